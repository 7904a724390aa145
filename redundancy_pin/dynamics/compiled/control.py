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
from math import isfinite, isnan
from typing import Any, TypeAlias, TypeVar, cast

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, SINGULAR_MARGIN, Array, numbers
from redundancy_pin.dynamics.compiled.build import Code
from redundancy_pin.dynamics.compiled.closing import ClosedMotion, Start, follow_motors
from redundancy_pin.dynamics.compiled.forward import CompiledForward
from redundancy_pin.dynamics.compiled.parameters import layout_of, parameter_vector, places_of, topology_of
from redundancy_pin.dynamics.one_sample import REFUSALS, Refusal, is_finite, refusal_of, solve_sample, without_answer
from redundancy_pin.dynamics.results import AccelerationSample, JointStateSample, ReducedDynamics, Sample, TorqueSample
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_poses
from redundancy_pin.robot import Robot, Wrench
from redundancy_pin.robot.checks import is_pose, too_few_motors
from redundancy_pin.robot.joint_ranges import is_in_range, range_table
from redundancy_pin.robot.loads import of_kind, wrench_values
from redundancy_pin.status import SampleStatus

Follow: TypeAlias = Callable[[PlatformMotion, CarrierMotion, Start | None], tuple[ClosedMotion, ReducedDynamics]]
"""Solves a motion of one sample by kinematics, on the branch of a start, or of the reference where that is None."""

T = TypeVar("T")

_STATUSES = tuple(SampleStatus)
"""By code: an index takes a fifth of the time of ``SampleStatus(code)``."""

_FOR_KINEMATICS = len(_STATUSES)
"""Code for samples that the C does not follow: kinematics may follow them, or report why their branch ends."""

_WITHOUT_RESULT = frozenset(
    {
        SampleStatus.UNREACHABLE,
        SampleStatus.BRANCH_LOST,
        SampleStatus.TYPE_I,
        SampleStatus.TYPE_II,
        SampleStatus.NOT_FINITE,
        _FOR_KINEMATICS,
    }
)
"""Codes of samples that have no results; the state of the C is not moved."""

_OPTIONAL = frozenset({"s", "sd", "sdd", "carrier_force", "velocity"})
"""Arguments that are zero where they are left out, and that one number may stand for."""

_LEFT_OUT: tuple[()] = ()
"""Default of arguments of carriers; there is one empty tuple."""

_NEEDS_CONVERTING = (TypeError, ValueError)
"""Errors for arguments other than plain arrays of doubles: lists, other numbers, masked arrays, omitted arguments."""


def _plain(value: Any, none: Array) -> Array:
    """Return a plain array as it is, and ``none`` where an argument of carriers is left out; raises TypeError."""
    if value is _LEFT_OUT:
        return none
    if type(value) is not np.ndarray:
        raise TypeError
    return value


class _Arguments:
    """Arguments of a call, one after the other in memory at a fixed address.

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
        """Copy arguments of any kind, the first ones of all.

        Raises:
            InputError: one of them does not have its shape, or is masked. Numbers that are not finite are left to the
                call.
        """
        for part, value, (name, shape) in zip(self.parts, values, self._shapes.items(), strict=False):
            if name in _OPTIONAL and (np.ndim(value) == 0 or not np.size(value)) and value is not None:
                value = np.full(shape, value if np.ndim(value) == 0 else 0.0)
            part[:] = numbers(value, name, shape).ravel()


def _caller(code: Code, name: str, *arguments: Any) -> Callable[[], int]:
    """Return a function of a library with its arguments, that holds the interpreter's lock; arrays give addresses."""
    function = ctypes.PyDLL(code.library._name, handle=code.library._handle)[name]
    given = [ctypes.c_void_p(value.ctypes.data) if isinstance(value, np.ndarray) else value for value in arguments]
    return partial(function, *given)


