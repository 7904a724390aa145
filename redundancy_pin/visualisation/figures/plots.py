"""Figures for papers: ``rp.plot``. Every function returns a matplotlib ``Figure``; ``save`` writes SVG, PNG or PDF.

One look for all: the same colour and line style for the same actuator, units on every axis, line styles that tell the
curves apart in print without colour, singular instants dotted, near-singular stretches grey, what is forbidden hatched.

    efforts     main efforts and carrier forces              of a plan or of ``curves``
    carriers    position, speed, acceleration with limits     of a plan or of ``curves``
    condition   condition number, thresholds, instants        of a plan or of ``curves``
    plan        all of these on one page                      of a plan
    path        the mechanism and where its platform goes     of a plan or a motion
    snapshots   the mechanism at several instants             of a plan, a motion or a robot's ``View``
    locus       singular curves over the workspace            of ``singular_locus``
    comparison  the efforts of several plans                  of plans or ``curves``

All raise ``RedundancyPinError`` where matplotlib is not installed. A new figure over time is a function here that lists
its panels: ``time_panels`` says how.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.plan import Plan, load_robot_of
from redundancy_pin.robot import Robot
from redundancy_pin.singularities.classify import classify_motion
from redundancy_pin.singularities.crossings import Crossing
from redundancy_pin.visualisation.figures.comparisons import plot_comparison
from redundancy_pin.visualisation.figures.curves import (
    Curves,
    carrier_panels,
    curves,
    curves_of,
    curves_of_plan,
    force_panel,
    main_panel,
    numbers,
    plan_title,
    singularity_panel,
)
from redundancy_pin.visualisation.figures.paths import draw_locus as locus
from redundancy_pin.visualisation.figures.paths import plot_path
from redundancy_pin.visualisation.figures.snapshots import draw_snapshots as snapshots
from redundancy_pin.visualisation.figures.style import STROKES, save
from redundancy_pin.visualisation.figures.time_panels import Background, Curve, plot_panel_grid, plot_time_panels
from redundancy_pin.visualisation.viewer.parts import base_hinges, links

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
    "snapshots",
]


def efforts(subject: Plan | Curves) -> Figure:
    """Draw the main efforts and, where there are carriers, their forces, over time.

    The axis of the main efforts is fitted to regular samples: next to a singularity they grow without bound.

    Args:
        subject: a plan, or ``curves`` of an inverse-dynamics computation.
    """
    drawn = curves_of(subject)
    panels = [main_panel(drawn), *([force_panel(drawn)] if drawn.carriers.s.shape[1] else [])]
    return plot_time_panels(drawn.title, panels, instants=drawn.instants, windows=drawn.windows)


def carriers(subject: Plan | Curves) -> Figure:
    """Draw position, speed and acceleration of the carriers over time; what their limits forbid is hatched.

    Args:
        subject: a plan, or ``curves`` of an inverse-dynamics computation.

    Raises:
        InputError: the robot has no carriers.
    """
    drawn = curves_of(subject)
    if drawn.carriers.s.shape[1] == 0:
        raise InputError(f"There are no carriers to draw ({drawn.title}).", remedy="Draw the efforts instead.")
    return plot_time_panels(drawn.title, carrier_panels(drawn), instants=drawn.instants, windows=drawn.windows)


def condition(subject: Plan | Curves) -> Figure:
    """Draw the condition number of the scaled W over time, with thresholds and singular instants.

    Args:
        subject: a plan, or ``curves`` of an inverse-dynamics computation.
    """
    drawn = curves_of(subject)
    panel = replace(singularity_panel(drawn), height=1.4)
    return plot_time_panels(drawn.title, [panel], instants=drawn.instants, windows=drawn.windows)


def plan(
    plan: Plan, *, title: str | None = None, reference: Array | None = None, reference_name: str = "baseline"
) -> Figure:
    """Draw a plan: six panels over time, readable without colour.

    Left: main efforts, carrier forces, condition number. Right: position, speed and acceleration of the carriers, with
    what their limits forbid hatched and every broken limit marked. Grey shades tell the phases of the planner. Drawn if
    the planner has them: its threshold (parameters ``threshold`` and ``measure``) and the singular instants
    (diagnostics ``singular_instants``).

    Args:
        plan: the plan.
        title: of the figure; made from the plan when left out.
        reference: (N, m) main efforts to compare with, thin lines, N or N·m.
        reference_name: what the legend calls them.
    """
    drawn = curves_of_plan(plan)
    main, bounds = main_panel(drawn), numbers(plan.parameters.get("effort"))
    if len(bounds) == len(plan.robot.actuated):
        main = replace(main, limits=[(-bound, bound) for bound in bounds])
    if reference is not None:
        thin = tuple(
            Curve("" if i else reference_name, plan.t, column, reference=True) for i, column in enumerate(reference.T)
        )
        main = replace(main, curves=(*thin, *main.curves))
    events = plan.limits.violated
    left = [main, force_panel(drawn, events), singularity_panel(drawn)]
    position, *rest = carrier_panels(drawn, events)
    right = [position, *(replace(panel, legend=False) for panel in rest)]
    return plot_panel_grid(title or plan_title(plan), [left, right], (9.6, 7.2), Background(plan, drawn.instants))


def path(
    subject: Plan | Robot,
    motion: PlatformMotion | None = None,
    *,
    crossings: Sequence[Crossing] = (),
    title: str | None = None,
) -> Figure:
    """Draw the mechanism at the start of a motion, the path of its platform in x and y, and the condition number.

    Args:
        subject: a plan, or the robot that the motion is for.
        motion: of a robot.
        crossings: from ``find_crossings`` along the same motion, to mark.
        title: of the figure.

    Raises:
        InputError: a plan with a motion, a robot without one, or a platform without x and y.
        PlanFileError: the robot of the plan is gone or has changed.
    """
    if isinstance(subject, Plan) is (motion is not None):
        raise InputError(
            "path draws a plan, or a robot with a motion.", remedy="Pass path(plan) or path(robot, motion)."
        )
    robot = load_robot_of(subject) if isinstance(subject, Plan) else subject
    followed = subject.motion if isinstance(subject, Plan) else motion
    if followed is None or robot.platform is None or robot.platform.axes[:2] != ("x", "y"):
        raise InputError(f"The platform of {robot.name} does not move in x and y.", remedy="Use rp.show to see it.")
    tree = lift(robot, followed)
    planned = curves_of_plan(subject) if isinstance(subject, Plan) else None
    point = followed.x[:, :2, 3] if followed.is_pose else followed.x[:, :2]
    instants = tuple(crossing.t for crossing in crossings) or (planned.instants if planned else ())
    places = [np.array([np.interp(t, followed.t, point[:, i]) for i in range(2)]) for t in instants]
    return plot_path(
        title or (planned.title if planned else robot.name),
        followed.t,
        point,
        [np.stack(ends)[:, :2] for ends in links(robot, tree.q[0])],
        base_hinges(robot)[:, :2],
        classify_motion(tree).condition,
        thresholds=planned.thresholds if planned else (),
        windows=planned.windows if planned else (),
        instants=instants,
        singular_points=places,
    )


def comparison(subjects: Mapping[str, Plan | Curves], *, title: str | None = None) -> Figure:
    """Draw the main efforts of several plans along the same motion, one panel an actuator, with their peaks.

    Of an inverse-dynamics computation, near-singular samples are left out of curves and peaks, and the title says so:
    efforts grow without bound there. Those of a plan are bounded, and all of them count.

    Args:
        subjects: plans or ``curves`` by what the legend calls them; at most six.
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
    (m, unit), first = next(iter(kinds)), next(iter(drawn.values()))
    names = tuple(f"τ{i + 1}" for i in range(m))
    cases, cut = {}, False
    for label, each in drawn.items():
        counts = np.isfinite(each.tau) if isinstance(subjects[label], Plan) else each.regular[:, None]
        cut = cut or not counts.all()
        cases[label] = (each.t, np.where(counts, each.tau, np.nan))
    heading = title or first.title.partition(":")[0] + (", near-singular samples left out" if cut else "")
    return plot_comparison(heading, names, unit.partition("[")[2].rstrip("]"), cases)
