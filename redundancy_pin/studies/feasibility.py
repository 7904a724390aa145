"""What a machine can do: two of its parameters swept over a grid, and the border between possible and impossible.

``docs/feasibility_map.md`` shows how it is used from Python.
"""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import groupby, pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from redundancy_pin.arrays import require_few, whole
from redundancy_pin.errors import InputError, RedundancyPinError
from redundancy_pin.io.files import write_text
from redundancy_pin.planners.registry import STEPWISE, SWITCH_OFF, WHOLE
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import require_matching
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.map_problem import LIMITS, OTHER, PRESETS, Axis, MapProblem, Preset, parse_axis, spaced
from redundancy_pin.studies.store import Progress, Store, make_folder
from redundancy_pin.studies.table import csv_text
from redundancy_pin.studies.verdicts import VERDICTS, Cell, Key, compute
from redundancy_pin.visualisation.figures.feasibility_map import Tile, plot_feasibility
from redundancy_pin.visualisation.figures.style import save
from redundancy_pin.workers import require_jobs

if TYPE_CHECKING:
    from matplotlib.figure import Figure

__all__ = [
    "LIMITS",
    "OTHER",
    "PRESETS",
    "STEPWISE",
    "SWITCH_OFF",
    "WHOLE",
    "Axis",
    "Cell",
    "FeasibilityMap",
    "MapProblem",
    "Preset",
    "VerdictChange",
    "compute",
    "feasibility_map",
    "parse_axis",
    "spaced",
    "write_map",
]

Direction = Literal["x", "y"]

MOST_CELLS, MOST_REFINE = 1_000_000, 30


# --- the map ---


@dataclass(frozen=True)
class VerdictChange:
    """Two neighbouring cells of one line of a map between which the verdict changes.

    ``line`` is the value of the other parameter, common to both; ``low`` and ``high`` are values of this one.
    """

    line: float
    low: float
    high: float
    possible: Literal["low", "high"]


@dataclass(frozen=True, eq=False)
class FeasibilityMap:
    """A computed map.

    Attributes:
        problem: what it is of.
        cells: those of the grid and those that refine the border, by planner and place.
        along: the axis along which the border is given, and was refined if at all.
    """

    problem: MapProblem
    cells: tuple[Cell, ...]
    along: Direction = "x"

    @property
    def axes(self) -> tuple[Axis, Axis]:
        """The axis of the border, and the other one."""
        return (self.problem.x, self.problem.y) if self.along == "x" else (self.problem.y, self.problem.x)

    def of(self, planner: str) -> tuple[Cell, ...]:
        """Return the cells of one planner."""
        return tuple(cell for cell in self.cells if cell.planner == planner)

    def cell(self, planner: str, x: float, y: float) -> Cell:
        """Return one cell; KeyError if there is none."""
        return {cell.key: cell for cell in self.cells}[planner, x, y]

    def place(self, cell: Cell) -> tuple[float, float]:
        """Return where a cell is on the axis of the border and on the other one."""
        return (cell.x, cell.y) if self.along == "x" else (cell.y, cell.x)

    def lines(self, planner: str) -> dict[float, list[Cell]]:
        """Return the cells of a planner in lines along the axis of the border, in order, by the other parameter."""
        cells = sorted(self.of(planner), key=lambda cell: self.place(cell)[::-1])
        return {line: list(group) for line, group in groupby(cells, key=lambda cell: self.place(cell)[1])}

    def border(self, planner: str) -> tuple[VerdictChange, ...]:
        """Return where, along the axis of the border, a planner can do one cell and not the next.

        Cells of which nothing is known have no border: between one that is possible and one that failed there is none.
        """
        return tuple(
            VerdictChange(line, self.place(low)[0], self.place(high)[0], "low" if low.possible else "high")
            for line, cells in self.lines(planner).items()
            for low, high in pairwise(cells)
            if {low.possible, high.possible} == {True, False}
        )

    def counts(self, planner: str) -> dict[str, int]:
        """Return how many cells have each verdict."""
        counted = Counter(cell.verdict for cell in self.of(planner))
        return {verdict.value: counted[verdict] for verdict in VERDICTS}

    def in_the_way(self, planner: str) -> dict[str, int]:
        """Return for how many infeasible cells each limit is the first in the way."""
        first = Counter(cell.limits[0] for cell in self.of(planner) if cell.verdict is ResultStatus.INFEASIBLE)
        return dict(first.most_common())

    def csv(self) -> str:
        """Return all cells as a CSV table, numbers to the last bit; what is not known is ``nan`` or empty."""
        names = ("planner", "x", "y", "verdict", "limits", "peak_effort", "dense_ratio", "seconds")
        shown = [{**vars(cell), "verdict": cell.verdict.value, "limits": " ".join(cell.limits)} for cell in self.cells]
        called = {"x": self.problem.x.name, "y": self.problem.y.name}
        # None becomes nan among floats
        kinds = {name: float if name in ("peak_effort", "dense_ratio") else None for name in names}
        return csv_text({called.get(n, n): np.array([row[n] for row in shown], dtype=kinds[n]) for n in names})

    def as_dict(self) -> dict[str, Any]:
        """Return everything as plain data, for JSON."""
        problem = self.problem
        return {
            "problem": problem.identity(),
            "x": vars(problem.x),
            "y": vars(problem.y),
            "along": self.along,
            "planners": {
                planner: {
                    "counts": self.counts(planner),
                    "in_the_way": self.in_the_way(planner),
                    "border": [vars(crossing) for crossing in self.border(planner)],
                    "seconds": sum(cell.seconds for cell in self.of(planner)),
                }
                for planner in problem.planners
            },
            "cells": [cell.as_dict() for cell in self.cells],
        }


