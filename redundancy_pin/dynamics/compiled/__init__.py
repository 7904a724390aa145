"""The third backend: closed-chain dynamics of any declared robot as machine code.

The equations of ``dynamics.rnea``, written a second time and from the model alone: symbols (``symbols.py``),
C from them and its cache (``build.py``), and a driver that closes the loops by Newton's method along a motion
(``closing.py``, ``driver.c``). An on-line planner evaluates a few instants at a time (``carrier_terms.py``).
"""

from __future__ import annotations

import os
import threading
import warnings
from collections.abc import Sequence
from functools import cached_property, partial
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, Frozen, lapack, read_only
from redundancy_pin.dynamics.arguments import OnUnreachable, SampleArguments, require_choice, require_matching_carriers
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.compiled.build import Library, bind, define
from redundancy_pin.dynamics.compiled.carrier_terms import Continued
from redundancy_pin.dynamics.compiled.closing import ClosedMotion, Start, close_motion, in_threads
from redundancy_pin.dynamics.compiled.control import AccelerationCall, JointStateCall, SampleCall
from redundancy_pin.dynamics.compiled.derivatives import MotionDerivatives, Partials, motion_partials
from redundancy_pin.dynamics.compiled.design import Design, design_of
from redundancy_pin.dynamics.compiled.forward import CompiledForward
from redundancy_pin.dynamics.results import (
    AccelerationSample,
    CarrierDerivatives,
    CarrierTerms,
    JointStateSample,
    ReducedDynamics,
    Sample,
    TorqueSample,
)
from redundancy_pin.errors import CompilerError, UnsupportedRobotError
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot, Wrench
from redundancy_pin.robot.checks import require_matching
from redundancy_pin.robot.loads import of_kind, wrench_values
from redundancy_pin.robot.scales import column_scale, force_sizes, row_scale

__all__ = ["CompiledDynamics", "Design", "MotionDerivatives", "Partials", "Sample", "design_of"]


