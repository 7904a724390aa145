"""Models of MuJoCo, written here, and how the same robot comes out of MuJoCo's own reader."""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path

import numpy as np

from redundancy_pin.arrays import Array

FOUR_BAR = """<mujoco model="four_bar">
  <compiler angle="radian" autolimits="true"/>
  <option gravity="0 -9.81 0" timestep="0.001"/>
  <default>
    <joint axis="0 0 1" damping="0.1"/>
    <geom type="capsule" size="0.02" density="700"/>
    <default class="heavy"><geom density="2000"/><joint armature="0.01"/></default>
  </default>
  <worldbody>
    <light pos="0 0 3"/>
    <geom type="plane" size="1 1 0.1" contype="0" conaffinity="0"/>
    <body name="crank" childclass="heavy">
      <joint name="crank" range="-3 3"/>
      <geom fromto="0 0 0 0.2 0 0"/>
      <body name="coupler" pos="0.2 0 0" euler="0 0 -1.2">
        <joint name="elbow" class="main"/>
        <geom fromto="0 0 0 0.5 0 0" class="main"/>
        <site name="tip" pos="0.5 0 0"/>
      </body>
    </body>
    <body name="rocker" pos="0.35 0 0" euler="0 0 -0.4">
      <joint name="rocker"/>
      <geom fromto="0 0 0 0.45 0 0"/>
      <site name="end" pos="0.45 0 0" euler="0.3 0.4 0.5"/>
    </body>
  </worldbody>
  <equality><connect name="pin" site1="tip" site2="end"/></equality>
  <actuator><motor name="drive" joint="crank" gear="20" ctrlrange="-2 3"/></actuator>
</mujoco>
"""
"""Not closed at its initial configuration."""

_ROTORS = """<body name="rotor" pos="0 0.3 0"><joint name="rotor" ref="0.3"/><geom type="sphere" size="0.1"/></body>
<body name="cam" pos="0 0.5 0"><joint name="cam" type="slide" axis="1 2 0" ref="-0.1"/>
<geom type="sphere" size="0.1"/></body>"""
_GEARS = """<joint name="gears" joint1="rotor" joint2="rocker" polycoef="0.2 -12"/>
<joint name="cam" joint1="cam" joint2="rotor" polycoef="0 0.01 0.002 -0.0005 0.0001"/>"""
GEARED = FOUR_BAR.replace("</worldbody>", f"{_ROTORS}</worldbody>").replace("</equality>", f"{_GEARS}</equality>")

SPATIAL = """<mujoco model="spatial">
  <include file="settings.xml"/>
  <worldbody>
    <frame pos="0 0 1" euler="90 0 0">
      <body name="slider" pos="0.1 0.2 0.3" axisangle="1 1 0 30">
        <inertial pos="0.01 0.02 0.03" quat="0.9 0.1 0.2 0.3" mass="1.5" diaginertia="0.02 0.03 0.04"/>
        <joint name="slide" type="slide" stiffness="50" springref="0.3" axis="1 2 3" pos="0.1 0.2 0.3" ref="0.05"/>
        <frame pos="0.02 0.01 -0.03" euler="10 0 20">
          <joint name="turn" axis="0 1 0" pos="0.05 0 0.02" ref="20" range="-90 90"/>
        </frame>
        <geom type="box" size="0.1 0.05 0.02"/>
        <body name="rod" pos="0 0 0.2" zaxis="1 0 1">
          <joint name="ball" type="ball" pos="0 0.01 0" armature="0.02" damping="0.3"/>
          <geom type="cylinder" size="0.01 0.2"/>
          <geom type="ellipsoid" size="0.05 0.03 0.02" pos="0 0 0.2" mass="0.3"/>
          <frame euler="0 30 0"><geom type="sphere" size="0.03" pos="0.1 0 0"/></frame>
          <site name="far" pos="0 0 0.4"/>
          <site name="drawn" fromto="0 0.1 0 0.2 0.3 0.4" size="0.01" type="capsule"/>
          <body name="lump" euler="10 30 50" pos="0.1 0 0.1">
            <inertial pos="0 0.1 0" mass="0.7" fullinertia="0.01 0.02 0.015 0.001 0.004 -0.002"/>
          </body>
        </body>
      </body>
    </frame>
    <body name="arm" pos="0.5 0.1 1.4" xyaxes="0 1 0 0.1 0.3 1">
      <inertial pos="0 0.1 0" mass="0.7" fullinertia="0.01 0.02 0.015 0.001 0.002 -0.001"/>
      <joint name="shoulder" axis="0 0 1"/>
      <body name="fore" pos="0.3 0 0.1">
        <joint name="fore" axis="1 0 0" stiffness="3" springref="20" damping="0.2"/>
        <geom type="capsule" fromto="0.1 0 0 0.2 0.1 0.3" size="0.02"/>
        <geom type="box" fromto="0 0 0 0 0.1 0" size="0.01"/>
        <site name="near" pos="0.2 0.1 0.3"/>
      </body>
    </body>
  </worldbody>
  <equality>
    <connect name="joint" body1="rod" body2="fore" anchor="0 0 0.4"/>
  </equality>
  <actuator>
    <position joint="slide" kp="10"/><motor joint="turn"/><motor joint="shoulder" gear="-2" forcerange="-3 3"/>
  </actuator>
  <keyframe><key name="bent" qpos="0.1 0.2 0.8 0.2 0.4 0.4 0.3 -0.2"/></keyframe>
</mujoco>
"""
SETTINGS = """<mujocoinclude>
  <compiler eulerseq="XYZ" autolimits="false"/>
  <compiler autolimits="true"/>
  <option><flag contact="disable"/></option>
  <default><joint frictionloss="0"/><default class="other"><geom rgba="1 0 0 1"/></default></default>
</mujocoinclude>
"""

