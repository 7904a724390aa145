"""Shapes of a user's URDF: meshes in several formats, primitives, and what is said of files that cannot be read."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.arrays import Array
from redundancy_pin.planners.robot_record import load_recorded, robot_record
from redundancy_pin.robot import Robot
from redundancy_pin.view import show
from redundancy_pin.visualisation.viewer import solids
from redundancy_pin.visualisation.viewer.scene import Scene
from redundancy_pin.visualisation.viewer.solids import ROLE_COLORS, Solid, find_mesh

JOINTS = [
    J("left_base", "revolute", "base", "left_1"),
    J("left_elbow", "revolute", "left_1", "left_2", (0.4, 0, 0)),
    J("left_mount", "fixed", "left_2", "left_tip", (0.5, 0, 0)),
    J("right_base", "revolute", "base", "right_1", (0.5, 0, 0)),
    J("right_elbow", "revolute", "right_1", "right_2", (0.4, 0, 0)),
    J("right_mount", "fixed", "right_2", "right_tip", (0.5, 0, 0)),
]
DECLARATION: dict[str, Any] = {
    "name": "five_bar_with_shapes",
    "closures": [{"frames": ["left_tip", "right_tip"], "axes": ["x", "y"]}],
    "actuated": ["left_base", "right_base"],
    "independent": {"platform": "left_tip", "axes": ["x", "y"]},
    "reference": {"platform": [0.25, 0.6], "guess": {"left_base": 2.0, "right_base": 1.0}},
}
ORIGIN = {"xyz": "0.1 0.2 -0.3", "rpy": "0.4 -0.5 0.6"}
SINGLE = 1e-6
"""m; STL and OBJ hold numbers of six or seven digits."""


def robot_with(folder: Path, visuals: Sequence[str], link: str = "left_1") -> Robot:
    """A five-bar one of whose links has visuals."""
    inside = "".join(f"<visual>{visual}</visual>" for visual in visuals)
    urdf = urdf_of(JOINTS).replace(f'<link name="{link}">', f'<link name="{link}">{inside}')
    if link == "base":
        urdf = urdf.replace('<link name="base"/>', f'<link name="base">{inside}</link>')
    return rp.load_robot(write_robot(folder, urdf, DECLARATION))


def visual(geometry: str, color: str = "") -> str:
    painted = f'<material name="paint"><color rgba="{color}"/></material>' if color else ""
    return f'<origin xyz="{ORIGIN["xyz"]}" rpy="{ORIGIN["rpy"]}"/>{painted}<geometry>{geometry}</geometry>'


REST = rp.PlatformMotion([0.0], [DECLARATION["reference"]["platform"]], [[0.0, 0.0]], [[0.0, 0.0]])


def scene_of(robot: Robot) -> Scene:
    return show(robot, REST).scene


def shapes_on(scene: Scene, joint: str) -> list[Solid]:
    body = scene.names.index(joint)
    return [solid for solid in scene.solids if solid.body == body and solid.role in ("link", "base")
            and not solid.name.startswith(("bar", "plate"))]  # fmt: skip


def origin() -> Array:
    placed = np.eye(4)
    placed[:3, :3] = Rotation.from_euler("xyz", [0.4, -0.5, 0.6]).as_matrix()  # roll, pitch, yaw about fixed axes
    placed[:3, 3] = 0.1, 0.2, -0.3
    return placed


def wedge() -> trimesh.Trimesh:
    """A body without any symmetry."""
    return trimesh.convex.convex_hull(np.array([[0, 0, 0], [0.3, 0, 0], [0, 0.2, 0], [0, 0, 0.1], [0.3, 0.1, 0.05]]))


@pytest.mark.parametrize("suffix", ["stl", "obj", "ply", "dae"])
def test_a_mesh_is_drawn_where_it_is_and_as_large_as_it_is(tmp_path: Path, suffix: str) -> None:
    """Against trimesh, which wrote the file: same corners, same volume, mirrored and stretched as ``scale`` says."""
    if suffix == "dae":
        pytest.importorskip("collada")
    (tmp_path / "parts").mkdir()
    wedge().export(tmp_path / "parts" / f"wedge.{suffix}")
    mesh = f'<mesh filename="parts/wedge.{suffix}" scale="2 -1 0.5"/>'
    (solid,) = shapes_on(scene_of(robot_with(tmp_path, [visual(mesh)])), "left_base")
    assert solid.shape == "mesh"
    assert solid.color == ROLE_COLORS["link"]  # the URDF gives none
    np.testing.assert_allclose(solid.placement, origin(), atol=1e-12)
    assert solid.mesh is not None
    vertices, triangles = solid.mesh
    expected = wedge().vertices * [2.0, -1.0, 0.5]
    for corner in expected:
        assert np.linalg.norm(vertices - corner, axis=1).min() < SINGLE
    for corner in vertices:
        assert np.linalg.norm(expected - corner, axis=1).min() < SINGLE
    drawn = trimesh.Trimesh(vertices, triangles)
    assert abs(drawn.volume) == pytest.approx(wedge().volume, rel=1e-4)  # |2 · −1 · 0.5| = 1


def test_each_file_and_each_scale_is_a_mesh_of_its_own_on_the_base_too_in_the_colour_of_the_urdf(
    tmp_path: Path,
) -> None:
    wedge().export(tmp_path / "wedge.stl")
    trimesh.creation.box((0.1, 0.1, 0.1)).export(tmp_path / "box.stl")
    given = ('wedge.stl"', 'box.stl"', 'box.stl" scale="3 3 3"', 'wedge.stl"')
    robot = robot_with(tmp_path, [visual(f'<mesh filename="{name}/>', "1.0 0.2 0.6 1") for name in given], link="base")
    shapes = shapes_on(scene_of(robot), "base")
    reach = [float(solid.mesh[0][:, 0].max()) for solid in shapes if solid.mesh is not None]
    assert reach == pytest.approx([0.3, 0.05, 0.15, 0.3], abs=SINGLE)
    assert {(solid.role, solid.color) for solid in shapes} == {("base", "#ff3399")}


def test_the_page_holds_every_vertex_of_a_mesh(tmp_path: Path) -> None:
    from test_page import objects_in

    wedge().export(tmp_path / "wedge.stl")
    view = show(robot_with(tmp_path, [visual('<mesh filename="wedge.stl"/>')]), REST)
    (tmp_path / "wedge.stl").unlink()  # the page needs no file
    page = view.html()
    (sent,) = [thing for path, thing in objects_in(page).items() if path.endswith("left_1_0")]
    (geometry,) = sent["geometries"]
    data = geometry["data"]["attributes"]["position"]["array"].data
    vertices = np.frombuffer(data, dtype=np.float32).reshape(-1, 3)
    assert {tuple(row) for row in vertices.round(4)} == {tuple(row) for row in wedge().vertices.astype("f4").round(4)}
    assert 'hidden><input id="clear"' not in page
    assert 'hidden><input id="clear"' in show(robot_with(tmp_path, []), REST).html()  # nothing to see through


def test_primitives_are_drawn(tmp_path: Path) -> None:
    given = ['<box size="0.1 0.2 0.3"/>', '<cylinder radius="0.05" length="0.4"/>', '<sphere radius="0.07"/>']
    # with an element of Drake, whose prefix is bound to no namespace
    painted = [visual(shape, "0 0 1 1") + "<drake:proximity_properties/>" for shape in given]
    shapes = shapes_on(scene_of(robot_with(tmp_path, painted)), "left_base")
    assert [solid.shape for solid in shapes] == ["box", "cylinder", "sphere"]
    for solid, size in zip(shapes, ((0.1, 0.2, 0.3), (0.05, 0.4), (0.07,)), strict=True):
        assert solid.size == pytest.approx(size)
        assert solid.color == "#0000ff"
        np.testing.assert_allclose(solid.placement, origin(), atol=1e-12)


def test_a_capsule_is_a_cylinder_and_two_spheres(tmp_path: Path) -> None:
    """Pinocchio's reader of URDF knows no capsules."""
    robot = robot_with(tmp_path, [visual('<capsule radius="0.05" length="0.4"/>', "1 0 0 1")])
    rod, low, high = shapes_on(scene_of(robot), "left_base")
    assert (rod.shape, low.shape, high.shape) == ("cylinder", "sphere", "sphere")
    assert rod.size == pytest.approx((0.05, 0.4))
    assert low.size == high.size == pytest.approx((0.05,))
    np.testing.assert_allclose(rod.placement, origin(), atol=1e-12)
    for ball, end in ((low, -0.2), (high, 0.2)):
        np.testing.assert_allclose(ball.placement[:3, 3], (origin() @ [0.0, 0.0, end, 1.0])[:3], atol=1e-12)
    assert {solid.color for solid in (rod, low, high)} == {"#ff0000"}


