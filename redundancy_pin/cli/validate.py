"""``redundancy-pin validate``: the dynamics of a robot against physics, and backend against backend."""

from __future__ import annotations

import os
from typing import Any

import click

from redundancy_pin import crosscheck
from redundancy_pin.cli.errors import FAILED_CHECK, print_line
from redundancy_pin.cli.options import jobs_option, json_option, robots, settings_option, trust_option
from redundancy_pin.cli.output import console, print_json, progress
from redundancy_pin.parallel import require_jobs


@click.command()
@click.option("--robot", "chosen", multiple=True, metavar="NAME|PATH",
              shell_complete=robots(),
              help="Robot to check. May be repeated.  [default: all shipped ones]")  # fmt: skip
@settings_option("--set", "settings", "Parameter of the robots, such as base=fixed. May be repeated.")
@click.option("--samples", default=2000, show_default=True, metavar="N", help="Random states for each robot.")
@click.option("--seed", default=0, show_default=True, metavar="S", help="Seed of the random states.")
@jobs_option(1)
@click.option("--device", type=click.Choice(["gpu", "cpu"]), help="Check rp.GpuDynamics there, too.")
@trust_option
@json_option
def validate(chosen: tuple[str, ...], samples: int, seed: int, jobs: int, as_json: bool, **given: Any) -> int:
    r"""Check the dynamics on random states.

    Closures, balance of power, inverse against forward dynamics, and the backends against each other. The checks do
    not say whether the model has the masses and lengths of your machine. Exit code 1 if a check fails.

    \b
    Example:
      redundancy-pin validate --robot 3rrr --samples 10000 --seed 1 --jobs 4
      redundancy-pin validate --robot machine.xml --set base=fixed
    """
    processes = os.cpu_count() or 1 if require_jobs(jobs) == -1 else jobs
    with progress("validate") as advance:
        report = crosscheck.run(
            chosen or None, samples, seed, lambda done, total: advance(done, total, ""), processes, **given
        )
    if as_json:
        print_json(report.as_dict())
    else:
        console().print(report.table().terminal())
    if report.passed:
        return 0
    checks = [row for row in report.rows if not row.note]
    failed = sum(not row.passed for row in checks)
    idle = f"of {report.unjudged[0]} nothing could be checked against physics" if report.unjudged else "no checks"
    print_line("error", f"{f'{failed} of {len(checks)} checks failed' if failed else idle}.")
    return FAILED_CHECK
