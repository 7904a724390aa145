"""Load a robot: read its files, close its reference configuration, check its mobility."""

from __future__ import annotations

import logging
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import Any, cast

import numpy as np
import pinocchio as pin

from redundancy_pin.arrays import Array, IntArray, checked, frozen, read_only
from redundancy_pin.errors import DeclarationError, InputError, millimetres
from redundancy_pin.kinematics.assembly import TURNED_OVER
from redundancy_pin.kinematics.closing import closed_near
from redundancy_pin.kinematics.closure import ConstraintSystem, with_all_rows
from redundancy_pin.kinematics.coordinates import (
    gravity_acts,
    in_working_mode,
    mode_name,
    reference_coordinates,
    working_modes,
)
from redundancy_pin.kinematics.mobility import check_mobility, check_reference_rank, other_axes
from redundancy_pin.kinematics.multistart import multistart
from redundancy_pin.kinematics.selection import STAYS_CLOSED, Selection, selected
from redundancy_pin.robot import Closure, Coupling, Robot
from redundancy_pin.robot.build import build, characteristic_length, robot_of_tree
from redundancy_pin.robot.changes import changed_urdf, require_still_joined
from redundancy_pin.robot.declaration import Declaration, parse, read_declaration, require_conditions
from redundancy_pin.robot.formats.mechanism import NOT_IN_FORCE, Mechanism
from redundancy_pin.robot.formats.urdf_tree import WITHOUT_INERTIAL
from redundancy_pin.robot.from_model import declared, depth_first, in_order_of, not_in_force
from redundancy_pin.robot.loads import JointForces, Load
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.robot.model_files import is_model_file, read_mechanism
from redundancy_pin.robot.named import too_few_motors
from redundancy_pin.robot.scales import closure_tolerance, is_revolute
from redundancy_pin.robot.urdf import Argument, declaration_path, is_shipped, known_values, render, source_of

_LOG = logging.getLogger(__name__)


def load_robot(
    source: str | Path,
    *,
    gravity: Sequence[float] | None = None,
    working_mode: Sequence[int] | None = None,
    trust: bool = False,
    **arguments: object,
) -> Robot:
    """Load a robot, close its chains at the declared reference and check its mobility.

    A robot is data: expressions in its files calculate and no more, and cannot cost more than a second or two.

    Args:
        source: name of a shipped robot ("2rpr", "delta", ...: ``redundancy-pin info``), path of a ``robot.yaml``, or of
            the folder that holds one.
        gravity: (3,) acceleration of gravity in the world frame, m/s²; as declared when left out.
        working_mode: ±1 a leg; as declared when left out.
        trust: let the expressions of a xacro file be any Python, which runs with your rights: for files whose author
            you trust.
        **arguments: xacro arguments of the robot's URDF (``carrier_mass=2.0``).

    Raises:
        ModelFileError: missing or broken files, expressions that are more than calculation, numbers that Pinocchio
            would read differently.
        InputError: an unknown xacro argument, a gravity or working mode of the wrong form.
        DeclarationError: a declaration that contradicts the URDF or itself: unknown names, joints in two roles, over-
            or under-constrained chains, a reference that does not close.
    """
    robot = load_with(source, arguments, gravity=gravity, working_mode=working_mode, trust=trust)
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
) -> Robot:
    """Load a robot as ``load_robot``, with xacro arguments that come from a file.

    Among keywords, a file could name ``trust`` as one of them.
    """
    written, path = repr((sorted(arguments.items()), gravity, working_mode)), declaration_path(source)
    kept = is_shipped(path) and not trust
    # what is kept is known by a path that means the same in all folders
    request = _Request(path.resolve() if kept else path, written, arguments, gravity, working_mode, trust)
    if is_model_file(path):
        return _load_model(request, {})
    if not kept:
        return _declared(request)
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


def _declared(request: _Request) -> Robot:
    file = read_declaration(request.path)
    with file.naming():
        return _load(request, file.data)


# files of shipped robots do not change, and sweeps, commands and tests load the same ones time and again
_shipped = lru_cache(maxsize=64)(_declared)


