"""One step after the other: least squares of a slightly curved function over the box that limits leave.

In one step of length h a carrier takes a new speed v' and moves by h v' (backward differences, Parsa 2014, eqs. 4.3
and 4.4). Say it has the distance g to the end of its track in front of it and can be braked by at most a. It may take
the speed v' if what is left after the step suffices to stop: h v' + v'²/(2a) ≤ g. Braking by a keeps this true: with
v' = max(v − a h, 0) the step is at most (v² − v'²)/(2a). So a carrier that starts inside the set never leaves its
track, whatever the lengths of the steps.

The problem of a step is min ‖r(u)‖² with lower ≤ u ≤ upper.
Gauss–Newton on r, which is a quadratic of u with no mixed terms: r(u + d) = r + J d + C (d ∘ d). Each step is a convex
quadratic programme over the box: without the bounds first, and by DAQP (an active-set solver, so exact) where that
leaves the box. What a step misses is known from the sizes of d, r and C, and decides whether one more is needed. The
problems are tiny and solved by the thousand, so that calls count: lists of floats where they are faster than arrays,
and LAPACK's own Cholesky. Measured with three unknowns, in the same minute: DAQP 40 µs, quadprog 80, pivoting in Python
240, ``scipy.optimize.lsq_linear`` 970.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import add, mul, sub
from typing import TypeAlias

import daqp
import numpy as np
from scipy.linalg.lapack import dposv

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import InfeasiblePlanError, RedundancyPinError
from redundancy_pin.planners.carrier_model import EffortModel
from redundancy_pin.planners.carrier_return import CarrierState
from redundancy_pin.robot import CarrierLimits

_EMPTY = 1e-9
"""A box that is empty by less than this fraction of the accelerations involved is one point: a limit that is met
exactly leaves a rounding error."""


def stoppable_speed(distance: float, step: float, deceleration: float) -> float:
    """Return the largest speed, m/s, from which a carrier can still be stopped before the end of its track.

    It is the root of h v + v²/(2a) = distance, or 0 where the distance, m, is not positive; h is the step, s, and a the
    largest deceleration, m/s², infinite if there is no limit.
    """
    if distance <= 0.0:
        return 0.0
    if not math.isfinite(deceleration) or not math.isfinite(distance):
        return distance / step
    slowed = deceleration * step
    # the rationalised root: the usual one cancels where the distance is small
    return 2.0 * deceleration * distance / (slowed + math.sqrt(slowed * slowed + 2.0 * deceleration * distance))


@dataclass(frozen=True)
class AccelerationBox:
    """What the carriers must keep to at every step.

    ``carriers`` (k,) names; ``limits`` (k,) track, speed, acceleration and force of each; the planner keeps to the
    first three; ``anticipate``: whether a carrier is kept able to stop before the end of its track; ``rest_at``: time
    by which all must be at rest, s; infinite for none.
    """

    carriers: tuple[str, ...]
    limits: tuple[CarrierLimits, ...]
    anticipate: bool
    rest_at: float

    @cached_property
    def _bounds(self) -> tuple[tuple[float, float, float, float], ...]:
        """Plain tuples: they are read at every step."""
        return tuple((limit.lower, limit.upper, limit.speed, limit.acceleration) for limit in self.limits)

    def box(self, t: float, step: float, s: Sequence[float], sd: Sequence[float]) -> tuple[list[float], list[float]]:
        """Return the smallest and largest s̈ of each carrier in a step (Parsa 2014, eqs. 4.2 to 4.4).

        With backward differences ṡ' = ṡ + h s̈ and s' = s + h ṡ' the limits of the track, the speed and the
        acceleration are one box. Two more bounds may narrow it: a carrier must be able to stop before its track ends
        (``anticipate``) and by the time ``rest_at``. Both give way to the largest deceleration, so they never empty it.

        ``t``: time at the end of the step, s; ``step``: length h of the step, s; ``s`` (k,) positions before the step,
        m; ``sd`` (k,) speeds before the step, m/s.
        """
        lower, upper = [], []
        for j, (first, last, fastest, a) in enumerate(self._bounds):
            position, speed = s[j], sd[j]
            reach = a * step
            least, most = max(speed - reach, -fastest), min(speed + reach, fastest)
            behind, ahead = position - first, last - position
            if most * step > ahead:
                most = ahead / step
            if -least * step > behind:
                least = -behind / step
            if self.anticipate:
                if most > 0.0 and (step + 0.5 * most / a) * most > ahead:
                    most = min(most, max(stoppable_speed(ahead, step, a), speed - reach))
                if least < 0.0 and (step - 0.5 * least / a) * -least > behind:
                    least = max(least, min(-stoppable_speed(behind, step, a), speed + reach))
            if self.rest_at < math.inf:
                left = a * max(self.rest_at - t, 0.0)
                most = min(most, max(left, speed - reach))
                least = max(least, min(-left, speed + reach))
            low, high = max((least - speed) / step, -a), min((most - speed) / step, a)
            if low > high:
                low = high = self._single(j, t, step, position, speed, low, high)
            lower.append(low)
            upper.append(high)
        return lower, upper

    def _single(self, j: int, t: float, step: float, s: float, sd: float, lower: float, upper: float) -> float:
        """Return the one acceleration left where rounding emptied the box."""
        bounds = self.limits[j]
        if lower - upper <= _EMPTY * (abs(lower) + abs(upper)):
            return min(max(0.5 * (lower + upper), -bounds.acceleration), bounds.acceleration)
        a = bounds.acceleration
        braked = sd - math.copysign(min(abs(sd), a * step), sd)
        reached = s + step * braked
        beyond = max(reached - bounds.upper, bounds.lower - reached)
        excess = abs(braked) - bounds.speed
        if beyond > excess:
            what, amount, unit = "track", float(beyond), "m"
            text = f"braked by {a:g} m/s² it would still be {beyond:.3g} m beyond the end of its track"
        else:
            what, amount, unit = "speed", float(excess), "m/s"
            text = f"braked by {a:g} m/s² it would still be {excess:.3g} m/s above its speed limit"
        message = (
            f"{self.carriers[j]} cannot keep its limits at t = {t:.6g} s: it arrives at s = {s:.6g} m with "
            f"{sd:.6g} m/s, and {text}."
        )
        remedy = "Use anticipate=True, a larger lam, higher limits, or a gentler motion."
        raise InfeasiblePlanError(
            message, remedy=remedy, constraint=what, carrier=self.carriers[j], time=t, amount=amount, unit=unit
        )


Linearised: TypeAlias = Callable[[list[float]], Array]
"""From u, k numbers, to [J r] (m, k + 1), J = ∂r/∂u."""

MOST_ITERATIONS = 50
"""One or two are usual. The curvature would have to match the slope for it to take ten."""

_DAMPING = 1e-13
"""Relative to the squared slope, to which it is added. It changes the rate at which the minimum is reached, not the
minimum, and makes a component that r does not feel stay where it is."""

_TOLERANCES = {"primal_tol": 1e-11, "dual_tol": 1e-13}
"""Of DAQP: m/s², and the gradient divided by the squared slope."""

_NO_ROWS = np.empty((0, 64))
"""DAQP's matrix of constraints other than bounds."""


