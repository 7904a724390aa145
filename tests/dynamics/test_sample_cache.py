"""RNEA with a cache, as planners use it: what is asked again, or of a motion that repeats itself, is as without."""

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.dynamics.rnea import RneaDynamics

ROUNDING = 1e-12


def round_the_base(turns: int) -> rp.PlatformMotion:
    """A circle about the first base joint of the 2-RPR: a lap has the coordinates and rates of the last, bit by bit."""
    lap = np.linspace(0.0, 2.0 * np.pi, 60, endpoint=False)
    unit = np.stack([np.cos(lap), np.sin(lap)], axis=1)
    x, xd, xdd = 0.15 * unit, 0.15 * unit[:, ::-1] * [-1.0, 1.0], -0.15 * unit
    t = np.arange(turns * len(lap)) * (2.0 * np.pi / len(lap))
    return rp.PlatformMotion(t, *(np.tile(part, (turns, 1)) for part in (x, xd, xdd)), check_rates=False)


def test_every_lap_has_its_own_turn_of_the_leg() -> None:
    dynamics, motion = RneaDynamics(zoo.robot_of("2rpr")).with_cache(), round_the_base(3)
    q = dynamics.along(motion).q
    assert np.ptp(q, axis=0).max() == pytest.approx(6.0 * np.pi, rel=0.02)
    np.testing.assert_array_equal(dynamics.along(motion).q, q)
    np.testing.assert_allclose(q, RneaDynamics(dynamics.robot).along(motion).q, atol=ROUNDING)


@pytest.mark.parametrize("change", [{"xd": 1.1}, {"xdd": 1.1}, {"x": 0.99}])
def test_another_motion_at_the_same_instants_is_solved_anew(change: dict[str, float]) -> None:
    dynamics, corner = RneaDynamics(zoo.robot_of("3rrr")), rp.trajectory.reference.corner(radius=0.025).sample(0.01)
    parts = {name: getattr(corner, name) * change.get(name, 1.0) for name in ("x", "xd", "xdd")}
    other = rp.PlatformMotion(corner.t, **parts, check_rates=False)
    cached = dynamics.with_cache()
    cached.along(corner)
    ours, theirs = cached.along(other), dynamics.along(other)
    for got, expected in zip(ours.tree_motion(), theirs.tree_motion(), strict=True):
        np.testing.assert_allclose(got, expected, atol=1e-9)
    np.testing.assert_allclose(ours.reduce().W, theirs.reduce().W, atol=ROUNDING)


def test_samples_between_known_ones_are_on_their_branch() -> None:
    dynamics, corner = RneaDynamics(zoo.robot_of("3rrr")), rp.trajectory.reference.corner(radius=0.025)
    cached = dynamics.with_cache()
    cached.along(corner.sample(0.05))
    fine = corner.sample(0.01)
    ours, theirs = cached.along(fine), dynamics.along(fine)
    np.testing.assert_allclose(ours.q, theirs.q, atol=ROUNDING)
    np.testing.assert_allclose(ours.reduce().f, theirs.reduce().f, atol=1e-9)


def test_a_cache_is_of_one_object() -> None:
    """Nor does a robot with other loads share it."""
    dynamics = RneaDynamics(zoo.robot_of("3rrr"))
    motion = rp.trajectory.reference.corner(radius=0.025).sample(0.05)
    cached = dynamics.with_cache()
    force = np.array([0.0, 1.0, 0.0, 0.0, 0.0, 0.0])
    loaded = cached.with_external(rp.Wrench("platform", force))
    cached.along(motion)
    assert dynamics.along(motion).q is not None
    np.testing.assert_allclose(
        loaded.along(motion).reduce().f - cached.along(motion).reduce().f,
        np.tile([0.0, -1.0, 0.0], (len(motion), 1)),
        atol=1e-9,
    )


def test_what_is_cached_is_taken_up_on_the_same_whole_turn_only() -> None:
    """A part of the motion that begins between known samples begins near the reference, a whole turn before them."""
    plain = RneaDynamics(zoo.robot_of("2rpr"))
    cached, angles = plain.with_cache(), np.linspace(0.0, 3.0 * np.pi, 180)

    def along(angle: np.ndarray) -> rp.PlatformMotion:
        unit = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        rate, second = 0.15 * unit[:, ::-1] * [-1.0, 1.0], -0.15 * unit
        return rp.PlatformMotion(angle, 0.15 * unit, rate, second, check_rates=False)

    cached.along(along(angles))
    part = along(np.append(0.5 * (angles[150] + angles[151]), angles[151:160]))
    q = cached.along(part).q
    assert np.abs(np.diff(q, axis=0)).max() < 0.1
    np.testing.assert_allclose(q, plain.along(part).q, atol=1e-12)
