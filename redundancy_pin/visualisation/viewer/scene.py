"""A motion of a robot and its efforts turned into the frames of a moving picture, as arrays.

Frames, the arrows of the efforts, the colours of the margin; the solids come from ``mechanism``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray, IntArray, positive, read_only
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint_index
from redundancy_pin.robot.loop_joints import ends_of
from redundancy_pin.robot.types import slides
from redundancy_pin.visualisation.viewer.mechanism import along_z, joint_axis, place, rods_of, solids_of
from redundancy_pin.visualisation.viewer.solids import ROLE_NAMES, Role, Solid

Group = Literal["main", "carrier"]
"""Whose effort an arrow shows."""

# Colours of the arrows: the main actuators', the carriers'
EFFORT_COLORS: Mapping[Group, str] = {"main": "#E4007C", "carrier": "#00A3A3"}
# Where the classes of the margin part: below the first a pose is reported as near-singular
MARGIN_EDGES = (NEAR_SINGULAR_MARGIN, 0.1, 0.2, 0.4)
# Colour of each class of the margin, from singular to far
MARGIN_COLORS = ("#B2182B", "#EF6C00", "#F6B600", "#5BAA3A", "#2166AC")
UNKNOWN_COLOR = "#9E9E9E"  # where there is no margin

OBLIQUE = (0.8, -1.0, 0.6)  # from where machines that are not flat are seen

FRAME_RATE = 60.0  # frames a second of the motion's own time
MOST_FRAMES = 600  # longer motions get fewer frames a second; a viewer interpolates between them
MOST_POINTS = 1000  # of the drawn path, but for changes of its colour
# Length of the arrow of the largest force, radius of the arc of the largest torque, in sizes of the machine
LONGEST_FORCE, LONGEST_TORQUE = 0.4, 0.16
_BEYOND = 1.5  # efforts next to a singularity grow without bound; their arrows stop at this multiple of the longest
FLAT = 0.02  # extent along z, in sizes of the machine, below which it counts as flat


@dataclass(frozen=True, eq=False)
class Arrow:
    """The effort of one actuator over the frames: straight for a force, an arc for a torque."""

    name: str  # of the joint
    body: int  # index of the joint; the arrow starts at its origin and turns with it
    axis: Array  # (3,) unit axis of the joint in its own frame; positive efforts point along it
    turning: bool  # whether it is a torque
    group: Group
    per_unit: float  # m of its length for each N or N·m
    length: Array  # (F,) with its sign, m; the radius of an arc. Zero where no finite effort exists


@dataclass(frozen=True, eq=False)
class JointCourse:
    """What a joint of one freedom does over the frames."""

    name: str  # of the joint
    body: int  # its index
    kind: str  # as legends call it
    unit: str  # of its position: m or rad
    position: Array  # (F,)
    effort: Array | None  # (F,) of its actuator, N or N·m; NaN where there is none. None for passive joints


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot in motion. F frames, N points of the path, J joints of the tree with the base as number 0."""

    title: str
    names: tuple[str, ...]  # (J,) of the joints, the base first, and of rods that close loops
    t: Array  # (F,) time of each frame, s, from zero
    placement: Array  # (F, J, 4, 4) placement of each joint's frame in the world, m; of a rod its middle, z along it
    solids: tuple[Solid, ...]  # base and platform, links, joints, tracks, carriers
    arrows: tuple[Arrow, ...]  # efforts
    margin: Array  # (F,) distance to type II, scaled; NaN where unknown
    path: Array  # (N, 3) places of the traced point, world, m
    path_margin: Array  # (N,) margin along it
    size: float  # of the machine, m: parts that have no size of their own are drawn in proportion to it
    captions: tuple[str, ...]  # what the arrows' lengths stand for, a line each
    readings: tuple[JointCourse, ...] = ()  # of all joints of one freedom

    @property
    def duration(self) -> float:
        """Duration of the motion, s."""
        return float(self.t[-1])

    @property
    def is_flat(self) -> bool:
        """Whether everything stays in a plane z = const."""
        return bool(np.ptp(self.placement[:, 1:, 2, 3]) < FLAT * self.size)


def make_scene(
    robot: Robot,
    t: Array,
    q: Array,
    margin: Array,
    tau: Array | None = None,
    carrier_force: Array | None = None,
    *,
    title: str = "",
    force_scale: float = 1.0,
) -> Scene:
    """Return the moving picture of (N, nq) configurations at (N,) times, s, with their margin (N,) to type II, scaled.

    Efforts ``tau`` (N, m), NaN where there are none, and ``carrier_force`` (N, k), N or N·m, become arrows;
    ``force_scale`` is how much longer than usual: usually the largest force met away from singularities has an arrow of
    0.4 sizes of the machine, the largest torque an arc of radius 0.16.

    Raises:
        InputError: a scale that is not a positive number.
    """
    positive(force_scale, "force_scale", "")
    frames, points = frame_samples(t), path_samples(margin)
    efforts: list[tuple[str, Group, Array]] = []
    if tau is not None:
        efforts += [(name, "main", tau[:, i]) for i, name in enumerate(robot.actuated)]
    if carrier_force is not None:
        efforts += [(name, "carrier", carrier_force[:, i]) for i, name in enumerate(robot.carriers)]
    arrows, captions = _arrows(robot, efforts, np.abs(margin) < NEAR_SINGULAR_MARGIN, frames, force_scale)
    moving = (*list(robot.model.names)[1:], *(f"rod {rod.name}" for rod in rods_of(robot)))
    return Scene(
        title=title,
        names=("base", *(str(name) for name in moving)),
        t=t[frames] - t[0],
        placement=placements(robot, q[frames]),
        solids=solids_of(robot),
        arrows=arrows,
        margin=np.abs(margin[frames]),
        path=traced(robot, q[points]),
        path_margin=np.abs(margin[points]),
        size=robot.characteristic_length,
        captions=captions,
        readings=_readings(robot, q[frames], {name: effort[frames] for name, _, effort in efforts}),
    )


