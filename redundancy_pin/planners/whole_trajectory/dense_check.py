"""Efforts between the nodes: what a plan that looks well at its nodes does in between, and beside a singularity."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.whole_trajectory.coefficients import Problem, Task
from redundancy_pin.planners.whole_trajectory.mesh import widened
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

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
    """Efforts τ = W⁻¹ f of the planned motion between the nodes, and carrier forces, by the backend.

    Attributes:
        peak: largest |τ| between the nodes, N or N·m.
        time: where, s.
        peak_at_nodes: largest |τ| at the nodes.
        ratio: of both, or of the effort of an actuator and its limit where that is lower than the peak at the nodes;
            efforts that are nothing beside those of the parked robot count as equal.
        points: number of points.
        exceeding: (M − 1,) steps in which the efforts exceed those at the nodes, or carrier forces their limits, by
            what is worth a middle node, and those beside them.
        broken: limits of main efforts and carrier forces that are exceeded between the nodes by more than is accepted.
    """

    peak: float
    time: float
    peak_at_nodes: float
    ratio: float
    points: int
    exceeding: BoolArray
    broken: tuple[LimitEvent, ...]

    @property
    def passed(self) -> bool:
        """Whether efforts and forces between the nodes are accepted."""
        return self.ratio <= ALLOWED and not self.broken

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
            "passed": self.passed,
        }


def dense_check(task: Task, problem: Problem, position: PiecewisePolynomial, tau: Array) -> DenseCheck:
    """Evaluate the backend on a grid finer than the nodes, and right beside the singular ones.

    Args:
        task: robot and motion.
        problem: the nodes.
        position: of the planned carriers, m.
        tau: (M, m) planned efforts at the nodes, N or N·m.
    """
    grid, settings, robot = problem.grid, task.settings, task.dynamics.robot
    left = np.flatnonzero(grid.h > 0.0)
    inside = grid.t[left, None] + grid.h[left, None] * np.arange(1, FINER) / FINER
    steps = [(i, i + side) for i in grid.singular for side in (-1, 0) if 0 <= i + side < len(grid.h)]
    beside = [grid.t[i] + (1.0 if j == i else -1.0) * fraction * grid.h[j] for i, j in steps for fraction in CLOSE]
    # nodes were judged already; between them no acceleration jumps, so every time may stand once
    times = np.setdiff1d(np.concatenate([inside.ravel(), beside]), grid.t)
    reduced = task.dynamics.along(task.source.sample_at(times)).reduce(carriers_at(position, times))
    efforts, forces = _efforts(reduced, grid.t, tau), np.asarray(reduced.carrier_force)
    effort_limit, force_limit = settings.limits.effort, settings.limits.carrier_force
    size, at_nodes = np.where(np.isfinite(efforts), np.abs(efforts), np.inf), float(np.abs(tau).max())
    # an actuator with a limit below the peak of the others is judged by its limit
    relative = (size / np.maximum(np.minimum(at_nodes, effort_limit), SMALL * problem.scales.tau)).max(axis=1)
    marked = (relative > MARKED) | (np.abs(forces) > MARKED * force_limit).any(axis=1)
    exceeding = np.zeros(len(grid.h), dtype=bool)
    exceeding[np.searchsorted(grid.t, times[marked], side="right") - 1] = True
    worst = int(size.max(axis=1).argmax())
    return DenseCheck(
        peak=float(size[worst].max()),
        time=float(times[worst]),
        peak_at_nodes=at_nodes,
        ratio=max(float(relative.max()), 1.0),
        points=len(times),
        exceeding=widened(exceeding, BESIDE),
        broken=limits_broken("effort", robot.actuated, times, efforts, effort_limit, ALLOWED)
        + limits_broken("force", robot.carriers, times, forces, force_limit, ALLOWED),
    )


def limits_broken(
    quantity: str, names: tuple[str, ...], t: Array, values: Array, limit: Array, allowed: float
) -> tuple[LimitEvent, ...]:
    """Return, for each actuator whose |value| exceeds its limit by more than a factor, where it does so most.

    Args:
        quantity: "effort" or "force".
        names: (j,) of the actuators.
        t: (N,) times, s.
        values: (N, j) efforts or forces, N or N·m; those that are not finite are judged elsewhere.
        limit: (j,) the largest allowed.
        allowed: factor on the limit.
    """
    events = []
    for name, own, most in zip(names, np.where(np.isfinite(values), values, 0.0).T, limit, strict=True):
        over = np.flatnonzero(np.abs(own) > allowed * most)
        if len(over):
            worst = int(over[np.abs(own[over]).argmax()])
            value = float(own[worst])
            excess = abs(value) - float(most)
            span = float(t[over[0]]), float(t[over[-1]])
            at = float(np.copysign(most, value))
            events.append(LimitEvent(name, quantity, *span, float(t[worst]), value, at, excess))
    return tuple(events)


def _efforts(reduced: ReducedDynamics, nodes: Array, tau: Array) -> Array:
    """Return W⁻¹ f; with more actuators than coordinates the efforts nearest to the planned ones, linear in a step."""
    n, m = reduced.W.shape[1:]
    if m <= n:
        return np.asarray(distribute(reduced).tau)
    planned = PiecewisePolynomial.linear(nodes, tau)(reduced.t)
    left = reduced.f - np.einsum("nim,nm->ni", reduced.W, planned)
    nearest: Array = planned + np.einsum("nmi,ni->nm", np.linalg.pinv(reduced.W), left)
    return nearest
