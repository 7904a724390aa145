"""The programme of a whole trajectory: exact coefficients of f, limits, ends and singular instants as sparse algebra.

Variables at each node: s, ṡ, s̈ and τ over their sizes; further ones where an objective or a limit needs them. s̈ is
linear between nodes, so that the carriers' motion is integrated exactly by linear equations; W τ = f is quadratic.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_limits import Limiter
from redundancy_pin.planners.whole_trajectory_objective import add_objective
from redundancy_pin.planners.whole_trajectory_program import Program


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
