"""C for a controller against the RNEA backend and ``distribute``; that it compiles, and needs nothing but math.h."""

from __future__ import annotations

import ctypes
import itertools
import json
import re
import shutil
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
import zoo
from generated_c import COMPILERS, NOTHING_WRITTEN, Code, compiled, filled_with, folder_of, run
from machines import code_of, machine
from prescribed import factors, times
from scaled import Units, scaled_robot

import redundancy_pin as rp
from redundancy_pin import codegen
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import InputError, OutputError, RedundancyPinError
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.robot import Robot
from redundancy_pin.robot.types import WorkingModes
from redundancy_pin.status import SampleStatus

pytestmark = pytest.mark.skipif("gcc" not in COMPILERS, reason="gcc is not installed")

EQUAL = 1e-12
"""Relative to the largest value of a motion, as generated C was asked for; efforts times the condition number."""

SMALL = ("2rpr", "3rrr", "four_bar", "universal", "continuous", "more actuators", "fewer actuators")
LARGE = pytest.param("gough", marks=pytest.mark.long)
LONG = [pytest.param(name, marks=pytest.mark.long) for name in ("3rrr", "universal", "gough")]
"""What takes a compiler long under a sanitiser."""


@cache
def program_of(name: str, level: str = "-O2", compiler: str = "gcc") -> Path:
    folder = folder_of(machine(name))
    target = folder.parent / f"{compiler}{level}"
    return compiled([folder / "unit.c", folder / "test_unit.c"], target, level, compiler=compiler)


def assert_near(got: object, want: np.ndarray, what: str, factor: float = 1.0, scale: float | None = None) -> None:
    size = max(np.nanmax(np.abs(want), initial=0.0) if scale is None else scale, 1e-3)
    np.testing.assert_allclose(got, want, rtol=0.0, atol=EQUAL * size * factor, err_msg=what)


# --- the compiler's view -------------------------------------------------------------------------------------------


@pytest.mark.long_for(*(f"{name}-gcc" for name in SMALL if name != "2rpr"))
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("name", [*SMALL, LARGE])
def test_it_compiles_and_its_own_test_passes(name: str, compiler: str) -> None:
    for level in ("-O0", "-O2", "-O3") if name == "3rrr" else ("-O2",):
        done = run(program_of(name, level, compiler))
        assert done.returncode == 0, done.stdout
        assert done.stdout.startswith("0 failures")


