"""One sample per call, for control loops: torques, accelerations and joint states in fixed memory.

A call copies its arguments to where compiled code expects them, runs it, and copies the results: about a microsecond
more than the code itself. Buffers and their addresses are made once, and only results are allocated. The code holds the
interpreter's lock, for it takes microseconds, and a thread that gave the lock up might wait milliseconds for it. Each
thread has its own buffers, and its own configuration from which Newton's method starts at the next sample.
"""

from __future__ import annotations

import ctypes
from collections.abc import Callable, Mapping
from functools import partial
from itertools import pairwise
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked
from redundancy_pin.dynamics.base import AccelerationSample, JointStateSample, TorqueSample
from redundancy_pin.dynamics.compiled.forward import CompiledForward
from redundancy_pin.errors import (
    InputError,
    SingularPoseError,
    UnreachablePoseError,
    UnsupportedRobotError,
    WorkingModeError,
)
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot, Wrench
from redundancy_pin.robot.joint_ranges import range_table
from redundancy_pin.robot.loads import of_kind, wrench_values
from redundancy_pin.robot.named import is_pose, too_few_motors
from redundancy_pin.status import SampleStatus

_STATUSES = tuple(SampleStatus)
"""By code: an index takes a fifth of the time of ``SampleStatus(code)``."""

_WITHOUT_RESULT = frozenset(
    {
        SampleStatus.UNREACHABLE,
        SampleStatus.BRANCH_LOST,
        SampleStatus.TYPE_I,
        SampleStatus.TYPE_II,
        SampleStatus.NOT_FINITE,
    }
)
"""Statuses of samples that the C writes no results of."""

_OPTIONAL = frozenset({"s", "sd", "sdd", "carrier_force", "velocity"})
"""Arguments that are zero where they are left out, and that one number may stand for."""

_LEFT_OUT: tuple[()] = ()
"""Default of arguments of carriers; there is one empty tuple."""

_NEEDS_CONVERTING = (TypeError, ValueError, AttributeError)
"""What ``_Arguments.views`` raise for lists, other numbers than doubles, and arguments that are left out."""


class _Arguments:
    """Arguments of a call, one behind the other in memory that stays where it is.

    Args:
        shapes: the shape of each argument by name.
    """

    def __init__(self, shapes: Mapping[str, tuple[int, ...]]) -> None:
        self._shapes = shapes
        ends = np.cumsum([0, *(int(np.prod(shape)) for shape in shapes.values())]).tolist()
        self.memory = np.zeros(ends[-1])
        self.parts = [self.memory[a:b] for a, b in pairwise(ends)]
        # a view takes arrays of doubles of its own length and refuses all else, in half the time of numpy's assignment
        self.views: list[Any] = [memoryview(cast(Any, part)) for part in self.parts]

    def convert(self, *values: ArrayLike) -> None:
        """Copy arguments of any kind.

        Raises:
            InputError: one of them does not have its shape. Numbers that are not finite are left to the call.
        """
        for part, value, (name, shape) in zip(self.parts, values, self._shapes.items(), strict=False):
            try:
                given = np.asarray(value, dtype=np.float64)
            except (TypeError, ValueError):
                given = checked(value, name, shape)  # raises, and says why
            if value is None:  # which numpy takes for NaN
                checked(value, name, shape)
            if name in _OPTIONAL and (given.ndim == 0 or not given.size):
                given = np.full(shape, 0.0 if given.ndim else given)
            if given.shape != shape:
                checked(np.nan_to_num(given), name, shape)
            part[:] = given.ravel()


class Code(Protocol):
    """A compiled topology and the address of the numbers of one robot."""

    library: ctypes.CDLL
    numbers: ctypes.c_void_p


def _caller(code: Code, name: str, *arguments: Any) -> Callable[[], int]:
    """Return a function of a library with its arguments, that holds the interpreter's lock; arrays give addresses."""
    function = ctypes.PyDLL(code.library._name, handle=code.library._handle)[name]
    given = [ctypes.c_void_p(value.ctypes.data) if isinstance(value, np.ndarray) else value for value in arguments]
    return partial(function, code.numbers, *given)


