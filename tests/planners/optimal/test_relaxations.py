"""What is said of limits that have to give way: amounts, limits that would suffice, units and instants."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.optimal import infeasible
from redundancy_pin.planners.optimal import solve as solving
from redundancy_pin.planners.optimal.mesh import grid_of
from redundancy_pin.planners.optimal.nlp import LEAST_SECONDS
from redundancy_pin.planners.optimal.problem import Problem, Task, read_problem
from redundancy_pin.planners.optimal.settings import checked_settings
from redundancy_pin.planners.optimal.solve import REACH, Multistart, Outcome, first_guess
from redundancy_pin.planners.optimal.transcription import KINDS, relaxed_bounds, slack_name
from redundancy_pin.planners.options import Limits, Mesh, Objective
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.continuous_motion import as_motion

LIMITS = {"jerk": (900.0, 700.0), "speed": (2.0, 1.5), "acceleration": (9.0, 8.0), "effort": (5.0, 4.0),
         "carrier_force": (30.0, 20.0), "track": [(-0.1, 0.15), (-0.2, 0.05)]}  # fmt: skip


@cache
def problem(end: str = "datum") -> Problem:
    dynamics = rp.VirtualWork(zoo.robot_of("2rpr"))
    source = as_motion(reference.circle(0.5, 0.2, 0.05))
    bounds = {"effort": 4.0, "energy": 9.0}
    settings = checked_settings(
        dynamics.robot, Objective("peak"), Limits(**LIMITS), Mesh(0.1, 0), end=end, at_most=bounds
    )
    return read_problem(Task(dynamics, source, settings), grid_of(source, [], 0.1))[0]


def solution(of: Problem, fraction: float = 0.0, **changed: Any) -> Any:
    """Scaled values of zero, but for some at a node and carrier, given in units."""
    count, k, m = len(of.grid.t), of.model.k, of.model.W.shape[2]
    values = {name: np.zeros((count, m if name == "tau" else k)) for name in ("s", "sd", "sdd", "tau", "force")}
    for name, (i, j, value) in changed.items():
        values[name][i, j] = value / np.broadcast_to(getattr(of.scales, name), values[name].shape[1:])[j]
    values |= {slack_name(kind): np.full((1, 1), fraction) for kind in KINDS}
    return SimpleNamespace(values=values)


def event(of: Problem, kind: str, fraction: float, **changed: Any) -> dict[str, Any]:
    return infeasible.elastic_event(of, robot_record(zoo.robot_of("2rpr")), solution(of, fraction, **changed), kind)


@pytest.mark.parametrize(
    ("kind", "changed", "amount", "limit", "unit", "limited"),
    [
        ("track", {"s": (4, 0, 0.18)}, 0.03, 0.18, "m", 0.15),
        ("track", {"s": (4, 1, -0.26)}, 0.06, -0.26, "m", -0.2),
        ("speed", {"sd": (5, 1, -1.8)}, 0.3, 1.8, "m/s", 1.5),
        ("speed", {"sd": (5, 0, 2.5)}, 0.5, 2.5, "m/s", 2.0),
        ("acceleration", {"sdd": (6, 0, -9.9)}, 0.9, 9.9, "m/s²", 9.0),
        ("effort", {"tau": (7, 1, 5.0)}, 1.0, 5.0, "N", 4.0),
        ("force", {"force": (8, 1, -26.0)}, 6.0, 26.0, "N", 20.0),
    ],
)
def test_what_is_exceeded_most_is_said_with_what_would_suffice(
    kind: str, changed: dict[str, tuple[int, int, float]], amount: float, limit: float, unit: str, limited: float
) -> None:
    of = problem()
    ((i, j, _),) = changed.values()
    said = event(of, kind, 0.123456, **changed)
    robot = zoo.robot_of("2rpr")
    names = robot.actuated if kind == "effort" else robot.carriers
    assert said["carrier"] == names[j]
    assert said["unit"] == unit
    assert said["time"] == of.grid.t[i]
    np.testing.assert_allclose([said["amount"], said["limit"]], [amount, limit], rtol=1e-6)
    start = f"the {kind} of {names[j]}, from {limited:g} to {limit:g} {unit} (12.3 %), most at t = {of.grid.t[i]:.6g} s"
    assert said["text"] == start


@pytest.mark.parametrize(("fraction", "percent"), [(0.004567, "0.457"), (0.5, "50"), (1.0, "100"), (23.4567, "2346")])
def test_percentages_have_digits_where_they_are_small_and_no_exponent_where_they_are_large(fraction, percent) -> None:
    assert f"({percent} %)" in event(problem(), "speed", fraction, sd=(5, 1, -1.8))["text"]


def test_a_jerk_is_that_of_a_step() -> None:
    of = problem()
    h = of.grid.h[4]
    said = event(of, "jerk", 0.2, sdd=(5, 0, 1000.0 * h))
    np.testing.assert_allclose([said["amount"], said["limit"]], [100.0, 1000.0], rtol=1e-9)
    assert said["time"] == of.grid.t[4]
    assert said["unit"] == "m/s³"


def test_ends_and_bounds_of_objectives_are_said_in_their_own_way() -> None:
    of = problem()
    said = event(of, "end", 0.2, s=(-1, 1, -0.07))
    assert said["time"] == of.grid.t[-1]
    assert said["text"] == "the carriers end up to 0.07 m from the datum"
    np.testing.assert_allclose(said["amount"], 0.07)
    assert event(problem("rest"), "end", 0.25)["text"] == "the end state by 0.25 of its size"
    said = event(of, "at_most", 0.25, tau=(3, 0, 100.0))
    assert said["objective"] == "effort"
    assert said["time"] == of.grid.t[0]
    np.testing.assert_allclose([said["amount"], said["limit"], said["fraction"]], [1.0, 5.0, 0.25])
    assert said["text"] == "effort at most, from 4 to 5 (25 %)"


@pytest.mark.parametrize(
    ("kind", "changed", "touched"),
    [
        ("track", {"s": (4, 0, 0.15)}, True),
        ("track", {"s": (4, 0, -0.1)}, True),
        ("track", {"s": (4, 0, 0.15 - 1e-4)}, False),
        ("track", {"s": (4, 0, -0.1 + 1e-4)}, False),
        ("speed", {"sd": (4, 1, -1.5)}, True),
        ("speed", {"sd": (4, 1, 1.49)}, False),
        ("jerk", {"sdd": (4, 1, 69.999)}, False),
        ("end", {}, False),
        ("at_most", {}, True),
    ],
)
def test_limits_that_are_touched(kind: str, changed: dict[str, tuple[int, int, float]], touched: bool) -> None:
    """Within a ten thousandth of their range."""
    of = problem()
    if kind == "jerk":
        changed = {"sdd": (4, 1, 699.0 * of.grid.h[4])}
    assert infeasible.is_touched(of, robot_record(zoo.robot_of("2rpr")), solution(of, **changed), kind) is touched


def test_guesses_after_the_first_swing_about_the_start() -> None:
    """s, ṡ and s̈ of one motion: by differences where ṡ and s̈ are not cut off."""
    of = problem()
    warm = first_guess(of, 0)
    np.testing.assert_allclose(warm["s"] * of.scales.s, np.tile(of.settings.start, (len(of.grid.t), 1)))
    guess, u = first_guess(of, 3), of.scales
    t = of.grid.t
    s, sd, sdd = (guess[name] * getattr(u, name) for name in ("s", "sd", "sdd"))
    np.testing.assert_allclose(s[[0, -1]], np.zeros((2, 2)), atol=1e-12)
    assert np.abs(guess["s"]).max() <= REACH
    assert np.abs(guess["s"]).max() > 0.1 * REACH
    # sums of sines of half a turn and its multiples: fitted, and differentiated
    waves = np.sin(np.pi * np.arange(1, 4) * ((t - t[0]) / (t[-1] - t[0]))[:, None])
    size, left, *_ = np.linalg.lstsq(waves, s, rcond=None)
    assert np.sqrt(left).max() < 1e-9
    frequency = np.pi * np.arange(1, 4) / (t[-1] - t[0])
    rate = (frequency * np.cos(frequency * (t[:, None] - t[0]))) @ size
    second = -(frequency**2 * np.sin(frequency * (t[:, None] - t[0]))) @ size
    np.testing.assert_allclose(sd, np.clip(rate, -0.9 * u.sd, 0.9 * u.sd), atol=1e-9)
    np.testing.assert_allclose(sdd, np.clip(second, -0.9 * u.sdd, 0.9 * u.sdd), atol=1e-8)


def test_steps_leave_an_elastic_limit_only_beyond_what_it_gave_way_by() -> None:
    """Tracks are 0.25 m long, speeds 2 and 1.5 m/s: by a fifth of half of that, and of the speeds themselves."""
    of = problem()
    bounds = relaxed_bounds(of, solution(of, 0.2).values)
    s, sd = (np.array(bounds[name]) * getattr(of.scales, name) for name in ("s", "sd"))
    np.testing.assert_allclose(s, [[-0.125, -0.225], [0.175, 0.075]], rtol=1e-6)
    np.testing.assert_allclose(sd, [[-2.4, -1.8], [2.4, 1.8]], rtol=1e-6)
    kept = relaxed_bounds(of, {"s": solution(of).values["s"]})
    np.testing.assert_allclose(np.array(kept["s"]) * of.scales.s, np.array(LIMITS["track"]).T, rtol=1e-6)


BLAMED = [
    ("Maximum_WallTime_Exceeded", "seconds", "time ran out"),
    ("Restoration_Failed", "balance", "by 0.25 of f"),
]


@pytest.mark.parametrize(("message", "constraint", "says"), BLAMED)
def test_where_nothing_helps_the_time_or_the_balance_is_to_blame(message: str, constraint: str, says: str) -> None:
    elastic = SimpleNamespace(message=message, violation=0.25)
    error = infeasible.nothing_helps(problem(), elastic, "Infeasible_Problem_Detected")
    assert error.details["constraint"] == constraint
    assert says in str(error)
    assert error.details["amount"] == 0.25


def test_a_platform_at_rest_is_scaled_by_what_its_carriers_do() -> None:
    """Where f is zero with parked carriers: the largest force that an acceleration at its limit asks for."""
    dynamics = rp.VirtualWork(zoo.robot_of("2rpr"))
    t = np.linspace(0.0, 1.0, 20)
    still = np.zeros((20, 2))
    motion = rp.PlatformMotion(t, still + np.array([0.25, 0.2]), still, still)
    source = as_motion(motion)
    settings = checked_settings(dynamics.robot, Objective("effort"), Limits(acceleration=8.0), Mesh(0.1, 0))
    scales = read_problem(Task(dynamics, source, settings), grid_of(source, [], 0.1))[0].scales
    pushed = []
    for j in range(2):
        sdd = np.zeros((1, 2))
        sdd[0, j] = 8.0
        carriers = rp.CarrierMotion(np.zeros((1, 2)), np.zeros((1, 2)), sdd, check_rates=False)
        pushed.append(np.abs(rp.RneaDynamics(dynamics.robot).reduce(motion[:1], carriers).f).max())
    np.testing.assert_allclose(scales.row, max(pushed), rtol=1e-9)


# --- which limits are tried, from solutions made up here ---

NOTHING = 1e-5
"""Fraction of a limit below which it has not given way."""


def elastic(slacks: dict[str, float], iterations: int = 1, **how: Any) -> Any:
    """A solution in which limits give way by so much, and nothing moves."""
    made = solution(problem())
    made.values |= {slack_name(kind): np.full((1, 1), fraction) for kind, fraction in slacks.items()}
    usual = {"feasible": True, "optimal": True, "infeasible": False, "message": "said", "violation": 0.0}
    return SimpleNamespace(values=made.values, iterations=iterations, **{**usual, **how})


class Solved:
    """Stands in for the solver: the answer to each set of kinds that may give way; each takes a second."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, answers: dict[tuple[str, ...], Any], spared: int) -> None:
        self.now, self.answers, self.tried = 100.0, answers, []
        monkeypatch.setattr(infeasible, "SPARED", spared * len(problem().grid.t))
        monkeypatch.setattr(infeasible, "solve", self)
        monkeypatch.setattr(infeasible, "time", SimpleNamespace(perf_counter=lambda: self.now))

    def __call__(
        self, of: Problem, guess: Any, seconds: float, stop: Any = None, *, elastic: Any, most: int | None = None
    ) -> Any:
        self.now += 1.0
        self.tried.append((elastic[0] if len(elastic) == 1 else "all", seconds, most))
        return self.answers[elastic]

    def refused(self, seconds: float = 60.0) -> InfeasiblePlanError:
        of = problem()
        settings = replace(of.settings, solver=replace(of.settings.solver, seconds=seconds))
        with pytest.raises(InfeasiblePlanError) as caught:
            infeasible.relax(replace(of, settings=settings), robot_record(zoo.robot_of("2rpr")), {}, "said")
        return caught.value


