"""The protocol of a backend: from motions of platform and carriers to W τ = f."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Protocol, TypeGuard, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.arguments import (
    OnUnreachable,
    SampleArguments,
    one_sample,
    require_matching_carriers,
    require_on_track,
)
from redundancy_pin.dynamics.forward import ForwardKernel
from redundancy_pin.dynamics.results import (
    TERMS,
    AccelerationSample,
    CarrierDerivatives,
    CarrierTerms,
    JointStateSample,
    ReducedDynamics,
    ReducedSample,
    Sample,
    TorqueSample,
)
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_consistent, require_sampled
from redundancy_pin.robot import Load, Robot


class DynamicsAlongMotion(Protocol):
    """Dynamics along one platform motion whose kinematics are already solved.

    The pose does not depend on the carriers, so everything here can be computed again and again for new
    carrier motions at the cost of the dynamics alone.
    """

    @property
    def robot(self) -> Robot:
        """The robot."""

    @property
    def motion(self) -> PlatformMotion:
        """The platform motion."""

    @property
    def q(self) -> Array | None:
        """(N, nq) configurations of the tree, carriers at s = 0; NaN where unreachable. None of a closed form."""

    @property
    def gamma(self) -> Array | None:
        """(N, nv, n) Γ, velocity of the tree per unit of each independent velocity. None of a closed form."""

    def reduce(self, carriers: CarrierMotion | None = None) -> ReducedDynamics:
        """Return f, W and carrier forces; carriers parked at s = 0 when left out."""

    def carrier_derivatives(self, carriers: CarrierMotion | None = None) -> CarrierDerivatives:
        """Return the exact derivatives of f and carrier forces by s, ṡ, s̈."""

    def base_wrench(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N, 6) the wrench of the robot on its base.

        Shaking force (3, N) and moment (3, N·m) about the world origin, world axes: gravity of all moving bodies
        less the rate of change of their momentum. What is fixed to the base does not count.
        """

    def energy(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N,) kinetic plus potential energy, J (zero height at the world origin)."""

    def closure_margin(self) -> Array:
        """Return (N,) smallest over largest singular value of the scaled closures, signed.

        Zero where the closures lose rank and branches meet; the sign changes where the motion goes through one such
        pose. One throughout, where the kinematics of a backend have no closures; NaN where unreachable, or not known.
        """


class ExactAlongMotion(DynamicsAlongMotion, Protocol):
    """Dynamics along a motion that are expressions too; what some backends' ``along`` returns."""

    def expressions(self, s: Any, sd: Any, sdd: Any) -> tuple[Any, Any]:
        """Return casadi's f (n, N) and carrier forces (k, N) of expressions of the carriers' motion, (k, N) each.

        Exact, with derivatives of any order.
        """


def has_expressions(along: DynamicsAlongMotion) -> TypeGuard[ExactAlongMotion]:
    """Return whether a backend has expressions of f along a motion."""
    return callable(getattr(along, "expressions", None))


_Backend = TypeVar("_Backend", bound="Dynamics")


