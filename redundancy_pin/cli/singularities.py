"""``redundancy-pin singularities``: where they are in the workspace, and when a motion meets them."""

from __future__ import annotations

from typing import Any

import click

from redundancy_pin.cli import options, output
from redundancy_pin.errors import InputError
from redundancy_pin.io.summary import Summary, TextTable, row
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.singularities.classify import SingularityKind
from redundancy_pin.singularities.crossings import Crossing, find_crossings
from redundancy_pin.singularities.locus import singular_locus
from redundancy_pin.trajectory import Trajectory
from redundancy_pin.visualisation.figures.maps import plot_workspace
from redundancy_pin.visualisation.figures.style import save

_DRAWN_STEP = 1e-3
"""Sampling interval of a trajectory in the picture, as a fraction of its duration."""

_FACTS = ("t", "until", "x", "crosses", "tangential", "leg", "uncontrolled_twist", "lost_direction")


@click.command()
@options.robot_options()
@options.motion_options("to search")
@click.option("--plot", metavar="PICTURE", help="Draw the singularities over the workspace (.png, .svg or .pdf).")
@options.json_option
def singularities(robot: options.RobotOptions, motion: options.MotionOptions, plot: str | None, as_json: bool) -> None:
    r"""Find singularities: a map, instants of a motion.

    Type I: some platform velocity is lost. Type II: some platform velocity is not controlled by the actuators. The
    instants come from root finding, not from the nearest sample. The motion is drawn into the picture.

    \b
    Examples:
      redundancy-pin singularities --robot 3rrr --working-mode +++ --plot locus.png
      redundancy-pin singularities --robot 2rpr --motion circle:speed=0.5
    """
    if not (motion.given or plot):
        raise InputError("No task given.", remedy="Ask for --plot or --motion.")
    output.require_outputs(None, (), plot)
    with output.progress("singularities") as advance:
        advance(0, 3, "reading")
        loaded = robot.load()
        followed = motion.follow("The search along a motion", loaded) if motion.given else None
        advance(1, 3, "along the motion")
        crossings = find_crossings(loaded, followed) if followed is not None else ()
        advance(2, 3, "over the workspace")

        def draw(path: str) -> None:
            save(plot_workspace(locus, motion=_drawn(followed), crossings=crossings), path)

        locus: Any = singular_locus(loaded) if plot else None
        plot, failed = output.drawn(plot, draw)
    table = TextTable(
        f"{loaded.name}: {len(crossings)} singular instant(s)",
        [_row(crossing) for crossing in crossings],
        ("t [s]", "position [m, rad]", "kind", "crossed or touched", "uncontrolled or lost direction"),
    )
    lines = [f"The motion is {motion.described}."] if motion.file else []
    lines += [f"The picture is {plot}."] if plot else []
    data = [
        {**{name: getattr(crossing, name) for name in _FACTS}, "kind": crossing.kind.label} for crossing in crossings
    ]
    facts: dict[str, Any] = {"robot": loaded.name, "motion": motion.described if motion.given else None, "plot": plot}
    facts |= {"ends": getattr(followed, "ends", None), "crossings": None if followed is None else data}
    found = None if locus is None else locus.summary()
    facts["locus"] = found
    tables = [*([] if found is None else found.tables), *([] if followed is None else [table])]
    summary = Summary(facts, *tables, warnings=[] if found is None else found.warnings)
    output.report(as_json, summary, *lines, failed=failed)


def _drawn(followed: PlatformMotion | Trajectory | None) -> Any:
    """Return the coordinates to draw; instants come from the trajectory itself."""
    if isinstance(followed, Trajectory):
        followed = followed.sample(_DRAWN_STEP * followed.duration)
    return None if followed is None else followed.x


def _row(crossing: Crossing) -> tuple[str, ...]:
    time = f"{crossing.t:.9g}" if crossing.until == crossing.t else f"{crossing.t:.9g} to {crossing.until:.9g}"
    type_ii = crossing.kind != SingularityKind.TYPE_I
    direction = crossing.uncontrolled_twist if type_ii else crossing.lost_direction
    place = row(crossing.x[:3, 3] if crossing.x.ndim == 2 else crossing.x)
    return time, place, crossing.kind.label, "crossed" if crossing.crosses else "touched", row(direction)
