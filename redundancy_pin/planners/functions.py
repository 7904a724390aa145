"""A plan between its samples: platform, carriers and main efforts as functions of time.

Planners hand over the two motions as they made them, and the efforts where they decided on them (none while the
actuators are off). Everywhere else W τ = f of these motions determines the efforts, and they are evaluated where
somebody plays the plan, not when it is made: ten evaluations of the backend in each step cost as much as the plan.
``intersample_check`` evaluates them against limits.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Chebyshev

from redundancy_pin.arrays import Array, Frozen, Side
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.trajectory.continuous_motion import Motion
from redundancy_pin.trajectory.functions_of_time import (
    PiecewisePolynomial,
    carriers_at,
    chebyshev_series,
)

DEGREE = 9
"""Of the efforts in each piece. A step of 5 ms of a motion that changes within 50 ms leaves 1e-14."""

BESIDE = 0.3
"""Part of a piece next to a singular instant in which τ = W⁻¹ f magnifies rounding and is not evaluated."""

DEGREE_BESIDE = 5
"""Of τ in the pieces at a singular instant, from the rest of the piece and the τ that the plan has there."""

ROUNDED = 1e-10
"""Times that differ by less than this fraction of the interval are one."""

ROOT = 1e-6
"""How exactly a root of det W is known, relative to the piece: a double one to the square root of rounding."""

POLE = 1e-2
"""Last coefficients of the efforts in a piece, relative to the largest, from which they have a pole there."""

SINGULAR_SAMPLE = 1e-6
"""Margin of W, relative to the largest along the motion, below which a sample of a plan counts as singular."""


@dataclass(frozen=True, eq=False)
class PlanFunctions(Frozen):
    """The functions of time of a plan, from its first to its last sample.

    Attributes:
        platform: motion of the platform.
        carriers: positions (k,) of the carriers, m; ṡ and s̈ are its derivatives.
        prescribed: main efforts (m,) where the planner decided on them, N or N·m, each over its own interval.
        preferred: main efforts (m,); where W leaves a choice, those nearest to them are taken. Where left out, the
            least efforts.
    """

    platform: Motion
    carriers: PiecewisePolynomial
    prescribed: tuple[PiecewisePolynomial, ...] = ()
    preferred: PiecewisePolynomial | None = None

    def carriers_at(self, times: Array, side: Side = "right") -> CarrierMotion:
        """Return the carriers at (N,) times, s; ``side`` decides where s̈ jumps."""
        return carriers_at(self.carriers, times, side)

    def efforts(self, reduced: ReducedDynamics) -> Array:
        """Return main efforts (N, m), N or N·m, of the dynamics along these motions; NaN if no finite efforts exist."""
        has_choice = reduced.W.shape[2] > reduced.W.shape[1]
        wanted = self.preferred(reduced.t) if self.preferred is not None and has_choice else None
        tau = np.array(distribute(reduced, preferred=wanted).tau)
        for part in self.prescribed:
            inside = (reduced.t >= part.start) & (reduced.t <= part.end)
            tau[inside] = part(reduced.t[inside])
        return tau

    def pieces(self, samples: Array) -> Array:
        """Return (P + 1,) times, s, between which everything is smooth, with the (N,) samples of a plan."""
        platform, decided = self.platform, [part.edges for part in self.prescribed]
        edges = np.concatenate([samples, self.carriers.edges, platform.breaks, platform.knots, *decided])
        return unique_times(edges[(edges >= samples[0]) & (edges <= samples[-1])])

    def effort_polynomials(
        self, edges: Array, reduced: ReducedDynamics, limits: Mapping[float, Array]
    ) -> PiecewisePolynomial:
        """Return the main efforts (m,) as polynomials.

        ``edges`` (P + 1,) ends of the pieces, s; ``reduced``: dynamics along these motions at the times of
        ``chebyshev_times`` of the pieces; ``limits``: efforts (m,) at edges, s, on a type II singularity, which W⁻¹ f
        tends to.
        """
        left, right, slack = edges[:-1], edges[1:], ROUNDED * (edges[-1] - edges[0])
        times = reduced.t.reshape(len(left), -1)
        tau = self.efforts(reduced).reshape(*times.shape, -1)
        for t, value in limits.items():
            at_end = (np.abs(left - t) <= slack) | (
                np.abs(right - t) <= slack
            )  # an edge may be a breakpoint next to the sample
            for i in np.flatnonzero(at_end):
                tau[i] = _beside((times[i] - t) / (right[i] - left[i]), tau[i], value)
        _require_finite(tau, edges, reduced)
        return PiecewisePolynomial.from_values(edges, tau)


def _beside(distance: Array, tau: Array, value: Array) -> Array:
    """Return τ (d, m) in a piece with a singular instant at one end, from the rest of the piece and τ there.

    ``distance`` (d,) of the times in the piece from the instant, in lengths of the piece; ``tau`` (d, m) W⁻¹ f there;
    ``value`` (m,) at the instant.
    """
    kept = np.abs(distance) > BESIDE
    domain = sorted([0.0, float(np.sign(distance[0]))])
    x, y = np.append(distance[kept], 0.0), np.vstack([tau[kept], value])
    columns = [Chebyshev.fit(x, column, DEGREE_BESIDE, domain=domain)(distance) for column in y.T]
    return np.stack(columns, axis=1)


def _require_finite(tau: Array, edges: Array, reduced: ReducedDynamics) -> None:
    """Check the (P, d, m) efforts in each piece: a pole, which no node need meet, leaves large last coefficients."""
    series = chebyshev_series(tau)
    size = np.abs(series).max(initial=0.0, where=np.isfinite(series))
    bad = ~np.isfinite(series).all(axis=(1, 2)) | (np.abs(series[:, -2:]).max(axis=(1, 2)) > POLE * size)
    for i in np.flatnonzero(bad)[:1].tolist():
        t = _singular_instant(tau[i], edges[i : i + 2], reduced, i)
        raise InfeasiblePlanError(
            f"The motion has no finite efforts at t = {t:.9g} s.",
            remedy="It meets a type II singularity that it may not cross: plan it with plan_whole_trajectory.",
            constraint="effort",
            time=t,
        )


def _singular_instant(tau: Array, ends: Array, reduced: ReducedDynamics, piece: int) -> float:
    """Return where in a piece the (d, m) efforts have their pole: where det W, a polynomial there, is zero."""
    nodes = slice(piece * len(tau), (piece + 1) * len(tau))
    times, W = reduced.t[nodes], np.asarray(reduced.W[nodes])
    lost = np.flatnonzero(~np.isfinite(tau).all(axis=1))
    if len(lost):
        return float(times[lost[0]])
    if W.shape[1] == W.shape[2]:
        determinant = np.linalg.det(W)
        roots = Chebyshev.fit(times, determinant / np.abs(determinant).max(), len(times) - 1, domain=ends).roots()
        slack = ROOT * (ends[1] - ends[0])
        near = np.sort(
            roots.real[(np.abs(roots.imag) <= slack) & (np.abs(roots.real - ends.mean()) <= 0.5 * np.ptp(ends) + slack)]
        )
        if len(near):
            return float(next((end for end in ends if abs(near[0] - end) <= slack), near[0]))
    return float(times[np.abs(tau).max(axis=1).argmax()])


def unique_times(times: Array) -> Array:
    """Return times in order, those that differ from the one before by rounding left out, the first and last kept."""
    edges = np.unique(times)
    kept: Array = edges[np.append(True, np.diff(edges) > ROUNDED * (edges[-1] - edges[0]))]
    kept[-1] = edges[-1]
    return kept
