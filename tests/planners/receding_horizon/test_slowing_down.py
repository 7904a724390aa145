"""Slowing down along the path where no plan keeps every limit, judged by the other backend and on a dense grid."""

import copy
import itertools
import json
import re
from dataclasses import replace
from functools import cache

import numpy as np
import online
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.receding_horizon import OnLineRun, Preview, RecedingHorizon, run_online
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, through_points
from redundancy_pin.trajectory.time_scaling import TimeScaling

WEAK = {"acceleration": 2.0}
"""m/s², a fifth of what the carriers can: over the circle at its speed there is no plan within it."""

MISSING = 1e-5
"""Of the largest effort: what other backends may miss of W τ = f away from singular instants."""


@cache
def machine(name: str = "2rpr"):
    masses = {"end_effector_mass": 0.5, "cylinder_mass": 0.3} if name == "2rpr" else {}
    robot = zoo.robot_of(name, **masses)
    return rp.CompiledDynamics(robot), (rp.VirtualWork if name == "2rpr" else rp.RneaDynamics)(robot)


CIRCLE = rp.trajectory.reference.circle(speed=0.5)


@cache
def slowed() -> OnLineRun:
    return run_online(RecedingHorizon(machine()[0], slow_down=True, **in_groups(RecedingHorizon, WEAK)), CIRCLE)


def assert_within(plan, limits) -> None:
    """Check the carriers on a grid ten times as dense as the samples of the plan."""
    carriers = plan.carriers_at(np.linspace(plan.t[0], plan.t[-1], 10 * len(plan.t)))
    assert (carriers.s >= limits.track[:, 0] - 1e-8).all()
    assert (carriers.s <= limits.track[:, 1] + 1e-8).all()
    assert (np.abs(carriers.sd) <= limits.speed * (1.0 + 1e-8)).all()
    assert (np.abs(carriers.sdd) <= limits.acceleration * (1.0 + 1e-6)).all()


def assert_same_path(plan, trajectory, delay: float) -> None:
    """Check that the platform goes through the places of the trajectory in their order, and that its rates are its."""
    t = np.linspace(plan.t[0], plan.t[-1], 4001)
    moved = plan.functions.platform
    assert moved.end == pytest.approx(trajectory.duration + delay, abs=1e-9)
    dense = np.linspace(0.0, trajectory.duration, 20001)
    places = trajectory.sample_at(dense).x
    speed, place = np.linalg.norm(trajectory.sample_at(dense).xd, axis=1).max(), 0
    for x in moved.sample_at(t).x:  # on from where it was, since a path may cross itself
        ahead = np.linalg.norm(places[max(place - 2, 0) : place + 50] - x, axis=1)
        place = max(place - 2, 0) + int(ahead.argmin())
        assert ahead.min() < speed * dense[1]
    np.testing.assert_allclose(moved.sample_at(t[-1:]).x[0], places[-1], atol=1e-9)


def assert_balanced(plan, other) -> None:
    """Check W τ = f by the other backend, away from singular instants, from the platform's motion itself."""
    instants = plan.findings.singular_instants
    t = plan.t[np.abs(np.subtract.outer(plan.t, instants)).min(axis=1, initial=1.0) > 0.01]
    moved = plan.functions.platform
    h = 1e-4
    inner = (t > moved.start + h) & (t < moved.end - h)
    kinks = np.abs(np.subtract.outer(t, moved.kinks)).min(axis=1) > 2.0 * h
    t = t[inner & kinks]
    before, there, after = (moved.sample_at(t + shift).x for shift in (-h, 0.0, h))
    xdd = (after - 2.0 * there + before) / h**2
    assert np.abs(xdd - moved.sample_at(t).xdd).max() < 1e-4 * max(1.0, np.abs(xdd).max())
    reduced = other.reduce(moved.sample_at(t), plan.carriers_at(t), check_track=False)
    tau = np.linalg.solve(reduced.W, reduced.f[..., None])[..., 0]
    planned = plan.tau[np.isin(plan.t, t)]
    np.testing.assert_allclose(planned, tau, rtol=MISSING, atol=MISSING * np.abs(tau).max())


