"""Forward dynamics and steps in machine code: against the simulation's own, virtual work by hand and closed forms."""

from __future__ import annotations

import functools
import pickle
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import moving
import numpy as np
import pytest
import zoo
from flat_linkages import GRAVITY, row_of_four_bars
from scipy.integrate import solve_ivp
from spatial_chains import chain_of

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.compiled import CompiledForward
from redundancy_pin.errors import IllPosedModelError, InputError, SingularPoseError
from redundancy_pin.planners.reference import MotionReference
from redundancy_pin.robot import Robot
from redundancy_pin.simulation import (
    Constant,
    FeedForward,
    ForwardDynamics,
    Sampling,
    Simulation,
    State,
    closed_state,
    linearise,
    motion_reference,
)
from redundancy_pin.simulation.controllers import NoisyAmplifier
from redundancy_pin.simulation.controllers.computed_torque import ComputedTorque, ReducedModel
from redundancy_pin.simulation.controllers.lqr import TimeVaryingLqr, linear_model
from redundancy_pin.simulation.derivatives import linearise_along
from redundancy_pin.simulation.state import Manifold
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

EQUAL = 1e-11
"""Relative: two codes for one system of equations, conditioned no worse than 1e3."""

SAME = 1e-8
"""Two integrations of a second or two to 1e-11 a step, rounded differently."""


kernel = functools.cache(CompiledForward)


def compiled(robot: Robot) -> Any:
    """A backend that offers forward dynamics and nothing else: inverse dynamics take time to compile."""
    return SimpleNamespace(robot=robot, along=None, forward=lambda: kernel(robot))


def machine(name: str) -> Robot:
    return chain_of(name) if name in ("continuous", "hinge") else moving.massive(name)


MACHINES = ("2rpr", "3rrr", "four_bar", "continuous")


@pytest.mark.long_for("four_bar", "continuous")
@pytest.mark.parametrize(
    "name", [*MACHINES, *(pytest.param(name, marks=pytest.mark.long) for name in ("gough", "hinge"))]
)
def test_accelerations_and_forces_are_those_of_the_projected_equations(name: str) -> None:
    robot, nothing = machine(name), np.zeros(0)
    own, given = ForwardDynamics(robot), ForwardDynamics(robot, prescribed=True)
    code = kernel(robot)
    for i, state in enumerate(moving.random_states(robot, 7, 6)):
        force = moving.random_force(robot, i)
        own.adapt(state.q)
        a = own.acceleration(state.q, state.v, force)
        loads = own.forces(state.q, state.v, force, a)
        evaluated = code.accelerations(state.q, state.v, force)
        assert evaluated is not None
        np.testing.assert_allclose(evaluated.a, a, atol=EQUAL * np.abs(a).max())
        size = np.abs(loads.closure_force).max()
        np.testing.assert_allclose(evaluated.closure_force, loads.closure_force, atol=EQUAL * size)
        if robot.k:  # prescribed carriers take the forces that were given
            sdd = a[robot.carrier_velocity]
            force[robot.carrier_velocity] = 0.0
            again, theirs = (
                code.accelerations(state.q, state.v, force, sdd),
                given.acceleration(state.q, state.v, force, sdd),
            )
            assert again is not None
            np.testing.assert_allclose(again.a, theirs, atol=EQUAL * np.abs(a).max())
            nothing = np.append(nothing, again.missing[robot.carrier_velocity] - loads.carrier_force)
    np.testing.assert_allclose(nothing, 0.0, atol=1e-9)


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_accelerations_are_those_that_hand_coded_virtual_work_asks_these_efforts_for(name: str) -> None:
    robot = moving.massive(name)
    manual = rp.VirtualWork(robot)
    for i, state in enumerate(moving.random_states(robot, 3, 5)):
        force = moving.random_force(robot, i)
        evaluated = kernel(robot).accelerations(state.q, state.v, force)
        assert evaluated is not None
        a = evaluated.a
        state.chain.update(state.q, state.v)
        xdd = state.chain.platform_jacobian() @ a + state.chain.full_rate()[state.chain.rows :] @ state.v
        motion = rp.PlatformMotion([0.0], [state.x], [state.xd], [xdd])
        r = manual.reduce(motion, rp.CarrierMotion([state.s], [state.sd], [a[robot.carrier_velocity]]))
        size = np.abs(r.f).max()
        np.testing.assert_allclose(r.W[0] @ force[robot.actuated_velocity], r.f[0], atol=1e-9 * size)
        np.testing.assert_allclose(r.carrier_force[0], force[robot.carrier_velocity], atol=1e-9 * size)


