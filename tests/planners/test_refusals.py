"""What planners refuse: the call, the error, what its message names, and its details; and that the remedies work."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError, InputError, RedundancyPinError, UnsupportedRobotError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.trajectory import Line, SpeedProfile, Trajectory, reference

NAN, INF = np.nan, np.inf
FREE = rp.Limits(effort=INF, actuator_speed=INF)
CIRCLE, CORNER = reference.circle(), reference.corner()
BARE = rp.VirtualWork(zoo.robot_of("3rrr", carriers=False))


@cache
def two(**arguments: Any) -> rp.VirtualWork:
    return rp.VirtualWork(zoo.robot_of("2rpr", **arguments))


@cache
def three(**arguments: Any) -> rp.VirtualWork:
    return rp.VirtualWork(zoo.robot_of("3rrr", **arguments))


@cache
def samples(count: int | None = None) -> rp.PlatformMotion:
    """Return the first samples of the corner, one-sided."""
    return CORNER.sample(0.01, two_sided=False)[:count]


def along(start: Any, end: Any) -> Trajectory:
    path = Line(start, end)
    return Trajectory(path, SpeedProfile(path.length, 0.3, 0.2))


SETTINGS: list[tuple[str, Callable[[], object]]] = [
    ("lam", lambda: rp.plan_stepwise(three(), samples(), objective=rp.Objective(lam=1.1))),
    ("lam", lambda: rp.plan_stepwise(three(), samples(), objective=rp.Objective(lam="half"))),  # type: ignore[arg-type]
    ("no baseline", lambda: rp.plan_stepwise(three(), samples(), objective=rp.Objective(lam=0.5))),
    (
        "baseline",
        lambda: rp.plan_stepwise(three(), samples(), objective=rp.Objective(lam=0.5, baseline=np.zeros((3, 3)))),
    ),
    ("baseline", lambda: rp.plan_stepwise(three(), samples(), objective=rp.Objective(lam=0.5, baseline=two()))),
    ("active", lambda: rp.plan_stepwise(three(), samples(), active="never")),  # type: ignore[arg-type]
    ("anticipate", lambda: rp.plan_stepwise(three(), samples(), anticipate="no")),  # type: ignore[arg-type]
    ("stop", lambda: rp.plan_stepwise(three(), samples(), stop="never")),  # type: ignore[arg-type]
    ("return_time", lambda: rp.plan_stepwise(three(), samples(), return_time="quick")),  # type: ignore[arg-type]
    ("brake_time", lambda: rp.plan_stepwise(three(), samples(), brake_time=-1.0)),
    ("least_margin", lambda: rp.plan_stepwise(three(), samples(), least_margin=0.0)),
    ("start", lambda: rp.plan_stepwise(three(), samples(), start=(0.0, 0.0))),
    ("datum", lambda: rp.plan_stepwise(three(), samples(), datum="middle")),  # type: ignore[arg-type]
    ("speed", lambda: rp.plan_stepwise(three(), samples(), limits=rp.Limits(speed=0.0))),
    ("speed", lambda: rp.plan_stepwise(three(), samples(), limits=rp.Limits(speed=(1.0, 1.0)))),
    ("acceleration", lambda: rp.plan_stepwise(three(), samples(), limits=rp.Limits(acceleration=-7.0))),
    ("acceleration", lambda: rp.plan_stepwise(three(), samples(), limits=rp.Limits(acceleration=INF), stop="within")),
    ("track", lambda: rp.plan_stepwise(three(), samples(), limits=rp.Limits(track=(1.0, -1.0)))),
    ("1 samples, too few", lambda: rp.plan_stepwise(three(), samples(1))),
    ("Trajectory was given", lambda: rp.plan_stepwise(CIRCLE, two())),  # type: ignore[arg-type]
    ("for the motion", lambda: rp.plan_stepwise(two(), "circle")),  # type: ignore[arg-type]
    ("for the motion", lambda: rp.plan_switch_off(two(), np.zeros((3, 2)))),  # type: ignore[arg-type]
    ("threshold", lambda: rp.plan_switch_off(two(), CIRCLE, threshold=1.0)),
    ("threshold", lambda: rp.plan_switch_off(two(), CIRCLE, threshold=1e7)),
    ("threshold", lambda: rp.plan_switch_off(two(), CIRCLE, measure="margin", threshold=0.0)),
    ("measure", lambda: rp.plan_switch_off(two(), CIRCLE, measure="angle")),  # type: ignore[arg-type]
    ("ramp_down", lambda: rp.plan_switch_off(two(), CIRCLE, ramp_down=0.0)),
    ("return_time", lambda: rp.plan_switch_off(two(), CIRCLE, return_time=-0.1)),
    ("return_time", lambda: rp.plan_switch_off(two(), CIRCLE, return_time="soon")),  # type: ignore[arg-type]
    ("datum", lambda: rp.plan_switch_off(two(), CIRCLE, datum=[0.0, 0.0, 0.0])),
    ("datum", lambda: rp.plan_switch_off(two(), CIRCLE, datum=[[0.0], [0.0, 1.0]])),  # type: ignore[arg-type]
    ("datum.*finite", lambda: rp.plan_switch_off(two(), CIRCLE, datum=INF)),
    ("dt", lambda: rp.plan_switch_off(two(), CIRCLE, mesh=rp.Mesh(dt=0.0))),
    ("single instant", lambda: rp.plan_switch_off(two(), CIRCLE.sample(1e-2)[:1])),
    ("speed", lambda: rp.plan_whole_trajectory(two(), CIRCLE, objective="speed")),
    ("objective", lambda: rp.plan_whole_trajectory(two(), CIRCLE, objective=None)),  # type: ignore[arg-type]
    ("weight", lambda: rp.plan_whole_trajectory(two(), CIRCLE, objective={"effort": -1.0})),
    ("weight is zero", lambda: rp.plan_whole_trajectory(two(), CIRCLE, objective={"effort": 0.0})),
    ("lam", lambda: rp.plan_whole_trajectory(two(), CIRCLE, objective=rp.Objective(lam=2.0))),
    ("no baseline", lambda: rp.plan_whole_trajectory(two(), CIRCLE, objective=rp.Objective("tracking", lam=0.5))),
    ("calm", lambda: rp.plan_whole_trajectory(two(), CIRCLE, objective=rp.Objective(calm=-0.01))),
    ("end", lambda: rp.plan_whole_trajectory(two(), CIRCLE, end="somewhere")),  # type: ignore[arg-type]
    ("dt", lambda: rp.plan_whole_trajectory(two(), CIRCLE, mesh=rp.Mesh(dt=0.0))),
    (r"2\.68e\+06 nodes", lambda: rp.plan_whole_trajectory(two(), CIRCLE, mesh=rp.Mesh(dt=1e-6))),
    ("seconds", lambda: rp.plan_whole_trajectory(two(), CIRCLE, solver=rp.Solver(seconds=-1.0))),
    ("starts", lambda: rp.plan_whole_trajectory(two(), CIRCLE, solver=rp.Solver(starts=NAN))),  # type: ignore[arg-type]
    ("refinements", lambda: rp.plan_whole_trajectory(two(), CIRCLE, mesh=rp.Mesh(refinements=-1))),
    ("speed", lambda: rp.plan_whole_trajectory(two(), CIRCLE, limits=rp.Limits(speed=-1.0))),
    ("effort", lambda: rp.plan_whole_trajectory(two(), CIRCLE, limits=rp.Limits(effort=(1.0, 2.0, 3.0)))),
    ("jerk", lambda: rp.plan_whole_trajectory(two(), CIRCLE, limits=rp.Limits(jerk=0.0))),
    ("start_speed", lambda: rp.plan_whole_trajectory(two(), CIRCLE, start_speed=NAN)),
    (
        "base_point",
        lambda: rp.plan_whole_trajectory(
            two(), CIRCLE, objective=rp.Objective("base_force", base_point=(0.0, NAN, 0.0))
        ),
    ),
    ("at_most", lambda: rp.plan_whole_trajectory(two(), CIRCLE, at_most={"efort": 1.0})),
    ("at_most", lambda: rp.plan_whole_trajectory(two(), CIRCLE, at_most={"effort": NAN})),
    ("objectives to bounds", lambda: rp.plan_whole_trajectory(two(), CIRCLE, at_most="effort")),  # type: ignore[arg-type]
    ("mesh", lambda: rp.plan_whole_trajectory(two(), CIRCLE, mesh=0.01)),  # type: ignore[arg-type]
    ("limits", lambda: rp.plan_whole_trajectory(two(), CIRCLE, limits={"speed": 1.0})),  # type: ignore[arg-type]
    ("effort", lambda: rp.plan_time_optimal(BARE, CORNER.path, limits=FREE)),
    ("begin", lambda: rp.plan_time_optimal(BARE, CORNER.path, limits=rp.Limits(effort=3.0), begin="anyhow")),  # type: ignore[arg-type]
    ("closed", lambda: rp.plan_time_optimal(BARE, CORNER.path, limits=rp.Limits(effort=3.0), lap=True)),
    ("effort", lambda: rp.plan_time_optimal(BARE, CORNER.path, limits=rp.Limits(effort=-1.0))),
    ("steps", lambda: rp.plan_time_optimal(BARE, CORNER.path, limits=rp.Limits(effort=3.0), mesh=rp.Mesh(steps=2))),
    (
        "actuator_speed",
        lambda: rp.plan_time_optimal(BARE, CORNER.path, limits=rp.Limits(effort=3.0, actuator_speed=0.0)),
    ),
    ("path", lambda: rp.plan_time_optimal(BARE, samples(), limits=rp.Limits(effort=1.0))),  # type: ignore[arg-type]
]
"""What a message names, and a call whose setting, dynamics or motion is none."""


@pytest.mark.parametrize("number", range(len(SETTINGS)), ids=lambda i: f"{i}-{SETTINGS[i][0]}")
def test_a_setting_out_of_its_domain_is_named(number: int) -> None:
    names, call = SETTINGS[number]
    with pytest.raises(InputError, match=names):
        call()


Row = tuple[str, type[RedundancyPinError], dict[str, Any], Callable[[], object], Callable[[], Plan] | None]

REFUSED: dict[str, Row] = {
    "stepwise: no carriers": (
        "no carriers",
        UnsupportedRobotError,
        {},
        lambda: rp.plan_stepwise(BARE, samples()),
        None,
    ),
    "switch off: no carriers": (
        "carrier",
        UnsupportedRobotError,
        {},
        lambda: rp.plan_switch_off(two(carriers=False), CIRCLE),
        None,
    ),
    "whole: no carriers": (
        "no carriers",
        UnsupportedRobotError,
        {},
        lambda: rp.plan_whole_trajectory(two(carriers=False), CIRCLE),
        None,
    ),
    "stepwise: start off the track": (
        "off its track",
        InfeasiblePlanError,
        {"joint": "carrier_2", "amount": pytest.approx(0.2)},
        lambda: rp.plan_stepwise(three(), samples(), start=(0.0, 1.2, 0.0)),
        None,
    ),
    "switch off: datum off the track": (
        r"puts carrier_2 at .* off its track",
        InfeasiblePlanError,
        {"amount": pytest.approx(0.05)},
        lambda: rp.plan_switch_off(two(), CIRCLE, datum=[0.0, -0.25]),
        None,
    ),
    "stepwise: across a singularity": (
        "type II",
        InfeasiblePlanError,
        {"constraint": "margin", "time": pytest.approx(0.67, abs=0.28)},
        lambda: rp.plan_stepwise(two(), CIRCLE.sample(0.01, two_sided=False)),
        lambda: rp.plan_switch_off(two(), CIRCLE, mesh=rp.Mesh(dt=0.01)),
    ),
    "stepwise: across a spatial one": (  # half way, at 90 degrees of yaw
        "plan_whole_trajectory",
        InfeasiblePlanError,
        {"time": pytest.approx(0.5)},
        lambda: rp.plan_stepwise(
            rp.RneaDynamics(zoo.robot_of("gough", carriers=True)),
            zoo.gough_crossing(),
            mesh=rp.Mesh(dt=0.05),
        ),
        None,
    ),
    "stepwise: across one between samples": (  # y = 0 is the line between the two bases: it starts at 0.4 m
        "crosses a type II singularity between",
        InfeasiblePlanError,
        {"time": pytest.approx(2.2, abs=0.5)},
        lambda: rp.plan_stepwise(two(), reference.line(speed=0.2).sample(0.5, two_sided=False)),
        None,
    ),
    "stepwise: margin": (
        "too close",
        InfeasiblePlanError,
        {"constraint": "margin", "margin": pytest.approx(0.45, abs=0.45)},
        lambda: rp.plan_stepwise(three(), samples(), least_margin=0.9),
        lambda: rp.plan_stepwise(three(), samples()),
    ),
    "stepwise: a box is empty": (
        "beyond the end of its track",
        InfeasiblePlanError,
        {"constraint": "track", "time": pytest.approx(0.4, 1.0)},
        lambda: rp.plan_stepwise(three(), samples(), anticipate=False, limits=rp.Limits(track=(-0.1, 0.1))),
        lambda: rp.plan_stepwise(three(), samples(), anticipate=True, limits=rp.Limits(track=(-0.1, 0.1))),
    ),
    "stepwise: no return": (  # it starts at the speed limit with the carriers still accelerating outwards
        "No return",
        InfeasiblePlanError,
        {},
        lambda: rp.plan_stepwise(
            three(), samples(), active="accelerating", return_time="shortest", limits=rp.Limits(track=(-0.16, 0.16))
        ),
        lambda: rp.plan_stepwise(
            three(), samples(), active="accelerating", return_time=0.4, limits=rp.Limits(track=(-0.16, 0.16))
        ),
    ),
    "stepwise: a platform that moves on": (
        "platform moves on",
        InfeasiblePlanError,
        {"constraint": "rest"},
        lambda: rp.plan_stepwise(three(), samples(70)),
        lambda: rp.plan_stepwise(three(), samples(70), stop="within"),
    ),
    "stepwise: an unfinished return": (
        "must be stopped",
        InfeasiblePlanError,
        {"constraint": "rest"},
        lambda: rp.plan_stepwise(three(), samples(50), active="accelerating", return_time=0.5, stop="within"),
        lambda: rp.plan_stepwise(three(), samples(50), active="accelerating", return_time=0.05, stop="within"),
    ),
    "switch off: a window at the start": (
        "motion begins",
        InfeasiblePlanError,
        {"constraint": "ramp_down", "amount": pytest.approx(0.03)},
        lambda: rp.plan_switch_off(two(), along((0.2, 0.02), (0.2, 0.4))),
        None,
    ),
    "switch off: a window at the end": (
        "ends",
        InfeasiblePlanError,
        {"constraint": "window_end", "time": pytest.approx(along((0.2, 0.4), (0.2, 0.02)).duration)},
        lambda: rp.plan_switch_off(two(), along((0.2, 0.4), (0.2, 0.02))),
        None,
    ),
    "switch off: no return on the track": (
        "track",
        InfeasiblePlanError,
        {"joint": "carrier_1"},
        lambda: rp.plan_switch_off(two(), CIRCLE, return_time="shortest"),
        lambda: rp.plan_switch_off(two(), CIRCLE, return_time="shortest", threshold=10.0),
    ),
    "switch off: a runaway": (  # gravity in the plane
        r"Carrier [12] runs away",
        InfeasiblePlanError,
        {"constraint": "carrier_motion"},
        lambda: rp.plan_switch_off(two(gravity=(0.0, -9.81, 0.0)), CIRCLE),
        None,
    ),
    "whole: no time": (
        "time ran out",
        InfeasiblePlanError,
        {"constraint": "seconds"},
        lambda: rp.plan_whole_trajectory(
            two(), CIRCLE, objective="peak", mesh=rp.Mesh(dt=0.05), solver=rp.Solver(seconds=1e-3)
        ),
        None,
    ),
    "least time: weight beyond the efforts": (
        "effort",
        InfeasiblePlanError,
        {"constraint": "effort"},
        lambda: rp.plan_time_optimal(
            rp.RneaDynamics(zoo.robot_of("3rrr", carriers=False, gravity=(0.0, -9.81, 0.0))),
            CORNER.path,
            limits=rp.Limits(effort=3.03),
            mesh=rp.Mesh(steps=6),
        ),
        None,
    ),
    "least time: dry friction": (
        "dry friction and loads that depend on time",
        UnsupportedRobotError,
        {},
        lambda: rp.plan_time_optimal(
            rp.RneaDynamics(zoo.robot_of("3rrr", carriers=False).loaded(rp.JointForces("base_1", friction=1.0))),
            CORNER.path,
            limits=rp.Limits(effort=3.03),
            mesh=rp.Mesh(steps=20),
        ),
        None,
    ),
    "least time: a load that depends on time": (
        "dry friction and loads that depend on time",
        UnsupportedRobotError,
        {},
        lambda: rp.plan_time_optimal(
            rp.RneaDynamics(zoo.robot_of("3rrr", carriers=False).loaded(rp.Wrench("platform", gust))),
            CORNER.path,
            limits=rp.Limits(effort=3.03),
            mesh=rp.Mesh(steps=20),
        ),
        None,
    ),
}
"""What the message says, the error, its details, the call, and one that follows the remedy."""


def gust(t: np.ndarray, x: np.ndarray, xd: np.ndarray) -> np.ndarray:
    return np.outer(np.sin(8.0 * t), np.eye(6)[0])


@pytest.mark.parametrize("name", REFUSED)
def test_what_cannot_be_planned_is_said_with_its_numbers_and_the_remedy_works(name: str) -> None:
    says, kind, details, call, remedied = REFUSED[name]
    with pytest.raises(kind, match=says) as caught:
        call()
    assert caught.value.remedy
    assert caught.value.details.get("amount", 0.0) >= 0.0
    for key, value in details.items():
        assert caught.value.details[key] == value, key
    if remedied is not None:
        assert np.isfinite(remedied().tau).all()


def test_what_is_missing_is_said_exactly() -> None:
    """A ramp down and a return fit up to the room that there is; what is beyond it is the amount."""
    window = rp.plan_switch_off(two(), CIRCLE, mesh=rp.Mesh(dt=5e-3)).diagnostics["windows"][0]
    entry, room = window["entry"], CIRCLE.duration - window["exit"]
    rp.plan_switch_off(two(), CIRCLE, mesh=rp.Mesh(dt=5e-3), ramp_down=entry)
    rp.plan_switch_off(two(), CIRCLE, mesh=rp.Mesh(dt=5e-3), return_time=room - 1e-6)
    with pytest.raises(InfeasiblePlanError, match="ramp down") as caught:
        rp.plan_switch_off(two(), CIRCLE, mesh=rp.Mesh(dt=5e-3), ramp_down=entry + 1e-3)
    assert caught.value.details["amount"] == pytest.approx(1e-3, rel=1e-6)
    with pytest.raises(InfeasiblePlanError, match="return") as caught:
        rp.plan_switch_off(two(), CIRCLE, mesh=rp.Mesh(dt=5e-3), return_time=room + 0.01)
    assert caught.value.details["amount"] == pytest.approx(0.01, rel=1e-6)


@pytest.mark.parametrize("backend", [rp.RneaDynamics, rp.VirtualWork])
def test_carriers_without_mass_are_one_clear_error(backend: Any) -> None:
    for name, motion in (("3rrr", CORNER), ("2rpr", CIRCLE)):
        robot = zoo.robot_of(name, carrier_mass=0.0)
        for plan in (rp.plan_stepwise, rp.plan_switch_off, rp.plan_whole_trajectory):
            with pytest.raises(UnsupportedRobotError, match="no mass") as caught:
                plan(backend(robot), motion, **in_groups(plan, {"dt": 0.02}))
            assert caught.value.details["carriers"] == robot.carriers


def test_a_robot_that_moves_no_mass_has_no_least_time_within_efforts() -> None:
    robot = rp.load_robot("2rpr", carriers=False)
    with pytest.raises(UnsupportedRobotError, match="moves no mass"):
        rp.plan_time_optimal(rp.VirtualWork(robot), CIRCLE.path)
