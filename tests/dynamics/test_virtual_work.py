"""Closed forms of the 2-RPR and the 3-RRR; and every backend against Lagrange's equations for point masses.

Nothing of that oracle knows a velocity or force formula: every body is replaced by point masses with the same mass,
centre and inertia (a slender rod by Simpson's 1:4:1, a disc by three points on a ring). Their positions are written
down as functions of q = (x, s), and the rest is differentiation: complex steps, exact to rounding, for the first
derivative of positions; central differences of order eight for the derivatives of kinetic energy and of momentum.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
import pytest
import zoo
from hypothesis import given
from hypothesis import strategies as st

import redundancy_pin as rp
from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array
from redundancy_pin.dynamics.base import DynamicsAlongMotion
from redundancy_pin.dynamics.virtual_work import two_rpr
from redundancy_pin.dynamics.virtual_work.three_rrr import ThreeRrrGeometry, ThreeRrrMechanism, inverse_displacement
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.robot.shipped import models_root

ROUNDING = 1e-13
"""A few hundred roundings of lengths of a few metres."""

GAP_ROUNDING = 1e-12
"""m: where the border is touched the gap is a difference of lengths that went through their squares."""

THESIS = ThreeRrrGeometry(1.0, 0.25, 1.0, 1.0)

UNEQUAL = ThreeRrrGeometry(0.9, 0.3, 1.2, 0.9)

PHI = np.array([np.pi / 6, 5 * np.pi / 6, -np.pi / 2])

coordinate = st.floats(-3, 3)


def u(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def corners(geometry, pose):
    return pose[:2] - geometry.platform_radius * u(pose[2] + PHI)


@given(x=coordinate, y=coordinate, mode=st.tuples(*[st.sampled_from([1, -1])] * 2))
def test_legs_of_the_two_rpr_close_the_loops_in_their_mode(x, y, mode):
    legs = two_rpr.inverse_displacement(0.5, [[x, y]], mode)
    away = np.hypot([x, x - 0.5], y) > 1e-6
    np.testing.assert_array_equal(np.sign(legs.d[away, 0]), np.array(mode)[away])
    tip = np.array([[0.0, 0.0], [0.5, 0.0]]) + legs.d * u(np.angle(legs.u[:, 0]))
    np.testing.assert_allclose(tip[away], np.tile([x, y], (2, 1))[away], atol=ROUNDING)
    assert np.all(legs.residual[away] < ROUNDING)


@given(
    pose=st.tuples(st.floats(-1, 2.5), st.floats(-1, 2.5), st.floats(-np.pi, np.pi)),
    geometry=st.sampled_from([THESIS, UNEQUAL]),
)
def test_all_modes_of_the_three_rrr_close_or_report_how_far_the_corner_is(pose, geometry):
    pose = np.array(pose)
    A, G = corners(geometry, pose), geometry.base_points
    rho = np.hypot(*(A - G).T)
    l1, l2 = geometry.proximal_length, geometry.distal_length
    short = np.maximum(np.maximum(rho - l1 - l2, abs(l1 - l2) - rho), 0.0)
    within = short == 0.0
    for mode in product((1, -1), repeat=3):
        legs = inverse_displacement(geometry, pose[None], mode)
        tip = G + l1 * u(legs.theta[:, 0]) + l2 * u(legs.beta[:, 0])
        np.testing.assert_allclose(tip[within], A[within], atol=ROUNDING)
        np.testing.assert_allclose(np.abs(legs.b)[within], l1, atol=ROUNDING)
        np.testing.assert_allclose(np.abs(legs.e)[within], l2, atol=ROUNDING)
        np.testing.assert_allclose(legs.residual[:, 0], short, atol=GAP_ROUNDING)
        # θ = γ ± ψ: the mode is the side of the line G A on which the elbow lies
        side = np.sin(legs.theta[:, 0] - np.arctan2(*(A - G).T[::-1]))
        clear = within & (np.abs(side) > 1e-6)
        np.testing.assert_array_equal(np.sign(side)[clear], np.array(mode)[clear])


def test_thesis_formulas_for_theta_and_jacobian():
    """Angles by arc cosine and the Jacobian's entries as printed (Parsa 2014, eq. 2.22-2.38)."""
    pose, mode = np.array([1.0, 0.4, 0.3]), (1, -1, 1)
    legs = inverse_displacement(UNEQUAL, pose[None], mode)
    l1, l2, l3 = 1.2, 0.9, 0.3
    for i in range(3):
        xA, yA = corners(UNEQUAL, pose)[i] - UNEQUAL.base_points[i]
        rho = np.hypot(xA, yA)
        theta = np.arctan2(yA, xA) + mode[i] * np.arccos((l1**2 + rho**2 - l2**2) / (2 * l1 * rho))
        phi = pose[2] + PHI[i]
        a, b = xA - l1 * np.cos(theta), yA - l1 * np.sin(theta)
        c, d = l1 * (xA * np.sin(theta) - yA * np.cos(theta)), l3 * (a * np.sin(phi) - b * np.cos(phi))
        assert abs(np.exp(1j * theta) - np.exp(1j * legs.theta[i, 0])) < ROUNDING
        np.testing.assert_allclose(legs.jacobian[:, i, 0], -np.array([a, b, d]) / c, atol=ROUNDING)
        np.testing.assert_allclose(legs.c[i, 0], c, atol=ROUNDING)


