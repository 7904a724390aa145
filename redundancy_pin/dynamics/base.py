"""The protocol both dynamics backends speak, and the results they return."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Protocol, TypeAlias, TypeGuard, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, Frozen, IntArray, numbers, peak, read_only
from redundancy_pin.dynamics.forward import ForwardKernel
from redundancy_pin.errors import CarrierLimitError, InputError, UnsupportedRobotError, millimetres
from redundancy_pin.motion import (
    CarrierMotion,
    PlatformMotion,
    require_carrier_motion,
    require_consistent,
    require_sampled,
)
from redundancy_pin.robot import Load, Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.joint_ranges import track_slack
from redundancy_pin.status import SampleStatus

OnUnreachable = Literal["raise", "mark"]
"""What to do with a pose that no configuration closes: raise, or mark the sample with NaN and its residual."""

SampleArguments: TypeAlias = tuple[ArrayLike, ArrayLike, ArrayLike, ArrayLike, ArrayLike, ArrayLike]
"""x, xd, xdd, s, sd, sdd of ``Dynamics.torque``."""

SampleArrays: TypeAlias = tuple[Array, Array, Array, Array, Array, Array]
"""The same as arrays: x (n,) or (4, 4), xd and xdd (n,), s, sd and sdd (k,)."""


@dataclass(frozen=True, eq=False, repr=False)
class ReducedDynamics(Frozen):
    """The equation of motion W τ = f in independent coordinates, with the carrier forces.

    N samples, n independent (platform) coordinates, m main actuators, k carriers. ``f`` and ``W`` stay
    finite at a type II singularity, where W loses rank. Positive efforts do positive work on positive
    joint rates. Gravity and inertia are both inside ``f``.

    Attributes:
        t: (N,) time, s.
        f: (N, n) generalised force, N and N·m, in the base frame.
        W: (N, n, m) actuation matrix; its transpose maps ẋ to the actuated joint rates.
        carrier_force: (N, k) force of each carrier's own actuator, N.
        reachable: (N,) false where no configuration closes the chains (f, W, carrier_force are NaN there).
        residual: (N,) closure residual left by the kinematics, m; the distance to the nearest closed configuration
            found where ``reachable`` is false.
        row_scale: (n,) the characteristic length for rotations, 1 for translations: dividing row i of W and f by it
            turns moments into forces.
        column_scale: (m,) the characteristic length for revolute actuators, 1 for prismatic ones.
        out_of_range: (N,) whether some joint is beyond its range, passive ones too; None where that was not checked.
        force_size: (N,) size of the forces of the motion before they cancel, N: mass · (gravity + length · (rate² +
            acceleration)), plus loads. Tolerances on f are fractions of it. None if W and f do not come from a robot.
    """

    t: Array
    f: Array
    W: Array
    carrier_force: Array
    reachable: BoolArray
    residual: Array
    row_scale: Array
    column_scale: Array
    out_of_range: BoolArray | None = None
    force_size: Array | None = None

    def __repr__(self) -> str:
        """Return shapes and peaks, not the arrays."""
        unreached = "" if self.reachable.all() else f", {int((~self.reachable).sum())} unreachable"
        return (
            f"ReducedDynamics(N={len(self.t)}, n={self.W.shape[1]}, m={self.W.shape[2]}, "
            f"k={self.carrier_force.shape[1]}{unreached}; {peak('f', self.f, 'N or N·m')})"
        )

    def at(self, samples: slice | IntArray) -> ReducedDynamics:
        """Return some of the samples."""
        names = ("t", "f", "W", "carrier_force", "reachable", "residual", "out_of_range", "force_size")
        parts = {name: getattr(self, name) for name in names}
        chosen: dict[str, Any] = {name: part if part is None else part[samples] for name, part in parts.items()}
        return replace(self, **chosen)


class ReducedSample(Protocol):
    """W τ = f at one sample; what ``Dynamics.sample`` returns."""

    @property
    def W(self) -> Array:
        """(n, m) actuation matrix."""

    @property
    def f(self) -> Array:
        """(n,) generalised force, N and N·m, in the base frame."""

    @property
    def carrier_force(self) -> Array:
        """(k,) force of each carrier's own actuator, N."""


