"""Draw the pictures of the README into this folder: ``make pictures``."""

from __future__ import annotations

import sys
import tempfile
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Line3DCollection, Poly3DCollection
from PIL import Image

import redundancy_pin as rp
from redundancy_pin.io.files import replacing_file
from redundancy_pin.planners.receding_horizon import run_online
from redundancy_pin.trajectory.waypoints import through_points
from redundancy_pin.visualisation.figures.paths import draw_frame, draw_path, label_plane
from redundancy_pin.visualisation.figures.plots import side_by_side
from redundancy_pin.visualisation.figures.style import figure
from redundancy_pin.visualisation.viewer.scene import Scene

FOLDER = Path(__file__).resolve().parent

FRAMES_A_SECOND = 20
"""Frames of a GIF last a whole number of hundredths of a second: 20 a second is true speed."""

COLORS = 32
"""Of the GIF: the scene has about a dozen, the rest are for smooth edges."""


def crossing() -> rp.Plan:
    """The 2-RPR on the thesis's circle, through two singularities with its main actuators off."""
    return rp.plan_switch_off(rp.load_robot("2rpr"), rp.trajectory.reference.circle(speed=0.5), threshold=7.0)


def corner() -> rp.Plan:
    """The 3-RRR around the thesis's corner, its carriers moving for least torque."""
    return rp.plan_stepwise(rp.load_robot("3rrr"), rp.trajectory.reference.corner(radius=0.025))