UNEQUAL_LENGTHS = {"base_radius": 0.9, "platform_radius": 0.3, "proximal_length": 1.2, "distal_length": 0.9}


@pytest.mark.parametrize(("beyond", "reached"), [(0.5 * CLOSURE_TOLERANCE, True), (1e-9, False), (0.3, False)])
def test_reach_ends_at_the_stretched_leg(beyond, reached):
    """Leg 1 is stretched along its own arm: G, B, A and P on one line at 30 degrees."""
    legs = inverse_displacement(THESIS, np.append((2.0 + 0.25 + beyond) * u(np.pi / 6), 0.0)[None])
    assert legs.reachable[0, 0] == reached
    assert np.isnan(legs.b[0, 0]) != reached
    np.testing.assert_allclose(legs.residual[0, 0], beyond, atol=1e-14)  # roundings of 2 m


def test_legs_without_a_direction_give_no_warning():
    """A leg of no length, which any direction closes; a folded leg of equal links, which any angle closes: c = 0."""
    short = two_rpr.inverse_displacement(0.5, [[0.0, 0.0]])
    assert np.isnan(short.u[0, 0])
    assert short.u[1, 0] == -1.0
    np.testing.assert_array_equal(short.residual, 0.0)
    folded = inverse_displacement(THESIS, np.append(0.25 * u(np.pi / 6), 0.0)[None])
    assert abs(folded.margin[0, 0]) < 1e-12
    assert folded.reachable[0, 0]
    for array in (short.d, short.u, short.jacobian, folded.b, folded.residual, folded.theta, folded.jacobian):
        assert not array.flags.writeable


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
@pytest.mark.parametrize("change", [{"closed_form": None}, {"closed_form": "gough"}, {"working_mode": (1,)}])
def test_robots_without_a_closed_form_are_refused(name, change):
    with pytest.raises(UnsupportedRobotError, match="RneaDynamics"):
        rp.VirtualWork(replace(zoo.robot_of(name), **change))


@pytest.mark.parametrize(
    ("model", "old", "new"),
    [
        ("2rpr", "actuated: [slide_1, slide_2]", "actuated: [slide_2, slide_1]"),
        ("2rpr", "actuated: [slide_1, slide_2]", "actuated: [swivel_1, slide_2]"),
        ("2rpr", "signs: [1, 1]", "signs: [1, -1]"),
        ("3rrr", "actuated: [base_1, base_2, base_3]", "actuated: [elbow_1, base_2, base_3]"),
        ("3rrr", "actuated: [base_1, base_2, base_3]", "actuated: [base_1, base_2, base_3, elbow_1]"),
        ("3rrr", "joints: [elbow_1, elbow_2, elbow_3]", "joints: [elbow_2, elbow_1, elbow_3]"),
        ("3rrr", "carrier_1, acceleration", "carrier_2, acceleration"),
    ],
)
def test_motors_modes_and_carriers_in_another_order_have_no_closed_form(model, old, new, tmp_path):
    """Its numbers would be those of other motors; all other backends take them."""
    for file in (models_root() / model).iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "robot.yaml"
    text = path.read_text()
    assert text.count(old) == 1
    text = text.replace(new, "@") if old.startswith("carrier") else text  # the two change places
    path.write_text(text.replace(old, new).replace("@", old))
    robot = rp.load_robot(path)
    assert robot.closed_form is None
    with pytest.raises(UnsupportedRobotError, match="other motors, modes or carriers"):
        rp.VirtualWork(robot)