class Sample(NamedTuple):
    """One sample of the equation of motion: W (n, m), f (n,), carrier_force (k,); see ``ReducedDynamics``."""

    W: Array
    f: Array
    carrier_force: Array


class TorqueSample(NamedTuple):
    """Efforts of one sample, with a status; what ``Dynamics.torque`` returns.

    Attributes:
        tau: (m,) efforts of the main actuators, N or N·m; NaN where there are none.
        status: as ``distribute`` gives it.
        margin: singularity margin of type II, the smallest singular value of the scaled W, no unit; NaN without W.
        carrier_force: (k,) force of each carrier's actuator, N or N·m; NaN without W.
        residual: closure residual of the configuration, m; of an unreachable pose the residual that Newton's method
            ends with; NaN if it is not known.
        serial_margin: lower bound of the distance to a type I singularity, no unit (``JointTrajectory``'s
            ``serial_margin_bound``); joint rates and efforts grow as it falls. NaN without W, and of a closed form.
    """

    tau: Array
    status: SampleStatus
    margin: float
    carrier_force: Array
    residual: float
    serial_margin: float = math.nan


class AccelerationSample(NamedTuple):
    """Accelerations of the tree at one state, with a status; what ``Dynamics.acceleration`` returns.

    Attributes:
        a: (nv,) acceleration of the tree, m/s² and rad/s²; NaN unless the status is ok.
        status: ok; singular_inconsistent where the closures have lost rank, or a free motion has no inertia;
            not_finite.
    """

    a: Array
    status: SampleStatus


class JointStateSample(NamedTuple):
    """All joints and the platform at one instant; what ``Dynamics.joint_state`` returns.

    Attributes:
        q: (nq,) configuration of the tree, m and rad, as Pinocchio has it: carriers included.
        v: (nv,) its velocity, m/s and rad/s.
        x: (n,) platform coordinates in the base frame, m and rad; (4, 4) for a pose.
        xd: (n,) their rates; the twist of a pose, in world axes at the platform's origin.
        status: ok, near_singular (type II), out_of_range; otherwise all numbers but the residual are NaN. Redundant
            motors whose positions or velocities contradict each other are unreachable, as in ``forward_kinematics``:
            by more than 1e-8 characteristic lengths or rad, or than that fraction of the velocities.
        margin: singularity margin, the smallest singular value of the scaled W, no unit.
        residual: closure residual or mismatch of redundant motors, whichever is larger, m (angles times the
            characteristic length); NaN if unknown. To use one of several noisy encoders, declare fewer joints as
            actuated.
    """

    q: Array
    v: Array
    x: Array
    xd: Array
    status: SampleStatus
    margin: float
    residual: float


@dataclass(frozen=True, eq=False)
class CarrierDerivatives(Frozen):
    """Exact derivatives of f and of the carrier forces with respect to the carrier motion.

    Attributes:
        f_s, f_sd, f_sdd: (N, n, k) derivatives of f by s, ṡ, s̈.
        force_s, force_sd, force_sdd: (N, k, k) derivatives of carrier_force by s, ṡ, s̈.
    """

    f_s: Array
    f_sd: Array
    f_sdd: Array
    force_s: Array
    force_sd: Array
    force_sdd: Array


TERMS = 5
"""Terms by which a carrier on a straight track enters W τ = f: s, s², ṡ, s ṡ and s̈."""


