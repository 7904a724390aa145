"""Compiled dynamics against the RNEA backend, Lagrange's equations for point masses, and what can go wrong.

Neither judge shares code with it: not its kinematics, not its Newton-Euler recursion.
"""

from __future__ import annotations

import copy
import itertools
import pickle
import threading
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import casadi
import numpy as np
import pinocchio as pin
import pytest
import spatial_chains
import zoo
from examples import examples
from flat_linkages import parallelogram
from hypothesis import given
from hypothesis import strategies as st
from point_mass_oracle import three_rrr_masses, two_rpr_masses
from scipy.spatial.transform import Rotation

from redundancy_pin import (
    CarrierMotion,
    PlatformMotion,
    RneaDynamics,
    distribute,
    load_robot,
    trajectory,
)
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.dynamics.compiled.closing import LARGEST_TURN, waypoints
from redundancy_pin.dynamics.compiled.parameters import parameter_vector, trig_at
from redundancy_pin.dynamics.compiled.symbols import SymbolicChain
from redundancy_pin.errors import (
    InputError,
    SingularPoseError,
    UnreachablePoseError,
)
from redundancy_pin.machine_code import CACHE
from redundancy_pin.robot import Robot

EQUAL = 1e-11
"""Relative to the largest value of the motion: what the issue of this backend asks for. Rounding is 1e-14."""

ZERO = 1e-3
"""N, m, J: what is below it next to zero is a difference of efforts of 1 to 100."""

LAGRANGE = 1e-8
"""The oracle differentiates by differences of order eight over 2e-3."""

MASSIVE = {
    "2rpr": {"end_effector_mass": 0.4, "cylinder_mass": 0.5, "piston_mass": 0.3, "gravity": (0.0, -9.81, 0.0)},
    "3rrr": {"gravity": (0.0, -9.81, 0.0)},
    "five_bar": {"gravity": (1.0, -9.81, 0.0)},
    "four_bar": {},
    "gough": {"payload_mass": 2.0},
}


def robot_of(name: str, **changed: object) -> Robot:
    return (
        spatial_chains.chain_of(name)
        if name in spatial_chains.CHAINS
        else zoo.robot_of(name, **MASSIVE[name], **changed)
    )


def assert_equal(got: np.ndarray, want: np.ndarray, what: str) -> None:
    scale = np.abs(want).max(initial=0.0)
    np.testing.assert_allclose(got, want, rtol=0.0, atol=EQUAL * max(scale, ZERO), err_msg=what)


def assert_same_dynamics(compiled: CompiledDynamics, motion: PlatformMotion, carriers: CarrierMotion) -> None:
    mine, theirs = compiled.along(motion), RneaDynamics(compiled.robot).along(motion)
    got, want = mine.reduce(carriers), theirs.reduce(carriers)
    for name in ("f", "W", "carrier_force", "row_scale", "column_scale", "reachable"):
        assert_equal(getattr(got, name), getattr(want, name), name)
    assert_equal(mine.base_wrench(carriers), theirs.base_wrench(carriers), "base wrench")
    assert_equal(mine.energy(carriers), theirs.energy(carriers), "energy")
    first, second = mine.carrier_derivatives(carriers), theirs.carrier_derivatives(carriers)
    for name in ("f_s", "f_sd", "f_sdd", "force_s", "force_sd", "force_sdd"):
        assert_equal(getattr(first, name), getattr(second, name), name)


# --- the same as RNEA on the tree, written by others ----------------------------------------------------------------


@pytest.mark.long_for("gough", "hinge", "five_bar", "cylindrical")
@pytest.mark.parametrize("name", [*MASSIVE, *spatial_chains.CHAINS])
def test_every_robot_moves_as_with_rnea(name: str) -> None:
    robot = robot_of(name)
    compiled = CompiledDynamics(robot, threads=1)
    t = np.linspace(0.0, 2.0, 300)
    for seed in range(3):
        assert_same_dynamics(compiled, zoo.smooth_motion(robot, seed).at(t), zoo.carriers_at(robot, t, seed))


