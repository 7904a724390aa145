"""The shapes a URDF gives its links: primitives and meshes."""

from __future__ import annotations

import logging
from typing import Any

import pinocchio as pin

from redundancy_pin.robot import Robot
from redundancy_pin.visualisation.scene import Mesh, Role, Shape, Solid
from redundancy_pin.visualisation.scene_colors import ROLE_COLORS
from redundancy_pin.visualisation.urdf_meshes import triangles_of, with_readable_meshes

_LOG = logging.getLogger(__name__)

_SAID = 3
"""Of the meshes that cannot be read, how many the warning names."""


def shapes_of_urdf(robot: Robot) -> tuple[Solid, ...]:
    """Return the visual shapes of the URDF, links and base in the colours it gives them.

    Meshes that are not found or cannot be read are left out, with one warning through ``logging``.

    Args:
        robot: the robot.
    """
    import coal

    loader = coal.CachedMeshLoader()
    urdf, unreadable = with_readable_meshes(robot.urdf, robot.urdf_folder, loader)
    if unreadable:
        _warn(robot.name, unreadable)
    visual = pin.buildGeomFromUrdfString(robot.model, urdf, pin.GeometryType.VISUAL, mesh_loader=loader)
    read: dict[tuple[str, tuple[float, ...]], Mesh] = {}
    solids = []
    for item in visual.geometryObjects:
        body = int(item.parentJoint)
        name = str(robot.model.names[body])
        role: Role = "carrier" if name in robot.carriers else "base" if body == 0 else "link"
        given = "#" + "".join(f"{round(255 * float(part)):02x}" for part in item.meshColor[:3])
        color = given if role != "carrier" and item.overrideMaterial else ROLE_COLORS[role]
        shape, size = _primitive(item.geometry)
        mesh = None
        if shape == "mesh":
            key = (str(item.meshPath), tuple(float(factor) for factor in item.meshScale))
            if key not in read:
                read[key] = triangles_of(item.geometry)
            mesh = read[key]
        placement = item.placement.homogeneous.copy()
        solids.append(Solid(str(item.name), body, placement, shape, size, role, color, mesh))
    return tuple(solids)


def _warn(name: str, unreadable: tuple[str, ...]) -> None:
    said = "; ".join(unreadable[:_SAID])
    if len(unreadable) > _SAID:
        said += f"; and {len(unreadable) - _SAID} more"
    _LOG.warning(
        "%d mesh file(s) of %s are not drawn: %s. Links without another shape are drawn as bars between their joints. "
        "Put the files where the URDF says, relative to it; folders of packages go into ROS_PACKAGE_PATH.",
        len(unreadable),
        name,
        said,
    )


def _primitive(geometry: Any) -> tuple[Shape, tuple[float, ...]]:
    kind = type(geometry).__name__
    if kind == "Box":
        return "box", tuple(2.0 * float(side) for side in geometry.halfSide)
    if kind == "Cylinder":
        return "cylinder", (float(geometry.radius), 2.0 * float(geometry.halfLength))
    if kind == "Sphere":
        return "sphere", (float(geometry.radius),)
    return "mesh", ()
