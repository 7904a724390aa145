"""The carriers' way back to where they park: a polynomial of degree seven, and the shortest that keeps the limits.

Carriers that must be able to stop: the speed they may have, and how they are braked.

In one step of length h a carrier takes a new speed v' and moves by h v' (backward differences, Parsa 2014, eqs. 4.3
and 4.4). Say it has the distance g to the end of its track in front of it and can be braked by at most a. It may take
the speed v' if what is left after the step suffices to stop: h v' + v'²/(2a) ≤ g. Braking by a keeps this true: with
v' = max(v − a h, 0) the step is at most (v² − v'²)/(2a). So a carrier that starts inside the set never leaves its
track, whatever the lengths of the steps.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize_scalar

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import boundary_polynomial
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at


def stoppable_speed(gap: float, step: float, deceleration: float) -> float:
    """Return the largest speed, m/s, from which a carrier can still be stopped before the end of its track.

    It is the root of h v + v²/(2a) = gap, or 0 where the gap, m, is not positive; h is the step, s, and a the largest
    deceleration, m/s², infinite if there is no limit.
    """
    if gap <= 0.0:
        return 0.0
    if not math.isfinite(deceleration) or not math.isfinite(gap):
        return gap / step
    slowed = deceleration * step
    # the rationalised root: the plain one cancels where the gap is small
    return 2.0 * deceleration * gap / (slowed + math.sqrt(slowed * slowed + 2.0 * deceleration * gap))


def braked_speeds(speed: Array, braking_time: Array, elapsed: Array) -> Array:
    """Return (J, k) the speeds of carriers that are braked by constant decelerations.

    ``speed`` (k,) speed at the start, m/s, either sign; ``braking_time`` (k,) time until rest, s; zero for a carrier at
    rest; ``elapsed`` (J,) time since the start at the end of each step, s.
    """
    duration = np.where(braking_time > 0.0, braking_time, 1.0)
    left: Array = speed * np.clip(1.0 - elapsed[:, None] / duration, 0.0, None)
    left[:, braking_time <= 0.0] = 0.0
    return left


def braking_times(speed: Array, room: Array, deceleration: Array, wanted: float) -> Array:
    """Return (k,) the time, s, each carrier takes to stop: as wanted, sooner where the track asks for it.

    Never below |v|/a, even where the ``room`` (k,) to the end of the track, m, is too short for it.
    """
    size = np.abs(speed)
    moving = size > 0.0
    by_track = np.where(moving, 2.0 * room / np.where(moving, size, 1.0), np.inf)
    return np.where(moving, np.maximum(np.minimum(wanted, by_track), size / deceleration), 0.0)


CANDIDATES = 160
"""Durations tried, evenly in their logarithm, before the search is refined between neighbours."""

SHORTEST_FRACTION = 1e-3
"""Of the time there is, that the shortest candidate takes."""

SAMPLES = 65
"""Samples of a candidate; the chosen one is judged at its extremes."""

ALLOWED = 1.0 + 1e-12
"""Largest use of a limit that keeps it: the shortest return lies on one, to rounding."""

QUANTITIES = ("track", "speed", "acceleration", "force")

_TIME_TOLERANCE = 1e-11
"""Relative, of the shortest duration."""


@dataclass(frozen=True, eq=False)
class CarrierState:
    """Carriers at an instant.

    ``t``: time, s; ``s``, ``sd``, ``sdd`` (k,) m, m/s, m/s².
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


def return_polynomial(state: CarrierState, duration: float, datum: Array) -> PiecewisePolynomial:
    """Return the carriers' way to rest at ``datum`` (k,): degree seven, without jerk at either end.

    Step 5 of Parsa 2014, section 3.1 (eq. 3.7); the start is not at rest, so all eight conditions are needed.
    """
    zero = np.zeros_like(datum)
    start = [state.s, state.sd, state.sdd, zero]
    polynomial = boundary_polynomial(state.t, state.t + duration, start, [datum, zero, zero, zero])
    return PiecewisePolynomial.from_bernstein(polynomial.control[:, None], [polynomial.t0, polynomial.t1])


def _bounds(robot: Robot) -> tuple[Array, Array]:
    """Return lower and upper limits (4, k) of track, speed, acceleration and force."""
    limits = robot.carrier_limits
    lower = np.array([[c.lower, -c.speed, -c.acceleration, -c.force] for c in limits]).T
    return lower, np.array([[c.upper, c.speed, c.acceleration, c.force] for c in limits]).T


def limit_uses(robot: Robot, s: Array, sd: Array, sdd: Array, force: Array) -> Array:
    """Return the fraction of each limit that is used (..., 4, k): track, speed, acceleration, force; each (..., k).

    Above 1 the limit is broken. Tracks are measured from their middle; a limit that is not declared is never used.
    """
    lower, upper = _bounds(robot)
    with np.errstate(invalid="ignore"):
        middle = np.where(np.isfinite(lower) & np.isfinite(upper), 0.5 * (lower + upper), 0.0)
    value = np.stack([s, sd, sdd, force], axis=-2)
    side = np.where(value >= middle, upper, lower)
    return np.where(np.isfinite(side), (value - middle) / (side - middle), 0.0)


