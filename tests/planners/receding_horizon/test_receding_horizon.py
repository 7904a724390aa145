"""On-line planning, judged by the other backend: W τ = f, limits between the nodes, singular instants, statuses."""

import itertools
import json
import re
from functools import cache
from types import SimpleNamespace

import numpy as np
import online
import pytest
import zoo
from online_programme import Ahead, linearised

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.receding_horizon import OnLineRun, Preview, RecedingHorizon, Weights, run_online
from redundancy_pin.planners.receding_horizon.constants import SHORTEST_STOP
from redundancy_pin.planners.receding_horizon.run import pieces_of
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import Line, circle_path
from redundancy_pin.trajectory.reference import circle

MISSING = 1e-4
"""N of up to 5 N that may be missing within a millisecond of a singular instant: two rounds leave less."""


@cache
def machine(name="2rpr"):
    masses = {"end_effector_mass": 0.5, "cylinder_mass": 0.3} if name == "2rpr" else {}
    robot = zoo.robot_of(name, **masses)
    return rp.CompiledDynamics(robot), (rp.RneaDynamics if robot.closed_form is None else rp.VirtualWork)(robot)


def line(start, end, duration=0.8):
    length = float(np.hypot(*np.subtract(end, start)))
    return Trajectory(Line(start, end), SpeedProfile(length, length / (0.7 * duration), 0.25 * duration))


_ARC = circle_path((0.25, 0.05), 0.09, start_angle=np.pi, sweep=np.pi)
ACROSS = Trajectory(_ARC, SpeedProfile(_ARC.length, 0.45, 0.2))
"""Over the line and back: two crossings."""


@cache
def across() -> OnLineRun:
    return run_online(RecedingHorizon(machine()[0]), ACROSS)


def assert_limits_between_nodes(plan, robot):
    t = np.linspace(plan.t[0], plan.t[-1], 4001)
    carriers = plan.carriers_at(t)
    for limit, s, sd, sdd in zip(robot.carrier_limits, carriers.s.T, carriers.sd.T, carriers.sdd.T, strict=True):
        assert limit.lower - 1e-8 <= s.min()
        assert s.max() <= limit.upper + 1e-8
        assert np.abs(sd).max() <= limit.speed * (1.0 + 1e-8)
        assert np.abs(sdd).max() <= limit.acceleration * (1.0 + 1e-6)


def test_a_singular_instant_is_crossed_as_the_other_backend_sees_it():
    run, (dynamics, other) = across(), machine()
    assert run.counts["ok"] == len(run.commands)
    assert run.plan.status.value == "ok"
    assert_limits_between_nodes(run.plan, dynamics.robot)
    t = np.array([crossing.t for crossing in rp.find_crossings(dynamics.robot, ACROSS)])
    np.testing.assert_allclose(run.plan.findings.singular_instants, t, atol=1e-8)
    # what W loses there f does not ask for, by the other backend; with parked carriers it would
    reduced, parked = (other.reduce(ACROSS.sample_at(t), carriers) for carriers in (run.plan.carriers_at(t), None))
    u = np.linalg.svd(reduced.W)[0][:, :, -1]
    assert len(t) == 2
    assert np.abs(np.einsum("qn,qn->q", u, reduced.f)).max() < MISSING
    assert np.abs(np.einsum("qn,qn->q", u, parked.f)).min() > 1000.0 * MISSING
    # 7e-7 N with efforts that are straight through the instant, without the kink that the jerk's jump gives them
    assert run.plan.diagnostics["missing_force"] < 5e-7


def test_a_slow_crossing_with_samples_next_to_it_is_within_limits_too():
    # W is next to singular for longer than from sample to sample, and one is judged there
    path = circle_path((0.25, 0.0), 0.09, start_angle=-0.3, sweep=0.6)
    slow = Trajectory(path, SpeedProfile(path.length, 0.12, 0.1))
    run = run_online(RecedingHorizon(machine()[0]), slow)
    (root,) = run.plan.findings.singular_instants
    inside = np.abs(run.plan.t - root) < 6e-3
    assert inside.sum() >= 4
    t = run.plan.t[inside]
    reduced = machine()[1].reduce(slow.sample_at(t), run.plan.carriers_at(t))
    left = np.einsum("nij,nj->ni", reduced.W, run.plan.tau[inside]) - reduced.f
    assert np.abs(left).max() < 1e-6 * np.abs(run.plan.tau).max()
    assert run.plan.status.value == "ok"


