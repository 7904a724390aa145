"""A scene on meshcat: objects once, then one animation. Works on a live viewer and on a recorder alike.

Everything that changes with time belongs to groups (pose, size, shown or not) and nothing to materials: a browser that
connects late is sent the animation first and the objects after it, and finds groups but no materials then.

Key frames of meshcat animations: the same tracks as its own ``Animation`` makes, filled from whole arrays.

Times are in seconds of the motion (a frame rate of 1 and frames that need not be whole), so that a motion plays at true
speed whatever its sampling. Every clip spans the whole motion: clips of different length would drift apart in a loop.
"""

from __future__ import annotations

import uuid
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.visualisation.viewer.scene import (
    EFFORT_COLORS,
    MARGIN_COLORS,
    ROLE_COLORS,
    UNKNOWN_COLOR,
    Arrow,
    Mesh,
    Plate,
    Scene,
    Solid,
    along_z,
    arc_points,
    code,
    corners_of,
    margin_classes,
    place,
    rgb,
)

AROUND = 14
"""Corners of a round cross-section."""

_ARC = 1.5 * np.pi
"""Angle of an arc up to its head: long enough to tell the sense of rotation, short enough to see where it starts."""


def arrow() -> Mesh:
    """Return an arrow of length 1 along z, with its foot at the origin; 0.22 wide at its head."""
    profile = np.array([[0.0, 0.0], [0.035, 0.0], [0.035, 0.75], [0.11, 0.75], [0.0, 1.0]])
    angles = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    rings = np.array([[[r * np.cos(a), r * np.sin(a), z] for a in angles] for r, z in profile])
    return _skin(rings, closed=False)


def arc() -> Mesh:
    """Return an arc with a head, of radius 1 about z, from the x axis in the positive sense."""
    shaft = [(angle, 0.06) for angle in np.linspace(0.0, _ARC - 0.35, 40)]
    sections = [(0.0, 0.0), *shaft, (_ARC - 0.35, 0.2), (_ARC, 0.0)]
    around = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    rings = []
    for angle, radius in sections:
        out = np.array([np.cos(angle), np.sin(angle), 0.0])
        up = np.array([0.0, 0.0, 1.0])
        rings.append([out + radius * (np.cos(a) * out - np.sin(a) * up) for a in around])
    return _skin(np.array(rings), closed=False)


def plate(corners: Array, thickness: float) -> Mesh:
    """Return a prism over a polygon.

    Args:
        corners: (c, 3) in order around the polygon, c ≥ 3, m.
        thickness: m, half of it on either side.
    """
    middle = corners.mean(axis=0)
    normal = np.linalg.svd(corners - middle).Vh[2]
    offset = 0.5 * thickness * normal
    c = len(corners)
    vertices = np.concatenate([corners + offset, corners - offset, [middle + offset, middle - offset]])
    triangles = []
    for i in range(c):
        j = (i + 1) % c
        triangles += [(i, j, 2 * c), (c + j, c + i, 2 * c + 1), (i, c + i, j), (j, c + i, c + j)]
    return vertices, np.array(triangles, dtype=np.intp)


def tube(points: Array, radius: float) -> tuple[Array, IntArray, IntArray]:
    """Return a tube along points.

    Args:
        points: (N, 3), m; those that coincide with the one before are passed over.
        radius: m.

    Returns:
        Vertices (V, 3), triangles (T, 3), and (V,) the index of the point each vertex belongs to. Without any length
        all three are empty.
    """
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    kept = np.concatenate([[0], np.flatnonzero(step > 1e-3 * radius) + 1]) if len(points) else np.zeros(0, dtype=int)
    if len(kept) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.intp), np.zeros(0, dtype=np.intp)
    way = points[kept]
    tangent = np.gradient(way, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    helper = np.eye(3)[int(np.argmin(np.abs(tangent).max(axis=0)))]  # the direction the path uses least
    first = np.cross(helper, tangent)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    second = np.cross(tangent, first)
    around = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)
    rings = way[:, None] + radius * (
        np.cos(around)[None, :, None] * first[:, None] + np.sin(around)[None, :, None] * second[:, None]
    )
    vertices, triangles = _skin(rings, closed=False)
    return vertices, triangles, np.repeat(kept, len(around))


def _skin(rings: Array, *, closed: bool) -> Mesh:
    """Return the surface through rings (R, a, 3)."""
    count, around = rings.shape[:2]
    ring = np.arange(count if closed else count - 1)[:, None]
    here, side = np.arange(around)[None, :], (np.arange(around)[None, :] + 1) % around
    after = (ring + 1) % count
    a, b = ring * around + here, ring * around + side
    c, d = after * around + here, after * around + side
    triangles = np.concatenate([np.stack([a, b, c], axis=2), np.stack([b, d, c], axis=2)], axis=1)
    return rings.reshape(-1, 3), triangles.reshape(-1, 3).astype(np.intp)


