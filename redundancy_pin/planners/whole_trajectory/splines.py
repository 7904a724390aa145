"""What is to be bounded on a course of the carriers, in few unknowns: the coefficients of splines.

s̈ is linear in a step, so the carriers are cubic splines: one coefficient a knot and carrier, with fixed ones at the
ends; a jump is a double knot, and middle nodes, across which the jerk is continuous, are none. The efforts are τ =
W⁻¹ f, at singular nodes what uᵀ Ẇ τ = uᵀ ḟ makes of it (``problem``) with uᵀ f = 0 as an equation beside it. Limits
of s, ṡ and s̈ are linear.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.sparse import csr_array

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.planners.carrier_model import CarrierModel
from redundancy_pin.planners.whole_trajectory.problem import WholeTrajectoryProblem
from redundancy_pin.planners.whole_trajectory.transcription import scaled_bounds

SPLINE = 4
"""Derivatives 0 to 3 of a cubic spline, and as many basis functions that are not zero."""


class Splines:
    """The course of the carriers as a linear function of x, the free coefficients (knot by knot, then by carrier).

    y (M, k, 4) are scaled s, ṡ and s̈ and the jerk over the size of s̈ at the nodes: ``matrix`` x + ``constant``.
    """

    def __init__(self, problem: WholeTrajectoryProblem) -> None:
        grid, u, settings, k = problem.grid, problem.scales, problem.settings, problem.model.k
        t, h, count = grid.t, grid.h, len(grid.t)
        # a jump is two nodes and so two knots, across which s and ṡ are continuous
        knots = np.concatenate([[t[0]] * SPLINE, t[1:-1][~grid.smooth[1:-1]], [t[-1]] * SPLINE])
        step = np.minimum(np.arange(count), count - 2)
        step = np.where(h[step] > 0.0, step, step - 1)
        last = np.searchsorted(knots, 0.5 * (t[step] + t[step + 1]), side="right") - 1
        basis = np.stack([_basis(knots, last, t, order) for order in range(SPLINE)], axis=1)
        self.size = np.stack([np.broadcast_to(size, k) for size in (u.s, u.sd, u.sdd, u.sdd)], axis=-1)
        by_carrier = basis[:, None] * (self.size[:, :1] / self.size)[:, :, None]  # (M, k, 4, 4)

        coefficients = len(knots) - SPLINE
        fixed, free = np.zeros((coefficients, k)), np.arange(coefficients) - 2
        fixed[:2] = settings.start / u.s
        fixed[1] += settings.start_speed / u.s * (knots[4] - knots[3]) / 3.0
        free[:2] = -1
        if settings.end == "datum":
            fixed[-2:], free[-2:] = settings.datum / u.s, -1
        elif settings.end == "rest":  # ṡ is the difference of the last two
            free[-1] = free[-2]
        places = last[:, None] + np.arange(1 - SPLINE, 1)  # (M, 4) the coefficients at each node
        number = np.where(free[places] >= 0, free[places] * k + np.arange(k)[:, None, None], -1)  # (k, M, 4)
        self.columns: IntArray = np.moveaxis(number, 0, 1).reshape(count, -1)  # (M, 4 k)
        self.count = (int(free.max()) + 1) * k
        self.by_carrier = np.where(np.moveaxis(number, 0, 1)[:, :, None] >= 0, by_carrier, 0.0)
        self.constant = np.einsum("mkqb,mbk->mkq", by_carrier, fixed[places])
        at = np.broadcast_to(np.maximum(np.moveaxis(number, 0, 1), 0)[:, :, None], by_carrier.shape)
        ends = np.arange(0, by_carrier.size + 1, SPLINE)
        self.matrix = csr_array((self.by_carrier.ravel(), at.ravel(), ends), shape=(len(ends) - 1, self.count))
        self.back = self.matrix.T.tocsr()
        # where entries of the nodes' matrices go in the lower band
        self.width = SPLINE * k
        self._all, self._own = (
            self._places(numbers) for numbers in (self.columns, self.columns.reshape(count, k, SPLINE))
        )

    def _places(self, numbers: IntArray) -> tuple[IntArray, IntArray]:
        """Return which entries of matrices (…, c, c) in coefficients (…, c) are below the diagonal, and where there."""
        i, j = numbers[..., :, None], numbers[..., None, :]
        used = np.flatnonzero((i >= j) & (j >= 0))
        return used, ((i - j) * self.count + j).ravel()[used]

    def course(self, x: Array) -> Array:
        """Return y (M, k, 4)."""
        course: Array = self.constant + (self.matrix @ x).reshape(self.constant.shape)
        return course

    def of_carriers(self, slopes: Array) -> Array:
        """Return slopes (M, …, k, 4) by y as those (M, …, 4 k) by the coefficients at each node."""
        between = (1,) * (slopes.ndim - 3)
        basis = self.by_carrier.reshape(len(slopes), *between, *self.by_carrier.shape[1:])
        return np.asarray((slopes[..., None, :] @ basis).reshape(*slopes.shape[:-2], -1))

    def band(self, forms: Array) -> Array:
        """Return the lower band of a sum of quadratic forms.

        ``forms`` (M, 4 k, 4 k) in the coefficients at each node, or (M, k, 4, 4) in y, a carrier's with its own.
        """
        used, places = self._all
        if forms.ndim == 4:
            forms, (used, places) = self.by_carrier.swapaxes(2, 3) @ forms @ self.by_carrier, self._own
        sums = np.bincount(places, weights=forms.ravel()[used], minlength=self.width * self.count)
        return np.asarray(sums, dtype=np.float64).reshape(self.width, self.count)

    def fitted(self, course: Array) -> Array:
        """Return x whose course is nearest to scaled s, ṡ and s̈ (M, k, 3)."""
        forms = np.broadcast_to(np.diag([1.0, 1.0, 1.0, 0.0]), (*course.shape[:2], SPLINE, SPLINE))
        missed = np.zeros_like(self.constant)
        missed[..., :3] = course - self.constant[..., :3]
        factors = dpbtrf(self.band(forms), lower=1)[0]
        return np.asarray(dpbtrs(factors, self.back @ missed.ravel(), lower=1)[0])


def _basis(knots: Array, last: IntArray, t: Array, order: int) -> Array:
    """Return a derivative (M, 4) of the cubic B-splines at times in the spans before knots ``last`` + 1 (de Boor)."""
    values = np.ones((len(t), 1))
    for degree in range(1, SPLINE):
        raised = np.zeros((len(t), degree + 1))
        for i in range(degree):
            low, high = knots[last + i + 1 - degree], knots[last + i + 1]
            if degree > SPLINE - 1 - order:
                rise, fall = degree / (high - low), degree / (low - high)
            else:
                rise, fall = (t - low) / (high - low), (high - t) / (high - low)
            raised[:, i + 1] += rise * values[:, i]
            raised[:, i] += fall * values[:, i]
        values = raised
    return values


_WAVES_AND_RATES = [(1, 0), (2, 0), (0, 1), (1, 1), (0, 3), (0, 2), (1, 3)] + [
    (wave, rate) for rate in range(4) for wave in (3, 4, 5, 6)
]
"""``carrier_model.terms`` as products: 1, s, s², cos s − 1, sin s, cos 2s − 1 or sin 2s with 1, ṡ, ṡ² or s̈."""


class Loads:
    """f and its first and second derivatives by the carriers' motion, from its terms."""

    def __init__(self, model: CarrierModel) -> None:
        count, n, k, each = model.f_terms.shape
        by_wave = np.zeros((count, k, n, 4, 7))
        for j, (wave, rate) in enumerate(_WAVES_AND_RATES[:each]):
            by_wave[..., rate, wave] += model.f_terms[..., j].swapaxes(1, 2)
        self.waves = np.flatnonzero(by_wave.any(axis=(0, 1, 2, 3)))
        self.by_wave = by_wave[..., self.waves].reshape(count, k, 4 * n, -1)
        self.f0, self.shape = model.f0, (count, k, n, 4, 3)

    def __call__(self, motion: Array) -> tuple[Array, Array, Array]:
        """Return f (M, n) and its derivatives (M, n, k, 3) and (M, n, k, 3, 3) at s, ṡ and s̈ (M, k, 3)."""
        s, sd, sdd = np.moveaxis(motion, -1, 0)
        one, zero, twice = np.ones_like(s), np.zeros_like(s), 2.0 * s
        c, d, c2, d2 = np.cos(s), np.sin(s), np.cos(twice), np.sin(twice)
        waves = np.array(
            [
                [one, s, s * s, c - 1.0, d, c2 - 1.0, d2],
                [zero, one, twice, -d, c, -2.0 * d2, 2.0 * c2],
                [zero, zero, 2.0 * one, -c, -d, -4.0 * c2, -4.0 * d2],
            ]
        )[:, self.waves]
        by_rate = (self.by_wave @ np.moveaxis(waves, (0, 1), (3, 2))).reshape(self.shape).swapaxes(1, 2)
        rates = np.stack([one, sd, sd * sd, sdd], axis=-1)[:, None]
        value, by_s, by_ss = np.moveaxis(np.einsum("mnkrd,mjkr->mnkd", by_rate, rates), -1, 0)
        faster = 2.0 * sd[:, None]
        first = np.stack([by_s, by_rate[..., 1, 0] + faster * by_rate[..., 2, 0], by_rate[..., 3, 0]], axis=-1)
        second = np.zeros((*first.shape, 3))
        second[..., 0, 0], second[..., 1, 1] = by_ss, 2.0 * by_rate[..., 2, 0]
        second[..., 0, 1] = second[..., 1, 0] = by_rate[..., 1, 1] + faster * by_rate[..., 2, 1]
        second[..., 0, 2] = second[..., 2, 0] = by_rate[..., 3, 1]
        return self.f0 + value.sum(axis=2), first, second


