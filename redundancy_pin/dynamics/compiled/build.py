"""From a robot to machine code: C by casadi and the driver beside it, compiled and kept by ``machine_code``.

A library's name is a hash of all that goes into it: the topology of the robot, the versions of casadi and Pinocchio,
the texts of this package, the compiler and its flags. Numbers of the robot are no part of it: they are arguments
(``parameters``), and robots that differ in them share a library.
"""

from __future__ import annotations

import copy
import ctypes
import functools
import importlib.metadata
import importlib.resources
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import CLOSURE_TOLERANCE, NEAR_SINGULAR_MARGIN, RANK_TOLERANCE, Array
from redundancy_pin.dynamics.compiled.emit import c_functions
from redundancy_pin.dynamics.compiled.parameters import Topology, parameter_vector, topology_of
from redundancy_pin.dynamics.compiled.symbols import SymbolicChain, casadi
from redundancy_pin.dynamics.distribution import CONSISTENCY_TOLERANCE, FORCE_TOLERANCE
from redundancy_pin.machine_code import FLAGS, built, digest, loaded
from redundancy_pin.motion import POSE_TOLERANCE
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.whole_turns import EXACT, FARTHEST, MOST_TURNS, TURN, WHOLE, counted_turns
from redundancy_pin.status import SampleStatus

LEAST_MARGIN = float(np.sqrt(2.0 * CLOSURE_TOLERANCE))
"""Scaled margin below which a pose counts as a type I singularity: two configurations meet there in a square root, and
one that is closed to within the tolerance is known no better than this."""

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Definition:
    """Functions of the robots of one topology, as casadi has them: by name the arguments and results.

    Attributes:
        chain: the expressions.
        functions: casadi Functions; names start with ``rp_``. Those that depend on numbers of the robot take its
            ``parameters.parameter_vector`` as their last argument.
    """

    chain: SymbolicChain
    functions: Mapping[str, Any]

    def shapes(self, name: str) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Return the lengths of a function's arguments and results."""
        function = self.functions[name]
        return (
            tuple(function.numel_in(i) for i in range(function.n_in())),
            tuple(function.numel_out(i) for i in range(function.n_out())),
        )


def define(robot: Robot) -> Definition:
    """Write the functions of a robot's topology. Matrices are laid out row by row, except K, column by column."""
    casadi()  # says so where it is missing, whatever was written before
    return _defined(topology_of(robot))


@functools.lru_cache(maxsize=8)
def _defined(topology: Topology) -> Definition:
    ca, robot = casadi(), topology.robot
    chain = SymbolicChain(robot)
    carriers = [ca.SX.sym(name, robot.k) for name in ("s", "sd", "sdd")]
    columns = robot.carrier_velocity.tolist()
    q, v, a = ca.SX(chain.q), ca.SX(chain.v), ca.SX(chain.a)
    for whole, part, at in zip((q, v, a), carriers, (robot.carrier_position.tolist(), columns, columns), strict=True):
        if at:
            whole[at] = part
    positions = ca.SX.sym("positions", robot.m)
    gamma = ca.SX.sym("gamma", robot.n, chain.model.nv)  # row by row in memory it is (nv, n)
    efforts, base = chain.efforts
    pose, tree = [chain.q, chain.trig], [chain.q, chain.trig, chain.v, chain.a]

    def at_carriers(*expressions: Any) -> list[Any]:
        function = ca.Function("inner", [*tree, chain.external, chain.parameters], list(expressions))
        results = function.call([q, chain.trig, v, a, chain.external, chain.parameters])
        return list(results)

    everything, ground, energy = at_carriers(efforts, base, chain.energy)
    reduced = [gamma @ everything, everything[columns] if columns else ca.SX(0, 1)]
    motion = [*tree, *carriers, chain.external]
    projected = [*tree, gamma, *carriers, chain.external]
    derivatives = [ca.vec(ca.jacobian(part, by).T) for part in reduced for by in carriers]
    missing = ca.vertcat(-chain.closure_rows, chain.missing) / chain.equation_unit
    K = ca.diag(1.0 / chain.equation_unit) @ chain.K @ ca.diag(chain.step_unit)
    definitions: dict[str, tuple[list[Any], list[Any]]] = {
        "rows": ([*pose, chain.x], [missing, ca.vec(K), chain.alignment]),  # without units
        "bias": ([*pose, chain.v], [chain.bias]),
        "turns": ([chain.q], [ca.vertcat(*(f(chain.q[i]) for i in chain.turning for f in (ca.cos, ca.sin)))]),
        "moved": ([chain.q, chain.step], [chain.moved]),
        "modes": (pose, [chain.mode_indicators]),
        "coordinates": (pose, [chain.coordinates]),
        "drives": ([chain.q, positions], [_missed(chain, positions)]),
        "project": (projected, reduced),
        "derivatives": (projected, derivatives),
        "efforts": (motion, [everything]),
        "base_wrench": (motion, [-ground]),
        "energy": (motion, [energy]),
    }
    functions = {}
    for name, (inputs, outputs) in definitions.items():
        functions[f"rp_{name}"] = function_of(chain, f"rp_{name}", inputs, outputs)
    return Definition(chain, functions)