def minimise(
    linearised: Linearised,
    lower: list[float],
    upper: list[float],
    start: list[float],
    *,
    slope: float,
    curvature: float,
    damping: Array,
    tolerance: float,
) -> tuple[list[float], int]:
    """Return the minimum of ‖r(u)‖² over lower ≤ u ≤ upper.

    ``linearised``: J and, as its last column, r at a point; ``lower``: k lower bounds; −inf for none; ``upper``: k
    upper bounds, not below the lower ones; ``start``: k numbers, a guess, inside the box or not; ``damping`` (k, k)
    added to JᵀJ, see ``damping_of``; ``tolerance``: how far the gradient at the result may be from that of a minimum,
    divided by the slope; in the unit of r.

    Returns:
        The minimum, k numbers, and the number of Gauss–Newton steps it took.
    """
    u, k = start, len(start)
    for iteration in range(1, MOST_ITERATIONS + 1):
        both = linearised(u)
        squared = both.T.dot(both)
        hessian, gradient = squared[:k, :k] + damping, squared[:k, k]
        step = [-d for d in dposv(hessian, gradient)[1].tolist()]
        reached = list(map(add, u, step))
        if _outside(reached, lower, upper):
            reached = _within(hessian / slope**2, gradient / slope**2, u, lower, upper)
            step = list(map(sub, reached, u))
        u = reached
        largest, remains = max(map(abs, step)), math.sqrt(squared.item(k, k))
        if curvature * largest * (largest + 2.0 * remains / slope) <= tolerance:
            return u, iteration
    raise RedundancyPinError(
        f"The least-squares problem of one step did not converge in {MOST_ITERATIONS} iterations.",
        remedy="Use a smaller time step: the effort is then closer to affine in the carriers' acceleration.",
        iterations=MOST_ITERATIONS,
    )


