"""Compiled dynamics and casadi Functions against the RNEA backend, which shares no code with them, and Pinocchio."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi
import casadi as ca
import numpy as np
import pinocchio as pin
import pytest
import spatial_chains
import zoo
from examples import FACTOR
from flat_linkages import parallelogram, row_of_four_bars
from machines import machine
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin import CompiledDynamics, RneaDynamics, inverse_kinematics, joint_reactions, symbolic, trajectory
from redundancy_pin.dynamics.compiled.parameters import parameter_vector, topology_of, trig_at
from redundancy_pin.dynamics.compiled.symbolic import SymbolicRobot
from redundancy_pin.dynamics.compiled.symbols import SymbolicChain
from redundancy_pin.errors import CompilerError
from redundancy_pin.kinematics.coordinates import coordinates, difference, mode_indicator, moved
from redundancy_pin.loading import robot_from_model
from redundancy_pin.machine_code import CACHE
from redundancy_pin.robot import Robot

EQUAL = 1e-11
"""Relative to the largest value of the motion: what the issue of this backend asks for. Rounding is 1e-14."""

ZERO = 1e-3
"""N, m, J: what is below it next to zero is a difference of efforts of 1 to 100."""


def assert_equal(got: np.ndarray, want: np.ndarray, what: str) -> None:
    scale = np.abs(want).max(initial=0.0)
    np.testing.assert_allclose(got, want, rtol=0.0, atol=EQUAL * max(scale, ZERO), err_msg=what)


def assert_same_dynamics(compiled: rp.CompiledDynamics, motion: rp.PlatformMotion, carriers: rp.CarrierMotion) -> None:
    mine, theirs = compiled.along(motion), rp.RneaDynamics(compiled.robot).along(motion)
    got, want = mine.reduce(carriers), theirs.reduce(carriers)
    for name in ("f", "W", "carrier_force", "row_scale", "column_scale", "reachable"):
        assert_equal(getattr(got, name), getattr(want, name), name)
    assert_equal(mine.base_wrench(carriers), theirs.base_wrench(carriers), "base wrench")
    assert_equal(mine.energy(carriers), theirs.energy(carriers), "energy")
    first, second = mine.carrier_derivatives(carriers), theirs.carrier_derivatives(carriers)
    for name in ("f_s", "f_sd", "f_sdd", "force_s", "force_sd", "force_sdd"):
        assert_equal(getattr(first, name), getattr(second, name), name)


@pytest.mark.long_for("gough", "hinge", "five_bar", "cylindrical")
@pytest.mark.parametrize("name", [*zoo.SHIPPED, *spatial_chains.CHAINS])
def test_every_robot_moves_as_with_rnea(name: str) -> None:
    robot = machine(name)
    compiled = rp.CompiledDynamics(robot, threads=1)
    t = np.linspace(0.0, 2.0, 100)
    for seed in range(FACTOR):
        assert_same_dynamics(compiled, zoo.smooth_motion(robot, seed).at(t), zoo.carriers_at(robot, t, seed))


def test_a_carrier_that_turns_moves_as_with_rnea() -> None:
    """Its cosine and sine are of its own position, not of the configuration that was closed with it at zero."""
    base = machine("four_bar")
    model = base.model.copy()
    place = pin.SE3(np.eye(3), np.array([0.1, 0.05, 0.0]))
    rotor = model.addJoint(2, pin.JointModelRZ(), place, "rotor")
    model.appendBodyToJoint(rotor, pin.Inertia(0.4, np.array([0.03, 0.01, 0.0]), 0.002 * np.eye(3)), pin.SE3.Identity())
    robot = rp.with_limits(rp.robot_from_model(
        model, closures=base.closures, actuated=base.actuated, carriers=["rotor"], independent=base.independent_joints,
        reference=np.append(base.q_reference, 0.0),
    ), lower=-3.0, upper=3.0)  # fmt: skip
    t = np.linspace(0.0, 1.0, 20)
    assert_same_dynamics(rp.CompiledDynamics(robot), zoo.smooth_motion(robot, 1).at(t), zoo.carriers_at(robot, t, 1))


class Bare(SimpleNamespace):
    """What the expressions of a tree read of a robot."""

    __hash__ = object.__hash__


def test_every_type_of_joint_is_pinocchios() -> None:
    # of what turns without end about a skew axis only the reader of URDF makes one
    skew = '<joint name="skew" type="continuous"><parent link="a"/><child link="b"/><axis xyz="1 2 2"/></joint>'
    model = pin.buildModelFromXML(f'<robot name="all"><link name="a"/><link name="b"/>{skew}</robot>')
    joints = (
        pin.JointModelFreeFlyer(),
        pin.JointModelSpherical(),
        pin.JointModelPlanar(),
        pin.JointModelTranslation(),
        pin.JointModelRUBY(),
        pin.JointModelRevoluteUnaligned(np.array([2.0, -1.0, 2.0]) / 3.0),
        pin.JointModelPrismaticUnaligned(np.array([2.0, 2.0, -1.0]) / 3.0),
        pin.JointModelRX(),
        pin.JointModelPZ(),
    )
    pin.seed(3)
    for i, joint in enumerate(joints):
        index = model.addJoint(i + 1, joint, pin.SE3.Random(), f"joint_{i}")
        model.appendBodyToJoint(index, pin.Inertia.Random(), pin.SE3.Identity())
    model.gravity.linear = np.array([1.0, 2.0, -9.0])
    rng = np.random.default_rng(0)
    model.armature = rng.uniform(0.1, 1.0, model.nv)
    nothing: Any = Bare(
        model=model, platform=None, closures=(), couplings=(), loads=(), independent_joints=(), working_modes=None,
        characteristic_length=1.0, actuated=(), carriers=(), gravity=model.gravity.linear, n=0, m=0, k=0,
        **dict.fromkeys(("carrier_position", "carrier_velocity", "actuated_velocity"), np.zeros(0, dtype=int)),
    )  # fmt: skip
    chain = SymbolicChain(nothing)
    evaluate = casadi.Function(
        "all", [chain.q, chain.trig, chain.v, chain.a, chain.step, chain.parameters],
        [*chain.efforts, chain.energy, chain.rates[: model.nq], chain.moved],
    )  # fmt: skip
    data = model.createData()
    for _ in range(5):
        q = pin.integrate(model, pin.neutral(model), rng.uniform(-3.0, 3.0, model.nv))
        v, a = rng.normal(size=(2, model.nv))
        step = 1e-5 * v
        got = evaluate(q, trig_at(nothing, q[None])[0], v, a, step, parameter_vector(nothing))
        efforts, base, energy, rate, moved = (np.array(part)[:, 0] for part in got)
        # from the inertia matrix: in it armature stands in every version of Pinocchio
        inertia = pin.crba(model, data, q)
        inertia = np.triu(inertia) + np.triu(inertia, 1).T
        want = inertia @ a + pin.nonLinearEffects(model, data, q, v)
        assert_equal(efforts, want, "efforts")
        total = 0.5 * v @ inertia @ v + pin.computePotentialEnergy(model, data, q)
        assert_equal(energy, np.array([total]), "energy")
        ahead, behind = (pin.integrate(model, q, sign * step) for sign in (1.0, -1.0))
        np.testing.assert_allclose(rate, (ahead - behind) / 2e-5, rtol=0.0, atol=1e-8)
        # a step keeps to the manifold and errs by its square
        np.testing.assert_allclose(moved, ahead, rtol=0.0, atol=1e-9)
        pin.rnea(model, data, q, v, a)
        np.testing.assert_allclose(base, data.oMi[1].act(data.f[1]).vector, rtol=1e-10)


def test_the_layout_of_a_motion_in_memory_does_not_matter() -> None:
    robot = machine("3rrr")
    motion = zoo.smooth_motion(robot, 4).at(np.linspace(0.0, 1.0, 10))
    turned = rp.PlatformMotion(motion.t, *(np.asfortranarray(part) for part in (motion.x, motion.xd, motion.xdd)))
    compiled = rp.CompiledDynamics(robot)
    np.testing.assert_array_equal(compiled.reduce(turned).f, compiled.reduce(motion).f)


def test_samples_in_several_threads_are_those_of_one() -> None:
    robot = machine("3rrr")
    t = np.linspace(0.0, 3.0, 5000)
    motion, carriers = zoo.smooth_motion(robot, 3).at(t), zoo.carriers_at(robot, t)
    one, many = (rp.CompiledDynamics(robot, threads=threads).reduce(motion, carriers) for threads in (1, 4))
    np.testing.assert_array_equal(many.f, one.f)
    np.testing.assert_array_equal(many.carrier_force, one.carrier_force)


def test_two_sided_samples_and_sparse_ones() -> None:
    robot = machine("3rrr")
    corner = trajectory.reference.corner().sample(dt=0.01)
    assert corner.jumps.any()
    assert_same_dynamics(rp.CompiledDynamics(robot), corner, rp.CarrierMotion.parked(len(corner), 3))
    sparse = zoo.smooth_motion(robot, 2).at(np.linspace(0.0, 2.0, 7))
    assert_same_dynamics(rp.CompiledDynamics(robot), sparse, rp.CarrierMotion.parked(7, 3))


def test_a_library_is_kept_and_a_broken_one_or_that_of_another_robot_is_built_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "kept"
    spelled = (f"{folder}{'/.' * count}" for count in itertools.count())

    def compile_and_compare(name: str) -> None:
        monkeypatch.setenv(CACHE, next(spelled))  # what a process has loaded it takes from the folder it knows
        robot = machine(name)
        motion = zoo.smooth_motion(robot, 0).at(np.linspace(0.0, 1.0, 5))
        assert_equal(rp.CompiledDynamics(robot).reduce(motion).f, rp.RneaDynamics(robot).reduce(motion).f, "f")

    compile_and_compare("four_bar")
    (library,) = folder.iterdir()
    kept = library.stat().st_ino
    compile_and_compare("four_bar")
    assert library.stat().st_ino == kept
    compile_and_compare("five_bar")
    (other,) = set(folder.iterdir()) - {library}
    for wrong in (b"half a file", other.read_bytes()):
        library.unlink()  # what this process has loaded stays mapped
        library.write_bytes(wrong)
        library.chmod(0o600)
        compile_and_compare("four_bar")
        assert library.read_bytes() != wrong


@pytest.mark.parametrize(("bars", "beside"), [(1, 0.0), (2, 1e-5), (2, 1e-4)])
def test_a_motion_through_a_rank_loss_of_the_closures_is_that_of_the_kinematics(bars: int, beside: float) -> None:
    """Newton's method of the driver ends where one determinant changes its sign, and passes two at once next to it."""
    robot = parallelogram() if bars == 1 else row_of_four_bars(bars)
    t = np.linspace(0.0, 1.0, 101)
    through = rp.PlatformMotion(t, 1.2 - 2.4 * t[:, None] + beside, np.full((101, 1), -2.4), np.zeros((101, 1)))
    mine, theirs = (backend(robot).reduce(through) for backend in (rp.CompiledDynamics, rp.RneaDynamics))
    assert mine.reachable.all()
    for name in ("f", "W"):
        assert_equal(getattr(mine, name), getattr(theirs, name), name)


