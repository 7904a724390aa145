"""One call, one sample: against whole motions, Pinocchio and kinematics; and inputs that are refused."""

from __future__ import annotations

import gc
import inspect
import tracemalloc
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache
from typing import Any

import moving
import numpy as np
import pinocchio as pin
import pytest
import zoo
from constrained import constrained
from examples import FACTOR
from flat_linkages import parallelogram, row_of_four_bars
from generated_c import ACTUATED
from machines import machine

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.results import ReducedDynamics, TorqueSample
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.kinematics.branch import BranchEnd, follower
from redundancy_pin.machine_code import find_compiler
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.status import SampleStatus

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")

EQUAL = 1e-11
"""Of the largest value; near singularities times the condition number."""

NOT_REDUCED = {SampleStatus.UNREACHABLE, SampleStatus.BRANCH_LOST, SampleStatus.TYPE_I, SampleStatus.NOT_FINITE}
"""Statuses of samples without W, which a batch marks as unreachable."""

ALL = pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics, rp.VirtualWork])
LARGE = [pytest.param(name, marks=pytest.mark.long) for name in ("gough", "3rps", "two_arms")]
Backend = type[rp.CompiledDynamics] | type[rp.RneaDynamics] | type[rp.VirtualWork]
Call = tuple[Callable[..., Any], list[Array]]


@cache
def dynamics_of(name: str) -> rp.CompiledDynamics:
    return rp.CompiledDynamics(machine(name))


def actuated_positions(robot: Robot) -> list[int]:
    return [find_joint(robot.model, name).idx_q for name in robot.actuated]


def assert_alike(got: Any, want: Any, rtol: float = 0.0, atol: float = 0.0) -> None:
    """Compare all parts of two samples, by default to the last bit."""
    for one, other in zip(got, want, strict=True):
        np.testing.assert_allclose(one, other, rtol=rtol, atol=atol)


# --- W, f and carrier forces


def one_by_one(dynamics: Dynamics, motion: rp.PlatformMotion, carriers: rp.CarrierMotion, order: Any) -> list[Any]:
    """Return samples of a motion in any order; those of RNEA in a row start from one another."""
    samples: list[Any] = []
    for k in order:
        near = bool(samples) and isinstance(dynamics, rp.RneaDynamics) and order[0] == 0
        start = {"start": samples[-1]} if near else {}
        tracks = carriers.s[k], carriers.sd[k], carriers.sdd[k]
        samples.append(dynamics.sample(motion.x[k], motion.xd[k], motion.xdd[k], *tracks, **start))
    return samples


def assert_rows(samples: list[Any], whole: ReducedDynamics, order: Any) -> None:
    for name in ("W", "f", "carrier_force"):
        expected, got = getattr(whole, name)[list(order)], np.array([getattr(sample, name) for sample in samples])
        np.testing.assert_allclose(got, expected, rtol=0.0, atol=EQUAL * np.abs(expected).max(initial=1e-3))


SAMPLED = [
    *((rp.RneaDynamics, name) for name in zoo.SHIPPED),
    *((rp.VirtualWork, name) for name in ("2rpr", "3rrr")),
    *((rp.CompiledDynamics, name) for name in ("3rrr", "four_bar")),
    pytest.param(rp.CompiledDynamics, "gough", marks=pytest.mark.long),
]


