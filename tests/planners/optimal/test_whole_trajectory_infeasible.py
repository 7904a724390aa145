"""Why there is no plan: the named limit, when and how much, checked by planning again with what is said to suffice."""

import time
from contextlib import nullcontext

import numpy as np
import pytest
import zoo

from redundancy_pin import CompiledDynamics, VirtualWork, plan_whole_trajectory
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.optimal import infeasible, whole_trajectory
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.case import in_groups
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.paths import Line

WIDER = 1.02
"""Limits are widened by a fiftieth more than what is said to suffice; the least relaxation itself leaves no room."""

NARROWER = 0.98
"""... and with a fiftieth of the relaxation missing there must be no plan."""

ROUNDING = 1e-6
"""Relative excess of an effort over its limit that the planner counts as rounding."""

SECONDS = 20.0
"""Time bound; the search for a plan and that for an explanation have as much each."""

STEPS = 30

ROOM = (9,)
"""Problems in which a plan needs less than is said to suffice: limits that give way are held between the nodes by hulls
in every step, those of a plan only in steps that leave them, and with speeds at their limit that is a fifth of 0.19."""

NAMES = {"force": "carrier_force"}


def straight(start, end, speed):
    path = Line(start, end)
    return Trajectory(path, SpeedProfile(path.length, speed, 0.2))


def random_problem(seed):
    """A robot and motion, and limits that no plan keeps: efforts below the least peak within the other limits."""
    rng = np.random.default_rng(seed)
    masses = {"end_effector_mass": float(rng.uniform(0.2, 0.5)), "cylinder_mass": float(rng.uniform(0.1, 0.3))}
    heavy, bar = VirtualWork(zoo.robot_of("2rpr", **masses)), CompiledDynamics(zoo.robot_of("five_bar"))
    line = straight(rng.uniform((0.1, 0.25), (0.4, 0.5)), rng.uniform((0.1, -0.5), (0.4, -0.25)), 0.5)
    across = straight((0.25, 0.6), rng.uniform((0.2, 0.25), (0.35, 0.35)), 0.4)
    circle = reference.circle(float(rng.uniform(0.4, 0.7)), 0.2)
    corner = reference.corner(float(rng.uniform(0.013, 0.03)))
    dynamics, trajectory, limits = (
        (VirtualWork(zoo.robot_of("2rpr")), circle, {}),
        (heavy, line, {"speed": float(rng.uniform(0.1, 0.3))}),
        (heavy, line, {"acceleration": float(rng.uniform(1.0, 3.0))}),
        (heavy, circle, {"jerk": float(rng.uniform(50.0, 100.0))}),
        (bar, across, {"track": float(rng.uniform(0.05, 0.1))}),
        (VirtualWork(zoo.robot_of("3rrr")), corner, {}),
        (bar, across, {"carrier_force": float(rng.uniform(0.1, 0.3)), "effort": 1.0}),
        (bar, across, {"speed": float(rng.uniform(0.05, 0.1)), "acceleration": float(rng.uniform(1.0, 2.0))}),
    )[seed % 8]
    if seed % 8 < 6:
        settings = {"dt": trajectory.duration / STEPS, "refinements": 0, "seconds": SECONDS}
        least = plan_whole_trajectory(
            dynamics,
            trajectory,
            **in_groups(plan_whole_trajectory, dict(objective="peak", **settings_of(limits), **settings)),
        )
        limits["effort"] = float(rng.uniform(0.7, 0.9)) * float(least.peak_effort_at_samples.max())
    return dynamics, trajectory, limits


def settings_of(limits):
    return {name: (-value, value) if name == "track" else value for name, value in limits.items()}


def relaxed(dynamics, limits, details, factor):
    """Limits let out by ``factor`` times the fraction that is said to suffice: one kind, or all named together.

    (That a freer end would do instead is not tried: it is not a limit that can be let out.)
    """
    merged = dict(limits)
    own = dynamics.robot.carrier_limits
    default = {
        "speed": own[0].speed,
        "acceleration": own[0].acceleration,
        "track": own[0].upper,
        "carrier_force": own[0].force,
    }
    events = [event for event in details["relaxations"] if event["constraint"] != "end"]
    for event in events if details["together"] else events[:1]:
        name = NAMES.get(event["constraint"], event["constraint"])
        merged[name] = merged.get(name, default.get(name)) * (1.0 + factor * event["fraction"])
    return merged


