"""A scene on meshcat: its objects, the pose of a frame, and the animation through all frames.

Times of key frames are in seconds of the motion (a frame rate of 1 and frames that need not be whole), so that a motion
plays at true speed whatever its sampling. Every clip spans the whole motion: clips of different length would drift
apart in a loop.
"""

from __future__ import annotations

import importlib
import warnings
from typing import Any
from urllib.parse import quote

import numpy as np
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.visualisation.viewer import mechanism
from redundancy_pin.visualisation.viewer import scene as scenes
from redundancy_pin.visualisation.viewer.solids import Mesh, Solid, extent_of, points_of

AROUND = 14  # corners of the round cross-section of an arrow
PATH_RADIUS = 0.008  # of the traced path, in sizes of the machine

# Angle of an arc up to its head: long enough to tell the sense of rotation, short enough to see where it starts
_ARC = 1.5 * np.pi
_NOTHING = 1e-6  # least size of an arrow, in sizes of the machine: a matrix of scale zero has no normals
_WIDEST = 0.35  # length of an arrow, in sizes of the machine, from which on arrows get no wider
_CONSTANT = 1e-12  # relative change of a property below which it needs no key frames: rounding
_MARGIN = 0.1  # free space about the machine, in its sizes: arrows need some
_SAMPLED = 40  # frames from which the camera's view follows
_DISTANCE = 1.4  # of the camera, in radii of what it must see: its view is 75 degrees high
_LAST = 3  # order in which arrows are drawn: after what is see-through (0) and the path (1, 2)
_ENDLESS = 2**31 - 1  # repetitions of the animation
# Turns meshcat's cylinders, which stand on y, to z
_Y_TO_Z = mechanism.place(np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]]))