def feasibility_map(
    problem: MapProblem,
    journal: str | Path | None = None,
    *,
    jobs: int | None = -1,
    refine: int = 0,
    along: Direction = "x",
    progress: Progress | None = None,
) -> FeasibilityMap:
    """Compute a map, taking over the cells that a store already has.

    Cells are independent, and are computed by ``joblib.Parallel``: by default in processes on this machine, each with
    one thread. Within ``joblib.parallel_config`` they go to the backend named there, such as a cluster.

    Args:
        problem: what the map is of.
        journal: file of the store of finished cells, made if it is missing; None keeps them in memory alone.
        jobs: number of processes, -1 for all cores; None for what ``joblib.parallel_config`` says.
        refine: how often the border is bisected between neighbouring cells of the grid.
        along: the axis along which it is bisected.
        progress: called whenever a cell is finished.

    Raises:
        InputError: an axis that is no parameter of the robot, the trajectory or the limits; a parameter that a planner
            does not take; or a robot or trajectory that cannot be made at any corner of the map.
        OutputError: as ``Store.open``, for a store of another problem or robot.
        RedundancyPinError: the robot does not load, or a worker process dies.
    """
    robot = _check(problem, jobs=jobs, refine=refine, along=along)
    # the fingerprint says least to a user, and changes along with others: last
    identity = {**problem.identity(), "machine": fingerprint(robot)}
    wanted = [(planner, x, y) for x in problem.x.values for y in problem.y.values for planner in problem.planners]

    def computed() -> FeasibilityMap:
        ordered = sorted(wanted, key=lambda key: (problem.planners.index(key[0]), *key[1:]))
        return FeasibilityMap(problem, tuple(store.records[key] for key in ordered), along)

    with Store.open(journal, "feasibility map", identity, Cell.from_dict) as store:
        for level in range(int(refine) + 1):
            if level:
                wanted += _bisected(computed())
            what = f"border {level} of {refine}" if level else "grid"
            store.complete(compute, {key: (problem, *key) for key in wanted}, jobs, progress, what)
        return computed()