class _Branch:
    """The branch that a call follows, in memory at a fixed address.

    Args:
        robot: the robot.
        code: its compiled dynamics.

    Attributes:
        numbers: (P,) the robot's, as the C takes them. Its working-mode signs are the signs of the branch, so that
            the C keeps every leg on its side.
        state: (nq + 1,) the last configuration, and a sign that changes across type I, 0 where that is not known; NaN
            at a rank loss of the closures.
        known: whether a start or a sample has determined the branch; before that it is the reference's.
        passed: the last sample at a rank loss of the closures, q and its state: Γ determines the branch, q does not.
        refused: the last sample refused by kinematics, and its start: None once a sample is solved.
    """

    def __init__(self, robot: Robot, code: Code) -> None:
        self.known = False
        self.passed: tuple[Array, Start] | None = None
        self.refused: tuple[bytes, Refusal] | None = None
        self._pose = np.setdiff1d(np.arange(robot.model.nq), robot.carrier_position)
        self.state = np.append(robot.q_reference, 0.0)
        own, topology = parameter_vector(robot), topology_of(robot)
        places = places_of(robot)["mode",]
        begin = layout_of(topology).starts["MODEL"] + int(topology.free[: places.start].sum())
        signs = slice(begin, begin + places.stop - places.start)
        self.numbers, self._start = own.copy(), _Arguments({"start": (robot.model.nq,)})
        self._signs = self.numbers[signs]
        self._own = own, own[signs]  # which the C reads
        self._begin = _caller(code, "rp_begin", *self._own, self._start.memory, self._signs, self.state)

    def begin(self, start: ArrayLike) -> bool:
        """Continue from a configuration (nq,), m and rad; returns False, and does nothing, if it is not finite.

        Raises:
            InputError: another shape.
        """
        try:
            if type(start) is not np.ndarray:
                raise TypeError
            self._start.views[0][:] = start
        except _NEEDS_CONVERTING:
            self._start.convert(start)
        begun = bool(self._begin())
        self.known = self.known or begun
        if self.passed is not None and np.array_equal(self.passed[0][self._pose], self.state[self._pose]):
            self.state[-1] = np.nan
        return begun

    def move(self, q: Array, state: Start, margin: float) -> None:
        """Go on from a sample that kinematics have solved, by its state where its margin is too small for the C."""
        self.passed = (q, state) if margin < SINGULAR_MARGIN else None
        self.begin(q)

    def refuses(self, given: Array) -> bool:
        """Return whether kinematics have refused a set-point here, which a loop requests repeatedly.

        Args:
            given: coordinates, or positions of the actuators; rates do not affect reachability.
        """
        return self.refused is not None and self.refused[0] == self._key(given)

    def by_kinematics(self, given: Array, solve: Callable[[Start | None], T]) -> T | Refusal:
        """Return a sample that kinematics solve from here, or from the reference where no branch is known yet.

        Args:
            given: as of ``refuses``.
            solve: function that solves it from a start, and raises ``REFUSALS``.
        """
        key = self._key(given)
        if self.refused is not None and self.refused[0] == key:
            return self.refused[1]
        start: Start | None = self.state[:-1].copy() if self.known else None
        if self.known and isnan(self.state[-1]):
            if self.passed is None:
                return Refusal(SampleStatus.BRANCH_LOST)
            start = self.passed[1]
        try:
            return solve(start)
        except REFUSALS as error:
            self.refused = key, refusal_of(error)
            return self.refused[1]

    def _key(self, given: Array) -> bytes:
        return b"".join(part.tobytes() for part in (self.state, self._signs, given)) + bytes([self.known])

    def save(self) -> tuple[Array, Array, bool]:
        """Return the state for ``restore``."""
        return self.state.copy(), self._signs.copy(), self.known

    def restore(self, saved: tuple[Array, Array, bool]) -> None:
        """Go back to where the branch was."""
        self.state[:], self._signs[:], self.known = saved


