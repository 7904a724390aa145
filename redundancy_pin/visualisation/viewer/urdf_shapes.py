"""Mesh files of a URDF: where they are, and their triangles."""

from __future__ import annotations

import logging
import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import IntArray
from redundancy_pin.robot import Robot
from redundancy_pin.visualisation.viewer.scene import ROLE_COLORS, Mesh, Role, Shape, Solid

_SCHEMES = ("package://", "model://")


def find_mesh(filename: str, folder: str) -> Path | None:
    """Return the file that a URDF means, or None where there is none.

    A relative name is looked for in the folder of the URDF. ``package://NAME/...`` is looked for in folders of that
    name beside and above the URDF, and where ``ROS_PACKAGE_PATH`` and ``AMENT_PREFIX_PATH`` point to.

    Args:
        filename: as the URDF gives it.
        folder: of the URDF; empty where it is not known.
    """
    for scheme in _SCHEMES:
        if filename.startswith(scheme):
            name, _, rest = filename.removeprefix(scheme).partition("/")
            candidates = (root / rest for root in _package_roots(name, folder))
            return next((file for file in candidates if file.is_file()), None)
    path = Path(filename.removeprefix("file://"))
    if not path.is_absolute():
        if not folder:
            return None
        path = Path(folder) / path
    return path if path.is_file() else None


def with_readable_meshes(urdf: str, folder: str, loader: Any) -> tuple[str, tuple[str, ...]]:
    """Return a URDF for drawing only, and what is wrong with the meshes that were left out of it.

    Mesh files have their absolute paths, visuals with meshes that cannot be read are gone, and so is all collision
    geometry. A capsule, which Pinocchio's reader does not know, is a cylinder and two spheres.

    Args:
        urdf: the rendered URDF.
        folder: where it lies; empty where it is not known.
        loader: a ``coal.CachedMeshLoader``, which keeps what it reads.
    """
    root = ElementTree.fromstring(urdf)
    unreadable: list[str] = []
    for link in root.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
        for visual in link.findall("visual"):
            mesh, capsule = visual.find("geometry/mesh"), visual.find("geometry/capsule")
            if mesh is not None:
                problem = _resolve(mesh, folder, loader)
                if problem:
                    unreadable.append(problem)
                    link.remove(visual)
            elif capsule is not None:
                link.remove(visual)
                link.extend(_parts_of_capsule(visual, capsule))
    return ElementTree.tostring(root, encoding="unicode"), tuple(dict.fromkeys(unreadable))


def triangles_of(geometry: Any) -> Mesh:
    """Return vertices (V, 3), m, and triangles (T, 3) of a mesh of coal, scaled as the URDF says."""
    corners: IntArray = np.array(
        [tuple(geometry.tri_indices(i)[k] for k in range(3)) for i in range(geometry.num_tris)], dtype=np.intp
    ).reshape(-1, 3)
    return np.array(geometry.vertices(), dtype=float), corners


def _package_roots(name: str, folder: str) -> Iterator[Path]:
    places = [Path(folder), *Path(folder).parents] if folder else []
    places += [Path(entry) for entry in os.environ.get("ROS_PACKAGE_PATH", "").split(os.pathsep) if entry]
    for place in places:
        if place.name == name:
            yield place
        yield place / name
    for prefix in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep):
        if prefix:
            yield Path(prefix) / "share" / name


def _resolve(mesh: ElementTree.Element, folder: str, loader: Any) -> str:
    """Give a mesh its absolute path; return what is wrong with it, if anything."""
    filename = mesh.get("filename", "")
    found = find_mesh(filename, folder)
    if found is None:
        return f"{filename} is not found"
    try:
        scale = np.array([float(part) for part in mesh.get("scale", "1 1 1").split()])
        loader.load(str(found), scale)
    except (ValueError, RuntimeError):
        return f"{found} cannot be read"
    mesh.set("filename", str(found))
    return ""


def _parts_of_capsule(visual: ElementTree.Element, capsule: ElementTree.Element) -> list[ElementTree.Element]:
    """Return a cylinder and the two spheres at its ends: what a capsule consists of."""
    from scipy.spatial.transform import Rotation

    origin = visual.find("origin")
    given = origin.attrib if origin is not None else {}
    xyz, rpy = (np.array([float(part) for part in given.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
    radius, length = capsule.get("radius", "0"), capsule.get("length", "0")
    half = 0.5 * float(length) * Rotation.from_euler("xyz", rpy).as_matrix()[:, 2]
    made = []
    for shape, centre in (("cylinder", xyz), ("sphere", xyz - half), ("sphere", xyz + half)):
        part = ElementTree.Element("visual")
        said = {"xyz": " ".join(map(repr, centre.tolist())), "rpy": " ".join(map(repr, rpy.tolist()))}
        ElementTree.SubElement(part, "origin", said)
        size = {"radius": radius, "length": length} if shape == "cylinder" else {"radius": radius}
        ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), shape, size)
        part.extend(visual.findall("material"))
        made.append(part)
    return made


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
