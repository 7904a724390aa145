"""One call, one sample: the branch that is followed from sample to sample, through any number of turns of a joint."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest
import zoo
from flat_linkages import row_of_four_bars
from folding import folding_four_bar, joint, rocker_angle, rocker_motion
from generated_c import COMPILERS, Code
from scipy.spatial.transform import Rotation
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.errors import InputError, SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.branch import BranchEnd, follower
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.machine_code import find_compiler
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import closure_tolerance
from redundancy_pin.status import SampleStatus

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")

FOLDING, GUESS = (0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5)
"""A four-bar whose crank turns once round, through a flat pose at π where two branches meet; m and rad."""

STOPPED, STOPPED_GUESS = (0.4, 0.3, 0.2, 0.25), (1.0, 2.0, 1.5)
"""A four-bar whose crank turns to ±1.4 rad and no farther: it reaches angles near a turn, but not on the same way."""

ROUNDING = 1e-9

BOTH = pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])


def in_small_steps(dynamics: Dynamics, path: Array, start: Array) -> Array:
    """Return the torques (N, m) along coordinates (N, 1) so dense that the next sample is plainly the nearest."""
    tau = [dynamics.torque(path[0], [1.0], [2.0], start=start).tau]
    return np.array([*tau, *(dynamics.torque(x, [1.0], [2.0]).tau for x in path[1:])])


@BOTH
def test_a_jump_keeps_the_branch_of_the_sample_before(backend: type[Dynamics]) -> None:
    """A four-bar of equal sides is a parallelogram or crossed; the second branch is not the reference's."""
    robot = row_of_four_bars(1)
    dynamics, path = backend(robot), np.linspace(1.2, 2.5, 60)[:, None]
    torques = []
    for branch in rp.assembly_modes(robot, path[0]).q:
        dense = in_small_steps(dynamics, path, branch)
        dynamics.torque(path[0], [1.0], [2.0], start=branch)
        there, back = (dynamics.torque(x, [1.0], [2.0]) for x in (path[-1], path[0]))
        np.testing.assert_allclose([there.tau, back.tau], dense[[-1, 0]], rtol=ROUNDING)
        torques.append(dense[-1, 0])
    assert abs(np.subtract(*torques)) > 0.1


@pytest.mark.parametrize("turn", [pytest.param(2.0, marks=pytest.mark.long), 2.5])
@pytest.mark.parametrize("axis", range(3))
def test_a_jump_by_more_than_a_right_angle_keeps_the_branch(axis: int, turn: float) -> None:
    """The rows of a rotation are sines, least again half a turn away; RNEA follows in short turns."""
    robot, still = rp.load_robot("gough"), np.zeros(6)
    home, half = follower(robot).home.x, np.zeros(3)
    half[axis] = 0.5 * turn
    poses = np.repeat(home[None], 2, axis=0)
    poses[:, :3, :3] = Rotation.from_rotvec([-half, half]).as_matrix() @ home[:3, :3]
    calls = rp.CompiledDynamics(robot), rp.RneaDynamics(robot)
    jumped, stepped = ([one.torque(pose, still, still) for pose in poses][1] for one in calls)
    assert (jumped.status, stepped.status) == (SampleStatus.OK, SampleStatus.OK)
    assert max(jumped.residual, stepped.residual) < closure_tolerance(robot)
    np.testing.assert_allclose(jumped.tau, stepped.tau, rtol=0.0, atol=ROUNDING * np.abs(stepped.tau).max())


