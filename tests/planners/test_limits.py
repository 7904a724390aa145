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
from redundancy_pin.planners.check import SAME, SAME_PEAK
from redundancy_pin.planners.intersample_check import BALANCE_TOLERANCE
from redundancy_pin.planners.limits import (
    BINDING,
    EXCEEDING,
    LIMIT_TOLERANCE,
    QUANTITIES,
    LimitedQuantity,
    LimitEvent,
    Quantity,
    ResolvedLimits,
    limit_events,
    motion_quantities,
    range_quantities,
)
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import CarrierLimits
from redundancy_pin.robot.joint_ranges import joint_ranges
from redundancy_pin.status import ResultStatus
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


def by_a_loop(rows: list[LimitedQuantity]) -> tuple[set, set]:
    """Broken and touched limits, one sample after the other."""
    broken, touched = set(), set()
    for row in rows:
        for i, joint in enumerate(row.joints):
            low, high = float(row.lower[i]), float(row.upper[i])
            for edge, sign in ((high, 1.0), (low, -1.0)):
                if not np.isfinite(edge):
                    continue
                values = [x if np.isfinite(x) else 0.0 for x in row.values[:, i]]
                both = np.isfinite(low) and np.isfinite(high)
                size = max(abs(edge), (high - low) / 2.0 if both else 0.0)
                excess = [sign * (x - edge) for x in values]
                over = [x > row.exceeding * size for x in excess]
                near = [x > -row.touching * size and not far for x, far in zip(excess, over, strict=True)]
                for into, flags in ((broken, over), (touched, near)):
                    for run in stretches(row.t, flags):
                        worst = max(run, key=lambda k: excess[k])
                        times = row.t[run[0]], row.t[run[-1]], row.t[worst]
                        into.add(LimitEvent(joint, row.name, *times, values[worst], edge, max(excess[worst], 0.0)))
    return broken, touched


def resolved(carriers: list[CarrierLimits]) -> ResolvedLimits:
    """Return the limits of carriers c0, c1, ... alone."""
    names = tuple(f"c{i}" for i in range(len(carriers)))
    track = np.array([(one.lower, one.upper) for one in carriers])
    rates = (np.array([getattr(one, name) for one in carriers]) for name in ("speed", "acceleration", "force"))
    none = np.full(len(carriers), np.inf)
    return ResolvedLimits(names, track, *rates, jerk=none, effort=none, actuator_speed=none)


@pytest.mark.parametrize("size", [1.0, 2.0**20, 2.0**-20])
@pytest.mark.parametrize(("most", "nearest"), [(EXCEEDING, BINDING), (LIMIT_TOLERANCE, LIMIT_TOLERANCE)])
def test_events_are_those_of_a_loop_over_the_samples(size: float, most: float, nearest: float) -> None:
    """Of carriers with all limits, with some and with one; values in runs of four, some of them unknown."""
    rng = np.random.default_rng(7)
    t, names = np.sort(rng.uniform(0.0, 9.0, 400)), ("a", "b", "c")
    ends = {"track": [(-0.3, 0.5), (0.2, 0.9), (-np.inf, np.inf)], "speed": [(-2.0, 2.0), (-3.0, 3.0), (-5.0, 5.0)]}
    beside = [-3.0 * nearest, -1.5 * nearest, -0.7 * nearest, 0.0, 0.7 * most, 1.5 * most, 3.0 * most, 0.4]
    rows = []
    for quantity, sides in ends.items():
        lower, upper = size * np.array(sides).T
        at = np.where(np.isfinite(lower), np.where(rng.random((400, 3)) < 0.5, lower, upper), size)
        half = np.where(np.isfinite(lower), np.maximum(np.abs(at), (upper - lower) / 2.0), size)
        step = np.repeat(rng.choice(beside, (100, 3)), 4, axis=0)
        values = at + np.where(at == lower, -1.0, 1.0) * step * half
        values[rng.integers(400, size=5), 1] = np.nan
        rows.append(LimitedQuantity(quantity, names, t, values, lower, upper, most, nearest))
    violated, binding = limit_events(rows)
    broken, touched = by_a_loop(rows)
    assert len(broken) > 100
    assert len(touched) > 100
    assert set(violated) == broken
    assert set(binding) == touched
    for events in (violated, binding):
        starts = [event.start for event in events]
        assert starts == sorted(starts)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_quantity_with_one_limit_is_judged_there(sign: float) -> None:
    t, values = np.arange(4.0), sign * np.array([[0.0], [0.5], [0.7], [0.1]])
    ends = sorted([np.array([sign * 0.4]), np.array([-sign * np.inf])])
    (event,), _ = limit_events([LimitedQuantity("track", ("c",), t, values, *ends)])
    assert (event.limit, event.start, event.end, event.worst) == (sign * 0.4, 1.0, 2.0, 2.0)
    assert event.amount == pytest.approx(0.3)


def test_a_track_with_one_end_is_judged_there() -> None:
    edge = -0.05
    limits = rp.Limits(track=(edge, np.inf), speed=np.inf, acceleration=np.inf)
    plan = rp.plan_switch_off("2rpr", reference.circle(), threshold=5.0, limits=limits)
    farthest = plan.carriers.s.min()
    events = [event for event in plan.limits.violated if event.quantity == "track"]
    assert plan.status is ResultStatus.LIMIT_VIOLATED
    assert {event.limit for event in events} == {edge}
    assert max(event.amount for event in events) == pytest.approx(abs(farthest - edge), rel=1e-6)