@dataclass(frozen=True, eq=False)
class Efforts:
    """The efforts at a course, over their size, and the equations e = 0 of the singular nodes.

    ``tau`` (M, m), ``slopes`` (M, m, k, 4) by y; ``second`` (M, n, k, 3, 3) derivatives of f by scaled s, ṡ and s̈;
    ``e`` (r,), ``by_y`` (r, k, 4) their slopes by y at their nodes.
    """

    tau: Array
    slopes: Array
    second: Array
    e: Array
    by_y: Array


class EffortsAlong:
    """τ and uᵀ f as functions of y."""

    def __init__(self, problem: WholeTrajectoryProblem, size: Array) -> None:
        model, u = problem.model, problem.scales
        self.f, self.size = Loads(model), size
        inverse = np.zeros(model.W.swapaxes(1, 2).shape)
        regular = np.setdiff1d(np.arange(len(model.W)), problem.grid.singular)
        inverse[regular] = np.linalg.inv(model.W[regular])
        self.nodes: list[tuple[int, Array, Array, Loads]] = []
        for node in problem.singular:
            W, rank = model.W[node.index], len(model.W[node.index]) - len(node.lost)
            across = np.linalg.svd(node.lost)[2][len(node.lost) :]  # the directions that are left
            both = np.linalg.inv(np.concatenate([across @ W, node.lost @ node.rate.W[0]]))
            inverse[node.index] = both[:, :rank] @ across
            self.nodes.append((node.index, node.lost, both[:, rank:] / u.tau, Loads(node.rate)))
        self.inverse = inverse / u.tau
        self.at = np.array([index for index, lost, *_ in self.nodes for _ in lost], dtype=np.intp)
        lost = [row for _, rows, *_ in self.nodes for row in rows]
        self.lost = np.array([row / (u.row @ np.abs(row)) for row in lost]).reshape(-1, model.W.shape[1])

    def __call__(self, y: Array) -> Efforts:
        """Return them at a course y (M, k, 4)."""
        count, k, _ = y.shape
        motion = y * self.size
        value, first, second = self.f(motion[..., :3])
        first = first * self.size[:, :3]
        second = second * (self.size[:, :3, None] * self.size[:, None, :3])
        tau = np.einsum("mji,mi->mj", self.inverse, value)
        slopes = np.zeros((count, self.inverse.shape[1], k, SPLINE))
        slopes[..., :3] = (self.inverse @ first.reshape(*first.shape[:2], -1)).reshape(*slopes.shape[:3], 3)
        for i, lost, inverse, rate in self.nodes:
            # ḟ = ∂f/∂t + Σ ∂f/∂y ẏ, ẏ = (ṡ, s̈, s⃛) in the scales of y
            ratio = self.size[:, 1:] / self.size[:, :3]
            flow = y[i, :, 1:] * ratio
            by_time, by_time_y, _ = rate(motion[i : i + 1, :, :3])
            by_y = np.zeros((*first.shape[1:3], SPLINE))
            by_y[..., :3] = by_time_y[0] * self.size[:, :3] + np.einsum("nkqr,kq->nkr", second[i], flow)
            by_y[..., 1:] += first[i] * ratio
            to_tau = inverse @ lost
            tau[i] += to_tau @ (by_time[0] + np.einsum("nkq,kq->n", first[i], flow))
            slopes[i] += np.einsum("mn,nkq->mkq", to_tau, by_y)
        by_y = np.zeros((len(self.at), k, SPLINE))
        by_y[..., :3] = np.einsum("rn,rnkq->rkq", self.lost, first[self.at])
        return Efforts(tau, slopes, second, np.einsum("rn,rn->r", self.lost, value[self.at]), by_y)


