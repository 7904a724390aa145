"""A pose from the one before: taken where it is plainly on the branch, left to a closer look everywhere else."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import spatial_chains
import zoo
from flat_linkages import row_of_four_bars
from folding import folding_four_bar
from redundancy_pin.kinematics.continuation import ANCHOR_SPACING, Point, follow

import redundancy_pin as rp
from redundancy_pin.kinematics.assembly import assemble, integrate, project
from redundancy_pin.kinematics.chain import Tracked, Tracker, tracker
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.kinematics.coordinates import moved
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot


@pytest.mark.parametrize("many", [False, True])
def test_a_pose_nearby_is_the_one_that_assembly_closes(shipped: Robot, many: bool) -> None:
    system, follower = zoo.system_of(shipped), tracker(shipped, many=many)
    home = follower.home
    increment = np.random.default_rng(5).uniform(-0.02, 0.02, shipped.n) * shipped.characteristic_length
    x = moved(shipped, home.x[None], increment[None])
    reached = follower.towards(home, x[0])
    assert reached is not None
    guess = integrate(shipped.model, home.q[None], (home.gamma @ increment)[None])
    expected = assemble(system, guess, x)
    np.testing.assert_allclose(reached.point.q, expected.q[0], rtol=0.0, atol=1e-12)
    np.testing.assert_allclose(reached.point.gamma, expected.gamma[0], rtol=0.0, atol=1e-10)
    assert reached.margin == pytest.approx(expected.projection.margin[0], rel=1e-10)
    inverse = expected.projection.inverse[0]
    np.testing.assert_allclose(reached.inverse, inverse, rtol=0.0, atol=1e-10 * np.abs(inverse).max())


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("name", ["hinge", "cylindrical", "universal"])
def test_axes_that_coincide_are_followed_and_not_turned_over(name: str, many: bool) -> None:
    """Along a turn by hundredths: each pose is the one that assembly closes."""
    robot = spatial_chains.chain_of(name)
    system, follower = zoo.system_of(robot), tracker(robot, many=many)
    here = follower.home
    for _ in range(3):
        x = here.x + 0.02
        reached = follower.towards(here, x)
        assert reached is not None
        expected = assemble(system, integrate(robot.model, here.q[None], (here.gamma @ (x - here.x))[None]), x[None])
        np.testing.assert_allclose(reached.point.q, expected.q[0], rtol=0.0, atol=1e-12)
        here = reached.point


@pytest.mark.parametrize("many", [False, True])
@pytest.mark.parametrize("independent", [{"joints": ["a", "b"]}, {"platform": "tip", "axes": ["x", "y"]}])
def test_a_chain_without_closures_is_followed(independent: dict[str, Any], many: bool) -> None:
    """Two links in a plane, whose tip is where trigonometry puts it."""
    model, joint, apart = pin.Model(), 0, pin.SE3.Identity()
    for name in ("a", "b"):
        joint = model.addJoint(joint, pin.JointModelRZ(), apart, name)
        model.appendBodyToJoint(joint, pin.Inertia.FromSphere(1.0, 0.1), pin.SE3.Identity())
        apart = pin.SE3(np.eye(3), np.array([1.0, 0.0, 0.0]))
    model.addBodyFrame("tip", joint, pin.SE3(np.eye(3), np.array([0.8, 0.0, 0.0])), 0)
    reference = {"guess": {"a": 0.3, "b": 0.5}, **({} if "joints" in independent else {"platform": [1.5, 0.9]})}
    robot = Robot.from_model(model, actuated=["a", "b"], independent=independent, reference=reference)
    follower = tracker(robot, many=many)
    x = follower.home.x + np.array([0.02, -0.01])
    reached = follower.towards(follower.home, x)
    assert reached is not None
    a, b = reached.point.q
    tip = [np.cos(a) + 0.8 * np.cos(a + b), np.sin(a) + 0.8 * np.sin(a + b)]
    np.testing.assert_allclose([a, b] if "joints" in independent else tip, x, atol=1e-12)
    v, acceleration = follower.rates(reached, np.array([0.1, 0.2]), np.zeros(2))
    assert np.isfinite([v, acceleration]).all()


def test_a_point_that_the_branch_contradicts_is_left_to_others() -> None:
    robot = zoo.robot_of("3rrr")
    follower = tracker(robot)
    home, x = follower.home, follower.home.x + np.array([0.01, 0.0, 0.0])
    assert follower.towards(home, x) is not None
    assert follower.towards(home._replace(gamma=3.0 * home.gamma), x) is None
    assert follower.towards(home, x + 100.0) is None
    assert follower.towards(home, x * np.nan) is None


@pytest.mark.parametrize("beside", [0.0, 1e-6, 1e-4, -1e-4])
def test_poses_beside_a_rank_loss_are_left_to_others(beside: float, tmp_path: Path) -> None:
    """Newton's rounding shows in the rates there."""
    robot = folding_four_bar(tmp_path, (0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5))
    follower = tracker(robot)
    still = np.zeros((1, 1))
    for before in (0.05, 2e-3):  # by a long step and by a short one
        tree = inverse_kinematics(robot, PlatformMotion(np.zeros(1), np.array([[np.pi - before]]), still, still))
        near = Point(tree.motion.x[0], tree.q[0], tree.gamma[0])
        assert follower.towards(near, np.array([np.pi + beside])) is None


