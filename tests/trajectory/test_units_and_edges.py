"""A motion is the same whatever it is measured in, and what is taken ends where the error says, at any size.

Lengths and times are multiplied by powers of two, so that what is homogeneous in them agrees to rounding: a product in
the place of a quotient shows, in tolerances and stopping rules too. Edges are tried from both sides, next to them.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import (
    Arc,
    ChainedPath,
    Line,
    PoseLine,
    RestToRest,
    SpeedProfile,
    Trajectory,
    corner_path,
    from_points,
    reference,
    rounded_polygon,
    through_points,
)
from redundancy_pin.trajectory.timing import law_through_speeds

UNITS = [(2.0**20, 1.0), (2.0**-20, 1.0), (1.0, 2.0**20), (2.0**11, 2.0**-17)]
"""How many new units of length and time an old one is."""

ROUNDED = 1e-11
"""Relative to the largest number of its kind."""

POINTS = np.array([[0.0, 0.0], [0.2, 0.1], [0.3, 0.4], [0.1, 0.5], [0.0, 0.3]])
TIMES = np.array([0.0, 0.5, 1.2, 2.0, 3.0])
CUSP = np.array([[0.0, 0.0], [0.3, 1e-3], [0.0, 2e-3], [0.3, 0.1]])
"""Turns back within a millimetre, where the arc length takes many panels, and time-optimal grids many steps."""
SQUARE = np.array([[0.0, 0.0], [0.4, 0.0], [0.4, 0.3], [0.0, 0.3]])
POSES = np.tile(np.eye(4), (4, 1, 1))
POSES[:, :3, :3] = Rotation.from_rotvec([[0, 0, 0], [0.4, 0.1, 0], [0.8, 0.5, -0.3], [0.2, 1.0, -0.6]]).as_matrix()
POSES[:, :3, 3] = [[0.0, 0.0, 1.0], [0.1, 0.0, 1.1], [0.2, 0.2, 1.1], [0.1, 0.3, 1.0]]


def poses(L: float) -> np.ndarray:
    moved = POSES.copy()
    moved[:, :3, 3] *= L
    return moved


MOTIONS: dict[str, Callable[[float, float], Trajectory]] = {
    "a spline by times": lambda L, T: from_points(L * POINTS, T * TIMES),
    "a spline by speed": lambda L, T: from_points(L * POINTS, speed=0.2 * L / T),
    "a spline by speeds": lambda L, T: from_points(L * POINTS, speed=np.array([0.0, 0.2, 0.3, 0.1, 0.0]) * L / T),
    "a closed spline by speeds": lambda L, T: from_points(
        L * POINTS, speed=np.array([0.1, 0.2, 0.3, 0.1, 0.2]) * L / T, closed=True
    ),
    "a spline with ramps": lambda L, T: from_points(L * POINTS, speed=0.2 * L / T, ramp_time=0.3 * T),
    "the fastest": lambda L, T: from_points(
        L * POINTS[:3], "time-optimal", max_speed=0.5 * L / T, max_acceleration=2.0 * L / T**2
    ),
    "the fastest of each coordinate": lambda L, T: from_points(
        L * CUSP[:3],
        "time-optimal",
        max_speed=np.array([0.5, 0.3]) * L / T,
        max_acceleration=np.array([2, 1]) * L / T**2,
    ),
    "the fastest pose": lambda L, T: from_points(
        poses(L)[:3], "time-optimal", max_speed=[0.3 * L / T, 1.0 / T], max_acceleration=[1.0 * L / T**2, 3.0 / T**2]
    ),
    "poses by speed": lambda L, T: from_points(poses(L), speed=0.1 * L / T, ramp_time=0.3 * T),
    "poses by times": lambda L, T: from_points(poses(L), T * np.array([0.0, 0.5, 1.2, 2.0])),
    "a pose": lambda L, T: reference.pose(poses(L)[0], poses(L)[2], 2.0 * T),
    "a corner": lambda L, T: on(corner_path((0.1 * L, 0.2 * L), (3.0 * L, 4.0 * L), 0.3 * L, 0.1 * L, -2.0), L, T),
    "a polygon": lambda L, T: on(rounded_polygon(L * SQUARE, 0.05 * L), L, T),
    "an open polygon": lambda L, T: on(rounded_polygon(L * SQUARE, 0.05 * L, closed=False), L, T),
    "unequal ramps": lambda L, T: Trajectory(
        Line((0.0, 0.0), (L, 0.0)), SpeedProfile(L, 0.5 * L / T, 0.4 * T, 0.14 * L, 0.6 * T, 0.13 * L)
    ),
    "a cusp": lambda L, T: on(through_points(L * CUSP), L, T),
}  # fmt: skip


def on(path: Any, L: float, T: float) -> Trajectory:
    return Trajectory(path, SpeedProfile(path.length, 0.2 * L / T, 0.2 * T))


def close(one: Any, other: Any) -> None:
    """Each column is the same but for rounding of its largest entry."""
    one, other = np.asarray(one), np.asarray(other)
    assert one.shape == other.shape
    np.testing.assert_allclose(one, other, rtol=0.0, atol=ROUNDED * max(np.abs(other).max(initial=0.0), 1e-300))


@pytest.mark.parametrize("name", MOTIONS)
def test_a_motion_is_the_same_in_other_units(name: str) -> None:
    plain = MOTIONS[name](1.0, 1.0)
    part = np.linspace(0.0, 1.0, 41)
    x, xd, xdd = plain.evaluate(np.minimum(part * plain.duration, plain.duration))
    for L, T in UNITS[3:] if "fastest" in name else UNITS:
        # the fastest pose has a grid on which metres and radians count alike
        L = 1.0 if name == "the fastest pose" else L
        other = MOTIONS[name](L, T)
        close(other.duration / T, plain.duration)
        y, yd, ydd = other.evaluate(np.minimum(part * other.duration, other.duration))
        pose = y.ndim == 3
        length = np.repeat([L, 1.0], 3) if pose else L
        if pose:
            close(y[:, :3, :3], x[:, :3, :3])
            close(y[:, :3, 3] / L, x[:, :3, 3])
        else:
            close(y / L, x)
        close(yd / length * T, xd)
        # where the curvature jumps rounding decides the side
        smooth = np.abs(part[:, None] * plain.duration - plain.breaks).min(axis=1, initial=1.0) > 1e-9
        close((ydd / length * T**2)[smooth], xdd[smooth])
        close(other.breaks / T, plain.breaks)


def chain(gap: float, kink: float, L: float) -> Any:
    turned = np.array([np.cos(kink), np.sin(kink)])
    first = Line((0.0, 0.0), (0.6 * L, 0.0))
    start = np.array([0.6 * L + gap, 0.0])
    return ChainedPath([first, Line(start, start + 0.4 * L * turned)])


def turned(angle: float) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_rotvec([0.0, 0.0, angle]).as_matrix()
    return pose


EDGES: dict[str, tuple[Callable[[float, float], Any], Mapping[str, Callable[[float], float]]]] = {
    # what is made of a size L and a number next to one, refused where it is above one; and what the error says
    "a path too short for its ramps": (
        lambda L, x: SpeedProfile(L / x, 0.5 * L, 1.2, 0.3 * L, 2.0, 0.7 * L),
        {"ramp_length": lambda L: 0.3 * L, "end_ramp_length": lambda L: 0.7 * L, "length": lambda L: L},
    ),
    "a ramp up that begins backwards": (
        lambda L, x: SpeedProfile(L, 0.5 * L, 1.5, 0.3 * L / x, 0.5, 0.2 * L),
        {"least": lambda L: 0.3 * L, "most": lambda L: L},
    ),
    "a ramp down that begins backwards": (
        lambda L, x: SpeedProfile(L, 0.5 * L, 0.5, 0.2 * L, 1.5, 0.3 * L / x),
        {"least": lambda L: 0.3 * L, "most": lambda L: L},
    ),
    "a radius beyond the first edge of an open polygon": (
        lambda L, x: rounded_polygon(L * np.array([[0, 0], [0.2, 0], [0.2, 0.9]]), 0.2 * L * x, closed=False),
        {"largest_radius": lambda L: 0.2 * L, "edge": lambda L: 0},
    ),
    "a law of another length": (
        lambda L, x: Trajectory(Line((0.0, 0.0), (L, 0.0)), RestToRest(L * (1.0 + 1e-9 * x), 1.0)),
        {"path_length": lambda L: L, "timing_length": lambda L: L * (1.0 + 1e-9)},
    ),
    "a gap in a chain": (lambda L, x: chain(1e-9 * L * x, 0.0, L), {"gap": lambda L: 1e-9 * L, "segment": lambda L: 0}),
    "a kink in a chain": (lambda L, x: chain(0.0, 1e-9 * x, L), {"kink": lambda L: 1e-9, "segment": lambda L: 0}),
    "an arc off its circle": (
        lambda L, x: Arc((0.0, 0.0), L, (1.0, 0.0), (1e-9 * x, 1.0), 1.0), {"error": lambda L: 1e-9}
    ),
    "half a turn": (
        lambda L, x: PoseLine(turned(0.0), turned(np.pi - 1e-6 / x), L),
        {"angle": lambda L: np.pi - 1e-6},
    ),
}  # fmt: skip


BESIDE = dict.fromkeys(("a gap in a chain", "a kink in a chain", "an arc off its circle", "half a turn",
                        "a law of another length"), 1e-3)  # fmt: skip
"""Of tolerances that are small themselves."""
BESIDE |= {name: 1e-6 for name in EDGES if "radius" in name}
"""Of a straight that is left of an edge, a shorter one loses its direction to rounding."""


@pytest.mark.parametrize("size", [1.0, 2.0**20, 2.0**-20])
@pytest.mark.parametrize("name", EDGES)
def test_what_is_taken_ends_where_the_error_says(name: str, size: float) -> None:
    make, says = EDGES[name]
    beside = BESIDE.get(name, 1e-9)
    make(size, 1.0 - beside)
    with pytest.raises(InputError) as caught:
        make(size, 1.0 + beside)
    for key, value in says.items():
        # the offending number is off the edge by what it was moved
        assert caught.value.details[key] == pytest.approx(value(size), rel=2.0 * beside), key


def test_laws_through_many_random_speeds_pass_them_and_never_run_back() -> None:
    """Places, speeds and accelerations by the sentence in the docstring, where no cubic runs back."""
    rng, plain = np.random.default_rng(11), 0
    for _ in range(60):
        count = int(rng.integers(2, 9))
        p = 7.0 + np.concatenate([[0.0], np.cumsum(rng.uniform(0.05, 2.0, count - 1))])
        v = rng.uniform(0.1, 3.0, count)
        v[rng.integers(count)] *= rng.integers(2)
        law = law_through_speeds(p, v)
        knots = np.concatenate([[0.0], law.knots, [law.duration]])
        at = law.evaluate(knots)
        np.testing.assert_allclose(at.p, p - p[0], atol=1e-12 * (p[-1] - p[0]))
        np.testing.assert_allclose(at.pd, v, atol=1e-11 * v.max())
        slopes = slopes_of(p, v)
        share = 1.0 if np.allclose(at.pdd, slopes, atol=1e-9 * (1.0 + np.abs(slopes).max())) else None
        plain += share is not None
        if share is None:  # a half of them, or none
            ratio = at.pdd[np.abs(slopes) > 1e-9] / slopes[np.abs(slopes) > 1e-9]
            assert any(np.allclose(ratio, part, atol=1e-6) for part in (0.5, 0.0))
        assert law.evaluate(np.linspace(0.0, law.duration, 2001)).pd.min() > -1e-9 * v.max()
    assert 20 <= plain < 60


def slopes_of(p: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Half the slopes of the monotone cubic of v² over p, by Fritsch and Butland's harmonic means."""
    w, h = v**2, np.diff(p)
    secant = np.diff(w) / h
    slopes = np.zeros(len(p))
    for i in range(1, len(p) - 1):
        a, b = secant[i - 1], secant[i]
        if a * b > 0.0:
            one, other = 2.0 * h[i] + h[i - 1], h[i] + 2.0 * h[i - 1]
            slopes[i] = (one + other) / (one / a + other / b)
    return 0.5 * slopes


@pytest.mark.parametrize("lengths", [[0.0], [0.0, 1.0, 1.0], [0.0, 2.0, 1.0]])
def test_no_law_leads_through_places_that_do_not_increase(lengths: list[float]) -> None:
    with pytest.raises(InputError, match="Arc lengths must increase"):
        law_through_speeds(lengths, np.ones(len(lengths)))
