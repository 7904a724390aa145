"""Plans judged anew, edited ones, and what masses of zero and numpy's errors do to planners."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import InputError, PlanFileError
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import Line, reference


def other(plan: Plan) -> rp.CompiledDynamics | rp.VirtualWork:
    """Return a backend that the plan was not made by."""
    kind = rp.CompiledDynamics if plan.backend == "VirtualWork" else rp.VirtualWork
    return kind(rp.load_robot_of(plan))


@pytest.fixture(scope="module")
def whole() -> Plan:
    return rp.plan_whole_trajectory(rp.VirtualWork(rp.load_robot("3rrr")), reference.corner(), mesh=rp.Mesh(dt=0.03))


PLANS: dict[str, Callable[[], Plan]] = {
    "stepwise": lambda: rp.plan_stepwise(
        rp.VirtualWork(rp.load_robot("3rrr")), reference.corner(), mesh=rp.Mesh(dt=0.01)
    ),
    "single samples": lambda: rp.plan_stepwise(
        rp.RneaDynamics(rp.load_robot("3rrr")), reference.corner().sample(dt=0.01, two_sided=False)
    ),
    "returns": lambda: rp.plan_stepwise(
        rp.VirtualWork(rp.load_robot("3rrr")),
        reference.square(),
        mesh=rp.Mesh(dt=0.02),
        active="accelerating",
        return_time=0.6,
    ),
    "switch off": lambda: rp.plan_switch_off(
        rp.VirtualWork(rp.load_robot("2rpr")), reference.circle(), mesh=rp.Mesh(dt=0.01)
    ),
    "through singularities": lambda: rp.plan_whole_trajectory(
        rp.RneaDynamics(rp.load_robot("2rpr")),
        reference.circle(),
        mesh=rp.Mesh(dt=0.05, refinements=0),
        objective="peak",
        limits=rp.Limits(jerk=500.0),
    ),
}


@pytest.mark.long_for("returns", "single samples")
@pytest.mark.parametrize("name", PLANS)
def test_a_plan_is_what_it_says_to_the_other_backend_before_and_after_a_file(name: str, tmp_path: Path) -> None:
    plan = PLANS[name]()
    plan.save(tmp_path / "plan.npz")
    for one in (plan, rp.load_plan(tmp_path / "plan.npz")):
        result = rp.check_plan(one, other(one))
        assert result.deviations == ()
        assert result.passed
        assert result.status is one.status
        np.testing.assert_allclose(result.peak_effort, one.peak_effort, rtol=1e-3)
        assert result.imbalance < 1e-6


def with_limits(plan: Plan) -> Plan:
    return with_limit(plan, speed=0.01)


def with_limit(plan: Plan, **limits: float | list[float]) -> Plan:
    """Return the plan with other limits to be judged by, one for all joints or one each."""
    own = plan.limits.judged_by
    other = {name: np.broadcast_to(value, getattr(own, name).shape).astype(float) for name, value in limits.items()}
    return replace(plan, limits=replace(plan.limits, judged_by=replace(own, **other)))


EDITS: dict[str, tuple[Callable[[Plan], Plan], set[str]]] = {
    "no efforts": (lambda plan: replace(plan, tau=np.nan * plan.tau), {"main efforts"}),
    "limits": (with_limits, {"limits", "status"}),
    "status": (lambda plan: replace(plan, status=ResultStatus.LIMIT_VIOLATED), {"status"}),
    "jerk": (lambda plan: with_limit(plan, jerk=0.1), {"limits", "status"}),
}


@pytest.mark.parametrize("name", EDITS)
def test_an_edited_plan_is_not_what_it_says(name: str, whole: Plan) -> None:
    edit, expected = EDITS[name]
    result = rp.check_plan(edit(whole), other(whole))
    assert not result.passed
    assert {deviation.quantity for deviation in result.deviations} == expected
    for deviation in result.deviations:
        assert deviation.message.endswith(".")
        assert np.isnan(deviation.time) or whole.t[0] <= deviation.time <= whole.t[-1]


def test_the_imbalance_is_relative_to_the_largest_f(whole: Plan) -> None:
    """Without efforts all of f is left."""
    dynamics = other(whole)
    result = rp.check_plan(replace(whole, tau=0.0 * whole.tau), dynamics)
    reduced = dynamics.reduce(whole.motion, whole.carriers)
    f = reduced.f / reduced.row_scale
    assert result.imbalance == pytest.approx(np.linalg.norm(f, axis=1).max() / np.abs(f).max(), rel=1e-9)


def test_the_dynamics_of_another_robot_are_refused(whole: Plan) -> None:
    with pytest.raises(InputError, match="for another robot"):
        rp.check_plan(whole, rp.VirtualWork(rp.load_robot("3rrr", platform_mass=2.0)))
    with pytest.raises(InputError, match="for the dynamics"):
        rp.check_plan(whole, None)  # type: ignore[arg-type]


@pytest.mark.parametrize("factor", [7.0, np.nan])
def test_a_file_that_was_edited_is_refused(factor: float, whole: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    whole.save(path)
    with np.load(path) as archive:
        arrays = dict(archive)
    np.savez_compressed(path, **{**arrays, "tau": factor * arrays["tau"]})
    with pytest.raises(PlanFileError, match="digest" if factor == 7.0 else "no finite efforts"):
        rp.load_plan(path)
    # not even a word of the metadata
    content = json.loads(str(arrays["metadata"]))
    content["record"]["planner"] = "someone"
    np.savez_compressed(path, **{**arrays, "metadata": np.array(json.dumps(content))})
    with pytest.raises(PlanFileError, match="digest"):
        rp.load_plan(path)
    # nor the digest itself: only version 1 of the format had none
    content = {key: value for key, value in json.loads(str(arrays["metadata"])).items() if key != "digest"}
    np.savez_compressed(path, **{**arrays, "metadata": np.array(json.dumps(content))})
    with pytest.raises(PlanFileError, match="digest"):
        rp.load_plan(path)
    np.savez(path, **arrays)  # packed in another way it is the same plan
    np.testing.assert_array_equal(rp.load_plan(path).tau, whole.tau)


PLANNERS = {
    "stepwise": lambda dynamics, motion: rp.plan_stepwise(dynamics, motion, mesh=rp.Mesh(dt=0.02)),
    "switch off": lambda dynamics, motion: rp.plan_switch_off(dynamics, motion, mesh=rp.Mesh(dt=0.02)),
    "shortest return": lambda dynamics, motion: rp.plan_switch_off(
        dynamics, motion, mesh=rp.Mesh(dt=0.01), return_time="shortest"
    ),
    "whole": lambda dynamics, motion: rp.plan_whole_trajectory(dynamics, motion, mesh=rp.Mesh(dt=0.05)),
    "peak": lambda dynamics, motion: rp.plan_whole_trajectory(
        dynamics, motion, mesh=rp.Mesh(dt=0.1, refinements=0), objective="peak", end="free"
    ),
}


@pytest.mark.long_for("shortest return", "peak")
@pytest.mark.parametrize("name", PLANNERS)
def test_planners_work_where_numpy_raises_its_errors(name: str) -> None:
    motion, robot = (reference.corner(), "3rrr") if name == "stepwise" else (reference.line(speed=0.2), "2rpr")
    dynamics = rp.VirtualWork(rp.load_robot(robot))
    usual = PLANNERS[name](dynamics, motion)
    with np.errstate(all="raise"):
        plan = PLANNERS[name](dynamics, motion)
        result = rp.check_plan(plan, dynamics)
    assert result.passed
    np.testing.assert_array_equal(plan.tau, usual.tau)


def test_limits_wider_than_the_robots_are_noted() -> None:
    robot = zoo.robot_of("3rrr")
    plan = rp.plan_stepwise(rp.VirtualWork(robot), reference.corner(), mesh=rp.Mesh(dt=0.02))
    assert rp.check_plan(plan, rp.CompiledDynamics(robot)).wider_limits == ()
    result = rp.check_plan(with_limit(plan, track=[-9.0, 9.0]), rp.CompiledDynamics(robot))
    assert result.passed
    assert len(result.wider_limits) == robot.k
    assert result.wider_limits[0].startswith(f"{robot.carriers[0]}: judged by a track of -9 to 9, ")
    lower, upper = plan.limits.judged_by.track[0].tolist()
    for track, notes in (([lower, 9.0], robot.k), ([-9.0, upper], robot.k), ([-0.1, 0.1], 0)):
        assert len(rp.check_plan(with_limit(plan, track=track), rp.CompiledDynamics(robot)).wider_limits) == notes


def test_limits_wider_than_those_of_motors_are_noted() -> None:
    motors = {"base_1": {"effort": 0.001, "speed": 1e9}, "base_2": {"effort": 1e9, "speed": 0.01}}
    motors["base_3"] = {"effort": 1e9, "speed": 1e9}
    robot = rp.with_limits(zoo.robot_of("3rrr"), motors)
    free = rp.Limits(effort=1e9, actuator_speed=1e9)
    plan = rp.plan_stepwise(rp.VirtualWork(robot), reference.corner(), mesh=rp.Mesh(dt=0.02), limits=free)
    result = rp.check_plan(plan, rp.RneaDynamics(robot))
    assert result.passed
    assert result.wider_limits == (
        "base_1: judged by effort up to 1e+09, the robot's own is 0.001.",
        "base_2: judged by speed up to 1e+09, the robot's own is 0.01.",
    )


@pytest.mark.parametrize(("control", "most", "own"), [("-0.5 2", 6.0, "-5 to 20"), ("-2 0.5", 6.0, "-20 to 5"),
                                                     ("-0.5 2", 4.0, None)])  # fmt: skip
def test_a_limit_wider_than_an_uneven_range_is_noted(
    control: str, most: float, own: str | None, tmp_path: Path
) -> None:
    """A limit counts both ways, so that one below the larger end may still be beyond the smaller one."""
    text = """<mujoco><worldbody><body><joint name="motor" type="hinge" axis="0 0 1"/>
    <geom type="capsule" fromto="0 0 0 0.4 0 0" size="0.02" mass="1"/></body></worldbody>
    <actuator><motor joint="motor" gear="10" ctrllimited="true" ctrlrange="RANGE"/></actuator></mujoco>"""
    (tmp_path / "bar.xml").write_text(text.replace("RANGE", control), encoding="utf-8")
    robot = rp.load_robot(tmp_path / "bar.xml", actuated="motor")
    limits, mesh = rp.Limits(effort=most), rp.Mesh(steps=20)
    plan = rp.plan_time_optimal(rp.RneaDynamics(robot), Line([0.0], [1.0]), limits=limits, mesh=mesh)
    assert np.abs(plan.tau).max() == pytest.approx(most, rel=1e-4)
    noted = f"motor: judged by effort up to {most:g}, the robot's own is {own}."
    assert rp.check_plan(plan, rp.RneaDynamics(robot)).wider_limits == (() if own is None else (noted,))


def test_what_a_plan_says_of_its_limits_is_compared(whole: Plan) -> None:
    """Violations that are none, and amounts that are others; the limits themselves are stated once."""
    assert not {field.name for field in fields(whole.limits.judged_by)} & set(whole.parameters)
    event = LimitEvent(whole.robot.carriers[0], "speed", 0.0, 0.1, 0.05, 9.0, 2.5, 6.5)
    (deviation,) = rp.check_plan(
        replace(whole, limits=replace(whole.limits, violated=(event,))), other(whole)
    ).deviations
    assert (deviation.quantity, deviation.amount) == ("limits", 6.5)
    slow = with_limits(whole)
    broken = replace(slow, status=ResultStatus.LIMIT_VIOLATED)
    true = rp.check_plan(broken, other(whole)).violated
    reported = replace(broken, limits=replace(broken.limits, violated=true))
    assert rp.check_plan(reported, other(whole)).passed
    halved = tuple(replace(one, amount=0.5 * one.amount) for one in true)
    result = rp.check_plan(replace(reported, limits=replace(broken.limits, violated=halved)), other(whole))
    assert len(result.deviations) == len({one.joint for one in true})
    for one in result.deviations:
        assert (one.quantity, ", not by " in one.message) == ("limits", True)
        amounts = [event.amount for event in true if f" of {event.joint} " in one.message]
        assert 2.0 * one.amount == pytest.approx(max(amounts))


def test_an_effort_exceeded_at_samples_and_between_them_is_one_broken_limit(whole: Plan) -> None:
    tight = [0.5 * float(peak) for peak in whole.peak_effort]
    result = rp.check_plan(with_limit(whole, effort=tight), other(whole))
    efforts = [event for event in result.violated if event.quantity == "effort"]
    assert {event.joint for event in efforts} == set(whole.robot.actuated)
    for event in (
        max((e for e in efforts if e.joint == name), key=lambda e: e.amount) for name in whole.robot.actuated
    ):
        j = whole.robot.actuated.index(event.joint)
        assert event.amount == pytest.approx(tight[j], rel=1e-3)


def test_a_plan_that_is_no_optimum_and_unresolved_is_not_converged() -> None:
    """No sample of a corner shows its jump from both sides; the step that does not end at a minimum is graver."""
    dynamics = rp.VirtualWork(zoo.robot_of("3rrr"))
    plan = rp.plan_stepwise(dynamics, reference.corner().sample(0.02, two_sided=False))
    assert (plan.status, plan.between.passed) == (ResultStatus.UNRESOLVED, False)
    worse = replace(plan, findings=replace(plan.findings, optimal=False))
    assert rp.check_plan(worse, dynamics).status is ResultStatus.NOT_CONVERGED


def test_the_acceleration_of_the_first_sample_is_judged(whole: Plan) -> None:
    sdd = np.array(whole.carriers.sdd)
    sdd[0] += 2e-3 * np.abs(sdd).max()
    check = rp.check_plan(replace(whole, carriers=replace(whole.carriers, sdd=sdd)), other(whole))
    assert ("carrier motion sdd", 0.0) in {(one.quantity, one.time) for one in check.deviations}
