"""What meshcat is sent, and the page around it: judged by unpacking the messages again."""

from __future__ import annotations

import base64
import html
import json
import re
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import OutputError, RedundancyPinError
from redundancy_pin.view import show
from redundancy_pin.visualisation.viewer.mechanism import prism
from redundancy_pin.visualisation.viewer.meshcat_scene import AROUND, arc, arrow, tube
from redundancy_pin.visualisation.viewer.page import View
from redundancy_pin.visualisation.viewer.scene import EFFORT_COLORS, MARGIN_COLORS, margin_classes

umsgpack = pytest.importorskip("umsgpack", reason="comes with meshcat")


@cache
def view_of(name: str) -> View:
    return show(zoo.robot_of(name))


@cache
def page_of(name: str) -> str:
    return view_of(name).html()


def commands_in(page: str) -> list[dict[str, Any]]:
    (listed,) = re.findall(r"for \(const text of (\[.*?\])\) \{", page)
    return [umsgpack.unpackb(base64.b64decode(text)) for text in json.loads(listed)]


def clips_in(page: str) -> dict[str, dict[str, Any]]:
    (animation,) = [command for command in commands_in(page) if command["type"] == "set_animation"]
    return {entry["path"].removeprefix("/meshcat/"): entry["clip"] for entry in animation["animations"]}


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Return the volume inside a closed surface whose triangles are seen counter-clockwise from outside."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.einsum("ti,ti->t", a, np.cross(b, c)).sum() / 6.0)


@pytest.mark.parametrize("name", zoo.SHIPPED)
def test_every_clip_lasts_as_long_as_the_motion(name: str) -> None:
    duration = view_of(name).scene.duration
    clips = clips_in(page_of(name))
    assert clips
    for path, clip in clips.items():
        assert clip["fps"] == 1, path  # times are seconds
        for track in clip["tracks"]:
            times = [key["time"] for key in track["keys"]]
            assert times[0] == 0.0, path
            assert times[-1] == duration, path
            assert (np.diff(times) > 0.0).all(), path


def test_key_frames_are_the_placements_of_the_scene() -> None:
    scene = view_of("3rrr").scene
    clip = clips_in(page_of("3rrr"))["robot/joint_elbow_2"]
    tracks = {track["name"]: [key["value"] for key in track["keys"]] for track in clip["tracks"]}
    placement = scene.placement[:, scene.names.index("elbow_2")]
    np.testing.assert_array_equal(tracks[".position"], placement[:, :3, 3])
    x, y, z, w = np.array(tracks[".quaternion"]).T
    np.testing.assert_allclose(1.0 - 2.0 * (y**2 + z**2), placement[:, 0, 0], atol=1e-12)
    np.testing.assert_allclose(2.0 * (x * y + z * w), placement[:, 1, 0], atol=1e-12)


def test_a_single_sample_is_a_still_picture() -> None:
    view = show(zoo.robot_of("2rpr"), rp.trajectory.reference.circle().sample(0.01)[:1])
    assert view.scene.duration == 0.0
    assert clips_in(view.html()) == {}


def test_a_long_motion_makes_no_long_page() -> None:
    motion = rp.trajectory.reference.line(speed=0.1).sample(0.001)
    assert len(motion) > 12_000
    assert len(show(zoo.robot_of("2rpr"), motion).html()) < 4e6


def test_one_copy_of_the_platform_is_shown_at_a_time() -> None:
    """The platform's colour is that of the margin's class in every frame."""
    view = view_of("2rpr")
    classes = margin_classes(view.scene.margin)
    assert set(classes.tolist()) == {0, 1, 2, 3, 4}
    clips = clips_in(page_of("2rpr"))
    for number in range(5):
        (track,) = next(clip for path, clip in clips.items() if path.endswith(f"_margin_{number}"))["tracks"]
        assert track["name"] == ".visible"
        assert track["type"] == "bool"
        keys = [(key["time"], key["value"]) for key in track["keys"]]
        step = np.searchsorted([time for time, _ in keys], view.scene.t, side="right") - 1
        np.testing.assert_array_equal([keys[i][1] for i in step], classes == number)


