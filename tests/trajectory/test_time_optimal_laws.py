"""Time-optimal laws: limits hold between samples, and durations are near the least time by toppra and closed forms."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
import toppra
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.spatial.transform import Rotation
from toppra.algorithm import TOPPRA

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import (
    Line,
    Path,
    PoseLine,
    TimingLaw,
    Trajectory,
    circle_path,
    corner_path,
    from_points,
    rounded_polygon,
    through_points,
)
from redundancy_pin.trajectory.time_optimal import fastest_law, least_duration

SLOWEST = 1.10
"""Largest duration of a law with a continuous acceleration, relative to the least time."""


class _Plain(toppra.interpolator.AbstractGeometricPath):  # type: ignore[misc]
    """A path as toppra knows one: x and its two derivatives by the arc length."""

    dof = 2

    def __init__(self, path: Path) -> None:
        self.path = path

    @property
    def path_interval(self) -> Any:
        return np.array([0.0, self.path.length])

    def __call__(self, places: Any, order: int = 0) -> Any:
        return self.path.evaluate(places)[order]


def segment_places(path: Path, count: int) -> np.ndarray:
    """Places between breaks, dense next to them; a break occurs on both sides."""
    inner = 1e-9 * path.length
    edges = [0.0, *path.breaks, path.length]
    part = 0.5 * (1.0 - np.cos(np.linspace(0.0, np.pi, count)))
    return np.unique([a + part * (b - a - inner * (b < path.length)) for a, b in pairwise(edges)])


def toppra_duration(path: Path, speed: np.ndarray, acceleration: np.ndarray) -> float:
    """Least time by toppra's own constraints of joint velocities and accelerations, on a grid of the test."""
    limits = [
        toppra.constraint.JointVelocityConstraint(np.stack([-speed, speed], axis=1)),
        toppra.constraint.JointAccelerationConstraint(np.stack([-acceleration, acceleration], axis=1)),
    ]
    p = segment_places(path, 120)
    rate = TOPPRA(limits, _Plain(path), gridpoints=p).compute_parameterization(0.0, 0.0)[1]
    return float((2.0 * np.diff(p) / (rate[1:] + rate[:-1])).sum())


def largest_use(path: Path, law: TimingLaw, speed: Any, acceleration: Any) -> float:
    """Largest |ẋ| and |ẍ| over their limits, by even times and by places; of one number that of the norm."""
    motion = Trajectory(path, law)
    even = np.linspace(0.0, law.duration, 10_001)
    beside = np.interp(segment_places(path, 1000), np.maximum.accumulate(law.evaluate(even).p), even)
    times, used = np.concatenate([even, beside, motion.breaks]), 0.0
    for side in ("left", "right"):
        point = motion.evaluate(times, side)
        for rates, limit in ((point.xd, speed), (point.xdd, acceleration)):
            size = np.abs(rates) if np.ndim(limit) else np.linalg.norm(rates, axis=1)
            used = max(used, float((size / limit).max()))
    return used


def require_continuous(law: TimingLaw) -> None:
    before, after = (law.evaluate(law.knots, side).pdd for side in ("left", "right"))
    largest = np.abs(law.evaluate(np.linspace(0.0, law.duration, 9999)).pdd).max()
    assert np.abs(after - before).max() < 1e-6 * largest
    ends = law.evaluate([0.0, law.duration])
    np.testing.assert_allclose([*ends.pd, *ends.pdd], 0.0, atol=1e-12 * largest)


