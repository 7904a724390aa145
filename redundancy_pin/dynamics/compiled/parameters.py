"""Numbers of a robot that generated code takes at run time, in one vector; only the topology is compiled.

Compiled are the joints and their order, the frames of closures, the actuated joints, and the structural zeros: numbers
that are zero, and entries of rotations and axes that are 1 or −1. All other numbers are parameters: placements, masses,
first moments, inertias, armatures, gravity, lengths of rods, couplings, loads, signs of the working mode, and scales.
Robots that differ in them share one library. Of a platform with mass, and of a link with a payload, all inertial
numbers are parameters, also those that are zero.

Inertial numbers are Pinocchio's dynamic parameters: the mass m, the first moment m c, and the inertia Ixx, Ixy, Iyy,
Ixz, Iyz, Izz about the joint's origin, in the axes of the joint's frame. Forces are linear in them, also at bodies
without mass (Featherstone, "Rigid Body Dynamics Algorithms", 2008, section 2.13).
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from types import MappingProxyType
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, Frozen, IntArray, read_only
from redundancy_pin.robot import JointForces, Payload, Robot, Spring, Wrench
from redundancy_pin.robot.loads import of_kind
from redundancy_pin.robot.lookup import find_joint, find_link, find_link_index
from redundancy_pin.robot.scales import force_terms, turning_coordinates, turning_velocities
from redundancy_pin.robot.types import slides

Key = tuple[Any, ...]
"""What a number belongs to: ("joint", 2, "origin"), ("link", "tool", "rotation"), ("rod", 0), ..."""

_ROUNDING = 4.0 * float(np.finfo(float).eps)
"""Share of a size below which a number is zero, and distance at which an entry of a rotation is 1: rounding of a sum of
a few products."""

JOINT_NUMBERS = ("damping", "friction", "friction_speed", "stiffness", "rest", "rotor_inertia", "gear")
SPRING_NUMBERS = ("stiffness", "damping", "length")


@dataclass(frozen=True, eq=False)
class Numbers(Frozen):
    """All numbers of a robot's model, whether compiled or not, in an order that its topology determines.

    Attributes:
        values: (F,) the numbers, SI units; ``places_of`` has the place of each one.
        structural: (F,) whether a number is a structural zero, 1 or −1, which is compiled.

    Example:
        >>> numbers = numbers_of(robot)
        >>> numbers.values[places_of(robot)["joint", 1, "body"]][0]  # kg, of the body that the first joint moves
    """

    values: Array
    structural: BoolArray


@lru_cache(maxsize=64)
def numbers_of(robot: Robot) -> Numbers:
    """Return the numbers of a robot's model."""
    model, length = robot.model, robot.characteristic_length
    links = [model.frames[index] for _, index, _ in links_of(robot)]
    placements = [*model.jointPlacements, *(link.placement for link in links)][1:]
    frames = np.array([placement.homogeneous for placement in placements])
    bodies = np.array([body.toDynamicParameters() for body in model.inertias])[1:]

    entries = np.concatenate([frames[:, :3, :3].ravel(), *(part.ravel() for part in motion_subspaces(robot))])
    rounded = np.round(entries)
    is_whole = np.abs(entries - rounded) <= _ROUNDING

    origins, size = frames[:, :3, 3], np.zeros(bodies.shape)
    size[:, 1:4] = bodies[:, :1] * length
    size[:, 4:] = np.abs(bodies[:, 4:]).max(axis=1, keepdims=True, initial=0.0)
    # payloads are put on the platform: their centres and inertias do not make another topology
    named = [robot.platform.frame] if robot.platform else []
    named += [load.frame for load in of_kind(robot.loads, Payload)]
    loaded = [int(find_link(model, name).parentJoint) - 1 for name in named]
    is_free = np.zeros(bodies.shape, dtype=bool)
    is_free[[index for index in loaded if index >= 0 and bodies[index, 0]], 1:] = True
    origins = np.where(np.abs(origins) <= _ROUNDING * length, 0.0, origins)
    bodies = np.where((np.abs(bodies) <= _ROUNDING * size) & ~is_free, 0.0, bodies)

    others = np.concatenate([model.gravity.linear, model.armature, *_of_constraints_and_loads(robot).values()])
    signs = _mode_signs(robot)
    values = [np.where(is_whole, rounded, entries), origins.ravel(), bodies.ravel(), others, signs]
    structural = [is_whole, *((part == 0.0).ravel() for part in (origins, bodies, others, signs))]
    structural[2] &= ~is_free.ravel()
    return Numbers(read_only(np.concatenate(values)), read_only(np.concatenate(structural)))


