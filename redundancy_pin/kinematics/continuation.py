"""Follow a branch: configurations along a sequence of poses, each reached continuously from the one before.

Anchors are laid along the path no further apart than a fraction of the robot's size (poses in between are made where
the samples are sparser, samples are passed over where they are denser). They are solved in batches that start from the
last solved anchor and shrink where the branch turns fast. The samples then start from an interpolation between their
anchors, so that a long, dense trajectory costs a few batched Newton steps and no loop over samples.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.kinematics.assembly import assemble, configuration_difference, integrate, project
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import difference, moved, row_scale
from redundancy_pin.kinematics.inverse_kinematics import multistart

ANCHOR_SPACING = 0.04
"""Distance of anchors along the path, in characteristic lengths."""

_LARGEST_BATCH = 32
_DEEPEST_HALVING = 22
"""Halvings of a step before the branch counts as lost. Towards a stretched leg every step covers a part of the way that
is left: this many come within 1e-9 characteristic lengths of it."""
_SHORTEST_STEP = 2.0**-3
"""Where Newton needs shorter steps than this the pose is approached in smaller steps instead."""
_CONTINUITY = 0.25
"""Largest part of a step that its trapezoidal prediction may miss before the branch counts as lost; the step is halved
first, which shrinks a smooth error eightfold and a jump not at all."""
_ROUNDING = 1e-7
"""Changes of q below this (rad, m) are rounding of the closure solution between all but equal poses."""
_MOST_ANCHORS = 20_000
"""Anchors laid along one path beyond one a sample: eight hundred characteristic lengths of path."""


class Point(NamedTuple):
    """One solved pose: coordinates (n,) or a pose (4, 4), configuration (nq,) and Γ (nv, n)."""

    x: Array
    q: Array
    gamma: Array


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
    system: ConstraintSystem, x: Array, start: Array, *, resume: bool = False, every_sample: bool = False
) -> Anchors:
    """Solve anchors along a path from a configuration closed at its first pose.

    Args:
        system: closures and platform rows.
        x: (N, n) coordinates or (N, 4, 4) poses.
        start: (nq,) closed configuration at ``x[0]``.
        resume: where the branch ends or leaves the robot's working mode, go on at the next pose that closes in it;
            without it the mode is not looked at, and the anchors after the end of the branch are left invalid.
        every_sample: lay an anchor on every sample.
    """
    position, poses = _lay_anchors(system, x, every_sample)
    count = len(position)
    q = np.tile(start, (count, 1))
    gamma = np.zeros((count, system.robot.model.nv, system.robot.n))
    valid = np.zeros(count, dtype=bool)
    slope = project(system, system.evaluate(start[None])).gamma[0]
    if np.isfinite(slope).all():  # a start at a type I singularity has no slope to follow
        gamma[0], valid[0] = slope, True
    last, batch, following = 0, _LARGEST_BATCH, 1
    while following < count:
        stop = min(following + batch, count)
        here = Point(poses[last], q[last], gamma[last])
        new = _advance(system, here, poses[following:stop], in_mode=resume)
        if not new and stop - following > 1:
            batch = max(1, batch // 4)
            continue
        if not new:
            halved = _advance_by_halving(system, here, poses[following], in_mode=resume)
            if halved is None:
                behind = reacquire(system, poses[following:], q[last]) if resume else None
                if behind is None:
                    q[following:] = q[last]
                    break
                skipped, halved = behind
                q[following : following + skipped] = q[last]
                following += skipped
            new = [halved]
        reached = following + len(new)
        q[following:reached], gamma[following:reached] = [one.q for one in new], [one.gamma for one in new]
        valid[following:reached] = True
        last, following = reached - 1, reached
        batch = min(2 * batch, _LARGEST_BATCH) if reached == stop else max(1, batch // 2)
    return Anchors(position, poses, q, gamma, valid)


def initial_guess(system: ConstraintSystem, x: Array, anchors: Anchors) -> Array:
    """Return (N, nq) guesses for all samples from their anchors: cubic along the chord, linear off it.

    Where the branch turns too fast for that between two anchors (next to a type I singularity), it is followed again
    from sample to sample.
    """
    samples = np.arange(len(x), dtype=float)
    if len(anchors.position) == 1:
        return np.repeat(anchors.q, len(x), axis=0)
    left = np.clip(np.searchsorted(anchors.position, samples, side="right") - 1, 0, len(anchors.position) - 2)
    right = left + 1
    robot, model = system.robot, system.robot.model
    unit = row_scale(robot)
    chord = difference(robot, anchors.x[right], anchors.x[left])
    here = difference(robot, x, anchors.x[left])
    length = np.maximum(((chord * unit) ** 2).sum(axis=1), np.finfo(float).tiny)
    u = np.clip((here * chord * unit**2).sum(axis=1) / length, 0.0, 1.0)[:, None]
    slope_left = np.einsum("nvi,ni->nv", anchors.gamma[left], chord)
    slope_right = np.einsum("nvi,ni->nv", anchors.gamma[right], chord)
    across = np.einsum("nvi,ni->nv", anchors.gamma[left], here - u * chord)
    span = configuration_difference(model, anchors.q[left], anchors.q[right])
    cubic = u * u * (3 - 2 * u) * span + u * (1 - u) ** 2 * slope_left - u * u * (1 - u) * slope_right
    both = anchors.valid[left] & anchors.valid[right]
    step = np.where(both[:, None], cubic + across, 0.0)
    # where the branch is found again behind a gap, the far side of the gap says nothing
    base = np.where(~anchors.valid[left] & anchors.valid[right], right, left)
    guess = integrate(model, anchors.q[base], step)
    smooth = continuous(system, anchors.q, anchors.gamma, anchors.x)
    for rough in np.unique(left[both & ~smooth[left] & (samples > anchors.position[left])]):
        between = np.flatnonzero((left == rough) & (samples > anchors.position[rough]))
        part = follow(system, np.concatenate([anchors.x[rough, None], x[between]]), anchors.q[rough], every_sample=True)
        guess[between] = part.q[np.isin(part.position, np.arange(1, len(between) + 1))]
    return guess


def continuous(system: ConstraintSystem, q: Array, gamma: Array, x: Array) -> BoolArray:
    """Return (N − 1,) whether each configuration continues the branch of the one before it.

    The change of q is compared with the trapezoidal rule over Γ and the change of x.
    """
    step = configuration_difference(system.robot.model, q[:-1], q[1:])
    return follows(step, gamma[:-1], gamma[1:], difference(system.robot, x[1:], x[:-1]))


def follows(step: Array, gamma0: Array, gamma1: Array, increment: Array) -> BoolArray:
    """Return (N,) whether steps (N, nv) of q are what Γ at both ends (N, nv, n) says of increments (N, n) of x."""
    predicted = np.einsum("nvi,ni->nv", 0.5 * (gamma0 + gamma1), increment)
    allowed = _CONTINUITY * np.abs(predicted).max(axis=1, initial=0.0) + _ROUNDING
    result: BoolArray = np.abs(step - predicted).max(axis=1, initial=0.0) <= allowed
    return result


def _lay_anchors(system: ConstraintSystem, x: Array, every_sample: bool) -> tuple[Array, Array]:
    robot = system.robot
    if len(x) == 1:
        return np.zeros(1), x
    increments = difference(robot, x[1:], x[:-1])
    lengths = np.linalg.norm(increments * row_scale(robot), axis=1) / (ANCHOR_SPACING * robot.characteristic_length)
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


def _advance(system: ConstraintSystem, here: Point, targets: Array, *, in_mode: bool) -> list[Point]:
    """Solve a batch of poses from one solved pose; return those before the first that leaves the branch."""
    robot = system.robot
    step = difference(robot, targets, np.repeat(here.x[None], len(targets), axis=0)) @ here.gamma.T
    guess = integrate(robot.model, np.repeat(here.q[None], len(targets), axis=0), step)
    solution = assemble(system, guess, targets, max_iterations=10, shortest_step=_SHORTEST_STEP)
    q = np.concatenate([here.q[None], solution.q])
    gamma = np.concatenate([here.gamma[None], solution.gamma])
    good = continuous(system, q, gamma, np.concatenate([here.x[None], targets]))
    good &= solution.usable if in_mode else solution.regular
    reached = len(good) if good.all() else int(np.argmin(good))
    return [Point(*point) for point in zip(targets[:reached], solution.q, solution.gamma, strict=False)]


def _advance_by_halving(system: ConstraintSystem, here: Point, target: Array, *, in_mode: bool) -> Point | None:
    """Reach one pose by shorter and shorter steps; None when even the shortest loses the branch."""
    robot = system.robot
    if not assemble(system, here.q[None], target[None]).closed[0]:
        return None  # out of reach: halving would only creep up to the border
    whole = difference(robot, target[None], here.x[None])
    start, done, size = here.x, 0.0, 0.5
    while done < 1.0:
        size = min(size, 1.0 - done)
        nearer = moved(robot, start[None], whole * (done + size)) if done + size < 1.0 else target[None]
        reached = _advance(system, here, nearer, in_mode=in_mode)
        if reached:
            done += size
            here, size = reached[0], 2.0 * size
        else:
            size /= 2.0
            if size < 2.0**-_DEEPEST_HALVING:
                return None
    return here


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
