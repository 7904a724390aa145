"""Generated C in other people's programs: any dialect, any names beside it, any size of numbers, any stack."""

from __future__ import annotations

import ctypes
import re
import resource
import shlex
import shutil
import subprocess
from collections.abc import Sequence
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
import spatial_chains
import stack
import zoo
from flat_linkages import row_of_four_bars
from generated_c import ACTUATED, COMPILERS, NOTHING_WRITTEN, Code, compiled, filled_with, folder_of, run

import redundancy_pin as rp
from redundancy_pin.errors import CompilerError
from redundancy_pin.machine_code import CACHE, find_compiler
from redundancy_pin.robot import Robot
from redundancy_pin.robot.shipped import shipped_robots
from redundancy_pin.status import SampleStatus

pytestmark = pytest.mark.skipif("gcc" not in COMPILERS, reason="gcc is not installed")

WARNINGS = ("-Wall", "-Wextra", "-Wpedantic", "-Wshadow", "-Wconversion", "-Wundef", "-Wcast-qual", "-Wwrite-strings")
C_ONLY = ("-Wstrict-prototypes", "-Wmissing-prototypes")
DIALECTS = ("", "-std=c99", "-std=gnu99", "-std=c11", "-std=gnu17", "-std=c2x")
"""The first is the compiler's own: gcc's has names in math.h that -std=c99 has not."""
CPP = ("-std=c++11", "-std=c++17")
CPP_OF = {"gcc": "g++", "clang": "clang++"}

ROBOTS = ("2rpr", "more actuators", "fewer actuators", *(name for name in shipped_robots() if name != "2rpr"))


LONG = partial(pytest.param, marks=pytest.mark.long)


@cache
def robot_of(name: str) -> Robot:
    if name in ACTUATED:
        driven, *joints = ACTUATED[name]
        return zoo.driven_by(zoo.robot_of(driven), *joints)
    if name in spatial_chains.CHAINS:
        return spatial_chains.chain_of(name)
    return row_of_four_bars(40) if name == "40 loops" else zoo.robot_of(name)


@cache
def code_of(name: str) -> Code:
    return Code(robot_of(name))