@pytest.mark.parametrize(("backend", "name"), SAMPLED)
def test_samples_are_rows_of_a_whole_motion_in_any_order(backend: Backend, name: str) -> None:
    robot, t = machine(name), np.linspace(0.0, 1.0, 30)
    motion, carriers = zoo.smooth_motion(robot, 1).at(t), zoo.carriers_at(robot, t, 1)
    dynamics, whole = backend(robot), rp.RneaDynamics(robot).reduce(motion, carriers)
    for order in (range(30), np.random.default_rng(0).permutation(30)[:12].tolist()):
        samples = one_by_one(dynamics, motion, carriers, order)
        assert_rows(samples, whole, order)
        if backend is rp.RneaDynamics:
            assert all(sample.residual < 1e-11 for sample in samples)
    parked = dynamics.sample(motion.x[7], motion.xd[7], motion.xdd[7])  # whatever the carriers did before
    assert_rows([parked], rp.RneaDynamics(robot).reduce(motion[7:8]), [0])


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])
def test_each_thread_has_its_own_warm_start(backend: Backend) -> None:
    robot, t = machine("3rrr"), np.linspace(0.0, 1.0, 41)
    dynamics, parked, order = backend(robot), rp.CarrierMotion.parked(41, 3), range(41)
    motions = [zoo.smooth_motion(robot, seed).at(t) for seed in range(4)]
    with ThreadPoolExecutor(4) as pool:
        results = pool.map(lambda motion: one_by_one(dynamics, motion, parked, order), motions)
        for samples, motion in zip(results, motions, strict=True):
            assert_rows(samples, rp.RneaDynamics(robot).reduce(motion), order)
    home, far, zero = motions[0].x[0], motions[0].x[0] + [0.3, 0.0, 0.0], np.zeros(3)
    with ThreadPoolExecutor(1) as pool:
        there = dynamics.torque(far, zero, zero + 1.0)
        elsewhere = pool.submit(dynamics.torque, home, zero, zero + 1.0).result()
        assert_alike(elsewhere[:2], dynamics.torque(home, zero, zero + 1.0, start=robot.q_reference)[:2], 1e-12)
        assert_alike(dynamics.torque(far, zero, zero + 1.0)[:2], there[:2], 1e-12)


def test_efforts_that_overflow_move_no_state() -> None:
    """Of the 2-RPR near the line between its base hinges forces of 1e307 N are balanced by efforts of 1e309 N."""
    dynamics, home, zero = dynamics_of("2rpr"), zoo.home_of(machine("2rpr")), np.zeros(2)
    q = np.array(machine("2rpr").q_reference)
    for _ in range(2):
        before = dynamics.torque(home, zero, zero + 1.0, start=q)
    near = np.array([0.2, 1e-3])
    assert dynamics.torque(near, zero, np.array([0.0, 1e300])).status is SampleStatus.NEAR_SINGULAR
    dynamics.torque(home, zero, zero + 1.0, start=q)
    assert dynamics.torque(near, zero, np.array([0.0, 3e306])).status is SampleStatus.NOT_FINITE
    assert_alike(dynamics.torque(home, zero, zero + 1.0), before)


def test_a_sample_far_from_the_one_before_is_reached_from_the_reference() -> None:
    robot = zoo.robot_of("2rpr")
    compiled, xd, xdd = rp.CompiledDynamics(robot), [0.3, -0.2], [1.0, 2.0]
    # through zero length: the way from each to the next is barred
    for x in ([0.2, 0.1], [-0.2, -0.1], [0.2, 0.1]):
        theirs = rp.RneaDynamics(robot).reduce(rp.PlatformMotion([0.0], [x], [xd], [xdd]))
        sample = compiled.sample(x, xd, xdd)
        assert_rows([sample], theirs, [0])


def test_rates_that_overflow_are_no_singularity() -> None:
    robot = zoo.robot_of("3rrr")
    with pytest.raises(InputError, match="beyond 1e"):
        rp.CompiledDynamics(robot).sample(zoo.home_of(robot), [1e200] * 3, [0.0] * 3)


# --- torques


def batch(dynamics: Dynamics, x: Array, xd: Array, xdd: Array, *tracks: Array) -> tuple[rp.Distribution, Array]:
    """Return efforts and carrier forces of one sample, closed from the reference."""
    motion = rp.PlatformMotion(np.arange(1.0), x[None], xd[None], xdd[None], check_rates=False)
    carriers = rp.CarrierMotion(*(part[None] for part in tracks), check_rates=False)
    reduced = dynamics.reduce(motion, carriers, unreachable="mark", check_track=False)
    return rp.distribute(reduced), reduced.carrier_force[0]


