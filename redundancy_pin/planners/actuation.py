"""W along a motion as a function of time: where it is singular, and where too close to it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal, get_args

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.spectrum import scaled, spectrum_of
from redundancy_pin.singularities.roots import Interval, below_zero, minima, zeros
from redundancy_pin.trajectory.functions_of_time import ContinuousMotion, PiecewisePolynomial

Measure = Literal["condition", "margin"]

TOLERANCE = 1e-11
"""Of the interpolated W, relative to its largest entry: the times of a window are then exact to about 1e-11 of it."""

SAMPLED_TOLERANCE = 1e-9
"""Of what is interpolated along a sampled motion: the quintics between samples a few milliseconds apart meet with kinks
below this, and resolving every one of them would be of no use."""

SAMPLES_A_PIECE = 33
"""A piece is a polynomial of degree 15: its singular values have few dips, and a dip shows in the samples beside it."""

LARGEST_CONDITION = 1e6
"""Beyond it the times at which W reaches a threshold are lost in the rounding of W."""

SINGULAR = 1e-9
"""A smallest singular value below this fraction of the largest along the motion is zero."""


@dataclass(frozen=True, eq=False)
class Actuation:
    """W (n, m) as a function of time.

    Attributes:
        interpolant: its entries, row by row.
        row_scale, column_scale: (n,) and (m,) what forces and efforts are measured in.
    """

    interpolant: PiecewisePolynomial
    row_scale: Array
    column_scale: Array

    @staticmethod
    def along(dynamics: Dynamics, motion: ContinuousMotion) -> Actuation:
        """Read W off a backend along a whole motion."""

        def values(times: Array) -> Array:
            return np.asarray(dynamics.along(motion.sample_at(times)).reduce().W).reshape(len(times), -1)

        def scale(values: Array) -> Array:
            return np.full(values.shape[1], np.abs(values).max())

        sample = dynamics.along(motion.sample_at(np.array([motion.start]))).reduce()
        tolerance = TOLERANCE if motion.exact else SAMPLED_TOLERANCE
        edges = smooth_edges(motion, motion.start, motion.end)
        entries = PiecewisePolynomial.fit(values, edges, motion.knots, scale, tolerance)
        return Actuation(entries, sample.row_scale, sample.column_scale)

    def at(self, times: Array) -> Array:
        """Return W (N, n, m) at (N,) times."""
        return self.interpolant(times).reshape(len(times), len(self.row_scale), len(self.column_scale))

    @cached_property
    def _times(self) -> Array:
        return dense(self.interpolant.edges)

    def singular_values(self, times: Array) -> Array:
        """Return (N, min(n, m)) singular values of the scaled W, the largest first."""
        return spectrum_of(scaled(self.at(times), self.row_scale, self.column_scale)).singular_values

    def windows(self, measure: Measure, threshold: float) -> list[Interval]:
        """Return the intervals in which W is nearer to singular than a threshold.

        Args:
            measure: "condition": where the condition number of the scaled W exceeds the threshold (that of the Jacobian
                for the 2-RPR, Parsa 2014, section 3.2); "margin": where its smallest singular value is below it.
            threshold: for the condition number above 1, for the margin positive.

        Raises:
            InputError: another measure, or a threshold out of range.
        """
        if measure not in get_args(Measure):
            raise InputError(f"measure is {measure!r}.", remedy="Pass 'condition' or 'margin'.", measure=measure)
        lower, upper = (1.0, LARGEST_CONDITION) if measure == "condition" else (0.0, np.inf)
        if not lower < threshold < upper:
            raise InputError(
                f"threshold is {threshold}, but a {measure} between {lower:g} and {upper:g} is needed.",
                remedy="The thesis works with condition numbers from 4 to 20.",
                threshold=threshold,
            )
        least = 1.0 / threshold if measure == "condition" else threshold
        return below_zero(lambda times: self._nearness(times, measure) - least, self._times)

    def worst(self, measure: Measure) -> float:
        """Return the largest condition number (infinite at a singularity), or the smallest margin, along the motion."""
        lowest = min(value for _, value in minima(lambda t: self._nearness(t, measure), self._times, np.inf))
        if measure == "margin":
            return lowest
        return 1.0 / lowest if lowest > SINGULAR else float("inf")

    def singular_instants(self) -> list[float]:
        """Return the times, s, at which the motion crosses or touches a type II singularity."""

        def signed(times: Array) -> Array:
            W = self.at(times)
            sign = np.sign(np.linalg.det(W)) if W.shape[1] == W.shape[2] else 1.0
            return np.asarray(self._nearness(times, "condition") * sign)

        return [zero.t for zero in zeros(signed, self._times, SINGULAR)]

    def _nearness(self, times: Array, measure: Measure) -> Array:
        """Return σ_min/σ_max, or σ_min: continuous also at a singularity, where a condition number is not."""
        values = self.singular_values(times)
        nearness: Array = values[:, -1] / values[:, 0] if measure == "condition" else values[:, -1]
        return nearness


def smooth_edges(motion: ContinuousMotion, start: float, end: float) -> Array:
    """Return (P + 1,) ends of pieces to fit a function along a motion on: jumps, and the few kinks of a trajectory."""
    inner = np.concatenate([motion.breaks, motion.knots]) if motion.exact else motion.breaks
    inner = np.unique(inner[(inner > start) & (inner < end)])
    edges: Array = np.concatenate([[start], inner, [end]])
    return edges


def dense(edges: Array) -> Array:
    """Return times that sample every piece densely, s; ``edges`` (P + 1,) are the ends of the pieces."""
    fraction = np.linspace(0.0, 1.0, SAMPLES_A_PIECE)[:-1]
    times: Array = np.append((edges[:-1, None] + np.diff(edges)[:, None] * fraction).ravel(), edges[-1])
    return times
