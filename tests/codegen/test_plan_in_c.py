"""The on-line planner as C for a controller: against Python's planner, in every dialect, and moving a MuJoCo model."""

from __future__ import annotations

import ctypes
import re
import shlex
import shutil
import subprocess
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from generated_c import COMPILERS, compiled, run

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.receding_horizon import Preview, RecedingHorizon
from redundancy_pin.status import UpdateStatus

pytestmark = pytest.mark.skipif("gcc" not in COMPILERS, reason="gcc is not installed")

WARNINGS = ("-Wshadow", "-Wconversion", "-Wundef", "-Wcast-qual", "-Wwrite-strings", "-Wstrict-prototypes")
DIALECTS = ("-std=c99", "-std=gnu17", "-std=c2x")
SAME = 1e-6
"""Of the largest value: the method stops at 1e-9 of its units, and what the cost is flat in is magnified."""

MASSES = {"end_effector_mass": 0.5, "cylinder_mass": 0.3, "piston_mass": 0.2}
ROBOTS: dict[str, dict[str, Any]] = {
    "2rpr": MASSES,
    "3rrr": {},
    "five_bar": {"carriers": True},
    "gough": {"carriers": True},
}
NAMES = ["2rpr", *(pytest.param(name, marks=pytest.mark.long) for name in ("3rrr", "five_bar", "gough"))]
LEVELS = [
    ("-O1",),
    pytest.param(("-O0", "-DUNIT_SCALAR"), marks=pytest.mark.long),
    pytest.param(("-O3", "-march=native"), marks=pytest.mark.long),
]
SYSTEM = 16 << 10
"""Bytes of a thread's stack that glibc takes for itself, at most (PTHREAD_STACK_MIN)."""

STATUSES = {0: UpdateStatus.OK, 2: UpdateStatus.RELAXED, 3: UpdateStatus.REFUSED, 5: UpdateStatus.TIME_SCALED}


@cache
def robot_of(name: str) -> Any:
    return rp.load_robot(name, **ROBOTS[name])


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> Any:
    """Return the folder of a robot's C with its planner, written once."""
    made: dict[str, Path] = {}

    def folder_of(name: str, **settings: Any) -> Path:
        key = f"{name}{settings}"
        if key not in made:
            robot, target = robot_of(name), tmp_path_factory.mktemp("plan") / "code"
            planner = RecedingHorizon(robot, **settings)
            made[key] = rp.write_c(robot, target, prefix="unit", online=planner).folder
        return made[key]

    return folder_of


def sources_of(folder: Path) -> list[Path]:
    return [folder / name for name in ("unit.c", "unit_plan.c", "test_unit_plan.c")]


def objects_of(folder: Path) -> list[Path]:
    """Return a robot and its planner, compiled once, with every warning an error."""
    made = [folder.parent / f"{name}.o" for name in ("unit", "unit_plan")]
    for target in made:
        if not target.exists():
            compiled([folder / f"{target.stem}.c"], target, "-c", "-O1", "-fPIC", *WARNINGS)
    return made


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("flags", LEVELS)
def test_recorded_updates_are_those_of_python(folders: Any, name: str, flags: Any, tmp_path: Path) -> None:
    """With vectors and without, which the sanitisers see to in ``make test``."""
    *sources, test = sources_of(folders(name))
    objects = objects_of(folders(name)) if flags == ("-O1",) else sources
    done = run(compiled([*objects, test], tmp_path / "program", *flags, *WARNINGS))
    assert done.stdout.startswith("0 failures"), (flags, done.stdout)