def test_limits_that_hardly_give_way_are_none(monkeypatch: pytest.MonkeyPatch) -> None:
    kept = elastic({"speed": 0.9 * NOTHING, "effort": 0.9 * NOTHING})
    solved = Solved(monkeypatch, {KINDS: kept}, 100)
    assert infeasible.relax(problem(), robot_record(zoo.robot_of("2rpr")), {}, "said") is kept
    solved.answers[KINDS] = elastic({"speed": 1.1 * NOTHING})
    solved.answers |= {(kind,): elastic({}, optimal=False, infeasible=True) for kind in KINDS}
    error = solved.refused()
    assert (error.details["constraint"], error.details["together"], error.details["untried"]) == ("speed", False, ())


def test_a_limit_exceeded_between_the_nodes_alone_is_in_the_way(monkeypatch: pytest.MonkeyPatch) -> None:
    """With limits at the nodes alone, where ``stop`` ends the search, none gives way."""

    def solve(of: Problem, guess: Any, seconds: float, stop: Any = None, *, elastic: Any, most: Any = None) -> Any:
        return solved(of, guess, seconds, elastic=elastic, most=most) if stop is None else kept

    kept = elastic({})
    solved = Solved(monkeypatch, {KINDS: elastic({"speed": 0.1})}, 100)
    solved.answers |= {(kind,): elastic({}, optimal=False, infeasible=True) for kind in KINDS}
    monkeypatch.setattr(infeasible, "solve", solve)
    assert solved.refused().details["constraint"] == "speed"


