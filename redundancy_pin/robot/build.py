"""Put a declaration and a mechanism together into a ``Robot`` (its reference configuration still a guess)."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from types import MappingProxyType
from typing import Literal

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import FILE_TOLERANCE, RANK_TOLERANCE, Array, read_only
from redundancy_pin.errors import DeclarationError, InputError, shown
from redundancy_pin.robot.declaration import CLOSED_FORM_ROLES, CLOSED_FORMS, CarrierEntry, Declaration
from redundancy_pin.robot.formats.mechanism import MOST_FREEDOMS, Mechanism
from redundancy_pin.robot.formats.xacro_file import Argument
from redundancy_pin.robot.joint_ranges import ROUNDING
from redundancy_pin.robot.loads import JointForces
from redundancy_pin.robot.lookup import find_joint, find_joint_index, find_link, find_link_index
from redundancy_pin.robot.loop_joints import add_frames, ends_of
from redundancy_pin.robot.types import CarrierLimits, Closure, Coupling, Platform, Robot, slides


def read_robot(
    declaration: Declaration,
    mechanism: Mechanism,
    *,
    parameters: Mapping[str, Argument] = MappingProxyType({}),
    source: str = "",
    mode: Sequence[int] | None = None,
    own_model: bool = False,
    rods: Mapping[str, float] = MappingProxyType({}),
) -> Robot:
    """Return the robot that a declaration makes of a mechanism, its names and roles checked.

    The reference configuration has the joints where the declaration puts them; it is not closed yet. An undeclared
    characteristic length is provisional.

    Args:
        declaration: it takes precedence over the mechanism for the same joints.
        mechanism: the tree, which becomes the robot's own, and the other content of its file.
        parameters: arguments of the file, with their values.
        source: what finds the robot again.
        mode: ±1 a leg; as declared when left out.
        own_model: the tree is the user's; its joints are not replaced.
        rods: lengths of rods by name, m, for rods without a declared length.

    Raises:
        DeclarationError: an unknown joint or frame, a joint in two roles, a carrier that moves the pose, a rod whose
            length is not known.
        InputError: a working mode of the wrong form.
    """
    if not own_model:
        # cosine and sine of continuous joints, which Pinocchio has, forget the turns that couplings count
        mechanism = mechanism.counting_turns({name for each in declaration.coupled for name in each.joints})
    model = mechanism.model
    _require_closed_form(declaration, parameters)
    joined = {frozenset((loop.frame_a, loop.frame_b)) for loop in declaration.loops}
    file_joints = [joint for joint in mechanism.loop_joints if frozenset(joint.frames()) not in joined]
    closures = (*(joint.closure() for joint in file_joints), *declaration.loops)
    entries = tuple(entry for entry in declaration.carriers if entry.when)
    carriers = tuple(entry.joint for entry in entries)
    own = {each.joint for each in declaration.coupled}
    couplings = (*declaration.coupled, *(each for each in mechanism.couplings if each.joint not in own))
    with _names_of_declaration():
        add_frames(model, (*file_joints, *declaration.loop_joints))
        _check_roles(declaration, closures, carriers, model)
        _check_couplings(couplings, declaration, carriers, model)
    guess = configuration(model, _positions(declaration, parameters), mechanism.start)
    sized, sizes = _with_lengths(closures, declaration, model, guess, rods)
    robot = Robot(
        name=str(declaration.name or mechanism.name),
        parameters=MappingProxyType(dict(parameters)),
        urdf=mechanism.shapes,
        model=model,
        closures=sized,
        couplings=couplings,
        platform=with_pointer(declaration.platform, model, guess),
        independent_joints=declaration.independent.joints,
        actuated=declaration.actuated,
        carriers=carriers,
        carrier_limits=tuple(_limits(model, entry) for entry in entries),
        q_reference=read_only(guess),
        working_modes=declaration.modes,
        working_mode=_mode(declaration, mode),
        characteristic_length=declaration.characteristic_length or characteristic_length(model, guess, carriers),
        closed_form=_closed_form(declaration, parameters, model, carriers),
        source=source,
    )
    _check_carriers_carry(robot)
    forces, notes = _forces(declaration, mechanism)
    with _names_of_declaration():
        robot = robot.loaded(*declaration.loads, *forces)
    return replace(robot, notes=(*sizes, *notes, *mechanism.notes, *_zero_limits(robot)))


@contextmanager
def _names_of_declaration() -> Iterator[None]:
    """Make an error about a name one of the declaration, which is where to correct it."""
    try:
        yield
    except InputError as error:
        raise DeclarationError(error.message, remedy=error.remedy, **error.details) from error


def _forces(declaration: Declaration, mechanism: Mechanism) -> tuple[list[JointForces], tuple[str, ...]]:
    """Return the file's friction and springs, except for joints whose forces are declared; and notes."""
    if mechanism.forces and not declaration.urdf_dynamics:
        names = ", ".join(load.joint for load in mechanism.forces)
        return [], (f"Friction and springs of the file are not in force (urdf_dynamics: false): {names}.",)
    declared = {entry.joint for entry in declaration.joint_forces}
    return [load for load in mechanism.forces if load.joint not in declared], ()


