"""Rare coincidences: starts on a limit, jumps on a singularity, one freedom, more actuators than freedoms."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
import zoo

from redundancy_pin import (
    RneaDynamics,
    VirtualWork,
    distribute,
    load_robot,
    plan_time_optimal,
    plan_whole_trajectory,
)
from redundancy_pin.planners.options import Limits, Mesh, Objective
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at
from redundancy_pin.trajectory.paths import Arc, ChainedPath, Line

HEAVY = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}
MODELS = Path(__file__).parents[3] / "models"


def carriers_between(plan, times):
    c = plan.carriers
    return carriers_at(PiecewisePolynomial.linear(plan.t, c.s, c.sd, c.sdd), times)


def efforts_at(dynamics, trajectory, plan, times):
    times = np.asarray(times)
    carriers = carriers_between(plan, times)
    return distribute(dynamics.reduce(trajectory.sample_at(times), carriers, check_track=False)).tau


STARTS = {
    "datum": lambda *task, inside: plan_whole_trajectory(
        *task, mesh=Mesh(dt=0.03, refinements=0), limits=Limits(track=(-1e-5 if inside else 0.0, 0.2))
    ),
    "start": lambda *task, inside: plan_whole_trajectory(
        *task,
        mesh=Mesh(dt=0.03, refinements=0),
        end="free",
        limits=Limits(track=(-0.1, 0.1)),
        start=-0.09999 if inside else -0.1,
    ),
    "speed": lambda *task, inside: plan_whole_trajectory(
        *task,
        mesh=Mesh(dt=0.03, refinements=0),
        limits=Limits(speed=0.5),
        start_speed=[0.49999, -0.49999] if inside else [0.5, -0.5],
    ),
}


@pytest.mark.long_for("speed", "datum")
@pytest.mark.parametrize("name", STARTS)
def test_a_start_on_a_limit_has_a_plan(name):
    """It is on the track, so it is allowed; the plan is that of a start just inside."""
    task = VirtualWork(zoo.robot_of("2rpr")), reference.circle(0.5, 0.2, 0.05)
    on, inside = (STARTS[name](*task, inside=inside) for inside in (False, True))
    assert on.findings.optimal  # on nodes so few it may be unresolved between them
    assert not on.limits.violated
    assert on.diagnostics["objective"]["effort"] == pytest.approx(inside.diagnostics["objective"]["effort"], rel=1e-2)


def through_a_jump(y):
    """Straight down to height y and on along an arc: ẍ jumps where the line of the base hinges, y = 0, is crossed."""
    path = ChainedPath([Line((0.2, 0.3), (0.2, y)), Arc((0.4, y), 0.2, (-1.0, 0.0), (0.0, -1.0), 1.2)])
    return Trajectory(path, SpeedProfile(path.length, 0.3, 0.2))


@pytest.mark.long_for("0.0")
@pytest.mark.parametrize("y", [0.0, 1e-12])
def test_a_jump_on_a_singular_instant_has_two_limits(y):
    """The efforts at both nodes are what W⁻¹ f tends to on their side; ``y`` keeps both apart by less than rounding."""
    dynamics, trajectory = VirtualWork(zoo.robot_of("2rpr", **HEAVY)), through_a_jump(y)
    plan = plan_whole_trajectory(dynamics, trajectory, objective=Objective(calm=0.0), mesh=Mesh(dt=0.02))
    before, after = plan.diagnostics["singular_nodes"]
    assert after == before + 1
    assert plan.t[before] == plan.t[after]
    for node, side in ((before, -1.0), (after, 1.0)):
        beside = efforts_at(dynamics, trajectory, plan, [plan.t[node] + side * 1e-5])[0]
        # over 10 µs the efforts change by 1e-3 of their size
        np.testing.assert_allclose(plan.tau[node], beside, atol=1e-3 * np.abs(plan.tau).max())
    apart = plan_whole_trajectory(dynamics, through_a_jump(1e-6), objective=Objective(calm=0.0), mesh=Mesh(dt=0.02))
    assert plan.diagnostics["objective"]["effort"] == pytest.approx(apart.diagnostics["objective"]["effort"], rel=1e-3)


def test_carrier_forces_are_looked_at_between_the_nodes():
    """On few nodes a force exceeds its limit by half of it between them; that was a plan within limits."""
    dynamics, trajectory, limit = VirtualWork(zoo.robot_of("3rrr")), reference.corner(0.0207), 0.35
    for refinements in (0, 3):
        plan = plan_whole_trajectory(
            dynamics,
            trajectory,
            objective="carrier_force",
            end="rest",
            mesh=Mesh(dt=trajectory.duration / 13, refinements=refinements),
            start_speed=[-0.08, -0.02, -0.016],
            limits=Limits(speed=0.68, carrier_force=limit),
        )
        times = np.setdiff1d(np.linspace(plan.t[0], plan.t[-1], 5000), plan.t)
        reduced = dynamics.reduce(trajectory.sample_at(times), carriers_between(plan, times))
        most = float(np.abs(reduced.carrier_force).max())
        if refinements:
            assert plan.status is ResultStatus.OK
            assert most <= 1.001 * limit
        else:
            assert plan.status is ResultStatus.LIMIT_VIOLATED
            worst = max(event.amount for event in plan.limits.violated if event.quantity == "force")
            # by samples 0.4 ms apart on both sides
            assert worst == pytest.approx(most - limit, rel=1e-2)


SLIDER = """
  <joint name="slider" type="prismatic">
    <parent link="crank_link"/><child link="slider_link"/>
    <origin xyz="0.1 0 0"/><axis xyz="1 0 0"/>
    <limit lower="-0.3" upper="0.3" velocity="2" effort="1000"/>
  </joint>
  <link name="slider_link">
    <inertial><mass value="1"/><inertia ixx="0" ixy="0" ixz="0" iyy="0" iyz="0" izz="0"/></inertial>
  </link>
