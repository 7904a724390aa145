"""Which bounds of a stepwise plan are said to be met, from where on, and what rounding they are forgiven."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from redundancy_pin import VirtualWork, load_robot, plan_stepwise
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.planners.limits import Limits
from redundancy_pin.planners.stepwise.course import PHASES, Course, brake, checked_settings
from redundancy_pin.planners.stepwise.optimiser import AccelerationBox, OptimisedSteps, StepProblems
from redundancy_pin.planners.stepwise.planner import diagnostics
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.trajectory import reference

LIMITS = CarrierLimits(lower=-0.5, upper=0.1, speed=0.4, acceleration=3.0, force=math.inf)
ENDLESS = replace(LIMITS, lower=-math.inf, upper=math.inf)
HALF_ENDLESS = replace(LIMITS, lower=-math.inf)

MET = 1e-9
"""Relative to the limit, or to the length of the track (0.6 m here, a metre where it does not end)."""

START, STEP = 5.0, 0.1
"""s, of the steps made up here."""


def box_of(*limits: CarrierLimits) -> AccelerationBox:
    return AccelerationBox(tuple(f"carrier_{j + 1}" for j in range(len(limits))), limits, True, math.inf)


def said(limits: CarrierLimits, s: Any, sd: Any, sdd: Any, side: str, met: Any = True) -> list[dict[str, Any]]:
    """What is reported of one carrier's steps; whether the box bounds each on a side."""
    s, sd, sdd = (np.array(part, dtype=float).reshape(-1, 1) for part in (s, sd, sdd))
    count, sign = len(s), 1.0 if side == "upper" else -1.0
    bound = np.where(np.broadcast_to(met, count)[:, None], sign * sdd, np.inf)
    lower, upper = (-np.full_like(sdd, np.inf), bound) if side == "upper" else (-bound, np.full_like(sdd, np.inf))
    stretch = OptimisedSteps(s, sd, sdd, lower, upper, np.ones(count, dtype=int))
    t = START + STEP * np.arange(count + 3)
    still = np.zeros((len(t), 1))
    course = Course(t, still, still, still, np.ones(len(t), dtype=int), ((2, stretch),), (), (), len(t) - 1)
    maps = np.zeros((len(t) - 1, 2, 6))
    maps[:, 0, 0] = 1.0  # r = u
    one = np.ones(len(t) - 1)
    problems = StepProblems(t, STEP * one, maps, np.zeros((len(one), 1, 1)), one, 0.0 * one, 1e-9)
    events: Any = diagnostics(problems, course, box_of(limits))["bounds"]
    return list(events)


@pytest.mark.parametrize("side", ["upper", "lower"])
@pytest.mark.parametrize(
    ("quantity", "short", "bound"),
    [
        ("sd", 0.4 * 0.5 * MET, "speed"),
        ("sd", 0.4 * 1.5 * MET, "stop"),
        ("sdd", 3.0 * 0.5 * MET, "acceleration"),
        ("sdd", 3.0 * 1.5 * MET, "stop"),
        ("s", 0.6 * 0.5 * MET, "track"),
        ("s", 0.6 * 1.5 * MET, "stop"),
    ],
)
def test_a_bound_is_named_up_to_rounding_and_else_the_carrier_is_kept_able_to_stop(
    side: str, quantity: str, short: float, bound: str
) -> None:
    sign = 1.0 if side == "upper" else -1.0
    most = {"s": LIMITS.upper if side == "upper" else -LIMITS.lower, "sd": LIMITS.speed, "sdd": LIMITS.acceleration}
    motion = {"s": 0.0, "sd": 0.05, "sdd": 0.5, quantity: most[quantity] - short}
    (event,) = said(LIMITS, **{name: sign * value for name, value in motion.items()}, side=side)
    assert (event["bound"], event["side"]) == (bound, side)


def test_an_event_lasts_while_the_box_binds() -> None:
    """Steps that end at START + 3, 4, ... times STEP; of the second run the last one binds at its speed too."""
    met = [True, True, False, True, True, True]
    events = said(LIMITS, np.zeros(6), [0.1, 0.1, 0.1, 0.1, 0.1, 0.4], np.full(6, 3.0), "upper", met)
    at = [(event["bound"], *(round((event[name] - START) / STEP, 6) for name in ("start", "end"))) for event in events]
    assert at == [("acceleration", 3.0, 4.0), ("acceleration", 6.0, 8.0), ("speed", 8.0, 8.0)]


