"""Computed torque with internal redundancy: where W loses rank, the carriers hold the platform."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import lapack

from redundancy_pin.arrays import RANK_TOLERANCE, Array, positive, read_only
from redundancy_pin.dynamics.allocation import Allocation, CarrierForces, allocate
from redundancy_pin.dynamics.default import DynamicsLike
from redundancy_pin.dynamics.forward import Equations, ForwardKernel
from redundancy_pin.dynamics.tree_loads import tree_equations
from redundancy_pin.errors import SingularPoseError
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.reference import MotionReference, ReferencePoint
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale
from redundancy_pin.simulation.controllers.base import (
    CarrierDrive,
    Command,
    Sampling,
    Tracking,
    kernel_of,
    largest_loads,
    load_limits,
    middles,
    positive_each,
)
from redundancy_pin.simulation.derivatives import state_error
from redundancy_pin.simulation.state import Manifold, State
from redundancy_pin.status import SampleStatus
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory


@dataclass(frozen=True, eq=False)
class ReducedEquations:
    """M (ẍ, s̈) + h = (W τ, F) at one state; d = n + k.

    Attributes:
        mass: (d, d) M, kg, kg·m, kg·m².
        bias: (d,) h: velocity terms and gravity, N or N·m.
        W: (n, m) generalised force on the platform per unit of main effort.
    """

    mass: Array
    bias: Array
    W: Array


class ReducedModel:
    """Evaluator of ``ReducedEquations`` for one robot. It holds a workspace: one for each thread or process.

    Args:
        robot: the robot.
        kernel: machine code for its equations.
    """

    def __init__(self, robot: Robot, kernel: ForwardKernel | None = None) -> None:
        self.robot, self._kernel = robot, kernel
        self.chain = ClosedChain(robot)
        nv = robot.model.nv
        self._columns = np.array(self.chain.pose_columns)
        self._identity = np.eye(len(self._columns))
        self._basis = np.zeros((nv, robot.n + robot.k))
        self._basis[robot.carrier_velocity, robot.n + np.arange(robot.k)] = 1.0
        self._particular = np.zeros(nv)

    def at(self, q: Array, v: Array) -> ReducedEquations:
        """Return the equations at a closed state q (nq,), v (nv,).

        Raises:
            SingularPoseError: a type I pose, where platform and carriers are no coordinates.
        """
        robot, n, rows = self.robot, self.robot.n, self.chain.rows
        system, rates, mass, at_rest = self._equations(q, v) if self._kernel is None else self._kernel.equations(q, v)
        _, _, inverse, singular = lapack.dgesv(system, self._identity)
        if singular or np.abs(system).max() * np.abs(inverse).max() * RANK_TOLERANCE > 1.0:
            raise SingularPoseError(
                f"{robot.name} is at a type I pose: platform and carriers do not describe its motion there.",
                remedy="Control it along a motion that keeps away from this pose.",
            )
        self._basis[self._columns, :n] = inverse[:, rows:]
        self._particular[self._columns] = -inverse.dot(rates)
        effort = at_rest + mass.dot(self._particular)
        basis = self._basis
        return ReducedEquations(
            basis.T.dot(mass.dot(basis)), basis.T.dot(effort), basis[robot.actuated_velocity, :n].T.copy()
        )

    def _equations(self, q: Array, v: Array) -> Equations:
        chain = self.chain
        chain.update(q, v)
        system, rates = chain.full_jacobian()[:, self._columns], chain.full_bias()
        effort, mass = tree_equations(self.robot, chain.data, q, v, np.zeros(len(v)))
        return Equations(system, rates, np.triu(mass) + np.triu(mass, 1).T, effort)


CARRIER_SHARE = 0.1
"""Default â: this share of the largest planned |s̈|, per planned effort. The smaller, the later carriers take over."""

POSITION = 1e-3
"""Deviation of the platform, m, whose correction is the least default τ̂: rotations count times the characteristic
length. That of ``bryson_weights``."""

LEAST_SHARE = 1e-3
"""Scales of actuators that the plan does not use: this share of the largest, so that no weight is infinite."""

HISTORY = 20_000
"""How many commands ``ComputedTorque.history`` keeps, about 20 MB: a digital one at 1 kHz has 20 s in it."""


@dataclass(frozen=True, eq=False)
class TorqueCommand:
    """What a computed torque commands at one state.

    Attributes:
        t: time, s.
        tau: (m,) main efforts, N or N·m.
        carrier_force: (k,) carrier forces, N.
        allocation: distribution of the force; if it is not ``balanced`` the efforts are the planned ones.
    """

    t: float
    tau: Array
    carrier_force: Array
    allocation: Allocation


class ComputedTorque(Tracking):
    """Inverse dynamics of the actual state with desired accelerations.

        ẍ = ẍ_d − 2 ζ ω ė − ω² e,   s̈ = s̈_d − 2 ζ ω_s ė_s − ω_s² e_s + δ,

    efforts and δ from ``allocate``. Away from a type II pose δ is small and platform and carriers obey two decoupled
    linear equations. Towards one the carriers take over: the platform keeps its equation, the carriers leave theirs by
    δ and come back afterwards. It gives up, by feeding the plan's efforts forward, at a type I pose and where main
    actuators and carriers together have no effect in some direction that the force needs (the allocation is not
    ``balanced``).

    Its feedback holds the carriers too, by their forces: ``simulate(carriers="motion")`` refuses it.

    Args:
        plan: a plan, or a reference of a robot; its robot is the model that the controller knows.
        motion: the trajectory that was planned for, for exact values between the samples of a plan.
        bandwidth: ω of the platform, rad/s.
        carrier_bandwidth: ω_s of the carriers, rad/s.
        damping: ζ of both.
        effort_scale: scalar or (m,) τ̂, main effort beyond the plan's that counts as much as â; when left out, the
            largest planned efforts, or the efforts that correct a millimetre (``correcting_efforts``) if larger:
            a plan with almost no main efforts gives no measure of the friction to overcome.
        carrier_scale: scalar or (k,) â, carrier acceleration beyond the wanted one, m/s²; a tenth of the largest
            planned |s̈| when left out.
        effort_limit: scalar or (m,) largest |τ|, N or N·m; the excess is left to the carriers.
        carrier_force_limit: scalar or (k,) largest |F|, N; the excess is left to the main actuators.
        dynamics: the plan's robot, or its name or path, for generated code (``as_dynamics``), which then forms the
            equations; or a backend of it.
        sampling: of the simulation, if it has one: the state is advanced to the middle of the interval in which the
            answer will act.

    Attributes:
        history: the latest ``HISTORY`` commands, a ``TorqueCommand`` for every call of ``effort``, trial steps
            of an integrator included; older ones are dropped. No answer depends on it.

    Raises:
        InputError: a gain, scale or limit out of its domain.
        InfeasiblePlanError, PlanFileError: see ``plan_reference``.

    Example:
        >>> from redundancy_pin.simulation import controllers
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner())
        >>> control = controllers.ComputedTorque(plan)
        >>> rp.simulate("3rrr", control, duration=0.1, rtol=1e-6, atol=1e-8).status.value
        'ok'
    """

    carrier_drive: CarrierDrive = "force"
    """A motion that is prescribed would leave nothing of the feedback on the carriers."""

    def __init__(
        self,
        plan: Plan | MotionReference,
        *,
        motion: TimedTrajectory | None = None,
        bandwidth: float = 30.0,
        carrier_bandwidth: float = 10.0,
        damping: float = 1.0,
        effort_scale: ArrayLike | None = None,
        carrier_scale: ArrayLike | None = None,
        effort_limit: ArrayLike | None = None,
        carrier_force_limit: ArrayLike | None = None,
        sampling: Sampling | None = None,
        dynamics: DynamicsLike | None = None,
    ) -> None:
        super().__init__(plan, motion, sampling)
        for name, value in (("bandwidth", bandwidth), ("carrier_bandwidth", carrier_bandwidth), ("damping", damping)):
            positive(value, name, "")
        robot = self.robot
        self.bandwidth, self.carrier_bandwidth, self.damping = bandwidth, carrier_bandwidth, damping
        frequency = np.concatenate([np.full(robot.n, bandwidth), np.full(robot.k, carrier_bandwidth)])
        self._stiffness, self._damping = frequency**2, 2.0 * damping * frequency
        largest_tau, _ = largest_loads(self.reference)
        largest_sdd = np.abs([self.reference.carriers(t)[2] for t in middles(self.reference)]).max(axis=0)
        self.carrier_scale = positive_each(carrier_scale, CARRIER_SHARE * largest_sdd, LEAST_SHARE, "carrier_scale")
        self.effort_limit, self.carrier_force_limit = load_limits(robot, effort_limit, carrier_force_limit)
        self.history: deque[TorqueCommand] = deque(maxlen=HISTORY)
        self._kernel = kernel_of(robot, dynamics)
        self._model = ReducedModel(robot, self._kernel)
        self._manifold = Manifold(self._model.chain)
        self._rows = row_scale(robot)
        if effort_scale is None:
            largest_tau = np.maximum(largest_tau, correcting_efforts(self.reference, bandwidth**2 * POSITION))
        self.effort_scale = positive_each(effort_scale, largest_tau, LEAST_SHARE, "effort_scale")

    def effort(self, t: float, state: State) -> Command:
        """Return main efforts (m,) and carrier forces (k,) at time t; ``history`` keeps how they came about."""
        command = self.command(t, state)
        self.history.append(command)
        return command.tau, command.carrier_force

    def command(self, t: float, state: State) -> TorqueCommand:
        """Return the efforts at a state and how the force is shared out; a function of its arguments.

        Args:
            t: time, s.
            state: estimated state of the machine.
        """
        robot, reference = self.robot, self.reference
        at = t + self.lead
        here = self._advanced(t, state) if self.lead else state
        point = reference.at(at)
        error = state_error(robot, here, point.x, point.xd, point.s, point.sd)
        d, n = robot.n + robot.k, robot.n
        wanted = np.concatenate([point.xdd, point.sdd]) - self._stiffness * error[:d] - self._damping * error[d:]
        wanted[:n] -= self._learnt()
        try:
            equations = self._model.at(here.q, here.v)
        except SingularPoseError:
            nothing = Allocation(point.tau, np.zeros(robot.k), float("nan"), 0.0, SampleStatus.TYPE_I)
            return self._as_planned(t, point, nothing)
        needed = equations.mass @ wanted + equations.bias
        carriers = CarrierForces(needed[n:], equations.mass[n:, n:], self.carrier_force_limit)
        allocation = allocate(
            equations.W,
            equations.mass[:n, n:],
            needed[:n],
            point.tau,
            effort_scale=self.effort_scale,
            carrier_scale=self.carrier_scale,
            row_scale=self._rows,
            effort_limit=self.effort_limit,
            carriers=carriers,
        )
        if not allocation.balanced:
            return self._as_planned(t, point, allocation)
        return TorqueCommand(t, read_only(allocation.tau), read_only(carriers.of(allocation.deviation)), allocation)

    def _learnt(self) -> Array:
        """Return the acceleration (n,) of the platform, m/s², that the motion so far has shown to be lacking: none."""
        return np.zeros(self.robot.n)

    def _as_planned(self, t: float, point: ReferencePoint, allocation: Allocation) -> TorqueCommand:
        """Return the plan's efforts, within the limits."""
        tau = np.clip(point.tau, -self.effort_limit, self.effort_limit)
        force = np.clip(point.carrier_force, -self.carrier_force_limit, self.carrier_force_limit)
        return TorqueCommand(t, read_only(tau), read_only(force), allocation)

    def _advanced(self, t: float, state: State) -> State:
        """Return where the state will be when the answer acts, by its velocity and the planned acceleration."""
        lead = self.lead
        _, _, a = self.reference.tree(t)
        model = self.robot.model
        q = pin.integrate(model, np.array(state.q), lead * state.v + 0.5 * lead * lead * a)
        v = state.v + lead * a
        tolerance = self._manifold.tolerance
        projected = None if self._kernel is None else self._kernel.project(np.concatenate([q, v]), tolerance)
        q, v = self._manifold.project(q, v)[:2] if projected is None else np.split(projected[0], [len(q)])
        return State(self._model.chain, t + lead, q, v, self._kernel)


def correcting_efforts(reference: MotionReference, acceleration: float) -> Array:
    """Return the main efforts (m,) that accelerate the platform along their own directions.

    With W_i the column of actuator i and u = W_i / |W_i|, in coordinates scaled to lengths: a uᵀ M_xx u / |W_i|, N or
    N·m, which is finite at type II poses; the median over the motion, zero for an actuator without effect anywhere.
    """
    model, rows = ReducedModel(reference.robot), row_scale(reference.robot)
    n, needed = reference.robot.n, []
    for t in middles(reference):
        q, v, _ = reference.tree(t)
        try:
            equations = model.at(q, v)
        except SingularPoseError:
            continue
        columns = equations.W / rows[:, None]
        size = np.linalg.norm(columns, axis=0)
        along = columns / np.where(size > 0.0, size, np.inf) / rows[:, None]
        carried = np.einsum("im,ij,jm->m", along, equations.mass[:n, :n], along)
        needed.append(acceleration * carried / np.where(size > 0.0, size, np.inf))
    return np.median(needed, axis=0) if needed else np.zeros(reference.robot.m)
