"""Loops of a URDF in every dialect: torques are those of Pinocchio's tree with the loop as rows of a KKT system."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from loop_oracle import Loops
from written import write_changed
from zoo import places_of

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import DeclarationError, RedundancyPinError
from redundancy_pin.loading import propose_robot

FILES = Path(__file__).parent / "files" / "urdf"
GOOD = sorted(path.stem for path in (FILES / "good").glob("*.urdf"))
GRAVITY = (0.0, -9.81, 0.0)
MOTION = (0.3, 1.7, -4.0)
"""Angle, rad, speed and acceleration of the motor."""


def torque(robot: rp.Robot) -> float:
    return float(rp.RneaDynamics(robot).torque(*([value] for value in MOTION)).tau[0])


def torque_by_kkt(text: str, points: dict[str, Array], near: Array) -> float:
    """Return the torque of the motor of a planar four-bar that is closed at a point of each of two links.

    The tree is Pinocchio's own, and nothing is this package's.
    """
    model = pin.buildModelFromXML(text)
    model.gravity.linear = np.array(GRAVITY)
    ends = [f"point of {link}" for link in points]
    for end, (link, at) in zip(ends, points.items(), strict=True):
        carrier = model.frames[model.getFrameId(link, pin.BODY)]
        place = carrier.placement * pin.SE3(np.eye(3), at)
        model.addFrame(pin.Frame(end, carrier.parentJoint, place, pin.OP_FRAME))
    x, xd, xdd = np.array(MOTION)[:, None]
    return float(Loops(model, [(ends[0], ends[1])], ["motor"]).torque(x, xd, xdd, near)[0])


@pytest.mark.parametrize("name", GOOD)
def test_torques_are_those_of_the_closed_loop(name: str) -> None:
    path = FILES / "good" / f"{name}.urdf"
    robot = rp.load_robot(path, gravity=GRAVITY)
    assert (robot.n, robot.actuated, robot.independent_joints) == (1, ("motor",), ("motor",))
    text, points = path.read_text(), {"bar": np.array([0.25, 0.0, 0.0]), "arm": np.array([0.2, 0.0, 0.0])}
    if name == "gazebo":  # its joint is where its child is at zero
        model = pin.buildModelFromXML(text)
        bar, arm = places_of(model, pin.neutral(model), "bar", "arm")
        points["bar"] = bar.actInv(arm).act(points["arm"])
    q = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], [[MOTION[0]]], [[0.0]], [[0.0]])).q[0]
    names, own = list(pin.buildModelFromXML(text).names)[1:], list(robot.model.names)[1:]
    assert names == own
    assert torque(robot) == pytest.approx(torque_by_kkt(text, points, q), rel=1e-9)


def test_a_distance_of_drake_that_nothing_changes_is_a_rod(tmp_path: Path) -> None:
    """In place of the bar: the same file with a bar of mass 0 has the same torque."""
    text = (FILES / "good" / "drake.urdf").read_text()
    bar, knee = (
        text[text.index(first) : text.index(last)]
        for first, last in (('<link name="bar"', '<link name="arm"'), ('<joint name="knee"', '<joint name="foot"'))
    )
    massless = bar.replace('value="0.5"', 'value="0"').replace('"1e-4"', '"0"').replace('"0.002"', '"0"')
    changes = ((bar, ""), (knee, ""), ("ball_con", "distance_con"), ('"bar"', '"crank"'), ('"0.25 0 0"', '"0.12 0 0"'))
    assert all(old in text for old, _ in changes)
    rod = text
    for old, new in changes:
        rod = rod.replace(old, new)
    stiff = '<drake:distance_constraint_distance value="0.25"/><drake:distance_constraint_stiffness value="inf"/>'
    (tmp_path / "rod.urdf").write_text(rod.replace("</drake:distance_c", stiff + "</drake:distance_c"))
    robot = rp.load_robot(tmp_path / "rod.urdf", gravity=GRAVITY)
    assert ([each.axes for each in robot.closures], robot.n) == ([("distance",)], 1)
    whole = rp.load_robot(FILES / "good" / "drake.urdf", gravity=GRAVITY)
    at = rp.PlatformMotion([0.0], [[MOTION[0]]], [[0.0]], [[0.0]])
    q, near = (rp.inverse_kinematics(each, at).q[0] for each in (robot, whole))
    np.testing.assert_allclose(q, near[:3], atol=1e-9)  # foot and motor, then the knee
    points = {"bar": np.array([0.25, 0.0, 0.0]), "arm": np.array([0.2, 0.0, 0.0])}
    assert torque(robot) == pytest.approx(torque_by_kkt(text.replace(bar, massless), points, near), rel=1e-9)


def changed(folder: Path, *changes: tuple[str, str], name: str = "urdf_plus") -> Path:
    """Write one of the good files with parts of its text replaced."""
    return write_changed(folder, FILES / "good" / f"{name}.urdf", *changes)


@pytest.mark.parametrize("name", GOOD)
def test_what_tinyxml2_reads_is_read(name: str, tmp_path: Path) -> None:
    """Gazebo, Drake and urdfdom do: "--" in comments, a blank before the declaration, prefixes of no namespace.

    Nor do they look at the namespace of the top element.
    """
    text = (FILES / "good" / f"{name}.urdf").read_text().replace(' xmlns:drake="http://drake.mit.edu"', "")
    text = text.replace("<robot ", "<robot xmlns='http://drake.mit.edu' ", 1)
    head, rest = text.split("\n", 1)
    odd = f"\n<?xml version='1.0'?>\n{head}\n<!-- gz topic --echo -->{rest}".replace(
        "</robot>", "<gz:x gz:y='1'/><!-----></robot>"
    )
    (tmp_path / f"{name}.urdf").write_text(odd)
    robot, own = (rp.load_robot(folder / f"{name}.urdf", gravity=GRAVITY) for folder in (tmp_path, FILES / "good"))
    assert torque(robot) == torque(own) == torque(rp.with_parameters(robot, masses={"arm": 0.3}))
    last = odd.count("\n")  # the file ends with a line break
    assert {*robot.notes} - {*own.notes} == {f"Passed over: <x> in line {last}, which is not understood."}


def test_an_axis_of_gazebo_in_the_frame_of_the_model_is_that_of_the_joint_or_refused(tmp_path: Path) -> None:
    """``use_parent_model_frame`` is of old SDF: Gazebo reads a URDF as a new one, which does not know it."""
    flag = "<use_parent_model_frame>1</use_parent_model_frame></axis>"
    same = rp.load_robot(
        changed(tmp_path, ("</axis>\n  </joint>", f"{flag}\n  </joint>"), name="gazebo"), gravity=GRAVITY
    )
    whole = rp.load_robot(FILES / "good" / "gazebo.urdf", gravity=GRAVITY)
    assert (torque(same), same.notes) == (torque(whole), whole.notes)
    turned = changed(
        tmp_path,
        ("<pose>0.2 0 0 0 0 0", "<pose>0.2 0 0 0.5 0 0"),
        ("</axis>\n  </joint>", f"{flag}\n  </joint>"),
        name="gazebo",
    )
    with pytest.raises(
        RedundancyPinError, match=r"'pin' of gazebo\.urdf has an axis in the frame of the model.*line 17"
    ) as refusal:
        rp.load_robot(turned)
    axis = re.search(r"\[(.*)\]", refusal.value.remedy)[1].replace(",", "")
    for pose in ("<pose>0.2 0 0 0.5 0 0", f'<pose degrees="true">0.2 0 0 {np.rad2deg(0.5)} 0 0'):
        along = ("<xyz>0 0 1</xyz></axis>\n  </joint>", f"<xyz>{axis}</xyz></axis>\n  </joint>")
        mended = changed(tmp_path, ("<pose>0.2 0 0 0 0 0", pose), along, name="gazebo")
        assert torque(rp.load_robot(mended, gravity=GRAVITY)) == pytest.approx(torque(whole), rel=1e-6)


MASS = '<mass value="{}"/><inertia ixx="{}" ixy="0" ixz="0" iyy="{}" iyz="0" izz="{}"/></inertial></link>'
NONE, ROD = MASS.format(0, 0, 0, 0), MASS.format(0.5, 1e-3, 2e-3, 1.5e-3)
RSSR = (FILES / "other" / "rssr.urdf").read_text()


@pytest.mark.parametrize("damped", ["", '<dynamics damping="0.1"/>'])
def test_three_hinges_through_a_point_are_the_ball_of_a_rod(damped: str, tmp_path: Path) -> None:
    """As onshape-to-robot writes balls: the spin of the rod is held, and torques are those with a ball of Drake."""
    links = [f'<link name="{name}"><inertial>{NONE}' for name in ("first", "second")]
    ends = ["crank", "first", "second", "rod"]
    hinges = [
        f'<joint name="near_{axis}" type="continuous"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{"0.1 0 0" if axis == "x" else "0 0 0"}"/><axis xyz="{xyz}"/>{damped}</joint>'
        for axis, parent, child, xyz in zip("xyz", ends, ends[1:], ("1 0 0", "0 1 0", "0 0 1"), strict=False)
    ]
    ball = '<drake:joint name="near" type="ball"><parent link="crank"/><child link="rod"/>'
    ball += '<origin xyz="0.1 0 0"/></drake:joint>'
    robots = []
    for name, parts in (("hinges", [*links, *hinges]), ("ball", [ball])):
        path = tmp_path / f"{name}.urdf"
        path.write_text(RSSR.replace("<!-- more -->", "".join(parts)))
        robots.append(rp.load_robot(path, gravity=GRAVITY))
        assert (robots[-1].n, robots[-1].independent_joints) == (1, ("motor",))
        assert sum("The spin of near" in note for note in robots[-1].notes) == 1
    assert list(robots[0].model.names)[1:] == ["foot", "motor", "near_x", "near_y", "near_z"]
    if not damped:
        assert torque(robots[0]) == pytest.approx(torque(robots[1]), rel=1e-9)
    driven = rp.load_robot(tmp_path / "hinges.urdf", actuated=["motor", "near_x"], gravity=GRAVITY)
    assert driven.n == 2  # a hinge that a motor turns is no part of a ball
    whole = RSSR.replace("<!-- more -->", "".join([*links, *hinges]))
    flag = f'<link name="flag"><inertial>{NONE}<joint name="waving" type="continuous"><parent link="first"/>'
    flag += '<child link="flag"/></joint></robot>'
    for old, new, count in (
        ('xyz="0 0 0"', 'xyz="0 0 0.01"', 2),  # nor are hinges that miss one another
        (links[0], links[0].replace(NONE, ROD), 2),  # nor those with a mass between them
        ("</robot>", flag, 3),  # nor those with something else between them
    ):
        assert old in whole
        (tmp_path / "no_ball.urdf").write_text(whole.replace(old, new))
        assert rp.load_robot(tmp_path / "no_ball.urdf", gravity=GRAVITY).n == count


@pytest.mark.long_for("bar-arm-2.0-CompiledDynamics")
@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.CompiledDynamics])
@pytest.mark.parametrize(("one", "other", "factor"), [("bar", "arm", 2.0), ("arm", "bar", 0.5)])
def test_a_coupling_is_of_sums_of_angles(backend: type, one: str, other: str, factor: float, tmp_path: Path) -> None:
    """URDF+: ratio times the angle to the predecessor is that to the successor, both from what carries both.

    With foot = factor (knee + motor), virtual work adds so much of the torque of the foot to both others.
    """
    belt = f'<coupling name="belt"><predecessor link="{one}"/><successor link="{other}"/><ratio value="2"/></coupling>'
    path = changed(tmp_path, ("<loop ", f"{belt}<!--<loop "), ("</loop>", "</loop>-->"))
    robot = rp.load_robot(path, actuated="motor,knee", gravity=GRAVITY)
    names = list(robot.model.names)[1:]
    motor, knee, foot = (names.index(name) for name in ("motor", "knee", "foot"))
    states = np.zeros((3, 3))
    states[:, motor], states[:, knee] = (0.2, 1.1, -2.0), (-0.1, 0.7, 3.0)
    states[:, foot] = factor * (states[:, motor] + states[:, knee])
    q, v, a = states
    alone = pin.rnea(robot.model, robot.model.createData(), q, v, a)
    columns = [names.index(name) for name in robot.independent_joints]
    motion = rp.PlatformMotion([0.0], *(state[None, columns] for state in states))
    tau = rp.distribute(backend(robot).reduce(motion)).tau[0]
    own = [names.index(name) for name in robot.actuated]
    np.testing.assert_allclose(tau, [alone[index] + factor * alone[foot] for index in own], rtol=1e-9)


@pytest.mark.parametrize("side", [1, -1])
def test_the_branch_of_loops_that_lie_in_a_line_is_asked_for(side: int, tmp_path: Path) -> None:
    """A four-bar, flat at zero, where its branches meet: both are known, as two circles that meet."""
    flat = changed(
        tmp_path,
        ('<origin rpy="0 0 0.8"/>', ""),
        ('<origin xyz="0.12 0 0" rpy="0 0 -0.5"/>', '<origin xyz="0.12 0 0"/>'),
        ('<origin xyz="0.3 0 0" rpy="0 0 1.2"/>', '<origin xyz="0.17 0 0"/>'),
        name="urdf_plus",
    )
    with pytest.raises(DeclarationError, match=r"Which branch\?.* --guess foot=\S+,motor=\S+,knee=\S+\."):
        rp.load_robot(flat)
    pivot, ground, motor = 0.12 * np.exp(0.8j), 0.17, 0.8
    away = abs(ground - pivot)
    along = (0.25**2 - 0.2**2 + away**2) / (2.0 * away)
    tip = pivot + (ground - pivot) / away * (along + side * 1j * np.sqrt(0.25**2 - along**2))
    angles = {"motor": motor, "knee": float(np.angle(tip - pivot)) - motor, "foot": float(np.angle(tip - ground))}
    proposal, robot = propose_robot(flat, guess={name: round(angle, 2) for name, angle in angles.items()})
    assert proposal.questions == ()
    assert robot is not None
    found = dict(zip(angles, robot.joint_positions(robot.q_reference, list(angles)), strict=True))
    assert found == pytest.approx(angles, abs=0.02)


@pytest.mark.parametrize(
    ("name", "text", "what"), [("robot", "<robot/>", "is a URDF"), ("robot.txt", "root:x:0", "is no model")]
)
def test_a_model_is_read_by_its_name(name: str, text: str, what: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    (tmp_path / "robot.yaml").write_text(f"urdf: {name}\nactuated: [a]\nreference: {{}}\n")
    with pytest.raises(RedundancyPinError, match=f"{what}, and by its name no URDF.*call it .urdf"):
        rp.load_robot(tmp_path)
