"""Roles of joints and frames against the URDF: kinds of joints that cannot play them, names met twice, references."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin import load_robot
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.robot import Robot

FIVE_BAR = [
    J("base_1", "revolute", "base", "upper_1"),
    J("elbow_1", "revolute", "upper_1", "lower_1", (0.5, 0, 0)),
    J("tip_1_mount", "fixed", "lower_1", "tip_1", (0.5, 0, 0)),
    J("base_2", "revolute", "base", "upper_2", (0.5, 0, 0)),
    J("elbow_2", "revolute", "upper_2", "lower_2", (0.5, 0, 0)),
    J("tip_2_mount", "fixed", "lower_2", "tip_2", (0.5, 0, 0)),
]
RIDER = J("rider", "prismatic", "lower_1", "mass", axis=(1, 0, 0))
DECLARATION: dict[str, Any] = {
    "closures": [{"frames": ["tip_1", "tip_2"], "axes": ["x", "y"]}],
    "actuated": ["base_1", "base_2"],
    "independent": {"platform": "tip_1", "axes": ["x", "y"]},
    "reference": {"platform": [0.25, 0.7], "guess": {"base_1": 2.0, "elbow_1": -1.0, "base_2": 1.0, "elbow_2": 1.0}},
}


def load(folder: Path, joints: list[J], **changes: object) -> Robot:
    return load_robot(write_robot(folder, urdf_of(joints), {**DECLARATION, **changes}))


GUESS = {"platform": [0.25, 0.7], "guess": {"ball": 0.1}}
HELD = {"joints": {"base_1": 0, "ball": 0}}


@pytest.mark.parametrize(
    ("kind", "changes", "message"),
    [
        ("floating", {"actuated": ["base_1", "ball"]}, "'ball' has 6 freedoms"),
        ("floating", {"carriers": [{"joint": "ball", "position": [-1, 1]}]}, "'ball' has 6 freedoms"),
        ("floating", {"independent": {"joints": ["base_1", "ball"]}, "reference": HELD}, "'ball' has 6 freedoms"),
        ("floating", {"reference": GUESS}, "cannot set joint 'ball': it has 7 coordinates"),
        ("continuous", {"carriers": [{"joint": "ball"}]}, "'ball' is a continuous joint.*bounded"),
    ],
)
def test_joints_that_cannot_play_a_role(kind: str, changes: dict[str, Any], message: str, tmp_path: Path) -> None:
    with pytest.raises(DeclarationError, match=message):
        load(tmp_path, [*FIVE_BAR, J("ball", kind, "lower_1", "satellite")], **changes)


@pytest.mark.parametrize("position", [None, (-100.0 * (1.0 + 1e-12), 100.0), (-0.2, 100.01), (-100.01, 0.2)])
def test_the_track_of_a_carrier_is_within_the_limits_of_its_joint(
    position: tuple[float, float] | None, tmp_path: Path
) -> None:
    """It may be rounded, as of an expression; left out, it is the limits."""
    carriers = [{"joint": "rider", "position": position and list(position)}]
    given = [*FIVE_BAR, RIDER], [{key: value for key, value in carriers[0].items() if value}]
    if position and 100.01 in np.abs(position):
        with pytest.raises(DeclarationError, match=r"100\.01.*'rider'.*-100 and 100"):
            load(tmp_path, given[0], carriers=given[1])
    else:
        limits = load(tmp_path, given[0], carriers=given[1]).carrier_limits[0]
        assert (limits.lower, limits.upper) == (position or (-100.0, 100.0))
        assert (limits.speed, limits.force, limits.acceleration) == (10.0, 10.0, np.inf)


def test_a_carrier_whose_urdf_gives_no_track_is_refused(tmp_path: Path) -> None:
    urdf = urdf_of([*FIVE_BAR, RIDER]).replace('lower="-100" upper="100" ', "")
    with pytest.raises(DeclarationError, match="'rider' runs from -inf to inf"):
        load_robot(write_robot(tmp_path, urdf, DECLARATION | {"carriers": [{"joint": "rider"}]}))


def test_a_mimic_joint_that_leaves_no_freedom_is_refused_not_ignored(tmp_path: Path) -> None:
    urdf = urdf_of(FIVE_BAR)
    name = '<joint name="elbow_2"'
    cut = urdf.index(name)
    urdf = urdf[:cut] + urdf[cut:].replace("</joint>", '<mimic joint="elbow_1"/></joint>', 1)
    with pytest.raises(DeclarationError, match="over-constrained"):
        load_robot(write_robot(tmp_path, urdf, DECLARATION))


def test_a_platform_that_tilts_has_the_angle_about_one_base_axis(tmp_path: Path) -> None:
    """A hinge at q about (0, 0.6, 0.8) brings the hand's x axis to (cos q, 0.8 sin q, ·): tan rz = 0.8 tan q."""
    slanted = [J("arm", "revolute", "base", "arm_link", axis=(0, 0.6, 0.8)), J("mount", "fixed", "arm_link", "hand")]
    robot = load(
        tmp_path,
        slanted,
        closures=[],
        actuated=["arm"],
        independent={"platform": "hand", "axes": ["rz"]},
        reference={"platform": [0.5]},
    )
    rz = np.linspace(0.5, 6.5, 60)
    tree = inverse_kinematics(robot, rp.PlatformMotion(rz, rz[:, None], np.full((60, 1), 1.5), np.full((60, 1), -2.0)))
    sine, cosine = np.sin(rz), np.cos(rz)
    square = 0.64 * cosine**2 + sine**2
    slope, bend = 0.8 / square, -0.8 * 2.0 * sine * cosine * 0.36 / square**2
    np.testing.assert_allclose(np.tan(tree.q[:, 0]), np.tan(rz) / 0.8, rtol=1e-9)
    np.testing.assert_allclose(tree.v[:, 0], 1.5 * slope, rtol=1e-11)
    np.testing.assert_allclose(tree.a[:, 0], -2.0 * slope + 2.25 * bend, rtol=1e-11)