RSSR = """<mujoco model="rssr">
  <worldbody>
    <site name="ground_a" pos="0.5 0.1 0"/><site name="ground_b" pos="0.5 0.2 0.03"/>
    <body name="crank"><joint name="crank" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.1" size="0.02"/>
      <body name="rod" pos="0 0 0.1"><joint name="ball" type="ball" armature="0.001" damping="0.05"/>
        <geom type="capsule" fromto="0 0 0 0.4 0.1 0.1" size="0.02"/>
        <body name="rocker" pos="0.4 0.1 0.1"><joint name="second" type="ball" damping="0.02"/>
          <geom type="capsule" fromto="0 0 0 0.1 0 -0.2" size="0.02"/>
          <site name="a" pos="0.1 0 -0.2"/><site name="b" pos="0.1 0.1 -0.17"/>
        </body>
      </body>
    </body>
  </worldbody>
  <equality>
    <connect name="a" site1="a" site2="ground_a"/><connect name="b" site1="b" site2="ground_b"/>
  </equality>
  <actuator><motor joint="crank"/></actuator>
</mujoco>
"""
"""A rod between two balls of the tree; the rocker's hinge is two points on its axis, a row of them redundant."""

WELD = """<mujoco model="welded">
  <compiler angle="radian"/>
  <worldbody>
    <body name="left" pos="0 0 0.1"><joint name="left" axis="0 1 0"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.02"/>
      <body name="top" pos="0 0 0.3" euler="0 0.2 0"><joint name="elbow" axis="0 1 0"/>
        <geom type="capsule" fromto="0 0 0 0.25 0 0" size="0.02"/></body>
    </body>
    <body name="right" pos="0.4 0 0.1"><joint name="right" axis="0 1 0" stiffness="2"/>
      <geom type="capsule" fromto="0 0 0 0 0 0.3" size="0.02"/>
      <body name="stub" pos="0 0 0.3" euler="0 -0.4 0"><joint name="wrist" axis="0 1 0"/>
        <geom type="sphere" size="0.03" pos="-0.05 0 0"/></body>
    </body>
  </worldbody>
  <equality><weld name="glue" body1="top" body2="stub" {weld}/></equality>
  <actuator><motor joint="left"/></actuator>
</mujoco>
"""


FREE = """<mujoco model="free">
  <worldbody>
    <body name="trunk" pos="0.1 0.2 0.9" euler="10 20 30">
      {root}
      <geom type="box" size="0.2 0.1 0.05" density="500"/>
      <body name="upper" pos="0.1 0 0"><joint name="hip" axis="0 1 0"/>
        <geom type="sphere" size="0.05" pos="0 0 -0.1"/></body>
    </body>
  </worldbody>
  <actuator><motor joint="hip"/></actuator>
  <keyframe><key name="lying" qpos="{key} 0.3"/></keyframe>
</mujoco>
"""


