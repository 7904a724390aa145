"""A robot of what Python has: a Pinocchio model, closures as objects of several kinds, names of frames and joints."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, checked
from redundancy_pin.errors import InputError, shown
from redundancy_pin.loading.mechanism import build_robot, warn_once
from redundancy_pin.robot import Closure, Coupling, Platform, Robot
from redundancy_pin.robot.checks import too_few_motors
from redundancy_pin.robot.formats.mechanism import Mechanism
from redundancy_pin.robot.inertia import negative_inertia
from redundancy_pin.robot.lookup import has_link
from redundancy_pin.robot.loop_joints import ROWS
from redundancy_pin.robot.rebuild import rebuilt, span
from redundancy_pin.robot.types import AXES


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
            by the joint's name if it has no link, "universe" for the ground.
        actuated: names of the main actuators.
        closures: the loops, each a ``Closure``, a mapping ``{"frames": [a, b], "axes": ["x", "y"]}``, a tuple
            ``(a, b, axes)``, or a constraint model of Pinocchio; of the latter, rows that are redundant all along
            the motion are left out, and listed in ``notes``.
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
        >>> bar = rp.load_robot("four_bar")
        >>> rp.robot_from_model(bar.model, actuated=["crank"], closures=bar.closures).n
        1
    """
    given, (model, at) = model, rebuilt(model)
    roles = {"actuated": actuated, "closures": closures, "carriers": carriers, "couplings": couplings}
    data: dict[str, Any] = {
        "name": name or str(getattr(model, "name", "")) or "robot",
        "urdf": "model",
        **_roles(model, {**roles, "independent": independent}, at),
        "working_modes": working_modes,
        "characteristic_length": characteristic_length,
        "redundant_rows": redundant_rows,
        "reference": reference if isinstance(reference, Mapping) else {},
        "gravity": model.gravity.linear.tolist(),
    }
    start = pin.neutral(model)
    if not (reference is None or isinstance(reference, Mapping)):
        start = _in_order_of(model, given, at, checked(reference, "reference", (model.nq,)))
    is_of_pinocchio = any(hasattr(each, "joint1_placement") for each in closures)
    mechanism = Mechanism(data["name"], model, start, shapes=urdf)
    robot = build_robot(data, mechanism, drop_dependent=is_of_pinocchio, mode=working_mode, own_model=True)
    moved = () if at == sorted(at) else ("Joints are numbered depth first, as Pinocchio's mass matrix needs them.",)
    if note := too_few_motors(robot):
        warn_once(note)
    return replace(robot, urdf_folder=urdf_folder, notes=(*robot.notes, *moved, *_not_in_force(given)))


def _in_order_of(model: pin.Model, given: pin.Model, at: list[int], q: Array) -> Array:
    """Return a configuration (nq,) of a model in the order of the one that ``rebuilt`` made of it."""
    result = np.empty(model.nq)
    for index in range(1, given.njoints):
        result[span(model, at[index], "q")] = q[span(given, index, "q")]
    return result


def _roles(model: pin.Model, arguments: Mapping[str, Any], at: list[int]) -> dict[str, Any]:
    """Return the part of a declaration with the closures and the role of each joint.

    Frames that are named and are no links become links, as do points and what joints carry without a link (by the name
    of the joint, "universe" for the ground), and the frames of Pinocchio's constraint models are added to the model;
    ``at`` are its indices of the joints that they name.

    Raises:
        InputError: something of another form, numbers that no machine has, or a joint that depends on others.
    """
    _require_sound(model)
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if "Mimic" in joint.shortname():
            raise InputError(
                f"The joint {name!r} mimics another.", remedy="Build the model without (mimic=False).", joint=str(name)
            )
    loops, couplings, actuated, carriers = (
        _several(arguments[what], what) for what in ("closures", "couplings", "actuated", "carriers")
    )
    _name_links(model)
    loops = [_closure(model, each, number, at) for number, each in enumerate(loops)]
    roles = _independent(arguments["independent"])
    ends = (name for loop in loops for kind in ("frames", *ROWS) for name in loop.get(kind, ()))
    named = [roles.get("platform"), *ends]
    for frame in list(model.frames):
        if frame.type in (pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT) and frame.name in named:
            _make_link(model, frame)
    return {
        "closures": loops,
        "couplings": [_coupling(each, number) for number, each in enumerate(couplings)],
        "actuated": actuated,
        "carriers": [{"joint": each} if isinstance(each, str) else each for each in carriers],
        "independent": roles,
    }


