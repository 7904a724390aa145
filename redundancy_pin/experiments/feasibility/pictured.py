"""From a computed map to its picture."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from redundancy_pin.experiments.feasibility.cell import Cell, Verdict
from redundancy_pin.experiments.feasibility.planning import tries
from redundancy_pin.experiments.feasibility.problem import LIMITS, SWITCH_OFF, WHOLE, MapProblem
from redundancy_pin.experiments.feasibility.result import FeasibilityMap, axis_of, place
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.visualisation.figures.feasibility_map import Kind, MapLabels, MapPanel, Tile, plot_feasibility

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MARKS: Mapping[str, str] = {
    "track": "T",
    "speed": "V",
    "acceleration": "A",
    "jerk": "J",
    "force": "F",
    "effort": "E",
    "end": "D",
    "workspace": "W",
    "margin": "S",
    "singular_pose": "S",
}
"""Letters of the limits in the picture; X for any other."""

_MEANINGS: Mapping[str, str] = {
    "T": "track",
    "V": "carrier speed",
    "A": "carrier acceleration",
    "J": "carrier jerk",
    "F": "carrier force",
    "E": "main effort",
    "D": "state at the end",
    "W": "workspace",
    "S": "singularity",
    "X": "other (see the table)",
}

_UNITS: Mapping[str, str] = {
    "speed": "m/s",
    "time": "s",
    "alpha": "rad",
    "acceleration": "m/s²",
    "jerk": "m/s³",
    "force": "N",
    "mass": "kg",
    "inertia": "kg·m²",
}
"""Units by the last word of a name; what is not listed is a length."""

_KINDS: Mapping[Verdict, Kind] = {
    Verdict.FEASIBLE: "feasible",
    Verdict.STOPPED_EARLY: "stopped_early",
    Verdict.INFEASIBLE: "infeasible",
    Verdict.FAILED: "failed",
}


def draw(found: FeasibilityMap) -> Figure:
    """Draw a map, one panel a planner.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    problem = found.problem
    effort = effort_unit(problem)
    labels = MapLabels(
        title=_title(problem),
        x=axis_label(problem.x.name, effort),
        y=axis_label(problem.y.name, effort),
        value=f"peak main effort [{effort}]",
        marks=_MEANINGS,
        x_scale=problem.x.scale,
        y_scale=problem.y.scale,
    )
    return plot_feasibility(
        [MapPanel(panel_title(problem, planner), tiles(found, planner)) for planner in problem.planners], labels
    )


def tiles(found: FeasibilityMap, planner: str) -> tuple[Tile, ...]:
    """Return a tile around each cell of a planner: lines along the axis of the border meet half way between cells."""
    along = found.along
    lines = found.lines(planner)
    sides = axis_of(found.problem, "y" if along == "x" else "x").edges(list(lines))
    axis = axis_of(found.problem, along)
    made = []
    for (cells, left), right in zip(zip(lines.values(), sides[:-1], strict=True), sides[1:], strict=True):
        ends = axis.edges([place(cell, along) for cell in cells])
        for cell, low, high in zip(cells, ends[:-1], ends[1:], strict=True):
            x, y = ((left, right), (low, high)) if along == "y" else ((low, high), (left, right))
            made.append(Tile(*x, *y, _KINDS[cell.verdict], cell.peak_effort, _mark(cell)))
    return tuple(made)


def axis_label(name: str, effort: str) -> str:
    """Return what to write on an axis: the parameter and its unit."""
    known = {"stroke": "stroke of the carriers", "speed": "speed of the platform"}
    shown = known.get(name, f"limit: {LIMITS[name].split(',')[0]}" if name in LIMITS else name.replace("_", " "))
    return f"{shown} [{unit_of(name, effort)}]"


def unit_of(name: str, effort: str) -> str:
    """Return the unit of a parameter, given that of the main efforts."""
    return effort if name == "max_effort" else _UNITS.get(name.rpartition("_")[2], "m")


def effort_unit(problem: MapProblem) -> str:
    """Return the unit of the main efforts."""
    robot = robot_record(problem.loaded)
    return robot.effort_unit(*robot.actuated)


def panel_title(problem: MapProblem, planner: str) -> str:
    """Return the planner and what it minimises or how often it tries."""
    said = planner.replace("-", " ")
    if planner == WHOLE:
        objective = problem.parameters.get(WHOLE, {}).get("objective", "effort")
        words = objective if isinstance(objective, str) else ", ".join(f"{w:g} {n}" for n, w in objective.items())
        return f"{said}: least {words}"
    key, symbol = ("threshold", "threshold") if planner == SWITCH_OFF else ("lam", "λ")
    values = sorted({settings[key] for settings in tries(problem, planner)})
    return f"{said}: {symbol} {', '.join(f'{value:g}' for value in values)}"


def _title(problem: MapProblem) -> str:
    effort = effort_unit(problem)
    fixed = {**problem.options, **problem.settings, **problem.limits}
    numbers = {name: value for name, value in fixed.items() if type(value) in (int, float)}
    rest = ", ".join(f"{name.replace('_', ' ')} {value:g} {unit_of(name, effort)}" for name, value in numbers.items())
    return f"{problem.robot}, {problem.trajectory}{f' ({rest})' if rest else ''}: what the machine can do"


def _mark(cell: Cell) -> str:
    return MARKS.get(cell.limits[0], "X") if cell.verdict is Verdict.INFEASIBLE else ""
