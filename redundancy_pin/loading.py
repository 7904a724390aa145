"""Load or make a robot: read its files, close its reference configuration, check its mobility."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext, suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeAlias, cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import AGREEMENT_TOLERANCE, Array, checked, frozen, require_type
from redundancy_pin.errors import DeclarationError, InputError, millimetres
from redundancy_pin.kinematics.assembly import TURNED_OVER
from redundancy_pin.kinematics.closing import closed_near
from redundancy_pin.kinematics.closure import ConstraintSystem, with_all_rows
from redundancy_pin.kinematics.coordinates import (
    gravity_acts,
    in_working_mode,
    joint_position,
    mode_name,
    reference_coordinates,
    working_modes,
)
from redundancy_pin.kinematics.cut_ends import about_several_axes, branches_meet, common_axis
from redundancy_pin.kinematics.mobility import check_mobility, check_reference_rank, other_axes
from redundancy_pin.kinematics.multistart import multistart
from redundancy_pin.kinematics.selection import Selection, selected
from redundancy_pin.robot import Closure, Coupling, Platform, Robot
from redundancy_pin.robot.build import characteristic_length, configuration, read_robot
from redundancy_pin.robot.changes import changed_urdf, require_still_joined
from redundancy_pin.robot.checks import too_few_motors
from redundancy_pin.robot.declaration import Declaration, parse, read_declaration, require_conditions
from redundancy_pin.robot.formats.mechanism import NOT_IN_FORCE, Mechanism
from redundancy_pin.robot.formats.urdf import WITHOUT_INERTIAL
from redundancy_pin.robot.from_model import declared, in_order_of, not_in_force
from redundancy_pin.robot.joint_ranges import meet_limits
from redundancy_pin.robot.loads import Load
from redundancy_pin.robot.lookup import find_joint, has_joint, joint_names
from redundancy_pin.robot.model_files import (
    is_model_file,
    is_urdf,
    mechanism_of_urdf,
    open_model,
    states_gravity,
)
from redundancy_pin.robot.propose import Proposal, propose
from redundancy_pin.robot.rebuild import rebuilt, span
from redundancy_pin.robot.scales import closure_tolerance, is_revolute
from redundancy_pin.robot.urdf import Argument, declaration_path, is_shipped, known_values, source_of

_LOG = logging.getLogger(__name__)

RobotLike: TypeAlias = Robot | str | Path
"""A robot, the name of a shipped one, or the path of a declaration or of its folder."""


def as_robot(robot: RobotLike) -> Robot:
    """Return a robot, loaded as ``load_robot`` does if it is named: the first line of every function that takes one.

    Raises:
        InputError: neither a robot nor a name or path.
        RedundancyPinError: what ``load_robot`` raises.

    Example:
        >>> as_robot("3rrr").n
        3
    """
    if isinstance(robot, (str, Path)):
        return load_robot(robot)
    require_type(robot, Robot, "A robot", "Pass load_robot(...), or the name or path of one.")
    return robot


def load_robot(
    source: str | Path,
    *,
    gravity: Sequence[float] | None = None,
    working_mode: Sequence[int] | None = None,
    trust: bool = False,
    untrusted: bool = False,
    **arguments: object,
) -> Robot:
    """Load a robot, close its chains at the declared reference and check its mobility.

    A robot is data: expressions in its files calculate and no more, and cannot cost more than a second or two.

    Args:
        source: name of a shipped robot ("2rpr", "delta", ...: ``redundancy-pin info``), path of a ``robot.yaml``, of
            the folder that holds one, or of a model file (URDF, xacro, MJCF, SDF) that states its loops and motors.
        gravity: (3,) acceleration of gravity in the world frame, m/s²; as declared when left out.
        working_mode: ±1 a leg; as declared when left out.
        trust: let the expressions of a xacro file be any Python, which runs with your rights, and let MJCF read files
            of other folders: for files whose author you trust.
        untrusted: let third-party compilers (xacro, MuJoCo's) read a stranger's file in a child process, which has
            limits of time and memory.
        **arguments: xacro arguments of the robot's URDF (``carrier_mass=2.0``). Model files without a declaration take
            ``base`` ("fixed" or "free") and ``actuated``, the motors ("a,b" or a list of names).

    Raises:
        ModelFileError: missing or broken files, expressions that are more than calculation, numbers that Pinocchio
            would read differently.
        InputError: an unknown xacro argument, a gravity or working mode of the wrong form.
        DeclarationError: a declaration that contradicts the URDF or itself: unknown names, joints in two roles, over-
            or under-constrained chains, a reference that does not close.
    """
    robot = load_with(source, arguments, gravity=gravity, working_mode=working_mode, trust=trust, untrusted=untrusted)
    for note in filter(None, (idle_gravity(robot, gravity), too_few_motors(robot))):
        _warn_once(note)
    return robot


def idle_gravity(robot: Robot, given: Sequence[float] | None) -> str:
    """Return what to say of a gravity that was asked for and moves nothing; empty if there is nothing to say."""
    if given is None or not np.any(robot.gravity) or gravity_acts(robot):
        return ""
    return (
        f"gravity = {robot.gravity.tolist()} is normal to the plane in which {robot.name} moves: it has no effect on "
        "efforts."
    )


def load_with(
    source: str | Path,
    arguments: Mapping[str, object],
    *,
    gravity: Sequence[float] | None = None,
    working_mode: Sequence[int] | None = None,
    trust: bool = False,
    untrusted: bool = False,
) -> Robot:
    """Load a robot as ``load_robot``, with xacro arguments that come from a file.

    Among keywords, a file could name ``trust`` as one of them.
    """
    written, path = repr((sorted(arguments.items()), gravity, working_mode)), declaration_path(source)
    kept = is_shipped(path) and not trust
    # what is kept is known by a path that means the same in all folders
    request = _Request(path.resolve() if kept else path, written, arguments, gravity, working_mode, trust, untrusted)
    if is_model_file(path):
        return _load(request, {})
    if not kept:
        return _load_declared(request)
    robot = _shipped(request)
    return replace(robot, model=robot.model.copy())  # of what is shared, all that can be changed


@dataclass(frozen=True)
class _Request:
    """A request for a robot; compared as written, since 1, 1.0 and True are three arguments of xacro."""

    path: Path
    written: str
    arguments: Mapping[str, object] = field(compare=False)
    gravity: Sequence[float] | None = field(compare=False)
    working_mode: Sequence[int] | None = field(compare=False)
    trust: bool
    untrusted: bool


def _load_declared(request: _Request) -> Robot:
    file = read_declaration(request.path)
    with file.naming():
        return _load(request, file.data)


# files of shipped robots do not change, and sweeps, commands and tests load the same ones time and again
_shipped = lru_cache(maxsize=64)(_load_declared)


def with_parameters(
    robot: RobotLike,
    /,
    *,
    masses: Mapping[str, float] | None = None,
    lengths: Mapping[str, Any] | None = None,
    **arguments: object,
) -> Robot:
    """Return a robot with other masses, lengths or xacro arguments, closed and checked as when it was loaded.

    Gravity, working mode and loads stay; limits too, unless xacro arguments are given. A robot whose masses or
    lengths are changed has no closed form any more (``VirtualWork`` refuses it): that is written in the arguments.

    Args:
        robot: a robot, or its name or path.
        masses: kg, by link; the moments of inertia of a link grow as its mass does, its centre stays. (Derivatives
            by ``"JOINT.mass"`` hold the inertia about the centre: ``dynamics.compiled.design_of``.)
        lengths: by joint, its distance from the joint before it, m; or (3,) its place in the frame of its parent
            link, m. This moves joints and frames only: masses, centres and moments of inertia of the links stay as
            they were, which ``notes`` and the log say. Xacro arguments of a file change both.
        **arguments: xacro arguments, as of ``load_robot``; the others stay.

    Raises:
        InputError: unknown names, values out of their domain, a robot that was not loaded from a URDF, or lengths
            that part a frame of a closure or the platform from a joint or frame at the same place.
        DeclarationError: the chains do not close at the declared reference any more.

    Example:
        >>> heavier = with_parameters(load_robot("four_bar"), masses={"rocker_link": 2.5})
    """
    robot = as_robot(robot)
    masses, lengths = {} if masses is None else masses, {} if lengths is None else lengths
    path = declaration_path(robot.source) if robot.source else None
    file = None if path is None or is_model_file(path) else read_declaration(path)
    if path is None or not is_urdf(path if file is None else Path(file.data["urdf"])):
        raise InputError(
            f"{robot.name} was not loaded from a URDF.",
            remedy="Change its Pinocchio model, or its file, and make the robot of that.",
        )
    mode = robot.working_mode or None
    if arguments:
        if any(note.startswith(_CHANGED) for note in robot.notes):
            raise InputError(
                f"Masses or lengths of {robot.name} are changed already; its arguments would be read from its files.",
                remedy="Give the arguments first, or all in one call.",
            )
        loads = robot.loads
        robot = load_with(
            robot.source, {**robot.parameters, **arguments}, gravity=robot.gravity.tolist(), working_mode=mode
        )
        robot = _with_added(robot, loads)
    if not (masses or lengths):
        return robot
    with nullcontext() if file is None else file.naming():
        roles = {"actuated": list(robot.actuated), "independent": {"joints": list(robot.independent_joints)}}
        data = {"urdf": path.name, **roles} if file is None else file.data
        declaration = parse(_with_defaults(data, path), robot.parameters)
        mechanism = mechanism_of_urdf(
            changed_urdf(robot.urdf, masses, lengths),
            path.parent / declaration.urdf,
            robot.parameters,
            None if file is None else declaration.joint_types,
        )
        if file is None:  # ends of loops that were found stay ends; the reference is the nearest closed configuration
            stated = {joint.name for joint in mechanism.loop_joints}
            found = [f"{each.frame_a},{each.frame_b}" for each in robot.closures if each.name not in stated]
            mechanism = propose(mechanism, close=found, is_open=True).mechanism
            if turned := [name for name in joint_names(mechanism.model) if not has_joint(robot.model, name)]:
                mechanism = mechanism.with_hinges(turned)  # the balls that moved freely when the robot was loaded
            mechanism = replace(mechanism, start=np.array(robot.q_reference))
        new, dropped = _select_rows(
            declaration,
            mechanism,
            gravity=robot.gravity.tolist(),
            parameters=robot.parameters,
            source=robot.source,
            mode=mode,
            rods={each.name: each.length for each in robot.closures},
        )
        new = replace(
            new,
            name=robot.name,
            urdf_folder=robot.urdf_folder,
            carrier_limits=robot.carrier_limits,
            own_meshes_only=robot.own_meshes_only,
            closed_form=None,  # it is written in the arguments, which say something else now
            notes=(*robot.notes, f"{_CHANGED} {', '.join([*masses, *lengths])}", *_lengths_only(robot, lengths)),
        )
        for bound in ("lower", "upper"):
            for what in ("Position", "Velocity", "Effort"):
                setattr(new.model, f"{bound}{what}Limit", getattr(robot.model, f"{bound}{what}Limit"))
        if lengths:
            require_still_joined(robot, new)
            new = _close_reference(new, declaration, robot.parameters, dropped)
        else:  # masses close no loop: the reference is that of the robot
            new = replace(new, q_reference=robot.q_reference, characteristic_length=robot.characteristic_length)
        return _with_added(new, robot.loads)


def _with_added(robot: Robot, loads: tuple[Load, ...]) -> Robot:
    """Return a robot that was read anew with the loads it got since: those of its files come first, and it has them."""
    added = loads[len(robot.loads) :]
    return robot.loaded(*added) if added else robot


_CHANGED = "changed since it was loaded:"
"""How a note begins that says so."""


def _lengths_only(robot: Robot, lengths: Iterable[str]) -> tuple[str, ...]:
    """Return a note that lengths change no masses, and log it; nothing without lengths."""
    if not (names := ", ".join(lengths)):
        return ()
    note = f"The lengths at {names} move joints and frames: links keep masses, centres and moments of inertia."
    _warn_once(f"{robot.name}: {note}")
    return (note,)


def _load(request: _Request, data: Mapping[str, Any]) -> Robot:
    """Load a mechanism with what a declaration adds to it, or without one."""
    file = request.path.parent / data["urdf"] if data else request.path
    if data and is_urdf(file):
        # before xacro runs, which would make a cryptic error of a length that is negative
        require_conditions(data, known_values(file, request.arguments))
    parameters, read = open_model(file, request.arguments, trust=request.trust, untrusted=request.untrusted)
    require_conditions(data, parameters)
    kinds: Mapping[str, str] | None = {} if data else None
    if data.get("joint_types"):
        kinds = parse(_with_defaults(data, request.path), parameters).joint_types
    mechanism = read(kinds)
    if data:
        robot = _robot_of(mechanism, request, file, data, parameters)
    else:
        proposal = propose(mechanism)
        _require_decided(proposal, file)
        proposal, robot = _settled(proposal, request, parameters)
        _require_decided(proposal, file)
    _report(robot.notes, file)
    return replace(robot, urdf_folder=str(file.resolve().parent))


def _robot_of(
    mechanism: Mechanism, request: _Request, file: Path, data: Mapping[str, Any], parameters: Mapping[str, Argument]
) -> Robot:
    """Return the robot of a mechanism, with hinges for balls that move freely."""
    try:
        return _build(mechanism, request, file, data, parameters)
    except DeclarationError as error:
        if "balls" not in error.details:
            raise
        hinged = mechanism.with_hinges(cast("tuple[str, ...]", error.details["balls"]))
    return _build(hinged, request, file, data, parameters)


# --- files that leave something open ----------------------------------------------------------------------------------


def propose_robot(
    path: Path,
    *,
    close: Sequence[str] = (),
    actuate: Sequence[str] = (),
    independent: Sequence[str] = (),
    guess: Mapping[str, float] = MappingProxyType({}),
    is_open: bool = False,
    trust: bool = False,
    untrusted: bool = False,
) -> tuple[Proposal, Robot | None]:
    """Return what is certain of a model file and what is to be asked, and the robot, None where none can be made yet.

    Args:
        path: a file of ``load_robot`` that needs no declaration.
        close: as of ``propose``.
        actuate: as of ``propose``.
        independent: names of independent joints; chosen where it is empty.
        guess: positions of joints, rad or m; the loops are closed near them.
        is_open: as of ``propose``.
        trust: as of ``load_robot``.
        untrusted: as of ``load_robot``.

    Raises:
        RedundancyPinError: files that cannot be read, unknown names.

    Example:
        >>> proposal, robot = propose_robot(Path("five_bar.urdf"), close=["ltip,rtip"], actuate=["a", "c"])
    """
    parameters, read = open_model(path, {}, trust=trust, untrusted=untrusted)
    proposal = propose(read(None), close=close, actuate=actuate, is_open=is_open)
    mechanism = proposal.mechanism
    if proposal.questions:
        return proposal, None
    start = configuration(mechanism.model, guess, mechanism.start)
    mechanism = replace(mechanism, start=start, independent=tuple(independent) or mechanism.independent)
    request = _Request(path, "", {}, None, None, trust, untrusted=untrusted)
    try:
        proposal, robot = _settled(replace(proposal, mechanism=mechanism), request, parameters)
    except DeclarationError as error:
        return proposal.refused(str(error)), None
    motors = len(proposal.mechanism.actuated)
    if is_urdf(path) and not (actuate or is_open or proposal.questions) and motors < robot.n:
        have = f"The mechanism has {robot.n} DOF and {motors} motor(s)"
        proposal = proposal.asking(
            f"Is a loop or a motor missing? {have}: --close A,B or --actuate A,B; --open if none is."
        )
    return proposal, robot


def _settled(proposal: Proposal, request: _Request, parameters: Mapping[str, Argument]) -> tuple[Proposal, Robot]:
    """Return a proposal with the questions that only the closed mechanism raises, and its robot.

    Where branches meet at the start, the reference is a pose near it, which may be on another branch than the machine.
    """
    mechanism, file = proposal.mechanism, request.path

    def build(own: Mechanism) -> Robot:
        return _robot_of(own, request, file, {}, parameters)

    try:
        robot = build(mechanism)
        is_flat = len(mechanism.start) == robot.model.nq and branches_meet(robot, mechanism.start)
    except DeclarationError as error:
        if "rank" not in error.details or not mechanism.loop_joints:
            raise
        robot, is_flat = _build_near_start(mechanism, build, error), True
    proposal = proposal.settled(robot, _turning(proposal, robot)).asking(*_hinges_off_axis(proposal, build))
    return (proposal.asking(_which_branch(robot)) if is_flat else proposal), robot


def _hinges_off_axis(proposal: Proposal, build: Callable[[Mechanism], Robot]) -> Iterator[str]:
    """Yield questions on hinges by --close about another axis than their links turn about where a ball joins them.

    Such a hinge holds them like a weld.
    """
    loops = proposal.mechanism.loop_joints
    for hinge in proposal.hinges_by_flag:
        joints = tuple(replace(each, kind="ball") if each is hinge else each for each in loops)
        axis = None
        with suppress(DeclarationError):
            axis = common_axis(build(replace(proposal.mechanism, loop_joints=joints)), hinge.links)
        if axis is not None and (away := np.arctan2(np.hypot(*axis[:2]), abs(axis[2]))) > _OFF_AXIS:
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
    single = [name for name in joint_names(robot.model) if find_joint(robot.model, name).nv == 1]
    at = (f"{name}={joint_position(robot, name, robot.q_reference[None])[0]:.3g}" for name in single)
    return (
        f"{_BRANCH} Where all joints start, loops lie in a line and branches meet. Name where the joints are near "
        f"the reference: --guess JOINT=VALUE,...; one branch nearby has --guess {','.join(at)}."
    )


def _turning(proposal: Proposal, robot: Robot) -> tuple[str, ...]:
    """Return the loop joints of unknown kind whose links turn against each other about several axes."""
    loops = proposal.mechanism.loop_joints
    ends = {joint.name: joint.links for joint in loops if joint.name in proposal.mechanism.presumed}
    return tuple(name for name, links in ends.items() if links in about_several_axes(robot, tuple(ends.values())))


def _require_decided(proposal: Proposal, file: Path) -> None:
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


def _with_defaults(data: Mapping[str, Any], path: Path) -> dict[str, Any]:
    """Return a declaration with what can be left out."""
    return {"name": path.resolve().parent.name, "reference": {}, **data}


_LARGEST_OFFSET = 0.5
"""rad and m, of each joint: where loops lie in a line at the start of a file, poses within this of it are tried."""

_MOST_TRIES = 8
"""Number of poses that are tried: each is as good as any other, and fails only near a singularity."""


def _build_near_start(mechanism: Mechanism, build: Callable[[Mechanism], Robot], error: DeclarationError) -> Robot:
    """Return a robot whose reference is near the start of its mechanism, where loops in a line lose rank.

    Args:
        mechanism: what a file describes.
        build: returns the robot of a mechanism with another start.
        error: raised again if no pose serves.
    """
    model, rng = mechanism.model, np.random.default_rng(1)
    for _ in range(_MOST_TRIES):
        start = pin.integrate(model, mechanism.start, rng.uniform(-_LARGEST_OFFSET, _LARGEST_OFFSET, model.nv))
        if model.nq == model.nv:
            start = np.clip(start, model.lowerPositionLimit, model.upperPositionLimit)
        with suppress(DeclarationError):
            return build(replace(mechanism, start=start))
    raise error


def _build(
    mechanism: Mechanism, request: _Request, file: Path, data: Mapping[str, Any], parameters: Mapping[str, Argument]
) -> Robot:
    """Return the robot of a mechanism, its roles those of the declaration ``data``, otherwise those of the file."""
    given = _with_defaults(data, request.path) if data else {"name": mechanism.name, "reference": {}}
    if mechanism.independent:
        given = {"independent": {"joints": list(mechanism.independent)}, **given}
    given = {"urdf": file.name, "actuated": list(mechanism.actuated), **given}
    if not given["actuated"]:
        named = "Name what is driven under `actuated`." if data else "It has no joint that could be: add one."
        raise DeclarationError(f"{file.name} drives no joint.", remedy=named)
    # a URDF does not say it: a declaration of one that leaves it out has none
    unsaid = [0.0, 0.0, 0.0] if data and is_urdf(file) else mechanism.model.gravity.linear.tolist()
    own = data.get("gravity", unsaid)
    robot = build_robot(
        given,
        replace(mechanism, model=mechanism.model.copy()),  # it gets frames, and may be needed again
        gravity=own if request.gravity is None else request.gravity,
        drop_dependent=not (data and is_urdf(file)),
        mode=request.working_mode,
        parameters=parameters,
        source=source_of(request.path),
    )
    if request.gravity is not None or "gravity" in data or states_gravity(file):
        return robot
    note = f"No file states gravity: it is {robot.gravity.tolist()} m/s²; gravity=... or a robot.yaml states another."
    return replace(robot, notes=(*robot.notes, note))


def _report(notes: Iterable[str], file: Path) -> None:
    """Log the notes that change results: forces of the file that are ignored, links whose mass it does not state."""
    for note in notes:
        if note.startswith((NOT_IN_FORCE, WITHOUT_INERTIAL)):
            _warn_once(f"{file.name}: {note}")


@lru_cache(maxsize=100)
def _warn_once(text: str) -> None:
    _LOG.warning(text)


def _close_reference(
    robot: Robot, declaration: Declaration, parameters: Mapping[str, Argument], dropped: bool
) -> Robot:
    """Return the robot with its reference closed and its mobility checked.

    Args:
        robot: with the guess as reference.
        declaration: what it was made of.
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
    if robot.all_closures:
        system = ConstraintSystem(with_all_rows(robot))
        turned = float(system.misalignment(system.evaluate(np.array(robot.q_reference)[None]))[0])
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


# --- from a Pinocchio model -------------------------------------------------------------------------------------------


def robot_from_model(
    model: pin.Model,
    *,
    actuated: Sequence[str],
    closures: Sequence[Any] = (),
    carriers: Sequence[Any] = (),
    independent: Sequence[str] | Platform | Mapping[str, Any] | None = None,
    reference: ArrayLike | Mapping[str, Any] | None = None,
    name: str = "",
    couplings: Sequence[Coupling | Mapping[str, Any] | tuple[str, str, Sequence[float]]] = (),
    working_modes: Any = None,
    working_mode: Sequence[int] | None = None,
    characteristic_length: float | None = None,
    redundant_rows: bool = False,
    urdf: str = "",
    urdf_folder: str = "",
) -> Robot:
    """Return a closed-chain robot made of a Pinocchio tree, with the checks that a file goes through.

    Args:
        model: the tree; it is copied. Its gravity counts. Frames of any type may be named, and what a joint carries
            by the joint's name where it has no link, "universe" for the ground.
        actuated: names of the main actuators.
        closures: the loops, each a ``Closure``, a mapping ``{"frames": [a, b], "axes": ["x", "y"]}``, a tuple
            ``(a, b, axes)``, or a constraint model of Pinocchio; of the latter, rows that are redundant all along
            the motion are left out, and ``notes`` says which.
        carriers: names of carrier joints, or mappings as in a ``robot.yaml`` (``{"joint": ..., "speed": ...}``).
        independent: names of joints, a ``Platform``, a mapping ``{"platform": frame, "axes": [...]}``; left out:
            joints are chosen, actuated ones first.
        reference: (nq,) a configuration near which the closed one is, a mapping ``{"platform": [...], "guess":
            {...}}`` or ``{"joints": {...}, "guess": {...}}`` as in a ``robot.yaml``; left out: near the neutral
            configuration of Pinocchio.
        name: what to call it; the model's own name when left out.
        couplings: joints that follow others, each a ``Coupling``, a mapping ``{"joint": ..., "of": ...,
            "polynomial": [...]}``, or a tuple of the three.
        working_modes: as in a ``robot.yaml``.
        working_mode: ±1 a leg.
        characteristic_length: as in a ``robot.yaml``, m.
        redundant_rows: as in a ``robot.yaml``, for closures of any kind.
        urdf: text of the URDF that its shapes are drawn from.
        urdf_folder: folder of the mesh files of that URDF.

    Raises:
        InputError: no Pinocchio model, or arguments of the wrong form.
        DeclarationError: names that are not in the model, joints in two roles, over- or under-constrained chains, a
            reference that does not close.
        UnsupportedRobotError: a joint of a type that closed chains do not cover.

    Example:
        >>> robot_from_model(load_robot("four_bar").model, actuated=["crank"], closures=load_robot("four_bar").closures)
    """
    given, (model, at) = model, rebuilt(model)
    roles = {"actuated": actuated, "closures": closures, "carriers": carriers, "couplings": couplings}
    data: dict[str, Any] = {
        "name": name or str(getattr(model, "name", "")) or "robot",
        "urdf": "model",
        **declared(model, {**roles, "independent": independent}, at),
        "working_modes": working_modes,
        "characteristic_length": characteristic_length,
        "redundant_rows": redundant_rows,
        "reference": reference if isinstance(reference, Mapping) else {},
        "gravity": model.gravity.linear.tolist(),
    }
    start = pin.neutral(model)
    if not (reference is None or isinstance(reference, Mapping)):
        start = in_order_of(model, given, at, checked(reference, "reference", (model.nq,)))
    is_of_pinocchio = any(hasattr(each, "joint1_placement") for each in closures)
    mechanism = Mechanism(data["name"], model, start, shapes=urdf)
    robot = build_robot(data, mechanism, drop_dependent=is_of_pinocchio, mode=working_mode, own_model=True)
    moved = () if at == sorted(at) else ("Joints are numbered depth first, as Pinocchio's mass matrix needs them.",)
    if note := too_few_motors(robot):
        _warn_once(note)
    return replace(robot, urdf_folder=urdf_folder, notes=(*robot.notes, *moved, *not_in_force(given)))


def build_robot(
    data: Mapping[str, Any],
    mechanism: Mechanism,
    *,
    drop_dependent: bool,
    gravity: Sequence[float] | None = None,
    mode: Sequence[int] | None = None,
    parameters: Mapping[str, Argument] = MappingProxyType({}),
    source: str = "",
    own_model: bool = False,
) -> Robot:
    """Return the robot of a declaration and a mechanism.

    Args:
        data: the declaration, checked here; without ``independent`` joints are chosen.
        mechanism: the tree, which becomes the robot's own; the reference is looked for where it starts.
        drop_dependent: leave out dependent closure rows.
        gravity: (3,) m/s²; that of the model when left out.
        mode: ±1 a leg; as declared when left out.
        parameters: of the robot.
        source: of the robot, where a file says what it is; its numbers may be rounded.
        own_model: the tree is the user's, whose joints stay what they are.
    """
    choose = not data.get("independent")
    declaration = parse({**data, "independent": {"joints": list(data["actuated"])}} if choose else data, parameters)
    robot, dropped = _select_rows(
        declaration,
        mechanism,
        gravity=gravity,
        drop_dependent=drop_dependent,
        choose=choose,
        parameters=parameters,
        source=source,
        mode=mode,
        own_model=own_model,
    )
    return _close_reference(robot, declaration, parameters, dropped)


def _select_rows(
    declaration: Declaration,
    mechanism: Mechanism,
    *,
    gravity: Sequence[float] | None = None,
    drop_dependent: bool = False,
    choose: bool = False,
    **of: Any,
) -> tuple[Robot, bool]:
    """Return the robot, its reference not closed yet, and whether dependent closure rows were left out.

    They are left out on demand (``drop_dependent``), where the declaration expects them, and where joints close loops:
    joints of a planar mechanism constrain more than it needs.
    """
    if gravity is not None:
        mechanism.model.gravity.linear = np.array(checked(gravity, "gravity", (3,)))
    robot = read_robot(declaration, mechanism, **of)
    has_joints = bool(declaration.loop_joints or mechanism.loop_joints)
    drop_dependent = drop_dependent or declaration.redundant_rows or has_joints
    if not (drop_dependent or choose):
        return robot, False
    model, resisted = robot.model, {load.joint for load in mechanism.forces}
    resisted |= {str(model.names[i]) for i in range(1, model.njoints) if np.any(model.armature[span(model, i, "v")])}
    selection = selected(
        replace(robot, platform=None, independent_joints=()),
        np.array(robot.q_reference),
        redundant=drop_dependent,
        declared=None if choose else robot.n,
        resisted=resisted,
    )
    kept, notes, every = selection.robot, [*robot.notes, *_notes(selection)], robot.closures
    robot = replace(robot, model=kept.model, closures=kept.closures, couplings=kept.couplings)
    if selection.left_out:
        # rows that are left say less of the side on which a weld closes: what follows starts on the right one
        robot = replace(
            robot,
            q_reference=frozen(selection.q),
            all_closures=_with_redundant_rows(kept.closures, every),
            dependent_residual=selection.opened,
        )
    if choose:
        notes.append(f"Independent joints, chosen: {', '.join(selection.independent)}.")
        robot = replace(robot, independent_joints=selection.independent)
    return replace(robot, notes=tuple(notes)), drop_dependent


def _notes(selection: Selection) -> Iterator[str]:
    """Yield what is to be said of a choice of closure rows."""
    if selection.fixed_spins:
        yield (
            f"The spin of {', '.join(selection.fixed_spins)} about the line between two balls, which moves nothing "
            "else, is held: one ball is a universal joint, the first where it has damping or armature; where both "
            "have, this is an approximation."
        )
    if selection.off_axis:
        listed = ", ".join(f"{name} by {away:.2g} m" for name, away in selection.off_axis.items())
        yield (
            f"The centre of mass is off that line: {listed}. There a rod between two balls swings, which is left out: "
            "what holds its spin carries the moment."
        )
    if selection.left_out:
        rows, opened = ", ".join(selection.left_out), selection.opened
        nearby = (
            f" to {opened:.1g} (characteristic lengths or rad) nearby: numbers are rounded, or the loops move to first "
            "order only"
            if opened > AGREEMENT_TOLERANCE
            else ""
        )
        yield f"Redundant closure rows left out, the loops stay closed in them{nearby}: {rows}."


def _with_redundant_rows(closures: tuple[Closure, ...], all_rows: tuple[Closure, ...]) -> tuple[Closure, ...]:
    """Return closures with the axes that they have among all; empty where none is missing.

    One between other frames than before, as where the spin of a rod is held, has all of its own.
    """
    given = {(each.name, each.frame_a, each.frame_b): each for each in all_rows}
    whole = [given.get((each.name, each.frame_a, each.frame_b), each) for each in closures]
    names = {each.name for each in closures}
    whole += [each for each in all_rows if each.name not in names]
    return tuple(whole) if whole != list(closures) else ()
