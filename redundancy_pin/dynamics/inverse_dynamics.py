"""Efforts along a motion, singular instants between its samples, and joints that leave their limits."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, RANK_TOLERANCE, Array, Frozen, frozen, read_only, runs
from redundancy_pin.dynamics.allocation import ROUNDING
from redundancy_pin.dynamics.arguments import OnUnreachable, require_matching_carriers, require_on_track
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.dynamics.distribution import Distribution, distribute
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.io.files import write_text
from redundancy_pin.io.summary import Summary, TextTable, row
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import difference
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_consistent, require_sampled
from redundancy_pin.robot import Robot
from redundancy_pin.robot.joint_ranges import JointExcess, beyond_limits
from redundancy_pin.robot.loads import Load, Wrench
from redundancy_pin.robot.scales import effort_unit, is_revolute, row_scale
from redundancy_pin.singularities.classify import SingularityKind, margins_of, signed_margin
from redundancy_pin.singularities.crossings import SPACING, Crossing, find_crossings
from redundancy_pin.spectrum import scaled
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.trajectory.csv_file import csv_rows, effort_columns, motion_columns
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

_CONSISTENT = 1e-3
"""Fraction of f, no unit, outside the range of W that counts as none at an instant between samples: rates and
accelerations are interpolated there. Efforts that it calls for exceed f only where the margin is below it, for as long
as that lasts."""

_LISTED = 10
"""Instants that a warning names; the rest is counted."""


@dataclass(frozen=True, eq=False)
class SingularInterval:
    """A type II singularity that a motion meets, at a sample or between two.

    Attributes:
        t: time, s.
        until: equal to ``t``, or the time until which the motion stays on it, s.
        kind: type II or combined.
        crosses: whether det W changes sign.
        status: status of the efforts at this instant.
        residual: N, scaled: the part of f that no actuator can carry (``Distribution.residual``).
    """

    t: float
    until: float
    kind: SingularityKind
    crosses: bool
    status: SampleStatus
    residual: float

    @property
    def unbounded(self) -> bool:
        """Whether no finite efforts exist there, so that they grow without bound towards it."""
        return not self.status.solved


@dataclass(frozen=True, eq=False, repr=False)
class InverseDynamics(Frozen):
    """Efforts along a motion, and singular instants between its samples.

    The search between the samples takes tens of milliseconds. The first access to ``status``, ``instants`` or
    ``unresolved`` starts it.

    Attributes:
        reduced: W τ = f and the carrier forces, (N, ...).
        efforts: the main efforts, with a status for each sample.
        bounds: (m, 2) smallest and largest main efforts, N or N·m; infinite if unbounded, or one for each sample.
    """

    reduced: ReducedDynamics
    efforts: Distribution
    bounds: Array
    _dynamics: Dynamics
    _along: DynamicsAlongMotion
    _carriers: CarrierMotion | None
    _unreachable: OnUnreachable

    @property
    def status(self) -> ResultStatus:
        """Status of the whole motion.

        Ok; unbounded (no finite efforts at a sample or between two); limit violated (at some samples none within the
        bounds); or unresolved.
        """
        without = self.efforts.status[~np.isfinite(self.efforts.tau).all(axis=1)]
        if any(instant.unbounded for instant in self.instants) or (without != SampleStatus.BOUND_INFEASIBLE).any():
            return ResultStatus.UNBOUNDED
        if len(without):
            return ResultStatus.LIMIT_VIOLATED
        return ResultStatus.UNRESOLVED if self.unresolved else ResultStatus.OK

    @cached_property
    def instants(self) -> tuple[SingularInterval, ...]:
        """The type II singularities met, at a sample or between two, in order of time."""
        met = [one for one in self._crossings[0] if one.kind != SingularityKind.TYPE_I]
        return _instants(self._dynamics, self._along.motion, self._carriers, met, self._unreachable) if met else ()

    @property
    def unresolved(self) -> str:
        """Why the motion cannot be followed between its samples; empty if it can."""
        return self._crossings[1]

    @cached_property
    def joint_limits(self) -> tuple[JointExcess, ...]:
        """Joints that leave a limit of position at samples, passive ones too."""
        robot, motion = self._along.robot, self._along.motion
        return beyond_limits(robot, self._configurations[0], motion.t)

    @cached_property
    def serial_margin(self) -> Array:
        """(N,) margin to type I at the samples, no unit, as ``classify_motion`` has it; NaN where none closes."""
        system, q = constraint_system(self._along.robot), self._configurations[0]
        closed = np.isfinite(q).all(axis=1)
        margin = np.full(len(q), np.nan)
        if closed.any():
            margin[closed] = margins_of(system, system.evaluate(q[closed])).serial
        return read_only(margin)

    @cached_property
    def _configurations(self) -> tuple[Array, Array]:
        """Configurations q (N, nq) and Γ (N, nv, n); solved here if the backend is a closed form."""
        along = self._along
        if along.q is not None and along.gamma is not None:
            return along.q, along.gamma
        tree = inverse_kinematics(along.robot, along.motion, mark_unreachable=self._unreachable == "mark")
        return tree.q, tree.gamma

    @cached_property
    def _crossings(self) -> tuple[list[Crossing], str]:
        """The singularities at and between consistent samples, and why some part cannot be followed, or ""."""
        robot, motion, reduced = self._along.robot, self._along.motion, self.reduced
        crossings: list[Crossing] = []
        unresolved = ""
        if not motion.check_rates:
            return crossings, unresolved
        margins = signed_margin(scaled(reduced.W, reduced.row_scale, reduced.column_scale))
        for first, stop in runs(reduced.reachable):
            part, margin = motion[first:stop], margins[first:stop]
            # of samples hardly farther apart than those of a search the margin itself shows whether there is anything
            if not part.t[-1] > part.t[0] or not _may_meet(robot, part, margin, 2.0 * SPACING):
                continue
            q, gamma = (each[first] for each in self._configurations)
            start = follower(robot).state_at(q, part.x[0], gamma) if np.isfinite(q).all() else None
            checked = PlatformMotion(part.t, part.x, part.xd, part.xdd, check_rates=False)
            try:
                crossings += find_crossings(robot, checked, start=start)
            except RedundancyPinError as error:
                # the samples can be followed, the motion between them cannot, or is too near a rank loss to search
                if _may_meet(robot, part, margin, 10.0 * SPACING):
                    unresolved = unresolved or error.message
        return crossings, unresolved

    def summary(self) -> Summary:
        """Return a summary of the efforts, SI units: a mapping, whose ``print`` is a table with warnings.

        NaN is left out of the largest efforts.
        """
        robot = self._along.robot
        facts: dict[str, Any] = {
            "robot": robot.name,
            "samples": len(self.efforts),
            "statuses": self.efforts.status_counts,
            "largest_tau": np.fmax.reduce(np.abs(self.efforts.tau), axis=0),
            "largest_carrier_force": np.fmax.reduce(np.abs(self.reduced.carrier_force), axis=0),
            "smallest_margin": float(np.fmin.reduce(self.efforts.margin)),
            "smallest_type_i_margin": float(np.fmin.reduce(self.serial_margin)),
            "largest_closure_residual": float(np.fmax.reduce(self.reduced.residual)),
            "status": self.status.value,
            "singular_instants": [
                {**vars(one), "kind": one.kind.label, "status": one.status.label, "unbounded": one.unbounded}
                for one in self.instants
            ],
            "joint_limits": [vars(excess) for excess in self.joint_limits],
            "unresolved": self.unresolved or None,
        }
        main, moved = (
            effort_unit(is_revolute(robot, name) for name in names) for names in (robot.actuated, robot.carriers)
        )
        rows = [
            ("status", self.status.value.replace("_", " ")),
            *((f"{name} samples", str(count)) for name, count in facts["statuses"].items()),
            (f"largest |tau| [{main}]", row(facts["largest_tau"])),
            *([(f"largest |carrier force| [{moved}]", row(facts["largest_carrier_force"]))] if robot.k else []),
            ("smallest margin to type II", f"{facts['smallest_margin']:.6g}"),
            ("smallest margin to type I", f"{facts['smallest_type_i_margin']:.6g}"),
            *([("singular at t [s]", row(one.t for one in self.instants))] if self.instants else []),
        ]
        return Summary(facts, TextTable(f"{robot.name}: {len(self.efforts)} samples", rows), warnings=self.warnings())

    def warnings(self) -> Iterator[str]:
        """Give the places without finite efforts, and limits of the sampling, a sentence each."""
        unbounded = [one for one in self.instants if one.unbounded]
        if unbounded:
            listed = ", ".join(f"{one.t:.9g}" for one in unbounded[:_LISTED])
            more = f" and {len(unbounded) - _LISTED} more instants" if len(unbounded) > _LISTED else ""
            worst = max(unbounded, key=lambda one: one.residual)
            what = "det W changes sign" if any(one.crosses for one in unbounded) else "W loses rank"
            yield (
                f"no finite main efforts at t = {listed} s{more}: {what} there, at a type II singularity; "
                f"{worst.residual:.4g} N (scaled) are left that no actuator can carry. Near it they grow without bound."
            )
        nearest = np.fmin.reduce(self.serial_margin)
        if self._along.robot.platform is None and nearest < NEAR_SINGULAR_MARGIN:
            t = self.reduced.t[int(np.nanargmin(self.serial_margin))]
            yield (
                f"the margin to type I is {nearest:.3g} at t = {t:.6g} s: the joints that are coordinates hardly "
                "determine the others there. If they are the motors, these hardly hold the machine, and efforts "
                "grow as the margin falls. With a platform as coordinates its type II singularities are found."
            )
        if self.unresolved:
            yield f"between its samples the motion cannot be followed: {self.unresolved}"
        yield from (f"{excess}." for excess in self.joint_limits)
        without = np.flatnonzero(~np.isfinite(self.efforts.tau).all(axis=1))
        if len(without):
            first = f"t = {self.reduced.t[without[0]]:.6g} s ({self.efforts.status_labels[without[0]]})"
            bounded = (self.efforts.status[without] == SampleStatus.BOUND_INFEASIBLE).all()
            what = "no main efforts within the bounds" if bounded else "no finite main efforts"
            yield f"{what} at {len(without)} of {len(self.efforts)} samples, first at {first}."

    def to_csv(self, path: str | Path) -> None:
        """Write the motion and its efforts to a CSV file, which ``from_csv`` reads as a motion again.

        Columns with units in their names: the motion's columns, ``tau:JOINT`` for each actuator and carrier, N or N·m,
        ``status``, ``margin``, ``residual``.

        Raises:
            OutputError: the file cannot be written; an earlier one is as it was.
        """
        robot, motion, efforts = self._along.robot, self._along.motion, self.efforts
        carriers = require_matching_carriers(robot, self._carriers, len(motion))
        columns = {
            **motion_columns(robot, motion, carriers),
            **effort_columns(robot.actuated, efforts.tau, robot),
            **effort_columns(robot.carriers, self.reduced.carrier_force, robot),
            "status": ("", efforts.status_labels),
            "margin": ("", efforts.margin),
            "residual": ("N", efforts.residual),
        }
        write_text(path, csv_rows(columns))

    def __repr__(self) -> str:
        """Return a summary of the whole motion, not the arrays."""
        met = ", ".join(f"{one.t:.6g}" for one in self.instants)
        parts = [
            self.status.value,
            *([f"singular at t = {met} s"] if met else []),
            *map(str, self.joint_limits),
            repr(self.efforts),
        ]
        return f"InverseDynamics({'; '.join(parts)})"


def inverse_dynamics(
    dynamics: DynamicsLike,
    motion: PlatformMotion,
    carriers: CarrierMotion | None = None,
    *,
    unreachable: OnUnreachable = "raise",
    external: Sequence[Load] = (),
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    preferred: ArrayLike | None = None,
) -> InverseDynamics:
    """Return the efforts along a motion, its singular instants, and joints that leave their limits.

    ``reduce`` and ``distribute`` know samples. Where det W changes sign between two of them both may be regular, and no
    finite effort exists in between; the result searches there on request. Samples of no motion (``check_rates=False``)
    and a single instant have nothing in between.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend.
        motion: N samples of the platform coordinates.
        carriers: N samples of the carriers; parked at s = 0 when left out.
        unreachable: refuse a motion that leaves the workspace ("raise"), or "mark" those samples.
        external: further loads, as in ``Dynamics.reduce``; sampled wrenches are linear between their samples.
        lower: scalar or (m,) smallest main efforts, N or N·m, such as a preload against backlash. As in ``distribute``.
        upper: scalar or (m,) largest main efforts, N or N·m. As in ``distribute``.
        preferred: scalar, (m,) or (N, m) main efforts kept to where the motion leaves a choice, N or N·m, such as a
            squeeze. As in ``distribute``.

    Raises:
        CarrierLimitError, InputError, UnreachablePoseError, SingularPoseError, WorkingModeError: as in
            ``Dynamics.reduce``.

    Example:
        >>> result = rp.inverse_dynamics("2rpr", rp.trajectory.reference.circle(speed=0.5).sample(0.01))
        >>> result.efforts.tau.shape, result.status.value
        ((270, 2), 'unbounded')
    """
    dynamics = as_dynamics(dynamics)
    dynamics = dynamics.with_external(*external) if external else dynamics
    require_sampled(motion)
    matched = require_matching_carriers(dynamics.robot, carriers, len(motion))
    require_consistent(motion, carriers)
    require_on_track(dynamics.robot, matched, motion.t)
    along = dynamics.along(motion, unreachable=unreachable)
    reduced = along.reduce(carriers)
    efforts = distribute(reduced, lower=lower, upper=upper, preferred=preferred)
    ends = ((lower, -np.inf), (upper, np.inf))
    constant = [none if bound is None or np.ndim(bound) > 1 else bound for bound, none in ends]
    bounds = frozen(np.stack([np.broadcast_to(each, dynamics.robot.m) for each in constant], axis=1))
    return InverseDynamics(reduced, efforts, bounds, dynamics, along, carriers, unreachable)


def _may_meet(robot: Robot, motion: PlatformMotion, margin: Array, nearest: float) -> bool:
    """Return whether a singularity may lie between samples; true for samples too far apart to decide.

    Between neighbouring samples at most ``nearest`` characteristic lengths apart the margin (N,) has at most one dip,
    less than twice as deep as the fall outside of them (``roots``).
    """
    steps = np.linalg.norm(difference(robot, motion.x[1:], motion.x[:-1]) * row_scale(robot), axis=1)
    if steps.max() > nearest * robot.characteristic_length:
        return True
    size = np.abs(margin)
    padded = np.pad(size, 1, mode="edge")
    fall = np.maximum(np.maximum(padded[:-2], padded[2:]) - size, 0.0)
    stays = size <= RANK_TOLERANCE  # along a singularity the margin is rounding, of either sign
    return bool((margin[1:] * margin[:-1] <= 0.0).any() or (size - 2.0 * fall <= 0.0).any() or stays.any())


def _instants(
    dynamics: Dynamics,
    motion: PlatformMotion,
    carriers: CarrierMotion | None,
    met: list[Crossing],
    unreachable: OnUnreachable,
) -> tuple[SingularInterval, ...]:
    """Return the efforts at crossings, which are inserted among the samples: one branch is followed through all."""
    t = np.array([one.t for one in met])
    new = ~np.isin(t, motion.t)
    order = np.argsort(np.concatenate([motion.t, t[new]]), kind="stable")

    def merged(old: Array, added: Array) -> Array:
        both: Array = np.concatenate([old, added[new]])[order]
        return both

    time, x = merged(motion.t, t), merged(motion.x, np.array([one.x for one in met]))
    xd, xdd = _rates(motion.t, motion.xd, motion.xdd, t)
    moved = None
    if carriers is not None:
        s, (sd, sdd) = _positions(motion.t, carriers, t), _rates(motion.t, carriers.sd, carriers.sdd, t)
        pairs = (carriers.s, s), (carriers.sd, sd), (carriers.sdd, sdd)
        moved = CarrierMotion(*(merged(*pair) for pair in pairs), check_rates=False)
    among = PlatformMotion(time, x, merged(motion.xd, xd), merged(motion.xdd, xdd), check_rates=False)
    loads = tuple(_between(load, motion.t, time) for load in dynamics.robot.loads)
    if any(new is not old for new, old in zip(loads, dynamics.robot.loads, strict=True)):
        dynamics = dynamics.for_robot(replace(dynamics.robot, loads=loads))
    reduced = dynamics.reduce(among, moved, unreachable=unreachable, check_track=False)
    # a margin that only touches zero is known to the root of its rounding
    solved = distribute(reduced, consistency_tolerance=_CONSISTENT, rank_tolerance=ROUNDING**0.5)
    instants = []
    for one, k in zip(met, np.searchsorted(time, t).tolist(), strict=True):
        if solved.rank[k] == min(reduced.W.shape[1:]):
            continue  # the closures lose rank there, W on the branch that goes through does not
        status, residual = SampleStatus(solved.status[k]), float(solved.residual[k])
        instants.append(SingularInterval(one.t, one.until, one.kind, one.crosses, status, residual))
    return tuple(instants)


def _is_sampled(load: Load) -> TypeGuard[Wrench]:
    return isinstance(load, Wrench) and isinstance(load.value, np.ndarray) and load.value.ndim == 2


def _between(load: Load, t: Array, at: Array) -> Load:
    """Return a wrench that is given at times, at others: linear in between. Other loads are as they are."""
    if not _is_sampled(load):
        return load
    value = np.stack([np.interp(at, t, column) for column in np.asarray(load.value).T], axis=1)
    return Wrench(load.frame, value, load.reference, load.point)


def _rates(t: Array, rate: Array, acceleration: Array, at: Array) -> tuple[Array, Array]:
    """Return rates and accelerations (C, n) at times: the cubics through both at the samples."""
    velocity = PiecewisePolynomial.through(t, rate, acceleration)
    return velocity(at), velocity.derivative()(at)


def _positions(t: Array, carriers: CarrierMotion, at: Array) -> Array:
    """Return (C, k) positions of carriers: the quintics through s, ṡ, s̈ at the samples."""
    return PiecewisePolynomial.through(t, carriers.s, carriers.sd, carriers.sdd)(at)
