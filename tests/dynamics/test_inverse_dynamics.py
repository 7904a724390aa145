"""What the samples of a motion do not show: singularities between them, and joints that leave their limits."""

from __future__ import annotations

import importlib
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from command_line import call, write_motion
from scipy.optimize import brentq

import redundancy_pin as rp
from redundancy_pin import CarrierMotion, PlatformMotion
from redundancy_pin.errors import InputError
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.trajectory import Line, RestToRest, Trajectory, reference

CIRCLE = reference.circle(speed=0.5)
BACKENDS = {"rnea": rp.RneaDynamics, "virtual work": rp.VirtualWork, "compiled": rp.CompiledDynamics}


def base_line_instants() -> list[float]:
    """The times at which the circle meets the line through both hinges of the 2-RPR, where its legs are parallel."""

    def height(t: float) -> float:
        return float(CIRCLE.sample_at([t]).x[0, 1])

    grid = np.linspace(0.0, CIRCLE.duration, 200)
    y = CIRCLE.sample_at(grid).x[:, 1]
    return [brentq(height, grid[k], grid[k + 1], xtol=1e-14) for k in np.flatnonzero(y[1:] * y[:-1] < 0.0)]


@pytest.mark.long_for(
    "compiled-0.001", "compiled-0.01", "rnea-0.001", "rnea-0.05", "virtual work-0.01", "virtual work-0.001"
)
@pytest.mark.parametrize("dt", [0.05, 0.01, 1e-3])
@pytest.mark.parametrize("name", BACKENDS)
def test_crossings_between_samples_are_named_by_their_instants(name: str, dt: float) -> None:
    motion = CIRCLE.sample(dt)
    result = rp.inverse_dynamics(BACKENDS[name](zoo.robot_of("2rpr")), motion)
    # no sample shows it: every one of them has finite efforts
    assert np.isfinite(result.efforts.tau).all()
    expected = base_line_instants()
    assert len(expected) == 2
    # between samples the motion is a quintic, off by the sixth power of the step
    np.testing.assert_allclose([one.t for one in result.instants], expected, atol=max(20.0 * dt**6, 1e-12))
    assert result.status is ResultStatus.UNBOUNDED
    for one in result.instants:
        assert one.crosses
        assert one.unbounded
        assert one.status is SampleStatus.SINGULAR_INCONSISTENT
    assert repr(result).startswith("InverseDynamics(unbounded; singular at t = 0.51941")


def test_what_is_left_at_a_crossing_is_what_efforts_beside_it_grow_with() -> None:
    """τ ~ residual / margin: known from a sample beside the instant, however near."""
    dynamics = rp.RneaDynamics(zoo.robot_of("2rpr"))
    [first, _] = rp.inverse_dynamics(dynamics, CIRCLE.sample(0.01)).instants
    beside = rp.distribute(dynamics.reduce(CIRCLE.sample_at([first.t - 1e-5])))
    assert np.linalg.norm(beside.tau[0]) * beside.margin[0] == pytest.approx(first.residual, rel=1e-3)


def test_carriers_that_carry_the_force_leave_the_efforts_finite() -> None:
    """A plan through the singularities: the same instants, and finite efforts at them."""
    pytest.importorskip("casadi")
    robot = zoo.robot_of("2rpr")
    plan = rp.plan_whole_trajectory(rp.VirtualWork(robot), CIRCLE, mesh=rp.Mesh(dt=0.04))
    result = rp.inverse_dynamics(rp.RneaDynamics(robot), plan.motion, plan.carriers)
    np.testing.assert_allclose([one.t for one in result.instants], base_line_instants(), atol=1e-9)
    assert [one.status for one in result.instants] == [SampleStatus.SINGULAR_CONSISTENT] * 2
    assert result.status is ResultStatus.OK
    # half of their motion does not carry it
    half = CarrierMotion(*(0.5 * part for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd)))
    assert rp.inverse_dynamics(rp.RneaDynamics(robot), plan.motion, half).status is ResultStatus.UNBOUNDED


def test_two_samples_on_either_side_are_enough() -> None:
    """As far from the instant on both sides, so that no sample is nearer than its neighbour; and pickled."""
    [t, _] = base_line_instants()
    result = rp.inverse_dynamics(rp.RneaDynamics(zoo.robot_of("2rpr")), CIRCLE.sample_at([t - 1e-3, t + 1e-3]))
    [one] = pickle.loads(pickle.dumps(result)).instants
    assert one.t == pytest.approx(t, abs=1e-11)


