"""Closing the chains by Newton, Γ of the closed state, and its margin to type I."""

from __future__ import annotations

import numpy as np
import pytest
import zoo
from examples import examples
from hypothesis import given
from hypothesis import strategies as st
from spatial_chains import chain_of

from redundancy_pin.arrays import CLOSURE_TOLERANCE, SINGULAR_MARGIN
from redundancy_pin.kinematics.assembly import (
    assemble,
    configuration_difference,
    integrate,
    project,
)
from redundancy_pin.kinematics.coordinates import coordinates, difference
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale, velocity_scale

# K of these machines has condition numbers below 1e3: the residual of its inverse stays below 1e3 roundings.
INVERSION = 1e-12
SAME = 1e-9  # two closed configurations of one regular pose: the closure tolerance over a margin of 0.01


@pytest.mark.parametrize("name", zoo.SHIPPED)
def test_bad_guesses_end_closed_at_the_target_or_say_that_they_did_not(name: str) -> None:
    """Random guesses one radian (or metre) off. Plain Newton loses 3 to 13 % of them on all but the 2-RPR."""
    robot = zoo.robot_of(name)
    system, target = zoo.system_of(robot), np.repeat(zoo.home_of(robot)[None], 400, axis=0)
    assembled = assemble(system, zoo.random_tree(robot, 5, 400)[0], target)
    state = system.evaluate(assembled.q)
    away = difference(robot, target, coordinates(robot, state)) * row_scale(robot)
    off = np.concatenate([state.phi, away], axis=1)
    np.testing.assert_array_equal(assembled.closed, np.abs(off).max(axis=1) < CLOSURE_TOLERANCE)
    np.testing.assert_allclose(assembled.residual, np.abs(off).max(axis=1), atol=1e-15)
    assert assembled.closed.mean() > 0.975


def test_newton_ends_where_full_steps_would_run_in_circles() -> None:
    """From a nearly stretched leg a full Newton step throws the elbow over several turns; the line search does not."""
    robot = zoo.robot_of("five_bar")
    system = zoo.system_of(robot)
    stretched = assemble(system, robot.q_reference[None], np.array([[0.25, np.sqrt(1 - 0.25**2) - 1e-7]])).q
    target = np.array([[0.25, 0.3]])
    assembled = assemble(system, stretched, target)
    assert assembled.closed.all()
    q, full = stretched.copy(), []
    for _ in range(3):
        state = system.evaluate(q)
        k = np.concatenate([state.Jc, state.Jx], axis=1)[0][:, system.pose_columns]
        residual = np.concatenate([-state.phi, target - coordinates(robot, state)], axis=1)[0]
        step = np.zeros(robot.model.nv)
        step[system.pose_columns] = np.linalg.solve(k, residual)
        full.append(np.abs(step).max())
        q = q + step
    assert full[0] > 100 * np.pi  # the case is necessary
    # the elbows stay within a turn of where they were
    assert np.abs(assembled.q - stretched).max() < 2 * np.pi


def test_gap_out_of_reach_compares_with_geometry() -> None:
    """Both legs of the five-bar are short of the target; the rows of closure and target share the shortage.

    The largest of four rows is at least the larger shortage over two pairs of axes, 1 / (2√2) of it. The line search
    stops near the best; full steps would fling the legs about and leave nearly twice the shortage.
    """
    robot = zoo.robot_of("five_bar")
    rng = np.random.default_rng(0)
    angle, beyond = rng.uniform(0.2, np.pi - 0.2, 300), rng.uniform(0.05, 1.0, 300)
    target = [0.25, 0.0] + (1.25 + beyond)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    short = np.stack([np.linalg.norm(target - hinge, axis=1) - 1.0 for hinge in ([0.0, 0.0], [0.5, 0.0])]).max(axis=0)
    assembled = assemble(zoo.system_of(robot), np.repeat(robot.q_reference[None], 300, axis=0), target)
    assert not assembled.closed.any()
    assert np.all(assembled.residual > short / (2 * np.sqrt(2)))
    assert np.all(assembled.residual < 1.1 * short)


def test_closing_alone_changes_the_guess_as_little_as_possible() -> None:
    """With neither target nor actuators the change is normal to the closed set, to second order in its length."""
    robot = zoo.robot_of("3rrr")
    system = zoo.system_of(robot)
    closed = zoo.random_closed(robot, 22, 5)
    push = np.zeros_like(closed)
    push[:, system.pose_columns] = 1e-4 * np.random.default_rng(1).uniform(-1, 1, (5, len(system.pose_columns)))
    assembled = assemble(system, closed + push)
    assert assembled.closed.all()
    change = assembled.q - closed - push
    jc = system.evaluate(assembled.q).Jc
    _, _, right = np.linalg.svd(jc[:, :, system.pose_columns])
    tangent = right[:, jc.shape[1] :]
    along = np.einsum("ntv,nv->nt", tangent, change[:, system.pose_columns])
    assert np.abs(change).max() > 1e-6
    assert np.abs(along).max() < 100 * 1e-4**2


