"""Least time along a path under limits of efforts and carriers: timing and carriers planned together."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, frozen
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.planners.carrier_model import require_carriers
from redundancy_pin.planners.intersample_check import IntersampleCheck, intersample_check
from redundancy_pin.planners.optimal.infeasible import Relaxation
from redundancy_pin.planners.optimal.mesh import NEAR_SINGULAR, steps_around, with_nodes
from redundancy_pin.planners.optimal.path_problem import PathTask
from redundancy_pin.planners.optimal.problem import Problem, at_pace, read_problem, required
from redundancy_pin.planners.optimal.refine import Planning, plan_and_refine
from redundancy_pin.planners.optimal.settings import REFUSED_ON_A_PATH, Begin, End, checked_settings
from redundancy_pin.planners.optimal.solve import Outcome, first_guess
from redundancy_pin.planners.optimal.transcription import VARIABLES, scaled_bounds, slack_name
from redundancy_pin.planners.options import Limits, Mesh, Solver, takes_groups
from redundancy_pin.planners.plan import Plan
from redundancy_pin.trajectory.continuous_motion import Motion, as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import Path
from redundancy_pin.trajectory.timing import TimingLaw, uniform_law
from redundancy_pin.trajectory.trajectory import Trajectory

NEIGHBOURS = 2
"""Steps on both sides of one whose efforts exceed their limits inside it that get a middle node as well."""

CLOSED = 1e-9
"""Distance of the ends of a path, relative to its length, and difference of their directions, up to which it is closed:
rounding of a path that is put together of arcs and lines."""

HALVED_AGAIN = (0.0, 1.5, 8.0, 64.0)
"""Ratios of efforts between the nodes to those at them, or to their limits, from which steps are halved once, twice,
three and four times: at a cusp of the path, where the platform nearly stops, 1000 is usual on the first mesh."""

LONGEST_STEP = 0.05
"""Largest step of a refined mesh, as a fraction of the whole time; it matters where the platform nearly rests."""

NEVER_KEPT = ("effort", "carrier_force", "track")
"""Limits that a motion may exceed at any speed, for example under gravity near a singularity."""


@takes_groups(REFUSED_ON_A_PATH)
@np.errstate(under="ignore")  # numbers too small to matter become zero, whatever the caller has numpy do
def plan_time_optimal(
    dynamics: DynamicsLike,
    path: Path | Trajectory,
    *,
    limits: Limits | None = None,
    mesh: Mesh | None = None,
    solver: Solver | None = None,
    begin: Begin = "datum",
    end: End = "datum",
    datum: ArrayLike = 0.0,
    lap: bool = False,
) -> Plan:
    """Plan the timing along a path, the carriers' motion and the main efforts such that the time is least.

    At places p on the path, type II singularities and jumps of the curvature among them, unknown are ṗ, p̈, s, ṡ, s̈ and
    τ, and between them the durations of the steps, in which p̈ and s̈ are linear. W is known at each place and may lose
    rank there; the rest is as in ``plan_whole_trajectory``: a plan within limits exceeds none by more than 0.1 %,
    between the nodes too. p̈ and s̈ jump where the curvature does. Efforts that neither W τ = f nor the least time
    determines are the smallest ones.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend.
            The robot need not have carriers, and may have more actuators than degrees of freedom.
        path: a path; of a trajectory its path.
        limits: in place of the robot's limits. Without a limit of efforts or of the actuators' rates no least time
            time.
        mesh: ``steps`` and ``refinements``: how often steps may be halved whose efforts or rates exceed their limits
            inside.
        solver: ``seconds`` and ``progress``.
        begin: "datum" (at rest there), "rest" (at rest anywhere) or "free" (carriers in motion).
        end: "free", "rest", "datum", or "periodic": s, ṡ, s̈ as at the start.
        datum: scalar or (k,) where the carriers park, m.
        lap: whether the motion repeats: ṗ and p̈ at the end are those at the start, and need not be zero. The path is
            closed.

    Returns:
        A plan whose samples are the nodes, from t = 0; ``plan.t[-1]`` is the time it takes. ``limits.binding`` names
        the limits that it touches.

    Raises:
        InputError: a setting out of its domain, or one that does not apply; neither an effort nor an actuator's speed
            is limited; a lap of a path that is not closed.
        UnsupportedRobotError: f has terms that are not covered, as of dry friction.
        InfeasiblePlanError: no timing keeps the limits, as under gravity where they are below what holding takes: it
            names those that would suffice, as ``plan_whole_trajectory``. Or a singularity is touched.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as the dynamics.

    Example:
        >>> bare = rp.load_robot("3rrr", carriers=False, working_mode=(1, 1, 1))
        >>> path = rp.trajectory.reference.corner().path
        >>> plan = rp.plan_time_optimal(bare, path, limits=rp.Limits(effort=3.03))
        >>> round(float(plan.t[-1]), 2)
        1.07
    """
    options = {"limits": limits, "mesh": mesh, "solver": solver, "begin": begin, "end": end, "datum": datum, "lap": lap}
    return optimise_timing(path_task(as_dynamics(dynamics), path, **options))[0]


def path_task(dynamics: Dynamics, path: Path | Trajectory, **options: Any) -> PathTask:
    """Return the task of ``plan_time_optimal`` after checking every option.

    Raises:
        InputError: as ``plan_time_optimal``.
    """
    path = path.path if isinstance(path, Trajectory) else path
    if not (hasattr(path, "evaluate") and hasattr(path, "length")):
        raise InputError(
            f"A path was expected, not {type(path).__name__}.",
            remedy="Pass a path or a trajectory: samples have a timing of their own.",
            name="path",
        )
    settings = checked_settings(dynamics.robot, length=path.length, **options)
    if not (np.isfinite(settings.limits.effort).any() or np.isfinite(settings.limits.actuator_speed).any()):
        raise InputError(
            "Nothing limits the time.",
            remedy="Limit the efforts, as by effort=2.0, or the rates of the actuators, as by actuator_speed=1.0.",
            name="effort",
        )
    if dynamics.robot.k:
        require_carriers(dynamics.robot)
    unit = as_motion(Trajectory(path, uniform_law(path.length, path.length)))
    if settings.lap:
        _require_closed(unit)
    return PathTask(dynamics, unit, settings, path)


def optimise_timing(task: PathTask) -> tuple[Plan, Outcome, Motion]:
    """Return the plan of a task, the programme and solution of least time, and the motion of the platform.

    Raises:
        InfeasiblePlanError, UnsupportedRobotError: as ``plan_time_optimal``.
    """
    began = time.perf_counter()
    settings = task.settings
    planned = plan_and_refine(LeastTime(task))
    parameters = {
        "begin": settings.begin,
        "end": settings.end,
        "lap": settings.lap,
        "datum": settings.datum.tolist(),
        "steps": round(task.path.length / settings.dt),
        "seconds": settings.solver.seconds,
        "refinements": settings.refinements,
    }
    plan = planned.plan(parameters, planned.findings, seconds=time.perf_counter() - began)
    return plan, planned.best, planned.motion.functions.platform


class LeastTime(Planning):
    """A plan of the timing along a path."""

    name = "time_optimal"
    task: PathTask

    def platform(self, outcome: Outcome) -> Motion:
        """Return the motion of the platform along the path by the law of a solution."""
        law, t = law_of(outcome), outcome.problem.times(outcome.values)
        breaks = t[:-1][outcome.problem.grid.h == 0.0]
        knots = frozen(np.setdiff1d(law.edges[1:-1], breaks))
        timed = Trajectory(self.task.path, TimingLaw.of(law, self.task.path.length))
        return Motion(timed, law.start, law.end, law.end, frozen(breaks), knots, True)

    def finer(self, outcome: Outcome, found: IntersampleCheck, marked: BoolArray, first: bool) -> Problem:
        """Return the problem with nodes halfway in time in the steps around the times that exceed, and in long ones.

        In steps that are halved once the jerk is continuous there: the efforts are seen, and no more is free. Those
        that are halved more often need more freedom, as at a cusp, where p̈ changes within a step of the first mesh.
        """
        problem = outcome.problem
        grid, times = problem.grid, problem.times(outcome.values)
        h = np.diff(times)
        is_long = h > LONGEST_STEP * times[-1]
        halvings = is_long.astype(int)
        for count, least in enumerate(HALVED_AGAIN, start=1):
            halvings[steps_around(times, found.middle[marked & (found.worst > least)], NEIGHBOURS)] = count
        halvings[h == 0.0] = 0
        smooth = ~is_long & (halvings == 1)
        steps = np.repeat(np.arange(len(h)), 2**halvings - 1)
        share = np.concatenate([np.arange(1, 2**level) / 2**level for level in halvings.tolist()])
        # ṗ is quadratic in a step with Bézier points of at least zero: an eighth of the step or more is on either side
        places = law_of(outcome)(times[steps] + share * h[steps])[:, 0]
        return read_problem(self.task, with_nodes(grid, steps, places, smooth[steps]), problem)

    def relaxation(self, problem: Problem) -> Relaxation:
        """Return a relaxation of the loads from the motion with parked carriers."""
        kinds = required(problem.timing).exceeded_parked or NEVER_KEPT[: 3 if self.task.dynamics.robot.k else 1]
        return Relaxation(_parked(problem, kinds), kinds, self._finer_relaxed)

    def _finer_relaxed(self, outcome: Outcome) -> Problem | None:
        found = intersample_check(self.planned(outcome))
        found = replace(found, use=np.zeros_like(found.use))  # limits that give way are no reason
        marked = found.too_coarse([])
        return self.finer(outcome, found, marked, False) if marked.any() else None


def _parked(problem: Problem, kinds: tuple[str, ...]) -> dict[str, Array]:
    """Return a harmonic motion with parked carriers, its loads, and the fractions by which these exceed limits."""
    guess, u = first_guess(problem), problem.scales
    loads = at_pace(problem.model, required(problem.timing).powers(guess))
    tau: Array = np.einsum("nmi,ni->nm", np.linalg.pinv(loads.W, rcond=NEAR_SINGULAR), loads.f0)
    guess |= {"tau": tau / u.tau, "force": loads.force0 / u.force}
    bounds = scaled_bounds(problem)
    for kind in set(kinds) & {"effort", "carrier_force"}:
        use = np.abs(guess[VARIABLES[kind]]) / bounds[kind][1]
        guess[slack_name(kind)] = np.array([[max(float(use.max(initial=0.0)) - 1.0, 0.0)]])
    return guess


def law_of(outcome: Outcome) -> PiecewisePolynomial:
    """Return the place on the path as a function of time, m."""
    problem, values = outcome.problem, outcome.values
    timing = required(problem.timing)
    pd, pdd = values["pd"] * timing.speed, values["pdd"] * timing.acceleration
    return PiecewisePolynomial.linear(problem.times(values), problem.grid.t[:, None], pd, pdd)


def _require_closed(unit: Motion) -> None:
    ends = unit.sample_at(np.array([unit.start, unit.end]))
    gap, turn = (float(np.abs(np.diff(part, axis=0)).max()) for part in (ends.x, ends.xd))
    if gap > CLOSED * unit.end or turn > CLOSED:
        raise InputError(
            f"The path ends {gap:.3g} from where it begins, and its direction differs by {turn:.3g}.",
            remedy="A lap needs a closed path, such as a circle or a square.",
            name="lap",
        )
