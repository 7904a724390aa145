"""Γ, the inverse of K, and the margin to type I."""

from __future__ import annotations

import numpy as np
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.kinematics.assembly import SINGULAR_MARGIN, assemble, project
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale, velocity_scale

# K of these machines has condition numbers below 1e3: the residual of its inverse stays below 1e3 roundings.
INVERSION = 1e-12


def test_gamma_obeys_the_closures_and_gives_the_platform_velocity(shipped: Robot) -> None:
    system = zoo.system_of(shipped)
    state = system.evaluate(zoo.random_closed(shipped, 11, 8))
    gamma = project(system, state).gamma
    np.testing.assert_allclose(state.Jc @ gamma, 0.0, atol=INVERSION)
    np.testing.assert_allclose(
        state.Jx @ gamma, np.broadcast_to(np.eye(shipped.n), (8, shipped.n, shipped.n)), atol=INVERSION
    )
    assert np.all(gamma[:, shipped.carrier_velocity] == 0.0)


def test_margin_bounds_the_smallest_singular_value_from_below(shipped: Robot) -> None:
    system = zoo.system_of(shipped)
    state = system.evaluate(zoo.random_closed(shipped, 12, 8))
    margin = project(system, state).margin
    smallest = np.linalg.svd(scaled_k(shipped, state.Jc, state.Jx), compute_uv=False).min(axis=1)
    p = len(system.pose_columns)
    assert np.all(margin <= smallest * (1 + INVERSION))
    assert np.all(margin >= smallest / np.sqrt(p) * (1 - INVERSION))


def scaled_k(robot: Robot, jc: np.ndarray, jx: np.ndarray) -> np.ndarray:
    """Return K with velocities in m/s on both sides; translation closure rows are in m/s already."""
    system = zoo.system_of(robot)
    assert not any(row.rotation for row in system.rows)
    k = np.concatenate([jc, jx * row_scale(robot)[None, :, None]], axis=1) / velocity_scale(robot)
    return k[:, :, system.pose_columns]


def test_columns_of_gamma_are_the_2rprs_own_kinematics() -> None:
    """Parsa 2014, eqs. 2.3 and 2.7: the slide rate is u·v and the swivel rate n·v / d."""
    robot = zoo.robot_of("2rpr")
    system = zoo.system_of(robot)
    q = zoo.random_closed(robot, 3, 6)
    gamma = project(system, system.evaluate(q)).gamma
    for leg in ("1", "2"):
        swivel, slide = (
            robot.model.joints[robot.model.getJointId(f"{name}_{leg}")].idx_v for name in ("swivel", "slide")
        )
        angle, length = q[:, swivel], q[:, slide]
        np.testing.assert_allclose(gamma[:, slide], np.stack([np.cos(angle), np.sin(angle)], axis=1), atol=INVERSION)
        across = np.stack([-np.sin(angle), np.cos(angle)], axis=1) / length[:, None]
        np.testing.assert_allclose(gamma[:, swivel], across, atol=INVERSION * 10)


def five_bar_at(height: float) -> np.ndarray:
    """Return a configuration of the five-bar on its axis of symmetry; both legs stretch together at the top."""
    robot = zoo.robot_of("five_bar")
    reach = np.sqrt(1.0 - 0.25**2)  # links of 0.5 m, hinges 0.5 m apart
    target = np.array([[0.25, reach - height]])
    return assemble(zoo.system_of(robot), robot.q_reference[None], target, max_iterations=200).q


@pytest.mark.parametrize("name", ["five_bar", "2rpr"])
def test_margin_is_zero_and_gamma_nan_at_a_type_i_singularity(name: str) -> None:
    robot = zoo.robot_of(name)
    system = zoo.system_of(robot)
    if name == "five_bar":
        singular = five_bar_at(0.0)
    else:  # the end-effector on the first base hinge: that leg has no direction
        singular = robot.q_reference[None].copy()
        slides = [robot.model.joints[robot.model.getJointId(f"slide_{leg}")].idx_q for leg in (1, 2)]
        swivel = robot.model.joints[robot.model.getJointId("swivel_2")].idx_q
        singular[0, slides], singular[0, swivel] = (0.0, 0.5), np.pi
    assert np.abs(system.evaluate(singular).phi).max() < 1e-11
    both = np.concatenate([singular, robot.q_reference[None]])
    projection = project(system, system.evaluate(both))
    assert projection.margin[0] == 0.0
    assert np.isnan(projection.inverse[0]).all()
    # the regular neighbour in the same stack is untouched
    alone = project(system, system.evaluate(robot.q_reference[None]))
    np.testing.assert_allclose(projection.gamma[1], alone.gamma[0], rtol=1e-12)
    assert projection.margin[1] == pytest.approx(alone.margin[0])


@pytest.mark.long
@examples(15)
@given(exponent=st.floats(-9.0, -3.0))
def test_margin_falls_with_the_square_root_of_the_way_to_full_stretch(exponent: float) -> None:
    """cos of the elbow angle gives the reach, so the sine of the elbow, and the margin, goes with √height."""
    robot = zoo.robot_of("five_bar")
    system = zoo.system_of(robot)
    height = 10.0**exponent
    margin = project(system, system.evaluate(five_bar_at(height))).margin[0]
    unit = project(system, system.evaluate(five_bar_at(1e-4))).margin[0] / 1e-2
    # the next term of the expansion is of the relative order √height; Newton leaves the elbow off by 1e-11 / √height
    assert margin == pytest.approx(unit * np.sqrt(height), rel=0.1)
    assert margin > SINGULAR_MARGIN