def pose_tracks(t: Array, placement: Array) -> list[Any]:
    """Return the tracks of a moving frame; none where it rests.

    Args:
        t: (F,) time, s.
        placement: (F, 4, 4).
    """
    position = placement[:, :3, 3]
    tracks = []
    if not _rests(position):
        tracks.append(_track("position", "vector3", t, position.tolist()))
    if not _rests(placement[:, :3, :3].reshape(len(t), 9)):
        turned = Rotation.from_matrix(placement[:, :3, :3]).as_quat()
        tracks.append(_track("quaternion", "quaternion", t, turned.tolist()))
    return tracks


def scale_tracks(t: Array, scale: Array) -> list[Any]:
    """Return the track of a changing size (F, 3); none where it stays."""
    return [] if _rests(scale) else [_track("scale", "vector3", t, scale.tolist())]


def visible_tracks(t: Array, visible: BoolArray) -> list[Any]:
    """Return the track of what is shown at times only, with a key where it changes, and one at either end."""
    changes = np.flatnonzero(np.diff(visible)) + 1
    keys = np.unique(np.concatenate([[0], changes, [len(t) - 1]]))
    return [_track("visible", "bool", t[keys], [bool(shown) for shown in visible[keys]])]


def clip(tracks: Sequence[Any]) -> Any:
    """Return an animation clip of one object."""
    from meshcat.animation import AnimationClip

    return AnimationClip(tracks={track.name: track for track in tracks}, fps=1)


def _track(name: str, kind: str, t: Array, values: list[Any]) -> Any:
    from meshcat.animation import AnimationTrack

    return AnimationTrack(name, kind, frames=[float(time) for time in t], values=values)


def _rests(values: Array) -> bool:
    return bool(np.abs(values - values[0]).max(initial=0.0) < 1e-12)


PATH_RADIUS = 0.008
"""Of the traced path, in sizes of the machine."""

_POINT_RADIUS = 0.09
"""Of a platform that is a point, in sizes of the machine."""

_CLEAR = 0.35
"""Opacity of what other things must be seen through."""

MESH_OPACITY = 0.5
"""Of meshes: joints, closures and carriers are inside them."""

_NOTHING = 1e-6
"""Least size of an arrow, m: viewers warn of objects without any."""

_MARGIN = 0.1
"""Free space about the machine, in its sizes: arrows need some."""

_SAMPLED = 40
"""Frames from which the camera's view follows."""

_DISTANCE = 1.4
"""Of the camera, in radii of what it must see: its view is 75 degrees high."""

_LAST = 3
"""Order in which arrows are drawn: after what is see-through (0) and the path (1, 2)."""

_ENDLESS = 2**31 - 1
"""Repetitions of the animation."""


def send_scene(viewer: Any, scene: Scene, *, forces: bool = True) -> None:
    """Send a scene to a viewer.

    Args:
        viewer: a ``meshcat.Visualizer``.
        scene: the scene.
        forces: whether arrows are shown at first; a viewer can switch them.
    """
    from meshcat.animation import Animation
    from meshcat.path import Path

    clips: dict[Any, Any] = {}

    def move(path: str, tracks: list[Any]) -> None:
        if tracks:
            clips[Path(("meshcat", *path.split("/")))] = clip(tracks)

    _set_stage(viewer, scene)
    bodies = [f"robot/{_plain(name)}" for name in scene.names]
    for j, path in enumerate(bodies):
        viewer[path].set_transform(scene.placement[0, j])
        move(path, pose_tracks(scene.t, scene.placement[:, j]))
    # shapes of a platform stand back for the plate whose colour says something
    covered = {item.body for item in scene.plates if len(item.corners) >= 3 and item.role == "platform"}
    for solid in scene.solids:
        clear = solid.body in covered and solid.role == "link"
        material = _material(solid.color, _CLEAR if clear else 1.0)
        if solid.shape == "mesh":
            material = _faceted(solid.color, _CLEAR if clear else MESH_OPACITY)
        _add(viewer, solid_path(scene, solid), _shape(solid), material, solid.placement)
    for flat in scene.plates:
        _add_plate(viewer, scene, flat, bodies[flat.body], move)
    for effort in scene.arrows:
        _add_arrow(viewer, scene, effort, move)
    viewer["forces"].set_property("visible", forces)
    _add_path(viewer, scene)
    viewer.set_animation(Animation(clips=clips), play=True, repetitions=_ENDLESS)


