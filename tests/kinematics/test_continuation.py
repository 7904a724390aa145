"""Anchors along a path, guesses between them, and the continuity test."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
import zoo
from redundancy_pin.kinematics.continuation import (
    ANCHOR_SPACING,
    Anchors,
    closed_around,
    continuous,
    follow,
    follows,
    initial_guess,
    reacquire,
)

from redundancy_pin.kinematics.assembly import assemble, project
from redundancy_pin.kinematics.coordinates import difference, in_working_mode
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale, velocity_unit


def test_anchors_are_dense_enough_and_no_denser(shipped: Robot) -> None:
    system = zoo.system_of(shipped)
    x = zoo.smooth_motion(shipped, 1).at(np.linspace(0.0, 2.0, 2000)).x
    anchors = follow(system, x, inverse_kinematics(shipped, zoo.smooth_motion(shipped, 1).at(np.zeros(1))).q[0])
    assert anchors.valid.all()
    steps = np.linalg.norm(difference(shipped, anchors.x[1:], anchors.x[:-1]) * row_scale(shipped), axis=1)
    sample = np.linalg.norm(difference(shipped, x[1:], x[:-1]) * row_scale(shipped), axis=1).max()
    allowed = ANCHOR_SPACING * shipped.characteristic_length
    assert steps.max() <= allowed + sample
    length = np.linalg.norm(difference(shipped, x[1:], x[:-1]) * row_scale(shipped), axis=1).sum()
    assert len(anchors.position) <= length / allowed + 2


def test_configurations_around_the_reference_are_near_it(shipped: Robot) -> None:
    """Those along the branch by 0.4 rad or characteristic lengths of the joint that moves farthest, before closing."""
    reference, q = np.array(shipped.q_reference), closed_around(zoo.system_of(shipped)).q
    unit = velocity_unit(shipped)
    far = np.array([np.abs(pin.difference(shipped.model, reference, one) / unit).max() for one in q])
    assert far[0] < 1e-9
    along = far[1 + len(far) // 2 :]
    assert 0.3 < along.min() <= along.max() < 0.5


def test_a_step_follows_if_it_is_what_the_trapezoidal_rule_predicts() -> None:
    """q̇ = Γ ẋ with Γ = 1 and then 3: an increment of 0.1 moves q by 0.2, not back, by nothing, or thrice as far."""
    system = zoo.system_of(zoo.robot_of("five_bar"))
    nv = system.robot.model.nv
    gamma0, gamma1 = np.full((4, nv, 1), 1.0), np.full((4, nv, 1), 3.0)
    step = np.array([0.2, -0.2, 0.0, 0.6])[:, None] * np.ones(nv)
    assert follows(system, step, gamma0, gamma1, np.full((4, 1), 0.1)).tolist() == [True, False, False, False]


def test_anchors_fill_in_between_sparse_samples() -> None:
    robot = zoo.robot_of("five_bar")
    x = np.array([[0.25, 0.76], [0.25, 0.30], [0.45, 0.30]])
    anchors = follow(zoo.system_of(robot), x, np.array(robot.q_reference)[:])
    assert anchors.valid.all()
    assert set(np.arange(3.0)) <= set(anchors.position)
    assert np.all(np.diff(anchors.position) > 0)
    np.testing.assert_allclose(anchors.x[anchors.position == 1.0][0], x[1])
    between = anchors.x[(anchors.position > 0) & (anchors.position < 1)]
    np.testing.assert_allclose(between[:, 0], 0.25)


def test_every_sample_may_be_an_anchor() -> None:
    robot = zoo.robot_of("five_bar")
    x = np.linspace(zoo.home_of(robot), zoo.home_of(robot) + 1e-3, 20)
    few = follow(zoo.system_of(robot), x, np.array(robot.q_reference))
    every = follow(zoo.system_of(robot), x, np.array(robot.q_reference), every_sample=True)
    assert len(few.position) == 2
    np.testing.assert_array_equal(every.position, np.arange(20))


def test_guesses_between_anchors_are_cubic(shipped: Robot) -> None:
    """A cubic through values and slopes errs with the fourth power of the spacing: far below the anchors' steps."""
    system = zoo.system_of(shipped)
    motion = zoo.smooth_motion(shipped, 2).at(np.linspace(0.0, 1.0, 500))
    tree = inverse_kinematics(shipped, motion)
    anchors = follow(system, motion.x, tree.q[0])
    guess = initial_guess(system, motion.x, anchors)
    step = np.abs(np.diff(anchors.q, axis=0)).max()
    assert np.abs(guess - tree.q).max() < 0.1 * step**2


