"""A motion of a robot and its efforts turned into the frames of a moving picture, as arrays.

Frames, the arrows of the efforts, the colours of the margin; the solids come from ``mechanism``.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray, IntArray, positive, read_only
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.robot import Robot
from redundancy_pin.robot.loop_joints import ends_of
from redundancy_pin.robot.types import slides
from redundancy_pin.visualisation.viewer.mechanism import along_z, joint_axis, place, rods_of, solids_of
from redundancy_pin.visualisation.viewer.solids import Role, Solid

Group = Literal["main", "carrier"]
"""Whose effort an arrow shows."""

# Colours of the arrows: the main actuators', the carriers'
EFFORT_COLORS: Mapping[Group, str] = {"main": "#E4007C", "carrier": "#00A3A3"}
# Bounds between the classes of the margin; below the first a pose is near-singular
MARGIN_EDGES = (NEAR_SINGULAR_MARGIN, 0.1, 0.2, 0.4)
# Colour of each class of the margin, from singular to far
MARGIN_COLORS = ("#B2182B", "#EF6C00", "#F6B600", "#5BAA3A", "#2166AC")
UNKNOWN_COLOR = "#9E9E9E"  # where there is no margin

OBLIQUE = (0.8, -1.0, 0.6)  # view direction of machines that are not flat

FRAME_RATE = 60.0  # frames a second of the motion's own time
MOST_FRAMES = 600  # longer motions get fewer frames a second; a viewer interpolates between them
MOST_POINTS = 1000  # of the drawn path, plus those where its colour changes
# Length of the arrow of the largest force, radius of the arc of the largest torque, in sizes of the machine
LONGEST_FORCE, LONGEST_TORQUE = 0.4, 0.16
_BEYOND = 1.5  # near a singularity efforts are unbounded; their arrows end at this multiple of the longest
FLAT = 0.02  # extent along z, in sizes of the machine, below which it counts as flat


@dataclass(frozen=True, eq=False)
class JointCourse:
    """A joint of one degree of freedom over the frames, and the arrow of its effort: an arc for a torque."""

    name: str  # of the joint
    body: int  # its index; the arrow starts at its origin and turns with it
    role: Role  # actuated, passive or carrier
    axis: Array  # (3,) unit axis in its own frame; positive efforts point along it
    turning: bool
    position: Array  # (F,) m or rad
    effort: Array | None  # (F,) of its actuator, N or N·m; NaN where there is none. None for passive joints
    per_unit: float = 0.0  # m of arrow for each N or N·m; zero for no arrow
    longest: float = np.inf  # m; longer arrows end there

    @property
    def length(self) -> Array:
        """(F,) length of the arrow with its sign, or radius of the arc, m; zero where no finite effort exists."""
        effort = np.zeros(len(self.position)) if self.effort is None else self.effort
        lengths = self.per_unit * np.where(np.isfinite(effort), effort, 0.0)
        return np.clip(lengths, -self.longest, self.longest)

    @property
    def group(self) -> Group:
        """Whose effort the arrow shows."""
        return "carrier" if self.role == "carrier" else "main"


@dataclass(frozen=True, eq=False)
class Scene:
    """A robot in motion. F frames, N points of the path, J joints of the tree with the base as number 0."""

    title: str
    names: tuple[str, ...]  # (J,) of the joints, the base first, and of rods that close loops
    t: Array  # (F,) time of each frame, s, from zero
    placement: Array  # (F, J, 4, 4) placement of each joint's frame in the world, m; of a rod its middle, z along it
    solids: tuple[Solid, ...]  # base and platform, links, joints, tracks, carriers
    joints: tuple[JointCourse, ...]  # all joints of one degree of freedom, with their efforts
    margin: Array  # (F,) distance to type II, scaled; NaN where unknown
    path: Array  # (N, 3) places of the traced point, world, m
    path_margin: Array  # (N,) margin along it
    size: float  # of the machine, m: parts that have no size of their own are drawn in proportion to it
    captions: tuple[str, ...]  # what the arrows' lengths stand for, a line each

    @property
    def duration(self) -> float:
        """Duration of the motion, s."""
        return float(self.t[-1])

    @property
    def arrows(self) -> tuple[JointCourse, ...]:
        """The joints whose efforts have arrows."""
        return tuple(joint for joint in self.joints if joint.per_unit)

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
    efforts: dict[str, Array] = {}
    if tau is not None:
        efforts |= dict(zip(robot.actuated, tau.T, strict=True))
    if carrier_force is not None:
        efforts |= dict(zip(robot.carriers, carrier_force.T, strict=True))
    joints = joints_over(robot, q[frames], {name: effort[frames] for name, effort in efforts.items()})
    joints, captions = _scaled(robot, joints, efforts, np.abs(margin) < NEAR_SINGULAR_MARGIN, force_scale)
    moving = (*list(robot.model.names)[1:], *(f"rod {rod.name}" for rod in rods_of(robot)))
    return Scene(
        title=title,
        names=("base", *(str(name) for name in moving)),
        t=t[frames] - t[0],
        placement=placements(robot, q[frames]),
        solids=solids_of(robot),
        joints=joints,
        margin=np.abs(margin[frames]),
        path=traced(robot, q[points]),
        path_margin=np.abs(margin[points]),
        size=robot.characteristic_length,
        captions=captions,
    )


def joints_over(robot: Robot, q: Array, efforts: Mapping[str, Array]) -> tuple[JointCourse, ...]:
    """Return the joints of one degree of freedom over (F, nq), with efforts (F,) by name, N or N·m; without arrows."""
    joints, model = [], robot.model
    for body in range(1, model.njoints):
        name = str(model.names[body])
        if model.joints[body].nv != 1:
            continue
        role: Role = "carrier" if name in robot.carriers else "actuated" if name in robot.actuated else "passive"
        position, turning = robot.joint_positions(q, [name])[:, 0], not slides(model.joints[body])
        position = read_only(np.unwrap(position) if turning else position)
        joints.append(JointCourse(name, body, role, joint_axis(model, body), turning, position, efforts.get(name)))
    return tuple(joints)


def _scaled(
    robot: Robot, joints: tuple[JointCourse, ...], efforts: Mapping[str, Array], singular: BoolArray, scale: float
) -> tuple[tuple[JointCourse, ...], tuple[str, ...]]:
    """Return joints with arrows for efforts (N,), and captions of the longest; forces and torques are scaled apart."""
    captions, counted = [], slice(None) if singular.all() else ~singular
    for turning, longest, unit, what in ((False, LONGEST_FORCE, "N", "force"), (True, LONGEST_TORQUE, "N·m", "torque")):
        alike = [joint.name for joint in joints if joint.turning is turning and joint.name in efforts]
        values = np.concatenate([np.zeros(1), *(np.abs(efforts[name][counted]) for name in alike)])
        largest = float(values[np.isfinite(values)].max())
        if largest == 0.0:
            continue
        length = longest * robot.characteristic_length * scale
        captions.append(f"largest {what} away from singularities: {largest:.3g} {unit}")
        joints = tuple(
            replace(joint, per_unit=length / largest, longest=_BEYOND * length) if joint.name in alike else joint
            for joint in joints
        )
    return joints, tuple(captions)


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
