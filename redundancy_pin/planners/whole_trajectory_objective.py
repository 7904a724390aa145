"""What a whole trajectory minimises: quadratic or linear in the variables of the programme."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_program import Program

REGULARISATION = 1e-5
"""Weight of the mean square of s̈ over its limit beside an objective of size one: where the objective leaves the
carriers open they take the gentlest motion, and the plan is unique."""


SHARED = 8
"""Nodes that share one copy of the peak; 8 and 32 are a tenth faster than 1 and than all."""


def add_objective(
    program: Program,
    problem: WholeProblem,
    A: IntArray,
    tau: IntArray,
    force: IntArray | None,
    V: IntArray,
    price: float,
) -> None:
    """Add the weighted objectives over their common size, times a price, and the regularisation.

    Integrals are trapezoidal sums over the nodes.
    """
    settings, scales = problem.settings, problem.scales
    w = problem.grid.weights[:, None]
    duration = float(w.sum())
    units = _units(problem, duration)
    whole = sum(weight * units[name] for name, weight in settings.objective.items())
    program.charge_square(A, price * REGULARISATION * w / duration)
    for name, weight in settings.objective.items():
        share = price * weight / whole
        if name in ("effort", "tracking"):
            program.charge_square(tau, share * w * scales.tau**2)
            if name == "tracking":
                program.charge(tau, -2.0 * share * w * scales.tau * problem.target)
        elif name == "peak":
            # a copy every few nodes, all equal: a single variable in every row would fill the solver's factors
            copies = program.variable("peak", (-(-len(tau) // SHARED),), 0.0)
            top = np.repeat(copies, SHARED)[: len(tau)]
            for sign in (1.0, -1.0):
                rows = program.rows(tau.shape, -np.inf, 0.0)
                program.add(rows, tau, sign)
                program.add(rows, top[:, None], -1.0)
            same = program.rows((len(copies) - 1,))
            program.add(same, copies[1:], 1.0)
            program.add(same, copies[:-1], -1.0)
            # on all copies alike, else the solver scales the whole objective by its one large slope
            program.charge(copies, share * scales.tau / len(copies))
        elif name == "carrier_acceleration":
            program.charge_square(A, share * w * scales.sdd**2)
        elif name == "effort_rate":
            _charge_effort_rate(program, problem, tau, share)
        elif force is not None and name == "carrier_force":
            program.charge_square(force, share * w * scales.force**2)
        elif force is not None:
            _charge_energy(program, problem, tau, force, V, share)


def _units(problem: WholeProblem, duration: float) -> dict[str, float]:
    """Return the size of each objective, in its unit."""
    scales = problem.scales
    power = scales.tau * (float(np.abs(problem.actuated_rate).max()) or 1.0)
    return {
        "effort": duration * scales.tau**2,
        "tracking": duration * scales.tau**2,
        "peak": scales.tau,
        "carrier_force": duration * float((scales.force**2).max()),
        "carrier_acceleration": duration * float((scales.sdd**2).max()),
        "effort_rate": scales.tau**2 / duration,
        "energy": duration * power,
    }


def _charge_effort_rate(program: Program, problem: WholeProblem, tau: IntArray, share: float) -> None:
    """Charge ∫ Σ τ̇² dt, the efforts linear between the nodes; they may jump where the reference does."""
    h = problem.grid.h
    at = np.flatnonzero(h > 0.0)
    change = program.variable("effort_change", (len(at), tau.shape[1]))
    rows = program.rows(change.shape)
    for variables, sign in ((tau[at + 1], 1.0), (tau[at], -1.0), (change, -1.0)):
        program.add(rows, variables, sign)
    program.charge_square(change, share * problem.scales.tau**2 / h[at, None])


def _charge_energy(
    program: Program, problem: WholeProblem, tau: IntArray, force: IntArray, V: IntArray, share: float
) -> None:
    """Charge the integral of powers p with p ≥ |τ q̇| and p ≥ |F ṡ|."""
    scales, w = problem.scales, problem.grid.weights[:, None]
    unit = scales.tau * (float(np.abs(problem.actuated_rate).max()) or 1.0)
    main = program.variable("main_power", tau.shape, 0.0)
    own = program.variable("carrier_power", force.shape, 0.0)
    for sign in (1.0, -1.0):
        rows = program.rows(tau.shape, 0.0, np.inf)
        program.add(rows, main, 1.0)
        program.add(rows, tau, sign * problem.actuated_rate * scales.tau / unit)
        rows = program.rows(force.shape, 0.0, np.inf)
        program.add(rows, own, 1.0)
        program.add_product(rows, force, V, sign * scales.force * scales.sd / unit)
    for block in (main, own):
        program.charge(block, share * w * unit)


def value(problem: WholeProblem, values: dict[str, Array]) -> dict[str, float]:
    """Return each weighted objective at the nodes, in its unit, unweighted."""
    scales, w = problem.scales, problem.grid.weights[:, None]
    tau = values["tau"] * scales.tau
    found: dict[str, float] = {}
    for name in problem.settings.objective:
        if name == "effort":
            found[name] = float((w * tau**2).sum())
        elif name == "tracking":
            found[name] = float((w * (tau - problem.target) ** 2).sum())
        elif name == "peak":
            found[name] = float(np.abs(tau).max())
        elif name == "effort_rate":
            h = problem.grid.h
            at = np.flatnonzero(h > 0.0)
            found[name] = float((np.diff(tau, axis=0)[at] ** 2 / h[at, None]).sum())
        elif name == "carrier_acceleration":
            found[name] = float((w * (values["sdd"] * scales.sdd) ** 2).sum())
        elif name == "carrier_force":
            found[name] = float((w * (values["force"] * scales.force) ** 2).sum())
        else:
            main = np.abs(tau * problem.actuated_rate)
            own = np.abs(values["force"] * scales.force * values["sd"] * scales.sd)
            found[name] = float((w * main).sum() + (w * own).sum())
    return found
