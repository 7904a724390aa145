"""Results of the main job, and its figures as a list: file, caption, function and cases."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from redundancy_pin.crosscheck import CrossCheckReport
from redundancy_pin.dynamics.backends import RNEA
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.replay import Replay
from redundancy_pin.status import ResultStatus
from redundancy_pin.thesis import cases, future
from redundancy_pin.thesis.case import Case, Plans
from redundancy_pin.thesis.cases import EFFORT, NONE, PEAK, STEPWISE, SWITCH_OFF, TASKS, by_method, without_carriers
from redundancy_pin.thesis.measures import MotionRun, rms_acceleration, window
from redundancy_pin.thesis.table import Record, mode_text
from redundancy_pin.visualisation.figures import plots
from redundancy_pin.visualisation.figures.curves import Curves, curves_of_plan
from redundancy_pin.visualisation.figures.paths import plot_plane_paths
from redundancy_pin.visualisation.figures.style import STROKES, figure, legend_above, log_scale
from redundancy_pin.visualisation.figures.time_panels import (
    Background,
    Curve,
    Panel,
    plot_panel_grid,
    plot_time_panels,
    series,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[..., "Figure"]
"""Draws results, given what picks a part of them: a run, a task, or cases of plans."""

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
    """A figure of the results folder: stem of its files, title and caption in the report, and its function."""

    stem: str
    title: str
    caption: str
    function: Draw
    given: tuple[Any, ...] = ()

    def draw(self, results: Results) -> Figure:
        """Draw it."""
        return self.function(results, *self.given)


# --- motions without a planner -------------------------------------------------------------------------------------


def motion_pictures(results: Results) -> Iterator[Picture]:
    """Give the figures of the motions without a planner: efforts and path of each, and cases side by side."""
    for run in results.runs:
        name, title = run.case.name, f"{run.case.title}, {_carriers(run.case)}"
        caption = f"{title}: efforts. {run.statement}."
        yield Picture(f"{name}-efforts", f"Efforts of {name}", caption, effort_figure, (run, title))
        caption = f"{title}: mechanism, path and condition number."
        yield Picture(f"{name}-path", f"Path of {name}", caption, path_figure, (run, title))
    for motion in dict.fromkeys(cases.motion_name(run.case) for run in results.runs):
        same = [run for run in results.runs if cases.motion_name(run.case) == motion]
        if len(same) > 1:
            caption = f"{same[0].case.title}: efforts with parked carriers and without carriers."
            yield Picture(f"{motion}-comparison", f"Comparison of {motion}", caption, comparison_figure, (same,))


def effort_figure(_: Results, run: MotionRun, title: str) -> Figure:
    """Draw the efforts of a run at regular samples; tables have differences and missing forces."""
    drawn = _curves(run, title)
    return plots.efforts(replace(drawn, tau=np.where(drawn.regular[:, None], drawn.tau, np.nan)))


def path_figure(_: Results, run: MotionRun, title: str) -> Figure:
    """Return the mechanism, the path and the condition number of a run."""
    return plots.path(run.robot, run.motion, crossings=run.crossings, title=title)


def comparison_figure(_: Results, runs: Sequence[MotionRun]) -> Figure:
    """Return the efforts of several runs along one motion."""
    return plots.comparison({_carriers(run.case): _curves(run) for run in runs}, title=runs[0].case.title)


def _curves(run: MotionRun, title: str = "") -> Curves:
    return plots.curves(run.robot, run.reduced[RNEA], run.distribution, crossings=run.crossings, title=title)


def _carriers(case: Case) -> str:
    return "no carriers" if case.planner == "none" else "carriers parked"


# --- result figures of the thesis ----------------------------------------------------------------------------------


def profile(_: Results, case: Case) -> Figure:
    """Draw the platform's speed and acceleration (norms)."""
    motion = case.trajectory().sample(_FINE)
    labels = {"speed |ẋ| [m/s]": motion.xd, "acceleration |ẍ| [m/s²]": motion.xdd}
    panels = [
        Panel(label, (Curve(label.partition(" ")[0], motion.t, np.linalg.norm(part[:, :2], axis=1), i),))
        for i, (label, part) in enumerate(labels.items())
    ]
    return plot_time_panels(f"{case.title}: speed and acceleration of the platform", panels)


