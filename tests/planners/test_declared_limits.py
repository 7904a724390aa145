"""Limits that a robot declares for its motors bind every planner, as those of its carriers do."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import reference

NAMES = ("base_1", "base_2", "base_3")
COARSE = rp.Mesh(dt=0.05, refinements=1)


def declaring(effort: float = np.inf, speed: float = np.inf, name: str = "3rrr") -> Robot:
    """Return a shipped robot whose motors have limits of effort, N·m or N, and of speed, rad/s or m/s."""
    robot = zoo.robot_of(name)
    return rp.with_limits(robot, {motor: {"effort": effort, "speed": speed} for motor in robot.actuated})


def planned(planner: str, robot: Robot, **options: Any) -> Plan:
    dynamics, corner = rp.VirtualWork(robot), reference.corner()
    if planner == "whole trajectory":
        return rp.plan_whole_trajectory(dynamics, corner, mesh=COARSE, **options)
    if planner == "stepwise":
        return rp.plan_stepwise(dynamics, corner, mesh=rp.Mesh(dt=0.02), **options)
    return rp.plan_switch_off(dynamics, reference.circle(), mesh=rp.Mesh(dt=0.01), **options)


def robot_name(planner: str) -> str:
    return "2rpr" if planner == "switch off" else "3rrr"


@cache
def without(planner: str) -> Plan:
    """Return a plan of the machine whose motors have no limits."""
    return planned(planner, declaring(name=robot_name(planner)))


def peaks(plan: Plan, robot: Robot) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Return (m,) the largest |τ| = |W⁻¹ f| and actuator rates at the samples, by RNEA."""
    reduced = rp.RneaDynamics(robot).along(plan.motion).reduce(plan.carriers)
    rate = np.einsum("nim,ni->nm", reduced.W, plan.motion.xd)
    driven = np.abs(plan.tau).max(axis=1) > 0.0  # switched off, at a singularity too
    tau = np.linalg.solve(reduced.W[driven], reduced.f[driven][..., None])[..., 0]
    return np.abs(tau).max(axis=0), np.abs(rate).max(axis=0)


# --- what is declared -------------------------------------------------------------------------------------------------


def test_what_a_robot_declares_is_the_default_and_what_is_given_replaces_it() -> None:
    robot = declaring(effort=5.0, speed=3.0)
    assert rp.Limits().resolved(robot).effort.tolist() == [5.0] * 3
    assert rp.Limits().resolved(robot).actuator_speed.tolist() == [3.0] * 3
    wider = rp.Limits(effort=[6.0, np.inf, 4.0], actuator_speed=np.inf).resolved(robot)
    assert wider.effort.tolist() == [6.0, np.inf, 4.0]
    assert np.isinf(wider.actuator_speed).all()


URDF = """<robot name="pendulum"><link name="base"/><link name="bar"><inertial><origin xyz="0.2 0 0"/><mass value="1"/>
<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="motor" type="revolute"><parent link="base"/><child link="bar"/><axis xyz="0 0 1"/>
<limit lower="-3" upper="3" effort="{}" velocity="{}"/></joint></robot>"""


def loaded(path: Path, text: str) -> Robot:
    path.write_text(text, encoding="utf-8")
    return rp.load_robot(path, actuated="motor")


@pytest.mark.parametrize(
    ("effort", "speed", "limits", "noted"),
    [
        ("7", "2", (7.0, 2.0), ""),
        ("0", "2", (np.inf, 2.0), "motor (effort)"),
        ("7", "0", (7.0, np.inf), "motor (speed)"),
        ("0", "0", (np.inf, np.inf), "motor (effort and speed)"),
    ],
)
def test_zeros_of_a_urdf_are_not_known_and_noted(
    tmp_path: Path, effort: str, speed: str, limits: tuple[float, float], noted: str
) -> None:
    robot = loaded(tmp_path / "pendulum.urdf", URDF.format(effort, speed))
    resolved = rp.Limits().resolved(robot)
    assert (*resolved.effort, *resolved.actuator_speed) == limits
    assert [noted in note for note in robot.notes if "not known" in note] == [True] * bool(noted)


MJCF = """<mujoco><worldbody><body><joint name="motor" type="hinge" axis="0 0 1"/>
<geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="1"/></body></worldbody>
<actuator><motor joint="motor" gear="10" ctrllimited="true" ctrlrange="{}"/></actuator></mujoco>"""


