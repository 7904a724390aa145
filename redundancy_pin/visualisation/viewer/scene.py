"""A motion of a robot and its efforts turned into the frames of a moving picture, as arrays.

First the frames, the arrows of the efforts and the colours of the margin; then the solids of the mechanism. Bars stand
in for links without a shape of their URDF; joints, closures, tracks, carriers, base and platform are added. Their sizes
are fractions of the size of the machine, its characteristic length.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from math import pi
from typing import Literal

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray, IntArray, read_only
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.coordinates import joint_position
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.kinematics.tree import TreeKinematics, motion_subspace
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.visualisation.viewer.solids import ROLE_COLORS, ROLE_NAMES, Mesh, Role, Shape, Solid, shapes_of_urdf

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

# Cross-section of a straight track: narrow and high, so that it stands out of the link it lies on
RAIL_WIDTH, RAIL_HEIGHT = 0.012, 0.06
CARRIER_SIDE = 0.06  # of a carrier without a shape of its own
BALANCED_RADIUS = 0.1  # of the arc about a carrier whose centre of mass is on its axis
JOINT_RADIUS, JOINT_LENGTH = 0.03, 0.06  # of a joint; thicker than the links of the shipped robots
BAR_RADIUS = 0.012  # of a link that has no shape of its own
PLATE_THICKNESS = 0.02  # of the platform; the base is half as thick
_POINT_RADIUS = 0.09  # of a platform that is a point
_ARM_RADIUS = 0.01  # of the arm that holds a turning carrier, and of the arc it runs along
_LONGEST_RAIL = 1.2  # half length at which the drawing of an unbounded track ends
_BALANCED = 1e-3  # distance of the centre of mass from the axis below which it counts as on it
_CLEAR = 0.35  # opacity of what other things must be seen through
FLAT = 0.02  # extent along z, in sizes of the machine, below which it counts as flat
_NO_LENGTH = 1e-9  # m; points that are nearer are one


@dataclass(frozen=True, eq=False)
class Arrow:
    """The effort of one actuator over the frames: straight for a force, an arc for a torque."""

    name: str  # of the joint
    body: int  # index of the joint; the arrow starts at its origin and turns with it
    axis: Array  # (3,) unit axis of the joint in its own frame; positive efforts point along it
    turning: bool  # whether it is a torque
    group: Group
    length: Array  # (F,) with its sign, m; the radius of an arc. Zero where no finite effort exists


@dataclass(frozen=True, eq=False)
class Reading:
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
    names: tuple[str, ...]  # (J,) of the joints, the base first
    t: Array  # (F,) time of each frame, s, from zero
    placement: Array  # (F, J, 4, 4) placement of each joint's frame in the world, m
    solids: tuple[Solid, ...]  # base and platform, links, joints, tracks, carriers
    arrows: tuple[Arrow, ...]  # efforts
    margin: Array  # (F,) distance to type II, scaled; NaN where unknown
    path: Array  # (N, 3) places of the traced point, world, m
    path_margin: Array  # (N,) margin along it
    size: float  # of the machine, m: parts that have no size of their own are drawn in proportion to it
    captions: tuple[str, ...]  # what the arrows' lengths stand for, a line each
    readings: tuple[Reading, ...] = ()  # of all joints of one freedom

    @property
    def duration(self) -> float:
        """Duration of the motion, s."""
        return float(self.t[-1])

    @property
    def is_flat(self) -> bool:
        """Whether everything stays in a plane z = const."""
        return bool(np.ptp(self.placement[:, 1:, 2, 3]) < FLAT * self.size)


def configurations(robot: Robot, motion: PlatformMotion, carriers: CarrierMotion) -> Array:
    """Return the (N, nq) configurations of a robot along a motion of N samples.

    Raises:
        InputError: samples that do not fit.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as ``lift``.
    """
    if len(carriers) != len(motion) or carriers.s.shape[1] != robot.k:
        raise InputError(
            f"The carrier motion has shape {carriers.s.shape}, expected ({len(motion)}, {robot.k}).",
            remedy="Sample it at the times of the platform motion.",
        )
    q = lift(robot, motion).q.copy()
    q[:, robot.carrier_position] = carriers.s  # the lift does not move them: no closure contains a carrier
    return q


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
    require_scale(force_scale)
    frames, points = frame_samples(t), path_samples(margin)
    efforts: list[tuple[str, Group, Array]] = []
    if tau is not None:
        efforts += [(name, "main", tau[:, i]) for i, name in enumerate(robot.actuated)]
    if carrier_force is not None:
        efforts += [(name, "carrier", carrier_force[:, i]) for i, name in enumerate(robot.carriers)]
    arrows, captions = _arrows(robot, efforts, np.abs(margin) < NEAR_SINGULAR_MARGIN, frames, force_scale)
    return Scene(
        title=title,
        names=("base", *(str(name) for name in list(robot.model.names)[1:])),
        t=t[frames] - t[0],
        placement=_placements(robot.model, q[frames]),
        solids=solids_of(robot),
        arrows=arrows,
        margin=np.abs(margin[frames]),
        path=traced(robot, q[points]),
        path_margin=np.abs(margin[points]),
        size=robot.characteristic_length,
        captions=captions,
        readings=_readings(robot, q[frames], {name: effort[frames] for name, _, effort in efforts}),
    )


def _readings(robot: Robot, q: Array, efforts: Mapping[str, Array]) -> tuple[Reading, ...]:
    found = []
    for body in range(1, robot.model.njoints):
        name = str(robot.model.names[body])
        if robot.model.joints[body].nv != 1:
            continue
        role: Role = "carrier" if name in robot.carriers else "actuated" if name in robot.actuated else "passive"
        position = joint_position(robot, name, q)
        turning = not slides(robot.model, body)
        if turning:
            position = np.unwrap(position)
        unit = "rad" if turning else "m"
        found.append(Reading(name, body, ROLE_NAMES[role], unit, read_only(position), efforts.get(name)))
    return tuple(found)


def require_scale(force_scale: float) -> None:
    """Check the factor on the length of arrows."""
    if not (np.isfinite(force_scale) and force_scale > 0.0):
        raise InputError(f"force_scale is {force_scale}.", remedy="Pass a positive number.")


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


def _placements(model: pin.Model, q: Array) -> Array:
    data = model.createData()
    placement = np.empty((len(q), model.njoints, 4, 4))
    for i, configuration in enumerate(q):
        pin.forwardKinematics(model, data, configuration)
        for j in range(model.njoints):
            placement[i, j] = data.oMi[j].homogeneous
    return placement


def traced(robot: Robot, q: Array) -> Array:
    """Return (N, 3) where the platform's origin or, without a platform, the first closure goes."""
    if robot.platform is None and not robot.closures:
        return np.zeros((0, 3))
    name = robot.platform.frame if robot.platform is not None else robot.closures[0].frame_a
    origin: Array = TreeKinematics(robot.model, [name]).pose(q).frame_origin[name].T
    return origin


