"""Objectives of one's own, by their formulas, and where a user finds those that there are."""

import re
from pathlib import Path

import numpy as np
import pytest
import zoo

from redundancy_pin import VirtualWork, plan_whole_trajectory
from redundancy_pin.errors import InputError
from redundancy_pin.planners.optimal import OBJECTIVES, ObjectiveTerm
from redundancy_pin.planners.options import Limits, Mesh, Objective
from redundancy_pin.trajectory import reference

CIRCLE = reference.circle(0.5, 0.2, 0.05)


def plan_of(objective, dt=0.06):
    return plan_whole_trajectory(
        VirtualWork(zoo.robot_of("2rpr")),
        CIRCLE,
        objective=Objective(objective, calm=0.0),
        mesh=Mesh(dt=dt, refinements=0),
        limits=Limits(effort=0.3),
    )


def test_an_objective_is_added_by_its_formula(monkeypatch):
    """The mean square of the carriers' speeds, and the largest of them: one integral, one largest value."""
    added = {
        "carrier_speed": ObjectiveTerm(lambda q: q.integral(q.sd**2), lambda u: u.duration * float(u.sd.max()) ** 2),
        "fastest_carrier": ObjectiveTerm(
            lambda q: q.largest(q.sd, float(q.scales.sd.max())), lambda u: float(u.sd.max())
        ),
    }
    for name, term in added.items():
        monkeypatch.setitem(OBJECTIVES, name, term)
    plans = {name: plan_of(name) for name in ("effort", *added)}
    half = 0.5 * np.diff(plans["effort"].t)
    weights = (np.append(half, 0.0) + np.append(0.0, half))[:, None]
    measures = {
        "carrier_speed": lambda plan: (weights * plan.carriers.sd**2).sum(),
        "fastest_carrier": lambda plan: np.abs(plan.carriers.sd).max(),
    }
    for name, measure in measures.items():
        assert plans[name].findings.optimal
        assert plans[name].diagnostics["objective"][name] == pytest.approx(measure(plans[name]), rel=1e-9)
        assert all(measure(plans[name]) <= (1.0 + 1e-3) * measure(other) for other in plans.values())
    assert measures["fastest_carrier"](plans["fastest_carrier"]) < 0.9 * measures["fastest_carrier"](plans["effort"])


def test_sizes_are_one_number_or_one_for_each_joint(monkeypatch):
    """The largest speed as a fraction of each carrier's limit: with equal limits it is the largest speed over that."""
    speeds = {
        "fastest": lambda q: q.largest(q.sd, float(q.scales.sd.max())),
        "fraction": lambda q: q.largest(q.sd, q.scales.sd),
        "distance": lambda q: q.integral(q.absolute(q.sd, q.scales.sd)),
        "distance_at_once": lambda q: q.integral(q.absolute(q.sd, float(q.scales.sd.max()))),
    }
    for name, formula in speeds.items():
        monkeypatch.setitem(OBJECTIVES, name, ObjectiveTerm(formula, lambda u: float(u.sd.max())))
    plans = {name: plan_of(name, dt=0.12) for name in speeds}
    limits = plans["fraction"].limits.judged_by.speed
    for name, plan in plans.items():
        assert plan.findings.optimal
        rates = np.abs(plan.carriers.sd)
        measure = np.trapezoid(rates.sum(axis=1), plan.t) if "distance" in name else rates.max()
        unit = limits[0] if name == "fraction" else 1.0
        assert plan.least_cost == pytest.approx(measure / unit, rel=1e-9)
    assert plans["fraction"].least_cost == pytest.approx(plans["fastest"].least_cost / limits[0], rel=1e-6)
    assert plans["distance"].least_cost == pytest.approx(plans["distance_at_once"].least_cost, rel=1e-6)


@pytest.mark.parametrize(
    ("formula", "size", "message"),
    [
        (lambda q: q.largest(q.sd, [1.0, 2.0, 3.0]), lambda u: 1.0, "size is"),
        (lambda q: q.largest(q.sd, [1.0, 0.0]), lambda u: 1.0, "positive"),
        (lambda q: q.sd**2, lambda u: 1.0, "numbers, not one"),
        (lambda q: q.integral(q.sd**2), lambda u: u.sd, "not one number"),
        (lambda q: q.integral(q.sd**2), lambda u: 0.0, "size of an objective"),
    ],
)
def test_sizes_and_formulas_of_another_shape_are_refused(monkeypatch, formula, size, message):
    monkeypatch.setitem(OBJECTIVES, "wrong", ObjectiveTerm(formula, size))
    with pytest.raises(InputError, match=message):
        plan_of("wrong")


@pytest.mark.long_for("absolute")
@pytest.mark.parametrize("term", ["absolute", "rate"])
def test_formulas_may_bound_and_differentiate(monkeypatch, term):
    formulas = {
        "absolute": (lambda q: q.integral(q.absolute(q.sd, float(q.scales.sd.max()))), lambda u: u.duration),
        "rate": (lambda q: q.integral_over_steps(q.rate(q.sdd) ** 2), lambda u: 1e3 * u.duration),
    }
    monkeypatch.setitem(OBJECTIVES, term, ObjectiveTerm(*formulas[term]))
    plan, usual = (plan_of(weights) for weights in (term, {"effort": 1.0, term: 1e-9}))
    assert plan.diagnostics["objective"][term] < 0.9 * usual.diagnostics["objective"][term]


def test_every_objective_is_named_where_a_user_looks_for_it():
    """In the planner's documentation and in the problem file of the documentation: all of them, and no others."""
    problem = (Path(__file__).parents[3] / "docs/problem.yaml").read_text()
    (listed,) = re.findall(
        r"objective \(a word, or weights: \{.*?\}; (.*?)\)", re.sub(r"\n#\s*", " ", problem), re.DOTALL
    )
    assert set(listed.split(", ")) == set(OBJECTIVES)
    text = plan_whole_trajectory.__doc__.partition("objective: ")[2].partition("lam: ")[0]
    assert set(re.findall(r'"(\w+)"\s+(?:∫|max)', text)) == set(OBJECTIVES)
