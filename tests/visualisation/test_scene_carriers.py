"""A carrier that turns is drawn where its mass is, on an arc as long as its limits allow."""

from __future__ import annotations

from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pinocchio as pin
import pytest
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import Robot
from redundancy_pin.view import default_motion, show
from redundancy_pin.visualisation.viewer.mechanism import BALANCED_RADIUS
from redundancy_pin.visualisation.viewer.scene import Scene
from redundancy_pin.visualisation.viewer.solids import Solid, arc_points, corners_of

LEVER = np.array([0.1, 0.02, 0.03])
"""Centre of mass of every link that ``urdf_of`` writes, in the frame of its joint, m."""

ROUNDING = 1e-12
"""Of sums and products of numbers of order one."""

JOINTS = [
    J("left_base", "revolute", "base", "left_1"),
    J("left_elbow", "revolute", "left_1", "left_2", (0.4, 0, 0)),
    J("left_mount", "fixed", "left_2", "left_tip", (0.5, 0, 0)),
    J("right_base", "revolute", "base", "right_1", (0.5, 0, 0)),
    J("right_elbow", "revolute", "right_1", "right_2", (0.4, 0, 0)),
    J("right_mount", "fixed", "right_2", "right_tip", (0.5, 0, 0)),
    # a mass that turns off its axis, tilted against its link, and one whose centre of mass is on its axis
    J("rotor", "revolute", "left_1", "rotor_link", (0.2, 0.01, 0.05), (0.3, -0.2, 0.5)),
    J("wheel", "revolute", "right_1", "wheel_link", (0.2, 0, 0.05), axis=tuple(LEVER / np.linalg.norm(LEVER))),
]
DECLARATION = {
    "closures": [{"frames": ["left_tip", "right_tip"], "axes": ["x", "y"]}],
    "actuated": ["left_base", "right_base"],
    "carriers": [{"joint": "rotor", "position": [-0.7, 1.1]}, {"joint": "wheel"}],
    "independent": {"platform": "left_tip", "axes": ["x", "y"]},
    "reference": {"platform": [0.25, 0.6], "guess": {"left_base": 2.0, "right_base": 1.0}},
}


@cache
def robot() -> Robot:
    with TemporaryDirectory() as folder:
        return rp.load_robot(write_robot(Path(folder), urdf_of(JOINTS), DECLARATION))


@cache
def turned() -> tuple[Array, Scene]:
    """Angles (N, 2) through the rotor's range and round the wheel, and what is shown of them."""
    motion = default_motion(robot())
    rate = np.array([1.8, 2.0]) / np.ptp(motion.t)
    s = np.array([-0.7, 0.0]) + np.outer(motion.t - motion.t[0], rate)
    carriers = CarrierMotion(s, np.tile(rate, (len(s), 1)), np.zeros_like(s))
    return s, show(robot(), motion, carriers).scene


def solid(scene: Scene, name: str, body: str) -> Solid:
    return next(item for item in scene.solids if item.name == name and scene.names[item.body] == body)


def in_world(scene: Scene, item: Solid, points: Array, frame: int) -> Array:
    place = scene.placement[frame, item.body] @ item.placement
    return points @ place[:3, :3].T + place[:3, 3]


def distance_to(line: Array, point: Array) -> float:
    """Least distance of a point from straight pieces between points (P, 3)."""
    a, b = line[:-1], line[1:]
    along = np.clip(np.einsum("pi,pi->p", point - a, b - a) / np.einsum("pi,pi->p", b - a, b - a), 0.0, 1.0)
    return float(np.linalg.norm(a + along[:, None] * (b - a) - point, axis=1).min())