@pytest.mark.parametrize("name", NAMES)
def test_the_planner_of_the_readme_plans_as_python_does_along_the_same_motion(
    folders: Any, name: str, tmp_path: Path
) -> None:
    folder = tmp_path / "code"
    shutil.copytree(folders(name), folder)
    text = (folder / "README.md").read_text(encoding="utf-8")
    (example,) = [one for one in re.findall(r"^```c\n(.*?)^```", text, flags=re.M | re.S) if "_plan_update" in one]
    (tmp_path / "example_plan.c").write_text(example, encoding="utf-8")
    (command,) = [line for line in text.splitlines() if line.startswith("cc ") and "example_plan" in line]
    words = [word.replace("-O2", "-O0") for word in shlex.split(command, comments=True)]  # in a third of the time
    subprocess.run(words, cwd=folder, check=True)
    told = run(tmp_path / "example_plan")
    assert (told.returncode, "status" in told.stdout) == (0, False)
    robot, t = robot_of(name), np.linspace(0.0, 1.0, 101)
    x = np.repeat(zoo.home_of(robot)[None], len(t), axis=0)
    x.reshape(len(t), -1)[:, 3 if x.ndim == 3 else 0] += 0.01 * (10.0 * t**3 - 15.0 * t**4 + 6.0 * t**5)
    xd, xdd = np.zeros((2, len(t), robot.n))
    xd[:, 0] = 0.3 * (t**2 - 2.0 * t**3 + t**4)
    xdd[:, 0] = 0.6 * (t - 3.0 * t**2 + 2.0 * t**3)
    planner, motion = RecedingHorizon(robot), rp.PlatformMotion(t, x, xd, xdd)
    for tick in range(200):
        now = planner.update(0.005 * tick, motion)
    found = [float(value) for value in re.findall(r"^tau\[\d+\] = (\S+)$", told.stdout, flags=re.M)]
    np.testing.assert_allclose(found, now.tau, rtol=1e-3, atol=1e-3 * np.abs(now.tau).max())


@pytest.mark.parametrize("name", NAMES)
def test_every_dialect_takes_it_without_a_warning(folders: Any, name: str) -> None:
    folder = folders(name)
    for dialect in DIALECTS:
        command = ["gcc", "-fsyntax-only", "-Werror", "-Wall", "-Wextra", "-Wpedantic", *WARNINGS, dialect]
        done = subprocess.run([*command, *map(str, sources_of(folder))], capture_output=True, text=True, check=False)
        assert done.returncode == 0, (dialect, done.stderr)