@examples(4)
@given(
    seed=st.integers(0, 10**6),
    radius=st.sampled_from([None, 1e-4, 1e-3, 1e-2, 0.1]),
    limits=st.tuples(*[st.floats(0.1, 10.0)] * 4),
)
def test_laws_keep_limits_of_each_coordinate_and_take_nearly_the_least_time(seed, radius, limits) -> None:
    """Splines through random points, and random zigzags with corners down to a ten thousandth of their edges."""
    dice = np.random.default_rng(seed)
    steps = np.column_stack([dice.uniform(0.5, 1.5, 4), dice.uniform(0.5, 1.5, 4) * (-1.0) ** np.arange(4)])
    points = np.cumsum(steps, axis=0)
    path = through_points(points) if radius is None else rounded_polygon(points, radius, closed=False)
    speed, acceleration = np.reshape(limits, (2, 2))
    law = fastest_law(path, speed, acceleration)
    assert largest_use(path, law, speed, acceleration) <= 1.0
    assert 0.99 < law.duration / toppra_duration(path, speed, acceleration) < SLOWEST
    require_continuous(law)


@pytest.mark.parametrize("radius", [pytest.param(0.1, marks=pytest.mark.long), 0.2])
def test_limits_are_tightened_where_the_speed_alone_takes_nearly_all_acceleration(radius: float) -> None:
    """Hardly any tangential acceleration was left there, no optimum existed, and laws took 1.18 and 1.23."""
    path = rounded_polygon([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.3, 0.7]], radius)
    speed, acceleration = np.array([[1.0, 0.5], [2.0, 3.0]])
    law = fastest_law(path, speed, acceleration)
    assert largest_use(path, law, speed, acceleration) <= 1.0
    assert law.least_duration == pytest.approx(toppra_duration(path, speed, acceleration), rel=2e-3)
    assert 1.0 < law.duration / law.least_duration < 1.05


def test_under_unlike_limits_intervals_are_not_tightened_at_once_by_all_they_exceed() -> None:
    """The first law exceeds limits by 6.7 at the ends of arcs: tightened by that the next law took 17.3 s."""
    dice = np.random.default_rng(344080)
    steps = np.column_stack([dice.uniform(0.5, 1.5, 4), dice.uniform(0.5, 1.5, 4) * (-1.0) ** np.arange(4)])
    path = rounded_polygon(np.cumsum(steps, axis=0), 0.1, closed=False)
    speed, acceleration = np.array([[0.329, 2.895], [0.17, 3.638]])
    law = fastest_law(path, speed, acceleration)
    assert largest_use(path, law, speed, acceleration) <= 1.0
    assert law.duration < 16.0  # 16.37 where pieces are not evaluated at their ends, on the left of a break


@pytest.mark.parametrize(("points", "noise"), [(100, 1e-4), pytest.param(50, 1e-2, marks=pytest.mark.long)])
def test_limits_hold_between_samples_on_splines_with_many_bends(points: int, noise: float) -> None:
    """Peaks of the curvature between two samples exceeded them by up to 0.3 %."""
    dice = np.random.default_rng(5)
    path = through_points(np.column_stack([np.linspace(0.0, 1.0, points), noise * dice.normal(size=points)]))
    law = fastest_law(path, 1.0, 2.0)
    assert 0.99 < largest_use(path, law, 1.0, 2.0) <= 1.0
    assert law.duration / law.least_duration < SLOWEST


@pytest.mark.parametrize("limits", [(0.5, 2.0), ((0.5, 0.3), (2.0, 1.0)), ((0.3, 1.0), (1.0, 3.0))])
def test_limits_of_norms_coordinates_and_poses_are_kept_and_reached(limits) -> None:
    """One number limits a norm, two of a pose the norms of ṗ and ω."""
    of_poses = limits[0] == (0.3, 1.0)
    motion = from_points(
        poses(3, 2.0) if of_poses else BENT, "time-optimal", max_speed=limits[0], max_acceleration=limits[1]
    )
    dense = motion.sample(motion.duration / 20_000)
    used = []
    for rates, limit in zip((dense.xd, dense.xdd), limits, strict=True):
        parts = rates.reshape(len(rates), len(np.atleast_1d(limit)), -1)
        used.append((np.linalg.norm(parts, axis=2) / limit).max(axis=1))
    at_limit = np.maximum(*used)
    assert 0.999 < at_limit.max() <= 1.0
    assert np.mean(at_limit > 0.97) > 0.85