def test_at_full_speed_there_is_no_plan_and_more_slowly_there_is() -> None:
    counts = run_online(RecedingHorizon(machine()[0], **in_groups(RecedingHorizon, WEAK)), CIRCLE).counts
    assert counts["relaxed"] > 0
    run = slowed()
    counts = run.counts
    assert counts["time_scaled"] > 0
    assert counts["time_scaled"] + counts["ok"] == len(run.commands)
    assert run.plan.status.value == "ok"
    assert 0.02 < run.plan.diagnostics["delay"] < 1.0


def test_the_path_is_the_same_within_the_limits_and_balanced() -> None:
    plan = slowed().plan
    assert_within(plan, RecedingHorizon(machine()[0], **in_groups(RecedingHorizon, WEAK)).resolved)
    assert_same_path(plan, CIRCLE, plan.diagnostics["delay"])
    assert_balanced(plan, machine()[1])
    assert plan.diagnostics["missing_force"] < 1e-4


def test_commands_say_where_along_the_preview_the_platform_is() -> None:
    run = slowed()
    plan, speeds = run.plan, []
    for command, after in itertools.pairwise(run.commands):
        if command.scaling is None:
            assert command.status is UpdateStatus.OK
            continue
        t = np.linspace(command.t, after.t, 5)
        sigma, rate, _ = command.scaling.at(t)
        speeds += rate.tolist()
        np.testing.assert_allclose(plan.functions.platform.sample_at(t).x, CIRCLE.sample_at(sigma).x, atol=1e-9)
        slow = min(rate[0], command.scaling.final_rate) < 1.0 - 1e-6
        assert command.status is (UpdateStatus.TIME_SCALED if slow else UpdateStatus.OK)
        assert bool(command.reason) == slow
    assert min(speeds) < 0.9
    assert min(speeds) >= 0.0
    assert max(speeds) <= 1.0 + 1e-12
    assert speeds[-1] == pytest.approx(1.0, abs=1e-9)  # it has caught up with the speed, not with the time


def test_singular_instants_are_told_when_they_are_met_and_not_when_they_were_thought_to_be() -> None:
    plan = slowed().plan
    W = machine()[1].reduce(plan.functions.platform.sample_at(plan.t)).W
    side = np.sign(np.linalg.det(W))
    crossed = plan.t[1:][side[1:] != side[:-1]]
    instants = np.array(plan.findings.singular_instants)
    assert len(instants) == len(crossed)
    assert (np.abs(instants - crossed) < 1.1 * np.diff(plan.t).max()).all()


def test_where_there_is_a_plan_nothing_is_slowed() -> None:
    own, other = (run_online(RecedingHorizon(machine()[0], slow_down=slow), CIRCLE) for slow in (True, False))
    assert own.counts == other.counts
    np.testing.assert_array_equal(own.plan.tau, other.plan.tau)
    np.testing.assert_array_equal(own.plan.carriers.s, other.plan.carriers.s)
    assert own.plan.diagnostics["delay"] == 0.0


def test_a_preview_that_is_a_function_is_asked_in_its_own_time() -> None:
    planner, asked = RecedingHorizon(machine()[0], slow_down=True, **in_groups(RecedingHorizon, WEAK)), []

    def preview(times):
        asked.append(times)
        return CIRCLE.sample_at(np.minimum(times, CIRCLE.duration - 1e-9))

    commands = [planner.update(t, preview) for t in (0.02 * np.arange(40)).tolist()]
    assert {c.status for c in commands} == {UpdateStatus.OK, UpdateStatus.TIME_SCALED}
    last = commands[-1]
    behind = last.t - float(last.scaling.at([last.t])[0][0])
    assert behind > 0.01
    latest = [c.t if c.scaling is None else float(c.scaling.at([c.t])[0][0]) for c in commands]
    assert max(times.max() for times in asked) <= max(latest) + planner.horizon + 1e-9
    assert min(times.min() for times in asked[-3:]) > last.t - behind - 0.021
    assert all((np.diff(times) > 0.0).all() for times in asked)


