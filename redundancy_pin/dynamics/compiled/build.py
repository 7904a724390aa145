"""From a robot to machine code: C by casadi plus the driver, compiled and cached by ``machine_code``.

A library's name is a hash of all that goes into it: the topology of the robot, the versions of casadi and Pinocchio,
the texts of this package, the compiler and its flags. Numbers of the robot are no part of it: they are arguments
(``parameters``), and robots that differ in them share a library.
"""

from __future__ import annotations

import ctypes
import functools
import importlib.metadata
import importlib.resources
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import (
    AGREEMENT_TOLERANCE,
    CLOSURE_TOLERANCE,
    NEAR_SINGULAR_MARGIN,
    RANK_TOLERANCE,
    ROUNDED_SHARE,
    SINGULAR_MARGIN,
    Array,
)
from redundancy_pin.dynamics.allocation import FORCE_TOLERANCE
from redundancy_pin.dynamics.compiled.emit import c_functions
from redundancy_pin.dynamics.compiled.parameters import Topology, parameter_vector, topology_of
from redundancy_pin.dynamics.compiled.symbols import SymbolicChain, ca
from redundancy_pin.dynamics.distribution import CONSISTENCY_TOLERANCE
from redundancy_pin.dynamics.forward import LEAST_INERTIA
from redundancy_pin.dynamics.results import TERMS
from redundancy_pin.errors import CompilerError
from redundancy_pin.machine_code import CACHE, FLAGS, REMEDY, built, digest, loaded
from redundancy_pin.motion import POSE_TOLERANCE
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.whole_turns import EXACT, FARTHEST, MOST_TURNS, TURN, WHOLE, counted_turns
from redundancy_pin.status import SampleStatus

NEIGHBOURS = 8
"""Configurations from the nearest of which a batch of carrier terms begins: first and last of each of four batches; a
control update has two or three."""

_CONSTANTS = {
    "NEIGHBOURS": NEIGHBOURS,
    "TERMS": TERMS,
    "TOLERANCE": CLOSURE_TOLERANCE,
    "AGREEMENT": AGREEMENT_TOLERANCE,
    "SINGULAR_MARGIN": SINGULAR_MARGIN,
    "RANK_TOLERANCE": RANK_TOLERANCE,
    "NEAR_SINGULAR": NEAR_SINGULAR_MARGIN,
    "CONSISTENCY_TOLERANCE": CONSISTENCY_TOLERANCE,
    "FORCE_TOLERANCE": FORCE_TOLERANCE,
    "POSE_TOLERANCE": POSE_TOLERANCE,
    "ROUNDED_SHARE": ROUNDED_SHARE,
    "ROUNDED_MARGIN": float(np.cbrt(ROUNDED_SHARE)),
    "LEAST_INERTIA": LEAST_INERTIA,
    "EPSILON": float(np.finfo(float).eps),
    "TURN": TURN,
    "MOST_TURNS": MOST_TURNS,
    "WHOLE": WHOLE,
    "EXACT": EXACT,
    "FARTHEST": FARTHEST,
}
"""Constants of the package that the C takes over, by their names there."""

_STATUSES = ", ".join(f"STATUS_{status.name} = {int(status)}" for status in SampleStatus)


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


def define(of: Robot | Topology) -> Definition:
    """Write the functions of a topology, or a robot's. Matrices are laid out row by row, except K, column by column."""
    return _defined(of if isinstance(of, Topology) else topology_of(of))


@functools.lru_cache(maxsize=8)
def _defined(topology: Topology) -> Definition:
    robot, chain = topology.robot, SymbolicChain(topology.robot, topology)
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
    rows, columns, _ = _blocks(chain)
    K = ca.diag(1.0 / chain.equation_unit) @ chain.K @ ca.diag(chain.step_unit)
    definitions: dict[str, tuple[list[Any], list[Any]]] = {
        "rows": ([*pose, chain.x], [missing, ca.vec(K[rows, columns]), chain.alignment]),  # without units
        "bias": ([*pose, chain.v], [chain.bias]),
        **tree_functions(chain),
        "coordinates": (pose, [chain.coordinates]),
        "drives": ([chain.q, positions], [_missed(chain, positions)]),
        "project": (projected, reduced),
        "derivatives": (projected, derivatives),
        "carrier_terms": ([*tree, gamma, chain.external], _carrier_terms(ca.vertcat(*reduced), carriers, robot.n)),
        "base_wrench": (motion, [-ground]),
        "energy": (motion, [energy]),
    }
    return Definition(chain, functions_of(chain, definitions))


def _carrier_terms(whole: Any, carriers: list[Any], n: int) -> list[Any]:
    """Return f and forces (n + k) with the carriers at rest at s = 0, and the terms (k, 5, n + k) of ``CarrierTerms``.

    The terms are Taylor coefficients: exact on straight tracks, where forces have no others.
    """
    terms: list[Any] = []
    s, sd, sdd = carriers
    for c in range(s.numel()):
        by_s, by_sd, by_sdd = (ca.jacobian(whole, part[c]) for part in (s, sd, sdd))
        for term in (by_s, 0.5 * ca.jacobian(by_s, s[c]), by_sd, ca.jacobian(by_sd, s[c]), by_sdd):
            own = ca.SX(whole.numel(), 1)
            own[[*range(n), n + c]] = term[[*range(n), n + c]]
            terms.append(own)
    at_rest = ca.substitute([whole, ca.vertcat(ca.SX(0, 1), *terms)], carriers, [ca.SX.zeros(s.numel())] * 3)
    return list(at_rest)


