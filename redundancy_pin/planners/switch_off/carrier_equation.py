"""Carrier motion under prescribed main efforts: f(s, ṡ, s̈) = W τ_ref as a differential equation with error control.

f is affine in s̈: F s̈ = W τ_ref − f(s, ṡ, 0), where F are the coefficients of s̈. F may lose rank at the pose that is to
be crossed, where an explicit integrator would divide by zero. Here s̈ is a polynomial on each step, and the undivided
equation is satisfied in the least-squares sense at more points than the polynomial has coefficients (collocation). The
defect is the error control: where a bounded s̈ exists it falls to machine precision, at a singular pose as well. Where
none exists it does not, and the step is halved until ``StepGivenUpError``.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import legendre

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.planners.carrier_model import TimedModel
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, preferred_middle

_DEGREE = 13
"""Degree of s̈ on a step."""

_POINTS = 20
"""Collocation points of a step."""

_DEFECTS = 10.0
"""Largest defect of an accepted step, in tolerances of the model, relative to the largest f along the crossing."""

_FORCE_SHARE = 1e-3
"""Fraction of the largest F s̈ on a step that scales the defects where it exceeds f: its rounding must pass."""

_LEAST_STEP = 1e-6
"""Shortest step, as a fraction of the interval."""

_MOST_ITERATIONS = 8
"""Of Newton's method on a step; f is quadratic, so four or five suffice."""


class StepGivenUpError(ArithmeticError):
    """No bounded s̈ satisfies the equation beyond a time; never leaves the planner.

    ``t``: that time, s; ``s``, ``sd`` (k,) carrier motion there, m and m/s; ``defect`` of the equation, N.
    """

    def __init__(self, t: float, s: Array, sd: Array, defect: float) -> None:
        super().__init__(t, s, sd, defect)
        self.t, self.s, self.sd, self.defect = t, s, sd, defect


@dataclass(frozen=True, eq=False)
class CarrierEquation:
    """The equation F s̈ = W τ_ref − f(s, ṡ, 0); with more carriers than coordinates s̈ has the least norm.

    Attributes:
        model: the carrier model over time.
        effort: the prescribed main efforts τ_ref over time, N or N·m.
        row_scale: (n,) the characteristic length, m, for moments, 1 for forces.
        size: largest f along the crossing, N, which defects are compared with.
    """

    model: TimedModel
    effort: PiecewisePolynomial
    row_scale: Array
    size: float

    def solve(self, start: float, end: float, s: Array, sd: Array) -> PiecewisePolynomial:
        """Integrate from a state (k,), (k,) at ``start`` to ``end``."""
        breaks = self.model.breaks
        ends = [*breaks[(breaks > start) & (breaks < end)].tolist(), end]
        least = _LEAST_STEP * (end - start)
        t, edges, series = start, [start], []
        for stop in ends:
            pending = [stop]
            while pending:
                position, defect, force = self._step(t, pending[-1], s, sd)
                if self._is_satisfied(defect, force):
                    half = 0.5 * (pending[-1] - t)
                    t = pending.pop()
                    edges.append(t)
                    series.append(position)
                    s, sd = position.sum(axis=0), legendre.legder(position).sum(axis=0) / half
                elif pending[-1] - t > least:
                    pending.append(preferred_middle(t, pending[-1], self.model.knots))
                else:
                    raise StepGivenUpError(t, s, sd, defect)
        return PiecewisePolynomial.from_series(np.array(edges), np.array(series), legendre.Legendre)

    def _is_satisfied(self, defect: float, force: float) -> bool:
        """Return whether a defect is within tolerance, ``force`` the largest F s̈, N."""
        return defect <= _DEFECTS * self.model.tolerance * max(self.size, _FORCE_SHARE * force)

    def _step(self, a: float, b: float, s0: Array, sd0: Array) -> tuple[Array, float, float]:
        """Return the Legendre series (d, k) of s on one step, the largest defect and the largest F s̈, N."""
        basis, half = _basis(), 0.5 * (b - a)
        t = a + half * (basis.x + 1.0)
        model = self.model.at(t)
        scale, load = self.row_scale[:, None], np.einsum("nij,nj->ni", model.W, self.effort(t))
        inertia = model.f_terms[..., -1] / scale
        idle = _idle_directions(inertia)
        value, first, second = basis.value, half * basis.first, half**2 * basis.second
        start = s0 + half * (basis.x[:, None] + 1.0) * sd0
        c = np.zeros((_DEGREE + 1, model.k))
        defect = force = np.inf
        for _ in range(_MOST_ITERATIONS):
            s, sd, sdd = start + second @ c, sd0 + first @ c, value @ c
            residual = (load - model.f(s, sd, sdd)) / self.row_scale
            residual = np.concatenate([residual, -np.einsum("nik,nk->ni", idle, sdd)], axis=1)
            previous, defect = defect, float(np.abs(residual).max())
            force = float(np.abs(np.einsum("nik,nk->ni", inertia, sdd)).max())
            if not defect < 0.5 * previous and self._is_satisfied(defect, force):
                break
            slopes = zip(model.slopes(s, sd), (second, first, value), strict=True)
            slope = sum(np.einsum("nik,nd->nidk", by / scale, basis_of) for by, basis_of in slopes)
            slope = np.concatenate([slope, np.einsum("nik,nd->nidk", idle, value)], axis=1)
            change = np.linalg.lstsq(slope.reshape(residual.size, -1), residual.ravel(), rcond=None)[0]
            if not np.isfinite(change).all():
                return c, np.inf, 0.0
            c = c + change.reshape(c.shape)
        rate = half * legendre.legint(c, lbnd=-1.0, axis=0)
        rate[0] += sd0
        position = half * legendre.legint(rate, lbnd=-1.0, axis=0)
        position[0] += s0
        return position, defect, force


class _Basis(NamedTuple):
    """Collocation points on (−1, 1), the Legendre polynomials there, and their first and second integrals from −1."""

    x: Array
    value: Array
    first: Array
    second: Array


@lru_cache(maxsize=1)
def _basis() -> _Basis:
    x, _ = legendre.leggauss(_POINTS)
    unit = np.eye(_DEGREE + 1)
    first, second = (legendre.legint(unit, order, lbnd=-1.0, axis=0) for order in (1, 2))
    value, once, twice = (legendre.legval(x, series).T for series in (unit, first, second))
    return _Basis(*(read_only(np.ascontiguousarray(part)) for part in (x, value, once, twice)))


def _idle_directions(F: Array) -> Array:
    """Return (N, k − n, k) combinations of carriers without effect on f, scaled as F; s̈ has no component along them."""
    n, k = F.shape[1:]
    if k == n:
        return np.empty((len(F), 0, k))
    _, size, vt = np.linalg.svd(F)
    rows: Array = vt[:, n:] * size[:, :1, None]
    return rows