class CompiledDynamics(Dynamics):
    """Closed-chain dynamics as compiled code, for any declared robot.

    The code is made and compiled when the object is made (under a second for a 3-RRR) and kept on disk, in the folder
    that ``$REDUNDANCY_PIN_CACHE`` names, or in ``~/.cache/redundancy_pin``. The compiler is what ``$CC`` names, or cc,
    gcc, clang, or what ``pip install 'redundancy_pin[compiler]'`` brings.

    Args:
        robot: the robot, or its name or path.
        threads: threads for many samples; as many as there are processors when left out.

    Raises:
        CompilerError: there is no C compiler, or it fails.
        UnsupportedRobotError: a joint of a type that is not covered.

    Example:
        >>> fast = rp.CompiledDynamics("five_bar")
        >>> fast.torque([0.2, 0.6], [0.5, 0.0], [0.0, 1.0]).status.label
        'ok'
    """

    def __init__(self, robot: RobotLike, *, threads: int | None = None) -> None:
        self._robot = as_robot(robot)
        self.threads = threads or os.cpu_count() or 1
        self.kernel = Library(self._robot)
        self._calls = _Calls(self)

    def __reduce__(self) -> tuple[partial[CompiledDynamics], tuple[Robot]]:
        """Rebuild it, from the cache, when it is copied or sent."""
        return partial(CompiledDynamics, threads=self.threads), (self._robot,)

    def __repr__(self) -> str:
        """Return the robot."""
        return f"CompiledDynamics({self._robot!r})"

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self._robot

    def along(self, motion: PlatformMotion, *, unreachable: OnUnreachable = "raise") -> CompiledAlongMotion:
        """Solve the kinematics of a platform motion once, for many carrier motions.

        The branch of the reference configuration is followed in steps small enough for Newton's method to
        contract, from the reference straight to the first sample and from sample to sample.

        Raises:
            InputError: the motion does not have the robot's coordinates.
            UnreachablePoseError: no configuration closes the chains; carries sample and residual (unless marked).
            SingularPoseError: a sample is a type I singularity (unless marked).
            WorkingModeError: the motion leaves the working mode, or cannot be followed continuously.
        """
        require_choice(unreachable)
        require_matching(self._robot, motion)
        return CompiledAlongMotion(self, close_motion(self._robot, self.kernel, motion, mark=unreachable == "mark"))

    def for_robot(self, robot: Robot) -> CompiledDynamics:
        """Return this backend, with its settings, for another robot.

        A library serves all robots that differ in numbers: lengths, masses, loads, working modes. A robot of another
        topology is compiled.
        """
        return CompiledDynamics(robot, threads=self.threads)

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
        """Return W (n, m), f (n,) and the carrier forces (k,) of one sample, for control loops.

        As ``Dynamics.sample``. Newton's method starts from the last sample of this thread, and from the
        reference if no straight line leads on from there.
        """
        return self._calls.sample.reduced(x, xd, xdd, s, sd, sdd, t)

    def _torque(self, given: SampleArguments, t: float, start: ArrayLike | None) -> TorqueSample:
        return self._calls.torque.torque(*given, t, start)

    def acceleration(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, carrier_force: ArrayLike = (), *, t: float = 0.0
    ) -> AccelerationSample:
        """Return the accelerations of the tree at a closed state with a status; see ``Dynamics.acceleration``."""
        return self._calls.acceleration(q, v, tau, carrier_force, t)

    def joint_state(
        self,
        position: ArrayLike,
        velocity: ArrayLike = (),
        s: ArrayLike = (),
        sd: ArrayLike = (),
        *,
        start: ArrayLike | None = None,
    ) -> JointStateSample:
        """Return all joints and the platform from the main actuators with a status; see ``Dynamics.joint_state``."""
        return self._calls.joint_state(position, velocity, s, sd, start)

    def _follow(
        self, motion: PlatformMotion, carriers: CarrierMotion, start: Start | None
    ) -> tuple[ClosedMotion, ReducedDynamics]:
        """Return a motion on the branch of a start, or of the reference, with W and f; raises as ``along``."""
        closed = close_motion(self._robot, self.kernel, motion, mark=False, start=start)
        return closed, CompiledAlongMotion(self, closed).reduce(carriers)

    def carrier_terms(self, t: Array, x: Array, xd: Array, xdd: Array) -> CarrierTerms:
        """Return W, and f as terms of the carriers' motion, at a few instants; see ``Dynamics.carrier_terms``.

        Newton's method starts from the last instants of this thread, if they are near.
        """
        return self._calls.carrier_terms(t, x, xd, xdd)

    @property
    def terms_call(self) -> tuple[int, int, int] | None:
        """See ``Dynamics.terms_call``; None where wrenches act on the robot: they depend on more than its motion."""
        return self._calls.carrier_terms.addresses

    def forward(self) -> CompiledForward | None:
        """Return forward dynamics, compiled on first use; None with a warning if compilation fails."""
        try:
            return self._forward
        except CompilerError as error:
            warnings.warn(f"No compiled forward dynamics of {self._robot.name}. {error}", RuntimeWarning, stacklevel=3)
            return None

    @cached_property
    def _forward(self) -> CompiledForward:
        return CompiledForward(self._robot)

    @cached_property
    def projection(self) -> Any:
        """One sample as a function of casadi: from q, trig, v, a, Γ and the carriers' motion to f and their forces."""
        return bind(define(self._robot).functions["rp_project"], self._robot)


class _Calls(threading.local):
    """The calls of one thread, made on first use, each with its memory and the branch that it follows.

    Args:
        dynamics: the dynamics to call.
    """

    def __init__(self, dynamics: CompiledDynamics) -> None:
        self._dynamics = dynamics
        lapack()  # kinematics follow where the C fails: a late import would delay a control loop

    @cached_property
    def sample(self) -> SampleCall:
        return SampleCall(self._dynamics.robot, self._dynamics.kernel, self._dynamics._follow)

    @cached_property
    def torque(self) -> SampleCall:
        return SampleCall(self._dynamics.robot, self._dynamics.kernel, self._dynamics._follow)

    @cached_property
    def acceleration(self) -> AccelerationCall:
        return AccelerationCall(self._dynamics._forward)

    @cached_property
    def joint_state(self) -> JointStateCall:
        return JointStateCall(self._dynamics.robot, self._dynamics.kernel)

    @cached_property
    def carrier_terms(self) -> Continued:
        return Continued(self._dynamics)


