"""One step after the other: among the accelerations that keep the limits, choose the one of least effort.

In one step of length h a carrier takes a new speed v' and moves by h v' (backward differences, Parsa 2014, eqs. 4.3
and 4.4). Let g be the distance to the end of its track in front of it, and a its largest deceleration. It may take the
speed v' if it can stop in the distance left after the step: h v' + v'²/(2a) ≤ g. Braking by a preserves this
inequality: with v' = max(v − a h, 0) the step is at most (v² − v'²)/(2a). So a carrier that starts inside this set
never leaves its track, whatever the lengths of the steps.

Within the bounds u of a step minimises ‖r(u)‖², where u = s̈ and r are the efforts at its end less their target. r is a
quadratic with small second derivatives. Each Gauss–Newton iteration is a quadratic programme with bounds, which DAQP
solves exactly (an active-set method; Arnström, Bemporad and Axehill 2022).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import daqp
import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.carrier_model import EffortModel
from redundancy_pin.planners.carrier_return import CarrierState
from redundancy_pin.planners.limits import ResolvedLimits

_EMPTY = 1e-9
"""Largest relative gap between a lower bound and a smaller upper bound that counts as rounding: one point is left."""


def stoppable_speed(distance: Array, step: float, deceleration: Array) -> Array:
    """Return the largest speeds, m/s, from which carriers can still be stopped before the ends of their tracks.

    The root of h v + v²/(2a) = distance, in the form that does not cancel; 0 where the distance is not positive.

    Args:
        distance: (k,) to the end of the track, m; infinite without one.
        step: length h of the step, s.
        deceleration: (k,) largest deceleration a, m/s²; infinite without a limit.
    """
    ends = np.isfinite(distance)
    room = np.where(ends, np.maximum(distance, 0.0), 0.0)
    return np.where(ends, 2.0 * room / (step + np.sqrt(step * step + 2.0 * room / deceleration)), np.inf)


@dataclass(frozen=True, eq=False)
class AccelerationBox:
    """What the carriers must keep to at every step.

    Attributes:
        limits: of k carriers; track, speed and acceleration limits are kept.
        anticipate: whether a carrier is kept able to stop before the end of its track.
        rest_at: time by which all must be at rest, s; infinite for none.
    """

    limits: ResolvedLimits
    anticipate: bool
    rest_at: float

    def box(self, t: float, step: float, s: Array, sd: Array) -> tuple[Array, Array]:
        """Return the smallest and largest s̈ (k,) of a step, m/s² (Parsa 2014, eqs. 4.2 to 4.4).

        With backward differences ṡ' = ṡ + h s̈ and s' = s + h ṡ' the limits of track, speed and acceleration are one
        box. Two more bounds may narrow it: a carrier must be able to stop before its track ends (``anticipate``) and by
        the time ``rest_at``. Neither requires more than the largest deceleration, so they never empty it.

        Args:
            t: time at the end of the step, s.
            step: length h of the step, s.
            s: (k,) positions before the step, m.
            sd: (k,) speeds before the step, m/s.

        Raises:
            InfeasiblePlanError: no acceleration keeps the limits; carries constraint, joint, time and amount.
        """
        (lower, upper), a = self.limits.track.T, self.limits.acceleration
        low = np.maximum((-self._largest_speed(t, step, s - lower, -sd) - sd) / step, -a)
        high = np.minimum((self._largest_speed(t, step, upper - s, sd) - sd) / step, a)
        for j in (low > high).nonzero()[0]:
            if low[j] - high[j] > _EMPTY * (abs(low[j]) + abs(high[j])):
                raise self._infeasible(int(j), t, step, float(s[j]), float(sd[j]))
            low[j] = high[j] = np.clip(0.5 * (low[j] + high[j]), -a[j], a[j])
        return low, high

    def _largest_speed(self, t: float, step: float, room: Array, sd: Array) -> Array:
        """Return the largest speeds (k,) towards the ends of the tracks, ``room`` away; ``sd`` is positive that way."""
        a = self.limits.acceleration
        reach = a * step
        safe = stoppable_speed(room, step, a) if self.anticipate else np.full_like(sd, np.inf)
        if math.isfinite(self.rest_at):
            safe = np.minimum(safe, a * max(self.rest_at - t, 0.0))
        largest = np.minimum(np.minimum(sd + reach, self.limits.speed), room / step)
        return np.minimum(largest, np.maximum(safe, sd - reach))

    def _infeasible(self, j: int, t: float, step: float, s: float, sd: float) -> InfeasiblePlanError:
        name, (lower, upper) = self.limits.names[j], self.limits.track[j]
        a = float(self.limits.acceleration[j])
        braked = sd - math.copysign(min(abs(sd), a * step), sd)
        reached = s + step * braked
        beyond, excess = max(reached - upper, lower - reached), abs(braked) - self.limits.speed[j]
        constraint, amount, unit = ("track", beyond, "m") if beyond > excess else ("speed", excess, "m/s")
        where = "beyond the end of its track" if constraint == "track" else "above its speed limit"
        return InfeasiblePlanError(
            f"{name} cannot keep its limits at t = {t:.6g} s: it arrives at s = {s:.6g} m with {sd:.6g} m/s, and "
            f"braked by {a:g} m/s² it would still be {amount:.3g} {unit} {where}.",
            remedy="Use anticipate=True, a larger lam, higher limits, or a gentler motion.",
            constraint=constraint,
            joint=name,
            time=t,
            amount=float(amount),
            unit=unit,
        )


_GRADIENT = 1e-9
"""Largest gradient at a minimum, as a fraction of the largest effort along the motion."""

_MOST_ITERATIONS = 50
"""Of Gauss–Newton in a step; one or two are usual."""

_DAMPING = 1e-13
"""Relative to the largest JᵀJ, to which it is added: a direction without effect on r keeps its acceleration."""

_NO_EFFECT = 1e-12
"""Entries of a step's Jacobian, relative to the largest along the motion with the carriers at rest, that are rounding:
at rest a carrier that slides along a link has no effect on its motor."""

_SOLVER = {"primal_tol": 1e-11, "dual_tol": 1e-13, "zero_tol": 1e-16, "sing_tol": 1e-18}
"""Of DAQP: bounds, m/s²; gradient relative to the largest JᵀJ; pivots. With its own pivots it calls one of ten boxes
infeasible where JᵀJ has a condition number of 1e12; with these none of 4,000."""


@dataclass(frozen=True, eq=False)
class OptimisedSteps:
    """P consecutive steps of the optimiser.

    Attributes:
        s, sd, sdd: (P, k) positions, m, speeds, m/s, and accelerations, m/s², at the end of each step.
        lower, upper: (P, k) smallest and largest accelerations that the limits allow, m/s².
        gradient: (P,) deviation from the conditions of a minimum (see ``_solve_step``), N or N·m.
    """

    s: Array
    sd: Array
    sdd: Array
    lower: Array
    upper: Array
    gradient: Array


def optimise(missing: EffortModel, first: int, last: int, start: CarrierState, box: AccelerationBox) -> OptimisedSteps:
    """Solve the steps between instants ``first`` and ``last``, each from where the one before it ended.

    Args:
        missing: the efforts less their target, at the instants between which the steps lie.
        first: the instant at which the first step begins.
        last: the instant at which the last step ends.
        start: the carriers at the first instant; their accelerations are the first guess.
        box: what the carriers must keep to.
    """
    s, sd, sdd, tolerance = start.s, start.sd, start.sdd, gradient_tolerance(missing)
    terms = np.ascontiguousarray(np.moveaxis(missing.tau_terms, -1, 1))
    steps, own = np.diff(missing.t)[first:last, None, None], terms[first + 1 : last + 1]
    at_rest = (steps**2 * own[:, 0], steps * own[:, 2], own[:, 4])
    no_effect = _NO_EFFECT * max(float(np.abs(part).max(initial=0.0)) for part in at_rest)
    results, gradients = [], []
    for i in range(first + 1, last + 1):
        h = float(missing.t[i] - missing.t[i - 1])
        lower, upper = box.box(float(missing.t[i]), h, s, sd)
        guess = np.clip(sdd, lower, upper)
        s, sd, sdd, gradient = _solve_step(
            missing.tau0[i], terms[i], h, s, sd, guess, lower, upper, tolerance, no_effect
        )
        results.append((s, sd, sdd, lower, upper))
        gradients.append(gradient)
    path, speed, acceleration, low, high = np.moveaxis(np.array(results), 1, 0).copy()
    return OptimisedSteps(path, speed, acceleration, low, high, np.array(gradients))


def gradient_tolerance(missing: EffortModel) -> float:
    """Return the largest gradient at a minimum, divided by the largest slope of the efforts, N or N·m."""
    size = float(np.abs(missing.tau0).max())
    return _GRADIENT * (size or float(np.abs(missing.tau_terms[..., -1]).max()))


def _solve_step(
    tau0: Array,
    terms: Array,
    h: float,
    s: Array,
    sd: Array,
    guess: Array,
    lower: Array,
    upper: Array,
    tolerance: float,
    no_effect: float,
) -> tuple[Array, Array, Array, float]:
    """Return s, ṡ and s̈ (k,) at the end of a step of length h, and the largest gradient left, N or N·m.

    ``tau0`` (m,), ``terms`` (5, m, k) of the efforts there less their target; see ``EffortModel``. The gradient is the
    largest component of the gradient of ½ ‖r‖² along a feasible descent move, divided by the largest entry
    of the Jacobian, so in the unit of r; 0 at a minimum, and where that entry is at most ``no_effect``.
    """
    by_s, by_s2, by_sd, by_ssd, by_sdd = terms
    u, damping, no_rows = guess, _DAMPING * np.eye(len(guess)), np.empty((0, len(guess)))
    for iteration in range(_MOST_ITERATIONS + 1):
        speed = sd + h * u
        place = s + h * speed
        r = tau0 + by_s @ place + by_s2 @ place**2 + by_sd @ speed + by_ssd @ (place * speed) + by_sdd @ u
        jacobian = h * h * (by_s + 2.0 * by_s2 * place + by_ssd * speed) + h * (by_sd + by_ssd * place) + by_sdd
        largest = np.abs(jacobian).max()
        if largest <= no_effect:  # nor has any other acceleration: the guess is as good
            gradient = 0.0
            break
        scaled = jacobian / largest
        slope = scaled.T @ r
        blocked = ((u <= lower) & (slope > 0.0)) | ((u >= upper) & (slope < 0.0))
        gradient = float(np.abs(slope[~blocked]).max(initial=0.0))
        if not gradient > tolerance or iteration == _MOST_ITERATIONS:
            break
        d, _, flag, info = daqp.solve(
            scaled.T @ scaled + damping, slope / largest, no_rows, upper - u, lower - u, **_SOLVER
        )
        if flag < 1 or not np.isfinite(d).all():
            break
        # an active bound is met bit by bit, not up to the rounding of a difference
        free = np.minimum(np.maximum(u + d, lower), upper)
        u = np.where(info["lam"] > 0.0, upper, np.where(info["lam"] < 0.0, lower, free))
    return place, speed, u, gradient