def _require_sound(model: pin.Model) -> None:
    """Raise InputError for numbers that no machine has, which files are not allowed either."""
    for index, joint in enumerate(model.joints):
        name, inertia, place = str(model.names[index]), model.inertias[index], model.jointPlacements[index]
        if not np.isfinite(place.homogeneous).all():
            raise InputError(f"The joint {name!r} is not placed by finite numbers.", remedy="Correct it.", joint=name)
        off = "" if np.isfinite(inertia.lever).all() else "a centre of mass that is not finite"
        if what := off or negative_inertia(inertia.mass, inertia.inertia):
            raise InputError(f"What the joint {name!r} carries has {what}.", remedy="Correct it.", joint=name)
        if index == 0:
            continue
        armature = model.armature[joint.idx_v : joint.idx_v + joint.nv]
        if not (armature >= 0.0).all() or not np.isfinite(armature).all():
            raise InputError(
                f"The joint {name!r} has the armature {armature.tolist()}.", remedy="Correct it.", joint=name
            )
        for what, first, count in (("Position", joint.idx_q, joint.nq), ("Effort", joint.idx_v, joint.nv)):
            low, high = (getattr(model, f"{end}{what}Limit")[first : first + count] for end in ("lower", "upper"))
            if not (low <= high).all():
                raise InputError(
                    f"The joint {name!r} has the limits of {what.lower()} {low.tolist()} to {high.tolist()}.",
                    remedy="Correct them; infinite ones are none.",
                    joint=name,
                )
    if np.any(model.gravity.angular):
        raise InputError(
            f"The model's gravity has an angular part, {model.gravity.angular.tolist()}.", remedy="Set it to zero."
        )


def _not_in_force(model: pin.Model) -> tuple[str, ...]:
    """Return a note on damping and friction of the model, which Pinocchio's own algorithms leave out too."""
    said = []
    for what in ("damping", "friction"):
        values = np.array(getattr(model, what, np.zeros(model.nv)))
        joints = enumerate(model.joints)
        names = [str(model.names[k]) for k, at in joints if k and values[at.idx_v : at.idx_v + at.nv].any()]
        said += [f"{what} of {', '.join(names)}"] if names else []
    remedy = "robot.loaded(JointForces(...)) puts it in force."
    return (f"Not in force, though the model has it: {'; '.join(said)}. {remedy}",) if said else ()


def _coupling(given: Any, number: int) -> dict[str, Any]:
    if isinstance(given, Mapping):
        return dict(given)
    if isinstance(given, Coupling):
        return {**asdict(given), "polynomial": list(given.polynomial), "also": list(given.also)}
    if not isinstance(given, (tuple, list)) or len(given) != 3:
        remedy = "Pass a Coupling, (joint, of, polynomial), or a mapping with these."
        raise InputError(f"couplings[{number}] is {shown(given)}.", remedy=remedy)
    return {"joint": given[0], "of": given[1], "polynomial": list(_several(given[2], f"couplings[{number}]"))}


def _several(values: Any, what: str) -> list[Any]:
    if isinstance(values, (str, Mapping)) or not hasattr(values, "__iter__"):
        raise InputError(f"{what} is {shown(values)}.", remedy="Pass a list.")
    return list(values)


def _closure(model: pin.Model, given: Any, number: int, at: list[int]) -> dict[str, Any]:
    if isinstance(given, Mapping):
        return dict(given)
    if isinstance(given, Closure) and given.is_rod:
        return {"name": given.name, "rod": [given.frame_a, given.frame_b], "length": given.length or None}
    if isinstance(given, Closure):
        return {"name": given.name, "frames": [given.frame_a, given.frame_b], "axes": list(given.axes)}
    if isinstance(given, (tuple, list)) and len(given) == 3:
        return {"frames": [given[0], given[1]], "axes": given[2]}
    if not hasattr(given, "joint1_placement"):
        raise InputError(
            f"closures[{number}] is {shown(given)}.",
            remedy="Pass a Closure, (frame_a, frame_b, axes), a mapping with frames and axes, or a constraint model of "
            "Pinocchio between two placements.",
        )
    if "Contact" in type(given).__name__:
        raise InputError(
            f"closures[{number}] is a {type(given).__name__}, which can let go and slide.",
            remedy="Pass a PointAnchorConstraintModel where it does neither.",
        )
    rows = given.residualSize()
    if rows not in (3, 6):
        raise InputError(f"closures[{number}] has {rows} rows.", remedy="Pass points (3) or frames (6).")
    name, ends = str(given.name) or f"constraint_{number + 1}", []
    for side, joint, placement in (
        ("a", given.joint1_id, given.joint1_placement),
        ("b", given.joint2_id, given.joint2_placement),
    ):
        ends.append(f"{name}_{side}")
        model.addFrame(pin.Frame(ends[-1], at[joint], pin.SE3(placement), pin.FrameType.BODY))
    return {"name": name, "frames": ends, "axes": list(AXES[:rows])}


def _independent(given: Any) -> dict[str, Any]:
    if given is None:
        return {}
    if isinstance(given, Platform):
        return {"platform": given.frame, "axes": list(given.axes)}
    return dict(given) if isinstance(given, Mapping) else {"joints": list(_several(given, "independent"))}


def _name_links(model: pin.Model) -> None:
    """Let all that loads may act on be found as links: points of the model, and what a joint carries by its name."""
    bodies = {int(frame.parentJoint) for frame in model.frames if frame.type == pin.FrameType.BODY}
    for frame in list(model.frames):
        if frame.type in (pin.FrameType.OP_FRAME, pin.FrameType.SENSOR):
            _make_link(model, frame)
    for index, name in enumerate(model.names):
        if index not in bodies and not has_link(model, name):
            model.addFrame(pin.Frame(str(name), index, pin.SE3.Identity(), pin.FrameType.BODY))


def _make_link(model: pin.Model, frame: pin.Frame) -> None:
    """Let a frame of another type be found as a link."""
    if not has_link(model, frame.name):
        model.addFrame(pin.Frame(frame.name, frame.parentJoint, frame.placement, pin.FrameType.BODY))
