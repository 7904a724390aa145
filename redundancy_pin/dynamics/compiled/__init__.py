"""The third backend: closed-chain dynamics of any declared robot as machine code, or interpreted without a compiler.

The equations are those of ``dynamics.rnea``, written a second time and from the model alone: symbols (``symbols.py``),
C from them and its cache (``build.py``), and a driver that closes the loops by Newton's method along a motion
(``driver.c``; ``interpreted.py`` is the same in Python).
"""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from copy import copy
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation, Slerp

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, Frozen, checked, frozen, read_only
from redundancy_pin.dynamics.base import (
    CarrierDerivatives,
    Dynamics,
    OnUnreachable,
    ReducedDynamics,
    Sample,
    require_choice,
    require_matching_carriers,
)
from redundancy_pin.dynamics.compiled.build import Library, build_library, define
from redundancy_pin.dynamics.compiled.derivatives import (
    MotionDerivatives,
    Partials,
    TreeSamples,
    motion_partials,
)
from redundancy_pin.dynamics.compiled.design import Design, design_of
from redundancy_pin.dynamics.compiled.forward import CompiledForward, forward_of
from redundancy_pin.dynamics.compiled.interpreted import Interpreter
from redundancy_pin.dynamics.compiled.load_symbols import shape_of
from redundancy_pin.errors import (
    InputError,
    RedundancyPinError,
    SingularPoseError,
    UnreachablePoseError,
    UnsupportedRobotError,
    WorkingModeError,
)
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_sampled
from redundancy_pin.robot import Robot, RobotLike, Wrench, as_robot
from redundancy_pin.robot.joint_ranges import out_of_range
from redundancy_pin.robot.loads import of_kind, wrench_values

__all__ = ["CompiledDynamics", "Design", "MotionDerivatives", "Partials", "Sample", "design_of"]

_CLOSED, _LOST, _SINGULAR, _OTHER_MODE, _NOT_FINITE = range(5)
"""Statuses of the driver."""

_STARTS = 60
"""Random configurations from which a pose is looked for that the straight way from the reference does not reach."""

_PER_THREAD = 400
"""Samples below which a second thread costs more than it brings."""

_TURN = 0.5
"""Longest turn, rad, of a pose at a time on the way from the reference: half a turn away the direction is lost."""