@pytest.mark.parametrize("name", ["3rrr", "continuous"])
def test_states_are_projected_by_the_shortest_step(name: str) -> None:
    robot = machine(name)
    rng = np.random.default_rng(5)
    for state in moving.random_states(robot, 2, 4):
        q = np.array(state.q) + 1e-5 * rng.normal(size=robot.model.nq)
        v = np.array(state.v) + 1e-3 * rng.normal(size=robot.model.nv)
        evaluated = kernel(robot).project(np.concatenate([q, v]), 1e-13)
        assert evaluated is not None
        expected_q, expected_v, before, left = Manifold(state.chain).project(q, v)
        np.testing.assert_allclose(evaluated[0], np.concatenate([expected_q, expected_v]), atol=1e-12)
        np.testing.assert_allclose(evaluated[1:], (before, left), rtol=1e-3, atol=1e-13)


@pytest.mark.long
def test_what_has_no_acceleration_is_left_to_those_who_say_why() -> None:
    robot = zoo.robot_of("2rpr")  # massless but for its carriers, which stand at s = 0
    state = closed_state(robot, [0.25, 0.4])
    assert kernel(robot).accelerations(state.q, state.v, np.zeros(robot.model.nv)) is None
    with pytest.raises(IllPosedModelError, match="end_effector_mass"):
        rp.simulate(robot, duration=1.0, dynamics=compiled(robot))
    start = closed_state(robot, [0.25, 0.4], [0.2, -0.1], s=[0.1, 0.15], sd=[0.3, -0.6])
    run = rp.simulate(robot, start=start, duration=1.0, stop_at=(), dynamics=compiled(robot))
    assert run.status is ResultStatus.NOT_CONVERGED
    assert "inertia" in run.reason
    flat = row_of_four_bars(2)
    q = np.zeros(flat.model.nq)
    with pytest.raises(SingularPoseError):
        ForwardDynamics(flat).adapt(q)
    assert kernel(flat).accelerations(q, q, q) is None


def require_same(run: Simulation, own: Simulation, within: float = SAME) -> None:
    assert (run.status, run.reason == "") == (own.status, own.reason == "")
    assert [(e.kind, e.name, e.terminal) for e in run.events] == [(e.kind, e.name, e.terminal) for e in own.events]
    np.testing.assert_allclose([e.t for e in run.events], [e.t for e in own.events], atol=within)
    for name in ("t", "q", "v", "x", "xd", "s", "tau", "carrier_force", "energy"):
        expected = getattr(own, name)
        size = max(1.0, float(np.abs(expected).max(initial=0.0)))
        np.testing.assert_allclose(getattr(run, name), expected, atol=within * size, err_msg=name)
    for name in ("a", "closure_force"):
        size = max(1.0, float(np.nanmax(np.abs(getattr(own, name)), initial=0.0)))
        np.testing.assert_allclose(getattr(run, name), getattr(own, name), atol=100 * within * size, err_msg=name)
    assert run.gap.max() < 1e-12


def both(robot: Robot, drive: Any = None, **options: Any) -> tuple[Simulation, Simulation]:
    run = rp.simulate(robot, drive, dynamics=compiled(robot), **options)
    return run, rp.simulate(robot, drive, **options)