def function_of(chain: SymbolicChain, name: str, inputs: list[Any], outputs: list[Any]) -> Any:
    """Return a casadi Function with dense results; numbers of the robot, where it needs any, are its last argument."""
    ca = casadi()
    dense = [ca.densify(part) for part in ca.cse(outputs)]
    depends = ca.depends_on(ca.veccat(*dense), chain.parameters)
    return ca.Function(name, [*inputs, chain.parameters] if depends else inputs, dense)


def bind(function: Any, robot: Robot) -> Any:
    """Return a function of a definition with the numbers of a robot in it, which are no arguments any more."""
    ca, vector = casadi(), parameter_vector(robot)
    count = function.n_in() - 1
    if function.numel_in(count) != len(vector) or not function.name_in(count):
        return function
    inputs = [ca.SX.sym(f"i{i}", function.size1_in(i), function.size2_in(i)) for i in range(count)]
    return ca.Function(function.name(), inputs, function.call([*inputs, ca.SX(vector)]))


def _missed(chain: SymbolicChain, positions: Any) -> Any:
    """Return (m,) how far the main actuators are from their positions, m and rad."""
    ca, missed = casadi(), []
    for i, name in enumerate(chain.robot.actuated):
        joint = find_joint(chain.robot.model, name)
        q = chain.q[joint.idx_q : joint.idx_q + joint.nq]
        if joint.nq == 1:
            missed.append(positions[i] - q)
        else:  # cosine and sine: the angle of the turn from one to the other
            c, s = ca.cos(positions[i]), ca.sin(positions[i])
            missed.append(ca.atan2(s * q[0] - c * q[1], c * q[0] + s * q[1]))
    return ca.vertcat(ca.SX(0, 1), *missed)


def source(definition: Definition) -> str:
    """Return the C of a robot as Python calls it: generated functions, sizes and tables, driver, batches."""
    chain = definition.chain
    turning = ", ".join(map(str, chain.turning)) or "0"
    return "\n".join(
        [
            driver_source(definition, definition.functions.values()),
            f"const int rp_turning[] = {{{turning}}};",
            sample_source(),
            _table("static const int CARRIERS", chain.robot.carrier_velocity),
            _table("static const int CARRIED", chain.robot.carrier_position),
            text_of("calls.c"),
            text_of("batch.c"),
        ]
    )


def driver_source(definition: Definition, functions: Iterable[Any], storage: str = "") -> str:
    """Return the C that closes a robot's loops: generated functions, sizes and tables, and ``driver.c``.

    With ``storage`` "static" nothing of it is seen from other files; who stands behind it calls all of it.
    """
    chain = definition.chain
    turns = counted_turns(chain.robot)
    listed = ", ".join(map(str, turns.coordinates.tolist()))
    counted = [
        f"#define TURNS {len(turns.coordinates)}",
        f"#define COUNTED_COORDINATES {{{listed}}}",
    ]
    if len(turns.coordinates):
        angles = ", ".join(map(str, (turns.angles.astype(int) + turns.kept).tolist()))
        counted.append(f"static const int ANGLE[] = {{{angles}}};")
    return "\n".join([*tables(chain, functions, storage), *counted, text_of("driver.c")])


def sample_source() -> str:
    """Return the C of one sample, ``sample.c``, with its constants; it follows ``driver_source``."""
    constants = {
        "RANK_TOLERANCE": RANK_TOLERANCE,
        "NEAR_SINGULAR": NEAR_SINGULAR_MARGIN,
        "CONSISTENCY_TOLERANCE": CONSISTENCY_TOLERANCE,
        "FORCE_TOLERANCE": FORCE_TOLERANCE,
    }
    statuses = ", ".join(f"STATUS_{status.name} = {int(status)}" for status in SampleStatus)
    text = [f"enum {{ {statuses}, STATUSES }};"]
    text += [f"#define {name} {value!r}" for name, value in constants.items()]
    return "\n".join([*text, text_of("sample.c")])


def _table(declared: str, values: Any) -> str:
    listed = ", ".join(repr(value) for value in np.asarray(values).tolist())
    return f"{declared}[] = {{{listed or '0'}}};"


def tables(chain: SymbolicChain, functions: Iterable[Any], storage: str) -> list[str]:
    """Return the C in front of a driver: generated functions, and sizes and tables in capitals."""
    robot = chain.robot
    sizes = {
        "NQ": chain.model.nq,
        "NV": chain.model.nv,
        "NP": len(chain.pose_columns),
        "N": robot.n,
        "M": robot.m,
        "NK": robot.k,
        "R": chain.rows,
        "NT": len(chain.turning),
        "NX": chain.x.numel(),
        "LEGS": chain.mode_indicators.numel(),
        "NALIGN": chain.alignment.numel(),
        "NWRENCH": chain.external.numel(),
        "TOLERANCE": CLOSURE_TOLERANCE,
        "LEAST_MARGIN": LEAST_MARGIN,
        "POSE_TOLERANCE": POSE_TOLERANCE,
        "EPSILON": float(np.finfo(float).eps),
        "TURN": TURN,
        "MOST_TURNS": MOST_TURNS,
        "WHOLE": WHOLE,
        "EXACT": EXACT,
        "FARTHEST": FARTHEST,
    }
    tables = {
        "static const int COLUMNS": chain.pose_columns,
        "static const int ACTUATED": robot.actuated_velocity,
    }
    text = ["#include <math.h>", f"#define EXPORTED {storage}".strip(), c_functions(functions, storage)]
    text += [f"#define {name} {value!r}" for name, value in sizes.items()]
    text += chain.layout.macros
    return [*text, *(_table(name, values) for name, values in tables.items())]


