"""On-line planning on random paths: ticks by status, limits, peak against the least one known off line, time of a tick.

``python benchmarks/online.py [machine] [paths] [solver ...]``; machines: 2rpr, five_bar, 3rrr. Where solvers are named
they are compared on these paths. Off line is ``plan_whole_trajectory``, objective "peak", from the same start and free
at the end.
"""

import sys
import time

import numpy as np

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.receding_horizon import RecedingHorizon, run_online
from redundancy_pin.trajectory import SpeedProfile, Trajectory
from redundancy_pin.trajectory.waypoints import through_points

MASSES = {"2rpr": {"end_effector_mass": 0.5, "cylinder_mass": 0.3}}

REACH = {"five_bar": (0.35, 0.45), "3rrr": (0.1, 0.1, 1.2)}
"""Half the box around home in which points are drawn, m and rad."""

CALM = 20.0
"""Largest acceleration of a path, m/s²: a spline through random points has turns that no machine follows."""


def machine(name):
    return rp.CompiledDynamics(rp.load_robot(name, **MASSES.get(name, {})))


def over_and_over(number):
    """A path of the 2-RPR that goes round a point near the singular line: 0.24 to 0.79 m/s."""
    rng = np.random.default_rng([7, number])
    count = int(rng.integers(12, 18))
    angle = rng.uniform(0, 6.28) + rng.choice([-1, 1]) * np.cumsum(rng.uniform(0.8, 1.3, count))
    radius = rng.uniform(0.09, 0.2, count)
    centre = np.array([0.25, rng.uniform(-0.02, 0.02)])
    path = through_points(centre + np.c_[0.7 * radius * np.cos(angle), radius * np.sin(angle)])
    return Trajectory(path, SpeedProfile(path.length, min(rng.uniform(0.24, 0.79), 0.8 * path.length / 0.3), 0.3))


def random_paths(name, dynamics):
    """Give paths through type II poses, without end."""
    if name == "2rpr":
        yield from map(over_and_over, range(10**6))
    home, rng = dynamics.reference[1], np.random.default_rng(4)
    reach = np.array(REACH[name])
    while True:
        points = home + rng.uniform(-1.0, 1.0, (4, len(home))) * reach
        points[0] = home + 0.1 * rng.uniform(-1.0, 1.0, len(home)) * reach
        path = through_points(points)
        trajectory = Trajectory(path, SpeedProfile(path.length, min(0.5, 0.8 * path.length / 0.4), 0.4))
        motion = trajectory.sample_at(np.linspace(0.0, trajectory.duration, 200))
        reduced = dynamics.along(motion, unreachable="mark").reduce()
        if reduced.reachable.all() and np.abs(motion.xdd).max() < CALM:
            side = np.linalg.slogdet(reduced.W)[0]
            if (side[1:] != side[:-1]).any():
                yield trajectory


def off_line(dynamics, trajectory):
    """Return the least peak known, None where nothing keeps the limits."""
    try:
        plan = rp.plan_whole_trajectory(
            dynamics, trajectory, objective="peak", end="free", start=0.0, dt=0.02, refinements=1, seconds=20
        )
    except InfeasiblePlanError:
        return None
    return float(plan.peak_effort.max())


def main(name="2rpr", count=10, *solvers):
    dynamics, ratios, milliseconds = machine(name), [], []
    for number, trajectory in zip(range(int(count)), random_paths(name, dynamics)):  # noqa: B905
        for solver in solvers or ("piqp",):
            planner, began = RecedingHorizon(dynamics, solver=solver), time.process_time()
            try:
                run = run_online(planner, trajectory)
            except InfeasiblePlanError as error:
                print(f"{name} {number} {solver}: {error}")
                continue
            spent = 1e3 * (time.process_time() - began) / len(run.commands)
            best = None if solvers else off_line(dynamics, trajectory)
            ratio = np.nan if best is None else run.plan.peak_effort.max() / best
            ratios.append(ratio)
            milliseconds += [1e3 * command.seconds for command in run.commands[1:]]
            ticks = ", ".join(f"{n} {status}" for status, n in run.counts.items() if n)
            print(
                f"{name} {number} {solver}: {trajectory.duration:.2f} s, "
                f"{len(run.plan.diagnostics['singular_instants'])} crossings; {ticks}; {run.plan.status.value}; peak "
                f"{run.plan.peak_effort.max():.3g}, {ratio:.2f} times off line; {spent:.1f} ms of the processor a tick",
                flush=True,
            )
    p50, p99 = np.percentile(milliseconds, [50, 99])
    print(
        f"ratio {np.nanmedian(ratios):.2f} (median), {np.nanmax(ratios):.2f}; a tick {p50:.1f} ms p50, {p99:.1f} ms p99"
    )


if __name__ == "__main__":
    main(*sys.argv[1:])
