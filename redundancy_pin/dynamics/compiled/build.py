"""From a robot to machine code: C by casadi and the driver beside it, compiled and kept by ``machine_code``.

A library's name is a hash of all that goes into it: the tree, closures and roles of the robot, the versions of casadi,
Pinocchio and this package, the compiler and its flags.
"""

from __future__ import annotations

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

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array
from redundancy_pin.dynamics.compiled.emit import c_functions
from redundancy_pin.dynamics.compiled.load_symbols import shape_of
from redundancy_pin.dynamics.compiled.symbols import SymbolicChain, casadi
from redundancy_pin.machine_code import FLAGS, built, digest, loaded
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import position_unit
from redundancy_pin.robot.whole_turns import counted_turns

LEAST_MARGIN = float(np.sqrt(2.0 * CLOSURE_TOLERANCE))
"""Scaled margin below which a pose counts as a type I singularity: two configurations meet there in a square root, and
one that is closed to within the tolerance is known no better than this."""

T = TypeVar("T")


@dataclass(frozen=True, eq=False)
class Definition:
    """Functions of one robot, as casadi has them: by name the arguments and results.

    Attributes:
        chain: the expressions.
        functions: casadi Functions; names start with ``rp_``.
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
    """Write the functions of a robot. Matrices are laid out row by row, but for K, which LAPACK's way suits."""
    casadi()  # says so where it is missing, whatever was written before
    return _defined(robot)


@functools.lru_cache(maxsize=8)
def _defined(robot: Robot) -> Definition:
    ca = casadi()
    chain = SymbolicChain(robot)
    carriers = [ca.SX.sym(name, robot.k) for name in ("s", "sd", "sdd")]
    columns = robot.carrier_velocity.tolist()
    q, v, a = ca.SX(chain.q), ca.SX(chain.v), ca.SX(chain.a)
    for whole, part, at in zip((q, v, a), carriers, (robot.carrier_position.tolist(), columns, columns), strict=True):
        if at:
            whole[at] = part
    gamma = ca.SX.sym("gamma", robot.n, chain.model.nv)  # row by row in memory it is (nv, n)
    efforts, base = chain.efforts
    pose, tree = [chain.q, chain.trig], [chain.q, chain.trig, chain.v, chain.a]

    def at_carriers(*expressions: Any) -> list[Any]:
        function = ca.Function("inner", [*tree, chain.external], list(expressions))
        results = function.call([q, chain.trig, v, a, chain.external])
        return list(results)

    everything, ground, energy = at_carriers(efforts, base, chain.energy)
    reduced = [gamma @ everything, everything[columns] if columns else ca.SX(0, 1)]
    motion = [*tree, *carriers, chain.external]
    projected = [*tree, gamma, *carriers, chain.external]
    derivatives = [ca.vec(ca.jacobian(part, by).T) for part in reduced for by in carriers]
    missing = ca.vertcat(-chain.closure_rows, chain.missing) / chain.equation_unit
    K = chain.K * (chain.step_unit / chain.equation_unit[:, None])
    definitions: dict[str, tuple[list[Any], list[Any]]] = {
        "rows": ([*pose, chain.x], [missing, ca.vec(K), chain.alignment]),  # without units
        "bias": ([*pose, chain.v], [chain.bias]),
        "turns": ([chain.q], [ca.vertcat(*(f(chain.q[i]) for i in chain.turning for f in (ca.cos, ca.sin)))]),
        "moved": ([chain.q, chain.step], [chain.moved]),
        "modes": (pose, [chain.mode_indicators]),
        "coordinates": (pose, [chain.coordinates]),
        "project": (projected, reduced),
        "derivatives": (projected, derivatives),
        "efforts": (motion, [everything]),
        "base_wrench": (motion, [-ground]),
        "energy": (motion, [energy]),
    }
    functions = {}
    for name, (inputs, outputs) in definitions.items():
        dense = [ca.densify(part) for part in ca.cse(outputs)]
        functions[f"rp_{name}"] = ca.Function(f"rp_{name}", inputs, dense)
    return Definition(chain, functions)


def source(definition: Definition) -> str:
    """Return the C of a robot as Python calls it: generated functions, sizes and tables, driver, batches."""
    chain = definition.chain
    turning = ", ".join(map(str, chain.turning)) or "0"
    return "\n".join(
        [
            driver_source(definition, definition.functions.values()),
            f"const int rp_turning[] = {{{turning}}};",
            text_of("batch.c"),
        ]
    )