def out_of_reach(name: str = "five_bar", far: float = 0.5) -> Trajectory:
    home = follower(machine(name)[0].robot).home.x
    path = through_points(home + np.array([[0.0, 0.0], [0.1, 0.05], [0.2, far]]))
    return Trajectory(path, SpeedProfile(path.length, 0.4, 0.3))


@cache
def standing():
    """A planner that has stopped before a pose out of reach, and its commands."""
    motion, planner = out_of_reach(), RecedingHorizon(machine("five_bar")[0], slow_down=True)
    commands = [planner.update(0.0, motion)]
    while final_rate(commands[-1]) > 0.0 or commands[-1].t < commands[-1].scaling.settled + 0.1:
        commands.append(planner.update(0.02 * len(commands), motion))
        assert commands[-1].t < 5.0
    return planner, *commands


def test_before_a_pose_out_of_reach_the_platform_stops_and_stays() -> None:
    motion, (dynamics, other) = out_of_reach(), machine("five_bar")
    with pytest.raises(InfeasiblePlanError, match=r"stands .* leads where the machine cannot go") as refused:
        run_online(RecedingHorizon(dynamics, slow_down=True), motion)
    place = json.loads(str(refused.value).split("go, to ")[1].split("]")[0] + "]")
    still = json.loads("[" + re.findall(r"motion is at ([\d.]+) s: at ([\d.]+) s", str(refused.value))[0][1] + "]")
    np.testing.assert_allclose(motion.sample_at(still).x[0], place, atol=1e-4)
    assert not other.along(motion.sample_at(still), unreachable="mark").reduce().reachable.any()
    planner, *commands = copy.deepcopy(standing())
    commands += [planner.update(0.02 * i, motion) for i in range(len(commands), len(commands) + 60)]
    assert {c.status for c in commands} == {UpdateStatus.OK, UpdateStatus.TIME_SCALED}
    scaling = commands[-1].scaling
    sigma, rate, _ = scaling.at([commands[-1].t])
    assert rate[0] == 0.0
    assert "goes over to 0.0%" in commands[-1].reason
    reached = motion.sample_at(np.linspace(0.0, float(sigma[0]), 40))
    assert other.along(reached, unreachable="mark").reduce().reachable.all()
    beyond = motion.sample_at(np.linspace(float(sigma[0]), motion.duration, 8))
    assert not other.along(beyond, unreachable="mark").reduce().reachable.all()
    # the carriers rest as well, and with them all efforts
    fastest = max(np.abs(command.motion_at(command.t)[1]).max() for command in commands)
    assert np.abs(commands[-1].motion_at(commands[-1].t)[1]).max() < 0.02 * fastest
    assert np.abs(commands[-1].tau).max() < 0.02 * max(np.abs(command.tau).max() for command in commands)


def test_iterations_are_those_of_all_speeds_that_were_tried() -> None:
    """Where no speed will do, full speed is planned for as without slowing down: its iterations come on top."""
    limits = rp.Limits(effort=0.4, acceleration=2.0)
    slows = RecedingHorizon(machine()[0], slow_down=True, limits=limits)
    plain = RecedingHorizon(machine()[0], limits=limits)
    assert slows.update(0.0, CIRCLE).status is plain.update(0.0, CIRCLE).status is UpdateStatus.RELAXED
    tried = slows.updates.last.iterations - plain.updates.last.iterations
    assert tried > 15  # each of some fifteen speeds takes one iteration at least
    assert slows.updates.last.iterations <= 12_160  # the bound that the header of generated code states