def test_a_shape_that_urdfdom_does_not_know_changes_no_mass(tmp_path: Path) -> None:
    shape = '<geometry><capsule radius="0.05" length="0.4"/></geometry>'
    urdf = urdf_of(JOINTS).replace('<link name="left_1">', f'<link name="left_1"><collision>{shape}</collision>')
    robot = rp.load_robot(write_robot(tmp_path, urdf, DECLARATION))
    assert robot.model.inertias[1] == robot_with(tmp_path, []).model.inertias[1]


def test_files_that_cannot_be_read_are_named_once_and_bars_stand_in(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    (tmp_path / "broken.stl").write_text("no mesh at all")
    meshes = [visual(f'<mesh filename="{name}"/>') for name in ("broken.stl", "package://nowhere/gone.dae", "gone.obj")]
    robot = robot_with(tmp_path, [*meshes, meshes[0]])
    with caplog.at_level(logging.WARNING):
        scene = scene_of(robot)
    (record,) = caplog.records
    message = record.getMessage()
    assert message.startswith("3 mesh file(s) of five_bar_with_shapes are not drawn")
    assert f"{tmp_path / 'broken.stl'} cannot be read" in message
    assert "package://nowhere/gone.dae is not found" in message
    assert "gone.obj is not found" in message
    assert "ROS_PACKAGE_PATH" in message
    assert shapes_on(scene, "left_base") == []
    bars = [solid for solid in scene.solids if solid.name.startswith("bar")]
    assert sorted(bar.size[1] for bar in bars) == pytest.approx([0.4, 0.4, 0.5, 0.5])  # from joint to joint
    bare = [solid for solid in scene_of(robot_with(tmp_path, [])).solids if solid.name.startswith("bar")]
    assert [bar.size for bar in bare] == [bar.size for bar in bars]
    scene_of(robot_with(tmp_path, [visual(f'<mesh filename="{i}.stl"/>') for i in range(20)]))
    assert "and 17 more" in caplog.text
    assert "19.stl" not in caplog.text


def test_where_a_mesh_is_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("ROS_PACKAGE_PATH", "AMENT_PREFIX_PATH"):
        monkeypatch.delenv(name, raising=False)
    folder = tmp_path / "pkg" / "urdf"
    places = {
        "file.stl": folder / "file.stl",
        f"file://{tmp_path}/absolute.stl": tmp_path / "absolute.stl",
        f"{tmp_path}/plain.stl": tmp_path / "plain.stl",
        "../meshes/up.stl": tmp_path / "pkg" / "meshes" / "up.stl",
        "package://pkg/meshes/own.stl": tmp_path / "pkg" / "meshes" / "own.stl",
        "package://other/beside.stl": tmp_path / "other" / "beside.stl",
        "model://other/model.stl": tmp_path / "other" / "model.stl",
    }
    for file in places.values():
        file.parent.mkdir(parents=True, exist_ok=True)
        file.touch()
    for filename, file in places.items():
        path = find_mesh(filename, str(folder))
        assert path is not None, filename
        assert path.samefile(file)
    assert find_mesh("file.stl", "") is None
    assert find_mesh("package://pkg/none.stl", str(folder)) is None
    assert find_mesh("package://other/beside.stl", "") is None
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{tmp_path}")
    assert find_mesh("package://other/beside.stl", "") == tmp_path / "other" / "beside.stl"
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "other"))  # the package itself
    assert find_mesh("package://other/beside.stl", "") == tmp_path / "other" / "beside.stl"
    monkeypatch.delenv("ROS_PACKAGE_PATH")
    (tmp_path / "share" / "installed").mkdir(parents=True)
    (tmp_path / "share" / "installed" / "a.stl").touch()
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    assert find_mesh("package://installed/a.stl", "") == tmp_path / "share" / "installed" / "a.stl"


