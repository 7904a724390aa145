"""Random robots in random motion: three backends against each other and against physics, at type II poses too.

10,000 states of each shipped robot in ``make long``. The 2-RPR whose only masses are its carriers is judged by the
angular momentum of each leg, the terms of the carriers' motion by central differences.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pinocchio as pin
import pytest
from closed_forward import ClosedForward
from examples import FACTOR, SHARE
from load_definitions import load_efforts, load_energy
from promises import Keep
from random_robots import Masses, RandomCase, random_case
from scipy.optimize import brentq

from redundancy_pin import CarrierMotion, CompiledDynamics, PlatformMotion, RneaDynamics, VirtualWork
from redundancy_pin.arrays import Array
from redundancy_pin.crosscheck import CheckRow
from redundancy_pin.crosscheck.checks import check_states, relative
from redundancy_pin.crosscheck.report import checked_row, merged
from redundancy_pin.crosscheck.states import batches
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.dynamics.tree_loads import tree_energy
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.robot import JointForces, Robot, Spring, Wrench
from redundancy_pin.robot.scales import row_scale

ROBOTS = ("2rpr", "3rrr", "five_bar", "four_bar", "gough")
CLOSED_FORM = ROBOTS[:2]

AWAY_FROM_TYPE_ONE, PARITY = 0.05, 1e-10
MOMENTUM, DERIVATIVES = 1e-6, 1e-7
"""Sixth-order differences over 0.5 ms; central differences of a quadratic, exact but for rounding over 1e-3."""

STATES, PARTS = 10_000, 10
"""Of each robot in ``make long``, and tests that share them; each part has a seed of its own, and robots of its own."""


def checked(case: RandomCase) -> Iterator[CheckRow]:
    """Yield the rows of all checks on a random robot, those of users and those of the two closed forms."""
    states, robot = case.states, case.robot
    yield from check_states(states)
    if robot.closed_form is None:
        return
    along = RneaDynamics(robot).along(states.motion)
    keep = along.tree.serial_margin_bound > AWAY_FROM_TYPE_ONE
    manual, carriers = VirtualWork(robot).along(states.motion), states.carriers
    first, second = along.energy(carriers)[keep, None], manual.energy(carriers)[keep, None]
    yield checked_row(robot.name, "parity: energy", relative(first, second), PARITY, {})
    for block in ("f", "force"):
        one, other = (
            np.concatenate([getattr(d, f"{block}_{name}")[keep] for name in ("s", "sd", "sdd")], axis=2)
            for d in (along.carrier_derivatives(carriers), manual.carrier_derivatives(carriers))
        )
        yield checked_row(robot.name, f"parity: derivatives of {block}", relative(one, other), PARITY, {})


def random_rows(name: str, samples: int, seed: int) -> tuple[CheckRow, ...]:
    cases = (random_case(name, size, seed, index, masses=Masses.ALL) for index, size in enumerate(batches(samples)))
    return merged(row for case in cases for row in checked(case))


@pytest.mark.long_for("five_bar", "four_bar")
@pytest.mark.property
@pytest.mark.parametrize("name", ROBOTS)
def test_backends_agree_with_each_other_and_with_physics(name: str) -> None:
    rows = random_rows(name, 25 * FACTOR if FACTOR > 1 else 4, 3)
    assert all(row.passed for row in rows if not row.note), rows
    assert sum(row.check.startswith("parity") for row in rows) == (11 if name in CLOSED_FORM else 4)


@pytest.mark.long
@pytest.mark.parametrize("part", range(PARTS))
def test_many_states_of_random_robots(part: int, keep: Keep) -> None:
    states, failed = max(1, int(SHARE * STATES / PARTS)), []
    for name in ROBOTS:
        rows = random_rows(name, states, 100 + part)
        wrong = [row.check for row in rows if not row.passed and not row.note]
        # how many states of a check that fails are wrong is not known: one, at least
        keep("parity", name, {"right": states - len(wrong), "wrong": len(wrong)}, dict.fromkeys(wrong, 1))
        failed += wrong
    assert not failed


def test_random_robots_vary_parameters_modes_and_gravity() -> None:
    cases = [random_case("3rrr", 3, seed, index) for seed in range(2) for index in range(2)]
    assert len({case.robot.working_mode for case in cases}) > 1
    assert len({case.robot.parameters["distal_length"] for case in cases}) == len(cases)
    assert all(np.linalg.norm(case.robot.gravity) > 0 for case in cases)


def test_random_pose_motions_are_consistent() -> None:
    """Twists against finite differences of the poses they belong to; rates of angles and carriers likewise."""
    case, h = random_case("gough", 5, 0, masses=Masses.ALL), 1e-5
    before, at, after = (case.motion(case.t + shift) for shift in (-h, 0.0, h))
    np.testing.assert_allclose((after.x[:, :3, 3] - before.x[:, :3, 3]) / (2 * h), at.xd[:, :3], atol=1e-7)
    spin = (after.x[:, :3, :3] - before.x[:, :3, :3]) / (2 * h) @ at.x[:, :3, :3].transpose(0, 2, 1)
    omega = np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]], axis=1)
    np.testing.assert_allclose(omega, at.xd[:, 3:], atol=1e-7)
    np.testing.assert_allclose((after.xd - before.xd) / (2 * h), at.xdd, atol=1e-6)


# --- type II poses ---------------------------------------------------------------------------------------------------


def singular_poses(case: RandomCase, wanted: int = 8) -> Array:
    """Return type II poses (P, n) on chords through the workspace, from the closed form's determinant."""
    manual: Dynamics = VirtualWork(case.robot)
    rng = np.random.default_rng(len(case.t))
    reach = 1.5 * case.robot.characteristic_length / row_scale(case.robot)
    ends = case.path.mean + rng.uniform(-1.0, 1.0, (200, 2, case.robot.n)) * reach

    def determinant(x: Array) -> Array:
        zero = np.zeros_like(x)
        along = manual.along(PlatformMotion(np.arange(len(x), dtype=float), x, zero, zero), unreachable="mark")
        with np.errstate(invalid="ignore"):  # NaN marks poses out of reach
            value: Array = np.linalg.det(along.reduce().W)
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


