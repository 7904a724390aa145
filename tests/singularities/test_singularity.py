"""Singularities against geometry; ellipsoids, stiffness and play against closed forms, energies and vertices."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import zoo
from hypothesis import given
from hypothesis import strategies as st

import redundancy_pin as rp
from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array
from redundancy_pin.dynamics.virtual_work.three_rrr import ThreeRrrGeometry, inverse_displacement
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.robot.scales import column_scale, row_scale
from redundancy_pin.singularities.classify import SingularityKind, classify, classify_motion, signed_margin
from redundancy_pin.spectrum import scaled, spectrum_of

ROUNDING = 1e-12
"""Singular values and directions of well-scaled 7 x 7 matrices, with three digits of room."""

BASE = np.array([[0.0, 0.0], [0.5, 0.0]])
"""Base hinges of the 2-RPR."""


def two_rpr_at(points: Array) -> Array:
    """Return (N, nq) configurations of the 2-RPR with the end-effector at points (N, 2)."""
    robot = zoo.robot_of("2rpr")
    q = np.zeros((len(points), robot.model.nq))
    for leg, base in enumerate(BASE, start=1):
        span = points - base
        q[:, zoo.index(robot, f"swivel_{leg}")] = np.arctan2(span[:, 1], span[:, 0])
        q[:, zoo.index(robot, f"slide_{leg}")] = np.hypot(span[:, 0], span[:, 1])
    return q


def three_rrr_from(x: Array, theta: Array, beta: Array) -> Array:
    """Return (N, nq) configurations of the 3-RRR from pose (N, 3) and link angles (3, N)."""
    robot = zoo.robot_of("3rrr")
    q = np.zeros((len(x), robot.model.nq))
    for leg in range(3):
        q[:, zoo.index(robot, f"base_{leg + 1}")] = theta[leg]
        q[:, zoo.index(robot, f"elbow_{leg + 1}")] = beta[leg] - theta[leg]
    q[:, zoo.index(robot, "wrist_1")] = x[:, 2] - beta[0]
    return q


@given(st.floats(-1.0, 1.5), st.floats(0.01, 1.0), st.sampled_from([-1, 1]))
def test_two_rpr_condition_number_is_the_cotangent_of_half_the_angle_between_the_legs(x, y, side) -> None:
    classes = classify(zoo.robot_of("2rpr"), two_rpr_at(np.array([[x, side * y]])))
    one, other = (np.array([x, side * y]) - base for base in BASE)
    cosine = abs(one @ other) / np.linalg.norm(one) / np.linalg.norm(other)
    gamma = np.arctan2(np.sqrt(1 - min(cosine, 1.0) ** 2), cosine)
    assert classes.kind[0] == SingularityKind.REGULAR
    # the angle loses digits as the legs align, with the square of their alignment
    assert classes.condition[0] == pytest.approx(1.0 / np.tan(gamma / 2), rel=1e-14 / gamma**2)
    assert classes.condition_unscaled[0] == pytest.approx(classes.condition[0], rel=ROUNDING)
    assert classes.parallel_margin[0] == pytest.approx(np.sqrt(max(1.0 - cosine, 0.0)), abs=1e-14 / gamma)
    assert np.isnan(classes.uncontrolled_twist).all()
    assert np.isnan(classes.lost_direction).all()


@given(st.floats(-1.0, 1.5).filter(lambda x: min(abs(x), abs(x - 0.5)) > 1e-3))
def test_two_rpr_is_type_ii_on_the_base_line(x) -> None:
    classes = classify(zoo.robot_of("2rpr"), two_rpr_at(np.array([[x, 0.0]])))
    assert SingularityKind(classes.kind[0]).label == "type_ii"
    np.testing.assert_allclose(classes.uncontrolled_twist, [[0.0, 1.0]], atol=ROUNDING)
    assert classes.condition[0] == np.inf
    assert classes.parallel_margin[0] < ROUNDING
    assert classes.locked_margin[0] < ROUNDING
    assert classes.near_type_ii[0]
    assert not classes.passive_motion[0]


def test_two_rpr_with_a_leg_of_no_length_spins_it_freely() -> None:
    classes = classify(zoo.robot_of("2rpr"), two_rpr_at(np.array([[0.0, 0.0], [0.25, 0.3]])))
    assert classes.kind.tolist() == [SingularityKind.COMBINED, SingularityKind.REGULAR]
    assert classes.passive_motion.tolist() == [True, False]
    assert classes.type_i.tolist() == classes.type_ii.tolist() == [True, False]
    np.testing.assert_allclose(classes.lost_direction[0], [0.0, 1.0], atol=ROUNDING)  # across the leg
    assert np.isnan(classes.uncontrolled_twist[0]).all()  # the swivel turns, the platform does not
    assert np.isnan(classes.parallel_margin[0])
    assert classes.condition[0] == np.inf


@given(st.floats(-0.6, 0.4), st.floats(0.0, 0.3))
def test_three_rrr_with_a_stretched_leg_loses_the_direction_along_it(turn, alpha) -> None:
    """A stretched leg keeps its corner from moving along the leg: u·v + ((A − P) × u) ω = 0 for every motion."""
    robot = zoo.robot_of("3rrr")
    geometry = ThreeRrrGeometry.from_parameters(robot.parameters)
    theta = np.pi / 6 + turn
    direction = np.array([np.cos(theta), np.sin(theta)])
    arm = -0.25 * np.array([np.cos(alpha + np.pi / 6), np.sin(alpha + np.pi / 6)])  # from P to corner 1
    pose = np.array([[*(2.0 * direction - arm), alpha]])
    legs = inverse_displacement(geometry, pose)
    thetas, betas = np.array(legs.theta), np.array(legs.beta)
    if not legs.reachable.all() or np.abs(legs.margin[1:]).min() < 0.05:
        return
    thetas[0] = betas[0] = theta  # exactly stretched: from the position the elbow is only known to 1e-8
    classes = classify(robot, three_rrr_from(pose, thetas, betas))
    assert classes.kind[0] == SingularityKind.TYPE_I
    row = np.array([*direction, arm[0] * direction[1] - arm[1] * direction[0]])
    lost = row / row_scale(robot) ** 2
    lost /= np.linalg.norm(lost * row_scale(robot))
    assert abs(np.dot(classes.lost_direction[0] * row_scale(robot), lost * row_scale(robot))) == pytest.approx(1.0)
    np.testing.assert_allclose(classes.lost_direction, classes.least_producible, atol=ROUNDING)
    assert not classes.passive_motion[0]
    assert classes.serial_margin[0] < ROUNDING
    # neighbours on either side are regular, at a margin that grows with the elbow angle
    near = classify(robot, three_rrr_from(pose, np.array(legs.theta), np.array(legs.beta)), tolerance=1e-7)
    assert near.kind[0] == SingularityKind.TYPE_I


def test_four_bar_at_the_end_of_its_crank_is_combined() -> None:
    """Coupler and rocker in line: the crank can go no further, and both rotate with the crank at rest."""
    lengths = {"ground_length": 0.4, "crank_length": 0.3, "coupler_length": 0.35, "rocker_length": 0.2}
    robot = zoo.robot_of("four_bar", **lengths)
    reach = lengths["coupler_length"] + lengths["rocker_length"]
    cosine = (0.4**2 + 0.3**2 - reach**2) / (2 * 0.4 * 0.3)
    crank = np.arccos(cosine)
    tip = 0.3 * np.array([np.cos(crank), np.sin(crank)])
    rocker = np.arctan2(tip[1], tip[0] - 0.4)
    q = np.zeros(3)
    q[zoo.index(robot, "crank")], q[zoo.index(robot, "rocker")] = crank, rocker
    classes = classify(robot, q)
    assert classes.kind[0] == SingularityKind.COMBINED
    assert classes.passive_motion[0]
    assert np.isfinite(classes.lost_direction[0, 0])
    assert np.isnan(classes.uncontrolled_twist[0, 0])


def test_margins_and_directions_along_a_regular_motion(shipped) -> None:
    """The parallel margin is that of W, and |D_a Wᵀ ẋ| of the least controlled unit twist, which makes it the least."""
    motion = zoo.smooth_motion(shipped, seed=3).at(np.linspace(0.0, 1.0, 30))
    tree = inverse_kinematics(shipped, motion)
    classes = classify_motion(tree)
    assert (classes.kind == SingularityKind.REGULAR).all()
    units = row_scale(shipped), column_scale(shipped)
    np.testing.assert_allclose(classes.parallel_margin, spectrum_of(scaled(tree.W, *units)).margin, rtol=1e-9)
    rates = np.einsum("nij,ni->nj", tree.W, classes.least_controlled) * units[1]
    np.testing.assert_allclose(np.linalg.norm(rates, axis=1), classes.parallel_margin, rtol=1e-9)
    # the inverse kinematics's bound is within a factor √p of the serial margin
    p = shipped.model.nv - shipped.k
    assert (tree.serial_margin_bound <= classes.serial_margin * (1 + 1e-9)).all()
    assert (tree.serial_margin_bound * np.sqrt(p) >= classes.serial_margin * (1 - 1e-9)).all()
    assert (classes.locked_margin > 0.0).all()
    for twist in (classes.least_controlled * units[0], classes.least_producible * units[0]):
        np.testing.assert_allclose(np.linalg.norm(twist, axis=1), 1.0, rtol=ROUNDING)
        largest = np.take_along_axis(twist, np.abs(twist).argmax(axis=1)[:, None], axis=1)
        assert (largest > -1e-6).all()


def test_unreachable_samples_are_marked() -> None:
    robot = zoo.robot_of("3rrr")
    x = np.array([[0.866, 0.5, 0.0], [5.0, 0.5, 0.0], [0.9, 0.5, 0.0]])
    tree = inverse_kinematics(robot, PlatformMotion([0.0, 1.0, 2.0], x, 0 * x, 0 * x), mark_unreachable=True)
    classes = classify_motion(tree)
    assert classes.kind.tolist() == [SingularityKind.REGULAR, SingularityKind.UNREACHABLE, SingularityKind.REGULAR]
    assert np.isnan(classes.parallel_margin[1])
    assert np.isnan(classes.least_controlled[1]).all()
    assert len(classes) == 3


def test_one_actuator_too_few_is_no_singularity() -> None:
    robot = zoo.driven_by(zoo.robot_of("2rpr"), "slide_1")
    classes = classify(robot, two_rpr_at(np.array([[0.25, 0.3], [0.2, 0.0]])))
    assert (classes.kind == SingularityKind.REGULAR).all()
    np.testing.assert_allclose(classes.parallel_margin, 1.0, rtol=ROUNDING)  # W is the unit vector of leg 1
    leg = np.array([0.25, 0.3]) / np.hypot(0.25, 0.3)
    np.testing.assert_allclose(classes.least_controlled[0], leg, atol=ROUNDING)


def test_one_actuator_too_many_removes_the_singularity() -> None:
    robot = zoo.driven_by(zoo.robot_of("2rpr"), "slide_1", "slide_2", "swivel_1")
    classes = classify(robot, two_rpr_at(np.array([[0.2, 0.0], [0.0, 0.0]])))
    # Wᵀ has the rows u1, u2 and n1/d1; on the base line u1 = −u2, and n1 L/d1 alone controls y
    assert classes.kind[0] == SingularityKind.REGULAR
    assert classes.parallel_margin[0] == pytest.approx(min(np.sqrt(2.0), robot.characteristic_length / 0.2))
    assert classes.kind[1] == SingularityKind.TYPE_I  # with the swivel locked nothing is left to move


def test_one_freedom_driven_where_its_motor_stands_still() -> None:
    # crank and coupler in line, 0.1 + 0.35 m: the rocker turns round, and W, its rate over the crank's, is rounding
    robot = zoo.driven_by(zoo.robot_of("four_bar"), "rocker")
    theta = np.arccos((0.45**2 + 0.4**2 - 0.25**2) / (2.0 * 0.45 * 0.4))
    psi = np.arctan2(0.45 * np.sin(theta), 0.45 * np.cos(theta) - 0.4)
    q = np.zeros((1, robot.model.nq))
    for name, angle in {"crank": theta, "rocker": psi, "coupler": theta + np.pi - psi}.items():
        q[0, zoo.index(robot, name)] = angle
    classes = classify(robot, q)
    assert classes.kind[0] == SingularityKind.TYPE_II
    assert classes.parallel_margin[0] == pytest.approx(0.0, abs=ROUNDING)
    assert np.isinf(classes.condition[0])


def test_scaling_makes_the_condition_number_independent_of_the_unit_of_length() -> None:
    """The 3-RRR in decimetres: the plain condition number, of virtual work's W, changes; the scaled one does not."""
    names = ("base_radius", "platform_radius", "proximal_length", "distal_length", "tail_length")
    metres = zoo.robot_of("3rrr")
    decimetres = zoo.robot_of("3rrr", **{name: 10.0 * float(metres.parameters[name]) for name in names})
    one, ten = (classify(robot, robot.q_reference) for robot in (metres, decimetres))
    assert ten.condition[0] == pytest.approx(one.condition[0], rel=1e-9)
    assert ten.parallel_margin[0] == pytest.approx(one.parallel_margin[0], rel=1e-9)
    assert ten.condition_unscaled[0] != pytest.approx(one.condition_unscaled[0], rel=0.05)
    for robot, found in ((metres, one), (decimetres, ten)):
        W = rp.VirtualWork(robot).sample(zoo.home_of(robot), *np.zeros((2, 3))).W
        assert found.condition_unscaled[0] == pytest.approx(np.linalg.cond(W), rel=1e-9)


