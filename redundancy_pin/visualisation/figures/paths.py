"""Figures in the plane: the path of a motion, and the mechanism at several instants.

Spatial machines are drawn obliquely ("3d"), with the directions of the axes, or as a projection that the title names.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, stretches
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_sampled
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import robot_of_record
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.result import Simulation
from redundancy_pin.singularities.classify import classify_motion
from redundancy_pin.singularities.crossings import Crossing
from redundancy_pin.visualisation.figures.curves import Curves, curves_of
from redundancy_pin.visualisation.figures.style import STROKES, Stroke, break_lines, figure, legend_below
from redundancy_pin.visualisation.figures.time_panels import condition_panel, draw_background, draw_panel, label_time
from redundancy_pin.visualisation.viewer import scene as scenes
from redundancy_pin.visualisation.viewer.mechanism import base_hinges, links
from redundancy_pin.visualisation.viewer.page import View
from redundancy_pin.visualisation.viewer.scene import FLAT, traced
from redundancy_pin.visualisation.viewer.solids import ROLE_NAMES, points_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_ZOOM_BELOW = 0.3  # A path smaller than this fraction of the mechanism gets a panel of its own
_PLANES = {"xy": (0, 1), "xz": (0, 2), "yz": (1, 2)}


# --- projections ----------------------------------------------------------------------------------------------------


def projection(plane: str) -> Array:
    """Return (2, 3) the matrix from the world to a picture: "xy", "xz", "yz", or "3d", seen obliquely.

    Raises:
        InputError: an unknown plane.
    """
    if plane == "3d":
        towards = np.array(scenes.OBLIQUE) / np.linalg.norm(scenes.OBLIQUE)
        right = np.cross([0.0, 0.0, 1.0], towards)
        right /= np.linalg.norm(right)
        return np.stack([right, np.cross(towards, right)])
    if plane not in _PLANES:
        raise InputError(f"The plane is {plane!r}.", remedy=f"Choose one of {', '.join((*_PLANES, '3d'))}.")
    matrix: Array = np.eye(3)[list(_PLANES[plane])]
    return matrix


def label_plane(axes: Axes, plane: str = "xy", *, flat: bool = True) -> None:
    """Give both axes their names and the same scale; the title names a projection unless the machine is ``flat``."""
    axes.set_aspect("equal", adjustable="datalim")
    if plane != "3d":
        axes.set(xlabel=f"{plane[0]} [m]", ylabel=f"{plane[1]} [m]")
        parts = [axes.get_title()] * bool(axes.get_title()) + [f"projection on {', '.join(plane)}"] * (not flat)
        axes.set_title(", ".join(parts))
        return
    axes.set_axis_off()  # the directions of the world's axes in a corner, with their length, in place of ticks
    (left, right), (bottom, top) = axes.get_xlim(), axes.get_ylim()
    length = 10.0 ** np.floor(np.log10(0.3 * max(right - left, top - bottom)))
    foot = np.array([left, bottom])
    for name, tip in zip("xyz", length * projection("3d").T, strict=True):
        axes.plot(*np.stack([foot, foot + tip]).T, color="#444444", linewidth=1.0)
        axes.annotate(name, xy=tuple(foot + 1.25 * tip), ha="center", va="center", fontsize=8)
    axes.annotate(f"axes: {length:g} m", xy=(0.01, 0.005), xycoords="axes fraction", fontsize=7.5, color="#444444")


# --- lines ----------------------------------------------------------------------------------------------------------


def draw_mechanism(axes: Axes, robot: Robot, q: Array, seen: Array, **style: Any) -> None:
    """Draw links and base hinges at a configuration (nq,) in grey, through a projection (2, 3)."""
    for ends in links(robot, q):
        axes.plot(
            *seen @ np.transpose(ends), "-o", **{"color": "#8C8C8C", "linewidth": 2.2, "markersize": 3.5, **style}
        )
    hinges = seen @ base_hinges(robot).T
    axes.plot(*hinges, "^", color="#000000", markersize=7, zorder=3.0, label="base hinge")


def _draw_path(axes: Axes, point: Array, stroke: Stroke, label: str, start_label: str | None = None) -> None:
    """Draw a path (N, 2) with its start and an arrow in its sense, a fifth of its length from there."""
    x, y = point.T
    axes.plot(x, y, label=label, zorder=2.2, **stroke | {"marker": "", "linewidth": 1.7})
    axes.plot(x[0], y[0], "o", color=stroke["color"], markersize=6, zorder=2.3, label=start_label)
    length = np.concatenate([[0.0], np.cumsum(np.hypot(np.diff(x), np.diff(y)))])
    tail, head = np.searchsorted(length, [0.22 * length[-1], 0.24 * length[-1]])
    arrow = {"arrowstyle": "-|>", "color": stroke["color"], "mutation_scale": 14}
    axes.annotate("", xy=(x[head], y[head]), xytext=(x[tail], y[tail]), arrowprops=arrow)


def draw_singular(axes: Axes, points: ArrayLike, color: str, label: str = "singular") -> None:
    """Draw crosses at singular points (c, 2) of the picture, m."""
    places = np.asarray(points, dtype=float)
    if len(places):
        axes.plot(*places.T, "x", color=color, markersize=9, markeredgewidth=2, zorder=3.1, label=label)


def plot_path(
    subject: Plan | Simulation | Robot,
    motion: PlatformMotion | None = None,
    *,
    crossings: Sequence[Crossing] = (),
    robot: Robot | None = None,
    title: str | None = None,
) -> Figure:
    """Draw the mechanism at the start of a motion, the path of its platform, and the condition number.

    A path that is small relative to the machine is drawn once more, enlarged. A machine that is not flat is seen
    obliquely, and its path drawn once more as a projection on x and y.

    Args:
        subject: a plan, a simulation, or the robot that the motion is for.
        motion: of a robot.
        crossings: from ``find_crossings`` along the same motion, to mark.
        robot: of a plan or a simulation from a file, if the files of the robot have moved, or it was changed in Python.
        title: of the figure.

    Raises:
        InputError: a plan or a simulation with a motion, a robot without one, or a robot without a platform.
        PlanFileError: the robot of the plan or the simulation is gone or has changed.

    Example:
        >>> robot, motion = rp.load_robot("3rrr"), rp.trajectory.reference.corner().sample(0.02)
        >>> figure = rp.plot.path(robot, motion)
    """
    if isinstance(subject, (Plan, Simulation)) is (motion is not None):
        raise InputError(
            "path draws a plan, a simulation, or a robot with a motion.",
            remedy="Pass path(plan), path(run) or path(robot, motion).",
        )
    if isinstance(subject, Robot) and robot is not None:
        raise InputError("robot= goes with a plan or a simulation.", remedy="Pass path(robot, motion).")
    robot = subject if isinstance(subject, Robot) else robot_of_record(subject.robot, robot)
    if robot.platform is None:
        raise InputError(f"{robot.name} has no platform whose path could be drawn.", remedy="Use rp.show to see it.")
    drawn, q = _followed(subject, motion, robot)
    drawn = replace(drawn, instants=tuple(crossing.t for crossing in crossings) or drawn.instants)

    point = traced(robot, q)
    places = np.array([[np.interp(one, drawn.t, along) for along in point.T] for one in drawn.instants]).reshape(-1, 3)
    everything = np.concatenate([point, base_hinges(robot), *links(robot, q[0])], axis=None).reshape(-1, 3)
    flat = bool(np.ptp(everything[:, 2]) < FLAT * robot.characteristic_length)
    zoomed = not flat or np.ptp(point, axis=0).max() < _ZOOM_BELOW * np.ptp(everything, axis=0).max()
    ratios = [1.0, 1.0, 1.4] if zoomed else [1.0, 1.4]
    with figure(10.0 if zoomed else 8.0, 3.6, title or drawn.title) as page:
        *panels, last = page.subplots(1, len(ratios), width_ratios=ratios)
        for axes, name, plane in zip(panels, ("mechanism at the start", "path"), ("xy" if flat else "3d", "xy"),
                                     strict=False):  # fmt: skip
            seen = projection(plane)
            if axes is panels[0]:
                draw_mechanism(axes, robot, q[0], seen, zorder=1.8)
            _draw_path(axes, point @ seen.T, STROKES[0], "path", "start")
            draw_singular(axes, places @ seen.T, STROKES[1]["color"])
            axes.set_title(name)
            label_plane(axes, plane, flat=flat)
        draw_panel(last, condition_panel(drawn), 1.4 * page.get_figwidth() / sum(ratios) - 0.8)
        draw_background(last, drawn)
        label_time([last], drawn.t[0], drawn.t[-1])
        legend_below(page)
        return page


def _followed(subject: Plan | Simulation | Robot, motion: PlatformMotion | None, robot: Robot) -> tuple[Curves, Array]:
    """Return curves and (N, nq) configurations; of a robot and a motion without efforts."""
    if isinstance(subject, Simulation):
        return curves_of(subject, robot), subject.q
    followed = subject.motion if isinstance(subject, Plan) else cast(PlatformMotion, motion)
    require_sampled(followed)
    tree = inverse_kinematics(robot, followed)
    if isinstance(subject, Plan):
        return curves_of(subject), tree.q
    classes, none = classify_motion(tree), np.zeros((len(tree.q), 0))
    parked = CarrierMotion.parked(len(tree.q), 0)
    regular = np.zeros(len(tree.q), dtype=np.intp)
    drawn = Curves(
        robot.name, followed.t, none, "", none, parked, (), classes.condition, classes.parallel_margin, regular, (), ()
    )
    return drawn, tree.q


def plot_plane_paths(title: str, paths: Mapping[str, Array]) -> Figure:
    """Draw paths (N, 2), m, by their label, with start and direction."""
    with figure(6.0, 5.2) as drawn:
        axes = drawn.add_subplot(title=title)
        for stroke, (label, point) in zip(STROKES, paths.items(), strict=False):
            _draw_path(axes, point, stroke, label)
        label_plane(axes)
        legend_below(drawn)
        return drawn


# --- snapshots: a moving picture on paper ---------------------------------------------------------------------------

_FAINTEST = 0.25  # opacity of the first instant; the last one is drawn in full
_BASE_OPACITY = 0.18  # of the base, which is behind everything
_MARKERS = {"actuated": "o", "passive": "o", "closure": "D"}
_ORDER = {"base": 0.5, "link": 1.8, "track": 2.2, "platform": 2.6, "carrier": 3.0}  # in which parts are drawn


def scene_in(view: object) -> scenes.Scene:
    """Return the scene of a view, or a scene as it is."""
    scene = view.scene if isinstance(view, View) else view
    if not isinstance(scene, scenes.Scene):
        message = f"A view can be drawn, not a {type(view).__name__}."
        raise InputError(message, remedy="Pass what rp.show returns: rp.show(plan).")
    return scene


def plot_snapshots(
    view: View | scenes.Scene, times: Sequence[float] | int = 5, *, plane: str = "xy", title: str | None = None
) -> Figure:
    """Draw links, tracks, carriers, base and platform at several instants, later ones stronger, over the path.

    Path and platform have the colour of the margin to a singularity.

    Args:
        view: what ``rp.show`` returns, or its scene.
        times: instants from the start of the motion, s, or how many, evenly spread.
        plane: which coordinates are drawn: "xy", "xz" or "yz", titled a projection for a spatial machine; or
            "3d", seen obliquely.
        title: of the figure; the scene's when left out.

    Raises:
        InputError: no view, an unknown plane, or times outside the motion.

    Example:
        >>> figure = rp.plot.snapshots(rp.show("3rrr"), 3)
    """
    scene = scene_in(view)
    projection(plane)  # refused before anything is drawn
    wanted = np.linspace(0.0, scene.duration, times) if isinstance(times, int) else np.asarray(times, dtype=float)
    if not wanted.size or not ((wanted >= 0.0) & (wanted <= scene.duration)).all():
        raise InputError(
            f"The instants are {times}; the motion lasts {scene.duration:.6g} s.",
            remedy="Pass times from the start of the motion, s, or a positive count.",
        )
    frames = [int(np.abs(scene.t - t).argmin()) for t in wanted]
    with figure(6.0, 5.2) as drawn:
        axes = drawn.add_subplot(title=break_lines(scene.title if title is None else title, 6.0))
        for i, frame in enumerate(frames):
            alpha = _FAINTEST + (1.0 - _FAINTEST) * (i + 1) / len(frames)
            draw_frame(axes, scene, frame, plane=plane, alpha=alpha, base=i == 0)
        draw_path(axes, scene, plane=plane)
        label_plane(axes, plane, flat=scene.is_flat)
        legend_below(drawn)
        return drawn


def draw_frame(
    axes: Axes, scene: scenes.Scene, frame: int, *, plane: str = "xy", alpha: float = 1.0, base: bool = True
) -> None:
    """Draw the outlines of the mechanism's parts at one frame of a scene; the ``base`` is the same in every frame."""
    matrix = projection(plane)
    for solid in scene.solids:
        place = scene.placement[frame, solid.body] @ solid.placement
        points = (points_of(solid) @ place[:3, :3].T + place[:3, 3]) @ matrix.T
        name = ROLE_NAMES.get(solid.role) if solid.role != "link" else None
        style: dict[str, Any] = {"alpha": alpha, "label": name, "zorder": _ORDER.get(solid.role, 2.8)}
        if solid.role in _MARKERS:
            face = "#FFFFFF" if solid.role == "passive" else solid.color
            axes.plot(*matrix @ place[:3, 3], _MARKERS[solid.role], linestyle="none", markersize=4.5,
                      markerfacecolor=face, markeredgecolor="#202020", markeredgewidth=0.7, **style)  # fmt: skip
        elif solid.role == "track":
            ends = place[:3, 3] + 0.5 * solid.size[2] * np.outer([-1.0, 1.0], place[:3, 2])  # of a bar along z
            line = points if solid.shape == "arc" else ends @ matrix.T
            axes.plot(*line.T, color=solid.color, linewidth=1.2, linestyle=(0, (3, 1.5)), **style)
        elif base or solid.role != "base":
            style["alpha"] = _BASE_OPACITY if solid.role == "base" else solid.opacity * alpha
            color = scenes.margin_color(scene.margin[frame]) if solid.role == "platform" else solid.color
            edge = color if solid.shape == "plate" else "#202020"  # seen from the side a plate is a line
            axes.fill(*_hull(points).T, facecolor=color, edgecolor=edge, linewidth=0.6, **style)


