"""Inverse dynamics of the 2-RPR and the 3-RRR, derived by hand from the principle of virtual work."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import AGREEMENT_TOLERANCE, Array, BoolArray, Frozen, read_only
from redundancy_pin.dynamics.arguments import OnUnreachable, SampleArguments, require_choice, require_matching_carriers
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.one_sample import solve_reduced_sample
from redundancy_pin.dynamics.results import CarrierDerivatives, ReducedDynamics, TorqueSample
from redundancy_pin.dynamics.virtual_work.loads import add_loads, require_known
from redundancy_pin.dynamics.virtual_work.mechanism import Carriers, Efforts
from redundancy_pin.dynamics.virtual_work.three_rrr import ThreeRrrLegs, ThreeRrrMechanism
from redundancy_pin.dynamics.virtual_work.two_rpr import TwoRprLegs, TwoRprMechanism
from redundancy_pin.errors import SingularPoseError, UnreachablePoseError, UnsupportedRobotError, millimetres
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import JointForces, Payload, Robot
from redundancy_pin.robot.checks import require_matching
from redundancy_pin.robot.declaration import CLOSED_FORM_ROLES
from redundancy_pin.robot.joint_ranges import joint_ranges
from redundancy_pin.robot.loads import of_kind, wrench_values
from redundancy_pin.robot.scales import column_scale, force_sizes, is_revolute, row_scale

__all__ = ["VirtualWork", "VirtualWorkAlongMotion"]

Mechanism = TwoRprMechanism | ThreeRrrMechanism
"""A mechanism in one working mode: ``legs`` solves the inverse displacement at (N, n) coordinates (residual, margin and
Jacobian of each leg; NaN passes through), ``along`` returns the dynamics along a motion through them. Arrays are
leg-major, (legs, N). Carrier i rides on leg i and acts on no other leg."""


class VirtualWork(Dynamics):
    """Hand-coded dynamics of the 2-RPR and the 3-RRR by the principle of virtual work.

    It knows the robot by its parameters alone: neither the URDF nor Pinocchio takes part, so that it can judge the
    backend that rests on them.

    Args:
        robot: a robot with a closed form ("2rpr" or "3rrr"), or its name or path.

    Raises:
        UnsupportedRobotError: the robot declares no closed form, or one that is not known here; or its model was
            replaced by one with another mass than its arguments (other changes of the model are not detected).

    Example:
        >>> motion = rp.trajectory.reference.corner().sample(0.01)
        >>> rp.VirtualWork(rp.load_robot("3rrr")).reduce(motion).W.shape[1:]
        (3, 3)
    """

    def __init__(self, robot: RobotLike) -> None:
        self._robot = as_robot(robot)
        self._mechanism = _mechanism_of(self._robot)
        _require_own_masses(self._robot, self._mechanism)
        require_known(self._robot, self._mechanism.frames, self._mechanism.joints)

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self._robot

    def for_robot(self, robot: Robot) -> VirtualWork:
        """Return this backend for a robot that differs in its loads; raises like it."""
        return VirtualWork(robot)

    def along(self, motion: PlatformMotion, *, unreachable: OnUnreachable = "raise") -> VirtualWorkAlongMotion:
        """Solve the kinematics of a platform motion once, for many carrier motions.

        The closed form keeps the robot's working mode by construction, so no ``WorkingModeError`` can arise; a
        motion up to the edge of its mode meets the type I singularity there.

        Raises:
            InputError: the motion does not have the robot's coordinates, or a wrong ``unreachable``.
            UnreachablePoseError: a leg does not reach (unless marked).
            SingularPoseError: a leg is at a type I singularity (unless marked).
        """
        require_choice(unreachable)
        require_matching(self._robot, motion)
        legs = self._mechanism.legs(motion.x)
        residual = legs.residual.max(axis=0)
        bad_leg = (legs.residual > self._mechanism.tolerance) | (legs.margin <= self._mechanism.least_margin)
        reachable: BoolArray = np.logical_not(bad_leg.any(axis=0))
        if not reachable.all():
            if unreachable == "raise":
                _refuse(legs, int(reachable.argmin()), self._robot, self._mechanism)
            # NaN in, NaN out: the samples to blank take part in the arithmetic, and in no warning.
            legs = self._mechanism.legs(np.where(reachable[:, None], motion.x, np.nan))
        return VirtualWorkAlongMotion(self._robot, self._mechanism, motion, legs, residual, reachable)

    def _torque(self, given: SampleArguments, t: float, start: ArrayLike | None) -> TorqueSample:
        # the closed form has one branch, given by the working mode, and needs no start
        springs = (load.joint for load in of_kind(self._robot.loads, JointForces) if load.stiffness)
        if any(is_revolute(self._robot, joint) for joint in springs):
            raise UnsupportedRobotError(
                "One sample does not determine the whole turns of a hinge, on which its spring depends.",
                remedy="Use reduce and distribute for whole motions, or RneaDynamics.",
            )
        return solve_reduced_sample(self, given, t)


class VirtualWorkAlongMotion(Frozen):
    """Closed-form dynamics along one platform motion; obtained from ``VirtualWork.along``.

    Rows of samples that are not reachable are NaN in every result. A carrier motion that does not fit the robot or the
    platform motion raises ``InputError``.

    Attributes:
        robot, motion: the robot, and its platform motion.
        q, gamma: None: a closed form has no tree.
    """

    def __init__(
        self,
        robot: Robot,
        mechanism: Mechanism,
        motion: PlatformMotion,
        legs: Any,
        residual: Array,
        reachable: BoolArray,
    ) -> None:
        self.robot, self.motion = robot, motion
        self.q = self.gamma = None
        self._reachable, self._residual = read_only(reachable), read_only(residual)
        self._dynamics = mechanism.along(legs, motion.x, motion.xd, motion.xdd)
        self._W = read_only(np.ascontiguousarray(legs.jacobian.transpose(2, 0, 1)))

    def reduce(self, carriers: CarrierMotion | None = None) -> ReducedDynamics:
        """Return f, W and carrier forces; carriers parked at s = 0 when left out. Tracks are not checked."""
        moved, k = self._leg_major(carriers), self.robot.k
        efforts, moving = self._efforts(moved), (self.motion.xd, self.motion.xdd, moved[1][:k].T, moved[2][:k].T)
        return ReducedDynamics(
            t=self.motion.t,
            f=self._result(np.ascontiguousarray(efforts.f.T)),
            W=self._W,
            carrier_force=self._result(np.ascontiguousarray(efforts.force[:k].T)),
            reachable=self._reachable,
            residual=self._residual,
            row_scale=row_scale(self.robot),
            column_scale=column_scale(self.robot),
            out_of_range=self._out_of_range,
            force_size=force_sizes(self.robot, *moving, self._wrenches),
        )

    @cached_property
    def _out_of_range(self) -> BoolArray:
        still = self._leg_major(None)
        beyond = np.zeros(len(self.motion), dtype=bool)
        for joint in joint_ranges(self.robot):
            value = self._dynamics.joint(joint.name, still).position[self._reachable]
            value = np.unwrap(value) if joint.turns else value  # a closed form has angles in (−π, π]
            beyond[self._reachable] |= joint.excess(value, True) > joint.slack
        return read_only(beyond)

    def carrier_derivatives(self, carriers: CarrierMotion | None = None) -> CarrierDerivatives:
        """Return the exact derivatives of f and carrier forces by s, ṡ, s̈."""
        k, efforts = self.robot.k, self._efforts(self._leg_major(carriers), derivatives=True)
        of_f = [self._result(part[:, :k].transpose(2, 0, 1).copy()) for part in efforts.by_f]
        of_force = [self._result(part[:k, :k].transpose(2, 0, 1).copy()) for part in efforts.by_force]
        return CarrierDerivatives(*of_f, *of_force)

    def base_wrench(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N, 6) the wrench on the base, N and N·m; gravity out of the plane enters here, and here alone."""
        return self._result(self._efforts(self._leg_major(carriers)).ground)

    def energy(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N,) kinetic plus potential energy, J (zero height at the world origin)."""
        return self._result(self._efforts(self._leg_major(carriers)).energy)

    def closure_margin(self) -> Array:
        """Return (N,) ones, NaN where unreachable: in one working mode the closed form has no branches that meet."""
        return read_only(np.where(self._reachable, 1.0, np.nan))

    @cached_property
    def _wrenches(self) -> tuple[Array, ...]:
        return wrench_values(self.robot.loads, self.motion.t, self.motion.x, self.motion.xd)

    def _efforts(self, carriers: Carriers, *, derivatives: bool = False) -> Efforts:
        """Return the generalised forces of links, carriers and loads."""
        efforts = self._dynamics.efforts(carriers, derivatives=derivatives)
        add_loads(efforts, self.robot, self._wrenches, self._dynamics, carriers)
        return efforts

    def _leg_major(self, carriers: CarrierMotion | None) -> Carriers:
        """Return s, ṡ, s̈ as (legs, N); zero where the robot has no carriers."""
        matched = require_matching_carriers(self.robot, carriers, len(self.motion))
        if self.robot.k == 0:
            return (np.zeros((self.robot.m, len(self.motion))),) * 3
        return matched.s.T.copy(), matched.sd.T.copy(), matched.sdd.T.copy()

    def _result(self, array: Array) -> Array:
        array[~self._reachable] = np.nan
        return read_only(array)


def _mechanism_of(robot: Robot) -> Mechanism:
    known = robot.parameters, robot.gravity.tolist(), robot.working_mode
    if (robot.closed_form, len(robot.working_mode)) == ("2rpr", 2):
        return TwoRprMechanism(*known)
    if (robot.closed_form, len(robot.working_mode)) == ("3rrr", 3):
        return ThreeRrrMechanism(*known)
    raise UnsupportedRobotError(
        "Virtual work is written out for the 2-RPR and the 3-RRR, their motors, modes and carriers in their order; "
        f"{robot.name} does not declare one of these closed forms, or has other motors, modes or carriers.",
        remedy="Use the backend rnea (RneaDynamics), which covers every robot.",
        robot=robot.name,
        closed_form=robot.closed_form,
        roles={name: (motors, modes) for name, (motors, modes, _, _) in CLOSED_FORM_ROLES.items()},
    )


def _require_own_masses(robot: Robot, mechanism: Mechanism) -> None:
    """Raise UnsupportedRobotError for a robot whose model was replaced: closed forms read its arguments."""
    moving = {name for body in robot.bodies for name in body.links}
    payloads = sum(load.mass for load in of_kind(robot.loads, Payload) if load.frame in moving)
    own, known = robot.moving_mass - payloads, sum(body.mass for body in mechanism.bodies)
    if not abs(own - known) <= AGREEMENT_TOLERANCE * max(own, known):
        raise UnsupportedRobotError(
            f"The bodies of {robot.name} have {own:.9g} kg in its model and {known:.9g} kg by its arguments, which "
            "virtual work reads.",
            remedy="Use RneaDynamics, and pass closed_form=None where the model is replaced.",
            robot=robot.name,
            masses=(own, known),
        )


def _refuse(legs: TwoRprLegs | ThreeRrrLegs, sample: int, robot: Robot, mechanism: Mechanism) -> None:
    residual, margin = legs.residual[:, sample], legs.margin[:, sample]
    if residual.max() > mechanism.tolerance:
        leg = int(residual.argmax())
        raise UnreachablePoseError(
            f"{robot.name} does not reach sample {sample}: leg {leg + 1} misses the platform by {residual[leg]:.3g} m."
            f"{millimetres(float(residual[leg]), robot.characteristic_length)}",
            remedy='Move the motion into the workspace. Inverse dynamics can mark such samples: unreachable="mark", '
            "on the command line --unreachable mark.",
            sample=sample,
            leg=leg,
            residual=float(residual[leg]),
        )
    leg = int(margin.argmin())
    raise SingularPoseError(
        f"{robot.name} is at a type I singularity at sample {sample}: the rate of leg {leg + 1} is not determined "
        f"(margin {margin[leg]:.3g}, at least {mechanism.least_margin:.3g} is needed).",
        remedy="Keep the motion away from the edge of the working mode. Inverse dynamics can mark such samples: "
        'unreachable="mark".',
        sample=sample,
        leg=leg,
        margin=float(margin[leg]),
    )
