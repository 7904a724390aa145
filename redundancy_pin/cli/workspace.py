"""``redundancy-pin workspace``: where the platform can go, and how far from singularities it is there."""

from __future__ import annotations

from typing import Any

import click

from redundancy_pin.cli import options, output
from redundancy_pin.errors import InputError
from redundancy_pin.singularities.workspace import workspace as reached
from redundancy_pin.visualisation.figures.maps import plot_workspace
from redundancy_pin.visualisation.figures.style import save


@click.command()
@options.robot_options()
@click.option("--free", metavar="NAMES", help="Coordinates that vary, such as x,z.  [default: all translations]")
@click.option(
    "--bounds", metavar="LOW:HIGH,...", help="Of each free coordinate, m or rad.  [default: the whole workspace]"
)
@options.keyword_options(reached, only=("at", "resolution"))
@click.option("--all-modes", is_flag=True, help="All working modes, not the robot's own alone.")
@click.option("--out", metavar="CSV", help="Where the nodes go.")
@click.option("--plot", metavar="PICTURE", help="Draw it (.png, .svg or .pdf).")
@options.json_option
def workspace(
    robot: options.RobotOptions,
    free: str | None,
    bounds: str | None,
    all_modes: bool,
    out: str | None,
    plot: str | None,
    as_json: bool,
    **given: Any,
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
    ranges: Any = None if bounds is None else [_pair(part) for part in bounds.split(",")]
    with output.progress("workspace") as advance:
        loaded = robot.load()
        advance(0, 2, "grid")
        space = reached(
            loaded,
            free=None if free is None else free.split(","),
            bounds=ranges,
            modes="all" if all_modes else "own",
            **given,
        )
        advance(1, 2, "writing")
        if out:
            space.to_csv(out)
        plot, failed = output.drawn(plot, lambda path: save(plot_workspace(space), path))
    output.report(as_json, space.summary(), files={"out": ("nodes", out), "plot": ("picture", plot)}, failed=failed)


def _pair(text: str) -> tuple[float, float]:
    low, _, high = text.partition(":")
    try:
        return options.number("bounds", low), options.number("bounds", high)
    except InputError:
        raise options.refusal("bounds", text, "not LOW:HIGH", "-0.4:0.4,0.2:0.9, for each free coordinate") from None
