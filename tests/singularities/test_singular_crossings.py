"""Crossing times against the analytic times of lines, circles and turns, what was built to touch, and known zeros."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import zoo
from examples import examples
from hypothesis import example, given
from hypothesis import strategies as st
from scipy.optimize import brentq

import redundancy_pin as rp
from redundancy_pin.errors import InputError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.singularities.classify import SingularityKind
from redundancy_pin.singularities.crossings import Crossing, _sampling_times, find_crossings
from redundancy_pin.singularities.roots import below_zero, minima, zeros
from redundancy_pin.trajectory import (
    PoseLine,
    RestToRest,
    Trajectory,
    circle_path,
    reference,
    through_points,
    with_constant,
)
from redundancy_pin.trajectory.continuous_motion import as_motion

TIME = 1e-11
"""Brent's method stops at 1e-13 of the duration (seconds here), the margin is exact to 1e-15."""


ARM = 0.25 * np.array([np.cos(np.pi / 6), np.sin(np.pi / 6)])
"""From corner 1 of the 3-RRR's platform to its centre, at α = 0."""


def along(path, duration: float = 2.0) -> Trajectory:
    return Trajectory(path, RestToRest(path.length, duration))


def time_at_arc(trajectory: Trajectory, p: float) -> float:
    """Return when arc length p is reached, by root finding on the timing law alone."""
    return float(brentq(lambda t: float(trajectory.timing.evaluate(t).p) - p, 0.0, trajectory.duration, xtol=1e-15))


def test_circle_of_the_thesis_crosses_the_base_line_twice() -> None:
    robot, trajectory = zoo.robot_of("2rpr"), reference.circle()
    crossings = find_crossings(robot, trajectory)
    angle = np.arcsin(0.185 / 0.2)
    arcs = [0.2 * angle, 0.2 * (np.pi - angle)]  # from the leftmost point, counter-clockwise
    assert [crossing.t for crossing in crossings] == pytest.approx([time_at_arc(trajectory, p) for p in arcs], abs=TIME)
    assert [crossing.x[0] for crossing in crossings] == pytest.approx(
        [0.25 - 0.2 * np.cos(angle), 0.25 + 0.2 * np.cos(angle)]
    )
    for crossing in crossings:
        assert crossing.kind == SingularityKind.TYPE_II
        assert crossing.crosses
        assert not crossing.tangential
        assert crossing.until == crossing.t
        assert crossing.leg is None
        assert abs(crossing.x[1]) < 1e-11
        np.testing.assert_allclose(np.abs(crossing.uncontrolled_twist), [0.0, 1.0], atol=1e-9)
        assert np.isnan(crossing.lost_direction).all()
    assert crossings[0].slope < 0.0 < crossings[1].slope


@examples(6)
@given(st.floats(0.05, 0.45), st.floats(-0.4, 0.4), st.floats(0.05, 0.5), st.floats(0.05, 0.5))
@example(0.15 + 0.1 * 0.4 / 1.1, -0.1 / 1.1, 0.4, 0.7)  # the line of the thesis
def test_any_line_through_the_base_line_is_crossed_where_it_meets_it(x, lean, above, below) -> None:
    start, end = np.array([x + lean * above, above]), np.array([x - lean * below, -below])
    if np.abs(x + lean * np.linspace(-below, above, 50)).min() < 0.0:
        return
    trajectory = along(through_points([start, end]))
    (crossing,) = find_crossings(zoo.robot_of("2rpr"), trajectory)
    assert crossing.t == pytest.approx(time_at_arc(trajectory, np.hypot(1.0, lean) * above), abs=1e-10)
    assert crossing.x == pytest.approx([x, 0.0], abs=1e-11)


