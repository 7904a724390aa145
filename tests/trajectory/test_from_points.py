"""Motions through points of one's own: they pass them, are smooth, keep their limits, and take the least time."""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import Trajectory, from_points, through_points
from redundancy_pin.trajectory import points as files_of_points
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.timing import law_through_speeds

POINTS = np.array([[0.0, 0.0], [0.2, 0.1], [0.3, 0.4], [0.1, 0.5], [0.0, 0.3]])
TIMES = np.array([1.0, 1.5, 2.2, 3.0, 4.0])  # counted from the first
TURNS = Rotation.from_rotvec([[0.0, 0.0, 0.0], [0.4, 0.1, 0.0], [0.8, 0.5, -0.3], [0.2, 1.0, -0.6]])
ORIGINS = np.array([[0.0, 0.0, 1.0], [0.1, 0.0, 1.1], [0.2, 0.2, 1.1], [0.1, 0.3, 1.0]])
POSES = np.tile(np.eye(4), (4, 1, 1))
POSES[:, :3, :3], POSES[:, :3, 3] = TURNS.as_matrix(), ORIGINS

BY: dict[str, dict[str, Any]] = {
    "times": {"times": TIMES},
    "times, rest": {"times": TIMES, "ends": "rest"},
    "speed": {"speed": 0.2},
    "speeds": {"speed": [0.0, 0.2, 0.3, 0.1, 0.0]},
    "time-optimal": {"times": "time-optimal", "max_speed": 0.5, "max_acceleration": 2.0},
    "time-optimal, each": {"times": "time-optimal", "max_speed": [0.5, 0.3], "max_acceleration": [2.0, 1.0]},
}
POSES_BY: dict[str, dict[str, Any]] = {
    "times": {"times": [0.0, 0.5, 1.2, 2.0]},
    "times, rest": {"times": [0.0, 0.5, 1.2, 2.0], "ends": "rest"},
    "speed": {"speed": 0.1, "ramp_time": 0.3},
    "speeds": {"speed": [0.0, 0.1, 0.2, 0.0]},
    "time-optimal": {"times": "time-optimal", "max_speed": [0.3, 1.0], "max_acceleration": [1.0, 3.0]},
}


@functools.cache
def through(name: str, *, poses: bool = False) -> Trajectory:
    """Return a motion of the lists above, made once."""
    return from_points(POSES, **POSES_BY[name]) if poses else from_points(POINTS, **BY[name])


def require_smooth(motion: Trajectory) -> None:
    """ẋ and ẍ are the derivatives of x and ẋ, and none of them jumps; the ends are at rest, without ``ends``."""
    dense = motion.sample(motion.duration / 20000)
    assert len(motion.breaks) == 0
    dt = np.diff(dense.t)[:, None]
    if dense.is_pose:
        turned = Rotation.from_matrix(dense.x[1:, :3, :3] @ dense.x[:-1, :3, :3].transpose(0, 2, 1)).as_rotvec()
        steps = np.concatenate([np.diff(dense.x[:, :3, 3], axis=0), turned], axis=1)
    else:
        steps = np.diff(dense.x, axis=0)
    for change, rates in ((steps, dense.xd), (np.diff(dense.xd, axis=0), dense.xdd)):
        mean = 0.5 * (rates[1:] + rates[:-1])
        assert np.abs(change / dt - mean).max() < 2e-3 * np.abs(rates).max()
    assert np.abs(np.diff(dense.xdd, axis=0)).max() < 0.02 * np.abs(dense.xdd).max()
    if motion.ends in (None, ("rest", "rest")):
        np.testing.assert_allclose(dense.xd[[0, -1]], 0.0, atol=1e-9 * np.abs(dense.xd).max())


