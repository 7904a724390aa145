"""The thesis's discretisation beside the integration, thresholds by margin, and the shortest return in a plan."""

import functools

import numpy as np
import pytest
import zoo
from leg_momentum import imbalance, legs_along, momentum_rate

from redundancy_pin import RneaDynamics, VirtualWork
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.switch_off.planner import plan_switch_off
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import reference


def two_rpr(**arguments):
    return VirtualWork(zoo.robot_of("2rpr", **arguments))


@functools.cache
def stepwise(dt, speed=0.5, threshold=5.0):
    return plan_switch_off(
        two_rpr(), reference.circle(speed), threshold=threshold, dt=dt, scheme="backward_differences"
    )


def test_backward_differences_are_what_they_say():
    plan = stepwise(1e-3)
    (window,) = plan.diagnostics["windows"]
    driven = np.flatnonzero((plan.t >= window["ramp_start"]) & (plan.t <= window["exit"]))
    s, sd, sdd = (
        part[driven[0] - 2 : driven[-1] + 1] for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd)
    )
    np.testing.assert_allclose(np.diff(s, axis=0)[1:] / 1e-3, sd[2:], atol=1e-11)
    np.testing.assert_allclose(np.diff(s, n=2, axis=0) / 1e-6, sdd[2:], atol=1e-8)
    legs = legs_along(plan.motion.x, plan.motion.xd, plan.motion.xdd)
    c = plan.carriers
    error = imbalance(legs, momentum_rate(legs, c.s, c.sd, c.sdd), plan.tau)
    assert np.abs(error).max() < 1e-7


@pytest.mark.long_for("0.75-5.0-jumps1")
@pytest.mark.parametrize(
    ("speed", "threshold", "jumps"),
    [
        (0.5, 5.0, (0.23, 0.21)),
        (0.75, 5.0, (0.84, 0.79)),
        *(pytest.param(0.5, most, (0.15, 0.15), marks=pytest.mark.long) for most in (10.0, 20.0)),
    ],
)
def test_jump_at_switch_on_is_that_of_the_step(speed, threshold, jumps):
    """The rebuilt jumps at 1 ms (the window snaps to the grid: up to 0.03 N), and half of them at half the step."""
    of = () if (speed, threshold) == (0.5, 5.0) else (speed, threshold)  # those are made once
    measured = np.array([stepwise(dt, *of).diagnostics["windows"][0]["exit_jump"] for dt in (1e-3, 5e-4)])
    np.testing.assert_allclose(measured[0], jumps, atol=0.03)
    np.testing.assert_allclose(measured[0] / measured[1], 2.0, rtol=0.1)


def test_backward_differences_converge_to_the_integration_at_first_order():
    exact = plan_switch_off(two_rpr(), reference.circle(), dt=1e-3)
    errors = []
    for dt in (2e-3, 1e-3, 5e-4):
        plan = stepwise(dt)
        common = np.arange(0.36, 0.966, 2e-3)
        ours = [np.interp(common, p.t, p.carriers.s[:, 0]) for p in (plan, exact)]
        errors.append(np.abs(ours[0] - ours[1]).max())
    assert errors[0] < 5e-3
    # the window snaps to the grid, which changes the ramp by up to a step: halving is not exact
    assert 1.5 < errors[0] / errors[2] < 8.0


def test_backward_differences_share_a_task_among_four_carriers_as_the_integration_does():
    dynamics = RneaDynamics(zoo.robot_of("2rpr", end_effector_carriers=True))
    exact, plan = (
        plan_switch_off(dynamics, reference.circle(), threshold=7.0, dt=0.01, scheme=scheme)
        for scheme in ("integration", "backward_differences")
    )
    s = exact.carriers.s
    # of first order: 7 mm at this step, half of it at half the step
    assert np.abs(plan.carriers_at(exact.t).s - s).max() < 0.01 < 0.1 * np.ptp(s, axis=0).min()


def test_backward_differences_refuse_what_the_integration_refuses():
    with pytest.raises(InfeasiblePlanError, match="nothing can carry"):
        plan_switch_off(two_rpr(end_effector_mass=0.3), reference.circle(), scheme="backward_differences")


