"""Several first guesses, limits between the nodes, strategies of the solver, and progress."""

from types import SimpleNamespace

import numpy as np
import pytest
import zoo
from scipy.interpolate import CubicSpline

import redundancy_pin.planners.optimal.nlp as solver
import redundancy_pin.planners.optimal.solve as constraint_generation
from redundancy_pin import CompiledDynamics, RneaDynamics, VirtualWork, plan_whole_trajectory
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.optimal import infeasible, refine, whole_trajectory
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import Line


def two_optima(**settings):
    """A line of the five-bar with wide limits that has two best plans nearby."""
    path = Line((0.159, 0.662), (0.247, 0.348))
    trajectory = Trajectory(path, SpeedProfile(path.length, 0.37, 0.2))
    return plan_whole_trajectory(
        CompiledDynamics(zoo.robot_of("five_bar")),
        trajectory,
        objective="peak",
        dt=trajectory.duration / 30,
        refinements=0,
        acceleration=30.0,
        speed=4.0,
        **settings,
    )


def test_random_first_guesses_are_swings_that_end_where_they_began(monkeypatch):
    """Their rates are those of their positions, as far as they are not cut off at the limits."""
    guesses, first_guess = [], constraint_generation.first_guess

    def kept(problem, number):
        guesses.append((problem, first_guess(problem, number)))
        return guesses[-1][1]

    monkeypatch.setattr(constraint_generation, "first_guess", kept)
    circle = reference.circle(0.5, 0.2, 0.05)
    plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), circle, dt=0.03, refinements=0, starts=3)
    assert len(guesses) == 3
    for problem, guess in guesses[1:]:
        t, u = problem.grid.t, problem.scales
        s, sd, sdd = guess["s"] * u.s, guess["sd"] * u.sd, guess["sdd"] * u.sdd
        np.testing.assert_allclose(s[[0, -1]], np.tile(problem.settings.start, (2, 1)), atol=1e-12 * u.s.max())
        assert np.ptp(s, axis=0).min() > 0.01 * u.s.max()
        middle = 0.5 * (t[1:] + t[:-1])
        for value, rate, scaled in ((s, sd, guess["sd"]), (sd, sdd, guess["sdd"])):
            quotient = CubicSpline(t, value)(middle, 1)
            inside = np.abs(scaled).max(axis=1) < 0.9
            inside = inside[1:] & inside[:-1]
            assert inside.any()
            exact = CubicSpline(t, rate)(middle)[inside]
            np.testing.assert_allclose(quotient[inside], exact, atol=0.02 * np.abs(exact).max())


def test_the_best_of_several_optima_is_kept_and_all_are_reported():
    plan = two_optima(starts=4)
    starts = plan.diagnostics["starts"]
    assert (starts["asked"], starts["tried"], starts["converged"]) == (4, 4, 4)
    costs = [optimum["cost"] for optimum in starts["optima"]]
    assert len(costs) == 2
    assert costs[0] < (1.0 - 1e-3) * costs[1]
    assert sorted(number for optimum in starts["optima"] for number in optimum["starts"]) == list(range(4))
    assert starts["won"] in starts["optima"][0]["starts"]
    assert starts["costs"][starts["won"]] == min(starts["costs"]) == plan.diagnostics["cost"]


@pytest.mark.long
def test_every_first_guess_is_tried_before_the_planner_gives_up(monkeypatch):
    tried = set()
    solve_nlp = constraint_generation.solve_nlp

    def counted(nlp, guess, *others):
        if isinstance(guess, dict) and set(guess) <= {"s", "sd", "sdd"}:  # later ones begin at solutions, with efforts
            tried.add(np.asarray(guess["s"]).tobytes())
        return solve_nlp(nlp, guess, *others)

    monkeypatch.setattr(constraint_generation, "solve_nlp", counted)
    with pytest.raises(InfeasiblePlanError):
        plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(2.5), dt=0.03, starts=3)
    assert len(tried) == 3


@pytest.mark.long
def test_one_optimum_is_reported_as_one():
    plan = plan_whole_trajectory(
        VirtualWork(zoo.robot_of("2rpr")), reference.circle(), dt=0.05, starts=3, refinements=0
    )
    starts = plan.diagnostics["starts"]
    assert len(starts["optima"]) == 1
    assert starts["optima"][0]["starts"] == [0, 1, 2]


COARSE = {"dt": 0.04, "refinements": 0}
"""Steps so long that plans overshoot their limits between the nodes unless that is prevented."""