@pytest.mark.long_for("fewer actuators", "more actuators")
@pytest.mark.parametrize("name", ["2rpr", "more actuators", "fewer actuators", *LONG])
def test_sanitisers_find_nothing(name: str, tmp_path: Path) -> None:
    folder = folder_of(machine(name))
    sources = [folder / "unit.c", folder / "test_unit.c"]
    # unoptimised: nothing is hidden, in a third of the time
    flags = ("-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
    done = run(compiled(sources, tmp_path / "program", *flags))
    assert done.returncode == 0, done.stdout + done.stderr
    assert done.stderr == ""


@pytest.mark.parametrize("units", [Units(1e-6, 1e-12), Units(1e6, 1e6)], ids=["small", "large"])
def test_its_own_test_knows_the_size_of_the_machine(units: Units, tmp_path: Path) -> None:
    folder = codegen.write_c(scaled_robot(machine("2rpr"), units), tmp_path / "code", prefix="unit").folder
    tests, text = compiled([folder / "test_unit.c"], tmp_path / "test.o", "-c"), (folder / "unit.c").read_text()
    for what in ("f", "tau", ""):
        wrong = f"  for (int i = 0; i < 1; ++i) efforts->{what}[i] *= 1.0 + 1e-9;\n" if what else ""
        (tmp_path / "unit.c").write_text(
            text.replace("  efforts->closure_residual = ", f"{wrong}  efforts->closure_residual = ")
        )
        done = run(compiled([tmp_path / "unit.c", tests], tmp_path / "program", f"-I{folder}"))
        assert f"{what} is" in done.stdout if what else done.returncode == 0, done.stdout


@pytest.mark.long
def test_its_own_test_can_fail(tmp_path: Path) -> None:
    folder = folder_of(machine("2rpr"))
    text = (folder / "unit.c").read_text(encoding="utf-8")
    broken = {
        "f": text.replace("copy(efforts->f, f, UNIT_OWN_N);", "copy(efforts->f, f, 2); efforts->f[1] *= 1.0 + 1e-9;"),
        "tau": text.replace("u[j] * UNIT_OWN_COLUMN_SCALE[j]", "u[j] * (1.0 + 1e-9)"),
        "carrier force": text.replace("copy(efforts->carrier_force, rest,", "copy(efforts->carrier_force, f,"),
        "xd": text.replace("xd[i] = result[i] / UNIT_OWN_ROW_SCALE[i]", "xd[i] = result[i] * 1.000001"),
        "closure Jacobian": text.replace("= K[i + j * UNIT_OWN_NP] *", "= -K[i + j * UNIT_OWN_NP] *"),
        "status of a bad input": re.sub(r"if \(!unit_own_finite\(in, .*?\)\) return UNIT_OWN_NOT_FINITE;", "", text),
        "a state that was written to": text.replace(
            "int closed = unit_own_rp_sample(UNIT_OWN_NUMBERS, from, in, out);",
            "int closed = unit_own_rp_sample(UNIT_OWN_NUMBERS, from, in, out); state->sign = 2.0;",
        ),
    }
    tests = compiled([folder / "test_unit.c"], tmp_path / "test_unit.o", "-c")
    for what, changed in broken.items():
        assert changed != text, what
        (tmp_path / "unit.c").write_text(changed)
        done = run(compiled([tmp_path / "unit.c", tests], tmp_path / "program", f"-I{folder}"))
        assert done.returncode == 1
        assert what in done.stdout, (what, done.stdout)


# --- the same as RNEA and distribute -------------------------------------------------------------------------------


def rows_of(motion: rp.PlatformMotion, carriers: rp.CarrierMotion, k: int) -> list[np.ndarray]:
    parts = (carriers.s, carriers.sd, carriers.sdd) if carriers.s.shape[1] else ()
    return [part[k] for part in (motion.x, motion.xd, motion.xdd, *parts)]


def assert_same(name: str, motion: rp.PlatformMotion, carriers: rp.CarrierMotion) -> list[int]:
    """Compare samples in order with the RNEA backend, each from the state before; return their statuses."""
    robot, code = machine(name), code_of(name)
    reduced = rp.RneaDynamics(robot).reduce(motion, carriers)
    want = rp.distribute(reduced)
    state, scale = code.start(), np.nanmax(np.abs(want.tau), initial=0.0)
    assert code.go_to(state, motion.x[0]) == 0
    for k in range(len(motion)):
        got = code.efforts(state, *rows_of(motion, carriers, k))
        if got.status == NOTHING_WRITTEN:  # farther away than a control cycle goes
            assert code.go_to(state, motion.x[k]) == 0
            got = code.efforts(state, *rows_of(motion, carriers, k))
        assert got.status == want.status[k], k
        assert_near(got.W.reshape(robot.n, robot.m), reduced.W[k], "W", scale=np.abs(reduced.W).max())
        assert_near(got.f, reduced.f[k], "f", scale=np.abs(reduced.f).max())
        if robot.k:
            force = reduced.carrier_force
            assert_near(got.carrier_force, force[k], "carrier force", scale=np.abs(force).max())
        condition = min(max(want.condition[k], 1.0), 1e9)
        assert_near(got.tau, want.tau[k], "tau", factor=condition, scale=scale)
        assert got.rank == want.rank[k]
        assert_near(got.margin, want.margin[k], "margin", scale=1.0)
        if np.isnan(want.tau[k]).any():
            largest = np.abs(reduced.f / reduced.row_scale).max()
            assert_near(got.residual, want.residual[k], "residual", scale=largest)
        assert got.closure_residual < 1e-11
    return want.status.tolist()


@pytest.mark.long_for("7-universal", "7-more actuators", "7-four_bar", "7-2rpr")
@pytest.mark.parametrize("name", [*SMALL, LARGE])
@pytest.mark.parametrize("seed", [pytest.param(0, marks=pytest.mark.long), 7])
def test_smooth_motions_and_their_samples_in_any_order(name: str, seed: int) -> None:
    robot, t = machine(name), np.linspace(0.0, 2.0, 60)
    motion, carriers = zoo.smooth_motion(robot, seed).at(t), zoo.carriers_at(robot, t, seed)
    assert_same(name, motion, carriers)
    if name in ("2rpr", "3rrr", "universal"):
        order = np.random.default_rng(2).permutation(len(t))
        shuffled = rp.PlatformMotion(t, *(part[order] for part in (motion.x, motion.xd, motion.xdd)))
        parts = (part[order] for part in (carriers.s, carriers.sd, carriers.sdd))
        assert_same(name, shuffled, rp.CarrierMotion(*parts))


def test_through_type_two() -> None:
    robot = machine("2rpr")
    motion = rp.trajectory.reference.circle().sample(dt=0.008)  # crosses the line of the base twice
    statuses = assert_same("2rpr", motion, zoo.carriers_at(robot, motion.t))
    assert {SampleStatus.OK, SampleStatus.NEAR_SINGULAR} <= set(statuses)
    still, moving = np.zeros(2), np.array([0.3, -0.7])
    for rate, acceleration in ((still, still), (moving, np.array([1.0, 2.0]))):  # on the line itself
        at = rp.PlatformMotion([0.0], [[0.2, 0.0]], rate[None], acceleration[None])
        assert assert_same("2rpr", at, rp.CarrierMotion.parked(1, 2)) == [SampleStatus.SINGULAR_INCONSISTENT]


PROBE = """
#include "unit.c"
int probe(const double *W, const double *f, unit_efforts *out);
int probe(const double *W, const double *f, unit_efforts *out) {
  unit_own_Efforts found = {{0.0}, 0.0, 0.0, 0.0, 0};
  int status = unit_own_distribute(UNIT_OWN_NUMBERS, W, f, 1.0, &found);
  for (int j = 0; j < UNIT_M; ++j) out->tau[j] = found.tau[j];
  out->residual = found.residual, out->margin = found.margin, out->condition = found.condition, out->rank = found.rank;
  return status;
}
"""


@pytest.mark.long_for("3rrr", "more actuators")
@pytest.mark.parametrize("name", ["2rpr", "3rrr", LARGE, "more actuators", "fewer actuators"])
def test_every_rank_is_distributed_as_by_distribute(name: str, tmp_path: Path) -> None:
    robot, random = machine(name), np.random.default_rng(3)
    folder = folder_of(robot)
    (tmp_path / "probe.c").write_text(PROBE)
    library = ctypes.CDLL(
        str(compiled([tmp_path / "probe.c"], tmp_path / "probe.so", f"-I{folder}", "-O1", "-shared", "-fPIC"))
    )
    n, m, count, seen = robot.n, robot.m, 6, set()
    home = zoo.home_of(robot)[None]
    scales = rp.RneaDynamics(robot).reduce(rp.PlatformMotion([0.0], home, np.zeros((1, n)), np.zeros((1, n))))
    cases = itertools.product(range(min(n, m) + 1), (0.0, 1e-8, 1.0), (1.0, 1e-3, 1e-7), (1.0, 1e-11))
    for rank, off, least, size in cases:
        values = np.where(np.arange(min(n, m)) < rank, np.geomspace(least, 2.0, min(n, m))[::-1], 0.0)
        U, A, _ = factors(random, count, n, m, size * values)
        W = A * scales.row_scale[:, None] / scales.column_scale
        g = times(A, random.normal(size=(count, m)) / size) + off * times(U, random.normal(size=(count, n)))
        nothing = np.zeros((count, 0))
        power = np.resize([0, 700, -700], count)  # of two: forces whose squares no double holds, and small ones
        f = np.ldexp(g * scales.row_scale, power[:, None])
        reduced = ReducedDynamics(
            np.arange(count, dtype=float), f, W, nothing, np.ones(count, dtype=bool),
            np.zeros(count), scales.row_scale, scales.column_scale, force_size=np.ones(count),
        )  # fmt: skip
        want = rp.distribute(reduced)
        seen |= set(want.status.tolist())
        for k in range(count):
            out = code_of(name).efforts_type()
            row, force = np.ascontiguousarray(W[k]), np.ascontiguousarray(reduced.f[k])
            pointers = [ctypes.c_void_p(array.ctypes.data) for array in (row, force)]
            status = library.probe(*pointers, ctypes.byref(out))
            assert status == want.status[k]
            assert out.rank == want.rank[k]
            condition = min(want.condition[k], 1e9)
            got, wanted = (np.ldexp(values, -power[k]) for values in (np.array(out.tau), want.tau[k]))
            assert_near(got, wanted, "tau", factor=condition)
            np.testing.assert_allclose(out.margin, want.margin[k], rtol=0.0, atol=1e-14)
            if status >= SampleStatus.SINGULAR_INCONSISTENT:
                # the range of a matrix moves by rounding over its least singular value
                allowed = 1e-14 / least * np.linalg.norm(g[k])
                left, wanted = np.ldexp([out.residual, want.residual[k]], -power[k])
                np.testing.assert_allclose(left, wanted, rtol=0.0, atol=allowed)
    expected = {SampleStatus.OK, SampleStatus.NEAR_SINGULAR, SampleStatus.SINGULAR_CONSISTENT}
    if n > m:
        expected |= {SampleStatus.UNDERACTUATED}
    assert expected | {SampleStatus.SINGULAR_INCONSISTENT} <= seen


# --- forward kinematics ---------------------------------------------------------------------------------------------


def drives_along(robot: Robot, motion: rp.PlatformMotion) -> tuple[np.ndarray, np.ndarray]:
    """Positions and rates of the actuators, from the lifted tree."""
    tree, model = rp.inverse_kinematics(robot, motion), robot.model
    joints = [model.joints[model.getJointId(name)] for name in robot.actuated]
    columns = [
        tree.q[:, joint.idx_q] if joint.nq == 1 else np.arctan2(tree.q[:, joint.idx_q + 1], tree.q[:, joint.idx_q])
        for joint in joints
    ]
    return np.stack(columns, axis=1), tree.v[:, robot.actuated_velocity]


@pytest.mark.long_for("universal", "four_bar")
@pytest.mark.parametrize("name", [*(name for name in SMALL if name != "fewer actuators"), LARGE])
def test_the_platform_follows_from_its_actuators(name: str) -> None:
    robot, code, t = machine(name), code_of(name), np.linspace(0.0, 2.0, 75)
    motion = zoo.smooth_motion(robot, 4).at(t)
    positions, velocities = drives_along(robot, motion)
    condition = rp.distribute(rp.RneaDynamics(robot).reduce(motion)).condition
    state = code.start()
    assert code.go_to(state, motion.x[0]) == 0
    for k in range(len(t)):
        got = code.platform(state, positions[k], velocities[k])
        assert got.status in (SampleStatus.OK, SampleStatus.NEAR_SINGULAR)
        assert_near(got.x, motion.x[k].ravel(), "x", factor=condition[k], scale=np.abs(motion.x).max())
        assert_near(got.xd, motion.xd[k], "xd", factor=condition[k], scale=np.abs(motion.xd).max())
        assert got.mismatch < 1e-11


def test_the_branch_is_that_of_the_state() -> None:
    """The end-effector of a 2-RPR lies above or below its base for the same legs."""
    code = code_of("2rpr")
    motion = rp.PlatformMotion([0.0], [[0.25, 0.2]], [[0.1, 0.3]], [[0.0, 0.0]])
    positions, velocities = drives_along(machine("2rpr"), motion)
    for side in (1.0, -1.0):
        state = code.start()
        assert code.go_to(state, np.array([0.24, 0.19 * side])) == 0
        got = code.platform(state, positions[0], velocities[0])
        np.testing.assert_allclose(got.x, [0.25, 0.2 * side], rtol=0.0, atol=1e-11)
        np.testing.assert_allclose(got.xd, [0.1, 0.3 * side], rtol=0.0, atol=1e-11)


def test_at_type_two_actuators_do_not_determine_the_platform() -> None:
    code, still = code_of("2rpr"), np.zeros((1, 2))
    at = rp.PlatformMotion([0.0], [[0.2, 0.0]], still, still)
    state = code.start()
    assert code.go_to(state, at.x[0]) == 0
    kept, untouched = bytes(state), bytes(filled_with(code.platform_type, 7.0))
    got = code.platform(state, drives_along(machine("2rpr"), at)[0][0], np.zeros(2))
    assert (got.status, got.raw, bytes(state)) == (SampleStatus.TYPE_II, untouched, kept)
    assert code.at("margins", state).rank == 1


def test_more_actuators_than_freedoms_take_the_nearest_pose() -> None:
    robot, code = machine("more actuators"), code_of("more actuators")
    motion = rp.PlatformMotion([0.0], zoo.home_of(robot)[None], [[0.5]], [[0.0]])
    positions, velocities = drives_along(robot, motion)
    off = np.array([2e-3, -1e-3])
    got = code.platform(state := code.start(), positions[0] + off, velocities[0])
    assert got.status == 0
    there = rp.PlatformMotion([0.0], got.x[None], [[0.0]], [[0.0]])
    missed = positions[0] + off - drives_along(robot, there)[0][0]
    W = rp.RneaDynamics(robot).reduce(there).W[0]
    assert np.abs(W @ missed).max() < 1e-9  # no other pose misses less; torques count alike here
    np.testing.assert_allclose(got.mismatch, robot.characteristic_length * np.linalg.norm(missed), rtol=1e-6)
    assert got.mismatch > 1e-5
    assert code.at("margins", state).rank == 1


# --- Jacobians and margins ------------------------------------------------------------------------------------------


@pytest.mark.long_for("universal", "four_bar")
@pytest.mark.parametrize("name", [*SMALL, LARGE])
def test_jacobians_and_margins(name: str) -> None:
    robot, code, t = machine(name), code_of(name), np.linspace(0.0, 2.0, 20)
    motion = zoo.smooth_motion(robot, 9).at(t)
    tree = rp.inverse_kinematics(robot, motion)
    want, efforts = ConstraintSystem(robot).evaluate(tree.q).Jc, rp.distribute(rp.RneaDynamics(robot).reduce(motion))
    state, nv = code.start(), robot.model.nv
    for k in range(len(t)):
        assert code.go_to(state, motion.x[k]) == 0
        got, margins = code.at("jacobians", state), code.at("margins", state)
        assert got.status == margins.status == 0
        gamma = got.gamma.reshape(nv, robot.n)
        assert_near(gamma, tree.gamma[k], "gamma")
        assert_near(got.W.reshape(robot.n, robot.m), tree.gamma[k][robot.actuated_velocity].T, "W")
        closure = got.closure.reshape(-1, nv)
        assert_near(closure, want[k], "closure")
        assert np.abs(closure @ gamma).max() < 1e-12
        assert_near(margins.type_I, tree.serial_margin_bound[k], "type I", scale=1.0)
        assert_near(margins.type_II, efforts.margin[k], "type II", scale=1.0)
        np.testing.assert_allclose(margins.condition, efforts.condition[k], rtol=1e-10)


# --- what cannot be --------------------------------------------------------------------------------------------------


@pytest.mark.long_for("universal")
@pytest.mark.parametrize("name", ["2rpr", "3rrr", "universal"])
def test_bad_input_gets_a_status_and_nothing_is_written(name: str) -> None:
    robot, code = machine(name), code_of(name)
    n, k = robot.n, robot.k
    good = [zoo.home_of(robot), np.ones(n), np.ones(n), *([np.zeros(k)] * 3 if k else [])]
    untouched, state = bytes(filled_with(code.efforts_type, 7.0)), code.start()
    kept = bytes(state)
    for i, part in enumerate(good):
        for bad in (np.nan, np.inf, -np.inf):
            given = [each.copy() for each in good]
            given[i].flat[part.size - 1] = bad
            got = code.efforts(state, *given)
            assert got.status >= NOTHING_WRITTEN, (i, bad)
            assert (got.raw, bytes(state)) == (untouched, kept)
    state.q[0] = np.nan
    assert code.efforts(state, *good).status == SampleStatus.NOT_FINITE
    assert code.at("margins", state).status == SampleStatus.NOT_FINITE
    assert code.go_to(state, good[0]) == SampleStatus.NOT_FINITE


def test_out_of_reach_and_type_one() -> None:
    code = code_of("3rrr")
    still = [np.zeros(3)] * 5
    state = code.start()
    kept = bytes(state)
    assert code.efforts(state, np.array([9.0, 0.5, 0.0]), *still).status == SampleStatus.UNREACHABLE
    assert code.go_to(state, np.array([2.9, 0.5, 0.0])) == SampleStatus.UNREACHABLE
    assert bytes(state) == kept
    two = code_of("2rpr")
    state = two.start()
    assert two.go_to(state, np.array([1e-3, 0.0])) == 0
    no_leg = two.efforts(state, np.array([1e-8, 0.0]), *[np.zeros(2)] * 5)
    assert no_leg.status in (SampleStatus.UNREACHABLE, SampleStatus.TYPE_I)


def test_a_state_knows_its_side_of_type_one() -> None:
    code, home = code_of("3rrr"), zoo.home_of(machine("3rrr"))
    state = code.start()
    side = state.sign
    assert abs(side) == 1.0
    assert code.efforts(state, home, *[np.zeros(3)] * 5).status < NOTHING_WRITTEN
    assert state.sign == side
    state.sign = -side
    kept = bytes(state)
    assert code.efforts(state, home, *[np.zeros(3)] * 5).status == SampleStatus.UNREACHABLE
    assert code.go_to(state, home) == SampleStatus.UNREACHABLE
    assert code.at("margins", state).status == code.at("jacobians", state).status == SampleStatus.UNREACHABLE
    assert bytes(state) == kept


def test_statuses_of_the_header_are_those_of_the_package(tmp_path: Path) -> None:
    """By name and number: a controller's log reads as a plan does."""
    rp.write_c(zoo.robot_of("2rpr"), tmp_path / "code", prefix="leg")
    header = (tmp_path / "code" / "leg.h").read_text(encoding="utf-8")
    listed = {name: int(number) for name, number in re.findall(r"^  LEG_([A-Z_]+) = (\d+),?", header, re.MULTILINE)}
    assert len(listed) == 10
    assert listed.items() <= {status.name: int(status) for status in SampleStatus}.items()


def test_another_working_mode_has_a_status_of_its_own() -> None:
    """A mode read off the crank changes where nothing is singular, so that its own check is what notices."""
    robot = machine("four_bar")
    crank = replace(robot, working_modes=WorkingModes(("crank",), (1,)), working_mode=(1,))
    code, still = Code(crank), np.zeros((1, 1))
    assert np.sin(zoo.home_of(robot)[0]) > 0.0
    state = code.start()
    assert code.go_to(state, np.array([0.01])) == 0
    kept = bytes(state)
    beyond = rp.PlatformMotion([0.0], [[-0.01]], still, still)
    assert code.efforts(state, beyond.x[0], still[0], still[0]).status == SampleStatus.BRANCH_LOST
    assert code.go_to(state, beyond.x[0]) == SampleStatus.BRANCH_LOST
    assert code.platform(state, drives_along(robot, beyond)[0][0], still[0]).status == SampleStatus.BRANCH_LOST
    assert bytes(state) == kept


def test_each_state_is_its_own() -> None:
    robot, code, t = machine("3rrr"), code_of("3rrr"), np.linspace(0.0, 1.0, 100)
    motions = [zoo.smooth_motion(robot, seed).at(t) for seed in range(4)]

    def work(motion: rp.PlatformMotion) -> np.ndarray:
        state, parked = code.start(), [np.zeros(3)] * 3
        code.go_to(state, motion.x[0])
        samples = zip(motion.x, motion.xd, motion.xdd, strict=True)
        return np.array([code.efforts(state, *sample, *parked).f for sample in samples])

    with ThreadPoolExecutor(len(motions)) as pool:
        for got, motion in zip(pool.map(work, motions), motions, strict=True):
            assert_near(got, rp.RneaDynamics(robot).reduce(motion).f, "f")


# --- files -----------------------------------------------------------------------------------------------------------


def test_names_from_a_file_cannot_leave_their_comments(tmp_path: Path) -> None:
    odd = 'x */ int y = "; /* ??/\n\\ é'
    robot = machine("four_bar")
    robot = replace(
        robot,
        name=odd,
        closures=tuple(replace(closure, name=odd) for closure in robot.closures),
        parameters={**robot.parameters, odd: odd},
    )
    written = codegen.write_c(robot, tmp_path / "code")
    assert re.fullmatch(r"[a-z][a-z0-9_]*", written.prefix)
    sources = [tmp_path / "code" / f"{stem}{written.prefix}.c" for stem in ("", "test_")]
    assert run(compiled(sources, tmp_path / "program")).returncode == 0


PREFIXES = {"rp": "rp", "2rpr": "robot_2rpr", "…": "robot", "3-RRR (new)": "robot_3_rrr_new", "Math": "robot_math"}


@pytest.mark.parametrize(("name", "prefix"), [*PREFIXES.items(), ("m", "robot_m")])
def test_prefixes(name: str, prefix: str) -> None:
    assert codegen.prefix_of(name, None) == prefix


@pytest.mark.parametrize("prefix", ["rp", "status", "check", "Unit", "robot"])
def test_prefixes_that_name_something_in_the_code(prefix: str, tmp_path: Path) -> None:
    """The generated functions rp_drives, an enumerator STATUS_OK, and check_jacobians of the test program."""
    codegen.write_c(machine("four_bar"), tmp_path / "code", prefix=prefix)
    for stem in ("", "test_"):
        compiled([tmp_path / "code" / f"{stem}{prefix}.c"], tmp_path / "code.o", "-fsyntax-only")


@pytest.mark.parametrize("prefix", ["", "2rpr", "a-b", "é", "x" * 41, "a\n", "a__b", "a_", "math", "TEST"])
def test_prefixes_that_are_no_names(prefix: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="prefix"):
        codegen.write_c(machine("four_bar"), tmp_path / "code", prefix=prefix)
    assert not (tmp_path / "code").exists()


def test_a_folder_is_replaced_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    robot, folder = machine("four_bar"), tmp_path / "code"
    codegen.write_c(robot, folder, prefix="first")
    written = codegen.write_c(robot, folder, prefix="second")
    assert {path.name for path in folder.iterdir()} == set(written.files)
    assert set(json.loads((folder / "summary.json").read_text())["files"]) == set(written.files) - {"summary.json"}
    assert not any("first" in name for name in written.files)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(codegen, "write_text", full)
    with pytest.raises(OSError, match="No space"):
        codegen.write_c(robot, folder, prefix="third")
    monkeypatch.undo()
    assert {path.name for path in folder.iterdir()} == set(written.files)
    assert [path.name for path in tmp_path.iterdir()] == ["code"]
    (folder / "mine.txt").touch()
    with pytest.raises(OutputError, match=r"mine\.txt"):
        codegen.write_c(robot, folder)


def test_joints_beyond_their_ranges_have_efforts(tmp_path: Path) -> None:
    robot, t = rp.with_limits(machine("four_bar"), {"crank": {"upper": 1.1}}), np.linspace(0.0, 1.0, 20)[:, None]
    motion = rp.PlatformMotion(t[:, 0], 1.0 + 0.2 * np.sin(6.0 * t), 1.2 * np.cos(6.0 * t), -7.2 * np.sin(6.0 * t))
    assert 0 < rp.RneaDynamics(robot).reduce(motion).out_of_range.sum() < len(t)
    codegen.write_c(robot, tmp_path / "code", prefix="bar", motion=motion)
    done = run(compiled([tmp_path / "code" / f"{stem}bar.c" for stem in ("", "test_")], tmp_path / "program"))
    assert done.stdout.startswith("0 failures"), done.stdout


@pytest.mark.long
def test_a_motion_of_ones_own(tmp_path: Path) -> None:
    robot = machine("2rpr")
    motion = rp.trajectory.reference.circle().sample(dt=0.01)
    written = codegen.write_c(robot, tmp_path / "code", motion=motion, prefix="circle")
    assert written.samples == min(200, len(motion))
    program = compiled([tmp_path / "code" / f"{stem}circle.c" for stem in ("", "test_")], tmp_path / "program")
    assert run(program).stdout.startswith("0 failures")
    with pytest.raises(InputError):
        codegen.write_c(robot, tmp_path / "other", motion=zoo.smooth_motion(machine("3rrr")).at(np.zeros(1)))
    with pytest.raises(InputError, match="without a motion"):
        codegen.write_c(robot, tmp_path / "other", carriers=rp.CarrierMotion.parked(3, 2))
    away = rp.PlatformMotion([0.0], [[0.0, 0.0]], [[0.0, 0.0]], [[0.0, 0.0]])  # a leg of no length
    with pytest.raises(RedundancyPinError):
        codegen.write_c(robot, tmp_path / "other", motion=away)
    assert not (tmp_path / "other").exists()


@pytest.mark.long
def test_times_are_printed(tmp_path: Path) -> None:
    folder = folder_of(machine("2rpr"))
    program = compiled([folder / "unit.c", folder / "test_unit.c"], tmp_path / "program", "-O2")
    done = run(program, "--time", "200")
    assert done.returncode == 0
    assert done.stdout.startswith("200 random samples; inverse dynamics wrote 200")
    match = re.findall(r"median ([\d.]+) us, 99\.9 % ([\d.]+) us, worst ([\d.]+) us", done.stdout)
    assert len(match) == 4
    assert run(program, "--time").returncode == 2


@pytest.mark.long
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not installed")
@pytest.mark.parametrize("name", ["2rpr", "fewer actuators", *LONG])
def test_valgrind_finds_nothing(name: str) -> None:
    done = run(Path("valgrind"), "-q", "--error-exitcode=9", "--leak-check=full", str(program_of(name)))
    assert done.returncode == 0, done.stderr


@pytest.mark.long
def test_from_far_away_it_is_that_branch_or_none() -> None:
    """Newton's method without its rule of contraction ends below the base here and there."""
    code, random, statuses = code_of("2rpr"), np.random.default_rng(0), []
    x = np.stack([random.uniform(-0.2, 0.7, 200), random.uniform(0.02, 0.5, 200)], axis=1)
    still = np.zeros((1, 2))
    for start, end in zip(x[::2], x[1::2], strict=True):
        positions, _ = drives_along(machine("2rpr"), rp.PlatformMotion([0.0], end[None], still, still))
        state = code.start()
        assert code.go_to(state, start) == 0
        kept = bytes(state)
        got = code.platform(state, positions[0], np.zeros(2))
        statuses.append(got.status)
        if got.status == NOTHING_WRITTEN:
            assert bytes(state) == kept
        else:
            np.testing.assert_allclose(got.x, end, rtol=0.0, atol=1e-9)
    assert 10 < statuses.count(NOTHING_WRITTEN) < 90