def test_threshold_on_the_margin():
    """Of unit vectors an angle γ apart the singular values are √(1 ± cos γ)."""
    trajectory, threshold = reference.circle(), 0.2
    plan = plan_switch_off(two_rpr(), trajectory, measure="margin", threshold=threshold)
    (window,) = plan.diagnostics["windows"]
    point = trajectory.sample_at([window["entry"], window["exit"]])
    u = legs_along(point.x, point.xd, point.xdd).u
    cosine = np.abs(np.einsum("nj,nj->n", u[:, 0], u[:, 1]))
    np.testing.assert_allclose(np.sqrt(1.0 - cosine), threshold, rtol=1e-9)
    # the same windows as with the condition number that belongs to it
    ratio = np.sqrt((2.0 - threshold**2) / threshold**2)
    other = plan_switch_off(two_rpr(), trajectory, threshold=ratio)
    assert other.diagnostics["windows"][0]["entry"] == pytest.approx(window["entry"], abs=1e-10)
    assert plan.diagnostics["worst_measure"] < 1e-12


@pytest.mark.long_for("20.0")
@pytest.mark.parametrize("threshold", [10.0, 20.0])
def test_shortest_return_in_a_plan(threshold):
    plan = plan_switch_off(two_rpr(), reference.circle(), threshold=threshold, return_time="shortest")
    (window,) = plan.diagnostics["windows"]
    assert plan.status is ResultStatus.OK
    assert {event.quantity for event in plan.limits.binding} == {"acceleration"}
    shorter = plan_switch_off(
        two_rpr(), reference.circle(), threshold=threshold, return_time=0.999 * window["return_time"]
    )
    assert shorter.status is ResultStatus.LIMIT_VIOLATED


@pytest.mark.long
def test_shortest_returns_decide_whether_windows_merge():
    plan = plan_switch_off(two_rpr(), reference.circle(), threshold=400.0, return_time="shortest")
    assert len(plan.diagnostics["windows"]) == 2
    assert plan.status is ResultStatus.OK
    merged = plan_switch_off(two_rpr(), reference.circle(), threshold=20.0, return_time="shortest")
    assert len(merged.diagnostics["windows"]) == 1


def test_events_are_samples_and_jumps_are_two_sided():
    """A path of lines and arcs: the acceleration jumps where they meet, inside the window too."""
    from redundancy_pin.trajectory import SpeedProfile, Trajectory, rounded_polygon

    path = rounded_polygon([[0.1, 0.3], [0.1, -0.04], [0.4, -0.04], [0.4, 0.3]], 0.08, start=0.09)
    trajectory = Trajectory(path, SpeedProfile(path.length, 0.4, 0.1))
    plan = plan_switch_off(two_rpr(), trajectory, threshold=5.0, ramp_down=0.02, return_time=0.2)
    for window in plan.diagnostics["windows"]:
        for event in ("ramp_start", "entry", "exit", "return_end"):
            assert np.abs(plan.t - window[event]).min() == 0.0
    jumps = plan.t[plan.motion.jumps]
    np.testing.assert_array_equal(jumps, trajectory.breaks)
    inside = [plan.phase[np.searchsorted(plan.t, t)] for t in jumps]
    assert 2 in inside  # some jump lies in the off phase, where s̈ has to jump with it
    for t in jumps:
        i = int(np.searchsorted(plan.t, t))
        np.testing.assert_allclose(plan.carriers.s[i], plan.carriers.s[i + 1], atol=1e-14)
        np.testing.assert_allclose(plan.carriers.sd[i], plan.carriers.sd[i + 1], atol=1e-12)
    legs = legs_along(plan.motion.x, plan.motion.xd, plan.motion.xdd)
    c = plan.carriers
    error = imbalance(legs, momentum_rate(legs, c.s, c.sd, c.sdd), plan.tau)
    assert np.abs(error).max() < 1e-9 * np.abs(plan.tau).max()