@BOTH
def test_a_sample_off_the_branch_has_a_status_and_does_not_move_it(backend: type[Dynamics], tmp_path: Path) -> None:
    robot = folding_four_bar(tmp_path, STOPPED, STOPPED_GUESS)
    dynamics = backend(robot)
    start = np.array(rp.assembly_modes(robot, [1.0]).q)
    reference = int(np.abs(start - robot.q_reference).max(axis=1).argmin())
    other = start[1 - reference]
    want = dynamics.torque([1.1], [1.0], [2.0], start=other)
    assert want.status is SampleStatus.OK
    for crank, status in (([2.5], SampleStatus.UNREACHABLE), ([2.0 * np.pi - 1.0], SampleStatus.BRANCH_LOST)):
        lost = dynamics.torque(crank, [1.0], [2.0])
        assert lost.status is status
        assert np.isnan([*lost.tau, lost.margin]).all()
        again = dynamics.torque([1.1], [1.0], [2.0])
        np.testing.assert_allclose(again.tau, want.tau, rtol=ROUNDING)
    # two sides of 0.45 m together, ends 0.4 m and 0.3 m from their hinge: what Newton's method leaves is between a
    # third of what is missing, shared by three joints, and all of it
    missing = np.sqrt(0.4**2 + 0.3**2 - 2.0 * 0.4 * 0.3 * np.cos(2.5)) - 0.45
    assert 0.3 * missing < dynamics.torque([2.5], [1.0], [2.0]).residual < 1.01 * missing
    for failed in ([2.5], [2.0 * np.pi - 1.0]):
        assert not dynamics.torque(failed, [1.0], [2.0], start=start[reference]).status.solved
    np.testing.assert_allclose(dynamics.torque([1.1], [1.0], [2.0]).tau, want.tau, rtol=ROUNDING)


def test_a_refusal_holds_for_the_branch_that_it_was_met_on(tmp_path: Path) -> None:
    """Near the last angle of the crank, which is on no way from the other one: there kinematics answer."""
    robot = folding_four_bar(tmp_path, STOPPED, STOPPED_GUESS)
    dynamics = rp.CompiledDynamics(robot)
    low, high = (rp.assembly_modes(robot, [crank]).q[0] for crank in (1.0, 2.0 * np.pi - 1.0))
    limit = np.arccos((0.4**2 + 0.3**2 - 0.45**2) / (2 * 0.4 * 0.3)) - 1e-5
    for own, other, crank in ((low, high, limit), (high, low, 2.0 * np.pi - limit)):
        for _ in range(2):  # a set-point that is held
            assert dynamics.torque([crank], [1.0], [2.0], start=other).status is SampleStatus.BRANCH_LOST
        assert dynamics.torque([crank], [1.0], [2.0], start=own).status is SampleStatus.OK


@BOTH
def test_a_start_decides_the_branch_in_any_working_mode(backend: type[Dynamics]) -> None:
    robot, flipped = zoo.robot_of("five_bar"), zoo.robot_of("five_bar", working_mode=(-1, 1))
    dynamics, other, still = backend(robot), backend(flipped), np.zeros(2)
    x = zoo.home_of(robot)
    start = rp.inverse_kinematics(flipped, rp.PlatformMotion([0.0], x[None], still[None], still[None])).q[0]
    near, far = x + np.array([[0.05, 0.0], [0.2, 0.05]])
    for given, at in ((start, x), (None, near), (None, far), (None, x)):
        got, want = dynamics.torque(at, still, [1.0, 2.0], start=given), other.torque(at, still, [1.0, 2.0])
        assert got.status is want.status is SampleStatus.OK
        np.testing.assert_allclose(got.tau, want.tau, rtol=ROUNDING)
    own = dynamics.torque(x, still, [1.0, 2.0], start=robot.q_reference)
    assert own.status is SampleStatus.OK
    assert np.abs(own.tau - got.tau).max() > 0.1 * np.abs(own.tau).max()
    if isinstance(dynamics, rp.CompiledDynamics):
        state = dynamics.joint_state(start[[0, 3]], start=start)
        assert state.status is SampleStatus.OK
        np.testing.assert_allclose(state.q, start, atol=1e-12)


