"""Motions that cannot be lifted: out of reach, singular, out of the working mode; raised, or marked."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import zoo

from redundancy_pin import PlatformMotion, load_robot
from redundancy_pin.arrays import CLOSURE_TOLERANCE
from redundancy_pin.errors import SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics import inverse_kinematics as kinematics
from redundancy_pin.kinematics.assembly import Assembly, assemble
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import mode_indicator
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.robot import Robot

REACH = np.sqrt(1.0 - 0.25**2)
"""Height on the axis of symmetry at which both legs of the five-bar are stretched: 1 m legs, hinges 0.5 m apart."""


def along(x: np.ndarray) -> PlatformMotion:
    """Return poses (N, n) as a motion that stands still in each: only positions matter here."""
    return PlatformMotion(0.01 * np.arange(len(x)), x, np.zeros_like(x), np.zeros_like(x))


def line(start: list[float], end: list[float], samples: int) -> PlatformMotion:
    return along(np.linspace(start, end, samples))


def out_and_back(samples: int = 101) -> tuple[PlatformMotion, np.ndarray]:
    """Return a motion of the five-bar up its axis, out of reach and back, and which samples are within reach."""
    height = 0.76 + 0.6 * np.sin(np.linspace(0.0, np.pi, samples))
    return along(np.stack([np.full(samples, 0.25), height], axis=1)), height < REACH


# --- out of reach ---


def test_out_of_reach_in_the_middle_is_raised_with_sample_and_gap() -> None:
    motion, within = out_and_back()
    first = int(np.argmin(within))
    with pytest.raises(UnreachablePoseError, match=f"sample {first} ") as caught:
        inverse_kinematics(zoo.robot_of("five_bar"), motion)
    assert caught.value.details["sample"] == first
    excess = motion.x[first, 1] - REACH
    # legs at 14.5° to the axis: the shortage along it, shared by the rows of closure and target
    assert 0.3 * excess < caught.value.details["gap"] < 1.1 * excess
    assert "inside the workspace" in caught.value.remedy


def test_out_of_reach_in_the_middle_is_marked_and_right_again_behind() -> None:
    robot = zoo.robot_of("five_bar")
    motion, within = out_and_back()
    tree = inverse_kinematics(robot, motion, mark_unreachable=True)
    np.testing.assert_array_equal(tree.reachable, within)
    for array in (tree.q, tree.v, tree.a, tree.gamma, tree.W):
        flat = array.reshape(len(motion), -1)
        assert np.isnan(flat[~within]).all()
        assert np.isfinite(flat[within]).all()
    assert np.all(tree.gap[~within] > 0.1 * (motion.x[~within, 1] - REACH))
    # the path returns on itself: so do the configurations
    np.testing.assert_allclose(tree.q[within], tree.q[::-1][within], atol=1e-7)


@pytest.mark.parametrize("hidden", [1, 5, 20])
@pytest.mark.parametrize("found", [True, False])
def test_samples_behind_a_gap_that_newton_misses_are_followed_back_to(
    hidden: int, found: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of the samples behind the gap the first are hidden from Newton's method, or all; multistart then has the rest."""
    motion, within = out_and_back()

    def blind(system: ConstraintSystem, guess: np.ndarray, target: np.ndarray, **rest: float) -> Assembly:
        solved = assemble(system, guess, target, **rest)  # type: ignore[arg-type]
        if len(target) == 1:
            return solved
        result = replace(solved)
        vars(result)["in_mode"] = solved.in_mode & (np.cumsum(solved.closed) > hidden) & found
        return result

    monkeypatch.setattr(kinematics, "assemble", blind)
    tree = inverse_kinematics(zoo.robot_of("five_bar"), motion, mark_unreachable=True)
    np.testing.assert_array_equal(tree.reachable, within)
    np.testing.assert_allclose(tree.q[within], tree.q[::-1][within], atol=1e-7)


