"""Read the ``robot.yaml`` of the collection example-parallel-robots: a URDF next to it, frames that coincide, motors.

Its keys: ``closed_loop``, pairs of frames, each named by a link or by the joint that carries it; ``type``, "6d" or "3d"
for each pair; ``name_mot``, the joints that are driven; ``joint_name`` and ``joint_type``, joints of the URDF that are
balls ("SPHERICAL"), universal joints ("UJOINT_XY": about x, then y, of the joint's frame) or fixed ("FIXED").
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from redundancy_pin.errors import DeclarationError, ModelFileError, did_you_mean
from redundancy_pin.io.schema import Schema, bad_value, validated
from redundancy_pin.io.yaml_file import parse_yaml
from redundancy_pin.robot.formats.mechanism import Mechanism
from redundancy_pin.robot.formats.urdf import Urdf, read_urdf, urdf_mechanism
from redundancy_pin.robot.formats.xml_files import read_model
from redundancy_pin.robot.loop_joints import LoopJoint

_OWN_KEY = re.compile(r"^(closed_loop|name_mot)[ \t]*:", re.MULTILINE)

_KINDS = {"SPHERICAL": "ball", "FIXED": "fixed"} | {
    f"UJOINT_{pair}": f"universal_{pair.lower()}" for pair in ("XY", "XZ", "YX", "YZ", "ZX", "ZY")
}

_Names = Annotated[tuple[str, ...], Field(description="a list of names")]
_Pair = Annotated[tuple[str, str], Field(description="two names of frames")]


class _File(Schema):
    closed_loop: Annotated[tuple[_Pair, ...], Field(description="a list of pairs of frames")] = ()
    type: Annotated[tuple[str, ...], Field(description="a list of 3d and 6d")] = ()
    name_mot: _Names = ()
    joint_name: _Names = ()
    joint_type: Annotated[tuple[Literal[tuple(_KINDS)], ...], Field(description=f"a list of {', '.join(_KINDS)}")] = ()  # type: ignore[valid-type]


def is_parallel_yaml(text: str) -> bool:
    """Return whether a text is such a file."""
    return bool(_OWN_KEY.search(text)) and not re.search(r"^urdf[ \t]*:", text, re.MULTILINE)


def read_parallel_yaml(path: Path, *, base: str = "fixed") -> Mechanism:
    """Read such a file, and the URDF in its folder.

    Args:
        path: the file.
        base: "fixed", or "free" to let the root link move.

    Raises:
        ModelFileError: no readable file; none or several URDFs next to it.
        DeclarationError: keys and names that are not known.
    """
    file = parse_yaml(read_model(path), str(path), ModelFileError)
    with file.naming():
        content = validated(_File, file.data if isinstance(file.data, dict) else {})
        source = _urdf_beside(path)
        urdf = read_model(source)
        tree = read_urdf(urdf, source)
        types = content.type or ("6d",) * len(content.closed_loop)
        for key, given, names in (
            ("type", types, content.closed_loop),
            ("joint_type", content.joint_type, content.joint_name),
        ):
            if len(given) != len(names):
                raise bad_value(key, list(given), f"a list of {len(names)}")
        closures = []
        for number, ((one, other), kind) in enumerate(zip(content.closed_loop, types, strict=True)):
            if kind.lower() not in ("3d", "6d"):
                raise bad_value(f"type[{number}]", kind, "3d or 6d")
            ends = (_link(tree, one), _link(tree, other))
            joint = "ball" if kind.lower() == "3d" else "weld"
            closures.append(LoopJoint(f"{one} = {other}", joint, ends))
        kinds = {name: _KINDS[kind] for name, kind in zip(content.joint_name, content.joint_type, strict=True)}
        unknown = [name for name in kinds if name not in {joint.name for joint in tree.joints}]
        for name in unknown:  # as the collection's own loader does, and said
            del kinds[name]
        notes = (f"Passed over, joint_name says what the URDF has not: {', '.join(unknown)}.",) if unknown else ()
        made = urdf_mechanism(tree, path.resolve().parent.name, kinds=kinds, base=base)
        return replace(
            made,
            loop_joints=(*made.loop_joints, *closures),
            actuated=content.name_mot,
            notes=(*notes, *made.notes),
        )


def _urdf_beside(path: Path) -> Path:
    folder = path.parent
    candidates = [folder / "robot.urdf"] if (folder / "robot.urdf").is_file() else sorted(folder.glob("*.urdf"))
    if len(candidates) != 1:
        raise ModelFileError(
            f"{path} names no URDF, and its folder holds {len(candidates) or 'none'}.",
            remedy="Put one beside it, and call it robot.urdf.",
            path=str(path),
        )
    return candidates[0]


def _link(tree: Urdf, name: str) -> str:
    """Return the link of a frame; a joint's frame is the frame of its child."""
    child = next((joint.child for joint in tree.joints if joint.name == name), None)
    if child is None and name not in tree.links:
        known = [*tree.links, *(joint.name for joint in tree.joints)]
        raise DeclarationError(f"The URDF has no frame {name!r}.", remedy=did_you_mean(name, known).strip(), name=name)
    return child or name
