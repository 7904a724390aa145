"""Computing a feasibility map on all cores, or on whatever joblib is told to use; what is finished is never lost."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal

import numpy as np

from redundancy_pin.errors import InputError, RedundancyPinError
from redundancy_pin.kinematics.coordinates import require_matching
from redundancy_pin.robot import Robot
from redundancy_pin.studies.feasibility.cell import Cell, Key, Verdict, compute
from redundancy_pin.studies.feasibility.problem import Axis, MapProblem
from redundancy_pin.studies.store import Progress, Store
from redundancy_pin.studies.table import csv_text

Direction = Literal["x", "y"]

_DIGITS = 9
"""Significant digits of a robot's numbers that must agree for its cells to be taken over."""


@dataclass(frozen=True)
class Crossing:
    """Two neighbouring cells of one line of a map between which the verdict changes.

    Attributes:
        line: value of the other parameter, common to both.
        low, high: values of this parameter.
        possible: which of the two can be done: "low" or "high".
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
        """Return one cell.

        Raises:
            KeyError: there is none.
        """
        return {cell.key: cell for cell in self.cells}[planner, x, y]

    def place(self, cell: Cell) -> tuple[float, float]:
        """Return where a cell is on the axis of the border and on the other one."""
        return (cell.x, cell.y) if self.along == "x" else (cell.y, cell.x)

    def lines(self, planner: str) -> dict[float, list[Cell]]:
        """Return the cells of a planner in lines along the axis of the border, in order, by the other parameter."""
        cells = sorted(self.of(planner), key=self.place)
        lines = sorted({self.place(cell)[1] for cell in cells})
        return {line: [cell for cell in cells if self.place(cell)[1] == line] for line in lines}

    def border(self, planner: str) -> tuple[Crossing, ...]:
        """Return where, along the axis of the border, a planner can do one cell and not the next.

        Cells of which nothing is known have no border: between one that is possible and one that failed there is none.
        """
        return tuple(
            Crossing(line, self.place(low)[0], self.place(high)[0], "low" if low.possible else "high")
            for line, cells in self.lines(planner).items()
            for low, high in pairwise(cells)
            if {low.possible, high.possible} == {True, False}
        )

    def counts(self, planner: str) -> dict[str, int]:
        """Return how many cells have each verdict."""
        counted = Counter(cell.verdict for cell in self.of(planner))
        return {verdict.value: counted[verdict] for verdict in Verdict}

    def in_the_way(self, planner: str) -> dict[str, int]:
        """Return for how many infeasible cells each limit is the first in the way."""
        first = Counter(cell.limits[0] for cell in self.of(planner) if cell.verdict is Verdict.INFEASIBLE)
        return dict(first.most_common())

    def csv(self) -> str:
        """Return all cells as a CSV table, numbers to the last bit; what is not known is ``nan`` or empty."""
        columns: dict[str, list[Any]] = {
            "planner": [cell.planner for cell in self.cells],
            self.problem.x.name: [cell.x for cell in self.cells],
            self.problem.y.name: [cell.y for cell in self.cells],
            "verdict": [cell.verdict.value for cell in self.cells],
            "limits": [" ".join(cell.limits) for cell in self.cells],
        }
        for name in ("peak_effort", "dense_ratio", "seconds"):
            values = [getattr(cell, name) for cell in self.cells]
            columns[name] = [float("nan") if value is None else value for value in values]
        return csv_text({name: np.array(values) for name, values in columns.items()})

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
    with Store.open(journal, "feasibility map", identity, Cell.from_dict) as store:
        for level in range(int(refine) + 1):
            if level:
                wanted += _bisected(_ordered(problem, wanted, store.records, along))
            what = f"border {level} of {refine}" if level else "grid"
            store.complete(compute, {key: (problem, *key) for key in wanted}, jobs, progress, what)
        return _ordered(problem, wanted, store.records, along)


def _check(problem: MapProblem, *, jobs: int | None, refine: int, along: Direction) -> Robot:
    """Check everything that can be checked before the first cell, and return the robot; see ``feasibility_map``."""
    if along not in ("x", "y"):
        raise InputError(f"along is {along!r}.", remedy='Pass "x" or "y".')
    if int(refine) != refine or refine < 0:
        raise InputError(f"refine is {refine}.", remedy="Pass a whole number from zero up.")
    if jobs == 0:
        raise InputError("jobs is 0.", remedy="Pass the number of processes, or -1 for all cores.")
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
    texts = [f"{0.0 if abs(value) < 1e-12 else value:.{_DIGITS}g}" for value in map(float, numbers)]
    return hashlib.sha256(json.dumps(texts).encode()).hexdigest()[:16]


def _ordered(
    problem: MapProblem, keys: list[Key], known: Mapping[tuple[Any, ...], Cell], along: Direction
) -> FeasibilityMap:
    """Return a map of some cells, by planner and place."""
    ordered = sorted(keys, key=lambda key: (problem.planners.index(key[0]), *key[1:]))
    return FeasibilityMap(problem, tuple(known[key] for key in ordered), along)


def _bisected(result: FeasibilityMap) -> list[Key]:
    """Return the cells half way between neighbours of which one is possible and the other is not."""
    keys: list[Key] = []
    axis, _ = result.axes
    for planner in result.problem.planners:
        for crossing in result.border(planner):
            middle = axis.middle(crossing.low, crossing.high)
            if crossing.low < middle < crossing.high:
                keys.append(
                    (planner, middle, crossing.line) if result.along == "x" else (planner, crossing.line, middle)
                )
    return keys
