"""The engine-neutral tree against Pinocchio: placements, inertias, coordinates."""

import dataclasses

import numpy as np
import pinocchio as pin
import pytest
import zoo
from engine_oracles import random_state, random_tree
from engines.links import GROUND, link_tree

from redundancy_pin.errors import UnsupportedRobotError

ROUNDING = 1e-12
"""A dozen products of rotations in a machine of a metre."""


def placed(tree, q):
    """World placements of the links, by composing what the tree says."""
    placements = []
    for link, value in zip(tree.links, tree.from_q(q), strict=True):
        turn = pin.exp3(np.array([0, 0, value])) if link.kind == "revolute" else np.eye(3)
        slide = np.array([0, 0, value]) if link.kind == "prismatic" else np.zeros(3)
        base = pin.SE3.Identity() if link.parent == GROUND else placements[link.parent]
        placements.append(base * pin.SE3(link.rotation, link.translation) * pin.SE3(turn, slide))
    return placements


@pytest.mark.parametrize("seed", range(6))
def test_links_stand_where_pinocchio_places_them(seed):
    robot = random_tree(seed)
    model, data = robot.model, robot.model.createData()
    q, _ = random_state(robot, seed)
    tree = link_tree(robot)
    pin.forwardKinematics(model, data, q)
    for index, (place, link) in enumerate(zip(placed(tree, q), tree.links, strict=True), start=1):
        expected = data.oMi[index]
        np.testing.assert_allclose(place.translation, expected.translation, atol=ROUNDING)
        inertia = expected.act(model.inertias[index])
        np.testing.assert_allclose(place.act(link.centre), inertia.lever, atol=ROUNDING)
        np.testing.assert_allclose(place.rotation @ link.inertia @ place.rotation.T, inertia.inertia, atol=ROUNDING)
        assert link.mass == inertia.mass


@pytest.mark.parametrize("name", zoo.SHIPPED)
def test_closure_frames_meet_in_closed_configurations(name):
    robot = zoo.robot_of(name)
    tree = link_tree(robot)
    for q in zoo.random_closed(robot, seed=1, count=3):
        places = placed(tree, q)
        for closure in tree.closures:
            a, b = (
                (pin.SE3.Identity() if frame.link == GROUND else places[frame.link])
                * pin.SE3(frame.rotation, frame.translation)
                for frame in (closure.a, closure.b)
            )
            # all shipped closures hold the positions a motion could separate
            np.testing.assert_allclose(a.translation, b.translation, atol=1e-10)


@pytest.mark.parametrize("seed", range(3))
def test_coordinates_survive_the_way_there_and_back(seed):
    robot = random_tree(seed, joints=6)
    assert robot.model.nq > robot.model.nv  # one of them is continuous
    q, v = random_state(robot, seed)
    tree = link_tree(robot)
    np.testing.assert_allclose(tree.to_q(tree.from_q(q)[None])[0], q, atol=ROUNDING)
    np.testing.assert_array_equal(tree.to_v(tree.from_v(v)[None])[0], v)


def test_a_ball_joint_is_refused_by_name():
    model = pin.Model()
    model.addJoint(0, pin.JointModelSpherical(), pin.SE3.Identity(), "ball")
    robot = dataclasses.replace(zoo.robot_of("four_bar"), model=model, closures=())
    with pytest.raises(UnsupportedRobotError, match=r"'ball' has type JointModelSpherical") as caught:
        link_tree(robot)
    assert "revolute" in caught.value.remedy


def test_a_screw_is_refused():
    model = pin.Model()
    model.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Identity(), "screw")
    robot = dataclasses.replace(zoo.robot_of("four_bar"), model=model, closures=())
    with pytest.raises(UnsupportedRobotError, match="'screw'"):
        link_tree(robot)
