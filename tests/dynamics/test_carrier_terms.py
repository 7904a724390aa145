"""Terms of the carriers' motion, batch after batch: against efforts of ``RneaDynamics.reduce``, which knows no terms.

That compiled code and ``along`` agree is compared at what neither can judge: next to a singularity, after jumps."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import moving
import numpy as np
import pytest
import zoo
from flat_linkages import parallelogram

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics, terms_along
from redundancy_pin.dynamics.results import CarrierTerms
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.robot import JointForces, Payload, Robot, Wrench

OTHER = 1e-10
"""Relative to the largest value of the motion: of two backends."""

SAME = 1e-12
"""Of the same functions at configurations that two ways of Newton's method have found."""

APART = 0.0025
"""s; an eighth of a planner's step."""


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


def terms_of(dynamics: Dynamics, motion: PlatformMotion) -> CarrierTerms:
    return dynamics.carrier_terms(motion.t, motion.x, motion.xd, motion.xdd)


def assert_near(got: CarrierTerms, want: CarrierTerms, tolerance: float) -> None:
    for name in CarrierTerms._fields:
        theirs = getattr(want, name)
        size = max(float(np.abs(theirs[np.isfinite(theirs)]).max(initial=0.0)), 1e-3)
        np.testing.assert_allclose(getattr(got, name), theirs, rtol=0.0, atol=tolerance * size, err_msg=name)


def motion_of(robot: Robot, seed: int = 0, samples: int = 40, start: float = 0.0) -> PlatformMotion:
    return zoo.smooth_motion(robot, seed).at(start + APART * np.arange(samples))


def batches(motion: PlatformMotion, size: int) -> list[PlatformMotion]:
    return [motion[i : i + size] for i in range(0, len(motion), size)]


@pytest.mark.parametrize("name", ROBOTS)
def test_any_motion_of_the_carriers_is_a_sum_of_terms(name: str, tmp_path: Path) -> None:
    """Batch after batch of any size, and all at once."""
    robot = ROBOTS[name](tmp_path)
    compiled, motion = rp.CompiledDynamics(robot), motion_of(robot)
    rng = np.random.default_rng(1)
    s, sd, sdd = rng.uniform(-0.2, 0.2, (3, len(motion), robot.k))
    want = rp.RneaDynamics(robot).along(motion).reduce(CarrierMotion(s, sd, sdd, check_rates=False))
    by_term = np.stack([s, s * s, sd, s * sd, sdd], axis=-1)
    cuts = [0, 4, 5, 17, len(motion)]
    batched = [terms_of(compiled, motion[slice(*pair)]) for pair in itertools.pairwise(cuts)]
    whole = [np.concatenate(part) for part in zip(*batched, strict=True)]
    for W, constant, terms in (whole, terms_of(rp.CompiledDynamics(robot), motion)):
        got = constant + np.einsum("nkj,nkji->ni", by_term, terms)
        for ours, theirs in ((W, want.W), (got[:, : robot.n], want.f), (got[:, robot.n :], want.carrier_force)):
            np.testing.assert_allclose(ours, theirs, rtol=0.0, atol=OTHER * np.abs(theirs).max(initial=1e-3))
    assert_near(batched[0], terms_of(rp.RneaDynamics(robot), motion[:4]), OTHER)


@pytest.mark.parametrize(("samples", "shift"), [(100, 0.0), (101, 0.0), (101, 1e-6)])
@pytest.mark.parametrize("size", [4, 51])
def test_batches_through_a_rank_loss_of_the_closures_are_those_of_the_whole_motion(
    samples: int, shift: float, size: int
) -> None:
    """A parallelogram is flat half way: at a sample, between two, or so near to one that its rates are lost."""
    dynamics, plain = rp.CompiledDynamics(parallelogram()), rp.CompiledDynamics(parallelogram())
    t = np.linspace(0.0, 1.0, samples)
    through = PlatformMotion(t, 1.2 + shift - 2.4 * t[:, None], np.full((samples, 1), -2.4), np.zeros((samples, 1)))
    for part in batches(through, size):
        got = terms_of(dynamics, part)
        assert np.isfinite(got.constant).all()
        # beside the flat pose K is that much nearer to singular
        assert_near(got, terms_along(plain.along(part, unreachable="mark")), SAME / 0.012)


