"""What a stepwise plan says about itself: optimality, bounds met, and efforts between the samples."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import BoolArray
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise.box import AccelerationBox
from redundancy_pin.planners.stepwise.course import OPTIMISE, Braking, Course
from redundancy_pin.planners.stepwise.optimiser import StepProblems, Stretch, definiteness, optimality
from redundancy_pin.trajectory.functions_of_time import TimedTrajectory

_MET = 1e-9
"""Relative distance from a bound that counts as met; the solver puts what is bound exactly on it."""


def diagnostics(problems: StepProblems, course: Course, ending: Braking, limits: AccelerationBox) -> dict[str, object]:
    """Return what the planner found, as plain data.

    Keys: ``steps`` and ``optimised_steps``; ``iterations`` (sum) and ``most_iterations``; ``largest_gradient``, the
    largest deviation from the conditions of a minimum (N or N·m, see ``optimality``); ``least_curvature``, the smallest
    eigenvalue of the Hessian of a step over its largest; ``bounds``, a tuple of mappings with carrier, bound
    (``speed``, ``acceleration``, ``track``, or ``stop``: the carrier is kept able to stop), side, start and end, s;
    ``returns``, start and end of each; ``braking``, start and end, NaN where nothing moved.
    """
    counts = [found.iterations for _, found in course.stretches]
    gradients, curvatures = [], []
    for first, found in course.stretches:
        residual, jacobian = problems.linearised(first, found.s, found.sd, found.sdd)
        gradients.append(optimality(residual, jacobian, found.lower, found.upper, found.sdd))
        curvatures.append(definiteness(residual, jacobian, problems.C[first : first + len(residual)]))
    return {
        "steps": len(problems.h) + len(ending.t),
        "optimised_steps": int(sum(len(count) for count in counts)),
        "iterations": int(sum(int(count.sum()) for count in counts)),
        "most_iterations": int(max((int(count.max()) for count in counts), default=0)),
        "largest_gradient": float(max((part.max() for part in gradients), default=0.0)),
        "least_curvature": float(min((part.min() for part in curvatures), default=np.inf)),
        "bounds": tuple(_bounds_met(course, limits)),
        "returns": tuple(course.returns),
        "braking": (ending.start, ending.end),
    }


def _bounds_met(course: Course, limits: AccelerationBox) -> list[dict[str, object]]:
    found: list[dict[str, object]] = []
    for first, stretch in course.stretches:
        t = course.t[first + 1 : first + 1 + len(stretch.s)]
        for j, name in enumerate(limits.carriers):
            for side, box in (("upper", stretch.upper), ("lower", stretch.lower)):
                at = stretch.sdd[:, j] == box[:, j]
                for bound, here in _which(stretch, limits, j, side).items():
                    edges = np.flatnonzero(np.diff(np.concatenate([[False], at & here, [False]]).astype(int)))
                    found += [
                        {"carrier": name, "bound": bound, "side": side, "start": float(t[a]), "end": float(t[b - 1])}
                        for a, b in zip(edges[::2], edges[1::2], strict=True)
                    ]
    return sorted(found, key=lambda event: (event["start"], event["carrier"]))


def _which(stretch: Stretch, limits: AccelerationBox, j: int, side: str) -> dict[str, BoolArray]:
    """Return for each kind of bound the steps at which it would be the one that binds on a side."""
    limit, sign = limits.limits[j], 1.0 if side == "upper" else -1.0
    end = limit.upper if side == "upper" else limit.lower
    with np.errstate(invalid="ignore"):
        speed = sign * stretch.sd[:, j] >= limit.speed * (1.0 - _MET)
        acceleration = sign * stretch.sdd[:, j] >= limit.acceleration * (1.0 - _MET)
        track = sign * (stretch.s[:, j] - end) >= -_MET * (limit.upper - limit.lower)
    stop = ~(speed | acceleration | track)
    return {"speed": speed, "acceleration": acceleration, "track": track, "stop": stop}


def between_samples(
    dynamics: Dynamics, plan: Plan, points: int, trajectory: TimedTrajectory | None = None
) -> dict[str, object]:
    """Return the largest efforts of a stepwise plan between its samples.

    Samples alone flatter the method: the accelerations are chosen for them. Between them s̈ is constant and ṡ meets the
    plan's at the samples; the positions lag behind the plan's by up to half a step, because backward differences move a
    carrier by its new speed.

    Args:
        dynamics: either backend, of the robot of the plan.
        plan: from ``plan_stepwise``.
        points: number of points inside each step.
        trajectory: the platform motion that was sampled, for exact values between the samples; quintics through x, ẋ,
            ẍ of the samples where left out, which smear a jump that is not two-sided over one step.

    Returns:
        ``peak_effort`` (m) over these points, N or N·m, and ``time_of_peak`` (m), s; the same over the optimised steps,
        ``optimised_peak``, beside ``optimised_peak_at_samples``; ``largest_lag``, m.

    Raises:
        InputError: poses without a trajectory.
    """
    left = np.flatnonzero(np.diff(plan.t) > 0.0)
    if trajectory is not None:
        left = left[plan.t[left + 1] <= trajectory.duration]
    fraction = np.arange(1, points + 1) / (points + 1)
    times = plan.t[left, None] + np.diff(plan.t)[left, None] * fraction
    functions = plan.functions_of_time if trajectory is None else plan.functions_along(trajectory)
    reduced = dynamics.along(functions.platform.sample_at(times.ravel())).reduce(functions.carriers_at(times.ravel()))
    efforts = np.abs(functions.efforts(reduced))
    optimised = np.repeat(plan.phase[left + 1] == OPTIMISE, points)
    at_samples = np.abs(plan.tau[plan.phase == OPTIMISE])
    worst = efforts.argmax(axis=0)
    return {
        "points": points,
        "peak_effort": tuple(efforts.max(axis=0).tolist()),
        "time_of_peak": tuple(times.ravel()[worst].tolist()),
        "optimised_peak": tuple(efforts[optimised].max(axis=0, initial=0.0).tolist()),
        "optimised_peak_at_samples": tuple(at_samples.max(axis=0, initial=0.0).tolist()),
        "largest_lag": float(np.abs(functions.carriers(plan.t) - plan.carriers.s).max(initial=0.0)),
    }
