"""Computed torque: linear error equation through type II poses, honest where it gives up, limits, delay."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from crossing_case import corner, crossing, perturbed, two_rpr

import redundancy_pin as rp
from redundancy_pin.errors import InputError, SingularPoseError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.reference import motion_reference
from redundancy_pin.robot.scales import row_scale
from redundancy_pin.simulation.controllers import ComputedTorque, FeedForward, TimeVaryingLqr, computed_torque
from redundancy_pin.simulation.controllers.base import Sampling
from redundancy_pin.simulation.controllers.computed_torque import ReducedModel
from redundancy_pin.simulation.state import State, closed_state, tree_state
from redundancy_pin.status import SampleStatus

BEFORE = 0.5
"""s; 19 ms before the first type II pose."""

AWAY, SPEED = [7e-4, -7e-4], [7e-3, 7e-3]
"""1 mm and 1e-2 m/s."""


def errors(run, reference):
    return run.x - np.array([reference.platform(float(t))[0] for t in run.t])


def critically_damped(t, away, speed, omega):
    """The solution of ë + 2 ω ė + ω² e = 0."""
    return (away + (speed + omega * away) * t[:, None]) * np.exp(-omega * t)[:, None]


@pytest.mark.long
@pytest.mark.parametrize("backend", [None, rp.CompiledDynamics])
def test_the_platform_obeys_its_error_equation_through_both_type_ii_poses(backend):
    motion, robot = crossing(), two_rpr()
    dynamics = None if backend is None else backend(robot)
    start = perturbed(robot, motion, BEFORE, AWAY, SPEED)
    control = ComputedTorque(motion)
    run = rp.simulate(robot, control, start=start, duration=0.4, rtol=1e-8, atol=1e-10, dynamics=dynamics)
    assert [event.kind for event in run.events].count("type_II") == 2
    expected = critically_damped(run.t - BEFORE, np.array(AWAY), np.array(SPEED), control.bandwidth)
    assert np.abs(errors(run, motion) - expected).max() < 1e-10  # what the integrator is asked for
    assert {one.allocation.status for one in control.history} == {SampleStatus.OK}
    assert np.abs(run.tau).max() < 1.5 * np.abs([motion.loads(t)[0] for t in run.t]).max()
    # the carriers did it: they left their plan, by far less than the 4 cm of track kept for that
    away = np.abs(run.s - np.array([motion.carriers(float(t))[0] for t in run.t])).max()
    assert 1e-4 < away < 1e-2


@pytest.mark.long
def test_without_carriers_that_help_the_efforts_have_no_bound():
    """The same with carriers pinned to their plan: near the type II pose the main actuators would take anything."""
    motion, robot = crossing(), two_rpr()
    state = perturbed(robot, motion, BEFORE, AWAY, SPEED)
    helped = ComputedTorque(motion)
    alone = ComputedTorque(motion, carrier_scale=1e-9)
    peaks = []
    for control in (helped, alone):
        run = rp.simulate(robot, helped, start=state, duration=0.03, rtol=1e-8, atol=1e-10, dt=1e-4)
        commands = [
            control.command(float(t), State(state.chain, float(t), q, v))
            for t, q, v in zip(run.t, run.q, run.v, strict=True)
        ]
        peaks.append(max(float(np.abs(command.tau).max()) for command in commands))
    assert peaks[1] > 50.0 * peaks[0]


@pytest.mark.long
def test_a_digital_one_with_a_delay_of_one_sample_crosses_too():
    motion, robot = crossing(), two_rpr()
    sampling = Sampling(1e-3, 1e-3)
    control = ComputedTorque(motion, sampling=sampling)
    start = perturbed(robot, motion, BEFORE, AWAY, SPEED)
    run = rp.simulate(
        robot, control, start=start, duration=0.4, sampling=sampling, rtol=1e-6, atol=1e-8, integrator="RK45"
    )
    expected = critically_damped(run.t - BEFORE, np.array(AWAY), np.array(SPEED), control.bandwidth)
    # the hold acts on accelerations up to bandwidth² mm; a millisecond of it is 30 µm/s, of which 2 % of a mm remain
    assert np.abs(errors(run, motion) - expected).max() < 2e-5
    assert len({command.t for command in control.history}) == 400


def test_a_controller_made_for_another_sampling_is_refused():
    control = ComputedTorque(crossing(), sampling=Sampling(1e-3, 1e-3))
    for sampling in (None, Sampling(1e-3), Sampling(2e-3, 1e-3)):
        with pytest.raises(InputError, match="ComputedTorque was made for Sampling"):
            rp.simulate(two_rpr(), control, duration=0.01, sampling=sampling)


@pytest.mark.long
def test_the_corner_of_the_three_rrr():
    motion = corner()
    start = perturbed(motion.robot, motion, 0.7, [*AWAY, 0.0], [*SPEED, 0.0])
    run = rp.simulate(motion.robot, ComputedTorque(motion), start=start, duration=0.4, rtol=1e-8, atol=1e-10)
    expected = critically_damped(run.t - 0.7, np.array([*AWAY, 0.0]), np.array([*SPEED, 0.0]), 30.0)
    assert run.status.value == "ok"
    assert np.abs(errors(run, motion) - expected).max() < 1e-10


@pytest.mark.long
def test_carriers_come_back_to_their_plan():
    motion = corner()
    point = motion.at(0.7)
    start = closed_state(motion.robot, point.x, point.xd, point.s + 2e-3, point.sd, t=0.7)
    run = rp.simulate(
        motion.robot, ComputedTorque(motion, carrier_scale=1e-6), start=start, duration=0.4, rtol=1e-8, atol=1e-10
    )
    away = run.s - np.array([motion.carriers(float(t))[0] for t in run.t])
    expected = critically_damped(run.t - 0.7, np.full(3, 2e-3), np.zeros(3), 10.0)
    assert np.abs(away - expected).max() < 1e-8
    assert np.abs(errors(run, motion)).max() < 1e-10


def test_it_gives_up_where_nothing_has_an_effect_and_says_so(monkeypatch):
    """A pose at which neither main actuators nor carriers push the platform along y."""
    motion = crossing()
    control = ComputedTorque(motion)
    t = 0.519
    q, v, _ = motion.tree(t)
    evaluated = ReducedModel(motion.robot).at(q, v)
    mass, W = evaluated.mass.copy(), evaluated.W.copy()
    mass[1, 2:] = mass[2:, 1] = 0.0
    W[1] = 0.0
    monkeypatch.setattr(ReducedModel, "at", lambda self, q, v: replace(evaluated, mass=mass, W=W))
    command = control.command(t, tree_state(motion.robot, q, v, t=t))
    needed = mass[1, :2] @ motion.at(t).xdd + evaluated.bias[1]
    assert command.allocation.status is SampleStatus.SINGULAR_INCONSISTENT
    assert command.allocation.residual == pytest.approx(abs(needed), rel=1e-6)
    assert np.array_equal(command.tau, motion.loads(t)[0])
    assert np.array_equal(command.carrier_force, motion.loads(t)[1])


def test_history_is_bounded_and_keeps_the_latest(monkeypatch):
    monkeypatch.setattr(computed_torque, "HISTORY", 3)
    motion = crossing()
    control = ComputedTorque(motion)
    times = [0.30, 0.31, 0.32, 0.33, 0.34]
    for t in times:
        q, v, _ = motion.tree(t)
        control.effort(t, tree_state(motion.robot, q, v, t=t))
    assert [command.t for command in control.history] == times[-3:]


def test_limited_main_efforts_are_made_up_for_by_carriers():
    motion, robot = crossing(), two_rpr()
    start = perturbed(robot, motion, 0.3, AWAY, SPEED)
    control = ComputedTorque(motion, effort_limit=1.7)  # the plan has 1.75 N
    run = rp.simulate(robot, control, start=start, duration=0.1, effort_limit=1.7, rtol=1e-8, atol=1e-10)
    assert any(one.allocation.saturated for one in control.history)
    assert {one.allocation.status for one in control.history} == {SampleStatus.OK}
    expected = critically_damped(run.t - 0.3, np.array(AWAY), np.array(SPEED), 30.0)
    assert np.abs(errors(run, motion) - expected).max() < 1e-7  # efforts kink where they meet their limits


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"bandwidth": 0.0}, "bandwidth is 0"),
        ({"carrier_bandwidth": -1.0}, "carrier_bandwidth is -1"),
        ({"damping": float("nan")}, "damping is nan"),
        ({"effort_scale": 0.0}, "effort_scale is 0.0"),
        ({"carrier_scale": [1.0, 2.0, 3.0]}, r"carrier_scale is \[1.0, 2.0, 3.0\]"),
        ({"effort_limit": -1.0}, "effort_limit is -1.0"),
        ({"carrier_force_limit": [1.0, 2.0, 3.0]}, "carrier_force_limit is"),
    ],
)
def test_settings_out_of_their_domain(changed, message):
    with pytest.raises(InputError, match=message):
        ComputedTorque(crossing(), **changed)


@pytest.mark.long
def test_limited_carriers_are_made_up_for_by_main_efforts():
    motion, robot = crossing(), two_rpr()
    start = perturbed(robot, motion, 0.3, AWAY, SPEED)
    free = ComputedTorque(motion)
    run = rp.simulate(robot, free, start=start, duration=0.1, rtol=1e-8, atol=1e-10)
    peak = np.abs(run.carrier_force).max(axis=0)
    limit = 0.97 * float(peak.max())
    control = ComputedTorque(motion, carrier_force_limit=limit)
    run = rp.simulate(robot, control, start=start, duration=0.1, carrier_force_limit=limit, rtol=1e-8, atol=1e-10)
    assert any(one.allocation.saturated for one in control.history)
    assert {one.allocation.status for one in control.history} == {SampleStatus.OK}
    assert np.abs(run.carrier_force).max() == pytest.approx(limit, rel=1e-12)
    expected = critically_damped(run.t - 0.3, np.array(AWAY), np.array(SPEED), 30.0)
    assert np.abs(errors(run, motion) - expected).max() < 1e-7  # the platform keeps its equation; forces kink
    # without knowing, what the amplifiers cut off is missing
    run = rp.simulate(robot, free, start=start, duration=0.1, carrier_force_limit=limit, rtol=1e-8, atol=1e-10)
    assert np.abs(errors(run, motion) - expected).max() > 1e-5


def test_where_it_gives_up_it_keeps_its_limits(monkeypatch):
    motion = crossing()
    control = ComputedTorque(motion, effort_limit=0.01, carrier_force_limit=0.02)
    q, v, _ = motion.tree(0.3)

    def type_I(self, q, v):
        raise SingularPoseError("type I")

    monkeypatch.setattr(ReducedModel, "at", type_I)
    command = control.command(0.3, tree_state(motion.robot, q, v, t=0.3))
    assert command.allocation.status is SampleStatus.TYPE_I
    assert np.abs(command.tau).max() == 0.01
    assert np.array_equal(command.carrier_force, np.clip(motion.loads(0.3)[1], -0.02, 0.02))


def straight(**masses):
    """A slow line on the 2-RPR with little to do, above its singular line."""
    path = rp.trajectory.Line((0.15, 0.4), (0.2, 0.3))
    motion = rp.trajectory.Trajectory(path, rp.trajectory.SpeedProfile(path.length, 0.05, 0.5))
    return motion_reference(rp.load_robot("2rpr", **masses), motion)


def test_correcting_efforts_of_a_point_mass():
    """Legs and carriers without mass: every leg pushes 0.5 kg along itself."""
    motion = straight(end_effector_mass=0.5, carrier_mass=0.0)
    assert computed_torque.correcting_efforts(motion, 0.9) == pytest.approx([0.45, 0.45], rel=1e-9)


def test_correcting_efforts_are_those_of_the_backend():
    """a (W̃ᵀ M̃ W̃)_ii / |W̃_i|³ with M and W of the inverse dynamics, in lengths."""
    motion = corner()
    robot, middles = motion.robot, 0.5 * (motion.edges[:-1] + motion.edges[1:])
    rows, inertias = row_scale(robot), []
    assert not np.allclose(rows, 1.0)
    # four accelerations at each point: three of one, and none
    points = [motion.at(t) for t in np.repeat(middles, 4).tolist()]
    still, steps = np.zeros((len(points), 3)), np.tile(np.eye(4, 3), (len(middles), 1))
    times, x = np.arange(len(points), dtype=float), [point.x for point in points]
    motions = PlatformMotion(times, x, still, steps, check_rates=False)
    reduced = rp.RneaDynamics(robot).reduce(motions, CarrierMotion([point.s for point in points], still, still))
    for f, W in zip(reduced.f.reshape(-1, 4, 3), reduced.W[::4] / rows[:, None], strict=True):
        mass = (f[:3] - f[3]).T / rows[:, None] / rows
        inertias.append(np.diag(W.T @ mass @ W) / np.linalg.norm(W, axis=0) ** 3)
    expected = 0.9 * np.median(inertias, axis=0)
    assert computed_torque.correcting_efforts(motion, 0.9) == pytest.approx(expected, rel=1e-8)


def test_the_default_effort_scale_is_no_less_than_what_corrects_a_millimetre():
    slow = straight(end_effector_mass=0.5, carrier_mass=1.0)
    planned = np.abs([slow.loads(float(t))[0] for t in slow.edges]).max()
    assert planned < 0.1
    least = computed_torque.correcting_efforts(slow, 30.0**2 * 1e-3)
    assert (least > 0.45).all()
    assert ComputedTorque(slow).effort_scale == pytest.approx(least, rel=1e-12)
    assert ComputedTorque(slow, bandwidth=60.0).effort_scale == pytest.approx(4.0 * least, rel=1e-12)
    assert ComputedTorque(slow, effort_scale=0.01).effort_scale == pytest.approx([0.01, 0.01])
    fast = crossing()  # needs 4 N
    middles = 0.5 * (fast.edges[:-1] + fast.edges[1:])
    assert np.array_equal(
        ComputedTorque(fast).effort_scale, np.abs([fast.loads(float(t))[0] for t in middles]).max(axis=0)
    )


@pytest.mark.parametrize(
    "control", [lambda: ComputedTorque(crossing()), lambda: TimeVaryingLqr(crossing(), step=0.2)], ids=["torque", "LQR"]
)
def test_carriers_driven_by_motion_are_refused_for_they_would_lose_their_feedback(control):
    control = control()
    with pytest.raises(InputError, match=rf'{type(control).__name__} drives carriers by force.*Pass carriers="force"'):
        rp.simulate(two_rpr(), control, duration=0.01, carriers="motion")
    still = FeedForward(crossing())
    assert rp.simulate(two_rpr(), still, duration=0.01, carriers="motion").status.value == "ok"


def test_where_there_are_no_carriers_nothing_is_refused():
    motion = straight(end_effector_mass=0.5, carriers=False)
    assert motion.robot.k == 0
    run = rp.simulate(motion.robot, ComputedTorque(motion), duration=0.01, carriers="motion")
    assert run.status.value == "ok"
