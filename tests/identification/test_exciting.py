"""Exciting motions: against random ones within the same limits, by regressors of differences."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pinocchio as pin
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.identification import ExcitingMotion, exciting_motion
from redundancy_pin.identification.parameters import INERTIAL
from redundancy_pin.robot import Robot
from redundancy_pin.spectrum import scaled, spectrum_of
from redundancy_pin.status import ResultStatus

LIMITS = rp.Limits(effort=12.0, actuator_speed=3.0)
MARGIN, DURATION = 0.3, 4.0
ROBOT = zoo.robot_of("five_bar", carriers=False).loaded(
    *(rp.JointForces(joint, friction_speed=0.02) for joint in ("base_1", "base_2"))
)


@lru_cache
def found(iterations: int, seed: int = 0) -> ExcitingMotion:
    """Return a motion that a search of a few iterations finds, or the first one of it."""
    return exciting_motion(ROBOT, None, LIMITS, 2.0, harmonics=2, margin=MARGIN, iterations=iterations, seed=seed)


@lru_cache
def best() -> ExcitingMotion:
    return exciting_motion(ROBOT, None, LIMITS, DURATION, harmonics=4, margin=MARGIN, iterations=40)


def changed(robot: Robot, kind: str, of: str) -> Robot:
    """Return a robot with one parameter larger by one."""
    if kind in ("damping", "friction"):
        loads = [replace(one, **{kind: getattr(one, kind) + 1.0}) if one.joint == of else one for one in robot.loads]
        return replace(robot, loads=tuple(loads), closed_form=None)
    model = robot.model.copy()
    index = 1 + [body.name for body in robot.bodies].index(of)
    ten = model.inertias[index].toDynamicParameters()
    ten[INERTIAL.index(kind)] += 1.0
    model.inertias[index] = pin.Inertia.FromDynamicParameters(ten)
    return replace(robot, model=model, closed_form=None)


def information(motion: ExcitingMotion, samples: int = 200) -> Array:
    """Return (b, b) the information per sample of efforts relative to their limits, from differences of efforts."""
    path = motion.sample_at(np.arange(samples) * motion.duration / samples)
    before = rp.RneaDynamics(ROBOT).reduce(path)
    columns = []
    for k in motion.base.independent:
        parameter = motion.base.parameters[k]
        after = rp.RneaDynamics(changed(ROBOT, parameter.kind, parameter.of)).reduce(path)
        columns.append(np.linalg.solve(before.W, (after.f - before.f)[..., None])[..., 0] * parameter.size / 12.0)
    Y = np.stack(columns, axis=2).reshape(-1, len(columns))
    return np.asarray(Y.T @ Y / samples)


def used(motion: ExcitingMotion, samples: int) -> float:
    """Return the largest used fraction of a limit on a mesh; infinite where the machine cannot follow."""
    path = motion.sample_at(np.linspace(0.0, motion.duration, samples))
    try:
        along = rp.RneaDynamics(ROBOT).along(path)
    except rp.errors.RedundancyPinError:
        return float("inf")
    reduced = along.reduce()
    tau = np.linalg.solve(reduced.W, reduced.f[..., None])
    rates = along.tree.v[:, ROBOT.actuated_velocity]
    margin = spectrum_of(scaled(reduced.W, reduced.row_scale, reduced.column_scale)).margin
    serial = along.tree.serial_margin_bound
    parts = np.abs(tau).max() / 12.0, np.abs(rates).max() / 3.0, *(MARGIN * (m[0] / m).max() for m in (margin, serial))
    return float(max(parts))


def random_motion(seed: int) -> ExcitingMotion:
    """Return a random motion that starts at rest, as large as limits allow."""
    rng, harmonics = np.random.default_rng(seed), np.arange(1.0, 5.0)
    series = rng.standard_normal((9, 2)) / np.concatenate([[1.0], harmonics, harmonics])[:, None]
    series[8] = -harmonics[:3] @ series[5:8] / 4.0  # at rest at zero, from there on without a jump of the acceleration
    series[4] = -(harmonics[:3] ** 2) @ series[1:4] / 16.0
    series[0] = -series[1:5].sum(axis=0)
    low, high = 0.0, 1.0
    for _ in range(12):
        middle = 0.5 * (low + high)
        inside = used(replace(best(), series=middle * series), 150) <= 1.0
        low, high = (middle, high) if inside else (low, middle)
    return replace(best(), series=low * series)


def holds_its_limits(motion: ExcitingMotion, samples: int) -> None:
    assert 0.99 < used(motion, samples) < 1.001
    assert motion.binding
    assert "binding: " in repr(motion)
    assert "none" not in repr(motion)


def test_limits_hold_on_a_mesh_ten_times_as_fine_and_what_binds_is_said() -> None:
    motion = found(8)
    holds_its_limits(motion, 10 * 2 * 12 + 1)
    assert motion.status is ResultStatus.NOT_CONVERGED
    ends = motion.sample_at(np.array([0.0, 2.0, 2.7]))
    assert np.allclose(ends.x[:2], zoo.home_of(ROBOT), atol=1e-9)
    assert np.abs(ends.xd[:2]).max() < 1e-9
    assert np.abs(ends.xdd[:2]).max() < 1e-9
    assert np.allclose(ends.x[2], motion.sample_at(np.array([0.7])).x[0])


def test_the_search_gains_information() -> None:
    first, later = (np.linalg.slogdet(information(found(k), 60))[1] / 11 for k in (0, 8))
    assert later - first > 0.2


@pytest.mark.long
def test_information_is_five_times_that_of_random_motions() -> None:
    """As the geometric mean over the parameters: of the median, and still more than of the best of twenty."""
    motion, b = best(), len(best().base)
    holds_its_limits(motion, 10 * 4 * 12 + 1)
    assert b == 11
    own = np.linalg.slogdet(information(motion))[1] / b
    others = [np.linalg.slogdet(information(random_motion(seed), 100))[1] / b for seed in range(20)]
    assert own - max(others) > np.log(1.5)
    assert own - np.median(others) > np.log(5.0)


def test_the_condition_number_is_that_of_regressors_by_differences() -> None:
    motion = found(8)
    by_differences = information(motion, 24)
    assert motion.information == pytest.approx(by_differences, rel=1e-4, abs=1e-6 * by_differences.max())
    assert motion.condition == pytest.approx(np.sqrt(np.linalg.cond(by_differences)), rel=1e-3)


@pytest.mark.parametrize(
    ("limits", "quantity"), [(rp.Limits(actuator_speed=0.3), "speed"), (rp.Limits(effort=0.4), "effort")]
)
def test_each_limit_binds_and_holds_between_the_samples(limits: rp.Limits, quantity: str) -> None:
    motion = exciting_motion(ROBOT, None, limits, 2.0, harmonics=2, iterations=0)
    along = rp.RneaDynamics(ROBOT).along(motion.sample_at(np.linspace(0.0, 2.0, 401)))
    reduced = along.reduce()
    largest = {
        "speed": np.abs(along.tree.v[:, ROBOT.actuated_velocity]).max() / 0.3,
        "effort": np.abs(np.linalg.solve(reduced.W, reduced.f[..., None])).max() / 0.4,
    }[quantity]
    assert 0.998 < largest < 1.001
    assert {event.quantity for event in motion.binding} == {quantity}


def test_the_same_seed_gives_the_same_motion_and_another_one_another() -> None:
    again = found.__wrapped__(0).series
    assert np.array_equal(again, found(0).series)
    assert not np.allclose(again, found(0, seed=1).series)


def test_the_margin_holds_at_its_dips_between_the_samples() -> None:
    """Evaluated at the samples alone, the margin of this motion would be 0.2 % too small."""
    motion = found(0, seed=1)
    along = rp.RneaDynamics(ROBOT).along(motion.sample_at(np.linspace(0.0, motion.duration, 1501)))
    reduced = along.reduce()
    margin = spectrum_of(scaled(reduced.W, reduced.row_scale, reduced.column_scale)).margin
    serial = along.tree.serial_margin_bound
    least = min((margin / margin[0]).min(), (serial / serial[0]).min())
    assert least >= (1.0 - 1e-5) * MARGIN
    assert motion.margin == pytest.approx(least, rel=1e-4)


@pytest.mark.parametrize("name", ["gough", "3rrr"])
def test_poses_and_carriers_move_by_one_function_of_time(name: str) -> None:
    """Rates are those of the poses; carriers stay on their tracks."""
    robot = zoo.robot_of(name)
    motion = exciting_motion(robot, ["mass of *"], rp.Limits(effort=1e4), 3.0, harmonics=2, iterations=0)
    t, h = np.linspace(0.1, 2.9, 9), 1e-5
    before, here, after = (motion.sample_at(t + step) for step in (-h, 0.0, h))
    assert np.allclose((after.xd - before.xd) / (2.0 * h), here.xdd, atol=1e-5 * np.abs(here.xdd).max())
    if here.is_pose:
        moved = np.array([pin.log3(b[:3, :3] @ a[:3, :3].T) for a, b in zip(before.x, after.x, strict=True)]) / (
            2.0 * h
        )
        assert np.allclose(moved, here.xd[:, 3:], atol=1e-5 * np.abs(here.xd).max())
        assert np.allclose((after.x - before.x)[:, :3, 3] / (2.0 * h), here.xd[:, :3], atol=1e-6)
    carried = motion.carriers_at(np.linspace(0.0, 3.0, 200))
    for values, limit in zip(carried.s.T, robot.carrier_limits, strict=True):
        assert limit.lower <= values.min() < values.max() <= limit.upper


@pytest.mark.parametrize(
    "arguments",
    [
        {"duration": 0.0},
        {"duration": np.nan},
        {"harmonics": 1},
        {"harmonics": np.nan},
        {"margin": 1.0},
        {"margin": 0.0},
        {"seed": -1},
        {"iterations": 0.5},
    ],
)
def test_arguments_out_of_range_are_named(arguments: dict[str, float]) -> None:
    with pytest.raises(InputError, match=next(iter(arguments))):
        exciting_motion(ROBOT, **arguments)  # type: ignore[arg-type]


def test_parameters_that_no_motion_shows_are_named() -> None:
    with pytest.raises(InputError, match="shows the parameters"):
        exciting_motion(ROBOT, ["mass of proximal_1"], LIMITS, 2.0, harmonics=2)


def test_limits_that_gravity_alone_breaks_are_named_with_their_use() -> None:
    robot = rp.load_robot("delta")
    still = rp.PlatformMotion([0.0, 1.0], np.tile(zoo.home_of(robot), (2, 1)), np.zeros((2, 3)), np.zeros((2, 3)))
    holding = np.abs(rp.inverse_dynamics(robot, still).efforts.tau).max()
    with pytest.raises(InfeasiblePlanError, match=r"keeps the limits.*Allow larger efforts") as caught:
        exciting_motion(robot, None, rp.Limits(effort=1e-3), 2.0, harmonics=2)
    assert caught.value.details["amount"] == pytest.approx(holding / 1e-3, rel=1e-3)


def test_a_time_too_short_for_any_motion_is_named_where_rest_keeps_the_limits() -> None:
    with pytest.raises(InfeasiblePlanError, match=r"in 1e-06 s uses .* of one\..*longer duration"):
        exciting_motion("delta", None, rp.Limits(effort=60.0), 1e-6, harmonics=2)
