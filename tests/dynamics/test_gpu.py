"""Many samples by the text that a GPU runs, compiled for the processor; NVRTC takes it, where that is installed."""

from __future__ import annotations

import copy
import ctypes
import importlib.util
import pickle
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import zoo
from machines import MASSIVE, machine

import redundancy_pin as rp
from redundancy_pin.dynamics.compiled import gpu
from redundancy_pin.dynamics.compiled.parameters import topology_of
from redundancy_pin.errors import CompilerError, InputError, RedundancyPinError, UnsupportedRobotError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.machine_code import find_compiler
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.shipped import shipped_robots
from redundancy_pin.status import SampleStatus

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")

EQUAL = 1e-12
"""Of the largest effort: both run one text, and compilers may put sums of a few products together in another order."""

INDEPENDENT = 1e-8
"""Of the largest effort, against Pinocchio: both close the loops to their own tolerance."""

ROBOTS = shipped_robots()
LONG = ("excavator", "five_bar", "2rpr", "gough")
"""Of kinds that others have: couplings of the ankle, planar chains of the 3-RRR, poses of two arms."""
SOLVED = (SampleStatus.OK, SampleStatus.NEAR_SINGULAR, SampleStatus.SINGULAR_CONSISTENT, SampleStatus.OUT_OF_RANGE)
REFUSED = (SampleStatus.UNREACHABLE, SampleStatus.BRANCH_LOST, SampleStatus.TYPE_I)
PARTS = "tau", "carrier_force", "margin", "residual", "serial_margin"


@cache
def dynamics_of(name: str) -> rp.GpuDynamics:
    return rp.GpuDynamics(machine(name), device="cpu")


def states(robot: Robot, count: int, reach: float, seed: int) -> dict[str, Any]:
    """Return random arguments of ``torque``, poses up to a share of the characteristic length from the reference."""
    rng, n, k = np.random.default_rng(seed), robot.n, robot.k
    home = follower(robot).state_at(robot.q_reference)
    assert home is not None
    size = reach * robot.characteristic_length * rng.uniform(size=count)
    if is_pose(robot):
        x = np.array([home.x @ pin.exp6(one * rng.uniform(-1.0, 1.0, 6)).homogeneous for one in size])
    else:
        x = home.x + size[:, None] * rng.uniform(-1.0, 1.0, (count, n))
    s = 0.05 * robot.characteristic_length * rng.normal(size=(3, count, k))
    return {"x": x, "xd": rng.normal(size=(count, n)), "xdd": rng.normal(size=(count, n)),
            "s": s[0], "sd": s[1], "sdd": s[2]}  # fmt: skip