class TorqueCall:
    """Torques of one sample; see ``Dynamics.torque``.

    Args:
        robot: the robot.
        code: its compiled dynamics.
        find: returns a configuration (nq,) that is closed at a motion of one sample, or raises what is wrong with it.
            It is called where Newton's method does not get there from the sample before.
    """

    def __init__(self, robot: Robot, code: Code, find: Callable[[PlatformMotion], Array]) -> None:
        n, m, k, wrenches = robot.n, robot.m, robot.k, 6 * len(of_kind(robot.loads, Wrench))
        if not m:
            raise InputError(f"{robot.name} has no main actuators.", remedy="Declare which joints are actuated.")
        self._robot, self._find, self._loaded = robot, find, bool(wrenches)
        self._code = code  # which keeps its numbers
        self._carriers, self._none = bool(k), np.zeros(k)
        self._pose, self._shape = is_pose(robot), (4, 4) if is_pose(robot) else (n,)
        sizes = (self._shape, (n,), (n,), (k,), (k,), (k,), (wrenches,))
        self._arguments = _Arguments(dict(zip(("x", "xd", "xdd", "s", "sd", "sdd", "wrench"), sizes, strict=True)))
        self._x, self._xd, self._xdd, self._s, self._sd, self._sdd, _ = self._arguments.views
        force, tau = n * m + n, n * m + n + k + 2
        self._results = np.zeros(tau + m + 3)
        self._force, self._tau = self._results[force : force + k], self._results[tau : tau + m]
        self._margin, self._residual = (partial(self._results.item, k) for k in (tau + m + 1, force + k))
        self._state, self._ranges = np.append(robot.q_reference, 0.0), range_table(robot)
        given = self._state, self._arguments.memory, self._ranges, len(self._ranges), self._results
        self._call = _caller(code, "rp_torque", *given)

    def __call__(
        self,
        x: Any,
        xd: Any,
        xdd: Any,
        s: Any,
        sd: Any,
        sdd: Any,
        t: float,
        start: ArrayLike | None,
    ) -> TorqueSample:
        """Return the torques; see ``Dynamics.torque``."""
        try:
            self._x[:] = x.ravel() if self._pose else x
            self._xd[:], self._xdd[:] = xd, xdd
            if self._carriers:
                none = self._none
                self._s[:] = none if s is _LEFT_OUT else s
                self._sd[:] = none if sd is _LEFT_OUT else sd
                self._sdd[:] = none if sdd is _LEFT_OUT else sdd
        except _NEEDS_CONVERTING:
            self._arguments.convert(x, xd, xdd, s, sd, sdd)
        if self._loaded:
            given = np.concatenate(self._arguments.parts[:-1])
            if not (np.isfinite(given).all() and np.isfinite(t)):  # a wrench may be a function of time and motion
                self._results.fill(np.nan)
                return self._result(SampleStatus.NOT_FINITE)
            at = self._motion(t)
            wrenches = wrench_values(self._robot.loads, at.t, at.x, at.xd)
            self._arguments.parts[-1][:] = np.concatenate(wrenches, axis=1)[0]
        if start is not None:
            self._state[:-1], self._state[-1] = checked(start, "start", self._robot.q_reference.shape), 0.0
        status = _STATUSES[self._call()]
        if status is SampleStatus.BRANCH_LOST:
            status = self._find_elsewhere(t)
        if status in _WITHOUT_RESULT:
            self._results.fill(np.nan)
        return self._result(status)

    def _result(self, status: SampleStatus) -> TorqueSample:
        return TorqueSample(self._tau.copy(), status, self._margin(), self._force.copy(), self._residual())

    def _motion(self, t: float) -> PlatformMotion:
        x, xd, xdd, *_ = self._arguments.parts
        return PlatformMotion(np.array([t]), x.reshape(1, *self._shape), xd[None], xdd[None], check_rates=False)

    def _find_elsewhere(self, t: float) -> SampleStatus:
        """Evaluate the sample from a configuration that kinematics finds; return what is wrong where it finds none."""
        if not np.isfinite(self._arguments.memory).all():
            return SampleStatus.NOT_FINITE
        try:
            self._state[:-1], self._state[-1] = self._find(self._motion(t)), 0.0
        except UnreachablePoseError:
            return SampleStatus.UNREACHABLE
        except SingularPoseError:
            return SampleStatus.TYPE_I
        except WorkingModeError:
            return SampleStatus.BRANCH_LOST
        return _STATUSES[self._call()]


