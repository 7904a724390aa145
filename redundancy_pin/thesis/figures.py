"""The figures of the report as a list: file, title, caption and a call of a function of ``rp.plot``."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.dynamics.backends import RNEA
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.replay import Replay
from redundancy_pin.thesis import cases
from redundancy_pin.thesis.beyond import coarsened
from redundancy_pin.thesis.cases import EFFORT, NONE, PEAK, TASKS, Case, Plans, by_method
from redundancy_pin.thesis.measures import MotionRun, window
from redundancy_pin.thesis.table import Record
from redundancy_pin.visualisation.figures import plots
from redundancy_pin.visualisation.figures.curves import Curves, curves_of
from redundancy_pin.visualisation.figures.paths import plot_plane_paths
from redundancy_pin.visualisation.figures.time_panels import (
    Panel,
    condition_panel,
    plot_time_panels,
    series,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

IN_FRONT = ("beyond-circle-0.5", "beyond-corner-r0.025")
"""Stems of the figures on the first page of the report."""

_FINE = 2e-3
"""Between the samples of reference motions, s."""


@dataclass(frozen=True, eq=False)
class Results:
    """What was run and what came out.

    ``runs`` are the motions without a planner, ``compared`` statements of the thesis about these; ``chapters`` has the
    records of each chapter that was run, by their names in ``summary.json``.
    """

    extent: cases.Extent
    check: CrossCheckReport
    runs: tuple[MotionRun, ...]
    compared: tuple[Record, ...]
    chapters: Mapping[str, Mapping[str, Any]]
    plans: Plans
    replays: tuple[Replay, ...] = ()


class Picture(NamedTuple):
    """A figure of the results folder: stem of its files, title and caption in the report, and what draws it."""

    stem: str
    title: str
    caption: str
    draw: Callable[[], Figure]


def pictures(results: Results) -> dict[str, list[Picture]]:
    """Return all figures of what was run, by chapter; a small extent has only the figures of the first page."""
    chapters = {"motions": _motions, "planned": _thesis, "beyond": _beyond, "future": _future, "replay": _replays}
    return {
        name: [picture for picture in made(results) if results.extent.figures or picture.stem in IN_FRONT]
        for name, made in chapters.items()
        if name in ("motions", *results.chapters)
    }


# --- motions without a planner -------------------------------------------------------------------------------------


def _motions(results: Results) -> Iterator[Picture]:
    """Give efforts and path of each motion, and the same motion with parked carriers and without carriers."""
    groups: dict[str, list[MotionRun]] = {}
    for run in results.runs:
        groups.setdefault(cases.motion_name(run.case), []).append(run)
        name, title = run.case.name, f"{run.case.title}, {_moving(run)}"
        caption = f"{title}: efforts. {run.statement}."
        yield Picture(f"{name}-efforts", f"Efforts of {name}", caption, partial(efforts, run, title))
        caption, draw = f"{title}: mechanism, path and condition number.", partial(plots.path, run.robot, run.motion)
        yield Picture(f"{name}-path", f"Path of {name}", caption, partial(draw, crossings=run.crossings, title=title))
    for motion, same in groups.items():
        if len(same) > 1:
            caption = f"{same[0].case.title}: efforts with parked carriers and without carriers."
            draw = partial(plots.comparison, {_moving(run): _curves(run) for run in same}, title=same[0].case.title)
            yield Picture(f"{motion}-comparison", f"Comparison of {motion}", caption, draw)


def efforts(run: MotionRun, title: str) -> Figure:
    """Draw the efforts of a run at regular samples; tables have differences and missing forces."""
    drawn = _curves(run, title)
    return plots.efforts(replace(drawn, tau=np.where(drawn.regular[:, None], drawn.tau, np.nan)))


def _curves(run: MotionRun, title: str = "") -> Curves:
    return plots.curves(run.robot, run.reduced[RNEA], run.distribution, crossings=run.crossings, title=title)


def _moving(run: MotionRun) -> str:
    return "no carriers" if run.case.planner == "none" else "carriers parked"


# --- result figures of the thesis ----------------------------------------------------------------------------------


def profile(_: Plans, case: Case) -> Figure:
    """Draw the platform's speed and acceleration (norms)."""
    motion = case.trajectory().sample(_FINE)
    labels = {"speed |ẋ| [m/s]": motion.xd, "acceleration |ẍ| [m/s²]": motion.xdd}
    norms = np.stack([np.linalg.norm(part[:, :2], axis=1) for part in labels.values()], axis=1)
    lines = series([label.partition(" ")[0] for label in labels], motion.t, norms)
    panels = [Panel(label, (curve,)) for label, curve in zip(labels, lines, strict=True)]
    return plot_time_panels(f"{case.title}: speed and acceleration of the platform", panels)


