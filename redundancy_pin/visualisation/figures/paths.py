"""Figures in the plane: the path of a motion, the mechanism at several instants, singular curves of the workspace.

What is not flat is seen obliquely ("3d"), with the directions of the axes drawn, or projected on two axes, and said so.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, stretches
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.coordinates import mode_name
from redundancy_pin.singularities.classify import SingularityKind
from redundancy_pin.singularities.crossings import Crossing
from redundancy_pin.singularities.locus import SingularLocus
from redundancy_pin.visualisation.figures.shading import brightest, hatched, shade
from redundancy_pin.visualisation.figures.style import STROKES, Stroke, figure, legend_below
from redundancy_pin.visualisation.figures.time_panels import Background, Windows, condition_panel, draw_panel
from redundancy_pin.visualisation.viewer import mechanism
from redundancy_pin.visualisation.viewer import scene as scenes
from redundancy_pin.visualisation.viewer.page import View
from redundancy_pin.visualisation.viewer.solids import ROLE_COLORS, ROLE_NAMES, Solid, arc_points, corners_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ZOOM_BELOW = 0.3  # A path smaller than this fraction of the mechanism gets a panel of its own
_TRIAD = 0.12  # length of the drawn axes, in widths of the picture


def projection(plane: str) -> Array:
    """Return (2, 3) the matrix from the world to a picture: "xy", "xz", "yz", or "3d", seen obliquely.

    Raises:
        InputError: an unknown plane.
    """
    if plane == "3d":
        towards = np.array(scenes.OBLIQUE) / np.linalg.norm(scenes.OBLIQUE)
        right = np.cross([0.0, 0.0, 1.0], towards)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(towards, right)])
    if plane not in _PLANES:
        raise InputError(f"The plane is {plane!r}.", remedy=f"Choose one of {', '.join((*_PLANES, '3d'))}.")
    matrix: Array = np.eye(3)[list(_PLANES[plane])]
    return matrix


def label_plane(axes: Axes, plane: str = "xy", *, flat: bool = True) -> None:
    """Give both axes their names and the same scale; say what is a projection of something that is not ``flat``."""
    axes.set_aspect("equal", adjustable="datalim")
    if plane == "3d":
        _draw_triad(axes)
        return
    axes.set(xlabel=f"{plane[0]} [m]", ylabel=f"{plane[1]} [m]")
    if not flat:
        _add_title(axes, f"projection on {plane[0]}, {plane[1]}")


def _add_title(axes: Axes, text: str) -> None:
    title = axes.get_title()
    axes.set_title(f"{title}, {text}" if title else text)


def _draw_triad(axes: Axes) -> None:
    """Draw the directions of the world's axes in a corner, with their length, in place of ticks."""
    axes.set(xticks=[], yticks=[])
    axes.grid(False)
    axes.spines[:].set_visible(False)
    axes.autoscale_view()
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    wide = _TRIAD * max(right - left, top - bottom)
    step = 10.0 ** np.floor(np.log10(wide))
    length = step * max(factor for factor in (1.0, 2.0, 5.0) if factor * step <= wide)
    foot = np.array([left + length, bottom - 1.2 * length])  # below everything else
    axes.update_datalim([foot - [length, 0.8 * length]])
    axes.autoscale_view()
    for name, tip in zip("xyz", length * projection("3d").T, strict=True):
        arrow = {"arrowstyle": "-|>", "color": "#444444", "mutation_scale": 8, "shrinkA": 0, "shrinkB": 0}
        axes.annotate("", xy=tuple(foot + tip), xytext=tuple(foot), arrowprops=arrow)
        axes.annotate(name, xy=tuple(foot + 1.25 * tip), ha="center", va="center", fontsize=8)
    axes.annotate(f"axes: {length:g} m", xy=(0.01, 0.005), xycoords="axes fraction", fontsize=7.5, color="#444444")


def draw_mechanism(axes: Axes, lines: Sequence[Array], hinges: Array | None) -> None:
    """Draw lines (2, 2) and base hinges (h, 2), m, in grey."""
    for line in lines:
        axes.plot(*line.T, "-o", color="#8C8C8C", linewidth=2.2, markersize=3.5, zorder=1.8)
    if hinges is not None:
        axes.plot(*hinges.T, "^", color="#000000", markersize=7, zorder=2.1, label="base hinge")


def _draw_path(axes: Axes, point: Array, stroke: Stroke, label: str, start_label: str | None = None) -> None:
    """Draw a path (N, 2) with its start and an arrow in its sense, a fifth of its length from there."""
    x, y = point.T
    axes.plot(x, y, color=stroke.color, linestyle=stroke.dash, linewidth=1.7, label=label, zorder=2.2)
    axes.plot(x[0], y[0], "o", color=stroke.color, markersize=6, zorder=2.3, label=start_label)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    tail, head = np.searchsorted(length, [0.22 * length[-1], 0.24 * length[-1]])
    arrow = {"arrowstyle": "-|>", "color": stroke.color, "mutation_scale": 14}
    axes.annotate("", xy=(x[head], y[head]), xytext=(x[tail], y[tail]), arrowprops=arrow)