OWN = ("own.stl", "file://{robot}/own.stl", "../meshes/package.stl", "package://mine/meshes/package.stl")
ELSEWHERE = ("{elsewhere}/secret.stl", "file://{elsewhere}/secret.stl", "../../../elsewhere/secret.stl", "link.stl",
             "package://elsewhere/secret.stl")  # fmt: skip


@pytest.mark.long_for(OWN[1], OWN[3], *ELSEWHERE[:2])
@pytest.mark.parametrize("filename", [*OWN, *ELSEWHERE])
def test_a_robot_that_a_file_names_is_drawn_with_its_own_meshes_only(
    tmp_path: Path, filename: str, caplog: pytest.LogCaptureFixture
) -> None:
    """Else the page of a stranger's plan, which goes to others, would hold any mesh of its reader's disk."""
    places = {name: tmp_path / name for name in ("plans", "plans/mine", "plans/mine/robot", "plans/mine/meshes",
                                                 "elsewhere")}  # fmt: skip
    for place in places.values():
        place.mkdir()
    robot, elsewhere = places["plans/mine/robot"], places["elsewhere"]
    (places["plans/mine"] / "package.xml").write_text("<package/>")
    for file in (robot / "own.stl", places["plans/mine/meshes"] / "package.stl", elsewhere / "secret.stl"):
        wedge().export(file)
    (robot / "link.stl").symlink_to(elsewhere / "secret.stl")
    name = filename.format(robot=robot, elsewhere=elsewhere)
    made = robot_with(robot, [visual(f'<mesh filename="{name}"/>')])
    assert len(shapes_on(scene_of(made), "left_base")) == 1
    record = replace(robot_record(made), folder=str(places["plans"]))
    assert len(shapes_on(scene_of(load_recorded(record, made.source)), "left_base")) == 1  # its user vouches for it
    assert not caplog.records
    drawn = shapes_on(scene_of(load_recorded(record)), "left_base")
    assert len(drawn) == (filename in OWN)
    assert ("outside the folder of its robot" in caplog.text) is (filename in ELSEWHERE)


