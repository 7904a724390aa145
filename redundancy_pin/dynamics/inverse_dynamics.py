"""Efforts along a motion, with a word on what its samples do not show: what lies between them, and limits of joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, TypeGuard

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import RANK_TOLERANCE, Array, Frozen, IntArray, frozen, require_type, runs
from redundancy_pin.dynamics.base import (
    Dynamics,
    OnUnreachable,
    ReducedDynamics,
    require_matching_carriers,
    require_on_track,
)
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.dynamics.distribution import Distribution, distribute
from redundancy_pin.errors import InputError, RedundancyPinError, numbered_from
from redundancy_pin.kinematics.continuation import Point
from redundancy_pin.kinematics.coordinates import difference, working_modes
from redundancy_pin.kinematics.inverse_kinematics import JointTrajectory, inverse_kinematics
from redundancy_pin.motion import CarrierMotion, PlatformMotion, joined, require_consistent, require_sampled
from redundancy_pin.robot import Robot
from redundancy_pin.robot.joint_ranges import JointExcess, Turns, beyond_limits, out_of_range, turns_of
from redundancy_pin.robot.loads import Load, Wrench
from redundancy_pin.robot.scales import row_scale
from redundancy_pin.singularities.classify import SingularityKind, signed_margin
from redundancy_pin.singularities.crossings import SPACING, Crossing, find_crossings
from redundancy_pin.spectrum import scaled
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

_CONSISTENT = 1e-3
"""Fraction of f outside the range of W that counts as none at an instant between samples: rates and accelerations are
interpolated there. Efforts that it calls for exceed f only where the margin is below it, for as long as that lasts."""

_AT_INSTANT = 1e-7
"""Rank tolerance there: instants are exact to rounding where the margin goes through zero, to its root where it only
touches."""


_NEAR, _FAR = 2.0 * SPACING, 10.0 * SPACING
"""Steps of samples, in characteristic lengths, between which the margin is not searched where it stays away from zero;
the second where the search fails."""


@dataclass(frozen=True, eq=False)
class SingularInstant:
    """A type II singularity that a motion meets, at a sample or between two.

    Attributes:
        t: time, s.
        until: equal to ``t``, or the time until which the motion stays on it, s.
        kind: type II or combined.
        crosses: whether det W changes sign.
        status: that of the efforts at this instant.
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
    """Efforts along a motion, and what the samples do not show.

    Attributes:
        reduced: W τ = f and the carrier forces, (N, ...).
        efforts: the main efforts, with a status for each sample.
        instants: the type II singularities met, in order of time.
        joint_limits: joints that leave a limit of position, passive ones too.
        unresolved: why the motion cannot be followed between its samples; empty where it can.
    """

    reduced: ReducedDynamics
    efforts: Distribution
    instants: tuple[SingularInstant, ...]
    joint_limits: tuple[JointExcess, ...]
    unresolved: str

    @property
    def status(self) -> ResultStatus:
        """What may be said of the whole motion."""
        without = self.reduced.reachable & ~np.isfinite(self.efforts.tau).all(axis=1)
        if without.any() or any(instant.unbounded for instant in self.instants):
            return ResultStatus.UNBOUNDED
        return ResultStatus.UNRESOLVED if self.unresolved else ResultStatus.OK

    def __repr__(self) -> str:
        """Return what is to be known of the whole motion, not the arrays."""
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
    """Return the efforts along a motion, what lies between its samples, and the limits of joints that it leaves.

    ``reduce`` and ``distribute`` know samples. Where det W changes sign between two of them both may be regular, and no
    finite effort exists in between; this function looks there. Samples that are no motion (``check_rates=False``) and
    a single instant have nothing in between.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend.
        motion: N samples of the platform coordinates.
        carriers: N samples of the carriers; parked at s = 0 when left out.
        unreachable: as in ``Dynamics.along``.
        external: further loads, as in ``Dynamics.reduce``; sampled wrenches are linear between their samples.
        lower: smallest efforts at the samples, as in ``distribute``.
        upper: largest ones, likewise.
        preferred: efforts that are kept to where there is a choice, likewise.

    Raises:
        CarrierLimitError, InputError, UnreachablePoseError, SingularPoseError, WorkingModeError: as in
            ``Dynamics.reduce``.
    """
    dynamics = as_dynamics(dynamics)
    dynamics = dynamics.with_external(*external) if external else dynamics
    require_sampled(motion)
    require_matching_carriers(dynamics.robot, carriers, len(motion))
    require_consistent(motion, carriers)
    wanted = {"lower": lower, "upper": upper, "preferred": preferred}
    return _part(dynamics, motion, carriers, unreachable, motion.check_rates, {}, wanted)[0]