def _require_closed_form(declaration: Declaration, parameters: Mapping[str, Argument]) -> None:
    """Require the xacro arguments from which a closed form is written out."""
    for name in CLOSED_FORMS.get(declaration.closed_form or "", ()):
        value = parameters.get(name)
        flag, auto = name == "carriers", name == "platform_inertia" and value == "auto"
        if not auto and (value is None or isinstance(value, str) or isinstance(value, bool) is not flag):
            what = f"is {value!r}" if name in parameters else "is missing"
            message = f"`closed_form: {declaration.closed_form}` needs the xacro argument {name!r}, which {what}."
            remedy = "Leave `closed_form` out: RneaDynamics covers every robot."
            raise DeclarationError(message, remedy=remedy, key="closed_form", name=name)


def _closed_form(
    declaration: Declaration, parameters: Mapping[str, Argument], model: pin.Model, carriers: tuple[str, ...]
) -> Literal["2rpr", "3rrr"] | None:
    """Return the closed form that covers the robot: motors, modes and axes are its own, in its order.

    So are carriers: each leg has a sliding one, or none has, and there are no others.
    """
    modes = declaration.modes
    if declaration.closed_form is None or modes is None:
        return None
    roles = (declaration.actuated, modes.joints, modes.signs, declaration.independent.axes)
    if tuple(map(tuple, roles)) != CLOSED_FORM_ROLES[declaration.closed_form]:
        return None
    legs = len(modes.joints) if parameters.get("carriers") else 0
    own = carriers == tuple(f"carrier_{leg + 1}" for leg in range(legs))
    return declaration.closed_form if own and all(slides(find_joint(model, name)) for name in carriers) else None


def _check_roles(
    declaration: Declaration, closures: Sequence[Closure], carriers: Sequence[str], model: pin.Model
) -> None:
    count = len(closures)
    if count > MOST_FREEDOMS:  # each of them takes a freedom at least
        raise DeclarationError(
            f"The model has {count} closures, more than the {MOST_FREEDOMS} freedoms that one may have.",
            remedy="Take out those that say again what others say.",
            closures=count,
        )
    driven = (*declaration.actuated, *carriers, *declaration.independent.joints)
    modes, guess = declaration.modes, declaration.reference.guess
    for name in (*driven, *guess, *(modes.joints if modes else ())):
        count = find_joint(model, name).nv
        if name in driven and count != 1:
            what = f"Joint {name!r} has {count} freedoms."
            raise _refused(name, what, "Actuated, carrier and independent joints must have one.")
    twice = [name for name in carriers if driven.count(name) > 1]
    if twice:
        remedy = "A carrier is neither a main actuator nor independent, and is listed once."
        raise _refused(twice[0], f"Joint {twice[0]!r} is declared in two roles.", remedy)
    for closure in closures:
        if find_link(model, closure.frame_a).parentJoint == find_link(model, closure.frame_b).parentJoint:
            what = f"The closure {closure.name!r} joins two frames of one rigid body."
            raise _refused(closure.name, what, "Name frames on the two bodies that meet there.")
    if declaration.platform:
        find_link(model, declaration.platform.frame)
    for name in carriers:
        if name in guess:
            what = f"`reference.guess` sets the carrier {name!r}."
            raise _refused(name, what, "Leave it out: the reference has the carriers at zero.")


def _check_couplings(
    couplings: Sequence[Coupling], declaration: Declaration, carriers: Sequence[str], model: pin.Model
) -> None:
    for coupling in couplings:
        for name in coupling.joints:
            joint = find_joint(model, name)
            if (joint.nq, joint.nv) != (1, 1):
                kind = "continuous: its turns are not counted" if joint.nv == 1 else "of several freedoms"
                remedy = "Couple revolute joints with (wide) limits, or prismatic ones."
                raise _refused(name, f"The coupled joint {name!r} is {kind}.", remedy)
            if name in carriers:
                what = f"The carrier {name!r} is coupled to another joint."
                raise _refused(name, what, "A carrier moves nothing else; declare it as actuated instead.")
        if coupling.joint == coupling.of:
            raise _refused(coupling.joint, f"The joint {coupling.joint!r} is coupled to itself.", "Name another.")
    if rods := [each.name for each in declaration.loops if each.is_rod and declaration.closed_form]:
        what = f"`closed_form: {declaration.closed_form}` knows no rods, as {rods[0]!r} is."
        raise _refused(rods[0], what, "Leave `closed_form` out: RneaDynamics covers every robot.")
    if couplings and declaration.closed_form:
        what = f"`closed_form: {declaration.closed_form}` knows no couplings, as {couplings[0].name!r} is."
        raise _refused(couplings[0].joint, what, "Leave `closed_form` out: RneaDynamics covers every robot.")