def assert_same(got: TorqueSample, want: rp.Distribution, force: Array) -> None:
    assert got.status is SampleStatus(want.status[0]) or (
        want.status[0] == SampleStatus.UNREACHABLE and got.status in NOT_REDUCED
    )
    condition = max(1.0, min(want.condition[0], 1e9)) if np.isfinite(want.condition[0]) else 1e9
    size = max(np.nanmax(np.abs(want.tau), initial=0.0), np.nanmax(np.abs(force), initial=0.0), 1e-3)
    np.testing.assert_allclose(got.tau, want.tau[0], rtol=0.0, atol=EQUAL * size * condition)
    np.testing.assert_allclose(got.margin, want.margin[0], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(got.carrier_force, force, rtol=0.0, atol=EQUAL * size)


BACKENDS = [
    *((rp.CompiledDynamics, name) for name in ("2rpr", "3rrr", "five_bar", "delta", *ACTUATED)),
    *((rp.RneaDynamics, name) for name in ("2rpr", "3rrr", *ACTUATED)),
    pytest.param(rp.RneaDynamics, "delta", marks=pytest.mark.long),
    *((rp.VirtualWork, name) for name in ("2rpr", "3rrr")),
    *(pytest.param(rp.CompiledDynamics, name, marks=pytest.mark.long) for name in ("gough", "3rps", "two_arms")),
]


@pytest.mark.parametrize(("backend", "name"), BACKENDS)
def test_torques_of_random_samples_are_those_of_reduce_and_distribute(backend: Backend, name: str) -> None:
    """Poses about the reference and far out of reach, in random motion; carriers on their tracks."""
    robot, dynamics, rng = machine(name), backend(machine(name)), np.random.default_rng(5)
    seen, home = set(), follower(machine(name)).home
    for trial in range(10 * FACTOR):
        step = rng.uniform(-1.0, 1.0, robot.n) * zoo.reach_of(robot) * (1.0 if trial % 5 else 6.0)
        x = zoo.home_of(robot).copy()
        if x.ndim == 1:
            x += step
        else:
            x[:3, 3] += step[:3]
        rates, tracks = rng.normal(size=(2, robot.n)), rng.uniform(-0.05, 0.05, (3, robot.k))
        got = dynamics.torque(x, *rates, *tracks, start=robot.q_reference)
        seen.add(got.status)
        if got.status in NOT_REDUCED and backend is not rp.VirtualWork:  # whose closed form needs no branch
            end = follower(robot).advance(home, x)
            assert isinstance(end, BranchEnd)
            assert got.status is end.status
            assert np.isnan([*got.tau, got.margin, *got.carrier_force]).all()
        else:
            assert_same(got, *batch(dynamics, x, *rates, *tracks))
    if name == "fewer actuators":
        assert SampleStatus.UNDERACTUATED in seen
    else:
        assert SampleStatus.OK in seen


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics, rp.VirtualWork])
def test_torques_at_a_type_two_pose_exist_or_not(backend: Backend) -> None:
    """The legs of the 2-RPR in one line: at rest nothing is asked; in motion nothing finite answers."""
    dynamics, zero = backend(moving.massive("2rpr")), np.zeros(2)
    at, moving_on = np.array([0.2, 0.0]), np.array([0.3, -0.7])
    expected = {SampleStatus.SINGULAR_CONSISTENT: (zero, zero), SampleStatus.SINGULAR_INCONSISTENT: (zero, moving_on)}
    dynamics.torque([0.2, 0.05], zero, zero)
    for status, (xd, xdd) in expected.items():
        got = dynamics.torque(at, xd, xdd)
        assert got.status is status
        assert np.isfinite(got.tau).all() == status.solved
        assert got.margin < 1e-12
        assert_same(got, *batch(dynamics, at, xd, xdd, zero, zero, zero))
    near = dynamics.torque([0.2, 1e-4], zero, moving_on)
    assert near.status is SampleStatus.NEAR_SINGULAR
    assert np.abs(near.tau).max() > 1e3


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics, rp.VirtualWork])
def test_failures_are_statuses_and_the_next_sample_is_as_before(backend: Backend) -> None:
    dynamics, zero = backend(machine("3rrr")), np.zeros(3)
    home = zoo.home_of(machine("3rrr"))
    before = [dynamics.torque(home, zero, zero + 1.0) for _ in range(2)][-1]
    moved = 0.0 if backend is rp.CompiledDynamics else 1e-12
    for x, status in (
        (home + np.array([9.0, 0.0, 0.0]), SampleStatus.UNREACHABLE),
        (home * np.nan, SampleStatus.NOT_FINITE),
        (home, SampleStatus.NOT_FINITE),
    ):
        got = dynamics.torque(x, zero, zero + (np.inf if x is home else 1.0))
        assert got.status is status
        assert np.isnan([*got.tau, got.margin, *got.carrier_force]).all()
        after = dynamics.torque(home, zero, zero + 1.0)
        assert after.status is SampleStatus.OK
        np.testing.assert_allclose(after.tau, before.tau, rtol=moved)
    for end in (-1.0, 1.0):
        off_track = dynamics.torque(home, zero, zero, s=1.001 * end)
        assert off_track.status is SampleStatus.OUT_OF_RANGE
        assert np.isfinite(off_track.tau).all()
        assert dynamics.torque(home, zero, zero, s=end).status is SampleStatus.OK