def test_efforts_are_continuous_through_the_singular_instant_and_those_of_the_other_backend():
    run, (dynamics, other) = across(), machine()
    for root in run.plan.findings.singular_instants:
        t = root + np.array([-2e-3, -1.2e-3, 1.2e-3, 2e-3])
        reduced = other.reduce(ACROSS.sample_at(t), run.plan.carriers_at(t))
        tau = np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0]
        # both sides extended to the instant: with another jerk than uᵀ Ẇ τ = uᵀ ḟ asks for they would differ
        before, after = tau[1] + 1.5 * (tau[1] - tau[0]), tau[2] + 1.5 * (tau[2] - tau[3])
        np.testing.assert_allclose(before, after, atol=0.03 * run.plan.peak_effort.max())
        np.testing.assert_allclose(run.plan.efforts_at(t, dynamics), tau, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("track", [(0.1496, 0.1504), (-0.1504, -0.1496), (0.1496, np.inf), (-np.inf, -0.1496)])
def test_a_track_far_from_zero_is_kept(track):
    # the ends of a narrow one are some 370 half widths from zero, which is no reason to take them for no limits
    low, high = track
    planner = RecedingHorizon(machine()[0], limits=rp.Limits(track=track))
    start = np.full(2, np.sign(low) * 0.15)
    command = planner.update(0.0, rp.trajectory.reference.circle(speed=0.05), start, np.zeros(2))
    assert command.status is UpdateStatus.OK
    s = np.array([command.motion_at(t)[0] for t in np.linspace(0.0, 0.5, 201)])
    assert low - 1e-8 <= s.min() < s.max() <= high + 1e-8


def test_the_peak_is_that_of_efforts_of_either_sign():
    planner = RecedingHorizon(machine()[0])
    command = planner.update(0.2, ACROSS)
    nodes = planner.updates.last.nodes
    tau = command.efforts(nodes[(nodes > 0.2 + 4.0 * planner.step) & (nodes <= command.known_until)])
    # one motor pushes as hard as the other pulls
    np.testing.assert_allclose([tau.max(), -tau.min()], command.peak, rtol=1e-6)


def test_where_w_is_next_to_singular_only_the_lost_direction_is_not_balanced():
    """Of a platform that turns: moments count over the characteristic length."""
    robot, t = zoo.robot_of("3rrr"), np.linspace(0.0, 1.0, 40)
    rate = np.array([0.0, 0.0, -2.0])
    x = zoo.home_of(robot) + [0.1, 0.2, 0.0] + t[:, None] * rate  # at the centre W would lose rotation alone
    motion = rp.PlatformMotion(t, x, np.tile(rate, (40, 1)), np.zeros((40, 3)))
    source = as_motion(motion)
    dynamics, ends = rp.RneaDynamics(robot), np.array([0.0, 1.0])
    (crossing,) = rp.find_crossings(robot, motion)
    efforts = PiecewisePolynomial.linear(ends, np.array([[1.0, 2.0, 3.0], [2.0, 1.0, 0.0]]))
    command = SimpleNamespace(t=0.0, efforts=efforts, singular=np.array([crossing.t]))
    carriers = PiecewisePolynomial.linear(ends, np.zeros((2, 3)))
    ((part, _),) = pieces_of(SimpleNamespace(dynamics=dynamics, robot=robot), source, carriers, [command])
    reduced = rp.VirtualWork(robot).reduce(source.sample_at(part.edges))
    W, f = reduced.W / reduced.row_scale[:, None], reduced.f / reduced.row_scale
    left = np.einsum("nij,ni->nj", np.linalg.svd(W)[0], np.einsum("nij,nj->ni", W, part(part.edges)) - f)
    assert np.abs(left[:, :2]).max() < 1e-9 * np.abs(f).max()
    assert np.abs(left[:, 2]).max() > 1e-3 * np.abs(f).max()


def test_commands_say_what_the_machine_does_until_the_next_tick():
    run, (_, other) = across(), machine()
    for command in run.commands[5:15]:
        t = command.t + np.array([0.0, 0.004, 0.016])
        s, sd, sdd = (np.stack(part) for part in zip(*(command.motion_at(float(x)) for x in t), strict=True))
        reduced = other.reduce(ACROSS.sample_at(t), rp.CarrierMotion(s, sd, sdd, check_rates=False))
        tau = np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0]
        np.testing.assert_allclose(command.efforts(t), tau, atol=0.02 * run.plan.peak_effort.max())
        assert command.residual < 0.1
        assert command.seconds > 0.0