def test_samples_are_interpolated_and_two_sided_ones_understood() -> None:
    """A corner sampled with its jumps, and a circle sampled at 10 ms, cross where the exact motions do."""
    robot = zoo.robot_of("2rpr")
    exact = reference.circle()
    sampled = find_crossings(robot, exact.sample(0.01))
    assert [c.t for c in sampled] == pytest.approx([c.t for c in find_crossings(robot, exact)], abs=1e-9)
    half = PlatformMotion(
        [0.0, 1.0, 1.0, 2.0],  # x = 0.2, y falls at 0.2 m/s, then is braked from t = 1 at 0.1 m/s²
        [[0.2, 0.25], [0.2, 0.05], [0.2, 0.05], [0.2, -0.1]],
        [[0.0, -0.2], [0.0, -0.2], [0.0, -0.2], [0.0, -0.1]],
        [[0.0, 0.0], [0.0, 0.0], [0.0, 0.1], [0.0, 0.1]],
    )
    (crossing,) = find_crossings(robot, half)
    assert crossing.t == pytest.approx(1.0 + (0.2 - np.sqrt(0.04 - 4 * 0.05 * 0.05)) / 0.1, abs=TIME)


@pytest.mark.parametrize("depth", [1e-3, 1e-7, 0.0, -1e-5])
def test_a_circle_that_dips_into_the_locus_crosses_twice_touches_or_misses(depth: float) -> None:
    """A pair of crossings inside one step is not missed."""
    trajectory = along(circle_path((0.25, 0.2 - depth), 0.2, start_angle=np.pi))
    crossings = find_crossings(zoo.robot_of("2rpr"), trajectory)
    angle = np.arcsin(min((0.2 - depth) / 0.2, 1.0))
    if depth > 0.0:
        times = [time_at_arc(trajectory, arc) for arc in (0.2 * angle, 0.2 * (np.pi - angle))]
        assert [c.t for c in crossings] == pytest.approx(times, abs=TIME + 1e-16 / depth)
        assert all(c.crosses for c in crossings)
    elif depth == 0.0:
        (touch,) = crossings
        assert not touch.crosses
        assert touch.tangential
        assert touch.x == pytest.approx([0.25, 0.0], abs=1e-6)
    else:
        assert crossings == ()


@pytest.mark.parametrize("points", [[[0.1, 0.3], [0.1, 0.0]], [[0.1, 0.0], [0.1, 0.3]]])
def test_a_motion_that_ends_or_starts_on_the_locus(points: list[list[float]]) -> None:
    (end,) = find_crossings(zoo.robot_of("2rpr"), along(through_points(points)))
    assert end.t == (2.0 if points[1][1] == 0.0 else 0.0)
    assert end.kind == SingularityKind.TYPE_II
    assert not end.crosses


def test_a_motion_along_the_locus_is_one_stay() -> None:
    (stay,) = find_crossings(zoo.robot_of("2rpr"), along(through_points([[0.1, 0.0], [0.4, 0.0]])))
    assert (stay.t, stay.until) == (0.0, 2.0)
    assert not stay.crosses
    assert stay.tangential


@pytest.mark.parametrize("ends", [True, False])
def test_a_motion_that_ends_or_starts_at_full_stretch(ends: bool) -> None:
    inside, border = [0.9, 0.5], ARM + 2.0 * np.array([np.cos(0.5), np.sin(0.5)])
    trajectory = along(with_constant(through_points([inside, border] if ends else [border, inside]), [0.0]))
    touches = [c for c in find_crossings(zoo.robot_of("3rrr"), trajectory) if c.kind == SingularityKind.TYPE_I]
    assert [(c.t, c.leg) for c in touches] == [(2.0 if ends else 0.0, 1)]


def test_a_motion_is_followed_from_a_start_farther_away() -> None:
    """The start is half a workspace from the first pose, and in another working mode than the declared one."""
    robot, other = zoo.robot_of("five_bar"), zoo.robot_of("five_bar", working_mode=(1, 1))
    home = np.array([0.25, 0.6])
    still = PlatformMotion([0.0], [home], [[0.0, 0.0]], [[0.0, 0.0]])
    start = inverse_kinematics(other, still).state(0)
    trajectory = along(through_points([[0.3, 0.1], [0.45, -0.2]]))
    (one,), (same,) = find_crossings(other, trajectory), find_crossings(robot, trajectory, start=start)
    assert one.t == pytest.approx(same.t, abs=TIME)
    np.testing.assert_allclose(one.q, same.q, atol=1e-10)


