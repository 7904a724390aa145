"""``redundancy-pin new``: a declaration of a model file, with a question for all that the file leaves open."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from redundancy_pin.arrays import decimal
from redundancy_pin.cli.errors import BAD_INPUT, printable
from redundancy_pin.cli.options import json_option, settings_option, trust_option, untrusted_option
from redundancy_pin.cli.output import report, warning
from redundancy_pin.errors import InputError, shown
from redundancy_pin.io.files import require_writable, write_text

if TYPE_CHECKING:
    from redundancy_pin.robot import Robot
    from redundancy_pin.robot.propose import Proposal


_FIRST_LINE = "# Written by `redundancy-pin new`.\n"


def _names(_context: click.Context, _option: click.Parameter, text: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


def _positions(context: click.Context, option: click.Parameter, text: str | None) -> dict[str, float]:
    pairs = [each.rpartition("=") for each in _names(context, option, text)]
    try:
        return {name.strip(): decimal(value) for name, _, value in pairs}
    except ValueError:
        raise InputError(f"--guess {shown(text)} is not JOINT=VALUE,...", remedy="Write numbers, rad or m.") from None


@click.command()
@click.argument("path", metavar="FILE")
@click.option(
    "--close", multiple=True, metavar="A,B[,KIND]", help="Links whose origins meet in a ball or KIND; may be repeated."
)
@click.option("--open", "is_open", is_flag=True, help="Close no loops but those that are stated or named here.")
@click.option("--actuate", metavar="A,B,...", callback=_names, help="Joints that are driven.")
@click.option("--carrier", "carriers", metavar="A,B,...", callback=_names, help="Joints of masses that balance.")
@click.option("--independent", metavar="A,B,...", callback=_names, help="Independent joints.  [default: chosen]")
@click.option("--guess", metavar="A=VALUE,...", callback=_positions, help="Where joints are near the reference.")
@settings_option("--set", "settings", "Argument of the file, such as base=free; may be repeated.")
@click.option("--out", metavar="FILE", help="What to write.  [default: robot.yaml beside the model]")
@trust_option
@untrusted_option
@json_option
def new(
    path: str, out: str | None, settings: dict[str, Any], trust: bool, untrusted: bool, as_json: bool, **decided: Any
) -> int:
    r"""Write a robot.yaml for a model file.

    The file may be a URDF, xacro, MJCF, SDF, or a robot.yaml of example-parallel-robots. The loops and motors that it
    states are listed, and those that names and places tell without doubt. Everything else is a question, with the flags
    that answer it; the robot.yaml does not load before they are answered, and the exit code is 2. Without KIND, --close
    is a ball where a hinge would be the same. Arguments of the file (--set) are not part of the robot.yaml, which says
    so: they are given whenever it is loaded.

    \b
    Example:
      redundancy-pin new machine.urdf --close left_tip,right_tip --actuate motor_1,motor_2
    """
    from redundancy_pin.loading import load_with, propose_robot
    from redundancy_pin.robot.checks import too_few_motors
    from redundancy_pin.robot.model_files import is_model_file, is_urdf

    source = Path(path)
    target = require_writable(out or source.parent / "robot.yaml")
    if target.exists() and not _is_undecided(target):
        raise InputError(f"{target} is there already.", remedy="Pass --out, or move it away.", path=str(target))
    if not is_urdf(source) and source.exists() and not is_model_file(source):
        raise InputError(f"{path} is no model of a robot.", remedy="Pass a URDF, xacro, MJCF or SDF file.")
    proposal, robot = propose_robot(source, settings, trust=trust, untrusted=untrusted, **decided)
    place = source.name if target.resolve().parent == source.resolve().parent else str(source.resolve())
    is_near_guess = is_urdf(source) or bool(decided["guess"])
    write_text(target, _declaration(proposal, robot, place, settings, is_near_guess=is_near_guess))
    mechanism, notes, outcome = proposal.mechanism, proposal.mechanism.notes, "it loads when all is decided"
    if robot and not proposal.questions:
        loaded = load_with(target, settings, trust=trust, untrusted=untrusted)
        notes = (*loaded.notes, *filter(None, [too_few_motors(loaded)]))
        outcome = f"n = {loaded.n}, m = {loaded.m}"
    facts = {
        "out": str(target),
        "loops": [{"name": each.name, "kind": each.kind, "links": each.links} for each in mechanism.loop_joints],
        "found": dict(proposal.found),
        "frames": proposal.frames,
        "actuated": mechanism.actuated if proposal.motors else [],
        "motors": proposal.motors,
        "carriers": mechanism.carriers,
        "independent": robot.independent_joints if robot else [],
        "notes": notes,
        "undecided": proposal.questions,
    }
    for question in proposal.questions:
        warning(f"undecided: {question}")
    report(as_json, facts, *proposal.listed(), *notes, f"{target}: {outcome}.")
    return BAD_INPUT if proposal.questions else 0


def _is_undecided(path: Path) -> bool:
    """Return whether a file is one of this command whose questions are open."""
    text = path.read_text(encoding="utf-8", errors="replace") if path.is_file() else ""
    return text.startswith(_FIRST_LINE) and "\nundecided:\n" in text


def _declaration(
    proposal: Proposal, robot: Robot | None, path: str, settings: Mapping[str, Any], *, is_near_guess: bool
) -> str:
    """Return the text of the declaration; what is not certain is left out, or a question under ``undecided``.

    ``is_near_guess``: the reference is near a guess, and not where the file starts.
    """
    import jinja2

    from redundancy_pin.loading.reference import reference_positions
    from redundancy_pin.robot.lookup import joint_names
    from redundancy_pin.robot.model_files import is_urdf

    positions, independent = {}, list[str]()
    if robot and is_near_guess:
        at = reference_positions(robot)
        positions = {name: round(value, 9) for name, value in at.items() if name not in robot.carriers}
    if robot:
        independent = list(robot.independent_joints)
    if proposal.questions or not set(independent) <= {*joint_names(proposal.mechanism.model)}:
        independent = []  # not known, or of hinges that stand for a ball of the file
    environment = jinja2.Environment(loader=jinja2.PackageLoader("redundancy_pin.cli", ""), trim_blocks=True)
    environment.filters["quoted"] = lambda value: json.dumps(value, ensure_ascii=False)
    environment.filters["printable"] = printable
    arguments = " ".join(
        f"--set {name}={str(value).lower() if value in (True, False) else value}" for name, value in settings.items()
    )
    given = {
        "arguments": arguments,
        "path": path,
        "is_urdf": is_urdf(Path(path)),
        "positions": positions,
        "independent": independent,
    }
    text: str = environment.get_template("robot.yaml.j2").render(proposal=proposal, **given)
    return text + "\n"