def one_by_one(robot: Robot, given: dict[str, Any]) -> list[Any]:
    """Return each sample by ``CompiledDynamics.torque``, from the reference."""
    compiled = rp.CompiledDynamics(robot)
    return [compiled.torque(*row, start=robot.q_reference) for row in zip(*given.values(), strict=True)]


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.long) if name in LONG else name for name in ROBOTS]
)
@pytest.mark.parametrize("reach", [0.2, 2.0])
def test_samples_are_those_of_compiled_dynamics(name: str, reach: float) -> None:
    robot = machine(name)
    given = states(robot, 24, reach, seed=7)
    found, wanted = dynamics_of(name).torque(**given), one_by_one(robot, given)
    solved = np.isin(found.status, SOLVED)
    assert solved.mean() > (0.9 if reach < 1.0 else 0.2)
    largest = max(np.abs(one.tau).max() for one, good in zip(wanted, solved, strict=True) if good)
    for k, one in enumerate(wanted):
        if not solved[k]:  # kinematics may pass where the straight way ends
            assert found.status[k] in REFUSED
            assert np.isnan(found.tau[k]).all()
            assert one.status in (*REFUSED, *SOLVED)
            continue
        assert found.status[k] == one.status
        for part in PARTS:
            np.testing.assert_allclose(getattr(found, part)[k], getattr(one, part), rtol=EQUAL, atol=EQUAL * largest)
    refused = [one.status in SOLVED for one, good in zip(wanted, solved, strict=True) if not good]
    assert sum(refused) <= (0 if reach < 1.0 else 0.4 * len(given["x"]))


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "delta", "gough"])
def test_efforts_and_equations_are_those_of_pinocchio(name: str) -> None:
    robot = machine(name)
    given = states(robot, 12, 0.2, seed=11)
    found, rnea = dynamics_of(name).torque(**given, equations=True), rp.RneaDynamics(robot)
    for k, row in enumerate(zip(*given.values(), strict=True)):
        sample, wanted = rnea.sample(*row), rnea.torque(*row)
        for part, other in (
            (found.W[k], sample.W),
            (found.f[k], sample.f),
            (found.carrier_force[k], sample.carrier_force),
        ):
            np.testing.assert_allclose(
                part, other, rtol=INDEPENDENT, atol=INDEPENDENT * max(1.0, np.abs(other).max(initial=0.0))
            )
        assert found.status[k] == wanted.status
        np.testing.assert_allclose(
            found.tau[k], wanted.tau, rtol=INDEPENDENT, atol=INDEPENDENT * np.abs(wanted.tau).max()
        )


def test_a_warm_start_follows_a_motion_as_a_motion_is_followed() -> None:
    robot = machine("3rrr")
    reference = follower(robot).state_at(robot.q_reference)
    assert reference is not None
    angle = np.linspace(0.0, 2.0 * np.pi, 60)
    away = 0.06 * np.array([np.cos(angle) - 1.0, np.sin(angle), np.zeros(60)]).T
    dynamics, state, taus = dynamics_of("3rrr"), None, list[Any]()
    many = np.array([1.0, 0.5, 0.25])[:, None]  # three machines in step, each on a circle of its own
    for one in away:
        found = dynamics.torque(reference.x + many * one, 0.1, 0.0, start=state)
        assert (found.status == SampleStatus.OK).all()
        state = found.state
        taus.append(found.tau)
    rnea = rp.RneaDynamics(robot)
    for k in (7, 31, 59):
        for at in range(3):
            x = reference.x + many[at] * away[k]
            wanted = rnea.torque(x, np.full(3, 0.1), np.zeros(3), *np.zeros((3, 3)))
            np.testing.assert_allclose(taus[k][at], wanted.tau, rtol=INDEPENDENT, atol=INDEPENDENT)


def test_a_start_decides_how_far_is_far() -> None:
    robot, dynamics = machine("gough"), dynamics_of("gough")
    home = follower(robot).state_at(robot.q_reference)
    assert home is not None
    turned = [home.x @ pin.exp6(np.array([0, 0, 0, 0, 0, 0.05 * k])).homogeneous for k in range(12)]
    state: Any = None
    for x in turned:
        found = dynamics.torque(x[None], 0.0, 0.0, start=state)
        assert found.status[0] in SOLVED
        state = found.state
    again = dynamics.torque(turned[-1][None], 0.0, 0.0, start=state)
    np.testing.assert_array_equal(again.tau, found.tau)
    lost = dynamics.torque(turned[-1][None], 0.0, 0.0, start=state * np.nan)
    assert lost.status[0] == SampleStatus.NOT_FINITE
    assert np.isnan(lost.tau).all()


def test_a_sample_that_is_refused_leaves_its_state_where_it_was() -> None:
    robot, dynamics = machine("3rrr"), dynamics_of("3rrr")
    found = dynamics.torque(np.array([[9.0, 9.0, 0.0], [np.nan, 0.0, 0.0]]), 0.0, 0.0)
    assert found.status.tolist() == [SampleStatus.UNREACHABLE, SampleStatus.NOT_FINITE]
    np.testing.assert_allclose(found.state[:, :-1], np.tile(robot.q_reference, (2, 1)), atol=1e-9)
    assert np.isnan(found.carrier_force).all()
    assert np.isnan(found.margin).all()


