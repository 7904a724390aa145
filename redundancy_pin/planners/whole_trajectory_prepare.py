"""From a robot and a motion to the numbers of the optimisation problem: the only calls of the backend."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import carrier_model
from redundancy_pin.planners.continuous_motion import ContinuousMotion
from redundancy_pin.planners.stepwise_settings import target_effort
from redundancy_pin.planners.whole_trajectory_data import WholeProblem, scales_of
from redundancy_pin.planners.whole_trajectory_grid import Grid
from redundancy_pin.planners.whole_trajectory_local import local_model
from redundancy_pin.planners.whole_trajectory_settings import WholeSettings
from redundancy_pin.planners.whole_trajectory_singular import singular_node


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