def solid_path(scene: Scene, solid: Solid) -> str:
    """Return where a solid is in the tree of meshcat, below its root."""
    return f"robot/{_plain(scene.names[solid.body])}/{_plain(solid.name)}"


def _set_stage(viewer: Any, scene: Scene) -> None:
    """White behind, no grid, and a camera that sees all of the motion."""
    for end in ("top_color", "bottom_color"):
        viewer["/Background"].set_property(end, [1.0, 1.0, 1.0])
    for name in ("/Grid", "/Axes"):
        viewer[name].set_property("visible", False)
    low, high = _extent(scene)
    radius = 0.5 * float(np.linalg.norm(high - low)) + _MARGIN * scene.size
    joints = scene.placement[:, 1:, 2, 3]
    flat = np.ptp(joints) < 0.02 * scene.size
    # a flat machine is seen from above with x to the right; any other obliquely
    direction = np.array([0.0, -0.25, 1.0]) if flat else np.array([0.8, -1.0, 0.6])
    x, y, z = _DISTANCE * radius * direction / np.linalg.norm(direction)
    # meshcat's camera looks at the origin whatever is done to it: what is to be in the middle goes there
    viewer.set_transform(place(translation=-0.5 * (low + high)))
    # the camera hangs in a frame whose y axis points up
    viewer["/Cameras/default/rotated/<object>"].set_property("position", [float(x), float(z), float(-y)])


def _extent(scene: Scene) -> tuple[Array, Array]:
    """Return the corners (3,), (3,) m of the box that holds all solids and the path over the whole motion."""
    frames = np.linspace(0, len(scene.t) - 1, min(len(scene.t), _SAMPLED)).round().astype(np.intp)
    points = [scene.placement[frames, 1:, :3, 3].reshape(-1, 3), scene.path]
    for solid in scene.solids:
        place = scene.placement[frames, solid.body]
        points.append((corners_of(solid) @ place[:, :3, :3].transpose(0, 2, 1) + place[:, None, :3, 3]).reshape(-1, 3))
    every = np.concatenate(points)
    return every.min(axis=0), every.max(axis=0)


def _add_plate(viewer: Any, scene: Scene, item: Plate, parent: str, move: Any) -> None:
    """A platform has a copy in the colour of each class of the margin that occurs, shown while it lasts."""
    path = f"{parent}/plate_{_plain(item.name)}"
    placement = np.eye(4)
    if len(item.corners) >= 3:
        geometry = _mesh(plate(item.corners, item.thickness))
    elif len(item.corners) == 2:
        along = item.corners[1] - item.corners[0]
        length = float(np.linalg.norm(along))
        placement = place(along_z(along / length), item.corners.mean(axis=0)) @ _Y_TO_Z
        geometry = _geometry().Cylinder(length, item.thickness)
    else:
        placement = place(translation=item.corners[0])
        geometry = _geometry().Sphere(_POINT_RADIUS * scene.size)
    if item.role != "platform":
        _add(viewer, path, geometry, _material(ROLE_COLORS[item.role], opacity=_CLEAR), placement)
        return
    classes = margin_classes(scene.margin)
    for number in sorted(set(classes.tolist())):
        color = MARGIN_COLORS[number] if number >= 0 else UNKNOWN_COLOR
        shown: BoolArray = classes == number
        copy = f"{path}_margin_{number if number >= 0 else 'unknown'}"
        _add(viewer, copy, geometry, _flat(color), placement)
        viewer[copy].set_property("visible", bool(shown[0]))
        if not shown.all():
            move(copy, visible_tracks(scene.t, shown))


def _add_arrow(viewer: Any, scene: Scene, item: Arrow, move: Any) -> None:
    path = f"forces/{item.group}_{_plain(item.name)}"
    placement = scene.placement[:, item.body] @ place(along_z(item.axis))
    length = np.where(np.abs(item.length) < _NOTHING, _NOTHING, item.length)
    size = np.abs(length)
    if item.turning:  # mirrored, an arc turns the other way round
        scale = np.stack([size, length, size], axis=1)
    else:  # all arrows are equally wide but for short ones
        wide = np.minimum(size, 0.35 * scene.size)
        scale = np.stack([wide, wide, length], axis=1)
    viewer[path].set_transform(placement[0])
    move(path, pose_tracks(scene.t, placement))
    viewer[f"{path}/effort"].set_transform(np.diag([*scale[0], 1.0]))
    move(f"{path}/effort", scale_tracks(scene.t, scale))
    geometry = _mesh(arc() if item.turning else arrow())
    material = _on_top(color=code(EFFORT_COLORS[item.group]))
    _add(viewer, f"{path}/effort/arrow", geometry, material, np.eye(4), order=_LAST)


