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


def test_the_sound_robot_loads(tmp_path: Path) -> None:
    robot = load(tmp_path, [*FIVE_BAR, RIDER], carriers=[{"joint": "rider"}])
    assert (robot.n, robot.m, robot.k) == (2, 2, 1)
    limits = robot.carrier_limits[0]
    assert (limits.lower, limits.upper, limits.speed, limits.force) == (-100.0, 100.0, 10.0, 10.0)
    assert limits.acceleration == np.inf
    assert not robot.q_reference.flags.writeable


@pytest.mark.parametrize("role", ["actuated", "carriers", "independent"])
def test_a_joint_of_many_freedoms_cannot_be_driven(tmp_path: Path, role: str) -> None:
    floating = J("ball", "floating", "lower_1", "satellite")
    changes: dict[str, dict[str, object]] = {
        "actuated": {"actuated": ["base_1", "ball"]},
        "carriers": {"carriers": [{"joint": "ball", "position": [-1, 1]}]},
        "independent": {
            "independent": {"joints": ["base_1", "ball"]},
            "reference": {"joints": {"base_1": 0, "ball": 0}},
        },
    }
    with pytest.raises(DeclarationError, match="'ball' has 6 freedoms") as caught:
        load(tmp_path, [*FIVE_BAR, floating], **changes[role])
    assert caught.value.details["name"] == "ball"


def test_a_carrier_without_ends_is_refused(tmp_path: Path) -> None:
    spinner = J("spinner", "continuous", "lower_1", "wheel")
    with pytest.raises(DeclarationError, match="'spinner' is a continuous joint") as caught:
        load(tmp_path, [*FIVE_BAR, spinner], carriers=[{"joint": "spinner"}])
    assert "bounded" in caught.value.remedy


def test_a_carrier_whose_urdf_gives_no_track_is_refused(tmp_path: Path) -> None:
    urdf = urdf_of([*FIVE_BAR, RIDER])
    name = '<joint name="rider"'
    urdf = urdf[: urdf.index(name)] + urdf[urdf.index(name) :].replace('lower="-100" upper="100" ', "", 1)
    path = write_robot(tmp_path, urdf, {**DECLARATION, "carriers": [{"joint": "rider"}]})
    with pytest.raises(DeclarationError, match="'rider' runs from -inf to inf"):
        load_robot(path)
    path = write_robot(tmp_path, urdf, {**DECLARATION, "carriers": [{"joint": "rider", "position": [-0.1, 0.1]}]})
    assert load_robot(path).carrier_limits[0].upper == 0.1


@pytest.mark.parametrize(
    ("position", "fits"),
    [
        ((-0.25, 0.25), True),
        ((-0.25 * (1.0 + 1e-12), 0.25), True),  # rounding of an expression
        ((-0.1, 0.2), True),
        ((-200.0, 200.0), False),  # mm for m
        ((-0.2, 0.25001), False),
        ((-0.25001, 0.2), False),
    ],
)
def test_the_track_of_a_carrier_is_within_the_limits_of_its_joint(
    position: tuple[float, float], fits: bool, tmp_path: Path
) -> None:
    urdf = urdf_of([*FIVE_BAR, RIDER])
    head, tail = urdf.split('<joint name="rider"')
    tail = tail.replace('lower="-100" upper="100"', 'lower="-0.25" upper="0.25"', 1)
    carriers = [{"joint": "rider", "position": list(position)}]
    path = write_robot(tmp_path, f'{head}<joint name="rider"{tail}', {**DECLARATION, "carriers": carriers})
    if fits:
        limits = load_robot(path).carrier_limits[0]
        assert (limits.lower, limits.upper) == position
        return
    with pytest.raises(DeclarationError) as refusal:
        load_robot(path)
    for part in ("'rider'", f"[{position[0]:g}, {position[1]:g}]", "-0.25 and 0.25"):
        assert part in refusal.value.message
    # what the remedy says
    carriers[0].pop("position")
    limits = load_robot(
        write_robot(tmp_path, f'{head}<joint name="rider"{tail}', {**DECLARATION, "carriers": carriers})
    )
    assert limits.carrier_limits[0].upper == 0.25


def test_the_guess_may_not_move_a_carrier(tmp_path: Path) -> None:
    reference = {"platform": [0.25, 0.7], "guess": {**DECLARATION["reference"]["guess"], "rider": 0.1}}
    with pytest.raises(DeclarationError, match="sets the carrier 'rider'"):
        load(tmp_path, [*FIVE_BAR, RIDER], carriers=[{"joint": "rider"}], reference=reference)


