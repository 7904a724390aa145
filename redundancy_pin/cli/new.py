"""``redundancy-pin new``: a declaration of a model file, with a question for all that the file leaves open."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from redundancy_pin.cli import options
from redundancy_pin.cli.errors import BAD_INPUT
from redundancy_pin.cli.output import report
from redundancy_pin.errors import InputError, RedundancyPinError
from redundancy_pin.io.files import require_writable, write_text
from redundancy_pin.io.summary import Summary
from redundancy_pin.robot.propose import KINDS

if TYPE_CHECKING:
    from redundancy_pin.robot import Robot


def _names(_context: click.Context, _option: click.Parameter, text: str | None) -> tuple[str, ...]:
    return tuple(name.strip() for name in (text or "").split(",") if name.strip())


def _platform(context: click.Context, option: click.Parameter, text: str | None) -> dict[str, Any]:
    from redundancy_pin.robot.types import AXES

    link, *axes = _names(context, option, text) or ("",)
    for axis in axes:
        options.require_choice(axis, AXES, "an axis of --platform")
    return {"platform": link, "axes": axes or ["x", "y"]} if link else {}


def _positions(context: click.Context, option: click.Parameter, text: str | None) -> dict[str, float]:
    pairs = [each.rpartition("=") for each in _names(context, option, text)]
    if not all(separator for _, separator, _ in pairs):
        raise options.refusal("guess", text, "not JOINT=VALUE,...", "numbers, rad or m")
    return {name.strip(): options.number(f"guess of {name}", value) for name, _, value in pairs}


@click.command()
@click.argument("path", metavar="FILE")
@click.option("--close", multiple=True, metavar="A,B[,KIND]",
              help=f"Links whose origins meet: a ball, or KIND of {', '.join(KINDS)}. May be repeated.")  # fmt: skip
@click.option("--open", "is_open", is_flag=True, help="Close no loops but those that are stated or named here.")
@click.option("--actuate", metavar="A,B,...", callback=_names, help="Joints that are driven.")
@click.option("--carrier", "carriers", metavar="A,B,...", callback=_names, help="Joints of masses that balance.")
@click.option("--independent", metavar="A,B,...", callback=_names, help="Independent joints.  [default: chosen]")
@click.option("--platform", metavar="LINK[,x,y]", callback=_platform,
              help="Link, and which of x, y, z, rx, ry, rz, in place of joints.  [axes: x,y]")  # fmt: skip
@click.option("--guess", metavar="A=VALUE,...", callback=_positions, help="Where joints are near the reference.")
@options.settings_option("--set", "settings", "Argument of the file, such as base=free. May be repeated.")
@click.option("--out", metavar="FILE", help="What to write.  [default: robot.yaml beside the model]")
@options.trust_option
@options.untrusted_option
@options.json_option
def new(
    path: str, out: str | None, settings: dict[str, Any], platform: dict[str, Any], as_json: bool, **decided: Any
) -> int:
    r"""Write a robot.yaml for a model file.

    The file may be a URDF, xacro, MJCF, SDF, or a robot.yaml of example-parallel-robots. The loops and motors that it
    states are listed, and those that names and places tell without doubt. Everything else is a question, with the flags
    that answer it; the robot.yaml does not load before they are answered, and the exit code is 2. Without KIND, --close
    is a ball where a hinge would be the same. Arguments of the file (--set) are not part of the robot.yaml, which says
    so: they are given whenever it is loaded. Motions are given in joints, or with --platform in coordinates of a link.

    \b
    Example:
      redundancy-pin new machine.urdf --close left_tip,right_tip --actuate motor_1,motor_2
    """
    from redundancy_pin.loading import load_with, propose_robot
    from redundancy_pin.loading.write_declaration import declaration_text, is_undecided
    from redundancy_pin.robot.checks import too_few_motors
    from redundancy_pin.robot.model_files import is_model_file, is_urdf

    if platform and decided["independent"]:
        raise InputError("--platform and --independent are both given.", remedy="Give motions in one of them.")
    source = Path(path)
    if not is_urdf(source) and source.exists() and not is_model_file(source):
        raise InputError(f"{path} is no model of a robot.", remedy="Pass a URDF, xacro, MJCF or SDF file.")
    proposal, robot = propose_robot(source, settings, platform=platform.get("platform", ""), **decided)
    target = require_writable(out or source.parent / "robot.yaml")
    if target.exists() and not is_undecided(target):
        raise InputError(f"{target} is there already.", remedy="Pass --out, or move it away.", path=str(target))
    place = source.name if target.resolve().parent == source.resolve().parent else str(source.resolve())
    near = is_urdf(source) or bool(decided["guess"])
    before = target.read_text(encoding="utf-8") if target.exists() else None
    write_text(target, declaration_text(proposal, robot, place, settings, is_near_guess=near, platform=platform))
    mechanism, notes, outcome = proposal.mechanism, proposal.mechanism.notes, "it loads when all is decided"
    warnings = [f"undecided: {question}" for question in proposal.questions]
    if robot and not proposal.questions:
        files = {name: decided[name] for name in ("trust", "untrusted")}
        try:
            loaded = load_with(target, settings, **files)
        except RedundancyPinError:  # such as a platform that does not move along its axes
            target.unlink() if before is None else write_text(target, before)
            raise
        far, near_guess = _branch_found(loaded, decided["guess"])
        notes = (*loaded.notes, *filter(None, [too_few_motors(loaded)]), *near_guess)
        outcome = f"n = {loaded.n}, m = {loaded.m}"
        warnings += far
    facts: dict[str, Any] = {
        "out": str(target),
        "loops": [{"name": each.name, "kind": each.kind, "links": each.links} for each in mechanism.loop_joints],
        "found": dict(proposal.found),
        "frames": proposal.frames,
        "actuated": mechanism.actuated if proposal.motors else [],
        "motors": proposal.motors,
        "carriers": mechanism.carriers,
        "independent": platform or (robot.independent_joints if robot else []),
        "notes": notes,
        "undecided": proposal.questions,
    }
    report(as_json, Summary(facts, warnings=warnings), *proposal.listed(), *notes, f"{target}: {outcome}.")
    return BAD_INPUT if proposal.questions else 0


_FAR = 0.3
"""rad, or characteristic lengths: a joint that ends farther from its guess may be on another branch."""


_MOVED = 1e-3
"""rad, or characteristic lengths: a joint that ends farther from its guess is said; a guess has three digits or so."""


def _branch_found(robot: Robot, guess: Mapping[str, float]) -> tuple[list[str], list[str]]:
    """Return warnings and notes of where the loops closed.

    Warnings: joints that a guess leaves out, and those that end far from their guess. Notes: those that end near it.
    """
    from redundancy_pin.loading.reference import reference_positions
    from redundancy_pin.robot.scales import is_revolute

    if not (guess and robot.closures):
        return [], []
    known = {*guess, *robot.carriers, *(one.joint for one in robot.couplings)}
    warnings, left, far, moved = list[str](), list[str](), list[str](), list[str]()
    for name, at in reference_positions(robot).items():
        if name not in known:
            left.append(f"{name}={at:.3g}")
        elif name in guess:
            off = at - guess[name]
            off = math.remainder(off, math.tau) if is_revolute(robot, name) else off / robot.characteristic_length
            if abs(off) > _MOVED:
                (far if abs(off) > _FAR else moved).append(f"{name}={at:.6g}, not {guess[name]:.6g}")
    if left:
        names, places = ", ".join(one.partition("=")[0] for one in left), ",".join(left)
        warnings.append(f"--guess leaves out {names}: the branch is the one with {places}; guess all for another one.")
    if far:
        what = f"the loops closed far from --guess, with {'; '.join(far)}"
        warnings.append(f"{what}: if that is another branch, guess {'all joints, ' if left else ''}nearer to yours.")
    return warnings, [f"The loops closed near --guess, with {'; '.join(moved)}."] if moved else []