def test_machines_differ_in_numbers() -> None:
    first = machine("3rrr")
    robots = [first, *(zoo.robot_of("3rrr", **MASSIVE["3rrr"], distal_length=length) for length in (0.95, 1.04))]
    given = states(first, 30, 0.1, seed=3)
    which = np.arange(30) % 3
    together = rp.GpuDynamics(robots, device="cpu").torque(**given, machine=which)
    for at, robot in enumerate(robots):
        alone = rp.GpuDynamics(robot, device="cpu").torque(**given)
        np.testing.assert_array_equal(together.tau[which == at], alone.tau[which == at])
        np.testing.assert_array_equal(together.status[which == at], alone.status[which == at])
    assert not np.allclose(together.tau[:3], alone.tau[:3])


def test_machines_have_their_own_wrenches_and_ranges_and_accelerations() -> None:
    robot = machine("3rrr")
    frame = robot.platform.frame if robot.platform else ""
    pulled = replace(robot, loads=(rp.Wrench(frame, [3.0, -2.0, 0.0, 0.0, 0.0, 0.5]),))
    other = replace(robot, loads=(rp.Wrench(frame, [-1.0, 4.0, 0.0, 0.0, 0.0, 0.2]),))
    narrow = rp.with_limits(other, lower=-1e-3, upper=1e-3)
    given, which = states(robot, 12, 0.1, seed=4), np.arange(12) % 2
    together = rp.GpuDynamics([pulled, narrow], device="cpu")
    found = together.torque(**given, machine=which)
    assert (found.status[which == 1] == SampleStatus.OUT_OF_RANGE).all()
    assert (found.status[which == 0] != SampleStatus.OUT_OF_RANGE).any()
    q = found.state[:, :-1].copy()
    q[:, robot.carrier_position] = given["s"]
    v = np.zeros((12, robot.model.nv))
    accelerations = together.acceleration(q, v, found.tau, found.carrier_force, machine=which)
    for at, one in enumerate((pulled, narrow)):
        alone = rp.GpuDynamics(one, device="cpu")
        mine = {name: part[which == at] for name, part in given.items()}
        np.testing.assert_array_equal(found.tau[which == at], alone.torque(**mine).tau)
        expected = alone.acceleration(q[which == at], 0.0, found.tau[which == at], found.carrier_force[which == at])
        np.testing.assert_array_equal(accelerations.a[which == at], expected.a)


def test_copies_and_pickles_give_the_same() -> None:
    dynamics, x = dynamics_of("3rrr"), states(machine("3rrr"), 3, 0.1, seed=6)
    wanted = dynamics.torque(**x).tau
    for other in (copy.deepcopy(dynamics), pickle.loads(pickle.dumps(dynamics))):
        np.testing.assert_array_equal(other.torque(**x).tau, wanted)


def test_arrays_of_any_layout_and_one_value_for_all() -> None:
    robot, dynamics = machine("3rrr"), dynamics_of("3rrr")
    given = states(robot, 9, 0.1, seed=5)
    plain = dynamics.torque(given["x"], given["xd"][0], 0.0, given["s"][0])
    spread = {name: np.tile(given[name][0], (9, 1)) for name in ("xd", "s")}
    twice = np.asfortranarray(np.repeat(given["x"], 2, axis=0))
    other = dynamics.torque(twice[::2], spread["xd"], np.zeros((9, 3)), spread["s"], 0.0, np.zeros(3))
    np.testing.assert_array_equal(other.tau, plain.tau)
    other = dynamics.torque(given["x"][::-1], spread["xd"].tolist(), 0, spread["s"])
    np.testing.assert_array_equal(other.tau[::-1], plain.tau)
    assert not plain.tau.flags.writeable
    poses = states(machine("gough"), 5, 0.1, seed=2)
    wanted = dynamics_of("gough").torque(**poses)
    turned = np.ascontiguousarray(poses["x"].transpose(1, 2, 0)).transpose(2, 0, 1)
    np.testing.assert_array_equal(dynamics_of("gough").torque(**poses | {"x": turned}).tau, wanted.tau)


