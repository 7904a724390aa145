"""Which robot a plan is for, in plain data, and how to load that robot again."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np

from redundancy_pin.errors import ModelFileError, PlanFileError, RedundancyPinError
from redundancy_pin.loading import load_robot
from redundancy_pin.robot import CarrierLimits, Robot

_SAME_BODIES = 1e-9
"""Relative deviation of mass properties that xacro's arithmetic may show between two machines."""

_SAME_REFERENCE = 1e-6
"""Deviation, m or rad, of the closed reference configuration between two machines: Newton stops far below it."""

_RATES = {"track": "", "speed": "/s", "acceleration": "/s²", "jerk": "/s³"}
"""Limits of a motion, and what their units add to that of its position."""


@dataclass(frozen=True, repr=False)
class RobotRecord:
    """What is needed to load the plan's robot again, and to notice that it has changed.

    Attributes:
        name: its name.
        source: name of a shipped robot or absolute path of its declaration; empty for a robot that was not loaded.
        arguments: its xacro arguments.
        gravity: (3,) m/s².
        working_mode: ±1 a leg.
        actuated: names of the main actuators.
        carriers: names of the carriers.
        rotating: those of the two that rotate; the others slide.
        carrier_limits: limits of the carriers, in the same order.
        bodies: a row of 10 for each joint of the tree: mass, kg; mass times centre, kg·m; inertia xx, xy, yy, xz, yz,
            zz about the joint, kg·m²; of the body it moves, in the frame of the joint.
        q_reference: (nq,) its closed reference configuration.
    """

    name: str
    source: str
    arguments: Mapping[str, float | bool | str]
    gravity: tuple[float, ...]
    working_mode: tuple[int, ...]
    actuated: tuple[str, ...]
    carriers: tuple[str, ...]
    rotating: tuple[str, ...]
    carrier_limits: tuple[CarrierLimits, ...]
    bodies: tuple[tuple[float, ...], ...]
    q_reference: tuple[float, ...]

    def __repr__(self) -> str:
        """Return which robot it is, not its mass properties."""
        return f"RobotRecord({self.name!r}, m={len(self.actuated)}, k={len(self.carriers)}, source={self.source!r})"

    def limit_unit(self, quantity: str, joint: str) -> str:
        """Return the unit of a limit of a joint.

        ``quantity``: "track", "speed", "acceleration" or "jerk" of its motion; anything else is an effort; ``joint``:
        name of an actuated joint or a carrier.
        """
        if quantity not in _RATES:
            return self.effort_unit(joint)
        return ("rad" if joint in self.rotating else "m") + _RATES[quantity]

    def effort_unit(self, *joints: str) -> str:
        """Return the unit of the efforts of joints: N, N·m, or both where some slide and some rotate."""
        turning = [name in self.rotating for name in joints]
        return "N·m" if turning and all(turning) else "N or N·m" if any(turning) else "N"


def robot_record(robot: Robot) -> RobotRecord:
    """Return the plain data from which a robot can be loaded again."""
    return RobotRecord(
        name=robot.name,
        source=robot.source,
        arguments=dict(robot.parameters),
        gravity=tuple(float(g) for g in robot.gravity),
        working_mode=robot.working_mode,
        actuated=robot.actuated,
        carriers=robot.carriers,
        rotating=tuple(name for name in (*robot.actuated, *robot.carriers) if _rotates(robot, name)),
        carrier_limits=robot.carrier_limits,
        bodies=tuple(tuple(float(v) for v in body.toDynamicParameters()) for body in list(robot.model.inertias)[1:]),
        q_reference=tuple(float(q) for q in robot.q_reference),
    )


def read_robot(record: Mapping[str, Any]) -> RobotRecord:
    """Return the record that a file holds as a mapping of its fields."""
    values = {field.name: record[field.name] for field in fields(RobotRecord)}
    values["carrier_limits"] = tuple(CarrierLimits(**entry) for entry in values["carrier_limits"])
    return RobotRecord(**values)


def load_recorded(record: RobotRecord, source: str | Path | None = None) -> Robot:
    """Load the robot of a record, and make sure that it is still the same.

    ``source``: where the robot is now, if its files have moved.
    """
    place = record.source if source is None else source
    if not str(place):
        raise PlanFileError(
            f"The plan does not say where its robot {record.name} was loaded from.",
            remedy="Pass source=, the path of its robot.yaml.",
        )
    try:
        robot = load_robot(
            place, gravity=record.gravity, working_mode=record.working_mode or None, **dict(record.arguments)
        )
    except ModelFileError as error:
        raise PlanFileError(
            f"The robot of the plan cannot be loaded: {error.message}",
            remedy="Pass source=, the path of its robot.yaml.",
            source=str(place),
        ) from error
    except RedundancyPinError as error:
        raise _changed(record, place, error.message) from error
    difference = _difference(record, robot_record(robot))
    if difference:
        raise _changed(record, place, difference)
    return robot


def _rotates(robot: Robot, name: str) -> bool:
    return not str(robot.model.joints[robot.model.getJointId(name)].shortname()).startswith("JointModelP")


def _changed(record: RobotRecord, place: str | Path, what: str) -> PlanFileError:
    return PlanFileError(
        f"The robot {record.name} at {place} is not the one the plan was made for: {what}",
        remedy="Plan again, or pass source=, the path of the robot.yaml as it was.",
        source=str(place),
    )


def _difference(then: RobotRecord, now: RobotRecord) -> str:
    """Say what differs first between two records; empty if they describe the same robot."""
    for name in ("arguments", "working_mode", "actuated", "carriers", "carrier_limits"):
        before, after = getattr(then, name), getattr(now, name)
        if before != after:
            return f"its {name.replace('_', ' ')} were {before}, now {after}."
    for name, what, tolerance in (
        ("bodies", "mass properties", _SAME_BODIES),
        ("q_reference", "reference configuration", _SAME_REFERENCE),
    ):
        before, after = np.array(getattr(then, name)), np.array(getattr(now, name))
        if before.shape != after.shape:
            return f"its {what} had shape {before.shape}, now {after.shape}."
        deviation = float(np.abs(before - after).max(initial=0.0)) / float(np.abs(before).max(initial=1.0))
        if not deviation <= tolerance:
            return f"its {what} differ by {deviation:.3g}."
    return ""
