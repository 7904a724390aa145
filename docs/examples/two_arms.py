"""Two UR5 hold a bar and lift it: twelve motors for six freedoms, and a squeeze of 20 N along the bar.

The bar hangs on the left arm's tool, a weld closes the loop at the right one's. The URDF comes with
``pip install 'redundancy_pin[examples]'`` and is used as it is.

Run it with ``python docs/examples/two_arms.py``; with ``--html arms.html`` it also writes the motion to look at.
"""

from __future__ import annotations

import argparse
from importlib.metadata import PackageNotFoundError, files

import numpy as np
import pinocchio as pin

import redundancy_pin as rp
from redundancy_pin.dynamics.contacts import closure_forces
from redundancy_pin.robot import Platform, Robot

ARM = (0.0, -1.4, 1.9, -2.07, -1.57, 0.0)
"""Joint angles of both arms at the start, rad: tools down."""

BAR, APART = 2.0, 0.9
"""Mass of the bar, kg, and distance between the arms, m."""


def two_arms() -> tuple[pin.Model, np.ndarray]:
    """Return both arms side by side, the bar on the left tool, frames ``bar``, ``bar_end``, ``right_tool``; and q."""
    (found,) = [file for file in files("example-robot-data") or () if file.name == "ur5_robot.urdf"]
    model = pin.Model()
    for side, y in (("left", 0.5), ("right", -0.5)):
        arm = pin.buildModelFromUrdf(str(found.locate()))
        for i in range(1, arm.njoints):
            arm.names[i] = f"{side}_{arm.names[i]}"
        for frame in arm.frames:
            frame.name = f"{side}_{frame.name}"
        model = pin.appendModel(model, arm, 0, pin.SE3(np.eye(3), np.array([0.0, y * APART, 0.0])))
    model.name, q, data = "two_arms", np.array(2 * ARM), model.createData()
    pin.framesForwardKinematics(model, data, q)
    left, right = (data.oMf[model.getFrameId(f"{side}_tool0")] for side in ("left", "right"))
    middle = pin.SE3(np.eye(3), 0.5 * (left.translation + right.translation))
    wrist = model.frames[model.getFrameId("left_tool0")].parentJoint
    inside = data.oMi[wrist].inverse()
    along_y = pin.Inertia(BAR, np.zeros(3), BAR / 12.0 * APART**2 * np.diag([1.0, 0.0, 1.0]))
    model.appendBodyToJoint(wrist, along_y, inside * middle)
    for name, place in (("bar", middle), ("bar_end", pin.SE3(np.eye(3), right.translation))):
        model.addFrame(pin.Frame(name, wrist, 0, inside * place, pin.FrameType.BODY))
    wrist = model.frames[model.getFrameId("right_tool0")].parentJoint
    tool = data.oMi[wrist].inverse() * pin.SE3(np.eye(3), right.translation)
    model.addFrame(pin.Frame("right_tool", wrist, 0, tool, pin.FrameType.BODY))
    return model, q


def load() -> Robot:
    """Return the closed chain."""
    model, q = two_arms()
    axes = ("x", "y", "z", "rx", "ry", "rz")
    return rp.Robot.from_model(
        model,
        closures=[{"name": "grip", "frames": ["bar_end", "right_tool"], "axes": list(axes)}],
        actuated=list(model.names)[1:],
        independent=Platform("bar", axes),
        reference=q,
    )


def lift(robot: Robot, samples: int = 101) -> rp.PlatformMotion:
    """Return one second in which the bar goes up by 0.15 m and tilts by 0.2 rad."""
    x = rp.forward_kinematics(robot, np.array([2 * ARM])).x[0]
    poses = np.array([x, x @ pin.SE3(pin.rpy.rpyToMatrix(0.2, 0.0, 0.0), np.array([0.0, 0.0, 0.15])).homogeneous])
    return rp.trajectory.from_points(poses, [0.0, 1.0]).sample(1.0 / (samples - 1))


def torques(robot: Robot, motion: rp.PlatformMotion, squeeze: float) -> tuple[rp.Distribution, np.ndarray]:
    """Return the least torques (N, 12) that squeeze the bar, and the force and moment (N, 6) at the right tool."""
    along = rp.RneaDynamics(robot).along(motion)
    grip = closure_forces(along)
    rows = grip.rows(-grip.component("grip", "y"), squeeze, squeeze)  # of the bar's end on the right tool, outward
    found = rp.distribute(along.reduce(), rows=[rows])
    return found, grip.at(found.tau)


def main() -> None:
    """Print the largest torques, with the squeeze and without."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--html", help="file to write the motion to")
    chosen = options.parse_args()
    try:
        robot = load()
    except (PackageNotFoundError, ValueError):
        raise SystemExit("The UR5's URDF is missing: pip install 'redundancy_pin[examples]'") from None
    motion = lift(robot)
    for squeeze in (0.0, 20.0):
        found, wrench = torques(robot, motion, squeeze)
        print(
            f"squeezed by {-wrench[:, 1].mean():.1f} N: largest torque {np.abs(found.tau).max():.2f} N·m, "
            f"largest moment at the right tool {np.linalg.norm(wrench[:, 3:], axis=1).max():.2f} N·m"
        )
    if chosen.html:
        rp.show(robot, motion).save(chosen.html)


if __name__ == "__main__":
    main()
