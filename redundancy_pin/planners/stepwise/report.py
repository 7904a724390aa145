"""What a stepwise plan says about itself: optimality, bounds met, and efforts between the samples."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise.course import BRAKE, OPTIMISE, Braking, Course
from redundancy_pin.planners.stepwise.optimiser import StepProblems, Stretch, definiteness, optimality
from redundancy_pin.planners.stepwise.settings import StepLimits
from redundancy_pin.trajectory.functions_of_time import TimedTrajectory, continuous_motion

_MET = 1e-9
"""Relative distance from a bound that counts as met; the solver puts what is bound exactly on it."""


def diagnostics(problems: StepProblems, course: Course, ending: Braking, limits: StepLimits) -> dict[str, object]:
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


def _bounds_met(course: Course, limits: StepLimits) -> list[dict[str, object]]:
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


def _which(stretch: Stretch, limits: StepLimits, j: int, side: str) -> dict[str, BoolArray]:
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

    Samples alone flatter the method: the accelerations are chosen for them. The motion between them is the one with
    piecewise constant s̈ and the plan's ṡ at the samples; its positions lag behind the plan's by up to half a step,
    because backward differences move a carrier by its new speed. On returns it is the quintic through s, ṡ, s̈.

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
    source = continuous_motion(plan.motion if trajectory is None else trajectory)
    motion = source.sample_at(times.ravel())
    carriers, lag = _between(plan, left, fraction)
    efforts = np.abs(distribute(dynamics.reduce(motion, carriers, check_track=False)).tau)
    optimised = np.repeat(plan.phase[left + 1] == OPTIMISE, points)
    at_samples = np.abs(plan.tau[plan.phase == OPTIMISE])
    worst = efforts.argmax(axis=0)
    return {
        "points": points,
        "peak_effort": tuple(efforts.max(axis=0).tolist()),
        "time_of_peak": tuple(motion.t[worst].tolist()),
        "optimised_peak": tuple(efforts[optimised].max(axis=0, initial=0.0).tolist()),
        "optimised_peak_at_samples": tuple(at_samples.max(axis=0, initial=0.0).tolist()),
        "largest_lag": lag,
    }


def _between(plan: Plan, left: IntArray, fraction: Array) -> tuple[CarrierMotion, float]:
    """Return the carriers inside the steps from samples ``left``, and the largest lag of their positions, m."""
    s, sd, sdd = (np.asarray(part) for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd))
    right = left + 1
    h = (plan.t[right] - plan.t[left])[:, None]
    stepped = np.isin(plan.phase[right], (OPTIMISE, BRAKE))
    # the lag grows by -h² u / 2 a step and starts anew after steps that are not of this kind
    grown = np.cumsum(np.where(stepped[:, None], -0.5 * h * h * sdd[right], 0.0), axis=0)
    last_exact = np.maximum.accumulate(np.where(stepped, -1, np.arange(len(left))))
    offset = np.where((last_exact >= 0)[:, None], grown[np.maximum(last_exact, 0)], 0.0)
    lag = np.where(stepped[:, None], grown - offset, 0.0)
    begins = np.vstack([np.zeros_like(lag[:1]), lag[:-1]]) * stepped[:, None]
    x = fraction[:, None] * h[:, None, :]
    position, speed, acceleration = s[left][:, None], sd[left][:, None], sdd[right][:, None]
    constant = (
        position + begins[:, None] + speed * x + 0.5 * acceleration * x * x,
        speed + acceleration * x,
        np.broadcast_to(acceleration, (*x.shape[:1], len(fraction), s.shape[1])),
    )
    smooth = _hermite(fraction, h, [part[left] for part in (s, sd, sdd)], [part[right] for part in (s, sd, sdd)])
    chosen = (
        np.where(stepped[:, None, None], a, b).reshape(-1, s.shape[1]) for a, b in zip(constant, smooth, strict=True)
    )
    return CarrierMotion(*chosen), float(np.abs(lag).max(initial=0.0))


def _hermite(fraction: Array, h: Array, start: list[Array], end: list[Array]) -> tuple[Array, Array, Array]:
    """Return value, rate and second rate (I, F, k) of the quintics between interval ends with (I, k) s, ṡ, s̈."""
    kappa = fraction[None, :, None]
    h = h[:, None]
    s0, v0, a0 = (part[:, None] for part in start)
    s1, v1, a1 = (part[:, None] for part in end)
    d = s1 - s0 - h * v0 - 0.5 * h * h * a0
    dv, da = h * (v1 - v0 - h * a0), h * h * (a1 - a0)
    c3, c4, c5 = 10.0 * d - 4.0 * dv + 0.5 * da, -15.0 * d + 7.0 * dv - da, 6.0 * d - 3.0 * dv + 0.5 * da
    x = kappa * h
    value = s0 + v0 * x + 0.5 * a0 * x * x + kappa**3 * (c3 + kappa * (c4 + kappa * c5))
    rate = v0 + a0 * x + kappa**2 * (3.0 * c3 + kappa * (4.0 * c4 + 5.0 * kappa * c5)) / h
    second = a0 + kappa * (6.0 * c3 + kappa * (12.0 * c4 + 20.0 * kappa * c5)) / h**2
    return value, rate, second
