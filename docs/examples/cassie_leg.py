"""Cassie's leg: the file's rods, corrected, and what its knee carries.

The SDF gives the achilles rod a ball at the hip and a hinge at the heel's spring. The machine has balls at both ends:
by the file's hinge the leg could not bend while its springs are relaxed. Two words of the file are changed, in a copy;
the declaration below holds the springs and says what is driven. The SDF comes with ``pip install
'redundancy_pin[examples]'``.

Run it with ``python docs/examples/cassie_leg.py``; with ``--html leg.html`` it also writes the motion to look at.
"""

from __future__ import annotations

import argparse
import tempfile
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import numpy as np

import redundancy_pin as rp
from redundancy_pin.robot import Robot

SIDES = ("left", "right")
MOTORS = ("roll-op", "yaw-op", "pitch-op", "knee-op", "tarsus-crank-joint")
FOLDED = -1.1
"""rad: a crank's angle, within its range. In the file's pose, at zero, crank and plantar rod lie nearly in a line: from
there a smooth motion of the crank into its range crosses the rod."""
SPRINGS = ("knee-shin-joint", "tarsus-spring-joint")
"""Joints of a leg that motors turn, and those of its leaf springs."""
BLADE = (0.01, 0.045, 0.0)
"""Middle of the foot's blade in its axes, m, as the collision shape of the file has it."""
CARRIED = 160.0
"""N: half of the machine's weight."""

DECLARATION = f"""
name: cassie_leg
description: Cassie clamped at the pelvis, the springs of its legs held
urdf: cassie.sdf
gravity: [0, 0, -9.81]
couplings: [{", ".join(f"{{joint: {side}-{name}, polynomial: [0]}}" for side in SIDES for name in SPRINGS)}]
actuated: &motors [{", ".join(f"{side}-{name}" for side in SIDES for name in MOTORS)}]
independent: {{joints: *motors}}
reference:
  joints: {{{", ".join(f"{side}-{name}: {FOLDED if 'crank' in name else 0}" for side in SIDES for name in MOTORS)}}}
  guess: {{{", ".join(f"{side}-foot-op: {FOLDED}, {side}-crank-rod-joint: {-FOLDED}" for side in SIDES)}}}
"""


def cassie_sdf(folder: Path) -> Path:
    """Write Cassie's SDF with balls at both ends of the achilles rods; return its path.

    Raises:
        PackageNotFoundError: example-robot-data is not installed.
    """
    paths = [file for file in files("example-robot-data") or () if file.name == "cassie_v2.sdf"]
    text, path = Path(str(paths[0].locate())).read_text(encoding="utf-8"), folder / "cassie.sdf"
    for side in SIDES:
        hinge = f'"{side}-achilles-spring-joint" type="revolute"'
        text = text.replace(hinge, hinge.replace("revolute", "ball"))
    path.write_text(text, encoding="utf-8")
    return path


def load(folder: Path) -> Robot:
    """Write SDF and declaration into a folder and load the robot."""
    cassie_sdf(folder)
    (folder / "cassie_leg.yaml").write_text(DECLARATION, encoding="utf-8")
    return rp.load_robot(folder / "cassie_leg.yaml")


def bend(robot: Robot, samples: int = 41) -> rp.PlatformMotion:
    """Return two seconds in which the left leg folds: its knee by −2 rad, the hip by 1; the blade stays level."""
    row = dict(zip(robot.independent_joints, np.eye(robot.n), strict=True))
    end = -2.0 * row["left-knee-op"] + 1.0 * row["left-pitch-op"] - 1.0 * row["left-tarsus-crank-joint"]
    start = FOLDED * (row["left-tarsus-crank-joint"] + row["right-tarsus-crank-joint"])
    return rp.trajectory.from_points([start, start + end], [0.0, 2.0], ends="rest").sample(2.0 / (samples - 1))


def torques(robot: Robot, motion: rp.PlatformMotion) -> rp.Distribution:
    """Return the motors' torques (N, 10) while the ground carries the left foot's blade."""
    ground = np.tile([0.0, 0.0, CARRIED, 0.0, 0.0, 0.0], (len(motion), 1))
    push = rp.Wrench("left-foot", ground, point=BLADE)
    return rp.distribute(rp.RneaDynamics(robot).reduce(motion, external=[push]))


def main() -> None:
    """Print how knee and tarsus go together, and the torques."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--html", help="file to write the motion to")
    chosen = options.parse_args()
    try:
        with tempfile.TemporaryDirectory() as folder:
            robot = load(Path(folder))
    except PackageNotFoundError:
        raise SystemExit("Cassie's SDF is missing: pip install 'redundancy_pin[examples]'") from None
    motion = bend(robot)
    column = robot.model.joints[robot.model.getJointId("left-shin-tarsus-joint")].idx_q
    knee = motion.x[:, robot.independent_joints.index("left-knee-op")]
    both = knee + rp.inverse_kinematics(robot, motion).q[:, column]
    print(
        f"knee by {knee[-1]:.2f} rad, tarsus by as much the other way: their sum stays within {np.abs(both).max():.1e}"
    )
    for name, tau in zip(robot.actuated, torques(robot, motion).tau.T, strict=True):
        if name.startswith("left"):
            print(f"{name}: {tau.min():.1f} to {tau.max():.1f} N·m")
    if chosen.html:
        rp.show(robot, motion).save(chosen.html)


if __name__ == "__main__":
    main()
