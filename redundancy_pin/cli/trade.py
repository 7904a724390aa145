"""``redundancy-pin trade``: what one quantity costs in another."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from redundancy_pin.cli import options
from redundancy_pin.cli.map import trajectory_of
from redundancy_pin.cli.output import progress, report
from redundancy_pin.cli.plan_problem import PARAMETERS, read_parameters
from redundancy_pin.errors import InputError, shown
from redundancy_pin.io.files import expanded, write_text
from redundancy_pin.studies.case import WHOLE, Case
from redundancy_pin.studies.case import options as plain
from redundancy_pin.studies.store import make_folder
from redundancy_pin.studies.table import json_data
from redundancy_pin.studies.trade import BOUNDED, MINIMISED, trade_off
from redundancy_pin.visualisation.figures.style import require_matplotlib, save


@click.command()
@options.robot_flags
@options.backend_option(None, "How to compute; the robot's closed form where it has one.")
@options.trajectory_option("Motion")
@click.option("--x", type=click.Choice(BOUNDED), default="energy", show_default=True, help="What is bounded.")
@click.option("--y", type=click.Choice(MINIMISED), default="peak", show_default=True, help="What is minimised.")
@click.option("--points", default=9, show_default=True, metavar="N", help="Bounds of x.")
@click.option("--between", metavar="LOW:HIGH", help="Bounds of x; shares of the tracks or of the time.")
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME=VALUE",
    help="Of `plan whole-trajectory`, such as end=free or acceleration=20; may be repeated.",
)
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
    folder = expanded(given["out"] or f"trade-{Path(given['robot']).stem}")
    parameters = planner_parameters(given["parameters"], "objective", "at_most")
    step = parameters.pop("dt", 0.005)
    case = Case(
        name=f"{Path(given['robot']).stem}-{name}",
        robot=given["robot"],
        path=name,
        path_options=plain(**path_options),
        planner="whole_trajectory",
        options=plain(**json_data(parameters)),
        working_mode=given["mode"] or (),
        arguments=plain(**given["settings"]),
        dt=step,
        title=f"{Path(given['robot']).stem}, {given['trajectory']}",
        gravity=given["gravity"],
        trust=given["trust"],
    )
    between, points = _between(given["between"]), given["points"]
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
    make_folder(folder)
    found = result.table()
    facts = json_data({"x": result.x, "y": result.y, "robot": case.robot, **case.as_dict(), "points": result.points})
    write_text(folder / "trade.md", f"# {result.y} against {result.x}\n\n{found.markdown()}\n")
    write_text(folder / "trade.csv", found.csv())
    write_text(folder / "trade.json", json.dumps(facts, indent=2, allow_nan=False) + "\n")
    for suffix in (".svg", ".png"):
        save(result.draw(), folder / f"trade{suffix}")
    written = f"Table and pictures are in {folder}: trade.md, trade.csv, trade.json, trade.svg, trade.png."
    report(given["as_json"], {**facts, "folder": str(folder)}, found, written)


def planner_parameters(texts: tuple[str, ...], *refused: str) -> dict[str, Any]:
    """Return parameters of the whole-trajectory planner from NAME=VALUE; several of one name where it takes several."""
    values: dict[str, Any] = {}
    for text in texts:
        name, separator, value = (part.strip() for part in text.partition("="))
        if not (separator and name and value) or name in refused:
            rest = f" other than {', '.join(refused)}" if refused else ""
            raise InputError(
                f"--parameter {shown(text)} is not NAME=VALUE of a parameter{rest}.",
                remedy=f"Write --parameter end=free{'; the objective is --y' if refused else ''}.",
            )
        known = PARAMETERS[WHOLE].get(name)
        values[name] = (*values.get(name, ()), value) if known and known.multiple else value
    return read_parameters(WHOLE, values)


def _between(text: str | None) -> tuple[float, float] | None:
    if text is None:
        return None
    try:
        low, high = (float(part) for part in text.split(":"))
    except ValueError:
        raise InputError(f"--between {shown(text)} is not LOW:HIGH.", remedy="Write --between 0.2:1.") from None
    return low, high
