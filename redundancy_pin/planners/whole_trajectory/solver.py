"""IPOPT on a programme: its strategies, in which order and how exactly it steps, and constraint generation.

Three rows a step and carrier hold track and speed everywhere by the hulls of the Bézier points, and double what the
solver has to factorise, while a handful of steps touches a limit. So the problem is solved with the limits at the
nodes, the exact extremes between the nodes are looked at, rows are added around the steps that leave the limits, and
it is solved again from where it was. The carriers' forces become variables only once one exceeds its limit.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.planners.whole_trajectory.least_peak import KNOWN, UNKNOWN, least_peak, serves
from redundancy_pin.planners.whole_trajectory.options import OBJECTIVES, Progress, casadi
from redundancy_pin.planners.whole_trajectory.problem import WholeTrajectoryProblem, widened
from redundancy_pin.planners.whole_trajectory.transcription import NLP, PEAK, RESERVE, scaled_bounds, transcribe
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

Options = dict[str, Any]
"""Options of IPOPT by name."""

TOLERANCE = 1e-9
"""Of the conditions of a minimum, in scaled variables."""

FEASIBLE = 1e-7
"""Violation of the scaled constraints below which a point that is not optimal may still be presented, as such."""

LEAST_SECONDS = 1e-3
"""Time the solver is given when there is none left; it accepts none of zero."""

SOLVED = "Solve_Succeeded"
"""The solver's word for an optimum."""

OUT_OF_TIME = "Maximum_WallTime_Exceeded"
"""The solver's word for it."""

LONG = 1000
"""Nodes from which the iterations are reported; below, a plan takes less than a second or two."""

PERIOD = 0.5
"""Time between two reports at least, s."""


@dataclass(frozen=True, eq=False)
class Solution:
    """What the solver ended with.

    ``values``: the variables by name, scaled; ``optimal``: whether the conditions of a minimum hold; ``feasible``:
    whether every constraint holds; ``message``: the solver's own word for how it ended; ``cost``: the scaled objective;
    ``violation``: largest violation of a scaled constraint; ``iterations``: number of iterations; ``seconds``: time
    taken; ``point``: x and the multipliers of its bounds and of the rows, to begin from with more rows; ``rows``: which
    rows these are (``NLP``); ``centre``: of ``least_peak``, from where IPOPT goes on, the barrier parameter, else zero.
    """

    values: dict[str, Array]
    optimal: bool
    feasible: bool
    message: str
    cost: float
    violation: float
    iterations: int
    seconds: float
    point: tuple[Array, Array, Array]
    rows: Mapping[str, Any]
    centre: float = 0.0

    @property
    def infeasible(self) -> bool:
        """Whether the solver is convinced that no point keeps every constraint (nearby, as for any such solver)."""
        return self.message == "Infeasible_Problem_Detected"

    @property
    def acceptable(self) -> bool:
        """Whether the solver came near an optimum and no further: with steps refined it may."""
        return self.message == "Solved_To_Acceptable_Level"

    def position(self, problem: WholeTrajectoryProblem) -> PiecewisePolynomial:
        """Return the carriers' positions, m, as a function of time: s̈ is linear in a step."""
        return problem.position(self.values)

    def tau(self, problem: WholeTrajectoryProblem) -> Array:
        """Return (M, m) the main efforts, N or N·m."""
        return self.values["tau"] * problem.scales.tau