class Dynamics(Protocol):
    """From platform and carrier motion to W τ = f: the only interface of planners; a backend defines ``along``."""

    @property
    def robot(self) -> Robot:
        """The robot."""

    def along(self, motion: PlatformMotion, *, unreachable: OnUnreachable = "raise") -> DynamicsAlongMotion:
        """Solve the kinematics of a platform motion once, for many carrier motions.

        Raises:
            UnreachablePoseError: a pose cannot be closed (unless ``unreachable="mark"``).
            SingularPoseError: a pose is a type I singularity (unless ``unreachable="mark"``).
            WorkingModeError: the motion leaves the robot's working mode.
        """

    def for_robot(self: _Backend, robot: Robot) -> _Backend:
        """Return the same backend, with its settings, for a robot that differs in its loads, or its reference.

        Raises:
            UnsupportedRobotError: a load that the backend does not cover.
        """
        raise UnsupportedRobotError(
            f"{type(self).__name__} takes no loads.", remedy="Make it for a robot that has them: robot.loaded(...)."
        )

    def with_external(self: _Backend, *external: Load) -> _Backend:
        """Return the same backend for the robot with further loads (``Robot.loaded``).

        Raises:
            InputError: no load, an unknown link or joint.
            UnsupportedRobotError: a load that the backend does not cover.
        """
        return self.for_robot(self.robot.loaded(*external))

    def reduce(
        self,
        motion: PlatformMotion,
        carriers: CarrierMotion | None = None,
        *,
        unreachable: OnUnreachable = "raise",
        check_track: bool = True,
        external: Sequence[Load] = (),
    ) -> ReducedDynamics:
        """Return f, W and carrier forces along a platform motion and a carrier motion.

        Samples are computed one by one, and must be samples of a motion: positions that move while their rates are zero
        would get efforts of zero. For unrelated states, and for poses at rest, pass
        ``PlatformMotion(..., check_rates=False)``.

        Args:
            motion: N samples of the platform coordinates.
            carriers: N samples of the carriers; parked at s = 0 when left out.
            unreachable: as in ``along``.
            check_track: refuse carriers that leave their tracks.
            external: further loads: ``Wrench("platform", (N, 6))`` acts *on* that link at the
                samples, in world axes at its origin, so f falls by Jᵀ of it; ``Payload`` and others as well.

        Raises:
            CarrierLimitError: a carrier leaves its track and ``check_track`` is true.
            InputError: rates that contradict the positions (``require_consistent``), and as in ``along``.
            UnreachablePoseError, SingularPoseError, WorkingModeError: as in ``along``.
            UnsupportedRobotError: a load that the backend does not cover.
        """
        if len(external):
            loaded = self.with_external(*external)
            return loaded.reduce(motion, carriers, unreachable=unreachable, check_track=check_track)
        require_sampled(motion)
        matched = require_matching_carriers(self.robot, carriers, len(motion))
        require_consistent(motion, carriers)
        if check_track:
            require_on_track(self.robot, matched, motion.t)
        return self.along(motion, unreachable=unreachable).reduce(carriers)

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
    ) -> ReducedSample:
        """Return W, f and carrier forces at one sample: ``reduce`` for repeated single samples.

        Arguments as of ``torque``. Tracks are not checked.

        Raises:
            InputError, UnreachablePoseError, SingularPoseError, WorkingModeError: as in ``along``.
        """
        motion, carriers = one_sample(self.robot, (x, xd, xdd, s, sd, sdd), t)
        one = self.along(motion).reduce(carriers)
        return Sample(one.W[0], one.f[0], one.carrier_force[0])

    def torque(
        self,
        x: ArrayLike,
        xd: ArrayLike,
        xdd: ArrayLike,
        s: ArrayLike = (),
        sd: ArrayLike = (),
        sdd: ArrayLike = (),
        *,
        t: float = 0.0,
        start: ArrayLike | None = None,
    ) -> TorqueSample:
        """Return the efforts of one sample with a status: ``reduce`` and ``distribute``, for a control loop.

        The sample lies on the branch of ``start``, otherwise of the last sample that this thread solved, at first of
        the reference. The branch is followed along the straight line to x. Where that fails, the efforts are NaN with
        the status unreachable, type_i or branch_lost, and the next sample starts from the same configuration as this
        one, not from the reference. Numbers that are not finite have the status not_finite,
        and so have numbers beyond 1e100, except in generated code, which accepts any whose forces do not overflow if it
        reaches the sample. There a sample takes microseconds; a refused sample takes some milliseconds, but only once
        for repeated calls at the same x. A carrier beyond its track is out_of_range like any other joint.

        Args:
            x: (n,) platform coordinates in the base frame, m and rad; (4, 4) for a pose.
            xd: (n,) their rates, m/s and rad/s; the twist of a pose, in world axes at the platform's origin.
            xdd: (n,) their second rates.
            s: scalar or (k,) positions of the carriers on their tracks, m; 0 when left out.
            sd: scalar or (k,) their rates, m/s; 0 when left out.
            sdd: scalar or (k,) their second rates, m/s²; 0 when left out.
            t: time, s, for wrenches that depend on it.
            start: (nq,) a closed configuration nearby, whose branch is followed, in any working mode. It may be open
                by noise: closing it at its own coordinates must move joints by less than half the singularity margin
                (rad, characteristic lengths), which keeps K regular. Otherwise the sample is branch_lost.

        Raises:
            InputError: wrong shapes, or a matrix that is not a pose.
            UnsupportedRobotError: the backend has no such call.

        Example:
            >>> import redundancy_pin as rp
            >>> dynamics = rp.CompiledDynamics("five_bar")
            >>> tau, status, margin, *_ = dynamics.torque([0.2, 0.4], [0.5, 0.0], [0.0, 1.0])
            >>> status.label
            'ok'
        """
        return self._torque((x, xd, xdd, s, sd, sdd), t, start)

    def _torque(self, given: SampleArguments, t: float, start: ArrayLike | None) -> TorqueSample:
        """Return ``torque`` evaluated by a backend."""
        raise _has_no(self, "torque", "reduce and distribute")

    def acceleration(
        self, q: ArrayLike, v: ArrayLike, tau: ArrayLike, carrier_force: ArrayLike = (), *, t: float = 0.0
    ) -> AccelerationSample:
        """Return the accelerations of the tree at a closed state under efforts, with a status.

        Forward dynamics with the loops closed: M a + h = Sᵀ τ + J_cᵀ λ, J_c a = −J̇_c v. Loads of the robot act too.

        Args:
            q: (nq,) configuration, closed; whether it is, is not checked.
            v: (nv,) velocity, closed.
            tau: (m,) efforts of the main actuators, N or N·m.
            carrier_force: scalar or (k,) efforts of the carriers' own actuators, N or N·m; 0 when left out.
            t: time, s, for wrenches that depend on it.

        Raises:
            InputError: wrong shapes.
            UnsupportedRobotError: the backend has no such call.
        """
        raise _has_no(self, "acceleration", "simulate")

    def joint_state(
        self,
        position: ArrayLike,
        velocity: ArrayLike = (),
        s: ArrayLike = (),
        sd: ArrayLike = (),
        *,
        start: ArrayLike | None = None,
    ) -> JointStateSample:
        """Return all joints and the platform from the main actuators, on the branch, with a status.

        A sample takes microseconds. A refused sample takes some milliseconds, once for repeated calls at its position.

        Args:
            position: (m,) positions of the main actuators, m and rad.
            velocity: scalar or (m,) their velocities; 0 when left out.
            s: scalar or (k,) positions of the carriers on their tracks, m; 0 when left out.
            sd: scalar or (k,) their rates, m/s; 0 when left out.
            start: (nq,) a closed configuration nearby, whose branch is followed; when left out, the configuration of
                the last sample of this thread, at first the reference. From there the actuators move straight, in as
                many steps as needed.

        Raises:
            InputError: wrong shapes.
            UnsupportedRobotError: fewer main actuators than degrees of freedom; the backend has no such call.
        """
        raise _has_no(self, "joint_state", "forward_kinematics")

    def carrier_terms(self, t: Array, x: Array, xd: Array, xdd: Array) -> CarrierTerms:
        """Return W, and f as terms of the carriers' motion, at a few instants.

        Instants that cannot be reached are NaN; behind the first of them others may be, too.

        Tracks are assumed to be straight; ``planners.carrier_model`` tests that. The branch may be followed from the
        last instants of this thread, if they are near, instead of the reference.

        Args:
            t: (N,) increasing times, s.
            x: (N, n) platform coordinates in the base frame, m and rad; (N, 4, 4) for a pose.
            xd: (N, n) their rates.
            xdd: (N, n) their second rates.

        Raises:
            InputError, WorkingModeError: as in ``along``, unreachable samples marked.
        """
        motion = PlatformMotion(t, x, xd, xdd, check_rates=False)
        return terms_along(self.along(motion, unreachable="mark"))

    @property
    def terms_call(self) -> tuple[int, int, int] | None:
        """``carrier_terms`` as C, as ``rp_terms`` of ``dynamics/compiled/batch.c``; None if the backend has none.

        Addresses of the function, of the robot's numbers, and of the configurations where this thread continues.
        """
        return None

    def forward(self) -> ForwardKernel | None:
        """Return forward dynamics as machine code; None if the backend has none."""
        return None


