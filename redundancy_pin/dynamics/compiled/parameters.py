"""Numbers of a robot that generated code takes at run time, in one vector; what is compiled is the topology alone.

Compiled are the joints and their order, which frames closures join, what is actuated, and the structural zeros: numbers
that are zero, and entries of rotations and axes that are 1 or −1. All other numbers are parameters: placements, masses,
first moments, inertias, armatures, gravity, coupling polynomials, loads, signs of the working mode, and scales. Robots
that differ in them share one library. Of a platform with mass, and of a link with a payload, all inertial numbers are
parameters, also those that are zero.

Inertial numbers are the mass m, the first moment m c and the inertia about the joint's origin, in the axes of the
joint's frame: forces are linear in them, also at bodies without mass (Featherstone, "Rigid Body Dynamics Algorithms",
2008, section 2.13).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, BoolArray, Frozen, IntArray, read_only
from redundancy_pin.robot import JointForces, Payload, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_joint, find_link
from redundancy_pin.robot.scales import (
    column_scale,
    coordinate_unit,
    force_terms,
    position_unit,
    row_scale,
    turning_coordinates,
    turning_velocities,
    velocity_scale,
    velocity_unit,
)
from redundancy_pin.robot.types import slides
from redundancy_pin.robot.whole_turns import counted_turns

Key = tuple[Any, ...]
"""What a number belongs to: ("joint", 2, "origin"), ("link", "tool", "rotation"), ("coupling", 0), ..."""

_ROUNDING = 4.0 * float(np.finfo(float).eps)
"""Share of a size below which a number is zero, and distance at which an entry of a rotation is 1: rounding of a sum of
a few products."""

_SIZE, _ENTRY, _FREE = range(3)
"""Which values are compiled: zero; zero, 1 and −1; none."""

JOINT_NUMBERS = ("damping", "friction", "friction_speed", "stiffness", "rest", "rotor_inertia", "gear")
SPRING_NUMBERS = ("stiffness", "damping", "length")


@dataclass(frozen=True, eq=False)
class Numbers(Frozen):
    """All numbers of a robot's model, whether compiled or not, in an order that its topology determines.

    Attributes:
        places: by key, where its numbers are.
        values: (F,) the numbers, SI units.
        structural: (F,) whether a number is a structural zero, 1 or −1, which is compiled.

    Example:
        >>> numbers = numbers_of(robot)
        >>> numbers.values[numbers.places["joint", 1, "mass"]]  # kg, of the body that the first joint moves
    """

    places: Mapping[Key, slice]
    values: Array
    structural: BoolArray


@lru_cache(maxsize=64)
def numbers_of(robot: Robot) -> Numbers:
    """Return the numbers of a robot's model."""
    places: dict[Key, slice] = {}
    values: list[Array] = []
    kinds: list[IntArray] = []
    end = 0
    for key, part, what, size in _listed(robot):
        flat = np.array(part, dtype=np.float64).ravel()
        flat[np.abs(flat) <= _ROUNDING * size] = 0.0
        if what == _ENTRY:
            whole = np.round(flat)
            flat = np.where(np.abs(flat - whole) <= _ROUNDING, whole, flat)
        places[key] = slice(end, end + len(flat))
        end += len(flat)
        values.append(flat)
        kinds.append(np.full(len(flat), what))
    whole, kind = np.concatenate(values), np.concatenate(kinds)
    structural = (kind != _FREE) & ((whole == 0.0) | ((kind == _ENTRY) & (np.abs(whole) == 1.0)))
    return Numbers(MappingProxyType(places), read_only(whole), read_only(structural))


