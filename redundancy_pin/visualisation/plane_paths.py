"""Paths in the plane, with the mechanism at the start where it helps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.visualisation.style import STROKES, figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class PlanePath:
    """One path.

    Attributes:
        label: in the legend.
        point: (N, 2) m.
    """

    label: str
    point: Array


def plot_plane_paths(
    title: str,
    paths: Sequence[PlanePath],
    *,
    links: Sequence[Array] = (),
    hinges: Array | None = None,
    singular: Sequence[tuple[float, float]] = (),
) -> Figure:
    """Draw paths with their start, their direction, and singular points.

    Args:
        title: of the figure.
        paths: what to draw.
        links: lines (2, 2) of the mechanism, m; none where left out.
        hinges: (h, 2) hinges on the base, m.
        singular: where the path is singular, m.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    with figure(6.0, 5.2) as drawn:
        axes = drawn.add_subplot()
        axes.set_title(title)
        for link in links:
            axes.plot(link[:, 0], link[:, 1], "-o", color="#8C8C8C", linewidth=2.2, markersize=3.5, zorder=1.8)
        if hinges is not None:
            axes.plot(hinges[:, 0], hinges[:, 1], "^", color="#000000", markersize=8, zorder=2.1, label="base hinge")
        for stroke, path in zip(STROKES, paths, strict=False):
            x, y = path.point.T
            axes.plot(x, y, color=stroke.color, linestyle=stroke.dash, linewidth=1.7, label=path.label, zorder=2.2)
            axes.plot(x[0], y[0], "o", color=stroke.color, markersize=6, zorder=2.3)
            length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
            at, to = np.searchsorted(length, [0.22 * length[-1], 0.24 * length[-1]])
            axes.annotate(
                "",
                xy=(x[to], y[to]),
                xytext=(x[at], y[at]),
                arrowprops={"arrowstyle": "-|>", "color": stroke.color, "mutation_scale": 15},
            )
        if singular:
            places = np.array(singular)
            axes.plot(places[:, 0], places[:, 1], "x", color="#000000", markersize=9, markeredgewidth=2,
                      label="singular", zorder=2.4)  # fmt: skip
        axes.set_aspect("equal", adjustable="datalim")
        axes.set_xlabel("x [m]")
        axes.set_ylabel("y [m]")
        axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=4, frameon=False)
        return drawn
