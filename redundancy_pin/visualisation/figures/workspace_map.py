"""Maps of workspaces: the margin in colour; where the platform or a joint cannot be is hatched."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array, require_type
from redundancy_pin.kinematics.coordinates import mode_name
from redundancy_pin.singularities.workspace import Workspace
from redundancy_pin.visualisation.figures.paths import draw_mechanism, label_plane, projection
from redundancy_pin.visualisation.figures.shading import COLORS, brightest, shade
from redundancy_pin.visualisation.figures.style import figure, legend_below
from redundancy_pin.visualisation.viewer.mechanism import base_hinges, links

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ISLAND: dict[str, Any] = {"color": "#D55E00", "linestyle": "--", "linewidth": 1.2}
_ISLAND_NAME = "not reached from the reference"


def draw_workspace(space: Workspace) -> Figure:
    """Draw a workspace: a map for each working mode over two coordinates, a cloud over three, curves over one.

    The colour is the margin to type II singularities. Its top is the 95th percentile, so that one bright spot does not
    flatten the rest; the arrow of the scale shows that larger margins exist. Islands that the start does not reach are
    outlined: in maps as a whole, in clouds each point, on curves by a broken line. In a cloud the nearest points hide
    the others.

    Raises:
        InputError: no workspace.
    """
    require_type(space, Workspace, "A workspace", "Pass what rp.workspace(robot) returns.")
    many = len(space.modes)
    columns = min(many, 4)
    rows = -(-many // columns)
    with figure(2.4 + 3.6 * columns, 1.4 + 3.4 * rows, f"{space.robot.name}: margin to type II singularities") as drawn:
        panels = drawn.subplots(rows, columns, squeeze=False).ravel()
        for axes in panels[many:]:
            axes.set_visible(False)
        size = np.abs(space.margin)
        top = brightest(size[space.in_range])
        draw: Any = (_curve, _map, _cloud)[len(space.axes) - 1]
        images = [draw(axes, space, k, size[k], top) for k, axes in enumerate(panels[:many])]
        if len(space.axes) > 1:
            bar = drawn.colorbar(images[-1], ax=list(panels), shrink=0.8, extend="max")
            bar.set_label("smallest scaled singular value of W [–]")
        for mode, axes in zip(space.modes, panels, strict=False):
            axes.set_title(f"working mode {mode_name(mode)}" if mode else axes.get_title())
        legend_below(drawn)
        return drawn


def _curve(axes: Axes, space: Workspace, k: int, size: Array, top: float) -> None:
    island = space.island[k] > 0
    for inside, look in ((~island, {"color": "#0072B2"}), (island, _ISLAND | {"label": _ISLAND_NAME})):
        if inside.any():
            axes.plot(space.axes[0], np.where(space.in_range[k] & inside, size, np.nan), **look)
    axes.set(xlabel=f"{space.names[0]} [{space.units[0]}]", ylabel="margin to type II [–]", ylim=(0.0, None))


def _map(axes: Axes, space: Workspace, k: int, size: Array, top: float) -> Any:
    image = shade(axes, space.axes, size, (space.reachable[k], space.in_range[k]), top)
    island = (space.island[k] > 0).T
    if island.any():
        axes.contour(*space.axes, island, [0.5], **{f"{name}s": value for name, value in _ISLAND.items()})
        axes.plot([], [], label=_ISLAND_NAME, **_ISLAND)
    x, y = (f"{name} [{unit}]" for name, unit in zip(space.names, space.units, strict=True))
    axes.set(xlabel=x, ylabel=y, aspect="equal" if space.units[0] == space.units[1] else "auto")
    return image


def _cloud(axes: Axes, space: Workspace, k: int, size: Array, top: float) -> Any:
    matrix, robot = projection("3d"), space.robot
    lines = [np.stack(ends) @ matrix.T for ends in links(robot, robot.q_reference)]
    draw_mechanism(axes, lines, base_hinges(robot) @ matrix.T)
    mesh = np.stack([part.ravel() for part in np.meshgrid(*space.axes, indexing="ij")], axis=1)
    inside = np.flatnonzero(space.in_range[k])
    order = inside[np.argsort(mesh[inside] @ np.cross(matrix[0], matrix[1]))]  # the nearest last, on top
    island = space.island[k].ravel()[order] > 0
    look: dict[str, Any] = {"cmap": COLORS, "vmin": 0.0, "vmax": top, "s": 6.0, "zorder": 1.5}
    look |= {"linewidths": np.where(island, 0.7, 0.0), "edgecolors": _ISLAND["color"]}
    flat = mesh[order] @ matrix.T
    image = axes.scatter(flat[:, 0], flat[:, 1], c=size.ravel()[order], **look)
    if island.any():
        axes.plot([], [], linestyle="", marker="o", markerfacecolor="none", markeredgecolor=_ISLAND["color"],
                  label=_ISLAND_NAME)  # fmt: skip
    label_plane(axes, "3d", flat=False)
    return image
