"""Inverse and forward dynamics of many samples on a GPU, by the C that the processor runs.

The text of generated code and its driver goes to NVRTC as it is (``many.c`` adds the loop over samples); cupy compiles
it when it is first used, keeps what was compiled, and holds the arrays. A sample is a thread: it starts from its own
configuration, or from the reference of its machine, and shares nothing with others.
"""

from __future__ import annotations

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any, ClassVar, Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import blocks, one_of, read_only
from redundancy_pin.dynamics.compiled.build import Code, address, carried_table, define, driver_source, text_of
from redundancy_pin.dynamics.compiled.forward import CompiledForward
from redundancy_pin.dynamics.compiled.parameters import Topology, common_topology, layout_of, parameter_vector
from redundancy_pin.errors import CompilerError, InputError, UnsupportedRobotError, optional, shortened
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot import Robot, Wrench
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.joint_ranges import range_table
from redundancy_pin.robot.loads import of_kind

Device: TypeAlias = Literal["gpu", "cpu"]

THREADS = 128
"""Threads of a block: a multiprocessor holds two blocks where each thread has all the registers that there are, 255."""

_MOST_BLOCKS = 1 << 20
"""Blocks of one launch; each thread computes further samples in a loop."""

_FUNCTIONS = ("rows", "bias", "turns", "moved", "modes", "coordinates", "drives", "project")
"""Generated functions called by ``calls.c`` and the sources before it."""

_NVRTC = (
    "#define INFINITY __longlong_as_double(0x7ff0000000000000)\n#define NAN __longlong_as_double(0x7ff8000000000000)\n"
)
"""What NVRTC lacks of math.h, whose functions it has without a header."""


_APART = "#ifdef __CUDACC__\n#define APART static __noinline__\n#else\n#define APART static\n#endif"
"""How large functions are declared: written out at every call they take NVRTC three to eight times as long (a Gough
platform a minute), and more registers than there are."""


@dataclass(frozen=True, eq=False)
class ManyTorques:
    """Efforts of N samples, from ``GpuDynamics.torque``; arrays are where the motion is: on the device, or numpy.

    Attributes:
        tau: (N, m) efforts of the main actuators, N or N·m; NaN where there are none.
        status: (N,) codes of ``SampleStatus``.
        margin: (N,) singularity margin of type II, the smallest singular value of the scaled W, no unit.
        carrier_force: (N, k) force of each carrier's actuator, N or N·m.
        residual: (N,) closure residual, m.
        serial_margin: (N,) lower bound of the distance to a type I singularity, no unit.
        state: (N, nq + 1) the ``start`` of the next call, which continues the branch of each sample: the
            configuration, carriers as at the reference, and a sign that changes across type I (0: not known).
        W, f: (N, n, m) and (N, n) the equation W τ = f that tau solves; None unless they were requested.
    """

    tau: Any
    status: Any
    margin: Any
    carrier_force: Any
    residual: Any
    serial_margin: Any
    state: Any
    W: Any = None
    f: Any = None


@dataclass(frozen=True, eq=False)
class ManyAccelerations:
    """Accelerations of N states; returned by ``GpuDynamics.acceleration``.

    Attributes:
        a: (N, nv) acceleration of the tree, m/s² and rad/s²; NaN unless the status is ok.
        status: (N,) codes of ``SampleStatus``, as of ``AccelerationSample``.
    """

    a: Any
    status: Any


