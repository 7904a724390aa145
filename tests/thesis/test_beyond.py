"""The chapter beyond the thesis on a small scale: its numbers against the saved plans and the other backend."""

from __future__ import annotations

import csv
import functools
import json
import math
from typing import Any, ClassVar

import numpy as np
import pytest
import quick_results

from redundancy_pin import CarrierMotion, Plan, distribute, load_plan
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.thesis import beyond
from redundancy_pin.thesis.beyond import (
    INFEASIBLE,
    SAME_COST,
    backend_record,
    plan_record,
    rises,
    starts_record,
    targets,
)
from redundancy_pin.thesis.case import Case, Plans
from redundancy_pin.thesis.cases import (
    EFFORT,
    NONE,
    PARKED,
    PEAK,
    PEAK_FREE,
    SINGULAR,
    SMOOTH,
    STEPWISE,
    SWITCH_OFF,
    SWITCH_OFF_LATE,
    TASKS,
    TURNS,
    by_method,
)
from redundancy_pin.thesis.claims import CALM, FINDINGS, NOT_JUDGED, verdicts
from redundancy_pin.thesis.table import Record

chapter = functools.partial(quick_results.chapter, "beyond")
FOLDER = functools.cache(lambda: quick_results.reproduction("beyond").folder)

ROUNDING = 1e-9
"""The same sums in another order."""

OTHER_BACKEND = 1e-7
"""Efforts by the other backend over the largest, where W is no worse conditioned than ``CONDITION``: 1e-12 of it."""

CONDITION = 1e4

BETWEEN = 0.02
"""Peaks on two grids, 20 points a step each but not the same ones; 5 ms to 80 ms a step here."""


def saved() -> list[tuple[Case, Record, Plan]]:
    """Every record that has a file, with the plan read back from it."""
    by_name = {task.name: task for task in TASKS}
    records = [record for record in chapter()["plans"] if record["file"]]
    return [(by_name[record["task"]], record, load_plan(FOLDER() / f"{record['file']}.npz")) for record in records]


COARSER = 4.0
"""As in the whole chapter on a small scale."""

plans_of = functools.cache(Plans)


@functools.cache
def few() -> list[tuple[Case, Record, Plan]]:
    """A crossing, a descent and a corner, without the rest of the chapter."""
    chosen = ((SINGULAR[2], EFFORT), (SINGULAR[5], EFFORT), (TURNS[0], PEAK))
    return [
        (task, plan_record(plans_of(), task, method, COARSER), plans_of().plan(by_method(task, method, COARSER)))
        for task, method in chosen
    ]


@pytest.fixture(params=[few, pytest.param(saved, marks=pytest.mark.long)], ids=["few", "all"])
def planned(request: pytest.FixtureRequest) -> list[tuple[Case, Record, Plan]]:
    return request.param()


def inside(plan: Plan, parts: int) -> tuple[np.ndarray[Any, Any], CarrierMotion]:
    """Times inside the steps and the carriers there, s̈ linear in a step, by Taylor series from its start."""
    t, c = plan.t, plan.carriers
    left = np.flatnonzero(np.diff(t) > 0.0)
    h = np.diff(t)[left]
    fraction = (np.arange(parts) + 0.5) / parts
    x = (fraction[None] * h[:, None])[..., None]
    jerk = ((c.sdd[left + 1] - c.sdd[left]) / h[:, None])[:, None]
    s, sd, sdd = (part[left][:, None] for part in (c.s, c.sd, c.sdd))
    k = c.s.shape[1]
    motion = CarrierMotion(
        (s + sd * x + sdd * x**2 / 2 + jerk * x**3 / 6).reshape(-1, k),
        (sd + sdd * x + jerk * x**2 / 2).reshape(-1, k),
        (sdd + jerk * x).reshape(-1, k),
    )
    return (t[left, None] + fraction[None] * h[:, None]).ravel(), motion


def test_numbers_are_those_of_the_plans(planned: list[tuple[Case, Record, Plan]]) -> None:
    for _, record, plan in planned:
        tau = np.abs(plan.tau)
        assert record["status"] == plan.status.value
        assert record["peak"] == pytest.approx(tau.max(), rel=ROUNDING)
        duration = plan.t[-1] - plan.t[0]
        assert record["rms"] == pytest.approx(
            np.sqrt(np.trapezoid((tau**2).sum(axis=1), plan.t) / duration), rel=ROUNDING
        )
        assert record["carrier_force"] == pytest.approx(np.abs(plan.carrier_force).max(), rel=ROUNDING)
        for name, part in (("position", "s"), ("speed", "sd"), ("acceleration", "sdd")):
            assert record[name] == pytest.approx(np.abs(getattr(plan.carriers, part)).max(), rel=ROUNDING)


