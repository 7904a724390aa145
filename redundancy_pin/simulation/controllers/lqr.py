"""Time-varying linear quadratic regulator along a reference; finite at type II poses."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import LinAlgError, block_diag, solve_continuous_are, solve_discrete_are

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.errors import InputError
from redundancy_pin.planners.continuous_motion import TimedTrajectory
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.control import CarrierDrive, Sampling, limit
from redundancy_pin.simulation.controllers.linear_model import LinearModel, linear_model, sampled_model
from redundancy_pin.simulation.controllers.riccati import NEGATIVE, Riccati, continuous_riccati, discrete_riccati
from redundancy_pin.simulation.controllers.tracking import Tracking
from redundancy_pin.simulation.controllers.weights import LqrWeights, bryson_weights
from redundancy_pin.simulation.linearise import state_error
from redundancy_pin.simulation.reference import MotionReference
from redundancy_pin.simulation.state import State

STEP = 5e-3
"""Default distance of the nodes of the linear model, s: planned motions change within 50 ms."""

CONTINUOUS_STEP = 1e-3
"""Intervals of constant A and B in the continuous Riccati equation, s."""


class TimeVaryingLqr(Tracking):
    """Plan plus linear state feedback, u = u_d(t) − K(t) δz, gains from the Riccati equation along the plan.

    Main actuators and carriers are inputs alike. The linear model exists at type II poses, and so do the gains: the
    carriers hold what the main actuators cannot. The final cost is that of holding the last pose for ever (algebraic
    Riccati equation at the end); where that has no solution (the last pose cannot be held) it is Q for one second.

    Without ``sampling`` the gains are those of the continuous equation, linear between nodes. With it they are those of
    the zero-order hold, and the efforts that still act during the delay are part of the state.

    Its feedback holds the carriers too, by their forces: ``simulate(carriers="motion")`` refuses it.

    Args:
        plan: a plan, or a reference of a robot; its robot is the model that the controller knows.
        motion: the trajectory that was planned for, for exact values between the samples of a plan.
        weights: cost rates; ``bryson_weights(reference)`` when left out.
        effort_limit: scalar or (m,) where the amplifiers saturate, N or N·m.
        carrier_force_limit: scalar or (k,) the same for the carriers, N.
        sampling: of the simulation; its delay may be up to one period.
        step: distance of the nodes of the linear model, s.

    Attributes:
        model: the linear model along the reference.
        t: (N + 1,) instants of the gains, s.
        riccati: cost to go and gains.
        holds_end: whether the last pose can be held, by the algebraic Riccati equation.

    Raises:
        InputError: weights of the wrong shape or sign, a delay of more than one period.
        SingularPoseError: a type I pose on the way.
        IllPosedModelError: a free motion of the model has no inertia somewhere on the way.
        InfeasiblePlanError, PlanFileError: see ``plan_reference``.
    """

    carrier_drive: CarrierDrive = "force"
    """A motion that is prescribed would leave nothing of the feedback on the carriers."""

    def __init__(
        self,
        plan: Plan | MotionReference,
        *,
        motion: TimedTrajectory | None = None,
        weights: LqrWeights | None = None,
        effort_limit: ArrayLike | None = None,
        carrier_force_limit: ArrayLike | None = None,
        sampling: Sampling | None = None,
        step: float = STEP,
    ) -> None:
        super().__init__(plan, motion, sampling)
        robot, reference = self.robot, self.reference
        if not (np.isfinite(step) and step > 0.0):
            raise InputError(f"step is {step} s.", remedy="Pass a positive number.", name="step")
        if sampling is not None and sampling.delay > sampling.period:
            raise InputError(
                f"The delay of {sampling.delay} s is longer than the period of {sampling.period} s.",
                remedy="Sample more slowly, or use ComputedTorque, which predicts over any delay.",
            )
        self.weights = bryson_weights(reference) if weights is None else weights
        _require_shapes(self.weights, 2 * (robot.n + robot.k), robot.m + robot.k)
        self._limit = np.concatenate(
            [limit(effort_limit, robot.m, "effort_limit"), limit(carrier_force_limit, robot.k, "carrier_force_limit")]
        )
        self.model = linear_model(reference, step)
        if sampling is None:
            self.t, self.riccati, self.holds_end = _continuous(self.model, self.weights)
        else:
            self.t, self.riccati, self.holds_end = _sampled(self.model, self.weights, sampling)
        self._times: list[float] = self.t.tolist()
        nothing = np.zeros(robot.m + robot.k)
        self._memory: tuple[float, Array, Array] = (np.inf, nothing, nothing)

    def gain(self, t: float) -> Array:
        """Return K (m + k, e) at time t: linear between nodes, or that of the sampling instant at or before t."""
        K = self.riccati.K
        i = bisect_right(self._times, t + self._tolerance) - 1
        if self.sampling is not None:
            held: Array = K[min(max(i, 0), len(K) - 1)]
            return held
        i = min(max(i, 0), len(K) - 2)
        share = min(max((t - self.t[i]) / (self.t[i + 1] - self.t[i]), 0.0), 1.0)
        between: Array = (1.0 - share) * K[i] + share * K[i + 1]
        return between

    @property
    def _tolerance(self) -> float:
        return 0.0 if self.sampling is None else 1e-6 * self.sampling.period

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        """Return main efforts (m,) and carrier forces (k,) at time t."""
        robot, reference = self.robot, self.reference
        x, xd, _ = reference.platform(t)
        s, sd, _ = reference.carriers(t)
        error = state_error(robot, state, x, xd, s, sd)
        planned = np.concatenate(reference.loads(t + self.lead))
        K = self.gain(t)
        acting = self._acting(t)
        if K.shape[1] > len(error):
            error = np.concatenate([error, acting])
        command = np.clip(planned - K @ error, -self._limit, self._limit)
        if self.sampling is not None:
            self._memory = (t, command - planned, acting)
        return command[: robot.m], command[robot.m :]

    def _acting(self, t: float) -> Array:
        """Return δu of the sample one period before t; zero where there was none, as at the start of a simulation.

        Asked again for the same t, it gives the same again. What an earlier simulation left does not count.
        """
        last, newest, before = self._memory
        if last == t:
            return before
        period = 0.0 if self.sampling is None else self.sampling.period
        return newest if 0.0 < t - last < 1.5 * period else np.zeros_like(newest)


def _continuous(model: LinearModel, weights: LqrWeights) -> tuple[Array, Riccati, bool]:
    Q, R = weights.Q, weights.R
    count = max(1, int(np.ceil((model.t[-1] - model.t[0]) / CONTINUOUS_STEP - 1e-9)))
    times = np.linspace(model.t[0], model.t[-1], count + 1)
    A, B = model.at(0.5 * (times[1:] + times[:-1]))
    final, holds = _final(lambda: solve_continuous_are(model.A[-1], model.B[-1], Q, R), Q)
    return read_only(times), continuous_riccati(A, B, Q, R, final, np.diff(times)), holds


def _sampled(model: LinearModel, weights: LqrWeights, sampling: Sampling) -> tuple[Array, Riccati, bool]:
    period = sampling.period
    Q, R = period * weights.Q, period * weights.R
    found = sampled_model(model, float(model.t[0]), float(model.t[-1]), period, sampling.delay)
    extra = found.transition.shape[1] - len(Q)
    Q = block_diag(Q, np.zeros((extra, extra))) if extra else Q
    final, holds = _final(lambda: solve_discrete_are(found.transition[-1], found.input[-1], Q, R), Q / period)
    return found.t, discrete_riccati(found.transition, found.input, Q, R, final), holds


def _final(solve: Callable[[], Array], fallback: Array) -> tuple[Array, bool]:
    """Return the cost of holding the last pose, or, where it cannot be held, that of one second of error."""
    try:
        final = np.asarray(solve())
    except (LinAlgError, ValueError):
        return fallback, False
    return (final, True) if np.isfinite(final).all() else (fallback, False)


def _require_shapes(weights: LqrWeights, states: int, inputs: int) -> None:
    for name, matrix, size in (("Q", weights.Q, states), ("R", weights.R, inputs)):
        if matrix.shape != (size, size) or not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T):
            raise InputError(
                f"{name} has shape {matrix.shape}; it must be finite, symmetric and ({size}, {size}).",
                remedy="Make the weights with bryson_weights(reference).",
                name=name,
            )
    of_states = np.linalg.eigvalsh(weights.Q)
    if of_states[0] < -NEGATIVE * abs(of_states[-1]) or np.linalg.eigvalsh(weights.R)[0] <= 0.0:
        raise InputError(
            "Q must be positive semidefinite and R positive definite.",
            remedy="Make the weights with bryson_weights(reference).",
        )