def inverse_dynamics_in_blocks(
    dynamics: DynamicsLike,
    blocks: Iterable[tuple[PlatformMotion, CarrierMotion | None]],
    *,
    unreachable: OnUnreachable = "raise",
    lower: ArrayLike | None = None,
    upper: ArrayLike | None = None,
    preferred: ArrayLike | None = None,
) -> Iterator[InverseDynamics]:
    """Give what ``inverse_dynamics`` returns for a motion that comes in blocks, block by block: memory does not grow.

    Each block goes on from a sample shortly before its first one, on the branch that the last one has led to, so that
    singularities between blocks are found too. Whole turns of joints are counted as in the first block. Rates are not
    compared with positions here: ``require_consistent`` does that for the whole.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend. Loads
            sampled in time do not go in blocks.
        blocks: samples of platform and carriers, each block following the one before.
        unreachable: as in ``inverse_dynamics``.
        lower: smallest efforts, scalar or (m,), as in ``distribute``.
        upper: largest ones, likewise.
        preferred: efforts that are kept to where there is a choice, likewise.

    Raises:
        InputError: a load of the robot is sampled in time, or blocks are not those of one motion.
        CarrierLimitError, UnreachablePoseError, SingularPoseError, WorkingModeError: as ``inverse_dynamics``; samples
            are numbered from the beginning of the motion.
    """
    dynamics = as_dynamics(dynamics)
    if any(_is_sampled(load) for load in dynamics.robot.loads):
        raise InputError(
            "A wrench sampled in time does not go with blocks of samples.",
            remedy="Pass a function of time, or the whole motion to inverse_dynamics.",
        )
    before: tuple[PlatformMotion, CarrierMotion | None] | None = None
    turns: Turns = {}
    wanted = {"lower": lower, "upper": upper, "preferred": preferred}
    done = 0  # samples that have been given
    for block in blocks:
        require_type(block, tuple, "A pair of motion and carriers", "Pass [(motion, None)] for one without carriers.")
        motion, carriers = block
        require_sampled(motion)
        if before is not None and motion.x.shape[1:] != before[0].x.shape[1:]:
            raise InputError(
                f"Samples of shape {motion.x.shape[1:]} follow such of {before[0].x.shape[1:]}.",
                remedy="Pass blocks of one motion.",
            )
        again = 0 if before is None else len(before[0])
        whole, moved = joined(before, (motion, carriers)) if before else (motion, carriers)
        until = -np.inf if before is None else before[0].t[-1]
        with numbered_from(done - again):
            result, tree = _part(dynamics, whole, moved, unreachable, motion.check_rates, turns, wanted)
        yield _without(result, again, until)
        done += len(motion)
        turns = turns or turns_of(dynamics.robot, tree.q)
        edge = edge_of(tree)
        before = whole[edge:], None if moved is None else moved[edge:]
        if tree.reachable[edge]:
            dynamics = _starting_at(dynamics, tree.q[edge])


def _part(
    dynamics: Dynamics,
    motion: PlatformMotion,
    carriers: CarrierMotion | None,
    unreachable: OnUnreachable,
    between: bool,
    turns: Turns,
    wanted: Mapping[str, Any],
) -> tuple[InverseDynamics, JointTrajectory]:
    """Return the efforts along consistent samples and the motion of the tree; ``between`` looks between them.

    ``wanted`` are arguments of ``distribute``.
    """
    robot = dynamics.robot
    require_on_track(robot, require_matching_carriers(robot, carriers, len(motion)), motion.t)
    along = dynamics.along(motion, unreachable=unreachable)
    reduced, tree = along.reduce(carriers), getattr(along, "tree", None)
    if not isinstance(tree, JointTrajectory):
        tree = inverse_kinematics(robot, motion, mark_unreachable=unreachable == "mark")
    if turns and reduced.out_of_range is not None:
        reduced = replace(reduced, out_of_range=out_of_range(robot, tree.q, turns=turns))
    margins = signed_margin(scaled(reduced.W, reduced.row_scale, reduced.column_scale))
    crossings: list[Crossing] = []
    unresolved = ""
    for first, stop in runs(reduced.reachable) if between else ():
        part, margin = motion[first:stop], margins[first:stop]
        if part.t[-1] > part.t[0] and _may_meet(robot, part, margin, _NEAR):
            try:
                start = Point(part.x[0], tree.q[first], tree.gamma[first]) if tree.reachable[first] else None
                crossings += find_crossings(robot, _unchecked(part), start=start)
            except RedundancyPinError as error:
                # the samples can be followed, the motion between them cannot, or is too near a rank loss to search
                if _may_meet(robot, part, margin, _FAR):
                    unresolved = unresolved or error.message
    met = [one for one in crossings if one.kind != SingularityKind.TYPE_I]
    instants = _instants(dynamics, motion, carriers, met, unreachable) if met else ()
    excesses = beyond_limits(robot, tree.q, motion.t, turns)
    return InverseDynamics(reduced, distribute(reduced, **wanted), instants, excesses, unresolved), tree


def _unchecked(motion: PlatformMotion) -> PlatformMotion:
    """Return samples whose rates have been compared with their positions."""
    return PlatformMotion(motion.t, motion.x, motion.xd, motion.xdd, check_rates=False)