class CarrierTerms(NamedTuple):
    """W τ = f at N instants for every motion of carriers on straight tracks: they enter by s, s², ṡ, s ṡ and s̈.

    N samples, n independent coordinates, m main actuators, k carriers; NaN where no configuration closes the chains.

    ``W`` (N, n, m) actuation matrix; ``constant`` (N, n + k) f and the carriers' forces with the carriers at rest at
    s = 0, N and N·m; ``terms`` (N, k, 5, n + k) their increments per unit of s, s², ṡ, s ṡ and s̈ of each
    carrier. A carrier adds nothing to the force of another one.
    """

    W: Array
    constant: Array
    terms: Array


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
    """From platform and carrier motion to W τ = f. Planners know this and nothing else; a backend defines ``along``."""

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
        """Return W, f and carrier forces at one sample: ``reduce`` for those who ask sample after sample.

        Arguments are those of ``torque``. Tracks are not checked.

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
        one: the reference is not returned to. Numbers that are not finite have the status not_finite,
        and so have those beyond 1e100, except in generated code, which takes any whose forces do not overflow.
        A carrier beyond its track is out_of_range like any other joint.

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
        """Return what ``torque`` returns, by a backend."""
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


def sample_arrays(robot: Robot, given: SampleArguments) -> SampleArrays:
    """Return the arguments of one sample as arrays of doubles; they need not be finite, nor x a pose.

    Arguments of the carriers that are empty are zero; one number is that of all carriers.

    Raises:
        InputError: wrong shapes, or what is no real number.
    """
    x, xd, xdd, *tracks = given
    n, k = robot.n, robot.k
    pose = (4, 4) if is_pose(robot) else (n,)
    platform = numbers(x, "x", pose), numbers(xd, "xd", (n,)), numbers(xdd, "xdd", (n,))
    carriers = []
    for part, name in zip(tracks, ("s", "sd", "sdd"), strict=True):
        shape = np.shape(part)
        if shape == (0,):
            carriers.append(np.zeros(k))
        else:
            carriers.append(numbers(part, name, (k,)) if shape else np.full(k, numbers(part, name, ())))
    return (*platform, carriers[0], carriers[1], carriers[2])


def one_sample(robot: Robot, given: SampleArguments, t: float) -> tuple[PlatformMotion, CarrierMotion]:
    """Return motions of one sample; arguments as of ``Dynamics.sample``.

    Raises:
        InputError: wrong shapes, values that are not finite, or a matrix that is no pose.
    """
    x, xd, xdd, s, sd, sdd = (part[None] for part in sample_arrays(robot, given))
    return PlatformMotion([t], x, xd, xdd), CarrierMotion(s, sd, sdd)


def require_choice(unreachable: str) -> None:
    """Check what to do with unreachable poses.

    Raises:
        InputError: neither "raise" nor "mark".
    """
    if unreachable not in ("raise", "mark"):
        raise InputError(f"unreachable is {unreachable!r}.", remedy='Pass "raise" or "mark".')


def require_matching_carriers(robot: Robot, carriers: CarrierMotion | None, samples: int) -> CarrierMotion:
    """Return the carrier motion; parked at s = 0 when left out.

    Raises:
        InputError: wrong number of samples or carriers.
    """
    if carriers is None:
        return CarrierMotion.parked(samples, robot.k)
    require_carrier_motion(carriers)
    if carriers.s.shape != (samples, robot.k):
        raise InputError(
            f"The carrier motion has shape {carriers.s.shape}, expected {(samples, robot.k)}.",
            remedy=f"{robot.name} has k = {robot.k} carriers; give one row for each sample of the platform motion.",
        )
    return carriers


def require_on_track(robot: Robot, carriers: CarrierMotion, t: Array) -> None:
    """Check that every carrier stays on its track.

    Args:
        robot: the robot.
        carriers: (N, k) carrier motion.
        t: (N,) time, s, for the message.

    Raises:
        CarrierLimitError: naming carrier, sample, time and the amount by which it leaves the track.
    """
    lower = np.array([limits.lower for limits in robot.carrier_limits])
    upper = np.array([limits.upper for limits in robot.carrier_limits])
    outside = np.maximum(lower - carriers.s, carriers.s - upper)
    if (outside > track_slack(robot)).any():
        k, i = (int(j) for j in np.unravel_index(int(outside.argmax()), outside.shape))
        raise CarrierLimitError(
            f"Carrier {robot.carriers[i]!r} leaves its track [{lower[i]:g}, {upper[i]:g}] m by {outside[k, i]:.3g} m "
            f"at sample {k} (t = {t[k]:.6g} s, s = {carriers.s[k, i]:.6g} m)."
            f"{millimetres(float(outside[k, i]), float(upper[i] - lower[i]))}",
            remedy="Shorten the motion or lengthen the track; planners evaluate off the track with check_track=False.",
            carrier=robot.carriers[i],
            sample=k,
            time=float(t[k]),
            amount=float(outside[k, i]),
        )
