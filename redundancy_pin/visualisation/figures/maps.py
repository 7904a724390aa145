"""Maps of the margin to singularities: singular curves, and reachable poses of the platform."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, require_type
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.coordinates import mode_name
from redundancy_pin.singularities.classify import SingularityKind
from redundancy_pin.singularities.crossings import Crossing
from redundancy_pin.singularities.locus import SingularLocus
from redundancy_pin.singularities.workspace import Workspace
from redundancy_pin.visualisation.figures.paths import draw_mechanism, draw_singular, label_plane, projection
from redundancy_pin.visualisation.figures.style import break_lines, figure, legend_below

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_COLORS = "viridis"  # dark is near a singularity, yellow far from all; neither is white, which nothing reachable is
_BRIGHT = 95.0  # per cent of the margins below the top of the colours: one bright spot does not make all others dark
_HATCHES: dict[str, dict[str, Any]] = {
    "out of reach": {"facecolor": "#FFFFFF", "edgecolor": "#C8C8C8", "hatch": "////", "linewidth": 0.0},
    "a joint beyond its limits": {"facecolor": "#E3C9C4", "edgecolor": "#B0675A", "hatch": "....", "linewidth": 0.0},
}
_TYPE_I: dict[str, Any] = {"color": "#000000", "linestyle": (0, (5, 2))}
_TYPE_II: dict[str, Any] = {"color": "#D55E00", "linestyle": "-"}
_LOCUS: dict[SingularityKind, dict[str, Any]] = {
    SingularityKind.TYPE_II: {**_TYPE_II, "linewidth": 2.0, "label": "type II (parallel)"},
    SingularityKind.TYPE_I: {**_TYPE_I, "linewidth": 1.4, "label": "type I (serial), border of the working mode"},
    SingularityKind.COMBINED: {"color": "#000000", "linewidth": 2.0, "linestyle": "-.", "label": "combined"},
}
_ISLAND: dict[str, Any] = {"color": "#D55E00", "linestyle": "--", "linewidth": 1.2}
_ISLAND_NAME = "not reached from the reference"


def plot_workspace(
    subject: Workspace | SingularLocus, *, motion: Array | None = None, crossings: Sequence[Crossing] = ()
) -> Figure:
    """Draw the margin to type II singularities over a workspace, or over the singular curves of a robot.

    The colour is the smallest singular value of the scaled W: darker is nearer to a singularity; hatched is out of
    reach. A workspace has a map for each working mode over two coordinates, a cloud over three, curves over one. The
    top of its colours is the 95th percentile; the arrow of the scale shows that larger margins exist. Islands that the
    start does not reach are outlined. In a cloud the nearest points hide the others. A locus has its type I and
    type II curves over the map of its working mode, or its margins as curves over a single coordinate.

    Args:
        subject: from ``workspace`` or ``singular_locus``.
        motion: (N, n) platform coordinates of a motion to draw over a locus, base frame, m and rad.
        crossings: singularities along that motion, to mark.

    Raises:
        InputError: neither a workspace nor a locus, or a motion over a workspace.

    Example:
        >>> figure = rp.plot.workspace(rp.workspace("five_bar", resolution=10))
        >>> figure = rp.plot.workspace(rp.singular_locus("five_bar", resolution=10))
    """
    remedy = "Pass what rp.workspace(robot) or rp.singular_locus(robot) returns."
    require_type(subject, (Workspace, SingularLocus), "A workspace or a singular locus", remedy)
    if isinstance(subject, SingularLocus):
        return _plot_locus(subject, motion, crossings)
    if motion is not None or len(crossings):
        raise InputError("A motion is drawn over a locus.", remedy="Pass what rp.singular_locus(robot) returns.")
    many, flat = len(subject.modes), len(subject.axes)
    columns = min(many, 4)
    rows = -(-many // columns)
    title = f"{subject.robot.name}: margin to type II singularities"
    with figure(2.4 + 3.6 * columns, 1.4 + 3.4 * rows, title) as drawn:
        panels = drawn.subplots(rows, columns, squeeze=False).ravel()
        for axes in panels[many:]:
            axes.set_visible(False)
        size = np.abs(subject.margin)
        top = _brightest(size[subject.in_range])
        draw: Any = (_curve, _map, _cloud)[flat - 1]
        images = [draw(axes, subject, k, size[k], top) for k, axes in enumerate(panels[:many])]
        if flat > 1:
            bar = drawn.colorbar(images[-1], ax=list(panels), shrink=0.8, extend="max")
            bar.set_label("smallest scaled singular value of W [–]")
        for mode, axes in zip(subject.modes, panels, strict=False):
            axes.set_title(f"working mode {mode_name(mode)}" if mode else axes.get_title())
        legend_below(drawn)
        return drawn


def _plot_locus(locus: SingularLocus, motion: Array | None, crossings: Sequence[Crossing]) -> Figure:
    mode = [f"working mode {mode_name(locus.robot.working_mode)}"] if locus.robot.working_mode else []
    fixed = [f"{name} = {round(value, 6) + 0.0:g} rad" for name, value in locus.fixed.items()]
    plane = len(locus.axes) == 2
    with figure(7.0, 5.6 if plane else 4.0) as drawn:
        title = ", ".join([f"Singularities of {locus.robot.name}", *mode, *fixed])
        axes = drawn.add_subplot(title=break_lines(title, 7.0))
        if plane:
            _draw_plane(drawn, axes, locus)
            if motion is not None:
                mark = "o" if len(motion) == 1 else ""
                axes.plot(*motion[:, list(locus.free)].T, marker=mark, color="#0072B2", zorder=2.6, label="motion")
            places = [crossing.x[list(locus.free)] for crossing in crossings]
            draw_singular(axes, places, "#0072B2", "singular instant")
        else:
            _draw_line(axes, locus)
        legend_below(drawn)
        return drawn


def _draw_plane(drawn: Figure, axes: Axes, locus: SingularLocus) -> None:
    size = np.abs(locus.margin)
    image = _shade(axes, locus.axes, size, (locus.reachable, locus.reachable), _brightest(size))
    bar = drawn.colorbar(image, ax=axes, shrink=0.8, extend="max")
    bar.set_label("margin to type II: σ_min of scaled W [–]")
    seen = np.eye(3)[["xyz".index(name) for name in locus.names]]
    draw_mechanism(axes, locus.robot, locus.q_reference, seen, color="#5A5A5A", linewidth=1.6, zorder=2.0)
    for curve in locus.curves:
        axes.plot(*curve.points[:, list(locus.free)].T, zorder=2.5, **_LOCUS[curve.kind])
    axes.plot(*locus.reference[list(locus.free)], "D", color="#0072B2", markersize=6, zorder=3.0, label="reference")
    axes.set_aspect("equal", adjustable="box")
    axes.set(**_axis_names(locus))


def _draw_line(axes: Axes, locus: SingularLocus) -> None:
    (coordinate,) = locus.axes
    axes.plot(coordinate, locus.serial_margin, **_TYPE_I, label="margin to type I")
    axes.plot(coordinate, np.abs(locus.margin), **_TYPE_II, label="margin to type II")
    for curve in locus.curves:
        place = float(curve.points[0, 0])
        label = f"{curve.kind.label.replace('_', ' ')} at {place:.6g}"
        axes.axvline(place, color="#000000", linewidth=1.0, linestyle=":", label=label)
    axes.plot(locus.reference[0], 0.0, "D", color="#0072B2", markersize=6, clip_on=False, label="reference")
    axes.set(**_axis_names(locus), ylabel="smallest scaled singular value [–]", ylim=(0.0, None))


def _curve(axes: Axes, space: Workspace, k: int, size: Array, top: float) -> None:
    island = space.island[k] > 0
    for inside, look in ((~island, {"color": "#0072B2"}), (island, _ISLAND | {"label": _ISLAND_NAME})):
        if inside.any():
            axes.plot(space.axes[0], np.where(space.in_range[k] & inside, size, np.nan), **look)
    axes.set(**_axis_names(space), ylabel="margin to type II [–]", ylim=(0.0, None))


def _map(axes: Axes, space: Workspace, k: int, size: Array, top: float) -> Any:
    image = _shade(axes, space.axes, size, (space.reachable[k], space.in_range[k]), top)
    island = (space.island[k] > 0).T
    if island.any():
        axes.contour(*space.axes, island, [0.5], **{f"{name}s": value for name, value in _ISLAND.items()})
        axes.plot([], [], label=_ISLAND_NAME, **_ISLAND)
    axes.set(**_axis_names(space), aspect="equal" if space.units[0] == space.units[1] else "auto")
    return image


def _cloud(axes: Axes, space: Workspace, k: int, size: Array, top: float) -> Any:
    matrix, robot = projection("3d"), space.robot
    draw_mechanism(axes, robot, robot.q_reference, matrix, zorder=1.8)
    mesh = np.stack([part.ravel() for part in np.meshgrid(*space.axes, indexing="ij")], axis=1)
    inside = np.flatnonzero(space.in_range[k])
    order = inside[np.argsort(mesh[inside] @ np.cross(matrix[0], matrix[1]))]  # the nearest last, on top
    island = space.island[k].ravel()[order] > 0
    look: dict[str, Any] = {"cmap": _COLORS, "vmin": 0.0, "vmax": top, "s": 6.0, "zorder": 1.5}
    look |= {"linewidths": np.where(island, 0.7, 0.0), "edgecolors": _ISLAND["color"]}
    x, y = matrix @ mesh[order].T
    image = axes.scatter(x, y, c=size.ravel()[order], **look)
    if island.any():
        axes.plot([], [], linestyle="", marker="o", markerfacecolor="none", markeredgecolor=_ISLAND["color"],
                  label=_ISLAND_NAME)  # fmt: skip
    label_plane(axes, "3d", flat=False)
    return image


def _axis_names(grid: SingularLocus | Workspace) -> dict[str, Any]:
    """Return the labels of the axes over which a grid of one or two coordinates is drawn."""
    labels = (f"{name} [{unit}]" for name, unit in zip(grid.names, grid.units, strict=True))
    return dict(zip(("xlabel", "ylabel"), labels, strict=False))


def _brightest(size: Array) -> float:
    """Return the margin at the top of the colours."""
    known = size[np.isfinite(size)]
    return max(float(np.percentile(known, _BRIGHT)), 1e-12) if len(known) else 1.0


def _shade(axes: Axes, grid: tuple[Array, ...], size: Array, there: tuple[BoolArray, BoolArray], top: float) -> Any:
    """Draw margins (A, B) over a grid in colour; cells without one are hatched and named in the legend.

    ``there`` is where nodes are reachable, and where joints are within their ranges too. Returns the image.
    """
    from matplotlib.patches import Rectangle

    axes.grid(False)
    reachable, in_range = there
    wide = [np.concatenate([[1.5 * a[0] - 0.5 * a[1]], a, [1.5 * a[-1] - 0.5 * a[-2]]]) for a in grid]
    for (name, style), where in zip(_HATCHES.items(), (~reachable, reachable & ~in_range), strict=True):
        if where.any():
            around = np.pad(where.T.astype(float), 1, mode="edge")
            face, hatch = [style["facecolor"]], [style["hatch"]]
            filled = axes.contourf(*wide, around, levels=[0.5, 1.5], colors=face, hatches=hatch)
            filled.set(edgecolor=style["edgecolor"], linewidth=0.0)
            axes.add_patch(Rectangle((0.0, 0.0), 0.0, 0.0, label=name, **style))  # for the legend
    shown = np.ma.masked_where(~in_range, size)
    return axes.pcolormesh(*grid, shown.T, cmap=_COLORS, vmin=0.0, vmax=top, shading="nearest", rasterized=True)
