"""Time scaling: a motion along its path at another speed, against differences of its positions."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.paths import ChainedPath, Line, circle_path
from redundancy_pin.trajectory.time_scaling import ScaledMotion, TimeScaling

H = 1e-4
"""Of central differences, s: off by H² and by rounding over H²."""

RATES = st.lists(st.tuples(st.floats(0.02, 0.4), st.floats(0.0, 1.2), st.floats(0.1, 0.5)), min_size=1, max_size=4)
"""After how long, s, to which σ̇, and within how long."""


def scaled(changes, start=0.0):
    scaling, t = TimeScaling.none(start), start
    for after, rate, duration in changes:
        t += after
        scaling = scaling.changed(t, rate, duration)
    return scaling


SLOWER = scaled([(0.2, 0.4, 0.3), (0.4, 0.9, 0.25)])


@given(changes=RATES, start=st.floats(-1.0, 1.0))
@settings(deadline=None, max_examples=40)
def test_the_time_of_a_motion_has_two_derivatives_and_ends_at_the_rate_that_was_asked_for(changes, start) -> None:
    scaling = scaled(changes, start)
    inner = scaling.curve.edges[1:-1]
    for order in range(3):
        part = scaling.curve.derivative(order)
        np.testing.assert_allclose(part(inner, "left"), part(inner), atol=1e-9)
    t = np.linspace(start - 0.5, scaling.settled + 0.5, 400)
    t = t[np.abs(t[:, None] - np.append(inner, start)).min(axis=1) > 2.0 * H]
    sigma, rate, bend = scaling.at(t)
    before, after = scaling.at(t - H)[0], scaling.at(t + H)[0]
    np.testing.assert_allclose(rate, (after - before) / (2.0 * H), atol=1e-5)
    np.testing.assert_allclose(bend, (after - 2.0 * sigma + before) / H**2, atol=1e-3)
    assert scaling.final_rate == changes[-1][1]
    np.testing.assert_allclose(scaling.at([scaling.settled + 7.0])[1], changes[-1][1], atol=1e-12)
    assert scaling.at([start - 0.3])[0][0] == pytest.approx(start - 0.3, abs=1e-15)  # nothing had changed


@given(changes=RATES, at=st.floats(-0.4, 3.0))
@settings(deadline=None, max_examples=40)
def test_when_a_time_of_the_motion_is_reached(changes, at) -> None:
    scaling = scaled(changes)
    if scaling.rates[0] >= 0.0:
        sigma = float(scaling.at([at])[0][0])
        again = scaling.time_at(sigma)
        # where it stands still it is there earlier
        assert float(scaling.at([again])[0][0]) == pytest.approx(sigma, abs=1e-12)
        assert again <= at + 1e-12 or scaling.at([at])[1][0] < 1e-3 or again == pytest.approx(at, abs=1e-9)


def test_what_is_never_reached_is_reached_at_no_time() -> None:
    stops = scaled([(0.5, 0.0, 0.4)])
    assert stops.final_rate == 0.0
    rest = float(stops.at([10.0])[0][0])
    assert stops.time_at(rest + 1e-6) == np.inf
    assert 0.5 < stops.time_at(rest - 1e-6) < 0.9
    assert TimeScaling.none(0.0).time_at(np.inf) == np.inf
    assert TimeScaling.none(0.0).time_at(-np.inf) == -np.inf


def test_a_change_that_leads_back_says_so() -> None:
    falling = TimeScaling.none(0.0).changed(0.0, 0.1, 0.1)  # within which σ̈ is −13/s at most
    assert falling.rates == (pytest.approx(0.1, abs=1e-12), pytest.approx(1.0, abs=1e-12))
    least, most = falling.changed(0.05, 0.3, 1.0).rates
    assert least < -1.0
    assert most == pytest.approx(1.0, abs=1e-12)
    assert falling.changed(0.05, 0.3, 0.1).rates[0] > 0.1


def test_what_is_past_is_forgotten() -> None:
    scaling = scaled([(0.2, 0.4, 0.3), (1.0, 0.9, 0.25)])
    t = np.linspace(2.0, 4.0, 50)
    kept, all_of_it = scaling.changed(2.5, 0.5, 0.3, since=2.0), scaling.changed(2.5, 0.5, 0.3)
    assert (kept.start, all_of_it.start) == (2.0, 0.0)
    for own, other in zip(kept.at(t), all_of_it.at(t), strict=True):
        np.testing.assert_allclose(own, other, atol=1e-12)


def test_rates_are_those_of_the_positions() -> None:
    motion = as_motion(ScaledMotion(as_motion(reference.circle(speed=0.5)), SLOWER))
    assert motion.end > motion.source.motion.end + 0.1
    t = np.linspace(0.01, motion.end - 0.01, 300)
    t = t[np.abs(t[:, None] - motion.kinks).min(axis=1) > 2.0 * H]
    there, before, after = (motion.sample_at(t + shift) for shift in (0.0, -H, H))
    np.testing.assert_allclose(there.xd, (after.x - before.x) / (2.0 * H), atol=1e-6)
    np.testing.assert_allclose(there.xdd, (after.xd - before.xd) / (2.0 * H), atol=1e-5)
    # along the same path: it is the circle's place at another time, and its end
    np.testing.assert_allclose(there.x, motion.source.motion.sample_at(SLOWER.at(t)[0]).x, atol=1e-12)
    np.testing.assert_allclose(
        motion.sample_at(np.array([motion.end])).x[0],
        motion.source.motion.sample_at(np.array([motion.source.motion.end])).x[0],
        atol=1e-12,
    )


def test_knots_that_are_one_but_for_rounding_are_one() -> None:
    """A change of σ̇ begins at a tick, where the motion may have a knot; between both there is no time for samples."""
    base = as_motion(reference.circle(speed=0.5))
    knot = float(base.knots[0])
    for begin in (knot, np.nextafter(knot, 9.0), np.nextafter(knot, 0.0), knot + 1e-12):
        motion = as_motion(ScaledMotion(base, TimeScaling.none(0.0).changed(begin, 0.5, 0.2)))
        assert np.diff(motion.kinks).min() > 1e-9
        assert np.abs(motion.kinks - knot).min() < 1e-11
        assert len(motion.polynomials.edges) > 2  # samples in every piece


def test_poses_turn_at_the_rates_they_say() -> None:
    start, end = np.eye(4), np.eye(4)
    end[:3, :3], end[:3, 3] = pin.exp3(np.array([0.9, -0.5, 1.1])), (0.1, 0.2, -0.1)
    trajectory = reference.pose(start, end, 1.5, "3-4-5")
    motion = as_motion(ScaledMotion(as_motion(trajectory), SLOWER))
    t = np.linspace(0.05, motion.end - 0.05, 100)
    t = t[np.abs(t[:, None] - motion.kinks).min(axis=1) > 2.0 * H]
    there, before, after = (motion.sample_at(t + shift) for shift in (0.0, -H, H))
    turned = [pin.log3(b[:3, :3] @ a[:3, :3].T) for a, b in zip(before.x, after.x, strict=True)]
    np.testing.assert_allclose(there.xd[:, 3:], np.array(turned) / (2.0 * H), atol=1e-6)
    np.testing.assert_allclose(there.xdd, (after.xd - before.xd) / (2.0 * H), atol=1e-5)


@pytest.mark.parametrize("share", np.linspace(0.3, 0.9, 25))
def test_a_jump_of_the_acceleration_keeps_both_its_sides(share) -> None:
    """From an arc to a line it jumps; twice the same time asks for both, also where rounding moves it."""
    path = ChainedPath([Line((0.1, 0.0), (0.0, 0.0)), circle_path((0.0, 0.1), 0.1, start_angle=-np.pi / 2, sweep=-2.0)])
    motion = as_motion(Trajectory(path, SpeedProfile(path.length, 0.3, 0.2)))
    slower = scaled([(0.2, share, 0.3), (0.4, 0.93, 0.25)])
    slowed = ScaledMotion(motion, slower)
    assert len(motion.breaks) == 1
    (own,), (at,) = motion.breaks.tolist(), slowed.breaks.tolist()
    sigma, rate, bend = (float(part[0]) for part in slower.at([at]))
    assert sigma == pytest.approx(own, abs=1e-12)
    assert rate < 0.95
    both, source = slowed.sample_at([at, at]), motion.sample_at(np.array([own, own]))
    assert np.abs(np.diff(source.xdd, axis=0)).max() > 0.5
    np.testing.assert_allclose(both.xdd, source.xdd * rate**2 + source.xd * bend, atol=1e-12)
