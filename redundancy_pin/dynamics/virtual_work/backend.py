"""The virtual-work backend: closed-form dynamics behind the protocol of ``dynamics.base``."""

from __future__ import annotations

from typing import cast

import numpy as np

from redundancy_pin.arrays import CLOSURE_TOLERANCE, Array, BoolArray, read_only
from redundancy_pin.dynamics.base import (
    CarrierDerivatives,
    OnUnreachable,
    ReducedDynamics,
    require_choice,
    require_matching,
    require_on_track,
)
from redundancy_pin.dynamics.virtual_work.mechanism import (
    Mechanism,
    MechanismAlongMotion,
    MechanismLegs,
    base_wrench,
    energy,
)
from redundancy_pin.dynamics.virtual_work.three_rrr import ThreeRrrMechanism, ThreeRrrParameters
from redundancy_pin.dynamics.virtual_work.two_rpr import TwoRprMechanism, TwoRprParameters
from redundancy_pin.errors import (
    InputError,
    SingularPoseError,
    UnreachablePoseError,
    UnsupportedRobotError,
)
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_sampled
from redundancy_pin.robot import Robot


class VirtualWork:
    """Hand-coded dynamics of the 2-RPR and the 3-RRR by the principle of virtual work.

    It knows the robot by its parameters alone: neither the URDF nor Pinocchio takes part, so that it can judge the
    backend that rests on them.

    Args:
        robot: a robot with a closed form ("2rpr" or "3rrr").

    Raises:
        UnsupportedRobotError: the robot declares no closed form, or one that is not known here.
    """

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self._mechanism = _mechanism_of(robot)

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self._robot

    def along(self, motion: PlatformMotion, *, unreachable: OnUnreachable = "raise") -> VirtualWorkAlongMotion:
        """Solve the kinematics of a platform motion once, for many carrier motions.

        The closed form keeps the robot's working mode by construction, so no ``WorkingModeError`` can arise; a
        motion up to the edge of its mode meets the type I singularity there.

        Args:
            motion: N samples of the platform coordinates, base frame, m and rad.
            unreachable: raise on the first pose that is out of reach or singular (type I), or mark all of them.

        Raises:
            InputError: the motion has the wrong number of coordinates, or holds poses, or ``unreachable`` is neither
                "raise" nor "mark".
            UnreachablePoseError: a leg does not reach (unless marked).
            SingularPoseError: a leg is at a type I singularity (unless marked).
        """
        require_choice(unreachable)
        require_sampled(motion)
        rows = len(self._mechanism.angular_rows)
        if motion.is_pose or motion.xd.shape[1] != rows:
            raise InputError(
                f"{self._robot.name} moves in {rows} platform coordinates; the motion has x of shape {motion.x.shape}.",
                remedy=f"Pass x, xd and xdd of shape (N, {rows}).",
                robot=self._robot.name,
                axes=self._robot.platform.axes if self._robot.platform else self._robot.independent_joints,
                poses=False,
                given=motion.xd.shape[1],
                given_poses=motion.is_pose,
            )
        legs = self._mechanism.legs(motion.x)
        bad_leg = (legs.gap > CLOSURE_TOLERANCE) | (legs.margin <= legs.least_margin)
        if not bad_leg.any():
            reachable = read_only(np.ones(len(motion), dtype=bool))
            return VirtualWorkAlongMotion(self._robot, self._mechanism, motion, legs, legs.gap.max(axis=0), reachable)
        if unreachable == "raise":
            _refuse(legs, bad_leg, self._robot)
        reachable = read_only(np.asarray(~bad_leg.any(axis=0)))
        gap = legs.gap.max(axis=0)
        # NaN in, NaN out: the samples to blank take part in the arithmetic, and in no warning.
        legs = self._mechanism.legs(np.where(reachable[:, None], motion.x, np.nan))
        return VirtualWorkAlongMotion(self._robot, self._mechanism, motion, legs, gap, reachable)

    def reduce(
        self,
        motion: PlatformMotion,
        carriers: CarrierMotion | None = None,
        *,
        unreachable: OnUnreachable = "raise",
        check_track: bool = True,
    ) -> ReducedDynamics:
        """Return f, W and carrier forces along a platform motion and a carrier motion.

        Args:
            motion: N samples of the platform coordinates.
            carriers: N samples of the carriers; parked at s = 0 when left out.
            unreachable: as in ``along``.
            check_track: refuse carriers that leave their tracks.

        Raises:
            CarrierLimitError: a carrier leaves its track and ``check_track`` is true.
            InputError, UnreachablePoseError, SingularPoseError: as in ``along``.
        """
        require_sampled(motion)
        if check_track:
            require_on_track(self._robot, require_matching(self._robot, carriers, len(motion)), motion.t)
        return self.along(motion, unreachable=unreachable).reduce(carriers)


