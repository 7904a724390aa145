"""Sampled motions: what they accept, what they refuse and why."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from redundancy_pin import CarrierMotion, PlatformMotion
from redundancy_pin.errors import InputError


def flat(t: list[float], columns: int = 2) -> PlatformMotion:
    zero = np.zeros((len(t), columns))
    return PlatformMotion(t, zero, zero, zero)


def poses(samples: int) -> np.ndarray:
    x = np.tile(np.eye(4), (samples, 1, 1))
    x[:, :3, :3] = Rotation.random(samples, random_state=1).as_matrix()
    return x


def test_motions_print_shapes_and_not_arrays() -> None:
    assert repr(flat([0.0, 0.25, 0.5])) == "PlatformMotion(N=3, n=2, t=0..0.5 s)"
    still = np.zeros((5, 6))
    assert repr(PlatformMotion(np.arange(5.0), poses(5), still, still)) == "PlatformMotion(N=5, n=6, poses, t=0..4 s)"
    wave = np.array([[0.1, -0.3], [0.2, 0.1]])
    assert repr(CarrierMotion(wave, 2.0 * wave, np.zeros((2, 2)))) == (
        "CarrierMotion(N=2, k=2; largest |s|, |sd|, |sdd|: 0.3, 0.6, 0)"
    )
    assert "k=0; largest |s|, |sd|, |sdd|: 0, 0, 0" in repr(CarrierMotion.parked(3, 0))


# --- platform motions ---


def test_a_motion_copies_and_locks_its_arrays() -> None:
    x = np.zeros((2, 2))
    motion = PlatformMotion([0.0, 1.0], x, x, x)
    x[0, 0] = 5.0
    assert motion.x[0, 0] == 0.0
    for array in (motion.t, motion.x, motion.xd, motion.xdd, motion.jumps):
        assert not array.flags.writeable
    assert len(motion) == 2
    assert not motion.is_pose


@given(st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=8))
@examples(60)
def test_time_must_increase(t: list[float]) -> None:
    if all(b > a for a, b in itertools.pairwise(t)):
        np.testing.assert_array_equal(flat(t).t, t)
    elif all(b >= a for a, b in itertools.pairwise(t)) and all(t.count(value) < 3 for value in t):
        assert flat(t).jumps.sum() == len(t) - len(set(t))
    else:
        with pytest.raises(InputError, match="Time does not increase"):
            flat(t)


def test_time_that_runs_back_names_the_sample() -> None:
    with pytest.raises(InputError, match=r"t\[1\] = 1, t\[2\] = 0.5") as caught:
        flat([0.0, 1.0, 0.5, 2.0])
    assert caught.value.details["sample"] == 2


def test_two_sided_samples_jump_in_acceleration_only() -> None:
    t, zero = [0.0, 1.0, 1.0, 2.0], np.zeros((4, 1))
    motion = PlatformMotion(t, zero, zero, [[0.0], [0.0], [5.0], [5.0]])
    np.testing.assert_array_equal(motion.jumps, [False, False, True, False])
    moved = zero.copy()
    moved[2] = 1e-9
    for x, xd in ((moved, zero), (zero, moved)):
        with pytest.raises(InputError, match=r"t\[1\] = 1, t\[2\] = 1.*equal x and xd"):
            PlatformMotion(t, x, xd, zero)


def test_an_instant_may_not_appear_three_times() -> None:
    with pytest.raises(InputError, match=r"t\[2\] = 1, t\[3\] = 1") as caught:
        flat([0.0, 1.0, 1.0, 1.0])
    assert caught.value.details["sample"] == 3


@pytest.mark.parametrize(
    ("name", "arrays"),
    [
        ("t", ([[0.0]], [[0.0]], [[0.0]], [[0.0]])),
        ("x", ([0.0], [[0.0, 1.0]], [[0.0]], [[0.0]])),
        ("x", ([0.0], [[0.0], [1.0]], [[0.0]], [[0.0]])),
        ("x", ([0.0], [0.0], [[0.0]], [[0.0]])),
        ("x", ([0.0], [[[0.0]]], [[0.0]], [[0.0]])),
        ("x", ([0.0], [[0.0], [1.0, 2.0]], [[0.0]], [[0.0]])),
        ("xd", ([0.0], [[0.0]], [[0.0], [1.0]], [[0.0]])),
        ("xdd", ([0.0], [[0.0]], [[0.0]], [[0.0, 1.0]])),
        ("xd", ([0.0], [[0.0]], [[np.nan]], [[0.0]])),
        ("xdd", ([0.0], [[0.0]], [[0.0]], [[np.inf]])),
    ],
)
def test_arrays_that_do_not_fit_are_named(name: str, arrays: tuple[list[object], ...]) -> None:
    with pytest.raises(InputError, match=f"^{name} ") as caught:
        PlatformMotion(*arrays)  # type: ignore[arg-type]
    assert caught.value.details["name"] == name


def test_an_empty_motion_is_refused() -> None:
    empty = np.zeros((0, 2))
    with pytest.raises(InputError, match="no samples"):
        PlatformMotion([], empty, empty, empty)


def test_slices_are_motions() -> None:
    motion = flat([0.0, 1.0, 2.0, 3.0])
    assert motion[1:3].t.tolist() == [1.0, 2.0]
    with pytest.raises(InputError):
        motion[4:]
    with pytest.raises(InputError, match="Time does not increase"):
        motion[::-1]


@pytest.mark.parametrize("columns", [3, 6])
def test_poses_are_recognised(columns: int) -> None:
    zero = np.zeros((3, columns))
    motion = PlatformMotion([0.0, 1.0, 2.0], poses(3), zero, zero)
    assert motion.is_pose
    assert motion[1:].x.shape == (2, 4, 4)


def _scaled(x: np.ndarray) -> None:
    x[1, :3, :3] *= 1.001


def _mirrored(x: np.ndarray) -> None:
    x[1, :3, 0] *= -1.0


def _last_row(x: np.ndarray) -> None:
    x[1, 3, 0] = 0.1


@pytest.mark.parametrize("spoil", [_scaled, _mirrored, _last_row])
def test_matrices_that_are_no_poses_are_refused(spoil: object) -> None:
    x, zero = poses(3), np.zeros((3, 6))
    spoil(x)  # type: ignore[operator]
    with pytest.raises(InputError, match=r"x\[1\] is not a homogeneous pose: it misses orthonormality by") as caught:
        PlatformMotion([0.0, 1.0, 2.0], x, zero, zero)
    assert caught.value.details["sample"] == 1


def test_poses_beyond_all_numbers_are_refused_without_a_warning() -> None:
    x = poses(2)
    x[:, :2, :2] = [[1e300, 1e300], [1e300, -1e300]]  # rows whose product is infinity less infinity
    with pytest.raises(InputError, match=r"x has 8 value\(s\) that are beyond 1e\+100"):
        PlatformMotion([0.0, 1.0], x, np.zeros((2, 6)), np.zeros((2, 6)))


def test_poses_with_nine_digits_pass() -> None:
    zero = np.zeros((3, 6))
    PlatformMotion([0.0, 1.0, 2.0], np.round(poses(3), 10), zero, zero)


def test_poses_may_be_two_sided() -> None:
    zero = np.zeros((2, 6))
    assert PlatformMotion([1.0, 1.0], poses(1).repeat(2, axis=0), zero, zero).jumps.tolist() == [False, True]
    with pytest.raises(InputError, match="Time does not increase"):
        PlatformMotion([1.0, 1.0], poses(2), zero, zero)


# --- carrier motions ---


def test_a_carrier_motion_copies_and_locks() -> None:
    s = np.zeros((3, 2))
    motion = CarrierMotion(s, s, s)
    s[0, 0] = 1.0
    assert motion.s[0, 0] == 0.0
    assert not motion.sdd.flags.writeable
    assert len(motion) == 3
    assert motion[1:].s.shape == (2, 2)


@pytest.mark.parametrize("which", ["s", "sd", "sdd"])
def test_carrier_arrays_of_another_shape_are_named(which: str) -> None:
    arrays = {"s": np.zeros((3, 2)), "sd": np.zeros((3, 2)), "sdd": np.zeros((3, 2))}
    arrays[which] = np.zeros(3) if which == "s" else np.zeros((2, 2))
    with pytest.raises(InputError, match=f"^{which} has shape"):
        CarrierMotion(**arrays)


@pytest.mark.parametrize(
    ("carriers", "at", "expected"),
    [
        (2, 0.0, [0.0, 0.0]),
        (2, 0.3, [0.3, 0.3]),
        (2, [0.1, -0.2], [0.1, -0.2]),
        (0, 0.0, []),
        (0, [], []),
        (1, [0.5], [0.5]),
    ],
)
def test_parked_carriers_stand_where_they_are_put(carriers: int, at: object, expected: list[float]) -> None:
    motion = CarrierMotion.parked(3, carriers, at)  # type: ignore[arg-type]
    np.testing.assert_array_equal(motion.s, np.tile(expected, (3, 1)))
    assert motion.sd.shape == motion.sdd.shape == (3, carriers)
    assert not motion.sd.any()
    assert not motion.sdd.any()


@pytest.mark.parametrize("at", [[0.1, 0.2, 0.3], [], [[0.1, 0.2]], "here", None, np.nan, [0.1, [0.2]]])
def test_parked_refuses_places_that_do_not_fit(at: object) -> None:
    with pytest.raises(InputError, match=r"^at "):
        CarrierMotion.parked(3, 2, at)  # type: ignore[arg-type]


@pytest.mark.parametrize(("samples", "carriers"), [(-1, 2), (3, -2)])
def test_parked_refuses_negative_counts(samples: int, carriers: int) -> None:
    with pytest.raises(InputError, match="negative"):
        CarrierMotion.parked(samples, carriers)


def test_parked_takes_counts_and_says_so() -> None:
    with pytest.raises(InputError, match=r"whole.*array.*len"):
        CarrierMotion.parked(np.zeros(3), 2)  # type: ignore[arg-type]
    assert len(CarrierMotion.parked(np.int64(3), 2)) == 3  # type: ignore[arg-type]
