"""Paths that ask for trouble: poses beyond all reach, full stretch without declared modes, cranks that turn on."""

import numpy as np
import pytest
import yaml

import redundancy_pin as rp
from redundancy_pin.errors import RedundancyPinError, UnreachablePoseError
from redundancy_pin.robot.urdf import models_root


@pytest.fixture(scope="module")
def five_bar_without_modes(tmp_path_factory):
    """The shipped five-bar with nothing in its declaration that tells one elbow from the other."""
    folder = tmp_path_factory.mktemp("five_bar")
    source = models_root() / "five_bar"
    declaration = yaml.safe_load((source / "robot.yaml").read_text())
    del declaration["working_modes"]
    (folder / "robot.yaml").write_text(yaml.safe_dump(declaration))
    (folder / "five_bar.urdf.xacro").write_text((source / "five_bar.urdf.xacro").read_text())
    return rp.load_robot(folder)


def still(x):
    x = np.atleast_2d(np.asarray(x, dtype=float))
    return rp.PlatformMotion(np.arange(len(x), dtype=float), x, 0 * x, 0 * x)


@pytest.mark.long_for("1000000.0", "1000000000.0", "100.0")
@pytest.mark.parametrize("far", [1e2, 1e6, 1e9, 1e14])
def test_a_pose_beyond_all_reach_is_an_error_and_not_a_burden(far):
    robot = rp.load_robot("five_bar")
    home = [0.25, 0.6]
    with pytest.raises(UnreachablePoseError) as caught:
        rp.inverse_kinematics(robot, still([[far, 0.0]]))
    # the legs reach one metre from bases half a metre apart: the rest of the way stays open
    assert caught.value.details["gap"] > 0.1 * far
    with pytest.raises(UnreachablePoseError):
        rp.inverse_kinematics(robot, still([home, [far, 0.0]]))
    marked = rp.inverse_kinematics(robot, still([home, [far, 0.0], home]), mark_unreachable=True)
    np.testing.assert_array_equal(marked.reachable, [True, False, True])


def reach_of_leg(robot, x):
    return np.linalg.norm(x) / (robot.parameters["proximal_length"] + robot.parameters["distal_length"])


@pytest.mark.long_for("301-1e-06", "301-1e-09", "3-1e-06", "301-0.001", "3-1e-09")
@pytest.mark.parametrize("below", [1e-3, 1e-6, 1e-9])
@pytest.mark.parametrize("samples", [3, 30, 301])
def test_the_elbow_stays_on_its_side_next_to_full_stretch(five_bar_without_modes, below, samples):
    """A path that comes up to full stretch of the left leg and goes back: no mode says where the elbow belongs."""
    robot = five_bar_without_modes
    direction = np.array([np.cos(1.2), np.sin(1.2)])
    full = float(robot.parameters["proximal_length"] + robot.parameters["distal_length"])
    reach = full * (1.0 - below - 0.2 * np.abs(np.linspace(-1.0, 1.0, samples)))
    elbow = zoo.index(robot, "elbow_1")
    expected = np.sign(rp.inverse_kinematics(robot, still(reach[:1, None] * direction)).q[0, elbow])
    try:
        tree = rp.inverse_kinematics(robot, still(reach[:, None] * direction))
    except RedundancyPinError:
        assert below < 1e-6  # so near that the branches cannot be told apart: refused, not guessed
    else:
        np.testing.assert_array_equal(np.sign(tree.q[:, elbow]), expected)
    marked = rp.inverse_kinematics(robot, still(reach[:, None] * direction), mark_unreachable=True)
    sides = np.sign(marked.q[:, elbow])
    both = marked.reachable[1:] & marked.reachable[:-1]
    assert not (both & (sides[1:] * sides[:-1] < 0)).any()


def test_a_crank_counts_its_turns():
    robot = rp.load_robot("four_bar")
    crank = zoo.index(robot, "crank")
    for x in ([0.5, 5.5], [0.5, 10 * np.pi], [0.5, -7.0, 3.0]):
        tree = rp.inverse_kinematics(robot, still(np.array(x)[:, None]))
        np.testing.assert_allclose(tree.q[:, crank], x, atol=1e-9)
