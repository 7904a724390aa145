"""Maps of workspaces: the margin in colour, what is out of reach hatched, what joints forbid dotted."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array, require_type
from redundancy_pin.kinematics.coordinates import mode_name
from redundancy_pin.singularities.workspace import Workspace
from redundancy_pin.visualisation.figures.paths import draw_mechanism, label_plane, projection
from redundancy_pin.visualisation.figures.shading import COLORS, brightest, hatched, shade
from redundancy_pin.visualisation.figures.style import figure, legend_below
from redundancy_pin.visualisation.viewer.mechanism import base_hinges, links

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_MARK: dict[str, Any] = {"color": "#D55E00", "linestyle": "--", "linewidth": 1.2}
"""Of what is in an island."""


def draw_workspace(space: Workspace) -> Figure:
    """Draw a workspace: a map for each working mode over two coordinates, a cloud over three, curves over one.

    The colour is the margin to type II singularities. Its top is the 95th percentile, so that one bright spot does not
    flatten the rest; the arrow of the scale says that there is more. Islands that the start does not reach are
    outlined: in maps as a whole, in clouds each point, on curves by a broken line. In a cloud the nearest points hide
    what is behind.

    Raises:
        InputError: no workspace.
    """
    from matplotlib.lines import Line2D

    require_type(space, Workspace, "A workspace", "Pass what rp.workspace(robot) returns.")
    many = len(space.modes)
    columns = min(many, 4)
    rows = -(-many // columns)
    with figure(2.4 + 3.6 * columns, 1.4 + 3.4 * rows, f"{space.robot.name}: margin to type II singularities") as drawn:
        panels = drawn.subplots(rows, columns, squeeze=False).ravel()
        size = np.abs(space.margin)
        top = brightest(size[space.in_range])
        image = None
        for k, axes in enumerate(panels):
            if k >= many:
                axes.set_visible(False)
                continue
            if space.modes[k]:
                axes.set_title(f"working mode {mode_name(space.modes[k])}")
            if len(space.axes) == 1:
                for island, look in ((False, {"color": "#0072B2"}), (True, _MARK)):
                    shown = space.in_range[k] & ((space.island[k] > 0) == island)
                    axes.plot(space.axes[0], np.where(shown, size[k], np.nan), **look)
                axes.set(
                    xlabel=f"{space.names[0]} [{space.units[0]}]", ylabel="margin to type II [–]", ylim=(0.0, None)
                )
            elif len(space.axes) == 2:
                image = shade(axes, space.axes, size[k], (space.reachable[k], space.in_range[k]), top)
                if (space.island[k] > 0).any():
                    axes.contour(
                        *space.axes,
                        (space.island[k] > 0).T,
                        [0.5],
                        **{f"{name}s": value for name, value in _MARK.items()},
                    )
                axes.set(
                    **{
                        f"{a}label": f"{name} [{unit}]"
                        for a, name, unit in zip("xy", space.names, space.units, strict=True)
                    }
                )
                axes.set_aspect("equal" if space.units[0] == space.units[1] else "auto")
            else:
                image = _cloud(axes, space, k, size[k], top)
        if image is not None:
            bar = drawn.colorbar(image, ax=list(panels), shrink=0.8, extend="max")
            bar.set_label("smallest scaled singular value of W [–]")
        marks = hatched(space.reachable, space.in_range)
        if (space.island > 0).any():
            look = _MARK if len(space.axes) < 3 else {"ls": "", "marker": "o", "mfc": "none", "mec": _MARK["color"]}
            marks.append(Line2D([], [], label="not reached from the reference", **look))
        legend_below(drawn, marks if len(space.axes) == 2 else marks[-1:] if (space.island > 0).any() else [])
        return drawn


def _cloud(axes: Axes, space: Workspace, k: int, size: Array, top: float) -> Any:
    matrix = projection("3d")
    robot = space.robot
    draw_mechanism(
        axes, [np.stack(ends) @ matrix.T for ends in links(robot, robot.q_reference)], base_hinges(robot) @ matrix.T
    )
    mesh = np.stack([part.ravel() for part in np.meshgrid(*space.axes, indexing="ij")], axis=1)
    inside = space.in_range[k].ravel()
    points, values = mesh[inside], size.ravel()[inside]
    towards = np.cross(matrix[0], matrix[1])
    order = np.argsort(points @ towards)  # the nearest last, on top
    flat = points[order] @ matrix.T
    rings = np.where(space.island[k].ravel()[inside][order] > 0, 0.7, 0.0)
    look: dict[str, Any] = {"cmap": COLORS, "vmin": 0.0, "vmax": top, "s": 6.0, "zorder": 1.5}
    look |= {"linewidths": rings, "edgecolors": _MARK["color"]}
    image = axes.scatter(flat[:, 0], flat[:, 1], c=values[order], **look)
    label_plane(axes, "3d", flat=False)
    return image
