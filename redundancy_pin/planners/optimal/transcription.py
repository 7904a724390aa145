"""Direct transcription: the trajectory as a nonlinear programme, in the solver library's expressions.

Unknowns at each node: s, ṡ, s̈ and τ over their sizes; further ones where an objective or a limit needs them. s̈ is
linear between nodes, so that the carriers' motion is integrated exactly by linear equations; W τ = f is quadratic.
Expressions are matrices with a row a node, so that the graph the library differentiates does not grow with the nodes.

Where the time is minimised, the nodes are places p on the path. ṗ and p̈ there and the durations h of the steps are
unknown too, p̈ is linear in a step, and all rows are the same with h an expression in place of a number.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cached_property

import casadi as ca
import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, IntArray, each
from redundancy_pin.dynamics.base import ExactAlongMotion
from redundancy_pin.planners.carrier_model import terms
from redundancy_pin.planners.limits import QUANTITIES
from redundancy_pin.planners.optimal.nlp import NLP, Expression
from redundancy_pin.planners.optimal.objectives import OBJECTIVES, Quantities
from redundancy_pin.planners.optimal.problem import Problem, SingularNode, powers_of, required

RESERVE = 1e-9
"""Fraction of the limits kept in reserve for the rounding of the solver."""

BEYOND = 0.25 * RESERVE
"""Fraction by which a limit on which the carriers start or end is let out: less than what counts as exceeding it."""

LEAST_RANGE = 1e-3
"""Least scaled limit of efforts and forces that gives way by a fraction of itself; smaller ones by one of this."""

VARIABLES = {"track": "s", "speed": "sd", "acceleration": "sdd", "effort": "tau", "carrier_force": "force"}
"""The variable that each of ``QUANTITIES`` limits; others are limited by rows."""

KINDS = ("track", "speed", "acceleration", "jerk", "effort", "carrier_force", "end", "at_most")
"""Limits that an elastic programme relaxes, in addition to further ``QUANTITIES``."""

ELASTIC_OBJECTIVE = 1e-6
"""Weight of the objective relative to the excess fractions of limits: it decides only between equal ones."""

ELASTIC_DURATION = 1e-3
"""The same of the duration, over its size, where that is the objective. Under gravity efforts come near those at rest
as the duration grows: it ends at a few times its size, and what would suffice is 1e-4 to 1e-3 more than at rest."""

REGULARISATION = 1e-5
"""Weight of the mean square of s̈ over its limit, relative to an objective of size one: if the objective does not
determine the carriers, they take the gentlest motion, and the plan is unique. The part of τ that W τ = f leaves
undetermined, over its size, has this weight too: the smallest of equivalent efforts, not the barrier's choice.
It increases the shipped objectives by less than 1e-8 of themselves."""

REGULARISATION_OF_TIME = 1e-3
"""Weight of the mean square of s̈, scaled, relative to the duration, scaled."""

LEAST_STEP = 1e-3
"""Fraction of its size that a step lasts at least."""

PEAK = "largest"
"""With what the names of the copies of a largest value begin."""

SHARED = 8
"""Nodes that share one copy of the peak: one a node is more unknowns, one for all fills the solver's factors."""


def scaled_bounds(problem: Problem, values: Mapping[str, Array] | None = None) -> dict[str, tuple[Array, Array]]:
    """Return lower and upper bounds of ``VARIABLES`` over their sizes, by the limit, a little narrowed.

    ``values``: variables by name, of which the fractions that an elastic programme ended with let the bounds out.
    """
    settings, u = problem.settings, problem.scales
    limits = settings.limits
    (lower, upper), speed = limits.track.T, limits.speed
    width = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    # a start or an end on its limit needs that limit whole, and a little more: the solver needs an interior
    fixed = [settings.start] + ([settings.datum] if settings.end == "datum" else [])
    low_margin, high_margin = (
        np.where(np.min(room, axis=0) <= RESERVE * width, -BEYOND, RESERVE) * width
        for room in ([at - lower for at in fixed], [upper - at for at in fixed])
    )
    at_start = np.abs(settings.start_speed)
    on_limit = (at_start > speed * (1.0 - RESERVE)) & (at_start <= speed)
    most = {kind: limits.of(kind) / getattr(u, name) for kind, name in VARIABLES.items() if kind != "track"}
    most["speed"] = np.where(on_limit, speed * (1.0 + BEYOND + RESERVE), speed) / u.sd
    first = 0
    for kind in ("effort", "carrier_force"):
        count = len(most[kind])
        if problem.shares is not None:
            most[kind] = most[kind] * problem.shares[:, first : first + count]
        # IPOPT ends the process where the bounds of a variable are nearer than rounding
        most[kind], first = np.maximum(most[kind], RESERVE), first + count
    bounds = {kind: (-bound * (1.0 - RESERVE), bound * (1.0 - RESERVE)) for kind, bound in most.items()}
    bounds["track"] = (lower + low_margin) / u.s, (upper - high_margin) / u.s
    for kind, (low, high) in bounds.items():
        if values is not None and slack_name(kind) in values:
            more = float(values[slack_name(kind)][0, 0]) * half_range(kind, low, high)
            bounds[kind] = low - more, high + more
    return bounds


