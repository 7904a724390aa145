"""Backend against physics: power, angular momentum, forward dynamics and finite differences."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray
from redundancy_pin.crosscheck.cases import Case
from redundancy_pin.crosscheck.report import Tally, relative
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion, ReducedDynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.simulation.pinocchio_way import ConstraintDynamics, has_point_closures

_STENCIL = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
_STEP = 5e-4
"""Sixth-order central differences: rounding is 1e-16 of the value over the step."""

_ENERGY_OFFSETS = np.array([-6, -4, -3, -2, -1, 0, 1, 2, 3, 4, 6])
_ENERGY_WEIGHTS = np.array([1, -9, -128, 1197, -5760, 0, 5760, -1197, 128, 9, -1]) / 7560.0
"""Eighth-order differences: the sixth-order ones with steps h and 2 h, extrapolated so that h⁶ cancels. One random
state in 1e5 changes so fast that the sixth-order ones leave 3e-8 at 0.5 ms, and 64 times less at every halving."""
_ENERGY_STEP = 2e-4

POWER = 1e-8
MOMENTUM = 1e-8
ROUND_TRIP = 1e-7
"""Limited by the damped solver of the forward dynamics (mu 1e-8, 30 iterations) and the conditioning of W."""
DERIVATIVES = 1e-7
"""Central differences of a quadratic are exact but for rounding: 1e-16 over the step of 1e-3, and cancellation."""


def check_power(tally: Tally, case: Case, dynamics: Dynamics, label: str) -> None:
    """Power of all actuators equals the rate of the energy: ẋᵀ f + ṡᵀ F = dE/dt (ẋᵀ f = q̇ₐᵀ τ)."""
    t = _apart(case.t)
    motion, carriers = case.motion(t), case.carriers(t)
    along = dynamics.along(motion)
    reduced = along.reduce(carriers)
    power = (reduced.f * motion.xd).sum(axis=1) + (reduced.carrier_force * carriers.sd).sum(axis=1)
    spread = (t[:, None] + _ENERGY_STEP * _ENERGY_OFFSETS).ravel()
    energy = dynamics.along(case.motion(spread)).energy(case.carriers(spread)).reshape(len(t), -1)
    size = np.maximum(np.abs(reduced.f * motion.xd).sum(axis=1), np.abs(energy).max(axis=1))
    keep = _away(case, t)
    deviation = np.abs(energy @ _ENERGY_WEIGHTS / _ENERGY_STEP - power) / np.maximum(size, 1e-3)
    tally.add(case.robot.name, f"power balance ({label})", deviation[keep], POWER)


def check_leg_momentum(tally: Tally, case: Case, dynamics: Dynamics, label: str) -> None:
    """Massless 2-RPR: f = Σ nᵢ Ḣᵢ / dᵢ, Hᵢ the angular momentum of carrier i about Aᵢ (Parsa 2014, eq. 2.17).

    The momentum comes from the carrier's position alone, differenced: r = L u + σ s n, H = m (r × ṙ).
    """
    robot = case.robot
    t = _apart(case.t)
    motion, carriers = case.motion(t), case.carriers(t)
    reduced = dynamics.along(motion).reduce(carriers)
    expected = np.zeros_like(motion.x)
    mass, offset = float(robot.parameters["carrier_mass"]), float(robot.parameters["track_offset"])
    spread = (t[:, None] + _STEP * np.arange(-6, 7)).ravel()
    wide, tracks = case.motion(spread), case.carriers(spread)
    for leg, (anchor, side) in enumerate(((0.0, 1.0), (float(robot.parameters["base_distance"]), -1.0))):
        sign = robot.working_mode[leg]

        def direction(x: Array, anchor: float = anchor, sign: int = sign) -> tuple[Array, Array, Array]:
            reach = x - np.array([anchor, 0.0])
            length = sign * np.linalg.norm(reach, axis=1, keepdims=True)
            u = reach / length
            return u, np.stack([-u[:, 1], u[:, 0]], axis=1), length

        u, n, _ = direction(wide.x)
        place = (offset * u + side * tracks.s[:, leg : leg + 1] * n).reshape(len(t), 13, 2)
        velocity = _differentiate(place)  # (N, 7, 2)
        inner = place[:, 3:-3]
        momentum = mass * (inner[..., 0] * velocity[..., 1] - inner[..., 1] * velocity[..., 0])
        _, normal, length = direction(motion.x)
        expected += normal * (momentum @ _STENCIL / _STEP)[:, None] / length
        weight = mass * robot.gravity[:2]
        moment = place[:, 6, 0] * weight[1] - place[:, 6, 1] * weight[0]
        expected -= normal * moment[:, None] / length
    keep = _away(case, t)
    tally.add(
        robot.name, f"angular momentum of each leg ({label})", relative(reduced.f[keep], expected[keep]), 100 * MOMENTUM
    )


def check_round_trip(tally: Tally, case: Case, dynamics: Dynamics, label: str) -> None:
    """Efforts from inverse dynamics, given to Pinocchio's constrained forward dynamics, return the accelerations."""
    robot = case.robot
    if not has_point_closures(robot):
        return  # the solver knows point closures only
    motion, carriers = case.motion(case.t), case.carriers(case.t)
    rnea = RneaDynamics(robot).along(motion)
    reduced = dynamics.along(motion).reduce(carriers)
    tau, solvable = _efforts(reduced)
    keep = np.flatnonzero(solvable & (rnea.tree.serial_margin_bound > NEAR_SINGULAR_MARGIN))
    q, v, a = rnea.tree_motion(carriers)
    effort = np.zeros_like(v)
    effort[robot.actuated_velocity] = tau.T
    effort[robot.carrier_velocity] = reduced.carrier_force.T
    solve = ConstraintDynamics(case.robot)
    forward = np.array([solve(q[:, k], v[:, k], effort[:, k]) for k in keep]).reshape(len(keep), len(v))
    tally.add(robot.name, f"inverse -> forward ({label})", relative(forward, a.T[keep]), ROUND_TRIP)


