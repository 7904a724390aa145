"""Outside engines: errors of every motion, ``make engines``. Wall times are those of the integration alone.

python tests/oracles/engine_table.py                 the tables of docs/tables/engines.md, as markdown
python tests/oracles/engine_table.py --json FILE     the same numbers as JSON too
"""

import argparse
import importlib.util
import json
from pathlib import Path

from engines import (
    deviation,
    open_loop_growth,
    run_exudyn,
    run_mujoco,
)
from engines.cases import CASES, prepare

import redundancy_pin as rp
from redundancy_pin.status import ResultStatus

TOLERANCE = 1e-5
"""m and rad, over the whole motion."""

STEPS = (1e-3, 1.25e-4)
"""s: what a user would take first, and what meets the tolerance on every motion."""

LOADED = next(case for case in CASES if case.name == "3-RRR turn while moving")
"""Through a type II pose, where the closures carry most."""

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
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(facts, indent=2) + "\n")
    if missed:
        raise SystemExit(f"Off by more than {TOLERANCE:g} m: {'; '.join(missed)}.")


if __name__ == "__main__":
    main()