@BOTH
def test_a_start_that_is_open_or_no_number_is_refused_with_a_status(backend: type[Dynamics]) -> None:
    robot, zero = zoo.robot_of("3rrr"), np.zeros(3)
    dynamics, home, q = backend(robot), zoo.home_of(robot), np.array(robot.q_reference)
    before = dynamics.torque(home, zero, zero + 1.0)
    pose = np.setdiff1d(np.arange(len(q)), robot.carrier_position)
    open_start = q.copy()
    open_start[pose] += np.random.default_rng(3).uniform(-1.5, 1.5, len(pose))
    for start, status in ((open_start, SampleStatus.BRANCH_LOST), (q * np.nan, SampleStatus.NOT_FINITE)):
        assert dynamics.torque(home, zero, zero + 1.0, start=start).status is status
        np.testing.assert_allclose(dynamics.torque(home, zero, zero + 1.0).tau, before.tau, rtol=1e-12)
        if isinstance(dynamics, rp.CompiledDynamics):
            assert dynamics.joint_state(np.zeros(3), start=start).status is status
    noisy = q + 1e-4 * np.sign(open_start - q)  # as encoders have it: the pose alone says where the joints are
    np.testing.assert_allclose(dynamics.torque(home, zero, zero + 1.0, start=noisy).tau, before.tau, rtol=1e-12)
    for wrong in (q[:-1], [[0.0]], "there"):
        with pytest.raises(InputError, match="start"):
            dynamics.torque(home, zero, zero, start=wrong)


@BOTH
@pytest.mark.parametrize(("noise", "status"), [(0.005, SampleStatus.OK), (0.02, SampleStatus.BRANCH_LOST)])
def test_noise_of_a_start_counts_by_the_distance_from_a_stretched_leg(
    backend: type[Dynamics], noise: float, status: SampleStatus
) -> None:
    """The tip of the five-bar one part in a hundred from the reach of its first leg: both elbows are off by rad."""
    robot, still = zoo.robot_of("five_bar"), np.zeros(2)
    x = 0.99 * np.array([0.25, 0.968]) / np.hypot(0.25, 0.968)
    q = np.array(rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], x[None], still[None], still[None])).q[0])
    q[[1, 4]] += [noise, -noise]
    assert backend(robot).torque(x, still, still, start=q).status is status


@BOTH
def test_a_start_at_a_singular_pose_says_no_branch(backend: type[Dynamics]) -> None:
    """The first leg of the five-bar at full stretch: its elbow may leave to either side."""
    robot, still = zoo.robot_of("five_bar"), np.zeros(2)
    dynamics, own = backend(robot), follower(robot)
    stretched = own.advance(own.home, np.array([0.25, 0.968]) / np.hypot(0.25, 0.968))
    assert isinstance(stretched, BranchEnd)
    assert stretched.status is SampleStatus.TYPE_I
    assert dynamics.torque(own.home.x, still, still).status is SampleStatus.OK
    assert dynamics.torque(0.9 * stretched.x, still, still, start=stretched.q).status is SampleStatus.BRANCH_LOST
    assert dynamics.torque(own.home.x, still, still).status is SampleStatus.OK
    assert dynamics.torque(stretched.x, still, still).status is SampleStatus.TYPE_I


def asked_one_by_one(dynamics: rp.RneaDynamics, motion: rp.PlatformMotion) -> list[Any]:
    samples: list[Any] = []
    for k in range(len(motion)):
        start = samples[-1] if samples else None
        samples.append(dynamics.sample(motion.x[k], motion.xd[k], motion.xdd[k], start=start))
    return samples


def crank_motion(crank: Array) -> rp.PlatformMotion:
    rate = np.full((len(crank), 1), 2.0)
    return rp.PlatformMotion(0.01 * np.arange(len(crank)), crank[:, None], rate, 0.0 * rate + 0.7, check_rates=False)


