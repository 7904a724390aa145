"""Time-varying linear quadratic regulator along a reference; finite at type II poses.

Three steps: the linear model along the reference (``linear_model``; ``sampled_model`` for a digital controller), the
Riccati equation backwards along it, and the feedback u = u_d(t) − K(t) δz.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import make_interp_spline
from scipy.linalg import LinAlgError, block_diag, cho_factor, cho_solve, expm, solve_continuous_are, solve_discrete_are

from redundancy_pin.arrays import Array, Frozen, frozen, positive, read_only
from redundancy_pin.dynamics.default import DynamicsLike
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.reference import MotionReference
from redundancy_pin.robot.scales import row_scale
from redundancy_pin.simulation.controllers.base import (
    CarrierDrive,
    Command,
    Sampling,
    Tracking,
    kernel_of,
    largest_loads,
    load_limits,
    positive_each,
)
from redundancy_pin.simulation.derivatives import linearise_along, state_error
from redundancy_pin.simulation.state import State
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

LEAST_SHARE = 0.05
"""An actuator that a plan hardly uses may still deviate by this share of the largest of its kind."""

NEGATIVE = 1e-9
"""Share of the largest eigenvalue by which rounding may make the smallest one of P negative."""

STEP = 5e-3
"""Default distance of the nodes of the linear model, s: planned motions change within 50 ms."""

CONTINUOUS_STEP = 1e-3
"""Intervals of constant A and B in the continuous Riccati equation, s."""


@dataclass(frozen=True, eq=False)
class LqrWeights(Frozen):
    """Cost rates of the regulator: ∫ δzᵀ Q δz + δuᵀ R δu dt.

    Attributes:
        Q: (2d, 2d) of δz = (δx, δs, δẋ, δṡ).
        R: (m + k, m + k) of δu = (δτ, δF).
    """

    Q: Array
    R: Array


def bryson_weights(
    reference: MotionReference,
    *,
    position: float = 1e-3,
    carrier: float = 1e-2,
    bandwidth: float = 30.0,
    effort: ArrayLike | None = None,
    carrier_force: ArrayLike | None = None,
) -> LqrWeights:
    """Return diagonal weights 1 / (acceptable deviation)² (Bryson and Ho 1975, section 5.2).

    Args:
        reference: the motion; its largest efforts are the acceptable deviations of efforts unless given.
        position: acceptable error of the platform, m; rotations get this over the characteristic length, rad.
        carrier: acceptable error of the carriers, m.
        bandwidth: acceptable errors of speeds over acceptable errors of positions, rad/s.
        effort: scalar or (m,) acceptable deviation of the main efforts, N or N·m, for example their limit less their
            planned peak.
        carrier_force: scalar or (k,) the same for the carriers, N.

    Raises:
        InputError: a value that is not positive, or of the wrong shape.

    Example:
        >>> from redundancy_pin.simulation import controllers
        >>> from redundancy_pin.simulation import plan_reference
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner())
        >>> controllers.bryson_weights(plan_reference(plan)).Q.shape
        (12, 12)
    """
    for name, value in (("position", position), ("carrier", carrier), ("bandwidth", bandwidth)):
        positive(value, name, "")
    robot = reference.robot
    largest = largest_loads(reference)
    main = positive_each(effort, largest[0], LEAST_SHARE, "effort")
    carriers = positive_each(carrier_force, largest[1], LEAST_SHARE, "carrier_force")
    place = np.concatenate([position / row_scale(robot), np.full(robot.k, carrier)])
    state = np.concatenate([place, bandwidth * place])
    return LqrWeights(frozen(np.diag(state**-2.0)), frozen(np.diag(np.concatenate([main, carriers]) ** -2.0)))


@dataclass(frozen=True, eq=False)
class Riccati(Frozen):
    """Solution of a finite-horizon Riccati equation.

    Attributes:
        P: (N + 1, e, e) cost to go: ξᵀ P ξ; symmetric, positive semidefinite.
        K: (N, p, e) gains: δu = −K ξ.
        least_eigenvalue: smallest eigenvalue of all P, relative to the largest of the same P.
    """

    P: Array
    K: Array
    least_eigenvalue: float


def discrete_riccati(transition: Array, input: Array, Q: Array, R: Array, final: Array) -> Riccati:
    """Minimise ξ_Nᵀ P_N ξ_N + Σ ξ_iᵀ Q ξ_i + u_iᵀ R u_i along ξ_{i+1} = Φ_i ξ_i + Γ_i u_i, i < N.

    Joseph's form (Φ − ΓK)ᵀ P (Φ − ΓK) + Q + Kᵀ R K keeps P symmetric and positive whatever the rounding of K.
    """
    count, size, inputs = input.shape
    P, K = np.empty((count + 1, size, size)), np.empty((count, inputs, size))
    P[-1] = 0.5 * (final + final.T)
    for i in range(count - 1, -1, -1):
        phi, gamma, after = transition[i], input[i], P[i + 1]
        weighted = after @ gamma
        K[i] = cho_solve(_factor(R + gamma.T @ weighted), weighted.T @ phi)
        closed = phi - gamma @ K[i]
        cost = closed.T @ after @ closed + Q + K[i].T @ R @ K[i]
        P[i] = 0.5 * (cost + cost.T)
    return Riccati(read_only(P), read_only(K), _least_eigenvalue(P))


def continuous_riccati(A: Array, B: Array, Q: Array, R: Array, final: Array, step: Array) -> Riccati:
    """Solve −Ṗ = AᵀP + PA − P B R⁻¹ Bᵀ P + Q backwards, exactly for A and B constant in each interval.

    With the Hamiltonian H = [[A, −B R⁻¹ Bᵀ], [−Q, −Aᵀ]] and [X; Y] = exp(−H h) [I; P(t + h)], P(t) = Y X⁻¹.
    ``step`` (N,) are the lengths h of the intervals, s; K is at the N + 1 ends like P, with the B of the interval
    before (after, at the start).
    """
    count, size, _ = B.shape
    factor = _factor(R)
    gain = np.array([cho_solve(factor, b.T) for b in B])
    hamiltonian = np.empty((count, 2 * size, 2 * size))
    hamiltonian[:, :size, :size], hamiltonian[:, :size, size:] = A, -B @ gain
    hamiltonian[:, size:, :size], hamiltonian[:, size:, size:] = -Q, -A.transpose(0, 2, 1)
    powers = expm(-hamiltonian * step[:, None, None])
    P = np.empty((count + 1, size, size))
    P[-1] = 0.5 * (final + final.T)
    for i in range(count - 1, -1, -1):
        stacked = powers[i, :, :size] + powers[i, :, size:] @ P[i + 1]
        cost = np.linalg.solve(stacked[:size].T, stacked[size:].T).T
        P[i] = 0.5 * (cost + cost.T)
    K = np.concatenate([gain[:1], gain]) @ P
    return Riccati(read_only(P), read_only(K), _least_eigenvalue(P))


def _factor(cost: Array) -> tuple[Array, bool]:
    try:
        factor: tuple[Array, bool] = cho_factor(cost)
    except LinAlgError as error:
        raise InputError(
            "The cost of the inputs is not positive definite.", remedy="Give every effort a positive weight."
        ) from error
    return factor


def _least_eigenvalue(P: Array) -> float:
    """Return the smallest relative eigenvalue of costs that must be finite and positive semidefinite."""
    least = float("nan")
    if np.isfinite(P).all():
        values = np.linalg.eigvalsh(P)
        least = float((values[:, 0] / np.maximum(np.abs(values).max(axis=1), np.finfo(float).tiny)).min())
    if not least >= -NEGATIVE:
        raise InputError(
            f"The Riccati equation has no positive solution: smallest relative eigenvalue {least:.3g}.",
            remedy="Pass Q and the final cost without negative eigenvalues, and less extreme weights.",
            least=least,
        )
    return least


@dataclass(frozen=True, eq=False)
class LinearModel(Frozen):
    """d(δz)/dt = A(t) δz + B(t) δu (``simulation.derivatives``), linear between nodes ``t`` (T,), s."""

    t: Array
    A: Array
    B: Array

    def at(self, times: Array) -> tuple[Array, Array]:
        """Return A (N, 2d, 2d) and B (N, 2d, m + k) at times (N,); outside the nodes those at the ends."""
        within = np.clip(times, self.t[0], self.t[-1])
        return make_interp_spline(self.t, self.A, k=1)(within), make_interp_spline(self.t, self.B, k=1)(within)


def linear_model(reference: MotionReference, step: float, dynamics: DynamicsLike | None = None) -> LinearModel:
    """Return the linearisation along a reference at nodes at most ``step``, s, apart; raises like ``linearise``."""
    robot, chain = reference.robot, ClosedChain(reference.robot)
    count = max(2, int(np.ceil((reference.end - reference.start) / step - 1e-9)) + 1)
    times = np.linspace(reference.start, reference.end, count)
    states = [State(chain, t, *reference.tree(t)[:2]) for t in times.tolist()]
    tau, force = (np.array(part) for part in zip(*(reference.loads(t) for t in times.tolist()), strict=True))
    nodes = linearise_along(robot, states, tau, force, kernel_of(robot, dynamics))
    A, B = (read_only(np.array(part)) for part in zip(*((node.A, node.B) for node in nodes), strict=True))
    return LinearModel(read_only(times), A, B)


@dataclass(frozen=True, eq=False)
class SampledModel(Frozen):
    """ξ_{i+1} = Φ_i ξ_i + Γ_i δu_i with ξ = (δz, δu of the sample before); the latter acts until the delay is over.

    ``t`` (N + 1,) sampling instants, s; without delay ξ is δz.
    """

    t: Array
    transition: Array
    input: Array


def sampled_model(model: LinearModel, start: float, end: float, period: float, delay: float) -> SampledModel:
    """Return the zero-order hold of a linear model from start to end, s, by matrix exponentials.

    A and B count as constant in each of the two parts of a period: before the new input acts, and after. The delay
    is at most one period.
    """
    count = max(1, int(np.ceil((end - start) / period - 1e-9)))
    times = start + period * np.arange(count + 1.0)
    transition, old = _hold(model, times[:-1] + 0.5 * delay, delay)
    after, new = _hold(model, times[:-1] + 0.5 * (delay + period), period - delay)
    phi, gamma = after @ transition, new
    if delay > 0.0:  # the input of the sample before is part of the state
        states, inputs = new.shape[1:]
        zero, one = np.zeros((count, inputs, states + inputs)), np.broadcast_to(np.eye(inputs), (count, inputs, inputs))
        phi = np.concatenate([np.concatenate([phi, after @ old], axis=2), zero], axis=1)
        gamma = np.concatenate([gamma, one], axis=1)
    return SampledModel(read_only(times), read_only(phi), read_only(gamma))


def _hold(model: LinearModel, times: Array, duration: float) -> tuple[Array, Array]:
    """Return Φ and Γ over intervals of one duration with the A and B of their middles."""
    A, B = model.at(times)
    states, inputs = B.shape[1:]
    block = np.zeros((len(times), states + inputs, states + inputs))
    block[:, :states, :states], block[:, :states, states:] = A, B
    power = expm(duration * block)
    return power[:, :states, :states], power[:, :states, states:]


class TimeVaryingLqr(Tracking):
    """Plan plus linear state feedback, u = u_d(t) − K(t) δz, gains from the Riccati equation along the plan.

    Main actuators and carriers are inputs alike. The linear model exists at type II poses, and so do the gains: the
    carriers supply the force that the main actuators cannot. The final cost is the cost of keeping the last pose for
    ever (algebraic Riccati equation at the end); if no control can keep the pose it is Q for one second.

    Without ``sampling`` the gains solve the continuous equation, linear between nodes. With it they are gains for
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
        dynamics: the plan's robot, or its name or path, for generated code (``as_dynamics``), by whose derivatives the
            linear model is made; or a backend of it.

    Attributes:
        model: the linear model along the reference.
        t: (N + 1,) instants of the gains, s.
        riccati: cost to go and gains.
        holds_end: whether the last pose can be stabilised, by the algebraic Riccati equation.

    Raises:
        InputError: weights of the wrong shape or sign, a delay of more than one period.
        SingularPoseError: a type I pose on the way.
        IllPosedModelError: a free motion of the model has no inertia somewhere on the way.
        InfeasiblePlanError, PlanFileError: see ``plan_reference``.

    Example:
        >>> from redundancy_pin.simulation import controllers
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner())
        >>> control = controllers.TimeVaryingLqr(plan, step=0.05)
        >>> control.holds_end
        True
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
        dynamics: DynamicsLike | None = None,
    ) -> None:
        super().__init__(plan, motion, sampling)
        robot, reference = self.robot, self.reference
        positive(step, "step", "s")
        if sampling is not None and sampling.delay > sampling.period:
            raise InputError(
                f"The delay of {sampling.delay} s is longer than the period of {sampling.period} s.",
                remedy="Sample more slowly, or use ComputedTorque, which predicts over any delay.",
            )
        self.weights = bryson_weights(reference) if weights is None else weights
        _require_weights(self.weights, 2 * (robot.n + robot.k), robot.m + robot.k)
        self._limit = np.concatenate(load_limits(robot, effort_limit, carrier_force_limit))
        self.model = linear_model(reference, step, dynamics)
        if sampling is None:
            self.t, self.riccati, self.holds_end = _continuous(self.model, self.weights)
            self._gain = PiecewisePolynomial.linear(self.t, self.riccati.K.reshape(len(self.t), -1))
        else:
            self.t, self.riccati, self.holds_end = _sampled(self.model, self.weights, sampling)
        nothing = np.zeros(robot.m + robot.k)
        # time of the last answer of a digital controller, its δu, and the δu that acted then: δu of the sample before
        self._memory: tuple[float, Array, Array] = (np.inf, nothing, nothing)

    def gain(self, t: float) -> Array:
        """Return K (m + k, e) at time t: linear between nodes, or the gain of the last sampling instant up to t."""
        K = self.riccati.K
        if self.sampling is not None:  # a reading at an instant may come a rounding before it
            i = int(np.searchsorted(self.t, t + 1e-6 * self.sampling.period, side="right")) - 1
            gain: Array = K[min(max(i, 0), len(K) - 1)]
            return gain
        return self._gain.at(t).reshape(K.shape[1:])

    def effort(self, t: float, state: State) -> Command:
        """Return main efforts (m,) and carrier forces (k,) at time t."""
        robot, m = self.robot, self.robot.m
        x, xd, s, sd, planned = self.reference.course(t)
        error = state_error(robot, state, x, xd, s, sd)
        K = self.gain(t)
        if self.sampling is not None:
            planned = self.reference.efforts.at(t + self.lead)
            acting = self._acting(t, self.sampling.period)
            if K.shape[1] > len(error):
                error = np.concatenate([error, acting])
        command = np.minimum(np.maximum(planned - K @ error, -self._limit), self._limit)
        if self.sampling is not None:
            self._memory = (t, command - planned, acting)
        return command[:m], command[m:]

    def _acting(self, t: float, period: float) -> Array:
        """Return δu of the sample one period before t; zero where there was none, as at the start of a simulation.

        Asked again for the same t, it gives the same again. What an earlier simulation left does not count.
        """
        last, newest, before = self._memory
        if last == t:
            return before
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
    hold = sampled_model(model, float(model.t[0]), float(model.t[-1]), period, sampling.delay)
    extra = hold.transition.shape[1] - len(Q)
    Q = block_diag(Q, np.zeros((extra, extra))) if extra else Q
    final, holds = _final(lambda: solve_discrete_are(hold.transition[-1], hold.input[-1], Q, R), Q / period)
    return hold.t, discrete_riccati(hold.transition, hold.input, Q, R, final), holds


def _final(solve: Callable[[], Array], fallback: Array) -> tuple[Array, bool]:
    """Return the cost of holding the last pose or, if no control can hold it, the cost of one second of error."""
    try:
        final = np.asarray(solve())
    except (LinAlgError, ValueError):
        return fallback, False
    return (final, True) if np.isfinite(final).all() else (fallback, False)


def _require_weights(weights: LqrWeights, states: int, inputs: int) -> None:
    remedy = "Make the weights with bryson_weights(reference)."
    for name, matrix, size in (("Q", weights.Q, states), ("R", weights.R, inputs)):
        if matrix.shape != (size, size) or not np.isfinite(matrix).all() or not np.allclose(matrix, matrix.T):
            shape = f"{name} has shape {matrix.shape}; it must be finite, symmetric and ({size}, {size})."
            raise InputError(shape, remedy=remedy, name=name)
    of_states = np.linalg.eigvalsh(weights.Q)
    if of_states[0] < -NEGATIVE * abs(of_states[-1]) or np.linalg.eigvalsh(weights.R)[0] <= 0.0:
        raise InputError("Q must be positive semidefinite and R positive definite.", remedy=remedy)
