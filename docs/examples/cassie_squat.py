"""A floating base on two legs of closed chains: Cassie squats on the edges of its feet.

Each leg is the model's own, its rods corrected (``cassie_leg.py``, beside this file): rods close a loop over knee and
shin and one over the ankle. Its springs are held. A foot touches the ground along the edge of its blade, at heel and
toe, and may roll about it: five closure rows a foot leave the trunk its six freedoms, which ten motors drive. What is
left of the choice keeps the forces at heels and toes in their friction cones. The SDF comes with ``pip install
'redundancy_pin[examples]'``.

Run it with ``python docs/examples/cassie_squat.py``.
"""

from __future__ import annotations

import tempfile
from importlib.metadata import PackageNotFoundError
from pathlib import Path

import numpy as np
import pinocchio as pin
from cassie_leg import BLADE, MOTORS, SIDES, SPRINGS, cassie_sdf

import redundancy_pin as rp
from redundancy_pin.dynamics.contacts import ClosureForces, closure_forces
from redundancy_pin.dynamics.distribution import Distribution
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot import Coupling, Platform, Robot

BENT = {
    **{"pitch-op": 0.6, "knee-op": -0.77, "shin-tarsus-joint": 0.77},
    **{"foot-op": -1.7, "tarsus-crank-joint": -1.7, "crank-rod-joint": 1.7},
}
"""rad, about where the joints of a leg are at the start; Newton's method closes the loops from there."""
CENTRE, ALONG, HALF = np.array(BLADE), np.array([np.cos(0.695), -np.sin(0.695), 0.0]), 0.08
"""Of the blade in its foot, as the collision shape of the file has it: middle, m, direction, half a length, m."""
CONTACTS = tuple(f"{side} {end}" for side in SIDES for end in ("heel", "toe"))
DEPTH, DURATION = 0.1, 1.0
"""How deep the squat goes, m, and how long it takes, s."""


def legs(names: tuple[str, ...]) -> tuple[str, ...]:
    """Return joints of a leg by their names on either side."""
    return tuple(f"{side}-{name}" for side in SIDES for name in names)


def load() -> Robot:
    """Return Cassie on its two feet, whose edges stay where they are at the start."""
    with tempfile.TemporaryDirectory() as folder:
        loaded = rp.load_robot(cassie_sdf(Path(folder)), base="free", actuated=legs(MOTORS))
    model, q = loaded.model.copy(), np.array(loaded.q_reference)
    for side in SIDES:
        for joint, angle in BENT.items():
            q[model.joints[model.getJointId(f"{side}-{joint}")].idx_q] = angle
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    feet = {side: model.frames[model.getFrameId(f"{side}-foot", pin.FrameType.BODY)] for side in SIDES}
    middle = np.mean([(data.oMi[foot.parentJoint] * foot.placement).act(CENTRE) for foot in feet.values()], axis=0)
    loops = [(each.name, [each.frame_a, each.frame_b], list(each.axes)) for each in loaded.closures]
    for side, foot in feet.items():
        width = data.oMi[foot.parentJoint].translation[1]
        for end, way, axes in (("heel", HALF, ["x", "y", "z"]), ("toe", -HALF, ["y", "z"])):
            ground, tip = f"ground {side} {end}", f"{side} {end} tip"
            place = pin.SE3(np.eye(3), np.array([-way, width, 0.0]))
            model.addFrame(pin.Frame(ground, 0, 0, place, pin.FrameType.BODY))
            point = foot.placement * pin.SE3(np.eye(3), CENTRE + way * ALONG)
            model.addFrame(pin.Frame(tip, foot.parentJoint, 0, point, pin.FrameType.BODY))
            loops.append((f"{side} {end}", [ground, tip], axes))
    middle[0] = pin.centerOfMass(model, data, q)[0]  # the trunk stands where its weight is over the feet
    pelvis = data.oMf[model.getFrameId("pelvis", pin.FrameType.BODY)].translation - middle * [1.0, 0.0, 1.0]
    single = [joint for joint in list(model.joints)[1:] if joint.nq == 1]  # the balls of the rods follow
    guess = {str(model.names[joint.id]): float(q[joint.idx_q]) for joint in single}
    guess |= {f"pelvis_{axis}": guess[f"pelvis_{axis}"] - float(middle[k]) for k, axis in ((0, "x"), (2, "z"))}
    standing = rp.robot_from_model(
        model,
        name="cassie_squat",
        closures=[{"name": name, "frames": frames, "axes": axes} for name, frames, axes in loops],
        couplings=[Coupling(f"{name} held", name, "", (0.0,)) for name in legs(SPRINGS)],
        actuated=legs(MOTORS),
        independent=Platform("pelvis", ("x", "y", "z", "rx", "ry", "rz")),
        reference={"platform": {"xyz": pelvis.tolist(), "rpy": [0.0, 0.0, 0.0]}, "guess": guess},
    )
    return standing.loaded(*loaded.loads)


def squat(robot: Robot, samples: int = 51) -> PlatformMotion:
    """Return one squat from the reference: the trunk goes down and up again, h (1 − cos ω t)."""
    t, w = np.linspace(0.0, DURATION, samples), 2.0 * np.pi / DURATION
    data = robot.model.createData()
    pin.framesForwardKinematics(robot.model, data, np.array(robot.q_reference))
    start = data.oMf[robot.model.getFrameId("pelvis", pin.FrameType.BODY)].homogeneous
    x, xd, xdd = np.tile(start, (samples, 1, 1)), np.zeros((samples, 6)), np.zeros((samples, 6))
    x[:, 2, 3] -= 0.5 * DEPTH * (1.0 - np.cos(w * t))
    xd[:, 2] = -0.5 * DEPTH * w * np.sin(w * t)
    xdd[:, 2] = -0.5 * DEPTH * w**2 * np.cos(w * t)
    return PlatformMotion(t, x, xd, xdd)


def efforts(robot: Robot, motion: PlatformMotion, friction: float) -> tuple[Distribution, ClosureForces]:
    """Return the least torques that keep forces at heels and toes in their cones, and these forces by the torques."""
    along = rp.RneaDynamics(robot).along(motion)
    feet = closure_forces(along)
    cones = [feet.friction_cone(contact, friction, least=2.0) for contact in CONTACTS]
    return rp.distribute(along.reduce(), rows=cones), feet


def main() -> None:
    """Print peaks of the torques and how near heels and toes come to slipping."""
    try:
        robot = load()
    except PackageNotFoundError:
        raise SystemExit("Cassie's SDF is missing: pip install 'redundancy_pin[examples]'") from None
    motion = squat(robot)
    for friction in (0.6, 0.02):
        tau, feet = efforts(robot, motion, friction)
        force = dict(zip(feet.names, feet.at(tau.tau).T, strict=True))
        least = min(force[f"z of {contact}"].min() for contact in CONTACTS)
        print(
            f"friction {friction}: largest torque {np.abs(tau.tau).max():.1f} N·m, least normal force {least:.1f} N, "
            f"{sorted(set(tau.status_labels.tolist()))}"
        )


if __name__ == "__main__":
    main()
