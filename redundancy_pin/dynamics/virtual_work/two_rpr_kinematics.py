"""Closed-form kinematics of the 2-RPR: two prismatic legs on free base hinges A1 = (0, 0), A2 = (base distance, 0).

Leg i spans B - A_i = d_i u_i with u = (cos θ, sin θ) and n = (-sin θ, cos θ). The working mode of a leg is the
sign of d; its assembly mode is the side of the base line the end-effector B is on. Arrays that differ from leg
to leg are leg-major, (2, N): one row a leg, one column a sample. No trigonometric function is needed: u is
kept as a vector, and θ is computed only where it is asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, checked, read_only
from redundancy_pin.errors import InputError


@dataclass(frozen=True)
class TwoRprGeometry:
    """Lengths that fix the kinematics of the 2-RPR.

    Attributes:
        base_distance: distance of the two base hinges, m.

    Raises:
        InputError: the distance is not positive and finite.
    """

    base_distance: float

    def __post_init__(self) -> None:
        if not (np.isfinite(self.base_distance) and self.base_distance > 0.0):
            raise InputError(
                f"base_distance is {self.base_distance}.",
                remedy="Pass a positive length in metres.",
                name="base_distance",
            )

    @staticmethod
    def from_parameters(parameters: Mapping[str, float | bool | str]) -> TwoRprGeometry:
        """Read the geometry off the parameters of the model ``2rpr``."""
        return TwoRprGeometry(base_distance=float(parameters["base_distance"]))

    @property
    def base_x(self) -> Array:
        """(2, 1) abscissa of the base hinges, m; both lie on y = 0."""
        return read_only(np.array([[0.0], [self.base_distance]]))


@dataclass(frozen=True, eq=False)
class TwoRprLegs:
    """The legs of the 2-RPR at sampled positions of the end-effector, in one working mode.

    Attributes:
        mode: sign of d of each leg.
        d: (2, N) signed leg length, m.
        ux, uy: (2, N) direction of the leg in the base frame; NaN where d = 0.
        gap: (2, N) what the closure A + d u = B leaves, m; a few roundings, and 0 where d = 0.
    """

    mode: tuple[int, int]
    d: Array
    ux: Array
    uy: Array
    gap: Array

    @property
    def theta(self) -> Array:
        """(2, N) angle of u against the base line, rad, in (-π, π]."""
        return read_only(np.arctan2(self.uy, self.ux))

    @property
    def jacobian(self) -> Array:
        """(N, 2, 2) J with ḋ = J ẋ; row i is u_i (Parsa 2014, eq. 2.2)."""
        J = np.empty((self.d.shape[1], 2, 2))
        J[:, :, 0] = self.ux.T
        J[:, :, 1] = self.uy.T
        return read_only(J)


@dataclass(frozen=True, eq=False)
class TwoRprRates:
    """First and second rates of the legs, each (2, N).

    Attributes:
        d_rate, d_acceleration: of the leg length, m/s and m/s².
        theta_rate, theta_acceleration: of the leg angle, rad/s and rad/s².
    """

    d_rate: Array
    d_acceleration: Array
    theta_rate: Array
    theta_acceleration: Array


@dataclass(frozen=True, eq=False)
class TwoRprAssembly:
    """One assembly mode of the 2-RPR at sampled leg lengths.

    Attributes:
        mode: +1 with the end-effector above the base line, -1 below; on the line the two coincide.
        point: (N, 2) end-effector B in the base frame, m; NaN where the legs do not meet.
        reachable: (N,) whether they do.
        gap: (N,) by how much they fail to meet, m; 0 where they do.
    """

    mode: int
    point: Array
    reachable: BoolArray
    gap: Array


def inverse_displacement(geometry: TwoRprGeometry, point: ArrayLike, mode: Sequence[int] = (1, 1)) -> TwoRprLegs:
    """Return the legs that put the end-effector at ``point`` (Parsa 2014, eq. 2.1).

    Args:
        geometry: the lengths.
        point: (N, 2) end-effector B in the base frame, m. NaN passes through.
        mode: sign of d of each leg.

    Raises:
        InputError: ``point`` is not (N, 2) or ``mode`` not two signs.
    """
    sign = _signs(mode)
    B = np.asarray(point, dtype=float)
    if B.ndim != 2 or B.shape[1] != 2:
        raise InputError(
            f"point has shape {B.shape}, expected (N, 2).", remedy="Rows are samples, columns are x and y."
        )
    x = B[:, 0] - geometry.base_x
    y = np.broadcast_to(B[:, 1], x.shape)
    d = np.hypot(x, y) * sign
    with np.errstate(divide="ignore", invalid="ignore"):  # d = 0 has no direction: NaN says so
        ux, uy = x / d, y / d
    gap = np.hypot(d * ux - x, d * uy - y)
    gap[d == 0.0] = 0.0  # whatever its direction
    for array in (d, ux, uy, gap):
        read_only(array)
    return TwoRprLegs((int(sign[0, 0]), int(sign[1, 0])), d, ux, uy, gap)


def inverse_displacement_all_modes(geometry: TwoRprGeometry, point: ArrayLike) -> tuple[TwoRprLegs, ...]:
    """Return the legs in all four working modes, each with its label, (1, 1) first.

    Args:
        geometry: the lengths.
        point: (N, 2) end-effector in the base frame, m.

    Raises:
        InputError: as ``inverse_displacement``.
    """
    return tuple(inverse_displacement(geometry, point, mode) for mode in product((1, -1), repeat=2))


def leg_rates(legs: TwoRprLegs, velocity: ArrayLike, acceleration: ArrayLike) -> TwoRprRates:
    """Return the rates of the legs (Parsa 2014, eq. 2.2-2.9).

    From B = A + d u: v = ḋ u + d θ̇ n and a = (d̈ - d θ̇²) u + (d θ̈ + 2 ḋ θ̇) n, read along u and n.

    Args:
        legs: the pose.
        velocity: (N, 2) of the end-effector in the base frame, m/s.
        acceleration: (N, 2) of the end-effector, m/s².

    Raises:
        InputError: wrong shapes.
    """
    samples = legs.d.shape[1]
    v = checked(velocity, "velocity", (samples, 2))
    a = checked(acceleration, "acceleration", (samples, 2))
    vx, vy, ax, ay = v[:, 0], v[:, 1], a[:, 0], a[:, 1]
    ux, uy, d = legs.ux, legs.uy, legs.d
    with np.errstate(divide="ignore", invalid="ignore"):
        d_rate = ux * vx + uy * vy
        theta_rate = (ux * vy - uy * vx) / d
        d_acceleration = ux * ax + uy * ay + d * theta_rate**2
        theta_acceleration = (ux * ay - uy * ax - 2.0 * d_rate * theta_rate) / d
    for array in (d_rate, d_acceleration, theta_rate, theta_acceleration):
        read_only(array)
    return TwoRprRates(d_rate, d_acceleration, theta_rate, theta_acceleration)


def forward_displacement(geometry: TwoRprGeometry, d: ArrayLike) -> tuple[TwoRprAssembly, TwoRprAssembly]:
    """Return both positions of the end-effector that given leg lengths allow, above the base line first.

    B is where the circles of radius |d_i| about A_i meet. The height over the base follows from the area of
    the triangle A1 A2 B in factored form, which keeps its digits where the triangle is almost flat.

    Args:
        geometry: the lengths.
        d: (2, N) signed leg lengths, m.

    Raises:
        InputError: ``d`` is not (2, N) or not finite.
    """
    d1, d2 = np.abs(checked(d, "d", (2, "N")))
    D = geometry.base_distance
    gap = np.maximum(np.maximum(D - d1 - d2, np.abs(d1 - d2) - D), 0.0)
    reachable = read_only(gap <= CLOSURE_TOLERANCE)
    x = ((d1 - d2) * (d1 + d2) + D * D) / (2.0 * D)
    sixteen_area_squared = (d1 + d2 + D) * (d1 + d2 - D) * (D + d1 - d2) * (D - d1 + d2)
    y = np.sqrt(np.maximum(sixteen_area_squared, 0.0)) / (2.0 * D)
    x[~reachable] = np.nan
    y[~reachable] = np.nan
    read_only(gap)
    above, below = (
        TwoRprAssembly(mode, read_only(np.stack([x, mode * y], axis=1)), reachable, gap) for mode in (1, -1)
    )
    return above, below


def _signs(mode: Sequence[int]) -> Array:
    if len(mode) != 2 or any(sign not in (1, -1) for sign in mode):
        raise InputError(f"mode is {tuple(mode)}.", remedy="Pass one sign, 1 or -1, for each of the two legs.")
    return np.array(mode, dtype=float)[:, None]
