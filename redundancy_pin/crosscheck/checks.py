"""The checks of a robot: one table of comparisons, tolerances and errors that pass, and one loop over it."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray, IntArray
from redundancy_pin.crosscheck.closures import largest_miss
from redundancy_pin.crosscheck.energy import energy_rate
from redundancy_pin.crosscheck.report import CheckRow, checked_row
from redundancy_pin.crosscheck.states import RandomStates
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.dynamics.compiled.gpu import Device, GpuDynamics
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.dynamics.rnea import RneaAlongMotion, RneaDynamics
from redundancy_pin.dynamics.tree_loads import TreeState, tree_loads
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.errors import CompilerError, IllPosedModelError, SingularPoseError, UnsupportedRobotError
from redundancy_pin.kinematics.branch import SAME_CONFIGURATION
from redundancy_pin.kinematics.closure import constraint_system
from redundancy_pin.robot import Robot
from redundancy_pin.robot.loads import wrench_values
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.simulation.forward import ForwardDynamics

_CLOSED = 1e-9
"""Closure residual, characteristic lengths and rad, of a configuration of another backend that counts as closed."""

_LEAST_INERTIA = 1e-5
"""Least share of the largest inertia that every free motion must have: rounding of forces is 1e-13 over that share."""

BACKENDS: dict[str, Callable[[Robot], Dynamics]] = {"compiled": CompiledDynamics, "virtual work": VirtualWork}
"""What is compared with RNEA; virtual work where the robot has a closed form."""


class Case:
    """Random states of a robot and what RNEA returns for them.

    Args:
        states: the states.
        device: "gpu" or "cpu": what also runs ``GpuDynamics`` on them; None leaves them out.

    Attributes:
        states, device: as given.
        along: RNEA along them.
        keep: indices of the states away from type I: those that every check judges.
        skipped: number of the others, by reason.
    """

    def __init__(self, states: RandomStates, device: Device | None = None) -> None:
        self.states, self.device, self.along = states, device, RneaDynamics(states.robot).along(states.motion)
        self.keep, self.skipped = select(len(states.motion), near_type_i=~_regular(self.along))

    @cached_property
    def reduced(self) -> ReducedDynamics:
        """W, f and carrier forces."""
        return self.along.reduce(self.states.carriers)

    @cached_property
    def tree_motion(self) -> tuple[Array, Array, Array]:
        """Configurations (N, nq), velocities and accelerations (N, nv) of all joints."""
        return self.along.tree_motion(self.states.carriers)


Compared: TypeAlias = Iterator[tuple[str, Array, Mapping[str, int], str]]
"""Name in reports, deviations of the judged states relative to their size, number of skipped states by reason, and why
nothing is compared (empty otherwise)."""


def closure_rates(case: Case) -> Compared:
    """Rates and accelerations of the joints keep the closures and move the platform as prescribed."""
    motion = case.states.motion
    parts = (part[case.keep] for part in (*case.tree_motion, motion.xd, motion.xdd))
    misses = [largest_miss(case.states.robot, *row) for row in zip(*parts, strict=True)]
    yield "rates and accelerations of the joints", np.array(misses), {}, ""


def power_balance(case: Case) -> Compared:
    """Power of all actuators equals the rate of the energy: ẋᵀ f + ṡᵀ F = dE/dt (ẋᵀ f = q̇ₐᵀ τ).

    dE/dt depends on q, v and a alone, which ``closure_rates`` judges. Along the closed motion rounding of the
    differences would grow as the inverse of the margin of a rank loss.
    """
    motion, carriers, reduced = case.states.motion, case.states.carriers, case.reduced
    parts = np.concatenate([reduced.f * motion.xd, reduced.carrier_force * carriers.sd], axis=1)
    rate, lost = energy_rate(case.states.robot, motion, *case.tree_motion)
    size = np.maximum(np.maximum(np.abs(parts).sum(axis=1), np.abs(case.along.energy(carriers))), 1e-3)
    yield "power balance (rnea)", (np.abs(rate + lost - parts.sum(axis=1)) / size)[case.keep], {}, ""


def round_trip(case: Case) -> Compared:
    """Efforts from inverse dynamics, given to the forward dynamics, return the accelerations."""
    name, robot, (q, v, a) = "inverse -> forward (rnea)", case.states.robot, case.tree_motion
    if robot.m < robot.n and robot.platform is not None:
        yield name, np.zeros(0), {"underactuated": len(case.keep)}, ""
        return
    driven, tau, unsolvable = _efforts(robot, case.reduced)
    effort = np.zeros_like(v)
    effort[:, driven], effort[:, robot.carrier_velocity] = tau, case.reduced.carrier_force
    effort += _wrench_efforts(case)
    keep, skipped = select(case.keep, **unsolvable)
    forward, judged, reached, refused = ForwardDynamics(robot), [], [], Counter[str]()
    for k in keep:
        try:
            acceleration = forward.acceleration(q[k], v[k], effort[k])
        except IllPosedModelError:
            refused["massless"] += 1
        except SingularPoseError:
            refused["rank_loss"] += 1
        else:
            if forward.least_inertia < _LEAST_INERTIA:
                refused["massless"] += 1
            else:
                judged.append(k)
                reached.append(acceleration)
    yield name, relative(np.array(reached), a[judged]), {**skipped, **refused}, ""


def parity(case: Case) -> Compared:
    """W, f, carrier forces and base wrench of the other backends equal the values of RNEA.

    Deviations are scaled by the margin of the closures, because rounding of two routes grows as its inverse.
    """
    robot, motion, carriers = case.states.robot, case.states.motion, case.states.carriers
    for label, make in BACKENDS.items():
        if make is VirtualWork and robot.closed_form is None:
            continue
        try:
            other = make(robot).along(motion)
        except (CompilerError, UnsupportedRobotError) as error:
            yield f"parity: W and f ({label})", np.zeros(0), {"no_backend": len(case.keep)}, str(error)
            continue
        keep, skipped = select(case.keep, other_branch=_elsewhere(case.along, other.q))
        first, second, share = case.reduced, other.reduce(carriers), _share(case)[keep]
        for quantity, a, b in (
            ("f", first.f, second.f),
            ("W", first.W, second.W),
            ("carrier force", first.carrier_force, second.carrier_force),
            ("base wrench", case.along.base_wrench(carriers), other.base_wrench(carriers)),
        ):
            yield f"parity: {quantity} ({label})", share * relative(a[keep], b[keep]), skipped, ""
    if case.device is not None:
        yield from _device_parity(case, case.device)


def _device_parity(case: Case, device: Device) -> Compared:
    """W, f and carrier forces of ``GpuDynamics`` equal those of RNEA, each state closed from its own configuration."""
    motion, carriers, first, keep = case.states.motion, case.states.carriers, case.reduced, case.keep
    label = f"GpuDynamics, {device}"
    try:
        many = GpuDynamics(case.states.robot, device=device)
    except UnsupportedRobotError as error:
        yield f"parity: W and f ({label})", np.zeros(0), {"no_backend": len(keep)}, str(error)
        return
    start = np.column_stack([case.along.q, np.zeros(len(motion))])
    track = carriers.s, carriers.sd, carriers.sdd
    found = many.torque(motion.x, motion.xd, motion.xdd, *track, start=start, equations=True)
    for quantity, a, b in (("f", first.f, found.f), ("W", first.W, found.W),
                           ("carrier force", first.carrier_force, found.carrier_force)):  # fmt: skip
        yield f"parity: {quantity} ({label})", _share(case)[keep] * relative(a[keep], b[keep]), {}, ""


def _share(case: Case) -> Array:
    """Return (N,) by what deviations of parity are multiplied."""
    share: Array = np.minimum(1.0, case.along.tree.serial_margin_bound / NEAR_SINGULAR_MARGIN)
    return share


@dataclass(frozen=True)
class Check:
    """One line of the table.

    Attributes:
        compare: returns the deviations of a case.
        tolerance: largest deviation that passes.
        does_not_show: the errors of a model that pass.
    """

    compare: Callable[[Case], Compared]
    tolerance: float
    does_not_show: str


CHECKS = (
    # rounding is 1e-14 of the terms, times the condition of the closures: at most 1e3 away from singularities
    Check(
        closure_rates,
        1e-10,
        "The joints move as the declared closures require. A closure at a wrong point and a wrong link length pass.",
    ),
    # rounding is 1e-14 of the terms, times the condition of the closures: at most 1e3 away from singularities
    Check(
        power_balance,
        1e-10,
        "Power and energy come from the same masses, inertias, gravity and loads. Wrong values, and a friction or "
        "spring that is not declared, pass.",
    ),
    # rounding of forces, 1e-13, over ``_LEAST_INERTIA``
    Check(
        round_trip,
        1e-7,
        "Inverse and forward dynamics read the same model. Wrong masses, inertias and loads cancel and pass.",
    ),
    Check(
        parity,
        1e-10,
        "All backends read the same declaration. They agree on a wrong one as well.",
    ),
)
"""What is checked, in the order of reports."""


def check_states(states: RandomStates, device: Device | None = None) -> Iterator[CheckRow]:
    """Return the rows of all ``CHECKS`` on random states of a robot, those away from type I; device as of ``Case``."""
    case = Case(states, device)
    for check in CHECKS:
        for name, values, skipped, note in check.compare(case):
            reasons = {**case.skipped, **skipped}
            yield checked_row(states.robot.name, name, values, check.tolerance, reasons, note, check.does_not_show)


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
    return np.asarray(differs & (residual < _CLOSED * along.robot.characteristic_length))


def _regular(along: RneaAlongMotion) -> BoolArray:
    """Return (N,) whether the states are away from type I; the bound falls with the number of joints."""
    margin = along.tree.serial_margin_bound
    typical = float(np.median(margin[margin > 0.0])) if (margin > 0.0).any() else 0.0
    return np.asarray(margin > min(NEAR_SINGULAR_MARGIN, 0.3 * typical))


def _efforts(robot: Robot, reduced: ReducedDynamics) -> tuple[IntArray, Array, dict[str, BoolArray]]:
    """Return velocity indices, the efforts that drive them (N, ·), and the states where there are none, by reason.

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