def _draw_singular(axes: Axes, points: Sequence[ArrayLike], color: str, label: str = "singular") -> None:
    if len(points):
        axes.plot(*np.array(points).T, "x", color=color, markersize=9, markeredgewidth=2, zorder=3.1, label=label)


def plot_path(
    title: str,
    t: Array,
    point: Array,
    mechanism: Sequence[Array],
    hinges: Array,
    condition: Array,
    *,
    thresholds: Sequence[float] = (),
    windows: Windows = (),
    instants: Sequence[float] = (),
    singular_points: Sequence[ArrayLike] = (),
) -> Figure:
    """Draw the mechanism with the path, the path enlarged where it is small, and the condition number over time.

    All of it in the base frame, m: the path ``point`` (N, 2) in x and y, or (N, 3), the lines (2, 2) or (2, 3) of the
    mechanism at the start, the ``hinges`` (h, 2) or (h, 3) on the base, and where the path meets singularities, (2,) or
    (3,) each. ``condition`` (N,) is infinite at a singularity. What has three coordinates is seen obliquely, its path
    in a panel of its own as a projection on x and y.
    """
    everything, spatial = np.concatenate([point, hinges, *mechanism]), point.shape[1] == 3
    zoomed = spatial or np.ptp(point, axis=0).max() < _ZOOM_BELOW * np.ptp(everything, axis=0).max()
    ratios = [1.0, 1.0, 1.4] if zoomed else [1.0, 1.4]
    with figure(10.0 if zoomed else 8.0, 3.6, title) as drawn:
        *panels, last = drawn.subplots(1, len(ratios), width_ratios=ratios)
        views = ("3d", "xy") if spatial else ("xy", "xy")
        seen = [projection(view)[:, : point.shape[1]].T for view in views]
        draw_mechanism(panels[0], [line @ seen[0] for line in mechanism], hinges @ seen[0])
        for axes, title, view, matrix in zip(panels, ("mechanism at the start", "path"), views, seen, strict=False):
            _draw_path(axes, point @ matrix, STROKES[0], "path", "start")
            _draw_singular(axes, [np.asarray(place) @ matrix for place in singular_points], STROKES[1].color)
            axes.set_title(title)
            label_plane(axes, view, flat=not spatial)
        panel = condition_panel(t, condition, thresholds, singular=bool(instants))
        draw_panel(last, panel, 1.4 * drawn.get_figwidth() / sum(ratios) - 0.8)
        background = Background(instants=instants, windows=windows)
        background.draw(last)
        last.set(xlim=(t[0], t[-1]), xlabel="time t [s]")
        handles = panels[0].get_legend_handles_labels()[0]
        legend_below(drawn, [*handles, *background.handles(drawn)])
        return drawn


def plot_plane_paths(
    title: str,
    paths: Mapping[str, Array],
    *,
    mechanism: Sequence[Array] = (),
    hinges: Array | None = None,
    singular: Sequence[ArrayLike] = (),
) -> Figure:
    """Draw paths (N, 2), m, by their label, with start, direction, mechanism and hinges, and singular points."""
    with figure(6.0, 5.2) as drawn:
        axes = drawn.add_subplot(title=title)
        draw_mechanism(axes, mechanism, hinges)
        for stroke, (label, point) in zip(STROKES, paths.items(), strict=False):
            _draw_path(axes, point, stroke, label)
        _draw_singular(axes, singular, "#000000")
        label_plane(axes)
        legend_below(drawn, axes.get_legend_handles_labels()[0])
        return drawn


_LOCUS_STROKES: dict[SingularityKind, dict[str, Any]] = {
    SingularityKind.TYPE_II: {"color": "#D55E00", "linewidth": 2.0, "linestyle": "-", "label": "type II (parallel)"},
    SingularityKind.TYPE_I: {"color": "#000000", "linewidth": 1.4, "linestyle": (0, (5, 2)),
                             "label": "type I (serial), border of the working mode"},
    SingularityKind.COMBINED: {"color": "#000000", "linewidth": 2.0, "linestyle": "-.", "label": "combined"},
}  # fmt: skip


