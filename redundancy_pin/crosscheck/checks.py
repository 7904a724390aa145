"""The checks: backend against backend and against power, momentum, forward dynamics, differences; and their report."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from rich.markup import escape
from rich.table import Table
from scipy.optimize import brentq

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray, IntArray
from redundancy_pin.crosscheck.cases import REASONS, RandomCase, reason_of
from redundancy_pin.crosscheck.closed_forward import ClosedForward, confined_to_planes
from redundancy_pin.crosscheck.load_power import energy_rate, load_efforts
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.scales import row_scale
from redundancy_pin.simulation.system import ConstraintDynamics, has_point_closures


class Deviation(NamedTuple):
    """The outcome of one check on many states.

    Attributes:
        check: what was compared.
        values: (N,) deviation of each state.
        tolerance: the largest that passes.
        skipped: how many more states there are, by the reason (a key of ``REASONS``) for which they were skipped.
    """

    check: str
    values: Array
    tolerance: float
    skipped: Mapping[str, int]


def select(states: int, **reasons: BoolArray) -> tuple[IntArray, dict[str, int]]:
    """Return the states for which no reason (N,) holds, and how many are skipped for each: for the first that holds."""
    left, skipped = np.ones(states, dtype=bool), {}
    for name, holds in reasons.items():
        if count := int((left & holds).sum()):
            skipped[name] = count
        left &= ~holds
    return np.flatnonzero(left), skipped


PARITY = 1e-10
"""Rounding through two different routes: about 1e-14 times the condition of the closures, at most 1e3 here."""

AWAY_FROM_TYPE_ONE = 0.05


def check_parity(case: RandomCase) -> Iterator[Deviation]:
    """Compare f, W, carrier forces, their derivatives, base wrench and energy of both backends on random states."""
    motion, carriers = case.motion(case.t), case.carriers(case.t)
    rnea = RneaDynamics(case.robot).along(motion)
    manual = VirtualWork(case.robot).along(motion)
    keep, skipped = select(len(case.t), near_type_i=rnea.tree.serial_margin_bound <= AWAY_FROM_TYPE_ONE)
    first, second = rnea.reduce(carriers), manual.reduce(carriers)
    for label, a, b in (
        ("f", first.f, second.f),
        ("W", first.W, second.W),
        ("carrier force", first.carrier_force, second.carrier_force),
        ("base wrench", rnea.base_wrench(carriers), manual.base_wrench(carriers)),
        ("energy", rnea.energy(carriers)[:, None], manual.energy(carriers)[:, None]),
    ):
        yield Deviation(f"parity: {label}", relative(a[keep], b[keep]), PARITY, skipped)
    derivatives = rnea.carrier_derivatives(carriers), manual.carrier_derivatives(carriers)
    for block in ("f", "force"):
        a, b = (
            np.concatenate([getattr(d, f"{block}_{argument}")[keep] for argument in ("s", "sd", "sdd")], axis=2)
            for d in derivatives
        )
        check = f"parity: derivatives of {'carrier ' if block == 'force' else ''}{block}"
        yield Deviation(check, relative(a, b), PARITY, skipped)


def check_parity_on_singularities(case: RandomCase) -> Iterator[Deviation]:
    """Compare f on poses where W has lost rank, found by root finding along lines between the states of the case."""
    poses = _singular_poses(case)[: len(case.t)]
    if len(poses) == 0:
        return
    motion, carriers = case.motion(case.t[: len(poses)]), case.carriers(case.t[: len(poses)])
    skipped: Counter[str] = Counter()
    compared: dict[str, list[Array]] = {"f": [], "carrier force": []}
    for k in range(len(poses)):
        # one sample each: singular poses of one case do not lie on one path
        here = PlatformMotion(motion.t[k : k + 1], poses[k : k + 1], motion.xd[k : k + 1], motion.xdd[k : k + 1])
        try:
            rnea = RneaDynamics(case.robot).along(here)
        except RedundancyPinError as error:
            skipped[reason_of(error)] += 1  # not reached from the reference without crossing type I
            continue
        if rnea.tree.serial_margin_bound[0] < AWAY_FROM_TYPE_ONE:
            skipped["near_type_i"] += 1
            continue
        first = rnea.reduce(carriers[k : k + 1])
        second = VirtualWork(case.robot).along(here).reduce(carriers[k : k + 1])
        singular = np.linalg.svd(first.W[0], compute_uv=False)
        if not singular[-1] < 1e-9 * singular[0]:
            skipped["not_singular"] += 1
            continue
        compared["f"].append(relative(first.f, second.f))
        compared["carrier force"].append(relative(first.carrier_force, second.carrier_force))
    for label, values in compared.items():
        if values:
            yield Deviation(f"parity: {label} at type II poses", np.concatenate(values), PARITY, skipped)


def _singular_poses(case: RandomCase, wanted: int = 8) -> Array:
    """Return type II poses (P, n) on chords between states, from the closed form's determinant."""
    manual: Dynamics = VirtualWork(case.robot)
    rng = np.random.default_rng(len(case.t))
    reach = 1.5 * case.robot.characteristic_length / row_scale(case.robot)
    ends = case.path.mean + rng.uniform(-1.0, 1.0, (200, 2, case.robot.n)) * reach

    def determinant(x: Array) -> Array:
        zero = np.zeros_like(x)
        w = manual.along(PlatformMotion(np.arange(len(x), dtype=float), x, zero, zero), unreachable="mark")
        with np.errstate(invalid="ignore"):  # NaN marks poses out of reach
            value: Array = np.linalg.det(w.reduce().W)
        return value

    def on_chord(u: float, start: Array, stop: Array) -> float:
        return float(determinant((start + u * (stop - start))[None])[0])

    poses: list[Array] = []
    values = np.stack([determinant(ends[:, 0]), determinant(ends[:, 1])])
    for k in np.flatnonzero(values[0] * values[1] < 0.0):
        start, stop = ends[k]
        try:
            u = brentq(on_chord, 0.0, 1.0, args=(start, stop), xtol=1e-15, rtol=8.9e-16)
        except (ValueError, RuntimeError):
            continue  # the chord leaves the workspace, or jumps through a pole
        if abs(on_chord(u, start, stop)) < 1e-10 * np.abs(values[:, k]).max():
            poses.append(start + u * (stop - start))
        if len(poses) == wanted:
            break
    return np.array(poses).reshape(len(poses), case.robot.n)