THROWN: dict[str, dict[str, Any]] = {
    "through type II": {"stop_at": ()},
    "through type II from below": {"stop_at": ()},
    "onto the end of a track": {},
    "steps of order 5": {"integrator": "RK45", "rtol": 1e-9, "atol": 1e-10, "stop_at": ()},
    "loose and long steps": {"rtol": 1e-6, "atol": 1e-7, "stop_at": ()},
    "few steps": {"max_steps": 10, "stop_at": (), "max_step": 0.02},
    "short steps": {"max_step": 4e-3, "stop_at": ()},
    "rubbing": {"external": lambda state: -0.3 * state.v, "stop_at": ()},
}


@pytest.mark.long_for("short steps", "loose and long steps")
@pytest.mark.parametrize("case", THROWN)
def test_a_machine_that_is_thrown_moves_the_same(case: str) -> None:
    robot = moving.massive("2rpr")
    side = -1.0 if case.endswith("below") else 1.0
    start = closed_state(robot, [0.15, 0.1 * side], [0.3, -0.7 * side], [0.05, -0.1], [0.4, 0.2])
    drive = Constant(np.array([0.3, -0.2]), np.array([0.2, 0.1]))
    loose = 1e-3 if case.startswith("loose") else SAME  # the same rules, but roundings decide about lengths of steps
    run, own = both(robot, drive, start=start, duration=0.8, dt=0.013, **THROWN[case])
    require_same(run, own, loose)
    assert abs(run.statistics.steps - own.statistics.steps) <= 2
    seen = {event.kind for event in own.events}
    assert case in ("few steps", "onto the end of a track") or "type_II" in seen
    assert case != "onto the end of a track" or own.status is ResultStatus.STOPPED
    assert case != "few steps" or (own.status is ResultStatus.NOT_CONVERGED and run.reason == own.reason)


class Damped:
    """Efforts that heed the state."""

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        return 0.2 * np.sin(3.0 * t + np.arange(state.robot.m)) - 0.1 * state.actuated_rate, -0.5 * state.sd


@pytest.mark.parametrize("sampling", [None, Sampling(0.01, 0.004)])
def test_controllers_are_asked_as_before(sampling: Sampling | None) -> None:
    robot = moving.massive("2rpr")
    start = closed_state(robot, [0.15, 0.2], [0.1, -0.2], [0.05, -0.1], [0.1, 0.2])
    options = {"start": start, "duration": 0.3, "sampling": sampling, "effort_limit": [0.15, np.inf], "stop_at": ()}
    run, own = both(robot, Damped(), **options)
    require_same(run, own)
    assert (np.abs(run.tau[:, 0]) == 0.15).any()


def test_errors_of_controllers_come_through_and_those_of_trial_steps_do_not() -> None:
    robot = moving.massive("2rpr")
    start = closed_state(robot, [0.15, 0.2])

    class Refusing(Damped):
        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            if t > 0.1:
                raise ZeroDivisionError("mine")
            return super().effort(t, state)

    with pytest.raises(ZeroDivisionError, match="mine"):
        rp.simulate(robot, Refusing(), start=start, duration=0.3, dynamics=compiled(robot))

    class Shy(Damped):
        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            tau, force = super().effort(t, state)
            return (tau, force) if np.abs(state.x - [0.15, 0.2]).max() < 0.5 else (tau * np.nan, force)

    run, own = both(robot, Shy(), start=start, duration=0.3, max_step=0.3, rtol=1e-6, atol=1e-7)
    require_same(run, own, 1e-5)


def test_plans_are_played_back_by_their_polynomials_and_saturate() -> None:
    robot = moving.massive("3rrr")
    motion = rp.trajectory.reference.corner(0.025)
    reference = motion_reference(robot, motion, step=0.05)
    assert FeedForward(reference).open_loop is reference.efforts
    options = {"stop_at": (), "rtol": 1e-8, "atol": 1e-9}
    for restart_at in ("breaks", "jumps"):
        require_same(*both(robot, FeedForward(reference), duration=0.4, restart_at=restart_at, **options), 1e-5)
    limit = 0.6 * np.abs([reference.loads(t)[0] for t in np.linspace(0.0, 0.4, 50)]).max(axis=0)
    run, own = both(robot, FeedForward(reference), duration=0.3, effort_limit=limit, **options)
    require_same(run, own, 1e-5)
    assert (np.abs(run.tau) <= limit).all()
    assert (np.abs(run.tau) == limit).any()

    class Half(FeedForward):
        """Efforts of its own, in place of the polynomials that it inherits."""

        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            tau, force = super().effort(t, state)
            return 0.5 * tau, force

    require_same(*both(robot, Half(reference), duration=0.1, **options), 1e-5)


