"""Balancing: what the base feels as an objective. Judged by the momentum, which Pinocchio computes by other means."""

from __future__ import annotations

import functools

import numpy as np
import pinocchio as pin
import pytest
import zoo

from redundancy_pin import PlatformMotion, RneaDynamics, VirtualWork, plan_whole_trajectory
from redundancy_pin.errors import InfeasiblePlanError, UnsupportedRobotError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.loading import robot_from_model
from redundancy_pin.planners.base_wrench import base_wrench
from redundancy_pin.planners.options import Limits, Mesh, Objective
from redundancy_pin.planners.plan import Plan
from redundancy_pin.trajectory import from_points, reference

pytest.importorskip("casadi")

CENTRE = (np.sqrt(0.75), 0.5, 0.0)
"""Of the base of the 3-RRR, m."""

MODE = (1, 1, 1)


def dynamics() -> VirtualWork:
    return VirtualWork(zoo.robot_of("3rrr", carrier_mass=3.0, working_mode=MODE))


@functools.cache
def plan(
    objective: str = "base_wrench", end: str = "free", point: tuple[float, ...] = CENTRE, dt: float = 0.02
) -> Plan:
    return plan_whole_trajectory(
        dynamics(),
        reference.corner(),
        objective=Objective(objective, base_point=point),
        end=end,
        mesh=Mesh(dt=dt),
        limits=Limits(track=(-1.0, 1.0), speed=5.0, acceleration=20.0),
    )


def momentum(made: Plan, t: np.ndarray) -> np.ndarray:
    """Momentum (N, 6) of all bodies, N·s, and its moment about the centre of the base, N·m·s, at times t."""
    robot = dynamics().robot
    carriers, tree = made.carriers_at(t), inverse_kinematics(robot, made.platform_at(t))
    q, v = np.array(tree.q), np.array(tree.v)
    q[:, robot.carrier_position], v[:, robot.carrier_velocity] = carriers.s, carriers.sd
    data, rows = robot.model.createData(), []
    for one, rate in zip(q, v, strict=True):
        about_mass = pin.computeCentroidalMomentum(robot.model, data, one, rate)
        turned = about_mass.angular + np.cross(data.com[0] - CENTRE, about_mass.linear)
        rows.append(np.concatenate([about_mass.linear, turned]))
    return np.array(rows)


def peaks(wrench: np.ndarray) -> np.ndarray:
    return np.linalg.norm(wrench.reshape(-1, 2, 3), axis=2).max(axis=0)


def test_a_balanced_plan_keeps_its_momentum() -> None:
    """Between the nodes too: what is left there falls with the square of their distance."""
    t = np.linspace(0.0, reference.corner().duration, 201)[1:-1]
    made = [plan("effort"), plan(), plan(dt=0.01)]
    changed, kept, closer = (np.ptp(momentum(each, t), axis=0) for each in made)
    assert changed[[0, 1, 5]].min() > 1.0
    assert kept.max() < 2e-3 * changed.max()
    assert closer.max() < 0.3 * kept.max()


def test_figures_of_the_corner() -> None:
    """Without carriers, parked, balanced, and with the carriers parked again at the end, in N and N·m."""
    bare = RneaDynamics(zoo.robot_of("3rrr", carriers=False, working_mode=MODE))
    motion = reference.corner().sample(0.005)
    for known, machine in (((7.06, 0.705), bare), ((20.4, 2.26), dynamics())):
        wrench = machine.along(motion).base_wrench()
        moved = np.concatenate([wrench[:, :3], wrench[:, 3:] - np.cross(CENTRE, wrench[:, :3])], axis=1)
        np.testing.assert_allclose(peaks(moved), known, rtol=5e-3)
    assert peaks(plan().base_wrench(dynamics(), CENTRE)).max() < 1e-3
    again = plan(end="datum").base_wrench(dynamics(), CENTRE)
    np.testing.assert_allclose(peaks(again), (3.71, 0.475), rtol=2e-2)


def test_objectives_are_the_integrals_they_say() -> None:
    """By the trapezoidal rule on the backend's wrench, moved by hand; weights decide between force and moment."""
    made = plan(end="datum")
    wrench = made.base_wrench(dynamics(), CENTRE)
    length = dynamics().robot.characteristic_length
    square = (wrench[:, :3] ** 2).sum(axis=1) + (wrench[:, 3:] ** 2).sum(axis=1) / length**2
    value = made.diagnostics["objective"]["base_wrench"]
    np.testing.assert_allclose(np.trapezoid(square, made.t), value, rtol=1e-8)
    one, other = plan("base_force", "datum"), plan("base_moment", "datum")
    of_one, of_other = (
        np.trapezoid(each.base_wrench(dynamics(), CENTRE) ** 2, each.t, axis=0) for each in (one, other)
    )
    assert of_one[:2].sum() < of_other[:2].sum()
    assert of_other[5] < of_one[5]
    np.testing.assert_allclose(one.diagnostics["objective"]["base_force"], of_one[:3].sum(), rtol=1e-8)
    np.testing.assert_allclose(other.diagnostics["objective"]["base_moment"], of_other[3:].sum(), rtol=1e-8)