def solve_nlp(
    nlp: NLP,
    guess: dict[str, Array] | Solution,
    seconds: float,
    options: Options | None = None,
    progress: Progress | None = None,
) -> Solution:
    """Solve a programme by IPOPT from one first guess.

    ``guess``: blocks by name, of which those left out start at zero; or a solution of this programme or of one with its
    first rows only, begun from with its multipliers (of use with the options ``WARM``); ``seconds``: time bound, s;
    ``progress``: called with a line of text now and then where the programme is long.
    """
    began = time.perf_counter()
    bounds = nlp.bounds
    rows = len(bounds["lbg"])
    is_long = nlp.blocks["s"].shape[0] >= LONG
    reporter = None if progress is None or not is_long else _reporter(len(bounds["lbx"]), rows, progress)
    settings = {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "print_time": False,
        "ipopt.tol": TOLERANCE,
        "ipopt.constr_viol_tol": 1e-10,
        "ipopt.bound_relax_factor": 0.0,
        "ipopt.max_iter": 1000,
        "ipopt.max_wall_time": seconds,
        "ipopt.mu_strategy": "monotone",
        "no_nlp_grad": True,  # multipliers of parameters, of which there are none
        **nlp.derivatives,
        **({} if reporter is None else {"iteration_callback": reporter}),
        **(options or {}),
    }
    function = casadi().nlpsol("whole_trajectory", "ipopt", nlp.functions, settings)
    nlp.keep_derivatives(function)
    if isinstance(guess, Solution):
        x, lam_x, lam_g = guess.point
        first = {"x0": x, "lam_x0": lam_x, "lam_g0": np.append(lam_g, np.zeros(rows - len(lam_g)))}
    else:
        first = {"x0": nlp.join(guess)}
    result = function(**first, **bounds)
    if reporter is not None and reporter.error is not None:
        raise reporter.error
    stats, g = function.stats(), np.asarray(result["g"]).ravel()
    message = str(stats["return_status"])
    x, lam_x, lam_g = (np.asarray(result[name]).ravel() for name in ("x", "lam_x", "lam_g"))
    violation = float(np.maximum(bounds["lbg"] - g, g - bounds["ubg"]).max(initial=0.0))
    return Solution(
        values=nlp.split(x),
        optimal=message in (SOLVED, "Feasible_Point_Found"),
        feasible=violation <= FEASIBLE,
        message=message,
        cost=float(result["f"]),
        violation=violation,
        iterations=int(stats["iter_count"]),
        seconds=time.perf_counter() - began,
        point=(x, lam_x, lam_g),
        rows=nlp.rows,
    )


def _now_and_then(progress: Progress) -> Callable[[int, float], None]:
    """Return what reports an iteration and the scaled objective there twice a second at most."""
    began, last = time.perf_counter(), -PERIOD

    def report(iteration: int, cost: float) -> None:
        nonlocal last
        now = time.perf_counter() - began
        if now - last >= PERIOD:
            last = now
            progress(f"iteration {iteration}, {now:.0f} s: scaled objective {cost:.6g}")

    return report


def _reporter(variables: int, rows: int, progress: Progress) -> Any:
    """Return what the solver calls at every iteration: it reports the iteration and the scaled objective now and then.

    What ``progress`` raises stops the solver and is kept in the attribute ``error``.
    """
    ca = casadi()
    sizes = {"x": variables, "f": 1, "g": rows, "lam_x": variables, "lam_g": rows, "lam_p": 0}
    base: Any = ca.Callback

    class Reporter(base):  # type: ignore[misc] # the base class exists only once the library is loaded
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.count, self.report = 0, _now_and_then(progress)
            self.error: BaseException | None = None
            self.construct("reporter", {})

        def get_n_in(self) -> int:
            return int(ca.nlpsol_n_out())

        def get_n_out(self) -> int:
            return 1

        def get_name_in(self, i: int) -> str:
            return str(ca.nlpsol_out(i))

        def get_sparsity_in(self, i: int) -> Any:
            return ca.Sparsity.dense(sizes[ca.nlpsol_out(i)], 1)

        def eval(self, arguments: Any) -> list[int]:
            try:
                self.report(self.count, float(arguments[1]))
            except BaseException as error:  # an interruption too would be lost in the library
                self.error = error
                return [1]
            self.count += 1
            return [0]

    return Reporter()


PREDICTED: Options = {"ipopt.mehrotra_algorithm": "yes", "ipopt.mu_strategy": "adaptive", "ipopt.max_iter": 60}
"""Mehrotra's predictor and corrector, made for quadratic programmes, which these are but for a few bilinear rows. On
least peak it takes 22 iterations where the monotone strategy takes 28 (the corner, 280 nodes), and 40 where that takes
63 and 96 (the square, 1000 and 3000 nodes). It has no line search, hence the bound on its iterations: where it takes
more it has wandered, and may end far from where it began (once in an optimum a third worse). Of 389 random tasks, 221
of them of the five-bar, 368 took it up to 57, to the optimum of the monotone strategy but for one, 15 % worse."""

ADAPTIVE: Options = {"ipopt.mu_strategy": "adaptive"}
"""This strategy often ends where the monotone one crawls."""

LINEAR_SYSTEM: Options = {"ipopt.mumps_permuting_scaling": 0, "ipopt.mumps_scaling": 0, "ipopt.mumps_pivot_order": 2}
"""Leaves the linear system as it is, for the programme is scaled already, and orders it by approximate minimum fill.
The search for a permutation takes a time that grows with the square of the nodes (25 s of 27 for six iterations at
10 000 nodes), and METIS, which long problems get by themselves, takes 1.4 to 1.7 times as long."""

