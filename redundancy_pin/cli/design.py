"""``redundancy-pin design``: one machine for several tasks, beside one made for each."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from redundancy_pin.cli import options
from redundancy_pin.cli.map import trajectory_of
from redundancy_pin.cli.output import progress, report
from redundancy_pin.cli.trade import planner_parameters
from redundancy_pin.errors import InputError, shown
from redundancy_pin.io.files import expanded, write_text
from redundancy_pin.studies.case import BACKENDS, RNEA, VIRTUAL_WORK, load
from redundancy_pin.studies.case import options as plain
from redundancy_pin.studies.co_design import DesignTask, compare_machines
from redundancy_pin.studies.store import make_folder
from redundancy_pin.studies.table import Column, Table, json_data, table


@click.command()
@options.robot_flags
@options.backend_option(None, "How to compute; the robot's closed form where it has one.")
@click.option(
    "--task",
    "tasks",
    multiple=True,
    required=True,
    metavar="NAME|FILE[:KEY=VALUE,...]",
    help="Motion, as --trajectory of the other commands; may be repeated.",
)
@click.option(
    "--vary",
    "ranges",
    multiple=True,
    required=True,
    metavar="NAME=LOW:HIGH",
    help="A number of the robot that is designed; may be repeated.",
)
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME=VALUE",
    help="Of `plan whole-trajectory`, such as objective=peak or acceleration=20; may be repeated.",
)
@click.option("--iterations", default=30, show_default=True, metavar="N", help="Most machines of a search.")
@click.option("--out", metavar="FOLDER", help="Where the tables go.  [default: design-ROBOT]")
@options.json_option
def design(**given: Any) -> None:
    r"""Design a machine for several tasks.

    Numbers of the robot between bounds and the plans of all tasks are optimised together: for each task alone, and for
    all with one machine. The table says what each task costs by each machine: peak effort, energy and its part for the
    carriers, force of the carriers, stroke, moving mass.

    \b
    Example:
      redundancy-pin design --robot 2rpr --set end_effector_mass=0.5 --task circle:speed=0.5 --task line:speed=0.2 \
        --vary carrier_mass=0.5:3 --vary track_offset=0.05:0.2 --parameter objective=peak --parameter dt=0.01
    """
    ranges = dict(map(_range, given["ranges"]))
    parameters = planner_parameters(given["parameters"])
    folder = expanded(given["out"] or f"design-{Path(given['robot']).stem}")
    robot = load(given["robot"], given["mode"] or (), plain(**given["settings"]), given["gravity"], given["trust"])
    backend = given["backend"] or (VIRTUAL_WORK if robot.closed_form else RNEA)
    dynamics = BACKENDS[backend](robot)
    tasks = {}
    for text in given["tasks"]:
        name, own = trajectory_of(text)
        tasks[text] = DesignTask(dynamics, options.make_trajectory(name, own), parameters)
    with progress("design") as advance:
        steps = iter(range(10**6))
        total = (len(tasks) + 1) * (given["iterations"] + 1) + 1
        records = compare_machines(
            tasks,
            ranges,
            iterations=given["iterations"],
            progress=lambda line: advance(min(next(steps), total - 1), total, line),
        )
    found = _table(records, tuple(ranges))
    facts = {"robot": given["robot"], "ranges": ranges, "parameters": parameters, "records": records}
    make_folder(folder)
    write_text(folder / "design.md", f"# Machines for {', '.join(tasks)}\n\n{found.markdown()}\n")
    write_text(folder / "design.csv", found.csv())
    write_text(folder / "design.json", json.dumps(json_data(facts), indent=2, allow_nan=False) + "\n")
    written = f"Tables are in {folder}: design.md, design.csv, design.json."
    report(given["as_json"], json_data({**facts, "folder": str(folder)}), found, written)


def _table(records: list[dict[str, Any]], names: tuple[str, ...]) -> Table:
    return table("machines", records, "what tasks cost", [Column(name, name, format=".4g") for name in names])


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, separator, ends = (part.strip() for part in text.partition("="))
    try:
        low, high = (float(part) for part in ends.split(":"))
    except ValueError:
        separator = ""
    if not (name and separator):
        raise InputError(f"--vary {shown(text)} is not NAME=LOW:HIGH.", remedy="Write --vary carrier_mass=0.5:3.")
    return name, (low, high)
