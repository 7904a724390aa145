"""One accepted step of an integrator as a function of time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property

import numpy as np
from scipy.integrate import OdeSolver

from redundancy_pin.arrays import Array


class Step:
    """An accepted step of an integrator, as a function of time.

    Args:
        solver: the integrator, after the step.
        before: y and ẏ at the start of the step.
    """

    def __init__(self, solver: OdeSolver, before: tuple[Array, Array]) -> None:
        self.start, self.end = float(solver.t_old), float(solver.t)
        self._solver, self._before = solver, before
        self._after: tuple[Array, Array] = (solver.y, solver.f)

    @cached_property
    def _dense(self) -> Callable[[float], Array]:
        # three more evaluations: made only where something asks for it
        interpolant: Callable[[float], Array] = self._solver.dense_output()
        return interpolant

    def __call__(self, t: float) -> Array:
        """Return y at a time in the step, to the accuracy of the integrator."""
        if t <= self.start:
            return self._before[0]
        return self._after[0] if t >= self.end else self._dense(t)

    def time(self, fraction: float) -> float:
        """Return the time at a fraction of the step, s."""
        return self.end if fraction == 1.0 else self.start + fraction * (self.end - self.start)

    def exactly(self, fraction: float) -> Array:
        """Return y at a fraction of the step, to the accuracy of the integrator."""
        return self(self.time(fraction))

    def guesses(self, weights: Array) -> Array:
        """Return (N, nq + nv) y at fractions of the step, from the cubic through y and ẏ at both ends.

        It is good enough to look whether something is near, and takes no evaluation.

        Args:
            weights: (N, 4) ``cubic`` of the fractions.
        """
        (y0, f0), (y1, f1) = self._before, self._after
        h = self.end - self.start
        found: Array = weights.dot(np.array([y0, h * f0, h * f1, y1]))
        return found


def cubic(fractions: Sequence[float]) -> Array:
    """Return (N, 4) weights of y, h ẏ at the start and h ẏ, y at the end of a step of length h in Hermite's cubic."""
    x = np.array(fractions)
    late = x * x * (3.0 - 2.0 * x)
    return np.stack([1.0 - late, x * (1.0 - x) ** 2, -x * x * (1.0 - x), late], axis=1)