@pytest.mark.parametrize("size", [1, 7, 64])
def test_blocks_change_nothing(monkeypatch: pytest.MonkeyPatch, size: int) -> None:
    given = states(machine("3rrr"), 20, 2.0, seed=9)
    wanted = dynamics_of("3rrr").torque(**given, equations=True)
    monkeypatch.setattr(gpu, "_BLOCK", size)
    found = dynamics_of("3rrr").torque(**given, equations=True)
    for part in (*PARTS, "state", "status", "W", "f"):
        np.testing.assert_array_equal(getattr(found, part), getattr(wanted, part))


def test_no_samples_are_no_error() -> None:
    found = dynamics_of("3rrr").torque(np.empty((0, 3)), 0.0, 0.0)
    assert found.tau.shape == (0, 3)
    assert found.status.shape == (0,)
    assert found.W is None


@pytest.mark.parametrize("name", ["3rrr", "delta", "gough"])
def test_accelerations_lead_back_to_the_motion(name: str) -> None:
    robot, dynamics = machine(name), dynamics_of(name)
    given = states(robot, 15, 0.15, seed=13)
    found = dynamics.torque(**given)
    compiled = rp.CompiledDynamics(robot)
    closed = []
    for k in range(15):  # of the closed tree at each sample: q, v, a
        x, xd, xdd = (given[part][k : k + 1] for part in ("x", "xd", "xdd"))
        motion = rp.PlatformMotion(np.zeros(1), x, xd, xdd, check_rates=False)
        tree = rp.inverse_kinematics(robot, motion)
        q, v, a = tree.q[0].copy(), tree.v[0].copy(), tree.a[0].copy()
        q[robot.carrier_position], v[robot.carrier_velocity] = given["s"][k], given["sd"][k]
        a[robot.carrier_velocity] = given["sdd"][k]
        closed.append((q, v, a))
    q, v, a = map(np.array, zip(*closed, strict=True))
    got = dynamics.acceleration(q, v, found.tau, found.carrier_force)
    assert (got.status == SampleStatus.OK).all()
    np.testing.assert_allclose(got.a, a, rtol=1e-6, atol=1e-6 * np.abs(a).max())
    for k in range(15):
        one = compiled.acceleration(q[k], v[k], found.tau[k], found.carrier_force[k])
        np.testing.assert_allclose(got.a[k], one.a, rtol=EQUAL, atol=EQUAL * np.abs(a).max())


def test_a_constant_wrench_acts_and_one_that_changes_is_refused() -> None:
    robot = machine("3rrr")
    frame = robot.platform.frame if robot.platform else ""
    pulled = replace(robot, loads=(*robot.loads, rp.Wrench(frame, [3.0, -2.0, 0.0, 0.0, 0.0, 0.5])))
    given = states(robot, 6, 0.1, seed=1)
    found = rp.GpuDynamics(pulled, device="cpu").torque(**given)
    rnea = rp.RneaDynamics(pulled)
    for k, row in enumerate(zip(*given.values(), strict=True)):
        np.testing.assert_allclose(found.tau[k], rnea.torque(*row).tau, rtol=INDEPENDENT, atol=INDEPENDENT)
    changing = replace(robot, loads=(rp.Wrench(frame, lambda t, x, xd: np.zeros((len(t), 6))),))
    with pytest.raises(UnsupportedRobotError, match="changes with time"):
        rp.GpuDynamics(changing, device="cpu")


