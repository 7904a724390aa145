"""Random planning problems, and what a plan promises: checked densely, by the other backend where there is one.

As a program it prints what goes wrong: ``python tests/support/random_problems.py [count] [first]``.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path
from typing import Any

import forked
import numpy as np
import zoo
from random_robots import Masses, random_robot

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.paths import Line
from redundancy_pin.trajectory.waypoints import rounded_polygon, through_points

ROBOTS = ("2rpr", "3rrr", "five_bar")
"""Those with carriers."""

PATIENCE = 90
"""s of the processor after which a problem is given up."""

FINER = 20
"""Samples in each step of a plan."""

ALLOWED = 1.05
"""What efforts and forces between the nodes may exceed limits and the stated peak by: the planner's promise."""

ROUNDING = 1e-6
"""Relative, of limits that a motion is built to lie on."""

BALANCED = 1e-6
"""Largest |W τ − f| of a sample over the largest |f|: what planners promise of efforts they prescribe."""


def random_path(robot: Robot, rng: np.random.Generator) -> Trajectory:
    """Return a motion about home, or one of the shipped; sharp turns, cusps and singular poses are among them."""
    home, reach = np.asarray(zoo.home_of(robot)), zoo.reach_of(robot) / 0.15
    speed, ramp = float(10.0 ** rng.uniform(-1.5, 0.3)), float(rng.choice([0.05, 0.2, 0.5]))
    kind = rng.integers(7)
    size = float(rng.choice([0.05, 0.15, 0.4]))
    if kind == 0 and robot.name == "2rpr":
        return reference.circle(speed=speed, ramp_time=ramp, ramp_length=0.5 * ramp * speed)
    if kind == 0 and robot.name == "3rrr":
        return reference.corner(radius=float(10.0 ** rng.uniform(-3, -1.4)), speed=min(speed, 0.4), ramp_time=ramp)
    points = home + rng.uniform(-1.0, 1.0, (int(rng.integers(3, 6)), len(home))) * reach * size
    if kind <= 2 or len(home) == 1:
        path: Any = Line(tuple(points[0]), tuple(points[1]))
    elif kind <= 4:
        path = through_points(points)
    elif kind == 5:  # there and nearly back again: a cusp, rounded by next to nothing
        points[-1] = points[0] + 1e-3 * (points[-1] - points[0])
        path = through_points(points)
    else:
        path = rounded_polygon(points, radius=float(10.0 ** rng.uniform(-4, -2)))
    return Trajectory(path, SpeedProfile(path.length, min(speed, 0.8 * path.length / ramp), ramp))


def random_limits(rng: np.random.Generator) -> Limits | None:
    """Return limits in place of the robot's, or None."""
    if rng.random() < 0.4:
        return None
    values: dict[str, Any] = {}
    for name, low, high in (("speed", -1, 1), ("acceleration", 0, 2), ("track", -2, 0)):
        if rng.random() < 0.5:
            value = float(10.0 ** rng.uniform(low, high))
            values[name] = (-value, value) if name == "track" else value
    return Limits(**values)


def solved(number: int) -> tuple[Plan, Robot, Dynamics]:
    """Return the plan of a random problem."""
    rng = np.random.default_rng([12, number])
    name = str(rng.choice(ROBOTS))
    robot = random_robot(name, rng, carriers=True, masses=rng.choice(list(Masses)))
    trajectory = random_path(robot, rng)
    closed_form = robot.closed_form is not None
    backends: list[Any] = [rp.RneaDynamics, rp.VirtualWork if closed_form else rp.RneaDynamics]
    first, second = backends if rng.random() < 0.5 else backends[::-1]
    dynamics, limits = first(robot), random_limits(rng)
    planner = rng.integers(3)
    step = trajectory.duration / int(rng.choice([40, 100, 200]))
    if planner == 0:
        plan = rp.plan_switch_off(
            dynamics,
            trajectory,
            threshold=float(10.0 ** rng.uniform(0.3, 2)),
            mesh=rp.Mesh(dt=step),
            return_time="shortest" if rng.random() < 0.3 else float(rng.uniform(0.1, 1.0)),
            ramp_down=float(rng.uniform(0.01, 0.2)),
        )
    elif planner == 1:
        plan = rp.plan_stepwise(
            dynamics, trajectory, mesh=rp.Mesh(dt=step), limits=limits, anticipate=bool(rng.random() < 0.5)
        )
    else:
        plan = rp.plan_whole_trajectory(
            dynamics,
            trajectory,
            mesh=rp.Mesh(dt=step, refinements=int(rng.choice([0, 3]))),
            limits=limits,
            solver=rp.Solver(seconds=15.0),
            objective=str(rng.choice(["effort", "peak"])),
            end=str(rng.choice(["datum", "free", "rest"])),
        )
    return plan, robot, second(robot)