class CompiledAlongMotion(Frozen):
    """Dynamics along one platform motion; obtained from ``CompiledDynamics.along``.

    Rows of samples that are not reachable are NaN in every result.

    Attributes:
        robot, motion: the robot, and its platform motion.
        q, gamma: (N, nq) configurations, carriers at zero, and (N, nv, n) Γ.
    """

    def __init__(self, dynamics: CompiledDynamics, closed: ClosedMotion) -> None:
        self._dynamics, (self._tree, self._trig) = dynamics, closed
        tree = closed.tree
        self.robot, self.motion, self.q, self.gamma = tree.robot, tree.motion, tree.q, tree.gamma

    @property
    def reachable(self) -> BoolArray:
        """(N,) whether a configuration closes the chains."""
        return self._tree.reachable

    def reduce(self, carriers: CarrierMotion | None = None) -> ReducedDynamics:
        """Return f, W and carrier forces; carriers parked at s = 0 when left out. Tracks are not checked."""
        n, k, motion = self.robot.n, self.robot.k, self.motion
        carriers = require_matching_carriers(self.robot, carriers, len(motion))
        moving = motion.xd, motion.xdd, carriers.sd, carriers.sdd
        f, force = self._mapped("rp_project", carriers, (n, k), gamma=True)
        return ReducedDynamics(
            t=self.motion.t,
            f=read_only(f),
            W=self._tree.W,
            carrier_force=read_only(force),
            reachable=self._tree.reachable,
            residual=self._tree.residual,
            row_scale=row_scale(self.robot),
            column_scale=column_scale(self.robot),
            out_of_range=self._tree.out_of_range,
            force_size=force_sizes(self.robot, *moving, self._wrenches),
        )

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

        By automatic and implicit differentiation; evaluated by casadi, on this thread. The first call for a robot and
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
        robot = self.robot
        carriers = require_matching_carriers(robot, carriers, len(self.motion))
        design = parameters if isinstance(parameters, Design) else design_of(robot, parameters)
        for wrench in of_kind(robot.loads, Wrench):
            if not isinstance(wrench.value, np.ndarray):
                raise UnsupportedRobotError(
                    f"{wrench!r} is a function whose own derivatives are not known.",
                    remedy="Pass its values at the samples, and add its derivatives by x and xd.",
                    frame=wrench.frame,
                )
        tree = self._tree.with_carriers(carriers)
        partials, _, share = motion_partials(robot, design, tree.q, tree.v, tree.a, self._external)
        return MotionDerivatives(design.names, share=share, reduced=self.reduce(carriers), **partials)

    def expressions(self, s: Any, sd: Any, sdd: Any) -> tuple[Any, Any]:
        """Return casadi's f (n, N) and carrier forces (k, N) of expressions of the carriers' motion, (k, N) each."""
        tree, n = self._tree, self.robot.n
        known = [part.T for part in (tree.q, self._trig, tree.v, tree.a)]
        known.append(tree.gamma.reshape(-1, n).T)  # the n rows of one sample beside those of the next
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
        return np.concatenate([np.zeros((len(self.motion), 0)), *self._wrenches], axis=1)

    @cached_property
    def _wrenches(self) -> tuple[Array, ...]:
        return wrench_values(self.robot.loads, self.motion.t, self.motion.x, self.motion.xd)

    def _mapped(
        self, name: str, carriers: CarrierMotion | None, widths: tuple[int, ...], *, gamma: bool = False
    ) -> list[Array]:
        samples, tree = len(self.motion), self._tree
        carriers = require_matching_carriers(self.robot, carriers, samples)
        inputs = [tree.q, self._trig, tree.v, tree.a, *([tree.gamma] if gamma else [])]
        inputs += [np.ascontiguousarray(part) for part in (carriers.s, carriers.sd, carriers.sdd, self._external)]
        outputs = [np.empty((samples, width)) for width in widths]

        def part(of: slice) -> None:
            self._dynamics.kernel.map(name, of.stop - of.start, [a[of] for a in inputs], [a[of] for a in outputs])

        in_threads(part, samples, self._dynamics.threads)
        if not tree.reachable.all():
            for output in outputs:
                output[~tree.reachable] = np.nan
        return outputs