def _listed(robot: Robot) -> Iterator[tuple[Key, Any, int, float]]:
    """Return keys, numbers, kind, and the size beside which smaller ones are rounding."""
    model, length = robot.model, robot.characteristic_length
    yield ("gravity",), model.gravity.linear, _SIZE, 0.0
    yield ("armature",), model.armature, _SIZE, 0.0
    subspaces = motion_subspaces(robot)
    # payloads are put on the platform: their centres and inertias do not make another topology
    links = [robot.platform.frame] if robot.platform else []
    links += [load.frame for load in of_kind(robot.loads, Payload)]
    loaded = {int(find_link(model, name).parentJoint) for name in links}
    for index in range(1, model.njoints):
        placement, body = model.jointPlacements[index], model.inertias[index]
        yield ("joint", index, "rotation"), placement.rotation, _ENTRY, 1.0
        yield ("joint", index, "origin"), placement.translation, _SIZE, length
        yield ("joint", index, "subspace"), subspaces[index], _ENTRY, 1.0
        mass, first, inertia = moments(body)
        yield ("joint", index, "mass"), mass, _SIZE, 0.0
        kind = _FREE if mass and index in loaded else _SIZE
        yield ("joint", index, "moment"), first, kind, mass * length
        yield ("joint", index, "inertia"), inertia, kind, float(np.abs(inertia).max())
    for name in links_of(robot):
        placement = find_link(model, name).placement
        yield ("link", name, "rotation"), placement.rotation, _ENTRY, 1.0
        yield ("link", name, "origin"), placement.translation, _SIZE, length
    for i, coupling in enumerate(robot.couplings):
        yield ("coupling", i), coupling.polynomial, _SIZE, 0.0
    for i, load in enumerate(robot.loads):
        if isinstance(load, Wrench):
            yield ("load", i, "point"), load.point, _SIZE, 0.0
        elif isinstance(load, JointForces):
            for name in JOINT_NUMBERS:
                yield ("load", i, name), getattr(load, name), _SIZE, 0.0
        elif isinstance(load, Spring):
            for name in (*SPRING_NUMBERS, "point_a", "point_b"):
                yield ("load", i, name), getattr(load, name), _SIZE, 0.0
    modes = robot.working_modes
    signs = [sign * own for sign, own in zip(modes.signs, robot.working_mode, strict=True)] if modes else []
    yield ("mode",), signs, _FREE, 0.0


def links_of(robot: Robot) -> list[str]:
    """Return the links whose frames closures, the platform, wrenches and springs are made of."""
    links = [name for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
    links += [robot.platform.frame] if robot.platform else []
    links += [load.frame for load in of_kind(robot.loads, Wrench)]
    links += [name for load in of_kind(robot.loads, Spring) for name in (load.frame_a, load.frame_b)]
    return list(dict.fromkeys(links))


def motion_subspaces(robot: Robot) -> list[Array]:
    """Return by joint (6, nv of the joint) its motion subspace, in its own frame; of the base none."""
    model, data = robot.model, robot.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    subspaces = [np.zeros((6, 0))]
    for index in range(1, model.njoints):
        joint = model.joints[index]
        local = np.reshape(pin.getJointJacobian(model, data, index, pin.ReferenceFrame.LOCAL), (6, model.nv))
        subspaces.append(local[:, joint.idx_v : joint.idx_v + joint.nv].copy())
    return subspaces


def moments(body: pin.Inertia) -> tuple[float, Array, Array]:
    """Return mass, kg, first moment (3), kg m, and inertia about the origin (3, 3), kg m², of a body."""
    mass, centre = float(body.mass), np.array(body.lever) if body.mass else np.zeros(3)
    about = np.array(body.inertia) + mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))
    return mass, mass * centre, about


# --- what is compiled -------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Topology:
    """What generated code is compiled for; equal for robots that share a library.

    Attributes:
        text: all that is compiled, in words.
        robot: one of the robots. Its numbers are not compiled.
        free: (F,) which of its numbers are parameters.
    """

    text: str
    robot: Robot = field(compare=False, repr=False)
    free: BoolArray = field(compare=False, repr=False)

    def varying(self, also: BoolArray) -> Topology:
        """Return the topology with more parameters (F,): numbers that are structural zeros here, and may change."""
        free = self.free | also
        return replace(self, text=f"{self.text} {np.packbits(free).tobytes().hex()}", free=read_only(free))


@lru_cache(maxsize=64)
def topology_of(robot: Robot) -> Topology:
    """Return the topology of a robot."""
    model, numbers, turns = robot.model, numbers_of(robot), counted_turns(robot)
    joints = [
        (
            str(model.names[i]),
            str(joint.shortname()),
            int(model.parents[i]),
            joint.idx_q,
            joint.nq,
            joint.idx_v,
            joint.nv,
        )
        for i, joint in itertools.islice(enumerate(model.joints), 1, None)
    ]
    parts = [
        joints,
        [(name, int(find_link(model, name).parentJoint)) for name in links_of(robot)],
        [(closure.frame_a, closure.frame_b, closure.axes) for closure in robot.closures],
        [(coupling.joint, coupling.of, len(coupling.polynomial)) for coupling in robot.couplings],
        (robot.platform, robot.independent_joints, robot.actuated, robot.carriers),
        robot.working_modes.joints if robot.working_modes else (),
        [_kind_of(load) for load in robot.loads if not isinstance(load, Payload)],  # a payload is in the inertias
        (turns.coordinates.tolist(), turns.angles.tolist(), turns.kept.tolist()),
        np.packbits(numbers.structural).tobytes().hex(),
        numbers.values[numbers.structural].astype(int).tolist(),
    ]
    return Topology(repr(parts), robot, read_only(~numbers.structural))