@functools.cache
def off_course(**changed: float) -> tuple[MotionReference, dict[str, Any]]:
    """A reference of the 3-RRR with angles a turn from those of the state to start from, which is off it."""
    robot = zoo.robot_of("3rrr", **changed) if changed else moving.massive("3rrr")
    motion = rp.trajectory.reference.corner(0.025).sample(0.02)[:5]
    turned = rp.PlatformMotion(motion.t, motion.x + np.array([0.0, 0.0, 2.0 * np.pi]), motion.xd, motion.xdd)
    reference = motion_reference(robot, turned, step=0.05)
    x, xd, s, sd, _ = reference.course(0.0)
    start = closed_state(robot, x + np.array([0.002, -0.001, 0.003 - 2.0 * np.pi]), xd, s + 0.01, sd + 0.02)
    return reference, {"start": start, "duration": 0.04, "dt": 0.02, "stop_at": ()}


def test_control_laws_drive_machine_code_as_they_drive_python() -> None:
    """Off the course, along angles a turn from those of the state; saturated; made for another robot."""
    reference, options = off_course()
    robot = reference.robot
    scales = {"damping": 0.7, "effort_scale": [1.0, 2.0, 3.0], "carrier_scale": [5.0, 3.0, 2.0]}
    # where efforts begin to saturate, the error of a step is that of a kink: rounding decides whether it is taken or
    # halved, and v differs by 1e-9; with steps that are all taken it does not
    same_steps = {"max_step": 2e-3, "rtol": 1e-5, "atol": 1e-5}
    laws: list[tuple[Any, float, dict[str, float]]] = [
        (TimeVaryingLqr(reference, step=0.05), 1e-6, {}),
        (TimeVaryingLqr(reference, step=0.05, effort_limit=0.5), 1e-6, {}),
        (ComputedTorque(reference, **scales), 1e-12, {}),
        (ComputedTorque(reference, **scales, effort_limit=1.5), 1e-11, same_steps),
        (ComputedTorque(reference, **scales, carrier_force_limit=10.0), 1e-11, same_steps),
        (ComputedTorque(reference, **scales, effort_limit=1.5, carrier_force_limit=10.0), 1e-8, same_steps),
        (ComputedTorque(off_course(carrier_mass=3.5)[0], **scales), 1e-10, {}),
    ]
    for law, tolerance, steps in laws:
        run, own = both(robot, law, **options, **steps)
        require_same(run, own, tolerance)
        assert np.abs(run.tau).max() > 0.1


def test_a_rotor_makes_another_machine() -> None:
    """Armature is in no record of a robot; code without it would simulate the bare machine."""
    robot = moving.massive("2rpr")
    geared = robot.model.copy()
    geared.armature = np.full(geared.nv, 0.5)
    with pytest.raises(InputError, match="another 2rpr"):
        rp.simulate(replace(robot, model=geared), duration=0.1, dynamics=compiled(robot))


@pytest.mark.parametrize("sampling", [Sampling(0.02), None])
def test_noise_of_amplifiers_reaches_machine_code(sampling: Sampling | None) -> None:
    """Behind them, efforts that are polynomials of time are none any more: noise that is always one is a bias."""
    robot = moving.massive("2rpr")
    tau, force = np.array([0.3, -0.2]), np.array([0.2, 0.1])
    ones: Any = SimpleNamespace(standard_normal=np.ones)
    options = {"start": closed_state(robot, [0.15, 0.2], s=0.05), "duration": 0.1, "sampling": sampling}
    noisy, biased = (
        rp.simulate(robot, controller, dynamics=compiled(robot), **options)
        for controller in (NoisyAmplifier(Constant(tau, force), ones, 0.1), Constant(tau + 0.1, force + 0.1))
    )
    require_same(noisy, biased)