@pytest.mark.parametrize("modes", [False, True])
@pytest.mark.parametrize("offsets", [np.linspace(-0.5, 0.5, 41), np.linspace(-0.5, 0.5, 20)])
def test_calls_go_through_a_bifurcation_by_the_tangent(offsets: Array, modes: bool, tmp_path: Path) -> None:
    """Crank, coupler and rocker in one line: there and nearby the closed form of the branch, by every call."""
    robot = folding_four_bar(tmp_path, FOLDING, GUESS, modes=modes)
    dynamics, rocker = rp.CompiledDynamics(robot), joint(robot, "rocker")
    motion = crank_motion(np.pi + offsets)
    home, crank = robot.q_reference, motion.x[:, 0]
    branch = min(
        (rocker_angle(FOLDING, sign) for sign in (1.0, -1.0)),
        key=lambda angle: abs(np.sin((angle(home[:1])[0] - home[rocker]) / 2.0)),
    )
    whole = rp.RneaDynamics(robot).reduce(motion)
    samples = asked_one_by_one(rp.RneaDynamics(robot), motion)
    np.testing.assert_allclose([s.f for s in samples], whole.f, rtol=0.0, atol=1e-7 * np.abs(whole.f).max())
    reached = np.array([sample.state.q[rocker] for sample in samples])
    assert np.abs(np.sin((reached - branch(crank)) / 2.0)).max() < 1e-12
    want = rp.distribute(whole)
    got = [dynamics.torque([x], [2.0], [0.7]) for x in crank]
    assert [one.status for one in got] == [SampleStatus(code) for code in want.status]
    np.testing.assert_allclose([one.tau for one in got], want.tau, rtol=0.0, atol=1e-7 * np.abs(want.tau).max())
    for x in crank:
        state = dynamics.joint_state([x], [2.0])
        assert state.status is SampleStatus.OK
        assert abs(np.sin((state.q[rocker] - branch(np.array([x]))[0]) / 2.0)) < 1e-9


@pytest.mark.parametrize(
    ("lengths", "guess"), [(FOLDING, GUESS), ((0.5, 0.2, 0.5, 0.2), (1.0, 1.0, -1.0))], ids=["folding", "parallelogram"]
)
def test_at_and_next_to_a_flat_pose_the_answer_is_that_of_the_branch(
    lengths: tuple[float, float, float, float], guess: tuple[float, float, float], tmp_path: Path
) -> None:
    """Whatever was asked for before: up to the flat pose, into it, past it and back, by 1e-9 to 0.1 rad."""
    robot, random = folding_four_bar(tmp_path, lengths, guess), np.random.default_rng(0)
    dynamics, reference = rp.CompiledDynamics(robot), rp.RneaDynamics(robot)
    home, rocker = robot.q_reference, joint(robot, "rocker")
    away = np.append(10.0 ** random.uniform(-9.0, -1.0, 15), [0.0, 1e-9, 2e-5, 1e-5, 0.0])
    away *= random.choice([-1.0, 1.0], len(away))
    for flat in (np.pi, 2.0 * np.pi):
        crank = flat + away
        angle, rate, _ = rocker_motion(robot, lengths, crank, np.ones(len(crank)), np.zeros(len(crank)))
        for x, position, speed in zip(crank, angle, rate, strict=True):
            state = dynamics.joint_state([x], [1.0])
            assert state.status is SampleStatus.OK
            assert abs(np.sin((state.q[rocker] - position) / 2.0)) < 1e-9
            np.testing.assert_allclose(state.v[rocker], speed, rtol=0.0, atol=1e-6)
            np.testing.assert_allclose([state.x[0], state.xd[0], state.margin], [x, 1.0, 1.0], rtol=1e-12)
            got, want = dynamics.torque([x], [1.0], [0.0]), reference.torque([x], [1.0], [0.0])
            assert got.status is want.status is SampleStatus.OK
            np.testing.assert_allclose(got.tau, want.tau, rtol=1e-6)
        assert dynamics.joint_state([flat - 0.1], start=home).status is SampleStatus.OK
        passed = dynamics.joint_state([flat])
        again = dynamics.joint_state([flat + 0.1], start=passed.q)  # what it returned says the branch
        assert abs(np.sin((again.q - dynamics.joint_state([flat + 0.1], start=home).q) / 2.0)).max() < 1e-9


