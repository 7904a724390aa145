"""The whole-trajectory planner: time of a plan against IPOPT with automatic derivatives, and its growth with the nodes.

The yardstick solves the same programme, of the same coefficients, by the same solver with the same settings; only its
derivatives are casadi's own, of the expanded expressions. Times are of setting up and solving; the model is the same
for both.
"""

import statistics
import time

import redundancy_pin as rp
from redundancy_pin.planners.continuous_motion import continuous_motion
from redundancy_pin.planners.whole_trajectory_grid import grid_of
from redundancy_pin.planners.whole_trajectory_nlp import build
from redundancy_pin.planners.whole_trajectory_prepare import Task, prepare
from redundancy_pin.planners.whole_trajectory_settings import checked_settings
from redundancy_pin.planners.whole_trajectory_solver import Solver

REPEATS = 5
NODES = 280
SAME = 1e-6
GROWTH = 1.5
"""Most by which the time a node may grow from 1000 to 10 000 nodes."""


def seconds(action):
    start = time.perf_counter()
    result = action()
    return time.perf_counter() - start, result


class Automatic:
    """A programme whose derivatives the solver finds by itself."""

    def __init__(self, program):
        self._program = program

    def __getattr__(self, name):
        return getattr(self._program, name)

    def functions(self):
        return self._program.functions()[0], {}


def problem_of(trajectory, nodes, objective):
    robot = rp.load_robot("3rrr")
    settings = checked_settings(
        robot,
        objective=objective,
        lam=0.0,
        baseline=False,
        start=None,
        start_speed=0.0,
        end="datum",
        datum=0.0,
        track=None,
        speed=None,
        acceleration=None,
        jerk=None,
        effort=None,
        carrier_force=None,
        dt=trajectory.duration / nodes,
        starts=1,
        seconds=600.0,
        refinements=0,
    )
    source = continuous_motion(trajectory)
    grid = grid_of(source, [], settings.dt)
    task = Task(rp.VirtualWork(robot), source, settings, None)
    took, problem = seconds(lambda: prepare(task, grid))
    return took, problem


def compared(radius, objective):
    _, problem = problem_of(rp.trajectory.reference.corner(radius), NODES, objective)
    ours = lambda: Solver(build(problem), 600.0).solve({})  # noqa: E731
    theirs = lambda: Solver(Automatic(build(problem)), 600.0, {"expand": True}).solve({})  # noqa: E731
    fast, slow = [], []
    for _ in range(REPEATS):
        b, got = seconds(ours)
        a, expected = seconds(theirs)
        fast.append(b)
        slow.append(a)
    difference = abs(got.cost - expected.cost) / abs(expected.cost)
    if not (got.optimal and difference <= SAME):
        raise RuntimeError(f"corner {radius} {objective}: optima differ by {difference:.1e}")
    row = {
        "what": f"whole-trajectory plan of the corner, r = {radius}, {objective}, against automatic derivatives",
        "nodes": len(problem.grid.t),
        "ratio": statistics.median(a / b for a, b in zip(slow, fast, strict=True)),
        "target": 1,
        "slow_seconds": statistics.median(slow),
        "fast_seconds": statistics.median(fast),
        "relative_difference": difference,
    }
    print(
        f"{row['what']}: {row['ratio']:.1f} times faster; {row['slow_seconds']:.3f} -> {row['fast_seconds']:.3f} s at "
        f"{row['nodes']} nodes; optima differ by {difference:.1e}"
    )
    return row


def growth(objective):
    times = {}
    for nodes in (1000, 10_000):
        prepared, problem = problem_of(rp.trajectory.reference.square(), nodes, objective)
        solved, found = seconds(lambda problem=problem: Solver(build(problem), 600.0).solve({}))
        if not found.optimal:
            raise RuntimeError(f"square at {nodes} nodes, {objective}: {found.message}")
        times[nodes] = {"prepare": prepared, "solve": solved, "iterations": found.iterations}
    a_step = [1e6 * times[n]["solve"] / n / times[n]["iterations"] for n in times]
    row = {
        "what": f"growth of a whole-trajectory plan of the square with its nodes, {objective}",
        "growth_of_time_a_node_and_iteration": a_step[1] / a_step[0],
        "target": GROWTH,
        "seconds": times,
    }
    print(
        f"{row['what']}: {times[1000]['solve']:.2f} s at 1000 nodes, {times[10_000]['solve']:.2f} s at 10 000; "
        f"{a_step[0]:.1f} and {a_step[1]:.1f} us a node and iteration"
    )
    return row


def rows():
    """The corner of the thesis at 280 nodes, and its square at 1000 and 10 000."""
    found = [compared(radius, objective) for objective in ("effort", "peak") for radius in (0.025, 0.013)]
    return [*found, growth("effort")]


if __name__ == "__main__":
    rows()
