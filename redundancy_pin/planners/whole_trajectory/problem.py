"""The optimisation problem of a whole trajectory as numbers: what the solver is given."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import CarrierModel, carrier_model
from redundancy_pin.planners.stepwise.settings import target_effort
from redundancy_pin.planners.whole_trajectory.mesh import Grid
from redundancy_pin.planners.whole_trajectory.settings import WholeSettings
from redundancy_pin.planners.whole_trajectory.singular import SingularNode, local_model, singular_node
from redundancy_pin.trajectory.functions_of_time import ContinuousMotion


@dataclass(frozen=True, eq=False)
class Scales:
    """Sizes that the variables and equations are divided by.

    Attributes:
        s, sd, sdd: (k,) of the carriers' motion, m, m/s, m/s².
        tau: of the main efforts, N or N·m.
        row: (n,) of the rows of W τ = f, N or N·m.
        force: (k,) of the carriers' forces, N.
    """

    s: Array
    sd: Array
    sdd: Array
    tau: float
    row: Array
    force: Array


@dataclass(frozen=True, eq=False)
class WholeProblem:
    """Everything the solver needs; M nodes, n coordinates, m main actuators, k carriers.

    Attributes:
        grid: the nodes.
        model: coefficients of W, f and the carrier forces at the nodes.
        singular: the nodes on type II singularities.
        actuated_rate: (M, m) rates of the main actuators.
        target: (M, m) efforts that the objective "tracking" aims at.
        settings: limits, ends and objective.
        scales: sizes.
        more_terms: (M, n, k, 2) coefficients of f by ṡ² and s s̈, for carriers on curved tracks.
    """

    grid: Grid
    model: CarrierModel
    singular: tuple[SingularNode, ...]
    actuated_rate: Array
    target: Array
    settings: WholeSettings
    scales: Scales
    more_terms: Array | None = None


def scales_of(model: CarrierModel, settings: WholeSettings, row_scale: Array, duration: float) -> Scales:
    """Return sizes from the limits, and from the parked robot where there are none."""
    limits = settings.limits
    s = np.array([_finite(0.5 * (bounds.upper - bounds.lower), 1.0) for bounds in limits])
    sd = np.array([_finite(bounds.speed, 10.0 * s[i] / duration) for i, bounds in enumerate(limits)])
    sdd = np.array([_finite(bounds.acceleration, 10.0 * sd[i] / duration) for i, bounds in enumerate(limits)])
    size = float(np.abs(model.f0 / row_scale).max())
    if size == 0.0:
        size = float(np.abs(model.f_terms[..., 4] / row_scale[:, None] * sdd).max()) or 1.0
    largest = np.linalg.svd(model.W / row_scale[:, None], compute_uv=False)[:, 0]
    tau = size / float(np.median(largest))
    force = np.abs(model.force0).max(axis=0) + np.abs(model.force_terms[..., 4]).max(axis=0) * sdd
    return Scales(s, sd, sdd, tau, size * row_scale, np.where(force > 0.0, force, 1.0))


def _finite(value: float, otherwise: float) -> float:
    return value if np.isfinite(value) else otherwise


@dataclass(frozen=True, eq=False)
class Task:
    """A planning task: what does not depend on the nodes."""

    dynamics: Dynamics
    source: ContinuousMotion
    settings: WholeSettings
    baseline: Dynamics | None


def prepare(task: Task, grid: Grid, around: CarrierMotion | None = None) -> WholeProblem:
    """Read the coefficients at all nodes off the backend.

    Args:
        task: robot, motion and settings.
        grid: the nodes.
        around: for carriers on curved tracks, the motion at the nodes around which f is fitted.

    Raises:
        UnsupportedRobotError: carriers on curved tracks.
        InfeasiblePlanError: the baseline robot has no finite efforts somewhere.
    """
    motion = task.source.sample_at(grid.t)
    along = task.dynamics.along(motion)
    model, more = (carrier_model(along), None) if around is None else local_model(along, around)
    nodes = tuple(
        singular_node(
            task.dynamics,
            task.source,
            int(i),
            float(grid.t[i]),
            task.settings.dt,
            None if around is None else around[int(i) : int(i) + 1],
            "left" if i < len(grid.h) and grid.h[i] == 0.0 else "right",
        )
        for i in grid.singular
    )
    tracked = task.settings.lam if "tracking" in task.settings.objective else 0.0
    target, _ = target_effort(task.dynamics.robot, motion, tracked, task.baseline if tracked else None)
    rate: Array = np.einsum("nim,ni->nm", model.W, motion.xd)
    row_scale = along.reduce().row_scale
    duration = task.source.end - task.source.start
    scales = scales_of(model, task.settings, row_scale, duration)
    return WholeProblem(grid, model, nodes, read_only(rate), read_only(target), task.settings, scales, more)
