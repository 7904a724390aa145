"""What a plan is, as plain data and in sentences, for reports and the command line."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from redundancy_pin.arrays import stretches
from redundancy_pin.planners.limits import LimitEvent, worst_events
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus

_MANY_REVERSALS = 10
"""Reversals of an effort near singularities up to which nothing is advised: a motion itself makes a few."""

_CALMING = 0.01
"""Weight of "effort_rate" that takes the 2-RPR's circle from 35 reversals to 6, for 8 % more peak."""

_LISTED = 6
"""Broken limits that a warning lists; the rest is counted."""

_FINER = {
    "whole_trajectory": "allow more refinements, or a shorter dt",
    "stepwise": "use a shorter dt, or both sides of each jump",
    "receding_horizon": "use a shorter step",
    "time_optimal": "allow more refinements, or more steps",
    "switch_off": "use a shorter dt",
}
"""What helps a planner whose samples do not show its efforts."""

_AS_IT_IS = ("peak_effort", "peak_effort_at_samples", "rms_effort", "main_energy", "carrier_energy", "reversals",
             "least_cost", "parameters", "diagnostics")  # fmt: skip


def summary(plan: Plan) -> dict[str, Any]:
    """Return what is worth knowing of a plan as plain data, by name; SI units.

    ``smallest_margin`` is zero if the plan crosses a singularity, though no sample may lie on it; ``phases`` has name,
    first and last time of every run of samples in one phase.

    Example:
        >>> summary(rp.load_plan("plan.npz"))["status"]
        'ok'
    """
    crossed = bool(plan.findings.singular_instants)
    return {
        "robot": plan.robot.name,
        "planner": plan.planner,
        "status": plan.status.value,
        "optimal": plan.findings.optimal if plan.findings.solver else None,
        "samples": len(plan.t),
        "start": float(plan.t[0]),
        "end": float(plan.t[-1]),
        "advice": advice(plan),
        "peak_carrier_force": np.abs(plan.carrier_force).max(axis=0, initial=0.0),
        "smallest_margin": 0.0 if crossed else float(np.fmin.reduce(plan.margin)),
        "phases": [
            {"name": plan.phases[plan.phase[first]], "start": float(plan.t[first]), "end": float(plan.t[stop - 1])}
            for first, stop in stretches(plan.phase)
        ],
        "findings": asdict(plan.findings),
        "limits": {kind: [vars(event) for event in getattr(plan.limits, kind)] for kind in ("violated", "binding")},
        **{name: getattr(plan, name) for name in _AS_IT_IS},
    }


def advice(plan: Plan) -> str | None:
    """Return what reduces the reversals of efforts near singularities of an optimised plan; None if there are few.

    Least efforts, and least peaks above all, leave the solver free to oscillate there: a price on their rate does not.
    """
    weights = plan.parameters.get("objective")
    if not isinstance(weights, Mapping) or "effort_rate" in weights:
        return None
    reversals = int(plan.reversals_near_singularities.max(initial=0))
    if reversals <= _MANY_REVERSALS:
        return None
    calmer = ", ".join(f"{name}={weight:g}" for name, weight in {**weights, "effort_rate": _CALMING}.items())
    return f"an effort reverses {reversals} times near singularities; a price on its rate calms it: objective {calmer}"


def warnings_of(plan: Plan, *, ranges: bool = True) -> Iterator[str]:
    """Give what is wrong with a plan, a sentence each; broken ranges of passive joints only with ``ranges``."""
    check = plan.between
    broken = tuple(event for event in plan.limits.violated if ranges or event.quantity != "range")
    if broken and plan.status is ResultStatus.LIMIT_VIOLATED:
        texts = event_texts(plan, broken, broken=True)
        more = [f"and {len(texts) - _LISTED} more"] if len(texts) > _LISTED else []
        yield f"limits broken: {'; '.join([*texts[:_LISTED], *more])}."
    if plan.status is ResultStatus.UNBOUNDED:
        bad = np.flatnonzero(~np.isfinite(plan.tau).all(axis=1))
        where = f" between the samples, at t = {check.time[int(check.peak.argmax())]:.6g} s"
        if len(bad):
            where = f" first at t = {plan.t[bad[0]]:.6g} s, at {len(bad)} of {len(plan.t)} samples"
        yield f"no finite main efforts:{where}, where W is singular."
    if not plan.findings.optimal:
        kept = plan.status in (ResultStatus.NOT_CONVERGED, ResultStatus.UNRESOLVED)
        there = "The plan keeps every limit, but there" if kept else "There"
        remedy = "use a shorter dt" if plan.planner == "stepwise" else "allow more seconds"
        yield (
            f"this is no optimum: the optimiser stopped early ({plan.findings.solver}). "
            f"{there} may be a better one; {remedy}."
        )
    if not check.passed and np.isfinite(check.ratio):
        worst = int(check.peak.argmax())
        yield (
            f"between the samples the efforts are {check.ratio:.4g} times those at the samples, up to "
            f"{check.peak[worst]:.4g} {plan.robot.effort_unit(plan.robot.actuated[worst])} at t = "
            f"{check.time[worst]:.6g} s: {_FINER[plan.planner]}."
        )


def event_texts(plan: Plan, events: tuple[LimitEvent, ...], *, broken: bool) -> list[str]:
    """Return a text for the worst event of each quantity of each joint: by how much a limit is broken, or which."""
    texts = []
    for event in worst_events(events):
        unit = plan.robot.limit_unit(event.quantity, event.joint)
        limit = event.limit if event.quantity in ("track", "range") else abs(event.limit)  # the others are of a size
        much = f"by {event.amount:.3g} {unit}" if broken else f"at its limit {limit:.3g} {unit}"
        texts.append(f"{event.quantity} of {event.joint} {much} at t = {event.worst:.4g} s")
    return texts
