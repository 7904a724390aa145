"""What the moving picture shows is where the robot is, and its arrows point where the efforts push."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
import yourdfpy
import zoo
from spatial_chains import chain_of

import redundancy_pin as rp
from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array
from redundancy_pin.errors import InputError
from redundancy_pin.robot import Robot
from redundancy_pin.view import default_motion
from redundancy_pin.visualisation.viewer.mechanism import body_points, links
from redundancy_pin.visualisation.viewer.scene import (
    FRAME_RATE,
    LONGEST_FORCE,
    LONGEST_TORQUE,
    MARGIN_COLORS,
    MOST_FRAMES,
    MOST_POINTS,
    Arrow,
    Scene,
    configurations,
    frame_samples,
    make_scene,
    margin_classes,
    margin_labels,
    path_samples,
)
from redundancy_pin.visualisation.viewer.solids import ROLE_COLORS

ROUNDING = 1e-9
"""Positions of order one from a closure gap of 1e-11 and sines and cosines on either side."""


def scene_of(robot: Robot) -> Scene:
    return rp.show(robot).scene


def in_world(scene: Scene, body: int, point: Array) -> Array:
    """Return (F, 3) where a point of a body goes."""
    return scene.placement[:, body, :3, :3] @ point + scene.placement[:, body, :3, 3]


def arrow_of(scene: Scene, name: str) -> Arrow:
    return next(arrow for arrow in scene.arrows if arrow.name == name)


def test_frames_are_samples_at_their_own_times() -> None:
    t = np.concatenate([np.linspace(0.0, 1.0, 1001), [1.0], np.linspace(1.001, 3.0, 2000)])  # a two-sided sample
    chosen = frame_samples(t)
    assert chosen[0] == 0
    assert chosen[-1] == len(t) - 1
    assert (np.diff(t[chosen]) > 0.0).all()
    assert len(chosen) == pytest.approx(3.0 * FRAME_RATE + 1, abs=1)
    # evenly spread: true to half a sample
    np.testing.assert_allclose(np.diff(t[chosen]), 1.0 / FRAME_RATE, atol=1.1e-3)


def test_long_and_coarse_motions_keep_their_length() -> None:
    assert len(frame_samples(np.linspace(0.0, 100.0, 100001))) == MOST_FRAMES
    coarse = np.array([0.0, 0.5, 2.0, 2.0, 4.0])
    np.testing.assert_array_equal(frame_samples(coarse), [0, 1, 2, 4])
    np.testing.assert_array_equal(frame_samples(np.array([1.0])), [0])


def test_the_drawn_path_is_thinned_but_not_where_its_colour_changes() -> None:
    margin = np.where(np.arange(100_000) == 41_237, 0.01, 1.0)  # one sample near a singularity
    chosen = path_samples(margin)
    assert len(chosen) < MOST_POINTS + 5
    assert {0, 41_236, 41_237, 41_238, 99_999} <= set(chosen.tolist())
    np.testing.assert_array_equal(path_samples(np.ones(3)), [0, 1, 2])


def test_bodies_are_where_another_reader_of_the_urdf_puts_them(shipped: Robot) -> None:
    """Joint values of a frame, by inverse_kinematics of the scene's motion, through yourdfpy's forward kinematics."""
    motion = default_motion(shipped)
    scene = rp.show(shipped, motion).scene
    q = rp.inverse_kinematics(shipped, motion).q.copy()
    q[:, shipped.carrier_position] = 0.0
    other = yourdfpy.URDF.load(io.BytesIO(shipped.urdf.encode()), load_meshes=False)
    frame = len(scene.t) // 3
    sample = int(np.flatnonzero(motion.t - motion.t[0] == scene.t[frame])[0])
    model = shipped.model
    joints = {name: model.joints[model.getJointId(name)].idx_q for name in other.actuated_joint_names}
    other.update_cfg({name: q[sample, index] for name, index in joints.items()})
    for name in other.actuated_joint_names:
        ours = scene.placement[frame, scene.names.index(name)]
        theirs = other.get_transform(other.joint_map[name].child)
        np.testing.assert_allclose(ours, theirs, atol=ROUNDING, err_msg=name)


def test_the_path_is_the_motion_of_the_platform(shipped: Robot) -> None:
    if shipped.platform is None:
        pytest.skip("no platform")
    motion = default_motion(shipped)
    path = rp.show(shipped, motion).scene.path
    columns = ["xyz".index(axis) for axis in shipped.platform.axes if axis in "xyz"]
    x = motion.x[:, :3, 3] if motion.is_pose else motion.x[:, : len(columns)]
    np.testing.assert_allclose(path[:, columns], x, atol=ROUNDING)


def test_the_three_rrr_has_its_base_triangle_and_its_platform() -> None:
    """Corners A_i = P − 0.25 (cos φ_i, sin φ_i), φ = 30, 150, −90 degrees, and base hinges of side √3."""
    scene = scene_of(zoo.robot_of("3rrr"))
    base, platform = (solid for solid in scene.solids if solid.name == "plate")
    angles = np.deg2rad([30.0, 150.0, -90.0])
    expected = -0.25 * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    x = default_motion(zoo.robot_of("3rrr")).x
    for k in (0, -1):
        place = scene.placement[k, platform.body]
        wanted = x[k, :2] + expected  # at α = 0
        for corner in platform.mesh[0][:3] @ place[:3, :3].T + place[:3, 3]:  # of its upper side
            assert np.linalg.norm(wanted - corner[:2], axis=1).min() < ROUNDING
    hinges = np.array([[0.0, 0.0], [np.sqrt(3.0), 0.0], [np.sqrt(3.0) / 2.0, 1.5]])
    for corner in base.mesh[0][:3, :2]:
        assert np.linalg.norm(hinges - corner, axis=1).min() < ROUNDING
    assert len(base.mesh[0]) == len(platform.mesh[0]) == 8  # three corners a side, and their middles


def test_closures_are_closed_in_every_frame(shipped: Robot) -> None:
    scene = scene_of(shipped)
    model = shipped.model
    for closure in shipped.closures:
        ends = []
        for name in (closure.frame_a, closure.frame_b):
            frame = model.frames[model.getFrameId(name)]
            ends.append(in_world(scene, int(frame.parentJoint), frame.placement.translation))
        np.testing.assert_allclose(ends[0], ends[1], atol=ROUNDING)


def test_a_rod_is_drawn_between_its_ends_in_every_frame() -> None:
    robot = chain_of("rod")
    scene, (rod,) = scene_of(robot), robot.closures
    (solid,) = (each for each in scene.solids if each.name == f"rod_{rod.name}")
    assert (scene.names[solid.body], solid.size[1]) == (f"rod {rod.name}", rod.length)
    along = np.array([0.0, 0.0, 0.5 * rod.length])
    for side, frame in ((-1.0, rod.frame_a), (1.0, rod.frame_b)):
        name = f"closure_{rod.name}" + ("_b" if side > 0.0 else "")
        (ball,) = (each for each in scene.solids if each.name == name)
        centre = in_world(scene, ball.body, ball.placement[:3, 3])
        np.testing.assert_allclose(in_world(scene, solid.body, side * along), centre, atol=ROUNDING)
        assert ball.body == robot.model.frames[robot.model.getFrameId(frame)].parentJoint
    drawn = links(robot, robot.q_reference)
    assert max(np.linalg.norm(end - start) for start, end in drawn) == pytest.approx(rod.length, abs=ROUNDING)


def test_every_role_is_drawn_in_a_colour_of_its_own() -> None:
    solids = scene_of(zoo.robot_of("3rrr")).solids
    count = {role: sum(solid.role == role for solid in solids) for role in ROLE_COLORS}
    assert count == {
        "base": 1,
        "link": 7,
        "track": 3,
        "carrier": 3,
        "actuated": 3,
        "passive": 4,
        "closure": 2,
        "platform": 1,
    }
    assert len(set(ROLE_COLORS.values())) == len(ROLE_COLORS)
    for solid in solids:
        if solid.role != "link":
            assert solid.color == ROLE_COLORS[solid.role]


def test_a_track_spans_what_the_carrier_may_do() -> None:
    robot = zoo.robot_of("3rrr", tail_length=0.4)  # longer on one side than on the other
    assert {limits.lower for limits in robot.carrier_limits} == {-0.4}
    scene = scene_of(robot)
    for track, limits in zip([s for s in scene.solids if s.role == "track"], robot.carrier_limits, strict=True):
        assert track.size[2] == pytest.approx(limits.upper - limits.lower)
        ends = [track.placement[:3, 3] + side * 0.5 * track.size[2] * track.placement[:3, 2] for side in (-1, 1)]
        np.testing.assert_allclose(ends, [[limits.lower, 0, 0], [limits.upper, 0, 0]], atol=1e-12)


def test_carrier_arrows_point_along_the_work_they_do() -> None:
    """With a carrier pushed along its track by δ, its place moves along its arrow for a positive force."""
    robot = zoo.robot_of("2rpr")
    motion = default_motion(robot)
    zero = np.zeros((len(motion), robot.k))
    moved = rp.CarrierMotion(zero + 1e-3, zero, zero)
    force = np.tile([1.0, -2.0], (len(motion), 1))
    here, there = (
        make_scene(robot, motion.t, configurations(robot, motion, carriers), np.ones(len(motion)), carrier_force=force)
        for carriers in (rp.CarrierMotion.parked(len(motion), robot.k), moved)
    )
    for name, sign in zip(robot.carriers, (1.0, -1.0), strict=True):
        arrow = arrow_of(here, name)
        shift = there.placement[:, arrow.body, :3, 3] - here.placement[:, arrow.body, :3, 3]
        vector = here.placement[:, arrow.body, :3, :3] @ arrow.axis * arrow.length[:, None]
        work = np.einsum("fi,fi->f", shift, vector)
        np.testing.assert_allclose(work, sign * np.linalg.norm(shift, axis=1) * np.abs(arrow.length), rtol=1e-9)


def test_arrows_are_scaled_to_the_largest_effort_away_from_singularities() -> None:
    robot = zoo.robot_of("3rrr")
    motion = default_motion(robot)
    n = len(motion)
    margin = np.ones(n)
    tau = np.zeros((n, 3))
    tau[0, 0], tau[-1] = -5.0, [1e6, np.nan, np.inf]
    margin[-1] = 0.5 * NEAR_SINGULAR_MARGIN
    scene = make_scene(
        robot,
        motion.t,
        configurations(robot, motion, rp.CarrierMotion.parked(n, robot.k)),
        margin,
        tau,
        force_scale=2.0,
    )
    longest = 2.0 * LONGEST_TORQUE * robot.characteristic_length
    first, second, third = scene.arrows
    assert first.turning
    assert first.length[0] == pytest.approx(-longest)
    assert first.length[-1] == pytest.approx(1.5 * longest)
    assert second.length[-1] == third.length[-1] == 0.0
    assert scene.captions == ("largest torque away from singularities: 5 N·m",)


def test_forces_and_torques_have_scales_of_their_own() -> None:
    robot = zoo.robot_of("3rrr")
    scene = scene_of(robot)
    size = robot.characteristic_length
    for turning, longest in ((True, LONGEST_TORQUE), (False, LONGEST_FORCE)):
        lengths = [np.abs(arrow.length).max() for arrow in scene.arrows if arrow.turning is turning]
        assert max(lengths) == pytest.approx(longest * size, rel=0.05)  # the largest may fall between two frames


def test_margin_classes() -> None:
    margins = np.array([0.0, 0.049, 0.05, 0.1, 0.3, -0.3, 0.4, 7.0, np.nan])
    np.testing.assert_array_equal(margin_classes(margins), [0, 0, 1, 2, 3, 3, 4, 4, -1])
    assert len(margin_labels()) == len(MARGIN_COLORS) == len(set(MARGIN_COLORS))


BARE = """<robot name="bare"><link name="base"/>
{links}</robot>"""
DECLARATION = """
urdf: bare.urdf
closures: [{frames: [left_tip, right_tip], axes: [x, y]}]
actuated: [left_base, right_base]
independent: {platform: left_tip, axes: [x, y]}
reference: {platform: [0.25, 0.6], guess: {left_base: 2.0, right_base: 1.0}}
"""


def bare_robot(folder: Path, visual: str) -> Robot:
    """A five-bar without shapes, or with what is given as every link's."""
    chain = []
    for side, x in (("left", 0.0), ("right", 0.5)):
        for link, parent, joint, kind, origin in (
            (f"{side}_1", "base", f"{side}_base", "revolute", x),
            (f"{side}_2", f"{side}_1", f"{side}_elbow", "revolute", 0.4),
            (f"{side}_tip", f"{side}_2", f"{side}_mount", "fixed", 0.5),
        ):
            chain.append(
                f'<link name="{link}">{visual}<inertial><mass value="1"/>'
                '<inertia ixx="0" ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial></link>'
                f'<joint name="{joint}" type="{kind}"><parent link="{parent}"/><child link="{link}"/>'
                f'<origin xyz="{origin} 0 0"/><axis xyz="0 0 1"/>'
                '<limit lower="-9" upper="9" velocity="9" effort="9"/></joint>'
            )
    (folder / "bare.urdf").write_text(BARE.format(links="".join(chain)))
    (folder / "robot.yaml").write_text(DECLARATION)
    return rp.load_robot(folder)


@pytest.mark.parametrize(
    "visual", ["", '<visual><geometry><mesh filename="package://nowhere/a.stl"/></geometry></visual>']
)
def test_links_without_a_primitive_shape_are_bars_between_their_joints(tmp_path: Path, visual: str) -> None:
    robot = bare_robot(tmp_path, visual)
    bars = [solid for solid in scene_of(robot).solids if solid.role == "link"]
    assert sorted(solid.size[1] for solid in bars) == pytest.approx([0.4, 0.4, 0.5, 0.5])
    np.testing.assert_allclose(body_points(robot, 0), [[0, 0, 0], [0.5, 0, 0]])


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_a_scale_that_is_none_is_refused(scale: float) -> None:
    with pytest.raises(InputError, match="force_scale"):
        rp.show(zoo.robot_of("2rpr"), force_scale=scale)


def test_a_carrier_motion_of_another_length_is_refused() -> None:
    robot = zoo.robot_of("2rpr")
    motion = default_motion(robot)
    with pytest.raises(InputError, match=r"shape \(3, 2\)"):
        make_scene(robot, motion.t, configurations(robot, motion, rp.CarrierMotion.parked(3, 2)), np.ones(len(motion)))
