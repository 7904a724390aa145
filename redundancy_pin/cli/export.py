"""``redundancy-pin export``: a plan for other programs."""

from __future__ import annotations

from pathlib import Path

import click

from redundancy_pin.cli.errors import OPTIONS, in_words
from redundancy_pin.cli.options import json_option, recorded_robot_options
from redundancy_pin.cli.output import report, same_file
from redundancy_pin.errors import InputError, OutputError
from redundancy_pin.io.files import require_writable
from redundancy_pin.planners.export import write_csv, write_json, write_mat, write_ros
from redundancy_pin.planners.plan import load_plan, load_robot_of

WRITERS = {".csv": write_csv, ".json": write_json, ".mat": write_mat, ".yaml": write_ros, ".yml": write_ros}
"""What is written, by the suffix of the file."""


@click.command()
@click.argument("path", metavar="NPZ")
@click.option("--to", "out", required=True, metavar="FILE", help=f"What to write: {', '.join(WRITERS)}.")
@click.option("--rate", type=float, metavar="HZ", help="Rows a second.  [default: the samples of the plan]")
@click.option("--two-sided", is_flag=True, help="Two rows where something jumps: before and after it.")
@click.option("--ros", is_flag=True, help="Write a JointTrajectory as .json; .yaml always is one.")
@recorded_robot_options
@json_option
def export(
    path: str, out: str, rate: float | None, two_sided: bool, ros: bool, source: str | None, trust: bool, as_json: bool
) -> None:
    r"""Write a plan for other programs.

    Positions, rates, accelerations and efforts of actuators and carriers by joint name, and the coordinates of the
    platform: as CSV (units in the names of the columns), JSON, a MAT file, or, as .yaml, a message
    trajectory_msgs/JointTrajectory of ROS 2. With --rate the rows are what the plan is between its samples, not
    interpolated ones; where something jumps they have the values after the jump.

    \b
    Examples:
      redundancy-pin export plan.npz --to plan.csv --rate 1000
      redundancy-pin export plan.npz --to trajectory.yaml --rate 250
    """
    suffix = Path(out).suffix.lower()
    if suffix not in WRITERS:
        raise OutputError(
            f"--to {out} has no suffix that says what to write.", remedy=f"End it in {', '.join(WRITERS)}.", path=out
        )
    if ros and suffix not in (".json", ".yaml", ".yml"):
        raise InputError(f"--ros does not go with {suffix}.", remedy="Write --to trajectory.yaml.")
    message = ros or WRITERS[suffix] is write_ros
    if message and two_sided:
        raise InputError("A JointTrajectory has one point at a time.", remedy="Leave --two-sided out.")
    if same_file(path, out):
        raise OutputError("--to is the file of the plan.", remedy="Give it another name.", path=out)
    require_writable(out)
    plan = load_plan(path)
    with in_words(OPTIONS.knowing({"rate": "--rate"})):
        table = plan.table(
            rate, two_sided=two_sided or (False if message else None), robot=load_robot_of(plan, source, trust=trust)
        )
        (write_ros if message else WRITERS[suffix])(table, out)
    facts = {"plan": path, "robot": plan.robot.name, "out": out, "rows": len(table.t), "joints": table.joints}
    report(as_json, facts, f"{len(table.t)} rows of {', '.join(table.joints)} are in {out}")
