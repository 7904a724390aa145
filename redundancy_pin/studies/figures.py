"""The figures of the reproduction as a list: file, caption, and what is drawn of which case."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.studies.case import RNEA, VIRTUAL_WORK, Case, Plans
from redundancy_pin.studies.cases import (
    CORNERS,
    CROSSINGS,
    EFFORT,
    NONE,
    PEAK,
    SMOOTH,
    STEPWISE,
    SWITCH_OFF,
    TASKS,
    TRADED,
    TURNS,
    Replayed,
    by_method,
    crosses,
    mode_text,
    motion_name,
    parked,
    thresholds,
    without_carriers,
)
from redundancy_pin.studies.measures import rms_acceleration, window
from redundancy_pin.studies.motions import MotionRun
from redundancy_pin.studies.results import Results
from redundancy_pin.visualisation.figures.comparisons import (
    TradeCurve,
    plot_bars,
    plot_comparison,
    plot_efforts,
    plot_side_by_side,
    plot_speed_border,
    plot_tracking,
    plot_trade_off,
)
from redundancy_pin.visualisation.figures.curves import curves
from redundancy_pin.visualisation.figures.paths import plot_path, plot_plane_paths
from redundancy_pin.visualisation.figures.time_panels import Curve, Panel, plot_time_panels
from redundancy_pin.visualisation.viewer.parts import base_hinges, links

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[..., "Figure"]
"""Draws what it is given; the figures of the thesis are ``draw(plans, *cases)``."""

_FINE = 2e-3
"""Between the samples of reference motions, s."""


@dataclass(frozen=True)
class Picture:
    """A figure of the results folder.

    Attributes:
        stem: name of its files without suffix.
        title: above it in the report.
        caption: below it.
        draw: makes it.
    """

    stem: str
    title: str
    caption: str
    draw: Callable[[Results], Figure]


def _of(draw: Draw, *given: Any) -> Callable[[Results], Figure]:
    return lambda results: draw(*given)


def _from_plans(draw: Draw, cases: Sequence[Case]) -> Callable[[Results], Figure]:
    return lambda results: draw(results.plans, *cases)


def _from_results(draw: Draw, *given: Any) -> Callable[[Results], Figure]:
    return lambda results: draw(results, *given)


# --- motions without a planner -------------------------------------------------------------------------------------


def motion_pictures(runs: Sequence[MotionRun]) -> list[Picture]:
    """Return the figures of the motions without a planner: efforts and path of each, and cases side by side."""
    pictures = []
    for run in runs:
        name = run.case.name
        title = f"{run.case.title}, {_carriers(run.case)}"
        pictures += [
            Picture(f"{name}-efforts", f"Efforts of {name}", f"{title}: efforts by both backends. {run.statement}.",
                    _of(effort_figure, run, title)),
            Picture(f"{name}-path", f"Path of {name}", f"{title}: mechanism, path and condition number.",
                    _of(path_figure, run, title)),
        ]  # fmt: skip
    for motion in dict.fromkeys(motion_name(run.case) for run in runs):
        same = [run for run in runs if motion_name(run.case) == motion]
        if len(same) > 1:
            caption = f"{same[0].case.title}: efforts with parked carriers and without carriers."
            pictures.append(Picture(f"{motion}-comparison", f"Comparison of {motion}", caption,
                                    _of(comparison_figure, same)))  # fmt: skip
    return pictures


def effort_figure(run: MotionRun, title: str) -> Figure:
    """Return the efforts of a run by both backends."""
    drawn = curves(run.robot, run.reduced[RNEA], run.distribution, title=title)
    return plot_efforts(
        replace(drawn, instants=tuple(instant.t for instant in run.instants)),
        run.solved[VIRTUAL_WORK].tau,
        backends=("RNEA", "virtual work"),
        scale=run.reduced[RNEA].column_scale,
        missing_force=[instant.missing_force for instant in run.instants],
    )


def path_figure(run: MotionRun, title: str) -> Figure:
    """Return the mechanism, the path and the condition number of a run."""
    return plot_path(
        title,
        run.t,
        run.motion.x[:, :2],
        *_mechanism(run.robot, run.motion),
        run.distribution.condition,
        thresholds=thresholds(run.case),
        windows=run.near_singular_windows,
        instants=[instant.t for instant in run.instants],
        singular_points=[instant.x[:2] for instant in run.instants],
    )


def comparison_figure(runs: Sequence[MotionRun]) -> Figure:
    """Return the efforts of several runs along one motion."""
    efforts = {_carriers(run.case): (run.t, run.distribution.tau) for run in runs}
    names = tuple(f"τ{i + 1}" for i in range(runs[0].robot.m))
    return plot_comparison(runs[0].case.title, names, runs[0].case.unit, efforts)


def _carriers(case: Case) -> str:
    return "no carriers" if case.planner == "none" else "carriers parked"


def _mechanism(robot: Robot, motion: PlatformMotion) -> tuple[tuple[Array, ...], Array]:
    """Return the lines and the hinges of a robot at the start of a motion, in the plane."""
    start = lift(robot, motion[:1]).q[0]
    return tuple(np.stack(ends)[:, :2] for ends in links(robot, start)), base_hinges(robot)[:, :2]


# --- result figures of the thesis ----------------------------------------------------------------------------------


def profile(plans: Plans, case: Case) -> Figure:
    """Draw the platform's speed and acceleration (norms)."""
    motion = case.trajectory().sample(_FINE)
    speed, acceleration = (np.linalg.norm(part[:, :2], axis=1) for part in (motion.xd, motion.xdd))
    panels = (
        Panel("speed |ẋ| [m/s]", (Curve("speed", motion.t, speed),)),
        Panel("acceleration |ẍ| [m/s²]", (Curve("acceleration", motion.t, acceleration, 1),)),
    )
    return plot_time_panels(f"{case.title}: speed and acceleration of the platform", panels)


