"""The chapter on the thesis's own planners: both backends, the fair comparison, limits, and its conclusions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from redundancy_pin.dynamics.distribution import SampleStatus
from redundancy_pin.errors import CrossCheckError, InfeasiblePlanError
from redundancy_pin.planners.plan import Plan, PlanStatus
from redundancy_pin.planners.stepwise.planner import between_samples
from redundancy_pin.studies.case import Case, Mode, Plans
from redundancy_pin.studies.cases import (
    CORNERS,
    CROSSINGS,
    HEAVY_CROSSING,
    MODE_CASES,
    NONE,
    PARKED,
    Extent,
    parked,
    without_carriers,
)
from redundancy_pin.studies.claims import claim, verdict
from redundancy_pin.studies.measures import (
    broken_limits,
    exit_forces,
    farthest_position,
    numbers,
    peak_in,
    plan_differences,
    position_at_exit,
    window,
)
from redundancy_pin.studies.modes import square_returns, working_modes
from redundancy_pin.studies.statements import DIFFERENCES, in_order, judge_all, sensitivity, thesis
from redundancy_pin.studies.table import Record

Chapter = dict[str, Any]
"""Records of the tables of a chapter, by name."""

Tell = Callable[[str], None]
"""Called after each part with what was done."""

PLAN_TOLERANCE = 1e-8
"""Largest relative difference of two plans: carriers are integrated with error control, which rounding steers."""

POINTS = 4
"""Points inside each step at which stepwise plans are looked at."""

MOVING = "carriers moving"

PARTS = len(CROSSINGS) + len(CORNERS) + 5
"""How often ``run_planned`` tells of progress."""


def run_planned(plans: Plans, extent: Extent, tell: Tell) -> Chapter:
    """Run the chapter.

    Raises:
        CrossCheckError: the backends plan a case differently.
        InfeasiblePlanError: a case of the thesis has no plan.
    """
    parity = []
    for case in (*CROSSINGS, *CORNERS):
        parity.append(plan_parity(plans, case))
        tell(case.name)
    judged = judge_all(plans, extent)
    tell("statements")
    modes = working_modes(plans, extent.modes)
    chapter: Chapter = {
        "rule": thesis()["rule"],
        "parity": parity,
        "against_thesis": in_order([*judged, *modes.pop("judged")]),
        "between_samples": between_records(plans),
        **modes,
        "shortest_returns_on_square": square_returns(plans, extent.modes),
    }
    tell("working modes")
    chapter["crossings"] = [crossing_record(plans, case) for case in CROSSINGS]
    chapter["heavy_end_effector"] = heavy_record(plans)
    tell("limits of the crossings")
    chapter["fair_comparison"] = fair_comparison(plans, extent.modes)
    tell("fair comparison")
    chapter["sensitivity"] = sensitivity(plans, extent)
    tell("sensitivity")
    chapter["conclusions"] = conclusions(chapter)
    return chapter


def plan_parity(plans: Plans, case: Case) -> Record:
    """Plan a case with both backends and compare.

    Raises:
        CrossCheckError: the plans differ by more than ``PLAN_TOLERANCE``, or in status.
    """
    first, second = (plans.plan(case, backend) for backend in case.backends)
    differences = plan_differences(first, second)
    worst = float(np.max(list(differences.values())))
    if first.status is not second.status or not worst <= PLAN_TOLERANCE:
        raise CrossCheckError(
            f"The plans of {case.name} by the two backends differ by {worst:.3g} (relative; at most {PLAN_TOLERANCE:g} "
            f"is allowed); they are {first.status.value} and {second.status.value}.",
            remedy="One of them is wrong: run `redundancy-pin validate` to see where.",
            parity=differences,
        )
    return {"case": case.name, **differences, "status": first.status.value, "worst": worst}


def between_records(plans: Plans) -> list[Record]:
    """Return the main stepwise plans at and between their samples, while the optimiser works: (3,) |τ|, N·m."""
    records = []
    for case in CORNERS:
        plan = plans.plan(case)
        between = between_samples(case.dynamics(), plan, POINTS, case.trajectory())
        records.append(
            {
                "case": case.name,
                "at_samples": between["optimised_peak_at_samples"],
                "between": between["optimised_peak"],
                "baseline": np.abs(plans.plan(without_carriers(case)).tau).max(axis=0),
            }
        )
    return records


def crossing_record(plans: Plans, case: Case) -> Record:
    """Return what became of a crossing: limits broken, the shortest return, the jump on switching on."""
    plan = plans.plan(case)
    end = max(limits.upper for limits in plan.limits.judged_by)
    shortest = plans.outcome(case.with_options(return_time="shortest"))
    return {
        "case": case.name,
        "status": plan.status.value,
        "broken": broken_limits(plan),
        "beyond_track_at_exit": max(0.0, position_at_exit(plan)[0] - end),
        "beyond_track": max(0.0, farthest_position(plan)[0] - end),
        "shortest": float(window(shortest)["return_time"]) if isinstance(shortest, Plan) else math.nan,
        "no_shortest": "" if isinstance(shortest, Plan) else shortest.message,
        "jump": exit_forces(plan),
        "jump_of_differences": exit_forces(plans.plan(case.with_options(scheme=DIFFERENCES))),
        "step": case.dt,
        "peak_on_return": peak_in(plan, "return")[0],
    }


def heavy_record(plans: Plans) -> Record | None:
    """Return why the circle cannot be crossed with a massive end-effector; None if it can."""
    outcome = plans.outcome(HEAVY_CROSSING)
    if not isinstance(outcome, InfeasiblePlanError):
        return None
    mass = dict(HEAVY_CROSSING.arguments)["end_effector_mass"]
    return {"what": f"end-effector of {mass:g} kg", "message": outcome.message, "details": dict(outcome.details)}


# --- no carriers, carriers parked, carriers moving; both sets of actuators counted ---------------------------------


def fair_comparison(plans: Plans, modes: Sequence[Mode]) -> list[Record]:
    """Compare for every motion of the thesis; corners and square in every working mode."""
    records: list[Record] = []
    for case in CROSSINGS:
        motion = case.name.rpartition("-")[0]
        if not any(record["motion"] == motion for record in records):
            records.append(_fair(motion, (), PARKED, parked(case), plans))
        records.append(_fair(motion, (), f"{MOVING}, off above CN {case.option('threshold'):g}", case, plans))
    raised = [case for case in MODE_CASES.values() if case.option("speed") or case.option("acceleration")]
    for mode in modes:
        for motion in ("corner-r0.025", "corner-r0.013", "square"):
            cases = [replace(case, working_mode=mode) for case in (*CORNERS, *raised) if case.name.startswith(motion)]
            records.append(_fair(motion, mode, NONE, without_carriers(cases[0]), plans))
            records.append(_fair(motion, mode, PARKED, parked(cases[0]), plans))
            records += [_fair(motion, mode, _how(case), case, plans) for case in cases]
    return records


def _how(case: Case) -> str:
    acceleration, speed = case.option("acceleration"), case.option("speed")
    limit = f", {acceleration:g} m/s²" if acceleration else f", {speed:g} m/s" if speed else ""
    return f"{MOVING}, λ = {case.option('lam'):g}{limit}"


def _fair(motion: str, mode: Mode, how: str, case: Case, plans: Plans) -> Record:
    plan = plans.plan(case)
    bounded = plan.status is not PlanStatus.UNBOUNDED_EFFORT
    # along a singular motion efforts without a plan grow without bound between samples, even if no sample is singular
    bounded &= not (how == PARKED and (plan.sample_status != SampleStatus.REGULAR).any())
    shown = numbers(plan)
    if not bounded:
        shown |= dict.fromkeys(("peak", "rms", "main_energy", "energy"), math.inf) | {"status": "unbounded_effort"}
    kept = ("peak", "rms", "carrier_force", "main_energy", "carrier_energy", "energy", "status")
    return {"motion": motion, "mode": mode, "what": how, "unit": case.unit, "bounded": bool(bounded),
            **{name: shown[name] for name in kept}}  # fmt: skip


# --- conclusions ---------------------------------------------------------------------------------------------------


def conclusions(chapter: Mapping[str, Any]) -> list[Record]:
    """Return what becomes of the thesis's conclusions, from the records of the chapter."""
    crossings, fair = chapter["crossings"], chapter["fair_comparison"]
    records = [
        _crossing(crossings, chapter["heavy_end_effector"]),
        _limits(crossings),
        _exit_forces(crossings),
        _corner("wide_corner", fair, "corner-r0.025"),
        _corner("sharp_corner", fair, "corner-r0.013"),
        _square(fair),
        _shared(fair),
        _agreement(chapter["claims"]),
    ]
    return [{**record, "thesis": record["claim"]} for record in records]