def test_efforts_that_jump_act_up_to_the_jump_and_from_it_on() -> None:
    robot = moving.massive("2rpr")

    class Switched:
        """Constant efforts that jump twice."""

        open_loop = PiecewisePolynomial(
            np.array([0.0, 0.1, 0.17, 0.3]),
            np.array([[[0.3, -0.2, 0.2, 0.1], [-0.5, 0.4, -0.6, 0.2], [0.1, 0.6, 0.3, -0.4]]]),
        )
        breaks, end = (0.1, 0.17), 0.3

        def effort(self, t: float, state: State) -> tuple[Array, Array]:
            return tuple(np.split(self.open_loop.at(t), [2]))

    run, own = both(robot, Switched(), start=closed_state(robot, [0.15, 0.2], s=0.05), dt=0.01, stop_at=())
    require_same(run, own)
    assert run.statistics.steps == own.statistics.steps  # a jump that is met inside a step costs dozens


def test_carriers_that_follow_their_motion_take_the_same_forces() -> None:
    robot = moving.massive("3rrr")

    class Swinging(Damped):
        def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
            phase = 5.0 * t + np.arange(3)
            return 0.1 * np.sin(phase), 0.5 * np.cos(phase), -2.5 * np.sin(phase)

    start = closed_state(robot, s=0.1 * np.sin(np.arange(3)), sd=0.5 * np.cos(np.arange(3)))
    for sampling in (None, Sampling(0.02)):
        run, own = both(robot, Swinging(), start=start, carriers="motion", duration=0.15, sampling=sampling)
        require_same(run, own)
        np.testing.assert_allclose(run.s, 0.1 * np.sin(5.0 * run.t[:, None] + np.arange(3)), atol=1e-14)


def test_falling_parallelograms_pass_their_flat_poses_like_the_pendulum_they_are() -> None:
    """Two loops that are flat at once: no determinant changes its sign there."""
    robot = row_of_four_bars(2)
    run = rp.simulate(
        robot, start=closed_state(robot, [0.5 * np.pi], [-0.3]), duration=3.0, dt=0.05, dynamics=compiled(robot)
    )
    pendulum = solve_ivp(
        lambda t, y: [y[1], -3.5 * GRAVITY / (3.0 / 3.0 + 2.0) * np.cos(y[0])],
        (0.0, 3.0),
        [0.5 * np.pi, -0.3],
        "DOP853",
        run.t,
        events=lambda t, y: np.sin(y[0]),
        rtol=1e-12,
        atol=1e-13,
    )
    assert run.status is ResultStatus.OK
    np.testing.assert_allclose(run.q[:, 0], pendulum.y[0], atol=1e-7)
    flat = [event.t for event in run.events if event.kind == "closure_rank"]
    np.testing.assert_allclose(flat, pendulum.t_events[0], atol=1e-7)
    assert len(flat) >= 2


@pytest.mark.long
def test_a_crank_that_turns_many_times_keeps_its_energy() -> None:
    robot = chain_of("continuous")
    run, own = both(robot, start=closed_state(robot, xd=[9.0]), duration=1.5)
    require_same(run, own, 1e-7)
    assert np.ptp(run.energy) < 1e-9 * np.abs(run.energy).max()
    assert run.statistics.evaluations > 12 * run.statistics.steps


@pytest.mark.long_for("four_bar", "gough")
@pytest.mark.parametrize("name", ["2rpr", "3rrr", "four_bar", "gough"])
def test_linearisations_are_those_of_the_analytic_derivatives(name: str) -> None:
    robot = moving.massive(name)
    states = moving.random_states(robot, 21, 3)
    force = np.array([moving.random_force(robot, i) for i in range(3)])
    loads = force[:, robot.actuated_velocity], force[:, robot.carrier_velocity]
    for i, linear in enumerate(linearise_along(robot, states, *loads, kernel(robot))):
        expected = linearise(robot, states[i], loads[0][i], loads[1][i])
        for part in ("A", "B", "acceleration", "a"):
            theirs = getattr(expected, part)
            np.testing.assert_allclose(getattr(linear, part), theirs, atol=1e-10 * np.abs(theirs).max(), err_msg=part)


