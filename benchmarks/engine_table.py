"""Outside engines: errors of every motion (``make engines``), and speeds at one tolerance (``make bench``).

    python benchmarks/engine_table.py                 the tables of docs/engines.md, as markdown
    python benchmarks/engine_table.py --json FILE     the same numbers as JSON too

Wall times are those of the integration alone: no building of models, no judging. Each number of a speed is the median
of five runs, all contestants in turn, so that a machine whose pace drifts moves all of them. Every contestant has its
cheapest setting that reaches the tolerance: an engine the longest step of a ladder, with steps that end at every node
of the plan or reach across; ``simulate`` the quickest combination of integrator, tolerance and restarts, its
steps being compiled (``CompiledDynamics``).
"""

import argparse
import importlib.util
import itertools
import json
import statistics
from pathlib import Path

import numpy as np
from engines import (
    Task,
    deviation,
    open_loop_growth,
    run_exudyn,
    run_mujoco,
    run_own,
)
from engines.cases import CASES, CORNER, prepare
from engines.own import TaskEfforts

import redundancy_pin as rp
from redundancy_pin.status import ResultStatus

TOLERANCE = 1e-5
"""m and rad, over the whole motion."""

TOLERANCES = (1e-3, 1e-4, TOLERANCE, 1e-6, 1e-7, 1e-8)
"""m and rad: from what a picture needs to where order counts."""

STEPS = (1e-3, 1.25e-4)
"""s: what a user would take first, and what meets the tolerance on every motion."""

LOADED = next(case for case in CASES if case.name == "3-RRR turn while moving")
"""Through a type II pose, where the closures carry most."""

LADDER = tuple(32e-3 / 2 ** (i / 2) for i in range(23))
"""Steps of engines, s."""

RTOLS = tuple(10.0 ** (-i / 2) for i in range(6, 23))
"""Relative tolerances of ``simulate``, 1e-3 to 1e-11; absolute ones are a tenth of them."""

SAMPLES = 0.02
"""Interval of the samples of ``simulate``, s."""

FINALISTS = 8
REPEATS = 5
ENGINES = {"exudyn": run_exudyn, "mujoco": run_mujoco}


def installed():
    available = {name: run for name, run in ENGINES.items() if importlib.util.find_spec(name) is not None}
    for name in ENGINES.keys() - available.keys():
        print(f"{name} is left out: it is not installed (pip install 'redundancy_pin[engines]').")
    return available


def measured(case, drive, run):
    off = deviation(drive, run)
    return {
        "case": case.name,
        "crossings": case.crossings,
        "duration": drive.task.duration,
        "engine": run.engine,
        "version": run.version,
        "step": run.settings["step"],
        "status": run.status.value,
        "platform": float(off.platform.max()),
        "turn": float(off.turn.max()),
        "carriers": float(off.carriers.max(initial=0.0)),
        "gap": float(off.gap.max()),
        "seconds": run.seconds,
        "met": run.status == ResultStatus.OK and off.largest < TOLERANCE,
    }


def errors(engines, backend=rp.RneaDynamics):
    """Every motion in every engine, at two steps."""
    print("| motion | crossings | engine | step, ms | platform, m | rotation, rad | carriers, m | gap, m | wall, s |")
    print("|---|---|---|---|---|---|---|---|---|")
    rows = []
    for case in CASES:
        drive = prepare(case, backend)
        for name, run in engines.items():
            for step in STEPS if name != "mujoco" or case.mujoco else ():
                row = measured(case, drive, run(drive.task, step=step))
                rows.append(row)
                print(
                    f"| {case.name}, {row['duration']:.1f} s | {case.crossings} | {name} | {1e3 * step:g} | "
                    f"{row['platform']:.1e} | {row['turn']:.1e} | {row['carriers']:.1e} | {row['gap']:.0e} | "
                    f"{row['seconds']:.1f} |",
                    flush=True,
                )
    print()
    return rows


def softness(case=LOADED, step=1.25e-4):
    """What the softness of MuJoCo's constraints costs, the step being small."""
    drive = prepare(case, rp.RneaDynamics)
    print(f"{case.name} in MuJoCo, steps of {1e3 * step:g} ms:\n")
    print("| integrator | time constant, ms | impedance | platform, m | rotation, rad | carriers, m | gap, m |")
    print("|---|---|---|---|---|---|---|")
    rows = []
    settings = [("RK4", c, 0.9999) for c in (2 * step, 1e-3, 5e-3, 2e-2)]
    settings += [
        ("RK4", 2 * step, 0.95),
        ("RK4", 2e-2, 0.95),
        ("implicitfast", 2 * step, 0.9999),
        ("Euler", 2e-2, 0.95),
    ]
    for integrator, constant, impedance in settings:
        run = run_mujoco(drive.task, step=step, time_constant=constant, impedance=impedance, integrator=integrator)
        row = measured(case, drive, run) | {
            "integrator": integrator,
            "time_constant": constant,
            "impedance": impedance,
        }
        rows.append(row)
        print(
            f"| {integrator} | {1e3 * constant:g} | {impedance} | {row['platform']:.1e} | {row['turn']:.1e} | "
            f"{row['carriers']:.1e} | {row['gap']:.0e} |"
        )
    print()
    return rows


