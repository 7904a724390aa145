"""The stop behind a plan, what a plan begins with, which starts are beyond limits, and settings of the planner."""

from __future__ import annotations

import copy
import time
from typing import Any

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory import RestToRest, SpeedProfile, Trajectory
from redundancy_pin.trajectory.paths import Line, circle_path

_ARC = circle_path((0.25, 0.05), 0.09, start_angle=np.pi, sweep=np.pi)
ACROSS = Trajectory(_ARC, SpeedProfile(_ARC.length, 0.45, 0.2))
"""Over the singular line and back."""

STEP = 0.02


def planner_of(**settings: Any) -> RecedingHorizon:
    robot = rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)
    return RecedingHorizon(rp.CompiledDynamics(robot), step=STEP, **in_groups(RecedingHorizon, settings))


@pytest.mark.parametrize("acceleration", [(0.5, 6.0), (3.0, 0.7), (2.0, 2.0), (np.inf, 2.0)])
def test_behind_a_plan_every_carrier_slows_down_as_fast_as_it_can(acceleration: tuple[float, float]) -> None:
    planner, later = planner_of(acceleration=acceleration, horizon=0.1), []
    for i in range(20):
        carriers = planner.update(STEP * i, ACROSS).carriers
        last = float(planner.updates.last.nodes[-1])
        begins, speeds = carriers.at(last), carriers.derivative()(np.array([last]), "left")[0]
        later.append(np.abs(speeds))
        durations = np.where(np.abs(speeds) > 1e-9 * np.array(acceleration), np.abs(speeds) / acceleration, 0.0)
        assert carriers.end == pytest.approx(last + durations.max(), abs=1e-12)
        for t in np.linspace(last, carriers.end, 31)[1:-1]:
            after = np.minimum(t - last, durations)
            slows = -np.sign(speeds) * np.where(np.isfinite(acceleration), acceleration, 0.0)
            place, speed = begins + speeds * after + 0.5 * slows * after**2, speeds + slows * after
            moves = t - last < durations
            np.testing.assert_allclose(carriers.at(float(t)), place, atol=1e-9)
            np.testing.assert_allclose(carriers.derivative().at(float(t)), speed * moves, atol=1e-9)
            clear = np.abs(t - last - durations) > 1e-9
            np.testing.assert_allclose(carriers.derivative(2).at(float(t))[clear], (slows * moves)[clear], atol=1e-9)
    assert (np.max(later, axis=0) > 0.01).all()


@pytest.mark.parametrize(("horizon", "fits"), [(1.99, False), (2.0, True), (200.0, True), (201.0, False)])
def test_a_horizon_has_two_to_two_hundred_steps(horizon: float, fits: bool) -> None:
    if fits:
        planner_of(horizon=horizon * STEP)
        return
    with pytest.raises(InputError, match=f"has {horizon:g} steps of 0.02 s"):
        planner_of(horizon=horizon * STEP)


@pytest.mark.long_for("2", "10", "12", "60")
@pytest.mark.parametrize("steps", [2, 7, 10, 12, 25, 60])
def test_nodes_reach_beyond_the_horizon_by_those_kept_for_singular_instants(steps: int) -> None:
    """Steps apart, from ten on two; where there is no singular instant and no turn eight nodes are left over."""
    planner = RecedingHorizon(rp.CompiledDynamics(rp.load_robot("3rrr")), step=STEP, horizon=steps * STEP)
    line = Line((0.0, 0.0, 0.0), (0.04, 0.03, 0.0))
    command = planner.update(0.0, Trajectory(line, RestToRest(line.length, 3.0)))
    edges = command.carriers.edges
    near = min(steps, 10)
    expected = near + (steps - near) // 2 + 8
    stop = command.carriers.derivative(3)(edges[:-1])
    assert np.isfinite(stop).all()
    first = min(expected, 10)
    nodes = STEP * np.concatenate([np.arange(first + 1), 10 + 2 * np.arange(1, expected - first + 1)])
    np.testing.assert_allclose(edges[: len(nodes)], nodes, atol=1e-9)
    # behind them there is the stop alone, no later than the slowest carrier stands
    assert len(edges) <= len(nodes) + 3


