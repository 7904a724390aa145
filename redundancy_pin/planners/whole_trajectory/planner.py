"""Carriers and main efforts planned together over a whole trajectory, through singularities and within every limit."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import BoolArray, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import SampleStatus
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.kinematics.spectrum import scaled, spectrum_of
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.plan import Plan, PlanStatus, finish_plan
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.planners.whole_trajectory.curved_tracks import search_curved
from redundancy_pin.planners.whole_trajectory.dense_check import DenseCheck, dense_check, limits_broken
from redundancy_pin.planners.whole_trajectory.mesh import Grid, grid_of, singular_instants, with_middles
from redundancy_pin.planners.whole_trajectory.multistart import Found, search
from redundancy_pin.planners.whole_trajectory.problem import Task, WholeProblem, prepare
from redundancy_pin.planners.whole_trajectory.settings import End, Objective, checked_settings
from redundancy_pin.planners.whole_trajectory.transcription import value
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, TimedTrajectory, continuous_motion

PHASES = ("optimised",)

ROUNDING = 1e-6
"""Relative excess of an effort at a node over its limit that counts as rounding."""


def assemble(task: Task, problem: WholeProblem, found: Found, checks: list[DenseCheck], seconds: float) -> Plan:
    """Let the backend judge the solution at the nodes, and report.

    At singular nodes the efforts are those of the solution, which W⁻¹ f tends to; elsewhere, and with as many main
    actuators as coordinates, W τ = f leaves no choice.
    """
    robot, best = task.dynamics.robot, found.best
    starts = found.summary
    course, tau = best.course(problem), best.tau(problem)
    prescribed = tau.copy()
    if robot.m <= robot.n:
        decided = np.ones(len(tau), dtype=bool)
        decided[problem.grid.singular] = False
        prescribed[decided] = np.nan
    plan = finish_plan(
        task.dynamics.along(task.source.sample_at(problem.grid.t)),
        course.at_nodes(),
        planner="whole_trajectory",
        phase=np.zeros(len(tau), dtype=np.intp),
        phases=PHASES,
        parameters=task.settings.parameters,
        diagnostics={
            "optimal": best.optimal,
            "solver": best.message,
            "iterations": best.iterations,
            "violation": best.violation,
            "cost": best.cost,
            "starts": starts,
            "costs": starts["costs"],
            "solver_messages": starts["messages"],
            "objective": value(problem, best.values),
            "fits": list(found.fits),
            "nodes": len(problem.grid.t),
            "singular_instants": np.unique(problem.grid.t[problem.grid.singular]).tolist(),
            "singular_nodes": [int(i) for i in problem.grid.singular],
            "smooth_nodes": [int(i) for i in np.flatnonzero(problem.grid.smooth)],
            "dense_check": checks[-1].summary,
            "dense_ratios": [check.ratio for check in checks],
            "solver_seconds": best.seconds,
            "seconds": seconds,
        },
        prescribed=prescribed,
        carrier_limits=task.settings.limits,
        functions=PlanFunctions(
            task.source,
            PiecewisePolynomial.linear_acceleration(course.t, course.s, course.sd, course.sdd).made_continuous(),
            preferred=PiecewisePolynomial.linear(course.t, tau),
        ),
    )
    status = np.array(plan.sample_status)
    at = problem.grid.singular
    status[at] = np.where(status[at] == SampleStatus.REGULAR, SampleStatus.SINGULAR_CONSISTENT, status[at])
    at_nodes = limits_broken("effort", robot.actuated, plan.t, plan.tau, task.settings.effort, 1.0 + ROUNDING)
    broken = (*plan.limits.violated, *at_nodes, *checks[-1].broken)
    verdict = plan.status
    if verdict is PlanStatus.WITHIN_LIMITS and broken:
        verdict = PlanStatus.VIOLATES_LIMITS
    elif verdict is PlanStatus.WITHIN_LIMITS and not best.optimal:
        verdict = PlanStatus.STOPPED_EARLY
    limits = replace(plan.limits, violated=tuple(sorted(broken, key=lambda event: event.start)))
    return replace(plan, sample_status=read_only(status), status=verdict, limits=limits)


NEAR = 0.2
"""Smallest over largest singular value of W below which the steps get a middle node from the start: there a kink in s̈
that is harmless elsewhere makes efforts between the nodes that the nodes do not show."""


def plan_whole_trajectory(
    dynamics: Dynamics,
    motion: PlatformMotion | TimedTrajectory,
    *,
    objective: Objective | Mapping[Objective, float] = "effort",
    lam: float = 0.0,
    baseline: Dynamics | None = None,
    start: ArrayLike | None = None,
    start_speed: ArrayLike = 0.0,
    end: End = "datum",
    datum: ArrayLike = 0.0,
    track: ArrayLike | None = None,
    speed: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    jerk: ArrayLike | None = None,
    effort: ArrayLike | None = None,
    carrier_force: ArrayLike | None = None,
    dt: float = 0.005,
    starts: int = 1,
    seconds: float = 60.0,
    refinements: int = 3,
    progress: Callable[[str], None] | None = None,
) -> Plan:
    """Plan the carriers' motion and the main efforts together, over the whole motion of the platform.

    The efforts τ are unknowns and W τ = f(s, ṡ, s̈) is a constraint, so W may lose rank. Type II singularities on the
    way are found exactly and lie on nodes. There f has to lie in the range of W (compatibility), τ is what W⁻¹ f tends
    to (``whole_trajectory_singular``), and the carriers' jerk is continuous, which makes both limits the same.

    s̈ is linear between the nodes and may jump only where the reference acceleration jumps; s and ṡ follow exactly.
    Track and speed limits hold between the nodes as well, by their Bézier hulls where they are met. For carriers on
    straight tracks f is quadratic in (s, ṡ) and affine in s̈ with coefficients that depend on time alone
    (``carrier_model``): they are read off the backend in a fixed number of calls, and the solver (IPOPT) works on them.
    For carriers on curved tracks f is fitted around each course in turn (``whole_trajectory_curved``).

    The plan is then judged by the backend on a grid 20 times finer than the nodes, right beside the singularities
    included. Where efforts between the nodes exceed the peak at the nodes, or efforts or carrier forces their limits,
    by more than 5 %, the steps get a node in the middle across which the jerk is continuous, and the plan is made again
    (``refinements``). ``diagnostics["dense_check"]`` has what is left of it; limits left exceeded by more make the
    status violates_limits, and ``limits.violated`` has them.

    Args:
        dynamics: either backend.
        motion: a trajectory, evaluated exactly wherever needed, or samples, with quintics between them.
        objective: what to minimise, or weights of several, each in its own unit: "effort" ∫ Σ τ² dt, "peak" max |τ|,
            "tracking" ∫ Σ (τ − λ τ̂)² dt, "carrier_force" ∫ Σ F² dt, "carrier_acceleration" ∫ Σ s̈² dt,
            "effort_rate" ∫ Σ τ̇² dt (0.01 of it beside "effort" calms the efforts next to singularities), "energy"
            ∫ Σ |τ q̇| + Σ |F ṡ| dt.
        lam: λ of "tracking", 0 to 1.
        baseline: backend of the robot whose efforts are τ̂.
        start: scalar or (k,) positions at the start, m; the datum when left out.
        start_speed: scalar or (k,) speeds there, m/s.
        end: "free", "rest", "datum" (at rest there), or "periodic" (s, ṡ, s̈ as at the start).
        datum: scalar or (k,) where the carriers park, m.
        track: (2,) or (k, 2) track ends in place of the robot's own, m.
        speed: scalar or (k,) limits of |ṡ| in place of the robot's own, m/s.
        acceleration: the same for |s̈|, m/s².
        carrier_force: the same for the forces of the carriers' actuators, N.
        jerk: scalar or (k,) limit of |s⃛|, m/s³; with it s̈ cannot jump.
        effort: scalar or (m,) limit of |τ|, N or N·m.
        dt: largest step between nodes, s.
        starts: number of first guesses; the first is parked carriers, the others are random swings (seeded). The best
            optimum is kept. ``diagnostics["starts"]`` says how many were asked for, tried and converged, which optima
            they led to (cost and first guesses of each, best first), which guess won, and all costs and messages.
        seconds: time bound of each solution, s.
        refinements: how often the grid may be refined.
        progress: called with a line of text at each stage, and during it where the plan has 1000 nodes or more. What it
            raises ends the planning.

    Returns:
        A plan whose samples are the nodes. ``status`` is stopped_early where the solver stopped before the conditions
        of a minimum held, with every limit kept; ``diagnostics["optimal"]`` says the same.

    Raises:
        InputError: a setting out of its domain.
        UnsupportedRobotError: no carriers.
        InfeasiblePlanError: no motion of the carriers keeps every limit; carries constraint, carrier, time, amount and
            the limit that would suffice. Or the motion touches a type II singularity, rests in it or stays in it
            (constraint "singular_touch"), where no finite efforts can be told.
        RedundancyPinError: casadi is not installed.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as the dynamics.
    """
    robot = dynamics.robot
    settings = checked_settings(
        robot,
        objective=objective,
        lam=lam,
        baseline=baseline is not None,
        start=start,
        start_speed=start_speed,
        end=end,
        datum=datum,
        track=track,
        speed=speed,
        acceleration=acceleration,
        jerk=jerk,
        effort=effort,
        carrier_force=carrier_force,
        dt=dt,
        starts=starts,
        seconds=seconds,
        refinements=refinements,
    )
    say = progress or _silent
    began = time.perf_counter()
    task = Task(dynamics, continuous_motion(motion), settings, baseline)
    instants = singular_instants(dynamics, task.source)
    grid = _watched(task, grid_of(task.source, instants, settings.dt))
    warm, curved = None, False
    checks: list[DenseCheck] = []
    while True:
        say(f"{len(grid.t)} nodes, {len(grid.singular)} of them singular: solving")
        problem = None if curved else _straight(task, grid)
        if problem is None:
            curved = True
            problem, found = search_curved(task, grid, warm, progress)
        else:
            found = search(problem, robot_record(robot), warm, settings.seconds, progress)
        warm, tau = found.best.course(problem), found.best.tau(problem)
        checks.append(dense_check(task, problem, warm, tau))
        say(f"peak effort {checks[-1].peak_at_nodes:.4g} at the nodes, {checks[-1].peak:.4g} between them")
        if checks[-1].passed or len(checks) > settings.refinements or not found.best.optimal:
            break
        grid = with_middles(grid, checks[-1].exceeding)
    return assemble(task, problem, found, checks, time.perf_counter() - began)


def _straight(task: Task, grid: Grid) -> WholeProblem | None:
    """Return the problem of carriers on straight tracks; None where f is not the polynomial it is for them."""
    try:
        return prepare(task, grid)
    except UnsupportedRobotError as error:
        if "deviation" in error.details:
            return None
        raise


def _watched(task: Task, grid: Grid) -> Grid:
    """Return the grid with a middle node in every step near a singularity."""
    reduced = task.dynamics.along(task.source.sample_at(grid.t)).reduce()
    values = spectrum_of(scaled(reduced.W, reduced.row_scale, reduced.column_scale)).singular_values
    # the only singular value of a single freedom is compared with what it is elsewhere
    size = values[:, 0] if values.shape[1] > 1 else values.max()
    near: BoolArray = values[:, -1] < NEAR * size
    return with_middles(grid, np.logical_or(near[1:], near[:-1]))


def _silent(text: str) -> None:
    """Say nothing."""
