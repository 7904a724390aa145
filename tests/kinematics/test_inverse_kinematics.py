"""Inverse kinematics: q, v, a along platform motions, judged by finite differences, Pinocchio and denser samples."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import zoo
from examples import examples
from folding import folding_four_bar
from hypothesis import given
from hypothesis import strategies as st
from spatial_chains import CHAINS, chain_of

from redundancy_pin import PlatformMotion, load_robot
from redundancy_pin.arrays import CLOSURE_TOLERANCE
from redundancy_pin.errors import SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.assembly import configuration_difference
from redundancy_pin.kinematics.coordinates import mode_indicator, working_modes
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.robot import Robot
from redundancy_pin.robot.types import WorkingModes

STEP = 1e-5
VELOCITY = 2e-8  # central differences: STEP² times third derivatives of 10², and the closure tolerance over STEP
ACCELERATION = 1e-6  # the same on v, whose third derivatives reach 10⁴


@pytest.mark.parametrize("name", [*zoo.SHIPPED, *CHAINS])
@examples(2)
@given(seed=st.integers(0, 2**16))
def test_velocity_and_acceleration_are_derivatives(name: str, seed: int) -> None:
    robot = chain_of(name) if name in CHAINS else zoo.robot_of(name)
    motion = zoo.smooth_motion(robot, seed)
    t = np.linspace(0.0, 1.0, 6)
    tree, after, before = (inverse_kinematics(robot, motion.at(t + shift)) for shift in (0.0, STEP, -STEP))
    rate = configuration_difference(robot.model, before.q, after.q) / (2 * STEP)
    np.testing.assert_allclose(tree.v, rate, atol=VELOCITY)
    np.testing.assert_allclose(tree.a, (after.v - before.v) / (2 * STEP), atol=ACCELERATION)
    np.testing.assert_allclose(
        np.einsum("nim,ni->nm", tree.W, tree.motion.xd), tree.v[:, robot.actuated_velocity], atol=1e-13
    )
    assert np.all(tree.v[:, robot.carrier_velocity] == 0.0)
    assert np.all(tree.a[:, robot.carrier_velocity] == 0.0)


def pinocchio_gap(robot: Robot, q: np.ndarray) -> float:
    """Return the largest distance of the frames of a point or pin closure, by Pinocchio (all shipped ones are such)."""
    data = robot.model.createData()
    worst = 0.0
    for configuration in q:
        pin.framesForwardKinematics(robot.model, data, configuration)
        for closure in robot.closures:
            a, b = (data.oMf[robot.model.getFrameId(name)].translation for name in (closure.frame_a, closure.frame_b))
            worst = max(worst, float(np.abs(a - b).max()))
    return worst


def test_any_sampling_gives_the_same_closed_configurations(shipped: Robot) -> None:
    """Of a large motion: the way between few samples is followed all the same, as it is beside nanoseconds."""
    motion = zoo.smooth_motion(shipped, 8, scale=2.0)
    base = np.linspace(0.0, 3.0, 10)
    dense = inverse_kinematics(shipped, motion.at(np.linspace(0.0, 3.0, 901)))
    assert dense.reachable.all()
    assert np.abs(np.diff(dense.q[::100], axis=0)).max() > 0.05
    assert dense.residual.max() < CLOSURE_TOLERANCE
    assert pinocchio_gap(shipped, dense.q[::10]) < CLOSURE_TOLERANCE
    clusters = np.sort(np.concatenate([base, base + 1e-9, base + 2e-9]))
    for times, kept in ((base, slice(None)), (clusters, slice(None, None, 3)), (base[4:5], slice(None))):
        other = inverse_kinematics(shipped, motion.at(times))
        expected = slice(None, None, 100) if len(times) > 1 else slice(400, 401)
        turned = configuration_difference(shipped.model, dense.q[expected], other.q[kept])
        np.testing.assert_allclose(np.sin(turned) if len(times) == 1 else turned, 0.0, atol=1e-9)
        np.testing.assert_allclose(other.a[kept], dense.a[expected], rtol=1e-8, atol=1e-8)
    assert not any(array.flags.writeable for array in vars(dense).values() if isinstance(array, np.ndarray))


def test_the_platform_is_where_the_motion_says(shipped: Robot) -> None:
    if shipped.platform is None:
        pytest.skip("no platform")
    motion = zoo.smooth_motion(shipped, 6).at(np.linspace(0.0, 1.0, 9))
    tree = inverse_kinematics(shipped, motion)
    data, frame = shipped.model.createData(), shipped.model.getFrameId(shipped.platform.frame)
    for k in range(len(motion)):
        pin.forwardKinematics(shipped.model, data, tree.q[k], tree.v[k], tree.a[k])
        placement = pin.updateFramePlacement(shipped.model, data, frame)
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        twist = pin.getFrameVelocity(shipped.model, data, frame, world).vector
        rate = pin.getFrameClassicalAcceleration(shipped.model, data, frame, world).vector
        if motion.is_pose:
            np.testing.assert_allclose(placement.homogeneous, motion.x[k], atol=CLOSURE_TOLERANCE)
            rows = np.arange(6)
        else:
            np.testing.assert_allclose(placement.translation[:2], motion.x[k, :2], atol=CLOSURE_TOLERANCE)
            rows = np.array([0, 1, 5])[: shipped.n]
        np.testing.assert_allclose(twist[rows], motion.xd[k], atol=1e-10)
        np.testing.assert_allclose(rate[rows], motion.xdd[k], atol=1e-9)


def test_two_sided_samples_differ_in_acceleration_only(shipped: Robot) -> None:
    motion = zoo.smooth_motion(shipped, 12).at(np.linspace(0.0, 1.0, 9))
    order = np.array([0, 1, 2, 3, 4, 4, 5, 6, 7, 8])
    jumped = motion.xdd[order].copy()
    jumped[5] += 1.0
    tree = inverse_kinematics(shipped, PlatformMotion(motion.t[order], motion.x[order], motion.xd[order], jumped))
    np.testing.assert_allclose(tree.q[4], tree.q[5], atol=1e-12)
    np.testing.assert_allclose(tree.v[4], tree.v[5], atol=1e-10)
    jump = np.einsum("vi,i->v", tree.gamma[4], np.ones(shipped.n))
    np.testing.assert_allclose(tree.a[5] - tree.a[4], jump, atol=1e-8)


# --- motions out of reach, singular, out of the working mode or of the branch of their start


REACH = np.sqrt(1.0 - 0.25**2)
"""Height on the axis of symmetry at which both legs of the five-bar are stretched: 1 m legs, hinges 0.5 m apart."""


def along(x: np.ndarray) -> PlatformMotion:
    """Return poses (N, n) as a motion that stands still in each: only positions matter here."""
    return PlatformMotion(0.01 * np.arange(len(x)), x, np.zeros_like(x), np.zeros_like(x))


def line(start: list[float], end: list[float], samples: int) -> PlatformMotion:
    return along(np.linspace(start, end, samples))


def out_and_back() -> PlatformMotion:
    """Up the axis of the five-bar, out of reach, and back."""
    height = 0.76 + 0.6 * np.sin(np.linspace(0.0, np.pi, 101))
    return along(np.stack([np.full(101, 0.25), height], axis=1))


def over_the_top() -> PlatformMotion:
    """Out on the left and in again on the right, far from the last good configuration."""
    angle = np.linspace(np.pi, 0.0, 61)
    return along(np.array([0.25, 0.45]) + np.stack([0.45 * np.cos(angle), 0.75 * np.sin(angle)], axis=1))


def down_from_outside() -> PlatformMotion:
    return line([0.25, 1.5], [0.25, 0.5], 101)


# --- out of reach


@pytest.mark.parametrize("motion_of", [out_and_back, over_the_top, down_from_outside])
def test_samples_out_of_reach_are_raised_or_marked_and_the_others_right(
    motion_of: Callable[[], PlatformMotion],
) -> None:
    """Links of half a metre: the law of cosines gives both elbows, the working mode their signs."""
    robot, motion = zoo.robot_of("five_bar"), motion_of()
    length = np.stack([np.linalg.norm(motion.x - hinge, axis=1) for hinge in ([0.0, 0.0], [0.5, 0.0])], axis=1)
    within = (length < 1.0).all(axis=1)
    first, excess = int(np.argmin(within)), length.max(axis=1) - 1.0
    assert 5 < within.sum() < len(motion) - 5
    with pytest.raises(UnreachablePoseError, match=rf"sample {first}\b") as caught:
        inverse_kinematics(robot, motion)
    assert caught.value.details["sample"] == first
    # the shortage is shared by the rows of closure and target: the largest of four is 1 / (2√2) of it at least
    assert excess[first] / (2.0 * np.sqrt(2.0)) < caught.value.details["residual"] < 1.1 * excess[first]
    assert "the workspace" in caught.value.remedy
    tree = inverse_kinematics(robot, motion, mark_unreachable=True)
    np.testing.assert_array_equal(tree.reachable, within)
    for array in (tree.q, tree.v, tree.a, tree.gamma, tree.W):
        flat = array.reshape(len(motion), -1)
        assert np.isnan(flat[~within]).all()
        assert np.isfinite(flat[within]).all()
    assert np.all(tree.residual[~within] > 0.1 * excess[~within])
    elbows = tree.q[within][:, [zoo.index(robot, f"elbow_{leg}") for leg in (1, 2)]]
    np.testing.assert_allclose(np.abs(elbows), 2.0 * np.arccos(length[within]), atol=1e-7)
    assert (mode_indicator(robot, tree.q[within]) * robot.working_mode > 0.0).all()


@pytest.mark.parametrize("far", [1e2, 1e14])
def test_a_pose_beyond_all_reach_is_an_error_and_not_a_burden(far: float) -> None:
    robot, home = zoo.robot_of("five_bar"), [0.25, 0.6]
    with pytest.raises(UnreachablePoseError, match=r"sample 0, x = \[.*open by") as caught:
        inverse_kinematics(robot, along(np.array([[far, 0.0]])))
    assert "workspace" in caught.value.remedy
    # the legs reach one metre from bases half a metre apart: the rest of the way stays open
    assert caught.value.details["residual"] > 0.1 * far
    with pytest.raises(UnreachablePoseError):
        inverse_kinematics(robot, along(np.array([home, [far, 0.0]])))
    marked = inverse_kinematics(robot, along(np.array([home, [far, 0.0], home])), mark_unreachable=True)
    np.testing.assert_array_equal(marked.reachable, [True, False, True])
    nowhere = inverse_kinematics(robot, along(np.array([[far, 0.0], [far, 0.1]])), mark_unreachable=True)
    assert not nowhere.reachable.any()
    assert np.isnan(nowhere.q).all()


# --- type I singularities ---


@pytest.mark.parametrize("modes", [True, False])
@pytest.mark.parametrize("left", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("samples", [3, 30])
def test_the_branch_is_kept_next_to_full_stretch(left: float, samples: int, modes: bool) -> None:
    """Up to full stretch of the first leg and back, also where no mode says where the elbow belongs."""
    robot = zoo.robot_of("five_bar")
    if not modes:
        robot = replace(robot, working_modes=None, working_mode=())
    reach = 1.0 - left - 0.2 * np.abs(np.linspace(-1.0, 1.0, samples))
    motion = along(reach[:, None] * np.array([np.cos(1.2), np.sin(1.2)]))
    # the law of cosines at the elbow of two 0.5 m links: sin² of half the elbow angle is 1 − ρ²
    expected = -2.0 * np.arcsin(np.sqrt(1.0 - reach**2))
    tree = inverse_kinematics(robot, motion, mark_unreachable=not modes)
    elbow, exact = tree.q[tree.reachable, zoo.index(robot, "elbow_1")], CLOSURE_TOLERANCE / np.sqrt(left)
    np.testing.assert_allclose(elbow, expected[tree.reachable], atol=exact)
    assert tree.reachable[[0, -1]].all()
    # so near that branches cannot be told apart without modes, a sample may be refused, not guessed
    assert tree.reachable.all() or (not modes and left < 1e-6)


@pytest.mark.parametrize(
    ("name", "motion", "sample"),
    [
        ("five_bar", line([0.25, 0.76], [0.25, REACH], 50), 49),  # both legs stretched
        ("five_bar", along(np.array([[0.25, REACH]])), 0),
        ("2rpr", line([0.0, 0.0], [0.1, 0.2], 20), 0),  # a leg without length
    ],
)
def test_a_type_i_singularity_is_named_or_marked(name: str, motion: PlatformMotion, sample: int) -> None:
    with pytest.raises(SingularPoseError, match="type I") as caught:
        inverse_kinematics(zoo.robot_of(name), motion)
    assert caught.value.details["sample"] == sample
    tree = inverse_kinematics(zoo.robot_of(name), motion, mark_unreachable=True)
    np.testing.assert_array_equal(tree.reachable, np.arange(len(motion)) != sample)
    assert np.isnan(tree.W[sample]).all()


def test_passing_close_by_a_base_hinge_turns_the_leg_around() -> None:
    robot = zoo.robot_of("2rpr")
    off = np.array([1e-4, 0.0])
    motion = along(np.linspace([0.1, 0.2], [-0.1, -0.2], 21) + off)
    tree = inverse_kinematics(robot, motion)
    slide, swivel = (zoo.index(robot, f"{name}_1") for name in ("slide", "swivel"))
    np.testing.assert_allclose(tree.q[:, slide], np.linalg.norm(motion.x, axis=1), atol=1e-10)
    turned = tree.q[-1, swivel] - tree.q[0, swivel]
    ends = np.arctan2(motion.x[[0, -1], 1], motion.x[[0, -1], 0])
    # right of the hinge the leg turns clockwise, by just less than half a turn
    assert turned == pytest.approx(ends[1] - ends[0], abs=1e-9)


# --- working modes ---


@pytest.mark.parametrize("samples", [20, 21])
def test_a_leg_through_its_base_hinge_is_named_or_marked_and_taken_up_in_the_mode(samples: int) -> None:
    """Of 21 samples one is at the hinge, of 20 none: behind it the branch has d < 0, the mode has d > 0."""
    robot = zoo.robot_of("2rpr")
    motion = line([0.1, 0.2], [-0.1, -0.2], samples)
    if samples == 20:
        with pytest.raises(WorkingModeError, match=r"leg 1 \(slide_1\)") as caught:
            inverse_kinematics(robot, motion)
        assert caught.value.details["leg"] == 1
        assert caught.value.details["sample"] == 10
        assert "working mode ++" in caught.value.message
    tree = inverse_kinematics(robot, motion, mark_unreachable=True)
    length = np.linalg.norm(motion.x, axis=1)
    away = length > 1e-9
    assert np.count_nonzero(tree.reachable != away) <= 1  # the change over itself may be marked too
    assert not tree.reachable.all()  # no branch is changed without a marked sample in between
    slide = zoo.index(robot, "slide_1")
    np.testing.assert_allclose(tree.q[tree.reachable, slide], length[tree.reachable], atol=1e-10)


def test_a_pose_that_closes_only_in_other_working_modes_names_one() -> None:
    """In no assembly of the four-bar is its coupler on one side and its rocker on the other."""
    robot = zoo.robot_of("four_bar")
    modes = WorkingModes(("coupler", "rocker"), (1, 1))
    nowhere = replace(robot, working_modes=modes, working_mode=(1, -1))
    with pytest.raises(WorkingModeError, match=r"only in other working modes than \+- of four_bar, such as") as caught:
        inverse_kinematics(nowhere, along(np.array([[1.5]])))
    assert caught.value.details["sample"] == 0
    assert "working_mode" in caught.value.remedy


def test_samples_before_the_first_one_found_are_followed_back() -> None:
    """Found at the far end only, the motion is followed back past the base hinge, around which the leg turns."""
    robot = zoo.robot_of("2rpr")
    motion = line([0.101, 0.2], [-0.099, -0.2], 21)
    expected = inverse_kinematics(robot, motion)
    turned = line([-0.099, -0.2], [0.101, 0.2], 21)
    back = inverse_kinematics(robot, turned, start=expected.state(20), mark_unreachable=True)
    assert back.reachable.all()
    np.testing.assert_allclose(back.q[::-1], expected.q, atol=1e-9)


def test_a_crank_that_cannot_go_round_stops_where_the_coupler_stretches() -> None:
    """A four-bar that is no Grashof chain: the law of cosines gives the crank angle at which it ends."""
    robot = load_robot("four_bar", crank_length=0.3, coupler_length=0.2, rocker_length=0.25)
    with pytest.raises((UnreachablePoseError, WorkingModeError)) as caught:
        inverse_kinematics(robot, along(np.linspace(1.0, np.pi, 40)[:, None]))
    limit = np.arccos((0.4**2 + 0.3**2 - 0.45**2) / (2 * 0.4 * 0.3))
    with pytest.raises((SingularPoseError, UnreachablePoseError)):  # there rates are infinite
        inverse_kinematics(robot, along(np.linspace(1.0, limit, 51)[:, None]))
    assert caught.value.details["sample"] == int(np.argmax(np.linspace(1.0, np.pi, 40) > limit))


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar"])
def test_random_poses_are_closed_or_refused_never_wrong(name: str) -> None:
    """A far-flung set of poses, marked: each is either in the mode and closed, or NaN with a reason."""
    robot: Robot = zoo.robot_of(name)
    rng = np.random.default_rng(7)
    x = zoo.home_of(robot) + rng.uniform(-0.8, 0.8, (25, robot.n)) * robot.characteristic_length
    tree = inverse_kinematics(robot, along(x), mark_unreachable=True)
    good = tree.reachable
    assert good.sum() > 6
    assert np.all(tree.residual[good] < CLOSURE_TOLERANCE)
    assert np.all(mode_indicator(robot, tree.q[good]) * np.array(robot.working_mode) > 0.0)
    for k in np.flatnonzero(~good)[:1]:
        with pytest.raises((UnreachablePoseError, WorkingModeError, SingularPoseError)):
            inverse_kinematics(robot, along(x[k : k + 1]))


# --- from a point of a branch in place of the reference ---

SAME = 1e-9
FOLDING = (0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5)


def straight(start: np.ndarray, end: np.ndarray, count: int = 7) -> PlatformMotion:
    """A straight way in a second, at an even speed."""
    t = np.linspace(0.0, 1.0, count)
    x = start + t[:, None] * (end - start)
    return PlatformMotion(t, x, np.tile(end - start, (count, 1)), np.zeros((count, len(start))))


@pytest.mark.parametrize("mode", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
@pytest.mark.parametrize("count", [1, 7])
def test_a_motion_stays_in_the_mode_of_its_start(mode: tuple[int, ...], count: int) -> None:
    """Whatever mode the robot was loaded in: it is the motion of the robot of that mode."""
    home = zoo.home_of(zoo.robot_of("five_bar"))
    first, last = home + np.array([0.02, -0.03]), home + np.array([-0.05, 0.04])
    own = zoo.robot_of("five_bar", working_mode=mode)
    expected = inverse_kinematics(own, straight(first, last)[:count])
    start = inverse_kinematics(own, straight(home, first)).state(0)
    for declared in ((1, -1), (-1, 1)):
        found = inverse_kinematics(
            zoo.robot_of("five_bar", working_mode=declared), straight(first, last)[:count], start=start
        )
        assert (np.sign(mode_indicator(own, found.q)) == mode).all()
        for what in ("q", "v", "a", "gamma", "W"):
            np.testing.assert_allclose(getattr(found, what), getattr(expected, what), atol=SAME)


@pytest.mark.parametrize("mark", [False, True])
def test_a_first_sample_behind_a_rank_loss_is_on_the_branch_of_the_start(mark: bool, tmp_path: Path) -> None:
    """Behind the flat pose the coupler is on its other side, which is another working mode."""
    robot = folding_four_bar(tmp_path, *FOLDING, modes=True)
    before, behind = np.array([np.pi - 0.3]), np.array([np.pi + 0.3])
    whole = inverse_kinematics(robot, straight(before, behind + 0.3, 25))
    start = whole.state(0)
    found = inverse_kinematics(robot, straight(behind, behind + 0.3, 5), start=start, mark_unreachable=mark)
    assert found.reachable.all()
    np.testing.assert_allclose(found.q[[0, -1]], whole.q[[16, 24]], atol=SAME)
    assert (mode_indicator(robot, found.q) * mode_indicator(robot, start.q[None]) < 0.0).all()


def test_a_start_at_the_rank_loss_itself_leads_on_in_the_declared_mode_or_the_other(tmp_path: Path) -> None:
    """Flat, the coupler is on neither side: the branch is that of the tangent of the start."""
    robot = folding_four_bar(tmp_path, *FOLDING, modes=True)
    flat = np.array([np.pi])
    start = inverse_kinematics(robot, straight(flat - 0.3, flat, 7)).state(-1)
    assert np.abs(mode_indicator(robot, start.q[None])).max() < 1e-9
    back = inverse_kinematics(robot, straight(flat - 0.1, flat - 0.3, 5), start=start)
    assert (mode_indicator(robot, back.q) > 0.0).all()
    np.testing.assert_allclose(
        back.q[-1], inverse_kinematics(robot, straight(flat - 0.3, flat - 0.1, 5)).q[0], atol=SAME
    )


def test_what_is_not_on_the_branch_of_the_start_is_refused() -> None:
    """Out of reach by a gap; or in reach, beyond a stretched leg: nothing is looked for elsewhere."""
    robot = load_robot("five_bar", proximal_length=0.65, distal_length=0.45)
    home = zoo.home_of(robot)
    start = inverse_kinematics(robot, straight(home, home + 0.01)).state(0)
    far = np.array([0.25, 1.4])
    with pytest.raises(UnreachablePoseError, match=r"The pose of sample 0 \(t = 0 s") as caught:
        inverse_kinematics(robot, straight(far, far + 0.01), start=start)
    # legs of 1.1 m at most, to a point as far from both hinges; each loop is open by its share, along an axis
    assert 0.05 < caught.value.details["residual"] < np.hypot(0.25, 1.4) - 1.0
    # the first leg is no shorter than 0.2 m, and the straight line leads past its hinge at 0.15 m
    beside, other = np.array([-0.15, 0.25]), np.array([-0.15, -0.25])
    start = inverse_kinematics(robot, straight(home, beside)).state(-1)
    with pytest.raises(WorkingModeError, match="cannot be reached continuously from the start") as refused:
        inverse_kinematics(robot, straight(other, other - 0.01), start=start)
    assert refused.value.details["sample"] == 0


def test_columns_of_w_come_in_the_order_of_the_declaration() -> None:
    """Parsa 2014, eq. 2.4: the rows of the 2-RPR's J = Wᵀ are the directions of leg 1, then of leg 2."""
    robot = zoo.robot_of("2rpr")
    assert robot.actuated == ("slide_1", "slide_2")
    tree = inverse_kinematics(robot, zoo.smooth_motion(robot, 9).at(np.linspace(0.0, 1.0, 5)))
    for leg, hinge in enumerate(([0.0, 0.0], [0.5, 0.0])):
        away = tree.motion.x - hinge
        np.testing.assert_allclose(tree.W[:, :, leg], away / np.linalg.norm(away, axis=1)[:, None], atol=1e-12)