class SampleCall:
    """One sample of a motion: its torques, or W, f and carrier forces; see ``Dynamics.torque`` and ``Dynamics.sample``.

    Samples that the C does not close go to kinematics: they pass a bifurcation of the branch, or report the cause.

    Args:
        robot: the robot.
        code: its compiled dynamics.
        follow: called if the C does not reach a sample; it raises the cause.
    """

    def __init__(self, robot: Robot, code: Code, follow: Follow) -> None:
        n, m, k, wrenches = robot.n, robot.m, robot.k, 6 * len(of_kind(robot.loads, Wrench))
        self._robot, self._follow, self._loaded = robot, follow, bool(wrenches)
        self._carriers, self._none = bool(k), np.zeros(k)
        self._pose, self._shape = is_pose(robot), (4, 4) if is_pose(robot) else (n,)
        sizes = (self._shape, (n,), (n,), (k,), (k,), (k,), (wrenches,))
        self._arguments = _Arguments(dict(zip(("x", "xd", "xdd", "s", "sd", "sdd", "wrench"), sizes, strict=True)))
        self._x, self._xd, self._xdd, self._s, self._sd, self._sdd, _ = self._arguments.views
        self._branch = branch = _Branch(robot, code)
        ends = np.cumsum([n * m, n, k, 2, m, 1]).tolist()
        self._results = np.zeros(ends[-1])
        self._W, self._f, self._force, _, self._tau, _ = np.split(self._results, ends[:-1])
        places = ends[2], ends[2] + 1, ends[4]
        self._residual, self._serial, self._margin = (partial(self._results.item, at) for at in places)
        self._ranges = range_table(robot)
        given = branch.numbers, branch.state, self._arguments.memory, self._results
        self._call_reach = _caller(code, "rp_reach", *given)
        self._call_torque = _caller(code, "rp_torque", *given, self._ranges, len(self._ranges)) if m else None

    def reduced(self, x: Any, xd: Any, xdd: Any, s: Any, sd: Any, sdd: Any, t: float) -> Sample:
        """Return W (n, m), f (n,) and carrier forces (k,); see ``Dynamics.sample``."""
        self._take(x, xd, xdd, s, sd, sdd, t)
        if not self._call_reach():
            return Sample(self._W.reshape(len(self._f), -1).copy(), self._f.copy(), self._force.copy())
        (tree, _), reduced = self._followed(self._motion(t), None)
        self._branch.state[:-1], self._branch.state[-1] = tree.q[0], 0.0
        sample = Sample(reduced.W[0], reduced.f[0], reduced.carrier_force[0])
        if not all(np.isfinite(part).all() for part in sample):
            raise InputError("The efforts of the sample are not finite.", remedy="Its rates are too large.")
        return sample

    def torque(
        self, x: Any, xd: Any, xdd: Any, s: Any, sd: Any, sdd: Any, t: float, start: ArrayLike | None
    ) -> TorqueSample:
        """Return the torques; see ``Dynamics.torque``."""
        if self._call_torque is None:
            raise InputError(f"{self._robot.name} has no main actuators.", remedy="Declare which joints are actuated.")
        self._take(x, xd, xdd, s, sd, sdd, t)
        saved = None if start is None else self._branch.save()
        if start is not None and not self._branch.begin(start):
            return without_answer(self._robot, SampleStatus.NOT_FINITE)
        code = _FOR_KINEMATICS if self._branch.refuses(self._arguments.parts[0]) else self._call_torque()
        if code not in _WITHOUT_RESULT:
            self._branch.known, self._branch.refused = True, None
            margins = self._residual(), self._serial()
            return TorqueSample(self._tau.copy(), _STATUSES[code], self._margin(), self._force.copy(), *margins)
        solved = False
        if start is not None:
            self._branch.begin(start)  # as given: repeated calls at one set-point compare with it
        try:
            answer = self._answer(code, t)
            solved = int(answer.status) not in _WITHOUT_RESULT
        finally:
            if saved is not None and not solved:
                self._branch.restore(saved)
        return answer

    def _answer(self, code: int, t: float) -> TorqueSample:
        """Return a sample that the C does not close; raises InputError if it is not a valid sample."""
        robot, branch, (x, xd, xdd, s, sd, sdd, _) = self._robot, self._branch, self._arguments.parts
        if code == SampleStatus.NOT_FINITE or not is_finite(self._arguments.parts, t):
            return without_answer(robot, SampleStatus.NOT_FINITE)
        if self._pose:
            require_poses(x.reshape(1, *self._shape))
        if code == SampleStatus.BRANCH_LOST and branch.known:
            return without_answer(robot, SampleStatus.BRANCH_LOST)
        found = branch.by_kinematics(x, lambda start: self._followed(self._motion(t), start))
        if isinstance(found, Refusal):
            return without_answer(robot, *found)
        (tree, _), reduced = found
        margin, residual = float(tree.serial_margin_bound[0]), float(tree.residual[0])
        branch.move(tree.q[0], tree.state(0), margin)
        sample = Sample(reduced.W[0], reduced.f[0], reduced.carrier_force[0])
        given = x.reshape(self._shape), xd, xdd, s, sd, sdd
        return solve_sample(robot, sample, tree.q[0], (residual, margin), given, t)

    def _take(self, x: Any, xd: Any, xdd: Any, s: Any, sd: Any, sdd: Any, t: float) -> None:
        """Copy the arguments to where C reads them, and evaluate wrenches; the C finds values that are not finite.

        Raises:
            InputError: wrong shapes.
        """
        try:
            if not type(x) is type(xd) is type(xdd) is np.ndarray:
                raise TypeError
            if not self._pose:
                self._x[:] = x
            elif x.shape == (4, 4):
                self._x[:] = x.ravel()
            else:
                raise ValueError
            self._xd[:], self._xdd[:] = xd, xdd
            if self._carriers:
                none = self._none
                self._s[:], self._sd[:], self._sdd[:] = _plain(s, none), _plain(sd, none), _plain(sdd, none)
            elif not s is sd is sdd is _LEFT_OUT:
                raise ValueError
        except _NEEDS_CONVERTING:
            self._arguments.convert(x, xd, xdd, s, sd, sdd)
        if t != 0.0 and not isfinite(t):
            self._arguments.memory[0] = np.nan
        if self._loaded:
            self._evaluate_wrenches(t)

    def _evaluate_wrenches(self, t: float) -> None:
        *parts, wrench = self._arguments.parts
        if np.isfinite(np.concatenate(parts)).all():  # a wrench may be a function of time and motion
            motion = self._motion(t)
            values = wrench_values(self._robot.loads, motion.t, motion.x, motion.xd)
            wrench[:] = np.concatenate(values, axis=1)[0]

    def _motion(self, t: float) -> PlatformMotion:
        """Return the sample as a motion; raises InputError if it is invalid."""
        x, xd, xdd, *_ = self._arguments.parts
        return PlatformMotion(np.array([t]), x.reshape(1, *self._shape), xd[None], xdd[None], check_rates=False)

    def _followed(self, motion: PlatformMotion, start: Start | None) -> tuple[ClosedMotion, ReducedDynamics]:
        carriers = CarrierMotion(*(part[None] for part in self._arguments.parts[3:6]), check_rates=False)
        return self._follow(motion, carriers, start)


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
        self._results = np.zeros(self._ends[-1] + 2)
        branch = self._branch = _Branch(robot, code)
        branch.known = True  # the branch of the reference
        self._robot, self._ranges = robot, range_table(robot)
        self._own_coordinates = robot.platform is None and set(robot.independent_joints) == set(robot.actuated)
        given = branch.numbers, branch.state, self._arguments.memory, self._results
        self._call = _caller(code, "rp_joint_state", *given, self._ranges, len(self._ranges))

    def __call__(self, position: Any, velocity: Any, s: Any, sd: Any, start: ArrayLike | None) -> JointStateSample:
        """Return joints and platform; see ``Dynamics.joint_state``."""
        try:
            if not type(position) is type(velocity) is np.ndarray:
                raise TypeError
            self._position[:], self._velocity[:] = position, velocity
            if self._carriers:
                self._s[:], self._sd[:] = _plain(s, self._none), _plain(sd, self._none)
            elif not s is sd is _LEFT_OUT:
                raise ValueError
        except _NEEDS_CONVERTING:
            self._arguments.convert(position, velocity, s, sd)
        branch = self._branch
        saved = None if start is None else branch.save()
        finite = start is None or branch.begin(start)
        self._results[-1] = np.nan
        if not finite:
            code = int(SampleStatus.NOT_FINITE)
        elif branch.refuses(self._arguments.parts[0]):
            code = _FOR_KINEMATICS
        else:
            code = self._call()
        if code not in _WITHOUT_RESULT:
            branch.refused = None
        else:
            if code == _FOR_KINEMATICS:
                if start is not None:
                    branch.begin(start)  # as given: repeated calls at one set-point compare with it
                code = self._by_kinematics()
            if code in _WITHOUT_RESULT:
                self._results[:-1] = np.nan
                if saved is not None:
                    branch.restore(saved)
        results, (q, v, x, xd) = self._results.copy(), self._ends
        return JointStateSample(
            results[:q],
            results[q:v],
            results[v:x].reshape(self._shape),
            results[x:xd],
            _STATUSES[code],
            results.item(xd),
            results.item(xd + 1),
        )

    def _by_kinematics(self) -> int:
        """Solve a sample that the C does not get to by kinematics; returns its status."""
        robot, branch = self._robot, self._branch
        position, velocity, s, sd = self._arguments.parts
        if not is_finite(self._arguments.parts, 0.0):
            return int(SampleStatus.NOT_FINITE)
        given = position.copy(), velocity.copy()
        found = branch.by_kinematics(position, lambda start: follow_motors(robot, start, *given))
        if isinstance(found, Refusal):
            self._results[-1] = found.residual
            # K of the actuators as coordinates is singular: they do not determine the platform's
            of_actuators = found.status is SampleStatus.TYPE_I and not self._own_coordinates
            return int(SampleStatus.TYPE_II if of_actuators else found.status)
        if found.serial_margin < SINGULAR_MARGIN:
            return int(SampleStatus.TYPE_I)
        branch.move(found.q, found.state, found.closing_margin)
        q, v = found.q.copy(), found.v.copy()
        q[robot.carrier_position], v[robot.carrier_velocity] = s, sd
        self._results[:] = np.concatenate([q, v, found.x.ravel(), found.xd, [found.margin, found.residual]])
        if not is_in_range(robot, q):
            return int(SampleStatus.OUT_OF_RANGE)
        return int(SampleStatus.NEAR_SINGULAR if found.margin < NEAR_SINGULAR_MARGIN else SampleStatus.OK)


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
        self._forward, self._loaded = forward, bool(wrenches)  # it keeps its numbers
        self._a = np.zeros(model.nv)
        given = forward.numbers, self._arguments.memory, self._a
        self._call = _caller(forward, "rp_acceleration", *given)

    def __call__(self, q: Any, v: Any, tau: Any, carrier_force: Any, t: float) -> AccelerationSample:
        """Return the accelerations; see ``Dynamics.acceleration``."""
        try:
            if not type(q) is type(v) is type(tau) is np.ndarray:
                raise TypeError
            self._q[:], self._v[:], self._tau[:] = q, v, tau
            if self._carriers:
                self._force[:] = _plain(carrier_force, self._none)
            elif carrier_force is not _LEFT_OUT:
                raise ValueError
        except _NEEDS_CONVERTING:
            self._arguments.convert(q, v, tau, carrier_force)
        if t != 0.0 and not isfinite(t):
            self._arguments.memory[0] = np.nan
        if self._loaded and np.isfinite(self._arguments.memory[: -len(self._arguments.parts[-1])]).all():
            x, xd = self._forward.platform(*self._arguments.parts[:2])
            wrenches = wrench_values(self._loads, np.array([t]), x[None], xd[None])
            self._arguments.parts[-1][:] = np.concatenate(wrenches, axis=1)[0]
        status = _STATUSES[self._call()]
        return AccelerationSample(self._a.copy(), status)