def _without(result: InverseDynamics, again: int, until: float) -> InverseDynamics:
    """Return a part without the samples, and the instants up to a time, that the part before it has given."""
    if not again:
        return result
    whole = {field.name: getattr(result.efforts, field.name) for field in fields(result.efforts)}
    rest: dict[str, Any] = {name: part if part is None else part[again:] for name, part in whole.items()}
    efforts = replace(result.efforts, **rest)
    reduced = result.reduced.at(slice(again, None))
    instants = tuple(one for one in result.instants if one.until > until)
    return replace(result, reduced=reduced, efforts=efforts, instants=instants)


def edge_of(tree: JointTrajectory) -> int:
    """Return the sample of the last tenth that is farthest from losing the branch, or the last where none is closed."""
    first = len(tree.motion) - max(1, len(tree.motion) // 10)
    margin = np.where(tree.reachable, tree.serial_margin_bound, -1.0)[first:]
    return first + int(np.argmax(margin)) if margin.max() > 0.0 else len(tree.motion) - 1


def _starting_at(dynamics: Dynamics, q: Array) -> Dynamics:
    """Return the backend with a configuration (nq,) of the branch as the reference: what follows comes from there."""
    robot = dynamics.robot
    mode = tuple(working_modes(robot, q[None])[0].tolist()) if robot.working_modes else robot.working_mode
    return dynamics.for_robot(replace(robot, q_reference=frozen(q), working_mode=mode))


def _may_meet(robot: Robot, motion: PlatformMotion, margin: Array, nearest: float) -> bool:
    """Return whether a singularity may lie between samples; always where they are too far apart to tell.

    Between samples that are near the margin (N,) has one dip at most, and it falls by less than twice what it falls
    outside of them (``roots``).
    """
    steps = np.linalg.norm(difference(robot, motion.x[1:], motion.x[:-1]) * row_scale(robot), axis=1)
    if steps.max() > nearest * robot.characteristic_length:
        return True
    size = np.abs(margin)
    beside = np.pad(size, 1, mode="edge")
    fall = np.maximum(np.maximum(beside[:-2], beside[2:]) - size, 0.0)
    stays = size <= RANK_TOLERANCE  # along a singularity the margin is rounding, of either sign
    return bool((margin[1:] * margin[:-1] <= 0.0).any() or (size - 2.0 * fall <= 0.0).any() or stays.any())


def _instants(
    dynamics: Dynamics,
    motion: PlatformMotion,
    carriers: CarrierMotion | None,
    met: list[Crossing],
    unreachable: OnUnreachable,
) -> tuple[SingularInstant, ...]:
    """Return what the efforts do at crossings, which are put among the samples: one branch is followed through all."""
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
    solved = distribute(reduced, consistency_tolerance=_CONSISTENT, rank_tolerance=_AT_INSTANT)
    instants = []
    for one, k in zip(met, np.searchsorted(time, t).tolist(), strict=True):
        if solved.rank[k] == min(reduced.W.shape[1:]):
            continue  # the closures lose rank there, W on the branch that goes through does not
        status, residual = SampleStatus(solved.status[k]), float(solved.residual[k])
        instants.append(SingularInstant(one.t, one.until, one.kind, one.crosses, status, residual))
    return tuple(instants)


def _is_sampled(load: Load) -> TypeGuard[Wrench]:
    return isinstance(load, Wrench) and isinstance(load.value, np.ndarray) and load.value.ndim == 2


def _between(load: Load, t: Array, at: Array) -> Load:
    """Return a wrench that is given at times, at others: linear in between. Other loads are as they are."""
    if not _is_sampled(load):
        return load
    value = np.stack([np.interp(at, t, column) for column in np.asarray(load.value).T], axis=1)
    return Wrench(load.frame, value, load.reference, load.point)


def _edges(t: Array) -> tuple[IntArray, Array]:
    """Return the samples (I,) at the left of an interval, and the edges (I + 1,) of the intervals."""
    left = np.flatnonzero(np.diff(t) > 0.0)
    return left, np.append(t[left], t[-1])


def _rates(t: Array, rate: Array, acceleration: Array, at: Array) -> tuple[Array, Array]:
    """Return rates and accelerations (C, n) at times: the cubics through both at the samples."""
    left, edges = _edges(t)
    h = np.diff(edges)[:, None]
    v0, v1, a0, a1 = rate[left], rate[left + 1], acceleration[left], acceleration[left + 1]
    velocity = PiecewisePolynomial.from_bernstein(np.stack([v0, v0 + h * a0 / 3.0, v1 - h * a1 / 3.0, v1]), edges)
    return velocity(at), velocity.derivative()(at)


def _positions(t: Array, carriers: CarrierMotion, at: Array) -> Array:
    """Return (C, k) positions of carriers: the quintics through s, ṡ, s̈ at the samples."""
    left, edges = _edges(t)
    ends = [(carriers.s[k], carriers.sd[k], carriers.sdd[k]) for k in (left, left + 1)]
    return PiecewisePolynomial.hermite(edges, *ends)(at)