def checked(sources: Sequence[Path], *flags: str, compiler: str = "gcc") -> subprocess.CompletedProcess[str]:
    """Let a compiler read sources, every warning an error."""
    command = [compiler, "-fsyntax-only", "-Werror", *WARNINGS, *filter(None, flags), *map(str, sources)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def example_of(folder: Path, target: Path) -> Path:
    """Write the example of a folder's README into a file."""
    (text,) = re.findall(r"^```c\n(.*?)^```", (folder / "README.md").read_text(encoding="utf-8"), flags=re.M | re.S)
    target.write_text(text, encoding="utf-8")
    return target


# --- dialects --------------------------------------------------------------------------------------------------------


@pytest.mark.long_for(*(f"{name}-gcc" for name in ROBOTS if name != "2rpr"))
@pytest.mark.parametrize("compiler", COMPILERS)
@pytest.mark.parametrize("name", ROBOTS)
def test_every_dialect_takes_it_without_a_warning(name: str, compiler: str, tmp_path: Path) -> None:
    folder = folder_of(robot_of(name))
    sources = [folder / "unit.c", folder / "test_unit.c", example_of(folder, tmp_path / "example.c")]
    for dialect in DIALECTS:
        done = checked(sources, dialect, *C_ONLY, f"-I{folder}", compiler=compiler)
        assert done.returncode == 0, (dialect, done.stderr)
    if shutil.which(CPP_OF[compiler]):
        for dialect in CPP:
            done = checked(sources, "-xc++", dialect, f"-I{folder}", compiler=CPP_OF[compiler])
            assert done.returncode == 0, (dialect, done.stderr)


@pytest.mark.skipif(shutil.which("g++") is None, reason="g++ is not installed")
def test_a_program_in_cpp_calls_what_is_compiled_as_c(tmp_path: Path) -> None:
    folder = folder_of(robot_of("2rpr"))
    example = example_of(folder, tmp_path / "example.c")
    built = ["gcc", "-c", "-O0", str(folder / "unit.c"), "-o", str(tmp_path / "unit.o")]
    files = ["-xc++", str(example), "-xnone", str(tmp_path / "unit.o"), "-o", str(tmp_path / "a")]
    linked = ["g++", f"-I{folder}", *files]
    for command in (built, linked):
        subprocess.run(command, check=True)
    assert run(tmp_path / "a").stdout.startswith("tau[0] = ")


def test_the_example_of_the_readme_runs_as_the_readme_compiles_it(tmp_path: Path) -> None:
    """Its efforts hold the machine at the reference; those of RNEA are what they are compared with."""
    robot, folder = robot_of("four_bar"), tmp_path / "code"
    shutil.copytree(folder_of(robot), folder)
    example_of(folder, tmp_path / "example.c")
    text = (folder / "README.md").read_text(encoding="utf-8")
    commands = [shlex.split(line, comments=True) for line in text.splitlines() if line.startswith("cc ")]
    assert len(commands) == 2
    for command in commands:
        subprocess.run(command, cwd=folder, check=True)
    assert run(tmp_path / "test_unit").stdout.startswith("0 failures")
    still = np.zeros((1, robot.n))
    home = rp.PlatformMotion([0.0], zoo.home_of(robot)[None], still, still)
    held = rp.distribute(rp.RneaDynamics(robot).reduce(home))
    told = re.findall(r"^tau\[\d+\] = (\S+)$", run(tmp_path / "example").stdout, flags=re.M)
    np.testing.assert_allclose([float(value) for value in told], held.tau[0], rtol=1e-5)  # printed with six digits


# --- names -----------------------------------------------------------------------------------------------------------

POISON = """finite rows rates move copy clear forward back near largest solve newton follow distribute rotate dot Pose
N M R NX NV NQ NP NK NT SHORT LONG SWEEPS TOLERANCE FLOOR LOST CLOSED SINGULAR COLUMNS WEIGHT EXPORTED REFERENCE"""
"""Names that libraries have, or that stood in the code bare."""

HEADERS = "complex ctype errno fenv float inttypes limits locale setjmp signal stdio stdlib string time unistd"


def defined(text: str, *flags: str) -> set[str]:
    """Return the macros that are defined after a text."""
    command = ["gcc", "-dM", "-E", "-xc", *flags, "-"]
    told = subprocess.run(command, input=text, capture_output=True, text=True, check=True).stdout
    return {line.split()[1].partition("(")[0] for line in told.splitlines()}


MATH = re.findall(
    r"\w+", "sin cos sincos tan atan2 atan acos asin sqrt hypot fabs floor round trunc copysign fmax fmin frexp ldexp"
)
"""All that the code may call."""


@pytest.mark.skipif(shutil.which("nm") is None, reason="nm is not installed")
@pytest.mark.long_for("more actuators", "3rrr", "universal")
@pytest.mark.parametrize("name", ["2rpr", "more actuators", "fewer actuators", "3rrr", "universal"])
def test_it_needs_math_alone_keeps_no_state_and_every_name_begins_with_the_prefix(name: str, tmp_path: Path) -> None:
    folder = folder_of(robot_of(name))
    header, text = ((folder / file).read_text(encoding="utf-8") for file in ("unit.h", "unit.c"))
    assert sorted(re.findall(r"^\s*#\s*include\s*(\S+)", text + header, flags=re.M)) == ['"unit.h"', "<math.h>"]
    for level in ("-O0", "-O2"):
        target = compiled([folder / "unit.c"], tmp_path / "unit.o", level, "-c")
        listed = subprocess.run(["nm", str(target)], capture_output=True, text=True, check=True).stdout
        symbols = [tuple(line.split()[-2:]) for line in listed.splitlines()]
        assert {kind for kind, _ in symbols} <= {"U", "T", "t", "r"}  # no b, d: nothing static that changes
        assert {symbol for kind, symbol in symbols if kind == "U"} <= set(MATH)
        public = {symbol for kind, symbol in symbols if kind == "T"}
        assert public == set(re.findall(r"^int (unit_\w+)\(", header, flags=re.M))
        assert ("unit_forward_kinematics" in public) is (name != "fewer actuators")
        inside = {symbol for kind, symbol in symbols if kind in "tr" and "." not in symbol}  # a dot: of a function
        assert inside == {symbol for symbol in inside if re.match(r"(unit_own|UNIT_OWN)_", symbol)}
    shown = defined(header) - defined("")
    assert {"UNIT_H", "UNIT_N", "UNIT_STACK_BYTES"} <= shown
    assert all(macro.startswith("UNIT_") for macro in shown)
    own, asked = "math", "math stddef stdio stdlib string time"
    for source, used, first in (("unit.c", own, ""), ("test_unit.c", asked, "#define _POSIX_C_SOURCE 199309L\n")):
        beside = defined(first + "".join(f"#include <{each}.h>\n" for each in used.split()))
        left = defined((folder / source).read_text(encoding="utf-8"), f"-I{folder}") - beside
        assert {macro for macro in left if not macro.startswith("UNIT_")} == set()


@pytest.mark.parametrize("dialect", ["-std=gnu17", "-std=c++17"])
def test_robots_are_compiled_as_one_file_amid_names_of_others(dialect: str, tmp_path: Path) -> None:
    if "++" in dialect and shutil.which("g++") is None:
        pytest.skip("g++ is not installed")
    names = ("2rpr", "more actuators", "fewer actuators")
    headers = "" if "++" in dialect else "".join(f"#include <{each}.h>\n" for each in HEADERS.split())
    parts = [f"#include <math.h>\n{headers}#pragma GCC poison {' '.join(POISON.split())}\n"]
    for i, name in enumerate(names):
        rp.codegen.write_c(robot_of(name), tmp_path / f"r{i}", prefix=f"r{i}")
        parts.append(f'#include "r{i}/r{i}.c"\n')
    (tmp_path / "all.c").write_text("".join(parts), encoding="utf-8")
    language = ("-xc++",) if "++" in dialect else ()
    done = checked([tmp_path / "all.c"], *language, dialect, f"-I{tmp_path}")
    assert done.returncode == 0, done.stderr


# --- compilers that assume finite numbers ----------------------------------------------------------------------------


@pytest.mark.parametrize("flag", ["-ffast-math", "-Ofast", "-ffinite-math-only"])
def test_finite_math_is_refused(flag: str) -> None:
    folder = folder_of(robot_of("fewer actuators"))
    for dialect in ("-std=c99", "-std=gnu17"):
        done = checked([folder / "unit.c"], dialect, flag)
        assert done.returncode != 0
        assert "#error" in done.stderr
        assert "The statuses need NaN and infinity" in done.stderr


def test_the_package_does_not_compile_its_own_with_finite_math(monkeypatch: pytest.MonkeyPatch) -> None:
    compiler = find_compiler()
    assert compiler is not None
    monkeypatch.setenv("CC", shlex.join([*compiler.command, "-ffast-math"]))
    monkeypatch.setenv(CACHE, "")
    with pytest.raises(CompilerError, match="statuses need NaN and infinity"):
        rp.CompiledDynamics(robot_of("four_bar"))


# --- numbers of any size ---------------------------------------------------------------------------------------------

POWERS = (-1000, -700, -401, -60, 0, 60, 401, 520, 700, 1000)
"""Of two. Squares leave the range of doubles from 2^±512 on."""


def times_power(values: np.ndarray, power: int) -> np.ndarray:
    return np.asarray(np.ldexp(values, power))


@pytest.mark.parametrize("at", [(0.2, 0.3), (0.2, 0.005)])
def test_efforts_are_as_many_times_as_large_as_accelerations(at: tuple[float, float]) -> None:
    """At rest and without gravity f and the efforts are linear in the acceleration, and powers of two round nothing."""
    code, still, acceleration = code_of("2rpr"), np.zeros(2), np.array([0.7, -1.3])
    state = code.start()
    assert code.go_to(state, np.array(at)) == 0
    one = code.efforts(state, np.array(at), still, acceleration, *[still] * 3)
    assert one.status == (SampleStatus.OK if at[1] > 0.1 else SampleStatus.NEAR_SINGULAR)
    for power in POWERS:
        got = code.efforts(state, np.array(at), still, times_power(acceleration, power), *[still] * 3)
        assert (got.status, got.rank, got.margin) == (one.status, one.rank, one.margin), power
        for name in ("f", "tau", "carrier_force"):
            np.testing.assert_array_equal(getattr(got, name), times_power(getattr(one, name), power), err_msg=name)
        assert got.residual <= 1e-13 * np.abs(got.f).max()
    kept = bytes(state)
    nothing = bytes(filled_with(code.efforts_type, 7.0))
    for power in range(1001, 1024):  # up to where no double holds the efforts
        got = code.efforts(state, np.array(at), still, times_power(acceleration, power), *[still] * 3)
        if got.status == one.status:
            np.testing.assert_array_equal(got.tau, times_power(one.tau, power))
        else:
            assert (got.status, got.raw, bytes(state)) == (SampleStatus.NOT_FINITE, nothing, kept)
    assert got.status == SampleStatus.NOT_FINITE


def test_what_no_efforts_balance_is_as_many_times_as_large() -> None:
    code, still, on_the_line = code_of("2rpr"), np.zeros(2), np.array([0.2, 0.0])
    state = code.start()
    assert code.go_to(state, on_the_line) == 0
    one = code.efforts(state, on_the_line, still, np.array([0.0, 1.0]), *[still] * 3)
    assert one.status == SampleStatus.SINGULAR_INCONSISTENT
    assert one.residual > 0.1
    for power in (0, 60, 401, 520, 700, 1000):
        got = code.efforts(state, on_the_line, still, np.array([0.0, 2.0**power]), *[still] * 3)
        assert (got.status, got.residual) == (one.status, times_power(one.residual, power))
        assert np.isnan(got.tau).all()


@pytest.mark.parametrize("name", ["2rpr", "more actuators"])
def test_rates_of_the_platform_are_as_many_times_as_large_as_those_of_actuators(name: str) -> None:
    robot, code, rate = robot_of(name), code_of(name), np.array([0.9, -0.9])
    still = np.zeros((1, robot.n))
    q = rp.inverse_kinematics(robot, rp.PlatformMotion([0.0], zoo.home_of(robot)[None], still, still)).q[0]
    position = np.array([q[robot.model.joints[robot.model.getJointId(each)].idx_q] for each in robot.actuated])
    one = code.platform(code.start(), position, rate)
    assert one.status < NOTHING_WRITTEN
    for power in (*POWERS, *range(1001, 1025)):
        state = code.start()
        kept, nothing = bytes(state), bytes(filled_with(code.platform_type, 7.0))
        got = code.platform(state, position, times_power(rate, power))
        with np.errstate(over="ignore"):
            wanted = times_power(one.xd, power)
        if np.isfinite(wanted).all():
            assert got.status == one.status
            np.testing.assert_array_equal(got.xd, wanted)
        else:  # no double holds them
            assert (got.status, got.raw, bytes(state)) == (SampleStatus.NOT_FINITE, nothing, kept)
    assert np.isinf(wanted).any() or name != "2rpr"


def test_nan_is_the_largest_of_any_numbers(tmp_path: Path) -> None:
    """So that no step of Newton's method counts as short for the numbers that come after it."""
    folder = folder_of(robot_of("2rpr"))
    head = "double probe(const double *values)"
    probe = f"{head};\n{head} {{ return unit_own_largest(values, 3); }}"
    (tmp_path / "probe.c").write_text(f'#include "unit.c"\n{probe}\n')
    library = ctypes.CDLL(
        str(compiled([tmp_path / "probe.c"], tmp_path / "probe.so", f"-I{folder}", "-O0", "-shared", "-fPIC"))
    )
    library.probe.restype = ctypes.c_double
    for values, largest in (([1.0, -3.0, 2.0], 3.0), ([0.0, -np.inf, 1.0], np.inf), ([0.0, 0.0, 0.0], 0.0)):
        assert library.probe((ctypes.c_double * 3)(*values)) == largest
    for at in range(3):
        assert np.isnan(library.probe((ctypes.c_double * 3)(*np.where(np.arange(3) == at, np.nan, 1.0))))


@pytest.mark.parametrize("name", ["2rpr", "more actuators", "3rrr"])
def test_numbers_that_overflow_on_the_way_get_a_status_and_nothing_is_written(name: str) -> None:
    robot, code = robot_of(name), code_of(name)
    home, still = zoo.home_of(robot), np.zeros(robot.n)
    parked = [np.zeros(robot.k)] * 3 if robot.k else []
    state = code.start()
    kept, nothing = bytes(state), bytes(filled_with(code.efforts_type, 7.0))
    for i in range(home.size - (name == "3rrr")):  # whose platform turns as often as it likes
        for size in (1e154, 1e200, 1e300, 1.7e308, -1.7e308):
            x = home.copy()
            x.flat[i] = size
            assert code.go_to(state, x) >= NOTHING_WRITTEN
            got = code.efforts(state, x, still, still, *parked)
            assert got.status >= NOTHING_WRITTEN
            assert (got.raw, bytes(state)) == (nothing, kept)


# --- stack -----------------------------------------------------------------------------------------------------------

SYSTEM = 16384
"""Bytes that glibc takes of a thread's stack at most, PTHREAD_STACK_MIN: the header and docs/compiled.md say so."""


def promised_of(folder: Path) -> int:
    return int(re.findall(r"UNIT_STACK_BYTES (\d+)", (folder / "unit.h").read_text(encoding="utf-8"))[0])


@pytest.mark.parametrize("name", ["two_arms", *map(LONG, ("2rpr", "fewer actuators", "gough", "40 loops"))])
@pytest.mark.parametrize("level", ["-O0", *map(LONG, ("-O1", "-O2", "-O3", "-Os"))])
def test_a_call_takes_no_more_stack_than_the_header_says(name: str, level: str, tmp_path: Path) -> None:
    folder = folder_of(robot_of(name))
    promised = promised_of(folder)
    program = stack.program(folder, "unit", level, tmp_path / "stack")
    used = stack.measured(program)
    assert {"go_to", "inverse_dynamics", "at"} <= set(used)
    assert max(used.values()) <= promised
    if level == "-O0":
        assert promised <= 3 * max(used.values())  # and is of use
    assert run(program, str(promised + SYSTEM)).returncode == 0
    if name == "40 loops":  # what 128 kB are too few for: the page behind the stack is touched
        resource.setrlimit(resource.RLIMIT_CORE, (0, resource.getrlimit(resource.RLIMIT_CORE)[1]))
        assert run(program, str(128 << 10)).returncode == -11


def test_the_table_of_the_documentation_is_of_the_code_as_it_is() -> None:
    number = r"([\d,]+)"
    row = rf"^\| (.+?) \| \d+ \| \d+ \| {number} \| {number} \| {number} "
    rows = re.findall(row, stack.PAGE.read_text(encoding="utf-8"), re.M)
    table = {name: [int(number.replace(",", "")) for number in numbers] for name, *numbers in rows}
    assert set(zoo.SHIPPED) <= set(shipped_robots()) <= set(table)
    assert all(used <= worst <= promised for promised, used, worst in table.values())
    for name in zoo.SHIPPED:
        promised = promised_of(folder_of(robot_of(name)))
        assert abs(table[name][0] - promised) <= 0.05 * promised, "run python benchmarks/stack.py"
