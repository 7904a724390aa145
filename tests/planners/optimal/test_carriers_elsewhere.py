"""Carriers on the end-effector of the 2-RPR, and on spatial machines under gravity, through type II poses."""

from functools import cache, partial

import numpy as np
import pinocchio as pin
import pytest
from scipy.spatial.transform import Rotation

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError, UnsupportedRobotError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics

FOLLOWED = 1e-6
"""m and rad, as required."""


DIFFERENCES = 2e-5
"""N, of some 15: fourth derivatives times the square of the step of the central differences, which is 1e-4."""


def on_the_end_effector(mass=0.0):
    return rp.load_robot("2rpr", carriers=False, end_effector_carriers=True, end_effector_mass=mass, carrier_mass=0.8)


def newton(points, masses, x, v, a, s, sd, sdd, gravity=0.0):
    """Generalised forces along x and s of masses at points(x, s), (P, 2) or (P, 3); all derivatives by differences."""
    h = 1e-4

    def at(t):
        return points(x + v * t + a * t**2 / 2, s + sd * t + sdd * t**2 / 2)

    acceleration = (at(h) - 2 * at(0.0) + at(-h)) / h**2
    acceleration[:, -1] += gravity
    inertial = np.array(masses)[:, None] * acceleration
    of_x = [(points(x + e, s) - points(x - e, s)) / (2 * h) for e in h * np.eye(len(x))]
    of_s = [(points(x, s + e) - points(x, s - e)) / (2 * h) for e in h * np.eye(len(s))]
    return ([(part * inertial).sum() for part in parts] for parts in (of_x, of_s))


def reduce_one(dynamics, x, v, a, s, sd, sdd):
    motion = rp.PlatformMotion(np.zeros(1), x[None], v[None], a[None])
    return dynamics.reduce(motion, rp.CarrierMotion(s[None], sd[None], sdd[None]))


@pytest.mark.long_for("CompiledDynamics")
@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.CompiledDynamics])
def test_carriers_on_the_end_effector_are_point_masses_that_turn_with_leg_1(backend):
    """Against Newton for three points: positions as formulas of B and s, all else by central differences."""
    robot = on_the_end_effector(0.3)
    rng = np.random.default_rng(3)
    x0, v, a, s0, sd, sdd = rng.uniform(0.2, 0.5, (6, 2)) * np.array([1, 1, 1, 0.3, 1, 1])[:, None]

    def masses(x, s):
        u = x / np.hypot(*x)
        return np.array([x, x + s[0] * u, x + s[1] * np.array([-u[1], u[0]])])

    motion = x0, v, a, s0, sd, sdd
    of_x, of_s = newton(masses, [0.3, 0.8, 0.8], *motion)
    reduced = reduce_one(backend(robot), *motion)
    np.testing.assert_allclose(reduced.f[0], of_x, atol=1e-6)
    np.testing.assert_allclose(reduced.carrier_force[0], of_s, atol=1e-6)


@pytest.mark.parametrize("carriers", [True, False])
def test_the_closed_form_refuses_them(carriers):
    robot = rp.load_robot("2rpr", carriers=carriers, end_effector_carriers=True)
    assert robot.closed_form is None
    assert robot.k == (4 if carriers else 2)
    with pytest.raises(UnsupportedRobotError, match="RneaDynamics"):
        rp.VirtualWork(robot)


@pytest.mark.long
@pytest.mark.parametrize("mass", [0.0, 0.5])
def test_carriers_on_the_end_effector_cross_and_are_replayed(mass):
    robot, circle = on_the_end_effector(mass), rp.trajectory.reference.circle(speed=0.5)
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robot), circle, mesh=rp.Mesh(dt=0.01))
    assert plan.status.value == "ok"
    assert len(plan.diagnostics["singular_instants"]) == 2
    if mass:  # the replay of the other one takes ten seconds
        run = rp.simulate(robot, plan, dt=0.01, stop_at=())
        assert np.abs(run.x - circle.evaluate(np.minimum(run.t, circle.duration)).x).max() < FOLLOWED


