"""The chapter on what the thesis leaves open, against figures known before and Pinocchio's momentum."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from redundancy_pin import inverse_kinematics
from redundancy_pin.thesis import future
from redundancy_pin.thesis.case import Plans
from redundancy_pin.thesis.cases import QUICK

pytest.importorskip("casadi")

TASK = "3-RRR corner, balanced"

REPLAYED = 1e-5
"""m, without control. At twice the steps of the report, as here, the delta is off by 1e-6, all others by less."""


def test_a_balanced_corner_keeps_its_momentum() -> None:
    case = replace(future.PLANNED[TASK, "least base wrench, free end"], dt=0.05)
    plan = case.plan()
    record = future.task_record(TASK, "", case, plan)
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
    cases = [case for (task, _), case in future.PLANNED.items() if task.startswith("2-RPR circle")]
    assert [case.backends for case in cases] == [("virtual-work", "rnea"), ("rnea",), ("rnea",)]
    case = replace(cases[1], dt=0.05)
    record = future.task_record("", "", case, case.plan())
    assert record["added"] == 2.0
    assert record["replay"] < 1e-8


@pytest.mark.long
def test_the_chapter_has_the_known_figures() -> None:
    records = future.run_future(Plans(), QUICK)["plans"]
    assert len(records) == len(future.PLANNED)
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