@pytest.mark.long_for("3001")
@pytest.mark.parametrize("samples", [61, 3001])
def test_marked_motion_may_come_back_elsewhere(samples: int) -> None:
    """Out over the top on the left, in again on the right: far from the last good configuration."""
    robot = zoo.robot_of("five_bar")
    angle = np.linspace(np.pi, 0.0, samples)
    x = np.array([0.25, 0.45]) + np.stack([0.45 * np.cos(angle), 0.75 * np.sin(angle)], axis=1)
    within = (np.linalg.norm(x, axis=1) < 1.0) & (np.linalg.norm(x - [0.5, 0.0], axis=1) < 1.0)
    assert samples / 12 < np.argmin(within) < np.flatnonzero(~within)[-1] < samples * 11 / 12
    tree = inverse_kinematics(robot, along(x), mark_unreachable=True)
    np.testing.assert_array_equal(tree.reachable, within)


@pytest.mark.long
def test_a_marked_motion_may_start_out_of_reach() -> None:
    robot = zoo.robot_of("five_bar")
    motion = line([0.25, 2.0], [0.25, 0.5], 301)
    within = motion.x[:, 1] < REACH
    tree = inverse_kinematics(robot, motion, mark_unreachable=True)
    np.testing.assert_array_equal(tree.reachable, within)
    expected = inverse_kinematics(robot, motion[int(np.argmax(within)) :])
    np.testing.assert_allclose(tree.q[within], expected.q, atol=1e-7)
    with pytest.raises(UnreachablePoseError, match="sample 0"):
        inverse_kinematics(robot, motion)


@pytest.mark.long
def test_a_motion_out_of_reach_throughout_is_marked_throughout() -> None:
    tree = inverse_kinematics(zoo.robot_of("five_bar"), line([3.0, 3.0], [4.0, 3.0], 20), mark_unreachable=True)
    assert not tree.reachable.any()
    assert np.isnan(tree.q).all()
    # the nearest the end of a 1 m leg comes to the nearest of the poses, shared by four rows
    assert tree.gap.min() > (np.hypot(3.0, 3.0) - 1.0) / (2 * np.sqrt(2))


# --- type I singularities ---


