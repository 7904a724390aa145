"""Plans of an update against an independent solution of the same quadratic programme, solved by DAQP."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache
from typing import Any

import numpy as np
import online
import pytest
import zoo
from online_programme import Ahead, Asked, Judge, Solution, linearised

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.planners.receding_horizon import Preview, RecedingHorizon, Weights
from redundancy_pin.planners.receding_horizon.command import Command, UpdatePlan
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, through_points
from redundancy_pin.trajectory.paths import circle_path

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

EFFORT, MULTIPLIER = 5e-3, 3e-2
"""Of the peak, and of the largest multiplier: as follows from these motions."""

COST = 1e-6
"""By which fraction of itself, or of one, a plan may be dearer than the optimum."""

MISSED = 1e-6
"""Of rows and bounds, which are all of size one."""

NEAR = 0.25
"""Steps before a singular instant in which a plan begins there."""

LOOSE, LOOSE_COST = 5e-3, 1e-2
"""m, and of the cost: programmes that follow one another are about plans that differ by what the cost is flat."""


@dataclass(frozen=True)
class Update:
    """An update: the plan before, the one that came of it, and what judges that."""

    last: UpdatePlan | None
    made: UpdatePlan
    judge: Judge
    best: Solution


def updates_of(
    dynamics: Dynamics,
    motion: Any,
    times: Any,
    measured: Callable[[Command, float], tuple[Any, Any]] = lambda last, t: (None, None),
    start: tuple[Any, Any] = (None, None),
    **settings: Any,
) -> list[Update]:
    """Return every third update and those of several programmes, solved by DAQP too."""
    planner = RecedingHorizon(dynamics, step=STEP, horizon=HORIZON, **in_groups(RecedingHorizon, settings))
    updates = []
    for i, t in enumerate(times):
        last, largest = planner.updates.last, planner.largest
        given = measured(last.command, float(t)) if last is not None else start
        planner.update(float(t), motion, *given)
        made = planner.updates.last
        assert made is not None
        coming = planner.updates.roots[planner.updates.roots > t - 1e-9]
        near = last is not None and len(coming) and coming[0] <= t + NEAR * STEP
        assert made.nodes[0] == (coming[0] if near else t)
        if i % 3 == 0 or made.rounds > 1:
            updates.append(Update(last, made, *Asked(planner, last, made, given, largest).solve()))
    return updates


def assert_optimal(update: Update) -> None:
    made, best, judge, once = update.made, update.best, update.judge, update.made.rounds == 1
    problem, command = judge.problem, made.command
    known = made.nodes <= command.known_until
    for found, wanted, near in zip(made.at, best.at, (PLACE, RATE, ACCELERATION), strict=True):
        most = near if once else near / PLACE * LOOSE
        np.testing.assert_allclose(found[known], wanted[known], atol=most)
        np.testing.assert_allclose(found[~known], wanted[~known], atol=BEHIND * most)
    x = judge.unknowns(made.at, judge.efforts(made.at, command.efforts(made.nodes)))
    rows, bounds = judge.missed(x)
    assert judge.cost(x) <= best.cost + (COST if once else LOOSE_COST) * max(1.0, abs(best.cost))
    assert rows <= (MISSED if once else LOOSE_COST)
    assert bounds <= (MISSED if once else LOOSE_COST)
    if not once and update.last is not None:
        return
    peak = np.abs(best.tau[problem.counts]).max()
    assert command.peak == pytest.approx(peak, rel=EFFORT)
    largest = np.abs(best.multipliers).max()
    given = int(update.last is not None)  # what multiplies a start that is given is not determined
    np.testing.assert_allclose(made.multipliers[given:], best.multipliers[given:], atol=MULTIPLIER * largest)


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
    "begins at its largest speed": (
        "2rpr",
        lambda: ACROSS,
        grid(1),
        {"speed": 0.3, "start": ([-0.15, 0.15], [0.2999, -0.2999]), "objective": Weights(centre=50.0)},
    ),
    "no track": ("2rpr", lambda: ACROSS, grid(30), {"track": NO_TRACK}),
    "no track, no speed": ("2rpr", lambda: ACROSS, grid(30), {"track": NO_TRACK, "speed": np.inf}),
    "mean square": ("2rpr", lambda: ACROSS, grid(30), {"objective": "effort"}),
    "irregular": ("2rpr", lambda: ACROSS, IRREGULAR, {}),
    "measured": ("2rpr", lambda: ACROSS, grid(30), {"measured": beside}),
    "measured, five_bar": ("five_bar", lambda: random_path("five_bar"), 1.2 + grid(30), {"measured": beside}),
    "an end on the way": ("2rpr", lambda: ACROSS.sample_at(ENDS), grid(19), {}),
}


@pytest.mark.long_for(
    *(f"{name}, random path" for name in ("2rpr", "3rrr", "five_bar")),
    *("redundant motor", "narrow", "no track", "mean square", "measured, five_bar"),
)
@pytest.mark.parametrize("case", CASES)
def test_plans_are_optima_of_their_programmes(case: str) -> None:
    name, motion, times, settings = CASES[case]
    updates = updates_of(dynamics_of(name), motion(), times, **settings)
    for update in updates:
        assert update.made.command.status is UpdateStatus.OK or "between the nodes" in update.made.command.reason
        assert_optimal(update)
    assert sum(update.made.rounds == 1 for update in updates) >= len(times) // 6  # of others less is asked


def test_plans_that_begin_at_a_singular_instant_are_optima() -> None:
    """An update right before one, on it, and again at the same time; from plans that are exact there: one programme."""
    dynamics = dynamics_of("2rpr")
    root = float(rp.find_crossings(dynamics.robot, ACROSS)[0].t)
    before = [root + STEP * part for part in (-4.0, -3.0, -2.0, -1.0, -0.5)]
    after = [root + STEP * part for part in (0.01, 0.3, 1.0, 2.0)]
    for close in ([-0.24, -0.1, -0.1, -0.01], [0.0, 0.0]):
        times = [*before, *(root + STEP * part for part in close), *after]
        begun = []
        for update in updates_of(dynamics, ACROSS, times):
            assert_optimal(update)
            begun.append((update.judge.problem.lin.singular[:1].tolist() == [0], update.made.rounds == 1))
        assert any(at_root for at_root, _ in begun)


SHORT: dict[str, tuple[str, Callable[[], Any], Array, dict[str, Any]]] = {
    "effort and acceleration": ("2rpr", lambda: ACROSS, [0.06], {"effort": 0.5, "acceleration": 1.0}),
    "jerk": ("2rpr", lambda: ACROSS, [0.06], {"jerk": 20.0, "acceleration": 1.0, "effort": 1.0}),
    "begins off its track": (
        "2rpr",
        lambda: ACROSS,
        0.06 + grid(4),
        {"track": (-0.1, 0.1), "start": ([0.12] * 2, None)},
    ),
    "begins too fast": ("2rpr", lambda: ACROSS, 0.06 + grid(4), {"speed": 0.3, "start": (None, [0.5] * 2)}),
    "force": ("2rpr", lambda: ACROSS, [0.06], {"carrier_force": 1.0, "acceleration": 1.5, "effort": 0.3}),
    "five_bar": ("five_bar", lambda: random_path("five_bar"), [1.2], {"effort": 0.3}),
}


@pytest.mark.parametrize("case", SHORT)
def test_where_no_plan_keeps_every_limit_the_least_is_missed_of_f(case: str) -> None:
    """What is missed is in the multipliers; the motion is as flat as where it costs next to nothing."""
    name, motion, times, settings = SHORT[case]
    for update in updates_of(dynamics_of(name), motion(), times, **settings):
        made, best, judge = update.made, update.best, update.judge
        assert made.command.status is UpdateStatus.RELAXED
        assert judge.problem.relaxed
        largest = np.abs(best.multipliers).max()
        np.testing.assert_allclose(made.multipliers, best.multipliers, atol=1e-3 * largest)
        soon = made.nodes < made.nodes[0] + 10.0 * STEP
        np.testing.assert_allclose(made.at[0][soon], best.at[0][soon], atol=PLACE)
        _, bounds = judge.missed(judge.unknowns(made.at, best.tau))
        assert bounds <= 1e-2  # the efforts are those of another motion
        row = judge.problem.sizes.row
        assert made.left >= 0.5 * np.abs(made.multipliers * row).max() / judge.problem.weights.missing


# the judge's own derivatives, by other backends


@pytest.mark.long_for("sliding")
@pytest.mark.parametrize("arm", [0.0, 0.2], ids=["sliding", "turning"])
def test_the_curvature_is_that_of_second_differences_by_the_other_backend(arm: float) -> None:
    robot = rp.load_robot("2rpr", **MASSES, arm_length=arm)
    rng, nodes, backend = np.random.default_rng(3), np.array([0.1, 0.3, 0.5]), rp.RneaDynamics(robot)
    ahead = Ahead(rp.CompiledDynamics(robot), Preview.of(ACROSS))
    at = tuple(size * rng.uniform(-1.0, 1.0, (3, robot.k)) for size in (0.1, 0.5, 5.0))
    y = rng.uniform(-1.0, 1.0, (3, robot.n))
    lin = linearised(ahead, nodes, np.empty(0, dtype=int), at, y, 1.0)

    def value(changes: Any) -> Array:
        carriers = rp.CarrierMotion(*(a + c for a, c in zip(at, changes, strict=True)), check_rates=False)
        return -(y * backend.reduce(ACROSS.sample_at(nodes), carriers, check_track=False).f).sum(axis=1)

    h = 2e-3  # m, m/s, m/s²
    assert np.abs(lin.curvature).max() > 0.1
    for carrier in range(robot.k):
        unit = h * np.eye(robot.k)[carrier]
        for i in range(3):
            for j in range(3):
                ends = [
                    a * b * value([(a * (i == own) + b * (j == own)) * unit for own in range(3)])
                    for a in (1.0, -1.0)
                    for b in (1.0, -1.0)
                ]
                second = sum(ends) / (4.0 * h**2)
                np.testing.assert_allclose(lin.curvature[:, carrier, i, j], second, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(("name", "start"), [("2rpr", 0.3), ("3rrr", 0.3), ("2rpr", ACROSS.duration)])
def test_units_of_the_first_plan_are_those_of_f_and_of_the_gain_of_the_motors(name: str, start: float) -> None:
    """Where the platform rests, of f that carriers make."""
    robot = dynamics_of(name).robot
    motion, judge, k = ACROSS if name == "2rpr" else CORNER, rp.RneaDynamics(robot), robot.k
    planner = RecedingHorizon(dynamics_of(name), step=STEP, horizon=HORIZON)
    planner.update(start, motion)
    sizes = planner.updates.last
    nodes = sizes.nodes
    known = nodes[nodes <= start + HORIZON + 1e-9]

    platform = Preview.of(motion).motion(known)

    def reduced(sdd: Array) -> Any:
        rest = np.zeros((len(known), k))
        return judge.reduce(platform, rp.CarrierMotion(rest, rest, sdd, check_rates=False))

    parked = reduced(np.zeros((len(known), k)))
    gain = np.median(np.linalg.norm(parked.W / parked.row_scale[:, None], ord=2, axis=(1, 2)))
    asked = np.abs(parked.f / parked.row_scale).max()
    by_carriers = max(np.abs(reduced(np.tile(unit, (len(known), 1))).f - parked.f).max() for unit in np.eye(k))
    wanted = max(asked, 0.1 * by_carriers)
    np.testing.assert_allclose(sizes.row, wanted * parked.row_scale, rtol=1e-6)
    assert sizes.tau == pytest.approx(wanted / gain, rel=1e-6)
