"""Plans driven open loop through forward dynamics: the machine does what the plan says."""

from functools import cache

import moving
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.simulation import FeedForward, State, closed_state, motion_reference

FOLLOWED = 1e-6
"""m and rad, as required; what is reached is 1e-11."""


CIRCLE = rp.trajectory.reference.circle(speed=0.5)
_DOWN = rp.trajectory.Line((0.15, 0.1), (0.2, -0.1))
ACROSS = rp.trajectory.Trajectory(_DOWN, rp.trajectory.RestToRest(_DOWN.length, duration=0.6))
"""Through two type II poses of the 2-RPR, and through one."""


@cache
def crossing(motion):
    """The 2-RPR with mass, and its plan for a motion."""
    robot = rp.load_robot("2rpr", end_effector_mass=0.5)
    return robot, rp.plan_whole_trajectory(rp.RneaDynamics(robot), motion, mesh=rp.Mesh(dt=0.01))


@cache
def stepwise_corner():
    """The 3-RRR around a corner step by step, without regard to efforts."""
    robot, corner = rp.load_robot("3rrr"), rp.trajectory.reference.corner(radius=0.025)
    return robot, corner, rp.plan_stepwise(rp.RneaDynamics(robot), corner, mesh=rp.Mesh(dt=0.01))


def largest_error(run, reference):
    points = [reference.at(float(t)) for t in run.t]
    platform = np.abs(run.x - [point.x for point in points]).max()
    carriers = np.abs(run.s - [point.s for point in points]).max(initial=0.0)
    return platform, carriers


@pytest.mark.long_for("circle-True", "circle-False")
@pytest.mark.parametrize("with_trajectory", [True, False])
@pytest.mark.parametrize(("motion", "poses"), [(CIRCLE, 2), (ACROSS, 1)], ids=["circle", "line"])
def test_a_whole_trajectory_plan_through_singular_poses(motion, poses, with_trajectory):
    robot, plan = crossing(motion)
    singular = plan.findings.singular_instants
    assert len(singular) == poses
    drive = FeedForward(plan, motion=motion if with_trajectory else None)
    # the nodes next to the singular instants are where W⁻¹ f magnifies what samples and solver leave, to 4e-7
    assert drive.reference.effort_deviation < 1e-8
    run = rp.simulate(robot, drive, dt=0.05)
    assert run.status.value == "ok"
    platform, carriers = largest_error(run, drive.reference)
    assert platform < FOLLOWED
    assert carriers < FOLLOWED
    crossed = [event.t for event in run.events if event.kind == "type_II"]
    np.testing.assert_allclose(crossed, singular, atol=1e-6)
    # against the trajectory itself, not what became of its samples
    np.testing.assert_allclose(run.x, motion.evaluate(np.minimum(run.t, motion.duration)).x, atol=FOLLOWED)
    assert run.gap.max() < 1e-9


@pytest.mark.long
def test_a_whole_trajectory_plan_of_the_corner():
    robot = rp.load_robot("3rrr")
    corner = rp.trajectory.reference.corner(radius=0.025)
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robot), corner, mesh=rp.Mesh(dt=0.01))
    run = rp.simulate(robot, plan, dt=0.01)
    assert run.status.value == "ok"
    np.testing.assert_allclose(run.x, corner.evaluate(np.minimum(run.t, corner.duration)).x, atol=FOLLOWED)
    assert (run.parameters["drive"], run.robot.name) == ("whole_trajectory", "3rrr")


@pytest.mark.long
def test_a_stepwise_plan_as_the_continuous_motion_it_stands_for():
    robot, corner, plan = stepwise_corner()
    drive = FeedForward(plan)
    run = rp.simulate(robot, drive, dt=0.01)
    assert run.status.value == "ok"
    assert max(largest_error(run, drive.reference)) < FOLLOWED
    np.testing.assert_allclose(run.x, corner.evaluate(np.minimum(run.t, corner.duration)).x, atol=FOLLOWED)