def test_weight_that_the_base_carries_anyway_does_not_count() -> None:
    """Gravity across the plane: its force is constant, and carriers cannot balance it."""
    heavy = VirtualWork(zoo.robot_of("3rrr", carrier_mass=3.0, working_mode=MODE, gravity=(0.0, 0.0, -9.81)))
    made = plan_whole_trajectory(
        heavy,
        reference.corner(),
        objective="base_force",
        end="datum",
        mesh=Mesh(dt=0.02),
        limits=Limits(track=(-1.0, 1.0), speed=5.0, acceleration=20.0),
    )
    level = plan("base_force", "datum")
    np.testing.assert_allclose(made.carriers.s, level.carriers.s, atol=1e-7)
    assert peaks(made.base_wrench(heavy))[0] > 100.0


def test_a_bound_counts_what_no_carrier_changes() -> None:
    """A gantry with a carrier along x: the force along y, of a mass moved as is known, is in the bound all the same."""
    model = pin.Model()
    for name, kind, parent in (
        ("x", pin.JointModelPX(), 0),
        ("y", pin.JointModelPY(), 1),
        ("c", pin.JointModelPX(), 1),
    ):
        joint = model.addJoint(parent, kind, pin.SE3.Identity(), name)
        model.appendBodyToJoint(joint, pin.Inertia(1.0, np.zeros(3), 1e-3 * np.eye(3)), pin.SE3.Identity())
    model.gravity.linear = np.zeros(3)
    carrier = {"joint": "c", "position": [-1.0, 1.0], "speed": 5.0, "acceleration": 50.0}
    gantry = RneaDynamics(robot_from_model(model, actuated=["x", "y"], carriers=[carrier], independent=["x", "y"]))
    assert gantry.robot.carrier_limits[0].force == np.inf  # Pinocchio's largest number is no limit
    line = from_points([[0.0, 0.0], [0.1, 0.2]], speed=0.5, ramp_time=0.2)
    made = plan_whole_trajectory(gantry, line, at_most={"base_force": 1e3}, end="free", mesh=Mesh(dt=0.02))
    t = made.t
    least = np.trapezoid(made.motion.xdd[:, 1] ** 2, t)  # of 1 kg, whatever the carrier does
    np.testing.assert_allclose(np.trapezoid(made.base_wrench(gantry)[:, 1] ** 2, t), least, rtol=1e-8)
    with pytest.raises(InfeasiblePlanError, match="base_force at most"):
        plan_whole_trajectory(gantry, line, at_most={"base_force": 0.9 * least}, end="free", mesh=Mesh(dt=0.02))


def test_other_terms_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A backend whose wrench is no sum over its carriers, as where one carries another."""
    along = dynamics().along(PlatformMotion([0.0], [[0.9, 0.5, 0.0]], np.zeros((1, 3)), np.zeros((1, 3))))
    true = type(along).base_wrench
    monkeypatch.setattr(type(along), "base_wrench", lambda self, c: true(self, c) + np.prod(c.s, axis=1, keepdims=True))
    with pytest.raises(UnsupportedRobotError, match="slide or turn"):
        base_wrench(along, np.zeros((1, 6)), np.zeros(3))


@pytest.mark.parametrize("heavier", [2.0**-30, 2.0**30])
def test_coefficients_of_the_wrench_are_those_of_any_mass(heavier: float) -> None:
    """A mass is a factor of all of them, and of what may be rounding of them."""
    masses = ("proximal_mass", "distal_mass", "platform_mass", "carrier_mass")
    shipped, models = zoo.robot_of("3rrr"), []
    for factor in (1.0, heavier):
        robot = zoo.robot_of("3rrr", **{name: float(shipped.parameters[name]) * factor for name in masses})
        along = RneaDynamics(robot).along(reference.corner().sample(0.3))
        models.append(base_wrench(along, np.zeros((1, 6)), np.array(CENTRE)))
    one, other = models
    np.testing.assert_allclose(other.w0 / heavier, one.w0, atol=1e-9 * np.abs(one.w0).max())
    np.testing.assert_allclose(other.by_term / heavier, one.by_term, atol=1e-9 * np.abs(one.by_term).max())
    assert other.felt.tolist() == one.felt.tolist()
    assert other.changed.tolist() == one.changed.tolist()
    sdd = np.array([20.0, 30.0, 40.0])
    np.testing.assert_allclose(other.sizes(sdd) / heavier, one.sizes(sdd), rtol=1e-9)