def test_near_singular_is_told_from_singular() -> None:
    y = 0.5 * NEAR_SINGULAR_MARGIN / np.sqrt(2.0) * 0.25
    classes = classify(zoo.robot_of("2rpr"), two_rpr_at(np.array([[0.25, y], [0.25, 0.25]])))
    assert classes.near_type_ii.tolist() == [True, False]
    assert not classes.type_ii.any()


def test_bad_arguments_are_refused() -> None:
    robot = zoo.robot_of("2rpr")
    open_chain = np.array(robot.q_reference)
    open_chain[0] += 0.1
    with pytest.raises(InputError, match="Configuration 0 of q is not closed"):
        classify(robot, open_chain)
    with pytest.raises(InputError, match="tolerance is 0"):
        classify(robot, robot.q_reference, tolerance=0.0)
    with pytest.raises(InputError, match="shape"):
        classify(robot, np.zeros((2, 3)))


# --- ellipsoids, stiffness and play


CLOSED_FORM = 1e-12


def directions(x: Array) -> Array:
    """Return (N, 2, 2) the directions of both legs (rows) of the shipped 2-RPR at (N, 2): ρ̇ = e · ẋ."""
    base = np.array([[0.0, 0.0], [0.5, 0.0]])
    legs = x[:, None] - base
    return legs / np.linalg.norm(legs, axis=2, keepdims=True)


