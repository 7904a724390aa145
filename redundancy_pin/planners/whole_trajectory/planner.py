"""Carriers and main efforts planned together over a whole trajectory, through singularities and within every limit."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import SampleStatus
from redundancy_pin.errors import InfeasiblePlanError, UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.limits import LimitEvent, Limits, grouped, limits_broken
from redundancy_pin.planners.plan import Plan, PlanStatus, finish_plan
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.planners.whole_trajectory.coefficients import Problem, Task, read_coefficients
from redundancy_pin.planners.whole_trajectory.infeasibility import relax
from redundancy_pin.planners.whole_trajectory.mesh import (
    Grid,
    grid_of,
    near_singular,
    singular_instants,
    widened,
    with_middles,
)
from redundancy_pin.planners.whole_trajectory.multistart import (
    Multistart,
    Outcome,
    first_guess,
    fit_and_solve,
    multistart,
)
from redundancy_pin.planners.whole_trajectory.options import End, Mesh, Objective, Solver, checked_settings
from redundancy_pin.planners.whole_trajectory.solver import OUT_OF_TIME, solve
from redundancy_pin.planners.whole_trajectory.transcription import objective_values
from redundancy_pin.trajectory.functions_of_time import (
    PiecewisePolynomial,
    TimedTrajectory,
    carriers_at,
    continuous_motion,
)

FINER = 20
"""Points in a step."""

CLOSE = (1e-3, 1e-2)
"""Further points beside singular nodes, as fractions of the step."""

ALLOWED = 1.05
"""Largest effort between the nodes over the largest at the nodes that is accepted."""

MARKED = 1.02
"""Ratio from which a step gets a middle node once any exceeds what is accepted."""

BESIDE = 4
"""Steps on both sides of such a step that get one as well: the next plan would have its kink just beside the refined
steps, and the grid would follow it one step at a time."""

SMALL = 1e-3
"""Efforts below this fraction of the size of the efforts count as zero here."""


@dataclass(frozen=True, eq=False)
class DenseCheck:
    """Efforts τ = W⁻¹ f of the planned motion between the nodes, and carrier forces, by the backend.

    Attributes:
        peak: largest |τ| between the nodes, N or N·m.
        time: where, s.
        peak_at_nodes: largest |τ| at the nodes.
        ratio: of both, or of the effort of an actuator and its limit where that is lower than the peak at the nodes;
            efforts that are nothing beside those of the parked robot count as equal.
        points: number of points.
        exceeding: (M − 1,) steps in which the efforts exceed those at the nodes, or carrier forces their limits, by
            what is worth a middle node, and those beside them.
        broken: limits of main efforts and carrier forces that are exceeded between the nodes by more than is accepted.
    """

    peak: float
    time: float
    peak_at_nodes: float
    ratio: float
    points: int
    exceeding: BoolArray
    broken: tuple[LimitEvent, ...]

    @property
    def passed(self) -> bool:
        """Whether efforts and forces between the nodes are accepted."""
        return self.ratio <= ALLOWED and not self.broken

    @property
    def summary(self) -> dict[str, object]:
        """The check as plain data."""
        return {
            "finer": FINER,
            "points": self.points,
            "peak_effort": self.peak,
            "time_of_peak": self.time,
            "peak_effort_at_nodes": self.peak_at_nodes,
            "ratio": self.ratio,
            "passed": self.passed,
        }


def dense_check(task: Task, problem: Problem, position: PiecewisePolynomial, tau: Array) -> DenseCheck:
    """Evaluate the backend on a grid finer than the nodes, and right beside the singular ones.

    ``position``: of the planned carriers, m; ``tau`` (M, m) planned efforts at the nodes, N or N·m.
    """
    grid, settings, robot = problem.grid, task.settings, task.dynamics.robot
    left = np.flatnonzero(grid.h > 0.0)
    inside = grid.t[left, None] + grid.h[left, None] * np.arange(1, FINER) / FINER
    steps = [(i, i + side) for i in grid.singular for side in (-1, 0) if 0 <= i + side < len(grid.h)]
    beside = [grid.t[i] + (1.0 if j == i else -1.0) * fraction * grid.h[j] for i, j in steps for fraction in CLOSE]
    # nodes were judged already; between them no acceleration jumps, so every time may stand once
    times = np.setdiff1d(np.concatenate([inside.ravel(), beside]), grid.t)
    reduced = task.dynamics.along(task.source.sample_at(times)).reduce(carriers_at(position, times))
    # with more actuators than coordinates the efforts nearest to the planned ones, which are linear in a step
    planned = PlanFunctions(task.source, position, preferred=PiecewisePolynomial.linear(grid.t, tau))
    efforts, forces = planned.efforts(reduced), np.asarray(reduced.carrier_force)
    effort_limit, force_limit = settings.limits.effort, settings.limits.carrier_force
    size, at_nodes = np.where(np.isfinite(efforts), np.abs(efforts), np.inf), float(np.abs(tau).max())
    # an actuator with a limit below the peak of the others is judged by its limit
    relative = (size / np.maximum(np.minimum(at_nodes, effort_limit), SMALL * problem.scales.tau)).max(axis=1)
    marked = (relative > MARKED) | (np.abs(forces) > MARKED * force_limit).any(axis=1)
    exceeding = np.zeros(len(grid.h), dtype=bool)
    exceeding[np.searchsorted(grid.t, times[marked], side="right") - 1] = True
    worst = int(size.max(axis=1).argmax())
    return DenseCheck(
        peak=float(size[worst].max()),
        time=float(times[worst]),
        peak_at_nodes=at_nodes,
        ratio=max(float(relative.max()), 1.0),
        points=len(times),
        exceeding=widened(exceeding, BESIDE),
        broken=limits_broken("effort", robot.actuated, times, efforts, effort_limit, ALLOWED)
        + limits_broken("force", robot.carriers, times, forces, force_limit, ALLOWED),
    )


PHASES = ("optimised",)

ROUNDING = 1e-6
"""Relative excess of an effort at a node over its limit that counts as rounding."""


def plan_whole_trajectory(
    dynamics: Dynamics,
    motion: PlatformMotion | TimedTrajectory,
    *,
    objective: str | Mapping[str, float] | Objective = "effort",
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
    limits: Limits | None = None,
    mesh: Mesh | None = None,
    solver: Solver | None = None,
) -> Plan:
    """Plan the carriers' motion and the main efforts together, over the whole motion of the platform.

    The efforts τ are unknowns and W τ = f(s, ṡ, s̈) is a constraint, so W may lose rank. Type II singularities on the
    way are found exactly and lie on nodes. There f has to lie in the range of W (compatibility), τ is what W⁻¹ f tends
    to (``whole_trajectory.coefficients``), and the carriers' jerk is continuous, which makes both limits the same.

    s̈ is linear between the nodes and may jump only where the reference acceleration jumps; s and ṡ follow exactly.
    Track and speed limits hold between the nodes as well, by their Bézier hulls where they are met. For carriers on
    straight tracks f is quadratic in (s, ṡ) and affine in s̈ with coefficients that depend on time alone
    (``carrier_model``): they are read off the backend in a fixed number of calls, and the solver (IPOPT) works on them.
    For carriers on curved tracks f is fitted around each course in turn (``whole_trajectory.multistart``).

    The plan is then judged by the backend on a grid 20 times finer than the nodes, right beside the singularities
    included. Where efforts between the nodes exceed the peak at the nodes, or efforts or carrier forces their limits,
    by more than 5 %, the steps get a node in the middle across which the jerk is continuous, and the plan is made again
    (``refinements``). ``diagnostics["dense_check"]`` has what is left of it; limits left exceeded by more make the
    status violates_limits, and ``limits.violated`` has them.

    Args:
        dynamics: either backend.
        motion: a trajectory, evaluated exactly wherever needed, or samples, with quintics between them.
        objective: what to minimise, or weights of several, each in its own unit (``OBJECTIVES``; or
            ``Objective``, with ``lam`` and ``baseline``): "effort" ∫ Σ τ² dt, "peak" max |τ|,
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
        limits: track, speed, acceleration, jerk, effort and carrier_force as one group in place of the keywords.
        mesh: dt and refinements, the same.
        solver: starts, seconds and progress, the same.

    Returns:
        A plan whose samples are the nodes. ``status`` is stopped_early where the solver stopped before the conditions
        of a minimum held, with every limit kept; ``diagnostics["optimal"]`` says the same.

    Raises:
        InputError: a setting out of its domain, or given both ways.
        UnsupportedRobotError: no carriers.
        InfeasiblePlanError: no motion of the carriers keeps every limit; carries constraint, carrier, time, amount and
            the limit that would suffice. Or the motion touches a type II singularity, rests in it or stays in it
            (constraint "singular_touch"), where no finite efforts are determined.
        RedundancyPinError: casadi is not installed.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as the dynamics.
    """
    began = time.perf_counter()
    if isinstance(objective, Objective):
        goal = grouped("objective", objective, Objective, lam=lam, baseline=baseline)
    else:
        goal = Objective(objective, lam, baseline)
    settings = checked_settings(
        dynamics.robot,
        goal,
        grouped(
            "limits",
            limits,
            Limits,
            track=track,
            speed=speed,
            acceleration=acceleration,
            jerk=jerk,
            carrier_force=carrier_force,
            effort=effort,
        ),
        grouped("mesh", mesh, Mesh, dt=dt, refinements=refinements),
        grouped("solver", solver, Solver, starts=starts, seconds=seconds, progress=progress),
        start=start,
        start_speed=start_speed,
        end=end,
        datum=datum,
    )
    report = settings.solver.progress or (lambda line: None)
    task = Task(dynamics, continuous_motion(motion), settings)
    nodes = grid_of(task.source, singular_instants(dynamics, task.source), settings.mesh.dt)
    nodes = with_middles(nodes, near_singular(dynamics, task.source, nodes))
    position: PiecewisePolynomial | None = None
    checks: list[DenseCheck] = []
    while True:
        report(f"{len(nodes.t)} nodes, {len(nodes.singular)} of them singular: solving")
        result = _solve(task, nodes, position)
        problem, solution = result.best.problem, result.best.solution
        position = solution.position(problem)
        check = dense_check(task, problem, position, solution.tau(problem))
        checks.append(check)
        report(f"peak effort {check.peak_at_nodes:.4g} at the nodes, {check.peak:.4g} between them")
        if check.passed or len(checks) > settings.mesh.refinements or not solution.optimal:
            return _plan(task, result, checks, time.perf_counter() - began)
        nodes = with_middles(nodes, check.exceeding)


def _solve(task: Task, nodes: Grid, warm: PiecewisePolynomial | None) -> Multistart:
    """Solve on a mesh from all first guesses, the first of which is a motion that is known."""
    try:
        problem = read_coefficients(task, nodes)
    except UnsupportedRobotError as error:
        if "deviation" not in error.details:
            raise
        # f is not the polynomial that it is for carriers on straight tracks
        parked = np.tile(task.settings.start, (len(nodes.t), 1))
        first = read_coefficients(task, nodes, CarrierMotion(parked, 0.0 * parked, 0.0 * parked))
        return multistart(first, warm, partial(fit_and_solve, task, first))

    def solve_from(guess: dict[str, Array], seconds: float) -> Outcome:
        return Outcome(problem, solve(problem, guess, seconds))

    result = multistart(problem, warm, solve_from)
    if result.feasible:
        return result
    # raises where limits are in the way; else what it returns keeps them, and the solver can begin there
    message = result.outcomes[0].solution.message
    relaxed = relax(problem, robot_record(task.dynamics.robot), first_guess(problem, warm, 0), message)
    seconds = task.settings.solver.seconds
    last = solve(problem, relaxed.values, seconds)
    if not last.feasible:
        late = last.message == OUT_OF_TIME
        raise InfeasiblePlanError(
            f"No plan was found{f' within {seconds:g} s' if late else ''} (the solver says {last.message}), "
            "although none of the limits is known to be in the way.",
            remedy="Allow more seconds, or a longer dt." if late else "Widen the limits a little, or start elsewhere.",
            constraint="seconds",
            time=float(nodes.t[0]),
            amount=seconds,
        )
    return replace(result, outcomes=(*result.outcomes, Outcome(problem, last)))


def _plan(task: Task, result: Multistart, checks: list[DenseCheck], seconds: float) -> Plan:
    """Let the backend judge the solution at the nodes, and report.

    At singular nodes the efforts are those of the solution, which W⁻¹ f tends to; elsewhere, and with as many main
    actuators as coordinates, W τ = f leaves no choice.
    """
    problem, solution = result.best.problem, result.best.solution
    robot, settings, nodes, starts = task.dynamics.robot, task.settings, problem.grid, result.summary
    prescribed = solution.tau(problem)
    if robot.m <= robot.n:
        prescribed[np.setdiff1d(np.arange(len(nodes.t)), nodes.singular)] = np.nan
    plan = finish_plan(
        task.dynamics.along(task.source.sample_at(nodes.t)),
        problem.carriers(solution.values),
        planner="whole_trajectory",
        phase=np.zeros(len(nodes.t), dtype=np.intp),
        phases=PHASES,
        parameters=settings.parameters,
        diagnostics={
            "optimal": solution.optimal,
            "solver": solution.message,
            "iterations": solution.iterations,
            "violation": solution.violation,
            "cost": solution.cost,
            "starts": starts,
            "costs": starts["costs"],
            "solver_messages": starts["messages"],
            "objective": objective_values(problem, solution.values),
            "fits": [outcome.fits for outcome in result.outcomes if outcome.fits],
            "nodes": len(nodes.t),
            "singular_instants": np.unique(nodes.t[nodes.singular]).tolist(),
            "singular_nodes": nodes.singular.tolist(),
            "smooth_nodes": np.flatnonzero(nodes.smooth).tolist(),
            "dense_check": checks[-1].summary,
            "dense_ratios": [check.ratio for check in checks],
            "solver_seconds": solution.seconds,
            "seconds": seconds,
        },
        prescribed=prescribed,
        carrier_limits=settings.limits.of_carriers,
        functions=PlanFunctions(
            task.source,
            solution.position(problem).made_continuous(),
            preferred=PiecewisePolynomial.linear(nodes.t, solution.tau(problem)),
        ),
    )
    sample_status = np.array(plan.sample_status)
    at = nodes.singular
    # the efforts there are finite and known to be the limits from both sides, however well W τ = f looks at one instant
    sample_status[at] = np.where(
        sample_status[at] == SampleStatus.REGULAR, SampleStatus.SINGULAR_CONSISTENT, sample_status[at]
    )
    at_nodes = limits_broken("effort", robot.actuated, plan.t, plan.tau, settings.limits.effort, 1.0 + ROUNDING)
    broken = sorted((*plan.limits.violated, *at_nodes, *checks[-1].broken), key=lambda event: event.start)
    status = plan.status
    if status is PlanStatus.WITHIN_LIMITS and (broken or not solution.optimal):
        status = PlanStatus.VIOLATES_LIMITS if broken else PlanStatus.STOPPED_EARLY
    limits = replace(plan.limits, violated=tuple(broken))
    return replace(plan, sample_status=read_only(sample_status), status=status, limits=limits)