@pytest.mark.parametrize("name", ["large.stl", "scene.gltf"])
def test_meshes_of_strangers_are_small_and_name_no_files(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setattr(solids, "LARGEST_MESH", 1000)
    wedge().export(tmp_path / "wedge.stl")
    (tmp_path / name).write_bytes((tmp_path / "wedge.stl").read_bytes() + bytes(1000 if name == "large.stl" else 0))
    made = robot_with(tmp_path, [visual(f'<mesh filename="{file}"/>') for file in (name, "wedge.stl")])
    scene = scene_of(load_recorded(replace(robot_record(made), folder=str(tmp_path))))
    assert len(shapes_on(scene, "left_base")) == 1
    assert f"{name} is" in caplog.text


def test_a_xacro_with_the_mesh_of_a_package_that_is_not_there_loads(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Its dynamics do not need the mesh; pictures say what they miss and draw the rest, relative names included."""
    wedge().export(tmp_path / "wedge.stl")
    given = "".join(f'<visual><geometry><mesh filename="{name}"/></geometry></visual>'
                    for name in ("package://nowhere/gone.stl", "wedge.stl"))  # fmt: skip
    urdf = urdf_of(JOINTS).replace('<link name="left_1">', f'<link name="left_1">{given}')
    (tmp_path / "robot.urdf.xacro").write_text(
        urdf.replace('name="written"', 'name="written" xmlns:xacro="http://www.ros.org/wiki/xacro"')
    )
    path = write_robot(tmp_path, urdf, {**DECLARATION, "urdf": "robot.urdf.xacro"})
    (solid,) = shapes_on(scene_of(rp.load_robot(path)), "left_base")
    assert solid.shape == "mesh"
    assert "package://nowhere/gone.stl is not found" in caplog.text
