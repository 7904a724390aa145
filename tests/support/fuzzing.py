"""What is done with malformed files, and how its result is judged: right, refused by one clear error, or wrong.

As a program it prints what goes wrong, by class: ``python tests/support/fuzzing.py KIND [count] [first]``.
"""

from __future__ import annotations

import contextlib
import csv
import io
import math
import random
import sys
import warnings
import xml.etree.ElementTree as ElementTree
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import forked
import mjcf_models
import mutated
import numpy as np
import pinocchio as pin

import redundancy_pin as rp
from redundancy_pin.cli.problem import read_problem
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.robot import Robot

CLOSED = 1e-9
"""m and rad; the rounding that Newton's method leaves of closures of about a metre."""

SAME_READING = 1e-6
"""N, N·m, m: MuJoCo makes what it is given of single precision here and there, and normalises quaternions."""

SAME_MASS = 1e-9
"""Relative; sums of the same numbers in another order."""


def wrong_robot(robot: Robot) -> str | None:
    """Return what is wrong with a robot that was accepted: its numbers, its closures, or that it does not move."""
    model = robot.model
    masses = np.array([inertia.mass for inertia in model.inertias])
    levers = np.array([inertia.lever for inertia in model.inertias])
    if not (np.isfinite(masses).all() and np.isfinite(levers).all() and (masses >= 0.0).all()):
        return "accepted: masses that are none"
    if not np.isfinite(robot.q_reference).all() or not np.isfinite(robot.gravity).all():
        return "accepted: numbers that are not finite"
    state = ConstraintSystem(robot).evaluate(robot.q_reference[None])
    if robot.closures and not np.abs(state.phi).max() < CLOSED * max(1.0, robot.characteristic_length):
        return f"accepted: the reference is open by {np.abs(state.phi).max():.2g}"
    home = coordinates(robot, state)
    motion = rp.PlatformMotion([0.0, 0.1], np.repeat(home, 2, axis=0), np.zeros((2, robot.n)), np.zeros((2, robot.n)))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        reduced = rp.RneaDynamics(robot).reduce(motion)
        rp.distribute(reduced)
    if not (np.isfinite(reduced.W).all() and np.isfinite(reduced.f).all()):
        return "accepted: dynamics that are not finite"
    return None


def _three(text: str) -> list[float]:
    values = [float(word) for word in text.split()]
    if len(values) != 3 or not all(map(math.isfinite, values)):
        raise ValueError(text)
    return values


def total_mass(text: str) -> float:
    """Return the mass of all links of a URDF, by nothing but its XML; ValueError where a number is none."""
    total = 0.0
    root = ElementTree.fromstring(text)
    for element in (*root.findall("link/inertial/origin"), *root.findall("joint/origin")):
        for key in ("xyz", "rpy"):
            _three(element.get(key, "0 0 0"))
    for joint in root.findall("joint"):
        axis = joint.find("axis")
        if axis is not None and joint.get("type") != "fixed" and not any(_three(axis.get("xyz", "1 0 0"))):
            raise ValueError("an axis without direction")
    for inertial in root.findall("link/inertial"):
        mass = inertial.find("mass")
        if mass is None:
            raise ValueError("an inertial without mass")
        total += float(mass.get("value", ""))
        inertia = inertial.find("inertia")
        for key in ("ixx", "iyy", "izz"):
            if inertia is None or not math.isfinite(float(inertia.get(key, ""))):
                raise ValueError("an inertia that is none")
    return total


def load_declared(folder: Path) -> str | None:
    """Load the robot of the folder."""
    return wrong_robot(rp.load_robot(folder / "robot.yaml"))


