"""One call, one sample: the branch that is followed from sample to sample, and inputs that are refused."""

from __future__ import annotations

import itertools
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from flat_linkages import parallelogram, row_of_four_bars
from folding import folding_four_bar, joint, rocker_angle
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.machine_code import find_compiler
from redundancy_pin.robot import Robot, Wrench
from redundancy_pin.robot.scales import closure_tolerance
from redundancy_pin.status import SampleStatus

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")

FOLDING, GUESS = (0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5)
"""A four-bar whose crank turns once round, through a flat pose at π where two branches meet; m and rad."""

STOPPED, STOPPED_GUESS = (0.4, 0.3, 0.2, 0.25), (1.0, 2.0, 1.5)
"""A four-bar whose crank turns to ±1.4 rad and no farther: it reaches angles near a turn, but not on the same way."""

ROUNDING = 1e-9

OK = SampleStatus.OK

BOTH = pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])


@cache
def compiled(name: str) -> rp.CompiledDynamics:
    return rp.CompiledDynamics(name)


def in_small_steps(dynamics: Dynamics, path: Array, start: Array) -> Array:
    """Return the torques (N, m) along coordinates (N, 1) so dense that the next sample is plainly the nearest."""
    tau = [dynamics.torque(path[0], [1.0], [2.0], start=start).tau]
    return np.array([*tau, *(dynamics.torque(x, [1.0], [2.0]).tau for x in path[1:])])


# --- the branch ------------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("turn", [2.0, 2.5])
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


@pytest.mark.parametrize("noise", [0.05, 0.1, 0.3])
@pytest.mark.parametrize("name", ["four_bar", "five_bar", "3rrr"])
def test_backends_take_and_refuse_the_same_noisy_starts(name: str, noise: float) -> None:
    """Noise of encoders and passive joints, rad, until few starts are near enough; none of those changes the branch."""
    dynamics, reference = compiled(name), rp.RneaDynamics(compiled(name).robot)
    robot, random = dynamics.robot, np.random.default_rng(3)
    x, zero = zoo.home_of(robot), np.zeros(robot.n)
    want = reference.torque(x, zero, zero + 1.0)
    for start in robot.q_reference + noise * random.normal(size=(100, robot.model.nq)):
        got = [one.torque(x, zero, zero + 1.0, start=start) for one in (dynamics, reference)]
        assert got[0].status is got[1].status
        assert got[0].status in (SampleStatus.OK, SampleStatus.BRANCH_LOST)
        for one in got:
            if one.status is SampleStatus.OK:
                np.testing.assert_allclose(one.tau, want.tau, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize("modes", [False, True])
@pytest.mark.parametrize("offsets", [np.linspace(-0.5, 0.5, 21), np.linspace(-0.5, 0.5, 20)])
def test_calls_go_through_a_bifurcation_by_the_tangent(offsets: Array, modes: bool, tmp_path: Path) -> None:
    """Crank, coupler and rocker in one line: there and nearby the closed form of the branch, and RNEA's torques."""
    robot = folding_four_bar(tmp_path, FOLDING, GUESS, modes=modes)
    dynamics, rocker = rp.CompiledDynamics(robot), joint(robot, "rocker")
    crank = np.pi + offsets
    t, rate = 0.01 * np.arange(len(crank)), np.full((len(crank), 1), 2.0)
    motion = rp.PlatformMotion(t, crank[:, None], rate, 0.0 * rate + 0.7, check_rates=False)
    want = rp.distribute(rp.RneaDynamics(robot).reduce(motion))
    got = [dynamics.torque([x], [2.0], [0.7]) for x in crank]
    assert [one.status for one in got] == [SampleStatus(code) for code in want.status]
    np.testing.assert_allclose([one.tau for one in got], want.tau, rtol=0.0, atol=1e-7 * np.abs(want.tau).max())
    branch = min((rocker_angle(FOLDING, sign) for sign in (1.0, -1.0)), key=lambda one: _off(one, robot, rocker))
    for x in crank[np.abs(offsets) > 1e-9]:
        state = dynamics.joint_state([x], [2.0])
        assert state.status is SampleStatus.OK
        assert abs(np.sin((state.q[rocker] - branch(np.array([x]))[0]) / 2.0)) < 1e-9


def _off(branch: Any, robot: Robot, rocker: int) -> float:
    home = robot.q_reference
    return float(abs(np.sin((branch(home[:1])[0] - home[rocker]) / 2.0)))


@BOTH
@pytest.mark.parametrize(("turn", "status"), [((2.5, 0.0), OK), ((0.0, 2.0), SampleStatus.BRANCH_LOST)])
def test_a_tilt_by_more_than_a_right_angle_is_followed_by_coordinates(
    backend: type[Dynamics], turn: tuple[float, float], status: SampleStatus
) -> None:
    """Of the 3-RPS, whose tilts are two coordinates: one leads past its legs, the other stays on the branch."""
    dynamics, stepped, still = backend("3rps"), backend("3rps"), np.zeros(3)
    home, tilt = follower(dynamics.robot).home.x, np.array([0.0, *turn])
    for part in np.linspace(-0.5, 0.5, 101) if status is OK else ():
        small = stepped.torque(home + part * tilt, still, still)
    dynamics.torque(home - 0.5 * tilt, still, still)
    jumped = dynamics.torque(home + 0.5 * tilt, still, still)
    assert jumped.status is status
    if status is OK:
        np.testing.assert_allclose(jumped.tau, small.tau, rtol=1e-7)


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics, rp.VirtualWork])
def test_near_full_stretch_a_sample_is_ok_and_its_serial_margin_small(backend: type[Dynamics]) -> None:
    """W and f exist there, and grow: a leg of length 2 a part e from full stretch turns by sqrt(e), its lever too."""
    dynamics, along = backend("3rrr"), np.array([np.cos(0.7), np.sin(0.7), 0.0])
    corner = np.array([0.25 * np.cos(np.pi / 6.0), 0.125, 0.0])  # where leg 1 holds the platform, from its centre
    missing, still = np.array([1e-3, 1e-6, 1e-9]), np.zeros(3)
    near = [dynamics.torque(2.0 * (1.0 - part) * along + corner, still, [1.0, 0.5, 0.3]) for part in missing]
    assert [one.status for one in near] == [OK] * 3
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


