"""The programme of a whole trajectory: exact coefficients of f, limits, ends and singular instants as sparse algebra.

Variables at each node: s, ṡ, s̈ and τ over their sizes; further ones where an objective or a limit needs them. s̈ is
linear between nodes, so that the carriers' motion is integrated exactly by linear equations; W τ = f is quadratic.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.planners.whole_trajectory.problem import WholeProblem
from redundancy_pin.planners.whole_trajectory.program import Program

RESERVE = 1e-9
"""Fraction of the limits kept in reserve for the rounding of the solver."""

BEYOND = 0.25 * RESERVE
"""Fraction by which a limit on which the carriers start or end is let out: less than what counts as exceeding it."""

ELASTIC_PRICE = 1.0
"""Of exceeding a limit by all of itself; beside it the objective counts as ``ELASTIC_OBJECTIVE``."""

ELASTIC_OBJECTIVE = 1e-6
"""Weight of the objective in an elastic problem: it decides only between equal excesses."""

KINDS = ("track", "speed", "acceleration", "jerk", "effort", "force", "end")
"""Limits that an elastic problem lets go."""

_KIND_OF = {"s": "track", "sd": "speed", "sdd": "acceleration", "tau": "effort", "force": "force"}


def slack_name(kind: str) -> str:
    """Return the name of the block of variables by which a kind of limit gives way."""
    return f"slack_{kind}"


class Limiter:
    """Adds variables within their limits, and the other limits, to a programme.

    In an elastic problem each kind of limit has one fraction e ≥ 0 by which all of its bounds are let out.
    """

    def __init__(self, program: Program, problem: WholeProblem, elastic: tuple[str, ...]) -> None:
        self._program, self._problem = program, problem
        self._bounds = scaled_bounds(problem)
        self._slack: dict[str, IntArray] = {}
        self.price = ELASTIC_OBJECTIVE if elastic else 1.0
        for kind in elastic:
            # one copy a node, all equal: a single variable in every row would fill the solver's factors
            slack = program.variable(slack_name(kind), (len(problem.grid.t),), 0.0)
            same = program.rows((len(slack) - 1,))
            program.add(same, slack[1:], 1.0)
            program.add(same, slack[:-1], -1.0)
            program.charge(slack[:1], ELASTIC_PRICE)
            self._slack[kind] = slack

    @property
    def limits_force(self) -> bool:
        """Whether any carrier's force is limited."""
        return bool(np.isfinite(self._bounds["force"]).any())

    def variable(self, name: str, shape: tuple[int, ...]) -> IntArray:
        """Add s, ṡ, s̈, τ or the carriers' force at all nodes, within their limits."""
        low, high = self._bounds[name]
        if _KIND_OF[name] not in self._slack:
            return self._program.variable(name, shape, low, high)
        block = self._program.variable(name, shape)
        self._within([(block, np.ones(1))], low, high, _KIND_OF[name])
        return block

    def jerk(self, A: IntArray) -> None:
        """Keep the jerk, which is constant in a step."""
        grid, jerk = self._problem.grid, self._problem.settings.jerk
        if np.isfinite(jerk).any():
            most = grid.h[:, None] * jerk / self._problem.scales.sdd
            self._within([(A[1:], 1.0), (A[:-1], -1.0)], -most, most, "jerk")

    def between_nodes(self, S: IntArray, V: IntArray, A: IntArray, steps: BoolArray) -> None:
        """Keep track and speed between the nodes, in some of the steps.

        ṡ is quadratic and s cubic in a step: each lies in the hull of its Bézier points, of which the inner ones are
        added here.

        Args:
            S: (M, k) variables s.
            V: (M, k) variables ṡ.
            A: (M, k) variables s̈.
            steps: (M − 1,) in which steps.
        """
        grid, u = self._problem.grid, self._problem.scales
        at = np.flatnonzero(steps & (grid.h > 0.0))
        h = grid.h[at, None]
        self._within([(V[at], 1.0), (A[at], h * u.sdd / u.sd / 2.0)], *self._bounds["sd"], "speed")
        reach = h * u.sd / u.s / 3.0
        self._within([(S[at], 1.0), (V[at], reach)], *self._bounds["s"], "track")
        self._within([(S[at + 1], 1.0), (V[at + 1], -reach)], *self._bounds["s"], "track")

    def end(self, S: IntArray, V: IntArray, A: IntArray) -> None:
        """Fix the end as asked."""
        settings, u = self._problem.settings, self._problem.scales
        zero = np.zeros(self._problem.model.k)
        if settings.end in ("rest", "datum"):
            self._within([(V[-1], 1.0)], zero, zero, "end")
        if settings.end == "datum":
            self._within([(S[-1], 1.0)], settings.datum / u.s, settings.datum / u.s, "end")
        if settings.end == "periodic":
            for block in (S, V, A):
                self._within([(block[-1], 1.0), (block[0], -1.0)], zero, zero, "end")

    def _within(self, parts: list[tuple[IntArray, Array | float]], low: Array, high: Array, kind: str) -> None:
        """Add low ≤ Σ coefficient · x ≤ high where a bound is finite."""
        shape = parts[0][0].shape
        low, high = np.broadcast_to(low, shape), np.broadcast_to(high, shape)
        bounded = np.isfinite(low) | np.isfinite(high)
        if not bounded.any():
            return
        pieces = [(block[bounded], np.broadcast_to(factor, shape)[bounded]) for block, factor in parts]
        lower, upper = low[bounded], high[bounded]
        if kind not in self._slack:
            self._fill(self._program.rows(lower.shape, lower, upper), pieces)
            return
        own = self._slack[kind]
        slack = np.broadcast_to(own[: shape[0], None], shape)[bounded] if len(shape) > 1 else own[-1]
        half = np.where(np.isfinite(upper - lower) & (upper > lower), 0.5 * (upper - lower), 1.0)
        for bounds, sign in (((lower, np.inf), 1.0), ((-np.inf, upper), -1.0)):
            rows = self._program.rows(lower.shape, *bounds)
            self._fill(rows, pieces)
            self._program.add(rows, slack, sign * half)

    def _fill(self, rows: IntArray, pieces: list[tuple[IntArray, Array]]) -> None:
        for variables, coefficient in pieces:
            self._program.add(rows, variables, coefficient)


