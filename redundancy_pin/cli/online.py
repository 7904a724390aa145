"""``redundancy-pin online``: a motion planned as if on line, update after update."""

from __future__ import annotations

from typing import Any

import click

from redundancy_pin.cli import options, output
from redundancy_pin.dynamics.backends import backend_of
from redundancy_pin.io.files import require_writable
from redundancy_pin.planners.receding_horizon import RecedingHorizon, run_online
from redundancy_pin.planners.receding_horizon.run import NOT_PLANNED
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.view import show
from redundancy_pin.visualisation.viewer.page import require_html


@click.command()
@options.robot_options()
@options.backend_option()
@options.motion_options("to follow")
@options.keyword_options(RecedingHorizon)
@options.keyword_options(run_online, only=("tick", "start"))
@click.option("--out", metavar="NPZ", help="Where the plan goes that came of it; `load_plan` reads it.")
@click.option("--html", metavar="HTML", help="Write one file that plays the motion offline.")
@options.json_option
def online(
    robot: options.RobotOptions,
    backend: str | None,
    motion: options.MotionOptions,
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
          --motion circle:speed=0.5 --out online.npz
    """
    output.require_outputs(out, (".npz",), inputs=(motion.file,))
    if html:
        require_html(html)
        require_writable(html)
    keywords = {name: value for name, value in given.items() if value is not None}
    drive = {name: keywords.pop(name) for name in ("tick", "start") if name in keywords}
    with output.progress("online") as advance:
        advance(0, 3, "reading")
        loaded = robot.load()
        followed = motion.follow("On-line planning", loaded)
        dynamics = options.dynamics_of(loaded, backend)
        planner = RecedingHorizon(dynamics, **in_groups(RecedingHorizon, keywords))
        advance(1, 3, "ticks")
        run = run_online(planner, followed, **drive)
        advance(2, 3, "writing")
        if out:
            run.plan.save(out)
        html, failed = output.drawn(html, lambda path: show(run.plan, robot=planner.robot).save(path))
    facts = run.summary()
    by, ends = backend_of(dynamics), getattr(followed, "ends", None)
    more = {"backend": by, "motion": motion.described, "ends": ends}
    output.report(as_json, facts, by=by, files={"out": ("plan", out), "html": ("page", html)}, failed=failed, **more)
    left = sum(run.counts[status.value] for status in NOT_PLANNED)
    return output.EXIT_CODES[run.plan.status] or (4 if left else 0)