def test_torques_and_joint_states_have_one_status_at_the_ends_of_a_crank(tmp_path: Path) -> None:
    """Its two last angles, and beyond: the crank is the coordinate and the motor, so both calls mean one state."""
    robot = folding_four_bar(tmp_path, STOPPED, STOPPED_GUESS)
    dynamics, last = rp.CompiledDynamics(robot), np.arccos((0.4**2 + 0.3**2 - 0.45**2) / (2 * 0.4 * 0.3))
    ends = last, TURN - last
    want = dict.fromkeys(ends, SampleStatus.TYPE_I)
    want |= dict.fromkeys((last + 1e-6, TURN - last - 1e-6, 2.5), SampleStatus.UNREACHABLE)
    for start in (q for crank in (1.0, TURN - 1.0) for q in rp.assembly_modes(robot, [crank]).q):
        beyond = TURN - 1.0 if start[joint(robot, "crank")] == pytest.approx(1.0) else 1.0
        for angle, status in (want | {beyond: SampleStatus.BRANCH_LOST}).items():
            torque = dynamics.torque([angle], [1.0], [2.0], start=start)
            state = dynamics.joint_state([angle], [1.0], start=start)
            assert torque.status is state.status is status
            assert np.isnan(torque.tau).all()
            assert np.isnan(state.q).all()


def test_samples_out_of_reach_singular_or_behind_the_border_are_refused_by_name(tmp_path: Path) -> None:
    dynamics, still = rp.RneaDynamics(zoo.robot_of("five_bar")), np.zeros(2)
    home = zoo.home_of(dynamics.robot)
    for given in (None, dynamics.sample(home, still, still)):
        with pytest.raises(UnreachablePoseError) as caught:
            dynamics.sample(home + 50.0, still, still, start=given)
        assert caught.value.details["sample"] == 0
    stopped = rp.RneaDynamics(folding_four_bar(tmp_path, STOPPED, STOPPED_GUESS))
    limit = np.arccos((0.4**2 + 0.3**2 - 0.45**2) / (2 * 0.4 * 0.3))
    start = stopped.sample([1.0], [0.0], [0.0])
    with pytest.raises((SingularPoseError, UnreachablePoseError)):
        stopped.sample([limit], [0.0], [0.0], start=start)
    with pytest.raises(WorkingModeError, match="cannot be reached continuously"):
        stopped.sample([2.0 * np.pi - 1.0], [0.0], [0.0], start=start)


@pytest.mark.parametrize("noise", [0.05, 0.1, 0.3])
@pytest.mark.parametrize("name", ["four_bar", "five_bar", "3rrr"])
def test_backends_take_and_refuse_the_same_noisy_starts(name: str, noise: float) -> None:
    """Noise of encoders and passive joints, rad, until few starts are near enough; none of those changes the branch."""
    dynamics, reference = rp.CompiledDynamics(name), rp.RneaDynamics(name)
    robot, random = dynamics.robot, np.random.default_rng(3)
    x, zero = zoo.home_of(robot), np.zeros(robot.n)
    want = reference.torque(x, zero, zero + 1.0)
    for start in robot.q_reference + noise * random.normal(size=(100, robot.model.nq)):
        got = [one.torque(x, zero, zero + 1.0, start=start) for one in (dynamics, reference)]
        assert got[0].status is got[1].status
        assert got[0].status in (SampleStatus.OK, SampleStatus.BRANCH_LOST)
        for one in got:
            if one.status is SampleStatus.OK:
                np.testing.assert_allclose(one.tau, want.tau, rtol=1e-10, atol=1e-10)


