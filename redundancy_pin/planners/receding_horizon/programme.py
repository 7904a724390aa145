"""The convex quadratic programme of one tick: s, ṡ, s̈ and τ at each node, with W τ = f linear about the last plan.

Its pattern never changes, so that a solver is set up once; equations that do not count at a tick are rows of zeros.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.errors import optional

SOLVERS: dict[str, dict[str, Any]] = {
    "piqp": {"piqp": {"max_iter": 60}},
    "proxqp": {"proxqp": {"max_iter": 400}},
    "osqp": {"osqp": {"eps_abs": 1e-5, "eps_rel": 1e-5, "max_iter": 4000, "verbose": False}},
}
"""Solvers of casadi that take the programme, and their options. PIQP takes a tenth of the time of the others; HPIPM
refuses rows that couple three nodes, and QRQP finds no solution (``benchmarks/online.py``)."""


class Rows:
    """Rows of a sparse matrix of a fixed pattern, put together from blocks."""

    def __init__(self) -> None:
        self.blocks: dict[str, int] = {}
        self._columns: list[IntArray] = []

    def add(self, name: str, *columns: Any) -> None:
        """Add rows with entries in columns: arrays (r,) of one entry a row, or (r, e) of several."""
        if len(columns) > 1:
            columns = (np.stack([np.ravel(part) for part in np.broadcast_arrays(*columns)], axis=1),)
        self.blocks[name] = len(columns[0])
        self._columns.append(columns[0])

    def finish(self, variables: int) -> None:
        """Order the entries by column, as solvers want them."""
        entries = np.concatenate([np.full(len(part), part.shape[1]) for part in self._columns])
        rows, columns = np.repeat(np.arange(len(entries)), entries), np.concatenate([p.ravel() for p in self._columns])
        order = np.lexsort((rows, columns))
        self.order, self.rows = order, rows[order]
        self.starts = np.searchsorted(columns[order], np.arange(variables + 1))
        self.shape = len(entries), variables

    def values(self, blocks: Mapping[str, tuple[Array, ...]]) -> list[Array]:
        """Return entries in order, and what else comes with the rows of each block (right sides or bounds)."""
        entries, *rest = zip(*(blocks[name] for name in self.blocks), strict=True)
        data = np.concatenate([part.ravel() for part in entries])[self.order]
        return [data, *(np.concatenate([np.ravel(part) for part in parts]) for parts in rest)]


@dataclass(frozen=True, eq=False)
class Values:
    """Numbers of one programme: ½ xᵀ P x + qᵀ x, A x = b, low ≤ G x ≤ high, lower ≤ x ≤ upper."""

    P: Array
    q: Array
    A: Array
    b: Array
    G: Array
    low: Array
    high: Array
    lower: Array
    upper: Array


Solve: TypeAlias = Callable[[Values], tuple[Array, bool]]
"""From a programme to its variables, and whether they are an optimum."""


class Programme:
    """Which variable and which row stands where.

    Variables, all over their sizes: s, ṡ, s̈ (k each), τ (m) and, in an elastic one, what is missing of W τ = f (n + 2)
    at each of the nodes; the peak.
    """

    def __init__(self, n: int, m: int, k: int, steps: int, solver: str, jerk: bool, force: bool, elastic: bool) -> None:
        spare = n + 2 if elastic else 0
        width = 3 * k + m + spare
        self.variables = (steps + 1) * width + 1
        at, carrier = np.arange(steps + 1)[:, None] * width, np.arange(k)
        self.s, self.sd, self.sdd = s, sd, sdd = tuple(at + j * k + carrier for j in range(3))
        self.tau = tau = at + 3 * k + np.arange(m)
        self.missing = missing = at + 3 * k + m + np.arange(spare)
        self.peak = self.variables - 1
        first, last = slice(0, -1), slice(1, None)
        wide = np.concatenate([tau, s, sd, sdd], axis=1)
        self.equal, self.within = equal, within = Rows(), Rows()
        equal.add("position", s[first], sd[first], sdd[first], sdd[last], s[last])
        equal.add("speed", sd[first], sdd[first], sdd[last], sd[last])
        equal.add(
            "dynamics", np.concatenate([np.repeat(wide, n, axis=0), missing[:, :n].reshape(len(tau) * n, -1)], axis=1)
        )
        equal.add("before", np.concatenate([wide[last], sdd[first], missing[last, n : n + 1]], axis=1))
        equal.add("start", np.concatenate([wide[:1], missing[:1, n : n + 1]], axis=1))
        equal.add("after", np.concatenate([wide[first], sdd[last], missing[first, n + 1 :]], axis=1))
        within.add("above", tau, self.peak)
        within.add("below", tau, self.peak)
        within.add("hull_left", s[first], sd[first])
        within.add("hull_right", s[last], sd[last])
        within.add("hull_speed", sd[first], sdd[first])
        within.add("stop", s[-1], sd[-1])
        within.add("stop_back", s[-1], sd[-1])
        if jerk:
            within.add("jerk", sdd[first], sdd[last])
        if force:
            within.add("force", np.repeat(np.concatenate([s, sd, sdd], axis=1), k, axis=0))
        for rows in (equal, within):
            rows.finish(self.variables)
        pair, every = [sdd[first].ravel(), sdd[last].ravel()], np.arange(self.variables)
        down, across = np.concatenate([every, *pair]), np.concatenate([every, *pair[::-1]])
        self._order = np.lexsort((down, across))
        self.pattern = down[self._order], np.searchsorted(across[self._order], np.arange(self.variables + 1))
        self.solve: Solve = _casadi(self, solver)

    def hessian(self, diagonal: Array, beside: Array) -> Array:
        """Return the entries of P: its diagonal, and (M, k) those of s̈ at two nodes that follow each other."""
        return np.concatenate([diagonal, beside.ravel(), beside.ravel()])[self._order]


def _casadi(programme: Programme, name: str) -> Solve:
    ca = optional("casadi", "On-line planning needs", "Install it with `pip install 'redundancy_pin[optimal]'`.")
    e, w = programme.equal, programme.within
    both = [ca.Sparsity(*r.shape, r.starts.tolist(), r.rows.tolist()) for r in (e, w)]
    rows = np.concatenate([e.rows, e.shape[0] + w.rows])
    columns = np.concatenate([np.repeat(np.arange(programme.variables), np.diff(r.starts)) for r in (e, w)])
    order, pattern = np.lexsort((rows, columns)), ca.vertcat(*both)
    H = ca.Sparsity(
        programme.variables, programme.variables, programme.pattern[1].tolist(), programme.pattern[0].tolist()
    )
    options = {"error_on_fail": False, "print_time": False, **SOLVERS[name]}
    solver = ca.conic("tick", name, {"h": H, "a": pattern}, options)

    def solve(v: Values) -> tuple[Array, bool]:
        entries = np.concatenate([v.A, v.G])[order]
        low, high = np.concatenate([v.b, v.low]), np.concatenate([v.b, v.high])
        result = solver(h=ca.DM(H, v.P), g=v.q, a=ca.DM(pattern, entries), lba=low, uba=high, lbx=v.lower, ubx=v.upper)
        x = np.asarray(result["x"]).ravel()
        return x, bool(solver.stats()["success"]) and bool(np.isfinite(x).all())

    return solve