def _arrows(
    robot: Robot, efforts: list[tuple[str, Group, Array]], singular: BoolArray, frames: IntArray, scale: float
) -> tuple[tuple[Arrow, ...], tuple[str, ...]]:
    """Return the arrows of efforts (N,), forces and torques each on a scale of their own, and what the longest mean."""
    arrows, captions = [], []
    bodies = {name: int(robot.model.getJointId(name)) for name, _, _ in efforts}
    for turns, longest, unit, what in ((False, LONGEST_FORCE, "N", "force"), (True, LONGEST_TORQUE, "N·m", "torque")):
        alike = [entry for entry in efforts if slides(robot.model, bodies[entry[0]]) is not turns]
        values = np.abs(np.array([effort for _, _, effort in alike]).reshape(len(alike), len(singular)))
        values[~np.isfinite(values)] = 0.0
        largest = float(values[:, slice(None) if singular.all() else ~singular].max(initial=0.0))
        if largest == 0.0:
            continue
        per_unit = longest * robot.characteristic_length * scale / largest
        captions.append(f"largest {what} away from singularities: {largest:.3g} {unit}")
        for name, group, effort in alike:
            bounded = np.clip(
                np.nan_to_num(effort[frames], posinf=0.0, neginf=0.0), -_BEYOND * largest, _BEYOND * largest
            )
            axis = joint_axis(robot.model, bodies[name])
            arrows.append(Arrow(name, bodies[name], axis, turns, group, per_unit * bounded))
    return tuple(arrows), tuple(captions)


def margin_classes(margin: Array) -> IntArray:
    """Return (N,) the class of each margin: an index into ``MARGIN_COLORS``, −1 where it is not known."""
    classes: IntArray = np.searchsorted(MARGIN_EDGES, np.abs(margin), side="right").astype(np.intp)
    return np.where(np.isnan(margin), -1, classes)


