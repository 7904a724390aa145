"""A motion and its efforts turned into the frames of a moving picture."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray, IntArray
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.kinematics.tree import TreeKinematics
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.visualisation.viewer.parts import plates_of, solids_of
from redundancy_pin.visualisation.viewer.scene import Arrow, Group, Scene, joint_axis, margin_classes, slides

FRAME_RATE = 60.0
"""Frames a second of the motion's own time."""

MOST_FRAMES = 600
"""Longer motions get fewer frames a second; a viewer interpolates between them."""

MOST_POINTS = 1000
"""Of the drawn path, but for changes of its colour."""

LONGEST_FORCE, LONGEST_TORQUE = 0.4, 0.16
"""Length of the arrow of the largest force, radius of the arc of the largest torque, in sizes of the machine."""

_BEYOND = 1.5
"""Efforts next to a singularity grow without bound; their arrows stop at this multiple of the longest."""


@dataclass(frozen=True, eq=False)
class ShownMotion:
    """What is shown: a motion of a robot with its efforts.

    Attributes:
        robot: the robot.
        title: one line.
        motion: N samples of the platform motion.
        carriers: N samples of the carrier motion.
        margin: (N,) distance to type II, scaled.
        tau: (N, m) main efforts, N or N·m; NaN where there are none. None: no arrows.
        carrier_force: (N, k) forces of the carriers' actuators, N. None: no arrows.
    """

    robot: Robot
    title: str
    motion: PlatformMotion
    carriers: CarrierMotion
    margin: Array
    tau: Array | None = None
    carrier_force: Array | None = None


def make_scene(shown: ShownMotion, *, force_scale: float = 1.0) -> Scene:
    """Return the moving picture of a motion.

    Args:
        shown: motion and efforts.
        force_scale: how much longer than usual arrows are drawn. Usually the largest force met away from
            singularities has an arrow of 0.4 sizes of the machine, the largest torque an arc of radius 0.16.

    Raises:
        InputError: a scale that is not a positive number, or samples that do not fit together.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as ``lift``.
    """
    if not (np.isfinite(force_scale) and force_scale > 0.0):
        raise InputError(f"force_scale is {force_scale}.", remedy="Pass a positive number.")
    robot, motion = shown.robot, shown.motion
    if len(shown.carriers) != len(motion) or shown.carriers.s.shape[1] != robot.k:
        raise InputError(
            f"The carrier motion has shape {shown.carriers.s.shape}, expected ({len(motion)}, {robot.k}).",
            remedy="Sample it at the times of the platform motion.",
        )
    q = lift(robot, motion).q.copy()
    q[:, robot.carrier_position] = shown.carriers.s
    frames, points = frame_samples(motion.t), path_samples(shown.margin)
    size = robot.characteristic_length
    arrows, captions = _arrows(shown, frames, force_scale)
    return Scene(
        title=shown.title,
        names=("base", *(str(name) for name in list(robot.model.names)[1:])),
        t=motion.t[frames] - motion.t[0],
        placement=_placements(robot.model, q[frames]),
        solids=solids_of(robot, size),
        plates=plates_of(robot, size),
        arrows=arrows,
        margin=np.abs(shown.margin[frames]),
        path=_traced(robot, q[points]),
        path_margin=np.abs(shown.margin[points]),
        size=size,
        captions=captions,
    )


def frame_samples(t: Array) -> IntArray:
    """Return which samples become frames: (F,) indices, increasing in time, the first and the last among them.

    Every frame is a sample, shown at the time it has, so that the picture runs at true speed whatever the sampling.

    Args:
        t: (N,) time, s.
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
    """Return which samples the drawn path goes through: enough to be smooth, and all where its colour changes.

    Args:
        margin: (N,) distance to type II, scaled.
    """
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


def _traced(robot: Robot, q: Array) -> Array:
    """Return (N, 3) the way of the platform's origin or, without a platform, of the first closure."""
    if robot.platform is None and not robot.closures:
        return np.zeros((0, 3))
    name = robot.platform.frame if robot.platform is not None else robot.closures[0].frame_a
    origin: Array = TreeKinematics(robot.model, [name]).pose(q).frame_origin[name].T
    return origin


def _arrows(shown: ShownMotion, frames: IntArray, scale: float) -> tuple[tuple[Arrow, ...], tuple[str, ...]]:
    robot = shown.robot
    regular = ~(np.abs(shown.margin) < NEAR_SINGULAR_MARGIN)
    efforts: list[tuple[str, Group, Array]] = []
    if shown.tau is not None:
        efforts += [(name, "main", shown.tau[:, i]) for i, name in enumerate(robot.actuated)]
    if shown.carrier_force is not None:
        efforts += [(name, "carrier", shown.carrier_force[:, i]) for i, name in enumerate(robot.carriers)]
    bodies = {name: int(robot.model.getJointId(name)) for name, _, _ in efforts}
    turning = {name: not slides(robot.model, body) for name, body in bodies.items()}
    arrows, captions = [], []
    for turns, longest, unit, what in ((False, LONGEST_FORCE, "N", "force"), (True, LONGEST_TORQUE, "N·m", "torque")):
        alike = [entry for entry in efforts if turning[entry[0]] is turns]
        largest = _largest([values for _, _, values in alike], regular)
        if largest == 0.0:
            continue
        per_unit = longest * robot.characteristic_length * scale / largest
        captions.append(f"largest {what} away from singularities: {largest:.3g} {unit}")
        for name, group, values in alike:
            bounded = np.clip(np.nan_to_num(values[frames], posinf=0.0, neginf=0.0), -_BEYOND * largest,
                              _BEYOND * largest)  # fmt: skip
            axis = joint_axis(robot.model, bodies[name])
            arrows.append(Arrow(name, bodies[name], axis, turns, group, per_unit * bounded))
    return tuple(arrows), tuple(captions)


def _largest(efforts: list[Array], regular: BoolArray) -> float:
    """Return the largest finite effort at regular samples or, if there are none, at any."""
    if not efforts:
        return 0.0
    values = np.abs(np.stack(efforts, axis=1))
    values[~np.isfinite(values)] = 0.0
    chosen = values[regular] if regular.any() else values
    return float(chosen.max(initial=0.0))