def displacement(_: Plans, case: Case) -> Figure:
    """Draw the platform's x and y over time."""
    motion = case.trajectory().sample(_FINE)
    lines = series(("x − x(0)", "y − y(0)"), motion.t, motion.x - motion.x[0])
    panels = [Panel(f"{curve.label} [m]", (curve,)) for curve in lines]
    return plot_time_panels(f"{case.title}: displacement of the platform", panels)


def paths(plans: Plans, *several: Case) -> Figure:
    """Draw the mechanism and path of a case, with the singular points; the paths alone of several cases."""
    if len(several) == 1:
        return plots.path(plans.plan(several[0]), title=f"{several[0].title}: path and mechanism at the start")
    lines = {f"radius {case.option('radius'):g} m": case.trajectory().sample(_FINE).x[:, :2] for case in several}
    return plot_plane_paths("Corners of the 3-RRR's platform", lines)


def condition(plans: Plans, *several: Case) -> Figure:
    """Draw the condition number along the motion of cases that differ in their threshold."""
    thresholds = tuple(float(case.option("threshold")) for case in several)
    drawn, title = curves_of(plans.plan(several[0])), f"{several[0].title}: condition number"
    return plots.condition(replace(drawn, thresholds=thresholds, title=title))


def forces(plans: Plans, case: Case) -> Figure:
    """Draw the forces of the main actuators and the condition number of a crossing."""
    plan = plans.plan(case)
    drawn, before = curves_of(plan), plan.t <= float(window(plan)["exit"])
    until = series(plan.robot.actuated, plan.t[before], plan.tau[before])
    part = Panel("force τ [N], until\nswitched on", until, height=1.2)
    panels = (plots.effort_panels(drawn)[0], part, condition_panel(drawn))
    return plot_time_panels(f"{_planned(case)}: main actuators", panels, drawn)


def carriers(plans: Plans, case: Case, title: str = "") -> Figure:
    """Draw position, speed and acceleration of the carriers."""
    drawn = curves_of(plans.plan(case))
    return plots.carriers(replace(drawn, title=title or f"{_planned(case)}: carriers"))


def torques(plans: Plans, case: Case) -> Figure:
    """Draw each base torque of a stepwise plan, of the machine without carriers, and with parked ones."""
    three = {
        "no carriers": cases.without_carriers(case),
        "carriers parked": cases.parked(case),
        "carriers moving": case,
    }
    drawn = {name: plans.plan(one) for name, one in three.items()}
    return plots.comparison(drawn, title=f"{_planned(case)}: base torques")


def _planned(case: Case) -> str:
    if case.planner == "switch_off":
        return f"{case.title}, off above condition number {case.option('threshold'):g}"
    return f"{case.title}, λ = {case.option('lam'):g}, working mode (+,+,+)"


_C5, _C10, _C20, _F5, _L1, _L2, _L15 = cases.CROSSINGS
_WIDE, _WIDE_HALF, _SHARP, _, _SQUARE_HALF, _SQUARE = cases.CORNERS

