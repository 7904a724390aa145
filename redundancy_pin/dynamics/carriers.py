"""Checks of a carrier motion that every backend makes."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import CarrierLimitError, InputError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import Robot

_TRACK_ROUNDING = 1e-12
"""A carrier parked at the very end of its track may overshoot it by rounding, m."""


def require_choice(unreachable: str) -> None:
    """Check what to do with unreachable poses.

    Raises:
        InputError: neither "raise" nor "mark".
    """
    if unreachable not in ("raise", "mark"):
        raise InputError(f"unreachable is {unreachable!r}.", remedy='Pass "raise" or "mark".')


def require_matching(robot: Robot, carriers: CarrierMotion | None, samples: int) -> CarrierMotion:
    """Return the carrier motion, parked at s = 0 when there is none.

    Raises:
        InputError: wrong number of samples or carriers.
    """
    if carriers is None:
        return CarrierMotion.parked(samples, robot.k)
    if carriers.s.shape != (samples, robot.k):
        raise InputError(
            f"The carrier motion has shape {carriers.s.shape}, expected {(samples, robot.k)}.",
            remedy=f"{robot.name} has {robot.k} carrier(s); give one row for each sample of the platform motion.",
        )
    return carriers


def require_on_track(robot: Robot, carriers: CarrierMotion, t: Array) -> None:
    """Check that every carrier stays on its track.

    Args:
        robot: the robot.
        carriers: (N, k) carrier motion.
        t: (N,) time, s, for the message.

    Raises:
        CarrierLimitError: naming carrier, sample, time and the amount by which it leaves the track.
    """
    carriers = require_matching(robot, carriers, len(t))
    lower = np.array([limits.lower for limits in robot.carrier_limits])
    upper = np.array([limits.upper for limits in robot.carrier_limits])
    outside = np.maximum(lower - carriers.s, carriers.s - upper)
    if outside.size and outside.max() > _TRACK_ROUNDING:
        k, i = (int(j) for j in np.unravel_index(int(outside.argmax()), outside.shape))
        raise CarrierLimitError(
            f"Carrier {robot.carriers[i]!r} leaves its track [{lower[i]:g}, {upper[i]:g}] m by {outside[k, i]:.3g} m "
            f"at sample {k} (t = {t[k]:.6g} s, s = {carriers.s[k, i]:.6g} m).",
            remedy="Shorten the motion or lengthen the track; planners evaluate off the track with check_track=False.",
            carrier=robot.carriers[i],
            sample=k,
            amount=float(outside[k, i]),
        )
