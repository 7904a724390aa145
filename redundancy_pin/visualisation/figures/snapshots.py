"""The mechanism at several instants of a motion, in the plane: a moving picture on paper."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.visualisation.figures.paths import label_plane
from redundancy_pin.visualisation.figures.style import figure, legend_below
from redundancy_pin.visualisation.viewer.page import View
from redundancy_pin.visualisation.viewer.scene import MARGIN_COLORS, UNKNOWN_COLOR, Scene, margin_classes, margin_labels
from redundancy_pin.visualisation.viewer.solids import ROLE_COLORS, ROLE_NAMES, Solid, arc_points, corners_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_FAINTEST = 0.25  # opacity of the first instant; the last one is drawn in full
_BASE_OPACITY = 0.18  # of the base, which is behind everything
_TRACK: dict[str, Any] = {"linestyle": (0, (3, 1.5))}

_COLORS = (*MARGIN_COLORS, UNKNOWN_COLOR)  # of the classes of the margin; class −1, not known, is the last
_WIDTHS = (3.4, *[1.6] * len(MARGIN_COLORS))  # singular stretches are wider, for print without colour
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
        axes = drawn.add_subplot(title=scene.title if title is None else title)
        for i, frame in enumerate(frames):
            alpha = _FAINTEST + (1.0 - _FAINTEST) * (i + 1) / len(frames)
            draw_frame(axes, scene, frame, plane=plane, alpha=alpha, base=i == 0)
        draw_path(axes, scene, plane=plane)
        label_plane(axes, plane)
        legend_below(drawn, _handles(scene, frames))
        return drawn


def draw_frame(
    axes: Axes, scene: Scene, frame: int, *, plane: str = "xy", alpha: float = 1.0, base: bool = True
) -> None:
    """Draw the mechanism at one frame of a scene; the ``base`` is the same in every frame."""
    columns = list(_PLANES[plane])
    platform = _COLORS[margin_classes(scene.margin[[frame]])[0]]
    for solid in scene.solids:
        if solid.role == "platform":
            _draw_solid(axes, replace(solid, color=platform), scene.placement[frame, solid.body], columns, alpha)
        elif base or solid.role != "base":
            _draw_solid(axes, solid, scene.placement[frame, solid.body], columns, alpha)


def draw_path(axes: Axes, scene: Scene, *, plane: str = "xy") -> None:
    """Draw the path of the platform in the colours of the margin."""
    from matplotlib.collections import LineCollection

    points = scene.path[:, list(_PLANES[plane])]
    if len(points) < 2:
        return
    classes = margin_classes(scene.path_margin)
    edges = np.flatnonzero(np.diff(classes)) + 1
    starts, stops = np.concatenate([[0], edges]), np.concatenate([edges + 1, [len(points)]])
    pieces = [points[a:b] for a, b in zip(starts, stops, strict=True)]
    colors, widths = ([table[classes[a]] for a in starts] for table in (_COLORS, _WIDTHS))
    axes.add_collection(LineCollection(pieces, colors=colors, linewidths=widths, zorder=4.0))
    axes.plot(*points[0], "o", color="#000000", markersize=4, zorder=4.1)


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
            handles.append(Line2D([], [], color=color, linewidth=_WIDTHS[number], label=f"margin {name}"))
    return handles


def _draw_solid(axes: Axes, solid: Solid, body: Array, columns: list[int], alpha: float) -> None:
    """Draw a solid of a body that is placed at (4, 4)."""
    place, color = body @ solid.placement, solid.color
    middle = place[:3, 3][columns]
    if solid.role in _DRAWN_AS_JOINT:
        face = "#FFFFFF" if solid.role == "passive" else color
        axes.plot(*middle, _DRAWN_AS_JOINT[solid.role], markersize=4.5, markerfacecolor=face, alpha=alpha,
                  markeredgecolor="#202020", markeredgewidth=0.7, zorder=2.8)  # fmt: skip
    elif solid.role == "track":
        ends = arc_points(solid) if solid.shape == "arc" else 0.5 * solid.size[2] * np.outer([-1.0, 1.0], [0, 0, 1])
        points = (ends @ place[:3, :3].T + place[:3, 3])[:, columns]
        axes.plot(*points.T, color=color, alpha=alpha, linewidth=1.2, zorder=2.2, **_TRACK)
    elif solid.mesh is not None or solid.shape == "box":
        corners = corners_of(solid) @ body[:3, :3].T + body[:3, 3]
        if solid.mesh is not None:
            corners = solid.mesh[0] @ place[:3, :3].T + place[:3, 3]
        style: dict[str, Any] = {"alpha": solid.opacity * alpha, "edgecolor": "#202020", "linewidth": 0.5}
        style["zorder"] = 3.0 if solid.role == "carrier" else 1.8
        if solid.shape == "plate":  # with an edge of its colour: seen from the side it is a line
            opacity, order = (alpha, 2.6) if solid.role == "platform" else (_BASE_OPACITY, 0.5)
            style = {"alpha": opacity, "edgecolor": color, "linewidth": 1.6, "zorder": order}
        axes.fill(*_hull(corners[:, columns]).T, facecolor=color, **style)
    elif solid.shape == "cylinder":
        radius, length = solid.size
        along = place[:3, 2][columns]
        if np.linalg.norm(along) * length > radius:  # seen end on it is a disc, which the plate stands for
            ends = np.stack([middle - 0.5 * length * along, middle + 0.5 * length * along])
            width, opacity, order = (5.0, _BASE_OPACITY, 0.5) if solid.role == "base" else (2.6, alpha, 2.0)
            axes.plot(*ends.T, color=color, alpha=opacity, solid_capstyle="round", linewidth=width, zorder=order)
    elif solid.role == "platform":
        axes.plot(*middle, "o", color=color, alpha=alpha, markersize=8.0, zorder=2.6)


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
