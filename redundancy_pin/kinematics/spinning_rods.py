"""Rods between two balls: a spin about the line between them that moves nothing else, and the row that holds it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import RANK_TOLERANCE, Array
from redundancy_pin.robot import AXES, Closure, Robot
from redundancy_pin.robot.lookup import find_joint_index, find_link_index

UNIVERSAL = "::universal"
"""How names of frames end between which a row holds the spin of a rod."""


class Rod(NamedTuple):
    """A body between two balls.

    Attributes:
        closure: number of the closure that is the second ball, None where it is a joint.
        ends: the joints that carry the two sides of the second ball.
        near: (3,) centre of the first ball, m.
        far: (3,) centre of the second ball, m.
    """

    closure: int | None
    ends: tuple[int, ...]
    near: Array
    far: Array


def find_spinning_rod(robot: Robot, loose: Collection[str], held: Collection[str], q: Array) -> tuple[str, Rod] | None:
    """Return a ball with a rod whose spin moves nothing else; its other ball may be the joint that is left loose."""
    model = robot.model
    for name in loose:
        for ball in (name, str(model.names[model.parents[find_joint_index(model, name)]])):
            if ball not in ("universe", *held) and (rod := _spins(robot, ball, q)) is not None:
                return ball, rod
    return None


def _spins(robot: Robot, joint: str, q: Array) -> Rod | None:
    """Return the rod that a ball joint carries, if it has one more end, another ball, of a closure or of the tree."""
    model, data = robot.model, robot.model.createData()
    index = find_joint_index(model, joint)
    if model.joints[index].nq != 4:
        return None
    pin.framesForwardKinematics(model, data, q)
    joints = [each for each in range(index + 1, model.njoints) if model.parents[each] == index]
    ends = [Rod(None, (index, each), data.oMi[index].translation, data.oMi[each].translation) for each in joints]
    for number, closure in enumerate(robot.closures):
        frames = [find_link_index(model, name) for name in (closure.frame_a, closure.frame_b)]
        carriers = tuple(int(model.frames[frame].parentJoint) for frame in frames)
        for frame, carrier in zip(frames, carriers, strict=True):
            if carrier == index:
                ends.append(Rod(number, carriers, data.oMi[index].translation, data.oMf[frame].translation))
    if len(ends) != 1 or (np.linalg.norm(ends[0].far - ends[0].near) <= RANK_TOLERANCE * robot.characteristic_length):
        return None
    rod = ends[0]
    is_ball = model.joints[joints[0]].nq == 4 if rod.closure is None else robot.closures[rod.closure].axes == AXES[:3]
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
    ends = (int(model.parents[index]), int(index)) if at_first else rod.ends
    names = f"{joint}:a{UNIVERSAL}", f"{joint}:b{UNIVERSAL}"
    for name, carrier in zip(names, ends, strict=True):
        model.addFrame(pin.Frame(name, carrier, data.oMi[carrier].inverse() * place, pin.FrameType.BODY))
    spin = Closure(f"spin of {joint}", names[0], names[1], ("rz",))
    if at_first or rod.closure is None:
        return replace(robot, model=model, closures=(*robot.closures, spin))
    closures = list(robot.closures)
    closures[rod.closure] = replace(spin, name=closures[rod.closure].name, axes=(*AXES[:3], "rz"))
    return replace(robot, model=model, closures=tuple(closures))
