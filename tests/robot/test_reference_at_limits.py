"""A joint at its limit is within it, however its position was rounded, in any unit of length; beyond it is beyond."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from command_line import call
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.errors import CarrierLimitError, InputError
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.controllers.base import Constant
from redundancy_pin.status import ResultStatus, SampleStatus

SLACK = 1e-9
"""Of the machine's length, and rad: what counts as rounding of a position that Newton's method found to 1e-11."""

FILE = 1e-3
"""Of the machine's length, and rad: what counts as rounding of a file's numbers, with a note."""

SCALES = (1e-3, 1.0, 1e3)
"""Lengths in km, m and mm."""


def slider(folder: Path, scale: float, slide: tuple[float, float], knee: tuple[float, float]) -> Path:
    """Write a crank of 0.3 upright on the ground, a coupler of 0.5, and a slide that is at 0.4 (3, 4, 5)."""
    joints = [
        J("crank", "revolute", "base", "crank"),
        J("knee", "revolute", "crank", "coupler", (0.3 * scale, 0, 0)),
        J("slide", "prismatic", "base", "block", axis=(1, 0, 0)),
        J("end", "fixed", "coupler", "coupler_end", (0.5 * scale, 0, 0)),
    ]
    urdf = urdf_of(joints).replace("0.1 0.02 0.03", f"{0.1 * scale!r} 0 0")
    for name, (lower, upper) in (("slide", slide), ("knee", knee)):
        head, tail = urdf.split(f'<joint name="{name}"')
        limits = f'lower="{lower!r}" upper="{upper!r}"'
        urdf = f'{head}<joint name="{name}"' + tail.replace('lower="-100" upper="100"', limits, 1)
    return write_robot(
        folder,
        urdf,
        {
            "closures": [{"frames": ["coupler_end", "block"], "axes": ["x", "y"]}],
            "actuated": ["crank"],
            "independent": {"joints": ["crank"]},
            "reference": {"joints": {"crank": np.pi / 2}, "guess": {"knee": -2.2, "slide": 0.4 * scale}},
        },
    )


KNEE = -float(np.pi / 2 + np.arctan2(3.0, 4.0))
"""rad; from the upright crank to the coupler, which goes down by 3 over 4."""


def verdicts(path: Path, robot: Robot) -> dict[str, bool]:
    """Return whether each part of the package takes the reference to be within all limits."""
    shown = call("info", "--robot", path).stdout
    still = np.zeros((1, 1))
    motion = rp.PlatformMotion([0.0], [[np.pi / 2]], still, still)
    try:
        run = rp.simulate(robot, Constant(np.zeros(1), np.zeros(0)), duration=0.05)
        simulated = run.status is ResultStatus.OK and not run.events
    except InputError:
        simulated = False
    driven = rp.forward_kinematics(robot, np.full((1, 1), np.pi / 2))
    return {
        "info": "(outside)" not in shown,
        "inverse_kinematics": not rp.inverse_kinematics(robot, motion).out_of_range[0],
        "efforts": rp.distribute(rp.RneaDynamics(robot).reduce(motion)).status_labels[0] != "out_of_range",
        "forward kinematics": driven.status[0] == SampleStatus.OK,
        "simulation": simulated,
    }


@pytest.mark.long_for("knee-1.0-upper")
@pytest.mark.parametrize(
    ("joint", "scale", "end"),
    [
        ("slide", 1e-3, "lower"),
        ("slide", 1.0, "upper"),
        ("slide", 1e3, "lower"),
        ("knee", 1.0, "lower"),
        ("knee", 1.0, "upper"),
    ],
)
def test_limits_at_the_reference(joint: str, end: str, scale: float, tmp_path: Path) -> None:
    """Exactly there, rounded to either side, beyond by four fifths of the slack; by the rounding of a file; by more."""
    size = scale if joint == "slide" else 1.0
    at, inwards = (0.4 * scale, 0.4 * scale) if joint == "slide" else (KNEE, 0.5)
    probe = rp.load_robot(slider(tmp_path, scale, (-scale, scale), (-3.0, 0.0)))
    unit = probe.characteristic_length if joint == "slide" else 1.0
    assert 0.05 * scale < probe.characteristic_length < scale
    rounded = [(way * 1e-16 * size, True) for way in (-1.0, 1.0) if scale == 1.0]
    amounts = [
        (0.8 * SLACK * unit, True),
        (3.0 * SLACK * unit, True),
        (0.1 * FILE * unit, True),
        (1.2 * FILE * unit, False),
    ]
    for beyond, inside in (*rounded, (0.0, True), *amounts):
        sign = 1.0 if end == "lower" else -1.0
        ends = at + sign * beyond, at + sign * inwards
        ranges = {"slide": (-scale, scale), "knee": (-3.0, 0.0), joint: (min(ends), max(ends))}
        path = slider(tmp_path, scale, ranges["slide"], ranges["knee"])
        robot = rp.load_robot(path)
        found = verdicts(path, robot)
        assert set(found.values()) == {inside}, (beyond, found)
        noted = [note for note in robot.notes if note.startswith("Limits that the reference misses by rounding")]
        assert len(noted) == (SLACK * unit < beyond < FILE * unit)
        if noted:
            assert f"{end} of {joint!r} by {beyond:.1g} {'m' if joint == 'slide' else 'rad'}" in noted[0]


def test_a_short_stroke_is_not_widened(tmp_path: Path) -> None:
    """A stroke of 1e-4 of the machine's length that the reference misses by as much: no rounding."""
    robot = rp.load_robot(slider(tmp_path, 1.0, (0.4001, 0.4002), (-3.0, 0.0)))
    at = robot.model.joints[robot.model.getJointId("slide")].idx_q
    assert (robot.model.lowerPositionLimit[at], robot.model.upperPositionLimit[at]) == (0.4001, 0.4002)


@pytest.mark.parametrize("scale", SCALES)
def test_carriers_at_the_ends_of_their_tracks(scale: float) -> None:
    """The same slack for the tracks of carriers, which a motion of the carriers is checked against."""
    lengths = ("base_distance", "proximal_length", "distal_length", "tail_length")
    robot = rp.load_robot("five_bar", carriers=True, **dict.fromkeys(lengths, 0.5 * scale))
    slack, still = SLACK * robot.characteristic_length, np.zeros((1, 2))
    motion = rp.PlatformMotion([0.0], [[0.25 * scale, 0.7 * scale]], still, still)
    dynamics = rp.RneaDynamics(robot)
    for side in (-1.0, 1.0):
        for beyond in (0.0, 0.8 * slack):
            dynamics.reduce(motion, rp.CarrierMotion([[0.0, side * (0.5 * scale + beyond)]], still, still))
        with pytest.raises(CarrierLimitError, match="carrier_2"):
            dynamics.reduce(motion, rp.CarrierMotion([[0.0, side * (0.5 * scale + 3.0 * slack)]], still, still))
