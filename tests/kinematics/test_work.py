"""How much work kinematics take: configurations evaluated, counted. A worse guess or step is still right in the end.

A count may be 5 % more than it was when it was written down here: the last step of Newton's method is a matter of
rounding.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import spatial_chains
import zoo
from folding import folding_four_bar

import redundancy_pin as rp
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.closing import close
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.kinematics.multistart import multistart
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import closure_tolerance, velocity_unit

MORE = 1.05


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Callable[..., int]:
    """Run something, and return at how many configurations it evaluates closures."""

    def count(action: Callable[[], Any]) -> int:
        action()  # what is done once per robot does not count
        calls = 0
        evaluate, place = ConstraintSystem.evaluate, ClosedChain.place

        def evaluated(self: ConstraintSystem, q: np.ndarray, *rest: Any) -> Any:
            nonlocal calls
            calls += len(q)
            return evaluate(self, q, *rest)

        def placed(self: ClosedChain, q: np.ndarray) -> None:
            nonlocal calls
            calls += 1
            place(self, q)

        with monkeypatch.context() as patch:
            patch.setattr(ConstraintSystem, "evaluate", evaluated)
            patch.setattr(ClosedChain, "place", placed)
            action()
        return calls

    return count


def at_most(found: int, expected: int) -> None:
    assert found <= MORE * expected
    assert found >= 0.7 * expected, "less than was written down: write down what it takes now"


DENSE = {"2rpr": 2123, "3rrr": 2510, "five_bar": 2131, "four_bar": 2100, "gough": 2140}
SPARSE = {"2rpr": 32, "3rrr": 80, "five_bar": 32, "four_bar": 64, "gough": 88}
"""Configurations at which closures are evaluated along 1,000 samples and along 7: two or three a step."""


def even(count: int) -> np.ndarray:
    return np.linspace(0.0, 2.0, count)


def test_dense_and_sparse_motions_take_few_newton_steps(shipped: Robot, counted: Callable[..., int]) -> None:
    motion = zoo.smooth_motion(shipped, 1)
    dense, sparse = (counted(lambda t=t: inverse_kinematics(shipped, motion.at(t))) for t in map(even, (1000, 7)))
    at_most(dense, DENSE[shipped.name])
    at_most(sparse, SPARSE[shipped.name])


def test_next_to_full_stretch_steps_get_shorter(counted: Callable[..., int]) -> None:
    robot = zoo.robot_of("five_bar")
    y = np.linspace(0.76, np.sqrt(1.0 - 0.25**2) - 1e-6, 50)
    x = np.stack([np.full(50, 0.25), y], axis=1)
    motion = rp.PlatformMotion(np.arange(50.0), x, np.zeros((50, 2)), np.zeros((50, 2)), check_rates=False)
    at_most(counted(lambda: inverse_kinematics(robot, motion)), 422)


def test_a_rank_loss_is_crossed_on_a_line_of_nodes(counted: Callable[..., int], tmp_path: Path) -> None:
    robot = folding_four_bar(tmp_path, (0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5))
    angle = np.pi + np.linspace(-1.0, 1.0, 11)[:, None] + 0.033
    motion = rp.PlatformMotion(np.arange(11.0), angle, np.ones((11, 1)), np.zeros((11, 1)), check_rates=False)
    at_most(counted(lambda: inverse_kinematics(robot, motion)), 291)


def test_a_goal_out_of_reach_is_given_up_at_the_border(counted: Callable[..., int]) -> None:
    """Whole steps to the border, and one search there; halved steps would creep up to it."""
    own = follower(zoo.robot_of("five_bar"))
    at_most(counted(lambda: own.advance(own.home, own.home.x + np.array([0.0, 1.0]))), REACHED[0])
    at_most(counted(lambda: own.advance(own.home, np.array([0.25, np.sqrt(1.0 - 0.25**2)]))), REACHED[1])


REACHED = 111, 103
"""Configurations on the way to a pose beyond the border, and to full stretch itself."""


def test_searches_take_a_few_dozen_starts(counted: Callable[..., int]) -> None:
    robot = zoo.robot_of("3rrr", carriers=False)
    system = zoo.system_of(robot)
    far = zoo.home_of(robot) + np.array([0.1, 0.05, 0.2])
    at_most(counted(lambda: multistart(system, -np.array(robot.q_reference), far)), 202)


CLOSING = {"universal": 108, "hinge": 97, "cylindrical": 62, "continuous": 56}


@pytest.mark.parametrize("name", CLOSING)
def test_loops_are_closed_from_afar_in_few_steps(name: str, counted: Callable[..., int]) -> None:
    """From joints up to 1.5 rad or characteristic lengths off, and never the wrong way round."""
    robot = spatial_chains.chain_of(name)
    system, rng, closed = zoo.system_of(robot), np.random.default_rng(0), []
    offs = rng.uniform(-1.5, 1.5, (8, robot.model.nv)) * velocity_unit(robot)
    starts = [pin.integrate(robot.model, np.array(robot.q_reference), off) for off in offs]
    at_most(counted(lambda: closed.extend(close(system, start) for start in starts)), CLOSING[name])
    assert all(gap < closure_tolerance(robot) for _, gap in closed)
    assert system.misalignment(system.evaluate(np.array([q for q, _ in closed]))).max() < 1e-9


def test_loops_too_far_apart_to_close_are_given_up_in_a_few_dozen_steps(counted: Callable[..., int]) -> None:
    """A rocker that is hinged ten metres away: the nearest that the links come to each other is left open."""
    robot = spatial_chains.chain_of("universal")
    model = pin.Model(robot.model)
    moved = pin.SE3(model.jointPlacements[model.getJointId("rocker")])
    moved.translation = moved.translation + np.array([10.0, 0.0, 0.0])
    model.jointPlacements[model.getJointId("rocker")] = moved
    system, q = ConstraintSystem(replace(robot, model=model)), np.array(robot.q_reference)
    at_most(counted(lambda: close(system, q)), 25)
    # along a line: ten metres and a half, less 0.2 + 0.6 m of crank and coupler and 0.4 m of rocker, 0.3 m aside
    assert 8.0 < close(system, q)[1] < 11.0
