"""Dynamics of any declared robot: recursive Newton–Euler on the open tree, projected on the closed chains.

At each state the closed configuration q comes from ``inverse_kinematics``, with v = Γ ẋ + C ṡ and J_c Γ = 0. The
constraint forces do no work in these velocities, so they drop out of the equation of motion of the tree:

    W τ = f,   W = Γᵀ Sᵀ,   f = Γᵀ rnea(q, v, a),   carrier force = Cᵀ rnea(q, v, a).

S selects the actuated joints and C the carriers. Γ depends on the platform motion alone, so it is computed once per
motion and serves any number of carrier motions. RNEA is Featherstone's algorithm (RBDA 2008, table 5.1) as Pinocchio
has it; loads of the robot enter as its external forces and as terms of the joints (``tree_loads``).
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, partial

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, Frozen, blocks, frozen, numbers, read_only
from redundancy_pin.dynamics.arguments import (
    OnUnreachable,
    SampleArguments,
    SampleArrays,
    one_sample,
    require_choice,
    require_matching_carriers,
    sample_arrays,
)
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.one_sample import REFUSALS, is_finite, refusal_of, solve_sample, without_answer
from redundancy_pin.dynamics.results import CarrierDerivatives, ReducedDynamics, TorqueSample
from redundancy_pin.dynamics.tree_loads import TreeState, tree_effort, tree_energy, tree_loads
from redundancy_pin.errors import InputError, WorkingModeError
from redundancy_pin.kinematics.branch import BranchEnd, ClosedState, Rates, follower
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.coordinates import in_working_mode
from redundancy_pin.kinematics.inverse_kinematics import JointTrajectory, inverse_kinematics
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_poses
from redundancy_pin.robot import Robot
from redundancy_pin.robot.loads import wrench_values
from redundancy_pin.robot.scales import column_scale, force_sizes, row_scale
from redundancy_pin.robot.whole_turns import TURN, counted_turns
from redundancy_pin.status import SampleStatus


@dataclass(frozen=True, eq=False)
class RneaSample(Frozen):
    """One sample of the equation of motion, and where the next one may start from.

    Attributes:
        W: (n, m) actuation matrix.
        f: (n,) generalised force, N and N·m, in the base frame.
        carrier_force: (k,) force of each carrier's own actuator, N.
        state: the closed state of the sample, carriers at zero.
        residual: closure residual, m.
        serial_margin_bound: lower bound of the distance to a type I singularity, scaled.
    """

    W: Array
    f: Array
    carrier_force: Array
    state: ClosedState
    residual: float
    serial_margin_bound: float

    def __iter__(self) -> Iterator[Array]:
        """Yield W, f and carrier forces, as the samples of other backends do."""
        return iter((self.W, self.f, self.carrier_force))


class RneaDynamics(Dynamics):
    """Closed-chain dynamics through Pinocchio's RNEA and constraint Jacobians, for any declared robot.

    ``reduce`` is inherited: it is ``along(motion).reduce(carriers)`` after a check of the tracks (``Dynamics.reduce``).

    Args:
        robot: the robot, or its name or path.
        progress: called with samples done and samples in all while the kinematics of a motion are solved.

    Example:
        >>> import redundancy_pin as rp
        >>> dynamics = rp.RneaDynamics("3rrr")
        >>> reduced = dynamics.reduce(rp.trajectory.reference.corner(radius=0.025).sample(0.01))
        >>> reduced.W.shape
        (184, 3, 3)
    """

    def __init__(self, robot: RobotLike, *, progress: Callable[[int, int], None] | None = None) -> None:
        self._robot, self._progress = as_robot(robot), progress
        self._cache: dict[bytes, Rates] | None = None
        self._thread = threading.local()
        """Holds ``last``: the closed state of this thread where the next ``torque`` starts."""

    def __reduce__(self) -> tuple[Callable[[Robot], RneaDynamics], tuple[Robot]]:
        """Rebuild it when it is copied or sent; the state of a thread stays in its thread."""
        return partial(RneaDynamics, progress=self._progress), (self._robot,)

    @property
    def robot(self) -> Robot:
        """The robot."""
        return self._robot

    def along(self, motion: PlatformMotion, *, unreachable: OnUnreachable = "raise") -> RneaAlongMotion:
        """Solve the kinematics of a platform motion once; raises as ``inverse_kinematics``."""
        require_choice(unreachable)
        marked = unreachable == "mark"
        report, cache = self._progress, self._cache
        tree = inverse_kinematics(self._robot, motion, mark_unreachable=marked, progress=report, cache=cache)
        return RneaAlongMotion(tree)

    def with_cache(self) -> RneaDynamics:
        """Return this backend with a cache of the samples that it solves along one motion, some kilobytes each.

        Closing takes most of the time. The cache belongs to the returned backend, and is freed with it.
        """
        own = self.for_robot(self._robot)
        own._cache = {}
        return own

    def for_robot(self, robot: Robot) -> RneaDynamics:
        """Return this backend for a robot that differs in its loads."""
        return RneaDynamics(robot, progress=self._progress)

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
        """Return W, f and carrier forces at one sample; see ``redundancy_pin.dynamics.base.Dynamics.sample``.

        ``start`` is an earlier result, of a pose nearby. The branch is followed from there along a straight line, and
        not from the reference configuration; an error is raised where that line does not lead to x.

        Raises:
            InputError, UnreachablePoseError, SingularPoseError, WorkingModeError: as in ``along``.
        """
        if start is not None and not isinstance(start, RneaSample):
            raise InputError(
                f"start is a {type(start).__name__}, expected what an earlier sample of RneaDynamics returned.",
                remedy="Pass that, or leave it out.",
            )
        here, arguments = None if start is None else start.state, (x, xd, xdd, s, sd, sdd)
        given = sample_arrays(self._robot, arguments)
        if not is_finite(given, t):
            one_sample(self._robot, given, t)  # which raises
        sample = self._regular_sample(given, here, t)
        return sample if isinstance(sample, RneaSample) else self._any_sample(given, here, t)

    def _torque(self, arguments: SampleArguments, t: float, start: ArrayLike | None) -> TorqueSample:
        robot, given = self._robot, sample_arrays(self._robot, arguments)
        here: ClosedState | None = getattr(self._thread, "last", None)
        q = None if start is None else numbers(start, "start", robot.q_reference.shape)
        if not is_finite(given if q is None else (*given, q), t):
            return without_answer(robot, SampleStatus.NOT_FINITE)
        if q is not None:
            here = follower(robot).state_at(q)
            if here is None or here.margin == 0.0:
                return without_answer(robot, SampleStatus.BRANCH_LOST)
        try:
            if here is not None:
                follower(robot).require_near(here, given[0])
        except WorkingModeError as error:
            return without_answer(robot, *refusal_of(error))
        sample = self._regular_sample(given, here, t)
        if isinstance(sample, BranchEnd):
            return without_answer(robot, sample.status, sample.residual)
        if sample is None:
            try:
                sample = self._any_sample(given, here, t)
            except REFUSALS as error:
                return without_answer(robot, *refusal_of(error))
        self._thread.last = sample.state
        kinematics = sample.residual, sample.serial_margin_bound
        return solve_sample(robot, sample, sample.state.q, kinematics, given, t)

    def _any_sample(self, given: SampleArrays, here: ClosedState | None, t: float) -> RneaSample:
        """Return one sample by the kinematics of whole motions, which pass rank losses and name errors."""
        motion, carriers = one_sample(self._robot, given, t)
        tree = inverse_kinematics(self._robot, motion, start=here)
        f, force = RneaAlongMotion(tree).forces(carriers)
        residual, margin = float(tree.residual[0]), float(tree.serial_margin_bound[0])
        return RneaSample(tree.W[0], f[0], force[0], tree.state(0), residual, margin)

    def _regular_sample(
        self, given: SampleArrays, start: ClosedState | None, t: float
    ) -> RneaSample | BranchEnd | None:
        """Return one sample from a state nearby, without a state from the reference, or why its branch ends.

        None where the pose lies near a rank loss or turns away, or not on the branch of the reference: see
        ``_any_sample``.
        """
        robot, own = self._robot, follower(self._robot)
        x, xd, xdd, s, sd, sdd = given
        home = own.home if start is None else start
        if x.ndim == 2:
            require_poses(x[None])
        turned = counted_turns(robot).coordinates
        if len(turned) and (np.abs(x[turned] - home.x[turned]) > TURN).any():
            return None
        reached = own.follow(home, read_only(x.copy()))
        if isinstance(reached, BranchEnd):
            return None if start is None else reached
        if reached.margin < own.near or (start is None and not in_working_mode(robot, reached.q[None])[0]):
            return None
        _, v, a = own.rates(reached, xd, xdd)
        q = reached.q
        if robot.k:
            q = q.copy()
            q[robot.carrier_position], v[robot.carrier_velocity], a[robot.carrier_velocity] = s, sd, sdd
        wrenches = wrench_values(robot.loads, np.array([t]), x[None], xd[None]) if robot.loads else ()
        effort = tree_effort(robot, own.chain.data, TreeState(q, v, a, [value[0] for value in wrenches]))
        f, force = read_only(reached.gamma.T @ effort), read_only(effort[robot.carrier_velocity])
        return RneaSample(read_only(reached.W), f, force, reached, reached.residual, reached.margin)


class RneaAlongMotion(Frozen):
    """RNEA dynamics along a platform motion whose kinematics are solved.

    Args:
        tree: the motion of the tree, carriers at zero.

    Attributes:
        robot, motion: the robot, and its platform motion.
        q, gamma: (N, nq) configurations, carriers at zero, and (N, nv, n) Γ.
    """

    def __init__(self, tree: JointTrajectory) -> None:
        self.tree, self.robot, self.motion = tree, tree.robot, tree.motion
        self.q, self.gamma = tree.q, tree.gamma

    def tree_motion(self, carriers: CarrierMotion | None = None) -> tuple[Array, Array, Array]:
        """Return q (N, nq), v (N, nv), a (N, nv) of the tree with the carriers in it, m, rad and s."""
        carriers = require_matching_carriers(self.robot, carriers, len(self.motion))
        tree = self.tree.with_carriers(carriers)
        return tree.q, tree.v, tree.a

    def tree_effort(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N, nv) generalised forces of the open tree, rnea(q, v, a) with loads, N and N·m."""
        efforts = np.empty(self.tree.v.shape)
        data = self.robot.model.createData()
        for i, state in enumerate(self.states(carriers)):
            efforts[i] = tree_effort(self.robot, data, state)
        return efforts

    def forces(self, carriers: CarrierMotion | None = None) -> tuple[Array, Array]:
        """Return f (N, n) and carrier forces (N, k): Γᵀ and Cᵀ times the effort of the tree, N and N·m."""
        effort = self.tree_effort(carriers)
        f = np.einsum("Nvi,Nv->Ni", self.tree.gamma, effort)
        return read_only(f), read_only(effort[:, self.robot.carrier_velocity])

    def reduce(self, carriers: CarrierMotion | None = None) -> ReducedDynamics:
        """Return f, W and carrier forces; carriers parked at s = 0 when left out."""
        carriers = require_matching_carriers(self.robot, carriers, len(self.motion))
        f, force = self.forces(carriers)
        moving = self.motion.xd, self.motion.xdd, carriers.sd, carriers.sdd
        return ReducedDynamics(
            t=self.motion.t,
            f=f,
            W=self.tree.W,
            carrier_force=force,
            reachable=self.tree.reachable,
            residual=self.tree.residual,
            row_scale=frozen(row_scale(self.robot)),
            column_scale=frozen(column_scale(self.robot)),
            out_of_range=self.tree.out_of_range,
            force_size=force_sizes(self.robot, *moving, self._wrenches),
        )

    def carrier_derivatives(self, carriers: CarrierMotion | None = None) -> CarrierDerivatives:
        """Return the exact derivatives of f and carrier forces by s, ṡ, s̈.

        They are projections of Pinocchio's RNEA derivatives (Carpentier and Mansard 2018), for Γ does not depend on
        the carriers.
        """
        robot, model, loads = self.robot, self.robot.model, tree_loads(self.robot)
        data, columns = model.createData(), robot.carrier_velocity
        by_q, by_v, by_a = derivatives = np.empty((3, len(self.motion), model.nv, robot.k))
        for i, state in enumerate(self.states(carriers)):
            forces = [] if loads is None else [loads.body_forces(data, state)]
            dq, dv, mass = pin.computeRNEADerivatives(model, data, state.q, state.v, state.a, *forces)
            # Pinocchio fills the upper triangle of the mass matrix only
            mass = np.triu(mass) + np.triu(mass, 1).T
            by_q[i], by_v[i], by_a[i] = dq[:, columns], dv[:, columns], mass[:, columns]
            if loads is not None:
                derivatives[:, i] += loads.carrier_derivatives(data, state, columns)
        of_f = [read_only(np.einsum("Nvi,Nvk->Nik", self.tree.gamma, part)) for part in derivatives]
        of_force = [read_only(part[:, columns]) for part in derivatives]
        return CarrierDerivatives(*of_f, *of_force)

    def base_wrench(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N, 6) force and moment of the robot on its base, about the world origin, world axes, N and N·m.

        It is the reaction to the forces through the joints at the root of the tree. Closure and actuator forces are
        internal and do not show; springs and rotors that act on the base do.
        """
        model, loads = self.robot.model, tree_loads(self.robot)
        data, wrench = model.createData(), np.empty((len(self.motion), 6))
        roots = [joint for joint in range(1, model.njoints) if model.parents[joint] == 0]
        for i, state in enumerate(self.states(carriers)):
            forces = [] if loads is None else [loads.body_forces(data, state)]
            pin.rnea(model, data, state.q, state.v, state.a, *forces)
            on_base = forces[0][0] if forces else pin.Force.Zero()
            for joint in roots:
                # data.f is what the parent exerts on the child, in the frame of the joint
                on_base -= data.liMi[joint].act(data.f[joint])
            wrench[i] = on_base.vector
        return read_only(wrench)

    def energy(self, carriers: CarrierMotion | None = None) -> Array:
        """Return (N,) kinetic plus potential energy, J (zero height at the world origin)."""
        data = self.robot.model.createData()
        return frozen([tree_energy(self.robot, data, state.q, state.v) for state in self.states(carriers)])

    def closure_margin(self) -> Array:
        """Return (N,) smallest over largest singular value of the scaled closures, with the sign of det K.

        K stacks the independent closure rows and the platform rows, columns of the pose's velocities. Zero where these
        lose rank, though dependent rows may keep it; NaN where the motion is not reachable.
        """
        chain, margin = ClosedChain(self.robot), np.full(len(self.motion), np.nan)
        if not chain.rows:
            return read_only(np.ones(len(margin)))
        known = np.flatnonzero(self.tree.reachable)
        for part in blocks(len(known)):
            K = np.empty((part.stop - part.start, len(chain.pose_columns), len(chain.pose_columns)))
            for own, q in zip(K, self.tree.q[known[part]], strict=True):
                chain.place(q)
                own[:] = chain.matrix()
            values = np.linalg.svd(K[:, : chain.rows], compute_uv=False)
            margin[known[part]] = np.linalg.slogdet(K)[0] * values[:, -1] / values[:, 0]
        return read_only(margin)

    def states(self, carriers: CarrierMotion | None = None) -> Iterator[TreeState]:
        """Yield the state of the tree sample by sample, carriers included."""
        wrenches = self._wrenches
        for i, state in enumerate(zip(*self.tree_motion(carriers), strict=True)):
            yield TreeState(*state, [value[i] for value in wrenches])

    @cached_property
    def _wrenches(self) -> tuple[Array, ...]:
        return wrench_values(self.robot.loads, self.motion.t, self.motion.x, self.motion.xd)
