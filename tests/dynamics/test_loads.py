"""Loads of a robot: three backends that share no kinematics, closed forms, energy, and MuJoCo's own Jacobians."""

from __future__ import annotations

import functools
import itertools
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import zoo
from load_definitions import load_efforts
from mjcf_models import RSSR, write

import redundancy_pin as rp
from redundancy_pin import (
    CarrierMotion,
    CompiledDynamics,
    JointForces,
    Payload,
    PlatformMotion,
    RneaDynamics,
    Spring,
    VirtualWork,
    Wrench,
)
from redundancy_pin.arrays import Array, frozen
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.tree_loads import TreeState, tree_effort, tree_equations
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.robot import Load, Robot
from redundancy_pin.robot.loads import wrench_values

PARITY = 1e-12
"""Of the largest entry: roundings of some hundred operations."""

REPLAY = 1e-9
"""Deviation of a replay, m."""

ARGUMENTS = {"2rpr": {"end_effector_mass": 0.3, "cylinder_mass": 0.2, "piston_mass": 0.1}}


@functools.cache
def machine(name: str, mode: tuple[int, ...] | None = None, **arguments: float) -> Robot:
    """Return a robot with gravity in all directions."""
    return zoo.robot_of(name, gravity=(1.0, -9.0, 2.0), working_mode=mode, **ARGUMENTS.get(name, {}), **arguments)


def moving(robot: Robot, count: int = 12) -> tuple[PlatformMotion, CarrierMotion]:
    t = np.linspace(0.1, 1.0, count)
    return zoo.smooth_motion(robot, 13).at(t), zoo.carriers_at(robot, t)


def links_of(robot: Robot) -> list[str]:
    return [str(frame.name) for frame in robot.model.frames if frame.type == pin.FrameType.BODY]


def joints_of(robot: Robot) -> list[str]:
    """Return the joints of one freedom."""
    names = list(zip(robot.model.names, robot.model.joints, strict=True))[1:]
    return [str(name) for name, joint in names if joint.nv == 1]


def all_loads(robot: Robot, samples: int) -> tuple[Load, ...]:
    """Return loads of every kind on every link and joint, random ones."""
    rng, links, joints = np.random.default_rng(0), links_of(robot), joints_of(robot)
    inertia = np.diag([0.01, 0.012, 0.015]) + 0.001 * np.array([[0.0, 1.0, 2.0], [1.0, 0.0, -3.0], [2.0, -3.0, 0.0]])
    loads: list[Load] = []
    for i, frame in enumerate(links):
        axes = "world" if i % 2 else "local"
        loads += [Wrench(frame, rng.normal(size=(samples, 6)), axes, rng.normal(size=3))]
        loads += [Payload(frame, rng.uniform(0.1, 1.0), 0.1 * rng.normal(size=3), inertia)]
    for joint in joints:
        numbers = rng.uniform(0.1, 1.0, 5)
        loads += [JointForces(joint, *numbers[:2], 0.1, *numbers[2:4], 0.01 * numbers[4], -7.0)]
    loads += [JointForces(joint, rotor_inertia=0.002, gear=20.0) for joint in joints[:2]]  # a second rotor there
    for a, b in itertools.pairwise(links):
        loads += [Spring(a, b, 20.0, 3.0, 0.1, *(0.3 * rng.normal(size=(2, 3))))]
    return tuple(loads)


@pytest.mark.parametrize("name", ["3rrr", "2rpr"])
def test_what_loads_ask_of_the_tree_is_what_pinocchios_jacobians_say(name: str) -> None:
    """Off the closures too: each joint moves on its own."""
    rng = np.random.default_rng(5)
    motion = moving(machine(name))[0]
    robot = machine(name).loaded(*all_loads(machine(name), len(motion)))
    q, v, a = rng.normal(size=(3, len(motion), robot.model.nv))
    wrenches, model, data = (
        wrench_values(robot.loads, motion.t, motion.x, motion.xd),
        robot.model,
        robot.model.createData(),
    )
    own = [
        tree_effort(robot, data, TreeState(*state, [w[k] for w in wrenches])) - pin.rnea(model, data, *state)
        for k, state in enumerate(zip(q, v, a, strict=True))
    ]
    assert_alike(np.array(own).T, load_efforts(robot, motion, q.T, v.T, a.T))