@examples(2)
@given(mode=st.tuples(*[st.sampled_from((1, -1))] * 3), seed=st.integers(0, 2**16))
def test_random_machines_and_modes(mode: tuple[int, int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes = {"proximal_length": rng.uniform(0.9, 1.3), "distal_length": rng.uniform(0.9, 1.3)}
    masses = {name: float(rng.uniform(0.0, 3.0)) for name in ("proximal_mass", "distal_mass", "carrier_mass")}
    robot = load_robot("3rrr", working_mode=mode, gravity=(0.3, -9.0, 1.0), **sizes, **masses)
    t = np.linspace(0.0, 1.0, 60)
    compiled = CompiledDynamics(robot, threads=1)
    assert_same_dynamics(compiled, zoo.smooth_motion(robot, seed).at(t), zoo.carriers_at(robot, t, seed))


def test_a_carrier_that_turns_moves_as_with_rnea() -> None:
    """Its cosine and sine are of its own position, not of the configuration that was closed with it at zero."""
    base = robot_of("four_bar")
    model = base.model.copy()
    place = pin.SE3(np.eye(3), np.array([0.1, 0.05, 0.0]))
    rotor = model.addJoint(2, pin.JointModelRZ(), place, "rotor")
    model.appendBodyToJoint(rotor, pin.Inertia(0.4, np.array([0.03, 0.01, 0.0]), 0.002 * np.eye(3)), pin.SE3.Identity())
    robot = Robot.from_model(
        model, closures=base.closures, actuated=base.actuated, carriers=["rotor"], independent=base.independent_joints,
        reference=np.append(base.q_reference, 0.0),
    ).with_limits(lower=-3.0, upper=3.0)  # fmt: skip
    t = np.linspace(0.0, 1.0, 20)
    assert_same_dynamics(CompiledDynamics(robot), zoo.smooth_motion(robot, 1).at(t), zoo.carriers_at(robot, t, 1))


def test_type_two_poses_are_as_finite_as_elsewhere() -> None:
    robot = robot_of("2rpr")
    motion = trajectory.reference.circle().sample(dt=0.002)  # crosses the line A1 A2 twice
    compiled = CompiledDynamics(robot)
    assert_same_dynamics(compiled, motion, zoo.carriers_at(robot, motion.t))
    determinant = np.linalg.det(compiled.reduce(motion).W)
    assert (np.diff(np.sign(determinant)) != 0).sum() == 2
    at = PlatformMotion([0.0], [[0.2, 0.0]], [[0.3, -0.7]], [[1.0, 2.0]])  # on the line itself
    rank_lost = distribute(compiled.reduce(at))
    assert rank_lost.rank[0] == 1
    np.testing.assert_array_equal(rank_lost.status, distribute(RneaDynamics(robot).reduce(at)).status)


# --- joints of several freedoms, which no shipped model has -----------------------------------------------------------


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


# --- Lagrange's equations, for point masses -------------------------------------------------------------------------


@pytest.mark.long_for("0-3rrr", "0-2rpr", "2-2rpr", "2-3rrr")
@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
@pytest.mark.parametrize("seed", range(3))
def test_efforts_obey_lagrange(name: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    if name == "2rpr":
        names = ("end_effector_mass", "cylinder_mass", "piston_mass", "carrier_mass", "track_offset")
        mode = (1, -1) if seed == 1 else (1, 1)
    else:
        names = ("proximal_mass", "distal_mass", "platform_mass", "carrier_mass")
        mode = (1, -1, 1) if seed == 1 else (1, 1, 1)
    gravity = rng.uniform(-10.0, 10.0, 3)
    chosen = {key: float(rng.uniform(0.1, 1.0)) for key in names}
    robot = load_robot(name, working_mode=mode, gravity=tuple(gravity), **chosen)
    oracle = (two_rpr_masses if name == "2rpr" else three_rrr_masses)(dict(robot.parameters), mode)
    t = np.linspace(0.0, 1.0, 10)
    motion, carriers = zoo.smooth_motion(robot, seed).at(t), zoo.carriers_at(robot, t, seed)
    compiled = CompiledDynamics(robot)
    reduced, wrench = compiled.reduce(motion, carriers), compiled.along(motion).base_wrench(carriers)
    for k in range(len(t)):
        state = [np.concatenate(pair) for pair in ((motion.x[k], carriers.s[k]), (motion.xd[k], carriers.sd[k]),
                                                   (motion.xdd[k], carriers.sdd[k]))]  # fmt: skip
        want = oracle.generalised_force(*state, gravity)
        got = np.concatenate([reduced.f[k], reduced.carrier_force[k]])
        np.testing.assert_allclose(got, want, rtol=0.0, atol=LAGRANGE * max(1.0, np.abs(want).max()))
        at_rest = oracle.base_wrench(*state, gravity)
        np.testing.assert_allclose(wrench[k], at_rest, rtol=0.0, atol=LAGRANGE * max(1.0, np.abs(at_rest).max()))


def test_the_layout_of_a_motion_in_memory_does_not_matter() -> None:
    robot = robot_of("3rrr")
    motion = zoo.smooth_motion(robot, 4).at(np.linspace(0.0, 1.0, 10))
    turned = PlatformMotion(motion.t, *(np.asfortranarray(part) for part in (motion.x, motion.xd, motion.xdd)))
    compiled = CompiledDynamics(robot)
    np.testing.assert_array_equal(compiled.reduce(turned).f, compiled.reduce(motion).f)


# --- one sample -----------------------------------------------------------------------------------------------------


@pytest.mark.long_for("gough")
@pytest.mark.parametrize("name", ["3rrr", "gough", "four_bar"])
def test_one_sample_is_a_row_of_many(name: str) -> None:
    robot = robot_of(name)
    t = np.linspace(0.0, 1.0, 30)
    motion, carriers = zoo.smooth_motion(robot, 1).at(t), zoo.carriers_at(robot, t, 1)
    compiled = CompiledDynamics(robot)
    want = compiled.reduce(motion, carriers)
    for k in np.random.default_rng(0).permutation(len(t)):  # near ones and far ones
        row = (motion.x[k], motion.xd[k], motion.xdd[k], carriers.s[k], carriers.sd[k], carriers.sdd[k])
        sample = compiled.sample(*row)
        assert_equal(sample.W, want.W[k], "W")
        assert_equal(sample.f, want.f[k], "f")
        assert_equal(sample.carrier_force, want.carrier_force[k], "carrier force")
    parked = compiled.sample(*row[:3])  # whatever the carriers did before
    assert_equal(parked.f, compiled.reduce(motion).f[k], "f")


def test_each_thread_has_its_own_warm_start() -> None:
    robot = robot_of("3rrr")
    t = np.linspace(0.0, 1.0, 200)
    compiled = CompiledDynamics(robot)
    motions = [zoo.smooth_motion(robot, seed).at(t) for seed in range(4)]
    wanted = [compiled.reduce(motion).f for motion in motions]
    got: list[list[np.ndarray]] = [[] for _ in motions]

    def work(i: int) -> None:
        for k in range(len(t)):
            got[i].append(compiled.sample(motions[i].x[k], motions[i].xd[k], motions[i].xdd[k]).f)

    threads = [threading.Thread(target=work, args=(i,)) for i in range(len(motions))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for mine, want in zip(got, wanted, strict=True):
        assert_equal(np.array(mine), want, "f")


@pytest.mark.parametrize(
    "wrong", [{"x": [0.1]}, {"xd": [1.0, 2.0]}, {"x": [np.nan] * 3}, {"sd": [np.nan] * 3}, {"s": [0.1]}, {"x": "here"}]
)
def test_a_sample_of_the_wrong_form_is_refused(wrong: dict[str, object]) -> None:
    robot = robot_of("3rrr")
    given = {"x": zoo.home_of(robot), "xd": np.zeros(3), "xdd": np.zeros(3), "s": np.zeros(3)} | wrong
    compiled = CompiledDynamics(robot)
    with pytest.raises(InputError):
        compiled.sample(**given)  # type: ignore[arg-type]
    assert np.isfinite(compiled.sample(zoo.home_of(robot), np.zeros(3), np.zeros(3)).f).all()


# --- out of reach, singular, another mode ---------------------------------------------------------------------------


def line(first: list[float], last: list[float], samples: int = 30) -> PlatformMotion:
    t = np.linspace(0.0, 1.0, samples)
    a, b = np.array(first), np.array(last)
    x = a + t[:, None] * (b - a)
    return PlatformMotion(t, x, np.repeat((b - a)[None], samples, axis=0), np.zeros_like(x))


LEAVING = {
    "out of the workspace": ("3rrr", line([0.9, 0.5, 0.0], [2.9, 0.5, 0.0]), UnreachablePoseError),
    "begins out of it": ("3rrr", line([9.0, 0.5, 0.0], [9.1, 0.5, 0.0]), UnreachablePoseError),
    "through a stretched leg of no length": ("2rpr", line([0.25, 0.3], [0.0, 0.0], 11), SingularPoseError),
    "five-bar stretched": ("five_bar", line([0.0, 0.5], [0.0, 5.0]), UnreachablePoseError),
}


@pytest.mark.parametrize("what", LEAVING)
def test_a_motion_that_cannot_be_is_refused_as_by_rnea(what: str) -> None:
    name, motion, expected = LEAVING[what]
    robot = robot_of(name)
    with pytest.raises(expected) as theirs:
        RneaDynamics(robot).along(motion)
    with pytest.raises(expected) as mine:
        CompiledDynamics(robot).along(motion)
    assert mine.value.details["sample"] == theirs.value.details["sample"]
    if expected is UnreachablePoseError:
        # the smallest gap from another start may be another local one, of the same size
        assert 0.3 < mine.value.details["gap"] / theirs.value.details["gap"] < 3.0  # type: ignore[operator]


def test_marked_samples_are_those_of_rnea() -> None:
    robot = robot_of("3rrr")
    there, back = line([0.9, 0.5, 0.0], [2.2, 0.9, 0.3]), line([2.2, 0.9, 0.3], [0.9, 0.5, 0.0])
    for motion in (there, back):
        theirs = RneaDynamics(robot).reduce(motion, unreachable="mark")
        mine = CompiledDynamics(robot).reduce(motion, unreachable="mark")
        np.testing.assert_array_equal(mine.reachable, theirs.reachable)
        assert 3 < mine.reachable.sum() < 27
        assert np.isnan(mine.f[~mine.reachable]).all()
        assert (mine.gap[~mine.reachable] > 1e-3).all()
        assert_equal(mine.f[mine.reachable], theirs.f[mine.reachable], "f")


def test_a_sample_far_from_the_one_before_is_reached_from_the_reference() -> None:
    robot = zoo.robot_of("2rpr")
    compiled, xd, xdd = CompiledDynamics(robot), [0.3, -0.2], [1.0, 2.0]
    # through zero length: the way from each to the next is barred
    for x in ([0.2, 0.1], [-0.2, -0.1], [0.2, 0.1]):
        theirs = RneaDynamics(robot).reduce(PlatformMotion([0.0], [x], [xd], [xdd]))
        sample = compiled.sample(x, xd, xdd)
        assert_equal(sample.W, theirs.W[0], "W")
        assert_equal(sample.f, theirs.f[0], "f")


def test_rates_that_overflow_are_no_singularity() -> None:
    robot = zoo.robot_of("3rrr")
    with pytest.raises(InputError, match="beyond 1e"):
        CompiledDynamics(robot).sample(zoo.home_of(robot), [1e200] * 3, [0.0] * 3)


def test_samples_in_several_threads_are_those_of_one() -> None:
    robot = robot_of("3rrr")
    t = np.linspace(0.0, 3.0, 5000)
    motion, carriers = zoo.smooth_motion(robot, 3).at(t), zoo.carriers_at(robot, t)
    one, many = (CompiledDynamics(robot, threads=threads).reduce(motion, carriers) for threads in (1, 4))
    np.testing.assert_array_equal(many.f, one.f)
    np.testing.assert_array_equal(many.carrier_force, one.carrier_force)


def test_two_sided_samples_and_sparse_ones() -> None:
    robot = robot_of("3rrr")
    corner = trajectory.reference.corner().sample(dt=0.01)
    assert corner.jumps.any()
    assert_same_dynamics(CompiledDynamics(robot), corner, CarrierMotion.parked(len(corner), 3))
    sparse = zoo.smooth_motion(robot, 2).at(np.linspace(0.0, 2.0, 7))
    assert_same_dynamics(CompiledDynamics(robot), sparse, CarrierMotion.parked(7, 3))


# --- compilers, caches, processes -----------------------------------------------------------------------------------


def test_a_library_is_kept_and_a_broken_one_or_that_of_another_robot_is_built_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "kept"
    spelled = (f"{folder}{'/.' * count}" for count in itertools.count())

    def compile_and_compare(name: str) -> None:
        monkeypatch.setenv(CACHE, next(spelled))  # what a process has loaded it takes from the folder it knows
        robot = robot_of(name)
        motion = zoo.smooth_motion(robot, 0).at(np.linspace(0.0, 1.0, 5))
        assert_equal(CompiledDynamics(robot).reduce(motion).f, RneaDynamics(robot).reduce(motion).f, "f")

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


def test_a_motion_through_a_rank_loss_of_the_closures_is_that_of_the_kinematics() -> None:
    """Newton's method of the driver ends there; the branch goes on, and forces with it."""
    robot = parallelogram()
    t = np.linspace(0.0, 1.0, 101)
    through = PlatformMotion(t, 1.2 - 2.4 * t[:, None], np.full((101, 1), -2.4), np.zeros((101, 1)))
    mine, theirs = (backend(robot).reduce(through) for backend in (CompiledDynamics, RneaDynamics))
    assert mine.reachable.all()
    for name in ("f", "W"):
        assert_equal(getattr(mine, name), getattr(theirs, name), name)


def test_a_pose_far_away_is_approached_in_equal_turns() -> None:
    """By the least rotation, and along a straight line; coordinates go at once."""
    first, last, angle = np.eye(4), np.eye(4), 3.5 * LARGEST_TURN
    turn = angle * np.array([1.0, 2.0, -2.0]) / 3.0
    first[:3, :3] = Rotation.from_rotvec([0.1, 0.2, 0.3]).as_matrix()
    last[:3, :3] = Rotation.from_rotvec(turn).as_matrix() @ first[:3, :3]
    first[:3, 3], last[:3, 3] = [1.0, 2.0, 3.0], [0.0, 4.0, 3.5]
    way = np.array(waypoints(first.ravel(), last.ravel(), True)).reshape(-1, 4, 4)
    assert len(way) == 4
    for share, pose in zip((0.25, 0.5, 0.75, 1.0), way, strict=True):
        expected = (1.0 - share) * first + share * last
        expected[:3, :3] = Rotation.from_rotvec(share * turn).as_matrix() @ first[:3, :3]
        np.testing.assert_allclose(pose, expected, atol=1e-12)
    assert waypoints(np.zeros(2), np.ones(2), False)[0].tolist() == [1.0, 1.0]


def test_copies_and_pickles_compute_the_same() -> None:
    four_bar = robot_of("four_bar")
    compiled = CompiledDynamics(four_bar)
    motion = zoo.smooth_motion(four_bar, 0).at(np.linspace(0.0, 1.0, 5))
    along = compiled.along(motion)
    for other in (pickle.loads(pickle.dumps(compiled)), copy.deepcopy(compiled)):
        np.testing.assert_array_equal(other.reduce(motion).f, compiled.reduce(motion).f)
    again = pickle.loads(pickle.dumps(along)).reduce()
    np.testing.assert_array_equal(again.f, along.reduce().f)
    assert not again.f.flags.writeable
