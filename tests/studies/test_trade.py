"""Fronts: bounds are kept, ends are what each quantity alone leads to, and points that others beat are marked."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.studies import trade
from redundancy_pin.studies.case import Case, options
from redundancy_pin.studies.trade import TradeOff, trade_off

CASE = Case(
    "corner",
    "3rrr",
    "corner",
    options(radius=0.025, speed=0.2, ramp_time=0.4),
    "whole_trajectory",
    options(acceleration=20.0, speed=5.0, refinements=0),
    dt=0.03,
)


@cache
def front() -> TradeOff:
    return trade_off(CASE, "carrier_force", "effort", points=3)


def test_a_front_runs_from_one_optimum_to_the_other() -> None:
    points = front().points
    assert [point["dominated"] for point in points] == [False] * 3
    assert all(point["x"] <= point["bound"] * (1.0 + 1e-7) for point in points)
    assert np.all(np.diff([point["x"] for point in points]) > 0.0)
    assert np.all(np.diff([point["y"] for point in points]) < 0.0)
    alone = CASE.with_options(objective="effort").plan()
    assert points[-1]["y"] == pytest.approx(float(alone.diagnostics["objective"]["effort"]), rel=1e-4)  # type: ignore[index]
    assert points[-1]["energy"] == pytest.approx(alone.main_energy + alone.carrier_energy, rel=1e-2)


def test_what_a_point_costs_beside() -> None:
    """Force on the base: that of all momenta's rates, by differences of positions of the centre of mass."""
    case = replace(CASE.with_options(objective="effort"), dt=2e-3)
    plan = case.plan()
    record = trade.trade_record(case, plan, "time", "effort", 1.0, "virtual-work")
    import pinocchio as pin

    from redundancy_pin import inverse_kinematics

    robot = case.load_robot()
    lifted = inverse_kinematics(robot, plan.motion)
    q = np.array(lifted.q)
    q[:, robot.carrier_position] = plan.carriers.s
    data = robot.model.createData()
    mass = pin.computeTotalMass(robot.model)
    t, first = np.unique(plan.t, return_index=True)
    centre = np.array([pin.centerOfMass(robot.model, data, row) for row in q[first]])
    force = mass * np.gradient(np.gradient(centre, t, axis=0), t, axis=0)
    largest = float(np.linalg.norm(force[5:-5], axis=1).max())
    assert record["base_force"] == pytest.approx(largest, rel=0.03)
    assert record["stroke"] == pytest.approx(float(np.ptp(plan.carriers.s, axis=0).max()))
    assert record["duration"] == pytest.approx(case.trajectory().duration)


def test_shorter_tracks_and_slower_motions() -> None:
    tracks = trade_off(CASE, "track", "effort", points=2, between=(0.05, 1.0))
    assert [point["x"] for point in tracks.points] == [pytest.approx(point["stroke"]) for point in tracks.points]
    assert tracks.points[0]["x"] <= 0.1 + 1e-9
    assert tracks.points[0]["y"] > tracks.points[1]["y"]
    slower = trade_off(CASE, "time", "effort", points=2, between=(1.0, 2.0))
    assert slower.points[0]["x"] == pytest.approx(CASE.trajectory().duration)
    assert slower.points[1]["y"] < 0.3 * slower.points[0]["y"]


@pytest.mark.long
def test_points_without_a_plan_say_why() -> None:
    bounded = trade_off(CASE, "carrier_force", "effort", points=2, between=(0.6, 100.0))
    assert "carrier_force at most" in bounded.points[0]["reason"]
    assert bounded.points[0]["status"] == "infeasible"
    assert len(bounded.front) == 1
    with pytest.raises(InfeasiblePlanError):
        trade_off(CASE, "carrier_force", "effort", points=2, between=(0.5, 0.6))


@pytest.mark.long
def test_a_front_begins_where_there_is_something() -> None:
    """The least acceleration is that of parked carriers: none but for rounding, of which no bound is made."""
    bounded = trade_off(CASE, "carrier_acceleration", "effort", points=2)
    first, last = (point["bound"] for point in bounded.points)
    assert first == pytest.approx(1e-3 * last, rel=1e-2)
    assert bounded.points[0]["y"] > bounded.points[1]["y"]


def test_beaten_points_are_marked() -> None:
    rows = [{"x": 1.0, "y": 5.0}, {"x": 2.0, "y": 6.0}, {"x": 3.0, "y": 4.0}]
    judged = trade.judge_front([{"reason": None, **row} for row in rows])
    assert [row["dominated"] for row in judged] == [False, True, False]


def test_the_picture_has_the_front() -> None:
    pytest.importorskip("matplotlib")
    (axes,) = front().draw().axes
    np.testing.assert_allclose(axes.lines[0].get_xydata(), [[point["x"], point["y"]] for point in front().front])
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("carrier_force", "effort")


@pytest.mark.parametrize(
    ("x", "y", "more", "message"),
    [
        ("effort", "effort", {}, "Both"),
        ("efort", "effort", {}, "efort"),
        ("effort", "tracking", {}, "tracking"),
        ("effort", "peak", {"points": 1}, "points"),
        ("effort", "peak", {"between": (2.0, 1.0)}, "bounds"),
    ],
)
def test_bad_input_is_named(x: str, y: str, more: dict[str, object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        trade_off(CASE, x, y, **more)  # type: ignore[arg-type]


def test_a_motion_without_a_speed_keeps_its_time() -> None:
    with pytest.raises(InputError, match="no one speed"):
        trade_off(replace(CASE, path_options=options(radius=0.025)), "time", "effort", points=2)


@pytest.mark.parametrize(
    ("x", "y", "ends"),
    [("effort", "carrier_acceleration", (None, 0.0)), ("peak", "effort", (0.0, 0.0)), ("track", "effort", (None, 0.0))],
)
def test_fronts_that_end_in_zero(x: str, y: str, ends: tuple[float | None, float]) -> None:
    """Massless, with a free end, the 2-RPR can move without any effort, and its carriers can stand still."""
    line = options(points=[[0.1, 0.45], [0.4, 0.25]], speed=0.3, ramp_time=0.3)
    wide = options(refinements=0, end="free", acceleration=50.0, speed=10.0, track=(-1.0, 1.0))
    result = trade_off(Case("line", "2rpr", "points", line, "whole_trajectory", wide, dt=0.05), x, y, points=2)
    assert not any(point["dominated"] for point in result.points)
    assert result.points[-1]["y"] == ends[1]
    if ends[0] is not None:
        assert {(point["x"], point["y"]) for point in result.points} == {ends}
    result.draw()