def test_one_sample_has_no_spring_that_counts_turns_and_the_slack_of_tracks_of_all_backends():
    plain, still = rp.load_robot("3rrr"), np.zeros(3)
    x = follower(plain).home.x
    for joint, refused in (("base_1", True), (plain.carriers[0], False)):
        sprung = rp.VirtualWork(plain.loaded(rp.JointForces(joint, stiffness=7.0)))
        if refused:
            with pytest.raises(UnsupportedRobotError, match="whole turns"):
                sprung.torque(x, still, still)
        else:
            assert sprung.torque(x, still, still).status.solved
    upper = plain.carrier_limits[0].upper
    for s, status in ((upper * (1.0 + 1e-15), "ok"), (upper * (1.0 + 1e-6), "out_of_range")):
        for backend in (rp.VirtualWork, rp.RneaDynamics):
            assert backend(plain).torque(x, still, still, [s, 0.0, 0.0]).status.label == status


# --- every backend against Lagrange's equations for point masses


COMPLEX_STEP = 1e-30
CENTRAL = ((1, 4 / 5), (2, -1 / 5), (3, 4 / 105), (4, -1 / 280))
STEP = 2e-3
"""Step of the central differences: the error is of the order (step / length of variation)^8, far below rounding
over step, 1e-13."""


def derivative(function: Callable[[float], np.ndarray], step: float = STEP) -> np.ndarray:
    """Derivative at 0 by central differences of order eight."""
    return sum(weight * (function(k * step) - function(-k * step)) for k, weight in CENTRAL) / step


