"""Two UR5 hold a bar and lift it: twelve motors for six freedoms, and a squeeze of 20 N along the bar.

The bar hangs on the left arm's tool, a weld closes the loop at the right one's: a shipped model of the gallery.

Run it with ``python docs/examples/two_arms.py``; with ``--html arms.html`` it also writes the motion to look at.
"""

from __future__ import annotations

import argparse

import numpy as np
import pinocchio as pin

import redundancy_pin as rp
from redundancy_pin.dynamics.contacts import closure_forces
from redundancy_pin.robot import Robot


def load() -> Robot:
    """Return the closed chain."""
    return rp.load_robot("two_arms")


def lift(robot: Robot, samples: int = 101) -> rp.PlatformMotion:
    """Return one second in which the bar goes up by 0.15 m and tilts by 0.2 rad."""
    x = rp.forward_kinematics(robot, robot.q_reference[None]).x[0]
    poses = np.array([x, x @ pin.SE3(pin.rpy.rpyToMatrix(0.2, 0.0, 0.0), np.array([0.0, 0.0, 0.15])).homogeneous])
    return rp.trajectory.from_points(poses, [0.0, 1.0], ends="rest").sample(1.0 / (samples - 1))


def torques(robot: Robot, motion: rp.PlatformMotion, squeeze: float) -> tuple[rp.Distribution, np.ndarray]:
    """Return the least torques (N, 12) that squeeze the bar, and the force and moment (N, 6) at the right tool."""
    along = rp.RneaDynamics(robot).along(motion)
    grip = closure_forces(along)
    rows = grip.rows(-grip.component("grip", "y"), squeeze, squeeze)  # of the bar's end on the right tool, outward
    distribution = rp.distribute(along.reduce(), rows=[rows])
    return distribution, grip.at(distribution.tau)


def main() -> None:
    """Print the largest torques, with the squeeze and without."""
    options = argparse.ArgumentParser(description=__doc__)
    options.add_argument("--html", help="file to write the motion to")
    chosen = options.parse_args()
    robot = load()
    motion = lift(robot)
    for squeeze in (0.0, 20.0):
        efforts, wrench = torques(robot, motion, squeeze)
        print(
            f"squeezed by {-wrench[:, 1].mean():.1f} N: largest torque {np.abs(efforts.tau).max():.2f} N·m, "
            f"largest moment at the right tool {np.linalg.norm(wrench[:, 3:], axis=1).max():.2f} N·m"
        )
    if chosen.html:
        rp.show(robot, motion).save(chosen.html)


if __name__ == "__main__":
    main()
