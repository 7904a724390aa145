"""Loops of a URDF in every dialect: torques are those of Pinocchio's tree with the loop as rows of a KKT system."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import RedundancyPinError

FILES = Path(__file__).parent / "files" / "urdf"
GOOD = sorted(path.stem for path in (FILES / "good").glob("*.urdf"))
BAD = sorted(path.stem for path in (FILES / "bad").glob("*.urdf"))
GRAVITY = (0.0, -9.81, 0.0)
MOTION = (0.3, 1.7, -4.0)
"""Angle, rad, speed and acceleration of the motor."""


def torque(robot: rp.Robot) -> float:
    x, xd, xdd = (np.array([[value]]) for value in MOTION)
    return float(rp.distribute(rp.RneaDynamics(robot).reduce(rp.PlatformMotion([0.0], x, xd, xdd))).tau[0, 0])


def torque_by_kkt(text: str, points: dict[str, Array], near: Array) -> float:
    """Return the torque of the motor of a planar four-bar that is closed at a point of each of two links.

    The tree is Pinocchio's own; its passive joints follow from two equations of Newton's method, the torque and both
    forces at the pin from the equations of motion, and nothing is this package's.
    """
    model = pin.buildModelFromXML(text)
    model.gravity.linear = np.array(GRAVITY)
    frames = []
    for link, at in points.items():
        carrier = model.frames[model.getFrameId(link, pin.BODY)]
        place = carrier.placement * pin.SE3(np.eye(3), at)
        frames.append(model.addFrame(pin.Frame(f"point of {link}", carrier.parentJoint, place, pin.OP_FRAME)))
    data = model.createData()
    aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

    def rows(q: Array) -> tuple[Array, Array]:
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        one, other = (data.oMf[frame].translation[:2].copy() for frame in frames)
        jacobians = [pin.getFrameJacobian(model, data, frame, aligned)[:2].copy() for frame in frames]
        return one - other, jacobians[0] - jacobians[1]

    names = list(model.names)[1:]
    motor = names.index("motor")
    passive = [index for index in range(model.nv) if index != motor]
    q = near.copy()
    for _ in range(20):
        gap, jacobian = rows(q)
        step = np.zeros(model.nv)
        step[passive] = -np.linalg.solve(jacobian[:, passive], gap)
        q = pin.integrate(model, q, step)
    gap, jacobian = rows(q)
    assert np.abs(gap).max() < 1e-14
    v, a = np.zeros(model.nv), np.zeros(model.nv)
    v[motor], a[motor] = MOTION[1:]
    v[passive] = -np.linalg.solve(jacobian[:, passive], jacobian[:, motor] * v[motor])
    pin.forwardKinematics(model, data, q, v, np.zeros(model.nv))
    bias = [pin.getFrameClassicalAcceleration(model, data, frame, aligned).linear[:2].copy() for frame in frames]
    a[passive] = -np.linalg.solve(jacobian[:, passive], jacobian[:, motor] * a[motor] + bias[0] - bias[1])
    forces = pin.rnea(model, model.createData(), q, v, a)
    unknown = np.column_stack([np.eye(model.nv)[motor], jacobian.T])
    return float(np.linalg.solve(unknown, forces)[0])


@pytest.mark.parametrize("name", GOOD)
def test_torques_are_those_of_the_closed_loop(name: str) -> None:
    path = FILES / "good" / f"{name}.urdf"
    robot = rp.load_robot(path, gravity=GRAVITY)
    assert (robot.n, robot.actuated, robot.independent_joints) == (1, ("motor",), ("motor",))
    text, points = path.read_text(), {"bar": np.array([0.25, 0.0, 0.0]), "arm": np.array([0.2, 0.0, 0.0])}
    if name == "gazebo":  # its joint is where its child is at zero
        model = pin.buildModelFromXML(text)
        data = model.createData()
        pin.framesForwardKinematics(model, data, pin.neutral(model))
        bar, arm = (data.oMf[model.getFrameId(link, pin.BODY)] for link in ("bar", "arm"))
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


@pytest.mark.parametrize("name", BAD)
def test_a_file_that_cannot_be_meant_is_refused_by_name(name: str) -> None:
    """The first line of each says what its error must contain."""
    path = FILES / "bad" / f"{name}.urdf"
    message = path.read_text().partition("\n")[0].removeprefix("<!-- ").removesuffix(" -->")
    with pytest.raises(RedundancyPinError) as refusal:
        rp.load_robot(path)
    assert message in str(refusal.value)
    assert f"{name}.urdf" in str(refusal.value)


def changed(folder: Path, *changes: tuple[str, str], name: str = "urdf_plus") -> Path:
    """Write one of the good files with parts of its text replaced."""
    text = (FILES / "good" / f"{name}.urdf").read_text()
    for old, new in changes:
        assert old in text
        text = text.replace(old, new, 1)
    folder.mkdir(exist_ok=True)
    path = folder / f"{name}.urdf"
    path.write_text(text)
    return path


def test_a_rotor_of_drake_adds_its_inertia_by_the_square_of_its_gear(tmp_path: Path) -> None:
    rotor = '<actuator name="m"><drake:rotor_inertia value="2e-5"/><drake:gear_ratio value="30"/></actuator>'
    plain = rp.load_robot(FILES / "good" / "urdf_plus.urdf", gravity=GRAVITY)
    robot = rp.load_robot(changed(tmp_path, ('<actuator name="m"/>', rotor)), gravity=GRAVITY)
    assert torque(robot) - torque(plain) == pytest.approx(30.0**2 * 2e-5 * MOTION[2], rel=1e-9)


def test_the_world_of_drake_needs_no_link(tmp_path: Path) -> None:
    plain = rp.load_robot(FILES / "good" / "urdf_plus.urdf", gravity=GRAVITY)
    onto_world = [('<parent link="ground"/>', '<parent link="world"/>')] * 2
    robot = rp.load_robot(changed(tmp_path, ('<link name="ground"/>', ""), *onto_world), gravity=GRAVITY)
    assert torque(robot) == torque(plain)
    assert "The link 'world', which the file does not have, is the ground." in robot.notes


def test_a_motor_of_a_joint_that_is_fixed_is_noted(tmp_path: Path) -> None:
    more = """<link name="cover"/><joint name="lid" type="fixed"><parent link="bar"/><child link="cover"/></joint>
    <transmission name="opens"><joint name="lid"/></transmission></robot>"""
    robot = rp.load_robot(changed(tmp_path, ("</robot>", more)))
    assert robot.actuated == ("motor",)
    assert any("'lid', which a transmission" in note for note in robot.notes)


@pytest.mark.parametrize(
    ("tag", "meant"), [("loopjoint", "loop_joint"), ("loops", "loop"), ("ball_constraint", "drake:ball_constraint")]
)
def test_misspelt_loops_are_errors(tag: str, meant: str, tmp_path: Path) -> None:
    with pytest.raises(RedundancyPinError, match=f"<{tag}> in line 20.*Did you mean '{meant}'"):
        rp.load_robot(changed(tmp_path, ("</robot>", f"<{tag}/></robot>")))


@pytest.mark.parametrize("word", ["false", "False"])
def test_marks_of_independent_joints(word: str, tmp_path: Path) -> None:
    """With or without capitals."""
    marks = [(f'<joint name="{name}"', f'<joint name="{name}" independent="{word}"') for name in ("motor", "foot")]
    path = changed(tmp_path, *marks, ('<joint name="knee"', '<joint name="knee" independent="True"'))
    assert rp.load_robot(path).independent_joints == ("knee",)


@pytest.mark.parametrize(
    ("old", "new", "note"),
    [
        ("</robot>", "<winding/></robot>", "Passed over: <winding>"),
        (
            "</robot>",
            "<drake:linear_bushing_rpy/></robot>",
            "Not in force, though the file says it: <linear_bushing_rpy>",
        ),
        (
            '<limit lower="-2"',
            '<joint_properties friction="0.1"/><limit lower="-2"',
            "friction by <joint_prop",
        ),
        ("</loop>", '<dynamics damping="3"/></loop>', "Not in force, though the file says it: <dynamics>"),
        ('<limit lower="-2"', '<backlash/><limit lower="-2"', "Passed over: <backlash>"),
        (
            '<limit lower="-2"',
            '<dynamics damping="0" spring="2"/><limit lower="-2"',
            "Passed over: 'spring' of <dynamics>",
        ),
        (
            '<limit lower="-2"',
            '<limit soft_effort="2" lower="-2"',
            "Passed over: 'soft_effort' of <limit>",
        ),
        (
            "</robot>",
            '<gazebo reference="motor"><springStiffness>2</springStiffness></gazebo></robot>',
            "Not in force, though the file says it: <springStiffness>",
        ),
    ],
)
def test_elements_that_are_not_understood_are_noted_with_their_line(
    old: str, new: str, note: str, tmp_path: Path
) -> None:
    path = changed(tmp_path, (old, new))
    line = path.read_text().partition(new)[0].count("\n") + 1
    (found,) = (each for each in rp.load_robot(path).notes if note in each)
    assert f"in line {line}" in found


@pytest.mark.parametrize(("kind", "names"), [("ball", ["knee"]), ("universal", ["knee_rx", "knee_ry"])])
def test_joints_of_drake(kind: str, names: list[str], tmp_path: Path) -> None:
    ends = '<parent link="crank"/><child link="ball"/>'
    joint = f'<link name="ball"/><drake:joint name="knee" type="{kind}">{ends}</drake:joint>'
    text = (
        '<robot name="r" xmlns:drake="http://drake.mit.edu"><link name="base"/><link name="crank"/>'
        '<joint name="motor" type="continuous"><parent link="base"/><child link="crank"/></joint>'
        f'{joint}<transmission name="t"><joint name="motor"/></transmission></robot>'
    )
    path = tmp_path / "r.urdf"
    path.write_text(text)
    moving = list(rp.load_robot(path).model.names)[2:]
    assert moving == (["knee_rz", "knee_ry", "knee_rx"] if kind == "ball" else names)


@pytest.mark.parametrize(
    ("ends", "expected"),
    [
        (("bar", "arm"), ("foot", "knee", (("motor", 2.0),))),  # foot = 2 (knee + motor)
        (("arm", "bar"), ("knee", "foot", (("motor", -1.0),))),  # knee + motor = 2 foot
    ],
)
def test_a_coupling_is_of_sums_of_angles(ends: tuple[str, str], expected: object, tmp_path: Path) -> None:
    """URDF+: ratio times the angle to the predecessor is that to the successor, both from what carries both."""
    one, other = ends
    belt = f'<coupling name="belt"><predecessor link="{one}"/><successor link="{other}"/><ratio value="2"/></coupling>'
    path = changed(tmp_path, ("<loop ", f"{belt}<!--<loop "), ("</loop>", "</loop>-->"))
    (coupling,) = rp.load_robot(path).couplings
    assert (coupling.joint, coupling.of, coupling.also) == expected
    assert coupling.polynomial == (0.0, 2.0)


@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.CompiledDynamics])
def test_a_coupling_of_three_joints_shares_its_torque(backend: type, tmp_path: Path) -> None:
    """With foot = 2 (knee + motor), virtual work adds twice the torque of the foot to both others."""
    belt = '<coupling name="belt"><predecessor link="bar"/><successor link="arm"/><ratio value="2"/></coupling>'
    path = changed(tmp_path, ("<loop ", f"{belt}<!--<loop "), ("</loop>", "</loop>-->"))
    robot = rp.load_robot(path, actuated="motor,knee", gravity=GRAVITY)
    names = list(robot.model.names)[1:]
    motor, knee, foot = (names.index(name) for name in ("motor", "knee", "foot"))
    states = np.zeros((3, 3))
    states[:, motor], states[:, knee] = (0.2, 1.1, -2.0), (-0.1, 0.7, 3.0)
    states[:, foot] = 2.0 * (states[:, motor] + states[:, knee])
    q, v, a = states
    alone = pin.rnea(robot.model, robot.model.createData(), q, v, a)
    columns = [names.index(name) for name in robot.independent_joints]
    motion = rp.PlatformMotion([0.0], *(state[None, columns] for state in states))
    tau = rp.distribute(backend(robot).reduce(motion)).tau[0]
    own = [names.index(name) for name in robot.actuated]
    np.testing.assert_allclose(tau, [alone[index] + 2.0 * alone[foot] for index in own], rtol=1e-9)


def test_joints_of_a_plain_file_are_named_as_driven_and_its_base_may_move(tmp_path: Path) -> None:
    drive = '  <transmission name="drive"><joint name="motor"/><actuator name="m"/></transmission>\n'
    path = changed(tmp_path, (drive, ""))
    assert rp.load_robot(path).actuated == ("motor",)  # by its name
    nameless = changed(tmp_path / "a", (drive, ""), ('"motor"', '"crank"'))
    with pytest.raises(
        RedundancyPinError, match=r"Which joints are driven, of crank, knee, foot\?.*redundancy-pin new"
    ):
        rp.load_robot(nameless)
    assert rp.load_robot(path, actuated="foot").actuated == ("foot",)
    free = rp.load_robot(path, actuated="motor", base="free")
    assert (free.n, free.m) == (7, 1)
    with pytest.raises(RedundancyPinError, match="'base' is 'loose'"):
        rp.load_robot(path, actuated="motor", base="loose")


def test_a_floating_joint_is_six_joints(tmp_path: Path) -> None:
    floating = (
        '<link name="world"/><joint name="base" type="floating"><parent link="world"/><child link="ground"/></joint>'
    )
    robot = rp.load_robot(changed(tmp_path, ('<link name="ground"/>', f'<link name="ground"/>{floating}')))
    assert robot.n == 7
    assert list(robot.model.names)[1:7] == [f"base_{axis}" for axis in ("x", "y", "z", "rz", "ry", "rx")]


def test_loops_that_lie_in_a_line_at_zero_are_closed_beside(tmp_path: Path) -> None:
    """A parallelogram, flat at zero: its rows lose rank there."""
    flat = changed(
        tmp_path,
        ('<origin rpy="0 0 0.8"/>', ""),
        ('<origin xyz="0.12 0 0" rpy="0 0 -0.5"/>', '<origin xyz="0.12 0 0"/>'),
        ('<origin xyz="0.3 0 0" rpy="0 0 1.2"/>', '<origin xyz="0.17 0 0"/>'),
        name="urdf_plus",
    )
    robot = rp.load_robot(flat)
    assert abs(np.sin(robot.q_reference[0])) > 1e-3
    assert any("lie in a line" in note for note in robot.notes)


def test_a_planar_joint_holds_a_body_on_a_plane(tmp_path: Path) -> None:
    """A puck of 2 kg and 0.3 kg·m²: its efforts are those of a free body in the plane."""
    path = tmp_path / "puck.urdf"
    inertia = '<inertia ixx="0.2" iyy="0.2" izz="0.3" ixy="0" ixz="0" iyz="0"/>'
    path.write_text(
        '<robot name="puck"><link name="table"/>'
        f'<link name="puck"><inertial><mass value="2"/>{inertia}</inertial></link>'
        '<joint name="free" type="floating"><parent link="table"/><child link="puck"/></joint>'
        '<loop name="slab" type="planar"><predecessor link="table"><origin xyz="0 0 0.5"/></predecessor>'
        '<successor link="puck"/><axis xyz="0 0 1"/></loop></robot>'
    )
    robot = rp.load_robot(path, actuated="free_x,free_y,free_rz")
    assert robot.n == 3
    motion = rp.PlatformMotion([0.0], [[0.1, 0.2, 0.3]], [[1.0, 2.0, 3.0]], [[4.0, 5.0, 6.0]])
    tau = rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau[0]
    np.testing.assert_allclose(tau, [8.0, 10.0, 1.8], atol=1e-12)


def test_a_slider_with_two_axes_is_refused(tmp_path: Path) -> None:
    """They do not say how its links are turned about them."""
    loop = '<loop name="pin" type="revolute">'
    path = tmp_path / "slider.urdf"
    text = (FILES / "good" / "urdf_plus.urdf").read_text()
    assert loop in text
    two = '<parent_axis xyz="1 0 0"/><child_axis xyz="0 1 0"/>'
    path.write_text(text.replace(loop, f'<loop name="pin" type="prismatic">{two}'))
    with pytest.raises(RedundancyPinError, match=r"slider 'pin' has two axes.*slider\.urdf, line \d+"):
        rp.load_robot(path)


def test_a_file_without_a_declaration_takes_other_masses_and_lengths(tmp_path: Path) -> None:
    """As if the file had said so."""
    robot = rp.load_robot(FILES / "good" / "urdf_plus.urdf", gravity=GRAVITY)
    mass = changed(tmp_path, ('<mass value="0.3"/>', '<mass value="0.6"/>'))
    other = rp.load_robot(mass, gravity=GRAVITY)
    names = [name for name in ("crank", "bar", "arm") if _mass(other, name) != _mass(robot, name)]
    assert len(names) == 1
    scaled = rp.with_parameters(robot, masses={names[0]: 0.6})
    assert scaled.actuated == robot.actuated
    np.testing.assert_array_equal(scaled.q_reference, robot.q_reference)
    assert _mass(scaled, names[0]) == pytest.approx(0.6)
    longer = rp.with_parameters(robot, lengths={"knee": 0.13})
    assert longer.n == 1
    placements = [one.model.jointPlacements[one.model.getJointId("knee")].translation for one in (longer, robot)]
    assert [np.linalg.norm(place) for place in placements] == pytest.approx([0.13, 0.12])


def _mass(robot: rp.Robot, link: str) -> float:
    body = robot.model.frames[robot.model.getFrameId(link, pin.BODY)].parentJoint
    return float(robot.model.inertias[body].mass)


def test_a_continuous_joint_that_is_coupled_keeps_its_limits_of_speed_and_effort(tmp_path: Path) -> None:
    """Counting its turns takes none of them away, nor its friction."""
    path = tmp_path / "gears.urdf"
    link = '<inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial></link>'
    joint = '<joint name="{0}" type="continuous"><parent link="base"/><child link="{0}_link"/><axis xyz="0 0 1"/>'
    path.write_text(
        f'<robot name="gears"><link name="base"/><link name="a_link">{link}<link name="b_link">{link}'
        + joint.format("a")
        + '<limit effort="9" velocity="7"/><dynamics damping="0.5"/></joint>'
        + joint.format("b")
        + '<mimic joint="a" multiplier="-3"/></joint></robot>'
    )
    robot = rp.load_robot(path, actuated="a")
    column = robot.model.joints[robot.model.getJointId("a")].idx_v
    assert (robot.model.upperEffortLimit[column], robot.model.upperVelocityLimit[column]) == (9.0, 7.0)
    motion = rp.PlatformMotion([0.0], [[0.1]], [[2.0]], [[3.0]])
    tau = rp.distribute(rp.RneaDynamics(robot).reduce(motion)).tau[0, 0]
    assert tau == pytest.approx(3.0 * (1.0 + 9.0) + 0.5 * 2.0)


@pytest.mark.parametrize(
    ("name", "text", "what"), [("robot", "<robot/>", "is a URDF"), ("robot.txt", "root:x:0", "is no model")]
)
def test_a_model_is_read_by_its_name(name: str, text: str, what: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text)
    (tmp_path / "robot.yaml").write_text(f"urdf: {name}\nactuated: [a]\nreference: {{}}\n")
    with pytest.raises(RedundancyPinError, match=f"{what}, and by its name no URDF.*call it .urdf"):
        rp.load_robot(tmp_path)