def slow() -> rp.trajectory.Trajectory:
    line = rp.trajectory.Line([0.15, 0.2], [0.25, 0.3])
    return rp.trajectory.Trajectory(line, rp.trajectory.RestToRest(line.length, 0.4, "4-5-6-7"))


@pytest.mark.parametrize(
    "name", [*MACHINES, *(pytest.param(name, marks=pytest.mark.long) for name in ("gough", "hinge"))]
)
def test_controllers_read_platform_and_equations_off_machine_code(name: str) -> None:
    robot = machine(name)
    code, own = ReducedModel(robot, kernel(robot)), ReducedModel(robot)
    for state in moving.random_states(robot, 4, 3):
        ours, theirs = code.at(state.q, state.v), own.at(state.q, state.v)
        for part in ("mass", "bias", "W"):
            size = np.abs(getattr(theirs, part)).max(initial=0.0)
            np.testing.assert_allclose(getattr(ours, part), getattr(theirs, part), atol=EQUAL * size, err_msg=part)
        read = State(state.chain, state.t, state.q, state.v, kernel(robot))
        np.testing.assert_allclose(read.x, state.x, atol=1e-13)
        np.testing.assert_allclose(read.xd, state.xd, atol=EQUAL * np.abs(state.xd).max())
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(read)).x, read.x)


def test_type_i_poses_have_no_equations_in_machine_code_either() -> None:
    robot = moving.massive("2rpr")
    state = moving.random_states(robot, 4, 1)[0]
    q = state.q.copy()
    q[[robot.model.joints[robot.model.getJointId(f"slide_{i}")].idx_q for i in (1, 2)]] = 0.0  # legs without length
    for code in (kernel(robot), None):
        with pytest.raises(SingularPoseError):
            ReducedModel(robot, code).at(q, state.v)


def test_controllers_make_their_models_by_machine_code() -> None:
    robot = moving.massive("2rpr")
    reference = motion_reference(robot, slow())
    model, own = linear_model(reference, 0.1, compiled(robot)), linear_model(reference, 0.1)
    np.testing.assert_allclose(model.A, own.A, atol=1e-9 * np.abs(own.A).max())
    np.testing.assert_allclose(model.B, own.B, atol=1e-9 * np.abs(own.B).max())
    sampling = Sampling(4e-3, 2e-3)
    drives = [ComputedTorque(reference, sampling=sampling, dynamics=one) for one in (compiled(robot), None)]
    run = rp.simulate(robot, drives[0], sampling=sampling, duration=0.1, dynamics=compiled(robot))
    require_same(run, rp.simulate(robot, drives[1], sampling=sampling, duration=0.1))


def test_dynamics_of_another_robot_are_refused_and_those_without_code_ignored() -> None:
    robot = moving.massive("2rpr")
    with pytest.raises(InputError, match="another 2rpr"):
        rp.simulate(robot, duration=0.1, dynamics=compiled(zoo.robot_of("2rpr")))
    with pytest.raises(InputError, match=r"five_bar.*2rpr is required"):
        rp.simulate(robot, duration=0.1, dynamics=rp.RneaDynamics("five_bar"))
    with pytest.raises(InputError, match="another 2rpr"):
        ComputedTorque(motion_reference(robot, slow()), dynamics=compiled(zoo.robot_of("2rpr")))
    start = closed_state(robot, [0.15, 0.2])
    own = rp.simulate(robot, start=start, duration=0.02)
    for other in (rp.RneaDynamics(robot), rp.VirtualWork(robot)):
        assert other.forward() is None
        require_same(rp.simulate(robot, start=start, duration=0.02, dynamics=other), own)
    crank = zoo.robot_of("four_bar")
    run = rp.simulate(crank, duration=0.1, dynamics=rp.CompiledDynamics(crank))
    require_same(run, rp.simulate(crank, duration=0.1))
