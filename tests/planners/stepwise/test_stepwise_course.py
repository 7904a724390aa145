"""Returns, take-overs, braking, two-sided samples, and what happens between the samples of a stepwise plan."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import BSpline

from redundancy_pin import CarrierMotion, PlatformMotion, VirtualWork, distribute, load_robot, plan_stepwise
from redundancy_pin.planners.options import Limits, Mesh, Objective
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import Line, SpeedProfile, Trajectory, boundary_polynomial, reference


@functools.cache
def dynamics_of(mode=(1, 1, 1), carriers=True):
    return VirtualWork(load_robot("3rrr", working_mode=mode, carriers=carriers))


def phase_names(plan):
    return np.array(plan.phases)[plan.phase]


@functools.cache
def square_plan(**settings):
    motion = reference.square().sample(0.01, two_sided=False)
    base = dynamics_of((1, -1, 1), carriers=False)
    return plan_stepwise(
        dynamics_of((1, -1, 1)),
        motion,
        active="accelerating",
        **in_groups(plan_stepwise, dict(lam=0.5, baseline=base, **settings)),
    )


def test_the_optimiser_works_exactly_while_the_platform_accelerates():
    plan = square_plan()
    moves = np.abs(plan.motion.xdd).max(axis=1) > 1e-9
    optimised = phase_names(plan)[1:] == "optimise"
    np.testing.assert_array_equal(optimised, moves[1:])


def test_rounding_in_the_reference_is_no_acceleration():
    motion = reference.square().sample(0.01, two_sided=False)
    noise = 1e-13 * np.sin(1000.0 * motion.t)[:, None] * [1.0, -1.0, 0.0]
    plans = [
        plan_stepwise(dynamics_of(), PlatformMotion(motion.t, motion.x, motion.xd, xdd), active="accelerating")
        for xdd in (motion.xdd, motion.xdd + noise)
    ]
    np.testing.assert_array_equal(plans[0].phase, plans[1].phase)


def test_returns_are_the_septic_from_the_last_optimised_state():
    plan = square_plan(return_time=0.4)
    names = phase_names(plan)
    starts = np.flatnonzero((names[1:] == "return") & (names[:-1] == "optimise"))
    assert len(starts) == len(plan.diagnostics["returns"]) == 4  # after the ramp and three corners
    for start, (begun, ended) in zip(starts, plan.diagnostics["returns"], strict=True):
        assert begun == plan.t[start]
        assert ended == pytest.approx(begun + 0.4)
        zero = np.zeros(3)
        state = [getattr(plan.carriers, part)[start] for part in ("s", "sd", "sdd")]
        septic = boundary_polynomial(begun, ended, [*state, zero], [zero] * 4)
        inside = np.arange(start + 1, len(plan.t))
        inside = inside[(plan.t[inside] < ended) & (np.cumsum(names[inside] != "return") == 0)]
        for order, part in enumerate(("s", "sd", "sdd")):
            np.testing.assert_allclose(
                getattr(plan.carriers, part)[inside], septic.derivative(order)(plan.t[inside]), atol=1e-9
            )


def test_parked_at_the_datum_between_return_and_next_corner():
    datum = (0.05, -0.1, 0.0)
    plan = square_plan(return_time=0.3, datum=datum)
    parked = np.flatnonzero(phase_names(plan) == "parked")
    parked = parked[plan.t[parked] > 0.1]
    assert len(parked) > 50
    np.testing.assert_array_equal(plan.carriers.s[parked], np.tile(datum, (len(parked), 1)))
    assert not plan.carriers.sd[parked].any()


def test_the_optimiser_takes_over_an_unfinished_return():
    plan = square_plan(return_time=2.0)
    names = phase_names(plan)
    over = np.flatnonzero((names[1:] == "optimise") & (names[:-1] == "return")) + 1
    assert len(over) == 4
    assert np.abs(plan.carriers.sd[over - 1]).max() > 0.01
    h = (plan.t[over] - plan.t[over - 1])[:, None]
    np.testing.assert_allclose(
        plan.carriers.s[over], plan.carriers.s[over - 1] + h * plan.carriers.sd[over], atol=1e-14
    )
    np.testing.assert_allclose(
        plan.carriers.sd[over], plan.carriers.sd[over - 1] + h * plan.carriers.sdd[over], atol=1e-14
    )


def test_a_return_that_breaks_a_limit_is_said_to():
    plan = square_plan(return_time=0.1)
    assert plan.status is ResultStatus.LIMIT_VIOLATED
    assert {event.quantity for event in plan.limits.violated} <= {"acceleration", "speed"}


def test_stopping_within_the_motion_keeps_its_samples():
    motion = reference.corner().sample(0.005, two_sided=False)
    plan = plan_stepwise(dynamics_of(), motion, stop="within")
    np.testing.assert_array_equal(plan.t, motion.t)
    assert np.abs(plan.carriers.sd[-1]).max() < 1e-12
    assert np.abs(plan.carriers.sdd).max() <= 7.0 * (1.0 + 1e-9)
    free = plan_stepwise(dynamics_of(), motion)
    untouched = plan.t < motion.t[-1] - 1.0 / 7.0  # from 1 m/s a carrier stops in 1/7 s
    np.testing.assert_allclose(plan.carriers.s[untouched], free.carriers.s[: len(motion)][untouched], atol=1e-12)


@pytest.mark.parametrize(("stop", "brake_time"), [("after", 0.2), ("after", 0.5), ("within", 0.5)])
def test_braking_begins_when_the_platform_comes_to_rest(stop, brake_time):
    """A motion that stands still for its last 0.3 s: the carriers are braked there, on time for ``within``."""
    motion = reference.corner().sample(0.01, two_sided=False)
    tail = np.arange(1, 31) * 0.01
    still = PlatformMotion(
        np.concatenate([motion.t, motion.t[-1] + tail]),
        np.vstack([motion.x, np.repeat(motion.x[-1:], 30, axis=0)]),
        np.vstack([motion.xd, np.zeros((30, 3))]),
        np.vstack([motion.xdd, np.zeros((30, 3))]),
    )
    plan = plan_stepwise(
        dynamics_of((1, -1, 1)),
        still,
        stop=stop,
        brake_time=brake_time,
        active="accelerating",
        objective=Objective(lam=0.5, baseline=dynamics_of((1, -1, 1), carriers=False)),
    )
    begun, ended = plan.diagnostics["braking"]
    assert begun == pytest.approx(motion.t[-2])  # the last sample at which the platform decelerates
    duration = min(brake_time, still.t[-1] - begun) if stop == "within" else brake_time
    assert ended == pytest.approx(begun + duration)
    assert plan.t[-1] == pytest.approx(
        max(still.t[-1], np.ceil((ended - still.t[-1]) / 0.01 - 1e-6) * 0.01 + still.t[-1])
    )
    assert not plan.carriers.sd[plan.t > ended - 1e-9].any()
    begins = int(np.searchsorted(plan.t, begun))
    first = (plan.t > begun) & (plan.t < ended - 0.01)
    expected = np.tile(-plan.carriers.sd[begins] / duration, (first.sum(), 1))
    np.testing.assert_allclose(plan.carriers.sdd[first], expected, atol=1e-9)


def test_anticipation_changes_nothing_until_a_carrier_must_stop():
    motion = reference.corner().sample(0.005, two_sided=False)
    with_it, without = (plan_stepwise(dynamics_of(), motion, anticipate=choice) for choice in (True, False))
    np.testing.assert_array_equal(with_it.carriers.s, without.carriers.s)


def test_the_small_corner_of_the_thesis_ends_with_a_carrier_that_cannot_stop_and_with_anticipation_it_can():
    motion = reference.corner(radius=0.013).sample(0.01, two_sided=False)
    plan = plan_stepwise(dynamics_of(), motion, anticipate=False)
    assert plan.status is ResultStatus.LIMIT_VIOLATED
    (event,) = plan.limits.violated
    assert (event.joint, event.quantity) == ("carrier_2", "track")
    assert event.worst > motion.t[-1]
    assert 0.01 < event.amount < 0.1
    assert not plan_stepwise(dynamics_of(), motion).limits.violated


def test_anticipation_keeps_a_short_track():
    motion = reference.corner().sample(0.005)
    plan = plan_stepwise(dynamics_of(), motion, limits=Limits(track=(-0.3, 0.2)))
    assert plan.status is ResultStatus.OK
    assert plan.carriers.s.min() >= -0.3
    assert plan.carriers.s.max() <= 0.2
    assert "stop" in {event["bound"] for event in plan.diagnostics["bounds"]}
    assert plan.carriers.s.min() < -0.28  # it uses the track


# ------------------------------------------------------------------------------------------------ between the samples


def dense_efforts(plan, trajectory, dynamics, points):
    """Times, and efforts of the quadratic spline with the plan's positions as control points (steps from rest)."""
    h = plan.t[1] - plan.t[0]
    # ghost points: the carriers rested before
    control = np.vstack([plan.carriers.s[:1], plan.carriers.s])
    knots = plan.t[0] + h * np.arange(-2, len(control) + 1)
    spline = BSpline(knots, control, 2)
    left = np.arange(len(plan.t) - 1)
    left = left[plan.t[left + 1] <= trajectory.duration]
    t = (plan.t[left, None] + h * np.arange(1, points + 1) / (points + 1)).ravel()
    carriers = CarrierMotion(spline(t), spline.derivative()(t), spline.derivative(2)(t))
    return t, distribute(dynamics.reduce(trajectory.sample_at(t), carriers, check_track=False)).tau


