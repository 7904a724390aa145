"""Outside engines: errors of every motion (``make engines``), and speeds at one tolerance (``make bench``).

    python benchmarks/engines.py                 the tables of docs/engines.md, as markdown
    python benchmarks/engines.py --json FILE     the same numbers as JSON too

Wall times of engines are those of the integration alone: no building of models, no judging. Each number of a speed is
the median of five runs, all contestants in turn, so that a machine whose pace drifts moves all of them.
"""

import argparse
import importlib.util
import json
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.simulation.engines import (
    Drive,
    EngineRun,
    RunStatus,
    deviation,
    open_loop_growth,
    run_exudyn,
    run_mujoco,
)
from redundancy_pin.simulation.engines.cases import CASES, CORNER, prepare

TOLERANCE = 1e-5
"""m and rad, over the whole motion."""

STEPS = (1e-3, 1.25e-4)
"""s: what a user would take first, and what meets the tolerance on every motion."""

LOADED = next(case for case in CASES if case.name == "3-RRR turn while moving")
"""Through a type II pose, where the closures carry most."""

LADDER = tuple(8e-3 / 2 ** (i / 2) for i in range(17))
REPEATS = 5
ENGINES = {"exudyn": run_exudyn, "mujoco": run_mujoco}

Simulate = Callable[[Drive, float], tuple[Array, Array, Array]]
"""From a drive, which has plan and task, and the tolerance to times (N,), platform coordinates (N, n) and carrier
positions (N, k)."""


def installed():
    found = {name: run for name, run in ENGINES.items() if importlib.util.find_spec(name) is not None}
    for name in ENGINES.keys() - found.keys():
        print(f"{name} is left out: it is not installed (pip install 'redundancy_pin[engines]').")
    return found


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
        "met": run.status == RunStatus.COMPLETED and off.largest < TOLERANCE,
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


def largest_step(drive, run, tolerance):
    """Return the first step of the ladder at which the motion is within the tolerance, or None."""
    for step in LADDER:
        found = run(drive.task, step=step)
        if found.status == RunStatus.COMPLETED and deviation(drive, found).largest < tolerance:
            return step
    return None


def speeds(simulate: Simulate | None = None, case=CORNER, tolerance=TOLERANCE):
    """Simulated time per wall time at one tolerance, for every engine and for ``simulate``.

    Args:
        simulate: a forward dynamics that takes a drive and a tolerance and returns times, platform and carriers.
        case: the motion.
        tolerance: largest error of platform and carriers over the motion, m and rad.
    """
    drive = prepare(case, rp.RneaDynamics)
    contestants: dict[str, Callable[[], float]] = {}
    notes: dict[str, dict[str, object]] = {}
    for name, run in installed().items():
        step = largest_step(drive, run, tolerance)
        if step is None:
            print(f"{name} does not reach {tolerance:g} on {case.name} with steps down to {LADDER[-1]:g} s.")
            continue
        reached = run(drive.task, step=step)
        notes[name] = {"step": reached.settings["step"], "error": deviation(drive, reached).largest}
        contestants[name] = lambda run=run, step=step: run(drive.task, step=step).seconds
    if simulate is not None:
        notes["redundancy_pin"] = {"error": own_error(drive, simulate(drive, tolerance))}

        def own():
            began = time.perf_counter()
            simulate(drive, tolerance)
            return time.perf_counter() - began

        contestants["redundancy_pin"] = own
    times: dict[str, list[float]] = {name: [] for name in contestants}
    for _ in range(REPEATS):
        for name, timed in contestants.items():
            times[name].append(timed())
    rows = []
    for name, wall in times.items():
        row = {
            "what": f"forward dynamics of the {case.name}, {tolerance:g} m, {name}",
            "simulated_per_wall": drive.task.duration / statistics.median(wall),
            **notes[name],
        }
        if simulate is not None and name != "redundancy_pin":
            ratios = [theirs / ours for theirs, ours in zip(wall, times["redundancy_pin"], strict=True)]
            row["ours_faster_by"] = statistics.median(ratios)
        rows.append(row)
        extra = f", steps of {1e3 * row['step']:g} ms" if "step" in row else ""
        faster = f"; ours is {row['ours_faster_by']:.1f} times as fast" if "ours_faster_by" in row else ""
        print(f"{row['what']}: {row['simulated_per_wall']:.1f} s a second{extra}, error {row['error']:.1e}{faster}")
    return rows


def own_error(drive, motion):
    """Return the largest error, m and rad, of times, platform coordinates and carrier positions."""
    t, x, s = (np.asarray(part) for part in motion)
    keep = np.append(np.diff(t) > 0.0, True)  # of an instant that stands twice, one
    t, x, s = t[keep], x[keep], s[keep]
    one = np.zeros((len(t), 0))
    run = EngineRun("own", "", {}, t, x, s, one, one, np.zeros(len(t)), len(t) - 1, 1.0, RunStatus.COMPLETED, "")
    return deviation(drive, run).largest


def rows(simulate: Simulate | None = None):
    """What ``make bench`` adds of the engines."""
    return speeds(simulate)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--json", type=Path, help="file for the numbers")
    path = parser.parse_args().json
    engines = installed()
    found = {"errors": errors(engines)}
    missed = [f"{row['case']} in {row['engine']}" for row in found["errors"] if row["step"] < 2e-4 and not row["met"]]
    if "mujoco" in engines:
        found["softness"] = softness()
    if "exudyn" in engines:
        found["growth"] = growth(run_exudyn)
    found["speeds"] = speeds()
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(found, indent=2) + "\n")
    if missed:
        raise SystemExit(f"Off by more than {TOLERANCE:g} m: {'; '.join(missed)}.")


if __name__ == "__main__":
    main()