def _check(problem: MapProblem, *, jobs: int | None, refine: int, along: Direction) -> Robot:
    """Check everything that can be checked before the first cell, and return the robot; see ``feasibility_map``."""
    if along not in ("x", "y"):
        raise InputError(f"along is {along!r}.", remedy='Pass "x" or "y".')
    whole(refine, "refine", 0, MOST_REFINE)
    if jobs is not None:
        require_jobs(jobs)
    cells = len(problem.x.values) * len(problem.y.values) * len(problem.planners)
    require_few(cells, MOST_CELLS, "The map has {} cells", "Give its axes fewer values.")
    problem.require_names()
    errors: list[RedundancyPinError] = []
    # one corner may be out of the domain of the motion, and its cells fail; not all of them
    for x in (problem.x.values[0], problem.x.values[-1]):
        for y in (problem.y.values[0], problem.y.values[-1]):
            try:
                case = problem.case(problem.planners[0], x, y, {})
                robot, start = case.dynamics(problem.backend).robot, case.trajectory().sample_at([0.0])
            except RedundancyPinError as error:
                errors.append(error)
            else:
                require_matching(robot, start)
                return problem.loaded
    raise errors[0]


def fingerprint(robot: Robot) -> str:
    """Return a hash of what a robot is, so that cells of a file that has changed since are not taken over."""
    numbers = [
        *(value for body in list(robot.model.inertias)[1:] for value in body.toDynamicParameters()),
        *robot.q_reference,
        *(value for limit in robot.carrier_limits for value in vars(limit).values()),
    ]
    # what is zero but for rounding may round either way
    texts = [f"{0.0 if abs(value) < 1e-12 else value:.9g}" for value in map(float, numbers)]
    return hashlib.sha256(json.dumps(texts).encode()).hexdigest()[:16]


def _bisected(result: FeasibilityMap) -> list[Key]:
    """Return the cells half way between neighbours of which one is possible and the other is not."""
    keys: list[Key] = []
    for planner in result.problem.planners:
        for crossing in result.border(planner):
            middle, line = result.axes[0].middle(crossing.low, crossing.high), crossing.line
            if crossing.low < middle < crossing.high:
                keys.append((planner, middle, line) if result.along == "x" else (planner, line, middle))
    return keys


# --- in files, and as a picture ---

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
    "speed": "m/s", "time": "s", "duration": "s", "alpha": "rad", "acceleration": "m/s²", "jerk": "m/s³", "force": "N",
    "mass": "kg", "inertia": "kg·m²",
}  # fmt: skip
"""Units by the last word of a name; what is not listed is a length."""


def write_map(found: FeasibilityMap, folder: str | Path, *, pictures: bool = True) -> tuple[Path, ...]:
    """Write a map into a folder: all cells as CSV and JSON, the picture as SVG and PNG; each whole or not at all.

    The folder is made if it is missing; other files in it are left alone. OutputError where a file cannot be written,
    RedundancyPinError for pictures without matplotlib.
    """
    place = make_folder(folder)
    write_text(place / "map.csv", found.csv())
    write_text(place / "map.json", json.dumps(found.as_dict(), indent=1, allow_nan=False) + "\n")
    files = [place / "map.csv", place / "map.json"]
    if pictures:  # after the numbers, which a picture that fails must not take with it
        files += write_pictures(found, place)
    return tuple(files)


def write_pictures(found: FeasibilityMap, folder: Path) -> tuple[Path, ...]:
    """Write the picture of a map into its folder, as SVG and PNG; errors as ``write_map``."""
    files = folder / "map.svg", folder / "map.png"
    save(draw(found), *files)
    return files


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
            letter = LETTERS.get(cell.limits[0], _OTHER)[0] if cell.verdict is ResultStatus.INFEASIBLE else ""
            made.append(Tile(*x, *y, cell.verdict, cell.peak_effort, letter))
    return tuple(made)


def axis_label(name: str, effort: str) -> str:
    """Return what to write on an axis: the parameter and its unit, given that of the main efforts."""
    known = {"stroke": "stroke of the carriers", "speed": "speed of the platform"}
    limits = {key: f"limit: {meaning.split(',')[0]}" for key, meaning in LIMITS.items()}
    return f"{({**limits, **known}).get(name, name.replace('_', ' '))} [{_unit(name, effort)}]"


def effort_unit(problem: MapProblem) -> str:
    """Return the unit of the main efforts."""
    return robot_record(problem.loaded).effort_units[0]


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