def test_the_path_has_the_colours_of_the_margin() -> None:
    commands = commands_in(page_of("2rpr"))
    (sent,) = [c for c in commands if c["type"] == "set_object" and c["path"] == "/meshcat/path/margin"]
    (geometry,) = sent["object"]["geometries"]
    colors = np.frombuffer(geometry["data"]["attributes"]["color"]["array"].data, dtype=np.float32).reshape(-1, 3)
    seen = {tuple(np.round(255 * color).astype(int).tolist()) for color in colors}
    assert seen == {tuple(int(c[i : i + 2], 16) for i in (1, 3, 5)) for c in MARGIN_COLORS}


def test_arrows_follow_the_efforts_and_never_vanish_to_nothing() -> None:
    scene = view_of("3rrr").scene
    clips = clips_in(page_of("3rrr"))
    for item in scene.arrows:
        (track,) = clips[f"forces/{item.group}_{item.name}/effort"]["tracks"]
        scale = np.array([key["value"] for key in track["keys"]])
        np.testing.assert_allclose(scale[:, 1 if item.turning else 2], item.length, atol=1e-6)
        assert (np.abs(scale) > 0.0).all()  # a matrix without inverse has no normals
    materials = [m for c in commands_in(page_of("3rrr")) if c["type"] == "set_object" for m in c["object"]["materials"]]
    colors = {material["color"] for material in materials}
    assert {int(color[1:], 16) for color in EFFORT_COLORS.values()} <= colors


def test_arrows_and_path_are_drawn_over_what_is_see_through() -> None:
    """Among see-through objects the order decides, for arrows and path take no notice of depth."""
    sent = [c for c in commands_in(page_of("3rrr")) if c["type"] == "set_object"]
    order = {c["path"].removeprefix("/meshcat/"): c["object"]["object"]["renderOrder"] for c in sent}
    arrows = {order[path] for path in order if path.endswith("/arrow")}
    assert arrows == {3}
    assert (order["path/halo"], order["path/margin"]) == (1, 2)
    assert {order[path] for path in order if path.startswith("robot/")} == {0}


def test_only_what_covers_other_things_is_see_through() -> None:
    sent = [c for c in commands_in(page_of("3rrr")) if c["type"] == "set_object" and "/robot/" in c["path"]]
    clear = {c["path"] for c in sent if c["object"]["materials"][0]["opacity"] < 1.0}
    assert clear == {"/meshcat/robot/base/plate", "/meshcat/robot/joint_wrist_1/visual_platform_0"}


def test_animations_touch_groups_only() -> None:
    """A browser that joins a live server late is sent the animation before the objects."""
    for name in zoo.SHIPPED:
        for path, clip in clips_in(page_of(name)).items():
            assert "<object>" not in path
            assert {track["name"] for track in clip["tracks"]} <= {".position", ".quaternion", ".scale", ".visible"}


def test_forces_can_be_off_at_first() -> None:
    view = View(view_of("3rrr").scene, forces=False)
    (sent,) = [c for c in commands_in(view.html()) if c["type"] == "set_property" and c["path"] == "/meshcat/forces"]
    assert sent["value"] is False
    assert re.search(r'id="forces" type="checkbox"\s*>', view.html())


def test_the_page_forbids_itself_the_network_and_names_no_address() -> None:
    page = page_of("gough")
    notices, page = re.findall(r"<!--(.*?)-->", page, flags=re.DOTALL)[0], re.sub(r"(?s)<!--.*?-->", "", page, count=1)
    assert "Permission is hereby granted" in notices
    assert "default-src 'none'" in page
    assert not re.findall(r"<(?:script|link|img|iframe)[^>]*\s(?:src|href)=(?!\"data:)", page)
    assert set(re.findall(r"https?://[^\s\"'\\]+", page)) <= {"http://www.w3.org/1999/xhtml"}  # a name, not an address
    assert page.count("</script>") == 2
    assert not re.search(r"@[A-Z_]+@", page)


def test_the_legend_lists_what_is_there() -> None:
    three, four = page_of("3rrr"), page_of("four_bar")
    assert "carrier" in three.split("<script>")[0]
    assert "effort of carriers" not in four
    assert "largest torque away from singularities" in four


