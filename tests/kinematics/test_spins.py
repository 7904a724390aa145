"""The spin of a rod between two balls of the tree is held; efforts of the planar linkage by plain Pinocchio."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import redundancy_pin as rp

CRANK, ROD, ROCKER, HALF = 0.1, 0.2, np.array([0.02, 0.0, 0.2]), np.array([0.0, 0.05, 0.0])
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


def planar(x: float, rate: float, acceleration: float) -> float:
    """Return the torque of the same linkage with hinges about y in place of balls, its pivot held in x and z."""
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
    tip = model.addFrame(pin.Frame("tip", parent, pin.SE3(np.eye(3), ROCKER), pin.FrameType.OP_FRAME))
    data, q, v = model.createData(), np.zeros(3), np.zeros(3)
    first = np.array([[1.0, 0.0, 0.0]])
    for _ in range(20):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        rows = pin.getFrameJacobian(model, data, tip, pin.LOCAL_WORLD_ALIGNED)[[0, 2]]
        K = np.concatenate([rows, first])
        q = q + np.linalg.solve(K, np.append((PIVOT - data.oMf[tip].translation)[[0, 2]], x - q[0]))
    v = np.linalg.solve(K, [0.0, 0.0, rate])
    pin.forwardKinematics(model, data, q, v, np.zeros(3))
    bias = pin.getFrameClassicalAcceleration(model, data, tip, pin.LOCAL_WORLD_ALIGNED).linear[[0, 2]]
    a = np.linalg.solve(K, np.append(-bias, acceleration))
    return float(np.linalg.solve(K.T, pin.rnea(model, data, q, v, a))[-1])


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
        np.testing.assert_allclose(tau, [planar(*motion)], rtol=1e-9)


def test_a_centre_of_mass_off_the_line_by_little_is_noted(tmp_path: Path) -> None:
    """0.1 mm of 0.2 m is no rounding: what holds the spin carries its moment."""
    pytest.importorskip("mujoco")
    path = tmp_path / "small.xml"
    for height, is_noted in ((0.0, False), (1e-4, True)):
        path.write_text(SMALL.replace('pos="0.1 0 0"', f'pos="0.1 0 {height}"'))
        notes = [note for note in rp.load_robot(path).notes if "off that line: near by 0.0001 m" in note]
        assert len(notes) == is_noted
        assert any("off that line" in note for note in rp.load_robot(path).notes) == is_noted