@pytest.mark.parametrize("carrier", [0, 1])
@pytest.mark.parametrize("beyond", [0.5e-6, 1.5e-6])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_a_start_counts_as_beyond_the_limits_by_more_than_a_millionth(carrier: int, beyond: float, side: float) -> None:
    track, speed = np.array([(-0.1, 0.2), (-0.3, 0.15)]), np.array([0.5, 0.9])
    for part in ("place", "speed"):
        s, sd = np.zeros(2), np.zeros(2)
        if part == "place":
            s[carrier] = track[carrier][int(side > 0.0)] + side * beyond
        else:
            sd[carrier] = side * (speed[carrier] + beyond)
        command = planner_of(track=track, speed=speed).update(0.0, ACROSS, s, sd)
        assert (command.reason == "no plan keeps every limit") == (beyond > 1e-6)
        assert (command.status is UpdateStatus.RELAXED) == (beyond > 1e-6 or part == "speed")


def test_ticks_say_how_long_they_took() -> None:
    planner, began = planner_of(), time.perf_counter()
    command = planner.update(0.06, ACROSS)
    assert 0.0 < command.seconds <= time.perf_counter() - began


def test_one_instant_that_is_known_has_efforts_for_a_step() -> None:
    planner = planner_of()
    efforts = planner.update(0.05, ACROSS.sample_at(np.linspace(0.0, 0.05, 20))).efforts
    assert efforts.start == 0.05
    assert efforts.end == pytest.approx(0.05 + STEP)
    np.testing.assert_array_equal(efforts.at(0.05), efforts.at(0.06))


def test_a_pose_out_of_reach_at_the_very_end_of_the_horizon_is_refused() -> None:
    dynamics = rp.CompiledDynamics(rp.load_robot("five_bar", carriers=True))
    home = zoo.home_of(dynamics.robot)
    path = Line(tuple(home), (home[0], home[1] + 0.9))
    away = Trajectory(path, SpeedProfile(0.9, 0.4, 0.2))
    first = RecedingHorizon(dynamics).update(0.3, away)
    assert first.status is UpdateStatus.REFUSED
    lost = float(first.reason.split("t = ")[1].split()[0])
    # the horizon is 0.5 s of first updates that are made later and later
    ends = np.array([lost - STEP, lost - 0.4 * STEP, lost, lost + STEP])
    statuses = [RecedingHorizon(dynamics).update(float(end - 0.5), away).status for end in ends]
    assert [status is UpdateStatus.REFUSED for status in statuses] == [False, False, True, True]


CORNER = rp.trajectory.reference.corner(radius=0.025)
"""Its arc is from 0.8 s to 0.996 s; between them the platform turns."""


@pytest.mark.parametrize("far", [False, True])
@pytest.mark.parametrize("kind", [lambda: CORNER, lambda: CORNER.sample_at, lambda: copy.copy(CORNER)])
def test_nodes_are_half_as_far_apart_where_the_platform_turns(far: bool, kind: Any) -> None:
    """Ten milliseconds next to the start and twenty farther ahead, whatever is shown."""
    planner = RecedingHorizon(rp.CompiledDynamics(rp.load_robot("3rrr")))
    preview = kind()
    for i in (24, 25) if far else (44, 45):
        planner.update(STEP * i, preview if kind() is CORNER else kind())
    nodes = planner.updates.last.nodes
    start = nodes[0]
    steps = np.diff(nodes)
    at = 0.5 * (nodes[1:] + nodes[:-1])
    turns = np.abs(np.subtract.outer(at, [0.8, CORNER.breaks[1]])).min(axis=1)
    near = at < start + 10 * STEP
    turned = ~near & (turns < STEP) & (at < start + 0.5) if far else near & (turns < 0.5 * STEP)
    assert turned.any()
    assert (steps[turned] < (1.01 if far else 0.51) * STEP).all()
    calm = near & (turns > 4.0 * STEP)
    assert (steps[calm] > 0.99 * STEP).all()