def test_motions_that_stay_away_states_and_single_instants_have_no_instants() -> None:
    away, through, motion = zoo.robot_of("3rrr"), zoo.robot_of("2rpr"), CIRCLE.sample(0.01)
    states = PlatformMotion(motion.t, motion.x, motion.xd, motion.xdd, check_rates=False)
    for dt in (0.05, 5e-3):
        result = rp.inverse_dynamics(rp.RneaDynamics(away), reference.corner().sample(dt))
        assert (result.status, result.instants, result.joint_limits) == (ResultStatus.OK, (), ())
    for one in (states, motion[:1]):
        assert rp.inverse_dynamics(rp.RneaDynamics(through), one).instants == ()


@pytest.mark.long
def test_reachable_stretches_are_looked_at_one_by_one() -> None:
    """From out of reach straight down into the workspace, and through the pose where both distal links are in line."""
    robot = zoo.robot_of("five_bar")
    path = Line([0.25, 1.4], [0.25, 0.2])
    line = Trajectory(path, RestToRest(path.length, duration=2.0))
    result = rp.inverse_dynamics(rp.RneaDynamics(robot), line.sample(0.02), unreachable="mark")
    assert (result.efforts.status == SampleStatus.UNREACHABLE).any()
    expected = brentq(lambda t: line.sample_at([t]).x[0, 1] - 0.25 * np.sqrt(3.0), 0.1, 1.9, xtol=1e-14)
    assert [one.t for one in result.instants] == pytest.approx([expected], abs=1e-8)
    assert result.status is ResultStatus.UNBOUNDED


# --- the command ---


def test_the_command_says_the_instants_and_has_an_exit_code(tmp_path: Path) -> None:
    motion, out = write_motion(tmp_path / "circle.csv", CIRCLE, 0.01), tmp_path / "out.csv"
    command = ("inverse-dynamics", "--robot", "2rpr", "--motion", motion, "--out", out)
    result = call(*command)
    assert result.exit_code == 3
    assert "unbounded" in result.stdout
    [line] = result.stderr.splitlines()
    assert line.startswith("warning: no finite main efforts at t = 0.519414238, 0.831222824 s: det W changes sign")
    machine = call(*command, "--json")
    assert machine.exit_code == 3
    facts = json.loads(machine.stdout)
    assert facts["status"] == "unbounded"
    np.testing.assert_allclose([one["t"] for one in facts["singular_instants"]], base_line_instants(), atol=1e-9)
    assert {one["kind"] for one in facts["singular_instants"]} == {"type_ii"}
    assert all(one["unbounded"] and one["crosses"] for one in facts["singular_instants"])
    assert facts["joint_limits"] == []


# --- limits of joints ---


@pytest.fixture(scope="module")
def limited() -> rp.Robot:
    """The four-bar with a rocker, which is passive, that may turn from 1.5 to 2.0 rad."""
    return rp.with_limits(zoo.robot_of("four_bar"), {"rocker": {"lower": 1.5, "upper": 2.0}})


def crank(start: float, end: float, samples: int = 201) -> PlatformMotion:
    t = np.linspace(0.0, 1.0, samples)
    rate = np.full((samples, 1), end - start)
    return PlatformMotion(t, start + t[:, None] * (end - start), rate, 0.0 * rate)


def test_a_passive_joint_that_leaves_its_limit_is_named_with_time_value_and_limit(limited) -> None:
    motion = crank(0.6, 2.2)
    free = rp.load_robot("four_bar")
    # without limits the same machine says where the rocker is
    place = free.model.joints[free.model.getJointId("rocker")].idx_q
    rocker = rp.inverse_kinematics(free, motion).q[:, place]
    result = {one.value > one.limit: one for one in rp.inverse_dynamics(rp.RneaDynamics(limited), motion).joint_limits}
    assert (rocker > 2.0).any()
    for upper, limit, beyond in ((True, 2.0, rocker > 2.0), (False, 1.5, rocker < 1.5)):
        assert (upper in result) == beyond.any()
        if upper in result:
            one = result[upper]
            assert (one.joint, one.limit, one.unit) == ("rocker", limit, "rad")
            assert one.t == motion.t[np.argmax(beyond)]
            assert one.value == pytest.approx(rocker.max() if upper else rocker.min(), abs=1e-12)
    assert "joint 'rocker' leaves its upper limit 2 rad at t = " in str(result[True])
    inside = crank(1.0, 1.1)
    assert rp.inverse_dynamics(rp.RneaDynamics(limited), inside).joint_limits == ()
    assert rp.inverse_dynamics(rp.RneaDynamics(free), motion).joint_limits == ()