@pytest.mark.long
def test_switching_off_with_mass_at_the_end_effector_takes_carriers_on_it():
    """Across leg and along it: those on the legs have no effect along the line of the bases."""
    circle = rp.trajectory.reference.circle(speed=0.5)
    with pytest.raises(InfeasiblePlanError, match="nothing can carry"):
        rp.plan_switch_off(rp.RneaDynamics(rp.load_robot("2rpr", end_effector_mass=0.5)), circle, threshold=7.0)
    plan = rp.plan_switch_off(rp.RneaDynamics(on_the_end_effector(0.5)), circle, threshold=7.0)
    assert np.isfinite(plan.tau).all()


def yawed(degrees):
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    pose[2, 3] = 0.6
    return pose


@cache
def crossing(dt):
    robot = rp.load_robot("gough", carriers=True)
    trajectory = rp.trajectory.reference.pose(yawed(70.0), yawed(110.0), 1.0)
    return robot, trajectory, rp.plan_whole_trajectory(rp.RneaDynamics(robot), trajectory, mesh=rp.Mesh(dt=dt))


def test_gough_crosses_90_degrees_of_yaw_under_gravity():
    """Without projection: Pinocchio's tree forces less the plan's efforts are forces in the loops, everywhere; and all
    the work is what the machine's energy has become, from rest to rest."""
    robot, _, plan = crossing(0.05)
    assert plan.status.value == "ok"
    np.testing.assert_allclose(plan.diagnostics["singular_instants"], [0.5], atol=1e-9)
    tree, model, data = (
        inverse_kinematics(robot, plan.motion).with_carriers(plan.carriers),
        robot.model,
        robot.model.createData(),
    )
    ends = [
        tuple(model.getFrameId(name, pin.FrameType.BODY) for name in (c.frame_a, c.frame_b)) for c in robot.closures
    ]
    power = []
    for sample, (q, v, a) in enumerate(zip(tree.q, tree.v, tree.a, strict=True)):
        left = pin.rnea(model, data, q, v, a).copy()
        left[robot.actuated_velocity] -= plan.tau[sample]
        left[robot.carrier_velocity] -= plan.carrier_force[sample]
        pin.computeJointJacobians(model, data, q)
        pin.updateFramePlacements(model, data)
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        loops = np.vstack(
            [
                pin.getFrameJacobian(model, data, i, world)[:3] - pin.getFrameJacobian(model, data, j, world)[:3]
                for i, j in ends
            ]
        )
        np.testing.assert_allclose(loops @ v, 0.0, atol=1e-9)
        inside = loops.T @ np.linalg.lstsq(loops.T, left, rcond=None)[0]
        np.testing.assert_allclose(left, inside, atol=1e-5)  # of 330 N
        power.append(
            plan.tau[sample] @ v[robot.actuated_velocity] + plan.carrier_force[sample] @ v[robot.carrier_velocity]
        )
    energy = [pin.computeMechanicalEnergy(model, data, tree.q[end], tree.v[end]) for end in (0, 20, -1)]
    assert np.abs(plan.carriers.s).max() > 0.05
    for half in (20, None):  # up to the crossing, and all; the trapezoidal rule is 0.1 J off
        upto = slice(None if half is None else half + 1)
        gained = energy[2 if half is None else 1] - energy[0]
        assert np.trapezoid(power[upto], plan.t[upto]) == pytest.approx(gained, abs=0.15)


def test_carriers_of_gough_lie_across_its_legs():
    robot = rp.load_robot("gough", carriers=True, track_angle=0.4, track_offset=0.25)
    q, data = robot.q_reference.copy(), robot.model.createData()
    q[robot.carrier_position] = 0.1
    pin.framesForwardKinematics(robot.model, data, q)
    for leg in range(1, 7):
        cylinder, mass = (
            data.oMf[robot.model.getFrameId(f"{name}_{leg}", pin.FrameType.BODY)] for name in ("cylinder", "mass")
        )
        across = 0.1 * np.array([np.cos(0.4), (-1) ** (leg + 1) * np.sin(0.4)])
        np.testing.assert_allclose(cylinder.actInv(mass).translation, [*across, 0.25], atol=1e-12)


