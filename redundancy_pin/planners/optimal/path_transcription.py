"""The programme of least time: p̈ and s̈ are linear in a step, and the durations of the steps are unknown."""

from __future__ import annotations

from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.planners.carrier_model import terms
from redundancy_pin.planners.optimal.nlp import NLP, casadi
from redundancy_pin.planners.optimal.path_problem import POWERS, TimeOptimalProblem
from redundancy_pin.planners.optimal.transcription import RESERVE, product

REGULARISATION = 1e-3
"""Weight of the mean squares of s̈ and p̈ over their sizes beside the duration over its own."""

LEAST_STEP = 1e-3
"""Of its first guess, that a step may last."""


def transcribe(problem: TimeOptimalProblem, between: BoolArray) -> NLP:
    """Return the programme; track and speed limits hold inside the steps ``between``, (M − 1,), as well."""
    return _Programme(problem, between).nlp


class _Programme:
    def __init__(self, problem: TimeOptimalProblem, between: BoolArray) -> None:
        ca, u, limits = casadi(), problem.sizes, problem.limits
        self.nlp, self._problem = NLP(), problem
        self.nlp.size = float(len(problem.grid.t))
        nodes, k, m = len(problem.grid.t), problem.model.k, problem.model.W.shape[2]
        keep = 1.0 - RESERVE
        edge = np.zeros((nodes, 1), dtype=bool)
        edge[[0, -1]] = not problem.lap
        of_effort, self._of_force, of_speed = problem.parts
        fastest = np.where(edge, 0.0, of_speed * problem.fastest[:, None] / u.speed * keep)
        at_rest = np.zeros((nodes, 1))
        variable = self.nlp.variable
        self.pd = variable("pd", (nodes, 1), at_rest, fastest) * u.speed
        self.pdd = variable("pdd", (nodes, 1)) * u.acceleration
        lower, upper = limits.track.T
        width = upper - lower
        margin = RESERVE * np.where(np.isfinite(width), width, 0.0)
        self._bounds = {
            "s": ((lower + margin) / u.s, (upper - margin) / u.s),
            "sd": (-limits.speed / u.sd * keep, limits.speed / u.sd * keep),
            "sdd": (-limits.acceleration / u.sdd * keep, limits.acceleration / u.sdd * keep),
        }
        self.s, self.sd, self.sdd = (
            variable(name, (nodes, k), *self._bounds[name]) * ca.repmat(ca.DM(getattr(u, name)).T, nodes, 1)
            for name in ("s", "sd", "sdd")
        )
        most = of_effort * limits.effort / u.tau * keep
        self.tau = variable("tau", (nodes, m), -most, most) * u.tau
        moving = (problem.grid.h > 0.0)[:, None]
        self.h = variable("h", (nodes - 1, 1), np.where(moving, LEAST_STEP, 0.0), np.where(moving, np.inf, 0.0))
        self.h = self.h * u.h[:, None]
        self._motion()
        self._ends()
        self._dynamics()
        self._forces()
        self._between(between)
        blocks = self.nlp.blocks
        gentle = ca.sumsqr(blocks["sdd"]) / max(k, 1)
        self.nlp.cost = ca.sum1(self.h) / u.duration + REGULARISATION / nodes * gentle

    def _equal(self, expression: Any, size: Array | float) -> None:
        shape = expression.shape
        self.nlp.within(expression / np.broadcast_to(size, shape) if shape[1] else expression)

    def _motion(self) -> None:
        """Integrate p̈ and s̈ exactly; across smooth nodes the jerks are the same on both sides."""
        ca, u, grid, h = casadi(), self._problem.sizes, self._problem.grid, self.h
        place = ca.DM(grid.t)
        for y, yd, ydd, size in (
            (place, self.pd, self.pdd, (1.0, u.speed, u.acceleration)),
            (self.s, self.sd, self.sdd, (u.s, u.sd, u.sdd)),
        ):
            if not y.shape[1]:
                continue
            step = ca.repmat(h, 1, y.shape[1])
            covered = step * yd[:-1, :] + step**2 / 6.0 * (2.0 * ydd[:-1, :] + ydd[1:, :])
            distance = np.where(grid.h > 0.0, grid.h, 1.0)[:, None] if y is place else size[0]
            self._equal(y[:-1, :] + covered - y[1:, :], distance)
            self._equal(yd[:-1, :] + step / 2.0 * (ydd[:-1, :] + ydd[1:, :]) - yd[1:, :], size[1])
            at = np.flatnonzero(grid.smooth)
            if len(at):
                before, after = (ca.repmat(h[i.tolist(), :] / u.h[i][:, None], 1, y.shape[1]) for i in (at - 1, at))
                ratio = np.repeat((u.h[at] / u.h[at - 1])[:, None], y.shape[1], axis=1)
                now = ydd[at.tolist(), :]
                earlier, later = ydd[(at - 1).tolist(), :], ydd[(at + 1).tolist(), :]
                self._equal(ratio * after * (now - earlier) - before * (later - now), size[2])
        jerk = self._problem.limits.jerk
        if np.isfinite(jerk).any():
            most = ca.repmat(h, 1, len(jerk)) * np.broadcast_to(jerk / u.sdd, (len(u.h), len(jerk)))
            change = (self.sdd[1:, :] - self.sdd[:-1, :]) / np.broadcast_to(u.sdd, (len(u.h), len(jerk)))
            self.nlp.within(change - most, -np.inf, 0.0)
            self.nlp.within(change + most, 0.0, np.inf)

    def _ends(self) -> None:
        problem, blocks = self._problem, self.nlp.blocks
        for how, i in ((problem.begin, 0), (problem.end, -1)):
            if how in ("rest", "datum"):
                self.nlp.within(blocks["sd"][i, :])
            if how == "datum":
                park = (problem.datum / problem.sizes.s)[None]
                self.nlp.within(blocks["s"][i, :], park, park)
        names = [*(("pd", "pdd") if problem.lap else ()), *(("s", "sd", "sdd") if problem.end == "periodic" else ())]
        for name in names:
            self.nlp.within(blocks[name][-1, :] - blocks[name][0, :])

    def _dynamics(self) -> None:
        problem = self._problem
        f, f0 = self._sum(problem.model.f0, problem.model.f_terms)
        size = np.broadcast_to(problem.sizes.row, f0.shape)
        self.nlp.within((product(problem.model.W, self.tau) - f) / size, f0 / size, f0 / size)
        for node in problem.singular:
            for u in node.lost:
                self._singular(node.index, u, node.rate)

    def _sum(self, first: Array, by_term: Array) -> tuple[Any, Array]:
        """Return (M, r) what depends on unknowns, and what does not, of coefficients (M, r, 4) and (M, r, k, c, 4)."""
        motion = (self.pd, self.pdd, self.s, self.sd, self.sdd)
        return _sum(first, by_term, *motion), first[..., 0]

    def _singular(self, i: int, u: Array, rate: Any) -> None:
        """Require uᵀ W' ṗ τ = uᵀ ḟ, see ``optimal.problem``; derivatives by p times ṗ are those by time."""
        ca, problem = casadi(), self._problem
        k, h = problem.model.k, problem.grid.h
        step = i if i < len(h) and h[i] > 0.0 else i - 1
        symbols = [ca.MX.sym(name, 1, columns) for name, columns in zip("vasde", (1, 1, k, k, k), strict=True)]

        def along_u(model: Any, at: int) -> Any:
            first, by_term = (
                np.einsum("i,i...->...", u, getattr(model, name)[at])[None, None] for name in ("f0", "f_terms")
            )
            return _sum(first, by_term, *symbols) + float(first[0, 0, 0])

        f, by_place = along_u(problem.model, i), along_u(rate, 0)
        jerk, jerk_p = ((x[step + 1, :] - x[step, :]) / self.h[step] for x in (self.sdd, self.pdd))
        v, a, s, sd, sdd = (x[i, :] for x in (self.pd, self.pdd, self.s, self.sd, self.sdd))
        rates = [ca.MX.sym(name, 1, columns) for name, columns in zip("fghij", (1, 1, k, k, k), strict=True)]
        carried = ca.jtimes(f, ca.horzcat(*symbols), ca.horzcat(*rates))
        f_dot = ca.Function("f_dot", [*symbols, *rates], [by_place * symbols[0] + carried])
        turning = u @ rate.W[0]
        size = problem.sizes.tau * problem.sizes.speed * max(float(np.abs(turning).max()), np.finfo(float).tiny)
        left = v * ca.mtimes(self.tau[i, :], ca.DM(turning))
        self.nlp.within((left - f_dot(v, a, s, sd, sdd, a, jerk_p, sd, sdd, jerk)) / size)

    def _forces(self) -> None:
        """Keep the limits of the carriers' forces."""
        problem, most = self._problem, self._problem.limits.carrier_force
        if not np.isfinite(most).any():
            return
        model, ca = problem.model, casadi()
        powers = {1: self.pd, 2: self.pd**2, 3: self.pdd}
        force: Any = ca.DM(model.force0[..., 0])
        for q in range(1, POWERS):
            force += model.force0[..., q] * ca.repmat(powers[q], 1, model.k)
        for j, term in enumerate(terms(self.s, self.sd, self.sdd, model.force_terms.shape[2], ca)):
            for q in range(POWERS):
                if model.force_terms[:, :, j, q].any():
                    force += model.force_terms[:, :, j, q] * term * (ca.repmat(powers[q], 1, model.k) if q else 1.0)
        bound = np.where(np.isfinite(most), (1.0 - RESERVE) * self._of_force, np.inf)
        self.nlp.within(force / np.broadcast_to(most, force.shape), -bound, bound)

    def _between(self, steps: BoolArray) -> None:
        """Keep the platform from running back, and track and speed limits inside steps, by inner Bézier points."""
        inner = (self.pd[:-1, :] + self.h / 2.0 * self.pdd[:-1, :]) / self._problem.sizes.speed
        self.nlp.within(inner, 0.0, np.inf)
        at = np.flatnonzero(steps & (self._problem.grid.h > 0.0)).tolist()
        if not at or not self.s.shape[1]:
            return
        after = [i + 1 for i in at]
        h = casadi().repmat(self.h[at, :], 1, self.s.shape[1])
        for name, inner in (
            ("sd", self.sd[at, :] + h / 2.0 * self.sdd[at, :]),
            ("s", self.s[at, :] + h / 3.0 * self.sd[at, :]),
            ("s", self.s[after, :] - h / 3.0 * self.sd[after, :]),
        ):
            size = np.broadcast_to(getattr(self._problem.sizes, name), inner.shape)
            self.nlp.within(inner / size, *self._bounds[name])


def _sum(first: Array, by_term: Array, pd: Any, pdd: Any, s: Any, sd: Any, sdd: Any) -> Any:
    """Return (M, r) the sums of terms that hold unknowns, of coefficients (M, r, 4) and (M, r, k, c, 4)."""
    ca, k = casadi(), by_term.shape[2]
    powers = {1: pd, 2: pd**2, 3: pdd}
    coefficients, values = [], []
    for q in range(1, POWERS):
        if first[..., q].any():
            coefficients.append(first[..., q][..., None])
            values.append(powers[q])
    for j, term in enumerate(terms(s, sd, sdd, by_term.shape[3], ca) if k else ()):
        for q in range(POWERS):
            if by_term[..., j, q].any():
                coefficients.append(by_term[..., j, q])
                values.append(term * ca.repmat(powers[q], 1, k) if q else term)
    if not values:
        return ca.DM.zeros(*first.shape[:2])
    return product(np.concatenate(coefficients, axis=2), ca.horzcat(*values))
