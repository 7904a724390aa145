"""Forward displacement of the 3-RRR: every platform pose that given base angles allow.

With the elbows B_i fixed, the platform centre P lies at distance l2 from each of the three centres
C_i(α) = B_i + l3 u(φ_i): the three centres have a circumcircle of radius l2 and P is its centre. Writing
r_ij = |C_i - C_j|² and D = (C_2 - C_1) x (C_3 - C_1), the product of the sides is twice the circumradius times
twice the area, so that P is eliminated exactly:

    r_12 r_23 r_31 = 4 l2² D².

Each r_ij and D is a first-degree trigonometric polynomial in α, so this is a Laurent polynomial of degree 3 in
z = exp(iα): at most six assembly modes. Squaring and clearing D loses nothing but care: where all three centres lie
on a line and two of them coincide, the equation has a double root that stands for two poses. Each root is therefore
only a candidate for α; the positions come from the two best-separated centres, both of them, and a pose counts only
after Newton's method has closed all three legs.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, checked, read_only
from redundancy_pin.errors import SingularPoseError
from redundancy_pin.kinematics.three_rrr import CORNER_ANGLES, ThreeRrrGeometry

_UNIT_CIRCLE_BAND = 0.1
"""Roots with | |z| - 1 | below this are tried. Rounding moves a root of multiplicity four by 1e-4; the rest of the
band costs a few steps of Newton's method and can add no pose that does not close."""

_SAME_POSE = 1e-6
"""Poses nearer than this (relative to l2, and radians) are one. Next to a fold of the forward map, closing the legs
to rounding fixes a pose to the square root of rounding, 1e-8."""

_NEWTON_STEPS = 60
"""Near a fold Newton's method halves its error each step: 60 halvings pass from 1 to rounding."""


@dataclass(frozen=True, eq=False)
class ThreeRrrAssembly:
    """One assembly mode of the 3-RRR.

    Attributes:
        index: place in the order of growing α in (-π, π], counted from 0.
        sign: sign of the determinant of the rows (a, b, d) of eq. 2.38; it changes at a type II singularity.
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
        SingularPoseError: the three centres coincide at some α, so that the platform moves on a circle with all
            base joints locked.
    """
    angle = checked(theta, "theta", (3,))
    elbows = geometry.base_points + geometry.proximal_length * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    starts = [start for alpha in _orientations(geometry, elbows) for start in _positions(geometry, elbows, alpha)]
    if not starts:
        return ()
    poses, residuals = _polished(geometry, elbows, np.array(starts))
    kept: list[tuple[Array, float]] = []
    for k in np.argsort(residuals):
        if residuals[k] <= CLOSURE_TOLERANCE and not any(_same(geometry, poses[k], other) for other, _ in kept):
            kept.append((poses[k], float(residuals[k])))
    kept.sort(key=lambda found: float(found[0][2]))
    return tuple(_labelled(geometry, elbows, index, pose, gap) for index, (pose, gap) in enumerate(kept))


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
        raise SingularPoseError(
            f"The elbows form a triangle congruent to the platform: at α = {alpha:.9g} rad the platform moves on a "
            "circle with the base joints locked, so the assembly modes are not isolated.",
            remedy="Change a base angle.",
            alpha=alpha,
        )
    # D is the imaginary part of conj(b2 + w2 z)(b3 + w3 z).
    linear = (np.conj(b2) * w3 - w2 * np.conj(b3)) / 2j
    twice_area = np.array([linear, np.imag(np.conj(b2) * b3 + np.conj(w2) * w3), np.conj(linear)])
    polynomial = np.convolve(np.convolve(squared_side(0, 1), squared_side(1, 2)), squared_side(2, 0))
    polynomial[1:-1] -= 4.0 * geometry.distal_length**2 * np.convolve(twice_area, twice_area)
    roots = np.roots(polynomial)
    alpha_all: Array = np.angle(roots[np.abs(np.abs(roots) - 1.0) < _UNIT_CIRCLE_BAND])
    return alpha_all


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


def _polished(geometry: ThreeRrrGeometry, elbows: Array, poses: Array) -> tuple[Array, Array]:
    """Close the legs by Newton's method from (M, 3) poses; return the poses and the largest error of each, m.

    At a fold the rows (a, b, d) lose rank; the shortest step is taken then. It only decides where the search goes
    next: a pose is accepted on its residual, never on convergence.
    """
    l2 = geometry.distal_length
    scale = np.array([l2, l2, 1.0])
    for _ in range(_NEWTON_STEPS):
        error, rows, _gap = _closure(geometry, elbows, poses)
        step = np.einsum("mij,mj->mi", np.linalg.pinv(rows * scale / l2, rcond=1e-14), error)
        step /= np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1.0)
        poses = poses - step * scale
        if np.abs(step).max() < 1e-15:
            break
    poses[:, 2] = np.pi - np.mod(np.pi - poses[:, 2], 2.0 * np.pi)
    return poses, _closure(geometry, elbows, poses)[2].max(axis=1)


def _same(geometry: ThreeRrrGeometry, one: Array, other: Array) -> bool:
    turn = abs(np.mod(one[2] - other[2] + np.pi, 2.0 * np.pi) - np.pi)
    distance = np.hypot(*(one[:2] - other[:2])) / geometry.distal_length
    return bool(max(turn, distance) < _SAME_POSE)


def _labelled(geometry: ThreeRrrGeometry, elbows: Array, index: int, pose: Array, residual: float) -> ThreeRrrAssembly:
    rows = _closure(geometry, elbows, pose[None])[1][0]
    determinant = float(np.linalg.det(rows)) / (geometry.distal_length**3 * geometry.platform_radius)
    sign = 1 if determinant > 0.0 else -1
    return ThreeRrrAssembly(index, sign, read_only(pose.copy()), determinant, residual)