def test_limits_that_are_loosened_let_it_go_on() -> None:
    planner = RecedingHorizon(machine()[0], slow_down=True, limits=rp.Limits(acceleration=1.0))
    times = (0.02 * np.arange(150)).tolist()
    slow = next(t for t in times if planner.update(t, CIRCLE).reason.startswith("the platform goes over"))
    tight = planner.update(slow + 0.02, CIRCLE)
    assert tight.scaling.final_rate < 0.9
    planner.limits = Limits()
    later = [planner.update(slow + 0.02 * i, CIRCLE) for i in range(2, 42)]
    assert later[-1].scaling.final_rate == 1.0
    assert later[-1].status is UpdateStatus.OK


def test_a_tick_that_is_missed_says_where_the_platform_is_too() -> None:
    planner = RecedingHorizon(machine()[0], slow_down=True, **in_groups(RecedingHorizon, WEAK))
    commands = [planner.update(t, CIRCLE) for t in (0.02 * np.arange(40)).tolist()]
    assert commands[-1].scaling is not None
    missed = planner.skip(0.8)
    assert missed.status is UpdateStatus.FALLBACK
    assert missed.scaling is commands[-1].scaling


@pytest.mark.long_for("2rpr-0.15-4", "five_bar-0.4-1")
@pytest.mark.parametrize(("name", "share", "seed"), [("2rpr", 0.1, 3), ("2rpr", 0.15, 4), ("five_bar", 0.4, 1)])
def test_random_paths_with_weak_carriers_are_followed_to_their_end(name: str, share: float, seed: int) -> None:
    dynamics, other = machine(name)
    trajectory = next(itertools.islice(online.random_paths(name, dynamics), seed, None))
    weak = [share * limit.acceleration for limit in dynamics.robot.carrier_limits]
    run = run_online(RecedingHorizon(dynamics, slow_down=True, limits=rp.Limits(acceleration=weak)), trajectory)
    assert run.counts["ok"] + run.counts["time_scaled"] == len(run.commands)
    assert run.counts["time_scaled"] > 0
    assert_within(run.plan, RecedingHorizon(dynamics, limits=rp.Limits(acceleration=weak)).resolved)
    assert_same_path(run.plan, trajectory, run.plan.diagnostics["delay"])
    assert_balanced(run.plan, other)


def assert_the_same_motion(command, other) -> None:
    """Check that a command is another's, but for what the cost is flat."""
    assert command.status is other.status
    assert (command.scaling is None) == (other.scaling is None)
    for own, their, near in zip(command.motion_at(other.t), other.motion_at(other.t), (1e-5, 1e-4, 1e-2), strict=True):
        np.testing.assert_allclose(own, their, atol=near)


@pytest.mark.parametrize("fails_at", [18, 22, 42])
def test_a_preview_that_fails_at_an_update_leaves_the_planner_as_it_was(fails_at: int) -> None:
    """What is in sight is that of the speed that commands tell, and not of one that was tried."""
    planner, left = RecedingHorizon(machine()[0], slow_down=True, **in_groups(RecedingHorizon, WEAK)), [10**9]

    def preview(times):
        left[0] -= 1
        if left[0] == 0:
            raise RuntimeError("no answer")
        return CIRCLE.sample_at(np.minimum(times, CIRCLE.duration - 1e-9))

    for i in range(fails_at):
        planner.update(0.02 * i, preview)
    failed = 0
    for i in range(fails_at, fails_at + 5):
        before, left[0] = copy.deepcopy(planner), 2
        try:
            planner.update(0.02 * i, preview)
        except RuntimeError:
            failed += 1
            left[0] = 10**9
            assert_the_same_motion(planner.update(0.02 * i, preview), before.update(0.02 * i, preview))
            assert planner.skip(0.02 * i).scaling is planner.updates.last.command.scaling
    assert failed


