"""Limits of a plan at their edges: events by a loop over samples, and what a check lets pass, at several sizes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import zoo
from scipy.interpolate import BPoly, CubicSpline

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.planners.check import SAME, SAME_PEAK, merged_events
from redundancy_pin.planners.intersample_check import BALANCE_TOLERANCE
from redundancy_pin.planners.limits import (
    BINDING,
    EXCEEDING,
    LimitEvent,
    Limits,
    ResolvedLimits,
    check_limits,
    limit_events,
    motion_events,
    range_events,
)
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import CarrierLimits
from redundancy_pin.robot.joint_ranges import joint_ranges
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial


def stretches(t: Array, flags: list[bool]) -> Iterator[list[int]]:
    run: list[int] = []
    for i, flag in enumerate([*flags, False]):
        if flag:
            run.append(i)
        elif run:
            yield run
            run = []


def by_a_loop(limits: list[CarrierLimits], t: Array, values: list[Array]) -> tuple[set, set]:
    """Broken and touched limits, one sample after the other."""
    broken, touched = set(), set()
    for i, limit in enumerate(limits):
        ends = {
            "track": (limit.lower, limit.upper),
            "speed": (-limit.speed, limit.speed),
            "acceleration": (-limit.acceleration, limit.acceleration),
            "force": (-limit.force, limit.force),
        }
        for (quantity, (low, high)), series in zip(ends.items(), values, strict=True):
            for edge, sign in ((high, 1.0), (low, -1.0)):
                if not np.isfinite(edge):
                    continue
                size = max(abs(edge), (high - low) / 2.0)
                excess = [sign * (x - edge) for x in series[:, i]]
                over = [x > EXCEEDING * size for x in excess]
                near = [x > -BINDING * size and not far for x, far in zip(excess, over, strict=True)]
                for into, flags in ((broken, over), (touched, near)):
                    for run in stretches(t, flags):
                        worst = max(run, key=lambda k: excess[k])
                        into.add(
                            LimitEvent(
                                f"c{i}",
                                quantity,
                                t[run[0]],
                                t[run[-1]],
                                t[worst],
                                series[worst, i],
                                edge,
                                max(excess[worst], 0.0),
                            )
                        )
    return broken, touched


def resolved(carriers: list[CarrierLimits]) -> ResolvedLimits:
    """Return the limits of carriers c0, c1, ... alone."""
    names = tuple(f"c{i}" for i in range(len(carriers)))
    track = np.array([(one.lower, one.upper) for one in carriers])
    rates = (np.array([getattr(one, name) for one in carriers]) for name in ("speed", "acceleration", "force"))
    none = np.full(len(carriers), np.inf)
    return ResolvedLimits(names, track, *rates, jerk=none, effort=none, actuator_speed=none)


@pytest.mark.parametrize("size", [1.0, 2.0**-20])
def test_events_are_those_of_a_loop_over_the_samples(size):
    rng = np.random.default_rng(7)
    limits = [
        CarrierLimits(-0.3 * size, 0.5 * size, 2.0 * size, 7.0 * size, 30.0 * size),
        CarrierLimits(0.2 * size, 0.9 * size, 3.0 * size, np.inf, 40.0 * size),
        CarrierLimits(-np.inf, np.inf, np.inf, 5.0 * size, np.inf),
    ]
    t = np.sort(rng.uniform(0.0, 9.0, 400))
    ends = [[(one.lower, one.upper) for one in limits]]
    ends += [
        [(-getattr(one, name), getattr(one, name)) for one in limits] for name in ("speed", "acceleration", "force")
    ]
    beside = [-3.0 * BINDING, -1.5 * BINDING, -0.7 * BINDING, 0.0, 0.7 * EXCEEDING, 1.5 * EXCEEDING, 3e-9, 0.4]
    values = []
    for sides in ends:
        columns = []
        for low, high in sides:
            at = np.where(rng.random(400) < 0.5, low, high) if np.isfinite(low) else np.full(400, size)
            half = np.maximum(np.abs(at), (high - low) / 2.0) if np.isfinite(low) else size
            # runs of samples, so that an event has a start and an end
            step = np.repeat(rng.choice(beside, 100), 4)
            columns.append(at + np.where(at == low, -1.0, 1.0) * step * half)
        values.append(np.array(columns).T)
    report = check_limits(resolved(limits), t, rp.CarrierMotion(*values[:3], check_rates=False), values[3])
    broken, touched = by_a_loop(limits, t, values)
    assert len(broken) > 100
    assert len(touched) > 100
    assert set(report.violated) == broken
    assert set(report.binding) == touched
    for events in (report.violated, report.binding):
        starts = [event.start for event in events]
        assert starts == sorted(starts)


def test_efforts_beyond_their_limits_or_at_them_are_one_event_each():
    """By a loop, with 0.1 % written out: two actuators are beyond, two at their limit, one has none, one is below."""
    rng = np.random.default_rng(2)
    for _ in range(20):
        t, names = np.sort(rng.uniform(0.0, 3.0, 60)), ("a", "b", "c", "d", "e", "f")
        limit = np.array([2.0, 50.0, np.inf, 0.3, 7.0, 7.0])
        values = rng.normal(size=(60, 6)) * np.where(np.isfinite(limit), limit, 1.0)
        values[rng.integers(60, size=5), 1] = np.nan
        values[:, 3] = 0.3 * 1.0009 * np.where(np.arange(60) == 20, -1.0, 0.9)
        values[:, 4] = 7.0 * 0.9991 * np.where(np.arange(60) % 30 == 20, 1.0, -0.9)
        values[:, 5] = 7.0 * 0.9989
        violated, touched = limit_events("effort", names, t, values, limit)
        assert [event.carrier for event in violated] == ["a", "b"]
        assert [event.carrier for event in touched] == ["d", "e"]
        for event in (*violated, *touched):
            column, most = values[:, names.index(event.carrier)], limit[names.index(event.carrier)]
            size = np.where(np.isnan(column), 0.0, np.abs(column))
            over = np.flatnonzero(size > most * (1.001 if event in violated else 0.999))
            worst = max(over, key=lambda k: size[k])
            assert (event.start, event.end, event.worst) == (t[over[0]], t[over[-1]], t[worst])
            assert event.value == column[worst]
            assert event.limit == np.sign(column[worst]) * most
            assert event.amount == pytest.approx(max(size[worst] - most, 0.0), rel=1e-9)
        values[20, 3] *= 1.0 + 2e-4
        assert limit_events("effort", names, t, values, limit)[0][-1].carrier == "d"


def test_between_samples_the_largest_values_decide():
    """Of random cubics and septics, by dense samples: position, speed, acceleration, and where they are largest.

    The acceleration of a septic, such as a carrier's way back, is largest inside a piece.
    """
    rng = np.random.default_rng(5)
    for septic in (False, True) * 20:
        t = np.concatenate([[1.0], 1.0 + np.cumsum(rng.uniform(0.05, 0.4, 5))])
        spline = CubicSpline(t, rng.normal(size=(6, 1)))
        position = PiecewisePolynomial.linear(t, *(spline(t, order) for order in range(3)))
        if septic:
            ends = rng.normal(size=(6, 4, 1)) * np.array([0.1, 1.0, 10.0, 100.0])[:, None]
            spline = BPoly.from_derivatives(t, ends)
            position = PiecewisePolynomial.through(t, *ends.swapaxes(0, 1))
        dense = np.unique(np.append(t, np.linspace(t[0], t[-1], 20001)))
        values = [spline(dense, order).ravel() for order in range(3)]
        peaks = [np.abs(value).max() for value in values]
        limits = [CarrierLimits(-0.8 * peaks[0], 0.8 * peaks[0], 0.9 * peaks[1], 0.95 * peaks[2], np.inf)]
        events = motion_events(resolved(limits), position)
        for quantity, value, part in (
            ("speed", values[1], 0.9),
            ("acceleration", values[2], 0.95),
            ("track", values[0], 0.8),
        ):
            mine = [event for event in events if event.quantity == quantity]
            worst = max(mine, key=lambda event: event.amount)
            most = np.abs(value).max()
            assert worst.amount == pytest.approx((1.0 - part) * most, rel=2e-2)
            assert abs(worst.value) == pytest.approx(most, rel=2e-3)
            assert worst.limit == pytest.approx(np.sign(worst.value) * part * most, rel=1e-9)


def test_joints_beyond_their_ranges_are_named_with_what_is_too_much():
    robot = zoo.robot_of("five_bar")
    ranges = [joint for joint in joint_ranges(robot) if np.isfinite(joint.upper - joint.lower)]
    assert ranges
    t = np.arange(7.0)
    for joint in ranges:
        q = np.tile(robot.q_reference, (7, 1))
        q[2, joint.at] = joint.upper + 0.25
        q[3, joint.at] = joint.upper + 0.5
        q[5, joint.at] = joint.lower - 0.125
        q[6] = np.nan
        events = {event.limit: event for event in range_events(robot, t, q) if event.carrier == joint.name}
        over, under = events[joint.upper], events[joint.lower]
        assert (over.start, over.end, over.worst) == (2.0, 3.0, 3.0)
        assert over.amount == pytest.approx(0.5)
        assert over.value == pytest.approx(joint.upper + 0.5)
        assert (under.start, under.end, under.worst) == (5.0, 5.0, 5.0)
        assert under.amount == pytest.approx(0.125)


def test_an_event_replaces_one_that_it_overlaps_where_it_exceeds_by_more():
    at = LimitEvent("a", "speed", 1.0, 2.0, 1.5, 3.0, 2.5, 0.5)
    for start, end, overlaps in (
        (2.0, 3.0, True),
        (2.1, 3.0, False),
        (0.0, 1.0, True),
        (0.0, 0.9, False),
        (1.2, 1.4, True),
    ):
        for amount in (0.4, 0.6):
            other = replace(at, start=start, end=end, amount=amount)
            merged = merged_events((at,), (other,))
            if not overlaps:
                assert set(merged) == {at, other}
            else:
                assert merged == ((other,) if amount > 0.5 else (at,))
    below = replace(at, limit=-2.5, amount=0.9)
    assert set(merged_events((at,), (below,))) == {at, below}
    # an effort that is exceeded has one event, whatever its sign and when
    efforts = replace(at, quantity="effort"), replace(below, quantity="effort", start=7.0, end=8.0)
    assert merged_events(efforts[:1], efforts[1:]) == efforts[1:]


@cache
def planned() -> Plan:
    dynamics = rp.VirtualWork(zoo.robot_of("3rrr", carrier_mass=3.0))
    return rp.plan_whole_trajectory(dynamics, reference.corner(), dt=0.05, refinements=0)


@pytest.mark.parametrize("beyond", [False, True])
@pytest.mark.parametrize(
    "name", ["carrier_force", "actuated_rate", "margin", "x", "xd", "xdd", "s", "sd", "sdd", "tau", "peak"]
)
def test_a_check_lets_pass_what_two_backends_may_show_and_no_more(name, beyond):
    plan = planned()
    i, part = 4, 1.05 if beyond else 0.95
    if name == "tau":
        dynamics = rp.RneaDynamics(zoo.robot_of("3rrr", carrier_mass=3.0))
        reduced = dynamics.reduce(plan.motion, plan.carriers)
        size = np.abs(reduced.f / reduced.row_scale).max()
        column = np.linalg.norm(reduced.W[i, :, 1] / reduced.row_scale)
        tau = plan.tau.copy()
        tau[i, 1] += part * BALANCE_TOLERANCE * size / column
        changed, what, amount = replace(plan, tau=tau), "main efforts", part * BALANCE_TOLERANCE
    elif name == "peak":
        peak = plan.between.peak.copy()
        amount = part * SAME_PEAK * peak.max()
        peak[1] += amount
        changed, what = replace(plan, between=replace(plan.between, peak=peak)), "peak effort"
    else:
        holder = plan.carriers if name in ("s", "sd", "sdd") else plan.motion if name in ("x", "xd", "xdd") else plan
        values = np.array(getattr(holder, name))
        flat = values.reshape(len(values), -1)
        amount = part * SAME * (1e3 if name == "sdd" else 1.0) * np.abs(values).max()
        flat[i, -1] += amount
        new = replace(holder, **{name: flat.reshape(values.shape)})
        changed = plan if new is plan else new
        if holder is plan.carriers:
            changed = replace(plan, carriers=new)
        elif holder is plan.motion:
            changed = replace(plan, motion=new)
        what = {
            "carrier_force": "forces of the carriers", "actuated_rate": "rates of the main actuators",
            "margin": "margin", **{part: f"platform motion {part}" for part in ("x", "xd", "xdd")},
        }.get(name, f"carrier motion {name}")  # fmt: skip
    found = rp.check_plan(changed, rp.RneaDynamics(zoo.robot_of("3rrr", carrier_mass=3.0)))
    named = {deviation.quantity: deviation for deviation in found.deviations}
    assert (what in named) == beyond
    if beyond:
        assert named[what].amount == pytest.approx(amount, rel=1e-2)
        if name != "peak":
            assert named[what].time == plan.t[i]


@pytest.mark.parametrize("size", [1.0, 2.0**20])
def test_places_are_on_a_track_up_to_its_ends(size):
    robot = zoo.robot_of("2rpr")
    limits = Limits(track=[(-0.2 * size, 0.3 * size), (0.1 * size, 0.4 * size)]).resolved(robot)
    for places in ((-0.2, 0.1), (0.3, 0.4)):
        np.testing.assert_array_equal(limits.on_track(size * np.array(places), "start"), size * np.array(places))
    for places, carrier, amount in (((-0.25, 0.2), 0, 0.05), ((0.0, 0.425), 1, 0.025), ((0.0, 0.0), 1, 0.1)):
        with pytest.raises(rp.errors.InfeasiblePlanError) as caught:
            limits.on_track(size * np.array(places), "start")
        assert caught.value.details["carrier"] == robot.carriers[carrier]
        assert caught.value.details["amount"] == pytest.approx(amount * size)