class CompiledDynamics(Dynamics):
    """Closed-chain dynamics as compiled code, for any declared robot.

    The code is made and compiled when the object is made (under a second for a 3-RRR) and kept on disk, in the folder
    that ``$REDUNDANCY_PIN_CACHE`` names, or in ``~/.cache/redundancy_pin``. Without a C compiler casadi interprets it,
    which is warned of: the same numbers, ``compiled`` false, ten to fifty times as long.

    Args:
        robot: the robot, or its name or path.
        threads: threads for many samples; as many as there are processors when left out.
        interpret: do not compile.

    Attributes:
        compiled: whether this runs machine code.

    Raises:
        RedundancyPinError: casadi is not installed.
        UnsupportedRobotError: a joint of a type that is not covered.
    """

    def __init__(self, robot: RobotLike, *, threads: int | None = None, interpret: bool = False) -> None:
        self._robot = robot = as_robot(robot)
        self._threads = threads or os.cpu_count() or 1
        self._interpret = interpret
        library, reason = (None, "") if interpret else build_library(robot)
        if reason:
            warnings.warn(
                f"The dynamics of {robot.name} are interpreted, not compiled: {reason}.", RuntimeWarning, stacklevel=2
            )
        self._kernel: Library | Interpreter = Interpreter(define(robot)) if library is None else library
        self.compiled = library is not None
        self._local = threading.local()
        self._loaded: dict[str, CompiledDynamics] = {}

    def __reduce__(self) -> tuple[Callable[..., CompiledDynamics], tuple[Any, ...]]:
        """Build it again, from the cache, where it is copied or sent to."""
        return _again, (self._robot, self._threads, self._interpret)

    def __repr__(self) -> str:
        """Return the robot, and whether it is compiled."""
        return f"CompiledDynamics({self._robot!r}, {'compiled' if self.compiled else 'interpreted'})"

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self._robot

    def along(self, motion: PlatformMotion, *, unreachable: OnUnreachable = "raise") -> CompiledAlongMotion:
        """Solve the kinematics of a platform motion once, for many carrier motions.

        The branch is that of the reference configuration, followed in steps small enough for Newton's method to
        contract, from the reference straight to the first sample and from sample to sample.

        Raises:
            InputError: the motion does not have the robot's coordinates.
            UnreachablePoseError: no configuration closes the chains; carries sample and gap (unless marked).
            SingularPoseError: a sample is a type I singularity (unless marked).
            WorkingModeError: the motion leaves the working mode, or cannot be followed continuously.
        """
        require_choice(unreachable)
        self._require_coordinates(motion)
        return CompiledAlongMotion(self, _lifted(self, motion, mark=unreachable == "mark"))

    def for_robot(self, robot: Robot) -> CompiledDynamics:
        """Return this backend for a robot that differs in its loads.

        What is compiled for one set of loads serves all values of its wrenches.
        """
        shape = shape_of(robot)
        if shape not in self._loaded:
            self._loaded[shape] = CompiledDynamics(robot, threads=self._threads, interpret=self._interpret)
        other = copy(self._loaded[shape])
        other._robot, other._local = robot, threading.local()
        return other

    def sample(
        self,
        x: ArrayLike,
        xd: ArrayLike,
        xdd: ArrayLike,
        s: ArrayLike = (),
        sd: ArrayLike = (),
        sdd: ArrayLike = (),
        *,
        t: float = 0.0,
    ) -> Sample:
        """Return W (n, m), f (n,) and the carrier forces (k,) of one sample: what a control loop asks for.

        Newton's method starts from the sample that this thread asked for before, and from the reference where that is
        too far away; ``along`` and ``reduce`` follow a whole motion, check tracks, and say what is wrong.

        Args:
            x: (n,) platform coordinates in the base frame, m and rad; (4, 4) for a pose.
            xd: (n,) their rates; the twist of a pose, in world axes at the platform's origin.
            xdd: (n,) their second rates.
            s: scalar or (k,) positions of the carriers on their tracks, m; 0 when left out.
            sd: scalar or (k,) their rates, m/s; 0 when left out.
            sdd: scalar or (k,) their second rates, m/s²; 0 when left out.
            t: time, s, for wrenches that depend on it.

        Raises:
            InputError: wrong shapes, or values that are not finite.
            UnreachablePoseError, SingularPoseError, WorkingModeError: as in ``along``.
        """
        one = getattr(self._local, "one", None)
        if one is None:
            one = self._local.one = _OneSample(self)
        return one((x, xd, xdd, s, sd, sdd), t)

    def forward(self) -> CompiledForward | None:
        """Return forward dynamics, compiled when they are first asked for; None where this is interpreted."""
        return self._forward if self.compiled else None

    @cached_property
    def _forward(self) -> CompiledForward | None:
        found, reason = forward_of(self._robot)
        if reason:
            warnings.warn(
                f"The forward dynamics of {self._robot.name} are not compiled: {reason}.", RuntimeWarning, stacklevel=4
            )
        return found

    @cached_property
    def projection(self) -> Any:
        """One sample as a function of casadi: from q, trig, v, a, Γ and the carriers' motion to f and their forces."""
        return define(self._robot).functions["rp_project"]

    @cached_property
    def reference(self) -> tuple[Array, Array]:
        """The reference configuration (nq,) and its coordinates, (n,) or the 16 of a pose."""
        q = np.array(self._robot.q_reference)
        x = np.empty(16 if self._is_pose else self._robot.n)
        self._kernel.map("rp_coordinates", 1, [q[None], self._kernel.trig_at(q[None])], [x[None]])
        return q, x

    @cached_property
    def scales(self) -> tuple[Array, Array]:
        """(n,) and (m,) the characteristic length for rotations and 1 for translations, of ẋ and of the actuators."""
        robot, length = self._robot, self._robot.characteristic_length
        turning = [not str(joint.shortname()).startswith("JointModelP") for joint in robot.model.joints]
        if robot.platform is not None:
            rows = [axis.startswith("r") for axis in robot.platform.axes]
        else:
            rows = [turning[robot.model.getJointId(name)] for name in robot.independent_joints]
        columns = [turning[robot.model.getJointId(name)] for name in robot.actuated]
        by_row, by_column = (frozen(np.where(np.array(which, dtype=bool), length, 1.0)) for which in (rows, columns))
        return by_row, by_column

    @property
    def _is_pose(self) -> bool:
        return self._robot.platform is not None and self._robot.platform.is_pose

    def _require_coordinates(self, motion: PlatformMotion) -> None:
        require_sampled(motion)
        robot = self._robot
        if motion.is_pose != self._is_pose or motion.xd.shape[1] != robot.n:
            form = "(N, 4, 4) poses" if self._is_pose else f"(N, {robot.n})"
            raise InputError(
                f"The motion has x of shape {motion.x.shape} and xd of shape {motion.xd.shape}; {robot.name} moves in "
                f"{robot.n} coordinates.",
                remedy=f"Pass x as {form} and xd, xdd as (N, {robot.n}).",
                robot=robot.name,
                axes=tuple(robot.platform.axes if robot.platform else robot.independent_joints),
                poses=self._is_pose,
                given=motion.xd.shape[1],
                given_poses=motion.is_pose,
            )


