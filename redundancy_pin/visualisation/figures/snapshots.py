"""The mechanism at several instants of a motion, in the plane: a moving picture on paper."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.visualisation.figures.style import figure
from redundancy_pin.visualisation.viewer.page import View
from redundancy_pin.visualisation.viewer.scene import (
    MARGIN_COLORS,
    ROLE_COLORS,
    ROLE_NAMES,
    UNKNOWN_COLOR,
    Plate,
    Scene,
    Solid,
    arc_points,
    margin_classes,
    margin_labels,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_FAINTEST = 0.25
"""Opacity of the first instant; the last one is drawn in full."""

_MESH_OPACITY = 0.35
"""Of the outline of a mesh, its convex hull: joints are seen through it."""

_TRACK: dict[str, Any] = {"linestyle": (0, (3, 1.5))}

_PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
_DRAWN_AS_JOINT = {"actuated": "o", "passive": "o", "closure": "D"}


def draw_snapshots(
    view: View | Scene, times: Sequence[float] | int = 5, *, plane: str = "xy", title: str | None = None
) -> Figure:
    """Draw links, tracks, carriers, base and platform at several instants, later ones stronger, over the path.

    Path and platform have the colour of the margin to a singularity.

    Args:
        view: what ``rp.show`` returns, or its scene.
        times: instants from the start of the motion, s, or how many, evenly spread.
        plane: which coordinates are drawn: "xy", "xz" or "yz".
        title: of the figure; the scene's when left out.

    Raises:
        InputError: no view, an unknown plane, or times outside the motion.
        RedundancyPinError: matplotlib is not installed.
    """
    scene = view.scene if isinstance(view, View) else view
    if not isinstance(scene, Scene):
        raise InputError(
            f"snapshots draws a view, not a {type(view).__name__}.", remedy="Pass what rp.show returns: rp.show(plan)."
        )
    if plane not in _PLANES:
        raise InputError(f"The plane is {plane!r}.", remedy=f"Choose one of {', '.join(_PLANES)}.")
    wanted = np.linspace(0.0, scene.duration, times) if isinstance(times, int) else np.asarray(times, dtype=float)
    if not wanted.size or not ((wanted >= 0.0) & (wanted <= scene.duration)).all():
        raise InputError(
            f"The instants are {times}; the motion lasts {scene.duration:.6g} s.",
            remedy="Pass times from the start of the motion, s, or a positive count.",
        )
    frames = [int(np.abs(scene.t - t).argmin()) for t in wanted]
    with figure(6.0, 5.2) as drawn:
        axes = drawn.add_subplot()
        axes.set_title(scene.title if title is None else title)
        for i, frame in enumerate(frames):
            alpha = _FAINTEST + (1.0 - _FAINTEST) * (i + 1) / len(frames)
            draw_frame(axes, scene, frame, plane=plane, alpha=alpha, base=i == 0)
        draw_path(axes, scene, plane=plane)
        label_plane(axes, plane)
        handles = _handles(scene, frames)
        drawn.legend(handles=handles, loc="outside lower center", ncols=min(len(handles), 3), frameon=False)
        return drawn


def draw_frame(
    axes: Axes, scene: Scene, frame: int, *, plane: str = "xy", alpha: float = 1.0, base: bool = True
) -> None:
    """Draw the mechanism at one frame of a scene.

    Args:
        axes: where to.
        scene: the scene.
        frame: number of the frame.
        plane: which coordinates are drawn.
        alpha: opacity.
        base: whether to draw the plate of the base, which is the same in every frame.
    """
    columns = list(_PLANES[plane])
    for item in scene.plates:
        if base or item.body:
            _draw_plate(axes, scene, item, frame, columns, alpha)
    for solid in scene.solids:
        _draw_solid(axes, solid, scene.placement[frame, solid.body] @ solid.placement, columns, alpha)


def draw_path(axes: Axes, scene: Scene, *, plane: str = "xy") -> None:
    """Draw the path of the platform in the colours of the margin."""
    from matplotlib.collections import LineCollection

    points = scene.path[:, list(_PLANES[plane])]
    if len(points) < 2:
        return
    classes = margin_classes(scene.path_margin)
    palette = (*MARGIN_COLORS, UNKNOWN_COLOR)  # −1 is the last
    edges = np.flatnonzero(np.diff(classes)) + 1
    starts, stops = np.concatenate([[0], edges]), np.concatenate([edges + 1, [len(points)]])
    pieces = [points[a:b] for a, b in zip(starts, stops, strict=True)]
    colors = [palette[classes[a]] for a in starts]
    widths = [_width(int(classes[a])) for a in starts]
    axes.add_collection(LineCollection(pieces, colors=colors, linewidths=widths, zorder=4.0))
    axes.plot(*points[0], "o", color="#000000", markersize=4, zorder=4.1)


def label_plane(axes: Axes, plane: str = "xy") -> None:
    """Give both axes their names and the same scale."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel(f"{plane[0]} [m]")
    axes.set_ylabel(f"{plane[1]} [m]")