def robot_with(
    robot: Robot, masses: Mapping[str, float], lengths: Mapping[str, Any], arguments: Mapping[str, object]
) -> Robot:
    """Return a robot with other parameters; see ``Robot.with_parameters``."""
    path = declaration_path(robot.source) if robot.source else Path()
    if not robot.source or is_model_file(path) or is_model_file(path.parent / read_declaration(path).data["urdf"]):
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
    file = read_declaration(path)
    with file.naming():
        declaration = parse(file.data, robot.parameters)
        urdf = changed_urdf(robot.urdf, masses, lengths)
        new = _built(declaration, path, urdf, robot.parameters, robot.gravity.tolist(), mode)
        new = replace(
            new,
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
            new = _closed(
                new, declaration, lambda: reference_coordinates(new, declaration.coordinates(robot.parameters))
            )
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
    source_file = request.path.parent / data["urdf"]
    if is_model_file(source_file):
        return _load_model(request, data)
    # before xacro runs, which would make a cryptic error of a length that is negative; and after, on what it evaluated
    require_conditions(data, known_values(source_file, request.arguments))
    urdf, parameters = render(source_file, request.arguments, trust=request.trust)
    require_conditions(data, parameters)
    declaration = parse(data, parameters)
    robot = _built(declaration, request.path, urdf, parameters, request.gravity, request.working_mode)
    _report(robot.notes, source_file)
    robot = replace(robot, urdf_folder=str(source_file.resolve().parent))
    return _closed(robot, declaration, lambda: reference_coordinates(robot, declaration.coordinates(parameters)))


def _built(declaration: Declaration, *arguments: Any) -> Robot:
    """Return what ``build`` makes of a declaration, without redundant closure rows where it says that there are any."""
    robot = build(declaration, *arguments)
    if not declaration.redundant_rows:
        return robot
    robot, _, notes = _with_rows_that_count(robot, redundant=True, rounded=True)
    return replace(robot, notes=(*robot.notes, *notes))


def _load_model(request: _Request, data: Mapping[str, Any]) -> Robot:
    """Load a file that describes a whole mechanism, with what a declaration that names it adds to that."""
    file = request.path.parent / data["urdf"] if data else request.path
    mechanism, parameters = read_mechanism(file, request.arguments)
    try:
        robot = _of_mechanism(mechanism, request, file, data, parameters)
    except DeclarationError as error:
        if "balls" not in error.details:
            raise
        mechanism = mechanism.with_hinges(cast("tuple[str, ...]", error.details["balls"]))
        robot = _of_mechanism(mechanism, request, file, data, parameters)
    _report(mechanism.notes, file)
    robot = replace(robot, notes=(*mechanism.notes, *robot.notes), urdf_folder=str(file.resolve().parent))
    if data.get("urdf_dynamics") is False:
        return replace(robot, notes=(*robot.notes, f"Friction and springs of {file.name} are not in force."))
    named = {load.joint for load in robot.loads if isinstance(load, JointForces)}  # the declaration comes first
    return robot.loaded(*(load for load in mechanism.forces if load.joint not in named))


def _of_mechanism(
    mechanism: Mechanism, request: _Request, file: Path, data: Mapping[str, Any], parameters: Mapping[str, Argument]
) -> Robot:
    model = mechanism.model(str(file))
    wanted = data.get("gravity") if request.gravity is None else request.gravity
    if wanted is not None:
        model.gravity.linear = np.array(checked(wanted, "gravity", (3,)))
    own = [{"name": c.name, "frames": [c.frame_a, c.frame_b], "axes": list(c.axes)} for c in mechanism.closures]
    further = data.get("closures")
    roles = {
        "name": request.path.parent.name if data else mechanism.name,
        "urdf": file.name,
        "actuated": list(mechanism.actuated),
        "reference": {},
        **data,
        "closures": [*own, *further] if isinstance(further, list) else own if further is None else further,
    }
    if not roles["actuated"]:
        sdf = file.suffix.lower() == ".sdf"  # which has no actuators
        drive = 'Name what is driven (actuated="a,b", or --set actuated=a,b)' if sdf else "Give it actuators"
        remedy = f"{drive}, or write a robot.yaml that names it under `urdf`, and joints under `actuated`."
        raise DeclarationError(f"{file.name} drives no joint.", remedy=remedy)
    return made(
        roles,
        model,
        mechanism.configuration(model),
        loose=True,
        urdf=mechanism.shapes,
        mode=request.working_mode,
        parameters=parameters,
        source=source_of(request.path),
        drive_independent=not (mechanism.drives_declared or data.get("actuated") or data.get("independent")),
        couplings=mechanism.couplings,
        resisted={load.joint for load in mechanism.forces}
        | {name for name, size in mechanism.armature.items() if size},
    )


def _report(notes: Iterable[str], file: Path) -> None:
    """Log the notes that change results: forces of the file that are ignored, links whose mass it does not state."""
    for note in notes:
        if note.startswith((NOT_IN_FORCE, WITHOUT_INERTIAL)):
            _warn_once(f"{file.name}: {note}")


@lru_cache(maxsize=100)
def _warn_once(text: str) -> None:
    _LOG.warning(text)


def _closed(robot: Robot, declaration: Declaration, target: Callable[[], Array] | None, dropped: bool = False) -> Robot:
    """Return the robot with its reference closed and its mobility checked.

    Args:
        robot: with the guess as reference.
        declaration: what it was made of.
        target: gives the reference coordinates, (1, n) or (1, 4, 4); None to close the loops by the smallest change.
        dropped: redundant rows were left out though the declaration does not say `redundant_rows: true`.
    """
    system = ConstraintSystem(robot)
    dropped = dropped or declaration.redundant_rows
    check_mobility(system, dropped=dropped)
    _require_radians(robot, declaration.reference.guess, "reference.guess")
    guess = np.array(robot.q_reference)
    columns = _columns(robot.model, declaration.reference.guess)
    if target is None:
        # no pose is prescribed: the nearest closed configuration of all joints is kept
        q = closed_near(robot, guess)
        gap, closed = 0.0, bool(in_working_mode(robot, q[None])[0])
    else:
        goal = target()[0]
        _require_radians(robot, dict(zip(robot.independent_joints, goal.tolist(), strict=False)), "reference.joints")
        prescribed = _prescribed(robot, guess, goal)
        q, gap, closed = multistart(system, guess, goal, known=columns, prescribed=prescribed)
    if not closed:
        raise DeclarationError(
            _not_closed(robot, q, gap),
            remedy=other_axes(robot) or "Correct `reference` in the declaration, or the lengths given as arguments.",
            gap=gap,
        )
    robot = replace(
        robot,
        q_reference=frozen(q),
        characteristic_length=declaration.characteristic_length
        or characteristic_length(robot.model, q, robot.carriers),
    )
    check_reference_rank(ConstraintSystem(robot), dropped=dropped)
    if robot.all_closures:
        system = ConstraintSystem(with_all_rows(robot))
        turned = float(system.misalignment(system.evaluate(np.array(robot.q_reference)[None]))[0])
        if turned > TURNED_OVER:
            raise DeclarationError(
                f"At the reference of {robot.name} a hinge or weld closes the wrong way round, by {turned:.3g} rad.",
                remedy="Name a `reference.guess` nearer to the right one.",
                angle=turned,
            )
    return robot


def _prescribed(robot: Robot, guess: Array, goal: Array) -> Array:
    """Return a guess (nq,) with the joints whose positions are prescribed where they end."""
    start = guess.copy()
    for name, value in () if robot.platform else zip(robot.independent_joints, goal.tolist(), strict=True):
        joint = find_joint(robot.model, name)
        at = (value,) if joint.nq == 1 else (np.cos(value), np.sin(value))
        start[joint.idx_q : joint.idx_q + joint.nq] = at
    return start


def _columns(model: pin.Model, names: Iterable[str]) -> IntArray:
    """Return the indices in q of joints."""
    listed = [find_joint(model, name) for name in names]
    return np.array([c for joint in listed for c in range(joint.idx_q, joint.idx_q + joint.nq)], dtype=np.intp)


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
    counted = {name for each in robot.couplings for name in (each.joint, each.of)}  # their turns
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
    arguments: Mapping[str, Any],
    *,
    working_modes: Any = None,
    working_mode: Sequence[int] | None = None,
    characteristic_length: float | None = None,
    redundant_rows: bool = False,
    urdf: str = "",
    urdf_folder: str = "",
) -> Robot:
    """Return a robot as ``Robot.from_model`` says, which has its named ``arguments`` here."""
    reference, closures = arguments["reference"], arguments["closures"]
    given, (model, at) = model, depth_first(model)
    data: dict[str, Any] = {
        "name": arguments["name"] or str(getattr(model, "name", "")) or "robot",
        "urdf": "model",
        **declared(model, arguments, at),
        "working_modes": working_modes,
        "characteristic_length": characteristic_length,
        "redundant_rows": redundant_rows,
        "reference": reference if isinstance(reference, Mapping) else {},
        "gravity": model.gravity.linear.tolist(),
    }
    near = not (reference is None or isinstance(reference, Mapping))
    start = in_order_of(model, given, at, checked(reference, "reference", (model.nq,))) if near else None
    loose = any(hasattr(each, "joint1_placement") for each in closures)
    robot = made(data, model, start, loose=loose, urdf=urdf, mode=working_mode)
    moved = () if at == sorted(at) else ("Joints are numbered depth first, as Pinocchio's mass matrix needs them.",)
    if note := too_few_motors(robot):
        _warn_once(note)
    return replace(robot, urdf_folder=urdf_folder, notes=(*robot.notes, *moved, *not_in_force(given)))