def test_the_guess_may_set_continuous_joints_but_not_floating_ones(tmp_path: Path) -> None:
    endless = [J(j.name, "continuous" if j.name == "base_1" else j.kind, j.parent, j.child, j.xyz) for j in FIVE_BAR]
    robot = load(tmp_path, endless)
    joint = robot.model.joints[robot.model.getJointId("base_1")]
    cosine, sine = robot.q_reference[joint.idx_q : joint.idx_q + 2]
    assert np.arctan2(sine, cosine) == pytest.approx(2.0, abs=0.3)
    floating = J("ball", "floating", "lower_1", "satellite")
    reference = {"platform": [0.25, 0.7], "guess": {"ball": 0.1}}
    with pytest.raises(DeclarationError, match="cannot set joint 'ball': it has 7 coordinates"):
        load(tmp_path, [*FIVE_BAR, floating], reference=reference)


def test_links_and_joints_may_share_their_names(tmp_path: Path) -> None:
    """The joint frame of ``tip_1`` lies elsewhere on another body: only the link of that name counts."""
    renamed = [J("tip_1", j.kind, j.parent, j.child, j.xyz) if j.name == "base_2" else j for j in FIVE_BAR]
    robot = load(tmp_path, renamed, actuated=["base_1", "tip_1"], reference={"platform": [0.25, 0.7], "guess": {
        "base_1": 2.0, "elbow_1": -1.0, "tip_1": 1.0, "elbow_2": 1.0}})  # fmt: skip
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.array(robot.q_reference))
    tip = data.oMf[robot.model.getFrameId("tip_1", pin.FrameType.BODY)].translation
    np.testing.assert_allclose(tip, [0.25, 0.7, 0.0], atol=1e-11)


def test_a_mimic_joint_that_leaves_no_freedom_is_refused_not_ignored(tmp_path: Path) -> None:
    urdf = urdf_of(FIVE_BAR)
    name = '<joint name="elbow_2"'
    cut = urdf.index(name)
    urdf = urdf[:cut] + urdf[cut:].replace("</joint>", '<mimic joint="elbow_1"/></joint>', 1)
    with pytest.raises(DeclarationError, match="over-constrained"):
        load_robot(write_robot(tmp_path, urdf, DECLARATION))


def test_a_reference_at_a_type_i_singularity_is_refused(tmp_path: Path) -> None:
    stretched = {"platform": [0.25, float(np.sqrt(1 - 0.25**2))], "guess": DECLARATION["reference"]["guess"]}
    with pytest.raises(DeclarationError, match="is a type I singularity") as caught:
        load(tmp_path, FIVE_BAR, reference=stretched)
    assert "Move the reference" in caught.value.remedy


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


