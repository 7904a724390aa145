"""Measured motions of a robot, and the smooth motion of platform and carriers that they show."""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline, make_lsq_spline
from scipy.sparse import csr_array

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
            through a type II singularity need them: there the motors do not determine the platform.
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
        if not len(time):
            raise InputError("Records have no sample.", remedy="Pass at least one time.")
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

    @property
    def efforts(self) -> Array:
        """(N, m) or (N, m + k) efforts of main actuators, and carrier forces where they were measured."""
        return np.concatenate([self.effort, self.carrier_force], axis=1)

    @property
    def positions(self) -> Array:
        """(N, c) measured columns: motors or platform coordinates, and carriers."""
        return np.concatenate([self.position, self.platform, self.carriers], axis=1)

    def changed(
        self, which: Any = slice(None), efforts: Array | None = None, positions: Array | None = None
    ) -> Records:
        """Return some of the samples, with other efforts or positions."""
        forces = np.split((self.efforts if efforts is None else efforts)[which], [self.effort.shape[1]], axis=1)
        columns = np.cumsum([self.position.shape[1], self.platform.shape[1]])
        places = np.split((self.positions if positions is None else positions)[which], columns, axis=1)
        result = copy(self)
        assign(result, t=self.t[which], effort=forces[0], carrier_force=forces[1])
        assign(result, position=places[0], platform=places[1], carriers=places[2])
        return result

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.t)

    def __repr__(self) -> str:
        """Return the numbers of samples and drives."""
        what = "platform" if self.platform.shape[1] else "motors"
        return f"Records({len(self)} samples of {what}, {self.t[0]:g} to {self.t[-1]:g} s)"


@dataclass(frozen=True, eq=False)
class SmoothMotion(Frozen):
    """The smooth motion of N samples that records show, and how noise of what was measured enters it.

    The c measured columns are motors or platform coordinates, and carriers.

    Attributes:
        motion, carriers: of platform and carriers, samples at both ends left out.
        kept: which samples of the records they are.
        jacobian: (N, n, c − k) ẋ per measured rate.
        noise: (c,) standard deviation of what was measured about the splines, m and rad.
        positions: the splines.
        efforts: those through all efforts, with the same knots.
        effort_noise: (d,) standard deviation of the efforts about them, N or N·m.
        basis: (N, K) first and second derivatives of the splines, sparse.
        everywhere: (T, K) splines at all samples of the records, sparse.
    """

    motion: PlatformMotion
    carriers: CarrierMotion
    kept: slice
    jacobian: Array
    noise: Array
    positions: BSpline
    efforts: BSpline
    effort_noise: Array
    basis: tuple[Any, Any]
    everywhere: Any

    @property
    def gram(self) -> Any:
        """(K, K) sum over all samples of products of the splines: inverse covariance of their coefficients, sparse."""
        return self.everywhere.T @ self.everywhere


def require_matching(robot: Robot, records: Records) -> None:
    """Raise InputError where the columns of records do not match a robot."""
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

    A spline has no phase shift, and its rates are exact derivatives. The platform follows from the motors
    by ``forward_kinematics`` on the branch of the reference. One and a half periods at each end are left out, where
    splines have free ends.

    Raises:
        InputError: fewer samples than a spline needs, gaps, motors whose positions the machine does not reach.
    """
    h = 0.5 / cut_off
    t, edge = records.t, 3.0 * h
    intervals = round((t[-1] - t[0]) / h)
    if intervals < 8 or len(t) < 2 * (intervals + _DEGREE):
        raise InputError(
            f"{len(t)} samples in {t[-1] - t[0]:g} s do not determine a spline with cut-off {cut_off:g} Hz.",
            remedy="Record at least 4 periods of the cut-off with 4 samples each, or change cut_off.",
            samples=len(t),
        )
    inner = np.linspace(t[0], t[-1], intervals + 1)
    _require_no_gap(t, inner)
    knots = np.concatenate([[t[0]] * _DEGREE, inner, [t[-1]] * _DEGREE])
    through_platform = bool(records.platform.shape[1])
    measured = records.platform if through_platform else records.position
    columns = np.concatenate([measured, records.carriers], axis=1)
    spline, efforts = (make_lsq_spline(t, part, knots, _DEGREE) for part in (columns, records.efforts))
    noise, effort_noise = (
        np.sqrt(((part - fitted(t)) ** 2).sum(axis=0) / (len(t) - intervals - _DEGREE))
        for part, fitted in ((columns, spline), (records.efforts, efforts))
    )
    inside = np.flatnonzero((t >= t[0] + edge) & (t <= t[-1] - edge))
    kept = slice(int(inside[0]), int(inside[-1]) + 1)
    smooth = [spline(t[kept], order) for order in range(3)]
    (u, ud, udd), held = (part[:, : measured.shape[1]] for part in smooth), records.carriers.shape[1]
    if through_platform:
        x, xd, xdd, jacobian = u, ud, udd, np.tile(np.eye(robot.n), (len(u), 1, 1))
    else:
        found = forward_kinematics(robot, u, rates=ud, accelerations=udd)
        if not found.known.all():
            k = int(np.argmin(found.known))
            raise InputError(
                f"The motors of {robot.name} at {np.array2string(u[k], precision=4)}, t = {t[kept][k]:g} s, are "
                f"{found.status_labels[k]} on the way from the reference.",
                remedy="Check order, sign, zero and unit of the encoders; through a type II singularity pass "
                "platform=... in place of position.",
                sample=k + kept.start,
            )
        x, xd, xdd, jacobian = found.x, found.xd, found.xdd, found.jacobian
    motion = PlatformMotion(t[kept], x, xd, xdd, check_rates=False)
    parked = CarrierMotion.parked(len(motion), robot.k)
    carriers = CarrierMotion(*(part[:, -held:] for part in smooth), check_rates=False) if held else parked
    noise = np.concatenate([noise, np.zeros(robot.k - held)])
    splines = BSpline(knots, np.eye(intervals + _DEGREE), _DEGREE)
    basis = csr_array(splines(t[kept], 1)), csr_array(splines(t[kept], 2))
    everywhere = csr_array(splines(t))
    return SmoothMotion(motion, carriers, kept, jacobian, noise, spline, efforts, effort_noise, basis, everywhere)


def _require_no_gap(t: Array, inner: Array) -> None:
    """Raise InputError where no sample lies between two knots: nothing determines the spline there."""
    empty = np.flatnonzero(np.histogram(t, inner)[0] == 0)
    if len(empty):
        k = int(np.searchsorted(t, inner[empty[0]], side="right"))
        raise InputError(
            f"The records have a gap from t = {t[k - 1]:g} s to {t[k]:g} s.",
            remedy="Pass the records before and after the gap as two Records, or lower cut_off.",
            sample=k,
        )