class GpuDynamics:
    """Inverse and forward dynamics of many samples of one machine, or of many machines of one topology, on a GPU.

    Double precision; numbers equal ``CompiledDynamics`` up to rounding errors. Arguments are arrays of the device
    (of cupy, torch, jax: whatever has ``__dlpack__``, without a copy, in any layout) and results are cupy's, which the
    others take by DLPack; or arrays of numpy, which go to the device in blocks. Work is put on cupy's current stream:
    keep arrays of other libraries until it is done.

    Where the straight way from the start does not lead to a sample it is ``unreachable``,
    ``type_i`` or ``branch_lost``, which proves nothing: ``CompiledDynamics`` uses kinematics, which may reach it.

    Args:
        robots: the robot, or its name or path; or several of one topology, that differ in numbers.
        device: "gpu"; "cpu" compiles the same text for the processor, in one thread: to try a program without a GPU.
        threads: threads of a block, 32 to 256 by 32: each may need 255 registers, of which a block has 65,536.

    Raises:
        RedundancyPinError: cupy is not installed.
        CompilerError: there is no GPU, or the code cannot be compiled.
        UnsupportedRobotError: no main actuators; a wrench that is not constant.
        InputError: robots of different topologies.

    Example:
        >>> dynamics = rp.GpuDynamics("3rrr", device="cpu")
        >>> x = np.array([[0.5, 0.29, 0.0], [0.51, 0.29, 0.0]])
        >>> found = dynamics.torque(x, 0.1, 0.0)
        >>> found.tau.shape, found.status.tolist()
        ((2, 3), [0, 0])
    """

    def __init__(self, robots: RobotLike | Sequence[Robot], *, device: Device = "gpu", threads: int = THREADS) -> None:
        several: Sequence[Any] = robots if isinstance(robots, (list, tuple)) else [robots]
        self.robots: tuple[Robot, ...] = tuple(as_robot(each) for each in several)
        one_of(device, "device", ("gpu", "cpu"))
        one_of(threads, "threads", range(32, 257, 32))
        if not self.robots:
            raise InputError("There is no robot.", remedy="Pass at least one.")
        self.robot = robot = self.robots[0]
        if not robot.m:
            raise UnsupportedRobotError(f"{robot.name} has no main actuators.", remedy="Declare which are actuated.")
        topology = common_topology(self.robots)
        if topology is None or len({range_table(each).shape for each in self.robots}) > 1:
            raise InputError(
                f"Robots of different topologies: {', '.join(sorted({each.name for each in self.robots}))}.",
                remedy="Pass robots that differ in numbers only, and make another GpuDynamics for the others.",
            )
        self._topology: Topology = topology
        self._settings = device, threads
        self._device: _Device = _Gpu(threads) if device == "gpu" else _Cpu()
        wrenches = [[load.value for load in of_kind(each.loads, Wrench)] for each in self.robots]
        if any(not isinstance(value, np.ndarray) or value.ndim > 1 for each in wrenches for value in each):
            raise UnsupportedRobotError(
                f"A wrench on {robot.name} changes with time or motion.",
                remedy="Take its values as constant wrenches of several machines, or use CompiledDynamics.",
            )
        vectors = [parameter_vector(each, topology) for each in self.robots]
        tables = vectors, wrenches, map(range_table, self.robots)
        rows = (np.array([*table], dtype=np.float64).reshape(len(self.robots), -1) for table in tables)
        self._machines, self._wrenches, self._ranges = map(self._device.xp.asarray, rows)
        self._compiled: dict[type[_Many], Any] = {}
        self._device.wait()  # calls may be on other streams than this one

    def __reduce__(self) -> tuple[Any, ...]:
        """Rebuild it, from compiled code, when it is copied or sent."""
        device, threads = self._settings
        return partial(type(self), device=device, threads=threads), (self.robots,)

    def __repr__(self) -> str:
        """Return the robot, and how many machines there are."""
        return f"GpuDynamics({self.robot!r}, {len(self.robots)} machine(s))"

    def _code(self, kind: type[_Many]) -> Any:
        if kind not in self._compiled:
            self._compiled[kind] = self._device.compiled(kind, self._topology)
        return self._compiled[kind]

    @cached_property
    def _references(self) -> Any:
        """States of all machines at their references (machines, nq + 1); raises InputError where one does not close."""
        states = self._device.xp.asarray(np.array([np.append(each.q_reference, 0.0) for each in self.robots]))
        found = self._device.xp.empty(len(self.robots), dtype=np.int32)
        code, count = self._code(_ManyEfforts), len(self.robots)
        self._device.launch(code, "rp_many_references", count, self._machines, states, found)
        for machine in np.flatnonzero(self._device.host(found))[:1]:
            raise InputError(
                f"The loops of machine {machine}, {self.robots[machine].name}, do not close at its reference.",
                remedy="Change its q_reference, or load it again with its own lengths.",
            )
        return states

    def torque(
        self,
        x: Any,
        xd: Any,
        xdd: Any,
        s: Any = 0.0,
        sd: Any = 0.0,
        sdd: Any = 0.0,
        *,
        start: Any = None,
        machine: Any = None,
        equations: bool = False,
    ) -> ManyTorques:
        """Return the efforts of N independent samples, with statuses; each as of ``Dynamics.torque``.

        Args:
            x: (N, n) coordinates, m and rad, or (N, 4, 4) poses.
            xd: (N, n) their rates, as ``PlatformMotion`` has them; (n,) or a number for all samples.
            xdd: (N, n) the rates of these.
            s: (N, k) positions of the carriers, m or rad; (k,) or a number for all samples.
            sd: (N, k) their velocities.
            sdd: (N, k) their accelerations.
            start: (N, nq + 1) states to continue from, ``ManyTorques.state`` of nearby samples, in the working mode
                of the machine; the machine's reference when left out.
            machine: (N,) of which of the robots a sample is; the first when left out.
            equations: also return W and f.

        Raises:
            InputError: shapes; a machine that there is not; a reference that does not close.
        """
        robot, n, k = self.robot, self.robot.n, self.robot.k
        state = (robot.model.nq + 1,)
        given = {"x": (x, (4, 4) if is_pose(robot) else (n,)), "xd": (xd, (n,)), "xdd": (xdd, (n,))}
        given |= {"s": (s, (k,)), "sd": (sd, (k,)), "sdd": (sdd, (k,)), "start": (start, state)}
        wanted: dict[str, tuple[int, ...] | None] = {
            "tau": (robot.m,), "carrier_force": (k,), "residual": (), "serial_margin": (), "margin": (), "state": state,
            "W": (n, robot.m) if equations else None, "f": (n,) if equations else None,
        }  # fmt: skip
        tables = self._machines, self._wrenches, self._references, self._ranges, np.int32(self._ranges.shape[1] // 5)
        return ManyTorques(**self._many(_ManyEfforts, given, wanted, machine, tables))

    def acceleration(
        self, q: Any, v: Any, tau: Any, carrier_force: Any = 0.0, *, machine: Any = None
    ) -> ManyAccelerations:
        """Return the accelerations of N closed states, with statuses; each as of ``Dynamics.acceleration``.

        Args:
            q: (N, nq) closed configurations of the tree, as Pinocchio has them: carriers included.
            v: (N, nv) velocities that keep them closed.
            tau: (N, m) efforts of the main actuators, N or N·m; (m,) or a number for all states.
            carrier_force: (N, k) forces of the carriers' actuators, N or N·m; (k,) or a number for all.
            machine: (N,) of which of the robots a state is; the first when left out.

        Raises:
            InputError: shapes; a machine that there is not.
        """
        model = self.robot.model
        given = {"q": (q, (model.nq,)), "v": (v, (model.nv,)), "tau": (tau, (self.robot.m,))}
        given["carrier_force"] = carrier_force, (self.robot.k,)
        tables = self._machines, self._wrenches
        wanted: dict[str, tuple[int, ...] | None] = {"a": (model.nv,)}
        found = self._many(_ManyAccelerations, given, wanted, machine, tables)
        return ManyAccelerations(**found)

    def _many(
        self,
        kind: type[_Many],
        given: Mapping[str, tuple[Any, tuple[int, ...]]],
        wanted: Mapping[str, tuple[int, ...] | None],
        machine: Any,
        tables: Sequence[Any],
    ) -> dict[str, Any]:
        """Return results by name, None where not wanted; the first of ``given`` says how many samples there are."""
        device, first = self._device, next(iter(given.values()))[0]
        axes = first.ndim if hasattr(first, "ndim") else np.ndim(first)
        if axes != len(next(iter(given.values()))[1]) + 1:
            raise InputError(
                f"{next(iter(given))} has {axes} axes.", remedy="Pass a row for each sample, x[None] for one."
            )
        on_host, samples = isinstance(first, (np.ndarray, list, tuple)), len(first)
        arrays = {"machine": (machine, ()), **given}
        taken = {each: _taken(np if on_host else device.xp, value, each, (samples, *size))
                 for each, (value, size) in arrays.items()}  # fmt: skip
        which = taken.pop("machine")
        if which is not None and which.dtype.kind not in "iu":
            raise InputError("machine has numbers that are not whole.", remedy="Pass integers, from 0.")
        if which is not None and samples and not 0 <= int(which.min()) <= int(which.max()) < len(self.robots):
            raise InputError("machine has a number of no robot.", remedy=f"Pass 0 to {len(self.robots) - 1}.")
        parts: list[dict[str, Any]] = []
        for part in (on_host and blocks(samples, _BLOCK)) or [slice(0, samples)]:
            now = {each: _part(array, part) for each, array in taken.items()}
            found = self._launched(kind, now, wanted, _part(which, part), tables, part.stop - part.start)
            # on the host at once: the device need not hold the results of all parts
            parts.append(
                {each: device.host(one) if on_host and one is not None else one for each, one in found.items()}
            )
        if not on_host:
            return parts[0]
        columns = {each: [part[each] for part in parts] for each in parts[0]}
        return {each: None if rows[0] is None else read_only(np.concatenate(rows)) for each, rows in columns.items()}

    def _launched(
        self,
        kind: type[_Many],
        given: dict[str, Any],
        wanted: Mapping[str, tuple[int, ...] | None],
        which: Any,
        tables: Sequence[Any],
        samples: int,
    ) -> dict[str, Any]:
        """Return results of samples that fit in the memory of the device, whose arrays are there or go there."""
        device, xp = self._device, self._device.xp
        # entries of all samples stand side by side, so that the threads of a warp write to neighbours
        results = {each: None if size is None else xp.moveaxis(xp.empty((*size, samples)), -1, 0)
                   for each, size in wanted.items()}  # fmt: skip
        arrays = given | results
        flat = [_flat(xp, arrays[each]) for each in kind.columns]  # named: the launch needs their memory
        columns = xp.asarray(np.array([device.column(array) for array in flat], dtype=np.int64))
        status = xp.empty(samples, dtype=np.int32)
        which = None if which is None else xp.ascontiguousarray(xp.asarray(which, dtype=np.int32))
        if samples:
            device.launch(self._code(kind), kind.name, samples, columns, which, status, *tables)
        return {**results, "status": status}


_BLOCK = 1 << 20
"""Samples of numpy's arrays that are on the device at a time: 1 GB of arguments and results for a Gough platform."""


def _part(array: Any, part: slice) -> Any:
    return None if array is None else array[part]


def _flat(xp: Any, array: Any) -> Any:
    """Return an array of at most two axes, samples first, on the device; a view where its strides are whole doubles."""
    if array is None or not array.size:
        return None
    array = xp.asarray(array)
    array = array.reshape(len(array), -1) if array.ndim > 2 else array
    return xp.ascontiguousarray(array) if any(stride % array.itemsize for stride in array.strides) else array


def _taken(xp: Any, value: Any, name: str, shape: tuple[int, ...]) -> Any:
    """Return an argument as an array of its shape, one for all samples repeated without a copy; None as it is."""
    if value is None and name in ("start", "machine"):
        return None
    try:
        is_foreign = xp is not np and hasattr(value, "__dlpack__") and not isinstance(value, (np.ndarray, xp.ndarray))
        array = xp.from_dlpack(value) if is_foreign else xp.asarray(value)
        if array.dtype.kind not in "biuf":
            raise TypeError(f"it holds {array.dtype}")
        array = array if name == "machine" else array.astype(np.float64, copy=False)
        if array.ndim == 0 or array.shape in (shape, shape[1:]):
            return xp.broadcast_to(array, shape)
    except (TypeError, ValueError, RuntimeError, BufferError) as error:
        raise InputError(
            f"{name} is not an array of numbers on the device of the first argument: {error}.",
            remedy="Pass all arrays from one device, in real numbers.",
            name=name,
        ) from error
    raise InputError(
        f"{name} has shape {array.shape}, not {shape}.", remedy="Pass a row for each sample, or one for all.", name=name
    )


class _Many(Code):
    """A function of C that takes many samples.

    Attributes:
        name: of the function.
        columns: its quantities, arguments and results, in the order in which it takes them.
    """

    name: ClassVar[str]
    columns: ClassVar[tuple[str, ...]]

    @classmethod
    def loop(cls, topology: Topology) -> str:
        """Return the text of the loop over samples."""
        numbers = layout_of(topology).size
        return f"#define NUMBERS {numbers}\nenum {{ {', '.join(cls.columns).upper()} }};\n{text_of('many.c')}"


class _ManyEfforts(_Many):
    """Inverse dynamics of many samples."""

    name = "rp_many_efforts"
    columns = ("x", "xd", "xdd", "s", "sd", "sdd", "start",
               "tau", "carrier_force", "residual", "serial_margin", "margin", "state", "W", "f")  # fmt: skip

    @staticmethod
    def source(topology: Topology) -> str:
        """Return the text for NVRTC and for a compiler of C."""
        definition = define(topology)
        used = [definition.functions[f"rp_{name}"] for name in _FUNCTIONS]
        driver = driver_source(definition, used, "APART"), carried_table(topology.robot)
        return "\n".join([_APART, *driver, *map(text_of, ("sample.c", "calls.c")), _ManyEfforts.loop(topology)])


class _ManyAccelerations(_Many):
    """Forward dynamics of many states."""

    name = "rp_many_accelerations"
    columns = ("q", "v", "tau", "carrier_force", "a")
    flags: ClassVar[tuple[str, ...]] = CompiledForward.flags

    @staticmethod
    def source(topology: Topology) -> str:
        """Return the text for NVRTC and for a compiler of C."""
        return f"{CompiledForward.dynamics_source(topology)}\n#define FORWARD\n{_ManyAccelerations.loop(topology)}"


# --- devices ----------------------------------------------------------------------------------------------------------


class _Device(ABC):
    """Where samples are computed: arrays, and functions of C with arrays, numbers of numpy or None as arguments."""

    xp: Any

    @abstractmethod
    def compiled(self, kind: type[Code], topology: Topology) -> Any:
        """Return compiled code; raises CompilerError."""

    @abstractmethod
    def launch(self, code: Any, name: str, samples: int, *arguments: Any) -> None:
        """Call a function of compiled code for many samples."""

    @abstractmethod
    def address(self, array: Any) -> int:
        """Return where an array is in the memory of the device."""

    def host(self, array: Any) -> NDArray[Any]:
        """Return an array as one of numpy."""
        return np.asarray(array)

    @abstractmethod
    def wait(self) -> None:
        """Wait until the device has finished the submitted work."""

    def column(self, array: Any) -> tuple[int, int, int]:
        """Return the ``Column`` of an array, the samples along its first axis: address and strides, in doubles."""
        if array is None:
            return (0, 0, 0)
        sample, *entry = (stride // array.itemsize for stride in array.strides)
        return (self.address(array), sample, *(entry or (0,)))


class _Cpu(_Device):
    """The processor, in one thread."""

    xp = np

    def compiled(self, kind: type[Code], topology: Topology) -> ctypes.CDLL:
        return kind.library_of(topology)

    def launch(self, code: ctypes.CDLL, name: str, samples: int, *arguments: Any) -> None:
        given = [
            address(one) if isinstance(one, np.ndarray) else None if one is None else ctypes.c_int(one)
            for one in arguments
        ]
        getattr(code, name)(ctypes.c_longlong(samples), *given)

    def address(self, array: Any) -> int:
        return int(array.ctypes.data)

    def wait(self) -> None:
        """Return: it is done when a call returns."""


class _Gpu(_Device):
    """The current GPU of cupy.

    Args:
        threads: of a block.

    Raises:
        RedundancyPinError: cupy is not installed.
        CompilerError: there is no GPU.
    """

    def __init__(self, threads: int) -> None:
        instead = "Without a GPU, CompiledDynamics has the same numbers, and device='cpu' the same calls."
        self.xp = optional("cupy", "Dynamics on a GPU need", f"Run `pip install 'redundancy_pin[gpu]'`. {instead}")
        self._threads = threads
        try:
            found = self.xp.cuda.runtime.getDeviceCount()
        except self.xp.cuda.runtime.CUDARuntimeError as error:
            raise CompilerError(f"There is no GPU of NVIDIA here ({error}).", remedy=instead) from error
        if not found:
            raise CompilerError("There is no GPU of NVIDIA here.", remedy=instead)

    def compiled(self, kind: type[Code], topology: Topology) -> Any:
        try:
            module = self.xp.RawModule(code=gpu_source(kind.source(topology)))
            module.compile()
        except Exception as error:  # what may be missing or fail has no class in common: NVRTC, headers, the driver
            raise CompilerError(
                f"NVRTC failed: {shortened(str(error))}.",
                remedy="Run `pip install 'redundancy_pin[gpu]'`, and compare the versions of CUDA and of the driver.",
            ) from error
        return module

    def launch(self, code: Any, name: str, samples: int, *arguments: Any) -> None:
        given = [np.uintp(0) if one is None else one for one in arguments]
        grid = min(-(-samples // self._threads), _MOST_BLOCKS)
        code.get_function(name)((grid,), (self._threads,), (np.int64(samples), *given))

    def address(self, array: Any) -> int:
        return int(array.data.ptr)

    def wait(self) -> None:
        self.xp.cuda.get_current_stream().synchronize()

    def host(self, array: Any) -> NDArray[Any]:
        found: NDArray[Any] = self.xp.asnumpy(array)
        return found


def gpu_source(text: str) -> str:
    """Return the C of this package as NVRTC takes it: without headers, which are built in, except two numbers."""
    return f"{_NVRTC}{text.replace('#include <math.h>', '')}"