def assert_alike(one: Array, other: Array, tolerance: float = PARITY) -> None:
    np.testing.assert_allclose(one, other, rtol=0.0, atol=tolerance * max(1.0, np.abs(one).max(initial=0.0)))


@pytest.mark.long_for("CompiledDynamics-five_bar", "CompiledDynamics-gough", "CompiledDynamics-3rrr")
@pytest.mark.parametrize(
    ("backend", "name"),
    [*((CompiledDynamics, name) for name in ("2rpr", "3rrr", "five_bar", "four_bar", "gough")),
     *((VirtualWork, name) for name in ("2rpr", "3rrr"))],
)  # fmt: skip
def test_backends_agree_on_loads_of_every_kind(backend: type[CompiledDynamics] | type[VirtualWork], name: str) -> None:
    mode = {"3rrr": (1, -1, 1), "2rpr": (-1, 1)}.get(name)
    robot = machine(name, mode, **({"platform_inertia": 0.05} if name == "3rrr" else {}))  # no disc
    motion, carriers = moving(robot)
    loads = all_loads(robot, len(motion))
    unloaded = RneaDynamics(robot).reduce(motion, carriers)
    first = RneaDynamics(robot).with_external(*loads).along(motion)
    assert np.abs(first.reduce(carriers).f - unloaded.f).max(axis=0).min() > 1.0
    second = backend(robot).with_external(*loads).along(motion)
    one, two = first.reduce(carriers), second.reduce(carriers)
    assert_alike(one.f, two.f)
    assert_alike(one.carrier_force, two.carrier_force)
    assert_alike(first.base_wrench(carriers), second.base_wrench(carriers))
    assert_alike(first.energy(carriers), second.energy(carriers))
    by_one, by_two = first.carrier_derivatives(carriers), second.carrier_derivatives(carriers)
    for part in by_one.__dataclass_fields__:
        assert_alike(getattr(by_one, part), getattr(by_two, part))


def test_a_spring_in_a_joint_is_wound_up_by_whole_turns_of_the_reference() -> None:
    """A turn more is 2π times the stiffness more, on all sides of the walls."""
    stiffness, joint, turns = 0.7, "base_1", -2
    robot = machine("3rrr", (1, -1, 1))
    q = np.array(robot.q_reference)
    q[robot.model.joints[robot.model.getJointId(joint)].idx_q] += 2.0 * np.pi * turns
    wound = replace(robot, q_reference=frozen(q))
    motion, carriers = moving(robot)
    spring = JointForces(joint, stiffness=stiffness)
    for backend in (RneaDynamics, VirtualWork, CompiledDynamics):
        before, after = (backend(one).reduce(motion, carriers, external=[spring]) for one in (robot, wound))
        more = np.linalg.solve(before.W, (after.f - before.f)[..., None])[..., 0]
        assert_alike(more, np.tile([2.0 * np.pi * turns * stiffness, 0.0, 0.0], (len(motion), 1)), 1e-10)


def test_a_wrench_on_the_platform_is_what_f_falls_by() -> None:
    """On the platform the Jacobian is the identity: closed forms, both kinds of axes, and a moment arm."""
    robot = machine("3rrr")
    motion, carriers = moving(robot)
    wrench = np.random.default_rng(1).normal(size=(len(motion), 6))
    angle, unloaded = motion.x[:, 2], RneaDynamics(robot).reduce(motion, carriers).f
    rows = wrench[:, [0, 1, 5]]
    for dynamics in (RneaDynamics(robot), VirtualWork(robot)):  # generated code has those of RNEA, see above
        world = dynamics.reduce(motion, carriers, external=[Wrench("platform", wrench)]).f
        assert_alike(unloaded - world, rows)
        local = dynamics.reduce(motion, carriers, external=[Wrench("platform", wrench, "local", (0.2, 0.0, 0.0))]).f
        c, s = np.cos(angle), np.sin(angle)
        push = np.stack([c * rows[:, 0] - s * rows[:, 1], s * rows[:, 0] + c * rows[:, 1]], axis=1)
        turned = rows[:, 2] + 0.2 * (c * push[:, 1] - s * push[:, 0])
        assert_alike(unloaded - local, np.column_stack([push, turned]))


