"""Measured motions of a robot, and the motion of platform and carriers that they show."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, Frozen, assign, checked
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.forward_kinematics import forward_kinematics
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose

_DEGREE = 5
"""Of the splines: accelerations are cubic, without jumps in the jerk."""


@dataclass(frozen=True, init=False, eq=False, repr=False)
class Records(Frozen):
    """A measured motion: N samples of the drives, m motors and k carriers.

    Attributes:
        t: (N,) time, s, increasing.
        effort: (N, m) efforts of the main actuators, N or N·m.
        position: (N, m) their positions, m or rad, full turns counted; (N, 0) if the platform was measured.
        platform: (N, n) coordinates of the platform, m and rad, if they were measured; (N, 0) otherwise. Motions
            through a type II singularity need them: there the motors do not say where the platform is.
        carriers: (N, k) positions of the carriers, m; parked at zero when left out.
        carrier_force: (N, k) forces of their actuators, N; (N, 0) if they were not measured.

    Raises:
        InputError: shapes, values that are not finite, time that does not increase, neither positions nor platform.
    """

    t: Array
    effort: Array
    position: Array
    platform: Array
    carriers: Array
    carrier_force: Array

    def __init__(
        self,
        t: ArrayLike,
        effort: ArrayLike,
        position: ArrayLike | None = None,
        *,
        platform: ArrayLike | None = None,
        carriers: ArrayLike | None = None,
        carrier_force: ArrayLike | None = None,
    ) -> None:
        time = checked(t, "t", ("N",))
        if not (np.diff(time) > 0.0).all():
            k = int(np.argmax(np.diff(time) <= 0.0)) + 1
            raise InputError(
                f"t does not increase: {time[k]:g} s at sample {k} follows {time[k - 1]:g} s.",
                remedy="Sort the samples and leave out doubles.",
                sample=k,
            )
        if (position is None) == (platform is None):
            raise InputError(
                "Records hold the positions of the motors or the coordinates of the platform, and not both.",
                remedy="Pass position=..., or platform=... where the motion goes through a type II singularity.",
            )
        given = {
            "effort": effort,
            "position": position,
            "platform": platform,
            "carriers": carriers,
            "carrier_force": carrier_force,
        }
        arrays = {
            name: np.zeros((len(time), 0)) if value is None else checked(value, name, (len(time), "any"))
            for name, value in given.items()
        }
        assign(self, t=time, **arrays)

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)

    def __repr__(self) -> str:
        """Return the numbers of samples and drives."""
        what = "platform" if self.platform.shape[1] else "motors"
        return f"Records({len(self)} samples of {what}, {self.t[0]:g} to {self.t[-1]:g} s)"


@dataclass(frozen=True, eq=False)
class SmoothMotion(Frozen):
    """The smooth motion that records show, and what of it is used.

    Attributes:
        motion, carriers: of platform and carriers, samples at both ends left out.
        kept: which samples of the records they are.
        noise: standard deviation of what was measured about the splines, by column, m and rad.
    """

    motion: PlatformMotion
    carriers: CarrierMotion
    kept: slice
    noise: Array


def require_matching(robot: Robot, records: Records) -> None:
    """Raise InputError where the columns of records are not those of a robot."""
    columns = {
        "effort": (robot.m,),
        "position": (robot.m, 0),
        "platform": (robot.n, 0),
        "carriers": (robot.k, 0),
        "carrier_force": (robot.k, 0),
    }
    for name, allowed in columns.items():
        found = getattr(records, name).shape[1]
        if found not in allowed:
            raise InputError(
                f"{name} has {found} columns; {robot.name} has {allowed[0]} of them.",
                remedy=f"Pass one for each of {', '.join(robot.carriers if 'carrier' in name else robot.actuated)}."
                if name != "platform"
                else "Pass one for each independent coordinate.",
                name=name,
            )
    if records.platform.shape[1] and is_pose(robot):
        raise InputError(
            f"The platform of {robot.name} has poses, which records do not hold.",
            remedy="Pass position=... of the motors.",
        )


def smooth_motion(robot: Robot, records: Records, cut_off: float) -> SmoothMotion:
    """Return the motion behind noisy positions: least-squares splines of degree 5, two knots a period of the cut-off.

    A spline has no phase shift, and its rates are those of its positions exactly. The platform follows from the motors
    by ``forward_kinematics`` on the branch of the reference. One and a half periods at each end are left out, where
    splines have free ends.

    Raises:
        InputError: fewer samples than a spline needs, motors whose positions the machine does not reach.
    """
    h = 0.5 / cut_off
    t, edge = records.t, 3.0 * h
    intervals = round((t[-1] - t[0]) / h) if len(t) > 1 else 0
    if intervals < 8 or len(t) < 2 * (intervals + _DEGREE):
        raise InputError(
            f"{len(t)} samples in {t[-1] - t[0]:g} s do not determine a spline with cut-off {cut_off:g} Hz.",
            remedy="Record at least 4 periods of the cut-off with 4 samples each, or change cut_off.",
            samples=len(t),
        )
    measured = records.platform if records.platform.shape[1] else records.position
    (u, ud, udd), noise = _spline(t, measured, intervals)
    s, noise_s = _spline(t, records.carriers, intervals)
    keep = np.flatnonzero((t >= t[0] + edge) & (t <= t[-1] - edge))
    kept = slice(int(keep[0]), int(keep[-1]) + 1)
    if records.platform.shape[1]:
        x, xd, xdd = u[kept], ud[kept], udd[kept]
    else:
        found = forward_kinematics(robot, u[kept], rates=ud[kept], accelerations=udd[kept])
        if not found.known.all():
            k = int(np.argmin(found.known))
            raise InputError(
                f"The motors of {robot.name} at {np.array2string(u[kept][k], precision=4)}, t = {t[kept][k]:g} s, are "
                f"{found.status_labels[k]} on the way from the reference.",
                remedy="Check order, sign, zero and unit of the encoders; through a type II singularity pass "
                "platform=... in place of position.",
                sample=k + kept.start,
            )
        x, xd, xdd = found.x, found.xd, found.xdd
    motion = PlatformMotion(t[kept], x, xd, xdd, check_rates=False)
    parked = CarrierMotion.parked(len(motion), robot.k)
    carriers = CarrierMotion(*(part[kept] for part in s), check_rates=False) if records.carriers.shape[1] else parked
    return SmoothMotion(motion, carriers, kept, np.concatenate([noise, noise_s]))


def _spline(t: Array, values: Array, intervals: int) -> tuple[tuple[Array, Array, Array], Array]:
    """Return a spline through (N, c) values with its two rates, and the standard deviation (c,) about it."""
    from scipy.interpolate import make_lsq_spline

    if not values.shape[1]:
        return (values, values, values), np.zeros(0)
    inner = np.linspace(t[0], t[-1], intervals + 1)
    knots = np.concatenate([[t[0]] * _DEGREE, inner, [t[-1]] * _DEGREE])
    spline = make_lsq_spline(t, values, knots, _DEGREE)
    first, second, third = (spline(t, order) for order in range(3))
    freedom = max(len(t) - intervals - _DEGREE, 1)
    return (first, second, third), np.sqrt(((values - first) ** 2).sum(axis=0) / freedom)