@pytest.mark.parametrize("name", BACKENDS)
def test_samples_without_efforts_are_a_motion_without(name: str) -> None:
    """On the singularity itself, at one sample; and all along it, where the margin is rounding of one sign."""
    dynamics = BACKENDS[name](zoo.robot_of("2rpr"))
    instant = CIRCLE.sample_at([base_line_instants()[0]])
    result = rp.inverse_dynamics(dynamics, instant)
    assert result.efforts.status_labels == ("singular_inconsistent",) or np.isnan(result.efforts.tau).all()
    assert result.status is ResultStatus.UNBOUNDED

    line = Line((0.15, 0.0), (0.25, 0.0))
    along = Trajectory(line, RestToRest(line.length, 1.0)).sample(0.05)
    push = rp.Wrench("end_effector", lambda t, x, xd: np.outer(5.0 * t, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
    stays = rp.inverse_dynamics(dynamics, along, external=[push])
    assert [(one.t, one.until) for one in stays.instants] == [(along.t[0], along.t[-1])]
    assert stays.status is ResultStatus.UNBOUNDED


@pytest.mark.long_for("virtual work", "rnea")
@pytest.mark.parametrize("name", BACKENDS)
def test_wrenches_given_at_samples_are_known_between_them(name: str) -> None:
    motion = CIRCLE.sample(0.01)
    values = np.zeros((len(motion), 6))
    values[:, 1] = 2.0 * motion.t  # linear in time: between samples what they say is exact
    dynamics = BACKENDS[name](zoo.robot_of("2rpr"))
    sampled = rp.inverse_dynamics(dynamics, motion, external=[rp.Wrench("end_effector", values)])
    law = rp.Wrench("end_effector", lambda t, x, xd: np.outer(2.0 * t, [0.0, 1.0, 0.0, 0.0, 0.0, 0.0]))
    exact = rp.inverse_dynamics(dynamics, motion, external=[law])
    residuals = [[one.residual for one in solution.instants] for solution in (sampled, exact)]
    np.testing.assert_allclose(*residuals, rtol=1e-9)
    assert (
        np.abs(
            np.subtract(residuals[1], [one.residual for one in rp.inverse_dynamics(dynamics, motion).instants])
        ).min()
        > 0.1
    )


@pytest.mark.parametrize(("start", "turns", "leaves"), [(2.0 * np.pi + 0.1, 0.9, False), (0.1, 1.4, True)])
def test_whole_turns_of_a_limited_crank_are_counted_once_per_motion(start: float, turns: float, leaves: bool) -> None:
    crank = zoo.robot_of("four_bar").independent_joints[0]
    robot = rp.with_limits(zoo.robot_of("four_bar"), {crank: {"lower": 0.0, "upper": 6.2}})
    angle = start + turns * 2.0 * np.pi * np.linspace(0.0, 1.0, 201)[:, None]
    rate = np.full_like(angle, turns * 2.0 * np.pi)
    turning = PlatformMotion(np.linspace(0.0, 1.0, 201), angle, rate, 0.0 * rate)
    solution = rp.inverse_dynamics(rp.RneaDynamics(robot), turning)
    out = solution.efforts.status == SampleStatus.OUT_OF_RANGE
    np.testing.assert_array_equal(out, angle[:, 0] > 6.2 if leaves else np.zeros(201, dtype=bool))
    assert bool(solution.joint_limits) == leaves


def test_bounds_and_preference_are_kept() -> None:
    """Of the first motor of two arms at rest, which has nothing to do by itself; what is preferred is missed least."""
    dynamics = rp.RneaDynamics("two_arms")
    at_rest = np.repeat(rp.forward_kinematics(dynamics.robot, dynamics.robot.q_reference[None]).x, 2, axis=0)
    motion = PlatformMotion([0.0, 1.0], at_rest, *np.zeros((2, 2, 6)))
    reduced = dynamics.reduce(motion)
    lower = np.where(np.arange(12) == 0, 0.1, -np.inf)
    assert (rp.inverse_dynamics(dynamics, motion, lower=lower).efforts.tau[:, 0] >= 0.1).all()
    assert (rp.inverse_dynamics(dynamics, motion, upper=-lower).efforts.tau[:, 0] <= -0.1).all()
    np.testing.assert_array_equal(rp.inverse_dynamics(dynamics, motion, lower=lower).bounds[:, 0], lower)
    np.testing.assert_array_equal(rp.inverse_dynamics(dynamics, motion, upper=3.0).bounds, [[-np.inf, 3.0]] * 12)
    preferred = np.arange(12.0)
    off = rp.inverse_dynamics(dynamics, motion, preferred=preferred).efforts.tau - preferred
    free = np.linalg.svd(reduced.W[0])[2][6:] / reduced.column_scale**2
    np.testing.assert_allclose(off @ free.T, 0.0, atol=1e-9)


SPACING = 0.01
"""Of the search for crossings, characteristic lengths."""


def shallow(steps: float, depth: float = 0.9) -> PlatformMotion:
    """A parabola of the 2-RPR over its base line, samples so many spacings of the search apart, two about its foot.

    Its foot is below the line, or above it where ``depth`` is negative, by that part of how high these two are over it.
    """
    t = np.arange(-3.5, 4.0)
    h = steps * SPACING * zoo.robot_of("2rpr").characteristic_length
    one = np.ones(8)
    x = np.stack([0.25 + h * t, 0.2 * h**2 * (t**2 - 0.25 * depth)], axis=1)
    return PlatformMotion(
        t, x, np.stack([h * one, 0.4 * h**2 * t], axis=1), np.stack([0.0 * one, 0.4 * h**2 * one], axis=1)
    )


@pytest.mark.parametrize("steps", [0.5, 5.0])
def test_a_dip_between_samples_is_searched_however_near_they_are(steps: float) -> None:
    motion = shallow(steps)
    assert (motion.x[:, 1] > 0.0).all()
    result = rp.inverse_dynamics(rp.RneaDynamics(zoo.robot_of("2rpr")), motion)
    np.testing.assert_allclose([one.t for one in result.instants], [-np.sqrt(0.225), np.sqrt(0.225)], atol=1e-6)


@pytest.mark.parametrize(
    ("steps", "depth", "status"),
    [(1.0, -60.0, "ok"), (5.0, -60.0, "ok"), (20.0, -60.0, "unresolved"), (1.0, 0.9, "unresolved")],
)
def test_what_cannot_be_searched_counts_where_samples_are_far_apart_or_near_the_line(
    steps: float, depth: float, status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def failing(*_: Any, **__: Any) -> None:
        raise InputError("It cannot be followed.", remedy="None.")

    monkeypatch.setattr(importlib.import_module("redundancy_pin.dynamics.inverse_dynamics"), "find_crossings", failing)
    motion = shallow(steps, depth)
    result = rp.inverse_dynamics(rp.RneaDynamics(zoo.robot_of("2rpr")), motion if depth > 0.0 else motion[3:5])
    assert (result.status.value, bool(result.unresolved)) == (status, status == "unresolved")


def test_motors_that_are_coordinates_are_warned_about_where_they_hardly_hold_the_machine() -> None:
    """With the platform as coordinates the pose is of type II; W of motors is the identity, whatever they hold."""
    five_bar = rp.load_robot("five_bar")
    way = [[0.25, 0.7], [0.25, 0.436]]  # both distal links are in line at 0.433
    down = rp.trajectory.from_points(way, [0.0, 1.0], ends="rest").sample(0.01)
    by_platform = rp.inverse_dynamics(five_bar, down)
    q = rp.inverse_kinematics(five_bar, down).q
    by_motors = rp.robot_from_model(
        five_bar.model, closures=five_bar.closures, actuated=list(five_bar.actuated), reference=np.array(q[0])
    )
    turn = rp.trajectory.from_points(five_bar.joint_positions(q), down.t, ends="rest").sample(0.01)
    result = rp.inverse_dynamics(by_motors, turn)
    assert np.allclose(result.efforts.margin, 1.0)
    assert by_platform.summary()["smallest_margin"] < 0.05
    assert any("the margin to type I is" in warning for warning in result.summary().warnings)
    assert 0.5 < result.summary()["smallest_type_i_margin"] / by_platform.summary()["smallest_margin"] < 2.0