def test_ranges_of_mjcf_are_limits_where_they_are_the_same_both_ways(tmp_path: Path) -> None:
    pytest.importorskip("mujoco")
    robot = loaded(tmp_path / "even.xml", MJCF.format("-0.5 0.5"))
    assert rp.Limits().resolved(robot).effort.tolist() == [5.0]
    robot = loaded(tmp_path / "uneven.xml", MJCF.format("-0.5 2"))
    with pytest.raises(InputError, match="from -5 to 20") as caught:
        rp.Limits().resolved(robot)
    assert "effort=" in caught.value.remedy
    assert rp.Limits(effort=5.0).resolved(robot).effort.tolist() == [5.0]


# --- planners ---------------------------------------------------------------------------------------------------------


def test_a_whole_trajectory_keeps_declared_efforts() -> None:
    free, most = without("whole trajectory"), 2.0
    assert peaks(free, declaring())[0].max() > 1.2 * most
    robot = declaring(effort=most)
    plan = planned("whole trajectory", robot)
    assert plan.status is ResultStatus.OK
    assert peaks(plan, robot)[0].max() <= most * 1.001
    assert plan.least_cost > free.least_cost
    for limits in (rp.Limits(effort=np.inf), rp.Limits(effort=np.inf, actuator_speed=np.inf)):
        np.testing.assert_array_equal(planned("whole trajectory", robot, limits=limits).tau, free.tau)


def test_a_whole_trajectory_is_judged_by_declared_speeds_and_not_refined_for_them() -> None:
    free = without("whole trajectory")
    fastest = peaks(free, declaring())[1]
    robot = declaring(speed=0.8 * float(fastest.max()))
    plan = planned("whole trajectory", robot)
    assert plan.status is ResultStatus.LIMIT_VIOLATED
    assert {event.quantity for event in plan.limits.violated} == {"speed"}
    assert max(abs(event.value) for event in plan.limits.violated) >= fastest.max() * (1.0 - 1e-9)
    np.testing.assert_array_equal(plan.tau, free.tau)
    check = rp.check_plan(plan, rp.RneaDynamics(robot))
    assert check.passed
    assert check.status is ResultStatus.LIMIT_VIOLATED


@pytest.mark.parametrize("planner", ["stepwise", "switch off"])
@pytest.mark.parametrize("quantity", ["effort", "speed"])
def test_planners_that_cannot_keep_them_are_judged_by_them(planner: str, quantity: str) -> None:
    free = without(planner)
    largest = peaks(free, declaring(name=robot_name(planner)))[("effort", "speed").index(quantity)]
    most = 0.9 * float(largest.max())
    plan = planned(planner, declaring(**{quantity: most}, name=robot_name(planner)))  # type: ignore[arg-type]
    np.testing.assert_array_equal(plan.tau, free.tau)
    events = [event for event in plan.limits.violated if event.quantity == quantity]
    assert {event.joint for event in events} == {
        name for name, size in zip(plan.robot.actuated, largest, strict=True) if size > most * 1.001
    }
    assert max(abs(event.value) for event in events) >= largest.max() * (1.0 - 1e-9)
    assert plan.status is ResultStatus.LIMIT_VIOLATED
    wide = planned(planner, declaring(name=robot_name(planner)), limits=rp.Limits(**{quantity_of(quantity): most}))
    assert wide.limits.violated == plan.limits.violated


def quantity_of(quantity: str) -> str:
    return "actuator_speed" if quantity == "speed" else quantity


def test_least_time_keeps_declared_limits() -> None:
    path, mesh = reference.corner().path, rp.Mesh(steps=20, refinements=1)
    options: dict[str, Any] = {"mesh": mesh, "begin": "rest", "end": "free"}
    given = rp.plan_time_optimal(
        rp.VirtualWork(declaring()), path, limits=rp.Limits(effort=3.0, actuator_speed=0.9), **options
    )
    robot = declaring(effort=3.0, speed=0.9)
    own = rp.plan_time_optimal(rp.VirtualWork(robot), path, **options)
    assert own.t[-1] == given.t[-1]
    assert peaks(own, robot)[0].max() <= 3.0 * 1.001
    assert peaks(own, robot)[1].max() <= 0.9 * 1.001
    with pytest.raises(InputError, match="Nothing limits the time"):
        rp.plan_time_optimal(
            rp.VirtualWork(robot), path, limits=rp.Limits(effort=np.inf, actuator_speed=np.inf), **options
        )


def test_updates_on_line_keep_declared_efforts() -> None:
    def updated(robot: Robot, **options: Any) -> float:
        planner = rp.RecedingHorizon(rp.VirtualWork(robot), horizon=0.2, **options)
        return planner.update(0.0, reference.corner()).peak

    free = updated(declaring())
    bound = updated(declaring(effort=0.8 * free))
    assert bound <= 0.8 * free * 1.001
    assert bound == updated(declaring(), limits=rp.Limits(effort=0.8 * free))