# --- inputs ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics, rp.VirtualWork])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_whatever_is_not_finite_is_a_status(backend: type[Dynamics], bad: float) -> None:
    """In every argument, and in the time."""
    robot = zoo.robot_of("3rrr").loaded(Wrench("platform", lambda t, x, xd: np.zeros((len(t), 6))))
    dynamics = backend(zoo.robot_of("3rrr") if backend is rp.VirtualWork else robot)
    given = [zoo.home_of(robot), np.ones(3), np.ones(3), np.zeros(3), np.zeros(3), np.zeros(3)]
    assert dynamics.torque(*given).status is SampleStatus.OK
    for i, part in enumerate(given):
        for k in range(len(part)):
            wrong = [one.copy() for one in given]
            wrong[i][k] = bad
            assert dynamics.torque(*wrong).status is SampleStatus.NOT_FINITE
    assert dynamics.torque(*given, t=bad).status is SampleStatus.NOT_FINITE
    assert dynamics.torque(*given).status is SampleStatus.OK


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics, rp.VirtualWork])
@pytest.mark.parametrize("wrong", [1j, None, "1"])
def test_what_is_no_real_number_is_refused(backend: type[Dynamics], wrong: complex | str | None) -> None:
    """In every argument of every call for one sample: numpy makes NaN of None, and a real part of a complex number."""
    dynamics = backend("3rrr")
    given = [zoo.home_of(dynamics.robot), *np.zeros((5, 3))]
    calls: list[tuple[Any, list[Array]]] = [(dynamics.torque, given), (dynamics.sample, given)]
    if isinstance(dynamics, rp.CompiledDynamics):
        q, v = np.array(dynamics.robot.q_reference), np.zeros(dynamics.robot.model.nv)
        calls += [
            (dynamics.joint_state, [q[:3], *np.zeros((3, 3))]),
            (dynamics.acceleration, [q, v, *np.zeros((2, 3))]),
        ]
    for call, arguments in calls:
        for place in range(len(arguments)):
            for bad in (wrong, [wrong] * len(arguments[place])):
                with pytest.raises(InputError):
                    call(*arguments[:place], bad, *arguments[place + 1 :])


