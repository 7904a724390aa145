"""What a whole-trajectory plan minimises.

To add an objective, add one entry to ``OBJECTIVES``: its formula and its size. Derivatives are the solver library's,
the same formula gives the number in ``diagnostics["objective"]``, and ``plan_whole_trajectory`` accepts the name.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, positive
from redundancy_pin.errors import InputError, shown
from redundancy_pin.planners.optimal.nlp import Expression


@dataclass(frozen=True, eq=False)
class Scales:
    """Sizes that variables, equations and objectives are divided by.

    ``s``, ``sd``, ``sdd`` (k,) of the carriers' motion, m, m/s, m/s²; ``tau``: of the main efforts, N or N·m;
    ``efforts`` (m,): of each of them, a torque counted as the force it exerts at the characteristic length, N or N·m;
    ``row`` (n,) of the rows of W τ = f, N or N·m; ``force`` (k,) of the carriers' forces, N; ``power``: of the main
    actuators, W; ``duration``: of the motion, s; ``base`` (6,) of force and moment on the base, N and N·m; ``length``:
    the characteristic one, m.
    """

    s: Array
    sd: Array
    sdd: Array
    tau: float
    efforts: Array
    row: Array
    force: Array
    power: float
    duration: float
    base: Array
    length: float


class Quantities(ABC):
    """Arguments of formulas: matrices with a row per node, in units, as expressions of the programme or as numbers.

    ``s``, ``sd``, ``sdd`` (M, k) motion of the carriers, m, m/s, m/s²; ``force`` (M, k) forces of the carriers'
    actuators, N; the programme has them only where something needs them; ``tau``, ``tau_target``, ``actuated_rate`` (M,
    m) main efforts, those that "tracking" aims at, and rates of the actuators; ``base_force``, ``base_moment`` (M, 3)
    what the base feels about ``base_point`` beyond the load at rest; ``scales``: sizes of all of them.
    """

    s: Expression
    sd: Expression
    sdd: Expression
    force: Expression
    tau: Expression
    actuated_rate: Expression
    base_force: Expression
    base_moment: Expression

    def __init__(self, h: Array, scales: Scales, tau_target: Array, actuated_rate: Array) -> None:
        self.scales, self.tau_target, self.actuated_rate = scales, ca.DM(tau_target), ca.DM(actuated_rate)
        self._h, self._steps = h, np.flatnonzero(h > 0.0)

    def integral(self, integrand: Expression) -> Expression:
        """Return ∫ Σ integrand dt by the trapezoidal rule, which agrees with W τ = f being required at the nodes."""
        weights = 0.5 * (np.append(self._h, 0.0) + np.append(0.0, self._h))
        return ca.dot(ca.DM(weights), ca.sum2(integrand))

    def rate(self, values: Expression) -> Expression:
        """Return the time derivative, in each step, of a function linear in it; skips jumps of the reference."""
        return (values[self._steps + 1, :] - values[self._steps, :]) / self._h[self._steps, None]

    def integral_over_steps(self, integrand: Expression) -> Expression:
        """Return ∫ Σ integrand dt of an integrand that is constant in each step, as ``rate`` is."""
        return ca.dot(ca.DM(self._h[self._steps]), ca.sum2(integrand))

    def bending(self, values: Expression) -> tuple[Expression, Array]:
        """Return by how much values at inner nodes deviate from the line through both neighbours, and weights h / T.

        Nodes at which the reference jumps are no inner ones.
        """
        at = np.flatnonzero((self._h[:-1] > 0.0) & (self._h[1:] > 0.0)) + 1
        before, after = self._h[at - 1, None], self._h[at, None]
        share = before / (before + after)
        deviation = values[at, :] - ((1.0 - share) * values[at - 1, :] + share * values[at + 1, :])
        return deviation, (before + after) / (2.0 * self.scales.duration)

    @abstractmethod
    def absolute(self, values: Expression, size: ArrayLike) -> Expression:
        """Return |values|, which has to be minimised.

        ``size``: scale of the values, one number or (c,) one for each of their columns.
        """

    @abstractmethod
    def largest(self, values: Expression, size: ArrayLike) -> Expression:
        """Return the largest of all |values|, which has to be minimised.

        ``size``: scale of the values. With one number the result has the unit of the values; with (c,) one
        for each of their columns, as ``scales.sd``, it is the largest fraction |values| / size, without a unit.
        """


@dataclass(frozen=True)
class ObjectiveTerm:
    """An objective.

    Attributes:
        formula: from the quantities to a scalar.
        size: maps the sizes of the quantities to the size of the objective: objectives are scaled before weighting.
    """

    formula: Callable[[Quantities], Expression]
    size: Callable[[Scales], float]

    def value(self, quantities: Quantities) -> Expression:
        """Return the objective after checking that it is one number.

        Raises:
            InputError: it has several, one for each node or joint.
        """
        value = self.formula(quantities)
        if isinstance(value, (ca.MX, ca.DM)) and value.numel() != 1:
            raise InputError(
                f"The formula of an objective gives {value.shape[0]} × {value.shape[1]} numbers, not one.",
                remedy="Make one of them, by q.integral(...) or q.largest(...).",
            )
        return value

    def size_of(self, scales: Scales) -> float:
        """Return its size after checking that it is one positive number.

        Raises:
            InputError: it has several, one for each carrier or actuator, as ``scales.sd`` has; or it is not positive.
        """
        size = np.asarray(self.size(scales), dtype=np.float64)
        if size.size != 1:
            raise InputError(
                f"The size of an objective is {shown(size.tolist())}, not one number.",
                remedy="Write float(u.sd.max()) in place of u.sd, for example.",
            )
        return positive(size.item(), "the size of an objective", "")


def _energy(q: Quantities) -> Expression:
    """∫ Σ |τ q̇| + Σ |F ṡ| dt: what motors draw that cannot recover energy."""
    power = q.scales.power
    return q.integral(q.absolute(q.tau * q.actuated_rate, power)) + q.integral(q.absolute(q.force * q.sd, power))


RIPPLE = 1e-2
"""Size of a ripple, as a fraction of the sizes of τ and s̈: what least efforts on the circle of the 2-RPR have."""

CARRIER_RIPPLE = 0.1
"""Weight of the ripple of s̈ relative to τ. Without it s̈ zigzags from node to node, and W⁻¹ magnifies this between
the nodes; with weight 1 the efforts keep more reversals (docs/planning.md, *Calm plans*)."""


def _ripple(q: Quantities) -> Expression:
    """Mean square of what τ and s̈ at each node deviate from the line through both neighbours, over their sizes.

    What is smooth contributes with the fourth power of the step: this weighs the zigzag of the nodes and little else.
    """
    (tau, weights), (sdd, _) = q.bending(q.tau), q.bending(q.sdd)
    parts = ((tau, 1.0 / q.scales.tau), (sdd, np.sqrt(CARRIER_RIPPLE) / q.scales.sdd))
    return sum(ca.sumsqr(ca.DM(np.sqrt(weights) * factor * np.ones(part.shape)) * part) for part, factor in parts)


OBJECTIVES: dict[str, ObjectiveTerm] = {
    "effort": ObjectiveTerm(lambda q: q.integral(q.tau**2), lambda u: u.duration * u.tau**2),
    "peak": ObjectiveTerm(lambda q: q.largest(q.tau, q.scales.tau), lambda u: u.tau),
    "tracking": ObjectiveTerm(lambda q: q.integral((q.tau - q.tau_target) ** 2), lambda u: u.duration * u.tau**2),
    "carrier_force": ObjectiveTerm(lambda q: q.integral(q.force**2), lambda u: u.duration * float(u.force.max()) ** 2),
    "carrier_acceleration": ObjectiveTerm(
        lambda q: q.integral(q.sdd**2), lambda u: u.duration * float(u.sdd.max()) ** 2
    ),
    "base_force": ObjectiveTerm(lambda q: q.integral(q.base_force**2), lambda u: u.duration * float(u.base[0]) ** 2),
    "base_moment": ObjectiveTerm(lambda q: q.integral(q.base_moment**2), lambda u: u.duration * float(u.base[3]) ** 2),
    "base_wrench": ObjectiveTerm(
        lambda q: q.integral(q.base_force**2) + q.integral((q.base_moment / q.scales.length) ** 2),
        lambda u: u.duration * float(u.base[0]) ** 2,
    ),
    "effort_rate": ObjectiveTerm(lambda q: q.integral_over_steps(q.rate(q.tau) ** 2), lambda u: u.tau**2 / u.duration),
    "ripple": ObjectiveTerm(_ripple, lambda u: RIPPLE**2),
    "energy": ObjectiveTerm(_energy, lambda u: u.duration * u.power),
}
"""All objectives by name."""
