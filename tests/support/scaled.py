"""The same machine and motion in other units: lengths times L, masses times M, times times T.

What a robot is, is scaled number by number in its Pinocchio tree, so that nothing of the package takes part in it but
``robot_from_model``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.loading import robot_from_model
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot.loads import JointForces, Load, Payload, Spring
from redundancy_pin.robot.types import Robot, slides


@dataclass(frozen=True)
class Units:
    """Factors by which lengths, masses and times grow."""

    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0

    @property
    def force(self) -> float:
        """Of a force."""
        return self.mass * self.length / self.time**2

    @property
    def torque(self) -> float:
        """Of a torque, and of an energy."""
        return self.force * self.length


def scaled_robot(robot: Robot, units: Units) -> Robot:
    """Return the robot with every length, mass and time in its tree and its loads scaled."""
    L, M, T = units.length, units.mass, units.time
    model, q = robot.model.copy(), np.array(robot.q_reference)
    for index in range(1, model.njoints):
        placement, body = model.jointPlacements[index], model.inertias[index]
        model.jointPlacements[index] = pin.SE3(placement.rotation, L * placement.translation)
        model.inertias[index] = pin.Inertia(M * body.mass, L * body.lever, M * L**2 * body.inertia)
        joint = model.joints[index]
        at, place = slice(joint.idx_v, joint.idx_v + joint.nv), slice(joint.idx_q, joint.idx_q + joint.nq)
        slide = slides(joint)
        unit = L if slide else 1.0
        force = units.force if slide else units.torque
        if joint.shortname() in ("JointModelFreeFlyer", "JointModelTranslation"):
            q[joint.idx_q : joint.idx_q + 3] *= L
        q[place] *= unit
        for limits in (model.lowerPositionLimit, model.upperPositionLimit):
            limits[place] = np.clip(limits[place] * unit, -1e300, 1e300)
        for limits in (model.lowerEffortLimit, model.upperEffortLimit):
            limits[at] = limits[at] * force if np.isfinite(limits[at] * force).all() else limits[at]
        model.upperVelocityLimit[at] = model.upperVelocityLimit[at] * unit / T
        model.lowerVelocityLimit[at] = model.lowerVelocityLimit[at] * unit / T
        inertia = M if slide else M * L**2
        model.armature[at] *= inertia
        model.rotorInertia[at] *= inertia
    for frame in model.frames:
        frame.placement = pin.SE3(frame.placement.rotation, L * frame.placement.translation)
        if frame.inertia.mass:
            frame.inertia = pin.Inertia(
                M * frame.inertia.mass, L * frame.inertia.lever, M * L**2 * frame.inertia.inertia
            )
    model.gravity = pin.Motion(model.gravity.linear * L / T**2, np.zeros(3))
    carriers = [
        {
            "joint": name,
            "position": [limits.lower * L, limits.upper * L],
            "speed": limits.speed * L / T,
            "acceleration": limits.acceleration * L / T**2,
            "force": limits.force * units.force,
        }
        for name, limits in zip(robot.carriers, robot.carrier_limits, strict=True)
    ]
    declared = None
    if robot.working_modes is not None:
        modes = robot.working_modes
        declared = {"joints": list(modes.joints), "signs": list(modes.signs), "default": list(robot.working_mode)}
    made = robot_from_model(
        model,
        actuated=robot.actuated,
        closures=[replace(each, length=each.length * units.length) for each in robot.closures],
        carriers=[_finite(each) for each in carriers],
        independent=robot.platform or list(robot.independent_joints),
        reference=q,
        name=robot.name,
        couplings=robot.couplings,
        working_modes=declared,
    )
    loads = [_load(robot, each, units) for each in robot.loads if not isinstance(each, Payload)]
    return made.loaded(*loads) if loads else made


def _finite(carrier: dict[str, object]) -> dict[str, object]:
    return {
        key: value for key, value in carrier.items() if key == "joint" or np.isfinite(np.asarray(value, float)).all()
    }


def _load(robot: Robot, load: Load, units: Units) -> Load:
    L, M, T = units.length, units.mass, units.time
    if isinstance(load, Spring):
        return Spring(
            load.frame_a, load.frame_b, stiffness=load.stiffness * M / T**2, damping=load.damping * M / T,
            length=load.length * L, point_a=load.point_a * L, point_b=load.point_b * L,
        )  # fmt: skip
    assert isinstance(load, JointForces), load
    slide = slides(robot.model.joints[robot.model.getJointId(load.joint)])
    unit, force = (L, units.force) if slide else (1.0, units.torque)
    return JointForces(
        load.joint, damping=load.damping * force * T / unit, friction=load.friction * force,
        friction_speed=load.friction_speed * unit / T, stiffness=load.stiffness * force / unit, rest=load.rest * unit,
        rotor_inertia=load.rotor_inertia * M * L**2, gear=load.gear / unit,
    )  # fmt: skip


def coordinate_units(robot: Robot, units: Units) -> Array:
    """Return (n,) the factor of each independent velocity, times T."""
    if robot.platform is not None:
        return np.array([units.length if axis in "xyz" else 1.0 for axis in robot.platform.axes])
    joints = (robot.model.joints[robot.model.getJointId(name)] for name in robot.independent_joints)
    return np.array([units.length if slides(joint) else 1.0 for joint in joints])


def effort_units(robot: Robot, units: Units) -> Array:
    """Return (m,) the factor of each main actuator's effort."""
    joints = (robot.model.joints[robot.model.getJointId(name)] for name in robot.actuated)
    return np.array([units.force if slides(joint) else units.torque for joint in joints])


def scaled_motion(robot: Robot, motion: PlatformMotion, units: Units) -> PlatformMotion:
    """Return the platform's motion in other units."""
    unit, T = coordinate_units(robot, units), units.time
    x = np.array(motion.x)
    if x.ndim == 3:
        x[:, :3, 3] *= units.length
    else:
        x = x * unit
    return PlatformMotion(motion.t * T, x, motion.xd * unit / T, motion.xdd * unit / T**2)


def scaled_carriers(motion: CarrierMotion, units: Units) -> CarrierMotion:
    """Return the carriers' motion in other units; they slide."""
    L, T = units.length, units.time
    return CarrierMotion(motion.s * L, motion.sd * L / T, motion.sdd * L / T**2)
