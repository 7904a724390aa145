"""Singularity margins that are typical of a robot, and the diagonal blocks of K: computed once per robot."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from redundancy_pin.arrays import IntArray, read_only
from redundancy_pin.kinematics.assembly import Assembly, assemble, inverses
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.mobility import free_motions
from redundancy_pin.kinematics.multistart import SEED, draw_starts

NEAR_RANK_LOSS = 3e-3
"""Singularity margin below which rounding shows: velocities lose 1e-16 / margin², accelerations 1e-16 / margin³."""

_SAMPLES, _SPREAD = 8, 0.4
"""Random configurations around the reference that determine the typical margin, of each kind, and how far the joints
are from it at most, before closing, rad or characteristic lengths."""


@lru_cache(maxsize=64)
def closed_around(system: ConstraintSystem) -> Assembly:
    """Return the reference configuration and some around it, the chains closed again where Newton's method can.

    Half of them are displaced in any direction, half along the branch: near a pose where several loops are flat,
    Newton's method closes the former to flat poses again.
    """
    q, rng = np.array(system.robot.q_reference), np.random.default_rng(SEED)
    around = [
        draw_starts(system, q, _SAMPLES, rng, turn=_SPREAD, slide=_SPREAD, along=along)
        for along in (None, free_motions(system, q))
    ]
    return assemble(system, np.concatenate([q[None], *around]))


@lru_cache(maxsize=64)
def typical_margin(system: ConstraintSystem) -> float:
    """Return the largest singularity margin at the reference and some configurations around it; 1 where all are 0."""
    around = closed_around(system)
    return float(around.projection.margin.max(where=around.closed, initial=0.0)) or 1.0


def near_rank_loss(system: ConstraintSystem) -> float:
    """Return the singularity margin below which a state is near a rank loss: smaller for robots of small margins.

    Short levers, gears and many joints make margins of 1e-3 and less everywhere (Cassie's leg), where no rank is lost.
    """
    return min(NEAR_RANK_LOSS, 0.1 * typical_margin(system))


@lru_cache(maxsize=64)
def loop_blocks(system: ConstraintSystem) -> tuple[tuple[IntArray, IntArray], ...]:
    """Return rows and columns of the B diagonal blocks to which K can be permuted, each that of a loop or a leg.

    det K is the product of theirs up to a sign, and they lose rank each by itself: two that change sign in one step
    leave that of det K. Columns j and k are of one block where K⁻¹ K, the identity, comes about by entries that lead
    from j to k and back. Entries below 1e-9 of the largest, with open chains, are zero by the structure of the robot.
    """
    q, rng = np.array(system.robot.q_reference), np.random.default_rng(SEED)
    rows = system.relative(system.evaluate(draw_starts(system, q, 2, rng, turn=_SPREAD, slide=_SPREAD)).K)
    solves, has = (
        (np.abs(part) > 1e-9 * np.abs(part).max(axis=(1, 2), keepdims=True)).any(axis=0)
        for part in (inverses(rows), rows)
    )
    leads = solves.astype(np.float64) @ has > 0.0
    together = (leads & leads.T) | np.eye(len(leads), dtype=bool)
    blocks, size = [], len(system.pose_columns)
    for k in range(size):
        columns = np.flatnonzero(together[k])
        if columns[0] == k:
            blocks.append((np.flatnonzero((solves[columns] & has[:, columns].T).any(axis=0)), columns))
    if any(len(own) != len(columns) for own, columns in blocks):
        everything = read_only(np.arange(size))
        return ((everything, everything),)
    return tuple((read_only(own), read_only(columns)) for own, columns in blocks)
