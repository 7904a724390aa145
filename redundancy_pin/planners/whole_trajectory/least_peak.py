"""Least peak by an interior-point method whose steps are banded systems, in the coefficients of splines.

What IPOPT solves has a dozen unknowns and as many rows a node, for equations and inequalities alike. With the carriers'
coefficients c as unknowns (``splines``) there remain inequalities and, at singular nodes, uᵀ f = 0:

    minimise p + ε ∫ Σ s̈² dt    subject to    −p ≤ τ(c) ≤ p,  limits of s, ṡ and s̈, which are linear in c.

With slacks w and multipliers z a Newton step is (H + Gᵀ (z/w) G) dc = …, as wide as a spline's support, beside a column
for p and rows for uᵀ f. Predictor and corrector are Mehrotra's, without a line search, as in ``solver.PREDICTED``. The
last barrier parameter stays, so that IPOPT can go on from w z = μ: it has the last word on every plan.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from scipy.linalg.lapack import dpbtrf, dpbtrs

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.planners.whole_trajectory.problem import WholeTrajectoryProblem
from redundancy_pin.planners.whole_trajectory.splines import SPLINE, Efforts, EffortsAlong, Inequalities, Splines
from redundancy_pin.planners.whole_trajectory.transcription import REGULARISATION

NEAR, CENTRE = 1e-7, 2.5e-13
"""Sum of all w z at the end over the peak: by so much it is from the least one. But no w z is less than what rounding
leaves of it, which is about IPOPT's last barrier parameter over the nodes."""

EXACT = 1e-8
"""Of equations and dual conditions at the end."""

FEW = 3000
"""Nodes up to which s̈ keeps its digits in the coefficients of a spline."""

MOST = 80
"""Iterations; where it takes more it has wandered."""

SHIFTS = (1e-15, 1e-13, 1e-11, 1e-9)
"""By which fractions of itself the diagonal grows until rounding leaves the matrix positive definite. The steps are
refined with the matrix as it is."""

REFINED, REFINEMENTS = 1e-14, 10
"""What is left of Newton's equations; with 1e-11 rounding makes the iterations a third more."""

CORRECTORS, FARTHER, CENTRAL = 2, 0.3, (0.01, 100.0)
"""Gondzio's correctors for each step (1996), the longer step they aim at, and which products w z, over the mean aimed
at, they leave alone. A third fewer iterations."""

UNKNOWN, KNOWN = (0.3, 0.1), (0.1, 0.03)
"""Least slacks to begin with, of the efforts over the peak and of the limits: where nothing is known, and from the
optimum of a coarser mesh, which takes up to a third fewer iterations."""

EQUATIONS = 1e3
"""Weight of the squares of the equations in the matrix, which keep it positive definite across them."""


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


def serves(problem: WholeTrajectoryProblem) -> bool:
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


@np.errstate(all="ignore")  # what becomes infinite ends it
def least_peak(
    problem: WholeTrajectoryProblem,
    guess: Mapping[str, Array],
    between: BoolArray,
    go_on: Callable[[int, float], bool],
    slacks: tuple[float, float] = UNKNOWN,
) -> LeastPeak | None:
    """Return the course of least peak, or None where the method ends without.

    ``guess``: scaled s, ṡ and s̈ to begin with; ``between`` (M − 1,): steps in which track and speed limits hold
    between the nodes as well; ``go_on``: called before each iteration with its number and the cost, false ends it;
    ``slacks``: the least ones to begin with.
    """
    try:
        return _least_peak(problem, guess, between, go_on, slacks)
    except np.linalg.LinAlgError:  # W is singular, or a matrix of the method to rounding
        return None