@examples(4)
@given(
    mode=st.sampled_from(list(itertools.product((1, -1), repeat=3))),
    radius=st.floats(0.15, 0.35),
    proximal=st.floats(0.8, 1.2),
    distal=st.floats(0.8, 1.2),
)
def test_every_working_mode_of_the_3rrr_is_the_one_asked_for(
    mode: tuple[int, ...], radius: float, proximal: float, distal: float
) -> None:
    robot = load_robot(
        "3rrr", working_mode=mode, platform_radius=radius, proximal_length=proximal, distal_length=distal
    )
    motion = zoo.smooth_motion(robot, 1, scale=0.7).at(np.linspace(0.0, 1.0, 30))
    tree = inverse_kinematics(robot, motion)
    np.testing.assert_array_equal(working_modes(robot, tree.q), np.tile(mode, (30, 1)))
    # Parsa 2014, eq. 2.22: θ = γ + ψ in mode +1, θ = γ − ψ in mode −1
    hinges = [np.zeros(2), np.array([np.sqrt(3), 0.0]), np.array([np.sqrt(3) / 2, 1.5])]
    for leg, hinge in enumerate(hinges):
        phi = motion.x[:, 2] + (np.pi / 6, 5 * np.pi / 6, -np.pi / 2)[leg]
        away = motion.x[:, :2] - radius * np.stack([np.cos(phi), np.sin(phi)], axis=1) - hinge
        rho = np.linalg.norm(away, axis=1)
        psi = np.arccos((proximal**2 + rho**2 - distal**2) / (2 * proximal * rho))
        theta = np.arctan2(away[:, 1], away[:, 0]) + mode[leg] * psi
        column = zoo.index(robot, f"base_{leg + 1}")
        np.testing.assert_allclose(np.sin(tree.q[:, column] - theta), 0.0, atol=1e-9)
        np.testing.assert_allclose(np.cos(tree.q[:, column] - theta), 1.0, atol=1e-9)
