"""What a picture of a robot consists of, as arrays, and the shapes that its URDF gives: no viewer is named here."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array, IntArray, assign
from redundancy_pin.io.reading import is_file
from redundancy_pin.robot import Robot
from redundancy_pin.robot.formats.packages import is_within, own_folders, package_roots
from redundancy_pin.robot.formats.xml_files import parsed_text

Role = Literal["base", "link", "track", "carrier", "actuated", "passive", "closure", "platform"]
"""What a part is to the mechanism; it decides on the colour."""

Shape = Literal["box", "cylinder", "sphere", "arc", "mesh", "plate"]

Mesh = tuple[Array, IntArray]
"""Vertices (V, 3), m, and triangles (T, 3), indices of vertices."""

ROLE_COLORS: Mapping[Role, str] = {
    "base": "#5A5A5A",
    "link": "#4A7FB5",
    "track": "#F0C808",
    "carrier": "#D95F0E",
    "actuated": "#202020",
    "passive": "#C8C8C8",
    "closure": "#9B59B6",
    "platform": "#348C4D",
}
"""Colour of each role, where the URDF does not give a link its own."""

ROLE_NAMES: Mapping[Role, str] = {
    "link": "link",
    "actuated": "driven joint",
    "passive": "passive joint",
    "closure": "loop joint",
    "track": "track",
    "carrier": "carrier",
}
"""What legends call them, in their order."""

MESH_OPACITY = 0.5  # of meshes: joints, closures and carriers are inside them
_ARC_STEP = 0.05  # of the points along an arc, rad
_CORNERS = 16  # of a circle
LARGEST_MESH = 50 << 20  # bytes, of an untrusted robot
_CLOSED_FORMATS = (".stl", ".obj", ".dae", ".ply")  # others, such as glTF, name further files for their vertices
_WARNED = 3  # of the meshes that cannot be read, how many the warning names
_SCHEMES = ("package://", "model://")
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Solid:
    """A shape fixed to a body. A cylinder has its axis along z; a plate is a prism over a polygon.

    Its ``size``, m: sides (3) of a box, radius and length of a cylinder, radius of a sphere; radius and thickness of an
    arc and the angles of its ends, rad about z from x; empty for a mesh and a plate.
    """

    name: str  # unique within the body
    body: int  # index of the joint that moves it; 0 is the base
    placement: Array  # (4, 4) homogeneous placement in the frame of that joint, m
    shape: Shape
    size: tuple[float, ...]
    role: Role
    color: str = ""  # ``#rrggbb``; that of the role when left out
    mesh: Mesh | None = None  # of a mesh and a plate, in the frame of ``placement``
    opacity: float = 1.0  # less than 1 where other things are to be seen through it

    def __post_init__(self) -> None:
        """Give it the colour of its role."""
        assign(self, color=self.color or ROLE_COLORS[self.role])


def points_of(solid: Solid) -> Array:
    """Return points (P, 3) whose convex hull is a solid, round ones as polygons, in the frame of its placement, m.

    Of an arc they are along its middle.
    """
    angle = np.linspace(0.0, 2.0 * np.pi, _CORNERS, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    points: Array
    if solid.mesh is not None:
        points = solid.mesh[0]
    elif solid.shape == "arc":
        radius, _, low, high = solid.size
        angle = np.linspace(low, high, max(2, round(abs(high - low) / _ARC_STEP) + 1))
        points = radius * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1)
    elif solid.shape == "box":
        points = (np.indices((2, 2, 2)).reshape(3, 8).T - 0.5) * np.array(solid.size)
    elif solid.shape == "cylinder":
        points = np.concatenate([solid.size[0] * circle + [0.0, 0.0, end * solid.size[1]] for end in (-0.5, 0.5)])
    else:
        rise = np.linspace(-0.5 * np.pi, 0.5 * np.pi, _CORNERS // 2 + 1)[:, None, None]
        points = solid.size[0] * (np.cos(rise) * circle + np.sin(rise) * [0.0, 0.0, 1.0]).reshape(-1, 3)
    return points


def extent_of(solids: Iterable[Solid], placement: Array, path: Array, seen: Array) -> tuple[Array, Array]:
    """Return the corners (d,), (d,) of the box that holds solids and a path (N, 3) over F frames, m.

    ``placement`` (F, J, 4, 4) are the frames of the joints; ``seen`` (d, 3) is a projection, or the identity.
    """
    every = [path @ seen.T]
    for solid in solids:
        points = points_of(solid)
        corners = np.where(np.indices((2, 2, 2)).reshape(3, 8).T, points.max(axis=0), points.min(axis=0))
        placed = placement[:, solid.body] @ solid.placement  # of a box about the solid: meshes have many points
        every.append((corners @ placed[:, :3, :3].transpose(0, 2, 1) + placed[:, None, :3, 3]).reshape(-1, 3) @ seen.T)
    low, high = (end(np.concatenate(every), axis=0) for end in (np.min, np.max))
    return low, high


def shapes_of_urdf(robot: Robot) -> tuple[Solid, ...]:
    """Return the visual shapes of the URDF, links and base in the colours it gives them.

    Meshes that are not found or cannot be read are left out, with one warning through ``logging``.
    """
    if not robot.urdf:  # made of a Pinocchio model
        return ()
    import coal

    loader = coal.CachedMeshLoader()
    urdf, unreadable = _with_readable_meshes(robot, loader)
    if unreadable:
        rest = f"; and {len(unreadable) - _WARNED} more" if len(unreadable) > _WARNED else ""
        _LOG.warning(
            "%d mesh file(s) of %s are not drawn: %s. Links without another shape are drawn as bars between their "
            "joints. Put the files where the URDF says, relative to it; folders of packages go into ROS_PACKAGE_PATH.",
            len(unreadable),
            robot.name,
            "; ".join(unreadable[:_WARNED]) + rest,
        )
    visual = pin.buildGeomFromUrdfString(robot.model, urdf, pin.GeometryType.VISUAL, mesh_loader=loader)
    meshes: dict[tuple[str, tuple[float, ...]], Mesh] = {}
    solids = []
    for item in visual.geometryObjects:
        body = int(item.parentJoint)
        carrier = str(robot.model.names[body]) in robot.carriers
        role: Role = "carrier" if carrier else "base" if body == 0 else "link"
        given = "#" + "".join(f"{round(255 * float(part)):02x}" for part in item.meshColor[:3])
        color = given if item.overrideMaterial and not carrier else ""
        shape, size = _primitive(item.geometry)
        mesh = None
        if shape == "mesh":  # a file that many links share is copied out of coal once
            key = (str(item.meshPath), tuple(float(factor) for factor in item.meshScale))
            if key not in meshes:
                faces = [[item.geometry.tri_indices(i)[k] for k in range(3)] for i in range(item.geometry.num_tris)]
                vertices = np.array(item.geometry.vertices(), dtype=float)
                meshes[key] = vertices, np.array(faces, dtype=np.intp).reshape(-1, 3)
            mesh = meshes[key]
        opacity = 1.0 if mesh is None else MESH_OPACITY
        placement = item.placement.homogeneous.copy()
        solids.append(Solid(f"visual_{item.name}", body, placement, shape, size, role, color, mesh, opacity))
    return tuple(solids)


def find_mesh(filename: str, folder: str) -> Path | None:
    """Return the mesh file that a URDF names, or None if it does not exist.

    A relative name is searched in the folder of the URDF; ``package://NAME/...`` in folders called NAME next to and
    above the URDF, and in the folders of ``ROS_PACKAGE_PATH`` and ``AMENT_PREFIX_PATH``.
    """
    for scheme in _SCHEMES:
        if filename.startswith(scheme):
            name, _, rest = filename.removeprefix(scheme).partition("/")
            candidates = (root / rest for root in package_roots(name, Path(folder) if folder else None))
            return next((file for file in candidates if is_file(file)), None)
    path = Path(filename.removeprefix("file://"))
    if not path.is_absolute():
        if not folder:
            return None
        path = Path(folder) / path
    return path if is_file(path) else None


def _with_readable_meshes(robot: Robot, loader: Any) -> tuple[str, tuple[str, ...]]:
    """Return a URDF for drawing only, and the problem of each mesh that was left out of it.

    Mesh files have their absolute paths, visuals with meshes that cannot be read are gone, and so is all collision
    geometry. A capsule, which Pinocchio's reader does not know, is a cylinder and two spheres.
    """
    try:
        root = ElementTree.fromstring(robot.urdf)
    except ElementTree.ParseError:  # a prefix that is bound to no namespace
        root = parsed_text(robot.urdf, "The URDF")
    unreadable: list[str] = []
    for link in root.iter("link"):
        for collision in link.findall("collision"):
            link.remove(collision)
        for visual in link.findall("visual"):
            mesh, capsule = visual.find("geometry/mesh"), visual.find("geometry/capsule")
            problem = _resolve(mesh, robot, loader) if mesh is not None else ""
            if problem:
                unreadable.append(problem)
            if problem or capsule is not None:
                link.remove(visual)
            if capsule is not None:
                link.extend(_parts_of_capsule(visual, capsule))
    return ElementTree.tostring(root, encoding="unicode"), tuple(dict.fromkeys(unreadable))


def _resolve(mesh: ElementTree.Element, robot: Robot, loader: Any) -> str:
    """Give a mesh its absolute path; return the problem with the file, if any."""
    filename = mesh.get("filename", "")
    file = find_mesh(filename, robot.urdf_folder)
    if file is None:
        return f"{filename} is not found"
    if robot.own_meshes_only:
        if not is_within(file, own_folders(Path(robot.urdf_folder) / "urdf")):
            return f"{filename} is outside the folder of its robot, which a file names (pass source= if you trust it)"
        if file.suffix.lower() not in _CLOSED_FORMATS or file.stat().st_size > LARGEST_MESH:
            return f"{filename} is larger than {LARGEST_MESH >> 20} MB, or none of {', '.join(_CLOSED_FORMATS)}"
    try:
        scale = np.array([float(part) for part in mesh.get("scale", "1 1 1").split()])
        loader.load(str(file), scale)
    except (ValueError, RuntimeError):
        return f"{file} cannot be read"
    mesh.set("filename", str(file))
    return ""


def _parts_of_capsule(visual: ElementTree.Element, capsule: ElementTree.Element) -> Iterator[ElementTree.Element]:
    """Return a cylinder and the two spheres at its ends: what a capsule consists of."""
    origin = visual.find("origin")
    given = origin.attrib if origin is not None else {}
    xyz, rpy = (np.array([float(part) for part in given.get(key, "0 0 0").split()]) for key in ("xyz", "rpy"))
    radius, length = capsule.get("radius", "0"), capsule.get("length", "0")
    half = 0.5 * float(length) * Rotation.from_euler("xyz", rpy).as_matrix()[:, 2]
    for shape, centre in (("cylinder", xyz), ("sphere", xyz - half), ("sphere", xyz + half)):
        part = ElementTree.Element("visual")
        placed = {key: " ".join(map(repr, values.tolist())) for key, values in (("xyz", centre), ("rpy", rpy))}
        ElementTree.SubElement(part, "origin", placed)
        size = {"radius": radius, "length": length} if shape == "cylinder" else {"radius": radius}
        ElementTree.SubElement(ElementTree.SubElement(part, "geometry"), shape, size)
        part.extend(visual.findall("material"))
        yield part


def _primitive(geometry: Any) -> tuple[Shape, tuple[float, ...]]:
    kind = type(geometry).__name__
    if kind == "Box":
        return "box", tuple(2.0 * float(side) for side in geometry.halfSide)
    if kind == "Cylinder":
        return "cylinder", (float(geometry.radius), 2.0 * float(geometry.halfLength))
    if kind == "Sphere":
        return "sphere", (float(geometry.radius),)
    return "mesh", ()
