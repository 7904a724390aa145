"""What the moving picture shows is where the robot is, and its arrows point where the efforts push."""

from __future__ import annotations

import io
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import moving
import numpy as np
import pinocchio as pin
import pytest
import yourdfpy
import zoo
from spatial_chains import chain_of
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array
from redundancy_pin.errors import InputError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import Robot
from redundancy_pin.view import default_motion
from redundancy_pin.visualisation.viewer.mechanism import BALANCED_RADIUS, base_hinges, body_points, links
from redundancy_pin.visualisation.viewer.scene import (
    FRAME_RATE,
    LONGEST_FORCE,
    LONGEST_TORQUE,
    MARGIN_COLORS,
    MOST_FRAMES,
    MOST_POINTS,
    Scene,
    frame_samples,
    make_scene,
    margin_classes,
    margin_labels,
    path_samples,
)
from redundancy_pin.visualisation.viewer.solids import ROLE_COLORS, Solid, extent_of, points_of

EXACT = 1e-12
"""Sums and products of numbers of order one."""

ROUNDING = 1e-9
"""Positions of order one from a closure gap of 1e-11 and sines and cosines on either side."""


def brief(robot: Robot) -> rp.PlatformMotion:
    """A few samples about home; each is a frame."""
    return zoo.smooth_motion(robot).at(np.linspace(0.0, 0.5, 11))


def scene_of(robot: Robot) -> Scene:
    return rp.show(robot, brief(robot)).scene


def in_world(scene: Scene, body: int, point: Array) -> Array:
    """Return (F, 3) where a point of a body goes."""
    return scene.placement[:, body, :3, :3] @ point + scene.placement[:, body, :3, 3]


def test_frames_are_samples_at_their_own_times() -> None:
    t = np.concatenate([np.linspace(0.0, 1.0, 1001), [1.0], np.linspace(1.001, 3.0, 2000)])  # a two-sided sample
    chosen = frame_samples(t)
    assert chosen[0] == 0
    assert chosen[-1] == len(t) - 1
    assert (np.diff(t[chosen]) > 0.0).all()
    assert len(chosen) == pytest.approx(3.0 * FRAME_RATE + 1, abs=1)
    # evenly spread: true to half a sample
    np.testing.assert_allclose(np.diff(t[chosen]), 1.0 / FRAME_RATE, atol=1.1e-3)
    assert len(frame_samples(np.linspace(0.0, 100.0, 100001))) == MOST_FRAMES
    np.testing.assert_array_equal(frame_samples(np.array([0.0, 0.5, 2.0, 2.0, 4.0])), [0, 1, 2, 4])
    np.testing.assert_array_equal(frame_samples(np.array([1.0])), [0])


def test_the_drawn_path_is_thinned_but_not_where_its_colour_changes() -> None:
    margin = np.where(np.arange(100_000) == 41_237, 0.01, 1.0)  # one sample near a singularity
    chosen = path_samples(margin)
    assert len(chosen) < MOST_POINTS + 5
    assert {0, 41_236, 41_237, 41_238, 99_999} <= set(chosen.tolist())
    np.testing.assert_array_equal(path_samples(np.ones(3)), [0, 1, 2])
    margins = np.array([0.0, 0.049, 0.05, 0.1, 0.3, -0.3, 0.4, 7.0, np.nan])
    np.testing.assert_array_equal(margin_classes(margins), [0, 0, 1, 2, 3, 3, 4, 4, -1])
    assert len(margin_labels()) == len(MARGIN_COLORS) == len(set(MARGIN_COLORS))


def test_bodies_are_where_another_reader_of_the_urdf_puts_them_loops_closed_and_the_path_is_the_motion(
    shipped: Robot,
) -> None:
    """Joint values of a frame, by inverse_kinematics of the scene's motion, through yourdfpy's forward kinematics."""
    motion, model = brief(shipped), shipped.model
    scene = rp.show(shipped, motion).scene
    q = rp.inverse_kinematics(shipped, motion).q.copy()
    q[:, shipped.carrier_position] = 0.0
    other = yourdfpy.URDF.load(io.BytesIO(shipped.urdf.encode()), load_meshes=False)
    frame = len(scene.t) // 3
    sample = int(np.flatnonzero(motion.t - motion.t[0] == scene.t[frame])[0])
    joints = {name: model.joints[model.getJointId(name)].idx_q for name in other.actuated_joint_names}
    other.update_cfg({name: q[sample, index] for name, index in joints.items()})
    for name in other.actuated_joint_names:
        ours = scene.placement[frame, scene.names.index(name)]
        theirs = other.get_transform(other.joint_map[name].child)
        np.testing.assert_allclose(ours, theirs, atol=ROUNDING, err_msg=name)
    for closure in shipped.closures:
        frames = [model.frames[model.getFrameId(name)] for name in (closure.frame_a, closure.frame_b)]
        ends = [in_world(scene, int(each.parentJoint), each.placement.translation) for each in frames]
        np.testing.assert_allclose(ends[0], ends[1], atol=ROUNDING)
    if shipped.platform is not None:
        columns = ["xyz".index(axis) for axis in shipped.platform.axes if axis in "xyz"]
        x = motion.x[:, :3, 3] if motion.is_pose else motion.x[:, : len(columns)]
        np.testing.assert_allclose(scene.path[:, columns], x, atol=ROUNDING)