@pytest.mark.long
def test_gough_is_replayed_through_90_degrees_of_yaw():
    robot, trajectory, plan = crossing(0.02)
    run = rp.simulate(robot, plan, dt=0.02, stop_at=())
    assert run.status.value == "ok"
    planned = trajectory.evaluate(np.minimum(run.t, 1.0)).x
    turned = Rotation.from_matrix(run.x[:, :3, :3] @ planned[:, :3, :3].transpose(0, 2, 1)).magnitude()
    assert np.abs(run.x[:, :3, 3] - planned[:, :3, 3]).max() < FOLLOWED
    assert turned.max() < FOLLOWED


def delta_points(x, s, on):
    """Points of a delta of 0.2, 0.05, 0.25, 0.35 m: platform, each rod's ends and middle (Simpson's rule is exact for
    slender rods), and its carriers; elbows outward."""
    everything = [x]
    for leg in range(3):
        c, d = np.cos(2 * np.pi * leg / 3), np.sin(2 * np.pi * leg / 3)
        to_world = np.array([[c, -d, 0], [d, c, 0], [0, 0, 1]])
        corner = to_world.T @ x + [0.05 - 0.2, 0, 0]
        across = np.arccos((corner @ corner + 0.25**2 - 0.35**2) / (2 * 0.25 * np.hypot(corner[0], corner[2])))
        down = np.arctan2(-corner[2], corner[0]) - across
        elbow = 0.25 * np.array([np.cos(down), 0, -np.sin(down)])
        rod = corner - elbow
        arm_normal = np.array([np.sin(down), 0, np.cos(down)])
        rod_normal = np.array([-rod[2], 0, rod[0]]) / np.hypot(rod[0], rod[2])
        track = elbow + s[leg] * arm_normal if on == "arms" else elbow + rod / 2 + s[leg] * rod_normal
        points = [0 * elbow, elbow / 2, elbow, elbow, elbow + rod / 2, corner, track]
        everything += [to_world @ (point + np.array([0.2, 0, 0])) for point in points]
    return np.array(everything)


@pytest.mark.parametrize("on", ["arms", "rods"])
def test_carriers_of_a_delta_are_point_masses_across_its_arms_or_rods(on):
    """Against Newton for points, under gravity."""
    places = {"carriers": on == "arms", "rod_carriers": on == "rods"}
    robot = rp.load_robot("delta", rod_length=0.35, carrier_mass=0.6, **places)
    rng = np.random.default_rng(5)
    x = np.array([0.03, -0.02, -0.2])
    v, a, s, sd, sdd = rng.uniform(-1.0, 1.0, (5, 3)) * np.array([1, 5, 0.1, 1, 10])[:, None]
    legs = [0.4 / 6, 0.4 * 4 / 6, 0.4 / 6, 0.15 / 6, 0.15 * 4 / 6, 0.15 / 6, 0.6]
    of_x, of_s = newton(partial(delta_points, on=on), [0.3, *3 * legs], x, v, a, s, sd, sdd, gravity=9.81)
    reduced = reduce_one(rp.RneaDynamics(robot), x, v, a, s, sd, sdd)
    np.testing.assert_allclose(reduced.f[0], of_x, atol=DIFFERENCES)
    np.testing.assert_allclose(reduced.carrier_force[0], of_s, atol=DIFFERENCES)


FLAT = rp.trajectory.Line((-0.04, 0.02, -0.25), (0.05, 0.0, -0.05))
"""Of a delta with rods of 0.35 m: up through the plane of its elbows, where weight acts along the lost direction."""


