"""Figures for papers: ``rp.plot``. Functions return a matplotlib ``Figure``; ``save`` writes SVG, PNG or PDF.

One look for all: the same colour and line style for the same actuator, units on every axis, line styles that
distinguish the curves in print without colour, singular instants dotted, near-singular intervals grey, forbidden ranges
hatched.

    efforts     main efforts and carrier forces              of a plan, a simulation or ``curves``
    carriers    position, speed, acceleration with limits     of a plan, a simulation or ``curves``
    condition   condition number, thresholds, instants        of a plan, a simulation or ``curves``
    plan        all of these on one page                      of a plan
    simulation  efforts, carriers, distance from a plan       of a simulation
    path        the mechanism and where its platform goes     of a plan, a simulation or a motion
    snapshots   the mechanism at several instants             of a plan's, a simulation's or a robot's ``View``
    video       the moving picture as .gif or .mp4            of a plan's, a simulation's or a robot's ``View``
    locus       singular curves over the workspace            of ``singular_locus``
    workspace   where the platform can go, and how well       of ``workspace``
    comparison  the efforts of several plans                  of plans, simulations or ``curves``

A new figure over time is a function here that lists its panels; ``time_panels`` has an example.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, PlanFileError
from redundancy_pin.kinematics.coordinates import angle_columns, distance
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import robot_of_record
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.result import Simulation
from redundancy_pin.visualisation.figures.curves import (
    Curves,
    curves,
    curves_of,
    curves_of_plan,
    plan_title,
)
from redundancy_pin.visualisation.figures.maps import draw_locus as locus
from redundancy_pin.visualisation.figures.maps import draw_workspace as workspace
from redundancy_pin.visualisation.figures.paths import draw_snapshots as snapshots
from redundancy_pin.visualisation.figures.paths import plot_path as path
from redundancy_pin.visualisation.figures.style import STROKES, save
from redundancy_pin.visualisation.figures.time_panels import (
    Background,
    Curve,
    Panel,
    background_of,
    condition_panel,
    fitted_range,
    plot_panel_grid,
    plot_time_panels,
    series,
)
from redundancy_pin.visualisation.figures.video import save_video as video

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "Curves",
    "carriers",
    "comparison",
    "condition",
    "curves",
    "efforts",
    "locus",
    "path",
    "plan",
    "save",
    "simulation",
    "snapshots",
    "video",
    "workspace",
]


LEAST_DISTANCE = 1e-16
"""m; distances that are smaller are drawn there."""

NAMED_IMPACTS = 4
"""Impacts, the largest ones, whose impulse is written beside them."""

SHOWN_DISTANCES = 1e-6
"""Smallest distance from a plan that is shown, relative to the largest: every simulation starts with rounding."""


def main_panel(drawn: Curves) -> Panel:
    """Return the main efforts and their bounds; near a singularity they may leave the picture."""
    curves = series(drawn.main_names, drawn.t, drawn.tau, fitted=drawn.regular)
    return Panel(f"main {drawn.main_unit}", curves, limits=drawn.bounds, height=1.3)


def force_panel(drawn: Curves, events: Sequence[LimitEvent] = ()) -> Panel:
    """Return the efforts of the carriers; ``events`` are limits to mark as broken."""
    unit, limits = "torque [N·m]" if drawn.carriers_turn else "force [N]", [each.force for each in drawn.limits]
    return _carrier_panel(drawn, unit, "force", drawn.carrier_force, [(-limit, limit) for limit in limits], events)


def carrier_panels(drawn: Curves, events: Sequence[LimitEvent] = ()) -> list[Panel]:
    """Return panels of position, speed and acceleration of the carriers; ``events`` are limits to mark as broken."""
    unit, motion, limits = "rad" if drawn.carriers_turn else "m", drawn.carriers, drawn.limits
    return [
        _carrier_panel(drawn, label, quantity, values, edges, events)
        for label, quantity, values, edges in (
            (f"position s [{unit}]", "track", motion.s, [(each.lower, each.upper) for each in limits]),
            (f"speed ṡ [{unit}/s]", "speed", motion.sd, [(-each.speed, each.speed) for each in limits]),
            (f"acceleration s̈ [{unit}/s²]", "acceleration", motion.sdd,
             [(-each.acceleration, each.acceleration) for each in limits]),
        )
    ]  # fmt: skip


def _carrier_panel(
    drawn: Curves, label: str, quantity: str, values: Array, limits: ArrayLike, events: Sequence[LimitEvent]
) -> Panel:
    broken = [event for event in events if event.quantity == quantity]
    marks = tuple((event.worst, event.value, f"{event.amount:.2g} beyond") for event in broken)
    curves = series(drawn.carrier_names, drawn.t, values, carrier=True)
    return Panel(f"carrier {label}", curves, limits=limits, marks=marks)


def efforts(subject: Plan | Simulation | Curves) -> Figure:
    """Draw the main efforts and, where there are carriers, their forces, over time.

    The axis of the main efforts is fitted to regular samples: next to a singularity they grow without bound. What their
    bounds forbid is hatched, and samples that have no efforts within the bounds are shaded.

    Args:
        subject: a plan, a simulation, or ``curves`` of an inverse-dynamics computation.
    """
    drawn = curves_of(subject)
    return _over_time(drawn, [main_panel(drawn), *([force_panel(drawn)] if drawn.carriers.s.shape[1] else [])])


def carriers(subject: Plan | Simulation | Curves) -> Figure:
    """Draw position, speed and acceleration of the carriers over time; what their limits forbid is hatched.

    Args:
        subject: a plan, a simulation, or ``curves`` of an inverse-dynamics computation.

    Raises:
        InputError: the robot has no carriers.
    """
    drawn = curves_of(subject)
    if drawn.carriers.s.shape[1] == 0:
        raise InputError(f"There are no carriers to draw ({drawn.title}).", remedy="Draw the efforts instead.")
    return _over_time(drawn, carrier_panels(drawn))


def condition(subject: Plan | Simulation | Curves, *, robot: Robot | None = None) -> Figure:
    """Draw the condition number of the scaled W over time, with thresholds and singular instants.

    Args:
        subject: a plan, a simulation, or ``curves`` of an inverse-dynamics computation.
        robot: of a simulation from a file, if the files of the robot have moved, or it was changed in Python.

    Raises:
        InputError: a simulation whose robot cannot be loaded.
    """
    drawn = curves_of(subject, robot)
    if np.isnan(drawn.condition).all():
        raise InputError(
            f"The condition number is not known ({drawn.title}): the robot's files are gone, or have changed.",
            remedy="Pass the robot of the simulation: rp.plot.condition(run, robot=robot).",
        )
    return _over_time(drawn, [replace(singularity_panel(drawn), height=1.4)])


def _over_time(drawn: Curves, panels: Sequence[Panel]) -> Figure:
    return plot_panel_grid(drawn.title, [panels], None, background_of(drawn))


def singularity_panel(drawn: Curves) -> Panel:
    return condition_panel(drawn.t, drawn.condition, drawn.thresholds, singular=bool(drawn.instants))


def plan(
    plan: Plan, *, title: str | None = None, reference: Array | None = None, reference_name: str = "baseline"
) -> Figure:
    """Draw a plan: six panels over time, readable without colour.

    Left: main efforts, carrier forces, condition number. Right: position, speed and acceleration of the carriers, with
    what their limits forbid hatched and every broken limit marked. Grey shades show the phases of the planner. Drawn if
    the planner has them: its threshold (parameters ``threshold`` and ``measure``) and the singular instants
    (``Plan.findings``).

    Args:
        plan: the plan.
        title: of the figure; made from the plan when left out.
        reference: (N, m) main efforts to compare with, thin lines, N or N·m.
        reference_name: what the legend calls them.
    """
    drawn = curves_of_plan(plan)
    main, events = main_panel(drawn), plan.limits.violated
    if reference is not None:
        thin = tuple(
            Curve("" if i else reference_name, plan.t, column, reference=True) for i, column in enumerate(reference.T)
        )
        main = replace(main, curves=(*thin, *main.curves))
    columns = [[main, force_panel(drawn, events), singularity_panel(drawn)], _carrier_column(drawn, events)]
    background = replace(background_of(drawn, plan), windows=())  # the greys are those of the phases
    return plot_panel_grid(title or plan_title(plan), columns, (9.6, 7.2), background)


def _carrier_column(drawn: Curves, events: Sequence[LimitEvent] = ()) -> list[Panel]:
    """Return the panels of the carriers under one legend."""
    position, *rest = carrier_panels(drawn, events)
    return [position, *(replace(panel, legend=False) for panel in rest)]


def side_by_side(title: str, plans: Mapping[str, Plan], unit: str, *, instants: Sequence[float] = ()) -> Figure:
    """Draw plans of one motion in columns: main efforts, and s, ṡ, s̈ of the carriers with their limits.

    Each effort panel has its own scale, and its peak above it; the rows of the carriers share their scales.
    """
    columns: list[list[Panel]] = []
    for name, plan in plans.items():
        peak = f"peak {float(plan.peak_effort.max()):.3g} {unit}, {plan.status.value.replace('_', ' ')}"
        efforts = series(plan.robot.actuated, plan.t, plan.tau)
        main = Panel(f"main effort τ [{unit}]", efforts, height=1.25, title=f"{name}\n{peak}", legend=False)
        rows = [replace(panel, legend=False, shared=True) for panel in carrier_panels(curves_of_plan(plan))]
        panels = [main, *rows]
        columns.append(panels if not columns else [replace(panel, label="") for panel in panels])
    return plot_panel_grid(title, columns, (2.0 + 2.6 * len(plans), 8.0), Background(None, instants))


def simulation(
    run: Simulation, plan: Plan | None = None, *, robot: Robot | None = None, title: str | None = None
) -> Figure:
    """Draw a simulation, with its plan in thin grey lines behind it.

    Main efforts and the efforts of the carriers; forces and impulses of joint stops; with a plan the distance of the
    platform from it; position, speed and acceleration of the carriers with what their limits forbid hatched.

    Args:
        run: the simulation.
        plan: the plan that was simulated.
        robot: of a simulation from a file, if the files of the robot have moved, or it was changed in Python.
        title: of the figure; made from the simulation when left out.

    Raises:
        InputError: a plan of another kind of robot, or of other times.
        PlanFileError: the robot is gone or has changed.
    """
    drawn = curves_of(run, robot)
    left, right = [main_panel(drawn)], []
    if drawn.carrier_names:
        left, right = [*left, force_panel(drawn)], _carrier_column(drawn)
    if plan is not None:
        planned = curves_of_plan(plan)
        if (planned.main_names, planned.carrier_names) != (drawn.main_names, drawn.carrier_names):
            raise InputError(
                f"The plan is for {plan.robot.name}, the simulation of {run.robot.name}: they have other joints.",
                remedy="Pass the plan that was simulated.",
            )
        left = [_over(*both) for both in zip(left, (main_panel(planned), force_panel(planned)), strict=False)]
        left.append(_distance_panel(run, plan, robot_of_record(run.robot, robot)))
        right = [_over(*both) for both in zip(right, carrier_panels(planned), strict=False)]
    left += _stop_panels(run, robot)
    columns = [left, right] if len(left) == len(right) else [[*left, *right]]
    return plot_panel_grid(title or drawn.title, columns, None, background_of(drawn))


def _stop_panels(run: Simulation, robot: Robot | None) -> list[Panel]:
    """Return the forces of joint stops, with the impulses of impacts marked; none where no stop pushes."""
    held = np.flatnonzero((np.nan_to_num(run.stop_force) != 0.0).any(axis=0)).tolist()
    hits = sorted((event for event in run.events if event.impulse > 0.0), key=lambda event: -event.impulse)
    if not held and not hits:
        return []
    names = {i: f"joint {i + 1}" for i in held}
    with suppress(PlanFileError):
        model = robot_of_record(run.robot, robot).model
        joints = zip(list(model.names)[1:], list(model.joints)[1:], strict=True)
        names = {joint.idx_v: str(name) for name, joint in joints if joint.nv == 1}
    curves = series([names[i] for i in held], run.t, run.stop_force[:, held])
    marks = tuple(
        (event.t, 0.0, f"{event.name}: {event.impulse:.3g} N·s or N·m·s" if i < NAMED_IMPACTS else "")
        for i, event in enumerate(hits)
    )
    return [Panel("stops [N or N·m]", curves or (Curve("", run.t, np.zeros(len(run))),), marks=marks)]


def _over(panel: Panel, behind: Panel) -> Panel:
    """Return a panel with the curves of another one thin behind its own."""
    thin = tuple(replace(curve, label="" if i else "plan", reference=True) for i, curve in enumerate(behind.curves))
    return replace(panel, curves=(*thin, *panel.curves))


def _distance_panel(run: Simulation, plan: Plan, robot: Robot) -> Panel:
    during = (run.t >= plan.t[0]) & (run.t <= plan.t[-1])
    if np.count_nonzero(during) < 2:
        raise InputError(
            f"The plan runs from {plan.t[0]:.6g} to {plan.t[-1]:.6g} s, the simulation from {run.t[0]:.6g} to "
            f"{run.t[-1]:.6g} s.",
            remedy="Pass the plan that was simulated.",
        )
    away = distance(robot, run.x[during], plan.platform_at(run.t[during]).x)
    name = "angles count times the characteristic length" if angle_columns(robot) else ""
    label = "distance of the platform\nfrom its plan [m]"
    return distance_panel(label, {name: (run.t[during], away)}, SHOWN_DISTANCES)


def distance_panel(label: str, curves: Mapping[str, tuple[Array, Array]], least: float = 0.0) -> Panel:
    """Return distances (N,), m, over times (N,), s, by label, from ``least`` of the largest on; a logarithmic axis."""
    lines = tuple(
        Curve(name, t, np.maximum(away, LEAST_DISTANCE), i) for i, (name, (t, away)) in enumerate(curves.items())
    )
    top = max(float(np.nanmax(curve.value)) for curve in lines)
    return Panel(label, lines, log=True, within=(max(0.5 * LEAST_DISTANCE, least * top), 3.0 * top))


def comparison(subjects: Mapping[str, Plan | Simulation | Curves], *, title: str | None = None) -> Figure:
    """Draw the main efforts of several plans along the same motion, one panel an actuator, with their peaks.

    Of an inverse-dynamics computation, near-singular samples are left out of curves and peaks, which the title
    states: efforts grow without bound there. Efforts of a plan are bounded, and all of them count.

    Args:
        subjects: plans, simulations or ``curves`` by what the legend calls them; at most six.
        title: of the figure.

    Raises:
        InputError: none, more than there are line styles, or different numbers of actuators.
    """
    drawn = {label: curves_of(subject) for label, subject in subjects.items()}
    kinds = {(each.tau.shape[1], each.main_unit) for each in drawn.values()}
    if not 1 <= len(drawn) <= len(STROKES) or len(kinds) != 1:
        raise InputError(
            f"{len(drawn)} plans with {sorted(kinds)} actuators cannot be compared in one figure.",
            remedy=f"Pass one to {len(STROKES)} plans of the same kind of robot.",
        )
    (_, kind), first = next(iter(kinds)), next(iter(drawn.values()))
    unit = kind[kind.index("[") + 1 : -1]
    counted = {
        label: each.regular[:, None] if isinstance(subjects[label], Curves) else np.isfinite(each.tau)
        for label, each in drawn.items()
    }

    def curve(i: int, stroke: int, label: str) -> Curve:
        tau = np.where(counted[label], drawn[label].tau, np.nan)[:, i]
        peak = float(np.nanmax(np.abs(tau), initial=0.0))
        return Curve(f"{label}: peak {peak:.3g} {unit}", drawn[label].t, tau, stroke)

    panels = [
        Panel(f"{name} [{unit}]", tuple(curve(i, k, label) for k, label in enumerate(drawn)))
        for i, name in enumerate(first.main_names)
    ]
    cut = any((np.isfinite(each.tau) & ~counted[label]).any() for label, each in drawn.items())
    heading = title or first.title.partition(":")[0] + (", near-singular samples left out" if cut else "")
    within = fitted_range([curve for panel in panels for curve in panel.curves])
    return plot_time_panels(heading, [replace(panel, within=within) for panel in panels])
