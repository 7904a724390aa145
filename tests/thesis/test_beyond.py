"""The chapter beyond the thesis on a small scale: its numbers against the saved plans and the other backend."""

from __future__ import annotations

import csv
import functools
import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin
import pytest
import quick_results

from redundancy_pin import CarrierMotion, Plan, distribute, inverse_kinematics, load_plan
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis.beyond import (
    SAME_COST,
    attempt,
    backend_record,
    fastest,
    future_record,
    plan_record,
    rises,
    run_future,
    starts_record,
    trade_record,
)
from redundancy_pin.thesis.cases import (
    EFFORT,
    FULL,
    FUTURE,
    PEAK,
    QUICK,
    SINGULAR,
    SWITCH_OFF,
    SWITCH_OFF_LATE,
    TASKS,
    TRADED,
    TURNS,
    Case,
    Plans,
    at_speed,
    by_method,
)
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


TRADE = replace(QUICK, ratios=(1e-2, 1.0, 100.0))


@pytest.mark.parametrize("task", [TRADED[0], pytest.param(TRADED[1], marks=pytest.mark.long)])
def test_trade_off_is_ordered_and_each_plan_is_the_best_by_its_own_weight(task: Case) -> None:
    record = trade_record(task, TRADE)
    assert record["monotone"]
    points = record["points"]
    assert [point["ratio"] for point in points] == [0.0, *TRADE.ratios]
    assert points[0]["rms_effort"] < points[-1]["rms_effort"]
    assert points[0]["rms_acceleration"] > points[-1]["rms_acceleration"]
    # weighted by the ratio 1, both parts of the cost are the same for the plan of least effort
    effort, acceleration = points[0]["rms_effort"], points[0]["rms_acceleration"]
    assert points[2]["weight"] * acceleration**2 == pytest.approx(effort**2, rel=1e-2)
    for point in points:
        costs = [one["rms_effort"] ** 2 + point["weight"] * one["rms_acceleration"] ** 2 for one in points]
        own = costs[points.index(point)]
        assert own <= min(costs) * (1.0 + 1e-6)


def test_what_rises() -> None:
    assert rises([1.0, 1.0 - 1e-9, 2.0])
    assert rises([-2.0, -1.0, -1.0 - 1e-9])
    assert not rises([1.0, 0.9, 2.0])


# --- how fast: the bracket holds the border ---------------------------------------------------------------------------

CIRCLE, LINE = SINGULAR[0], SINGULAR[4]
EXTENT = replace(QUICK, tolerance=0.01, starts=3)


@functools.cache
def line_plan() -> Plan:
    return by_method(LINE, EFFORT, 8.0).plan()


def speed(case: Case) -> float:
    return float(case.option("speed"))


class Border(Plans):
    """A memo in which a motion has a plan as a rule says."""

    def __init__(self, rule: Callable[[Case], bool], given: Plan | None = None) -> None:
        super().__init__()
        self._rule, self._given = rule, given
        self.wanted: list[Case] = []

    def outcome(self, case: Case, backend: str | None = None) -> Any:
        self.wanted.append(case)
        if self._rule(case):
            return self._given or line_plan()
        return InfeasiblePlanError("none", constraint="acceleration", joint="carrier_1", limit=-10.1, fraction=0.01)


def ends(record: dict[str, Any]) -> tuple[float, float]:
    return float(record["fastest_with_plan"]["speed"]), float(record["slowest_without"]["speed"])


@pytest.mark.parametrize("border", [0.52, 0.7, 1.234, 3.0])
def test_bracket_holds_the_border(border: float) -> None:
    plans = Border(lambda case: speed(case) <= border)
    record = fastest(plans, CIRCLE, EXTENT)
    slower, faster = ends(record)
    assert slower <= border < faster
    assert faster - slower <= 0.01 * slower * (1.0 + 1e-9)
    assert [trial["speed"] for trial in record["trials"]] == sorted({speed(case) for case in plans.wanted})
    assert all(trial["feasible"] == (trial["speed"] <= border) for trial in record["trials"])
    # at the upper end every first guess is tried, with both objectives
    last = [case for case in plans.wanted if speed(case) == faster and case.option("starts") == EXTENT.starts]
    assert {case.option("objective")[0][0] for case in last} == {"effort", "carrier_acceleration"}


def test_a_plan_from_another_guess_moves_the_border() -> None:
    """From parked carriers plans exist up to 1 m/s, from other guesses up to 1.05 m/s."""
    record = fastest(Border(lambda case: speed(case) <= (1.05 if case.option("starts") else 1.0)), CIRCLE, EXTENT)
    assert ends(record) > (1.0, 1.05)
    assert ends(record)[1] > 1.05


@pytest.mark.parametrize("enough", [True, False])
def test_whether_the_wider_limit_suffices(enough: bool) -> None:
    plans = Border(lambda case: speed(case) <= 0.6 or (enough and case.option("acceleration") is not None))
    record = fastest(plans, CIRCLE, EXTENT)
    assert record["suffices"] is enough
    wider = [case for case in plans.wanted if case.option("acceleration")]
    assert [case.option("acceleration") for case in wider] == [pytest.approx(1.01 * 10.1)]
    assert speed(wider[0]) == record["slowest_without"]["speed"]


