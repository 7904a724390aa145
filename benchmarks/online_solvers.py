"""Solvers of quadratic programmes side by side, on those of the on-line planner's ticks.

``python benchmarks/online_solvers.py [paths] [machine] ...`` prints a table of docs/online.md. Each solver is given the
programmes of all ticks in order, as the planner in Python has them, put together beforehand, in one object that goes on
from the tick before; those that are not installed have no row. The last row is the planner's own method: it solves
what it makes of its programmes of the same ticks, and its time holds linearising and putting together too.
"""

import sys
import time
from itertools import islice

import numpy as np
from online import machine, random_paths
from scipy import sparse

from redundancy_pin.planners.receding_horizon import RecedingHorizon

STEP = 0.02
"""Between ticks, s."""

MOST = 100
"""Programmes: some of these solvers take a tenth of a second for each."""

FEWER = {"ProxQP": 12}
"""Of those of the 2-RPR: ProxQP 0.8.0 had not come back from a later one after two minutes."""


def programmes(dynamics, paths):
    """Return the programmes of the ticks: P, q, A, b, G, low, high, lower, upper, of ``Programme.numbers_of``."""
    kept = []
    for path in paths:
        planner = RecedingHorizon(dynamics, interpret=True)
        programme = planner.ticks.programme(False)
        asked = programme.numbers_of

        def remembered(problem, asked=asked):
            numbers = asked(problem)
            kept.append([value.copy() for value in numbers])
            return numbers

        programme.numbers_of = remembered
        for t in np.arange(0.0, path.duration, STEP).tolist():
            planner.update(t, path)
    return kept


def judged(numbers, x):
    """Return the cost of a solution, and by how much it misses an equation or a bound, in units."""
    P, q, A, b, G, low, high, lower, upper = numbers
    g = G @ x
    beyond = max(float(part.max()) for part in (low - g, g - high, lower - x, x - upper))
    return 0.5 * x @ (P @ x) + q @ x, max(beyond, float(np.abs(A @ x - b).max()))


class Piqp:
    """Interior points; it does not begin where the tick before ends."""

    def __init__(self, kkt=None):
        import piqp

        self.solver = piqp.SparseSolver() if kkt else piqp.DenseSolver()
        settings = self.solver.settings
        if kkt:
            settings.kkt_solver = getattr(piqp.KKTSolver, kkt)
        settings.eps_abs, settings.eps_rel, settings.preconditioner_iter = 1e-8, 1e-10, 0
        settings.eps_duality_gap_abs = settings.eps_duality_gap_rel = 1e-6
        self.is_dense, self.begun = not kkt, False

    def given(self, numbers):
        # with the zeros that are among its entries: ``update`` goes by their places
        return [value.toarray() if self.is_dense and sparse.issparse(value) else value for value in numbers]

    def solve(self, given):
        (self.solver.update if self.begun else self.solver.setup)(*given)
        self.begun = True
        self.solver.solve()
        return np.array(self.solver.result.x), self.solver.result.info.iter


class Osqp:
    """Splitting, from the solution of the tick before, and polished."""

    def __init__(self, precision):
        import osqp

        self.solver, self.precision, self.begun = osqp.OSQP(), precision, False

    def given(self, numbers):
        P, q, A, b, G, low, high, lower, upper = numbers
        rows = sparse.vstack([A, G, sparse.identity(len(q))], format="csc")
        bounds = np.concatenate([b, low, lower]), np.concatenate([b, high, upper])
        return sparse.triu(P, format="csc"), q, rows, *bounds

    def solve(self, given):
        P, q, rows, low, high = given
        if self.begun:
            self.solver.update(Px=P.data, Ax=rows.data, q=q, l=low, u=high)
        else:
            settings = {"eps_abs": self.precision, "eps_rel": self.precision, "max_iter": 4000, "polishing": True}
            self.solver.setup(P, q, rows, low, high, verbose=False, **settings)
            self.begun = True
        result = self.solver.solve(raise_error=False)
        return result.x, result.info.iter


