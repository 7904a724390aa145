"""Read and check ``robot.yaml``: closures, actuated joints, carriers, independent coordinates."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import pinocchio as pin
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    RootModel,
    ValidationInfo,
    field_validator,
    model_validator,
)

from redundancy_pin.arrays import LARGEST, Array
from redundancy_pin.errors import DeclarationError, InputError, ModelFileError
from redundancy_pin.io.reading import read_text
from redundancy_pin.io.schema import Schema, bad_value, require_known_keys, validated
from redundancy_pin.io.yaml_file import LARGEST_FILE, YamlFile, parse_yaml
from redundancy_pin.robot.formats.expressions import FUNCTIONS, Evaluator
from redundancy_pin.robot.formats.urdf import KINDS
from redundancy_pin.robot.formats.xacro_file import Argument
from redundancy_pin.robot.formats.xml_files import format_of, remedy_of_format
from redundancy_pin.robot.loads import JointForces, Load, Payload, Spring, Wrench
from redundancy_pin.robot.loop_joints import LoopJoint, joint_between, placed
from redundancy_pin.robot.types import AXES, Closure, Coupling, Platform, WorkingModes

CLOSED_FORMS: Mapping[str, tuple[str, ...]] = {
    "2rpr": (
        *("base_distance", "track_offset", "carriers", "carrier_mass", "end_effector_mass"),
        *("cylinder_mass", "cylinder_length", "piston_mass", "piston_length"),
    ),
    "3rrr": (
        *("base_radius", "platform_radius", "proximal_length", "distal_length", "tail_length", "carriers"),
        *("carrier_mass", "proximal_mass", "distal_mass", "platform_mass", "platform_inertia"),
    ),
}
"""The closed forms there are, and the xacro arguments that each is written out in."""

CLOSED_FORM_ROLES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...], tuple[int, ...], tuple[str, ...]]] = {
    "2rpr": (("slide_1", "slide_2"), ("slide_1", "slide_2"), (1, 1), ("x", "y")),
    "3rrr": (("base_1", "base_2", "base_3"), ("elbow_1", "elbow_2", "elbow_3"), (-1, -1, -1), ("x", "y", "rz")),
}
"""Motors, joints of the modes and their signs, and independent axes of each; of others its numbers are not."""


def _number(value: object, info: ValidationInfo[Evaluator]) -> float:
    """Return a number, or what an expression in the xacro arguments gives."""
    if isinstance(value, str):
        try:
            value = info.context.eval(value)
        except Exception as error:  # an expression may raise anything
            raise ValueError(f"a number or an expression in the xacro arguments ({error})") from error
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) <= LARGEST:
        raise ValueError("a finite number")
    return float(value)


def _without_repetitions(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(set(names)) != len(names):
        raise ValueError("a list without repetitions")
    return names


def _track(ends: tuple[float, float]) -> tuple[float, float]:
    if not ends[0] < ends[1]:
        raise ValueError("[lower, upper] with lower < upper")
    return ends


def _switch(name: object, info: ValidationInfo[Evaluator]) -> bool:
    """Return the value of the xacro argument that switches an entry on and off."""
    value = info.context.names.get(name) if isinstance(name, str) else None
    if not isinstance(value, bool):
        raise ValueError("the name of a xacro argument that is true or false")
    return value


Number = Annotated[float, BeforeValidator(_number)]
Triple = Annotated[tuple[Number, Number, Number], Field(description="a list of 3 numbers")]
Limit = Annotated[Annotated[Number, Field(gt=0)] | None, Field(description="positive, or left out")]
Positive = Annotated[Annotated[Number, Field(ge=0)], Field(description="a number, not negative")]
Name = Annotated[str, Field(description="a name")]
Names = Annotated[
    tuple[str, ...], Field(min_length=1, description="a list of names, not empty"), AfterValidator(_without_repetitions)
]
Axes = Annotated[
    tuple[Literal["x", "y", "z", "rx", "ry", "rz"], ...],
    Field(min_length=1, description=f"a subset of {', '.join(AXES)}"),
    AfterValidator(_without_repetitions),
    AfterValidator(lambda axes: tuple(sorted(axes, key=AXES.index))),
]
Signs = Annotated[tuple[Literal[1, -1], ...], Field(description="a list of 1 and -1, one a leg", validate_default=True)]


_ORIGIN = (0.0, 0.0, 0.0)


Pair = Annotated[
    tuple[str, str], Field(description="the names of two different links"), AfterValidator(_without_repetitions)
]
Points = Annotated[tuple[Triple, Triple], Field(description="two lists of 3 numbers")]
Direction = Literal["x", "y", "z"] | Triple


class ClosureEntry(Schema):
    """What closes a loop: a joint between points of two links, or two frames and the axes along which they coincide.

    A joint is named by its kind: ``{hinge: [rod, rocker], at: [[0.2, 0, 0], [0.15, 0, 0]], axis: z}``. Its frame is at
    a point of each link, turned by ``rpy``; its axis is read in that frame, one for both or one in each. A rod has no
    mass and a ball at a point of each link: ``{rod: [crank, rocker], at: [[0.2, 0, 0], [0.15, 0, 0]], length: 0.3}``.
    """

    name: str | None = None
    frames: Pair | None = Field(None, description="two different frames")
    axes: Axes = ()
    hinge: Pair | None = None
    slider: Pair | None = None
    cylinder: Pair | None = None
    ball: Pair | None = None
    universal: Pair | None = None
    planar: Pair | None = None
    weld: Pair | None = None
    rod: Pair | None = None
    at: Points = (_ORIGIN, _ORIGIN)
    rpy: Points = (_ORIGIN, _ORIGIN)
    axis: Direction | tuple[Direction, Direction] | None = Field(
        None, description="x, y, z or a list of 3 numbers, or one of these for each link"
    )
    length: Limit = None

    @model_validator(mode="after")
    def _has_what_its_kind_takes(self) -> ClosureEntry:
        kinds = [kind for kind in _TAKES if getattr(self, kind)]
        if len(kinds) != 1:
            raise ValueError(f"a mapping with one of {', '.join(_TAKES)}")
        needed, more = _TAKES[kinds[0]]
        given = self.model_fields_set - {"name", *kinds}
        if not set(needed) <= given <= {*needed, *more}:
            left_out = f"; {', '.join(more)} may be left out" if more else ""
            raise ValueError(f"a mapping with {', '.join((*kinds, *needed, *more))}{left_out}")
        try:
            self.joint()
        except DeclarationError as error:
            raise ValueError(f"a joint: {error.message} {error.remedy}") from error
        return self

    @property
    def kind(self) -> str:
        """The kind of the joint, or "frames"."""
        return next(kind for kind in _TAKES if getattr(self, kind))

    def _directions(self) -> tuple[Array, Array]:
        """Return the axis of the joint in each of its frames."""
        axis = "z" if self.axis is None else self.axis
        pair = axis if isinstance(axis, tuple) and len(axis) == 2 else (axis, axis)
        one, other = (np.eye(3)["xyz".index(each)] if isinstance(each, str) else np.array(each) for each in pair)
        return one, other

    def default_name(self) -> str:
        """Return the name of a closure that is not named: its kind and its links, or its frames."""
        ends = " = ".join(getattr(self, self.kind))
        return ends if self.kind == "frames" else f"{self.kind} {ends}"

    def joint(self) -> LoopJoint | None:
        """Return the joint; None where frames and axes are given."""
        if self.kind == "frames":
            return None
        links = getattr(self, self.kind)
        places = [placed(pin.rpy.rpyToMatrix(*rpy), at) for at, rpy in zip(self.at, self.rpy, strict=True)]
        name = self.name or self.default_name()
        return joint_between(name, self.kind, links, places, self._directions(), self.length or 0.0)

    def closure(self) -> Closure:
        """Return the closure, with a name."""
        if joint := self.joint():
            return joint.closure()
        one, other = self.frames or ("", "")
        return Closure(self.name or self.default_name(), one, other, self.axes)


def _each_with_a_name(closures: tuple[ClosureEntry, ...]) -> tuple[ClosureEntry, ...]:
    """Return closures with names: those between the same two links, such as rods of a parallelogram, are numbered."""
    names, numbered = [each.name or each.default_name() for each in closures], list[ClosureEntry]()
    for place, (each, name) in enumerate(zip(closures, names, strict=True)):
        is_named = each.name is not None or names.count(name) == 1
        number = names[: place + 1].count(name)
        numbered.append(each if is_named else each.model_copy(update={"name": f"{name} {number}"}))
    return tuple(numbered)


_TAKES: Mapping[str, tuple[tuple[str, ...], tuple[str, ...]]] = {
    "frames": (("axes",), ()),
    "hinge": ((), ("at", "axis", "rpy")),
    "slider": ((), ("at", "axis", "rpy")),
    "cylinder": ((), ("at", "axis", "rpy")),
    "ball": ((), ("at",)),
    "universal": (("axis",), ("at", "rpy")),
    "planar": ((), ("at", "axis", "rpy")),
    "weld": ((), ("at", "rpy")),
    "rod": ((), ("at", "length")),
}
"""Keys beside a kind: those that it needs, and those that may be left out."""


class CouplingEntry(Schema):
    """A coupling of two joints; see ``types.Coupling``."""

    name: str | None = None
    joint: str = Field(description="the name of a joint")
    of: str = Field("", description="the name of the joint that it follows, or left out where it is held")
    polynomial: Annotated[tuple[Number, ...], Field(min_length=1, max_length=9)] = Field(
        description="a list of 1 to 9 numbers, the constant first"
    )
    also: Annotated[tuple[tuple[str, Number], ...], Field(description="a list of pairs, a joint and a factor")] = ()

    @field_validator("polynomial")
    @classmethod
    def _one_number_if_fixed(cls, polynomial: tuple[float, ...], info: ValidationInfo) -> tuple[float, ...]:
        if len(polynomial) > 1 and not info.data.get("of", "?"):
            raise ValueError("one number, where the joint is held; `of` names a joint to follow")
        return polynomial


class CarrierEntry(Schema):
    """A carrier; None where the URDF or infinity decides."""

    joint: str = Field(description="the name of a joint")
    position: Annotated[tuple[Number, Number], AfterValidator(_track)] | None = None
    speed: Limit = None
    acceleration: Limit = None
    force: Limit = None
    when: Annotated[bool, BeforeValidator(_switch)] = True


class JointForcesEntry(Schema):
    """What acts in a joint; see ``loads.JointForces``."""

    joint: str = Field(description="the name of a joint")
    damping: Positive = 0.0
    friction: Positive = 0.0
    friction_speed: Limit = None
    stiffness: Positive = 0.0
    rest: Number = 0.0
    rotor_inertia: Positive = 0.0
    gear: Number = 1.0

    def load(self) -> JointForces:
        """Return it as a load."""
        given = {name: value for name, value in dict(self).items() if value is not None}
        return JointForces(**given)


class SpringEntry(Schema):
    """A spring between two links; see ``loads.Spring``."""

    frames: Annotated[Names, Field(min_length=2, max_length=2, description="two different frames")]
    stiffness: Positive = 0.0
    damping: Positive = 0.0
    length: Positive = 0.0
    points: Annotated[tuple[Triple, Triple], Field(description="two points, each a list of 3 numbers")] = (_ORIGIN,) * 2

    def load(self) -> Spring:
        """Return it as a load."""
        return Spring(self.frames[0], self.frames[1], self.stiffness, self.damping, self.length, *self.points)


class PayloadEntry(Schema):
    """A mass that a link carries; see ``loads.Payload``."""

    frame: str = Field(description="the name of a frame (a URDF link)")
    mass: Positive
    centre: Triple = _ORIGIN
    inertia: Annotated[Triple, Field(description="a list of 3 moments of inertia about its axes")] = _ORIGIN

    def load(self) -> Payload:
        """Return it as a load."""
        return Payload(self.frame, self.mass, self.centre, np.diag(self.inertia))


class WrenchEntry(Schema):
    """A constant wrench on a link; see ``loads.Wrench``."""

    frame: str = Field(description="the name of a frame (a URDF link)")
    force: Triple = _ORIGIN
    moment: Triple = _ORIGIN
    reference: Literal["world", "local"] = "world"
    point: Triple = _ORIGIN

    def load(self) -> Wrench:
        """Return it as a load."""
        return Wrench(self.frame, (*self.force, *self.moment), self.reference, self.point)


class Independent(Schema):
    """The independent coordinates: part of the platform's pose, or joints."""

    joints: Names = ()
    platform: str | None = Field(None, description="the name of a frame (a URDF link)", validate_default=True)
    axes: Axes = ()

    @field_validator("platform")
    @classmethod
    def _one_of_two(cls, platform: str | None, info: ValidationInfo) -> str | None:
        if bool(platform) == bool(info.data.get("joints")):
            raise ValueError("the name of a frame (a URDF link), given with `axes`: either `joints`, or `platform`")
        return platform


