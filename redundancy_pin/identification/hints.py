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

_BETTER = 0.25
"""Part of the residual mean square that is left if efforts are named otherwise, below which that is reported."""

_SHIFTED = 0.8
"""The same of efforts that are shifted in time."""

_LONGEST, _LAGS = 1.0, 401
"""Longest shift, s, at most a quarter of the record, and how many shifts are tried."""


def hints(robot: Robot, records: Sequence[Records], rows: Sequence[Rows]) -> list[str]:
    """Return what signs, order or times of the efforts would explain them far better, as texts."""
    left = _misfit(rows)
    effort = [one.effort for one in rows]
    now = left(effort)
    driven, prior = (np.concatenate(parts) for parts in zip(*((one.driven, one.prior) for one in rows), strict=True))
    size = np.linalg.norm(driven) * np.linalg.norm(prior)
    drives = [*robot.actuated, *robot.carriers][: rows[0].E.shape[2]]
    named, listed = _renamed(drives, effort, left, now), []
    if named:
        listed.append(named)
    elif (driven * prior).sum() < -0.5 * size:
        listed.append("All efforts seem to have the wrong sign: the robot as declared needs opposite ones.")
    reach = min(_LONGEST, *(0.25 * (one.t[-1] - one.t[0]) for one in records))
    lags = np.linspace(-reach, reach, _LAGS)
    smooth = [_shifted(one, part) for one, part in zip(records, rows, strict=True)]
    shifted = np.array([left([part(lag) for part in smooth]) for lag in lags])
    best = int(np.argmin(shifted))
    if 0 < best < _LAGS - 1 and shifted[best] < _SHIFTED * now:
        before, here, after = shifted[best - 1 : best + 2]
        lag = lags[best] + 0.5 * (lags[1] - lags[0]) * (before - after) / (before - 2.0 * here + after)
        listed.append(
            f"Efforts {abs(lag):.3g} s {'later' if lag > 0.0 else 'earlier'} than the positions would leave "
            f"{here / now:.0%} of the residual mean square: their times differ, or friction or a spring is missing."
        )
    return listed


def _renamed(drives: list[str], effort: list[Array], left: Callable[[list[Array]], float], now: float) -> str:
    """Return which signs and order of columns leave far less; one change after the other, as long as each helps."""
    signs, order, best = np.ones(len(drives)), np.arange(len(drives)), now
    for _ in range(2 * len(drives)):
        candidates = []
        for k in range(len(drives) if len(drives) > 1 else 0):
            candidates.append((np.where(np.arange(len(drives)) == k, -signs, signs), order))
        for j, k in combinations(range(len(drives)), 2):
            swapped = order.copy()
            swapped[[j, k]] = order[[k, j]]
            candidates.append((signs, swapped))
        found = [left([s * part[:, o] for part in effort]) for s, o in candidates]
        if not found or min(found) > 0.7 * best:
            break
        best, (signs, order) = min(found), candidates[int(np.argmin(found))]
    if best > _BETTER * now:
        return ""
    columns = ", ".join(f"{'-' if sign < 0.0 else ''}{drives[k]}" for sign, k in zip(signs, order, strict=True))
    return (
        f"Columns of the efforts seem to be {columns}: so read they leave {best / now:.0%} of the residual mean square."
    )


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