def test_leaving_the_workspace_names_the_time() -> None:
    u = np.array([np.cos(0.5), np.sin(0.5)])
    start, end = ARM + 1.5 * u, ARM + 2.1 * u
    trajectory = along(with_constant(through_points([start, end]), [0.0]))
    with pytest.raises(UnreachablePoseError, match="leaves the workspace at t = ") as caught:
        find_crossings(zoo.robot_of("3rrr"), trajectory)
    assert caught.value.details["time"] == pytest.approx(time_at_arc(trajectory, 0.5), abs=1e-8)


@pytest.mark.parametrize(
    "angle", [pytest.param(40.0, marks=pytest.mark.long), 50.0, pytest.param(60.0, marks=pytest.mark.long)]
)
def test_a_smooth_motion_may_start_with_a_leg_stretched(angle: float) -> None:
    """Leg 1 is 1 m long at full stretch; the first samples of a rest-to-rest law are 1e-10 m from there."""
    stretched = [np.cos(np.radians(angle)), np.sin(np.radians(angle))]
    (crossing,) = find_crossings(zoo.robot_of("five_bar"), along(through_points([stretched, [0.25, 0.7]])))
    assert (crossing.t, crossing.kind, crossing.leg) == (pytest.approx(0.0, abs=1e-3), SingularityKind.TYPE_I, 1)
    assert not crossing.crosses


@pytest.mark.parametrize(("start", "first"), [(1.2, 0), (np.sqrt(1.0 - 0.25**2), 1)])
def test_a_first_pose_out_of_reach_is_named_by_its_time(start: float, first: int) -> None:
    """From outside, or from the border (both legs of 1 m stretched) outward; the search has 400 steps here."""
    law = PlatformMotion(
        [0.0, 1.0], [[0.25, start], [0.25, start + 0.2]], [[0.0, 0.2], [0.0, 0.2]], [[0.0, 0.0], [0.0, 0.0]]
    )
    with pytest.raises(UnreachablePoseError, match="at t = ") as caught:
        find_crossings(zoo.robot_of("five_bar"), law)
    assert caught.value.details["time"] == pytest.approx(first / 400.0)
    assert "sample" not in caught.value.details
    assert "sample" not in caught.value.message


def test_a_path_outside_before_its_first_regular_sample_names_the_border() -> None:
    """From the border outward at 0.1 mm/s, accelerated inward by 0.2 m/s²: inside again after 1 ms, within one step."""
    border, v, a = np.sqrt(1.0 - 0.25**2), 1e-4, -0.2
    law = PlatformMotion(
        [0.0, 1.0], [[0.25, border], [0.25, border + v + 0.5 * a]], [[0.0, v], [0.0, v + a]], [[0.0, a], [0.0, a]]
    )
    with pytest.raises(UnreachablePoseError, match="leaves the workspace at t = ") as caught:
        find_crossings(zoo.robot_of("five_bar"), law)
    assert caught.value.details["time"] == pytest.approx(-2.0 * v / a, abs=1e-6)


@pytest.mark.parametrize("modes", [True, False])
def test_a_leg_that_turns_round_within_one_step_is_followed(modes: bool) -> None:
    """70 µm from its base hinge the leg of a 2-RPR makes half a turn; the path meets the base line behind the hinge."""
    robot = zoo.robot_of("2rpr") if modes else replace(zoo.robot_of("2rpr"), working_modes=None, working_mode=())
    trajectory = along(through_points([[-0.1, 0.1], [0.1001, -0.0999]]))
    (crossing,) = find_crossings(robot, trajectory)
    assert crossing.kind == SingularityKind.TYPE_II
    assert crossing.x == pytest.approx([0.1 * 0.2001 / 0.1999 - 0.1, 0.0], abs=1e-11)
    swivels = [zoo.index(robot, f"swivel_{leg}") for leg in (1, 2)]
    turned = np.abs(np.angle(np.exp(1j * (crossing.q[swivels] - [0.0, np.pi]))))
    assert turned.max() < 1e-9


