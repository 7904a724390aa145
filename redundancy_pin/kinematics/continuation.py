"""Follow a branch: configurations along a sequence of poses, each reached continuously from the one before.

Anchors are laid along the path no further apart than a fraction of the robot's size (poses in between are made where
the samples are sparser, samples are passed over where they are denser). They are solved in batches that start from the
last solved anchor and shrink where the branch turns fast. The samples then start from an interpolation between their
anchors, so that a long, dense trajectory costs a few batched Newton steps and no loop over samples.

Poses where the closures themselves lose rank (a flat four-bar whose sides add up in pairs, a stretched parallelogram)
are crossings of branches. K is singular there, but along each branch q and Γ are smooth: the branch goes on with
the tangent it came with. See ``through_rank_loss``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, blocks
from redundancy_pin.kinematics.assembly import (
    Assembly,
    assemble,
    configuration_difference,
    integrate,
    inverses,
    project,
    rates,
)
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates, difference, mode_indicator, moved
from redundancy_pin.kinematics.multistart import multistart
from redundancy_pin.robot.scales import closure_tolerance, coordinate_unit, row_scale, velocity_unit

ANCHOR_SPACING = 0.04
"""Distance of anchors along the path, in characteristic lengths."""

_LARGEST_BATCH = 32
_DEEPEST_HALVING = 22
"""Halvings of a step before the branch counts as lost. Towards a stretched leg every step covers a part of the way that
is left: this many come within 1e-9 characteristic lengths of it."""
_SHORTEST_STEP = 2.0**-3
"""Where Newton needs shorter steps than this the pose is approached in smaller steps instead."""
CONTINUITY = 0.25
"""Largest part of a step that its trapezoidal prediction may miss before the branch counts as lost; the step is halved
first, which shrinks a smooth error eightfold and a jump not at all."""
ROUNDING = 1e-7
"""Changes of q below this (rad, or characteristic lengths) are rounding of the closure solution."""
_MOST_ANCHORS = 20_000
"""Anchors laid along one path beyond one a sample: eight hundred characteristic lengths of path."""


NEAR_RANK_LOSS = 3e-3
"""Scaled margin below which rounding shows: it costs velocities 1e-16 / margin², accelerations 1e-16 / margin³."""

_USUAL_PART = 0.1
"""Part of a robot's usual margin above which nothing is near a rank loss: short levers, gears and many joints make
margins of 1e-3 and less everywhere (Cassie), where no rank is lost."""
_NO_ENTRY = 1e-9
"""Part of the largest entry of K, or of its inverse, below which an entry is zero by the structure of the robot."""

_SOME, _AROUND = 8, 0.2
"""Configurations of a kind around the reference that say what is usual, and the change of their joints, rad or
characteristic lengths."""

_NODES = np.array([-4.0, -3.0, -2.0, -1.0, 1.0, 2.0, 3.0, 4.0])
_NODE_SPACINGS = (1e-2, 2.5e-3)
"""Distance of the nodes of an interpolation, in characteristic lengths: wide ones keep away from the singular pose,
narrow ones are for branches that turn fast."""

_SAME_TANGENT = 0.05
"""As ``CONTINUITY``, for the step across a rank loss. A prediction by both slopes is wrong by less than a hundredth of
a step of eight node spacings; a branch whose tangent is nearer than this to the own one would not be told apart."""

_CARRIED = 1e-8
"""Largest part of Γ that K Γ = (0, 1) may be missed by at a carried pose. At a fold, where Γ is infinite, it is missed
by one."""


_TOWARDS = 0.9
"""Share of a loop's determinant that its slope at an end of a step must consume within the step, for the step to count
as one through a rank loss. A determinant that is linear on both sides of its zero has one and more at both ends."""

_SLOPE_STEP = 1e-4
"""Part of a step over which a determinant's slope is taken."""

_CLEAR = 0.1
"""Part of ``near_rank_loss`` that the margin of a node must have, so that another loop's rank loss beside it costs
accelerations no more than their seventh digit."""

_SHIFTS = np.linspace(-1.2, 1.2, 25)
"""Places for a line's centre, in node spacings: its nodes keep away from every loop's rank loss as far as they can."""


