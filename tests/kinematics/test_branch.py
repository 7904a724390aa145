"""Following a branch: each step ends where assembly closes, on the branch of the start, or is refused."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import zoo
from flat_linkages import row_of_four_bars
from folding import folding_four_bar

import redundancy_pin as rp
from redundancy_pin.errors import InputError, SingularPoseError
from redundancy_pin.kinematics.branch import (
    BranchEnd,
    ClosedState,
    follower,
)
from redundancy_pin.kinematics.coordinates import with_independent_joints
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.robot import Payload
from redundancy_pin.status import SampleStatus


@pytest.mark.parametrize("independent", [{"joints": ["a", "b"]}, {"platform": "tip", "axes": ["x", "y"]}])
def test_a_chain_without_closures_is_followed(independent: dict[str, Any]) -> None:
    """Two links in a plane, whose tip is where trigonometry puts it."""
    model = pin.Model()
    for parent, name in enumerate("ab"):
        zoo.add_body(model, parent, pin.JointModelRZ(), float(parent), 0.0, name)
    model.addBodyFrame("tip", 2, pin.SE3(np.eye(3), np.array([0.8, 0.0, 0.0])), 0)
    reference = {"guess": {"a": 0.3, "b": 0.5}, **({} if "joints" in independent else {"platform": [1.5, 0.9]})}
    robot = rp.robot_from_model(model, actuated=["a", "b"], independent=independent, reference=reference)
    own = follower(robot)
    x = own.home.x + np.array([0.02, -0.01])
    reached = own.advance(own.home, x)
    assert isinstance(reached, ClosedState)
    a, b = reached.q
    tip = [np.cos(a) + 0.8 * np.cos(a + b), np.sin(a) + 0.8 * np.sin(a + b)]
    np.testing.assert_allclose([a, b] if "joints" in independent else tip, x, atol=1e-12)


def test_a_state_that_the_branch_contradicts_is_refused() -> None:
    own = follower(zoo.robot_of("3rrr"))
    x = own.home.x + np.array([0.01, 0.0, 0.0])
    assert own.step(own.home, x) is not None
    assert own.step(replace(own.home, gamma=3.0 * own.home.gamma), x) is None


def along(*x: float) -> np.ndarray:
    return np.array(x)


REACH = np.sqrt(1.0 - 0.25**2)
"""Height on the axis of symmetry at which both legs of the five-bar are stretched: 1 m legs, hinges 0.5 m apart."""


@pytest.mark.parametrize(
    ("x", "status"),
    [
        (along(0.25, 1.5), SampleStatus.UNREACHABLE),
        (along(0.25, REACH), SampleStatus.TYPE_I),
        (-0.5 * zoo.home_of(zoo.robot_of("five_bar")), SampleStatus.BRANCH_LOST),  # through the hinge of the first leg
        (along(np.nan, 0.5), SampleStatus.NOT_FINITE),
    ],
)
def test_a_branch_that_ends_says_why_and_where(x: np.ndarray, status: SampleStatus) -> None:
    own = follower(zoo.robot_of("five_bar"))
    end = own.advance(own.home, x)
    assert isinstance(end, BranchEnd)
    assert end.status is status
    assert not end.rank_lost
    np.testing.assert_array_equal(end.x, x)
    if status is SampleStatus.NOT_FINITE:
        return
    assert end.is_final == (status is not SampleStatus.BRANCH_LOST)
    # shared by the rows of closures and target: legs at 14.5° to the axis
    assert (end.residual > 0.1) == (status is SampleStatus.UNREACHABLE)
    way = x - own.home.x
    done = (end.last.x - own.home.x) @ way / (way @ way)
    assert 0.0 <= done < 1.0
    np.testing.assert_allclose(end.last.x, own.home.x + done * way, atol=1e-12)
    assert isinstance(own.advance(own.home, end.last.x), ClosedState)


def test_a_state_keeps_no_array_that_others_change() -> None:
    own = follower(zoo.robot_of("five_bar"))
    x = np.array(own.home.x) + 0.01
    states = own.close(own.home.q, x), own.step(own.home, x), own.singular_state(x, *map(np.array, (own.home.q, x)))
    x[0] = 9.0
    for state in states:
        assert state is not None
        assert state.x[0] == own.home.x[0] + 0.01
        assert not any(part.flags.writeable for part in (state.x, state.q, state.gamma, state.inverse))


@pytest.mark.parametrize("beside", [0.0, 1e-6, -1e-6])
def test_no_plain_step_leads_to_a_rank_loss(beside: float, tmp_path: Path) -> None:
    """Newton's rounding shows in the rates there; ``pass_through`` has the state and its rates, ``rates`` refuses."""
    robot = folding_four_bar(tmp_path, (0.4, 0.2, 0.35, 0.25), (1.0, 1.9, 1.5))
    own = follower(robot)
    before = own.advance(own.home, np.array([np.pi - 0.05]))
    assert isinstance(before, ClosedState)
    plain = own.step(before, np.array([np.pi + beside]))
    assert plain is None or plain.margin < own.near
    passed = own.pass_through(before, np.array([np.pi + beside]), np.ones(1), np.zeros(1))
    assert passed is not None
    assert passed.state.interpolated
    with pytest.raises(SingularPoseError, match="pass_through"):
        own.rates(passed.state, np.ones(1), np.zeros(1))


