"""Forward displacement of the 3-RRR: every solution closes, every pose is found again, none is missed."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from redundancy_pin.dynamics.virtual_work.three_rrr import ThreeRrrGeometry, inverse_displacement
from redundancy_pin.dynamics.virtual_work.three_rrr_forward import forward_displacement
from redundancy_pin.errors import InputError, SingularPoseError

THESIS = ThreeRrrGeometry(1.0, 0.25, 1.0, 1.0)
WIDE = ThreeRrrGeometry(0.8, 0.7, 0.6, 1.1)
PHI = np.array([np.pi / 6, 5 * np.pi / 6, -np.pi / 2])
CLOSED = 1e-11
"""What a solution may leave of |A - B| = l2, m."""

angles = st.tuples(*[st.floats(-np.pi, np.pi)] * 3)


def u(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def leg_errors(geometry, theta, pose):
    A = pose[:2] - geometry.platform_radius * u(pose[2] + PHI)
    B = geometry.base_points + geometry.proximal_length * u(np.asarray(theta))
    return np.abs(np.hypot(*(A - B).T) - geometry.distal_length)


def inverse_matrix(geometry, theta, pose):
    """Rows of the closure's derivative by the pose, lengths in units of l2, by complex steps."""
    rows = np.empty((3, 3))
    B = geometry.base_points + geometry.proximal_length * u(np.asarray(theta))
    for column in range(3):
        moved = pose + 1e-30j * np.eye(3)[column]
        A = moved[:2] - geometry.platform_radius * u(moved[2] + PHI)
        rows[:, column] = (((A - B) ** 2).sum(axis=1) / 2).imag / 1e-30
    scale = np.array([geometry.distal_length] * 2 + [geometry.distal_length * geometry.platform_radius])
    return rows / scale


def crossings_by_scanning(geometry, theta, samples=4000):
    """Count the assembly modes without elimination: turn the platform through all α, close legs 1 and 2, both ways, and
    count the sign changes of the error of leg 3; None where the scan is too coarse to tell."""
    alpha = np.linspace(-np.pi, np.pi, samples + 1)
    B = geometry.base_points + geometry.proximal_length * u(np.asarray(theta))
    C = B + geometry.platform_radius * u(alpha[:, None] + PHI)
    side = C[:, 1] - C[:, 0]
    r = np.hypot(*side.T)
    half_height_squared = geometry.distal_length**2 - r**2 / 4
    exists = half_height_squared > 0
    height = np.sqrt(np.maximum(half_height_squared, 0))
    across = np.stack([-side[:, 1], side[:, 0]], axis=1) * (height / r)[:, None]
    errors = [
        np.hypot(*((C[:, 0] + C[:, 1]) / 2 + sign * across - C[:, 2]).T) - geometry.distal_length for sign in (1, -1)
    ]
    # near r = 0 the intersection turns fast, next to an end of the range or to a double root the count is not clear
    if r.min() < 0.05 or not (exists.all() or np.abs(np.diff(exists.astype(int))).sum() % 2 == 0):
        return None
    count = 0
    for error in errors:
        both = exists[1:] & exists[:-1]
        change = both & (np.sign(error[1:]) != np.sign(error[:-1]))
        slope = np.abs(np.diff(error))
        if np.any(change & (slope < 1e-6)):
            return None
        dip = exists[1:-1] & (np.abs(error[1:-1]) < 1e-4) & ~change[1:] & ~change[:-1]
        if dip.any():
            return None
        count += int(change.sum())
    ends = np.flatnonzero(exists[1:] != exists[:-1])
    for end in ends:  # at an end the two branches join: a crossing between them and the last sample would be missed
        inside = end if exists[end] else end + 1
        if np.sign(errors[0][inside]) != np.sign(errors[1][inside]):
            count += 1
        elif min(abs(errors[0][inside]), abs(errors[1][inside])) < 1e-2:
            return None
    return count


