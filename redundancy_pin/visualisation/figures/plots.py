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
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.dynamics.distribution import Distribution, SampleStatus
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.plan_file import load_robot_of
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.singularities.classify import classify_motion
from redundancy_pin.singularities.crossings import Crossing
from redundancy_pin.visualisation.figures.efforts import plot_comparison
from redundancy_pin.visualisation.figures.locus import draw_locus as locus
from redundancy_pin.visualisation.figures.paths import PathCurves, base_hinges, links, plot_path
from redundancy_pin.visualisation.figures.plan import draw_limits, draw_series, fit_to
from redundancy_pin.visualisation.figures.plan import plot_plan as plan
from redundancy_pin.visualisation.figures.snapshots import draw_snapshots as snapshots
from redundancy_pin.visualisation.figures.style import (
    BEYOND,
    CARRIER_STROKES,
    STROKES,
    figure,
    legend_above,
    mark_singular,
    save,
    words,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from redundancy_pin.singularities.crossings import Crossing


@dataclass(frozen=True, eq=False)
class Curves:
    """One motion with its efforts. N samples, m main actuators, k carriers.

    Attributes:
        title: one line.
        t: (N,) time, s.
        tau: (N, m) main efforts, N or N·m; NaN where there are none.
        main_unit: of the main efforts, such as ``"torque [N·m]"``.
        carrier_force: (N, k) efforts of the carriers' actuators, N.
        carriers: N samples of the carrier motion, m; rad where they turn.
        carriers_turn: whether they do.
        limits: (k,) limits of the carriers.
        condition: (N,) condition number of the scaled W.
        margin: (N,) smallest singular value of the scaled W.
        regular: (N,) samples that are neither near-singular nor singular: effort axes are scaled to these.
        instants: singular instants, s.
        thresholds: condition numbers that mean something to the motion.
    """

    title: str
    t: Array
    tau: Array
    main_unit: str
    carrier_force: Array
    carriers: CarrierMotion
    limits: tuple[CarrierLimits, ...]
    condition: Array
    margin: Array
    regular: BoolArray
    carriers_turn: bool = False
    instants: tuple[float, ...] = ()
    thresholds: tuple[float, ...] = ()

    @property
    def windows(self) -> tuple[tuple[float, float], ...]:
        """First and last time, s, of each stretch of samples below the near-singular margin."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.margin < NEAR_SINGULAR_MARGIN, [False]])))
        return tuple(
            (float(self.t[start]), float(self.t[stop - 1])) for start, stop in zip(edges[::2], edges[1::2], strict=True)
        )


def curves_of_plan(plan: Plan) -> Curves:
    """Return the curves of a plan; singular instants and threshold where its planner names them."""
    threshold = plan.parameters.get("threshold") if plan.parameters.get("measure") == "condition" else None
    return Curves(
        title=f"{plan.robot.name}: {plan.planner.replace('_', ' ')}, {words(plan.status.value)}",
        t=plan.t,
        tau=plan.tau,
        main_unit=_unit(tuple(name in plan.robot.rotating for name in plan.robot.actuated)),
        carrier_force=plan.carrier_force,
        carriers=plan.carriers,
        limits=plan.limits.judged_by,
        condition=plan.condition,
        margin=plan.margin,
        regular=plan.sample_status == SampleStatus.REGULAR,
        carriers_turn=bool(plan.robot.carriers) and set(plan.robot.carriers) <= set(plan.robot.rotating),
        instants=_numbers(plan.diagnostics.get("singular_instants")),
        thresholds=_numbers([threshold]),
    )


def curves(
    robot: Robot,
    reduced: ReducedDynamics,
    efforts: Distribution,
    carriers: CarrierMotion | None = None,
    *,
    crossings: Sequence[Crossing] = (),
    thresholds: Sequence[float] = (),
    title: str | None = None,
) -> Curves:
    """Return the curves of an inverse-dynamics computation.

    Args:
        robot: the robot.
        reduced: from ``dynamics.reduce``.
        efforts: from ``distribute``.
        carriers: what ``reduced`` was computed with; parked at zero when left out.
        crossings: from ``find_crossings`` along the same motion: where the singular instants are.
        thresholds: condition numbers to mark.
        title: the robot's name when left out.

    Raises:
        InputError: parts of different length.
    """
    samples = len(reduced.t)
    sliding = CarrierMotion.parked(samples, robot.k) if carriers is None else carriers
    if len(efforts) != samples or len(sliding) != samples or sliding.s.shape[1] != robot.k:
        raise InputError(
            f"{samples} samples of dynamics do not fit {len(efforts)} of efforts and carriers of shape "
            f"{sliding.s.shape}.",
            remedy="Pass what belongs to one motion.",
        )
    turning = tuple(not _slides(robot, name) for name in robot.actuated)
    return Curves(
        title=robot.name if title is None else title,
        t=reduced.t,
        tau=efforts.tau,
        main_unit=_unit(turning),
        carrier_force=reduced.carrier_force,
        carriers=sliding,
        limits=robot.carrier_limits,
        condition=efforts.condition,
        margin=efforts.margin,
        regular=efforts.status == SampleStatus.REGULAR,
        carriers_turn=bool(robot.carriers) and not any(_slides(robot, name) for name in robot.carriers),
        instants=tuple(crossing.t for crossing in crossings),
        thresholds=tuple(thresholds),
    )


def _slides(robot: Robot, name: str) -> bool:
    return str(robot.model.joints[robot.model.getJointId(name)].shortname()).startswith("JointModelP")


def _unit(turning: tuple[bool, ...]) -> str:
    if not any(turning):
        return "force [N]"
    return "torque [N·m]" if all(turning) else "effort [N or N·m]"


def _numbers(values: object) -> tuple[float, ...]:
    """Return the numbers of a list in plain data; none where it is something else."""
    listed = values if isinstance(values, (list, tuple)) else ()
    return tuple(float(value) for value in listed if isinstance(value, (int, float)))


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

CONDITION_TOP = 1e3
"""Largest condition number of the axis: at a singular instant it is infinite."""

_LINEAR_UP_TO = 10.0
"""Up to this condition number the axis is linear."""

_SINGLE, _MORE = 2.4, 1.7
"""Heights of a lone panel and of each of several, inches."""


def efforts(subject: Plan | Curves) -> Figure:
    """Draw the main efforts and, where there are carriers, their forces, over time.

    The axis of the main efforts is fitted to regular samples: next to a singularity they grow without bound.

    Args:
        subject: a plan, or ``curves`` of an inverse-dynamics computation.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    drawn = _curves(subject)
    k = drawn.carrier_force.shape[1]
    with figure(7.0, 1.0 + (1.6 * _MORE if k else _SINGLE) + (_MORE if k else 0.0)) as page:
        panels = list(page.subplots(2 if k else 1, 1, sharex=True, squeeze=False)[:, 0])
        draw_series(panels[0], drawn.t, drawn.tau, [f"τ{i + 1}" for i in range(drawn.tau.shape[1])])
        fit_to(panels[0], drawn.tau, drawn.regular)
        panels[0].set_ylabel(f"main {drawn.main_unit}")
        if k:
            draw_series(panels[1], drawn.t, drawn.carrier_force, _carrier_names(k), CARRIER_STROKES)
            draw_limits(
                panels[1], drawn.carrier_force, [(-limits.force, limits.force) for limits in drawn.limits], label=BEYOND
            )
            panels[1].set_ylabel("carrier torque [N·m]" if drawn.carriers_turn else "carrier force [N]")
        _finish(page, panels, drawn)
        return page


def carriers(subject: Plan | Curves) -> Figure:
    """Draw position, speed and acceleration of the carriers over time; what their limits forbid is hatched.

    Args:
        subject: a plan, or ``curves`` of an inverse-dynamics computation.

    Raises:
        InputError: the robot has no carriers.
        RedundancyPinError: matplotlib is not installed.
    """
    drawn = _curves(subject)
    k, unit = drawn.carriers.s.shape[1], "rad" if drawn.carriers_turn else "m"
    if k == 0:
        raise InputError(f"There are no carriers to draw ({drawn.title}).", remedy="Draw the efforts instead.")
    with figure(7.0, 1.0 + 3.0 * _MORE) as page:
        panels = list(page.subplots(3, 1, sharex=True, squeeze=False)[:, 0])
        for panel, values, label, bounds in (
            (panels[0], drawn.carriers.s, f"position s [{unit}]", [(each.lower, each.upper) for each in drawn.limits]),
            (panels[1], drawn.carriers.sd, f"speed ṡ [{unit}/s]", [(-each.speed, each.speed) for each in drawn.limits]),
            (
                panels[2],
                drawn.carriers.sdd,
                f"acceleration s̈ [{unit}/s²]",
                [(-each.acceleration, each.acceleration) for each in drawn.limits],
            ),
        ):
            draw_series(panel, drawn.t, values, _carrier_names(k), CARRIER_STROKES)
            draw_limits(panel, values, bounds, label=BEYOND)
            panel.set_ylabel(f"carrier {label}")
        _finish(page, panels, drawn)
        return page


def condition(subject: Plan | Curves) -> Figure:
    """Draw the condition number of the scaled W over time, with thresholds and singular instants.

    Args:
        subject: a plan, or ``curves`` of an inverse-dynamics computation.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    drawn = _curves(subject)
    with figure(7.0, 1.0 + _SINGLE) as page:
        panel = page.add_subplot()
        shown = np.minimum(np.where(np.isnan(drawn.condition), np.inf, drawn.condition), 10.0 * CONDITION_TOP)
        panel.plot(drawn.t, shown, color="#000000", linewidth=1.3, label="condition number")
        for i, threshold in enumerate(drawn.thresholds):
            stroke = STROKES[1 + i % (len(STROKES) - 1)]
            name = f"threshold {threshold:g}"
            panel.axhline(threshold, color=stroke.color, linestyle=stroke.dash, linewidth=1.1, label=name)
        top = max([float(shown.max()), *(2.0 * threshold for threshold in drawn.thresholds)])
        if drawn.instants or top > _LINEAR_UP_TO:
            panel.set_yscale("log")
            panel.set_ylim(1.0, CONDITION_TOP if drawn.instants else min(CONDITION_TOP, 1.5 * top))
        else:
            panel.set_ylim(1.0, 1.0 + 1.2 * max(top - 1.0, 0.1))
        panel.set_ylabel("condition number of W [–]")
        _finish(page, [panel], drawn)
        return page


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
        RedundancyPinError: matplotlib is not installed.
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
    found = curves_of_plan(subject) if isinstance(subject, Plan) else None
    point = followed.x[:, :2, 3] if followed.is_pose else followed.x[:, :2]
    instants = tuple(crossing.t for crossing in crossings) or (found.instants if found else ())
    places = [np.array([np.interp(t, followed.t, point[:, i]) for i in range(2)]) for t in instants]
    return plot_path(
        PathCurves(
            title=title or (found.title if found else robot.name),
            t=followed.t,
            point=point,
            links=tuple(np.stack(ends)[:, :2] for ends in links(robot, tree.q[0])),
            hinges=base_hinges(robot)[:, :2],
            condition=classify_motion(tree).condition,
            thresholds=found.thresholds if found else (),
            windows=found.windows if found else (),
            instants=instants,
            singular_points=tuple((float(place[0]), float(place[1])) for place in places),
        )
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
        RedundancyPinError: matplotlib is not installed.
    """
    drawn = {label: _curves(subject) for label, subject in subjects.items()}
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


def _curves(subject: Plan | Curves) -> Curves:
    if isinstance(subject, Plan):
        return curves_of_plan(subject)
    if not isinstance(subject, Curves):
        raise InputError(
            f"This figure draws a plan or curves, not a {type(subject).__name__}.",
            remedy="Pass a plan, or rp.plot.curves(robot, reduced, efforts).",
        )
    return subject


def _carrier_names(k: int) -> list[str]:
    return [f"carrier {i + 1}" for i in range(k)]


def _finish(page: Figure, panels: Sequence[Axes], drawn: Curves) -> None:
    """Mark singularities in every panel, put legends above and time below."""
    for i, panel in enumerate(panels):
        mark_singular(panel, drawn.windows, drawn.instants, label=i == 0)
        handles = panel.get_legend_handles_labels()[0]
        legend_above(panel, len(handles))
    page.suptitle(drawn.title, fontsize=10.5)
    panels[-1].set_xlabel("time t [s]")
    if drawn.t[-1] > drawn.t[0]:
        panels[-1].set_xlim(float(drawn.t[0]), float(drawn.t[-1]))
    page.align_ylabels(list(panels))