@BOTH
def test_numbers_that_are_not_finite_are_found_where_no_result_depends_on_them(backend: type[Dynamics]) -> None:
    """The position of a carrier on a rail of the base, across gravity."""
    dynamics = backend(parallelogram("rail"))
    for s, status in ((0.1, SampleStatus.OK), (np.nan, SampleStatus.NOT_FINITE), (-0.1, SampleStatus.OK)):
        assert dynamics.torque([1.3], [1.0], [2.0], [s], [0.2], [0.3]).status is status


@pytest.mark.parametrize("name", ["five_bar", "3rrr", "delta"])
def test_motors_that_jump_lead_where_small_steps_do(name: str) -> None:
    """Farther than Newton's method gets in two steps; in random directions, to where the steps are still regular."""
    dynamics, random = compiled(name), np.random.default_rng(4)
    robot = dynamics.robot
    start, jumps = np.array(robot.q_reference), 0
    motors = [robot.model.joints[robot.model.getJointId(motor)].idx_q for motor in robot.actuated]
    for direction in random.normal(size=(40, robot.m)):
        way = start[motors] + np.linspace(0.0, 1.2, 60)[1:, None] * direction / np.linalg.norm(direction)
        dynamics.joint_state(start[motors], start=start)
        stepped = list(itertools.takewhile(lambda state: state.status is OK, map(dynamics.joint_state, way)))
        if len(stepped) > 30:
            dynamics.joint_state(start[motors], start=start)
            jumped = dynamics.joint_state(way[len(stepped) - 1])
            assert jumped.status is OK
            np.testing.assert_allclose(jumped.q, stepped[-1].q, rtol=0.0, atol=ROUNDING)
            jumps += 1
    assert jumps > 10


def test_states_and_motors_that_are_not_finite_are_a_status() -> None:
    robot, dynamics = zoo.robot_of("3rrr"), compiled("3rrr")
    q = np.array(robot.q_reference)
    calls: list[tuple[Any, list[Array]]] = [
        (dynamics.joint_state, [q[:3], np.zeros(3), np.zeros(3), np.zeros(3)]),
        (dynamics.acceleration, [q, np.zeros(robot.model.nv), np.zeros(3), np.zeros(3)]),
    ]
    for call, given in calls:
        for i, part in enumerate(given):
            wrong = [one.copy() for one in given]
            wrong[i][len(part) - 1] = np.nan
            assert call(*wrong).status is SampleStatus.NOT_FINITE
    assert dynamics.acceleration(q, np.zeros(robot.model.nv), np.zeros(3), t=np.nan).status is SampleStatus.NOT_FINITE


@BOTH
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


@BOTH
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


@BOTH
def test_wrenches_that_cancel_count_among_the_forces_that_rounding_is_compared_with(backend: type[Dynamics]) -> None:
    """The legs in one line hold nothing across it: a rest of 1e-4 N of two wrenches of 1e6 N is their rounding."""
    push, still = np.array([0.0, 1e6, 0.0, 0.0, 0.0, 0.0]), np.zeros(2)
    rest = np.array([0.0, 1e-4, 0.0, 0.0, 0.0, 0.0])
    robot = zoo.robot_of("2rpr")
    frame = robot.platform.frame if robot.platform is not None else ""
    statuses = []
    for wrenches in ([push, rest - push], [rest]):
        dynamics = backend(robot.loaded(*(Wrench(frame, one) for one in wrenches)))
        dynamics.torque([0.2, 0.05], still, still)
        statuses.append(dynamics.torque([0.2, 0.0], still, still).status)
    assert statuses == [SampleStatus.SINGULAR_CONSISTENT, SampleStatus.SINGULAR_INCONSISTENT]
