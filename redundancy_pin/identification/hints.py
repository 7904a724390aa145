"""Hints that efforts have wrong signs, another order or other times, each verified by a fit of the efforts put right.

Candidates are found with the equations as measured, weighted by the noise of the efforts about their splines, so that
one product with a basis of the regressor gives the residual. A candidate counts where a whole fit leaves that noise
and no more. A hint refuses nothing.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
from scipy.optimize import minimize_scalar

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.identification.equations import Rows, Solution, whitening
from redundancy_pin.identification.records import Records
from redundancy_pin.robot import Robot

_HELPS = 0.7
"""Part of the residual mean square that another sign, order or time leaves, below which it is a candidate."""

_EXPLAINED = 1.25
"""Residual mean square over that of the noise of the efforts, below which a fit explains them."""

_NOTICED = 0.05
"""Decrease of the residual mean square of a record, over that of the noise, that makes a shift a candidate."""

_LEFT_OUT = 0.1
"""Standard deviation left out of f relative to that by readings: nothing near a singularity decides a hint."""

_UNITS = 1e3
"""Ratio of measured and declared forces, either way, from which units are in doubt."""

_LONGEST, _LAGS = 1.0, 201
"""Longest shift, s, at most a quarter of the record, and how many shifts are tried."""


def hints(
    robot: Robot,
    records: Sequence[Records],
    rows: Sequence[Rows],
    solution: Solution,
    refit: Callable[[Sequence[Records]], Solution],
) -> list[str]:
    """Report other signs, another order, or shifts in time of the efforts that explain the records.

    Args:
        robot: the given robot; it determines the common sign of all efforts.
        records: the records.
        rows: the equations as measured.
        solution: their solution.
        refit: returns the solution of other records.
    """
    declared, measured = (
        np.concatenate(part) for part in zip(*((r.driven - r.right, r.driven) for r in rows), strict=True)
    )
    given, found = (float(np.median(np.abs(forces))) for forces in (declared, measured))
    if given and found and not 1.0 / _UNITS < found / given < _UNITS:
        return [
            f"The measured forces are {found / given:.2g} times those of {robot.name} as declared: check the units of "
            "the efforts, N and N·m, and of the robot."
        ]
    now = _mean_square(solution)
    signs, order, suspected = _other_columns(rows)
    others = [one.changed(efforts=signs * one.efforts[:, order]) for one in records]
    changed = (signs < 0.0).any() or (np.diff(order) < 0).any()
    if changed and _refitted(refit, others) < _EXPLAINED:
        drives = [*robot.actuated, *robot.carriers]
        names = [f"{'-' if s < 0.0 else ''}{drives[k]}" for s, k in zip(signs, order.tolist(), strict=True)]
        return [f"Columns of the efforts seem to be those of {', '.join(names)}."]
    lags = [_other_time(one) for one in rows]
    if any(lags):
        others = [_shifted(record, by, lag) for record, by, lag in zip(records, rows, lags, strict=True)]
        then, suspected = _refitted(refit, others), True
        if then < min(now, _EXPLAINED):
            return [
                f"Efforts {abs(lag):.3g} s {'later' if lag > 0.0 else 'earlier'} than the positions"
                f"{f' in records[{k}]' if len(records) > 1 else ''} would leave {then / now:.0%} of the residual mean "
                f"square: add {-lag:.3g} s to the times of the efforts, or friction or a spring is missing."
                for k, lag in enumerate(lags)
                if lag
            ]
    if suspected and now > _EXPLAINED:
        return [
            "Residuals follow the rates: friction or a spring is missing, or times of efforts and positions differ, or "
            "the order of columns. Check time stamps and column order."
        ]
    return []


def _refitted(refit: Callable[[Sequence[Records]], Solution], others: Sequence[Records]) -> float:
    """Return the mean square of the residuals of other records; infinite if their equations are lost in rounding."""
    try:
        return _mean_square(refit(others))
    except np.linalg.LinAlgError:
        return np.inf


def _mean_square(solution: Solution) -> float:
    """Return the mean square of the residuals of a solution, over the noise of the readings about splines."""
    weights = [whitening(part.rows.E, part.rows.record.noise, _LEFT_OUT) for part in solution.parts]
    white = [np.einsum("Nrs,Ns->Nr", L, part.rest).ravel() for L, part in zip(weights, solution.parts, strict=True)]
    return float(np.mean(np.concatenate(white) ** 2))


def _misfit(rows: Sequence[Rows], edge: float = 0.0) -> Callable[[Sequence[Array]], float]:
    """Return the function of efforts (N, d) of each record that is the square sum which no parameters explain.

    Samples within ``edge``, s, of the ends do not count.
    """
    parts = []
    for one in rows:
        t, E = one.record.along.motion.t, one.record.E
        inner = (t >= t[0] + edge) & (t <= t[-1] - edge)
        L = whitening(E, one.record.noise, _LEFT_OUT)[inner]
        prior = one.driven - one.right
        parts.append((inner, L @ E[inner], np.einsum("Nrs,Ns->Nr", L, prior[inner]), L @ one.Y[inner]))
    basis = np.linalg.qr(np.concatenate([A.reshape(-1, A.shape[2]) for *_, A in parts]))[0]

    def left(efforts: Sequence[Array]) -> float:
        weighted = [
            (np.einsum("Nrd,Nd->Nr", E, u[inner]) - prior).ravel()
            for (inner, E, prior, _), u in zip(parts, efforts, strict=True)
        ]
        y = np.concatenate(weighted)
        return float(y @ y - ((y @ basis) ** 2).sum())

    return left


def _other_columns(rows: Sequence[Rows]) -> tuple[Array, IntArray, bool]:
    """Return signs and order of columns that leave far less, and if they do; one change after the other that helps.

    The common sign leaves the residual unchanged: the given robot determines it.
    """
    readings, left = [one.record.reading for one in rows], _misfit(rows)
    every = np.arange(readings[0].shape[1], dtype=np.intp)
    signs, order, suspected = np.ones(len(every)), every, False
    best = left(readings)
    for _ in range(2 * len(every)):
        candidates = [(np.where(every == k, -signs, signs), order) for k in every[1:]]
        for j, k in combinations(every, 2):
            candidates.append((signs, np.where(every == j, order[k], np.where(every == k, order[j], order))))
        found = [left([own_signs * u[:, own_order] for u in readings]) for own_signs, own_order in candidates]
        if not found or min(found) > _HELPS * best:
            break
        suspected, best, (signs, order) = True, min(found), candidates[int(np.argmin(found))]
    driven = np.concatenate(
        [np.einsum("Nrd,Nd->Nr", one.record.E, signs * one.record.reading[:, order]) for one in rows]
    )
    prior = np.concatenate([one.driven - one.right for one in rows])
    if (driven * prior).sum() < -0.5 * np.linalg.norm(driven) * np.linalg.norm(prior):
        signs = -signs
    return signs, order, suspected


def _other_time(rows: Rows) -> float:
    """Return by how much later efforts of a record would leave less, s; zero where none would."""
    t, u, spline = rows.record.along.motion.t, rows.record.reading, rows.record.smooth.efforts
    reach = min(_LONGEST, 0.25 * float(t[-1] - t[0]))
    misfit = _misfit([rows], edge=reach)
    rest = u - spline(t)[:, : u.shape[1]]

    def left(lag: float) -> float:
        return misfit([rest + spline(np.clip(t + lag, t[0], t[-1]))[:, : u.shape[1]]])

    lags = np.linspace(-reach, reach, _LAGS)
    found = [left(lag) for lag in lags]
    best = int(np.argmin(found))
    if not 0 < best < _LAGS - 1:
        return 0.0
    finer = minimize_scalar(
        left, bounds=(lags[best - 1], lags[best + 1]), method="bounded", options={"xatol": 1e-5 * reach}
    )
    return float(finer.x) if left(0.0) - finer.fun > _NOTICED * rows.right.size else 0.0


def _shifted(record: Records, rows: Rows, lag: float) -> Records:
    """Return a record with positions so much later, s, and their noise of now; efforts stay as they were measured."""
    spline, t = rows.record.smooth.positions, record.t
    known = (t - lag >= t[0]) & (t - lag <= t[-1])
    moved = record.positions - spline(t) + spline(np.clip(t - lag, t[0], t[-1]))
    return record.changed(known, positions=moved) if lag else record