@pytest.mark.parametrize("each", [lambda: copy.copy(CIRCLE), lambda: CIRCLE.sample_at])
def test_a_preview_that_is_another_object_at_every_tick_is_followed_as_one(each) -> None:
    """Nodes around singular instants that are past stay, and σ̇ does not change next to those ahead."""
    same, other = (RecedingHorizon(machine()[0], slow_down=True, **in_groups(RecedingHorizon, WEAK)) for _ in range(2))
    for t in (0.02 * np.arange(90)).tolist():
        command, again = same.update(t, CIRCLE), other.update(t, each())
        assert_the_same_motion(again, command)
    own, their = (planner.update(1.8, CIRCLE).scaling.at([1.8])[0] for planner in (same, other))
    assert own == pytest.approx(their, abs=1e-12)


@pytest.mark.parametrize("tick", [20, 30, 35, 50])
def test_a_copy_goes_on_as_the_planner_does(tick: int) -> None:
    planner = RecedingHorizon(machine()[0], slow_down=True, **in_groups(RecedingHorizon, WEAK))
    for i in range(tick):
        planner.update(0.02 * i, CIRCLE)
    other = copy.deepcopy(planner)
    for i in range(tick, tick + 8):
        command, again = planner.update(0.02 * i, CIRCLE), other.update(0.02 * i, CIRCLE)
        assert_the_same_motion(again, command)


def test_planners_that_run_without_end_forget_the_speeds_that_are_past() -> None:
    planner, most = RecedingHorizon(machine()[0], slow_down=True, **in_groups(RecedingHorizon, WEAK)), 0
    there_and_back = 0.45  # s

    def preview(times):
        phase = np.pi * times / there_and_back
        x = np.stack([0.25 + 0.0 * phase, 0.05 + 0.09 * np.sin(phase)], axis=1)
        rate = np.pi / there_and_back
        xd = np.stack([0.0 * phase, 0.09 * rate * np.cos(phase)], axis=1)
        return rp.PlatformMotion(times, x, xd, -(rate**2) * (x - (0.25, 0.05)), check_rates=False)

    for i in range(200):
        command = planner.update(1e3 + 0.02 * i, preview)
        if command.scaling is not None:
            most = max(most, len(command.scaling.curve.edges))
    assert command.status in (UpdateStatus.OK, UpdateStatus.TIME_SCALED)
    assert 2 < most < 12


def test_a_preview_that_begins_too_late_is_told_in_both_times() -> None:
    planner = RecedingHorizon(machine()[0], slow_down=True, **in_groups(RecedingHorizon, WEAK))
    for i in range(40):
        command = planner.update(0.02 * i, CIRCLE)
    own = float(command.scaling.at([0.8])[0][0])
    late = CIRCLE.sample_at(np.linspace(0.8, 1.6, 200))
    with pytest.raises(InputError, match=rf"t = 0.8 s, {own:.6g} s of the preview .* begins at 0.8 s"):
        planner.update(0.8, late)
    on_time = CIRCLE.sample_at(np.linspace(own, 1.6, 200))
    assert planner.update(0.8, on_time).status in (UpdateStatus.OK, UpdateStatus.TIME_SCALED)


def test_a_plan_that_is_too_fast_next_to_its_start_is_none() -> None:
    """The programme does not bound the speed of the first half step, which is given but for s̈ at its end."""
    planner = RecedingHorizon(machine()[0], limits=rp.Limits(speed=0.2))
    planner.update(0.0, CIRCLE)
    for i in range(1, 15):
        planner.update(0.02 * i, CIRCLE)
    last = planner.updates.last.command
    t = last.t + 0.005
    s, _, sdd = last.motion_at(t)
    fast = 0.2 * np.sign(sdd) * (1.0 - 1e-4)  # so that it is beyond within the first half step
    again = copy.deepcopy(planner)
    assert planner.update(t, CIRCLE, s, fast).status is UpdateStatus.RELAXED
    assert again.update(t, CIRCLE).status is UpdateStatus.OK