def _crossing(crossings: Sequence[Record], heavy: Record | None) -> Record:
    inside = [record["case"] for record in crossings if record["status"] == "within_limits"]
    attempts = len(crossings) + 1
    return claim(
        "crossing", verdict(len(inside) + (heavy is None), attempts), crossed=len(crossings), inside=inside, heavy=heavy
    )


def _limits(crossings: Sequence[Record]) -> Record:
    broken = [record for record in crossings if record["status"] == "violates_limits"]
    return claim(
        "limits",
        verdict(len(crossings) - len(broken), len(crossings)),
        total=len(crossings),
        broken=[record["case"] for record in broken],
        out=[
            (record["case"], record["beyond_track_at_exit"]) for record in crossings if record["beyond_track_at_exit"]
        ],
        cured=[(record["case"], record["shortest"]) for record in broken if not record["no_shortest"]],
        never=[record["case"] for record in crossings if record["no_shortest"]],
    )


def _exit_forces(crossings: Sequence[Record]) -> Record:
    exact, stepped = (max(max(record[key]) for record in crossings) for key in ("jump", "jump_of_differences"))
    artefact = exact < 1e-3 * stepped
    same_motion = [
        max(record["jump_of_differences"]) for record in crossings if record["case"].startswith("circle-0.5-")
    ]
    return claim(
        "exit_forces",
        "does not stand" if artefact else "stands",
        artefact=artefact,
        exact=exact,
        stepped=stepped,
        step=crossings[0]["step"],
        by_threshold=same_motion,
        grows=len(same_motion) > 1 and sorted(same_motion) == same_motion,
    )