def _readings(robot: Robot, q: Array, efforts: Mapping[str, Array]) -> tuple[JointCourse, ...]:
    readings = []
    for body in range(1, robot.model.njoints):
        name = str(robot.model.names[body])
        if robot.model.joints[body].nv != 1:
            continue
        role: Role = "carrier" if name in robot.carriers else "actuated" if name in robot.actuated else "passive"
        position = robot.joint_positions(q, [name])[:, 0]
        turning = not slides(robot.model.joints[body])
        if turning:
            position = np.unwrap(position)
        unit = "rad" if turning else "m"
        readings.append(JointCourse(name, body, ROLE_NAMES[role], unit, read_only(position), efforts.get(name)))
    return tuple(readings)


def frame_samples(t: Array) -> IntArray:
    """Return which samples become frames: (F,) indices, increasing in time, the first and the last among them.

    Every frame is a sample, shown at the time it has, so that the picture runs at true speed whatever the sampling.
    """
    first_of_instant = np.concatenate([[0], np.flatnonzero(np.diff(t) > 0.0) + 1])
    times = t[first_of_instant]
    count = min(MOST_FRAMES, max(2, int(np.ceil((t[-1] - t[0]) * FRAME_RATE)) + 1))
    if len(times) <= count:
        return first_of_instant
    wanted = np.linspace(t[0], t[-1], count)
    after = np.clip(np.searchsorted(times, wanted), 1, len(times) - 1)
    nearest = after - (wanted - times[after - 1] < times[after] - wanted)
    result: IntArray = first_of_instant[np.unique(nearest)]
    return result


def path_samples(margin: Array) -> IntArray:
    """Return which samples the drawn path goes through: enough to be smooth, and all where its colour changes."""
    even = np.linspace(0, len(margin) - 1, min(len(margin), MOST_POINTS)).round().astype(np.intp)
    changes = np.flatnonzero(np.diff(margin_classes(margin)))
    return np.unique(np.concatenate([even, changes, changes + 1])).astype(np.intp)


def placements(robot: Robot, q: Array) -> Array:
    """Return (F, J, 4, 4) the frames of joints and rods at configurations (F, nq), as ``Scene.placement``, m."""
    model, rods = robot.model, rods_of(robot)
    data = model.createData()
    placement = np.empty((len(q), model.njoints + len(rods), 4, 4))
    for i, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        for j in range(model.njoints):
            placement[i, j] = data.oMi[j].homogeneous
        for j, rod in enumerate(rods, start=model.njoints):
            start, end = ends_of(rod, model, data)
            placement[i, j] = place(along_z((end - start) / rod.length), 0.5 * (start + end))
    return placement


def traced(robot: Robot, q: Array) -> Array:
    """Return (N, 3) where the platform's origin or, without a platform, the first closure goes."""
    if robot.platform is None and not robot.closures:
        return np.zeros((0, 3))
    name = robot.platform.frame if robot.platform is not None else robot.closures[0].frame_a
    return constraint_system(robot).evaluate(q).placement(name)[1].T


def _arrows(
    robot: Robot, efforts: list[tuple[str, Group, Array]], singular: BoolArray, frames: IntArray, scale: float
) -> tuple[tuple[Arrow, ...], tuple[str, ...]]:
    """Return the arrows of efforts (N,), forces and torques each on a scale of their own, and what the longest mean."""
    arrows, captions = [], []
    bodies = {name: find_joint_index(robot.model, name) for name, _, _ in efforts}
    for turns, longest, unit, what in ((False, LONGEST_FORCE, "N", "force"), (True, LONGEST_TORQUE, "N·m", "torque")):
        alike = [entry for entry in efforts if slides(robot.model.joints[bodies[entry[0]]]) is not turns]
        values = np.abs(np.array([effort for _, _, effort in alike]).reshape(len(alike), len(singular)))
        values[~np.isfinite(values)] = 0.0
        largest = float(values[:, slice(None) if singular.all() else ~singular].max(initial=0.0))
        if largest == 0.0:
            continue
        per_unit = longest * robot.characteristic_length * scale / largest
        captions.append(f"largest {what} away from singularities: {largest:.3g} {unit}")
        for name, group, effort in alike:
            lengths = per_unit * np.where(np.isfinite(effort[frames]), effort[frames], 0.0)
            bounded = np.clip(lengths, -_BEYOND * largest * per_unit, _BEYOND * largest * per_unit)
            axis = joint_axis(robot.model, bodies[name])
            arrows.append(Arrow(name, bodies[name], axis, turns, group, per_unit, bounded))
    return tuple(arrows), tuple(captions)


def margin_classes(margin: Array) -> IntArray:
    """Return (N,) the class of each margin: an index into ``MARGIN_COLORS``, −1 for NaN."""
    classes: IntArray = np.searchsorted(MARGIN_EDGES, np.abs(margin), side="right").astype(np.intp)
    return np.where(np.isnan(margin), -1, classes)


def margin_color(margin: float) -> str:
    """Return the colour of the class of a margin."""
    return (*MARGIN_COLORS, UNKNOWN_COLOR)[margin_classes(np.array([margin]))[0]]  # class −1 is the last


def margin_labels() -> tuple[str, ...]:
    """Return the label of each class in the legend."""
    edges = [f"{edge:g}" for edge in MARGIN_EDGES]
    inner = [f"{low} to {high}" for low, high in pairwise(edges)]
    return (f"below {edges[0]}: near-singular", *inner, f"above {edges[-1]}")