def shortest_return(
    robot: Robot, force: CarrierForce, state: CarrierState, datum: Array, available: float
) -> tuple[float | None, LimitUse]:
    """Search the shortest return that keeps every limit of the carriers.

    The overshoot of the polynomial grows with its duration and its acceleration with the inverse, so the durations
    that keep the limits form an interval if there are any. It is bracketed on a logarithmic grid; where no candidate
    lies in it, the neighbourhood of the best ones is searched before it is called empty. ``datum`` (k,) is where to
    park, m, ``available`` the longest duration, s. Returned are the duration, s, or None where none keeps the limits,
    and the limit use of that, or of the best.
    """

    def use(duration: float) -> LimitUse:
        return _limit_use(robot, force, return_polynomial(state, duration, datum))

    durations = np.geomspace(SHORTEST_FRACTION * available, available, CANDIDATES)
    uses = _sampled_uses(robot, force, state, datum, durations)
    padded = np.concatenate([[np.inf], uses, [np.inf]])
    dips = (padded[1:-1] <= padded[:-2]) & (padded[1:-1] <= padded[2:]) & (uses > ALLOWED)
    for i in np.flatnonzero(dips | (uses <= ALLOWED)).tolist():
        low, high = float(durations[max(i - 1, 0)]), float(durations[i])
        if uses[i] > ALLOWED:  # the limits may be kept between two candidates
            bounds = (low, float(durations[min(i + 1, CANDIDATES - 1)]))
            best = minimize_scalar(lambda T: use(float(T)).use, bounds=bounds, method="bounded")
            high, uses[i] = float(best.x), float(best.fun)
            durations[i] = high
        if use(high).use <= ALLOWED:
            return _first_allowed(use, low, high)
    return None, use(float(durations[uses.argmin()]))


def _sampled_uses(robot: Robot, force: CarrierForce, state: CarrierState, datum: Array, durations: Array) -> Array:
    """Return (T,) the largest limit use of the samples of each return."""
    paths = [return_polynomial(state, duration, datum) for duration in durations]
    times = np.array([np.linspace(path.start, path.end, SAMPLES) for path in paths])
    motions = [carriers_at(path, t) for path, t in zip(paths, times, strict=True)]
    s, sd, sdd = (np.concatenate([getattr(motion, name) for motion in motions]) for name in ("s", "sd", "sdd"))
    uses = limit_uses(robot, s, sd, sdd, force(times.ravel(), s, sd, sdd))
    largest: Array = uses.reshape(len(durations), -1).max(axis=1)
    return largest


def _limit_use(robot: Robot, force: CarrierForce, path: PiecewisePolynomial) -> LimitUse:
    """Return the limit that a path uses most, at its samples and at its extremes."""
    extremes = [path.derivative(order).extremes() for order in range(3)]
    times = np.unique(np.concatenate([np.linspace(path.start, path.end, SAMPLES), *extremes]))
    motion = carriers_at(path, times)
    s, sd, sdd = (np.asarray(part) for part in (motion.s, motion.sd, motion.sdd))
    efforts = force(times, s, sd, sdd)
    uses = limit_uses(robot, s, sd, sdd, efforts)
    at, which, i = (int(index) for index in np.unravel_index(int(uses.argmax()), uses.shape))
    value = float((s, sd, sdd, efforts)[which][at, i])
    lower, upper = (float(bounds[which, i]) for bounds in _bounds(robot))
    limit = upper if abs(value - upper) <= abs(value - lower) else lower
    return LimitUse(float(uses[at, which, i]), QUANTITIES[which], robot.carriers[i], float(times[at]), value, limit)


def _first_allowed(use: Callable[[float], LimitUse], low: float, high: float) -> tuple[float, LimitUse]:
    """Bisect between a duration that is not allowed (or the shortest of all) and one that is."""
    at_low = use(low)
    if at_low.use <= ALLOWED:
        return low, at_low
    while high - low > _TIME_TOLERANCE * high:
        middle = 0.5 * (low + high)
        low, high = (low, middle) if use(middle).use <= ALLOWED else (middle, high)
    return high, use(high)


def no_return(use: LimitUse, start: float, available: float, remedy: str) -> InfeasiblePlanError:
    """Return the error that says that no return keeps the limits, which one stands in the way, and by how much."""
    return InfeasiblePlanError(
        f"No return of the carriers of at most {available:.6g} s from t = {start:.6g} s keeps their limits: the best "
        f"one breaks the {use.quantity} limit {use.limit:g} of {use.carrier} by {use.amount:.4g} at t = {use.t:.6g} s.",
        remedy=remedy,
        constraint=use.quantity,
        carrier=use.carrier,
        time=use.t,
        amount=use.amount,
    )
