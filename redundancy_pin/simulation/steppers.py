"""Integrators: scipy's solvers, and machine code if the machine has it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.integrate import DOP853, RK45, OdeSolver, Radau

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.forward import ForwardKernel, Integration, Rules
from redundancy_pin.errors import IllPosedModelError, InputError, RedundancyPinError, SingularPoseError
from redundancy_pin.simulation.controllers.base import Command
from redundancy_pin.simulation.events import BETWEEN, BRIEF
from redundancy_pin.simulation.problem import (
    SAME,
    InitialValueProblem,
    SimulatedSample,
    SimulationProgress,
    SmoothInterval,
)
from redundancy_pin.simulation.rank_loss import NEAR
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

INTEGRATORS = {"DOP853": DOP853, "RK45": RK45, "Radau": Radau}
"""Runge-Kutta methods of scipy: explicit ones of order 8 and 5, the latter cheaper where a sampled controller makes
every step short; and the implicit Radau IIA of order 5 for stiff springs and dampers."""

EXPLICIT = ("DOP853", "RK45")
"""Those that machine code has."""

VELOCITY_CHANGE, VELOCITY_FLOOR = 0.05, 1e-3
"""The projection may change a velocity by this share of the largest, and this much, characteristic lengths or rad in a
time scale. It takes away what a step has gained in error; a change beyond that leads to another branch."""

_DIFFERENCE = 1e-7
"""Step of the differences for the Jacobian of an implicit integrator, share of a number or of its unit."""

_PORTION = 1000
"""Steps of machine code between two looks of Python at its signals."""


class Rate:
    """ẏ over the rest of an interval up to ``end``, s, as scipy's solvers call it, and the progress it starts from.

    ``failure`` is the error of the last call without an answer in this step.
    """

    def __init__(self, progress: SimulationProgress, unit: Array, end: float) -> None:
        self._machine, self._hold, self._unit, self._end = progress.machine, progress.hold, unit, end
        self.sheet = progress.sheet
        self.evaluations = 0
        self.failure: RedundancyPinError | None = None

    def __call__(self, t: float, y: Array) -> Array:
        """Return ẏ; NaN if it is undetermined: the integrator then tries a shorter step."""
        self.evaluations += 1
        if y[0] != y[0]:  # a stage after one that had no answer
            return np.full(len(y), np.nan)
        # efforts that jump at the end of an interval are evaluated just before it
        state = self._machine.state(t if t < self._end else float(np.nextafter(self._end, -np.inf)), y)
        try:
            return self._machine.rate(state, self._machine.command(state, self._hold), self.sheet)
        except (IllPosedModelError, SingularPoseError, InputError) as error:
            # a controller may have no answer to the state of a trial step that is too long
            self.failure = error
            return np.full(len(y), np.nan)

    def jacobian(self, t: float, y: Array) -> Array:
        """Return ∂ẏ/∂y by differences; scipy's own step grows without bound where nothing depends on a coordinate."""
        here, steps = self(t, y), _DIFFERENCE * np.maximum(self._unit, np.abs(y))
        columns = [(self(t, y + step * e) - here) / step for step, e in zip(steps, np.eye(len(y)), strict=True)]
        J: Array = np.nan_to_num(np.stack(columns, axis=1))  # no answer: Newton fails, and the step is shortened
        return J


def solver(
    problem: InitialValueProblem, progress: SimulationProgress, interval: SmoothInterval
) -> tuple[OdeSolver, Rate]:
    """Return scipy's solver over the rest of an interval; it selects the first step unless one is suggested."""
    rate = Rate(progress, problem.unit, interval.end)
    step = None if progress.next_step is None else min(progress.next_step, interval.end - progress.t)
    implicit = {} if problem.method in EXPLICIT else {"jac": rate.jacobian}
    method = INTEGRATORS[problem.method]
    return method(rate, progress.t, progress.y, interval.end, first_step=step, **implicit, **problem.settings), rate


class OrdinarySteps:
    """The steps that machine code takes.

    Args:
        kernel: machine code of the machine.
        problem: the problem that is integrated.
        start: its start.
        intervals: its smooth intervals.
    """

    def __init__(
        self,
        kernel: ForwardKernel,
        problem: InitialValueProblem,
        start: SimulationProgress,
        intervals: list[SmoothInterval],
    ) -> None:
        self._machine, self._problem, self._sampled = start.machine, problem, problem.sampling is not None
        amplifiers, manifold, grid = self._machine.amplifiers, self._machine.manifold, problem.grid
        self._by_time = self._machine.heeds_time_only and (self._sampled or amplifiers.open_loop is not None)
        nothing = PiecewisePolynomial.constant(np.zeros(len(amplifiers.limits)), grid[0], grid[-1])
        self._hold: Command | None = None
        rules = Rules(
            method=problem.method,
            **problem.settings,
            grid=grid,
            time_tolerance=SAME * float(grid[1] - grid[0]),
            breaks=np.array([interval.end for interval in intervals]),
            efforts=(amplifiers.open_loop or nothing) if self._by_time else None,
            loads=None if self._by_time else self._loads,
            prescribed=self._machine.dynamics.prescribed,
            limits=amplifiers.limits,
            stops=start.functions.stops,
            time=problem.time,
            brief=BRIEF,
            check_travel=BETWEEN,
            near_rank=NEAR,
            shortest=problem.shortest,
            tolerance=manifold.tolerance,
            largest_residual=manifold.largest_residual,
            velocity_change=VELOCITY_CHANGE,
            velocity_floor=VELOCITY_FLOOR,
        )
        self._code: Integration = kernel.integration(rules)

    def _loads(self, t: float, q: Array, v: Array) -> tuple[Array, tuple[Array, Array, Array] | None]:
        return self._machine.forces_at(t, q, v, self._hold)

    def take(self, progress: SimulationProgress, interval: SmoothInterval) -> SimulationProgress:
        """Take the ordinary steps ahead, to the end of the interval, or without a command on hold to the end of all."""
        problem, grid, samples, hold = self._problem, self._problem.grid, progress.samples, progress.hold
        self._hold = hold
        if hold is not None and self._by_time:
            self._code.hold(np.concatenate(hold))
        end = interval.end if self._sampled else float(grid[-1])
        if progress.next_step is None:  # scipy's first one
            stepper, rate = solver(problem, progress, interval)
            evaluations = progress.evaluations + rate.evaluations
            progress = replace(progress, next_step=float(stepper.h_abs), evaluations=evaluations)
        before, stopped = progress.steps, False
        while not stopped and progress.t < end and progress.steps < problem.max_steps:
            # in portions, so that it can be interrupted and reports how far it is
            portion = min(_PORTION, problem.max_steps - progress.steps)
            progress, states, stopped = self._code.advance(progress, len(samples), end, portion)
            times = grid[len(samples) : len(samples) + len(states)].tolist()
            samples.extend(SimulatedSample(t, y, self._machine, hold, None) for t, y in zip(times, states, strict=True))
            problem.notify(progress)
        return replace(progress, short=0) if progress.steps > before else progress