def damping_of(k: int, slope: float) -> Array:
    """Return the (k, k) damping of ``minimise`` for slopes of a given size."""
    return _DAMPING * slope * slope * np.eye(k)


def _outside(values: list[float], lower: list[float], upper: list[float]) -> bool:
    for value, low, high in zip(values, lower, upper):  # noqa: B905, SIM110 (strict or a generator costs time here)
        if not low <= value <= high:
            return True
    return False


def _within(hessian: Array, gradient: Array, u: list[float], lower: list[float], upper: list[float]) -> list[float]:
    """Return the minimum over the box of ½ dᵀ H d + gᵀ d, d the distance from u."""
    here = np.array(u)
    d, _, flag, info = daqp.solve(
        hessian, gradient, _NO_ROWS[:, : len(u)], np.array(upper) - here, np.array(lower) - here, **_TOLERANCES
    )
    if flag < 1:
        return _within_by_least_squares(hessian, gradient, here, lower, upper, flag)
    # a bound with a multiplier is met bit by bit, not up to the rounding of a difference
    sides = zip((here + d).tolist(), info["lam"].tolist(), lower, upper, strict=True)
    return [b if force > 0.0 else a if force < 0.0 else min(max(x, a), b) for x, force, a, b in sides]


def _within_by_least_squares(
    hessian: Array, gradient: Array, here: Array, lower: list[float], upper: list[float], flag: int
) -> list[float]:
    """Return the same minimum where DAQP calls a box infeasible, as it does of Hessians of condition 1e12."""
    from scipy.optimize import lsq_linear

    try:
        root = np.linalg.cholesky(hessian).T
    except np.linalg.LinAlgError:
        root = np.full_like(hessian, np.nan)
    if not (np.isfinite(root).all() and np.isfinite(gradient).all()):
        raise RedundancyPinError(
            f"The quadratic programme of one step was not solved (DAQP: {flag}).",
            remedy="Check the efforts along the motion: they must not be NaN.",
        )
    low, high = np.array(lower), np.array(upper)
    apart = low < high  # lsq_linear takes no bounds that are equal
    u = low.copy()
    target = root @ here - np.linalg.solve(root.T, gradient) - root[:, ~apart] @ low[~apart]
    if apart.any():
        bounds = low[apart], high[apart]
        solved = lsq_linear(root[:, apart], target, bounds, method="bvls", tol=1e-15)
        u[apart] = np.where(solved.active_mask > 0, bounds[1], np.where(solved.active_mask < 0, bounds[0], solved.x))
    return u.tolist()  # type: ignore[no-any-return]


