"""Planners beyond the thesis, each against another way to the same result. ``run.py`` calls ``rows()``.

Times are of the processor, medians of pairs taken in turn.
"""

import statistics
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
import path_timing

import redundancy_pin as rp
from redundancy_pin.planners.optimal.co_design import DesignTask, Search
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.trajectory import reference

REPEATS = 3
EFFORT = 3.03
WIDE = {"track": (-1.0, 1.0), "speed": 5.0, "acceleration": 20.0}
MODE = {"working_mode": (1, 1, 1)}
CENTRE = (0.866, 0.5, 0.0)
MOST = 2.0
"""Processor seconds of a plan."""
STEP = 1e-3
"""Relative, of the masses and lengths of differences."""


def seconds(action):
    start = time.process_time()
    result = action()
    return time.process_time() - start, result


def compared(what, slow, fast, target, difference):
    """A row: time of the slow way over that of the fast one; ``difference`` is of both results."""
    fast()
    times, expected, result = [], None, None
    for _ in range(REPEATS):
        b, result = seconds(fast)
        a, expected = seconds(slow)
        times.append((a, b))
    row = {
        "what": what,
        "ratio": statistics.median(a / b for a, b in times),
        "target": target,
        "slow_seconds": statistics.median(a for a, _ in times),
        "fast_seconds": statistics.median(b for _, b in times),
        "relative_difference": float(difference(expected, result)),
    }
    print(
        f"{what}: {row['ratio']:.2f} (target {target:g}); {row['slow_seconds']:.2f} -> {row['fast_seconds']:.2f} s; "
        f"results differ by {row['relative_difference']:.1e}"
    )
    return row


def least_time():
    """Without carriers against toppra; with them."""
    bare, path = rp.VirtualWork(rp.load_robot("3rrr", carriers=False, **MODE)), reference.corner().path
    carrying = rp.VirtualWork(rp.load_robot("3rrr", carrier_mass=3.0, **MODE))

    def alone():
        return rp.plan_time_optimal(bare, path, limits=rp.Limits(effort=EFFORT)).t[-1]

    yield compared(
        "least time round the corner, no carriers, against toppra on 400 steps",
        lambda: path_timing.least_time(bare, path, EFFORT),
        alone,
        1.0,
        lambda theirs, ours: abs(ours / theirs - 1.0),
    )
    spent = statistics.median(
        seconds(
            lambda: rp.plan_time_optimal(carrying, path, **in_groups(rp.plan_time_optimal, dict(effort=EFFORT, **WIDE)))
        )[0]
        for _ in range(REPEATS)
    )
    what = "least time round the corner, carriers parked at both ends"
    print(f"{what}: {spent:.2f} s (target {MOST:g})")
    yield {"what": what, "seconds": spent, "target": MOST}


def base_wrench():
    """Least wrench on the base against least effort."""
    dynamics, corner = rp.VirtualWork(rp.load_robot("3rrr", carrier_mass=3.0, **MODE)), reference.corner()

    def plan(objective):
        return rp.plan_whole_trajectory(
            dynamics,
            corner,
            end="free",
            **in_groups(rp.plan_whole_trajectory, dict(objective=objective, base_point=CENTRE, dt=0.01, **WIDE)),
        )

    yield compared(
        "whole-trajectory plan of the corner, least effort over effort with base wrench",
        lambda: plan("effort"),
        lambda: plan({"effort": 1.0, "base_wrench": 1.0}),
        0.5,
        lambda *_: 0.0,
    )


def gradients():
    """Slopes of least costs by three numbers of a robot, against plans made anew."""
    circle = reference.circle(speed=0.5, ramp_time=0.2, ramp_length=0.05)
    fixed = rp.Mesh(dt=0.02, refinements=0)
    options = {"objective": "effort", "limits": rp.Limits(acceleration=20.0), "mesh": fixed}
    least = {**options, "objective": rp.Objective("effort", calm=0.0)}

    def effort(robot):
        plan = rp.plan_whole_trajectory(rp.VirtualWork(robot), circle, **least)
        return plan.diagnostics["objective"]["effort"]

    yield slopes_compared(
        "slopes of a least cost by three numbers of the 2-RPR",
        DesignTask(rp.VirtualWork(rp.load_robot("2rpr", end_effector_mass=0.5)), circle, options),
        ("carrier_mass", "track_offset", "end_effector_mass"),
        effort,
    )
    line = rp.trajectory.Line([0.1, 0.0, -0.5], [-0.1, 0.1, -0.45])
    fastest = {"limits": rp.Limits(effort=30.0), "mesh": rp.Mesh(steps=100, refinements=0)}
    yield slopes_compared(
        "slopes of a least time by three numbers of the delta robot",
        DesignTask(rp.load_robot("delta"), line, {"objective": "time", **fastest}),
        ("arm_length", "rod_length", "platform_mass"),
        lambda robot: rp.plan_time_optimal(robot, line, **fastest).t[-1],
    )


def slopes_compared(what, task, names, value):
    """A row: slopes of a task's least cost by numbers of its robot; ``value`` is the least cost of another robot."""
    robot = task.dynamics.robot
    at = {name: float(robot.parameters[name]) for name in names}

    def differences():
        slopes = []
        for name in names:
            ends = [value(rp.with_parameters(robot, **{name: at[name] * (1.0 + sign * STEP)})) for sign in (1, -1)]
            slopes.append((ends[0] - ends[1]) / (2.0 * at[name] * STEP))
        return np.array(slopes)

    search = Search([task], {name: (0.5 * at[name], 2.0 * at[name]) for name in names})
    return compared(
        f"{what}, plans made anew over multipliers and exact derivatives",
        differences,
        lambda: search.machine(search.start).gradients[0],
        1.0,
        lambda theirs, ours: np.abs(ours - theirs).max() / np.abs(theirs).max(),
    )


def rows():
    """Least time, base wrench, co-design."""
    return [*least_time(), *base_wrench(), *gradients()]


if __name__ == "__main__":
    rows()