@pytest.fixture(scope="module")
def poses() -> tuple[rp.Robot, Array, Array]:
    """The 2-RPR at poses (N, 2) and its configurations there."""
    robot = zoo.robot_of("2rpr")
    x = np.array([[0.25, 0.4], [0.1, 0.3], [0.3, 0.35]])
    still = np.zeros(x.shape)
    return (
        robot,
        x,
        rp.inverse_kinematics(robot, rp.PlatformMotion([0.0, 1.0, 2.0], x, still, still, check_rates=False)).q,
    )


def test_condition_and_axes_of_two_legs_at_an_angle(poses: tuple[rp.Robot, Array, Array]) -> None:
    robot, x, q = poses
    e = directions(x)
    gamma = np.arccos((e[:, 0] * e[:, 1]).sum(axis=1))  # between the legs
    performance = rp.performance(robot, q)
    # ẋᵀ (e₁ e₁ᵀ + e₂ e₂ᵀ) ẋ ≤ 1: eigenvalues 1 ± cos γ
    half = np.sqrt(np.stack([1.0 - np.abs(np.cos(gamma)), 1.0 + np.abs(np.cos(gamma))], axis=1))
    assert np.abs(performance.velocity.axes - 1.0 / half).max() < CLOSED_FORM
    assert np.abs(performance.force.axes - half[:, ::-1]).max() < CLOSED_FORM
    assert np.abs(performance.condition - half[:, 1] / half[:, 0]).max() < CLOSED_FORM
    assert np.abs(performance.manipulability - 1.0 / np.abs(np.sin(gamma))).max() < CLOSED_FORM
    assert np.abs(performance.margin - half[:, 0]).max() < CLOSED_FORM


