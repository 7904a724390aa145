"""A declaration from what Python has: closures as objects of several kinds, frames of any type, lists of names."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pinocchio as pin

from redundancy_pin.errors import InputError, shown
from redundancy_pin.robot.types import AXES, Closure, Coupling, Platform


def declared(model: pin.Model, said: Mapping[str, Any]) -> dict[str, Any]:
    """Return the part of a declaration that says what closes the loops and which role each joint has.

    Frames that are named and are no links become links, and the frames of Pinocchio's constraint models are added to
    the model.

    Raises:
        InputError: something of another form, or a joint that depends on others.
    """
    if not isinstance(model, pin.Model):
        raise InputError(f"The model is {shown(model)}.", remedy="Pass a pinocchio.Model (pin.buildModelFromUrdf).")
    for name, joint in zip(list(model.names)[1:], list(model.joints)[1:], strict=True):
        if "Mimic" in joint.shortname():
            raise InputError(
                f"The joint {name!r} mimics another.", remedy="Build the model without (mimic=False).", joint=str(name)
            )
    loops, couplings, actuated, carriers = (
        _several(said[what], what) for what in ("closures", "couplings", "actuated", "carriers")
    )
    loops = [_closure(model, each, number) for number, each in enumerate(loops)]
    roles = _independent(said["independent"])
    for frame in (*(name for loop in loops for name in loop["frames"]), roles.get("platform")):
        _make_link(model, frame)
    return {
        "closures": loops,
        "couplings": [_coupling(each, number) for number, each in enumerate(couplings)],
        "actuated": actuated,
        "carriers": [{"joint": each} if isinstance(each, str) else each for each in carriers],
        "independent": roles,
    }


def _coupling(given: Any, number: int) -> dict[str, Any]:
    if isinstance(given, Mapping):
        return dict(given)
    if isinstance(given, Coupling):
        return {"name": given.name, "joint": given.joint, "of": given.of, "polynomial": list(given.polynomial)}
    if not isinstance(given, (tuple, list)) or len(given) != 3:
        remedy = "Pass a Coupling, (joint, of, polynomial), or a mapping with these."
        raise InputError(f"couplings[{number}] is {shown(given)}.", remedy=remedy)
    return {"joint": given[0], "of": given[1], "polynomial": list(_several(given[2], f"couplings[{number}]"))}


def _several(values: Any, what: str) -> list[Any]:
    if isinstance(values, (str, Mapping)) or not hasattr(values, "__iter__"):
        raise InputError(f"{what} is {shown(values)}.", remedy="Pass a list.")
    return list(values)


def _closure(model: pin.Model, given: Any, number: int) -> dict[str, Any]:
    if isinstance(given, Mapping):
        return dict(given)
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
    rows = given.residualSize()
    if rows not in (3, 6):
        raise InputError(f"closures[{number}] has {rows} rows.", remedy="Pass points (3) or frames (6).")
    name, ends = str(given.name) or f"constraint_{number + 1}", []
    for side, joint, placement in (
        ("a", given.joint1_id, given.joint1_placement),
        ("b", given.joint2_id, given.joint2_placement),
    ):
        ends.append(f"{name}_{side}")
        model.addFrame(pin.Frame(ends[-1], joint, pin.SE3(placement), pin.FrameType.BODY))
    return {"name": name, "frames": ends, "axes": list(AXES[:rows])}


def _independent(given: Any) -> dict[str, Any]:
    if given is None:
        return {}
    if isinstance(given, Platform):
        return {"platform": given.frame, "axes": list(given.axes)}
    return dict(given) if isinstance(given, Mapping) else {"joints": list(_several(given, "independent"))}


def _make_link(model: pin.Model, name: Any) -> None:
    """Let a frame of another type be found as a link; nothing where there is none, which is said later."""
    if not isinstance(name, str) or model.existFrame(name, pin.FrameType.BODY) or not model.existFrame(name):
        return
    frame = model.frames[model.getFrameId(name)]
    model.addFrame(pin.Frame(name, frame.parentJoint, frame.placement, pin.FrameType.BODY))