@pytest.mark.parametrize(
    "motion",
    [
        pytest.param(line((0.2, 0.15), (0.25, 0.0)), id="stops on the line"),
        pytest.param(line((0.2, 0.0), (0.3, 0.0), 0.5), id="goes along it"),
        pytest.param(line((0.2, 0.15), (0.25, 1e-3)), id="stops beside it", marks=pytest.mark.long),
        pytest.param(circle_path((0.25, 0.08), 0.08, start_angle=np.pi / 2), id="touches it", marks=pytest.mark.long),
        pytest.param(
            circle_path((0.25, 0.0795), 0.08, start_angle=np.pi / 2), id="over it and back", marks=pytest.mark.long
        ),
    ],
)
def test_no_tick_gives_up_on_the_line(motion):
    if not isinstance(motion, Trajectory):
        motion = Trajectory(motion, SpeedProfile(motion.length, 0.4, 0.3))
    run = run_online(RecedingHorizon(machine()[0]), motion)
    assert run.counts["ok"] == len(run.commands)
    assert run.plan.diagnostics["missing_force"] < 0.05
    assert np.isfinite(run.plan.peak_effort).all()
    assert_limits_between_nodes(run.plan, machine()[0].robot)


@pytest.mark.parametrize("stops", [pytest.param(0.36, marks=pytest.mark.long), 0.46])
def test_an_operator_who_stops_all_of_a_sudden_is_followed(stops):
    """The preview changes its mind at t = 0.3 s: time along the path comes to rest."""
    dynamics, _ = machine()
    braking = 2.0 * (stops - 0.3)  # to rest at the place where the old plan is at the time given

    def stopped(t):
        part = np.clip((t - 0.3) / braking, 0.0, 1.0)
        place = np.where(t < 0.3, t, 0.3 + braking * (part - part**3 + 0.5 * part**4))
        rate = np.where(t < 0.3, 1.0, 1.0 - 3.0 * part**2 + 2.0 * part**3)
        change = np.where((t < 0.3) | (part >= 1.0), 0.0, 6.0 * (part**2 - part) / braking)
        order = np.argsort(place, kind="stable")
        x, xd, xdd = (np.empty((len(t), 2)) for _ in range(3))
        for i in order:
            there = ACROSS.sample_at(np.array([place[i]]))
            x[i], xd[i] = there.x[0], there.xd[0] * rate[i]
            xdd[i] = there.xdd[0] * rate[i] ** 2 + there.xd[0] * change[i]
        return rp.PlatformMotion(t, x, xd, xdd, check_rates=False)

    planner, commands = RecedingHorizon(dynamics), []
    for i in range(40):
        t = 0.02 * i
        commands.append(planner.update(t, ACROSS.sample_at if t < 0.3 else stopped))
    assert {command.status for command in commands} <= {UpdateStatus.OK, UpdateStatus.RELAXED}
    assert sum(command.status is UpdateStatus.RELAXED for command in commands) <= 2
    assert commands[-1].status is UpdateStatus.OK
    assert commands[-1].residual < 1e-6
    t = np.linspace(0.0, 0.8, 801)
    s = np.stack([next(c for c in reversed(commands) if c.t <= x + 1e-12).motion_at(float(x))[0] for x in t])
    assert np.abs(s).max() <= 0.2 + 1e-8