def _add_path(viewer: Any, scene: Scene) -> None:
    layers = (("halo", 2.0 * PATH_RADIUS), ("margin", PATH_RADIUS))  # white about it: seen on any ground
    for order, (name, radius) in enumerate(layers, start=1):
        vertices, triangles, owner = tube(scene.path, radius * scene.size)
        if not len(vertices):
            return
        color = np.ones(vertices.shape) if name == "halo" else _path_colors(scene)[owner]
        geometry = _geometry().TriangularMeshGeometry(vertices, triangles, color=color)
        _add(viewer, f"path/{name}", geometry, _on_top(vertexColors=True), np.eye(4), order=order)


def _path_colors(scene: Scene) -> Array:
    """Return (N, 3) the colour of each sample of the path."""
    palette = np.array([rgb(color) for color in (*MARGIN_COLORS, UNKNOWN_COLOR)])  # −1 is the last
    colors: Array = palette[margin_classes(scene.path_margin)]
    return colors


def _add(viewer: Any, path: str, geometry: Any, material: Any, placement: Array, *, order: int = 0) -> None:
    """Set an object. Identifiers, else random, follow from its path: the same scene gives the same bytes.

    Among see-through objects, those of a higher ``order`` are drawn later.
    """
    thing = _ordered(geometry, material, order)
    for kind, element in (("object", thing), ("geometry", geometry), ("material", material)):
        element.uuid = str(uuid.uuid5(uuid.NAMESPACE_URL, f"redundancy_pin/{path}/{kind}"))
    viewer[path].set_object(thing)
    viewer[path].set_transform(placement)


def _ordered(geometry: Any, material: Any, order: int) -> Any:
    """Return an object that says when it is drawn, which meshcat's own cannot."""

    class Ordered(_geometry().Mesh):  # type: ignore[misc]
        def lower(self) -> Any:
            data = super().lower()
            data["object"]["renderOrder"] = order
            return data

    return Ordered(geometry, material)


def _shape(solid: Solid) -> Any:
    geometry = _geometry()
    if solid.mesh is not None:
        return _mesh(solid.mesh)
    if solid.shape == "box":
        return geometry.Box(list(solid.size))
    if solid.shape == "sphere":
        return geometry.Sphere(solid.size[0])
    if solid.shape == "arc":
        return _mesh(tube(arc_points(solid), solid.size[1])[:2])
    radius, length = solid.size
    return _mesh(_cylinder(radius, length))


def _cylinder(radius: float, length: float) -> Mesh:
    """Return a closed cylinder about z; meshcat's own stands on y."""
    around = np.linspace(0.0, 2.0 * np.pi, 24, endpoint=False)
    circle = np.stack([np.cos(around), np.sin(around)], axis=1)
    profile = [(0.0, -0.5), (radius, -0.5), (radius, -0.5), (radius, 0.5), (radius, 0.5), (0.0, 0.5)]
    rings = np.array([[[r * x, r * y, z * length] for x, y in circle] for r, z in profile])
    here, side = np.arange(24), (np.arange(24) + 1) % 24
    faces = []
    for ring in (0, 2, 4):  # doubled rings keep the edges sharp
        a, b, c, d = (24 * ring + here, 24 * ring + side, 24 * (ring + 1) + here, 24 * (ring + 1) + side)
        faces += [np.stack([a, b, c], axis=1), np.stack([b, d, c], axis=1)]
    return rings.reshape(-1, 3), np.concatenate(faces).astype(np.intp)


def _mesh(mesh: Mesh) -> Any:
    return _geometry().TriangularMeshGeometry(*mesh)


def _material(color: str, opacity: float = 1.0) -> Any:
    return _geometry().MeshLambertMaterial(color=code(color), opacity=opacity)


def _faceted(color: str, opacity: float = 1.0) -> Any:
    """Return a material that shades each triangle by itself: edges of machine parts stay sharp."""
    return _geometry().MeshPhongMaterial(color=code(color), opacity=opacity, flatShading=True)


def _flat(color: str) -> Any:
    """Return a material that light does not change: its colour means something."""
    return _geometry().MeshBasicMaterial(color=code(color))


def _on_top(**settings: Any) -> Any:
    """Return a material of its exact colour that nothing hides: drawn after all opaque things, whatever is nearer."""
    return _geometry().MeshBasicMaterial(transparent=True, depthTest=False, **settings)


def _geometry() -> Any:
    from meshcat import geometry

    return geometry


def _plain(name: str) -> str:
    """Return a name that is one step of a path."""
    return name.replace("/", "_")


_Y_TO_Z = place(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))
"""Turns meshcat's cylinders, which stand on y, to z."""