class VirtualWorkAlongMotion:
    """Closed-form dynamics along one platform motion; obtained from ``VirtualWork.along``.

    Rows of samples that are not reachable are NaN in every result.
    """

    def __init__(
        self,
        robot: Robot,
        mechanism: Mechanism,
        motion: PlatformMotion,
        legs: MechanismLegs,
        gap: Array,
        reachable: BoolArray,
    ) -> None:
        self._robot = robot
        self._motion = motion
        self._reachable = reachable
        self._all_reachable = bool(reachable.all())
        self._gap = read_only(gap)
        self._dynamics: MechanismAlongMotion = legs.along(motion.xd, motion.xdd)
        self._W = read_only(self._dynamics.jacobian.transpose(0, 2, 1))
        length = robot.characteristic_length
        self._row_scale = read_only(np.where(mechanism.angular_rows, length, 1.0))
        self._column_scale = read_only(np.where(mechanism.angular_columns, length, 1.0))

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self._robot

    @property
    def motion(self) -> PlatformMotion:
        """The platform motion."""
        return self._motion

    def reduce(self, carriers: CarrierMotion | None = None) -> ReducedDynamics:
        """Return f, W and carrier forces; carriers parked at s = 0 when left out. Tracks are not checked.

        Raises:
            InputError: the carrier motion does not fit the robot or the platform motion.
        """
        f, force = self._dynamics.efforts(*self._leg_major(carriers))
        return ReducedDynamics(
            t=self._motion.t,
            f=self._result(np.ascontiguousarray(f.T)),
            W=self._W,
            carrier_force=self._result(np.ascontiguousarray(force[: self._robot.k].T)),
            reachable=self._reachable,
            gap=self._gap,
            row_scale=self._row_scale,
            column_scale=self._column_scale,
        )

    def carrier_derivatives(self, carriers: CarrierMotion | None = None) -> CarrierDerivatives:
        """Return the exact derivatives of f and carrier forces by s, ṡ, s̈.

        Raises:
            InputError: as ``reduce``.
        """
        d = self._dynamics.effort_derivatives(*self._leg_major(carriers))
        f = (self._result(np.moveaxis(part[:, : self._robot.k], 2, 0).copy()) for part in (d.f_s, d.f_sd, d.f_sdd))
        force = (self._diagonal(part) for part in (d.force_s, d.force_sd, d.force_sdd))
        return CarrierDerivatives(*f, *force)

    def base_wrench(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N, 6) the wrench of the robot on its base: weight less the rate of momentum.

        Shaking force, N, and moment about the world origin, N·m, world axes. Gravity out of the plane enters here,
        and here alone.

        Raises:
            InputError: as ``reduce``.
        """
        return self._result(base_wrench(self._dynamics.bodies(*self._leg_major(carriers)), self._robot.gravity))

    def energy(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N,) kinetic plus potential energy, J (zero height at the world origin).

        Raises:
            InputError: as ``reduce``.
        """
        return self._result(energy(self._dynamics.bodies(*self._leg_major(carriers)), self._robot.gravity))

    def _leg_major(self, carriers: CarrierMotion | None) -> tuple[Array, Array, Array]:
        """Return s, ṡ, s̈ as (legs, N); zero where the robot has no carriers."""
        samples = len(self._motion)
        if carriers is not None:
            require_matching(self._robot, carriers, samples)
        if carriers is None or self._robot.k == 0:
            zero = np.zeros((self._robot.m, samples))
            return zero, zero, zero
        return (
            np.ascontiguousarray(carriers.s.T),
            np.ascontiguousarray(carriers.sd.T),
            np.ascontiguousarray(carriers.sdd.T),
        )

    def _diagonal(self, per_leg: Array) -> Array:
        k = self._robot.k
        full = np.zeros((len(self._motion), k, k))
        each = np.arange(k)
        full[:, each, each] = per_leg[:k].T
        return self._result(full)

    def _result(self, array: Array) -> Array:
        if not self._all_reachable:
            array[~self._reachable] = np.nan
        return read_only(array)


def _mechanism_of(robot: Robot) -> Mechanism:
    gravity = cast("tuple[float, float, float]", tuple(float(component) for component in robot.gravity))
    mode = robot.working_mode
    if robot.closed_form == "2rpr" and len(mode) == 2:
        return TwoRprMechanism(TwoRprParameters.from_parameters(robot.parameters, gravity), mode)
    if robot.closed_form == "3rrr" and len(mode) == 3:
        return ThreeRrrMechanism(ThreeRrrParameters.from_parameters(robot.parameters, gravity), mode)
    declared = f"{robot.closed_form!r} and {len(mode)} legs" if robot.closed_form else "neither"
    raise UnsupportedRobotError(
        f"Virtual work is written out for the 2-RPR (closed form '2rpr', two legs) and the 3-RRR ('3rrr', three legs); "
        f"{robot.name} declares {declared}.",
        remedy="Use RneaDynamics, which covers every robot.",
        robot=robot.name,
        closed_form=robot.closed_form,
    )


def _refuse(legs: MechanismLegs, bad_leg: BoolArray, robot: Robot) -> None:
    sample = int(bad_leg.any(axis=0).argmax())
    gap, margin = legs.gap[:, sample], legs.margin[:, sample]
    if gap.max() > CLOSURE_TOLERANCE:
        leg = int(gap.argmax())
        raise UnreachablePoseError(
            f"{robot.name} does not reach sample {sample}: leg {leg + 1} misses the platform by {gap[leg]:.3g} m.",
            remedy='Move the motion into the workspace, or pass unreachable="mark".',
            sample=sample,
            leg=leg,
            gap=float(gap[leg]),
        )
    leg = int(margin.argmin())
    raise SingularPoseError(
        f"{robot.name} is at a type I singularity at sample {sample}: the rate of leg {leg + 1} is not determined "
        f"(margin {margin[leg]:.3g}, at least {legs.least_margin:.3g} is needed).",
        remedy='Keep the motion away from the edge of the working mode, or pass unreachable="mark".',
        sample=sample,
        leg=leg,
        margin=float(margin[leg]),
    )