_STENCIL = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0
_STEP = 5e-4
"""Sixth-order central differences: rounding is 1e-16 of the value over the step."""
_TURN = 0.01
"""Step of the energy's differences, as the angle by which all joints together turn in it: of the sine of twice that
angle the quotient leaves out 5e-13, and rounding is 1e-14."""

MOTION = 1e-10
"""Rounding of rows and of the solution of their equations is 1e-14 of their terms, and closures are open by 1e-12."""
POWER = 1e-10
MOMENTUM = 1e-8
_IDLE_MASS = 1e-12
"""Smallest eigenvalue of the mass matrix, over its diagonal, of a tree in which every motion moves a mass."""

ROUND_TRIP = 1e-7
"""Limited by the damped solver of the forward dynamics (mu 1e-8, 30 iterations) and the conditioning of W."""
_JUDGED = 1e-3
DERIVATIVES = 1e-7
"""Central differences of a quadratic are exact but for rounding: 1e-16 over the step of 1e-3, and cancellation."""


def check_motion(case: RandomCase) -> Iterator[Deviation]:
    """Rates and accelerations of the joints keep closures closed and move the platform as told: Pinocchio's frames."""
    motion = case.motion(case.t)
    tree = RneaDynamics(case.robot).along(motion)
    q, v, a = (part.T for part in tree.tree_motion(case.carriers(case.t)))
    keep, skipped = select(len(case.t), near_type_i=~_regular(tree.tree.serial_margin_bound))
    frames = ClosedForward(case.robot)
    missed = [frames.missed(q[:, k], v[:, k], a[:, k], motion.xd[k], motion.xdd[k]) for k in keep]
    yield Deviation("rates and accelerations of the joints", np.array(missed), MOTION, skipped)