@ALL
def test_ranges_of_passive_joints_may_be_counted_from_another_turn(backend: Backend) -> None:
    """The first leg of the 2-RPR swings between 11 and 80 degrees, written a whole turn further."""
    turn = 2.0 * np.pi
    dynamics = backend(rp.with_limits(zoo.robot_of("2rpr"), {"swivel_1": {"lower": 0.2 + turn, "upper": 1.4 + turn}}))
    for angle, status in (
        (0.1, SampleStatus.OUT_OF_RANGE),
        (0.3, SampleStatus.OK),
        (1.3, SampleStatus.OK),
        (1.5, SampleStatus.OUT_OF_RANGE),
    ):
        x = 0.3 * np.array([np.cos(angle), np.sin(angle)])  # the hinge is the origin
        assert dynamics.torque(x, [0.1, 0.0], [0.0, 1.0]).status is status


def test_wrenches_and_other_loads_are_felt() -> None:
    pushed = machine("3rrr").loaded(
        rp.Wrench("platform", np.array([3.0, -2.0, 0.0, 0.0, 0.0, 0.7])),
        rp.Payload("platform", 1.2, [0.1, 0.0, 0.0]),
        rp.JointForces(machine("3rrr").actuated[0], damping=0.4),
    )
    dynamics, rng = rp.CompiledDynamics(pushed), np.random.default_rng(1)
    home, rates, tracks = zoo.home_of(pushed), rng.normal(size=(2, 3)), rng.uniform(-0.1, 0.1, (3, 3))
    got = dynamics.torque(home, *rates, *tracks)
    assert_same(got, *batch(dynamics, home, *rates, *tracks))
    assert np.abs(got.tau - dynamics_of("3rrr").torque(home, *rates, *tracks).tau).max() > 0.1


@ALL
def test_wrenches_that_cancel_count_among_the_forces_that_rounding_is_compared_with(backend: type[Dynamics]) -> None:
    """The legs in one line hold nothing across it: a rest of 1e-4 N of two wrenches of 1e6 N is their rounding."""
    push, still = np.array([0.0, 1e6, 0.0, 0.0, 0.0, 0.0]), np.zeros(2)
    rest = np.array([0.0, 1e-4, 0.0, 0.0, 0.0, 0.0])
    robot = zoo.robot_of("2rpr")
    frame = robot.platform.frame if robot.platform is not None else ""
    statuses = []
    for wrenches in ([push, rest - push], [rest]):
        dynamics = backend(robot.loaded(*(rp.Wrench(frame, one) for one in wrenches)))
        dynamics.torque([0.2, 0.05], still, still)
        statuses.append(dynamics.torque([0.2, 0.0], still, still).status)
    assert statuses == [SampleStatus.SINGULAR_CONSISTENT, SampleStatus.SINGULAR_INCONSISTENT]


# --- accelerations


@pytest.mark.long_for("2rpr", "five_bar")
@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar", "four_bar", "delta", *LARGE[:2], "pushed"])
def test_accelerations_are_pinocchio_s(name: str) -> None:
    robot = machine("3rrr" if name == "pushed" else name)
    push, frame = np.array([3.0, -2.0, 0.0, 0.0, 0.0, 0.7]) * (name == "pushed"), robot.model.nframes - 1
    if name == "pushed":
        frame = robot.model.getFrameId("platform")
        dynamics = rp.CompiledDynamics(robot.loaded(rp.Wrench("platform", push)))
    else:
        dynamics = dynamics_of(name)
    for i, state in enumerate(moving.random_states(robot, 3, 3 * FACTOR)):
        force = moving.random_force(robot, i)
        a, status = dynamics.acceleration(
            state.q, state.v, force[robot.actuated_velocity], force[robot.carrier_velocity]
        )
        data, q = robot.model.createData(), np.array(state.q)
        pushed = pin.computeFrameJacobian(robot.model, data, q, frame, pin.LOCAL_WORLD_ALIGNED).T @ push
        want = constrained(robot, state.q, state.v, force + pushed)
        assert status is SampleStatus.OK
        np.testing.assert_allclose(a, want, rtol=0.0, atol=1e-8 * np.abs(want).max())