@pytest.mark.parametrize(
    ("limits", "side", "short", "bound"),
    [
        (ENDLESS, "upper", 0.0, "speed"),
        (ENDLESS, "lower", 0.0, "speed"),
        (HALF_ENDLESS, "upper", 0.05, "speed"),
        (HALF_ENDLESS, "lower", 0.05, "speed"),
        (HALF_ENDLESS, "upper", 0.5 * MET, "track"),
        (HALF_ENDLESS, "upper", 1.5 * MET, "speed"),
    ],
)
def test_the_end_of_a_track_that_does_not_end_is_not_met(
    limits: CarrierLimits, side: str, short: float, bound: str
) -> None:
    sign = 1.0 if side == "upper" else -1.0
    events = said(limits, LIMITS.upper - short, sign * LIMITS.speed, sign * 0.5, side)
    assert {event["bound"] for event in events} == {"speed", bound}


def robot() -> Robot:
    return load_robot("3rrr", working_mode=(1, 1, 1))


def test_a_plan_on_endless_tracks_meets_no_end_of_them() -> None:
    """As on tracks that are long enough, of which it is the plan."""
    corner = reference.corner(radius=0.013).sample(0.02)
    endless, long = (
        plan_stepwise(VirtualWork(robot()), corner, speed=0.4, acceleration=3.0, track=(-length, length))
        for length in (math.inf, 50.0)
    )
    assert endless.diagnostics["bounds"] == long.diagnostics["bounds"]
    assert {event["bound"] for event in endless.diagnostics["bounds"]} == {"speed", "acceleration"}
    np.testing.assert_allclose(endless.carriers.s, long.carriers.s, atol=1e-9)


def braked(limits: CarrierLimits, room: float, speed: float) -> Course:
    """A course that ends so far from the upper end of the track, braked in steps of STEP; the platform rests."""
    shipped = robot()
    options = {
        "active": "always", "stop": "after", "anticipate": True, "lam": 0.0, "between": 0, "objective": {"effort": 1.0},
        "base_point": None, "start": 0.0, "datum": 0.0, "return_time": 0.4, "brake_time": 0.5, "least_margin": 1e-3,
    }  # fmt: skip
    settings = checked_settings(shipped, Limits(), **options)
    t, zero = START + STEP * np.arange(2.0), np.zeros((2, 1))
    s, sd = zero + limits.upper - room, zero + speed
    course = Course(t, s, sd, zero, np.ones(2, dtype=int), (), (), (), 1)
    return brake(settings, box_of(limits), course, STEP, platform_rests=True)


@pytest.mark.parametrize("limits", [LIMITS, HALF_ENDLESS])
def test_a_carrier_that_cannot_be_stopped_on_its_track_says_by_how_much_and_when(limits: CarrierLimits) -> None:
    """At 0.3 m/s a deceleration of 3 m/s² takes one step of 0.1 s, in which backward differences do not move it.

    At 0.6 m/s it takes two, and the first leaves 0.3 m/s, which move it by 0.03 m.
    """
    course = braked(limits, 0.001, 0.3)
    np.testing.assert_allclose(course.s[-1], limits.upper - 0.001, atol=1e-12)
    with pytest.raises(InfeasiblePlanError, match="cannot be stopped") as caught:
        braked(limits, 0.001, 0.6)
    details = caught.value.details
    assert (details["constraint"], details["carrier"]) == ("track", "carrier_1")
    assert details["amount"] == pytest.approx(0.029, rel=1e-9)
    assert details["time"] == pytest.approx(START + 2.0 * STEP)
    assert "from 0.6 m/s at t = 5.1 s it is 0.029 m beyond the end of its track at t = 5.2 s" in str(caught.value)


@pytest.mark.parametrize(
    ("room", "speed", "lasts"),
    [
        (0.05, 0.4, 0.25),  # 2 room / speed
        (0.5, 0.4, 0.5),  # as wanted
        (0.5, 0.0, math.nan),
    ],
)
def test_braking_lasts_as_wanted_or_as_the_track_and_the_deceleration_ask(
    room: float, speed: float, lasts: float
) -> None:
    limits = replace(LIMITS, lower=-2.0, upper=1.0)
    course = braked(limits, room, speed)
    begin, end = course.braking
    np.testing.assert_allclose([begin, end - begin], [START + STEP, lasts] if speed else [math.nan, math.nan])
    steps = math.ceil(lasts / STEP - 1e-9) if speed else 0
    assert len(course.t) == 2 + steps
    np.testing.assert_allclose(np.diff(course.t), STEP)
    # speeds fall evenly, and are backward differences of the positions; so are accelerations of the speeds
    falls = speed * np.clip(1.0 - STEP * np.arange(1, steps + 1) / (lasts or 1.0), 0.0, None)
    np.testing.assert_allclose(course.sd[2:, 0], falls, atol=1e-12)
    np.testing.assert_allclose(np.diff(course.s[1:, 0]), STEP * falls, atol=1e-12)
    np.testing.assert_allclose(course.sdd[2:, 0], np.diff(course.sd[1:, 0]) / STEP, atol=1e-9)
    assert [PHASES[i] for i in course.phase[2:]] == ["brake"] * steps