class WorkingModesEntry(Schema):
    """Working modes: the indicator joint of each leg; signs and the default mode are +1 where they are left out."""

    joints: Names
    signs: Signs = ()
    default: Signs = ()

    @field_validator("signs", "default")
    @classmethod
    def _one_a_leg(cls, signs: tuple[int, ...], info: ValidationInfo) -> tuple[int, ...]:
        legs = len(info.data.get("joints", signs))
        if signs and len(signs) != legs:
            raise ValueError(f"a list of {legs}, one sign a leg")
        return signs or (1,) * legs


class _Pose(Schema):
    xyz: Triple
    rpy: Triple = (0.0, 0.0, 0.0)


class _Coordinates(RootModel[tuple[Number, ...]]):
    root: tuple[Number, ...] = Field(description="a list of a number for each axis of the platform")


class _Positions(RootModel[dict[str, Number]]):
    root: dict[str, Number] = Field(description="a mapping of joint names to positions")


class Reference(Schema):
    """The reference configuration; the form of its coordinates follows from the independent ones."""

    platform: Any = None
    joints: Any = None
    guess: dict[str, Number] = Field({}, description="a mapping of joint names to positions")


class Declaration(Schema):
    """A checked declaration. Names of joints and frames are checked later, against the URDF."""

    name: str | int | float | None = None
    description: Any = None
    urdf: Name
    requires: tuple[str, ...] = ()
    closed_form: Literal["2rpr", "3rrr"] | None = Field(None, description="one of 2rpr, 3rrr, or left out")
    gravity: Triple = (0.0, 0.0, 0.0)
    joint_types: dict[str, Literal[KINDS]] = Field(  # type: ignore[valid-type]
        {}, description=f"a mapping of joints of the URDF to {', '.join(KINDS)}"
    )
    closures: Annotated[
        tuple[ClosureEntry, ...], Field(description="a list of mappings"), AfterValidator(_each_with_a_name)
    ] = ()
    redundant_rows: bool = Field(False, description="true or false")
    couplings: Annotated[tuple[CouplingEntry, ...], Field(description="a list of mappings")] = ()
    actuated: Names
    carriers: Annotated[tuple[CarrierEntry, ...], Field(description="a list of mappings")] = ()
    independent: Independent
    working_modes: WorkingModesEntry | None = None
    reference: Reference
    characteristic_length: Limit = Field(None, description="a positive length in metres")
    urdf_dynamics: bool = Field(True, description="true or false")
    joint_forces: Annotated[tuple[JointForcesEntry, ...], Field(description="a list of mappings")] = ()
    springs: Annotated[tuple[SpringEntry, ...], Field(description="a list of mappings")] = ()
    payloads: Annotated[tuple[PayloadEntry, ...], Field(description="a list of mappings")] = ()
    wrenches: Annotated[tuple[WrenchEntry, ...], Field(description="a list of mappings")] = ()

    @property
    def loads(self) -> tuple[Load, ...]:
        """The declared loads, without the loads of the URDF."""
        entries: tuple[JointForcesEntry | SpringEntry | PayloadEntry | WrenchEntry, ...]
        entries = (*self.joint_forces, *self.springs, *self.payloads, *self.wrenches)
        return tuple(entry.load() for entry in entries)

    @property
    def loops(self) -> tuple[Closure, ...]:
        """The closures, each with a name."""
        return tuple(entry.closure() for entry in self.closures)

    @property
    def loop_joints(self) -> tuple[LoopJoint, ...]:
        """The closures that are joints, whose frames a model has to get (``loop_joints.add_frames``)."""
        return tuple(joint for entry in self.closures if (joint := entry.joint()))

    @property
    def coupled(self) -> tuple[Coupling, ...]:
        """The couplings, each with a name."""
        return tuple(
            Coupling(c.name or " of ".join(filter(None, (c.joint, c.of))), c.joint, c.of, c.polynomial, c.also)
            for c in self.couplings
        )

    @property
    def platform(self) -> Platform | None:
        """The platform, or None where joints are independent."""
        return Platform(self.independent.platform, self.independent.axes) if self.independent.platform else None

    @property
    def modes(self) -> WorkingModes | None:
        """How to read working modes."""
        return WorkingModes(self.working_modes.joints, self.working_modes.signs) if self.working_modes else None

    def coordinates(self, parameters: Mapping[str, Argument]) -> tuple[float, ...]:
        """Return the reference: platform coordinates, (xyz, rpy) run together for a pose, or joint positions.

        Raises:
            DeclarationError: naming the key, the value and what is allowed.
        """
        given, context, joints = self.reference, _evaluator(parameters), self.independent.joints
        if self.platform is None:
            positions = validated(_Positions, given.joints, key="reference.joints", context=context).root
            require_known_keys(positions, joints, "reference.joints")
            if len(positions) < len(joints):
                raise bad_value("reference.joints", given.joints, f"a value for each of {', '.join(joints)}")
            return tuple(positions[name] for name in joints)
        if self.platform.is_pose:
            pose = validated(_Pose, given.platform, key="reference.platform", context=context)
            _require_radians(pose.rpy, "reference.platform.rpy", given.platform)
            return (*pose.xyz, *pose.rpy)
        place = validated(_Coordinates, given.platform, key="reference.platform", context=context).root
        if len(place) != len(self.platform.axes):
            raise bad_value("reference.platform", given.platform, f"a list of {len(self.platform.axes)}")
        turned = [value for value, axis in zip(place, self.platform.axes, strict=True) if axis.startswith("r")]
        _require_radians(turned, "reference.platform", given.platform)
        return place


