"""Least peak in few unknowns: an interior-point method whose steps are banded systems.

What IPOPT solves has a dozen unknowns and as many rows a node, for equations and inequalities alike. Here the carriers
are splines, s̈ linear in a step and s, ṡ whole by construction: one coefficient a knot and carrier, with fixed ones at
the ends; middle nodes, across which the jerk is continuous, add none. The efforts are τ = W⁻¹ f, at singular nodes what
uᵀ Ẇ τ = uᵀ ḟ makes of it (``problem``), with uᵀ f = 0 as an equation. There remain inequalities,

    minimise p + ε ∫ Σ s̈² dt    subject to    −p ≤ τ(c) ≤ p,  limits of s, ṡ and s̈, which are linear in c,

and with slacks w and multipliers z a Newton step is (H + Gᵀ (z/w) G) dc = …, as wide as a spline's support, beside one
column for p and rows for uᵀ f: a tenth of the time of one of IPOPT. Predictor and corrector are Mehrotra's, without a
line search, as in ``solver.PREDICTED``, and the last barrier parameter stays, so that IPOPT can go on from w z = μ: it
has the last word on every plan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs
from scipy.sparse import csr_array

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.planners.carrier_model import CarrierModel
from redundancy_pin.planners.whole_trajectory.problem import Problem
from redundancy_pin.planners.whole_trajectory.transcription import REGULARISATION, scaled_bounds

NEAR = 1e-6
"""Sum of all w z at the end over the peak: by so much it is from the least one."""

EXACT = 1e-8
"""Of equations and dual conditions at the end."""

FEW = 3000
"""Nodes up to which s̈ keeps its digits in the coefficients of a spline."""

MOST = 80
"""Iterations; where it takes more it has wandered."""

SPLINE = 4
"""Derivatives 0 to 3 of a cubic spline, and as many basis functions that are not zero."""

SHIFTS = (1e-15, 1e-13, 1e-11, 1e-9)
"""By which fractions of itself the diagonal grows until rounding leaves the matrix positive definite. The steps are
refined with the matrix as it is."""

REFINED, REFINEMENTS = 1e-14, 10
"""What is left of Newton's equations; with 1e-11 rounding makes the iterations a third more."""

CORRECTORS, FARTHER, CENTRAL = 2, 0.3, (0.01, 100.0)
"""Gondzio's correctors for each step (1996), the longer step they aim at, and which products w z, over the mean aimed
at, they leave alone. A third fewer iterations."""

EQUATIONS = 1e3
"""Weight of the squares of the equations in the matrix, which keep it positive definite across them."""


class _Splines:
    """The course of the carriers as a linear function of x, the free coefficients (knot by knot, then by carrier).

    y (M, k, 4) are scaled s, ṡ and s̈ and the jerk over the size of s̈ at the nodes: ``matrix`` x + ``constant``.
    """

    def __init__(self, problem: Problem) -> None:
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
        return np.bincount(places, forms.ravel()[used], self.width * self.count).reshape(self.width, self.count)

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


class _Loads:
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
class _At:
    """The efforts at a course, over their size, and the equations e = 0 of the singular nodes.

    ``tau`` (M, m), ``slopes`` (M, m, k, 4) by y; ``second`` (M, n, k, 3, 3) derivatives of f by scaled s, ṡ and s̈;
    ``e`` (r,), ``by_y`` (r, k, 4) their slopes by y at their nodes.
    """

    tau: Array
    slopes: Array
    second: Array
    e: Array
    by_y: Array


class _Efforts:
    """τ and uᵀ f as functions of y."""

    def __init__(self, problem: Problem, size: Array) -> None:
        model, u = problem.model, problem.scales
        self.f, self.size = _Loads(model), size
        inverse = np.zeros(model.W.swapaxes(1, 2).shape)
        regular = np.setdiff1d(np.arange(len(model.W)), problem.grid.singular)
        inverse[regular] = np.linalg.inv(model.W[regular])
        self.nodes: list[tuple[int, Array, Array, _Loads]] = []
        for node in problem.singular:
            W, rank = model.W[node.index], len(model.W[node.index]) - len(node.lost)
            across = np.linalg.svd(node.lost)[2][len(node.lost) :]  # the directions that are left
            both = np.linalg.inv(np.concatenate([across @ W, node.lost @ node.rate.W[0]]))
            inverse[node.index] = both[:, :rank] @ across
            self.nodes.append((node.index, node.lost, both[:, rank:] / u.tau, _Loads(node.rate)))
        self.inverse = inverse / u.tau
        self.at = np.array([index for index, lost, *_ in self.nodes for _ in lost], dtype=np.intp)
        lost = [row for _, rows, *_ in self.nodes for row in rows]
        self.lost = np.array([row / (u.row @ np.abs(row)) for row in lost]).reshape(-1, model.W.shape[1])

    def __call__(self, y: Array) -> _At:
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
        return _At(tau, slopes, second, np.einsum("rn,rn->r", self.lost, value[self.at]), by_y)


