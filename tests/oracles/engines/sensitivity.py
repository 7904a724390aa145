"""How an error at the start grows when nothing controls it: what an open-loop comparison has to live with."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from engines.run import EngineRun
from engines.task import Task
from redundancy_pin.arrays import Array, read_only
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import difference

PROBE = 1e-6
"""Initial speed error, m/s and rad/s: its effect stands far above an engine's rounding and is still linear."""


def open_loop_growth(
    task: Task, integrate: Callable[[Task], EngineRun], *, probe: float = PROBE
) -> tuple[Array, Array]:
    """Return times (N,), s, and (N,) the largest displacement there per initial speed error, in s.

    Each independent coordinate and each carrier gets the error in turn; of the displacements of platform (m and rad
    alike) and carriers the largest counts. A free body gives t; what is above it is instability.

    Args:
        task: the task.
        integrate: runs a task with an engine; every run must have the same times.
        probe: initial speed error, m/s and rad/s.
    """
    robot = task.robot
    state = ConstraintSystem(robot).evaluate(np.array(task.q)[None])
    carriers = np.zeros((robot.k, robot.model.nv))
    carriers[np.arange(robot.k), robot.carrier_velocity] = 1.0
    rows = np.concatenate([state.Jc[0], state.Jx[0], carriers])
    free = robot.n + robot.k
    directions = np.linalg.solve(rows, np.eye(len(rows))[:, -free:])
    nominal = integrate(task)
    growth = np.zeros(len(nominal.t))
    for direction in directions.T:
        moved = Task(robot, task.start, task.end, task.q, task.v + probe * direction, task.efforts, task.breaks)
        run = integrate(moved)
        count = min(len(run.t), len(nominal.t))
        off = np.concatenate(
            [difference(robot, run.x[:count], nominal.x[:count]), run.s[:count] - nominal.s[:count]], axis=1
        )
        growth[:count] = np.maximum(growth[:count], np.linalg.norm(off, axis=1) / probe)
        growth[count:] = np.inf
    return nominal.t, read_only(growth)
