"""``redundancy-pin check``: a saved plan judged anew by the dynamics of its robot."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click
import numpy as np

from redundancy_pin.cli.errors import FAILED_CHECK
from redundancy_pin.cli.options import backend_option, json_option, recorded_robot_options
from redundancy_pin.cli.output import TextTable, number, report, row
from redundancy_pin.cli.plan import BREAKS_LIMITS, EXIT_CODES
from redundancy_pin.planners.check import check_plan
from redundancy_pin.planners.plan import load_plan, load_robot_of
from redundancy_pin.studies.case import BACKENDS, RNEA


@click.command()
@click.argument("path", metavar="NPZ")
@backend_option(RNEA, "What judges the plan.")
@recorded_robot_options
@json_option
def check(path: str, source: str | None, backend: str, trust: bool, as_json: bool) -> int:
    r"""Judge a saved plan anew.

    Its motion goes through the dynamics of its robot again: W τ = f at the samples, limits, efforts between the
    samples, and the status that follows, against what the plan says. Exit codes: 0 the plan is what it says, and within
    its limits; 1 it is not what it says (a line on stderr for each deviation); 2 no plan, or a file that was changed
    since it was saved; 3 and 4 it is what it says, and `plan` ends with that code.

    \b
    Example:
      redundancy-pin check plan.npz --backend virtual-work
    """
    plan = load_plan(path)
    result = check_plan(plan, BACKENDS[backend](load_robot_of(plan, source, trust=trust)))
    facts = {
        "plan": path,
        "backend": backend,
        "passed": result.passed,
        "status": result.status.value,
        "saved_status": plan.status.value,
        **{name: getattr(result, name) for name in ("imbalance", "peak_effort", "wider_limits", "closure_rank")},
        "limits": {"violated": [vars(event) for event in result.violated]},
        "deviations": [vars(deviation) for deviation in result.deviations],
    }
    rows = [
        ("is what it says", "yes" if result.passed else "NO"),
        ("status", result.status.value.replace("_", " ")),
        ("largest imbalance of W τ = f", number(result.imbalance)),
        (f"peak main effort [{plan.robot.effort_units[0]}]", row(result.peak_effort)),
        ("limits broken", str(len(result.violated)) if result.violated else "none"),
        *(("deviation", deviation.message) for deviation in result.deviations),
        *(("wider limit", note) for note in result.wider_limits),
        *(("closures lose rank", _where(loss)) for loss in result.closure_rank),
    ]
    title = f"{plan.robot.name}, {plan.planner.replace('_', ' ')}, by {backend}"
    report(as_json, facts, TextTable(title, (), rows))
    for deviation in result.deviations:
        click.echo(f"error: {deviation.message}", err=True)
    return EXIT_CODES.get(result.status, BREAKS_LIMITS) if result.passed else FAILED_CHECK


def _where(loss: Mapping[str, Any]) -> str:
    pose = ", ".join(number(float(value)) for value in np.ravel(loss["x"]))
    return f"at t = {loss['time']:.6g} s, x = {pose}: branches of the kinematics meet there"
