"""Several first guesses, limits between the nodes, strategies of the solver, its time, and progress."""

from types import SimpleNamespace

import numpy as np
import pytest
import zoo

import redundancy_pin.planners.optimal.nlp as solver
import redundancy_pin.planners.optimal.solve as constraint_generation
from redundancy_pin import CompiledDynamics, RneaDynamics, VirtualWork, plan_whole_trajectory
from redundancy_pin.planners.optimal import infeasible, refine, whole_trajectory
from redundancy_pin.planners.options import Limits, Mesh, Objective, Solver
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.paths import Line


def two_optima(starts):
    """A line of the five-bar with wide limits that has two best plans nearby."""
    path = Line((0.159, 0.662), (0.247, 0.348))
    trajectory = Trajectory(path, SpeedProfile(path.length, 0.37, 0.2))
    return plan_whole_trajectory(
        CompiledDynamics(zoo.robot_of("five_bar")),
        trajectory,
        objective="peak",
        mesh=Mesh(dt=trajectory.duration / 30, refinements=0),
        limits=Limits(acceleration=30.0, speed=4.0),
        solver=Solver(starts=starts),
    )


def test_the_best_of_several_optima_is_kept_and_all_are_reported():
    plan = two_optima(4)
    starts = plan.diagnostics["starts"]
    assert (starts["asked"], starts["tried"], starts["converged"]) == (4, 4, 4)
    costs = [optimum["cost"] for optimum in starts["optima"]]
    assert len(costs) == 2
    assert costs[0] < (1.0 - 1e-3) * costs[1]
    assert sorted(number for optimum in starts["optima"] for number in optimum["starts"]) == list(range(4))
    assert starts["won"] in starts["optima"][0]["starts"]
    assert starts["costs"][starts["won"]] == min(starts["costs"]) == plan.diagnostics["cost"]


@pytest.mark.long_for("speed-0.55-stopped early", "track-0.05-stopped early", "speed-0.55-optimal")
@pytest.mark.parametrize("tolerance", [1e-9, 1e-40], ids=["optimal", "stopped early"])
@pytest.mark.parametrize(("quantity", "limit"), [("speed", 0.55), ("track", 0.05)])
def test_limits_hold_between_the_nodes_where_they_are_met(quantity, limit, tolerance, monkeypatch):
    """Also where the solver stops before a tolerance that it never reaches."""
    monkeypatch.setattr(solver, "TOLERANCE", tolerance)
    # steps so long that plans overshoot their limits between the nodes unless that is prevented
    plan = plan_whole_trajectory(
        VirtualWork(zoo.robot_of("2rpr")),
        reference.circle(0.6, 0.2),
        mesh=Mesh(dt=0.04, refinements=0),
        limits=Limits(
            speed=limit if quantity == "speed" else None, track=(-limit, limit) if quantity == "track" else None
        ),
    )
    assert plan.findings.optimal is (tolerance == 1e-9)
    assert plan.status is (ResultStatus.OK if plan.findings.optimal else ResultStatus.NOT_CONVERGED)
    c = plan.carriers
    position = PiecewisePolynomial.linear(plan.t, c.s, c.sd, c.sdd)
    least, most = (position if quantity == "track" else position.derivative()).ranges()
    assert (1.0 - 1e-3) * limit <= max(most.max(), -least.min()) <= limit


def test_what_progress_raises_ends_the_planning(monkeypatch):
    monkeypatch.setattr(solver, "LONG", 10)

    def interrupt(line):
        if line.startswith("iteration"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan_whole_trajectory(
            VirtualWork(zoo.robot_of("2rpr")), reference.circle(), mesh=Mesh(dt=0.05), solver=Solver(progress=interrupt)
        )


def test_a_long_plan_needs_nobody_who_listens(monkeypatch):
    monkeypatch.setattr(solver, "LONG", 10)
    plan = plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(), mesh=Mesh(dt=0.05))
    assert plan.findings.optimal


def test_the_seconds_of_the_solver_are_those_of_its_solutions(monkeypatch):
    solve_nlp, seconds = constraint_generation.solve_nlp, []

    def noted(*arguments):
        solution = solve_nlp(*arguments)
        seconds.append(solution.seconds)
        return solution

    monkeypatch.setattr(constraint_generation, "solve_nlp", noted)
    plan = plan_whole_trajectory(
        VirtualWork(zoo.robot_of("2rpr")),
        reference.circle(),
        objective=Objective(calm=0.0),
        mesh=Mesh(dt=0.1, refinements=0),
    )
    assert plan.diagnostics["solver_seconds"] == pytest.approx(sum(seconds), rel=1e-9)


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


