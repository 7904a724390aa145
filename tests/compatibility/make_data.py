"""How ``data/`` was made: run once, by version 0.1.0, and kept as a record. No test runs it.

Run anew it would record what the package does now, which is not what it promised then. To pin something new, record
that alone. From the top of the repository: ``PYTHONPATH=.:tests python tests/compatibility/make_data.py``.
"""

from __future__ import annotations

import json
import os
import tempfile
from pathlib import Path
from typing import Any

from command_line import call, write_motion
from compatibility_cases import BACKENDS, COMMANDS, DATA, EFFORTS, PLANS, REPLAYS, REPRODUCE, simulated
from interfaces import PLACES, describe, documented_imports, headline_table, place, public_names, results, structure
from interfaces import thing as named

from redundancy_pin.trajectory import reference


def make() -> None:
    """Write every file of ``data/``."""
    DATA.mkdir(exist_ok=True)
    for name, plan in PLANS.items():
        plan().save(DATA / f"{name}.npz")
    for name, replay in REPLAYS.items():
        simulated(replay).save(DATA / f"{name}.npz")
    write_motion(DATA / "motion.csv", reference.circle(speed=0.5), 0.05, carriers=2)
    for backend in BACKENDS:
        call(*EFFORTS, "--backend", backend, "--motion", DATA / "motion.csv", "--out", DATA / f"efforts-{backend}.csv")
    modules = {name: place(name) for name in PLACES}
    names = {
        name: {entry: describe(named(module, entry)) for entry in public_names(module)}
        for name, module in modules.items()
    }
    write("public_api.json", {"names": names, "results": results()})
    write("documented_imports.json", documented_imports())
    write("headline.json", headline_table())
    write("command_line.json", {**commands(), REPRODUCE: small_job()})


def commands() -> dict[str, Any]:
    """Return keys and types of the JSON that each command prints."""
    rows = {}
    for name, command in COMMANDS.items():
        with tempfile.TemporaryDirectory() as folder:
            os.chdir(folder)
            for source, copy in (("motion.csv", "motion.csv"), ("whole-line.npz", "plan.npz")):
                Path(copy).write_bytes((DATA / source).read_bytes())
            result = call(*command.arguments, "--json")
            os.chdir(DATA)
            assert result.exit_code == command.code, (name, result.exit_code, result.stderr)
            rows[name] = structure(json.loads(result.stdout))
    return rows


def small_job() -> Any:
    """Return the keys of ``summary.json``, which ``reproduce --json`` prints: from a job with little of everything."""
    from redundancy_pin.studies.cases import BY_NAME, QUICK
    from redundancy_pin.studies.reproduce import reproduce

    small = [BY_NAME[name] for name in ("circle-0.5-parked", "corner-r0.025-baseline")]
    with tempfile.TemporaryDirectory() as folder:
        job = reproduce(Path(folder) / "results", small, extent=QUICK, samples=4)
        return structure(json.loads(json.dumps(job.summary)))


def write(name: str, data: Any) -> None:
    """Write JSON as it is reviewed: a line a value."""
    (DATA / name).write_text(json.dumps(data, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    make()