@pytest.mark.parametrize("name", CLOSED_FORM)
def test_backends_agree_at_type_ii_poses(name: str) -> None:
    compared = 0
    for index in range(2 * FACTOR):
        case = random_case(name, 8, 3, index, masses=Masses.ALL)
        motion, carriers = case.motion(case.t), case.carriers(case.t)
        for k, pose in enumerate(singular_poses(case)):
            # one sample each: singular poses of one case do not lie on one path
            here = PlatformMotion(motion.t[k : k + 1], pose[None], motion.xd[k : k + 1], motion.xdd[k : k + 1])
            try:
                rnea = RneaDynamics(case.robot).along(here)
            except RedundancyPinError:
                continue  # not reached from the reference without crossing type I
            if rnea.tree.serial_margin_bound[0] < AWAY_FROM_TYPE_ONE:
                continue
            first = rnea.reduce(carriers[k : k + 1])
            singular = np.linalg.svd(first.W[0], compute_uv=False)
            assert singular[-1] < 1e-9 * singular[0]
            for backend in (VirtualWork, CompiledDynamics):
                other = backend(case.robot).along(here).reduce(carriers[k : k + 1])
                assert relative(first.f, other.f)[0] < PARITY
                assert relative(first.carrier_force, other.carrier_force)[0] < PARITY
            compared += 1
    assert compared > 5


# --- carriers ------------------------------------------------------------------------------------------------------

STENCIL, STEP = np.array([-1.0, 9.0, -45.0, 0.0, 45.0, -9.0, 1.0]) / 60.0, 5e-4


