"""``redundancy-pin codegen``: C of a robot for a controller."""

from __future__ import annotations

import click

from redundancy_pin.cli.options import MotionOptions, RobotOptions, json_option, motion_options, robot_options
from redundancy_pin.cli.output import report
from redundancy_pin.codegen import write_c
from redundancy_pin.io.files import require_replaceable


@click.command()
@robot_options()
@click.option("--out", required=True, metavar="FOLDER", help="Where the files go; earlier ones are replaced.")
@click.option("--prefix", metavar="NAME", help="What names in C begin with; the robot's name when left out.")
@motion_options("for the test program")
@json_option
def codegen(robot: RobotOptions, out: str, prefix: str | None, motion: MotionOptions, as_json: bool) -> None:
    r"""Write C for a controller.

    C99 that allocates nothing and calls math.h alone: inverse dynamics with the statuses of `inverse-dynamics`, forward
    kinematics, constraint Jacobians, margins to singularities. A header says shapes, units and frames; with it come
    CMake file, README and a test program, which compares recorded samples with another backend and measures times.

    \b
    Example:
      redundancy-pin codegen --robot 3rrr --out controller
    """
    require_replaceable(out)  # before the robot is loaded
    loaded = robot.load()
    moves = motion.sampled("The test program", loaded) if motion.given else None
    written = write_c(loaded, out, prefix=prefix, motion=moves, carriers=motion.carriers(loaded))
    facts = {**vars(written), "folder": str(written.folder)}
    report(as_json, facts, f"{written.folder}: {', '.join(written.files)}")