def displacement(plans: Plans, case: Case) -> Figure:
    """Draw the platform's x and y over time."""
    motion = case.trajectory().sample(_FINE)
    panels = tuple(
        Panel(f"{name} [m]", (Curve(name, motion.t, motion.x[:, i] - motion.x[0, i], i),))
        for i, name in enumerate(("x − x(0)", "y − y(0)"))
    )
    return plot_time_panels(f"{case.title}: displacement of the platform", panels)


def paths(plans: Plans, *cases: Case) -> Figure:
    """Draw the paths of cases; of a crossing with the mechanism at its start and the singular points."""
    lines = {
        f"radius {case.option('radius'):g} m" if len(cases) > 1 else "path": case.trajectory().sample(_FINE).x[:, :2]
        for case in cases
    }
    first = cases[0]
    if first.planner != "switch_off":
        return plot_plane_paths("Corners of the 3-RRR's platform" if len(cases) > 1 else first.title, lines)
    trajectory = first.trajectory()
    mechanism, hinges = _mechanism(first.load_robot(), trajectory.sample(_FINE))
    return plot_plane_paths(
        f"{first.title}: path and mechanism at the start",
        lines,
        mechanism=mechanism,
        hinges=hinges,
        singular=list(trajectory.sample_at(np.array(_instants(plans.plan(first)))).x),
    )


def condition(plans: Plans, *cases: Case) -> Figure:
    """Draw the condition number along the motion of cases that differ in their threshold."""
    plan = plans.plan(cases[0])
    levels = tuple((case.option("threshold"), f"threshold {case.option('threshold'):g}") for case in cases)
    panel = Panel("condition number [–]", (Curve("condition number", plan.t, plan.condition),), levels, log=True,
                  height=1.8)  # fmt: skip
    return plot_time_panels(f"{cases[0].title}: condition number", (panel,), instants=_instants(plan))


def forces(plans: Plans, case: Case) -> Figure:
    """Draw the forces of the main actuators and the condition number of a crossing."""
    plan, threshold = plans.plan(case), case.option("threshold")
    before = plan.t <= float(window(plan)["exit"])
    whole, shown = (
        tuple(Curve(f"τ{i + 1}", plan.t[part], plan.tau[part, i], i) for i in range(2))
        for part in (slice(None), before)
    )
    level = ((threshold, f"threshold {threshold:g}"),)
    panels = (
        Panel("force τ [N]", whole, height=1.3),
        Panel("force τ [N], until\nswitched on", shown, height=1.2),
        Panel("condition number [–]", (Curve("condition number", plan.t, plan.condition),), level, log=True),
    )
    return plot_time_panels(f"{_off(case)}: main actuators", panels, plan=plan, instants=_instants(plan))