@given(theta=angles, geometry=st.sampled_from([THESIS, WIDE]))
def test_every_solution_closes_and_is_labelled(theta, geometry):
    solutions = forward_displacement(geometry, theta)
    assert len(solutions) <= 6
    assert [s.index for s in solutions] == list(range(len(solutions)))
    alphas = [s.pose[2] for s in solutions]
    assert alphas == sorted(alphas)
    for s in solutions:
        errors = leg_errors(geometry, theta, s.pose)
        assert errors.max() < CLOSED
        np.testing.assert_allclose(s.residual, errors.max(), atol=1e-14)
        rows = inverse_matrix(geometry, theta, s.pose)
        np.testing.assert_allclose(s.determinant, np.linalg.det(rows), atol=1e-12)
        assert s.sign == (np.sign(s.determinant) if abs(s.determinant) > 1e-6 else 0)
        assert not s.pose.flags.writeable


@given(theta=angles, geometry=st.sampled_from([THESIS, WIDE]))
def test_the_determinants_of_all_assembly_modes_alternate_in_sum(theta, geometry):
    """Real solutions are born in pairs at type II singularities, one of each sign."""
    solutions = forward_displacement(geometry, theta)
    assume(all(abs(s.determinant) > 1e-4 for s in solutions))
    assert sum(s.sign for s in solutions) == 0


@given(theta=angles, geometry=st.sampled_from([THESIS, WIDE]))
def test_no_solution_is_missed_that_scanning_finds(theta, geometry):
    solutions = forward_displacement(geometry, theta)
    assume(all(abs(s.determinant) > 1e-2 for s in solutions))
    count = crossings_by_scanning(geometry, theta)
    assume(count is not None)
    assert len(solutions) == count


@pytest.mark.long
@given(
    x=st.floats(-0.5, 2.2),
    y=st.floats(-0.8, 1.8),
    alpha=st.floats(-3.1, 3.1),
    geometry=st.sampled_from([THESIS, WIDE]),
)
def test_every_pose_is_among_the_solutions_of_its_base_angles_in_every_mode(x, y, alpha, geometry):
    pose = np.array([x, y, alpha])
    assume(inverse_displacement(geometry, pose[None]).reachable.all())
    for legs in (inverse_displacement(geometry, pose[None], mode) for mode in product((1, -1), repeat=3)):
        if abs(np.linalg.det(legs.platform_matrix[0])) < 1e-5:
            continue  # on a fold the pose is fixed to the square root of rounding only
        solutions = forward_displacement(geometry, legs.theta[:, 0])
        nearest = min(np.abs(s.pose - pose).max() for s in solutions)
        assert nearest < 1e-8, legs.mode


def test_six_assembly_modes_exist():
    geometry = ThreeRrrGeometry(1.0, 0.9, 0.7, 1.2)
    rng = np.random.default_rng(1)
    counts = {len(forward_displacement(geometry, theta)) for theta in rng.uniform(-np.pi, np.pi, (80, 3))}
    assert counts == {0, 2, 4, 6} or counts == {2, 4, 6}


@pytest.mark.parametrize("size", [0.01, 100.0])
def test_a_machine_of_another_size_has_the_same_poses(size):
    theta = np.array([0.3, 2.0, -1.2])
    lengths = np.array([1.0, 0.9, 0.7, 1.2])
    here = forward_displacement(ThreeRrrGeometry(*lengths), theta)
    there = forward_displacement(ThreeRrrGeometry(*(size * lengths)), theta)
    assert len(here) == len(there) > 0
    scaled = [one.pose * [size, size, 1.0] for one in here]
    np.testing.assert_allclose([one.pose for one in there], scaled, rtol=1e-9, atol=1e-9 * size)


def test_two_poses_at_one_orientation():
    """Two centres coincide at α = 0: the eliminated equation has a double root there that stands for two poses."""
    geometry = ThreeRrrGeometry(1.0, 0.25, 1.0, 1.0)
    # elbows 1 and 2 a platform side apart, parallel to it: C1 = C2 at α = 0
    G, side = geometry.base_points, geometry.platform_radius * (u(PHI[1]) - u(PHI[0]))
    # l1 (u(θ1) - u(θ2)) = G2 - G1 + side (side points to -x): mirror images about the vertical
    half = (np.hypot(*(G[1] - G[0])) - np.hypot(*side)) / 2
    theta1 = np.arccos(half)
    elbow_gap = np.hypot(*((G[0] + u(theta1)) - (G[1] + u(np.pi - theta1))))
    np.testing.assert_allclose(elbow_gap, np.hypot(*side), atol=1e-12)
    theta = np.array([theta1, np.pi - theta1, -2.0])
    solutions = forward_displacement(geometry, theta)
    at_zero = [s for s in solutions if abs(s.pose[2]) < 1e-7]
    assert len(at_zero) == 2
    assert np.hypot(*(at_zero[0].pose - at_zero[1].pose)[:2]) > 1.0


