"""Hints that efforts have wrong signs, another order or other times: what would explain them better.

The equations are solved again for changed efforts with equal weights, which costs one product each with the basis of
the regressor. A hint refuses nothing: a force that the model lacks may look like a shift in time.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import combinations

import numpy as np
from scipy.interpolate import make_lsq_spline

from redundancy_pin.arrays import Array
from redundancy_pin.identification.equations import Rows, first_noise
from redundancy_pin.identification.records import DEGREE, Records
from redundancy_pin.robot import Robot

_HELPS = 0.7
"""Part of the residual mean square that another sign or order leaves, below which it is reported."""

_SHIFTED = 0.9
"""The same of a shift in time."""

_LONGEST, _LAGS = 1.0, 401
"""Longest shift, s, at most a quarter of the record, and how many shifts are tried."""


def hints_of_order(robot: Robot, rows: Sequence[Rows]) -> list[str]:
    """Report signs and an order of columns that leave far less; one change after the other, as long as each helps.

    The robot as declared says the sign of all efforts together. ``rows`` are the equations as measured.
    """
    drives = [*robot.actuated, *robot.carriers][: rows[0].E.shape[2]]
    left, every = _misfit(rows), np.arange(len(drives))
    signs, order = np.ones(len(drives)), every
    best = left([one.effort for one in rows])
    for _ in range(2 * len(drives)):
        flips = [(np.where(every == k, -signs, signs), order) for k in every[1:]]
        swaps = [
            (signs, np.where(every == j, order[k], np.where(every == k, order[j], order)))
            for j, k in combinations(every, 2)
        ]
        candidates = [*flips, *swaps]
        found = [left([s * one.effort[:, o] for one in rows]) for s, o in candidates]
        if not found or min(found) > _HELPS * best:
            break
        best, (signs, order) = min(found), candidates[int(np.argmin(found))]
    driven = np.concatenate([np.einsum("Nrd,Nd->Nr", one.E, signs * one.effort[:, order]) for one in rows])
    prior = np.concatenate([one.prior for one in rows])
    if (driven * prior).sum() < -0.5 * np.linalg.norm(driven) * np.linalg.norm(prior):
        signs = -signs
    if (signs > 0.0).all() and (order == every).all():
        return []
    columns = ", ".join(f"{'-' if sign < 0.0 else ''}{drives[int(k)]}" for sign, k in zip(signs, order, strict=True))
    return [f"Columns of the efforts seem to be those of {columns}."]


def hints_of_time(records: Sequence[Records], rows: Sequence[Rows]) -> list[str]:
    """Report a shift in time that leaves less.

    ``rows`` are the equations about rates without the estimated noise of positions, which would hide small shifts.
    """
    left = _misfit(rows)
    reach = min(_LONGEST, *(0.25 * (one.t[-1] - one.t[0]) for one in records))
    lags = np.linspace(-reach, reach, _LAGS)
    moved = [_shifted(one, part) for one, part in zip(records, rows, strict=True)]
    found = np.array([left([part(lag) for part in moved]) for lag in lags])
    best, now = int(np.argmin(found)), found[_LAGS // 2]
    if not (0 < best < _LAGS - 1 and found[best] < _SHIFTED * now):
        return []
    before, here, after = found[best - 1 : best + 2]
    lag = lags[best] + 0.5 * (lags[1] - lags[0]) * (before - after) / (before - 2.0 * here + after)
    return [
        f"Efforts {abs(lag):.3g} s {'later' if lag > 0.0 else 'earlier'} than the positions would leave "
        f"{here / now:.0%} of the residual mean square: their times differ, or friction or a spring is missing."
    ]


def _misfit(rows: Sequence[Rows]) -> Callable[[list[Array]], float]:
    """Return the function of efforts (N, d) of each record that is the square sum which no parameters explain."""
    noise = first_noise(rows)
    L = [noise.whitening(one.E) for one in rows]
    A = np.concatenate(
        [(part @ one.Y).reshape(one.prior.size, one.Y.shape[2]) for part, one in zip(L, rows, strict=True)]
    )
    basis = np.linalg.qr(A)[0]

    def left(effort: list[Array]) -> float:
        b = np.concatenate(
            [
                (part @ ((one.E @ u[:, :, None])[..., 0] - one.prior)[..., None]).ravel()
                for part, one, u in zip(L, rows, effort, strict=True)
            ]
        )
        return float(b @ b - ((b @ basis) ** 2).sum())

    return left


def _shifted(record: Records, rows: Rows) -> Callable[[float], Array]:
    """Return the function of a lag, s, that is the efforts (N, d) of a record so much later, with the noise of now.

    Efforts interpolated between samples would have less noise than at them.
    """
    both = np.concatenate([record.effort, record.carrier_force], axis=1)[:, : rows.E.shape[2]]
    spline = make_lsq_spline(record.t, both, rows.smooth.knots, DEGREE)
    first, last, here = record.t[0], record.t[-1], record.t[rows.smooth.kept]
    rest = rows.effort - spline(here)
    return lambda lag: np.asarray(rest + spline(np.clip(here + lag, first, last)))