def differentiate(values: Array) -> Array:
    """Return the sixth-order derivative of (N, p, d) along axis 1, at its p − 6 inner points."""
    inner = values.shape[1] - 6
    total = sum((weight * values[:, j : j + inner] for j, weight in enumerate(STENCIL)), np.zeros_like(values[:, 6:]))
    return np.asarray(total / STEP)


@pytest.mark.parametrize("backend", [RneaDynamics, VirtualWork, CompiledDynamics])
def test_angular_momentum_of_each_leg_of_the_massless_machine(backend: type[Dynamics]) -> None:
    """f = Σ nᵢ Ḣᵢ / dᵢ, Hᵢ the angular momentum of carrier i about Aᵢ (Parsa 2014, eq. 2.17).

    The momentum comes from the carrier's position alone, differenced: r = L u + σ s n, H = m (r × ṙ).
    """
    for index in range(2 * FACTOR):
        case = random_case("2rpr", 1, 7, index, masses=Masses.ZERO_STAYS_ZERO, carriers=True)
        robot, t = case.robot, np.arange(0.1, 6.0, 0.5)
        motion = case.motion(t)
        along = backend(robot).along(motion)
        f, expected = along.reduce(case.carriers(t)).f, np.zeros_like(motion.x)
        mass, offset = float(robot.parameters["carrier_mass"]), float(robot.parameters["track_offset"])
        spread = (t[:, None] + STEP * np.arange(-6, 7)).ravel()
        wide, tracks = case.motion(spread), case.carriers(spread)
        for leg, (anchor, side) in enumerate(((0.0, 1.0), (float(robot.parameters["base_distance"]), -1.0))):
            u, n, _ = direction(wide.x, anchor, robot.working_mode[leg])
            place = (offset * u + side * tracks.s[:, leg : leg + 1] * n).reshape(len(t), 13, 2)
            velocity, inner = differentiate(place), place[:, 3:-3]
            momentum = mass * (inner[..., 0] * velocity[..., 1] - inner[..., 1] * velocity[..., 0])
            weight = mass * robot.gravity[:2]
            moment = place[:, 6, 0] * weight[1] - place[:, 6, 1] * weight[0]
            _, normal, length = direction(motion.x, anchor, robot.working_mode[leg])
            expected += normal * (momentum @ STENCIL / STEP - moment)[:, None] / length
        regular = RneaDynamics(robot).along(motion).tree.serial_margin_bound > AWAY_FROM_TYPE_ONE
        assert regular.sum() > 5
        assert relative(f[regular], expected[regular]).max() < MOMENTUM


def direction(x: Array, anchor: float, sign: int) -> tuple[Array, Array, Array]:
    """Return the direction of a leg (N, 2), its normal, and its signed length (N, 1)."""
    reach = x - np.array([anchor, 0.0])
    length = sign * np.linalg.norm(reach, axis=1, keepdims=True)
    u = reach / length
    return u, np.stack([-u[:, 1], u[:, 0]], axis=1), length


@pytest.mark.parametrize(
    ("name", "backend"),
    [
        *((name, backend) for name in CLOSED_FORM for backend in (RneaDynamics, VirtualWork, CompiledDynamics)),
        *((name, RneaDynamics) for name in ("five_bar", "gough")),
    ],
)
def test_derivatives_by_the_carriers_motion_are_differences(name: str, backend: type[Dynamics]) -> None:
    case = random_case(name, 6, 5, masses=Masses.ALL, carriers=True)
    carriers, along = case.carriers(case.t), backend(case.robot).along(case.motion(case.t))
    if case.robot.k:
        assert worst_derivative(along, carriers) < DERIVATIVES