def _mode_signs(robot: Robot) -> Array:
    """Return (legs,) the signs of the indicators of the working mode, times the robot's own mode."""
    modes = robot.working_modes
    signs = [sign * own for sign, own in zip(modes.signs, robot.working_mode, strict=True)] if modes else []
    return np.array(signs, dtype=np.float64)


def _of_constraints_and_loads(robot: Robot) -> dict[Key, Array]:
    """Return by key the lengths of rods, the coefficients of couplings, and the numbers of loads."""
    numbers: dict[Key, Any] = {("rod", i): each.length for i, each in enumerate(robot.closures) if each.is_rod}
    for i, coupling in enumerate(robot.couplings):
        numbers["coupling", i, "polynomial"] = coupling.polynomial
        numbers["coupling", i, "also"] = [factor for _, factor in coupling.also]
    names = {Wrench: ("point",), JointForces: JOINT_NUMBERS, Spring: (*SPRING_NUMBERS, "point_a", "point_b")}
    for i, load in enumerate(robot.loads):
        for name in names.get(type(load), ()):
            numbers["load", i, name] = getattr(load, name)
    return {key: np.array(value, dtype=np.float64).ravel() for key, value in numbers.items()}


def places_of(robot: Robot) -> Mapping[Key, slice]:
    """Return by key where its numbers are in ``numbers_of``: matrices row by row, a body's ten numbers as above."""
    model = robot.model
    joints = [("joint", index) for index in range(1, model.njoints)]
    frames: list[Key] = [*joints, *(("link", name) for name, *_ in links_of(robot))]
    sizes: dict[Key, int] = {(*frame, "rotation"): 9 for frame in frames}
    sizes |= {(*joint, "subspace"): 6 * model.joints[joint[1]].nv for joint in joints}
    sizes |= {(*frame, "origin"): 3 for frame in frames}
    sizes |= {(*joint, "body"): 10 for joint in joints}
    sizes |= {("gravity",): 3, ("armature",): model.nv}
    sizes |= {key: len(numbers) for key, numbers in _of_constraints_and_loads(robot).items()}
    sizes["mode",] = len(_mode_signs(robot))
    ends = list(itertools.accumulate(sizes.values(), initial=0))
    return MappingProxyType({key: slice(*end) for key, end in zip(sizes, itertools.pairwise(ends), strict=True)})


