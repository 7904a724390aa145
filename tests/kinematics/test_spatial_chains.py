"""Universal, hinge and cylindrical closures and continuous joints, judged by Pinocchio's frame placements."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import zoo
from loop_oracle import Loops
from spatial_chains import CHAINS, RCCC_TWISTS, chain_of
from written import urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin import PlatformMotion, RneaDynamics, distribute, forward_kinematics, load_robot
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.robot import AXES, Robot

CLOSED = 1e-11  # the package's own closure tolerance, here measured by Pinocchio


def swing(robot: Robot, t: np.ndarray) -> PlatformMotion:
    angle = zoo.home_of(robot)[0] + 0.4 * np.sin(5 * t)
    return PlatformMotion(t, angle[:, None], 2 * np.cos(5 * t)[:, None], -10 * np.sin(5 * t)[:, None])


def relative_placements(robot: Robot, q: np.ndarray) -> list[pin.SE3]:
    """Return frame b seen from frame a, configuration by configuration."""
    data, closure = robot.model.createData(), robot.closures[0]
    result = []
    for configuration in q:
        pin.framesForwardKinematics(robot.model, data, configuration)
        a, b = (data.oMf[robot.model.getFrameId(name)] for name in (closure.frame_a, closure.frame_b))
        result.append(a.actInv(b))
    return result


@pytest.mark.parametrize("name", CHAINS)
def test_lifted_motion_closes_the_joint_as_pinocchio_sees_it(name: str) -> None:
    robot = chain_of(name)
    for placement in relative_placements(robot, inverse_kinematics(robot, swing(robot, np.linspace(0.0, 1.5, 40))).q):
        translation, turn = placement.translation, placement.rotation
        if name == "rod":
            assert np.linalg.norm(translation) == pytest.approx(robot.closures[0].length, abs=CLOSED)
            continue
        # centres together, those of a cylindrical joint on one line
        np.testing.assert_allclose(translation[: 2 if name == "cylindrical" else 3], 0.0, atol=CLOSED)
        if name == "universal":  # the cross square
            assert turn[1, 0] == pytest.approx(0.0, abs=CLOSED)
        if name in ("hinge", "cylindrical"):  # axes the same way
            np.testing.assert_allclose(turn[:, 2], [0.0, 0.0, 1.0], atol=CLOSED)


def test_positions_of_joints_are_what_encoders_read() -> None:
    """Continuous joints, which have a cosine and a sine in q, lead from the motor to all joints and back."""
    robot = chain_of("continuous")
    motion = PlatformMotion(np.arange(5.0), np.array([[-3.0], [-1.0], [0.1], [1.0], [3.1]]), *np.zeros((2, 5, 1)))
    tree = inverse_kinematics(robot, motion)
    np.testing.assert_allclose(robot.joint_positions(tree.q), motion.x, atol=1e-15)
    names = ["rocker", "crank", "coupler"]
    rocker, crank, coupler = robot.joint_positions(tree.q, names).T
    # the loop in the plane: crank pin from both sides
    ends = 0.1 * np.exp(1j * crank) - 0.4 - 0.25 * np.exp(1j * rocker)
    np.testing.assert_allclose(0.35 * np.exp(1j * (rocker + coupler)), ends, atol=1e-11)
    home = robot.joint_positions(robot.q_reference)
    assert home.shape == (1,)
    found = forward_kinematics(robot, robot.joint_positions(tree.q), start=tree.q[0])
    np.testing.assert_allclose(np.exp(1j * found.x), np.exp(1j * motion.x), atol=1e-12)
    state = rp.CompiledDynamics(robot).joint_state(home)
    np.testing.assert_allclose(robot.joint_positions(state.q, names), robot.joint_positions(robot.q_reference, names))


@pytest.mark.parametrize("axis", AXES)
def test_any_coordinate_of_the_rocker_has_the_efforts_of_the_crank(axis: str, tmp_path: Path) -> None:
    """One motion by the crank, and by a place or an angle of the rocker. Its z axis is the one about which it turns:
    the angle of that axis about y stays, and another axis tells it."""
    joints, declaration = CHAINS["hinge"]
    crank = chain_of("hinge")
    guess = dict(zip(list(crank.model.names)[1:], crank.q_reference.tolist(), strict=True))
    roles = {"actuated": ["crank"], "independent": {"platform": "rocker_link", "axes": [axis]}}
    robot = load_robot(
        write_robot(tmp_path, urdf_of(joints), {**declaration, **roles, "reference": {"guess": guess}}),
        gravity=(0.3, -9.0, 1.0),
    )
    assert robot.platform is not None
    data, k, step = robot.model.createData(), AXES.index(axis) % 3, 2e-3
    moved = swing(crank, 0.05 + step * np.arange(-2.0, 3.0))
    x = []
    for q in inverse_kinematics(crank, moved).q:
        pin.framesForwardKinematics(robot.model, data, q)
        place = data.oMf[robot.model.getFrameId("rocker_link", pin.BODY)]
        pointer = place.rotation[:, robot.platform.pointer]
        angle = np.arctan2(pointer[(k + 2) % 3], pointer[(k + 1) % 3])
        x.append(angle if axis.startswith("r") else place.translation[k])
    xd = np.dot([1, -8, 0, 8, -1], x) / (12.0 * step)
    xdd = np.dot([-1, 16, -30, 16, -1], x) / (12.0 * step**2)
    motion = PlatformMotion([0.0], [[x[2]]], [[xd]], [[xdd]])
    want = RneaDynamics(dataclasses.replace(crank, model=robot.model)).reduce(moved)
    got = RneaDynamics(robot).reduce(motion)
    np.testing.assert_allclose(distribute(got).tau[0], distribute(want).tau[2], rtol=1e-6)


@pytest.mark.parametrize("turns", [0, 1])
def test_forward_kinematics_of_a_continuous_motor(turns: int) -> None:
    robot = chain_of("continuous")
    solution = forward_kinematics(robot, [1.2 + 2 * np.pi * turns])
    assert solution.known.all()
    at = zoo.index(robot, "crank")
    np.testing.assert_allclose(solution.q[0, at : at + 2], [np.cos(1.2), np.sin(1.2)], atol=CLOSED)


def test_a_planar_four_bar_closed_by_a_hinge_names_the_rows_to_take_out(tmp_path: Path) -> None:
    joints, declaration = CHAINS["continuous"]
    hinge = {"frames": ["crank_tip", "coupler_tip"], "axes": ["x", "y", "z", "rx", "ry"]}
    hinged = {**declaration, "closures": [hinge], "actuated": ["crank"], "independent": {"joints": ["crank"]}}
    with pytest.raises(DeclarationError, match=r"z of .*, rx of .*, ry of ") as caught:
        load_robot(write_robot(tmp_path, urdf_of(joints), hinged))
    assert caught.value.details["freedoms"] == -2


# --- the spin of a rod between two balls of the tree is held


CRANK, ROD, ROCKER = 0.1, 0.2, np.array([0.02, 0.0, 0.2])
"""m: the crank from the origin along x, a rod on a ball, a rocker on a second ball; two points lead the rocker."""

PIVOT = np.array([CRANK + ROD, 0.0, 0.0]) + ROCKER

SMALL = f"""<mujoco model="small"><compiler angle="radian"/><worldbody>
<body name="crank"><joint name="motor" axis="0 1 0"/><inertial pos="0.05 0 0" mass="0.2" diaginertia="1e-4 2e-4 2e-4"/>
<body name="rod" pos="{CRANK} 0 0"><joint name="near" type="ball"/>
<inertial pos="0.1 0 0" mass="0.3" diaginertia="1e-5 1e-3 1e-3"/>
<body name="rocker" pos="{ROD} 0 0"><joint name="far" type="ball"/>
<inertial pos="0 0 0.1" mass="0.25" diaginertia="5e-4 5e-4 1e-5"/>
<site name="p" pos="0.02 0.05 0.2"/><site name="m" pos="0.02 -0.05 0.2"/></body></body></body>
<site name="wp" pos="{PIVOT[0]} 0.05 {PIVOT[2]}"/><site name="wm" pos="{PIVOT[0]} -0.05 {PIVOT[2]}"/>
</worldbody><equality><connect site1="p" site2="wp"/><connect site1="m" site2="wm"/></equality>
<actuator><motor joint="motor"/></actuator></mujoco>"""


def planar() -> Loops:
    """Return the same linkage with hinges about y in place of balls, its pivot held in x and z."""
    model, parent = pin.Model(), 0
    bodies = [
        (0.0, 0.2, [0.05, 0.0, 0.0], [1e-4, 2e-4, 2e-4]),
        (CRANK, 0.3, [0.1, 0.0, 0.0], [1e-5, 1e-3, 1e-3]),
        (ROD, 0.25, [0.0, 0.0, 0.1], [5e-4, 5e-4, 1e-5]),
    ]
    for i, (at, mass, centre, moments) in enumerate(bodies):
        place = pin.SE3(np.eye(3), np.array([at, 0.0, 0.0]))
        parent = model.addJoint(parent, pin.JointModelRY(), place, f"hinge_{i}")
        model.appendBodyToJoint(parent, pin.Inertia(mass, np.array(centre), np.diag(moments)), pin.SE3.Identity())
    for name, joint, at in (("tip", parent, ROCKER), ("pivot", 0, PIVOT)):
        model.addFrame(pin.Frame(name, joint, pin.SE3(np.eye(3), at), pin.FrameType.OP_FRAME))
    return Loops(model, [("pivot", "tip")], ["hinge_0"], (0, 2))


def test_a_rod_between_two_balls_of_the_tree(tmp_path: Path) -> None:
    """One degree of freedom, and the efforts of the planar linkage."""
    pytest.importorskip("mujoco")
    path = tmp_path / "small.xml"
    path.write_text(SMALL)
    robot = rp.load_robot(path)
    assert (robot.n, robot.independent_joints) == (1, ("motor",))
    assert any(note.startswith("The spin of near about the line between two balls") for note in robot.notes)
    dynamics = rp.RneaDynamics(robot)
    for motion in ((0.0, 0.0, 0.0), (0.3, 2.0, -4.0), (-0.2, -3.0, 5.0)):
        tau = dynamics.torque(*(np.array([each]) for each in motion)).tau
        np.testing.assert_allclose(tau, planar().torque(*(np.array([each]) for each in motion)), rtol=1e-9)


def test_a_centre_of_mass_off_the_line_by_little_is_noted(tmp_path: Path) -> None:
    """0.1 mm of 0.2 m is no rounding: what holds the spin carries its moment."""
    pytest.importorskip("mujoco")
    path = tmp_path / "small.xml"
    for height, is_noted in ((0.0, False), (1e-4, True)):
        path.write_text(SMALL.replace('pos="0.1 0 0"', f'pos="0.1 0 {height}"'))
        notes = [note for note in rp.load_robot(path).notes if "off that line: near by 0.0001 m" in note]
        assert len(notes) == is_noted
        assert any("off that line" in note for note in rp.load_robot(path).notes) == is_noted


def test_rccc_axes_obey_the_spherical_four_bar() -> None:
    """Duffy's cosine law: the axes' directions form a spherical quadrilateral, whatever the slides do."""
    robot = chain_of("cylindrical")
    q = inverse_kinematics(robot, swing(robot, np.linspace(0.0, 1.2, 15))).q
    crank, turn_2 = (q[:, zoo.index(robot, name)] for name in ("crank", "turn_2"))
    alpha, beta, gamma, delta = RCCC_TWISTS
    # axis 1 = z of the base, axis 4 = z of the pivot; axes 3 and 4 keep the angle gamma
    axis_4 = np.array([0.0, -np.sin(delta), np.cos(delta)])
    about_z = np.array([[np.cos(crank), -np.sin(crank)], [np.sin(crank), np.cos(crank)]])
    inner = np.array([np.sin(beta) * np.sin(turn_2), -np.sin(beta) * np.cos(turn_2), np.full_like(crank, np.cos(beta))])
    y = np.cos(alpha) * inner[1] - np.sin(alpha) * inner[2]
    z = np.sin(alpha) * inner[1] + np.cos(alpha) * inner[2]
    axis_3 = np.array([about_z[0, 0] * inner[0] + about_z[0, 1] * y, about_z[1, 0] * inner[0] + about_z[1, 1] * y, z])
    np.testing.assert_allclose(axis_4 @ axis_3, np.cos(gamma), atol=CLOSED)


def test_a_hinge_turned_over_is_not_closed() -> None:
    """Opposite hinge axes make all five rows vanish; only the misalignment tells."""
    robot = chain_of("hinge")
    system = zoo.system_of(robot)
    rng = np.random.default_rng(2)
    q = robot.q_reference + rng.uniform(-np.pi, np.pi, (200, robot.model.nq))
    assembled = assemble(system, q, np.full((200, 1), 0.6))
    upright = np.array([placement.rotation[2, 2] for placement in relative_placements(robot, assembled.q)])
    rows_vanish = np.abs(assembled.state.phi).max(axis=1) < CLOSED
    over = rows_vanish & (upright < 0.0)
    assert over.any()
    assert not assembled.closed[over].any()
    np.testing.assert_allclose(assembled.residual[over], np.pi * robot.characteristic_length, atol=1e-6)
    assert assembled.closed[rows_vanish & (upright > 0.0)].all()
