"""What ``redundancy-pin plan`` writes and prints."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import click
import numpy as np
from rich.table import Table

from redundancy_pin.cli.output import console, number, print_json, require_suffix
from redundancy_pin.errors import OutputError
from redundancy_pin.files import replacing_file, require_writable
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.plan import Plan, PlanStatus
from redundancy_pin.planners.whole_trajectory_check import ALLOWED
from redundancy_pin.studies.case import RNEA, VIRTUAL_WORK
from redundancy_pin.studies.measures import SWING, reversals
from redundancy_pin.visualisation.plan_figures import plot_plan
from redundancy_pin.visualisation.style import picture_format, require_matplotlib, save

_BACKENDS = {"Rnea": RNEA, "VirtualWork": VIRTUAL_WORK}
"""How the command line calls what a plan names by its class."""

_LISTED = 6
"""Broken limits that a table and a warning list; the rest is counted."""


def require_outputs(out: str | None, plot: str | None, inputs: Sequence[str] = ()) -> None:
    """Check that both files can be written and are none of the inputs, before the work is done.

    Raises:
        OutputError: one of them cannot be.
        RedundancyPinError: a picture without matplotlib.
    """
    if out:
        require_suffix("--out", out, ".npz")
        require_writable(out)
    if plot:
        require_matplotlib()
        picture_format(plot)
        require_writable(plot)
    for flag, path in (("--out", out), ("--plot", plot)):
        if path and any(_same_file(path, given) for given in inputs):
            raise OutputError(f"{flag} is the file {path} to read from.", remedy="Give it another name.", path=path)


def write_outputs(plan: Plan, out: str | None, plot: str | None) -> None:
    """Write the plan and its picture: both or neither.

    Raises:
        OutputError: a file cannot be written.
    """
    with ExitStack() as stack:
        if plot:
            save(plot_plan(plan), stack.enter_context(replacing_file(plot)))
        if out:
            plan.save(out)


def print_plan(plan: Plan, out: str | None, plot: str | None, *, as_json: bool) -> None:
    """Print what is worth knowing of a plan on stdout."""
    if as_json:
        print_json({**summary(plan), "out": out, "plot": plot})
    else:
        console().print(_table(plan, out, plot))


def warn(plan: Plan) -> None:
    """Say in one line on stderr what is wrong with a plan; nothing if it is within its limits."""
    if plan.status is PlanStatus.VIOLATES_LIMITS:
        said = "; ".join(_event(plan, event, broken=True) for event in plan.limits.violated[:_LISTED])
        more = len(plan.limits.violated) - _LISTED
        click.echo(f"warning: limits broken: {said}{f'; and {more} more' if more > 0 else ''}.", err=True)
    if plan.status is PlanStatus.UNBOUNDED_EFFORT:
        bad = np.flatnonzero(~np.isfinite(plan.tau).all(axis=1))
        where = f" first at t = {plan.t[bad[0]]:.6g} s," if len(bad) else ""
        click.echo(
            f"warning: no finite main efforts:{where} at {len(bad)} of {len(plan.t)} samples, where W is singular.",
            err=True,
        )
    if plan.status is PlanStatus.STOPPED_EARLY:
        click.echo(
            f"warning: this is no optimum: the optimiser stopped early ({plan.diagnostics.get('solver')}). The plan "
            "keeps every limit, but there may be a better one; allow more --seconds.",
            err=True,
        )
    ratio = _ratio_between_nodes(plan)
    if ratio > ALLOWED:
        click.echo(
            f"warning: the efforts between the nodes are {ratio:.4g} times those at the nodes; allow more "
            "--refinements, or a shorter --dt.",
            err=True,
        )


def summary(plan: Plan) -> dict[str, Any]:
    """Return what is worth knowing of a plan as plain data."""
    return {
        "robot": plan.robot.name,
        "planner": plan.planner,
        "backend": plan.backend,
        "status": plan.status.value,
        "optimal": plan.diagnostics.get("optimal"),
        "samples": len(plan.t),
        "start": float(plan.t[0]),
        "end": float(plan.t[-1]),
        "peak_effort": plan.peak_effort,
        "rms_effort": plan.rms_effort,
        "reversals": reversals(plan),
        "peak_carrier_force": np.abs(plan.carrier_force).max(axis=0, initial=0.0),
        "main_energy": plan.main_energy,
        "carrier_energy": plan.carrier_energy,
        "smallest_margin": _smallest_margin(plan),
        "phases": _phase_times(plan),
        "limits": {
            "violated": [vars(event) for event in plan.limits.violated],
            "binding": [vars(event) for event in plan.limits.binding],
        },
        "parameters": plan.parameters,
        "diagnostics": plan.diagnostics,
    }


def status_text(plan: Plan) -> str:
    """Return the status in words; of a plan that is no optimum, that as well."""
    said = plan.status.value.replace("_", " ")
    if plan.diagnostics.get("optimal", True):
        return said
    return f"{said}: no optimum, the solver says {plan.diagnostics.get('solver')}"


def _of_the_optimum(plan: Plan) -> Iterator[tuple[str, str]]:
    """Give what an optimised plan says of its optimum and its nodes."""
    if "optimal" not in plan.diagnostics:
        return
    weights: Any = plan.parameters["objective"]
    yield "minimised", ", ".join(name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights.items())
    found: Any = plan.diagnostics
    reached = "local optimum" if found["optimal"] else "NOT an optimum"
    yield "reached", f"{reached} in {found['iterations']} iterations, {found['seconds']:.3g} s"
    yield "nodes", f"{found['nodes']}, {len(found['singular_nodes'])} of them singular"
    yield "efforts between the nodes", f"at most {_ratio_between_nodes(plan):.6g} times those at the nodes"


def _ratio_between_nodes(plan: Plan) -> float:
    ratios: Any = plan.diagnostics.get("dense_ratios") or (1.0,)
    return float(ratios[-1])


def _same_file(first: str, second: str) -> bool:
    try:
        return os.path.samefile(Path(first).expanduser(), Path(second).expanduser())
    except OSError:
        return False


def _smallest_margin(plan: Plan) -> float:
    """Return the smallest margin of the plan: zero where it crosses a singularity, though no sample may lie on it."""
    crossed = plan.diagnostics.get("singular_instants")
    return 0.0 if crossed else float(np.fmin.reduce(plan.margin))


def _phase_times(plan: Plan) -> list[dict[str, Any]]:
    """Return name, first and last time of every stretch of samples in one phase."""
    edges = np.flatnonzero(np.diff(plan.phase)) + 1
    starts, stops = np.concatenate([[0], edges]), np.concatenate([edges, [len(plan.phase)]]) - 1
    return [
        {"name": plan.phases[plan.phase[a]], "start": float(plan.t[a]), "end": float(plan.t[b])}
        for a, b in zip(starts, stops, strict=True)
    ]


def _table(plan: Plan, out: str | None, plot: str | None) -> Table:
    found = summary(plan)
    table = Table(
        title=f"{plan.robot.name}, {plan.planner.replace('_', ' ')}, {_BACKENDS.get(plan.backend, plan.backend)}",
        show_header=False,
    )
    table.add_row("status", status_text(plan))
    table.add_row("time [s]", f"{found['start']:.6g} to {found['end']:.6g}, {found['samples']} samples")
    table.add_row("phases [s]", _phases(found["phases"]))
    main, moved = plan.robot.effort_unit(*plan.robot.actuated), plan.robot.effort_unit(*plan.robot.carriers)
    table.add_row(f"peak main effort [{main}]", _row(found["peak_effort"]))
    table.add_row(f"rms main effort [{main}]", _row(found["rms_effort"]))
    table.add_row(f"reversals above {100.0 * SWING:g} % of the peak", _row(found["reversals"]))
    table.add_row(f"peak carrier effort [{moved}]", _row(found["peak_carrier_force"]))
    table.add_row("energy, main actuators [J]", number(plan.main_energy))
    table.add_row("energy, carriers [J]", number(plan.carrier_energy))
    table.add_row("smallest margin", number(found["smallest_margin"]))
    for name, text in _of_the_optimum(plan):
        table.add_row(name, text)
    table.add_row("limits broken", _events(plan, plan.limits.violated, broken=True))
    table.add_row("limits touched", _events(plan, plan.limits.binding, broken=False))
    for name, path in (("plan", out), ("picture", plot)):
        if path:
            table.add_row(f"{name} written to", path)
    return table


def _phases(phases: list[dict[str, Any]]) -> str:
    shown = [f"{phase['name'].replace('_', ' ')} {phase['start']:.4g}–{phase['end']:.4g}" for phase in phases]
    return ", ".join(shown[:10]) + (f", and {len(shown) - 10} more" if len(shown) > 10 else "")


def _events(plan: Plan, events: tuple[LimitEvent, ...], *, broken: bool) -> str:
    if not events:
        return "none"
    lines = [_event(plan, event, broken=broken) for event in events[:_LISTED]]
    return "\n".join(lines) + (f"\nand {len(events) - _LISTED} more" if len(events) > _LISTED else "")


def _event(plan: Plan, event: LimitEvent, *, broken: bool) -> str:
    unit = plan.robot.limit_unit(event.quantity, event.carrier)
    limit = event.limit if event.quantity == "track" else abs(event.limit)  # the others are limits of a size
    much = f"by {event.amount:.3g} {unit}" if broken else f"at its limit {limit:.3g} {unit}"
    return f"{event.quantity} of {event.carrier} {much} at t = {event.worst:.4g} s"


def _row(values: Any) -> str:
    return ", ".join(number(float(value)) for value in values)
