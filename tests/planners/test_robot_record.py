"""What a record says of its robot: units of efforts and limits by kind of joint, and a short ``repr``."""

from __future__ import annotations

import pytest
import zoo

from redundancy_pin.planners.robot_record import RobotRecord, robot_record


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


def test_shipped_robots_slide_and_turn() -> None:
    two, three = robot_record(zoo.robot_of("2rpr")), robot_record(zoo.robot_of("3rrr"))
    assert (two.effort_unit(*two.actuated), three.effort_unit(*three.actuated)) == ("N", "N·m")
    assert three.effort_unit(*three.carriers) == "N"


def test_the_record_prints_without_its_mass_properties() -> None:
    assert repr(robot_record(zoo.robot_of("3rrr"))) == "RobotRecord('3rrr', m=3, k=3, source='3rrr')"