def test_accelerations_without_an_answer_have_a_status() -> None:
    """Legs without mass at rest under forces; a parallelogram that is flat, where it may fold; a NaN."""
    massless, parallelogram = rp.CompiledDynamics("2rpr"), rp.CompiledDynamics(row_of_four_bars(1))
    q, v = np.array(massless.robot.q_reference), np.zeros(massless.robot.model.nv)
    flat, almost = np.zeros(3), 1e-11 * np.array([1.0, -1.0, 1.0])
    unknown = massless.acceleration(np.append(q[:-1], np.nan), v, np.ones(2))
    for got, status in (
        (massless.acceleration(q, v, np.ones(2)), SampleStatus.SINGULAR_INCONSISTENT),
        (parallelogram.acceleration(flat, flat, [1.0]), SampleStatus.SINGULAR_INCONSISTENT),
        (parallelogram.acceleration(almost, flat, [1.0]), SampleStatus.SINGULAR_INCONSISTENT),
        (unknown, SampleStatus.NOT_FINITE),
    ):
        assert got.status is status
        assert np.isnan(got.a).all()
    folded = np.array(parallelogram.robot.q_reference)
    assert parallelogram.acceleration(folded, 0.0 * folded, [1.0]).status is SampleStatus.OK


# --- joint states


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar", "delta", "more actuators", "continuous", *LARGE])
def test_all_joints_follow_from_the_motors(name: str) -> None:
    robot = machine(name)
    dynamics = rp.CompiledDynamics(robot)  # at home, wherever other tests have left theirs
    t = np.linspace(0.0, 0.6, 45)
    motion, carriers = zoo.smooth_motion(robot, 4).at(t), zoo.carriers_at(robot, t, 4)
    tree = rp.inverse_kinematics(robot, motion)
    q, v = np.array(tree.q), np.array(tree.v)
    q[:, robot.carrier_position], v[:, robot.carrier_velocity] = carriers.s, carriers.sd
    joints = [find_joint(robot.model, name) for name in robot.actuated]
    for k in range(len(t)):
        position = [
            q[k, joint.idx_q] if joint.nq == 1 else np.arctan2(q[k, joint.idx_q + 1], q[k, joint.idx_q])
            for joint in joints
        ]
        got = dynamics.joint_state(position, v[k, robot.actuated_velocity], carriers.s[k], carriers.sd[k])
        assert got.status in (SampleStatus.OK, SampleStatus.NEAR_SINGULAR)
        scale = 1.0 / max(got.margin, 1e-3)
        np.testing.assert_allclose(got.q, q[k], rtol=0.0, atol=1e-12 * scale * max(1.0, np.abs(q[k]).max()))
        np.testing.assert_allclose(got.v, v[k], rtol=0.0, atol=1e-11 * scale * np.abs(v).max())
        np.testing.assert_allclose(got.x, motion.x[k], rtol=0.0, atol=1e-12 * scale)
        np.testing.assert_allclose(got.xd, motion.xd[k], rtol=0.0, atol=1e-11 * scale * np.abs(motion.xd).max())


@pytest.mark.parametrize("name", ["more actuators", pytest.param("two_arms", marks=pytest.mark.long)])
def test_redundant_motors_that_contradict_each_other_have_no_pose(name: str) -> None:
    """As in ``forward_kinematics``: by more than rounding, in positions or in velocities; nothing is moved."""
    robot, dynamics, random = machine(name), dynamics_of(name), np.random.default_rng(5)
    at, q0, length = actuated_positions(robot), np.array(robot.q_reference), robot.characteristic_length
    gamma = follower(robot).home.gamma[robot.actuated_velocity]
    rate = gamma @ random.normal(size=robot.n)
    away = np.linalg.svd(gamma)[0][:, robot.n]  # a direction that no motion of the platform has
    assert dynamics.joint_state(q0[at], rate, start=q0).status is SampleStatus.OK
    for off in (0.0, 1e-9, 1e-6, 1e-3, 0.1):
        position = q0[at] + off * away
        got, theirs = dynamics.joint_state(position, rate), rp.forward_kinematics(robot, position)
        assert got.status is SampleStatus(int(theirs.status[0]))
        assert got.status is (SampleStatus.OK if off < 1e-8 else SampleStatus.UNREACHABLE)
        # of least squares at most what a motor is off that the others leave, and no less than its share
        assert 0.1 * off * length <= got.residual + 1e-13 <= 1.01 * off * length * np.sqrt(robot.m) + 1e-12
        assert np.isnan(got.q).all() == np.isnan(got.xd).all() == (not got.status.solved)
        got = dynamics.joint_state(q0[at], rate + off * away * np.abs(rate).max())
        assert got.status is (SampleStatus.OK if off < 1e-8 else SampleStatus.UNREACHABLE)
    before = [dynamics.joint_state(q0[at], rate) for _ in range(3)][-1]
    assert dynamics.joint_state(q0[at], away).status is SampleStatus.UNREACHABLE
    assert dynamics.joint_state(q0[at] + 0.1 * away, rate).status is SampleStatus.UNREACHABLE
    assert dynamics.joint_state(q0[at], rate).status is SampleStatus.OK
    assert_alike(dynamics.joint_state(q0[at], rate), before)


