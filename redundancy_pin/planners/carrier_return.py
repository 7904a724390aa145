"""The carriers' way back to where they park: a polynomial of degree seven, and the shortest that keeps the limits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq, minimize_scalar

from redundancy_pin.arrays import Array, Frozen
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.limits import OF_CARRIERS, LimitEvent, ResolvedLimits
from redundancy_pin.trajectory import boundary_polynomial
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

CANDIDATES = 32
"""Durations tried, evenly in their logarithm, before the search is refined between neighbours."""

SHORTEST_FRACTION = 1e-3
"""Of the time there is, that the shortest candidate takes."""

SAMPLES = 65
"""Samples of a candidate, which is also evaluated at its extremes."""

ALLOWED = 1.0 + 1e-12
"""Largest use of a limit that keeps it: the shortest return lies on a limit, to machine precision."""

_TIME_TOLERANCE = 1e-11
"""Relative, of the shortest duration."""


@dataclass(frozen=True, eq=False)
class CarrierState(Frozen):
    """Carriers at an instant.

    ``t``: time, s; ``s``, ``sd``, ``sdd`` (k,) m, m/s, m/s².
    """

    t: float
    s: Array
    sd: Array
    sdd: Array


CarrierForce = Callable[[Array, Array, Array, Array], Array]
"""From (N,) times and s, ṡ, s̈ (N, k) to the forces of the carriers' actuators (N, k), N."""


def return_polynomial(state: CarrierState, duration: float, datum: Array) -> PiecewisePolynomial:
    """Return the carriers' way to rest at ``datum`` (k,): degree seven, without jerk at either end.

    Step 5 of Parsa 2014, section 3.1 (eq. 3.7); the start is not at rest, so all eight conditions are needed.
    """
    zero = np.zeros_like(datum)
    start = [state.s, state.sd, state.sdd, zero]
    return boundary_polynomial(state.t, state.t + duration, start, [datum, zero, zero, zero])


def limit_uses(limits: ResolvedLimits, s: Array, sd: Array, sdd: Array, force: Array) -> Array:
    """Return the fraction of each limit that is used (..., 4, k): track, speed, acceleration, force; each (..., k).

    Above 1 the limit is broken. Tracks are measured from their middle; a limit that is not declared is never used.
    """
    lower, upper = limits.bounds
    with np.errstate(invalid="ignore"):
        middle = np.where(np.isfinite(lower) & np.isfinite(upper), 0.5 * (lower + upper), 0.0)
    value = np.stack([s, sd, sdd, force], axis=-2)
    side = np.where(value >= middle, upper, lower)
    return np.where(np.isfinite(side), (value - middle) / (side - middle), 0.0)


def no_force(t: Array, s: Array, sd: Array, sdd: Array) -> Array:
    """Return zeros (N, k): the forces of carriers whose force limits do not count."""
    return np.zeros_like(s)


def shortest_return(
    limits: ResolvedLimits, force: CarrierForce, state: CarrierState, datum: Array, available: float, remedy: str
) -> PiecewisePolynomial:
    """Return the shortest return (``return_polynomial``) that keeps every limit of the carriers.

    The overshoot of the polynomial grows with its duration and its acceleration with the inverse, so the durations
    that keep the limits form an interval if there are any. It is bracketed on a logarithmic grid. Where no candidate
    lies in it, the minimum of the limit use is sought between candidates before the interval counts as empty.

    Args:
        limits: of the carriers.
        force: forces of their actuators along a motion; ``no_force`` where these do not count.
        state: the carriers at the start.
        datum: (k,) where to park, m.
        available: longest duration, s.
        remedy: what to do where no duration keeps the limits, for the message.

    Raises:
        InfeasiblePlanError: no duration keeps the limits. The message and the details are of the best one: which limit
            of which carrier it exceeds, when and by how much.
    """

    def use(duration: float) -> tuple[float, LimitEvent]:
        return _limit_use(limits, force, return_polynomial(state, duration, datum))

    durations = np.geomspace(SHORTEST_FRACTION * available, available, CANDIDATES).tolist()
    found = [use(duration) for duration in durations]
    beside = [np.inf, *(most for most, _ in found), np.inf]
    for i in range(CANDIDATES):
        if found[i][0] > ALLOWED and beside[i] > found[i][0] <= beside[i + 2]:
            # the limits may be kept between two candidates
            ends = np.log([durations[max(i - 1, 0)], durations[min(i + 1, CANDIDATES - 1)]])
            least = minimize_scalar(lambda T: use(np.exp(T))[0], bounds=ends, method="bounded")
            durations[i] = float(np.exp(least.x))
            found[i] = use(durations[i])
        if found[i][0] <= ALLOWED:
            # the candidates before it break a limit
            shortest = _first_within(lambda T: use(T)[0], durations[i - 1], durations[i]) if i else durations[i]
            return return_polynomial(state, shortest, datum)
    _, event = min(found, key=lambda one: one[0])
    raise InfeasiblePlanError(
        f"No return of the carriers of at most {available:.6g} s from t = {state.t:.6g} s keeps their limits: the best "
        f"one breaks the {event.quantity} limit {event.limit:g} of {event.joint} by {event.amount:.4g} at "
        f"t = {event.worst:.6g} s.",
        remedy=remedy,
        constraint=event.quantity,
        joint=event.joint,
        time=event.worst,
        amount=event.amount,
    )


def _first_within(use: Callable[[float], float], low: float, high: float) -> float:
    """Return the shortest duration, s, that keeps the limits, between one that breaks them and one that does not."""
    tolerance = {"xtol": _TIME_TOLERANCE * low, "rtol": _TIME_TOLERANCE}
    shortest = float(brentq(lambda T: use(float(T)) - ALLOWED, low, high, **tolerance))
    if use(shortest) > ALLOWED:  # the root is known from one side only
        shortest = min(shortest * (1.0 + 2.0 * _TIME_TOLERANCE), high)
    return shortest


def _limit_use(limits: ResolvedLimits, force: CarrierForce, path: PiecewisePolynomial) -> tuple[float, LimitEvent]:
    """Return the largest use of a limit along a path, at its samples and at its extremes, and of which limit."""
    extremes = [path.derivative(order).extremes() for order in range(3)]
    times = np.unique(np.concatenate([np.linspace(path.start, path.end, SAMPLES), *extremes]))
    motion = carriers_at(path, times)
    s, sd, sdd = (np.asarray(part) for part in (motion.s, motion.sd, motion.sdd))
    efforts = force(times, s, sd, sdd)
    uses = limit_uses(limits, s, sd, sdd, efforts)
    at, which, i = (int(index) for index in np.unravel_index(int(uses.argmax()), uses.shape))
    use, t, value = float(uses[at, which, i]), float(times[at]), float((s, sd, sdd, efforts)[which][at, i])
    lower, upper = (float(bounds[which, i]) for bounds in limits.bounds)
    limit = upper if abs(value - upper) <= abs(value - lower) else lower
    amount = abs(value - limit) if use > 1.0 else 0.0
    return use, LimitEvent(limits.names[i], OF_CARRIERS[which], t, t, t, value, limit, amount)