@pytest.mark.parametrize(
    ("arguments", "settings"),
    [
        ((np.zeros((4, 2)), 0.0, 0.0), {}),
        ((np.zeros((4, 3)), np.zeros((3, 3)), 0.0), {}),
        ((np.zeros((4, 3)), 0.0, 0.0), {"start": np.zeros((4, 2))}),
        ((np.zeros((4, 3)), 0.0, 0.0), {"machine": [0, 0, 0, 1]}),
        ((np.zeros((4, 3)), 0.0, 0.0), {"machine": [0, 0]}),
        ((0.0, 0.0, 0.0), {}),
        ((np.zeros((4, 3)), "fast", 0.0), {}),
        ((np.zeros((4, 3)), None, 0.0), {}),
        ((np.zeros((4, 3)), 1j, 0.0), {}),
        ((np.zeros((4, 3)), 0.0, 0.0), {"machine": [0.5, 0.0, 0.0, 0.0]}),
        (([1.0, 0.4, 0.0], 0.0, 0.0), {}),
    ],
)
def test_wrong_arguments_are_one_clear_error(arguments: tuple[Any, ...], settings: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        dynamics_of("3rrr").torque(*arguments, **settings)


def test_robots_of_other_topologies_are_refused() -> None:
    with pytest.raises(InputError, match="different topologies"):
        rp.GpuDynamics([machine("3rrr"), machine("delta")], device="cpu")
    with pytest.raises(InputError, match="no robot"):
        rp.GpuDynamics([], device="cpu")
    with pytest.raises(InputError, match="device"):
        rp.GpuDynamics("3rrr", device="tpu")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="threads"):
        rp.GpuDynamics("3rrr", device="cpu", threads=512)


def test_without_a_gpu_or_cupy_the_error_says_what_to_do(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cupy", None)
    with pytest.raises(RedundancyPinError, match=r"redundancy_pin\[gpu\]"):
        rp.GpuDynamics("3rrr")
    none = ModuleType("cupy")
    none.cuda = ModuleType("cuda")  # type: ignore[attr-defined]
    none.cuda.runtime = ModuleType("runtime")
    none.cuda.runtime.CUDARuntimeError = OSError
    none.cuda.runtime.getDeviceCount = lambda: 0
    monkeypatch.setitem(sys.modules, "cupy", none)
    with pytest.raises(CompilerError, match="CompiledDynamics"):
        rp.GpuDynamics("3rrr")


def nvrtc() -> ctypes.CDLL | None:
    """Return the compiler, of the package nvidia-cuda-nvrtc-cu12 or of a system with CUDA; it needs no GPU."""
    spec = importlib.util.find_spec("nvidia")
    places = [Path(each) for each in (spec.submodule_search_locations or ())] if spec else []
    names = [str(file) for place in places for file in place.glob("cuda_nvrtc/lib/libnvrtc.so.*")]
    for name in (*names, "libnvrtc.so"):
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    return None


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar"])
@pytest.mark.parametrize("kind", [gpu._ManyEfforts, gpu._ManyAccelerations])
def test_nvrtc_compiles_the_text(name: str, kind: Any) -> None:
    library = nvrtc()
    if library is None:
        pytest.skip("NVRTC is not installed")
    program, text = ctypes.c_void_p(), gpu.gpu_source(kind.source(topology_of(machine(name)))).encode()
    assert not library.nvrtcCreateProgram(ctypes.byref(program), text, b"robot.cu", 0, None, None)
    # the options that cupy gives it
    options = [b"--gpu-architecture=compute_90", b"--device-as-default-execution-space", b"-std=c++17", b"-ftz=true"]
    failed = library.nvrtcCompileProgram(program, len(options), (ctypes.c_char_p * len(options))(*options))
    size = ctypes.c_size_t()
    library.nvrtcGetProgramLogSize(program, ctypes.byref(size))
    log = ctypes.create_string_buffer(size.value)
    library.nvrtcGetProgramLog(program, log)
    assert not failed, log.value.decode()[:2000]