@pytest.mark.long
def test_holding_the_efforts_of_the_samples_is_another_command():
    # what a replay must not do: the samples of a stepwise plan, held over a step, lead away from the path
    robot, corner, plan = stepwise_corner()
    keep = np.append(np.diff(plan.t) > 0.0, True)
    times, tau, force = plan.t[keep], plan.tau[keep], plan.carrier_force[keep]

    class Held:
        breaks = times[1:-1]
        end = float(times[-1])

        def effort(self, t: float, state: State):
            at = min(int(np.searchsorted(times, t, side="right")), len(times) - 1)
            return tau[at], force[at]

    start = FeedForward(plan).start_state(robot)
    run = rp.simulate(robot, Held(), start=start, dt=0.01, stop_at=())
    away = np.abs(run.x - corner.evaluate(np.minimum(run.t, corner.duration)).x).max()
    assert away > 100 * FOLLOWED


@pytest.mark.long
def test_a_massless_crossing_follows_its_plan_up_to_the_singular_pose_and_says_why_not_further():
    robot = rp.load_robot("2rpr")
    circle = rp.trajectory.reference.circle(speed=0.5)
    plan = rp.plan_switch_off(rp.RneaDynamics(robot), circle, threshold=5.0, mesh=rp.Mesh(dt=0.005))
    drive = FeedForward(plan, motion=circle)
    run = rp.simulate(robot, drive, dt=0.01, carriers="motion", stop_at=())
    assert run.status.value == "not_converged"
    assert "end_effector_mass" in run.reason
    first = plan.findings.singular_instants[0]
    assert first - 1e-3 < run.t[-1] < first
    assert largest_error(run, drive.reference)[0] < FOLLOWED


def rest_to_rest(robot):
    """Return a motion of half a second from the reference pose, of any shipped robot."""
    home = closed_state(robot).x
    if home.ndim == 2:
        end = home.copy()
        end[:3, 3] += [0.08, -0.05, 0.06]
        end[:3, :3] = Rotation.from_rotvec([0.2, -0.15, 0.3]).as_matrix() @ home[:3, :3]
        return rp.trajectory.reference.pose(home, end, 0.5, "3-4-5")
    path = rp.trajectory.Line(home, home + np.linspace(0.1, 0.15, len(home)))
    return rp.trajectory.Trajectory(path, rp.trajectory.RestToRest(path.length, duration=0.5))


@pytest.mark.long_for("five_bar", "2rpr")
@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar", "four_bar", "gough"])
def test_efforts_of_a_parked_motion_move_any_robot_along_it(name):
    robot = moving.massive(name)
    trajectory = rest_to_rest(robot)
    drive = FeedForward(motion_reference(robot, trajectory, 0.05 if robot.k else 0.0))
    run = rp.simulate(robot, drive, dt=0.05)
    assert run.status.value == "ok"
    np.testing.assert_allclose(run.x, trajectory.evaluate(run.t).x, atol=FOLLOWED)
    np.testing.assert_allclose(run.s, 0.05, atol=FOLLOWED)
    # the force that holds a carrier is the one that driving it by motion takes
    given = rp.simulate(robot, drive, dt=0.05, carriers="motion")
    np.testing.assert_allclose(given.carrier_force, run.carrier_force, atol=1e-6)
    np.testing.assert_allclose(given.tau, run.tau, atol=0.0)


def test_a_plan_of_sampled_poses_moves_the_platform_along_them(tmp_path):
    """A spatial platform: position to 1e-6 m and orientation to 1e-6 rad, as read from a file."""
    robot = rp.load_robot("gough", carriers=True)
    trajectory = rest_to_rest(robot)
    plan = rp.plan_stepwise(rp.RneaDynamics(robot), trajectory.sample(0.02))
    plan.save(tmp_path / "plan.npz")
    assert np.ptp(plan.carriers.s, axis=0).min() > 0.01  # the carriers do move
    # the plan uses the last micrometre of its tracks
    run = rp.simulate(robot, rp.load_plan(tmp_path / "plan.npz"), dt=0.05, stop_at=())
    assert run.status.value == "ok"
    planned = trajectory.evaluate(np.minimum(run.t, trajectory.duration)).x
    turned = Rotation.from_matrix(run.x[:, :3, :3] @ planned[:, :3, :3].transpose(0, 2, 1)).magnitude()
    assert np.abs(run.x[:, :3, 3] - planned[:, :3, 3]).max() < FOLLOWED
    assert turned.max() < FOLLOWED
