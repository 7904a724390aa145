"""Verdicts on claims follow the records of their chapter, and those of a quick run never contradict the full one."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import pytest

from redundancy_pin.thesis.beyond import INFEASIBLE, MODE_METHODS, TARGETS, targets
from redundancy_pin.thesis.cases import (
    EFFORT,
    ENERGY,
    MOVING,
    NONE,
    PARKED,
    PEAK,
    PEAK_FREE,
    SINGULAR,
    SMOOTH,
    STEPWISE,
    SWITCH_OFF,
    SWITCH_OFF_LATE,
    TURNS,
)
from redundancy_pin.thesis.claims import CONCLUSIONS, FINDINGS, NOT_JUDGED, THESIS_SPEED, verdicts

Change = Callable[[dict[str, Any]], dict[str, Any]]


def by_name(claims: Any, chapter: Mapping[str, Any], complete: bool = True) -> dict[str, dict[str, Any]]:
    records = verdicts(claims, chapter, complete=complete)
    assert all(record["claim"] and record["here"] and "{" not in record["here"] for record in records)
    return {record["name"]: record for record in records}


# --- conclusions of the thesis -------------------------------------------------------------------------------------

CROSSING = {"case": "circle-0.5-cn5", "status": "limit_violated", "jump": (1e-12, 1e-12)}
SOUND = {**CROSSING, "status": "ok"}
HEAVY = {"what": "end-effector of 0.5 kg", "message": "no", "details": {"amount": 0.25}}


def conclusions(
    moving: tuple[float, float] = (1.0, 1.0),
    crossing: Any = CROSSING,
    heavy: Any = HEAVY,
    holds: tuple[bool, bool] = (False, False),
    energy: float = 0.1,
    status: str = "limit_violated",
    complete: bool = True,
) -> dict[str, dict[str, Any]]:
    """Conclusions of every motion in two modes: 3 N·m without carriers, 12 parked, and a given peak moving.

    At the sharp corner raised limits lower the peak, to 2 N·m, in mode + alone; ``status`` is of plans that move.
    Of two statements in words the first holds in mode + and, as ``holds`` says, in mode −; the second as it says.
    """
    records = []
    for motion in ("corner-r0.025", "corner-r0.013", "square"):
        for mode, peak in zip(((1, 1, 1), (-1, -1, -1)), moving, strict=True):
            for what, peak_of, used in (
                (NONE, 3.0, 0.4),
                (PARKED, 12.0, 1.4),
                (f"{MOVING}, λ = 0", peak, energy * peak),
            ):
                own = 5.0 if what.startswith(MOVING) else 0.0
                records.append({"motion": motion, "mode": mode, "what": what, "peak": peak_of, "main_energy": used,
                                "energy": used + own, "status": status if own else "ok"})  # fmt: skip
            if motion == "corner-r0.013":
                raised = f"{MOVING}, λ = 0, 12 m/s²"
                records.append({**records[-1], "what": raised, "peak": 2.0 if mode[0] > 0 else 3.0})
    claims = [{"modes": {"+": {"holds": True}, "−": {"holds": holds[0]}}},
              {"modes": {"+": {"holds": holds[1]}, "−": {"holds": holds[1]}}}]  # fmt: skip
    chapter = {"crossings": [crossing], "fair_comparison": records, "heavy_end_effector": heavy, "claims": claims}
    return by_name(CONCLUSIONS, chapter, complete)


@pytest.mark.parametrize(
    ("name", "changes", "good", "shown"),
    [
        ("crossing", {}, (0, 2), "0 keep the carriers' limits (none). With an end-effector of 0.5 kg none exists"),
        ("crossing", {"crossing": SOUND}, (1, 2), "0.25 N is left"),
        ("crossing", {"crossing": SOUND, "heavy": None}, (2, 2), "1 keep the carriers' limits (circle-0.5-cn5)."),
        ("limits", {}, (0, 1), "1 of 1 plans break a limit (circle-0.5-cn5)"),
        ("limits", {"crossing": SOUND}, (1, 1), "0 of 1 plans break a limit (none)"),
        ("limits", {"crossing": {**CROSSING, "status": "not_converged"}}, (1, 1), "0 of 1 plans break a limit (none)"),
        ("exit_forces", {}, (0, 1), "1e-12 N at most"),
        ("exit_forces", {"crossing": {**CROSSING, "jump": (0.0, 0.0051)}}, (1, 1), "0.005 N at most"),
        ("wide_corner", {}, (2, 2), "lower in 2 of 2 working modes (0.33 times)"),
        ("wide_corner", {"moving": (2.0, 9.0)}, (1, 2), "(0.67 to 3 times), against the same machine with parked"),
        ("wide_corner", {"moving": (2.0, 9.0)}, (1, 2), "carriers in 2"),
        ("wide_corner", {"moving": (13.0, 9.0)}, (0, 2), "parked carriers in 1"),
        ("wide_corner", {"moving": (2.0, 9.0)}, (1, 2), "parked carriers alone make it 4 times as large."),
        # there the thesis says that torques exceed the baseline
        ("sharp_corner", {}, (0, 2), "4 times as large. With 12 m/s² it is lower in 1."),
        ("sharp_corner", {"moving": (2.0, 9.0)}, (1, 2), ""),
        ("sharp_corner", {"moving": (9.0, 9.0)}, (2, 2), ""),
        ("square", {"moving": (2.0, 9.0)}, (1, 2), "0.67 to 3 times that of the machine without carriers"),
        ("square", {}, (2, 2), "2 of the plans break a limit"),
        ("square", {"status": "not_converged"}, (2, 2), "0 of the plans break a limit"),
        ("shared", {}, (4, 4), f"it is {5.1 / 0.4:.2g} times the energy"),  # both sets of actuators count
        ("shared", {"moving": (2.9, 3.5)}, (2, 4), "0.72 to 0.88 times the energy they need"),
        ("shared", {"moving": (2.9, 1.0), "energy": 0.2}, (2, 4), "in 2 of 4 plans"),
        ("agreement", {}, (0, 2), "(+) reproduce 1 of the 2 statements"),
        ("agreement", {"holds": (True, False)}, (0, 2), "(+, −) reproduce 1 of the 2 statements"),
        ("agreement", {"holds": (False, True)}, (1, 2), "(+) reproduce 2 of the 2 statements"),
        ("agreement", {"holds": (True, True)}, (2, 2), "(+, −) reproduce 2 of the 2"),
    ],
)  # fmt: skip
def test_conclusions_follow_the_numbers(name: str, changes: dict[str, Any], good: tuple[int, int], shown: str) -> None:
    record = conclusions(**changes)[name]
    assert (record["good"], record["total"]) == good
    stands = "does not stand" if not good[0] else "stands" if good[0] == good[1] else "stands with conditions"
    assert record["stands"] == stands
    assert shown in record["here"]


def test_some_of_the_cases_show_that_a_claim_stands_with_conditions_and_nothing_else() -> None:
    for moving, holds, stands in (
        ((1.0, 1.0), (False, False), NOT_JUDGED),
        ((9.0, 9.0), (True, True), NOT_JUDGED),
        ((1.0, 9.0), (False, True), "stands with conditions"),
    ):
        quick = conclusions(moving, holds=holds, complete=False)
        assert {quick[name]["stands"] for name in ("wide_corner", "sharp_corner", "square", "shared", "agreement")} == {
            stands
        }
        assert (quick["crossing"]["stands"], quick["exit_forces"]["stands"]) == ("does not stand",) * 2  # all cases
    sampled = {claim.name for claim in FINDINGS if claim.sampled}
    assert sampled == {"speed", "corner_wide", "corner_sharp", "backends", "first_guesses"}


# --- findings beyond the thesis ------------------------------------------------------------------------------------


def record(task: str, method: str, peak: float, **changes: Any) -> dict[str, Any]:
    status = changes.get("status", "ok")
    exists = status != INFEASIBLE
    return {"task": task, "way": method, "unit": "N", "status": status, "exists": exists,
            "sound": status == "ok", "peak": peak, "dense_peak": peak, "worst": peak, "reversals": 2.0,
            "energy": peak / 10.0 + 1.0, "before": math.nan, "missing": math.nan if exists else 0.25,
            **changes}  # fmt: skip


def changed(method: str, task: str = "", **values: Any) -> Change:
    """Return a change of the records of a method, and of one task unless all are meant."""
    return lambda r: {**r, **values} if r["way"] == method and task in r["task"] else r


def mode(radius: float, ratio: float = 0.6, **peaks: float) -> dict[str, Any]:
    """Return a corner in a working mode; the plan of least peak is the lowest unless peaks say otherwise."""
    shown = {STEPWISE: 2.5, EFFORT: 2.5, PEAK: 1.7, PEAK_FREE: 1.5} | {name: peaks[name] for name in peaks}
    rows = {method: record("c", method, shown.get(method, 3.0)) for method in MODE_METHODS}
    return {"radius": radius, "ratio": ratio, "lower": ratio < 1.0, "rows": rows}


UNPLANNED = mode(0.025)
UNPLANNED["rows"][STEPWISE] = record("c", STEPWISE, math.nan, status=INFEASIBLE)
CIRCLE = {"task": "circle-0.5", "fastest_with_plan": {"speed": 1.7}}
SAME = {"case": "c", "worst": 1e-12, "cost": 1e-12, "same": True}
GUESSES = {"case": "c", "costs": [1.0, 1.0], "parked_is_best": True}


def findings(change: Change = lambda r: r, **parts: Any) -> dict[str, dict[str, Any]]:
    rows = []
    for task in SINGULAR:
        off = {"status": INFEASIBLE} if task.name == "heavy-0.5" else {"status": "limit_violated", "before": 2.8}
        rows += [record(task.name, SWITCH_OFF, 28.0, **off), record(task.name, SWITCH_OFF_LATE, 23.0)]
        rows += [record(task.name, EFFORT, 0.28), record(task.name, PEAK, 0.14), record(task.name, SMOOTH, 0.35)]
    for task in TURNS:
        rows += [record(task.name, NONE, 3.0, energy=0.3), record(task.name, STEPWISE, 7.0)]
        rows += [record(task.name, EFFORT, 2.5), record(task.name, PEAK, 1.7)]
    rows.append(record(TURNS[0].name, ENERGY, 13.5, energy=0.84))
    modes = [mode(radius) for radius in (0.025, 0.013)]
    given = {"plans": [change(row) for row in rows], "fastest": [CIRCLE], "working_modes": modes, "backends": [SAME],
             "first_guesses": [GUESSES], **parts}  # fmt: skip
    return by_name(FINDINGS, given)


ALIKE: Change = lambda r: r  # noqa: E731
WORSE = {"status": "not_converged", "sound": False}
OPTIMISED = 3 * len(SINGULAR) + 2 * len(TURNS) + 1


@pytest.mark.parametrize(
    ("name", "change", "good", "shown"),
    [
        ("singular", ALIKE, (6, 6), "Switching off keeps the limits on none, and has no plan for heavy-0.5."),
        ("singular", changed(EFFORT, "circle-0.5", **WORSE), (5, 6), "5 of 6 motions"),
        ("singular", changed(SWITCH_OFF, "line-0.1", status="ok", sound=True), (6, 6), "limits on line-0.1, and"),
        ("singular", changed(SWITCH_OFF, "line-0.1", status="ok", sound=True), (6, 6),
         "Only beyond a condition number of 20 it keeps them on circle-0.5, circle-0.75, heavy-0.5, line-0.2, five"),
        ("singular", changed(SWITCH_OFF_LATE, "line", **WORSE), (6, 6), "circle-0.75, heavy-0.5, five-bar-0.3 too."),
        ("singular", changed(EFFORT, "heavy", worst=0.56), (6, 6), "has 0.01 times the largest main force of"),
        ("singular", changed(EFFORT, "circle-0.5", worst=0.56), (6, 6), "has 0.01 to 0.02 times the largest main"),
        ("singular", changed(EFFORT, "circle-0.5", worst=0.56), (6, 6), "and 0.1 to 0.2 times the largest before"),
        ("heavy", ALIKE, (1, 1), "heavy-0.5 (0.25 N)"),
        ("heavy", changed(PEAK, "heavy", **WORSE), (0, 1), "0 have plans"),
        ("corner_square", ALIKE, (1, 1), "lower in 1 of 1 working modes (0.57 times)"),
        ("corner_square", changed(PEAK, "square", worst=4.0), (0, 1), "1.3 times"),
        ("corner_square", changed(PEAK, "square", worst=3.0), (0, 1), "(1 times)"),
        ("corner_square", changed(PEAK, "square", **WORSE), (0, 1), "has a lower one than the whole trajectory in 0."),
        ("corner_square", changed(STEPWISE, "square", worst=1.0), (1, 1), "than the whole trajectory in 1."),
        ("cost", ALIKE, (0, 7), "2.8 to 4.2 times as much"),
        ("cost", ALIKE, (0, 7), "for least energy it is 2.8 times, at 4.5 times the peak torque."),
        ("cost", changed(NONE, energy=9.0), (7, 7), "7 of 7 plans need less"),
        ("between", ALIKE, (OPTIMISED, OPTIMISED), "at worst 1.000 times"),
        ("between", changed(PEAK, "square", dense_peak=1.051 * 1.7), (OPTIMISED - 1, OPTIMISED),
         "(square (whole trajectory: peak))"),
        ("calm", changed(SMOOTH, "line-0.1", reversals=6.0), (OPTIMISED, OPTIMISED),
         "With a weight of 0.01 on the rate of the efforts they reverse at most 6 times on the crossings, with 1.2"),
        ("calm", changed(SMOOTH, "heavy", worst=0.56), (OPTIMISED, OPTIMISED), "with 1.2 to 2 times the peak of"),
        ("calm", changed(EFFORT, reversals=10.0), (OPTIMISED, OPTIMISED), "reverses 10 times"),
        ("calm", changed(EFFORT, "line-0.1", reversals=11.0), (OPTIMISED - 1, OPTIMISED),
         "(line-0.1 (whole trajectory: effort))"),
    ],
)  # fmt: skip
def test_findings_follow_the_plans(name: str, change: Change, good: tuple[int, int], shown: str) -> None:
    entry = findings(change)[name]
    assert (entry["good"], entry["total"]) == good
    assert shown in entry["here"]


@pytest.mark.parametrize(
    ("name", "parts", "good", "shown"),
    [
        ("speed", {}, (1, 1), "1.700 m/s"),
        ("speed", {"fastest": [{**CIRCLE, "fastest_with_plan": {"speed": THESIS_SPEED}}]}, (0, 1), "0.750 m/s"),
        ("backends", {"backends": [SAME, {**SAME, "worst": 1e-3, "same": False}]}, (1, 2), "costs do not (c)"),
        ("backends", {"backends": [{**SAME, "worst": 1e-3, "cost": 1e-3, "same": False}]}, (0, 1), "is 0.001 (c)."),
        ("first_guesses", {"first_guesses": [GUESSES, GUESSES, {**GUESSES, "parked_is_best": False}]}, (2, 3), "of 3"),
        # of the corners every working mode counts, and not the first one alone
        ("corner_wide", {"working_modes": [mode(0.025), mode(0.025, 1.3), mode(0.013, 1.4)]}, (1, 2), "(0.6 to 1.3"),
        ("corner_sharp", {"working_modes": [mode(0.025), mode(0.013, 1.3)]}, (0, 1), "(1.3 times)"),
        ("corner_wide", {"working_modes": [mode(0.025, **{STEPWISE: 1.6})]}, (1, 1),
         "than the whole trajectory in 1. With the end free, as stepwise planning leaves it, it has one in 0."),
        ("corner_wide", {"working_modes": [mode(0.025, **{STEPWISE: 1.4})]}, (1, 1), "it has one in 1."),
        ("corner_wide", {"working_modes": [UNPLANNED]}, (1, 1), "than the whole trajectory in 0."),
    ],
)  # fmt: skip
def test_findings_follow_the_other_tables(name: str, parts: Any, good: tuple[int, int], shown: str) -> None:
    entry = findings(**parts)[name]
    assert (entry["good"], entry["total"]) == good
    assert shown in entry["here"]


def test_what_was_not_run_is_not_judged() -> None:
    """A quick run has no race on the circle; small extents have no second backend and no further first guesses."""
    line = {**CIRCLE, "task": "line-0.2"}
    none = findings(lambda r: {**r, "exists": False}, fastest=[line], backends=[], first_guesses=[])
    for name in ("speed", "cost", "between", "calm", "backends", "first_guesses"):
        assert none[name]["stands"] == NOT_JUDGED


def test_targets_are_met_by_sound_plans_that_hold_between_nodes() -> None:
    rows = [record(task, method, 0.99 * aim) for task, method, aim in TARGETS]
    assert [entry["met"] for entry in targets(rows)] == [True] * 4
    for worse in ({"peak": 0.22}, {"dense_peak": 0.3}, WORSE, {"status": INFEASIBLE, "sound": False, "peak": math.nan}):
        assert [entry["met"] for entry in targets([{**rows[0], **worse}, *rows[1:]])] == [False, True, True, True]
