"""Follow a branch: configurations along a sequence of poses, each reached continuously from the one before.

Anchors are laid along the path no further apart than a fraction of the robot's size (poses in between are made where
the samples are sparser, samples are passed over where they are denser). They are solved in batches that start from the
last solved anchor and shrink where the branch turns fast. The samples then start from an interpolation between their
anchors, so that a long, dense trajectory costs a few batched Newton steps and no loop over samples.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.kinematics.assembly import Assembly, assemble, configuration_difference, integrate
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import difference, moved, row_scale
from redundancy_pin.kinematics.modes import in_working_mode
from redundancy_pin.kinematics.projection import project

ANCHOR_SPACING = 0.04
"""Distance of anchors along the path, in characteristic lengths."""

_LARGEST_BATCH = 32
_DEEPEST_HALVING = 10
_SHORTEST_STEP = 2.0**-3
"""Where Newton needs shorter steps than this the pose is approached in smaller steps instead."""
_CONTINUITY = 0.25
"""Largest part of a step that its trapezoidal prediction may miss before the branch counts as lost; the step is halved
first, which shrinks a smooth error eightfold and a jump not at all."""


@dataclass(frozen=True, eq=False)
class Anchors:
    """Solved poses along a path.

    Attributes:
        position: (A,) where each lies: sample index plus fraction of the way to the next sample.
        q: (A, nq) configurations; the last reached one where ``valid`` is false.
        gamma: (A, nv, n) velocities per unit of each independent velocity.
        valid: (A,) whether the anchor was reached along the branch.
    """

    position: Array
    x: Array
    q: Array
    gamma: Array
    valid: BoolArray


def follow(system: ConstraintSystem, x: Array, start: Array, *, resume: bool = False) -> Anchors:
    """Solve anchors along a path from a configuration closed at its first pose.

    Args:
        system: closures and platform rows.
        x: (N, n) coordinates or (N, 4, 4) poses, base frame.
        start: (nq,) closed configuration at ``x[0]``.
        resume: where the branch ends, go on at the next pose that closes in the robot's working mode; without it the
            anchors after the end of the branch are left invalid.
    """
    position, poses = _lay_anchors(system, x)
    count = len(position)
    q = np.tile(start, (count, 1))
    gamma = np.zeros((count, system.robot.model.nv, system.robot.n))
    valid = np.zeros(count, dtype=bool)
    state = system.evaluate(start[None])
    gamma[0], valid[0] = project(system, state).gamma[0], True
    last, batch = 0, _LARGEST_BATCH
    following = 1
    while following < count:
        stop = min(following + batch, count)
        reached, solved, slopes = _advance(system, poses[last], q[last], gamma[last], poses[following:stop])
        if reached == 0 and stop - following > 1:
            batch = max(1, batch // 4)
            continue
        if reached == 0:
            halved = _halve(system, poses[last], q[last], gamma[last], poses[following])
            if halved is None:
                found = _resume(system, poses[following:], q[last]) if resume else None
                if found is None:
                    q[following:] = q[last]
                    break
                skipped, q_next, gamma_next = found
                q[following : following + skipped] = q[last]
                following += skipped
                halved = q_next, gamma_next
            solved, slopes, reached = halved[0][None], halved[1][None], 1
        here = slice(following, following + reached)
        q[here], gamma[here], valid[here] = solved[:reached], slopes[:reached], True
        last = following + reached - 1
        following = last + 1
        batch = min(2 * batch, _LARGEST_BATCH) if reached == stop - here.start else max(1, batch // 2)
    return Anchors(position, poses, q, gamma, valid)


def initial_guess(system: ConstraintSystem, x: Array, anchors: Anchors) -> Array:
    """Return (N, nq) guesses for all samples from their anchors: cubic along the chord, linear off it."""
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
    both = (anchors.valid[left] & anchors.valid[right])[:, None]
    step = np.where(both, cubic + across, 0.0)
    return integrate(model, anchors.q[left], step)


def continuous(system: ConstraintSystem, q: Array, gamma: Array, x: Array) -> BoolArray:
    """Return (N − 1,) whether each configuration continues the branch of the one before it.

    The change of q is compared with the trapezoidal rule over Γ and the change of x.
    """
    model = system.robot.model
    step = configuration_difference(model, q[:-1], q[1:])
    predicted = np.einsum("nvi,ni->nv", 0.5 * (gamma[:-1] + gamma[1:]), difference(system.robot, x[1:], x[:-1]))
    allowed = _CONTINUITY * np.abs(predicted).max(axis=1, initial=0.0) + _ROUNDING
    result: BoolArray = np.abs(step - predicted).max(axis=1, initial=0.0) <= allowed
    return result


_ROUNDING = 1e-7
"""Changes of q below this (rad, m) are rounding of the closure solution between all but equal poses."""


def _lay_anchors(system: ConstraintSystem, x: Array) -> tuple[Array, Array]:
    robot = system.robot
    if len(x) == 1:
        return np.zeros(1), x
    increments = difference(robot, x[1:], x[:-1])
    lengths = np.linalg.norm(increments * row_scale(robot), axis=1) / (ANCHOR_SPACING * robot.characteristic_length)
    pieces = np.maximum(np.ceil(lengths), 1).astype(np.intp)
    bins = np.floor(np.concatenate([[0.0], np.cumsum(lengths)]))
    chosen = np.concatenate([[True], np.diff(bins) > 0])
    chosen[-1] = True
    sparse = pieces > 1
    chosen[:-1] |= sparse
    chosen[1:] |= sparse
    base = np.repeat(np.arange(len(pieces)), np.where(sparse, pieces - 1, 0))
    order = _running_count(base) + 1
    fraction = order / pieces[base]
    between = moved(robot, x[base], increments[base] * fraction[:, None])
    position = np.concatenate([np.flatnonzero(chosen).astype(float), base + fraction])
    poses = np.concatenate([x[chosen], between])
    by_position = np.argsort(position, kind="stable")
    return position[by_position], poses[by_position]


def _running_count(groups: IntArray) -> IntArray:
    """Return for each entry of a sorted array how many equal entries stand before it."""
    first = np.searchsorted(groups, groups, side="left")
    return np.arange(len(groups)) - first


def _advance(system: ConstraintSystem, x0: Array, q0: Array, gamma0: Array, targets: Array) -> tuple[int, Array, Array]:
    """Solve a batch of poses from one solved pose; return how many of them continue the branch, q and Γ."""
    robot = system.robot
    step = difference(robot, targets, np.repeat(x0[None], len(targets), axis=0)) @ gamma0.T
    guess = integrate(robot.model, np.repeat(q0[None], len(targets), axis=0), step)
    solution: Assembly = assemble(system, guess, targets, max_iterations=10, shortest_step=_SHORTEST_STEP)
    gamma = project(system, solution.state).gamma
    chain = continuous(
        system,
        np.concatenate([q0[None], solution.q]),
        np.concatenate([gamma0[None], gamma]),
        np.concatenate([x0[None], targets]),
    )
    good = chain & solution.closed & np.isfinite(gamma).all(axis=(1, 2))
    reached = len(good) if good.all() else int(np.argmin(good))
    return reached, solution.q, gamma


def _resume(system: ConstraintSystem, targets: Array, q: Array) -> tuple[int, Array, Array] | None:
    """Find the first pose that closes in the working mode, starting from the last good configuration and the reference.

    Returns:
        Its index, its configuration and Γ; None when there is none.
    """
    best: tuple[int, Array, Array] | None = None
    for guess in (q, np.array(system.robot.q_reference)):
        solution = assemble(system, np.repeat(guess[None], len(targets), axis=0), targets)
        gamma = project(system, solution.state).gamma
        good = solution.closed & in_working_mode(system.robot, solution.q) & np.isfinite(gamma).all(axis=(1, 2))
        if good.any() and (best is None or int(np.argmax(good)) < best[0]):
            first = int(np.argmax(good))
            best = first, solution.q[first], gamma[first]
    return best


def _halve(system: ConstraintSystem, x0: Array, q0: Array, gamma0: Array, target: Array) -> tuple[Array, Array] | None:
    """Reach one pose by shorter and shorter steps; None when even the shortest loses the branch."""
    robot = system.robot
    whole = difference(robot, target[None], x0[None])
    done, size = 0.0, 0.5
    x, q, gamma = x0, q0, gamma0
    while done < 1.0:
        size = min(size, 1.0 - done)
        nearer = moved(robot, x0[None], whole * (done + size)) if done + size < 1.0 else target[None]
        reached, solved, slopes = _advance(system, x, q, gamma, nearer)
        if reached:
            done += size
            x, q, gamma, size = nearer[0], solved[0], slopes[0], 2.0 * size
        else:
            size /= 2.0
            if size < 2.0**-_DEEPEST_HALVING:
                return None
    return q, gamma
