"""Limits of a whole trajectory: bounds at the nodes, hulls between them, ends; or, elastic, prices of leaving them."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.planners.whole_trajectory_data import WholeProblem
from redundancy_pin.planners.whole_trajectory_program import Program

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
