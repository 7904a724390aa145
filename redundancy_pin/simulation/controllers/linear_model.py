"""The linear model along a reference, and what a sampled controller sees of it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import expm

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.simulation.chain import ClosedChain
from redundancy_pin.simulation.linearise import linearise
from redundancy_pin.simulation.reference import MotionReference
from redundancy_pin.simulation.state import State


@dataclass(frozen=True, eq=False)
class LinearModel:
    """d(δz)/dt = A(t) δz + B(t) δu along a reference, linear between its nodes.

    δz = (δx, δs, δẋ, δṡ), δu = (δτ, δF); see ``simulation.linearise``.

    Attributes:
        t: (T,) nodes, s.
        A: (T, 2d, 2d).
        B: (T, 2d, m + k).
    """

    t: Array
    A: Array
    B: Array

    def at(self, times: Array) -> tuple[Array, Array]:
        """Return A (N, 2d, 2d) and B (N, 2d, m + k) at times (N,); outside the nodes those at the ends."""
        inside = np.clip(times, self.t[0], self.t[-1])
        i = np.clip(np.searchsorted(self.t, inside, side="right") - 1, 0, len(self.t) - 2)
        share = ((inside - self.t[i]) / (self.t[i + 1] - self.t[i]))[:, None, None]
        return (1.0 - share) * self.A[i] + share * self.A[i + 1], (1.0 - share) * self.B[i] + share * self.B[i + 1]


def linear_model(reference: MotionReference, step: float) -> LinearModel:
    """Return the linearisation along a reference at nodes at most ``step`` apart.

    Args:
        reference: the motion and its efforts.
        step: s.

    Raises:
        SingularPoseError: a type I pose on the way.
        IllPosedModelError: a free motion of the model has no inertia somewhere on the way.
    """
    robot = reference.robot
    chain = ClosedChain(robot)
    count = max(2, int(np.ceil((reference.end - reference.start) / step - 1e-9)) + 1)
    times = np.linspace(reference.start, reference.end, count)
    found = []
    for t in times.tolist():
        q, v, _ = reference.tree(t)
        found.append(linearise(robot, State(chain, t, q, v), *reference.loads(t)))
    return LinearModel(
        read_only(times), read_only(np.array([one.A for one in found])), read_only(np.array([one.B for one in found]))
    )


@dataclass(frozen=True, eq=False)
class SampledModel:
    """ξ_{i+1} = Φ_i ξ_i + Γ_i δu_i with ξ = (δz, δu of the sample before); the latter acts until the delay is over.

    Attributes:
        t: (N + 1,) sampling instants, s.
        transition: (N, e, e) Φ, e = 2d + m + k, or 2d without delay.
        input: (N, e, m + k) Γ.
    """

    t: Array
    transition: Array
    input: Array


def sampled_model(model: LinearModel, start: float, end: float, period: float, delay: float) -> SampledModel:
    """Return the zero-order hold of a linear model, by matrix exponentials.

    A and B count as constant in each of the two parts of a period: before the new input acts, and after.

    Args:
        model: the continuous one.
        start: first sampling instant, s.
        end: last one at the latest, s.
        period: sampling period, s.
        delay: from reading the state to the change of the efforts, s; at most one period.
    """
    count = max(1, int(np.ceil((end - start) / period - 1e-9)))
    times = start + period * np.arange(count + 1.0)
    transition, old = _hold(model, times[:-1] + 0.5 * delay, delay)
    after, new = _hold(model, times[:-1] + 0.5 * (delay + period), period - delay)
    phi, gamma = after @ transition, new
    if delay == 0.0:
        return SampledModel(read_only(times), read_only(phi), read_only(gamma))
    states, inputs = new.shape[1:]
    large = np.zeros((count, states + inputs, states + inputs))
    large[:, :states, :states] = phi
    large[:, :states, states:] = after @ old
    enters = np.zeros((count, states + inputs, inputs))
    enters[:, :states] = gamma
    enters[:, states:] = np.eye(inputs)
    return SampledModel(read_only(times), read_only(large), read_only(enters))


def _hold(model: LinearModel, times: Array, duration: float) -> tuple[Array, Array]:
    """Return Φ and Γ over intervals of one duration with the A and B of their middles."""
    A, B = model.at(times)
    states, inputs = B.shape[1:]
    block = np.zeros((len(times), states + inputs, states + inputs))
    block[:, :states, :states], block[:, :states, states:] = A, B
    power = expm(duration * block)
    return power[:, :states, :states], power[:, :states, states:]
