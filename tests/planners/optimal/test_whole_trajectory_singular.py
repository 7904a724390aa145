"""Motions that touch a type II singularity, rest in it, follow it, pass close by, or cross it twice in a moment.

The circle of the 2-RPR with its lowest point at height h over the line of the base hinges touches it where h = 0.
"""

import numpy as np
import pytest
import zoo

from redundancy_pin import Limits, Mesh, RneaDynamics, VirtualWork, check_plan, distribute, plan_whole_trajectory
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, rounded_polygon
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
    plan = plan_of(trajectory, dt=0.08)
    half = np.arccos(1.0 - depth / RADIUS) * RADIUS / SPEED
    middle = trajectory.duration / 2
    np.testing.assert_allclose(plan.findings.singular_instants, [middle - half, middle + half], atol=1e-6)
    assert plan.status is ResultStatus.OK
    assert plan.between.passed


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
    assert plan.findings.singular_instants == ()
    # the first plan is near already (7.4 for the peak at 1e-6, else 2.9 at most); 100 and more without middle nodes
    assert plan.diagnostics["dense_ratios"][0] <= 10.0
    assert plan.status is ResultStatus.OK
    assert plan.between.passed


def test_where_a_path_bends_on_a_singularity_the_efforts_jump_and_each_side_has_its_own():
    """The straight ends on the line of the hinges: efforts there against those beside it, to the other backend too."""
    robot = zoo.robot_of("2rpr", cylinder_mass=0.3, piston_mass=0.2)
    path = rounded_polygon([[0.15, 0.2], [0.15, -0.05], [0.35, -0.05]], 0.05, closed=False)
    bend = Trajectory(path, SpeedProfile(path.length, 0.3, 0.1))
    wide = Limits(track=(-1.0, 1.0), speed=10.0, acceleration=100.0)
    plan = plan_whole_trajectory(VirtualWork(robot), bend, mesh=Mesh(dt=0.02), limits=wide)
    (t,) = plan.findings.singular_instants
    assert t == bend.breaks[0]
    before, after = np.flatnonzero(plan.t == t)
    for i, away in ((before, np.array([-2e-4, -1e-4])), (after, np.array([1e-4, 2e-4]))):
        beside = RneaDynamics(robot).reduce(bend.sample_at(t + away), plan.carriers_at(t + away))
        limit = np.polyfit(away, distribute(beside).tau, 1)[1]
        np.testing.assert_allclose(plan.tau[i], limit, atol=1e-3 * np.abs(plan.tau).max())
    assert np.abs(plan.tau[after] - plan.tau[before]).max() > 0.1
    assert check_plan(plan, RneaDynamics(robot)).passed
