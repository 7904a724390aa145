"""Nonlinear programmes, put together block by block and solved by IPOPT (Wächter and Biegler 2006, in casadi)."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any, TypeAlias

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array
from redundancy_pin.planners.options import Progress

Expression: TypeAlias = Any
"""casadi.MX, or casadi.DM if the variables are numbers; casadi annotates no result types of its operators."""

Options = dict[str, Any]
"""Options of IPOPT by name."""

TOLERANCE = 1e-9
"""Of the conditions of a minimum, in scaled variables."""

FEASIBLE = 1e-7
"""Violation of the scaled constraints below which a point that is not optimal may still be presented, as such."""

LEAST_SECONDS = 1e-3
"""Least time for the solver, s, after the time bound; it does not accept zero."""

OPTIMAL = ("Solve_Succeeded", "Solved_To_Acceptable_Level", "Feasible_Point_Found")
"""IPOPT's words for an optimum. Acceptable is what keeps ``TOLERANCE`` after as many steps as rounding allows."""

OUT_OF_TIME = "Maximum_WallTime_Exceeded"
"""The solver's word for it."""

STALLED = "Violation_Stalls"
"""Our word for a search that was ended by ``PATIENCE``, in the solver's style."""

PATIENCE = 30
"""Iterations in which the violation does not fall by a tenth, and stays above ``FAR``, after which a search ends. Those
that led to the plans of 59 whole trajectories, of the thesis and at random, had 16 such at most; those that led nowhere
50 to 100. What keeps the limits is sought elsewhere then (``infeasible.relax``)."""

FAR = 1e-2
"""Violation of the scaled constraints; nearer ones are at times approached in 40 iterations and more."""

LONG = 1000
"""Nodes from which the iterations are reported; below, a plan takes less than a second or two."""

PERIOD = 0.5
"""Time between two reports at least, s."""

LINEAR_SYSTEM: Options = {"ipopt.mumps_permuting_scaling": 0, "ipopt.mumps_scaling": 0, "ipopt.mumps_pivot_order": 2}
"""Leaves the linear system as it is, for the programme is scaled already, and orders it by approximate minimum fill.
The search for a permutation takes a time that grows with the square of the nodes, and METIS, which long problems get by
themselves, takes longer (docs/planning.md, *Solver*)."""

BARRIER = 1e-10
"""Barrier parameter at which the solver ends. At a constant parameter Newton's steps reach machine precision, also on
flat optima, where within ``TOLERANCE`` the efforts of two backends may be 1e-2 apart."""

LAST_STEPS = 3
"""Consecutive steps within ``TOLERANCE`` that end the search, where rounding does not let it come closer."""

_EXACT: Options = {"ipopt.mu_target": BARRIER, "ipopt.acceptable_iter": LAST_STEPS}

FIRST: Options = {**_EXACT, **LINEAR_SYSTEM, "ipopt.mu_strategy": "adaptive", "ipopt.max_iter": 250}
"""Options from a guess: on least peak two thirds of the iterations of the monotone strategy. Plans take 10 to 100
iterations, and plans of least energy come nearest to the bound."""

FALLBACK: Options = _EXACT
"""Options where the first ones did not end at an optimum. The linear solver's own scaling takes time, and is needed
where events are a ten thousandth of a step apart."""

_PUSHES = ("bound_push", "bound_frac", "slack_bound_push", "slack_bound_frac")


def _from_optimum(barrier: float, push: float) -> Options:
    """Return options from an optimum: first barrier parameter, and distance from bounds as a part of their range."""
    return {
        **LINEAR_SYSTEM,
        "ipopt.mu_init": barrier,
        "ipopt.bound_mult_init_method": "mu-based",
        **{f"ipopt.{name}": push for name in _PUSHES},
    }


WARM: Options = {**_EXACT, **_from_optimum(1e-4, 1e-4), "ipopt.max_iter": 250}
"""Options from the optimum of the same task on other nodes, or with fewer rows."""

RELAXED: Options = {**_EXACT, **LINEAR_SYSTEM, "ipopt.mu_target": 1e-5, "ipopt.max_iter": 250}
"""Options where limits give way: fractions of a limit are then within 2e-4.

Flat optima, as under gravity, where slower motions hardly need less, take up to 150 iterations more to a parameter of
1e-10. The parameter decreases monotonically: an adaptive one may oscillate about this value without end."""

RELAXED_AGAIN: Options = {**WARM, "ipopt.mu_target": 1e-5}
"""The same from the least relaxation on other nodes."""

ON_FINER_NODES: Options = {**_EXACT, **_from_optimum(1e-2, 1e-2), "ipopt.max_iter": 250}
"""Options from an optimum on nodes so few that they do not show every effort."""

