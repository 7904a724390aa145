"""The numbers of the programme of least time: how f depends on speed and acceleration along the path, at nodes on it.

The nodes are places p on the path, so that W, its lost directions and all coefficients are numbers; unknown are the
speed ṗ and the acceleration p̈ there, the motion of the carriers, the efforts, and the duration of each step. With
ẋ = x' ṗ and ẍ = x'' ṗ² + x' p̈ each coefficient of ``CarrierModel`` is a combination of 1, ṗ, ṗ² and p̈: four speeds
and accelerations tell them apart.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.carrier_model import TERMS, CarrierModel, carrier_model, turning_model
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.optimal.mesh import Grid
from redundancy_pin.planners.optimal.problem import SingularNode

POWERS = 4
"""1, ṗ, ṗ² and p̈: the last axis of every coefficient."""

_ROUNDING = 1e-11
"""Coefficients below this fraction of the largest are none: they would be entries of the Jacobian."""

_TOLERANCE = 1e-8
"""Deviation of the combination from the backend at another speed and acceleration that counts as rounding."""


@dataclass(frozen=True, eq=False)
class PathScales:
    """What variables are divided by.

    ``speed``, ``acceleration``: along the path, m/s and m/s²; ``s``, ``sd``, ``sdd`` (k,) of the carriers, m, m/s,
    m/s²; ``tau``: of the efforts, N or N·m; ``row`` (n,) of the rows of W τ = f; ``h``
    (M − 1,) of the steps, s; ``duration``: their sum.
    """

    speed: float
    acceleration: float
    s: Array
    sd: Array
    sdd: Array
    tau: float
    row: Array
    h: Array
    duration: float


@dataclass(frozen=True, eq=False)
class TimeOptimalProblem:
    """The numbers of the programme; M nodes, n coordinates, m main actuators, k carriers.

    ``grid``: the nodes, at places on the path, m, in place of times; ``model``: coefficients there, with an axis for
    ``POWERS`` in the end; ``singular``: nodes on type II singularities; ``fastest`` (M,) largest speed along the path,
    m/s; ``limits``: those of efforts and carriers; ``begin``, ``end``: how the carriers begin and end; ``datum`` (k,)
    where they park, m; ``lap``: the platform moves on at the end as it began; ``sizes``: scales; ``shares`` (M, c):
    fractions of the limits of efforts, forces and limited rates that the nodes may use; all of them when left out.
    """

    grid: Grid
    model: CarrierModel
    singular: tuple[SingularNode, ...]
    fastest: Array
    limits: ResolvedLimits
    begin: str
    end: str
    datum: Array
    lap: bool
    sizes: PathScales
    shares: Array | None = None

    @property
    def parts(self) -> tuple[Array, Array, Array]:
        """Fractions of the limits of efforts (M, m), forces (M, k) and of the speed (M, 1) that the nodes may use."""
        nodes, m, k = len(self.grid.t), self.model.W.shape[2], self.model.k
        shares = np.ones((nodes, m + k)) if self.shares is None else self.shares
        return shares[:, :m], shares[:, m : m + k], shares[:, m + k :].min(axis=1, initial=1.0)[:, None]


def read_model(along: DynamicsAlongMotion, dynamics: Dynamics) -> CarrierModel:
    """Read the coefficients off a backend along the path at unit speed (its derivatives are those by p).

    Raises:
        UnsupportedRobotError: f has other terms, as of dry friction, of carriers that carry one another, or of time.
    """
    motion, robot = along.motion, dynamics.robot

    def at(speed: float, acceleration: float, later: float = 0.0) -> CarrierModel:
        xdd = motion.xdd * speed**2 + motion.xd * acceleration
        there = dynamics.along(PlatformMotion(motion.t + later, motion.x, motion.xd * speed, xdd, check_rates=False))
        if robot.k:
            try:
                return carrier_model(there)
            except UnsupportedRobotError as error:
                if "deviation" not in error.details:
                    raise
            return turning_model(there)
        reduced = there.reduce()
        none = (np.zeros((len(motion), *shape)) for shape in ((robot.n, 0, TERMS), (0,), (0, TERMS)))
        by_term, force0, force_terms = none
        return CarrierModel(motion.t, reduced.W, reduced.f, by_term, force0, force_terms)

    rest, ahead, back, push, other = at(0.0, 0.0), at(1.0, 0.0), at(-1.0, 0.0), at(0.0, 1.0), at(0.7, -1.3, 0.37)
    names = [field.name for field in fields(CarrierModel)][2:]
    parts = {}
    for name in names:
        still, plus, minus, pushed, last = (np.asarray(getattr(one, name)) for one in (rest, ahead, back, push, other))
        size = max(np.abs(getattr(one, name.replace("_terms", "0"))).max(initial=0.0) for one in (ahead, push, rest))
        size = max(size, np.abs(plus).max(initial=0.0), 1e-300)
        split = np.stack([still, 0.5 * (plus - minus), 0.5 * (plus + minus) - still, pushed - still], axis=-1)
        over = tuple(range(split.ndim - (2 if name.endswith("_terms") else 1)))
        split[..., np.abs(split).max(axis=over, initial=0.0) <= _ROUNDING * size] = 0.0
        deviation = float(np.abs(split @ np.array([1.0, 0.7, 0.49, -1.3]) - last).max(initial=0.0)) / size
        if deviation > _TOLERANCE:
            raise UnsupportedRobotError(
                f"f of {robot.name} is no sum of 1, ṗ, ṗ² and p̈ along the path alone: it deviates by {deviation:.2g}.",
                remedy="Leave dry friction and loads that depend on time out, or plan at a given speed.",
            )
        parts[name] = split
    return replace(rest, **parts)