def test_the_mass_is_drawn_at_its_centre_of_mass_in_every_frame() -> None:
    """Against Pinocchio's own centre of mass of the body's subtree, which is the body alone."""
    s, scene = turned()
    box = solid(scene, "carrier", "rotor")
    model, motion = robot().model, default_motion(robot())
    data = model.createData()
    q = rp.inverse_kinematics(robot(), motion).q.copy()
    q[:, robot().carrier_position] = s
    for frame in (0, len(scene.t) // 2, len(scene.t) - 1):
        sample = int(np.abs(motion.t - motion.t[0] - scene.t[frame]).argmin())
        pin.centerOfMass(model, data, q[sample])
        drawn = in_world(scene, box, np.zeros((1, 3)), frame)[0]
        np.testing.assert_allclose(drawn, data.oMi[box.body].act(data.com[box.body]), atol=ROUNDING)


def test_the_mass_stays_on_its_arc_from_end_to_end() -> None:
    _, scene = turned()
    box, arc = solid(scene, "carrier", "rotor"), solid(scene, "track_of_rotor", "left_base")
    assert arc.role == "track"
    radius = np.hypot(LEVER[0], LEVER[1])  # the axis is z
    assert arc.size[0] == pytest.approx(radius)
    assert arc.size[2:] == (-0.7, 1.1)
    sagitta = radius * 0.05**2 / 8.0  # of the pieces the arc is drawn with
    for frame in range(0, len(scene.t), 10):
        centre = in_world(scene, box, np.zeros((1, 3)), frame)[0]
        assert distance_to(in_world(scene, arc, arc_points(arc), frame), centre) < 1.1 * sagitta
    for frame, end in ((0, 0), (-1, -1)):
        centre = in_world(scene, box, np.zeros((1, 3)), frame)[0]
        np.testing.assert_allclose(in_world(scene, arc, arc_points(arc), frame)[end], centre, atol=ROUNDING)


def test_an_arm_holds_the_mass() -> None:
    _, scene = turned()
    box, arm = solid(scene, "carrier", "rotor"), solid(scene, "carrier_arm", "rotor")
    half = 0.5 * arm.size[1] * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    foot, tip = (half @ arm.placement[:3, :3].T) + arm.placement[:3, 3]
    np.testing.assert_allclose(foot, [0.0, 0.0, LEVER[2]], atol=ROUNDING)
    np.testing.assert_allclose(tip, LEVER, atol=ROUNDING)
    np.testing.assert_allclose(box.placement[:3, 3], LEVER, atol=ROUNDING)


def test_a_balanced_carrier_is_a_bar_across_its_axis_in_a_full_round() -> None:
    _, scene = turned()
    bar, arc = solid(scene, "carrier", "wheel"), solid(scene, "track_of_wheel", "right_base")
    size = robot().characteristic_length
    assert arc.size[0] == pytest.approx(BALANCED_RADIUS * size)
    assert arc.size[2:] == (-np.pi, np.pi)  # limits of ±100 rad
    assert bar.size[0] == pytest.approx(2.0 * BALANCED_RADIUS * size)
    axis = LEVER / np.linalg.norm(LEVER)
    assert abs(bar.placement[:3, 0] @ axis) < ROUNDING  # across
    np.testing.assert_allclose(bar.placement[:3, 3], LEVER, atol=ROUNDING)
    directions = scene.placement[:, bar.body, :3, :3] @ bar.placement[:3, 0]
    assert np.ptp(directions, axis=0).max() > 0.5  # its turning is seen


def test_no_solid_is_twice_on_a_body() -> None:
    _, scene = turned()
    names = [(item.body, item.name) for item in scene.solids]
    assert len(set(names)) == len(names)


def test_pages_and_snapshots_show_it(tmp_path: Path) -> None:
    pytest.importorskip("meshcat")
    view = show(robot())
    view.save(tmp_path / "out.html")
    figure = rp.plot.snapshots(view, 2)
    rp.plot.save(figure, tmp_path / "out.png")
    arc = solid(view.scene, "track_of_rotor", "left_base")
    drawn = [line for line in figure.axes[0].lines if len(line.get_xdata()) == len(arc_points(arc))]
    expected = in_world(view.scene, arc, arc_points(arc), 0)[:, :2]
    assert any(np.allclose(np.array(line.get_xydata()), expected, atol=ROUNDING) for line in drawn)


@pytest.mark.parametrize("name", ["turning carriers", "3rrr"])
def test_corners_hold_what_is_drawn(name: str) -> None:
    """Boxes that hold a solid: every vertex that viewers draw is inside, and each face is touched."""
    pytest.importorskip("meshcat")
    from redundancy_pin.visualisation.viewer.meshcat_scene import tube

    scene = turned()[1] if name != "3rrr" else show("3rrr").scene
    seen = set()
    for item in scene.solids:
        corners = (corners_of(item) - item.placement[:3, 3]) @ item.placement[:3, :3]
        if item.shape == "arc":
            drawn, slack = tube(arc_points(item), item.size[1])[0], item.size[1]
        elif item.mesh is not None:
            drawn, slack = item.mesh[0], 1e-9
        else:
            radius, *length = item.size
            reach = {"box": 0.5 * np.array(item.size), "sphere": np.full(3, radius)}.get(
                item.shape, np.array([radius, radius, 0.5 * length[-1] if length else 0.0])
            )
            drawn, slack = np.array([reach, -reach]), 1e-9
        np.testing.assert_allclose(corners.max(axis=0), drawn.max(axis=0), atol=1.01 * slack)
        np.testing.assert_allclose(corners.min(axis=0), drawn.min(axis=0), atol=1.01 * slack)
        seen.add(item.shape)
    assert {"box", "cylinder", "sphere"} <= seen
