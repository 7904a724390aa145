"""The least cost of one task by one robot, and its derivatives by numbers of the robot, for co-design.

The objective "time" is the duration of a path by ``plan_time_optimal``, of any robot. For other objectives a robot with
carriers has a plan to choose: its least cost is the cost of ``plan_whole_trajectory``. Both have the derivatives of
``optimal.sensitivity``, by the multipliers of the optimum: no plan is made again. Of a robot without carriers the
motion determines the efforts, W(x; p) τ = f(x, ẋ, ẍ; p), and with more actuators than degrees of freedom the efforts
of least norm are taken. Its cost is a function J(τ, q̇, ...) of them at nodes (``OBJECTIVES``), and
dJ/dp = Σ ∂J/∂τ dτ/dp + ..., with dτ/dp by implicit differentiation of W τ = f. That holds the motion of the platform,
and closes the loops again: joint angles change with lengths.

Every instant at which an effort of the continuous motion is largest is a node. A peak is therefore the peak of the
continuous motion. That the instant moves with p adds nothing to the derivative, since the effort is stationary there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, TypeAlias

import casadi as ca
import numpy as np

from redundancy_pin.arrays import Array, IntArray, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.default import design_derivatives
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.carrier_model import require_carriers
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions, unique_times
from redundancy_pin.planners.intersample_check import PlannedMotion, intersample_check
from redundancy_pin.planners.optimal.mesh import Grid, first_mesh, with_nodes
from redundancy_pin.planners.optimal.nlp import Expression
from redundancy_pin.planners.optimal.objectives import OBJECTIVES
from redundancy_pin.planners.optimal.problem import Problem, Task, read_problem
from redundancy_pin.planners.optimal.sensitivity import DesignedRobot, base_slopes, design_gradient
from redundancy_pin.planners.optimal.settings import checked_settings
from redundancy_pin.planners.optimal.solve import Outcome
from redundancy_pin.planners.optimal.time_optimal import optimise_timing, path_task
from redundancy_pin.planners.optimal.transcription import Evaluation, objective_values
from redundancy_pin.planners.optimal.whole_trajectory import optimise
from redundancy_pin.planners.options import Limits, Objective, group_of
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus, SampleStatus, solved_status
from redundancy_pin.trajectory.continuous_motion import Motion, TimedTrajectory, as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import Path

TIME = "time"
"""Objective of a path whose timing is planned."""

FOLLOWED = "inverse_dynamics"
"""Planner of a plan whose efforts follow from the motion."""


def least_cost(
    dynamics: Dynamics,
    motion: PlatformMotion | TimedTrajectory | Path,
    options: Mapping[str, Any],
    near: LeastCost | None = None,
) -> LeastCost:
    """Return the least cost of a task.

    Args:
        dynamics: a backend of the robot.
        motion: of the platform; for the objective "time" a path, or a trajectory for its path.
        options: keywords of ``plan_whole_trajectory``, or of ``plan_time_optimal`` for the objective "time".
        near: the least cost of the task by a similar robot, whose plan is a good first guess.

    Raises:
        InfeasiblePlanError: no plan keeps the limits; or the robot has no carriers, and its motion meets a type II
            singularity or needs efforts beyond their limits.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as the dynamics.
    """
    rest = dict(options)
    objective = replace(Objective.of(rest.pop("objective", "effort")), calm=0.0)
    if objective.weights == TIME:
        timed = path_task(dynamics, motion, **rest)  # type: ignore[arg-type]  # which refuses samples
        return PlannedCost(timed, rest.get("limits"), *optimise_timing(timed))
    source = as_motion(motion)  # type: ignore[arg-type]  # which refuses paths
    task = Task(dynamics, source, checked_settings(dynamics.robot, objective, **rest))
    if not dynamics.robot.k:
        return follow(task)
    require_carriers(dynamics.robot)
    position = None
    if isinstance(near, PlannedCost):
        position = near.outcome.problem.position(near.outcome.values)
    plan, outcome = optimise(task, position)
    return PlannedCost(task, rest.get("limits"), plan, outcome, task.source)


# --- a plan to choose -------------------------------------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class PlannedCost:
    """The least cost of a task that is planned, see ``LeastCost``.

    Attributes:
        task: the task.
        limits: as given, in place of the robot's own.
        plan: its plan.
        outcome: programme and solution.
        platform: motion of the platform.
    """

    task: Task
    limits: Limits | None
    plan: Plan
    outcome: Outcome
    platform: Motion

    @cached_property
    def value(self) -> float:
        """The weighted objectives, or the duration, s, without the regularisation."""
        problem, values = self.outcome.problem, self.outcome.values
        if problem.timing is not None:
            return float(problem.times(values)[-1])
        return self.task.settings.weighted(objective_values(problem, values))

    def gradient(self, designed: DesignedRobot) -> Array:
        """Return (d,) the derivatives of the least cost by the parameters."""
        return design_gradient(self.task, self.outcome, self.platform, designed, group_of(self.limits, Limits))


# --- without: the motion determines the efforts -----------------------------------------------------------------------


@dataclass(frozen=True, eq=False)
class FollowedCost:
    """The cost of a task by a robot without carriers, see ``LeastCost``.

    Attributes:
        task: the task.
        plan: its motion at the nodes, and its efforts.
        values: the objectives that are weighted or bounded, by name, in their units.
        by: derivatives of the weighted objectives by (M, m) efforts and (M, m) rates of the actuators, by (M, 6) wrench
            on the base, and by the characteristic length.
    """

    task: Task
    plan: Plan
    values: Mapping[str, float]
    by: tuple[Array, Array, Array, float]

    @property
    def value(self) -> float:
        """The weighted objectives."""
        return self.task.settings.weighted(self.values)

    def gradient(self, designed: DesignedRobot) -> Array:
        """Return (d,) the derivatives of the cost by the parameters.

        Raises:
            UnsupportedRobotError: a parameter that changes the joints of the robot, or a load that is a function.
        """
        motion, (by_tau, by_rate, by_base, by_length) = self.plan.motion, self.by
        along = design_derivatives(designed.robot, motion, self.plan.carriers, designed.names)
        rate = np.einsum("nimd,ni->nmd", along.W.parameters, motion.xd)
        gradient: Array = np.einsum("nm,nmd->d", by_tau, along.tau.parameters) + np.einsum("nm,nmd->d", by_rate, rate)
        if by_base.any():
            base = base_slopes(self.task.settings, motion, along.base_wrench.parameters, designed)
            gradient = gradient + np.einsum("nc,ncd->d", by_base, base)
        if by_length:
            own = designed.robot.characteristic_length
            slopes = [(robot.characteristic_length - own) / step for robot, step in designed.neighbours]
            gradient = gradient + by_length * np.array(slopes)
        return read_only(gradient)


def follow(task: Task) -> FollowedCost:
    """Return the cost of following a motion without carriers.

    Raises:
        InfeasiblePlanError: the motion meets a type II singularity, or has no finite efforts for another reason; or a
            limit is exceeded.
    """
    grid = first_mesh(task.dynamics, task.source, task.settings.dt)
    if len(grid.singular):
        raise _without_efforts(float(grid.t[grid.singular[0]]), "meets a type II singularity")
    # its peaks become nodes
    grid, fixed = _with_times(grid, intersample_check(_planned(task, grid)).peaks.time)
    planned = _planned(task, grid)
    plan = finish_plan(planned)
    unsolved = np.flatnonzero(~solved_status(plan.sample_status))
    if len(unsolved):
        status = SampleStatus(plan.sample_status[unsolved[0]])
        raise _without_efforts(float(plan.t[unsolved[0]]), f"has no efforts ({status.label})")
    if plan.status is ResultStatus.UNBOUNDED:
        at = float(plan.between.time[plan.between.peak.argmax()])
        raise _without_efforts(at, "has efforts that grow without bound")
    for event in plan.limits.violated:
        raise InfeasiblePlanError(
            f"{event.joint} exceeds its {event.quantity} limit of {event.limit:.6g}: {event.value:.6g} at "
            f"t = {event.worst:.6g} s.",
            remedy="Move more slowly, widen the limit, or begin with another robot.",
            constraint=event.quantity,
            time=event.worst,
            amount=event.amount,
        )
    values, by = _objectives(task, plan, grid, fixed)
    for name, bound in task.settings.at_most.items():
        if values[name] > bound:
            raise InfeasiblePlanError(
                f"{name} is {values[name]:.6g}, which may be {bound:.6g} at most.",
                remedy="Raise the bound, or begin with another robot.",
                constraint="at_most",
                time=float(plan.t[0]),
                amount=values[name] - bound,
            )
    return FollowedCost(task, plan, values, by)


def _without_efforts(t: float, why: str) -> InfeasiblePlanError:
    return InfeasiblePlanError(
        f"At t = {t:.6g} s the motion {why}: without carriers nothing makes its efforts finite.",
        remedy="Keep away from singularities, narrow the ranges of the parameters, or give the robot carriers.",
        constraint="effort",
        time=t,
    )


def _with_times(grid: Grid, times: Array) -> tuple[Grid, IntArray]:
    """Return a grid with nodes at more times, s, skipping times it has, and the indices of its previous nodes."""
    merged = unique_times(np.concatenate([grid.t, times]))
    added = merged[~np.isin(merged, grid.t)]
    finer = with_nodes(grid, np.searchsorted(grid.t, added, side="right") - 1, added, False)
    return finer, np.flatnonzero(~np.isin(finer.t, added))


def _planned(task: Task, grid: Grid) -> PlannedMotion:
    """Return the motion at nodes, with the efforts that W τ = f determines."""
    motion = task.source.sample_at(grid.t)
    ends = np.array([task.source.start, task.source.end])
    none = PiecewisePolynomial.from_values(ends, np.zeros((1, 1, 0)))
    return PlannedMotion(
        task.dynamics,
        PlanFunctions(task.source, none),
        task.dynamics.along(motion),
        CarrierMotion.parked(len(motion), 0),
        task.settings.limits,
        FOLLOWED,
        parameters=task.settings.parameters,
    )


class _Symbols(Evaluation):
    """The quantities of a followed motion, of which those that change with the robot are symbols.

    These are efforts and rates (M, m), the wrench on the base (M, 6) and the characteristic length. Integrals, rates
    and ripples are those at the nodes that were there before the peaks of the efforts: a node that moves with the robot
    would change the error of the trapezoidal rule.
    """

    def __init__(self, problem: Problem, fixed: IntArray) -> None:
        none = np.zeros((len(problem.grid.t), 0))
        super().__init__(problem, {"s": none, "sd": none, "sdd": none, "force": none}, np.diff(problem.grid.t[fixed]))
        self._fixed = fixed.tolist()
        self.tau, self.actuated_rate = (ca.MX.sym("y", *problem.target.shape) for _ in range(2))
        self.base, length = ca.MX.sym("base", len(none), 6), ca.MX.sym("length")
        self.base_force, self.base_moment = self.base[:, :3], self.base[:, 3:]
        self.scales = replace(problem.scales, length=length)  # type: ignore[arg-type]  # costs are differentiated by it

    def integral(self, integrand: Expression) -> Expression:
        """Return ∫ Σ integrand dt by the trapezoidal rule."""
        return super().integral(integrand[self._fixed, :])

    def rate(self, values: Expression) -> Expression:
        """Return the time derivative in each step."""
        return super().rate(values[self._fixed, :])

    def bending(self, values: Expression) -> tuple[Expression, Array]:
        """Return by how much values at inner nodes deviate from the line through both neighbours, and weights."""
        return super().bending(values[self._fixed, :])


def _objectives(
    task: Task, plan: Plan, grid: Grid, fixed: IntArray
) -> tuple[dict[str, float], tuple[Array, Array, Array, float]]:
    """Return the objectives by name, and the derivatives of ``FollowedCost.by``."""
    problem = read_problem(task, grid)
    symbols, objective = _Symbols(problem, fixed), task.settings.objective
    formulas = {name: OBJECTIVES[name].value(symbols) for name in {**objective, **task.settings.at_most}}
    cost = sum(weight * formulas[name] for name, weight in objective.items())
    variables = [symbols.tau, symbols.actuated_rate, symbols.base, symbols.scales.length]
    outputs = [*formulas.values(), *(ca.gradient(cost, variable) for variable in variables)]
    base = problem.base.w0 if problem.base else np.zeros((len(grid.t), 6))
    values = ca.Function("objectives", variables, outputs).call(
        [plan.tau, plan.actuated_rate, base, task.dynamics.robot.characteristic_length]
    )
    by_tau, by_rate, by_base, by_length = (part.full() for part in values[len(formulas) :])
    found = {name: float(value) for name, value in zip(formulas, values, strict=False)}
    return found, (by_tau, by_rate, by_base, by_length.item())


LeastCost: TypeAlias = PlannedCost | FollowedCost
"""The least cost of a task by a robot: ``plan`` has it, ``value`` is in the unit of the objective, and ``gradient`` are
its derivatives by parameters of the robot."""