def test_a_payload_is_mass_of_the_platform() -> None:
    robot, heavier = machine("3rrr"), zoo.robot_of("3rrr", gravity=(1.0, -9.0, 2.0), platform_mass=1.7)
    motion, carriers = moving(robot)
    disc = 0.5 * 1.2 * 0.25**2
    payload = Payload("platform", 1.2, inertia=np.diag([0.5 * disc, 0.5 * disc, disc]))
    assert robot.loaded(payload).model.inertias != robot.model.inertias
    expected = RneaDynamics(heavier).along(motion)
    for dynamics in (RneaDynamics(robot), VirtualWork(robot)):
        along = dynamics.with_external(payload).along(motion)
        assert_alike(along.reduce(carriers).f, expected.reduce(carriers).f)
        assert_alike(along.base_wrench(carriers), expected.base_wrench(carriers))
        assert_alike(along.energy(carriers), expected.energy(carriers))


def test_process_forces_are_functions_of_time_and_pose() -> None:
    robot = machine("3rrr")
    motion, carriers = moving(robot)

    def spring_of_the_wall(t: Array, x: Array, xd: Array) -> Array:
        push = np.zeros((len(t), 6))
        push[:, 0], push[:, 1] = -30.0 * x[:, 0] - 2.0 * xd[:, 0], np.sin(t)
        return push

    law = Wrench("platform", spring_of_the_wall)
    values = Wrench("platform", spring_of_the_wall(motion.t, motion.x, motion.xd))
    for dynamics in (RneaDynamics(robot), VirtualWork(robot), CompiledDynamics(robot)):
        expected = dynamics.reduce(motion, carriers, external=[values])
        assert_alike(dynamics.reduce(motion, carriers, external=[law]).f, expected.f)
        one = dynamics.with_external(law).sample(
            motion.x[4], motion.xd[4], motion.xdd[4], carriers.s[4], carriers.sd[4], carriers.sdd[4], t=motion.t[4]
        )
        assert_alike(one.f, expected.f[4])
        assert_alike(one.carrier_force, expected.carrier_force[4])


def test_what_cannot_be_said_is_refused_by_name() -> None:
    robot, motion = machine("3rrr"), moving(machine("3rrr"))[0]
    with pytest.raises(InputError, match="no link") as caught:
        robot.loaded(Wrench("platfrom", np.zeros(6)))
    assert "platform" in caught.value.remedy
    with pytest.raises(InputError, match="has 3 samples, the motion 12"):
        RneaDynamics(robot).reduce(motion, external=[Wrench("platform", np.zeros((3, 6)))])
    with pytest.raises(InputError, match="reference"):
        Wrench("platform", np.zeros(6), "body")  # type: ignore[arg-type]
    tilted = np.eye(3)
    tilted[0, 1] = 1e-6
    for inertia in (*map(np.diag, ([1.0, 1.0, 3.0], [1.0, 1.0, 2.000001], [-1e-6, 1.0, 1.0])), tilted):
        with pytest.raises(InputError, match="no body has"):
            Payload("platform", 1.0, inertia=inertia)
    Payload("platform", 1.0, inertia=np.diag([1.0, 1.0, 2.0]))  # a flat body
    for no_matrix in ("ball", [[1.0], [2.0, 3.0]], [1.0, 2.0]):
        with pytest.raises(InputError, match=r"^inertia "):
            Payload("platform", 1.0, inertia=no_matrix)
    with pytest.raises(InputError, match="damping"):
        JointForces("base_1", damping=-1.0)
    with pytest.raises(InputError, match="shape"):
        Wrench("platform", lambda t, x, xd: np.zeros(6)).at(motion.t, motion.x, motion.xd)
    with pytest.raises(InputError, match="A load is"):
        robot.loaded("platform")  # type: ignore[arg-type]
    with pytest.raises(UnsupportedRobotError, match="takes no loads"):
        Dynamics.for_robot(VirtualWork(robot), robot)


