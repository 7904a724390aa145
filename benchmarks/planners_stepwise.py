"""The stepwise planner against scipy's SLSQP called at each step on the same problem (the thesis used an SQP as well).

SLSQP gets what the planner has: the coefficients of the efforts, read off the backend once, the exact gradient, the box
and the previous step as its first guess. It minimises over s̈, in which the problem is well scaled; over s its bounds
would be a fraction of a millimetre apart. A second yardstick asks the backend at every evaluation, as one would without
those coefficients.
"""

import statistics
import time

import numpy as np
from scipy.optimize import minimize

import redundancy_pin as rp
from redundancy_pin.planners.carrier_model import effort_model
from redundancy_pin.planners.carrier_return import CarrierState
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.stepwise.planner import LEAST_MARGIN, plan_stepwise
from redundancy_pin.planners.stepwise.step import AccelerationBox, optimise

REPEATS = 7
TARGET = 20
SAME = 1e-6
PRECISION = 1e-12
"""Of SLSQP's objective; with its default of 1e-6 its carriers end 7e-6 away."""


def seconds(action):
    start = time.perf_counter()
    result = action()
    return time.perf_counter() - start, result


def box(limits, h, s, sd):
    """The limits as bounds of s̈: acceleration, speed and track."""
    ends = np.array([(b.lower, b.upper, b.speed, b.acceleration) for b in limits]).T
    lower, upper, speed, acceleration = ends
    low = np.maximum(np.maximum(-acceleration, (-speed - sd) / h), (lower - s - h * sd) / h**2)
    high = np.minimum(np.minimum(acceleration, (speed - sd) / h), (upper - s - h * sd) / h**2)
    return low, high


def slsqp_steps(model, limits):
    """The carriers' positions, one SLSQP a step, efforts and gradient from the coefficients."""
    k = len(limits)
    s, sd, sdd = np.zeros(k), np.zeros(k), np.zeros(k)
    records = []
    for j in range(1, len(model.t)):
        h, tau0 = model.t[j] - model.t[j - 1], model.tau0[j]
        by_s, by_s2, by_sd, by_ssd, by_sdd = np.moveaxis(model.tau_terms[j], -1, 0)

        def cost(u, s=s, sd=sd, h=h, tau0=tau0, a=by_s, b=by_s2, c=by_sd, d=by_ssd, e=by_sdd):
            rate = sd + h * u
            place = s + h * rate
            tau = tau0 + a @ place + b @ place**2 + c @ rate + d @ (place * rate) + e @ u
            slope = h * h * (a + 2.0 * b * place + d * rate) + h * (c + d * place) + e
            return tau @ tau, 2.0 * tau @ slope

        low, high = box(limits, h, s, sd)
        guess = np.clip(sdd, low, high)
        solved = minimize(cost, guess, jac=True, bounds=np.stack([low, high], 1), method="SLSQP", tol=PRECISION)
        sdd = np.clip(solved.x, low, high)
        sd = sd + h * sdd
        s = s + h * sd
        records.append(s)
    return np.array(records)


def slsqp_on_backend(dynamics, motion, limits):
    """The same, asking the backend at every evaluation; the gradient by its exact carrier derivatives."""
    k = len(limits)
    s, sd, sdd = np.zeros(k), np.zeros(k), np.zeros(k)
    records = []
    for j in range(1, len(motion)):
        h, along = motion.t[j] - motion.t[j - 1], dynamics.along(motion[j : j + 1])

        def cost(u, s=s, sd=sd, h=h, along=along):
            rate = sd + h * u
            carriers = rp.CarrierMotion((s + h * rate)[None], rate[None], u[None])
            reduced, slopes = along.reduce(carriers), along.carrier_derivatives(carriers)
            inverse = np.linalg.inv(reduced.W[0])
            tau = inverse @ reduced.f[0]
            slope = inverse @ (h * h * slopes.f_s[0] + h * slopes.f_sd[0] + slopes.f_sdd[0])
            return tau @ tau, 2.0 * tau @ slope

        low, high = box(limits, h, s, sd)
        guess = np.clip(sdd, low, high)
        solved = minimize(cost, guess, jac=True, bounds=np.stack([low, high], 1), method="SLSQP", tol=PRECISION)
        sdd = np.clip(solved.x, low, high)
        sd = sd + h * sdd
        s = s + h * sd
        records.append(s)
    return np.array(records)


def compared(title, slow, fast, least, repeats=REPEATS):
    """Time two ways to the carriers' positions in turn; raises where they differ."""
    fast()
    ratios, slow_times, fast_times = [], [], []
    for _ in range(repeats):
        a, expected = seconds(slow)
        b, got = seconds(fast)
        ratios.append(a / b)
        slow_times.append(a)
        fast_times.append(b)
    steps = len(expected)
    difference = float(np.abs(expected - got[-steps:]).max() / np.abs(expected).max())
    if difference > SAME:
        raise RuntimeError(f"{title}: the carriers differ by {difference:.1e} of their travel")
    row = {
        "what": title,
        "ratio": statistics.median(ratios),
        "ratio_min": min(ratios),
        "ratio_max": max(ratios),
        "target": least,
        "slow_us_per_step": 1e6 * statistics.median(slow_times) / steps,
        "fast_us_per_step": 1e6 * statistics.median(fast_times) / steps,
        "relative_difference": difference,
    }
    print(
        f"{title}: {row['ratio']:.0f} times faster (target {least}, range {row['ratio_min']:.0f} to "
        f"{row['ratio_max']:.0f}); {row['slow_us_per_step']:.0f} -> {row['fast_us_per_step']:.0f} us a step; "
        f"carriers differ by {difference:.1e}"
    )
    return row


def rows():
    """The corner of the thesis, 1.8 s at 5 ms, λ = 0."""
    robot = rp.load_robot("3rrr")
    dynamics = rp.VirtualWork(robot)
    motion = rp.trajectory.reference.corner().sample(0.005, two_sided=False)
    model = effort_model(dynamics.along(motion), LEAST_MARGIN)
    start = CarrierState(0.0, *np.zeros((3, robot.k)))
    limits = AccelerationBox(Limits().resolved(robot), anticipate=True, rest_at=np.inf)

    def steps():
        return optimise(model, 0, len(motion) - 1, start, limits).s

    def plan():
        return np.array(plan_stepwise(dynamics, motion).carriers.s)[1 : len(motion)]

    return [
        compared(
            "stepwise plan of the corner, its steps against SLSQP at each step",
            lambda: slsqp_steps(model, robot.carrier_limits),
            steps,
            TARGET,
        ),
        compared(
            "the whole plan (model, limits, statuses, diagnostics) against SLSQP asking the backend",
            lambda: slsqp_on_backend(dynamics, motion, robot.carrier_limits),
            plan,
            TARGET,
            repeats=3,
        ),
    ]


if __name__ == "__main__":
    rows()