def _again(robot: Robot, threads: int, interpret: bool) -> CompiledDynamics:
    return CompiledDynamics(robot, threads=threads, interpret=interpret)


class _OneSample:
    """One sample at a time, in fixed memory; one for each thread."""

    def __init__(self, dynamics: CompiledDynamics) -> None:
        robot = dynamics.robot
        self._dynamics, n, m, k = dynamics, robot.n, robot.m, robot.k
        pose = robot.platform is not None and robot.platform.is_pose
        self._shapes = [(4, 4) if pose else (n,), (n,), (n,), (k,), (k,), (k,)]
        width = 16 if pose else n
        self._wrenches = 6 * len(of_kind(robot.loads, Wrench))
        self._given, self._result = np.zeros(width + 2 * n + 3 * k + self._wrenches), np.zeros(n * m + n + k + 2)
        self._state = np.append(np.array(robot.q_reference), 0.0)
        self._parked = np.zeros(k)
        self._cuts, self._shape = (n * m, n * m + n, n * m + n + k), (n, m)
        self._evaluate = dynamics._kernel.sampler(self._state, self._given, self._result)

    def __call__(self, values: tuple[ArrayLike, ...], t: float) -> Sample:
        try:
            parts = [np.asarray(value, dtype=np.float64) for value in values]
        except (TypeError, ValueError):
            self._refuse(values)
        if [part.shape for part in parts] != self._shapes:
            carried = [self._parked if not part.size else part for part in parts[3:]]
            carried = [np.full(self._parked.shape, part) if part.ndim == 0 else part for part in carried]
            parts[3:] = carried  # one number stands for all carriers
            if [part.shape for part in parts] != self._shapes:
                self._refuse(values)
        if self._wrenches:
            x, xd = parts[0][None], parts[1][None]
            parts += [part[0] for part in wrench_values(self._dynamics.robot.loads, np.array([t]), x, xd)]
        parts[0] = parts[0].ravel()
        np.concatenate(parts, out=self._given)
        if self._evaluate() != _CLOSED:
            self._from_reference(values)
        result, (a, b, c) = self._result.copy(), self._cuts
        return Sample(result[:a].reshape(self._shape), result[a:b], result[b:c])

    def _from_reference(self, values: tuple[ArrayLike, ...]) -> None:
        motion = self._refuse(values)
        # raises, unless the sample was only too far from the one before
        self._state[:-1] = _lifted(self._dynamics, motion, mark=False).q[0]
        self._state[-1] = 0.0
        status = self._evaluate()
        if status == _NOT_FINITE:
            raise InputError("The efforts of the sample are not finite.", remedy="Its rates are too large.")
        if status != _CLOSED:
            raise SingularPoseError(
                "The sample is at a type I singularity: the platform velocity does not determine the joint velocities.",
                remedy="Keep the legs away from full stretch, full fold and zero length.",
                sample=0,
            )

    def _refuse(self, values: tuple[ArrayLike, ...]) -> PlatformMotion:
        """Return the sample as a motion; raises where it is none."""
        names = ("x", "xd", "xdd", "s", "sd", "sdd")
        parts = [
            checked(value, name, shape)
            for value, name, shape in zip(values, names, self._shapes, strict=True)
            if name[0] == "x" or np.size(value)
        ]
        return PlatformMotion(np.zeros(1), *(part[None] for part in parts[:3]))