def check_power(case: RandomCase, dynamics: Dynamics, label: str) -> Iterator[Deviation]:
    """Power of all actuators equals the rate of the energy: ẋᵀ f + ṡᵀ F = dE/dt (ẋᵀ f = q̇ₐᵀ τ).

    dE/dt asks for q, v and a alone, which ``check_motion`` judges: E is differenced along q ⊕ v u, v + a u, which
    leaves the closures. Along the closed motion rounding would grow as the inverse of the margin of a rank loss.
    """
    motion, carriers = case.motion(case.t), case.carriers(case.t)
    tree, along = RneaDynamics(case.robot).along(motion), dynamics.along(motion)
    keep, skipped = select(len(case.t), near_type_i=~_regular(tree.tree.serial_margin_bound))
    reduced, (q, v, a) = along.reduce(carriers), (part.T for part in tree.tree_motion(carriers))
    power = (reduced.f * motion.xd).sum(axis=1) + (reduced.carrier_force * carriers.sd).sum(axis=1)
    rate, energy, lost = energy_rate(case.robot, motion, q, v, a, _TURN, _STENCIL)
    size = np.maximum(np.maximum(np.abs(reduced.f * motion.xd).sum(axis=1), np.abs(energy)), 1e-3)
    yield Deviation(f"power balance ({label})", (np.abs(rate + lost - power) / size)[keep], POWER, skipped)
    missed = np.abs(along.energy(carriers) - energy) / size
    yield Deviation(f"energy ({label})", missed[keep], PARITY, skipped)


def check_leg_momentum(case: RandomCase, dynamics: Dynamics, label: str) -> Iterator[Deviation]:
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
    margin = RneaDynamics(robot).along(motion).tree.serial_margin_bound
    keep, skipped = select(len(t), near_type_i=~_regular(margin))
    if len(t) < len(case.t):
        skipped["too_close"] = len(case.t) - len(t)
    check = f"angular momentum of each leg ({label})"
    yield Deviation(check, relative(reduced.f[keep], expected[keep]), 100 * MOMENTUM, skipped)


def check_round_trip(case: RandomCase, dynamics: Dynamics, label: str) -> Iterator[Deviation]:
    """Efforts from inverse dynamics, given to Pinocchio's constrained forward dynamics, return the accelerations.

    Its solver knows points in space and in machines that are plane; for other closures ``ClosedForward`` stands in.
    What that says of its rounding is what may pass where it is more than ROUND_TRIP of the accelerations; states that
    it leaves without three digits are not judged.
    """
    robot, name = case.robot, f"inverse -> forward ({label})"
    if robot.m < robot.n and robot.platform is not None:
        yield Deviation(name, np.zeros(0), ROUND_TRIP, {"underactuated": len(case.t)})
        return
    motion, carriers = case.motion(case.t), case.carriers(case.t)
    rnea = RneaDynamics(robot).along(motion)
    reduced = dynamics.along(motion).reduce(carriers)
    driven, tau, unsolvable = _efforts(robot, reduced)
    keep, skipped = select(len(case.t), near_type_i=~_regular(rnea.tree.serial_margin_bound), **unsolvable)
    q, v, a = (part.T for part in rnea.tree_motion(carriers))
    effort = np.zeros_like(v)
    effort[driven] = tau.T
    effort[robot.carrier_velocity] = reduced.carrier_force.T
    if robot.loads:  # Pinocchio's solver knows none
        effort -= load_efforts(robot, motion, q, v, a)
    pointed = has_point_closures(robot) and confined_to_planes(robot, q[:, 0], v[:, 0])
    forward, rounding = np.empty((len(keep), len(v))), np.zeros(len(keep))
    if pointed:
        constrained = ConstraintDynamics(robot)
        for i, k in enumerate(keep):
            forward[i] = constrained(q[:, k], v[:, k], effort[:, k])
    else:
        closed = ClosedForward(robot)
        for i, k in enumerate(keep):
            forward[i], rounding[i] = closed(q[:, k], v[:, k], effort[:, k])
    coarse = ~(rounding <= _JUDGED * np.abs(a.T[keep]).max(axis=1))
    lost: BoolArray = np.logical_not(np.isfinite(forward).all(axis=1))
    lost[lost] = [has_massless_motion(robot.model, q[:, k]) for k in keep[lost]]
    judged, more = select(len(keep), massless=lost, ill_conditioned=coarse)
    floor = np.maximum(rounding / ROUND_TRIP, 1e-6)
    yield Deviation(name, relative(forward, a.T[keep], floor)[judged], ROUND_TRIP, {**skipped, **more})


