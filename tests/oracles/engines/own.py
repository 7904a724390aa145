"""This package's own forward dynamics as one more engine, to be compared with the outside ones on equal terms."""

from __future__ import annotations

from importlib.metadata import version
from typing import Literal

import numpy as np

from engines.run import EngineRun
from engines.task import Task
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.simulate import ATOL, RTOL, simulate
from redundancy_pin.simulation.state import State, tree_state
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

RESOLVED = 1e-12
"""Last Chebyshev coefficients of efforts that are no polynomials yet, relative to the largest."""


class TaskEfforts:
    """The efforts of a task as a controller that heeds nothing but the time.

    Args:
        task: initial state and efforts.
    """

    def __init__(self, task: Task) -> None:
        self.end = task.end
        self.breaks = task.breaks
        given = task.efforts
        if not isinstance(given, PiecewisePolynomial):
            edges = np.array([task.start, *task.breaks, task.end])
            given = PiecewisePolynomial.fit(given, edges, np.empty(0), _size, RESOLVED)
        self._efforts = given
        self.jumps = given.jumps()
        self._m = task.robot.m
        self._start = (task.start, task.q, task.v)

    @property
    def open_loop(self) -> PiecewisePolynomial:
        """The efforts as polynomials of time."""
        return self._efforts

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        """Return main efforts (m,) and carrier forces (k,) at time t."""
        both = self._efforts.at(t)
        return both[: self._m], both[self._m :]

    def start_state(self, robot: Robot) -> State:
        """Return the state that the task starts from."""
        t, q, v = self._start
        return tree_state(robot, q, v, t=t)


def run_own(
    task: Task,
    *,
    rtol: float = RTOL,
    atol: float = ATOL,
    integrator: Literal["DOP853", "RK45"] = "DOP853",
    restart_at: Literal["breaks", "jumps"] = "breaks",
    dt: float = 0.01,
    dynamics: Dynamics | None = None,
) -> EngineRun:
    """Integrate a task with ``simulate``; nothing ends it before its time, carriers off their tracks included.

    Args:
        task: initial state and efforts.
        rtol: relative tolerance of a step.
        atol: absolute tolerance of a step, m, rad, m/s and rad/s.
        integrator: "DOP853" or "RK45".
        restart_at: "breaks" or "jumps", see ``simulate``.
        dt: interval between the instants of the result, s.
        dynamics: a backend with forward dynamics in machine code, see ``simulate``.

    Returns:
        The motion; ``steps`` are those of the integrator. Where it failed the status is ``STOPPED``.

    Raises:
        UnsupportedRobotError: see ``simulate``.
        InputError: a setting out of its domain.
        IllPosedModelError, SingularPoseError: at the start, forces do not determine the acceleration.
    """
    options = {"rtol": rtol, "atol": atol, "integrator": integrator, "restart_at": restart_at}
    run = simulate(task.robot, TaskEfforts(task), stop_at=(), dt=dt, dynamics=dynamics, **options)  # type: ignore[arg-type]
    return EngineRun(
        engine="redundancy_pin",
        version=version("redundancy_pin"),
        settings=options,
        t=run.t,
        x=run.x,
        s=run.s,
        q=run.q,
        v=run.v,
        gap=run.gap,
        steps=run.statistics.steps,
        seconds=run.statistics.seconds,
        status=ResultStatus.OK if run.status is ResultStatus.OK else ResultStatus.NOT_CONVERGED,
        message=run.reason,
    )


def _size(values: Array) -> Array:
    largest: Array = np.maximum(np.abs(values).max(axis=0), np.finfo(float).tiny)
    return largest