def _least_peak(
    problem: WholeTrajectoryProblem,
    guess: Mapping[str, Array],
    between: BoolArray,
    go_on: Callable[[int, float], bool],
    slacks: tuple[float, float],
) -> LeastPeak | None:
    splines = Splines(problem)
    efforts, limits = EffortsAlong(problem, splines.size), Inequalities(problem, splines, between)
    zero = np.zeros((len(problem.grid.t), problem.model.k))
    x = splines.fitted(np.stack([guess.get(name, zero) for name in ("s", "sd", "sdd")], axis=-1))
    half = 0.5 * problem.grid.h
    gentle = 2.0 * REGULARISATION * (np.append(half, 0.0) + np.append(0.0, half)) / problem.scales.duration
    y = splines.course(x)
    at = efforts(y)
    p = float(np.quantile(np.abs(at.tau).max(axis=1), 0.9))
    g = limits(x, p, at.tau)
    of_efforts = np.arange(len(g)) < 2 * limits.efforts
    w = np.maximum(g, np.where(of_efforts, slacks[0] * p, slacks[1]))
    z = np.where(of_efforts, 1.0, w[of_efforts].mean() / w) / (2 * limits.efforts)
    nu = np.zeros(len(at.e))
    for iteration in range(MOST):
        cost = p + 0.5 * float((gentle[:, None] * y[..., 2] ** 2).sum())
        system = NewtonSystem(efforts, limits, gentle, at, y, limits(x, p, at.tau) - w, w, z, nu)
        mu, centre = float(w @ z) / len(w), max(NEAR * p / len(w), CENTRE)
        if system.error <= EXACT and np.abs(w * z - centre).max() <= 0.5 * centre:
            values = {"s": y[..., 0], "sd": y[..., 1], "sdd": y[..., 2], "tau": at.tau}
            return LeastPeak(values, p, centre, cost, iteration)
        if not (np.isfinite(cost) and go_on(iteration, cost) and system.factorise()):
            return None
        step, dw, dz = system.step(centre, mu)
        dx, dp, dnu = step[: splines.count], float(step[splines.count]), step[splines.count + 1 :]
        lengths = _longest(w, dw), _longest(z, dz)
        primal, dual = (1.0 if far == 1.0 else max(0.99, 1.0 - mu) * far for far in lengths)
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


class NewtonSystem:
    """Newton's equations at a point: residuals, the factors, and steps from them. ``left`` is g − w."""

    def __init__(
        self,
        efforts: EffortsAlong,
        limits: Inequalities,
        gentle: Array,
        at: Efforts,
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
        self.error = float(np.abs(np.concatenate([left, at.e, self.dual])).max())

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

    def rough(self, right: Array) -> Array:
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
            direction = self.rough(missing)
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
        products = centre - w * z
        chosen = self._towards(products if mu <= 5.0 * centre else -w * z)
        if mu > 5.0 * centre:
            _, dw, dz = chosen
            ahead = (w + _longest(w, dw) * dw) @ (z + _longest(z, dz) * dz) / len(w)
            aim = max(float(ahead / mu) ** 3 * mu, centre)
            products = aim - w * z - dw * dz
            chosen = self._towards(products)
            low, high = aim * CENTRAL[0], aim * CENTRAL[1]
            for _ in range(CORRECTORS):
                _, dw, dz = chosen
                lengths = _longest(w, dw), _longest(z, dz)
                if min(lengths) > 0.9:
                    break
                farther = (min(1.0, far + FARTHER) for far in lengths)
                reached = (w + next(farther) * dw) * (z + next(farther) * dz)
                further = products + np.maximum(np.clip(reached, low, high) - reached, -high)
                other = self._towards(further)
                if _longest(w, other[1]) + _longest(z, other[2]) < sum(lengths) + 0.1 * FARTHER:
                    break
                products, chosen = further, other
        return self._changes(self._refined(chosen[0], self._right(products)), products)

    def _towards(self, products: Array) -> _Step:
        return self._changes(self.rough(self._right(products)), products)

    def _right(self, products: Array) -> Array:
        """Return the right side of Newton's equations for changes of the products w z."""
        by_step = self.back @ ((products - self.z * self.left) / self.w) - self.dual
        return np.concatenate([by_step - EQUATIONS * self.at.e @ self.equations, self.at.e])

    def _changes(self, solution: Array, products: Array) -> _Step:
        dw = self.slopes @ solution[: self.n + 1] + self.left
        return solution, dw, (products - self.z * dw) / self.w
