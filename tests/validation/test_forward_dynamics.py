"""Forward dynamics judged by Pinocchio's solver, virtual work, closed forms and invariants."""

from __future__ import annotations

import moving
import numpy as np
import pinocchio as pin
import pytest
import zoo
from constrained import constrained
from scipy.integrate import solve_ivp
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.simulation.controllers.base import Constant
from redundancy_pin.simulation.forward import ForwardDynamics
from redundancy_pin.simulation.state import closed_state, tree_state

TWO_WAYS = 1e-8
"""Relative to the largest acceleration: required; the proximal iteration stops at 1e-14 times the conditioning."""

ROUND_TRIP = 1e-9
"""Relative: efforts and accelerations through two codes, conditioned no worse than 1e4."""

DRIFT = 1e-8
"""Relative change of an invariant in 10 s, as required; a step is accurate to 1e-11 of itself."""

GAP = 1e-9
"""m, as required."""


@pytest.mark.parametrize("name", zoo.SHIPPED)
def test_projected_equations_and_pinocchios_solver_agree(name):
    robot = moving.massive(name)
    projected = ForwardDynamics(robot)
    for i, state in enumerate(moving.random_states(robot, 11, 40)):
        force = moving.random_force(robot, i)
        projected.adapt(state.q)
        ours = projected.acceleration(state.q, state.v, force)
        theirs = constrained(robot, state.q, state.v, force)
        assert np.abs(ours - theirs).max() < TWO_WAYS * np.abs(ours).max()


def test_they_agree_at_a_type_two_pose_too():
    state = moving.type_two_state()
    for i in range(10):
        force = moving.random_force(state.robot, i)
        ours = ForwardDynamics(state.robot).acceleration(state.q, state.v, force)
        theirs = constrained(state.robot, state.q, state.v, force)
        assert np.abs(ours - theirs).max() < TWO_WAYS * np.abs(ours).max()


@pytest.mark.parametrize(("name", "arguments"), [("2rpr", {"end_effector_mass": 0.5}), ("3rrr", {})])
def test_efforts_of_virtual_work_give_back_the_motion_they_were_made_for(name, arguments):
    robot = rp.load_robot(name, **arguments)
    t = np.linspace(0.0, 2.0, 25)
    motion, carriers = zoo.smooth_motion(robot, seed=2).at(t), zoo.carriers_at(robot, t)
    reduced = rp.VirtualWork(robot).reduce(motion, carriers)
    tau = rp.distribute(reduced).tau
    assert np.isfinite(tau).all()
    dynamics = ForwardDynamics(robot)
    for i in range(len(t)):
        state = closed_state(robot, motion.x[i], motion.xd[i], carriers.s[i], carriers.sd[i])
        force = np.zeros(robot.model.nv)
        force[robot.actuated_velocity], force[robot.carrier_velocity] = tau[i], reduced.carrier_force[i]
        dynamics.adapt(state.q)
        a = dynamics.acceleration(state.q, state.v, force)
        chain = dynamics.chain
        chain.update(state.q, state.v)
        xdd = chain.platform_jacobian() @ a + chain.full_rate()[chain.rows :] @ state.v
        np.testing.assert_allclose(xdd, motion.xdd[i], atol=ROUND_TRIP * np.abs(motion.xdd).max())
        np.testing.assert_allclose(
            a[robot.carrier_velocity], carriers.sdd[i], atol=ROUND_TRIP * np.abs(carriers.sdd).max()
        )


def test_the_round_trip_holds_at_type_two_poses_for_any_effort():
    # W has lost rank, so virtual work cannot be asked for τ; but W τ = f must hold for the ẍ that τ produces
    robot = rp.load_robot("2rpr", end_effector_mass=0.5)
    manual, rng = rp.VirtualWork(robot), np.random.default_rng(4)
    for x in (0.1, 0.2, 0.35):
        state = closed_state(robot, [x, 0.0], rng.normal(size=2), rng.uniform(-0.1, 0.1, 2), rng.normal(size=2))
        tau, loads = rng.normal(0.0, 5.0, 2), rng.normal(0.0, 5.0, 2)
        force = np.zeros(robot.model.nv)
        force[robot.actuated_velocity], force[robot.carrier_velocity] = tau, loads
        dynamics = ForwardDynamics(robot)
        a = dynamics.acceleration(state.q, state.v, force)
        chain = dynamics.chain
        chain.update(state.q, state.v)
        xdd = chain.platform_jacobian() @ a + chain.full_rate()[chain.rows :] @ state.v
        motion = rp.PlatformMotion([0.0], [state.x], [state.xd], [xdd])
        reduced = manual.reduce(motion, rp.CarrierMotion([state.s], [state.sd], [a[robot.carrier_velocity]]))
        assert np.linalg.svd(reduced.W[0], compute_uv=False)[-1] < 1e-12
        size = np.abs(reduced.f).max()
        np.testing.assert_allclose(reduced.W[0] @ tau, reduced.f[0], atol=ROUND_TRIP * size)
        np.testing.assert_allclose(reduced.carrier_force[0], loads, atol=ROUND_TRIP * size)


