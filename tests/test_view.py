"""``rp.show``: which motion is shown of a plan, a motion, a robot or a name, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.coordinates import difference
from redundancy_pin.robot import Robot
from redundancy_pin.view import default_motion
from redundancy_pin.visualisation.viewer.scene import Scene


@pytest.fixture(scope="module")
def plan() -> rp.Plan:
    robot = zoo.robot_of("3rrr")
    motion = rp.trajectory.reference.corner().sample(0.01)
    return rp.plan_stepwise(rp.RneaDynamics(robot), motion)


def _effort(scene: Scene, name: str) -> np.ndarray:
    return next(arrow.length for arrow in scene.arrows if arrow.name == name)


def test_a_plan_shows_its_own_motions_and_efforts(plan: rp.Plan) -> None:
    scene = rp.show(plan).scene
    assert scene.duration == plan.t[-1] - plan.t[0]
    # the carriers move along their links by what the plan says
    name = scene.names.index("carrier_1")
    link = scene.names.index("elbow_1")
    apart = np.linalg.norm(scene.placement[:, name, :3, 3] - scene.placement[:, link, :3, 3], axis=1)
    samples = np.searchsorted(plan.t, scene.t + plan.t[0])
    np.testing.assert_allclose(apart, np.abs(plan.carriers.s[samples, 0]), atol=1e-12)
    assert apart.max() > 0.01
    # arrows in proportion to the efforts, torques and forces each
    for names, efforts in ((plan.robot.actuated, plan.tau), (plan.robot.carriers, plan.carrier_force)):
        lengths = np.stack([_effort(scene, name) for name in names], axis=1)
        scale = np.abs(lengths).max() / np.abs(efforts[samples]).max()
        np.testing.assert_allclose(lengths, scale * efforts[samples], atol=1e-9)
    np.testing.assert_array_equal(scene.margin, np.abs(plan.margin[samples]))


def test_a_motion_shows_the_efforts_of_inverse_dynamics() -> None:
    robot = zoo.robot_of("2rpr")
    motion = rp.trajectory.reference.line(speed=0.2).sample(dt=0.01)
    wave = 0.05 * np.sin(motion.t)[:, None] * np.ones(2)
    carriers = rp.CarrierMotion(wave, 0.05 * np.cos(motion.t)[:, None] * np.ones(2), -wave)
    scene = rp.show(robot, motion, carriers).scene
    expected = rp.VirtualWork(robot).reduce(motion, carriers)
    solved = rp.distribute(expected)
    frames = np.searchsorted(motion.t, scene.t)
    regular = solved.margin[frames] > 0.05
    for names, efforts in ((robot.actuated, solved.tau), (robot.carriers, expected.carrier_force)):
        lengths = np.stack([_effort(scene, name) for name in names], axis=1)[regular]
        wanted = efforts[frames][regular]
        scale = np.abs(lengths).max() / np.abs(wanted).max()
        np.testing.assert_allclose(lengths, scale * wanted, rtol=1e-6, atol=1e-9)


def test_the_machines_of_the_thesis_show_its_trajectories() -> None:
    circle = default_motion(zoo.robot_of("2rpr"))
    np.testing.assert_allclose(np.hypot(*(circle.x - [0.25, 0.185]).T), 0.2, rtol=1e-9)
    np.testing.assert_allclose(default_motion(zoo.robot_of("3rrr")).x[0], [1.0, 0.4, 0.0])


@pytest.mark.parametrize("name", ["five_bar", "four_bar", "gough"])
def test_the_swing_of_other_robots_is_closed_smooth_and_consistent(name: str) -> None:
    robot: Robot = zoo.robot_of(name)
    motion = default_motion(robot)
    home = zoo.home_of(robot)
    for end in (0, -1):
        np.testing.assert_allclose(motion.x[end], home, atol=1e-9)
        np.testing.assert_allclose(motion.xd[end], 0.0, atol=1e-9)
    assert np.abs(difference(robot, motion.x[[len(motion) // 2]], motion.x[[0]])).max() > 0.01
    step = np.diff(motion.t)[:, None]
    rate = difference(robot, motion.x[1:], motion.x[:-1]) / step
    # the mean of both ends is the mean over a step but for h² ẍ' / 12, of order 1e-4 here
    np.testing.assert_allclose(rate, 0.5 * (motion.xd[1:] + motion.xd[:-1]), atol=2e-4)
    np.testing.assert_allclose(np.diff(motion.xd, axis=0) / step, 0.5 * (motion.xdd[1:] + motion.xdd[:-1]), atol=2e-4)


def test_a_machine_of_other_lengths_swings_where_the_thesis_does_not_reach() -> None:
    small = zoo.robot_of("3rrr", base_radius=0.2, proximal_length=0.2, distal_length=0.2, platform_radius=0.05)
    motion = default_motion(small)
    np.testing.assert_allclose(motion.x[0], zoo.home_of(small), atol=1e-9)


def test_what_does_not_go_together_is_refused(plan: rp.Plan) -> None:
    motion = rp.trajectory.reference.corner().sample(0.1)
    with pytest.raises(InputError, match="own motions"):
        rp.show(plan, motion)
    with pytest.raises(InputError, match="goes with a plan"):
        rp.show("3rrr", robot=zoo.robot_of("3rrr"))
    with pytest.raises(InputError, match="moves in"):
        rp.show(zoo.robot_of("2rpr"), motion)


def test_the_package_loads_no_viewer_and_no_plots_until_asked() -> None:
    import subprocess
    import sys

    program = "import sys, redundancy_pin; print({'meshcat', 'matplotlib', 'selenium'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "set()"


def test_a_trajectory_in_place_of_its_samples_is_refused_with_how_to_sample_it() -> None:
    robot, corner = zoo.robot_of("3rrr"), rp.trajectory.reference.corner()
    for computed in (
        lambda: rp.show(robot, corner),  # type: ignore[arg-type]
        lambda: rp.inverse_kinematics(robot, corner),  # type: ignore[arg-type]
        lambda: rp.RneaDynamics(robot).reduce(corner),  # type: ignore[arg-type]
        lambda: rp.VirtualWork(robot).reduce(corner),  # type: ignore[arg-type]
        lambda: rp.plot.path(robot, corner),  # type: ignore[arg-type]
    ):
        with pytest.raises(InputError, match=r"not Trajectory\. Pass trajectory\.sample\(dt="):
            computed()


def test_what_is_neither_plan_nor_robot_is_named() -> None:
    with pytest.raises(InputError, match=r"not PlatformMotion\. Pass show\(plan\)"):
        rp.show(rp.trajectory.reference.corner().sample(dt=0.1))  # type: ignore[arg-type]