def test_efforts_and_energies_follow_from_the_motion_by_the_other_backend(
    planned: list[tuple[Case, Record, Plan]],
) -> None:
    for task, record, plan in planned:
        reduced = task.dynamics(task.backends[-1]).reduce(
            task.trajectory().sample_at(plan.t), plan.carriers, check_track=False
        )
        # W τ = f at every sample, singular ones and those with the motors off included
        imbalance = np.abs(np.einsum("nij,nj->ni", reduced.W, plan.tau) - reduced.f)
        smooth = np.append(True, np.diff(plan.t) > 0.0) & np.append(np.diff(plan.t) > 0.0, True)  # jumps have two sides
        assert imbalance[smooth].max() <= 1e-6 * np.abs(reduced.f).max(), record["file"]
        good = smooth & (plan.condition < CONDITION) & (plan.phase == 0)
        assert good.sum() > 0.2 * len(plan.t)
        tau = distribute(reduced).tau
        np.testing.assert_allclose(
            tau[good], plan.tau[good], atol=OTHER_BACKEND * record["peak"], err_msg=record["file"]
        )
        rate = np.einsum("nij,ni->nj", reduced.W, plan.motion.xd)
        main = np.trapezoid(np.abs(plan.tau * rate).sum(axis=1), plan.t)
        assert record["main_energy"] == pytest.approx(main, rel=1e-6)
        own = np.trapezoid(np.abs(plan.carrier_force * plan.carriers.sd).sum(axis=1), plan.t)
        assert record["carrier_energy"] == pytest.approx(own, rel=1e-6)


def test_peaks_between_the_nodes_and_limits_by_the_other_backend(planned: list[tuple[Case, Record, Plan]]) -> None:
    checked = 0
    for task, record, plan in planned:
        if record["way"] in (SWITCH_OFF, SWITCH_OFF_LATE):
            continue
        times, motion = inside(plan, 20)
        tau = distribute(task.dynamics(task.backends[-1]).reduce(task.trajectory().sample_at(times), motion)).tau
        assert np.abs(tau).max() == pytest.approx(record["dense_peak"], rel=BETWEEN), record["file"]
        if record["sound"]:
            limits = {"track": motion.s, "speed_limit": motion.sd, "acceleration_limit": motion.sdd}
            for name, values in limits.items():
                assert np.abs(values).max() <= record[name] * (1.0 + ROUNDING), record["file"]
            checked += 1
    assert checked >= len({task.name for task, _, _ in planned})


@pytest.mark.long
def test_files_agree_with_each_other() -> None:
    text = (FOLDER() / "report.md").read_text()
    with (FOLDER() / "beyond.csv").open(newline="") as stream:
        table = list(csv.DictReader(stream))
    records = json.loads((FOLDER() / "summary.json").read_text())["beyond"]["plans"]
    for line, record in zip(table, records, strict=True):
        assert (line["task"], line["way"], line["status"]) == (record["task"], record["way"], record["status"])
        assert line["peak"] == ("nan" if record["peak"] is None else repr(record["peak"]))
        name = f"[{record['way']}]({record['file']}.npz)" if record["file"] else record["way"]
        assert f"| {record['task']} | {name} | {record['status']} |" in text


def test_the_force_that_is_missing_by_hand() -> None:
    """Mass of the end-effector times its acceleration along the force; the legs' own masses have no part in it."""
    heavy = plan_record(plans_of(), SINGULAR[2], SWITCH_OFF, COARSER)
    whole = plans_of().plan(by_method(SINGULAR[2], EFFORT, COARSER))
    instant = whole.findings.singular_instants[0]  # type: ignore[index]
    acceleration = SINGULAR[2].trajectory().sample_at(np.array([instant])).xdd[0, 0]
    assert heavy["missing"] == pytest.approx(0.5 * abs(acceleration), rel=1e-9)
    assert f"t = {instant:.6g} s" in heavy["why"]


class Given(Plans):
    """A memo that has what it is given, by backend."""

    def __init__(self, **outcomes: Plan | InfeasiblePlanError) -> None:
        super().__init__()
        self._outcomes = outcomes

    def outcome(self, case: Case, backend: str | None = None) -> Plan | InfeasiblePlanError:
        return self._outcomes[(backend or case.backends[0]).replace("-", "_")]


def test_backends_are_compared_in_motion_effort_and_status() -> None:
    case = by_method(SINGULAR[4], EFFORT, 8.0)
    plan = case.plan()
    assert backend_record(Given(virtual_work=plan, rnea=plan), case)["same"]
    none = InfeasiblePlanError("no")
    one = backend_record(Given(virtual_work=plan, rnea=none), case)
    assert not one["same"]
    assert one["worst"] == math.inf
    assert backend_record(Given(virtual_work=none, rnea=none), case)["same"]


