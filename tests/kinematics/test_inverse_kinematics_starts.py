"""Lifting from a point of a branch in place of the reference: in its own working mode, through rank losses, refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zoo
from folding import folding_four_bar

import redundancy_pin as rp
from redundancy_pin.errors import UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.branch import ClosedState
from redundancy_pin.kinematics.coordinates import mode_indicator
from redundancy_pin.kinematics.inverse_kinematics import JointTrajectory, inverse_kinematics

SAME = 1e-9
FOLDING = (0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5)


def point(tree: JointTrajectory, k: int = -1) -> ClosedState:
    return tree.state(k)


def straight(start: np.ndarray, end: np.ndarray, count: int = 7) -> rp.PlatformMotion:
    """A straight way in a second, at an even speed."""
    t = np.linspace(0.0, 1.0, count)
    x = start + t[:, None] * (end - start)
    return rp.PlatformMotion(t, x, np.tile(end - start, (count, 1)), np.zeros((count, len(start))))


@pytest.mark.parametrize("mode", [(1, 1), (1, -1), (-1, 1), (-1, -1)])
@pytest.mark.parametrize("count", [1, 7])
def test_a_motion_stays_in_the_mode_of_its_start(mode: tuple[int, ...], count: int) -> None:
    """Whatever mode the robot was loaded in: it is the motion of the robot of that mode."""
    home = zoo.home_of(zoo.robot_of("five_bar"))
    first, last = home + np.array([0.02, -0.03]), home + np.array([-0.05, 0.04])
    own = zoo.robot_of("five_bar", working_mode=mode)
    expected = inverse_kinematics(own, straight(first, last)[:count])
    start = point(inverse_kinematics(own, straight(home, first)), 0)
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
    start = point(whole, 0)
    found = inverse_kinematics(robot, straight(behind, behind + 0.3, 5), start=start, mark_unreachable=mark)
    assert found.reachable.all()
    np.testing.assert_allclose(found.q[[0, -1]], whole.q[[16, 24]], atol=SAME)
    assert (mode_indicator(robot, found.q) * mode_indicator(robot, start.q[None]) < 0.0).all()


def test_a_start_at_the_rank_loss_itself_leads_on_in_the_declared_mode_or_the_other(tmp_path: Path) -> None:
    """Flat, the coupler is on neither side: the branch is that of the tangent of the start."""
    robot = folding_four_bar(tmp_path, *FOLDING, modes=True)
    flat = np.array([np.pi])
    start = point(inverse_kinematics(robot, straight(flat - 0.3, flat, 7)))
    assert np.abs(mode_indicator(robot, start.q[None])).max() < 1e-9
    back = inverse_kinematics(robot, straight(flat - 0.1, flat - 0.3, 5), start=start)
    assert (mode_indicator(robot, back.q) > 0.0).all()
    np.testing.assert_allclose(
        back.q[-1], inverse_kinematics(robot, straight(flat - 0.3, flat - 0.1, 5)).q[0], atol=SAME
    )


def test_what_is_not_on_the_branch_of_the_start_is_refused() -> None:
    """Out of reach by a gap; or in reach, beyond a stretched leg: nothing is looked for elsewhere."""
    robot = rp.load_robot("five_bar", proximal_length=0.65, distal_length=0.45)
    home = zoo.home_of(robot)
    start = point(inverse_kinematics(robot, straight(home, home + 0.01)), 0)
    far = np.array([0.25, 1.4])
    with pytest.raises(UnreachablePoseError, match=r"The pose of sample 0 \(t = 0 s") as caught:
        inverse_kinematics(robot, straight(far, far + 0.01), start=start)
    # legs of 1.1 m at most, to a point as far from both hinges; each loop is open by its share, along an axis
    assert 0.05 < caught.value.details["gap"] < np.hypot(0.25, 1.4) - 1.0
    # the first leg is no shorter than 0.2 m, and the straight line leads past its hinge at 0.15 m
    beside, other = np.array([-0.15, 0.25]), np.array([-0.15, -0.25])
    start = point(inverse_kinematics(robot, straight(home, beside)))
    with pytest.raises(WorkingModeError, match="cannot be reached continuously from the start") as refused:
        inverse_kinematics(robot, straight(other, other - 0.01), start=start)
    assert refused.value.details["sample"] == 0