def _handles(scene: Scene, frames: Sequence[int]) -> list[Any]:
    """Return what the legend says: the kinds of parts there are, and the margins that occur."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    handles: list[Any] = []
    for role in (role for role in ROLE_NAMES if role != "link" and any(solid.role == role for solid in scene.solids)):
        color, name = ROLE_COLORS[role], ROLE_NAMES[role]
        if role in _DRAWN_AS_JOINT:
            face = "#FFFFFF" if role == "passive" else color
            handles.append(Line2D([], [], linestyle="none", marker=_DRAWN_AS_JOINT[role], markerfacecolor=face,
                                  markeredgecolor="#202020", markersize=5.0, label=name))  # fmt: skip
        elif role == "track":
            handles.append(Line2D([], [], color=color, linewidth=1.2, label=name, **_TRACK))
        else:
            handles.append(Patch(facecolor=color, edgecolor="#202020", linewidth=0.5, label=name))
    margins = margin_classes(np.concatenate([scene.path_margin, scene.margin[list(frames)]]))
    for number, (color, name) in enumerate(zip(MARGIN_COLORS, margin_labels(), strict=True)):
        if number in margins:
            handles.append(Line2D([], [], color=color, linewidth=_width(number), label=f"margin {name}"))
    return handles


def _width(number: int) -> float:
    """Return the width of the path in a class of the margin: singular stretches are wider, for print without colour."""
    return 3.4 if number == 0 else 1.6


def _draw_plate(axes: Axes, scene: Scene, item: Plate, frame: int, columns: list[int], alpha: float) -> None:
    place = scene.placement[frame, item.body]
    corners = (item.corners @ place[:3, :3].T + place[:3, 3])[:, columns]
    color, order = ROLE_COLORS[item.role], 0.5
    if item.role == "platform":
        number = int(margin_classes(scene.margin[[frame]])[0])
        color, order = MARGIN_COLORS[number] if number >= 0 else UNKNOWN_COLOR, 2.6
    opacity = alpha if item.role == "platform" else 0.18
    if len(corners) >= 3:
        # with an edge: seen from the side a plate is a line
        axes.fill(*corners.T, facecolor=color, alpha=opacity, edgecolor=color, linewidth=1.6, zorder=order)
    elif len(corners) == 2:
        axes.plot(*corners.T, color=color, alpha=opacity, linewidth=5.0, zorder=order)
    else:
        axes.plot(*corners.T, "o", color=color, alpha=alpha, markersize=8.0, zorder=order)


def _draw_solid(axes: Axes, solid: Solid, place: Array, columns: list[int], alpha: float) -> None:
    style: dict[str, Any] = {"color": solid.color, "alpha": alpha}
    middle = place[:3, 3][columns]
    if solid.role in _DRAWN_AS_JOINT:
        face = "#FFFFFF" if solid.role == "passive" else solid.color
        marker = _DRAWN_AS_JOINT[solid.role]
        axes.plot(*middle, marker, markersize=4.5, markerfacecolor=face, markeredgecolor="#202020", alpha=alpha,
                  markeredgewidth=0.7, zorder=2.8)  # fmt: skip
    elif solid.shape == "box":
        _draw_box(axes, solid, place, columns, style)
    elif solid.shape == "arc":
        points = arc_points(solid) @ place[:3, :3].T + place[:3, 3]
        axes.plot(*points[:, columns].T, linewidth=1.2, zorder=2.2, **_TRACK, **style)
    elif solid.mesh is not None:
        points = (solid.mesh[0] @ place[:3, :3].T + place[:3, 3])[:, columns]
        axes.fill(*_hull(points).T, facecolor=solid.color, alpha=_MESH_OPACITY * alpha, edgecolor="#202020",
                  linewidth=0.5, zorder=1.8)  # fmt: skip
    elif solid.shape == "cylinder":
        radius, length = solid.size
        along = place[:3, 2][columns]
        if np.linalg.norm(along) * length > radius:  # seen end on it is a disc, which the plate stands for
            ends = np.stack([middle - 0.5 * length * along, middle + 0.5 * length * along])
            axes.plot(*ends.T, solid_capstyle="round", linewidth=2.6, zorder=2.0, **style)


def _draw_box(axes: Axes, solid: Solid, place: Array, columns: list[int], style: dict[str, Any]) -> None:
    if solid.role == "track":
        ends = place[:3, 3] + 0.5 * solid.size[2] * np.outer([-1.0, 1.0], place[:3, 2])
        axes.plot(*ends[:, columns].T, linewidth=1.2, zorder=2.2, **_TRACK, **style)
        return
    sides = 0.5 * np.array(solid.size)
    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], dtype=float)
    corners = (signs * sides @ place[:3, :3].T + place[:3, 3])[:, columns]
    axes.fill(*_hull(corners).T, facecolor=solid.color, alpha=style["alpha"], edgecolor="#202020", linewidth=0.5,
              zorder=3.0 if solid.role == "carrier" else 1.8)  # fmt: skip


def _hull(points: Array) -> Array:
    """Return the corners of the convex hull of points (N, 2) in order; the two ends where they lie on a line."""
    from scipy.spatial import ConvexHull

    spread = points - points.mean(axis=0)
    _, size, along = np.linalg.svd(spread, full_matrices=False)
    if size[1] <= 1e-9 * size[0]:
        place = spread @ along[0]
        return points[[int(place.argmin()), int(place.argmax())]]
    hull: Array = points[ConvexHull(points).vertices]
    return hull
