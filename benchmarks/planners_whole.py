"""The whole-trajectory planner: time of a plan against two plain ways to it, and its growth with the nodes.

Both yardsticks are IPOPT through casadi with casadi's own derivatives. One is given the coefficients, with limits at
the nodes only: the same programme without the rows that hold between nodes, at the settings the planner had before it
was tuned. The other is given the mechanism's equations of motion as symbolic expressions (that of the tests). Times are
of setting up and solving; reading the coefficients off the backend is reported beside them.
"""

import statistics
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "support"))
import numpy as np
import symbolic_mechanisms
import symbolic_plans

import redundancy_pin as rp
from redundancy_pin.planners.optimal.mesh import grid_of
from redundancy_pin.planners.optimal.nlp import solve_nlp
from redundancy_pin.planners.optimal.problem import Task, read_problem
from redundancy_pin.planners.optimal.settings import checked_settings
from redundancy_pin.planners.optimal.solve import solve
from redundancy_pin.planners.optimal.transcription import transcribe
from redundancy_pin.planners.options import Mesh, Objective, Solver
from redundancy_pin.trajectory.continuous_motion import as_motion

REPEATS = 5
FULL_REPEATS = 3
NODES = 280
SAME = 1e-6
SAME_FULL = 1e-3
FULL_TARGET = 50
GROWTH = 1.5
"""Most by which the time a node may grow from 1000 to 10 000 nodes."""
LIMITS = {"speed": 1.0, "track": 1.0, "acceleration": 7.0}


def seconds(action):
    start = time.perf_counter()
    result = action()
    return time.perf_counter() - start, result


def problem_of(trajectory, nodes, objective):
    robot = rp.load_robot("3rrr")
    settings = checked_settings(
        robot, Objective(objective), mesh=Mesh(trajectory.duration / nodes, 0), solver=Solver(seconds=600.0)
    )
    source = as_motion(trajectory)
    grid = grid_of(source, [], settings.dt)
    task = Task(rp.VirtualWork(robot), source, settings)
    return seconds(lambda: read_problem(task, grid)[0])


def paired(slow, fast, repeats):
    """Times of both, in turn, and the last results."""
    times, expected, got = [], None, None
    for _ in range(repeats):
        b, got = seconds(fast)
        a, expected = seconds(slow)
        times.append((a, b))
    slow_times, fast_times = zip(*times, strict=True)
    figures = {
        "ratio": statistics.median(a / b for a, b in times),
        "slow_seconds": statistics.median(slow_times),
        "fast_seconds": statistics.median(fast_times),
    }
    return figures, expected, got


def report(what, problem, figures, target, difference, allowed, extra):
    if not difference <= allowed:
        raise RuntimeError(f"{what}: optima differ by {difference:.1e}")
    row = {"what": what, "nodes": len(problem.grid.t), **figures, "target": target, "relative_difference": difference}
    print(
        f"{what}: {row['ratio']:.1f} times faster (target {target}); {row['slow_seconds']:.3f} -> "
        f"{row['fast_seconds']:.3f} s at {row['nodes']} nodes; optima differ by {difference:.1e}"
    )
    return {**row, **extra}