def test_behind_a_gap_the_guess_comes_from_the_near_side() -> None:
    """A sample between a lost anchor, which holds the last good configuration from far away, and one found again."""
    robot = zoo.robot_of("five_bar")
    x = np.array([zoo.home_of(robot)] * 3) + np.array([[0.0, 0.5], [0.0, 0.01], [0.0, 0.0]])
    far, near = np.array(robot.q_reference) + 2.0, np.array(robot.q_reference)
    gamma = np.zeros((2, robot.model.nv, robot.n))
    anchors = Anchors(np.array([0.0, 2.0]), x[[0, 2]], np.stack([far, near]), gamma, np.array([False, True]))
    guess = initial_guess(zoo.system_of(robot), x, anchors)
    np.testing.assert_array_equal(guess[1], near)
    lost = Anchors(np.array([0.0, 2.0]), x[[0, 2]], np.stack([near, far]), gamma, np.array([True, False]))
    np.testing.assert_array_equal(initial_guess(zoo.system_of(robot), x, lost)[1], near)


def test_the_end_of_the_branch_leaves_the_rest_invalid() -> None:
    robot = zoo.robot_of("five_bar")
    height = np.concatenate([np.linspace(0.76, 1.1, 30), np.linspace(1.1, 0.76, 30)])
    x = np.stack([np.full(60, 0.25), height], axis=1)
    stopped = follow(zoo.system_of(robot), x, np.array(robot.q_reference))
    end = int(np.argmin(stopped.valid))
    assert not stopped.valid[end:].any()
    assert stopped.x[end - 1, 1] < np.sqrt(1 - 0.25**2) < stopped.x[end, 1]
    resumed = follow(zoo.system_of(robot), x, np.array(robot.q_reference), resume=True)
    np.testing.assert_array_equal(resumed.valid, resumed.x[:, 1] < np.sqrt(1 - 0.25**2))


def test_a_jump_to_the_other_elbow_is_not_continuous() -> None:
    robot = zoo.robot_of("five_bar")
    system = zoo.system_of(robot)
    x = np.linspace(zoo.home_of(robot), zoo.home_of(robot) - [0.0, 0.01], 3)
    q = inverse_kinematics(robot, zoo.smooth_motion(robot, 0).at(np.zeros(1))).q  # any closed start
    q = assemble(system, np.repeat(robot.q_reference[None], 3, axis=0), x).q
    other = zoo.robot_of("five_bar", working_mode=(-1, -1))
    q[2] = assemble(system, other.q_reference[None], x[2:]).q[0]
    gamma = project(system, system.evaluate(q)).gamma
    np.testing.assert_array_equal(continuous(system, q, gamma, x), [True, False])


def test_standing_still_is_continuous(shipped: Robot) -> None:
    system = zoo.system_of(shipped)
    q = np.repeat(shipped.q_reference[None], 3, axis=0)
    x = np.repeat(zoo.home_of(shipped)[None], 3, axis=0)
    assert continuous(system, q, project(system, system.evaluate(q)).gamma, x).all()


@pytest.mark.parametrize("nothing_within", [True, False])
def test_reacquire_finds_the_first_pose_in_the_mode(nothing_within: bool) -> None:
    robot = zoo.robot_of("five_bar")
    heights = np.linspace(1.5, 1.2, 40) if nothing_within else np.linspace(1.5, 0.5, 101)
    targets = np.stack([np.full(len(heights), 0.25), heights], axis=1)
    reacquired = reacquire(zoo.system_of(robot), targets, np.array(robot.q_reference))
    if nothing_within:
        assert reacquired is None
    else:
        assert reacquired is not None
        index, (_, q, gamma, _) = reacquired
        assert index == int(np.argmax(heights < np.sqrt(1 - 0.25**2)))
        assert in_working_mode(robot, q[None])[0]
        assert np.isfinite(gamma).all()