@pytest.mark.parametrize("modes", [True, False])
def test_a_path_through_the_hinge_of_a_leg_is_refused(modes: bool) -> None:
    """There the leg has no length, and turns by half a turn at once."""
    robot = zoo.robot_of("2rpr") if modes else replace(zoo.robot_of("2rpr"), working_modes=None, working_mode=())
    with pytest.raises(WorkingModeError, match="cannot be followed"):
        find_crossings(robot, along(through_points([[-0.1, 0.13], [0.1, -0.13]])))


def test_five_bar_crosses_where_its_distal_links_align() -> None:
    """On the axis of symmetry with elbows outward: both distal links horizontal, elbows at ±0.5 m from the axis."""
    trajectory = along(through_points([[0.25, 0.7], [0.25, 0.2]]))
    (crossing,) = find_crossings(zoo.robot_of("five_bar"), trajectory)
    height = np.sqrt(0.5**2 - 0.25**2)  # elbow at (−0.25, h): proximal link 0.5 m from (0, 0)
    assert crossing.x == pytest.approx([0.25, height], abs=1e-10)
    assert crossing.t == pytest.approx(time_at_arc(trajectory, 0.7 - height), abs=TIME)
    np.testing.assert_allclose(np.abs(crossing.uncontrolled_twist), [0.0, 1.0], atol=1e-9)


@pytest.mark.parametrize(("mode", "combined"), [((1, 1), True), ((1, -1), False)])
def test_a_stretched_leg_with_the_other_distal_link_in_line_is_combined(mode: tuple[int, int], combined: bool) -> None:
    """Leg 1 of the five-bar is stretched at 60° where both elbows may coincide: the tip then turns about them."""
    along_leg, across = np.array([0.5, np.sqrt(0.75)]), np.array([np.sqrt(0.75), -0.5])
    trajectory = along(through_points([[0.3, 0.5], along_leg.tolist()]))
    (end,) = find_crossings(zoo.robot_of("five_bar", working_mode=mode), trajectory)
    assert (end.kind, end.leg) == (SingularityKind.COMBINED if combined else SingularityKind.TYPE_I, 1)
    np.testing.assert_allclose(end.lost_direction, along_leg, atol=1e-6)
    np.testing.assert_allclose(end.uncontrolled_twist, across if combined else [np.nan] * 2, atol=1e-6)


def test_gough_platform_is_singular_a_quarter_turn_from_home() -> None:
    """Fichter 1986: two similar hexagons with six legs are singular after a turn of 90° about their common axis."""
    robot = zoo.robot_of("gough")
    home = zoo.home_of(robot)

    def turned(angle: float):
        pose = home.copy()
        cosine, sine = np.cos(angle), np.sin(angle)
        pose[:3, :3] = np.array([[cosine, -sine, 0.0], [sine, cosine, 0.0], [0.0, 0.0, 1.0]]) @ home[:3, :3]
        return pose

    trajectory = Trajectory(PoseLine(turned(0.0), turned(np.radians(100.0))), RestToRest(1.0, 2.0))
    (crossing,) = find_crossings(robot, trajectory)
    assert crossing.kind == SingularityKind.TYPE_II
    assert crossing.t == pytest.approx(time_at_arc(trajectory, 0.9), abs=1e-9)
    (sampled,) = find_crossings(robot, trajectory.sample(0.02))
    assert sampled.t == pytest.approx(crossing.t, abs=1e-5)  # cubic rotation vectors between samples 20 ms apart


def test_one_instant_and_silly_numbers_are_refused() -> None:
    robot = zoo.robot_of("2rpr")
    still = PlatformMotion([0.0], [[0.2, 0.2]], [[0.0, 0.0]], [[0.0, 0.0]])
    with pytest.raises(InputError, match="single instant"):
        find_crossings(robot, still)
    with pytest.raises(InputError, match="spacing"):
        find_crossings(robot, reference.circle(), spacing=0.0)
    with pytest.raises(InputError, match="moves in"):
        find_crossings(zoo.robot_of("3rrr"), reference.circle())