def test_each_limit_that_gave_way_is_tried_alone_and_the_least_relaxation_comes_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Efforts first; a bound of an objective counts as touched. Each has what others left of iterations and time."""
    answers = {
        KINDS: elastic({"speed": 0.1, "effort": 0.2, "jerk": 0.3}, 7),
        ("effort",): elastic({"effort": 0.5}, 30),
        ("speed",): elastic({"speed": 0.25}, 20),
        ("jerk",): elastic({}, 10, optimal=False, infeasible=True),
        ("at_most",): elastic({}, 10, optimal=False),
    }
    solved = Solved(monkeypatch, answers, 100)
    details = solved.refused().details
    order = [name for name, _, _ in solved.tried]
    assert order[:2] == ["all", "effort"]
    spent = {"all": 0, "effort": 30, "speed": 20, "jerk": 10, "at_most": 10}
    assert sorted(order) == sorted(spent)
    for number, (_, seconds, most) in enumerate(solved.tried[1:], 1):
        assert seconds == 60.0 - number
        assert most == 100 - sum(spent[name] for name in order[:number])
    assert [event["constraint"] for event in details["relaxations"]] == ["speed", "effort"]
    assert [event["fraction"] for event in details["relaxations"]] == [0.25, 0.5]
    assert (details["constraint"], details["together"], details["untried"]) == ("speed", False, ("at_most",))


@pytest.mark.parametrize(("spared", "seconds", "tries"), [(30, 60.0, 1), (31, 60.0, 2), (100, 2.0, 1), (100, 2.5, 2)])
def test_where_iterations_or_time_run_out_the_rest_is_said_to_be_untried(
    spared: int, seconds: float, tries: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first takes 30 iterations, and it and the elastic programme a second each."""
    stuck = elastic({}, 30, optimal=False, infeasible=True)
    answers = {(kind,): stuck for kind in KINDS} | {KINDS: elastic({"speed": 0.1, "effort": 0.2}, 7)}
    solved = Solved(monkeypatch, answers, spared)
    details = solved.refused(seconds).details
    assert len([name for name, *_ in solved.tried if name != "all"]) == tries
    assert len(details["untried"]) == 3 - tries
    assert details["together"]
    assert [event["constraint"] for event in details["relaxations"]] == ["speed", "effort"]


