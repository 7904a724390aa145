"""Close loops from afar, with rows that may be redundant: files put joints far from where the loops meet."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, RANK_TOLERANCE, Array
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.assembly import assemble
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.mobility import free_motions
from redundancy_pin.kinematics.multistart import SEED, draw_starts
from redundancy_pin.robot import Robot

_SPREADS = np.linspace(0.2, 1.5, 30)
"""rad or characteristic lengths: how far further starts are away, up to a quarter turn."""

_CONTRADICTION = 30.0
"""Residual over the tolerance up to which Newton's method from the start has found the configuration that is meant."""

_ITERATIONS = 100
"""Most steps of Newton's method: on redundant rows it converges linearly where they lose rank."""


def closed_near(
    robot: Robot, q: Array, tolerance: float = CLOSURE_TOLERANCE, rank_tolerance: float = RANK_TOLERANCE
) -> Array:
    """Return the closed configuration (nq,) that the smallest changes of q lead to.

    Args:
        robot: its closure rows may be redundant.
        q: (nq,) where to begin.
        tolerance: largest closure residual, characteristic lengths or rad; larger where redundant rows agree except for
            rounding.
        rank_tolerance: as of ``assemble``.

    Raises:
        DeclarationError: the loops do not close from there; carries the smallest residual, m.

    Example:
        >>> q = closed_near(robot, pin.neutral(robot.model))
    """
    system, rng = ConstraintSystem(robot), np.random.default_rng(SEED)
    best = np.inf
    starts = (q, *(draw_starts(system, q, 1, rng, spread=spread)[0] for spread in _SPREADS))
    for start in starts:
        reached = assemble(system, start[None], rank_tolerance=rank_tolerance, max_iterations=_ITERATIONS)
        residual = float(reached.residual[0])
        if residual < tolerance * robot.characteristic_length:
            closed: Array = reached.q[0]
            return closed
        best = min(best, residual)
        if start is q and residual < _CONTRADICTION * tolerance * robot.characteristic_length:
            break  # rows that contradict each other: another assembly, where they do so less, is another machine
    raise DeclarationError(
        f"The loops of {robot.name} do not close near the reference: the closure residual is {best:.3g} m.",
        remedy="Name a reference that is nearer to a closed configuration, or correct the closures.",
        residual=best,
    )


def closed_neighbours(
    system: ConstraintSystem,
    q: Array,
    count: int,
    spread: float,
    tolerance: float = CLOSURE_TOLERANCE,
    rank_tolerance: float = RANK_TOLERANCE,
) -> Array:
    """Return closed configurations (N, nq) around a closed one, the first of them that one itself.

    They are displaced along the motions that the rows leave free: from anywhere else Newton's method may turn a short
    lever over, or close loops to a flat pose nearby. Those that it does not close are left out.

    Args:
        system: closure rows, which may be redundant.
        q: (nq,) the closed configuration.
        count: number of neighbouring configurations.
        spread: displacement, before closing, of the joint that moves farthest, rad or characteristic lengths.
        tolerance: as of ``closed_near``.
        rank_tolerance: as of ``assemble``.
    """
    rng, free = np.random.default_rng(SEED), free_motions(system, q, rank_tolerance)
    starts = draw_starts(system, q, count, rng, spread=spread, along=free)
    starts = np.concatenate([q[None], starts])
    reached = assemble(system, starts, rank_tolerance=rank_tolerance, max_iterations=_ITERATIONS)
    closed = reached.residual < tolerance * system.robot.characteristic_length
    return reached.q[closed] if closed.any() else q[None]
