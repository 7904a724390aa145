"""Several first guesses, rows between the nodes only where needed, and progress."""

import time

import numpy as np
import pytest
import zoo

import redundancy_pin.planners.whole_trajectory.constraint_generation as between
import redundancy_pin.planners.whole_trajectory.multistart as searching
import redundancy_pin.planners.whole_trajectory.planner as planner
import redundancy_pin.planners.whole_trajectory.solver as progress
import redundancy_pin.planners.whole_trajectory.solver as solver
from redundancy_pin import RneaDynamics, VirtualWork, plan_whole_trajectory
from redundancy_pin.planners.whole_trajectory.mesh import CarrierCourse
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.paths import Line


def two_optima(**settings):
    """A line of the five-bar with wide limits that has two best plans nearby."""
    path = Line((0.159, 0.662), (0.247, 0.348))
    trajectory = Trajectory(path, SpeedProfile(path.length, 0.37, 0.2))
    return plan_whole_trajectory(
        RneaDynamics(zoo.robot_of("five_bar")),
        trajectory,
        objective="peak",
        dt=trajectory.duration / 50,
        refinements=0,
        acceleration=30.0,
        speed=4.0,
        **settings,
    )


def test_the_best_of_several_optima_is_kept_and_all_are_told(monkeypatch):
    """Begun from the guess that leads to the second best, several starts find the best; the diagnostics say so."""
    second = two_optima(starts=6).diagnostics["starts"]["optima"][1]["starts"][0]
    usual = searching.first_guess
    monkeypatch.setattr(searching, "first_guess", lambda problem, warm, i: usual(problem, warm, (i + second) % 6))
    alone, several = two_optima(), two_optima(starts=6)
    found = several.diagnostics["starts"]
    assert (found["asked"], found["tried"], found["converged"]) == (6, 6, 6)
    costs = [optimum["cost"] for optimum in found["optima"]]
    assert len(costs) == 2
    assert costs == sorted(costs)
    assert sorted(number for optimum in found["optima"] for number in optimum["starts"]) == list(range(6))
    assert found["won"] in found["optima"][0]["starts"]
    assert 0 in found["optima"][1]["starts"]
    assert several.peak_effort.max() < (1.0 - 1e-3) * alone.peak_effort.max()
    assert found["costs"][found["won"]] == min(found["costs"]) == several.diagnostics["cost"]


def test_one_optimum_is_told_as_one():
    plan = plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(), dt=0.05, starts=3)
    found = plan.diagnostics["starts"]
    assert len(found["optima"]) == 1
    assert found["optima"][0]["starts"] == [0, 1, 2]


def test_exact_ranges_of_a_course_against_fine_samples():
    rng = np.random.default_rng(0)
    t = np.array([0.0, 0.3, 0.5, 0.5, 0.9, 1.0])
    course = CarrierCourse(t, *(rng.uniform(-1.0, 1.0, (6, 3)) * scale for scale in (0.1, 0.5, 20.0)))
    s_low, s_high, sd_low, sd_high = course.ranges()
    for i in np.flatnonzero(np.diff(t) > 0.0):
        x = np.linspace(0.0, t[i + 1] - t[i], 20001)[:, None]
        jerk = (course.sdd[i + 1] - course.sdd[i]) / (t[i + 1] - t[i])
        s = course.s[i] + course.sd[i] * x + course.sdd[i] * x**2 / 2 + jerk * x**3 / 6
        sd = course.sd[i] + course.sdd[i] * x + jerk * x**2 / 2
        # between samples 2e-5 s apart, 40 m/s² change ṡ by 1e-8 at an extreme
        for exact, sampled in ((s_low, s.min(0)), (s_high, s.max(0)), (sd_low, sd.min(0)), (sd_high, sd.max(0))):
            np.testing.assert_allclose(exact[i], sampled, atol=1e-7)


def test_a_course_of_constant_speed_has_its_ends_as_ranges():
    t = np.array([0.0, 1.0])
    course = CarrierCourse(t, np.array([[0.0], [2.0]]), np.full((2, 1), 2.0), np.zeros((2, 1)))
    assert [float(part[0, 0]) for part in course.ranges()] == [0.0, 2.0, 2.0, 2.0]


@pytest.mark.parametrize(("quantity", "limit"), [("speed", 0.55), ("track", 0.05)])
def test_limits_hold_between_the_nodes_where_they_are_met(quantity, limit, monkeypatch):
    """Coarse steps overshoot between the nodes unless rows are added: they are, and only in a few steps."""
    asked = []
    build = between.build

    def watched(problem, **settings):
        asked.append(settings.get("between"))
        return build(problem, **settings)

    monkeypatch.setattr(between, "build", watched)
    setting = {"speed": limit} if quantity == "speed" else {"track": (-limit, limit)}
    plan = plan_whole_trajectory(
        VirtualWork(zoo.robot_of("2rpr")), reference.circle(0.6, 0.2), dt=0.04, refinements=0, **setting
    )
    ranges = CarrierCourse(plan.t, plan.carriers.s, plan.carriers.sd, plan.carriers.sdd).ranges()
    low, high = ranges[:2] if quantity == "track" else ranges[2:]
    assert max(high.max(), -low.min()) <= limit
    assert max(high.max(), -low.min()) >= (1.0 - 1e-3) * limit
    assert len(asked) > 1
    assert 0 < sum(int(steps.sum()) for steps in asked[-1]) < 0.5 * (len(plan.t) - 1)


@pytest.mark.parametrize("narrow", [False, True])
def test_a_late_stop_is_a_plan_only_if_limits_hold_between_the_nodes(narrow, monkeypatch):
    """Stopped before a tolerance that it never reaches: feasible, or not so where a step leaves its speed limit."""
    limit = {"speed": 0.55} if narrow else {"track": (-1.0, 1.0)}
    setting = {"dt": 0.04, "refinements": 0, **limit}
    dynamics, trajectory = VirtualWork(zoo.robot_of("2rpr")), reference.circle(0.6, 0.2)
    problems = []
    search = planner.search

    def watched(problem, *arguments):
        problems.append(problem)
        return search(problem, *arguments)

    monkeypatch.setattr(planner, "search", watched)
    plan_whole_trajectory(dynamics, trajectory, **setting)
    problem = problems[0]
    monkeypatch.setattr(solver, "TOLERANCE", 1e-40)
    stopped = between._by_rows_needed(problem, {}, time.perf_counter() + 60.0, None)
    assert not stopped.optimal
    assert stopped.feasible is not narrow


def test_long_plans_tell_their_progress(monkeypatch):
    monkeypatch.setattr(searching, "LONG", 10)
    monkeypatch.setattr(progress, "PERIOD", 0.0)
    lines = []
    plan = plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(), dt=0.05, progress=lines.append)
    told = [line for line in lines if line.startswith("iteration")]
    assert len(told) >= plan.diagnostics["iterations"]
    assert "scaled objective" in told[-1]


def test_short_plans_tell_their_stages_only():
    lines = []
    plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(), dt=0.05, progress=lines.append)
    assert lines
    assert not [line for line in lines if line.startswith("iteration")]


def test_what_progress_raises_ends_the_planning(monkeypatch):
    monkeypatch.setattr(searching, "LONG", 10)

    def interrupt(line):
        if line.startswith("iteration"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), reference.circle(), dt=0.05, progress=interrupt)