def test_single_limits_have_at_least_twice_the_iterations_of_all_together(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = {(kind,): elastic({}, 1000, optimal=False, infeasible=True) for kind in KINDS}
    solved = Solved(monkeypatch, answers | {KINDS: elastic({"speed": 0.1, "effort": 0.2}, 55)}, 9)
    solved.refused()
    assert [most for name, _, most in solved.tried if name != "all"] == [110]


@pytest.mark.parametrize(
    ("least", "named"),
    [
        ({"effort": 5.0, "energy": 9.0}, {"effort": (1.0, 5.0, 0.25)}),
        ({"effort": 3.0, "energy": 13.5}, {"energy": (4.5, 13.5, 0.5)}),
        ({"effort": 5.0, "energy": 13.5}, {"effort": (1.0, 5.0, 0.25), "energy": (4.5, 13.5, 0.5)}),
        ({"effort": 4.0 * (1.0 + 0.9 * NOTHING), "energy": 4.0}, {}),
    ],
)
def test_bounds_are_compared_with_the_least_there_is(
    least: dict[str, float], named: dict[str, tuple[float, ...]], monkeypatch: pytest.MonkeyPatch
) -> None:
    """The bounds are 4 and 9; of what is no optimum nothing is known."""
    asked = []

    def solve(of: Problem, *_: Any) -> Any:
        asked.append((dict(of.settings.objective), dict(of.settings.at_most)))
        return SimpleNamespace(values={}, optimal=optimal)

    monkeypatch.setattr(infeasible, "solve", solve)
    monkeypatch.setattr(infeasible, "objective_values", lambda of, values: least)
    optimal = False
    infeasible.require_bounds(problem(), {})
    assert asked == [({"effort": 1.0}, {}), ({"energy": 1.0}, {})]
    optimal = True
    if not named:
        infeasible.require_bounds(problem(), {})
        return
    with pytest.raises(InfeasiblePlanError, match="What is needed at least: ") as caught:
        infeasible.require_bounds(problem(), {})
    details = caught.value.details
    assert details["together"] is (len(named) > 1)
    for event in details["relaxations"]:
        numbers = [event[name] for name in ("amount", "limit", "fraction")]
        np.testing.assert_allclose(numbers, named[event["objective"]], rtol=1e-12)
    assert [event["objective"] for event in details["relaxations"]] == list(named)


# --- several first guesses ---


def ended(cost: float, place: float = 0.0, feasible: bool = True, optimal: bool = True) -> Outcome:
    values = {"s": np.array([[0.0, 0.1], [0.0, place]])}
    made: Any = SimpleNamespace(cost=cost, values=values, feasible=feasible, optimal=optimal, message="said")
    return Outcome(problem(), made)


def test_optima_of_one_cost_and_motion_are_one() -> None:
    """Costs to 1e-5 of themselves, positions to a hundredth of half the track."""
    outcomes = (
        ended(-200.0, 0.5), ended(-200.0 * (1.0 - 0.9e-5), 0.509), ended(-200.0, 0.511),
        ended(-200.0 * (1.0 + 1.1e-5), 0.5),
        ended(-900.0, optimal=False), ended(-1e9, feasible=False, optimal=False), ended(-200.001, 0.5),
    )  # fmt: skip
    said = Multistart(outcomes, 9).summary
    assert said["optima"] == [
        {"cost": -200.0 * (1.0 + 1.1e-5), "starts": [3]},
        {"cost": -200.001, "starts": [0, 1, 6]},
        {"cost": -200.0, "starts": [2]},
    ]
    assert (said["asked"], said["tried"], said["converged"], said["won"]) == (9, 7, 5, 3)
    np.testing.assert_allclose(said["costs"], [one.solution.cost for one in outcomes[:5]] + [np.nan, -200.001])  # type: ignore[arg-type]


def test_the_best_is_an_optimum_before_what_keeps_the_limits_before_the_rest() -> None:
    only, kept, lost = ended(5.0), ended(3.0, optimal=False), ended(1.0, feasible=False, optimal=False)
    for outcomes, best in (((lost, kept, only), only), ((lost, kept), kept), ((lost,), lost)):
        several = Multistart(outcomes, 3)
        assert several.best is best
        assert several.feasible is (best is not lost)


@pytest.mark.parametrize(
    ("seconds", "each", "given"),
    [(5.0, 2.0, [5.0, 3.0, 1.0]), (5.0, 2.5, [5.0, 2.5]), (5.0, 0.5, [5.0, 4.5, 4.0, 3.5]), (1e-6, 1.0, [None])],
)
def test_first_guesses_share_the_time_there_is(
    seconds: float, each: float, given: list[float | None], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Four are asked for; the first is tried however little time there is."""
    of, clock, asked = problem(), [100.0], []
    of = replace(of, settings=replace(of.settings, solver=replace(of.settings.solver, starts=4, seconds=seconds)))
    monkeypatch.setattr(solving, "time", SimpleNamespace(perf_counter=lambda: clock[0]))

    def solve(of: Problem, guess: dict[str, Any], left: float, stop: Any) -> Any:
        asked.append((guess, left))
        clock[0] += each
        return ended(1.0).solution

    monkeypatch.setattr(solving, "solve", solve)
    made = solving.multistart(of, None)
    assert (len(made.outcomes), made.requested) == (len(given), 4)
    assert [left for _, left in asked] == [LEAST_SECONDS if left is None else left for left in given]
    assert set(asked[0][0]) == {"s"}
    for number, (guess, _) in enumerate(asked):
        np.testing.assert_array_equal(guess["s"], first_guess(of, number)["s"])