THESIS: tuple[tuple[str, Callable[..., Figure], tuple[Case, ...]], ...] = (
    ("3.6", profile, (_C5,)), ("3.7", paths, (_C5,)), ("3.8", profile, (_L1,)), ("3.9", paths, (_L1,)),
    ("3.10", condition, (_C5, _C10, _C20)), ("3.11", forces, (_C5,)), ("3.12", carriers, (_C5,)),
    ("3.13", forces, (_C10,)), ("3.14", forces, (_C20,)), ("3.15", carriers, (_C20,)), ("3.16", forces, (_F5,)),
    ("3.17", carriers, (_F5,)), ("3.18", condition, (_L1,)), ("3.19", forces, (_L1,)), ("3.20", carriers, (_L1,)),
    ("3.21", forces, (_L2,)), ("3.22", forces, (_L15,)),
    ("4.2", paths, (_WIDE, _SHARP)), ("4.3", profile, (_WIDE,)), ("4.4", profile, (_SHARP,)),
    ("4.5", paths, (_SQUARE,)), ("4.6", displacement, (_SQUARE,)), ("4.7", profile, (_SQUARE,)),
    ("4.8", torques, (_WIDE,)), ("4.9", carriers, (_WIDE,)), ("4.10", torques, (_SHARP,)),
    ("4.11", carriers, (_SHARP,)),
    ("4.12", torques, (_WIDE_HALF,)), ("4.13", carriers, (_WIDE_HALF,)), ("4.14", carriers, (_WIDE_HALF,)),
    ("4.15", torques, (_SQUARE_HALF,)), ("4.16", carriers, (_SQUARE_HALF,)), ("4.17", torques, (_SQUARE,)),
    ("4.18", carriers, (_SQUARE,)),
)  # fmt: skip
"""Number in the thesis, what is drawn, of which cases. Its 3.1 to 3.5 and 4.1 are flow charts and sketches."""

_CAPTIONS: dict[Callable[..., Figure], str] = {
    profile: "Speed and acceleration of the platform.",
    displacement: "Displacement of the platform from its start.",
    paths: "Path; of one motion with the mechanism at its start, its singular points and the condition number.",
    condition: "Condition number with the thresholds; infinite at the dotted lines, the axis is cut at 1000.",
    forces: "Forces of the main actuators (positive: push; opposite in the thesis) and condition number.",
    carriers: "Position, speed and acceleration of the carriers with their limits.",
    torques: "Base torques beside the machine without carriers and with parked ones.",
}


def _thesis(results: Results) -> Iterator[Picture]:
    for number, draw, several in THESIS:
        chapter, _, count = number.partition(".")
        caption = f"{_CAPTIONS[draw]} Run: {', '.join(case.name for case in several)}."
        stem = f"figure-{chapter}-{int(count):02d}"
        yield Picture(stem, f"Figure {number}", caption, partial(draw, results.plans, *several))


# --- beyond the thesis ---------------------------------------------------------------------------------------------

_SHOWN = (NONE, cases.STEPWISE, cases.SWITCH_OFF, EFFORT, PEAK, cases.SMOOTH)
"""Methods that the figures of a motion show, left to right, where there is a plan."""


def _beyond(results: Results) -> Iterator[Picture]:
    for task in TASKS:
        caption = f"{task.title}: main efforts, and position, speed and acceleration of the carriers with their limits."
        caption += " Dotted: singular instants." if cases.crosses(task) else ""
        draw = partial(plans_of, results.plans, task, results.extent.coarser)
        yield Picture(f"beyond-{task.name}", f"Plans of {task.name}", caption, draw)


def plans_of(plans: Plans, task: Case, coarser: float) -> Figure:
    """Draw the plans of a task side by side."""
    own = [method for method in _SHOWN if method in cases.methods(task)]
    outcomes = {method: plans.outcome(by_method(task, method, coarser)) for method in own}
    existing = {method: outcome for method, outcome in outcomes.items() if isinstance(outcome, Plan)}
    instants = curves_of(existing[EFFORT]).instants if EFFORT in existing else ()
    return plots.side_by_side(task.title, existing, task.unit, instants=instants)


def _future(results: Results) -> Iterator[Picture]:
    caption = "Motion of the carriers, with their limits; dotted: the singular instant."
    for case in (cases.FUTURE[key] for key in results.extent.future):
        if case.title:
            draw = partial(carriers, results.plans, coarsened(case, results.extent), case.title)
            yield Picture(f"future-{case.robot}", case.title, caption, draw)


def _replays(results: Results) -> Iterator[Picture]:
    """Give the tracking errors of two plans that all drives replay."""
    for one in results.extent.replayed:
        distances = {run.drive: (run.t, run.error) for run in results.replays if run.plan == one.name and len(run.t)}
        if distances and one.method == EFFORT and one.task.name in ("heavy-0.5", "corner-r0.025"):
            caption = f"Distance of the platform from its plan ({one.name}), for each drive."
            panel = replace(plots.distance_panel("distance from the plan [m]", distances), height=1.8)
            draw = partial(plot_time_panels, one.task.title, [panel])
            yield Picture(f"replay-{one.task.name}", f"Replay of {one.task.name}", caption, draw)
