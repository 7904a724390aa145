"""What is said of limits that have to give way: amounts, limits that would suffice, units and instants."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.planners.whole_trajectory import multistart
from redundancy_pin.planners.whole_trajectory.options import Limits, Mesh, Objective, checked_settings
from redundancy_pin.planners.whole_trajectory.problem import Task, WholeTrajectoryProblem, grid_of, read_coefficients
from redundancy_pin.trajectory import reference
from redundancy_pin.trajectory.continuous_motion import continuous_motion

LIMITS = {"jerk": (900.0, 700.0), "speed": (2.0, 1.5), "acceleration": (9.0, 8.0), "effort": (5.0, 4.0),
         "carrier_force": (30.0, 20.0), "track": [(-0.1, 0.15), (-0.2, 0.05)]}  # fmt: skip


@cache
def problem(end: str = "datum") -> WholeTrajectoryProblem:
    dynamics = rp.VirtualWork(zoo.robot_of("2rpr"))
    source = continuous_motion(reference.circle(0.5, 0.2, 0.05))
    bounds = {"effort": 4.0, "energy": 9.0}
    settings = checked_settings(
        dynamics.robot, Objective("peak"), Limits(**LIMITS), Mesh(0.1, 0), end=end, at_most=bounds
    )
    return read_coefficients(Task(dynamics, source, settings), grid_of(source, [], 0.1))


def solution(of: WholeTrajectoryProblem, fraction: float = 0.0, **changed: Any) -> Any:
    """Scaled values of zero, but for some at a node and carrier, given in units."""
    count, k, m = len(of.grid.t), of.model.k, of.model.W.shape[2]
    values = {name: np.zeros((count, m if name == "tau" else k)) for name in ("s", "sd", "sdd", "tau", "force")}
    for name, (i, j, value) in changed.items():
        values[name][i, j] = value / np.broadcast_to(getattr(of.scales, name), values[name].shape[1:])[j]
    values |= {multistart.slack_name(kind): np.full((1, 1), fraction) for kind in multistart.KINDS}
    return SimpleNamespace(values=values)


def event(of: WholeTrajectoryProblem, kind: str, fraction: float, **changed: Any) -> dict[str, Any]:
    return multistart.elastic_event(of, robot_record(zoo.robot_of("2rpr")), solution(of, fraction, **changed), kind)


@pytest.mark.parametrize(
    ("kind", "changed", "amount", "limit", "unit", "limited"),
    [
        ("track", {"s": (4, 0, 0.18)}, 0.03, 0.18, "m", 0.15),
        ("track", {"s": (4, 1, -0.26)}, 0.06, -0.26, "m", -0.2),
        ("speed", {"sd": (5, 1, -1.8)}, 0.3, 1.8, "m/s", 1.5),
        ("speed", {"sd": (5, 0, 2.5)}, 0.5, 2.5, "m/s", 2.0),
        ("acceleration", {"sdd": (6, 0, -9.9)}, 0.9, 9.9, "m/s²", 9.0),
        ("effort", {"tau": (7, 1, 5.0)}, 1.0, 5.0, "N", 4.0),
        ("force", {"force": (8, 1, -26.0)}, 6.0, 26.0, "N", 20.0),
    ],
)
def test_what_is_exceeded_most_is_said_with_what_would_suffice(
    kind: str, changed: dict[str, tuple[int, int, float]], amount: float, limit: float, unit: str, limited: float
) -> None:
    of = problem()
    ((i, j, _),) = changed.values()
    said = event(of, kind, 0.123456, **changed)
    robot = zoo.robot_of("2rpr")
    names = robot.actuated if kind == "effort" else robot.carriers
    assert said["carrier"] == names[j]
    assert said["unit"] == unit
    assert said["time"] == of.grid.t[i]
    np.testing.assert_allclose([said["amount"], said["limit"]], [amount, limit], rtol=1e-6)
    start = f"the {kind} of {names[j]}, from {limited:g} to {limit:g} {unit} (12.3 %), most at t = {of.grid.t[i]:.6g} s"
    assert said["text"] == start


@pytest.mark.parametrize(("fraction", "percent"), [(0.004567, "0.457"), (0.5, "50"), (1.0, "100"), (23.4567, "2346")])
def test_percentages_have_digits_where_they_are_small_and_no_exponent_where_they_are_large(fraction, percent) -> None:
    assert f"({percent} %)" in event(problem(), "speed", fraction, sd=(5, 1, -1.8))["text"]


def test_a_jerk_is_that_of_a_step() -> None:
    of = problem()
    h = of.grid.h[4]
    said = event(of, "jerk", 0.2, sdd=(5, 0, 1000.0 * h))
    np.testing.assert_allclose([said["amount"], said["limit"]], [100.0, 1000.0], rtol=1e-9)
    assert said["time"] == of.grid.t[4]
    assert said["unit"] == "m/s³"


def test_ends_and_bounds_of_objectives_are_said_in_their_own_way() -> None:
    of = problem()
    said = event(of, "end", 0.2, s=(-1, 1, -0.07))
    assert said["time"] == of.grid.t[-1]
    assert said["text"] == "the carriers end up to 0.07 m from the datum"
    np.testing.assert_allclose(said["amount"], 0.07)
    assert event(problem("rest"), "end", 0.25)["text"] == "the end state by 0.25 of its size"
    said = event(of, "at_most", 0.25, tau=(3, 0, 100.0))
    assert said["objective"] == "effort"
    assert said["time"] == of.grid.t[0]
    np.testing.assert_allclose([said["amount"], said["limit"], said["fraction"]], [1.0, 5.0, 0.25])
    assert said["text"] == "effort at most, from 4 to 5 (25 %)"


@pytest.mark.parametrize(
    ("kind", "changed", "touched"),
    [
        ("track", {"s": (4, 0, 0.15)}, True),
        ("track", {"s": (4, 0, -0.1)}, True),
        ("track", {"s": (4, 0, 0.15 - 1e-4)}, False),
        ("track", {"s": (4, 0, -0.1 + 1e-4)}, False),
        ("speed", {"sd": (4, 1, -1.5)}, True),
        ("speed", {"sd": (4, 1, 1.49)}, False),
        ("jerk", {"sdd": (4, 1, 69.999)}, False),
        ("end", {}, False),
        ("at_most", {}, True),
    ],
)
def test_limits_that_are_touched(kind: str, changed: dict[str, tuple[int, int, float]], touched: bool) -> None:
    """Within a ten thousandth of their range."""
    of = problem()
    if kind == "jerk":
        changed = {"sdd": (4, 1, 699.0 * of.grid.h[4])}
    assert multistart.is_touched(of, robot_record(zoo.robot_of("2rpr")), solution(of, **changed), kind) is touched


def test_guesses_after_the_first_swing_about_the_start() -> None:
    """s, ṡ and s̈ of one motion: by differences where ṡ and s̈ are not cut off."""
    of = problem()
    warm = multistart.first_guess(of, None, 0)
    np.testing.assert_allclose(warm["s"] * of.scales.s, np.tile(of.settings.start, (len(of.grid.t), 1)))
    guess, u = multistart.first_guess(of, None, 3), of.scales
    t = of.grid.t
    s, sd, sdd = (guess[name] * getattr(u, name) for name in ("s", "sd", "sdd"))
    np.testing.assert_allclose(s[[0, -1]], np.zeros((2, 2)), atol=1e-12)
    assert np.abs(guess["s"]).max() <= multistart.REACH
    assert np.abs(guess["s"]).max() > 0.1 * multistart.REACH
    # sums of sines of half a turn and its multiples: fitted, and differentiated
    waves = np.sin(np.pi * np.arange(1, 4) * ((t - t[0]) / (t[-1] - t[0]))[:, None])
    size, left, *_ = np.linalg.lstsq(waves, s, rcond=None)
    assert np.sqrt(left).max() < 1e-9
    frequency = np.pi * np.arange(1, 4) / (t[-1] - t[0])
    rate = (frequency * np.cos(frequency * (t[:, None] - t[0]))) @ size
    second = -(frequency**2 * np.sin(frequency * (t[:, None] - t[0]))) @ size
    np.testing.assert_allclose(sd, np.clip(rate, -0.9 * u.sd, 0.9 * u.sd), atol=1e-9)
    np.testing.assert_allclose(sdd, np.clip(second, -0.9 * u.sdd, 0.9 * u.sdd), atol=1e-8)


BLAMED = [
    ("Maximum_WallTime_Exceeded", "seconds", "time ran out"),
    ("Restoration_Failed", "balance", "by 0.25 of f"),
]


@pytest.mark.parametrize(("message", "constraint", "says"), BLAMED)
def test_where_nothing_helps_the_time_or_the_balance_is_to_blame(message: str, constraint: str, says: str) -> None:
    elastic = SimpleNamespace(message=message, violation=0.25)
    error = multistart.nothing_helps(problem(), elastic, "Infeasible_Problem_Detected")
    assert error.details["constraint"] == constraint
    assert says in str(error)
    assert error.details["amount"] == 0.25


def test_a_platform_at_rest_is_scaled_by_what_its_carriers_do() -> None:
    """Where f is zero with parked carriers: the largest force that an acceleration at its limit asks for."""
    dynamics = rp.VirtualWork(zoo.robot_of("2rpr"))
    t = np.linspace(0.0, 1.0, 20)
    still = np.zeros((20, 2))
    motion = rp.PlatformMotion(t, still + np.array([0.25, 0.2]), still, still)
    source = continuous_motion(motion)
    settings = checked_settings(dynamics.robot, Objective("effort"), Limits(acceleration=8.0), Mesh(0.1, 0))
    scales = read_coefficients(Task(dynamics, source, settings), grid_of(source, [], 0.1)).scales
    pushed = []
    for j in range(2):
        sdd = np.zeros((1, 2))
        sdd[0, j] = 8.0
        carriers = rp.CarrierMotion(np.zeros((1, 2)), np.zeros((1, 2)), sdd, check_rates=False)
        pushed.append(np.abs(rp.RneaDynamics(dynamics.robot).reduce(motion[:1], carriers).f).max())
    np.testing.assert_allclose(scales.row, max(pushed), rtol=1e-9)