def test_the_same_scene_gives_the_same_bytes(tmp_path: Path) -> None:
    view = view_of("five_bar")
    for name in ("a.html", "b.html"):
        view.save(tmp_path / name)
    assert (tmp_path / "a.html").read_bytes() == (tmp_path / "b.html").read_bytes()
    assert (tmp_path / "a.html").read_text(encoding="utf-8") == show(zoo.robot_of("five_bar")).html()


def test_a_notebook_gets_the_page_in_a_frame() -> None:
    cell = view_of("five_bar")._repr_html_()
    (inlined,) = re.findall(r'<iframe srcdoc="([^"]*)"', cell)
    assert html.unescape(inlined) == page_of("five_bar")


def test_titles_are_text_and_not_markup(tmp_path: Path) -> None:
    from dataclasses import replace

    scene = replace(view_of("five_bar").scene, title="<b>&</b>")
    assert "<b>" not in View(scene).html().split("<script>")[0]


def test_what_cannot_be_written_leaves_nothing(tmp_path: Path) -> None:
    view = view_of("five_bar")
    with pytest.raises(OutputError, match=r"does not end in \.html"):
        view.save(tmp_path / "out.png")
    with pytest.raises(OutputError, match="no folder"):
        view.save(tmp_path / "none" / "out.html")
    assert list(tmp_path.iterdir()) == []


def test_without_meshcat_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    view = view_of("five_bar")
    monkeypatch.setitem(sys.modules, "meshcat", None)
    for call in (view.html, view.serve, view._repr_html_):
        with pytest.raises(RedundancyPinError, match=r"pip install 'redundancy_pin\[show\]'"):
            call()


def test_an_arrow_points_along_z_and_an_arc_turns_positively() -> None:
    vertices, triangles = arrow()
    assert vertices[:, 2].min() == 0.0
    assert vertices[:, 2].max() == 1.0
    assert volume(vertices, triangles) > 0.0
    vertices, triangles = arc()
    tip, foot = vertices[-1], vertices[0]
    np.testing.assert_allclose(foot, [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(tip, [0.0, -1.0, 0.0], atol=1e-12)  # three quarters of a turn, counter-clockwise
    middle = vertices.reshape(-1, AROUND, 3).mean(axis=1)
    angle = np.unwrap(np.arctan2(middle[:, 1], middle[:, 0]))
    assert (np.diff(angle) > -1e-12).all()
    assert angle[-1] - angle[0] == pytest.approx(1.5 * np.pi)
    assert volume(vertices, triangles) > 0.0


def test_a_plate_is_a_prism() -> None:
    square = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    assert abs(volume(*prism(square, 0.1))) == pytest.approx(0.2)


def test_a_tube_has_its_radius_and_follows_its_points() -> None:
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(400)], axis=1)
    vertices, triangles, owner = tube(circle, 0.01)
    assert volume(vertices, triangles) == pytest.approx(2.0 * np.pi * 3.0 * np.sqrt(3.0) / 2.0 * 1e-4, rel=2e-2)
    np.testing.assert_allclose(np.linalg.norm(vertices - circle[owner], axis=1), 0.01, rtol=1e-9)


def test_a_path_that_rests_has_no_tube() -> None:
    for points in (np.zeros((0, 3)), np.zeros((1, 3)), np.ones((5, 3))):
        assert len(tube(points, 0.01)[0]) == 0


def test_show_is_one_line() -> None:
    assert rp.show is show


def test_names_of_joints_neither_end_a_script_nor_stand_for_a_part_of_the_page() -> None:
    scene = show("four_bar").scene
    usual = View(scene).html()
    named = replace(scene.readings[0], name="</script><b>@VIEWER@", effort=np.full(len(scene.t), np.nan))
    text = View(replace(scene, readings=(named, *scene.readings[1:]))).html()
    assert text.count("</script") == usual.count("</script")
    assert text.count("MeshCat=") == usual.count("MeshCat=")
    assert "<b>" not in text.partition("const readings")[2].partition("\n")[0]
    assert "\\u003c/script>\\u003cb>@VIEWER@" in text
    assert "NaN" not in text.partition("const readings")[2].partition("\n")[0]
