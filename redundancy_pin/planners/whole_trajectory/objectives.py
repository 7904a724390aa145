"""What a whole-trajectory plan minimises: one table, each objective a formula of the quantities along the trajectory.

To add an objective, add one entry to ``OBJECTIVES``: its formula and its size. Derivatives are the solver library's,
the same formula gives the number in ``diagnostics["objective"]``, and ``plan_whole_trajectory`` accepts the name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import RedundancyPinError


def casadi() -> Any:
    """Return the optional solver library.

    Raises:
        RedundancyPinError: it is not installed.
    """
    try:
        import casadi as library
    except ImportError as error:
        raise RedundancyPinError(
            "Planning over the whole trajectory needs casadi, which is not installed.",
            remedy="Install it with `pip install 'redundancy_pin[optimal]'`.",
        ) from error
    return library


@dataclass(frozen=True, eq=False)
class Scales:
    """Sizes that variables, equations and objectives are divided by.

    Attributes:
        s, sd, sdd: (k,) of the carriers' motion, m, m/s, m/s².
        tau: of the main efforts, N or N·m.
        row: (n,) of the rows of W τ = f, N or N·m.
        force: (k,) of the carriers' forces, N.
        power: of the main actuators, W.
        duration: of the motion, s.
    """

    s: Array
    sd: Array
    sdd: Array
    tau: float
    row: Array
    force: Array
    power: float
    duration: float


class Quantities(ABC):
    """What formulas may use: matrices with a row a node, in units, as expressions of the programme or as numbers.

    Attributes:
        s, sd, sdd: (M, k) motion of the carriers, m, m/s, m/s².
        force: (M, k) forces of the carriers' actuators, N; the programme has them only where something needs them.
        tau, tau_target, actuated_rate: (M, m) main efforts, those that "tracking" aims at, and rates of the actuators.
        scales: sizes of all of them.
    """

    s: Any
    sd: Any
    sdd: Any
    force: Any
    tau: Any

    def __init__(self, h: Array, scales: Scales, tau_target: Array, actuated_rate: Array) -> None:
        self.scales, self.tau_target, self.actuated_rate = scales, casadi().DM(tau_target), casadi().DM(actuated_rate)
        self._h, self._steps = h, np.flatnonzero(h > 0.0)

    def integral(self, integrand: Any) -> Any:
        """Return ∫ Σ integrand dt by the trapezoidal rule, which agrees with W τ = f being required at the nodes."""
        weights = 0.5 * (np.append(self._h, 0.0) + np.append(0.0, self._h))
        return casadi().dot(casadi().DM(weights), casadi().sum2(integrand))

    def rate(self, values: Any) -> Any:
        """Return the time derivative in each step of what is linear in a step; jumps of the reference are no steps."""
        return (values[self._steps + 1, :] - values[self._steps, :]) / self._h[self._steps, None]

    def integral_over_steps(self, integrand: Any) -> Any:
        """Return ∫ Σ integrand dt of what is constant in each step, as ``rate`` is."""
        return casadi().dot(casadi().DM(self._h[self._steps]), casadi().sum2(integrand))

    @abstractmethod
    def absolute(self, values: Any, size: float) -> Any:
        """Return |values|, which has to be minimised; ``size`` is what the values are scaled by."""

    @abstractmethod
    def largest(self, values: Any, size: float) -> Any:
        """Return the largest of all |values|, which has to be minimised; ``size`` is what the values are scaled by."""


@dataclass(frozen=True)
class ObjectiveTerm:
    """An objective.

    Attributes:
        formula: from the quantities to a scalar.
        size: from the sizes of the quantities to that of the objective: all are divided by theirs before weighting.
        flat: it leaves the carriers open over whole stretches. There the regularisation alone decides, and where the
            conditions of a minimum hold within tolerance the efforts may still be 1e-2 off those that fulfil them: two
            backends would give two plans. Such optima are finished with exact steps.
        kinked: it has kinks in products of two unknowns, far from a quadratic programme: Mehrotra's
            predictor-corrector crawls on it, and every step is refined.
    """

    formula: Callable[[Quantities], Any]
    size: Callable[[Scales], float]
    flat: bool = False
    kinked: bool = False


def _energy(q: Quantities) -> Any:
    """∫ Σ |τ q̇| + Σ |F ṡ| dt: what motors draw that cannot recover energy."""
    power = q.scales.power
    return q.integral(q.absolute(q.tau * q.actuated_rate, power)) + q.integral(q.absolute(q.force * q.sd, power))


OBJECTIVES: dict[str, ObjectiveTerm] = {
    "effort": ObjectiveTerm(lambda q: q.integral(q.tau**2), lambda u: u.duration * u.tau**2),
    "peak": ObjectiveTerm(lambda q: q.largest(q.tau, q.scales.tau), lambda u: u.tau, flat=True),
    "tracking": ObjectiveTerm(lambda q: q.integral((q.tau - q.tau_target) ** 2), lambda u: u.duration * u.tau**2),
    "carrier_force": ObjectiveTerm(lambda q: q.integral(q.force**2), lambda u: u.duration * float(u.force.max()) ** 2),
    "carrier_acceleration": ObjectiveTerm(
        lambda q: q.integral(q.sdd**2), lambda u: u.duration * float(u.sdd.max()) ** 2
    ),
    "effort_rate": ObjectiveTerm(lambda q: q.integral_over_steps(q.rate(q.tau) ** 2), lambda u: u.tau**2 / u.duration),
    "energy": ObjectiveTerm(_energy, lambda u: u.duration * u.power, flat=True, kinked=True),
}
"""All objectives by name."""