@pytest.mark.parametrize("scalar", [pytest.param("-UUNIT_SCALAR", marks=pytest.mark.long), "-DUNIT_SCALAR"])
def test_sanitisers_find_nothing(folders: Any, scalar: str, tmp_path: Path) -> None:
    flags = ("-O0", "-g", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", scalar)
    done = run(compiled(sources_of(folders("2rpr")), tmp_path / "program", *flags))
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("0 failures")


@pytest.mark.long
@pytest.mark.skipif(shutil.which("valgrind") is None, reason="valgrind is not installed")
def test_valgrind_finds_nothing(folders: Any, tmp_path: Path) -> None:
    program = compiled(sources_of(folders("2rpr")), tmp_path / "program", "-O0", "-g")
    done = run(Path("valgrind"), "-q", "--error-exitcode=9", "--leak-check=full", str(program))
    assert done.returncode == 0, done.stderr


def test_its_own_test_can_fail_and_times_are_drawn(folders: Any, tmp_path: Path) -> None:
    folder = folders("2rpr")
    text = (folder / "test_unit_plan.c").read_text(encoding="utf-8")
    a, b, c = re.findall(r"^  \{([\d.e-]+, 0, \{)([\d.e-]+)(, .*)$", text, flags=re.M)[40]
    changed = tmp_path / "test_unit_plan.c"
    changed.write_text(text.replace(f"{a}{b}{c}", f"{a}{float(b) + 1e-4!r}{c}"), encoding="utf-8")
    program = compiled([*objects_of(folder), changed], tmp_path / "program", f"-I{folder}")
    done = run(program)
    assert done.returncode == 1
    assert "update 40: s is" in done.stdout
    drawn = run(program, "--time", "500").stdout
    assert re.match(
        r"500 updates: median [\d.]+ us, 99 % [\d.]+ us, worst .* iterations: median \d+, most \d+\n", drawn
    )
    assert drawn.count("*") > 20
    assert run(program, "--time").returncode == 2


def test_it_allocates_nothing_and_its_names_begin_with_the_prefix(folders: Any, tmp_path: Path) -> None:
    objects = []
    for name in ("unit", "unit_plan"):
        objects.append(tmp_path / f"{name}.o")
        built = ["gcc", "-c", "-O0", "-std=c99", str(folders("2rpr") / f"{name}.c"), "-o", str(objects[-1])]
        subprocess.run(built, check=True)
    listed = subprocess.run(["nm", *map(str, objects)], capture_output=True, text=True, check=True).stdout
    needed = set(re.findall(r"^ +U (\w+)$", listed, flags=re.M))
    given = set(re.findall(r"^\w+ [A-TV-Z] (\w+)$", listed, flags=re.M))
    assert given
    assert all(name.startswith("unit_") for name in given)
    maths = {
        "sin",
        "cos",
        "sqrt",
        "fabs",
        "floor",
        "ceil",
        "pow",
        "copysign",
        "atan2",
        "frexp",
        "ldexp",
        "round",
        "trunc",
    }
    strings = {"memcpy", "memmove", "memset", "memcmp", "__stack_chk_fail", "_GLOBAL_OFFSET_TABLE_"}
    assert needed - given <= maths | strings | {"sincos", "fmin", "fmax", "hypot"}
    writable = re.findall(r"^\w+ [bBdD] (\w+)$", listed, flags=re.M)
    assert not writable


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("level", ["-O0", pytest.param("-O2", marks=pytest.mark.long)])
def test_a_call_takes_no_more_stack_than_the_header_says(folders: Any, name: str, level: str, tmp_path: Path) -> None:
    folder = folders(name)
    header = (folder / "unit.h").read_text(encoding="utf-8")
    promised = int(re.findall(r"UNIT_PLAN_STACK_BYTES (\d+)", header)[0])
    sources = [Path(__file__).with_name("plan_stack.c"), folder / "unit.c", folder / "unit_plan.c"]
    tested = f'-DTESTED="{folder / "test_unit_plan.c"}"'
    command = ["gcc", "-std=gnu99", "-w", level, tested, f"-I{folder}", *map(str, sources)]
    command += ["-o", str(tmp_path / "stack")]
    subprocess.run([*command, "-lm", "-lpthread"], check=True)
    used = int(run(tmp_path / "stack").stdout)
    assert promised / 8 < used <= promised + SYSTEM
    done = run(tmp_path / "stack", str(promised + 2 * SYSTEM))
    assert done.returncode == 0


class Plan:
    """The planner's C called with numpy arrays."""

    def __init__(self, folder: Path, preview: Preview) -> None:
        target = folder.parent / "plan.so"  # which keeps no state
        if not target.exists():
            compiled(objects_of(folder), target, "-shared")
        self._library = ctypes.CDLL(str(target))
        header = (folder / "unit.h").read_text(encoding="utf-8")
        (doubles,) = re.findall(r"#define UNIT_PLAN_DOUBLES (\d+)", header)
        self._memory = (ctypes.c_double * int(doubles))()
        pieces = preview.polynomials
        assert pieces is not None
        self._kept = (
            np.array(pieces.edges, order="C"),
            np.array(pieces.coefficients, order="C"),
            np.array(preview.breaks),
        )
        edges, coefficients, breaks = self._kept

        class Ahead(ctypes.Structure):
            _fields_ = [
                ("pieces", ctypes.c_int), ("order", ctypes.c_int), ("edges", ctypes.c_void_p),
                ("coefficients", ctypes.c_void_p), ("moves_until", ctypes.c_double), ("end", ctypes.c_double),
                ("breaks", ctypes.c_int), ("break_times", ctypes.c_void_p), ("number", ctypes.c_long),
            ]  # fmt: skip

        self.ahead = Ahead(
            len(edges) - 1, len(coefficients), edges.ctypes.data, coefficients.ctypes.data, preview.moves_until,
            preview.end, len(breaks), breaks.ctypes.data, 1,
        )  # fmt: skip
        self.reset()

    def reset(self) -> None:
        assert self._library.unit_plan_reset(ctypes.byref(self._memory)) == 0

    def update(self, t: float, measured: Array | None = None) -> tuple[int, Array]:
        command = np.full(64, np.nan)
        given = None if measured is None else ctypes.c_void_p(measured.ctypes.data)
        places = ctypes.byref(self.ahead), ctypes.c_void_p(command.ctypes.data)
        status = self._library.unit_plan_update(ctypes.byref(self._memory), ctypes.c_double(t), given, *places)
        return int(status), command

    def command_at(self, t: float) -> tuple[int, Array]:
        command = np.full(64, np.nan)
        place = ctypes.c_void_p(command.ctypes.data)
        return int(self._library.unit_plan_command_at(ctypes.byref(self._memory), ctypes.c_double(t), place)), command

    def set_limits(self, limits: Any) -> int:
        names = ("track", "speed", "acceleration", "jerk", "carrier_force", "effort")
        values = np.concatenate([np.ravel(getattr(limits, name)) for name in names])
        return int(self._library.unit_plan_set_limits(ctypes.byref(self._memory), ctypes.c_void_p(values.ctypes.data)))


CIRCLE = rp.trajectory.reference.circle(speed=0.5)


@pytest.mark.parametrize("slow_down", [False, True])
def test_measured_carriers_limits_that_change_and_slowing_down_are_as_in_python(folders: Any, slow_down: bool) -> None:
    """Through two singularities, with limits that no plan keeps for a while."""
    robot = robot_of("2rpr")
    planner = RecedingHorizon(robot, slow_down=slow_down)
    plan = Plan(folders("2rpr", **({"slow_down": True} if slow_down else {})), Preview.of(CIRCLE))
    rng, seen, command = np.random.default_rng(1), set(), None
    for i in range(120):
        t = 0.01 * i
        if i in (30, 60):
            weak = Limits(acceleration=2.0, effort=None if slow_down else 1.0)
            planner.limits = weak if i == 30 else Limits()
            assert plan.set_limits(planner.resolved) == 0
        measured = None
        if i % 3 == 1 and command is not None:
            s, sd, _ = command.motion_at(t)
            measured = np.concatenate([s + rng.uniform(-1e-4, 1e-4, 2), sd + rng.uniform(-1e-3, 1e-3, 2)])
        command = planner.update(t, CIRCLE, *(() if measured is None else np.split(measured, 2)))
        status, told = plan.update(t, measured)
        assert STATUSES[status] is command.status
        seen.add(command.status)
        for later in (0.0, 0.003, 0.2, 1.0):
            again, values = plan.command_at(t + later)
            assert again == (4 if t + later > command.known_until else status)  # FALLBACK: nobody has renewed it
            motion = np.concatenate(command.motion_at(t + later))
            for own, wanted in zip(np.split(values[:6], 3), np.split(motion, 3), strict=True):
                np.testing.assert_allclose(own, wanted, atol=1e2 * SAME * max(1.0, np.abs(wanted).max()))
            efforts = command.efforts.at(t + later)
            np.testing.assert_allclose(values[6:8], efforts, atol=1e3 * SAME * max(1.0, np.abs(efforts).max()))
        np.testing.assert_allclose(told[:2], command.motion_at(t)[0], atol=1e2 * SAME)
        own = t if command.scaling is None else float(command.scaling.at([t])[0][0])
        assert told[10] == pytest.approx(own, abs=1e-9)
    assert UpdateStatus.OK in seen
    assert (UpdateStatus.TIME_SCALED if slow_down else UpdateStatus.RELAXED) in seen


@pytest.mark.parametrize(("slow_down", "most"), [(False, 2560), (True, 12160)])
def test_the_header_states_the_iterations_of_an_update_at_most(folders: Any, slow_down: bool, most: int) -> None:
    """Eight programmes, begun with a solution and without, and relaxed, about two motions; 15 speeds that are tried."""
    settings = {"slow_down": True} if slow_down else {}
    header = (folders("2rpr", **settings) / "unit.h").read_text()
    stated = re.search(r"at\s+most (\d+) iterations", header)
    assert stated is not None
    assert int(stated[1]) == most


def test_a_preview_that_leads_out_of_reach_is_refused_and_one_that_begins_there_too(folders: Any) -> None:
    robot = robot_of("five_bar")
    path = rp.trajectory.through_points(np.array([[0.25, 0.75], [0.25, 1.4]]))
    away = rp.trajectory.Trajectory(path, rp.trajectory.SpeedProfile(path.length, 0.6, 0.2))
    plan, planner = Plan(folders("five_bar"), Preview.of(away)), RecedingHorizon(robot)
    statuses = [(STATUSES[plan.update(0.02 * i)[0]], planner.update(0.02 * i, away).status) for i in range(20)]
    assert all(own is other for own, other in statuses)
    assert statuses[-1][0] is UpdateStatus.REFUSED
    plan.reset()
    assert plan.update(float(away.duration))[0] == 8
    assert plan.command_at(0.0)[0] == 6


def test_previews_that_say_nothing_of_what_comes_are_none(folders: Any) -> None:
    """Past the end of one that is known no further, polynomials that end moving, edges that do not increase."""
    samples = CIRCLE.sample_at(np.linspace(0.0, 0.4, 81))
    plan = Plan(folders("2rpr"), Preview.of(samples))
    assert plan.update(0.39)[0] == 0
    assert plan.update(0.4 + 1e-6)[0] == 7
    assert plan.command_at(0.39)[0] == 0
    assert plan.command_at(0.395)[0] == 0  # within a step of the update
    assert plan.command_at(0.415)[0] == 4  # the last plan goes on
    plan.reset()
    plan.ahead.end = np.inf
    assert plan.update(0.1)[0] == 7
    plan.ahead.moves_until = np.nan
    assert plan.update(0.1)[0] == 7
    plan.ahead.end, plan.ahead.moves_until = 0.4, np.inf
    assert plan.update(0.1)[0] == 0
    edges = plan._kept[0]
    edges[3] = edges[2]
    assert plan.update(0.11)[0] == 7


def test_a_plan_that_was_never_reset_and_clocks_of_the_epoch_are_refused(folders: Any) -> None:
    """Neither hangs: the first has no step, and beyond 2⁵³ of them no grid goes on."""
    plan = Plan(folders("2rpr"), Preview.of(CIRCLE))
    ctypes.memset(ctypes.byref(plan._memory), 0, ctypes.sizeof(plan._memory))
    assert plan.update(0.01)[0] == 7
    assert plan.set_limits(RecedingHorizon(robot_of("2rpr")).resolved) == 7
    assert plan.command_at(0.01)[0] == 6
    plan.reset()
    plan.ahead.end, plan.ahead.moves_until = np.inf, CIRCLE.duration
    for t in (1.7e9, -1.7e9, 1e14, 1e300, np.inf, np.nan):
        assert plan.update(t)[0] == 7
    assert plan.update(1e5)[0] == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_motion_that_is_not_finite_ahead_is_no_preview(folders: Any, bad: float) -> None:
    """Nothing is written, and the plan before goes on."""
    plan = Plan(folders("2rpr"), Preview.of(CIRCLE.sample_at(np.linspace(0.0, 1.0, 201))))
    assert plan.update(0.0)[0] == 0
    coefficients = plan._kept[1]
    coefficients[:, int(np.searchsorted(plan._kept[0], 0.55)) :] = bad
    status, command = plan.update(0.1)
    assert status == 7
    assert np.isnan(command).all()
    assert plan.command_at(0.1)[0] == 0


def test_robots_and_planners_that_do_not_fit_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="plans for 2rpr"):
        rp.write_c("3rrr", tmp_path / "code", online=RecedingHorizon("2rpr"))
    turning = rp.load_robot("2rpr", arm_length=0.2, **MASSES)
    with pytest.raises(UnsupportedRobotError, match="carriers that turn"):
        rp.write_c(turning, tmp_path / "code", online=RecedingHorizon(turning))
    assert not (tmp_path / "code").exists()


