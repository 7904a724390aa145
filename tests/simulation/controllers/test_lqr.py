"""Time-varying LQR: finite at type II poses, as its linear model predicts, and it brings perturbed machines back."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from crossing_case import corner, crossing, perturbed, two_rpr
from scipy.integrate import solve_ivp
from scipy.linalg import solve_continuous_are

import redundancy_pin as rp
from redundancy_pin.errors import IllPosedModelError, InputError
from redundancy_pin.planners.reference import motion_reference
from redundancy_pin.simulation.controllers import LqrWeights, TimeVaryingLqr, bryson_weights
from redundancy_pin.simulation.controllers.base import Sampling
from redundancy_pin.simulation.derivatives import linearise, state_error
from redundancy_pin.simulation.state import tree_state
from redundancy_pin.trajectory import reference as trajectories

BEFORE, SINGULAR = 0.5, 0.518
DELAYED = Sampling(2e-3, 2e-3)
AWAY, SPEED = [7e-4, -7e-4], [7e-3, 7e-3]


@cache
def regulator(step: float = 1e-3) -> TimeVaryingLqr:
    return TimeVaryingLqr(crossing(), step=step)


@cache
def delayed() -> TimeVaryingLqr:
    return TimeVaryingLqr(crossing(), sampling=DELAYED, step=5e-3)


def deviations(run, motion):
    residuals = []
    for t, q, v in zip(run.t.tolist(), run.q, run.v, strict=True):
        point = motion.at(t)
        residuals.append(
            state_error(motion.robot, tree_state(motion.robot, q, v, t=t), point.x, point.xd, point.s, point.sd)
        )
    return np.array(residuals)


@pytest.mark.long
def test_gains_are_finite_and_smooth_at_the_type_ii_pose():
    control = regulator()
    beside, there = control.gain(0.3), control.gain(SINGULAR)
    assert np.isfinite(control.riccati.K).all()
    assert np.abs(there).max() < 3.0 * np.abs(beside).max()
    step = np.abs(np.diff(control.riccati.K, axis=0)).max() / np.abs(control.riccati.K).max()
    assert step < 0.05
    assert control.holds_end


@pytest.mark.long
def test_the_cost_to_go_is_symmetric_and_positive():
    for control in (regulator(), delayed()):
        P = control.riccati.P
        assert (P.transpose(0, 2, 1) == P).all()
        assert control.riccati.least_eigenvalue > -1e-12


@pytest.mark.long
def test_the_linear_closed_loop_predicts_the_simulation():
    """δż = (A − B K) δz from the linearisation at each instant itself, not from the controller's own table."""
    motion, control = crossing(), regulator(4e-3)
    robot = motion.robot
    runs = {}
    for size in (1e-6, 1e-5):
        start = perturbed(robot, motion, BEFORE, [size, -size], [10.0 * size, 10.0 * size])
        run = rp.simulate(robot, control, start=start, duration=0.05, rtol=1e-10, atol=1e-13, dt=0.01)
        runs[size] = deviations(run, motion)

    def rate(t, z):
        q, v, _ = motion.tree(t)
        linear = linearise(robot, tree_state(robot, q, v, t=t), *motion.loads(t))
        return (linear.A - linear.B @ control.gain(t)) @ z

    unit = solve_ivp(rate, (BEFORE, BEFORE + 0.05), runs[1e-6][0] / 1e-6, t_eval=run.t, rtol=1e-6, atol=1e-9).y.T
    assert np.abs(unit[-1, :2]).max() > 0.1  # not yet back: there is something to predict
    left = {size: float(np.abs(away - size * unit).max()) for size, away in runs.items()}
    # what is left is of second order, with speeds of up to 28 times the size; 0.1 % of them at the larger size
    assert left[1e-5] < 1e-3 * 1e-5 * np.abs(unit).max()
    assert 30.0 < left[1e-5] / left[1e-6] < 300.0


def test_a_perturbed_machine_is_brought_back_through_both_type_ii_poses():
    motion, robot = crossing(), two_rpr()
    start = perturbed(robot, motion, BEFORE, AWAY, SPEED)
    run = rp.simulate(
        robot, delayed(), start=start, duration=0.8, sampling=DELAYED, rtol=1e-6, atol=1e-8, integrator="RK45"
    )
    away = np.linalg.norm(deviations(run, motion)[:, :2], axis=1)
    assert [event.kind for event in run.events].count("type_II") == 2
    assert away.max() < 1.5e-3
    assert away[-1] < 0.02 * away[0]


@pytest.mark.long
def test_open_loop_the_same_machine_drifts_away():
    motion, robot = crossing(), two_rpr()
    start = perturbed(robot, motion, BEFORE, AWAY, SPEED)
    run = rp.simulate(
        robot,
        rp.simulation.FeedForward(motion),
        start=start,
        duration=0.8,
        rtol=1e-8,
        atol=1e-9,
        stop_at=(),
    )
    assert np.linalg.norm(deviations(run, motion)[-1, :2]) > 5e-3


@pytest.mark.long
def test_the_corner_of_the_three_rrr():
    motion = corner()
    control = TimeVaryingLqr(motion, step=0.02)
    start = perturbed(motion.robot, motion, 0.7, [*AWAY, 0.0], [*SPEED, 0.0])
    run = rp.simulate(motion.robot, control, start=start, duration=0.4, rtol=1e-7, atol=1e-9)
    away = deviations(run, motion)
    assert run.status.value == "ok"
    assert np.linalg.norm(away[-1, :2]) < 0.1 * np.linalg.norm(away[0, :2])


