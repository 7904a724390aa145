"""Loops closed from far away, the search for a pose in the working mode, and the turns of what is found."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import zoo
from written import J, urdf_of, write_robot

from redundancy_pin import load_robot
from redundancy_pin.arrays import CLOSURE_TOLERANCE
from redundancy_pin.errors import DeclarationError, WorkingModeError
from redundancy_pin.kinematics import inverse_kinematics as branch
from redundancy_pin.kinematics import multistart as search_module
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.closing import close, closed_near
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import in_working_mode, working_modes
from redundancy_pin.kinematics.inverse_kinematics import point_on_branch
from redundancy_pin.kinematics.multistart import draw_starts, mixed_legs, multistart, wrapped
from redundancy_pin.robot import Robot
from redundancy_pin.robot.changes import with_limits
from redundancy_pin.robot.scales import position_unit

TURN = 2.0 * np.pi
AXES = np.eye(3)
CLOSED = 1e-9  # m or rad: the closure tolerance, as Pinocchio's placements show it

AXES_OF = {
    "hinge about x": ("x", "y", "z", "ry", "rz"),
    "hinge about y": ("x", "y", "z", "rx", "rz"),
    "hinge about z": ("x", "y", "z", "rx", "ry"),
    "weld": ("x", "y", "z", "rx", "ry", "rz"),
}


def arm(folder: Path, kind: str, size: float) -> Robot:
    """A body with all six freedoms, welded or hinged to a seat that turns too; ``size`` m count as a radian."""
    names = ["slide_x", "slide_y", "slide_z", "turn_z", "turn_y", "turn_x"]
    links = ["base", *(f"after_{name}" for name in names)]
    joints = [
        J(name, "prismatic" if i < 3 else "revolute", links[i], links[i + 1], axis=AXES["xyz".index(name[-1])].tolist())
        for i, name in enumerate(names)
    ]
    joints.append(J("carry", "revolute", "base", "seat", axis=(0.6, 0.0, 0.8)))
    independent = ["carry"] if kind == "weld" else ["carry", f"turn_{kind[-1]}"]
    declaration = {
        "closures": [{"frames": ["seat", links[-1]], "axes": list(AXES_OF[kind])}],
        "actuated": independent,
        "independent": {"joints": independent},
        "reference": {"joints": dict.fromkeys(independent, 0.0)},
        "characteristic_length": size,
    }
    return load_robot(write_robot(folder, urdf_of(joints), declaration))


def apart(robot: Robot, q: np.ndarray, kind: str) -> tuple[float, float]:
    """How far the frames are from each other, m, and by which angle they, or their hinges' axes, are turned away."""
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, q)
    ends = robot.closures[0].frame_a, robot.closures[0].frame_b
    a, b = (data.oMf[robot.model.getFrameId(name, pin.FrameType.BODY)] for name in ends)
    turn = a.rotation.T @ b.rotation
    if kind == "weld":
        return float(np.linalg.norm(a.translation - b.translation)), float(np.linalg.norm(pin.log3(turn)))
    k = "xyz".index(kind[-1])
    sine = np.linalg.norm(np.cross(turn[:, k], AXES[k]))
    return float(np.linalg.norm(a.translation - b.translation)), float(np.arctan2(sine, turn[k, k]))


@pytest.mark.parametrize("kind", AXES_OF)
@pytest.mark.parametrize("size", [0.25, 1.0, 4.0])
def test_frames_far_away_are_turned_together(tmp_path: Path, kind: str, size: float) -> None:
    """From anywhere within 1.2 rad and characteristic lengths, and never the wrong way round."""
    robot = arm(tmp_path, kind, size)
    system, rng = ConstraintSystem(robot), np.random.default_rng(4)
    for _ in range(12):
        reached, gap = close(system, rng.uniform(-1.2, 1.2, robot.model.nq) * position_unit(robot))
        assert gap < CLOSED
        assert max(apart(robot, reached, kind)) < CLOSED