@pytest.mark.parametrize("turn", [0.4, 2.2])
def test_a_motion_may_begin_far_turned_from_the_reference(turn: float) -> None:
    """Rows of a pose are sines of its rotation: generated code gets as far as these say the way, kinematics beyond."""
    robot, still = machine("gough"), np.zeros((2, 6))
    x = np.repeat(zoo.home_of(robot)[None], 2, axis=0)
    x[:, :3, :3] = Rotation.from_rotvec([0.0, 0.0, turn]).as_matrix() @ x[:, :3, :3]
    motion = rp.PlatformMotion(np.arange(2.0), x, still, still)
    mine, theirs = (backend(robot).along(motion) for backend in (rp.CompiledDynamics, rp.RneaDynamics))
    assert_equal(mine.q, theirs.q, "configurations")


# --- robots that differ in numbers share compiled code: libraries are counted in an empty cache


@pytest.fixture
def without_kinematics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Regular motions are followed by generated code alone: asking the kinematics would hide its mistakes."""

    def refuse(*given: object, **named: object) -> None:
        raise AssertionError("generated code did not follow the motion")

    monkeypatch.setattr("redundancy_pin.dynamics.compiled.closing.inverse_kinematics", refuse)


def libraries(folder: Path) -> int:
    return len(list(folder.glob("*.so")))


def assert_backends_agree(dynamics: rp.CompiledDynamics) -> None:
    """Along a motion about the robot's own reference."""
    robot, t = dynamics.robot, np.linspace(0.0, 1.0, 7)
    assert_same_dynamics(dynamics, zoo.smooth_motion(robot, 3).at(t), zoo.carriers_at(robot, t))


