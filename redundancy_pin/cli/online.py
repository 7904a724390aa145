"""``redundancy-pin online``: a motion planned as if on line, tick after tick."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click
import numpy as np

from redundancy_pin.cli import options, output
from redundancy_pin.cli.errors import OPTIONS, in_words
from redundancy_pin.cli.plan import BREAKS_LIMITS, EXIT_CODES, NOT_OPTIMAL, summary, warn
from redundancy_pin.cli.plan_problem import number, numbers
from redundancy_pin.io.files import require_writable
from redundancy_pin.planners.receding_horizon import RecedingHorizon, run_online
from redundancy_pin.studies.case import BACKENDS, COMPILED

_LIMITS = {
    "track": ("LOWER,UPPER", "Ends of the tracks in place of theirs, m."),
    "max_speed": ("V[,V...]", "Limit of the carriers in place of theirs, m/s."),
    "max_acceleration": ("A[,A...]", "The same, m/s²."),
    "max_jerk": ("J[,J...]", "Limit of the carriers' jerk, m/s³."),
    "max_effort": ("E[,E...]", "Limit of the main efforts, N or N·m."),
    "max_carrier_force": ("F[,F...]", "Limit of the carriers' forces, N."),
}


def _limit_options(command: Any) -> Any:
    for name, (metavar, text) in reversed(list(_LIMITS.items())):
        command = click.option(options.flag(name), name, metavar=metavar, help=text)(command)
    return command


@click.command()
@options.robot_options()
@options.backend_option(COMPILED)
@options.trajectory_options
@click.option("--horizon", default="0.5", show_default=True, metavar="SECONDS", help="How far ahead the path is known.")
@click.option("--step", default="0.02", show_default=True, metavar="SECONDS", help="Between the nodes of a plan.")
@click.option("--tick", metavar="SECONDS", help="Between plans.  [default: a step]")
@click.option("--objective", default="peak", show_default=True, metavar="WORD", help="peak, or effort.")
@click.option("--start", default="0", show_default=True, metavar="S[,S...]", help="Where the carriers start, m.")
@_limit_options
@click.option("--out", metavar="NPZ", help="Where the plan goes that came of it; `load_plan` reads it.")
@options.json_option
def online(
    robot: options.RobotOptions,
    backend: str,
    motion: options.MotionOptions,
    out: str | None,
    as_json: bool,
    **given: Any,
) -> int:
    r"""Plan a motion as if on line.

    The path is known for a short time ahead (--horizon). Every tick plans the carriers and the efforts anew, through
    type II singularities that come up; the carriers follow the first piece. The plan that comes of it is judged as any
    other. Needs the extra `optimal`.

    Exit codes: 0 every tick found a plan within limits, and the whole keeps them; 3 the whole breaks limits; 4 it keeps
    them, but some ticks had to leave something out, or its samples do not show its efforts; 2 bad input, or the path
    leads where the machine cannot go (the line on stderr says when).

    \b
    Example:
      redundancy-pin online --robot 2rpr --set end_effector_mass=0.5 --set cylinder_mass=0.3 \
          --trajectory circle --speed 0.5 --out online.npz
    """
    if out:
        output.require_suffix("--out", out, ".npz")
        require_writable(out)
    settings: dict[str, Any] = {name: number(options.flag(name), given[name]) for name in ("horizon", "step")}
    names = {name: name.removeprefix("max_") for name in _LIMITS}
    flags = {names[name]: options.flag(name) for name in _LIMITS} | {"horizon": "--horizon", "objective": "--objective"}
    with output.progress("online") as advance, in_words(OPTIONS.knowing(flags)):
        advance(0, 2, "reading")
        limits = {names[name]: numbers(options.flag(name), given[name]) for name in _LIMITS if given[name] is not None}
        tick = None if given["tick"] is None else number("--tick", given["tick"])
        start = numbers("--start", given["start"])
        followed = motion.follow("On-line planning")
        dynamics = BACKENDS[backend](robot.load())
        planner = RecedingHorizon(dynamics, objective=given["objective"], **settings, **limits)
        advance(1, 2, "ticks")
        run = run_online(planner, followed, tick=tick, start=start)
        if out:
            run.plan.save(out)
    plan = run.plan
    seconds = 1e3 * np.percentile([command.seconds for command in run.commands], [50.0, 99.0])
    facts = {**summary(plan), "ticks": run.counts, "milliseconds": {"p50": seconds[0], "p99": seconds[1]}, "out": out}
    output.report(as_json, facts, _table(facts, plan.robot.effort_units[0]))
    warn(plan)
    left = sum(count for status, count in run.counts.items() if status != "planned")
    if left:
        output.warning(f"{left} of {len(run.commands)} ticks had no plan within every limit.")
    code = EXIT_CODES.get(plan.status, BREAKS_LIMITS)
    return code or (NOT_OPTIMAL if left else 0)


def _table(facts: Mapping[str, Any], unit: str) -> output.TextTable:
    found: Any = facts["diagnostics"]
    rows = [
        ("status", facts["status"].replace("_", " ")),
        ("ticks", ", ".join(f"{count} {status}" for status, count in facts["ticks"].items() if count)),
        ("time of a tick, p50 and p99 [ms]", output.row(facts["milliseconds"].values())),
        ("singular instants [s]", output.row(found["singular_instants"]) or "none"),
        ("force missing there [N]", output.number(found["missing_force"])),
        (f"peak main effort [{unit}]", output.row(facts["peak_effort"])),
        *((name, facts[key]) for name, key in (("plan written to", "out"),) if facts[key]),
    ]
    return output.TextTable(f"{facts['robot']}, on line, {facts['backend']}", (), rows)