@dataclass(frozen=True, eq=False)
class LeastPeak:
    """A course of least peak: scaled s, ṡ and s̈ (M, k) and τ (M, m) by name.

    ``peak`` largest |τ|, scaled; ``centre``: the barrier parameter, w z of every inequality; ``cost``, ``iterations``.
    """

    values: dict[str, Array]
    peak: float
    centre: float
    cost: float
    iterations: int


class _Inequalities:
    """g ≥ 0: p − τ, p + τ, and then limits of y at nodes, and between them in some steps (M − 1,).

    ``squares`` makes of weights of the limits what they add to the band of a quadratic form.
    """

    def __init__(self, problem: Problem, splines: _Splines, between: BoolArray) -> None:
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
        held = np.ones((count, k, 6), dtype=bool)
        held[~np.append(between, False), :, 3:5] = held[~np.append(False, between), :, 5] = False
        # what is fixed keeps its limits
        held[0, :, :2] = held[-1, :, {"datum": [0, 1], "rest": [1], "free": []}[end]] = False
        rest, values, columns = [], [], []
        for side, sign in ((0, 1.0), (1, -1.0)):
            limits = [np.broadcast_to(bounds[name][side], k) for name in ("s", "sd", "sdd", "sd", "s", "s")]
            limit = np.broadcast_to(np.stack(limits, axis=-1), held.shape)
            at = np.nonzero(held & np.isfinite(limit))
            rest.append(sign * (np.einsum("mkrq,mkq->mkr", points, splines.constant) - limit)[at])
            values.append(sign * (points @ splines.by_carrier)[at])
            columns.append(splines.columns.reshape(count, k, SPLINE)[at[:2]])
        self.rest, self.values, by = np.concatenate(rest), np.concatenate(values), np.concatenate(columns)
        # of rows with the coefficients at their node and p, p's last; what is fixed has zeros
        own = np.concatenate([splines.columns, np.full((count, 1), splines.count)], axis=1).repeat(m, axis=0)
        self._columns = np.maximum(np.concatenate([part.ravel() for part in (own, own, by)]), 0)
        lengths = np.repeat([own.shape[1], SPLINE], [2 * self.efforts, len(by)])
        self._ends = np.append(0, np.cumsum(lengths))
        row, i, j = np.nonzero((by[:, :, None] >= by[:, None]) & (by[:, None] >= 0))
        place = (by[row, i] - by[row, j]) * splines.count + by[row, j]
        shape = (splines.width * splines.count, len(by))
        self.squares = csr_array((self.values[row, i] * self.values[row, j], (place, row)), shape=shape)
        self._limits = csr_array(
            (self.values.ravel(), np.maximum(by, 0).ravel(), np.arange(0, by.size + 1, SPLINE)),
            shape=(len(by), splines.count),
        )

    def __call__(self, x: Array, p: float, tau: Array) -> Array:
        return np.concatenate([(p - tau).ravel(), (p + tau).ravel(), self._limits @ x + self.rest])

    def slopes(self, slopes: Array) -> Any:
        """Return those of g by (x, p), from those (M, m, 4 k) of τ by the coefficients at each node."""
        by_coefficient = slopes.reshape(self.efforts, -1)
        ones = np.ones((self.efforts, 1))
        below, above = (np.concatenate([sign * by_coefficient, ones], axis=1).ravel() for sign in (-1.0, 1.0))
        values = np.concatenate([below, above, self.values.ravel()])
        return csr_array((values, self._columns, self._ends), shape=(len(self._ends) - 1, self.splines.count + 1))


def serves(problem: Problem) -> bool:
    """Return whether a problem is one of these: nothing but the peak, efforts that f determines, no further limits."""
    settings, limits, (count, n, m) = problem.settings, problem.settings.limits, problem.model.W.shape
    return (
        set(settings.objective) == {"peak"}
        and not settings.at_most
        and settings.end != "periodic"
        and problem.exact is None
        and n == m
        and count < FEW
        and not np.isfinite([*limits.effort, *limits.jerk]).any()
    )


