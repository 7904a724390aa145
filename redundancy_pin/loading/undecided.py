"""Model files that leave loops, motors or branches open: certain facts, questions, and the robot."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import FILE_TOLERANCE, Array
from redundancy_pin.errors import DeclarationError
from redundancy_pin.kinematics.closing import closed_neighbours
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.mobility import free_motions, independent_columns
from redundancy_pin.kinematics.selection import EXACT
from redundancy_pin.loading.mechanism import OpenedModel
from redundancy_pin.loading.reference import reference_positions
from redundancy_pin.robot import Robot
from redundancy_pin.robot.build import configuration
from redundancy_pin.robot.formats.mechanism import Mechanism
from redundancy_pin.robot.lookup import find_link_index
from redundancy_pin.robot.model_files import is_urdf, open_model
from redundancy_pin.robot.propose import BY_FLAG, Proposal, propose


def propose_robot(
    path: Path,
    arguments: Mapping[str, object] = MappingProxyType({}),
    *,
    close: Sequence[str] = (),
    actuate: Sequence[str] = (),
    carriers: Sequence[str] = (),
    independent: Sequence[str] = (),
    platform: str = "",
    guess: Mapping[str, float] = MappingProxyType({}),
    is_open: bool = False,
    trust: bool = False,
    untrusted: bool = False,
) -> tuple[Proposal, Robot | None]:
    """Return the certain facts of a model file and the questions, and the robot, None if none can be made yet.

    Args:
        path: a file of ``load_robot`` that needs no declaration.
        arguments: of the file, as of ``load_robot``.
        close: as of ``propose``.
        actuate: as of ``propose``.
        carriers: as of ``propose``.
        independent: names of independent joints; chosen if empty.
        platform: as of ``propose``.
        guess: positions of joints, rad or m; the loops are closed near them.
        is_open: as of ``propose``.
        trust: as of ``load_robot``.
        untrusted: as of ``load_robot``.

    Raises:
        RedundancyPinError: files that cannot be read, unknown names.

    Example:
        >>> propose_robot(Path("five_bar.urdf"), close=["ltip,rtip"], actuate=["a", "c"])  # doctest: +SKIP
    """
    parameters, read = open_model(path, arguments, trust=trust, untrusted=untrusted)
    named = (*actuate, *carriers, *independent)
    proposal = propose(
        read(None, named), close=close, actuate=actuate, carriers=carriers, platform=platform, is_open=is_open
    )
    mechanism = proposal.mechanism
    if proposal.questions:
        return proposal, None
    start = configuration(mechanism.model, guess, mechanism.start)
    mechanism = replace(mechanism, start=start, independent=tuple(independent) or mechanism.independent)
    try:
        proposal, robot = settled(replace(proposal, mechanism=mechanism), OpenedModel(path, parameters=parameters))
    except DeclarationError as error:
        return proposal.refused(str(error)), None
    motors = len(proposal.mechanism.actuated)
    if is_urdf(path) and not (actuate or is_open or proposal.questions) and motors < robot.n:
        have = f"The mechanism has {robot.n} DOF and {motors} motor(s)"
        proposal = proposal.asking(
            f"Is a loop or a motor missing? {have}: --close A,B or --actuate A,B; --open if none is."
        )
    return proposal, robot


def settled(proposal: Proposal, opened: OpenedModel) -> tuple[Proposal, Robot]:
    """Return a proposal with the questions that only the closed mechanism raises, and its robot.

    Where branches meet at the start, the reference is a pose near it, which may be on another branch than the machine.

    Raises:
        DeclarationError: as ``OpenedModel.robot``.
    """
    mechanism = proposal.mechanism
    try:
        robot = opened.robot(mechanism)
        is_flat = len(mechanism.start) == robot.model.nq and branches_meet(robot, mechanism.start)
    except DeclarationError as error:
        if "rank" not in error.details or not mechanism.loop_joints:
            raise
        robot, is_flat = _build_near_start(mechanism, opened, error), True
    proposal = proposal.settled(robot, _turning(proposal, robot)).asking(*_hinges_off_axis(proposal, opened))
    return (proposal.asking(_which_branch(robot)) if is_flat else proposal), robot


def _hinges_off_axis(proposal: Proposal, opened: OpenedModel) -> Iterator[str]:
    """Yield questions on hinges by --close about another axis than their links turn about where a ball joins them.

    Such a hinge holds them like a weld.
    """
    loops = proposal.mechanism.loop_joints
    for hinge in (loop for loop in loops if loop.kind == "hinge" and proposal.found.get(loop.name) == BY_FLAG):
        joints = tuple(replace(each, kind="ball") if each is hinge else each for each in loops)
        axes = np.zeros((0, 3))
        with suppress(DeclarationError):
            axes = turning_axes(opened.robot(replace(proposal.mechanism, loop_joints=joints)), hinge.links)
        if len(axes) == 1 and (away := np.arctan2(np.hypot(*axes[0, :2]), abs(axes[0, 2]))) > _OFF_AXIS:
            ends = ",".join(hinge.links)
            yield (
                f"Which joint closes the loop at {ends}? A hinge about z of {hinge.links[0]} is "
                f"{np.rad2deg(away):.3g}° off the axis about which the links turn, and holds them like a weld: "
                f"--close {ends},ball or --close {ends},weld."
            )


_OFF_AXIS = 1e-2
"""rad: ten times what placements of a file are off by (``arrays.FILE_TOLERANCE``)."""

_BRANCH = "Which branch?"
"""How the question begins."""


def _which_branch(robot: Robot) -> str:
    """Return the question on which branch the machine is, with where the joints are on the one nearby."""
    at = (f"{name}={value:.3g}" for name, value in reference_positions(robot).items())
    return (
        f"{_BRANCH} Where all joints start, loops lie in a line and branches meet. Name where the joints are near "
        f"the reference: --guess JOINT=VALUE,...; one branch nearby has --guess {','.join(at)}."
    )


def _turning(proposal: Proposal, robot: Robot) -> list[str]:
    """Return the loop joints of unknown kind whose links turn against each other about several axes."""
    unknown = [joint for joint in proposal.mechanism.loop_joints if joint.name in proposal.mechanism.presumed]
    return [joint.name for joint in unknown if len(turning_axes(robot, joint.links)) > 1]


def require_decided(proposal: Proposal, file: Path) -> None:
    """Refuse a file that leaves something open."""
    if proposal.questions:
        ways = [f"`redundancy-pin new {file.name}` with these flags writes a robot.yaml that does."]
        if file.suffix != ".xacro" and not proposal.motors:
            ways.append('Motors alone: load_robot(..., actuated="a,b"), or --set actuated=a,b.')
        if file.suffix in (".xml", ".mjcf") and proposal.questions[-1].startswith(_BRANCH):
            ways.append('Or load_robot(..., keyframe="home"), --set keyframe=home, with a keyframe on the branch.')
        raise DeclarationError(
            f"{file.name} does not say it all. {' '.join(proposal.questions)}",
            remedy=" ".join(ways),
            questions=proposal.questions,
        )


_LARGEST_OFFSET = 0.5
"""rad and m, of each joint: where loops lie in a line at the start of a file, poses within this of it are tried."""

_MOST_TRIES = 8
"""Number of poses that are tried: each is as good as any other, and fails only near a singularity."""


def _build_near_start(mechanism: Mechanism, opened: OpenedModel, error: DeclarationError) -> Robot:
    """Return a robot whose reference is near the start of its mechanism, where loops in a line lose rank.

    Args:
        mechanism: what a file describes.
        opened: the file.
        error: raised again if no pose serves.
    """
    model, rng = mechanism.model, np.random.default_rng(1)
    for _ in range(_MOST_TRIES):
        start = pin.integrate(model, mechanism.start, rng.uniform(-_LARGEST_OFFSET, _LARGEST_OFFSET, model.nv))
        if model.nq == model.nv:
            start = np.clip(start, model.lowerPositionLimit, model.upperPositionLimit)
        with suppress(DeclarationError):
            return opened.robot(replace(mechanism, start=start))
    raise error


# --- how the frames of cut ends move --------------------------------------------------------------------------------


_AROUND = 4, 0.3
"""Number of configurations around the reference, and how far from it the joint is that moves farthest, rad or
characteristic lengths: an axis that is not fixed turns by about as much."""


def turning_axes(robot: Robot, ends: tuple[str, str]) -> Array:
    """Return (k, 3) orthonormal axes, in the first frame, about which two frames turn against each other.

    None where they do not turn; one where its direction is fixed in the first frame, and so in the second; several
    otherwise. Where two frames meet in a ball and turn about one axis, a hinge along that axis allows the same motions:
    in a planar loop, and in a spherical one with its ball away from the centre. The axes span the relative
    angular velocities of all motions that the loops leave free, at the reference and at a few configurations near it.

    Args:
        robot: its reference is closed.
        ends: names of two links, in which a loop is cut.

    Example:
        >>> len(turning_axes(robot, ("coupler_tip", "rocker_tip")))
        1
    """
    model, data, turns = robot.model, robot.model.createData(), []
    indices = [find_link_index(model, name) for name in ends]
    for q, velocities in _motions(robot):
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        first, second = (
            pin.getFrameJacobian(model, data, index, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)[3:] for index in indices
        )
        turns.append(velocities @ (second - first).T @ data.oMf[indices[0]].rotation)
    values, axes = np.linalg.svd(np.concatenate(turns))[1:]
    found: Array = axes[(values[0] > FILE_TOLERANCE) & (values > FILE_TOLERANCE * values[0])]
    return found


def branches_meet(robot: Robot, q: Array) -> bool:
    """Return whether closure rows depend on one another at q (nq,) that do not at the reference, as links in a line do.

    Example:
        >>> branches_meet(robot, pin.neutral(robot.model))  # of a parallelogram that is flat there
        True
    """
    rows = ConstraintSystem(robot).closure_rows(q)
    return len(independent_columns(rows.T, EXACT)) < len(rows)


@lru_cache(maxsize=1)  # of one robot several ends are looked at
def _motions(robot: Robot) -> list[tuple[Array, Array]]:
    """Return configurations (nq,) and the free joint velocities (f, nv) there, the reference first."""
    system, found = ConstraintSystem(robot), []
    for q in closed_neighbours(system, np.array(robot.q_reference), *_AROUND):
        motions = free_motions(system, q)
        velocities = np.zeros((len(motions), robot.model.nv))
        velocities[:, system.pose_columns] = motions * system.step_unit
        found.append((q, velocities))
    return found