CALMING: Options = {
    **_from_optimum(1e-2, 0.1),
    # Mehrotra's probing step: a third fewer iterations than monotone barrier parameters
    "ipopt.mu_strategy": "adaptive",
    "ipopt.mu_oracle": "probing",
    "ipopt.mu_target": 1e-5,
    "ipopt.max_iter": 60,
    # "acceptable" is here what keeps the rows and no longer changes the ripple
    "ipopt.acceptable_iter": 2,
    "ipopt.acceptable_obj_change_tol": 1e-2,
    "ipopt.acceptable_constr_viol_tol": 0.1 * FEASIBLE,
    **{f"ipopt.acceptable_{name}": 1e10 for name in ("tol", "dual_inf_tol", "compl_inf_tol")},
}
"""Options by which an optimum is made calmer: two steps that keep the rows and change the ripple by less than 1 % are
the end, for how calm it is exactly does not matter.

Calmer motions leave limits that the optimum met. A start close to these would keep multipliers there, which shrink by
half an iteration: hence the tenth of the range. The barrier parameter ends at 1e-5: Newton's steps then converge to
rounding, and backends agree."""


class NLP:
    """minimise f(x) subject to l ≤ x ≤ u and b ≤ g(x) ≤ c, put together block by block.

    ``blocks``: the variables by name, matrices; ``cost``: the expression f, to be added to; ``size``: the solver's
    scaling factor of f; ``rows``: the options of ``transcribe`` that select the rows.
    """

    def __init__(self) -> None:
        self.blocks: dict[str, Expression] = {}
        self.cost: Expression = 0.0
        self.size = 1.0
        self.rows: dict[str, Any] = {}
        self._rows: list[Expression] = []
        self._bounds: dict[str, list[Array]] = {"lbx": [], "ubx": [], "lbg": [], "ubg": []}

    def variable(
        self, name: str, shape: tuple[int, int], lower: ArrayLike = -np.inf, upper: ArrayLike = np.inf
    ) -> Expression:
        """Add a block of variables within bounds."""
        self.blocks[name] = ca.MX.sym(name, *shape)
        for side, bound in (("lbx", lower), ("ubx", upper)):
            self._bounds[side].append(np.broadcast_to(bound, shape).ravel(order="F"))
        return self.blocks[name]

    def within(self, expression: Expression, lower: Expression = 0.0, upper: Expression = 0.0) -> None:
        """Add lower ≤ expression ≤ upper where a bound is finite; bounds broadcast to the matrix.

        Bounds that are expressions themselves have a row each.
        """
        if isinstance(lower, ca.MX):
            self.within(expression - lower, 0.0, np.inf)
            self.within(expression - upper, -np.inf, 0.0)
            return
        low, high = (np.broadcast_to(bound, expression.shape).ravel(order="F") for bound in (lower, upper))
        bounded = np.flatnonzero(np.isfinite(low) | np.isfinite(high))
        if len(bounded):
            column: Expression = ca.vec(expression)
            self._rows.append(column if len(bounded) == len(low) else column[bounded.tolist()])
            self._bounds["lbg"].append(low[bounded])
            self._bounds["ubg"].append(high[bounded])

    @cached_property
    def functions(self) -> dict[str, Expression]:
        """The finished programme, in the form of the solver."""
        x = ca.vertcat(*(ca.vec(block) for block in self.blocks.values()))
        return {"x": x, "f": self.cost, "g": ca.densify(ca.vertcat(*self._rows))}

    @property
    def bounds(self) -> dict[str, Array]:
        """Bounds of variables and rows under the names the solver has for them."""
        return {name: np.concatenate([np.empty(0), *parts]) for name, parts in self._bounds.items()}

    def split(self, x: Array) -> dict[str, Array]:
        """Return the blocks of a vector of all variables by name."""
        parts = np.split(x, np.cumsum([block.numel() for block in self.blocks.values()])[:-1])
        named = zip(self.blocks.items(), parts, strict=True)
        return {name: part.reshape(block.shape, order="F") for (name, block), part in named}

    def join(self, values: Mapping[str, Array]) -> Array:
        """Return the vector of all variables from blocks; those left out are zero."""
        filled = (np.broadcast_to(values.get(name, 0.0), block.shape) for name, block in self.blocks.items())
        return np.concatenate([part.ravel(order="F") for part in filled])


