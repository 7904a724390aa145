"""Poses where the closures lose rank on the way of a plan are named: flat parallelograms, whose flat angle is known."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from flat_linkages import parallelogram

import redundancy_pin as rp
from redundancy_pin.planners.intersample_check import closure_rank_losses
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory.continuous_motion import as_motion

DURATION = 2.0

EXACT = 1e-6
"""s; the times are exact to the rounding of the configuration beside a rank loss."""


def swing(first: float, last: float, count: int = 101) -> rp.PlatformMotion:
    """Return a crank that swings from one angle to another at a constant rate, so that its angle says the time."""
    t = np.linspace(0.0, DURATION, count)
    rate = (last - first) / DURATION
    return rp.PlatformMotion(t, (first + rate * t)[:, None], np.full((count, 1), rate), np.zeros((count, 1)))


def when(first: float, last: float, angle: float) -> float:
    return DURATION * (angle - first) / (last - first)


def hinged() -> Robot:
    """Return the parallelogram closed by a hinge: three of its five rows are redundant everywhere."""
    robot = parallelogram()
    closures = [replace(each, axes=("x", "y", "z", "rx", "ry")) for each in robot.closures]
    roles = {"actuated": robot.actuated, "independent": {"joints": robot.independent_joints}}
    q = np.array(robot.q_reference)
    return rp.robot_from_model(robot.model, closures=closures, reference=q, redundant_rows=True, **roles)


# the rank loss on a sample, between two samples, and two of them; angles are measured from the line of the base hinges
@pytest.mark.long_for("False-1.2--4.0-flat2", "True-1.2--4.0-flat2")
@pytest.mark.parametrize(
    ("first", "last", "flat"),
    [(1.0, -1.0, [0.0]), (1.2, 3.9, [np.pi]), (1.2, -4.0, [0.0, -np.pi]), (1.2, 0.3, [])],
)
@pytest.mark.parametrize("redundant", [False, True])
def test_time_and_pose_of_each_rank_loss_are_named(
    first: float, last: float, flat: list[float], redundant: bool
) -> None:
    dynamics, motion = rp.RneaDynamics(hinged() if redundant else parallelogram()), swing(first, last)
    margin = dynamics.along(motion).closure_margin()
    # where two branches cross the determinant changes its sign, and the ratio of singular values is small
    assert margin[0] * margin[-1] * (-1.0) ** len(flat) > 0.0
    assert all(np.abs(margin[np.abs(motion.x[:, 0] - angle).argmin()]) < 0.05 for angle in flat)
    crossings = closure_rank_losses(dynamics, dynamics.along(motion), as_motion(motion))
    np.testing.assert_allclose([loss["time"] for loss in crossings], [when(first, last, a) for a in flat], atol=EXACT)
    np.testing.assert_allclose(np.ravel([loss["x"] for loss in crossings]), flat, atol=EXACT)


def test_plans_and_their_check_name_it() -> None:
    dynamics, motion = rp.RneaDynamics(parallelogram("carrier")), swing(1.2, -0.9)
    plan = rp.plan_stepwise(dynamics, motion, limits=rp.Limits(acceleration=50.0), brake_time=0.1)
    (loss,) = plan.findings.closure_rank  # type: ignore[misc]
    assert loss["time"] == pytest.approx(when(1.2, -0.9, 0.0), abs=EXACT)
    assert loss["x"] == pytest.approx([0.0], abs=EXACT)
    result = rp.check_plan(plan, dynamics)
    assert result.passed
    assert result.closure_rank == (loss,)
