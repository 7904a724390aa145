"""One call, one sample: torques, accelerations and joint states against batches, Pinocchio and kinematics."""

from __future__ import annotations

import gc
import threading
import tracemalloc
from functools import cache

import moving
import numpy as np
import pinocchio as pin
import pytest
import zoo
from flat_linkages import row_of_four_bars
from generated_c import ACTUATED, actuated_by
from spatial_chains import chain_of

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics, TorqueSample
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.kinematics.branch import BranchEnd, follower
from redundancy_pin.machine_code import find_compiler
from redundancy_pin.robot import JointForces, Payload, Robot, Wrench
from redundancy_pin.robot.lookup import find_joint, find_link
from redundancy_pin.status import SampleStatus

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")

EQUAL = 1e-11
"""Of the largest value; near singularities times the condition number."""

NOT_REDUCED = {SampleStatus.UNREACHABLE, SampleStatus.BRANCH_LOST, SampleStatus.TYPE_I, SampleStatus.NOT_FINITE}
"""Statuses of samples without W, which a batch marks as unreachable."""


@cache
def robot_of(name: str) -> Robot:
    if name in ACTUATED:
        return actuated_by(*ACTUATED[name])
    return chain_of(name) if name == "continuous" else moving.massive(name)


@cache
def dynamics_of(name: str) -> rp.CompiledDynamics:
    return rp.CompiledDynamics(robot_of(name))


Backend = type[rp.CompiledDynamics] | type[rp.RneaDynamics] | type[rp.VirtualWork]

LARGE = [pytest.param(name, marks=pytest.mark.long) for name in ("gough", "3rps", "two_arms")]


# --- torques ---------------------------------------------------------------------------------------------------------


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
    *((rp.RneaDynamics, name) for name in ("2rpr", "3rrr", "delta", *ACTUATED)),
    *((rp.VirtualWork, name) for name in ("2rpr", "3rrr")),
]
LONG = ("gough", "3rps", "two_arms")


@pytest.mark.parametrize(
    ("backend", "name"),
    [*BACKENDS, *(pytest.param(rp.CompiledDynamics, name, marks=pytest.mark.long) for name in LONG)],
)
def test_torques_of_random_samples_are_those_of_reduce_and_distribute(backend: Backend, name: str) -> None:
    """Poses about the reference and far out of reach, in random motion; carriers on their tracks."""
    robot, dynamics, rng = robot_of(name), backend(robot_of(name)), np.random.default_rng(5)
    seen, home = set(), follower(robot_of(name)).home
    for trial in range(30):
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
    dynamics, zero = backend(robot_of("2rpr")), np.zeros(2)
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
    dynamics, zero = backend(robot_of("3rrr")), np.zeros(3)
    home = zoo.home_of(robot_of("3rrr"))
    before = dynamics.torque(home, zero, zero + 1.0)
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
        np.testing.assert_allclose(after.tau, before.tau, rtol=1e-12)
    for end in (-1.0, 1.0):
        off_track = dynamics.torque(home, zero, zero, s=1.001 * end)
        assert off_track.status is SampleStatus.OUT_OF_RANGE
        assert np.isfinite(off_track.tau).all()
        assert dynamics.torque(home, zero, zero, s=end).status is SampleStatus.OK


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])
def test_ranges_of_passive_joints_may_be_counted_from_another_turn(backend: Backend) -> None:
    """The first leg of the 2-RPR swings between 11 and 80 degrees, written a whole turn further."""
    turn = 2.0 * np.pi
    dynamics = backend(zoo.robot_of("2rpr").with_limits({"swivel_1": {"lower": 0.2 + turn, "upper": 1.4 + turn}}))
    for angle, status in (
        (0.1, SampleStatus.OUT_OF_RANGE),
        (0.3, SampleStatus.OK),
        (1.3, SampleStatus.OK),
        (1.5, SampleStatus.OUT_OF_RANGE),
    ):
        x = 0.3 * np.array([np.cos(angle), np.sin(angle)])  # the hinge is the origin
        assert dynamics.torque(x, [0.1, 0.0], [0.0, 1.0]).status is status