def has_massless_motion(model: pin.Model, q: Array) -> bool:
    """Return whether the tree moves in some direction without moving a mass, so that no force says how fast."""
    mass = pin.crba(model, model.createData(), q)
    mass = np.triu(mass) + np.triu(mass, 1).T
    size = np.sqrt(np.diag(mass))
    if not size.all():
        return True
    return bool(np.linalg.eigvalsh(mass / np.outer(size, size))[0] < _IDLE_MASS)


def check_derivatives(case: RandomCase, along: DynamicsAlongMotion, label: str) -> Iterator[Deviation]:
    """Derivatives of f and carrier force by s, ṡ, s̈ against central differences (exact for a quadratic)."""
    check = f"derivatives by s, s', s'' ({label})"
    if not case.robot.k:
        yield Deviation(check, np.zeros(0), DERIVATIVES, {"no_carriers": len(case.t)})
        return
    carriers = case.carriers(case.t)
    exact = along.carrier_derivatives(carriers)
    step, worst = 1e-3, np.zeros(len(case.t))
    for argument in ("s", "sd", "sdd"):
        for k in range(case.robot.k):
            shifted = []
            for sign in (1.0, -1.0):
                parts = {name: np.array(getattr(carriers, name)) for name in ("s", "sd", "sdd")}
                parts[argument][:, k] += sign * step
                shifted.append(along.reduce(CarrierMotion(parts["s"], parts["sd"], parts["sdd"])))
            for name, quantity in (("f", "f"), ("force", "carrier_force")):
                difference = (getattr(shifted[0], quantity) - getattr(shifted[1], quantity)) / (2.0 * step)
                whole = getattr(exact, f"{name}_{argument}")
                size = np.maximum(np.abs(whole).max(axis=(1, 2)), np.abs(getattr(shifted[0], quantity)).max(axis=1))
                deviation = np.abs(whole[:, :, k] - difference).max(axis=1) / np.maximum(size, 1.0)
                worst = np.maximum(worst, deviation)  # a NaN stays
    yield Deviation(check, worst, DERIVATIVES, {})


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
    return np.asarray(slots * spacing)


def _regular(margin: Array) -> BoolArray:
    """Return (N,) where a motion keeps away from type I; the bound falls with joints: of legs it is low everywhere."""
    typical = float(np.median(margin[margin > 0.0])) if (margin > 0.0).any() else 0.0
    return np.asarray(margin > min(NEAR_SINGULAR_MARGIN, 0.3 * typical))


def _efforts(robot: Robot, reduced: ReducedDynamics) -> tuple[IntArray, Array, dict[str, BoolArray]]:
    """Return driven velocities, their minimum-norm efforts where W has full row rank by a margin, and where it has not.

    Where the motors cannot do it, as of a machine whose arms are not driven, the independent joints are, whose efforts
    are f.
    """
    singular = np.linalg.svd(reduced.W, compute_uv=False)
    solvable: BoolArray = (robot.m >= robot.n) & (singular[:, -1] > NEAR_SINGULAR_MARGIN * singular[:, 0])
    if robot.platform is None and not solvable.any():
        joints = (find_joint(robot.model, name) for name in robot.independent_joints)
        unknown = ~np.isfinite(reduced.f).all(axis=1)
        return np.array([each.idx_v for each in joints]), reduced.f, {"not_finite": np.asarray(unknown)}
    safe = np.where(solvable[:, None, None], reduced.W, np.eye(*reduced.W.shape[1:]))
    tau: Array = (np.linalg.pinv(safe) @ reduced.f[:, :, None])[:, :, 0]
    return robot.actuated_velocity, tau, {"near_type_ii": ~solvable}