def _positions(declaration: Declaration, parameters: Mapping[str, Argument]) -> dict[str, float]:
    """Return positions of joints, rad or m, from which the reference is closed: its own count before the guess's."""
    positions = dict(declaration.reference.guess)
    if declaration.reference.joints is not None:
        given = zip(declaration.independent.joints, declaration.coordinates(parameters), strict=True)
        positions.update(given)
    return positions


def _with_lengths(
    closures: Sequence[Closure],
    declaration: Declaration,
    model: pin.Model,
    guess: Array,
    known: Mapping[str, float],
) -> tuple[tuple[Closure, ...], tuple[str, ...]]:
    """Return closures whose rods have lengths, and notes of those that are measured.

    A length is the rod's own, the one known by name, or the distance of its ends at the guess (nq,), which has the
    reference of independent joints. A platform's pose puts no joint anywhere: lengths are not measured there.
    """
    if not any(each.is_rod for each in closures):
        return tuple(closures), ()
    data = model.createData()
    pin.forwardKinematics(model, data, guess)
    sized, notes = [], []
    for each in closures:
        length = each.length or known.get(each.name, 0.0)
        if each.is_rod and not length:
            if declaration.reference.platform is not None:
                what = (
                    f"The rod {each.name!r} has no length, and `reference.platform` puts no joints where to measure it."
                )
                raise _refused(each.name, what, "Give its `length`, or a `reference` of joints.")
            length = float(np.linalg.norm(np.subtract(*ends_of(each, model, data))))
            if length <= RANK_TOLERANCE * characteristic_length(model, guess, ()):
                what = f"The ends of the rod {each.name!r} coincide at the reference."
                raise _refused(each.name, what, "Give its `length`, or a `reference.guess` in which they are apart.")
            notes.append(f"The rod {each.name!r} is {length:.6g} m long, as its ends are apart at the reference.")
        sized.append(replace(each, length=length) if each.is_rod else each)
    return tuple(sized), tuple(notes)


def _refused(name: str, what: str, remedy: str) -> DeclarationError:
    return DeclarationError(what, remedy=remedy, name=name)


def _limits(model: pin.Model, entry: CarrierEntry) -> CarrierLimits:
    """Return the declared limits, or the limits of the URDF, in which a zero means "not known"."""
    joint = find_joint(model, entry.joint)
    if joint.nq != 1:
        what = f"The carrier {entry.joint!r} is a continuous joint."
        raise _refused(entry.joint, what, "Give it a bounded revolute or prismatic joint.")
    ends = tuple(float(limit[joint.idx_q]) for limit in (model.lowerPositionLimit, model.upperPositionLimit))
    lower, upper = entry.position or ends
    slack = ROUNDING * (ends[1] - ends[0])
    if slack > 0.0 and (lower < ends[0] - slack or upper > ends[1] + slack):
        what = (
            f"`position: [{lower:g}, {upper:g}]` of the carrier {entry.joint!r} exceeds the limits of its joint, "
            f"{ends[0]:g} and {ends[1]:g}."
        )
        remedy = "Give a position within these, or leave it out to take them; or widen the <limit> of the joint."
        raise _refused(entry.joint, what, remedy)
    if not -np.inf < lower < upper < np.inf:
        what = f"The track of the carrier {entry.joint!r} runs from {lower:g} to {upper:g}."
        remedy = "Give its joint a <limit> with lower < upper in the URDF, or the carrier a `position`."
        raise _refused(entry.joint, what, remedy)
    own = model.upperVelocityLimit, model.lowerEffortLimit, model.upperEffortLimit
    speed, least, force = (float(limit[joint.idx_v]) for limit in own)
    if least != -force and not entry.force:
        what = f"The forces of the carrier {entry.joint!r} are from {least:g} to {force:g}; its limit counts both ways."
        raise _refused(entry.joint, what, "Give the carrier a `force`.")
    unknown, largest = float("inf"), np.finfo(float).max  # the latter is Pinocchio's for none
    return CarrierLimits(
        lower,
        upper,
        entry.speed or (speed if 0.0 < speed < largest else unknown),
        entry.acceleration or unknown,
        entry.force or (force if 0.0 < force < largest else unknown),
    )