@pytest.mark.long_for(*"01235")
@pytest.mark.parametrize("seed", range(8))
def test_the_speed_never_leads_back_nor_beyond_that_of_the_preview(seed: int) -> None:
    """Whatever the limits are now: σ, σ̇ and σ̈ go on from where they are, and σ̇ stays between 0 and 1."""
    rng = np.random.default_rng(seed)
    planner, changes = RecedingHorizon(machine()[0], slow_down=True), 0
    before = TimeScaling.none(0.0)
    for t in (0.02 * np.arange(120)).tolist():
        if rng.random() < 0.2:
            planner.limits = Limits(acceleration=float(rng.choice([0.5, 1.0, 2.0, 10.0])))
        scaling = planner.update(t, CIRCLE).scaling or before
        changes += scaling is not before
        for own, their in zip(scaling.at([t]), before.at([t]), strict=True):
            np.testing.assert_allclose(own, their, atol=1e-9)
        _, rate, _ = scaling.at(np.linspace(t, t + 1.0, 500))
        assert rate.min() > -1e-6
        assert rate.max() < 1.0 + 1e-6
        before = scaling
    assert changes > 3


@pytest.mark.long_for("0.3-5-0.07", "0.3-20-0.09")
@pytest.mark.parametrize(("horizon", "first", "near"), [(0.3, 5, 0.07), (0.3, 20, 0.09), (0.5, 10, 0.12)])
def test_a_stop_that_is_called_off_leads_on_and_never_back(horizon: float, first: int, near: float) -> None:
    """The way is blocked at once, and free again when the speed may rise: in the middle of the ramp to rest."""
    planner = RecedingHorizon(
        machine("five_bar")[0], slow_down=True, horizon=horizon, limits=Limits(acceleration=1e3, speed=100.0)
    )
    free = out_of_reach(far=0.12)

    def blocked(times):
        motion = free.sample_at(times)
        away = np.where(times > 0.02 * first + near, 1.0, 0.0)[:, None]
        return rp.PlatformMotion(times, motion.x + away, motion.xd, motion.xdd, check_rates=False)

    for i in range(first + 10):
        command = planner.update(0.02 * i, blocked if first <= i < first + 5 else free)
        if command.scaling is not None:
            _, rate, _ = command.scaling.at(command.t + np.linspace(0.0, 2.0 * horizon, 400))
            assert rate.min() > -1e-9
            assert rate.max() < 1.0 + 1e-9
    assert command.scaling is not None


def final_rate(command) -> float:
    return 1.0 if command.scaling is None else command.scaling.final_rate


@pytest.mark.parametrize("acceleration", [0.1, 0.3, 0.5])
def test_rises_are_five_steps_apart_to_all_of_the_speed_or_by_a_quarter(acceleration: float) -> None:
    planner = RecedingHorizon(machine()[0], slow_down=True, limits=rp.Limits(acceleration=acceleration))
    rises, before = [], 1.0
    for i in range(60):
        now = final_rate(planner.update(0.02 * i, CIRCLE))
        if now > before:
            rises.append((0.02 * i, now, before))
        before = now
    assert len(rises) >= 3
    assert np.diff([at for at, _, _ in rises]).min() > 0.0999
    assert all(any(abs(now - wanted) < 1e-9 for wanted in (1.0, was + 0.25, was + 0.05)) for _, now, was in rises)


