"""Where the carriers cannot act in some direction, and whether anything has to be carried there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, frozen
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.kinematics.spectrum import null_directions, spectrum_of
from redundancy_pin.planners.carrier_equation import CarrierEquation
from redundancy_pin.planners.dips import minima, sampling

RANK_LOSS = 1e-8
"""Smallest singular value of F, as a fraction of its largest, that counts as zero at a minimum found by search."""

BALANCED = 1e-7
"""Fraction of f that may be left along the direction in which the carriers cannot act: at such an instant, known to
1e-8 of the motion where it only touches the singularity, f is still off by a multiple of that."""


ACTUATED = 1e-6
"""Fraction of W along a direction below which the main actuators have no effect in it."""


@dataclass(frozen=True, eq=False)
class LostDirection:
    """An instant at which the accelerations of the carriers have no effect in one direction.

    Attributes:
        t: time, s.
        direction: (n,) unit vector u, scaled coordinates, with uᵀ F = 0.
        parked: uᵀ(f − W τ_ref) with the carriers at rest at s = 0, N.
        by_motion: largest coefficient of uᵀ f by s, s², ṡ or s ṡ of a carrier; where it is zero the carriers cannot
            change what is left, whatever they do.
        by_main: whether the main actuators, were they on, would have an effect along u. They have on the 2-RPR, whose
            legs push where its carriers cannot; not where carriers and actuators act through the same joints.
    """

    t: float
    direction: Array
    parked: float
    by_motion: float
    by_main: bool

    def left(self, equation: CarrierEquation, s: Array, sd: Array) -> float:
        """Return uᵀ(f − W τ_ref), N, for carriers at s with speed ṡ, (k,) each."""
        model = equation.model.at(np.array([self.t]))
        load = np.einsum("nij,nj->ni", model.W, equation.effort(model.t))
        force = (model.f(s[None], sd[None], np.zeros((1, model.k))) - load) / equation.row_scale
        return float(force[0] @ self.direction)


def lost_directions(equation: CarrierEquation, start: float, end: float) -> list[LostDirection]:
    """Return the instants between two times at which F lacks rank.

    Raises:
        InfeasiblePlanError: F lacks rank all along.
    """
    model = equation.model
    times = sampling(model.interpolant.edges, start, end)
    n = len(equation.row_scale)

    def forces(t: Array) -> Array:
        matrices: Array = model.at(t).f_terms[..., 4] / equation.row_scale[:, None]
        return matrices

    largest = float(spectrum_of(forces(times)).singular_values.max())

    def smallest(t: Array) -> Array:
        value: Array = spectrum_of(forces(t)).singular_values[:, n - 1] / largest
        return value

    if largest == 0.0 or np.median(smallest(times)) < RANK_LOSS:
        raise InfeasiblePlanError(
            f"From t = {start:.6g} s to {end:.6g} s there is a direction in which accelerating the carriers has no "
            "effect.",
            remedy="Their tracks have to be laid so that the carriers act in every coordinate (on the 2-RPR: away "
            "from the base hinge), or the motion must leave the singularity.",
            constraint="carrier_effect",
            time=start,
            amount=end - start,
        )
    found = []
    for t, value in minima(smallest, times, RANK_LOSS):
        if value >= RANK_LOSS:
            continue
        u = null_directions(forces(np.array([t])))[0][0]
        here = model.at(np.array([t]))
        parked = (here.f0 - np.einsum("nij,nj->ni", here.W, equation.effort(here.t)))[0] / equation.row_scale
        by_motion = np.einsum("i,ikj->kj", u / equation.row_scale, here.f_terms[0, :, :, :4])
        W = here.W[0] / equation.row_scale[:, None]
        by_main = bool(np.abs(u @ W).max() > ACTUATED * np.abs(W).max())
        found.append(LostDirection(t, frozen(u), float(u @ parked), float(np.abs(by_motion).max()), by_main))
    return found


def require_balanced(equation: CarrierEquation, lost: Sequence[LostDirection]) -> None:
    """Check that where the carriers cannot act, and cannot change what is left, nothing is left.

    Raises:
        InfeasiblePlanError: something is; carries the force, its direction and the time.
    """
    for instant in lost:
        helpless = instant.by_motion <= BALANCED * equation.size
        if helpless and abs(instant.parked) > BALANCED * equation.size:
            raise nothing_carries(instant, instant.parked, "whatever the carriers do")


def nothing_carries(instant: LostDirection, force: float, circumstance: str) -> InfeasiblePlanError:
    """Return the error that says which force nothing can carry.

    Args:
        instant: where and in which direction.
        force: uᵀ(f − W τ_ref), N.
        circumstance: for which motion of the carriers.
    """
    direction = np.round(np.sign(force) * instant.direction, 12) + 0.0  # no negative zeros
    along = ", ".join(f"{component:.6f}" for component in direction)
    return InfeasiblePlanError(
        f"At the singular pose, t = {instant.t:.6g} s, nothing can carry the inertial force: the motion needs "
        f"{abs(force):.6g} N along ({along}), but the main actuators are off there and no acceleration of the carriers "
        f"has an effect in this direction ({circumstance}).",
        remedy="Pass the singularity without acceleration along this direction or without the masses that need it"
        + (", or leave the main actuators on: they could carry it." if instant.by_main else "."),
        constraint="singular_pose",
        time=instant.t,
        amount=abs(force),
        main_actuators_could=instant.by_main,
        direction=tuple(float(component) for component in direction),
    )
