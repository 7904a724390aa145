"""Kinematics of the closed forms of the 2-RPR and the 3-RRR; dynamics are judged by the mission and the cross-check."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest
import zoo
from hypothesis import given
from hypothesis import strategies as st

import redundancy_pin as rp
from redundancy_pin.arrays import CLOSURE_TOLERANCE
from redundancy_pin.dynamics.virtual_work import two_rpr
from redundancy_pin.dynamics.virtual_work.three_rrr import ThreeRrrGeometry, inverse_displacement
from redundancy_pin.errors import UnsupportedRobotError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.robot.shipped import models_root

ROUNDING = 1e-13
"""A few hundred roundings of lengths of a few metres."""

GAP_ROUNDING = 1e-12
"""m: where the border is touched the gap is a difference of lengths that went through their squares."""

THESIS = ThreeRrrGeometry(1.0, 0.25, 1.0, 1.0)

UNEQUAL = ThreeRrrGeometry(0.9, 0.3, 1.2, 0.9)

PHI = np.array([np.pi / 6, 5 * np.pi / 6, -np.pi / 2])

coordinate = st.floats(-3, 3)


def u(angle):
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def corners(geometry, pose):
    return pose[:2] - geometry.platform_radius * u(pose[2] + PHI)


@given(x=coordinate, y=coordinate, mode=st.tuples(*[st.sampled_from([1, -1])] * 2))
def test_legs_of_the_two_rpr_close_the_loops_in_their_mode(x, y, mode):
    legs = two_rpr.inverse_displacement(0.5, [[x, y]], mode)
    away = np.hypot([x, x - 0.5], y) > 1e-6
    np.testing.assert_array_equal(np.sign(legs.d[away, 0]), np.array(mode)[away])
    tip = np.array([[0.0, 0.0], [0.5, 0.0]]) + legs.d * u(np.angle(legs.u[:, 0]))
    np.testing.assert_allclose(tip[away], np.tile([x, y], (2, 1))[away], atol=ROUNDING)
    assert np.all(legs.residual[away] < ROUNDING)


@given(
    pose=st.tuples(st.floats(-1, 2.5), st.floats(-1, 2.5), st.floats(-np.pi, np.pi)),
    geometry=st.sampled_from([THESIS, UNEQUAL]),
)
def test_all_modes_of_the_three_rrr_close_or_report_how_far_the_corner_is(pose, geometry):
    pose = np.array(pose)
    A, G = corners(geometry, pose), geometry.base_points
    rho = np.hypot(*(A - G).T)
    l1, l2 = geometry.proximal_length, geometry.distal_length
    short = np.maximum(np.maximum(rho - l1 - l2, abs(l1 - l2) - rho), 0.0)
    within = short == 0.0
    for mode in product((1, -1), repeat=3):
        legs = inverse_displacement(geometry, pose[None], mode)
        tip = G + l1 * u(legs.theta[:, 0]) + l2 * u(legs.beta[:, 0])
        np.testing.assert_allclose(tip[within], A[within], atol=ROUNDING)
        np.testing.assert_allclose(np.abs(legs.b)[within], l1, atol=ROUNDING)
        np.testing.assert_allclose(np.abs(legs.e)[within], l2, atol=ROUNDING)
        np.testing.assert_allclose(legs.residual[:, 0], short, atol=GAP_ROUNDING)
        # θ = γ ± ψ: the mode is the side of the line G A on which the elbow lies
        side = np.sin(legs.theta[:, 0] - np.arctan2(*(A - G).T[::-1]))
        clear = within & (np.abs(side) > 1e-6)
        np.testing.assert_array_equal(np.sign(side)[clear], np.array(mode)[clear])


def test_thesis_formulas_for_theta_and_jacobian():
    """Angles by arc cosine and the Jacobian's entries as printed (Parsa 2014, eq. 2.22-2.38)."""
    pose, mode = np.array([1.0, 0.4, 0.3]), (1, -1, 1)
    legs = inverse_displacement(UNEQUAL, pose[None], mode)
    l1, l2, l3 = 1.2, 0.9, 0.3
    for i in range(3):
        xA, yA = corners(UNEQUAL, pose)[i] - UNEQUAL.base_points[i]
        rho = np.hypot(xA, yA)
        theta = np.arctan2(yA, xA) + mode[i] * np.arccos((l1**2 + rho**2 - l2**2) / (2 * l1 * rho))
        phi = pose[2] + PHI[i]
        a, b = xA - l1 * np.cos(theta), yA - l1 * np.sin(theta)
        c, d = l1 * (xA * np.sin(theta) - yA * np.cos(theta)), l3 * (a * np.sin(phi) - b * np.cos(phi))
        assert abs(np.exp(1j * theta) - np.exp(1j * legs.theta[i, 0])) < ROUNDING
        np.testing.assert_allclose(legs.jacobian[:, i, 0], -np.array([a, b, d]) / c, atol=ROUNDING)
        np.testing.assert_allclose(legs.c[i, 0], c, atol=ROUNDING)


