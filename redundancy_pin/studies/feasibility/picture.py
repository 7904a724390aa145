"""A computed map in files, and its picture."""

from __future__ import annotations

import json
from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING

from redundancy_pin.io.files import replacing_file, write_text
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.studies.feasibility.problem import LIMITS, SWITCH_OFF, WHOLE, MapProblem
from redundancy_pin.studies.feasibility.sweep import FeasibilityMap, Verdict
from redundancy_pin.studies.store import make_folder
from redundancy_pin.visualisation.figures.feasibility_map import Tile, plot_feasibility
from redundancy_pin.visualisation.figures.style import save

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LETTERS: Mapping[str, tuple[str, str]] = {
    "track": ("T", "track"),
    "speed": ("V", "carrier speed"),
    "acceleration": ("A", "carrier acceleration"),
    "jerk": ("J", "carrier jerk"),
    "force": ("F", "carrier force"),
    "effort": ("E", "main effort"),
    "end": ("D", "state at the end"),
    "workspace": ("W", "workspace"),
    "margin": ("S", "singularity"),
    "singular_pose": ("S", "singularity"),
}
"""Letters of the limits in the picture, and what they stand for."""

_OTHER = ("X", "other (see the table)")

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


def write_map(found: FeasibilityMap, folder: str | Path, *, pictures: bool = True) -> tuple[Path, ...]:
    """Write a map into a folder: all cells as CSV and JSON, the picture as SVG and PNG; each whole or not at all.

    Args:
        found: the map.
        folder: made if it is missing; other files in it are left alone.
        pictures: whether to draw.

    Raises:
        OutputError: a file cannot be written.
        RedundancyPinError: pictures without matplotlib.
    """
    place = make_folder(folder)
    drawn = [draw(found)] if pictures else []  # what may fail comes before the first file
    write_text(place / "map.csv", found.csv())
    write_text(place / "map.json", json.dumps(found.as_dict(), indent=1, allow_nan=False) + "\n")
    files = [place / "map.csv", place / "map.json"]
    for figure in drawn:
        for name in ("map.svg", "map.png"):
            with replacing_file(place / name) as temporary:
                save(figure, temporary)
            files.append(place / name)
    return tuple(files)


def draw(result: FeasibilityMap) -> Figure:
    """Draw a map, one panel a planner."""
    problem = result.problem
    effort = effort_unit(problem)
    fixed = {**problem.options, **problem.settings, **problem.limits}
    numbers = {name: value for name, value in fixed.items() if type(value) in (int, float)}
    rest = ", ".join(f"{name.replace('_', ' ')} {value:g} {_unit(name, effort)}" for name, value in numbers.items())
    return plot_feasibility(
        f"{problem.robot}, {problem.trajectory}{f' ({rest})' if rest else ''}: what the machine can do",
        {_panel_title(problem, planner): tiles(result, planner) for planner in problem.planners},
        x=axis_label(problem.x.name, effort),
        y=axis_label(problem.y.name, effort),
        value=f"peak main effort [{effort}]",
        marks=dict([*LETTERS.values(), _OTHER]),
        x_scale=problem.x.scale,
        y_scale=problem.y.scale,
    )


def tiles(result: FeasibilityMap, planner: str) -> tuple[Tile, ...]:
    """Return a tile around each cell of a planner: lines along the axis of the border meet half way between cells."""
    along, across = result.axes
    lines = result.lines(planner)
    made = []
    for cells, sides in zip(lines.values(), pairwise(across.edges(list(lines))), strict=True):
        for cell, ends in zip(cells, pairwise(along.edges([result.place(cell)[0] for cell in cells])), strict=True):
            x, y = (ends, sides) if result.along == "x" else (sides, ends)
            letter = LETTERS.get(cell.limits[0], _OTHER)[0] if cell.verdict is Verdict.INFEASIBLE else ""
            made.append(Tile(*x, *y, cell.verdict.value, cell.peak_effort, letter))
    return tuple(made)


def axis_label(name: str, effort: str) -> str:
    """Return what to write on an axis: the parameter and its unit, given that of the main efforts."""
    known = {"stroke": "stroke of the carriers", "speed": "speed of the platform"}
    shown = known.get(name, f"limit: {LIMITS[name].split(',')[0]}" if name in LIMITS else name.replace("_", " "))
    return f"{shown} [{_unit(name, effort)}]"


def effort_unit(problem: MapProblem) -> str:
    """Return the unit of the main efforts."""
    robot = robot_record(problem.loaded)
    return robot.effort_unit(*robot.actuated)


def _unit(name: str, effort: str) -> str:
    return effort if name == "max_effort" else _UNITS.get(name.rpartition("_")[2], "m")


def _panel_title(problem: MapProblem, planner: str) -> str:
    """Return the planner and what it minimises, or the values of its parameter that are tried."""
    name = planner.replace("-", " ")
    if planner == WHOLE:
        objective = problem.parameters.get(WHOLE, {}).get("objective", "effort")
        words = objective if isinstance(objective, str) else ", ".join(f"{w:g} {n}" for n, w in objective.items())
        return f"{name}: least {words}"
    key, symbol = ("threshold", "threshold") if planner == SWITCH_OFF else ("lam", "λ")
    values = sorted({settings[key] for settings in problem.attempts(planner)})
    return f"{name}: {symbol} {', '.join(f'{value:g}' for value in values)}"