class JointStateCall:
    """All joints and the platform from the main actuators; see ``Dynamics.joint_state``.

    Args:
        robot: the robot.
        code: its compiled dynamics.

    Raises:
        UnsupportedRobotError: fewer main actuators than degrees of freedom.
    """

    def __init__(self, robot: Robot, code: Code) -> None:
        few = too_few_motors(robot)
        if few:
            raise UnsupportedRobotError(few, remedy="Determine the other degrees of freedom by other means.")
        m, k, model = robot.m, robot.k, robot.model
        self._shape: tuple[int, ...] = (4, 4) if is_pose(robot) else (robot.n,)
        self._carriers, self._none = bool(k), np.zeros(k)
        self._arguments = _Arguments({"position": (m,), "velocity": (m,), "s": (k,), "sd": (k,)})
        self._position, self._velocity, self._s, self._sd = self._arguments.views
        self._ends = np.cumsum([model.nq, model.nv, int(np.prod(self._shape)), robot.n]).tolist()
        self._results = np.zeros(self._ends[-1] + 3)
        self._state, self._ranges = np.append(robot.q_reference, 0.0), range_table(robot)
        given = self._state, self._arguments.memory, self._ranges, len(self._ranges), self._results
        self._call = _caller(code, "rp_joint_state", *given)
        self._code = code  # which keeps its numbers

    def __call__(self, position: Any, velocity: Any, s: Any, sd: Any, start: ArrayLike | None) -> JointStateSample:
        """Return joints and platform; see ``Dynamics.joint_state``."""
        try:
            self._position[:], self._velocity[:] = position, velocity
            if self._carriers:
                self._s[:] = self._none if s is _LEFT_OUT else s
                self._sd[:] = self._none if sd is _LEFT_OUT else sd
        except _NEEDS_CONVERTING:
            self._arguments.convert(position, velocity, s, sd)
        if start is not None:
            self._state[:-1], self._state[-1] = checked(start, "start", (len(self._state) - 1,)), 0.0
        status = _STATUSES[self._call()]
        if status in _WITHOUT_RESULT:
            self._results.fill(np.nan)
        results, (q, v, x, xd) = self._results.copy(), self._ends
        return JointStateSample(
            results[:q], results[q:v], results[v:x].reshape(self._shape), results[x:xd], status, results.item(xd)
        )


class AccelerationCall:
    """Accelerations of one state; see ``Dynamics.acceleration``.

    Args:
        forward: compiled forward dynamics of the robot.
    """

    def __init__(self, forward: CompiledForward) -> None:
        robot, model = forward.robot, forward.robot.model
        wrenches = 6 * len(of_kind(robot.loads, Wrench))
        sizes = {"q": model.nq, "v": model.nv, "tau": robot.m, "carrier_force": robot.k, "wrench": wrenches}
        self._arguments = _Arguments({name: (size,) for name, size in sizes.items()})
        self._q, self._v, self._tau, self._force, _ = self._arguments.views
        self._carriers, self._none, self._loads = bool(robot.k), np.zeros(robot.k), robot.loads
        self._read = forward.reader() if wrenches else None
        self._a = np.zeros(model.nv)
        self._call = _caller(forward, "rp_acceleration", self._arguments.memory, *forward.tolerances, self._a)
        self._code = forward  # which keeps its numbers

    def __call__(self, q: Any, v: Any, tau: Any, carrier_force: Any, t: float) -> AccelerationSample:
        """Return the accelerations; see ``Dynamics.acceleration``."""
        try:
            self._q[:], self._v[:], self._tau[:] = q, v, tau
            if self._carriers:
                self._force[:] = self._none if carrier_force is _LEFT_OUT else carrier_force
        except _NEEDS_CONVERTING:
            self._arguments.convert(q, v, tau, carrier_force)
        if self._read is not None:
            here = self._read(*self._arguments.parts[:2])
            wrenches = wrench_values(self._loads, np.array([t]), here.x[None], here.xd[None])
            self._arguments.parts[-1][:] = np.concatenate(wrenches, axis=1)[0]
        status = _ACCELERATION_STATUSES[self._call()]
        return AccelerationSample(self._a.copy(), status)


_ACCELERATION_STATUSES = (
    SampleStatus.OK,
    SampleStatus.SINGULAR_INCONSISTENT,
    SampleStatus.SINGULAR_INCONSISTENT,
    SampleStatus.NOT_FINITE,
)
"""By code of ``forward.c``: fine, closures have lost rank, a free motion has no inertia, not finite."""
