"""How the solver goes about a whole trajectory: which of its strategies, in which order, and how exactly it steps."""

from __future__ import annotations

from typing import Any

from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_solver import TOLERANCE

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