def _require_radians(angles: Sequence[float], key: str, given: object) -> None:
    """Check that no angle is beyond a turn: it would be one in degrees."""
    if any(abs(angle) > 2.0 * math.pi for angle in angles):
        raise bad_value(key, given, "angles in radians, within a turn (degrees?)")


UNDECIDED = "undecided"
"""Key of what `redundancy-pin new` could not know: a declaration that has it is refused, with the questions."""


def read_declaration(path: Path) -> YamlFile:
    """Read the mapping at the top of a declaration.

    Raises:
        ModelFileError: unreadable file or broken YAML.
        DeclarationError: not a mapping, an unknown key, or no ``urdf``.
    """
    text = read_text(path, ModelFileError, largest=LARGEST_FILE)
    if other := format_of(text):  # before YAML chokes on it
        message, remedy = f"{path} is {other}, not a declaration.", remedy_of_format(other)
        raise DeclarationError(message, remedy=remedy, format=other)
    file = parse_yaml(text, str(path), ModelFileError)
    data = file.data
    known = [*Declaration.model_fields, UNDECIDED]
    if not isinstance(data, dict):
        raise DeclarationError(f"{path} holds no mapping of keys.", remedy=f"Its keys: {', '.join(known)}.")
    with file.naming():
        require_known_keys(data, known, "")
        if questions := data.pop(UNDECIDED, None):
            asked = questions if isinstance(questions, list) else [questions]
            remedy = f"Decide it in the file, then delete the key `{UNDECIDED}`."
            raise DeclarationError(" ".join(map(str, asked)), remedy=remedy, key=UNDECIDED)
        if not isinstance(data.get("urdf"), str):
            raise DeclarationError(
                "The declaration names no `urdf`.",
                remedy="Add `urdf: file.urdf.xacro`, relative to the file.",
                key="urdf",
            )
    return file