def test_a_regular_motion_has_none(shipped) -> None:
    motion = zoo.smooth_motion(shipped, seed=2).at(np.linspace(0.0, 1.0, 60))
    crossings: tuple[Crossing, ...] = find_crossings(shipped, motion)
    assert crossings == ()


# --- limits met to rounding are met


@pytest.mark.parametrize(("leg", "hinge", "angle"), [(1, 0.0, 50.0), (2, 0.5, 130.0)])
@pytest.mark.parametrize("inside", [1e-12, pytest.param(1e-13, marks=pytest.mark.long), 0.0])
def test_a_touch_from_rounding_inside_is_no_way_out(leg: int, hinge: float, angle: float, inside: float) -> None:
    """Quintics through rounded samples leave it by 1e-12 m next to the touch, a tenth of the closure tolerance."""
    t, step = np.linspace(0.0, 1.0, 201), 1e-5

    def tip(time: np.ndarray) -> np.ndarray:
        turned, reach = np.deg2rad(angle) + 0.6 * (time - 0.503), 1.0 - inside - 0.4 * (time - 0.503) ** 2
        return np.column_stack([hinge + reach * np.cos(turned), reach * np.sin(turned)])

    before, here, after = tip(t - step), tip(t), tip(t + step)
    rates = (after - before) / (2.0 * step), (after - 2.0 * here + before) / step**2
    met = find_crossings("five_bar", rp.PlatformMotion(t, here, *rates, check_rates=False))
    assert met or inside < 1e-12
    for crossing in met:
        assert (crossing.kind, crossing.leg) == (SingularityKind.TYPE_I, leg)
        assert crossing.t == pytest.approx(0.503, abs=1e-5)


# --- the finder of zeros, touches and dips, on functions whose zeros are known


TIMES = np.linspace(0.0, 2.0, 41)
ROUNDING = 1e-14


@example([1.96875, 1.984375])  # both in the last step
@given(st.lists(st.floats(0.01, 1.99), min_size=1, max_size=4, unique=True).map(sorted))
def test_simple_zeros_are_all_found_however_near(roots: list[float]) -> None:
    if np.diff([0.0, *roots]).min() < 2e-4:  # closer pairs leave a dip that is zero within the tolerance
        return
    if any(sum(lo <= r <= lo + 0.1 for r in roots) > 2 for lo in TIMES):  # at most one dip between two samples
        return
    intervals = zeros(lambda t: np.prod([np.sin(t - r) for r in roots], axis=0), TIMES, 1e-13)
    assert [one.t for one in intervals] == pytest.approx(roots, abs=1e-9)
    assert all(one.crosses and one.until == one.t for one in intervals)


@pytest.mark.parametrize("at", [0.4, 0.512345, 1.9999, 0.05])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_touches_of_either_kind(at: float, sign: float) -> None:
    (smooth,) = zeros(lambda t: sign * (t - at) ** 2, TIMES, 1e-12)
    (sharp,) = zeros(lambda t: sign * np.abs(t - at), TIMES, 1e-12)
    (cusp,) = zeros(lambda t: sign * np.sqrt(np.abs(t - at)), TIMES, 1e-6)
    assert smooth.t == pytest.approx(at, abs=1e-6)
    assert sharp.t == pytest.approx(at, abs=ROUNDING)
    assert cusp.t == pytest.approx(at, abs=1e-12)
    assert not smooth.crosses
    assert not sharp.crosses


def test_a_near_miss_and_a_constant_are_no_zeros() -> None:
    for function in (lambda t: np.full(len(t), 0.3), lambda t: (t - 0.77) ** 2 + 1e-6):
        assert zeros(function, TIMES, 1e-9) == []


def test_a_stay_has_a_beginning_and_an_end() -> None:
    (stay,) = zeros(lambda t: np.maximum(t - 1.213, 0.0) - np.maximum(0.62 - t, 0.0), TIMES, 1e-9)
    assert (stay.t, stay.until) == pytest.approx((0.62, 1.213), abs=2e-9)
    assert stay.crosses
    (ends,) = zeros(lambda t: np.maximum(1.0 - t, 0.0), TIMES, 1e-9)
    assert (ends.t, ends.until) == (pytest.approx(1.0, abs=2e-9), 2.0)


