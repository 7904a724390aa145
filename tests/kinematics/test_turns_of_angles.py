"""Whole turns of passive angles, scattered starts, and the gap of loops that do not close: in closed form."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import zoo
from written import J, urdf_of, write_robot

from redundancy_pin import load_robot
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.multistart import draw_starts, wrapped

TURN = 2.0 * np.pi


def limited(lower: float, upper: float):
    """The five-bar with limits of a passive elbow, and the place of that in q."""
    robot = zoo.robot_of("five_bar")
    name = next(str(name) for name in list(robot.model.names)[1:] if str(name).startswith("elbow"))
    robot = robot.with_limits({name: {"lower": lower, "upper": upper}})
    return robot, zoo.index(robot, name)


@pytest.mark.parametrize(
    ("limits", "angle", "guess", "expected"),
    [
        # within half a turn, whatever the turn; half a turn itself is the positive one
        ((-10.0, 10.0), 1.0 + 2 * TURN, None, 1.0),
        ((-10.0, 10.0), -1.0 - 3 * TURN, None, -1.0),
        ((-10.0, 10.0), np.pi, None, np.pi),
        ((-10.0, 10.0), -np.pi, None, np.pi),
        ((-10.0, 10.0), 3.0, None, 3.0),
        ((-10.0, 10.0), -3.0, None, -3.0),
        ((-10.0, 10.0), 4.0, None, 4.0 - TURN),
        # allowed as it is: the guess does not count
        ((-10.0, 10.0), 1.0, 7.0, 1.0),
        # beyond a limit: the turn of the guess, where that is within
        ((3.5, 6.0), 4.0, 4.5, 4.0),
        ((3.5, 6.0), 4.0 - TURN, 4.5, 4.0),
        ((-6.0, -3.5), -4.0, -4.5, -4.0),
        ((-6.0, -3.5), TURN - 4.0, -4.5, -4.0),
        ((9.0, 14.0), 4.0, 10.0, 4.0 + TURN),
        # not within there either
        ((3.5, 3.9), 4.0, 4.5, 4.0 - TURN),
        # the very limit is within
        ((1.0, 2.0), 1.0, 7.0, 1.0),
        ((1.0, 2.0), 2.0, 7.0, 2.0),
        ((4.0, 6.0), 4.0, 4.0, 4.0),
        ((3.5, 4.0), 4.0, 4.0, 4.0),
    ],
)
def test_passive_angles_are_of_the_turn_that_is_allowed(limits, angle, guess, expected):
    """Exactly at limits the numbers are moved by their own rounding, so that these are of whole floats."""
    robot, at = limited(*limits)
    q = np.array(robot.q_reference)[None].copy()
    q[0, at] = angle
    near = None if guess is None else np.array(robot.q_reference)
    if near is not None:
        near[at] = guess
    found = wrapped(robot, q, near)
    assert found[0, at] == pytest.approx(expected, abs=1e-14)
    assert q[0, at] == angle  # what was given stays


@pytest.mark.parametrize("name", ["five_bar", "2rpr", "3rrr"])
@pytest.mark.parametrize("spread", [0.2, 1.5])
def test_scattered_configurations_are_as_far_away_as_is_said(name, spread):
    """Angles by the spread in rad, slides by the spread of the characteristic length; carriers stay."""
    robot = zoo.robot_of(name)
    system = ConstraintSystem(robot)
    q = np.array(robot.q_reference)
    away = draw_starts(system, q, 2000, np.random.default_rng(1), turn=spread, slide=spread) - q
    for number, joint in enumerate(robot.model.joints):
        if not number or joint.nq != 1:
            continue
        most = np.abs(away[:, joint.idx_q]).max()
        if joint.idx_v in robot.carrier_velocity:
            assert most == 0.0
        else:
            size = robot.characteristic_length if "P" in str(joint.shortname()).removeprefix("JointModel") else 1.0
            # the largest of 2000 even numbers is within 1 % of their bound
            assert 0.99 * spread * size < most <= spread * size * (1.0 + 1e-12)
            # as many to either side, within three deviations of the mean
            assert abs(away[:, joint.idx_q].mean()) < 3.0 * spread * size / np.sqrt(3.0 * 2000)


@pytest.mark.parametrize("apart", [2.5, 3.0])
def test_the_gap_that_is_left_is_what_bars_lack(tmp_path: Path, apart: float) -> None:
    """Two bars of 1 m, and two hinges farther apart than both: stretched they lack the rest, in m."""
    joints = [
        J("first", "revolute", "base", "one"),
        J("elbow", "revolute", "one", "two", (1.0, 0.0, 0.0)),
        J("end", "fixed", "two", "tip", (1.0, 0.0, 0.0)),
        J("place", "fixed", "base", "pin", (apart, 0.0, 0.0)),
        J("other", "revolute", "base", "away", (0.0, 1.0, 0.0)),
    ]
    declaration = {
        "closures": [{"frames": ["tip", "pin"], "axes": ["x", "y"]}],
        "actuated": ["other"],
        "independent": {"joints": ["other"]},
        "redundant_rows": True,
        "reference": {"joints": {"other": 0.0}, "guess": {"first": 0.4, "elbow": -0.8}},
    }
    with pytest.raises(DeclarationError, match="do not close") as caught:
        load_robot(write_robot(tmp_path, urdf_of(joints), declaration))
    # a gap is the largest part along an axis of the frame, which in a plane is no less than the whole over root 2
    assert (apart - 2.0) / np.sqrt(2.0) <= caught.value.details["gap"] <= 1.01 * (apart - 2.0)