def test_missed_ticks_leave_a_plan_within_limits():
    dynamics, _ = machine()
    planner, rng = RecedingHorizon(dynamics), np.random.default_rng(3)
    with pytest.raises(InputError, match="no plan"):
        planner.skip(0.0)
    pieces, statuses = [], []
    for i in range(30):
        t = 0.02 * i
        command = planner.update(t, ACROSS) if i == 0 or rng.random() < 0.5 else planner.skip(t)
        statuses.append(command.status)
        pieces.append(command.carriers.between(t, t + 0.02))
    assert set(statuses) == {UpdateStatus.OK, UpdateStatus.FALLBACK}
    s, sd = (np.concatenate([piece.derivative(i)(piece.edges[:1]) for piece in pieces]) for i in (0, 1))
    ends, end_speeds = (
        np.concatenate([piece.derivative(i)(piece.edges[-1:], "left") for piece in pieces]) for i in (0, 1)
    )
    np.testing.assert_allclose(s[1:], ends[:-1], atol=1e-12)
    np.testing.assert_allclose(sd[1:], end_speeds[:-1], atol=1e-10)
    assert np.abs(s).max() <= 0.2 + 1e-9
    # and without a further tick: to the end of the plan, and to rest on the track
    last = command.carriers
    t = np.linspace(last.start, last.end, 2001)
    assert np.abs(last(t)).max() <= 0.2 + 1e-8
    assert np.abs(last.derivative(2)(t)).max() <= 10.0 + 1e-6
    np.testing.assert_allclose(last.derivative()(t[-1:], "left"), 0.0, atol=1e-9)


def test_carriers_of_unequal_limits_stop_on_their_tracks_behind_the_horizon():
    planner = RecedingHorizon(machine()[0], limits=rp.Limits(acceleration=(0.5, 20.0)), horizon=0.2)
    for i in range(12):
        stop = planner.update(0.02 * i, ACROSS).carriers
        t = np.linspace(stop.start, stop.end, 2001)
        assert np.abs(stop(t)).max() <= 0.2 + 1e-8
        assert (np.abs(stop.derivative(2)(t)).max(axis=0) <= np.array([0.5, 20.0]) + 1e-6).all()
        np.testing.assert_allclose(stop.derivative()(t[-1:], "left"), 0.0, atol=1e-9)
        pieces = stop(stop.edges[1:-1]) - stop(stop.edges[1:-1], "left")
        rates = stop.derivative()(stop.edges[1:-1]) - stop.derivative()(stop.edges[1:-1], "left")
        np.testing.assert_allclose(pieces, 0.0, atol=1e-9)
        np.testing.assert_allclose(rates, 0.0, atol=20.0 * SHORTEST_STOP)  # what stops sooner stands


BETWEEN = 5e-3
"""Fraction of the largest f so far: efforts are linear over 2.5 ms, in which f is not."""


def missing_until_the_next_node(planner, command, trajectory, judge):
    """Largest |W τ − f| of a command's first step by the other backend, both sides of jumps of the acceleration."""
    end = min(command.t + planner.step, trajectory.duration)
    inner = trajectory.breaks[(trajectory.breaks > command.t) & (trajectory.breaks <= end + 1e-9)]
    t = np.unique(np.concatenate([np.linspace(command.t, end, 60), inner - 1e-7, inner[inner < end] + 1e-7]))
    motion = rp.CarrierMotion(*map(np.array, zip(*map(command.motion_at, t), strict=True)), check_rates=False)
    reduced = judge.reduce(trajectory.sample_at(t), motion, check_track=False)
    missing = (np.einsum("nij,nj->ni", reduced.W, command.efforts(t)) - reduced.f) / reduced.row_scale
    return np.abs(missing).max(), np.abs(reduced.f / reduced.row_scale).max()


def test_efforts_jump_where_the_acceleration_of_the_platform_jumps_between_two_nodes():
    dynamics, judge = machine("3rrr")
    corner = rp.trajectory.reference.corner(radius=0.025)
    planner, largest = RecedingHorizon(dynamics), 0.0
    for t in np.arange(0.0, corner.duration - 0.02, 0.02):
        command = planner.update(t, corner)
        missing, f = missing_until_the_next_node(planner, command, corner, judge)
        largest = max(largest, f)
        assert command.status is UpdateStatus.OK
        assert missing < BETWEEN * largest
    assert largest > 10.0