def margin_labels() -> tuple[str, ...]:
    """Return what the legend says of each class."""
    edges = [f"{edge:g}" for edge in MARGIN_EDGES]
    inner = [f"{low} to {high}" for low, high in pairwise(edges)]
    return (f"below {edges[0]}: near-singular", *inner, f"above {edges[-1]}")


# --- the solids of a mechanism --------------------------------------------------------------------------------------


def solids_of(robot: Robot) -> tuple[Solid, ...]:
    """Return base and platform, links, joints, tracks and carriers."""
    size = robot.characteristic_length
    plates = _plates(robot, size)
    # shapes of a platform stand back for the plate whose colour says something
    covered = {plate.body for plate in plates if plate.role == "platform" and plate.shape == "plate"}
    shapes = [
        replace(solid, opacity=_CLEAR) if solid.body in covered and solid.role == "link" else solid
        for solid in shapes_of_urdf(robot)
    ]
    clothed = {solid.body for solid in shapes}
    return (*plates, *shapes, *_bars(robot, size, clothed), *_joints(robot, size), *_carriers(robot, size, clothed))


# --- where bodies are jointed --------------------------------------------------------------------------------------


def body_points(robot: Robot, body: int) -> Array:
    """Return (c, 3) where a body is jointed to others, closures included, in the frame of its own joint, m."""
    data = _placed(robot, pin.neutral(robot.model))
    points: Array = (_hinges(robot, body, data) - data.oMi[body].translation) @ data.oMi[body].rotation
    return points


def base_hinges(robot: Robot) -> Array:
    """Return (B, 3) where the chains are fixed to the base, m, base frame."""
    return read_only(body_points(robot, 0))


def links(robot: Robot, q: Array) -> tuple[tuple[Array, Array], ...]:
    """Return the ends (3,), (3,) m of the lines that make up the mechanism at a configuration (nq,).

    A link is a line or, with three hinges or more, a polygon between its hinges (its own joint, the joints that follow,
    its closures). The origin of a platform that is a single line is its end.
    """
    model, data = robot.model, _placed(robot, q)
    pairs: list[tuple[Array, Array]] = []
    for body in range(1, model.njoints):
        points = _hinges(robot, body, data)
        if robot.platform is not None and len(points) < 3:
            frame = _frame(model, robot.platform.frame)
            if int(frame.parentJoint) == body:
                points = _distinct([*points, (data.oMi[body] * frame.placement).translation])
        pairs += _outline(_ordered(points))
    return tuple(pairs)


def _placed(robot: Robot, q: Array) -> pin.Data:
    data = robot.model.createData()
    pin.forwardKinematics(robot.model, data, np.array(q))
    return data


