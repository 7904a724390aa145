"""Arguments of dynamics: motions of platform and carriers, and single samples, checked."""

from __future__ import annotations

from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, numbers
from redundancy_pin.errors import CarrierLimitError, InputError, millimetres
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_carrier_motion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.joint_ranges import track_slack
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.types import slides

OnUnreachable = Literal["raise", "mark"]
"""What to do with a pose that no configuration closes: raise, or mark the sample with NaN and its residual."""

SampleArguments: TypeAlias = tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike, ArrayLike, ArrayLike]
"""x, xd, xdd, s, sd, sdd of ``Dynamics.torque``."""

SampleArrays: TypeAlias = tuple[Array, Array, Array, Array, Array, Array]
"""The same as arrays: x (n,) or (4, 4), xd and xdd (n,), s, sd and sdd (k,)."""


def sample_arrays(robot: Robot, given: SampleArguments) -> SampleArrays:
    """Return the arguments of one sample as arrays of doubles; they need not be finite, nor x a pose.

    Empty arguments of the carriers are zero; one number applies to all carriers.

    Raises:
        InputError: wrong shapes, or values that are not real numbers.
    """
    x, xd, xdd, *tracks = given
    n, k = robot.n, robot.k
    pose = (4, 4) if is_pose(robot) else (n,)
    platform = numbers(x, "x", pose), numbers(xd, "xd", (n,)), numbers(xdd, "xdd", (n,))
    carriers = []
    for part, name in zip(tracks, ("s", "sd", "sdd"), strict=True):
        shape = np.shape(part)
        if shape == (0,):
            carriers.append(np.zeros(k))
        else:
            carriers.append(numbers(part, name, (k,)) if shape else np.full(k, numbers(part, name, ())))
    return (*platform, carriers[0], carriers[1], carriers[2])


def one_sample(robot: Robot, given: SampleArguments, t: float) -> tuple[PlatformMotion, CarrierMotion]:
    """Return motions of one sample; arguments as of ``Dynamics.sample``.

    Raises:
        InputError: wrong shapes, values that are not finite, or a matrix that is not a pose.
    """
    x, xd, xdd, s, sd, sdd = (part[None] for part in sample_arrays(robot, given))
    return PlatformMotion([t], x, xd, xdd), CarrierMotion(s, sd, sdd)


def require_choice(unreachable: str) -> None:
    """Check what to do with unreachable poses.

    Raises:
        InputError: neither "raise" nor "mark".
    """
    if unreachable not in ("raise", "mark"):
        raise InputError(f"unreachable is {unreachable!r}.", remedy='Pass "raise" or "mark".')


def require_matching_carriers(robot: Robot, carriers: CarrierMotion | None, samples: int) -> CarrierMotion:
    """Return the carrier motion; parked at s = 0 when left out.

    Raises:
        InputError: wrong number of samples or carriers.
    """
    if carriers is None:
        return CarrierMotion.parked(samples, robot.k)
    require_carrier_motion(carriers)
    if carriers.s.shape != (samples, robot.k):
        raise InputError(
            f"The carrier motion has shape {carriers.s.shape}, expected {(samples, robot.k)}.",
            remedy=f"{robot.name} has k = {robot.k} carriers; give one row for each sample of the platform motion.",
        )
    return carriers


def track_excess(robot: Robot, carriers: CarrierMotion) -> Array:
    """Return (N, k) how far carriers (N, k) are beyond the ends of their tracks, m or rad; negative inside."""
    lower = np.array([limits.lower for limits in robot.carrier_limits])
    upper = np.array([limits.upper for limits in robot.carrier_limits])
    return np.asarray(np.maximum(lower - carriers.s, carriers.s - upper))


def require_on_track(robot: Robot, carriers: CarrierMotion, t: Array) -> None:
    """Check that every carrier stays on its track.

    Args:
        robot: the robot.
        carriers: (N, k) carrier motion.
        t: (N,) time, s, for the message.

    Raises:
        CarrierLimitError: naming carrier, sample, time and the amount by which it leaves the track.
    """
    outside = track_excess(robot, carriers)
    if (outside > track_slack(robot)).any():
        k, i = (int(j) for j in np.unravel_index(int(outside.argmax()), outside.shape))
        track, is_sliding = robot.carrier_limits[i], slides(find_joint(robot.model, robot.carriers[i]))
        unit, size = "m" if is_sliding else "rad", float(track.upper - track.lower)
        raise CarrierLimitError(
            f"Carrier {robot.carriers[i]!r} leaves its track [{track.lower:g}, {track.upper:g}] {unit} by "
            f"{outside[k, i]:.3g} {unit} at sample {k} (t = {t[k]:.6g} s, s = {carriers.s[k, i]:.6g} {unit})."
            f"{millimetres(float(outside[k, i]), size) if is_sliding else ''}",
            remedy="Shorten the motion or lengthen the track.",
            carrier=robot.carriers[i],
            sample=k,
            time=float(t[k]),
            amount=float(outside[k, i]),
        )