@pytest.mark.long_for("speed-0.55-stopped early", "track-0.05-stopped early", "speed-0.55-optimal")
@pytest.mark.parametrize("tolerance", [1e-9, 1e-40], ids=["optimal", "stopped early"])
@pytest.mark.parametrize(("quantity", "limit"), [("speed", 0.55), ("track", 0.05)])
def test_limits_hold_between_the_nodes_where_they_are_met(quantity, limit, tolerance, monkeypatch):
    """Also where the solver stops before a tolerance that it never reaches."""
    monkeypatch.setattr(solver, "TOLERANCE", tolerance)
    setting = {"speed": limit} if quantity == "speed" else {"track": (-limit, limit)}
    plan = plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(0.6, 0.2), **COARSE, **setting)
    assert plan.diagnostics["optimal"] is (tolerance == 1e-9)
    assert plan.status is (ResultStatus.OK if plan.diagnostics["optimal"] else ResultStatus.NOT_CONVERGED)
    c = plan.carriers
    position = PiecewisePolynomial.linear(plan.t, c.s, c.sd, c.sdd)
    least, most = (position if quantity == "track" else position.derivative()).ranges()
    assert (1.0 - 1e-3) * limit <= max(most.max(), -least.min()) <= limit


def test_long_plans_report_their_progress(monkeypatch):
    monkeypatch.setattr(solver, "LONG", 10)
    monkeypatch.setattr(solver, "PERIOD", 0.0)
    lines = []
    plan = plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(), dt=0.05, progress=lines.append)
    reported = [line for line in lines if line.startswith("iteration")]
    assert len(reported) >= plan.diagnostics["iterations"]
    assert "scaled objective" in reported[-1]


def test_short_plans_report_their_stages_only():
    lines = []
    plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(), dt=0.05, progress=lines.append)
    assert lines
    assert not [line for line in lines if line.startswith("iteration")]


def test_what_progress_raises_ends_the_planning(monkeypatch):
    monkeypatch.setattr(solver, "LONG", 10)

    def interrupt(line):
        if line.startswith("iteration"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(), dt=0.05, progress=interrupt)


STRATEGIES = [solver.FIRST, solver.FALLBACK, solver.WARM]


@pytest.mark.parametrize("options", STRATEGIES, ids=["first", "fallback", "warm"])
def test_the_barrier_parameter_ends_at_a_known_value(options):
    """Minimise wᵀ s with s ≥ 0: on the central path w s = μ exactly. What ends elsewhere has another flat optimum."""
    weights = np.array([[1.0], [0.03], [20.0]])
    nlp = solver.NLP()
    s = nlp.variable("s", (3, 1), 0.0)
    nlp.within(s, -np.inf, 10.0)
    nlp.cost = solver.ca.dot(solver.ca.DM(weights), s)
    found = solver.solve_nlp(nlp, {"s": np.ones((3, 1))}, 10.0, options)
    assert found.optimal
    np.testing.assert_allclose(found.values["s"] * weights, 1e-10, rtol=1e-2)


@pytest.mark.parametrize("options", STRATEGIES, ids=["first", "fallback", "warm"])
def test_the_last_steps_are_taken_where_newton_s_method_is_slow(options):
    """Minimise s⁴/4: each step takes off a third of s, and 0.7 of the slope s³. Three steps with slopes below 1e-9."""
    nlp = solver.NLP()
    s = nlp.variable("s", (1, 1))
    nlp.within(s, -10.0, 10.0)
    nlp.cost = s**4 / 4.0
    found = solver.solve_nlp(nlp, {"s": np.ones((1, 1))}, 10.0, options)
    assert found.optimal
    assert abs(float(found.values["s"][0, 0])) ** 3 < 1.2e-10


SAME_COST = 1e-6
"""Relative difference of the objective of two solutions that are one optimum: the solver's tolerance leaves 1e-7."""

BOTH_BACKENDS = 1e-6
"""Of the largest value, as of plans with fewer nodes."""


def square_plan(nodes, backend=VirtualWork, objective="peak"):
    trajectory = reference.square()
    dt = trajectory.duration / nodes
    return plan_whole_trajectory(
        backend(zoo.robot_of("3rrr")), trajectory, objective=objective, dt=dt, refinements=0, seconds=600.0
    )


@pytest.mark.long
def test_iterations_do_not_grow_with_the_nodes():
    """Ten times as many nodes. An objective that does not grow with them takes twice the iterations, 49 and 96."""
    few, many = (square_plan(nodes).diagnostics["iterations"] for nodes in (300, 3000))
    assert many <= 1.35 * few


@pytest.mark.long
def test_long_plans_are_the_same_from_both_backends():
    """At 1000 nodes the tolerance alone leaves efforts 2e-2 apart: the last steps have to be taken, and exactly."""
    ours, theirs = (square_plan(1000, backend) for backend in (VirtualWork, RneaDynamics))
    np.testing.assert_allclose(ours.tau, theirs.tau, atol=BOTH_BACKENDS * np.abs(theirs.tau).max())
    size = np.abs(theirs.carriers.sdd).max()
    np.testing.assert_allclose(ours.carriers.sdd, theirs.carriers.sdd, atol=BOTH_BACKENDS * size)


