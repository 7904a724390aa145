"""Where a motion goes: the mechanism at its start, the path, and the condition number along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.robot import Robot
from redundancy_pin.visualisation.figures.style import STROKES, figure, mark_singular

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def base_hinges(robot: Robot) -> Array:
    """Return (B, 3) where the chains are fixed to the base: origins of the first joints, m, base frame."""
    model = robot.model
    first = [j for j in range(1, model.njoints) if model.parents[j] == 0 and model.names[j] not in robot.carriers]
    points = [model.jointPlacements[j].translation for j in first]
    for frame in _closure_frames(robot):
        if model.frames[frame].parentJoint == 0:
            points.append(model.frames[frame].placement.translation)
    return read_only(np.array(points).reshape(-1, 3))


def links(robot: Robot, q: Array) -> tuple[tuple[Array, Array], ...]:
    """Return the ends (3,), (3,) m of the lines that make up the mechanism at a configuration (nq,).

    A link is a line or, with three hinges or more, a polygon between its hinges (its own joint, the joints that follow,
    its closures). The origin of a platform that is a single line is its end.
    """
    model = robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, np.array(q))
    points: dict[int, list[Array]] = {j: [data.oMi[j].translation.copy()] for j in range(1, model.njoints)}
    for joint in range(1, model.njoints):
        if model.parents[joint] > 0 and model.names[joint] not in robot.carriers:
            points[model.parents[joint]].append(data.oMi[joint].translation.copy())
    for frame in _closure_frames(robot):
        points.setdefault(model.frames[frame].parentJoint, []).append(data.oMf[frame].translation.copy())
    if robot.platform is not None:
        frame = _body(model, robot.platform.frame)
        on_link = points[model.frames[frame].parentJoint]
        if len(_distinct(on_link)) < 3:
            on_link.append(data.oMf[frame].translation.copy())
    points.pop(0, None)
    return tuple(pair for hinges in points.values() for pair in _outline(_distinct(hinges)))


def _distinct(points: list[Array]) -> list[Array]:
    kept: list[Array] = []
    for point in points:
        if all(np.linalg.norm(point - other) > _NO_LENGTH for other in kept):
            kept.append(point)
    return kept


def _outline(points: list[Array]) -> list[tuple[Array, Array]]:
    pairs = list(pairwise(points))
    return [*pairs, (points[-1], points[0])] if len(points) > 2 else pairs


def _closure_frames(robot: Robot) -> list[int]:
    names = [name for closure in robot.closures for name in (closure.frame_a, closure.frame_b)]
    return [_body(robot.model, name) for name in names]


def _body(model: pin.Model, name: str) -> int:
    return int(model.getFrameId(name, pin.FrameType.BODY))


_NO_LENGTH = 1e-9


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
