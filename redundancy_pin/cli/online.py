"""``redundancy-pin online``: a motion planned as if on line, tick after tick."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click
import numpy as np

from redundancy_pin.cli import options, output
from redundancy_pin.cli.errors import OPTIONS, in_words
from redundancy_pin.cli.plan import BREAKS_LIMITS, EXIT_CODES, NOT_OPTIMAL, summary, warn
from redundancy_pin.cli.plan_problem import flags_of, number, numbers, parameters_of, planner_options, read_parameters
from redundancy_pin.io.files import require_writable
from redundancy_pin.planners.receding_horizon import RecedingHorizon, run_online
from redundancy_pin.status import UpdateStatus
from redundancy_pin.studies.case import in_groups
from redundancy_pin.view import show
from redundancy_pin.visualisation.viewer.page import require_html, require_meshcat


@click.command()
@options.robot_options()
@options.backend_option()
@options.trajectory_options
@planner_options("online")
@click.option("--tick", metavar="SECONDS", help="Between plans.  [default: a step]")
@click.option("--start", default="0", show_default=True, metavar="S[,S...]", help="Where the carriers start, m.")
@click.option("--out", metavar="NPZ", help="Where the plan goes that came of it; `load_plan` reads it.")
@click.option(
    "--html", metavar="HTML", help="Write one file that plays offline: the path known ahead, plans, the motion."
)
@options.json_option
def online(
    robot: options.RobotOptions,
    backend: str | None,
    motion: options.MotionOptions,
    tick: str | None,
    start: str,
    out: str | None,
    html: str | None,
    as_json: bool,
    **given: Any,
) -> int:
    r"""Plan a motion as if on line.

    The path is known for a short time ahead (--horizon). Every tick plans the carriers and the efforts anew, through
    type II singularities that come up; the carriers follow the first piece. The plan that comes of it is judged as any
    other. Needs a C compiler.

    Exit codes: 0 every tick found a plan within limits, with --slow-down at a lower speed where need be, and the whole
    keeps them; 3 the whole breaks limits; 4 it keeps them, but some ticks had to leave something out, or its samples do
    not show its efforts; 2 bad input, or the path leads where the machine cannot go (the line on stderr says when).

    \b
    Example:
      redundancy-pin online --robot 2rpr --set end_effector_mass=0.5 --set cylinder_mass=0.3 \
          --trajectory circle --speed 0.5 --out online.npz
    """
    if out:
        output.require_suffix("--out", out, ".npz")
        require_writable(out)
    if html:
        require_meshcat()
        require_html(html)
        require_writable(html)
    flags = {**flags_of("online"), "tick": "--tick", "start": "--start"}
    with output.progress("online") as advance, in_words(OPTIONS.knowing(flags)):
        advance(0, 3, "reading")
        parameters = read_parameters("online", parameters_of(given))
        between, at = None if tick is None else number("--tick", tick), numbers("--start", start)
        loaded = robot.load()
        followed = motion.follow("On-line planning", loaded)
        planner = RecedingHorizon(options.dynamics_of(loaded, backend), **in_groups(RecedingHorizon, parameters))
        advance(1, 3, "ticks")
        run = run_online(planner, followed, tick=between, start=at)
        advance(2, 3, "writing")
        if out:
            run.plan.save(out)
        failed = output.drawn(html, lambda path: show(run.plan, robot=planner.robot, commands=run.commands).save(path))
        html = None if failed else html
    plan = run.plan
    seconds = 1e3 * np.percentile([command.seconds for command in run.commands], [50.0, 99.0])
    facts = {**summary(plan), "ticks": run.counts, "milliseconds": {"p50": seconds[0], "p99": seconds[1]}}
    facts |= {"motion": motion.described, "ends": getattr(followed, "ends", None), "out": out, "html": html}
    output.report(as_json, facts, _table(facts, plan.robot.effort_units[0]))
    warn(plan)
    planned = (UpdateStatus.OK.value, UpdateStatus.TIME_SCALED.value)
    left = sum(count for status, count in run.counts.items() if status not in planned)
    if left:
        output.warning(f"{left} of {len(run.commands)} ticks had no plan within every limit.")
    if failed:
        raise failed
    code = EXIT_CODES.get(plan.status, BREAKS_LIMITS)
    return code or (NOT_OPTIMAL if left else 0)


def _table(facts: Mapping[str, Any], unit: str) -> output.TextTable:
    diagnostics: Any = facts["diagnostics"]
    rows = [
        ("status", facts["status"].replace("_", " ")),
        ("motion", facts["motion"]),
        ("ticks", ", ".join(f"{count} {status}" for status, count in facts["ticks"].items() if count)),
        ("time of a tick, p50 and p99 [ms]", output.row(facts["milliseconds"].values())),
        ("later at the end [s]", output.number(diagnostics["delay"])),
        ("singular instants [s]", output.row(facts["findings"]["singular_instants"]) or "none"),
        ("force missing there [N]", output.number(diagnostics["missing_force"])),
        (f"peak main effort [{unit}]", output.row(facts["peak_effort"])),
        *((name, facts[key]) for name, key in (("plan written to", "out"), ("page written to", "html")) if facts[key]),
    ]
    return output.TextTable(f"{facts['robot']}, on line, {facts['backend']}", (), rows)