def test_a_pose_turns_as_fast_however_short_the_way_of_its_origin() -> None:
    """The arc length is the origin's: with a way of 0.8 mm the law had thousands of pieces, and took ten seconds."""
    short = poses(3, 2.0) * [1e-3, 1e-3, 1e-3, 1.0, 1.0, 1.0, 1.0]
    motion = from_points(short, "time-optimal", max_speed=(0.3, 0.8), max_acceleration=(3.0, 8.0))
    assert len(motion.timing.knots) < 200
    assert motion.duration < SLOWEST * motion.timing.least_duration


@pytest.mark.parametrize("radius", [1e-4, 1e-3, pytest.param(0.03, marks=pytest.mark.long)])
def test_sharp_corners_of_a_square_cost_a_fraction_of_their_own_time(radius: float) -> None:
    """With corners of 0.1 mm the law took five times the least time: it blended over 2 % of the duration.

    With corners of 1 mm it takes 3.8 % more than the least time where nodes do not come closer before a bend.
    """
    path = rounded_polygon([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]], radius)
    law = fastest_law(path, 1.0, 2.0)
    assert largest_use(path, law, 1.0, 2.0) <= 1.0
    # arcs at √(a r), all acceleration centripetal; three edges between two arcs, two halves of one from and to rest
    corner = np.sqrt(2.0 * radius)
    edges = 3.0 * straight_time(1.0 - 2.0 * radius, corner, corner) + 2.0 * straight_time(0.5 - radius, 0.0, corner)
    least = edges + 4.0 * 0.5 * np.pi * radius / corner
    assert 1.0 < law.duration / least < 1.03


def straight_time(length: float, start: float, end: float, fastest: float = 1.0, a: float = 2.0) -> float:
    """Least time over a straight, m, between two speeds, m/s: up to a top speed and down again."""
    top = min(fastest, np.sqrt(0.5 * (start**2 + end**2) + a * length))
    ramps = (2.0 * top**2 - start**2 - end**2) / (2.0 * a)
    return float((2.0 * top - start - end) / a + (length - ramps) / top)


def circle_time(radius: float, acceleration: float, length: float) -> float:
    """Up to where all acceleration is centripetal w = ṗ² obeys w' = 2 √(a² − w²/r²), that is w = a r sin(2p/r)."""
    ramp, _ = quad(lambda p: 1.0 / np.sqrt(acceleration * radius * np.sin(2.0 * p / radius)), 0.0, np.pi * radius / 4.0)
    return float(2.0 * ramp + (length - np.pi * radius / 2.0) / np.sqrt(acceleration * radius))


@pytest.mark.parametrize(
    ("path", "speed", "acceleration", "expected"),
    [
        (Line((0.0, 0.0), (1.0, 0.0)), 0.5, 2.0, 1.0 / 0.5 + 0.5 / 2.0),  # a trapezium
        (Line((0.0, 0.0), (1.0, 0.0)), 9.0, 2.0, 2.0 * np.sqrt(1.0 / 2.0)),  # a triangle: half the way each
        (Line((0.0, 0.0), (3.0, 4.0)), [9.0, 9.0], [0.3, 0.5], 2.0 * np.sqrt(3.0 / 0.3)),  # x is the slower one
        (circle_path((0.0, 0.0), 0.5), 9.0, 1.0, circle_time(0.5, 1.0, np.pi)),
        # where a side of the polygon has 6e-17 for a cosine of zero, cruising went to and fro and took 2 % more
        (circle_path((0.0, 0.0), 0.3), 9.0, 2.0, circle_time(0.3, 2.0, 0.6 * np.pi)),
    ],
)
def test_the_least_time_is_that_of_closed_forms(path: Any, speed: Any, acceleration: Any, expected: float) -> None:
    assert least_duration(path, speed, acceleration) == pytest.approx(expected, rel=2e-3)
    law = fastest_law(path, speed, acceleration)
    assert expected < law.duration < 1.02 * expected
    np.testing.assert_allclose(law.evaluate([0.0, law.duration]).pd, 0.0, atol=1e-12)