def least_peak(
    problem: Problem, guess: Mapping[str, Array], between: BoolArray, go_on: Callable[[int, float], bool]
) -> LeastPeak | None:
    """Return the course of least peak, or None where the method ends without.

    ``guess``: scaled s, ṡ and s̈ to begin with; ``between`` (M − 1,): steps in which track and speed limits hold
    between the nodes as well; ``go_on``: asked before each iteration, with its number and the cost.
    """
    splines = _Splines(problem)
    efforts, limits = _Efforts(problem, splines.size), _Inequalities(problem, splines, between)
    zero = np.zeros((len(problem.grid.t), problem.model.k))
    x = splines.fitted(np.stack([guess.get(name, zero) for name in ("s", "sd", "sdd")], axis=-1))
    half = 0.5 * problem.grid.h
    gentle = 2.0 * REGULARISATION * (np.append(half, 0.0) + np.append(0.0, half)) / problem.scales.duration
    y = splines.course(x)
    at = efforts(y)
    p = float(np.quantile(np.abs(at.tau).max(axis=1), 0.9))
    g = limits(x, p, at.tau)
    of_efforts = np.arange(len(g)) < 2 * limits.efforts
    w = np.maximum(g, np.where(of_efforts, 0.3 * p, 0.1))
    z = np.where(of_efforts, 1.0, w[of_efforts].mean() / w) / (2 * limits.efforts)
    nu = np.zeros(len(at.e))
    for iteration in range(MOST):
        cost = p + 0.5 * float((gentle[:, None] * y[..., 2] ** 2).sum())
        system = _System(efforts, limits, gentle, at, y, limits(x, p, at.tau) - w, w, z, nu)
        mu, centre = float(w @ z) / len(w), NEAR * p / len(w)
        if system.error <= EXACT and np.abs(w * z - centre).max() <= 0.5 * centre:
            values = {"s": y[..., 0], "sd": y[..., 1], "sdd": y[..., 2], "tau": at.tau}
            return LeastPeak(values, p, centre, cost, iteration)
        if not (np.isfinite(cost) and go_on(iteration, cost) and system.factorise()):
            return None
        step, dw, dz = system.step(centre, mu)
        dx, dp, dnu = step[: splines.count], float(step[splines.count]), step[splines.count + 1 :]
        primal, dual = (1.0 if (far := _longest(*one)) == 1.0 else max(0.99, 1.0 - mu) * far for one in ((w, dw), (z, dz)))
        x, p, w = x + primal * dx, p + primal * dp, w + primal * dw
        nu, z = nu + dual * dnu, z + dual * dz
        y = splines.course(x)
        at = efforts(y)
    return None


def _longest(values: Array, step: Array) -> float:
    """Return how much of a step keeps positive values so."""
    return min(1.0, 1.0 / max(float((-step / values).max()), 1e-300))


_Step = tuple[Array, Array, Array]
"""(dx, dp, dν), and the steps of w and z."""


