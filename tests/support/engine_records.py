"""What an outside engine's motion would measure: friction at the motors, noise of efforts, encoders with steps."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import zoo
from engines import drive_of_motion, run_exudyn, run_mujoco
from measured import built, declared, noisy

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.identification import Fit, Records, chain_regressor
from redundancy_pin.robot import Robot

MACHINES = ("five_bar", "delta", "gough", "3rrr")
"""Five-bar and 3-RRR with carriers."""


@dataclass(frozen=True, eq=False)
class Measured:
    """A machine as declared and as built, and what was measured of its motion in an engine, without noise."""

    given: Robot
    true: Robot
    exact: Records


LONGEST = {"gough": 2.2}
"""Time, s, for which a machine stays near its motion without control; this one loses it within 3 s."""


def engine_records(name: str, engine: str, seconds: float = 3.0, every: int = 4, seed: int = 0) -> Measured:
    """Return records of a machine that an engine moves by efforts alone, nothing controls it.

    The engine's machine has no friction: that of its motors, which it does not move by, is added to the efforts that
    they are measured to have, at the speeds that the engine computes. Samples are 1 ms times ``every`` apart.
    """
    given = declared(name)
    true = built(given)
    bare = replace(true, loads=tuple(load for load in true.loads if not isinstance(load, rp.JointForces)))
    t = np.arange(0.0, min(seconds, LONGEST.get(name, seconds)) + 5e-3, 0.01)
    path = zoo.smooth_motion(true, seed=seed, speed=8.0)
    drive = drive_of_motion(rp.RneaDynamics(bare), path.at(t), lambda times: zoo.carriers_at(true, times, seed))
    run = (run_mujoco if engine == "mujoco" else run_exudyn)(drive.task, step=1e-3)
    effort = np.array(drive.task.efforts(run.t))
    for j, joint in enumerate((*true.actuated, *true.carriers)):
        load = next(one for one in true.loads if isinstance(one, rp.JointForces) and one.joint == joint)
        column = true.model.joints[true.model.getJointId(joint)].idx_v
        effort[:, j] += load.resistance(np.zeros(len(run.t)), run.v[:, column])
    kept = slice(None, None, every)
    carried = {"carriers": run.s[kept], "carrier_force": effort[kept, true.m :]} if true.k else {}
    return Measured(
        given, true, Records(run.t[kept], effort[kept, : true.m], true.joint_positions(run.q)[kept], **carried)
    )


def with_noise(measured: Measured, seed: int) -> Records:
    """Return the records with 5 % of white noise and encoders of 17 bits."""
    return noisy(measured.exact, seed)


def efforts_of(robot: Robot, fit: Fit | None = None, seed: int = 9) -> Array:
    """Return (N, m) the efforts of a motion that no record holds.

    With the ``fit`` of a robot as given those of its base parameters, whatever bodies ``fit.robot`` would have.
    """
    t = np.linspace(0.0, 3.0, 90)
    motion, carriers = zoo.smooth_motion(robot, seed=seed, speed=8.0).at(t), zoo.carriers_at(robot, t, seed)
    along = rp.RneaDynamics(robot).along(motion)
    reduced = along.reduce(carriers)
    f = np.array(reduced.f)
    if fit is not None:
        Y = chain_regressor(along, [fit.base.parameters[k] for k in fit.base.independent], carriers)[:, : robot.n]
        f += Y @ (fit.values - fit.base.combination @ fit.base.standard)
    return np.asarray(np.linalg.solve(reduced.W, f[..., None])[..., 0])
