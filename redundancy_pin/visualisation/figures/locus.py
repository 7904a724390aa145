"""The singular locus over the workspace: type I and type II curves over the margin, readable in black and white."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.io.files import replacing_file
from redundancy_pin.kinematics.modes import mode_name
from redundancy_pin.singularities.classify import SingularityKind
from redundancy_pin.singularities.crossings import Crossing
from redundancy_pin.singularities.locus import SingularLocus
from redundancy_pin.visualisation.figures.paths import base_hinges, links
from redundancy_pin.visualisation.figures.style import figure, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_STROKES: dict[SingularityKind, dict[str, Any]] = {
    SingularityKind.TYPE_II: {"color": "#D55E00", "linewidth": 2.0, "linestyle": "-", "label": "type II (parallel)"},
    SingularityKind.TYPE_I: {
        "color": "#000000",
        "linewidth": 1.4,
        "linestyle": (0, (5, 2)),
        "label": "type I (serial), border of the working mode",
    },
    SingularityKind.COMBINED: {"color": "#000000", "linewidth": 2.0, "linestyle": "-.", "label": "combined"},
}

_MECHANISM = "#5A5A5A"


def plot_locus(
    locus: SingularLocus, path: str | Path, *, motion: Array | None = None, crossings: Sequence[Crossing] = ()
) -> None:
    """Write a picture of a singular locus; the suffix (.png, .svg, .pdf) decides on the format.

    The shade is the distance to type II (smallest singular value of the scaled W): darker is nearer; white is out of
    reach in this working mode. A robot with a single coordinate gets its margins as curves.

    Args:
        locus: from ``singular_locus``.
        path: the file to write; one that exists is replaced.
        motion: (N, n) platform coordinates of a motion to draw over it, base frame, m and rad.
        crossings: singularities along that motion, to mark.

    Raises:
        OutputError: the file cannot be written, or its suffix is no picture format; nothing is changed then.
        RedundancyPinError: matplotlib is not installed.
    """
    drawn = draw_locus(locus, motion=motion, crossings=crossings)
    with replacing_file(path) as temporary:
        save(drawn, temporary)


def draw_locus(locus: SingularLocus, *, motion: Array | None = None, crossings: Sequence[Crossing] = ()) -> Figure:
    """Return the picture of a singular locus, see ``plot_locus``.

    Raises:
        InputError: something else than a locus.
        RedundancyPinError: matplotlib is not installed.
    """
    if not isinstance(locus, SingularLocus):
        raise InputError(
            f"locus draws a singular locus, not a {type(locus).__name__}.",
            remedy="Pass what rp.singular_locus(robot) returns.",
        )
    with figure(7.0, 5.6 if len(locus.axes) == 2 else 4.0) as drawn:
        axes = drawn.add_subplot()
        axes.set_title(_title(locus))
        if len(locus.axes) == 2:
            _draw_plane(drawn, axes, locus)
            _draw_motion(axes, locus, motion, crossings)
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.12), ncols=2, frameon=False)
        else:
            _draw_line(axes, locus)
        return drawn


def _title(locus: SingularLocus) -> str:
    robot = locus.robot
    parts = [f"Singularities of {robot.name}"]
    if robot.working_mode:
        parts.append(f"working mode {mode_name(robot.working_mode)}")
    parts += [f"{name} = {round(value, 6) + 0.0:g} rad" for name, value in locus.fixed.items()]
    return ", ".join(parts)


def _draw_plane(drawn: Figure, axes: Axes, locus: SingularLocus) -> None:
    x, y = locus.axes
    axes.grid(False)
    shade = np.ma.masked_invalid(np.abs(locus.margin.T))
    # no part of the map is black or white: curves stand out from it, and so does what is out of reach
    top = float(shade.max())
    image = axes.pcolormesh(
        x, y, shade, cmap="Greys_r", vmin=-0.6 * top, vmax=1.1 * top, shading="nearest", rasterized=True
    )
    bar = drawn.colorbar(image, ax=axes, shrink=0.8)
    bar.ax.set_ylim(0.0, top)
    bar.set_label("margin to type II: smallest scaled singular value of W [–]")
    for start, end in links(locus.robot, locus.q_reference):
        ends = np.stack([start, end])[:, list(_spatial(locus))]
        axes.plot(*ends.T, color=_MECHANISM, linewidth=1.6, marker="o", markersize=3.5, zorder=2.0)
    _draw_curves(axes, locus)
    hinges = base_hinges(locus.robot)[:, list(_spatial(locus))]
    axes.plot(*hinges.T, "^", color="#000000", markersize=8, zorder=3.0, label="base hinge")
    home = locus.reference[list(locus.free)]
    axes.plot(*home, "D", color="#0072B2", markersize=6, zorder=3.0, label="reference")
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel(f"{locus.names[0]} [{locus.units[0]}]")
    axes.set_ylabel(f"{locus.names[1]} [{locus.units[1]}]")


def _draw_curves(axes: Axes, locus: SingularLocus) -> None:
    named: set[SingularityKind] = set()
    for curve in locus.curves:
        style = dict(_STROKES[curve.kind])
        if curve.kind in named:
            style.pop("label")
        named.add(curve.kind)
        axes.plot(*curve.points[:, list(locus.free)].T, zorder=2.5, **style)


def _draw_motion(axes: Axes, locus: SingularLocus, motion: Array | None, crossings: Sequence[Crossing]) -> None:
    columns = list(locus.free)
    if motion is not None:
        axes.plot(*motion[:, columns].T, color="#0072B2", linewidth=1.4, zorder=2.6, label="motion")
    if crossings:
        places = np.array([crossing.x for crossing in crossings])[:, columns]
        axes.plot(
            *places.T, "x", color="#0072B2", markersize=9, markeredgewidth=2, zorder=3.1, label="singular instant"
        )


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
    axes.set_xlabel(f"{locus.names[0]} [{locus.units[0]}]")
    axes.set_ylabel("smallest scaled singular value [–]")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.18), ncols=3, frameon=False)


def _spatial(locus: SingularLocus) -> tuple[int, ...]:
    """Return which of the world's axes the two coordinates of the picture are."""
    return tuple("xyz".index(name) for name in locus.names)
