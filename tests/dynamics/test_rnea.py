"""RNEA on closed chains, judged by energy, momentum, Pinocchio's forward dynamics, differences and scaling laws.

None of them goes through Γ or rnea the way the backend does. Joint reactions against free-body diagrams.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
import zoo
from constrained import constrained
from machines import MASSIVE, machine
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin import CarrierMotion, JointForces, PlatformMotion, Spring, Wrench, load_robot, trajectory
from redundancy_pin.dynamics.contacts import closure_forces
from redundancy_pin.dynamics.reactions import joint_reactions
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.errors import InputError
from redundancy_pin.loading import robot_from_model
from redundancy_pin.robot import Robot

ROBOTS = sorted(MASSIVE)

STEP = 1e-3

SIXTH_ORDER = ((1, 0.75), (2, -0.15), (3, 1.0 / 60.0))
"""Weights of the central difference of sixth order: its truncation at STEP is 1e-18 times the seventh derivative."""


def assert_close(actual: np.ndarray, expected: np.ndarray, relative: float) -> None:
    """Compare relative to the largest entry: small entries are differences of large ones."""
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=relative * np.abs(expected).max())


def test_armature_about_a_skew_axis_is_in_the_energy() -> None:
    """½ aᵀ (rnea(q, 0, a) − rnea(q, 0, 0)), which has it in Pinocchio."""
    model = pin.Model()
    for kind in (pin.JointModelRevoluteUnaligned(np.array([0.0, 0.6, 0.8])), pin.JointModelRZ()):
        joint = model.addJoint(model.njoints - 1, kind, pin.SE3.Random(), f"joint_{model.njoints}")
        model.appendBodyToJoint(joint, pin.Inertia.Random(), pin.SE3.Identity())
    model.armature = np.array([2.0, 0.5])
    robot = robot_from_model(model, closures=[], actuated=["joint_1", "joint_2"])
    q, v, still = np.array([0.3, -0.4]), np.array([1.5, -0.7]), np.zeros(2)
    data = model.createData()
    effort = pin.rnea(model, data, q, still, v) - pin.rnea(model, data, q, still, still)
    along = RneaDynamics(robot).along(PlatformMotion([0.0], q[None], v[None], still[None]))
    assert along.energy()[0] - pin.computePotentialEnergy(model, data, q) == pytest.approx(0.5 * v @ effort, rel=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
@pytest.mark.parametrize("seed", [1, 2])
def test_forward_dynamics_under_the_computed_efforts_gives_the_motion_back(name: str, seed: int) -> None:
    robot, t = machine(name), np.linspace(0.0, 1.0, 6)
    along, carriers = RneaDynamics(robot).along(zoo.smooth_motion(robot, seed).at(t)), zoo.carriers_at(robot, t, seed)
    reduced = along.reduce(carriers)
    tau = np.linalg.solve(reduced.W, reduced.f[:, :, None])[:, :, 0]
    q, v, a = along.tree_motion(carriers)
    for k in range(len(t)):
        effort = np.zeros(robot.model.nv)
        effort[robot.actuated_velocity] = tau[k]
        effort[robot.carrier_velocity] = reduced.carrier_force[k]
        # accelerations of 1e1 to 1e3 through a mass matrix of condition 1e4: 1e-8 keeps four digits of reserve
        assert_close(constrained(robot, q[k], v[k], effort), a[k], 1e-8)


def shifted(carriers: CarrierMotion, which: str, amount: np.ndarray) -> CarrierMotion:
    parts = {"s": carriers.s, "sd": carriers.sd, "sdd": carriers.sdd}
    parts[which] = parts[which] + amount
    return CarrierMotion(**parts)


@pytest.mark.parametrize("name", ["2rpr", "3rrr", "five_bar", "gough", "stacked"])
def test_carrier_derivatives_are_derivatives(name: str, tmp_path: Path) -> None:
    robot = stacked_carriers(tmp_path) if name == "stacked" else machine(name)
    t = np.linspace(0.0, 1.0, 5)
    along, carriers = RneaDynamics(robot).along(zoo.smooth_motion(robot, 7).at(t)), zoo.carriers_at(robot, t)
    derivatives = along.carrier_derivatives(carriers)
    assert derivatives.f_s.shape == (5, robot.n, robot.k)
    assert derivatives.force_s.shape == (5, robot.k, robot.k)
    step = 1e-3  # f is quadratic in the carriers: central differences have no truncation error at all
    for which in ("s", "sd", "sdd"):
        for j in range(robot.k):
            up, down = (along.reduce(shifted(carriers, which, sign * step * np.eye(robot.k)[j])) for sign in (1, -1))
            f_by, force_by = getattr(derivatives, f"f_{which}"), getattr(derivatives, f"force_{which}")
            np.testing.assert_allclose(f_by[:, :, j], (up.f - down.f) / (2 * step), atol=1e-9)
            expected = (up.carrier_force - down.carrier_force) / (2 * step)
            np.testing.assert_allclose(force_by[:, :, j], expected, atol=1e-9)


def arm_with(folder: Path, *carriers: J) -> Robot:
    """Return a two-link arm with carriers on its second link, or on one another."""
    arm = [
        J("shoulder", "revolute", "base", "upper"),
        J("elbow", "revolute", "upper", "lower", (0.5, 0, 0)),
        J("mount", "fixed", "lower", "hand", (0.5, 0, 0)),
    ]
    declaration = {
        "actuated": ["shoulder", "elbow"],
        "carriers": [{"joint": joint.name, "position": [-0.2, 0.2]} for joint in carriers],
        "independent": {"platform": "hand", "axes": ["x", "y"]},
        "reference": {"platform": [0.3, 0.6], "guess": {"shoulder": 1.8, "elbow": -1.5}},
    }
    return load_robot(write_robot(folder, urdf_of([*arm, *carriers]), declaration))


def stacked_carriers(folder: Path) -> Robot:
    """A carrier carries a second one: their accelerations load each other."""
    first = J("slide_1", "prismatic", "lower", "mass_1", axis=(1, 0, 0))
    return arm_with(folder, first, J("slide_2", "prismatic", "mass_1", "mass_2", axis=(0.6, 0.8, 0)))


def test_derivatives_of_loads_on_a_carrier_that_turns(tmp_path: Path) -> None:
    """A wrench in world axes turns in the frame of its body, one in local axes does not: sixth-order differences."""
    robot = arm_with(tmp_path, J("turn", "revolute", "lower", "mass", axis=(0.6, 0.0, 0.8))).loaded(
        Wrench("mass", [3.0, -2.0, 1.0, 0.5, -0.7, 0.9], "world", (0.3, 0.1, 0.2)),
        Wrench("mass", [-1.0, 4.0, 2.0, 0.6, 0.8, -0.5], "local", (0.2, -0.1, 0.1)),
        Spring("base", "mass", 40.0, 3.0, 0.2, (0.1, 0.2, 0.0), (0.2, 0.0, 0.1)),
        Spring("mass", "base", 25.0, 2.0, 0.3, (0.0, 0.1, 0.2), (-0.2, 0.3, 0.0)),
        JointForces("turn", 0.4, 0.3, 0.5, 2.0, 0.1, 0.02, -6.0),
    )
    t = np.linspace(0.0, 1.0, 4)
    along, carriers = RneaDynamics(robot).along(zoo.smooth_motion(robot, 7).at(t)), zoo.carriers_at(robot, t)
    derivatives = along.carrier_derivatives(carriers)
    for which in ("s", "sd", "sdd"):
        sides = {k: along.reduce(shifted(carriers, which, np.array([k * STEP]))) for k in range(-3, 4)}
        for of, name in (("f", "f"), ("force", "carrier_force")):
            expected = sum(w * (getattr(sides[k], name) - getattr(sides[-k], name)) for k, w in SIXTH_ORDER) / STEP
            np.testing.assert_allclose(getattr(derivatives, f"{of}_{which}")[:, :, 0], expected, atol=1e-8)


def test_the_2rprs_force_is_the_rate_of_the_legs_angular_momentum() -> None:
    """Parsa 2014, eq. 2.17, collapsed: Jᵀτ = Σ n h / d with h = m[(L² + s²) θ̈ + 2 s ṡ θ̇ + σ L s̈]."""
    robot = zoo.robot_of("2rpr")
    t = np.linspace(0.0, 1.0, 7)
    motion, carriers = zoo.smooth_motion(robot, 10).at(t), zoo.carriers_at(robot, t)
    expected = np.zeros((7, 2))
    for leg, (hinge, sigma) in enumerate((((0.0, 0.0), 1.0), ((0.5, 0.0), -1.0))):
        away = motion.x - hinge
        d = np.linalg.norm(away, axis=1)
        u = away / d[:, None]
        n = np.stack([-u[:, 1], u[:, 0]], axis=1)
        turn = (n * motion.xd).sum(axis=1) / d
        turn_rate = ((n * motion.xdd).sum(axis=1) - 2 * (u * motion.xd).sum(axis=1) * turn) / d
        s, sd, sdd = carriers.s[:, leg], carriers.sd[:, leg], carriers.sdd[:, leg]
        h = (0.1**2 + s**2) * turn_rate + 2 * s * sd * turn + sigma * 0.1 * sdd
        expected += n * (h / d)[:, None]
    np.testing.assert_allclose(RneaDynamics(robot).reduce(motion, carriers).f, expected, atol=1e-12)


def test_progress_of_a_long_motion_is_reported_up_to_its_end() -> None:
    calls: list[tuple[int, int]] = []
    motion = trajectory.reference.corner(radius=0.025).sample(dt=2e-3)
    RneaDynamics("3rrr", progress=lambda done, total: calls.append((done, total))).along(motion)
    assert calls[-1] == (len(motion), len(motion))
    assert calls == sorted(calls)


# --- joint reactions against free-body diagrams


FORCE_TOLERANCE = 1e-9
"""N, N·m: forces of 10 to 100, conditioned no worse than 1e3, leave 1e-11."""


@pytest.fixture(scope="module", params=["2rpr", "3rrr"])
def case(request):
    masses = {"2rpr": {"end_effector_mass": 0.7, "cylinder_mass": 0.4, "piston_mass": 0.3}, "3rrr": {}}[request.param]
    robot, t = zoo.robot_of(request.param, gravity=(0.4, -9.81, -2.0), **masses), np.linspace(0.1, 0.7, 5)
    along, carriers = RneaDynamics(robot).along(zoo.smooth_motion(robot, 1).at(t)), zoo.carriers_at(robot, t)
    reduced = along.reduce(carriers)
    tau = np.linalg.solve(reduced.W, reduced.f[:, :, None])[:, :, 0]
    return robot, along, carriers, reduced, tau


def test_efforts_of_the_motion_leave_nothing_unbalanced(case):
    _, along, carriers, _, tau = case
    assert joint_reactions(along, tau, carriers).residual.max() < FORCE_TOLERANCE
    wrong = joint_reactions(along, tau + 1.0, carriers)
    assert wrong.residual.min() > 1e-3


def test_joint_axes_carry_the_actuator_efforts_and_nothing_else(case):
    robot, along, carriers, reduced, tau = case
    reactions = joint_reactions(along, tau, carriers)
    data = robot.model.createData()
    q, _, _ = along.tree_motion(carriers)
    for i in range(len(q)):
        pin.computeJointJacobians(robot.model, data, q[i])
        for name, wrench in zip(reactions.joints, reactions.joint_wrench[i], strict=True):
            joint = robot.model.getJointId(name)
            subspace = pin.getJointJacobian(robot.model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
            along_axis = subspace[:, robot.model.joints[joint].idx_v] @ wrench
            expected = 0.0
            if name in robot.actuated:
                expected = tau[i, robot.actuated.index(name)]
            elif name in robot.carriers:
                expected = reduced.carrier_force[i, robot.carriers.index(name)]
            assert along_axis == pytest.approx(expected, abs=FORCE_TOLERANCE)


def test_each_body_obeys_newton_and_euler(case):
    """Sum of joint, closure and gravity forces on one body = its rate of momentum (finite differences of motion)."""
    robot, along, carriers, _, tau = case
    model = robot.model
    reactions = joint_reactions(along, tau, carriers)
    data = model.createData()
    q, v, a = along.tree_motion(carriers)
    gravity = np.array(robot.gravity)
    i, step = 2, 1e-5
    rates = {}
    for sign in (1, -1):
        shifted = pin.integrate(model, q[i], sign * step * v[i] + 0.5 * step**2 * a[i])
        pin.forwardKinematics(model, data, shifted, v[i] + sign * step * a[i])
        for body in range(1, model.njoints):
            momentum = data.oMi[body].act(model.inertias[body] * data.v[body])
            rates[body] = rates.get(body, 0.0) + sign * momentum.vector / (2 * step)
    pin.forwardKinematics(model, data, q[i], v[i])
    net = {}
    for name, wrench in zip(reactions.joints, reactions.joint_wrench[i], strict=True):
        body = model.getJointId(name)
        origin = data.oMi[body].translation
        about_world = np.concatenate([wrench[:3], wrench[3:] + np.cross(origin, wrench[:3])])
        net[body] = net.get(body, 0.0) + about_world
        net[model.parents[body]] = net.get(model.parents[body], 0.0) - about_world
    pin.updateFramePlacements(model, data)
    row = 0
    for closure in robot.closures:
        at_a, at_b = (data.oMf[model.getFrameId(f)] for f in (closure.frame_a, closure.frame_b))
        local = np.zeros(3)
        for axis in closure.axes:
            local["xyz".index(axis)] = reactions.closure_force[i, row]
            row += 1
        force = at_a.rotation @ local
        wrench = np.concatenate([force, np.cross(at_b.translation, force)])
        for frame, sign in ((closure.frame_b, 1), (closure.frame_a, -1)):
            body = model.frames[model.getFrameId(frame)].parentJoint
            net[body] = net.get(body, 0.0) + sign * wrench
    for body in range(1, model.njoints):
        inertia = model.inertias[body]
        weight = inertia.mass * gravity
        centre = data.oMi[body].act(inertia.lever)
        net[body] = net[body] + np.concatenate([weight, np.cross(centre, weight)])
        # central differences of momentum with step 1e-5: 1e-10 truncation, 1e-11/1e-5 rounding
        np.testing.assert_allclose(net[body], rates[body], atol=5e-6)
    ground = -net[0]
    np.testing.assert_allclose(-ground, along.base_wrench(carriers)[i], atol=FORCE_TOLERANCE)


def test_rows_without_effort_have_no_reactions_and_wrong_shapes_are_refused(case):
    _, along, carriers, _, tau = case
    holes = tau.copy()
    holes[1] = np.nan
    reactions = joint_reactions(along, holes, carriers)
    assert np.isnan([*reactions.joint_wrench[1].ravel(), reactions.residual[1]]).all()
    assert np.isfinite(reactions.joint_wrench[0]).all()
    for wrong, message in ((tau[:, :-1], "tau"), (rp.distribute(along.reduce(carriers)), "not an array of numbers")):
        with pytest.raises(InputError, match=message):
            joint_reactions(along, wrong, carriers)


def test_a_chain_without_loops_has_reactions_too():
    """Two hanging links: each joint bears the weight of what hangs on it."""
    model, parent = pin.Model(), 0
    for name in ("upper", "lower"):
        parent = model.addJoint(parent, pin.JointModelRX(), pin.SE3(np.eye(3), np.array([0.0, 0.0, -0.3])), name)
        inertia = pin.Inertia(2.0, np.array([0.0, 0.0, -0.1]), 0.01 * np.eye(3))
        model.appendBodyToJoint(parent, inertia, pin.SE3.Identity())
    robot = rp.robot_from_model(model, actuated=["upper", "lower"])
    still = np.zeros((2, 2))
    along = RneaDynamics(robot).along(rp.PlatformMotion([0.0, 1.0], still, still, still))
    reactions = joint_reactions(along, rp.distribute(along.reduce()).tau)
    weight = -2.0 * model.gravity.linear[2]
    np.testing.assert_allclose(reactions.joint_wrench[:, :, 2], [[2 * weight, weight]] * 2, atol=FORCE_TOLERANCE)
    assert reactions.residual.max() < FORCE_TOLERANCE
    assert closure_forces(along).names == ()
    with pytest.raises(InputError, match=r"There is no closure row 'x of grip'. The robot has no closures"):
        closure_forces(along).component("grip", "x")
