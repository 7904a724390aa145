"""What a tick does step by step: where plans begin, how many programmes they take, what is made of a solution."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import make_interp_spline

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.planners.receding_horizon import PlanningStatus, RecedingHorizon
from redundancy_pin.planners.receding_horizon.ahead import Linearised
from redundancy_pin.planners.receding_horizon.command import Command, extended
from redundancy_pin.planners.receding_horizon.programme import Programme, TickProblem, units_of
from redundancy_pin.trajectory import SpeedProfile, Trajectory
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import circle_path

pytest.importorskip("piqp")

_ARC = circle_path((0.25, 0.05), 0.09, start_angle=np.pi, sweep=np.pi)
ACROSS = Trajectory(_ARC, SpeedProfile(_ARC.length, 0.45, 0.2))
"""Over the singular line and back."""

STEP = 0.02
NEAR, SETTLED, CONVERGED = 0.25, 2.0, 2.5
"""Steps before a singular instant in which a plan begins there, goes on from the last one, has several rounds."""

FINER = 1e-4
"""s, between samples of what is integrated by trapezia."""


@cache
def backends() -> tuple[rp.CompiledDynamics, rp.VirtualWork]:
    robot = rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)
    return rp.CompiledDynamics(robot), rp.VirtualWork(robot)


def planner_of(**settings: Any) -> RecedingHorizon:
    return RecedingHorizon(backends()[0], step=STEP, **settings)


@cache
def first_round() -> Any:
    """The plan of a first tick."""
    planner = planner_of()
    planner.update(0.2, ACROSS)
    return planner._last


# a stop behind the plan, and motions to begin with


@pytest.mark.parametrize(
    ("speeds", "acceleration"),
    [
        ((0.4, -0.9), (0.5, 6.0)),
        ((-0.4, 0.9), (3.0, 0.7)),
        ((0.3, 0.3), (2.0, 2.0)),  # at rest at the same time
        ((0.0, 0.5), (2.0, 2.0)),
        ((0.0, 0.0), (2.0, 2.0)),
        ((1e-6, -0.5), (2.0, 2.0)),  # half a microsecond: it stands
        ((4e-6, -0.5), (2.0, 2.0)),  # two: it stops
        ((0.3, -0.5), (np.inf, 2.0)),
    ],
)
def test_behind_a_plan_every_carrier_slows_down_as_fast_as_it_can(
    speeds: tuple[float, float], acceleration: tuple[float, float]
) -> None:
    planner = planner_of(acceleration=acceleration)
    nodes, end = np.array([1.0, 1.02, 1.05]), np.array(speeds)
    rng = np.random.default_rng(1)
    sdd = rng.uniform(-5.0, 5.0, (3, 2))
    h = np.diff(nodes)[:, None]
    # backwards from the end: s̈ is linear between the nodes
    sd = end - np.vstack([np.cumsum((h * (sdd[1:] + sdd[:-1]) / 2)[::-1], axis=0)[::-1], np.zeros((1, 2))])
    s = rng.uniform(-0.1, 0.1, 2) + np.vstack(
        [np.zeros((1, 2)), np.cumsum(h * sd[:-1] + h**2 * (sdd[:-1] / 3 + sdd[1:] / 6), axis=0)]
    )
    carriers = planner._with_stop(nodes, s, sd, sdd)
    durations = np.abs(end) / acceleration
    durations[durations < 1e-6] = 0.0
    assert carriers.start == 1.0
    assert carriers.end == pytest.approx(1.05 + durations.max(), abs=1e-15)
    for j in range(2):
        spline = make_interp_spline(nodes, sdd[:, j], 1)
        a = -np.sign(end[j]) * acceleration[j] if durations[j] > 0.0 else 0.0
        moving = end[j] if durations[j] > 0.0 else 0.0
        for t in np.linspace(1.0, carriers.end, 57):
            found = [carriers.derivative(i).at(float(t))[j] if i else carriers.at(float(t))[j] for i in range(3)]
            if t < 1.05:
                speed = sd[0, j] + spline.integrate(1.0, t)
                place = s[0, j] + (t - 1.0) * sd[0, j] + spline.antiderivative(2)(t)
                np.testing.assert_allclose(found, [place, speed, spline(t)], atol=1e-12)
            elif abs(t - 1.05 - durations[j]) > 1e-12:
                after = min(t - 1.05, durations[j])
                slows = t - 1.05 < durations[j]
                place = s[-1, j] + moving * after + 0.5 * a * after**2
                np.testing.assert_allclose(
                    found, [place, (moving + a * after) * slows, a * slows], atol=1e-12 * max(1.0, abs(a))
                )


def test_other_motions_to_begin_with_come_to_rest_nearby_in_the_middle_and_towards_the_corners() -> None:
    track = np.array([(-0.1, 0.3), (-0.2, 0.1)])
    planner, last = planner_of(track=track, acceleration=(4.0, 7.0)), first_round()
    t, until, (s, sd, sdd) = 0.31, 0.7, last.command.motion_at(0.31)
    assert np.abs(sd).min() > 1e-3
    middle, half = track.mean(axis=1), 0.5 * np.diff(track)[:, 0]
    nearby = s + np.sign(sd) * sd**2 / (2.0 * np.array([4.0, 7.0]))  # where full braking ends
    corners = [middle + 0.6 * half * np.array(side) for side in product((-1.0, 1.0), repeat=2)]
    for target in (nearby, middle, *corners, nearby, middle):
        guess = planner._guess(t, until, last)
        begins, ends = (guess.command.motion_at(float(time)) for time in (t, until))
        for part, wanted in zip((*begins, *ends), (s, sd, sdd, target, 0.0 * s, 0.0 * s), strict=True):
            np.testing.assert_allclose(part, wanted, atol=1e-9)
        assert not guess.multipliers.any()
        assert guess.multipliers.shape == last.multipliers.shape


def test_without_a_track_a_motion_to_begin_with_stays_where_the_carriers_are() -> None:
    planner, last = planner_of(track=[(-np.inf, 0.3), (-0.2, 0.1)]), first_round()
    s = last.command.motion_at(0.31)[0]
    ends = [planner._guess(0.31, 0.7, last).command.motion_at(0.7)[0] for _ in range(6)]
    np.testing.assert_allclose([end[0] for end in ends[1:]], s[0], atol=1e-12)
    np.testing.assert_allclose(sorted({round(end[1], 9) for end in ends[1:]}), [-0.14, -0.05, 0.04])


# rounds


def scripted(
    monkeypatch: pytest.MonkeyPatch, planner: RecedingHorizon, answers: list[tuple[float, PlanningStatus]]
) -> tuple[list[Any], list[Any]]:
    """Have the programmes of a tick miss so much of f; return what they were about, and what they brought."""
    about: list[Any] = []
    made: list[Any] = []
    rng, last = np.random.default_rng(1), first_round()

    def plan(t: float, until: float, given: Any, before: Any) -> Any:
        left, status = answers[len(made)]
        about.append(before)
        own = tuple(rng.uniform(-1.0, 1.0, part.shape) for part in last.at)
        command = replace(last.command, status=status)
        made.append(
            replace(
                last, command=command, left=left, at=own, multipliers=rng.uniform(-1.0, 1.0, last.multipliers.shape)
            )
        )
        return made[-1]

    monkeypatch.setattr(planner, "_plan", plan)
    return about, made


PLANNED, ELASTIC, FALLBACK = PlanningStatus.PLANNED, PlanningStatus.ELASTIC, PlanningStatus.FALLBACK
FINE = (1e-4, PLANNED)


@pytest.mark.parametrize(
    ("first", "answers", "count", "best"),
    [
        pytest.param(True, [FINE] * 8, 3, 2, id="three at first"),
        pytest.param(False, [FINE] * 8, 1, 0, id="one is enough"),
        pytest.param(False, [(1e-2, PLANNED)] + [FINE] * 8, 1, 0, id="a hundredth is linear"),
        pytest.param(False, [(1.1e-2, PLANNED)] + [FINE] * 8, 2, 1, id="more is not"),
        pytest.param(True, [(0.09, PLANNED)] * 3 + [FINE] * 8, 4, 3, id="three at first and one more"),
        pytest.param(False, [(0.08 - 0.005 * i, PLANNED) for i in range(9)], 8, 7, id="eight at most"),
        pytest.param(False, [(0.5, ELASTIC), (0.4, ELASTIC), (0.3961, ELASTIC)], 3, 2, id="no nearer"),
        pytest.param(False, [(0.5, ELASTIC), (0.4, ELASTIC), (0.39, ELASTIC), (0.39, ELASTIC)], 4, 3, id="nearer"),
        pytest.param(False, [(0.03, PLANNED)] * 9, 8, 7, id="a plan may be as far"),
        pytest.param(False, [(0.5, FALLBACK)] + [FINE] * 8, 1, 0, id="no answer"),
        pytest.param(False, [(0.02, ELASTIC), (0.02, ELASTIC)], 2, 1, id="as near as it may be in doubt"),
    ],
)
def test_a_tick_has_as_many_programmes_as_it_takes(
    monkeypatch: pytest.MonkeyPatch, first: bool, answers: Any, count: int, best: int
) -> None:
    planner = planner_of()
    about, made = scripted(monkeypatch, planner, answers)
    last = None if first else first_round()
    found = planner._rounds(0.2, 0.7, (None, None), last)
    assert len(made) == count
    assert found is made[best]
    # each about the one before
    assert about[0] is last
    assert all(a is b for a, b in zip(about[1:], made, strict=False))


def test_a_programme_that_is_farther_off_is_followed_by_one_about_the_plan_halfway(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    planner = planner_of()
    lefts = [0.05, 0.2, 0.06, 0.04, 0.009]
    about, made = scripted(monkeypatch, planner, [(left, PLANNED) for left in lefts])
    found = planner._rounds(0.2, 0.7, (None, None), first_round())
    assert found is made[4]
    assert about[1] is made[0]
    for place, other in ((2, 1), (3, 2)):
        for part, own, their in zip(about[place].at, made[0].at, made[other].at, strict=True):
            np.testing.assert_allclose(part, 0.5 * (own + their), rtol=1e-12)
        mean = 0.5 * (made[0].multipliers + made[other].multipliers)
        np.testing.assert_allclose(about[place].multipliers, mean, rtol=1e-12)
        assert about[place].command is made[other].command
    assert about[4] is made[3]


def test_farther_off_within_a_hundredth_is_no_farther(monkeypatch: pytest.MonkeyPatch) -> None:
    """Where a singular instant is near and f is not yet exact there, there is another round all the same."""
    planner = planner_of()
    planner._sizes = tick_sizes()
    about, made = scripted(monkeypatch, planner, [(1e-4, PLANNED), (5e-3, PLANNED), (1e-3, PLANNED)])
    monkeypatch.setattr(planner, "_is_settled", lambda t, plan: len(made) > 2)
    assert planner._rounds(0.2, 0.7, (None, None), first_round()) is made[2]
    assert about[2] is made[1]


def tick_sizes() -> Any:
    planner = planner_of()
    planner.update(0.2, ACROSS)
    return planner._sizes


@pytest.mark.parametrize(("left", "softened"), [(0.1, False), (0.11, True)])
def test_a_plan_that_misses_a_tenth_of_f_ahead_is_called_elastic(
    monkeypatch: pytest.MonkeyPatch, left: float, softened: bool
) -> None:
    planner = planner_of()
    scripted(monkeypatch, planner, [(left, PLANNED)] * 8)
    command = planner._rounds(0.2, 0.7, (None, None), first_round()).command
    assert (command.status is ELASTIC) == softened
    assert command.reason == ("ahead 11% of the force is missing" if softened else "")


def test_an_elastic_programme_counts_as_a_tenth_off_at_least() -> None:
    for left, status, doubt in (
        (0.03, PLANNED, 0.03),
        (0.03, ELASTIC, 0.1),
        (0.3, ELASTIC, 0.3),
        (0.03, FALLBACK, 0.1),
    ):
        plan = first_round()
        assert replace(plan, left=left, command=replace(plan.command, status=status)).doubt == doubt


def test_next_to_a_singular_instant_f_is_met_to_a_millionth() -> None:
    planner, plan, t = planner_of(), first_round(), 0.2
    planner._sizes = tick_sizes()
    exact = 1e-6 * planner._sizes.row.max()
    for ahead, near in (((-1e-4,), False), ((1e-4,), True), ((2.4 * STEP,), True), ((2.6 * STEP,), False), ((), False)):
        for residual, met in ((0.9 * exact, True), (1.1 * exact, False)):
            for left in (0.009, 0.011):
                command = replace(plan.command, t=t, singular=t + np.array(ahead), residual=residual, status=PLANNED)
                settled = planner._is_settled(t, replace(plan, command=command, left=left))
                assert settled == (left < 0.01 and (met or not near))
    for status, settled in ((ELASTIC, False), (FALLBACK, True), (PlanningStatus.REFUSED, True)):
        command = replace(plan.command, status=status)
        assert planner._is_settled(t, replace(plan, command=command, left=1.0)) == settled


@pytest.mark.parametrize(("other", "taken"), [(0.2, True), (0.31, False)])
def test_an_elastic_plan_is_tried_from_elsewhere_too_and_the_nearer_one_counts(
    monkeypatch: pytest.MonkeyPatch, other: float, taken: bool
) -> None:
    planner = planner_of()
    planner.update(0.2, ACROSS)
    last, asked = planner._last, []
    assert last is not None
    plans = [
        replace(last, command=replace(last.command, status=ELASTIC, peak=float(i)), left=left)
        for i, left in enumerate((0.3, other))
    ]

    def rounds(t: float, until: float, given: Any, about: Any) -> Any:
        asked.append(about)
        return plans[len(asked) - 1]

    monkeypatch.setattr(planner, "_rounds", rounds)
    command = planner.update(0.22, ACROSS)
    assert command.peak == float(taken)
    assert asked[0] is last
    assert len(asked) == 2
    assert not asked[1].multipliers.any()  # another motion to begin with


def test_the_largest_effort_so_far_is_that_of_each_step_until_the_next_tick(monkeypatch: pytest.MonkeyPatch) -> None:
    planner, plan, largest = planner_of(), first_round(), 0.0
    for t, peak in ((0.2, 3.0), (0.22, -5.0), (0.24, 4.0)):
        # as high in the middle of the step, and higher right before and behind it
        times = t + STEP * np.array([-1.0, 0.0, 0.5, 1.0, 1.1, 9.0])
        values = np.outer([2.0, 0.5, 1.0, 0.5, 0.5, 3.0], [peak, 0.1])
        command = replace(plan.command, t=t, status=ELASTIC, efforts=PiecewisePolynomial.linear(times, values))
        made = replace(plan, command=command)
        monkeypatch.setattr(planner, "_rounds", lambda *ask, made=made: made)
        planner.update(t, ACROSS)
        largest = max(largest, abs(peak))
        assert planner.largest == pytest.approx(largest)


# ticks of a machine, all of what they ask and answer


@dataclass
class Asked:
    """What was asked of a programme, and what was made of the solution."""

    t: float
    until: float
    given: tuple[Array | None, ...]
    about: Any
    last: Command | None
    lin: Linearised
    multipliers: Array
    problem: TickProblem
    solution: Any
    sizes: Any
    roots: Array
    made: Any


@cache
def asked() -> tuple[RecedingHorizon, list[Asked]]:
    """Ticks across a singular instant with carriers a little beside the plan, and one next to the instant."""
    planner, seen = planner_of(), []
    now: dict[str, Any] = {}
    plan, about, solve = RecedingHorizon._plan, Linearised.about, Programme.solve

    def linear(ahead: Any, nodes: Any, singular: Any, at: Any, multipliers: Any, until: float) -> Linearised:
        now["lin"], now["multipliers"] = about(ahead, nodes, singular, at, multipliers, until), multipliers.copy()
        return now["lin"]

    def solved(self: Programme, problem: TickProblem) -> Any:
        now["problem"], now["solution"] = problem, solve(self, problem)
        return now["solution"]

    def planned(self: RecedingHorizon, t: float, until: float, given: Any, before: Any) -> Any:
        made = plan(self, t, until, given, before)
        roots, last = self._ahead.roots.copy(), self._last.command if self._last else None
        seen.append(Asked(t, until, given, before, last, sizes=self._sizes, roots=roots, made=made, **now))
        return made

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Linearised, "about", staticmethod(linear))
        patch.setattr(Programme, "solve", solved)
        patch.setattr(RecedingHorizon, "_plan", planned)
        root = rp.find_crossings(backends()[0].robot, ACROSS)[0].t
        times = [0.06, 0.08, root - 4.0 * STEP, root - 2.1 * STEP, root - 1.9 * STEP, root - 0.6 * STEP]
        times += [root - 0.26 * STEP, root - 0.24 * STEP, root + 0.1 * STEP, root + STEP]
        rng = np.random.default_rng(3)
        for i, t in enumerate(times):
            if i == 0:
                command = planner.update(t, ACROSS, [0.01, -0.02], [0.05, 0.03])
                continue
            s, sd, _ = command.motion_at(t)
            beside = s + 1e-4 * rng.uniform(-1.0, 1.0, 2), sd + 1e-3 * rng.uniform(-1.0, 1.0, 2)
            measured = (beside, (beside[0], None), (None, beside[1]), (None, None))[(0, 0, 1, 0, 0, 2, 3, 0, 2, 0)[i]]
            command = planner.update(t, ACROSS, *measured)
    return planner, seen


def test_plans_begin_where_the_carriers_are_and_next_to_a_singular_instant_where_the_last_plan_is() -> None:
    _, seen = asked()
    starts = []
    for tick in seen:
        coming = tick.roots[tick.roots > tick.t - 1e-9]
        away = (coming[0] - tick.t) / STEP if len(coming) else np.inf
        start = float(coming[0]) if tick.last is not None and away <= NEAR else tick.t
        assert tick.lin.nodes[0] == start
        (s, sd, sdd), k = tick.problem.first, 2
        assert tick.problem.free == (tick.last is None)
        assert (tick.problem.step, tick.problem.horizon) == (STEP, 0.5)
        if tick.last is None:
            np.testing.assert_array_equal((s, sd, sdd), ([0.01, -0.02], [0.05, 0.03], np.zeros(k)))
            continue
        own = [part[0] for part in extended(tick.last.carriers, np.array([start]))]
        expected = [
            planned if part is None or away <= SETTLED else part
            for part, planned in zip((*tick.given, None), own, strict=True)
        ]
        np.testing.assert_array_equal((s, sd, sdd), expected)
        starts.append((start > tick.t, away <= SETTLED, tick.given[0] is None, tick.given[1] is None))
    assert {True, False} == {at_root for at_root, *_ in starts}
    assert {True, False} == {settled for _, settled, *_ in starts}


def test_f_is_linear_about_the_plan_before_with_the_multipliers_of_the_nodes_that_both_have() -> None:
    _, seen = asked()
    kept = []
    for tick in seen:
        nodes = tick.lin.nodes
        if tick.about is None:
            assert tick.last is None
            for part, first in zip(tick.lin.at, tick.problem.first, strict=True):
                np.testing.assert_array_equal(part, np.tile(first, (len(nodes), 1)))
            assert not tick.multipliers.any()
            continue
        again = tick.about.command.t == tick.t and np.array_equal(tick.about.nodes, nodes)
        at = tick.about.at if again else extended(tick.about.command.carriers, nodes)
        np.testing.assert_array_equal(tick.lin.at, at)
        expected = np.zeros_like(tick.multipliers)
        for i, own in enumerate(nodes):
            for j, their in enumerate(tick.about.nodes):
                if abs(own - their) <= 1e-9:
                    expected[i] = tick.about.multipliers[j]
        np.testing.assert_array_equal(tick.multipliers, expected)
        kept.append((again, np.any(expected, axis=1).mean()))
    assert {True, False} == {again for again, _ in kept}
    assert min(share for again, share in kept if not again) > 0.3


def test_efforts_count_relative_to_those_of_the_last_plan() -> None:
    """Not to less than a twentieth of what parked carriers take, and not to more than that."""
    planner, seen = asked()
    for tick in seen:
        share = 1.0 if tick.last is None else min(max(tick.last.peak / tick.sizes.tau, 0.05), 1.0)
        assert tick.problem.sizes.tau == pytest.approx(share * tick.sizes.tau, rel=1e-12)
        np.testing.assert_array_equal(tick.problem.sizes.row, tick.sizes.row)
    assert planner._last is not None
    own = planner_of()
    own.update(0.06, ACROSS)
    assert own._last is not None
    problems: list[TickProblem] = []
    with pytest.MonkeyPatch.context() as patch:
        solve = Programme.solve
        patch.setattr(Programme, "solve", lambda self, problem: problems.append(problem) or solve(self, problem))
        for peak, share in ((1e3, 1.0), (1e-3, 0.05)):
            own._last = replace(own._last, command=replace(own._last.command, peak=peak * own._sizes.tau))
            problems.clear()
            own.update(own._last.command.t + STEP, ACROSS)
            assert problems[0].sizes.tau == pytest.approx(share * own._sizes.tau, rel=1e-12)


def integrated(nodes: Array, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
    """Places and speeds at nodes of an acceleration that is linear in between, by many trapezia."""
    t = np.unique(np.concatenate([np.arange(nodes[0], nodes[-1], FINER), nodes]))
    a = np.stack([np.interp(t, nodes, column) for column in sdd.T], axis=1)
    speed = sd + cumulative_trapezoid(a, t, axis=0, initial=0.0)
    # of speeds the trapezia are off by the square of the step
    place = s + cumulative_trapezoid(speed, t, axis=0, initial=0.0)
    at = np.searchsorted(t, nodes)
    return place[at], speed[at]


def test_commands_are_the_motion_of_a_solution_and_the_efforts_that_it_takes() -> None:
    """By the other backend: what is missing of f at all nodes, over their sizes, and at the first three steps, N."""
    planner, seen = asked()
    other, robot = backends()[1], planner.robot
    assert all(tick.made.command.status is PLANNED for tick in seen)
    for tick in seen:
        x, multipliers = tick.solution
        p, made, command, nodes = planner.programme(False), tick.made, tick.made.command, tick.lin.nodes
        sdd, tau = x[p.sdd] * units_of(planner.resolved)[2], x[p.tau] * tick.problem.sizes.tau
        s, sd, _ = tick.problem.first
        places, speeds = integrated(nodes, s, sd, sdd)
        for found, expected, near in zip(made.at, (places, speeds, sdd), (1e-8, 1e-12, 1e-12), strict=True):
            np.testing.assert_allclose(found, expected, atol=near)
        np.testing.assert_array_equal(made.nodes, nodes)
        np.testing.assert_array_equal(made.multipliers, multipliers)
        inner = nodes[:-1]
        for order, part in enumerate(made.at):
            own = command.carriers.derivative(order) if order else command.carriers
            np.testing.assert_allclose(own(inner), part[:-1], atol=1e-8)
        if tick.last is not None and nodes[0] > tick.t:  # up to the instant where the plan begins it is the last one
            early = np.linspace(tick.t, nodes[0], 5)[:-1]
            np.testing.assert_allclose(command.carriers(early), tick.last.carriers(early), atol=1e-12)
            np.testing.assert_allclose(command.efforts(early), tick.last.efforts(early), atol=1e-9)
        assert command.carriers.start == tick.t
        known = np.flatnonzero(tick.lin.known)
        assert command.known_until == nodes[known[-1]]
        counts = tick.problem.counts
        assert command.peak == pytest.approx(np.abs(tau[counts]).max(), rel=1e-12)
        motion = rp.CarrierMotion(*made.at, check_rates=False)
        reduced = other.reduce(ACROSS.sample_at(nodes), motion, check_track=False)
        missed = np.abs(np.einsum("nij,nj->ni", reduced.W, tau) - reduced.f)
        assert made.left == pytest.approx((missed[counts] / tick.problem.sizes.row).max(), rel=1e-3, abs=1e-9)
        early = np.flatnonzero(counts[:4])
        assert command.residual == pytest.approx((missed[early] / reduced.row_scale).max(), rel=1e-3, abs=1e-8)
        # forces of the carriers' actuators over the first three steps, and the efforts there
        t = nodes[:4]
        np.testing.assert_allclose(command.forces(t), reduced.carrier_force[:4], rtol=1e-6, atol=1e-7)
        size = np.linalg.svd(reduced.W / reduced.row_scale[:, None], compute_uv=False)
        exact = size[:, -1] > 1e-3 * size[:, 0]
        first = np.arange(len(nodes)) < 4
        solved = np.linalg.solve(reduced.W[exact & first], reduced.f[exact & first][..., None])[..., 0]
        np.testing.assert_allclose(command.efforts(nodes[exact & first]), solved, rtol=1e-6, atol=1e-7)
        later = counts & ~first
        np.testing.assert_allclose(command.efforts(nodes[later]), tau[later], rtol=1e-9, atol=1e-12)
        singular = counts & first & ~exact
        np.testing.assert_allclose(command.efforts(nodes[singular]), tau[singular], rtol=1e-9, atol=1e-9)
    assert robot.m == robot.n
