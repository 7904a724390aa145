"""Rods between two balls: a spin about the line between them that moves nothing else, and the row that holds it.

A ball is a joint of the model, or three hinges in a row through one point, without mass between them. URDF knows no
balls: onshape-to-robot writes NAME_x, NAME_y, NAME_z.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import RANK_TOLERANCE, Array
from redundancy_pin.robot import AXES, Closure, Robot
from redundancy_pin.robot.inertia import NO_MASS
from redundancy_pin.robot.lookup import find_joint_index, find_link_index
from redundancy_pin.robot.rebuild import axis_of
from redundancy_pin.robot.types import slides

UNIVERSAL = "::universal"
"""How names of frames end between which a row holds the spin of a rod."""


class Rod(NamedTuple):
    """A body between two balls.

    Attributes:
        closure: number of the closure that is the second ball, None for a joint.
        ends: the joints that carry the two sides of the second ball.
        near: (3,) centre of the first ball, m.
        far: (3,) centre of the second ball, m.
    """

    closure: int | None
    ends: tuple[int, ...]
    near: Array
    far: Array


def find_spinning_rod(robot: Robot, loose: Collection[str], held: Collection[str], q: Array) -> tuple[str, Rod] | None:
    """Return a ball with a rod whose spin moves nothing else; its other ball may be the joint that is left loose.

    Of a ball that is three hinges the name is that of the last, which carries the rod.
    """
    model = robot.model
    for name in loose:
        if ball := _ball_around(robot, find_joint_index(model, name)):
            for index in (ball[-1], int(model.parents[ball[0]])):
                end = str(model.names[index])
                if index and end not in held and (rod := _spins(robot, index, q)) is not None:
                    return end, rod
    return None


def hinges_of(robot: Robot, joint: str) -> tuple[str, ...]:
    """Return the joints that are the ball of which a joint is the last."""
    index = find_joint_index(robot.model, joint)
    return tuple(str(robot.model.names[each]) for each in _ball_around(robot, index) or (index,))


def _ball_around(robot: Robot, index: int) -> tuple[int, ...] | None:
    """Return the joints of the ball that a joint is, or is one of three hinges of, outwards; None if it is none."""
    model = robot.model
    if model.joints[index].nq == 4:
        return (index,)
    row = [index]
    while _continues(robot, row[0]):
        row.insert(0, int(model.parents[row[0]]))
    while (after := list(model.children[row[-1]])) and _continues(robot, int(after[0])):
        row.append(int(after[0]))
    if len(row) != 3 or any(str(model.names[each]) in (*robot.actuated, *robot.carriers) for each in row):
        return None
    turn, axes = np.eye(3), []
    for each in row:
        turn = turn @ model.jointPlacements[each].rotation
        axes.append(turn @ axis_of(model, each))
    return tuple(row) if abs(np.linalg.det(axes)) > RANK_TOLERANCE else None


def _continues(robot: Robot, index: int) -> bool:
    """Return whether a hinge turns about a point of the hinge before it, with nothing else and no mass between them."""
    model, before = robot.model, int(robot.model.parents[index])
    are_hinges = before and all(
        model.joints[each].nv == 1 and not slides(model.joints[each]) for each in (before, index)
    )
    away = np.linalg.norm(model.jointPlacements[index].translation)
    return bool(
        are_hinges
        and len(model.children[before]) == 1
        and model.inertias[before].mass <= NO_MASS * pin.computeTotalMass(model)
        and away <= RANK_TOLERANCE * robot.characteristic_length
    )


def _spins(robot: Robot, index: int, q: Array) -> Rod | None:
    """Return the rod that a ball carries, if it has one more end, another ball, of a closure or of the tree.

    ``index``: of the ball, or of the last of its hinges.
    """
    model, data = robot.model, robot.model.createData()
    ball = _ball_around(robot, index)
    if ball is None or ball[-1] != index:
        return None
    pin.framesForwardKinematics(model, data, q)
    start = data.oMi[index].translation
    joints = [each for each in range(index + 1, model.njoints) if model.parents[each] == index]
    ends = [
        Rod(None, (index, (_ball_around(robot, each) or (each,))[-1]), start, data.oMi[each].translation)
        for each in joints
    ]
    for number, closure in enumerate(robot.closures):
        frames = [find_link_index(model, name) for name in (closure.frame_a, closure.frame_b)]
        carriers = tuple(int(model.frames[frame].parentJoint) for frame in frames)
        for frame, carrier in zip(frames, carriers, strict=True):
            if carrier == index:
                ends.append(Rod(number, carriers, start, data.oMf[frame].translation))
    if len(ends) != 1 or (np.linalg.norm(ends[0].far - ends[0].near) <= RANK_TOLERANCE * robot.characteristic_length):
        return None
    rod = ends[0]
    is_ball = _ball_around(robot, joints[0]) if rod.closure is None else robot.closures[rod.closure].axes == AXES[:3]
    return rod if is_ball else None


def centre_off_axis(robot: Robot, joint: str, rod: Rod, q: Array) -> float:
    """Return how far the centre of mass of a rod is from the line between its balls, m; zero without a mass."""
    model, data, index = robot.model, robot.model.createData(), find_joint_index(robot.model, joint)
    if model.inertias[index].mass == 0.0:
        return 0.0
    pin.forwardKinematics(model, data, q)
    along, centre = rod.far - rod.near, data.oMi[index].act(model.inertias[index].lever) - rod.near
    return float(np.linalg.norm(np.cross(along, centre)) / np.linalg.norm(along))


def with_spin_fixed(robot: Robot, joint: str, rod: Rod, q: Array, *, at_first: bool) -> Robot:
    """Return the robot with one row more: a universal joint in place of the first or second of two balls on a rod."""
    model = pin.Model(robot.model)
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    z = (rod.far - rod.near) / np.linalg.norm(rod.far - rod.near)
    x = np.cross(z, np.eye(3)[int(np.argmin(np.abs(z)))])
    x /= np.linalg.norm(x)
    place = pin.SE3(np.column_stack([x, np.cross(z, x), z]), rod.near if at_first else rod.far)
    index = find_joint_index(model, joint)
    first = (_ball_around(robot, index) or (index,))[0]
    ends = (int(model.parents[first]), int(index)) if at_first else rod.ends
    names = f"{joint}:a{UNIVERSAL}", f"{joint}:b{UNIVERSAL}"
    for name, carrier in zip(names, ends, strict=True):
        model.addFrame(pin.Frame(name, carrier, data.oMi[carrier].inverse() * place, pin.FrameType.BODY))
    spin = Closure(f"spin of {joint}", names[0], names[1], ("rz",))
    if at_first or rod.closure is None:
        return replace(robot, model=model, closures=(*robot.closures, spin))
    closures = list(robot.closures)
    closures[rod.closure] = replace(spin, name=closures[rod.closure].name, axes=(*AXES[:3], "rz"))
    return replace(robot, model=model, closures=tuple(closures))
