"""Main efforts as exact polynomials of the carrier motion: τ = W⁻¹ f, formed once for all carrier motions."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import DynamicsAlongMotion, ReducedDynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.status import SampleStatus
from redundancy_pin.errors import InfeasiblePlanError, UnsupportedRobotError
from redundancy_pin.planners.carrier_model import CarrierModel, carrier_model, terms


@dataclass(frozen=True, eq=False)
class EffortModel:
    """Coefficients of the main efforts at N instants.

    N samples, m main actuators, k carriers; last axis of ``tau_terms``: s, s², ṡ, s ṡ, s̈.

    Attributes:
        t: (N,) time, s.
        tau0: (N, m) efforts with the carriers at rest at s = 0, N or N·m.
        tau_terms: (N, m, k, 5) coefficients, by carrier and term.
        margin: (N,) smallest singular value of the scaled W.
    """

    t: Array
    tau0: Array
    tau_terms: Array
    margin: Array

    def tau(self, s: Array, sd: Array, sdd: Array) -> Array:
        """Return efforts (N, m) for a carrier motion, each (N, k)."""
        value: Array = self.tau0 + np.einsum("nmkj,nkj->nm", self.tau_terms, terms(s, sd, sdd))
        return value


def effort_model(along: DynamicsAlongMotion, least_margin: float) -> EffortModel:
    """Read the coefficients of the main efforts off a backend.

    With more actuators than freedoms the efforts are those of least norm, as ``distribute`` defines it: they too are
    linear in f.

    Args:
        along: dynamics along a platform motion, from either backend.
        least_margin: smallest margin of W along the motion that is accepted.

    Raises:
        UnsupportedRobotError: no carriers, carriers on curved tracks, fewer actuators than freedoms, or more carriers
            than actuators.
        InfeasiblePlanError: the motion meets or crosses a type II singularity, or comes closer than ``least_margin``.
    """
    robot = along.robot
    if robot.k > robot.m or robot.m < robot.n:
        raise UnsupportedRobotError(
            f"{robot.name} has {robot.n} freedoms, {robot.m} main actuators and {robot.k} carriers; the carriers of "
            "least effort are not determined.",
            remedy="This planner needs at least as many main actuators as freedoms and as carriers.",
            n=robot.n,
            m=robot.m,
            k=robot.k,
        )
    model = carrier_model(along)
    inverse, margin = _inverse(along.reduce())
    _require_regular(model, margin, least_margin)
    return EffortModel(
        model.t,
        read_only(np.einsum("nmi,ni->nm", inverse, model.f0)),
        read_only(np.einsum("nmi,nikj->nmkj", inverse, model.f_terms)),
        margin,
    )


def _inverse(reduced: ReducedDynamics) -> tuple[Array, Array]:
    """Return (N, m, n) the map from f to the efforts, and (N,) the margin of W.

    The map is what ``distribute`` makes of each unit vector; NaN where W lacks rank.
    """
    samples, n = reduced.f.shape
    unit = np.tile(np.eye(n), (samples, 1))
    each = {
        name: np.repeat(getattr(reduced, name), n, axis=0) for name in ("t", "W", "carrier_force", "reachable", "gap")
    }
    solved = distribute(replace(reduced, f=unit, **each))
    efforts = np.where((solved.status > SampleStatus.NEAR_SINGULAR)[:, None], np.nan, solved.tau)
    return efforts.reshape(samples, n, -1).swapaxes(1, 2), read_only(np.array(solved.margin[::n]))


def _require_regular(model: CarrierModel, margin: Array, least_margin: float) -> None:
    worst = int(np.argmin(margin))
    remedy = "Plan with plan_switch_off, which crosses it, or lead the platform along another path."
    if margin[worst] < least_margin:
        raise InfeasiblePlanError(
            f"The motion comes too close to a type II singularity: at t = {model.t[worst]:.6g} s the margin of W is "
            f"{margin[worst]:.3g}, below {least_margin:.3g}; this planner needs W⁻¹.",
            remedy=remedy,
            constraint="margin",
            time=float(model.t[worst]),
            margin=float(margin[worst]),
        )
    if model.W.shape[1] == model.W.shape[2]:
        side = np.sign(np.linalg.det(model.W))
        crossed = np.flatnonzero(side[1:] != side[:-1])
        if len(crossed):
            j = int(crossed[0])
            raise InfeasiblePlanError(
                f"The motion crosses a type II singularity between t = {model.t[j]:.6g} and {model.t[j + 1]:.6g} s "
                f"(margins {margin[j]:.3g} and {margin[j + 1]:.3g}).",
                remedy=remedy,
                constraint="margin",
                time=float(model.t[j]),
                margin=0.0,
            )
