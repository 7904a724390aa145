"""``redundancy-pin check``, ``export``: a saved plan validated by its robot's dynamics, or written for others."""

from __future__ import annotations

from pathlib import Path

import click

from redundancy_pin.cli.errors import FAILED_CHECK, print_line
from redundancy_pin.cli.options import backend_option, dynamics_of, json_option, recorded_robot_options
from redundancy_pin.cli.output import EXIT_CODES, report, require_outputs
from redundancy_pin.errors import InputError
from redundancy_pin.planners.plan import load_plan, load_robot_of

WRITERS = {".csv": "to_csv", ".json": "to_json", ".mat": "to_mat", ".yaml": "to_ros", ".yml": "to_ros"}
"""Methods of ``PlanTable`` that write a file, by its suffix."""


@click.command()
@click.argument("path", metavar="NPZ")
@backend_option("What judges the plan.")
@recorded_robot_options
@json_option
def check(path: str, source: str | None, backend: str | None, trust: bool, as_json: bool) -> int:
    r"""Re-validate a saved plan.

    Its motion goes through the dynamics of its robot again: W τ = f at the samples, limits, efforts between the
    samples, and the status that follows, against what the plan says. Exit codes: 0 the plan is what it says, and within
    its limits; 1 it is not what it says (a line on stderr for each deviation); 2 no plan, or a file that was changed
    since it was saved; 3 and 4 it is what it says, and `plan` ends with that code.

    \b
    Example:
      redundancy-pin check plan.npz --backend virtual-work
    """
    # what plans and judges takes as long to import as an export takes
    from redundancy_pin.dynamics.backends import backend_of
    from redundancy_pin.planners.check import check_plan

    plan = load_plan(path)
    dynamics = dynamics_of(load_robot_of(plan, source, trust=trust), backend)
    result = check_plan(plan, dynamics)
    facts = result.summary(plan)
    backend = backend_of(dynamics)
    report(as_json, facts, by=f"by {backend}", plan=path, backend=backend)
    for deviation in result.deviations:
        print_line("error", deviation.message)
    return EXIT_CODES[result.status] if result.passed else FAILED_CHECK


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
    require_outputs(out, tuple(WRITERS), inputs=(path,), flag="--to")
    if ros and suffix not in (".json", ".yaml", ".yml"):
        raise InputError(f"--ros does not go with {suffix}.", remedy="Write --to trajectory.yaml.")
    writer = "to_ros" if ros else WRITERS[suffix]
    if writer == "to_ros" and two_sided:
        raise InputError("A JointTrajectory has one point at a time.", remedy="Leave --two-sided out.")
    plan, sides = load_plan(path), two_sided or (False if writer == "to_ros" else None)
    table = plan.table(rate, two_sided=sides, robot=load_robot_of(plan, source, trust=trust))
    getattr(table, writer)(out)
    facts = {"plan": path, "robot": plan.robot.name, "out": out, "rows": len(table.t), "joints": table.joints}
    report(as_json, facts, f"{len(table.t)} rows of {', '.join(table.joints)} are in {out}")