@pytest.mark.parametrize("name", BY)
def test_points_are_passed_smoothly(name: str) -> None:
    motion = through(name)
    require_smooth(motion)
    times = (
        [motion.timing.time_at(float(p)) for p in through_points(POINTS).lengths_at_points]
        if "times" not in name
        else TIMES - TIMES[0]
    )
    np.testing.assert_allclose(motion.evaluate(times).x, POINTS, atol=1e-12)
    speeds = np.linalg.norm(motion.evaluate(times).xd, axis=1)
    if name == "speeds":
        np.testing.assert_allclose(speeds, BY[name]["speed"], atol=1e-9)
    if name == "speed":
        np.testing.assert_allclose(speeds[1:-1], 0.2, rtol=1e-9)


@pytest.mark.parametrize("name", POSES_BY)
def test_poses_are_passed_smoothly(name: str) -> None:
    motion = through(name, poses=True)
    require_smooth(motion)
    times = (
        POSES_BY[name]["times"]
        if "times" in name
        else [motion.timing.time_at(float(p)) for p in through_points(ORIGINS).lengths_at_points]
    )
    np.testing.assert_allclose(motion.evaluate(times).x, POSES, atol=1e-9)
    if name == "time-optimal":  # which rows make is the same before any law
        return
    as_rows = np.concatenate([ORIGINS, -TURNS.as_quat()], axis=1)  # both signs are the same rotation
    np.testing.assert_allclose(from_points(as_rows, **POSES_BY[name]).sample(0.01).x, motion.sample(0.01).x, atol=1e-9)