def _hinges(robot: Robot, body: int, data: pin.Data) -> Array:
    """Return (c, 3) where a body is jointed to others in a configuration, m, world.

    A joint that floats or moves in a plane joins nothing: its origin is no point that both bodies have.
    """
    model = robot.model
    points = [data.oMi[body].translation] if body and not _floats(model, body) else []
    children = [
        j
        for j in range(1, model.njoints)
        if model.parents[j] == body and model.names[j] not in robot.carriers and not _floats(model, j)
    ]
    points += [data.oMi[j].translation for j in children]
    frames = [_frame(model, name) for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
    points += [(data.oMi[body] * frame.placement).translation for frame in frames if int(frame.parentJoint) == body]
    return _distinct(points)


def _floats(model: pin.Model, index: int) -> bool:
    """Return whether a joint of several freedoms shifts its body."""
    if model.joints[index].nv < 2:
        return False
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    return bool(np.abs(motion_subspace(model, data, index)[:3]).max() > 0.0)


def _distinct(points: Sequence[Array]) -> Array:
    """Return (c, 3) points without those that are where an earlier one is."""
    distinct: list[Array] = []
    for point in points:
        if all(np.linalg.norm(point - other) > _NO_LENGTH for other in distinct):
            distinct.append(point)
    return np.array(distinct).reshape(-1, 3)


def _ordered(points: Array) -> Array:
    """Return points (c, 3) in order around their middle, in the plane that fits them best."""
    if len(points) < 3:
        return points
    centred = points - points.mean(axis=0)
    u, v = np.linalg.svd(centred).Vh[:2] @ centred.T
    result: Array = points[np.argsort(np.arctan2(v, u))]
    return result


def _outline(points: Array) -> list[tuple[Array, Array]]:
    """Return the sides between points in order, that from the last to the first too where there are three or more."""
    pairs = list(pairwise(points))
    return [*pairs, (points[-1], points[0])] if len(points) > 2 else pairs


# --- what is drawn there -------------------------------------------------------------------------------------------


def _plates(robot: Robot, size: float) -> list[Solid]:
    """Return the base, through the joints fixed to it, and the platform: a plate, a bar, or a ball at its origin."""
    thickness = PLATE_THICKNESS * size
    base = _ordered(body_points(robot, 0))
    plates = [_plate("base", 0, base, 0.5 * thickness)] if len(base) > 1 else []
    if robot.platform is not None:
        frame = _frame(robot.model, robot.platform.frame)
        body = int(frame.parentJoint)
        corners = _ordered(body_points(robot, body))
        if len(corners) > 2:
            plates.append(_plate("platform", body, corners, thickness))
        else:
            ball = place(translation=frame.placement.translation)
            plates.append(_solid("plate", body, ball, "sphere", (_POINT_RADIUS * size,), "platform"))
    return plates


def _plate(role: Role, body: int, corners: Array, thickness: float) -> Solid:
    opacity = _CLEAR if role == "base" else 1.0
    if len(corners) == 2:
        bar = _rod("plate", body, corners[0], corners[1], thickness, role)
        return replace(bar, opacity=opacity)
    return Solid("plate", body, np.eye(4), "plate", (), role, ROLE_COLORS[role], prism(corners, thickness), opacity)


def prism(corners: Array, thickness: float) -> Mesh:
    """Return a prism over a polygon (c, 3), c ≥ 3, m, half of the thickness on either side."""
    middle = corners.mean(axis=0)
    offset = 0.5 * thickness * np.linalg.svd(corners - middle).Vh[2]
    c = len(corners)
    vertices = np.concatenate([corners + offset, corners - offset, [middle + offset, middle - offset]])
    i = np.arange(c)
    j = (i + 1) % c
    faces = [(i, j, 2 * c + 0 * i), (c + j, c + i, 2 * c + 1 + 0 * i), (i, c + i, j), (j, c + i, c + j)]
    return vertices, np.concatenate([np.stack(face, axis=1) for face in faces]).astype(np.intp)


def _bars(robot: Robot, size: float, clothed: set[int]) -> list[Solid]:
    return [
        _rod(f"bar_{i}", body, start, end, BAR_RADIUS * size, "link")
        for body in range(1, robot.model.njoints)
        if body not in clothed and robot.model.names[body] not in robot.carriers
        for i, (start, end) in enumerate(_outline(_ordered(body_points(robot, body))))
    ]


def _joints(robot: Robot, size: float) -> list[Solid]:
    model, solids = robot.model, []
    for body in range(1, model.njoints):
        name = str(model.names[body])
        if name in robot.carriers or model.joints[body].nv != 1:
            continue
        role: Role = "actuated" if name in robot.actuated else "passive"
        # fixed to what carries the joint: a slide stays where it is while its rod moves
        parent, home = int(model.parents[body]), model.jointPlacements[body].homogeneous
        side = 2.0 * JOINT_RADIUS * size
        box: tuple[Shape, tuple[float, ...]] = ("box", (side, side, 1.2 * side))
        shape, form = box if slides(model, body) else ("cylinder", (JOINT_RADIUS * size, JOINT_LENGTH * size))
        axis = place(along_z(joint_axis(model, body)))
        solids.append(_solid(f"joint_{name}", parent, home @ axis, shape, form, role))
    for closure in robot.closures:
        frame = _frame(model, closure.frame_a)
        ball = (1.3 * JOINT_RADIUS * size,)
        placement = frame.placement.homogeneous.copy()
        solids.append(_solid(f"closure_{closure.name}", int(frame.parentJoint), placement, "sphere", ball, "closure"))
    return solids


def _carriers(robot: Robot, size: float, clothed: set[int]) -> list[Solid]:
    """Return the tracks of all carriers, and the carriers that the URDF gives no shape."""
    solids = []
    for name, limits in zip(robot.carriers, robot.carrier_limits, strict=True):
        body = int(robot.model.getJointId(name))
        drawn = _sliding if slides(robot.model, body) else _turning
        track, *shapes = drawn(robot, body, limits, size)
        solids += [track, *([] if body in clothed else shapes)]
    return solids


def _sliding(robot: Robot, body: int, limits: CarrierLimits, size: float) -> list[Solid]:
    """Return the rail and the carrier on it."""
    model, longest = robot.model, _LONGEST_RAIL * size
    low, high = max(limits.lower, -longest), min(limits.upper, longest)
    axis = joint_axis(model, body)
    home = model.jointPlacements[body].homogeneous @ place(along_z(axis), 0.5 * (low + high) * axis)
    sides = (RAIL_WIDTH * size, RAIL_HEIGHT * size, high - low)
    return [
        _solid(f"track_of_{model.names[body]}", int(model.parents[body]), home, "box", sides, "track"),
        _solid("carrier", body, np.eye(4), "box", (CARRIER_SIDE * size,) * 3),
    ]


def _turning(robot: Robot, body: int, limits: CarrierLimits, size: float) -> list[Solid]:
    """Return the arc through the centre of mass, and the mass at the end of its arm.

    A mass that is balanced about the axis is a bar across it, that its turning be seen.
    """
    model = robot.model
    axis = joint_axis(model, body)
    centre: Array = model.inertias[body].lever
    height = float(centre @ axis)
    arm = centre - height * axis
    radius = float(np.linalg.norm(arm))
    balanced = radius < _BALANCED * size
    out = along_z(axis)[:, 0] if balanced else arm / radius
    radius = BALANCED_RADIUS * size if balanced else radius
    # on the axis, z along it, x towards the carrier at angle zero
    frame = place(np.stack([out, np.cross(axis, out), axis], axis=1), height * axis)
    low, high = limits.lower, limits.upper
    if not high - low < 2.0 * pi:  # more than a round, or without end
        low, high = -pi, pi
    home = model.jointPlacements[body].homogeneous @ frame
    form = (radius, _ARM_RADIUS * size, low, high)
    track = _solid(f"track_of_{model.names[body]}", int(model.parents[body]), home, "arc", form, "track")
    side = CARRIER_SIDE * size
    if balanced:
        return [track, _solid("carrier", body, frame, "box", (2.0 * radius, 0.5 * side, 0.5 * side))]
    mass = frame @ place(translation=np.array([radius, 0.0, 0.0]))
    rod = _rod("carrier_arm", body, frame[:3, 3], mass[:3, 3], _ARM_RADIUS * size, "carrier")
    return [track, _solid("carrier", body, mass, "box", (side,) * 3), rod]


def _solid(
    name: str, body: int, placement: Array, shape: Shape, form: tuple[float, ...], role: Role = "carrier"
) -> Solid:
    return Solid(name, body, placement, shape, form, role, ROLE_COLORS[role])


def _rod(name: str, body: int, start: Array, end: Array, radius: float, role: Role) -> Solid:
    """Return a cylinder between two points."""
    length = float(np.linalg.norm(end - start))
    placement = place(along_z((end - start) / length), 0.5 * (start + end))
    return _solid(name, body, placement, "cylinder", (radius, length), role)


# --- joints and placements -----------------------------------------------------------------------------------------


def along_z(axis: Array) -> Array:
    """Return a rotation (3, 3) whose third column is a unit axis."""
    # the second column is as near to z as can be: the high side of a rail is up, out of the plane of a planar machine
    helper = np.eye(3)[2 if abs(axis[2]) < 0.9 else 0]
    first = np.cross(helper, axis)
    first /= np.linalg.norm(first)
    return np.stack([first, np.cross(axis, first), axis], axis=1)


def joint_axis(model: pin.Model, index: int) -> Array:
    """Return (3,) the unit axis of a joint of one freedom in its own frame."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    linear, angular = np.split(motion_subspace(model, data, index)[:, 0], 2)
    axis: Array = angular if angular.any() else linear
    return axis / np.linalg.norm(axis)


def slides(model: pin.Model, index: int) -> bool:
    """Return whether a joint is prismatic."""
    return str(model.joints[index].shortname()).startswith("JointModelP")


def place(rotation: Array | None = None, translation: Array | None = None) -> Array:
    """Return a homogeneous placement (4, 4)."""
    turn, shift = np.eye(3) if rotation is None else rotation, np.zeros(3) if translation is None else translation
    placement: Array = pin.SE3(turn, shift).homogeneous
    return placement


def _frame(model: pin.Model, name: str) -> pin.Frame:
    return model.frames[model.getFrameId(name, pin.FrameType.BODY)]