def scaled_bounds(problem: WholeProblem) -> dict[str, tuple[Array, Array]]:
    """Return lower and upper bounds of s, ṡ, s̈, τ and the carriers' force over their sizes, a little narrowed."""
    limits, u = problem.settings.limits, problem.scales
    lower, upper = (np.array([getattr(bound, side) for bound in limits]) for side in ("lower", "upper"))
    finite = np.isfinite(lower) & np.isfinite(upper)
    width = np.where(finite, upper - lower, 0.0)
    # a start or an end on its limit needs that limit whole, and a little more: the solver needs an interior
    fixed = [problem.settings.start] + ([problem.settings.datum] if problem.settings.end == "datum" else [])
    low_margin, high_margin = (
        np.where(np.min(room, axis=0) <= RESERVE * width, -BEYOND, RESERVE) * width
        for room in ([at - lower for at in fixed], [upper - at for at in fixed])
    )
    speed, acceleration, force = (
        np.array([getattr(bound, name) for bound in limits]) for name in ("speed", "acceleration", "force")
    )
    found = {"s": ((lower + low_margin) / u.s, (upper - high_margin) / u.s)}
    at_start = np.abs(problem.settings.start_speed)
    speed = np.where(
        (at_start > speed * (1.0 - RESERVE)) & (at_start <= speed), speed * (1.0 + BEYOND + RESERVE), speed
    )
    for name, most, size in (
        ("sd", speed, u.sd),
        ("sdd", acceleration, u.sdd),
        ("tau", problem.settings.effort, u.tau),
        ("force", force, u.force),
    ):
        bound = most * (1.0 - RESERVE) / size
        found[name] = (-bound, bound)
    return found


REGULARISATION = 1e-5
"""Weight of the mean square of s̈ over its limit beside an objective of size one: where the objective leaves the
carriers open they take the gentlest motion, and the plan is unique."""


SHARED = 8
"""Nodes that share one copy of the peak; 8 and 32 are a tenth faster than 1 and than all."""