_QUANTITIES = {"position": ("s", "s [m]"), "speed": ("sd", "ṡ [m/s]"), "acceleration": ("sdd", "s̈ [m/s²]")}
"""Of carriers: their name in a motion, and the label of the axis."""


def carriers(plans: Plans, case: Case) -> Figure:
    """Draw position, speed and acceleration of the carriers of a crossing."""
    plan = plans.plan(case)
    panels = []
    for quantity, (name, label) in _QUANTITIES.items():
        values = getattr(plan.carriers, name)
        curves = tuple(Curve(f"carrier {i + 1}", plan.t, values[:, i], i, carrier=True) for i in range(values.shape[1]))
        panels.append(Panel(label, curves, limits=_limits(plan, quantity), height=1.2))
    return plot_time_panels(f"{_off(case)}: carriers", panels, plan=plan, instants=_instants(plan))


def torques(plans: Plans, case: Case) -> Figure:
    """Draw each base torque of a stepwise plan beside the machine without carriers and with parked ones."""
    plan, none, still = (plans.plan(one) for one in (case, without_carriers(case), parked(case)))
    panels = tuple(
        Panel(
            f"τ{i + 1} [N·m]",
            (
                Curve("no carriers", none.t, none.tau[:, i], reference=True),
                Curve("carriers parked", still.t, still.tau[:, i], 1),
                Curve("carriers moving", plan.t, plan.tau[:, i], 0),
            ),
        )
        for i in range(3)
    )
    return plot_time_panels(f"{_stepwise(case)}: base torques", panels, plan=plan)


def positions(plans: Plans, case: Case) -> Figure:
    """Draw the positions of the carriers of a stepwise plan, one panel each."""
    return _each_carrier(plans, case, "position")


def accelerations(plans: Plans, case: Case) -> Figure:
    """Draw their accelerations."""
    return _each_carrier(plans, case, "acceleration")


def _each_carrier(plans: Plans, case: Case, quantity: str) -> Figure:
    plan, (name, label) = plans.plan(case), _QUANTITIES[quantity]
    values = getattr(plan.carriers, name)
    panels = tuple(
        Panel(
            f"carrier {i + 1}\n{label}",
            (Curve(f"{quantity} of carrier {i + 1}", plan.t, values[:, i], i, carrier=True),),
            limits=_limits(plan, quantity),
        )
        for i in range(3)
    )
    return plot_time_panels(f"{_stepwise(case)}: {quantity} of the carriers", panels, plan=plan)


def _off(case: Case) -> str:
    return f"{case.title}, off above condition number {case.option('threshold'):g}"


def _stepwise(case: Case) -> str:
    return f"{case.title}, λ = {case.option('lam'):g}, working mode (+,+,+)"


def _limits(plan: Plan, quantity: str) -> tuple[float, ...]:
    first = plan.limits.judged_by[0]
    if quantity == "position":
        return first.lower, first.upper
    limit = getattr(first, quantity)
    return (-limit, limit) if np.isfinite(limit) else ()


def _instants(plan: Plan) -> list[float]:
    instants: Any = plan.diagnostics.get("singular_instants") or ()
    return [float(instant) for instant in instants]


_C5, _C10, _C20, _F5, _L1, _L2, _L15 = CROSSINGS
_WIDE, _WIDE_HALF, _SHARP, _, _SQUARE_HALF, _SQUARE = CORNERS

