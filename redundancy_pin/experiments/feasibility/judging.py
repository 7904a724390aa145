"""What a plan, or the lack of one, says of a cell."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from redundancy_pin.errors import (
    InfeasiblePlanError,
    SingularPoseError,
    UnreachablePoseError,
    WorkingModeError,
)
from redundancy_pin.experiments.feasibility.cell import Cell, Verdict
from redundancy_pin.experiments.feasibility.machine import Machine
from redundancy_pin.planners.plan import Plan, PlanStatus
from redundancy_pin.planners.whole_trajectory.dense_check import ALLOWED

BINDS = 0.999
"""A limit is said to bind where this fraction of it is used: an interior-point solution stays a little inside."""

ROUNDING = 1e-6
"""Relative excess of an effort over its limit that counts as rounding."""

UNDECIDED = ("seconds", "balance")
"""What an error of the planner names where it shows of no limit that it is in the way."""


def judge(planner: str, plan: Plan, made: Machine) -> Cell:
    """Return what a plan says of its cell.

    A plan that breaks a limit of the carriers, exceeds the limit of the main efforts, or needs unbounded ones is none.

    Args:
        planner: its name.
        plan: the plan.
        made: the machine it is for.

    Returns:
        The cell, whose place is still to be filled in.
    """
    ratio = _dense_ratio(plan)
    peak = float(plan.peak_effort.max(initial=0.0))
    between = peak * max(1.0, ratio or 1.0)
    cell = Cell(planner, 0.0, 0.0, Verdict.FEASIBLE, dense_ratio=ratio, status=plan.status.value)
    if plan.status is PlanStatus.UNBOUNDED_EFFORT:
        return replace(cell, verdict=Verdict.INFEASIBLE, limits=("effort",), message="No finite main efforts exist.")
    cell = replace(cell, peak_effort=between)
    broken = _broken(plan, peak, made.effort)
    if broken:
        worst = broken[0]
        message = "; ".join(f"{name} of {who} by {by:.4g} at {t:.4g} s" for _, name, who, t, by in broken[:4])
        return replace(
            cell,
            verdict=Verdict.INFEASIBLE,
            limits=tuple(dict.fromkeys(entry[1] for entry in broken)),
            carrier=worst[2],
            time=worst[3],
            amount=worst[4],
            message=f"The plan breaks limits: {message}.",
        )
    if made.effort is not None and between > ALLOWED * made.effort:
        return replace(
            cell, verdict=Verdict.FAILED, message=f"Between the nodes the efforts reach {between:.4g}: not resolved."
        )
    early = plan.status is PlanStatus.STOPPED_EARLY
    verdict = Verdict.STOPPED_EARLY if early else Verdict.FEASIBLE
    message = f"The solver says {plan.diagnostics.get('solver')}." if early else ""
    return replace(cell, verdict=verdict, limits=_binding(plan, peak, made), message=message)


def _broken(plan: Plan, peak: float, effort: float | None) -> list[tuple[float, str, str, float, float]]:
    """Return relative excess, quantity, whose, when and amount of every limit that is broken, the worst first."""
    found = [
        (event.amount / max(abs(event.limit), 1e-12), event.quantity, event.carrier, event.worst, event.amount)
        for event in plan.limits.violated
        if event.quantity != "effort"  # judged below; between the nodes it says that the plan is not resolved
    ]
    if effort is not None and peak > effort * (1.0 + ROUNDING):
        i, j = np.unravel_index(int(np.nanargmax(np.abs(plan.tau))), plan.tau.shape)
        found.append(((peak - effort) / effort, "effort", plan.robot.actuated[int(j)], float(plan.t[i]), peak - effort))
    return sorted(found, reverse=True)


def _binding(plan: Plan, peak: float, made: Machine) -> tuple[str, ...]:
    """Return the limits of which a plan uses all but a thousandth, the one most used first."""
    s, limits = plan.carriers, plan.limits.judged_by
    lower, upper, speed, acceleration, force = (
        np.array([getattr(limit, name) for limit in limits])
        for name in ("lower", "upper", "speed", "acceleration", "force")
    )
    use = {
        "track": np.abs(s.s - 0.5 * (lower + upper)) / (0.5 * (upper - lower)),
        "speed": np.abs(s.sd) / speed,
        "acceleration": np.abs(s.sdd) / acceleration,
        "force": np.abs(plan.carrier_force) / force,
        "effort": np.array([peak / made.effort if made.effort else 0.0]),
    }
    if made.jerk:
        h = np.diff(plan.t)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            jerk = np.where(h > 0.0, np.diff(s.sdd, axis=0) / h, 0.0)
        use["jerk"] = np.abs(jerk) / made.jerk
    most = {name: float(np.max(np.where(np.isfinite(part), part, 0.0), initial=0.0)) for name, part in use.items()}
    return tuple(name for name in sorted(most, key=lambda name: -most[name]) if most[name] >= BINDS)


def _dense_ratio(plan: Plan) -> float | None:
    found: Any = plan.diagnostics
    if "dense_check" in found:
        return float(found["dense_check"]["ratio"])
    if "between_samples" in found:
        peak = float(plan.peak_effort.max(initial=0.0))
        return max(found["between_samples"]["peak_effort"]) / peak if peak > 0.0 else None
    return None


def of_error(planner: str, error: Exception) -> Cell:
    """Return what an error says of its cell.

    Poses out of reach, type I singularities and changes of the working mode are limits of the machine. Errors that name
    no constraint, or one that only says that the planner gave up, leave the cell unknown.
    """
    message = f"{type(error).__name__}: {' '.join(str(error).split())}"
    if isinstance(error, (UnreachablePoseError, SingularPoseError, WorkingModeError)):
        return Cell(planner, 0.0, 0.0, Verdict.INFEASIBLE, limits=("workspace",), message=message)
    details: Mapping[str, Any] = error.details if isinstance(error, InfeasiblePlanError) else {}
    constraint = str(details.get("constraint", ""))
    if not constraint or constraint in UNDECIDED:
        return Cell(planner, 0.0, 0.0, Verdict.FAILED, message=message)
    limits: tuple[str, ...] = (constraint,)
    if details.get("together"):
        limits = tuple(dict.fromkeys(str(entry["constraint"]) for entry in details["relaxations"]))
    when = details.get("time", details.get("t"))
    return Cell(
        planner,
        0.0,
        0.0,
        Verdict.INFEASIBLE,
        limits=limits,
        carrier=None if details.get("carrier") is None else str(details["carrier"]),
        time=None if when is None else float(when),
        amount=None if details.get("amount") is None else float(details["amount"]),
        message=message,
    )