def tree_functions(chain: SymbolicChain) -> dict[str, tuple[list[Any], list[Any]]]:
    """Return arguments and results of the functions that both libraries have: ``tree.c`` calls them, and modes."""
    turns = ca.vertcat(*(function(chain.q[i]) for i in chain.turning for function in (ca.cos, ca.sin)))
    return {
        "turns": ([chain.q], [turns]),
        "moved": ([chain.q, chain.step], [chain.moved]),
        "modes": ([chain.q, chain.trig], [chain.mode_indicators]),
    }


def functions_of(chain: SymbolicChain, definitions: Mapping[str, tuple[list[Any], list[Any]]]) -> dict[str, Any]:
    """Return casadi Functions with dense results; numbers of the robot, where one needs any, are its last argument."""
    functions = {}
    for name, (inputs, outputs) in definitions.items():
        dense = [ca.densify(part) for part in ca.cse(outputs)]
        depends = ca.depends_on(ca.veccat(*dense), chain.parameters)
        functions[f"rp_{name}"] = ca.Function(f"rp_{name}", [*inputs, chain.parameters] if depends else inputs, dense)
    return functions


def bind(function: Any, robot: Robot) -> Any:
    """Return a function of a definition with the numbers of a robot in it, which are no arguments any more."""
    vector = parameter_vector(robot)
    count = function.n_in() - 1
    if function.numel_in(count) != len(vector) or not function.name_in(count):
        return function
    inputs = [ca.SX.sym(f"i{i}", function.size1_in(i), function.size2_in(i)) for i in range(count)]
    return ca.Function(function.name(), inputs, function.call([*inputs, ca.SX(vector)]))


def _missed(chain: SymbolicChain, positions: Any) -> Any:
    """Return (m,) how far the main actuators are from their positions, m and rad."""
    missed = []
    for i, name in enumerate(chain.robot.actuated):
        joint = find_joint(chain.robot.model, name)
        q = chain.q[joint.idx_q : joint.idx_q + joint.nq]
        if joint.nq == 1:
            missed.append(positions[i] - q)
        else:  # cosine and sine: the angle of the turn from one to the other
            c, s = ca.cos(positions[i]), ca.sin(positions[i])
            missed.append(ca.atan2(s * q[0] - c * q[1], c * q[0] + s * q[1]))
    return ca.vertcat(ca.SX(0, 1), *missed)


def _blocks(chain: SymbolicChain) -> tuple[list[int], list[int], list[tuple[int, int, int]]]:
    """Return rows and columns of K in the order in which it is block triangular, and the blocks on its diagonal.

    Of a block come the first row, the size, and the end of the rows in which its columns are not zero.
    """
    pattern = chain.K.sparsity()
    _, rows, columns, starts, ends, *_ = pattern.btf()
    if starts != ends:  # a structure that has no inverse
        rows = columns = list(range(len(chain.pose_columns)))
        starts = [0, len(rows)]
    filled = np.array(ca.DM(pattern, 1.0))[np.ix_(rows, columns)] != 0.0
    reached = [int(np.flatnonzero(filled[:, first:end].any(axis=1))[-1]) + 1 for first, end in pairwise(starts)]
    sizes = np.diff(starts).tolist()
    return rows, columns, list(zip(starts, sizes, reached, strict=False))


def driver_source(definition: Definition, functions: Iterable[Any], storage: str = "") -> str:
    """Return the C that closes a robot's loops: generated functions, sizes and tables, and ``driver.c``.

    With ``storage`` "static" its functions are not visible in other files; the including code must call all of them.
    """
    chain = definition.chain
    turns = counted_turns(chain.robot)
    listed = ", ".join(map(str, turns.coordinates.tolist()))
    counted = [
        f"#define TURNS {len(turns.coordinates)}",
        f"#define COUNTED_COORDINATES {{{listed}}}",
    ]
    rows, columns, blocks = _blocks(chain)
    places = {"static const int ROW_PLACE": np.argsort(rows), "static const int COLUMN_PLACE": np.argsort(columns)}
    counted += [_table(name, values) for name, values in places.items()]
    counted += [f"#define EACH_BLOCK {' '.join(f'BLOCK{block}' for block in blocks)}"]
    if len(turns.coordinates):
        angles = ", ".join(map(str, (turns.angles.astype(int) + turns.kept).tolist()))
        counted.append(f"static const int ANGLE[] = {{{angles}}};")
    return "\n".join([*tables(chain, functions, storage), *counted, text_of("driver.c")])


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
    }
    tables = {
        "static const int COLUMNS": chain.pose_columns,
        "static const int ACTUATED": robot.actuated_velocity,
        "static const int CARRIERS": robot.carrier_velocity,
    }
    text = ["#include <math.h>", c_functions(functions, storage)]
    text += [f"#define {name} {value!r}" for name, value in {**sizes, **_CONSTANTS}.items()]
    text += [f"enum {{ {_STATUSES}, STATUSES }};", *chain.layout.macros]
    return [*text, *(_table(name, values) for name, values in tables.items()), text_of("tree.c")]