UNREFINED: Options = {"ipopt.fast_step_computation": "yes"}
"""Takes steps as they come from one solution of the linear system. With the former a fourth faster on the 3-RRR;
whether the result is an optimum is judged as strictly."""

MANY = 1000
"""Nodes from which steps are refined all the same: rounding there makes the iterations more."""

_BEGUN = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac", "mult_bound_push")


def _from_solution(push: float, mu: float) -> Options:
    pushes = {f"ipopt.warm_start_{name}": push for name in _BEGUN}
    return {"ipopt.warm_start_init_point": "yes", **pushes, "ipopt.mu_init": mu}


WARM = _from_solution(push=1e-3, mu=1e-7)
"""For beginning at the optimum of a programme with fewer rows: the fewest iterations over the barrier parameters 1e-3
to 1e-9 and the pushes 1e-3 to 1e-9, on 11 plans that needed more rows."""

FINISH: Options = {
    **_from_solution(push=1e-9, mu=1e-10),
    "ipopt.mu_target": 1e-10,
    "ipopt.tol": 1e-14,
    "ipopt.acceptable_tol": TOLERANCE,
}
"""For the last of Newton's steps on a flat optimum: at a barrier parameter that stays they converge to rounding, which
is more than the tolerance can ask for, so their number is given. Efforts from two backends then agree to 1e-11. (Pushes
of 1e-12 would accept the point as it is.)"""