def changed_in_every_number(name: str) -> list[Robot]:
    """The robot with one number of its file changed each; a link of two halves stays symmetric (a structural zero)."""
    robot = rp.load_robot(name)
    numbers = {key: value for key, value in robot.parameters.items() if type(value) is float and value}
    halves = {key for key in numbers if key in ("distal_length", "tail_length")}
    changes = [{key: 1.03 * numbers[key] for key in (halves if one in halves else {one})} for one in numbers]
    return [rp.load_robot(name, **change) for change in changes]


def payloads(name: str) -> list[Robot]:
    """The robot with payloads on its platform, or on the first link that a closure joins."""
    robot = rp.load_robot(name)
    link = robot.platform.frame if robot.platform else robot.closures[0].frame_a
    return [
        robot.loaded(rp.Payload(link, mass, centre, inertia))
        for mass, centre, inertia in ((0.7, (0.01, 0.02, 0.03), 0.001), (0.2, (0.0, 0.0, 0.0), 0.0))
    ]


@pytest.mark.usefixtures("without_kinematics")
@pytest.mark.parametrize(("name", "loaded"), [("four_bar", 4), pytest.param("3rrr", 2, marks=pytest.mark.long)])
def test_another_number_is_not_another_library(
    name: str, loaded: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE, str(tmp_path))
    first = rp.CompiledDynamics(name)
    assert first.forward() is not None
    assert libraries(tmp_path) == 2  # inverse and forward dynamics
    robots = changed_in_every_number(name)
    assert len(robots) > 5
    for i, robot in enumerate(robots):
        dynamics = first.for_robot(robot) if i % 2 else rp.CompiledDynamics(robot)
        assert dynamics.forward() is not None
        assert_backends_agree(dynamics)
    assert_backends_agree(first)  # which none of the others has changed
    assert libraries(tmp_path) == 2
    assert len({topology_of(robot).text for robot in payloads(name)}) == 1
    for robot in payloads(name):  # a link that is no platform gets another topology, once
        dynamics = first.for_robot(robot)
        assert dynamics.forward() is not None
        assert_backends_agree(dynamics)
        assert libraries(tmp_path) == loaded


