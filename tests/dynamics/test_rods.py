"""Rods of constant length that close loops: against links without mass between two balls, and a four-bar by hand."""

from __future__ import annotations

import dataclasses
import functools
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import zoo
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.compiled.parameters import topology_of
from redundancy_pin.robot import AXES, Closure, Robot
from redundancy_pin.simulation.state import closed_state
from redundancy_pin.status import SampleStatus

End = tuple[str, tuple[float, float, float]]
Rods = list[tuple[End, End, float]]
"""Joints that carry both ends, where the ends are in their frames, m, and the length of the rod, m."""

SAME = 1e-9
"""Relative. Loops close to 1e-12 of their size, and a link on balls has Jacobians of its own."""


def body(model: pin.Model, name: str, joint: pin.JointModel, place: pin.SE3, parent: int = 0) -> int:
    index = model.addJoint(parent, joint, place, name)
    inertia = pin.Inertia(0.5, np.array([0.06, 0.02, -0.03]), np.diag([0.002, 0.003, 0.0025]))
    model.appendBodyToJoint(index, inertia, pin.SE3.Identity())
    model.addBodyFrame(f"{name}_link", index, pin.SE3.Identity(), 0)
    return int(index)


def cranks(first: pin.SE3, second: pin.SE3) -> pin.Model:
    """Return a crank and a rocker about the z axes of two placements."""
    model = pin.Model()
    for name, place in (("crank", first), ("rocker", second)):
        body(model, name, pin.JointModelRZ(), place)
    model.gravity.linear = np.array([0.5, -9.0, 2.0])
    return model


def planar() -> tuple[pin.Model, Rods]:
    model = cranks(pin.SE3.Identity(), pin.SE3(np.eye(3), np.array([0.3, 0, 0])))
    return model, [(("crank", (0.1, 0, 0)), ("rocker", (0.2, 0, 0)), 0.3)]


def skew() -> tuple[pin.Model, Rods]:
    first, second = pin.rpy.rpyToMatrix(0.2, -0.1, 0.0), pin.rpy.rpyToMatrix(0.7, 0.3, 0.1)
    model = cranks(pin.SE3(first, np.zeros(3)), pin.SE3(second, np.array([0.5, 0.3, 0.0])))
    return model, [(("crank", (0.2, 0, 0.05)), ("rocker", (0.4, 0, 0)), 0.6)]


