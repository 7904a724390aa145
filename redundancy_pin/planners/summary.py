"""What a plan is, as plain data, as a table and in sentences."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import stretches
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.io.summary import Summary, TextTable, listed, number, row
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.planners.limits import LimitEvent, worst_events
from redundancy_pin.planners.robot_record import RobotRecord
from redundancy_pin.robot.joint_ranges import JointExcess, beyond_limits
from redundancy_pin.status import ResultStatus, UpdateStatus

if TYPE_CHECKING:
    from redundancy_pin.planners.plan import Plan

REVERSAL = 0.05
"""Change after a turning point, as a fraction of the peak effort, from which the turning point is a reversal."""

_MANY_REVERSALS = 10
"""Reversals of an effort near singularities up to which nothing is advised: a motion itself makes a few."""

_CALMING = 0.01
"""Weight of "effort_rate" that takes the 2-RPR's circle from 35 reversals to 6, for 8 % more peak."""

_LISTED = 6
"""Limits that a warning or a table lists; the rest is counted."""

_LISTED_PHASES = 10
"""The same of phases: a stepwise plan may change its phase at every step."""

_FINER = {
    "whole_trajectory": "allow more refinements, or a shorter dt",
    "stepwise": "use a shorter dt, or both sides of each jump",
    "time_optimal": "allow more refinements, or more steps",
    "switch_off": "use a shorter dt",
}
"""What helps a planner whose samples do not show its efforts."""

_AS_IT_IS = ("peak_effort", "peak_effort_at_samples", "rms_effort", "main_energy", "carrier_energy", "reversals",
             "least_cost", "parameters", "diagnostics")  # fmt: skip


def summary(plan: Plan, dynamics: DynamicsLike | None = None) -> Summary:
    """Return ``Plan.summary``."""
    crossed = bool(plan.findings.singular_instants)
    facts: dict[str, Any] = {
        "robot": plan.robot.name,
        "planner": plan.planner,
        "status": plan.status.value,
        "optimal": plan.findings.optimal if plan.findings.solver else None,
        "samples": len(plan.t),
        "start": float(plan.t[0]),
        "end": float(plan.t[-1]),
        "advice": advice(plan),
        "peak_carrier_force": plan.between.force_peak,
        "smallest_margin": 0.0 if crossed else float(np.fmin.reduce(plan.margin)),
        "phases": [
            {"name": plan.phases[plan.phase[first]], "start": float(plan.t[first]), "end": float(plan.t[stop - 1])}
            for first, stop in stretches(plan.phase)
        ],
        "findings": asdict(plan.findings),
        "limits": {kind: [vars(event) for event in getattr(plan.limits, kind)] for kind in ("violated", "binding")},
        **{name: getattr(plan, name) for name in _AS_IT_IS},
    }
    left: tuple[JointExcess, ...] = ()
    if dynamics is not None:
        dynamics = as_dynamics(dynamics)
        q = inverse_kinematics(dynamics.robot, plan.motion, mark_unreachable=True).q
        left = beyond_limits(dynamics.robot, q, plan.t)
        point = np.asarray(plan.parameters.get("base_point", (0.0, 0.0, 0.0)))
        base = np.linalg.norm(plan.base_wrench(dynamics, point).reshape(-1, 2, 3), axis=2).max(axis=0)
        facts |= {"peak_base_force": base[0], "peak_base_moment": base[1], "base_point": point}
        facts["joint_limits"] = [vars(one) for one in left]
    warnings = [*(f"{one}." for one in left), *warnings_of(plan, ranges=not left)]
    return Summary(facts, _table(plan, facts), warnings=warnings)


def _table(plan: Plan, facts: Mapping[str, Any]) -> TextTable:
    status = plan.status.value.replace("_", " ")
    if not plan.findings.optimal:
        status = f"{status}: no optimum, the solver says {plan.findings.solver}"
    phases = [f"{one['name'].replace('_', ' ')} {one['start']:.4g}–{one['end']:.4g}" for one in facts["phases"]]
    # of the joints' kinds: a robot may have motors that turn and carriers that slide
    main, moved = plan.robot.effort_units
    rows = [
        ("status", status),
        ("time [s]", f"{facts['start']:.6g} to {facts['end']:.6g}, {facts['samples']} samples"),
        ("phases [s]", listed(phases, _LISTED_PHASES, ", ")),
        (f"peak main effort [{main}]", row(facts["peak_effort"])),
        (f"rms main effort at the samples [{main}]", row(facts["rms_effort"])),
        (f"reversals above {100.0 * REVERSAL:g} % of the peak, at the samples", row(facts["reversals"])),
        (f"peak carrier effort [{moved}]", row(facts["peak_carrier_force"])),
    ]
    if "base_point" in facts:
        moment = f"its moment about {row(facts['base_point'])} m [N·m]"
        rows += [("peak force on the base at the samples [N]", number(facts["peak_base_force"]))]
        rows += [(moment, number(facts["peak_base_moment"]))]
    rows += [
        ("energy at the samples, main actuators [J]", number(plan.main_energy)),
        ("energy at the samples, carriers [J]", number(plan.carrier_energy)),
        ("smallest margin", number(facts["smallest_margin"])),
        *_optimum(plan),
        *([("advice", facts["advice"])] if facts["advice"] else []),
    ]
    for name, events in (("limits broken", plan.limits.violated), ("limits touched", plan.limits.binding)):
        texts = event_texts(plan.robot, events, broken=events is plan.limits.violated)
        rows.append((name, listed(texts, _LISTED, "\n") or "none"))
    return TextTable(f"{plan.robot.name}, {plan.planner.replace('_', ' ')}", rows)


