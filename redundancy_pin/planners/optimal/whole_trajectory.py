"""Carriers and main efforts planned together over a whole trajectory, through singularities and within every limit."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import BoolArray
from redundancy_pin.dynamics.default import DynamicsLike, as_cached_dynamics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.carrier_model import require_carriers
from redundancy_pin.planners.intersample_check import IntersampleCheck
from redundancy_pin.planners.optimal.calm import calmed
from redundancy_pin.planners.optimal.mesh import steps_around, with_middles
from redundancy_pin.planners.optimal.problem import Problem, Task, read_problem
from redundancy_pin.planners.optimal.refine import Planning, plan_and_refine
from redundancy_pin.planners.optimal.settings import REFUSED, End, checked_settings
from redundancy_pin.planners.optimal.solve import Outcome
from redundancy_pin.planners.optimal.transcription import objective_sizes, objective_values
from redundancy_pin.planners.options import Limits, Mesh, Objective, Solver, takes_groups
from redundancy_pin.planners.plan import Plan
from redundancy_pin.trajectory.continuous_motion import Motion, TimedTrajectory, as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

NEIGHBOURS = 4
"""Steps on both sides of one with a middle node that get one as well: otherwise the kink of the next plan would be next
to the refined steps, and the grid would follow it one step at a time."""


TWICE = 1.08
"""Ratio of efforts between the nodes to those at them from which steps are halved twice."""


@takes_groups(REFUSED)
@np.errstate(under="ignore")  # numbers too small to matter become zero, whatever the caller has numpy do
def plan_whole_trajectory(
    dynamics: DynamicsLike,
    motion: PlatformMotion | TimedTrajectory,
    *,
    objective: str | Mapping[str, float] | Objective = "effort",
    limits: Limits | None = None,
    mesh: Mesh | None = None,
    solver: Solver | None = None,
    start: ArrayLike | None = None,
    start_speed: ArrayLike = 0.0,
    end: End = "datum",
    datum: ArrayLike = 0.0,
    at_most: Mapping[str, float] | None = None,
) -> Plan:
    """Plan the carriers' motion and the main efforts together, over the whole motion of the platform.

    The efforts τ are unknowns and W τ = f(s, ṡ, s̈) is a constraint, so W may lose rank. Type II singularities on the
    way are found exactly and lie on nodes. There f has to lie in the range of W (compatibility), τ is what W⁻¹ f tends
    to (``optimal.problem``), and the carriers' jerk is continuous, which makes both limits the same.

    s̈ is linear between the nodes and may jump only where the reference acceleration jumps; s and ṡ follow exactly.
    Track and speed limits hold between the nodes as well, by their Bézier hulls where they are met. For carriers on
    straight tracks f is quadratic in (s, ṡ) and affine in s̈ with coefficients that depend on time alone
    (``carrier_model``): they are read off the backend in a fixed number of calls, and the solver (IPOPT) works on them.
    Carriers that turn add waves of their angles. Where f has yet other terms, as with carriers on carriers, it is the
    expression of generated code (``CompiledDynamics``).

    With more main actuators than degrees of freedom W τ = f leaves efforts a choice. Where the objective leaves it open
    as well, as "energy" does at rest, where no effort takes power, the plan has the efforts of least Σ (τ_j / c_j)²,
    c_j the characteristic length for torques and 1 for forces, as ``distribute``.

    The backend then checks the plan between the nodes, the neighbourhood of singularities included. Where efforts
    there exceed the peak at the nodes by more than 5 %, or efforts or carrier forces their limits by more than 2 %, the
    steps get a node in the middle across which the jerk is continuous, and the plan is made again
    (``Mesh.refinements``). A smaller excess is met by lower limits at the adjacent nodes.
    ``between`` has the remaining excess; limits exceeded by more than 0.1 % make the status
    limit_violated, and ``limits.violated`` has them.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend.
        motion: a trajectory, evaluated exactly wherever needed, or samples, with quintics between them.
        objective: what to minimise, or weights of several, each in its own unit (``OBJECTIVES``); or ``Objective``,
            which documents some of them further: "effort" ∫ Σ τ² dt, "peak" max |τ|,
            "tracking" ∫ Σ (τ − λ τ̂)² dt, "carrier_force" ∫ Σ F² dt, "carrier_acceleration" ∫ Σ s̈² dt,
            "effort_rate" ∫ Σ τ̇² dt (0.01 of it added to "effort" calms the efforts next to singularities), "energy"
            ∫ Σ |τ q̇| + Σ |F ṡ| dt; "base_force" ∫ |F_b|² dt, "base_moment" ∫ |M_b|² dt and "base_wrench"
            ∫ |F_b|² + |M_b|²/ℓ² dt, ℓ the characteristic length: what the base feels beyond the load at rest where the
            motion begins (``planners.base_wrench``); "ripple" ∫ Σ ((τ − τ̄)/τ₀)² + 0.1 Σ ((s̈ − s̄)/s₀)² dt / T, with bars
            for the line through the neighbouring nodes and τ₀, s₀ the sizes of τ and s̈: what ``calm`` minimises.
            Where an effort of the least-cost plan reverses more than 10 times (``Plan.reversals``), the plan is the one
            with the least ripple that costs at most 1 + ``calm`` times as much at the nodes; 0 for the least-cost plan.
            Between them no bound holds: measured, the whole motion costs 1.0 to 3.4 % more than the least cost at the
            nodes, and 3.2 % less to 3.1 % more than the least-cost plan as a whole (docs/planning.md, *Calm
            plans*). ``plan.least_cost`` is the least cost at the nodes, ``diagnostics["calm"]`` whether a calmer
            plan was kept.
        limits: in place of the robot's own. ``actuator_speed`` is judged: the motion is given.
        mesh: ``dt`` and ``refinements``.
        solver: of several ``starts`` the best optimum is kept. ``diagnostics["starts"]`` has how many were requested,
            tried and converged, which optima they led to (cost and first guesses of each, best first), which guess won,
            and all costs and messages.
        start: scalar or (k,) positions at the start, m; the datum when left out.
        start_speed: scalar or (k,) speeds there, m/s.
        end: "free", "rest", "datum" (at rest there), or "periodic" (s, ṡ, s̈ as at the start).
        datum: scalar or (k,) where the carriers park, m.
        at_most: bounds of further objectives at the nodes, by name, each in its unit:
            ``objective="peak", at_most={"energy": 2.0}``.

    Returns:
        A plan whose samples are the nodes. ``status`` is not_converged if the solver stopped before the conditions
        of a minimum were met, with every limit kept; ``findings.optimal`` is then False.

    Raises:
        InputError: a setting out of its domain, or one that does not apply.
        UnsupportedRobotError: no carriers; or a carrier carries another, and the backend has f as no expression.
        InfeasiblePlanError: no motion of the carriers keeps every limit; carries constraint, joint, time, amount and
            the limit that would suffice. Or the motion touches a type II singularity, rests in it or stays in it
            (constraint "singular_touch"), where no finite efforts are determined.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as the dynamics.

    Example:
        >>> line = rp.trajectory.reference.line(speed=0.2)
        >>> plan = rp.plan_whole_trajectory("2rpr", line, mesh=rp.Mesh(dt=0.05))
        >>> plan.status.value
        'ok'
    """
    dynamics = as_cached_dynamics(dynamics)
    source = as_motion(motion)
    require_carriers(dynamics.robot)
    settings = checked_settings(
        dynamics.robot, objective, limits, mesh, solver, start, start_speed, end=end, datum=datum, at_most=at_most
    )
    return optimise(Task(dynamics, source, settings))[0]


class WholeTrajectory(Planning):
    """A plan over a given motion of the platform."""

    name = "whole_trajectory"

    def platform(self, outcome: Outcome) -> Motion:
        """Return the motion of the task."""
        return self.task.source

    def finer(self, outcome: Outcome, found: IntersampleCheck, marked: BoolArray, first: bool) -> Problem:
        """Return the problem with nodes in the middle of steps in which efforts are larger, and of their neighbours."""
        # on the first mesh the carriers still exploit gaps between the nodes; most of these vanish on finer meshes
        nodes = outcome.problem.grid
        for least in (0.0,) if first else (0.0, TWICE):
            nodes = with_middles(nodes, steps_around(nodes.t, found.middle[marked & (found.worst > least)], NEIGHBOURS))
        return read_problem(self.task, nodes, outcome.problem)


def optimise(task: Task, position: PiecewisePolynomial | None = None) -> tuple[Plan, Outcome]:
    """Return the plan of a task, and the programme and solution of least cost; as ``plan_whole_trajectory``.

    ``position``: of the carriers, to begin with in place of parked ones.
    """
    began, planning = time.perf_counter(), WholeTrajectory(task)
    planned = plan_and_refine(planning, position)
    left = began + task.settings.solver.seconds - time.perf_counter()
    chosen, calming = calmed(planning, planned, left)
    least, best = planned.best, chosen.best
    costs = objective_values(least.problem, least.values)
    plan = chosen.plan(
        task.settings.parameters,
        replace(planned.findings, least_cost=task.settings.weighted(costs)),
        iterations=least.solution.iterations,
        solver_seconds=least.solution.seconds,
        cost=least.solution.cost,
        starts=planned.solutions.summary,
        objective=objective_values(best.problem, best.values),
        objective_size=objective_sizes(best.problem),
        calm=calming,
        seconds=time.perf_counter() - began,
    )
    return plan, least