def _kind_of(load: Any) -> tuple[str, ...]:
    if isinstance(load, Wrench):
        return "Wrench", load.frame, load.reference
    if isinstance(load, JointForces):
        return "JointForces", load.joint
    if isinstance(load, Spring):
        return "Spring", load.frame_a, load.frame_b
    return (type(load).__name__,)


# --- the vector that generated code takes -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Layout(Frozen):
    """Sections of the vector ``numbers`` of generated code, the same for all robots of a topology.

    Attributes:
        sizes: by name in C, how many numbers a section has. The last is MODEL.
    """

    sizes: Mapping[str, int]

    @cached_property
    def starts(self) -> Mapping[str, int]:
        """By name, where a section begins."""
        ends = itertools.accumulate(self.sizes.values(), initial=0)
        return MappingProxyType(dict(zip(self.sizes, ends, strict=False)))

    @cached_property
    def size(self) -> int:
        """The length of the vector."""
        return sum(self.sizes.values())

    @property
    def macros(self) -> list[str]:
        """The lines of C that name the sections of a vector called ``numbers``."""
        scalars = {name for name, size in self.sizes.items() if size == 1 and name in _SCALARS}
        return [
            f"#define {name} numbers[{start}]" if name in scalars else f"#define {name} (numbers + {start})"
            for name, start in self.starts.items()
        ]


_SCALARS = ("LENGTH", "MASS", "GRAVITY", "VISCOUS", "STATIC")
"""Sections of one number: the characteristic length, m, and ``robot.scales.ForceTerms``, SI."""


def _sections(robot: Robot) -> dict[str, Array]:
    """Return the sections of scales, by name in C."""
    terms = force_terms(robot)
    return {
        **{name: np.array([getattr(terms, name.lower())]) for name in _SCALARS},
        "STEP_UNIT": velocity_unit(robot)[pose_columns(robot)],
        "EQUATION_UNIT": np.concatenate([np.where(turning_rows(robot), 1.0, terms.length), coordinate_unit(robot)]),
        "POSITION_UNIT": position_unit(robot),
        "VELOCITY_SCALE": velocity_scale(robot),
        "ROW_SCALE": row_scale(robot),
        "COLUMN_SCALE": column_scale(robot),
        "CARRIER_UNIT": velocity_unit(robot)[robot.carrier_velocity],
    }


def layout_of(topology: Topology) -> Layout:
    """Return the layout of the vector for a topology."""
    sizes = {name: len(values) for name, values in _sections(topology.robot).items()}
    return Layout(MappingProxyType({**sizes, "MODEL": int(topology.free.sum())}))


def parameter_vector(robot: Robot, topology: Topology | None = None) -> Array:
    """Return the vector (P,) that generated code takes for a robot, its scales first, SI units.

    Args:
        robot: the robot.
        topology: its own, or one with more parameters.
    """
    free = (topology or topology_of(robot)).free
    return read_only(np.concatenate([*_sections(robot).values(), numbers_of(robot).values[free]]))


def pose_columns(robot: Robot) -> IntArray:
    """Return (p,) the velocity indices without the carriers'."""
    return np.setdiff1d(np.arange(robot.model.nv), robot.carrier_velocity)


def turning_rows(robot: Robot) -> list[bool]:
    """Return (r,) which closure rows are angles: those of rotation axes, and couplings of turning joints."""
    rows = [axis.startswith("r") for closure in robot.closures for axis in closure.axes]
    return rows + [not slides(find_joint(robot.model, coupling.joint)) for coupling in robot.couplings]


def turning_equations(robot: Robot) -> list[bool]:
    """Return (r + n,) which closure rows and independent coordinates are angles."""
    return turning_rows(robot) + turning_coordinates(robot)


def turning_steps(robot: Robot) -> list[bool]:
    """Return (p,) which velocities that move the pose are rotations."""
    turning: list[bool] = turning_velocities(robot)[pose_columns(robot)].tolist()
    return turning
