"""Carriers and their tracks: a straight track to slide along, or an arc about the axis of a carrier that turns."""

from __future__ import annotations

from dataclasses import dataclass
from math import pi

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.visualisation.scene import Role, Shape, Solid
from redundancy_pin.visualisation.scene_colors import ROLE_COLORS
from redundancy_pin.visualisation.scene_frames import along_z, joint_axis, place, slides

RAIL_WIDTH, RAIL_HEIGHT = 0.012, 0.06
"""Cross-section of a straight track: narrow and high, so that it stands out of the link it lies on."""

CARRIER_SIDE = 0.06
"""Of a carrier without a shape of its own, in sizes of the machine."""

BALANCED_RADIUS = 0.1
"""Of the arc about a carrier whose centre of mass is on its axis."""

_ARM_RADIUS = 0.01
"""Of the arm that holds a turning carrier, and of the arc it runs along."""

_LONGEST_RAIL = 1.2
"""Half length, in sizes, at which the drawing of an unbounded track ends."""

_BALANCED = 1e-3
"""Distance of the centre of mass from the axis, in sizes, below which it counts as on it."""


@dataclass(frozen=True, eq=False)
class _Turn:
    """How a turning carrier is drawn, in the frame of its joint at angle zero.

    Attributes:
        frame: (4, 4) on the axis, z along it, x towards the carrier.
        radius: of the arc, m.
        balanced: whether the centre of mass is on the axis.
    """

    frame: Array
    radius: float
    balanced: bool


def carrier_solids(robot: Robot, size: float, clothed: set[int]) -> list[Solid]:
    """Return the tracks of all carriers, and the carriers that the URDF gives no shape.

    Args:
        robot: the robot.
        size: of the machine, m.
        clothed: bodies that the URDF gives a shape.
    """
    solids = []
    for name, limits in zip(robot.carriers, robot.carrier_limits, strict=True):
        body = int(robot.model.getJointId(name))
        if slides(robot.model, body):
            solids.append(_rail(robot, name, body, limits, size))
            if body not in clothed:
                solids.append(_solid("carrier", body, np.eye(4), "box", (CARRIER_SIDE * size,) * 3))
            continue
        turn = _turn(robot, body, size)
        solids.append(_arc(robot, name, body, limits, turn, size))
        if body not in clothed:
            solids += _turning(body, turn, size)
    return solids


def _rail(robot: Robot, name: str, body: int, limits: CarrierLimits, size: float) -> Solid:
    model = robot.model
    longest = _LONGEST_RAIL * size
    low, high = max(limits.lower, -longest), min(limits.upper, longest)
    axis = joint_axis(model, body)
    upright = along_z(axis)
    if abs(axis[2]) < 0.9:  # high side along the joint's z, which is the plane's normal in a planar machine
        side = np.cross(np.array([0.0, 0.0, 1.0]), axis)
        side /= np.linalg.norm(side)
        upright = np.stack([side, np.cross(axis, side), axis], axis=1)
    home = model.jointPlacements[body].homogeneous @ place(upright, 0.5 * (low + high) * axis)
    sides = (RAIL_WIDTH * size, RAIL_HEIGHT * size, high - low)
    return _solid(f"track_of_{name}", int(model.parents[body]), home, "box", sides, "track")


def _turn(robot: Robot, body: int, size: float) -> _Turn:
    """Find where a turning carrier is: its centre of mass, or beside the axis where that is on the axis."""
    axis = joint_axis(robot.model, body)
    centre: Array = robot.model.inertias[body].lever
    height = float(centre @ axis)
    arm = centre - height * axis
    radius = float(np.linalg.norm(arm))
    balanced = radius < _BALANCED * size
    out = along_z(axis)[:, 0] if balanced else arm / radius
    frame = place(np.stack([out, np.cross(axis, out), axis], axis=1), height * axis)
    return _Turn(frame, BALANCED_RADIUS * size if balanced else radius, balanced)


def _arc(robot: Robot, name: str, body: int, limits: CarrierLimits, turn: _Turn, size: float) -> Solid:
    low, high = limits.lower, limits.upper
    if not high - low < 2.0 * pi:  # more than a round, or without end
        low, high = -pi, pi
    home = robot.model.jointPlacements[body].homogeneous @ turn.frame
    form = (turn.radius, _ARM_RADIUS * size, low, high)
    return _solid(f"track_of_{name}", int(robot.model.parents[body]), home, "arc", form, "track")


def _turning(body: int, turn: _Turn, size: float) -> list[Solid]:
    """Return the mass at the end of its arm; a balanced one is a bar across the axis, that its turning be seen."""
    side = CARRIER_SIDE * size
    if turn.balanced:
        return [_solid("carrier", body, turn.frame, "box", (2.0 * turn.radius, 0.5 * side, 0.5 * side))]
    to_x = place(np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]), np.array([0.5 * turn.radius, 0.0, 0.0]))
    mass = turn.frame @ place(translation=np.array([turn.radius, 0.0, 0.0]))
    return [
        _solid("carrier", body, mass, "box", (side,) * 3),
        _solid("carrier_arm", body, turn.frame @ to_x, "cylinder", (_ARM_RADIUS * size, turn.radius)),
    ]


def _solid(
    name: str, body: int, placement: Array, shape: Shape, form: tuple[float, ...], role: Role = "carrier"
) -> Solid:
    return Solid(name, body, placement, shape, form, role, ROLE_COLORS[role])
