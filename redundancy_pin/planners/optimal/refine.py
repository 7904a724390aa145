"""Solve, look between the nodes, refine or lower the limits, and solve again: for whole trajectories and least time."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import (
    LOWERED,
    Findings,
    IntersampleCheck,
    PlannedMotion,
    intersample_check,
)
from redundancy_pin.planners.optimal.infeasible import Relaxation, relax, require_bounds
from redundancy_pin.planners.optimal.mesh import first_mesh
from redundancy_pin.planners.optimal.nlp import OUT_OF_TIME
from redundancy_pin.planners.optimal.problem import Problem, Task, read_problem
from redundancy_pin.planners.optimal.solve import (
    Multistart,
    Outcome,
    Stop,
    first_guess,
    multistart,
    solve,
)
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.trajectory.continuous_motion import Motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

PHASES = ("optimised",)


class Planning(ABC):
    """One planning of a task; the subclass has the differences between least time and a whole trajectory.

    Attributes:
        name: of the planner.
        task: robot, motion and settings.
    """

    name: str

    def __init__(self, task: Task) -> None:
        self.task = task

    @abstractmethod
    def platform(self, outcome: Outcome) -> Motion:
        """Return the motion of the platform of a solution."""

    @abstractmethod
    def finer(self, outcome: Outcome, found: IntersampleCheck, marked: BoolArray, first: bool) -> Problem:
        """Return the problem on a finer mesh.

        Args:
            outcome: the problem on the present one, and its solution.
            found: result of the check between the nodes.
            marked: (P,) pieces of that which the nodes do not show.
            first: whether no mesh was finer before.
        """

    def relaxation(self, problem: Problem) -> Relaxation:
        """Return from where, and of which limits, the smallest relaxation is sought."""
        return Relaxation(
            first_guess(problem), peaks=lambda outcome: intersample_check(self.planned(outcome)).peaks.peak
        )

    def solve(self, problem: Problem, guess: Mapping[str, Array] | None, deadline: float, stop: Stop) -> Multistart:
        """Return solutions from all first guesses, one of them feasible.

        Without a solution the limits are relaxed: this names the conflicting limits, or finds a motion that keeps
        them all, from which the solver starts once more.

        Args:
            problem: the numbers.
            guess: scaled blocks by name, in place of parked carriers.
            deadline: as for ``multistart``, s.
            stop: as for ``solve.solve``.

        Raises:
            InfeasiblePlanError: limits must be relaxed (``relax``), or another cause prevents a plan.
        """
        first = guess

        def within_limits(message: str) -> tuple[Problem, Mapping[str, Array]]:
            robot = robot_record(self.task.dynamics.robot)
            found = relax(problem, robot, self.relaxation(problem), message, deadline)
            return found.problem, found.values

        if guess is None and problem.timing is not None and problem.timing.exceeded_parked:
            # the weight is more than the motors hold: refuting that takes long, and this finds the motion if any
            problem, first = within_limits("")
        solutions = multistart(problem, first, deadline, stop)
        # neither relaxed above, nor an attempt with lower limits
        if not solutions.feasible and first is guess and problem.shares is None:
            if problem.settings.at_most:
                require_bounds(problem, first_guess(problem), deadline)
            problem, first = within_limits(solutions.outcomes[0].solution.message)
            again = Outcome(problem, solve(problem, first, deadline - time.perf_counter(), stop))
            solutions = replace(solutions, outcomes=(*solutions.outcomes, again))
        if solutions.feasible:
            return solutions
        last, seconds = solutions.outcomes[-1].solution, self.task.settings.solver.seconds
        late, remedy = last.message == OUT_OF_TIME, "Widen the limits a little, or start elsewhere."
        raise InfeasiblePlanError(
            f"No plan was found{f' within {seconds:g} s' if late else ''} (the solver says {last.message}; unbalanced "
            f"by {last.violation:.2g}), although none of the limits is known to be in the way.",
            remedy="Allow more seconds, or a coarser mesh." if late else remedy,
            constraint="seconds" if late else "balance",
            time=float(problem.times(last.values)[0]),
            amount=seconds if late else last.violation,
        )

    def planned(self, outcome: Outcome) -> PlannedMotion:
        """Return the planned motion of a solution.

        At singular nodes the efforts are taken from the solution, the limit of W⁻¹ f; elsewhere, and with as many main
        actuators as coordinates, W τ = f leaves no choice. With more actuators the efforts are the nearest to the
        planned ones, which are linear in a step.
        """
        problem, values, robot = outcome.problem, outcome.values, self.task.dynamics.robot
        nodes, tau, platform, t = problem.grid, problem.tau(values), self.platform(outcome), problem.times(values)
        prescribed = tau.copy()
        if robot.m <= robot.n:
            prescribed[np.setdiff1d(np.arange(len(t)), nodes.singular)] = np.nan
        position = problem.position(values).remove_offsets()
        return PlannedMotion(
            self.task.dynamics,
            PlanFunctions(platform, position, preferred=PiecewisePolynomial.linear(t, tau)),
            self.task.dynamics.along(platform.sample_at(t)),
            problem.carriers(values),
            self.task.settings.limits,
            self.name,
            prescribed=prescribed,
            singular=nodes.singular,
            phases=PHASES,
            chooses_timing=problem.timing is not None,
        )


@dataclass(frozen=True, eq=False)
class Planned:
    """The last plan of ``plan_and_refine``.

    ``solutions``: of all first guesses; ``motion``: of the best one; ``check``: result of the check between the nodes;
    ``ratios``: largest efforts and forces between the nodes over those at the nodes or their limits, one a
    round; ``out_of_time``: whether the time bound ended the search on finer meshes or with lower limits.
    """

    solutions: Multistart
    motion: PlannedMotion
    check: IntersampleCheck
    ratios: tuple[float, ...]
    out_of_time: bool = False

    @property
    def best(self) -> Outcome:
        """The programme and solution of the plan."""
        return self.solutions.best

    @property
    def findings(self) -> Findings:
        """What others read of the plan."""
        solution, t = self.best.solution, self.motion.motion.t
        instants = np.unique(t[self.best.problem.grid.singular]).tolist()
        return Findings(solution.optimal, solution.message, tuple(instants))

    @property
    def diagnostics(self) -> dict[str, object]:
        """Return the further diagnostics that both planners report."""
        nodes, solution, t = self.best.problem.grid, self.best.solution, self.motion.motion.t
        return {
            "iterations": solution.iterations,
            "violation": solution.violation,
            "nodes": len(t),
            "singular_nodes": nodes.singular.tolist(),
            "smooth_nodes": np.flatnonzero(nodes.smooth).tolist(),
            "solver_seconds": solution.seconds,
            "dense_ratios": list(self.ratios),
            "out_of_time": self.out_of_time,
        }

    def plan(self, parameters: Mapping[str, object], findings: Findings, **found: object) -> Plan:
        """Return the plan with its diagnostics; ``found`` extends or replaces the common diagnostics."""
        known = {**self.diagnostics, **found}
        motion = replace(self.motion, parameters=parameters, findings=findings, diagnostics=known)
        return finish_plan(motion, self.check)


def plan_and_refine(planning: Planning, position: PiecewisePolynomial | None = None) -> Planned:
    """Return a plan whose nodes show its efforts, and that keeps every limit between them, within the refinement bound.

    Where the nodes do not show the efforts between them the mesh is refined; where a limit is exceeded by less, the
    limits at the adjacent nodes are lowered.

    Args:
        planning: the task, with the functions of its planner.
        position: of the carriers, to begin with in place of parked ones.

    Raises:
        InfeasiblePlanError: as ``Planning.solve``.
    """
    task, settings = planning.task, planning.task.settings
    nodes = first_mesh(task.dynamics, task.source, settings.dt, task.slows_at_ends)
    problem = read_problem(task, nodes)
    guess: Mapping[str, Array] | None = None
    if position is not None:
        guess = problem.scaled(carriers_at(position, nodes.t))
    deadline = time.perf_counter() + settings.solver.seconds
    report = settings.solver.progress or (lambda line: None)
    ratios: list[float] = []
    last: Planned | None = None
    refined = lowered = 0

    evaluated: list[tuple[Mapping[str, Array], PlannedMotion, IntersampleCheck]] = []

    def check(outcome: Outcome) -> tuple[PlannedMotion, IntersampleCheck]:
        # what ``solve`` returns it has asked ``is_coarse`` about, with other counts of iterations
        if not evaluated or evaluated[-1][0] is not outcome.values:
            motion = planning.planned(outcome)
            evaluated[:] = [(outcome.values, motion, intersample_check(motion))]
        return evaluated[-1][1:]

    def is_coarse(outcome: Outcome) -> bool:
        _, found = check(outcome)
        return refined < settings.refinements and not found.passed and bool(found.too_coarse([]).any())

    def refine(coarse: Planned, marked: BoolArray) -> tuple[Problem, Mapping[str, Array]]:
        nonlocal refined
        following = planning.finer(coarse.best, coarse.check, marked, refined == 0)
        refined += 1
        return following, coarse.best.problem.resampled(coarse.best.values, following)

    while True:
        report(f"{len(problem.grid.t)} nodes, {len(problem.grid.singular)} of them singular: solving")
        try:
            solutions = planning.solve(problem, guess, deadline, is_coarse)
        except InfeasiblePlanError:
            late = time.perf_counter() > deadline
            if last is None or (problem.shares is None and not late):
                raise
            if late or refined == settings.refinements:
                return replace(last, out_of_time=late)
            # nothing keeps the lower limits at the nodes: finer nodes may keep the limits themselves
            problem, guess = refine(last, last.check.exceeding)
            continue
        problem, solution = solutions.best.problem, solutions.best.solution
        motion, found = check(solutions.best)
        at_nodes = np.abs(problem.tau(solution.values)).max()
        duration = motion.motion.t[-1] - motion.motion.t[0]
        report(f"{duration:.6g} s, peak effort {at_nodes:.4g} at the nodes, {found.peaks.peak.max():.4g} between them")
        ratios.append(float(found.worst.max(initial=1.0)))
        last = Planned(solutions, motion, found, tuple(ratios))
        marked = found.too_coarse(ratios if lowered else [])
        finer = bool(marked.any()) and refined < settings.refinements
        if found.passed or not solution.optimal or not (finer or (not found.within_limits and lowered < LOWERED)):
            return last
        if time.perf_counter() > deadline:
            return replace(last, out_of_time=True)
        if finer:
            problem, guess = refine(last, marked)
        else:
            lowered += 1
            shares = found.shares(problem.times(solution.values), problem.shares)
            guess, problem = solution.values, replace(problem, shares=shares)