def write(folder: Path, text: str) -> Path:
    """Write a model and what it includes."""
    (folder / "settings.xml").write_text(SETTINGS)
    path = folder / "model.xml"
    path.write_text(text)
    return path


class Engine:
    """MuJoCo with the model of a file, in the coordinates of the robot that was loaded from it.

    Joints have the same order in both; a ball's quaternion is w, x, y, z there.
    """

    def __init__(self, path: Path) -> None:
        import mujoco

        self.mujoco = mujoco
        self.model = mujoco.MjModel.from_xml_path(str(path))
        # only equalities, inertia, dampers and springs: what the robot has
        self.model.dof_frictionloss[:] = 0.0
        self.model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_LIMIT
        self.data = mujoco.MjData(self.model)

    def set(self, robot, q: Array, v: Array | None = None, without: Collection[str] = ()) -> None:
        """Set the state of a robot, but for joints that MuJoCo has not: those of tendons."""
        for index in range(1, robot.model.njoints):
            if robot.model.names[index] in without:
                continue
            joint, name = robot.model.joints[index], robot.model.names[index]
            own = self.model.joint(name)
            part = q[joint.idx_q : joint.idx_q + joint.nq]
            self.data.qpos[own.qposadr[0] : own.qposadr[0] + joint.nq] = (
                np.array([part[3], *part[:3]]) if joint.nq == 4 else part
            )
            if v is not None:
                self.data.qvel[own.dofadr[0] : own.dofadr[0] + joint.nv] = v[joint.idx_v : joint.idx_v + joint.nv]
        self.mujoco.mj_forward(self.model, self.data)

    def columns(self, robot, without: Collection[str] = ()) -> tuple[list[int], list[int]]:
        """Return the index in MuJoCo's velocities of each of the robot's, and which of the robot's these are."""
        columns, kept = [], []
        for name, joint in list(zip(robot.model.names, robot.model.joints, strict=True))[1:]:
            if name not in without:
                columns += [int(self.model.joint(name).dofadr[0]) + i for i in range(joint.nv)]
                kept += range(joint.idx_v, joint.idx_v + joint.nv)
        return columns, kept

    def mass(self) -> Array:
        """Return the mass matrix (nv, nv)."""
        mass: Array = np.zeros((self.model.nv, self.model.nv))
        for column, unit in enumerate(np.eye(self.model.nv)):
            product = np.zeros(self.model.nv)
            self.mujoco.mj_mulM(self.model, self.data, product, unit)
            mass[:, column] = product
        return mass

    def torque(self, robot, a: Array, held: Array) -> Array:
        """Return the efforts (m + k,) of motors and carriers that give the state an acceleration, equalities holding.

        M a + h = p + Sᵀ τ + Jᵀ λ, with p of dampers and springs, all of MuJoCo's own making, solved by
        least squares; ``held`` (h, nv) are rows that the
        robot has and MuJoCo has not.
        """
        nv, (columns, _), mass = self.model.nv, self.columns(robot), self.mass()
        acceleration = np.zeros(nv)
        acceleration[columns] = a
        needed = mass @ acceleration + self.data.qfrc_bias - self.data.qfrc_passive
        equality = self.data.efc_type == self.mujoco.mjtConstraint.mjCNSTR_EQUALITY
        J = np.zeros((int(equality.sum()) + len(held), nv))
        J[len(held) :] = self.data.efc_J.reshape(-1, nv)[equality]
        J[: len(held), columns] = held
        driven = np.concatenate([robot.actuated_velocity, robot.carrier_velocity])
        selection = np.zeros((nv, len(driven)))
        selection[np.array(columns)[driven], np.arange(len(driven))] = 1.0
        matrix = np.concatenate([selection, J.T], axis=1)
        solution, *_ = np.linalg.lstsq(matrix, needed, rcond=1e-9)
        np.testing.assert_allclose(matrix @ solution, needed, atol=1e-9)
        effort: Array = solution[: len(driven)]
        return effort