@pytest.mark.parametrize("another", [False, True], ids=["in sight", "by the last plan"])
def test_next_to_a_singular_instant_the_speed_does_not_change(another: bool) -> None:
    """Up to half a step behind it σ is what it was, though another preview has not come into sight yet."""
    near, circle = 0, rp.trajectory.reference.circle(speed=0.75)
    planner = RecedingHorizon(machine()[0], slow_down=True, limits=rp.Limits(acceleration=1.0))
    before, singular = TimeScaling.none(0.0), np.empty(0)
    for t in (0.02 * np.arange(75)).tolist():
        command = planner.update(t, copy.copy(circle) if another else circle)
        scaling = command.scaling or before
        coming = singular[(singular > t - 0.02) & (singular < t + 0.05)]
        if scaling is not before and len(coming):
            times = np.linspace(t - 0.02, coming.max() + 0.0099, 50)
            np.testing.assert_allclose(scaling.at(times)[0], before.at(times)[0], atol=1e-12)
            near += 1
        before, singular = scaling, command.singular
    assert near


def test_jumps_of_a_preview_are_met_by_the_clock() -> None:
    """Efforts have both sides of a jump of ẍ, 20 ns apart, where the platform is slower than its preview too."""
    preview = replace(Preview.of(CIRCLE), breaks=np.arange(0.0713, 1.5, 0.0713))
    planner, met = RecedingHorizon(machine()[0], slow_down=True, **in_groups(RecedingHorizon, WEAK)), 0
    for t in (0.02 * np.arange(60)).tolist():
        command = planner.update(t, preview)
        if command.scaling is None or command.status is not UpdateStatus.TIME_SCALED:
            continue
        for at in map(command.scaling.time_at, preview.breaks.tolist()):
            if t + 0.006 < at < t + 0.055:
                edges = command.efforts.edges
                assert np.abs(edges - (at - 1e-8)).min() < 1e-9
                assert np.abs(edges - (at + 1e-8)).min() < 1e-9
                met += 1
    assert met > 0


@pytest.mark.parametrize(
    ("s", "sd"), [(0.1501, 0.0), (0.151, 0.0), (0.1, 0.31)], ids=["off the track", "far off the track", "too fast"]
)
def test_a_start_beyond_a_limit_leaves_a_planner_that_goes_on(s: float, sd: float) -> None:
    """No slower motion keeps every limit at such a start; the first plan that is kept says what all is divided by."""
    dynamics = rp.CompiledDynamics(rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3))
    planner = RecedingHorizon(dynamics, slow_down=True, limits=rp.Limits(track=(-0.15, 0.15), speed=0.3))
    first = planner.update(0.0, CIRCLE, [s, s], [sd, sd])
    assert first.status is UpdateStatus.RELAXED
    later = [planner.update(0.02 * i, CIRCLE, [0.1, 0.1], [0.0, 0.0]) for i in range(1, 6)]
    assert all(command.status in (UpdateStatus.OK, UpdateStatus.TIME_SCALED) for command in later)


@pytest.mark.parametrize("late", [0.0, 0.5e-9])
def test_a_platform_that_stands_goes_on_with_a_preview_that_begins_there(late: float) -> None:
    """Where its time is (``Command.scaling``), or within rounding later; the first one leads out of reach."""
    planner, *commands = copy.deepcopy(standing())
    command, t = commands[-1], commands[-1].t
    own = float(command.scaling.at([t])[0][0])
    place = out_of_reach().sample_at([own]).x[0]

    def back(times):
        u = np.maximum(times - own, 0.0)
        x = np.stack([place[0] - 0.1 * (1.0 - np.cos(u)), np.full(len(u), place[1])], axis=1)
        xd, xdd = (np.stack([-0.1 * part, 0.0 * u], axis=1) for part in (np.sin(u), np.cos(u)))
        return rp.PlatformMotion(times, x, xd, xdd, check_rates=False)

    ahead = Preview(back, own + late, own + 100.0)
    commands = [planner.update(t + 0.02 * i, ahead) for i in range(1, 60)]
    assert {c.status for c in commands} <= {UpdateStatus.OK, UpdateStatus.TIME_SCALED}
    assert final_rate(commands[-1]) > 0.0