def hexaglide() -> tuple[pin.Model, Rods]:
    """Return six slides that carry a floating platform on six rods: six degrees of freedom."""
    model, rods = pin.Model(), []
    body(model, "platform", pin.JointModelFreeFlyer(), pin.SE3.Identity())
    for i in range(6):
        base, top = (0.6 * np.array([np.cos(a), np.sin(a), 0]) for a in (i // 2 * 2.1 + (i % 2) * 0.5, i * 1.05 - 0.2))
        body(model, f"slide_{i}", pin.JointModelPZ(), pin.SE3(np.eye(3), base))
        corner = 0.4 * top
        length = float(np.linalg.norm(corner + 0.5 * np.eye(3)[2] - base))
        rods.append(((f"slide_{i}", (0, 0, 0)), ("platform", tuple(corner)), length))
    model.gravity.linear = np.array([0.0, 0.5, -9.0])
    return model, rods


MACHINES = {"planar": planar, "skew": skew, "hexaglide": hexaglide}
DRIVEN = {"planar": ["crank"], "skew": ["crank"], "hexaglide": [f"slide_{i}" for i in range(6)]}
INDEPENDENT = {"planar": ["crank"], "skew": ["crank"], "hexaglide": {"platform": "platform_link", "axes": list(AXES)}}


def reference_of(name: str, model: pin.Model) -> Array:
    q = pin.neutral(model)
    given = {"platform": [0, 0, 0.5, 0, 0, 0, 1]} if name == "hexaglide" else {"crank": [1.0], "rocker": [1.4]}
    for joint, values in given.items():
        entry = model.joints[model.getJointId(joint)]
        q[entry.idx_q : entry.idx_q + entry.nq] = values
    return q


@functools.cache
def robot_of(name: str, *, rods: bool, driven: str = "", left_out: bool = False) -> Robot:
    """Return a machine with rods, or with links of mass 0 between two balls, whose spin is held."""
    model, pairs = MACHINES[name]()
    closures: list[Any] = []
    data = model.createData()
    pin.forwardKinematics(model, data, reference_of(name, model))
    for number, ((joint_a, point_a), (joint_b, point_b), length) in enumerate(pairs):
        a, b = (model.getJointId(joint) for joint in (joint_a, joint_b))
        model.addBodyFrame(f"b_{number}", b, pin.SE3(np.eye(3), np.array(point_b, dtype=float)), 0)
        place = pin.SE3(np.eye(3), np.array(point_a, dtype=float))
        if rods:
            model.addBodyFrame(f"a_{number}", a, place, 0)
            ends = (f"a_{number}", f"b_{number}")
            known = Closure(f"rod_{number}", *ends, ("distance",), length)
            closures.append({"name": f"rod_{number}", "rod": list(ends)} if left_out else known)
        else:
            line = data.oMi[a].actInv(data.oMi[b].act(np.array(point_b, dtype=float))) - place.translation
            place.rotation = pin.Quaternion.FromTwoVectors(np.eye(3)[0], line).matrix()
            ball = model.addJoint(a, pin.JointModelSpherical(), place, f"ball_{number}")
            model.addBodyFrame(f"a_{number}", ball, pin.SE3(np.eye(3), np.array([length, 0, 0])), 0)
            closures.append((f"a_{number}", f"b_{number}", ["x", "y", "z"]))
    return rp.robot_from_model(
        model,
        actuated=[driven] if driven else DRIVEN[name],
        closures=closures,
        independent=INDEPENDENT[name],
        reference=reference_of(name, model),
        characteristic_length=0.4,
        redundant_rows=not rods,
    )


def columns(robot: Robot, names: list[str]) -> list[int]:
    joints = [robot.model.joints[robot.model.getJointId(name)] for name in names]
    return [column for joint in joints for column in range(joint.idx_v, joint.idx_v + joint.nv)]


@pytest.mark.parametrize("name", MACHINES)
def test_a_rod_is_a_link_without_mass_between_two_balls(name: str) -> None:
    """Velocities, accelerations, W, f and efforts of RNEA, on the links and on the rods, and of generated code."""
    rods, links = (robot_of(name, rods=each) for each in (True, False))
    assert [closure.axes for closure in rods.closures] == [("distance",)] * len(rods.closures)
    assert rods.model.nv == rods.n + len(rods.closures)
    motion = zoo.smooth_motion(rods, 3).at(np.linspace(0.0, 1.0, 5))
    own, other = (rp.RneaDynamics(each).along(motion) for each in (rods, links))
    names = [str(joint) for joint in rods.model.names][1:]
    for one, two in zip(own.states(None), other.states(None), strict=True):
        for rate in ("v", "a"):
            left, right = getattr(one, rate)[columns(rods, names)], getattr(two, rate)[columns(links, names)]
            np.testing.assert_allclose(left, right, atol=SAME * max(1.0, np.abs(right).max()))
    ours, theirs, generated = own.reduce(), other.reduce(), rp.CompiledDynamics(rods).reduce(motion)
    for each in (theirs, generated):
        np.testing.assert_allclose(ours.W, each.W, atol=SAME)
        np.testing.assert_allclose(ours.f, each.f, rtol=SAME, atol=SAME)
    np.testing.assert_allclose(rp.distribute(ours).tau, rp.distribute(theirs).tau, rtol=1e-8, atol=1e-8)


def test_the_force_in_a_rod_holds_the_rocker() -> None:
    """Moments about the rocker's axis: a λ at the end of the rod, gravity, and what accelerates the rocker."""
    robot = robot_of("planar", rods=True)
    motion = zoo.smooth_motion(robot, 3).at(np.linspace(0.0, 1.0, 4))
    along = rp.RneaDynamics(robot).along(motion)
    reactions = rp.joint_reactions(along, rp.distribute(along.reduce()).tau)
    assert reactions.closures == ("distance of rod_0",)
    rocker = robot.model.inertias[2]
    for state, force in zip(along.states(None), reactions.closure_force[:, 0], strict=True):
        crank, turned = state.q
        end = 0.2 * np.array([np.cos(turned), np.sin(turned), 0.0])
        line = np.array([0.3, 0.0, 0.0]) + end - 0.1 * np.array([np.cos(crank), np.sin(crank), 0.0])
        arm = pin.exp3(np.array([0, 0, turned])) @ rocker.lever
        moment = (force * np.cross(end, line / 0.3) + np.cross(arm, rocker.mass * robot.gravity))[2]
        inertia = rocker.inertia[2, 2] + rocker.mass * rocker.lever[:2] @ rocker.lever[:2]
        assert moment == pytest.approx(inertia * state.a[1], abs=1e-10)


def four_bar(x: float, xd: float, xdd: float, rocker: float) -> tuple[float, float]:
    """Return W and f of the planar machine, driven at its rocker, by implicit derivatives of |B − A|² = L²."""
    lever, mass, gravity = np.array([0.06, 0.02]), 0.5, np.array([0.5, -9.0])
    inertia = 0.0025 + mass * lever @ lever

    def turned(vector: Array, angle: float) -> Array:
        return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ vector

    a, b = turned(np.array([0.1, 0.0]), x), turned(np.array([0.2, 0.0]), rocker)
    da, db = turned(a, np.pi / 2), turned(b, np.pi / 2)
    d = np.array([0.3, 0.0]) + b - a
    slope = (d @ da) / (d @ db)
    bend = -(da @ da + d @ a - 2.0 * slope * (da @ db) + slope**2 * (db @ db - d @ b)) / (d @ db)
    f = inertia * (xdd + slope * (slope * xdd + bend * xd**2))
    for angle, rate in ((x, 1.0), (rocker, slope)):
        f -= rate * mass * gravity @ turned(lever, angle + np.pi / 2)
    return float(slope), float(f)


def test_a_planar_four_bar_by_hand_through_its_singular_pose() -> None:
    """Where crank and rod are in line the rocker stands, and what drives it moves nothing: W = 0, and no effort."""
    robot = robot_of("planar", rods=True, driven="rocker")
    rest = np.arccos(0.25)  # of the rocker, whose end is 0.4 m from the crank's axis then
    stretched = float(np.arctan2(0.2 * np.sin(rest), 0.35))
    x = np.array([1.0, 0.9, 0.8, 0.72, stretched, 0.4, 0.3])[:, None]
    xd, xdd = np.full(x.shape, -1.3), np.full(x.shape, 0.7)
    motion = rp.PlatformMotion(np.arange(float(len(x))), x, xd, xdd, check_rates=False)
    along = rp.RneaDynamics(robot).along(motion)
    q = [state.q for state in along.states(None)]
    want = np.array([four_bar(each[0], -1.3, 0.7, each[1]) for each in q])
    assert q[4][1] == pytest.approx(rest, abs=1e-9)
    for reduced in (along.reduce(), rp.CompiledDynamics(robot).reduce(motion)):
        np.testing.assert_allclose(reduced.W[:, 0, 0], want[:, 0], atol=1e-9)
        np.testing.assert_allclose(reduced.f[:, 0], want[:, 1], atol=1e-9)
        status = rp.distribute(reduced).status
        assert list(np.flatnonzero(status != SampleStatus.OK)) == [4]
        assert status[4] == SampleStatus.SINGULAR_INCONSISTENT


@pytest.mark.parametrize("name", ["skew", "hexaglide"])
def test_a_machine_that_swings_freely_keeps_its_energy(name: str) -> None:
    robot = robot_of(name, rods=True)
    start = closed_state(robot, xd=np.full(robot.n, 0.3))
    run = rp.simulate(robot, start=start, duration=0.3)
    assert run.t[-1] == pytest.approx(0.3)
    assert np.ptp(run.energy) < 1e-8 * np.abs(run.energy).max()
    assert np.abs(run.v[-1] - run.v[0]).max() > 0.1
    assert run.gap.max() < 1e-9


@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.CompiledDynamics])
def test_a_parallelogram_on_a_rod_turns_through_its_flat_poses(backend: type, tmp_path: Path) -> None:
    """There the only row of the closures is zero, and the branch on which the rod turns too begins."""
    cranks = [J("crank", "revolute", "base", "crank"), J("rocker", "revolute", "base", "rocker", (0.3, 0, 0))]
    declaration = {
        "gravity": [0, -9.81, 0],
        "closures": [{"rod": ["crank", "rocker"], "at": [[0.2, 0, 0], [0.2, 0, 0]], "length": 0.3}],
        "actuated": ["crank"],
        "independent": {"joints": ["crank"]},
        "reference": {"joints": {"crank": 1.0}, "guess": {"rocker": 1.0}},
    }
    robot = rp.load_robot(write_robot(tmp_path, urdf_of(cranks), declaration))
    start = closed_state(robot, xd=[-9.0])
    run = rp.simulate(robot, start=start, duration=2.0, stop_at=(), dynamics=backend(robot))
    assert run.t[-1] == 2.0
    assert {event.quantity for event in run.violated} == {"speed"}  # it turns faster than the file allows
    assert run.q[-1, 0] < -6.0 * np.pi
    flat = 1 - int(np.ceil(run.q[-1, 0] / np.pi))  # multiples of π from 0 downwards
    assert [event.kind for event in run.events].count("closure_rank") == flat
    np.testing.assert_allclose(run.q[:, 1], run.q[:, 0], atol=1e-9)
    assert np.ptp(run.energy) < 1e-9 * np.abs(run.energy).max()