def test_a_turn_about_one_axis_stays_a_turn_about_it() -> None:
    """Quaternions of one axis lie in a plane: the spline cannot leave it, and its angle goes by the times."""
    angles = np.array([0.0, 0.3, 0.6, 0.9])
    poses = np.tile(np.eye(4), (4, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(angles[:, None] * [0.0, 0.6, 0.8]).as_matrix()
    dense = from_points(poses, np.arange(4.0)).sample(0.01)
    np.testing.assert_allclose(np.cross(dense.xd[:, 3:], [0.0, 0.6, 0.8]), 0.0, atol=1e-12)
    travelled = np.trapezoid(dense.xd[:, 3:] @ [0.0, 0.6, 0.8], dense.t)
    assert travelled == pytest.approx(0.9, rel=1e-4)


def test_speeds_of_uniform_acceleration_give_just_that() -> None:
    """Between the first and the last two points, where nothing starts or stops: v² grows with p, v with t."""
    lengths = np.linspace(0.0, 2.0, 9)
    law = law_through_speeds(lengths, np.sqrt(0.25 + 2.0 * 0.5 * lengths))
    t = np.linspace(law.time_at(0.25), law.time_at(1.75), 50)
    np.testing.assert_allclose(law.evaluate(t).pdd, 0.5, atol=1e-9)
    up_and_down = law_through_speeds([0.0, 0.1, 1.0, 1.05, 2.0], [0.0, 3.0, 0.01, 2.0, 0.0])  # rough, never backwards
    assert up_and_down.evaluate(np.linspace(0.0, up_and_down.duration, 5000)).pd.min() >= -1e-9


def test_a_law_of_pieces_is_inverted_and_scaled() -> None:
    law = law_through_speeds([0.0, 0.3, 1.0], [0.0, 0.5, 0.0])
    for p in (0.0, 1e-9, 0.2, 0.3, 0.9, 1.0):
        assert law.evaluate(law.time_at(p)).p == pytest.approx(p, abs=1e-12)
    twice = law.scaled(2.0)
    t = np.linspace(0.0, twice.duration, 7)
    for order, (ours, theirs) in enumerate(zip(twice.evaluate(t), law.evaluate(2.0 * t), strict=True)):
        np.testing.assert_allclose(ours, theirs * 2.0**order, atol=1e-12)


@pytest.mark.parametrize("name", BY)
def test_planners_get_it_as_polynomials(name: str) -> None:
    motion = through(name)
    times = np.linspace(0.0, motion.duration, 999)
    polynomials = as_motion(motion).polynomials
    exact = motion.sample_at(times)
    for part, columns in ((exact.x, slice(0, 2)), (exact.xd, slice(2, 4)), (exact.xdd, slice(4, 6))):
        assert np.abs(polynomials(times)[:, columns] - part).max() < 1e-8 * np.abs(part).max()


# ------------------------------------------------------------------------------------------------- ends

OMEGA, RADIUS, CENTRE = 5.0, 0.1, np.array([0.7, 0.35])


def circle(t: Array, order: int = 0) -> Array:
    """Half a metre a second, or its derivatives."""
    angle = OMEGA * t + 0.5 * np.pi * order
    return RADIUS * OMEGA**order * np.stack([np.cos(angle), np.sin(angle)], axis=1) + CENTRE * (order == 0)


def polynomial(*coefficients: float) -> Any:
    """A coordinate c0 + c1 t + ..., and its derivatives."""
    return lambda t, order=0: np.polynomial.Polynomial(coefficients).deriv(order)(t)[:, None] + 0.0 * t[:, None]


def sine(phase: float) -> Any:
    return lambda t, order=0: (
        0.1 * 3.0**order * np.sin(3.0 * t + phase + 0.5 * np.pi * order)[:, None] + 0.3 * (order == 0)
    )


QUINTIC = polynomial(0.7, 0.0, 0.0, 1.0, -1.5, 0.6)  # from rest to rest in a second
SEPTIC = polynomial(0.7, 0.0, 0.0, 0.0, 3.5, -8.4, 7.0, -2.0)
CLOSED_FORMS: dict[str, tuple[Any, float, tuple[str, str]]] = {
    "circle": (circle, 1.3, ("samples", "samples")),
    "sine": (sine(0.4), 2.0, ("samples", "samples")),
    "from a turning point": (sine(0.5 * np.pi), 2.0, ("samples", "samples")),  # ẋ is zero there, ẍ is not
    "line": (polynomial(0.3, 0.2), 1.0, ("samples", "samples")),
    "constant acceleration": (polynomial(0.3, 0.0, 0.2), 1.0, ("samples", "samples")),
    "rest to rest": (QUINTIC, 1.0, ("rest", "rest")),
    "rest to rest, slowly": (SEPTIC, 1.0, ("rest", "rest")),
    "from rest": (QUINTIC, 0.6, ("rest", "samples")),
    "to rest": (lambda t, order=0: QUINTIC(t + 0.4, order), 0.6, ("samples", "rest")),
    "after a pause": (lambda t, order=0: QUINTIC(np.maximum(t - 0.3, 0.0), order), 1.3, ("rest", "rest")),
}


def six_digits(values: Array) -> Array:
    return np.array([float(f"{value:.6g}") for value in values.ravel()]).reshape(values.shape)


@pytest.mark.parametrize(
    "rate", [10, 50, 1000, *(pytest.param(rate, marks=pytest.mark.long) for rate in (20, 100, 200, 500))]
)
@pytest.mark.parametrize("name", CLOSED_FORMS)
def test_ends_are_those_that_the_points_show(name: str, rate: int) -> None:
    """With all digits, with six, and with six decimals as most CSV files have."""
    exact, duration, ends = CLOSED_FORMS[name]
    t = np.linspace(0.0, duration, round(duration * rate) + 1)
    for rounded in (np.asarray, six_digits, lambda values: values.round(6)):
        motion = from_points(rounded(exact(t)), t + 3.0)
        assert motion.ends == ends
        assert from_points(rounded(exact(t)) * 1e3, t * 1e-3).ends == ends  # in other units
        assert from_points(rounded(exact(t))[::-1], t).ends == ends[::-1]  # backwards
        assert f"ends={ends}" in repr(motion)
        assert motion.scaled(0.5).ends == ends
        at_ends = motion.evaluate([0.0, motion.duration])
        speed, acceleration = (np.abs(exact(np.linspace(0.0, duration, 999), order)).max() for order in (1, 2))
        if rounded is np.asarray and rate >= 50:
            assert np.abs(at_ends.xd - exact(t[[0, -1]], 1)).max() < 1e-3 * speed
            assert np.abs(at_ends.xdd - exact(t[[0, -1]], 2)).max() < 0.02 * max(acceleration, speed)
        # rounding at 1 kHz is 5e-7 m/(1 ms)² = 0.5 m/s² and more where it is not told from the motion
        assert np.abs(at_ends.xdd - exact(t[[0, -1]], 2)).max() < 0.15 * max(acceleration, speed)


ORDERS = (6, 5, 4)
"""Of the errors of x, ẋ and ẍ in the distance of the points."""


@pytest.mark.parametrize("name", ["circle", "sine", "from a turning point"])
def test_errors_fall_with_the_declared_orders(name: str) -> None:
    exact, duration, _ = CLOSED_FORMS[name]
    dense = np.linspace(0.0, duration, 2001)
    errors = []
    for steps in (32, 64, 128):
        t = np.linspace(0.0, duration, steps + 1)
        at = from_points(exact(t), t).evaluate(dense)
        errors.append([np.abs(part - exact(dense, order)).max() for order, part in enumerate(at)])
    reached = np.log2(np.array(errors[:-1]) / np.array(errors[1:]))
    assert (reached > np.array(ORDERS) - 0.4).all()


def test_a_circle_at_constant_speed_has_constant_speed_and_acceleration() -> None:
    """At 50 Hz, with six digits: it started and ended at rest, and its accelerations there were 10 times as large."""
    t = np.linspace(0.0, 1.3, 66)
    for points, tolerance in ((circle(t), 1e-4), (six_digits(circle(t)), 0.01)):
        dense = from_points(points, t).sample(1e-3)
        np.testing.assert_allclose(np.linalg.norm(dense.xd, axis=1), OMEGA * RADIUS, rtol=tolerance)
        np.testing.assert_allclose(np.linalg.norm(dense.xdd, axis=1), OMEGA**2 * RADIUS, rtol=tolerance)


def test_ends_that_are_asked_for_are_taken() -> None:
    t = np.linspace(0.0, 1.3, 66)
    for ends in ("rest", "samples", ("rest", "samples"), ["samples", "auto"]):
        motion = from_points(circle(t), t, ends=ends)
        words = (ends, ends) if isinstance(ends, str) else tuple(ends)
        assert motion.ends == tuple(word.replace("auto", "samples") for word in words)
        speeds = np.linalg.norm(motion.evaluate([0.0, motion.duration]).xd, axis=1)
        expected = [0.0 if word == "rest" else OMEGA * RADIUS for word in words]
        np.testing.assert_allclose(speeds, expected, rtol=1e-4, atol=1e-12)
    t = np.linspace(0.0, 1.0, 11)
    assert from_points(QUINTIC(t), t, ends="samples").ends == ("samples", "samples")
    assert from_points(circle(t), speed=0.1).ends is None


@pytest.mark.parametrize("count", [2, 3, 4, 5, 6])
def test_few_points_are_passed_by_the_polynomial_through_them(count: int) -> None:
    """Nothing shows rest in fewer than six: whoever wants it asks for it."""
    exact = polynomial(*[0.3, 0.2, -0.1, 0.4, 0.2, -0.3][:count])
    t = np.linspace(0.0, 0.8, count)
    motion = from_points(exact(t), t)
    assert motion.ends == ("samples", "samples")
    dense = np.linspace(0.0, 0.8, 101)
    for order, part in enumerate(motion.evaluate(dense)):
        np.testing.assert_allclose(part, exact(dense, order), atol=1e-9)
    at_rest = from_points(exact(t), t, ends="rest").evaluate([0.0, 0.8])
    np.testing.assert_allclose(at_rest.xd, 0.0, atol=1e-12)
    np.testing.assert_allclose(at_rest.xdd, 0.0, atol=1e-12)


@pytest.mark.parametrize("moves", ["origin", "turn", "both"])
@pytest.mark.parametrize("rate", [20, 100, 1000])
def test_poses_keep_their_twist_and_what_turns_on_the_spot_is_not_at_rest(moves: str, rate: int) -> None:
    t = np.linspace(0.0, 1.0, rate + 1)
    axis, poses = np.array([0.48, 0.6, 0.64]), np.tile(np.eye(4), (len(t), 1, 1))
    twist = np.zeros(6)
    if moves != "origin":
        poses[:, :3, :3] = Rotation.from_rotvec(np.outer(0.8 * t, axis)).as_matrix()
        twist[3:] = 0.8 * axis
    if moves != "turn":
        poses[:, :3, 3] = np.outer(t, [0.1, -0.2, 0.3])
        twist[:3] = 0.1, -0.2, 0.3
    motion = from_points(poses, t)
    assert motion.ends == ("samples", "samples")
    dense = motion.sample(0.01)
    np.testing.assert_allclose(dense.xd, np.tile(twist, (len(dense), 1)), atol=1e-5)
    assert np.abs(dense.xdd).max() < 1e-3
    course = QUINTIC(t)[:, 0] - 0.7  # the same from rest to rest
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(course, axis)).as_matrix()
    poses[:, :3, 3] = np.outer(course, twist[:3])
    assert from_points(poses, t).ends == ("rest", "rest")


# ------------------------------------------------------------------------------------------------- files


def write(path: Path, names: str, rows: Array) -> Path:
    path.write_text("\n".join([names, *(",".join(map(repr, row)) for row in rows.tolist())]) + "\n", encoding="utf-8")
    return path


def test_files_hold_points_with_times_speeds_or_neither(tmp_path: Path) -> None:
    timed, speed = from_points(POINTS, TIMES).sample(0.1), [0.0, 0.2, 0.3, 0.1, 0.0]
    file = write(tmp_path / "way.csv", "t, x, y", np.column_stack([TIMES, POINTS]))
    np.testing.assert_array_equal(from_points(file).sample(0.1).x, timed.x)
    file = write(tmp_path / "way.csv", "x,y,time", np.column_stack([POINTS, TIMES]))
    np.testing.assert_array_equal(from_points(file).sample(0.1).x, timed.x)
    file = write(tmp_path / "fast.csv", "x,y,speed", np.column_stack([POINTS, speed]))
    np.testing.assert_array_equal(from_points(file).sample(0.1).x, from_points(POINTS, speed=speed).sample(0.1).x)
    file = write(tmp_path / "plain.csv", "x,y", POINTS)
    for content in (
        {"points": POINTS.tolist(), "t": TIMES.tolist()},
        {"points": POINTS.tolist(), "times": TIMES.tolist()},
    ):
        (tmp_path / "way.json").write_text(json.dumps(content), encoding="utf-8")
        np.testing.assert_array_equal(from_points(tmp_path / "way.json").sample(0.1).x, timed.x)
    (tmp_path / "way.json").write_text(json.dumps(POINTS.tolist()), encoding="utf-8")
    np.testing.assert_array_equal(from_points(tmp_path / "way.json", TIMES).sample(0.1).x, timed.x)


def test_files_hold_poses(tmp_path: Path) -> None:
    times = POSES_BY["times"]["times"]
    expected = from_points(POSES, times).sample(0.1).x
    rows = np.column_stack([times, TURNS.as_quat(), ORIGINS])
    file = write(tmp_path / "way.csv", "t,qx,qy,qz,qw,x,y,z", rows)  # by name, in any order
    np.testing.assert_allclose(from_points(file).sample(0.1).x, expected, atol=1e-12)
    (tmp_path / "way.json").write_text(json.dumps({"points": POSES.tolist(), "t": times}), encoding="utf-8")
    np.testing.assert_allclose(from_points(tmp_path / "way.json").sample(0.1).x, expected, atol=1e-12)


def test_a_constant_orientation_and_a_closed_path() -> None:
    motion = from_points(POINTS, speed=0.2, alpha=0.3, closed=True)
    dense = motion.sample(0.01)
    assert (dense.x[:, 2] == 0.3).all()
    np.testing.assert_allclose(dense.x[0], dense.x[-1], atol=1e-9)
    speeds = [0.1, 0.2, 0.3, 0.1, 0.1]
    around = from_points(POINTS, speed=speeds, closed=True)
    assert np.linalg.norm(around.evaluate(around.duration).xd) == pytest.approx(0.1)


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "neither": ({}, "Neither times nor speed"),
    "both": ({"times": TIMES, "speed": 0.1}, "Both times and speed"),
    "word": ({"times": "fast"}, "times is 'fast'"),
    "backwards": ({"times": TIMES[::-1]}, "times must increase"),
    "too few times": ({"times": [0.0, 1.0]}, r"times has shape \(2,\)"),
    "a limit without use": ({"speed": 0.1, "max_speed": 1.0}, "max_speed is given, and has no effect.*time-optimal"),
    "ramps of times": ({"times": TIMES, "ramp_time": 1.0}, "ramp_time is given.*one cruising speed"),
    "no limit": ({"times": "time-optimal", "max_speed": 1.0}, "needs max_acceleration"),
    "negative limit": ({"times": "time-optimal", "max_speed": 1.0, "max_acceleration": -1.0}, "max_acceleration is -1"),
    "limits of others": ({"times": "time-optimal", "max_speed": [1.0] * 3, "max_acceleration": 1.0}, "3 values"),
    "unlike limits": ({"times": "time-optimal", "max_speed": [1.0] * 2, "max_acceleration": 1.0}, "different numbers"),
    "three speeds": ({"speed": [0.1] * 3}, "3 values for 5 points"),
    "negative speed": ({"speed": [0.0, 0.1, -0.1, 0.1, 0.0]}, r"speed\[2\] is -0.1"),
    "two stops": ({"speed": [0.0, 0.1, 0.0, 0.0, 0.1]}, r"speed\[2\] and speed\[3\] are zero"),
    "text": ({"times": TIMES, "alpha": "x"}, "values is not an array of numbers"),
    "ends of a cruise": ({"speed": 0.1, "ends": "rest"}, "ends is given.*points with times"),
    "ends": ({"times": TIMES, "ends": "still"}, "ends is 'still'. Pass one of auto, rest, samples"),
    "three ends": ({"times": TIMES, "ends": ["rest", "rest", "rest"]}, "or a pair of them"),
    "closed times": ({"times": TIMES, "closed": True}, "closed is for coordinates"),
    "times no spline can take": ({"times": [0.0, 1e-300, 1.0, 2.0, 3.0]}, "numbers 0 and 1 are 1e-300 s apart, of 3 s"),
    "times that lose all digits": ({"times": [0.0, 1e-9, 1.0, 2.0, 1e9]}, "Space them more evenly"),
    "a speed that is none": ({"speed": 1e-300}, "speed is 1e-300 m/s, expected one from 1e-100 to 1e[+]100"),
    "a speed beyond all": ({"speed": 1e101}, "speed is 1e[+]101 m/s"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_makes_no_motion_is_said(name: str) -> None:
    arguments, says = REFUSED[name]
    with pytest.raises(InputError, match=says):
        from_points(POINTS, **arguments)


def test_poses_that_make_no_spline_are_said() -> None:
    on_the_spot = POSES.copy()
    on_the_spot[:, :3, 3] = 0.0
    with pytest.raises(InputError, match="coincide"):
        from_points(on_the_spot, speed=0.1)
    far = POSES.copy()
    far[1, :3, :3] = Rotation.from_rotvec([np.pi, 0.0, 0.0]).as_matrix()
    with pytest.raises(InputError, match="half a turn apart"):
        from_points(far, [0.0, 1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="not a homogeneous pose"):
        from_points(2.0 * POSES, [0.0, 1.0, 2.0, 3.0])
    with pytest.raises(InputError, match="two numbers"):
        from_points(POSES, "time-optimal", max_speed=1.0, max_acceleration=1.0)


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("way.csv", "t,x\n0,1\n1,two\n", "row 3, column 'x': 'two'"),
        ("way.csv", "t\n0\n1\n", "no coordinates"),
        (
            "way.csv",
            "x,y\n0,0\n1,1\n",
            "given, and .*way.csv has neither t nor speed. Give it a column t, or .*csv:speed=0.1",
        ),
        ("way.csv", "0,0\n1,1\n2,3\n", "begins with numbers, '0, 0', where the names of its columns should stand"),
        ("way.csv", "t;x;y\n0;0,5;1\n", "one column, 't;x;y': semicolons are between its names. Put commas"),
        ("way.csv", "t,x0,xd0,xdd0\n0,0,0,0\n1,1,0,0\n", "sampled motion"),
        ("way.json", '{"points": [[0, 1], [2]], "t": [0, 1]}', "points is not an array"),
        ("way.json", '{"pionts": [[0, 1]]}', "'pionts'"),
        ("way.json", "{", "not JSON"),
        ("way.json", "3", "no list of points"),
        ("way.json", '[{"x": 1}, {"y": 1}]', r'no list of points.*"points": \[\[x, y\]'),
        ("way.txt", "t,x\n0,1\n", "neither .csv nor .json"),
    ],
)
def test_files_that_hold_no_points_are_named(name: str, text: str, says: str, tmp_path: Path) -> None:
    (tmp_path / name).write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=says):
        from_points(tmp_path / name)


