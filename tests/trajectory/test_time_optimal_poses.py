"""As fast as limits allow: some limit of a pose is met all the time, none exceeded; mirrored and turned paths."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import PoseLine, from_points, through_points
from redundancy_pin.trajectory.time_optimal import fastest_law, least_duration

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
    """By sampling: what is beyond between the instants of the law is less than 1e-3.

    Switches, of 2 % of the duration each, take the most of a tenth of it; elsewhere 2 % are left.
    """
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
    assert used.max() <= 1.0 + 1e-3
    assert np.quantile(used, 0.1) >= 0.9
    assert np.quantile(used, 0.2) >= 0.975


@pytest.mark.parametrize("mirror", [(-1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)])
@pytest.mark.parametrize(("speed", "acceleration"), [((9.0, 9.0), (2.0, 3.0)), ((0.4, 0.5), (3.0, 2.0))])
def test_mirrored_paths_take_the_same_time(mirror, speed, acceleration):
    """Limits are the same in both directions of a coordinate; on the same path, mirrored, only rounding differs."""
    there = least_duration(through_points(BENT * mirror), speed, acceleration)
    assert there == pytest.approx(least_duration(through_points(BENT), speed, acceleration), rel=1e-9)


@pytest.mark.parametrize("angle", [0.3, 1.2, 2.9])
def test_turned_paths_take_the_same_time_under_a_limit_of_the_norm(angle):
    turn = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
    there = least_duration(through_points(BENT @ turn.T), 0.5, 2.0)
    assert there == pytest.approx(least_duration(through_points(BENT), 0.5, 2.0), rel=1e-6)  # steps halved elsewhere


def test_a_line_between_equal_poses_has_no_least_time() -> None:
    with pytest.raises(InputError, match=r"stands still.*RestToRest"):
        fastest_law(PoseLine(np.eye(4), np.eye(4)), [1.0, 1.0], [1.0, 1.0])