</robot>"""


def declared(folder, source, name, **changes):
    text = (MODELS / source / f"{source}.urdf.xacro").read_text()
    if source == "four_bar":
        text = text.replace("</robot>", SLIDER)
    (folder / f"{source}.urdf.xacro").write_text(text)
    declaration = yaml.safe_load((MODELS / source / "robot.yaml").read_text()) | {"name": name} | changes
    (folder / "robot.yaml").write_text(yaml.safe_dump(declaration))
    return load_robot(folder / "robot.yaml", **zoo.WITH_CARRIERS.get(source, {}))


def test_one_freedom_crosses_its_singularity(tmp_path):
    """The rocker drives the crank through a dead point, where the only singular value of W vanishes."""
    robot = declared(
        tmp_path, "four_bar", "bar", actuated=["rocker"], carriers=[{"joint": "slider", "acceleration": 20.0}]
    )
    dynamics, path = RneaDynamics(robot), Line((1.0,), (5.0,))
    trajectory = Trajectory(path, SpeedProfile(path.length, 2.0, 0.2))
    plan = plan_whole_trajectory(dynamics, trajectory, mesh=Mesh(dt=0.1))
    assert plan.status is ResultStatus.OK
    (node,) = plan.diagnostics["singular_nodes"]
    for side in (-1e-5, 1e-5):
        beside = efforts_at(dynamics, trajectory, plan, [plan.t[node] + side])[0]
        np.testing.assert_allclose(plan.tau[node], beside, atol=1e-5 * np.abs(plan.tau).max())


def test_more_actuators_than_freedoms_are_judged_by_their_own_efforts(tmp_path):
    """The least peak is not of least norm; between the nodes the plan's own distribution is judged."""
    robot = declared(tmp_path, "five_bar", "over", actuated=["base_1", "base_2", "elbow_1"])
    path = Line((0.25, 0.6), (0.32, 0.3))
    trajectory = Trajectory(path, SpeedProfile(path.length, 0.3, 0.2))
    dynamics = RneaDynamics(robot)
    plan = plan_whole_trajectory(dynamics, trajectory, objective="peak", mesh=Mesh(dt=0.1))
    assert plan.status is ResultStatus.OK
    assert plan.between.passed
    reduced = dynamics.reduce(plan.motion, plan.carriers)
    assert np.abs(distribute(reduced).tau).max() > 1.05 * np.abs(plan.tau).max()
    np.testing.assert_allclose(np.einsum("nim,nm->ni", reduced.W, plan.tau), reduced.f, atol=1e-7)