def test_what_limits_cut_off_between_two_nodes_is_said():
    """Round the corner with 4 N·m: at the nodes they are enough, where the arc begins and ends they are not."""
    dynamics, judge = machine("3rrr")
    corner = rp.trajectory.reference.corner(radius=0.025)
    planner, largest, cut = RecedingHorizon(dynamics, limits=rp.Limits(effort=4.0)), 0.0, []
    for t in np.arange(0.0, corner.duration - 0.02, 0.02):
        command = planner.update(t, corner)
        missing, f = missing_until_the_next_node(planner, command, corner, judge)
        largest = max(largest, f)
        if command.status is UpdateStatus.OK:
            assert missing < BETWEEN * largest
        else:
            cut.append(t)
            assert "between the nodes" in command.reason
            assert command.residual == pytest.approx(missing, rel=0.05)
    assert all(t < broken < t + 0.02 + 1e-9 for t, broken in zip(cut, corner.breaks, strict=True))


def test_limits_that_shrink_below_the_state_are_softened_and_said():
    planner = RecedingHorizon(machine()[0])
    for i in range(10):
        command = planner.update(0.02 * i, ACROSS)
    sd = command.motion_at(0.2)[1]
    assert np.abs(sd).max() > 0.1
    planner.limits = rp.Limits(speed=0.5 * float(np.abs(sd).max()))
    softened = planner.update(0.2, ACROSS)
    assert softened.status is UpdateStatus.RELAXED
    for i in range(11, 24):
        command = planner.update(0.02 * i, ACROSS)
    assert command.status is UpdateStatus.OK
    assert np.abs(command.motion_at(command.t + 0.2)[1]).max() <= 0.5 * np.abs(sd).max() + 1e-9


def test_too_little_effort_is_said_with_what_is_missing():
    planner = RecedingHorizon(machine()[0], limits=rp.Limits(effort=0.5, acceleration=1.0))
    commands = [planner.update(0.02 * i, line((0.2, 0.15), (0.3, -0.15), 0.4)) for i in range(4)]
    assert commands[-1].status is UpdateStatus.RELAXED
    assert max(command.residual for command in commands) > 0.1
    assert commands[-1].reason
    # what is sent keeps the limits, and is saturated
    sent = [np.abs(command.efforts(np.linspace(command.t, command.t + 0.06, 61))).max() for command in commands]
    np.testing.assert_allclose(sent[-1], 0.5)
    assert max(sent) <= 0.5


def test_where_the_machine_cannot_go_is_refused_before_it_gets_there():
    dynamics, _ = machine("five_bar")
    home = zoo.home_of(dynamics.robot)
    motion = line(tuple(home), (home[0], home[1] + 0.9))
    planner = RecedingHorizon(dynamics)
    command = planner.update(0.0, motion)
    assert command.status is UpdateStatus.REFUSED
    lost = float(command.reason.split("t = ")[1].split()[0])
    place = json.loads(command.reason.split("go, to ")[1])
    np.testing.assert_allclose(place, motion.sample_at([lost]).x[0], atol=1e-4)
    dynamics.reduce(motion.sample_at([command.known_until]))
    with pytest.raises(rp.errors.UnreachablePoseError):
        dynamics.reduce(motion.sample_at([lost]))
    with pytest.raises(InfeasiblePlanError, match="refuses to go on"):
        run_online(RecedingHorizon(dynamics), motion)


def test_a_preview_may_be_a_function_or_samples_and_may_end_on_the_way():
    dynamics, _ = machine()
    motion = ACROSS.sample_at(np.linspace(0.0, 0.3, 200))
    previews = [Preview.of(ACROSS), Preview.of(ACROSS.sample_at), Preview.of(motion)]
    first, second, ends = (RecedingHorizon(dynamics).update(0.0, preview) for preview in previews)
    t = np.linspace(0.0, 0.4, 9)
    np.testing.assert_allclose(first.carriers(t), second.carriers(t), atol=1e-6)
    assert ends.status is UpdateStatus.OK
    assert 0.25 < ends.known_until <= 0.3 < first.known_until
    with pytest.raises(InputError, match="preview is str"):
        RecedingHorizon(dynamics).update(0.0, "straight on")