def test_another_folder_or_compiler_counts_from_when_it_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rp.CompiledDynamics("four_bar")
    monkeypatch.setenv(CACHE, str(tmp_path))
    rp.CompiledDynamics("four_bar")
    assert libraries(tmp_path) == 1
    monkeypatch.setenv("CC", "no such compiler")
    monkeypatch.setenv("PATH", "")
    with pytest.raises(CompilerError):
        rp.CompiledDynamics("four_bar")


def of_modes() -> list[Robot]:
    return [zoo.robot_of("five_bar", working_mode=mode) for mode in ((1, 1), (-1, -1), (1, -1))]


def of_loads() -> list[Robot]:
    """Loads of another size, and one of another kind."""
    robot = zoo.robot_of("four_bar")
    joint = str(robot.model.names[1])
    loads = [
        rp.JointForces(joint, size, size, 0.02 * size, size, 0.1 * size, 0.01 * size, -2.0 * size)
        for size in (1.0, 3.7)
    ]
    return [robot.loaded(load) for load in (*loads, rp.JointForces(joint, damping=1.0))]


def of_gravity() -> list[Robot]:
    """Structural zeros are compiled: gravity along y alone, and along x too."""
    directions = ((0.0, -9.81, 0.0), (0.0, -3.7, 0.0), (1.0, -9.81, 0.0))
    return [zoo.robot_of("four_bar", gravity=gravity) for gravity in directions]