def import_meshcat() -> Any:
    """Return the package meshcat; its first import warns of a name of pyzmq that is to go."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        return importlib.import_module("meshcat")


def send_scene(viewer: Any, scene: scenes.Scene, *, forces: bool = True) -> None:
    """Send the objects of a scene to a ``meshcat.Visualizer``; arrows are shown at first if ``forces`` is true."""
    _set_stage(viewer, scene)
    for solid in scene.solids:
        _add_solid(viewer, scene, solid)
    for arrow in scene.arrows:
        _add_arrow(viewer, arrow)
    viewer["forces"].set_property("visible", forces)
    _add_path(viewer, scene)
    send_frame(viewer, scene, 0)


def send_frame(viewer: Any, scene: scenes.Scene, frame: int) -> None:
    """Pose the bodies and the arrows of a scene that was sent, and give the platform the colour of its margin."""
    for j in range(len(scene.names)):
        viewer[_body_path(scene, j)].set_transform(scene.placement[frame, j])
    for arrow in scene.arrows:
        placement, scale = _arrow_frames(scene, arrow)
        viewer[arrow_path(arrow)].set_transform(placement[frame])
        viewer[f"{arrow_path(arrow)}/effort"].set_property("scale", scale[frame].tolist())
    for solid in scene.solids:
        if solid.role == "platform":
            color = [*rgb(scenes.margin_color(float(scene.margin[frame]))), 1.0]
            viewer[solid_path(scene, solid)].set_property("color", color)


def send_animation(viewer: Any, scene: scenes.Scene) -> None:
    """Send key frames of the bodies and the arrows of a scene, which play in a loop."""
    from meshcat.animation import Animation

    clips: dict[Any, Any] = {}
    for j in range(len(scene.names)):
        _animate(clips, viewer[_body_path(scene, j)], scene.t, **_pose(scene.placement[:, j]))
    for arrow in scene.arrows:
        placement, scale = _arrow_frames(scene, arrow)
        _animate(clips, viewer[arrow_path(arrow)], scene.t, **_pose(placement))
        _animate(clips, viewer[f"{arrow_path(arrow)}/effort"], scene.t, scale=scale)
    viewer.set_animation(Animation(clips=clips), play=True, repetitions=_ENDLESS)


def solid_path(scene: scenes.Scene, solid: Solid) -> str:
    """Return where a solid is in the tree of meshcat, below its root."""
    return f"{_body_path(scene, solid.body)}/{_step(solid.name)}"


def arrow_path(arrow: scenes.JointCourse) -> str:
    """Return where an arrow is in the tree of meshcat, below its root."""
    return f"forces/{arrow.group}_{_step(arrow.name)}"


def _body_path(scene: scenes.Scene, body: int) -> str:
    """Return where a body is, below the root: the name of its joint with a prefix, which the base lacks."""
    return f"robot/joint_{_step(scene.names[body])}" if body else "robot/base"


def _step(name: str) -> str:
    """Return a name as one step of a path; different names stay different."""
    return quote(name, safe="")


def _set_stage(viewer: Any, scene: scenes.Scene) -> None:
    """White behind, no grid, and a camera that sees all of the motion."""
    for end in ("top_color", "bottom_color"):
        viewer["/Background"].set_property(end, [1.0, 1.0, 1.0])
    for name in ("/Grid", "/Axes"):
        viewer[name].set_property("visible", False)
    frames = np.linspace(0, len(scene.t) - 1, min(len(scene.t), _SAMPLED)).round().astype(np.intp)
    low, high = extent_of(scene.solids, scene.placement[frames], scene.path, np.eye(3))
    radius = 0.5 * float(np.linalg.norm(high - low)) + _MARGIN * scene.size
    # a flat machine is seen from above with x to the right; any other obliquely
    direction = np.array([0.0, -0.25, 1.0]) if scene.is_flat else np.array(scenes.OBLIQUE)
    x, y, z = _DISTANCE * radius * direction / np.linalg.norm(direction)
    # meshcat's camera looks at the origin whatever is done to it: what is to be in the middle goes there
    viewer.set_transform(mechanism.place(translation=-0.5 * (low + high)))
    # the camera hangs in a frame whose y axis points up
    viewer["/Cameras/default/rotated/<object>"].set_property("position", [float(x), float(z), float(-y)])


# --- objects -------------------------------------------------------------------------------------------------------


def _add_solid(viewer: Any, scene: scenes.Scene, solid: Solid) -> None:
    from meshcat import geometry

    placement, color = solid.placement, {"color": int(solid.color[1:], 16), "opacity": solid.opacity}
    if solid.shape == "box":
        shape = geometry.Box(list(solid.size))
    elif solid.shape == "sphere":
        shape = geometry.Sphere(solid.size[0])
    elif solid.shape == "cylinder":
        shape, placement = geometry.Cylinder(solid.size[1], solid.size[0]), placement @ _Y_TO_Z
    else:
        mesh = solid.mesh or tube(points_of(solid), solid.size[1])[:2]
        shape = geometry.TriangularMeshGeometry(*mesh)
    if solid.role == "platform":
        material = geometry.MeshBasicMaterial(**color)  # no light changes a colour that means something
    elif solid.shape == "mesh":
        material = geometry.MeshPhongMaterial(**color, flatShading=True)  # edges of machine parts stay sharp
    else:
        material = geometry.MeshLambertMaterial(**color)
    _add(viewer, solid_path(scene, solid), shape, material, placement)


def _add_arrow(viewer: Any, item: scenes.JointCourse) -> None:
    from meshcat import geometry

    shape = geometry.TriangularMeshGeometry(*(arc() if item.turning else arrow()))
    material = _on_top(color=int(scenes.EFFORT_COLORS[item.group][1:], 16))
    _add(viewer, f"{arrow_path(item)}/effort/arrow", shape, material, order=_LAST)


def _arrow_frames(scene: scenes.Scene, item: scenes.JointCourse) -> tuple[Array, Array]:
    """Return (F, 4, 4) where an arrow is and (F, 3) its scale.

    A negative effort mirrors its arrow: straight ones point the other way, arcs turn the other way.
    """
    least = _NOTHING * scene.size
    length = np.where(np.abs(item.length) < least, least, item.length)
    wide = np.abs(length) if item.turning else np.minimum(np.abs(length), _WIDEST * scene.size)
    scale = np.stack([wide, length, wide] if item.turning else [wide, wide, length], axis=1)
    return scene.placement[:, item.body] @ mechanism.place(mechanism.along_z(item.axis)), scale


def _add_path(viewer: Any, scene: scenes.Scene) -> None:
    from meshcat import geometry

    palette = np.array([rgb(color) for color in (*scenes.MARGIN_COLORS, scenes.UNKNOWN_COLOR)])  # class −1 is the last
    layers = (("halo", 2.0 * PATH_RADIUS), ("margin", PATH_RADIUS))  # white about it: seen on any ground
    for order, (name, radius) in enumerate(layers, start=1):
        vertices, triangles, owner = tube(scene.path, radius * scene.size)
        if not len(vertices):
            return
        color = np.ones(vertices.shape) if name == "halo" else palette[scenes.margin_classes(scene.path_margin)][owner]
        shape = geometry.TriangularMeshGeometry(vertices, triangles, color=color)
        _add(viewer, f"path/{name}", shape, _on_top(vertexColors=True), order=order)


def _add(viewer: Any, path: str, shape: Any, material: Any, placement: Array | None = None, *, order: int = 0) -> None:
    """Set an object; see-through objects of a higher ``order`` are drawn later."""
    from meshcat import geometry

    class Ordered(geometry.Mesh):  # type: ignore[misc]
        def lower(self) -> Any:  # meshcat's own object cannot say when it is drawn
            data = super().lower()
            data["object"]["renderOrder"] = order
            return data

    viewer[path].set_object(Ordered(shape, material))
    if placement is not None:
        viewer[path].set_transform(placement)


def _on_top(**settings: Any) -> Any:
    """Return a material of its exact colour that nothing hides: drawn after all opaque things, whatever is nearer."""
    from meshcat import geometry

    return geometry.MeshBasicMaterial(transparent=True, depthTest=False, **settings)


def rgb(color: str) -> tuple[float, float, float]:
    """Return a colour ``#rrggbb`` as three numbers from 0 to 1."""
    red, green, blue = (int(color[i : i + 2], 16) / 255.0 for i in (1, 3, 5))
    return red, green, blue