def _zero_limits(robot: Robot) -> tuple[str, ...]:
    """Return a note on main actuators whose limits of effort or speed are zero, which means "not known"."""
    model, at = robot.model, robot.actuated_velocity
    zero = {
        "effort": (model.lowerEffortLimit[at] == 0.0) & (model.upperEffortLimit[at] == 0.0),
        "speed": model.upperVelocityLimit[at] == 0.0,
    }
    named = [
        f"{name} ({' and '.join(kinds)})"
        for i, name in enumerate(robot.actuated)
        if (kinds := [kind for kind, is_zero in zero.items() if is_zero[i]])
    ]
    return (f"Limits of zero count as not known: {', '.join(named)}.",) if named else ()


def _mode(declaration: Declaration, wanted: Sequence[int] | None) -> tuple[int, ...]:
    default = declaration.working_modes.default if declaration.working_modes else ()
    if wanted is None:
        return default
    mode = tuple(wanted) if isinstance(wanted, Sequence) else ()
    if not default or len(mode) != len(default) or not all(sign in (1, -1) for sign in mode):
        legs = len(default)
        has = f"has {legs} legs" if legs else "declares no working modes"
        example = f"Give one sign per leg: {'+' * legs}, in Python {(1,) * legs}." if legs else "Leave it out."
        raise InputError(
            f"working_mode is {shown(wanted)}, but the robot {has}.", remedy=example, name="working_mode", legs=legs
        )
    return tuple(int(sign) for sign in mode)


def configuration(model: pin.Model, positions: Mapping[str, float], start: Array) -> Array:
    """Return a configuration (nq,) with joints at positions, rad or m, and the others where they start (nq,).

    Raises:
        InputError: the model has no such joint.
        DeclarationError: a joint of several coordinates, except a continuous one.
    """
    q: Array = start.copy()
    for name, value in positions.items():
        joint = find_joint(model, name)
        if joint.nq > 2:
            what = f"`reference.guess` cannot set joint {name!r}: it has {joint.nq} coordinates."
            raise _refused(name, what, "Leave it out: it starts at its neutral position.")
        # a continuous joint has the cosine and the sine of its angle as coordinates
        q[joint.idx_q : joint.idx_q + joint.nq] = value if joint.nq == 1 else (np.cos(value), np.sin(value))
    return q


def with_pointer(platform: Platform | None, model: pin.Model, q: Array) -> Platform | None:
    """Return a platform with the frame axis that defines its angle: for a single rotation, the first in its plane.

    The order follows the base axes after the axis of rotation. So rz is the angle of the frame's x axis, unless
    the frame is mounted with that axis along z; any mounting will do.
    """
    if platform is None or len(platform.rotations) != 1:
        return platform
    data, k = model.createData(), platform.rotations[0]
    pin.framesForwardKinematics(model, data, q)
    rotation = data.oMf[find_link_index(model, platform.frame)].rotation
    i, j = (k + 1) % 3, (k + 2) % 3
    in_plane = np.hypot(rotation[i], rotation[j]) > _IN_PLANE
    return replace(platform, pointer=next((axis for axis in (i, j) if in_plane[axis]), k))


_IN_PLANE = 0.5
"""Length of the part of a unit axis in the plane of rotation from which it serves to measure the angle."""


def characteristic_length(model: pin.Model, q: Array, carriers: Sequence[str]) -> float:
    """Return one size for one machine: the root mean square distance of its joints from their mean.

    It is 1 m where all joints are at one point, except for the rounding of a file, and where no joint counts.

    Args:
        model: the tree.
        q: (nq,) closed configuration.
        carriers: joints that do not count, so that the machine has one size with and without its carriers.
    """
    data = model.createData()
    pin.forwardKinematics(model, data, q)
    counted = [index for index in range(1, model.njoints) if model.names[index] not in carriers]
    if not counted:
        return 1.0
    origins = np.array([data.oMi[index].translation for index in counted])
    spread = float(np.sqrt(((origins - origins.mean(axis=0)) ** 2).sum(axis=1).mean()))
    parts = [origins, *(model.jointPlacements[index].translation[None] for index in counted)]
    reach = max(float(np.linalg.norm(part, axis=1).max()) for part in parts)
    return spread if spread > FILE_TOLERANCE * reach else 1.0


def _check_carriers_carry(robot: Robot) -> None:
    """A carrier may change the dynamics, never the pose."""
    model = robot.model
    frames = {name for closure in robot.closures for name in (closure.frame_a, closure.frame_b)}
    for frame in sorted(frames | ({robot.platform.frame} if robot.platform else set())):
        support = list(model.supports[find_link(model, frame).parentJoint])
        for carrier in robot.carriers:
            if find_joint_index(model, carrier) in support:
                what = f"The carrier {carrier!r} moves the frame {frame!r}, which closes a loop or is the platform."
                remedy = "A carrier slides beside the load path; declare this joint as actuated instead."
                raise DeclarationError(what, remedy=remedy, carrier=carrier, frame=frame)