THESIS: tuple[tuple[str, Draw, tuple[Case, ...]], ...] = (
    ("3.6", profile, (_C5,)),
    ("3.7", paths, (_C5,)),
    ("3.8", profile, (_L1,)),
    ("3.9", paths, (_L1,)),
    ("3.10", condition, (_C5, _C10, _C20)),
    ("3.11", forces, (_C5,)),
    ("3.12", carriers, (_C5,)),
    ("3.13", forces, (_C10,)),
    ("3.14", forces, (_C20,)),
    ("3.15", carriers, (_C20,)),
    ("3.16", forces, (_F5,)),
    ("3.17", carriers, (_F5,)),
    ("3.18", condition, (_L1,)),
    ("3.19", forces, (_L1,)),
    ("3.20", carriers, (_L1,)),
    ("3.21", forces, (_L2,)),
    ("3.22", forces, (_L15,)),
    ("4.2", paths, (_WIDE, _SHARP)),
    ("4.3", profile, (_WIDE,)),
    ("4.4", profile, (_SHARP,)),
    ("4.5", paths, (_SQUARE,)),
    ("4.6", displacement, (_SQUARE,)),
    ("4.7", profile, (_SQUARE,)),
    ("4.8", torques, (_WIDE,)),
    ("4.9", accelerations, (_WIDE,)),
    ("4.10", torques, (_SHARP,)),
    ("4.11", accelerations, (_SHARP,)),
    ("4.12", torques, (_WIDE_HALF,)),
    ("4.13", positions, (_WIDE_HALF,)),
    ("4.14", accelerations, (_WIDE_HALF,)),
    ("4.15", torques, (_SQUARE_HALF,)),
    ("4.16", accelerations, (_SQUARE_HALF,)),
    ("4.17", torques, (_SQUARE,)),
    ("4.18", accelerations, (_SQUARE,)),
)
"""Number in the thesis, what is drawn, of which cases. Its 3.1 to 3.5 and 4.1 are flow charts and sketches."""

_CAPTIONS: dict[Draw, str] = {
    profile: "Speed and acceleration of the platform.",
    displacement: "Displacement of the platform from its start.",
    paths: "Path; of a crossing with the mechanism at its start and crosses where it is singular.",
    condition: "Condition number with the thresholds; infinite at the dotted lines, the axis is cut at 1000.",
    forces: "Forces of the main actuators (positive: push; opposite in the thesis) and condition number.",
    carriers: "Position, speed and acceleration of the carriers with their limits.",
    torques: "Base torques beside the machine without carriers and with parked ones.",
    positions: "Positions of the carriers with their limits.",
    accelerations: "Accelerations of the carriers with their limits.",
}


def thesis_pictures() -> list[Picture]:
    """Return the result figures of the thesis, drawn anew."""
    pictures = []
    for number, draw, cases in THESIS:
        chapter, _, count = number.partition(".")
        runs = ", ".join(case.name for case in cases)
        pictures.append(
            Picture(
                f"figure-{chapter}-{int(count):02d}",
                f"Figure {number}",
                f"{_CAPTIONS[draw]} Run: {runs}.",
                _from_plans(draw, cases),
            )
        )
    return pictures


# --- beyond the thesis ---------------------------------------------------------------------------------------------

_SHOWN = (NONE, STEPWISE, SWITCH_OFF, EFFORT, PEAK, SMOOTH)
"""Methods that the figures of a motion show, left to right, where there is a plan."""

RADII = tuple(float(task.option("radius")) for task in TURNS[:2])


def beyond_pictures() -> list[Picture]:
    """Return the figures of the chapter beyond the thesis."""
    return [
        *(
            Picture(
                f"beyond-{task.name}",
                f"Plans of {task.name}",
                f"{task.title}: main efforts, and position, speed and acceleration of the carriers with their limits."
                + (" Dotted: singular instants." if crosses(task) else ""),
                _from_results(task_figure, task),
            )
            for task in TASKS
        ),
        Picture(
            "beyond-fastest",
            "Fastest motions",
            "Largest main force of the plans of least effort over speed: every speed that has a plan (dots), and those "
            "without (crosses, on the lower edge).",
            fastest_figure,
        ),
        *(
            Picture(
                f"beyond-modes-r{radius:g}",
                f"Working modes, radius {radius:g} m",
                f"Largest |τ| at the corner of radius {radius:g} m in every working mode, at the samples or between "
                "them. Stepwise plans leave the carriers where they are; the others bring them back.",
                _from_results(modes_figure, radius),
            )
            for radius in RADII
        ),
        Picture(
            "beyond-trade-off",
            "Trade-off",
            "Main effort against the carriers' acceleration: each point is the optimum for one weight.",
            trade_figure,
        ),
    ]


