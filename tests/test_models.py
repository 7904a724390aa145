"""Shipped models as Pinocchio reads them, against yourdfpy and against geometry worked out by hand.

yourdfpy parses the same URDF text on its own: kinematics through its scene graph, inertias straight from the tags.
Pinocchio merges rigidly attached links into one body; the merge is redone here with Steiner's theorem.
"""

from __future__ import annotations

import io
import json
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
from command_line import call

import redundancy_pin as rp
from redundancy_pin.robot import Robot
from redundancy_pin.robot.shipped import shipped_robots

ROUNDING = 1e-12
"""Both sides evaluate the same closed formula on numbers of order one; chains are at most nine joints long."""

CLOSED = 1e-10
"""Joint values found by Newton to a closure gap of 1e-11, times a condition number below ten."""

VARIANTS: list[tuple[str, dict[str, object]]] = [
    ("2rpr", {}),
    ("2rpr", {"carriers": False, "end_effector_mass": 0.7}),
    ("2rpr", {"cylinder_mass": 0.4, "piston_mass": 0.3, "end_effector_mass": 0.2, "track_offset": 0.05}),
    ("2rpr", {"end_effector_carriers": True}),
    ("2rpr", {"arm_length": 0.15, "end_effector_carriers": True}),
    ("3rrr", {}),
    ("3rrr", {"carriers": False}),
    ("3rrr", {"arm_length": 0.2}),
    ("3rrr", {"platform_inertia": 0.02, "tail_length": 0.6, "carrier_mass": 1.5}),
    ("five_bar", {}),
    ("five_bar", {"carriers": True}),
    ("five_bar", {"carriers": True, "base_distance": 0.3, "distal_length": 0.6, "tail_length": 0.2}),
    ("four_bar", {}),
    ("four_bar", {"crank_length": 0.12, "rocker_mass": 0.9}),
    ("gough", {}),
    ("gough", {"payload_mass": 2.0, "payload_height": 0.3, "base_angle": 0.15, "height": 0.7}),
    ("gough", {"carriers": True, "track_angle": 0.4, "track_offset": 0.25}),
    ("3rps", {}),
    ("3rps", {"platform_radius": 0.15, "height": 0.6}),
    ("ankle", {}),
    ("delta", {}),
    ("delta", {"carriers": True}),
    ("delta", {"rod_carriers": True}),
    ("excavator", {}),
    ("two_arms", {}),
    ("walking_leg", {}),
]


THESIS = ("2rpr", "3rrr")
"""The machines of the thesis, which are about carriers."""


class Loaded(NamedTuple):
    """One model through both readers."""

    robot: Robot
    other: yourdfpy.URDF

    def joint(self, name: str) -> pin.JointModel:
        return _joint(self.robot, name)


def _joint(robot: Robot, name: str) -> pin.JointModel:
    return robot.model.joints[robot.model.getJointId(name)]


def _at_reference(robot: Robot, names: list[str]) -> np.ndarray:
    """Return the values of some joints in the reference configuration."""
    return robot.q_reference[[_joint(robot, name).idx_q for name in names]]


def _load(name: str, arguments: dict[str, object]) -> Loaded:
    robot = rp.load_robot(name, **arguments)
    return Loaded(robot, yourdfpy.URDF.load(io.BytesIO(robot.urdf.encode()), load_meshes=False))


def _label(variant: tuple[str, dict[str, object]]) -> str:
    name, arguments = variant
    return "-".join([name, *(f"{key}={value}" for key, value in arguments.items())])


@pytest.fixture(scope="module", params=VARIANTS, ids=_label)
def loaded(request: pytest.FixtureRequest) -> Loaded:
    return _load(*request.param)


def test_every_shipped_robot_has_a_variant_here() -> None:
    assert {name for name, _ in VARIANTS} == set(shipped_robots())


def test_both_readers_see_the_same_joints(loaded: Loaded) -> None:
    assert set(loaded.robot.model.names) - {"universe"} == set(loaded.other.actuated_joint_names)
    assert loaded.robot.model.nq == loaded.robot.model.nv == len(loaded.other.actuated_joint_names)


def test_carriers_argument_removes_the_carriers(loaded: Loaded) -> None:
    sliding = {name for name in loaded.other.actuated_joint_names if "carrier_" in name}
    assert set(loaded.robot.carriers) == sliding
    wanted = [value for key, value in loaded.robot.parameters.items() if key == "carriers" or key.endswith("_carriers")]
    assert bool(sliding) == any(wanted)