def test_the_three_rrr_has_its_base_triangle_and_its_platform() -> None:
    """Corners A_i = P − 0.25 (cos φ_i, sin φ_i), φ = 30, 150, −90 degrees, and base hinges of side √3."""
    scene = zoo.view_of("3rrr").scene
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
    motion = brief(robot)
    zero = np.zeros((len(motion), robot.k))
    moved = rp.CarrierMotion(zero + 1e-3, zero, zero)
    force = np.tile([1.0, -2.0], (len(motion), 1))
    here, there = (
        make_scene(
            robot,
            motion.t,
            rp.inverse_kinematics(robot, motion).with_carriers(carriers).q,
            np.ones(len(motion)),
            carrier_force=force,
        )
        for carriers in (rp.CarrierMotion.parked(len(motion), robot.k), moved)
    )
    for name, sign in zip(robot.carriers, (1.0, -1.0), strict=True):
        arrow = next(arrow for arrow in here.arrows if arrow.name == name)
        shift = there.placement[:, arrow.body, :3, 3] - here.placement[:, arrow.body, :3, 3]
        vector = here.placement[:, arrow.body, :3, :3] @ arrow.axis * arrow.length[:, None]
        work = np.einsum("fi,fi->f", shift, vector)
        np.testing.assert_allclose(work, sign * np.linalg.norm(shift, axis=1) * np.abs(arrow.length), rtol=1e-9)


def test_arrows_are_scaled_to_the_largest_effort_away_from_singularities() -> None:
    robot = zoo.robot_of("3rrr")
    motion = brief(robot)
    n = len(motion)
    margin = np.ones(n)
    tau = np.zeros((n, 3))
    tau[0, 0], tau[1, 1], tau[-1] = -5.0, np.inf, [1e6, np.nan, np.inf]
    margin[-1] = 0.5 * NEAR_SINGULAR_MARGIN
    scene = make_scene(
        robot,
        motion.t,
        rp.inverse_kinematics(robot, motion).q,
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
    both = zoo.view_of(
        "3rrr"
    ).scene  # forces and torques have scales of their own; the largest may fall between two frames
    for turning, most in ((True, LONGEST_TORQUE), (False, LONGEST_FORCE)):
        lengths = [np.abs(arrow.length).max() for arrow in both.arrows if arrow.turning is turning]
        assert max(lengths) == pytest.approx(most * robot.characteristic_length, rel=0.05)


def test_a_motor_that_slides_is_drawn_on_the_barrel_between_its_hinge_and_the_rods_end() -> None:
    """Of the 2-RPR, whose legs start at (0, 0) and (0.5, 0), at the reference; of a gantry on what it moves."""
    robot = zoo.robot_of("2rpr")
    q = np.array(robot.q_reference)[None]
    scene = make_scene(robot, np.zeros(1), q, np.ones(1))
    tip = scene.path[0]
    for leg, hinge in (("1", [0.0, 0.0, 0.0]), ("2", [0.5, 0.0, 0.0])):
        (box,) = (solid for solid in scene.solids if solid.name == f"joint_slide_{leg}")
        assert scene.names[box.body] == f"swivel_{leg}"
        centre = in_world(scene, box.body, box.placement[:3, 3])[0]
        np.testing.assert_allclose(centre[:2], 0.5 * (tip + hinge)[:2], atol=ROUNDING)


def test_the_origin_of_a_floating_joint_is_no_hinge(tmp_path: Path) -> None:
    robot = moving.floating(tmp_path, left=0.1)
    body = robot.model.getJointId("root")
    np.testing.assert_allclose(sorted(body_points(robot, body)[:, 0]), [0.1, 0.6], atol=1e-12)
    assert len(base_hinges(robot)) == 0
    scene = scene_of(robot)
    assert not [solid for solid in scene.solids if solid.role == "base"]
    rp.plot.snapshots(scene, 2)


def test_scales_and_carriers_that_do_not_fit_are_refused() -> None:
    robot = zoo.robot_of("2rpr")
    for scale in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="force_scale"):
            rp.show(robot, force_scale=scale)
    with pytest.raises(InputError, match=r"shape \(3, 2\)"):
        rp.show(robot, brief(robot), rp.CarrierMotion.parked(3, 2))


# --- carriers that turn -----------------------------------------------------------------------------------------------

LEVER = np.array([0.1, 0.02, 0.03])
"""Centre of mass of every link that ``urdf_of`` writes, in the frame of its joint, m."""

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
def with_turning_carriers() -> Robot:
    with TemporaryDirectory() as folder:
        return rp.load_robot(write_robot(Path(folder), urdf_of(JOINTS), DECLARATION))


@cache
def turned() -> tuple[Array, Scene]:
    """Angles (N, 2) through the rotor's range and round the wheel, and what is shown of them."""
    motion = brief(with_turning_carriers())
    rate = np.array([1.8, 2.0]) / np.ptp(motion.t)
    s = np.array([-0.7, 0.0]) + np.outer(motion.t - motion.t[0], rate)
    carriers = CarrierMotion(s, np.tile(rate, (len(s), 1)), np.zeros_like(s))
    return s, rp.show(with_turning_carriers(), motion, carriers).scene


