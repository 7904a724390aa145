"""C for a controller: inverse dynamics, forward kinematics, Jacobians and margins of one robot, in C99 and math.h.

The expressions and the closing of loops are those of ``dynamics.compiled``; ``controller.c`` stands behind them
(``source``). What the test program expects comes from ``RneaDynamics`` (``recorded``), which shares nothing with them.
"""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from redundancy_pin.codegen.pages import pages
from redundancy_pin.codegen.plan import record_plan
from redundancy_pin.codegen.recorded import record
from redundancy_pin.dynamics.compiled.parameters import parameter_vector, topology_of
from redundancy_pin.errors import InputError, UnsupportedRobotError, shown
from redundancy_pin.io.files import MANIFEST, replacing_folder, require_replaceable, write_text
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.robot import Robot, Wrench
from redundancy_pin.robot.loads import of_kind

__all__ = ["GeneratedCode", "write_c"]

_LONGEST_PREFIX = 40
"""Letters: compilers that count only the first 63 of a name still tell all functions apart."""

_TAKEN = re.compile(
    "m|assert|complex|ctype|errno|fenv|float|inttypes|iso646|limits|locale|math|setjmp|signal|std[a-z]+|string|tgmath|"
    "threads|time|uchar|wchar|wctype|all|clean|help|install|package|test",
    flags=re.IGNORECASE,
)
"""Headers and library of C, which files of that name would hide, and targets of CMake."""


@dataclass(frozen=True)
class GeneratedCode:
    """C that was written.

    Attributes:
        folder: where it is.
        prefix: what all its names begin with.
        files: names of the files in the folder.
        samples: samples of the motion that its test program compares with.
    """

    folder: Path
    prefix: str
    files: tuple[str, ...]
    samples: int


def write_c(
    robot: RobotLike,
    folder: str | Path,
    *,
    prefix: str | None = None,
    motion: PlatformMotion | None = None,
    carriers: CarrierMotion | None = None,
    online: RecedingHorizon | None = None,
) -> GeneratedCode:
    """Write C99 for a controller into a folder: source, header, CMake file, README, and a test program.

    The code allocates nothing, has no state but what its caller holds, and calls math.h alone. Its functions give W,
    f, τ with the statuses of ``distribute``, and carrier forces; platform coordinates from actuated positions (with at
    least as many actuators as freedoms); constraint Jacobians; margins to singularities. Ranges of joints and tracks
    are not checked.

    Args:
        robot: the robot, or its name or path; its dimensions, masses, gravity and working mode become constants.
        folder: missing, empty, or one that this function filled before, which is replaced as a whole.
        prefix: what names in C begin with; the robot's name when left out.
        motion: N samples that the test program compares with ``RneaDynamics``, unreachable ones left out, thinned
            out to 200; a random motion about the reference when left out.
        carriers: N samples of the carriers for it; parked when left out.
        online: a planner of this robot, of which the code is written too: limits, weights and steps as it has them now.
            Its functions plan over the platform's motion ahead, given as piecewise polynomials, and evaluate W and f by
            this code; its test program has 100 recorded updates along ``motion``.

    Raises:
        InputError: a prefix that is no name in C; the motion does not fit, or no sample of it can be reached; no
            actuators.
        OutputError: the folder cannot be written, or holds other files.
        UnsupportedRobotError: a joint of a type that is not covered; wrenches on the robot.

    Example:
        >>> rp.write_c("four_bar", "controller").prefix
        'four_bar'
    """
    robot = as_robot(robot)
    require_replaceable(folder)
    name = prefix_of(robot.name, prefix)
    if not robot.m:
        raise InputError(f"{robot.name} has no main actuators.", remedy="Declare which joints are actuated.")
    if of_kind(robot.loads, Wrench):
        raise UnsupportedRobotError(
            f"{robot.name} has wrenches on it, which the code for a controller does not take.",
            remedy="Write the code without them, and add Jᵀ of what is measured to f.",
        )
    if carriers is not None and motion is None:
        raise InputError("carriers are given without a motion.", remedy="Pass both, or neither.")
    if online is not None:
        _require_same(online.robot, robot)
    recorded = record(robot, motion, carriers)
    written = pages(robot, name, recorded, None if online is None else (online, record_plan(online, motion)))
    with replacing_folder(folder) as temporary:
        for file, text in written.items():
            write_text(temporary / file, text)
        write_text(temporary / MANIFEST, json.dumps({"robot": robot.name, "prefix": name, "files": [*written]}) + "\n")
    return GeneratedCode(Path(folder), name, (*written, MANIFEST), len(recorded))


def _require_same(own: Robot, robot: Robot) -> None:
    """Check that a planner's robot is the one that is written."""
    same = own is robot or topology_of(own).text == topology_of(robot).text
    if not same or not np.array_equal(parameter_vector(own), parameter_vector(robot)):
        raise InputError(
            f"The planner plans for {own.name}, which is not the {robot.name} that is written.",
            remedy="Make the planner of this robot: online=RecedingHorizon(robot).",
        )


def prefix_of(robot: str, given: str | None) -> str:
    if given is None:
        name = re.sub(r"[^A-Za-z0-9]+", "_", robot).strip("_").lower()[:_LONGEST_PREFIX].strip("_")
        if re.match(r"[a-z]", name) and not _TAKEN.fullmatch(name):  # a digit begins no name
            return name
        return f"robot_{name}"[:_LONGEST_PREFIX].strip("_")
    # two underscores in a row belong to compilers
    if not re.fullmatch(r"[A-Za-z](_?[A-Za-z0-9])*", given, flags=re.ASCII) or len(given) > _LONGEST_PREFIX:
        raise InputError(
            f"prefix is {shown(given)}, which cannot begin names in C here.",
            remedy=f"Choose a letter, then letters, digits and single underscores between, at most {_LONGEST_PREFIX}.",
            name="prefix",
        )
    if _TAKEN.fullmatch(given):
        raise InputError(
            f"prefix is {given}: the header {given}.h or the target {given} is there already.",
            remedy=f"Choose another one, such as robot_{given}.",
            name="prefix",
        )
    return given