def test_torques_follow_the_branch_of_the_sample_before_or_of_start() -> None:
    """The elbow of the 2-RPR's legs: above the line of its base from one start, below it from the other."""
    dynamics, zero = dynamics_of("3rrr"), np.zeros(3)
    home = zoo.home_of(robot_of("3rrr"))
    path = home + np.linspace(0.0, 0.3, 40)[:, None] * [1.0, 0.0, 0.0]
    stepwise = [dynamics.torque(x, zero, zero + 1.0) for x in path]
    anew = [dynamics.torque(x, zero, zero + 1.0, start=robot_of("3rrr").q_reference) for x in path]
    for one, other in zip(stepwise, anew, strict=True):
        np.testing.assert_allclose(one.tau, other.tau, rtol=1e-9)
    results = {}

    def elsewhere() -> None:
        results["tau"] = dynamics.torque(home, zero, zero + 1.0).tau

    thread = threading.Thread(target=elsewhere)
    thread.start()
    thread.join()
    np.testing.assert_allclose(results["tau"], anew[0].tau, rtol=1e-12)
    np.testing.assert_allclose(dynamics.torque(path[-1], zero, zero + 1.0).tau, stepwise[-1].tau, rtol=1e-12)


def test_wrenches_and_other_loads_are_felt() -> None:
    pushed = robot_of("3rrr").loaded(
        Wrench("platform", np.array([3.0, -2.0, 0.0, 0.0, 0.0, 0.7])),
        Payload("platform", 1.2, [0.1, 0.0, 0.0]),
        JointForces(robot_of("3rrr").actuated[0], damping=0.4),
    )
    dynamics, rng = rp.CompiledDynamics(pushed), np.random.default_rng(1)
    home, rates, tracks = zoo.home_of(pushed), rng.normal(size=(2, 3)), rng.uniform(-0.1, 0.1, (3, 3))
    got = dynamics.torque(home, *rates, *tracks)
    assert_same(got, *batch(dynamics, home, *rates, *tracks))
    assert np.abs(got.tau - dynamics_of("3rrr").torque(home, *rates, *tracks).tau).max() > 0.1


@pytest.mark.parametrize("call", ["torque", "acceleration", "joint_state"])
def test_arguments_of_any_kind_are_taken_and_wrong_shapes_refused(call: str) -> None:
    robot, dynamics = robot_of("3rrr"), dynamics_of("3rrr")
    given: dict[str, list[Array]] = {
        "torque": [zoo.home_of(robot), np.ones(3), np.ones(3), np.full(3, 0.1), np.zeros(3), np.ones(3)],
        "acceleration": [np.array(robot.q_reference), np.zeros(robot.model.nv), np.ones(3), np.zeros(3)],
        "joint_state": [robot.q_reference[actuated_positions(robot)], np.zeros(3), np.full(3, 0.1), np.zeros(3)],
    }
    method, arguments = getattr(dynamics, call), given[call]
    want = method(*arguments)
    strided = [np.repeat(part, 2)[::2] for part in arguments]
    assert not strided[0].flags.c_contiguous
    listed = [part.tolist() for part in arguments]
    for other in (method(*strided), method(*listed), method(*listed[:2], *arguments[2:])):
        for one, two in zip(other, want, strict=True):
            np.testing.assert_array_equal(one, two)
    for i, part in enumerate(arguments):
        for wrong in (part[:-1], part[None], np.append(part, 0.0), "text", None):
            with pytest.raises(InputError):
                method(*arguments[:i], wrong, *arguments[i + 1 :])
    if call != "acceleration":
        ones = method(*arguments[: -2 if call == "joint_state" else -3], 0.1)
        np.testing.assert_array_equal(
            ones[0], method(*arguments[: -2 if call == "joint_state" else -3], np.full(3, 0.1))[0]
        )
    parked = method(*arguments[: len(arguments) - (3 if call == "torque" else 2 if call == "joint_state" else 1)])
    assert parked.status is SampleStatus.OK  # after others that were not parked


# --- accelerations ---------------------------------------------------------------------------------------------------


