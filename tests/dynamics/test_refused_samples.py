"""Samples that compiled code does not follow: the follower follows them, or their status says why it does not."""

from __future__ import annotations

import numpy as np
import pytest
import zoo
from examples import FACTOR
from flat_linkages import parallelogram
from machines import machine

import redundancy_pin as rp
from redundancy_pin.kinematics import branch
from redundancy_pin.kinematics.branch import Follower
from redundancy_pin.machine_code import find_compiler
from redundancy_pin.status import SampleStatus

pytestmark = pytest.mark.skipif(find_compiler() is None, reason="there is no C compiler")


@pytest.fixture
def work(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What kinematics do: their steps along branches, and searches by Newton's method."""
    done: list[str] = []
    step, assemble = Follower.step, branch.assemble
    monkeypatch.setattr(Follower, "step", lambda *given: (done.append("step"), step(*given))[1])
    monkeypatch.setattr(branch, "assemble", lambda *given: (done.append("search"), assemble(*given))[1])
    return done


BEYOND = {"2rpr": [-0.6, 0.6], "3rrr": [0.6, 0.6, 0.6], "five_bar": [0.6, -0.6]}
"""From the reference to where no pose is: of the 2-RPR and the five-bar a triangle's side is longer than the others."""


@pytest.mark.parametrize("name", BEYOND)
def test_set_points_out_of_reach_have_the_answer_of_forward_kinematics(name: str, work: list[str]) -> None:
    """Noise on set-points beyond the reach, each with another velocity; encoders in counts, a glitch.

    The follower takes steps of 0.04 rad or characteristic lengths to where the branch ends. A set-point that is held
    costs no more kinematics, one that is far away none at all.
    """
    robot, dynamics, random = machine(name), rp.CompiledDynamics(machine(name)), np.random.default_rng(2)
    home = np.array(robot.q_reference)
    at, away = robot.joint_positions(home), np.array(BEYOND[name])
    dynamics.joint_state(at, start=home)
    for _ in range(4 * FACTOR):
        work.clear()
        near = at + away + 1e-3 * random.normal(size=robot.m)
        got = dynamics.joint_state(near, random.normal(size=robot.m))
        assert 0 < len(work) < 60
        work.clear()
        held = dynamics.joint_state(near, random.normal(size=robot.m))
        far = dynamics.joint_state(at + away * 10.0 ** random.uniform(3.5, 8.0), random.normal(size=robot.m))
        assert not work
        want = rp.forward_kinematics(robot, near)
        assert got.status is held.status is SampleStatus(int(want.status[0])) is SampleStatus.UNREACHABLE
        assert got.residual == held.residual > 1e-3
        assert far.status is SampleStatus.BRANCH_LOST
        assert np.isnan(far.residual)
        assert np.isnan([*got.q, *held.q, *far.q]).all()
    assert dynamics.joint_state(at, start=home).status is SampleStatus.OK


@pytest.mark.parametrize("name", ["five_bar", "delta"])
def test_far_set_points_are_those_that_forward_kinematics_reach(name: str, work: list[str]) -> None:
    """Motors turn by rad at once, through type I singularities too; the C follows no branch through those."""
    robot, dynamics, random = machine(name), rp.CompiledDynamics(machine(name)), np.random.default_rng(7)
    home, beyond = np.array(robot.q_reference), 0
    for _ in range(6 * FACTOR):
        position = robot.joint_positions(home) + 2.0 * random.normal(size=robot.m)
        work.clear()
        got = dynamics.joint_state(position, start=home)
        asked = bool(work)
        want = rp.forward_kinematics(robot, position)
        assert got.status.solved == want.known[0]
        if want.known[0]:
            beyond += asked
            np.testing.assert_allclose(got.q, want.q[0], rtol=0.0, atol=1e-8)
            np.testing.assert_allclose(got.x, want.x[0], rtol=0.0, atol=1e-8)
        else:
            assert got.status in (SampleStatus.UNREACHABLE, SampleStatus.BRANCH_LOST)
    assert beyond


@pytest.mark.parametrize("backend", [rp.CompiledDynamics, rp.RneaDynamics])
def test_several_joints_are_not_followed_over_many_turns(
    backend: type[rp.CompiledDynamics] | type[rp.RneaDynamics],
) -> None:
    """A parallelogram and another one beside it, cranks as coordinates; RNEA walked for minutes."""
    robot = zoo.driven_by(parallelogram("second"), "crank_0", "second_0")
    dynamics, home, zero = backend(robot), zoo.home_of(robot), np.zeros(2)
    for away, status in ((2.0, "ok"), (19.0, "ok"), (40.0, "branch_lost"), (1e9, "branch_lost"), (19.0, "ok")):
        got = dynamics.torque(home + np.array([away, 0.0]), zero, zero, start=robot.q_reference)
        assert got.status.label == status
        assert np.isfinite(got.tau).all() == (status == "ok")


def test_legs_that_make_no_triangle_are_unreachable() -> None:
    """The base of the 2-RPR is half a metre long; its legs may have any length, of either sign."""
    robot, dynamics, random = machine("2rpr"), rp.CompiledDynamics(machine("2rpr")), np.random.default_rng(11)
    legs, home = robot.joint_positions(robot.q_reference), np.array(robot.q_reference)
    apart = 0
    for position in legs + random.normal(size=(16, 2)) * random.uniform(0.1, 2.0, (16, 1)):
        got, (a, b) = dynamics.joint_state(position, start=home), np.abs(position)
        if a + b < 0.5 or abs(a - b) > 0.5:
            apart += 1
            assert got.status is SampleStatus.UNREACHABLE
            assert got.residual > 0.0
    assert 4 <= apart <= 12


def test_steps_that_newton_misses_are_halved_before_a_set_point_is_out_of_reach() -> None:
    """The straight way of the motors of a 3-RRR to positions that two halves of it lead to."""
    sizes = {"base_radius": 1.0547846749285816, "platform_radius": 0.22697867137638703,
             "proximal_length": 0.8163894095744779, "distal_length": 0.8066110542114117}  # fmt: skip
    robot = rp.load_robot("3rrr", **sizes, carriers=False, working_mode=(1, -1, 1))
    dynamics = rp.CompiledDynamics(robot)
    start = np.array([1.549025913101081, -2.0711757456043323, 0.5221498325032493, 1.592566740488712, 2.0711757456043336,
                      -0.5453691892921135, -2.071175745604333])  # fmt: skip
    goal = np.array([0.933800493101081, 2.360165980488712, -0.17109097929211353])
    got = dynamics.joint_state(goal, start=start)
    dynamics.joint_state(0.5 * (robot.joint_positions(start) + goal), start=start)
    want = dynamics.joint_state(goal)
    assert got.status is want.status is SampleStatus.OK
    np.testing.assert_allclose(got.q, want.q, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize(("name", "x"), [("2rpr", [-0.25, -0.4]), ("delta", [-0.1940804, -0.30004984, 0.56533433])])
def test_what_is_refused_from_a_start_is_not_refused_without_one(name: str, x: list[float]) -> None:
    """On no straight way from the reference; without a branch to keep to, the sample may be on any."""
    robot = machine(name)
    dynamics, zero = rp.CompiledDynamics(robot), np.zeros(robot.n)
    assert not dynamics.torque(x, zero, zero, start=robot.q_reference).status.solved
    assert dynamics.torque(x, zero, zero).status is rp.CompiledDynamics(robot).torque(x, zero, zero).status
    assert dynamics.torque(x, zero, zero).status.solved


def test_a_start_that_is_named_again_is_refused_again_at_once(work: list[str]) -> None:
    robot, dynamics = machine("five_bar"), rp.CompiledDynamics(machine("five_bar"))
    home = np.array(robot.q_reference)
    beyond, counts = robot.joint_positions(home) + BEYOND["five_bar"], []
    for _ in range(3):
        assert dynamics.joint_state(beyond, start=home).status is SampleStatus.UNREACHABLE
        counts.append(len(work))
    assert 0 < counts[0] == counts[-1]


def test_what_is_refused_is_not_looked_for_again_at_other_velocities(work: list[str]) -> None:
    """The flat pose of the 2-RPR, which kinematics name: a set-point that is held while its rate is noisy."""
    robot, dynamics = machine("2rpr"), rp.CompiledDynamics(machine("2rpr"))
    dynamics.joint_state(robot.joint_positions(robot.q_reference), start=robot.q_reference)
    counts = []
    for rate in (0.0, 1.0, -1e-3):
        assert dynamics.joint_state([0.2, 0.3], [rate, rate]).status is SampleStatus.TYPE_II
        counts.append(len(work))
    assert 0 < counts[0] == counts[-1] < 50
