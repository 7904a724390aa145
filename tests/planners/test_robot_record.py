"""What a record says of its robot: units of efforts and limits by kind of joint, and a short ``repr``."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import redundancy_pin as rp
from redundancy_pin.io.archive import read_archive, write_archive
from redundancy_pin.planners.robot_record import RobotRecord, read_robot, record_difference, robot_record
from redundancy_pin.robot import Coupling


def mixed() -> RobotRecord:
    """A slide and a hinge of each role."""
    return RobotRecord("bot", "", {}, (0.0, 0.0, 0.0), (), ("slide", "hinge"), ("shoe", "wheel"), ("hinge", "wheel"),
                       (), ((1.0,) * 10,), (0.0,))  # fmt: skip


@pytest.mark.parametrize(
    ("joints", "unit"),
    [(("slide",), "N"), (("hinge", "wheel"), "N·m"), (("slide", "hinge"), "N or N·m"), ((), "N")],
)
def test_units_of_efforts(joints: tuple[str, ...], unit: str) -> None:
    assert mixed().effort_unit(*joints) == unit


@pytest.mark.parametrize(
    ("quantity", "sliding", "turning"),
    [
        ("track", "m", "rad"),
        ("speed", "m/s", "rad/s"),
        ("acceleration", "m/s²", "rad/s²"),
        ("jerk", "m/s³", "rad/s³"),
        ("force", "N", "N·m"),
        ("effort", "N", "N·m"),
    ],
)
def test_units_of_limits(quantity: str, sliding: str, turning: str) -> None:
    assert mixed().limit_unit(quantity, "shoe") == sliding
    assert mixed().limit_unit(quantity, "wheel") == turning


def coupled(ratio: float = 2.0, upper: float = 1.5) -> rp.Robot:
    """Two hinges, the second of which follows the first."""
    model = pin.Model()
    for name in ("motor", "geared"):
        joint = model.addJoint(model.njoints - 1, pin.JointModelRZ(), pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 0.1 * np.eye(3)), pin.SE3.Identity())
    model.lowerPositionLimit[:], model.upperPositionLimit[:] = [-1.0, -np.inf], [1.0, upper]
    couplings = [Coupling("gears", "geared", "motor", (0.0, ratio))]
    return rp.robot_from_model(model, name="coupled", actuated=["motor"], closures=[], couplings=couplings)


def test_couplings_and_ranges_tell_robots_apart() -> None:
    record = robot_record(coupled())
    assert record.couplings == (Coupling("gears", "geared", "motor", (0.0, 2.0)),)
    assert record.ranges == (("motor", -1.0, 1.0), ("geared", -np.inf, 1.5))
    assert record.describes(coupled())
    assert not record_difference(record, robot_record(coupled(2.0 + 1e-12)))  # arithmetic of another machine
    for off, same in ((4e-16, True), (1e-8, False)):  # the last step of Newton's method, and another geometry
        assert replace(record, q_reference=tuple(q + off for q in record.q_reference)).describes(coupled()) is same
    for other, says in (
        (coupled(2.5), "coupling 'gears' was geared, motor, 0, 2, now geared, motor, 0, 2.5"),
        (coupled(upper=1.2), "range of the joint 'geared' was -inf, 1.5, now -inf, 1.2"),
    ):
        assert not record.describes(other)
        assert says in record_difference(record, robot_record(other))
        assert says not in record_difference(robot_record(other), record)
    bare = replace(record, couplings=(), ranges=())
    assert "'gears' was none, now geared" in record_difference(bare, record)
    assert "'gears' was geared, motor, 0, 2, now none" in record_difference(record, bare)


def _record_of(tmp_path: Path, record: RobotRecord) -> RobotRecord:
    write_archive(tmp_path / "record.npz", "record", 1, record)
    return read_archive(
        tmp_path / "record.npz", "record", 1, "record", lambda values: read_robot(values, tmp_path / "record.npz")
    )


def test_couplings_and_ranges_go_through_files(tmp_path: Path) -> None:
    record = robot_record(coupled())
    again = _record_of(tmp_path, record)
    assert (again.couplings, again.ranges) == (record.couplings, record.ranges)
    assert again.describes(coupled())


def test_arguments_that_came_since_count_unless_they_are_as_usual() -> None:
    """An argument may change lengths, which a record does not hold otherwise."""
    robot = rp.load_robot("2rpr")
    record = robot_record(robot)
    older = replace(record, arguments={k: v for k, v in record.arguments.items() if k != "end_effector_carriers"})
    assert older.describes(robot)
    other = replace(robot, parameters={**robot.parameters, "end_effector_carriers": True})
    assert not older.describes(other)
    assert "arguments" in record_difference(older, robot_record(other))


def test_loads_tell_robots_without_arguments_apart() -> None:
    robot = coupled()
    assert not robot_record(robot).arguments
    loaded = robot_record(robot.loaded(rp.JointForces("motor", friction=1.0)))
    assert record_difference(robot_record(robot), loaded).startswith("its loads were ()")
    assert not record_difference(loaded, loaded)
