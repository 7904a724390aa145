"""``redundancy-pin new``: a declaration proposed for a URDF."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Mapping
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click
import numpy as np

from redundancy_pin.cli.errors import printable
from redundancy_pin.cli.options import json_option, trust_option
from redundancy_pin.cli.output import report, warning
from redundancy_pin.errors import DeclarationError, InputError
from redundancy_pin.io.files import require_writable, write_text
from redundancy_pin.robot.joint_ranges import joint_ranges
from redundancy_pin.robot.lookup import find_link_index

if TYPE_CHECKING:
    from redundancy_pin.robot import Robot
    from redundancy_pin.robot.formats.mechanism import JointEntry, Mechanism
    from redundancy_pin.robot.formats.urdf import Urdf

_SINGLE = ("revolute", "continuous", "prismatic")

_COINCIDE = 1e-5
"""m: frames that are nearer at the zero configuration are taken to be one point, cut in two; files are rounded."""

_NO_MASS = 1e-6
"""Of the mass of all: exporters give frames a gram in a tonne, as some readers refuse links that weigh nothing."""


@click.command()
@click.argument("path", metavar="URDF")
@click.option("--out", metavar="FILE", help="What to write.  [default: robot.yaml beside the URDF]")
@trust_option
@json_option
def new(path: str, out: str | None, trust: bool, as_json: bool) -> None:
    r"""Propose a robot.yaml for a URDF.

    Nothing is asked. It looks at the tree: a frame that carries nothing and weighs nothing, and coincides with another
    such one or with another chain's link when all joints are at zero, is where a loop was cut, and so are the only two
    such frames; loops that the URDF states itself are kept; joints with transmissions are driven, else as many as
    there are freedoms, those with limits of effort and position first; joints that mimic others are coupled to them;
    the reference is a closed configuration. What is written loads; read it, and correct it.

    \b
    Example:
      redundancy-pin new machine.urdf
    """
    from redundancy_pin.loading import FLAT, load_robot
    from redundancy_pin.robot.formats.urdf import read_urdf, urdf_mechanism
    from redundancy_pin.robot.urdf import render

    source = Path(path)
    if source.suffix.lower() not in (".urdf", ".xacro"):
        raise InputError(
            f"{path} is no URDF.", remedy="Pass a .urdf or .xacro; models of MuJoCo and Gazebo need no declaration."
        )
    target = require_writable(out or source.parent / "robot.yaml")
    if target.exists():
        raise InputError(f"{target} is there already.", remedy="Pass --out, or move it away.", path=str(target))
    urdf, _ = render(source, {}, trust=trust)
    tree = read_urdf(urdf, source)
    name = source.name.partition(".")[0]
    mechanism = urdf_mechanism(tree, name)
    mechanism.model.gravity.linear = np.array([0.0, 0.0, -9.81])
    pairs, how, doubts = _proposed_closures(tree, mechanism)
    declared = mechanism.actuated if mechanism.drives_declared else ()
    single = [joint for joint in tree.joints if joint.kind in _SINGLE and not joint.mimic]
    driven = [*declared] or [joint.name for joint in single if _is_limited(joint)] or [joint.name for joint in single]
    if not driven:
        raise InputError(f"{source.name} has no joint of one freedom to drive.", remedy="Add one.")
    data = {
        "name": name,
        "urdf": source.name,
        "closures": [{"frames": pair, "axes": ["x", "y", "z"]} for pair in pairs],
        "actuated": driven,
        "reference": {},
    }
    robot, flat = _closed(data, mechanism, drive_independent=not declared)
    doubts += [FLAT] if flat else []
    beside = target.resolve().parent == source.resolve().parent
    doubts += _out_of_range(robot)
    place = source.name if beside else str(source.resolve())
    write_text(target, _text(robot, place, how, bool(declared), doubts, {each.name for each in mechanism.loop_joints}))
    loaded = load_robot(target, trust=trust)
    facts = {
        "out": str(target),
        "closures": [{"frames": [c.frame_a, c.frame_b], "axes": c.axes} for c in loaded.closures],
        "couplings": [asdict(coupling) for coupling in loaded.couplings],
        "actuated": loaded.actuated,
        "independent": loaded.independent_joints,
        "doubts": doubts,
    }
    for doubt in () if as_json else doubts:
        warning(doubt)
    closures = f"{len(loaded.closures)} closure(s)" if loaded.closures else f"no closure: {how}"
    counts = f"n = {loaded.n}, m = {loaded.m}, {closures}"
    report(as_json, facts, f"{target}: {counts}. Read it, and correct it.")


def _closed(data: Mapping[str, Any], mechanism: Mechanism, *, drive_independent: bool) -> tuple[Robot, bool]:
    """Return the robot, and whether it is that of a pose beside zero.

    Raises:
        DeclarationError: as at zero, if no pose near it serves either.
    """
    from redundancy_pin.loading import beside, build_robot

    def at(own: Mechanism) -> Robot:
        own = replace(own, model=own.model.copy())  # it becomes the robot's
        return build_robot(data, own, loose=True, drive_independent=drive_independent)

    try:
        return at(mechanism), False
    except DeclarationError as error:
        return beside(mechanism, at, error), True


def _proposed_closures(tree: Urdf, mechanism: Mechanism) -> tuple[list[list[str]], str, list[str]]:
    """Return pairs of frames that close loops, how they were found, and what could be otherwise."""
    import pinocchio as pin

    if mechanism.loop_joints:  # all loops of a file are read, or none
        named = ", ".join(each.name for each in mechanism.loop_joints)
        return [], f"the URDF says it, at {named}", []
    model = mechanism.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, pin.neutral(model))
    frames = [frame for frame in model.frames if frame.type == pin.FrameType.BODY]
    at = {str(frame.name): data.oMf[find_link_index(model, frame.name)].translation for frame in frames}
    carrier = {str(frame.name): int(frame.parentJoint) for frame in frames}
    parents = {joint.parent for joint in tree.joints}
    weight = _NO_MASS * sum(link.mass for link in tree.links.values())
    ends = [
        joint.child
        for joint in tree.joints
        if joint.kind == "fixed" and joint.child not in parents and tree.links[joint.child].mass <= weight
    ]
    pairs: list[list[str]] = []
    for one, other in itertools.combinations(ends, 2):
        apart = carrier[one] != carrier[other] and not {one, other} & {name for pair in pairs for name in pair}
        if apart and np.linalg.norm(at[one] - at[other]) < _COINCIDE:
            pairs.append([one, other])
    paired = {name for pair in pairs for name in pair}
    marked: list[list[str]] = []
    for end in ends:
        # a pin marked on one of its links alone: it is where another chain's link begins
        chain = set(model.supports[carrier[end]])
        on = {
            carrier[name]: name
            for name in reversed(at)
            if name not in ends and carrier[name] not in chain and np.linalg.norm(at[name] - at[end]) < _COINCIDE
        }
        on = {joint: name for joint, name in on.items() if carrier[end] not in set(model.supports[joint])}
        if end not in paired and len(on) == 1:
            marked.append([end, *on.values()])
    loose = [end for end in ends if end not in paired and all(end != mark for mark, _ in marked)]
    pairs += marked
    if pairs:
        doubts = [
            f"{end!r} is where {link!r} is at zero, by chance perhaps: {', '.join(loose)} carry and weigh nothing too."
            for end, link in marked
            if loose
        ]
        doubts += [
            f"{end!r} is where {one!r} and {other!r} are: a pin of three links takes one closure more, a mark none."
            for one, other in pairs
            for end in ends
            if carrier[end] not in (carrier[one], carrier[other]) and np.linalg.norm(at[end] - at[one]) < _COINCIDE
        ]
        return pairs, "they coincide when all joints are at zero", doubts
    if len(ends) == 2 and carrier[ends[0]] != carrier[ends[1]]:
        return [ends], "the only two links that carry nothing and weigh nothing", []
    which = f" (say under closures which are one point: {', '.join(ends)})" if len(ends) > 1 else ""
    return [], f"no two frames coincide when all joints are at zero{which}", []


def _out_of_range(robot: Robot) -> list[str]:
    """Return a line on joints that the reference has beyond their limits."""
    q = robot.q_reference[None]
    beyond = [joint.name for joint in joint_ranges(robot) if joint.is_left(q[:, joint.at], False)[0]]
    return [f"The reference is out of the range of {', '.join(beyond)}: guess another."] if beyond else []


def _is_limited(joint: JointEntry) -> bool:
    """Return whether a joint has a motor's limits: an effort, and bounds short of a full turn."""
    limits = joint.limits
    bounds = limits.get("upper", np.inf) - limits.get("lower", -np.inf)
    return limits.get("effort", 0.0) > 0.0 and bounds < (np.inf if joint.kind == "prismatic" else 2.0 * np.pi - 0.01)


