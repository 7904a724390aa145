"""Inverse dynamics of the 3-RRR with carriers: the same efforts of the same motion, by Pinocchio alone and by us."""

from functools import cache

import numpy as np
import pytest
from plain_loop import PlainLoop, smooth_motion

import redundancy_pin as rp

SAMPLES = 1000
BACKENDS = {"RNEA": rp.RneaDynamics, "virtual work": rp.VirtualWork, "generated C": rp.CompiledDynamics}
SAME = 1e-8
"""Of the largest effort."""


@cache
def work():
    """Return the robot, its motion, and the efforts by a plain loop of Pinocchio calls."""
    robot = rp.load_robot("3rrr")
    motion, carriers = smooth_motion(SAMPLES)
    return robot, motion, carriers, PlainLoop(robot).from_platform_motion(motion, carriers)


def timed(benchmark, action, rounds=5, iterations=1, units=SAMPLES):
    """Time an action that handles ``units`` samples, and return its result."""
    action()
    benchmark.extra_info["units"] = units
    return benchmark.pedantic(action, rounds=rounds, iterations=iterations)


@pytest.mark.benchmark(group="efforts from platform motion, 3-RRR with carriers, a sample")
@pytest.mark.parametrize("who", ["plain Pinocchio", *BACKENDS])
def test_from_platform_motion(benchmark, who):
    robot, motion, carriers, expected = work()
    if who == "plain Pinocchio":
        loop = PlainLoop(robot)
        tau = timed(benchmark, lambda: loop.from_platform_motion(motion, carriers))
    else:
        dynamics = BACKENDS[who](robot)
        tau = timed(benchmark, lambda: rp.distribute(dynamics.reduce(motion, carriers)).tau)
    assert np.abs(tau - expected).max() < SAME * np.abs(expected).max()


@pytest.mark.benchmark(group="efforts for new carriers on the same motion, 3-RRR, a sample")
@pytest.mark.parametrize("who", ["plain Pinocchio", *BACKENDS])
def test_new_carriers(benchmark, who):
    """The loop gets q, v and a; a backend has the motion of the platform closed."""
    robot, motion, carriers, expected = work()
    if who == "plain Pinocchio":
        loop, (q, v, a) = PlainLoop(robot), rp.RneaDynamics(robot).along(motion).tree_motion(carriers)
        tau = timed(benchmark, lambda: loop.from_tree_motion(q, v, a))
    else:
        along = BACKENDS[who](robot).along(motion)
        tau = timed(benchmark, lambda: rp.distribute(along.reduce(carriers)).tau)
    assert np.abs(tau - expected).max() < SAME * np.abs(expected).max()


@pytest.mark.benchmark(group="efforts asked sample after sample from Python, 3-RRR, a sample")
@pytest.mark.parametrize("who", ["plain Pinocchio", "RNEA", "generated C"])
def test_one_sample_after_another(benchmark, who):
    robot, motion, carriers, expected = work()
    if who == "plain Pinocchio":
        loop = PlainLoop(robot)
        tau = timed(benchmark, lambda: loop.from_platform_motion(motion, carriers))
    else:
        dynamics = BACKENDS[who](robot)
        rows = list(zip(motion.x, motion.xd, motion.xdd, carriers.s, carriers.sd, carriers.sdd, strict=True))
        tau = np.array(timed(benchmark, lambda: [dynamics.torque(*row).tau for row in rows]))
    assert np.abs(tau - expected).max() < SAME * np.abs(expected).max()
