"""Figures in the plane: where a motion goes, with its condition number, and the singular curves over the workspace."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.modes import mode_name
from redundancy_pin.singularities.classify import SingularityKind
from redundancy_pin.singularities.crossings import Crossing
from redundancy_pin.singularities.locus import SingularLocus
from redundancy_pin.visualisation.figures.style import STROKES, Stroke, figure, legend_below
from redundancy_pin.visualisation.figures.time_panels import Background, Windows, condition_panel, draw_panel
from redundancy_pin.visualisation.viewer.parts import base_hinges, links

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ZOOM_BELOW = 0.3  # A path smaller than this fraction of the mechanism gets a panel of its own


def label_plane(axes: Axes, plane: str = "xy") -> None:
    """Give both axes their names and the same scale."""
    axes.set_aspect("equal", adjustable="datalim")
    axes.set(xlabel=f"{plane[0]} [m]", ylabel=f"{plane[1]} [m]")


def _draw_mechanism(axes: Axes, lines: Sequence[Array], hinges: Array | None) -> None:
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

    All of it in the plane of the base frame's x and y, m.

    Args:
        title: of the figure.
        t: (N,) time, s.
        point: (N, 2) path of the platform.
        mechanism: lines (2, 2) between the hinges at the start.
        hinges: (h, 2) hinges on the base.
        condition: (N,) condition number of the scaled Jacobian; infinite at a singularity.
        thresholds: condition numbers to mark.
        windows: near-singular time intervals, s.
        instants: singular instants, s.
        singular_points: (2,) each, where the path meets singularities.
    """
    everything = np.concatenate([point, hinges, *mechanism])
    zoomed = np.ptp(point, axis=0).max() < _ZOOM_BELOW * np.ptp(everything, axis=0).max()
    ratios = [1.0, 1.0, 1.4] if zoomed else [1.0, 1.4]
    with figure(10.0 if zoomed else 8.0, 3.6, title) as drawn:
        *planes, last = drawn.subplots(1, len(ratios), width_ratios=ratios)
        _draw_mechanism(planes[0], mechanism, hinges)
        for axes, title in zip(planes, ("mechanism at the start", "path"), strict=False):
            _draw_path(axes, point, STROKES[0], "path", "start")
            _draw_singular(axes, singular_points, STROKES[1].color)
            label_plane(axes)
            axes.set_title(title)
        panel = condition_panel(t, condition, thresholds, singular=bool(instants))
        draw_panel(last, panel, 1.4 * drawn.get_figwidth() / sum(ratios) - 0.8)
        background = Background(instants=instants, windows=windows)
        background.draw(last)
        last.set(xlim=(t[0], t[-1]), xlabel="time t [s]")
        handles = planes[0].get_legend_handles_labels()[0]
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
        _draw_mechanism(axes, mechanism, hinges)
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

    The shade is the distance to type II (smallest singular value of the scaled W): darker is nearer; white is out of
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
        legend_below(drawn, axes.get_legend_handles_labels()[0])
        return drawn


def _draw_plane(drawn: Figure, axes: Axes, locus: SingularLocus) -> None:
    axes.grid(False)
    shade = np.ma.masked_invalid(np.abs(locus.margin.T))
    # no part of the map is black or white: curves stand out from it, and so does what is out of reach
    top = float(shade.max())
    image = axes.pcolormesh(
        *locus.axes, shade, cmap="Greys_r", vmin=-0.6 * top, vmax=1.1 * top, shading="nearest", rasterized=True
    )
    bar = drawn.colorbar(image, ax=axes, shrink=0.8)
    bar.ax.set_ylim(0.0, top)
    bar.set_label("margin to type II: smallest scaled singular value of W [–]")
    spatial = ["xyz".index(name) for name in locus.names]  # which of the world's axes the picture has
    for ends in links(locus.robot, locus.q_reference):
        axes.plot(*np.stack(ends)[:, spatial].T, "-o", color="#5A5A5A", linewidth=1.6, markersize=3.5, zorder=2.0)
    named: set[SingularityKind] = set()
    for curve in locus.curves:
        style = _LOCUS_STROKES[curve.kind] | ({"label": None} if curve.kind in named else {})
        named.add(curve.kind)
        axes.plot(*curve.points[:, list(locus.free)].T, zorder=2.5, **style)
    axes.plot(*base_hinges(locus.robot)[:, spatial].T, "^", color="#000000", markersize=8, zorder=3.0,
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