def draw_locus(locus: SingularLocus, *, motion: Array | None = None, crossings: Sequence[Crossing] = ()) -> Figure:
    """Draw a singular locus: type I and type II curves over the margin, readable in black and white.

    The colour is the distance to type II (smallest singular value of the scaled W): darker is nearer; hatched is out of
    reach in this working mode. A robot with a single coordinate gets its margins as curves.

    Args:
        locus: from ``singular_locus``.
        motion: (N, n) platform coordinates of a motion to draw over it, base frame, m and rad.
        crossings: singularities along that motion, to mark.

    Raises:
        InputError: something else than a locus.
    """
    if not isinstance(locus, SingularLocus):
        raise InputError(
            f"locus draws a singular locus, not a {type(locus).__name__}.",
            remedy="Pass what rp.singular_locus(robot) returns.",
        )
    mode = [f"working mode {mode_name(locus.robot.working_mode)}"] if locus.robot.working_mode else []
    fixed = [f"{name} = {round(value, 6) + 0.0:g} rad" for name, value in locus.fixed.items()]
    plane = len(locus.axes) == 2
    with figure(7.0, 5.6 if plane else 4.0) as drawn:
        axes = drawn.add_subplot(title=", ".join([f"Singularities of {locus.robot.name}", *mode, *fixed]))
        if plane:
            _draw_plane(drawn, axes, locus)
            if motion is not None:
                axes.plot(*motion[:, list(locus.free)].T, color="#0072B2", zorder=2.6, label="motion")
            places = [crossing.x[list(locus.free)] for crossing in crossings]
            _draw_singular(axes, places, "#0072B2", "singular instant")
        else:
            _draw_line(axes, locus)
        out = hatched(locus.reachable, locus.reachable) if plane else []
        legend_below(drawn, [*axes.get_legend_handles_labels()[0], *out])
        return drawn


def _draw_plane(drawn: Figure, axes: Axes, locus: SingularLocus) -> None:
    size, there = np.abs(locus.margin), (locus.reachable, locus.reachable)
    image = shade(axes, locus.axes, size, there, brightest(size))
    bar = drawn.colorbar(image, ax=axes, shrink=0.8, extend="max")
    bar.set_label("margin to type II: smallest scaled singular value of W [–]")
    spatial = ["xyz".index(name) for name in locus.names]  # which of the world's axes the picture has
    for ends in mechanism.links(locus.robot, locus.q_reference):
        axes.plot(*np.stack(ends)[:, spatial].T, "-o", color="#5A5A5A", linewidth=1.6, markersize=3.5, zorder=2.0)
    named: set[SingularityKind] = set()
    for curve in locus.curves:
        style = _LOCUS_STROKES[curve.kind] | ({"label": None} if curve.kind in named else {})
        named.add(curve.kind)
        axes.plot(*curve.points[:, list(locus.free)].T, zorder=2.5, **style)
    axes.plot(*mechanism.base_hinges(locus.robot)[:, spatial].T, "^", color="#000000", markersize=8, zorder=3.0,
              label="base hinge")  # fmt: skip
    home = locus.reference[list(locus.free)]
    axes.plot(*home, "D", color="#0072B2", markersize=6, zorder=3.0, label="reference")
    axes.set_aspect("equal", adjustable="box")
    x, y = (f"{name} [{unit}]" for name, unit in zip(locus.names, locus.units, strict=True))
    axes.set(xlabel=x, ylabel=y)


def _draw_line(axes: Axes, locus: SingularLocus) -> None:
    (coordinate,) = locus.axes
    axes.plot(coordinate, locus.serial_margin, color="#000000", linestyle=(0, (5, 2)), label="margin to type I")
    axes.plot(coordinate, np.abs(locus.margin), color="#D55E00", linestyle="-", label="margin to type II")
    for curve in locus.curves:
        place = float(curve.points[0, 0])
        label = f"{curve.kind.label.replace('_', ' ')} at {place:.6g}"
        axes.axvline(place, color="#000000", linewidth=1.0, linestyle=":", label=label)
    axes.plot(locus.reference[0], 0.0, "D", color="#0072B2", markersize=6, clip_on=False, label="reference")
    axes.set_ylim(bottom=0.0)
    axes.set(xlabel=f"{locus.names[0]} [{locus.units[0]}]", ylabel="smallest scaled singular value [–]")


def scene_in(view: object) -> scenes.Scene:
    """Return the scene of a view, or a scene as it is."""
    scene = view.scene if isinstance(view, View) else view
    if not isinstance(scene, scenes.Scene):
        message = f"A view can be drawn, not a {type(view).__name__}."
        raise InputError(message, remedy="Pass what rp.show returns: rp.show(plan).")
    return scene


# --- snapshots: a moving picture on paper ---------------------------------------------------------------------------

_FAINTEST = 0.25  # opacity of the first instant; the last one is drawn in full
_BASE_OPACITY = 0.18  # of the base, which is behind everything
_TRACK: dict[str, Any] = {"linestyle": (0, (3, 1.5))}