@pytest.mark.parametrize("length", [1.0, 2.0**5])
@pytest.mark.parametrize("side", [1.0, -1.0])
def test_a_step_across_a_rank_loss_stays_on_the_smooth_branch(length: float, side: float) -> None:
    """A parallelogram through its flat pose: coupler and crank go on turning against each other, in any unit."""
    robot = row_of_four_bars(1, crank=length, coupler=length)
    own = follower(robot)
    turn = np.array([1.0 if name.startswith("crank") else -1.0 for name in list(robot.model.names)[1:]])
    before = own.close(side * 0.03 * turn, np.array([side * 0.03]))
    assert before is not None
    assert before.margin == pytest.approx(0.03, rel=1.0)
    for goal in (-0.03, -0.01, 0.01, 0.0):
        reached = own.advance(before, np.array([side * goal]))
        assert isinstance(reached, ClosedState)
        np.testing.assert_allclose(reached.q, side * goal * turn, atol=1e-9)
        np.testing.assert_allclose(reached.gamma[:, 0], turn, atol=1e-7)


@pytest.mark.parametrize("excess", [1e-6, 1e-7, 1e-8, 1e-9])
@pytest.mark.parametrize("count", [2, 7, 40])
def test_no_branch_is_changed_where_two_nearly_touch(excess: float, count: int, tmp_path: Path) -> None:
    """The coupler stays on its side of a four-bar that misses its flat pose by a little: followed, or given up."""
    robot = folding_four_bar(tmp_path, (0.4, 0.2, 0.35, 0.25 + excess), (1.0, 1.9, 1.5))
    own, coupler = follower(robot), zoo.index(robot, "coupler")
    here = own.advance(own.home, np.array([np.pi - 0.02]))
    assert isinstance(here, ClosedState)
    side = np.sign(np.sin(here.q[coupler]))
    for angle in np.linspace(np.pi - 0.02, np.pi + 0.02, count)[1:]:
        reached = own.advance(here, np.array([angle]))
        if isinstance(reached, BranchEnd):
            break
        here = reached
        assert np.sign(np.sin(here.q[coupler])) == side


def test_states_and_coordinates_that_do_not_fit_are_refused() -> None:
    """Another shape, no pose, another robot, or the same tree and loops with other independent coordinates."""
    own, gough = follower(zoo.robot_of("five_bar")), follower(zoo.robot_of("gough"))
    home, short = own.home, along(0.4)
    for call in (own.advance, own.step, lambda here, x: own.pass_through(here, x, *np.zeros((2, 2)))):
        with pytest.raises(InputError, match=r"x has shape \(1,\), expected \(2,\)"):
            call(home, short)
    for call, message in (
        (lambda: own.close(home.q, short), r"x has shape \(1,\), expected \(2,\)"),
        (lambda: own.state_at(np.zeros(3)), r"q has shape \(3,\)"),
        (lambda: own.advance(home, home.x + 1j), "complex"),
        (lambda: own.rates(home, np.array(1.0), along(0.0, 0.0)), r"xd has shape \(\), expected \(2,\)"),
        (lambda: own.rates(home, along(0.0, 0.0), along(np.nan, 0.0)), "xdd has 1 value"),
    ):
        with pytest.raises(InputError, match=message):
            call()
    for factor in (np.diag([2.0, 2.0, 2.0, 1.0]), np.diag([1.0, 1.0, -1.0, 1.0]), 2.0 * np.eye(4)):
        with pytest.raises(InputError, match="not a homogeneous pose"):
            gough.advance(gough.home, gough.home.x @ factor)
    motion = rp.PlatformMotion([0.0], home.x[None], *np.zeros((2, 1, 2)))
    for name in ("delta", "four_bar"):
        other = follower(zoo.robot_of(name)).home
        for go_on in (own.advance, own.follow, own.step):
            with pytest.raises(InputError, match=f"{name}.*five_bar"):
                go_on(other, home.x)
        with pytest.raises(InputError, match=f"{name}.*five_bar"):
            inverse_kinematics(own.robot, motion, start=other, mark_unreachable=True)
    driven = follower(with_independent_joints(own.robot, own.robot.actuated))
    with pytest.raises(InputError, match="no closed state"):
        driven.advance(home, driven.home.x)
    loaded = follower(own.robot.loaded(Payload("end_effector", 1.0)))
    assert isinstance(loaded.advance(home, loaded.home.x + 0.01), ClosedState)
