"""RNEA backend: what it accepts, refuses and returns."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import zoo

from redundancy_pin import CarrierMotion, CompiledDynamics, PlatformMotion, inverse_dynamics
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.errors import CarrierLimitError, InputError, UnreachablePoseError
from redundancy_pin.robot import Robot
from redundancy_pin.status import SampleStatus


def assert_close(actual: np.ndarray, expected: np.ndarray, relative: float) -> None:
    """Compare relative to the largest entry: small entries are differences of large ones."""
    np.testing.assert_allclose(actual, expected, rtol=0.0, atol=relative * np.abs(expected).max(initial=0.0))


def test_left_out_carriers_are_parked_at_zero() -> None:
    robot = zoo.robot_of("3rrr")
    motion = zoo.smooth_motion(robot, 11).at(np.linspace(0.0, 1.0, 4))
    dynamics = RneaDynamics(robot)
    left_out, parked = dynamics.reduce(motion), dynamics.reduce(motion, CarrierMotion.parked(4, 3))
    for name in ("f", "W", "carrier_force"):
        np.testing.assert_array_equal(getattr(left_out, name), getattr(parked, name))


def test_one_solution_of_the_kinematics_serves_many_carrier_motions() -> None:
    robot = zoo.robot_of("3rrr")
    t = np.linspace(0.0, 1.0, 4)
    dynamics, motion = RneaDynamics(robot), zoo.smooth_motion(robot, 11).at(t)
    along = dynamics.along(motion)
    for seed in (0, 1, 0):
        carriers = zoo.carriers_at(robot, t, seed)
        np.testing.assert_array_equal(along.reduce(carriers).f, dynamics.reduce(motion, carriers).f)
    assert np.isfinite(along.tree.q).all()
    assert not along.tree.q[:, robot.carrier_position].any()


def test_a_single_sample_equals_that_sample_of_many(shipped: Robot) -> None:
    t = np.linspace(0.0, 1.0, 5)
    motion, carriers = zoo.smooth_motion(shipped, 13).at(t), zoo.carriers_at(shipped, t)
    dynamics = RneaDynamics(shipped)
    many, alone = dynamics.along(motion), dynamics.along(motion[2:3])
    one = carriers[2:3]
    assert_close(alone.reduce(one).f, many.reduce(carriers).f[2:3], 1e-9)
    assert_close(alone.base_wrench(one), many.base_wrench(carriers)[2:3], 1e-9)
    assert_close(alone.energy(one), many.energy(carriers)[2:3], 1e-9)


def test_unreachable_samples_are_marked_and_the_others_unharmed() -> None:
    robot = zoo.robot_of("five_bar")
    x = np.stack([np.full(41, 0.25), 0.76 + 0.6 * np.sin(np.linspace(0.0, np.pi, 41))], axis=1)
    motion = PlatformMotion(np.arange(41.0), x, np.ones_like(x), np.ones_like(x), check_rates=False)
    carriers = zoo.carriers_at(robot, motion.t)
    dynamics = RneaDynamics(robot)
    with pytest.raises(UnreachablePoseError):
        dynamics.reduce(motion, carriers)
    marked = dynamics.reduce(motion, carriers, unreachable="mark")
    within = x[:, 1] < np.sqrt(1 - 0.25**2)
    np.testing.assert_array_equal(marked.reachable, within)
    for array in (marked.f, marked.W, marked.carrier_force):
        assert np.isnan(array[~within]).all()
        assert np.isfinite(array[within]).all()
    assert np.all(marked.gap[~within] > 1e-3)
    first = dynamics.reduce(motion[:5], carriers[:5])
    assert_close(marked.f[:5], first.f, 1e-9)


def test_what_to_do_with_unreachable_poses_is_one_of_two() -> None:
    robot = zoo.robot_of("five_bar")
    motion = zoo.smooth_motion(robot, 1).at(np.zeros(1))
    with pytest.raises(InputError, match="unreachable is 'ignore'"):
        RneaDynamics(robot).reduce(motion, unreachable="ignore")  # type: ignore[arg-type]


def test_a_carrier_off_its_track_is_named_unless_the_check_is_off() -> None:
    robot = zoo.robot_of("3rrr")
    motion = zoo.smooth_motion(robot, 14).at(np.linspace(0.0, 1.0, 5))
    s = np.zeros((5, 3))
    s[3, 1] = 1.25
    carriers = CarrierMotion(s, np.zeros((5, 3)), np.zeros((5, 3)))
    with pytest.raises(
        CarrierLimitError, match=r"'carrier_2' leaves its track \[-1, 1\] m by 0.25 m at sample 3"
    ) as caught:
        RneaDynamics(robot).reduce(motion, carriers)
    assert caught.value.details["carrier"] == "carrier_2"
    assert caught.value.details["sample"] == 3
    assert caught.value.details["amount"] == pytest.approx(0.25)
    assert np.isfinite(RneaDynamics(robot).reduce(motion, carriers, check_track=False).f).all()


@pytest.mark.parametrize(("samples", "carriers"), [(4, 3), (5, 2), (5, 0)])
def test_carriers_that_do_not_fit_are_refused(samples: int, carriers: int) -> None:
    robot = zoo.robot_of("3rrr")
    motion = zoo.smooth_motion(robot, 14).at(np.linspace(0.0, 1.0, 5))
    with pytest.raises(InputError, match=r"expected \(5, 3\)"):
        RneaDynamics(robot).reduce(motion, CarrierMotion.parked(samples, carriers))
    with pytest.raises(InputError, match=r"expected \(5, 3\)"):
        inverse_dynamics(RneaDynamics(robot), motion, CarrierMotion.parked(samples, carriers))


def test_results_are_read_only_and_of_the_stated_shapes(shipped: Robot) -> None:
    n, m, k = shipped.n, shipped.m, shipped.k
    reduced = RneaDynamics(shipped).reduce(zoo.smooth_motion(shipped, 1).at(np.linspace(0.0, 1.0, 4)))
    shapes = {"t": (4,), "f": (4, n), "W": (4, n, m), "carrier_force": (4, k), "reachable": (4,), "gap": (4,)}
    for name, shape in {**shapes, "row_scale": (n,), "column_scale": (m,)}.items():
        array = getattr(reduced, name)
        assert array.shape == shape, name
        assert not array.flags.writeable, name
    assert isinstance(replace(reduced, f=reduced.f * 2), ReducedDynamics)


# --- one sample after another: test_control_rate_branches.py ---


def test_a_start_may_be_open_by_noise_but_not_visibly() -> None:
    robot, still = zoo.robot_of("3rrr"), np.zeros(3)
    dynamics, home, rng = RneaDynamics(robot), zoo.home_of(robot), np.random.default_rng(0)
    expected = dynamics.torque(home, still, still + 1.0)
    assert expected.residual < 1e-11
    for size, statuses in ((1e-4, {SampleStatus.OK}), (1.0, {SampleStatus.BRANCH_LOST})):
        starts = robot.q_reference + rng.normal(0.0, size, (20, robot.model.nq))
        noisy = [dynamics.torque(home, still, still + 1.0, start=start) for start in starts]
        assert {one.status for one in noisy} == statuses
        assert all(np.allclose(one.tau, expected.tau, rtol=1e-10) for one in noisy if one.status.solved)


def test_samples_are_unpacked_and_their_arguments_refused_by_name() -> None:
    robot, still = zoo.robot_of("gough"), np.zeros(6)
    dynamics, home = RneaDynamics(robot), zoo.home_of(robot)
    W, f, force = dynamics.sample(home, still, still)
    assert (W.shape, f.shape, force.shape) == ((6, 6), (6,), (0,))
    for call in (dynamics.torque, dynamics.sample):
        with pytest.raises(InputError, match=r"^s has shape \(2,\), expected \(0,\)"):
            call(home, still, still, s=[1.0, 2.0])
        with pytest.raises(InputError, match=r"^xdd has shape \(5,\), expected \(6,\)"):
            call(home, still, still[:5])


def test_efforts_that_grow_towards_type_one_have_a_small_serial_margin() -> None:
    """The first leg of the five-bar nearly stretched: W is far from singular, the margin goes with the root."""
    still, margins = np.zeros(2), []
    rnea, compiled = RneaDynamics(zoo.robot_of("five_bar")), CompiledDynamics(zoo.robot_of("five_bar"))
    for reach in (0.8, 1.0 - 1e-4, 1.0 - 1e-6):
        x = [0.25, np.sqrt(reach**2 - 0.0625)]
        one, other = (dynamics.torque(x, still, still + 1.0) for dynamics in (rnea, compiled))
        assert one.margin > 0.1
        assert other.serial_margin == pytest.approx(one.serial_margin, rel=1e-6)
        margins.append(one.serial_margin)
    assert margins[0] > 0.1
    assert margins[1] / margins[2] == pytest.approx(10.0, rel=0.05)