def animate(scene: Scene, path: Path, *, title: str) -> None:
    """Write a scene as a GIF that plays at true speed and repeats."""
    times = np.arange(0.0, scene.duration, 1.0 / FRAMES_A_SECOND)
    pictures = [_picture(scene, int(np.abs(scene.t - t).argmin()), title) for t in times]
    # one palette for all frames, so that nothing flickers; taken from several, so that every colour is in it
    strip = Image.new("RGB", (pictures[0].width, 4 * pictures[0].height))
    for i in range(4):
        strip.paste(pictures[i * len(pictures) // 4], (0, i * pictures[0].height))
    palette = strip.quantize(COLORS, method=Image.Quantize.MAXCOVERAGE)
    frames = [picture.quantize(palette=palette, dither=Image.Dither.NONE) for picture in pictures]
    with replacing_file(path) as temporary:
        frames[0].save(
            temporary, save_all=True, append_images=frames[1:], duration=1000 // FRAMES_A_SECOND, loop=0, optimize=True
        )


def _picture(scene: Scene, frame: int, title: str) -> Image.Image:
    with figure(4.0, 3.4) as drawn:
        axes = drawn.add_subplot()
        draw_frame(axes, scene, frame)
        draw_path(axes, scene)
        axes.set_title(f"{title}, t = {scene.t[frame]:.2f} s")
        label_plane(axes)
        axes.set(xlim=(-0.25, 0.75), ylim=(-0.3, 0.5), aspect="equal", autoscale_on=False)
        axes.set_adjustable("box")
        canvas: Any = FigureCanvasAgg(drawn)
        canvas.draw()
        return Image.fromarray(np.asarray(canvas.buffer_rgba())[:, :, :3].copy())


def cassie_leg() -> Figure:
    """Cassie's left leg as it folds, from the side, and the knee's torque while it carries half of the machine."""
    sys.path.append(str(FOLDER.parent / "examples"))
    from cassie_leg import BLADE, bend, load, torques  # of the extra examples

    with tempfile.TemporaryDirectory() as folder:
        robot = load(Path(folder))
    motion = bend(robot)
    tau, q, data = torques(robot, motion).tau, rp.inverse_kinematics(robot, motion).q, robot.model.createData()
    knee = motion.x[:, robot.independent_joints.index("left-knee-op")]
    rod, foot = (0.5012, 0.0, 0.0), (0.055, 0.0, 0.008)  # ends of the rods, m, in the axes of rod and foot
    bars = {
        "hip, knee, shin, tarsus": [("hip-pitch",), ("knee",), ("shin",), ("tarsus",), ("foot",)],
        "achilles rod": [("hip-pitch",), ("achilles-rod", rod)],
        "crank and plantar rod": [("foot-crank",), ("plantar-rod",), ("foot", foot)],
    }
    with figure(7.2, 3.4) as drawn:
        side, curve = drawn.subplots(1, 2, width_ratios=[1.0, 1.4])
        for k, shade in ((0, 0.35), (len(motion) // 2, 0.6), (len(motion) - 1, 1.0)):
            pin.framesForwardKinematics(robot.model, data, np.array(q[k]))

            def at(name: str, offset: Any = (0.0, 0.0, 0.0)) -> Any:
                place = data.oMf[robot.model.getFrameId(f"left-{name}", pin.FrameType.BODY)]
                return place.act(np.array(offset))[[0, 2]]

            for (label, points), color in zip(bars.items(), ("#4477aa", "#cc6677", "#228833"), strict=True):
                line = np.transpose([at(*point) for point in points])
                side.plot(*line, color=color, alpha=shade, marker=".", label=label if shade == 1.0 else None)
            blade = [at("foot", np.array(BLADE) + way * np.array([0.0615, -0.0512, 0.0])) for way in (1, -1)]
            side.plot(*np.transpose(blade), color="#333333", alpha=shade, linewidth=3)
        side.set(aspect="equal", xlabel="x [m]", ylabel="z [m]", ylim=(-0.45, 1.05))
        side.legend(fontsize=7)
        for name in ("pitch-op", "knee-op", "tarsus-crank-joint"):
            curve.plot(np.degrees(knee), tau[:, robot.actuated.index(f"left-{name}")], label=name)
        curve.set(xlabel="knee [deg] from the file's pose", ylabel="torque [N m], 160 N carried")
        curve.legend(fontsize=7)
        return drawn


def delta_crossing() -> Figure:
    """The delta before, in and after the plane of its elbows, its carriers as in the plan of least peak."""
    robot = rp.load_robot("delta", rod_length=0.35, rod_carriers=True)
    line = rp.trajectory.Line((-0.04, 0.02, -0.25), (0.05, 0.0, -0.05))
    motion = rp.trajectory.Trajectory(line, rp.trajectory.RestToRest(line.length, 0.5, "4-5-6-7"))
    plan = rp.plan_whole_trajectory(robot, motion, objective="peak", mesh=rp.Mesh(dt=0.01))
    (singular,) = plan.findings.singular_instants
    with figure(9.0, 2.2) as drawn:
        for panel, t in enumerate((singular - 0.1, singular, singular + 0.1), 1):
            k = int(np.abs(plan.t - t).argmin())
            q = rp.inverse_kinematics(robot, plan.motion).with_carriers(plan.carriers).q
            axes: Any = drawn.add_subplot(1, 3, panel, projection="3d", proj_type="ortho")
            draw_machine(axes, robot, [np.array(q[k]), np.array(q[0]), np.array(q[-1])], (12, -75), zoom=1.25)
            axes.set_title(f"t = {plan.t[k]:.3f} s", fontsize=9)
        return drawn


def singular_poses() -> Figure:
    """A five-bar in a regular pose and at singularities of type I and II, each with the direction that is lost."""
    robot = rp.load_robot("five_bar")
    down = rp.trajectory.from_points([[0.25, 0.7], [0.25, 0.2]], [0.0, 1.0], ends="rest")
    (second,) = (each for each in rp.find_crossings(robot, down) if each.kind.label == "type_ii")
    outward = np.array([np.cos(1.15), np.sin(1.15)])  # along the first arm, stretched
    reach = 0.99999 * (robot.parameters["proximal_length"] + robot.parameters["distal_length"])
    out = rp.trajectory.from_points([[0.25, 0.7], reach * outward], [0.0, 1.0], ends="rest")
    poses = {
        "regular": (down, 0.0, None),
        "type I: an arm is stretched": (out, 1.0, outward),
        "type II: the distal links are in line": (down, second.t, second.uncontrolled_twist),
    }
    model, data = robot.model, robot.model.createData()
    with figure(8.4, 2.9) as drawn:
        for axes, (title, (motion, end, lost)) in zip(drawn.subplots(1, 3), poses.items(), strict=True):
            q = rp.inverse_kinematics(robot, motion.sample_at(np.linspace(0.0, end, 200) if end else [0.0])).q[-1]
            pin.framesForwardKinematics(model, data, np.array(q))
            tip, *bases = (
                data.oMf[model.getFrameId(name)].translation[:2] for name in ("end_effector", *robot.actuated)
            )
            for leg, base in enumerate(bases, 1):
                elbow = data.oMi[model.getJointId(f"elbow_{leg}")].translation[:2]
                axes.plot(*np.transpose([base, elbow, tip]), color="#4477aa", linewidth=2.5, marker="o", mfc="white")
                axes.plot(*base, color="#222222", marker="o", markersize=9)
            if lost is not None:
                for way in (0.22, -0.22):
                    arrow = {"arrowstyle": "->", "color": "#cc3311", "linewidth": 1.8}
                    axes.annotate("", xy=tip + way * lost, xytext=tip, arrowprops=arrow)
            axes.set(aspect="equal", xlim=(-0.55, 1.05), ylim=(-0.12, 1.3))
            axes.set_title(title, fontsize=9)
            axes.set_axis_off()
        return drawn


def on_line() -> Figure:
    """The 2-RPR of the thesis over its singular line three times: planned at once, switched off, and on the way."""
    angle, radius = np.radians([100, 30, -40, -110, -180, -250, -320, -400]), [15, 18, 12, 17, 10, 16, 19, 13]
    ellipse = np.stack([0.7 * np.cos(angle), np.sin(angle)], axis=1)
    path = through_points([0.25, 0.0] + 0.01 * np.array(radius)[:, None] * ellipse)
    motion = rp.trajectory.Trajectory(path, rp.trajectory.SpeedProfile(path.length, 0.5, 0.3))
    dynamics = rp.CompiledDynamics(rp.load_robot("2rpr"))
    plans = {
        "off line, least peak": rp.plan_whole_trajectory(
            dynamics, motion, objective="peak", end="free", start=0.0, mesh=rp.Mesh(dt=0.01)
        ),
        "switched off near the line": rp.plan_switch_off(dynamics, motion, threshold=4.0, return_time="shortest"),
        "on line, half a second ahead": run_online(rp.RecedingHorizon(dynamics), motion).plan,
    }
    instants = plans["off line, least peak"].findings.singular_instants
    return side_by_side("The 2-RPR over its singular line", plans, "N", instants=instants)


def draw_machine(
    axes: Any, robot: rp.Robot, configurations: list[Any], view: tuple[float, float], zoom: float = 0.95
) -> None:
    """Draw the first of some configurations by the shapes of the robot's file, in the space that all of them need."""
    turn = np.linspace(0.0, 2.0 * np.pi, 33)
    shapes = pin.buildGeomFromUrdfString(robot.model, robot.urdf, pin.GeometryType.VISUAL)
    corners = [np.zeros((1, 3))]
    for k, q in enumerate(configurations):
        data, placed = robot.model.createData(), shapes.createData()
        pin.updateGeometryPlacements(robot.model, data, shapes, placed, q)
        lines = [  # offsets between joints
            np.array([data.oMi[robot.model.parents[joint]].translation, data.oMi[joint].translation])
            for joint in range(1, robot.model.njoints)
            if robot.model.parents[joint]
        ]
        faces: list[Any] = []
        for shape, place in zip(shapes.geometryObjects, placed.oMg, strict=True):
            name, form = robot.model.names[shape.parentJoint], shape.geometry
            color = "#d95f0e" if name in robot.carriers else "#4477aa" if shape.parentJoint else "#777777"
            if hasattr(form, "halfSide"):
                signs = np.array([[1, 1], [1, -1], [-1, -1], [-1, 1]])
                sides = [np.insert(signs, axis, side, axis=1) for axis in range(3) for side in (1, -1)]
                points = [face * form.halfSide @ place.rotation.T + place.translation for face in sides]
                faces.append((points, color, 0.9 if name in robot.carriers else 0.25))
                corners += points
                continue
            if form.radius > form.halfLength:
                ring = form.radius * np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
                points, width = ring @ place.rotation.T + place.translation, 1.5
            else:
                points = place.translation + np.outer([1, -1], form.halfLength * place.rotation[:, 2])
                width = 2.5
            corners.append(points)
            if k == 0:
                axes.plot(*points.T, color=color, linewidth=width)
        if k == 0:
            axes.add_collection3d(Line3DCollection(lines, colors="#bbbbbb", linewidths=1.5))
            for points, color, alpha in faces:
                axes.add_collection3d(Poly3DCollection(points, facecolors=color, alpha=alpha))
    least, most = np.concatenate(corners).min(axis=0), np.concatenate(corners).max(axis=0)
    most = np.maximum(most, least + 0.05 * (most - least).max())
    axes.set(**{f"{axis}lim": (least[k], most[k]) for k, axis in enumerate("xyz")})
    axes.set_box_aspect(most - least, zoom=zoom)
    axes.view_init(*view)
    axes.set_axis_off()


def main() -> None:
    """Draw all pictures."""
    animate(rp.show(crossing()).scene, FOLDER / "crossing.gif", title="2-RPR")
    plan = corner()
    with_cassie = any(
        each.metadata["Name"] == "example-robot-data" for each in distributions()
    )  # of the extra examples
    for name, drawn in (
        ("corner.svg", rp.plot.snapshots(rp.show(plan), 3, title="3-RRR around a corner")),
        ("corner_carriers.svg", rp.plot.carriers(plan)),
        ("delta_crossing.svg", delta_crossing()),
        ("on_line.svg", on_line()),
        ("singular_poses.svg", singular_poses()),
        *([("cassie_leg.svg", cassie_leg())] if with_cassie else []),
    ):
        with replacing_file(FOLDER / name) as temporary:
            rp.plot.save(drawn, temporary)
    for path in sorted(FOLDER.glob("*.[gs][iv][fg]")):
        print(f"{path.name}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
