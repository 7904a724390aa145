"""Efforts at a type II singularity that a motion crosses: the limit of W⁻¹ f from both sides.

At a singular instant there are directions u with uᵀ W = 0. There W τ = f requires uᵀ f = 0, whatever τ is, and leaves
the part of τ in the null space of W open. The derivative of W τ = f by time, projected on u, determines that part,
since uᵀ W τ̇ = 0:

    uᵀ Ẇ τ = uᵀ ḟ.

Where the motion crosses the singularity at a rate, (W; uᵀ Ẇ) has full rank. Both equations together give the one τ that
W⁻¹ f tends to, from both sides if the carriers' jerk is the same on both.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, Frozen, Side, read_only
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.planners.functions import DEGREE
from redundancy_pin.spectrum import scaled
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, chebyshev_times

LOST = 1e-6
"""Singular values of the scaled W, relative to the largest, that are zero at a singular instant. The instant is known
to the square root of rounding where the motion only touches the singularity."""

CROSSED = 1e-3
"""Change of the vanishing singular value over the whole motion, at its rate at the instant and relative to the largest
singular value, from which a motion crosses the singularity. Rounding makes 1e-6 of a touch; the circle of the 2-RPR has
4."""

Evaluate = Callable[[Array], ReducedDynamics]
"""From (N,) increasing times, s, to W and f along a motion of platform and carriers."""


@dataclass(frozen=True, eq=False)
class SingularInstant(Frozen):
    """A type II singularity on a motion of platform and carriers; r directions are lost.

    Attributes:
        t: time, s.
        u: (r, n) rows with u W = 0, of unit length where forces count in N and moments over the characteristic length.
        W: (n, m) actuation matrix.
        W_rate: (n, m) its derivative by time, 1/s.
        f: (n,) generalised force, N and N·m.
        f_rate: (n,) its derivative by time, the carriers' motion included, N/s and N·m/s.
        size: largest singular value of the scaled W near the instant.
        row_scale: (n,) the characteristic length, m, for moments, 1 for forces.
        duration: of the motion, s.
    """

    t: float
    u: Array
    W: Array
    W_rate: Array
    f: Array
    f_rate: Array
    size: float
    row_scale: Array
    duration: float

    @staticmethod
    def along(evaluate: Evaluate, edges: Array, t: float, side: Side = "right") -> SingularInstant:
        """Return the singular instant at a time of a motion.

        Args:
            evaluate: the dynamics along the motion.
            edges: (P + 1,) times, s, between which the motion is smooth; ``t`` is one of them.
            t: time of the instant, s.
            side: from which derivatives are taken; the other one at the first and the last edge.
        """
        i = int(np.abs(edges - t).argmin())
        first = min(max(i - (side == "left"), 0), len(edges) - 2)
        ends = edges[first : first + 2]
        reduced = evaluate(chebyshev_times(ends, DEGREE))
        n, m = reduced.W.shape[1:]
        values = np.concatenate([np.asarray(reduced.W).reshape(len(reduced.t), -1), reduced.f], axis=1)
        function = PiecewisePolynomial.from_values(ends, values[None])
        (W, f), (W_rate, f_rate) = (
            (flat[: n * m].reshape(n, m), flat[n * m :]) for flat in (function.at(t), function.derivative().at(t))
        )
        scales = reduced.row_scale, reduced.column_scale
        size = float(np.linalg.norm(scaled(reduced.W, *scales), 2, axis=(1, 2)).max())
        left, values, _ = np.linalg.svd(scaled(W[None], *scales)[0])
        lost = max(int((values <= LOST * size).sum()), 1)
        u = left[:, n - lost :].T / reduced.row_scale
        u, W, W_rate, f, f_rate = (read_only(part) for part in (u, W, W_rate, f, f_rate))
        duration = float(edges[-1] - edges[0])
        return SingularInstant(t, u, W, W_rate, f, f_rate, size, reduced.row_scale, duration)

    @property
    def equation(self) -> tuple[Array, Array]:
        """uᵀ Ẇ (r, m) and uᵀ ḟ (r,): they determine the efforts together with W τ = f."""
        return self.u @ self.W_rate, self.u @ self.f_rate

    def efforts(self, preferred: Array | None = None) -> Array:
        """Return the efforts (m,), N or N·m, that W⁻¹ f tends to.

        Args:
            preferred: (m,) efforts to which those are nearest that are chosen where the equations leave a choice; zero
                when left out.
        """
        rows, right = self.equation
        rate = np.linalg.norm(rows, axis=1)
        crossed = rate * self.duration > CROSSED * self.size  # the others are rounding
        weight = self.size / rate[crossed]
        lost = self.u * self.row_scale
        kept = (np.eye(len(self.f)) - lost.T @ lost) / self.row_scale  # the rows of W τ = f that are not lost
        matrix = np.concatenate([kept @ self.W, weight[:, None] * rows[crossed]])
        force = np.concatenate([kept @ self.f, weight * right[crossed]])
        start = np.zeros(self.W.shape[1]) if preferred is None else preferred
        return np.asarray(start + np.linalg.lstsq(matrix, force - matrix @ start, rcond=LOST)[0])