CONSERVATIVE = {
    "2rpr": ({"end_effector_mass": 0.5, "cylinder_mass": 0.8, "piston_mass": 0.4}, 0.2),
    "3rrr": ({}, 0.3),
    "five_bar": ({"end_effector_mass": 0.3}, 0.3),
    "four_bar": ({}, 2.0),
    "gough": ({"gravity": (0.0, 0.0, 0.0)}, 0.1),
}
"""Arguments and speed of the start: ten seconds without efforts take each machine far from there."""


def pin_gaps(robot, q):
    """Return (N,) the closure gaps of point closures as Pinocchio's own frame placements have them, m."""
    model, data = robot.model, robot.model.createData()
    gaps = []
    for configuration in q:
        pin.framesForwardKinematics(model, data, configuration)
        largest = 0.0
        for closure in robot.closures:
            a, b = (
                data.oMf[model.getFrameId(frame, pin.FrameType.BODY)] for frame in (closure.frame_a, closure.frame_b)
            )
            apart = a.actInv(b).translation[["xyz".index(axis) for axis in closure.axes]]
            largest = max(largest, np.abs(apart).max())
        gaps.append(largest)
    return np.array(gaps)


@pytest.mark.long_for("four_bar", "five_bar")
@pytest.mark.parametrize("name", CONSERVATIVE)
def test_ten_seconds_without_efforts_keep_the_energy_and_the_closures(name):
    arguments, speed = CONSERVATIVE[name]
    robot = zoo.robot_of(name, **arguments)
    sd = 0.01 if robot.k else 0.0
    start = closed_state(robot, xd=np.full(robot.n, speed), sd=sd)
    run = rp.simulate(robot, start=start, duration=10.0, dt=0.05, stop_at=())
    assert run.status.value == ("limit_violated" if run.violated else "ok")  # nothing keeps it within its limits
    assert run.t[-1] == 10.0
    assert np.ptp(run.energy) < DRIFT * np.abs(run.energy).max()
    assert np.ptp(run.x, axis=0).max() > 0.1
    gaps = pin_gaps(robot, run.q)
    assert gaps.max() < GAP
    np.testing.assert_allclose(run.gap, gaps, atol=1e-14)
    assert run.gap.max() > 0.0
    assert run.statistics.largest_correction < GAP


def test_efforts_change_the_energy_by_their_work():
    robot = moving.massive("3rrr")
    drive = Constant(np.array([0.4, -0.3, 0.5]), np.array([0.2, -0.1, 0.1]))
    run = rp.simulate(robot, drive, duration=0.8, dt=1e-3)
    assert run.status.value == "ok"
    # the trapezoidal sum of the power is off by dt² / 12 times its change of slope: 1e-7 of it
    np.testing.assert_allclose(run.energy - run.energy[0], run.work, atol=1e-6 * np.abs(run.work).max())


def test_a_free_leg_keeps_its_angular_momentum_whatever_its_carrier_does():
    # massless 2-RPR, prismatic joints free: nothing but its own base hinge turns a leg (Parsa 2014, eq. 2.17)
    robot = rp.load_robot("2rpr")
    start = closed_state(robot, [0.25, 0.4], [0.2, -0.1], [0.1, 0.15], [0.3, 0.2])
    drive = Constant(np.zeros(2), np.array([0.8, 0.5]))
    run = rp.simulate(robot, drive, start=start, duration=0.3, dt=0.01, stop_at=(), max_steps=1000)
    assert run.t[-1] == 0.3
    assert {event.joint for event in run.violated} <= set(robot.carriers)  # nothing stops a carrier at its limits
    offset = float(robot.parameters["track_offset"])
    for leg, side in enumerate((1.0, -1.0)):
        swivel = robot.model.joints[robot.model.getJointId(f"swivel_{leg + 1}")].idx_v
        rate, s, sd = run.v[:, swivel], run.s[:, leg], run.sd[:, leg]
        momentum = float(robot.parameters["carrier_mass"]) * ((offset**2 + s**2) * rate + side * offset * sd)
        np.testing.assert_allclose(momentum, momentum[0], rtol=1e-8)
    assert np.abs(run.sd - run.sd[0]).max() > 0.1