def require_conditions(data: Mapping[str, Any], parameters: Mapping[str, Argument]) -> None:
    """Check the conditions under ``requires``, such as ``base_radius > 0``, on the xacro arguments.

    Raises:
        DeclarationError: a condition is not one.
        InputError: a condition does not hold; carries it and the arguments it names.
    """
    conditions = data.get("requires", [])
    if not isinstance(conditions, list):
        raise bad_value("requires", conditions, "a list")
    evaluator = _evaluator(parameters)  # one for all, as its work is bounded
    for condition in map(str, conditions):
        try:
            holds = evaluator.eval(condition)
        except Exception as error:  # a condition may raise anything
            raise bad_value("requires", condition, f"a condition on the xacro arguments ({error})") from error
        if not isinstance(holds, bool):
            raise bad_value("requires", condition, "a condition, such as `length > 0`")
        if not holds:
            given = {name: value for name, value in parameters.items() if name in condition.split()}
            values = ", ".join(f"{name} = {value}" for name, value in given.items())
            raise InputError(
                f"The arguments do not make a machine: {condition} does not hold ({values}).",
                remedy="Change them so that it does.",
                condition=condition,
                **given,
            )


def parse(data: Mapping[str, Any], parameters: Mapping[str, Argument]) -> Declaration:
    """Check the mapping against the schema, with the expressions in it evaluated.

    Args:
        data: from ``read_declaration``.
        parameters: the xacro arguments, which expressions may use.

    Raises:
        DeclarationError: naming the key, the value and what is allowed.
    """
    return validated(Declaration, data, context=_evaluator(parameters))


def _evaluator(parameters: Mapping[str, Argument]) -> Evaluator:
    return Evaluator({**FUNCTIONS, **parameters})
