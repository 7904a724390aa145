"""Plans driven open loop through forward dynamics: the machine does what the plan says."""

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.simulation.feed_forward import FeedForward
from redundancy_pin.simulation.state import State

FOLLOWED = 1e-6
"""m and rad, as required; what is reached is 1e-11."""


def largest_error(run, reference):
    points = [reference.at(float(t)) for t in run.t]
    platform = np.abs(run.x - [point.x for point in points]).max()
    carriers = np.abs(run.s - [point.s for point in points]).max(initial=0.0)
    return platform, carriers


@pytest.mark.parametrize("with_trajectory", [True, False])
def test_a_whole_trajectory_plan_through_two_singular_poses(with_trajectory):
    robot = rp.load_robot("2rpr", end_effector_mass=0.5)
    circle = rp.trajectory.reference.circle(speed=0.5)
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robot), circle, dt=0.01)
    singular = plan.diagnostics["singular_instants"]
    assert len(singular) == 2
    drive = FeedForward(plan, motion=circle if with_trajectory else None)
    run = rp.simulate(robot, drive, dt=0.01)
    assert run.status.value == "completed"
    platform, carriers = largest_error(run, drive.reference)
    assert platform < FOLLOWED
    assert carriers < FOLLOWED
    crossed = [event.t for event in run.events if event.kind == "type_II"]
    np.testing.assert_allclose(crossed, singular, atol=1e-6)
    # against the trajectory itself, not what became of its samples
    np.testing.assert_allclose(run.x, circle.evaluate(np.minimum(run.t, circle.duration)).x, atol=FOLLOWED)
    assert run.gap.max() < 1e-9


def test_a_whole_trajectory_plan_of_the_corner():
    robot = rp.load_robot("3rrr")
    corner = rp.trajectory.reference.corner(radius=0.025)
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robot), corner, dt=0.01)
    run = rp.simulate(robot, plan, dt=0.01)
    assert run.status.value == "completed"
    np.testing.assert_allclose(run.x, corner.evaluate(np.minimum(run.t, corner.duration)).x, atol=FOLLOWED)
    assert (run.parameters["drive"], run.robot.name) == ("whole_trajectory", "3rrr")


def test_a_stepwise_plan_as_the_continuous_motion_it_stands_for():
    robot = rp.load_robot("3rrr")
    corner = rp.trajectory.reference.corner(radius=0.025)
    plan = rp.plan_stepwise(rp.RneaDynamics(robot), corner, lam=0.0)
    drive = FeedForward(plan)
    run = rp.simulate(robot, drive, dt=0.01)
    assert run.status.value == "completed"
    assert max(largest_error(run, drive.reference)) < FOLLOWED
    np.testing.assert_allclose(run.x, corner.evaluate(np.minimum(run.t, corner.duration)).x, atol=FOLLOWED)


def test_holding_the_efforts_of_the_samples_is_another_command():
    # what a replay must not do: the samples of a stepwise plan, held over a step, lead away from the path
    robot = rp.load_robot("3rrr")
    corner = rp.trajectory.reference.corner(radius=0.025)
    plan = rp.plan_stepwise(rp.RneaDynamics(robot), corner, lam=0.0)
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


def test_a_massless_crossing_follows_its_plan_up_to_the_singular_pose_and_says_why_not_further():
    robot = rp.load_robot("2rpr")
    circle = rp.trajectory.reference.circle(speed=0.5)
    plan = rp.plan_switch_off(rp.RneaDynamics(robot), circle, threshold=5.0, dt=0.005)
    drive = FeedForward(plan, motion=circle)
    run = rp.simulate(robot, drive, dt=0.01, carriers="motion", stop_at=())
    assert run.status.value == "failed"
    assert "end_effector_mass" in run.reason
    first = plan.diagnostics["singular_instants"][0]
    assert first - 1e-3 < run.t[-1] < first
    assert largest_error(run, drive.reference)[0] < FOLLOWED