def carried_table(robot: Robot) -> str:
    """Return the C of one more table, the indices of the carriers in q, which controllers do not need."""
    return _table("static const int CARRIED", robot.carrier_position)


def text_of(name: str) -> str:
    """Return the text of a file of this package."""
    return importlib.resources.files(__package__).joinpath(name).read_text(encoding="utf-8")


# --- libraries --------------------------------------------------------------------------------------------------------


@functools.cache  # nothing that is loaded is ever unloaded
def _library_of(
    kind: str,
    source: Callable[[Topology], str],
    flags: tuple[str, ...],
    topology: Topology,
    _environment: tuple[str | None, ...],
) -> ctypes.CDLL:
    """Return a compiled library of a topology: the one of this process, that on disk, or a new one."""
    library, reason = built(
        lambda compiler: digest([kind, topology.text, *_sources(), compiler, *flags]),
        lambda: source(topology),
        loaded,
        flags,
    )
    if library is None:
        raise CompilerError(f"Generated code cannot be compiled: {reason}.", remedy=REMEDY)
    return library


@functools.cache
def _sources() -> tuple[str, ...]:
    """Return the cache key besides the topology: versions, constants, and the source texts of this package."""
    folder = importlib.resources.files(__package__)
    names = sorted(file.name for file in folder.iterdir() if file.name.endswith((".py", ".c")))
    versions = importlib.metadata.version("casadi"), str(pin.__version__)  # without the time that an import takes
    return (*versions, repr(_CONSTANTS), _STATUSES, *names, *map(text_of, names))


class Code(ABC):
    """A compiled topology with the numbers of one robot; a class for each kind of library.

    Args:
        robot: the robot.

    Attributes:
        flags: of the compiler.
        robot: the robot.
        library: its functions, the same object for all robots of the topology.
        numbers: the address of the robot's ``parameters.parameter_vector``, the first argument of the functions.

    Raises:
        CompilerError: there is no C compiler, or it fails.
        UnsupportedRobotError: a joint of a type that is not covered.
    """

    flags: ClassVar[tuple[str, ...]] = FLAGS

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self.library = self.library_of(topology_of(robot))
        self._numbers = parameter_vector(robot)
        self.numbers = address(self._numbers)

    def __reduce__(self) -> tuple[Any, ...]:
        """Load it again, from the cache, when it is copied or sent."""
        return type(self), (self.robot,)

    @classmethod
    def library_of(cls, topology: Topology) -> ctypes.CDLL:
        """Return the compiled functions of a topology."""
        # another compiler or folder, named while the process runs, counts from then on
        environment = tuple(map(os.environ.get, ("CC", "PATH", CACHE)))
        return _library_of(cls.__name__, cls.source, cls.flags, topology, environment)

    @staticmethod
    @abstractmethod
    def source(topology: Topology) -> str:
        """Return the C of a topology."""

    def call(self, name: str, *arguments: object) -> int:
        """Call a function of the library with arrays, which must be contiguous, and numbers of ctypes or integers."""
        given = [address(value) if isinstance(value, np.ndarray) else value for value in arguments]
        return int(getattr(self.library, name)(self.numbers, *given))


def address(array: Array) -> ctypes.c_void_p:
    """Return where an array is in memory; who keeps the address has to keep the array."""
    return ctypes.c_void_p(array.ctypes.data)


class Library(Code):
    """Inverse dynamics and the closing of loops of one robot: functions called with arrays."""

    @staticmethod
    def source(topology: Topology) -> str:
        """Return the C that Python calls: generated functions, sizes and tables, driver, batches."""
        definition = define(topology)
        driver = driver_source(definition, definition.functions.values())
        texts = map(text_of, ("sample.c", "calls.c", "terms.c", "batch.c"))
        return "\n".join([driver, carried_table(topology.robot), "#define SHARED", *texts])

    def map(self, name: str, samples: int, inputs: Sequence[Array], outputs: Sequence[Array]) -> None:
        """Evaluate a generated function for many samples, the first axis of all arrays; outputs are written to."""
        arguments: list[Any] = []
        for arrays in (inputs, outputs):
            count = len(arrays)
            strides = (array[0].size if array.strides[0] else 0 for array in arrays)
            arguments += [count, (ctypes.c_void_p * count)(*(array.ctypes.data for array in arrays))]
            arguments.append((ctypes.c_long * count)(*strides))
        function = ctypes.cast(getattr(self.library, name), ctypes.c_void_p)
        self.library.rp_map(self.numbers, function, ctypes.c_long(samples), *arguments)
