"""Ellipsoids, stiffness and play against closed forms, potential energies and vertices of boxes of motor errors."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, UnsupportedRobotError

EXACT = 1e-12


def two_rpr(x: Array) -> Array:
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
    e = two_rpr(x)
    gamma = np.arccos((e[:, 0] * e[:, 1]).sum(axis=1))  # between the legs
    performance = rp.performance(robot, q)
    # ẋᵀ (e₁ e₁ᵀ + e₂ e₂ᵀ) ẋ ≤ 1: eigenvalues 1 ± cos γ
    half = np.sqrt(np.stack([1.0 - np.abs(np.cos(gamma)), 1.0 + np.abs(np.cos(gamma))], axis=1))
    assert np.abs(performance.velocity.axes - 1.0 / half).max() < EXACT
    assert np.abs(performance.force.axes - half[:, ::-1]).max() < EXACT
    assert np.abs(performance.condition - half[:, 1] / half[:, 0]).max() < EXACT
    assert np.abs(performance.manipulability - 1.0 / np.abs(np.sin(gamma))).max() < EXACT
    assert np.abs(performance.margin - half[:, 0]).max() < EXACT


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


def moved(robot: rp.Robot, q: Array, steps: Array) -> Array:
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
    away = moved(robot, q, np.array(pairs))[:, columns] - q[columns]
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
    for given in ([], [1.0, 2.0, 3.0], [[1, 2], [3]], 10**400, "x", np.nan):
        for question in (
            lambda given=given: rp.platform_stiffness(robot, q, given),
            lambda given=given: rp.platform_stiffness(robot, q, {robot.actuated[0]: given}),
            lambda given=given: rp.platform_play(robot, q, given),
            lambda given=given: rp.performance(robot, q, rates=given),
            lambda given=given: rp.performance(robot, given),
        ):
            with pytest.raises(InputError):
                question()
    weak = replace(robot, actuated=robot.actuated[:1])
    with pytest.raises(UnsupportedRobotError, match="1 main actuators and 2 DOF"):
        rp.performance(weak, q)


@pytest.mark.parametrize("name", ["2rpr", "gough"])
def test_figure_has_an_ellipse_a_pose_in_each_panel(name: str) -> None:
    pytest.importorskip("matplotlib")
    robot = zoo.robot_of(name)
    performance = rp.performance(robot, zoo.random_closed(robot, 2, 3))
    drawn = rp.plot.ellipsoids(performance)
    for axes, unit in zip(drawn.axes, ("m/s", " N "), strict=True):
        assert unit in axes.get_title()
        rings = [line for line in axes.lines if len(line.get_xdata()) == 73]
        assert len(rings) == 3
    if name == "2rpr":  # drawn as long as it is
        ring = np.array(drawn.axes[1].lines[-2].get_xydata()) - np.array(drawn.axes[1].lines[-1].get_xydata())
        length = np.linalg.norm(ring, axis=1)
        assert abs(length.max() / length.min() - performance.force.condition[-1]) < 1e-9
    with pytest.raises(InputError, match="A performance was expected"):
        rp.plot.ellipsoids(5)
