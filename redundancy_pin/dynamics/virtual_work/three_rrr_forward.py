"""Forward displacement of the 3-RRR: every platform pose that given base angles allow.

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

from dataclasses import dataclass
from itertools import combinations
from typing import NoReturn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, Frozen, checked, read_only
from redundancy_pin.dynamics.virtual_work.three_rrr import CORNER_ANGLES, ThreeRrrGeometry
from redundancy_pin.errors import SingularPoseError

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
class ThreeRrrAssembly(Frozen):
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
        if residuals[k] <= geometry.tolerance and not any(_same(geometry, poses, determinants, k, j) for j in kept):
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
    if max(abs(abs(z) - 1.0) * abs(w2), abs(b3 + w3 * z)) <= geometry.tolerance:
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
        f"{what} with the base joints locked, so the assembly modes are not isolated.", remedy="Change a base angle."
    )


def _positions(geometry: ThreeRrrGeometry, elbows: Array, alpha: float) -> list[Array]:
    """Return both poses at orientation α that close the two legs whose centres are farthest apart."""
    phi = alpha + np.array(CORNER_ANGLES)
    centres = elbows + geometry.platform_radius * np.stack([np.cos(phi), np.sin(phi)], axis=1)
    i, j = max(combinations(range(3), 2), key=lambda pair: float(np.hypot(*(centres[pair[0]] - centres[pair[1]]))))
    middle, chord = (centres[i] + centres[j]) / 2.0, centres[j] - centres[i]
    length = float(np.hypot(*chord))
    height = np.sqrt(max(geometry.distal_length**2 - length**2 / 4.0, 0.0))
    across = np.array([-chord[1], chord[0]]) * (height / length)
    return [np.append(middle + side * across, alpha) for side in (1.0, -1.0)]


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
