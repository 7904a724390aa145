"""The carriers' way back to where they park: a polynomial of degree seven, and the shortest that keeps the limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.carrier_path import CarrierPath
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import Polynomial, boundary_polynomial

CANDIDATES = 160
"""Durations tried, evenly in their logarithm, before the search is refined between neighbours."""

SHORTEST_FRACTION = 1e-3
"""Of the time there is, that the shortest candidate takes."""

SAMPLES = 65
"""Samples of a candidate; the chosen one is judged at its extremes."""

ON_THE_LIMIT = 1e-12
"""Relative excess at which a return counts as on its limit; the shortest one is built to lie there."""


@dataclass(frozen=True, eq=False)
class CarrierState:
    """Carriers at an instant.

    Attributes:
        t: time, s.
        s, sd, sdd: (k,) m, m/s, m/s².
    """

    t: float
    s: Array
    sd: Array
    sdd: Array


@dataclass(frozen=True)
class LimitUse:
    """The limit that a motion comes nearest to, or breaks most.

    Attributes:
        use: fraction of the limit that is used; above 1 it is broken. Tracks are measured from their middle.
        quantity: "track", "speed", "acceleration" or "force".
        carrier: name of the carrier.
        t: when, s.
        value, limit: m, m/s, m/s² or N, with their signs.
    """

    use: float
    quantity: str
    carrier: str
    t: float
    value: float
    limit: float

    @property
    def amount(self) -> float:
        """How far the value exceeds the limit, in its unit."""
        return max(0.0, abs(self.value - self.limit) if self.use > 1.0 else 0.0)


CarrierForce = Callable[[Array, Array, Array, Array], Array]
"""From (N,) times and s, ṡ, s̈ (N, k) to the forces of the carriers' actuators (N, k), N."""


def return_polynomial(state: CarrierState, duration: float, datum: Array) -> Polynomial:
    """Return the carriers' way to rest at ``datum`` (k,): degree seven, without jerk at either end.

    Step 5 of Parsa 2014, section 3.1 (eq. 3.7); the start is not at rest, so all eight conditions are needed.
    """
    zero = np.zeros_like(datum)
    start = [state.s, state.sd, state.sdd, zero]
    return boundary_polynomial(state.t, state.t + duration, start, [datum, zero, zero, zero])


def limit_use(robot: Robot, force: CarrierForce, path: CarrierPath, times: Array) -> LimitUse:
    """Return which limit a path uses most at (N,) times."""
    motion = path(times)
    efforts = force(times, np.asarray(motion.s), np.asarray(motion.sd), np.asarray(motion.sdd))
    worst = LimitUse(0.0, "track", robot.carriers[0], float(times[0]), float(motion.s[0, 0]), np.inf)
    for i, (name, limits) in enumerate(zip(robot.carriers, robot.carrier_limits, strict=True)):
        bounds = (
            ("track", motion.s[:, i], limits.lower, limits.upper),
            ("speed", motion.sd[:, i], -limits.speed, limits.speed),
            ("acceleration", motion.sdd[:, i], -limits.acceleration, limits.acceleration),
            ("force", efforts[:, i], -limits.force, limits.force),
        )
        for quantity, value, lower, upper in bounds:
            middle = 0.5 * (lower + upper) if np.isfinite(lower + upper) else 0.0
            side = np.where(value >= middle, upper, lower)
            with np.errstate(invalid="ignore"):
                use = np.where(np.isinf(side), 0.0, (value - middle) / (side - middle))
            at = int(use.argmax())
            if use[at] > worst.use:
                worst = LimitUse(float(use[at]), quantity, name, float(times[at]), float(value[at]), float(side[at]))
    return worst


def shortest_return(
    robot: Robot, force: CarrierForce, state: CarrierState, datum: Array, available: float
) -> tuple[float | None, LimitUse]:
    """Search the shortest return that keeps every limit of the carriers.

    The overshoot of the polynomial grows with its duration and its acceleration with the inverse, so the durations
    that keep the limits form an interval if there are any; it is bracketed on a logarithmic grid, and where no
    candidate lies in it the best ones are refined before it is called empty.

    Args:
        robot: the robot, for the limits.
        force: forces of the carriers' actuators.
        state: the carriers at the start.
        datum: (k,) where to park, m.
        available: longest duration, s.

    Returns:
        The duration, s, or None where none keeps the limits, and the limit use of that, or of the best, duration.
    """

    def use(duration: float) -> LimitUse:
        path = CarrierPath.of_polynomial(return_polynomial(state, duration, datum))
        samples = np.linspace(path.start, path.end, SAMPLES)
        return limit_use(robot, force, path, np.union1d(samples, path.extremes()))

    durations = np.geomspace(SHORTEST_FRACTION * available, available, CANDIDATES)
    uses = np.array([use(duration).use for duration in durations])
    allowed = 1.0 + ON_THE_LIMIT
    good = int(np.argmax(uses <= allowed)) if (uses <= allowed).any() else CANDIDATES
    for i in _dips(uses[: good + 1]):
        low, high = durations[max(i - 1, 0)], durations[min(i + 1, CANDIDATES - 1)]
        best = minimize_scalar(lambda T: use(float(T)).use, bounds=(low, high), method="bounded")
        if best.fun <= allowed:
            return _first_allowed(use, float(low), float(best.x), allowed)
        if best.fun < uses.min():
            durations, uses = np.append(durations, best.x), np.append(uses, best.fun)
    if good < CANDIDATES:
        return _first_allowed(use, float(durations[max(good - 1, 0)]), float(durations[good]), allowed)
    return None, use(float(durations[uses.argmin()]))


def _dips(values: Array) -> IntArray:
    """Return the indices of the local minima that lie before the last value."""
    padded = np.concatenate([[np.inf], values, [-np.inf if len(values) < CANDIDATES else np.inf]])
    lowest: IntArray = np.flatnonzero((padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]))
    return lowest


def _first_allowed(use: Callable[[float], LimitUse], low: float, high: float, allowed: float) -> tuple[float, LimitUse]:
    """Bisect between a duration that is not allowed (or the shortest of all) and one that is."""
    if use(low).use <= allowed:
        return low, use(low)
    while high - low > 1e-12 * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if use(middle).use <= allowed else (middle, high)
    return high, use(high)


def no_return(use: LimitUse, exit_time: float, available: float) -> InfeasiblePlanError:
    """Return the error that says that no return keeps the limits, which one stands in the way, and by how much."""
    return InfeasiblePlanError(
        f"No return of the carriers of at most {available:.6g} s from t = {exit_time:.6g} s keeps their limits: the "
        f"best one breaks the {use.quantity} limit {use.limit:g} of {use.carrier} by {use.amount:.4g} at "
        f"t = {use.t:.6g} s.",
        remedy="Raise the threshold (a shorter window moves the carriers less), lengthen the tracks, or pass a "
        "return_time and accept a plan that violates limits.",
        constraint=use.quantity,
        carrier=use.carrier,
        t=use.t,
        amount=use.amount,
    )