def test_damping_of_balls_is_the_same_in_both_backends(tmp_path: Path) -> None:
    robot = rp.load_robot(write(tmp_path, RSSR))
    assert {load.joint for load in robot.loads if isinstance(load, JointForces)} == {"ball", "second"}
    motion, _ = moving(robot, 6)
    one, two = RneaDynamics(robot).along(motion), CompiledDynamics(robot).along(motion)
    assert_alike(one.reduce().f, two.reduce().f)
    assert_alike(one.base_wrench(), two.base_wrench())
    assert_alike(one.energy(), two.energy())
    for given in ({"friction": 1.0}, {"stiffness": 1.0}, {"rotor_inertia": 1.0}):
        with pytest.raises(UnsupportedRobotError, match=r"'ball' has 3 freedoms.*can have damping"):
            robot.loaded(JointForces("ball", **given))


def test_symbols_hold_constant_wrenches_only() -> None:
    robot = machine("four_bar")
    link = str(robot.model.frames[-1].name)
    loaded = robot.loaded(Wrench(link, (1.0, 2.0, 0.0, 0.0, 0.0, 0.5)))
    motion = moving(loaded, 4)[0]
    tree, expected = rp.inverse_kinematics(loaded, motion), RneaDynamics(loaded).reduce(motion)
    f = rp.symbolic(loaded).f(tree.q[2], tree.v[2], tree.a[2])
    assert_alike(np.array(f).ravel(), expected.f[2])
    with pytest.raises(UnsupportedRobotError, match="constant"):
        rp.symbolic(robot.loaded(Wrench(link, lambda t, x, xd: np.zeros((len(t), 6)))))


def test_reactions_balance_with_loads() -> None:
    """What the base's joints transmit, summed about the origin, is the wrench on the base."""
    robot = machine("2rpr").loaded(
        Wrench("piston_2", (5.0, 3.0, 0.0, 0.0, 0.0, 2.0), "world", (0.1, 0.0, 0.0)), JointForces("slide_1", 2.0)
    )
    motion, carriers = moving(robot)
    along = RneaDynamics(robot).along(motion)
    reactions = rp.joint_reactions(along, rp.distribute(along.reduce(carriers)).tau, carriers)
    assert reactions.residual.max() < 1e-9
    total = np.zeros((len(motion), 3))
    for name, place in (("swivel_1", 0.0), ("swivel_2", 0.5)):
        force, moment = np.split(reactions.joint_wrench[:, reactions.joints.index(name)], 2, axis=1)
        total[:, :2] -= force[:, :2]
        total[:, 2] -= moment[:, 2] + place * force[:, 1]
    assert_alike(total, along.base_wrench(carriers)[:, [0, 1, 5]], 1e-9)


@pytest.mark.long_for("2rpr")
@pytest.mark.parametrize("name", ["2rpr", "gough"])
def test_planned_efforts_in_open_loop_close_with_everything_on(name: str) -> None:
    robot = zoo.robot_of(name, gravity=(0.5, -9.0, 2.0), **ARGUMENTS.get(name, {}))
    joints = joints_of(robot)[:8]
    link = robot.platform.frame if robot.platform else ""
    loaded = robot.loaded(
        Wrench(link, _pull, "local", (0.05, 0.02, 0.0)),
        Payload(link, 0.2, (0.02, 0.0, 0.01), 1e-3),
        *(JointForces(joint, 0.4, 0.5, 0.1, 0.3, 0.2, 0.0005, -8.0) for joint in joints),
        Spring("base", link, 12.0, 2.0, 0.1, (0.3, -0.2, 0.1)),
    )
    motion = zoo.smooth_motion(robot, 13).at(np.linspace(0.0, 0.2, 21))
    reference = rp.simulation.motion_reference(loaded, motion)
    simulated = {"duration": 0.05, "rtol": 1e-11, "atol": 1e-12, "dt": 0.02}
    run = rp.simulate(loaded, rp.simulation.FeedForward(reference), **simulated)
    assert run.status.value == "ok"
    expected = np.array([reference.platform(t)[0] for t in run.t])
    assert np.abs(run.x - expected).max() < REPLAY
    if name == "2rpr":  # machine code, which has rows, masses and loads of its own
        code = rp.simulate(loaded, rp.simulation.FeedForward(reference), dynamics=CompiledDynamics(loaded), **simulated)
        assert np.abs(code.x - expected).max() < REPLAY
        assert_alike(code.energy, run.energy, 1e-9)
        assert_alike(code.closure_force, run.closure_force, 1e-7)
    lacking = replace(loaded, loads=loaded.loads[2:])
    off = rp.simulate(lacking, rp.simulation.FeedForward(reference), **simulated)
    assert np.abs(off.x - expected[: len(off.x)]).max() > 1e-5


