"""A floating base: the quadruped Solo squats, its feet held to the ground by friction alone.

The trunk floats, the feet are pinned by closures, and twelve motors drive the six freedoms of the trunk. What is left
of the choice keeps the force at each foot inside its friction cone: rows of one quadratic program a sample. The URDF
comes with ``pip install 'redundancy_pin[examples]'`` and is used as it is.

Run it with ``python docs/examples/solo_squat.py``; with ``--html solo.html`` it also writes the motion to look at.
"""

from __future__ import annotations

import argparse
from importlib.metadata import PackageNotFoundError, files
from pathlib import Path

import numpy as np
import pinocchio as pin

import redundancy_pin as rp
from redundancy_pin.dynamics.contacts import ClosureForces, closure_forces
from redundancy_pin.dynamics.distribution import Distribution
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Platform, Robot

LEGS = ("FL", "FR", "HL", "HR")
JOINTS = tuple(f"{leg}_{joint}" for leg in LEGS for joint in ("HAA", "HFE", "KFE"))
HEIGHT, DEPTH, DURATION = 0.3, 0.06, 0.5
"""Of the trunk at the start, m; how deep the squat goes, m; and how long it takes, s."""


def solo_urdf() -> Path:
    """Return the path of Solo's URDF among the installed files of example-robot-data.

    Raises:
        PackageNotFoundError: it is not installed.
    """
    paths = [file for file in files("example-robot-data") or () if file.name == "solo12.urdf"]
    return Path(str(paths[0].locate())).resolve()


def load() -> Robot:
    """Return Solo on its four feet, which stay where they are at the start."""
    model = pin.buildModelFromUrdf(str(solo_urdf()), pin.JointModelFreeFlyer())
    q = pin.neutral(model)
    q[2] = HEIGHT
    for leg in LEGS:  # knees point to the middle
        side = 1.0 if leg.startswith("F") else -1.0
        for joint, angle in (("HFE", 0.7), ("KFE", -1.4)):
            q[model.joints[model.getJointId(f"{leg}_{joint}")].idx_q] = side * angle
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    for leg in LEGS:
        place = data.oMf[model.getFrameId(f"{leg}_FOOT")].translation.copy()
        model.addFrame(pin.Frame(f"ground_{leg}", 0, 0, pin.SE3(np.eye(3), place), pin.FrameType.BODY))
    return rp.robot_from_model(
        model,
        name="solo_squat",
        closures=[{"name": leg, "frames": [f"ground_{leg}", f"{leg}_FOOT"], "axes": ["x", "y", "z"]} for leg in LEGS],
        actuated=JOINTS,
        independent=Platform("base_link", ("x", "y", "z", "rx", "ry", "rz")),
        reference=q,
    )


def squat(samples: int = 101) -> PlatformMotion:
    """Return one squat: the trunk goes down and up again, h (1 − cos ω t)."""
    t, w = np.linspace(0.0, DURATION, samples), 2.0 * np.pi / DURATION
    x, xd, xdd = np.tile(np.eye(4), (samples, 1, 1)), np.zeros((samples, 6)), np.zeros((samples, 6))
    x[:, 2, 3] = HEIGHT - 0.5 * DEPTH * (1.0 - np.cos(w * t))
    xd[:, 2] = -0.5 * DEPTH * w * np.sin(w * t)
    xdd[:, 2] = -0.5 * DEPTH * w**2 * np.cos(w * t)
    return PlatformMotion(t, x, xd, xdd)


def efforts(robot: Robot, motion: PlatformMotion, friction: float) -> tuple[Distribution, ClosureForces]:
    """Return the least torques that keep every foot's force inside its cone, and the feet's forces by the torques."""
    along = rp.RneaDynamics(robot).along(motion)
    feet = closure_forces(along)
    cones = [feet.friction_cone(leg, friction, least=0.5) for leg in LEGS]
    return rp.distribute(along.reduce(), rows=cones), feet


def main() -> None:
    """Print peaks of the torques and how near the feet come to slipping."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--html", help="file to write the motion to")
    chosen = options.parse_args()
    try:
        robot, motion = load(), squat()
    except PackageNotFoundError:
        raise SystemExit("Solo's URDF is missing: pip install 'redundancy_pin[examples]'") from None
    for friction in (0.6, 0.2):
        tau, feet = efforts(robot, motion, friction)
        force = feet.at(tau.tau).reshape(len(motion), len(LEGS), 3)
        slip = np.linalg.norm(force[:, :, :2], axis=2) / force[:, :, 2]
        print(
            f"friction {friction}: largest torque {np.abs(tau.tau).max():.3f} N·m, tangential over normal force up "
            f"to {slip.max():.3f}, {sorted(set(tau.status_labels.tolist()))}"
        )
    if chosen.html:
        rp.show(robot, motion).save(chosen.html)


if __name__ == "__main__":
    main()