def driver_source(definition: Definition, functions: Iterable[Any], storage: str = "") -> str:
    """Return the C that closes a robot's loops: generated functions, sizes and tables, and ``driver.c``.

    With ``storage`` "static" nothing of it is seen from other files; who stands behind it calls all of it.
    """
    turns = counted_turns(definition.chain.robot)
    listed = ", ".join(map(str, turns.coordinates.tolist()))
    counted = [
        f"#define TURNS {len(turns.coordinates)}",
        f"#define COUNTED_COORDINATES {{{listed}}}",
    ]
    if len(turns.coordinates):
        angles = ", ".join(map(str, (turns.angles.astype(int) + turns.kept).tolist()))
        counted.append(f"static const int ANGLE[] = {{{angles}}};")
    return "\n".join([*tables(definition.chain, functions, storage), *counted, text_of("driver.c")])


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
        "R": len(chain.closure_scale),
        "NT": len(chain.turning),
        "NX": chain.x.numel(),
        "LEGS": chain.mode_indicators.numel(),
        "NALIGN": chain.alignment.numel(),
        "LENGTH": float(robot.characteristic_length),
        "TOLERANCE": CLOSURE_TOLERANCE,
        "LEAST_MARGIN": LEAST_MARGIN,
    }
    tables = {
        "static const int COLUMNS": chain.pose_columns,
        "static const int ACTUATED": robot.actuated_velocity,
        "static const double STEP_UNIT": chain.step_unit,
        "static const double EQUATION_UNIT": chain.equation_unit,
        "static const double POSITION_UNIT": position_unit(robot),
    }
    text = ["#include <math.h>", f"#define EXPORTED {storage}".strip(), c_functions(functions, storage)]
    text += [f"#define {name} {value!r}" for name, value in sizes.items()]
    for name, values in tables.items():
        listed = ", ".join(repr(value) for value in np.asarray(values).tolist())
        text.append(f"{name}[] = {{{listed or '0'}}};")
    return text


def text_of(name: str) -> str:
    """Return the text of a file of this package."""
    return importlib.resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


_WRITTEN = ("symbols.py", "load_symbols.py", "build.py", "emit.py", "driver.c", "batch.c")
"""Files that decide what is compiled: who changes one gets a new library."""


def key(robot: Robot, compiler: str, files: Sequence[str] = _WRITTEN, flags: Sequence[str] = FLAGS) -> str:
    """Return what tells one library from another: a hash of all that goes into it. The reference does not."""
    model = robot.model
    roles = [
        robot.closures,
        robot.couplings,
        robot.platform,
        robot.independent_joints,
        robot.actuated,
        robot.carriers,
        robot.working_modes,
    ]
    try:
        version = importlib.metadata.version("casadi")  # without the time that an import takes
    except importlib.metadata.PackageNotFoundError:
        version = str(casadi().__version__)  # installed by other means than pip, or not at all
    versions = [version, str(pin.__version__)]
    written = [*files, *(text_of(name) for name in files)]
    parts = [
        model.saveToString(),
        repr(roles),
        shape_of(robot),
        repr((robot.working_mode, robot.characteristic_length, robot.gravity.tolist())),
        *versions,
        repr(CLOSURE_TOLERANCE),
        *written,
        compiler,
        *flags,
    ]
    return digest(parts)


class Library:
    """A compiled robot: functions called with arrays.

    Args:
        path: the shared library.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.library = loaded(path)
        for name in ("rp_lift", "rp_follow", "rp_sample", "rp_map", "rp_project", "rp_terms"):
            getattr(self.library, name)  # AttributeError where the file is another one
        self.library.rp_assemble.restype = ctypes.c_double
        self.alignments, turning = (
            ctypes.c_int.in_dll(self.library, name).value for name in ("rp_alignments", "rp_turnings")
        )
        self.trigs = 2 * turning
        self._turning = list((ctypes.c_int * turning).in_dll(self.library, "rp_turning"))

    def trig_at(self, q: Array) -> Array:
        """Return (N, T) the cosines and sines at configurations (N, nq) that the functions take."""
        angles = q[:, self._turning]
        return np.stack([np.cos(angles), np.sin(angles)], axis=2).reshape(len(q), -1)

    def call(self, name: str, *arguments: object) -> int:
        """Call a function of the driver with arrays and integers."""
        return int(getattr(self.library, name)(*(_as_c(value) for value in arguments)))

    def assemble(self, q: Array, x: Array) -> float:
        """Bring q (nq), in place, to where it misses x least; return what is left."""
        return float(self.library.rp_assemble(_as_c(q), _as_c(x)))

    def map(self, name: str, samples: int, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate a generated function for many samples, the first axis of all arrays; outputs are written to."""
        pointer = ctypes.cast(getattr(self.library, name), ctypes.c_void_p)
        packed = [_pointers(arrays) for arrays in (inputs, outputs)]
        sizes = [
            (ctypes.c_long * max(len(arrays), 1))(*(array[0].size if array.strides[0] else 0 for array in arrays))
            for arrays in (inputs, outputs)
        ]
        self.library.rp_map(
            pointer, ctypes.c_long(samples), len(inputs), packed[0], sizes[0], len(outputs), packed[1], sizes[1]
        )

    def sampler(self, state: Array, given: Array, result: Array) -> Callable[[], int]:
        """Return a function that evaluates one sample from and into fixed arrays: addresses are looked up once."""
        function = self.library.rp_sample
        arguments = tuple(_as_c(array) for array in (state, given, result))

        def sample(_alive: tuple[Array, ...] = (state, given, result)) -> int:
            status: int = function(*arguments)
            return status

        return sample


def _as_c(value: object) -> object:
    return ctypes.c_void_p(value.ctypes.data) if isinstance(value, np.ndarray) else value


def _pointers(arrays: Sequence[Array]) -> Any:
    return (ctypes.c_void_p * max(len(arrays), 1))(*(array.ctypes.data for array in arrays))


def build_library(robot: Robot) -> tuple[Library | None, str]:
    """Return the compiled robot, from disk or new; or None and the reason why there is none."""
    return built_for(robot, _WRITTEN, lambda: source(define(robot)), Library)


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