@pytest.mark.parametrize("kind", ["hinge about x", "hinge about y", "hinge about z"])
def test_hinges_that_are_opposite_turn_over(tmp_path: Path, kind: str) -> None:
    """Either way round; the sines of rows say that nothing is open there. Followers refuse such a configuration."""
    robot = arm(tmp_path, kind, 1.0)
    q = np.zeros(robot.model.nq)
    over = next(name for name in ("turn_z", "turn_y") if name[-1] != kind[-1])
    q[zoo.index(robot, over)] = np.pi
    assert apart(robot, q, kind)[1] == pytest.approx(np.pi)
    assert max(apart(robot, close(ConstraintSystem(robot), q)[0], kind)) < CLOSED
    own = follower(robot)
    assert own.close(own.home.q, own.home.x) is not None
    assert own.close(q, own.home.x) is None


def two_bars(folder: Path, end: tuple[float, float]) -> Robot:
    """Load two bars of 1 m, the first hinged to the base and the second to a place (x, y), m."""
    joints = [
        J("first", "revolute", "base", "one"),
        J("elbow", "revolute", "one", "two", (1.0, 0.0, 0.0)),
        J("end", "fixed", "two", "tip", (1.0, 0.0, 0.0)),
        J("place", "fixed", "base", "pin", (*end, 0.0)),
        J("other", "revolute", "base", "away", (0.0, 1.0, 0.0)),
    ]
    declaration = {
        "closures": [{"frames": ["tip", "pin"], "axes": ["x", "y"]}],
        "actuated": ["other"],
        "independent": {"joints": ["other"]},
        "redundant_rows": True,
        "reference": {"joints": {"other": 0.0}, "guess": {"first": 0.4, "elbow": -0.8}},
    }
    return load_robot(write_robot(folder, urdf_of(joints), declaration))


@pytest.mark.parametrize("target", [(1.0, 0.0), (-1.2, 0.0), (0.3, 0.0)])
def test_loops_that_no_step_leads_to_are_closed_from_beside(tmp_path: Path, target: tuple[float, float]) -> None:
    """The bars are stretched in line with where their end belongs: no small turn brings it nearer."""
    robot = two_bars(tmp_path, target)
    first, elbow = closed_near(robot, np.zeros(robot.model.nq))[[zoo.index(robot, name) for name in ("first", "elbow")]]
    end = np.array([np.cos(first) + np.cos(first + elbow), np.sin(first) + np.sin(first + elbow)])
    np.testing.assert_allclose(end, target, atol=1e-10)


def test_the_gap_that_is_left_is_what_bars_lack(tmp_path: Path) -> None:
    """Two hinges farther apart than both bars: stretched they lack the rest, in m."""
    with pytest.raises(DeclarationError, match="do not close") as caught:
        two_bars(tmp_path, (3.0, 0.0))
    # a gap is the largest part along an axis of the frame, which in a plane is no less than the whole over root 2
    assert 1.0 / np.sqrt(2.0) <= caught.value.details["residual"] <= 1.01


def test_behind_an_obstacle_the_search_takes_over() -> None:
    """The straight way of the 2-RPR from home runs through the base hinge of leg 1, where the branch ends."""
    robot = zoo.robot_of("2rpr")
    system = zoo.system_of(robot)
    behind = -0.5 * zoo.home_of(robot)
    q = point_on_branch(system, behind).q
    assert in_working_mode(robot, q[None])[0]
    slides = [zoo.index(robot, f"slide_{leg}") for leg in (1, 2)]
    np.testing.assert_allclose(q[slides], [np.hypot(*behind), np.hypot(*(behind - [0.5, 0.0]))], atol=1e-10)


