"""``redundancy-pin map``: what a machine can do, over two of its parameters."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from itertools import groupby
from pathlib import Path
from typing import Any

import click

from redundancy_pin.cli import options
from redundancy_pin.cli.errors import FAILED_CHECK
from redundancy_pin.cli.output import drawn, report, resumable, warning
from redundancy_pin.cli.plan_problem import PARAMETERS, number, read_parameters
from redundancy_pin.dynamics.backends import RNEA, VIRTUAL_WORK
from redundancy_pin.errors import InputError, shown
from redundancy_pin.io.files import expanded
from redundancy_pin.io.json_data import json_data
from redundancy_pin.planners.registry import STEPWISE, SWITCH_OFF, WHOLE
from redundancy_pin.studies import feasibility
from redundancy_pin.studies.store import FILE
from redundancy_pin.studies.table import Column, Table, table
from redundancy_pin.trajectory.points import read_points
from redundancy_pin.visualisation.figures.style import require_matplotlib
from redundancy_pin.workers import cluster


def _limit_options(command: Callable[..., Any]) -> Callable[..., Any]:
    limits = {options.flag(name): f"Limit: {text}; inf for none." for name, text in feasibility.LIMITS.items()}
    return options.number_options(limits)(command)


@click.command("map")
@options.robot_flags
@options.backend_option(default="virtual-work where it can, otherwise rnea")
@options.trajectory_option("Motion")
@click.option("--x", "x_text", metavar="AXIS", help="NAME=LOW:HIGH:COUNT, with :log at its end for a logarithmic one.")
@click.option("--y", "y_text", metavar="AXIS", help="The same, or NAME=V,V,...: values one by one.")
@_limit_options
@click.option(
    "--planner",
    "planners",
    type=click.Choice([SWITCH_OFF, STEPWISE, WHOLE]),
    multiple=True,
    help="May be repeated.  [default: that of the thesis, and whole-trajectory]",
)
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="PLANNER:NAME=VALUE",
    help="Of a planner, such as whole-trajectory:objective=peak; may be repeated.",
)
@click.option("--refine", default=2, show_default=True, metavar="N", help="How often the border is bisected.")
@click.option("--along", type=click.Choice(["x", "y"]), default="x", show_default=True, help="Axis of the bisection.")
@options.jobs_option(-1)
@options.scheduler_option
@click.option("--out", metavar="FOLDER", help="Where store, tables and pictures go.  [default: map-ROBOT]")
@options.json_option
def map(**given: Any) -> int:
    r"""What a machine can do: two parameters swept.

    Every cell of a grid goes to the planner of the thesis and to the whole-trajectory planner. The pictures show side
    by side where they find a plan within every limit, its peak effort, and which limit is in the way elsewhere. Axes
    are keys of the trajectory (speed, radius, ramp_time, ...), limits (stroke, max_speed, max_acceleration, max_jerk,
    max_effort, max_carrier_force), and numeric arguments of the robot (carrier_mass, ...).

    Finished cells are kept in FOLDER/store.sqlite: after an interruption the same command goes on where it was.
    Exit code 1: a planner failed in every cell.

    \b
    Examples:
      redundancy-pin map --robot 2rpr
      redundancy-pin map --robot 3rrr --x radius=0.013:0.05:8 --y carrier_mass=0.5:5:8 --max-effort 4 --jobs 8
    """
    problem = problem_of(given)
    require_matplotlib()  # before hours of planning, not after them
    folder = expanded(given["out"] or f"map-{Path(problem.robot).stem}")
    settings: dict[str, Any] = {name: given[name] for name in ("jobs", "refine", "along")}
    with cluster(given["scheduler"]), resumable("map", "cells", folder / FILE) as advance:
        result = feasibility.feasibility_map(problem, folder / FILE, **settings, progress=advance)
    files = [*feasibility.write_map(result, folder, pictures=False)]
    undrawn = drawn(str(folder / "map.svg"), lambda _: files.extend(feasibility.write_pictures(result, folder)))
    facts = {**result.as_dict(), "folder": str(folder), "files": [str(path) for path in files]}
    del facts["cells"]
    written = f"Tables and pictures are in {folder}: {', '.join(path.name for path in files)}."
    report(given["as_json"], facts, _counts(result), _border(result), written)
    failed = {planner: [cell for cell in result.of(planner) if cell.possible is None] for planner in problem.planners}
    for planner, cells in failed.items():
        if cells:
            where = f"{problem.x.name} {cells[0].x:g}, {problem.y.name} {cells[0].y:g}"
            why = f"in the first ({where}) with: {' '.join(cells[0].message.split())}"
            warning(f"{planner} failed in {len(cells)} cell(s), {why}")
    if undrawn:
        raise undrawn
    return FAILED_CHECK if any(len(cells) == len(result.of(planner)) for planner, cells in failed.items()) else 0


def problem_of(given: Mapping[str, Any]) -> feasibility.MapProblem:
    """Return the problem that the options describe; what is left out comes from the preset of the robot."""
    robot = given["robot"]
    preset = feasibility.PRESETS.get(robot, feasibility.OTHER)
    if given["trajectory"] is None and robot not in feasibility.PRESETS:
        raise InputError(f"There is no usual motion of {robot}.", remedy="Add --trajectory.")
    name, path_options = trajectory_of(given["trajectory"] or preset.trajectory)
    usual = name == preset.trajectory  # limits and options of a preset were chosen for its own motion
    x, y = feasibility.parse_axis(given["x_text"] or preset.x), feasibility.parse_axis(given["y_text"] or preset.y)
    own = {key: float(given[key]) for key in feasibility.LIMITS if given[key] is not None}
    limits = {**(preset.limits if usual else {}), **own}
    for axis, text in ((x, given["x_text"]), (y, given["y_text"])):
        if axis.name in limits and given.get(axis.name) is None:
            del limits[axis.name]
        if text is None and given.get(axis.name) is not None:
            raise InputError(
                f"{options.flag(axis.name)} fixes {axis.name}, which is an axis of this map.",
                remedy="Name other axes with --x and --y.",
            )
    parameters: dict[str, dict[str, Any]] = {}
    for text in given["parameters"]:
        planner, key, value = _parameter(text)
        parameters.setdefault(planner, {}).setdefault(key, []).append(value)
    return feasibility.MapProblem(
        x=x,
        y=y,
        trajectory=name,
        options={**(preset.options if usual else {}), **path_options},
        mode=given["mode"] or (),
        **{key: given[key] for key in ("robot", "settings", "gravity", "trust")},
        backend=given["backend"] or (VIRTUAL_WORK if robot in feasibility.PRESETS else RNEA),
        limits={key: value for key, value in limits.items() if not math.isinf(value)},
        planners=given["planners"] or (preset.thesis, feasibility.WHOLE),
        parameters={planner: _read(planner, values) for planner, values in parameters.items()},
    )


def trajectory_of(text: str) -> tuple[str, dict[str, Any]]:
    """Return name and options of a trajectory; of a file the points, which are part of a problem, not its name."""
    name, texts = options.split_trajectory(text)
    if options.is_points_file(name):
        name, texts = "points", {"points": _points(name), **texts}
    return name, options.trajectory_values(name, texts)


def _points(file: str) -> str:
    """Return the points of a file as they are written in ``points:points=...``."""
    points, times, speed = read_points(file)
    if times is not None or speed is not None:
        raise InputError(
            f"{file} says when its points are passed, which a map varies.",
            remedy="Leave the columns t and speed out, and add :speed=0.1,ramp_time=0.2.",
        )
    return ";".join(" ".join(repr(value) for value in row) for row in points.tolist())


def _parameter(text: str) -> tuple[str, str, str]:
    planner, colon, rest = text.partition(":")
    key, separator, value = rest.partition("=")
    if not (colon and separator and key.strip() and value.strip()):
        raise InputError(
            f"--parameter {shown(text)} is not PLANNER:NAME=VALUE.", remedy="Write --parameter switch-off:threshold=20."
        )
    return (
        options.require_choice(planner.strip(), (SWITCH_OFF, STEPWISE, WHOLE), "the planner"),
        key.strip(),
        value.strip(),
    )


def _read(planner: str, given: Mapping[str, list[str]]) -> dict[str, Any]:
    """Return parameters of a planner as plain data; repeated ones belong together where the planner takes several."""
    if planner == feasibility.STEPWISE and "dt" in given:  # a flag of its own on the command line of the planner
        rest = {key: values for key, values in given.items() if key != "dt"}
        return {**_read(planner, rest), "dt": number("dt", given["dt"][-1])}
    values = {
        key: tuple(texts) if (known := PARAMETERS[planner].get(key)) and known.multiple else texts[-1]
        for key, texts in given.items()
    }
    return {key: json_data(value) for key, value in read_parameters(planner, values).items()}


def _counts(result: feasibility.FeasibilityMap) -> Table:
    rows = []
    for planner, numbers in result.as_dict()["planners"].items():
        limits = ", ".join(f"{limit} {count}" for limit, count in numbers["in_the_way"].items())
        rows.append({"planner": planner, **numbers["counts"], "limits": limits, "seconds": numbers["seconds"]})
    return table("map_counts", rows, f"{result.problem.robot}, {result.problem.trajectory}: cells")


_UNIFORM: Mapping[frozenset[bool | None], str] = {
    frozenset([True]): "all possible",
    frozenset([False]): "none possible",
}


def _border(result: feasibility.FeasibilityMap) -> Table:
    (along, across), unit = result.axes, feasibility.effort_unit(result.problem)
    rows: dict[float, dict[str, Any]] = {value: {"line": f"{value:g}"} for value in across.values}
    for planner in result.problem.planners:
        for value, cells in result.lines(planner).items():
            rows[value][planner] = _UNIFORM.get(frozenset(cell.possible for cell in cells), "not known")
        for value, crossings in groupby(result.border(planner), lambda crossing: crossing.line):
            rows[value][planner] = "; ".join(f"{crossing.low:.4g} … {crossing.high:.4g}" for crossing in crossings)
    planners = [Column(planner) for planner in result.problem.planners]
    columns = [Column("line", feasibility.axis_label(across.name, unit)), *planners]
    label = feasibility.axis_label(along.name, unit)
    title = f"border: {label} between a cell that is possible and one that is not"
    return Table.of(columns, list(rows.values()), title)
