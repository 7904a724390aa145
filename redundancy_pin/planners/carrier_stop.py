"""Carriers that must be able to stop: the speed they may have, and how they are braked.

In one step of length h a carrier takes a new speed v' and moves by h v' (backward differences, Parsa 2014, eqs. 4.3
and 4.4). Say it has the distance g to the end of its track in front of it and can be braked by at most a. It may take
the speed v' if what is left after the step suffices to stop: h v' + v'²/(2a) ≤ g. Braking by a keeps this true: with
v' = max(v − a h, 0) the step is at most (v² − v'²)/(2a). So a carrier that starts inside the set never leaves its
track, whatever the lengths of the steps.
"""

from __future__ import annotations

import math

import numpy as np

from redundancy_pin.arrays import Array


def stoppable_speed(gap: float, step: float, deceleration: float) -> float:
    """Return the largest speed towards the end of a track from which a carrier can still be stopped before it.

    Args:
        gap: distance to the end of the track before the step, m.
        step: length of the step, s.
        deceleration: largest deceleration, m/s²; infinite if there is no limit.

    Returns:
        Speed after the step, m/s: the root of h v + v²/(2a) = gap, or 0 where the gap is not positive.
    """
    if gap <= 0.0:
        return 0.0
    if not math.isfinite(deceleration) or not math.isfinite(gap):
        return gap / step
    slowed = deceleration * step
    # the rationalised root: the plain one cancels where the gap is small
    return 2.0 * deceleration * gap / (slowed + math.sqrt(slowed * slowed + 2.0 * deceleration * gap))


def braked_speeds(speed: Array, braking_time: Array, elapsed: Array) -> Array:
    """Return (J, k) the speeds of carriers that are braked by constant decelerations.

    Args:
        speed: (k,) speed at the start, m/s, either sign.
        braking_time: (k,) time until rest, s; zero for a carrier at rest.
        elapsed: (J,) time since the start at the end of each step, s.
    """
    duration = np.where(braking_time > 0.0, braking_time, 1.0)
    left: Array = speed * np.clip(1.0 - elapsed[:, None] / duration, 0.0, None)
    left[:, braking_time <= 0.0] = 0.0
    return left


def braking_times(speed: Array, room: Array, deceleration: Array, wanted: float) -> Array:
    """Return (k,) the time each carrier takes to stop: as wanted, sooner where the track asks for it.

    Args:
        speed: (k,) speed, m/s, either sign.
        room: (k,) distance to the end of the track in the direction of motion, m.
        deceleration: (k,) largest deceleration, m/s².
        wanted: wanted time, s.

    Returns:
        Time, s; never below |v|/a, even where the track is too short for it.
    """
    size = np.abs(speed)
    moving = size > 0.0
    by_track = np.where(moving, 2.0 * room / np.where(moving, size, 1.0), np.inf)
    times: Array = np.where(moving, np.maximum(np.minimum(wanted, by_track), size / deceleration), 0.0)
    return times