@pytest.mark.parametrize("name", ["3rrr", "gough"])
def test_ellipsoids_are_what_motors_of_unit_norm_reach(name: str) -> None:
    robot = zoo.robot_of(name)
    q, rng = zoo.random_closed(robot, 1, 3), np.random.default_rng(0)
    rates, efforts = rng.uniform(0.5, 2.0, (2, robot.m))
    performance = rp.performance(robot, q, rates=rates, efforts=efforts)
    unit = np.where([axis.startswith("r") for axis in robot.platform.axes], robot.characteristic_length, 1.0)
    ball = rng.normal(size=(200, robot.m))
    ball /= np.linalg.norm(ball, axis=1, keepdims=True)
    for k in range(3):
        force = (ball * efforts) @ performance.W[k].T / unit
        velocity = np.linalg.solve(performance.W[k].T, (ball * rates).T).T * unit
        for ellipsoid, reached in ((performance.force, force), (performance.velocity, velocity)):
            inside = reached @ ellipsoid.directions[k] / ellipsoid.axes[k]
            assert np.abs(np.linalg.norm(inside, axis=1) - 1.0).max() < 1e-10
    assert (np.diff(performance.velocity.axes) <= 0.0).all()
    assert np.abs(performance.condition / rp.classify(robot, q).condition - 1.0).max() < 1e-10