def test_a_step_in_which_rank_may_be_lost_is_left_to_others(tmp_path: Path) -> None:
    """Halfway between both poses linkages fold flat, and the branch that has a kink there closes as well."""
    robot = folding_four_bar(tmp_path, (0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5))
    follower, still = tracker(robot), np.zeros((1, 1))
    tree = inverse_kinematics(robot, PlatformMotion(np.zeros(1), np.array([[np.pi - 0.015]]), still, still))
    near = Point(tree.motion.x[0], tree.q[0], tree.gamma[0])
    assert follower.towards(near, np.array([np.pi + 0.015])) is None
    assert follower.towards(near, np.array([np.pi - 0.017])) is not None


@pytest.mark.parametrize("size", [1.0, 2.0**5])
def test_the_way_to_a_pose_is_gone_in_steps_of_a_part_of_the_machine(
    size: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As many as it takes at the anchors' spacing; a way of more than a hundred is left to others at once."""
    names = ("base_distance", "proximal_length", "distal_length", "tail_length")
    plain = zoo.robot_of("five_bar").parameters
    robot = rp.load_robot("five_bar", carriers=True, **{name: size * float(plain[name]) for name in names})
    follower, targets, step = tracker(robot), [], Tracker.step

    def counted(self: Tracker, here: Point, x: np.ndarray) -> Tracked | None:
        targets.append(np.array(x))
        return step(self, here, x)

    monkeypatch.setattr(Tracker, "step", counted)
    spacing = ANCHOR_SPACING * robot.characteristic_length
    home, along = follower.home.x, np.array([0.6, -0.8])
    for way, steps in ((0.0, 1), (0.5, 1), (0.99, 1), (1.01, 2), (1.99, 2), (2.5, 3)):
        targets.clear()
        reached = follower.towards(follower.home, home + way * spacing * along)
        assert reached is not None
        expected = home + np.linspace(0.0, way, steps + 1)[1:, None] * spacing * along
        np.testing.assert_allclose(targets, expected, rtol=1e-12)
    targets.clear()
    assert follower.towards(follower.home, home + 101.0 * spacing * along) is None
    assert not targets


@pytest.mark.parametrize("length", [1.0, 2.0**5])
@pytest.mark.parametrize("beside", [0.02, -0.02])
def test_a_step_is_shorter_than_the_way_to_a_rank_loss(length: float, beside: float) -> None:
    """In radians and in scaled units; a longer one may have led over one, and is left to others."""
    robot = row_of_four_bars(1, crank=length, coupler=length)
    system, follower = constraint_system(robot), tracker(robot)
    turn = np.array([1.0 if name.startswith("crank") else -1.0 for name in list(robot.model.names)[1:]])
    margin = project(system, system.evaluate((beside * turn)[None])).margin[0]
    assert 0.5 < margin / abs(beside) < 2.0
    for share, taken in ((0.5, True), (0.95, True), (1.05, False), (1.5, False)):
        before = beside + np.copysign(share * margin, beside)
        q = before * turn
        start = Point(np.array([before]), q, project(system, system.evaluate(q[None])).gamma[0])
        reached = follower.towards(start, np.array([beside]))
        assert (reached is not None) == taken
        if reached is not None:
            np.testing.assert_allclose(reached.point.q, beside * turn, atol=1e-9)


@pytest.mark.parametrize("size", [1.0, 2.0**5])
def test_anchors_are_laid_at_one_spacing_whatever_the_samples(size: float) -> None:
    """Between samples that are far apart in even parts of a step; of samples that are near each other on some."""
    robot = row_of_four_bars(1, crank=size, coupler=size)
    system, start = constraint_system(robot), np.array(robot.q_reference)
    # the crank's angle times the size of the machine, in parts of that size: the spacing is an angle
    first = float(robot.q_reference[0])
    for way, parts in ((1.5, 2), (2.5, 3), (9.9, 10)):
        far = follow(system, first + ANCHOR_SPACING * way * np.array([[0.0], [1.0], [1.25]]), start)
        between = np.arange(parts + 1) / parts
        more = max(int(np.ceil(0.25 * way)), 1)
        expected = [*between, *(1.0 + np.arange(1, more + 1) / more)]
        np.testing.assert_allclose(far.position, expected, atol=1e-12)
        np.testing.assert_allclose(
            far.x[:, 0], first + ANCHOR_SPACING * way * np.interp(expected, range(3), [0, 1, 1.25])
        )
        assert far.valid.all()
    dense = first + ANCHOR_SPACING * np.arange(0.0, 5.01, 0.23)[:, None]
    anchors = follow(system, dense, start)
    assert (anchors.position == anchors.position.round()).all()
    apart = np.diff(anchors.position) * 0.23
    assert apart.max() < 1.0 + 2.0 * 0.23
    assert apart[:-1].min() > 1.0 - 2.0 * 0.23
    every = follow(system, dense, start, every_sample=True)
    np.testing.assert_array_equal(every.position, np.arange(len(dense)))