def test_a_motion_that_ends_at_rest_stays_there_and_one_that_does_not_ends():
    t = np.linspace(0.0, ACROSS.duration, 400)
    rests, moves = Preview.of(ACROSS), Preview.of(ACROSS.sample_at(t[:200]))
    later = rests.motion(ACROSS.duration + np.array([0.0, 1.0, 1000.0]))
    np.testing.assert_allclose(later.x, np.tile(later.x[:1], (3, 1)), atol=1e-12)
    assert np.abs(later.xd).max() < 1e-9
    assert rests.end > 1000.0 + ACROSS.duration
    assert moves.end == t[199]


def singular_instants_of(found):
    """Each once, of updates of which each tells those ahead."""
    every = np.sort(np.concatenate(found))
    return every[np.append(True, np.diff(every) > 1e-6)]


def test_singular_instants_before_the_zero_of_time_are_as_dense():
    """Up and down over the line, long ago: what is in sight grows tick by tick."""

    def swing(t):
        waves = np.cos(20.0 * t), -20.0 * np.sin(20.0 * t), -400.0 * np.cos(20.0 * t)
        x, xd, xdd = (np.outer(wave, [0.0, 0.03]) for wave in waves)
        return rp.PlatformMotion(t, x + np.array([0.25, 0.0]), xd, xdd)

    planner, preview, found = RecedingHorizon(machine()[0]), Preview(swing, -3.0, 3.0), []
    for t in np.arange(-2.0, -1.5, 0.02):
        found.append(planner.update(t, preview).singular)
    np.testing.assert_allclose(singular_instants_of(found), np.pi / 20.0 * (np.arange(-13, -6) + 0.5), atol=1e-9)


def test_the_rate_of_f_at_a_singular_instant_is_that_of_differences_by_the_other_backend():
    dynamics, other = machine()
    root = float(rp.find_crossings(dynamics.robot, ACROSS)[0].t)
    rng = np.random.default_rng(1)
    nodes = root + np.array([-0.02, 0.0, 0.02, 0.04, 0.06])
    s, sd, sdd = (rng.uniform(-1.0, 1.0, (5, 2)) * size for size in (0.1, 0.5, 5.0))
    at = s, sd, sdd
    ahead = Ahead(dynamics, Preview.of(ACROSS))
    lin = linearised(ahead, nodes, np.array([1]), at, np.zeros((5, 2)), 1.0)
    changes = [rng.uniform(-1.0, 1.0, 2) * size for size in (1e-3, 1e-2, 0.1, 10.0)]
    changed = lin.f_rate[0] + sum(part[0] @ change for part, change in zip(lin.slope_rates, changes, strict=True))
    h = np.array([-1e-4, 1e-4])
    for expected, own in ((lin.f_rate[0], np.zeros((4, 2))), (changed, changes)):
        a, b, c, d = s[1] + own[0], sd[1] + own[1], sdd[1] + own[2], own[3]
        motion = [
            np.array([a + x * b + x**2 / 2 * c + x**3 / 6 * d for x in h]),
            np.array([b + x * c + x**2 / 2 * d for x in h]),
            np.array([c + x * d for x in h]),
        ]
        f = other.reduce(ACROSS.sample_at(root + h), rp.CarrierMotion(*motion, check_rates=False), check_track=False).f
        # quadratic terms of the changes are the difference that is left
        np.testing.assert_allclose(lin.lost[0] @ (f[1] - f[0]) / 2e-4, expected, rtol=1e-3, atol=2e-4)
    assert abs(changed - lin.f_rate[0]) > 1.0
    rate = [lin.lost[0] @ other.reduce(ACROSS.sample_at([root + x])).W[0] for x in h]
    np.testing.assert_allclose((rate[1] - rate[0]) / 2e-4, lin.W_rate[0], rtol=1e-5)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"horizon": 0.01}, "has 0.5 steps"),
        ({"objective": "least"}, "objective is"),
        ({"limits": {"effort": 1.0}}, "Limits"),
    ],
)
def test_settings_out_of_their_domain_are_refused(settings, message):
    with pytest.raises(InputError, match=message):
        RecedingHorizon(machine()[0], **in_groups(RecedingHorizon, settings))