@pytest.mark.usefixtures("without_kinematics")
@pytest.mark.parametrize(("robots", "last"), [(of_modes, 1), (of_loads, 2), (of_gravity, 2)])
def test_modes_and_numbers_share_a_library_and_kinds_do_not(
    robots: Callable[[], list[Robot]], last: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(CACHE, str(tmp_path))
    for robot, count in zip(robots(), (1, 1, last), strict=True):
        assert_backends_agree(rp.CompiledDynamics(robot))
        assert libraries(tmp_path) == count


@pytest.mark.parametrize(("size", "same"), [(1e-17, True), (1e-9, False)])
def test_rounding_makes_no_other_topology(size: float, same: bool) -> None:
    """Zero beside the characteristic length, the mass and the inertia, and beside 1 in a rotation."""
    robot = rp.load_robot("four_bar")
    body = robot.model.inertias[2]

    def moved(model: pin.Model) -> None:
        model.jointPlacements[2].translation = model.jointPlacements[2].translation + size * np.array([0.0, 0.0, 1.0])

    def turned(model: pin.Model) -> None:
        model.jointPlacements[2].rotation = model.jointPlacements[2].rotation @ pin.exp3(np.array([size, 0.0, 0.0]))

    def heavier(model: pin.Model) -> None:
        model.inertias[2] = pin.Inertia(body.mass, body.lever + size * np.array([0.0, 0.0, 1.0]), body.inertia)

    for change in (moved, turned, heavier):
        model = robot.model.copy()
        change(model)
        assert (topology_of(dataclasses.replace(robot, model=model)) == topology_of(robot)) is same


def test_every_role_is_part_of_a_topology() -> None:
    """A library under the name of another topology would be loaded, and its answers would be wrong."""
    robot = rp.load_robot("3rrr")
    first, *rest = robot.closures
    platform, modes = robot.platform, robot.working_modes
    assert platform is not None
    assert modes is not None
    others = [
        {"closures": (dataclasses.replace(first, axes=first.axes[:1]), *rest)},
        {"closures": (dataclasses.replace(first, frame_a=first.frame_b, frame_b=first.frame_a), *rest)},
        {"platform": dataclasses.replace(platform, pointer=1)},
        {"platform": dataclasses.replace(platform, axes=platform.axes[:2])},
        {"actuated": robot.actuated[::-1]},
        {"carriers": robot.carriers[::-1]},
        {"working_modes": dataclasses.replace(modes, joints=modes.joints[::-1])},
        {"loads": (rp.JointForces(robot.actuated[0], damping=1.0),)},
        {"loads": (rp.Wrench(platform.frame, np.ones(6), "local"),)},
        {"loads": (rp.Wrench(platform.frame, np.ones(6), "world"),)},
    ]
    texts = [topology_of(dataclasses.replace(robot, **other)).text for other in others]
    assert len({topology_of(robot).text, *texts}) == len(others) + 1


# --- the casadi Functions of a robot, in graphs of both kinds


NEAR = 1e-11
"""Relative to the largest value, or one; rounding is 1e-14."""


def assert_near(got: object, want: np.ndarray, what: str) -> None:
    scale = max(1.0, np.abs(want).max(initial=0.0))
    np.testing.assert_allclose(np.array(got).reshape(want.shape), want, rtol=0.0, atol=NEAR * scale, err_msg=what)


@pytest.mark.long_for("gough")
@pytest.mark.parametrize("name", [*zoo.SHIPPED, *spatial_chains.CHAINS])
def test_they_say_what_rnea_says(name: str) -> None:
    robot = machine(name)
    functions = symbolic(robot)
    t = np.linspace(0.0, 1.0, 3)
    motion, carriers = zoo.smooth_motion(robot, 1).at(t), zoo.carriers_at(robot, t, 1)
    along = RneaDynamics(robot).along(motion)
    reduced, tree = along.reduce(carriers), inverse_kinematics(robot, motion)
    tau = np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0]
    reactions = joint_reactions(along, tau, carriers)
    wrench, energy, rnea = along.base_wrench(carriers), along.energy(carriers), along.tree_effort(carriers)
    state = zoo.system_of(robot).evaluate(tree.q)
    r, n = state.Jc.shape[1], robot.n
    for k in range(len(t)):
        q, v, a = (part[k] for part in along.tree_motion(carriers))
        still = np.zeros(r + n)
        assert_near(functions.closure(q), np.zeros(r), "closure")
        assert_near(functions.coordinates(q), motion.x[k], "coordinates")
        assert_near(functions.position(q, motion.x[k]), still, "position")
        assert_near(functions.velocity(q, v, motion.xd[k]), still, "velocity")
        assert_near(functions.acceleration(q, v, a, motion.xdd[k]), still, "acceleration")
        assert_near(functions.Jc(q), state.Jc[k], "Jc")
        assert_near(functions.Jx(q), state.Jx[k], "Jx")
        assert_near(functions.K(q), state.K[k], "K")
        assert_near(functions.gamma(q), tree.gamma[k], "gamma")
        assert_near(functions.rnea(q, v, a), rnea[k], "rnea")
        assert_near(functions.f(q, v, a), reduced.f[k], "f")
        assert_near(functions.W(q), reduced.W[k], "W")
        assert_near(functions.carrier_force(q, v, a), reduced.carrier_force[k], "carrier force")
        assert_near(functions.base_wrench(q, v, a), wrench[k], "base wrench")
        assert_near(functions.energy(q, v), energy[k : k + 1], "energy")
        efforts = (tau[k], reduced.carrier_force[k], reactions.closure_force[k])
        assert_near(functions.balance(q, v, a, *efforts), np.zeros(robot.model.nv), "balance")
        assert (np.array(functions.mode(q)) > 0.0).all()
        assert (np.array(functions.alignment(q)) > 0.0).all()
        # the bias is the rest of the acceleration rows, those of the platform included
        rows = np.concatenate([state.Jc[k], state.Jx[k]]) @ a + np.array(functions.bias(q, v))[:, 0]
        assert_near(rows, np.concatenate([np.zeros(r), motion.xdd[k]]), "bias")