def made(
    data: Mapping[str, Any],
    model: pin.Model,
    start: Array | None,
    *,
    loose: bool,
    urdf: str = "",
    mode: Sequence[int] | None = None,
    parameters: Mapping[str, Argument] = MappingProxyType({}),
    source: str = "",
    drive_independent: bool = False,
    couplings: Sequence[Coupling] = (),
    resisted: Collection[str] = (),
) -> Robot:
    """Return the robot of a declaration and a model that was built already.

    Args:
        data: the declaration, checked here; without ``independent`` joints are chosen.
        model: the tree, which becomes the robot's own.
        start: (nq,) where the reference is looked for; joints of the declaration's guess go where it says.
        loose: leave out closure rows that are redundant.
        urdf: what shapes are drawn from.
        mode: ±1 a leg; as declared when left out.
        parameters: of the robot.
        source: of the robot, where a file says what it is; its numbers may be rounded.
        drive_independent: let the joints that are chosen as independent be the main actuators, ``actuated`` first.
        couplings: those of the model, beside those of the declaration.
        resisted: joints with damping or armature.
    """
    chosen = dict(data)
    chosen["independent"] = data.get("independent") or {"joints": list(data["actuated"])}
    declaration = parse(chosen, {})
    robot = robot_of_tree(
        declaration,
        model,
        name=str(declaration.name),
        parameters=parameters,
        urdf=urdf,
        source=source,
        mode=mode,
        couplings=couplings,
    )
    if start is not None:
        listed = _columns(model, declaration.reference.guess)
        guess = np.array(start)
        guess[listed] = robot.q_reference[listed]
        robot = replace(robot, q_reference=frozen(guess))
    notes: list[str] = []
    loose = loose or declaration.redundant_rows
    if loose or not data.get("independent"):
        robot, selection, notes = _with_rows_that_count(robot, redundant=loose, rounded=bool(source), resisted=resisted)
        if not data.get("independent"):
            robot = replace(robot, independent_joints=selection.independent)
            notes.append(f"Independent joints, chosen: {', '.join(selection.independent)}.")
        if drive_independent:
            columns = [find_joint(model, name).idx_v for name in selection.independent]
            driven = read_only(np.array(columns, dtype=np.intp))
            robot = replace(robot, actuated=selection.independent, actuated_velocity=driven)
            notes.append(
                "The file does not say what is driven: taken are the independent joints; actuated=... names others."
            )
    given = declaration.reference
    prescribed = given.platform is not None or given.joints is not None
    target = (lambda: reference_coordinates(robot, declaration.coordinates({}))) if prescribed else None
    return replace(_closed(robot, declaration, target, loose), notes=tuple(notes))