def test_a_free_floating_chain_keeps_its_momentum_under_internal_forces(tmp_path):
    robot = moving.floating(tmp_path)
    start = closed_state(robot, xd=[0.3, -0.2, 0.1, 0.7, -1.1, 0.9], sd=0.4)

    class Push:
        """The carrier's actuator pushes to and fro, the bar's motor against the triangle."""

        def effort(self, t, state):
            return np.array([2.0 * np.sin(3.0 * t)]), np.array([4.0 * np.cos(5.0 * t)])

    run = rp.simulate(robot, Push(), start=start, duration=5.0, dt=0.25)
    assert run.status.value == "ok"
    model, data = robot.model, robot.model.createData()
    momentum = []
    for q, v in zip(run.q, run.v, strict=True):
        pin.computeCentroidalMomentum(model, data, q, v)
        centre, (linear, angular) = data.com[0], (data.hg.linear, data.hg.angular)
        momentum.append(np.concatenate([linear, angular + np.cross(centre, linear)]))
    np.testing.assert_allclose(momentum, momentum[:1] * len(momentum), atol=DRIFT * np.abs(momentum[0]).max())
    assert np.abs(np.linalg.norm(run.q[:, 3:7], axis=1) - 1.0).max() < 1e-12  # quaternions stay unit
    assert run.gap.max() < GAP
    assert np.ptp(run.s) > 0.1


def rocker_and_coupler(theta, lengths):
    """Return the angles of coupler and rocker of the open four-bar, by circle intersection, and their rates per θ̇."""
    ground, crank, coupler, rocker = lengths
    tip = crank * np.exp(1j * theta)
    far = np.abs(ground - tip)
    along = (far**2 + coupler**2 - rocker**2) / (2 * far)
    joint = tip + (ground - tip) / far * (along + 1j * np.sqrt(coupler**2 - along**2))
    beta, phi = np.angle(joint - tip), np.angle(joint - ground)
    # ẋ of the joint from both sides, crank·θ̇ e^{iθ} + coupler·β̇ e^{iβ} = rocker·φ̇ e^{iφ}, across rocker and coupler
    across = np.sin(beta - phi)
    return (
        beta,
        phi,
        (crank * np.sin(phi - theta) / (coupler * across), crank * np.sin(beta - theta) / (rocker * across)),
    )


def four_bar_lagrange(lengths, masses, gravity, torque):
    """Return the scalar Lagrange equation of a four-bar of slender rods, θ̈(θ, θ̇), inertia and height differenced."""
    _, crank, coupler, rocker = lengths
    crank_mass, coupler_mass, rocker_mass = masses

    def inertia_and_height(theta):
        beta, phi, (beta_rate, phi_rate) = rocker_and_coupler(theta, lengths)
        centre = crank * np.exp(1j * theta) + 0.5 * coupler * beta_rate * np.exp(1j * beta)
        inertia = crank_mass * crank**2 / 3 + coupler_mass * (np.abs(centre) ** 2 + coupler**2 * beta_rate**2 / 12)
        inertia += rocker_mass * rocker**2 * phi_rate**2 / 3
        height = crank_mass * crank * np.sin(theta) / 2
        height += coupler_mass * (crank * np.sin(theta) + coupler * np.sin(beta) / 2)
        height += rocker_mass * rocker * np.sin(phi) / 2
        return np.array([inertia, height])

    weights, offsets = np.array([-1, 9, -45, 0, 45, -9, 1]) / 60.0, np.arange(-3, 4)
    step = 2e-3

    def rate(t, y):
        theta, omega = y
        values = inertia_and_height(theta + offsets * step)
        slope = values @ weights / step
        return np.array([omega, (torque - 0.5 * slope[0] * omega**2 - gravity * slope[1]) / values[0, 3]])

    return rate