def test_forward_kinematics_of_every_link(loaded: Loaded) -> None:
    model = loaded.robot.model
    data = model.createData()
    rng = np.random.default_rng(20)
    for _ in range(5):
        q = rng.uniform(-3.0, 3.0, model.nq)
        loaded.other.update_cfg({name: q[loaded.joint(name).idx_q] for name in loaded.other.actuated_joint_names})
        pin.framesForwardKinematics(model, data, q)
        for link in loaded.other.link_map:
            ours = data.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous
            np.testing.assert_allclose(ours, loaded.other.get_transform(link), atol=ROUNDING, rtol=0, err_msg=link)


def test_joint_limits(loaded: Loaded) -> None:
    model = loaded.robot.model
    for name in loaded.other.actuated_joint_names:
        limit, joint = loaded.other.joint_map[name].limit, loaded.joint(name)
        assert model.lowerPositionLimit[joint.idx_q] == limit.lower
        assert model.upperPositionLimit[joint.idx_q] == limit.upper
        assert model.velocityLimit[joint.idx_v] == limit.velocity
        assert model.effortLimit[joint.idx_v] == limit.effort


def test_mass_and_inertia_of_every_body(loaded: Loaded) -> None:
    model = loaded.robot.model
    for name in loaded.other.actuated_joint_names:
        mass, moment, inertia = _body(loaded.other, loaded.other.joint_map[name].child)
        ours = model.inertias[model.getJointId(name)]
        about_joint = ours.inertia + ours.mass * _steiner(ours.lever)
        np.testing.assert_allclose(ours.mass, mass, atol=ROUNDING, rtol=0, err_msg=name)
        np.testing.assert_allclose(ours.mass * ours.lever, moment, atol=ROUNDING, rtol=0, err_msg=name)
        np.testing.assert_allclose(about_joint, inertia, atol=ROUNDING, rtol=0, err_msg=name)


def _steiner(arm: np.ndarray) -> np.ndarray:
    """Return the inertia (3, 3) about the origin of a unit point mass at ``arm``."""
    return arm @ arm * np.eye(3) - np.outer(arm, arm)


def _body(urdf: yourdfpy.URDF, link: str) -> tuple[float, np.ndarray, np.ndarray]:
    """Return mass, first moment and inertia about ``link`` of it and all links fixed to it, in its frame."""
    mass, moment, inertia = 0.0, np.zeros(3), np.zeros((3, 3))
    pending = [(link, np.eye(4))]
    while pending:
        name, placement = pending.pop()
        inertial = urdf.link_map[name].inertial
        if inertial is not None:
            com = placement if inertial.origin is None else placement @ inertial.origin
            arm, rotation = com[:3, 3], com[:3, :3]
            mass += inertial.mass
            moment = moment + inertial.mass * arm
            inertia = inertia + rotation @ inertial.inertia @ rotation.T + inertial.mass * _steiner(arm)
        for joint in urdf.joint_map.values():
            if joint.parent == name and joint.type == "fixed":
                pending.append((joint.child, placement if joint.origin is None else placement @ joint.origin))
    return mass, moment, inertia


@pytest.mark.parametrize(
    ("name", "arguments", "mass"),
    [
        ("2rpr", {}, 2 * 1.0),
        ("3rrr", {}, 3 * (1.0 + 1.0 + 3.0) + 0.5),
        ("3rrr", {"carriers": False}, 3 * (1.0 + 1.0) + 0.5),
        ("five_bar", {}, 2 * (0.5 + 0.5) + 0.2),
        ("five_bar", {"carriers": True}, 2 * (0.5 + 0.5 + 1.0) + 0.2),
        ("four_bar", {}, 0.2 + 0.7 + 0.5),
        ("gough", {"carriers": True, "carrier_mass": 3.0}, 6 * (1.5 + 0.8 + 3.0) + 5.0),
        ("gough", {"payload_mass": 2.0}, 6 * (1.5 + 0.8) + 5.0 + 2.0),
    ],
)
def test_total_mass(name: str, arguments: dict[str, object], mass: float) -> None:
    """Every declared mass is attached once, none to a link that cannot move."""
    assert pin.computeTotalMass(rp.load_robot(name, **arguments).model) == pytest.approx(mass, abs=ROUNDING)


