"""Least time along a path by toppra, through its own constraint interface: no carriers."""

from __future__ import annotations

import functools
from itertools import combinations
from typing import Any

import numpy as np
import toppra
from toppra.algorithm import TOPPRA

from redundancy_pin import PlatformMotion
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.trajectory import Path


def reduced(dynamics: Dynamics, path: Path, p: Any, pd: Any, pdd: Any) -> Any:
    """Load at places of a path, (N,), at speeds and accelerations along it."""
    x, tangent, curvature = path.evaluate(np.atleast_1d(p))
    motion = PlatformMotion([0.0], x, pd * tangent, pdd * tangent + pd**2 * curvature, check_rates=False)
    return dynamics.reduce(motion)


class _Along(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
    """The place on a path and the main joints; of the latter the rate alone, for which toppra asks."""

    def __init__(self, dynamics: Dynamics, path: Path) -> None:
        self.dynamics, self.own = dynamics, path

    @property
    def dof(self) -> int:
        return 1 + self.dynamics.robot.m

    @property
    def path_interval(self) -> Any:
        return np.array([0.0, self.own.length])

    def __call__(self, places: Any, order: int = 0) -> Any:
        values = np.zeros((np.size(places), self.dof))
        values[:, 0] = places if order == 0 else 2 - order
        if order == 1:
            for row, place in zip(values, np.atleast_1d(places), strict=True):
                row[1:] = reduced(self.dynamics, self.own, place, 0.0, 0.0).W[0].T @ self.own.evaluate([place])[1][0]
        return values if np.ndim(places) else values[0]


def least_time(dynamics: Dynamics, path: Path, effort: float, rate: float = np.inf, steps: int = 400) -> float:
    """Duration by toppra: the loads that efforts can balance are a zonotope, whose facets are its constraint."""
    m = dynamics.robot.m
    sides = np.array(list(combinations(range(m), dynamics.robot.n - 1)))

    @functools.cache
    def facets(place: float) -> Any:
        W = reduced(dynamics, path, place, 0.0, 0.0).W[0]
        across = np.linalg.svd(W[:, sides].transpose(1, 2, 0))[2][:, -1]
        return np.vstack([across, -across]), np.tile(effort * np.abs(across @ W).sum(axis=1), 2)

    def load(q: Any, qd: Any, qdd: Any) -> Any:
        return reduced(dynamics, path, q[0], qd[0], qdd[0]).f[0]

    curve = _Along(dynamics, path)
    limits = [
        toppra.constraint.SecondOrderConstraint(load, lambda q: facets(q[0])[0], lambda q: facets(q[0])[1], m + 1)
    ]
    if rate < np.inf:
        fastest = np.append(1e3, np.full(m, rate))
        limits.append(toppra.constraint.JointVelocityConstraint(np.stack([-fastest, fastest], axis=1)))
    before = np.array(path.breaks) - 1e-9  # the curvature jumps
    places = np.unique(np.concatenate([np.linspace(0.0, path.length, steps + 1), before, path.breaks]))
    speed = TOPPRA(limits, curve, gridpoints=places).compute_parameterization(0.0, 0.0)[1]
    return float((2.0 * np.diff(places) / (speed[1:] + speed[:-1])).sum())
