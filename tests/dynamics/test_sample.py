"""One sample after another: the numbers of a whole motion, on its branch, or a refusal by name."""

from __future__ import annotations

import copy
import pickle
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from folding import folding_four_bar, joint, rocker_angle

from redundancy_pin import CarrierMotion, PlatformMotion, VirtualWork
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.errors import InputError, SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.robot import Robot

FOLDING = (0.4, 0.2, 0.35, 0.25)
GUESS = (1.0, 1.9, 1.5)


def asked_one_by_one(dynamics: Dynamics, motion: PlatformMotion, carriers: CarrierMotion | None = None) -> list[Any]:
    samples: list[Any] = []
    for k in range(len(motion)):
        tracks = (carriers.s[k], carriers.sd[k], carriers.sdd[k]) if carriers is not None else ()
        start = {"start": samples[-1]} if samples and isinstance(dynamics, RneaDynamics) else {}
        samples.append(dynamics.sample(motion.x[k], motion.xd[k], motion.xdd[k], *tracks, **start))
    return samples


def assert_same(samples: list[Any], whole: Any) -> None:
    for name in ("W", "f", "carrier_force"):
        expected = getattr(whole, name)
        got = np.array([getattr(sample, name) for sample in samples])
        np.testing.assert_allclose(got, expected, rtol=0.0, atol=1e-10 * max(1.0, np.abs(expected).max(initial=0.0)))


def test_samples_along_a_motion_are_those_of_the_motion(shipped: Robot) -> None:
    t = np.linspace(0.0, 1.0, 41)
    motion, carriers = zoo.smooth_motion(shipped, 13).at(t), zoo.carriers_at(shipped, t)
    dynamics = RneaDynamics(shipped)
    whole = dynamics.reduce(motion, carriers)
    assert_same(asked_one_by_one(dynamics, motion, carriers), whole)
    cold = [
        dynamics.sample(motion.x[k], motion.xd[k], motion.xdd[k], carriers.s[k], carriers.sd[k], carriers.sdd[k])
        for k in (0, 20, 40)
    ]
    assert_same(cold, replace(whole, W=whole.W[::20], f=whole.f[::20], carrier_force=whole.carrier_force[::20]))
    assert all(sample.gap < 1e-11 for sample in cold)


def test_closed_forms_answer_for_one_sample_too() -> None:
    robot = zoo.robot_of("3rrr")
    t = np.linspace(0.0, 1.0, 5)
    motion = zoo.smooth_motion(robot, 13).at(t)
    assert_same(asked_one_by_one(VirtualWork(robot), motion), RneaDynamics(robot).reduce(motion))


def crank_motion(crank: np.ndarray) -> PlatformMotion:
    size = (len(crank), 1)
    t = np.arange(len(crank)) * 0.01
    return PlatformMotion(t, crank[:, None], np.full(size, 2.0), np.full(size, 0.7), check_rates=False)


@pytest.mark.parametrize("modes", [False, True])
@pytest.mark.parametrize("offsets", [np.linspace(-1.0, 1.0, 101), np.linspace(-1.0, 1.0, 10) + 0.033])
def test_samples_go_through_a_rank_loss_of_the_closures(offsets: np.ndarray, modes: bool, tmp_path: Path) -> None:
    robot = folding_four_bar(tmp_path, FOLDING, GUESS, modes=modes)
    motion = crank_motion(np.pi + offsets)
    dynamics = RneaDynamics(robot)
    samples = asked_one_by_one(dynamics, motion)
    whole = dynamics.reduce(motion)
    np.testing.assert_allclose([s.f for s in samples], whole.f, rtol=0.0, atol=1e-7 * np.abs(whole.f).max())
    home = robot.q_reference
    sign = min(
        (1.0, -1.0),
        key=lambda one: abs(np.sin((rocker_angle(FOLDING, one)(home[:1])[0] - home[joint(robot, "rocker")]) / 2)),
    )
    reached = np.array([sample.state.q[joint(robot, "rocker")] for sample in samples])
    off = np.sin((reached - rocker_angle(FOLDING, sign)(motion.x[:, 0])) / 2.0)
    assert np.abs(off).max() < 1e-12


@pytest.mark.parametrize("excess", [1e-2, 1e-4, 1e-6, 1e-8])
def test_samples_do_not_jump_to_a_branch_that_all_but_touches(excess: float, tmp_path: Path) -> None:
    robot = folding_four_bar(tmp_path, (*FOLDING[:3], FOLDING[3] + excess), GUESS)
    coupler = joint(robot, "coupler")
    samples = asked_one_by_one(RneaDynamics(robot), crank_motion(np.linspace(np.pi - 0.5, np.pi + 0.5, 101)))
    assert len({float(np.sign(np.sin(sample.state.q[coupler]))) for sample in samples}) == 1


