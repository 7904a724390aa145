"""From a planned motion to the efforts that make it, as functions of time, exact between the plan's samples too.

Efforts read off a plan's samples by interpolation are off by a power of the sampling step, and beside a type II
singularity that is magnified. Here the motion is taken as the function of time it is, and W τ = f is solved at 16
Chebyshev points of every stretch between two nodes of the plan, inside which everything is analytic. The points keep
off the ends of a stretch, so τ is never asked for at a singular node itself; the polynomial fills it in.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from engines.task import Task
from redundancy_pin.arrays import Array, BoolArray, checked
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.reference import actuators_off, planned_carriers, planned_platform, smooth_pieces
from redundancy_pin.trajectory.functions_of_time import (
    ContinuousMotion,
    PiecewisePolynomial,
    TimedTrajectory,
    carriers_at,
    chebyshev_series,
    chebyshev_times,
    continuous_motion,
)

STRETCH = 0.01
"""Longest stretch of a motion that is no plan, s: 16 points in it resolve whatever a machine can follow."""


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

    Between the samples the carriers move as ``planned_carriers`` says, and main actuators are off where
    ``actuators_off`` says so.

    Args:
        dynamics: either backend, for the robot of the plan.
        plan: the plan.
        trajectory: the platform motion it was made for; quintics between the plan's samples when left out.

    Raises:
        InputError: the trajectory is not that of the plan.
        InfeasiblePlanError: efforts without a finite value; carries the time.
    """
    source = planned_platform(plan, trajectory)
    position = planned_carriers(plan)
    edges = smooth_pieces(position, source)
    drive = _drive(dynamics, source, partial(carriers_at, position), edges, edges[1:-1], actuators_off(plan, edges))
    planned = np.concatenate([plan.tau, plan.carrier_force], axis=1)
    # a sample belongs to the step that it ends, the second of two at a jump to the one it begins, and the first one to
    # none: a plan by steps may set off with a jump
    own = drive.task.efforts(plan.t, side="left")
    own[plan.motion.jumps] = drive.task.efforts(plan.t[plan.motion.jumps])
    off = np.abs(own - planned)[1:]
    return replace(drive, plan=plan, plan_gap=float(np.nanmax(off, initial=0.0)))


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
    source = continuous_motion(trajectory)
    own = checked(knots, "knots", ("c",))
    fixed = np.concatenate([[source.start, source.end], source.breaks, source.knots, own])
    edges = np.unique(np.clip(fixed, source.start, source.end))
    counts = np.ceil(np.diff(edges) / STRETCH).astype(int)
    pieces = [np.linspace(a, b, n, endpoint=False) for a, b, n in zip(edges[:-1], edges[1:], counts, strict=True)]
    k = dynamics.robot.k
    at = carriers or (lambda times: CarrierMotion.parked(len(times), k))
    ends = np.append(np.concatenate(pieces), edges[-1])
    return _drive(dynamics, source, at, ends, edges[1:-1], np.zeros(len(ends) - 1, dtype=bool))


def _drive(
    dynamics: Dynamics,
    source: ContinuousMotion,
    carriers: Callable[[Array], CarrierMotion],
    edges: Array,
    breaks: Array,
    off: BoolArray,
) -> Drive:
    def efforts(times: Array) -> Array:
        reduced = dynamics.along(source.sample_at(times)).reduce(carriers(times))
        tau = distribute(reduced).tau.copy()
        tau[off[np.clip(np.searchsorted(edges, times) - 1, 0, len(off) - 1)]] = 0.0
        bad = np.flatnonzero(~np.isfinite(tau).all(axis=1))
        if len(bad):
            t = float(times[bad[0]])
            raise InfeasiblePlanError(
                f"The motion has no finite efforts at {t:.9g} s.",
                remedy="Plan the carriers through the singularity with plan_whole_trajectory.",
                t=t,
            )
        return np.concatenate([tau, reduced.carrier_force], axis=1)

    # not fitted to a tolerance: the stretches are short enough, and division beside a singular node would chase its
    # rounding
    values = efforts(chebyshev_times(edges)).reshape(len(edges) - 1, -1, dynamics.robot.m + dynamics.robot.k)
    polynomials = PiecewisePolynomial.from_values(edges, values)
    robot = dynamics.robot
    first = edges[:1]
    tree, its_carriers = lift(robot, source.sample_at(first)), carriers(first)
    q, v = tree.q[0].copy(), tree.v[0].copy()
    q[robot.carrier_position] = its_carriers.s[0]
    v[robot.carrier_velocity] = its_carriers.sd[0]
    task = Task(robot, float(edges[0]), float(edges[-1]), q, v, polynomials, breaks)
    resolution = float(np.abs(chebyshev_series(values)[:, -3:]).max())
    return Drive(task, source.sample_at, carriers, resolution)