def test_optima_are_counted() -> None:
    case = by_method(SINGULAR[0], EFFORT).with_options(starts=3)

    class Solved:
        diagnostics: ClassVar = {"starts": {"costs": [1.1, 1.0, math.nan, 1.0 + 0.5 * SAME_COST]}}

    record = starts_record(Given(virtual_work=Solved()), case)  # type: ignore[arg-type]
    assert (record["optima"], record["missing"], record["parked_is_best"]) == (2, 1, False)
    assert record["excess"] == pytest.approx(0.1)
    assert starts_record(Given(virtual_work=InfeasiblePlanError("no")), case)["missing"] == 3


@pytest.mark.long
def test_trade_off_is_ordered() -> None:
    record = chapter()["trade_off"][1]
    assert record["task"] == TURNS[0].name
    assert record["monotone"]
    first, last = record["points"][0], record["points"][-1]
    assert first["rms_effort"] < last["rms_effort"]
    assert first["rms_acceleration"] > last["rms_acceleration"]
    assert rises([1.0, 1.0 - 1e-9, 2.0])
    assert not rises([1.0, 0.9, 2.0])


# --- verdicts follow the numbers -----------------------------------------------------------------------------------


def record(task: str, method: str, peak: float, **changes: Any) -> dict[str, Any]:
    status = changes.get("status", "ok")
    exists = status != INFEASIBLE
    return {"task": task, "way": method, "unit": "N", "status": status, "exists": exists,
            "sound": status == "ok", "peak": peak, "dense_peak": peak, "worst": peak, "reversals": 2.0,
            "rms": peak / 2.0, "carrier_force": 9.0, "main_energy": peak / 10.0, "energy": peak / 10.0 + 1.0,
            "before": math.nan, "missing": math.nan if exists else 0.25, **changes}  # fmt: skip


def changed(method: str, task: str = "", **values: Any) -> Any:
    """Return a change of the records of a method, and of one task unless all are meant."""
    return lambda r: {**r, **values} if r["way"] == method and task in r["task"] else r


def made(change: Any = lambda r: r, **parts: Any) -> dict[str, dict[str, Any]]:
    rows = []
    for task in SINGULAR:
        off = {"status": INFEASIBLE} if task.name == "heavy-0.5" else {"status": "limit_violated", "before": 2.8}
        rows += [record(task.name, SWITCH_OFF, 28.0, **off), record(task.name, SWITCH_OFF_LATE, 23.0)]
        rows += [record(task.name, EFFORT, 0.28), record(task.name, PEAK, 0.14), record(task.name, SMOOTH, 0.35)]
    for task in TURNS:
        rows += [
            record(task.name, NONE, 3.0, energy=0.3),
            record(task.name, PARKED, 12.0),
            record(task.name, STEPWISE, 7.0),
        ]
        rows += [record(task.name, EFFORT, 2.5), record(task.name, PEAK, 1.7)]
    same = dict.fromkeys(("position", "speed", "acceleration", "tau", "carrier_force", "cost", "worst"), 1e-12)
    modes = [
        {"radius": radius, "ratio": 0.6, "lower": True,
         "rows": {m: record("c", m, p) for m, p in ((STEPWISE, 1.0), (PEAK, 1.7), (PEAK_FREE, 0.5))}}
        for radius in (0.025, 0.013)
    ]  # fmt: skip
    race = {"task": "circle-0.5", "title": "circle", "unit": "N", "effort_limit": math.inf,
            "fastest_with_plan": {"speed": 1.7, "peak": 74.0}, "slowest_without": None}  # fmt: skip
    given = {
        "plans": [change(row) for row in rows],
        "fastest": [race],
        "working_modes": modes,
        "backends": [{**same, "case": "c", "statuses": ["a", "a"], "same": True}],
        "first_guesses": [{"case": "c", "costs": [1.0], "parked_is_best": True, "optima": 1, "excess": 0.0}],
        **parts,
    }
    return {entry["name"]: entry for entry in verdicts(FINDINGS, given)}


SLOW = {"task": "circle-0.5", "title": "circle", "unit": "N", "effort_limit": math.inf,
        "fastest_with_plan": {"speed": 0.7, "peak": 74.0}, "slowest_without": None}  # fmt: skip
WORSE = {"status": "not_converged", "sound": False}


