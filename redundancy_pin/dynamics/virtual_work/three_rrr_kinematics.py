"""Closed-form inverse kinematics of the 3-RRR: three legs of two links between a base and a platform triangle.

Leg i runs from the base hinge G over the elbow B = G + l1 u(θ) to the platform corner A = B + l2 u(β), with
A = P - l3 u(φ) and φ = α + 30°, α + 150°, α - 90°; u(θ) = (cos θ, sin θ), and v⊥ = (-v_y, v_x) is v turned by +90°.
The working mode of a leg is the sign in θ = γ ± ψ, γ the direction of A from G and ψ the angle at G in the
triangle G B A.

Arrays that differ from leg to leg are leg-major, (3, N): one row a leg, one column a sample. The links are kept
as vectors b = l1 u(θ) and e = l2 u(β), found by rotating A - G within its triangle, so that the cosine and sine of
α are the only trigonometric functions; angles are computed only where they are asked for.

Forward displacement of the 3-RRR: every platform pose that given base angles allow.

With the elbows B_i fixed, the platform centre P lies at distance l2 from each of the three centres
C_i(α) = B_i + l3 u(φ_i): the three centres have a circumcircle of radius l2 and P is its centre. Writing
r_ij = |C_i - C_j|² and D = (C_2 - C_1) x (C_3 - C_1), the product of the sides is twice the circumradius times
twice the area, so that P is eliminated exactly:

    r_12 r_23 r_31 = 4 l2² D².

Each r_ij and D is a first-degree trigonometric polynomial in α, so this is a Laurent polynomial of degree 3 in
z = exp(iα): at most six assembly modes. Where two centres coincide, both sides have a double zero, which can stand for
two poses. A root is therefore only a candidate for α: both positions that the two best-separated centres allow are
tried, and a pose counts only after Newton's method has closed all three legs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import combinations, product
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, checked, read_only
from redundancy_pin.errors import InputError, SingularPoseError

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


_UNIT_CIRCLE_BAND = 0.1
"""Roots with | |z| - 1 | below this are tried. Rounding moves a root of multiplicity four by 1e-4; the rest of the
band costs a few steps of Newton's method and can add no pose that does not close."""

_FOLD = 1e-6
"""Poses nearer than this (relative to l2, and radians) are one, and a scaled determinant below it counts as zero. Where
two assembly modes meet (a fold), closing the legs to rounding fixes a pose to the square root of rounding, 1e-8."""

_CUSP = 1e-4
"""The same distance where the determinant is below ``_FOLD`` / 10 at both poses. Where three assembly modes meet (a
cusp) a pose is fixed to the cube root of rounding, 1e-5, and the determinant grows as the distance squared."""

_NEWTON_PHASES = ((50, 1e-14), (5, 1e-5))
"""Steps, and the fraction of the largest singular value of the rows (a, b, d) below which a direction is left out of a
step. The first phase halves the error each step even at a fold: fifty halvings pass from 1 to rounding. At a cusp it
bounces along the slack direction; the second phase leaves that alone and closes the legs across it."""


@dataclass(frozen=True, eq=False)
class ThreeRrrAssembly:
    """One assembly mode of the 3-RRR.

    Attributes:
        index: place in the order of growing α in (-π, π], counted from 0.
        sign: sign of the determinant of the rows (a, b, d) of eq. 2.38; it changes at a type II singularity. It is 0
            there, where two assembly modes have become one to the accuracy a pose can be found with.
        pose: (3,) x, y, m, and α, rad, in the base frame.
        determinant: that determinant divided by l2³ times the platform radius: the margin to type II.
        residual: largest error of |A_i - B_i| against l2, m.
    """

    index: int
    sign: int
    pose: Array
    determinant: float
    residual: float


def forward_displacement(geometry: ThreeRrrGeometry, theta: ArrayLike) -> tuple[ThreeRrrAssembly, ...]:
    """Return all real assembly modes at given base angles, none to six, in the order of growing α.

    Args:
        geometry: the lengths.
        theta: (3,) angles of the proximal links, rad.

    Raises:
        InputError: ``theta`` is not three finite numbers.
        SingularPoseError: the platform moves with all base joints locked: the three centres coincide at some α, or
            the three elbows do and the distal links are as long as the platform's radius.
    """
    angle = checked(theta, "theta", (3,))
    elbows = geometry.base_points + geometry.proximal_length * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    starts = [start for alpha in _orientations(geometry, elbows) for start in _positions(geometry, elbows, alpha)]
    if not starts:
        return ()
    poses, determinants, residuals = _polished(geometry, elbows, np.array(starts))
    kept: list[int] = []
    for k in np.argsort(residuals):
        if residuals[k] <= CLOSURE_TOLERANCE and not any(_same(geometry, poses, determinants, k, j) for j in kept):
            kept.append(int(k))
    kept.sort(key=lambda k: float(poses[k, 2]))
    return tuple(
        ThreeRrrAssembly(
            index=index,
            sign=0 if abs(determinants[k]) < _FOLD else int(np.sign(determinants[k])),
            pose=read_only(poses[k].copy()),
            determinant=float(determinants[k]),
            residual=float(residuals[k]),
        )
        for index, k in enumerate(kept)
    )