def test_from_far_away_it_is_that_branch_or_none() -> None:
    """The end-effector of the 2-RPR stays above its base, whatever legs are asked for at once."""
    robot, dynamics, rng = machine("2rpr"), dynamics_of("2rpr"), np.random.default_rng(0)
    at, answers = actuated_positions(robot), 0
    x = np.stack([rng.uniform(-0.2, 0.7, 40), rng.uniform(0.02, 0.5, 40)], axis=1)
    q = [rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], one[None], *np.zeros((2, 1, 2)))).q[0] for one in x]
    for start, end, target in zip(q[::2], q[1::2], x[1::2], strict=True):
        got = dynamics.joint_state(end[at], start=start)
        if got.status.solved:
            answers += 1
            np.testing.assert_allclose(got.x, target, rtol=0.0, atol=1e-9)
        else:
            assert got.status in (SampleStatus.BRANCH_LOST, SampleStatus.TYPE_II)
    assert 10 < answers <= 20


def test_motors_without_a_pose_have_a_status() -> None:
    robot, dynamics, still = machine("2rpr"), dynamics_of("2rpr"), np.zeros((1, 2))
    at = actuated_positions(robot)
    apart = dynamics.joint_state([0.05, 0.05])  # legs too short to meet, half a metre apart
    assert apart.status is SampleStatus.UNREACHABLE
    assert apart.residual > 0.01
    assert np.isnan(np.concatenate([apart.q, apart.v, apart.x, apart.xd, [apart.margin]])).all()
    flat = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[0.2, 0.0]], still, still)).q[0]
    for step in (0.0, 1e-3):
        assert dynamics.joint_state(flat[at] + step, start=flat).status is SampleStatus.TYPE_II
    assert dynamics.joint_state(flat[at], start=robot.q_reference).status is SampleStatus.TYPE_II
    near = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[0.2, 1e-4]], still, still)).q[0]
    assert dynamics.joint_state(near[at], start=near).status is SampleStatus.NEAR_SINGULAR
    assert dynamics.joint_state(np.array([np.nan, 0.3])).status is SampleStatus.NOT_FINITE
    with pytest.raises(UnsupportedRobotError, match="1 actuated"):
        dynamics_of("fewer actuators").joint_state([0.0])


# --- inputs


def calls_of(dynamics: Dynamics) -> list[Call]:
    """Return the calls for one sample of the 3-RRR, with arguments that they answer; of RNEA there are two."""
    robot, ones, zero, tracks = dynamics.robot, np.ones(3), np.zeros(3), np.full(3, 0.1)
    given, q = [zoo.home_of(machine("3rrr")), ones, ones, tracks, zero, ones], np.array(robot.q_reference)
    calls: list[Call] = [(dynamics.torque, given), (dynamics.sample, given)]
    if isinstance(dynamics, rp.CompiledDynamics):
        motors = q[actuated_positions(robot)]
        calls += [(dynamics.acceleration, [q, np.zeros(robot.model.nv), ones, zero])]
        calls += [(dynamics.joint_state, [motors, zero, tracks, zero])]
    return calls


