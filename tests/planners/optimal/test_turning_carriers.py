"""Carriers on curved tracks: f by its terms, and by the expressions of generated code as for carriers on carriers."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import redundancy_pin as rp
import redundancy_pin.planners.optimal.problem as problem  # whose readers of f are taken away
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.planners.base_wrench import base_wrench
from redundancy_pin.planners.carrier_model import carrier_model
from redundancy_pin.robot import Robot
from redundancy_pin.robot.shipped import models_root
from redundancy_pin.trajectory import Arc, ChainedPath, Line, SpeedProfile, Trajectory, reference

MASSES = {"arm_length": 0.15, "end_effector_mass": 0.5, "cylinder_mass": 0.3}
LINE = Line((0.1, 0.45), (0.4, 0.25))
MOTION = Trajectory(LINE, SpeedProfile(LINE.length, 0.5, 0.2))


@cache
def robot() -> Robot:
    return rp.load_robot("2rpr", **MASSES)


@contextlib.contextmanager
def unknown_terms() -> Iterator[None]:
    """Take the terms of turning carriers from the planner."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(problem, "reader_of", lambda task: problem.linear_model)
        yield


def test_terms_of_carriers_that_slide_and_turn_are_exact(tmp_path: Path) -> None:
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
    machine = rp.load_robot(tmp_path, **MASSES)
    rng, motion = np.random.default_rng(1), reference.circle(0.5, 0.2, 0.05).sample(0.2)
    s, sd, sdd = rng.normal(size=(3, len(motion), 2)) * np.array([3.0, 10.0, 100.0])[:, None, None]
    carriers, point = rp.CarrierMotion(s, sd, sdd), np.array([0.3, -0.2, 0.1])
    for dynamics in (rp.RneaDynamics(machine), rp.CompiledDynamics(machine)):
        along = dynamics.along(motion)
        model, true = carrier_model(along, turning=True), along.reduce(carriers)
        np.testing.assert_allclose(model.f(s, sd, sdd), true.f, atol=1e-11 * np.abs(true.f).max())
        force = np.abs(true.carrier_force).max()
        np.testing.assert_allclose(model.carrier_force(s, sd, sdd), true.carrier_force, atol=1e-11 * force)
        wrench = along.base_wrench(carriers)
        ours = base_wrench(along, np.zeros((1, 6)), point, turning=True)(carriers)
        atol = 1e-11 * np.abs(wrench).max()
        np.testing.assert_allclose(ours[:, :3], wrench[:, :3], atol=atol)
        np.testing.assert_allclose(ours[:, 3:] + np.cross(point, wrench[:, :3]), wrench[:, 3:], atol=atol)


@pytest.mark.long_for("circle-peak", "line-peak", "circle-effort", "line-carrier_force")
@pytest.mark.parametrize("objective", ["effort", "peak", "carrier_force"])
@pytest.mark.parametrize("name", ["line", "circle"])
def test_expressions_of_f_lead_to_the_plan_of_its_terms(name: str, objective: str) -> None:
    """Of one function, differentiated in two ways; on the circle through singular poses, within a limit of forces."""
    motion, dynamics = MOTION if name == "line" else reference.circle(0.5, 0.2, 0.05), rp.CompiledDynamics(robot())
    by_terms = rp.plan_whole_trajectory(
        dynamics,
        motion,
        objective=rp.Objective(objective, calm=0.0),
        mesh=rp.Mesh(dt=0.1, refinements=0),
        limits=rp.Limits(carrier_force=60.0),
    )
    with unknown_terms():
        plan = rp.plan_whole_trajectory(
            dynamics,
            motion,
            objective=rp.Objective(objective, calm=0.0),
            mesh=rp.Mesh(dt=0.1, refinements=0),
            limits=rp.Limits(carrier_force=60.0),
        )
    assert plan.findings.optimal
    assert plan.least_cost == pytest.approx(by_terms.least_cost, rel=1e-5)
    reduced = rp.RneaDynamics(robot()).reduce(plan.motion, plan.carriers)
    left = np.einsum("nim,nm->ni", reduced.W, plan.tau) - reduced.f
    assert np.abs(left).max() <= 1e-8 * np.abs(reduced.f).max()
    np.testing.assert_allclose(plan.carrier_force, reduced.carrier_force, atol=1e-9 * np.abs(plan.carrier_force).max())


def test_other_backends_than_generated_code_refuse_carriers_whose_f_is_no_sum_and_say_what_plans_them() -> None:
    with unknown_terms(), pytest.raises(UnsupportedRobotError, match=r"no sum over its carriers.*CompiledDynamics"):
        rp.plan_whole_trajectory(rp.RneaDynamics(robot()), MOTION, mesh=rp.Mesh(dt=0.05))


@pytest.mark.parametrize("plan", [rp.plan_stepwise, rp.plan_switch_off])
def test_planners_for_straight_tracks_refuse_curved_ones(plan: Any) -> None:
    """Their f is one of s and s², and not of sines of s."""
    circle = reference.circle(0.5, 0.2, 0.05)  # through a singular pose, beside which carriers are switched off
    motion = MOTION if plan is rp.plan_stepwise else circle
    with pytest.raises(UnsupportedRobotError, match="terms of carriers that slide, each on a link of its own"):
        plan(rp.RneaDynamics(robot()), motion, mesh=rp.Mesh(dt=0.05))


def test_a_jump_on_a_singular_instant_has_two_limits() -> None:
    """Down to the line of the base hinges and on along an arc: each node has the efforts of its side."""
    path = ChainedPath([Line((0.2, 0.3), (0.2, 0.0)), Arc((0.25, 0.0), 0.05, (-1.0, 0.0), (0.0, -1.0), 1.2)])
    motion = Trajectory(path, SpeedProfile(path.length, 0.3, 0.2))
    dynamics = rp.RneaDynamics(robot())
    plan = rp.plan_whole_trajectory(
        dynamics, motion, objective=rp.Objective(calm=0.0), mesh=rp.Mesh(dt=0.06), limits=rp.Limits(effort=np.inf)
    )
    before, after = plan.diagnostics["singular_nodes"]  # type: ignore[misc]
    assert plan.t[before] == plan.t[after]
    for node, side in ((before, -1.0), (after, 1.0)):
        beside = plan.efforts_at(plan.t[[node]] + side * 1e-5, dynamics)[0]
        np.testing.assert_allclose(plan.tau[node], beside, atol=1e-3 * np.abs(plan.tau).max())