@dataclass(frozen=True)
class PointMasses:
    """``positions`` maps q (complex allowed) to (P, 2); ``masses`` is (P,)."""

    masses: np.ndarray
    positions: Callable[[np.ndarray], np.ndarray]

    def velocities(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """(P, 2) velocities."""
        return self.positions(q + 1j * COMPLEX_STEP * qd).imag / COMPLEX_STEP

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        """(P, 2, len(q)) derivatives of the positions."""
        return np.stack([self.velocities(q, direction) for direction in np.eye(len(q))], axis=2)

    def kinetic(self, q: np.ndarray, qd: np.ndarray) -> float:
        """Kinetic energy."""
        return 0.5 * float(self.masses @ (self.velocities(q, qd) ** 2).sum(axis=1))

    def energy(self, q: np.ndarray, qd: np.ndarray, gravity: np.ndarray) -> float:
        """Kinetic plus potential energy, zero height at the origin."""
        return self.kinetic(q, qd) - float(self.masses @ self.positions(q) @ gravity[:2])

    def momentum(self, q: np.ndarray, qd: np.ndarray) -> np.ndarray:
        """(3,) linear momentum and angular momentum about the origin."""
        r, v = self.positions(q), self.velocities(q, qd)
        return np.array([*(self.masses @ v), self.masses @ (r[:, 0] * v[:, 1] - r[:, 1] * v[:, 0])])

    def generalised_force(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, gravity: np.ndarray) -> np.ndarray:
        """d/dt (dT/dq̇) - dT/dq + dU/dq at a state and acceleration."""

        def conjugate(t: float) -> np.ndarray:
            q_t, qd_t = q + qd * t + 0.5 * qdd * t * t, qd + qdd * t
            return np.einsum("p,pcj,pc->j", self.masses, self.jacobian(q_t), self.velocities(q_t, qd_t))

        def kinetic_gradient(direction: np.ndarray) -> float:
            return float(derivative(lambda h: np.asarray(self.kinetic(q + h * direction, qd))))

        weight = np.einsum("p,pcj,c->j", self.masses, self.jacobian(q), gravity[:2])
        return derivative(conjugate) - np.array([kinetic_gradient(e) for e in np.eye(len(q))]) - weight

    def base_wrench(self, q: np.ndarray, qd: np.ndarray, qdd: np.ndarray, gravity: np.ndarray) -> np.ndarray:
        """(6,) weight less the rate of momentum, moments about the origin."""
        rate = derivative(lambda t: self.momentum(q + qd * t + 0.5 * qdd * t * t, qd + qdd * t))
        r = np.column_stack([self.positions(q), np.zeros(len(self.masses))])
        weight = self.masses[:, None] * gravity
        total = np.concatenate([weight.sum(axis=0), np.cross(r, weight).sum(axis=0)])
        return total - np.array([rate[0], rate[1], 0.0, 0.0, 0.0, rate[2]])


def rod(mass: float) -> list[float]:
    """Masses of the two ends and the middle that stand for a slender rod."""
    return [mass / 6, 4 * mass / 6, mass / 6]


def angle_of(v: np.ndarray) -> complex:
    """atan2 for a complex step: the step rides along in the imaginary part, to first order."""
    re, im = v.real, v.imag
    return np.arctan2(re[1], re[0]) + 1j * (re[0] * im[1] - re[1] * im[0]) / (re @ re)


def arccos(value: complex) -> complex:
    """Arc cosine for a complex step."""
    return np.arccos(value.real) - 1j * value.imag / np.sqrt(1.0 - value.real**2)


def two_rpr_masses(parameters: dict, mode: tuple[int, int]) -> PointMasses:
    """The 2-RPR as point masses; q = (x, y, s1, s2)."""
    p = parameters
    masses = [p["end_effector_mass"]]
    for _ in range(2):
        masses += rod(p["cylinder_mass"]) + rod(p["piston_mass"]) + [p["carrier_mass"] if p["carriers"] else 0.0]

    def positions(q: np.ndarray) -> np.ndarray:
        B = q[:2]
        points = [B]
        for leg in range(2):
            A = np.array([leg * p["base_distance"], 0.0])
            u = mode[leg] * (B - A) / np.sqrt(((B - A) ** 2).sum())
            n = np.array([-u[1], u[0]])
            points += [A + k * p["cylinder_length"] * u for k in (0.0, 0.5, 1.0)]
            points += [B - k * p["piston_length"] * u for k in (0.0, 0.5, 1.0)]
            points += [A + p["track_offset"] * u + (1, -1)[leg] * q[2 + leg] * n]
        return np.array(points)

    return PointMasses(np.array(masses), positions)


def three_rrr_masses(parameters: dict, mode: tuple[int, int, int]) -> PointMasses:
    """The 3-RRR as point masses; q = (x, y, α, s1, s2, s3). Angles by eq. 2.22-2.27 of the thesis."""
    p = parameters
    l1, l2, l3, R = (p[k] for k in ("proximal_length", "distal_length", "platform_radius", "base_radius"))
    given = p["platform_inertia"]
    gyration = l3 * np.sqrt(0.5) if given == "auto" else np.sqrt(given / p["platform_mass"])
    tail = p["tail_length"] if p["carriers"] else 0.0
    masses = [p["platform_mass"] / 3] * 3
    for _ in range(3):
        masses += rod(p["proximal_mass"]) + rod(p["distal_mass"]) + [p["carrier_mass"] if p["carriers"] else 0.0]

    def u(angle: complex) -> np.ndarray:
        return np.array([np.cos(angle), np.sin(angle)])

    def positions(q: np.ndarray) -> np.ndarray:
        P, alpha = q[:2], q[2]
        points = [P + gyration * u(alpha + k * 2 * np.pi / 3) for k in range(3)]
        for leg in range(3):
            G = R * np.array([(0, 0), (np.sqrt(3), 0), (np.sqrt(3) / 2, 1.5)][leg])
            A = P - l3 * u(alpha + (np.pi / 6, 5 * np.pi / 6, -np.pi / 2)[leg])
            rho = np.sqrt(((A - G) ** 2).sum())
            theta = angle_of(A - G) + mode[leg] * arccos((l1**2 + rho**2 - l2**2) / (2 * l1 * rho))
            B = G + l1 * u(theta)
            along = (A - B) / l2
            points += [G + k * l1 * u(theta) for k in (0.0, 0.5, 1.0)]
            points += [B + (-tail + k * (l2 + tail)) * along for k in (0.0, 0.5, 1.0)]
            points += [B + q[3 + leg] * along]
        return np.array(points) if np.iscomplexobj(q) else np.array(points).real

    return PointMasses(np.array(masses), positions)


AGREEMENT = 1e-8
"""Relative to the largest effort of the sample. Central differences over a step of 2e-3 round at 1e-13, and the poses
keep a margin of 0.3 to type I."""

STATES = 12
SEEDS = range(8)


@dataclass(frozen=True)
class Case:
    """A random machine in random states, one row each; q = (x, s), a carrier for each leg: of mass 0 if it has none."""

    backend: type[rp.VirtualWork] | type[rp.CompiledDynamics]
    robot: rp.Robot
    oracle: PointMasses
    q: Array
    qd: Array
    qdd: Array

    @property
    def along(self) -> DynamicsAlongMotion:
        """The dynamics along the platform's states."""
        parts = (part[:, : self.robot.n] for part in (self.q, self.qd, self.qdd))
        motion = rp.PlatformMotion(np.arange(float(len(self.q))), *parts, check_rates=False)
        return self.backend(self.robot).along(motion)

    @property
    def carriers(self) -> rp.CarrierMotion:
        """The carriers' states."""
        n, k = self.robot.n, self.robot.k
        parts = (part[:, n : n + k] for part in (self.q, self.qd, self.qdd))
        return rp.CarrierMotion(*parts, check_rates=False)

    def states(self) -> Iterator[tuple[Array, Array, Array]]:
        """Iterate over (q, qd, qdd)."""
        return zip(self.q, self.qd, self.qdd, strict=True)

    def moved(self, t: float) -> Case:
        """Return the case after a time of its accelerations, s."""
        return replace(self, q=self.q + self.qd * t + 0.5 * self.qdd * t**2, qd=self.qd + self.qdd * t)


def numbers_of(name: str, seed: int) -> dict[str, object]:
    """Return random arguments of a model, carriers and the disc's inertia among them."""
    rng = np.random.default_rng(seed)
    if name == "2rpr":
        names = ("track_offset", "carrier_mass", "end_effector_mass", "cylinder_mass", "cylinder_length")
        names += ("piston_mass", "piston_length", "base_distance")
        return {key: float(rng.uniform(0.1, 1.5)) for key in names} | {"carriers": seed % 4 != 3}
    names = ("proximal_mass", "distal_mass", "platform_mass", "carrier_mass", "tail_length")
    parameters: dict[str, object] = {key: float(rng.uniform(0.3, 1.5)) for key in names}
    parameters |= {key: float(rng.uniform(1.0, 1.5)) for key in ("proximal_length", "distal_length")}
    parameters |= {"platform_radius": float(rng.uniform(0.1, 0.4)), "base_radius": float(rng.uniform(0.8, 1.2))}
    return parameters | {"carriers": seed % 4 != 3, "platform_inertia": "auto" if seed % 2 else 0.05}


def poses_of(robot: rp.Robot, rng: np.random.Generator) -> Array:
    """Return poses anywhere, away from type I."""
    if robot.name == "2rpr":
        height = rng.uniform(0.5, 2, STATES) * rng.choice([1, -1], STATES)
        return np.column_stack([rng.uniform(-1, 2, STATES), height])
    centre = float(robot.parameters["base_radius"]) * np.array([np.sqrt(3) / 2, 0.5])
    tries = np.column_stack([centre + rng.uniform(-1, 1, (2000, 2)), rng.uniform(-np.pi, np.pi, 2000)])
    legs = ThreeRrrMechanism(robot.parameters, robot.gravity, robot.working_mode).legs(tries)
    x = tries[(legs.margin > 0.3).all(axis=0)][:STATES]
    assert len(x) == STATES
    return x


def case_of(backend: type[rp.VirtualWork] | type[rp.CompiledDynamics], name: str, seed: int) -> Case:
    """Return closed forms at poses anywhere, and what follows a branch along a motion."""
    rng = np.random.default_rng(seed)
    mode = tuple(rng.choice([1, -1], 2 if name == "2rpr" else 3).tolist())
    gravity = rng.uniform(-10.0, 10.0, 3)
    robot = rp.load_robot(name, working_mode=mode, gravity=tuple(gravity), **numbers_of(name, seed))
    oracle = (two_rpr_masses if name == "2rpr" else three_rrr_masses)(dict(robot.parameters), mode)
    if backend is rp.VirtualWork:
        x, (xd, xdd) = poses_of(robot, rng), rng.uniform(-2, 2, (2, STATES, robot.n))
    else:
        motion = zoo.smooth_motion(robot, seed).at(np.linspace(0.0, 1.0, STATES))
        x, xd, xdd = motion.x, motion.xd, motion.xdd
    s, (sd, sdd) = rng.uniform(-1, 1, (STATES, robot.m)), rng.uniform(-2, 2, (2, STATES, robot.m))
    return Case(backend, robot, oracle, np.hstack([x, s]), np.hstack([xd, sd]), np.hstack([xdd, sdd]))


CASES = [(rp.VirtualWork, name, seed) for name in ("2rpr", "3rrr") for seed in SEEDS]
CASES += [(rp.CompiledDynamics, name, seed) for name in ("2rpr", "3rrr") for seed in (1, 2, 3)]


@pytest.fixture(params=CASES, ids=lambda p: f"{p[0].__name__}-{p[1]}-{p[2]}")
def case(request: pytest.FixtureRequest) -> Case:
    return case_of(*request.param)


def assert_close(got: Array, want: Array, tolerance: float = AGREEMENT) -> None:
    scale = max(1.0, np.abs(want).max(initial=0.0))
    np.testing.assert_allclose(got, want, rtol=0, atol=tolerance * scale)


@pytest.mark.long_for(
    *(f"VirtualWork-{name}-{seed}" for name in ("2rpr", "3rrr") for seed in range(2, 8)),
    *(f"CompiledDynamics-{name}-{seed}" for name in ("2rpr", "3rrr") for seed in (2, 3)),
)
def test_efforts_and_base_wrench_obey_lagrange(case: Case) -> None:
    reduced, wrench = case.along.reduce(case.carriers), case.along.base_wrench(case.carriers)
    for k, state in enumerate(case.states()):
        got = np.concatenate([reduced.f[k], reduced.carrier_force[k]])
        assert_close(got, case.oracle.generalised_force(*state, case.robot.gravity)[: len(got)])
        assert_close(wrench[k], case.oracle.base_wrench(*state, case.robot.gravity))


def test_energy_is_that_of_the_point_masses_and_grows_by_the_power(case: Case) -> None:
    got = case.along.energy(case.carriers)
    want = [case.oracle.energy(q, qd, case.robot.gravity) for q, qd, _ in case.states()]
    assert_close(got, np.array(want), 1e-12)  # both exact but for rounding
    reduced, carriers = case.along.reduce(case.carriers), case.carriers
    power = (reduced.f * case.qd[:, : case.robot.n]).sum(axis=1) + (reduced.carrier_force * carriers.sd).sum(axis=1)

    def energy_at(t: float) -> Array:
        moved = case.moved(t)
        return moved.along.energy(moved.carriers)

    assert_close(power, derivative(energy_at))


def test_derivatives_by_the_carriers(case: Case) -> None:
    """f is quadratic in (s, ṡ) and affine in s̈, as are the forces: central differences are exact for any step."""
    along, carriers = case.along, case.carriers
    exact = along.carrier_derivatives(carriers)
    for which in ("s", "sd", "sdd"):
        for leg in range(case.robot.k):
            up, down = (
                along.reduce(replace(carriers, **{which: getattr(carriers, which) + step * np.eye(case.robot.k)[leg]}))
                for step in (0.5, -0.5)
            )
            assert_close(getattr(exact, f"f_{which}")[:, :, leg], up.f - down.f, 1e-12)
            assert_close(getattr(exact, f"force_{which}")[:, :, leg], up.carrier_force - down.carrier_force, 1e-12)


def test_W_is_the_derivative_of_the_actuated_joints(case: Case) -> None:
    """Lengths of legs and angles of cranks in closed form, by complex steps (Parsa 2014, eqs. 2.3 and 2.22)."""
    robot, W = case.robot, case.along.reduce().W
    for x, own in zip(case.q[:, : robot.n], W, strict=True):
        for row, direction in zip(own, np.eye(robot.n), strict=True):
            want = actuated(robot, x + 1j * COMPLEX_STEP * direction).imag / COMPLEX_STEP
            assert_close(row, want, 1e-11)


def actuated(robot: rp.Robot, x: Array) -> Array:
    """Return (m,) the actuated joints at coordinates (n,), complex ones too."""
    sizes, joints = {key: value for key, value in robot.parameters.items() if isinstance(value, float)}, []
    for leg, mode in enumerate(robot.working_mode):
        if robot.name == "2rpr":
            joints.append(mode * np.sqrt((x[0] - leg * sizes["base_distance"]) ** 2 + x[1] ** 2))
            continue
        hinge = sizes["base_radius"] * np.array([(0, 0), (np.sqrt(3), 0), (np.sqrt(3) / 2, 1.5)][leg])
        turned = x[2] + (np.pi / 6, 5 * np.pi / 6, -np.pi / 2)[leg]
        corner = x[:2] - sizes["platform_radius"] * np.array([np.cos(turned), np.sin(turned)]) - hinge
        rho, first = np.sqrt((corner**2).sum()), sizes["proximal_length"]
        cosine = (first**2 + rho**2 - sizes["distal_length"] ** 2) / (2 * first * rho)
        joints.append(angle_of(corner) + mode * arccos(cosine))
    return np.array(joints)
