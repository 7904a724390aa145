"""Terms of the carriers' motion, batch after batch: against efforts of ``RneaDynamics.reduce``, which knows no terms.

That compiled code and ``along`` agree is compared at what neither can judge: next to a singularity, after jumps."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path
from typing import Any

import moving
import numpy as np
import pytest
import zoo
from flat_linkages import parallelogram

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import CarrierTerms, terms_along
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import JointForces, Payload, Robot, Wrench

OTHER = 1e-10
"""Relative to the largest value of the motion: of two backends."""

SAME = 1e-12
"""Of the same functions at configurations that two ways of Newton's method have found."""

APART = 0.0025
"""s; an eighth of a planner's step."""

BATCH = 4


def pulling(t: Array, x: Array, xd: Array) -> Array:
    force = np.zeros((len(t), 6))
    force[:, 0], force[:, 1], force[:, 5] = np.sin(7.0 * t), 2.0 * x[:, 1] - xd[:, 0], 0.3
    return force


ROBOTS: dict[str, Callable[[Path], Robot]] = {
    "2rpr": lambda _: zoo.robot_of("2rpr", end_effector_mass=0.5, cylinder_mass=0.3, gravity=(0.0, -9.81, 0.0)),
    "3rrr": lambda _: zoo.robot_of("3rrr", gravity=(0.5, -9.81, 0.0)),
    "five_bar": lambda _: zoo.robot_of("five_bar"),
    "no carriers, in space": lambda _: zoo.robot_of("gough", payload_mass=2.0),
    "in space": lambda folder: rp.load_robot(moving.floating(folder).source, gravity=(0.3, -0.5, -9.81)),
    "loads": lambda _: zoo.robot_of("2rpr", end_effector_mass=0.5).loaded(
        Wrench("end_effector", pulling), Payload("end_effector", 0.2), JointForces("slide_1", 2.0)
    ),
    "more actuators": lambda _: zoo.driven_by(zoo.robot_of("five_bar"), "base_1", "base_2", "elbow_1"),
    "fewer actuators": lambda _: zoo.driven_by(zoo.robot_of("five_bar"), "base_1"),
}


class Counted:
    """Compiled dynamics that count how often a motion is followed from the reference."""

    def __init__(self, robot: Robot, monkeypatch: pytest.MonkeyPatch) -> None:
        self.dynamics, self.followed = rp.CompiledDynamics(robot), 0
        along = self.dynamics.along

        def counted(motion: PlatformMotion, **options: Any) -> Any:
            self.followed += 1
            return along(motion, **options)

        monkeypatch.setattr(self.dynamics, "along", counted)

    def terms(self, motion: PlatformMotion) -> CarrierTerms:
        return self.dynamics.carrier_terms(motion.t, motion.x, motion.xd, motion.xdd)


def assert_near(got: CarrierTerms, want: CarrierTerms, tolerance: float) -> None:
    for name in CarrierTerms._fields:
        theirs = getattr(want, name)
        size = max(float(np.abs(theirs[np.isfinite(theirs)]).max(initial=0.0)), 1e-3)
        np.testing.assert_allclose(getattr(got, name), theirs, rtol=0.0, atol=tolerance * size, err_msg=name)


def motion_of(robot: Robot, seed: int = 0, samples: int = 40, start: float = 0.0) -> PlatformMotion:
    return zoo.smooth_motion(robot, seed).at(start + APART * np.arange(samples))


def batches(motion: PlatformMotion, size: int = BATCH) -> list[PlatformMotion]:
    return [motion[i : i + size] for i in range(0, len(motion), size)]