# --- report --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class CheckRow:
    """One check on one robot.

    Attributes:
        robot: robot it was made on.
        check: what was compared.
        samples: number of states that were checked (of the row "random motions": motions that were used).
        worst: largest deviation, relative to the size of what was compared.
        tolerance: largest deviation that passes.
        passed: whether it does; false for a check without samples or with NaN.
        note: why the row is no check and does not count; empty for a check.
        skipped: number of states that were skipped, by reason (a key of ``REASONS``).
    """

    robot: str
    check: str
    samples: int
    worst: float
    tolerance: float
    passed: bool
    note: str = ""
    skipped: Mapping[str, int] = field(default_factory=dict)

    @property
    def total(self) -> int:
        """Number of states, those that were skipped included."""
        return self.samples + sum(self.skipped.values())

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON and tables."""
        return {**asdict(self), "total": self.total}


@dataclass(frozen=True)
class CrossCheckReport:
    """All rows of a cross-check."""

    rows: tuple[CheckRow, ...]
    seed: int

    @property
    def passed(self) -> bool:
        """Whether there are checks, every robot was judged by physics, and every check passes."""
        checks = [row for row in self.rows if not row.note]
        return bool(checks) and not self.unjudged and all(row.passed for row in checks)

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Robots of which nothing was checked against physics: backends that agree may share what they were given."""
        judged = {row.robot for row in self.rows if not row.note and not row.check.startswith("parity")}
        return tuple(dict.fromkeys(row.robot for row in self.rows if row.robot not in judged))

    def as_dict(self) -> dict[str, object]:
        """Return plain numbers, for JSON."""
        return {"passed": self.passed, "seed": self.seed, "rows": [row.as_dict() for row in self.rows]}

    def table(self) -> Table:
        """Return the report as a table for the terminal."""
        table = Table("robot", "check", title=f"cross-check, seed {self.seed}")
        for heading in ("states", "worst", "allowed", ""):
            table.add_column(heading, justify="right")
        for row in self.rows:
            states = f"{row.samples} of {row.total}" if row.skipped else str(row.samples)
            if row.note:
                table.add_row(row.robot, f"{row.check}: {escape(row.note)}", states, "", "", "left out")
            else:
                verdict = "[green]ok[/green]" if row.passed else "[red]FAILED[/red]"
                table.add_row(row.robot, row.check, states, f"{row.worst:.1e}", f"{row.tolerance:.0e}", verdict)
            for reason, count in row.skipped.items():
                table.add_row("", f"  skipped: {REASONS[reason]}", str(count), "", "", "")
        return table


def checked_row(robot: str, deviation: Deviation) -> CheckRow:
    """Return the row of one check; a deviation that is not finite makes the worst NaN."""
    check, values, tolerance, skipped = deviation
    worst = float(np.max(values, initial=0.0)) if np.isfinite(values).all() else float("nan")
    passed = bool(len(values) > 0 and worst <= tolerance)
    return CheckRow(robot, check, len(values), worst, tolerance, passed, skipped=dict(skipped))


def merged(rows: Iterable[CheckRow]) -> tuple[CheckRow, ...]:
    """Return one row a check and robot, in the order of first appearance; a NaN stays."""
    total: dict[tuple[str, str], CheckRow] = {}
    for row in rows:
        before = total.get((row.robot, row.check), row)
        samples = row.samples + (before.samples if before is not row else 0)
        worst = float(np.maximum(before.worst, row.worst))
        passed = samples > 0 and worst <= row.tolerance
        note = row.note and before.note  # one batch with states is a check
        skipped = dict(Counter(row.skipped) + Counter(before.skipped if before is not row else {}))
        total[row.robot, row.check] = replace(
            row, samples=samples, worst=worst, passed=passed, note=note, skipped=skipped
        )
    return tuple(total.values())


def relative(first: Array, second: Array, floor: float | Array = 1e-6) -> Array:
    """Return (N,) the largest difference of each sample (N, …) relative to the largest entry of the sample.

    The least size to divide by keeps rounding of what happens to vanish from being blown up: the floor, or a thousandth
    of the typical size of the whole array where that is larger.
    """
    count = len(first)
    if first.size == 0:
        return np.zeros(count)
    a, b = first.reshape(count, -1), second.reshape(count, -1)
    size = np.maximum(np.abs(a).max(axis=1), np.abs(b).max(axis=1))
    typical = float(np.median(size)) if count else 0.0
    result: Array = np.abs(a - b).max(axis=1) / np.maximum(size, np.maximum(floor, 1e-3 * typical))
    return result