_COLORS = (
    *scenes.MARGIN_COLORS,
    scenes.UNKNOWN_COLOR,
)  # of the classes of the margin; class −1, not known, is the last
_WIDTHS = (3.4, *[1.6] * len(scenes.MARGIN_COLORS))  # singular stretches are wider, for print without colour
_PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}
_DRAWN_AS_JOINT = {"actuated": "o", "passive": "o", "closure": "D"}


def draw_snapshots(
    view: View | scenes.Scene, times: Sequence[float] | int = 5, *, plane: str = "xy", title: str | None = None
) -> Figure:
    """Draw links, tracks, carriers, base and platform at several instants, later ones stronger, over the path.

    Path and platform have the colour of the margin to a singularity.

    Args:
        view: what ``rp.show`` returns, or its scene.
        times: instants from the start of the motion, s, or how many, evenly spread.
        plane: which coordinates are drawn: "xy", "xz" or "yz", said to be a projection of what is not flat; or
            "3d", seen obliquely.
        title: of the figure; the scene's when left out.

    Raises:
        InputError: no view, an unknown plane, or times outside the motion.
    """
    scene = scene_in(view)
    projection(plane)  # refused before anything is drawn
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
        label_plane(axes, plane, flat=scene.is_flat)
        legend_below(drawn, scene_handles(scene, frames))
        return drawn


def fitting_plane(scene: scenes.Scene) -> str:
    """Return the plane that shows a scene: "xy" where it is flat, else "3d"."""
    return "xy" if scene.is_flat else "3d"


def draw_frame(
    axes: Axes, scene: scenes.Scene, frame: int, *, plane: str = "xy", alpha: float = 1.0, base: bool = True
) -> None:
    """Draw the mechanism at one frame of a scene; the ``base`` is the same in every frame."""
    matrix = projection(plane)
    platform = _COLORS[scenes.margin_classes(scene.margin[[frame]])[0]]
    for solid in scene.solids:
        if solid.role == "platform":
            _draw_solid(axes, replace(solid, color=platform), scene.placement[frame, solid.body], matrix, alpha)
        elif base or solid.role != "base":
            _draw_solid(axes, solid, scene.placement[frame, solid.body], matrix, alpha)


def draw_path(axes: Axes, scene: scenes.Scene, *, plane: str = "xy") -> None:
    """Draw the path of the platform in the colours of the margin."""
    from matplotlib.collections import LineCollection

    points = scene.path @ projection(plane).T
    if len(points) < 2:
        return
    classes = scenes.margin_classes(scene.path_margin)
    parts = stretches(classes)
    pieces = [points[a : b + 1] for a, b in parts]  # each up to where the next one begins
    colors, widths = [_COLORS[classes[a]] for a, _ in parts], [_WIDTHS[classes[a]] for a, _ in parts]
    # white about it: seen on a platform of its colour
    axes.add_collection(LineCollection([points], colors=["#FFFFFF"], linewidths=[max(widths) + 2.0], zorder=3.9))
    axes.add_collection(LineCollection(pieces, colors=colors, linewidths=widths, zorder=4.0))
    axes.plot(*points[0], "o", color="#000000", markersize=4, zorder=4.1)


def scene_handles(scene: scenes.Scene, frames: Sequence[int]) -> list[Any]:
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
    margins = scenes.margin_classes(np.concatenate([scene.path_margin, scene.margin[list(frames)]]))
    for number, (color, name) in enumerate(zip(scenes.MARGIN_COLORS, scenes.margin_labels(), strict=True)):
        if number in margins:
            handles.append(Line2D([], [], color=color, linewidth=_WIDTHS[number], label=f"margin {name}"))
    return handles


def _draw_solid(axes: Axes, solid: Solid, body: Array, matrix: Array, alpha: float) -> None:
    """Draw a solid of a body that is placed at (4, 4), by a projection (2, 3)."""
    place, color = body @ solid.placement, solid.color
    middle = matrix @ place[:3, 3]
    if solid.role in _DRAWN_AS_JOINT:
        face = "#FFFFFF" if solid.role == "passive" else color
        axes.plot(*middle, _DRAWN_AS_JOINT[solid.role], markersize=4.5, markerfacecolor=face, alpha=alpha,
                  markeredgecolor="#202020", markeredgewidth=0.7, zorder=2.8)  # fmt: skip
    elif solid.role == "track":
        ends = arc_points(solid) if solid.shape == "arc" else 0.5 * solid.size[2] * np.outer([-1.0, 1.0], [0, 0, 1])
        points = (ends @ place[:3, :3].T + place[:3, 3]) @ matrix.T
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
        axes.fill(*_hull(corners @ matrix.T).T, facecolor=color, **style)
    elif solid.shape == "cylinder":
        radius, length = solid.size
        along = matrix @ place[:3, 2]
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
