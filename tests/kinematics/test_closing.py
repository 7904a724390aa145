"""Hinges and welds closed from far away: steps turn the frames together the short way."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from written import J, urdf_of, write_robot

from redundancy_pin import load_robot
from redundancy_pin.kinematics.closing import close, closed_near
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import position_unit

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
    """Either way round; the sines of rows say that nothing is open there."""
    robot = arm(tmp_path, kind, 1.0)
    q = np.zeros(robot.model.nq)
    over = next(name for name in ("turn_z", "turn_y") if name[-1] != kind[-1])
    q[zoo.index(robot, over)] = np.pi
    assert apart(robot, q, kind)[1] == pytest.approx(np.pi)
    assert max(apart(robot, close(ConstraintSystem(robot), q)[0], kind)) < CLOSED


@pytest.mark.parametrize("target", [(1.0, 0.0), (-1.2, 0.0), (0.3, 0.0)])
def test_loops_that_no_step_leads_to_are_closed_from_beside(tmp_path: Path, target: tuple[float, float]) -> None:
    """Two stretched bars of 1 m in line with where their end belongs: no small turn brings it nearer."""
    joints = [
        J("first", "revolute", "base", "one"),
        J("elbow", "revolute", "one", "two", (1.0, 0.0, 0.0)),
        J("end", "fixed", "two", "tip", (1.0, 0.0, 0.0)),
        J("place", "fixed", "base", "pin", (*target, 0.0)),
        J("other", "revolute", "base", "away", (0.0, 1.0, 0.0)),
    ]
    declaration = {
        "closures": [{"frames": ["tip", "pin"], "axes": ["x", "y"]}],
        "actuated": ["other"],
        "independent": {"joints": ["other"]},
        "reference": {"joints": {"other": 0.0}, "guess": {"first": 0.4, "elbow": -0.8}},
    }
    robot = load_robot(write_robot(tmp_path, urdf_of(joints), declaration))
    places = [zoo.index(robot, name) for name in ("first", "elbow")]
    first, elbow = closed_near(robot, np.zeros(robot.model.nq))[places]
    end = np.array([np.cos(first) + np.cos(first + elbow), np.sin(first) + np.sin(first + elbow)])
    np.testing.assert_allclose(end, target, atol=1e-10)
