"""Carriers on curved tracks: the 2-RPR with a mass on a turning arm on each leg, and what its plan must satisfy.

f is known by its terms there. For carriers that carry others it is not, and the planner takes the expressions of
generated code: that is tried on the same robot, without the terms.
"""

import contextlib
import functools

import numpy as np
import pytest
import symbolic_mechanisms
import symbolic_plans
import yaml

import redundancy_pin.planners.optimal.problem as problem
import redundancy_pin.planners.optimal.transcription as transcription
from redundancy_pin import (
    CarrierMotion,
    CompiledDynamics,
    RneaDynamics,
    distribute,
    load_robot,
    plan_whole_trajectory,
)
from redundancy_pin.errors import InfeasiblePlanError, UnsupportedRobotError
from redundancy_pin.planners.base_wrench import base_wrench
from redundancy_pin.planners.carrier_model import turning_model
from redundancy_pin.robot.urdf import models_root
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.paths import Line

ARM = 0.15
LIMITS = {"speed": 8.0, "track": 1.2, "acceleration": 60.0}
"""rad/s, rad and rad/s²: the machine's own."""

MASSES = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}
SAME = 1e-3
"""Relative difference of the objectives, as for straight tracks; found are 1e-6 or less."""


@pytest.fixture(scope="module")
def robot():
    return load_robot("2rpr", arm_length=ARM, **MASSES)


