"""Solving the programme of a whole trajectory with IPOPT, from one or several first guesses."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_motion import CarrierCourse
from redundancy_pin.planners.whole_trajectory_program import Program, casadi
from redundancy_pin.planners.whole_trajectory_progress import Say, watcher

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