# --- key frames ----------------------------------------------------------------------------------------------------

_KINDS = {"position": "vector3", "quaternion": "quaternion", "scale": "vector3"}


def _animate(clips: dict[Any, Any], group: Any, t: Array, **tracks: Array) -> None:
    """Give a group of the viewer key frames of what changes of it: arrays over the frames (F, ...) by property."""
    from meshcat.animation import AnimationClip, AnimationTrack

    made = {
        name: AnimationTrack(name, _KINDS[name], t.tolist(), values.tolist())
        for name, values in tracks.items()
        if np.abs(values - values[0]).max(initial=0.0) > _CONSTANT * np.abs(values).max(initial=0.0)
    }
    if made:
        clips[group.path] = AnimationClip(tracks=made, fps=1)


def _pose(placement: Array) -> dict[str, Array]:
    """Return position and quaternion of a moving frame (F, 4, 4)."""
    return {"position": placement[:, :3, 3], "quaternion": Rotation.from_matrix(placement[:, :3, :3]).as_quat()}


# --- shapes that meshcat has not ---------------------------------------------------------------------------------


def arrow() -> Mesh:
    """Return an arrow of length 1 along z, with its foot at the origin; 0.22 wide at its head."""
    profile = np.array([[0.0, 0.0], [0.035, 0.0], [0.035, 0.75], [0.11, 0.75], [0.0, 1.0]])
    angle = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(AROUND)], axis=1)
    return _skin(profile[:, :1, None] * circle + profile[:, 1:, None] * [0.0, 0.0, 1.0])


def arc() -> Mesh:
    """Return an arc with a head, of radius 1 about z, from the x axis in the positive sense."""
    along = np.concatenate([[0.0], np.linspace(0.0, _ARC - 0.35, 40), [_ARC - 0.35, _ARC]])
    radius = np.concatenate([[0.0], np.full(40, 0.06), [0.2, 0.0]])[:, None, None]
    out = np.stack([np.cos(along), np.sin(along), np.zeros(len(along))], axis=1)[:, None]
    around = np.linspace(0.0, 2.0 * np.pi, AROUND, endpoint=False)[:, None]
    return _skin(out + radius * (np.cos(around) * out - np.sin(around) * [0.0, 0.0, 1.0]))


def tube(points: Array, radius: float) -> tuple[Array, IntArray, IntArray]:
    """Return a tube along points (N, 3), m: vertices, triangles, and (V,) the index of the point of each vertex.

    Points that coincide with the one before are passed over. Without any length all three are empty.
    """
    step = np.linalg.norm(np.diff(points, axis=0), axis=1)
    kept = np.concatenate([[0], np.flatnonzero(step > 1e-3 * radius) + 1]) if len(points) else np.zeros(0, dtype=int)
    if len(kept) < 2:
        return np.zeros((0, 3)), np.zeros((0, 3), dtype=np.intp), np.zeros(0, dtype=np.intp)
    line = points[kept]
    tangent = np.gradient(line, axis=0)
    tangent /= np.maximum(np.linalg.norm(tangent, axis=1, keepdims=True), 1e-300)
    helper = np.eye(3)[int(np.argmin(np.abs(tangent).max(axis=0)))]  # the direction the path uses least
    first = np.cross(helper, tangent)
    first /= np.maximum(np.linalg.norm(first, axis=1, keepdims=True), 1e-300)
    second = np.cross(tangent, first)
    around = np.linspace(0.0, 2.0 * np.pi, 6, endpoint=False)[:, None]
    rings = line[:, None] + radius * (np.cos(around) * first[:, None] + np.sin(around) * second[:, None])
    return (*_skin(rings), np.repeat(kept, len(around)))


def _skin(rings: Array) -> Mesh:
    """Return the surface through rings (R, a, 3)."""
    count, around = rings.shape[:2]
    ring, here = np.arange(count - 1)[:, None] * around, np.arange(around)[None, :]
    side = (here + 1) % around
    a, b, c, d = ring + here, ring + side, ring + around + here, ring + around + side
    triangles = np.concatenate([np.stack([a, b, c], axis=2), np.stack([b, d, c], axis=2)], axis=1)
    return rings.reshape(-1, 3), triangles.reshape(-1, 3).astype(np.intp)