def test_at_rest_the_gains_are_those_of_the_algebraic_equation():
    robot = rp.load_robot("3rrr")
    path = trajectories.corner(radius=0.025)
    still = motion_reference(
        robot,
        rp.PlatformMotion([0.0, 0.3], np.repeat(path.sample(0.1).x[:1], 2, 0), np.zeros((2, 3)), np.zeros((2, 3))),
    )
    weights = LqrWeights(np.diag([1e6] * 6 + [1e3] * 6), np.diag([0.1] * 6))
    control = TimeVaryingLqr(still, weights=weights)
    q, v, _ = still.tree(0.0)
    linear = linearise(robot, tree_state(robot, q, v), np.zeros(3), np.zeros(3))
    P = solve_continuous_are(linear.A, linear.B, weights.Q, weights.R)
    assert np.allclose(control.gain(0.1), np.linalg.solve(weights.R, linear.B.T @ P), rtol=1e-6, atol=1e-3)


def test_the_memory_of_the_delay_is_the_effort_that_acts():
    control = delayed()
    motion = crossing()
    state = perturbed(motion.robot, motion, BEFORE, AWAY, SPEED)
    first = np.concatenate(control.effort(BEFORE, state))
    again = np.concatenate(control.effort(BEFORE, state))
    assert np.array_equal(first, again)
    later = np.concatenate(control.effort(BEFORE + DELAYED.period, state))
    K, at = control.gain(BEFORE + DELAYED.period), BEFORE + DELAYED.period
    point = motion.at(at)
    error = state_error(motion.robot, state, point.x, point.xd, point.s, point.sd)
    acting = first - np.concatenate(motion.loads(BEFORE + control.lead))
    expected = np.concatenate(motion.loads(at + control.lead)) - K @ np.concatenate([error, acting])
    assert np.allclose(later, expected)
    assert np.abs(K[:, 8:] @ acting).max() > 1e-3 * np.abs(expected).max()


def test_what_an_earlier_simulation_left_does_not_count():
    control, motion = delayed(), crossing()
    states = [perturbed(motion.robot, motion, t, AWAY, SPEED) for t in (0.4, BEFORE)]
    alone = np.concatenate(TimeVaryingLqr(motion, sampling=DELAYED, step=0.05).effort(BEFORE, states[1]))
    used = TimeVaryingLqr(motion, sampling=DELAYED, step=0.05)
    used.effort(0.4, states[0])
    assert np.array_equal(np.concatenate(used.effort(BEFORE, states[1])), alone)
    assert np.abs(control.gain(0.4)[:, 8:]).max() > 0.0  # and it would have counted


def test_it_saturates_where_the_amplifiers_do():
    motion = crossing()
    control = TimeVaryingLqr(motion, effort_limit=1.0, carrier_force_limit=2.0, step=0.05)
    state = perturbed(motion.robot, motion, 0.3, [0.05, -0.05], [0.0, 0.0])
    tau, force = control.effort(0.3, state)
    assert np.abs(tau).max() <= 1.0
    assert np.abs(force).max() == 2.0


def test_bryson_weights_are_inverse_squares_of_what_is_acceptable():
    motion = crossing()
    weights = bryson_weights(motion, position=2e-3, carrier=5e-2, bandwidth=10.0, effort=4.0, carrier_force=[8.0, 16.0])
    assert np.allclose(np.diag(weights.Q) ** -0.5, [2e-3, 2e-3, 5e-2, 5e-2, 2e-2, 2e-2, 0.5, 0.5])
    assert np.allclose(np.diag(weights.R) ** -0.5, [4.0, 4.0, 8.0, 16.0])
    turned = bryson_weights(corner())
    assert np.diag(turned.Q)[2] ** -0.5 == pytest.approx(1e-3 / corner().robot.characteristic_length)


def test_a_massless_machine_has_no_linear_model_at_a_type_ii_pose():
    robot = rp.load_robot("2rpr")
    circle = trajectories.circle(speed=0.5)
    plan = rp.plan_switch_off(rp.RneaDynamics(robot), circle, threshold=10.0, mesh=rp.Mesh(dt=0.01))
    with pytest.raises(IllPosedModelError, match="end_effector_mass"):
        TimeVaryingLqr(plan, motion=circle)


def test_a_semidefinite_weight_may_be_so_up_to_rounding():
    rows = np.random.default_rng(0).normal(size=(3, 8))
    Q = rows.T @ rows
    assert np.linalg.eigvalsh(Q)[0] < 0.0
    assert np.isfinite(TimeVaryingLqr(crossing(), weights=LqrWeights(Q, np.eye(4)), step=0.1).riccati.K).all()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"step": 0.0}, "step is 0"),
        ({"sampling": Sampling(1e-3, 2e-3)}, "delay of 0.002 s is longer"),
        ({"weights": LqrWeights(np.eye(3), np.eye(4))}, r"Q has shape \(3, 3\)"),
        ({"weights": LqrWeights(np.eye(8), -np.eye(4))}, "R positive definite"),
        ({"weights": LqrWeights(np.diag([-1e-3, *np.ones(7)]), np.eye(4))}, "Q must be positive semidefinite"),
    ],
)
def test_settings_out_of_their_domain(changed, message):
    with pytest.raises(InputError, match=message):
        TimeVaryingLqr(crossing(), **changed)


@pytest.mark.parametrize(
    "changed", [{"position": 0.0}, {"carrier": -1.0}, {"bandwidth": np.inf}, {"effort": [1.0, 2.0, 3.0]}]
)
def test_weights_out_of_their_domain(changed):
    with pytest.raises(InputError, match=next(iter(changed))):
        bryson_weights(crossing(), **changed)