def optimality(residual: Array, jacobian: Array, lower: Array, upper: Array, u: Array) -> Array:
    """Return (P,) how far P points are from satisfying the conditions of a minimum.

    The largest component of the gradient that a move inside the box could follow downhill, divided by the size of J;
    zero at a minimum. In the unit of r.

    ``residual`` (P, m) r at the points; ``jacobian`` (P, m, k) J there; ``lower`` (P, k) lower bounds; ``upper`` (P, k)
    upper bounds; ``u`` (P, k) the points.
    """
    gradient = np.einsum("pm,pmk->pk", residual, jacobian)
    gradient = np.where((u <= lower) & (gradient > 0.0), 0.0, gradient)
    gradient = np.where((u >= upper) & (gradient < 0.0), 0.0, gradient)
    size = np.maximum(np.abs(jacobian).max(axis=(1, 2), initial=0.0), np.finfo(float).tiny)
    value: Array = np.abs(gradient).max(axis=1, initial=0.0) / size
    return value


def definiteness(residual: Array, jacobian: Array, curvatures: Array) -> Array:
    """Return (P,) the smallest eigenvalue of the Hessian at P points, relative to the largest.

    The Hessian of ½ ‖r‖² is JᵀJ + 2 diag(Cᵀ r). Where it is positive everywhere in the box the minimum is the only one.

    ``residual`` (P, m) r at the points; ``jacobian`` (P, m, k) J there; ``curvatures`` (P, m, k) C.
    """
    hessian = np.einsum("pmk,pml->pkl", jacobian, jacobian)
    each = np.arange(hessian.shape[1])
    hessian[:, each, each] += 2.0 * np.einsum("pmk,pm->pk", curvatures, residual)
    eigenvalues = np.linalg.eigvalsh(hessian)
    ratio: Array = eigenvalues[:, 0] / np.abs(eigenvalues).max(axis=1)
    return ratio


_TOLERANCE = 1e-9
"""Of the gradient at a minimum, as a fraction of the efforts along the motion."""


