"""Which robot a plan is for, in plain data, and how to load that robot again."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import astuple, dataclass, field, fields, replace
from functools import cached_property
from math import inf, isnan
from pathlib import Path
from typing import Annotated, Any, get_type_hints

import numpy as np
from numpy.typing import ArrayLike
from pydantic import AfterValidator, ConfigDict, Field, create_model

from redundancy_pin.arrays import Frozen, assign
from redundancy_pin.errors import DeclarationError, InputError, ModelFileError, PlanFileError, RedundancyPinError, shown
from redundancy_pin.io.schema import Schema, validated
from redundancy_pin.loading import RobotLike, as_robot, load_with
from redundancy_pin.planners.limits import QUANTITIES
from redundancy_pin.robot import CarrierLimits, Coupling, Robot
from redundancy_pin.robot.declaration import read_declaration
from redundancy_pin.robot.formats.xacro_file import known_values
from redundancy_pin.robot.joint_ranges import joint_ranges
from redundancy_pin.robot.model_files import is_model_file
from redundancy_pin.robot.scales import effort_unit, is_revolute
from redundancy_pin.robot.shipped import declaration_path, shipped_sources

_SAME_NUMBERS = 1e-9
"""Relative deviation that arithmetic may show between two machines. It is rounding, also in the last step of Newton's
method: 1e-11, to which loops count as closed, at a margin of 1e-2."""

_SAME_REFERENCE = 1e-6
"""Deviation, m or rad, of the reference configuration of a robot that is loaded again for a plan."""


def _require_numbers(limits: tuple[CarrierLimits, ...]) -> tuple[CarrierLimits, ...]:
    if any(isnan(value) for limit in limits for value in astuple(limit)):
        raise ValueError("numbers, infinite for no limit")
    return limits


def _require_signs(mode: tuple[int, ...]) -> tuple[int, ...]:
    if not set(mode) <= {1, -1}:
        raise ValueError("1 or -1 for each leg")
    return mode


def _require_finite(couplings: tuple[Coupling, ...]) -> tuple[Coupling, ...]:
    for each in couplings:
        if not each.polynomial or not np.isfinite([*each.polynomial, *(factor for _, factor in each.also)]).all():
            raise ValueError("couplings with at least one coefficient, all of them finite")
    return couplings


_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Floats = Annotated[tuple[_Finite, ...], Field(description="finite numbers")]
_Names = Annotated[tuple[str, ...], Field(description="names")]
_Number = Annotated[float, Field(ge=-inf)]
"""Infinite maybe, but a number: NaN is not even that much."""


@dataclass(frozen=True, repr=False)
class RobotRecord(Frozen):
    """What is needed to load the plan's robot again, and to notice that it has changed.

    Attributes:
        name: its name.
        source: name of a shipped robot or absolute path of its declaration; in a file, the path relative to the folder
            of the file if inside it; empty for a robot that was not loaded.
        arguments: its xacro arguments.
        gravity: (3,) m/s².
        working_mode: ±1 a leg.
        actuated: names of the main actuators.
        carriers: names of the carriers.
        rotating: names of the rotating joints among actuators, carriers and joints with a range; the others slide.
        carrier_limits: limits of the carriers, in the same order.
        bodies: a row of 10 for each joint of the tree: mass, kg; mass times centre, kg·m; inertia xx, xy, yy, xz, yz,
            zz about the joint, kg·m²; of the body it moves, in the frame of the joint.
        q_reference: (nq,) its closed reference configuration.
        loads: loads other than gravity, as text; wrenches that are functions by their names.
        couplings: joints that follow others.
        ranges: of joints that have one, except carriers: name, lower and upper end, m or rad.
        folder: absolute path of the folder of the file that the record was read from, None for one made of a robot. The
            author of a file must not choose which code is loaded: in a record from a file, ``source`` counts only if it
            is a shipped robot or inside that folder.
    """

    name: str
    source: str
    arguments: Mapping[str, float | bool | str]
    gravity: Annotated[_Floats, Field(min_length=3, max_length=3, description="3 finite numbers")]
    working_mode: Annotated[tuple[int, ...], AfterValidator(_require_signs)]
    actuated: _Names
    carriers: _Names
    rotating: _Names
    carrier_limits: Annotated[tuple[CarrierLimits, ...], AfterValidator(_require_numbers)]
    bodies: tuple[Annotated[_Floats, Field(min_length=10, max_length=10, description="10 finite numbers")], ...]
    q_reference: _Floats
    loads: tuple[str, ...] = ()
    couplings: Annotated[tuple[Coupling, ...], AfterValidator(_require_finite)] = ()
    ranges: Annotated[
        tuple[tuple[str, _Number, _Number], ...], Field(description="a name and two numbers for each joint")
    ] = ()
    folder: str | None = field(default=None, compare=False)

    def __repr__(self) -> str:
        """Return which robot it is, not its mass properties."""
        return f"RobotRecord({self.name!r}, m={len(self.actuated)}, k={len(self.carriers)}, source={self.source!r})"

    @cached_property
    def made_of(self) -> Robot | None:
        """The robot that ``robot_record`` made the record of; None for one from a file, and in other processes."""
        return None

    def describes(self, robot: Robot) -> bool:
        """Return whether the record is of that very robot, wherever its files are."""
        now = robot_record(robot)
        arguments, reference = self.known_arguments(now), now.q_reference
        if _deviation(self.q_reference, reference) <= _SAME_NUMBERS:
            reference = self.q_reference  # closed by iterations
        return replace(now, source=self.source, arguments=arguments, q_reference=reference) == self

    def known_arguments(self, now: RobotRecord) -> dict[str, float | bool | str]:
        """Return the arguments of a newer record without new ones that have their defaults."""
        later = {name: value for name, value in now.arguments.items() if name not in self.arguments}
        if later:  # lengths and frames are not in a record: an argument may change what nothing else here shows
            usual = _usual(now.source, self.arguments)
            later = {name: value for name, value in later.items() if usual.get(name) == value}
        return {name: value for name, value in now.arguments.items() if name not in later}

    def saved_beside(self, path: str | Path) -> RobotRecord:
        """Return the record as it goes into the file of that path: a source in its folder as the path from there."""
        source, folder = self.source, _folder_of(path)
        if source and source not in shipped_sources() and (self.folder is not None or os.path.isabs(source)):
            place = _real(self.folder or "", source)
            if place.is_relative_to(folder):
                source = place.relative_to(folder).as_posix()
            elif self.folder is not None:
                source = str(place)
        return replace(self, source=source, folder=None)

    def limit_unit(self, quantity: str, joint: str) -> str:
        """Return the unit of a limit of a joint.

        ``quantity``: name of one of ``QUANTITIES``, or "range"; ``joint``: name of an actuated joint, a carrier or one
        that has a range.
        """
        units = {one.name: one.unit for one in QUANTITIES.values()}
        return units["track" if quantity == "range" else quantity](joint in self.rotating)

    def effort_unit(self, *joints: str) -> str:
        """Return the unit of the efforts of joints: N, N·m, or both where some slide and some rotate."""
        return effort_unit(name in self.rotating for name in joints)

    @property
    def effort_units(self) -> tuple[str, str]:
        """Units of the efforts of the main actuators, and of the carriers."""
        return self.effort_unit(*self.actuated), self.effort_unit(*self.carriers)


def robot_record(robot: Robot) -> RobotRecord:
    """Return the plain data from which a robot can be loaded again."""
    ranges = joint_ranges(robot)
    limited = (*robot.actuated, *robot.carriers, *(joint.name for joint in ranges))
    record = RobotRecord(
        name=robot.name,
        source=robot.source,
        arguments=dict(robot.parameters),
        gravity=tuple(float(g) for g in robot.gravity),
        working_mode=robot.working_mode,
        actuated=robot.actuated,
        carriers=robot.carriers,
        rotating=tuple(name for name in dict.fromkeys(limited) if is_revolute(robot, name)),
        carrier_limits=robot.carrier_limits,
        bodies=tuple(tuple(float(v) for v in body.toDynamicParameters()) for body in list(robot.model.inertias)[1:]),
        q_reference=tuple(float(q) for q in robot.q_reference),
        loads=tuple(map(repr, robot.loads)),
        couplings=robot.couplings,
        ranges=tuple((joint.name, joint.lower, joint.upper) for joint in ranges),
    )
    assign(record, made_of=robot)
    return record


def robot_of_record(record: RobotRecord, robot: RobotLike | None = None) -> Robot:
    """Return the robot that is given; else the one that the record was made of; else load it, as ``load_recorded``."""
    if robot is not None:
        return as_robot(robot)
    return load_recorded(record) if record.made_of is None else record.made_of


def _usual(source: str, given: Mapping[str, float | bool | str]) -> Mapping[str, float | bool | str]:
    """Return all arguments of a robot where some are given; of files that must be trusted, those not calculated."""
    with suppress(RedundancyPinError):
        return load_with(source, given).parameters
    with suppress(RedundancyPinError):
        path = declaration_path(source)
        return known_values(path.parent / read_declaration(path).data["urdf"], given)
    return {}


class _Strict(Schema):
    """Nothing is converted, and the fields of dataclasses are validated too."""

    model_config = ConfigDict(strict=True, revalidate_instances="always")


_STORED = tuple(field.name for field in fields(RobotRecord) if field.compare)
"""Fields of a record that its file holds."""

_TYPES: dict[str, Any] = {name: (get_type_hints(RobotRecord, include_extras=True)[name], ...) for name in _STORED}

_Record = create_model("_Record", __base__=_Strict, **_TYPES)
"""What a file must hold for a ``RobotRecord``."""


def read_robot(record: Mapping[str, Any], file: str | Path) -> RobotRecord:
    """Return the record that a file holds as a mapping of its fields.

    Raises:
        KeyError: a field is missing.
        DeclarationError: names the first invalid field and the allowed values.
    """
    values = {name: record[name] for name in _STORED}
    for name, kind in (("carrier_limits", CarrierLimits), ("couplings", Coupling)):
        if isinstance(values[name], tuple):
            values[name] = tuple(kind(**each) if isinstance(each, Mapping) else each for each in values[name])
    return RobotRecord(**dict(validated(_Record, values, of="robot")), folder=str(_folder_of(file)))


def load_recorded(record: RobotRecord, source: str | Path | None = None, *, trust: bool = False) -> Robot:
    """Load the robot of a record, and make sure that it is still the same.

    ``source``: present location of the robot, if its files have moved or are elsewhere than the file with the record;
    ``trust``: as for ``load_robot``; only a user sets it, never a file.
    """
    _require_sound(record)
    try:
        place = _own_source(record) if source is None else source
        robot = _loaded_from(place, record, trust=trust, named=source is not None)
    except ModelFileError as error:
        raise PlanFileError(
            f"The robot of the plan cannot be loaded: {error.message}",
            remedy=f"Load it from where its files are now, and pass it: {_load_and_pass('robot.yaml')}",
            source=record.source,
        ) from error
    except PlanFileError:
        raise
    except RedundancyPinError as error:
        at, name = source or record.source, ""
        with suppress(RedundancyPinError):  # the parameters and modes of another kind of robot do not fit
            name = load_with(at, {}, trust=trust).name
        raise _changed(record, at, error.message, name) from error
    difference = record_difference(record, robot_record(robot))
    if difference:
        raise _changed(record, place, difference, robot.name)
    return replace(robot, own_meshes_only=source is None and record.folder is not None and not trust)


def _loaded_from(place: str | Path, record: RobotRecord, *, trust: bool, named: bool) -> Robot:
    """Load the robot of a record from a place; a file without arguments, if named."""
    settings: dict[str, Any] = {"gravity": record.gravity, "working_mode": record.working_mode or None, "trust": trust}
    try:
        return load_with(place, record.arguments, **settings)
    except InputError:
        if not (named and record.arguments):
            raise
        plain = load_with(place, {}, **settings)
        if plain.parameters:
            raise
        return plain


def _require_sound(record: RobotRecord) -> None:
    """Judge a record that was put together in Python as one that comes from a file."""
    values = {name: getattr(record, name) for name in _STORED}
    if isinstance(record.arguments, Mapping):
        values["arguments"] = dict(record.arguments)
    try:
        validated(_Record, values, of="robot")
    except DeclarationError as error:
        raise PlanFileError(error.message, remedy=error.remedy or "Save the plan again.") from error


_PASS_ROBOT = "robot=robot, as in rp.show(plan, robot=robot); a controller takes plan_reference(plan, robot=robot)."
"""How a robot goes with its plan, or its simulation."""


def _load_and_pass(place: str) -> str:
    return f"robot = rp.load_robot_of(plan, {place!r}), then {_PASS_ROBOT} {_name_robot(place)}"


def _name_robot(place: str) -> str:
    return f"On the command line: --robot {shlex.quote(place)}."


def _own_source(record: RobotRecord) -> str:
    """Return the location of the robot if the record may set it; PlanFileError if the user must."""
    if not record.source:
        raise PlanFileError(
            f"The plan has no file of its robot {shown(record.name)}: the robot was made in Python.",
            remedy=f"Pass the robot itself: {_PASS_ROBOT}",
        )
    if record.folder is None or record.source in shipped_sources():
        return record.source
    place = _real(record.folder, record.source)
    _require_inside(place, record.folder)
    place = _real(str(declaration_path(str(place))))  # of a folder: its robot.yaml may be a link, too
    _require_inside(place, record.folder)
    if not is_model_file(place):
        _require_inside(_real(os.path.dirname(place), read_declaration(place).data["urdf"]), record.folder)
    return str(place)


def _require_inside(place: Path, folder: str) -> None:
    if not place.is_relative_to(folder):
        raise PlanFileError(
            f"The plan names {place} for its robot, outside its own folder {folder}: a file must not "
            "load a robot from elsewhere.",
            remedy=f"Where you trust that robot, load it and pass it: {_load_and_pass(str(place))}",
            source=str(place),
        )


def _folder_of(file: str | Path) -> Path:
    return _real(os.path.dirname(os.path.expanduser(file)))


def _real(*parts: str) -> Path:
    """Return the absolute path with every symbolic link followed; an invalid path is treated as nonexistent."""
    try:
        return Path(os.path.realpath(os.path.join(*parts)))
    except (OSError, ValueError):
        return Path(os.sep, "\N{REPLACEMENT CHARACTER}")


def _changed(record: RobotRecord, place: str | Path, what: str, name: str = "") -> PlanFileError:
    """Return the error that another robot than that of the record is at a place; ``name``: its name, where known."""
    meant = "" if name == record.name else f", {record.name}"
    return PlanFileError(
        f"The robot {f'{name} ' if name else ''}at {place} is not the one the plan was made for{meant}: {what}",
        remedy=f"Plan again, or pass the robot as it was: {_PASS_ROBOT} {_name_robot('robot.yaml')}",
        source=str(place),
    )


def record_difference(then: RobotRecord, now: RobotRecord) -> str:
    """Return the first difference between two records; empty if they describe the same robot."""
    for name in ("arguments", "working_mode", "actuated", "carriers", "carrier_limits", "loads"):
        before, after = getattr(then, name), then.known_arguments(now) if name == "arguments" else getattr(now, name)
        if name == "arguments" and not now.arguments:
            continue  # files written for this machine have none: their content is compared below
        if name == "loads":  # payloads are in the mass properties
            before, after = (tuple(one for one in loads if not one.startswith("Payload(")) for loads in (before, after))
        if before != after:
            return f"its {name.replace('_', ' ')} were {before}, now {after}."
    for name, what in (("couplings", "coupling"), ("ranges", "range of the joint")):
        had, has = _by_name(getattr(then, name)), _by_name(getattr(now, name))
        for key in {**had, **has}:
            if not _alike(had.get(key), has.get(key)):
                return f"its {what} {key!r} was {_entry(had.get(key))}, now {_entry(has.get(key))}."
    for name, what, tolerance in (
        ("bodies", "mass properties", _SAME_NUMBERS),
        ("q_reference", "reference configuration", _SAME_REFERENCE),
    ):
        before, after = getattr(then, name), getattr(now, name)
        if np.shape(before) != np.shape(after):
            return f"its {what} had shape {np.shape(before)}, now {np.shape(after)}."
        deviation = _deviation(before, after)
        if not deviation <= tolerance:
            return f"its {what} differ by {deviation:.3g}."
    return ""


def _deviation(before: ArrayLike, after: ArrayLike) -> float:
    """Return the largest deviation of numbers, relative to the largest of those before and 1; inf for other shapes."""
    if np.shape(before) != np.shape(after):
        return inf
    return float(np.abs(np.subtract(before, after)).max(initial=0.0)) / float(np.abs(before).max(initial=1.0))


_Entry = tuple[tuple[str, ...], tuple[float, ...]]
"""Names and numbers of a coupling or of a range."""


def _by_name(entries: Sequence[Coupling | tuple[str, float, float]]) -> dict[str, _Entry]:
    entries_by_name: dict[str, _Entry] = {}
    for each in entries:
        if isinstance(each, Coupling):
            factors = tuple(factor for _, factor in each.also)
            entries_by_name[each.name] = (
                (each.joint, each.of, *(name for name, _ in each.also)),
                each.polynomial + factors,
            )
        else:
            entries_by_name[each[0]] = (), each[1:]
    return entries_by_name


def _alike(one: _Entry | None, other: _Entry | None) -> bool:
    if one is None or other is None or one[0] != other[0] or len(one[1]) != len(other[1]):
        return False
    return bool(np.allclose(one[1], other[1], rtol=_SAME_NUMBERS, atol=_SAME_NUMBERS))


def _entry(entry: _Entry | None) -> str:
    return "none" if entry is None else ", ".join([*filter(None, entry[0]), *(f"{each:.9g}" for each in entry[1])])
