"""Margins over a grid in colour; hatched where there are none."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

COLORS = "viridis"
"""Dark is near a singularity, yellow far from all; neither is white, which nothing reachable is."""

_BRIGHT = 95.0
"""Per cent of the nodes below the top of the colours: a single bright spot does not make all others dark."""

_HATCHES: dict[str, dict[str, Any]] = {
    "out of reach": {"facecolor": "#FFFFFF", "edgecolor": "#C8C8C8", "hatch": "////", "linewidth": 0.0},
    "a joint beyond its limits": {"facecolor": "#E3C9C4", "edgecolor": "#B0675A", "hatch": "....", "linewidth": 0.0},
}


def brightest(size: Array) -> float:
    """Return the margin at the top of the colours."""
    known = size[np.isfinite(size)]
    return max(float(np.percentile(known, _BRIGHT)), 1e-12) if len(known) else 1.0


def shade(axes: Axes, grid: tuple[Array, ...], size: Array, there: tuple[BoolArray, BoolArray], top: float) -> Any:
    """Draw margins (A, B) over a grid in colour; cells without one are hatched and named in the legend.

    ``there`` is where nodes are reachable, and where joints are within their ranges too. Returns the image.
    """
    from matplotlib.patches import Rectangle

    axes.grid(False)
    reachable, in_range = there
    wide = [
        np.concatenate([axis[:1] * 1.5 - axis[1:2] * 0.5, axis, axis[-1:] * 1.5 - axis[-2:-1] * 0.5]) for axis in grid
    ]
    for (name, style), where in zip(_HATCHES.items(), (~reachable, reachable & ~in_range), strict=True):
        if where.any():
            around = np.pad(where.T.astype(float), 1, mode="edge")
            face, hatch = [style["facecolor"]], [style["hatch"]]
            filled = axes.contourf(*wide, around, levels=[0.5, 1.5], colors=face, hatches=hatch)
            filled.set(edgecolor=style["edgecolor"], linewidth=0.0)
            axes.add_patch(Rectangle((0.0, 0.0), 0.0, 0.0, label=name, **style))  # for the legend
    shown = np.ma.masked_where(~in_range, size)
    return axes.pcolormesh(*grid, shown.T, cmap=COLORS, vmin=0.0, vmax=top, shading="nearest", rasterized=True)
