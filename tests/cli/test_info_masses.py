"""What ``redundancy-pin info`` says of masses and of the efforts that hold a robot, worked out by hand."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from command_line import call
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.robot import Payload

ROUNDING = 1e-9
"""Relative, of a closed formula against numbers that Newton's method closed to 1e-11."""

GRAVITY = 9.81


def facts_of(*arguments: str) -> dict:
    return json.loads(call("info", *arguments, "--json").stdout)


def test_bodies_are_those_of_the_file_with_what_is_fixed_to_them(tmp_path: Path) -> None:
    """The five-bar: rods of 0.5 kg, a point of 0.2 kg fixed to the end of one of them (Steiner)."""
    facts = facts_of("--robot", "five_bar")
    bodies = {body["name"]: body for body in facts["bodies"]}
    assert set(bodies) == {"proximal_1", "distal_1", "proximal_2", "distal_2"}
    assert facts["moving_mass"] == pytest.approx(2.2, rel=ROUNDING)
    assert facts["moving_weight"] == 0.0  # it lies flat, without gravity
    assert facts_of("--robot", "five_bar", "--gravity", "0,0,-9.81")["moving_weight"] == pytest.approx(
        2.2 * GRAVITY, rel=ROUNDING
    )
    rod, tip, length = 0.5, 0.2, 0.5
    plain, heavy = bodies["distal_2"], bodies["distal_1"]
    np.testing.assert_allclose(plain["centre"], [length / 2, 0, 0], rtol=ROUNDING)
    np.testing.assert_allclose(plain["principal_moments"], [0, *[rod * length**2 / 12] * 2], rtol=ROUNDING)
    assert heavy["mass"] == pytest.approx(rod + tip, rel=ROUNDING)
    centre = (rod * length / 2 + tip * length) / (rod + tip)
    moment = rod * length**2 / 12 + rod * (centre - length / 2) ** 2 + tip * (length - centre) ** 2
    np.testing.assert_allclose(heavy["centre"], [centre, 0, 0], rtol=ROUNDING)
    np.testing.assert_allclose(heavy["principal_moments"], [0, moment, moment], rtol=ROUNDING, atol=1e-15)
    assert "end_effector" in heavy["links"]
    text = call("info", "--robot", "five_bar").stdout
    assert "distal_1 with end_effector" in text
    assert "2.2 kg" in text

    robot = rp.load_robot("five_bar")
    assert [body.name for body in robot.bodies] == [body["name"] for body in facts["bodies"]]
    loaded = robot.loaded(Payload("end_effector", 0.3))
    assert loaded.moving_mass == pytest.approx(2.5, rel=ROUNDING)


def crank_drive(folder: Path, scale: float = 1.0) -> Path:
    """Write a four-bar with a centre of mass beside the line of each link; lengths times a scale."""
    joints = [
        J("crank", "revolute", "base", "crank"),
        J("knee", "revolute", "crank", "coupler", (0.1, 0, 0)),
        J("rocker", "revolute", "base", "rocker", (0.3, 0, 0)),
        J("coupler_end", "fixed", "coupler", "coupler_tip", (0.3, 0, 0)),
        J("rocker_end", "fixed", "rocker", "rocker_tip", (0.2, 0, 0)),
    ]
    return write_robot(
        folder,
        urdf_of(joints, mass=0.7),
        {
            "closures": [{"frames": ["coupler_tip", "rocker_tip"], "axes": ["x", "y"]}],
            "gravity": [0, -GRAVITY, 0],
            "actuated": ["crank"],
            "independent": {"joints": ["crank"]},
            "reference": {"joints": {"crank": 1.0}, "guess": {"knee": -0.6, "rocker": 1.4}},
        },
    )


def potential(angle: complex) -> complex:
    """Return the potential energy of that four-bar, J: circles about the ends of coupler and rocker meet above."""
    knee, hinge = 0.1 * np.exp(1j * angle), 0.3
    away = hinge - knee
    apart = abs(away)
    along = (0.3**2 - 0.2**2 + apart**2) / (2.0 * apart)
    tip = knee + away / apart * (along + 1j * np.sqrt(0.3**2 - along**2))
    turns = np.exp(1j * angle), (tip - knee) / abs(tip - knee), (tip - hinge) / abs(tip - hinge)
    centres = [at + turn * (0.1 + 0.02j) for at, turn in zip((0.0, knee, hinge), turns, strict=True)]
    return 0.7 * GRAVITY * sum(centre.imag for centre in centres)


def test_the_holding_torque_is_the_slope_of_the_potential(tmp_path: Path) -> None:
    facts = facts_of("--robot", str(crank_drive(tmp_path)))
    holding = facts["reference"]["holding"]
    step = 1e-5
    expected = (potential(1.0 + step) - potential(1.0 - step)) / (2.0 * step)
    assert abs(expected) > 0.5
    assert holding["status"] == "ok"
    assert [(each["joint"], each["unit"]) for each in holding["efforts"]] == [("crank", "N·m")]
    assert holding["efforts"][0]["effort"] == pytest.approx(expected, rel=1e-8)  # of a central difference
    assert f"{expected:.6g} N·m" in call("info", "--robot", str(tmp_path / "robot.yaml")).stdout


def test_carriers_are_held_too_and_forces_have_their_unit() -> None:
    """A carrier of the 2-RPR moves across its leg, which leans by the angle of its swivel: m g cos of it."""
    facts = facts_of("--robot", "2rpr", "--gravity", "0,-9.81,0")
    efforts = {each["joint"]: each for each in facts["reference"]["holding"]["efforts"]}
    assert {each["unit"] for each in efforts.values()} == {"N"}
    lean = np.arctan2(0.4, 0.25)
    for name in ("carrier_1", "carrier_2"):
        assert abs(efforts[name]["effort"]) == pytest.approx(GRAVITY * np.cos(lean), rel=ROUNDING)


def test_what_cannot_be_held_has_its_status(tmp_path: Path) -> None:
    """A crank at the top of a slider is held by anything, a swing without motor by nothing: NaN, null in JSON."""
    joints = [J("swing", "revolute", "base", "arm"), J("motor", "revolute", "base", "wheel", (1.0, 0, 0))]
    path = write_robot(
        tmp_path,
        urdf_of(joints),
        {
            "gravity": [0, -GRAVITY, 0],
            "actuated": ["motor"],
            "independent": {"joints": ["swing", "motor"]},
            "reference": {"joints": {"swing": 0.3, "motor": 0.2}},
        },
    )
    holding = facts_of("--robot", str(path))["reference"]["holding"]
    assert holding["status"] == "underactuated"
    assert holding["efforts"][0]["effort"] is None
    text = call("info", "--robot", str(path)).stdout
    assert "underactuated" in text
    assert "nan N·m" in text


def test_bodies_are_shown_in_any_unit(tmp_path: Path) -> None:
    """Masses, moments and efforts of small machines are not rounded to zero."""
    tiny = (
        urdf_of([J("swing", "revolute", "base", "arm")], mass=3e-14).replace("0.02", "2e-17").replace("0.03", "3e-17")
    )
    path = write_robot(
        tmp_path,
        tiny.replace("0.025", "2.5e-17"),
        {
            "gravity": [0, -GRAVITY, 0],
            "actuated": ["swing"],
            "independent": {"joints": ["swing"]},
            "reference": {"joints": {"swing": 0.0}},
        },
    )
    text = call("info", "--robot", str(path)).stdout
    assert "3e-14" in text
    assert f"{3e-14 * GRAVITY * 0.1:.6g} N·m" in text