def _orientations(geometry: ThreeRrrGeometry, elbows: Array) -> Array:
    """Return (M,) orientations α at which the eliminated equation holds, or nearly so.

    In complex numbers C_i - C_j = b + w z with b = B_i - B_j and w = l3 (exp(i o_i) - exp(i o_j)), |z| = 1;
    each factor is written as its three coefficients, of z, 1 and 1/z.
    """
    B = elbows[:, 0] + 1j * elbows[:, 1]
    corner = geometry.platform_radius * np.exp(1j * np.array(CORNER_ANGLES))

    def squared_side(i: int, j: int) -> NDArray[np.complex128]:
        b, w = B[i] - B[j], corner[i] - corner[j]
        return np.array([w * np.conj(b), abs(b) ** 2 + abs(w) ** 2, np.conj(w) * b])

    b2, b3, w2, w3 = B[1] - B[0], B[2] - B[0], corner[1] - corner[0], corner[2] - corner[0]
    z = -np.conj(w2) * b2 / abs(w2) ** 2  # where the first two centres coincide, if it has modulus 1
    if max(abs(abs(z) - 1.0) * abs(w2), abs(b3 + w3 * z)) <= CLOSURE_TOLERANCE:
        alpha = float(np.angle(z))
        _refuse_self_motion(
            f"The elbows form the platform's own triangle: at α = {alpha:.9g} rad the platform moves on a circle"
        )
    # D is the imaginary part of conj(b2 + w2 z)(b3 + w3 z).
    linear = (np.conj(b2) * w3 - w2 * np.conj(b3)) / 2j
    twice_area = np.array([linear, np.imag(np.conj(b2) * b3 + np.conj(w2) * w3), np.conj(linear)])
    polynomial = np.convolve(np.convolve(squared_side(0, 1), squared_side(1, 2)), squared_side(2, 0))
    size = np.abs(polynomial).max()
    polynomial[1:-1] -= 4.0 * geometry.distal_length**2 * np.convolve(twice_area, twice_area)
    if np.abs(polynomial).max() <= CLOSURE_TOLERANCE * size:
        _refuse_self_motion("The elbows coincide and the distal links are as long as the platform's radius: it turns")
    roots = np.roots(polynomial)
    alpha_all: Array = np.angle(roots[np.abs(np.abs(roots) - 1.0) < _UNIT_CIRCLE_BAND])
    return alpha_all


def _refuse_self_motion(what: str) -> NoReturn:
    raise SingularPoseError(
        f"{what} with the base joints locked, so the assembly modes are not isolated.",
        remedy="Change a base angle.",
    )


def _positions(geometry: ThreeRrrGeometry, elbows: Array, alpha: float) -> list[Array]:
    """Return both poses at orientation α that close the two legs whose centres are farthest apart."""
    phi = alpha + np.array(CORNER_ANGLES)
    centres = elbows + geometry.platform_radius * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    i, j = max(combinations(range(3), 2), key=lambda pair: float(np.hypot(*(centres[pair[0]] - centres[pair[1]]))))
    middle, side = (centres[i] + centres[j]) / 2.0, centres[j] - centres[i]
    length = float(np.hypot(*side))
    height = np.sqrt(max(geometry.distal_length**2 - length**2 / 4.0, 0.0))
    across = np.array([-side[1], side[0]]) * (height / length)
    return [np.append(middle + way * across, alpha) for way in (1.0, -1.0)]


def _closure(geometry: ThreeRrrGeometry, elbows: Array, poses: Array) -> tuple[Array, Array, Array]:
    """Return the errors (|e|² - l2²)/(2 l2), (M, 3), the rows (a, b, d), (M, 3, 3), and ||e| - l2|, (M, 3)."""
    phi = poses[:, 2:] + np.array(CORNER_ANGLES)
    arm_x, arm_y = -geometry.platform_radius * np.cos(phi), -geometry.platform_radius * np.sin(phi)
    ex, ey = poses[:, :1] + arm_x - elbows[:, 0], poses[:, 1:2] + arm_y - elbows[:, 1]
    rows = np.stack([ex, ey, arm_x * ey - arm_y * ex], axis=2)
    l2 = geometry.distal_length
    return (ex * ex + ey * ey - l2 * l2) / (2.0 * l2), rows, np.abs(np.hypot(ex, ey) - l2)


def _polished(geometry: ThreeRrrGeometry, elbows: Array, poses: Array) -> tuple[Array, Array, Array]:
    """Close the legs by Newton's method from (M, 3) poses.

    Returns:
        the best pose met from each start, (M, 3); its scaled determinant; and its largest error, m. A pose is
        accepted on that error, never on convergence, so that leaving slack directions out of a step hides nothing.
    """
    l2 = geometry.distal_length
    scale = np.array([l2, l2, 1.0])
    best, least = poses, _closure(geometry, elbows, poses)[2].max(axis=1)
    for steps, slack in _NEWTON_PHASES:
        poses = best.copy()
        for _ in range(steps):
            error, rows, _gap = _closure(geometry, elbows, poses)
            step = np.einsum("mij,mj->mi", np.linalg.pinv(rows * scale / l2, rcond=slack), error)
            step /= np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1.0)  # at most l2, or a radian
            poses = poses - step * scale
            gap = _closure(geometry, elbows, poses)[2].max(axis=1)
            better = gap < least
            best, least = np.where(better[:, None], poses, best), np.where(better, gap, least)
            if np.abs(step).max() < 1e-15:
                break
    determinants = np.linalg.det(_closure(geometry, elbows, best)[1]) / (l2**3 * geometry.platform_radius)
    best[:, 2] = np.pi - np.mod(np.pi - best[:, 2], 2.0 * np.pi)
    return best, determinants, least


def _same(geometry: ThreeRrrGeometry, poses: Array, determinants: Array, k: int, j: int) -> bool:
    turn = abs(np.mod(poses[k, 2] - poses[j, 2] + np.pi, 2.0 * np.pi) - np.pi)
    distance = np.hypot(*(poses[k, :2] - poses[j, :2])) / geometry.distal_length
    at_a_cusp = max(abs(determinants[k]), abs(determinants[j])) < _FOLD / 10.0
    return bool(max(turn, distance) < (_CUSP if at_a_cusp else _FOLD))
