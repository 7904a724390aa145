"""``redundancy-pin workspace``: where the platform can go, and how far from singularities it is there."""

from __future__ import annotations

from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import decimal
from redundancy_pin.cli import options, output
from redundancy_pin.cli.errors import OPTIONS, in_words
from redundancy_pin.errors import InputError, shown
from redundancy_pin.io.files import write_text
from redundancy_pin.kinematics.coordinates import mode_name
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.singularities.workspace import Workspace
from redundancy_pin.singularities.workspace import workspace as reached
from redundancy_pin.trajectory.csv_file import checked_poses, coordinate_names, csv_rows, unit_of


@click.command()
@options.robot_options()
@click.option("--free", metavar="NAMES", help="Coordinates that vary, such as x,z.  [default: all translations]")
@click.option(
    "--at",
    metavar="X,Y,...",
    help="Coordinates that the slice goes through; of a pose position and unit quaternion x, y, z, w.  "
    "[default: the reference]",
)
@click.option(
    "--bounds", metavar="LOW:HIGH,...", help="Of each free coordinate, m or rad.  [default: the whole workspace]"
)
@click.option("--resolution", type=int, metavar="N", help="Nodes along each axis.  [default: 400, 100 or 25]")
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
    if out:
        output.require_suffix("--out", out, ".csv")
    output.require_outputs(out, plot, ())
    wanted: dict[str, Any] = {
        "free": None if free is None else free.split(","),
        "at": _numbers("--at", at),
        "bounds": None if bounds is None else [_numbers("--bounds", part, ":", 2) for part in bounds.split(",")],
    }
    words = {name: f"--{name}" for name in (*wanted, "resolution")}
    with output.progress("workspace") as advance, in_words(OPTIONS.knowing(words)):
        loaded = robot.load()
        if wanted["at"] and is_pose(loaded):
            if len(wanted["at"]) != 7:
                raise InputError(
                    f"--at has {len(wanted['at'])} numbers, and {loaded.name} moves through poses.",
                    remedy="Write seven: position and unit quaternion x, y, z, w.",
                )
            wanted["at"] = checked_poses(np.array([wanted["at"]]), "--at")[0]
        advance(0, 2, "grid")
        modes = "all" if all_modes else "own"
        space = reached(loaded, **wanted, resolution=resolution, modes=modes)
        advance(1, 2, "writing")
        if out:
            write_text(out, csv_rows(_columns(space)))
        failed = output.drawn(plot, lambda path: _draw(space, path))
        plot = None if failed else plot
    facts = _facts(space)
    unit = "·".join(space.units).replace("m·m·m", "m³").replace("m·m", "m²").replace("rad·rad", "rad²")
    rows = [
        (f"{name} [{one}]", f"{low:.6g} to {high:.6g}")
        for (name, (low, high)), one in zip(facts["bounds"].items(), space.units, strict=True)
    ]
    rows += [(f"size [{unit}]", f"{space.size:.6g}")]
    for mode, one in facts["modes"].items():
        parts = f", {one['islands']} island(s) not reached from the reference" if one["islands"] else ""
        rows.append(
            (mode or "nodes", f"{one['reachable']} of {facts['nodes']} reachable, {one['in_range']} in range{parts}")
        )
    rows += [("written to", path) for path in (out, plot) if path]
    facts |= {"out": out, "plot": plot}
    output.report(as_json, facts, output.TextTable(f"{loaded.name}: workspace over {', '.join(space.names)}", (), rows))
    if failed:
        raise failed


def _draw(space: Workspace, plot: str) -> None:
    from redundancy_pin.visualisation.figures.style import save
    from redundancy_pin.visualisation.figures.workspace_map import draw_workspace

    save(draw_workspace(space), plot)


def _numbers(flag: str, text: str | None, between: str = ",", count: int | None = None) -> list[float] | None:
    """Return numbers in a row; as many as ``count`` says.

    Raises:
        InputError: they are none.
    """
    if text is None:
        return None
    try:
        numbers = [decimal(part) for part in text.split(between)]
    except ValueError:
        numbers = []
    if not numbers or (count and len(numbers) != count):
        remedy = "Write LOW:HIGH for each free coordinate, such as -0.4:0.4,0.2:0.9." if count else "Write 0.1,0.2."
        raise InputError(f"{flag} has {shown(text)}, which is not {count or 'a row of'} numbers.", remedy=remedy)
    return numbers


def _columns(space: Workspace) -> dict[str, tuple[str, NDArray[Any]]]:
    """Return unit and values of the columns of a file."""
    x = space.x[:, :3, 3] if space.x.ndim == 3 else space.x
    many, names = len(space.modes), coordinate_names(space.robot)[: x.shape[1]]
    places = {name: (unit_of(space.robot, name), np.tile(x[:, k], many)) for k, name in enumerate(names)}
    values = {
        "reachable": space.reachable.astype(int),
        "in_range": space.in_range.astype(int),
        "margin": space.margin,
        "serial_margin": space.serial_margin,
        "island": space.island,
    }
    modes = np.repeat([mode_name(mode) if mode else "" for mode in space.modes], len(x))
    return {"mode": ("", modes), **places, **{name: ("", array.ravel()) for name, array in values.items()}}


def _facts(space: Workspace) -> dict[str, Any]:
    parts = zip(space.modes, space.reachable, space.in_range, space.island, strict=True)
    return {
        "robot": space.robot.name,
        "bounds": {name: [axis[0], axis[-1]] for name, axis in zip(space.names, space.axes, strict=True)},
        "nodes": int(space.reachable[0].size),
        "size": space.size,
        "modes": {
            mode_name(mode) if mode else "": {
                "reachable": int(reachable.sum()),
                "in_range": int(in_range.sum()),
                "islands": int(island.max(initial=0)),
            }
            for mode, reachable, in_range, island in parts
        },
    }