def test_ticks_do_not_go_back_in_time():
    planner = RecedingHorizon(machine()[0])
    planner.update(0.1, ACROSS)
    with pytest.raises(InputError, match=r"after one at 0\.1 s"):
        planner.update(0.05, ACROSS)


@pytest.mark.parametrize(
    ("t", "preview", "message"),
    [
        ("soon", ACROSS, "t is 'soon'"),
        (np.nan, ACROSS, "t is nan"),
        (-0.01, ACROSS, "the preview begins at 0 s"),
        (0.1, ACROSS.sample_at(np.linspace(0.0, 0.05, 20)), r"ends at 0\.05 s.*skip"),
        (1.7e9, ACROSS.sample_at, "Count time from the start of the run"),
        (1e18, ACROSS.sample_at, "Count time from the start of the run"),
        (0.0, lambda t: ACROSS.sample_at(t[:1]), "answers for 1"),
        (0.0, lambda t: ACROSS.sample_at(t + 0.1), r"from 0\.1 s on"),
        (0.0, lambda t: None, "not NoneType"),
    ],
)
def test_previews_and_times_that_make_no_sense_are_refused(t, preview, message):
    with pytest.raises(InputError, match=message):
        RecedingHorizon(machine()[0]).update(t, preview)


def test_what_is_not_known_is_not_called_known_and_missed_ticks_go_forward():
    planner = RecedingHorizon(machine()[0])
    command = planner.update(0.05, ACROSS.sample_at(np.linspace(0.0, 0.05, 20)))
    assert command.known_until == 0.05
    for t in (0.0, np.nan):
        with pytest.raises(InputError):
            planner.skip(t)
    for t in (np.nan, [0.1, 0.2], "soon"):
        with pytest.raises(InputError, match="t "):
            command.motion_at(t)
    with pytest.raises(InputError, match="longer than the horizon"):
        run_online(planner, ACROSS, tick=0.6)
    with pytest.raises(InputError, match="effort weighs -1"):
        Weights(effort=-1.0)


@pytest.mark.parametrize(("step", "horizon", "share"), [(5.0, 10.0, 0.5), (0.7, 140.0, 50.0)])
def test_the_longest_step_and_horizon_that_a_refusal_names_are_not_too_long(step, horizon, share):
    planner = RecedingHorizon(machine()[0], step=step, horizon=horizon)
    for speed in np.linspace(0.5, 0.9, 9):
        motion = circle(speed=speed)
        with pytest.raises(InputError, match="Pass at most") as caught:
            run_online(planner, motion)
        most = float(re.search(r"at most (\S+) s", str(caught.value))[1])
        assert 0.99 < most / (share * motion.duration) <= 1.0


def test_no_limit_at_all_is_no_limit():
    planner = RecedingHorizon(
        machine()[0], limits=rp.Limits(acceleration=np.inf, speed=np.inf, track=(-np.inf, np.inf))
    )
    with np.errstate(all="raise"):
        assert planner.update(0.0, ACROSS).status is UpdateStatus.OK


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "number"), [("2rpr", i) for i in range(3, 8)] + [("five_bar", i) for i in (2, 3, 8, 9, 12, 19, 22, 23)]
)
def test_random_paths_are_planned_at_every_tick_and_keep_the_limits(name, number):
    dynamics, other = machine(name)
    trajectory = next(itertools.islice(online.random_paths(name, dynamics), number, None))
    run = run_online(RecedingHorizon(dynamics), trajectory)
    assert run.counts["ok"] == len(run.commands)
    assert run.plan.diagnostics["missing_force"] < 0.01 * np.abs(run.plan.tau).max()
    assert_limits_between_nodes(run.plan, dynamics.robot)
    away = np.abs(np.subtract.outer(run.plan.t, run.plan.findings.singular_instants)).min(axis=1, initial=1.0) > 0.01
    t = run.plan.t[away]
    reduced = other.reduce(trajectory.sample_at(t), run.plan.carriers_at(t), check_track=False)
    tau = np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0]
    np.testing.assert_allclose(run.plan.tau[away], tau, rtol=1e-5, atol=1e-6 * np.abs(tau).max())
