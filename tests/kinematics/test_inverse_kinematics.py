"""Inverse kinematics: q, v, a along platform motions, judged by finite differences, Pinocchio and denser samples."""

from __future__ import annotations

import itertools

import numpy as np
import pinocchio as pin
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from spatial_chains import CHAINS, chain_of

from redundancy_pin import PlatformMotion
from redundancy_pin.arrays import CLOSURE_TOLERANCE
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.assembly import configuration_difference
from redundancy_pin.kinematics.coordinates import working_modes
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.robot import Robot

STEP = 1e-5
VELOCITY = 2e-8  # central differences: STEP² times third derivatives of 10², and the closure tolerance over STEP
ACCELERATION = 1e-6  # the same on v, whose third derivatives reach 10⁴


@pytest.mark.parametrize("name", [*zoo.SHIPPED, *CHAINS])
@examples(2)
@given(seed=st.integers(0, 2**16))
def test_velocity_and_acceleration_are_derivatives(name: str, seed: int) -> None:
    robot = chain_of(name) if name in CHAINS else zoo.robot_of(name)
    motion = zoo.smooth_motion(robot, seed)
    t = np.linspace(0.0, 1.0, 6)
    tree, after, before = (inverse_kinematics(robot, motion.at(t + shift)) for shift in (0.0, STEP, -STEP))
    rate = configuration_difference(robot.model, before.q, after.q) / (2 * STEP)
    np.testing.assert_allclose(tree.v, rate, atol=VELOCITY)
    np.testing.assert_allclose(tree.a, (after.v - before.v) / (2 * STEP), atol=ACCELERATION)
    np.testing.assert_allclose(
        np.einsum("nim,ni->nm", tree.W, tree.motion.xd), tree.v[:, robot.actuated_velocity], atol=1e-13
    )
    assert np.all(tree.v[:, robot.carrier_velocity] == 0.0)
    assert np.all(tree.a[:, robot.carrier_velocity] == 0.0)


def pinocchio_gap(robot: Robot, q: np.ndarray) -> float:
    """Return the largest distance of the frames of a point or pin closure, by Pinocchio (all shipped ones are such)."""
    data = robot.model.createData()
    worst = 0.0
    for configuration in q:
        pin.framesForwardKinematics(robot.model, data, configuration)
        for closure in robot.closures:
            a, b = (data.oMf[robot.model.getFrameId(name)].translation for name in (closure.frame_a, closure.frame_b))
            worst = max(worst, float(np.abs(a - b).max()))
    return worst


def test_any_sampling_gives_the_same_closed_configurations(shipped: Robot) -> None:
    """Of a large motion: the way between few samples is followed all the same, as it is beside nanoseconds."""
    motion = zoo.smooth_motion(shipped, 8, scale=2.0)
    base = np.linspace(0.0, 3.0, 10)
    dense = inverse_kinematics(shipped, motion.at(np.linspace(0.0, 3.0, 901)))
    assert dense.reachable.all()
    assert np.abs(np.diff(dense.q[::100], axis=0)).max() > 0.05
    assert dense.residual.max() < CLOSURE_TOLERANCE
    assert pinocchio_gap(shipped, dense.q[::10]) < CLOSURE_TOLERANCE
    clusters = np.sort(np.concatenate([base, base + 1e-9, base + 2e-9]))
    for times, kept in ((base, slice(None)), (clusters, slice(None, None, 3)), (base[4:5], slice(None))):
        other = inverse_kinematics(shipped, motion.at(times))
        expected = slice(None, None, 100) if len(times) > 1 else slice(400, 401)
        turned = configuration_difference(shipped.model, dense.q[expected], other.q[kept])
        np.testing.assert_allclose(np.sin(turned) if len(times) == 1 else turned, 0.0, atol=1e-9)
        np.testing.assert_allclose(other.a[kept], dense.a[expected], rtol=1e-8, atol=1e-8)
    assert not any(array.flags.writeable for array in vars(dense).values() if isinstance(array, np.ndarray))


def test_the_platform_is_where_the_motion_says(shipped: Robot) -> None:
    if shipped.platform is None:
        pytest.skip("no platform")
    motion = zoo.smooth_motion(shipped, 6).at(np.linspace(0.0, 1.0, 9))
    tree = inverse_kinematics(shipped, motion)
    data, frame = shipped.model.createData(), shipped.model.getFrameId(shipped.platform.frame)
    for k in range(len(motion)):
        pin.forwardKinematics(shipped.model, data, tree.q[k], tree.v[k], tree.a[k])
        placement = pin.updateFramePlacement(shipped.model, data, frame)
        world = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        twist = pin.getFrameVelocity(shipped.model, data, frame, world).vector
        rate = pin.getFrameClassicalAcceleration(shipped.model, data, frame, world).vector
        if motion.is_pose:
            np.testing.assert_allclose(placement.homogeneous, motion.x[k], atol=CLOSURE_TOLERANCE)
            rows = np.arange(6)
        else:
            np.testing.assert_allclose(placement.translation[:2], motion.x[k, :2], atol=CLOSURE_TOLERANCE)
            rows = np.array([0, 1, 5])[: shipped.n]
        np.testing.assert_allclose(twist[rows], motion.xd[k], atol=1e-10)
        np.testing.assert_allclose(rate[rows], motion.xdd[k], atol=1e-9)