def load_urdf(folder: Path) -> str | None:
    """Load the robot, and compare its mass with that of the file."""
    robot = rp.load_robot(folder / "robot.yaml")
    try:
        expected = total_mass((folder / "robot.urdf").read_text(encoding="utf-8"))
    except (ValueError, LookupError, ElementTree.ParseError) as error:
        return f"accepted: a URDF with what is no number: {error}"
    mass = sum(inertia.mass for inertia in robot.model.inertias)
    if not abs(mass - expected) <= SAME_MASS * max(1.0, expected):
        return f"accepted: a mass of {mass:g} kg, the file has {expected:g} kg"
    return wrong_robot(robot)


def load_mjcf(folder: Path) -> str | None:
    """Load the robot, and compare its bodies and what holds it against gravity with MuJoCo's own reading."""
    notes = io.StringIO()
    with contextlib.redirect_stderr(notes):  # what is not in force is said
        robot = rp.load_robot(folder / "model.xml")
    if any("Not in force" not in line and "cannot balance" not in line for line in notes.getvalue().splitlines()):
        return f"accepted: with {notes.getvalue()!r}"
    try:
        import mujoco

        mujoco.set_mju_user_warning(lambda text: None)
        engine = mjcf_models.Engine(folder / "model.xml")
        engine.set(robot, robot.q_reference)
    except (ValueError, KeyError, IndexError, ImportError):
        return wrong_robot(robot)  # nobody to compare with
    model, data = robot.model, robot.model.createData()
    gravity_efforts = pin.computeGeneralizedGravity(model, data, np.array(robot.q_reference))
    pin.framesForwardKinematics(model, data, np.array(robot.q_reference))
    expected = np.array(engine.data.qfrc_bias)[engine.columns(robot)[0]]
    if not np.abs(gravity_efforts - expected).max() <= SAME_READING * max(1.0, float(np.abs(expected).max())):
        return f"accepted: held by {gravity_efforts.round(6).tolist()}, MuJoCo says {expected.round(6).tolist()}"
    sites = {engine.model.site(i).name for i in range(engine.model.nsite)}
    for i in range(1, engine.model.nbody):
        name = engine.model.body(i).name
        # the first of a site and a body of one name keeps it
        if name and name not in sites and model.existFrame(name, pin.FrameType.BODY):
            place = data.oMf[model.getFrameId(name, pin.FrameType.BODY)].translation
            if not np.abs(place - engine.data.xpos[i]).max() <= SAME_READING * max(1.0, float(np.abs(place).max())):
                return f"accepted: {name} is at {place.tolist()}, MuJoCo says {engine.data.xpos[i].tolist()}"
    return wrong_robot(robot)


def load_sdf(folder: Path) -> str | None:
    """Load the robot, and compare its mass with that of the file."""
    robot = rp.load_robot(folder / "machine.sdf", actuated="crank")
    try:
        root = ElementTree.fromstring((folder / "machine.sdf").read_bytes())
        masses = [float(one.text or "") for one in root.iterfind(".//link/inertial/mass")]
        poses = [[float(word) for word in (one.text or "").split()] for one in root.iter("pose")]
    except (ValueError, ElementTree.ParseError) as error:
        return f"accepted: an SDF with what is no number: {error}"
    if any(len(pose) not in (0, 6, 7) or not all(map(math.isfinite, pose)) for pose in poses):
        return "accepted: a pose that is none"
    mass = sum(inertia.mass for inertia in robot.model.inertias)
    # a link without an inertial has 1 kg in SDF
    bare = sum(one.find("inertial/mass") is None for one in root.iter("link"))
    if not any(abs(mass - sum(masses) - more) <= SAME_MASS * max(1.0, sum(masses)) for more in (0.0, float(bare))):
        return f"accepted: a mass of {mass:g} kg, the file has {sum(masses):g} kg"
    return wrong_robot(robot)