class _Lifted(NamedTuple):
    """Motion of the tree; see ``kinematics.lift.TreeMotion``."""

    motion: PlatformMotion
    q: Array
    trig: Array
    v: Array
    a: Array
    gamma: Array
    W: Array
    gap: Array
    margin: Array
    reachable: BoolArray


class CompiledAlongMotion(Frozen):
    """Dynamics along one platform motion; obtained from ``CompiledDynamics.along``.

    Rows of samples that are not reachable are NaN in every result.
    """

    def __init__(self, dynamics: CompiledDynamics, lifted: _Lifted) -> None:
        self._dynamics = dynamics
        self._lifted = lifted

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self._dynamics.robot

    @property
    def motion(self) -> PlatformMotion:
        """The platform motion."""
        return self._lifted.motion

    @property
    def gamma(self) -> Array:
        """(N, nv, n) velocities of the tree per unit of each independent velocity."""
        return self._lifted.gamma

    def reduce(self, carriers: CarrierMotion | None = None) -> ReducedDynamics:
        """Return f, W and carrier forces; carriers parked at s = 0 when left out. Tracks are not checked."""
        n, k = self.robot.n, self.robot.k
        f, force = self._mapped("rp_project", carriers, (n, k), gamma=True)
        rows, columns = self._dynamics.scales
        return ReducedDynamics(
            t=self.motion.t,
            f=read_only(f),
            W=self._lifted.W,
            carrier_force=read_only(force),
            reachable=self._lifted.reachable,
            gap=self._lifted.gap,
            row_scale=rows,
            column_scale=columns,
            out_of_range=self._out_of_range,
        )

    @cached_property
    def _out_of_range(self) -> BoolArray:
        return out_of_range(self.robot, self._lifted.q)

    def carrier_derivatives(self, carriers: CarrierMotion | None = None) -> CarrierDerivatives:
        """Return the exact derivatives of f and carrier forces by s, ṡ, s̈ (casadi's, of the symbols)."""
        n, k = self.robot.n, self.robot.k
        parts = self._mapped("rp_derivatives", carriers, (n * k,) * 3 + (k * k,) * 3, gamma=True)
        shaped = [part.reshape(len(part), -1, k) if k else np.zeros((len(part), rows, 0))
                  for part, rows in zip(parts, (n, n, n, k, k, k), strict=True)]  # fmt: skip
        return CarrierDerivatives(*(read_only(part) for part in shaped))

    def derivatives(
        self, carriers: CarrierMotion | None = None, parameters: Sequence[str] | Design = ()
    ) -> MotionDerivatives:
        """Return exact derivatives of f, W, τ, carrier forces, base wrench and closure forces, by all they depend on.

        By automatic and implicit differentiation; interpreted by casadi, on this thread. The first call for a robot and
        its parameters writes the expressions (under a second for a 3-RRR), later ones find them.

        Args:
            carriers: carrier motion; parked at s = 0 when left out.
            parameters: design parameters, numbers of the xacro file (``"distal_length"``) or of the tree
                (``"elbow_1.mass"``), see ``design.design_of``; or a ``Design``.

        Raises:
            InputError: an unknown parameter, or carriers of the wrong shape.
            UnsupportedRobotError: a parameter that changes the axes or the number of joints; a wrench that is a
                function, whose derivatives are not known.
        """
        lifted, robot = self._lifted, self.robot
        carriers = require_matching_carriers(robot, carriers, len(self.motion))
        design = parameters if isinstance(parameters, Design) else design_of(robot, parameters)
        x = self.motion.x.reshape(len(self.motion), -1)
        for wrench in of_kind(robot.loads, Wrench):
            if not isinstance(wrench.value, np.ndarray):
                raise UnsupportedRobotError(
                    f"{wrench!r} is a function whose own derivatives are not known.",
                    remedy="Pass its values at the samples, and add what it changes by x and xd.",
                    frame=wrench.frame,
                )
        samples = TreeSamples(x, lifted.q, lifted.v, lifted.a, lifted.reachable, self._external)
        partials, share = motion_partials(robot, design, samples, carriers)
        return MotionDerivatives(design.names, share=share, reduced=self.reduce(carriers), **partials)

    def expressions(self, s: Any, sd: Any, sdd: Any) -> tuple[Any, Any]:
        """Return casadi's f (n, N) and carrier forces (k, N) of expressions of the carriers' motion, (k, N) each."""
        lifted, n = self._lifted, self.robot.n
        known = [part.T for part in (lifted.q, lifted.trig, lifted.v, lifted.a)]
        known.append(lifted.gamma.reshape(-1, n).T)  # the n rows of one sample beside those of the next
        f, force = self._dynamics.projection.map(len(self.motion)).call([*known, s, sd, sdd, self._external.T])
        return f, force

    def base_wrench(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N, 6) force and moment of the robot on its base, about the world origin, world axes, N and N·m."""
        (wrench,) = self._mapped("rp_base_wrench", carriers, (6,))
        return read_only(wrench)

    def energy(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N,) kinetic plus potential energy, J (zero height at the world origin)."""
        (energy,) = self._mapped("rp_energy", carriers, (1,))
        return read_only(energy[:, 0])

    def closure_margin(self) -> Array:
        """Return (N,) NaN: it is not known here. Branches are not carried across poses where the closures lose rank."""
        return read_only(np.full(len(self.motion), np.nan))

    @cached_property
    def _external(self) -> Array:
        """(N, 6 w) the wrenches on the robot, in their own axes."""
        motion = self.motion
        values = wrench_values(self.robot.loads, motion.t, motion.x, motion.xd)
        return np.concatenate([np.zeros((len(motion), 0)), *values], axis=1)

    def _mapped(
        self, name: str, carriers: CarrierMotion | None, widths: tuple[int, ...], *, gamma: bool = False
    ) -> list[Array]:
        samples, lifted = len(self.motion), self._lifted
        carriers = require_matching_carriers(self.robot, carriers, samples)
        inputs = [lifted.q, lifted.trig, lifted.v, lifted.a, *([lifted.gamma] if gamma else [])]
        inputs += [np.ascontiguousarray(part) for part in (carriers.s, carriers.sd, carriers.sdd, self._external)]
        outputs = [np.empty((samples, width)) for width in widths]

        def part(of: slice) -> None:
            self._dynamics._kernel.map(name, of.stop - of.start, [a[of] for a in inputs], [a[of] for a in outputs])

        _each(part, _parts(samples, self._dynamics._threads))
        if not lifted.reachable.all():
            for output in outputs:
                output[~lifted.reachable] = np.nan
        return outputs


