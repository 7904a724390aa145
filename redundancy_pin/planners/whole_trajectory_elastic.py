"""Why there is no plan: the smallest relaxation of the limits that admits one."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_limits import KINDS, scaled_bounds
from redundancy_pin.planners.whole_trajectory_solver import Solution

NOTHING = 1e-5
"""A relaxation below this fraction of a limit is none: the price of the objective and the reserve leave as much."""

OUT_OF_TIME = "Maximum_WallTime_Exceeded"
"""The solver's word for it."""

_UNITS = {"track": "m", "speed": "m/s", "acceleration": "m/s²", "jerk": "m/s³", "effort": "N or N·m", "force": "N"}


def explain(
    problem: WholeProblem, carriers: tuple[str, ...], elastic: Solution, message: str
) -> InfeasiblePlanError | None:
    """Return the error that says which limits are in the way, or None where the elastic problem finds none.

    The error carries ``constraint`` (the limit let out most), ``time``, ``amount`` by which it is exceeded there,
    ``limit`` that would suffice, and ``relaxations``: the same for every limit that was let out. Together they suffice;
    their sum, as fractions of the limits, is as small as was found.

    Args:
        problem: the numbers.
        carriers: (k,) names.
        elastic: solution of the elastic problem.
        message: how the solver ended on the ordinary one.
    """
    if not elastic.feasible:
        if elastic.message == OUT_OF_TIME:
            return InfeasiblePlanError(
                "The time ran out before any plan was found, and before any limit was shown to be in the way.",
                remedy="Allow more seconds, or a longer dt.",
                constraint="seconds",
                time=float(problem.grid.t[0]),
                amount=elastic.violation,
            )
        return InfeasiblePlanError(
            "No plan was found, nor one with relaxed limits "
            f"(the solver says {message}, then {elastic.message}; unbalanced by {elastic.violation:.2g} of f).",
            remedy="The actuators and carriers cannot balance this motion at all: lead the platform elsewhere.",
            constraint="balance",
            time=float(problem.grid.t[0]),
            amount=elastic.violation,
        )
    slack = dict(zip(KINDS, elastic.values["slack"].tolist(), strict=True))
    let_out = sorted((kind for kind in KINDS if slack[kind] > NOTHING), key=lambda kind: -slack[kind])
    if not let_out:
        return None
    events = [_event(problem, carriers, elastic, kind, slack[kind]) for kind in let_out]
    first = events[0]
    text = "; ".join(str(event["text"]) for event in events)
    relaxations = tuple({name: value for name, value in event.items() if name != "text"} for event in events)
    details = {name: value for name, value in relaxations[0].items() if name != "constraint"}
    return InfeasiblePlanError(
        f"No motion of the carriers keeps every limit. A plan exists with these let out: {text}.",
        remedy="Relax these limits by as much, slow the motion down, or leave the end free.",
        constraint=str(first["constraint"]),
        relaxations=relaxations,
        **details,
    )


def _event(
    problem: WholeProblem, carriers: tuple[str, ...], elastic: Solution, kind: str, fraction: float
) -> dict[str, object]:
    """Return what is exceeded most, where, and what would suffice."""
    t = problem.grid.t
    if kind == "end":
        missed = np.abs(elastic.values["s"][-1] - problem.settings.datum / problem.scales.s) * problem.scales.s
        if problem.settings.end == "datum":
            text = f"the carriers end up to {missed.max():.4g} m from the datum"
        else:
            text = f"the end state by {fraction:.3g} of its size"
        return {"constraint": kind, "time": float(t[-1]), "amount": float(missed.max()), "text": text}
    values, low, high, names = _quantity(problem, carriers, elastic, kind)
    excess = np.maximum(values - high, low - values)
    i, j = np.unravel_index(int(np.argmax(np.where(np.isfinite(excess), excess, -np.inf))), excess.shape)
    upper = bool(values[i, j] - high[j] >= low[j] - values[i, j])
    limit, amount, unit = float((high if upper else low)[j]), float(excess[i, j]), _UNITS[kind]
    enough = limit + (amount if upper else -amount)
    text = (
        f"the {kind} of {names[j]}, from {limit:.6g} to {enough:.6g} {unit} ({100.0 * fraction:.3g} %), "
        f"most at t = {t[i]:.6g} s"
    )
    return {
        "constraint": kind,
        "carrier": names[j],
        "time": float(t[i]),
        "amount": amount,
        "limit": enough,
        "unit": unit,
        "fraction": fraction,
        "text": text,
    }


def _quantity(
    problem: WholeProblem, carriers: tuple[str, ...], elastic: Solution, kind: str
) -> tuple[Array, Array, Array, tuple[str, ...]]:
    """Return the values of a limited quantity at the nodes, its bounds, and whose they are."""
    u = problem.scales
    if kind == "jerk":
        h = np.maximum(problem.grid.h, np.finfo(float).tiny)[:, None]
        jerk = np.where(problem.grid.h[:, None] > 0.0, np.diff(elastic.values["sdd"], axis=0) * u.sdd / h, 0.0)
        return jerk, -problem.settings.jerk, problem.settings.jerk, carriers
    name, size = {
        "track": ("s", u.s),
        "speed": ("sd", u.sd),
        "acceleration": ("sdd", u.sdd),
        "effort": ("tau", np.full(problem.model.W.shape[2], u.tau)),
        "force": ("force", u.force),
    }[kind]
    low, high = (bound * size for bound in scaled_bounds(problem)[name])
    names = carriers if kind != "effort" else tuple(f"main actuator {j + 1}" for j in range(len(size)))
    return elastic.values[name] * size, low, high, names
