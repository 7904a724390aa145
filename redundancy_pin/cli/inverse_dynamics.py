"""``redundancy-pin inverse-dynamics``: the efforts along a motion, as a CSV file."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import click
import numpy as np

from redundancy_pin.cli import options, output
from redundancy_pin.dynamics.arguments import require_matching_carriers
from redundancy_pin.dynamics.backends import backend_of
from redundancy_pin.dynamics.inverse_dynamics import inverse_dynamics as efforts_along
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot.loads import Load, Payload, Wrench
from redundancy_pin.visualisation.figures.curves import curves
from redundancy_pin.visualisation.figures.plots import efforts
from redundancy_pin.visualisation.figures.style import save

STEP = 1e-3
"""Default time between samples of a trajectory, s."""


def _loads(make: Callable[[str, list[float]], Load], sizes: tuple[int, int]) -> Callable[..., tuple[Load, ...]]:
    """Return a callback of click for ``LINK=NUMBER,...``, with one of two counts of numbers."""

    def read(option: click.Option, text: str) -> Load:
        link, _, values = text.rpartition("=")
        parts = np.atleast_1d(options.numbers(f"{option.name} of {link}", values)).tolist() if link else []
        if len(parts) not in sizes:
            raise options.refusal(str(option.name), text, f"not {option.metavar}", f"--{option.name} {option.metavar}")
        return make(link.strip(), parts)

    return lambda _context, option, texts: tuple(read(option, text) for text in texts)


def _payload(link: str, given: list[float]) -> Payload:
    return Payload(link, given[0], given[1:] or (0.0, 0.0, 0.0))


def _wrench(link: str, given: list[float]) -> Wrench:
    return Wrench(link, [*given, *[0.0] * (6 - len(given))])


@click.command("inverse-dynamics")
@options.robot_options()
@options.backend_option()
@options.motion_options("to follow")
@click.option("--dt", type=float, metavar="SECONDS", help=f"Between samples of the trajectory.  [default: {STEP:g}]")
@click.option("--out", metavar="CSV", help="Where the efforts go.")
@click.option("--plot", metavar="PICTURE", help="Draw the efforts over time (.png, .svg or .pdf).")
@options.keyword_options(efforts_along, only=("unreachable", "upper", "lower", "preferred"))
@click.option("--payload", multiple=True, metavar="LINK=MASS[,X,Y,Z]", callback=_loads(_payload, (1, 4)),
              help="Mass, kg, that a link carries, and where in its frame, m. May be repeated.")  # fmt: skip
@click.option("--wrench", multiple=True, metavar="LINK=FX,FY,FZ[,MX,MY,MZ]", callback=_loads(_wrench, (3, 6)),
              help="Force, N, and moment, N·m, on a link, in axes of the world. May be repeated.")  # fmt: skip
@options.json_option
def inverse_dynamics(
    robot: options.RobotOptions,
    backend: str | None,
    motion: options.MotionOptions,
    dt: float | None,
    out: str | None,
    plot: str | None,
    payload: tuple[Load, ...],
    wrench: tuple[Load, ...],
    as_json: bool,
    **keywords: Any,
) -> int:
    r"""Compute the efforts along a motion.

    Those of the main actuators and of the carriers. The motion has a row of names, with units such as `x [mm]` or
    without (then SI): t; x, y, z, rx, ry, rz; rates xd, ...; accelerations xdd, ...; and for each carrier s:JOINT,
    sd:JOINT, sdd:JOINT. Without carrier columns the carriers are parked at s = 0. A spatial platform has x, y, z, qx,
    qy, qz, qw, position and unit quaternion, and six rates, its twist in world axes; a robot without a platform has
    x:JOINT, .... An instant may occur twice, for the acceleration before and after a jump. A file without rates is
    passed as a trajectory through its points.

    The CSV has the columns of the motion, which --motion reads again, tau:JOINT for each actuator and carrier,
    status, margin, residual. Where no finite effort exists, or none within the bounds, tau is nan and the status says
    why. --upper 40 bounds no negative effort; --lower=-40 --upper 40 does.

    What the samples do not show is reported as well: singularities between them, and joints that leave their limits.
    The exit code is 3 where no such effort exists, at a sample or between two, 4 where the motion cannot
    be followed between its samples.

    \b
    Example:
      redundancy-pin inverse-dynamics --robot 3rrr --set carrier_mass=2.0 \
          --motion motion.csv --out efforts.csv
      redundancy-pin inverse-dynamics --robot 2rpr --motion way.csv:speed=0.1 --out efforts.csv
      redundancy-pin inverse-dynamics --robot two_arms.yaml --motion motion.csv --payload bar=2 \
          --preferred 0,0,0,5,0,0 --lower=-40 --upper 40 --out efforts.csv
    """
    output.require_outputs(out, (".csv",), plot, (motion.file,))
    given = {name: value for name, value in keywords.items() if value is not None}
    with output.progress("inverse dynamics") as advance:
        loaded = robot.load()
        loaded = loaded.loaded(*payload, *wrench) if payload or wrench else loaded
        dynamics = options.dynamics_of(loaded, backend)
        advance(0, 1, "reading")
        followed = motion.follow("Inverse dynamics", loaded, dt=dt)
        samples = followed if isinstance(followed, PlatformMotion) else followed.sample(STEP if dt is None else dt)
        carriers = require_matching_carriers(loaded, motion.carriers(loaded), len(samples))
        advance(0, len(samples), "dynamics")
        result = efforts_along(dynamics, samples, carriers, **given)
        if out:
            result.to_csv(out)

        def draw(path: str) -> None:
            drawn = curves(loaded, result.reduced, result.efforts, carriers, bounds=result.bounds)
            save(efforts(replace(drawn, instants=tuple(one.t for one in result.instants))), path)

        plot, failed = output.drawn(plot, draw)
        advance(len(samples), len(samples), "dynamics")
    facts, by = result.summary(), backend_of(dynamics)
    more = {"backend": by, "motion": motion.described, "ends": getattr(followed, "ends", None)}
    output.report(
        as_json, facts, by=by, files={"out": ("efforts", out), "plot": ("picture", plot)}, failed=failed, **more
    )
    return output.EXIT_CODES[result.status]