def _text(robot: Robot, urdf: str, how: str, is_declared: bool, doubts: list[str], stated: Collection[str]) -> str:
    """Return the declaration, with a comment on each thing that was guessed."""
    import json

    import jinja2

    q, model = robot.q_reference, robot.model
    positions = {}
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if joint.nv == 1:
            angle = q[joint.idx_q] if joint.nq == 1 else np.arctan2(q[joint.idx_q + 1], q[joint.idx_q])
            positions[str(name)] = round(float(angle), 6)
    guessed = "as many joints as freedoms, those with limits first; choose."
    driven = "the joints with transmissions or ros2_control." if is_declared else guessed
    free = {name: positions[name] for name in robot.independent_joints}
    rest = {name: value for name, value in positions.items() if name not in free}
    made = jinja2.Environment(loader=jinja2.PackageLoader("redundancy_pin.cli", ""), trim_blocks=True)
    made.filters["quoted"] = lambda value: json.dumps(value, ensure_ascii=False)
    template = made.get_template("robot.yaml.j2")
    said = [printable(doubt) for doubt in doubts]
    return (
        template.render(
            robot=robot,
            closures=[each for each in robot.closures if each.name not in stated],
            urdf=urdf,
            how=how,
            driven=driven,
            free=free,
            rest=rest,
            doubts=said,
        )
        + "\n"
    )