@ALL
def test_arguments_of_any_kind_are_taken_and_others_refused(backend: Backend) -> None:
    """numpy makes NaN of None, and a real part of a complex number."""
    dynamics = backend(machine("3rrr"))
    rounding = 1e-12 if backend is rp.RneaDynamics else 0.0  # its samples start where the one before was closed
    for call, given in calls_of(dynamics):
        want, strided = call(*given), [np.repeat(part, 2)[::2] for part in given]
        assert not strided[0].flags.c_contiguous
        listed = [part.tolist() for part in given]
        named = dict(zip(inspect.signature(call).parameters, given, strict=False))
        assert_alike(call(**named), want, rounding, rounding)
        unmasked = [np.ma.masked_array(part) for part in given]
        for other in (call(*strided), call(*listed), call(*listed[:2], *given[2:]), call(*unmasked)):
            assert_alike(other, want, rounding, rounding)
        for i, (name, part) in enumerate(zip(inspect.signature(call).parameters, given, strict=False)):
            with pytest.raises(InputError, match=rf"^{name} has shape"):
                call(*given[:i], part[:-1], *given[i + 1 :])
            masked = np.ma.masked_array(part, mask=np.arange(len(part)) == 0)
            wrong: list[Any] = [part[None], np.append(part, 0.0), "text", masked]
            for no_number in (1j, None, "1"):
                wrong += [no_number, [no_number] * len(part)]
            for bad in wrong:
                with pytest.raises(InputError):
                    call(*given[:i], bad, *given[i + 1 :])
        fewer = given[: 2 if call == dynamics.joint_state else 3]
        if call != dynamics.acceleration:
            assert_alike(call(*fewer, 0.1), call(*fewer, np.full(3, 0.1)), rounding, rounding)
        # carriers are parked, after others that were not
        assert_alike(call(*fewer), call(*fewer, 0.0), rounding, rounding)


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])
def test_masked_starts_are_refused(backend: type[Dynamics]) -> None:
    dynamics = backend(machine("3rrr"))
    q = np.array(dynamics.robot.q_reference)
    for call, given in calls_of(dynamics):
        if call in (dynamics.torque, dynamics.joint_state):
            with pytest.raises(InputError, match="masked"):
                call(*given, start=np.ma.masked_array(q, mask=np.arange(len(q)) == 0))
            assert call(*given, start=np.ma.masked_array(q)).status is SampleStatus.OK


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])
@pytest.mark.parametrize("beyond", [1e101, -1e160])
def test_places_beyond_1e100_are_no_numbers(backend: type[Dynamics], beyond: float) -> None:
    robot, dynamics, zero = machine("3rrr"), backend(machine("3rrr")), np.zeros(3)
    home, motors = zoo.home_of(robot), np.array(robot.q_reference)[actuated_positions(robot)]
    assert dynamics.torque(home, zero, zero).status is SampleStatus.OK
    assert dynamics.torque(home + beyond, zero, zero).status is SampleStatus.NOT_FINITE
    assert dynamics.torque(home, zero, zero).status is SampleStatus.OK
    if isinstance(dynamics, rp.CompiledDynamics):
        assert dynamics.joint_state(motors + beyond).status is SampleStatus.NOT_FINITE
        assert dynamics.joint_state(motors).status is SampleStatus.OK