@pytest.mark.parametrize("name", [*zoo.SHIPPED, *spatial_chains.CHAINS])
def test_off_the_motion_they_are_pinocchios_and_the_kinematics(name: str) -> None:
    """The tree, whether its loops are closed or not; and what is missing to a pose that is turned away."""
    robot, rng = machine(name), np.random.default_rng(8)
    functions, model = symbolic(robot), robot.model.copy()
    data, home = model.createData(), np.array(robot.q_reference)
    for _ in range(2):
        q = pin.integrate(model, home, rng.uniform(-0.5, 0.5, model.nv))
        v, a = rng.normal(size=(2, model.nv))
        assert_near(functions.rnea(q, v, a), pin.rnea(model, data, q, v, a), "rnea")
        energy = pin.computeKineticEnergy(model, data, q, v) + pin.computePotentialEnergy(model, data, q)
        assert_near(functions.energy(q, v), np.array([energy]), "energy")
        # the force that holds the base is what the momentum of all changes by, less its weight
        pin.computeCentroidalMomentumTimeVariation(model, data, q, v, a)
        force = data.dhg.linear - data.mass[0] * model.gravity.linear
        assert_near(-np.array(functions.base_wrench(q, v, a))[:3, 0], force, "base wrench")
    state = zoo.system_of(robot).evaluate(home[None])
    indicators = mode_indicator(robot, home[None])[0] * robot.working_mode if robot.working_mode else np.empty(0)
    assert_near(functions.mode(home), indicators, "mode")
    x = coordinates(robot, state)
    target = moved(robot, x, rng.uniform(-0.4, 0.4, (1, robot.n)))
    missing = -difference(robot, target, x)[0]
    if robot.platform is not None and robot.platform.is_pose:  # the sine of the angle, about its axis
        turn = Rotation.from_matrix(target[0, :3, :3] @ x[0, :3, :3].T).as_rotvec()
        angle = np.linalg.norm(turn)
        missing[3:] = -turn * np.sin(angle) / angle
    assert_near(np.array(functions.position(home, target[0]))[-robot.n :, 0], missing, "position")


