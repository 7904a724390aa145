"""A feasibility map: what can be done coloured by effort, what cannot hatched and lettered, the border between them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.status import ResultStatus
from redundancy_pin.visualisation.figures.style import figure, legend_below, log_scale, write_numbers

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.colors import Normalize
    from matplotlib.figure import Figure


Scale = Literal["linear", "log"]

_COLORS = "cividis"  # lightness rises evenly, so that it reads in grey too
_DECADES = 30.0  # largest over smallest effort from which on colours are logarithmic
_HATCHES: Mapping[ResultStatus, tuple[str, str]] = {
    ResultStatus.INFEASIBLE: ("////", "#BDBDBD"),
    ResultStatus.UNRESOLVED: ("....", "#8C8C8C"),
}
_RING: dict[str, Any] = {
    "linestyle": "none", "marker": "o", "markerfacecolor": "#FFFFFF", "markeredgecolor": "#000000"
}  # fmt: skip
"""Of a plan whose optimiser did not converge."""

_LARGEST, _SMALLEST = 9.0, 4.5  # size of the letters, points: as the tiles allow; below the smallest there is none


@dataclass(frozen=True)
class Tile:
    """A rectangle of the map around one cell."""

    x0: float
    x1: float
    y0: float
    y1: float
    kind: ResultStatus
    value: float | None = None  # peak effort, for the colour; None without a plan
    mark: str = ""  # letter of the limit that is in the way

    @property
    def possible(self) -> bool:
        """Whether there is a plan that keeps every limit."""
        return self.kind in (ResultStatus.OK, ResultStatus.NOT_CONVERGED)


def plot_feasibility(
    title: str,
    panels: Mapping[str, Sequence[Tile]],
    *,
    x: str,
    y: str,
    value: str,
    marks: Mapping[str, str],
    x_scale: Scale = "linear",
    y_scale: Scale = "linear",
) -> Figure:
    """Draw the maps of several planners side by side, readable without colour.

    Tiles with a plan are coloured by effort; a ring says that the optimiser did not converge. Tiles without a plan are
    hatched and carry the letter of the limit in the way, unresolved ones are dotted with a question mark. A thick line
    is the border between possible and not possible, a dashed one that of the other planner (only with two of them).

    ``panels`` are by their titles; ``x``, ``y`` and ``value`` label the axes and the colours; ``marks`` says what each
    letter stands for.
    """
    borders = [border_of(tiles) for tiles in panels.values()]
    with figure(1.4 + 4.3 * len(panels), 5.4, title) as drawn:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LogNorm

        axes = list(drawn.subplots(1, len(panels), sharex=True, sharey=True, squeeze=False)[0])
        norm = _norm([tile.value for tiles in panels.values() for tile in tiles if tile.possible])
        for i, ((name, tiles), on) in enumerate(zip(panels.items(), axes, strict=True)):
            on.set(title=name, xlabel=x)
            if x_scale == "log":
                log_scale(on, "x")
            if y_scale == "log":
                log_scale(on)
            on.set_xlim(min(tile.x0 for tile in tiles), max(tile.x1 for tile in tiles))
            on.set_ylim(min(tile.y0 for tile in tiles), max(tile.y1 for tile in tiles))
            on.grid(False)
            _draw_tiles(on, tiles, norm)
            if len(panels) == 2:
                _draw_border(on, borders[1 - i], own=False)
            _draw_border(on, borders[i], own=True)
        axes[0].set_ylabel(y)
        if norm is not None:
            bar = drawn.colorbar(ScalarMappable(norm, _COLORS), ax=axes, label=value, fraction=0.04, pad=0.02)
            if isinstance(norm, LogNorm):
                write_numbers(bar.ax.yaxis)
        # letters need to know how large the tiles have become
        drawn.draw_without_rendering()
        for tiles, on in zip(panels.values(), axes, strict=True):
            _draw_marks(on, tiles)
        _legend(drawn, list(panels.values()), marks, any(len(segments) for segments in borders))
        return drawn


def border_of(tiles: Sequence[Tile]) -> Array:
    """Return (S, 2, 2) segments, start and end (x, y), where tiles with and without a plan meet.

    Tiles do not overlap, and neighbours share their edges exactly.
    """
    one = [tile for tile in tiles if tile.possible]
    other = [tile for tile in tiles if tile.kind == ResultStatus.INFEASIBLE]
    if not (one and other):
        return np.empty((0, 2, 2))
    ax0, ax1, ay0, ay1 = (np.array([getattr(tile, name) for tile in one]) for name in ("x0", "x1", "y0", "y1"))
    bx0, bx1, by0, by1 = (np.array([getattr(tile, name) for tile in other]) for name in ("x0", "x1", "y0", "y1"))
    along_y, along_x = (ay0, ay1, by0, by1), (ax0, ax1, bx0, bx1)
    segments = [np.empty((0, 2, 2))]
    for edge, beside, (a0, a1, b0, b1), axis in (
        (ax1, bx0, along_y, 0), (ax0, bx1, along_y, 0), (ay1, by0, along_x, 1), (ay0, by1, along_x, 1)
    ):  # fmt: skip
        for place in np.intersect1d(edge, beside):  # all tiles with all others would be too many
            i, j = np.flatnonzero(edge == place), np.flatnonzero(beside == place)
            low, high = np.maximum(a0[i, None], b0[None, j]), np.minimum(a1[i, None], b1[None, j])
            shared = low < high
            ends = [np.stack([np.full(shared.sum(), place), end[shared]], axis=-1) for end in (low, high)]
            segments.append(np.stack(ends, axis=1)[..., :: -1 if axis else 1])
    return np.concatenate(segments)


def _norm(values: Sequence[float | None]) -> Normalize | None:
    from matplotlib.colors import LogNorm, Normalize

    known = [value for value in values if value is not None and value > 0.0]
    if not known:
        return None
    least, most = min(known), max(known)
    if most > _DECADES * least:
        return LogNorm(least, most)
    return Normalize(0.0, most)


def _draw_tiles(axes: Axes, tiles: Sequence[Tile], norm: Normalize | None) -> None:
    import matplotlib
    from matplotlib.collections import PolyCollection

    colors = matplotlib.colormaps[_COLORS]
    for kind in (ResultStatus.OK, ResultStatus.NOT_CONVERGED, ResultStatus.INFEASIBLE, ResultStatus.UNRESOLVED):
        chosen = [tile for tile in tiles if tile.kind == kind]
        if not chosen:
            continue
        corners = [[(t.x0, t.y0), (t.x1, t.y0), (t.x1, t.y1), (t.x0, t.y1)] for t in chosen]
        if kind in _HATCHES:
            hatch, grey = _HATCHES[kind]
            style: dict[str, Any] = {"facecolor": "#FFFFFF", "edgecolor": grey, "hatch": hatch, "linewidth": 0.3}
        else:
            fill = [colors(norm(t.value)) if norm is not None and t.value else "#FFFFFF" for t in chosen]
            style = {"facecolor": fill, "edgecolor": "none", "linewidth": 0.0}
        axes.add_collection(PolyCollection(corners, zorder=1.0, **style))
        if kind == ResultStatus.NOT_CONVERGED:
            centres = np.array([_centre(axes, tile) for tile in chosen])
            axes.plot(*centres.T, markersize=5, zorder=3.0, **_RING)


def _draw_border(axes: Axes, segments: Array, *, own: bool) -> None:
    from matplotlib.collections import LineCollection

    if not len(segments):
        return
    for color, width in (("#FFFFFF", 4.2), ("#000000", 2.4)) if own else (("#FFFFFF", 2.2), ("#000000", 1.1)):
        dashed = not own and color == "#000000"
        lines = LineCollection(list(segments), colors=color, linewidths=width, zorder=2.2 if own else 2.0)
        lines.set(linestyle=(0, (4, 2)) if dashed else "solid", capstyle="butt" if dashed else "projecting")
        axes.add_collection(lines)


def _draw_marks(axes: Axes, tiles: Sequence[Tile]) -> None:
    for tile in tiles:
        text = (
            "?" if tile.kind == ResultStatus.UNRESOLVED else tile.mark if tile.kind == ResultStatus.INFEASIBLE else ""
        )
        corners = axes.transData.transform([(tile.x0, tile.y0), (tile.x1, tile.y1)])
        size = min(0.62 * float(np.abs(corners[1] - corners[0]).min()) * 72.0 / axes.figure.dpi, _LARGEST)
        if text and size >= _SMALLEST:
            x, y = _centre(axes, tile)
            box = {"facecolor": "#FFFFFF", "edgecolor": "none", "pad": 0.4}
            axes.text(x, y, text, ha="center", va="center", fontsize=size, zorder=2.5, bbox=box)


def _centre(axes: Axes, tile: Tile) -> tuple[float, float]:
    x = np.sqrt(tile.x0 * tile.x1) if axes.get_xscale() == "log" else 0.5 * (tile.x0 + tile.x1)
    y = np.sqrt(tile.y0 * tile.y1) if axes.get_yscale() == "log" else 0.5 * (tile.y0 + tile.y1)
    return float(x), float(y)


def _legend(drawn: Figure, panels: Sequence[Sequence[Tile]], marks: Mapping[str, str], bordered: bool) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    tiles = [tile for panel in panels for tile in panel]
    present = {tile.kind for tile in tiles}
    used = sorted({tile.mark for tile in tiles if tile.kind == ResultStatus.INFEASIBLE})
    limits = ", ".join(f"{mark} {marks[mark]}" for mark in used)
    handles: list[Any] = []
    if bordered:
        handles.append(Line2D([], [], color="#000000", linewidth=2.4, label="border"))
    if bordered and len(panels) == 2:
        dashes = (0, (4, 2))
        handles.append(Line2D([], [], color="#000000", linewidth=1.1, linestyle=dashes, label="border, other panel"))
    if ResultStatus.NOT_CONVERGED in present:
        handles.append(Line2D([], [], label="possible, optimiser did not converge", **_RING))
    for kind, label in (
        (ResultStatus.INFEASIBLE, f"not possible; in the way: {limits}"),
        (ResultStatus.UNRESOLVED, "? not known (numerical failure)"),
    ):
        if kind in present:
            hatch, grey = _HATCHES[kind]
            handles.append(Patch(facecolor="#FFFFFF", edgecolor=grey, hatch=hatch, label=label))
    legend_below(drawn, handles)
