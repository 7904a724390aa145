"""How the solver goes about a whole trajectory: which of its strategies, in which order, and how exactly it steps."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.planners.whole_trajectory.mesh import CarrierCourse
from redundancy_pin.planners.whole_trajectory.problem import WholeProblem
from redundancy_pin.planners.whole_trajectory.program import Program, casadi

Say = Callable[[str], None]
"""Takes one line of text."""

LONG = 1000
"""Nodes from which the iterations are reported; below, a plan takes less than a second or two."""

PERIOD = 0.5
"""Time between two lines at least, s."""


def watcher(variables: int, rows: int, say: Say) -> Any:
    """Return what the solver calls at every iteration: it says the iteration and the scaled objective now and then.

    Args:
        variables: number of variables of the programme.
        rows: number of its rows.
        say: called with one line of text, at most twice a second. What it raises stops the solver and is kept in
            the attribute ``error``.
    """
    library = casadi()
    vectors = {"x": variables, "f": 1, "g": rows, "lam_x": variables, "lam_g": rows, "lam_p": 0}

    base: Any = library.Callback

    class Watcher(base):  # type: ignore[misc] # the base class exists only once the library is loaded
        def __init__(self) -> None:
            library.Callback.__init__(self)
            self.count, self.began, self.last = 0, time.perf_counter(), -PERIOD
            self.error: BaseException | None = None
            self.construct("watcher", {})

        def get_n_in(self) -> int:
            return int(library.nlpsol_n_out())

        def get_n_out(self) -> int:
            return 1

        def get_name_in(self, i: int) -> str:
            return str(library.nlpsol_out(i))

        def get_name_out(self, i: int) -> str:
            return "stop"

        def get_sparsity_in(self, i: int) -> Any:
            return library.Sparsity.dense(vectors[library.nlpsol_out(i)], 1)

        def eval(self, arguments: Any) -> list[int]:
            now = time.perf_counter() - self.began
            if now - self.last >= PERIOD:
                self.last = now
                try:
                    say(f"iteration {self.count}, {now:.0f} s: scaled objective {float(arguments[1]):.6g}")
                except BaseException as error:  # an interruption too would be lost in the library
                    self.error = error
                    return [1]
            self.count += 1
            return [0]

    return Watcher()


TOLERANCE = 1e-9
"""Of the conditions of a minimum, in scaled variables."""

FEASIBLE = 1e-7
"""Violation of the scaled constraints below which a point that is not optimal may still be presented, as such."""

LEAST_SECONDS = 1e-3
"""Time the solver is given when there is none left; it accepts none of zero."""


@dataclass(frozen=True, eq=False)
class Solution:
    """What the solver found.

    Attributes:
        values: the variables by name, scaled.
        optimal: whether the conditions of a minimum hold.
        feasible: whether every constraint holds.
        message: the solver's own word for how it ended.
        cost: the scaled objective.
        violation: largest violation of a scaled constraint.
        iterations: number of iterations.
        seconds: time taken.
        point: x and the multipliers of its bounds and of the rows, to begin from with more rows.
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

    @property
    def infeasible(self) -> bool:
        """Whether the solver is convinced that no point keeps every constraint (nearby, as for any such solver)."""
        return self.message == "Infeasible_Problem_Detected"

    @property
    def acceptable(self) -> bool:
        """Whether the solver came near an optimum and no further: with steps refined it may."""
        return self.message == "Solved_To_Acceptable_Level"

    def course(self, problem: WholeProblem) -> CarrierCourse:
        """Return the carriers' motion in units."""
        u = problem.scales
        parts = (self.values["s"] * u.s, self.values["sd"] * u.sd, self.values["sdd"] * u.sdd)
        return CarrierCourse(problem.grid.t, *parts)

    def tau(self, problem: WholeProblem) -> Array:
        """Return (M, m) the main efforts, N or N·m."""
        efforts: Array = self.values["tau"] * problem.scales.tau
        return efforts


class Solver:
    """IPOPT on one programme, which it keeps with its derivatives for any number of first guesses."""

    def __init__(
        self, program: Program, seconds: float, options: dict[str, Any] | None = None, say: Say | None = None
    ) -> None:
        self._program, self._bounds = program, program.bounds()
        self._watcher = None if say is None else watcher(program.size, program.row_count, say)
        watch = {} if self._watcher is None else {"iteration_callback": self._watcher}
        functions, derivatives = program.functions()
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
            **derivatives,
            **watch,
            **(options or {}),
        }
        self._function = casadi().nlpsol("whole_trajectory", "ipopt", functions, settings)

    def solve(self, guess: dict[str, Array] | Solution) -> Solution:
        """Solve from one first guess: blocks by name, of which those left out start at zero, or a solution.

        A solution may be that of a programme with fewer rows (the first ones of this), and is begun from with its
        multipliers; that is of use with the options ``WARM`` only.
        """
        began = time.perf_counter()
        if isinstance(guess, Solution):
            x, lam_x, lam_g = guess.point
            more = np.zeros(self._program.row_count - len(lam_g))
            first = {"x0": x, "lam_x0": lam_x, "lam_g0": np.concatenate([lam_g, more])}
        else:
            first = {"x0": self._program.join(guess)}
        found = self._function(**first, **self._bounds)
        if self._watcher is not None and self._watcher.error is not None:
            raise self._watcher.error
        stats = self._function.stats()
        x, g = np.asarray(found["x"]).ravel(), np.asarray(found["g"]).ravel()
        violation = max(
            float(np.max(self._bounds["lbg"] - g, initial=0.0)), float(np.max(g - self._bounds["ubg"], initial=0.0))
        )
        return Solution(
            values=self._program.split(x),
            optimal=str(stats["return_status"]) in ("Solve_Succeeded", "Feasible_Point_Found"),
            feasible=violation <= FEASIBLE,
            message=str(stats["return_status"]),
            cost=float(found["f"]),
            violation=violation,
            iterations=int(stats["iter_count"]),
            seconds=time.perf_counter() - began,
            point=(x, np.asarray(found["lam_x"]).ravel(), np.asarray(found["lam_g"]).ravel()),
        )