@pytest.mark.long_for("2-1e-06", "50-1e-06", "50-1e-09")
@pytest.mark.parametrize("left", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("samples", [2, 50])
def test_the_branch_is_kept_next_to_full_stretch(left: float, samples: int) -> None:
    robot = zoo.robot_of("five_bar")
    tree = inverse_kinematics(robot, line([0.25, 0.76], [0.25, REACH - left], samples))
    # the law of cosines at the elbow of two 0.5 m links: sin² of half the elbow angle is 1 − ρ²
    rho = np.hypot(0.25, tree.motion.x[:, 1])
    elbow = 2 * np.arcsin(np.sqrt(np.maximum(1 - rho**2, 0.0)))
    index = zoo.index(robot, "elbow_1")
    np.testing.assert_allclose(tree.q[:, index], -elbow, atol=CLOSURE_TOLERANCE / np.sqrt(left))


@pytest.mark.long_for("1", "2")
@pytest.mark.parametrize("samples", [1, 2, 50])
def test_full_stretch_itself_is_a_type_i_singularity(samples: int) -> None:
    robot = zoo.robot_of("five_bar")
    motion = line([0.25, 0.76], [0.25, REACH], samples) if samples > 1 else along(np.array([[0.25, REACH]]))
    with pytest.raises(SingularPoseError, match="type I") as caught:
        inverse_kinematics(robot, motion)
    assert caught.value.details["sample"] == samples - 1
    tree = inverse_kinematics(robot, motion, mark_unreachable=True)
    assert not tree.reachable[-1]
    assert tree.reachable[:-1].all()
    assert np.isnan(tree.W[-1]).all()


def test_a_start_at_a_type_i_singularity_is_named_or_marked() -> None:
    robot = zoo.robot_of("2rpr")
    motion = line([0.0, 0.0], [0.1, 0.2], 20)
    with pytest.raises(SingularPoseError, match="sample 0") as caught:
        inverse_kinematics(robot, motion)
    assert caught.value.details["sample"] == 0
    tree = inverse_kinematics(robot, motion, mark_unreachable=True)
    np.testing.assert_array_equal(tree.reachable, np.arange(20) > 0)


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


def test_a_leg_through_its_base_hinge_leaves_the_mode_and_is_named() -> None:
    motion = line([0.1, 0.2], [-0.1, -0.2], 20)  # no sample at the hinge itself
    with pytest.raises(WorkingModeError, match=r"leg 1 \(slide_1\)") as caught:
        inverse_kinematics(zoo.robot_of("2rpr"), motion)
    assert caught.value.details["leg"] == 1
    assert caught.value.details["sample"] == 10
    assert "working mode ++" in caught.value.message


@pytest.mark.long_for("20")
@pytest.mark.parametrize("samples", [20, 21])
def test_a_leg_through_its_base_hinge_is_marked_and_taken_up_in_the_mode(samples: int) -> None:
    """Of 21 samples one is at the hinge, of 20 none: behind it the branch has d < 0, the mode has d > 0."""
    robot = zoo.robot_of("2rpr")
    motion = line([0.1, 0.2], [-0.1, -0.2], samples)
    tree = inverse_kinematics(robot, motion, mark_unreachable=True)
    length = np.linalg.norm(motion.x, axis=1)
    away = length > 1e-9
    assert np.count_nonzero(tree.reachable != away) <= 1  # the change over itself may be marked too
    slide = zoo.index(robot, "slide_1")
    np.testing.assert_allclose(tree.q[tree.reachable, slide], length[tree.reachable], atol=1e-10)


def test_samples_before_the_first_one_found_are_followed_back() -> None:
    """Found at the far end only, the motion is followed back past the base hinge, around which the leg turns."""
    robot = zoo.robot_of("2rpr")
    motion = line([0.101, 0.2], [-0.099, -0.2], 21)
    expected = inverse_kinematics(robot, motion)
    turned = line([-0.099, -0.2], [0.101, 0.2], 21)
    back = inverse_kinematics(robot, turned, start=expected.state(20), mark_unreachable=True)
    assert back.reachable.all()
    np.testing.assert_allclose(back.q[::-1], expected.q, atol=1e-9)


def test_the_four_bars_crossed_mode_is_not_left_for_the_open_one() -> None:
    """Loaded crossed and turned once around: the Grashof four-bar stays crossed all the way."""
    robot = load_robot("four_bar", working_mode=(-1,))
    tree = inverse_kinematics(robot, along(np.linspace(1.0, 1.0 + 2 * np.pi, 50)[:, None]))
    assert np.all(mode_indicator(robot, tree.q) < 0.0)


def test_a_crank_that_cannot_go_round_stops_where_the_coupler_stretches() -> None:
    """A four-bar that is no Grashof chain: the law of cosines gives the crank angle at which it ends."""
    robot = load_robot("four_bar", crank_length=0.3, coupler_length=0.2, rocker_length=0.25)
    with pytest.raises((UnreachablePoseError, WorkingModeError)) as caught:
        inverse_kinematics(robot, along(np.linspace(1.0, np.pi, 40)[:, None]))
    limit = np.arccos((0.4**2 + 0.3**2 - 0.45**2) / (2 * 0.4 * 0.3))
    assert caught.value.details["sample"] == int(np.argmax(np.linspace(1.0, np.pi, 40) > limit))


@pytest.mark.long_for("five_bar")
@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar"])
def test_random_poses_are_closed_or_refused_never_wrong(name: str) -> None:
    """A far-flung set of poses, marked: each is either in the mode and closed, or NaN with a reason."""
    robot: Robot = zoo.robot_of(name)
    rng = np.random.default_rng(7)
    x = zoo.home_of(robot) + rng.uniform(-0.8, 0.8, (25, robot.n)) * robot.characteristic_length
    tree = inverse_kinematics(robot, along(x), mark_unreachable=True)
    good = tree.reachable
    assert good.sum() > 6
    assert np.all(tree.gap[good] < CLOSURE_TOLERANCE)
    assert np.all(mode_indicator(robot, tree.q[good]) * np.array(robot.working_mode) > 0.0)
    for k in np.flatnonzero(~good)[:1]:
        with pytest.raises((UnreachablePoseError, WorkingModeError, SingularPoseError)):
            inverse_kinematics(robot, along(x[k : k + 1]))
