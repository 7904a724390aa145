"""The thesis's own discretisation of a crossing: backward differences on a uniform grid.

At each sample ṡ and s̈ are backward differences of s, which makes f(s, ṡ, s̈) = W τ_ref k nonlinear equations for the k
positions (Parsa 2014, eqs 3.5 and 3.6). They are solved exactly, so every sample is in balance; but the speed is that
of half a step earlier and the acceleration that of a whole step, an error of first order. The first sample after
switch-on, on the return polynomial, asks for efforts in one step: a jump in proportion to the step. It is here
to reproduce the thesis and to show where its jumps come from.
"""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import CarrierModel
from redundancy_pin.planners.switch_off.carrier_equation import CarrierEquation
from redundancy_pin.planners.switch_off.crossing import Crossing, crossing_equation
from redundancy_pin.singularities.roots import Interval
from redundancy_pin.trajectory.functions_of_time import ContinuousMotion, PiecewisePolynomial

STEP_TOLERANCE = 1e-9
"""Largest imbalance at a sample, relative to the largest f along the crossing. A position rounded to 1e-17 m is an
acceleration of 1e-11 m/s² at a step of a millisecond."""

_MOST_ITERATIONS = 20


def cross_stepwise(
    dynamics: Dynamics,
    motion: ContinuousMotion,
    window: Interval,
    ramp_time: float,
    datum: Array,
    row_scale: Array,
    dt: float,
) -> Crossing:
    """Solve the carriers through one window, sample by sample; the window is widened or narrowed to the grid.

    The actuators are off from the first to the last sample inside the window.

    Raises:
        InfeasiblePlanError: a force that nothing can carry at a singular pose, or a sample without solution.
    """
    first = int(np.ceil((window.start - motion.start) / dt - 1e-9))
    last = max(int(np.floor((window.end - motion.start) / dt + 1e-9)), first)
    steps = min(max(1, round(ramp_time / dt)), first)
    t: Array = motion.start + dt * np.arange(first - steps, last + 1, dtype=np.float64)
    snapped = Interval(float(t[steps]), float(t[-1]), window.open_start, window.open_end)
    equation, lost = crossing_equation(dynamics, motion, snapped, float(t[0]), datum, row_scale)
    model = equation.model.at(t)
    load = np.einsum("nij,nj->ni", model.W, equation.effort(t))
    s = np.tile(datum, (len(t) + 2, 1))  # two samples at rest before the first
    for i in range(len(t)):
        s[i + 2] = _position(equation, model, i, load[i], s[i + 1], s[i], dt)
    sd = np.diff(s, axis=0) / dt
    carriers = CarrierMotion(s[2:], sd[1:], np.diff(sd, axis=0) / dt)
    # s̈ of a sample is that of the step which ends there; the first sample only starts one
    position = PiecewisePolynomial.constant_acceleration(t, s[2:], carriers.sd, carriers.sdd)
    return Crossing(snapped, equation.effort, position.made_continuous(), lost, (read_only(t), carriers))


def _position(
    equation: CarrierEquation, model: CarrierModel, i: int, load: Array, last: Array, before: Array, dt: float
) -> Array:
    """Solve f(s, (s − s₁)/dt, (s − 2 s₁ + s₂)/dt²) = W τ_ref for s (k,) by Newton's method."""
    by_s, by_s2, by_sd, by_ssd, by_sdd = np.moveaxis(model.f_terms[i] / equation.row_scale[:, None, None], -1, 0)
    target = (load - model.f0[i]) / equation.row_scale
    s = 2.0 * last - before
    left = np.inf
    for _ in range(_MOST_ITERATIONS):
        sd, sdd = (s - last) / dt, (s - 2.0 * last + before) / dt**2
        residual = target - by_s @ s - by_s2 @ (s * s) - by_sd @ sd - by_ssd @ (s * sd) - by_sdd @ sdd
        left = float(np.abs(residual).max())
        if left <= STEP_TOLERANCE * equation.size:
            return s
        slope = by_s + 2.0 * by_s2 * s + by_sd / dt + by_ssd * (sd + s / dt) + by_sdd / dt**2
        s = s + np.linalg.lstsq(slope, residual, rcond=None)[0]
    t = float(model.t[i])
    raise InfeasiblePlanError(
        f"At t = {t:.6g} s no position of the carriers balances the prescribed efforts: {left:.3g} N are left.",
        remedy="Use the integration scheme, or a shorter step.",
        constraint="carrier_motion",
        time=t,
        amount=left,
    )