@pytest.mark.parametrize("size", [1.0, 1e5])
def test_freedoms_are_counted_alike_in_any_unit_of_length(tmp_path: Path, size: float) -> None:
    """A slide that a closure of its own holds, and one that nothing does: beside hinges of 0.5 m, or so many 10 µm."""
    joints = [replace(each, xyz=tuple(size * part for part in each.xyz)) for each in FIVE_BAR]
    held = [J("bolt", "prismatic", "base", "bolt", axis=(1, 0, 0)), J("mark", "fixed", "base", "mark")]
    closures = [*DECLARATION["closures"], {"frames": ["bolt", "mark"], "axes": ["x"]}]
    reference = {**DECLARATION["reference"], "platform": [0.25 * size, 0.7 * size]}
    given = {"closures": closures, "reference": reference, "characteristic_length": size}
    with pytest.raises(DeclarationError, match=r"these joints still move: rider\. Add") as caught:
        load(tmp_path, [*joints, *held, RIDER], **given)
    assert [caught.value.details[key] for key in ("freedoms", "declared", "rank")] == [3, 2, 3]


def test_indices_of_roles_are_those_of_the_model() -> None:
    """A continuous joint has two coordinates and one velocity: behind it q and v are counted apart."""
    model = pin.Model()
    for kind, name in ((pin.JointModelRUBZ(), "spin"), (pin.JointModelPX(), "slide"), (pin.JointModelRZ(), "arm")):
        model.addJoint(0, kind, pin.SE3.Identity(), name)
    robot = replace(rp.load_robot("four_bar"), model=model, actuated=("arm", "spin"), carriers=("slide",))
    assert robot.actuated_velocity.tolist() == [2, 0]
    assert (robot.carrier_velocity.tolist(), robot.carrier_position.tolist()) == ([1], [2])