def _wrench_efforts(case: Case) -> Array:
    """Return (N, nv) what the robot's wrenches do at the joints, which forward dynamics take as given forces."""
    robot, motion, (q, v, a) = case.states.robot, case.states.motion, case.tree_motion
    loads = tree_loads(robot)
    if loads is None:
        return np.zeros_like(v)
    values, data = wrench_values(robot.loads, motion.t, motion.x, motion.xd), robot.model.createData()
    tree = (TreeState(q[k], v[k], a[k], [value[k] for value in values]) for k in range(len(q)))
    return np.array([loads.external(data, state) for state in tree])


def select(states: int | IntArray, **reasons: BoolArray) -> tuple[IntArray, dict[str, int]]:
    """Return the indices of states for which no reason (N,) holds, and how many are skipped for each reason.

    ``states`` is N, or the indices to choose from. A state is counted for the first reason that holds.
    """
    left, skipped = np.arange(states) if isinstance(states, int) else states, {}
    for name, holds in reasons.items():
        if count := int(holds[left].sum()):
            skipped[name] = count
        left = left[~holds[left]]
    return left, skipped


def relative(first: Array, second: Array) -> Array:
    """Return (N,) the largest difference of each sample (N, …) relative to the largest entry of the sample.

    The divisor is at least 1e-6, and a thousandth of the typical size of the whole array: rounding of a quantity that
    vanishes at one sample does not count.
    """
    if first.size == 0:
        return np.zeros(len(first))
    a, b = first.reshape(len(first), -1), second.reshape(len(first), -1)
    size = np.maximum(np.abs(a).max(axis=1), np.abs(b).max(axis=1))
    result: Array = np.abs(a - b).max(axis=1) / np.maximum(size, max(1e-6, 1e-3 * float(np.median(size))))
    return result
