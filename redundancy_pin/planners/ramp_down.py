"""The main efforts on their way to zero before a crossing."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.continuous_motion import ContinuousMotion
from redundancy_pin.trajectory import Polynomial, boundary_polynomial

_NODES = 16
"""Nodes of the interpolant from which the parked efforts are differentiated."""

_TAIL = 1e-11
"""Of the interpolant's last coefficients, relative to the largest; the stretch is halved until they are as small."""

_MOST_HALVINGS = 8
"""After them rounding would cost the derivatives more than the interpolation does."""

_NARROW = 1e-3
"""Of the ramp: a smooth stretch shorter than this is not differentiated on."""


@dataclass(frozen=True, eq=False)
class RampDown:
    """The main efforts on their way to zero, and zero after it.

    Attributes:
        polynomial: quintic with values (m,), N or N·m (Parsa 2014, eq. 3.4).
        parked_at_entry: (m,) what they would be at its end with the carriers parked.
    """

    polynomial: Polynomial
    parked_at_entry: Array

    def __call__(self, times: Array) -> Array:
        """Return the efforts (N, m) at (N,) times from the start of the ramp on."""
        value = np.zeros((len(times), self.polynomial.control.shape[1]))
        ramp = times < self.polynomial.t1
        value[ramp] = self.polynomial(times[ramp])
        return value


def ramp_down(dynamics: Dynamics, motion: ContinuousMotion, start: float, end: float, datum: Array) -> RampDown:
    """Return the quintic from the parked efforts at ``start``, with their rate and its rate, to zero at ``end``.

    The derivatives are those of an interpolant of the parked efforts over the smooth stretch around ``start``.
    """

    def parked(times: Array) -> Array:
        along = dynamics.along(motion.sample_at(times))
        tau = distribute(along.reduce(CarrierMotion.parked(len(times), dynamics.robot.k, datum))).tau
        return np.asarray(tau)

    kinks = np.concatenate([[motion.start], motion.breaks, motion.knots if motion.exact else [], [motion.end]])
    left, right = _smooth_around(kinks, start, end - start)
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
    return RampDown(boundary_polynomial(start, end, [at[0], *rates], [zero, zero, zero]), at[1])


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