def test_a_weld_whose_axes_changed_places_is_told_from_a_true_one() -> None:
    """All rows vanish there, and the cosines are zero: CompiledDynamics took it for closed where they rounded up."""
    model = pin.Model()
    joints = (pin.JointModelRZ(), pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ(), pin.JointModelSpherical())
    for number, joint in enumerate(joints):
        name = ("turn", "x", "y", "z", "ball")[number]
        index = model.addJoint(number if number > 1 else 0, joint, pin.SE3.Identity(), name)
        model.appendBodyToJoint(index, pin.Inertia(1.0, np.zeros(3), np.eye(3)), pin.SE3.Identity())
    for name, joint in (("hand", 1), ("end", 5)):
        model.addBodyFrame(name, joint, pin.SE3.Identity(), 0)
    weld = ("hand", "end", ["x", "y", "z", "rx", "ry", "rz"])
    robot = robot_from_model(model, closures=[weld], actuated=["turn"])
    functions, rng = symbolic(robot), np.random.default_rng(0)
    assert (np.array(functions.alignment(np.array(robot.q_reference))) > 0.0).all()
    false = np.concatenate([np.zeros(4), [-0.5, -0.5, -0.5, 0.5]])
    for step in 1e-9 * rng.normal(size=(20, robot.model.nv)):
        q = pin.integrate(robot.model, false, step)
        assert np.abs(np.array(functions.closure(q))).max() < 1e-7
        assert (np.array(functions.alignment(q)) < 0.0).any()


def test_both_kinds_of_graphs_hold_them() -> None:
    robot = machine("3rrr")
    functions = symbolic(robot)
    assert {field.name for field in dataclasses.fields(SymbolicRobot)} > {"f", "W", "rnea", "balance"}
    nv = robot.model.nv
    numbers = [np.array(robot.q_reference), np.linspace(0.1, 1.0, nv), np.linspace(-1.0, 2.0, nv)]
    for kind in (ca.SX, ca.MX):
        symbols = [kind.sym(name, nv) for name in "qva"]
        f = functions.f(*symbols)
        slope = ca.Function("slope", symbols, [f, ca.jacobian(f, symbols[2])])
        value, by_a = slope(*numbers)
        assert_near(value, np.array(functions.f(*numbers)), "f")
        # linear in a
        rest = np.array(functions.f(*numbers[:2], np.zeros(nv)))
        assert_near(np.array(by_a) @ numbers[2][:, None] + rest, np.array(value), "f by a")


def test_expressions_of_the_carriers_motion_have_the_values_of_rnea(shipped: Robot) -> None:
    """Of many samples at once, each with its own influence matrix."""
    t = np.linspace(0.0, 1.0, 4)
    motion, carriers = zoo.smooth_motion(shipped, 5).at(t), zoo.carriers_at(shipped, t)
    along = CompiledDynamics(shipped).along(motion)
    f, force = along.expressions(*(ca.DM(part.T) for part in (carriers.s, carriers.sd, carriers.sdd)))
    wanted = RneaDynamics(shipped).reduce(motion, carriers)
    for got, want in ((f, wanted.f), (force, wanted.carrier_force)):
        np.testing.assert_allclose(np.array(got).T, want, rtol=1e-9, atol=1e-9 * np.abs(wanted.f).max())