def test_an_open_chain_is_the_closed_chain_without_closures(tmp_path: Path) -> None:
    robot = load(
        tmp_path,
        FIVE_BAR[:3],
        closures=[],
        actuated=["base_1", "elbow_1"],
        independent={"platform": "tip_1", "axes": ["x", "y"]},
        reference={"platform": [0.3, 0.6], "guess": {"base_1": 2.0, "elbow_1": -1.0}},
    )
    from redundancy_pin import PlatformMotion, RneaDynamics

    motion = PlatformMotion([0.0], [[0.3, 0.6]], [[0.1, -0.2]], [[0.5, 1.0]])
    reduced = RneaDynamics(robot).reduce(motion)
    q, v, a = (part[0] for part in RneaDynamics(robot).along(motion).tree_motion())
    tau = np.linalg.solve(reduced.W[0], reduced.f[0])
    np.testing.assert_allclose(tau, pin.rnea(robot.model, robot.model.createData(), q, v, a), atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"requires": ["length >"]}, r"`requires` is 'length >'.*a condition on the xacro arguments"),
        ({"independent": ["tip_1"]}, r"`independent` is \['tip_1'\].*a mapping with the keys"),
        ({"independent": {"axes": ["x"]}}, "`independent.platform` is None.*the name of a frame"),
        ({"carriers": [{"position": [0, 1]}]}, r"`carriers\[0\].joint` is None.*the name of a joint"),
        (
            {"independent": {"joints": ["base_1", "base_2"]}, "reference": {"joints": {"base_1": 1.0}}},
            "`reference.joints` is .*a value for each of base_1, base_2",
        ),
        ({"reference": {"platform": [0.25, 0.7], "guess": [1.0]}}, "`reference.guess` is .*a mapping of joint names"),
        ({"reference": {"platform": [0.25, 10**400]}}, r"`reference.platform\[1\]` is .*a finite number"),
        ({"reference": {"platform": ["9**9**9", 0.7]}}, r"`reference.platform\[0\]` is '9.*a number or an expression"),
        ({"reference": {"platform": [True, 0.7]}}, r"`reference.platform\[0\]` is True.*a finite number"),
        ({"closures": {"frames": []}}, "`closures` is .*a list"),
    ],
)
def test_declarations_of_the_wrong_form_say_what_is_allowed(
    tmp_path: Path, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(DeclarationError, match=message):
        load(tmp_path, FIVE_BAR, **changes)


def test_a_robot_prints_its_mode_with_a_sign_a_leg() -> None:
    assert "+-+" in repr(load_robot("3rrr", working_mode=(1, -1, 1)))
    assert "-+-" in repr(load_robot("3rrr", working_mode=(-1, 1, -1)))


@pytest.mark.parametrize(
    ("joints", "changes", "numbers", "named"),
    [
        # four velocities, two rows
        ([], {"independent": {"joints": ["base_1"]}}, (2, 1, 2), "still move: elbow_1, base_2, elbow_2"),
        ([], {"independent": {"joints": ["base_1", "base_2", "elbow_1"]}}, (2, 3, 2), "is over-constrained"),
        # of three rows one asks for what the plane has anyway
        ([], {"closures": [{"frames": ["tip_1", "tip_2"], "axes": ["x", "y", "z"]}]}, (1, 2, 2), "redundant: z of"),
        # one that nothing asks for
        ([RIDER], {}, (3, 2, 2), "still move: rider"),
        ([RIDER, J("spin", "revolute", "mass", "top")], {}, (4, 2, 2), "still move: rider, spin"),
    ],
)
def test_freedoms_are_counted(
    tmp_path: Path, joints: list[J], changes: dict[str, Any], numbers: tuple[int, int, int], named: str
) -> None:
    """Velocities less rows, what is declared, and the rank of the rows; and which joints or rows are too many."""
    if "independent" in changes:
        held = changes["independent"]["joints"]
        guess = DECLARATION["reference"]["guess"]
        reference = {
            "joints": {name: guess[name] for name in held},
            "guess": {name: value for name, value in guess.items() if name not in held},
        }
        changes = {**changes, "reference": reference}
    with pytest.raises(DeclarationError, match=named) as caught:
        load(tmp_path, [*FIVE_BAR, *joints], **changes)
    details = caught.value.details
    assert (details["freedoms"], details["declared"], details["rank"]) == numbers


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


def test_rows_are_looked_through_only_where_some_are_redundant(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """What names them takes as long to import as all else that loading asks for."""
    asked: list[int] = []
    monkeypatch.setattr("scipy.linalg.qr", lambda *_, **__: asked.append(1) or pytest.fail("the rows are independent"))
    assert load(tmp_path, FIVE_BAR).n == 2
    assert not asked


@pytest.mark.parametrize(("follower", "numbers"), [("rotor", 1), ("elbow", 2), ("", 2)])
def test_joints_that_turn_on_count_their_turns_where_one_of_them_follows(
    follower: str, numbers: int, tmp_path: Path
) -> None:
    """Cosine and sine, which Pinocchio has of a continuous joint, forget them; where none is coupled they stay."""
    joints = [
        J("arm", "revolute", "base", "arm"),
        J("elbow", "revolute", "arm", "fore", (0.3, 0, 0)),
        J("rotor", "continuous", "base", "rotor", (0, 0.4, 0)),
    ]
    urdf, others = urdf_of(joints), {"arm", "elbow", "rotor"} - {follower}
    if follower:
        start = urdf.index(f'<joint name="{follower}"')
        urdf = urdf[:start] + urdf[start:].replace("</joint>", '<mimic joint="arm" multiplier="2"/></joint>', 1)
    declaration = {"actuated": sorted(others), "reference": {}, "independent": {"joints": sorted(others)}}
    model = load_robot(write_robot(tmp_path, urdf, declaration)).model
    assert model.joints[model.getJointId("rotor")].nq == numbers
    assert model.nv == 3


def test_a_platform_without_axes_leaves_freedoms_and_does_move(tmp_path: Path) -> None:
    with pytest.raises(DeclarationError, match="under-constrained") as caught:
        load(tmp_path, FIVE_BAR, independent={"platform": "tip_1"})
    assert "does not move" not in str(caught.value)


def test_indices_of_roles_are_those_of_the_model() -> None:
    """A continuous joint has two coordinates and one velocity: behind it q and v are counted apart."""
    model = pin.Model()
    for kind, name in ((pin.JointModelRUBZ(), "spin"), (pin.JointModelPX(), "slide"), (pin.JointModelRZ(), "arm")):
        model.addJoint(0, kind, pin.SE3.Identity(), name)
    robot = replace(rp.load_robot("four_bar"), model=model, actuated=("arm", "spin"), carriers=("slide",))
    assert robot.actuated_velocity.tolist() == [2, 0]
    assert (robot.carrier_velocity.tolist(), robot.carrier_position.tolist()) == ([1], [2])
