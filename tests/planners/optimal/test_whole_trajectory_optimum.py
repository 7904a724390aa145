"""The optimum of the whole-trajectory planner against formulations that share nothing with it but the nodes."""

import numpy as np
import pytest
import zoo
from full_model import solve_2rpr, solve_by_backend

from redundancy_pin import CompiledDynamics, VirtualWork, plan_whole_trajectory
from redundancy_pin.planners.options import Limits, Mesh, Solver
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.paths import Line

SAME = 1e-3
"""Relative difference of the objectives that the issue of this planner allows; found are 1e-6 or less."""

LIMITS = {"speed": 2.5, "track": 0.2, "acceleration": 10.0}


def objective_of(plan, name):
    return plan.diagnostics["objective"][name]


@pytest.mark.long_for("peak")
@pytest.mark.parametrize("objective", [pytest.param("effort", marks=pytest.mark.long), "peak"])
def test_circle_through_both_singularities(objective):
    trajectory = reference.circle(0.5, 0.2, 0.05)
    plan = plan_whole_trajectory(
        VirtualWork(zoo.robot_of("2rpr")), trajectory, objective=objective, mesh=Mesh(dt=0.03, refinements=0)
    )
    assert len(plan.diagnostics["singular_nodes"]) == 2
    theirs = solve_2rpr(trajectory, plan, objective, LIMITS)
    np.testing.assert_allclose(objective_of(plan, objective), theirs, rtol=SAME)


@pytest.mark.long_for("1", "3")
@pytest.mark.parametrize("seed", range(4))
def test_random_lines_with_random_limits(seed):
    rng = np.random.default_rng(seed)
    start, end = rng.uniform((0.1, 0.25), (0.4, 0.5)), rng.uniform((0.1, -0.5), (0.4, -0.2))
    path = Line(start, end if seed % 2 else rng.uniform((0.1, 0.1), (0.4, 0.6)))
    trajectory = Trajectory(path, SpeedProfile(path.length, 0.4, 0.2))
    limits = {
        "speed": float(rng.uniform(0.3, 1.0)),
        "track": float(rng.uniform(0.05, 0.2)),
        "acceleration": float(rng.uniform(4.0, 10.0)),
    }
    objective = ("effort", "peak")[seed // 2]
    plan = plan_whole_trajectory(
        VirtualWork(zoo.robot_of("2rpr")),
        trajectory,
        objective=objective,
        mesh=Mesh(dt=0.04, refinements=0),
        limits=Limits(
            speed=limits["speed"], acceleration=limits["acceleration"], track=(-limits["track"], limits["track"])
        ),
    )
    assert plan.diagnostics["optimal"]
    theirs = solve_2rpr(trajectory, plan, objective, limits)
    np.testing.assert_allclose(objective_of(plan, objective), theirs, rtol=SAME)


@pytest.mark.long_for("peak")
@pytest.mark.parametrize("objective", ["effort", "peak"])
def test_corner_against_a_solver_that_asks_the_backend(objective):
    dynamics = CompiledDynamics(zoo.robot_of("3rrr"))
    plan = plan_whole_trajectory(dynamics, reference.corner(), objective=objective, mesh=Mesh(dt=0.2, refinements=0))
    limits = {"speed": 1.0, "track": 1.0, "acceleration": 7.0}
    theirs = solve_by_backend(dynamics, plan, objective, limits)
    np.testing.assert_allclose(objective_of(plan, objective), theirs, rtol=SAME)


@pytest.mark.long
def test_random_first_guesses_find_nothing_better():
    """Three random swings as first guesses end in the optimum that parked carriers lead to."""
    plan = plan_whole_trajectory(
        VirtualWork(zoo.robot_of("3rrr")),
        reference.corner(0.013),
        objective="peak",
        mesh=Mesh(dt=0.03, refinements=0),
        solver=Solver(starts=4),
    )
    costs = np.array(plan.diagnostics["costs"])
    assert len(costs) == 4
    np.testing.assert_allclose(costs, costs.min(), rtol=1e-6)