@pytest.mark.parametrize(
    ("name", "change", "stands"),
    [
        ("singular", lambda r: r, "stands"),
        ("singular", changed(EFFORT, "circle-0.5", **WORSE), "stands with conditions"),
        ("heavy", lambda r: r, "stands"),
        ("heavy", changed(PEAK, "heavy", **WORSE), "does not stand"),
        ("corner_wide", lambda r: r, "stands"),
        ("corner_square", changed(PEAK, "square", worst=4.0), "does not stand"),
        ("corner_square", changed(PEAK, "square", **WORSE), "does not stand"),
        ("cost", lambda r: r, "does not stand"),
        ("cost", changed(NONE, energy=9.0), "stands"),
        ("between", lambda r: r, "stands"),
        ("between", changed(PEAK, dense_peak=2.5), "stands with conditions"),
        ("calm", lambda r: r, "stands"),
        ("calm", changed(EFFORT, "circle-0.5", reversals=CALM + 60.0), "stands with conditions"),
        ("speed", lambda r: r, "stands"),
        ("backends", lambda r: r, "stands"),
        ("first_guesses", lambda r: r, "stands"),
    ],
)
def test_findings_follow_the_plans(name: str, change: Any, stands: str) -> None:
    entry = made(change)[name]
    assert entry["stands"] == stands
    assert "{" not in entry["here"] + entry["claim"]


def test_findings_follow_the_other_tables() -> None:
    assert made(fastest=[SLOW])["speed"]["stands"] == "does not stand"
    assert made(fastest=[{**SLOW, "effort_limit": 2.8}])["speed"]["stands"] == NOT_JUDGED  # a capped race is another
    flat = {"case": "c", "worst": 1e-3, "cost": 1e-9, "same": False}
    assert made(backends=[flat])["backends"]["stands"] == "does not stand"
    assert "costs do not (c)" in made(backends=[flat])["backends"]["here"]
    better = {"case": "c", "costs": [1.1, 1.0], "parked_is_best": False, "optima": 2, "excess": 0.1}
    assert made(first_guesses=[better])["first_guesses"]["stands"] == "does not stand"
    lost = [
        {
            "radius": 0.025,
            "ratio": 1.3,
            "lower": False,
            "rows": {m: record("c", m, 1.0) for m in (STEPWISE, PEAK, PEAK_FREE)},
        }
    ]
    assert made(working_modes=lost)["corner_wide"]["stands"] == "does not stand"


def test_what_was_not_run_is_not_judged() -> None:
    """A quick run has no race on the circle; small extents have no second backend and no further first guesses."""
    line = {**SLOW, "task": "line-0.2"}
    none = made(lambda r: {**r, "exists": False}, fastest=[line], backends=[], first_guesses=[])
    for name in ("speed", "cost", "between", "calm", "backends", "first_guesses"):
        assert none[name]["stands"] == NOT_JUDGED
        assert none[name]["here"]


def test_numbers_of_findings() -> None:
    entries = made()
    singular = entries["singular"]["here"]
    assert "has no plan for heavy-0.5." in singular
    assert "plan of least effort has 0.01 times the largest main force" in singular
    assert "0.1 times the largest until the motors are off" in singular
    assert "0.25 N" in entries["heavy"]["here"]
    peaks = ((STEPWISE, 1.0), (PEAK, 1.7), (PEAK_FREE, 0.5))
    mode = {"radius": 0.025, "ratio": 0.6, "lower": True, "rows": {m: record("c", m, p) for m, p in peaks}}
    two = made(working_modes=[mode, mode])["corner_wide"]["here"]
    assert "lower in 2 of 2 (0.6 times)" in two
    assert "has a lower one in 2; with the end free as well, in 0." in two
    # peaks between the nodes count where they are larger than those at the nodes
    assert "has 0.02 times the largest main force" in made(changed(EFFORT, worst=0.56))["singular"]["here"]
    none = made(changed(PEAK, "square", status=INFEASIBLE, exists=False, sound=False))["between"]["here"]
    assert none.endswith("No plan was found for square (whole trajectory: peak).")
    assert "No plan was found" not in entries["between"]["here"]
    early = made(changed(EFFORT, "circle-0.5", **WORSE))["between"]["here"]
    assert "1 plans stopped before an optimum (circle-0.5 (whole trajectory: effort))." in early


def test_targets_are_met_by_sound_plans_that_hold_between_nodes() -> None:
    rows = [record(task, method, 0.99 * aim) for task, method, aim in beyond.TARGETS]
    assert [entry["met"] for entry in targets(rows)] == [True] * 4
    for worse in ({"peak": 0.22}, {"dense_peak": 0.3}, WORSE, {"status": INFEASIBLE, "sound": False, "peak": math.nan}):
        assert [entry["met"] for entry in targets([{**rows[0], **worse}, *rows[1:]])] == [False, True, True, True]