Options = dict[str, Any]
"""Options of IPOPT by name."""

PREDICTED: Options = {
    "ipopt.mehrotra_algorithm": "yes",
    "ipopt.mu_strategy": "adaptive",
    "ipopt.max_iter": 60,
}
"""Mehrotra's predictor and corrector, made for quadratic programmes, which these are but for a few bilinear rows. On
least peak it takes 22 iterations where the monotone strategy takes 28 (the corner, 280 nodes), and 40 where that takes
63 and 96 (the square, 1000 and 3000 nodes). It has no line search, hence the bound on its iterations: where it takes
more it has wandered, and may end far from where it began (once in an optimum a third worse). Of 389 random tasks, 221
of them of the five-bar, 368 took it up to 57, to the optimum of the monotone strategy but for one, 15 % worse."""

ADAPTIVE: Options = {"ipopt.mu_strategy": "adaptive"}
"""This strategy often ends where the monotone one crawls."""

LINEAR_SYSTEM: Options = {
    "ipopt.mumps_permuting_scaling": 0,
    "ipopt.mumps_scaling": 0,
    "ipopt.mumps_pivot_order": 2,
}
"""Leaves the linear system as it is, for the programme is scaled already, and orders it by approximate minimum fill.
The search for a permutation takes a time that grows with the square of the nodes (25 s of 27 for six iterations at
10 000 nodes), and METIS, which long problems get by themselves, takes 1.4 to 1.7 times as long."""

UNREFINED: Options = {"ipopt.fast_step_computation": "yes"}
"""Takes steps as they come from one solution of the linear system. With the former a fourth faster on the 3-RRR;
whether the result is an optimum is judged as strictly."""

MANY = 1000
"""Nodes from which steps are refined all the same: rounding there makes the iterations more."""

FLAT = frozenset({"peak", "energy"})
"""Objectives that leave the carriers open over whole stretches. There the regularisation alone decides, and where the
conditions hold within tolerance the efforts may still be 1e-2 off those that fulfil them: two backends would give two
plans."""

TANGLED = frozenset({"energy"})
"""Objectives with kinks in products of two unknowns, far from a quadratic programme: Mehrotra's way crawls on them, and
every step is refined."""

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

LAST_STEPS, LAST_STEPS_OF_MANY = 2, 4
"""Numbers of these steps within tolerance. At 3000 nodes two leave 3e-5 of the efforts, four 3e-12."""


def is_flat(problem: WholeProblem) -> bool:
    """Return whether an optimum has to be finished with exact steps to be the same from either backend."""
    return bool(FLAT & set(problem.settings.objective))


def scaling(problem: WholeProblem) -> Options:
    """Return what makes the objective as large as the number of nodes, of which it is a mean.

    The multipliers of the equations are then of size one whatever the number of nodes; else the barrier, which starts
    at one size for all problems, outweighs the objective, and the tolerance of the conditions hides what is left of it.
    """
    return {} if TANGLED & set(problem.settings.objective) else {"ipopt.obj_scaling_factor": float(len(problem.grid.t))}


def first_attempts(problem: WholeProblem) -> tuple[Options, ...]:
    """Return what to try on a problem in turn, before it is built with every row."""
    if TANGLED & set(problem.settings.objective):
        return (_linear_system(problem),)
    steps: Options = {} if _many(problem) else UNREFINED
    return tuple({**scaling(problem), **LINEAR_SYSTEM, **steps, **strategy} for strategy in (PREDICTED, {}))


def with_more_rows(problem: WholeProblem) -> Options:
    """Return the options for a solution that is begun from that of a programme with fewer rows."""
    return {**scaling(problem), **LINEAR_SYSTEM, **({} if _many(problem) else UNREFINED), **WARM}


def refined(problem: WholeProblem) -> Options:
    """Return the options for going on, with refined steps, from a point that is near an optimum and no further."""
    return {**scaling(problem), **_linear_system(problem), **WARM}


def last_steps(problem: WholeProblem) -> Options:
    """Return the options for the exact steps that end on a flat optimum."""
    steps = LAST_STEPS_OF_MANY if _many(problem) else LAST_STEPS
    return {**scaling(problem), **LINEAR_SYSTEM, **FINISH, "ipopt.acceptable_iter": steps}


def later_attempts(problem: WholeProblem) -> tuple[Options, ...]:
    """Return what to try in turn on a problem with every row, where the first attempts did not end at an optimum."""
    return tuple({**scaling(problem), **_linear_system(problem), **strategy} for strategy in ({}, ADAPTIVE))


def _many(problem: WholeProblem) -> bool:
    return len(problem.grid.t) >= MANY


def _linear_system(problem: WholeProblem) -> Options:
    """Return the linear solver's own scaling where the number of nodes leaves time for it."""
    return LINEAR_SYSTEM if _many(problem) else {}