@pytest.mark.long_for("peak")
@pytest.mark.parametrize("objective", ["effort", "peak"])
def test_where_the_first_strategy_gives_up_the_next_finds_the_same_optimum(monkeypatch, objective):
    """Efforts too: within the tolerance alone those of two strategies are 2e-5 of the peak apart."""
    dynamics, trajectory = VirtualWork(zoo.robot_of("2rpr")), reference.circle()
    settings = {"objective": objective, "dt": 0.05, "refinements": 0}
    usual = plan_whole_trajectory(dynamics, trajectory, **settings)
    monkeypatch.setitem(solver.FIRST, "ipopt.max_iter", 3)
    other = plan_whole_trajectory(dynamics, trajectory, **settings)
    assert other.diagnostics["optimal"]
    assert other.diagnostics["iterations"] > usual.diagnostics["iterations"]
    assert other.diagnostics["cost"] == pytest.approx(usual.diagnostics["cost"], rel=SAME_COST)
    np.testing.assert_allclose(usual.tau, other.tau, atol=BOTH_BACKENDS * np.abs(other.tau).max())


def test_a_second_strategy_begins_at_what_keeps_the_limits_and_never_replaces_it(monkeypatch):
    """The first strategy is stopped beside the optimum; the second, which may do next to nothing, leaves the limits."""
    dynamics, trajectory = VirtualWork(zoo.robot_of("2rpr")), reference.circle()
    settings = {"objective": "effort_rate", "dt": 0.05, "refinements": 0}
    usual = plan_whole_trajectory(dynamics, trajectory, **settings)
    monkeypatch.setitem(solver.FIRST, "ipopt.max_iter", 9)
    monkeypatch.setitem(solver.FALLBACK, "ipopt.max_iter", 2)
    guesses, ended, solve_nlp = [], [], constraint_generation.solve_nlp

    def kept(nlp, guess, *others):
        guesses.append(guess)
        ended.append(solve_nlp(nlp, guess, *others))
        return ended[-1]

    monkeypatch.setattr(constraint_generation, "solve_nlp", kept)
    plan = plan_whole_trajectory(dynamics, trajectory, **settings)
    first, second, _ = ended  # the last one has rows between the nodes
    assert (first.feasible, first.optimal, second.feasible) == (True, False, False)
    assert second.cost < first.cost
    assert guesses[1] is first.values
    assert guesses[2] is first.values
    assert plan.diagnostics["cost"] == pytest.approx(usual.diagnostics["cost"], rel=SAME_COST)


class Clock:
    """A clock for all modules of the planner, on which each solution takes so many seconds."""

    def __init__(self, monkeypatch, each):
        self.now, self.left = 100.0, []
        solve_nlp = constraint_generation.solve_nlp

        def timed(nlp, guess, seconds, *others):
            self.left.append(seconds)
            self.now += each
            return solve_nlp(nlp, guess, 600.0, *others)

        monkeypatch.setattr(constraint_generation, "solve_nlp", timed)
        for module in (constraint_generation, infeasible, refine, whole_trajectory):
            monkeypatch.setattr(module, "time", SimpleNamespace(perf_counter=lambda: self.now))


def test_the_search_for_what_would_suffice_has_the_time_that_is_left(monkeypatch):
    clock = Clock(monkeypatch, 1.0)
    with pytest.raises(InfeasiblePlanError, match="What would suffice"):
        plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(2.5), dt=0.05, seconds=60.0)
    assert len(clock.left) > 3
    assert clock.left == [60.0 - i for i in range(len(clock.left))]


def test_meshes_share_the_time_and_where_it_is_over_the_last_plan_counts(monkeypatch):
    dynamics, trajectory = VirtualWork(zoo.robot_of("2rpr")), reference.circle()
    settings = {"objective": "peak", "dt": 0.05, "seconds": 60.0}
    coarse = plan_whole_trajectory(dynamics, trajectory, **settings, refinements=0)
    fine = plan_whole_trajectory(dynamics, trajectory, **settings)
    assert fine.diagnostics["nodes"] > coarse.diagnostics["nodes"]
    assert not fine.diagnostics["out_of_time"]
    with monkeypatch.context() as patched:
        clock = Clock(patched, 1.0)
        assert plan_whole_trajectory(dynamics, trajectory, **settings).diagnostics["nodes"] == fine.diagnostics["nodes"]
        assert clock.left == [60.0 - i for i in range(len(clock.left))]
    Clock(monkeypatch, 70.0)
    plan = plan_whole_trajectory(dynamics, trajectory, **settings)
    assert plan.diagnostics["out_of_time"]
    assert plan.diagnostics["nodes"] == coarse.diagnostics["nodes"]
    assert plan.status in (ResultStatus.UNRESOLVED, ResultStatus.LIMIT_VIOLATED)
