"""From a planned motion to the efforts that make it, as functions of time: the same as ``simulate`` plays."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from engines.task import Task
from redundancy_pin.arrays import Array, Side, checked
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.functions import DEGREE, PlanFunctions, unique_times
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.receding_horizon import Command
from redundancy_pin.planners.reference import MotionReference, plan_reference, reference_of
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory, as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, chebyshev_series, chebyshev_times

STRETCH = 0.01
"""Longest stretch of a motion that is no plan, s: a polynomial over it resolves whatever a machine can follow."""


@dataclass(frozen=True, eq=False)
class Drive:
    """A planned motion and the task of following it without feedback.

    Attributes:
        task: initial state and efforts.
        platform: from (N,) increasing times, s, to the planned platform motion there.
        carriers: the same for the carriers.
        resolution: largest of the last three Chebyshev coefficients of any effort, N or N·m: how well the polynomials
            resolve it.
        plan: the plan, if there is one.
        plan_gap: largest difference between these efforts and the plan's own at its samples, N or N·m: what the lag of
            carriers planned by backward differences costs, rounding for other plans. NaN without a plan.
    """

    task: Task
    platform: Callable[[Array], PlatformMotion]
    carriers: Callable[[Array], CarrierMotion]
    resolution: float
    plan: Plan | None = None
    plan_gap: float = float("nan")


def drive_of_plan(dynamics: Dynamics, plan: Plan, trajectory: TimedTrajectory | None = None) -> Drive:
    """Return the drive of a plan.

    Args:
        dynamics: either backend, for the robot of the plan.
        plan: the plan.
        trajectory: the platform motion it was made for, for plans that do not carry it.

    Raises:
        InputError: the trajectory is not that of the plan.
        InfeasiblePlanError: efforts without a finite value; carries the time.
    """
    reference = plan_reference(plan, robot=dynamics.robot, motion=trajectory)
    functions = plan.functions if trajectory is None else plan.functions_along(trajectory)
    return _drive(reference, functions, reference.edges[1:-1], plan)


def commanded(task: Task, commands: Sequence[Command]) -> Task:
    """Return a task with the efforts that were commanded on line, those of every tick until the next one.

    They are as they are: linear over 2.5 ms, and W τ = f up to what the next tick corrects.
    """
    ends = [*(command.t for command in commands[1:]), task.end]
    pieces = [
        [part.between(command.t, end) for part in (command.efforts, command.forces)]
        for command, end in zip(commands, ends, strict=True)
    ]
    efforts, forces = map(PiecewisePolynomial.joined, zip(*pieces, strict=True))

    def both(t: Array, side: Side = "right") -> Array:
        return np.hstack([efforts(t, side), forces(t, side)])

    edges = unique_times(np.concatenate([efforts.edges, forces.edges]))
    return Task(task.robot, task.start, task.end, task.q, task.v, both, edges[1:-1])


def drive_of_motion(
    dynamics: Dynamics,
    trajectory: TimedTrajectory | PlatformMotion,
    carriers: Callable[[Array], CarrierMotion] | None = None,
    *,
    knots: ArrayLike = (),
) -> Drive:
    """Return the drive of a platform motion and a carrier motion given as a function of time.

    Args:
        dynamics: either backend.
        trajectory: the platform motion.
        carriers: from (N,) times, s, to the carrier motion there, smooth between knots; parked at zero when left out.
        knots: (c,) times, s, at which it is not smooth, and instants at which the platform is singular. Accelerations
            may jump only where those of the trajectory do.

    Raises:
        InputError: knots that are not finite numbers.
        InfeasiblePlanError: efforts without a finite value; carries the time.
    """
    source, robot = as_motion(trajectory), dynamics.robot
    own = checked(knots, "knots", ("c",))
    fixed = np.concatenate([[source.start, source.end], source.breaks, source.knots, own])
    edges = np.unique(np.clip(fixed, source.start, source.end))
    position = PiecewisePolynomial.constant(np.zeros(robot.k), source.start, source.end)
    if carriers is not None and robot.k:
        position = PiecewisePolynomial.fit(lambda t: carriers(t).s, edges, own, lambda s: np.abs(s).max(axis=0), 1e-13)
    counts = np.ceil(np.diff(edges) / STRETCH).astype(int)
    pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(edges[:-1], edges[1:], counts, strict=True)]
    functions = PlanFunctions(source, position)
    reference = reference_of(robot, functions, np.append(np.concatenate(pieces), edges[-1]))
    return _drive(reference, functions, edges[1:-1], None)


def _drive(reference: MotionReference, functions: PlanFunctions, breaks: Array, plan: Plan | None) -> Drive:
    efforts, (q, v, _) = reference.efforts, reference.tree(reference.start)
    task = Task(reference.robot, reference.start, reference.end, q, v, efforts, breaks)
    at_nodes = efforts(chebyshev_times(efforts.edges, DEGREE)).reshape(len(efforts.edges) - 1, DEGREE + 1, -1)
    resolution = float(np.abs(chebyshev_series(at_nodes)[:, -3:]).max())
    gap = reference.effort_deviation
    return Drive(task, functions.platform.sample_at, functions.carriers_at, resolution, plan, gap)