@dataclass(frozen=True, eq=False)
class Solution:
    """What the solver ended with.

    ``values``: the variables by name, scaled; ``optimal``: whether the conditions of a minimum hold; ``feasible``:
    whether every constraint holds; ``message``: the solver's own word for how it ended; ``cost``: the scaled objective;
    ``violation``: largest violation of a scaled constraint; ``iterations``: number of iterations; ``seconds``: time
    taken; ``point``: x and the multipliers of its bounds and of the rows; ``rows``: which rows these are (``NLP``).
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

    @property
    def infeasible(self) -> bool:
        """Whether the solver is convinced that no point keeps every constraint (nearby, as for any such solver)."""
        return self.message == "Infeasible_Problem_Detected"

    @property
    def stalled(self) -> bool:
        """Whether the search was ended far from keeping the constraints, as it came no closer."""
        return self.message == STALLED


def solve_nlp(
    nlp: NLP,
    guess: Mapping[str, Array],
    seconds: float,
    options: Options = FIRST,
    progress: Progress | None = None,
    patience: float = np.inf,
) -> Solution:
    """Solve a programme by IPOPT from one first guess.

    ``guess``: blocks by name, of which those left out start at zero; ``seconds``: time bound, s; ``progress``: called
    with a line of text now and then where the programme is long; ``patience``: iterations that come no closer to the
    constraints after which the search ends (``PATIENCE``).
    """
    began = time.perf_counter()
    bounds = nlp.bounds
    is_long = nlp.blocks["s"].shape[0] >= LONG
    observer = _observer(bounds, progress if is_long else None, patience)
    settings = {
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "print_time": False,
        "ipopt.tol": 1e-3 * TOLERANCE,
        "ipopt.acceptable_tol": TOLERANCE,
        "ipopt.constr_viol_tol": 1e-10,
        "ipopt.bound_relax_factor": 0.0,
        "ipopt.obj_scaling_factor": nlp.size,
        "ipopt.max_iter": 1000,
        "ipopt.max_wall_time": seconds,
        "no_nlp_grad": True,  # multipliers of parameters, of which there are none
        "iteration_callback": observer,
        **options,
    }
    function = ca.nlpsol("plan", "ipopt", nlp.functions, settings)
    result = function(x0=nlp.join(guess), **bounds)
    if observer.error is not None:
        raise observer.error
    stats, g = function.stats(), np.asarray(result["g"]).ravel()
    message = STALLED if observer.stalled else str(stats["return_status"])
    x, lam_x, lam_g = (np.asarray(result[name]).ravel() for name in ("x", "lam_x", "lam_g"))
    violation = _violation(bounds, g)
    return Solution(
        values=nlp.split(x),
        optimal=message in OPTIMAL,
        feasible=violation <= FEASIBLE,
        message=message,
        cost=float(result["f"]),
        violation=violation,
        iterations=int(stats["iter_count"]),
        seconds=time.perf_counter() - began,
        point=(x, lam_x, lam_g),
        rows=nlp.rows,
    )


def _observer(bounds: Mapping[str, Array], progress: Progress | None, patience: float) -> Any:
    """Return the iteration callback of the solver: it reports now and then, and ends a search that stalls.

    An exception raised by ``progress`` stops the solver and is kept in the attribute ``error``; ``stalled``: whether
    the violation of the rows did not shrink for ``patience`` iterations.
    """
    variables, rows = len(bounds["lbx"]), len(bounds["lbg"])
    sizes = {"x": variables, "f": 1, "g": rows, "lam_x": variables, "lam_g": rows, "lam_p": 0}
    began = time.perf_counter()

    class Observer(ca.Callback):
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.count, self.reported = 0, -PERIOD
            self.reached, self.since, self.stalled = np.inf, 0, False
            self.error: BaseException | None = None
            self.construct("observer", {})

        def get_n_in(self) -> int:
            return int(ca.nlpsol_n_out())

        def get_n_out(self) -> int:
            return 1

        def get_name_in(self, i: int) -> str:
            return str(ca.nlpsol_out(i))

        def get_sparsity_in(self, i: int) -> Any:
            return ca.Sparsity.dense(sizes[ca.nlpsol_out(i)], 1)

        def eval(self, arguments: Any) -> list[int]:
            now = time.perf_counter() - began
            if progress is not None and now - self.reported >= PERIOD:
                self.reported = now
                try:
                    progress(f"iteration {self.count}, {now:.0f} s: scaled objective {float(arguments[1]):.6g}")
                except BaseException as error:  # an interruption too would be lost in the library
                    self.error = error
                    return [1]
            self.count += 1
            violation = _violation(bounds, np.asarray(arguments[2]).ravel())
            self.since = 0 if violation < 0.9 * self.reached else self.since + 1
            self.reached = violation if self.since == 0 else self.reached
            self.stalled = self.since >= patience and self.reached > FAR
            return [int(self.stalled)]

    return Observer()


def _violation(bounds: Mapping[str, Array], g: Array) -> float:
    """Return the largest violation of the rows, whose values are g."""
    return float(np.maximum(bounds["lbg"] - g, g - bounds["ubg"]).max(initial=0.0))
