"""Options in groups, nodes, and an objective of one's own."""

import re
from pathlib import Path

import numpy as np
import pytest
import zoo

from redundancy_pin import VirtualWork, plan_whole_trajectory
from redundancy_pin.errors import InputError
from redundancy_pin.planners.optimal import OBJECTIVES, ObjectiveTerm
from redundancy_pin.planners.options import Limits, Mesh, Objective, Solver
from redundancy_pin.studies.case import in_groups
from redundancy_pin.trajectory import reference

CIRCLE = reference.circle(0.5, 0.2, 0.05)


def plan_of(**options):
    return plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), CIRCLE, **in_groups(plan_whole_trajectory, options))


FLAT = {
    "objective": {"effort": 1.0, "carrier_force": 0.1},
    "lam": 0.0,
    "speed": 1.0,
    "jerk": 300.0,
    "effort": [0.3, 0.3],
}
FLAT |= {"dt": 0.08, "refinements": 0, "starts": 2, "seconds": 30.0}


def test_options_as_flags_and_files_write_them_give_the_plan_of_groups():
    flat = plan_of(**FLAT)
    lines = []
    grouped = plan_of(
        objective=Objective(FLAT["objective"]),
        limits=Limits(speed=1.0, jerk=300.0, effort=[0.3, 0.3]),
        mesh=Mesh(0.08, refinements=0),
        solver=Solver(starts=2, seconds=30.0, progress=lines.append),
    )
    assert grouped.parameters == flat.parameters
    np.testing.assert_array_equal(grouped.tau, flat.tau)
    assert lines


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"mesh": 0.01}, "The group Mesh"),
        ({"limits": {"speed": 1.0}}, "The group Limits"),
        ({"mesh": Mesh(steps=50)}, "steps does not apply"),
        ({"limits": Limits(speed=-1.0)}, "speed"),
    ],
)
def test_groups_of_another_kind_and_fields_that_do_not_apply_are_named(options, message):
    with pytest.raises(InputError, match=message):
        plan_whole_trajectory(VirtualWork(zoo.robot_of("2rpr")), CIRCLE, **options)


@pytest.mark.parametrize(
    "make",
    [
        lambda: Mesh(0.0),
        lambda: Mesh(refinements=31),
        lambda: Mesh(steps=3),
        lambda: Solver(starts=0),
        lambda: Solver(seconds=0.0),
        lambda: Objective(lam=1.1),
        lambda: Objective(calm=-0.1),
        lambda: Objective(base_point=(0.0, 0.0)),
        lambda: Objective("effort", lam=0.5),
        lambda: Objective({"effort": 1.0}, baseline="3rrr"),
    ],
)
def test_a_group_checks_its_numbers(make):
    with pytest.raises(InputError):
        make()


def test_lam_and_baseline_ask_for_tracking():
    assert Objective(lam=0.5, baseline="3rrr").weights == "tracking"
    assert Objective().weights == "effort"


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
    options = {"dt": 0.06, "refinements": 0, "effort": 0.3, "calm": 0.0}
    plans = {name: plan_of(objective=name, **options) for name in ("effort", *added)}
    half = 0.5 * np.diff(plans["effort"].t)
    weights = (np.append(half, 0.0) + np.append(0.0, half))[:, None]
    measures = {
        "carrier_speed": lambda plan: (weights * plan.carriers.sd**2).sum(),
        "fastest_carrier": lambda plan: np.abs(plan.carriers.sd).max(),
    }
    for name, measure in measures.items():
        assert plans[name].diagnostics["optimal"]
        assert plans[name].diagnostics["objective"][name] == pytest.approx(measure(plans[name]), rel=1e-9)
        assert all(measure(plans[name]) <= (1.0 + 1e-3) * measure(other) for other in plans.values())
    assert measures["fastest_carrier"](plans["fastest_carrier"]) < 0.9 * measures["fastest_carrier"](plans["effort"])


@pytest.mark.long_for("absolute")
@pytest.mark.parametrize("term", ["absolute", "rate"])
def test_formulas_may_bound_and_differentiate(monkeypatch, term):
    formulas = {
        "absolute": (lambda q: q.integral(q.absolute(q.sd, float(q.scales.sd.max()))), lambda u: u.duration),
        "rate": (lambda q: q.integral_over_steps(q.rate(q.sdd) ** 2), lambda u: 1e3 * u.duration),
    }
    monkeypatch.setitem(OBJECTIVES, term, ObjectiveTerm(*formulas[term]))
    options = {"dt": 0.06, "refinements": 0, "effort": 0.3}
    plan, usual = (plan_of(objective=weights, **options) for weights in (term, {"effort": 1.0, term: 1e-9}))
    assert plan.diagnostics["objective"][term] < 0.9 * usual.diagnostics["objective"][term]


@pytest.mark.parametrize("trajectory", [reference.corner(), CIRCLE], ids=["corner", "circle"])
def test_nodes_have_every_event_and_are_integrated_exactly(trajectory):
    corner = len(trajectory.breaks) > 0
    dynamics = VirtualWork(zoo.robot_of("3rrr" if corner else "2rpr"))
    plan = plan_whole_trajectory(dynamics, trajectory, mesh=Mesh(dt=0.03, refinements=1))
    h = np.diff(plan.t)
    assert h.max() <= 0.03 * (1.0 + 1e-9)
    np.testing.assert_array_equal(plan.t[1:][h == 0.0], trajectory.breaks)
    assert np.isin(plan.diagnostics["singular_instants"], plan.t).all()
    # s̈ is linear in a step, and s and ṡ are its integrals
    c, step = plan.carriers, h[:, None]
    sd = c.sd[:-1] + step * (c.sdd[:-1] + c.sdd[1:]) / 2.0
    np.testing.assert_allclose(c.sd[1:], sd, atol=1e-9 * np.abs(c.sd).max())
    s = c.s[:-1] + step * c.sd[:-1] + step**2 * (2.0 * c.sdd[:-1] + c.sdd[1:]) / 6.0
    np.testing.assert_allclose(c.s[1:], s, atol=1e-9 * np.abs(c.s).max())
    smooth = np.array(plan.diagnostics["smooth_nodes"], dtype=int)
    assert len(plan.diagnostics["singular_instants"]) == (0 if corner else 2)
    assert np.isin(plan.diagnostics["singular_nodes"], smooth).all()
    jerk = np.diff(plan.carriers.sdd, axis=0) / np.where(h > 0.0, h, np.inf)[:, None]
    np.testing.assert_allclose(jerk[smooth - 1], jerk[smooth], atol=1e-6 * np.abs(jerk).max())


def test_every_objective_is_named_where_a_user_looks_for_it():
    """In the planner's documentation and in the problem file of the documentation: all of them, and no others."""
    problem = (Path(__file__).parents[3] / "docs/problem.yaml").read_text()
    (listed,) = re.findall(
        r"objective \(a word, or weights: \{.*?\}; (.*?)\)", re.sub(r"\n#\s*", " ", problem), re.DOTALL
    )
    assert set(listed.split(", ")) == set(OBJECTIVES)
    text = plan_whole_trajectory.__doc__.partition("objective: ")[2].partition("limits: ")[0]
    assert set(re.findall(r'"(\w+)"\s+(?:∫|max)', text)) == set(OBJECTIVES)