def test_turns_and_singular_instants_that_are_long_past_are_forgotten() -> None:
    """A preview that is a function is read anew each time, and what was kept of it does not grow."""
    robot = rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)
    planner, rate = RecedingHorizon(rp.CompiledDynamics(robot)), 5.0

    def preview(times: Any) -> rp.PlatformMotion:
        phase, still = rate * times, 0.0 * times
        x = np.stack([0.25 + still, 0.07 * np.sin(phase)], axis=1)
        xd = np.stack([still, 0.07 * rate * np.cos(phase)], axis=1)
        return rp.PlatformMotion(times, x, xd, -(rate**2) * (x - (0.25, 0.0)), check_rates=False)

    most = 0
    for i in range(250):
        planner.update(0.02 * i, preview)
        most = max(most, len(planner.updates.roots) + len(planner.updates.sharp))
    assert 1 <= most < 8


def test_where_nothing_can_be_reached_is_no_turn_and_spoils_no_later_one() -> None:
    dynamics = rp.CompiledDynamics(rp.load_robot("five_bar", carriers=True))
    home = zoo.home_of(dynamics.robot)
    away = Line(tuple(home), (home[0], home[1] + 0.9))
    planner = RecedingHorizon(dynamics)
    planner.update(0.0, Trajectory(away, SpeedProfile(away.length, 1.6, 0.2)))
    assert not len(planner.updates.sharp[planner.updates.sharp > 0.5])
    first = planner.update(STEP, Trajectory(away, SpeedProfile(away.length, 1.6, 0.2)))
    assert first.status is UpdateStatus.REFUSED


def test_many_turns_leave_a_plan_its_horizon() -> None:
    """A hand that trembles turns every 50 ms: three of these turns have finer nodes, and plans reach nearly as far."""
    robot = rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)
    planner = RecedingHorizon(rp.CompiledDynamics(robot), horizon=0.5)

    def preview(times: Any) -> rp.PlatformMotion:
        w = 2.0 * np.pi * 10.0
        x = np.stack([0.25 + 0.1 * times, 0.2 + 1e-3 * np.sin(w * times)], axis=1)
        xd = np.stack([0.1 + 0.0 * times, 1e-3 * w * np.cos(w * times)], axis=1)
        xdd = np.stack([0.0 * times, -1e-3 * w**2 * np.sin(w * times)], axis=1)
        return rp.PlatformMotion(times, x, xd, xdd, check_rates=False)

    for i in range(10):
        planner.update(0.02 * i, preview)
        assert len(planner.updates.sharp) > 3
        assert planner.updates.last.nodes[-1] >= 0.02 * i + 0.46


@pytest.mark.parametrize("early", [0.0, 1e-4, -1e-4, 0.5 * STEP])
def test_efforts_are_exact_for_three_steps_of_a_clock_that_is_early_or_late(early: float) -> None:
    """At every instant of the grid up to the last node within three steps and a hundredth."""
    planner = planner_of()
    planner.update(0.0, ACROSS)
    t = 15 * STEP - early
    edges = planner.update(t, ACROSS).efforts.edges
    last = STEP * np.floor((t + 3.0 * STEP + 0.01 * STEP) / STEP + 1e-9)
    grid = 0.125 * STEP * np.arange(np.ceil(t / (0.125 * STEP) + 1e-9), np.round(last / (0.125 * STEP)) + 1)
    grid = grid[grid > t + 0.1 * 0.125 * STEP]  # those next to a node are left out
    assert last > t + 2.0 * STEP
    assert np.abs(edges[:, None] - grid).min(axis=0).max() < 1e-9
    assert (edges[edges > last + 1e-9] - edges[np.flatnonzero(edges > last + 1e-9) - 1]).min() > 0.2 * STEP
