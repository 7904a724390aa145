"""Figures for papers: ``rp.plot``. Functions return a matplotlib ``Figure``; ``save`` writes SVG, PNG or PDF.

One look for all: the same colour and line style for the same actuator, units on every axis, line styles that
distinguish the curves in print without colour, singular instants dotted, phases or near-singular intervals grey,
forbidden ranges hatched.

    efforts     main efforts and carrier forces               of a plan, a simulation or ``curves``
    carriers    position, speed, acceleration with limits     of a plan, a simulation or ``curves``
    condition   condition number, thresholds, instants        of a plan, a simulation or ``curves``
    overview    all of these on one page                      of a plan, or a simulation over its plan
    comparison  the main efforts of several motions           of plans, simulations or ``curves``
    path        the mechanism and the path of its platform    of a plan, a simulation or a motion
    snapshots   the mechanism at several instants             of a plan's, a simulation's or a robot's ``View``
    workspace   singular curves, reachable poses, margins     of ``singular_locus`` or ``workspace``
    video       the moving picture as .gif or .mp4            of a plan's, a simulation's or a robot's ``View``

A new figure over time is a function here that lists its panels; ``time_panels`` has an example.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, require_type
from redundancy_pin.errors import InputError, PlanFileError
from redundancy_pin.kinematics.coordinates import angle_columns, distance
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import robot_of_record
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.result import Simulation
from redundancy_pin.visualisation.figures.curves import Curves, curves, curves_of, plan_title
from redundancy_pin.visualisation.figures.maps import plot_workspace as workspace
from redundancy_pin.visualisation.figures.paths import plot_path as path
from redundancy_pin.visualisation.figures.paths import plot_snapshots as snapshots
from redundancy_pin.visualisation.figures.style import BEHIND, CARRIER_STROKES, STROKES, save
from redundancy_pin.visualisation.figures.time_panels import (
    Curve,
    Panel,
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
    "overview",
    "path",
    "save",
    "snapshots",
    "video",
    "workspace",
]

LEAST_DISTANCE = 1e-16
"""m; smaller distances are drawn there."""

NAMED_IMPACTS = 4
"""Number of impacts, the largest ones, with their impulse as text."""

SHOWN_DISTANCES = 1e-6
"""Smallest distance from a plan that is shown, relative to the largest: simulations start with rounding errors."""


def efforts(subject: Plan | Simulation | Curves) -> Figure:
    """Draw the main efforts and, where there are carriers, their forces, over time.

    The axis of the main efforts is fitted to regular samples: near a singularity they grow without bound. Values beyond
    their bounds are hatched, and samples without efforts within the bounds are shaded.

    Args:
        subject: a plan, a simulation, or ``curves`` of an inverse-dynamics computation.

    Example:
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner().sample(0.02))
        >>> figure = rp.plot.efforts(plan)
    """
    drawn = curves_of(subject)
    return plot_time_panels(drawn.title, effort_panels(drawn), drawn)


def carriers(subject: Plan | Simulation | Curves) -> Figure:
    """Draw position, speed and acceleration of the carriers over time; values beyond their limits are hatched.

    Args:
        subject: a plan, a simulation, or ``curves`` of an inverse-dynamics computation.

    Raises:
        InputError: the robot has no carriers.

    Example:
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner().sample(0.02))
        >>> figure = rp.plot.carriers(plan)
    """
    drawn = curves_of(subject)
    if not drawn.carrier_names:
        raise InputError(f"There are no carriers to draw ({drawn.title}).", remedy="Draw the efforts instead.")
    return plot_time_panels(drawn.title, carrier_panels(drawn), drawn)


def condition(subject: Plan | Simulation | Curves, *, robot: Robot | None = None) -> Figure:
    """Draw the condition number of the scaled W over time, with thresholds and singular instants.

    Args:
        subject: a plan, a simulation, or ``curves`` of an inverse-dynamics computation.
        robot: of a simulation from a file, if the files of the robot have moved, or it was changed in Python.

    Raises:
        InputError: a simulation whose robot cannot be loaded.

    Example:
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner().sample(0.02))
        >>> figure = rp.plot.condition(plan)
    """
    drawn = curves_of(subject, robot)
    if np.isnan(drawn.condition).all():
        raise InputError(
            f"The condition number is not known ({drawn.title}): the robot's files are gone, or have changed.",
            remedy="Pass the robot of the simulation: rp.plot.condition(run, robot=robot).",
        )
    return plot_time_panels(drawn.title, [replace(condition_panel(drawn), height=1.4)], drawn)


def overview(
    subject: Plan | Simulation, plan: Plan | None = None, *, robot: Robot | None = None, title: str | None = None
) -> Figure:
    """Draw a plan or a simulation on one page, with another plan in thin grey lines behind it.

    Main efforts, carrier forces, and position, speed and acceleration of the carriers with their limits. Of a plan also
    the condition number, every broken limit, and the phases; the planner's threshold and the singular instants, if it
    has them. Of a simulation also forces and impulses of joint stops and, with its plan, the distance of the platform
    from it.

    Args:
        subject: a plan or a simulation.
        plan: the plan that was simulated, or one to compare with.
        robot: of a simulation from a file, if the files of the robot have moved, or it was changed in Python.
        title: of the figure; made from the subject when left out.

    Raises:
        InputError: a plan of another kind of robot, or of other times.
        PlanFileError: the robot is gone or has changed.

    Example:
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner().sample(0.02))
        >>> figure = rp.plot.overview(plan)
        >>> figure = rp.plot.overview(rp.simulate(rp.load_robot("3rrr"), plan, duration=0.1), plan)
    """
    remedy = "Pass rp.load_plan(...) or rp.simulation.load_simulation(...)."
    require_type(subject, (Plan, Simulation), "A plan or a simulation", remedy)
    require_type(plan, (Plan, type(None)), "The plan of a simulation, or one to compare with", "Pass load_plan(...).")
    drawn, events = curves_of(subject, robot), subject.limits.violated if isinstance(subject, Plan) else ()
    left, right = effort_panels(drawn, events), carrier_panels(drawn, events) if drawn.carrier_names else []
    if plan is not None:
        planned = curves_of(plan)
        if (planned.main_names, planned.carrier_names) != (drawn.main_names, drawn.carrier_names):
            kind = "plan" if isinstance(subject, Plan) else "simulation"
            raise InputError(
                f"The plan is for {plan.robot.name}, the {kind} of {subject.robot.name}: they have other joints.",
                remedy="Pass the plan that was simulated.",
            )
        left = [_over(*both) for both in zip(left, effort_panels(planned), strict=True)]
        right = [_over(*both) for both in zip(right, carrier_panels(planned), strict=False)]
    if isinstance(subject, Plan):
        left.append(condition_panel(drawn))
    else:
        if plan is not None:
            left.append(_distance_panel(subject, plan, robot_of_record(subject.robot, robot)))
        left += _stop_panels(subject, robot)
    right = [*right[:1], *(replace(panel, legend=False) for panel in right[1:])]
    columns = [left, right] if len(left) == len(right) else [[*left, *right]]
    heading = title or (plan_title(subject) if isinstance(subject, Plan) else drawn.title)
    return plot_panel_grid(heading, columns, drawn)


def comparison(subjects: Mapping[str, Plan | Simulation | Curves], *, title: str | None = None) -> Figure:
    """Draw the main efforts of several plans along the same motion, one panel per actuator, with their peaks.

    Of an inverse-dynamics computation, near-singular samples are left out of curves and peaks, which the title
    states: efforts grow without bound there. Efforts of a plan are bounded, and all of them count.

    Args:
        subjects: plans, simulations or ``curves`` by their label in the legend; at most six.
        title: of the figure.

    Raises:
        InputError: none, more than there are line styles, or different numbers of actuators.

    Example:
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner().sample(0.02))
        >>> run = rp.simulate(rp.load_robot("3rrr"), plan, duration=0.1)
        >>> figure = rp.plot.comparison({"planned": plan, "simulated": run})
    """
    drawn = {label: curves_of(subject) for label, subject in subjects.items()}
    kinds = {(each.tau.shape[1], each.main_unit) for each in drawn.values()}
    if not 1 <= len(drawn) <= len(STROKES) or len(kinds) != 1:
        raise InputError(
            f"{len(drawn)} plans with {sorted(kinds)} actuators cannot be compared in one figure.",
            remedy=f"Pass one to {len(STROKES)} plans of the same kind of robot.",
        )
    first = next(iter(drawn.values()))
    unit = first.main_unit.partition("[")[2].rstrip("]")
    counted = {
        label: each.regular[:, None] if isinstance(subjects[label], Curves) else np.isfinite(each.tau)
        for label, each in drawn.items()
    }
    tau = {label: np.where(counted[label], each.tau, np.nan) for label, each in drawn.items()}

    def panel(i: int, name: str) -> Panel:
        labels = [f"{label}: peak {np.nanmax(np.abs(tau[label][:, i]), initial=0.0):.3g} {unit}" for label in drawn]
        lines = zip(labels, drawn.values(), tau.values(), STROKES, strict=False)
        return Panel(f"{name} [{unit}]", tuple(Curve(label, each.t, of[:, i], s) for label, each, of, s in lines))

    panels = [panel(i, name) for i, name in enumerate(first.main_names)]
    cut = any((np.isfinite(each.tau) & ~counted[label]).any() for label, each in drawn.items())
    heading = title or first.title.partition(":")[0] + (", near-singular samples left out" if cut else "")
    within = fitted_range([curve for panel in panels for curve in panel.curves])
    return plot_time_panels(heading, [replace(panel, within=within) for panel in panels])


def side_by_side(title: str, plans: Mapping[str, Plan], unit: str, *, instants: Sequence[float] = ()) -> Figure:
    """Draw plans of one motion in columns: main efforts, and s, ṡ, s̈ of the carriers with their limits.

    Each effort panel has its own scale, and its peak above it; the rows of the carriers share their scales.
    """
    columns: list[list[Panel]] = []
    for name, plan in plans.items():
        peak = f"peak {float(plan.peak_effort.max()):.3g} {unit}, {plan.status.value.replace('_', ' ')}"
        main = Panel(f"main effort τ [{unit}]", series(plan.robot.actuated, plan.t, plan.tau), height=1.25,
                     title=f"{name}\n{peak}", legend=False)  # fmt: skip
        rows = [replace(panel, legend=False, shared=True) for panel in carrier_panels(curves_of(plan))]
        panels = [main, *rows]
        columns.append(panels if not columns else [replace(panel, label="") for panel in panels])
    behind = replace(curves_of(next(iter(plans.values()))), instants=tuple(instants))
    return plot_panel_grid(title, columns, behind, size=(2.0 + 2.6 * len(plans), 8.0), shaded=False)


# --- panels ---------------------------------------------------------------------------------------------------------


def effort_panels(drawn: Curves, events: Sequence[LimitEvent] = ()) -> list[Panel]:
    """Return panels of the main efforts and, where there are carriers, of their efforts; ``events`` are marked."""
    lines = series(drawn.main_names, drawn.t, drawn.tau)
    main = tuple(replace(line, fitted=drawn.regular) for line in lines)  # others may leave the picture
    panels = [Panel(f"main {drawn.main_unit}", main, limits=drawn.bounds, height=1.3)]
    if drawn.carrier_names:
        unit, limits = "torque [N·m]" if drawn.carriers_turn else "force [N]", [each.force for each in drawn.limits]
        ends = [(-limit, limit) for limit in limits]
        panels.append(_carrier_panel(drawn, unit, "force", drawn.carrier_force, ends, events))
    return panels


def carrier_panels(drawn: Curves, events: Sequence[LimitEvent] = ()) -> list[Panel]:
    """Return panels of position, speed and acceleration of the carriers; ``events`` are marked as broken limits."""
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
    lines = series(drawn.carrier_names, drawn.t, values, CARRIER_STROKES)
    return Panel(f"carrier {label}", lines, limits=limits, marks=marks)


def _over(panel: Panel, behind: Panel) -> Panel:
    """Return a panel with the curves of another one thin behind its own."""
    thin = tuple(replace(curve, label="" if i else "plan", stroke=BEHIND) for i, curve in enumerate(behind.curves))
    return replace(panel, curves=(*thin, *panel.curves))


def _stop_panels(run: Simulation, robot: Robot | None) -> list[Panel]:
    """Return the forces of joint stops, with the impulses of impacts marked; none where no stop pushes."""
    active = np.flatnonzero((np.nan_to_num(run.stop_force) != 0.0).any(axis=0)).tolist()
    hits = sorted((event for event in run.events if event.impulse > 0.0), key=lambda event: -event.impulse)
    if not active and not hits:
        return []
    names = {i: f"joint {i + 1}" for i in active}
    with suppress(PlanFileError):
        model = robot_of_record(run.robot, robot).model
        joints = zip(list(model.names)[1:], list(model.joints)[1:], strict=True)
        names = {joint.idx_v: str(name) for name, joint in joints if joint.nv == 1}
    lines = series([names[i] for i in active], run.t, run.stop_force[:, active])
    marks = tuple(
        (event.t, 0.0, f"{event.name}: {event.impulse:.3g} N·s or N·m·s" if i < NAMED_IMPACTS else "")
        for i, event in enumerate(hits)
    )
    return [Panel("stops [N or N·m]", lines or (Curve("", run.t, np.zeros(len(run))),), marks=marks)]


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


def distance_panel(label: str, lines: Mapping[str, tuple[Array, Array]], least: float = 0.0) -> Panel:
    """Return distances (N,), m, over times (N,), s, by label, from ``least`` of the largest on; a logarithmic axis."""
    drawn = tuple(
        Curve(name, t, np.maximum(away, LEAST_DISTANCE), stroke)
        for (name, (t, away)), stroke in zip(lines.items(), STROKES, strict=False)
    )
    top = max(float(np.nanmax(curve.value)) for curve in drawn)
    return Panel(label, drawn, log=True, within=(max(0.5 * LEAST_DISTANCE, least * top), 3.0 * top))