def half_range(kind: str, lower: Array, upper: Array) -> Array:
    """Return half the distance of two scaled bounds, a fraction of which an elastic limit gives way by.

    1 without a bound. Of efforts and forces ``LEAST_RANGE`` at least: a fraction of a much smaller limit, as large as
    these need, is beyond the solver.
    """
    half = np.maximum(0.5 * (upper - lower), LEAST_RANGE if kind in ("effort", "carrier_force") else 0.0)
    return np.where(np.isfinite(half) & (upper > lower), half, 1.0)


class Transcription(Quantities):
    """The programme of a problem while it is put together, and its quantities as expressions.

    In an elastic programme each kind of limit has one fraction e ≥ 0 by which all of its bounds are relaxed.
    """

    def __init__(self, problem: Problem, elastic: Sequence[str]) -> None:
        u = problem.scales
        super().__init__(problem.grid.h, u, problem.target, problem.actuated_rate)
        self.nlp = NLP()
        # The objective is a mean over the nodes. Multiplied by their number, it gives multipliers of size one.
        # Otherwise the barrier, which starts at one size, outweighs the objective of a long plan.
        self.nlp.size = float(len(problem.grid.t))
        self._problem, self._bounds = problem, scaled_bounds(problem)
        self.h: Expression = problem.grid.h[:, None]
        self._pace: tuple[Expression, ...] = ()
        self._slack: dict[str, Expression] = {}
        for kind in elastic:
            self._slack[kind], mean = self._copies(slack_name(kind), len(problem.grid.t))
            self.nlp.cost += mean
        self.s, self.sd, self.sdd = (
            self._variable(kind, problem.model.k) for kind in ("track", "speed", "acceleration")
        )
        self.tau = self._variable("effort", problem.model.W.shape[2])

    def _variable(self, kind: str, columns: int) -> Expression:
        """Add one of ``VARIABLES`` at all nodes within limits, scaled, and return it in its unit."""
        name, shape = VARIABLES[kind], (len(self._problem.grid.t), columns)
        if kind in self._slack:
            block = self.nlp.variable(name, shape)
            self.limit(kind, block, *self._bounds[kind])
        else:
            block = self.nlp.variable(name, shape, *self._bounds[kind])
        return block * _rows(getattr(self.scales, name), shape)

    def _copies(self, name: str, nodes: int) -> tuple[Expression, Expression]:
        """Add copies of one variable ≥ 0, all equal; return the copy for each node (M, 1), and their mean.

        A single variable in every row would fill the solver's factors. The mean gives all copies a slope: the solver
        scales the whole objective by the largest one.
        """
        copies = self.nlp.variable(name, (-(-nodes // SHARED), 1), 0.0)
        self.nlp.within(copies[1:] - copies[:-1])
        return copies[(np.arange(nodes) // SHARED).tolist(), 0], ca.sum1(copies) / copies.shape[0]

    @cached_property
    def force(self) -> Expression:
        """The forces of the carriers' actuators, which become variables once something needs them."""
        model = self._problem.model
        force = self._variable("carrier_force", model.k)
        if self._problem.exact is not None:
            self.equal(force - self._exact[1], np.zeros_like(model.force0), self.scales.force)
            return force
        # each carrier's force depends on its own motion
        own, by_term = np.arange(model.k), np.zeros((len(model.t), model.k, *model.force_terms.shape[1:]))
        by_term[:, own, own] = model.force_terms
        by_carriers, alone = self._sum(model.force0, by_term)
        self.equal(force - by_carriers, alone, self.scales.force)
        return force

    def _sum(self, first: Array, by_term: Array, *motion: Expression) -> tuple[Expression, Array]:
        """Return (M, r) what of a sum depends on unknowns, and what does not.

        ``first`` (M, r) and ``by_term`` (M, r, k, terms) coefficients, with an axis for 1, ṗ, ṗ² and p̈ in the end
        where the time is unknown; ``motion``: s, ṡ, s̈ and, where unknown, ṗ and p̈; those at the nodes when left out.
        """
        s, sd, sdd, *pace = motion or (self.s, self.sd, self.sdd, *self._pace)
        if self._problem.timing is None:
            first, by_term = first[..., None], by_term[..., None]
        powers = powers_of(*pace)
        used = [(first[..., q, None], power) for q, power in enumerate(powers) if q and first[..., q].any()]
        for j, term in enumerate(terms(s, sd, sdd, by_term.shape[3], ca) if s.shape[1] else ()):
            for q, power in enumerate(powers):
                if by_term[..., j, q].any():
                    used.append((by_term[..., j, q], term * power if q else term))
        if not used:
            return ca.DM.zeros(*first.shape[:2]), first[..., 0]
        coefficients, values = zip(*used, strict=True)
        return product(np.concatenate(coefficients, axis=2), ca.horzcat(*values)), first[..., 0]

    @cached_property
    def base_force(self) -> Expression:
        """The components of the force on the base, N, without those that are zero throughout."""
        return self._base[:, np.flatnonzero(self._base_rows < 3).tolist()]

    @cached_property
    def base_moment(self) -> Expression:
        """Those of the moment, N·m."""
        return self._base[:, np.flatnonzero(self._base_rows >= 3).tolist()]

    @property
    def _base_rows(self) -> IntArray:
        base = self._problem.base
        return np.flatnonzero(base.felt if base else [])

    @cached_property
    def _base(self) -> Expression:
        """The wrench on the base as variables (M, r), which only an objective needs."""
        base, at = self._problem.base, self._base_rows
        if base is None:
            raise ValueError("The problem has no base wrench.")
        size = self.scales.base[at]
        wrench = self.nlp.variable("base", (len(base.w0), len(at))) * _rows(size, (len(base.w0), len(at)))
        by_term = np.where(base.changed[at, None, None], base.by_term[:, at], 0.0)
        self.equal(wrench - self._sum(base.w0[:, at], by_term)[0], base.w0[:, at], size)
        return wrench

    def equal(self, expression: Expression, value: Expression, size: Expression) -> None:
        """Require expression = value, over a size."""
        self.nlp.within(expression / _rows(size, expression.shape), value / size, value / size)

    def limit(
        self, kind: str, expression: Expression, lower: Expression, upper: Expression, at: IntArray | None = None
    ) -> None:
        """Keep lower ≤ expression ≤ upper, all of them scaled; in an elastic programme relaxed by its fraction.

        ``at``: the node of each row; 0, 1, 2 and so on when left out.
        """
        if kind not in self._slack:
            self.nlp.within(expression, lower, upper)
            return
        lower, upper = (np.broadcast_to(bound, expression.shape) for bound in (lower, upper))
        half = half_range(kind, lower, upper)
        at = np.arange(expression.shape[0]) if at is None else at
        slack = ca.repmat(self._slack[kind][at.tolist()], 1, expression.shape[1])
        self.nlp.within(expression + half * slack, lower, np.inf)
        self.nlp.within(expression - half * slack, -np.inf, upper)

    def dynamics(self) -> None:
        """Require W τ = f at every node, whatever the rank of W, and its rate at the singular ones."""
        model = self._problem.model
        if self._problem.exact is None:
            f, f0 = self._sum(model.f0, model.f_terms)
        else:
            f, f0 = self._exact[0], np.zeros_like(model.f0)
        self.equal(product(model.W, self.tau) - f, f0, self.scales.row)
        if self._problem.singular:
            self._singular_instants()

    @cached_property
    def _exact(self) -> tuple[Expression, Expression]:
        """Right sides f (M, n) and carrier forces (M, k) at the nodes, as the backend's expressions have them."""
        return loads_of(self._problem.exact, self.s, self.sd, self.sdd)

    def _singular_instants(self) -> None:
        """Require uᵀ Ẇ τ = uᵀ ḟ, see ``problem``; uᵀ f = 0 follows from W τ = f at the node.

        Along a path the rates of the coefficients are those by p, and ṗ times these are those by time.
        """
        problem = self._problem
        # one row for each lost direction u
        nodes = [node for node in problem.singular for _ in node.lost]
        u = np.concatenate([node.lost for node in problem.singular])
        at = np.array([node.index for node in nodes])
        # both steps at a node have one jerk, except where the reference jumps: there each node has a step of its own
        h = problem.grid.h
        step = np.array([i if i < len(h) and h[i] > 0.0 else i - 1 for i in at])

        def along_u(values: Array) -> Array:
            projected: Array = np.einsum("ri,ri...->r...", u, values)[:, None]
            return projected

        W, f0, f_terms = (
            along_u(np.concatenate([getattr(node.rate, name) for node in nodes])) for name in ("W", "f0", "f_terms")
        )
        motion = [x[at, :] for x in (self.s, self.sd, self.sdd, *self._pace)]
        # the rates of all of these
        jerks = [(x[step + 1, :] - x[step, :]) / self.h[step, :] for x in (self.sdd, *self._pace[1:])]
        rates = [motion[1], motion[2], jerks[0], *motion[4:], *jerks[1:]]
        symbols, rate_symbols = ([ca.MX.sym("x", *x.shape) for x in motion] for _ in range(2))
        if problem.exact is None:
            f, _ = self._sum(along_u(problem.model.f0[at]), along_u(problem.model.f_terms[at]), *symbols)
            by_place, alone = self._sum(f0, f_terms, *symbols)
            by_place += alone
        else:
            f, by_place = (ca.vertcat(*rows) for rows in zip(*self._exact_at(nodes, u, *symbols), strict=True))
        speed = symbols[3] if self._pace else 1.0
        f_dot = ca.Function(
            "f_dot",
            [*symbols, *rate_symbols],
            [by_place * speed + ca.jtimes(f, ca.horzcat(*symbols), ca.horzcat(*rate_symbols))],
        )
        left = product(W, self.tau[at, :]) * (motion[3] if self._pace else 1.0)
        size = self.scales.tau * np.maximum(np.abs(W).max(axis=2), np.finfo(float).tiny)
        self.equal(left - f_dot(*motion, *rates), 0.0, size * (problem.timing.speed if problem.timing else 1.0))

    @staticmethod
    def _exact_at(nodes: Sequence[SingularNode], u: Array, *motion: Expression) -> list[tuple[Expression, Expression]]:
        """Return uᵀ f and its time derivative at fixed carriers, for each row of the carriers' motion."""
        loads = []
        for row, (node, lost) in enumerate(zip(nodes, u, strict=True)):
            if node.exact is None:
                raise ValueError("A singular node has no expressions.")
            here, beside, weights = node.exact
            one = [part[row, :] for part in motion]
            around = loads_of(beside, *(ca.repmat(part, len(weights), 1) for part in one))[0]
            loads.append((loads_of(here, *one)[0] @ lost, ca.mtimes(ca.DM(weights).T, around) @ lost))
        return loads

    def motion(self) -> None:
        """Integrate s̈, which is linear in a step, so that ṡ is quadratic and s cubic; keep jerks, start and end."""
        settings, u = self._problem.settings, self.scales
        self._integrate(self.s, self.sd, self.sdd, (u.s, u.sd, u.sdd))
        limited = np.flatnonzero(np.isfinite(settings.limits.jerk))
        if len(limited):
            change = self.nlp.blocks["sdd"][1:, limited.tolist()] - self.nlp.blocks["sdd"][:-1, limited.tolist()]
            most = self.h * np.broadcast_to((settings.limits.jerk / u.sdd)[limited], change.shape)
            steps = np.flatnonzero(self._problem.grid.h).tolist()
            jumps = np.flatnonzero(self._problem.grid.h == 0.0).tolist()
            self.limit("jerk", change[steps, :], -most[steps, :], most[steps, :], np.array(steps))
            self.nlp.within(change[jumps, :])  # no limit of the jerk, however wide, lets s̈ jump
        self._start()
        first, last = ({name: self.nlp.blocks[name][i, :] for name in ("s", "sd", "sdd")} for i in (0, -1))
        if settings.end in ("rest", "datum"):
            self.limit("end", last["sd"], 0.0, 0.0)
        if settings.end == "datum":
            self.limit("end", last["s"], settings.datum[None] / u.s, settings.datum[None] / u.s)
        if settings.end == "periodic":
            for name in first:
                self.limit("end", last[name] - first[name], 0.0, 0.0)

    def _integrate(
        self, y: Expression, yd: Expression, ydd: Expression, sizes: tuple[Expression, Expression, Expression]
    ) -> None:
        """Integrate ÿ, which is linear in a step, exactly; the jerk is the same on both sides of smooth nodes."""
        if not y.shape[1]:
            return
        grid, h = self._problem.grid, self.h
        # the nodes at both ends of each step
        y0, y1, yd0, yd1, ydd0, ydd1 = (part for x in (y, yd, ydd) for part in (x[:-1, :], x[1:, :]))
        self.equal(y0 + h * yd0 + h**2 / 6.0 * (2.0 * ydd0 + ydd1) - y1, 0.0, sizes[0])
        self.equal(yd0 + h / 2.0 * (ydd0 + ydd1) - yd1, 0.0, sizes[1])
        at = np.flatnonzero(grid.smooth)
        # over the size of both steps, so that the row has the size of ÿ
        usual = (grid.h if self._problem.timing is None else self._problem.timing.h)[:, None]
        before, after = (h[i, :] / (usual[at - 1] + usual[at]) for i in (at - 1, at))
        self.equal(after * ydd[at - 1, :] + before * ydd[at + 1, :] - (before + after) * ydd[at, :], 0.0, sizes[2])

    def _start(self) -> None:
        """Constrain position and speed of the carriers at the start, if given."""
        settings, u = self._problem.settings, self.scales
        if settings.begin == "datum":
            self.equal(self.s[0, :], settings.start[None], u.s)
        if settings.begin != "free":
            self.equal(self.sd[0, :], settings.start_speed[None], u.sd)

    def further_limits(self) -> None:
        """Keep the limits of further ``QUANTITIES`` at the nodes."""
        problem, limits = self._problem, self._problem.settings.limits
        first = 0
        for key, joints in limits.evaluated().items():
            columns = slice(first, first + len(joints))
            first += len(joints)
            if key in limits.further and len(joints):
                share = 1.0 if problem.shares is None else problem.shares[:, columns]
                used = QUANTITIES[key].values(self)[:, joints.tolist()]
                most = (1.0 - RESERVE) * share * np.ones(used.shape)
                self.limit(key, used / _rows(limits.of(key)[joints], used.shape), -most, most)

    def limits_between_nodes(self, steps: BoolArray) -> None:
        """Keep track and speed limits inside some of the steps, (M − 1,).

        ṡ is quadratic and s cubic in a step: each lies in the hull of its Bézier points, of which the inner ones are
        added here.
        """
        at = np.flatnonzero(steps & (self._problem.grid.h > 0.0))
        h = self.h[at, :]
        if not self.s.shape[1]:
            return
        for kind, inner in (
            ("speed", self.sd[at, :] + h / 2.0 * self.sdd[at, :]),
            ("track", self.s[at, :] + h / 3.0 * self.sd[at, :]),
            ("track", self.s[at + 1, :] - h / 3.0 * self.sd[at + 1, :]),
        ):
            size = _rows(getattr(self.scales, VARIABLES[kind]), inner.shape)
            self.limit(kind, inner / size, *self._bounds[kind], at)

    def objective(self) -> None:
        """Add the weighted objectives over their common size, bounds of objectives, and the regularisation."""
        settings = self._problem.settings
        terms = [(weight, OBJECTIVES[name]) for name, weight in settings.objective.items()]
        size = sum(weight * term.size_of(self.scales) for weight, term in terms)
        values = {name: OBJECTIVES[name].value(self) for name in {**settings.objective, **settings.at_most}}
        for name, bound in settings.at_most.items():
            self.limit("at_most", values[name] / bound, -np.inf, 1.0)
        cost = sum(weight * values[name] for name, weight in settings.objective.items()) / size
        gentle = self.integral(self.nlp.blocks["sdd"] ** 2) / self.scales.duration
        cost += REGULARISATION * (gentle + self._open_efforts())
        self.nlp.cost += (ELASTIC_OBJECTIVE if self._slack else 1.0) * cost

    def _open_efforts(self) -> Expression:
        """Return the mean square of the part δ of the efforts with W δ = 0, over their sizes.

        Without it the efforts have the least Σ (τ_j / size_j)². At a singular node uᵀ Ẇ δ = 0 holds as well.
        """
        model, sizes = self._problem.model, self.scales.efforts
        n, m = model.W.shape[1:]
        if m <= n:
            return 0.0
        directions = np.linalg.svd(model.W / self.scales.row[:, None] * sizes)[2][:, n:]
        for node in self._problem.singular:
            rows = np.concatenate([model.W[node.index] / self.scales.row[:, None], node.lost @ node.rate.W[0]]) * sizes
            rows /= np.maximum(np.linalg.norm(rows, axis=1, keepdims=True), np.finfo(float).tiny)
            directions[node.index] = np.linalg.svd(rows)[2][n:]
        squares = product(directions, self.tau / _rows(sizes, self.tau.shape)) ** 2
        return ca.sum1(ca.sum2(squares)) / len(model.t)

    def absolute(self, values: Expression, size: ArrayLike) -> Expression:
        """Bound |values| by variables."""
        bound = self.nlp.variable(f"absolute_{len(self.nlp.blocks)}", values.shape, 0.0)
        rows = _rows(_sizes(values, size), values.shape)
        for sign in (1.0, -1.0):
            self.nlp.within(bound - sign * values / rows, 0.0, np.inf)
        return rows * bound

    def largest(self, values: Expression, size: ArrayLike) -> Expression:
        """Bound all |values| by one variable, of which there is a copy every few nodes."""
        copies, mean = self._copies(f"{PEAK}_{len(self.nlp.blocks)}", values.shape[0])
        top = ca.repmat(copies, 1, values.shape[1])
        rows = _rows(_sizes(values, size), values.shape)
        for sign in (1.0, -1.0):
            self.nlp.within(sign * values / rows - top, -np.inf, 0.0)
        return mean if np.ndim(size) else size * mean


class PathTranscription(Transcription):
    """The programme of least time along a path: the carriers' rows as they are, with the steps' durations unknown."""

    def __init__(self, problem: Problem, elastic: Sequence[str]) -> None:
        super().__init__(problem, elastic)
        timing, nodes = required(problem.timing), len(problem.grid.t)
        fastest = timing.fastest / timing.speed * (1.0 - RESERVE)
        if problem.shares is not None:  # the last columns are the actuators' rates
            rates = len(problem.settings.limits.evaluated()["actuator_speed"])
            fastest = fastest * problem.shares[:, problem.shares.shape[1] - rates :].min(axis=1, initial=1.0)
        if not problem.settings.lap:
            fastest[[0, -1]] = 0.0
        self._pace = (
            self.nlp.variable("pd", (nodes, 1), 0.0, fastest[:, None]) * timing.speed,
            self.nlp.variable("pdd", (nodes, 1)) * timing.acceleration,
        )
        self.actuated_rate *= self._pace[0]
        moving = (problem.grid.h > 0.0)[:, None]
        bounds = np.where(moving, LEAST_STEP, 0.0), np.where(moving, np.inf, 0.0)
        self.h = self.nlp.variable("h", (nodes - 1, 1), *bounds) * timing.h[:, None]

    def motion(self) -> None:
        """Integrate p̈ and s̈; a lap ends as it began, and the platform never runs back."""
        grid, timing, (pd, pdd) = self._problem.grid, required(self._problem.timing), self._pace
        distance = np.where(grid.h > 0.0, grid.h, 1.0)[:, None]
        self._integrate(ca.DM(grid.t), pd, pdd, (distance, timing.speed, timing.acceleration))
        if self._problem.settings.lap:
            for block in (self.nlp.blocks["pd"], self.nlp.blocks["pdd"]):
                self.nlp.within(block[-1, :] - block[0, :])
        self.nlp.within((pd[:-1, :] + self.h / 2.0 * pdd[:-1, :]) / timing.speed, 0.0, np.inf)
        super().motion()

    def objective(self) -> None:
        """Add the duration over its size, and the regularisation."""
        gentle = ca.sumsqr(self.nlp.blocks["sdd"]) / (max(self._problem.model.k, 1) * self.nlp.size)
        duration: Expression = ca.sum1(self.h)
        cost = duration / self.scales.duration + REGULARISATION_OF_TIME * gentle + REGULARISATION * self._open_efforts()
        self.nlp.cost += (ELASTIC_DURATION if self._slack else 1.0) * cost


class Evaluation(Quantities):
    """The quantities as numbers, of scaled variables by name; ``h``: steps in place of the problem's, s."""

    def __init__(self, problem: Problem, values: Mapping[str, Array], h: Array | None = None) -> None:
        super().__init__(problem.grid.h if h is None else h, problem.scales, problem.target, problem.actuated_rate)
        for name, value in values.items():
            if name in VARIABLES.values():
                setattr(self, name, ca.DM(value * getattr(problem.scales, name)))
        if problem.timing is not None and "pd" in values:
            self.actuated_rate *= ca.DM(values["pd"] * problem.timing.speed)
        if problem.base is not None:
            wrench = problem.base(problem.carriers(values))
            self.base_force, self.base_moment = ca.DM(wrench[:, :3]), ca.DM(wrench[:, 3:])

    def absolute(self, values: Expression, size: ArrayLike) -> Expression:
        """Return |values|."""
        return ca.fabs(values)

    def largest(self, values: Expression, size: ArrayLike) -> Expression:
        """Return the largest |value|, or fraction of a size."""
        if isinstance(size, (np.ndarray, list, tuple)) and np.ndim(size):
            values = values / _rows(_sizes(values, size), values.shape)
        return ca.mmax(ca.fabs(values))


def objective_values(problem: Problem, values: Mapping[str, Array]) -> dict[str, float]:
    """Return each weighted or bounded objective at the nodes, in its unit, from scaled variables by name."""
    quantities = Evaluation(problem, values)
    named = {**problem.settings.objective, **problem.settings.at_most}
    return {name: float(OBJECTIVES[name].value(quantities)) for name in named}


def objective_sizes(problem: Problem) -> dict[str, float]:
    """Return the size that each weighted or bounded objective is divided by, in its unit."""
    named = {**problem.settings.objective, **problem.settings.at_most}
    return {name: OBJECTIVES[name].size_of(problem.scales) for name in named}


def transcribe(
    problem: Problem, elastic: Sequence[str] = (), between: BoolArray | None = None, limit_force: bool = True
) -> NLP:
    """Return the programme of a problem.

    ``elastic``: kinds of limits (``KINDS``) that may be exceeded, at a price, to find out which of them are in the way;
    ``between`` (M − 1,): steps in which track and speed limits hold between the nodes as well; all when left out;
    ``limit_force``: whether the limits of the carriers' forces are enforced.
    """
    programme = (Transcription if problem.timing is None else PathTranscription)(problem, elastic)
    programme.nlp.rows = {"elastic": tuple(elastic), "between": between, "limit_force": limit_force}
    programme.motion()
    programme.dynamics()
    if limit_force and np.isfinite(problem.settings.limits.carrier_force).any():
        programme.force  # noqa: B018 # adds the forces as variables within their limits
    programme.further_limits()
    programme.objective()
    programme.limits_between_nodes(np.ones(len(problem.grid.h), dtype=bool) if between is None else between)
    return programme.nlp


def slack_name(kind: str) -> str:
    """Return the name of the variables by which a kind of limit gives way."""
    return f"slack_{kind}"


def loads_of(
    along: ExactAlongMotion | None, s: Expression, sd: Expression, sdd: Expression
) -> tuple[Expression, Expression]:
    """Return f (N, n) and carrier forces (N, k) as expressions of the carriers' motion, (N, k) each."""
    if along is None:
        raise ValueError("The problem has no expressions.")
    f, force = along.expressions(s.T, sd.T, sdd.T)
    return f.T, force.T


def product(coefficients: Array, values: Expression) -> Expression:
    """Return (M, r) the products of (M, r, c) matrices and the (M, c) rows of an expression."""
    # zeros are dropped, for they would be entries of the Jacobian
    return ca.horzcat(*(ca.sum2(ca.sparsify(ca.DM(row)) * values) for row in np.moveaxis(coefficients, 1, 0)))


def _sizes(values: Expression, size: ArrayLike) -> Array:
    """Return (c,) a size for each column of values, given as such or as one number."""
    return each(size, "size", (values.shape[1],), above_zero=True, finite=True)


def _rows(size: ArrayLike, shape: tuple[int, int]) -> Expression:
    """Return a size for each column as a matrix with equal rows (columns the library broadcasts by itself)."""
    size = np.asarray(size)
    if not size.size:
        return 1.0
    # one number, as where all carriers have one limit, is handed over twenty times faster
    return float(size.flat[0]) if np.all(size == size.flat[0]) else np.broadcast_to(size, shape)
