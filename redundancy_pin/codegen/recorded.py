"""What the test program of generated C expects: samples of a motion through the RNEA backend, not the same code."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.arguments import require_matching_carriers
from redundancy_pin.dynamics.distribution import Distribution, distribute
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.errors import InputError, SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import moved
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_sampled
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale

SAMPLES = 200
"""Samples at most, of which a test program holds some 60 numbers each."""

_REACH = 0.15
"""Excursion about the reference, in characteristic lengths, that is tried first."""

_SMALLEST = 1e-4
"""Excursion at which it is given up."""


@dataclass(frozen=True, eq=False)
class Recorded:
    """N samples and what is expected at them.

    Attributes:
        motion: x (N, n) or (N, 4, 4), xd and xdd (N, n).
        carriers: s, sd and sdd (N, k).
        reduced: W, f, carrier forces.
        efforts: τ and statuses, whether joints are in their ranges or not.
        type_I_margin: (N,) lower bound of the scaled distance to a type I singularity.
        closure: (r, nv) closure Jacobian at the first sample.
        gamma: (nv, n) Γ there.
        position: (N, m) positions of the main actuators, m and rad.
        velocity: (N, m) their rates, m/s and rad/s.
    """

    motion: tuple[Array, Array, Array]
    carriers: tuple[Array, Array, Array]
    reduced: ReducedDynamics
    efforts: Distribution
    type_I_margin: Array
    closure: Array
    gamma: Array
    position: Array
    velocity: Array

    def __len__(self) -> int:
        """Return the number of samples."""
        return len(self.position)


def record(robot: Robot, motion: PlatformMotion | None, carriers: CarrierMotion | None) -> Recorded:
    """Return what the RNEA backend says along a motion, or along a random one about the reference.

    Raises:
        InputError: the motion does not fit the robot, or no sample of it can be reached.
    """
    if motion is None:
        motion, carriers = _random_motion(robot)
    require_sampled(motion)
    carriers = require_matching_carriers(robot, carriers, len(motion))
    whole = RneaDynamics(robot).along(motion, unreachable="mark").reduce(carriers)
    reachable = np.flatnonzero(whole.reachable)
    if not len(reachable):
        raise InputError(f"No sample of the motion can be reached by {robot.name}.", remedy="Move it.")
    # the whole motion is lifted, which is followed from sample to sample; some of it is kept
    tree = inverse_kinematics(robot, motion, mark_unreachable=True)
    kept = reachable[np.unique(np.linspace(0, len(reachable) - 1, SAMPLES).round().astype(int))]
    reduced = whole.at(kept)
    return Recorded(
        motion=(motion.x[kept], motion.xd[kept], motion.xdd[kept]),
        carriers=(carriers.s[kept], carriers.sd[kept], carriers.sdd[kept]),
        reduced=reduced,
        efforts=distribute(replace(reduced, out_of_range=None)),  # the C knows no ranges of joints and tracks
        type_I_margin=tree.serial_margin_bound[kept],
        closure=ConstraintSystem(robot).evaluate(tree.q[kept[:1]]).Jc[0],
        gamma=tree.gamma[kept[0]],
        position=robot.joint_positions(tree.q[kept]),
        velocity=np.einsum("Nij,Ni->Nj", reduced.W, motion.xd[kept]),
    )


def _random_motion(robot: Robot) -> tuple[PlatformMotion, CarrierMotion]:
    """Return a closed path about the reference with random rates, as far out as the robot can follow."""
    random = np.random.default_rng(0)
    home = follower(robot).home.x[None]
    t = np.linspace(0.0, 2.0, SAMPLES)
    angles = np.outer(t, [2.0 * np.pi, 3.0 * np.pi])[:, :, None] + random.uniform(0.0, 2.0 * np.pi, (2, robot.n))
    path = (random.uniform(0.2, 0.5, (2, robot.n)) * np.sin(angles)).sum(axis=1)
    length, scale = robot.characteristic_length, row_scale(robot)
    xd, xdd = (size * length / scale * random.uniform(-1.0, 1.0, path.shape) for size in (2.0, 20.0))
    reach = _REACH * length
    while True:
        motion = PlatformMotion(t, moved(robot, np.repeat(home, len(t), axis=0), path * reach / scale), xd, xdd)
        try:
            inverse_kinematics(robot, motion)
            break
        except (UnreachablePoseError, SingularPoseError, WorkingModeError):
            reach *= 0.5
            if reach < _SMALLEST * length:
                raise
    half = np.array([min(-limits.lower, limits.upper) for limits in robot.carrier_limits])
    half = np.where(np.isfinite(half), np.maximum(half, 0.0), length)
    s, sd, sdd = (size * half * random.uniform(-1.0, 1.0, (len(t), robot.k)) for size in (1.0, 5.0, 50.0))
    return motion, CarrierMotion(s, sd, sdd)