# --- closing the loops along a motion ---------------------------------------------------------------------------------


def _lifted(dynamics: CompiledDynamics, motion: PlatformMotion, *, mark: bool) -> _Lifted:
    robot, samples = dynamics.robot, len(motion)
    x = np.ascontiguousarray(motion.x.reshape(samples, -1))
    nq, nv, n, m = robot.model.nq, robot.model.nv, robot.n, robot.m
    shapes = ((nq,), (dynamics._kernel.trigs,), (nv,), (nv,), (nv, n), (n, m), (), ())
    arrays = [np.full((samples, *shape), np.nan) for shape in shapes]
    status = np.full(samples, _LOST, dtype=np.intc)
    first, failed = 0, 0
    start = _start(dynamics, motion, 0, mark)
    while True:
        if start is not None:
            failed = _run(dynamics, motion, x, first, start, arrays, status)
            # the sample that cannot be followed stays marked: what is reacquired behind it may be another branch
            first = failed
        first += 1
        if not mark or first >= samples:
            break
        away = first - failed
        start = _start(dynamics, motion, first, mark, thorough=away & (away - 1) == 0)
    good: BoolArray = status == _CLOSED
    if not good.all():
        if not mark:
            _refuse(dynamics, motion, x, arrays, status, int(np.argmin(good)))
        missing = np.flatnonzero(~good)
        for k in missing[np.isnan(arrays[6][missing])]:
            arrays[6][k] = _nearest(dynamics, x[k], arrays[0], int(k))[1]
        for array in arrays[:6]:
            array[~good] = np.nan
    q, trig, v, a, gamma, W, gap, margin = (read_only(array) for array in arrays)
    return _Lifted(motion, q, trig, v, a, gamma, W, gap, margin, read_only(good))


