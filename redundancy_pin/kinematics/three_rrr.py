"""Closed-form inverse kinematics of the 3-RRR: three legs of two links between a base and a platform triangle.

Leg i runs from the base hinge G over the elbow B = G + l1 u(θ) to the platform corner A = B + l2 u(β), with
A = P - l3 u(φ) and φ = α + 30°, α + 150°, α - 90°; u(θ) = (cos θ, sin θ), and v⊥ = (-v_y, v_x) is v turned by +90°.
The working mode of a leg is the sign in θ = γ ± ψ, γ the direction of A from G and ψ the angle at G in the
triangle G B A.

Arrays that differ from leg to leg are leg-major, (3, N): one row a leg, one column a sample. The links are kept
as vectors b = l1 u(θ) and e = l2 u(β), found by rotating A - G within its triangle, so that the cosine and sine of
α are the only trigonometric functions; angles are computed only where they are asked for.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, checked, read_only
from redundancy_pin.errors import InputError

CORNER_ANGLES = (np.pi / 6.0, 5.0 * np.pi / 6.0, -np.pi / 2.0)
"""φ - α of each leg, rad (Parsa 2014, eq. 2.20)."""


@dataclass(frozen=True)
class ThreeRrrGeometry:
    """Lengths that fix the kinematics of the 3-RRR, m.

    Attributes:
        base_radius: circumradius of the triangle of base hinges; the first hinge is the origin.
        platform_radius: l3, from the platform's centre to its corners.
        proximal_length: l1.
        distal_length: l2.

    Raises:
        InputError: a length is not positive and finite.
    """

    base_radius: float
    platform_radius: float
    proximal_length: float
    distal_length: float

    def __post_init__(self) -> None:
        for field in fields(self):
            length = getattr(self, field.name)
            if not (np.isfinite(length) and length > 0.0):
                raise InputError(
                    f"{field.name} is {length}.", remedy="Pass a positive length in metres.", name=field.name
                )

    @staticmethod
    def from_parameters(parameters: Mapping[str, float | bool | str]) -> ThreeRrrGeometry:
        """Read the geometry off the parameters of the model ``3rrr``."""
        return ThreeRrrGeometry(**{field.name: float(parameters[field.name]) for field in fields(ThreeRrrGeometry)})

    @property
    def base_points(self) -> Array:
        """(3, 2) base hinges G in the base frame, m."""
        triangle = np.array([[0.0, 0.0], [np.sqrt(3.0), 0.0], [np.sqrt(3.0) / 2.0, 1.5]])
        return read_only(self.base_radius * triangle)


@dataclass(frozen=True, eq=False)
class ThreeRrrLegs:
    """The legs of the 3-RRR at sampled platform poses, in one working mode; each array is (3, N).

    Attributes:
        geometry: the lengths.
        mode: sign of each leg in θ = γ ± ψ.
        arm_x, arm_y: from the platform's centre to its corner, A - P = -l3 u(φ), m.
        bx, by: proximal link b = B - G, m; NaN out of reach.
        ex, ey: distal link e = A - B, m; NaN out of reach.
        c: (A - G) x b, m²: minus l1 l2 times the sine of the elbow angle β - θ, zero at a type I
            singularity (Parsa 2014, eq. 2.37); its sign is the mode. NaN out of reach.
        gap: how far the corner is out of the leg's reach, m; where it is within, what the closure
            |A - B| = l2 leaves (a few roundings).
    """

    geometry: ThreeRrrGeometry
    mode: tuple[int, int, int]
    arm_x: Array
    arm_y: Array
    bx: Array
    by: Array
    ex: Array
    ey: Array
    c: Array
    gap: Array

    @property
    def reachable(self) -> BoolArray:
        """(3, N) whether the leg reaches its corner, to within the closure tolerance."""
        return read_only(self.gap <= CLOSURE_TOLERANCE)

    @property
    def theta(self) -> Array:
        """(3, N) angle of the proximal link, rad, in (-π, π]."""
        return read_only(np.arctan2(self.by, self.bx))

    @property
    def beta(self) -> Array:
        """(3, N) angle of the distal link, rad, in (-π, π]."""
        return read_only(np.arctan2(self.ey, self.ex))

    @property
    def elbow_sine(self) -> Array:
        """(3, N) |sin(β - θ)|, the margin to a type I singularity."""
        return read_only(np.abs(self.c) / (self.geometry.proximal_length * self.geometry.distal_length))

    @property
    def jacobian(self) -> Array:
        """(N, 3, 3) J with θ̇ = J ẋ: row i is -(a, b, d)/c (Parsa 2014, eq. 2.34-2.38)."""
        J = np.empty((self.c.shape[1], 3, 3))
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = -self.ex / self.c, -self.ey / self.c
            J[:, :, 0] = x.T
            J[:, :, 1] = y.T
            J[:, :, 2] = (self.arm_x * y - self.arm_y * x).T
        return read_only(J)

    @property
    def platform_matrix(self) -> Array:
        """(N, 3, 3) matrix of rows (a, b, d), m, m and m²; singular at a type II singularity (eq. 2.38)."""
        D = np.empty((self.c.shape[1], 3, 3))
        D[:, :, 0] = self.ex.T
        D[:, :, 1] = self.ey.T
        D[:, :, 2] = (self.arm_x * self.ey - self.arm_y * self.ex).T
        return read_only(D)


@dataclass(frozen=True, eq=False)
class ThreeRrrRates:
    """First and second rates of the link angles, each (3, N), rad/s and rad/s².

    Attributes:
        theta_rate, theta_acceleration: of the proximal links.
        beta_rate, beta_acceleration: of the distal links.
    """

    theta_rate: Array
    theta_acceleration: Array
    beta_rate: Array
    beta_acceleration: Array


def inverse_displacement(geometry: ThreeRrrGeometry, pose: ArrayLike, mode: Sequence[int] = (1, 1, 1)) -> ThreeRrrLegs:
    """Return the legs that put the platform at ``pose`` (Parsa 2014, eq. 2.18-2.27).

    With p = A - G, ρ = |p|, q = (l1² + ρ² - l2²)/2 and c = ± sqrt(l1² ρ² - q²), turning p by ±ψ gives
    b = (q p + c p⊥)/ρ². The root is twice the area of the triangle with sides l1, l2, ρ, taken in Heron's
    factored form: it keeps its digits next to a type I singularity.

    Args:
        geometry: the lengths.
        pose: (N, 3) platform centre and orientation (x, y, α) in the base frame, m and rad. NaN passes through.
        mode: sign of each leg.

    Raises:
        InputError: ``pose`` is not (N, 3) or ``mode`` not three signs.
    """
    sign = _signs(mode)
    x = np.asarray(pose, dtype=float)
    if x.ndim != 2 or x.shape[1] != 3:
        raise InputError(
            f"pose has shape {x.shape}, expected (N, 3).", remedy="Rows are samples, columns are x, y and α."
        )
    l1, l2 = geometry.proximal_length, geometry.distal_length
    arm_x, arm_y = _arms(geometry, x[:, 2])
    G = geometry.base_points
    px = x[:, 0] + arm_x - G[:, :1]
    py = x[:, 1] + arm_y - G[:, 1:]
    rho_squared = px * px + py * py
    rho = np.sqrt(rho_squared)
    shortage = np.maximum(rho - (l1 + l2), abs(l1 - l2) - rho)
    sixteen_area_squared = (rho + (l1 + l2)) * ((l1 + l2) - rho) * (rho - (l1 - l2)) * (rho + (l1 - l2))
    c = sign * (0.5 * np.sqrt(np.maximum(sixteen_area_squared, 0.0)))
    out_of_reach = shortage > CLOSURE_TOLERANCE
    if out_of_reach.any():
        c[out_of_reach] = np.nan
    q = 0.5 * (rho_squared + (l1 - l2) * (l1 + l2))
    with np.errstate(divide="ignore", invalid="ignore"):  # ρ = 0: every direction closes the leg, and c = 0 says so
        q /= rho_squared
        turn = c / rho_squared
        bx = q * px - turn * py
        by = q * py + turn * px
    ex, ey = px - bx, py - by
    gap = np.fmax(np.abs(np.sqrt(ex * ex + ey * ey) - l2), shortage)  # fmax: the shortage where there is no e
    for array in (arm_x, arm_y, bx, by, ex, ey, c, gap):
        read_only(array)
    label = (int(sign[0, 0]), int(sign[1, 0]), int(sign[2, 0]))
    return ThreeRrrLegs(geometry, label, arm_x, arm_y, bx, by, ex, ey, c, gap)


def inverse_displacement_all_modes(geometry: ThreeRrrGeometry, pose: ArrayLike) -> tuple[ThreeRrrLegs, ...]:
    """Return the legs in all eight working modes, each with its label, (1, 1, 1) first.

    Args:
        geometry: the lengths.
        pose: (N, 3) platform poses (x, y, α) in the base frame, m and rad.

    Raises:
        InputError: as ``inverse_displacement``.
    """
    return tuple(inverse_displacement(geometry, pose, mode) for mode in product((1, -1), repeat=3))


def leg_rates(legs: ThreeRrrLegs, velocity: ArrayLike, acceleration: ArrayLike) -> ThreeRrrRates:
    """Return the rates of the link angles (Parsa 2014, eq. 2.28-2.38).

    The corner moves with v_A = v + α̇ (A - P)⊥ and a_A = a + α̈ (A - P)⊥ - α̇² (A - P). Since |A - B| = l2:
    e·(v_A - v_B) = 0 and e·(a_A - a_B) + l2² β̇² = 0, with v_B = θ̇ b⊥, a_B = θ̈ b⊥ - θ̇² b and e·b⊥ = -c.
    Across the distal link, l2² β̇ = e⊥·(v_A - v_B) and l2² β̈ = e⊥·(a_A - a_B).

    Args:
        legs: the poses.
        velocity: (N, 3) rate of (x, y, α) in the base frame, m/s and rad/s.
        acceleration: (N, 3) its rate, m/s² and rad/s².

    Raises:
        InputError: wrong shapes.
    """
    samples = legs.c.shape[1]
    vx, vy, va = np.ascontiguousarray(checked(velocity, "velocity", (samples, 3)).T)
    ax, ay, aa = np.ascontiguousarray(checked(acceleration, "acceleration", (samples, 3)).T)
    bx, by, ex, ey, c = legs.bx, legs.by, legs.ex, legs.ey, legs.c
    arm_x, arm_y = legs.arm_x, legs.arm_y
    over_length = 1.0 / legs.geometry.distal_length**2
    va_squared = va * va
    corner_vx = vx - va * arm_y
    corner_vy = vy + va * arm_x
    corner_ax = ax - aa * arm_y - va_squared * arm_x
    corner_ay = ay + aa * arm_x - va_squared * arm_y
    with np.errstate(divide="ignore", invalid="ignore"):
        over_c = -1.0 / c
        theta_rate = (ex * corner_vx + ey * corner_vy) * over_c
        theta_rate_squared = theta_rate * theta_rate
        across_v = ex * (corner_vy - theta_rate * bx) - ey * (corner_vx + theta_rate * by)
        beta_rate = across_v * over_length
        pull_x = corner_ax + theta_rate_squared * bx
        pull_y = corner_ay + theta_rate_squared * by
        theta_acceleration = (ex * pull_x + ey * pull_y + across_v * beta_rate) * over_c
        pull_x += theta_acceleration * by
        pull_y -= theta_acceleration * bx
        beta_acceleration = (ex * pull_y - ey * pull_x) * over_length
    for array in (theta_rate, theta_acceleration, beta_rate, beta_acceleration):
        read_only(array)
    return ThreeRrrRates(theta_rate, theta_acceleration, beta_rate, beta_acceleration)


def _arms(geometry: ThreeRrrGeometry, alpha: Array) -> tuple[Array, Array]:
    offset = np.array(CORNER_ANGLES)[:, None]
    cos_offset = -geometry.platform_radius * np.cos(offset)
    sin_offset = -geometry.platform_radius * np.sin(offset)
    cos_alpha, sin_alpha = np.cos(alpha), np.sin(alpha)
    return cos_offset * cos_alpha - sin_offset * sin_alpha, sin_offset * cos_alpha + cos_offset * sin_alpha


def _signs(mode: Sequence[int]) -> Array:
    if len(mode) != 3 or any(sign not in (1, -1) for sign in mode):
        raise InputError(f"mode is {tuple(mode)}.", remedy="Pass one sign, 1 or -1, for each of the three legs.")
    return np.array(mode, dtype=float)[:, None]
