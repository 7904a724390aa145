"""How the solver goes about a whole trajectory: which of its strategies, in which order, and how exactly it steps."""

from __future__ import annotations

from typing import Any

from redundancy_pin.planners.whole_trajectory_data import WholeProblem

Options = dict[str, Any]
"""Options of IPOPT by name."""

PREDICTED: Options = {
    "ipopt.mehrotra_algorithm": "yes",
    "ipopt.mu_strategy": "adaptive",
    "ipopt.max_iter": 80,
}
"""Mehrotra's predictor and corrector, made for quadratic programmes, which these are but for a few bilinear rows. On
least peak it takes 22 iterations where the monotone strategy takes 28 (the corner, 280 nodes), and 40 where that takes
63 and 96 (the square, 1000 and 3000 nodes). It has no line search, hence the bound on its iterations."""

ADAPTIVE: Options = {"ipopt.mu_strategy": "adaptive"}
"""This strategy often ends where the monotone one crawls."""

UNREFINED: Options = {
    "ipopt.fast_step_computation": "yes",
    "ipopt.mumps_permuting_scaling": 0,
    "ipopt.mumps_scaling": 0,
}
"""Takes steps as they come from one solution of the linear system: the programme is scaled already. A fourth faster on
the 3-RRR; whether the result is an optimum is judged as strictly."""

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

FINISH = _from_solution(push=1e-9, mu=1e-10)
"""For the last of Newton's steps on a flat optimum, one to five: efforts from two backends then agree to 1e-8. Pushes
of 1e-12 would accept the point as it is."""


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
        return ({},)
    steps: Options = {} if len(problem.grid.t) >= MANY else UNREFINED
    return tuple({**scaling(problem), **steps, **strategy} for strategy in (PREDICTED, {}))


def with_more_rows(problem: WholeProblem) -> Options:
    """Return the options for a solution that is begun from that of a programme with fewer rows."""
    exact = is_flat(problem) or len(problem.grid.t) >= MANY
    return {**scaling(problem), **({} if exact else UNREFINED), **WARM}


def last_steps(problem: WholeProblem) -> Options:
    """Return the options for the exact steps that end on a flat optimum."""
    return {**scaling(problem), **FINISH}


def later_attempts(problem: WholeProblem) -> tuple[Options, ...]:
    """Return what to try in turn on a problem with every row, where the first attempts did not end at an optimum."""
    return tuple({**scaling(problem), **strategy} for strategy in ({}, ADAPTIVE))