@ALL
@pytest.mark.parametrize("bad", [np.nan, np.inf, -1e200])
def test_whatever_is_not_finite_or_too_large_is_a_status(backend: Backend, bad: float) -> None:
    """In every argument, and in the time; ``sample``, which has no status, refuses it.

    Squares of 1e200 are not finite; generated code scales by powers of two, and has a wider range.
    """
    if bad == -1e200 and backend is rp.CompiledDynamics:
        return
    robot = machine("3rrr")
    if backend is not rp.VirtualWork:
        robot = robot.loaded(rp.Wrench("platform", lambda t, x, xd: np.zeros((len(t), 6))))
    dynamics = backend(robot)
    for call, given in calls_of(dynamics):
        for i, part in enumerate(given):
            for k in range(len(part)):
                wrong = [one.copy() for one in given]
                wrong[i][k] = bad
                if call == dynamics.sample:
                    with pytest.raises(InputError):
                        call(*wrong)
                else:
                    assert call(*wrong).status is SampleStatus.NOT_FINITE
        if call in (dynamics.torque, dynamics.acceleration) and not np.isfinite(bad):
            assert call(*given, t=bad).status is SampleStatus.NOT_FINITE
        if call != dynamics.sample:
            assert call(*given).status is SampleStatus.OK


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])
def test_numbers_that_are_not_finite_are_found_where_no_result_depends_on_them(backend: type[Dynamics]) -> None:
    """The position of a carrier on a rail of the base, across gravity."""
    dynamics = backend(parallelogram("rail"))
    for s, status in ((0.1, SampleStatus.OK), (np.nan, SampleStatus.NOT_FINITE), (-0.1, SampleStatus.OK)):
        assert dynamics.torque([1.3], [1.0], [2.0], [s], [0.2], [0.3]).status is status


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])
def test_matrices_that_are_no_poses_are_refused(backend: type[Dynamics]) -> None:
    dynamics, zero = backend(zoo.robot_of("gough")), np.zeros(6)
    home = zoo.home_of(dynamics.robot)
    flipped, sheared, scaled, moved = (home.copy() for _ in range(4))
    flipped[:3, 2] *= -1.0
    sheared[0, 1] += 1e-6
    scaled[3, 3] = 2.0
    moved[3, 0] = 1e-6
    assert dynamics.torque(home, zero, zero).status is SampleStatus.OK
    for wrong in (flipped, sheared, scaled, moved, 1.001 * home):
        with pytest.raises(InputError, match="homogeneous pose"):
            dynamics.torque(wrong, zero, zero, start=np.array(dynamics.robot.q_reference))
        with pytest.raises(InputError, match="homogeneous pose"):
            dynamics.sample(wrong, zero, zero)
    for shape in ((16,), (2, 8)):
        with pytest.raises(InputError, match="shape"):
            dynamics.torque(home.reshape(shape), zero, zero)
    rounded = home.copy()
    rounded[0, 1] += 1e-11
    assert dynamics.torque(rounded, zero, zero).status is SampleStatus.OK


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])
def test_carriers_that_a_robot_does_not_have_are_refused(backend: type[Dynamics]) -> None:
    dynamics, zero = backend(zoo.robot_of("delta")), np.zeros(3)
    home = zoo.home_of(dynamics.robot)
    for place in range(3):
        tracks: list[Any] = [(), (), ()]
        tracks[place] = [0.1]
        with pytest.raises(InputError):
            dynamics.torque(home, zero, zero, *tracks)
    assert dynamics.torque(home, zero, zero, [], np.zeros(0), 0.0).status is SampleStatus.OK
    if isinstance(dynamics, rp.CompiledDynamics):
        q, v = np.array(dynamics.robot.q_reference), np.zeros(dynamics.robot.model.nv)
        with pytest.raises(InputError, match="carrier_force"):
            dynamics.acceleration(q, v, zero, [1.0])
        with pytest.raises(InputError, match="s has shape"):
            dynamics.joint_state(zero, zero, [0.1])


# --- memory


def test_calls_leave_no_memory_behind() -> None:
    """6e3 calls, a quarter of them without an answer, and nothing allocated is left."""
    robot, dynamics, zero = machine("3rrr"), dynamics_of("3rrr"), np.zeros(3)
    home, nowhere, motors = (
        zoo.home_of(robot),
        zoo.home_of(robot) * np.nan,
        robot.q_reference[actuated_positions(robot)],
    )
    q, v, tau = np.array(robot.q_reference), np.zeros(robot.model.nv), np.ones(3)

    def calls(count: int) -> None:
        for _ in range(count):
            dynamics.torque(home, zero, zero)
            dynamics.torque(nowhere, zero, zero)
            dynamics.acceleration(q, v, tau)
            dynamics.joint_state(motors, zero)

    calls(100)
    gc.collect()
    tracemalloc.start()
    calls(100)
    before = tracemalloc.get_traced_memory()[0]
    calls(1_500)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert after - before < 2_000


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics, rp.VirtualWork])
def test_forces_whose_squares_overflow_are_as_many_times_as_large(backend: Backend) -> None:
    """Velocity terms are of second order; gravity is lost beside them."""
    dynamics, zero = backend("3rrr"), np.zeros(3)
    x = zoo.home_of(dynamics.robot)
    slow, fast = (dynamics.torque(x, [scale, 2.0 * scale, scale], zero) for scale in (1e20, 1e90))
    assert fast.status is slow.status is SampleStatus.OK
    np.testing.assert_allclose(fast.tau * 1e-140, slow.tau, rtol=EQUAL)
