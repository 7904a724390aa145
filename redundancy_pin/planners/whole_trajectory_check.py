"""Efforts between the nodes: what a plan that looks well at its nodes does in between, and beside a singularity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_motion import CarrierCourse
from redundancy_pin.planners.whole_trajectory_prepare import Task

FINER = 20
"""Points in a step."""

CLOSE = (1e-3, 1e-2)
"""Further points beside singular nodes, as fractions of the step."""

ALLOWED = 1.05
"""Largest effort between the nodes over the largest at the nodes that is accepted."""

MARKED = 1.02
"""Ratio from which a step gets a middle node once any exceeds what is accepted."""

BESIDE = 4
"""Steps on both sides of such a step that get one as well: the next plan would have its kink just beside the refined
steps, and the grid would follow it one step at a time."""

SMALL = 1e-3
"""Efforts below this fraction of the size of the efforts count as zero here."""


@dataclass(frozen=True, eq=False)
class DenseCheck:
    """Efforts τ = W⁻¹ f of the planned motion between the nodes, by the backend.

    Attributes:
        peak: largest |τ| between the nodes, N or N·m.
        time: where, s.
        peak_at_nodes: largest |τ| at the nodes.
        ratio: of both; efforts that are nothing beside those of the parked robot count as equal.
        points: number of points.
        exceeding: (M − 1,) steps in which the efforts exceed those at the nodes by what is worth a middle node, and
            those beside them.
    """

    peak: float
    time: float
    peak_at_nodes: float
    ratio: float
    points: int
    exceeding: BoolArray

    @property
    def summary(self) -> dict[str, object]:
        """The check as plain data."""
        return {
            "finer": FINER,
            "points": self.points,
            "peak_effort": self.peak,
            "time_of_peak": self.time,
            "peak_effort_at_nodes": self.peak_at_nodes,
            "ratio": self.ratio,
            "passed": self.ratio <= ALLOWED,
        }


def dense_check(task: Task, problem: WholeProblem, course: CarrierCourse, tau: Array) -> DenseCheck:
    """Evaluate the backend on a grid finer than the nodes, and right beside the singular ones.

    Args:
        task: robot and motion.
        problem: the nodes.
        course: the planned carriers.
        tau: (M, m) planned efforts at the nodes, N or N·m.
    """
    grid = problem.grid
    fine, _ = course.inside(FINER)
    beside: list[float] = []
    for i in grid.singular:
        for side in (-1, 0):
            if 0 <= i + side < len(grid.h):
                beside += [float(grid.t[i]) + (1.0 if side == 0 else -1.0) * f * float(grid.h[i + side]) for f in CLOSE]
    # nodes were judged already; between them no acceleration jumps, so every time may stand once
    times = np.setdiff1d(np.concatenate([fine, beside]), grid.t)
    efforts = np.abs(distribute(task.dynamics.along(task.source.sample_at(times)).reduce(course.at(times))).tau)
    largest = np.where(np.isfinite(efforts), efforts, np.inf).max(axis=1)
    at_nodes = float(np.abs(tau).max())
    least = max(at_nodes, SMALL * problem.scales.tau)
    step = np.searchsorted(grid.t, times, side="right") - 1
    exceeding = np.zeros(len(grid.h), dtype=bool)
    marked = step[largest > MARKED * least, None] + np.arange(-BESIDE, BESIDE + 1)
    exceeding[np.clip(marked, 0, len(grid.h) - 1)] = True
    worst = int(largest.argmax())
    ratio = max(float(largest[worst]), least) / least
    return DenseCheck(float(largest[worst]), float(times[worst]), at_nodes, ratio, len(times), exceeding)