def constrained(robot: Robot, q: Array, v: Array, force: Array) -> Array:
    """Return Pinocchio's constrained accelerations (nv,): point closures, a proximal iteration to 1e-14."""
    model = robot.model
    models, datas = pin.StdVec_RigidConstraintModel(), pin.StdVec_RigidConstraintData()
    for closure in robot.closures:
        ends = (find_link(model, name) for name in (closure.frame_a, closure.frame_b))
        places = (part for end in ends for part in (end.parentJoint, end.placement))
        models.append(pin.RigidConstraintModel(pin.ContactType.CONTACT_3D, model, *places, pin.ReferenceFrame.LOCAL))
        datas.append(models[-1].createData())
    data = model.createData()
    pin.initConstraintDynamics(model, data, models, datas)
    settings = pin.ProximalSettings(1e-14, 1e-8, 100)
    return np.array(pin.constraintDynamics(model, data, q, v, force, models, datas, settings))


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar", "four_bar", "delta", *LARGE[:2]])
def test_accelerations_are_pinocchio_s(name: str) -> None:
    robot, dynamics = robot_of(name), dynamics_of(name)
    for i, state in enumerate(moving.random_states(robot, 3, 8)):
        force = moving.random_force(robot, i)
        tau, carried = force[robot.actuated_velocity], force[robot.carrier_velocity]
        a, status = dynamics.acceleration(state.q, state.v, tau, carried)
        want = constrained(robot, state.q, state.v, force)
        assert status is SampleStatus.OK
        np.testing.assert_allclose(a, want, rtol=0.0, atol=1e-8 * np.abs(want).max())


@pytest.mark.parametrize("name", ["3rrr", "continuous", LARGE[2]])
def test_accelerations_under_the_torques_of_a_motion_are_those_of_the_motion(name: str) -> None:
    robot, dynamics = robot_of(name), dynamics_of(name)
    t = np.linspace(0.0, 1.0, 12)
    motion, carriers = zoo.smooth_motion(robot, 3).at(t), zoo.carriers_at(robot, t, 3)
    tree = rp.inverse_kinematics(robot, motion)
    for k in range(len(t)):
        q, v, a = np.array(tree.q[k]), np.array(tree.v[k]), np.array(tree.a[k])
        q[robot.carrier_position], v[robot.carrier_velocity] = carriers.s[k], carriers.sd[k]
        a[robot.carrier_velocity] = carriers.sdd[k]
        torque = dynamics.torque(
            motion.x[k], motion.xd[k], motion.xdd[k], carriers.s[k], carriers.sd[k], carriers.sdd[k]
        )
        got = dynamics.acceleration(q, v, torque.tau, torque.carrier_force)
        assert got.status is SampleStatus.OK
        np.testing.assert_allclose(got.a, a, rtol=0.0, atol=1e-9 * np.abs(tree.a).max())


def test_accelerations_heed_wrenches() -> None:
    robot = robot_of("3rrr")
    force = np.array([3.0, -2.0, 0.0, 0.0, 0.0, 0.7])
    pushed = rp.CompiledDynamics(robot.loaded(Wrench("platform", force)))
    state = moving.random_states(robot, 3, 1)[0]
    model, data = robot.model, robot.model.createData()
    frame = model.getFrameId("platform")
    jacobian = pin.computeFrameJacobian(model, data, np.array(state.q), frame, pin.LOCAL_WORLD_ALIGNED)
    want = constrained(robot, state.q, state.v, jacobian.T @ force)
    got = pushed.acceleration(state.q, state.v, np.zeros(3))
    np.testing.assert_allclose(got.a, want, rtol=0.0, atol=1e-8 * np.abs(want).max())


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


# --- joint states ----------------------------------------------------------------------------------------------------


def actuated_positions(robot: Robot) -> list[int]:
    return [find_joint(robot.model, name).idx_q for name in robot.actuated]


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar", "delta", "more actuators", "continuous", *LARGE])
def test_all_joints_follow_from_the_motors(name: str) -> None:
    robot, dynamics = robot_of(name), dynamics_of(name)
    t = np.linspace(0.0, 2.0, 150)
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