@contextlib.contextmanager
def unknown_terms():
    """Take the terms of turning carriers from the planner."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problem, "reader_of", lambda task: problem.linear_model)
        yield


@pytest.mark.parametrize(
    ("name", "objective"),
    [("line", "peak"), *(pytest.param("circle", what, marks=pytest.mark.long) for what in ("effort", "peak"))],
)
def test_turning_carriers_are_planned_in_one_solution_by_any_backend(robot, name, objective, monkeypatch):
    monkeypatch.setattr(transcription, "loads_of", never)
    plan = plan_whole_trajectory(RneaDynamics(robot), TRAJECTORIES[name], objective=objective, dt=0.05, refinements=0)
    require_balanced(robot, plan)
    machine = symbolic_mechanisms.two_rpr(arm=ARM, **MASSES)
    theirs, _ = symbolic_plans.solve(machine, TRAJECTORIES[name], plan, objective, LIMITS)
    np.testing.assert_allclose(plan.diagnostics["objective"][objective], theirs, rtol=SAME)


def test_terms_of_carriers_that_slide_and_turn_are_exact(tmp_path):
    """One of each, on an oblique axis and with gravity, far from the motions that the terms are read from."""
    urdf, declaration = (models_root() / "2rpr" / name for name in ("2rpr.urdf.xacro", "robot.yaml"))
    text = urdf.read_text()
    for old, new in (
        ("'revolute' if arm_length else 'prismatic'", "'revolute' if name == 1 else 'prismatic'"),
        ('<axis xyz="0 0 ${along + across}"/>', '<axis xyz="${2-name} ${across} ${across*(2-name)}"/>'),
    ):
        assert text.count(old) == 1
        text = text.replace(old, new)
    (tmp_path / urdf.name).write_text(text)
    mixed = yaml.safe_load(declaration.read_text()) | {"gravity": [1.0, -9.0, 0.5]}
    (tmp_path / "robot.yaml").write_text(yaml.safe_dump(mixed))
    robot = load_robot(tmp_path, arm_length=ARM, **MASSES)
    rng = np.random.default_rng(1)
    motion = TRAJECTORIES["circle"].sample(0.2)
    s, sd, sdd = rng.normal(size=(3, len(motion), 2)) * np.array([3.0, 10.0, 100.0])[:, None, None]
    for dynamics in (RneaDynamics(robot), CompiledDynamics(robot)):
        along = dynamics.along(motion)
        model, true = turning_model(along), along.reduce(CarrierMotion(s, sd, sdd))
        np.testing.assert_allclose(model.f(s, sd, sdd), true.f, atol=1e-11 * np.abs(true.f).max())
        force = np.abs(true.carrier_force).max()
        np.testing.assert_allclose(model.carrier_force(s, sd, sdd), true.carrier_force, atol=1e-11 * force)
        carriers, point = CarrierMotion(s, sd, sdd), np.array([0.3, -0.2, 0.1])
        wrench = along.base_wrench(carriers)
        ours = base_wrench(along, np.zeros((1, 6)), point, turning=True)(carriers)
        atol = 1e-11 * np.abs(wrench).max()
        np.testing.assert_allclose(ours[:, :3], wrench[:, :3], atol=atol)
        np.testing.assert_allclose(ours[:, 3:] + np.cross(point, wrench[:, :3]), wrench[:, 3:], atol=atol)


def never(*arguments, **settings):
    raise AssertionError("f was taken as an expression where its terms are known")


def short_line():
    path = Line((0.1, 0.45), (0.4, 0.25))
    return Trajectory(path, SpeedProfile(path.length, 0.5, 0.2))


TRAJECTORIES = {"line": short_line(), "circle": reference.circle(0.5, 0.2, 0.05)}


SEVERAL = ("circle", "peak")
"""It has three optima: 0.9969, 0.9982, at which IPOPT ends with the full model, and 1.0095 N."""


def require_least(plan, theirs, name, objective):
    ours = plan.diagnostics["objective"][objective]
    assert ours <= (1.0 + SAME) * theirs
    if (name, objective) != SEVERAL:
        assert ours >= (1.0 - SAME) * theirs


@pytest.mark.long
def test_plan_through_singularities_balances_and_is_as_good_between_the_nodes(robot, exact):
    plan = exact("circle", "effort")  # refinements would change nothing
    assert plan.status is ResultStatus.OK
    assert plan.diagnostics["dense_check"]["passed"]
    reduced = RneaDynamics(robot).reduce(plan.motion, plan.carriers)
    left = np.einsum("nim,nm->ni", reduced.W, plan.tau) - reduced.f
    assert np.abs(left).max() <= 1e-6 * np.abs(reduced.f).max()
    # the arms do turn, by much more than a straight track would pass for
    assert np.abs(plan.carriers.s).max() > 0.2


@pytest.mark.long
def test_small_changes_of_the_course_do_not_help(robot, exact):
    """To first order around the plan: efforts of the backend itself, along random changes that keep both ends."""
    plan = exact("line", "effort")
    dynamics, t, c = RneaDynamics(robot), plan.t, plan.carriers
    rng = np.random.default_rng(0)
    half = 0.5 * np.diff(t)
    w = (np.append(half, 0.0) + np.append(0.0, half))[:, None]

    def effort(s, sd, sdd):
        return float((w * distribute(dynamics.reduce(plan.motion, type(c)(s, sd, sdd))).tau ** 2).sum())

    assert (np.abs(c.sdd) < 0.99 * LIMITS["acceleration"]).all()
    best = effort(c.s, c.sd, c.sdd)
    for _ in range(8):
        bump = rng.normal(size=(len(t), 2))
        # s̈ linear in a step, with the two conditions that s and ṡ end at zero
        sd, s = _integrated(t, bump)
        ones, ramp = np.ones_like(bump), np.broadcast_to(t[:, None] - t[0], bump.shape)
        basis = [_integrated(t, ones), _integrated(t, ramp)]
        ends = np.array([[basis[0][0][-1, 0], basis[1][0][-1, 0]], [basis[0][1][-1, 0], basis[1][1][-1, 0]]])
        a, b = np.linalg.solve(ends, -np.array([sd[-1], s[-1]]))
        bump = bump + a * ones + b * ramp
        sd, s = _integrated(t, bump)
        e = 1e-4 / np.abs(bump).max()
        change = effort(c.s + e * s, c.sd + e * sd, c.sdd + e * bump) - effort(
            c.s - e * s, c.sd - e * sd, c.sdd - e * bump
        )
        # the regularisation, 1e-6 of the objective's size, tilts the optimum by as much
        assert abs(change) / 2.0 <= 1e-5 * best * e * np.abs(bump).max() + 1e-9 * best


def _integrated(t, sdd):
    h = np.diff(t)[:, None]
    sd = np.vstack([np.zeros((1, 2)), np.cumsum(h * (sdd[:-1] + sdd[1:]) / 2, axis=0)])
    s = np.vstack([np.zeros((1, 2)), np.cumsum(h * sd[:-1] + h**2 * (2 * sdd[:-1] + sdd[1:]) / 6, axis=0)])
    return sd, s


@pytest.fixture(scope="module")
def exact(robot):
    """Plans of a backend that has f as an expression, each made once."""
    dynamics = CompiledDynamics(robot)  # to plan takes less time than to compile

    @functools.cache
    def plan(name, objective, **settings):
        with unknown_terms():
            return plan_whole_trajectory(
                dynamics, TRAJECTORIES[name], objective=objective, dt=0.05, refinements=0, **settings
            )

    return plan


def require_balanced(robot, plan):
    assert plan.diagnostics["optimal"]
    reduced = RneaDynamics(robot).reduce(plan.motion, plan.carriers)
    left = np.einsum("nim,nm->ni", reduced.W, plan.tau) - reduced.f
    assert np.abs(left).max() <= 1e-8 * np.abs(reduced.f).max()


@pytest.mark.long
@pytest.mark.parametrize(("name", "objective"), [("line", "peak"), ("circle", "effort"), ("circle", "peak")])
def test_with_expressions_one_solution_finds_the_optimum_of_the_full_model(robot, exact, name, objective):
    plan = exact(name, objective, starts=4 if (name, objective) == SEVERAL else 1)
    require_balanced(robot, plan)
    if objective == "effort":  # a peak comes to lie between nodes so far apart
        assert plan.status is ResultStatus.OK
        assert plan.diagnostics["dense_check"]["passed"]
    machine = symbolic_mechanisms.two_rpr(arm=ARM, **MASSES)
    theirs, _ = symbolic_plans.solve(machine, TRAJECTORIES[name], plan, objective, LIMITS)
    require_least(plan, theirs, name, objective)


@pytest.mark.long
def test_forces_of_carriers_on_curved_tracks_are_limited_and_minimised_by_their_expressions(robot, exact):
    free = exact("line", "effort")
    largest = np.abs(RneaDynamics(robot).reduce(free.motion, free.carriers).carrier_force).max()
    limited = exact("line", "effort", carrier_force=0.7 * largest)
    gentle = exact("line", "carrier_force")
    for plan in (limited, gentle):
        require_balanced(robot, plan)
        forces = RneaDynamics(robot).reduce(plan.motion, plan.carriers).carrier_force
        assert np.abs(forces).max() <= 0.7 * largest * (1.0 + 1e-8) or plan is gentle
        np.testing.assert_allclose(plan.carrier_force, forces, atol=1e-9 * largest)
    assert limited.diagnostics["objective"]["effort"] > free.diagnostics["objective"]["effort"] * (1.0 + 1e-4)
    squares = [np.trapezoid((one.carrier_force**2).sum(axis=1), one.t) for one in (gentle, limited, free)]
    assert squares[0] < 0.9 * min(squares[1:])


@pytest.mark.long
def test_limits_that_no_course_keeps_are_named_by_the_exact_problem(robot, exact):
    most = exact("line", "peak").peak_effort.max()
    with pytest.raises(InfeasiblePlanError) as caught:
        exact("line", "effort", effort=0.5 * most)
    assert "effort" in {event["constraint"] for event in caught.value.details["relaxations"]}


def test_other_backends_than_generated_code_refuse_carriers_whose_f_is_no_sum_and_say_what_plans_them(robot):
    with unknown_terms(), pytest.raises(UnsupportedRobotError, match=r"no sum over its carriers.*CompiledDynamics"):
        plan_whole_trajectory(RneaDynamics(robot), TRAJECTORIES["line"], dt=0.05)