@pytest.mark.parametrize("name", ROBOTS)
def test_any_motion_of_the_carriers_is_a_sum_of_terms(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = ROBOTS[name](tmp_path)
    counted, motion = Counted(robot, monkeypatch), motion_of(robot)
    rng = np.random.default_rng(1)
    s, sd, sdd = rng.uniform(-0.2, 0.2, (3, len(motion), robot.k))
    carriers = CarrierMotion(s, sd, sdd, check_rates=False)
    want = rp.RneaDynamics(robot).along(motion).reduce(carriers)
    parts = [counted.terms(part) for part in batches(motion)]
    first = motion[:BATCH]
    assert_near(parts[0], rp.RneaDynamics(robot).carrier_terms(first.t, first.x, first.xd, first.xdd), OTHER)
    W, constant, terms = (np.concatenate(part) for part in zip(*parts, strict=True))
    by_term = np.stack([s, s * s, sd, s * sd, sdd], axis=-1)
    got = constant + np.einsum("nkj,nkji->ni", by_term, terms)
    for ours, theirs in ((W, want.W), (got[:, : robot.n], want.f), (got[:, robot.n :], want.carrier_force)):
        size = np.abs(theirs).max(initial=1e-3)
        np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=OTHER * size)
    assert counted.followed == 1


def sweep(samples: int) -> PlatformMotion:
    """Of the five-bar up its axis, from 0.35 to 0.93 m: Newton's method does not get from one end to the other."""
    t = APART * np.arange(samples)
    rate = np.pi / 0.62
    y, yd, ydd = 0.64 - 0.29 * np.cos(rate * t), 0.29 * rate * np.sin(rate * t), 0.29 * rate**2 * np.cos(rate * t)
    x, xd, xdd = (np.stack([0.0 * t + part[0], part[1]], axis=1) for part in ((0.25, y), (0.0, yd), (0.0, ydd)))
    return PlatformMotion(t, x, xd, xdd)


def at_random(samples: int) -> list[slice]:
    ends = np.append(0, np.cumsum(np.random.default_rng(2).integers(1, 30, samples)))
    return [slice(*pair) for pair in itertools.pairwise(ends[ends <= samples].tolist())]