def test_only_other_modes_close_is_said_so(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fault injected: the search finds closed configurations, but none that counts as the right mode."""
    robot = zoo.robot_of("five_bar")
    nowhere = lambda robot, q: np.zeros(len(q), dtype=bool)  # noqa: E731
    monkeypatch.setattr(branch, "in_working_mode", nowhere)
    monkeypatch.setattr(search_module, "in_working_mode", nowhere)
    with pytest.raises(WorkingModeError, match=r"closes only in other working modes than \+- of five_bar") as caught:
        point_on_branch(zoo.system_of(robot), zoo.home_of(robot), sample=2)
    assert caught.value.details["sample"] == 2
    assert "working_mode" in caught.value.remedy


def test_search_prefers_the_solution_nearest_to_the_guess(shipped: Robot) -> None:
    system = zoo.system_of(shipped)
    q, gap, closed = multistart(system, np.array(shipped.q_reference), zoo.home_of(shipped))
    assert closed
    assert gap < CLOSURE_TOLERANCE
    np.testing.assert_allclose(q, shipped.q_reference, atol=1e-9)


def test_search_finds_the_same_of_its_mode_every_time_from_a_guess_in_another() -> None:
    robot = zoo.robot_of("3rrr", working_mode=(1, -1, 1))
    guess = np.array(zoo.robot_of("3rrr", working_mode=(-1, 1, -1)).q_reference)
    first, second = (multistart(zoo.system_of(robot), guess, zoo.home_of(robot)) for _ in range(2))
    assert first.in_mode
    np.testing.assert_array_equal(working_modes(robot, first.q[None])[0], [1, -1, 1])
    np.testing.assert_array_equal(first.q, second.q)


def test_search_returns_angles_within_a_turn() -> None:
    robot = zoo.robot_of("3rrr")
    wound = np.array(robot.q_reference)
    wound[robot.actuated_velocity] += 2 * np.pi
    q, _, closed = multistart(zoo.system_of(robot), wound, zoo.home_of(robot))
    assert closed
    assert np.abs(q).max() <= np.pi


def test_search_turns_joints_all_around_whatever_the_characteristic_length() -> None:
    """A characteristic length of exactly 1 m must not make angles look like lengths."""
    robot = replace(zoo.robot_of("3rrr"), characteristic_length=1.0, working_mode=(-1, -1, -1))
    q, _, closed = multistart(ConstraintSystem(robot), np.array(robot.q_reference), zoo.home_of(zoo.robot_of("3rrr")))
    assert closed
    np.testing.assert_array_equal(working_modes(robot, q[None])[0], [-1, -1, -1])


@pytest.mark.long_for("mode0", "mode1")
@pytest.mark.parametrize("mode", [(-1, -1, -1, -1, -1, -1), (1, -1, 1, 1, -1, -1), (-1, 1, 1, -1, 1, 1)])
def test_every_mode_of_six_legs_is_found_for_other_lengths(mode: tuple[int, ...]) -> None:
    """One random start in 64 falls to a given mode of six legs: they are put together leg by leg."""
    robot = load_robot("gough", base_radius=0.7, platform_radius=0.27, height=0.52, working_mode=mode)
    assembled = zoo.system_of(robot).evaluate(np.array(robot.q_reference)[None])
    assert np.abs(assembled.phi).max() < CLOSURE_TOLERANCE
    np.testing.assert_array_equal(working_modes(robot, np.array(robot.q_reference)[None])[0], mode)
    lengths = [robot.q_reference[zoo.index(robot, f"slide_{leg}")] for leg in range(1, 7)]
    np.testing.assert_array_equal(np.sign(lengths), mode)


def test_legs_are_not_mixed_where_one_is_right_in_none() -> None:
    robot = zoo.robot_of("3rrr", working_mode=(1, 1, 1))
    other = zoo.robot_of("3rrr", working_mode=(-1, 1, 1))
    guess, q = np.array(robot.q_reference), np.array(other.q_reference)
    assert mixed_legs(robot, q[None], guess) is None
    assert mixed_legs(robot, q[None][:0], guess) is None
    third = np.array(zoo.robot_of("3rrr", working_mode=(1, -1, 1)).q_reference)
    mixed = mixed_legs(robot, np.array([q, third]), guess)
    np.testing.assert_array_equal(working_modes(robot, mixed[None])[0], [1, 1, 1])
    assert np.abs(zoo.system_of(robot).evaluate(mixed[None]).phi).max() < CLOSURE_TOLERANCE


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
    robot = with_limits(zoo.robot_of("five_bar"), {"elbow_1": {"lower": limits[0], "upper": limits[1]}})
    at = zoo.index(robot, "elbow_1")
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
    system = zoo.system_of(robot)
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