def dense_times(plan: Plan) -> Array:
    """Return times inside all steps of a plan, none of them on a sample."""
    t = np.unique(plan.t)
    fraction = (np.arange(FINER) + 0.5) / FINER
    return np.asarray((t[:-1, None] + fraction * np.diff(t)[:, None]).ravel())


def broken_promise(plan: Plan, robot: Robot, other: Dynamics) -> str | None:
    """Return which promise a plan breaks that says it is within its limits; None for every other plan."""
    if plan.status not in (ResultStatus.OK, ResultStatus.NOT_CONVERGED):
        return None
    if not np.isfinite(plan.tau).all():
        return "promise: efforts are finite at the samples"
    at_samples = other.along(plan.motion).reduce(plan.carriers)
    size = max(float(np.abs(at_samples.f / at_samples.row_scale).max()), 1e-9)
    imbalance = np.linalg.norm(
        (np.einsum("nij,nj->ni", at_samples.W, plan.tau) - at_samples.f) / at_samples.row_scale, axis=1
    )
    if imbalance.max() > BALANCED * size:
        return f"promise: W tau = f at the samples: off by {imbalance.max() / size:.2g} of the largest f"
    times = dense_times(plan)
    carriers = plan.carriers_at(times)
    for i, limit in enumerate(plan.limits.judged_by.of_carriers):
        span = ROUNDING * max(limit.upper - limit.lower, 1e-3)
        over = max(float((carriers.s[:, i] - limit.upper).max()), float((limit.lower - carriers.s[:, i]).max()))
        if over > span:
            return f"promise: the track between the samples: beyond it by {over:.2g} m ({plan.planner})"
        for word, values, most in (
            ("speed", carriers.sd, limit.speed),
            ("acceleration", carriers.sdd, limit.acceleration),
        ):
            largest = float(np.abs(values[:, i]).max())
            if largest > most * (1.0 + ROUNDING):
                return f"promise: the {word} between the samples: {largest / most:.4g} of its limit ({plan.planner})"
    dense = other.along(plan.platform_at(times)).reduce(carriers)
    for i, limit in enumerate(plan.limits.judged_by.of_carriers):
        use = float(np.abs(dense.carrier_force[:, i]).max()) / limit.force
        if use > ALLOWED:
            return f"promise: the carrier's force between the samples: {use:.4g} of its limit ({plan.planner})"
    efforts = np.abs(plan.functions.efforts(dense))
    reported = float(plan.peak_effort.max())
    finite = np.isfinite(efforts).all(axis=1)
    if not finite.all():
        return f"promise: efforts are finite between the samples ({plan.planner})"
    largest = float(efforts.max())
    if largest > ALLOWED * reported + ROUNDING * size:
        return (
            f"promise: the stated peak effort: {largest:.4g} between the samples, not {reported:.4g} ({plan.planner})"
        )
    return None


def try_problem(number: int) -> forked.Outcome:
    """Solve a random problem in a process of its own and judge the plan."""

    def action(folder: Path) -> str | None:
        return broken_promise(*solved(number))

    return forked.run(action, {}, PATIENCE, seconds=float("inf"))


def warm() -> None:
    """Load once, before any fork, what all problems share."""
    for name in ROBOTS:
        random_robot(name, np.random.default_rng(0))
        zoo.robot_of(name)


def main() -> None:
    """Try as many problems as the first argument says."""
    count, first = (int(text) for text in (*sys.argv[1:], *("50", "0")[len(sys.argv) - 1 :]))
    warm()
    counts: Counter[str] = Counter()
    for number in range(first, first + count):
        outcome = try_problem(number)
        counts[outcome.verdict] += 1
        if outcome.verdict == forked.WRONG:
            counts[outcome.reason] += 1
            forked.show(f"{number}: {outcome.reason} | {outcome.seconds:.1f} s | {outcome.text!r}")
        elif outcome.verdict == forked.REFUSED:
            counts["refused: " + outcome.text[:25]] += 1
    for reason, times in counts.most_common(30):
        forked.show(f"{times:5} {reason}")


if __name__ == "__main__":
    main()