@BOTH
@pytest.mark.parametrize(("turn", "status"), [((2.5, 0.0), SampleStatus.OK), ((0.0, 2.0), SampleStatus.BRANCH_LOST)])
def test_a_tilt_by_more_than_a_right_angle_is_followed_by_coordinates(
    backend: type[Dynamics], turn: tuple[float, float], status: SampleStatus
) -> None:
    """Of the 3-RPS, whose tilts are two coordinates: one leads past its legs, the other stays on the branch."""
    dynamics, stepped, still = backend("3rps"), backend("3rps"), np.zeros(3)
    home, tilt = follower(dynamics.robot).home.x, np.array([0.0, *turn])
    for part in np.linspace(-0.5, 0.5, 101) if status is SampleStatus.OK else ():
        small = stepped.torque(home + part * tilt, still, still)
    dynamics.torque(home - 0.5 * tilt, still, still)
    jumped = dynamics.torque(home + 0.5 * tilt, still, still)
    assert jumped.status is status
    if status is SampleStatus.OK:
        np.testing.assert_allclose(jumped.tau, small.tau, rtol=1e-7)


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics, rp.VirtualWork])
def test_near_full_stretch_a_sample_is_ok_and_its_serial_margin_small(backend: type[Dynamics]) -> None:
    """W and f exist there, and grow: a leg of length 2 a part e from full stretch turns by sqrt(e), its lever too."""
    dynamics, along = backend("3rrr"), np.array([np.cos(0.7), np.sin(0.7), 0.0])
    corner = np.array([0.25 * np.cos(np.pi / 6.0), 0.125, 0.0])  # where leg 1 holds the platform, from its centre
    missing, still = np.array([1e-3, 1e-6, 1e-9]), np.zeros(3)
    near = [dynamics.torque(2.0 * (1.0 - part) * along + corner, still, [1.0, 0.5, 0.3]) for part in missing]
    assert [one.status for one in near] == [SampleStatus.OK] * 3
    grown = np.array([one.tau[0] for one in near]) * np.sqrt(missing)
    np.testing.assert_allclose(grown / grown[-1], 1.0, atol=0.1)
    np.testing.assert_allclose(grown[1] / grown[-1], 1.0, atol=2e-3)
    if backend is not rp.VirtualWork:
        margin = np.array([one.serial_margin for one in near]) / np.sqrt(missing)
        np.testing.assert_allclose(margin / margin[-1], 1.0, atol=0.02)
    for beyond, status in ((0.0, SampleStatus.TYPE_I), (1e-9, SampleStatus.UNREACHABLE)):
        end = dynamics.torque(2.0 * (1.0 + beyond) * along + corner, still, [1.0, 0.5, 0.3])
        assert end.status is status
        assert np.isnan(end.tau).all()


# --- coordinates many turns of a joint away


TURN = 2.0 * np.pi
TURNS = (0, 1, -1, 10, 790, -790, 1_000_000)
HERE = 1.3
BACKENDS: dict[str, Callable[[Robot], Dynamics]] = {"rnea": rp.RneaDynamics, "compiled": CompiledDynamics}
STIFFNESS = 0.02
GRAVITY = 9.81


def angle_after(turns: int) -> float:
    return HERE + TURN * turns


def within_a_turn(angle: float) -> float:
    """What is left of an angle as it was rounded: sine and cosine of large numbers are exact."""
    return float(np.arctan2(np.sin(angle), np.cos(angle)))


def motion_at(x: float, xd: float = 0.0, xdd: float = 0.0) -> rp.PlatformMotion:
    return rp.PlatformMotion([0.0], [[x]], [[xd]], [[xdd]])


def near(found: object, expected: object, x: float, scale: float = 1.0) -> None:
    """Equal but for rounding, that of an angle of this size included."""
    np.testing.assert_allclose(found, expected, rtol=0.0, atol=scale * (1e-11 + 4.0 * np.spacing(abs(x))))


