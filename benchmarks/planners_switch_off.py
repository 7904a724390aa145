"""Benchmark of the switch-off planner: duration of the motion over planning time. run.py calls ``rows()``."""

import statistics
import time

import redundancy_pin as rp
from redundancy_pin.planners.switch_off.planner import plan_switch_off
from redundancy_pin.trajectory import reference

REPEATS = 5
TARGET = 1.0
"""A plan takes less time than the motion."""


def rows():
    """Return a row for each backend and way of planning: duration of the motion over the time its plan takes."""
    robot, trajectory = rp.load_robot("2rpr"), reference.circle()
    sampled = trajectory.sample(1e-3)
    cases = (
        ("circle, CN 5", trajectory, {"threshold": 5.0}),
        ("circle, CN 20, shortest return", trajectory, {"threshold": 20.0, "return_time": "shortest"}),
        ("circle sampled at 1 ms, CN 5", sampled, {"threshold": 5.0}),
    )
    records = []
    for backend, dynamics in (("RNEA", rp.RneaDynamics(robot)), ("virtual work", rp.VirtualWork(robot))):
        for name, motion, settings in cases:
            times = []
            for _ in range(REPEATS):
                start = time.perf_counter()
                plan_switch_off(dynamics, motion, **settings)
                times.append(time.perf_counter() - start)
            ratios = [trajectory.duration / seconds for seconds in times]
            row = {
                "what": f"switch-off plan, {name}, {backend}: duration of the motion over planning time",
                "ratio": statistics.median(ratios),
                "ratio_min": min(ratios),
                "ratio_max": max(ratios),
                "target": TARGET,
                "seconds": statistics.median(times),
            }
            print(f"{row['what']}: {row['ratio']:.0f} (target {TARGET:g}); {1e3 * row['seconds']:.0f} ms a plan")
            records.append(row)
    return records


if __name__ == "__main__":
    rows()