def _run(
    dynamics: CompiledDynamics,
    motion: PlatformMotion,
    x: Array,
    first: int,
    start: Array,
    arrays: list[Array],
    status: NDArray[np.intc],
) -> int:
    """Lift the samples from ``first`` on; return the first that is not closed, or how many there are.

    A whole motion is lifted in as many parts as there are threads, which count only if they join.
    """
    kernel, samples = dynamics._kernel, len(motion)
    # a motion keeps the layout it was given in, say of a transposed array; C reads row by row
    t, xd, xdd = (np.ascontiguousarray(part) for part in (motion.t, motion.xd, motion.xdd))

    def lift(part: slice, q: Array) -> int:
        rest = [array[part] for array in (t, x, xd, xdd)]
        outputs = [*(array[part] for array in arrays), status[part]]
        return kernel.call("rp_lift", part.stop - part.start, *rest, q, x[part.start], *outputs)

    parts = [slice(first + p.start, first + p.stop) for p in _parts(samples - first, dynamics._threads)]
    if len(parts) > 1 and first == 0:
        starts = [start]
        for part in parts[1:]:
            q = starts[-1].copy()
            if kernel.call("rp_follow", q, x[parts[len(starts) - 1].start], x[part.start]) != _CLOSED:
                break
            starts.append(q)
        if len(starts) == len(parts):
            _each(lambda pair: lift(*pair), list(zip(parts, starts, strict=True)))
            if (status[first:] == _CLOSED).all() and all(
                _joined(kernel, arrays[0], x, part.start) for part in parts[1:]
            ):
                return samples
        status[first:] = _LOST  # the straight way to a part led elsewhere than the motion: one after the other
    return first + lift(slice(first, samples), start)


def _joined(kernel: Library | Interpreter, q: Array, x: Array, k: int) -> bool:
    """Return whether sample k continues the branch of the one before."""
    reached = q[k - 1].copy()
    closed = kernel.call("rp_follow", reached, x[k - 1], x[k]) == _CLOSED
    return closed and float(np.abs(reached - q[k]).max()) < _SAME