def _pull(t: Array, x: Array, xd: Array) -> Array:
    wrench, place = np.zeros((len(t), 6)), x[:, :3, 3] if x.ndim == 3 else x
    wrench[:, 0], wrench[:, 1] = 3.0 * np.sin(2.0 * t) - 4.0 * xd[:, 0], -8.0 - 5.0 * place[:, 1]
    return wrench


def test_rotors_obey_lagrange_on_a_spatial_tree() -> None:
    """Gyroscopic moments do no work, and no balance of power sees them: d/dt ∂T/∂v − ∂T/∂q, by differences."""
    robot = machine("gough")
    model, data = robot.model, robot.model.createData()
    loads = [JointForces(name, rotor_inertia=0.02, gear=gear) for name, gear in _GEARS.items()]
    loaded = robot.loaded(*loads)

    def mass(q: Array) -> Array:
        """Return M_r of T = ½ vᵀ M_r v = Σ ½ I G² v² + I G v z·ω, ω of the link before the joint."""
        pin.computeJointJacobians(model, data, q)
        total = np.zeros((model.nv, model.nv))
        for load in loads:
            index = model.getJointId(load.joint)
            column = model.joints[index].idx_v
            own, before = (
                pin.getJointJacobian(model, data, which, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
                for which in (index, model.parents[index])
            )
            axis = own[3:, column] if load.joint.startswith(("tilt", "ball")) else own[:3, column]
            size = load.rotor_inertia * load.gear
            total[column, column] += size * load.gear
            coupling = np.zeros_like(total)
            coupling[column] = size * axis @ (before[3:] if model.parents[index] else 0.0 * own[3:])
            total += coupling + coupling.T
        return total

    rng = np.random.default_rng(2)
    (q,), (v,) = zoo.random_tree(robot, 5, 1)
    a, h = rng.normal(size=model.nv), 1e-3
    weights = {1: 8.0 / 12.0, 2: -1.0 / 12.0}
    by_q = np.array(
        [
            sum(s * w * mass(q + s * k * h * unit) / h for k, w in weights.items() for s in (1.0, -1.0))
            for unit in np.eye(model.nv)
        ]
    )
    expected = mass(q) @ a + np.einsum("kij,k,j->i", by_q, v, v) - 0.5 * np.einsum("kij,i,j->k", by_q, v, v)
    (effort, whole), (bare, links) = (tree_equations(each, data, q, v, a) for each in (loaded, robot))
    np.testing.assert_allclose(effort - bare, expected, atol=1e-9)
    np.testing.assert_allclose(np.triu(whole - links), np.triu(mass(q)), atol=1e-13)


_GEARS = {"tilt_1": -7.0, "slide_2": 30.0, "ball_1_z": 5.0, "ball_1_y": -9.0}


def test_friction_of_fast_joints_does_not_overflow() -> None:
    """Its derivative against central differences; at a thousand friction speeds it is the damping."""
    load, step = JointForces("crank", damping=0.3, friction=2.0, friction_speed=0.01), 1e-6
    v = np.array([-0.02, 0.0, 0.004, 0.03])
    expected = (load.resistance(0.0 * v, v + step) - load.resistance(0.0 * v, v - step)) / (2.0 * step)
    np.testing.assert_allclose(load.resistance_rate(v), expected, rtol=1e-6)
    with np.errstate(all="raise"):
        np.testing.assert_array_equal(load.resistance_rate(np.array([-10.0, 10.0])), 0.3)
