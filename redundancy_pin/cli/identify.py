"""``redundancy-pin identify``: masses, inertias and friction from measured motions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click
import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.cli import options, output
from redundancy_pin.errors import InputError, did_you_mean
from redundancy_pin.identification.fit import identify as run_identification
from redundancy_pin.identification.records import Records
from redundancy_pin.identification.robot_file import write_robot
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory.csv_file import coordinate_names, read_measured
from redundancy_pin.visualisation.figures.identification import write_report


def _records(path: str, robot: Robot) -> Records:
    """Return the records of a file: columns by the names of the joints."""
    columns = read_measured(path)

    def stacked(names: Sequence[str], optional: bool = False) -> Array:
        absent = [name for name in names if name not in columns]
        if absent and not (optional and len(absent) == len(names)):
            hint = did_you_mean(absent[0], list(columns)) or f"Its columns are {', '.join(columns)}."
            raise InputError(f"{path} has no column {absent[0]!r}.", remedy=hint, name="records", column=absent[0])
        return np.array([columns[name] for name in names if not absent]).reshape(-1, len(columns["t"])).T

    q, tau = ([f"{symbol}:{joint}" for joint in robot.actuated] for symbol in ("q", "tau"))
    s, force = ([f"{symbol}:{joint}" for joint in robot.carriers] for symbol in ("s", "tau"))
    if any(name in columns for name in q) or is_pose(robot):
        moved = {"position": stacked(q)}
    else:
        moved = {"platform": stacked(coordinate_names(robot))}
    carried = {"carriers": stacked(s, optional=True), "carrier_force": stacked(force, optional=True)}
    return Records(columns["t"], stacked(tau), **moved, **carried)


@click.command()
@options.robot_options()
@click.option("--records", required=True, multiple=True, metavar="CSV", help="Measured motion. May be repeated.")
@click.option("--cut-off", type=float, required=True, metavar="HZ",
              help="Of the splines through the positions: above the motion, below the noise.")  # fmt: skip
@click.option("--parameters", multiple=True, metavar="PATTERN", help="Such as '* of distal_1'. May be repeated.")
@click.option("--sensors", multiple=True, metavar="PATTERN",
              help="'offset of *', 'factor of *' or 'tilt * of gravity'. May be repeated.")  # fmt: skip
@click.option("--out", metavar="YAML",
              help="The robot, with the nearest real bodies: a declaration, its model beside it.")  # fmt: skip
@click.option("--report", "page", metavar="HTML", help="Page with the parameters, forces and residuals.")
@options.json_option
def identify(
    robot: options.RobotOptions,
    records: tuple[str, ...],
    out: str | None,
    page: str | None,
    as_json: bool,
    **given: Any,
) -> int:
    r"""Find masses and friction from measured motions.

    Records have a row of names, with units or in SI: t; q:JOINT and tau:JOINT of each motor, as `export` and
    `simulate --out run.csv` write them; s:JOINT, and tau:JOINT where measured, of each carrier. Without q columns,
    platform coordinates x, y, ....

    Exit codes: 0 done; 1 something about the result is doubtful (a line on stderr for each); 4 the motion shows none of
    the parameters, or the iteration did not converge.

    \b
    Example:
      redundancy-pin identify --robot five_bar --records run.csv --cut-off 10 \
          --out robot.yaml --report fit.html
    """
    output.require_outputs(out, (".yaml",), None, records)
    output.require_outputs(page, (".html",), None, records, flag="--report")
    keywords = {**given, "parameters": given["parameters"] or None, "physical": out is not None}
    with output.progress("identify") as advance:
        advance(0, 3, "reading")
        loaded = robot.load()
        read = [_records(path, loaded) for path in records]
        advance(1, 3, "fit")
        try:
            fit = run_identification(loaded, read, **keywords)
        except InputError as error:
            message = error.message.replace("physical=True", "--out")
            raise InputError(message, remedy=error.remedy, **error.details) from error
        advance(2, 3, "writing")
        if out:
            write_robot(fit.robot, out)
        page, failed = output.drawn(page, lambda path: write_report(fit, path))
    files = {"out": ("robot", out), "report": ("report", page)}
    output.report(as_json, fit.summary(), files=files, failed=failed)
    return 4 if fit.status is not ResultStatus.OK else int(bool(fit.problems))