@cache
def crank_rocker() -> Robot:
    return rp.with_limits(rp.load_robot("four_bar"), {"crank": {"lower": -1e7, "upper": 1e7}})


@cache
def drag_link() -> Robot:
    """A four-bar whose rocker turns with its crank, against a torsion spring that is wound up."""
    lengths = {"ground_length": 0.1, "crank_length": 0.3, "coupler_length": 0.35, "rocker_length": 0.4}
    return rp.load_robot("four_bar", **lengths).loaded(rp.JointForces("rocker", stiffness=STIFFNESS))


@cache
def geared(*polynomial: float) -> Robot:
    """Two pendulums, the second driven by the first."""
    declaration = {
        "gravity": [0.0, -GRAVITY, 0.0],
        "couplings": [{"joint": "second", "of": "first", "polynomial": list(polynomial)}],
        "actuated": ["first"],
        "independent": {"joints": ["first"]},
        "reference": {"joints": {"first": HERE}, "guess": {"second": float(np.polyval(polynomial[::-1], HERE))}},
    }
    joints = [J("first", "revolute", "base", "arm"), J("second", "revolute", "base", "other", (1.0, 0.0, 0.0))]
    return rp.load_robot(write_robot(Path(mkdtemp()), urdf_of(joints), declaration))


def holding(x: float, *polynomial: float) -> float:
    """Torque that holds the pendulums: the slope of m g (y of both centres at (0.1, 0.02))."""
    second, slope = np.polyval(polynomial[::-1], x), np.polyval(np.polyder(polynomial[::-1]), x)
    lever = [0.1 * np.cos(angle) - 0.02 * np.sin(angle) for angle in (x, second)]
    return float(GRAVITY * (lever[0] + slope * lever[1]))


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("turns", TURNS)
def test_a_crank_is_the_same_after_any_number_of_turns(backend: str, turns: int) -> None:
    dynamics, x = BACKENDS[backend](crank_rocker()), angle_after(turns)
    plain, far = (dynamics.reduce(motion_at(each, 2.0, 3.0)) for each in (within_a_turn(x), x))
    for name in ("f", "W"):
        near(getattr(far, name), getattr(plain, name), x)
    assert rp.distribute(far).status[0] == rp.distribute(plain).status[0]


@pytest.mark.parametrize("backend", BACKENDS)
@pytest.mark.parametrize("turns", [*TURNS[:-1], 5_000])
def test_a_joint_that_turns_along_keeps_its_turns(backend: str, turns: int) -> None:
    """Each turn winds the spring up by 2π; the work of that is STIFFNESS 2π turns dφ."""
    dynamics, x = BACKENDS[backend](drag_link()), angle_after(turns)
    slope = float(inverse_kinematics(drag_link(), motion_at(within_a_turn(x))).gamma[0, 1, 0])
    assert abs(slope) > 0.2
    plain, far = (dynamics.reduce(motion_at(each)).f for each in (within_a_turn(x), x))
    wound = STIFFNESS * TURN * turns * slope
    near(far - plain, wound, x, max(1.0, abs(wound)))


@pytest.mark.parametrize("backend", BACKENDS)
def test_turns_of_a_dependent_joint_are_given_up_where_they_would_open_the_loops(backend: str) -> None:
    dynamics, x = BACKENDS[backend](drag_link()), angle_after(1_000_000)
    plain, far = (dynamics.reduce(motion_at(each)).f for each in (within_a_turn(x), x))
    near(far, plain, x)


WHOLE = (0.2, 1.0, 1.0 / (2.0 * HERE + TURN))
"""The first turn adds one more turn of the second joint, the next ones add others."""
NEVER = [(0.2, 0.1 * 2.0**0.5), (0.2, 1.0, 1e-5)]
"""An incommensurate ratio, and a curved one."""
GEARS = [
    *((backend, (0.2, 2.5), turns) for backend in BACKENDS for turns in TURNS[:-1]),
    *((backend, WHOLE, 4) for backend in BACKENDS),
    *(("compiled", polynomial, 790) for polynomial in NEVER),
    ("compiled", (0.2, 0.1234), 1_000_000),  # a ratio of 617 to 5000; RNEA takes a minute
    pytest.param("rnea", (0.2, 0.1234), 1_000_000, marks=pytest.mark.long),
]