def test_derivatives_by_the_length_are_differences_of_robots() -> None:
    """Of order six: the length is a number that generated code takes at run time."""
    robot, step = robot_of("skew", rods=True), 2e-3
    motion = zoo.smooth_motion(robot, 3).at(np.linspace(0.0, 1.0, 3))
    got = rp.CompiledDynamics(robot).along(motion).derivatives(parameters=["rod_0.length"])
    weights, efforts = {-3: -1 / 60, -2: 3 / 20, -1: -3 / 4, 1: 3 / 4, 2: -3 / 20, 3: 1 / 60}, {}
    for i in weights:
        (rod,) = robot.closures
        rod = dataclasses.replace(rod, length=rod.length + i * step)
        other = dataclasses.replace(robot, closures=(rod,))
        assert topology_of(other) == topology_of(robot)
        efforts[i] = rp.RneaDynamics(other).reduce(motion).f
    want = sum(weight * efforts[i] for i, weight in weights.items()) / step
    np.testing.assert_allclose(got.f.parameters[..., 0], want, rtol=1e-7, atol=1e-7)


def test_a_length_that_is_left_out_is_that_of_the_reference() -> None:
    robot = robot_of("planar", rods=True, left_out=True)
    (rod,) = robot.closures
    apart = [0.3 + 0.2 * np.cos(1.4) - 0.1 * np.cos(1.0), 0.2 * np.sin(1.4) - 0.1 * np.sin(1.0)]
    assert rod.length == pytest.approx(np.hypot(*apart), rel=1e-14)
    np.testing.assert_allclose(robot.q_reference, [1.0, 1.4], atol=1e-12)