@pytest.mark.long_for("carrier_acceleration")
@pytest.mark.parametrize("objective", ["carrier_acceleration", "carrier_force"])
def test_where_the_objective_leaves_the_efforts_open_they_are_the_smallest(objective):
    """Three motors for two freedoms, with limits so different that the middle of them is not the smallest effort."""
    robot = zoo.robot_of("five_bar")
    dynamics = RneaDynamics(replace(robot, actuated=(*robot.actuated, "elbow_1")))
    path = Line((0.2, 0.55), (0.3, 0.6))
    plan = plan_whole_trajectory(
        dynamics,
        Trajectory(path, SpeedProfile(path.length, 0.3, 0.1)),
        objective=Objective(objective, calm=0.0),
        mesh=Mesh(dt=0.04, refinements=0),
        limits=Limits(effort=[1000.0, 4.0, 4.0]),
    )
    loads = dynamics.reduce(plan.motion, plan.carriers)
    smallest = np.einsum("nmi,ni->nm", np.linalg.pinv(loads.W), loads.f)
    np.testing.assert_allclose(plan.tau, smallest, atol=1e-4 * np.abs(smallest).max())


def smallest_of_least_power(loads, rate):
    """Return (N,) the least Σ |τ_j q̇_j| over W τ = f, and (N, 3) the efforts of least norm that have it.

    Three motors, two freedoms: τ = τ₀ + z d, and the power is a polygon in z with corners where an effort is zero. The
    least power is that of the best corner; the corners that have it bound all z that do.
    """
    powers, efforts = [], []
    for W, f, speed in zip(loads.W, loads.f, rate, strict=True):
        least, d = np.linalg.pinv(W) @ f, np.linalg.svd(W)[2][2]
        corners = np.append(-least / d, 0.0)
        power = np.abs((least + corners[:, None] * d) * speed).sum(axis=1)
        best = corners[power <= power.min() + 1e-9 * np.abs(least * speed).sum()]
        powers.append(power.min())
        efforts.append(least + np.clip(0.0, best.min(), best.max()) * d)
    return np.array(powers), np.array(efforts)


@pytest.mark.long_for("unlimited")
@pytest.mark.parametrize("limits", [None, Limits(effort=5.0)], ids=["unlimited", "limited"])
def test_of_efforts_that_take_the_same_energy_the_plan_has_the_smallest(limits):
    """At rest no effort takes power; elsewhere motors that drive share it at no cost. Up to 0.9 N·m were open."""
    robot = zoo.robot_of("five_bar")
    dynamics, path = RneaDynamics(replace(robot, actuated=(*robot.actuated, "elbow_1"))), Line((0.25, 0.6), (0.32, 0.3))
    motion = Trajectory(path, SpeedProfile(path.length, 0.3, 0.2))
    goal, mesh = Objective("energy", calm=0.0), Mesh(dt=0.04, refinements=0)
    plan = plan_whole_trajectory(dynamics, motion, objective=goal, mesh=mesh, limits=limits)
    loads = dynamics.reduce(plan.motion, plan.carriers)
    rate = np.einsum("nim,ni->nm", loads.W, plan.motion.xd)
    power, smallest = smallest_of_least_power(loads, rate)
    size = np.abs(plan.tau).max()
    at_rest = [0, -1]
    np.testing.assert_allclose(plan.tau[at_rest], smallest[at_rest], atol=1e-6 * size)
    # at the ends of the efforts that cost the same the solver's barrier rounds the corner
    np.testing.assert_allclose(plan.tau, smallest, atol=1e-2 * size)
    total = np.trapezoid(power + np.abs(plan.carrier_force * plan.carriers.sd).sum(axis=1), plan.t)
    assert plan.diagnostics["objective"]["energy"] == pytest.approx(total, rel=1e-6)


def test_least_time_takes_the_smallest_efforts_that_have_it():
    """Where the motors' speeds limit the time, limits of efforts far off said which efforts balance each other."""
    robot = zoo.robot_of("five_bar", carriers=False)
    dynamics = RneaDynamics(replace(robot, actuated=(*robot.actuated, "elbow_1")))
    path, limits = Line((0.25, 0.6), (0.32, 0.3)), Limits(effort=[50.0, 20.0, 30.0], actuator_speed=1.0)
    plan = plan_time_optimal(dynamics, path, limits=limits, mesh=Mesh(steps=20, refinements=0))
    loads = dynamics.reduce(plan.motion, plan.carriers)
    smallest = np.einsum("nmi,ni->nm", np.linalg.pinv(loads.W), loads.f)
    free = (np.abs(smallest) < 0.9 * np.asarray(limits.effort)).all(axis=1)
    assert free.mean() > 0.5
    np.testing.assert_allclose(plan.tau[free], smallest[free], atol=1e-3 * np.abs(plan.tau).max())
