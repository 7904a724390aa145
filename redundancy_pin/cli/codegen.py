"""``redundancy-pin codegen``: C of a robot for a controller."""

from __future__ import annotations

from typing import Any

import click

from redundancy_pin.cli.options import (
    MotionOptions,
    RobotOptions,
    json_option,
    keyword_options,
    motion_options,
    robot_options,
)
from redundancy_pin.cli.output import report
from redundancy_pin.codegen import write_c
from redundancy_pin.errors import InputError
from redundancy_pin.io.files import require_replaceable
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.planners.registry import in_groups


@click.command()
@robot_options()
@click.option("--out", required=True, metavar="FOLDER", help="Where the files go; earlier ones are replaced.")
@click.option("--prefix", metavar="NAME", help="What names in C begin with; the robot's name when left out.")
@motion_options("for the test programs")
@click.option("--online", is_flag=True, help="Write the on-line planner too: --horizon, --step, limits ...")
@keyword_options(RecedingHorizon)
@json_option
def codegen(
    robot: RobotOptions,
    out: str,
    prefix: str | None,
    motion: MotionOptions,
    online: bool,
    as_json: bool,
    **given: Any,
) -> None:
    r"""Write C for a controller.

    C99 that allocates nothing and calls math.h alone: inverse dynamics with the statuses of `inverse-dynamics`, forward
    kinematics, constraint Jacobians, margins to singularities. A header says shapes, units and frames; with it come
    CMake file, README and a test program, which compares recorded samples with another backend and measures times. With
    --online the planner of `online` is written too: a controller calls it with the platform's motion ahead.

    \b
    Examples:
      redundancy-pin codegen --robot 3rrr --out controller
      redundancy-pin codegen --robot 3rrr --online --horizon 0.4 --out planner
    """
    require_replaceable(out)  # before the robot is loaded
    keywords = {name: value for name, value in given.items() if value is not None}
    if keywords and not online:
        raise InputError(f"--{', --'.join(keywords).replace('_', '-')} given without --online.", remedy="Add --online.")
    loaded = robot.load()
    planner = RecedingHorizon(loaded, **in_groups(RecedingHorizon, keywords)) if online else None
    moves = motion.sampled("The test program", loaded) if motion.given else None
    written = write_c(loaded, out, prefix=prefix, motion=moves, carriers=motion.carriers(loaded), online=planner)
    facts = {**vars(written), "folder": str(written.folder)}
    report(as_json, facts, f"{written.folder}: {', '.join(written.files)}")