UNEQUAL_LENGTHS = {"base_radius": 0.9, "platform_radius": 0.3, "proximal_length": 1.2, "distal_length": 0.9}


@pytest.mark.parametrize(("beyond", "reached"), [(0.5 * CLOSURE_TOLERANCE, True), (1e-9, False), (0.3, False)])
def test_reach_ends_at_the_stretched_leg(beyond, reached):
    """Leg 1 is stretched along its own arm: G, B, A and P on one line at 30 degrees."""
    legs = inverse_displacement(THESIS, np.append((2.0 + 0.25 + beyond) * u(np.pi / 6), 0.0)[None])
    assert legs.reachable[0, 0] == reached
    assert np.isnan(legs.b[0, 0]) != reached
    np.testing.assert_allclose(legs.residual[0, 0], beyond, atol=1e-14)  # roundings of 2 m


def test_legs_without_a_direction_give_no_warning():
    """A leg of no length, which any direction closes; a folded leg of equal links, which any angle closes: c = 0."""
    short = two_rpr.inverse_displacement(0.5, [[0.0, 0.0]])
    assert np.isnan(short.u[0, 0])
    assert short.u[1, 0] == -1.0
    np.testing.assert_array_equal(short.residual, 0.0)
    folded = inverse_displacement(THESIS, np.append(0.25 * u(np.pi / 6), 0.0)[None])
    assert abs(folded.margin[0, 0]) < 1e-12
    assert folded.reachable[0, 0]
    for array in (short.d, short.u, short.jacobian, folded.b, folded.residual, folded.theta, folded.jacobian):
        assert not array.flags.writeable


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
@pytest.mark.parametrize("change", [{"closed_form": None}, {"closed_form": "gough"}, {"working_mode": (1,)}])
def test_robots_without_a_closed_form_are_refused(name, change):
    with pytest.raises(UnsupportedRobotError, match="RneaDynamics"):
        rp.VirtualWork(replace(zoo.robot_of(name), **change))


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_masses_of_a_model_that_was_replaced_are_not_those_of_the_arguments(name):
    robot = zoo.robot_of(name)
    model = robot.model.copy()
    max(model.inertias, key=lambda inertia: inertia.mass).mass *= 1.01
    with pytest.raises(UnsupportedRobotError, match="closed_form=None"):
        rp.VirtualWork(replace(robot, model=model))
    last = next(body.links[0] for body in reversed(robot.bodies) if body.links)
    carrying = robot.loaded(rp.Payload(last, 2.0), rp.Payload("base", 3.0))  # payloads are no other machine
    assert rp.VirtualWork(carrying).robot is carrying


@pytest.mark.parametrize(
    ("model", "old", "new"),
    [
        ("2rpr", "actuated: [slide_1, slide_2]", "actuated: [slide_2, slide_1]"),
        ("2rpr", "actuated: [slide_1, slide_2]", "actuated: [swivel_1, slide_2]"),
        ("2rpr", "signs: [1, 1]", "signs: [1, -1]"),
        ("3rrr", "actuated: [base_1, base_2, base_3]", "actuated: [elbow_1, base_2, base_3]"),
        ("3rrr", "actuated: [base_1, base_2, base_3]", "actuated: [base_1, base_2, base_3, elbow_1]"),
        ("3rrr", "joints: [elbow_1, elbow_2, elbow_3]", "joints: [elbow_2, elbow_1, elbow_3]"),
        ("3rrr", "carrier_1, acceleration", "carrier_2, acceleration"),
    ],
)
def test_motors_modes_and_carriers_in_another_order_have_no_closed_form(model, old, new, tmp_path):
    """Its numbers would be those of other motors; all other backends take them."""
    for file in (models_root() / model).iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    path = tmp_path / "robot.yaml"
    text = path.read_text()
    assert text.count(old) == 1
    text = text.replace(new, "@") if old.startswith("carrier") else text  # the two change places
    path.write_text(text.replace(old, new).replace("@", old))
    robot = rp.load_robot(path)
    assert robot.closed_form is None
    with pytest.raises(UnsupportedRobotError, match="other motors, modes or carriers"):
        rp.VirtualWork(robot)


def test_one_sample_has_no_spring_that_counts_turns_and_the_slack_of_tracks_of_all_backends():
    plain, still = rp.load_robot("3rrr"), np.zeros(3)
    x = follower(plain).home.x
    for joint, refused in (("base_1", True), (plain.carriers[0], False)):
        sprung = rp.VirtualWork(plain.loaded(rp.JointForces(joint, stiffness=7.0)))
        if refused:
            with pytest.raises(UnsupportedRobotError, match="whole turns"):
                sprung.torque(x, still, still)
        else:
            assert sprung.torque(x, still, still).status.solved
    upper = plain.carrier_limits[0].upper
    for s, status in ((upper * (1.0 + 1e-15), "ok"), (upper * (1.0 + 1e-6), "out_of_range")):
        for backend in (rp.VirtualWork, rp.RneaDynamics):
            assert backend(plain).torque(x, still, still, [s, 0.0, 0.0]).status.label == status