def check_derivatives(tally: Tally, case: Case, along: DynamicsAlongMotion, label: str) -> None:
    """Derivatives of f and carrier force by s, ṡ, s̈ against central differences (exact for a quadratic)."""
    carriers = case.carriers(case.t)
    exact = along.carrier_derivatives(carriers)
    step = 1e-3
    for argument in ("s", "sd", "sdd"):
        for k in range(case.robot.k):
            shifted = []
            for sign in (1.0, -1.0):
                parts = {name: np.array(getattr(carriers, name)) for name in ("s", "sd", "sdd")}
                parts[argument][:, k] += sign * step
                shifted.append(along.reduce(CarrierMotion(**parts)))
            for field, quantity in (("f", "f"), ("force", "carrier_force")):
                difference = (getattr(shifted[0], quantity) - getattr(shifted[1], quantity)) / (2.0 * step)
                whole = getattr(exact, f"{field}_{argument}")
                size = np.maximum(np.abs(whole).max(axis=(1, 2)), np.abs(getattr(shifted[0], quantity)).max(axis=1))
                deviation = np.abs(whole[:, :, k] - difference).max(axis=1) / np.maximum(size, 1.0)
                tally.add(case.robot.name, f"derivatives by s, s', s'' ({label})", deviation, DERIVATIVES)


def _differentiate(values: Array) -> Array:
    """Return the sixth-order derivative of (N, p, d) along axis 1, at its p − 6 inner points."""
    inner = values.shape[1] - 6
    result: Array = sum(
        (weight * values[:, j : j + inner] for j, weight in enumerate(_STENCIL)), np.zeros_like(values[:, :inner])
    )
    return result / _STEP


def _apart(t: Array) -> Array:
    """Return the times that are far enough apart for stencils around them not to overlap."""
    spacing = 14.0 * _STEP
    slots = np.unique(np.round(t / spacing).astype(int))
    result: Array = slots * spacing
    return result


def _away(case: Case, t: Array) -> BoolArray:
    tree = RneaDynamics(case.robot).along(case.motion(t)).tree
    result: BoolArray = tree.serial_margin_bound > NEAR_SINGULAR_MARGIN
    return result


def _efforts(reduced: ReducedDynamics) -> tuple[Array, BoolArray]:
    """Return minimum-norm efforts where W has full row rank by a margin, and which samples those are."""
    singular = np.linalg.svd(reduced.W, compute_uv=False)
    solvable: BoolArray = singular[:, -1] > NEAR_SINGULAR_MARGIN * singular[:, 0]
    safe = np.where(solvable[:, None, None], reduced.W, np.eye(*reduced.W.shape[1:]))
    tau: Array = (np.linalg.pinv(safe) @ reduced.f[:, :, None])[:, :, 0]
    return tau, solvable