def test_columns_of_w_come_in_the_order_of_the_declaration() -> None:
    """Parsa 2014, eq. 2.4: the rows of the 2-RPR's J = Wᵀ are the directions of leg 1, then of leg 2."""
    robot = zoo.robot_of("2rpr")
    assert robot.actuated == ("slide_1", "slide_2")
    tree = inverse_kinematics(robot, zoo.smooth_motion(robot, 9).at(np.linspace(0.0, 1.0, 5)))
    for leg, hinge in enumerate(([0.0, 0.0], [0.5, 0.0])):
        away = tree.motion.x - hinge
        np.testing.assert_allclose(tree.W[:, :, leg], away / np.linalg.norm(away, axis=1)[:, None], atol=1e-12)


@examples(4)
@given(
    mode=st.sampled_from(list(itertools.product((1, -1), repeat=3))),
    radius=st.floats(0.15, 0.35),
    proximal=st.floats(0.8, 1.2),
    distal=st.floats(0.8, 1.2),
)
def test_every_working_mode_of_the_3rrr_is_the_one_asked_for(
    mode: tuple[int, ...], radius: float, proximal: float, distal: float
) -> None:
    from redundancy_pin import load_robot

    robot = load_robot(
        "3rrr", working_mode=mode, platform_radius=radius, proximal_length=proximal, distal_length=distal
    )
    motion = zoo.smooth_motion(robot, 1, scale=0.7).at(np.linspace(0.0, 1.0, 30))
    tree = inverse_kinematics(robot, motion)
    np.testing.assert_array_equal(working_modes(robot, tree.q), np.tile(mode, (30, 1)))
    # Parsa 2014, eq. 2.22: θ = γ + ψ in mode +1, θ = γ − ψ in mode −1
    hinges = [np.zeros(2), np.array([np.sqrt(3), 0.0]), np.array([np.sqrt(3) / 2, 1.5])]
    for leg, hinge in enumerate(hinges):
        phi = motion.x[:, 2] + (np.pi / 6, 5 * np.pi / 6, -np.pi / 2)[leg]
        away = motion.x[:, :2] - radius * np.stack([np.cos(phi), np.sin(phi)], axis=1) - hinge
        rho = np.linalg.norm(away, axis=1)
        psi = np.arccos((proximal**2 + rho**2 - distal**2) / (2 * proximal * rho))
        theta = np.arctan2(away[:, 1], away[:, 0]) + mode[leg] * psi
        column = zoo.index(robot, f"base_{leg + 1}")
        np.testing.assert_allclose(np.sin(tree.q[:, column] - theta), 0.0, atol=1e-9)
        np.testing.assert_allclose(np.cos(tree.q[:, column] - theta), 1.0, atol=1e-9)


def test_two_sided_samples_differ_in_acceleration_only(shipped: Robot) -> None:
    motion = zoo.smooth_motion(shipped, 12).at(np.linspace(0.0, 1.0, 9))
    order = np.array([0, 1, 2, 3, 4, 4, 5, 6, 7, 8])
    jumped = motion.xdd[order].copy()
    jumped[5] += 1.0
    tree = inverse_kinematics(shipped, PlatformMotion(motion.t[order], motion.x[order], motion.xd[order], jumped))
    np.testing.assert_allclose(tree.q[4], tree.q[5], atol=1e-12)
    np.testing.assert_allclose(tree.v[4], tree.v[5], atol=1e-10)
    jump = np.einsum("vi,i->v", tree.gamma[4], np.ones(shipped.n))
    np.testing.assert_allclose(tree.a[5] - tree.a[4], jump, atol=1e-8)


@pytest.mark.parametrize("name", zoo.SHIPPED)
def test_a_motion_in_other_coordinates_is_refused(name: str) -> None:
    robot = zoo.robot_of(name)
    wrong = PlatformMotion([0.0], np.zeros((1, robot.n + 1)), np.zeros((1, robot.n + 1)), np.zeros((1, robot.n + 1)))
    with pytest.raises(InputError, match=f"{robot.name} moves in {robot.n} coordinates") as caught:
        inverse_kinematics(robot, wrong)
    assert f"xd, xdd as (N, {robot.n})" in caught.value.remedy
