"""Moving links whose mass the file does not state are reported once, by name; links stated to be massless are not."""

from __future__ import annotations

import json
import logging
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import call
from written import FOUR_BAR, J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.robot import Robot
from redundancy_pin.robot.urdf import shipped_robots

JOINTS = (*FOUR_BAR, J("plate", "fixed", "base", "ground_plate", (0.2, 0, 0)))
DECLARATION = {
    "closures": [{"frames": ["coupler_tip", "rocker_tip"], "axes": ["x", "y"]}],
    "gravity": [0, -9.81, 0],
    "actuated": ["crank"],
    "independent": {"joints": ["crank"]},
    "reference": {"joints": {"crank": 1.0}, "guess": {"knee": -0.6, "rocker": 1.4}},
}
SHAPE = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
COLLISION = '<collision><geometry><box size="1 1 1"/></geometry></collision>'
NO_MASS = '<inertial><mass value="0"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>'


def link(urdf: str, name: str, content: str) -> str:
    """Return a URDF in which a link holds something else."""
    new, count = re.subn(rf'<link name="{name}">.*?</link>', f'<link name="{name}">{content}</link>', urdf)
    assert count == 1
    return new


def note_of(robot: Robot) -> str:
    """Return the note on masses that the file does not state; empty if there is none."""
    notes = [note for note in robot.notes if "<inertial>" in note]
    assert len(notes) <= 1
    return "".join(notes)


def reported(folder: Path, **contents: str) -> str:
    """Return the names that the note of the four-bar lists; empty without a note."""
    urdf = urdf_of(JOINTS)
    for name, content in contents.items():
        urdf = link(urdf, name, content)
    return note_of(rp.load_robot(write_robot(folder, urdf, DECLARATION))).partition(": ")[2].partition(". ")[0]


@pytest.mark.parametrize(
    ("contents", "names"),
    [
        ({}, ""),
        ({"crank": ""}, "crank"),
        ({"crank": "", "rocker": SHAPE}, "crank, rocker"),
        ({"crank": NO_MASS, "rocker": SHAPE + NO_MASS}, ""),
        ({"coupler_tip": ""}, ""),  # a mark
        ({"coupler_tip": SHAPE}, "coupler_tip"),  # something that is there, and weighs nothing
        ({"coupler_tip": COLLISION}, "coupler_tip"),
        ({"ground_plate": SHAPE}, ""),  # does not move
        ({"coupler": "", "coupler_tip": NO_MASS.replace('mass value="0"', 'mass value="1"')}, ""),  # of one body
    ],
)
def test_links_are_named(contents: dict[str, str], names: str, tmp_path: Path) -> None:
    assert reported(tmp_path, **contents) == names


def test_the_mass_counts_as_zero_and_the_user_is_told_so_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """In Python by a note and one line of the log; on the command line on stderr, beside whatever was asked for."""
    bare = link(urdf_of(JOINTS), "rocker", "")
    stated = link(urdf_of(JOINTS), "rocker", NO_MASS)
    robots = []
    for name, urdf in (("bare", bare), ("stated", stated)):
        (tmp_path / name).mkdir()
        robots.append(rp.load_robot(write_robot(tmp_path / name, urdf, DECLARATION | {"name": name})))
    t = np.linspace(0.0, 1.0, 21)
    motion = rp.PlatformMotion(t, 1.0 + t[:, None] ** 2, 2.0 * t[:, None], np.full((21, 1), 2.0))
    efforts = [rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau for robot in robots]
    np.testing.assert_array_equal(*efforts)
    assert not note_of(robots[1])

    (tmp_path / "once").mkdir()
    path = write_robot(tmp_path / "once", bare.replace("rocker_end", "mark"), DECLARATION)
    (tmp_path / "once" / "robot.urdf").rename(tmp_path / "once" / "once.urdf")
    path.write_text(path.read_text(encoding="utf-8").replace("robot.urdf", "once.urdf"), encoding="utf-8")
    caplog.clear()
    with caplog.at_level(logging.WARNING, "redundancy_pin"):
        told = json.loads(call("info", "--robot", path, "--json").stdout)
        call("info", "--robot", path)
    lines = [record.getMessage() for record in caplog.records if "<inertial>" in record.getMessage()]
    assert len(lines) == 1
    assert lines[0].startswith("once.urdf: ")
    assert "rocker" in lines[0]
    assert "crank" not in lines[0]
    assert sum("<inertial>" in note for note in told["notes"]) == 1


@pytest.mark.parametrize("name", shipped_robots())
def test_shipped_robots_state_all_masses(name: str) -> None:
    """With their carriers too."""
    known = rp.load_robot(name).parameters
    switches = {key: True for key in ("carriers", "rod_carriers", "end_effector_carriers") if key in known}
    for each in (rp.load_robot(name, **switches), rp.load_robot(name)):
        assert not note_of(each)
