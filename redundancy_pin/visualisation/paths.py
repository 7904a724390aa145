"""Where a motion goes: the mechanism at its start, the path, and the condition number along it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.visualisation.style import STROKES, figure, mark_singular

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LARGEST_CONDITION = 1e3
"""Top of the condition axis: beyond it the curve is a spike whose height is that of the sampling."""

_ZOOM_BELOW = 0.3
"""A path smaller than this fraction of the mechanism gets a panel of its own."""


@dataclass(frozen=True, eq=False)
class PathCurves:
    """What the plot shows, all in the plane of the base frame's x and y.

    Attributes:
        title: of the figure.
        t: (N,) time, s.
        point: (N, 2) path of the platform, m.
        links: lines (2, 2) between the hinges of the mechanism at the start, m.
        hinges: (h, 2) hinges on the base, m.
        condition: (N,) condition number of the scaled Jacobian; infinite at a singularity.
        thresholds: condition numbers to mark.
        windows: near-singular time intervals, s.
        instants: singular instants, s.
        singular_points: (c, 2) where the path meets singularities, m.
    """

    title: str
    t: Array
    point: Array
    links: tuple[Array, ...]
    hinges: Array
    condition: Array
    thresholds: tuple[float, ...] = ()
    windows: tuple[tuple[float, float], ...] = ()
    instants: tuple[float, ...] = ()
    singular_points: tuple[tuple[float, float], ...] = ()


def plot_path(curves: PathCurves) -> Figure:
    """Draw the mechanism with the path, the path enlarged where it is small, and the condition number over time.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    everything = np.concatenate([curves.point, curves.hinges, *curves.links])
    zoomed = np.ptp(curves.point, axis=0).max() < _ZOOM_BELOW * np.ptp(everything, axis=0).max()
    ratios = [1.0, 1.0, 1.4] if zoomed else [1.0, 1.4]
    with figure(10.0 if zoomed else 8.0, 3.6) as drawn:
        panels = drawn.subplots(1, len(ratios), width_ratios=ratios)
        drawn.suptitle(curves.title, fontsize=10.5)
        _draw_mechanism(panels[0], curves, with_start=not zoomed)
        if zoomed:
            _draw_path(panels[1], curves, with_start=True)
            _label(panels[1])
            panels[1].set_title("path")
        _draw_condition(panels[-1], curves)
        return drawn


def _draw_mechanism(axes: Axes, curves: PathCurves, *, with_start: bool) -> None:
    for links in curves.links:
        axes.plot(links[:, 0], links[:, 1], color="#8C8C8C", linewidth=2.2, solid_capstyle="round", zorder=1.8)
        axes.plot(links[:, 0], links[:, 1], "o", color="#8C8C8C", markersize=3.5, zorder=1.9)
    axes.plot(
        curves.hinges[:, 0], curves.hinges[:, 1], "^", color="#000000", markersize=7, zorder=2.1, label="base hinge"
    )
    _draw_path(axes, curves, with_start=with_start)
    _label(axes)
    axes.set_title("mechanism at the start")


def _draw_path(axes: Axes, curves: PathCurves, *, with_start: bool) -> None:
    x, y = curves.point.T
    axes.plot(x, y, color=STROKES[0].color, linewidth=1.6, label="path", zorder=2.0)
    if with_start:
        middle = len(x) // 8
        axes.annotate(
            "",
            xy=(x[middle + len(x) // 40], y[middle + len(x) // 40]),
            xytext=(x[middle], y[middle]),
            arrowprops={"arrowstyle": "-|>", "color": STROKES[0].color, "mutation_scale": 13},
        )
        axes.plot(x[0], y[0], "o", color=STROKES[0].color, markersize=6, label="start", zorder=2.3)
    if curves.singular_points:
        places = np.array(curves.singular_points)
        axes.plot(
            places[:, 0],
            places[:, 1],
            "x",
            color=STROKES[1].color,
            markersize=8,
            markeredgewidth=2,
            zorder=2.4,
            label="singular",
        )
    if with_start:
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.2), ncols=4, frameon=False, columnspacing=1.0)


def _label(axes: Axes) -> None:
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")


def _draw_condition(axes: Axes, curves: PathCurves) -> None:
    shown = np.minimum(curves.condition, 2.0 * _LARGEST_CONDITION)
    axes.plot(curves.t, shown, color="#000000", linewidth=1.3)
    mark_singular(axes, curves.windows, curves.instants, label=True)
    for i, threshold in enumerate(curves.thresholds):
        stroke = STROKES[1 + i % (len(STROKES) - 1)]
        axes.axhline(
            threshold, color=stroke.color, linestyle=stroke.dash, linewidth=1.0, label=f"threshold {threshold:g}"
        )
    singular = bool(curves.instants)
    if singular:
        axes.set_yscale("log")
        axes.set_ylim(1.0, _LARGEST_CONDITION)
    else:
        axes.set_ylim(1.0, 1.0 + 1.4 * (float(np.nanmax(shown)) - 1.0))
    axes.set_xlim(curves.t[0], curves.t[-1])
    axes.set_xlabel("time t [s]")
    axes.set_ylabel("condition number [–]")
    axes.set_title("condition number (scaled)")
    if singular or curves.thresholds:
        axes.legend(loc="upper right")