def _existing(results: Results, task: Case) -> dict[str, Plan]:
    """Return the plans of a task that are shown and exist, by method."""
    methods = {record["way"] for record in results.chapters["beyond"]["plans"] if record["task"] == task.name}
    outcomes = {
        method: results.plans.outcome(by_method(task, method, results.extent.coarser))
        for method in _SHOWN
        if method in methods
    }
    return {method: outcome for method, outcome in outcomes.items() if isinstance(outcome, Plan)}


def task_figure(results: Results, task: Case) -> Figure:
    """Return the plans of a task side by side."""
    plans = _existing(results, task)
    return plot_side_by_side(task.title, plans, task.unit, instants=_instants(plans[EFFORT]) if EFFORT in plans else ())


def modes_figure(results: Results, radius: float) -> Figure:
    """Return the peaks at a corner in every working mode."""
    records = [record for record in results.chapters["beyond"]["working_modes"] if record["radius"] == radius]
    series = {
        method: np.array([record["rows"][method]["worst"] for record in records])
        for method in (NONE, STEPWISE, EFFORT, PEAK)
    }
    title = f"3-RRR, corner of radius {radius:g} m: largest torque in every working mode"
    modes = [mode_text(record["mode"]) for record in records]
    return plot_bars(title, modes, "working mode", "largest |τ| [N·m]", series)


def fastest_figure(results: Results) -> Figure:
    """Return the largest main force over speed."""
    attempts = [
        (
            race["title"] + ("" if np.isinf(race["effort_limit"]) else f", up to {race['effort_limit']:.2g} N"),
            np.array([(trial["speed"], trial["peak"]) for trial in race["trials"] if trial["feasible"]]),
            np.array([trial["speed"] for trial in race["trials"] if not trial["feasible"]]),
        )
        for race in results.chapters["beyond"]["fastest"]
    ]
    return plot_speed_border("2-RPR: largest main force over speed, carriers within their limits", attempts)


def trade_figure(results: Results) -> Figure:
    """Return effort against acceleration, with other plans as marks."""
    trades = []
    for task, trade in zip(TRADED, results.chapters["beyond"]["trade_off"], strict=True):
        points = [point for point in trade["points"] if point["status"] != "infeasible"]
        marks = {
            method: (rms_acceleration(plan), float(np.linalg.norm(plan.rms_effort)))
            for method, plan in _existing(results, task).items()
            if method in (NONE, STEPWISE, SWITCH_OFF)
        }
        along = np.array([(point["rms_acceleration"], point["rms_effort"]) for point in points])
        trades.append(TradeCurve(task.title, task.unit, along, marks))
    return plot_trade_off("Main effort against the carriers' acceleration", trades)


# --- replay --------------------------------------------------------------------------------------------------------


def replay_pictures(results: Results) -> list[Picture]:
    """Return the figures of the chapter on replays: tracking errors of the plans that all drives replay."""
    names = {replay.plan for replay in results.replays}
    return [
        Picture(
            f"replay-{replayed.task.name}",
            f"Replay of {replayed.task.name}",
            f"Distance of the platform from its plan ({replayed.name}), for each drive.",
            _from_results(tracking_figure, replayed),
        )
        for replayed in results.extent.replayed
        if replayed.name in names
        and (replayed.task.name, replayed.method) in (("heavy-0.5", EFFORT), ("corner-r0.025", EFFORT))
    ]


def tracking_figure(results: Results, replayed: Replayed) -> Figure:
    """Return the distances from a plan for every drive that replayed it."""
    same = [one for one in results.replays if one.plan == replayed.name and len(one.t)]
    return plot_tracking(replayed.task.title, {one.drive: (one.t, one.error) for one in same})


def pictures(results: Results) -> dict[str, list[Picture]]:
    """Return all figures of what was run, by chapter."""
    chosen = {"motions": motion_pictures(results.runs)}
    if "planned" in results.chapters:
        chosen["planned"] = thesis_pictures()
    if "beyond" in results.chapters:
        chosen["beyond"] = beyond_pictures()
    if "replay" in results.chapters:
        chosen["replay"] = replay_pictures(results)
    return chosen