def _with_rows_that_count(
    robot: Robot, *, redundant: bool, rounded: bool, resisted: Collection[str] = ()
) -> tuple[Robot, Selection, list[str]]:
    """Return a robot without its redundant closure rows, what else was chosen, and what is to be said of it."""
    notes: list[str] = []
    provisional = replace(robot, platform=None, independent_joints=())
    selection = selected(
        provisional, np.array(robot.q_reference), redundant=redundant, rounded=rounded, resisted=resisted
    )
    kept = selection.robot
    robot = replace(robot, model=kept.model, closures=kept.closures, couplings=kept.couplings)
    if selection.fixed_spins:
        notes.append(
            f"The spin of {', '.join(selection.fixed_spins)} about the line between two balls, which moves nothing "
            "else, is held: one ball is a universal joint, the first where it has damping or armature; where both "
            "have, this is an approximation."
        )
    if selection.off_axis:
        listed = ", ".join(f"{name} by {away:.2g} m" for name, away in selection.off_axis.items())
        notes.append(
            f"The centre of mass is off that line: {listed}. There a rod between two balls swings, which is left out: "
            "what holds its spin carries the moment."
        )
    if selection.left_out:
        # rows that are left say less of the side on which a weld closes: what follows starts on the right one
        every = _with_redundant_rows(kept.closures, provisional.closures)
        robot = replace(robot, q_reference=frozen(selection.q), all_closures=every)
        rows, opened = ", ".join(selection.left_out), selection.opened
        nearby = (
            f" to {opened:.1g} (characteristic lengths or rad) nearby, as the file's numbers are rounded"
            if opened > STAYS_CLOSED
            else ""
        )
        notes.append(f"Redundant closure rows left out, the loops stay closed in them{nearby}: {rows}.")
    return robot, selection, notes


def _with_redundant_rows(closures: tuple[Closure, ...], all_rows: tuple[Closure, ...]) -> tuple[Closure, ...]:
    """Return closures with the axes that they have among all; empty where none is missing.

    One between other frames than before, as where the spin of a rod is held, has all of its own.
    """
    given = {(each.name, each.frame_a, each.frame_b): each for each in all_rows}
    whole = [given.get((each.name, each.frame_a, each.frame_b), each) for each in closures]
    names = {each.name for each in closures}
    whole += [each for each in all_rows if each.name not in names]
    return tuple(whole) if whole != list(closures) else ()
