"""Motions that touch a type II singularity, rest in it, follow it, pass close by, or cross it twice in a moment.

The circle of the 2-RPR with its lowest point at height h over the line of the base hinges touches it where h = 0.
"""

import numpy as np
import pytest
import zoo

from redundancy_pin import VirtualWork, plan_whole_trajectory
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.case import in_groups
from redundancy_pin.trajectory import SpeedProfile, Trajectory
from redundancy_pin.trajectory.paths import Line, circle_path

RADIUS, SPEED, X = 0.2, 0.3, 0.25
HEAVY = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}


def over_the_line(h):
    path = circle_path((X, RADIUS + h), RADIUS, start_angle=np.pi / 2)
    return Trajectory(path, SpeedProfile(path.length, SPEED, 0.2))


def straight(start, end):
    path = Line(start, end)
    return Trajectory(path, SpeedProfile(path.length, SPEED, 0.2))


def plan_of(trajectory, dt=0.02, **settings):
    return plan_whole_trajectory(
        VirtualWork(zoo.robot_of("2rpr", **HEAVY)),
        trajectory,
        **in_groups(plan_whole_trajectory, dict(dt=dt, **settings)),
    )


def test_a_touch_is_a_clear_error():
    trajectory = over_the_line(0.0)
    with pytest.raises(InfeasiblePlanError, match="touches") as caught:
        plan_of(trajectory)
    details = caught.value.details
    assert details["constraint"] == "singular_touch"
    assert not details["at_rest"]
    # lowest after half the circle
    assert details["time"] == pytest.approx(trajectory.duration / 2, abs=1e-6)


@pytest.mark.parametrize("reverse", [False, True])
def test_resting_in_a_singular_pose_is_a_clear_error(reverse):
    ends = ((0.2, 0.3), (0.3, 0.0))
    trajectory = straight(*(ends[::-1] if reverse else ends))
    with pytest.raises(InfeasiblePlanError, match="rests in") as caught:
        plan_of(trajectory)
    assert caught.value.details["at_rest"]
    assert caught.value.details["time"] == pytest.approx(0.0 if reverse else trajectory.duration, abs=1e-3)


def test_following_a_singularity_is_a_clear_error():
    with pytest.raises(InfeasiblePlanError, match="without crossing"):
        plan_of(straight((0.1, 0.0), (0.4, 0.0)))


@pytest.mark.long_for("0.0001")
@pytest.mark.parametrize("depth", [1e-7, pytest.param(1e-6, marks=pytest.mark.long), 1e-4])
def test_two_crossings_in_a_moment_are_both_on_nodes(depth):
    """The circle dips under the line by ``depth`` between two crossings at x = X ± √(2 R depth)."""
    trajectory = over_the_line(-depth)
    plan = plan_of(trajectory, dt=0.04)
    half = np.arccos(1.0 - depth / RADIUS) * RADIUS / SPEED
    middle = trajectory.duration / 2
    np.testing.assert_allclose(plan.diagnostics["singular_instants"], [middle - half, middle + half], atol=1e-6)
    assert plan.status is ResultStatus.OK
    assert plan.diagnostics["dense_check"]["passed"]


@pytest.mark.long_for("peak-1e-06")
@pytest.mark.parametrize(
    ("objective", "height"),
    [
        ("effort", 1e-6),
        ("effort", 1e-2),
        ("peak", 1e-6),
        *(pytest.param(*case, marks=pytest.mark.long) for case in (("effort", 1e-4), ("peak", 1e-4), ("peak", 1e-2))),
    ],
)
def test_passing_close_by_is_planned_as_carefully(objective, height):
    plan = plan_of(over_the_line(height), objective=objective)
    assert plan.diagnostics["singular_instants"] == []
    # the first plan is near already (7.4 for the peak at 1e-6, else 2.9 at most); 100 and more without middle nodes
    assert plan.diagnostics["dense_ratios"][0] <= 10.0
    assert plan.status is ResultStatus.OK
    assert plan.diagnostics["dense_check"]["passed"]


@pytest.mark.long
def test_efforts_change_smoothly_from_a_crossing_to_a_near_miss():
    """The plan hardly depends on which side of the line the lowest point is; its nodes do (8e-3, 7e-4, 6e-5 of the
    effort at steps of 20, 10 and 5 ms)."""
    above, below = (
        plan_of(over_the_line(h), dt=0.01, refinements=0).diagnostics["objective"]["effort"] for h in (1e-6, -1e-6)
    )
    assert above == pytest.approx(below, rel=1e-3)