def displacement(_: Results, case: Case) -> Figure:
    """Draw the platform's x and y over time."""
    motion = case.trajectory().sample(_FINE)
    lines = series(("x − x(0)", "y − y(0)"), motion.t, motion.x - motion.x[0])
    panels = [Panel(f"{curve.label} [m]", (curve,)) for curve in lines]
    return plot_time_panels(f"{case.title}: displacement of the platform", panels)


def paths(results: Results, *several: Case) -> Figure:
    """Draw the mechanism and path of a case, with the singular points; the paths alone of several cases."""
    if len(several) == 1:
        return plots.path(results.plans.plan(several[0]), title=f"{several[0].title}: path and mechanism at the start")
    lines = {f"radius {case.option('radius'):g} m": case.trajectory().sample(_FINE).x[:, :2] for case in several}
    return plot_plane_paths("Corners of the 3-RRR's platform", lines)


def condition(results: Results, *several: Case) -> Figure:
    """Draw the condition number along the motion of cases that differ in their threshold."""
    thresholds = tuple(float(case.option("threshold")) for case in several)
    drawn, title = curves_of_plan(results.plans.plan(several[0])), f"{several[0].title}: condition number"
    return plots.condition(replace(drawn, thresholds=thresholds, title=title))


def forces(results: Results, case: Case) -> Figure:
    """Draw the forces of the main actuators and the condition number of a crossing."""
    plan = results.plans.plan(case)
    drawn, before = curves_of_plan(plan), plan.t <= float(window(plan)["exit"])
    until = series(plan.robot.actuated, plan.t[before], plan.tau[before])
    part = Panel("force τ [N], until\nswitched on", until, height=1.2)
    panels = (plots.main_panel(drawn), part, plots.singularity_panel(drawn))
    return plot_time_panels(f"{_planned(case)}: main actuators", panels, plan=plan, instants=drawn.instants)


def carriers(results: Results, case: Case) -> Figure:
    """Draw position, speed and acceleration of the carriers."""
    drawn = curves_of_plan(results.plans.plan(case))
    return plots.carriers(replace(drawn, title=f"{_planned(case)}: carriers"))


def torques(results: Results, case: Case) -> Figure:
    """Draw each base torque of a stepwise plan, of the machine without carriers, and with parked ones."""
    three = {"no carriers": without_carriers(case), "carriers parked": cases.parked(case), "carriers moving": case}
    plans = {name: results.plans.plan(one) for name, one in three.items()}
    return plots.comparison(plans, title=f"{_planned(case)}: base torques")


def _planned(case: Case) -> str:
    if case.planner == "switch_off":
        return f"{case.title}, off above condition number {case.option('threshold'):g}"
    return f"{case.title}, λ = {case.option('lam'):g}, working mode (+,+,+)"


_C5, _C10, _C20, _F5, _L1, _L2, _L15 = cases.CROSSINGS
_WIDE, _WIDE_HALF, _SHARP, _, _SQUARE_HALF, _SQUARE = cases.CORNERS