def test_the_least_time_round_many_corners_is_that_of_toppra_on_a_grid_that_resolves_them() -> None:
    """Steps that turn by more than 0.1 rad see the limits of coordinates at too few angles: 2 % too much time."""
    path = rounded_polygon([[0.01 * i, 0.02 * (i % 2)] for i in range(25)], 1e-3, closed=False)
    speed, acceleration = np.array([[9.0, 9.0], [2.0, 3.0]])
    expected = toppra_duration(path, speed, acceleration)
    assert least_duration(path, speed, acceleration) == pytest.approx(expected, rel=5e-3)


def test_the_least_time_is_the_same_backwards() -> None:
    """Start and end of each step change places: what limits one limits the other, and the optimum is that of both."""
    limits = [0.5, 0.3], [2.0, 1.0]
    there, back = (least_duration(through_points(points), *limits) for points in (BENT, BENT[::-1]))
    assert back == pytest.approx(there, rel=1e-6)  # steps of a thousandth are not halved alike
    # the curvature jumps where an arc ends: each step has that of its own side
    there, back = (
        least_duration(rounded_polygon(points, 0.01, closed=False), *limits) for points in (BENT, BENT[::-1])
    )
    assert back == pytest.approx(there, rel=1e-5)


def test_the_fastest_law_brakes_for_a_corner() -> None:
    """On an arc of radius r the platform may have √(a r), on straights more: limits hold on both sides of a break."""
    path = corner_path((0.0, 0.0), (1.0, 0.0), 0.5, 0.05)
    motion = Trajectory(path, fastest_law(path, 1.0, 2.0))
    dense = motion.sample(motion.duration / 20000)
    assert np.linalg.norm(dense.xdd, axis=1).max() <= 2.0 * (1.0 + 1e-6)
    on_arc = motion.evaluate([motion.timing.time_at(float(p)) for p in path.breaks]).xd
    assert np.linalg.norm(on_arc, axis=1).max() <= np.sqrt(2.0 * 0.05) * (1.0 + 1e-6)
    assert np.linalg.norm(dense.xd, axis=1).max() > 2.0 * np.sqrt(2.0 * 0.05)


def test_the_fastest_law_keeps_limits_where_a_spline_turns_back_within_a_millimetre() -> None:
    path = through_points([[-0.6, 0.4], [0.9, -0.35], [-0.55, 0.26], [0.1, -0.9]])
    p = np.linspace(0.0, path.length, 20_001)
    assert np.linalg.norm(path.evaluate(p).curvature, axis=1).max() > 1e3
    law = fastest_law(path, 2.0, 5.0)
    reached = law.evaluate(even := np.linspace(0.0, law.duration, 20_001)).p
    t = np.concatenate([even, np.interp(p, np.maximum.accumulate(reached), even)])
    at = law.evaluate(t)
    point, pd = path.evaluate(at.p), at.pd[:, None]
    assert np.linalg.norm(point.tangent * pd, axis=1).max() <= 2.0
    assert 4.0 < np.linalg.norm(point.tangent * at.pdd[:, None] + point.curvature * pd**2, axis=1).max() <= 5.0


BENT = np.array([[0.0, 0.0], [0.2, 0.1], [0.3, 0.4], [0.1, 0.5], [0.0, 0.3]])


def poses(seed: int, turning: float) -> np.ndarray:
    """Five poses along a bent line that turn ever more about axes that differ."""
    dice = np.random.default_rng(seed)
    places = np.column_stack([np.linspace(0.0, 0.8, 5), 0.1 * dice.random(5), 0.1 * dice.random(5)])
    vectors = turning * np.column_stack([np.linspace(0.0, 1.0, 5) ** 2, *(0.2 * dice.random((2, 5)))])
    return np.hstack([places, Rotation.from_rotvec(vectors).as_quat()])