def _optimum(plan: Plan) -> Iterator[tuple[str, str]]:
    """Add the optimum and the nodes of an optimised plan."""
    facts: Mapping[str, Any] = plan.diagnostics
    if "nodes" not in facts:
        return
    weights: Any = plan.parameters.get("objective", {"time": 1.0})
    yield "minimised", ", ".join(name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights.items())
    reached = "local optimum" if plan.findings.optimal else "NOT an optimum"
    yield "reached", f"{reached} in {facts['iterations']} iterations, {facts['seconds']:.3g} s"
    if plan.least_cost is not None:
        calmer = f"; this plan costs up to {plan.parameters['calm']:g} of it more, to be calm"
        yield "least cost", f"{plan.least_cost:.6g}{calmer if facts['calm']['kept'] else ''}"
    yield "nodes", f"{facts['nodes']}, {len(facts['singular_nodes'])} of them singular"
    hidden = 100.0 * (plan.between.ratio - 1.0)
    yield "efforts between the nodes", f"at most {hidden:.4g} % of the largest above those at the nodes"


def advice(plan: Plan) -> str | None:
    """Return a remedy for the reversals of efforts near singularities of an optimised plan; None if there are few.

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
    """Return the problems of a plan, a sentence each; broken ranges of passive joints only with ``ranges``."""
    check, late, finer = plan.between, [*_unplanned(plan)], _FINER.get(plan.planner, "use a shorter step")
    finer = "" if late else finer
    broken = tuple(event for event in plan.limits.violated if ranges or event.quantity != "range")
    if broken and plan.status is ResultStatus.LIMIT_VIOLATED:
        yield limits_broken(plan.robot, broken)
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
        shown = plan.peak_effort_at_samples
        worst = int((check.peak - shown).argmax())
        name = plan.robot.actuated[worst]
        yield (
            f"the samples do not show the efforts between them: {name} takes up to {check.peak[worst]:.4g} "
            f"{plan.robot.effort_unit(name)} at t = {check.time[worst]:.6g} s, and {shown[worst]:.4g} at the samples"
            f"{finer and f': {finer}'}."
        )
    yield from late


def _unplanned(plan: Plan) -> Iterator[str]:
    """Give the updates of an on-line run without a plan within every limit, and a remedy."""
    ticks: Any = plan.diagnostics.get("ticks", {})
    without = {
        each.value: ticks[each.value] for each in (UpdateStatus.RELAXED, UpdateStatus.FALLBACK) if ticks.get(each.value)
    }
    if not without:
        return
    counts = ", ".join(f"{count} {name}" for name, count in without.items())
    reasons: Any = plan.diagnostics.get("reasons", ())
    # where efforts run along their limit they are what is missed, and a lower speed may miss them by more: beside a
    # singular pose. Where carriers are late for a singular pose, efforts leap over their limit there
    short = any(event.quantity == "effort" for event in plan.limits.binding)
    slower = ""
    if not (short or plan.parameters.get("slow_down", False)):
        slower = "try to lead the platform more slowly (slow_down=True, --slow-down), or "
    yield (
        f"{sum(without.values())} of {sum(ticks.values())} ticks had no plan within every limit "
        f"({'; '.join((counts, *reasons))}): {slower}loosen the limits, or lower the speed of the motion."
    )


def limits_broken(robot: RobotRecord, events: tuple[LimitEvent, ...]) -> str:
    """Return the warning that limits are broken: which, by how much, and when."""
    return f"limits broken: {listed(event_texts(robot, events, broken=True), _LISTED, '; ')}."


def event_texts(robot: RobotRecord, events: tuple[LimitEvent, ...], *, broken: bool) -> list[str]:
    """Return a text for the worst event of each quantity of each joint: by how much a limit is broken, or which."""
    texts = []
    for event in worst_events(events):
        unit = robot.limit_unit(event.quantity, event.joint)
        limit = event.limit if event.quantity in ("track", "range") else abs(event.limit)  # the others are of a size
        much = f"by {event.amount:.3g} {unit}" if broken else f"at its limit {limit:.3g} {unit}"
        texts.append(f"{event.quantity} of {event.joint} {much} at t = {event.worst:.4g} s")
    return texts
