"""On-line plans of carriers elsewhere: in space and under gravity, on the end-effector, and on arms that turn."""

from functools import cache

import numpy as np
import pytest
import zoo
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.planners.receding_horizon import RecedingHorizon, run_online
from redundancy_pin.trajectory import Line, RestToRest, Trajectory

FOLLOWED = 1e-6
"""m and rad, of the machine's forward dynamics with the plan's efforts and carriers' forces; it is 1e-9 or less."""

MASSES = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}
RISE = Line((-0.04, 0.02, -0.25), (0.05, 0.0, -0.05))
"""Up through the plane of a delta's elbows, where weight acts along the lost direction."""


def arms(name, **masses):
    return rp.load_robot(name, arm_length=0.3, **masses)


CASES = {
    "gough": lambda: (rp.load_robot("gough", carriers=True), zoo.gough_crossing()),
    "delta": lambda: (
        rp.load_robot("delta", rod_length=0.35, rod_carriers=True),
        Trajectory(RISE, RestToRest(RISE.length, 0.5, "4-5-6-7")),
    ),
    "end-effector": lambda: (
        rp.load_robot("2rpr", carriers=False, end_effector_carriers=True, carrier_mass=0.8, end_effector_mass=0.5),
        rp.trajectory.reference.circle(speed=0.5),
    ),
    "arms": lambda: (arms("2rpr", **MASSES), rp.trajectory.reference.circle(speed=0.5)),
    "arms, corner": lambda: (arms("3rrr"), rp.trajectory.reference.corner()),
}


@cache
def run_of(name):
    robot, motion = CASES[name]()
    return robot, motion, run_online(RecedingHorizon(rp.CompiledDynamics(robot)), motion)


CROSSINGS = {"gough": 1, "delta": 1, "end-effector": 2, "arms": 2, "arms, corner": 0}


@pytest.mark.long_for("end-effector", "arms", "arms, corner")
@pytest.mark.parametrize("name", CASES)
def test_every_tick_is_planned_and_the_machine_follows(name):
    """Through the crossings that ``find_crossings`` knows, within limits between the samples too, and replayed."""
    robot, motion, run = run_of(name)
    assert run.counts["ok"] == len(run.commands) > 20
    # at the corner f jumps, and the samples before and after it do not show how far efforts go between them
    assert run.plan.status.value == ("unresolved" if name == "arms, corner" else "ok")
    known = [crossing.t for crossing in rp.find_crossings(robot, motion)]
    assert len(known) == CROSSINGS[name]
    np.testing.assert_allclose(run.plan.findings.singular_instants, known, atol=1e-8)
    t = np.linspace(run.plan.t[0], run.plan.t[-1], 4001)
    carriers = run.plan.carriers_at(t)
    assert np.ptp(carriers.s, axis=0).min() > 0.01
    for limit, s, sd, sdd in zip(robot.carrier_limits, carriers.s.T, carriers.sd.T, carriers.sdd.T, strict=True):
        assert limit.lower - 1e-8 <= s.min()
        assert s.max() <= limit.upper + 1e-8
        assert np.abs(sd).max() <= limit.speed * (1.0 + 1e-8)
        assert np.abs(sdd).max() <= limit.acceleration * (1.0 + 1e-6)
    replay = rp.simulate(robot, run.plan, dt=0.02, stop_at=())
    assert replay.status.value == "ok"
    planned = motion.sample_at(np.minimum(replay.t, motion.duration)).x
    if planned.ndim == 3:
        turned = Rotation.from_matrix(replay.x[:, :3, :3] @ planned[:, :3, :3].transpose(0, 2, 1)).magnitude()
        assert turned.max() < FOLLOWED
        np.testing.assert_allclose(replay.x[:, :3, 3], planned[:, :3, 3], atol=FOLLOWED)
    else:
        np.testing.assert_allclose(replay.x, planned, atol=FOLLOWED)


@pytest.mark.parametrize("name", ["gough", "delta"])
def test_without_carriers_to_help_the_weight_cannot_be_carried_there(name):
    """Parked carriers leave most of the weight's share along the lost direction, which plans remove."""
    robot, motion, run = run_of(name)
    (instant,) = (crossing.t for crossing in rp.find_crossings(robot, motion))
    at = np.array([instant])
    dynamics = rp.RneaDynamics(robot)
    lost = []
    for carriers in (None, run.plan.carriers_at(at)):
        reduced = dynamics.reduce(motion.sample_at(at), carriers)
        u = np.linalg.svd(reduced.W[0] / reduced.row_scale[:, None])[0][:, -1]
        lost.append(abs(u @ (reduced.f[0] / reduced.row_scale)))
    assert lost[0] > 1.0
    assert lost[1] < 1e-6 * lost[0]
