"""Moving links whose mass the file does not state are reported once, by name; links stated to be massless are not."""

from __future__ import annotations

import logging
import re
from pathlib import Path

import pytest
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


def test_the_user_is_told_so_once(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    path = write_robot(tmp_path, link(urdf_of(JOINTS), "rocker", ""), DECLARATION)
    with caplog.at_level(logging.WARNING, "redundancy_pin"):
        for _ in range(2):
            note = note_of(rp.load_robot(path))
    assert [record.getMessage() for record in caplog.records if "<inertial>" in record.getMessage()] == [
        f"robot.urdf: {note}"
    ]


@pytest.mark.parametrize("name", shipped_robots())
def test_shipped_robots_state_all_masses(name: str) -> None:
    """With their carriers too."""
    known = rp.load_robot(name).parameters
    switches = {key: True for key in ("carriers", "rod_carriers", "end_effector_carriers") if key in known}
    for each in (rp.load_robot(name, **switches), rp.load_robot(name)):
        assert not note_of(each)