def test_a_four_bar_follows_its_scalar_lagrange_equation():
    robot = rp.load_robot("four_bar")
    names = ("ground", "crank", "coupler", "rocker")
    lengths = [float(robot.parameters[f"{name}_length"]) for name in names]
    masses = [float(robot.parameters[f"{name}_mass"]) for name in names[1:]]
    torque = 0.05
    run = rp.simulate(
        robot, Constant(np.array([torque]), np.zeros(0)), start=closed_state(robot, [1.0], [3.0]), duration=1.5, dt=0.05
    )
    theirs = solve_ivp(
        four_bar_lagrange(lengths, masses, 9.81, torque),
        (0.0, 1.5),
        [1.0, 3.0],
        "DOP853",
        run.t,
        rtol=1e-10,
        atol=1e-10,
    )
    assert np.ptp(run.x) > 2 * np.pi  # it turns over, and x runs on
    # differences of sixth order over 2 mrad leave 1e-12; two integrators of 1e-10 and 20 rad/s leave 1e-8
    np.testing.assert_allclose(run.x[:, 0], theirs.y[0], atol=1e-7)
    np.testing.assert_allclose(run.xd[:, 0], theirs.y[1], atol=1e-6)


def test_a_carrier_under_constant_force_reaches_its_stop_when_it_must(tmp_path):
    # on the base of a four-bar nothing else moves it: s = F t² / 2 m, and the track of `urdf_of` is 100 m long
    joints = [
        J("crank", "revolute", "base", "crank_link"),
        J("crank_mount", "fixed", "crank_link", "crank_tip", (0.1, 0, 0)),
        J("rocker", "revolute", "base", "rocker_link", (0.4, 0, 0)),
        J("coupler", "revolute", "rocker_link", "coupler_link", (0.25, 0, 0)),
        J("coupler_mount", "fixed", "coupler_link", "coupler_tip", (0.35, 0, 0)),
        J("slider", "prismatic", "base", "mass", axis=(1, 0, 0)),
    ]
    declaration = {
        "closures": [{"frames": ["crank_tip", "coupler_tip"], "axes": ["x", "y"]}],
        "actuated": ["crank"],
        "carriers": [{"joint": "slider"}],
        "independent": {"joints": ["crank"]},
        "reference": {"joints": {"crank": 1.0}, "guess": {"rocker": 1.9, "coupler": 2.0}},
    }
    robot = rp.load_robot(write_robot(tmp_path, urdf_of(joints), declaration))
    acceleration = 70.0
    run = rp.simulate(robot, Constant(np.zeros(1), np.array([acceleration])), duration=5.0)
    event = run.events[-1]
    assert run.status.value == "stopped"
    assert (event.kind, event.name, event.terminal) == ("track", "slider upper", True)
    assert event.t == pytest.approx(np.sqrt(2.0 * 100.0 / acceleration), rel=1e-10)
    assert run.t[-1] == event.t
    assert run.s[-1, 0] == pytest.approx(100.0, rel=1e-10)


def test_the_integrator_keeps_the_order_of_its_method():
    # steps held fixed by a huge tolerance: halving them divides the error of DOP853 by 2⁸, of RK45 by 2⁵
    robot = moving.massive("five_bar")
    start = closed_state(robot, xd=[0.8, -0.5], sd=[0.5, -0.4])

    def end(integrator, step):
        run = rp.simulate(
            robot, start=start, duration=0.5, rtol=1.0, atol=1e3, max_step=step, integrator=integrator, stop_at=()
        )
        return np.concatenate([run.q[-1], run.v[-1]])

    exact = end("DOP853", 0.5 / 64)
    for integrator, order, steps in (("DOP853", 8, (0.5 / 3, 0.5 / 6)), ("RK45", 5, (0.5 / 16, 0.5 / 32))):
        coarse, fine = (np.abs(end(integrator, step) - exact).max() for step in steps)
        assert np.log2(coarse / fine) > order - 1.0


def test_tighter_tolerances_give_smaller_errors():
    robot = moving.massive("3rrr")
    start = tree_state(robot, *((state := moving.random_states(robot, 5, 1)[0]).q, state.v))
    ends = {
        rtol: rp.simulate(robot, start=start, duration=0.25, rtol=rtol, atol=0.1 * rtol, stop_at=()).q[-1]
        for rtol in (1e-13, 1e-9, 1e-5)
    }
    fine, coarse = (np.abs(ends[rtol] - ends[1e-13]).max() for rtol in (1e-9, 1e-5))
    assert fine < 1e-7
    assert fine < 0.1 * coarse