def _by_mode(fair: Sequence[Record], motion: str) -> list[dict[str, Record]]:
    """Return, for each working mode, the records of a motion by what moves."""
    groups: dict[Mode, dict[str, Record]] = {}
    for record in fair:
        if record["motion"] == motion:
            groups.setdefault(tuple(record["mode"]), {})[record["what"]] = record
    return list(groups.values())


def _corner(name: str, fair: Sequence[Record], motion: str) -> Record:
    groups, moving = _by_mode(fair, motion), f"{MOVING}, λ = 0"
    total = len(groups)
    below, below_parked = (
        sum(group[moving]["peak"] < group[other]["peak"] for group in groups) for other in (NONE, PARKED)
    )
    raised = {
        what.rpartition(", ")[2]: sum(group[what]["peak"] < group[NONE]["peak"] for group in groups)
        for what in groups[0]
        if what.startswith(moving + ",")
    }
    return claim(
        name,
        # of the sharper corner the thesis says that torques exceed the baseline's
        verdict(total - below if name == "sharp_corner" else below, total),
        total=total,
        below=below,
        below_parked=below_parked,
        factors=[group[moving]["peak"] / group[NONE]["peak"] for group in groups],
        parked=[group[PARKED]["peak"] / group[NONE]["peak"] for group in groups],
        raised=raised,
    )


def _square(fair: Sequence[Record]) -> Record:
    groups = _by_mode(fair, "square")
    pairs = [(group[what], group[NONE]) for group in groups for what in group if what.startswith(MOVING)]
    better = sum(moving["peak"] < none["peak"] for moving, none in pairs)
    return claim(
        "square",
        verdict(better, len(pairs)),
        total=len(pairs),
        better=better,
        broken=sum(moving["status"] != "within_limits" for moving, _ in pairs),
        peaks=[moving["peak"] / none["peak"] for moving, none in pairs],
        rms=[moving["rms"] / none["rms"] for moving, none in pairs],
    )


def _shared(fair: Sequence[Record]) -> Record:
    groups = [group for motion in ("corner-r0.025", "corner-r0.013") for group in _by_mode(fair, motion)]
    pairs = [(group[f"{MOVING}, λ = 0"], group[NONE]) for group in groups]
    relieved = sum(
        moving["peak"] < none["peak"] and moving["main_energy"] < none["main_energy"] for moving, none in pairs
    )
    return claim(
        "shared",
        verdict(relieved, len(pairs)),
        total=len(pairs),
        relieved=relieved,
        main=[moving["main_energy"] / none["main_energy"] for moving, none in pairs],
        energy=[moving["energy"] / none["energy"] for moving, none in pairs],
        carrier_force=[moving["carrier_force"] for moving, _ in pairs],
    )


def _agreement(claims: Sequence[Record]) -> Record:
    modes = list(claims[0]["modes"])
    counts = [sum(entry["modes"][mode]["holds"] for entry in claims) for mode in modes]
    best, total = max(counts), len(claims)
    return claim(
        "agreement",
        verdict(sum(count == total for count in counts), len(counts)),
        total=total,
        best=best,
        modes=[mode for mode, count in zip(modes, counts, strict=True) if count == best],
    )
