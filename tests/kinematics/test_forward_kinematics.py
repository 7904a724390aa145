"""Forward kinematics against closed forms: two circles (five-bar), three circles (3-RRR), leg lengths (Gough)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
import zoo
from scipy.optimize import brentq

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, SingularPoseError, UnreachablePoseError, UnsupportedRobotError
from redundancy_pin.status import SampleStatus

BASE, LINK = 0.5, 0.5  # of the shipped five-bar, m
Pair = tuple[float, float]
TOLERANCE = 1e-11  # closure tolerance, times the gain of a well-conditioned pose
LIKE_RATES = 1e-6  # central differences at 1e-4 s


def motors(robot: rp.Robot, q: Array) -> Array:
    return np.array(q)[..., robot.actuated_velocity]


def two_circles(u: Array, side: float = 1.0) -> Array:
    """Return (N, 2) the point of a five-bar with motor angles (N, 2): the upper intersection of two circles, or NaN."""
    a = LINK * np.stack([np.cos(u[:, 0]), np.sin(u[:, 0])], axis=1)
    b = LINK * np.stack([np.cos(u[:, 1]), np.sin(u[:, 1])], axis=1) + [BASE, 0.0]
    d = b - a
    half = 0.5 * np.linalg.norm(d, axis=1)
    with np.errstate(invalid="ignore"):
        height = np.sqrt(LINK**2 - half**2)
    normal = np.stack([-d[:, 1], d[:, 0]], axis=1) / (2.0 * half[:, None])
    return 0.5 * (a + b) + side * height[:, None] * normal


@pytest.fixture(scope="module")
def five_bar() -> rp.Robot:
    return zoo.robot_of("five_bar")


def turning(t: Array) -> tuple[Array, Array, Array]:
    """Return (N, 2) motor angles of a motion of the five-bar from the reference, their rates and accelerations."""
    home = motors(zoo.robot_of("five_bar"), zoo.robot_of("five_bar").q_reference)
    size = np.array([0.3, -0.2])
    return (
        home + size * np.sin(t)[:, None] + [0.0, 0.1] * t[:, None],
        size * np.cos(t)[:, None] + [0.0, 0.1],
        -size * np.sin(t)[:, None],
    )


def test_five_bar_is_the_intersection_of_two_circles(five_bar: rp.Robot) -> None:
    t = np.linspace(0.0, 3.0, 31)
    u, ud, udd = turning(t)
    solution = rp.forward_kinematics(five_bar, u, rates=ud, accelerations=udd)
    assert set(solution.status_labels) == {"ok"}
    assert np.abs(solution.x - two_circles(u)).max() < TOLERANCE
    h = 1e-4
    before, here, after = (two_circles(turning(t + step)[0]) for step in (-h, 0.0, h))
    assert np.abs(solution.xd - (after - before) / (2 * h)).max() < LIKE_RATES
    assert np.abs(solution.xdd - (after - 2 * here + before) / h**2).max() < 1e-5
    assert np.abs(np.einsum("nij,nj->ni", solution.jacobian, ud) - solution.xd).max() < TOLERANCE


def test_start_chooses_the_branch(five_bar: rp.Robot) -> None:
    u = turning(np.linspace(0.0, 3.0, 7))[0]
    modes = rp.assembly_modes(five_bar, u[0])
    assert len(modes) == 2
    other = rp.forward_kinematics(five_bar, u, start=modes.q[1])
    assert np.abs(other.x - two_circles(u, -1.0)).max() < TOLERANCE


def test_no_samples_are_no_poses(five_bar: rp.Robot) -> None:
    nothing = rp.forward_kinematics(five_bar, np.zeros((0, 2)))
    assert nothing.x.shape == (0, 2)
    assert len(nothing) == 0


def test_motors_out_of_reach_end_the_branch(five_bar: rp.Robot) -> None:
    home = motors(five_bar, five_bar.q_reference)
    out = np.concatenate([np.linspace(0.0, 1.0, 11), np.linspace(0.9, 0.0, 10)])
    u = home + out[:, None] * [1.0, -1.0]  # the elbows part until the distal links cannot meet, and come back
    solution = rp.forward_kinematics(five_bar, u)
    possible = np.isfinite(two_circles(u)).all(axis=1)
    first = int(np.argmin(possible))
    assert 0 < first < 10
    assert (solution.status[:first] == SampleStatus.OK).all()
    assert (solution.status[~possible] == SampleStatus.UNREACHABLE).all()
    assert (solution.residual[~possible] > 1e-6).all()
    # back within reach: above or below, nobody knows
    again = possible & (np.arange(len(u)) > first)
    assert again.any()
    assert (solution.status[again] == SampleStatus.BRANCH_LOST).all()
    assert np.isnan(solution.x[first:]).all()
    assert not solution.known[first:].any()


def test_stretched_distal_links_are_singular(five_bar: rp.Robot) -> None:
    # elbows a metre apart on a level line: cos u = −0.5 and 0.5
    u = np.array([[1.9, np.pi - 1.9], [2 * np.pi / 3, np.pi / 3]])
    solution = rp.forward_kinematics(five_bar, u, rates=np.ones((2, 2)))
    assert solution.status.tolist() == [SampleStatus.OK, SampleStatus.TYPE_II]
    assert solution.margin[1] == 0.0
    assert np.abs(solution.x[1] - [0.25, LINK * np.sqrt(0.75)]).max() < 1e-5  # a square root of the closure tolerance
    assert np.isnan(solution.xd[1]).all()
    with pytest.raises(SingularPoseError, match="start is a type II"):
        rp.forward_kinematics(five_bar, u, start=solution.q[1])


def test_joint_range_of_a_passive_joint(five_bar: rp.Robot) -> None:
    t = np.linspace(0.0, 3.0, 31)
    u = turning(t)[0]
    free = rp.forward_kinematics(five_bar, u)
    joint = five_bar.model.getJointId("elbow_2")
    elbow = free.q[:, five_bar.model.joints[joint].idx_q]
    limit = float(np.median(elbow))
    limited = rp.forward_kinematics(rp.with_limits(five_bar, {"elbow_2": {"upper": limit}}), u)
    assert ((limited.status == SampleStatus.OUT_OF_RANGE) == (elbow > limit + 1e-9)).all()
    assert limited.known.all()
    assert (limited.x == free.x).all()
    assert np.abs(limited.excess[:, joint - 1] - (elbow - limit)).max() < TOLERANCE


def three_circles(robot: rp.Robot, u: Array) -> Array:
    """Return (M, 3) all x, y, α of a 3-RRR with motor angles (3,): a scan over α, roots refined.

    The platform's corners lie on circles of radius 1 m about the elbows. Differences of the three equations are linear
    in x, y; put into the first they leave a function of α.
    """
    model, data = robot.model, robot.model.createData()
    pin.framesForwardKinematics(model, data, np.array(robot.q_reference))
    hinges = np.array([data.oMi[model.getJointId(f"base_{i}")].translation[:2] for i in (1, 2, 3)])
    middle = data.oMf[model.getFrameId("platform")]
    corners = np.array([middle.actInv(data.oMf[model.getFrameId(f"corner_{i}")]).translation[:2] for i in (2, 3)])
    corners = np.concatenate([-corners.sum(axis=0)[None], corners])  # an equilateral triangle about its middle
    elbows = hinges + np.stack([np.cos(u), np.sin(u)], axis=1)

    def position(alpha: Array) -> tuple[Array, Array]:
        points = np.exp(1j * alpha)[:, None] * (corners[:, 0] + 1j * corners[:, 1])
        turned = np.stack([points.real, points.imag], axis=2)
        k = turned - elbows  # |x + k_i| = 1
        A = 2.0 * (k[:, 1:] - k[:, :1])
        b = (k[:, :1] ** 2).sum(axis=2) - (k[:, 1:] ** 2).sum(axis=2)
        x = np.linalg.solve(A, b[:, :, None])[:, :, 0]
        return x, ((x + k[:, 0]) ** 2).sum(axis=1) - 1.0

    grid = np.linspace(-np.pi, np.pi, 20_001) + 1e-7
    value = position(grid)[1]
    roots = []
    for i in np.flatnonzero(np.sign(value[1:]) != np.sign(value[:-1])):
        root = brentq(lambda alpha: position(np.array([alpha]))[1][0], grid[i], grid[i + 1], xtol=1e-15)
        x, rest = position(np.array([root]))
        if abs(rest[0]) < 1e-6:  # not a pole
            roots.append([*x[0], root])
    return np.array(roots)


def test_all_assembly_modes_of_the_3rrr() -> None:
    robot = zoo.robot_of("3rrr", platform_radius=0.9)
    home, counts = motors(robot, robot.q_reference), set()
    for turn in ([0.3, -0.5, -0.9], [-0.5, 0.8, -0.9], [-0.8, 0.3, 0.9]):
        u = home + np.array(turn)
        oracle = three_circles(robot, u)
        counts.add(len(oracle))
        if not len(oracle):
            with pytest.raises(UnreachablePoseError, match="stay open"):
                rp.assembly_modes(robot, u, most_starts=128)
            continue
        modes = rp.assembly_modes(robot, u)
        assert len(modes) == len(oracle)
        x = np.array(modes.x)
        x[:, 2] = (x[:, 2] + np.pi) % (2 * np.pi) - np.pi
        assert np.abs(x[np.argsort(x[:, 2])] - oracle[np.argsort(oracle[:, 2])]).max() < 1e-9
        assert modes.unseen < 0.01
    assert counts == {0, 4, 6}


@pytest.mark.long
def test_gough_modes_have_their_leg_lengths_and_come_in_mirror_images() -> None:
    robot = zoo.robot_of("gough")
    u = motors(robot, robot.q_reference) + np.linspace(0.0, 0.15, 6)
    modes = rp.assembly_modes(robot, u)
    assert 2 <= len(modes) <= 40
    assert max(np.abs(zoo.leg_lengths(robot, pose) - u).max() for pose in modes.x) < TOLERANCE
    # base and platform are flat: with p also diag(1, 1, −1) p, R diag(1, 1, −1) R diag(1, 1, −1)
    mirror = np.diag([1.0, 1.0, -1.0])
    for pose in modes.x:
        image = np.eye(4)
        image[:3, 3], image[:3, :3] = mirror @ pose[:3, 3], mirror @ pose[:3, :3] @ mirror
        assert np.abs(modes.x - image).max(axis=(1, 2)).min() < 1e-9


def test_gough_forwards_is_its_inverse_backwards() -> None:
    robot = zoo.robot_of("gough")
    motion = zoo.smooth_motion(robot, 3).at(np.linspace(0.0, 1.0, 9))
    tree = rp.inverse_kinematics(robot, motion)
    u, ud, udd = (part[:, robot.actuated_velocity] for part in (tree.q, tree.v, tree.a))
    solution = rp.forward_kinematics(robot, u, rates=ud, accelerations=udd)
    lengths = np.array([zoo.leg_lengths(robot, pose) for pose in solution.x])
    assert np.abs(lengths - u).max() < TOLERANCE
    assert np.abs(solution.x - motion.x).max() < TOLERANCE
    assert np.abs(solution.xd - motion.xd).max() < 1e-9
    assert np.abs(solution.xdd - motion.xdd).max() < 1e-8
    assert np.abs(np.einsum("nij,nkj->nik", solution.jacobian, tree.W) - np.eye(6)).max() < 1e-9  # W = J⁻ᵀ


def test_a_branch_that_ends_between_far_samples_is_lost(five_bar: rp.Robot) -> None:
    """The motors go straight to a single sample far away; where they cannot in between, nothing is known behind."""
    home = motors(five_bar, five_bar.q_reference)
    for goal, whole in (((1.24, -2.49), False), ((4.33, 2.34), False), ((2.0, -2.51), False), ((3.2, 2.9), True)):
        way = two_circles(home + np.linspace(0.0, 1.0, 2001)[:, None] * (goal - home))
        assert np.isfinite(way[-1]).all()
        assert np.isfinite(way).all() == whole
        solution = rp.forward_kinematics(five_bar, goal)
        assert solution.status_labels[0] == ("ok" if whole else "branch_lost")
        assert not whole or np.abs(solution.x[0] - way[-1]).max() < TOLERANCE


def test_redundant_motors_must_agree(five_bar: rp.Robot) -> None:
    robot = zoo.driven_by(five_bar, *five_bar.actuated, "elbow_1")
    positions = rp.forward_kinematics(five_bar, turning(np.linspace(0.0, 1.0, 5))[0])
    u = np.array(positions.q[:, robot.actuated_velocity])
    solution = rp.forward_kinematics(robot, u)
    assert solution.known.all()
    assert np.abs(solution.x - positions.x).max() < TOLERANCE
    u[2, 2] += 1e-3
    solution = rp.forward_kinematics(robot, u)
    assert solution.status.tolist() == [0, 0, SampleStatus.UNREACHABLE, 0, 0]
    assert solution.residual[2] > 1e-4
    assert np.isnan(solution.x[2]).all()
    assert np.isfinite(solution.x[3:]).all()


@pytest.mark.parametrize("end", [(0.25, 0.1), (0.3, -0.4), (-0.1, -0.4)])
def test_redundant_motors_lead_through_singularities_of_some_of_them(five_bar: rp.Robot, end: Pair) -> None:
    """Those on the base alone lose the platform on the way, or take it elsewhere; all three never do."""
    robot = zoo.driven_by(five_bar, *five_bar.actuated, "elbow_1")
    motion = rp.trajectory.from_points([(0.25, 0.75), end], speed=0.5).sample(0.02)
    tree = rp.inverse_kinematics(robot, motion)  # from the platform to the joints nothing is singular
    u, ud, udd = (np.array(part)[:, robot.actuated_velocity] for part in (tree.q, tree.v, tree.a))
    alone = rp.forward_kinematics(five_bar, u[:, :2])
    assert not (np.abs(alone.x - motion.x) < 0.01).all()
    solution = rp.forward_kinematics(robot, u, rates=ud, accelerations=udd)
    assert solution.known.all()
    assert np.abs(solution.x - motion.x).max() < TOLERANCE
    assert np.abs(solution.xd - motion.xd).max() < 1e-10
    assert np.abs(solution.xdd - motion.xdd).max() < 1e-9
    through = np.einsum("nij,nj->ni", solution.jacobian, ud)
    assert np.abs(through - motion.xd).max() < 1e-10


def test_angles_of_the_platform_count_the_turns_between_far_samples_and_from_call_to_call() -> None:
    model = pin.Model()
    for parent, (name, place) in enumerate((("base", 0.0), ("wrist", 0.4))):
        zoo.add_body(model, parent, pin.JointModelRZ(), place, 0.0, name)
    model.addBodyFrame("tip", 2, pin.SE3.Identity(), 0)
    robot = rp.robot_from_model(
        model,
        actuated=["base", "wrist"],
        closures=[],
        independent={"platform": "tip", "axes": ["x", "rz"]},
        reference={"platform": [0.4 * np.cos(0.8), 0.9], "guess": {"base": 0.8, "wrist": 0.1}},
    )
    u = np.array([[1.3, 3.0], [1.3, 9.5], [1.1, -4.0]])
    solution = rp.forward_kinematics(robot, u)
    assert solution.status_labels.tolist() == ["ok"] * 3
    assert np.abs(solution.x[:, 1] - u.sum(axis=1)).max() < TOLERANCE
    again = rp.forward_kinematics(robot, u[2], start=solution.q[1])
    assert np.abs(again.x[0, 1] - u[2].sum()) < TOLERANCE


def test_thousands_of_turns_of_one_motor_take_no_longer_than_three() -> None:
    """Against small steps over all turns, and by the period of the linkage."""
    robot = zoo.robot_of("four_bar")
    home = motors(robot, robot.q_reference)
    wanted = home + np.array([0.3, 10.2 * np.pi, 9.0 * np.pi, -5.5 * np.pi])[:, None]
    far = rp.forward_kinematics(robot, wanted, rates=np.ones((4, 1)))
    small = np.concatenate([np.linspace(a, b, 100)[1:] for a, b in zip([home, *wanted], wanted, strict=False)])
    step = rp.forward_kinematics(robot, small, rates=np.ones(small.shape))
    at = [98, 197, 296, 395]
    np.testing.assert_allclose(far.q, step.q[at], atol=1e-9)
    np.testing.assert_allclose(far.x, wanted, atol=1e-9)
    np.testing.assert_allclose(far.jacobian, step.jacobian[at], atol=1e-9)
    assert (far.status == step.status[at]).all()
    many = rp.forward_kinematics(robot, home + 2e4 * np.pi + 0.3)
    np.testing.assert_allclose(many.q[0, 1:] - far.q[0, 1:], 0.0, atol=1e-9)  # coupler and rocker swing
    assert many.q[0, 0] == pytest.approx(home[0] + 2e4 * np.pi + 0.3, abs=1e-9)
    assert many.status_labels.tolist() == ["out_of_range"]


@pytest.mark.parametrize(("most", "attempts"), [(None, 512), (1, 128), (128, 128), (129, 256), (3000, 512)])
def test_motors_that_no_configuration_has_are_given_up(five_bar: rp.Robot, most: int | None, attempts: int) -> None:
    """The proximal links point away from each other: 1.5 m are left for two distal links of 0.5 m."""
    given = {} if most is None else {"most_starts": most}
    with pytest.raises(UnreachablePoseError, match=f"m in {attempts} attempts") as caught:
        rp.assembly_modes(five_bar, np.array([np.pi, 0.0]), **given)
    # with residuals of g, motors are off by g over the length, and a tip by no more than root 2 of g
    length = five_bar.characteristic_length
    least = brentq(lambda g: 0.5 + np.cos(g / length) - (1.0 + np.sqrt(2.0) * g), 0.0, 0.5)
    assert least < caught.value.details["residual"] < 0.51


def test_modes_are_said_with_their_ranges_margins_and_hits(five_bar: rp.Robot) -> None:
    """Two points of two circles; a range of an elbow that one of them is out of."""
    u = np.array([2.0, 1.0])
    modes = rp.assembly_modes(five_bar, u)
    motors = [zoo.index(five_bar, name) for name in five_bar.actuated]
    np.testing.assert_allclose(modes.q[:, motors], np.tile(u, (2, 1)), atol=1e-9)
    tips = np.array([[0.5 * np.cos(2.0), 0.5 * np.sin(2.0)], [0.5 + 0.5 * np.cos(1.0), 0.5 * np.sin(1.0)]])
    for q, x in zip(modes.q, modes.x, strict=True):
        np.testing.assert_allclose(np.linalg.norm(x - tips, axis=1), 0.5, atol=1e-9)
        assert (np.abs(q) <= np.pi).all()
    reference = np.array(five_bar.q_reference)
    assert np.abs(modes.q[0] - reference).sum() < np.abs(modes.q[1] - reference).sum()
    assert modes.in_range.all()
    assert (modes.margin > 0.0).all()
    # both come from as many starts, within what chance allows: three deviations of a fair coin
    assert abs(modes.hits[0] - modes.hits[1]) < 3.0 * np.sqrt(modes.hits.sum())
    assert modes.hits.min() >= 6
    elbow = next(str(name) for name in five_bar.model.names if str(name).startswith("elbow"))
    at = zoo.index(five_bar, elbow)
    low, high = sorted(modes.q[:, at])
    narrow = rp.with_limits(five_bar, {elbow: {"lower": 0.5 * (low + high), "upper": high + 0.1}})
    again = rp.assembly_modes(narrow, u)
    assert again.in_range.tolist() == (again.q[:, at] > 0.5 * (low + high)).tolist()
    assert sorted(again.in_range) == [False, True]


def test_motors_robots_and_searches_of_no_sense_are_refused(five_bar: rp.Robot) -> None:
    home, wrong = motors(five_bar, five_bar.q_reference), ("x", [[1, 2], [3]], [1.0], 10**400, [np.nan, 0.0])
    for given, message in (
        ({"start": np.array(five_bar.q_reference) + 0.1}, "of start is not closed"),
        ({"actuated": [[2.0]]}, "actuated has shape"),
        ({"actuated": [1e4 * np.pi, 1.0]}, "whole turns between samples"),
        ({"actuated": [1.0, -2e6 * np.pi]}, "whole turns between samples"),
        ({"actuated": [0.0, 1e15]}, "where in a turn"),
        ({"actuated": [0.0, -1e90]}, "where in a turn"),
        *(({name: value}, None) for name in ("actuated", "rates") for value in wrong),
    ):
        with pytest.raises(InputError, match=message):
            rp.forward_kinematics(five_bar, **{"actuated": home, **given})
    with pytest.raises(UnsupportedRobotError, match="1 main actuators and 2 freedoms"):
        rp.forward_kinematics(replace(five_bar, actuated=five_bar.actuated[:1]), home[:1])
    with pytest.raises(InputError):
        rp.assembly_modes(five_bar, np.ones(2), most_starts="x")


@pytest.mark.parametrize("angle", [0.0, 1e-3])
def test_where_all_links_are_in_a_line_the_motors_are_singular_and_the_platform_is_known(angle: float) -> None:
    """Motors at the same angle: the distal links are in a line. At zero with the proximal ones: closures lose rank."""
    robot = zoo.robot_of("five_bar", base_distance=2.0, proximal_length=1.0, distal_length=1.0)
    solution = rp.forward_kinematics(robot, [[0.0, 1.0], [-0.1, 0.3], [angle, angle], [0.02, 0.02]])
    assert solution.status_labels.tolist() == ["ok", "ok", "type_ii", "type_ii"]
    assert solution.margin[2:].tolist() == [0.0, 0.0]
    ends = np.array([angle, 0.02])
    between = np.stack([1.0 + np.cos(ends), np.sin(ends)], axis=1)  # of the elbows, 2 m apart
    np.testing.assert_allclose(solution.x[2:], between, atol=np.sqrt(TOLERANCE))  # a double root