def solid(scene: Scene, name: str, body: str) -> Solid:
    return next(item for item in scene.solids if item.name == name and scene.names[item.body] == body)


def placed(scene: Scene, item: Solid, points: Array, frame: int) -> Array:
    place = scene.placement[frame, item.body] @ item.placement
    return points @ place[:3, :3].T + place[:3, 3]


def test_the_mass_is_at_its_centre_of_mass_on_its_arc_and_at_the_end_of_its_arm() -> None:
    """Against Pinocchio's own centre of mass of the body's subtree, which is the body alone."""
    s, scene = turned()
    box, arc = solid(scene, "carrier", "rotor"), solid(scene, "track_of_rotor", "left_base")
    arm, model = solid(scene, "carrier_arm", "rotor"), with_turning_carriers().model
    motion = brief(with_turning_carriers())
    data = model.createData()
    q = rp.inverse_kinematics(with_turning_carriers(), motion).q.copy()
    q[:, with_turning_carriers().carrier_position] = s
    radius = np.hypot(LEVER[0], LEVER[1])  # the axis is z
    assert (arc.role, arc.size[0], arc.size[2:]) == ("track", pytest.approx(radius), (-0.7, 1.1))
    for frame in (0, len(scene.t) // 2, len(scene.t) - 1):
        sample = int(np.abs(motion.t - motion.t[0] - scene.t[frame]).argmin())
        pin.centerOfMass(model, data, q[sample])
        drawn = placed(scene, box, np.zeros((1, 3)), frame)[0]
        np.testing.assert_allclose(drawn, data.oMi[box.body].act(data.com[box.body]), atol=EXACT)
        line = placed(scene, arc, points_of(arc), frame)
        assert np.linalg.norm(line - drawn, axis=1).min() < 0.026 * radius  # half a step of the points along the arc
        if frame in (0, len(scene.t) - 1):
            np.testing.assert_allclose(line[0 if frame == 0 else -1], drawn, atol=EXACT)
    half = 0.5 * arm.size[1] * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
    ends = half @ arm.placement[:3, :3].T + arm.placement[:3, 3]
    np.testing.assert_allclose(ends, [[0.0, 0.0, LEVER[2]], LEVER], atol=EXACT)


def test_a_balanced_carrier_is_a_bar_across_its_axis_in_a_full_round() -> None:
    _, scene = turned()
    bar, arc = solid(scene, "carrier", "wheel"), solid(scene, "track_of_wheel", "right_base")
    size = with_turning_carriers().characteristic_length
    assert arc.size[0] == pytest.approx(BALANCED_RADIUS * size)
    assert arc.size[2:] == (-np.pi, np.pi)  # limits of ±100 rad
    assert bar.size[0] == pytest.approx(2.0 * BALANCED_RADIUS * size)
    axis = LEVER / np.linalg.norm(LEVER)
    assert abs(bar.placement[:3, 0] @ axis) < EXACT  # across
    np.testing.assert_allclose(bar.placement[:3, 3], LEVER, atol=EXACT)
    directions = scene.placement[:, bar.body, :3, :3] @ bar.placement[:3, 0]
    assert np.ptp(directions, axis=0).max() > 0.5  # its turning is seen


@pytest.mark.parametrize("name", ["turning carriers", "3rrr"])
def test_boxes_hold_the_solids_and_snapshots_draw_arcs(name: str) -> None:
    """Every vertex that viewers draw is inside, and each face is touched."""
    scene = turned()[1] if name != "3rrr" else zoo.view_of("3rrr").scene
    assert len({(item.body, item.name) for item in scene.solids}) == len(scene.solids)
    for item in scene.solids:
        own = np.linalg.inv(item.placement)[None, None].repeat(len(scene.names), axis=1)
        low, high = extent_of([item], own, np.zeros((0, 3)), np.eye(3))
        if item.shape == "arc" or item.mesh is not None:
            drawn = points_of(item) if item.mesh is None else item.mesh[0]
        else:
            radius, *length = item.size
            reach = {"box": 0.5 * np.array(item.size), "sphere": np.full(3, radius)}.get(
                item.shape, np.array([radius, radius, 0.5 * length[-1] if length else 0.0])
            )
            drawn = np.array([reach, -reach])
        np.testing.assert_allclose([low, high], [drawn.min(axis=0), drawn.max(axis=0)], atol=1e-9)
        assert item.role == "link" or item.color == ROLE_COLORS[item.role]
    assert {"box", "cylinder", "sphere"} <= {item.shape for item in scene.solids}
    lines = [np.array(line.get_xydata()) for line in rp.plot.snapshots(scene, 1).axes[0].lines]
    for item in (item for item in scene.solids if item.shape == "arc"):
        expected = placed(scene, item, points_of(item), 0)[:, :2]
        assert any(len(line) == len(expected) and np.allclose(line, expected, atol=EXACT) for line in lines)
