"""Carrier motion under prescribed main efforts: f(s, ṡ, s̈) = W τ_ref as a differential equation with error control.

With f affine in s̈ this is F s̈ = W τ_ref − f(s, ṡ, 0), F the coefficients of s̈. F loses rank wherever W does, so an
explicit integrator would divide by zero at the very pose that is to be crossed. Here s̈ is a polynomial on each step
instead, and the equation, undivided, is satisfied in the least-squares sense at more points than the polynomial has
coefficients. Where a bounded s̈ exists the defect falls to rounding, at a singular pose as anywhere else; where none
exists it does not, and the step is divided until it is given up. The defect is the error control: no step is accepted
that does not satisfy the equation.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev, legendre

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import TimedModel
from redundancy_pin.singularities.roots import Interval
from redundancy_pin.trajectory import boundary_polynomial
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, preferred_middle

_NODES = 16
"""Nodes of the interpolant from which the parked efforts are differentiated."""

_TAIL = 1e-11
"""Of the interpolant's last coefficients, relative to the largest; the stretch is halved until they are as small."""

_MOST_HALVINGS = 8
"""After them rounding would cost the derivatives more than the interpolation does."""

_NARROW = 1e-3
"""Of the ramp: a smooth stretch shorter than this is not differentiated on."""


def ramp_down(
    dynamics: Dynamics, motion: ContinuousMotion, start: float, window: Interval, datum: Array
) -> tuple[PiecewisePolynomial, Array]:
    """Return the main efforts (m,) through a window, N or N·m: a quintic to zero at its start, and zero.

    The quintic (Parsa 2014, eq. 3.4) begins with the efforts of parked carriers at ``start``, their rate and its rate:
    those of an interpolant over the smooth stretch around ``start``. Behind it are the parked efforts at its end.
    """
    end = window.start

    def parked(times: Array) -> Array:
        along = dynamics.along(motion.sample_at(times))
        tau = distribute(along.reduce(CarrierMotion.parked(len(times), dynamics.robot.k, datum))).tau
        return np.asarray(tau)

    left, right = _smooth_around(motion.kinks, start, end - start)
    nodes = np.sort(chebyshev.chebpts1(_NODES))
    to_series = np.linalg.inv(chebyshev.chebvander(nodes, _NODES - 1))
    for _ in range(_MOST_HALVINGS):
        series = to_series @ parked(0.5 * (left + right) + 0.5 * (right - left) * nodes)
        if np.abs(series[-3:]).max() <= _TAIL * np.abs(series).max():
            break
        left, right = 0.5 * (left + start), 0.5 * (right + start)
    x, per_second = (2.0 * start - left - right) / (right - left), 2.0 / (right - left)
    rates = [chebyshev.chebval(x, chebyshev.chebder(series, order)) * per_second**order for order in (1, 2)]
    at = parked(np.array([start, end]))
    zero = np.zeros(dynamics.robot.m)
    quintic = boundary_polynomial(start, end, [at[0], *rates], [zero, zero, zero])
    return PiecewisePolynomial.joined([quintic, PiecewisePolynomial.constant(zero, end, window.end)]), at[1]


def _smooth_around(kinks: Array, t: float, width: float) -> tuple[float, float]:
    """Return the stretch without kinks around a time, at most ``width`` before and half of it after, s."""
    before = min(t - float(kinks[kinks <= t].max()), width)
    after = min(float(kinks[kinks > t].min()) - t, 0.5 * width)
    narrow = _NARROW * width  # derivatives from so short a stretch would be rounding; that on the other side will do
    if before < narrow:
        before = 0.0
    elif after < narrow:
        after = 0.0
    return t - before, t + after


DEGREE = 13
"""Of s̈ on a step."""

POINTS = 20
"""Points of a step at which the equation is satisfied."""

DEFECTS = 10.0
"""Largest defect of the equation in tolerances of the model, relative to the largest f along the crossing."""

FORCE_SHARE = 1e-3
"""Of the largest F s̈ on a step, that counts as well where it is more than that f: its rounding has to pass."""

LEAST_STEP = 1e-6
"""A step shorter than this fraction of the interval is given up."""

_MOST_ITERATIONS = 8
"""Of Newton's method on one step: f is quadratic, and it converges in four or five."""


class StepGivenUpError(ArithmeticError):
    """No bounded s̈ satisfies the equation past a time; never leaves the planner.

    ``t``: that time, s; ``s``, ``sd`` (k,) carrier motion there, m and m/s; ``defect``: what was left of the equation,
    N.
    """

    def __init__(self, t: float, s: Array, sd: Array, defect: float) -> None:
        super().__init__(t, s, sd, defect)
        self.t, self.s, self.sd, self.defect = t, s, sd, defect


@dataclass(frozen=True, eq=False)
class CarrierEquation:
    """The equation F s̈ = W τ_ref − f(s, ṡ, 0).

    Of more carriers than coordinates the s̈ of least norm is taken.

    ``model``: the carrier model over time; ``effort``: the prescribed main efforts; ``row_scale`` (n,) the
    characteristic length for moments, 1 for forces; ``size``: largest f along the crossing, N, which defects are
    compared with.
    """

    model: TimedModel
    effort: PiecewisePolynomial
    row_scale: Array
    size: float

    def solve(self, start: float, end: float, s: Array, sd: Array) -> PiecewisePolynomial:
        """Integrate from a state (k,), (k,) at ``start`` to ``end``."""
        breaks = self.model.breaks
        ends = [*breaks[(breaks > start) & (breaks < end)].tolist(), end]
        least = LEAST_STEP * (end - start)
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
        return defect <= DEFECTS * self.model.tolerance * max(self.size, FORCE_SHARE * force)

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
        c = np.zeros((DEGREE + 1, model.k))
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
    """Points of a step on (−1, 1), and there the Legendre polynomials and their first and second integrals from −1."""

    x: Array
    value: Array
    first: Array
    second: Array


@lru_cache(maxsize=1)
def _basis() -> _Basis:
    x, _ = legendre.leggauss(POINTS)
    unit = np.eye(DEGREE + 1)
    first, second = (legendre.legint(unit, order, lbnd=-1.0, axis=0) for order in (1, 2))
    value, once, twice = (legendre.legval(x, series).T for series in (unit, first, second))
    return _Basis(*(read_only(np.ascontiguousarray(part)) for part in (x, value, once, twice)))


def _idle_directions(F: Array) -> Array:
    """Return (N, k − n, k) combinations of carriers without effect on f, as large as F: s̈ has no part in them."""
    n, k = F.shape[1:]
    if k == n:
        return np.empty((len(F), 0, k))
    _, size, vt = np.linalg.svd(F)
    rows: Array = vt[:, n:] * size[:, :1, None]
    return rows
