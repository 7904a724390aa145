"""The actuation matrix and the carrier model as functions of time.

Both are read off the backend in a few batched calls and then interpolated to rounding, so that root finding and the
integration of the carriers' motion can ask for any time without calling the backend again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.planners.carrier_model import TERMS, CarrierModel, carrier_model
from redundancy_pin.planners.continuous_motion import ContinuousMotion
from redundancy_pin.planners.piecewise_chebyshev import PiecewiseChebyshev, fit
from redundancy_pin.trajectory import Side

ACTUATION_TOLERANCE = 1e-11
"""Of the interpolated W, relative to its largest entry: the times of a window are then exact to about 1e-11 of it."""

MODEL_TOLERANCE = 1e-12
"""Of each group of coefficients, relative to its largest entry."""

SAMPLED_TOLERANCE = 1e-9
"""Of the same where the motion was sampled: the quintics between samples a few milliseconds apart meet with kinks below
this, and resolving every one of them would be of no use."""

_LEAST_GROUP = 1e-4
"""A group smaller than this fraction of the largest is held to the tolerance of this size: the rounding of a backend
does not shrink with the group."""


@dataclass(frozen=True, eq=False)
class TimedActuation:
    """W as a function of time."""

    interpolant: PiecewiseChebyshev
    shape: tuple[int, int]

    @staticmethod
    def of(dynamics: Dynamics, motion: ContinuousMotion) -> TimedActuation:
        """Read W off a backend along a whole motion."""

        def values(times: Array) -> Array:
            W = np.asarray(dynamics.along(motion.sample_at(times)).reduce().W)
            return W.reshape(len(times), -1)

        edges = _edges(motion, motion.start, motion.end)
        tolerance = ACTUATION_TOLERANCE if motion.exact else SAMPLED_TOLERANCE
        found = fit(values, edges, motion.knots, lambda v: np.full(v.shape[1], np.abs(v).max()), tolerance)
        return TimedActuation(found, (dynamics.robot.n, dynamics.robot.m))

    def at(self, times: Array) -> Array:
        """Return W (N, n, m) at (N,) times."""
        return self.interpolant(times).reshape(len(times), *self.shape)


@dataclass(frozen=True, eq=False)
class TimedModel:
    """The carrier model as a function of time.

    Attributes:
        start, end: interval, s.
        breaks: (b,) inner times at which f may jump, s.
        knots: (c,) further ends of the pieces, s.
        interpolant: all coefficients side by side.
        tolerance: of the coefficients, relative.
        n, m, k: numbers of coordinates, main actuators and carriers.
    """

    start: float
    end: float
    breaks: Array
    knots: Array
    interpolant: PiecewiseChebyshev
    tolerance: float
    n: int
    m: int
    k: int

    @staticmethod
    def of(dynamics: Dynamics, motion: ContinuousMotion, start: float, end: float) -> TimedModel:
        """Read the model off a backend over a part of a motion.

        Raises:
            UnsupportedRobotError: see ``carrier_model``.
        """
        robot = dynamics.robot

        def values(times: Array) -> Array:
            model = carrier_model(dynamics.along(motion.sample_at(times)))
            parts = (model.W, model.f0, model.f_terms, model.force0, model.force_terms)
            return np.concatenate([np.asarray(part).reshape(len(times), -1) for part in parts], axis=1)

        def scale(found: Array) -> Array:
            group = _groups(robot.n, robot.m, robot.k)
            largest = np.array([np.abs(found[:, group == g]).max() for g in range(group.max() + 1)])
            limited: Array = np.maximum(largest, _LEAST_GROUP * largest.max())[group]
            return limited

        tolerance = MODEL_TOLERANCE if motion.exact else SAMPLED_TOLERANCE
        interpolant = fit(values, _edges(motion, start, end), motion.knots, scale, tolerance)
        inner = motion.breaks[(motion.breaks > start) & (motion.breaks < end)]
        knots = np.setdiff1d(interpolant.edges[1:-1], inner)
        return TimedModel(start, end, inner, knots, interpolant, tolerance, robot.n, robot.m, robot.k)

    def at(self, times: Array, side: Side = "right") -> CarrierModel:
        """Return the model at (N,) times inside the interval; ``side`` decides at a break."""
        instants = np.atleast_1d(np.asarray(times, dtype=np.float64))
        W, f0, f_terms, force0, force_terms = np.split(
            self.interpolant(instants, side), np.cumsum(_sizes(self.n, self.m, self.k))[:-1], axis=1
        )
        count = len(instants)
        return CarrierModel(
            instants,
            W.reshape(count, self.n, self.m),
            f0,
            f_terms.reshape(count, self.n, self.k, TERMS),
            force0,
            force_terms.reshape(count, self.k, TERMS),
        )


def _edges(motion: ContinuousMotion, start: float, end: float) -> Array:
    """Return the ends of the first pieces: jumps, and the few kinks of a trajectory."""
    inner = np.concatenate([motion.breaks, motion.knots]) if motion.exact else motion.breaks
    inner = np.unique(inner[(inner > start) & (inner < end)])
    edges: Array = np.concatenate([[start], inner, [end]])
    return edges


def _sizes(n: int, m: int, k: int) -> list[int]:
    return [n * m, n, n * k * TERMS, k, k * TERMS]


def _groups(n: int, m: int, k: int) -> Array:
    """Return (C,) the group of each coefficient: those of one unit are held to one tolerance."""
    terms = np.arange(TERMS)
    groups: Array = np.concatenate(
        [
            np.zeros(n * m, dtype=int),
            np.full(n, 1),
            2 + np.tile(terms, n * k),
            np.full(k, 2 + TERMS),
            3 + TERMS + np.tile(terms, k),
        ]
    )
    return groups
