"""One accepted step of an integrator as a function of time."""

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property

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

    def guess(self, fraction: float) -> Array:
        """Return y at a fraction of the step, from the cubic through y and ẏ at both ends: good enough to look."""
        (y0, f0), (y1, f1) = self._before, self._after
        x, h = fraction, self.end - self.start
        if x == 1.0:
            return y1
        slope: Array = x * (1.0 - x) * h * ((1.0 - x) * f0 - x * f1)
        return slope + y0 + (y1 - y0) * x * x * (3.0 - 2.0 * x)
