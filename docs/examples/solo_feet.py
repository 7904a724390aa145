"""A loop closed on a robot that has none: the quadruped Solo on a stand, its feet tied together two by two.

The trunk is clamped; the left front foot is pinned to the left hind foot, the right ones likewise. Each side is then a
planar five-bar, and eight motors drive four freedoms. The URDF comes with
``pip install 'redundancy_pin[examples]'`` and is used as it is: what closes the chains is the declaration below.

Run it with ``python docs/examples/solo_feet.py``; with ``--html solo.html`` it also writes the motion to look at.
"""

from __future__ import annotations

import argparse
import tempfile
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import numpy as np

import redundancy_pin as rp
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import Line, RestToRest, Trajectory

DECLARATION = """
name: solo_feet
description: the quadruped Solo on a stand, front and hind feet pinned together on either side
urdf: {urdf}
gravity: [0, 0, -9.81]
closures:
  - {{name: left, frames: [FL_FOOT, HL_FOOT], axes: [x, z]}}     # a pin about y, the axis of all its hinges
  - {{name: right, frames: [FR_FOOT, HR_FOOT], axes: [x, z]}}
actuated: [FL_HFE, FL_KFE, FR_HFE, FR_KFE, HL_HFE, HL_KFE, HR_HFE, HR_KFE]
independent: {{joints: [FL_HFE, FR_HFE, HL_HFE, HR_HFE]}}
reference:
  joints: {{FL_HFE: 0.45, FR_HFE: 0.45, HL_HFE: -0.45, HR_HFE: -0.45}}
  guess: {{FL_KFE: 0.4, FR_KFE: 0.4, HL_KFE: -0.4, HR_KFE: -0.4}}     # feet below the knees
"""

START = (0.45, 0.45, -0.45, -0.45)
END = (0.2, 0.6, -0.7, -0.6)
"""Hip angles, rad, in the order of ``independent``."""


def solo_urdf() -> Path:
    """Return the path of Solo's URDF among the installed files of example-robot-data.

    Raises:
        PackageNotFoundError: it is not installed.
    """
    (paths,) = [file for file in files("example-robot-data") or () if file.name == "solo.urdf"]
    return Path(str(paths.locate())).resolve()


def load(folder: Path) -> Robot:
    """Write the declaration into a folder and load the robot."""
    declaration = folder / "robot.yaml"
    declaration.write_text(DECLARATION.format(urdf=solo_urdf()), encoding="utf-8")
    return rp.load_robot(declaration)


def swing() -> Trajectory:
    """Return half a second in which the hips turn, each by its own angle."""
    path = Line(START, END)
    return Trajectory(path, RestToRest(path.length, duration=0.5))


def main() -> None:
    """Print the torques, and the least ones the ties leave."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--html", help="file to write the motion to")
    chosen = options.parse_args()
    try:
        with tempfile.TemporaryDirectory() as folder:
            robot = load(Path(folder))
    except PackageNotFoundError:
        raise SystemExit("Solo's URDF is missing: pip install 'redundancy_pin[examples]'") from None
    motion = swing().sample(dt=0.002)
    reduced = rp.RneaDynamics(robot).reduce(motion)
    efforts = rp.distribute(reduced)  # eight motors, four freedoms: the torques of least norm
    for name, peak in zip(robot.actuated, np.abs(efforts.tau).max(axis=0), strict=True):
        print(f"{name}: {peak:.4f} N·m")
    print(f"smallest margin {efforts.margin.min():.4f}, largest residual of a tie {reduced.residual.max():.1e} m")
    if chosen.html:
        rp.show(robot, motion).save(chosen.html)


if __name__ == "__main__":
    main()