def add_objective(
    program: Program,
    problem: WholeProblem,
    A: IntArray,
    tau: IntArray,
    force: IntArray | None,
    V: IntArray,
    price: float,
) -> None:
    """Add the weighted objectives over their common size, times a price, and the regularisation.

    Integrals are trapezoidal sums over the nodes.
    """
    settings, scales = problem.settings, problem.scales
    w = problem.grid.weights[:, None]
    duration = float(w.sum())
    units = _units(problem, duration)
    whole = sum(weight * units[name] for name, weight in settings.objective.items())
    program.charge_square(A, price * REGULARISATION * w / duration)
    for name, weight in settings.objective.items():
        share = price * weight / whole
        if name in ("effort", "tracking"):
            program.charge_square(tau, share * w * scales.tau**2)
            if name == "tracking":
                program.charge(tau, -2.0 * share * w * scales.tau * problem.target)
        elif name == "peak":
            # a copy every few nodes, all equal: a single variable in every row would fill the solver's factors
            copies = program.variable("peak", (-(-len(tau) // SHARED),), 0.0)
            top = np.repeat(copies, SHARED)[: len(tau)]
            for sign in (1.0, -1.0):
                rows = program.rows(tau.shape, -np.inf, 0.0)
                program.add(rows, tau, sign)
                program.add(rows, top[:, None], -1.0)
            same = program.rows((len(copies) - 1,))
            program.add(same, copies[1:], 1.0)
            program.add(same, copies[:-1], -1.0)
            # on all copies alike, else the solver scales the whole objective by its one large slope
            program.charge(copies, share * scales.tau / len(copies))
        elif name == "carrier_acceleration":
            program.charge_square(A, share * w * scales.sdd**2)
        elif name == "effort_rate":
            _charge_effort_rate(program, problem, tau, share)
        elif force is not None and name == "carrier_force":
            program.charge_square(force, share * w * scales.force**2)
        elif force is not None:
            _charge_energy(program, problem, tau, force, V, share)


def _units(problem: WholeProblem, duration: float) -> dict[str, float]:
    """Return the size of each objective, in its unit."""
    scales = problem.scales
    power = scales.tau * (float(np.abs(problem.actuated_rate).max()) or 1.0)
    return {
        "effort": duration * scales.tau**2,
        "tracking": duration * scales.tau**2,
        "peak": scales.tau,
        "carrier_force": duration * float((scales.force**2).max()),
        "carrier_acceleration": duration * float((scales.sdd**2).max()),
        "effort_rate": scales.tau**2 / duration,
        "energy": duration * power,
    }


def _charge_effort_rate(program: Program, problem: WholeProblem, tau: IntArray, share: float) -> None:
    """Charge ∫ Σ τ̇² dt, the efforts linear between the nodes; they may jump where the reference does."""
    h = problem.grid.h
    at = np.flatnonzero(h > 0.0)
    change = program.variable("effort_change", (len(at), tau.shape[1]))
    rows = program.rows(change.shape)
    for variables, sign in ((tau[at + 1], 1.0), (tau[at], -1.0), (change, -1.0)):
        program.add(rows, variables, sign)
    program.charge_square(change, share * problem.scales.tau**2 / h[at, None])


def _charge_energy(
    program: Program, problem: WholeProblem, tau: IntArray, force: IntArray, V: IntArray, share: float
) -> None:
    """Charge the integral of powers p with p ≥ |τ q̇| and p ≥ |F ṡ|."""
    scales, w = problem.scales, problem.grid.weights[:, None]
    unit = scales.tau * (float(np.abs(problem.actuated_rate).max()) or 1.0)
    main = program.variable("main_power", tau.shape, 0.0)
    own = program.variable("carrier_power", force.shape, 0.0)
    for sign in (1.0, -1.0):
        rows = program.rows(tau.shape, 0.0, np.inf)
        program.add(rows, main, 1.0)
        program.add(rows, tau, sign * problem.actuated_rate * scales.tau / unit)
        rows = program.rows(force.shape, 0.0, np.inf)
        program.add(rows, own, 1.0)
        program.add_product(rows, force, V, sign * scales.force * scales.sd / unit)
    for block in (main, own):
        program.charge(block, share * w * unit)


def value(problem: WholeProblem, values: dict[str, Array]) -> dict[str, float]:
    """Return each weighted objective at the nodes, in its unit, unweighted."""
    scales, w = problem.scales, problem.grid.weights[:, None]
    tau = values["tau"] * scales.tau
    found: dict[str, float] = {}
    for name in problem.settings.objective:
        if name == "effort":
            found[name] = float((w * tau**2).sum())
        elif name == "tracking":
            found[name] = float((w * (tau - problem.target) ** 2).sum())
        elif name == "peak":
            found[name] = float(np.abs(tau).max())
        elif name == "effort_rate":
            h = problem.grid.h
            at = np.flatnonzero(h > 0.0)
            found[name] = float((np.diff(tau, axis=0)[at] ** 2 / h[at, None]).sum())
        elif name == "carrier_acceleration":
            found[name] = float((w * (values["sdd"] * scales.sdd) ** 2).sum())
        elif name == "carrier_force":
            found[name] = float((w * (values["force"] * scales.force) ** 2).sum())
        else:
            main = np.abs(tau * problem.actuated_rate)
            own = np.abs(values["force"] * scales.force * values["sd"] * scales.sd)
            found[name] = float((w * main).sum() + (w * own).sum())
    return found


def build(
    problem: WholeProblem,
    elastic: tuple[str, ...] = (),
    between: Sequence[BoolArray] | None = None,
    limit_force: bool = True,
) -> Program:
    """Return the programme of a problem.

    Args:
        problem: the numbers.
        between: groups of steps, (M − 1,) each, in which track and speed limits hold between the nodes as well; all
            when left out. Their rows come last and group by group, so that those of a longer list are appended.
        limit_force: whether the limits of the carriers' forces are held.
        elastic: kinds of limits (``KINDS``) that may be exceeded, at a price, to find out which of them are in the way.
    """
    program = Program()
    limiter = Limiter(program, problem, elastic)
    nodes, k = len(problem.grid.t), problem.model.k
    S, V, A = (limiter.variable(name, (nodes, k)) for name in ("s", "sd", "sdd"))
    tau = limiter.variable("tau", (nodes, problem.model.W.shape[2]))
    _integrate(program, problem, S, V, A)
    limiter.jerk(A)
    terms = ((S, None), (S, S), (V, None), (S, V), (A, None))
    _balance(program, problem, terms, tau)
    force = None
    if (limit_force and limiter.limits_force) or {"carrier_force", "energy"} & set(problem.settings.objective):
        force = limiter.variable("force", (nodes, k))
        _carrier_forces(program, problem, terms, force)
    _smooth(program, problem, A)
    for number in range(len(problem.singular)):
        _singular(program, problem, number, (S, V, A), tau)
    _start(program, problem, S, V)
    limiter.end(S, V, A)
    add_objective(program, problem, A, tau, force, V, limiter.price)
    for steps in [np.ones(nodes - 1, dtype=bool)] if between is None else between:
        limiter.between_nodes(S, V, A, steps)
    return program


def sizes(problem: WholeProblem) -> Array:
    """Return (5, k) the sizes of the five terms s, s², ṡ, s ṡ, s̈."""
    u = problem.scales
    return np.array([u.s, u.s**2, u.sd, u.s * u.sd, u.sdd])


Terms = tuple[tuple[IntArray, IntArray | None], ...]


def _integrate(program: Program, problem: WholeProblem, S: IntArray, V: IntArray, A: IntArray) -> None:
    """Equate each node with the end of the step before it: s̈ linear, ṡ quadratic, s cubic."""
    u, h = problem.scales, problem.grid.h[:, None]
    rate, push, both = h * u.sd / u.s, h * u.sdd / u.sd, h * h * u.sdd / u.s
    position = program.rows((len(h), problem.model.k))
    for variables, coefficient in (
        (S[:-1], 1.0),
        (V[:-1], rate),
        (A[:-1], both / 3.0),
        (A[1:], both / 6.0),
        (S[1:], -1.0),
    ):
        program.add(position, variables, coefficient)
    speed = program.rows((len(h), problem.model.k))
    for variables, coefficient in ((V[:-1], 1.0), (A[:-1], push / 2.0), (A[1:], push / 2.0), (V[1:], -1.0)):
        program.add(speed, variables, coefficient)


def _add_term(program: Program, rows: IntArray, term: tuple[IntArray, IntArray | None], coefficient: Array) -> None:
    first, second = term
    if second is None:
        program.add(rows, first, coefficient)
    else:
        program.add_product(rows, first, second, coefficient)


def _balance(program: Program, problem: WholeProblem, terms: Terms, tau: IntArray) -> None:
    """W τ − f = 0 at every node, whatever the rank of W."""
    model, scales = problem.model, problem.scales
    row = scales.row[:, None]
    rows = program.rows(model.f0.shape, model.f0 / scales.row, model.f0 / scales.row)
    program.add(rows[:, :, None], tau[:, None, :], model.W * scales.tau / row)
    for j, (first, second) in enumerate(terms):
        term = (first[:, None, :], None if second is None else second[:, None, :])
        _add_term(program, rows[:, :, None], term, -model.f_terms[..., j] * sizes(problem)[j] / row)
    if problem.more_terms is not None:
        S, V, A = (terms[j][0][:, None, :] for j in (0, 2, 4))
        squares, products = np.moveaxis(problem.more_terms, -1, 0)
        program.add_product(rows[:, :, None], V, V, -squares * scales.sd**2 / row)
        program.add_product(rows[:, :, None], S, A, -products * scales.s * scales.sdd / row)


def _carrier_forces(program: Program, problem: WholeProblem, terms: Terms, force: IntArray) -> None:
    """Equate the forces of the carriers' actuators with their polynomial."""
    model, scales = problem.model, problem.scales
    rows = program.rows(force.shape, model.force0 / scales.force, model.force0 / scales.force)
    program.add(rows, force, 1.0)
    for j, term in enumerate(terms):
        _add_term(program, rows, term, -model.force_terms[..., j] * sizes(problem)[j] / scales.force)


def _smooth(program: Program, problem: WholeProblem, A: IntArray) -> None:
    """Equate the jerk on both sides of the nodes that ask for it."""
    h = problem.grid.h
    at = np.flatnonzero(problem.grid.smooth)
    before, after = h[at - 1, None], h[at, None]
    rows = program.rows((len(at), problem.model.k))
    for variables, coefficient in ((A[at - 1], after), (A[at + 1], before), (A[at], -(before + after))):
        program.add(rows, variables, coefficient / (before + after))


def _singular(
    program: Program, problem: WholeProblem, number: int, motion: tuple[IntArray, IntArray, IntArray], tau: IntArray
) -> None:
    """Ask for uᵀ Ẇ τ = uᵀ ḟ, see ``whole_trajectory_singular``; compatibility is part of W τ = f at the node."""
    node, scales, model = problem.singular[number], problem.scales, problem.model
    i = node.index
    s, v, a = (part[i] for part in motion)
    A = motion[2]
    step = i if i < len(problem.grid.h) and problem.grid.h[i] > 0.0 else i - 1
    h = float(problem.grid.h[step])
    us, uv, ua = scales.s, scales.sd, scales.sdd
    terms = ((s, None), (s, s), (v, None), (s, v), (a, None))
    for u in node.lost:
        W = u @ node.rate.W[0] * scales.tau
        size = max(float(np.abs(W).max()), np.finfo(float).tiny)
        level = float(u @ node.rate.f0[0]) / size
        rows = program.rows((1,), level, level)
        program.add(rows, tau[i], W / size)
        by_time = np.einsum("i,ikj->jk", u, node.rate.f_terms[0]) * sizes(problem) / size
        for term, coefficient in zip(terms, by_time, strict=True):
            _add_term(program, rows, term, -coefficient)
        c1, c2, c3, c4, c5 = np.einsum("i,ikj->jk", u, model.f_terms[i]) / size
        program.add(rows, v, -c1 * uv)
        program.add_product(rows, s, v, -2.0 * c2 * us * uv)
        program.add(rows, a, -c3 * ua)
        program.add_product(rows, v, v, -c4 * uv * uv)
        program.add_product(rows, s, a, -c4 * us * ua)
        program.add(rows, A[step + 1], -c5 * ua / h)
        program.add(rows, A[step], c5 * ua / h)
        if problem.more_terms is not None:
            e1, e2 = np.einsum("i,ikj->jk", u, problem.more_terms[i]) / size
            program.add_product(rows, v, a, -(2.0 * e1 + e2) * uv * ua)
            program.add_product(rows, s, A[step + 1], -e2 * us * ua / h)
            program.add_product(rows, s, A[step], e2 * us * ua / h)


def _start(program: Program, problem: WholeProblem, S: IntArray, V: IntArray) -> None:
    settings, scales = problem.settings, problem.scales
    for variables, value in ((S[0], settings.start / scales.s), (V[0], settings.start_speed / scales.sd)):
        program.add(program.rows(value.shape, value, value), variables, 1.0)
