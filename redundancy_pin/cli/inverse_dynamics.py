"""``redundancy-pin inverse-dynamics``: the efforts along a motion in a CSV file."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import click
import numpy as np
from numpy.typing import NDArray

from redundancy_pin.arrays import Array
from redundancy_pin.cli import options, output
from redundancy_pin.cli.errors import OPTIONS, in_words
from redundancy_pin.cli.plan_problem import numbers
from redundancy_pin.dynamics.arguments import OnUnreachable, require_matching_carriers
from redundancy_pin.dynamics.backends import backend_of
from redundancy_pin.dynamics.inverse_dynamics import InverseDynamics
from redundancy_pin.dynamics.inverse_dynamics import inverse_dynamics as efforts_along
from redundancy_pin.errors import InputError, OutputError
from redundancy_pin.io.files import require_writable, write_text
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.robot import Robot
from redundancy_pin.robot.loads import Load
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory.csv_file import csv_rows, effort_columns, motion_columns

STEP = 1e-3  # between samples of a trajectory, s
EXIT_CODES = {ResultStatus.OK: 0, ResultStatus.UNBOUNDED: 3, ResultStatus.UNRESOLVED: 4}
_LISTED = 10  # instants that a warning names
_FLAGS = {"unreachable": "--unreachable", "dt": "--dt", "lower": "--min-effort", "upper": "--max-effort",
          "preferred": "--preferred"}  # fmt: skip


def _numbers(name: str) -> Any:
    return lambda _context, _option, text: None if text is None else numbers(name, text)


@click.command("inverse-dynamics")
@options.robot_options()
@options.backend_option()
@options.motion_options(f"Motion to follow: {options.MOTION_CSV}", "Trajectory to follow instead, carriers parked")
@click.option("--dt", type=float, metavar="SECONDS", help=f"Between samples of the trajectory.  [default: {STEP:g}]")
@click.option("--out", required=True, metavar="CSV", help="Where the efforts go.")
@click.option(
    "--unreachable",
    type=click.Choice(["raise", "mark"]),
    default="raise",
    show_default=True,
    help="Refuse a motion that leaves the workspace, or mark those samples.",
)
@click.option("--max-effort", "upper", metavar="E[,E...]", callback=_numbers("--max-effort"),
              help="Bound of the main efforts, N or N·m, of both signs unless --min-effort is given.")  # fmt: skip
@click.option("--min-effort", "lower", metavar="E[,E...]", callback=_numbers("--min-effort"),
              help="Smallest main efforts, such as a preload against backlash.")  # fmt: skip
@click.option("--preferred", metavar="E[,E...]", callback=_numbers("--preferred"),
              help="Main efforts kept to where the motion leaves a choice, such as a squeeze.")  # fmt: skip
@options.load_options
@options.json_option
def inverse_dynamics(
    robot: options.RobotOptions,
    backend: str | None,
    motion: options.MotionOptions,
    dt: float | None,
    out: str,
    unreachable: OnUnreachable,
    upper: Any,
    lower: Any,
    preferred: Any,
    loads: Sequence[Load],
    as_json: bool,
) -> int:
    r"""Compute the efforts along a motion.

    Those of the main actuators and of the carriers. The motion has a row of names, with units such as `x [mm]` or
    without (then SI): t; x, y, z, rx, ry, rz; rates xd, ...; accelerations xdd, ...; and for each carrier s:JOINT,
    sd:JOINT, sdd:JOINT. Without carrier columns the carriers are parked at s = 0. A spatial platform has x, y, z, qx,
    qy, qz, qw, position and unit quaternion, and six rates, its twist in world axes; a robot without a platform has
    x:JOINT, .... An instant may occur twice, for the acceleration before and after a jump. A file without rates is
    passed as a trajectory through its points.

    The result has the columns of the motion, which --motion reads again, tau:JOINT for each actuator and carrier,
    status, margin, residual. Where no finite effort exists, or none within the bounds, tau is nan and the status says
    why.

    What the samples do not show is reported as well: singularities between them, and joints that leave their limits.
    The exit code is 3 where no such effort exists, at a sample or between two, 4 where the motion cannot
    be followed between its samples.

    \b
    Example:
      redundancy-pin inverse-dynamics --robot 3rrr --set carrier_mass=2.0 \
          --motion motion.csv --out efforts.csv
      redundancy-pin inverse-dynamics --robot 2rpr --trajectory way.csv:speed=0.1 --out efforts.csv
      redundancy-pin inverse-dynamics --robot two_arms.yaml --motion motion.csv --payload bar=2 \
          --preferred 0,0,0,5,0,0 --max-effort 40 --out efforts.csv
    """
    # whatever is wrong with the output is reported before the work, and a motion is never written over
    if motion.file and output.same_file(motion.file, out):
        raise OutputError("--out is the file of the motion.", remedy="Give it another name.", path=out)
    output.require_suffix("--out", out, ".csv")
    require_writable(out)
    with (
        output.progress("inverse dynamics") as advance,
        in_words(OPTIONS.knowing(_FLAGS if lower is not None else {**_FLAGS, "lower": "--max-effort"})),
    ):
        if lower is None and upper is not None and (np.asarray(upper) < 0.0).any():
            raise InputError(
                f"--max-effort is {np.min(upper):g}, and counts for both signs.",
                remedy="Pass zero or more, or --min-effort as well.",
            )
        loaded = robot.load()
        loaded = loaded.loaded(*loads) if loads else loaded
        dynamics = options.dynamics_of(loaded, backend)
        used = backend_of(dynamics)
        wanted = {"upper": upper, "lower": -upper if lower is None and upper is not None else lower}
        advance(0, 1, "reading")
        followed = motion.follow("Inverse dynamics", loaded, dt=dt)
        samples = followed if isinstance(followed, PlatformMotion) else followed.sample(STEP if dt is None else dt)
        carriers = require_matching_carriers(loaded, motion.carriers(loaded), len(samples))
        advance(0, len(samples), "dynamics")
        result = efforts_along(dynamics, samples, carriers, unreachable=unreachable, preferred=preferred, **wanted)
        write_text(out, csv_rows(_columns(loaded, samples, carriers, result)))
        advance(len(samples), len(samples), "dynamics")
    _warn(result)
    facts: dict[str, Any] = {
        "robot": loaded.name,
        "backend": used,
        "motion": motion.described,
        "ends": getattr(followed, "ends", None),
    }
    facts |= {"out": out, **_summary(result)}
    main, moved = robot_record(loaded).effort_units
    rows = [("motion", motion.described)]
    rows += [(f"{name} samples", str(count)) for name, count in facts["statuses"].items()]
    rows.append((f"largest |tau| [{main}]", output.row(facts["largest_tau"])))
    if loaded.k:
        rows.append((f"largest |carrier force| [{moved}]", output.row(facts["largest_carrier_force"])))
    rows += [("smallest margin", f"{facts['smallest_margin']:.6g}"), ("whole motion", result.status.value)]
    if result.instants:
        rows.append(("singular at t [s]", output.row(one.t for one in result.instants)))
    rows.append(("written to", out))
    output.report(as_json, facts, output.TextTable(f"{loaded.name}, {used}: {len(samples)} samples", (), rows))
    return EXIT_CODES[result.status]


def _columns(
    robot: Robot, motion: PlatformMotion, carriers: CarrierMotion, result: InverseDynamics
) -> dict[str, tuple[str, NDArray[Any]]]:
    """Return the columns of a file: unit and values of the motion, the efforts, and what is said of each sample."""
    efforts, forces = result.efforts, result.reduced.carrier_force
    return {
        **motion_columns(robot, motion, carriers),
        **effort_columns(robot.actuated, efforts.tau, robot),
        **effort_columns(robot.carriers, forces, robot),
        "status": ("", efforts.status_labels), "margin": ("", efforts.margin), "residual": ("N", efforts.residual)
    }  # fmt: skip


def _warn(result: InverseDynamics) -> None:
    """Print on stderr where no finite efforts are, and what the samples do not show, a line each."""
    unbounded = [one for one in result.instants if one.unbounded]
    if unbounded:
        listed = ", ".join(f"{one.t:.9g}" for one in unbounded[:_LISTED])
        more = f" and {len(unbounded) - _LISTED} more instants" if len(unbounded) > _LISTED else ""
        worst = max(unbounded, key=lambda one: one.residual)
        what = "det W changes sign" if any(one.crosses for one in unbounded) else "W loses rank"
        output.warning(
            f"no finite main efforts at t = {listed} s{more}: {what} there, at a type II singularity; "
            f"{worst.residual:.4g} N (scaled) are left that no actuator can carry. Beside it they grow without bound."
        )
    if result.unresolved:
        output.warning(f"between its samples the motion cannot be followed: {result.unresolved}")
    for excess in result.joint_limits:
        output.warning(f"{excess}.")
    reduced, efforts = result.reduced, result.efforts
    without = np.flatnonzero(~np.isfinite(efforts.tau).all(axis=1))
    if len(without):
        first = f"t = {reduced.t[without[0]]:.6g} s ({efforts.status_labels[without[0]]})"
        output.warning(f"no finite main efforts at {len(without)} of {len(efforts)} samples, first at {first}.")


def _summary(result: InverseDynamics) -> dict[str, Any]:
    reduced, efforts = result.reduced, result.efforts
    return {
        "samples": len(efforts),
        "statuses": efforts.status_counts,
        "largest_tau": _largest(efforts.tau).tolist(),
        "largest_carrier_force": _largest(reduced.carrier_force).tolist(),
        "smallest_margin": float(np.fmin.reduce(efforts.margin)),
        "largest_closure_residual": float(np.fmax.reduce(reduced.residual)),
        "status": result.status.value,
        "singular_instants": [
            {**vars(one), "kind": one.kind.label, "status": one.status.label, "unbounded": one.unbounded}
            for one in result.instants
        ],
        "joint_limits": [vars(excess) for excess in result.joint_limits],
        "unresolved": result.unresolved or None,
    }


def _largest(values: Array) -> Array:
    """Return the largest magnitude in each column, NaN left out; NaN for a column that has nothing else."""
    return np.asarray(np.fmax.reduce(np.abs(values), axis=0))