def growth(run, step=1e-3):
    """How an error at the start grows on each motion, per that of a free body."""
    print("| motion | duration T, s | largest growth, s | over T |")
    print("|---|---|---|---|")
    rows = []
    for case in CASES:
        drive = prepare(case, rp.RneaDynamics)
        _, grown = open_loop_growth(drive.task, lambda task: run(task, step=step))
        rows.append({"case": case.name, "duration": drive.task.duration, "growth": float(grown.max())})
        print(
            f"| {case.name} | {drive.task.duration:.2f} | {grown.max():.2g} | {grown.max() / drive.task.duration:.1f} |"
        )
    print()
    return rows


def within(drive, run, tolerance):
    return run.status == ResultStatus.OK and deviation(drive, run).largest < tolerance


def tasks(drive):
    """Return the task of a drive with steps that end at every node of the plan, and at jumps of the efforts only."""
    task = drive.task
    jumps = TaskEfforts(task).jumps
    across = Task(task.robot, task.start, task.end, task.q, task.v, task.efforts, jumps)
    return {"breaks": task, "jumps": across}


def longest_steps(drive, run, tolerance):
    """Return the setting of an engine with fewest steps that is within the tolerance, or None."""
    best, most = None, np.inf
    for where, task in tasks(drive).items():
        for step in LADDER:
            reached = run(task, step=step)
            if reached.steps >= most:
                break  # no better than the other
            if within(drive, reached, tolerance):
                best, most = {"restart_at": where, "step": step}, reached.steps
                break
    return best


def cheapest(drive, tolerance, dynamics):
    """Return the setting of ``simulate`` that takes least time to be within the tolerance."""
    records = []
    for integrator, restart_at in itertools.product(("RK45", "DOP853"), ("jumps", "breaks")):
        for rtol in RTOLS:
            setting = {"integrator": integrator, "restart_at": restart_at, "rtol": rtol, "atol": rtol / 10}
            run = run_own(drive.task, dt=SAMPLES, dynamics=dynamics, **setting)
            if within(drive, run, tolerance):
                records.append((run.seconds, len(records), setting))
                if restart_at == "breaks":  # one step for each step of the plan, and tighter ones cost as much or more
                    break
    finalists = [setting for _, _, setting in sorted(records)[:FINALISTS]]
    times = [
        [run_own(drive.task, dt=SAMPLES, dynamics=dynamics, **setting).seconds for setting in finalists]
        for _ in range(REPEATS)
    ]
    medians = [statistics.median(column) for column in zip(*times, strict=True)]
    return finalists[medians.index(min(medians))]


def speeds(case=CORNER, tolerance=TOLERANCE):
    """Simulated time per wall time at one tolerance, for every engine and for ``simulate``.

    Args:
        case: the motion.
        tolerance: largest error of platform and carriers over the motion, m and rad.
    """
    drive = prepare(case, rp.RneaDynamics)
    dynamics = rp.CompiledDynamics(drive.task.robot)
    own = cheapest(drive, tolerance, dynamics)
    contestants = {"redundancy_pin": (lambda: run_own(drive.task, dt=SAMPLES, dynamics=dynamics, **own), own)}
    for name, run in installed().items():
        setting = longest_steps(drive, run, tolerance)
        if setting is None:
            print(f"{name} does not reach {tolerance:g} on {case.name} with steps down to {LADDER[-1]:g} s.")
        else:
            task, step = tasks(drive)[setting["restart_at"]], setting["step"]
            contestants[name] = (lambda run=run, task=task, step=step: run(task, step=step), setting)
    wall = {name: [] for name in contestants}
    last = {}
    for _ in range(REPEATS):
        for name, (go, _) in contestants.items():
            last[name] = go()
            wall[name].append(last[name].seconds)
    rows = []
    for name, (_, setting) in contestants.items():
        row = {
            "what": f"forward dynamics of the {case.name}, {tolerance:g} m, {name}",
            "version": last[name].version,
            "simulated_per_wall": drive.task.duration / statistics.median(wall[name]),
            "steps": last[name].steps,
            "error": deviation(drive, last[name]).largest,
            **setting,
        }
        if "step" in row:
            row["step"] = setting["step"] = last[name].settings["step"]  # as cut at the breaks
        faster = ""
        if name != "redundancy_pin":
            ratios = [theirs / ours for theirs, ours in zip(wall[name], wall["redundancy_pin"], strict=True)]
            row["ours_faster_by"] = statistics.median(ratios)
            faster = f"; ours is {row['ours_faster_by']:.2g} times as fast"
        rows.append(row)
        told = ", ".join(
            f"{key} {value:.3g}" if isinstance(value, float) else str(value) for key, value in setting.items()
        )
        print(
            f"{row['what']}: {row['simulated_per_wall']:.1f} s a second, {row['steps']} steps ({told}), error "
            f"{row['error']:.1e}{faster}",
            flush=True,
        )
    return rows


def rows():
    """What ``make bench`` adds of the engines: speeds at every tolerance."""
    return [row for tolerance in TOLERANCES for row in speeds(tolerance=tolerance)]


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="file for the numbers")
    path = parser.parse_args().json
    engines = installed()
    facts = {"errors": errors(engines)}
    missed = [f"{row['case']} in {row['engine']}" for row in facts["errors"] if row["step"] < 2e-4 and not row["met"]]
    if "mujoco" in engines:
        facts["softness"] = softness()
    if "exudyn" in engines:
        facts["growth"] = growth(run_exudyn)
    facts["speeds"] = rows()
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(facts, indent=2) + "\n")
    if missed:
        raise SystemExit(f"Off by more than {TOLERANCE:g} m: {'; '.join(missed)}.")


if __name__ == "__main__":
    main()
