"""Ticks by machine code against those by numpy and PIQP: each from the same last plan, on the same programme."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import online
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.machine_code import CACHE, find_compiler
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.receding_horizon import RecedingHorizon, Weights
from redundancy_pin.planners.receding_horizon.ahead import FIRST, SOON
from redundancy_pin.planners.receding_horizon.command import Command, TickPlan
from redundancy_pin.planners.receding_horizon.preview import SAME
from redundancy_pin.planners.receding_horizon.programme import Programme, TickProblem, units_of
from redundancy_pin.planners.receding_horizon.tick import REGULAR
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, through_points
from redundancy_pin.trajectory.paths import circle_path

pytest.importorskip("piqp")

STEP, TICK = 0.02, 0.02
MASSES = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}

_ARC = circle_path((0.25, 0.05), 0.09, start_angle=np.pi, sweep=np.pi)
ACROSS = Trajectory(_ARC, SpeedProfile(_ARC.length, 0.45, 0.2))
"""Over the singular line of the 2-RPR and back."""


CORNER = rp.trajectory.reference.corner(radius=0.025)


@cache
def dynamics_of(name: str) -> Dynamics:
    """``arms``: carriers that turn; ``driven elbow``: a motor more than there are coordinates."""
    if name == "2rpr":
        return rp.CompiledDynamics(rp.load_robot("2rpr", **MASSES))
    if name == "arms":
        return rp.CompiledDynamics(rp.load_robot("2rpr", arm_length=0.15, **MASSES))
    if name == "driven elbow":
        robot = rp.load_robot("3rrr")
        return rp.RneaDynamics(replace(robot, actuated=(*robot.actuated, "elbow_1")))
    return rp.CompiledDynamics(zoo.robot_of(name))


RANDOM = {
    "3rrr": [[0.865, 0.5067, 0.0858], [0.9014, 0.4756, -0.9861], [0.8719, 0.4159, -0.8868], [0.8965, 0.55, 0.2807]],
    "five_bar": [[0.2401, 0.7982], [0.4581, 0.7794], [0.3506, 0.333], [0.1637, 0.5997]],
}
"""Points of the first random paths through type II poses of ``benchmarks/online.py``, which takes long to find them."""


@cache
def random_path(name: str) -> Trajectory:
    if name == "2rpr":
        return online.over_and_over(3)
    path = through_points(np.array(RANDOM[name]))
    return Trajectory(path, SpeedProfile(path.length, 0.5, 0.4))


HORIZON = 0.5
NO_TRACK = [(-np.inf, np.inf)] * 2

PLACE, RATE, ACCELERATION = 2e-4, 2e-3, 0.1
"""m, m/s and m/s², or rad: within their tolerances the cost is flat that far."""

BEHIND = 2.0
"""So much farther behind the horizon, where neither place nor speed weigh."""

EFFORT, FORCE, MULTIPLIER = 5e-3, 0.02, 3e-2
"""Of the peak; N; of the largest: as follows from these motions."""

RESIDUAL = 1e-5
"""N, and fraction of f: what f has beside its linear part is of second order; where that is more, ``EFFORT`` of it, as
motions differ by what the cost is flat."""

COST = 1e-5
"""By which fraction machine code may be dearer: the gap that PIQP may leave is a tenth of that."""

MISSED = 1e-6
"""Of rows and bounds, which are all of size one: that of PIQP is 1e-8, and by its second try 1e-6."""

LOOSE = 5e-3
"""m: where several programmes follow one another they are each about another plan, and may be one more or less."""

LOOSE_COST, LOOSE_ROWS = 1e-2, 1e-2
"""Then f is linear about another plan than the one that is looked at, by the fraction that counts as linear."""


@dataclass(frozen=True)
class Tick:
    """A tick by both, from the same last plan: plans, the programmes of the one of numpy and the last solution."""

    last: TickPlan
    compiled: TickPlan
    interpreted: TickPlan
    problems: list[TickProblem]
    solution: Array
    programme: Programme

    @property
    def once(self) -> bool:
        """Whether there was one programme, the same for both."""
        return len(self.problems) == 1


def ticks_of(
    dynamics: Dynamics,
    motion: Any,
    times: Any,
    measured: Callable[[Command, float], tuple[Any, Any]] = lambda last, t: (None, None),
    **settings: Any,
) -> Iterator[Tick]:
    """Give the ticks after the first; all are by machine code, or this fails."""
    compiled = RecedingHorizon(dynamics, step=STEP, horizon=HORIZON, **in_groups(RecedingHorizon, settings))
    interpreted = RecedingHorizon(
        dynamics, step=STEP, horizon=HORIZON, interpret=True, **in_groups(RecedingHorizon, settings)
    )
    assert compiled.compiled
    assert not interpreted.compiled
    ours, theirs = compiled.ticks, interpreted.ticks
    seen: list[tuple[TickProblem, Any]] = []
    solve = Programme.solve

    def solved(self: Programme, problem: TickProblem) -> Any:
        seen.append((problem, solve(self, problem)))
        return seen[-1][1]

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Programme, "solve", solved)
        for planner in (compiled, interpreted):
            planner.update(float(times[0]), motion)
        theirs.ahead = ours.ahead  # singular instants to the last bit
        for t in times[1:]:
            last = ours.last
            assert last is not None
            theirs.last, theirs.sizes, theirs.largest = last, ours.sizes, ours.largest
            given = measured(last.command, float(t))
            seen.clear()
            compiled.update(float(t), motion, *given)
            assert not seen, f"the tick at {t:.6g} s was left to Python"
            interpreted.update(float(t), motion, *given)
            assert ours.last is not None
            assert theirs.last is not None
            problems = [problem for problem, _ in seen]
            yield Tick(last, ours.last, theirs.last, problems, seen[-1][1][0], theirs.programme(False))
            assert compiled.largest == pytest.approx(interpreted.largest, rel=EFFORT)


def unknowns_of(tick: Tick) -> Array:
    """Return the variables of the last programme at the plan by machine code."""
    problem, programme, plan = tick.problems[-1], tick.programme, tick.compiled
    lin, x = problem.lin, np.zeros(programme.variables)
    places = programme.s, programme.sd, programme.sdd
    for place, part, unit in zip(places, plan.at, units_of(problem.limits), strict=True):
        x[place] = part / unit
    changes = (own - their for own, their in zip(plan.at, lin.at, strict=True))
    f = lin.f + sum(np.einsum("nik,nk->ni", slope, own) for slope, own in zip(lin.slopes, changes, strict=True))
    tau = plan.command.efforts(lin.nodes)
    W, right = lin.W / lin.row_scale[:, None], f / lin.row_scale
    size = np.linalg.svd(W, compute_uv=False)
    soon = lin.nodes <= lin.nodes[0] + (FIRST + SOON) * problem.step + SAME
    first = soon & (size[:, -1] > REGULAR * size[:, 0])
    # in the first steps efforts are those of f as it is, and a programme has those of f as it is linear
    missing = right[first] - np.einsum("nij,nj->ni", W[first], tau[first])
    tau[first] += np.einsum("nij,nj->ni", np.linalg.pinv(W[first]), missing)
    tau[~problem.counts] = 0.0
    x[programme.tau] = tau / problem.sizes.tau
    x[programme.peak] = max(
        np.abs(x[programme.tau]).max(), problem.weights.memory * problem.largest / problem.sizes.tau
    )
    return x


def judged(tick: Tick, x: Array) -> tuple[float, float, float]:
    """Return the cost of variables, and by how much they miss equations and bounds of the last programme."""
    P, q, A, b, G, low, high, lower, upper = tick.programme.numbers_of(tick.problems[-1])
    bounds = np.concatenate([G @ x - high, low - G @ x, x - upper, lower - x])
    return float(0.5 * x @ (P @ x) + q @ x), float(np.abs(A @ x - b).max()), float(bounds.max())


def assert_the_same(tick: Tick) -> None:
    own, their = tick.compiled, tick.interpreted
    command, expected = own.command, their.command
    assert command.status is expected.status
    assert command.status is UpdateStatus.OK or "between the nodes" in command.reason
    assert command.reason == expected.reason
    np.testing.assert_array_equal(own.nodes, their.nodes)
    np.testing.assert_array_equal(command.singular, expected.singular)
    assert command.known_until == expected.known_until
    known = own.nodes <= command.known_until
    for found, wanted, near in zip(own.at, their.at, (PLACE, RATE, ACCELERATION), strict=True):
        most = near if tick.once else near / PLACE * LOOSE
        np.testing.assert_allclose(found[known], wanted[known], atol=most)
        np.testing.assert_allclose(found[~known], wanted[~known], atol=BEHIND * most)
    end = command.carriers.end
    t = np.linspace(command.t, end, 201)
    np.testing.assert_allclose(command.carriers(t), expected.carriers(t), atol=PLACE if tick.once else LOOSE)
    (cost, rows, bounds), (least, _, _) = judged(tick, unknowns_of(tick)), judged(tick, tick.solution)
    assert cost <= least + (COST if tick.once else LOOSE_COST) * abs(least)
    assert rows <= (MISSED if tick.once else LOOSE_ROWS)
    assert bounds <= MISSED
    if not tick.once:
        return
    assert command.residual == pytest.approx(expected.residual, abs=RESIDUAL, rel=EFFORT)
    assert own.left == pytest.approx(their.left, abs=RESIDUAL, rel=EFFORT)
    assert command.peak == pytest.approx(expected.peak, rel=EFFORT)
    assert own.largest == pytest.approx(their.largest, abs=EFFORT * expected.peak)
    t = np.linspace(command.t, command.t + STEP * FIRST, 61)
    np.testing.assert_allclose(command.efforts(t), expected.efforts(t), atol=EFFORT * expected.peak)
    assert (np.abs(command.efforts(t)) <= tick.problems[-1].limits.effort * (1.0 + 1e-12)).all()
    np.testing.assert_allclose(command.forces(t), expected.forces(t), atol=FORCE)
    largest = np.abs(their.multipliers).max()
    np.testing.assert_allclose(own.multipliers, their.multipliers, atol=MULTIPLIER * largest)


def grid(count: int) -> Array:
    return TICK * np.arange(count)


def beside(last: Command, t: float) -> tuple[Array, Array]:
    """Return a state a little beside the plan, another one at each tick."""
    s, sd, _ = last.motion_at(t)
    rng = np.random.default_rng(round(1e6 * t))
    return s + rng.uniform(-1e-4, 1e-4, s.shape), sd + rng.uniform(-2e-3, 2e-3, s.shape)


IRREGULAR = np.cumsum(np.append(0.003, np.random.default_rng(2).uniform(0.003, 0.03, 30)))
ENDS = np.linspace(0.0, 0.4, 300)
CENTRED = Weights(centre=0.0, end=0.0, end_speed=0.0)

CASES: dict[str, tuple[str, Callable[[], Any], Array, dict[str, Any]]] = {
    "2rpr": ("2rpr", lambda: ACROSS, grid(30), {}),
    "2rpr, random path": ("2rpr", lambda: random_path("2rpr"), grid(40), {}),
    "3rrr, random path": ("3rrr", lambda: random_path("3rrr"), 1.94 + grid(30), {}),
    "five_bar, random path": ("five_bar", lambda: random_path("five_bar"), 1.2 + grid(40), {}),
    "effort cut off between nodes": ("3rrr", lambda: CORNER, grid(30), {"effort": 4.0}),
    "redundant motor": ("driven elbow", lambda: random_path("3rrr"), 1.94 + grid(30), {}),
    "redundant motor, effort": (
        "driven elbow",
        lambda: random_path("3rrr"),
        1.94 + grid(15),
        {"effort": 8.9, "objective": "effort"},
    ),
    "arms that turn": ("arms", lambda: ACROSS, grid(30), {}),
    "jerk": ("2rpr", lambda: ACROSS, grid(30), {"jerk": 150.0}),
    "force": ("2rpr", lambda: ACROSS, grid(30), {"carrier_force": 6.0}),
    "effort": ("3rrr", lambda: random_path("3rrr"), 1.94 + grid(15), {"effort": 10.5, "objective": "effort"}),
    "narrow": ("2rpr", lambda: ACROSS, grid(30), {"track": (-0.03, 0.03), "objective": CENTRED}),
    "narrow, fast": (
        "2rpr",
        lambda: ACROSS,
        grid(30),
        {"track": (-0.03, 0.03), "acceleration": 60.0, "objective": replace(CENTRED, end_speed=0.1)},
    ),
    "slow": ("2rpr", lambda: ACROSS, grid(30), {"speed": 0.15}),
    "no track": ("2rpr", lambda: ACROSS, grid(30), {"track": NO_TRACK}),
    "no track, no speed": ("2rpr", lambda: ACROSS, grid(30), {"track": NO_TRACK, "speed": np.inf}),
    "mean square": ("2rpr", lambda: ACROSS, grid(30), {"objective": "effort"}),
    "irregular": ("2rpr", lambda: ACROSS, IRREGULAR, {}),
    "measured": ("2rpr", lambda: ACROSS, grid(30), {"measured": beside}),
    "measured, five_bar": ("five_bar", lambda: random_path("five_bar"), 1.2 + grid(30), {"measured": beside}),
    "an end on the way": ("2rpr", lambda: ACROSS.sample_at(ENDS), grid(19), {}),
}


@pytest.mark.parametrize("case", CASES)
def test_machine_code_plans_as_numpy_does_and_no_dearer(case: str) -> None:
    name, motion, times, settings = CASES[case]
    once = []
    for tick in ticks_of(dynamics_of(name), motion(), times, **settings):
        assert_the_same(tick)
        once.append(tick.once)
    assert np.mean(once) > 0.5  # elsewhere less is asked


# around singular instants


def test_plans_that_begin_at_a_singular_instant_are_the_same() -> None:
    """A tick right before one, on it, and again at the same time; from plans that are exact there: one programme."""
    dynamics = dynamics_of("2rpr")
    roots = [float(crossing.t) for crossing in rp.find_crossings(dynamics.robot, ACROSS)]
    before = [roots[0] + STEP * part for part in (-4.0, -3.0, -2.0, -1.0, -0.5)]
    after = [roots[0] + STEP * part for part in (0.01, 0.3, 1.0, 2.0)]
    for close in ([-0.2, -0.05], [-0.24, -0.1, -0.1, -0.01], [0.0, 0.0], [-0.1, 0.0]):
        begun = []
        times = np.array([*before, *(roots[0] + STEP * part for part in close), *after])
        for tick in ticks_of(dynamics, ACROSS, times):
            assert_the_same(tick)
            at_root = tick.problems[0].lin.singular[:1].tolist() == [0]
            begun.append((at_root, tick.once))
        assert sum(at_root for at_root, _ in begun) >= len(close)
        assert (True, True) in begun


# what is left to Python


def statuses_of(planner: RecedingHorizon, motion: Any, times: Array) -> tuple[list[TickPlan], list[UpdateStatus]]:
    plans, statuses = [], []
    for t in times:
        statuses.append(planner.update(float(t), motion).status)
        assert planner.ticks.last is not None
        plans.append(planner.ticks.last)
    return plans, statuses


@pytest.mark.parametrize(
    ("settings", "lost"),
    [
        ({"effort": 0.5, "acceleration": 1.0}, True),
        ({"jerk": 20.0, "acceleration": 1.0, "effort": 1.0}, True),
        ({}, False),
    ],
)
def test_what_no_plan_keeps_within_limits_is_left_to_python(settings: dict[str, Any], lost: bool) -> None:
    """From the same last plan, with the programme of which nothing is kept."""
    dynamics, elastic = dynamics_of("2rpr"), 0
    compiled = RecedingHorizon(dynamics, step=STEP, **in_groups(RecedingHorizon, settings))
    for i in range(8):
        t = 0.04 * i
        last, largest, sizes = compiled.ticks.last, compiled.ticks.largest, compiled.ticks.sizes
        command = compiled.update(t, ACROSS)
        if last is None or command.status is UpdateStatus.OK:
            continue
        elastic += 1
        again = RecedingHorizon(dynamics, step=STEP, interpret=True, **in_groups(RecedingHorizon, settings))
        again.update(0.0, ACROSS)
        again.ticks.last, again.ticks.largest, again.ticks.sizes = last, largest, sizes
        expected = again.update(t, ACROSS)
        assert command.status is expected.status is UpdateStatus.RELAXED
        assert command.reason == expected.reason
        assert command.residual == pytest.approx(expected.residual, rel=0.02)
    assert (elastic > 0) == lost


def test_limits_that_change_between_ticks_hold_for_machine_code_as_well() -> None:
    planner = RecedingHorizon(dynamics_of("2rpr"), step=STEP)
    for i in range(10):
        planner.update(TICK * i, ACROSS)
    fastest = 1.02 * np.abs(planner.update(TICK * 10, ACROSS).carriers.derivative()(np.linspace(0.2, 0.7, 400))).max()
    for changed in (
        Limits(acceleration=8.0),
        Limits(acceleration=8.0, jerk=600.0),
        Limits(speed=fastest),
        Limits(track=(-0.19, 0.19)),
        Limits(),
    ):
        planner.limits = changed
        t = planner.ticks.last.command.t + TICK if planner.ticks.last else 0.0
        command = planner.update(t, ACROSS)
        assert command.status is UpdateStatus.OK
        nodes = np.linspace(t + 1e-9, t + HORIZON, 400)
        resolved = planner.resolved
        _, sd, sdd = (np.array(part) for part in zip(*(command.motion_at(float(x)) for x in nodes), strict=True))
        later = nodes > t + STEP  # s̈ at the start is given
        assert (np.abs(sdd[later]) <= resolved.acceleration + 1e-6).all()
        assert (np.abs(sd[later]) <= resolved.speed + 1e-6).all()
        jerks = np.abs(command.carriers.derivative(3)(command.carriers.edges[command.carriers.edges < t + HORIZON]))
        assert (jerks <= resolved.jerk + 1e-3).all()


def test_without_a_compiler_plans_are_those_of_numpy(request: pytest.FixtureRequest) -> None:
    # one backend each: what it remembers of earlier poses decides digits that the solver leaves open
    first, second = (rp.CompiledDynamics(rp.load_robot("2rpr", **MASSES)) for _ in range(2))
    request.getfixturevalue("no_compiler")
    assert find_compiler() is None
    with pytest.warns(RuntimeWarning, match="not in machine code: there is no C compiler"):
        without = RecedingHorizon(first, step=STEP)
    assert not without.compiled
    found, _ = statuses_of(without, ACROSS, grid(16))
    expected, _ = statuses_of(RecedingHorizon(second, step=STEP, interpret=True), ACROSS, grid(16))
    for own, their in zip(found, expected, strict=True):
        np.testing.assert_array_equal(own.nodes, their.nodes)
        np.testing.assert_allclose(own.at, their.at, atol=1e-12)


def test_a_library_is_compiled_once_and_kept(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    compiler, dynamics = find_compiler(), dynamics_of("2rpr")
    assert compiler is not None
    script, log, kept = tmp_path / "cc", tmp_path / "log", tmp_path / "kept"
    command = " ".join(shlex.quote(word) for word in compiler.command)
    script.write_text(f'#!/bin/sh\necho compiled >> {log}\nexec {command} "$@" -O0\n')
    script.chmod(0o755)
    monkeypatch.setenv("CC", str(script))
    monkeypatch.setenv(CACHE, str(kept))
    for settings, times in (
        ({}, 1),
        ({"jerk": 100.0}, 1),
        ({"interpret": True, "horizon": 0.06}, 1),
        ({"horizon": 0.04}, 2),
    ):
        planner = RecedingHorizon(dynamics, **in_groups(RecedingHorizon, {"horizon": 0.08, **settings}))
        assert planner.compiled == ("interpret" not in settings)
        assert len(log.read_text().split()) == times
        assert len(list(kept.glob("*.so"))) == times