@lru_cache(maxsize=64)
def links_of(robot: Robot) -> tuple[tuple[str, int, int], ...]:
    """Return the links that closures, the platform, wrenches and springs name: name, index, and joint that moves it."""
    names = [name for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
    names += [robot.platform.frame] if robot.platform else []
    names += [load.frame for load in of_kind(robot.loads, Wrench)]
    names += [name for load in of_kind(robot.loads, Spring) for name in (load.frame_a, load.frame_b)]
    model = robot.model
    found = [(name, find_link_index(model, name)) for name in dict.fromkeys(names)]
    return tuple((name, index, int(model.frames[index].parentJoint)) for name, index in found)


def motion_subspaces(robot: Robot) -> list[Array]:
    """Return by joint (6, nv of the joint) its motion subspace, in its own frame, without the base."""
    joints = itertools.islice(robot.model.joints, 1, None)
    return [np.reshape(joint.createData().S, (6, joint.nv)) for joint in joints]


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
    numbers = numbers_of(robot)
    parts = [
        *_connections(robot),
        np.packbits(numbers.structural).tobytes().hex(),
        numbers.values[numbers.structural].astype(np.int8).tobytes().hex(),
    ]
    return Topology(repr(parts), robot, read_only(~numbers.structural))


def common_topology(robots: Sequence[Robot]) -> Topology | None:
    """Return a topology for several robots; structural zeros of only some of them become parameters.

    None if they differ in more than numbers.
    """
    first, *others = robots
    connections, numbers = repr(_connections(first)), numbers_of(first)
    also = np.zeros(len(numbers.values), dtype=bool)
    for other in others:
        if repr(_connections(other)) != connections or len(numbers_of(other).values) != len(also):
            return None
        also |= ~numbers_of(other).structural | (numbers_of(other).values != numbers.values)
    topology = topology_of(first)
    return topology.varying(read_only(also)) if (also & ~topology.free).any() else topology


def _connections(robot: Robot) -> list[object]:
    """Return the connections of a robot in a form that is equal for equal connections."""
    model = robot.model
    return [
        (list(model.names), [joint.shortname() for joint in model.joints], list(model.parents)),
        [(name, joint) for name, _, joint in links_of(robot)],
        [(closure.frame_a, closure.frame_b, closure.axes) for closure in robot.closures],
        [(each.joint, each.of, len(each.polynomial), [name for name, _ in each.also]) for each in robot.couplings],
        (robot.platform, robot.independent_joints, robot.actuated, robot.carriers),
        robot.working_modes.joints if robot.working_modes else (),
        [_kind_of(load) for load in robot.loads if not isinstance(load, Payload)],  # a payload is in the inertias
    ]


def _kind_of(load: Any) -> tuple[str, ...]:
    names = {Wrench: ("frame", "reference"), JointForces: ("joint",), Spring: ("frame_a", "frame_b")}[type(load)]
    return (type(load).__name__, *(getattr(load, name) for name in names))


# --- the vector that generated code takes -----------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class Layout(Frozen):
    """Sections of the vector ``numbers`` of generated code, the same for all robots of a topology.

    Attributes:
        sizes: length of each section, by name in C: first the sections of ``robot.scales.ForceTerms``, SI units, last
            MODEL, the numbers of the model that are parameters, and between them scales that are a length or 1.
        is_length: (S,) which of the latter are the characteristic length, m; the others are 1.
    """

    sizes: Mapping[str, int]
    is_length: BoolArray

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
        return [
            f"#define {name} numbers[{start}]" if name in _SCALARS else f"#define {name} (numbers + {start})"
            for name, start in self.starts.items()
        ]


_SCALARS = ("LENGTH", "MASS", "GRAVITY", "VISCOUS", "STATIC")
"""Sections of one number."""


@lru_cache(maxsize=64)
def layout_of(topology: Topology) -> Layout:
    """Return the layout of the vector for a topology."""
    robot = topology.robot
    slide = ~turning_velocities(robot)
    slide_rows, slide_coordinates = ~turning_rows(robot), ~np.array(turning_coordinates(robot), dtype=bool)
    actuated = [slides(find_joint(robot.model, name)) for name in robot.actuated]
    position = np.zeros(robot.model.nq, dtype=bool)
    for joint in itertools.islice(robot.model.joints, 1, None):  # translations come first, in q as in v
        position[joint.idx_q : joint.idx_q + int(slide[joint.idx_v : joint.idx_v + joint.nv].sum())] = True
    is_length = {
        "VELOCITY_UNIT": slide,
        "EQUATION_UNIT": np.concatenate([slide_rows, slide_coordinates]),
        "POSITION_UNIT": position,
        "ROW_SCALE": ~slide_coordinates,
        "COLUMN_SCALE": ~np.array(actuated, dtype=bool),
    }
    sizes = {name: len(which) for name, which in is_length.items()}
    whole = {**dict.fromkeys(_SCALARS, 1), **sizes, "MODEL": int(topology.free.sum())}
    return Layout(MappingProxyType(whole), read_only(np.concatenate(list(is_length.values()))))


def parameter_vector(robot: Robot, topology: Topology | None = None) -> Array:
    """Return the vector (P,) that generated code takes for a robot, its scales first, SI units.

    Args:
        robot: the robot.
        topology: its own, or one with more parameters.
    """
    topology = topology or topology_of(robot)
    terms, is_length = force_terms(robot), layout_of(topology).is_length
    scalars = [getattr(terms, name.lower()) for name in _SCALARS]
    scales = np.where(is_length, terms.length, 1.0)
    return read_only(np.concatenate([scalars, scales, numbers_of(robot).values[topology.free]]))


def pose_columns(robot: Robot) -> IntArray:
    """Return (p,) the velocity indices without the carriers'."""
    return np.setdiff1d(np.arange(robot.model.nv), robot.carrier_velocity)


def turning_joints(robot: Robot) -> list[int]:
    """Return the entries of q that are angles of joints that turn: cosines and sines of them are computed once.

    Carriers, whose positions are arguments, and joints that turn without end, whose entries are cosine and sine, have
    none.
    """
    carried = set(robot.carrier_position.tolist())
    joints = itertools.islice(robot.model.joints, 1, None)
    bounded = [joint.idx_q for joint in joints if joint.nq == 1 and joint.shortname().startswith("JointModelR")]
    return [index for index in bounded if index not in carried]


def trig_at(robot: Robot, q: Array) -> Array:
    """Return (N, 2 · turning joints) the cosines and sines at configurations (N, nq) that generated functions take."""
    angles = q[:, turning_joints(robot)]
    return np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(q), -1)


def turning_rows(robot: Robot) -> BoolArray:
    """Return (r,) which closure rows are angles: rows of rotation axes, and couplings of turning joints."""
    rows = [axis.startswith("r") for closure in robot.closures for axis in closure.axes]
    rows += [not slides(find_joint(robot.model, coupling.joint)) for coupling in robot.couplings]
    return np.array(rows, dtype=bool)
