"""The shipped four-bar on paper, in complex numbers: imaginary steps differentiate it exactly, to the last digit.

Angles by Newton's method on the loop of its vectors, torque by virtual work. No URDF, no Pinocchio, no casadi.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

IMAGINARY = 1e-30
"""Steps this small have squares of nothing: the imaginary part is the derivative."""


def crank_torque(phi: complex, rate: complex, second: complex, sizes: Mapping[str, complex]) -> tuple[complex, complex]:
    """Return the torque of the crank, and the force of the crank's tip on the coupler along the crank."""
    ground, crank, coupler, rocker = (sizes[f"{bar}_length"] for bar in ("ground", "crank", "coupler", "rocker"))
    m2, m3, m4 = (sizes[f"{bar}_mass"] for bar in ("crank", "coupler", "rocker"))

    def unit(angle: complex) -> np.ndarray:
        return np.array([np.cos(angle), np.sin(angle)])

    def across(angle: complex) -> np.ndarray:
        return np.array([-np.sin(angle), np.cos(angle)])

    # from the crank's hinge to its tip, and there by way of ground, rocker and coupler
    angles = np.array([1.9, 3.9], dtype=complex)
    for _ in range(60):
        four, three = angles
        gap = crank * unit(phi) - np.array([ground, 0.0]) - rocker * unit(four) - coupler * unit(three)
        matrix = np.stack([rocker * across(four), coupler * across(three)], axis=1)
        angles = angles + np.linalg.solve(matrix, gap)
    four, three = angles
    ratio = np.linalg.solve(matrix, crank * across(phi))
    turn = ratio * rate
    pull = -crank * unit(phi) * rate**2 + rocker * unit(four) * turn[0] ** 2 + coupler * unit(three) * turn[1] ** 2
    bend = np.linalg.solve(matrix, crank * across(phi) * second + pull)
    weight = np.array([0.0, -9.81])
    # of each bar's centre: its derivative by the crank's angle, and its acceleration
    hinge_by, hinge = rocker * across(four) * ratio[0], rocker * (across(four) * bend[0] - unit(four) * turn[0] ** 2)
    bars = [
        (m2, crank, across(phi) * crank / 2, crank / 2 * (across(phi) * second - unit(phi) * rate**2), 1.0, second),
        (m4, rocker, hinge_by / 2, hinge / 2, ratio[0], bend[0]),
        (m3, coupler, hinge_by + across(three) * coupler / 2 * ratio[1],
         hinge + coupler / 2 * (across(three) * bend[1] - unit(three) * turn[1] ** 2), ratio[1], bend[1]),
    ]  # fmt: skip
    torque = sum(m * (by @ (acc - weight)) + m * size**2 / 12 * r * b for m, size, by, acc, r, b in bars)
    # coupler and rocker without the crank: what its tip pushes them with does the work of turning each of them
    pushes = []
    for alone in (0, 1):  # the rocker alone turns, then the coupler alone
        own = np.eye(2)[alone]
        work = m4 * (own[0] * rocker / 2 * across(four)) @ (hinge / 2 - weight) + m4 * rocker**2 / 12 * own[0] * bend[0]
        centre = own[0] * rocker * across(four) + own[1] * coupler / 2 * across(three)
        work += m3 * centre @ (bars[2][3] - weight) + m3 * coupler**2 / 12 * own[1] * bend[1]
        pushes.append(work)
    push = np.linalg.solve(matrix.T, np.array(pushes))
    return complex(torque), complex(push @ unit(phi))