def test_many_at_once_equal_each_alone(shipped: Robot) -> None:
    system = zoo.system_of(shipped)
    guess = np.concatenate([zoo.random_tree(shipped, 31, 4)[0], zoo.random_closed(shipped, 31, 3)])
    target = np.repeat(zoo.home_of(shipped)[None], 7, axis=0)
    batch = assemble(system, guess, target)
    for i in range(7):
        alone = assemble(system, guess[i : i + 1], target[i : i + 1])
        assert alone.closed[0] == batch.closed[i]
        if alone.closed[0]:
            np.testing.assert_allclose(alone.q[0], batch.q[i], atol=SAME)


def test_a_singular_sample_does_not_spoil_its_stack() -> None:
    """K is exactly singular at the 2-RPR's base hinge: the step there is minimum-norm, the others' is Newton's."""
    robot = zoo.robot_of("2rpr")
    system = zoo.system_of(robot)
    singular = np.array(robot.q_reference)
    singular[zoo.index(robot, "slide_1")] = 0.0
    home = zoo.home_of(robot)
    assembled = assemble(system, np.stack([singular, robot.q_reference]), np.stack([home, home + 0.01]))
    assert assembled.closed[1]
    assert np.isfinite(assembled.q).all()


def test_redundant_rows_still_close() -> None:
    """The hinge chain with its guess turned back and forth: rank-deficient steps are minimum-norm, not refused."""
    robot = zoo.robot_of("five_bar")
    system = zoo.system_of(robot)
    folded = np.array(robot.q_reference)
    for name in ("elbow_1", "elbow_2"):
        folded[zoo.index(robot, name)] = 0.0
    assembled = assemble(system, folded[None])
    assert assembled.closed.all()


def test_carriers_keep_their_positions() -> None:
    robot = zoo.robot_of("3rrr")
    guess = np.array(robot.q_reference)[None] + 0.01
    guess[0, robot.carrier_position] = [0.3, -0.2, 0.1]
    assembled = assemble(zoo.system_of(robot), guess, zoo.home_of(robot)[None])
    np.testing.assert_array_equal(assembled.q[0, robot.carrier_position], [0.3, -0.2, 0.1])


@pytest.mark.parametrize("kind", ["five_bar", "continuous"])
def test_integrate_and_difference_are_inverse(kind: str) -> None:
    robot = chain_of(kind) if kind == "continuous" else zoo.robot_of(kind)
    rng = np.random.default_rng(4)
    q = np.repeat(robot.q_reference[None], 5, axis=0)
    step = rng.uniform(-1.0, 1.0, (5, robot.model.nv))
    moved = integrate(robot.model, q, step)
    np.testing.assert_allclose(configuration_difference(robot.model, q, moved), step, atol=1e-14)
    assert integrate(robot.model, q[:0], step[:0]).shape == q[:0].shape
    assert configuration_difference(robot.model, q[:0], q[:0]).shape == step[:0].shape


def test_gamma_obeys_the_closures_and_the_margin_is_a_lower_bound(shipped: Robot) -> None:
    """Of the smallest singular value of K with velocities in m/s on both sides, within the root of its size."""
    system = zoo.system_of(shipped)
    assert not any(row.rotation for row in system.rows)  # closure rows are in m/s already
    state = system.evaluate(zoo.random_closed(shipped, 11, 8))
    projection = project(system, state)
    gamma = projection.gamma
    np.testing.assert_allclose(state.Jc @ gamma, 0.0, atol=INVERSION)
    np.testing.assert_allclose(
        state.Jx @ gamma, np.broadcast_to(np.eye(shipped.n), (8, shipped.n, shipped.n)), atol=INVERSION
    )
    assert np.all(gamma[:, shipped.carrier_velocity] == 0.0)
    k = np.concatenate([state.Jc, state.Jx * row_scale(shipped)[:, None]], axis=1) / velocity_scale(shipped)
    smallest = np.linalg.svd(k[:, :, system.pose_columns], compute_uv=False).min(axis=1)
    assert np.all(projection.margin <= smallest * (1 + INVERSION))
    assert np.all(projection.margin >= smallest / np.sqrt(len(system.pose_columns)) * (1 - INVERSION))


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
        slides = [zoo.index(robot, f"slide_{leg}") for leg in (1, 2)]
        swivel = zoo.index(robot, "swivel_2")
        singular[0, slides], singular[0, swivel] = (0.0, 0.5), np.pi
    assert np.abs(system.evaluate(singular).phi).max() < 1e-11
    both = np.concatenate([singular, robot.q_reference[None]])
    projection = project(system, system.evaluate(both))
    assert projection.margin[0] == 0.0
    assert np.isnan(projection.gamma[0, system.pose_columns]).all()
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