class ProxQp:
    """Augmented Lagrangian, from the solution of the tick before; made anew, for ``update`` of 0.8.0 hangs here."""

    def __init__(self, kind):
        import proxsuite

        self.module, self.kind, self.before = proxsuite.proxqp, kind, None

    def given(self, numbers):
        P, q, A, b, G, low, high, lower, upper = numbers
        rows = sparse.vstack([G, sparse.identity(len(q))], format="csc")
        bounds = (np.concatenate(part).clip(-1e20, 1e20) for part in ((low, lower), (high, upper)))  # its infinity
        given = P, q, A, b, rows, *bounds
        return [value.toarray() if self.kind == "dense" and sparse.issparse(value) else value for value in given]

    def solve(self, given):
        qp = getattr(self.module, self.kind).QP(len(given[1]), len(given[3]), given[4].shape[0])
        qp.settings.eps_abs, qp.settings.eps_rel = 1e-6, 0.0
        qp.settings.max_iter, qp.settings.max_iter_in = 200, 200
        qp.init(*given)
        if self.before is None:
            qp.solve()
        else:
            qp.settings.initial_guess = self.module.InitialGuess.WARM_START
            qp.solve(*self.before)
        self.before = qp.results.x, qp.results.y, qp.results.z
        return np.array(qp.results.x), qp.results.info.iter


SOLVERS = {
    "PIQP, sparse": lambda: Piqp("sparse_ldlt"),
    "PIQP, bounds condensed (as in Python)": lambda: Piqp("sparse_ldlt_ineq_cond"),
    "PIQP, multistage": lambda: Piqp("sparse_multistage"),
    "PIQP, dense": Piqp,
    "OSQP, 1e-4": lambda: Osqp(1e-4),
    "OSQP, 1e-6": lambda: Osqp(1e-6),
    "ProxQP, sparse, 1e-6": lambda: ProxQp("sparse"),
    "ProxQP, dense, 1e-6": lambda: ProxQp("dense"),
}


def in_turn(make, asked):
    """Return seconds, iterations, and what ``judged`` says, of each of the programmes in order."""
    solver, rows = make(), []
    for numbers in asked:
        given = solver.given(numbers)
        began = time.perf_counter()
        x, iterations = solver.solve(given)
        rows.append((time.perf_counter() - began, iterations, *judged(numbers, x)))
    return np.array(rows)


def own(dynamics, paths):
    """Return seconds and iterations of the ticks in machine code."""
    rows = []
    for path in paths:
        planner = RecedingHorizon(dynamics)
        for t in np.arange(0.0, path.duration, STEP).tolist():
            command = planner.update(t, path)
            rows.append((command.solver_seconds, planner.ticks.last.iterations))
    return np.array(rows)


def main(count=1, *names):
    for name in names or ("2rpr", "3rrr"):
        dynamics = machine(name)
        paths = [*islice(random_paths(name, dynamics), int(count))]
        asked, least = programmes(dynamics, paths)[:MOST], None
        P, _, A, _, G, *_ = asked[-1]
        print(f"{name}: {len(asked)} programmes of {P.shape[0]} unknowns, {A.shape[0]} equations, {G.shape[0]} rows")
        for title, make in SOLVERS.items():
            try:
                part = in_turn(make, asked[: FEWER.get(title.split(",")[0], MOST)])
            except ImportError:
                continue
            least = part[:, 2] if least is None else least  # of the first one
            ms, dear = 1e3 * np.percentile(part[:, 0], [50, 99]), np.abs(part[:, 2] / least[: len(part)] - 1.0)
            told = f"{ms[0]:.2f}, {ms[1]:.2f} | {np.median(part[:, 1]):.0f}, {part[:, 1].max():.0f} | "
            told += f"{np.median(part[:, 3]):.0e}, {part[:, 3].max():.0e} | {np.nanmax(dear):.0e}"
            print(f"| {title} | {len(part)} | {told} |", flush=True)
        spent = own(dynamics, paths)[1:MOST]
        ms, iterations = 1e3 * np.percentile(spent[:, 0], [50, 99]), spent[:, 1]
        told = f"{ms[0]:.2f}, {ms[1]:.2f} | {np.median(iterations):.0f}, {iterations.max():.0f}"
        print(f"| its own | {len(spent)} | {told} | | |")


if __name__ == "__main__":
    main(*sys.argv[1:])
