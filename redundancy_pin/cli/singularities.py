"""``redundancy-pin singularities``: where they are in the workspace, and when a motion meets them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click

from redundancy_pin.cli import options, output
from redundancy_pin.cli.errors import OPTIONS, in_words
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Robot
from redundancy_pin.singularities.classify import SingularityKind
from redundancy_pin.singularities.crossings import Crossing, find_crossings
from redundancy_pin.singularities.locus import SingularLocus, singular_locus
from redundancy_pin.trajectory import Trajectory
from redundancy_pin.visualisation.figures.paths import draw_locus
from redundancy_pin.visualisation.figures.style import save

_DRAWN_STEP = 1e-3  # sampling interval of a trajectory in the picture, as a fraction of its duration


@click.command()
@options.robot_options()
@options.motion_options(f"Motion to search: {options.MOTION_CSV}", "Trajectory to search instead")
@click.option("--plot", metavar="PICTURE", help="Draw the singularities over the workspace (.png, .svg or .pdf).")
@options.json_option
def singularities(robot: options.RobotOptions, motion: options.MotionOptions, plot: str | None, as_json: bool) -> None:
    r"""Find singularities: a map, instants of a motion.

    Type I: some platform velocity is lost. Type II: some platform velocity is not controlled by the actuators. The
    instants come from root finding, not from the nearest sample. The motion is drawn into the picture.

    \b
    Examples:
      redundancy-pin singularities --robot 3rrr --mode +++ --plot locus.png
      redundancy-pin singularities --robot 2rpr --trajectory circle:speed=0.5
    """
    if not (motion.given or plot):
        raise InputError("There is nothing to do.", remedy="Ask for --plot, --motion or --trajectory.")
    if plot:
        output.require_picture(plot)
    with output.progress("singularities") as advance, in_words(OPTIONS.knowing({"find_crossings": "--motion"})):
        advance(0, 3, "reading")
        loaded = robot.load()
        followed = motion.follow("The search along a motion", loaded) if motion.given else None
        advance(1, 3, "along the motion")
        crossings = find_crossings(loaded, followed) if followed is not None else ()
        advance(2, 3, "over the workspace")
        failed = None
        if plot:
            locus = singular_locus(loaded)
            failed = output.drawn(plot, lambda path: _draw(locus, followed, crossings, path))
            plot = None if failed else plot
    shown: list[Any] = [_table(loaded, crossings)] if followed is not None else []
    shown += [f"The motion is {motion.described}."] if motion.file else []
    shown += [f"The picture is {plot}."] if plot else []
    data = [crossing_data(crossing) for crossing in crossings] if followed is not None else None
    facts: dict[str, Any] = {"robot": loaded.name, "motion": motion.described if motion.given else None}
    facts |= {"ends": getattr(followed, "ends", None), "crossings": data, "plot": plot}
    output.report(as_json, facts, *shown)
    if failed:
        raise failed


def crossing_data(crossing: Crossing) -> dict[str, Any]:
    """Return a crossing as plain data."""
    names = ("t", "until", "x", "crosses", "tangential", "leg", "uncontrolled_twist", "lost_direction")
    return {**{name: getattr(crossing, name) for name in names}, "kind": crossing.kind.label}


def _table(robot: Robot, crossings: Sequence[Crossing]) -> output.TextTable:
    rows = []
    for crossing in crossings:
        type_ii = crossing.kind != SingularityKind.TYPE_I
        direction = crossing.uncontrolled_twist if type_ii else crossing.lost_direction
        place = crossing.x[:3, 3] if crossing.x.ndim == 2 else crossing.x
        rows.append(
            (
                f"{crossing.t:.9g}" if crossing.until == crossing.t else f"{crossing.t:.9g} to {crossing.until:.9g}",
                output.row(place),
                crossing.kind.label,
                "crossed" if crossing.crosses else "touched",
                output.row(direction),
            )
        )
    headings = ("t [s]", "position [m, rad]", "kind", "crossed or touched", "uncontrolled or lost direction")
    return output.TextTable(f"{robot.name}: {len(crossings)} singular instant(s)", headings, rows)


def _draw(
    locus: SingularLocus, followed: PlatformMotion | Trajectory | None, crossings: Sequence[Crossing], plot: str
) -> None:
    # drawing only: instants come from the trajectory itself
    motion = followed.sample(_DRAWN_STEP * followed.duration) if isinstance(followed, Trajectory) else followed
    save(draw_locus(locus, motion=None if motion is None else motion.x, crossings=crossings), plot)