def test_the_branch_is_that_of_the_start() -> None:
    """The end-effector of a 2-RPR lies above or below its base for the same legs."""
    robot, dynamics, still = robot_of("2rpr"), dynamics_of("2rpr"), np.zeros((1, 2))
    at = actuated_positions(robot)
    for side in (1.0, -1.0):
        motion = rp.PlatformMotion([0.0], [[0.24, 0.19 * side]], still, still)
        start = rp.inverse_kinematics(robot, motion).q[0]
        legs = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[0.25, 0.2 * side]], still, still)).q[0, at]
        for given in (start, None):  # then by the sample before
            got = dynamics.joint_state(legs, start=given)
            assert got.status is SampleStatus.OK
            np.testing.assert_allclose(got.x, [0.25, 0.2 * side], rtol=0.0, atol=1e-12)


def test_motors_far_away_are_followed_on_the_branch() -> None:
    """From the reference to legs of other lengths, in one call: what ``forward_kinematics`` finds along the way."""
    robot, dynamics = robot_of("3rrr"), dynamics_of("3rrr")
    at, home = actuated_positions(robot), np.array(robot.q_reference)
    position = home[at] - [0.5, 0.4, 0.3]
    got = dynamics.joint_state(position, start=home)
    assert got.status in (SampleStatus.OK, SampleStatus.NEAR_SINGULAR)
    steps = np.linspace(0.0, 1.0, 400)[:, None]
    q = home
    for target in home[at] + steps * (position - home[at]):
        q = dynamics.joint_state(target, start=q).q
    np.testing.assert_allclose(got.q, q, rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(got.q[at], position, rtol=0.0, atol=1e-12)


def test_from_far_away_it_is_that_branch_or_none() -> None:
    """The end-effector of the 2-RPR stays above its base, whatever legs are asked for at once."""
    robot, dynamics, rng = robot_of("2rpr"), dynamics_of("2rpr"), np.random.default_rng(0)
    at, answers = actuated_positions(robot), 0
    x = np.stack([rng.uniform(-0.2, 0.7, 120), rng.uniform(0.02, 0.5, 120)], axis=1)
    q = [rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], one[None], *np.zeros((2, 1, 2)))).q[0] for one in x]
    for start, end, target in zip(q[::2], q[1::2], x[1::2], strict=True):
        got = dynamics.joint_state(end[at], start=start)
        if got.status.solved:
            answers += 1
            np.testing.assert_allclose(got.x, target, rtol=0.0, atol=1e-9)
        else:
            assert got.status in (SampleStatus.BRANCH_LOST, SampleStatus.TYPE_II)
    assert 30 < answers <= 60


def test_motors_without_a_pose_have_a_status() -> None:
    robot, dynamics, still = robot_of("2rpr"), dynamics_of("2rpr"), np.zeros((1, 2))
    at = actuated_positions(robot)
    apart = dynamics.joint_state([0.05, 0.05])  # legs too short to meet, half a metre apart
    assert apart.status is SampleStatus.BRANCH_LOST
    assert np.isnan(np.concatenate([apart.q, apart.v, apart.x, apart.xd, [apart.margin]])).all()
    flat = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[0.2, 0.0]], still, still)).q[0]
    for step in (0.0, 1e-3):
        assert dynamics.joint_state(flat[at] + step, start=flat).status is SampleStatus.TYPE_II
    near = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[0.2, 1e-4]], still, still)).q[0]
    assert dynamics.joint_state(near[at], start=near).status is SampleStatus.NEAR_SINGULAR
    assert dynamics.joint_state(np.array([np.nan, 0.3])).status is SampleStatus.NOT_FINITE
    with pytest.raises(UnsupportedRobotError, match="1 actuated"):
        dynamics_of("fewer actuators").joint_state([0.0])


# --- memory ----------------------------------------------------------------------------------------------------------


def test_calls_leave_no_memory_behind() -> None:
    """2e4 calls, a quarter of them without an answer, and nothing allocated is left."""
    robot, dynamics, zero = robot_of("3rrr"), dynamics_of("3rrr"), np.zeros(3)
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
    calls(5_000)
    after = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    assert after - before < 2_000