@pytest.mark.parametrize(
    ("turning", "speed", "acceleration"),
    [
        (0.4, (100.0, 100.0), (2.0, 100.0)),  # the origin's acceleration alone
        (2.0, (100.0, 100.0), (100.0, 2.0)),  # the rotation's
        (2.0, (0.3, 100.0), (3.0, 8.0)),
        (2.0, (100.0, 0.8), (3.0, 8.0)),
    ],
)
def test_of_poses_one_limit_is_met_all_the_time(turning, speed, acceleration):
    """Switches, each between two nodes, take the most of a tenth of the duration."""
    path = from_points(poses(3, turning), "time-optimal", max_speed=speed, max_acceleration=acceleration)
    t = np.linspace(0.0, path.duration, 2001)
    motion = path.sample_at(t)
    used = np.stack(
        [
            np.linalg.norm(rates[:, part], axis=1) / limit
            for rates, limits in ((motion.xd, speed), (motion.xdd, acceleration))
            for part, limit in zip((slice(3), slice(3, 6)), limits, strict=True)
        ]
    ).max(axis=0)
    assert used.max() <= 1.0
    assert np.quantile(used, 0.1) >= 0.9
    assert np.quantile(used, 0.2) >= 0.975


@pytest.mark.parametrize("mirror", [(-1.0, 1.0), (1.0, -1.0)])
@pytest.mark.parametrize(("speed", "acceleration"), [((9.0, 9.0), (2.0, 3.0)), ((0.4, 0.5), (3.0, 2.0))])
def test_mirrored_paths_take_the_same_time(mirror, speed, acceleration):
    """Limits are the same in both directions of a coordinate; on the same path, mirrored, only rounding differs."""
    there = least_duration(through_points(BENT * mirror), speed, acceleration)
    assert there == pytest.approx(least_duration(through_points(BENT), speed, acceleration), rel=1e-9)


@pytest.mark.parametrize("angle", [1.2])
def test_turned_paths_take_the_same_time_under_a_limit_of_the_norm(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    there = least_duration(through_points(BENT @ turn.T), 0.5, 2.0)
    assert there == pytest.approx(least_duration(through_points(BENT), 0.5, 2.0), rel=1e-6)  # steps halved elsewhere


def test_a_line_between_equal_poses_has_no_least_time() -> None:
    with pytest.raises(InputError, match=r"stands still.*RestToRest"):
        fastest_law(PoseLine(np.eye(4), np.eye(4)), [1.0, 1.0], [1.0, 1.0])


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_law_uses_its_limits_but_for_the_reserve(seed: int) -> None:
    """1e-4 of the speed, by 100,000 samples: the largest use between the nodes is found, not estimated from above."""
    points = np.cumsum(np.random.default_rng(seed).uniform(-0.5, 1.0, (6, 2)), axis=0)
    path, speed, acceleration = through_points(points), np.array([1.0, 0.7]), np.array([2.0, 3.0])
    law = fastest_law(path, speed, acceleration)
    at = law.evaluate(np.linspace(0.0, law.duration, 100_001))
    point, pd, pdd = path.evaluate(at.p), at.pd[:, None], at.pdd[:, None]
    xd, xdd = point.tangent * pd, point.curvature * pd**2 + point.tangent * pdd
    use = max((np.abs(xd) / speed).max(), np.sqrt((np.abs(xdd) / acceleration).max()))
    assert 1.0 - 1.5e-4 <= use <= 1.0


@pytest.mark.parametrize("speed", [None, np.array([0.0, np.nan, 0.0])], ids=["none", "not finite"])
def test_where_toppra_finds_no_law_the_limits_are_named(speed: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """As under limits of two coordinates that are 1e8 apart; which ones is a matter of rounding."""
    monkeypatch.setattr(TOPPRA, "compute_parameterization", lambda *_: (None, speed, None))
    with pytest.raises(InputError, match="No timing law was found") as caught:
        fastest_law(through_points([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]]), 1.0, 1e8)
    assert "like limits" in caught.value.remedy