THESIS: tuple[tuple[str, Draw, tuple[Case, ...]], ...] = (
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

_CAPTIONS: dict[Draw, str] = {
    profile: "Speed and acceleration of the platform.",
    displacement: "Displacement of the platform from its start.",
    paths: "Path; of one motion with the mechanism at its start, its singular points and the condition number.",
    condition: "Condition number with the thresholds; infinite at the dotted lines, the axis is cut at 1000.",
    forces: "Forces of the main actuators (positive: push; opposite in the thesis) and condition number.",
    carriers: "Position, speed and acceleration of the carriers with their limits.",
    torques: "Base torques beside the machine without carriers and with parked ones.",
}


def thesis_pictures(_results: Results) -> Iterator[Picture]:
    """Give the result figures of the thesis."""
    for number, draw, several in THESIS:
        chapter, _, count = number.partition(".")
        caption = f"{_CAPTIONS[draw]} Run: {', '.join(case.name for case in several)}."
        yield Picture(f"figure-{chapter}-{int(count):02d}", f"Figure {number}", caption, draw, several)


# --- beyond the thesis ---------------------------------------------------------------------------------------------

_SHOWN = (NONE, STEPWISE, SWITCH_OFF, EFFORT, PEAK, cases.SMOOTH)
"""Methods that the figures of a motion show, left to right, where there is a plan."""


def beyond_pictures(_: Results) -> Iterator[Picture]:
    """Give the figures of the chapter beyond the thesis."""
    for task in TASKS:
        caption = f"{task.title}: main efforts, and position, speed and acceleration of the carriers with their limits."
        caption += " Dotted: singular instants." if cases.crosses(task) else ""
        yield Picture(f"beyond-{task.name}", f"Plans of {task.name}", caption, task_figure, (task,))
    caption = "Largest main force of the plans of least effort over speed: every speed that has a plan (dots), and "
    caption += "those without (crosses, on the lower edge)."
    yield Picture("beyond-fastest", "Fastest motions", caption, fastest_figure)
    for radius in (float(task.option("radius")) for task in cases.TURNS[:2]):
        title = f"Working modes, radius {radius:g} m"
        caption = f"Largest |τ| at the corner of radius {radius:g} m in every working mode, at the samples or between "
        caption += "them. Stepwise plans leave the carriers where they are; the others bring them back."
        yield Picture(f"beyond-modes-r{radius:g}", title, caption, modes_figure, (radius,))
    caption = "Main effort against the carriers' acceleration: each point is the optimum for one weight."
    yield Picture("beyond-trade-off", "Trade-off", caption, trade_figure)


def _existing(results: Results, task: Case) -> dict[str, Plan]:
    """Return the plans of a task that are shown and exist, by method."""
    methods = {record["way"] for record in results.chapters["beyond"]["plans"] if record["task"] == task.name}
    shown = {method: by_method(task, method, results.extent.coarser) for method in _SHOWN if method in methods}
    outcomes = {method: results.plans.outcome(case) for method, case in shown.items()}
    return {method: outcome for method, outcome in outcomes.items() if isinstance(outcome, Plan)}


def task_figure(results: Results, task: Case) -> Figure:
    """Draw the plans of a task side by side."""
    plans = _existing(results, task)
    instants = curves_of_plan(plans[EFFORT]).instants if EFFORT in plans else ()
    return side_by_side(task.title, plans, task.unit, instants=instants)


def side_by_side(title: str, plans: Mapping[str, Plan], unit: str, *, instants: Sequence[float] = ()) -> Figure:
    """Draw plans of one motion in columns: main efforts, and s, ṡ, s̈ of the carriers with their limits.

    Each effort panel has its own scale, and its peak above it; the rows of the carriers share their scales.
    """
    columns: list[list[Panel]] = []
    for name, plan in plans.items():
        peak = f"peak {float(plan.peak_effort.max()):.3g} {unit}, {plan.status.value.replace('_', ' ')}"
        efforts = series(plan.robot.actuated, plan.t, plan.tau)
        main = Panel(f"main effort τ [{unit}]", efforts, height=1.25, title=f"{name}\n{peak}", legend=False)
        rows = [replace(panel, legend=False, shared=True) for panel in plots.carrier_panels(curves_of_plan(plan))]
        panels = [main, *rows]
        columns.append(panels if not columns else [replace(panel, label="") for panel in panels])
    return plot_panel_grid(title, columns, (2.0 + 2.6 * len(plans), 8.0), Background(None, instants))


def modes_figure(results: Results, radius: float) -> Figure:
    """Draw the peaks at a corner in every working mode as bars; a missing bar is a missing plan."""
    records = [record for record in results.chapters["beyond"]["working_modes"] if record["radius"] == radius]
    bars = zip((NONE, STEPWISE, EFFORT, PEAK), STROKES, ("", "///", "...", "xxx"), strict=False)
    places = np.arange(len(records))
    with figure(8.8, 3.6, f"3-RRR, corner of radius {radius:g} m: largest torque in every working mode") as drawn:
        axes = drawn.subplots()
        for i, (method, stroke, hatch) in enumerate(bars):
            peaks = np.nan_to_num([record["rows"][method]["worst"] for record in records])
            axes.bar(places + 0.2 * (i - 1.5), peaks, 0.2, color=stroke.color, hatch=hatch, label=method)
        log_scale(axes)
        axes.set_xticks(places, [mode_text(record["mode"]) for record in records])
        axes.set(xlabel="working mode", ylabel="largest |τ| [N·m]")
        legend_above(axes, 8.0)
        return drawn


def fastest_figure(results: Results) -> Figure:
    """Draw the largest main force over speed, with crosses on the lower edge for speeds without a plan."""
    with figure(7.0, 4.6, "2-RPR: largest main force over speed, carriers within their limits") as drawn:
        axes = drawn.subplots()
        for stroke, race in zip(STROKES, results.chapters["beyond"]["fastest"], strict=False):
            cap = "" if np.isinf(race["effort_limit"]) else f", up to {race['effort_limit']:.2g} N"
            planned = [(trial["speed"], trial["peak"]) for trial in race["trials"] if trial["feasible"]]
            without = [trial["speed"] for trial in race["trials"] if not trial["feasible"]]
            line: Any = {"color": stroke.color, "linestyle": stroke.dash, "marker": stroke.marker}
            axes.plot(*np.array(planned).T, label=race["title"] + cap, **line)
            axes.plot(without, [0.02] * len(without), "x", color=stroke.color, transform=axes.get_xaxis_transform())
        log_scale(axes)
        axes.set(xlabel="cruising speed [m/s] (crosses: no plan)", ylabel="largest main force [N]")
        legend_above(axes, 6.2)
        return drawn


def trade_figure(results: Results) -> Figure:
    """Draw effort against acceleration, with other plans as marks."""
    with figure(3.8 * len(cases.TRADED), 3.8, "Main effort against the carriers' acceleration") as drawn:
        panels = drawn.subplots(1, len(cases.TRADED), squeeze=False)[0]
        trades = results.chapters["beyond"]["trade_off"]
        for axes, task, trade in zip(panels, cases.TRADED, trades, strict=True):
            points = [point for point in trade["points"] if point["status"] != ResultStatus.INFEASIBLE.value]
            along = np.array([(point["rms_acceleration"], point["rms_effort"]) for point in points])
            axes.plot(*along.T, marker="o", color=STROKES[0].color, label="whole trajectory, one point a weight")
            others = {name: plan for name, plan in _existing(results, task).items() if name in _SHOWN[:3]}
            for stroke, (name, plan) in zip(STROKES[1:], others.items(), strict=False):
                effort = float(np.linalg.norm(plan.rms_effort))
                axes.plot([rms_acceleration(plan)], [effort], marker=stroke.marker, color=stroke.color, label=name)
            axes.set_title(task.title, fontsize=9)
            axes.set(xlabel="rms of s̈ [m/s²]", ylabel=f"rms of |τ| [{task.unit}]")
            legend_above(axes, 3.4)
        return drawn


# --- future --------------------------------------------------------------------------------------------------------


def future_pictures(_: Results) -> Iterator[Picture]:
    """Give the figures of spatial machines through singularities."""
    for case in future.SPATIAL:
        caption = "Motion of the carriers, with their limits; dotted: the singular instant."
        yield Picture(f"future-{case.name}", case.title, caption, spatial_figure, (case,))


def spatial_figure(results: Results, case: Case) -> Figure:
    """Return the carriers of a plan."""
    return plots.carriers(results.plans.plan(future.coarsened(case, results.extent)))


# --- replay --------------------------------------------------------------------------------------------------------


def replay_pictures(results: Results) -> Iterator[Picture]:
    """Give the tracking errors of two plans that all drives replay."""
    names = {replay.plan for replay in results.replays}
    for one in results.extent.replayed:
        if one.name in names and one.method == EFFORT and one.task.name in ("heavy-0.5", "corner-r0.025"):
            caption = f"Distance of the platform from its plan ({one.name}), for each drive."
            title = f"Replay of {one.task.name}"
            yield Picture(f"replay-{one.task.name}", title, caption, tracking_figure, (one,))


def tracking_figure(results: Results, replayed: cases.Replayed) -> Figure:
    """Return the distances from a plan for every drive that replayed it."""
    same = [one for one in results.replays if one.plan == replayed.name and len(one.t)]
    distances = {one.drive: (one.t, one.error) for one in same}
    panel = replace(plots.distance_panel("distance from the plan [m]", distances), height=1.8)
    return plot_time_panels(replayed.task.title, [panel])


PICTURES: Mapping[str, Callable[[Results], Iterator[Picture]]] = {
    "motions": motion_pictures,
    "planned": thesis_pictures,
    "beyond": beyond_pictures,
    "future": future_pictures,
    "replay": replay_pictures,
}
"""Figures by chapter."""


def pictures(results: Results) -> dict[str, list[Picture]]:
    """Return all figures of what was run, by chapter; a small extent has only the figures of the first page."""
    return {
        name: [picture for picture in made(results) if results.extent.figures or picture.stem in IN_FRONT]
        for name, made in PICTURES.items()
        if name in ("motions", *results.chapters)
    }