def test_at_a_type_ii_pose_speed_is_endless_and_one_force_is_none() -> None:
    robot = zoo.robot_of("five_bar")
    q = np.array(robot.q_reference)
    turn = 2 * np.pi / 3  # the distal links in line
    for joint, angle in {"base_1": turn, "elbow_1": -turn, "base_2": np.pi / 3, "elbow_2": turn}.items():
        q[zoo.index(robot, joint)] = angle
    performance = rp.performance(robot, q)
    assert np.isinf(performance.velocity.axes[0, 0])
    assert np.isfinite(performance.velocity.axes[0, 1])
    assert performance.force.axes[0, 1] < 1e-9
    assert np.isinf(rp.platform_play(robot, q, 1e-4)).all()


def displaced(robot: rp.Robot, q: Array, steps: Array) -> Array:
    """Return (N, nq) configurations of a robot at platform positions (N, n) beside that of q, by inverse kinematics."""
    x = rp.forward_kinematics(robot, q[robot.actuated_velocity], start=q).x[0] + steps
    still = np.zeros(x.shape)
    return np.array(
        rp.inverse_kinematics(robot, rp.PlatformMotion(np.arange(len(x)), x, still, still, check_rates=False)).q
    )


@pytest.mark.parametrize("springs", ["motors", "all"])
def test_stiffness_is_the_second_derivative_of_the_springs_energy(springs: str) -> None:
    robot = zoo.robot_of("3rrr")
    q = np.array(robot.q_reference)
    names = robot.actuated if springs == "motors" else (*robot.actuated, "elbow_2", "wrist_1")
    k = dict(zip(names, [100.0, 150.0, 80.0, 40.0, 25.0], strict=False))
    columns = [zoo.index(robot, name) for name in k]
    h = 1e-3
    signs, unit = ((1, 1), (1, -1), (-1, 1), (-1, -1)), np.eye(3)
    pairs = [h * (a * unit[i] + b * unit[j]) for i in range(3) for j in range(3) for a, b in signs]
    away = displaced(robot, q, np.array(pairs))[:, columns] - q[columns]
    energy = (0.5 * np.array(list(k.values())) * away**2).sum(axis=1).reshape(3, 3, 2, 2)
    second = (energy[:, :, 0, 0] - energy[:, :, 0, 1] - energy[:, :, 1, 0] + energy[:, :, 1, 1]) / (4 * h * h)
    stiffness = rp.platform_stiffness(robot, q, k if springs == "all" else list(k.values()))[0]
    assert np.abs(stiffness - second).max() < 1e-4 * np.abs(second).max()  # O(h²)
    if springs == "motors":
        J = np.linalg.inv(rp.performance(robot, q).W[0].T)
        assert np.abs(stiffness - np.linalg.inv(J).T @ np.diag(list(k.values())) @ np.linalg.inv(J)).max() < 1e-9