def text_of(name: str) -> str:
    """Return the text of a file of this package."""
    return importlib.resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


_WRITTEN = (
    "symbols.py",
    "load_symbols.py",
    "parameters.py",
    "build.py",
    "emit.py",
    "driver.c",
    "sample.c",
    "calls.c",
    "batch.c",
)
"""Files that decide what is compiled: who changes one gets a new library."""


def key(robot: Robot, compiler: str, files: Sequence[str] = _WRITTEN, flags: Sequence[str] = FLAGS) -> str:
    """Return what tells one library from another: a hash of all that goes into it. Numbers of the robot do not."""
    try:
        version = importlib.metadata.version("casadi")  # without the time that an import takes
    except importlib.metadata.PackageNotFoundError:
        version = str(casadi().__version__)  # installed by other means than pip, or not at all
    constants = repr((CLOSURE_TOLERANCE, RANK_TOLERANCE, NEAR_SINGULAR_MARGIN, CONSISTENCY_TOLERANCE, FORCE_TOLERANCE))
    texts = (text_of(name) for name in files)
    return digest([topology_of(robot).text, version, str(pin.__version__), constants, *files, *texts, compiler, *flags])


class Library:
    """A compiled topology with the numbers of one robot: functions called with arrays.

    Args:
        path: the shared library.
        robot: the robot.
    """

    def __init__(self, path: Path, robot: Robot) -> None:
        self.path = path
        self.library = loaded(path)
        for name in ("rp_lift", "rp_follow", "rp_reach", "rp_map", "rp_project", "rp_terms"):
            getattr(self.library, name)  # AttributeError where the file is another one
        turning = ctypes.c_int.in_dll(self.library, "rp_turnings").value
        self.trigs = 2 * turning
        self._turning = list((ctypes.c_int * turning).in_dll(self.library, "rp_turning"))
        self._set_numbers(robot)

    def _set_numbers(self, robot: Robot) -> None:
        self._numbers = parameter_vector(robot)
        self.numbers = ctypes.c_void_p(self._numbers.ctypes.data)

    def for_robot(self, robot: Robot) -> Library:
        """Return the same functions with the numbers of another robot of the topology; nothing is compiled."""
        other = copy.copy(self)
        other._set_numbers(robot)
        return other

    def trig_at(self, q: Array) -> Array:
        """Return (N, T) the cosines and sines at configurations (N, nq) that the functions take."""
        angles = q[:, self._turning]
        return np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(q), -1)

    def call(self, name: str, *arguments: object) -> int:
        """Call a function of the driver with arrays and integers."""
        return int(getattr(self.library, name)(self.numbers, *(_as_c(value) for value in arguments)))

    def map(self, name: str, samples: int, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate a generated function for many samples, the first axis of all arrays; outputs are written to."""
        pointer = ctypes.cast(getattr(self.library, name), ctypes.c_void_p)
        packed = [_pointers(arrays) for arrays in (inputs, outputs)]
        sizes = [
            (ctypes.c_long * max(len(arrays), 1))(*(array[0].size if array.strides[0] else 0 for array in arrays))
            for arrays in (inputs, outputs)
        ]
        count = ctypes.c_long(samples)
        self.library.rp_map(
            self.numbers, pointer, count, len(inputs), packed[0], sizes[0], len(outputs), packed[1], sizes[1]
        )


def _as_c(value: object) -> object:
    return ctypes.c_void_p(value.ctypes.data) if isinstance(value, np.ndarray) else value


def _pointers(arrays: Sequence[Array]) -> Any:
    return (ctypes.c_void_p * max(len(arrays), 1))(*(array.ctypes.data for array in arrays))


def build_library(robot: Robot) -> tuple[Library | None, str]:
    """Return the compiled robot, from disk or new; or None and the reason why there is none."""
    return built_for(robot, _WRITTEN, lambda: source(define(robot)), lambda path: Library(path, robot))


def built_for(
    robot: Robot,
    files: Sequence[str],
    write: Callable[[], str],
    load: Callable[[Path], T],
    flags: Sequence[str] = FLAGS,
) -> tuple[T | None, str]:
    """Return a library of a robot, as ``machine_code.built`` does.

    Args:
        robot: the robot.
        files: those of this package that decide what is compiled.
        write: returns the C.
        load: opens a library.
        flags: of the compiler.
    """
    return built(lambda compiler: key(robot, compiler, files, flags), write, load, flags)