def test_steps_with_a_value_that_is_not_finite_are_left_alone() -> None:
    def pole(t: np.ndarray) -> np.ndarray:
        return np.where(np.abs(t - 1.0) < 0.06, np.nan, 1.0 / np.where(t == 1.0, 1.0, t - 1.0) + 2.0)

    assert [one.t for one in zeros(pole, TIMES, 1e-12)] == pytest.approx([0.5])


def test_minima_between_or_on_samples_are_found_once_if_low_enough() -> None:
    function = lambda t: np.abs(np.sin(3.0 * t)) + 0.5 * t  # noqa: E731
    assert [t for t, _ in minima(function, TIMES, np.inf)] == pytest.approx([0.0, np.pi / 3.0, 2.0], abs=ROUNDING)
    assert [t for t, _ in minima(function, TIMES, 0.1)] == [0.0]
    for at in (0.525, 0.5, 1.275):
        ((t, value),) = minima(lambda t, at=at: np.abs(t - at), TIMES, 0.01)
        assert (t, value) == pytest.approx((at, 0.0), abs=ROUNDING)


@examples(100)
@given(centre=st.floats(0.05, 0.95), width=st.floats(1e-7, 0.02), slope=st.floats(0.1, 10.0))
def test_short_window_is_not_missed(centre, width, slope):
    """A sharp dip, as the smallest singular value makes it: below zero over a width far below the sampling."""

    def function(t):
        return slope * (np.abs(t - centre) - width)

    intervals = below_zero(function, np.linspace(0.0, 1.0, 33))
    assert len(intervals) == 1
    assert intervals[0].start == pytest.approx(centre - width, abs=1e-12)
    assert intervals[0].end == pytest.approx(centre + width, abs=1e-12)
    ((t, value),) = minima(lambda times: np.abs(times - centre), np.linspace(0.0, 1.0, 33), 1e-9)
    assert t == pytest.approx(centre, abs=1e-14)
    assert value < 1e-14


@examples(100)
@given(centre=st.floats(0.1, 0.9), depth=st.floats(1e-9, 1e-3))
def test_shallow_smooth_dip_is_not_missed(centre, depth):
    intervals = below_zero(lambda t: (t - centre) ** 2 - depth, np.linspace(0.0, 1.0, 33))
    assert len(intervals) == 1
    assert intervals[0].end - intervals[0].start == pytest.approx(2.0 * np.sqrt(depth), rel=1e-6)


def test_intervals_at_the_ends_are_open():
    intervals = below_zero(lambda t: 0.25 - np.abs(t - 0.5), np.linspace(0.0, 1.0, 33))
    assert [(i.open_start, i.open_end) for i in intervals] == [(True, False), (False, True)]
    assert intervals[0].end == pytest.approx(0.25, abs=1e-14)


def shaken(frequency: float, duration: float = 1.0) -> PlatformMotion:
    """A 2-RPR shaken across its singular line y = 0, 20 samples a period."""
    t = np.linspace(0.0, duration, round(20 * frequency * duration) + 1)
    turn, rest = 2.0 * np.pi * frequency, 0.0 * t
    y, yd = 0.02 + 0.03 * np.sin(turn * t), 0.03 * turn * np.cos(turn * t)
    return PlatformMotion(
        t, *(np.stack(pair, axis=1) for pair in ((rest + 0.25, y), (rest, yd), (rest, turn**2 * (0.02 - y))))
    )


@pytest.mark.parametrize("frequency", [50.0, 200.0, 310.0])
def test_no_oscillation_hides_between_the_samples_of_the_search(frequency: float) -> None:
    """At 200 Hz each of the 400 even steps is half a period: y is the same at all of them."""
    motion = as_motion(shaken(frequency))
    y = motion.sample_at(_sampling_times(rp.load_robot("2rpr"), motion, 0.01)).x[:, 1]
    assert (np.diff(np.sign(y)) != 0.0).sum() == 2 * frequency


def test_each_crossing_of_an_oscillation_is_found() -> None:
    assert len(find_crossings("2rpr", shaken(400.0, duration=0.02))) == 16