@pytest.mark.parametrize(("backend", "polynomial", "turns"), GEARS)
def test_gears_do_not_come_round_with_every_turn(backend: str, polynomial: tuple[float, ...], turns: int) -> None:
    x = angle_after(turns)
    found = BACKENDS[backend](geared(*polynomial)).reduce(motion_at(x)).f[0, 0]
    near(found, holding(x, *polynomial), x, 100.0 if polynomial == WHOLE else 10.0)


@pytest.mark.parametrize("polynomial", NEVER)
def test_turns_that_never_repeat_are_followed_one_by_one_up_to_a_number(polynomial: tuple[float, ...]) -> None:
    with pytest.raises(UnreachablePoseError, match=r"1000000 turns of 'first' away, which do not repeat"):
        CompiledDynamics(geared(*polynomial)).reduce(motion_at(angle_after(1_000_000)))


@pytest.mark.parametrize("backend", BACKENDS)
def test_samples_too_many_turns_away_are_marked_and_others_are_not(backend: str) -> None:
    robot, x, still = geared(0.2, 0.1 * 2.0**0.5), angle_after(20_000), np.zeros((3, 1))
    dynamics = BACKENDS[backend](robot)
    motion = rp.PlatformMotion([0.0, 1.0, 2.0], [[0.3], [x], [0.4]], still, still, check_rates=False)
    reduced = dynamics.along(motion, unreachable="mark").reduce()
    assert reduced.reachable.tolist() == [True, False, True]
    near(reduced.f[[0, 2], 0], [holding(one, 0.2, 0.1 * 2.0**0.5) for one in (0.3, 0.4)], 1.0, 10.0)
    assert not dynamics.along(motion[1:2], unreachable="mark").reduce().reachable.any()
    with pytest.raises(UnreachablePoseError, match="which do not repeat") as caught:
        dynamics.reduce(motion)
    assert caught.value.details["sample"] == 1
    assert dynamics.torque([x], [0.0], [0.0]).status is SampleStatus.UNREACHABLE
    assert not rp.forward_kinematics(robot, [[x]]).known.any()


def test_one_sample_after_another_and_a_motion_agree() -> None:
    """A motion counts the turns of a dependent joint as it goes; a sample far away has as many."""
    t = np.linspace(0.0, 1.0, 200)
    x = HERE + 3.2 * TURN * t
    full, ones = np.ones((200, 1)), CompiledDynamics(drag_link())
    motion = rp.PlatformMotion(t, x[:, None], 3.2 * TURN * full, 0.0 * full)
    f = ones.reduce(motion).f
    near([ones.sample([x[k]], [3.2 * TURN], [0.0]).f for k in (199, 7, 120)], f[[199, 7, 120]], x[-1], 100.0)


@pytest.mark.skipif(not COMPILERS, reason="no compiler is installed")
@pytest.mark.parametrize("turns", TURNS)
def test_generated_c_goes_there(turns: int) -> None:
    x = angle_after(turns)
    for robot in (crank_rocker(), geared(0.2, 2.5)):
        if robot is not crank_rocker() and turns == TURNS[-1]:
            continue  # the geared joint is rounded to 1e-9 there
        code = Code(robot)
        state = code.start()
        assert code.go_to(state, np.array([x])) == 0
        got = code.efforts(state, np.array([x]), np.array([2.0]), np.array([3.0]))
        expected = rp.RneaDynamics(robot).reduce(motion_at(x, 2.0, 3.0))
        assert got.status == 0
        near(got.f, expected.f[0], x, 10.0)
        assert code.go_to(state, np.array([HERE])) == 0
