"""Poses where the closures lose rank on the way of a plan are named: flat parallelograms, whose flat angle is known."""

from __future__ import annotations

import json

import numpy as np
import pytest
import zoo
from click.testing import CliRunner
from flat_linkages import four_bar, parallelogram, row_of_four_bars

import redundancy_pin as rp
from redundancy_pin.cli import main
from redundancy_pin.planners.intersample_check import closure_rank_losses
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import reference
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


# the rank loss on a sample, between two samples, and two of them; angles are measured from the line of the base hinges
@pytest.mark.long_for("1.2--4.0-flat2")
@pytest.mark.parametrize(
    ("first", "last", "flat"),
    [(1.0, -1.0, [0.0]), (1.2, 3.9, [np.pi]), (1.2, -4.0, [0.0, -np.pi]), (1.2, 0.3, [])],
)
def test_time_and_pose_of_each_rank_loss_are_named(first: float, last: float, flat: list[float]) -> None:
    dynamics, motion = rp.RneaDynamics(parallelogram()), swing(first, last)
    margin = dynamics.along(motion).closure_margin()
    # where two branches cross the determinant changes its sign, and the ratio of singular values is small
    assert margin[0] * margin[-1] * (-1.0) ** len(flat) > 0.0
    assert all(np.abs(margin[np.abs(motion.x[:, 0] - angle).argmin()]) < 0.05 for angle in flat)
    crossings = closure_rank_losses(dynamics, dynamics.along(motion), as_motion(motion))
    np.testing.assert_allclose([loss["time"] for loss in crossings], [when(first, last, a) for a in flat], atol=EXACT)
    np.testing.assert_allclose(np.ravel([loss["x"] for loss in crossings]), flat, atol=EXACT)


@pytest.mark.long
def test_two_loops_that_are_flat_at_once_are_one_pose() -> None:
    """The determinant keeps its sign there: it is a product of two that change theirs."""
    dynamics, motion = rp.RneaDynamics(row_of_four_bars(2)), swing(1.2, -0.9)
    crossings = closure_rank_losses(dynamics, dynamics.along(motion), as_motion(motion))
    assert [loss["time"] for loss in crossings] == pytest.approx([when(1.2, -0.9, 0.0)], abs=1e-4)


def test_a_linkage_that_is_never_flat_has_none() -> None:
    """A crank that turns: the shortest and the longest side are together shorter than the other two."""
    dynamics, motion = rp.RneaDynamics(four_bar((1.0, 3.0, 3.0, 4.0), 1.2, 1)), swing(1.2, 7.0)
    assert closure_rank_losses(dynamics, dynamics.along(motion), as_motion(motion)) == []


def test_plans_and_their_check_name_it() -> None:
    dynamics, motion = rp.RneaDynamics(parallelogram("carrier")), swing(1.2, -0.9)
    plan = rp.plan_stepwise(dynamics, motion, limits=rp.Limits(acceleration=50.0), brake_time=0.1)
    (loss,) = plan.diagnostics["closure_rank"]  # type: ignore[misc]
    assert loss["time"] == pytest.approx(when(1.2, -0.9, 0.0), abs=EXACT)
    assert loss["x"] == pytest.approx([0.0], abs=EXACT)
    result = rp.check_plan(plan, dynamics)
    assert result.passed
    assert result.closure_rank == (loss,)


def test_the_shipped_robots_have_none_and_the_command_says_so(tmp_path) -> None:  # type: ignore[no-untyped-def]
    plan = rp.plan_stepwise(rp.RneaDynamics(zoo.robot_of("3rrr")), reference.corner(), dt=0.02)
    assert plan.diagnostics["closure_rank"] == []
    assert plan.status is ResultStatus.OK
    plan.save(tmp_path / "plan.npz")
    out = CliRunner().invoke(main, ["check", str(tmp_path / "plan.npz"), "--json"])
    assert json.loads(out.stdout)["closure_rank"] == []


def test_a_backend_that_does_not_know_says_nothing() -> None:
    dynamics = rp.CompiledDynamics(zoo.robot_of("3rrr"))
    assert np.isnan(dynamics.along(reference.corner().sample(0.1)).closure_margin()).all()
    assert rp.plan_stepwise(dynamics, reference.corner(), dt=0.1).diagnostics["closure_rank"] == []