CENTRED: Options = {
    "ipopt.warm_start_init_point": "no",
    "ipopt.bound_mult_init_method": "mu-based",
    **{f"ipopt.{name}": 1e-14 for name in ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")},
}
"""For the last steps from a point on the central path: the multipliers of inequalities follow from the barrier
parameter, and IPOPT makes those of the equations by itself."""

BOUNDED = 60
"""Iterations of a draft with bounds of objectives after which each bound is looked at by itself."""

LAST_STEPS, LAST_STEPS_OF_MANY = 2, 4
"""Numbers of these steps within tolerance. At 3000 nodes two leave 3e-5 of the efforts, four 3e-12."""


@dataclass(frozen=True, eq=False)
class Strategies:
    """Options of the solver for a problem, by what it is to do.

    ``first``: what to try in turn, before the problem is built with every row; ``more_rows``: to go on from the
    solution of a programme with fewer rows; ``refined``: to go on, with refined steps, from a point that is near an
    optimum and no further; ``centred``: the last steps from a point on the central path, whose barrier parameter is
    given; ``later``: what to try in turn with every row, where the first ones did not end at an
    optimum; ``last_steps``: the exact steps that end on a flat optimum; None where the optimum is sharp.
    """

    first: tuple[Options, ...]
    more_rows: Options
    refined: Options
    centred: Callable[[float], Options]
    later: tuple[Options, ...]
    last_steps: Options | None


def strategies(problem: WholeTrajectoryProblem) -> Strategies:
    """Return how the solver goes about a problem."""
    terms = [OBJECTIVES[name] for name in {**problem.settings.objective, **problem.settings.at_most}]
    kinked, flat = any(term.kinked for term in terms), any(term.flat for term in terms)
    nodes = len(problem.grid.t)
    many = nodes >= MANY
    # An objective as large as the number of nodes, of which it is a mean: the multipliers of the equations are then of
    # size one whatever the number. Else the barrier, which starts at one size for all problems, outweighs the
    # objective, and the tolerance of the conditions hides what is left of it.
    scaling: Options = {} if kinked else {"ipopt.obj_scaling_factor": float(nodes)}
    fast = {**scaling, **LINEAR_SYSTEM, **({} if many else UNREFINED)}
    # with the linear solver's own scaling only where the number of nodes leaves time for it
    careful = {**scaling, **(LINEAR_SYSTEM if many else {})}
    steps = {"ipopt.acceptable_iter": LAST_STEPS_OF_MANY if many else LAST_STEPS}
    exact = {**scaling, **LINEAR_SYSTEM, **FINISH, **steps}
    return Strategies(
        first=(careful,) if kinked else ({**fast, **PREDICTED}, fast),
        more_rows={**fast, **WARM},
        refined={**careful, **WARM},
        centred=lambda centre: {**exact, **CENTRED, "ipopt.mu_init": centre * nodes},
        later=(careful, {**careful, **ADAPTIVE}),
        last_steps=exact if flat else None,
    )


ROUNDS = 4
"""Rounds of adding rows, after which all are."""

CLOSE = -1e-4
"""Minus the distance from a limit, as a fraction of its size, at which steps of a course of ``least_peak`` get rows:
IPOPT would leave the limit there on its way to the end of a flat optimum."""

AROUND = 2
"""Steps on both sides of one that leaves a limit that get rows as well: the next solution would leave it there."""


def draft(problem: WholeTrajectoryProblem, guess: dict[str, Array], seconds: float) -> Solution | None:
    """Solve with limits at the nodes alone: this shows whether nodes are dense enough, in half the time.

    ``guess``, ``seconds``: as for ``solve``, which goes on from there. None where that would save nothing.
    """
    strategy, deadline = strategies(problem), time.perf_counter() + seconds
    if strategy.last_steps is None:
        return None
    if serves(problem):
        # rows that cost nothing here, where a course that is known comes near to limits
        near = _leaves_limits(problem, problem.position(guess), CLOSE)
        quick = _least_peak(problem, guess, widened(near, AROUND), deadline, KNOWN if "sdd" in guess else UNKNOWN)
        if quick is not None:
            return quick
    seconds = max(deadline - time.perf_counter(), LEAST_SECONDS)
    nlp = transcribe(problem, between=[], limit_force=False)
    # bounds of objectives are asked for below the least there is, which takes a thousand iterations to see from here
    most = {"ipopt.max_iter": BOUNDED} if problem.settings.at_most else {}
    return solve_nlp(nlp, guess, seconds, {**strategy.first[0], **most}, problem.settings.solver.progress)


def _least_peak(
    problem: WholeTrajectoryProblem,
    guess: dict[str, Array],
    between: BoolArray,
    deadline: float,
    slacks: tuple[float, float] = UNKNOWN,
) -> Solution | None:
    """Solve by ``least_peak``, with limits between the nodes in some steps; None where it ends without."""
    began = time.perf_counter()
    progress = problem.settings.solver.progress
    report = None if progress is None or len(problem.grid.t) < LONG else _now_and_then(progress)

    def go_on(iteration: int, cost: float) -> bool:
        if report is not None:
            report(iteration, cost)
        return time.perf_counter() < deadline

    optimum = least_peak(problem, guess, between, go_on, slacks)
    if optimum is None:
        return None
    return Solution(
        values=optimum.values | {PEAK: np.array(optimum.peak)},
        optimal=True,
        feasible=True,
        message=SOLVED,
        cost=optimum.cost,
        violation=0.0,
        iterations=optimum.iterations,
        seconds=time.perf_counter() - began,
        point=(np.empty(0),) * 3,
        rows={"between": (between,)},
        centre=optimum.centre,
    )


def solve(
    problem: WholeTrajectoryProblem, guess: dict[str, Array], seconds: float, begun: Solution | None = None
) -> Solution:
    """Solve a problem with every limit held at the nodes and between them.

    ``guess``: first guess, scaled blocks by name; ``seconds``: time bound, s; ``begun``: a draft from this guess.

    Returns:
        An optimum that keeps every limit; or where that is not reached, the outcome with all rows from the start.
    """
    deadline = time.perf_counter() + seconds - (0.0 if begun is None else begun.seconds)
    attempts = [_with_needed_rows(problem, guess, deadline, begun)]
    if begun is not None and begun.centre and not attempts[0].optimal and time.perf_counter() < deadline:
        attempts.append(_with_needed_rows(problem, guess, deadline, None))
    known = len(attempts)
    # the other strategy often ends where the first one crawls
    for options in () if attempts[-1].optimal else strategies(problem).later:
        left = deadline - time.perf_counter()
        if attempts[-1].optimal or attempts[-1].infeasible or left <= 0.0:
            break
        start = guess if len(attempts) == known else attempts[-1].values
        attempts.append(solve_nlp(transcribe(problem), start, left, options, problem.settings.solver.progress))
    best = min(attempts, key=lambda solution: (not solution.optimal, not solution.feasible))
    return _with_totals(best, attempts)


def _with_needed_rows(
    problem: WholeTrajectoryProblem, guess: dict[str, Array], deadline: float, begun: Solution | None
) -> Solution:
    """Solve with rows only where they are needed; the outcome is feasible only where limits hold in between, too."""
    attempts = [] if begun is None else [begun]

    def attempt(nlp: NLP, options: Options, start: dict[str, Array] | Solution) -> Solution:
        left = max(deadline - time.perf_counter(), LEAST_SECONDS)
        attempts.append(solve_nlp(nlp, start, left, options, problem.settings.solver.progress))
        return attempts[-1]

    strategy = strategies(problem)
    groups: list[BoolArray] = []
    limit_force = False
    start: dict[str, Array] | Solution = guess
    # a draft is what the first one leads to
    option_sets = strategy.first[len(attempts) :] if begun is None or not begun.optimal else ()
    while begun is not None and begun.centre:
        start, option_sets, position = begun.values, (strategy.centred(begun.centre),), begun.position(problem)
        rows = begun.rows["between"][0]
        groups = [rows | widened(_leaves_limits(problem, position, CLOSE), AROUND)]
        if len(attempts) > ROUNDS or not (_leaves_limits(problem, position) & ~rows).any():
            break
        begun = _least_peak(problem, start, groups[0], deadline)
        attempts += [] if begun is None else [begun]
    while True:
        nlp = transcribe(problem, between=groups, limit_force=limit_force)
        centred = isinstance(start, dict) and PEAK in start
        if isinstance(start, dict) and centred:
            start = start | {name: start[PEAK] for name in nlp.blocks if name.startswith(PEAK)}
        for options in option_sets:
            if attempt(nlp, options, start).optimal or time.perf_counter() > deadline:
                break
        solution = attempts[-1]
        # where the barrier parameter stays, the solver cannot call it more than acceptable
        if solution.acceptable and centred:
            solution = replace(solution, optimal=True, message=SOLVED)
        elif solution.acceptable:
            solution = attempt(nlp, strategy.refined, solution)
        if not solution.optimal:
            leaves = _leaves_limits(problem, solution.position(problem))
            kept = not leaves.any() and not exceeds_force(problem, solution)
            return _with_totals(replace(solution, feasible=solution.feasible and kept), attempts)
        if not limit_force and exceeds_force(problem, solution):
            # more variables, so that the multipliers are of no use
            limit_force, start, option_sets = True, solution.values, strategy.first
            continue
        leaves = _leaves_limits(problem, solution.position(problem))
        if not leaves.any() and strategy.last_steps is not None and not centred:
            exact = attempt(nlp, strategy.last_steps, solution)
            if not (exact.optimal or exact.acceptable):
                return _with_totals(solution, attempts)
            solution = replace(exact, optimal=True, message=solution.message)
            leaves = _leaves_limits(problem, solution.position(problem))
        if not leaves.any():
            return _with_totals(solution, attempts)
        # steps that get rows: where some leave limits, but for those that have theirs
        new: BoolArray = widened(leaves, AROUND) & ~np.any([np.zeros_like(leaves), *groups], axis=0)
        if len(groups) == ROUNDS or not new.any():
            return _with_totals(replace(solution, optimal=False, feasible=False), attempts)
        groups.append(new)
        start, option_sets = solution, (strategy.more_rows,)


def _leaves_limits(problem: WholeTrajectoryProblem, position: PiecewisePolynomial, by: float = 0.0) -> BoolArray:
    """Return (M − 1,) the steps inside which track or speed limits are exceeded, by more than a part of the reserve.

    ``by``: by how much more, as a fraction of their sizes.
    """
    bounds = scaled_bounds(problem)
    exceeded = np.zeros(len(problem.grid.h), dtype=bool)
    for name, function in (("s", position), ("sd", position.derivative())):
        (lower, upper), size = bounds[name], getattr(problem.scales, name)
        width = upper - lower
        spare = by + 0.25 * RESERVE * np.where(np.isfinite(width), width, 0.0)
        least, most = function.ranges()
        exceeded[problem.grid.h > 0.0] |= ((most / size > upper + spare) | (least / size < lower - spare)).any(axis=1)
    return exceeded


def exceeds_force(problem: WholeTrajectoryProblem, solution: Solution) -> bool:
    """Return whether a carrier needs more force at a node than its limit."""
    carriers, (low, high) = problem.carriers(solution.values), scaled_bounds(problem)["force"]
    force = problem.carrier_force(carriers) / problem.scales.force
    return bool(((force > high) | (force < low)).any())


def _with_totals(chosen: Solution, attempts: list[Solution]) -> Solution:
    """Return a solution with the iterations and the time of all attempts."""
    iterations, seconds = (sum(getattr(attempt, name) for attempt in attempts) for name in ("iterations", "seconds"))
    return replace(chosen, iterations=int(iterations), seconds=float(seconds))
