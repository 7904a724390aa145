"""Efforts that loads of a planar mechanism require, by virtual work.

A force F at a point whose velocity per unit of a platform rate is H, and a moment M on a link that spins by G per unit
of it, have the power Re(conj(F) H) + M G; what acts in a joint has its effort times the joint's rate. Whatever moves
the platform resists with f, so f falls by that power. Forces along z and moments about x and y do no work, and reach
the base alone.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.virtual_work.mechanism import (
    Body,
    Carriers,
    ComplexArray,
    Efforts,
    PlanarDynamics,
    PlanarFrame,
    wrench_on_ground,
)
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.robot import JointForces, Payload, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind


def require_known(robot: Robot, frames: Sequence[str], joints: Sequence[str]) -> None:
    """Check that the closed form has the links and joints of the robot's loads.

    Raises:
        UnsupportedRobotError: it has not.
    """
    for load in robot.loads:
        in_joint, between = isinstance(load, JointForces), isinstance(load, Spring)
        known = joints if in_joint else frames
        for name in ("joint",) if in_joint else ("frame_a", "frame_b") if between else ("frame",):
            if getattr(load, name) not in known:
                raise UnsupportedRobotError(
                    f"The closed form of {robot.name} does not cover {load!r}.",
                    remedy=f"It has the links {', '.join(frames)} and the joints {', '.join(joints)}; RneaDynamics has "
                    "all.",
                    name=getattr(load, name),
                )


def add_loads(
    efforts: Efforts, robot: Robot, wrenches: Sequence[Array], dynamics: PlanarDynamics, carriers: Carriers
) -> None:
    """Add the efforts that balance the loads of a robot at N samples.

    Args:
        efforts: the sum, changed in place.
        robot: the robot.
        wrenches: (N, 6) the value of each wrench.
        dynamics: dynamics along the motion, which place links and joints.
        carriers: s, ṡ, s̈, (legs, N) each.
    """
    for wrench, value in zip(of_kind(robot.loads, Wrench), wrenches, strict=True):
        here = dynamics.frame(wrench.frame, carriers)
        axis = here.axis if wrench.reference == "local" else 1.0
        push, tilt = (value[:, 0] + 1j * value[:, 1]) * axis, (value[:, 3] + 1j * value[:, 4]) * axis
        point, height = here.point(complex(wrench.point[0], wrench.point[1])), float(wrench.point[2])
        efforts.resist(point, push, value[:, 5])
        if here.moves:
            efforts.ground += wrench_on_ground(point.place, height, push, value[:, 2], tilt, value[:, 5])

    for load in of_kind(robot.loads, Payload):
        (x, y, z), inertia = load.centre, load.inertia
        body = Body(load.frame, load.mass, complex(x, y), inertia[2, 2], z, complex(inertia[0, 2], inertia[1, 2]))
        body.add_to(efforts, dynamics.frame(load.frame, carriers), robot.gravity)

    for spring in of_kind(robot.loads, Spring):
        ends = [
            dynamics.frame(frame, carriers).point(complex(end[0], end[1]))
            for frame, end in ((spring.frame_a, spring.point_a), (spring.frame_b, spring.point_b))
        ]
        pull, changes, stored = _spring(spring, *ends)
        efforts.resist(ends[0], pull, changes=changes)
        efforts.resist(ends[1], -pull, changes={i: [-part for part in parts] for i, parts in changes.items()})
        efforts.energy += stored

    for forces in of_kind(robot.loads, JointForces):
        joint = dynamics.joint(forces.joint, carriers)
        revolute, momentum = joint.axis is None, forces.rotor_inertia * forces.gear
        home = float(robot.q_reference[list(robot.model.names)[1:].index(forces.joint)])  # a coordinate per joint
        position = _counted(joint.position, home) if revolute else joint.position
        turning = joint.link.spin_rate if revolute else 0.0
        effort = forces.resistance(position, joint.rate) + momentum * (forces.gear * joint.acceleration + turning)
        efforts.f += effort * joint.unit_rate
        efforts.energy += 0.5 * forces.stiffness * (position - forces.rest) ** 2
        efforts.energy += 0.5 * momentum * forces.gear * joint.rate**2
        if joint.carrier is not None:
            efforts.force[joint.carrier] += effort
            by_motion = forces.stiffness, forces.resistance_rate(joint.rate), momentum * forces.gear
            for derivative, part in zip(efforts.by_force, by_motion if efforts.derivatives else (), strict=False):
                derivative[joint.carrier, joint.carrier] += part
        if joint.axis is None:
            efforts.f += momentum * joint.acceleration * joint.link.G
            efforts.energy += momentum * joint.rate * joint.link.spin
            efforts.ground[:, 5] -= momentum * joint.acceleration
        else:  # it spins about an axis in the plane, and the link turns it
            rate = momentum * (joint.acceleration + 1j * joint.link.spin * joint.rate) * joint.axis
            efforts.ground[:, 3] -= rate.real
            efforts.ground[:, 4] -= rate.imag


def _spring(
    spring: Spring, a: PlanarFrame, b: PlanarFrame
) -> tuple[ComplexArray, dict[int, list[ComplexArray]], Array]:
    """Return the force (N,) on the end a, its derivatives by carrier and by s, ṡ, s̈, and the energy (N,).

    F = φ e with e = (z_b − z_a) / l and φ = k (l − l₀) + c Re(conj(e) ż); ends at different heights add to l alone.
    """
    line, speed, rise = b.place - a.place, b.velocity - a.velocity, float(spring.point_b[2] - spring.point_a[2])
    length = np.hypot(np.abs(line), rise)
    inverse = np.divide(1.0, length, out=np.zeros_like(length), where=length > 0.0)
    along = line * inverse
    size = spring.stiffness * (length - spring.length) + spring.damping * (np.conj(along) * speed).real
    changes: dict[int, list[ComplexArray]] = {}
    for end, sign in ((b, 1.0), (a, -1.0)):
        if end.track is None or end.carrier is None:
            continue
        moved, turned = sign * end.track, sign * 1j * end.spin * end.track  # of the line and of its rate, by s
        stretch = (np.conj(along) * moved).real
        swing = (moved - along * stretch) * inverse
        rate = (np.conj(swing) * speed).real + (np.conj(along) * turned).real
        by_s = (spring.stiffness * stretch + spring.damping * rate) * along + size * swing
        parts = [by_s, spring.damping * stretch * along, np.zeros_like(line)]
        if end.carrier in changes:  # both ends on one carrier
            parts = [one + other for one, other in zip(changes[end.carrier], parts, strict=True)]
        changes[end.carrier] = parts
    return size * along, changes, 0.5 * spring.stiffness * (length - spring.length) ** 2


def _counted(angle: Array, reference: float) -> Array:
    """Return the angles of one motion with their full turns, the first nearest to the reference."""
    counted, known = np.array(angle), np.isfinite(angle)
    if known.any():
        whole = np.unwrap(angle[known])
        counted[known] = whole + 2.0 * np.pi * np.round((reference - whole[0]) / (2.0 * np.pi))
    return counted
