"""Read and check ``robot.yaml``: what closes the loops, what is driven, what is carried, what is independent."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import simpleeval
import yaml

from redundancy_pin.errors import DeclarationError, InputError, ModelFileError
from redundancy_pin.robot.types import AXES, Closure, Platform, WorkingModes
from redundancy_pin.robot.urdf import Argument

_KEYS = (
    "name",
    "description",
    "urdf",
    "requires",
    "closed_form",
    "gravity",
    "closures",
    "actuated",
    "carriers",
    "independent",
    "working_modes",
    "reference",
    "characteristic_length",
)
_LARGEST = 1e300
_CLOSED_FORMS = ("2rpr", "3rrr")
_FUNCTIONS = {"sqrt": math.sqrt, "sin": math.sin, "cos": math.cos, "tan": math.tan, "atan2": math.atan2}


@dataclass(frozen=True)
class CarrierEntry:
    """A carrier as declared; None where the URDF or infinity decides."""

    joint: str
    position: tuple[float, float] | None
    speed: float | None
    acceleration: float | None
    force: float | None


@dataclass(frozen=True)
class Declaration:
    """A checked declaration. Names of joints and frames are checked later, against the URDF.

    Attributes:
        path: the file it came from.
        reference: platform coordinates, or ``(xyz, rpy)`` run together for a pose, or joint positions of the
            independent joints, in their order.
        guess: joint positions to start the assembly of the reference configuration from, by joint name.
    """

    path: Path
    name: str
    closed_form: str | None
    gravity: tuple[float, float, float]
    closures: tuple[Closure, ...]
    actuated: tuple[str, ...]
    carriers: tuple[CarrierEntry, ...]
    platform: Platform | None
    independent_joints: tuple[str, ...]
    working_modes: WorkingModes | None
    default_mode: tuple[int, ...]
    reference: tuple[float, ...]
    guess: Mapping[str, float] = field(default_factory=dict)
    characteristic_length: float | None = None


def read_yaml(path: Path) -> dict[str, Any]:
    """Read the mapping at the top of a declaration.

    Raises:
        ModelFileError: unreadable file or broken YAML.
        DeclarationError: not a mapping, an unknown key, or no ``urdf``.
    """
    try:
        data = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ModelFileError(
            f"{path} is not readable YAML: {error}.", remedy="Repair the file.", path=str(path)
        ) from error
    if isinstance(data, str) and data.lstrip().startswith("<"):
        raise DeclarationError(
            f"{path} is a URDF, not a declaration.", remedy="Pass the robot.yaml that names it under `urdf`."
        )
    if not isinstance(data, dict):
        raise DeclarationError(f"{path} holds no mapping of keys.", remedy=f"Its keys: {', '.join(_KEYS)}.")
    _allow_keys(data, _KEYS, "")
    if not isinstance(data.get("urdf"), str):
        raise DeclarationError(f"{path} names no `urdf`.", remedy="Add `urdf: file.urdf.xacro`, relative to the file.")
    return data


def require_conditions(data: Mapping[str, Any], parameters: Mapping[str, Argument]) -> None:
    """Check the conditions under ``requires``, such as ``base_radius > 0``, on the xacro arguments.

    Raises:
        DeclarationError: a condition is not one.
        InputError: a condition does not hold; carries it and the arguments it names.
    """
    evaluator = simpleeval.SimpleEval(functions=dict(_FUNCTIONS), names={"pi": math.pi, **parameters})
    for condition in _sequence(data.get("requires", []), "requires"):
        try:
            holds = evaluator.eval(str(condition))
        except Exception as error:  # a condition may raise anything
            raise _bad("requires", condition, f"a condition on the xacro arguments ({error})") from error
        if not isinstance(holds, bool):
            raise _bad("requires", condition, "a condition, such as `length > 0`")
        if not holds:
            given = {name: value for name, value in parameters.items() if name in str(condition).split()}
            values = ", ".join(f"{name} = {value}" for name, value in given.items())
            raise InputError(
                f"The arguments do not make a machine: {condition} does not hold ({values}).",
                remedy="Change them so that it does.",
                condition=str(condition),
                **given,
            )


def parse(path: Path, data: Mapping[str, Any], parameters: Mapping[str, Argument]) -> Declaration:
    """Turn the raw mapping into a declaration, with the expressions in it evaluated.

    Args:
        path: where it came from, for messages.
        data: from ``read_yaml``.
        parameters: the xacro arguments, which expressions may use.

    Raises:
        DeclarationError: naming the key, the value and what is allowed.
    """
    number = _Numbers(parameters)
    closed_form = data.get("closed_form")
    if closed_form is not None and closed_form not in _CLOSED_FORMS:
        raise _bad("closed_form", closed_form, f"one of {', '.join(_CLOSED_FORMS)}, or left out")
    platform, independent_joints = _independent(data.get("independent"))
    modes, default_mode = _working_modes(data.get("working_modes"))
    gravity = _sequence(data.get("gravity", [0, 0, 0]), "gravity", length=3)
    reference, guess = _reference(data.get("reference"), number, platform, independent_joints)
    length = data.get("characteristic_length")
    length = None if length is None else number(length, "characteristic_length")
    if length is not None and not length > 0:
        raise _bad("characteristic_length", length, "a positive length in metres")
    return Declaration(
        path=path,
        name=str(data.get("name", path.parent.name)),
        closed_form=closed_form,
        gravity=tuple(number(g, "gravity") for g in gravity),  # type: ignore[arg-type]
        closures=_closures(data.get("closures", [])),
        actuated=_names(data.get("actuated"), "actuated"),
        carriers=_carriers(data.get("carriers", []), number, parameters),
        platform=platform,
        independent_joints=independent_joints,
        working_modes=modes,
        default_mode=default_mode,
        reference=reference,
        guess=guess,
        characteristic_length=length,
    )


class _Numbers:
    """Numbers of a declaration: plain, or expressions in the xacro arguments."""

    def __init__(self, parameters: Mapping[str, Argument]) -> None:
        self._evaluator = simpleeval.SimpleEval(functions=dict(_FUNCTIONS), names={"pi": math.pi, **parameters})

    def __call__(self, value: object, key: str) -> float:
        if isinstance(value, str):
            try:
                value = self._evaluator.eval(value)
            except Exception as error:  # an expression may raise anything
                raise _bad(key, value, f"a number or an expression in the xacro arguments ({error})") from error
        if isinstance(value, bool) or not isinstance(value, (int, float)) or not abs(value) < _LARGEST:
            raise _bad(key, value, "a finite number")
        return float(value)


def _bad(key: str, value: object, allowed: str) -> DeclarationError:
    return DeclarationError(
        f"The declaration's `{key}` is {value!r}.", remedy=f"It must be {allowed}.", key=key, value=value
    )


def _allow_keys(mapping: Mapping[Any, Any], allowed: Sequence[str], where: str) -> None:
    for key in mapping:
        if key not in allowed:
            close = difflib.get_close_matches(str(key), allowed, n=1)
            hint = f"Did you mean `{close[0]}`? " if close else ""
            place = f" in `{where}`" if where else ""
            raise DeclarationError(
                f"Unknown key `{key}`{place}.", remedy=f"{hint}Allowed: {', '.join(allowed)}.", key=str(key)
            )


def _mapping(value: object, key: str, allowed: Sequence[str]) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise _bad(key, value, f"a mapping with the keys {', '.join(allowed)}")
    _allow_keys(value, allowed, key)
    return value


def _sequence(value: object, key: str, length: int | None = None) -> list[Any]:
    if not isinstance(value, list) or (length is not None and len(value) != length):
        raise _bad(key, value, "a list" if length is None else f"a list of {length}")
    return value


def _names(value: object, key: str) -> tuple[str, ...]:
    names = _sequence(value, key)
    if not names or not all(isinstance(name, str) for name in names):
        raise _bad(key, value, "a list of names, not empty")
    if len(set(names)) != len(names):
        raise _bad(key, value, "a list without repetitions")
    return tuple(names)


def _axes(value: object, key: str) -> tuple[str, ...]:
    axes = _names(value, key)
    if not set(axes) <= set(AXES):
        raise _bad(key, value, f"a subset of {', '.join(AXES)}")
    return tuple(sorted(axes, key=AXES.index))


def _closures(value: object) -> tuple[Closure, ...]:
    closures = []
    for index, entry in enumerate(_sequence(value, "closures")):
        key = f"closures[{index}]"
        mapping = _mapping(entry, key, ("name", "frames", "axes"))
        frames = _names(mapping.get("frames"), f"{key}.frames")
        if len(frames) != 2:
            raise _bad(f"{key}.frames", list(frames), "two different frames")
        name = str(mapping.get("name", f"{frames[0]} = {frames[1]}"))
        closures.append(Closure(name, frames[0], frames[1], _axes(mapping.get("axes"), f"{key}.axes")))
    return tuple(closures)


def _carriers(value: object, number: _Numbers, parameters: Mapping[str, Argument]) -> tuple[CarrierEntry, ...]:
    carriers = []
    for index, entry in enumerate(_sequence(value, "carriers")):
        key = f"carriers[{index}]"
        mapping = _mapping(entry, key, ("joint", "position", "speed", "acceleration", "force", "when"))
        switch = mapping.get("when")
        if switch is not None:
            if not isinstance(parameters.get(str(switch)), bool):
                raise _bad(f"{key}.when", switch, "the name of a xacro argument that is true or false")
            if not parameters[str(switch)]:
                continue
        position = mapping.get("position")
        limits: dict[str, float | None] = {}
        for name in ("speed", "acceleration", "force"):
            limit = None if mapping.get(name) is None else number(mapping[name], f"{key}.{name}")
            if limit is not None and not limit > 0:
                raise _bad(f"{key}.{name}", limit, "positive, or left out")
            limits[name] = limit
        ends = None
        if position is not None:
            low, high = (number(end, f"{key}.position") for end in _sequence(position, f"{key}.position", length=2))
            if not low < high:
                raise _bad(f"{key}.position", position, "[lower, upper] with lower < upper")
            ends = (low, high)
        joint = mapping.get("joint")
        if not isinstance(joint, str):
            raise _bad(f"{key}.joint", joint, "the name of a joint")
        carriers.append(CarrierEntry(joint, ends, limits["speed"], limits["acceleration"], limits["force"]))
    return tuple(carriers)


def _independent(value: object) -> tuple[Platform | None, tuple[str, ...]]:
    mapping = _mapping(value, "independent", ("platform", "axes", "joints"))
    if "joints" in mapping:
        if len(mapping) != 1:
            raise _bad("independent", dict(mapping), "either `joints`, or `platform` with `axes`")
        return None, _names(mapping["joints"], "independent.joints")
    if not isinstance(mapping.get("platform"), str):
        raise _bad("independent.platform", mapping.get("platform"), "the name of a frame (a URDF link)")
    axes = _axes(mapping.get("axes"), "independent.axes")
    if sum(axis.startswith("r") for axis in axes) == 2:
        raise _bad("independent.axes", list(axes), "translations with no rotation, one rotation, or all three")
    return Platform(mapping["platform"], axes), ()


def _working_modes(value: object) -> tuple[WorkingModes | None, tuple[int, ...]]:
    if value is None:
        return None, ()
    mapping = _mapping(value, "working_modes", ("joints", "signs", "default"))
    joints = _names(mapping.get("joints"), "working_modes.joints")
    signs = {}
    for key in ("signs", "default"):
        given = _sequence(mapping.get(key, [1] * len(joints)), f"working_modes.{key}", length=len(joints))
        if not all(sign in (1, -1) for sign in given):
            raise _bad(f"working_modes.{key}", given, "a list of 1 and -1, one a leg")
        signs[key] = tuple(int(sign) for sign in given)
    return WorkingModes(joints, signs["signs"]), signs["default"]


def _reference(
    value: object, number: _Numbers, platform: Platform | None, joints: tuple[str, ...]
) -> tuple[tuple[float, ...], dict[str, float]]:
    mapping = _mapping(value, "reference", ("platform", "joints", "guess"))
    guess = {
        str(name): number(angle, f"reference.guess.{name}")
        for name, angle in _mapping_of_any(mapping.get("guess", {}), "reference.guess").items()
    }
    if platform is None:
        given = _mapping(mapping.get("joints"), "reference.joints", joints)
        missing = [name for name in joints if name not in given]
        if missing:
            raise _bad("reference.joints", dict(given), f"a value for each of {', '.join(joints)}")
        return tuple(number(given[name], f"reference.joints.{name}") for name in joints), guess
    if platform.is_pose:
        pose = _mapping(mapping.get("platform"), "reference.platform", ("xyz", "rpy"))
        entries = [*_sequence(pose.get("xyz"), "reference.platform.xyz", 3)]
        entries += _sequence(pose.get("rpy", [0, 0, 0]), "reference.platform.rpy", 3)
    else:
        entries = _sequence(mapping.get("platform"), "reference.platform", len(platform.axes))
    return tuple(number(entry, "reference.platform") for entry in entries), guess


def _mapping_of_any(value: object, key: str) -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise _bad(key, value, "a mapping of joint names to positions")
    return value
