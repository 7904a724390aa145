"""What meshcat is sent, the page around it and the server of it: read back from the messages."""

from __future__ import annotations

import base64
import html
import json
import logging
import re
import urllib.error
import urllib.request
import webbrowser
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from zoo import view_of

import redundancy_pin as rp
from redundancy_pin.errors import OutputError, RedundancyPinError
from redundancy_pin.visualisation.viewer import page as pages
from redundancy_pin.visualisation.viewer.mechanism import prism
from redundancy_pin.visualisation.viewer.meshcat_scene import AROUND, arc, arrow, import_meshcat, tube
from redundancy_pin.visualisation.viewer.page import LiveView, View
from redundancy_pin.visualisation.viewer.scene import EFFORT_COLORS, MARGIN_COLORS, make_scene, margin_classes

umsgpack = pytest.importorskip("umsgpack", reason="comes with meshcat")


@cache
def page_of(name: str) -> str:
    return view_of(name).html()


def commands_in(page: str) -> list[dict[str, Any]]:
    (listed,) = re.findall(r"for \(const text of (\[.*?\])\) \{", page)
    return [umsgpack.unpackb(base64.b64decode(text)) for text in json.loads(listed)]


def commands_of(send: Callable[[Any], None]) -> list[dict[str, Any]]:
    """Return a list that what is sent to a meshcat viewer goes into, then and later."""
    meshcat = import_meshcat()

    sent: list[dict[str, Any]] = []

    class Window:
        def send(self, command: Any) -> None:
            sent.append(umsgpack.unpackb(umsgpack.packb(command.lower())))

    send(meshcat.Visualizer(window=Window()))
    return sent


def clips_in(page: str) -> dict[str, dict[str, Any]]:
    (animation,) = [command for command in commands_in(page) if command["type"] == "set_animation"]
    return {entry["path"].removeprefix("/meshcat/"): entry["clip"] for entry in animation["animations"]}


def objects_in(page: str) -> dict[str, dict[str, Any]]:
    sent = [command for command in commands_in(page) if command["type"] == "set_object"]
    return {command["path"].removeprefix("/meshcat/"): command["object"] for command in sent}


def data_in(page: str, name: str) -> Any:
    (text,) = re.findall(r"const data = (.*);\n", page)
    return json.loads(text)[name]


def volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Return the volume inside a closed surface whose triangles are seen counter-clockwise from outside."""
    a, b, c = (vertices[triangles[:, k]] for k in range(3))
    return float(np.einsum("ti,ti->t", a, np.cross(b, c)).sum() / 6.0)


@pytest.mark.long_for("five_bar", "3rrr")
@pytest.mark.parametrize("name", zoo.SHIPPED)
def test_every_clip_moves_a_group_for_as_long_as_the_motion(name: str) -> None:
    duration = view_of(name).scene.duration
    clips = clips_in(page_of(name))
    assert clips
    for path, clip in clips.items():
        assert clip["fps"] == 1, path  # times are seconds
        assert {track["name"] for track in clip["tracks"]} <= {".position", ".quaternion", ".scale"}
        for track in clip["tracks"]:
            times = [key["time"] for key in track["keys"]]
            assert (times[0], times[-1]) == (0.0, duration), path
            assert (np.diff(times) > 0.0).all(), path


def test_key_frames_are_the_placements_and_the_efforts_of_the_scene() -> None:
    scene, clips = view_of("3rrr").scene, clips_in(page_of("3rrr"))
    tracks = {t["name"]: [key["value"] for key in t["keys"]] for t in clips["robot/joint_elbow_2"]["tracks"]}
    placement = scene.placement[:, scene.names.index("elbow_2")]
    np.testing.assert_array_equal(tracks[".position"], placement[:, :3, 3])
    x, y, z, w = np.array(tracks[".quaternion"]).T
    np.testing.assert_allclose(1.0 - 2.0 * (y**2 + z**2), placement[:, 0, 0], atol=1e-12)
    np.testing.assert_allclose(2.0 * (x * y + z * w), placement[:, 1, 0], atol=1e-12)
    for item in scene.arrows:
        (track,) = clips[f"forces/{item.group}_{item.name}/effort"]["tracks"]
        scale = np.array([key["value"] for key in track["keys"]])
        np.testing.assert_allclose(scale[:, 1 if item.turning else 2], item.length, atol=1e-6)
        assert (np.abs(scale) > 0.0).all()  # a matrix without inverse has no normals
    colors = {thing["materials"][0]["color"] for thing in objects_in(page_of("3rrr")).values()}
    assert {int(color[1:], 16) for color in EFFORT_COLORS.values()} <= colors


def test_a_single_sample_is_a_still_picture_and_a_long_motion_no_long_page() -> None:
    robot = zoo.robot_of("2rpr")
    still = rp.show(robot, rp.trajectory.reference.circle().sample(0.01)[:1])
    assert (still.scene.duration, clips_in(still.html())) == (0.0, {})
    t = np.linspace(0.0, 12.0, 12_001)
    q, effort = np.tile(robot.q_reference, (len(t), 1)), np.sin(t)[:, None] * [1.0, 2.0]
    q[:, robot.carrier_position] = 0.1 * effort
    scene = make_scene(robot, t, q, np.ones(len(t)), effort)
    assert len(View(scene).html()) < 4e6


def test_the_platform_and_the_path_have_the_colours_of_the_margin() -> None:
    scene, page = view_of("2rpr").scene, page_of("2rpr")
    classes, margins = margin_classes(scene.margin), data_in(page, "margins")
    assert set(classes.tolist()) == {0, 1, 2, 3, 4}
    assert margins["classes"] == classes.tolist()
    assert margins["colors"][:5] == list(MARGIN_COLORS)
    assert margins["parts"] == ["robot/joint_slide_1/plate"]
    assert set(margins["parts"]) <= objects_in(page).keys()
    (geometry,) = objects_in(page)["path/margin"]["geometries"]
    colors = np.frombuffer(geometry["data"]["attributes"]["color"]["array"].data, dtype=np.float32).reshape(-1, 3)
    seen = {tuple(np.round(255 * color).astype(int).tolist()) for color in colors}
    assert seen == {tuple(int(c[i : i + 2], 16) for i in (1, 3, 5)) for c in MARGIN_COLORS}


def test_arrows_and_path_are_drawn_over_what_is_see_through_and_little_is() -> None:
    """Among see-through objects the order decides, for arrows and path take no notice of depth."""
    sent = objects_in(page_of("3rrr"))
    order = {path: thing["object"]["renderOrder"] for path, thing in sent.items()}
    assert {order[path] for path in order if path.endswith("/arrow")} == {3}
    assert (order["path/halo"], order["path/margin"]) == (1, 2)
    assert {order[path] for path in order if path.startswith("robot/")} == {0}
    clear = {path for path, thing in sent.items() if thing["materials"][0].get("opacity", 1.0) < 1.0}
    assert clear == {"robot/base/plate", "robot/joint_wrist_1/visual_platform_0"}


def test_values_of_the_joints_are_those_of_the_scene() -> None:
    view = view_of("3rrr")
    readings = data_in(page_of("3rrr"), "readings")
    np.testing.assert_allclose(readings["t"], view.scene.t, rtol=1e-5)
    assert [one["name"] for one in readings["joints"]] == [one.name for one in view.scene.joints]
    for sent, own in zip(readings["joints"], view.scene.joints, strict=True):
        np.testing.assert_allclose(sent["position"], own.position, rtol=1e-5, atol=1e-12)
        assert (sent["effort"] is None) == (own.effort is None)
        if own.effort is not None:
            np.testing.assert_allclose(sent["effort"], own.effort, rtol=1e-5, atol=1e-12)
            assert sent["effort_unit"] == ("N·m" if own.turning else "N")
    assert {path for path, _ in readings["parts"]} <= objects_in(page_of("3rrr")).keys()


def test_forces_can_be_off_at_first_and_the_legend_lists_what_is_there() -> None:
    off = View(view_of("3rrr").scene, forces=False).html()
    (sent,) = [c for c in commands_in(off) if c["type"] == "set_property" and c["path"] == "/meshcat/forces"]
    assert sent["value"] is False
    assert re.search(r'id="forces" type="checkbox"\s*>', off)
    assert "carrier" in off.split("<script>")[0]
    assert "effort of carriers" not in page_of("four_bar")
    assert "largest torque away from singularities" in page_of("four_bar")


def test_the_page_forbids_itself_the_network_and_names_no_address() -> None:
    page = page_of("gough")
    notices, page = re.findall(r"<!--(.*?)-->", page, flags=re.DOTALL)[0], re.sub(r"(?s)<!--.*?-->", "", page, count=1)
    assert "Permission is hereby granted" in notices
    assert "default-src 'none'" in page
    assert not re.findall(r"<(?:script|link|img|iframe)[^>]*\s(?:src|href)=(?!\"data:)", page)
    assert set(re.findall(r"https?://[^\s\"'\\]+", page)) <= {"http://www.w3.org/1999/xhtml"}  # a name, not an address
    assert page.count("</script>") == 2
    assert not re.search(r"\{[{%]", page.partition("</script>")[0].partition("<script>")[0])


def test_names_and_titles_are_text_and_neither_markup_nor_a_part_of_the_page() -> None:
    scene, usual = view_of("four_bar").scene, page_of("four_bar")
    named = replace(scene.joints[0], name="</script><b>{{ viewer }}", effort=np.full(len(scene.t), np.nan))
    text = View(replace(scene, title="<b>&</b>", joints=(named, *scene.joints[1:]))).html()
    assert "<b>" not in text.split("<script>")[0]
    for mark in ("</script", "MeshCat="):
        assert text.count(mark) == usual.count(mark)
    written = text.partition("const data")[2].partition("\n")[0]
    assert "\\u003c/script\\u003e\\u003cb\\u003e{{ viewer }}" in written
    assert "<b>" not in written
    assert "NaN" not in written


def test_a_notebook_gets_a_page_in_a_frame_and_a_file_is_whole_or_not_there(tmp_path: Path) -> None:
    view = view_of("four_bar")
    (inlined,) = re.findall(r'<iframe srcdoc="([^"]*)"', view._repr_html_())
    assert commands_in(html.unescape(inlined))
    with pytest.raises(OutputError, match=r"does not end in \.html"):
        view.save(tmp_path / "out.png")
    with pytest.raises(OutputError, match="no folder"):
        view.save(tmp_path / "none" / "out.html")
    assert list(tmp_path.iterdir()) == []


# --- shapes -----------------------------------------------------------------------------------------------------------


def test_an_arrow_points_along_z_and_an_arc_turns_positively() -> None:
    vertices, triangles = arrow()
    assert (vertices[:, 2].min(), vertices[:, 2].max()) == (0.0, 1.0)
    assert volume(vertices, triangles) > 0.0
    vertices, triangles = arc()
    np.testing.assert_allclose(vertices[0], [1.0, 0.0, 0.0], atol=1e-12)
    np.testing.assert_allclose(vertices[-1], [0.0, -1.0, 0.0], atol=1e-12)  # three quarters of a turn, positive
    middle = vertices.reshape(-1, AROUND, 3).mean(axis=1)
    angle = np.unwrap(np.arctan2(middle[:, 1], middle[:, 0]))
    assert (np.diff(angle) > -1e-12).all()
    assert angle[-1] - angle[0] == pytest.approx(1.5 * np.pi)
    assert volume(vertices, triangles) > 0.0


def test_a_plate_is_a_prism_and_a_tube_has_its_radius_and_follows_its_points() -> None:
    square = np.array([[0.0, 0.0, 0.0], [2.0, 0.0, 0.0], [2.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    assert abs(volume(*prism(square, 0.1))) == pytest.approx(0.2)
    angle = np.linspace(0.0, 2.0 * np.pi, 400)
    circle = np.stack([np.cos(angle), np.sin(angle), np.zeros(400)], axis=1)
    vertices, triangles, owner = tube(circle, 0.01)
    assert volume(vertices, triangles) == pytest.approx(2.0 * np.pi * 3.0 * np.sqrt(3.0) / 2.0 * 1e-4, rel=2e-2)
    np.testing.assert_allclose(np.linalg.norm(vertices - circle[owner], axis=1), 0.01, rtol=1e-9)
    for points in (np.zeros((0, 3)), np.zeros((1, 3)), np.ones((5, 3))):  # a path that rests
        assert len(tube(points, 0.01)[0]) == 0


# --- served to this machine -------------------------------------------------------------------------------------------


def read(url: str) -> tuple[str, str]:
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.headers["Content-Type"], answer.read().decode("utf-8")


def test_the_page_is_served_to_this_machine_until_it_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    opened: list[str] = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    live = view_of("four_bar").serve(open_browser=True)
    try:
        assert re.fullmatch(r"http://127\.0\.0\.1:\d+/", live.url)
        assert opened == [live.url]
        kind, text = read(live.url)
        assert kind == "text/html; charset=utf-8"
        assert data_in(text, "readings") == data_in(page_of("four_bar"), "readings")
        assert read(f"{live.url}?again")[1] == text
        with pytest.raises(urllib.error.HTTPError, match="404"):
            read(f"{live.url}etc/passwd")
    finally:
        live.close()
    live.wait()  # which ends when it is closed
    with pytest.raises(OSError, match="refused"):
        read(live.url)


def test_views_have_addresses_of_their_own_without_chatter_and_no_port_is_an_error(
    caplog: pytest.LogCaptureFixture, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    first, second = LiveView("one"), LiveView("two")
    try:
        with caplog.at_level(logging.INFO):
            assert (read(first.url)[1], read(second.url)[1]) == ("one", "two")
    finally:
        first.close()
        second.close()
    assert (caplog.records, tuple(capsys.readouterr())) == ([], ("", ""))
    monkeypatch.setattr(pages, "HERE", "203.0.113.1")  # an address for documentation: of no machine
    with pytest.raises(RedundancyPinError, match="No port of") as raised:
        LiveView("page")
    assert "--html" in raised.value.remedy