def test_a_first_row_of_numbers_is_no_name(tmp_path: Path) -> None:
    """With a speed the first of three points was dropped, and the motion went through the other two."""
    (tmp_path / "way.csv").write_text("0.25,0.7\n0.3,0.75\n0.2,0.72\n", encoding="utf-8")
    with pytest.raises(InputError, match=r"begins with numbers, '0.25, 0.7'.*t,x,y for points"):
        from_points(tmp_path / "way.csv", speed=0.1)
    file = write(tmp_path / "one.csv", "crank angle", np.array([[0.0], [1.0]]))  # a name may hold a blank
    assert from_points(file, [0.0, 1.0]).dimension == 1


def test_a_file_has_no_more_points_than_a_spline_may(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Three million took 17 s and 0.9 GB before they were refused for the samples they make."""
    assert files_of_points.MOST_POINTS <= 100_000
    monkeypatch.setattr(files_of_points, "MOST_POINTS", 100)
    place = tmp_path / "way.csv"
    place.write_text("x\n" + "1\n" * 100, encoding="utf-8")
    assert len(files_of_points.read_points(place)[0]) == 100
    place.write_text("x\n" + "1\n" * 101, encoding="utf-8")
    with pytest.raises(InputError, match="has more than 100 rows"):
        files_of_points.read_points(place)


def test_times_of_a_file_are_not_overridden_in_silence(tmp_path: Path) -> None:
    file = write(tmp_path / "way.csv", "t,x,y", np.column_stack([TIMES, POINTS]))
    with pytest.raises(InputError, match="times of its own, and speed"):
        from_points(file, speed=0.1)


@pytest.mark.parametrize(("names", "order"), [("t,y,x", [1, 0]), ("t,z,x,y", [1, 2, 0]), ("t,yaw,x,y", [1, 2, 0])])
def test_coordinates_of_a_file_are_taken_by_name(names: str, order: list[int], tmp_path: Path) -> None:
    rows = np.random.default_rng(3).uniform(size=(len(TIMES), len(order)))
    file = write(tmp_path / "way.csv", names, np.column_stack([TIMES, rows]))
    points = from_points(file).evaluate(TIMES - TIMES[0]).x
    np.testing.assert_allclose(points, rows[:, order], atol=1e-12)


@pytest.mark.parametrize("names", ["t,x,y,z,roll,pitch,yaw", "x,y,z,yaw", "x,Roll", "t,x,y,yaw,pitch"])
def test_angles_of_a_pose_are_refused_with_what_to_do(names: str, tmp_path: Path) -> None:
    file = write(tmp_path / "way.csv", names, np.random.default_rng(3).uniform(size=(5, names.count(",") + 1)))
    with pytest.raises(InputError, match=r"qx, qy, qz, qw \(scipy"):
        from_points(file, None if names[0] == "t" else TIMES)
