"""Poses as fast as limits allow: some limit is met all the time, of origin or rotation, and none exceeded."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from redundancy_pin.trajectory import from_points


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
