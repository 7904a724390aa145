"""Exact derivatives of compiled dynamics: against differences of the RNEA backend, and a four-bar in complex numbers.

Differences are exact where a quantity is of the second degree: in ẋ, ẍ, ṡ, s̈ and in masses. Others are of order six.

The four-bar on paper: angles by Newton's method on the loop of its vectors, torque by virtual work, no URDF, Pinocchio
or casadi; imaginary steps differentiate it to the last digit.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping

import numpy as np
import pinocchio as pin
import pytest
import spatial_chains
import zoo
from examples import FACTOR
from generated_c import ACTUATED
from machines import machine
from scipy.spatial.transform import Rotation

from redundancy_pin import CarrierMotion, PlatformMotion, RneaDynamics, distribute, joint_reactions, load_robot
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.compiled import CompiledDynamics, Partials, design_of
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.loading import with_parameters
from redundancy_pin.robot import JointForces, Robot, Spring, Wrench

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


EQUAL = 1e-8
"""Relative to the largest derivative: loops close to 1e-13, and a sixth of a step of 4e-3 magnifies that."""

EXACT = 1e-10
"""Relative, where differences are exact: rounding of efforts, magnified by nothing."""

STEP = 4e-3

WEIGHTS = {-3: -1 / 60, -2: 3 / 20, -1: -3 / 4, 1: 3 / 4, 2: -3 / 20, 3: 1 / 60}
"""Central differences of order six."""

ZERO = np.zeros(3)

QUANTITIES = ("f", "W", "tau", "carrier_force", "base_wrench")


def robot_of(name: str) -> Robot:
    if name != "loaded":
        return machine(name)
    return machine("3rrr").loaded(
        Wrench("distal_2", (3.0, -2.0, 0.0, 0.0, 0.0, 1.0), "local", (0.3, 0.1, 0.0)),
        JointForces("elbow_1", 0.4, 0.3, 0.5, 2.0, 0.1, 0.02, -6.0),
        Spring("base", "platform", 40.0, 3.0, 0.2, (0.1, 0.0, 0.0)),
    )


def motions_of(robot: Robot, seed: int, samples: int = 3) -> tuple[PlatformMotion, CarrierMotion]:
    t = np.linspace(0.0, 0.6, samples)
    return zoo.smooth_motion(robot, seed).at(t), zoo.carriers_at(robot, t, seed)


def judged(robot: Robot, motion: PlatformMotion, carriers: CarrierMotion, tau: Array | None = None) -> dict[str, Array]:
    along = RneaDynamics(robot).along(motion)
    reduced = along.reduce(carriers)
    result = {name: getattr(reduced, name) for name in ("f", "W", "carrier_force")}
    result["tau"] = distribute(reduced).tau
    result["base_wrench"] = along.base_wrench(carriers)
    if tau is not None:
        result["closure_force"] = joint_reactions(along, tau, carriers).closure_force
    return result


def difference(at: Callable[[float], dict[str, Array]], step: float, weights: Mapping[int, float]) -> dict[str, Array]:
    results = {i: at(i * step) for i in weights}
    return {name: sum(w * results[i][name] for i, w in weights.items()) / step for name in results[1]}


def shifted(motion: PlatformMotion, part: str, i: int, by: float) -> PlatformMotion:
    """Return a motion with one coordinate moved; a pose by a displacement, or a rotation about its origin."""
    parts = {name: np.array(getattr(motion, name)) for name in ("x", "xd", "xdd")}
    if part == "x" and motion.is_pose and i >= 3:
        turn = Rotation.from_rotvec(by * np.eye(3)[i - 3]).as_matrix()
        parts["x"][:, :3, :3] = turn @ parts["x"][:, :3, :3]
    elif part == "x" and motion.is_pose:
        parts["x"][:, i, 3] += by
    else:
        parts[part][:, i] += by
    return PlatformMotion(motion.t, **parts)


def moved(carriers: CarrierMotion, part: str, i: int, by: float) -> CarrierMotion:
    parts = {name: np.array(getattr(carriers, name)) for name in ("s", "sd", "sdd")}
    parts[part][:, i] += by
    return CarrierMotion(**parts)


def assert_derivative(got: Partials, part: str, i: int, want: Array, tolerance: float, what: str) -> None:
    whole = getattr(got, part)
    scale = np.nanmax(np.abs(whole), initial=1.0)
    np.testing.assert_allclose(whole[..., i], want, rtol=0.0, atol=tolerance * scale, err_msg=f"{what} by {part}[{i}]")


def assert_motion_derivatives(robot: Robot, seed: int, columns: int | None = None) -> None:
    motion, carriers = motions_of(robot, seed)
    got = CompiledDynamics(robot).along(motion).derivatives(carriers)
    chosen = np.random.default_rng(seed).permutation(robot.n)[:columns]
    exact = {-1: -0.5, 1: 0.5}
    rates = (STEP, WEIGHTS, EQUAL) if robot.loads else (1.0, exact, EXACT)  # friction is no polynomial
    for i in chosen:
        for part, step, weights, tolerance in (
            ("x", STEP, WEIGHTS, EQUAL), ("xd", *rates), ("xdd", 1.0, exact, EXACT)
        ):  # fmt: skip
            want = difference(lambda by, p=part, i=i: judged(robot, shifted(motion, p, i, by), carriers), step, weights)
            for name in QUANTITIES:
                assert_derivative(getattr(got, name), part, i, want[name], tolerance, name)
    for i in range(robot.k):
        for part in ("s", "sd", "sdd"):  # of the second degree, as the tracks are straight
            want = difference(lambda by, p=part, i=i: judged(robot, motion, moved(carriers, p, i, by)), 0.1, exact)
            for name in QUANTITIES:
                assert_derivative(getattr(got, name), part, i, want[name], 10 * EXACT, name)
    assert not got.f.x.flags.writeable


@pytest.mark.long_for("hinge", "five_bar", "universal", "rod", "continuous", "gough", "fewer actuators")
@pytest.mark.parametrize("name", ["2rpr", "loaded", "five_bar", "four_bar", *spatial_chains.CHAINS, "gough", *ACTUATED])
def test_by_the_motion(name: str) -> None:
    assert_motion_derivatives(robot_of(name), 1, columns=1 if FACTOR == 1 else 3)


def test_type_two_poses_are_as_good_as_others() -> None:
    robot = robot_of("2rpr")
    at = PlatformMotion([0.0], [[0.2, 0.0]], [[0.3, -0.7]], [[1.0, 2.0]])  # on the line of the base: W has rank one
    got = CompiledDynamics(robot).along(at).derivatives()
    parked = CarrierMotion.parked(1, robot.k)
    assert abs(np.linalg.det(RneaDynamics(robot).reduce(at).W[0])) < 1e-12
    for i in range(2):
        want = difference(lambda by, i=i: judged(robot, shifted(at, "x", i, by), parked), STEP / 4, WEIGHTS)
        for name in set(QUANTITIES) - {"tau"}:
            assert_derivative(getattr(got, name), "x", i, want[name], 10 * EQUAL, name)
    # the efforts have a pole there: a status, and no number that looks like a derivative
    nothing = 0.0 * at.xd
    rest = CompiledDynamics(load_robot("2rpr")).along(PlatformMotion([0.0], at.x, nothing, nothing))
    for one, label in ((got, "singular_inconsistent"), (rest.derivatives(), "singular_consistent")):
        assert one.efforts.status_labels[0] == label
        assert all(np.isnan(getattr(one.tau, field.name)).all() for field in dataclasses.fields(Partials))


def test_fewer_actuators_have_derivatives_along_what_they_can_balance() -> None:
    robot = machine("fewer actuators")
    (motion, _), dynamics = motions_of(robot, 9), RneaDynamics(robot)

    def with_xdd(xdd: Array) -> PlatformMotion:
        return PlatformMotion(motion.t, motion.x, motion.xd, xdd, check_rates=False)

    # f is affine in ẍ: that which one motor produces with an effort of 2
    f, W = (getattr(dynamics.reduce(with_xdd(0.0 * motion.xdd)), name) for name in ("f", "W"))
    mass = np.stack([dynamics.reduce(with_xdd(0.0 * motion.xdd + unit)).f - f for unit in np.eye(2)], axis=-1)
    xdd = np.linalg.solve(mass, (2.0 * W[..., 0] - f)[..., None])[..., 0]
    got = CompiledDynamics(robot).along(with_xdd(xdd)).derivatives()
    np.testing.assert_allclose(got.efforts.tau, 2.0, rtol=1e-9)
    assert np.isnan(got.tau.xdd).all()
    # by all of f in proportion, which the motor can: the accelerations and its effort
    along = np.linalg.solve(mass, W)[..., 0]
    by_xdd = np.einsum("nic,nc->ni", got.f.xdd, along)
    turned = dataclasses.replace(got, f=dataclasses.replace(got.f, xdd=by_xdd[..., None]), W=only(got.W, "xdd"))
    np.testing.assert_allclose(turned.tau.xdd, 1.0, rtol=1e-9)


def only(partials: Partials, part: str) -> Partials:
    return dataclasses.replace(partials, **{part: getattr(partials, part)[..., :1]})


@pytest.mark.long_for("gough", "hinge", "cylindrical", "3rrr")
@pytest.mark.parametrize("name", ["five_bar", "3rrr", "hinge", "cylindrical", "gough"])
def test_closure_forces(name: str) -> None:
    """Of efforts that go on producing the motion: otherwise there are none to compare with."""
    robot = robot_of(name)
    motion, carriers = motions_of(robot, 3, samples=2)
    got = CompiledDynamics(robot).along(motion).derivatives(carriers)
    tau = got.efforts.tau
    result = got.closure_force(tau, got.tau)

    def forces(other: PlatformMotion) -> dict[str, Array]:
        reduced = RneaDynamics(robot).reduce(other, carriers)
        return judged(robot, other, carriers, np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0])

    for part in ("x", "xd", "xdd"):
        i = robot.n - 1
        want = difference(lambda by, p=part, i=i: forces(shifted(motion, p, i, by)), STEP, WEIGHTS)
        assert_derivative(result, part, i, want["closure_force"], EQUAL, "closure force")
    closure_force = got.closure_force(tau)
    np.testing.assert_allclose(closure_force.xdd - result.xdd, got.share @ got.tau.xdd, atol=1e-9)
    with pytest.raises(InputError, match="tau"):
        got.closure_force(tau[:, :-1] if robot.m > 1 else np.zeros((2, 2)))


@pytest.mark.long_for("gough-parameters4", "3rrr-parameters3", "five_bar-parameters2", "2rpr-parameters0")
@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("2rpr", ("track_offset", "base_distance", "end_effector_mass")),
        ("five_bar", ("proximal_length", "carrier_mass")),
        ("five_bar", ("distal_length", "tail_length")),
        ("3rrr", ("platform_radius", "distal_length")),
        ("gough", ("base_angle", "cylinder_mass")),
    ],
)
def test_by_numbers_of_the_xacro_file(name: str, parameters: tuple[str, ...]) -> None:
    robot = robot_of(name)
    motion, carriers = motions_of(robot, 5, samples=2)
    got = CompiledDynamics(robot).along(motion).derivatives(carriers, parameters)
    assert got.parameters == parameters

    @functools.cache
    def reloaded(parameter: str, by: float) -> Robot:
        numbers = {**robot.parameters, parameter: robot.parameters[parameter] + by}
        return load_robot(name, gravity=tuple(robot.gravity), working_mode=robot.working_mode or None, **numbers)

    for i, parameter in enumerate(parameters):
        linear = parameter.endswith("mass")
        step, weights = (0.1, {-1: -0.5, 1: 0.5}) if linear else (STEP, WEIGHTS)
        want = difference(lambda by, p=parameter: judged(reloaded(p, by), motion, carriers), step, weights)
        for quantity in QUANTITIES:
            tolerance = 10 * EXACT if linear else EQUAL
            assert_derivative(getattr(got, quantity), "parameters", i, want[quantity], tolerance, parameter)


def test_a_parameter_at_zero_is_differentiated_to_one_side() -> None:
    robot = load_robot("2rpr", gravity=(0.0, -9.81, 0.0))
    motion, carriers = motions_of(robot, 6)
    got = CompiledDynamics(robot).along(motion).derivatives(carriers, ["end_effector_mass"])
    heavier = load_robot("2rpr", gravity=(0.0, -9.81, 0.0), end_effector_mass=1.0)
    want = judged(heavier, motion, carriers)["f"] - judged(robot, motion, carriers)["f"]  # linear in the mass
    np.testing.assert_allclose(got.f.parameters[..., 0], want, atol=1e-9)


def remade(robot: Robot, change: Callable[[object], None]) -> Robot:
    model = robot.model.copy()
    change(model)
    return dataclasses.replace(robot, model=model)


Change = Callable[[pin.Model, float], None]


def moves_body(index: int, mass: float = 0.0, lever: Array = ZERO, tensor: Array | float = 0.0) -> Change:
    def change(model: pin.Model, by: float) -> None:
        old = model.inertias[index]
        model.inertias[index] = pin.Inertia(old.mass + by * mass, old.lever + by * lever, old.inertia + by * tensor)

    return change


def moves_place(of: str, index: int, along: Array = ZERO, about: Array = ZERO) -> Change:
    def change(model: pin.Model, by: float) -> None:
        old = model.jointPlacements[index] if of == "joint" else model.frames[index].placement
        new = pin.SE3(old.rotation @ pin.exp3(by * about), old.translation + by * along)
        if of == "joint":
            model.jointPlacements[index] = new
        else:
            model.frames[index].placement = new

    return change


@pytest.mark.parametrize("name", [pytest.param("five_bar", marks=pytest.mark.long), "universal"])
def test_by_numbers_of_the_tree(name: str) -> None:
    """Mass, centre and inertia of a link; places of a joint and of a closure."""
    robot, unit = machine(name), np.eye(3)
    joint, other, link = robot.model.names[2], robot.model.names[3], robot.closures[0].frame_b
    j, o = robot.model.getJointId(joint), robot.model.getJointId(other)
    frame = robot.model.getFrameId(link, pin.FrameType.BODY)
    changes = {
        f"{joint}.mass": moves_body(j, mass=1.0),
        f"{other}.centre.x": moves_body(o, lever=unit[0]),
        f"{joint}.origin.y": moves_place("joint", j, along=unit[1]),
        f"{joint}.origin.rz": moves_place("joint", j, about=unit[2]),
        f"{link}.origin.x": moves_place("frame", frame, along=unit[0]),
    }
    for i, axis in enumerate("xyz"):
        changes[f"{joint}.centre.{axis}"] = moves_body(j, lever=unit[i])
        for k in range(i, 3):
            tensor = np.maximum(np.outer(unit[i], unit[k]), np.outer(unit[k], unit[i]))
            changes[f"{joint}.inertia.{axis}{'xyz'[k]}"] = moves_body(j, tensor=tensor)
    motion, carriers = motions_of(robot, 7, samples=1)
    got, felt = CompiledDynamics(robot).along(motion).derivatives(carriers, list(changes)), []
    for i, (parameter, change) in enumerate(changes.items()):
        linear = ".inertia." in parameter or parameter.endswith("mass")
        step, weights = (0.1, {0: -1.0, 1: 1.0}) if linear else (STEP, WEIGHTS)
        want = difference(
            lambda by, c=change: judged(remade(robot, lambda model: c(model, by)), motion, carriers), step, weights
        )
        felt += [parameter] if np.abs(want["f"]).max() > 1e-6 else []
        # not the base's wrench: RNEA takes that of the URDF's numbers
        for quantity in ("f", "W", "carrier_force"):
            assert_derivative(getattr(got, quantity), "parameters", i, want[quantity], EQUAL, parameter)
    assert len(felt) == (7 if name == "five_bar" else 14), felt  # in a plane most numbers are nobody's


@pytest.mark.long_for("of kg and m")
@pytest.mark.parametrize(("length", "mass"), [(1.0, 1.0), (1e-3, 1e-9)], ids=["of kg and m", "of µg and mm"])
def test_a_four_bar_in_complex_numbers(length: float, mass: float) -> None:
    names = list(machine("four_bar").parameters)
    units = {name: length if name.endswith("length") else mass for name in names}
    robot = load_robot("four_bar", **{name: machine("four_bar").parameters[name] * units[name] for name in names})
    force, turning = mass, mass * length  # of crank's tip and crank, under the same gravity
    sizes = {name: complex(float(robot.parameters[name])) for name in names}
    t = np.linspace(0.0, 1.0, 4)
    motion = zoo.smooth_motion(robot, 8).at(t)
    along = CompiledDynamics(robot).along(motion)
    got, reduced = along.derivatives(parameters=names), along.reduce()
    # the crank drives itself: W = 1, τ = f
    follows = Partials(*(getattr(got.f, field.name) for field in dataclasses.fields(Partials)))
    closure = got.closure_force(reduced.f, follows)
    for k in range(len(t)):
        state = [complex(part[k, 0]) for part in (motion.x, motion.xd, motion.xdd)]
        np.testing.assert_allclose(reduced.f[k, 0], crank_torque(*state, sizes)[0].real, rtol=1e-12)
        for i, part in enumerate(("x", "xd", "xdd")):
            stepped = [value + 1j * IMAGINARY * (i == j) for j, value in enumerate(state)]
            torque, push = (value.imag / IMAGINARY for value in crank_torque(*stepped, sizes))
            np.testing.assert_allclose(getattr(got.f, part)[k, 0, 0], torque, rtol=1e-11, atol=1e-11 * turning)
            np.testing.assert_allclose(getattr(closure, part)[k, 0, 0], push, rtol=1e-11, atol=1e-11 * force)
        for i, name in enumerate(names):
            unit = units[name]
            stepped_sizes = {**sizes, name: sizes[name] + 1j * IMAGINARY * unit}
            torque, push = (value.imag / IMAGINARY / unit for value in crank_torque(*state, stepped_sizes))
            for one, want, size in ((got.f, torque, turning), (closure, push, force)):
                np.testing.assert_allclose(
                    one.parameters[k, 0, i], want, rtol=1e-10, atol=1e-10 * size / unit, err_msg=name
                )


@pytest.mark.parametrize("changes", [{"masses": {"crank_link": 5.0}}, {"lengths": {"rocker": 0.41}}])
def test_numbers_of_a_file_that_no_longer_says_them(changes: dict[str, dict[str, float]]) -> None:
    changed = with_parameters(robot_of("four_bar"), **changes)
    with pytest.raises(UnsupportedRobotError, match="changed after it was loaded, and 'coupler_mass'"):
        design_of(changed, ["coupler_mass"])
    assert design_of(changed, ["coupler.mass"]).columns.any()  # of the tree itself
    other = with_parameters(robot_of("four_bar"), crank_mass=5.0)
    want = design_of(robot_of("four_bar"), ["crank_mass"])
    np.testing.assert_allclose(design_of(other, ["crank_mass"]).columns, want.columns, rtol=1e-12)  # linear


def test_parameters_that_are_none() -> None:
    robot = robot_of("five_bar")
    with pytest.raises(InputError, match="distal_length"):
        design_of(robot, ["distal_lenght"])
    with pytest.raises(InputError, match="carriers"):
        design_of(robot, ["carriers"])
    for name in ("elbow_1.inertia.xw", "elbow_1.centre", "nobody.mass", "elbow_1.origin.r"):
        with pytest.raises(InputError, match="no design parameter"):
            design_of(robot, [name])
    with pytest.raises(InputError, match=r"distal_1 is a link, moved by the joint elbow_1: 'elbow_1\.mass'"):
        design_of(robot, ["distal_1.mass"])
    with pytest.raises(UnsupportedRobotError, match="not loaded"):
        design_of(dataclasses.replace(robot, source=""), ["distal_length"])
