"""The checks: against closures, power and forward dynamics, and backend against backend."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray, IntArray
from redundancy_pin.crosscheck.closures import largest_miss
from redundancy_pin.crosscheck.energy import energy_rate
from redundancy_pin.crosscheck.report import CheckRow, checked_row
from redundancy_pin.crosscheck.states import RandomStates
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.dynamics.rnea import RneaAlongMotion
from redundancy_pin.dynamics.tree_loads import TreeState, tree_loads
from redundancy_pin.errors import CompilerError, IllPosedModelError, SingularPoseError, UnsupportedRobotError
from redundancy_pin.kinematics.branch import SAME_CONFIGURATION
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.robot import Robot
from redundancy_pin.robot.loads import wrench_values
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.simulation.forward import ForwardDynamics

MOTION = POWER = PARITY = 1e-10
"""Rounding is 1e-14 of the terms, times the condition of the closures: at most 1e3 away from singularities. Closures
are open by 1e-12."""

CLOSED = 1e-9
"""Closure residual, characteristic lengths and rad, of a configuration of another backend that counts as closed."""

ROUND_TRIP, _LEAST_INERTIA = 1e-7, 1e-5
"""Deviation of accelerations that passes, and the least share of the largest inertia that every free motion must have:
rounding of forces, 1e-13, over that share."""


Deviations = tuple[Array, Mapping[str, int]]
"""(N,) deviations of the states that were judged, relative to their size, and how many were skipped, by reason."""


def closure_rates(states: RandomStates, along: RneaAlongMotion, keep: IntArray) -> Deviations:
    """Rates and accelerations of the joints keep the closures and move the platform as prescribed."""
    q, v, a = along.tree_motion(states.carriers)
    xd, xdd = states.motion.xd, states.motion.xdd
    return np.array([largest_miss(states.robot, q[k], v[k], a[k], xd[k], xdd[k]) for k in keep]), {}


def power_balance(states: RandomStates, along: RneaAlongMotion, keep: IntArray) -> Deviations:
    """Power of all actuators equals the rate of the energy: ẋᵀ f + ṡᵀ F = dE/dt (ẋᵀ f = q̇ₐᵀ τ).

    dE/dt depends on q, v and a alone, which ``closure_rates`` judges. Along the closed motion rounding of the
    differences would grow as the inverse of the margin of a rank loss.
    """
    motion, carriers, reduced = states.motion, states.carriers, along.reduce(states.carriers)
    parts = np.concatenate([reduced.f * motion.xd, reduced.carrier_force * carriers.sd], axis=1)
    rate, lost = energy_rate(states.robot, motion, *along.tree_motion(carriers))
    size = np.maximum(np.maximum(np.abs(parts).sum(axis=1), np.abs(along.energy(carriers))), 1e-3)
    return (np.abs(rate + lost - parts.sum(axis=1)) / size)[keep], {}


def round_trip(states: RandomStates, along: RneaAlongMotion, keep: IntArray) -> Deviations:
    """Efforts from inverse dynamics, given to the forward dynamics, return the accelerations."""
    robot = states.robot
    if robot.m < robot.n and robot.platform is not None:
        return np.zeros(0), {"underactuated": len(keep)}
    reduced, (q, v, a) = along.reduce(states.carriers), along.tree_motion(states.carriers)
    driven, tau, unsolvable = _efforts(robot, reduced)
    effort = np.zeros_like(v)
    effort[:, driven], effort[:, robot.carrier_velocity] = tau, reduced.carrier_force
    effort += _wrench_efforts(states, q, v, a)
    forward, reached, refused = ForwardDynamics(robot), np.full_like(a, np.nan), np.full(len(a), "", dtype=object)
    for reason, holds in unsolvable.items():
        refused[holds] = reason
    for k in keep[refused[keep] == ""]:
        try:
            reached[k] = forward.acceleration(q[k], v[k], effort[k])
            refused[k] = "massless" if forward.least_inertia < _LEAST_INERTIA else ""
        except IllPosedModelError:
            refused[k] = "massless"
        except SingularPoseError:
            refused[k] = "rank_loss"
    judged = keep[refused[keep] == ""]
    return relative(reached[judged], a[judged]), Counter(reason for reason in refused[keep] if reason)


CHECKS = {
    "rates and accelerations of the joints": (closure_rates, MOTION),
    "power balance (rnea)": (power_balance, POWER),
    "inverse -> forward (rnea)": (round_trip, ROUND_TRIP),
}
"""Checks of RNEA against physics: name in reports, function of states, tolerance. None says whether the declared model
is the machine (``report.SCOPE``)."""


def check_physics(states: RandomStates, along: RneaAlongMotion) -> Iterator[CheckRow]:
    """Return a row for each of ``CHECKS`` on states away from type I."""
    keep, skipped = select(len(states.motion), near_type_i=~_regular(along))
    for name, (deviations, tolerance) in CHECKS.items():
        values, more = deviations(states, along, keep)
        yield checked_row(states.robot.name, name, values, tolerance, {**skipped, **more})


def check_parity(
    states: RandomStates, along: RneaAlongMotion, label: str, make: Callable[[Robot], Dynamics]
) -> Iterator[CheckRow]:
    """W, f, carrier forces and base wrench of another backend equal the values of RNEA."""
    robot = states.robot
    try:
        other = make(robot).along(states.motion)
    except (CompilerError, UnsupportedRobotError) as error:
        none = {"no_backend": len(states.motion)}
        yield checked_row(robot.name, f"parity: W and f ({label})", np.zeros(0), PARITY, none, str(error))
        return
    keep, skipped = select(len(states.motion), near_type_i=~_regular(along), other_branch=_elsewhere(along, other.q))
    first, second = along.reduce(states.carriers), other.reduce(states.carriers)
    # rounding of two routes grows as the inverse of the margin
    share = np.minimum(1.0, along.tree.serial_margin_bound / NEAR_SINGULAR_MARGIN)[keep]
    for quantity, a, b in (
        ("f", first.f, second.f),
        ("W", first.W, second.W),
        ("carrier force", first.carrier_force, second.carrier_force),
        ("base wrench", along.base_wrench(states.carriers), other.base_wrench(states.carriers)),
    ):
        deviation = share * relative(a[keep], b[keep])
        yield checked_row(robot.name, f"parity: {quantity} ({label})", deviation, PARITY, skipped)


def _elsewhere(along: RneaAlongMotion, q: Array | None) -> BoolArray:
    """Return (N,) whether q (N, nq) closes the loops on another branch than RNEA.

    Two branches may come near each other between samples. Declared working modes leave a backend no choice.
    """
    if q is None or along.robot.working_modes is not None:
        return np.zeros(len(along.q), dtype=bool)
    residual = np.abs(constraint_system(along.robot).evaluate(q).phi).max(axis=1, initial=0.0)
    apart = q - along.q
    apart -= 2.0 * np.pi * np.round(apart / (2.0 * np.pi))  # a joint may be whole turns away
    differs = np.abs(apart).max(axis=1) > SAME_CONFIGURATION
    return np.asarray(differs & (residual < CLOSED * along.robot.characteristic_length))


def _regular(along: RneaAlongMotion) -> BoolArray:
    """Return (N,) whether the states are away from type I; the bound falls with the number of joints."""
    margin = along.tree.serial_margin_bound
    typical = float(np.median(margin[margin > 0.0])) if (margin > 0.0).any() else 0.0
    return np.asarray(margin > min(NEAR_SINGULAR_MARGIN, 0.3 * typical))


def _efforts(robot: Robot, reduced: ReducedDynamics) -> tuple[IntArray, Array, dict[str, BoolArray]]:
    """Return velocity indices, the efforts that drive them (N, ·), and the states where there are none.

    Minimum-norm efforts of the main actuators where W has full row rank by a margin. Where they cannot move the
    machine, as one whose arms have no motors, the independent joints are driven, whose efforts are f.
    """
    singular = np.linalg.svd(reduced.W, compute_uv=False)
    solvable: BoolArray = (robot.m >= robot.n) & (singular[:, -1] > NEAR_SINGULAR_MARGIN * singular[:, 0])
    if robot.platform is None and not solvable.any():
        joints = (find_joint(robot.model, name) for name in robot.independent_joints)
        unknown = np.logical_not(np.isfinite(reduced.f).all(axis=1))
        return np.array([each.idx_v for each in joints]), reduced.f, {"not_finite": unknown}
    safe = np.where(solvable[:, None, None], reduced.W, np.eye(*reduced.W.shape[1:]))
    tau: Array = (np.linalg.pinv(safe) @ reduced.f[:, :, None])[:, :, 0]
    return robot.actuated_velocity, tau, {"near_type_ii": ~solvable}


def _wrench_efforts(states: RandomStates, q: Array, v: Array, a: Array) -> Array:
    """Return (N, nv) what the robot's wrenches do at the joints, which forward dynamics take as given forces."""
    robot, motion, loads = states.robot, states.motion, tree_loads(states.robot)
    if loads is None:
        return np.zeros_like(v)
    values, data = wrench_values(robot.loads, motion.t, motion.x, motion.xd), robot.model.createData()
    tree = (TreeState(q[k], v[k], a[k], [value[k] for value in values]) for k in range(len(q)))
    return np.array([loads.external(data, state) for state in tree])


def select(states: int, **reasons: BoolArray) -> tuple[IntArray, dict[str, int]]:
    """Return the states for which no reason (N,) holds, and how many are skipped for each: for the first that holds."""
    left, skipped = np.ones(states, dtype=bool), {}
    for name, holds in reasons.items():
        if count := int((left & holds).sum()):
            skipped[name] = count
        left &= ~holds
    return np.flatnonzero(left), skipped


def relative(first: Array, second: Array) -> Array:
    """Return (N,) the largest difference of each sample (N, …) relative to the largest entry of the sample.

    The divisor is at least 1e-6, and a thousandth of the typical size of the whole array: rounding of a quantity that
    vanishes at one sample does not count.
    """
    count = len(first)
    if first.size == 0:
        return np.zeros(count)
    a, b = first.reshape(count, -1), second.reshape(count, -1)
    size = np.maximum(np.abs(a).max(axis=1), np.abs(b).max(axis=1))
    result: Array = np.abs(a - b).max(axis=1) / np.maximum(size, max(1e-6, 1e-3 * float(np.median(size))))
    return result