def test_only_the_machines_of_the_thesis_have_carriers_unless_asked() -> None:
    """A carrier is a mass of a kilogram or so, and two motors more: who does not ask for it wants the plain machine."""
    for name in shipped_robots():
        plain, carriers = rp.load_robot(name), rp.load_robot(name).parameters.get("carriers")
        assert (plain.k > 0) == (name in THESIS), name
        assert carriers in (None, name in THESIS)
        for asked in () if carriers is None else (True, False):
            other = rp.load_robot(name, carriers=asked)
            assert (other.k > 0) == asked
            text = f"carriers={str(asked).lower()}"
            told = json.loads(call("info", "--robot", name, "--set", text, "--json").stdout)
            assert told["counts"]["carriers k"] == other.k


def test_five_bar_distal_links_are_collinear_inside_the_workspace() -> None:
    """Elbows at 120 and 60 degrees are 1 m apart, as far as two distal links of 0.5 m reach: P is midway."""
    loaded = _load("five_bar", {})
    outward = {"base_1": 120, "elbow_1": -120, "base_2": 60, "elbow_2": 120}
    loaded.other.update_cfg({name: np.deg2rad(angle) for name, angle in outward.items()})
    tips = [loaded.other.get_transform(link) for link in ("end_effector", "tip_2")]
    for tip in tips:
        np.testing.assert_allclose(tip[:3, 3], [0.25, np.sqrt(3) / 4, 0], atol=ROUNDING)
    np.testing.assert_allclose(tips[0][:3, 0], -tips[1][:3, 0], atol=ROUNDING)
    # the mode of that pose is the default one, and its neighbourhood in every direction is within reach of both legs
    assert loaded.robot.working_mode == (1, -1)
    reach = [np.hypot(0.25 - base, np.sqrt(3) / 4) for base in (0.0, 0.5)]
    assert max(reach) < 0.9
    assert min(reach) > 0.1


@pytest.mark.parametrize(("mode", "side"), [((1,), 1.0), ((-1,), -1.0)], ids=["open", "crossed"])
def test_four_bar_modes_are_the_two_circle_intersections(mode: tuple[int, ...], side: float) -> None:
    robot = rp.load_robot("four_bar", working_mode=mode)
    crank, rocker = _at_reference(robot, ["crank", "rocker"])
    crank_pin = 0.1 * np.array([np.cos(crank), np.sin(crank)])
    hinge = np.array([0.4, 0.0])
    span = np.linalg.norm(hinge - crank_pin)
    along = (hinge - crank_pin) / span
    across = np.array([-along[1], along[0]])
    foot = (0.35**2 - 0.25**2 + span**2) / (2 * span)
    meeting = crank_pin + foot * along + side * np.sqrt(0.35**2 - foot**2) * across
    np.testing.assert_allclose(hinge + 0.25 * np.array([np.cos(rocker), np.sin(rocker)]), meeting, atol=CLOSED)


@pytest.mark.parametrize("arguments", [{}, {"height": 0.8, "base_angle": 0.3, "platform_radius": 0.25}], ids=str)
def test_gough_leg_lengths_are_distances_between_the_hexagons(arguments: dict[str, float]) -> None:
    robot = rp.load_robot("gough", **arguments)
    height, base_angle = arguments.get("height", 0.6), arguments.get("base_angle", 0.2)
    platform_radius = arguments.get("platform_radius", 0.3)
    pairs = np.deg2rad([0.0, 120.0, 120.0, 240.0, 240.0, 360.0])
    base = pairs + base_angle * np.array([1, -1, 1, -1, 1, -1])
    platform = np.deg2rad([60.0, 60.0, 180.0, 180.0, 300.0, 300.0]) + 0.2 * np.array([-1, 1, -1, 1, -1, 1])
    legs = platform_radius * np.exp(1j * platform) - 0.6 * np.exp(1j * base)
    slides = _at_reference(robot, [f"slide_{i}" for i in range(1, 7)])
    np.testing.assert_allclose(slides, np.hypot(np.abs(legs), height), atol=CLOSED)


def test_gough_is_far_from_locking_its_hinges_at_the_reference() -> None:
    """The universal joints and the hinges of the ball joint lock when their middle hinge turns by 90 degrees."""
    robot = rp.load_robot("gough")
    middle = [f"tilt_{i}" for i in range(1, 7)] + ["ball_1_y"]
    angles = _at_reference(robot, middle)
    assert np.abs(np.rad2deg(angles)).max() < 45.0