def raised(**arguments):
    robot = rp.load_robot("delta", rod_length=0.35, **arguments)
    return robot, rp.trajectory.Trajectory(FLAT, rp.trajectory.RestToRest(FLAT.length, 0.5, "4-5-6-7"))


def test_a_delta_with_carriers_across_its_rods_goes_through_the_plane_of_its_elbows_under_gravity():
    robot, motion = raised(rod_carriers=True)
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robot), motion, mesh=rp.Mesh(dt=0.02))
    assert plan.status.value == "ok"
    (instant,) = plan.diagnostics["singular_instants"]
    points = delta_points(motion.evaluate(np.array([instant])).x[0], np.zeros(3), "rods")[1:].reshape(3, 7, 3)
    assert abs(np.linalg.det((points[:, 5] - points[:, 3]) / 0.35)) < 1e-9  # the rods lie in a plane
    run = rp.simulate(robot, plan, dt=0.02, stop_at=())
    assert run.status.value == "ok"
    assert np.abs(run.x - motion.evaluate(np.minimum(run.t, 0.5)).x).max() < FOLLOWED


@pytest.mark.long
def test_a_delta_cannot_go_there_with_carriers_on_its_arms_or_light_ones():
    """Locked motors hold the arms, so nothing on them acts along the lost direction."""
    robot, motion = raised(carriers=True)
    with pytest.raises(InfeasiblePlanError, match="cannot balance this motion at all"):
        rp.plan_whole_trajectory(rp.RneaDynamics(robot), motion, mesh=rp.Mesh(dt=0.02))
    robot, motion = raised(rod_carriers=True, carrier_mass=0.2)
    with pytest.raises(InfeasiblePlanError, match="acceleration of rod_carrier_") as caught:
        rp.plan_whole_trajectory(rp.RneaDynamics(robot), motion, mesh=rp.Mesh(dt=0.02))
    wider = 1.02 * caught.value.details["limit"]
    plan = rp.plan_whole_trajectory(
        rp.RneaDynamics(robot), motion, mesh=rp.Mesh(dt=0.02), limits=rp.Limits(acceleration=wider)
    )
    assert plan.status.value == "ok"


@pytest.mark.long
def test_what_light_carriers_lack_is_said_in_numbers_that_suffice():
    trajectory = rp.trajectory.reference.pose(yawed(70.0), yawed(110.0), 1.0)
    dynamics = rp.RneaDynamics(rp.load_robot("gough", carriers=True, carrier_mass=0.5))
    with pytest.raises(InfeasiblePlanError, match="acceleration of carrier_") as caught:
        rp.plan_whole_trajectory(dynamics, trajectory, mesh=rp.Mesh(dt=0.05))
    wider = 1.02 * caught.value.details["limit"]
    assert (
        rp.plan_whole_trajectory(
            dynamics, trajectory, mesh=rp.Mesh(dt=0.05), limits=rp.Limits(acceleration=wider)
        ).status.value
        == "ok"
    )


@pytest.mark.long_for("2rpr")
@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_carriers_on_arms_are_replayed_and_their_masses_count(name):
    masses = {"end_effector_mass": 0.5, "cylinder_mass": 0.3} if name == "2rpr" else {}
    motion = rp.trajectory.reference.corner() if name == "3rrr" else rp.trajectory.reference.circle(0.5)
    robots = [rp.load_robot(name, arm_length=0.3, carrier_mass=mass, **masses) for mass in (1.0, 1.01)]
    assert robots[0].closed_form is None
    plan = rp.plan_whole_trajectory(rp.RneaDynamics(robots[0]), motion, mesh=rp.Mesh(dt=0.05))
    off = []
    for robot in robots:
        run = rp.simulate(robot, plan, dt=0.05, stop_at=())
        off.append(np.abs(run.x - motion.evaluate(np.minimum(run.t, motion.duration)).x[: len(run.t)]).max())
    assert off[0] < FOLLOWED
    assert off[1] > 100 * FOLLOWED
