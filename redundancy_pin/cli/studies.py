"""``redundancy-pin reproduce``, ``study``, ``trade``, ``design``: many plans, and a folder of results."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import click

from redundancy_pin.arrays import decimal
from redundancy_pin.cli import options
from redundancy_pin.cli.map import trajectory_of
from redundancy_pin.cli.output import drawn, progress, report, resumable
from redundancy_pin.cli.plan_problem import PARAMETERS, read_parameters
from redundancy_pin.dynamics.backends import VIRTUAL_WORK
from redundancy_pin.errors import InputError, shown
from redundancy_pin.io.files import expanded, write_text
from redundancy_pin.io.json_data import json_data
from redundancy_pin.planners.optimal.co_design import DesignTask, compare_machines
from redundancy_pin.planners.optimal.least_cost import TIME
from redundancy_pin.planners.registry import PLANNERS, WHOLE, in_groups
from redundancy_pin.studies.case import Case, load
from redundancy_pin.studies.case import options as as_options
from redundancy_pin.studies.reproduce import reproduce as run_job
from redundancy_pin.studies.reproduce import tables
from redundancy_pin.studies.robustness import DRAWS, robustness_study, study_caption, study_csv, study_table
from redundancy_pin.studies.store import FILE, make_folder
from redundancy_pin.studies.table import Column, Table, table
from redundancy_pin.studies.trade import BOUNDED, MINIMISED, trade_off
from redundancy_pin.visualisation.figures.style import require_matplotlib, save
from redundancy_pin.workers import cluster

_LEAST_TIME = "time-optimal"
"""Planner of paths, as the command line names it."""

_Command = TypeVar("_Command", bound=Callable[..., Any])

_SHOWN = {
    "motions": ("name", "samples", "parity", "smallest_margin", "statement"),
    "thesis": ("source", "experiment", "quantity", "stated", "computed", "unit"),
    "judged": ("source", "quantity", "stated", "ours", "verdict"),
    "conclusions": ("claim", "stands", "here"),
    "findings": ("claim", "stands", "here"),
    "study": ("scenario", "drive", "success", "largest", "worst", "statuses"),
}
"""By table, the columns that fit a terminal side by side; the files have all of them."""


@click.command()
@click.option("--out", default="results", show_default=True, metavar="FOLDER", help="Where the results go.")
@options.json_option
def reproduce(out: str, as_json: bool) -> None:
    r"""Run the experiments of the thesis.

    Both backends compute every case; CSV, figures, summary.json, report.md and
    report.html go into the folder.

    First the backends are checked against each other; if they disagree the job stops (exit code 1). The folder appears
    when everything is done. One of earlier results is replaced; one that holds anything else is left alone.

    \b
    Example:
      redundancy-pin reproduce --out results
    """
    with progress("reproduce") as advance:
        done = run_job(out, progress=advance)
    made = tables(done.results)
    shown_tables = [made[name].only(*columns) for name, columns in _SHOWN.items() if name in made]
    passed = f"cross-check passed: {len(done.results.check.rows)} checks"
    end = f"{passed}. Results are in {done.folder} (start with report.html or report.md)."
    report(as_json, done.summary, *shown_tables, end)


@click.command()
@click.option("--draws", default=DRAWS, show_default=True, metavar="N", help="Machines drawn for each cell.")
@click.option("--seed", default=0, show_default=True, metavar="N", help="Of the draws.")
@click.option("--severity", default=1.0, show_default=True, metavar="X", help="Factor on errors, friction and noise.")
@click.option("--jobs", type=int, default=None, metavar="N", help="Processes; all cores when left out.")
@options.scheduler_option
@click.option("--out", default="study", show_default=True, metavar="FOLDER", help="Where store and tables go.")
@options.json_option
def study(
    draws: int, seed: int, severity: float, jobs: int | None, scheduler: str | None, out: str, as_json: bool
) -> None:
    r"""Drive imperfect machines through singularities, many times.

    Masses, lengths, starts, friction, encoders and force noise are drawn at random; planned crossings are driven open
    loop, by computed torque and by LQR, digital and with a delay. Finished trials are in FOLDER/store.sqlite: the same
    command goes on where it was interrupted, and with more draws adds to it.

    \b
    Example:
      redundancy-pin study --draws 200 --out study
    """
    folder = expanded(out)
    with cluster(scheduler), resumable("study", "trials", folder / FILE) as advance:
        result = robustness_study(
            draws, seed=seed, severity=severity, jobs=jobs, journal=folder / FILE, progress=advance
        )
    extent = f"Seed {seed}, severity {severity:g}, {draws} {'draw' if draws == 1 else 'draws'} a cell."
    cells, caption = study_table(result), study_caption(result)
    summary = {"seed": seed, "severity": severity, "imperfections": asdict(result.imperfections)}
    summary |= {"cells": [asdict(cell) for cell in result.cells]}
    write_text(folder / "study.md", f"# Robustness\n\n{extent}\n\n{caption}\n\n{cells.markdown()}\n")
    write_text(folder / "trials.csv", study_csv(result))
    _write_json(folder / "summary.json", summary)
    files = f"Tables and store are in {folder}: study.md, trials.csv, summary.json, {FILE}."
    report(as_json, summary, extent, cells.only(*_SHOWN["study"]), caption, files)


def _machine(text: str) -> Callable[[_Command], _Command]:
    """Return the options of commands that plan over the whole trajectory; ``text`` is the help of --parameter."""
    repeated: Any = {"multiple": True, "metavar": "NAME=VALUE"}
    parameter = click.option("--parameter", "parameters", **repeated, help=f"Of `plan whole-trajectory`, {text}.")
    backend = options.backend_option(default="virtual-work where it can; otherwise as plan")
    return lambda command: options.robot_flags(backend(parameter(command)))


@click.command()
@_machine("such as end=free or acceleration=20; may be repeated")
@options.trajectory_option("Motion")
@click.option("--x", type=click.Choice(BOUNDED), default="energy", show_default=True, help="What is bounded.")
@click.option("--y", type=click.Choice(MINIMISED), default="peak", show_default=True, help="What is minimised.")
@click.option("--points", default=9, show_default=True, metavar="N", help="Bounds of x.")
@click.option("--between", metavar="LOW:HIGH", help="Bounds of x; shares of the tracks or of the time.")
@options.jobs_option(-1)
@click.option("--out", metavar="FOLDER", help="Where table and pictures go.  [default: trade-ROBOT]")
@options.json_option
def trade(**given: Any) -> None:
    r"""Draw a Pareto front of plans.

    y is minimised while x may not exceed a bound, for bounds from the least x to what x is where only y counts. Each
    point says what else it costs: peak effort, energy, force of the carriers and on the base, stroke, time.

    \b
    Examples:
      redundancy-pin trade --robot 3rrr --trajectory corner --x energy --y peak
      redundancy-pin trade --robot 3rrr --trajectory corner --x track --y peak --parameter end=free
    """
    require_matplotlib()
    if given["trajectory"] is None:
        raise InputError("A trade needs a motion.", remedy="Add --trajectory, such as --trajectory corner.")
    name, path_options = trajectory_of(given["trajectory"])
    robot = Path(given["robot"]).stem
    folder = expanded(given["out"] or f"trade-{robot}")
    parameters = _planner_parameters(given["parameters"], "objective", "at_most")
    step = parameters.pop("dt", 0.005)
    case = Case(
        name=f"{robot}-{name}",
        robot=given["robot"],
        path=name,
        path_options=as_options(**path_options),
        planner="whole_trajectory",
        options=as_options(**json_data(parameters)),
        working_mode=given["mode"] or (),
        arguments=as_options(**given["settings"]),
        dt=step,
        title=f"{robot}, {given['trajectory']}",
        gravity=given["gravity"],
        trust=given["trust"],
    )
    points, between = given["points"], given["between"]
    if between is not None:
        between = _ends(between, "--between", between, "LOW:HIGH", "0.2:1")
    with progress("trade") as advance:
        done = iter(range(1, points + 4))
        result = trade_off(
            case,
            given["x"],
            given["y"],
            points=points,
            between=between,
            backend=given["backend"],
            jobs=given["jobs"],
            tell=lambda text: advance(min(next(done, points + 2), points + 2), points + 2, text),
        )
    facts = {"x": result.x, "y": result.y, "robot": case.robot, **case.as_dict(), "points": result.points}
    _write(folder, "trade", f"{result.y} against {result.x}", result.table(), facts)
    pictures = [folder / "trade.svg", folder / "trade.png"]
    failed = drawn(str(pictures[0]), lambda _: save(result.draw(), *pictures))
    files = ["trade.md", "trade.csv", "trade.json", *([] if failed else [path.name for path in pictures])]
    written = f"Results are in {folder}: {', '.join(files)}."
    report(given["as_json"], {**facts, "folder": str(folder)}, result.table(), written)
    if failed:
        raise failed


@click.command()
@_machine("such as objective=peak or acceleration=20, or with objective=time of `plan time-optimal`; may be repeated")
@click.option("--task", "tasks", multiple=True, required=True, metavar="NAME|FILE[:KEY=VALUE,...]",
              help="Motion, as --trajectory of the other commands; may be repeated.")  # fmt: skip
@click.option("--vary", "ranges", multiple=True, required=True, metavar="NAME=LOW:HIGH",
              help="A number of the robot that is designed; may be repeated.")  # fmt: skip
@click.option("--iterations", default=30, show_default=True, metavar="N", help="Most machines of a search.")
@click.option("--out", metavar="FOLDER", help="Where the tables go.  [default: design-ROBOT]")
@options.json_option
def design(**given: Any) -> None:
    r"""Design a machine for several tasks.

    Numbers of the robot between bounds and the plans of all tasks are optimised together: for each task alone, and for
    all with one machine. The table says what each task costs by each machine: peak effort, energy and its part for the
    carriers, force of the carriers, stroke, moving mass. With objective=time the durations of the paths are minimised.

    \b
    Examples:
      redundancy-pin design --robot 3rrr --task corner --vary carrier_mass=0.5:5 --parameter objective=time \
        --parameter effort=3
      redundancy-pin design --robot 2rpr --set end_effector_mass=0.5 --task circle:speed=0.5 --task line:speed=0.2 \
        --vary carrier_mass=0.5:3 --vary track_offset=0.05:0.2 --parameter objective=peak --parameter dt=0.01
    """
    ranges = dict(map(_range, given["ranges"]))
    planner, parameters = _design_parameters(given["parameters"])
    grouped = in_groups(PLANNERS[planner], parameters) | ({"objective": TIME} if planner == _LEAST_TIME else {})
    folder = expanded(given["out"] or f"design-{Path(given['robot']).stem}")
    robot = load(given["robot"], given["mode"] or (), as_options(**given["settings"]), given["gravity"], given["trust"])
    dynamics = options.dynamics_of(robot, given["backend"] or (VIRTUAL_WORK if robot.closed_form else None))
    kinds = [text.partition(":")[0] for text in given["tasks"]]
    named = {kind if kinds.count(kind) == 1 else text: text for kind, text in zip(kinds, given["tasks"], strict=True)}
    tasks = {
        name: DesignTask(dynamics, options.make_trajectory(*trajectory_of(text)), grouped)
        for name, text in named.items()
    }
    with progress("design") as advance:
        steps = iter(range(10**6))
        total = (len(tasks) + 1) * (given["iterations"] + 1) + 1
        records = compare_machines(
            tasks,
            ranges,
            iterations=given["iterations"],
            progress=lambda line: advance(min(next(steps), total - 1), total, line),
        )
    costs = table("machines", records, "what tasks cost", [Column(name, name, format=".4g") for name in ranges])
    facts = {"robot": given["robot"], "tasks": named, "ranges": ranges, "parameters": parameters, "records": records}
    _write(folder, "design", f"Machines for {', '.join(tasks)}", costs, facts)
    written = f"Tables are in {folder}: design.md, design.csv, design.json."
    report(given["as_json"], {**facts, "folder": str(folder)}, costs, written)


def _write(folder: Path, stem: str, title: str, rows: Table, facts: Mapping[str, Any]) -> None:
    """Write a table as Markdown and CSV, and facts as JSON."""
    make_folder(folder)
    write_text(folder / f"{stem}.md", f"# {title}\n\n{rows.markdown()}\n")
    write_text(folder / f"{stem}.csv", rows.csv())
    _write_json(folder / f"{stem}.json", facts)


def _write_json(path: Path, facts: Mapping[str, Any]) -> None:
    write_text(path, json.dumps(json_data(facts), indent=2, allow_nan=False) + "\n")


def _design_parameters(texts: tuple[str, ...]) -> tuple[str, dict[str, Any]]:
    """Return the planner of a design and its parameters: that of least time for objective=time, which stands alone."""
    rest = tuple(text for text in texts if text.replace(" ", "") != f"objective={TIME}")
    planner = WHOLE if len(rest) == len(texts) else _LEAST_TIME
    return planner, _planner_parameters(rest, planner=planner)


def _planner_parameters(texts: tuple[str, ...], *refused: str, planner: str = WHOLE) -> dict[str, Any]:
    """Return parameters of a planner from NAME=VALUE; several of one name where it takes several."""
    values: dict[str, Any] = {}
    for text in texts:
        name, separator, value = (part.strip() for part in text.partition("="))
        if not (separator and name and value) or name in refused:
            rest = f" other than {', '.join(refused)}" if refused else ""
            raise InputError(
                f"--parameter {shown(text)} is not NAME=VALUE of a parameter{rest}.",
                remedy=f"Write --parameter end=free{'; the objective is --y' if refused else ''}.",
            )
        known = PARAMETERS[planner].get(name)
        values[name] = (*values.get(name, ()), value) if known and known.multiple else value
    return read_parameters(planner, values)


def _ends(text: str, flag: str, given: str, form: str, example: str) -> tuple[float, float]:
    """Return both numbers of LOW:HIGH; ``given`` is all that the flag was given, of which it is the end."""
    try:
        low, high = (decimal(part) for part in text.split(":"))
    except ValueError:
        raise InputError(f"{flag} {shown(given)} is not {form}.", remedy=f"Write {flag} {example}.") from None
    return low, high


def _range(text: str) -> tuple[str, tuple[float, float]]:
    name, _, ends = (part.strip() for part in text.partition("="))
    return name, _ends(ends if name else "", "--vary", text, "NAME=LOW:HIGH", "carrier_mass=0.5:3")
