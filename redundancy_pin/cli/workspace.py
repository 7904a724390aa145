"""``redundancy-pin workspace``: where the platform can go, and how far from singularities it is there."""

from __future__ import annotations

from typing import Any

import click
import numpy as np

from redundancy_pin.arrays import decimal
from redundancy_pin.cli import options, output
from redundancy_pin.errors import InputError, shown
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.singularities.workspace import Workspace
from redundancy_pin.singularities.workspace import workspace as reached
from redundancy_pin.trajectory.csv_file import checked_poses


@click.command()
@options.robot_options()
@click.option("--free", metavar="NAMES", help="Coordinates that vary, such as x,z.  [default: all translations]")
@click.option("--at", metavar="X,Y,...", help="Coordinates that the slice goes through; of a pose position and unit "
              "quaternion x, y, z, w.  [default: the reference]")  # fmt: skip
@click.option(
    "--bounds", metavar="LOW:HIGH,...", help="Of each free coordinate, m or rad.  [default: the whole workspace]"
)
@options.keyword_options(reached, only=("resolution",))
@click.option("--all-modes", is_flag=True, help="All working modes, not the robot's own alone.")
@click.option("--out", metavar="CSV", help="Where the nodes go.")
@click.option("--plot", metavar="PICTURE", help="Draw it (.png, .svg or .pdf).")
@options.json_option
def workspace(
    robot: options.RobotOptions,
    free: str | None,
    at: str | None,
    bounds: str | None,
    resolution: int | None,
    all_modes: bool,
    out: str | None,
    plot: str | None,
    as_json: bool,
) -> None:
    r"""Map where the platform can go.

    One, two or three coordinates vary over a grid, the others stay as they are in the reference, or `at` another point.
    The CSV has a row for each node and working mode: mode; the coordinates, such as `x [m]` (a pose: x, y, z);
    reachable, in_range (all joints within their limits) as 0 or 1; margin to type II, serial_margin to type I, nan out
    of reach; island, 0 where the reference reaches.

    \b
    Examples:
      redundancy-pin workspace --robot five_bar --plot workspace.png
      redundancy-pin workspace --robot gough --free x,z --bounds -0.4:0.4,0.2:0.9 --resolution 40 --out nodes.csv
    """
    output.require_outputs(out, (".csv",), plot)
    point = None if at is None else _numbers("at", at, ",", "Write 0.1,0.2.")
    ranges: Any = None if bounds is None else [
        _numbers("bounds", part, ":", "Write LOW:HIGH for each free coordinate, such as -0.4:0.4,0.2:0.9.", 2)
        for part in bounds.split(",")
    ]  # fmt: skip
    with output.progress("workspace") as advance:
        loaded = robot.load()
        advance(0, 2, "grid")
        space = reached(
            loaded,
            free=None if free is None else free.split(","),
            at=None if point is None else _place(loaded, point),
            bounds=ranges,
            resolution=resolution,
            modes="all" if all_modes else "own",
        )
        advance(1, 2, "writing")
        if out:
            space.to_csv(out)
        failed = output.drawn(plot, lambda path: _draw(space, path))
        plot = None if failed else plot
    facts: dict[str, Any] = {**space.summary(), "out": out, "plot": plot}
    unit = "·".join(space.units)
    for kind in ("m", "rad"):
        unit = unit.replace(f"{kind}·{kind}·{kind}", f"{kind}³").replace(f"{kind}·{kind}", f"{kind}²")
    rows = [
        *(
            (f"{name} [{one}]", f"{low:.6g} to {high:.6g}")
            for (name, (low, high)), one in zip(facts["bounds"].items(), space.units, strict=True)
        ),
        (f"size [{unit}]", f"{space.size:.6g}"),
    ]
    for mode, one in facts["modes"].items():
        islands = f", {one['islands']} island(s) not reached from the reference" if one["islands"] else ""
        counts = f"{one['reachable']} of {facts['nodes']} reachable, {one['in_range']} in range{islands}"
        rows.append((mode or "nodes", counts))
    rows += [("written to", path) for path in (out, plot) if path]
    output.report(as_json, facts, output.TextTable(f"{loaded.name}: workspace over {', '.join(space.names)}", rows))
    if failed:
        raise failed


def _draw(space: Workspace, path: str) -> None:
    from redundancy_pin.visualisation.figures.style import save
    from redundancy_pin.visualisation.figures.workspace_map import draw_workspace

    save(draw_workspace(space), path)


def _numbers(name: str, text: str, between: str, remedy: str, count: int = 0) -> list[float]:
    """Return numbers in a row, as many as ``count`` says."""
    try:
        numbers = [decimal(part) for part in text.split(between)]
    except ValueError:
        numbers = []
    if not numbers or (count and len(numbers) != count):
        raise InputError(f"{name} has {shown(text)}, which is not {count or 'a row of'} numbers.", remedy=remedy)
    return numbers


def _place(robot: Robot, point: list[float]) -> Any:
    """Return the point of a slice; of a robot that moves through poses from position and quaternion."""
    if not is_pose(robot):
        return point
    if len(point) != 7:
        raise InputError(
            f"at has {len(point)} numbers, and {robot.name} moves through poses.",
            remedy="Write seven: position and unit quaternion x, y, z, w.",
        )
    return checked_poses(np.array([point]), "at")[0]