_SAME = 1e-9
"""Two configurations nearer than this (rad, m) are one, computed twice."""


def _parts(samples: int, threads: int) -> list[slice]:
    count = max(1, min(threads, samples // _PER_THREAD))
    edges = np.linspace(0, samples, count + 1).round().astype(int).tolist()
    return [slice(a, b) for a, b in pairwise(edges)]


def _each(work: Callable[[Any], Any], items: list[Any]) -> None:
    """Do some work for each item, in a thread each; compiled code runs beside Python."""
    if len(items) == 1:
        work(items[0])
        return
    with ThreadPoolExecutor(len(items)) as pool:
        list(pool.map(work, items))


def _start(
    dynamics: CompiledDynamics, motion: PlatformMotion, sample: int, mark: bool, thorough: bool = True
) -> Array | None:
    """Return a configuration (nq,) closed at a sample: straight from the reference, or the nearest in the mode.

    None, with ``mark``, where there is none.
    """
    kernel = dynamics._kernel
    reference, home = dynamics.reference
    x = np.ascontiguousarray(motion.x[sample].reshape(-1))
    q, here = reference.copy(), home
    for target in _way(home, x, motion.is_pose):
        status = kernel.call("rp_follow", q, here, target)
        here = target
        if status == _LOST:
            break
    if status == _CLOSED:
        return q
    best, gap = _multistart(dynamics, x) if thorough else (None, np.nan)
    if best is not None:
        return best
    if mark:
        return None
    raise _no_start(dynamics, motion, sample, gap)


def _way(home: Array, x: Array, is_pose: bool) -> list[Array]:
    """Return coordinates on the way from one pose to another, the last one last; a pose turns a little at a time."""
    if not is_pose:
        return [x]
    first, last = home.reshape(4, 4), x.reshape(4, 4)
    rotations = Rotation.from_matrix(np.stack([first[:3, :3], last[:3, :3]]))
    angle = (rotations[1] * rotations[0].inv()).magnitude()
    shares = np.linspace(0.0, 1.0, int(np.ceil(angle / _TURN)) + 1)[1:] if angle > 0.0 else np.ones(1)
    poses = np.repeat(np.eye(4)[None], len(shares), axis=0)
    poses[:, :3, :3] = Slerp([0.0, 1.0], rotations)(shares).as_matrix()
    poses[:, :3, 3] = first[:3, 3] + shares[:, None] * (last[:3, 3] - first[:3, 3])
    poses[-1] = last
    return [pose.ravel() for pose in poses]


def _multistart(dynamics: CompiledDynamics, x: Array) -> tuple[Array | None, float]:
    """Return the configuration nearest to the reference in the working mode, and the smallest gap that was met."""
    import pinocchio as pin

    kernel, robot = dynamics._kernel, dynamics.robot
    reference, _ = dynamics.reference
    random = np.random.default_rng(0)
    best, nearest, least = None, np.inf, np.inf
    for trial in range(_STARTS):
        step = np.zeros(robot.model.nv)
        if trial:
            step = random.uniform(-np.pi, np.pi, robot.model.nv)
        step[robot.carrier_velocity] = 0.0
        q: Array = pin.integrate(robot.model, reference, step)
        gap = kernel.assemble(q, x)
        least = min(least, gap)
        if gap < CLOSURE_TOLERANCE and kernel.call("rp_follow", q, x, x) == _CLOSED:
            away = float(np.abs(pin.difference(robot.model, reference, q)).max())
            if away < nearest:
                best, nearest = q, away
    return best, least


def _nearest(dynamics: CompiledDynamics, x: Array, q: Array, k: int) -> tuple[Array, float]:
    """Return where Newton's method ends at sample k from the last one that was closed, and by how much it is open."""
    known = np.flatnonzero(~np.isnan(q[:k, 0]))
    nearest = q[known[-1]].copy() if len(known) else dynamics.reference[0].copy()
    return nearest, dynamics._kernel.assemble(nearest, x)


def _is_singular(kernel: Library | Interpreter, q: Array, x: Array, size: int) -> bool:
    """Return whether K is singular at a configuration, to the square root of rounding."""
    residual, K, alignment = np.empty((1, size)), np.empty((1, size, size)), np.empty((1, kernel.alignments))
    kernel.map("rp_rows", 1, [q[None], kernel.trig_at(q[None]), x[None]], [residual, K, alignment])
    values = np.linalg.svd(K[0], compute_uv=False)
    return bool(values[-1] <= _SINGULAR_RATIO * values[0])


_SINGULAR_RATIO = 1e-5
"""Ratio of singular values below which K counts as singular in a message: Newton reaches a double root to 1e-6."""


# --- what is wrong ----------------------------------------------------------------------------------------------------


def _no_start(dynamics: CompiledDynamics, motion: PlatformMotion, sample: int, gap: float) -> RedundancyPinError:
    robot, pose = dynamics.robot, f"The pose of sample {sample}, x = {np.round(motion.x[sample], 6).tolist()},"
    if gap < CLOSURE_TOLERANCE and robot.working_modes is not None:
        return WorkingModeError(
            f"{pose} closes only in other working modes than {_mode(robot)} of {robot.name}.",
            remedy="Load the robot in that working_mode, or move the pose.",
            sample=sample,
        )
    if gap < CLOSURE_TOLERANCE:
        return SingularPoseError(
            f"{pose} is a type I singularity: the platform velocity does not determine the joint velocities.",
            remedy="Keep the legs away from full stretch, full fold and zero length.",
            sample=sample,
        )
    return UnreachablePoseError(
        f"{pose} cannot be reached in the working mode of {robot.name}: the chains stay open by {gap:.3g} m.",
        remedy="Move the pose into the workspace, or load the robot in another working_mode.",
        sample=sample,
        gap=gap,
    )


def _refuse(
    dynamics: CompiledDynamics, motion: PlatformMotion, x: Array, arrays: list[Array], status: NDArray[np.intc], k: int
) -> None:
    when = f"sample {k} (t = {motion.t[k]:.6g} s"
    if status[k] == _OTHER_MODE:
        raise WorkingModeError(
            f"The motion leaves the working mode {_mode(dynamics.robot)} at {when}).",
            remedy="Plan a path that keeps every leg on its side, or load the robot in another working_mode.",
            sample=k,
        )
    nearest, gap = _nearest(dynamics, x[k], arrays[0], k)
    if status[k] == _LOST and gap >= CLOSURE_TOLERANCE:
        raise UnreachablePoseError(
            f"The pose of {when}, x = {np.round(motion.x[k], 6).tolist()}) cannot be reached: the chains stay open by "
            f"{gap:.3g} m.",
            remedy="Keep the motion inside the workspace, or ask for unreachable samples to be marked.",
            sample=k,
            gap=gap,
        )
    if status[k] == _SINGULAR or _is_singular(
        dynamics._kernel, nearest, x[k], dynamics.robot.model.nv - dynamics.robot.k
    ):
        raise SingularPoseError(
            f"At {when}) the motion meets a type I singularity: the platform velocity does not determine the joint "
            "velocities.",
            remedy="Keep the legs away from full stretch, full fold and zero length.",
            sample=k,
        )
    raise WorkingModeError(
        f"The motion cannot be followed continuously to {when}): the way there leaves the workspace or passes a type I "
        "singularity (a leg at full stretch, full fold or zero length).",
        remedy="Keep every leg away from the end of its reach, or sample the motion more finely.",
        sample=k,
    )


def _mode(robot: Robot) -> str:
    return "".join("+" if sign > 0 else "-" for sign in robot.working_mode)