@dataclass(frozen=True, eq=False)
class StepProblems:
    """The least-squares problem of every step.

    A step of length h from (s, ṡ) with the acceleration u ends at ṡ' = ṡ + h u, s' = s + h ṡ'. The efforts there less
    their target are r, and J = ∂r/∂u; both are linear in φ = (1, s', s'², ṡ', s' ṡ', u), so one product gives both. The
    second derivatives do not depend on the state: r(u + d) = r + J d + C (d ∘ d).

    J steps; step j ends at instant j + 1.

    ``t`` (J + 1,) instants, s; ``h`` (J,) lengths of the steps, s; ``maps`` (J, m (k + 1), 1 + 5 k) from φ to [J r],
    row by row; ``C`` (J, m, k) curvatures; ``slope`` (J,) size of J; ``curvature`` (J,) size of C; ``tolerance``: of
    the gradient, divided by the slope, N or N·m.
    """

    t: Array
    h: Array
    maps: Array
    C: Array
    slope: Array
    curvature: Array
    tolerance: float

    def linearised(self, first: int, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
        """Return r (P, m) and J (P, m, k) at the ends (P, k) of the steps from ``first`` on."""
        features = np.concatenate([np.ones((len(s), 1)), s, s * s, sd, s * sd, sdd], axis=1)
        steps, m, k = self.C[first : first + len(s)].shape
        values = np.einsum("jvf,jf->jv", self.maps[first : first + steps], features)
        both = values.reshape(steps, m, k + 1)
        return both[:, :, k], both[:, :, :k]


def step_problems(model: EffortModel, target: Array, at: IntArray) -> StepProblems:
    """Prepare the steps between chosen samples of a model.

    ``model``: coefficients of the efforts, N samples; ``target`` (N, m) efforts to aim at, λ τ̂, N or N·m; ``at`` (J +
    1,) samples between which the steps lie; their times increase.
    """
    t = model.t[at]
    h = np.diff(t)
    ends = at[1:]
    by_s, by_s2, by_sd, by_ssd, by_sdd = np.moveaxis(model.tau_terms[ends], -1, 0)
    steps, m, k = by_s.shape
    H = h[:, None, None]
    maps = np.zeros((steps, m, k + 1, 1 + 5 * k))
    maps[:, :, k, 0] = model.tau0[ends] - target[ends]
    maps[:, :, k, 1:] = np.concatenate([by_s, by_s2, by_sd, by_ssd, by_sdd], axis=2)
    each = np.arange(k)
    slope = H * H * by_s + H * by_sd + by_sdd
    maps[:, :, each, 0] = slope
    maps[:, :, each, 1 + each] = 2.0 * H * H * by_s2 + H * by_ssd
    maps[:, :, each, 1 + 2 * k + each] = H * H * by_ssd
    C = H**4 * by_s2 + H**3 * by_ssd
    size = np.abs(slope).max(axis=(1, 2), initial=np.finfo(float).tiny)
    efforts = np.abs(maps[:, :, k, 0]).max(initial=0.0)
    return StepProblems(
        t,
        h,
        maps.reshape(steps, m * (k + 1), -1),
        C,
        size,
        np.abs(C).max(axis=(1, 2), initial=0.0),
        float(_TOLERANCE * (efforts or size.max(initial=0.0))),
    )


@dataclass(frozen=True, eq=False)
class OptimisedSteps:
    """Consecutive steps of the optimiser.

    ``s`` (P, k) positions at the end of each step, m; ``sd`` (P, k) speeds there, m/s; ``sdd`` (P, k) accelerations,
    m/s²; ``lower`` (P, k) smallest accelerations the limits allow; ``upper`` (P, k) largest; ``iterations`` (P,)
    iterations of each step.
    """

    s: Array
    sd: Array
    sdd: Array
    lower: Array
    upper: Array
    iterations: IntArray


def optimise(
    problems: StepProblems, first: int, last: int, start: CarrierState, limits: AccelerationBox
) -> OptimisedSteps:
    """Solve steps first ... last − 1, each from where the one before it ended.

    ``start``: the carriers before the first step; their accelerations are the first guess.
    """
    m, k = problems.C.shape[1:]

    def linearised(u: list[float]) -> Array:
        rate = [v + h * a for v, a in zip(sd, u)]  # noqa: B905 (strict costs time here)
        place = [x + h * v for x, v in zip(s, rate)]  # noqa: B905
        features = [1.0, *place, *map(mul, place, place), *rate, *map(mul, place, rate), *u]
        both: Array = step_map.dot(features).reshape(m, k + 1)
        return both

    damping = damping_of(k, float(problems.slope.max()))
    lengths, times = problems.h.tolist(), problems.t.tolist()
    slopes, curvatures = problems.slope.tolist(), problems.curvature.tolist()
    results: list[tuple[list[float], ...]] = []
    iterations: list[int] = []
    s, sd, u = start.s.tolist(), start.sd.tolist(), start.sdd.tolist()
    guess = u
    for j in range(first, last):
        h, step_map, before = lengths[j], problems.maps[j], u
        low, high = limits.box(times[j + 1], h, s, sd)
        u, count = minimise(
            linearised,
            low,
            high,
            guess,
            slope=slopes[j],
            curvature=curvatures[j],
            damping=damping,
            tolerance=problems.tolerance,
        )
        guess = [2.0 * now - then for now, then in zip(u, before)]  # noqa: B905
        sd = [v + h * a for v, a in zip(sd, u)]  # noqa: B905
        s = [x + h * v for x, v in zip(s, sd)]  # noqa: B905
        results.append((s, sd, u, low, high))
        iterations.append(count)
    position, speed, acceleration, lower, upper = np.moveaxis(np.array(results).reshape(-1, 5, k), 1, 0).copy()
    return OptimisedSteps(position, speed, acceleration, lower, upper, np.array(iterations, dtype=np.intp))
