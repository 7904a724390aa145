"""Dynamics of any declared robot: Pinocchio's recursive Newton–Euler on the tree, projected on the closed chains.

With v = Γ ẋ + C ṡ and J_c Γ = 0 the constraint forces drop out of the equation of motion of the tree, and

    W τ = f,   W = Γᵀ Sᵀ,   f = Γᵀ rnea(q, v, a),   carrier force = Cᵀ rnea(q, v, a).

Γ depends on the platform motion alone, so it is computed once a motion. Loads of the robot (``Robot.loaded``) add the
generalised forces L of ``tree_loads`` to those of rnea.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, Frozen, blocks, checked, frozen, read_only, require_type
from redundancy_pin.dynamics.base import (
    CarrierDerivatives,
    Dynamics,
    OnUnreachable,
    ReducedDynamics,
    TorqueSample,
    one_sample,
    require_choice,
    require_matching_carriers,
)
from redundancy_pin.dynamics.one_sample import REFUSALS, is_finite, solve_sample, status_of, without_answer
from redundancy_pin.dynamics.tree_loads import TreeState, tree_energy, tree_loads
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.assembly import SINGULAR_MARGIN
from redundancy_pin.kinematics.chain import tracker
from redundancy_pin.kinematics.closure import ConstraintState, constraint_system, with_all_rows
from redundancy_pin.kinematics.continuation import Point
from redundancy_pin.kinematics.inverse_kinematics import JointTrajectory, inverse_kinematics
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import Robot, RobotLike, as_robot
from redundancy_pin.robot.loads import wrench_values
from redundancy_pin.robot.lookup import find_link, joint_names
from redundancy_pin.robot.scales import column_scale, row_scale, sample_scales, velocity_scale
from redundancy_pin.status import SampleStatus

SAMPLES_PER_BLOCK = 20_000
"""Samples beyond these go through RNEA in blocks, so that the memory they take does not grow."""

_SAMPLES_PER_THREAD = 500
"""Below this a second thread costs more than it brings."""


@dataclass(frozen=True, eq=False)
class RneaSample(Frozen):
    """One sample of the equation of motion, and where the next one may start from.

    Attributes:
        W: (n, m) actuation matrix.
        f: (n,) generalised force, N and N·m, in the base frame.
        carrier_force: (k,) force of each carrier's own actuator, N.
        point: the pose, its configuration q (nq,) with carriers at zero, and Γ (nv, n).
        gap: closure residual, m.
        serial_margin_bound: lower bound of the distance to a type I singularity, scaled.
    """

    W: Array
    f: Array
    carrier_force: Array
    point: Point
    gap: float
    serial_margin_bound: float


class RneaDynamics(Dynamics):
    """Closed-chain dynamics through Pinocchio's RNEA and constraint Jacobians, for any declared robot.

    ``reduce`` is inherited: it is ``along(motion).reduce(carriers)`` after a check of the tracks (``Dynamics.reduce``).

    Args:
        robot: the robot, or its name or path.
        threads: threads of the batched RNEA; as many as there are processors when left out.
        progress: called with samples done and samples in all while the kinematics of a motion are solved.
    """

    def __init__(
        self, robot: RobotLike, *, threads: int | None = None, progress: Callable[[int, int], None] | None = None
    ) -> None:
        self._robot, self._progress = as_robot(robot), progress
        self.threads = threads or os.cpu_count() or 1
        self._parked = frozen(np.zeros(self._robot.k))
        self._last: dict[int, RneaSample] = {}
        """By thread the sample from which ``torque`` goes on."""

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self._robot

    def along(self, motion: PlatformMotion, *, unreachable: OnUnreachable = "raise") -> RneaAlongMotion:
        """Solve the kinematics of a platform motion once; raises as ``inverse_kinematics``."""
        require_choice(unreachable)
        marked = unreachable == "mark"
        tree = inverse_kinematics(self._robot, motion, mark_unreachable=marked, progress=self._progress)
        return RneaAlongMotion(tree, self.threads)

    def for_robot(self, robot: Robot) -> RneaDynamics:
        """Return this backend for a robot that differs in its loads."""
        return RneaDynamics(robot, threads=self.threads, progress=self._progress)

    def sample(
        self,
        x: ArrayLike,
        xd: ArrayLike,
        xdd: ArrayLike,
        s: ArrayLike = (),
        sd: ArrayLike = (),
        sdd: ArrayLike = (),
        *,
        start: RneaSample | None = None,
        t: float = 0.0,
    ) -> RneaSample:
        """Return W, f and carrier forces at one sample; see ``Dynamics.sample``.

        ``start`` is an earlier result, of a pose nearby. The branch is followed from there on a straight line, in tens
        of microseconds, and not from the reference configuration; where it does not lead to x, that is an error.

        Raises:
            InputError, UnreachablePoseError, SingularPoseError, WorkingModeError: as in ``along``.
        """
        robot = self._robot
        if start is not None and not isinstance(start, RneaSample):
            raise InputError(
                f"start is a {type(start).__name__}, expected what an earlier sample of RneaDynamics returned.",
                remedy="Pass that, or leave it out.",
            )
        sample = self._direct_sample((x, xd, xdd, s, sd, sdd), start, t)
        if sample is not None:
            return sample
        motion, carriers = one_sample(robot, x, xd, xdd, s, sd, sdd, t=t)
        tree = inverse_kinematics(robot, motion, start=None if start is None else start.point)
        one = RneaAlongMotion(tree).reduce(carriers)
        margin = float(tree.serial_margin_bound[0])
        point = Point(motion.x[0], tree.q[0], tree.gamma[0])
        return RneaSample(one.W[0], one.f[0], one.carrier_force[0], point, float(tree.gap[0]), margin)

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
        """Return the efforts of one sample with a status; see ``Dynamics.torque``."""
        given = x, xd, xdd, s, sd, sdd
        if start is not None:
            there = replace(self._robot, q_reference=checked(start, "start", self._robot.q_reference.shape))
            return self.for_robot(there).torque(*given, t=t)
        thread = threading.get_ident()
        try:
            sample = self.sample(*given, start=self._last.get(thread), t=t)
        except (InputError, *REFUSALS):
            if not is_finite(given):
                return without_answer(self._robot, SampleStatus.NOT_FINITE)
            try:
                sample = self.sample(*given, t=t)  # from the reference
            except REFUSALS as error:
                return without_answer(self._robot, status_of(error))
        self._last[thread] = sample
        return solve_sample(self._robot, sample, sample.point.q, given, t)

    def _direct_sample(self, given: tuple[ArrayLike, ...], start: RneaSample | None, t: float) -> RneaSample | None:
        """Return a sample that needs neither a second look at its kinematics nor a word about its input."""
        robot, follower = self._robot, tracker(self._robot, many=True)
        try:
            x, xd, xdd, *carriers = (np.array(part, dtype=float) for part in given)
        except (TypeError, ValueError):
            return None
        s, sd, sdd = (self._parked if part.shape == (0,) else part for part in carriers)
        shapes = [part.shape for part in (xd, xdd, s, sd, sdd)]
        if x.shape != follower.home.x.shape or shapes != [(robot.n,)] * 2 + [(robot.k,)] * 3:
            return None
        finite = bool(np.isfinite(np.concatenate((xd, xdd, s, sd, sdd))).all())
        home = follower.home if start is None else start.point
        reached = follower.towards(home, read_only(x)) if finite and home.x.shape == x.shape else None
        if reached is None:
            return None
        v, a = follower.rates(reached, xd, xdd)
        gamma, q = reached.point.gamma, reached.point.q.copy()
        q[robot.carrier_position], v[robot.carrier_velocity], a[robot.carrier_velocity] = s, sd, sdd
        effort = pin.rnea(robot.model, follower.chain.data, q, v, a)
        loads = tree_loads(robot)
        if loads is not None:
            wrenches = wrench_values(robot.loads, np.array([t]), x[None], xd[None])
            effort = effort + loads.efforts(TreeState(q[None], v[None], a[None], wrenches))[:, 0]
        parts = gamma.take(robot.actuated_velocity, 0).T, gamma.T.dot(effort), effort.take(robot.carrier_velocity)
        W, f, force = (read_only(part) for part in parts)
        return RneaSample(W, f, force, reached.point, reached.gap, reached.margin)


class RneaAlongMotion(Frozen):
    """RNEA dynamics along a lifted platform motion.

    Args:
        tree: the lifted motion.
        threads: threads of the batched RNEA.

    Attributes:
        robot, motion: the robot, and its platform motion.
    """

    def __init__(self, tree: JointTrajectory, threads: int = 1) -> None:
        self.tree, self.robot, self.motion = tree, tree.robot, tree.motion
        self.threads = max(1, min(threads, len(tree.motion) // _SAMPLES_PER_THREAD))
        self._rows = frozen(row_scale(tree.robot))
        self._columns = frozen(column_scale(tree.robot))

    def reduce(self, carriers: CarrierMotion | None = None) -> ReducedDynamics:
        """Return f, W and carrier forces; carriers parked at s = 0 when left out."""
        carriers = require_matching_carriers(self.robot, carriers, len(self.motion))
        f, force = np.empty(self.motion.xd.shape), np.empty(carriers.s.shape)
        for part in blocks(len(f), SAMPLES_PER_BLOCK):
            effort = self.tree_effort(carriers, part)
            gammas = self._gamma if len(f) <= SAMPLES_PER_BLOCK else self.tree.gamma[part].transpose(2, 1, 0).copy()
            for i, gamma in enumerate(gammas):
                f[part, i] = np.einsum("vn,vn->n", gamma, effort)
            force[part] = effort[self.robot.carrier_velocity].T
        moving = self.motion.xd, self.motion.xdd, carriers.sd, carriers.sdd
        return ReducedDynamics(
            t=self.motion.t,
            f=read_only(f),
            W=self.tree.W,
            carrier_force=read_only(force),
            reachable=self.tree.reachable,
            gap=self.tree.gap,
            row_scale=self._rows,
            column_scale=self._columns,
            out_of_range=self.tree.out_of_range,
            force_size=sample_scales(self.robot, *moving, self._wrenches).force,
        )

    def tree_motion(
        self, carriers: CarrierMotion | None = None, part: slice = slice(None)
    ) -> tuple[Array, Array, Array]:
        """Return q (nq, N), v (nv, N), a (nv, N) of the tree, carriers included, samples in columns."""
        robot, carriers = self.robot, require_matching_carriers(self.robot, carriers, len(self.motion))
        q, v, a = (np.array(whole[part].T, order="F") for whole in (self.tree.q, self.tree.v, self.tree.a))
        q[robot.carrier_position] = carriers.s[part].T
        v[robot.carrier_velocity] = carriers.sd[part].T
        a[robot.carrier_velocity] = carriers.sdd[part].T
        return q, v, a

    def tree_effort(self, carriers: CarrierMotion | None = None, part: slice = slice(None)) -> Array:
        """Return (nv, N) generalised forces of the open tree, rnea(q, v, a)."""
        q, v, a = self.tree_motion(carriers, part)
        # for a single column the binding returns a vector
        effort: Array = np.reshape(pin.rneaInParallel(self.threads, self._pool, q, v, a), v.shape)
        loads = tree_loads(self.robot)
        return effort if loads is None else effort + loads.efforts(self._state(q, v, a, part))

    def _state(self, q: Array, v: Array, a: Array, part: slice = slice(None)) -> TreeState:
        return TreeState(q.T, v.T, a.T, tuple(value[part] for value in self._wrenches))

    @cached_property
    def _wrenches(self) -> tuple[Array, ...]:
        return wrench_values(self.robot.loads, self.motion.t, self.motion.x, self.motion.xd)

    def carrier_derivatives(self, carriers: CarrierMotion | None = None) -> CarrierDerivatives:
        """Return the exact derivatives of f and carrier forces by s, ṡ, s̈ (Pinocchio's RNEA derivatives, projected)."""
        robot, model = self.robot, self.robot.model
        data = model.createData()
        q, v, a = self.tree_motion(carriers)
        columns = robot.carrier_velocity
        samples = len(self.motion)
        by_q, by_v, by_a, mirrored = (np.empty((samples, model.nv, robot.k)) for _ in range(4))
        for i in range(samples):
            dq, dv, da = pin.computeRNEADerivatives(model, data, q[:, i], v[:, i], a[:, i])
            by_q[i], by_v[i], by_a[i], mirrored[i] = dq[:, columns], dv[:, columns], da[:, columns], da[columns].T
        # Pinocchio fills the upper triangle of the mass matrix only
        rows = np.arange(model.nv)
        by_a = np.where(rows[:, None] > rows[columns], mirrored, by_a)
        loads = tree_loads(robot)
        if loads is not None:
            more = loads.carrier_derivatives(self._state(q, v, a))
            by_q, by_v, by_a = (part + added for part, added in zip((by_q, by_v, by_a), more, strict=True))
        gamma = self.tree.gamma
        projected = [np.einsum("nvi,nvk->nik", gamma, part) for part in (by_q, by_v, by_a)]
        own = [part[:, columns] for part in (by_q, by_v, by_a)]
        return CarrierDerivatives(*(read_only(part) for part in (*projected, *own)))

    def base_wrench(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N, 6) force and moment of the robot on its base, about the world origin, world axes, N and N·m.

        The root of the tree is given six freedoms and no motion: the generalised force there is what holds the base.
        Closure and actuator forces are internal and do not show.
        """
        q, v, a = self.tree_motion(carriers)
        samples = q.shape[1]
        root = np.zeros((7, samples))
        root[6] = 1.0  # w of the quaternion: no rotation, so the root's axes are the world's
        still = np.zeros((6, samples))
        whole = (np.asfortranarray(np.concatenate(pair)) for pair in ((root, q), (still, v), (still, a)))
        effort = np.reshape(pin.rneaInParallel(self.threads, self._floating_pool, *whole), (-1, samples))
        # the effort at the root is what the ground exerts on the robot; the wrench on the base is its reaction
        wrench: Array = np.ascontiguousarray(-effort[:6].T)
        loads = tree_loads(self.robot)
        if loads is not None:
            wrench += loads.resultant(self._state(q, v, a))
        return read_only(wrench)

    def energy(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N,) kinetic plus potential energy, J (zero height at the world origin)."""
        model = self.robot.model
        data = model.createData()
        q, v, a = self.tree_motion(carriers)
        total = [tree_energy(model, data, q[:, i], v[:, i]) for i in range(q.shape[1])]
        loads = tree_loads(self.robot)
        return frozen(total if loads is None else total + loads.energy(self._state(q, v, a)))

    def closure_margin(self) -> Array:
        """Return (N,) smallest over largest singular value of the scaled closures, with the sign of det K.

        Zero where the closures lose rank; NaN where the motion is not reachable.
        """
        robot, system = self.robot, constraint_system(self.robot)
        columns, margin = system.pose_columns, np.full(len(self.motion), np.nan)
        if not len(system.rows):
            return read_only(np.ones(len(margin)))
        for part in blocks(len(margin)):
            good = np.arange(len(margin))[part][self.tree.reachable[part]]
            state = system.evaluate(self.tree.q[good])
            rows = state.Jc[:, :, columns] * system.closure_scale[:, None] / velocity_scale(robot)[columns]
            values = np.linalg.svd(rows, compute_uv=False)
            margin[good] = np.linalg.slogdet(state.K)[0] * values[:, -1] / values[:, 0]
        return read_only(margin)

    @cached_property
    def _gamma(self) -> Array:
        """Γ as (n, nv, N): the projection then runs over contiguous samples."""
        return self.tree.gamma.transpose(2, 1, 0).copy()

    @cached_property
    def _pool(self) -> pin.ModelPool:
        return pin.ModelPool(self.robot.model, self.threads)

    @cached_property
    def _floating_pool(self) -> pin.ModelPool:
        model = self.robot.model
        free = pin.Model()
        free.gravity = model.gravity
        # links fixed to the base stand on the ground: their weight is not the mechanism's, and this body has none
        root = free.addJoint(0, pin.JointModelFreeFlyer(), pin.SE3.Identity(), "redundancy_pin::base")
        for index in range(1, model.njoints):  # pin.appendModel refuses a joint with the name of a link
            parent = model.parents[index] + root
            free.addJoint(parent, model.joints[index], model.jointPlacements[index], model.names[index])
            free.inertias[index + root] = model.inertias[index]
        return pin.ModelPool(free, self.threads)


# --- reactions --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class JointReactions(Frozen):
    """What the joints transmit along a motion.

    Attributes:
        joints: names of the tree's joints, J of them.
        joint_wrench: (N, J, 6) force and moment that the parent body exerts on the child through each joint, world
            axes, at the joint's origin, N and N·m; actuator efforts included.
        closures: name of each closure row, ``"x of tip_2 = corner_2"``, then of each coupling, r of them.
        closure_force: (N, r) force (or moment) along each closure row: what frame a exerts on frame b, in the axes of
            frame a, N or N·m; of a coupling q = p(q_of) the effort that it exerts in its joint, −p' times that in the
            other. Redundant rows, which the loader leaves out, are among them: motion does not tell how they share a
            load, and these are the forces of least norm, moments divided by the characteristic length.
        residual: (N,) largest generalised force left unbalanced by the given efforts, N or N·m. Rounding when the
            efforts produce the motion; large when they do not, and then the reactions mean nothing.
    """

    joints: tuple[str, ...]
    joint_wrench: Array
    closures: tuple[str, ...]
    closure_force: Array
    residual: Array


def joint_reactions(along: RneaAlongMotion, tau: ArrayLike, carriers: CarrierMotion | None = None) -> JointReactions:
    """Compute the reactions in every joint and closure.

    The closure forces λ follow from the equations of motion of the tree, J_cᵀ λ = rnea(q, v, a) − Sᵀ τ − C F, which
    have full column rank away from type I singularities; a second pass of RNEA with λ as external forces gives the
    joint wrenches. Where the closures lose rank (a flat four-bar) the linkage can be prestressed: both are
    undetermined, and NaN.

    Args:
        along: RNEA dynamics along a platform motion.
        tau: (N, m) main efforts, N or N·m; rows of NaN (no finite effort exists) give rows of NaN.
        carriers: carrier motion, parked when left out.

    Raises:
        InputError: ``tau`` has the wrong shape.
    """
    require_type(along, RneaAlongMotion, "RNEA dynamics along a motion", "Pass RneaDynamics(robot).along(motion).")
    robot, tree = along.robot, along.tree
    try:
        effort = np.asarray(tau, dtype=float)
    except (TypeError, ValueError):  # a Distribution, say: what is wrong with it is said by
        effort = checked(tau, "tau", (len(along.motion), robot.m))
    holes = np.isnan(effort).any(axis=-1, keepdims=True) if effort.ndim == 2 else np.zeros(1, dtype=bool)
    checked(np.where(holes, 0.0, effort), "tau", (len(along.motion), robot.m))
    usable = ~holes[:, 0] & tree.reachable
    whole = with_all_rows(robot)
    state = constraint_system(whole).evaluate(tree.q)
    rest = along.tree_effort(carriers).T.copy()
    rest[:, robot.actuated_velocity] -= effort
    rest[~usable] = 0.0
    stacked, left, determined = closure_multipliers(robot, state, rest[:, :, None], usable)
    multipliers = stacked[:, :, 0]
    forces = _closure_wrenches(whole, state, multipliers)
    loads, (q, v, a) = tree_loads(robot), along.tree_motion(carriers)
    for joint, load in ({} if loads is None else loads.bodies(along._state(q, v, a))).items():
        forces[joint] = forces.get(joint, 0.0) + load
    wrench = _second_pass(along, carriers, forces)
    left[~usable] = np.nan
    for array in (multipliers, wrench):
        array[~(usable & determined)] = np.nan
    return JointReactions(
        joints=joint_names(robot.model),
        joint_wrench=read_only(wrench),
        closures=whole.constraint_names,
        closure_force=read_only(multipliers),
        residual=read_only(np.abs(left).max(axis=(1, 2), initial=0.0)),
    )


def closure_multipliers(
    robot: Robot, state: ConstraintState, efforts: Array, usable: BoolArray
) -> tuple[Array, Array, BoolArray]:
    """Return (N, r, c) λ with J_cᵀ λ = efforts, (N, nv, c), what they leave, and (N,) where the closures determine λ.

    The ``state`` has redundant rows too, if there are any: of least norm are then the forces, and moments divided by
    the characteristic length. Samples that are not ``usable`` (N,) have zeros.
    """
    system, rank = constraint_system(with_all_rows(robot)), len(constraint_system(robot).rows)
    columns = system.pose_columns
    transposed = np.where(usable[:, None, None], state.Jc[:, :, columns], 0.0).transpose(0, 2, 1)
    scaled = transposed * (system.closure_scale / velocity_scale(robot)[columns, None])
    if rank < len(system.rows):
        left, values, right = np.linalg.svd(transposed * system.closure_scale, full_matrices=False)
        inverse = np.where(values[:, :rank] > 0.0, 1.0 / np.maximum(values[:, :rank], 1e-300), 0.0)
        right, left = right[:, :rank].transpose(0, 2, 1), left[:, :, :rank].transpose(0, 2, 1)
        multipliers = system.closure_scale[:, None] * (right @ (inverse[:, :, None] * (left @ efforts[:, columns])))
    else:
        multipliers = np.linalg.pinv(transposed) @ efforts[:, columns]
    if not rank:  # an open chain, or one whose closures are redundant in every row
        return multipliers, efforts[:, columns] - transposed @ multipliers, np.ones(len(usable), dtype=bool)
    determined = np.linalg.svd(scaled, compute_uv=False)[:, rank - 1] > SINGULAR_MARGIN
    return multipliers, efforts[:, columns] - transposed @ multipliers, determined


def _closure_wrenches(robot: Robot, state: ConstraintState, multipliers: Array) -> dict[int, Array]:
    """Return by joint index the closure forces on its body: (6, N) about the world origin, world axes."""
    model = robot.model
    total: dict[int, Array] = {}
    of_rows = (closure for closure in robot.closures for _ in closure.axes)
    for index, closure in enumerate(of_rows):
        # at an open frame pair the force acts where frame b is, on both bodies
        wrench = state.rows.wrench[:, index] * multipliers[:, index]
        for frame, sign in ((closure.frame_b, 1.0), (closure.frame_a, -1.0)):
            joint = int(find_link(model, frame).parentJoint)
            total[joint] = total.get(joint, 0.0) + sign * wrench
    return total


def _second_pass(along: RneaAlongMotion, carriers: CarrierMotion | None, forces: dict[int, Array]) -> Array:
    model = along.robot.model
    data = model.createData()
    q, v, a = along.tree_motion(carriers)
    external = pin.StdVec_Force()
    for _ in range(model.njoints):
        external.append(pin.Force.Zero())
    result = np.empty((q.shape[1], model.njoints - 1, 6))
    for i in range(q.shape[1]):
        # places first: RNEA takes external forces in the frames of the joints, and these are in world axes
        pin.forwardKinematics(model, data, q[:, i])
        for joint, wrench in forces.items():
            if joint > 0:
                external[joint] = data.oMi[joint].actInv(pin.Force(wrench[:, i]))
        pin.rnea(model, data, q[:, i], v[:, i], a[:, i], external)
        for joint in range(1, model.njoints):
            rotation = data.oMi[joint].rotation
            result[i, joint - 1, :3] = rotation @ data.f[joint].linear
            result[i, joint - 1, 3:] = rotation @ data.f[joint].angular
    return result