def test_after_a_jump_the_terms_are_those_of_rnea() -> None:
    robot = zoo.robot_of("five_bar")
    dynamics, rnea = rp.CompiledDynamics(robot), rp.RneaDynamics(robot)
    motion, home = motion_of(robot, samples=8), zoo.home_of(robot)
    away = PlatformMotion(motion.t, motion.x - home + (-0.1, 0.35), motion.xd, motion.xdd)
    for part in (motion[:4], away[:4], away[4:], motion[4:]):
        assert_near(terms_of(dynamics, part), terms_of(rnea, part), OTHER)


@pytest.mark.parametrize("beyond", [-1e-2, -1e-7, -1e-12, 1e-7, pytest.param(0.2, marks=pytest.mark.long)])
def test_near_and_beyond_the_edge_of_the_workspace_samples_are_marked_as_by_along(beyond: float) -> None:
    """The five-bar straight up its axis to an edge at 0.968 m and back; behind the end of a branch more may be marked.

    Batches of one instant are marked by themselves, others as motions are.
    """
    robot = zoo.robot_of("five_bar")
    dynamics, plain = rp.CompiledDynamics(robot), rp.CompiledDynamics(robot)
    t, low, edge = 0.0025 * np.arange(21), 0.76, float(np.sqrt(1.0 - 0.25**2))
    rate, swing, zero = np.pi / t[-1], edge + beyond - low, np.zeros_like(t)
    sine, cosine = np.sin(rate * t), np.cos(rate * t)
    parts = (low + swing * sine, swing * rate * cosine, -swing * rate**2 * sine)
    motion = PlatformMotion(t, *(np.stack(pair, axis=1) for pair in zip((zero + 0.25, zero, zero), parts, strict=True)))
    lost = 0
    for part in (*batches(motion, 1), *batches(motion, 4)):
        want, got = terms_along(plain.along(part, unreachable="mark")), terms_of(dynamics, part)
        missing, marked = (np.isnan(terms.constant).any(axis=1) for terms in (want, got))
        assert (missing <= marked).all()
        assert (marked <= np.logical_or.accumulate(missing)).all()
        want, got = (CarrierTerms(*(values[~marked] for values in terms)) for terms in (want, got))
        # W and f grow with the inverse of the margin, and so does what rounding makes of them
        assert_near(got, want, SAME * max(1.0, float(np.nanmax(np.abs(want.W), initial=0.0)) ** 3))
        lost += int(missing.sum())
    assert (lost > 0) == (beyond > -1e-11)  # within it legs count as stretched


def test_numbers_that_are_none_are_refused_and_another_working_mode_is_followed() -> None:
    robot = zoo.robot_of("2rpr")
    dynamics, motion = rp.CompiledDynamics(robot), motion_of(robot, samples=4)
    given = (motion.t, motion.x, motion.xd, motion.xdd)
    for i in range(4):
        broken = [np.array(part) for part in given]
        broken[i][2] = np.nan
        shorter = [part[:, :1] if i == k > 0 else part for k, part in enumerate(given)]
        for wrong in (broken, shorter)[: 1 + (i > 0)]:
            with pytest.raises(RedundancyPinError):
                dynamics.carrier_terms(*wrong)
    mirrored = PlatformMotion(motion.t, motion.x * (1.0, -1.0), motion.xd, motion.xdd, check_rates=False)
    assert_near(terms_of(dynamics, mirrored), terms_along(dynamics.along(mirrored, unreachable="mark")), SAME)
