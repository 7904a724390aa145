"""Rates of the angles that a platform has for coordinates: which part of its angular velocity they are.

The rate of an angle is g · ω. The vector g depends on one axis a of the platform frame alone. With p the part of a
normal to the base axis e_k that the angle is measured about,

    angle of a about e_k:   g = e_k − (a · e_k) p / |p|²,
    roll,  a = R e_x, k = z:   g = p / |p|²,
    pitch, a = R e_x, k = z:   g = e_k × p / |p|,
    yaw,   a = R e_x, k = z:   the first.

So g has the rates ġ and g̈ along ȧ = ω × a and ä. The pitch comes to ±π/2 where p vanishes: there roll and yaw are one
turn, no rate of them exists, and K loses rank.
"""

from __future__ import annotations

from math import comb

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array
from redundancy_pin.robot import Platform, Robot
from redundancy_pin.robot.lookup import find_link_index

ROLL, PITCH, ABOUT = "roll", "pitch", "about"

_SMALLEST = 1e-30
"""Square of a sine, or of |p|, that is rounding: p is not divided by a smaller one, and K is singular there."""


def angle_rows(robot: Robot) -> dict[int, tuple[str, int]]:
    """Return which base axes have a rotation whose rate is not a component of the twist, and the kind and k of each.

    A pose has none, nor has a platform that joints about one base axis carry, as in a planar robot.
    """
    platform = robot.platform
    if platform is None or platform.is_pose or not platform.rotations:
        return {}
    if len(platform.rotations) == 1:
        k = platform.rotations[0]
        return {} if _turns_about(robot, platform, k) else {k: (ABOUT, k)}
    kinds = {0: (ROLL, 2), 1: (PITCH, 2), 2: (ABOUT, 2)}
    return {axis: kinds[axis] for axis in platform.rotations}


def pointer(platform: Platform) -> int:
    """Return which axis of the platform frame g depends on."""
    return platform.pointer if len(platform.rotations) == 1 else 0


def _turns_about(robot: Robot, platform: Platform, k: int) -> bool:
    """Return whether all joints that turn the platform do so about one base axis: they then always do."""
    model, data = robot.model, robot.model.createData()
    frame = find_link_index(model, platform.frame)
    world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    jacobian = pin.computeFrameJacobian(model, data, np.array(robot.q_reference), frame, world)
    across = np.delete(np.reshape(jacobian, (6, -1))[3:], k, axis=0)
    return bool((across**2).max(initial=0.0) <= _SMALLEST)


def direction(kinds: list[tuple[str, int]], order: int, axis: list[Array]) -> Array:
    """Return g of each row, or its first or second time derivative.

    Args:
        kinds: (C) the kind of each row and its k.
        order: 0, 1 or 2.
        axis: (3, C) or (3, C, N) the axis a of each row, then its time derivatives, as many as the order.
    """
    result = np.empty(axis[0].shape)
    for row, (kind, k) in enumerate(kinds):
        rates = [part[:, row] for part in axis]
        normal = [(part.T * (np.arange(3) != k)).T for part in rates]
        fractions = _over_length(normal, 0.5 if kind == PITCH else 1.0)
        if kind == ROLL:
            result[:, row] = fractions[order]
        elif kind == PITCH:
            f = fractions[order]
            result[0, row], result[1, row], result[2, row] = -f[1], f[0], 0.0
        else:
            along = [part[k] for part in rates]
            result[:, row] = -sum(comb(order, i) * along[i] * fractions[order - i] for i in range(order + 1))
            result[k, row] += order == 0
    return result


def _over_length(p: list[Array], power: float) -> list[Array]:
    """Return p / |p|^(2 power) and as many time derivatives as are given of p."""
    square = np.maximum((p[0] * p[0]).sum(axis=0), _SMALLEST)
    scale = square**-power
    result = [scale * p[0]]
    if len(p) > 1:
        first = 2.0 * (p[0] * p[1]).sum(axis=0) / square
        result.append(scale * (p[1] - power * first * p[0]))
    if len(p) > 2:
        second = 2.0 * (p[1] * p[1] + p[0] * p[2]).sum(axis=0) / square
        bend = power * (power + 1.0) * first**2 - power * second
        result.append(scale * (p[2] - 2.0 * power * first * p[1] + bend * p[0]))
    return result