@pytest.mark.parametrize(
    ("name", "parts"),
    [
        *((name, at_random(120)) for name in ("3rrr", "five_bar", "loads")),
        # a horizon long, from about where it was: a preview that may change its mind is read anew at every update
        ("far", [slice(0, 240), slice(2, 242), slice(4, 244)]),
        ("far", [slice(0, 4), slice(4, 220), slice(220, 224), slice(224, 240)]),
    ],
)
def test_batches_of_any_size_are_those_of_one_motion(
    name: str, parts: list[slice], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = ROBOTS["five_bar" if name == "far" else name](tmp_path)
    counted, motion = Counted(robot, monkeypatch), sweep(244) if name == "far" else motion_of(robot, 2, 120)
    whole = terms_along(rp.CompiledDynamics(robot).along(motion))
    for part in parts:
        assert_near(counted.terms(motion[part]), CarrierTerms(*(values[part] for values in whole)), SAME)
    assert counted.followed == 1


@pytest.mark.parametrize(("samples", "shift"), [(100, 0.0), (101, 0.0), (101, 1e-6)])
@pytest.mark.parametrize("size", [4, 51])
def test_batches_through_a_rank_loss_of_the_closures_are_those_of_the_whole_motion(
    samples: int, shift: float, size: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A parallelogram is flat half way: at a sample, between two, or so near to one that its rates are lost."""
    robot = parallelogram()
    counted, plain = Counted(robot, monkeypatch), rp.CompiledDynamics(robot)
    t = np.linspace(0.0, 1.0, samples)
    through = PlatformMotion(t, 1.2 + shift - 2.4 * t[:, None], np.full((samples, 1), -2.4), np.zeros((samples, 1)))
    for part in batches(through, size):
        want = terms_along(plain.along(part, unreachable="mark"))
        got = counted.terms(part)
        np.testing.assert_array_equal(np.isnan(got.constant), np.isnan(want.constant))
        assert_near(got, want, SAME / 0.012)  # beside the flat pose K is that much nearer to singular
        assert np.isfinite(got.constant).all()


def test_after_a_jump_it_is_followed_from_the_reference(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = zoo.robot_of("five_bar")
    counted, plain = Counted(robot, monkeypatch), rp.CompiledDynamics(robot)
    motion, home = motion_of(robot, samples=8), zoo.home_of(robot)
    away = PlatformMotion(motion.t, motion.x - home + (-0.1, 0.35), motion.xd, motion.xdd)
    for i, part in enumerate((motion[:4], away[:4], away[4:], motion[4:])):
        assert_near(counted.terms(part), terms_along(plain.along(part)), SAME)
        assert counted.followed == (1, 2, 2, 2)[i]  # where it was before is near


def over_the_edge(robot: Robot, farthest: float, samples: int = 21) -> PlatformMotion:
    """The five-bar straight up its axis and back, as far as a height; both legs are stretched at 0.968 m."""
    t = APART * np.arange(samples)
    rate = np.pi / t[-1]
    low = 0.76
    swing = farthest - low
    y = low + swing * np.sin(rate * t)
    zero = np.zeros_like(t)
    parts = (y, swing * rate * np.cos(rate * t), -swing * rate**2 * np.sin(rate * t))
    x, xd, xdd = (np.stack([first, part], axis=1) for first, part in zip((zero + 0.25, zero, zero), parts, strict=True))
    return PlatformMotion(t, x, xd, xdd)


@pytest.mark.parametrize("beyond", [-1e-2, -1e-7, -1e-12, 1e-7, pytest.param(0.2, marks=pytest.mark.long)])
def test_near_and_beyond_the_edge_of_the_workspace_samples_are_marked_as_by_along(
    beyond: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Batches of one instant are marked by themselves, others as motions are; behind the end of a branch maybe more."""
    robot = zoo.robot_of("five_bar")
    counted, plain = Counted(robot, monkeypatch), rp.CompiledDynamics(robot)
    edge = float(np.sqrt(1.0 - 0.25**2))
    motion = over_the_edge(robot, edge + beyond)
    lost = 0
    for size in (1, BATCH):
        for part in batches(motion, size):
            want = terms_along(plain.along(part, unreachable="mark"))
            got = counted.terms(part)
            missing, marked = (np.isnan(terms.constant).any(axis=1) for terms in (want, got))
            assert (missing <= marked).all()
            assert (marked <= np.logical_or.accumulate(missing)).all()
            want, got = (CarrierTerms(*(values[~marked] for values in terms)) for terms in (want, got))
            # W and f grow with the inverse of the margin, and so does what rounding makes of them
            tolerance = SAME * max(1.0, float(np.nanmax(np.abs(want.W), initial=0.0)) ** 3)
            assert_near(got, want, tolerance)
            lost += int(missing.sum())
    assert (lost > 0) == (beyond > -1e-11)  # within it legs count as stretched
    assert counted.followed < len(motion) + len(batches(motion))


def test_another_working_mode_and_numbers_that_are_none_are_refused_as_ever() -> None:
    robot = zoo.robot_of("2rpr")
    dynamics, motion = rp.CompiledDynamics(robot), motion_of(robot, samples=4)
    given = (motion.t, motion.x, motion.xd, motion.xdd)
    dynamics.carrier_terms(*given)
    for i in range(4):
        broken = [np.array(part) for part in given]
        broken[i][2] = np.nan
        with pytest.raises(RedundancyPinError):
            dynamics.carrier_terms(*broken)
    with pytest.raises(RedundancyPinError):
        dynamics.carrier_terms(motion.t, motion.x[:, :1], motion.xd, motion.xdd)
    with pytest.raises(RedundancyPinError):
        dynamics.carrier_terms(motion.t, motion.x, motion.xd[:, :1], motion.xdd[:, :1])
    mirrored = PlatformMotion(motion.t, motion.x * (1.0, -1.0), motion.xd, motion.xdd, check_rates=False)
    want = terms_along(dynamics.along(mirrored, unreachable="mark"))
    assert_near(dynamics.carrier_terms(mirrored.t, mirrored.x, mirrored.xd, mirrored.xdd), want, SAME)