def test_an_unsound_plan_is_none() -> None:
    broken = replace(line_plan(), status=ResultStatus.LIMIT_VIOLATED)
    trial = attempt(Border(lambda case: True, given=broken), by_method(CIRCLE, EFFORT))
    assert not trial["feasible"]
    assert trial["status"] == "limit_violated"


@pytest.mark.long
def test_the_real_border_of_the_circle() -> None:
    record = fastest(Plans(), at_speed(CIRCLE, 1.4), replace(QUICK, tolerance=0.2, starts=1))
    assert record["slowest_without"]["constraint"] == "acceleration"
    # the limit that would suffice grows with the speed beyond the border
    fractions = [trial["fraction"] for trial in record["trials"] if not trial["feasible"]]
    assert fractions[0] > 0.0
    assert np.all(np.diff(fractions) > 0.0)


# --- future work, against figures known before and Pinocchio's momentum ----------------------------------------------

TASK = "3-RRR corner, balanced"

REPLAYED = 1e-5
"""m, without control. At twice the steps of the report, as here, the delta is off by 1e-6, all others by less."""


def test_a_balanced_corner_keeps_its_momentum() -> None:
    case = replace(FUTURE[TASK, "least base wrench, free end"], dt=0.05)
    plan = case.plan()
    record = future_record(TASK, "", case)
    assert record["base_force"] < 1e-3
    assert record["added"] == 9.0
    robot = case.load_robot()
    tree = inverse_kinematics(robot, plan.motion).with_carriers(plan.carriers)
    data = robot.model.createData()
    momenta = []
    for q, v in zip(tree.q, tree.v, strict=True):
        pin.computeCentroidalMomentum(robot.model, data, q, v)
        momenta.append(data.hg.linear[:2].copy())
    alone = case.with_options(objective="effort").plan()
    # between the nodes the balance is of second order in the step
    drift = np.abs(np.array(momenta) - momenta[0]).max()
    assert drift < 0.02 * np.abs(alone.base_wrench(case.dynamics())[:, :2]).max() * plan.t[-1]


def test_carriers_elsewhere_are_planned_and_replayed_by_a_backend_that_knows_them() -> None:
    circles = [case for (task, _), case in FUTURE.items() if task.startswith("2-RPR circle")]
    assert [case.backends for case in circles] == [("virtual-work", "rnea"), ("rnea",), ("rnea",)]
    case = replace(circles[1], dt=0.05)
    record = future_record("", "", case)
    assert record["added"] == 2.0
    assert record["replay"] < 1e-8


@pytest.mark.long
def test_the_chapter_has_the_known_figures() -> None:
    records = run_future(Plans(), replace(QUICK, future=FULL.future))["plans"]
    assert len(records) == len(FUTURE)
    by = {(record["task"], record["way"]): record for record in records}
    assert {record["status"] for record in records} <= {"ok", "unresolved"}
    bare = by[TASK, "no carriers"]
    assert (bare["base_force"], bare["base_moment"]) == pytest.approx((7.05, 0.705), rel=5e-3)
    free = by[TASK, "least base wrench, free end"]
    assert max(free["base_force"], free["base_moment"]) < 1e-3
    parked = by[TASK, "least base wrench, parked at the end"]
    assert parked["base_force"] < 0.6 * bare["base_force"]
    times = [record["duration"] for record in records if record["task"].endswith("least time")]
    assert times == pytest.approx([1.070, 0.655, 0.500], rel=5e-3)
    assert all(record["replay"] < REPLAYED for record in records)
    circle = {method: record for (task, method), record in by.items() if task.startswith("2-RPR circle")}
    assert [len(record["singular_instants"]) for record in circle.values()] == [2, 2, 2]
    legs, end_effector, _ = (record["peak"] for record in circle.values())
    assert legs < end_effector
    slow, fast = bare["peak"], by["3-RRR corner at twice the feed", "machine of co-design, least peak"]
    assert fast["peak"] < slow == pytest.approx(3.03, rel=2e-3)
    assert fast["duration"] < 0.7 * bare["duration"]
    front = [(record["energy"], record["peak"]) for record in records if "front" in record["task"]]
    assert [energy for energy, _ in front] == pytest.approx([2.0, 3.0, 4.0], rel=1e-3)
    assert [peak for _, peak in front] == sorted((peak for _, peak in front), reverse=True)
    spatial = [record for record in records if record["task"].startswith(("Gough", "delta"))]
    assert [len(record["singular_instants"]) for record in spatial] == [1, 1]
    # beyond the load at rest: shaken by less than the weights of the machines with their carriers
    assert [record["base_force"] < mass * 9.81 for record, mass in zip(spatial, (30.8, 3.45), strict=True)] == [
        True
    ] * 2