def test_a_self_motion_is_refused():
    """Elbows congruent to the platform: a circle of poses closes the legs with the base joints locked."""
    geometry = ThreeRrrGeometry(1.0, 0.25, 0.75, 0.6)
    outward = np.array([-np.pi / 6 - 2 * np.pi / 3, -np.pi / 6, np.pi / 2]) + np.pi  # towards the base's centre
    elbows = geometry.base_points + 0.75 * u(outward)
    np.testing.assert_allclose(np.hypot(*(elbows[1] - elbows[0])), 0.25 * np.sqrt(3), atol=1e-12)
    with pytest.raises(SingularPoseError, match="circle"):
        forward_displacement(geometry, outward)


def test_a_platform_that_turns_about_coincident_elbows_is_refused():
    geometry = ThreeRrrGeometry(1.0, 0.4, 1.0, 0.4)
    inward = np.array([np.pi / 6, 5 * np.pi / 6, -np.pi / 2])
    with pytest.raises(SingularPoseError, match="turns"):
        forward_displacement(geometry, inward)
    assert forward_displacement(ThreeRrrGeometry(1.0, 0.4, 1.0, 0.5), inward) == ()


def test_two_assembly_modes_that_meet_are_one_without_a_sign():
    """Symmetric home pose of a machine whose distal links point at the centre: a type II singularity."""
    geometry = ThreeRrrGeometry(1.0, 0.25, 0.4, 0.35)  # the legs are straight towards the centre: 0.4 + 0.35 + 0.25 = 1
    solutions = forward_displacement(geometry, [np.pi / 6, 5 * np.pi / 6, -np.pi / 2])
    centre = np.array([np.sqrt(3) / 2, 0.5, 0.0])
    home = [s for s in solutions if np.abs(s.pose - centre).max() < 1e-6]
    assert [s.sign for s in home] == [0]


def test_three_assembly_modes_that_meet_are_one():
    """A cusp: base angles 0, 240 and 300 degrees, all radii and lengths 1, the platform at the centre."""
    solutions = forward_displacement(ThreeRrrGeometry(1.0, 1.0, 1.0, 1.0), [0.0, 4 * np.pi / 3, 5 * np.pi / 3])
    centre = np.array([np.sqrt(3) / 2, 0.5, 0.0])
    assert len(solutions) == 4  # six, three of them in one
    home = [s for s in solutions if np.abs(s.pose - centre).max() < 1e-4]  # the cube root of rounding, with room
    assert len(home) == 1


@pytest.mark.parametrize("x", np.linspace(0.5, 1.3, 9))
def test_a_pose_upside_down_is_listed_once(x):
    """α = π and α = -π are one pose, from whichever side rounding comes."""
    pose = np.array([x, 0.45, np.pi])
    for legs in (inverse_displacement(THESIS, pose[None], mode) for mode in product((1, -1), repeat=3)):
        solutions = forward_displacement(THESIS, legs.theta[:, 0])
        mirrored = [s for s in solutions if np.abs(u(s.pose[2]) - u(np.pi)).max() < 1e-6]
        assert len([s for s in mirrored if np.abs(s.pose[:2] - pose[:2]).max() < 1e-6]) == 1


def test_none_where_the_elbows_are_too_far_apart():
    geometry = ThreeRrrGeometry(2.0, 0.25, 0.5, 0.5)
    assert forward_displacement(geometry, [np.pi, 0.0, np.pi / 2]) == ()


@pytest.mark.parametrize("theta", [[0.0, 1.0], [0.0, 1.0, np.nan]])
def test_bad_input_is_refused(theta):
    with pytest.raises(InputError):
        forward_displacement(THESIS, theta)
