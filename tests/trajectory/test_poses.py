import numpy as np
import pytest
from scipy.linalg import expm, logm
from scipy.spatial.transform import Rotation
from trajectory_checks import clear_of, differentiate

from redundancy_pin.errors import InputError
from redundancy_pin.trajectory import PoseLine, SpeedProfile, Trajectory, reference


def _skew(w):
    return np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])


def _pose(vector, place):
    pose = np.eye(4)
    pose[:3, :3] = expm(_skew(vector))
    pose[:3, 3] = place
    return pose


START, END = _pose([0.2, -0.1, 0.4], [0.1, 0.0, 0.5]), _pose([-0.5, 0.8, 0.3], [0.0, 0.2, 0.7])


def test_rows_of_position_and_quaternion_are_poses():
    rows = [[*each[:3, 3], *Rotation.from_matrix(each[:3, :3]).as_quat()] for each in (START, END)]
    expected, got = (reference.pose(*ends, 1.5).sample(0.1) for ends in ((START, END), rows))
    for name in ("x", "xd", "xdd"):
        np.testing.assert_allclose(getattr(got, name), getattr(expected, name), atol=1e-12)
    with pytest.raises(InputError, match="end: the quaternion"):
        reference.pose(rows[0], [*rows[1][:6], 3.0])


def test_starts_and_ends_in_the_given_poses_at_rest():
    motion = reference.pose(START, END, 1.5).sample(0.01)
    assert motion.is_pose
    assert motion.t[-1] == 1.5
    np.testing.assert_allclose(motion.x[[0, -1]], [START, END], atol=1e-14)
    np.testing.assert_allclose(motion.xd[[0, -1]], 0.0, atol=1e-14)
    np.testing.assert_allclose(motion.xdd[[0, -1]], 0.0, atol=1e-12)


def test_twist_and_its_rate_are_the_derivatives_in_world_axes():
    trajectory, step = reference.pose(START, END, 1.5, "3-4-5"), 1e-3
    t = clear_of([0.0, 1.5], step)
    rate = differentiate(lambda s: trajectory.evaluate(s).x, t, step)
    pose, twist, acceleration = trajectory.evaluate(t)
    spin = rate[:, :3, :3] @ pose[:, :3, :3].transpose(0, 2, 1)  # Ṙ Rᵀ = [ω]× with ω in world axes
    np.testing.assert_allclose(spin, [_skew(w) for w in twist[:, 3:]], atol=1e-11)
    np.testing.assert_allclose(rate[:, :3, 3], twist[:, :3], atol=1e-11)
    np.testing.assert_allclose(acceleration, differentiate(lambda s: trajectory.evaluate(s).xd, t, step), atol=1e-10)


def test_rotation_follows_one_world_axis():
    trajectory = reference.pose(START, END)
    half = trajectory.evaluate(0.5).x  # both polynomials are at one half at half time
    turn = logm(END[:3, :3] @ START[:3, :3].T)
    np.testing.assert_allclose(half[:3, :3], expm(0.5 * turn) @ START[:3, :3], atol=1e-13)
    np.testing.assert_allclose(half[:3, 3], 0.5 * (START + END)[:3, 3], atol=1e-15)


def test_any_timing_law_and_scaling():
    trajectory = Trajectory(PoseLine(START, END, 0.3), SpeedProfile(0.3, 0.2, 0.1))
    np.testing.assert_allclose(trajectory.evaluate(trajectory.duration).x, END, atol=1e-14)
    fast = trajectory.scaled(2.0)
    t = np.linspace(0.0, fast.duration, 50)
    np.testing.assert_allclose(
        fast.evaluate(t).xdd, 4.0 * trajectory.evaluate(np.minimum(2 * t, trajectory.duration)).xdd, atol=1e-10
    )
    assert trajectory.evaluate(np.zeros((2, 3))).x.shape == (2, 3, 4, 4)
    assert trajectory.evaluate(0.1).xd.shape == (6,)
    assert len(trajectory.breaks) == 0
    assert len(trajectory.sample(times=[0.1, 0.2])) == 2


@pytest.mark.parametrize(
    ("start", "end", "message"),
    [
        (np.eye(3), np.eye(4), r"start has shape \(3, 3\)"),
        (np.eye(4), 2 * np.eye(4), "not a homogeneous pose"),
        (np.eye(4), np.diag([-1.0, -1.0, 1.0, 1.0]), "at half a turn the axis is not determined"),
    ],
)
def test_bad_poses_are_refused(start, end, message):
    with pytest.raises(InputError, match=message):
        reference.pose(start, end)
