"""Planners: least time beside toppra, and what a plan of each kind takes."""

import numpy as np
import path_timing
import pytest

import redundancy_pin as rp
from redundancy_pin.trajectory import reference

EFFORT = 3.03
MODE = {"working_mode": (1, 1, 1)}
WIDE = rp.Limits(effort=EFFORT, track=(-1.0, 1.0), speed=5.0, acceleration=20.0)
CIRCLE = reference.circle()


@pytest.mark.benchmark(group="least time round the corner of the 3-RRR, no carriers")
@pytest.mark.parametrize("who", ["toppra on 400 steps", "plan_time_optimal"])
def test_least_time(benchmark, who):
    bare, path = rp.VirtualWork(rp.load_robot("3rrr", carriers=False, **MODE)), reference.corner().path
    if who.startswith("toppra"):
        duration = benchmark.pedantic(path_timing.least_time, (bare, path, EFFORT), rounds=3)
    else:
        limits = rp.Limits(effort=EFFORT)
        duration = benchmark.pedantic(lambda: rp.plan_time_optimal(bare, path, limits=limits).t[-1], rounds=3)
    assert np.isclose(duration, path_timing.least_time(bare, path, EFFORT), rtol=1e-2)


PLANS = {
    "plan_stepwise, corner of the 3-RRR, 1.8 s": lambda: rp.plan_stepwise("3rrr", reference.corner().sample(0.005)),
    "plan_switch_off, circle of the 2-RPR, 2.7 s": lambda: rp.plan_switch_off("2rpr", CIRCLE, threshold=5.0),
    "plan_whole_trajectory, circle of the 2-RPR, 2.7 s": lambda: rp.plan_whole_trajectory(
        rp.load_robot("2rpr", end_effector_mass=0.5), CIRCLE
    ),
    "plan_time_optimal, corner of the 3-RRR with carriers": lambda: rp.plan_time_optimal(
        rp.load_robot("3rrr", carrier_mass=3.0, **MODE), reference.corner().path, limits=WIDE
    ),
}


@pytest.mark.benchmark(group="a plan")
@pytest.mark.parametrize("who", PLANS)
def test_plans(benchmark, who):
    PLANS[who]()
    assert len(benchmark.pedantic(PLANS[who], rounds=3).t)
