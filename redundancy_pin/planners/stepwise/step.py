"""One step after the other: the accelerations that the limits leave, and among them those of least effort.

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
from functools import cached_property

import daqp
import numpy as np

from redundancy_pin.arrays import Array, IntArray
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
        limits: of k carriers; those of track, speed and acceleration are kept.
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
        the time ``rest_at``. Neither asks for more than the largest deceleration, so they never empty it.

        Args:
            t: time at the end of the step, s.
            step: length h of the step, s.
            s: (k,) positions before the step, m.
            sd: (k,) speeds before the step, m/s.

        Raises:
            InfeasiblePlanError: no acceleration keeps the limits; carries constraint, carrier, time and amount.
        """
        (lower, upper), a = self.limits.track.T, self.limits.acceleration
        low = np.maximum((-self._largest_speed(t, step, s - lower, -sd) - sd) / step, -a)
        high = np.minimum((self._largest_speed(t, step, upper - s, sd) - sd) / step, a)
        for j in np.flatnonzero(low > high):
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
            carrier=name,
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

_SOLVER = {"primal_tol": 1e-11, "dual_tol": 1e-13, "zero_tol": 1e-16, "sing_tol": 1e-18}
"""Of DAQP: bounds, m/s²; gradient relative to the largest JᵀJ; pivots. With its own pivots it calls one of ten boxes
infeasible where JᵀJ has a condition number of 1e12; with these none of 4,000."""


@dataclass(frozen=True, eq=False)
class StepProblems:
    """The least-squares problems of J steps; step j ends at instant j + 1.

    Attributes:
        t: (J + 1,) instants, s.
        tau0: (J, m) efforts at the ends of the steps less their target, carriers at rest at s = 0, N or N·m.
        terms: (J, 5, m, k) coefficients of the efforts there, by s, s², ṡ, s ṡ and s̈.
    """

    t: Array
    tau0: Array
    terms: Array

    @staticmethod
    def of(model: EffortModel, target: Array, instants: IntArray) -> StepProblems:
        """Return the steps between chosen samples of a model.

        Args:
            model: coefficients of the efforts at N samples.
            target: (N, m) efforts to aim at, λ τ̂, N or N·m.
            instants: (J + 1,) samples between which the steps lie, with increasing times.
        """
        ends = instants[1:]
        terms = np.ascontiguousarray(np.moveaxis(model.tau_terms[ends], -1, 1))
        return StepProblems(model.t[instants], model.tau0[ends] - target[ends], terms)

    @cached_property
    def tolerance(self) -> float:
        """Largest gradient at a minimum, divided by the largest slope of the efforts, N or N·m."""
        size = float(np.abs(self.tau0).max(initial=0.0))
        return _GRADIENT * (size or float(np.abs(self.terms[:, 4]).max(initial=0.0)))

    def linearised(self, j: int, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
        """Return r (m,) of step j, which ends with ``s``, ``sd`` and ``sdd`` (k,), and its Jacobian (m, k) by s̈."""
        by_s, by_s2, by_sd, by_ssd, by_sdd = self.terms[j]
        h = self.t[j + 1] - self.t[j]
        r = self.tau0[j] + by_s @ s + by_s2 @ (s * s) + by_sd @ sd + by_ssd @ (s * sd) + by_sdd @ sdd
        return r, h * h * (by_s + 2.0 * by_s2 * s + by_ssd * sd) + h * (by_sd + by_ssd * s) + by_sdd


@dataclass(frozen=True, eq=False)
class OptimisedSteps:
    """P consecutive steps of the optimiser.

    Attributes:
        s, sd, sdd: (P, k) positions, m, speeds, m/s, and accelerations, m/s², at the end of each step.
        lower, upper: (P, k) smallest and largest accelerations that the limits allow, m/s².
        iterations: (P,) quadratic programmes solved in each step.
        gradient: (P,) deviation from the conditions of a minimum (see ``optimality``), N or N·m.
    """

    s: Array
    sd: Array
    sdd: Array
    lower: Array
    upper: Array
    iterations: IntArray
    gradient: Array


def optimise(
    problems: StepProblems, first: int, last: int, start: CarrierState, box: AccelerationBox
) -> OptimisedSteps:
    """Solve steps first ... last − 1, each from where the one before it ended.

    ``start``: the carriers before the first step; their accelerations are the first guess.
    """
    s, sd, sdd = start.s, start.sd, start.sdd
    results, iterations, gradients = [], [], []
    for j in range(first, last):
        lower, upper = box.box(float(problems.t[j + 1]), float(problems.t[j + 1] - problems.t[j]), s, sd)
        s, sd, sdd, count, gradient = _solve_step(problems, j, s, sd, np.clip(sdd, lower, upper), lower, upper)
        results.append((s, sd, sdd, lower, upper))
        iterations.append(count)
        gradients.append(gradient)
    path, speed, acceleration, low, high = np.moveaxis(np.array(results), 1, 0).copy()
    counts = np.array(iterations, dtype=np.intp)
    return OptimisedSteps(path, speed, acceleration, low, high, counts, np.array(gradients))


def _solve_step(
    problems: StepProblems, j: int, s: Array, sd: Array, guess: Array, lower: Array, upper: Array
) -> tuple[Array, Array, Array, int, float]:
    """Return s, ṡ and s̈ (k,) at the end of step j, the number of programmes solved, and the gradient left."""
    h, u = problems.t[j + 1] - problems.t[j], guess
    damping, no_rows = _DAMPING * np.eye(len(u)), np.empty((0, len(u)))
    for iteration in range(_MOST_ITERATIONS + 1):
        speed = sd + h * u
        place = s + h * speed
        r, jacobian = problems.linearised(j, place, speed, u)
        gradient = optimality(r, jacobian, lower, upper, u)
        if gradient <= problems.tolerance or iteration == _MOST_ITERATIONS:
            break
        scaled = jacobian / np.abs(jacobian).max()
        linear = scaled.T @ (r / np.abs(jacobian).max())
        d, _, flag, info = daqp.solve(scaled.T @ scaled + damping, linear, no_rows, upper - u, lower - u, **_SOLVER)
        if flag < 1:
            break
        # an active bound is met bit by bit, not up to the rounding of a difference
        u = np.where(info["lam"] > 0.0, upper, np.where(info["lam"] < 0.0, lower, np.clip(u + d, lower, upper)))
    return place, speed, u, iteration, gradient


def optimality(residual: Array, jacobian: Array, lower: Array, upper: Array, u: Array) -> float:
    """Return the largest component of the gradient of ½ ‖r‖² that a move inside the box could follow downhill.

    Divided by the largest entry of the Jacobian (m, k), so in the unit of the residual r (m,); 0 at a minimum.
    """
    gradient = jacobian.T @ residual
    blocked = ((u <= lower) & (gradient > 0.0)) | ((u >= upper) & (gradient < 0.0))
    return float(np.abs(np.where(blocked, 0.0, gradient)).max() / np.abs(jacobian).max())