class Inequalities:
    """g ≥ 0: p − τ, p + τ, and then limits of y at nodes, and between them in some steps (M − 1,).

    ``squares`` makes of weights of the limits what they add to the band of a quadratic form.
    """

    def __init__(self, problem: WholeTrajectoryProblem, splines: Splines, between: BoolArray) -> None:
        h, end, bounds = problem.grid.h, problem.settings.end, scaled_bounds(problem)
        u, (count, _, m), k = problem.scales, problem.model.W.shape, problem.model.k
        self.splines, self.efforts = splines, count * m
        # s, ṡ, s̈ and the inner Bézier points of ṡ and s, see ``Transcription.limits_between_nodes``
        points = np.zeros((count, k, 6, SPLINE))
        for row, base in enumerate((0, 1, 2, 1, 0, 0)):
            points[:, :, row, base] = 1.0
        ahead, behind = np.append(h, 0.0)[:, None], np.append(0.0, h)[:, None]
        points[:, :, 3, 2], points[:, :, 4, 1] = ahead / 2.0 * u.sdd / u.sd, ahead / 3.0 * u.sd / u.s
        points[:, :, 5, 1] = -behind / 3.0 * u.sd / u.s
        bounded = np.ones((count, k, 6), dtype=bool)
        bounded[~np.append(between, False), :, 3:5] = bounded[~np.append(False, between), :, 5] = False
        # what is fixed keeps its limits
        bounded[0, :, :2] = bounded[-1, :, {"datum": [0, 1], "rest": [1], "free": []}[end]] = False
        rest, values, columns = [], [], []
        for side, sign in ((0, 1.0), (1, -1.0)):
            limits = [np.broadcast_to(bounds[name][side], k) for name in ("s", "sd", "sdd", "sd", "s", "s")]
            limit = np.broadcast_to(np.stack(limits, axis=-1), bounded.shape)
            at = np.nonzero(bounded & np.isfinite(limit))
            rest.append(sign * (np.einsum("mkrq,mkq->mkr", points, splines.constant) - limit)[at])
            values.append(sign * (points @ splines.by_carrier)[at])
            columns.append(splines.columns.reshape(count, k, SPLINE)[at[:2]])
        self.rest, self.values, by = np.concatenate(rest), np.concatenate(values), np.concatenate(columns)
        # of rows with the coefficients at their node and p, p's last; what is fixed has zeros
        own = np.concatenate([splines.columns, np.full((count, 1), splines.count)], axis=1).repeat(m, axis=0)
        self._columns = np.maximum(np.concatenate([part.ravel() for part in (own, own, by)]), 0)
        lengths = np.repeat([own.shape[1], SPLINE], [2 * self.efforts, len(by)])
        self._ends = np.append(0, np.cumsum(lengths))
        limit_of, i, j = np.nonzero((by[:, :, None] >= by[:, None]) & (by[:, None] >= 0))
        place = (by[limit_of, i] - by[limit_of, j]) * splines.count + by[limit_of, j]
        shape = (splines.width * splines.count, len(by))
        self.squares = csr_array((self.values[limit_of, i] * self.values[limit_of, j], (place, limit_of)), shape=shape)
        self._limits = csr_array(
            (self.values.ravel(), np.maximum(by, 0).ravel(), np.arange(0, by.size + 1, SPLINE)),
            shape=(len(by), splines.count),
        )

    def __call__(self, x: Array, p: float, tau: Array) -> Array:
        """Return g at coefficients, the peak and the scaled efforts (M, m)."""
        return np.concatenate([(p - tau).ravel(), (p + tau).ravel(), self._limits @ x + self.rest])

    def slopes(self, slopes: Array) -> Any:
        """Return those of g by (x, p), from those (M, m, 4 k) of τ by the coefficients at each node."""
        by_coefficient = slopes.reshape(self.efforts, -1)
        ones = np.ones((self.efforts, 1))
        below, above = (np.concatenate([sign * by_coefficient, ones], axis=1).ravel() for sign in (-1.0, 1.0))
        values = np.concatenate([below, above, self.values.ravel()])
        return csr_array((values, self._columns, self._ends), shape=(len(self._ends) - 1, self.splines.count + 1))
