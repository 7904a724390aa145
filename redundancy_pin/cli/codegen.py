"""``redundancy-pin codegen``: C of a robot for a controller."""

from __future__ import annotations

import click

from redundancy_pin.cli.errors import printable
from redundancy_pin.cli.options import RobotOptions, json_option, motion_option, robot_options
from redundancy_pin.cli.output import print_json
from redundancy_pin.codegen import write_c
from redundancy_pin.dynamics.compiled.symbols import casadi
from redundancy_pin.io.files import require_replaceable
from redundancy_pin.trajectory import carriers_from_csv, from_csv


@click.command()
@robot_options()
@click.option("--out", required=True, metavar="FOLDER", help="Where the files go; earlier ones are replaced.")
@click.option("--prefix", metavar="NAME", help="What names in C begin with; the robot's name when left out.")
@motion_option("Motion for the test program, as `inverse-dynamics` reads it.")
@json_option
def codegen(
    robot: RobotOptions, out: str, prefix: str | None, motion_path: str | None, check_rates: bool, as_json: bool
) -> None:
    r"""Write C for a controller.

    C99 that allocates nothing and calls math.h alone: inverse dynamics with the statuses of `inverse-dynamics`, forward
    kinematics, constraint Jacobians, margins to singularities. A header says shapes, units and frames; with it come
    CMake file, README and a test program, which compares recorded samples with another backend and measures times.

    \b
    Example:
      redundancy-pin codegen --robot 3rrr --out controller
    """
    require_replaceable(out)  # before the robot is loaded
    casadi()
    moves = None if motion_path is None else from_csv(motion_path, check_rates=check_rates)
    carriers = None if motion_path is None else carriers_from_csv(motion_path, check_rates=check_rates)
    written = write_c(robot.load(), out, prefix=prefix, motion=moves, carriers=carriers)
    if as_json:
        files, folder = list(written.files), str(written.folder)
        print_json({"folder": folder, "prefix": written.prefix, "files": files, "samples": written.samples})
    else:
        click.echo(f"{printable(str(written.folder))}: {', '.join(written.files)}")