def test_each_joint_may_have_times_of_its_own() -> None:
    t, values = np.array([[0.0, 0.5], [1.0, 1.5]]), np.array([[1.0, -3.0], [2.5, 0.0]])
    violated, touched = limit_events(
        [LimitedQuantity("effort", ("a", "b"), t, values, -np.full(2, 2.0), np.full(2, 2.0))]
    )
    assert [(one.joint, one.worst, one.limit, one.amount) for one in violated] == [
        ("b", 0.5, -2.0, 1.0),
        ("a", 1.0, 2.0, 0.5),
    ]
    assert touched == ()


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
        events, _ = limit_events(motion_quantities(resolved(limits), position))
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
            assert np.interp(worst.worst, dense, value) == pytest.approx(worst.value, rel=2e-3)
            assert worst.limit == pytest.approx(np.sign(worst.value) * part * most, rel=1e-9)


def test_an_acceleration_that_is_largest_before_a_jump_counts() -> None:
    """s̈ rises from 0 to 3 m/s² within a second, and is 0 from then on."""
    cubic = np.zeros((4, 2, 1))
    cubic[0, 0], cubic[2:, 1, 0] = 0.5, [1.5, 0.5]
    position = PiecewisePolynomial(np.array([0.0, 1.0, 2.0]), cubic)
    own = [CarrierLimits(-9.0, 9.0, 9.0, 2.5, np.inf)]
    (event,), _ = limit_events(motion_quantities(resolved(own), position))
    assert (event.quantity, event.worst, event.limit) == ("acceleration", 1.0, 2.5)
    assert event.amount == pytest.approx(0.5)


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
        violated, _ = limit_events(range_quantities(robot, t, q))
        events = {event.limit: event for event in violated if event.joint == joint.name}
        over, under = events[joint.upper], events[joint.lower]
        assert (over.start, over.end, over.worst) == (2.0, 3.0, 3.0)
        assert over.amount == pytest.approx(0.5)
        assert over.value == pytest.approx(joint.upper + 0.5)
        assert (under.start, under.end, under.worst) == (5.0, 5.0, 5.0)
        assert under.amount == pytest.approx(0.125)


@cache
def planned() -> Plan:
    dynamics = rp.VirtualWork(zoo.robot_of("3rrr", carrier_mass=3.0))
    return rp.plan_whole_trajectory(dynamics, reference.corner(), mesh=rp.Mesh(dt=0.05, refinements=0))


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


@pytest.mark.parametrize("name", ["track", "speed", "acceleration"])
def test_a_plan_on_its_limit_is_within_it_and_one_beside_it_is_not(name):
    """The largest of each quantity as a limit, a little wider and a little narrower."""
    plan = planned()
    robot = zoo.robot_of("3rrr", carrier_mass=3.0)
    position = plan.functions.carriers.derivative(["track", "speed", "acceleration"].index(name))
    most = float(np.abs(position.ranges()).max(axis=(0, 1))[0])
    for factor, broken in ((1.0 + 1e-8, False), (1.0 - 1e-8, True)):
        edge = most * factor
        change = {"lower": -edge, "upper": edge} if name == "track" else {name: edge}
        limits = (
            CarrierLimits(
                **{"lower": -9.0, "upper": 9.0, "speed": np.inf, "acceleration": np.inf, "force": np.inf} | change
            ),
        )
        limits += tuple(CarrierLimits(-9.0, 9.0, np.inf, np.inf, np.inf) for _ in range(2))
        own = Limits().resolved(replace(robot, carrier_limits=limits))
        violated, touched = limit_events(motion_quantities(own, plan.functions.carriers))
        assert bool(violated) == broken
        assert all(event.joint == robot.carriers[0] for event in (*violated, *touched))
        assert touched or broken
        if broken:
            worst = max(violated, key=lambda event: event.amount)
            assert worst.amount == pytest.approx(1e-8 * most, rel=1e-3)
    assert plan.status is ResultStatus.OK


@pytest.mark.parametrize("size", [1.0, 2.0**20])
def test_places_are_on_a_track_up_to_its_ends(size):
    robot = zoo.robot_of("2rpr")
    limits = Limits(track=[(-0.2 * size, 0.3 * size), (0.1 * size, 0.4 * size)]).resolved(robot)
    for places in ((-0.2, 0.1), (0.3, 0.4)):
        np.testing.assert_array_equal(limits.on_track(size * np.array(places), "start"), size * np.array(places))
    for places, carrier, amount in (((-0.25, 0.2), 0, 0.05), ((0.0, 0.425), 1, 0.025), ((0.0, 0.0), 1, 0.1)):
        with pytest.raises(rp.errors.InfeasiblePlanError) as caught:
            limits.on_track(size * np.array(places), "start")
        assert caught.value.details["joint"] == robot.carriers[carrier]
        assert caught.value.details["amount"] == pytest.approx(amount * size)


@pytest.mark.parametrize(
    ("name", "formula", "message"),
    [
        ("power", None, "gives an array of shape"),
        ("power", lambda q: (q.tau * q.actuated_rate)[:, :1], "gives an array of shape"),
        ("power", lambda q: q.no_such_quantity, "fails"),
        ("speed", lambda q: q.tau * q.actuated_rate, "has the name of another one"),
    ],
)
def test_a_quantity_of_a_user_that_cannot_be_limited_is_refused(monkeypatch, name, formula, message):
    monkeypatch.setitem(QUANTITIES, "power", Quantity(name, "actuated", lambda turns: "W", formula))
    dynamics = rp.CompiledDynamics(zoo.robot_of("2rpr", end_effector_mass=0.5, cylinder_mass=0.3))
    for plan in (rp.plan_whole_trajectory, rp.plan_time_optimal):
        with pytest.raises(rp.errors.InputError, match=message):
            plan(dynamics, rp.trajectory.reference.circle(speed=0.5), limits=Limits(further={"power": 5.0}))
