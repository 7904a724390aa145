"""Least time along a path under limits of efforts and carriers: timing and carriers planned together."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, each, frozen, one_of, positive, read_only, whole
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import CarrierModel, require_carriers
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import LOWERED, PlannedMotion, intersample_check
from redundancy_pin.planners.limits import Limits, grouped
from redundancy_pin.planners.optimal.mesh import Grid, first_mesh, near_singular, widened
from redundancy_pin.planners.optimal.nlp import (
    FALLBACK,
    FIRST,
    LEAST_SECONDS,
    OUT_OF_TIME,
    WARM,
    Solution,
    solve_nlp,
)
from redundancy_pin.planners.optimal.objectives import LIMITS, MOST_REFINEMENTS, End
from redundancy_pin.planners.optimal.path_problem import PathScales, TimeOptimalProblem, read_model
from redundancy_pin.planners.optimal.path_transcription import transcribe
from redundancy_pin.planners.optimal.problem import SingularNode, singular_node
from redundancy_pin.planners.plan import Plan
from redundancy_pin.trajectory import Side
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion, continuous_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import Path
from redundancy_pin.trajectory.timing import TimingLaw, uniform_law
from redundancy_pin.trajectory.trajectory import Trajectory

Begin = Literal["datum", "rest", "free"]
"""How the carriers begin: at rest where they park; at rest anywhere; or anyhow."""

PHASES = ("optimised",)

BESIDE = 2
"""Steps on both sides of one whose efforts exceed their limits inside it that get a middle node as well."""

LONG = 0.05
"""Of the whole time, that a step may last when others are refined: where the platform nearly stands still."""

APART = 0.02
"""Of a step, from a node to a new one inside at least."""

ROUNDS = 4
"""Of rows between the nodes, where a carrier leaves its track or its speed limit there."""


@np.errstate(under="ignore")  # numbers too small to matter become zero, whatever the caller has numpy do
def plan_time_optimal(
    dynamics: DynamicsLike,
    path: Path | Trajectory,
    *,
    effort: ArrayLike | None = None,
    actuator_speed: ArrayLike | None = None,
    begin: Begin = "datum",
    end: End = "datum",
    datum: ArrayLike = 0.0,
    lap: bool = False,
    track: ArrayLike | None = None,
    speed: ArrayLike | None = None,
    acceleration: ArrayLike | None = None,
    jerk: ArrayLike | None = None,
    carrier_force: ArrayLike | None = None,
    steps: int = 100,
    seconds: float = 60.0,
    refinements: int = 3,
    progress: Callable[[str], None] | None = None,
    limits: Limits | None = None,
) -> Plan:
    """Plan the timing along a path, the carriers' motion and the main efforts such that the time is least.

    At places p on the path, type II singularities and jumps of the curvature among them, unknown are ṗ, p̈, s, ṡ, s̈ and
    τ, and between them the durations of the steps, in which p̈ and s̈ are linear. W is known at each place and may lose
    rank there; the rest is as in ``plan_whole_trajectory``: a plan within limits exceeds none by more than 0.1 %,
    between the nodes too. p̈ and s̈ jump where the
    curvature does.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend.
            The robot need not have carriers, and may have more actuators than degrees of freedom.
        path: a path; of a trajectory its path.
        effort: scalar or (m,) limit of |τ|, N or N·m.
        actuator_speed: scalar or (m,) limit of the main actuators' rates, m/s or rad/s.
        begin: "datum" (at rest there), "rest" (at rest anywhere) or "free" (carriers in motion).
        end: "free", "rest", "datum", or "periodic": s, ṡ, s̈ as at the start.
        datum: scalar or (k,) where the carriers park, m.
        lap: the platform goes on and on: ṗ and p̈ at the end are those at the start, and need not be zero. The path is
            closed.
        track: (2,) or (k, 2) track ends in place of the robot's own, m.
        speed: scalar or (k,) limits of |ṡ| in place of the robot's own, m/s.
        acceleration: the same for |s̈|, m/s².
        jerk: scalar or (k,) limit of |s⃛|, m/s³.
        carrier_force: the same for the forces of the carriers' actuators, N.
        steps: least number of steps.
        seconds: time bound of each solution, s.
        refinements: how often steps may be halved whose efforts or rates exceed their limits inside.
        progress: called with a line of text at each stage.
        limits: track, speed, acceleration, jerk, effort and carrier_force as one group in place of the keywords.

    Returns:
        A plan whose samples are the nodes, from t = 0; ``plan.t[-1]`` is the time it takes. ``limits.binding`` names
        the limits that it touches.

    Raises:
        InputError: a setting out of its domain; neither an effort nor an actuator's speed is limited; a lap of a path
            that is not closed.
        UnsupportedRobotError: f has terms that are not covered, as of dry friction.
        InfeasiblePlanError: no timing keeps the limits (constraint "effort"); or a singularity is touched.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as the dynamics.
    """
    began = time.perf_counter()
    dynamics = as_dynamics(dynamics)
    robot = dynamics.robot
    report = progress or (lambda line: None)
    path = path.path if isinstance(path, Trajectory) else path
    if not (hasattr(path, "evaluate") and hasattr(path, "length")):
        raise InputError(
            f"A path was expected, not {type(path).__name__}.",
            remedy="Pass a path or a trajectory: samples have a timing of their own.",
            name="path",
        )
    one_of(begin, "begin", get_args(Begin))
    one_of(end, "end", get_args(End))
    group = grouped("limits", limits, Limits, track=track, speed=speed, acceleration=acceleration, jerk=jerk,
                    carrier_force=carrier_force, effort=effort)  # fmt: skip
    resolved = group.resolved(robot)
    rates = each(np.inf if actuator_speed is None else actuator_speed, "actuator_speed", (robot.m,), above_zero=True)
    if not (np.isfinite(resolved.effort).any() or np.isfinite(rates).any()):
        raise InputError(
            "Nothing limits the time.",
            remedy="Limit the efforts, as by effort=2.0, or the rates of the actuators, as by actuator_speed=1.0; "
            "limits that the robot's joints have bind no planner.",
            name="effort",
        )
    park, count = resolved.on_track(datum, "datum"), whole(steps, "steps", 4, 100_000)
    often, bound = whole(refinements, "refinements", 0, MOST_REFINEMENTS), positive(seconds, "seconds", "s")
    if robot.k:
        require_carriers(robot)
    unit = continuous_motion(Trajectory(path, uniform_law(path.length, path.length)))
    if lap:
        _require_closed(unit)
    nodes = first_mesh(dynamics, unit, path.length / count, ends=not lap)
    within = replace(resolved, actuator_speed=rates)
    given = {"begin": begin, "end": end, "datum": park, "lap": lap, "limits": resolved}
    problem, guess = path_problem(dynamics, unit, nodes, rates, given), None
    ratios: list[float] = []
    refined = lowered = 0
    while True:
        report(f"{len(nodes.t)} nodes, {len(nodes.singular)} of them singular: solving")
        try:
            solution = solved_programme(
                problem, first_guess(problem) if guess is None else moved_guess(guess, problem), bound
            )
        except InfeasiblePlanError:
            if not (ratios and lowered):
                raise
            break  # no timing keeps the lower limits at the nodes: the last one stands, and says what it exceeds
        motion = TimedSolution.of(path, problem, solution)
        report(f"{motion.t[-1]:.6g} s")
        prescribed = motion.tau.copy()
        if robot.m <= robot.n:
            prescribed[np.setdiff1d(np.arange(len(nodes.t)), nodes.singular)] = np.nan
        planned = PlannedMotion(
            dynamics,
            PlanFunctions(motion.platform, motion.carriers, preferred=PiecewisePolynomial.linear(motion.t, motion.tau)),
            dynamics.along(motion.platform.sample_at(motion.t)),
            motion.samples,
            within,
            "time_optimal",
            prescribed=prescribed,
            singular=nodes.singular,
            phases=PHASES,
        )
        solved_at, between = nodes, intersample_check(planned)
        ratios.append(float(between.worst.max(initial=1.0)))
        marked = between.too_coarse(ratios if lowered else [])
        finer = bool(marked.any()) and refined < often
        lower = not between.within_limits and lowered < LOWERED
        if between.passed or not solution.optimal or not (finer or lower):
            break
        guess = in_units(problem, solution)
        if finer:
            refined += 1
            nodes = finer_nodes(nodes, motion, between.middle[marked])
            problem = path_problem(dynamics, unit, nodes, rates, given)
        else:
            lowered += 1
            problem = replace(problem, shares=between.shares(motion.t, problem.shares))
    nodes = solved_at
    planned = replace(
        planned,
        parameters={
            "begin": begin,
            "end": end,
            "lap": lap,
            "datum": park.tolist(),
            "track": [tuple(ends) for ends in resolved.track.tolist()],
            **{name: getattr(resolved, name).tolist() for name in LIMITS},
            "actuator_speed": rates.tolist(),
            "steps": count,
            "seconds": bound,
            "refinements": often,
        },
        diagnostics={
            "optimal": solution.optimal,
            "solver": solution.message,
            "iterations": solution.iterations,
            "violation": solution.violation,
            "duration": float(motion.t[-1]),
            "nodes": len(nodes.t),
            "singular_instants": np.unique(motion.t[nodes.singular]).tolist(),
            "singular_nodes": nodes.singular.tolist(),
            "smooth_nodes": np.flatnonzero(nodes.smooth).tolist(),
            "solver_seconds": solution.seconds,
            "dense_ratios": ratios,
            "seconds": time.perf_counter() - began,
        },
    )
    return finish_plan(planned, between)


@dataclass(frozen=True, eq=False)
class TimedSolution:
    """A solution in units.

    ``t`` (M,) times of the nodes, s; the ``law`` p(t) and the ``carriers``' positions, m; the ``platform``'s motion;
    ``samples`` and ``tau`` (M, m) at the nodes.
    """

    t: Array
    law: PiecewisePolynomial
    carriers: PiecewisePolynomial
    platform: ContinuousMotion
    samples: CarrierMotion
    tau: Array

    @staticmethod
    def of(path: Path, problem: TimeOptimalProblem, solution: Solution) -> TimedSolution:
        """Return that of a solution."""
        u, values, grid = problem.sizes, solution.values, problem.grid
        t = np.concatenate([[0.0], np.cumsum(values["h"][:, 0] * u.h)])
        samples = CarrierMotion(*(values[name] * getattr(u, name) for name in ("s", "sd", "sdd")), check_rates=False)
        law = PiecewisePolynomial.linear(t, grid.t[:, None], values["pd"] * u.speed, values["pdd"] * u.acceleration)
        carriers = PiecewisePolynomial.linear(t, samples.s, samples.sd, samples.sdd)
        breaks = t[:-1][grid.h == 0.0]
        knots = frozen(np.setdiff1d(law.edges[1:-1], breaks))
        timed = Trajectory(path, TimingLaw.of(law, path.length))
        platform = ContinuousMotion(timed, law.start, law.end, law.end, frozen(breaks), knots, True)
        return TimedSolution(t, law, carriers.made_continuous(), platform, samples, values["tau"] * u.tau)


def finer_nodes(grid: Grid, motion: TimedSolution, exceeding: Array) -> Grid:
    """Return a grid with a node halfway in time in each step around the times that exceed, s, and in long ones.

    But in the long ones the jerk is continuous there: the efforts are seen, and no more is free.
    """
    h = np.diff(motion.t)
    steps = np.zeros(len(h), dtype=bool)
    steps[np.clip(np.searchsorted(motion.t, exceeding, side="right") - 1, 0, len(h) - 1)] = True
    marked = np.flatnonzero((widened(steps, BESIDE) | (h > LONG * motion.t[-1])) & (h > 0.0))
    places = motion.law(0.5 * (motion.t[marked] + motion.t[marked + 1]))[:, 0]
    left, right = grid.t[marked], grid.t[marked + 1]
    # a law that stands still in a step, or runs back, has no place of its own halfway
    places = np.clip(places, left + APART * (right - left), right - APART * (right - left))
    on = np.zeros(len(grid.t), dtype=bool)
    on[grid.singular] = True
    smooth = np.insert(grid.smooth, marked + 1, h[marked] <= LONG * motion.t[-1])
    t = np.insert(grid.t, marked + 1, places)
    return Grid(read_only(t), read_only(np.flatnonzero(np.insert(on, marked + 1, False))), read_only(smooth))


def _require_closed(unit: ContinuousMotion) -> None:
    ends = unit.sample_at(np.array([unit.start, unit.end]))
    apart = float(np.abs(np.diff(ends.x, axis=0)).max() + np.abs(np.diff(ends.xd, axis=0)).max())
    if apart > 1e-9:
        raise InputError(
            f"The path ends {apart:.3g} from where it begins, or in another direction.",
            remedy="A lap needs a closed path, such as a circle or a square.",
            name="lap",
        )


def path_problem(
    dynamics: Dynamics, unit: ContinuousMotion, nodes: Grid, rates: Array, given: Mapping[str, Any]
) -> TimeOptimalProblem:
    """Read the coefficients, and choose sizes by the speed that the parked robot may take."""
    motion = unit.sample_at(nodes.t)
    along = dynamics.along(motion)
    model = read_model(along, dynamics)
    parked = along.reduce()

    def read(there: DynamicsAlongMotion) -> CarrierModel:
        return read_model(there, dynamics)

    def node(i: int) -> SingularNode:
        side: Side = "left" if i < len(nodes.h) and nodes.h[i] == 0.0 else "right"
        return singular_node(dynamics, unit, i, float(nodes.t[i]), read, side)

    singular = tuple(node(i) for i in nodes.singular.tolist())
    limits = given["limits"]
    turning = np.abs(np.einsum("nim,ni->nm", model.W, motion.xd))
    fastest = (rates / np.maximum(turning, 1e-300)).min(axis=1, initial=1e300)
    length = unit.end
    place = nodes.t / nodes.t[-1]
    regular = ~near_singular(parked)
    inverse = np.linalg.pinv(model.W[regular])

    def use(speed: float) -> float:
        """Return the largest share of the limits that harmonic motion of a mean speed has of them."""
        pd, pdd = speed * np.sqrt(4.0 * place * (1.0 - place)), 2.0 * speed**2 / length * (1.0 - 2.0 * place)
        f = _at(model.f0, pd, pdd)[regular]
        tau = np.einsum("nmi,ni->nm", inverse, f)
        share = np.abs(tau / np.where(np.isfinite(limits.effort), limits.effort, np.inf)).max(initial=0.0)
        return max(float(share), float((pd / fastest).max()))

    speeds = length * np.geomspace(1e-3, 1e3, 121)
    uses = np.array([use(speed) for speed in speeds])
    below = np.flatnonzero(uses <= 0.9)
    speed = float(speeds[below[-1] if len(below) else int(uses.argmin())])
    duration = 0.5 * np.pi * length / speed
    share = np.arccos(1.0 - 2.0 * place) / np.pi
    h = duration * np.diff(share)
    acceleration = 2.0 * speed**2 / length
    (lower, upper), k = limits.track.T, model.k
    s = np.where(np.isfinite(upper - lower), 0.5 * (upper - lower), 1.0) if k else np.zeros(0)
    sd = np.where(np.isfinite(limits.speed), limits.speed, 10.0 * s / duration)
    sdd = np.where(np.isfinite(limits.acceleration), limits.acceleration, 10.0 * sd / duration)
    size = float(np.abs(_at(model.f0, speed, acceleration) / parked.row_scale).max()) or 1.0
    largest = np.linalg.svd(model.W / parked.row_scale[:, None], compute_uv=False)[:, 0]
    finite = limits.effort[np.isfinite(limits.effort)]
    tau = float(finite.min()) if len(finite) else size / float(np.median(largest))
    row = max(size, tau * float(np.median(largest))) * parked.row_scale
    sizes = PathScales(speed, acceleration, s, sd, sdd, tau, row, np.where(nodes.h > 0.0, h, duration), duration)
    return TimeOptimalProblem(grid=nodes, model=model, singular=singular, fastest=fastest, sizes=sizes, **given)


def _at(first: Array, pd: ArrayLike, pdd: ArrayLike) -> Array:
    """Return coefficients (M, r, 4) at speeds and accelerations along the path, (M,) or one for all."""
    powers = np.stack(np.broadcast_arrays(1.0, pd, np.square(pd), pdd), axis=-1)
    return np.asarray(np.einsum("nrq,nq->nr", first, np.broadcast_to(powers, (len(first), 4))))


def first_guess(problem: TimeOptimalProblem) -> dict[str, Array]:
    """Return scaled variables of parked carriers and harmonic motion, of even speed in a lap."""
    u, grid, k = problem.sizes, problem.grid, problem.model.k
    place = grid.t / grid.t[-1]
    parked = np.tile(problem.datum / u.s, (len(place), 1)) if k else np.zeros((len(place), 0))
    if problem.lap:
        pd, pdd, h = np.full(len(place), 0.5), np.zeros(len(place)), grid.h / (0.5 * u.speed) / u.h
    else:
        pd, pdd, h = np.sqrt(4.0 * place * (1.0 - place)), 1.0 - 2.0 * place, np.where(grid.h > 0.0, 1.0, 0.0)
    return {"pd": pd[:, None], "pdd": pdd[:, None], "h": h[:, None], "s": parked}


_MOVED = ("pd", "pdd", "s", "sd", "sdd", "tau")
_SIZE = {"pd": "speed", "pdd": "acceleration"}


def in_units(problem: TimeOptimalProblem, solution: Solution) -> dict[str, Array]:
    """Return the variables in units, and under "place" and "h" the nodes and the durations of the steps."""
    u = problem.sizes
    values = {name: solution.values[name] * getattr(u, _SIZE.get(name, name)) for name in _MOVED}
    return {**values, "place": problem.grid.t, "h": solution.values["h"] * u.h[:, None]}


def moved_guess(values: dict[str, Array], problem: TimeOptimalProblem) -> dict[str, Array]:
    """Return scaled variables on other nodes, from those in units on fewer."""
    u, new, old = problem.sizes, problem.grid.t, values["place"]
    at = np.searchsorted(old, new, side="left")
    # of nodes that occur twice the second one is the second one there, too
    second = np.append(False, np.diff(new) == 0.0)
    at[second] += 1
    same = old[at] == new
    below = np.maximum(at - 1, 0)
    part = np.divide(new - old[below], old[at] - old[below], out=np.ones_like(new), where=~same)[:, None]
    moved = {name: (1.0 - part) * values[name][below] + part * values[name][at] for name in _MOVED}
    scaled_ones = {name: value / getattr(u, _SIZE.get(name, name)) for name, value in moved.items()}
    times = np.concatenate([[0.0], np.cumsum(values["h"])])
    t = ((1.0 - part[:, 0]) * times[below] + part[:, 0] * times[at])[:, None]
    return {**scaled_ones, "h": np.diff(t, axis=0) / u.h[:, None]}


def solved_programme(problem: TimeOptimalProblem, guess: dict[str, Array], seconds: float) -> Solution:
    """Solve with rows between the nodes where they are needed.

    Raises:
        InfeasiblePlanError: no timing was found.
    """
    deadline = time.perf_counter() + seconds
    between: BoolArray = np.zeros(len(problem.grid.h), dtype=bool)
    iterations, spent = 0, 0.0
    for _ in range(ROUNDS + 1):
        for options in (WARM if "tau" in guess else FIRST, FALLBACK):
            left = max(deadline - time.perf_counter(), LEAST_SECONDS)
            solution = solve_nlp(transcribe(problem, between), guess, left, options)
            iterations, spent = iterations + solution.iterations, spent + solution.seconds
            if solution.optimal or time.perf_counter() > deadline:
                break
        leaves = leaves_limits(problem, solution) & ~between
        if not solution.feasible or not leaves.any():
            break
        between, guess = between | widened(leaves, BESIDE), solution.values
    if not solution.feasible:
        late = solution.message == OUT_OF_TIME
        raise InfeasiblePlanError(
            f"No timing was found{f' within {seconds:g} s' if late else ' that keeps the limits'} "
            f"(the solver says {solution.message}; unbalanced by {solution.violation:.2g}).",
            remedy="Allow more seconds." if late else "Raise the limits of efforts or carriers, or leave the end free.",
            constraint="seconds" if late else "effort",
            time=0.0,
            amount=solution.violation,
        )
    return replace(solution, iterations=iterations, seconds=spent)


def leaves_limits(problem: TimeOptimalProblem, solution: Solution) -> BoolArray:
    """Return (M − 1,) the steps inside which a carrier leaves its track or exceeds its speed."""
    u, values, limits = problem.sizes, solution.values, problem.limits
    leaves: BoolArray = np.zeros(len(problem.grid.h), dtype=bool)
    if not problem.model.k:
        return leaves
    t = np.concatenate([[0.0], np.cumsum(values["h"][:, 0] * u.h)])
    position = PiecewisePolynomial.linear(t, *(values[name] * getattr(u, name) for name in ("s", "sd", "sdd")))
    lower, upper = limits.track.T
    for function, low, high in ((position, lower, upper), (position.derivative(), -limits.speed, limits.speed)):
        least, most = function.ranges()
        leaves[problem.grid.h > 0.0] |= ((most > high) | (least < low)).any(axis=1)
    return leaves