def test_a_planner_and_a_tracking_controller_lead_a_mujoco_model_through_a_singularity(
    folders: Any, tmp_path: Path
) -> None:
    """All in one C program: 200 Hz and 1 kHz, no Python in the loop."""
    mujoco = pytest.importorskip("mujoco")
    home = Path(mujoco.__file__).parent
    (library,) = sorted(home.glob("libmujoco.so*"))[:1] or pytest.skip("MuJoCo has no library here")
    folder, model = folders("2rpr"), rp.write_mjcf(robot_of("2rpr"), tmp_path / "model.xml")
    sources = [*objects_of(folder), Path(__file__).with_name("plan_and_track.c")]
    command = [
        "gcc",
        "-std=c99",
        "-O1",
        "-D_POSIX_C_SOURCE=200112L",
        "-Wall",
        "-Wextra",
        "-Werror",
        "-isystem",
        home / "include",
    ]
    command += [f"-I{folder}", *sources, "-o", tmp_path / "track", library, "-lm", f"-Wl,-rpath,{home}"]
    subprocess.run([str(word) for word in command], check=True)
    done = run(tmp_path / "track", str(model))
    assert done.returncode == 0, done.stdout
    (distance, crossings, status) = re.findall(r"distance (\S+) m, crossings (\d+), worst status (\d+)", done.stdout)[0]
    assert float(distance) < 1e-4
    assert (int(crossings), int(status)) == (1, 0)