def worst_derivative(along: DynamicsAlongMotion, carriers: CarrierMotion, step: float = 1e-3) -> float:
    exact, worst = along.carrier_derivatives(carriers), 0.0
    for argument in ("s", "sd", "sdd"):
        for k in range(carriers.s.shape[1]):
            shifted = []
            for sign in (1.0, -1.0):
                parts = {name: np.array(getattr(carriers, name)) for name in ("s", "sd", "sdd")}
                parts[argument][:, k] += sign * step
                shifted.append(along.reduce(CarrierMotion(parts["s"], parts["sd"], parts["sdd"])))
            for name, quantity in (("f", "f"), ("force", "carrier_force")):
                one, other = (getattr(each, quantity) for each in shifted)
                whole = getattr(exact, f"{name}_{argument}")
                size = np.maximum(np.abs(whole).max(axis=(1, 2)), np.abs(one).max(axis=1))
                off = np.abs(whole[:, :, k] - (one - other) / (2.0 * step)).max(axis=1) / np.maximum(size, 1.0)
                worst = float(np.maximum(worst, off.max()))  # a NaN stays
    return worst


# --- loads and closures by definition --------------------------------------------------------------------------------


def loaded(robot: Robot) -> Robot:
    links = [frame.name for frame in robot.model.frames if frame.type == pin.FrameType.BODY]
    joint = robot.model.names[2]
    return robot.loaded(
        JointForces(joint, damping=0.7, friction=0.4, friction_speed=0.5, stiffness=3.0, rest=0.2),
        JointForces(robot.model.names[1], rotor_inertia=2e-3, gear=-12.0),
        Spring(links[1], links[-1], 40.0, 3.0, 0.1, (0.05, 0.02, 0.01), (0.0, 0.03, 0.2)),
        Wrench(links[-1], [1.0, -2.0, 0.5, 0.3, 0.1, -0.4], "world", (0.1, 0.05, 0.02)),
        Wrench(links[1], [1.0, 2.0, 3.0, 0.1, 0.2, 0.3], "local", (0.1, 0.0, 0.3)),
    )


@pytest.mark.parametrize("name", ["five_bar", "3rrr"])
def test_efforts_move_the_loaded_machine_as_the_laws_of_motion_by_definition_say(name: str) -> None:
    """M a + h = τ + Jᵀ λ, J a + J̇ v = 0 with closures, loads and energy written out from Pinocchio's frames."""
    case = random_case(name, 6, 0, masses=Masses.ALL)
    robot, motion, carriers = loaded(case.robot), case.motion(case.t), case.carriers(case.t)
    along = RneaDynamics(robot).along(motion)
    reduced, (q, v, a) = along.reduce(carriers), along.tree_motion(carriers)
    own, data, judged = ClosedForward(robot), robot.model.createData(), 0
    loads = load_efforts(robot, motion, q.T, v.T, a.T).T
    for k in range(len(motion)):
        energy = load_energy(robot, q[k : k + 1].T, v[k : k + 1].T)[0]
        energy += pin.computeKineticEnergy(robot.model, data, q[k], v[k])
        energy += pin.computePotentialEnergy(robot.model, data, q[k])
        assert tree_energy(robot, data, q[k], v[k]) == pytest.approx(energy, rel=1e-12)
        singular = np.linalg.svd(reduced.W[k], compute_uv=False)
        if singular[-1] < 0.01 * singular[0]:
            continue
        effort = np.zeros(robot.model.nv)
        effort[robot.actuated_velocity] = np.linalg.solve(reduced.W[k], reduced.f[k])
        effort[robot.carrier_velocity] = reduced.carrier_force[k]
        reached, _ = own(q[k], v[k], effort - loads[k])
        np.testing.assert_allclose(reached, a[k], rtol=0.0, atol=1e-8 * np.abs(a[k]).max())
        judged += 1
        # exaggerated by a thousandth, loads are noticed
        reached, _ = own(q[k], v[k], effort - 1.001 * loads[k])
        assert np.abs(reached - a[k]).max() > 1e-7 * np.abs(a[k]).max()
    assert judged > 2
