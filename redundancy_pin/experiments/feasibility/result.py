"""A computed feasibility map: its cells, the border between what can be done and what cannot, and tables."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from redundancy_pin.experiments.csv_text import csv_text
from redundancy_pin.experiments.feasibility.axis import Axis
from redundancy_pin.experiments.feasibility.cell import Cell, Key, Verdict
from redundancy_pin.experiments.feasibility.problem import MapProblem

Direction = Literal["x", "y"]


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
        along: the axis along which the border is told, and was refined if at all.
    """

    problem: MapProblem
    cells: tuple[Cell, ...]
    along: Direction = "x"

    def of(self, planner: str) -> tuple[Cell, ...]:
        """Return the cells of one planner."""
        return tuple(cell for cell in self.cells if cell.planner == planner)

    def cell(self, planner: str, x: float, y: float) -> Cell:
        """Return one cell.

        Raises:
            KeyError: there is none.
        """
        return {cell.key: cell for cell in self.cells}[planner, x, y]

    def lines(self, planner: str) -> dict[float, list[Cell]]:
        """Return the cells of a planner in lines along the axis of the border, in order, by the other parameter."""
        return lines_of(self.of(planner), self.along)

    def border(self, planner: str) -> tuple[Crossing, ...]:
        """Return where, along the axis of the border, a planner can do one cell and not the next.

        Cells of which nothing is known have no border: between one that is possible and one that failed there is none.
        """
        return crossings(self.lines(planner), self.along)

    def counts(self, planner: str) -> dict[str, int]:
        """Return how many cells have each verdict."""
        found = Counter(cell.verdict for cell in self.of(planner))
        return {verdict.value: found.get(verdict, 0) for verdict in Verdict}

    def in_the_way(self, planner: str) -> dict[str, int]:
        """Return for how many infeasible cells each limit is the first in the way."""
        first = Counter(cell.limits[0] for cell in self.of(planner) if cell.verdict is Verdict.INFEASIBLE)
        return dict(first.most_common())

    def csv(self) -> str:
        """Return all cells as a CSV table, numbers to the last bit; what is not known is ``nan`` or empty."""
        x, y = self.problem.x.name, self.problem.y.name
        return csv_text(
            {
                "planner": np.array([cell.planner for cell in self.cells]),
                x: np.array([cell.x for cell in self.cells]),
                y: np.array([cell.y for cell in self.cells]),
                "verdict": np.array([cell.verdict.value for cell in self.cells]),
                "limits": np.array([" ".join(cell.limits) for cell in self.cells]),
                "peak_effort": _numbers([cell.peak_effort for cell in self.cells]),
                "dense_ratio": _numbers([cell.dense_ratio for cell in self.cells]),
                "seconds": np.array([cell.seconds for cell in self.cells]),
            }
        )

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


def lines_of(cells: tuple[Cell, ...], along: Direction) -> dict[float, list[Cell]]:
    """Return cells in lines along an axis, in order, by the value of the other parameter."""
    lines: dict[float, list[Cell]] = {}
    for cell in cells:
        lines.setdefault(cell.x if along == "y" else cell.y, []).append(cell)
    return {key: sorted(lines[key], key=lambda cell: place(cell, along)) for key in sorted(lines)}


def crossings(lines: dict[float, list[Cell]], along: Direction) -> tuple[Crossing, ...]:
    """Return the pairs of neighbours of which one is possible and the other is not."""
    found = []
    for line, cells in lines.items():
        for low, high in pairwise(cells):
            if {low.possible, high.possible} == {True, False}:
                side: Literal["low", "high"] = "low" if low.possible else "high"
                found.append(Crossing(line, place(low, along), place(high, along), side))
    return tuple(found)


def place(cell: Cell, along: Direction) -> float:
    """Return where a cell is on an axis."""
    return cell.x if along == "x" else cell.y


def axis_of(problem: MapProblem, along: Direction) -> Axis:
    """Return the axis itself."""
    return problem.x if along == "x" else problem.y


def grid_keys(problem: MapProblem) -> list[Key]:
    """Return the cells of the grid, planner by planner at each place."""
    return [(planner, x, y) for x in problem.x.values for y in problem.y.values for planner in problem.planners]


def _numbers(values: list[float | None]) -> np.ndarray[Any, np.dtype[np.float64]]:
    return np.array([np.nan if value is None else value for value in values], dtype=float)