def compared(radius, objective):
    trajectory = rp.trajectory.reference.corner(radius)
    prepared, problem = problem_of(trajectory, NODES, objective)

    def ours():
        optimum = solve(problem, {}, 600.0)
        if not optimum.optimal:
            raise RuntimeError(f"corner {radius} {objective}: {optimum.message}")
        return optimum

    def coefficients():
        return solve_nlp(
            transcribe(problem, between=np.zeros(len(problem.grid.h), dtype=bool), limit_force=False), {}, 600.0
        )

    ours()
    extra = {"reading_coefficients_seconds": prepared}
    name = f"whole-trajectory plan of the corner, r = {radius}, {objective}"
    figures, expected, got = paired(coefficients, ours, REPEATS)
    difference = abs(got.cost - expected.cost) / abs(expected.cost)
    what = f"{name}, against IPOPT on the coefficients at the nodes"
    yield report(what, problem, figures, 1, difference, SAME, {**extra, "slow_solver_seconds": expected.seconds})

    plan = rp.plan_whole_trajectory(
        rp.VirtualWork(rp.load_robot("3rrr")),
        trajectory,
        objective=objective,
        mesh=rp.Mesh(dt=trajectory.duration / NODES, refinements=0),
    )
    # a fresh mechanism each time, as a plan of another machine would need
    figures, (expected, _), _ = paired(
        lambda: symbolic_plans.solve(symbolic_mechanisms.three_rrr(), trajectory, plan, objective, LIMITS),
        ours,
        FULL_REPEATS,
    )
    difference = abs(plan.diagnostics["objective"][objective] - expected) / expected
    what = f"{name}, against IPOPT on the full model"
    yield report(what, problem, figures, FULL_TARGET, difference, SAME_FULL, extra)


def growth(objective):
    times = {}
    for nodes in (1000, 10_000):
        prepared, problem = problem_of(rp.trajectory.reference.square(), nodes, objective)
        # one long run each: time of the processor, which other work on the machine lengthens less
        began = time.process_time()
        optimum = solve(problem, {}, 600.0)
        solved = time.process_time() - began
        if not optimum.optimal:
            raise RuntimeError(f"square at {nodes} nodes, {objective}: {optimum.message}")
        times[nodes] = {"prepare": prepared, "solve": solved, "iterations": optimum.iterations}
    a_step = [1e6 * times[n]["solve"] / n / times[n]["iterations"] for n in times]
    row = {
        "what": f"growth of a whole-trajectory plan of the square with its nodes, {objective}",
        "growth_of_time_a_node_and_iteration": a_step[1] / a_step[0],
        "growth_of_time_a_node": times[10_000]["solve"] / times[1000]["solve"] / 10.0,
        "target": GROWTH,
        "seconds": times,
    }
    print(
        f"{row['what']}: {times[1000]['solve']:.2f} s at 1000 nodes, {times[10_000]['solve']:.2f} s at 10 000; "
        f"{a_step[0]:.1f} and {a_step[1]:.1f} us a node and iteration, {times[1000]['iterations']} and "
        f"{times[10_000]['iterations']} iterations"
    )
    return row


def turning(objective):
    """Processor time of plans with carriers that turn, and with those that slide."""
    cases = {
        "2rpr": rp.trajectory.reference.circle(0.5, 0.2, 0.05),
        "3rrr": rp.trajectory.reference.corner(0.025),
    }
    for name, trajectory in cases.items():
        arms = rp.CompiledDynamics(rp.load_robot(name, arm_length=0.15))
        tracks = rp.CompiledDynamics(rp.load_robot(name))

        def planned(dynamics, trajectory=trajectory):
            began = time.process_time()
            rp.plan_whole_trajectory(dynamics, trajectory, objective=objective)
            return time.process_time() - began

        planned(arms)  # the kernels are compiled
        ours, sliding = planned(arms), planned(tracks)
        what = f"whole-trajectory plan with turning carriers, {name}, {objective}"
        print(f"{what}: {ours:.2f} s (target 2), sliding ones {sliding:.2f} s")
        yield {
            "what": what,
            "seconds": ours,
            "target": 2.0,
            "sliding_seconds": sliding,
        }


def rows():
    """The corner of the thesis at 280 nodes, its square at 1000 and 10 000, and carriers that turn."""
    cases = [(radius, objective) for objective in ("effort", "peak") for radius in (0.025, 0.013)]
    return [
        *(row for case in cases for row in compared(*case)),
        growth("effort"),
        growth("peak"),
        *turning("effort"),
        *turning("peak"),
    ]


if __name__ == "__main__":
    rows()