def read_motion(folder: Path) -> str | None:
    """Read a CSV and compare the columns with what Python's own reader gives."""
    motion = rp.trajectory.from_csv(folder / "motion.csv")
    rp.trajectory.csv_file.carriers_from_csv(folder / "motion.csv")
    with (folder / "motion.csv").open(newline="", encoding="utf-8-sig") as stream:
        rows = [[cell.strip() for cell in row] for row in csv.reader(stream) if any(cell.strip() for cell in row)]
    names = rows[0]
    table = {
        name: [float(row[i]) for row in rows[1:]] for i, name in enumerate(names) if name[:1] in ("t", "x") and name
    }
    if len(set(names)) < len(names):
        return "accepted: a column twice"
    parts = [("t", motion.t[:, None]), ("xd", motion.xd), ("xdd", motion.xdd)]
    if motion.x.ndim == 2:
        parts.append(("x", motion.x))
    for key, array in parts:
        for i in range(array.shape[1]):
            name = key if key == "t" else f"{key}{i}"
            if name not in table or not np.array_equal(np.array(table[name]), array[:, i]):
                return f"accepted: {name} is not the column of the file"
    if not all(np.isfinite(array).all() for _, array in parts) or (np.diff(motion.t) < 0.0).any():
        return "accepted: numbers that are none, or times that run back"
    return None


def read_problem_file(folder: Path) -> str | None:
    """Read a problem, with its robot and its motion."""
    problem = read_problem(str(folder / "problem.yaml"))
    return wrong_robot(problem.dynamics.robot)


@dataclass(frozen=True)
class Kind:
    """Files that are malformed, what is done with them, and how many of them."""

    make: Callable[[random.Random], mutated.Files]
    action: forked.Action
    count: int


KINDS = {
    "declarations (YAML)": Kind(mutated.declarations, load_declared, 2000),
    "URDF": Kind(mutated.urdfs, load_urdf, 2000),
    "xacro": Kind(mutated.xacros, load_declared, 1500),
    "motions (CSV)": Kind(mutated.motions, read_motion, 1500),
    "problems (YAML)": Kind(mutated.problems, read_problem_file, 1000),
    "MJCF": Kind(mutated.mjcfs, load_mjcf, 1000),
    "SDF": Kind(mutated.sdfs, load_sdf, 500),
}


@dataclass
class Tally:
    """Counts of verdicts, the classes of what is wrong with their numbers, an example of each: (number, text)."""

    counts: Counter[str] = field(default_factory=Counter)
    classes: Counter[str] = field(default_factory=Counter)
    examples: dict[str, tuple[int, str]] = field(default_factory=dict)


def outcome_of(name: str, number: int) -> forked.Outcome:
    """Make and try one input of a kind."""
    kind = KINDS[name]
    return forked.run(kind.action, kind.make(random.Random(f"{name}/{number}")))


def warm(name: str) -> None:
    """Do once, before any fork, what all inputs share: what is imported and cached costs them nothing."""
    kind = KINDS[name]
    for number in range(20):
        kind.make(random.Random(f"{name}/{number}"))
    with contextlib.suppress(Exception):
        rp.load_robot("3rrr")


def tally(name: str, numbers: range, report: Callable[[str], None] | None = None) -> Tally:
    """Try inputs of a kind and count how they ended."""
    warm(name)
    result = Tally()
    for number in numbers:
        outcome = outcome_of(name, number)
        result.counts[outcome.verdict] += 1
        if outcome.verdict == forked.WRONG:
            result.classes[f"{outcome.reason} ({number})"] += 1
            result.examples.setdefault(outcome.reason, (number, outcome.text))
            if report is not None:
                used = f"{outcome.seconds:.1f} s {outcome.megabytes:.0f} MB"
                report(f"{name} {number}: {outcome.reason} | {used} | {outcome.text!r}")
    return result


def main() -> None:
    """Try a kind whose name begins with the first argument."""
    start, *rest = sys.argv[1:]
    count, first = (int(text) for text in (*rest, *("200", "0")[len(rest) :]))
    for name in KINDS:
        if name.startswith(start):
            result = tally(name, range(first, first + count), forked.show)
            forked.show(f"{name} {dict(result.counts)}")
            for reason, example in result.examples.items():
                forked.show(f"  {reason}: {example!r}")


if __name__ == "__main__":
    main()