@pytest.mark.long_for("6", "1")
@pytest.mark.parametrize(
    "seed", [pytest.param(seed, marks=() if seed in (1, 6) else pytest.mark.long) for seed in range(16)]
)
def test_what_is_said_to_suffice_suffices_and_less_does_not(seed):
    dynamics, trajectory, limits = random_problem(seed)
    settings = {"dt": trajectory.duration / STEPS, "refinements": 0, "seconds": SECONDS}
    began = time.perf_counter()
    with pytest.raises(InfeasiblePlanError) as caught:
        plan_whole_trajectory(
            dynamics, trajectory, **in_groups(plan_whole_trajectory, dict(**settings_of(limits), **settings))
        )
    assert time.perf_counter() - began < 2.0 * SECONDS
    details = caught.value.details
    assert 0.0 <= details["time"] <= trajectory.duration
    assert details["amount"] > 0.0
    enough = relaxed(dynamics, limits, details, WIDER)
    plan = plan_whole_trajectory(
        dynamics, trajectory, **in_groups(plan_whole_trajectory, dict(**settings_of(enough), **settings))
    )
    # a statement about the nodes; without refinements efforts may exceed their limit between them, as the status says
    assert plan.diagnostics["optimal"]
    assert np.abs(plan.tau).max() <= enough.get("effort", np.inf) * (1.0 + ROUNDING)
    if plan.status is not ResultStatus.OK:
        assert {event.quantity for event in plan.limits.violated} == {"effort"}
        assert not plan.diagnostics["dense_check"]["passed"]
    too_little = relaxed(dynamics, limits, details, NARROWER)
    with nullcontext() if seed in ROOM else pytest.raises(InfeasiblePlanError):
        plan_whole_trajectory(
            dynamics, trajectory, **in_groups(plan_whole_trajectory, dict(**settings_of(too_little), **settings))
        )


def test_what_was_not_tried_is_said(monkeypatch):
    """Of a limit that does not do by itself this takes ten times as long to see as of one that does."""
    monkeypatch.setattr(infeasible, "SPARED", 0)
    dynamics, trajectory, limits = random_problem(6)
    settings = {"dt": trajectory.duration / STEPS, "refinements": 0}
    with pytest.raises(InfeasiblePlanError, match="Not tried to the end: ") as caught:
        plan_whole_trajectory(
            dynamics, trajectory, **in_groups(plan_whole_trajectory, dict(**settings_of(limits), **settings))
        )
    assert set(caught.value.details["untried"]) >= {"effort"}
    assert caught.value.details["together"]


def test_a_bound_below_the_least_there_is_names_that_least_without_a_search(monkeypatch):
    dynamics, trajectory = CompiledDynamics(zoo.robot_of("five_bar")), straight((0.25, 0.6), (0.3, 0.3), 0.4)
    settings = {"dt": trajectory.duration / STEPS, "refinements": 0}
    least = plan_whole_trajectory(
        dynamics, trajectory, **in_groups(plan_whole_trajectory, dict(objective="energy", **settings))
    ).diagnostics["objective"]["energy"]
    monkeypatch.setattr(whole_trajectory, "relax", None)
    with pytest.raises(InfeasiblePlanError, match="What would suffice: energy at most") as caught:
        plan_whole_trajectory(
            dynamics,
            trajectory,
            at_most={"energy": 0.5 * least},
            **in_groups(plan_whole_trajectory, dict(objective="peak", **settings)),
        )
    assert caught.value.details["limit"] == pytest.approx(least, rel=1e-6)
    assert caught.value.details["constraint"] == "at_most"
    kept = plan_whole_trajectory(
        dynamics,
        trajectory,
        at_most={"energy": 1.01 * least},
        **in_groups(plan_whole_trajectory, dict(objective="peak", **settings)),
    )
    assert kept.diagnostics["objective"]["energy"] <= 1.01 * least * (1.0 + ROUNDING)