def test_play_is_attained_at_a_corner_of_the_box_and_never_passed() -> None:
    robot = zoo.robot_of("3rrr")
    q, off = np.array(robot.q_reference), np.array([1e-5, 2e-5, 3e-5])
    u = q[robot.actuated_velocity]
    home = rp.forward_kinematics(robot, u).x[0]
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=3))) * off
    errors = np.abs(np.concatenate([rp.forward_kinematics(robot, u + corner).x for corner in corners]) - home)
    play = rp.platform_play(robot, q, off)[0]
    assert np.abs(errors.max(axis=0) / play - 1.0).max() < 1e-3  # second order in δ


def test_play_of_redundant_motors_is_what_all_of_them_allow() -> None:
    own = zoo.robot_of("2rpr")
    robot = zoo.driven_by(own, "slide_1", "slide_2", "swivel_1")
    q, off = zoo.random_closed(own, 1, 4), np.array([1e-3, 2e-3, 3e-3])
    play = rp.platform_play(robot, q, off)
    for W, largest in zip(rp.performance(robot, q).W, play, strict=True):
        # vertices of |Wᵀ Δx| ≤ δ: two of the bounds hold with equality
        vertices = []
        for i, j in itertools.combinations(range(3), 2):
            for signs in itertools.product((-1.0, 1.0), repeat=2):
                x = np.linalg.solve(W[:, [i, j]].T, np.array(signs) * off[[i, j]])
                if (np.abs(W.T @ x) <= off + 1e-12).all():
                    vertices.append(np.abs(x))
        assert np.abs(largest - np.max(vertices, axis=0)).max() < 1e-9
    assert (play <= rp.platform_play(own, q, off[:2]) + 1e-12).all()


def test_numbers_of_no_sense_are_refused(poses: tuple[rp.Robot, Array, Array]) -> None:
    robot, _, q = poses
    for wrong, message in (
        (lambda: rp.performance(robot, q, rates=-1.0), "rates is"),
        (lambda: rp.platform_play(robot, q, [-1e-3, 0.0]), "play is"),
        (lambda: rp.platform_stiffness(robot, q, {"slide_9": 1.0}), "slide_9.*Did you mean"),
        (lambda: rp.platform_stiffness(robot, q, -1.0), "stiffness of"),
    ):
        with pytest.raises(InputError, match=message):
            wrong()
    for bad in ([], [1.0, 2.0, 3.0], [[1, 2], [3]], 10**400, "x", np.nan):
        for question in (
            lambda bad=bad: rp.platform_stiffness(robot, q, bad),
            lambda bad=bad: rp.platform_stiffness(robot, q, {robot.actuated[0]: bad}),
            lambda bad=bad: rp.platform_play(robot, q, bad),
            lambda bad=bad: rp.performance(robot, q, rates=bad),
            lambda bad=bad: rp.performance(robot, bad),
        ):
            with pytest.raises(InputError):
                question()
    weak = replace(robot, actuated=robot.actuated[:1])
    with pytest.raises(UnsupportedRobotError, match="1 main actuators and 2 DOF"):
        rp.performance(weak, q)


def test_a_signed_margin_is_negative_where_the_determinant_is() -> None:
    """Singular values 2 and 1/2 by construction; no determinant without a square matrix, and none of NaN."""
    turned = np.array([[0.6, -0.8], [0.8, 0.6]])
    W = np.stack([turned @ np.diag([2.0, sign]) for sign in (0.5, -0.5, np.nan)])
    np.testing.assert_allclose(signed_margin(W), [0.5, -0.5, np.nan], atol=1e-15)
    np.testing.assert_allclose(signed_margin(np.array([[[-2.0, 0.0, 0.0], [0.0, 0.5, 0.0]]])), [0.5], atol=1e-15)
