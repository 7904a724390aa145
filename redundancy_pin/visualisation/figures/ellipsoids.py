"""Velocity and force ellipsoids of a platform's translations, drawn where the platform is."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array, require_type
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.singularities.performance import Ellipsoid, Performance
from redundancy_pin.visualisation.figures.paths import draw_mechanism, label_plane, projection
from redundancy_pin.visualisation.figures.style import STROKES, figure, legend_below
from redundancy_pin.visualisation.viewer.mechanism import base_hinges, links

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIZE = 0.12
"""Largest semi-axis drawn of the median pose, in sizes of the picture; longer ones than three times that are cut."""

_ENDLESS = 1e6
"""An infinite semi-axis is drawn as so many times the largest finite one, and cut."""


def draw_ellipsoids(performance: Performance, *, plane: str | None = None) -> Figure:
    """Draw the ellipsoids of translations, velocities left, forces right, at each pose; the mechanism is at the first.

    Each panel has a scale of its own, which its title says. A velocity ellipse that a singularity makes endless ends at
    the border of the picture; the other panel is flat there.

    Args:
        performance: from ``performance``; a few poses make a readable picture.
        plane: "xy", "xz", "yz" or "3d", seen obliquely; by default what suits the platform's translations.

    Raises:
        InputError: no performance, an unknown plane.
        UnsupportedRobotError: a platform with less than two translations.
    """
    require_type(performance, Performance, "A performance", "Pass what rp.performance(robot, q) returns.")
    robot = performance.robot
    moving = [axis for axis in (robot.platform.axes if robot.platform else ()) if not axis.startswith("r")]
    if robot.platform is None or len(moving) < 2:
        raise UnsupportedRobotError(
            f"The platform of {robot.name} has no plane to draw ellipses in.", remedy="Plot the numbers themselves."
        )
    spatial = len(moving) == 3
    view = plane or ("3d" if spatial else "".join(moving))
    matrix = projection(view)
    rows = [robot.platform.axes.index(axis) for axis in moving]
    into = matrix[:, ["xyz".index(axis) for axis in moving]]
    places = constraint_system(robot).evaluate(performance.q).placement(robot.platform.frame)[1].T @ matrix.T
    lines = [np.stack(ends) @ matrix.T for ends in links(robot, performance.q[0])]
    hinges = base_hinges(robot) @ matrix.T
    size = float(np.ptp(np.concatenate([*lines, hinges, places]), axis=0).max())
    with figure(9.0, 4.6, f"{robot.name}: what its motors reach") as drawn:
        kinds = (("velocity", "m/s", performance.velocity), ("force", "N", performance.force))
        for axes, stroke, (name, unit, ellipsoid) in zip(drawn.subplots(1, 2), STROKES, kinds, strict=False):
            outlines = outline(ellipsoid, rows, into)
            reach = np.linalg.norm(outlines, axis=2).max(axis=1)
            finite = reach[np.isfinite(reach)]
            scale = _SIZE * size / float(np.median(finite)) if len(finite) else 1.0
            draw_mechanism(axes, lines, hinges)
            for place, ring in zip(places, outlines, strict=True):
                length = scale * np.linalg.norm(ring, axis=1, keepdims=True)
                ring = scale * ring * np.minimum(1.0, 3.0 * _SIZE * size / np.maximum(length, 1e-300))
                axes.plot(*(place + ring).T, color=stroke.color, linewidth=1.3, zorder=2.5)
                axes.plot(*place, "+", color="#000000", markersize=5, zorder=2.6)
            label_plane(axes, view, flat=not spatial)
            axes.set_title(f"{name} ellipsoids: {_SIZE * size / scale:.3g} {unit} are {_SIZE * size:.3g} m long")
        legend_below(drawn, axes.get_legend_handles_labels()[0])
        return drawn


def outline(ellipsoid: Ellipsoid, rows: list[int], into: Array) -> Array:
    """Return (N, 73, 2) the borders of the projections of ellipsoids, in their own units.

    Args:
        ellipsoid: scaled, (N, n).
        rows: which of the platform's coordinates are drawn, d of them; the ellipsoid is projected on them.
        into: (2, d) from these to the picture.
    """
    axes = np.where(
        np.isfinite(ellipsoid.axes), ellipsoid.axes, np.nanmax(ellipsoid.axes[np.isfinite(ellipsoid.axes)]) * 1e6
    )
    halves = into @ (ellipsoid.directions[:, rows] * axes[:, None, :])  # x = A y with |y| ≤ 1
    u, values, _ = np.linalg.svd(halves)
    angle = np.linspace(0.0, 2.0 * np.pi, 73)
    circle = np.stack([np.cos(angle), np.sin(angle)])
    result: Array = ((u * values[:, None, :2]) @ circle).transpose(0, 2, 1)
    return result