SAME_COST = 1e-6
"""Relative difference of the objective of two solutions that are one optimum: the solver's tolerance leaves 1e-7."""

BOTH_BACKENDS = 1e-6
"""Of the largest value, as of plans with fewer nodes."""


@pytest.mark.long_for("peak")
@pytest.mark.parametrize("objective", ["effort", "peak"])
def test_where_the_first_strategy_gives_up_the_next_finds_the_same_optimum(monkeypatch, objective):
    """Efforts too: within the tolerance alone those of two strategies are 2e-5 of the peak apart."""
    dynamics, trajectory = VirtualWork(zoo.robot_of("2rpr")), reference.circle()
    usual, other = None, None
    for most in (250, 3):
        monkeypatch.setitem(solver.FIRST, "ipopt.max_iter", most)
        usual, other = (
            other,
            plan_whole_trajectory(dynamics, trajectory, objective=objective, mesh=Mesh(dt=0.1, refinements=0)),
        )
    assert other.findings.optimal
    assert other.diagnostics["cost"] == pytest.approx(usual.diagnostics["cost"], rel=SAME_COST)
    np.testing.assert_allclose(usual.tau, other.tau, atol=BOTH_BACKENDS * np.abs(other.tau).max())


def test_a_second_strategy_never_replaces_what_keeps_the_limits(monkeypatch):
    """The first strategy is stopped beside the optimum; the second, which may do next to nothing, leaves the limits."""
    dynamics, trajectory = VirtualWork(zoo.robot_of("2rpr")), reference.circle()
    usual = plan_whole_trajectory(dynamics, trajectory, objective="effort_rate", mesh=Mesh(dt=0.05, refinements=0))
    monkeypatch.setitem(solver.FIRST, "ipopt.max_iter", 9)
    monkeypatch.setitem(solver.FALLBACK, "ipopt.max_iter", 2)
    plan = plan_whole_trajectory(dynamics, trajectory, objective="effort_rate", mesh=Mesh(dt=0.05, refinements=0))
    assert plan.diagnostics["cost"] == pytest.approx(usual.diagnostics["cost"], rel=SAME_COST)


@pytest.mark.long
def test_long_plans_are_the_same_from_both_backends():
    """At 1000 nodes the tolerance alone leaves efforts 2e-2 apart: the last steps have to be taken, and exactly."""
    square = reference.square()
    ours, theirs = (
        plan_whole_trajectory(
            backend(zoo.robot_of("3rrr")),
            square,
            objective="peak",
            mesh=Mesh(dt=square.duration / 1000, refinements=0),
            solver=Solver(seconds=600.0),
        )
        for backend in (VirtualWork, RneaDynamics)
    )
    np.testing.assert_allclose(ours.tau, theirs.tau, atol=BOTH_BACKENDS * np.abs(theirs.tau).max())


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


def test_meshes_share_the_time_and_where_it_is_over_the_last_plan_counts(monkeypatch):
    dynamics, trajectory = VirtualWork(zoo.robot_of("2rpr")), reference.circle()
    coarse, fine = (
        plan_whole_trajectory(
            dynamics, trajectory, objective="peak", mesh=Mesh(dt=0.1, refinements=often), solver=Solver(seconds=60.0)
        )
        for often in (0, 3)
    )
    assert fine.diagnostics["nodes"] > coarse.diagnostics["nodes"]
    assert not fine.diagnostics["out_of_time"]
    clock = Clock(monkeypatch, 70.0)
    plan = plan_whole_trajectory(dynamics, trajectory, objective="peak", mesh=Mesh(dt=0.1), solver=Solver(seconds=60.0))
    assert clock.left[0] == 60.0
    assert max(clock.left[1:], default=0.0) < 1.0
    assert plan.diagnostics["out_of_time"]
    assert plan.diagnostics["nodes"] == coarse.diagnostics["nodes"]
    assert plan.status in (ResultStatus.UNRESOLVED, ResultStatus.LIMIT_VIOLATED)