class _System:
    """Newton's equations at a point: residuals, the factors, and steps from them. ``left`` is g − w."""

    def __init__(
        self,
        efforts: _Efforts,
        limits: _Inequalities,
        gentle: Array,
        at: _At,
        y: Array,
        left: Array,
        w: Array,
        z: Array,
        nu: Array,
    ) -> None:
        self.limits, self.efforts, self.splines = limits, efforts, limits.splines
        self.at, self.left, self.w, self.z, self.nu = at, left, w, z, nu
        self.nodes, self.gentle = efforts.at, gentle
        self.n = self.splines.count
        self.by_node = self.splines.of_carriers(at.slopes)
        self.slopes = limits.slopes(self.by_node)
        self.back = self.slopes.T
        columns = self.splines.columns
        self.crossing = np.zeros((len(self.nodes), columns.shape[1]))
        self.equations = np.zeros((len(self.nodes), self.n + 1))
        for i, node in enumerate(self.nodes):
            self.crossing[i] = (at.by_y[i, :, None] @ self.splines.by_carrier[node]).ravel()
            np.add.at(self.equations[i], np.maximum(columns[node], 0), self.crossing[i])
        slope = np.zeros_like(y)
        slope[..., 2] = gentle[:, None] * y[..., 2]
        self.dual = np.append(self.splines.back @ slope.ravel(), 1.0) - self.back @ z - nu @ self.equations
        self.error = max(np.abs(part).max(initial=0.0) for part in (left, at.e, self.dual))

    def factorise(self) -> bool:
        """Make the factors; return whether the matrix is positive definite, if only without the curvature of τ."""
        limits, splines, (count, m, k, _) = self.limits, self.splines, self.at.slopes.shape
        self.weights = self.z / self.w
        below, above, limited = np.split(self.weights, [limits.efforts, 2 * limits.efforts])
        form = self.by_node.swapaxes(1, 2) @ ((below + above).reshape(count, m, 1) * self.by_node)
        np.add.at(form, self.nodes, EQUATIONS * self.crossing[:, :, None] * self.crossing[:, None])
        band = splines.band(form) + (limits.squares @ limited).reshape(splines.width, -1)
        below, above = self.z[: limits.efforts], self.z[limits.efforts : 2 * limits.efforts]
        price = np.einsum("mi,min->mn", (below - above).reshape(count, m), self.efforts.inverse)
        np.subtract.at(price, self.nodes, self.nu[:, None] * self.efforts.lost)
        curved = np.einsum("mn,mnkqr->mkqr", price, self.at.second)
        for shifts, curvature in ((SHIFTS[:2], curved), (SHIFTS, 0.0)):
            self.curvature = np.zeros((count, k, SPLINE, SPLINE))
            self.curvature[..., :3, :3] = curvature
            self.curvature[..., 2, 2] += self.gentle[:, None]
            whole = band + splines.band(self.curvature)
            for shift in shifts:
                shifted = whole.copy()
                shifted[0] *= 1.0 + shift
                self.factors, failed = dpbtrf(shifted, lower=1, overwrite_ab=1)
                if not failed:
                    self._border()
                    return True
        return False

    def _border(self) -> None:
        """Eliminate the splines' coefficients from the equations of p and of the singular nodes."""
        of_efforts = np.arange(len(self.w)) < 2 * self.limits.efforts
        by_p = self.back @ (self.weights * of_efforts)
        self.rows = np.concatenate([by_p[None, :-1], -self.equations[:, :-1]])
        corner = np.zeros((len(self.rows), len(self.rows)))
        corner[0, 0] = by_p[-1]
        self.solved = dpbtrs(self.factors, self.rows.T, lower=1)[0]
        self.small = np.linalg.inv(corner - self.rows @ self.solved)

    def _rough(self, right: Array) -> Array:
        """Return (dx, dp, dν) from the factors."""
        first = dpbtrs(self.factors, right[: self.n], lower=1)[0]
        rest = self.small @ (right[self.n :] - self.rows @ first)
        return np.concatenate([first - self.solved @ rest, rest])

    def _product(self, v: Array) -> Array:
        """Return the matrix times (dx, dp, dν), by its factors: in their product, the band, digits are lost."""
        step, nu = v[: self.n + 1], v[self.n + 1 :]
        dy = (self.splines.matrix @ step[:-1]).reshape(*self.curvature.shape[:3], 1)
        met = self.equations @ step
        product = self.back @ (self.weights * (self.slopes @ step)) + (EQUATIONS * met - nu) @ self.equations
        product[:-1] += self.splines.back @ (self.curvature @ dy).ravel()
        return np.concatenate([product, -met])

    def _refined(self, solution: Array, right: Array) -> Array:
        """Return (dx, dp, dν) by generalised conjugate residuals, led by the factors."""
        missing = right - self._product(solution)
        tried: list[tuple[Array, Array]] = []
        while len(tried) < REFINEMENTS and np.abs(missing).max() > REFINED * np.abs(right).max():
            direction = self._rough(missing)
            product = self._product(direction)
            for other, image in tried:
                along = product @ image
                product, direction = product - along * image, direction - along * other
            length = np.linalg.norm(product)
            if not length > 0.0:
                break
            direction, product = direction / length, product / length
            tried.append((direction, product))
            along = missing @ product
            solution, missing = solution + along * direction, missing - along * product
        return solution

    def step(self, centre: float, mu: float) -> _Step:
        """Return the step to products w z of ``centre``, or nearer to it; ``mu`` their mean."""
        w, z = self.w, self.z
        right, products = self._right(centre - w * z), centre - w * z
        chosen = self._changes(self._rough(right), products)
        if mu > 5.0 * centre:
            _, dw, dz = self._changes(self._rough(self._right(-w * z)), -w * z)
            ahead = (w + _longest(w, dw) * dw) @ (z + _longest(z, dz) * dz) / len(w)
            aim = max((ahead / mu) ** 3 * mu, centre)
            products = aim - w * z - dw * dz
            chosen = self._changes(self._rough(self._right(products)), products)
            low, high = (aim * bound for bound in CENTRAL)
            for _ in range(CORRECTORS):
                _, dw, dz = chosen
                lengths = _longest(w, dw), _longest(z, dz)
                if min(lengths) > 0.9:
                    break
                farther = (min(1.0, far + FARTHER) for far in lengths)
                reached = (w + next(farther) * dw) * (z + next(farther) * dz)
                further = products + np.maximum(np.clip(reached, low, high) - reached, -high)
                other = self._changes(self._rough(self._right(further)), further)
                if _longest(w, other[1]) + _longest(z, other[2]) < sum(lengths) + 0.1 * FARTHER:
                    break
                products, chosen = further, other
        return self._changes(self._refined(chosen[0], self._right(products)), products)

    def _right(self, products: Array) -> Array:
        """Return the right side of Newton's equations for changes of the products w z."""
        by_step = self.back @ ((products - self.z * self.left) / self.w) - self.dual
        return np.concatenate([by_step - EQUATIONS * self.at.e @ self.equations, self.at.e])

    def _changes(self, solution: Array, products: Array) -> _Step:
        dw = self.slopes @ solution[: self.n + 1] + self.left
        return solution, dw, (products - self.z * dw) / self.w
