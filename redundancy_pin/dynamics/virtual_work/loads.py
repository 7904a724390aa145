"""What loads ask of a planar mechanism, by virtual work: power per unit of each platform rate and of each carrier's.

A force F (complex, in the plane) at a point whose velocity per unit of a rate is v, and a moment M on a link that turns
by w per unit of it, have the power Re(F̄ v) + M w there; what acts in a joint has its effort times the joint's rate.
Whatever moves the platform resists with f, so f falls by that power. The velocities per unit of ẋ_j are those of the
motion with ẋ = e_j.

Forces along z and moments about x and y do no work, and reach the base alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.virtual_work.mechanism import Body, ComplexArray, PlanarDynamics, wrench_on_ground
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.robot import JointForces, Load, Payload, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind


@dataclass(frozen=True, eq=False)
class LoadEfforts:
    """f (n, N) and forces of the carriers (k, N) that the loads ask for; what reaches the base (N, 6); energy (N,)."""

    f: Array
    force: Array
    ground: Array
    energy: Array


def require_known(robot: Robot, frames: Sequence[str], joints: Sequence[str]) -> None:
    """Check that the closed form has the links and joints of the robot's loads.

    Raises:
        UnsupportedRobotError: it has not.
    """
    for load in robot.loads:
        named = (load.joint,) if isinstance(load, JointForces) else _frames_of(load)
        for name in named:
            if name not in (joints if isinstance(load, JointForces) else frames):
                raise UnsupportedRobotError(
                    f"The closed form of {robot.name} does not cover {load!r}.",
                    remedy=f"It has the links {', '.join(frames)} and the joints {', '.join(joints)}; RneaDynamics has "
                    "all.",
                    name=name,
                )


def _frames_of(load: Load) -> tuple[str, ...]:
    if isinstance(load, Spring):
        return load.frame_a, load.frame_b
    return () if isinstance(load, JointForces) else (load.frame,)


def load_efforts(
    robot: Robot,
    wrenches: Sequence[Array],
    now: PlanarDynamics,
    units: Sequence[PlanarDynamics],
    carriers: tuple[Array, Array, Array],
    *,
    resistance: bool = True,
) -> LoadEfforts:
    """Return what the loads of a robot ask for at N samples.

    Args:
        robot: the robot.
        wrenches: (N, 6) the value of each wrench.
        now: dynamics along the motion (``frame`` and ``joint`` place links and joints).
        units: the same along ẋ = e_j, for each j.
        carriers: s, ṡ, s̈, (legs, N) each.
        resistance: with friction and springs in joints.
    """
    s, sd, sdd = carriers
    samples, parked = s.shape[1], (s, np.zeros_like(s), np.zeros_like(s))
    f, force = np.zeros((len(units), samples)), np.zeros((s.shape[0], samples))
    ground, energy = np.zeros((samples, 6)), np.zeros(samples)

    def resist(frame: str, offset: complex, push: ComplexArray, moment: Array | float) -> None:
        """Add a force on a point of a frame, and a moment on it: what acts on the link."""
        for row, unit in zip(f, units, strict=True):
            moved = unit.frame(frame, *parked)
            row -= (np.conj(push) * moved.point(offset)[1]).real + moment * moved.spin
        here = now.frame(frame, *parked)
        if here.carrier is not None:
            force[here.carrier] -= (np.conj(push) * here.track).real

    for wrench, value in zip(of_kind(robot.loads, Wrench), wrenches, strict=True):
        here = now.frame(wrench.frame, s, sd, sdd)
        flat = wrench.reference == "local"
        push = (value[:, 0] + 1j * value[:, 1]) * (here.axis if flat else 1.0)
        tilt = (value[:, 3] + 1j * value[:, 4]) * (here.axis if flat else 1.0)
        offset, height = complex(wrench.point[0], wrench.point[1]), float(wrench.point[2])
        resist(wrench.frame, offset, push, value[:, 5])
        if here.moves:
            ground += wrench_on_ground(here.point(offset)[0], height, push, value[:, 2], tilt, value[:, 5])

    for load in of_kind(robot.loads, Payload):
        (x, y, z), inertia = load.centre, load.inertia
        body = Body(load.frame, load.mass, complex(x, y), inertia[2, 2], z, complex(inertia[0, 2], inertia[1, 2]))
        here = now.frame(load.frame, s, sd, sdd)
        resist(load.frame, body.centre, *body.load(here, robot.gravity)[1:])
        if here.moves:
            ground += body.on_ground(here, robot.gravity)
            energy += body.energy(here, robot.gravity)

    for spring in of_kind(robot.loads, Spring):
        offsets = complex(spring.point_a[0], spring.point_a[1]), complex(spring.point_b[0], spring.point_b[1])
        here_a, here_b = (now.frame(frame, s, sd, sdd) for frame in (spring.frame_a, spring.frame_b))
        a, b = here_a.point(offsets[0]), here_b.point(offsets[1])
        line, rise = b[0] - a[0], float(spring.point_b[2] - spring.point_a[2])
        length = np.hypot(np.abs(line), rise)
        along: ComplexArray = np.divide(line, length, out=np.zeros_like(line), where=length > 0.0)
        rate = (np.conj(along) * (b[1] - a[1])).real
        pull = (spring.stiffness * (length - spring.length) + spring.damping * rate) * along
        resist(spring.frame_a, offsets[0], pull, 0.0)
        resist(spring.frame_b, offsets[1], -pull, 0.0)
        energy += 0.5 * spring.stiffness * (length - spring.length) ** 2

    for forces in of_kind(robot.loads, JointForces):
        joint = now.joint(forces.joint, s, sd, sdd)
        rotor, gear = forces.rotor_inertia, forces.gear
        revolute = joint.axis is None
        position = _counted(joint.position, _reference(robot, forces.joint)) if revolute else joint.position
        effort = forces.resistance(position, joint.rate) if resistance else np.zeros(samples)
        effort = effort + rotor * gear * (gear * joint.acceleration + (joint.link_spin_rate if revolute else 0.0))
        for row, unit in zip(f, units, strict=True):
            per_rate = unit.joint(forces.joint, *parked)
            row += effort * per_rate.rate
            if revolute:
                row += rotor * gear * joint.acceleration * per_rate.link_spin
        if joint.carrier is not None:
            force[joint.carrier] += effort
        energy += 0.5 * forces.stiffness * (position - forces.rest) ** 2 + 0.5 * rotor * gear**2 * joint.rate**2
        if joint.axis is None:
            energy += rotor * gear * joint.rate * joint.link_spin
            ground[:, 5] -= rotor * gear * joint.acceleration
        else:  # it spins about an axis in the plane, and the link turns it
            momentum = rotor * gear * (joint.acceleration + 1j * joint.link_spin * joint.rate) * joint.axis
            ground[:, 3] -= momentum.real
            ground[:, 4] -= momentum.imag
    return LoadEfforts(f, force, ground, energy)


def _reference(robot: Robot, joint: str) -> float:
    return float(robot.q_reference[list(robot.model.names)[1:].index(joint)])  # a coordinate a joint


def _counted(angle: Array, reference: float) -> Array:
    """Return angles with their full turns: those of one motion, the first nearest to the reference."""
    counted, known = np.array(angle), np.isfinite(angle)
    if known.any():
        whole = np.unwrap(angle[known])
        counted[known] = whole + 2.0 * np.pi * np.round((reference - whole[0]) / (2.0 * np.pi))
    return counted


def load_derivatives(
    robot: Robot,
    wrenches: Sequence[Array],
    now: PlanarDynamics,
    units: Sequence[PlanarDynamics],
    carriers: tuple[Array, Array, Array],
) -> list[tuple[Array, Array]]:
    """Return the derivatives of f (N, n, k) and of the carriers' forces (N, k, k) by s, by ṡ and by s̈.

    But for springs they are quadratic in the motion of the carriers: differences are exact. Those by s are of order
    eight, which reaches rounding for springs too. Arguments as of ``load_efforts``.
    """
    samples, result = carriers[0].shape[1], []
    length = robot.characteristic_length
    rates = [np.abs(part).max(axis=0, initial=0.0) for part in carriers[1:]]
    sizes = (
        0.02 * length * np.clip(_shortest(robot, now, carriers) / length, 1e-4, 1.0),
        *(np.where(rate > 0.0, rate, length) for rate in rates),
    )
    for order in range(3):
        by_f, by_force = np.zeros((samples, robot.n, robot.k)), np.zeros((samples, robot.k, robot.k))
        for i in range(robot.k):
            step = sizes[order]
            for distance, weight in _DIFFERENCES if order == 0 else ((1.0, 0.5), (-1.0, -0.5)):
                moved = [np.array(part) for part in carriers]
                moved[order][i] += distance * step
                there = load_efforts(robot, wrenches, now, units, (moved[0], moved[1], moved[2]), resistance=False)
                by_f[:, :, i] += weight * (there.f / step).T
                by_force[:, :, i] += weight * (there.force[: robot.k] / step).T
        for forces in of_kind(robot.loads, JointForces):
            joint = now.joint(forces.joint, *carriers)
            if joint.carrier is not None and order < 2:
                own = np.full(samples, forces.stiffness) if order == 0 else forces.resistance_rate(joint.rate)
                by_force[:, joint.carrier, joint.carrier] += own
        result.append((by_f, by_force))
    return result


_DIFFERENCES = tuple(
    (sign * steps, sign * weight)
    for steps, weight in ((1, 4.0 / 5.0), (2, -1.0 / 5.0), (3, 4.0 / 105.0), (4, -1.0 / 280.0))
    for sign in (1.0, -1.0)
)
"""Distances, in steps, and weights of central differences of order eight (Fornberg 1988)."""


def _shortest(robot: Robot, now: PlanarDynamics, carriers: tuple[Array, Array, Array]) -> Array:
    """Return (N,) the length of the shortest spring, m: how fast forces bend with places."""
    lengths = np.full((1, carriers[0].shape[1]), np.inf)
    for spring in of_kind(robot.loads, Spring):
        a = now.frame(spring.frame_a, *carriers).point(complex(spring.point_a[0], spring.point_a[1]))[0]
        b = now.frame(spring.frame_b, *carriers).point(complex(spring.point_b[0], spring.point_b[1]))[0]
        lengths = np.append(lengths, np.abs(b - a)[None], axis=0)
    shortest: Array = lengths.min(axis=0)
    return shortest
