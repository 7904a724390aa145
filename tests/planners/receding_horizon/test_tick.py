"""What a tick does step by step: where plans begin, how many programmes they take, what is made of a solution."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from scipy.integrate import cumulative_trapezoid

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.planners.receding_horizon.ahead import Linearised
from redundancy_pin.planners.receding_horizon.command import Command, extended
from redundancy_pin.planners.receding_horizon.programme import Programme, TickProblem, units_of
from redundancy_pin.planners.receding_horizon.tick import TickPlanner, with_stop
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import UpdateStatus
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


CORNER = rp.trajectory.reference.corner(radius=0.025)
MOTIONS = {"2rpr": ACROSS, "3rrr": CORNER, "driven elbow": CORNER}


@cache
def backends(name: str = "2rpr") -> tuple[Dynamics, Dynamics]:
    """What plans, and what judges.

    Of platforms that turn moments count over a characteristic length; with one more motor than coordinates many
    efforts do as well.
    """
    if name == "2rpr":
        robot = rp.load_robot("2rpr", end_effector_mass=0.5, cylinder_mass=0.3)
        return rp.CompiledDynamics(robot), rp.VirtualWork(robot)
    robot = replace(rp.load_robot("3rrr"), characteristic_length=0.2)
    if name == "3rrr":
        return rp.CompiledDynamics(robot), rp.VirtualWork(robot)
    driven = replace(robot, actuated=(*robot.actuated, "elbow_1"))
    return rp.RneaDynamics(driven), rp.RneaDynamics(driven)


def planner_of(name: str = "2rpr", **settings: Any) -> RecedingHorizon:
    return RecedingHorizon(backends(name)[0], step=STEP, interpret=True, **in_groups(RecedingHorizon, settings))


@cache
def first_round() -> Any:
    """The plan of a first tick."""
    planner = planner_of()
    planner.update(0.2, ACROSS)
    return planner.ticks.last


# motions to begin with


def test_other_motions_to_begin_with_come_to_rest_nearby_in_the_middle_and_towards_the_corners() -> None:
    track = np.array([(-0.1, 0.3), (-0.2, 0.1)])
    planner, last = planner_of(track=track, acceleration=(4.0, 7.0)), first_round()
    t, until, (s, sd, sdd) = 0.31, 0.7, last.command.motion_at(0.31)
    assert np.abs(sd).min() > 1e-3
    middle, half = track.mean(axis=1), 0.5 * np.diff(track)[:, 0]
    nearby = s + np.sign(sd) * sd**2 / (2.0 * np.array([4.0, 7.0]))  # where full braking ends
    corners = [middle + 0.6 * half * np.array(side) for side in product((-1.0, 1.0), repeat=2)]
    for target in (nearby, middle, *corners, nearby, middle):
        guess = planner.ticks.guess(t, until, last)
        begins, ends = (guess.command.motion_at(float(time)) for time in (t, until))
        for part, wanted in zip((*begins, *ends), (s, sd, sdd, target, 0.0 * s, 0.0 * s), strict=True):
            np.testing.assert_allclose(part, wanted, atol=1e-9)
        assert not guess.multipliers.any()
        assert guess.multipliers.shape == last.multipliers.shape


def test_without_a_track_a_motion_to_begin_with_stays_where_the_carriers_are() -> None:
    planner, last = planner_of(track=[(-np.inf, 0.3), (-0.2, 0.1)]), first_round()
    s = last.command.motion_at(0.31)[0]
    ends = [planner.ticks.guess(0.31, 0.7, last).command.motion_at(0.7)[0] for _ in range(6)]
    np.testing.assert_allclose([end[0] for end in ends[1:]], s[0], atol=1e-12)
    np.testing.assert_allclose(sorted({round(end[1], 9) for end in ends[1:]}), [-0.14, -0.05, 0.04])


# rounds


def scripted(
    monkeypatch: pytest.MonkeyPatch, planner: RecedingHorizon, answers: list[tuple[float, UpdateStatus]]
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

    monkeypatch.setattr(planner.ticks, "plan", plan)
    return about, made


OK, RELAXED, FALLBACK = UpdateStatus.OK, UpdateStatus.RELAXED, UpdateStatus.FALLBACK
FINE = (1e-4, OK)


@pytest.mark.parametrize(
    ("first", "answers", "count", "best"),
    [
        pytest.param(True, [FINE] * 8, 3, 2, id="three at first"),
        pytest.param(False, [FINE] * 8, 1, 0, id="one is enough"),
        pytest.param(False, [(1e-2, OK)] + [FINE] * 8, 1, 0, id="a hundredth is linear"),
        pytest.param(False, [(1.1e-2, OK)] + [FINE] * 8, 2, 1, id="more is not"),
        pytest.param(True, [(0.09, OK)] * 3 + [FINE] * 8, 4, 3, id="three at first and one more"),
        pytest.param(False, [(0.08 - 0.005 * i, OK) for i in range(9)], 8, 7, id="eight at most"),
        pytest.param(False, [(0.5, RELAXED), (0.4, RELAXED), (0.3961, RELAXED)], 3, 2, id="no nearer"),
        pytest.param(False, [(0.5, RELAXED), (0.4, RELAXED), (0.39, RELAXED), (0.39, RELAXED)], 4, 3, id="nearer"),
        pytest.param(False, [(0.03, OK)] * 9, 8, 7, id="a plan may be as far"),
        pytest.param(False, [(0.5, FALLBACK)] + [FINE] * 8, 1, 0, id="no answer"),
        pytest.param(False, [(0.02, RELAXED), (0.02, RELAXED)], 2, 1, id="as near as it may be in doubt"),
    ],
)
def test_a_tick_has_as_many_programmes_as_it_takes(
    monkeypatch: pytest.MonkeyPatch, first: bool, answers: Any, count: int, best: int
) -> None:
    planner = planner_of()
    about, made = scripted(monkeypatch, planner, answers)
    last = None if first else first_round()
    found = planner.ticks.rounds(0.2, 0.7, (None, None), last)
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
    about, made = scripted(monkeypatch, planner, [(left, OK) for left in lefts])
    found = planner.ticks.rounds(0.2, 0.7, (None, None), first_round())
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
    planner.ticks.sizes = tick_sizes()
    about, made = scripted(monkeypatch, planner, [(1e-4, OK), (5e-3, OK), (1e-3, OK)])
    monkeypatch.setattr(planner.ticks, "is_settled", lambda t, plan: len(made) > 2)
    assert planner.ticks.rounds(0.2, 0.7, (None, None), first_round()) is made[2]
    assert about[2] is made[1]


def tick_sizes() -> Any:
    planner = planner_of()
    planner.update(0.2, ACROSS)
    return planner.ticks.sizes


@pytest.mark.parametrize(("left", "softened"), [(0.1, False), (0.11, True)])
def test_a_plan_that_misses_a_tenth_of_f_ahead_is_called_elastic(
    monkeypatch: pytest.MonkeyPatch, left: float, softened: bool
) -> None:
    planner = planner_of()
    scripted(monkeypatch, planner, [(left, OK)] * 8)
    command = planner.ticks.rounds(0.2, 0.7, (None, None), first_round()).command
    assert (command.status is RELAXED) == softened
    assert command.reason == ("ahead 11% of the force is missing" if softened else "")


def test_an_elastic_programme_counts_as_a_tenth_off_at_least() -> None:
    for left, status, doubt in (
        (0.03, OK, 0.03),
        (0.03, RELAXED, 0.1),
        (0.3, RELAXED, 0.3),
        (0.03, FALLBACK, 0.1),
    ):
        plan = first_round()
        assert replace(plan, left=left, command=replace(plan.command, status=status)).doubt == doubt


def test_next_to_a_singular_instant_f_is_met_to_a_millionth() -> None:
    planner, plan, t = planner_of(), first_round(), 0.2
    planner.ticks.sizes = tick_sizes()
    exact = 1e-6 * planner.ticks.sizes.row.max()
    for ahead, near in (((-1e-4,), False), ((1e-4,), True), ((2.4 * STEP,), True), ((2.6 * STEP,), False), ((), False)):
        for residual, met in ((0.9 * exact, True), (1.1 * exact, False)):
            for left in (0.009, 0.011):
                command = replace(plan.command, t=t, singular=t + np.array(ahead), residual=residual, status=OK)
                settled = planner.ticks.is_settled(t, replace(plan, command=command, left=left))
                assert settled == (left < 0.01 and (met or not near))
    for status, settled in ((RELAXED, False), (FALLBACK, True), (UpdateStatus.REFUSED, True)):
        command = replace(plan.command, status=status)
        assert planner.ticks.is_settled(t, replace(plan, command=command, left=1.0)) == settled


@pytest.mark.parametrize(("other", "taken"), [(0.2, True), (0.31, False)])
def test_an_elastic_plan_is_tried_from_elsewhere_too_and_the_nearer_one_counts(
    monkeypatch: pytest.MonkeyPatch, other: float, taken: bool
) -> None:
    planner = planner_of()
    planner.update(0.2, ACROSS)
    last, asked = planner.ticks.last, []
    assert last is not None
    plans = [
        replace(last, command=replace(last.command, status=RELAXED, peak=float(i)), left=left)
        for i, left in enumerate((0.3, other))
    ]

    def rounds(t: float, until: float, given: Any, about: Any) -> Any:
        asked.append(about)
        return plans[len(asked) - 1]

    monkeypatch.setattr(planner.ticks, "rounds", rounds)
    command = planner.update(0.22, ACROSS)
    assert command.peak == float(taken)
    assert asked[0] is last
    assert len(asked) == 2
    assert not asked[1].multipliers.any()  # another motion to begin with


def test_the_largest_effort_so_far_is_that_of_each_step_until_the_next_tick(monkeypatch: pytest.MonkeyPatch) -> None:
    planner, plan, largest = planner_of(), first_round(), 0.0
    for t, peak in ((0.2, 3.0), (0.22, 5.0), (0.24, 4.0)):
        made = replace(plan, command=replace(plan.command, t=t, status=RELAXED), largest=peak)
        monkeypatch.setattr(planner.ticks, "rounds", lambda *ask, made=made: made)
        planner.update(t, ACROSS)
        largest = max(largest, peak)
        assert planner.largest == largest


@pytest.mark.parametrize("interpret", [True, False])
def test_the_largest_effort_of_a_plan_is_that_of_its_command_up_to_the_next_tick(interpret: bool) -> None:
    """Across a singular instant, where a part of the command is that of the last plan, and not behind the step."""
    planner, later = RecedingHorizon(backends()[0], step=STEP, interpret=interpret), 0
    for i in range(26):
        t = 0.06 + STEP * i
        efforts = planner.update(t, ACROSS).efforts
        made = planner.ticks.last
        assert made is not None
        ends = efforts.edges[efforts.edges < t + STEP]
        at_fifths, everywhere = (
            np.abs(efforts(times)).max()
            for times in (t + STEP * np.linspace(0.0, 1.0, 5), np.append(ends[ends >= t], [t, t + STEP]))
        )
        assert made.largest == pytest.approx(at_fifths, rel=1e-9)
        assert made.largest <= everywhere * (1.0 + 1e-9)
        later += made.largest < 0.9 * np.abs(efforts(efforts.edges)).max()
    assert later > 5


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
def asked(name: str) -> tuple[RecedingHorizon, list[Asked]]:
    """Ticks with carriers a little beside the plan: across a singular instant, one of them next to it, or on a way."""
    planner, seen, motion = planner_of(name), [], MOTIONS[name]
    now: dict[str, Any] = {}
    plan, about, solve = TickPlanner.plan, Linearised.about, Programme.solve

    def linear(ahead: Any, nodes: Any, singular: Any, at: Any, multipliers: Any, until: float) -> Linearised:
        now["lin"], now["multipliers"] = about(ahead, nodes, singular, at, multipliers, until), multipliers.copy()
        return now["lin"]

    def solved(self: Programme, problem: TickProblem) -> Any:
        now["problem"], now["solution"] = problem, solve(self, problem)
        return now["solution"]

    def planned(self: TickPlanner, t: float, until: float, given: Any, before: Any) -> Any:
        made = plan(self, t, until, given, before)
        roots, last = self.ahead.roots.copy(), self.last.command if self.last else None
        seen.append(Asked(t, until, given, before, last, sizes=self.sizes, roots=roots, made=made, **now))
        return made

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Linearised, "about", staticmethod(linear))
        patch.setattr(Programme, "solve", solved)
        patch.setattr(TickPlanner, "plan", planned)
        k, times = planner.robot.k, [0.06, 0.08, 0.1, 0.123]
        if name == "2rpr":
            root = rp.find_crossings(planner.robot, motion)[0].t
            times = [0.06, 0.08, *(root + STEP * np.array([-4.0, -2.1, -1.9, -0.6, -0.26, -0.24, 0.1, 1.0]))]
        rng = np.random.default_rng(3)
        command = planner.update(times[0], motion, np.linspace(0.01, -0.02, k), np.linspace(0.05, 0.03, k))
        for i, t in enumerate(times[1:]):
            s, sd, _ = command.motion_at(t)
            beside = s + 1e-4 * rng.uniform(-1.0, 1.0, k), sd + 1e-3 * rng.uniform(-1.0, 1.0, k)
            measured = (beside, (beside[0], None), beside, beside, (None, beside[1]), (None, None))[i % 6]
            command = planner.update(t, motion, *measured)
    return planner, seen


every_machine = pytest.mark.parametrize("name", MOTIONS)


@every_machine
def test_plans_begin_where_the_carriers_are_and_next_to_a_singular_instant_where_the_last_plan_is(name: str) -> None:
    planner, seen = asked(name)
    k, starts = planner.robot.k, []
    for tick in seen:
        coming = tick.roots[tick.roots > tick.t - 1e-9]
        away = (coming[0] - tick.t) / STEP if len(coming) else np.inf
        start = float(coming[0]) if tick.last is not None and away <= NEAR else tick.t
        assert tick.lin.nodes[0] == start
        s, sd, sdd = tick.problem.first
        assert tick.problem.free == (tick.last is None)
        assert (tick.problem.step, tick.problem.horizon) == (STEP, 0.5)
        if tick.last is None:
            given = np.linspace(0.01, -0.02, k), np.linspace(0.05, 0.03, k), np.zeros(k)
            np.testing.assert_array_equal((s, sd, sdd), given)
            continue
        own = [part[0] for part in extended(tick.last.carriers, np.array([start]))]
        expected = [
            planned if part is None or away <= SETTLED else part
            for part, planned in zip((*tick.given, None), own, strict=True)
        ]
        np.testing.assert_array_equal((s, sd, sdd), expected)
        piece = int(np.searchsorted(tick.last.carriers.edges, start)) - 1
        jerk = tick.last.carriers.derivative(3)(tick.last.carriers.edges[piece : piece + 1])[0]
        np.testing.assert_allclose(tick.problem.jerk, jerk, rtol=1e-9, atol=1e-9)
        starts.append((start > tick.t, away <= SETTLED))
    if name == "2rpr":
        assert {True, False} == {at_root for at_root, _ in starts}
        assert {True, False} == {settled for _, settled in starts}


@every_machine
def test_f_is_linear_about_the_plan_before_with_the_multipliers_of_the_nodes_that_both_have(name: str) -> None:
    _, seen = asked(name)
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
    assert max(share for again, share in kept if not again) > 0.3


@every_machine
def test_efforts_count_relative_to_those_of_the_last_plan(name: str) -> None:
    _, seen = asked(name)
    for tick in seen:
        share = 1.0 if tick.last is None else min(max(tick.last.peak / tick.sizes.tau, 0.1), 1.0)
        assert tick.problem.sizes.tau == pytest.approx(share * tick.sizes.tau, rel=1e-12)
        np.testing.assert_array_equal(tick.problem.sizes.row, tick.sizes.row)


@pytest.mark.parametrize(("peak", "share"), [(1e3, 1.0), (1e-3, 0.1)])
def test_efforts_count_between_a_tenth_of_those_of_parked_carriers_and_these(
    monkeypatch: pytest.MonkeyPatch, peak: float, share: float
) -> None:
    planner = planner_of()
    planner.update(0.06, ACROSS)
    assert planner.ticks.last is not None
    assert planner.ticks.sizes is not None
    tau = planner.ticks.sizes.tau
    problems: list[TickProblem] = []
    solve = Programme.solve
    monkeypatch.setattr(Programme, "solve", lambda self, problem: problems.append(problem) or solve(self, problem))
    planner.ticks.last = replace(planner.ticks.last, command=replace(planner.ticks.last.command, peak=peak * tau))
    planner.update(0.08, ACROSS)
    assert problems[0].sizes.tau == pytest.approx(share * tau, rel=1e-12)


def integrated(nodes: Array, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
    """Places and speeds at nodes of an acceleration that is linear in between, by many trapezia."""
    t = np.unique(np.concatenate([np.arange(nodes[0], nodes[-1], FINER), nodes]))
    a = np.stack([np.interp(t, nodes, column) for column in sdd.T], axis=1)
    speed = sd + cumulative_trapezoid(a, t, axis=0, initial=0.0)
    # of speeds the trapezia are off by the square of the step
    place = s + cumulative_trapezoid(speed, t, axis=0, initial=0.0)
    at = np.searchsorted(t, nodes)
    return place[at], speed[at]


@every_machine
def test_commands_are_the_motion_of_a_solution_and_the_efforts_that_it_takes(name: str) -> None:
    """By the other backend: what is missing of f at all nodes, over their sizes, and at the first four, N."""
    planner, seen = asked(name)
    other, motion = backends(name)[1], MOTIONS[name]
    assert all(tick.made.command.status is OK for tick in seen)
    for tick in seen:
        x, multipliers = tick.solution
        p, made, command, nodes = planner.ticks.programme(False), tick.made, tick.made.command, tick.lin.nodes
        sdd, tau = x[p.sdd] * units_of(planner.resolved)[2], x[p.tau] * tick.problem.sizes.tau
        s, sd, _ = tick.problem.first
        places, speeds = integrated(nodes, s, sd, sdd)
        for found, expected, near in zip(made.at, (places, speeds, sdd), (1e-8, 1e-12, 1e-12), strict=True):
            np.testing.assert_allclose(found, expected, atol=near)
        np.testing.assert_array_equal(made.nodes, nodes)
        np.testing.assert_array_equal(made.multipliers, multipliers)
        for order, part in enumerate(made.at):
            own = command.carriers.derivative(order) if order else command.carriers
            np.testing.assert_allclose(own(nodes[:-1]), part[:-1], atol=1e-8)
        if tick.last is not None and nodes[0] > tick.t:  # up to the instant where the plan begins it is the last one
            early = np.linspace(tick.t, nodes[0], 5)[:-1]
            np.testing.assert_allclose(command.carriers(early), tick.last.carriers(early), atol=1e-12)
            np.testing.assert_allclose(command.efforts(early), tick.last.efforts(early), atol=1e-9)
        assert command.carriers.start == tick.t
        assert command.known_until == nodes[np.flatnonzero(tick.lin.known)[-1]]
        counts, soon = tick.problem.counts, nodes <= nodes[0] + 3.01 * planner.step + 1e-9
        first = soon & (np.arange(len(nodes)) < 4)
        assert command.peak == pytest.approx(np.abs(tau[counts]).max(), rel=1e-12)
        carriers = rp.CarrierMotion(*made.at, check_rates=False)
        reduced = other.reduce(motion.sample_at(nodes), carriers, check_track=False)
        missed = np.abs(np.einsum("nij,nj->ni", reduced.W, tau) - reduced.f)
        assert made.left == pytest.approx((missed[counts] / tick.problem.sizes.row).max(), rel=1e-3, abs=1e-8)
        residual = (missed[counts & first] / reduced.row_scale).max(initial=0.0)
        assert command.residual == pytest.approx(residual, rel=1e-3, abs=1e-7)
        # forces of the carriers' actuators over the first three steps, and the efforts there
        np.testing.assert_allclose(command.forces(nodes[soon]), reduced.carrier_force[soon], rtol=1e-6, atol=1e-6)
        size = np.linalg.svd(reduced.W / reduced.row_scale[:, None], compute_uv=False)
        exact = soon & (size[:, -1] > 1e-3 * size[:, 0])
        W, efforts = reduced.W[exact], command.efforts(nodes[exact])
        np.testing.assert_allclose(np.einsum("nij,nj->ni", W, efforts), reduced.f[exact], rtol=1e-6, atol=1e-6)
        # of the efforts that do they are the nearest to those planned: in no direction that W loses they change
        planned = tau[exact]
        if not counts[0]:
            planned[nodes[exact] == nodes[0]] = tau[1]
        lost = np.linalg.svd(W)[2][:, planner.robot.n :]
        np.testing.assert_allclose(np.einsum("nlm,nm->nl", lost, efforts - planned), 0.0, atol=1e-7)
        rest = counts & ~exact
        np.testing.assert_allclose(command.efforts(nodes[rest]), tau[rest], rtol=1e-9, atol=1e-9)


def test_efforts_next_to_a_singular_instant_are_the_same_in_other_units() -> None:
    """Whether W⁻¹ f is the effort there is asked of numbers without units: transmissions, and rows that are moments."""
    planner, seen = asked("2rpr")
    root = seen[0].roots[0]
    tick = next(tick for tick in seen if tick.t < root < tick.t + 2.0 * STEP)
    ahead, made = planner.ticks.ahead, tick.made
    carriers = with_stop(planner.resolved.acceleration, tick.lin.nodes, *made.at)
    tau = tick.solution[0][planner.ticks.programme(False).tau] * tick.problem.sizes.tau
    own, _, residual, peak = planner.ticks.efforts(tick.problem, carriers, tau)
    assert np.abs(own.edges - root).min() < 1e-9
    assert np.diff(own.edges).max() > 2.0 * ahead.spacing * (1.0 - 1e-6)  # what is next to it is left out
    known, scale = ahead.known, ahead.row_scale
    try:
        for transmission, length in ((100.0, 1.0), (0.01, 1.0), (1.0, 100.0), (1.0, 0.01)):
            rows = np.array([1.0, length])
            both = np.append(rows, np.ones(2))  # of f and the carriers' forces
            W = transmission * rows[:, None]
            ahead.known = known._replace(W=known.W * W, constant=known.constant * both, terms=known.terms * both)
            lin = replace(tick.lin, W=tick.lin.W * W, f=tick.lin.f * rows, row_scale=scale * rows)
            ahead.row_scale = scale * rows
            other = planner.ticks.efforts(replace(tick.problem, lin=lin), carriers, tau / transmission)
            np.testing.assert_allclose(other[0].edges, own.edges, rtol=1e-12)
            np.testing.assert_allclose(other[0](own.edges) * transmission, own(own.edges), rtol=1e-6, atol=1e-9)
            assert (other[2], other[3] * transmission) == pytest.approx((residual, peak), rel=1e-6)
    finally:
        ahead.known, ahead.row_scale = known, scale


# the efforts up to the next node


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
@pytest.mark.parametrize("known", [True, False])
def test_what_limits_cut_off_until_the_next_node_is_looked_at_where_they_are_met(name: str, known: bool) -> None:
    """By the other backend: in a step, at the instants where an effort is at its limit, or later than that."""
    other, motion, t = backends(name)[1], MOTIONS[name], 0.06
    planner = planner_of(name)
    plan = planner.update(t, motion)
    sizes = planner.ticks.sizes
    assert sizes is not None
    end = t + STEP if known else t
    plan = replace(plan, known_until=t + 0.4 if known else t)
    instants = t + STEP / 8.0 * np.arange(9)
    efforts = plan.efforts(np.append(instants, instants[-1] + STEP))
    for most in (0.6, 0.97, 1.0 - 1e-5, 1.5):  # of the largest efforts of this step: too little, nearly enough
        limit = most * np.abs(efforts[:9]).max(axis=0)
        planner.limits = Limits(effort=limit)
        cut = np.clip(efforts, -limit, limit)
        command = replace(
            plan, efforts=PiecewisePolynomial.linear(np.append(instants, instants[-1] + STEP), cut), residual=1e-9
        )
        carriers = rp.CarrierMotion(*extended(command.carriers, instants), check_rates=False)
        reduced = other.reduce(motion.sample_at(instants), carriers, check_track=False)
        W, f = reduced.W / reduced.row_scale[:, None], reduced.f / reduced.row_scale
        missing = np.abs(np.einsum("nij,nj->ni", W, cut[:9]) - f).max(axis=1)
        meets = (np.abs(cut[:9]) >= limit * (1.0 - 1e-12)).any(axis=1) & (instants <= end + 1e-9)
        worst = missing[meets].max(initial=0.0)
        found = planner.ticks.checked_between(t, command)
        assert found.residual == pytest.approx(max(worst, 1e-9), rel=1e-5, abs=1e-7)
        softened = worst > 1e-3 * sizes.row.max()
        assert found.status is (RELAXED if softened else OK)
        assert bool(found.reason) == softened
        if worst > 1e-4:  # a thousandth of the size of f, and that alone, decides
            for part, elastic in ((1.1, False), (0.9, True)):
                planner.ticks.sizes = replace(sizes, row=part * 1e3 * worst * np.array([0.1, 1.0]))
                assert (planner.ticks.checked_between(t, command).status is RELAXED) == elastic
            planner.ticks.sizes = sizes


def test_a_moment_that_limits_cut_off_counts_over_the_characteristic_length() -> None:
    planner, other, t = planner_of("3rrr"), backends("3rrr")[1], 0.06
    plan = planner.update(t, CORNER)
    instants = t + STEP / 8.0 * np.arange(9)
    carriers = rp.CarrierMotion(*extended(plan.carriers, instants), check_rates=False)
    reduced = other.reduce(CORNER.sample_at(instants), carriers, check_track=False)
    efforts = np.linalg.solve(reduced.W, (reduced.f + np.array([0.3, 0.0, 0.9]))[..., None])[..., 0]
    planner.limits = Limits(effort=1e-3 * np.abs(efforts).max())
    found = planner.ticks.checked_between(t, replace(plan, efforts=PiecewisePolynomial.linear(instants, efforts)))
    assert found.residual == pytest.approx(0.9 / 0.2, rel=1e-5)
