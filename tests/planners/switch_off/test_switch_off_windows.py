"""Thresholds, merged windows, returns and jumps, spare carriers."""

from __future__ import annotations

import numpy as np
import pytest
import zoo
from leg_momentum import imbalance, legs_along, momentum_rate

from redundancy_pin import Mesh, VirtualWork, plan_switch_off
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference, rounded_polygon


def two_rpr(**arguments):
    return VirtualWork(zoo.robot_of("2rpr", **arguments))


def test_the_instant_that_stops_the_carriers_is_named_not_one_before_it():
    """Across the line of the hinges straight, which needs no force along it, and back on an arc, which does."""
    vertices = [[0.1, 0.3], [0.1, -0.06], [0.3, -0.06], [0.3, 0.0], [0.42, 0.3]]
    path = rounded_polygon(vertices, 0.04, closed=False)
    trajectory = Trajectory(path, SpeedProfile(path.length, 0.4, 0.1))
    with pytest.raises(InfeasiblePlanError, match="nothing can carry") as caught:
        plan_switch_off(two_rpr(end_effector_mass=0.3), trajectory, ramp_down=0.02)
    t, amount = caught.value.details["time"], caught.value.details["amount"]
    there = trajectory.sample_at([t])
    assert abs(there.x[0, 1]) < 1e-9
    assert there.x[0, 0] > 0.29
    assert amount == pytest.approx(0.3 * abs(there.xdd[0, 0]), rel=1e-7)


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


def test_events_are_samples_and_jumps_are_two_sided():
    """A path of lines and arcs: the acceleration jumps where they meet, inside the window too."""
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


def test_every_step_of_the_grid_is_a_sample():
    """Events are further ones; only what differs from one by rounding is left out."""
    dt, circle = 2e-4, reference.circle()
    plan = plan_switch_off(two_rpr(), circle, mesh=Mesh(dt=dt))
    grid = np.append(dt * np.arange(np.ceil(circle.duration / dt - 1e-9)), circle.duration)
    right = np.searchsorted(plan.t, grid).clip(1, len(plan.t) - 1)
    apart = np.minimum(np.abs(plan.t[right] - grid), np.abs(plan.t[right - 1] - grid))
    assert apart.max() <= 1e-9 * dt


def test_no_step_is_as_short_as_rounding():
    """A break of the path that is on the grid, but for its last bits, is one sample with it."""
    path = rounded_polygon([[0.1, 0.3], [0.1, -0.04], [0.4, -0.04], [0.4, 0.3]], 0.08, start=0.09)
    trajectory = Trajectory(path, SpeedProfile(path.length, 0.4, 0.1))
    corner = trajectory.breaks[0]
    steps = next(n for n in range(100, 200) if n * (corner / n) != corner)
    plan = plan_switch_off(two_rpr(), trajectory, ramp_down=0.02, return_time=0.2, mesh=Mesh(dt=corner / steps))
    apart = np.diff(np.unique(plan.t))
    assert apart.min() > 1e-9 * plan.t[-1]
