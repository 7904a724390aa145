"""Close the reference configuration of a robot, and name the loop that stays open if that fails."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, frozen
from redundancy_pin.errors import DeclarationError, millimetres
from redundancy_pin.kinematics.assembly import TURNED_OVER
from redundancy_pin.kinematics.closing import closed_near
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import (
    in_working_mode,
    mode_name,
    reference_coordinates,
    working_modes,
)
from redundancy_pin.kinematics.mobility import check_mobility, check_reference_rank, other_axes
from redundancy_pin.kinematics.multistart import multistart
from redundancy_pin.robot import Robot
from redundancy_pin.robot.build import characteristic_length, configuration
from redundancy_pin.robot.declaration import Declaration
from redundancy_pin.robot.formats.xacro_file import Argument
from redundancy_pin.robot.joint_ranges import meet_limits
from redundancy_pin.robot.lookup import find_joint, joint_names
from redundancy_pin.robot.scales import closure_tolerance, is_revolute


def close_reference(robot: Robot, declaration: Declaration, parameters: Mapping[str, Argument], dropped: bool) -> Robot:
    """Return the robot with its reference closed and its mobility checked.

    Args:
        robot: with the guess as reference.
        declaration: of the robot.
        parameters: what its expressions are in.
        dropped: redundant rows were left out.
    """
    system = ConstraintSystem(robot)
    check_mobility(system, dropped=dropped)
    _require_radians(robot, declaration.reference.guess, "reference.guess")
    model, guess, given = robot.model, np.array(robot.q_reference), declaration.reference
    if given.platform is None and given.joints is None:
        # no pose is prescribed: the nearest closed configuration of all joints is kept
        q = closed_near(robot, guess)
        gap, closed = 0.0, bool(in_working_mode(robot, q[None])[0])
    else:
        goal = reference_coordinates(robot, declaration.coordinates(parameters))[0]
        positions = {} if robot.platform else dict(zip(robot.independent_joints, goal.tolist(), strict=True))
        _require_radians(robot, positions, "reference.joints")
        guessed = [find_joint(model, name) for name in given.guess]
        known = np.array([c for joint in guessed for c in range(joint.idx_q, joint.idx_q + joint.nq)], dtype=np.intp)
        prescribed = configuration(model, positions, guess)
        q, gap, closed = multistart(system, guess, goal, known=known, prescribed=prescribed)
    if not closed:
        raise DeclarationError(
            _not_closed(robot, q, gap),
            remedy=other_axes(robot) or "Correct `reference` in the declaration, or the lengths given as arguments.",
            residual=gap,
        )
    robot = replace(
        robot,
        q_reference=frozen(q),
        characteristic_length=declaration.characteristic_length
        or characteristic_length(robot.model, q, robot.carriers),
    )
    robot = check_reference_rank(ConstraintSystem(robot), dropped=dropped)
    every = ConstraintSystem(robot).every
    turned = float(every.misalignment(every.evaluate(np.array(robot.q_reference)[None]))[0])
    if turned > TURNED_OVER:
        raise DeclarationError(
            f"At the reference of {robot.name} a hinge or weld closes the wrong way round, by {turned:.3g} rad.",
            remedy="Name a `reference.guess` nearer to the right one.",
            angle=turned,
        )
    return meet_limits(robot)


def _not_closed(robot: Robot, nearest: Array, gap: float) -> str:
    mode = f" in working mode {mode_name(robot.working_mode)}" if robot.working_mode else ""
    if gap >= closure_tolerance(robot):
        return (
            f"The reference of {robot.name} does not close{mode}: the best of many starts leaves a gap of "
            f"{gap:.3g} m{_where_open(robot, nearest)}."
            f"{millimetres(gap, characteristic_length(robot.model, nearest, robot.carriers))}"
        )
    other = mode_name(tuple(working_modes(robot, nearest[None])[0]))
    return f"The reference of {robot.name} does not close{mode}, only in others such as {other}."


_OPEN = 0.1
"""A closure that is open by this fraction of the largest gap is named with it."""


def _where_open(robot: Robot, q: Array) -> str:
    """Return which closures a configuration (nq,) leaves open, the worst first."""
    from scipy.optimize import least_squares  # which takes a while to import, and is needed where loading fails

    system = ConstraintSystem(robot)

    def residual(step: Array) -> Array:
        phi: Array = system.evaluate(pin.integrate(robot.model, q, step)[None]).phi[0] / system.closure_unit
        return phi

    # Newton's method stops for all loops where one goes no further: least squares closes those that can be
    phi = np.abs(least_squares(residual, np.zeros(robot.model.nv)).fun) * robot.characteristic_length
    rows = [len(closure.axes) for closure in robot.closures] + [1] * len(robot.couplings)
    gaps = [float(part.max(initial=0.0)) for part in np.split(phi, np.cumsum(rows)[:-1])]
    worst = max(gaps, default=0.0)
    if worst < closure_tolerance(robot):
        return ": the loops close, but not where the reference says"
    names = [closure.name for closure in robot.closures] + [coupling.name for coupling in robot.couplings]
    named = sorted(zip(gaps, names, strict=True), reverse=True)
    listed = ", ".join(f"{name!r} by {gap:.3g}" for gap, name in named if gap > _OPEN * worst)
    return f" (open: {listed}; are its frames where the links meet?)"


def _require_radians(robot: Robot, positions: Mapping[str, float], key: str) -> None:
    """Check that no joint that turns is put beyond a turn that its limits do not ask for: it would be in degrees."""
    counted = {name for each in robot.couplings for name in each.joints}  # their turns
    for name, value in positions.items():
        if name in counted or not is_revolute(robot, name) or abs(value) <= 2.0 * np.pi:
            continue
        joint = find_joint(robot.model, name)
        ends = [float(limit[joint.idx_q]) for limit in (robot.model.lowerPositionLimit, robot.model.upperPositionLimit)]
        if joint.nq == 1 and (ends[0] > 2.0 * np.pi or ends[1] < -2.0 * np.pi):
            continue
        raise DeclarationError(
            f"`{key}` puts the joint {name!r} at {value:g} rad, {abs(value) / (2.0 * np.pi):.3g} turns: degrees?",
            remedy=f"Write radians, within a turn: {value:g} degrees are {np.deg2rad(value):.6g}.",
            key=key,
            name=name,
            value=value,
        )


def reference_positions(robot: Robot) -> dict[str, float]:
    """Return where the joints of one degree of freedom are at the reference configuration, rad or m, by name."""
    single = [name for name in joint_names(robot.model) if find_joint(robot.model, name).nv == 1]
    return dict(zip(single, robot.joint_positions(robot.q_reference, single).tolist(), strict=True))