def test_between_samples_is_the_quadratic_spline_of_the_positions():
    trajectory = reference.corner(straight=0.12)
    steps = 300
    motion = trajectory.sample(times=np.linspace(0.0, trajectory.duration, steps + 1), two_sided=False)
    plan = plan_stepwise(dynamics_of(), motion)
    t, expected = dense_efforts(plan, trajectory, dynamics_of(), 3)
    exact = replace(plan, functions=plan.functions_along(trajectory))
    np.testing.assert_allclose(exact.efforts_at(t, dynamics_of()), expected, atol=1e-6 * np.abs(expected).max())
    lag = np.abs(plan.carriers_at(motion.t).s - plan.carriers.s[: len(motion)]).max()
    h = trajectory.duration / steps
    assert lag == pytest.approx(0.5 * h * np.abs(plan.carriers.sd).max(), rel=1e-9)


def test_a_two_sided_sample_has_one_state_and_two_accelerations():
    trajectory = reference.corner()
    plan = plan_stepwise(dynamics_of((1, -1, 1)), trajectory.sample(0.005))
    jumps = np.flatnonzero(plan.motion.jumps)
    assert len(jumps) == 2
    for j in jumps:
        np.testing.assert_array_equal(plan.carriers.s[j], plan.carriers.s[j - 1])
        np.testing.assert_array_equal(plan.carriers.sd[j], plan.carriers.sd[j - 1])
        np.testing.assert_array_equal(plan.carriers.sdd[j], plan.carriers.sdd[j + 1])
        assert np.abs(plan.carriers.sdd[j] - plan.carriers.sdd[j - 1]).max() > 1.0
    # out of the corner into a return, which begins with the acceleration the optimiser left
    plan = plan_stepwise(dynamics_of((1, -1, 1)), trajectory.sample(0.005), active="accelerating")
    out = np.flatnonzero(plan.motion.jumps)[1]
    assert phase_names(plan)[out - 1 : out + 1].tolist() == ["optimise", "return"]
    np.testing.assert_array_equal(plan.carriers.sdd[out], plan.carriers.sdd[out - 1])