class Point(NamedTuple):
    """One solved pose: coordinates (n,) or a pose (4, 4), configuration (nq,), Γ (nv, n), and signs of determinants.

    The signs (B,) are those of each loop's part of det K, see ``loops``; zero where they are not known.
    """

    x: Array
    q: Array
    gamma: Array
    side: Array | float = 0.0


@dataclass(frozen=True, eq=False)
class Anchors:
    """Solved poses along a path.

    Attributes:
        position: (A,) where each lies: sample index plus fraction of the way to the next sample.
        x: (A, n) coordinates or (A, 4, 4) poses.
        q: (A, nq) configurations; the last reached one where ``valid`` is false.
        gamma: (A, nv, n) velocities per unit of each independent velocity.
        valid: (A,) whether the anchor was reached along the branch.
    """

    position: Array
    x: Array
    q: Array
    gamma: Array
    valid: BoolArray


def follow(
    system: ConstraintSystem,
    x: Array,
    start: Array,
    slope: Array | None = None,
    *,
    resume: bool = False,
    every_sample: bool = False,
) -> Anchors:
    """Solve anchors along a path from a configuration closed at its first pose.

    Args:
        system: closures and platform rows.
        x: (N, n) coordinates or (N, 4, 4) poses.
        start: (nq,) closed configuration at ``x[0]``.
        slope: (nv, n) Γ there, for a start at which K is singular.
        resume: where the branch ends or leaves the robot's working mode, go on at the next pose that closes in it;
            without it the mode is not looked at, and the anchors after the end of the branch are left invalid.
        every_sample: lay an anchor on every sample.
    """
    position, poses = _lay_anchors(system, x, every_sample)
    count = len(position)
    q = np.tile(start, (count, 1))
    gamma = np.zeros((count, system.robot.model.nv, system.robot.n))
    valid = np.zeros(count, dtype=bool)
    side = np.zeros((count, len(loops(system))))
    if slope is None:
        state = system.evaluate(start[None])
        slope, side[0] = project(system, state).gamma[0], determinants(system, state.K)[0][0]
    if np.isfinite(slope).all():  # a start at a type I singularity has no slope to follow
        gamma[0], valid[0] = slope, True
    last, batch, following = 0, _LARGEST_BATCH, 1
    mode = np.array(system.robot.working_mode, dtype=float) if resume else None
    regular = Point(poses[0], q[0], gamma[0], side[0])
    while following < count:
        stop = min(following + batch, count)
        here = Point(poses[last], q[last], gamma[last], side[last])
        regular = here if np.all(here.side) else regular
        new = _advance(system, here, poses[following:stop], mode)
        if not new and stop - following > 1:
            batch = max(1, batch // 4)
            continue
        if not new:
            halved = _point_at_rank_loss(system, here, poses[following])
            if halved is None and mode is not None:
                beyond = _advance(system, here, poses[following : following + 1], None)
                # a path that starts at a rank loss starts between two modes
                if beyond and (not np.all(regular.side) or crosses(system, regular, beyond[0])):
                    halved, mode = beyond[0], np.sign(mode_indicator(system.robot, beyond[0].q[None])[0])
            if halved is None:
                halved = _advance_by_halving(system, here, poses[following], mode)
            if halved is None:
                behind = reacquire(system, poses[following:], q[last]) if resume else None
                if behind is None:
                    q[following:] = q[last]
                    break
                skipped, halved = behind
                mode = np.array(system.robot.working_mode, dtype=float)
                q[following : following + skipped] = q[last]
                following += skipped
            new = [halved]
        reached = following + len(new)
        for part, values in zip((q, gamma, side), list(zip(*new, strict=True))[1:], strict=True):
            part[following:reached] = values
        valid[following:reached] = True
        last, following = reached - 1, reached
        batch = min(2 * batch, _LARGEST_BATCH) if reached == stop else max(1, batch // 2)
    return Anchors(position, poses, q, gamma, valid)


def initial_guess(system: ConstraintSystem, x: Array, anchors: Anchors) -> Array:
    """Return (N, nq) guesses for all samples from their anchors: cubic along the chord, linear off it.

    Where the branch turns too fast for that between two anchors (next to a type I singularity), it is followed again
    from sample to sample.
    """
    if len(anchors.position) == 1:
        return np.repeat(anchors.q, len(x), axis=0)
    samples = np.arange(len(x), dtype=float)
    left = np.clip(np.searchsorted(anchors.position, samples, side="right") - 1, 0, len(anchors.position) - 2)
    guess = np.empty((len(x), system.robot.model.nq))
    for part in blocks(len(x)):
        guess[part] = _between_anchors(system, x[part], anchors, left[part])
    smooth = continuous(system, anchors.q, anchors.gamma, anchors.x)
    smooth |= ~(anchors.valid[1:] & anchors.valid[:-1])
    for rough in np.unique(left[~smooth[left] & (samples > anchors.position[left])]):
        between = np.flatnonzero((left == rough) & (samples > anchors.position[rough]))
        path = np.concatenate([anchors.x[rough, None], x[between]])
        again = follow(system, path, anchors.q[rough], anchors.gamma[rough], every_sample=True)
        guess[between] = again.q[np.isin(again.position, np.arange(1, len(between) + 1))]
    return guess


def _between_anchors(system: ConstraintSystem, x: Array, anchors: Anchors, left: IntArray) -> Array:
    """Return (N, nq) guesses for samples beside the anchors number ``left``."""
    robot, model = system.robot, system.robot.model
    right, unit = left + 1, row_scale(robot)
    chord = difference(robot, anchors.x[right], anchors.x[left])
    here = difference(robot, x, anchors.x[left])
    length = np.maximum(((chord * unit) ** 2).sum(axis=1), np.finfo(float).tiny)
    u = np.clip((here * chord * unit**2).sum(axis=1) / length, 0.0, 1.0)[:, None]
    slope_left = np.einsum("nvi,ni->nv", anchors.gamma[left], chord)
    slope_right = np.einsum("nvi,ni->nv", anchors.gamma[right], chord)
    across = np.einsum("nvi,ni->nv", anchors.gamma[left], here - u * chord)
    span = configuration_difference(model, anchors.q[left], anchors.q[right])
    both = anchors.valid[left] & anchors.valid[right]
    step = np.where(both[:, None], _cubic(u, span, slope_left, slope_right) + across, 0.0)
    # where the branch is found again behind a gap, the far side of the gap is no evidence
    base = np.where(~anchors.valid[left] & anchors.valid[right], right, left)
    return integrate(model, anchors.q[base], step)


def _cubic(u: Array, span: Array, slope_left: Array, slope_right: Array) -> Array:
    """Return Hermite's cubic from 0 at u = 0 to ``span`` at u = 1."""
    result: Array = u * u * (3 - 2 * u) * span + u * (1 - u) ** 2 * slope_left - u * u * (1 - u) * slope_right
    return result


def continuous(system: ConstraintSystem, q: Array, gamma: Array, x: Array) -> BoolArray:
    """Return (N − 1,) whether each configuration continues the branch of the one before it.

    The change of q is compared with the trapezoidal rule over Γ and the change of x.
    """
    step = configuration_difference(system.robot.model, q[:-1], q[1:])
    return follows(system, step, gamma[:-1], gamma[1:], difference(system.robot, x[1:], x[:-1]))


def follows(
    system: ConstraintSystem, step: Array, gamma0: Array, gamma1: Array, increment: Array, part: float = CONTINUITY
) -> BoolArray:
    """Return (N,) whether steps (N, nv) of q are what Γ at both ends (N, nv, n) says of increments (N, n) of x."""
    unit = velocity_unit(system.robot)
    predicted = np.einsum("nvi,ni->nv", 0.5 * (gamma0 + gamma1), increment) / unit
    allowed = part * np.abs(predicted).max(axis=1, initial=0.0) + ROUNDING
    result: BoolArray = np.abs(step / unit - predicted).max(axis=1, initial=0.0) <= allowed
    return result


def _lay_anchors(system: ConstraintSystem, x: Array, every_sample: bool) -> tuple[Array, Array]:
    robot = system.robot
    if len(x) == 1:
        return np.zeros(1), x
    increments = difference(robot, x[1:], x[:-1])
    lengths = np.linalg.norm(increments / coordinate_unit(robot), axis=1) / ANCHOR_SPACING
    # a path of many thousand machine sizes is out of reach somewhere, and that is found with long steps too
    lengths /= max(1.0, float(lengths.sum()) / _MOST_ANCHORS)
    pieces = np.maximum(np.ceil(lengths), 1).astype(np.intp)
    bins = np.floor(np.concatenate([[0.0], np.cumsum(lengths)]))
    chosen = np.concatenate([[True], (np.diff(bins) > 0) | every_sample])
    chosen[-1] = True
    sparse = pieces > 1
    chosen[:-1] |= sparse
    chosen[1:] |= sparse
    base = np.repeat(np.arange(len(pieces)), np.where(sparse, pieces - 1, 0))
    order = np.arange(len(base)) - np.searchsorted(base, base, side="left") + 1  # 1, 2, ... within each step
    fraction = order / pieces[base]
    between = moved(robot, x[base], increments[base] * fraction[:, None])
    position = np.concatenate([np.flatnonzero(chosen).astype(float), base + fraction])
    poses = np.concatenate([x[chosen], between])
    by_position = np.argsort(position, kind="stable")
    return position[by_position], poses[by_position]


def _advance(
    system: ConstraintSystem, here: Point, targets: Array, mode: Array | None, *, guarded: bool = True
) -> list[Point]:
    """Solve a batch of poses from one solved pose; return those before the first that leaves the branch, or a mode.

    ``mode`` (legs,) are signs to keep, None for any. Where the sign of a loop's determinant changes, branches cross or
    a jump from one to another beside it (two that all but touch) looks like it: ``crosses`` tells. Where it comes to
    zero and keeps its sign, the branch has a kink, or turns sharply: shorter steps tell.
    """
    robot = system.robot
    step = difference(robot, targets, np.repeat(here.x[None], len(targets), axis=0)) @ here.gamma.T
    guess = integrate(robot.model, np.repeat(here.q[None], len(targets), axis=0), step)
    solution = assemble(system, guess, targets, max_iterations=10, shortest_step=_SHORTEST_STEP)
    q = np.concatenate([here.q[None], solution.q])
    gamma = np.concatenate([here.gamma[None], solution.gamma])
    x = np.concatenate([here.x[None], targets])
    increment = difference(robot, x[1:], x[:-1])
    good = follows(system, configuration_difference(robot.model, q[:-1], q[1:]), gamma[:-1], gamma[1:], increment)
    good &= solution.regular
    if mode is not None:
        good &= (np.sign(mode_indicator(robot, solution.q)) == mode).all(axis=1)
    side, log = determinants(system, solution.state.K)
    points = [here, *map(Point, targets, solution.q, solution.gamma, side)]
    if guarded:
        changed = np.concatenate([side[:1] * here.side, side[1:] * side[:-1]]) < 0.0
        good &= ~(_comes_to_zero(system, q, gamma, increment, log, good) & ~changed).any(axis=1)
        for k in np.flatnonzero(changed.any(axis=1)):
            good[k] = good[: k + 1].all() and crosses(system, points[k], points[k + 1])
    return points[1:] if good.all() else points[1 : int(np.argmin(good)) + 1]


def _comes_to_zero(
    system: ConstraintSystem, q: Array, gamma: Array, increment: Array, log: Array, steps: BoolArray
) -> BoolArray:
    """Return (N, B) which determinants come to zero within N steps, as far as their slopes at both ends tell.

    q (N + 1, nq) and Γ (N + 1, nv, n) are those at the ends of the steps, ``increment`` (N, n) of the coordinates, and
    ``log`` (N, B) the logarithms at the ends alone. Only ``steps`` (N,) are looked at, and of these only such along
    which Γ changes.
    """
    result = np.zeros((len(increment), len(loops(system))), dtype=bool)
    bent, straight = (
        np.abs(np.einsum("nvi,ni->nv", part, increment) / velocity_unit(system.robot)).max(axis=1, initial=0.0)
        for part in (gamma[1:] - gamma[:-1], 0.5 * (gamma[1:] + gamma[:-1]))
    )
    k = np.flatnonzero(steps & (bent > _SAME_TANGENT * straight))
    if not len(k):
        return result
    ahead, back = (_SLOPE_STEP * np.einsum("nvi,ni->nv", gamma[ends], increment[k]) for ends in (k, k + 1))
    places = np.concatenate([q[k], q[k + 1], q[:1]])
    beside = integrate(system.robot.model, places, np.concatenate([ahead, -back, np.zeros_like(ahead[:1])]))
    _, inside = determinants(system, system.evaluate(beside).K)
    at_ends = np.concatenate([inside[-1:], log])
    with np.errstate(invalid="ignore"):  # zero, and zero beside it
        lost = -np.expm1(inside[:-1] - np.concatenate([at_ends[k], at_ends[k + 1]]))
    result[k] = (lost.reshape(2, len(k), -1) > _TOWARDS * _SLOPE_STEP).all(axis=0)
    return result


def _advance_by_halving(system: ConstraintSystem, here: Point, target: Array, mode: Array | None) -> Point | None:
    """Reach one pose by shorter and shorter steps; None when even the shortest loses the branch."""
    robot = system.robot
    if not assemble(system, here.q[None], target[None]).closed[0]:
        return None  # out of reach: halving would only creep up to the border
    whole = difference(robot, target[None], here.x[None])
    start, done, size = here.x, 0.0, 0.5
    while done < 1.0:
        size = min(size, 1.0 - done)
        nearer = moved(robot, start[None], whole * (done + size)) if done + size < 1.0 else target[None]
        reached = _advance(system, here, nearer, mode)
        if reached:
            done += size
            here, size = reached[0], 2.0 * size
        else:
            size /= 2.0
            if size < 2.0**-_DEEPEST_HALVING:
                return None
    return here


class PosesAtRankLoss(NamedTuple):
    """M poses at a rank loss: q (M, nq), Γ (M, nv, n), v and a (M, nv), closure residual (M,), m."""

    q: Array
    gamma: Array
    v: Array
    a: Array
    gap: Array


@lru_cache(maxsize=64)
def closed_around(system: ConstraintSystem) -> Assembly:
    """Return the reference configuration and some around it, the chains closed again where Newton's method can.

    Half of them are off any way, half along the branch: beside a pose where several loops are flat, Newton's method
    closes the former to flat poses again.
    """
    model, q, rng = system.robot.model, np.array(system.robot.q_reference), np.random.default_rng(0)
    unit = velocity_unit(system.robot)
    steps = rng.normal(0.0, _AROUND, (1 + _SOME, model.nv)) * unit
    steps[0] = 0.0
    home = assemble(system, q[None], max_iterations=0)
    if home.closed[0] and home.projection.margin[0] > 0.0:
        along = (rng.normal(size=(_SOME, system.robot.n)) * coordinate_unit(system.robot)) @ home.gamma[0].T
        farthest = np.abs(along / unit).max(axis=1, keepdims=True)
        steps = np.concatenate([steps, 2.0 * _AROUND * along / np.where(farthest > 0.0, farthest, 1.0)])
    return assemble(system, integrate(model, np.repeat(q[None], len(steps), axis=0), steps))


@lru_cache(maxsize=64)
def loops(system: ConstraintSystem) -> tuple[tuple[IntArray, IntArray], ...]:
    """Return rows and columns of the B diagonal blocks to which K can be permuted, each that of a loop or a leg.

    det K is the product of theirs but for a sign, and they lose rank each by itself: two that change sign in one step
    leave that of det K. Columns j and k are of one block where K⁻¹ K, which is one, comes about by entries that lead
    from j to k and back.
    """
    model, rng = system.robot.model, np.random.default_rng(0)
    # entries that are zero here, with open chains, are zero everywhere
    any_way = rng.normal(0.0, _AROUND, (2, model.nv)) * velocity_unit(system.robot)
    start = np.repeat(np.array(system.robot.q_reference)[None], 2, axis=0)
    rows = system.relative(system.evaluate(integrate(model, start, any_way)).K)
    inverse = inverses(rows)
    solves, has = (
        (np.abs(part) > _NO_ENTRY * np.abs(part).max(axis=(1, 2), keepdims=True)).any(axis=0)
        for part in (inverse, rows)
    )
    leads = solves.astype(np.float64) @ has > 0.0
    together = (leads & leads.T) | np.eye(len(leads), dtype=bool)
    blocks, size = [], len(system.pose_columns)
    for k in range(size):
        columns = np.flatnonzero(together[k])
        if columns[0] == k:
            blocks.append((np.flatnonzero((solves[columns] & has[:, columns].T).any(axis=0)), columns))
    if any(len(own) != len(columns) for own, columns in blocks):
        return ((np.arange(size), np.arange(size)),)
    return tuple(blocks)


def determinants(system: ConstraintSystem, K: Array) -> tuple[Array, Array]:
    """Return signs and logarithms (N, B) of the determinants of each loop's block of K (N, r + n, p)."""
    parts = [np.linalg.slogdet(K[:, own[:, None], columns]) for own, columns in loops(system)]
    sign, log = (np.stack(values, axis=1) for values in zip(*parts, strict=True))
    return sign, log


def near_rank_loss(system: ConstraintSystem) -> float:
    """Return the margin below which a pose counts as near a rank loss: less for robots of small ones."""
    return min(NEAR_RANK_LOSS, _USUAL_PART * usual_margin(system))


@lru_cache(maxsize=64)
def usual_margin(system: ConstraintSystem) -> float:
    """Return the largest margin of the reference and of some configurations around it; one where they have none.

    A rank loss is left behind by all but every change, small margins throughout are not.
    """
    around = closed_around(system)
    return float(around.projection.margin.max(where=around.closed, initial=0.0)) or 1.0


def through_rank_loss(
    system: ConstraintSystem, here: Point, x: Array, xd: Array, xdd: Array, along: Array | None = None
) -> PosesAtRankLoss | None:
    """Return neighbouring poses at or beside a rank loss of the closures, on the branch of a point.

    q, Γ and the rates are interpolated, with an error O(h⁸), between eight nodes on a line through the poses, four on
    each side. A node is an ordinary pose, h and more away from the rank loss, and the branch is followed to it; across,
    by the continuity of the tangent. The answer is verified: it closes, and K Γ = (0, 1).

    Args:
        system: closures and platform rows.
        here: a point of the branch.
        x: (M, n) coordinates or (M, 4, 4) poses, within a node spacing of one another.
        xd: (M, n) their rates.
        xdd: (M, n) and rates of these.
        along: (n,) direction of the line; when left out that from the point to the poses, or, where that goes along a
            rank loss, one coordinate's, or that of all.

    Returns:
        None where the branch does not go on smoothly (a leg at full stretch: a fold).
    """
    robot, unit = system.robot, coordinate_unit(system.robot)
    centre = x[len(x) // 2]
    chord = difference(robot, centre[None], here.x[None])[0]
    # away from the rank losses of several loops that do not move together lead only all coordinates at once
    directions = (chord, *np.eye(robot.n), unit) if along is None else (along,)
    for direction in directions:
        size = float(np.linalg.norm(direction / unit))
        for spacing in _NODE_SPACINGS if size > 0.0 else ():
            line = _line(system, here, centre, direction / size * spacing)
            result = None if line is None else _interpolated(system, line, x, xd, xdd)
            if result is not None:
                return result
    return None


def crosses(system: ConstraintSystem, before: Point, after: Point) -> bool:
    """Return whether a rank loss that the branch goes smoothly through lies between two neighbouring points of it.

    A loop's determinant changes its sign there, and so may the indicator of a working mode: the legs do not change
    over, the branch leads from one mode to the other. Where several loops do so, the branch has to go smoothly through
    the rank loss of each.
    """
    chord = difference(system.robot, after.x[None], before.x[None])
    sign, log = determinants(system, system.evaluate(np.stack([before.q, after.q])).K)
    largest = log.max(axis=0)
    size = np.exp(log - np.where(np.isfinite(largest), largest, 0.0))
    lost = np.flatnonzero((sign[0] * sign[1] <= 0.0) | (size.min(axis=0) <= ROUNDING))
    if not len(lost) or not np.isfinite(largest[lost]).all():
        return False
    still = np.zeros_like(chord)
    for loop in lost:
        root = moved(system.robot, before.x[None], chord * (size[0, loop] / size[:, loop].sum()))
        beyond = through_rank_loss(system, before, root, still, still, chord[0])
        if beyond is None:
            return False
        # all but linear on a branch that goes through zero; on one that keeps its side nothing vanishes there
        there = determinants(system, system.evaluate(beyond.q).K)[1][0, loop]
        if not there - largest[loop] < np.log(CONTINUITY):
            return False
    return True


def _point_at_rank_loss(system: ConstraintSystem, here: Point, target: Array) -> Point | None:
    """Return the point at a target where the closures lose rank; None where they do not, or no branch goes through."""
    step = here.gamma @ difference(system.robot, target[None], here.x[None])[0]
    guess = system.evaluate(integrate(system.robot.model, here.q[None], step[None]))
    near = near_rank_loss(system)
    if project(system, guess).margin[0] > 10.0 * near:
        return None
    solution = assemble(system, guess.q, target[None])
    if solution.closed[0] and solution.projection.margin[0] > near:
        return None
    still = np.zeros((1, system.robot.n))
    result = through_rank_loss(system, here, target[None], still, still)
    return None if result is None else Point(target, result.q[0], result.gamma[0])


class _Line(NamedTuple):
    """Nodes of an interpolation: centre of the line, step from node to node (n,), x (8, n), q (8, nq), Γ (8, nv, n)."""

    centre: Array
    step: Array
    x: Array
    q: Array
    gamma: Array


def _line(system: ConstraintSystem, here: Point, centre: Array, step: Array, *, recentre: bool = True) -> _Line | None:
    """Solve nodes on both sides of a pose, on the branch of a point; None where it does not lead to all of them."""
    robot, model = system.robot, system.robot.model
    x = moved(robot, np.repeat(centre[None], len(_NODES), axis=0), _NODES[:, None] * step)
    near = _advance(system, here, x[:1], None, guarded=False)  # it is for guards that lines are made
    if not near:
        return None
    first = near[0]
    whole = (_NODES[-1] - _NODES[0]) * step
    guess = integrate(model, first.q[None], (first.gamma @ whole)[None])
    across = assemble(system, guess, x[-1:], max_iterations=10, shortest_step=_SHORTEST_STEP)
    if not across.regular[0]:
        return None
    span = configuration_difference(model, first.q[None], across.q)
    if not follows(system, span, first.gamma[None], across.gamma, whole[None], _SAME_TANGENT)[0]:
        return None
    sign, log = determinants(system, system.evaluate(np.stack([first.q, across.q[0]])).K)
    lost = sign[0] * sign[1] < 0.0
    if recentre and lost.any():
        # of a determinant, all but linear between the two
        root = _NODES[0] + (_NODES[-1] - _NODES[0]) / (1.0 + np.exp(np.minimum(log[1, lost] - log[0, lost], 100.0)))
        shifts = np.append(root[np.abs(root) < _SHIFTS[-1]], _SHIFTS)
        away = np.abs(_NODES[:, None] - (root - shifts[:, None])[:, None]).min(axis=(1, 2))
        shift = shifts[int(away.argmax())]
        return _line(system, first, moved(robot, centre[None], (shift * step)[None])[0], step, recentre=False)
    u = ((_NODES[1:-1] - _NODES[0]) / (_NODES[-1] - _NODES[0]))[:, None]
    between = _cubic(u, span, first.gamma @ whole, across.gamma[0] @ whole)
    inner = assemble(system, integrate(model, np.repeat(first.q[None], len(u), axis=0), between), x[1:-1])
    apart = configuration_difference(model, np.repeat(first.q[None], len(u), axis=0), inner.q) - between
    unit = velocity_unit(robot)
    if not inner.regular.all() or np.abs(apart / unit).max() > _SAME_TANGENT * np.abs(span / unit).max() / len(_NODES):
        return None
    q = np.concatenate([first.q[None], inner.q, across.q])
    return _Line(centre, step, x, q, np.concatenate([first.gamma[None], inner.gamma, across.gamma]))


def _interpolated(system: ConstraintSystem, line: _Line, x: Array, xd: Array, xdd: Array) -> PosesAtRankLoss | None:
    robot, model, count = system.robot, system.robot.model, len(_NODES)
    unit = coordinate_unit(robot) ** -2.0
    away = difference(robot, x, np.repeat(line.centre[None], len(x), axis=0))
    u = (away * line.step * unit).sum(axis=1) / (line.step**2 * unit).sum()
    if np.abs(u).max() > _NODES[-1] / 2.0:
        return None
    others = _NODES[None, :] - _NODES[:, None] + np.eye(count)
    factors = np.where(np.eye(count, dtype=bool), 1.0, (u[:, None, None] - _NODES) / -others)
    weights = factors.prod(axis=2)  # Lagrange's, (M, 8)
    # each pose has its own nodes: the line, moved sideways through the pose
    aside = np.repeat(away - u[:, None] * line.step, count, axis=0)
    places = moved(robot, np.tile(line.x, (len(x), *(1,) * (line.x.ndim - 1))), aside)
    start = integrate(
        model, np.tile(line.q, (len(x), 1)), np.einsum("nvi,ni->nv", np.tile(line.gamma, (len(x), 1, 1)), aside)
    )
    nodes = assemble(system, start, places)
    if not nodes.closed.all() or nodes.projection.margin.min() <= _CLEAR * near_rank_loss(system):
        return None
    v, a = rates(system, nodes.state, nodes.projection, np.repeat(xd, count, axis=0), np.repeat(xdd, count, axis=0))

    def at_poses(values: Array) -> Array:
        result: Array = np.einsum("mj,mj...->m...", weights, values.reshape(len(x), count, *values.shape[1:]))
        return result

    base = np.repeat(nodes.q.reshape(len(x), count, -1)[:, count // 2], count, axis=0)
    q = integrate(model, base[::count], at_poses(configuration_difference(model, base, nodes.q)))
    gamma, state = at_poses(nodes.gamma), system.evaluate(q)
    residual = np.concatenate([state.phi, difference(robot, x, coordinates(robot, state))], axis=1)
    gap = system.gap(residual)
    relative = gamma[:, system.pose_columns] * (coordinate_unit(robot) / system.step_unit[:, None])
    product = np.einsum("nrv,nvi->nri", system.relative(state.K), relative)
    product[:, len(system.rows) :] -= np.eye(robot.n)
    if gap.max() > closure_tolerance(robot) or np.abs(product).max() > _CARRIED * (1.0 + np.abs(relative).max()):
        return None
    return PosesAtRankLoss(q, gamma, at_poses(v), at_poses(a), gap)


def reacquire(system: ConstraintSystem, targets: Array, q: Array) -> tuple[int, Point] | None:
    """Return the first pose that closes in the working mode, from a configuration (nq,) and from the reference.

    Where the chains close earlier, but in another mode, multistart looks for the mode at that pose. None when no pose
    closes.
    """
    start, count = 0, _LARGEST_BATCH
    while start < len(targets):
        first = _reacquire_within(system, targets[start : start + count], q)
        if first is not None:
            return start + first[0], first[1]
        start, count = start + count, 2 * count
    return None


def _reacquire_within(system: ConstraintSystem, targets: Array, q: Array) -> tuple[int, Point] | None:
    best: tuple[int, Point] | None = None
    earliest = len(targets)
    for guess in (q, np.array(system.robot.q_reference)):
        starts = np.repeat(guess[None], len(targets), axis=0)
        solution = assemble(system, starts, targets, shortest_step=_SHORTEST_STEP)
        if solution.regular.any():
            earliest = min(earliest, int(np.argmax(solution.regular)))
        k = int(np.argmax(solution.usable))
        if solution.usable[k] and (best is None or k < best[0]):
            best = k, Point(targets[k], solution.q[k], solution.gamma[k])
    if earliest < (best[0] if best else len(targets)):
        solved = multistart(system, q, targets[earliest])
        slope = project(system, system.evaluate(solved.q[None])).gamma[0]
        if solved.in_mode and np.isfinite(slope).all():
            best = earliest, Point(targets[earliest], solved.q, slope)
    return best