def test_a_start_decides_the_branch(tmp_path: Path) -> None:
    """Behind a rank loss the branch that was followed and that of the reference are two."""
    robot = folding_four_bar(tmp_path, FOLDING, GUESS)
    dynamics = RneaDynamics(robot)
    motion = crank_motion(np.linspace(np.pi - 0.5, np.pi + 0.5, 51))
    through = asked_one_by_one(dynamics, motion)[-1]
    again = dynamics.sample(motion.x[-1], motion.xd[-1], motion.xdd[-1], start=through)
    np.testing.assert_allclose(again.state.q, through.state.q, rtol=0.0, atol=1e-12)
    other = folding_four_bar(tmp_path, FOLDING, (GUESS[0] + 4.0, GUESS[1] + 3.0, GUESS[2]))
    elsewhere = RneaDynamics(other).sample(motion.x[-1], motion.xd[-1], motion.xdd[-1])
    assert np.abs(np.sin((elsewhere.state.q - through.state.q) / 2.0)).max() > 1e-3
    kept = dynamics.sample(motion.x[-1], motion.xd[-1], motion.xdd[-1], start=elsewhere)
    np.testing.assert_allclose(kept.state.q, elsewhere.state.q, rtol=0.0, atol=1e-12)


def test_what_is_out_of_reach_singular_or_behind_the_border_is_refused_by_name() -> None:
    robot = zoo.robot_of("five_bar")
    dynamics, still = RneaDynamics(robot), np.zeros(2)
    home = zoo.home_of(robot)
    start = dynamics.sample(home, still, still)
    for given in (None, start):
        with pytest.raises(UnreachablePoseError) as caught:
            dynamics.sample(home + 50.0, still, still, start=given)
        assert caught.value.details["sample"] == 0
    legs = 2
    assert len(robot.working_mode) == legs
    flipped = zoo.robot_of("five_bar", working_mode=tuple(-sign for sign in robot.working_mode))
    other = RneaDynamics(flipped).sample(home, still, still)
    same = dynamics.sample(home, still, still, start=other)  # a start has its own mode
    np.testing.assert_allclose(same.state.q, other.state.q, rtol=0.0, atol=1e-12)


def test_a_line_that_leaves_the_workspace_is_no_way(tmp_path: Path) -> None:
    lengths = (0.4, 0.3, 0.2, 0.25)
    robot = folding_four_bar(tmp_path, lengths, (1.0, 2.0, 1.5))
    limit = np.arccos((0.4**2 + 0.3**2 - 0.45**2) / (2 * 0.4 * 0.3))
    dynamics = RneaDynamics(robot)
    start = dynamics.sample([1.0], [0.0], [0.0])
    with pytest.raises((SingularPoseError, UnreachablePoseError)):
        dynamics.sample([limit], [0.0], [0.0], start=start)
    with pytest.raises(WorkingModeError, match="cannot be reached continuously"):
        dynamics.sample([2.0 * np.pi - 1.0], [0.0], [0.0], start=start)


@pytest.mark.parametrize(
    "change",
    [
        {"x": [0.1, np.nan, 0.0]},
        {"x": [0.1, 0.2]},
        {"x": "here"},
        {"xd": [np.inf, 0.0, 0.0]},
        {"xdd": [[0.0, 0.0, 0.0]]},
        {"s": [0.0]},
        {"sdd": [np.nan] * 3},
        {"start": 3},
    ],
    ids=str,
)
def test_malformed_samples_are_refused(change: dict[str, Any]) -> None:
    robot = zoo.robot_of("3rrr")
    given = {"x": zoo.home_of(robot), "xd": np.zeros(3), "xdd": np.zeros(3), **change}
    with pytest.raises(InputError):
        RneaDynamics(robot).sample(**given)


def test_samples_can_be_copied_and_sent_and_are_read_only() -> None:
    robot = zoo.robot_of("3rrr")
    dynamics = RneaDynamics(robot)
    x = zoo.home_of(robot)
    one = dynamics.sample(x, np.ones(3), np.ones(3))
    for again in (copy.copy(one), copy.deepcopy(one), pickle.loads(pickle.dumps(one))):
        nearby = dynamics.sample(x + 1e-3, np.ones(3), np.ones(3), start=again)
        np.testing.assert_array_equal(nearby.f, dynamics.sample(x + 1e-3, np.ones(3), np.ones(3), start=one).f)
        for array in (again.W, again.f, again.carrier_force, again.state.x, again.state.q, again.state.gamma):
            assert not array.flags.writeable


def test_threads_do_not_disturb_each_other() -> None:
    robot = zoo.robot_of("3rrr")
    dynamics = RneaDynamics(robot)
    motion = zoo.smooth_motion(robot, 13).at(np.linspace(0.0, 1.0, 41))
    whole = dynamics.reduce(motion)
    with ThreadPoolExecutor(4) as pool:
        for samples in pool.map(lambda _: asked_one_by_one(dynamics, motion), range(8)):
            assert_same(samples, whole)