def test_halving_the_step_converges_at_first_order():
    """Backward differences: the distance to a fine plan halves with the step."""
    trajectory = reference.corner()
    mode = (1, -1, 1)
    end = 0.72  # before the corner the motion is smooth
    places = []
    for dt in (0.02, 0.01, 0.005, 0.0005):
        motion = trajectory.sample(times=np.linspace(0.0, end, round(end / dt) + 1))
        plan = plan_stepwise(
            dynamics_of(mode), motion, stop="within", limits=Limits(acceleration=1e3, speed=1e3), brake_time=1e-3
        )
        places.append(plan.carriers.s[np.searchsorted(plan.t, 0.6 - 1e-9)])
    errors = [np.abs(place - places[-1]).max() for place in places[:-1]]
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rates > 0.8).all()
    assert (rates < 1.3).all()  # the fine plan has a tenth of the last error of its own


def test_between_samples_follows_the_polynomials_of_the_returns():
    trajectory, dynamics, plan = reference.square(), dynamics_of((1, -1, 1)), square_plan(return_time=0.4)
    for begun, ended in plan.diagnostics["returns"]:
        start = int(np.searchsorted(plan.t, begun))
        t = np.linspace(begun, ended, 60)[1:-1]
        zero = np.zeros(3)
        state = [getattr(plan.carriers, part)[start] for part in ("s", "sd", "sdd")]
        septic = boundary_polynomial(begun, ended, [*state, zero], [zero] * 4)
        # what the steps before the return lagged behind the samples is carried on
        lag = plan.carriers_at([begun]).s - state[0]
        carriers = CarrierMotion(septic(t) + lag, septic.derivative(1)(t), septic.derivative(2)(t))
        expected = distribute(dynamics.reduce(trajectory.sample_at(t), carriers)).tau
        exact = replace(plan, functions=plan.functions_along(trajectory))
        np.testing.assert_allclose(exact.efforts_at(t, dynamics), expected, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize(("brake_time", "track"), [(0.3, None), (0.02, None), (0.5, 0.25)])
def test_braking_takes_the_wanted_time_or_what_track_and_deceleration_ask(brake_time, track):
    """Constant decelerations: min(wanted, 2 d / v) and at least v / a for each carrier, d to the end of its track."""
    motion = reference.corner().sample(0.005)
    plan = plan_stepwise(
        dynamics_of(), motion, brake_time=brake_time, limits=Limits(track=None if track is None else (-track, track))
    )
    last = int(np.searchsorted(plan.t, motion.t[-1]))
    s, v = plan.carriers.s[last], plan.carriers.sd[last]
    room = (1.0 if track is None else track) - np.sign(v) * s
    wanted = np.maximum(np.minimum(brake_time, 2.0 * room / np.abs(v)), np.abs(v) / 7.0)
    elapsed = plan.t[last:, None] - motion.t[-1]
    expected = v * np.clip(1.0 - elapsed / wanted, 0.0, None)
    np.testing.assert_allclose(plan.carriers.sd[last:], expected, atol=1e-12)
    np.testing.assert_allclose(plan.diagnostics["braking"], motion.t[-1] + np.array([0.0, wanted.max()]))
    h = np.diff(plan.t[last:])[:, None]
    np.testing.assert_allclose(np.diff(plan.carriers.s[last:], axis=0), h * expected[1:], atol=1e-12)


def test_a_limit_broken_between_samples_of_a_return_is_said():
    """A return whose samples stay within 7 m/s² while its polynomial does not (coarse steps of 20 ms)."""
    path = Line([0.6, 0.5, 0.0], [1.1, 0.5, 0.0])
    motion = Trajectory(path, SpeedProfile(path.length, 0.3, 0.2))
    plan = plan_stepwise(dynamics_of(), motion, mesh=Mesh(dt=0.02), active="accelerating", return_time=0.8542364)
    assert np.abs(plan.carriers.sdd).max() <= 7.0 * (1 + 1e-9)
    assert plan.status is ResultStatus.LIMIT_VIOLATED
    event = max(plan.limits.violated, key=lambda event: event.amount)
    assert event.quantity == "acceleration"
    assert 0.0 < event.amount < 0.02
