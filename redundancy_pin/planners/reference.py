"""A motion with its tree and the efforts that belong to it, for any instant in microseconds.

The functions of time of a plan are in ``Plan.functions``. Here its inverse dynamics are evaluated
at the Chebyshev points of all pieces at once and kept as polynomials, so that a simulation, a controller or an outside
engine can ask for any instant. The efforts of the samples, interpolated, would be another, wrong, command.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, Frozen, positive, read_only
from redundancy_pin.dynamics.default import rnea_along
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.inverse_kinematics import JointTrajectory, inverse_kinematics
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion, parked_place
from redundancy_pin.planners.functions import DEGREE, SINGULAR_SAMPLE, PlanFunctions, unique_times
from redundancy_pin.planners.robot_record import robot_of_record
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory, as_motion
from redundancy_pin.trajectory.functions_of_time import SHIFT, PiecewisePolynomial, chebyshev_times

if TYPE_CHECKING:
    from redundancy_pin.planners.plan import Plan


def inverse_dynamics(
    robot: Robot, motion: PlatformMotion, carriers: CarrierMotion
) -> tuple[JointTrajectory, ReducedDynamics]:
    """Return N samples of the tree, carriers included, and W τ = f; raises like ``inverse_kinematics``.

    It is always RNEA: the simulation judges plans that generated code made.
    """
    tree = inverse_kinematics(robot, motion)
    return tree.with_carriers(carriers), rnea_along(tree).reduce(carriers)


@dataclass(frozen=True, eq=False)
class ReferencePoint(Frozen):
    """A planned motion at one instant.

    Attributes:
        t: time, s.
        x: (n,) platform coordinates, m and rad, or a pose (4, 4).
        xd, xdd: (n,) their rates.
        s, sd, sdd: (k,) carrier motion.
        q, v, a: (nq,), (nv,), (nv,) tree configuration, velocity and acceleration, carriers included.
        tau: (m,) main efforts, N or N·m.
        carrier_force: (k,) forces of the carriers' actuators, N.
    """

    t: float
    x: Array
    xd: Array
    xdd: Array
    s: Array
    sd: Array
    sdd: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    carrier_force: Array


class MotionReference:
    """A motion of platform and carriers with the efforts that belong to it, as a function of time.

    Made by ``plan_reference`` or ``motion_reference``.

    Attributes:
        robot: the robot whose efforts these are.
        edges: (P + 1,) ends of the pieces, s; efforts may jump or kink there and nowhere else.
        jumps: (j,) inner edges, s, at which efforts jump; at the others their slope does.
        start, end: first and last time, s.
        is_pose: whether the platform's coordinates are poses.
        efforts: τ and carrier forces as polynomials on the pieces.
        carrier_lag: (k,) largest distance of the carriers from the samples of a plan, m: what backward differences
            leave.
        effort_deviation: largest distance of the efforts from the finite ones that a plan has at its samples, N or N·m;
            what its own discretisation costs. NaN without a plan.
    """

    def __init__(
        self,
        robot: Robot,
        edges: Array,
        states: PiecewisePolynomial,
        efforts: PiecewisePolynomial,
        is_pose: bool,
        carrier_lag: Array,
        deviation: float,
    ) -> None:
        self.robot, self.edges = robot, edges
        self.start, self.end = float(edges[0]), float(edges[-1])
        self.carrier_lag, self.effort_deviation = carrier_lag, deviation
        self.efforts, self.jumps = efforts, efforts.jumps()
        self.is_pose = is_pose
        n, k, model = robot.n, robot.k, robot.model
        ends = np.cumsum([16 if is_pose else n, n, n, k, k, k, model.nq, model.nv, model.nv]).tolist()
        self._columns = [slice(first, stop) for first, stop in itertools.pairwise([0, *ends])]
        self._motion = states  # x, ẋ, ẍ, s, ṡ, s̈, q, v and a side by side

    def loads(self, t: float) -> tuple[Array, Array]:
        """Return main efforts (m,) and carrier forces (k,) at time t; outside the motion those at its ends."""
        both = self.efforts.at(t)
        return both[: self.robot.m], both[self.robot.m :]

    def carriers(self, t: float) -> tuple[Array, Array, Array]:
        """Return s, ṡ, s̈ (k,) at time t."""
        _, _, _, s, sd, sdd, *_ = self._states(t)
        return s, sd, sdd

    def platform(self, t: float) -> tuple[Array, Array, Array]:
        """Return x, (n,) or a pose (4, 4), ẋ and ẍ (n,) at time t."""
        x, xd, xdd, *_ = self._states(t)
        return x, xd, xdd

    def tree(self, t: float) -> tuple[Array, Array, Array]:
        """Return q (nq,), v and a (nv,) at time t."""
        *_, q, v, a = self._states(t)
        return q, v, a

    def at(self, t: float) -> ReferencePoint:
        """Return everything at time t, s."""
        return ReferencePoint(t, *(*self._states(t), *self.loads(t)))

    def course(self, t: float) -> tuple[Array, Array, Array, Array, Array]:
        """Return x, ẋ, s, ṡ and all efforts (m + k) at time t, s: the reference values of a feedback controller."""
        x, xd, _, s, sd, *_ = self._states(t)
        return x, xd, s, sd, self.efforts.at(t)

    def _states(self, t: float) -> list[Array]:
        """Return x, ẋ, ẍ, s, ṡ, s̈, q, v and a at time t."""
        flat = self._motion.at(t)
        x, *others = (flat[columns] for columns in self._columns)
        return [x.reshape(4, 4) if self.is_pose else x, *others]

    def tree_and_loads(self, times: Array) -> tuple[Array, Array, Array, Array]:
        """Return q (N, nq), v and a (N, nv), and main efforts and carrier forces side by side (N, m + k), at times."""
        flat = self._motion(times)
        q, v, a = (flat[:, columns] for columns in self._columns[-3:])
        return q, v, a, self.efforts(times)


def plan_reference(
    plan: Plan, *, robot: RobotLike | None = None, motion: TimedTrajectory | None = None
) -> MotionReference:
    """Return the continuous motion of a plan.

    Args:
        plan: from any planner.
        robot: its robot; loaded from the plan when left out.
        motion: the trajectory that was planned for; it makes a difference to plans that were made from samples, which
            otherwise stand for the quintics through x, ẋ, ẍ of their samples.

    Raises:
        InputError: the motion is not the plan's motion.
        InfeasiblePlanError: some instant has no finite efforts.
        PlanFileError: the robot cannot be loaded, or has changed since.

    Example:
        >>> from redundancy_pin.simulation import plan_reference
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner())
        >>> plan_reference(plan).at(0.5).tau.shape
        (3,)
    """
    if not hasattr(plan, "functions"):
        raise InputError(f"A plan was expected, not {type(plan).__name__}.", remedy="Pass load_plan(...).")
    machine = robot_of_record(plan.robot, robot)
    functions = plan.functions if motion is None else plan.functions_along(motion)
    return reference_of(machine, functions, functions.pieces(plan.t), plan)


def motion_reference(
    robot: RobotLike,
    motion: TimedTrajectory | PlatformMotion,
    carriers: ArrayLike | CarrierMotion = 0.0,
    *,
    step: float = 0.01,
) -> MotionReference:
    """Return a platform motion, with parked or moving carriers, as a reference, with its efforts.

    Args:
        robot: the robot, or its name or path.
        motion: a trajectory, or samples with quintics between them.
        carriers: scalar or (k,) where the carriers are parked, m; or their motion at the samples of the platform's,
            with quintics in between.
        step: longest piece, s, of the series that represent it.

    Raises:
        InfeasiblePlanError: some instant has no finite efforts.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as inverse dynamics.

    Example:
        >>> from redundancy_pin.simulation import motion_reference
        >>> turn = rp.trajectory.from_points([[1.0], [2.0]], [0.0, 1.0], ends="rest")
        >>> motion_reference("four_bar", turn).at(0.5).x
        array([1.5])
    """
    positive(step, "step", "s")
    robot, source = as_robot(robot), as_motion(motion)
    if isinstance(carriers, CarrierMotion):
        position = _between_samples(motion, carriers, robot.k)
    else:
        place = parked_place(carriers, robot.k, "The place of parked carriers")
        position = PiecewisePolynomial.constant(place, source.start, source.end)
    own = np.unique(np.concatenate([[source.start], source.breaks, source.knots, [source.end]]))
    parts = [np.linspace(a, b, max(2, int(np.ceil((b - a) / step)) + 1)) for a, b in itertools.pairwise(own)]
    return reference_of(robot, PlanFunctions(source, position), unique_times(np.concatenate([*parts, position.edges])))


def _between_samples(
    motion: TimedTrajectory | PlatformMotion, carriers: CarrierMotion, count: int
) -> PiecewisePolynomial:
    """Return the positions of carriers between the samples that they and the platform have."""
    if not isinstance(motion, PlatformMotion) or carriers.s.shape != (len(motion), count):
        samples = len(motion) if isinstance(motion, PlatformMotion) else "no"
        raise InputError(
            f"The carrier motion has shape {carriers.s.shape}; the platform motion has {samples} samples, the robot "
            f"{count} carriers.",
            remedy="Sample both at the same times.",
        )
    return PiecewisePolynomial.through(motion.t, carriers.s, carriers.sd, carriers.sdd)


def reference_of(robot: Robot, functions: PlanFunctions, edges: Array, plan: Plan | None = None) -> MotionReference:
    """Evaluate the inverse dynamics along two motions, smooth between ``edges``, at all Chebyshev points at once.

    The efforts of a plan at singular instants are those that W⁻¹ f tends to. Raises like ``plan_reference``.
    """
    times = chebyshev_times(edges, DEGREE)
    motion, along = functions.platform.sample_at(times), functions.carriers_at(times)
    tree, reduced = inverse_dynamics(robot, motion, along)

    def polynomials(*parts: Array) -> PiecewisePolynomial:
        values = np.concatenate([part.reshape(len(times), -1) for part in parts], axis=1)
        return PiecewisePolynomial.from_values(edges, values.reshape(len(edges) - 1, DEGREE + 1, -1))

    limits, lag = {}, np.zeros(robot.k)
    if plan is not None:
        singular = np.flatnonzero(plan.margin <= SINGULAR_SAMPLE * plan.margin.max())
        limits = {float(plan.t[i]): np.asarray(plan.tau[i]) for i in singular if np.isfinite(plan.tau[i]).all()}
        lag = np.abs(functions.carriers(plan.t) - plan.carriers.s).max(axis=0, initial=0.0)
    tau = functions.effort_polynomials(edges, reduced, limits)
    together = polynomials(motion.x, motion.xd, motion.xdd, along.s, along.sd, along.sdd, tree.q, tree.v, tree.a)
    efforts = tau.hstack(polynomials(reduced.carrier_force))
    lag = read_only(np.where(lag < SHIFT, 0.0, lag))
    deviation = float("nan") if plan is None else _deviation(plan, tau)
    return MotionReference(robot, read_only(edges), together, efforts, motion.is_pose, lag, deviation)


def _deviation(plan: Plan, tau: PiecewisePolynomial) -> float:
    """Return the largest distance of the efforts from the samples of a plan; NaN without efforts."""
    two_sided = plan.motion.jumps | np.append(plan.motion.jumps[1:], False)
    finite = np.isfinite(plan.tau).all(axis=1) & ~two_sided
    # a sample belongs to the step that it ends, and the first one to none: a plan by steps may set off with a jump
    finite[0] = False
    distances = np.abs(tau(plan.t[finite], "left") - plan.tau[finite])
    return float(distances.max()) if distances.size else float("nan")