def _has_no(dynamics: Dynamics, call: str, instead: str) -> UnsupportedRobotError:
    return UnsupportedRobotError(
        f"{type(dynamics).__name__} has no {call}.", remedy=f"Use CompiledDynamics, or {instead}."
    )


def terms_along(along: DynamicsAlongMotion) -> CarrierTerms:
    """Read the terms off a backend along a motion, from its exact derivatives at two motions of the carriers."""
    robot, samples = along.robot, len(along.motion)
    n, k = robot.n, robot.k
    rest = np.zeros((samples, k))
    # a hundred times the robot's length, whatever that is: far enough for the rounding of linear terms to be nothing
    length = 100.0 * robot.characteristic_length
    parked = CarrierMotion(rest, rest, rest, check_rates=False)
    displaced = CarrierMotion(rest + length, rest, rest, check_rates=False)
    reduced = along.reduce(parked)
    first, second = along.carrier_derivatives(parked), along.carrier_derivatives(displaced)

    def by_term(name: str) -> Array:
        by_s, by_sd, by_sdd = (np.asarray(getattr(first, f"{name}_{rate}")) for rate in ("s", "sd", "sdd"))
        both = (np.asarray(getattr(second, f"{name}_sd")) - by_sd) / length
        square = 0.5 * (np.asarray(getattr(second, f"{name}_s")) - by_s) / length
        return np.stack([by_s, square, by_sd, both, by_sdd], axis=-1)  # (N, n or k, k, 5)

    own, terms = np.arange(k), np.zeros((samples, k, TERMS, n + k))
    terms[..., :n] = by_term("f").transpose(0, 2, 3, 1)
    terms[:, own, :, n + own] = by_term("force")[:, own, own].transpose(1, 0, 2)
    constant = np.concatenate([reduced.f, reduced.carrier_force], axis=1)
    return CarrierTerms(reduced.W, read_only(constant), read_only(terms))