def draw_path(axes: Axes, scene: scenes.Scene, *, plane: str = "xy") -> None:
    """Draw the path of the platform in the colours of the margin, wider near singularities."""
    points, classes = scene.path @ projection(plane).T, scenes.margin_classes(scene.path_margin)
    if len(points) > 1:
        halo = 5.4 if (classes == 0).any() else 3.6  # seen on a platform of its colour
        axes.plot(*points.T, color="#FFFFFF", linewidth=halo, zorder=3.9)
        for a, b in stretches(classes):  # each up to where the next one begins
            number, color = int(classes[a]), scenes.margin_color(scene.path_margin[a])
            name = f"margin {scenes.margin_labels()[number]}" if number >= 0 else None
            axes.plot(*points[a : b + 1].T, color=color, linewidth=1.6 if number else 3.4, zorder=4.0, label=name)
    axes.plot(*points[:1].T, "o", color="#000000", markersize=4, zorder=4.1)


def _hull(points: Array) -> Array:
    """Return the corners of the convex hull of points (N, 2) in order."""
    from scipy.spatial import ConvexHull, QhullError

    try:
        hull: Array = points[ConvexHull(points).vertices]
    except QhullError:  # they lie on a line
        hull = points[np.lexsort(points.T)[[0, -1]]]
    return hull
