"""The exported page in a real browser: opened from disk with the network off, looked at while it plays."""

from __future__ import annotations

import io
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from scipy.spatial.transform import Rotation
from written import J, urdf_of, write_robot

import redundancy_pin as rp
from redundancy_pin.view import show
from redundancy_pin.visualisation.viewer.meshcat_scene import rgb
from redundancy_pin.visualisation.viewer.page import View
from redundancy_pin.visualisation.viewer.scene import (
    EFFORT_COLORS,
    LONGEST_FORCE,
    LONGEST_TORQUE,
    MARGIN_COLORS,
    Scene,
    make_scene,
)
from redundancy_pin.visualisation.viewer.solids import ROLE_COLORS

pytest.importorskip("selenium", reason="selenium drives the browser: pip install 'redundancy_pin[dev]'")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
DRIVER = shutil.which("chromedriver")

pytestmark = pytest.mark.skipif(
    CHROMIUM is None or DRIVER is None,
    reason="Chromium or its driver is not installed (Debian: apt install chromium chromium-driver)",
)

FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--disable-dev-shm-usage",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--window-size=800,700",
)

EXACT = 3
"""Levels of 255 by which a colour that no light changes may be off: rounding of the browser's colour management."""

SHADED = 0.06
"""Deviation of the direction of a colour in RGB space that white light leaves as it is (Lambert)."""


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    from selenium import webdriver
    from selenium.webdriver.chrome.service import Service

    options = webdriver.ChromeOptions()
    options.binary_location = CHROMIUM
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    driver = webdriver.Chrome(options=options, service=Service(DRIVER))
    driver.execute_cdp_cmd("Network.enable", {})
    offline = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
    driver.execute_cdp_cmd("Network.emulateNetworkConditions", offline)
    yield driver
    driver.quit()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Of the shipped robots' pages."""
    return tmp_path_factory.mktemp("pages")


def _page_of(browser: Any, folder: Path, name: str) -> Any:
    """Open the page of a shipped robot, unless the test before has left it open: seconds each."""
    file = folder / f"{name}.html"
    if not file.exists():
        zoo.view_of(name).save(file)
    if browser.current_url != file.as_uri():
        _open(browser, file)
    return browser


@pytest.fixture
def page(browser: Any, folder: Path) -> Any:
    """The 3-RRR on its corner."""
    return _page_of(browser, folder, "3rrr")


def _open(browser: Any, file: Path) -> None:
    browser.get(file.as_uri())
    _wait(browser)


def _wait(browser: Any) -> None:
    """Wait until the scene is there and moves."""
    _until(browser, "return typeof animator !== 'undefined' && animator.actions.length > 0 && animator.time > 0")


def _until(browser: Any, condition: str) -> None:
    from selenium.webdriver.support.ui import WebDriverWait

    WebDriverWait(browser, 30, poll_frequency=0.05).until(lambda driver: driver.execute_script(condition))


def _seek(browser: Any, t: float) -> None:
    browser.execute_script("if (animator.playing) { byId('play').click(); } goTo(arguments[0]); viewer.render();", t)


def _picture(browser: Any) -> np.ndarray:
    """Return the canvas as (h, w, 3), 0 to 255; panels that lie over it are hidden."""
    from matplotlib.image import imread

    hide = "for (const e of [byId('panel'), byId('bar'), viewer.gui.domElement]) e.style.visibility = 'hidden'; "
    browser.execute_script(hide + "viewer.render();")
    pixels = imread(io.BytesIO(browser.get_screenshot_as_png()), format="png")
    return np.round(255.0 * pixels[:, :, :3])


def _is(picture: np.ndarray, color: str) -> np.ndarray:
    """Return (h, w) where a picture has a colour that light does not change."""
    return np.abs(picture - 255.0 * np.array(rgb(color))).max(axis=2) <= EXACT


def _is_shaded(picture: np.ndarray, color: str) -> np.ndarray:
    """Return (h, w) where a picture has a colour in some light."""
    wanted = np.array(rgb(color)) / np.linalg.norm(rgb(color))
    length = np.linalg.norm(picture, axis=2)
    direction = picture / np.maximum(length, 1.0)[:, :, None]
    return (np.linalg.norm(direction - wanted, axis=2) < SHADED) & (length > 60.0)


WATCH = """
const done = arguments[0], seen = [];
const watch = () => {
  seen.push([animator.clock.oldTime / 1000, animator.time]);
  if (seen.at(-1)[0] - seen[0][0] > 0.5) { done(seen); } else { requestAnimationFrame(watch); }
};
requestAnimationFrame(watch);
"""
"""Real time, s, at which a frame was made, and time of the motion shown in it, for half a second."""

SAME_FRAME = 0.01
"""s; both clocks are read for the same frame, one of them rounded to the nearest tenth of a millisecond."""


def _drift(seen: np.ndarray, speed: float) -> np.ndarray:
    """From frame to frame, motion shown beyond real time, whole rounds left out: a busy machine draws few frames."""
    ahead = np.diff(seen[:, 1]) - speed * np.diff(seen[:, 0])
    half = 0.5 * reference_duration()
    return (ahead + half) % (2.0 * half) - half


def test_it_plays_by_itself_at_true_speed(page: Any) -> None:
    if not page.execute_script("return animator.playing"):  # a test has stopped it
        page.refresh()
        _wait(page)
    assert page.execute_script("return animator.duration") == pytest.approx(reference_duration(), abs=1e-6)
    for speed in (0.25, 1.0):
        page.execute_script(f"byId('speed').value = {speed}; byId('speed').onchange({{target: byId('speed')}});")
        seen = np.array(page.execute_async_script(WATCH))
        assert np.ptp(seen[:, 0]) > 0.45
        assert np.abs(_drift(seen, speed)).max() < SAME_FRAME
    _seek(page, reference_duration() - 0.05)  # it starts again at its end
    page.execute_script("byId('play').click();")
    _until(page, "return animator.playing && animator.time < 0.5 * duration")


def reference_duration() -> float:
    """Two straights of 0.12 m and a quarter circle of 0.025 m at 0.2 m/s; ramps of 0.4 s cover half as much."""
    return (0.24 + 0.5 * np.pi * 0.025) / 0.2 + 0.4


def test_forces_can_be_switched_and_scaled(page: Any) -> None:
    _seek(page, 0.9)
    color = EFFORT_COLORS["carrier"]
    picture = _picture(page)
    usual = _is(picture, color).sum()
    assert min(usual, _is(picture, EFFORT_COLORS["main"]).sum()) > 20
    for role, least in (("carrier", 50), ("track", 200), ("closure", 20)):
        assert _is_shaded(picture, ROLE_COLORS[role]).sum() > least, role
    page.execute_script("byId('scale').value = 0.5; byId('scale').oninput({target: byId('scale')});")
    larger = _is(_picture(page), color).sum()
    page.execute_script("byId('forces').click();")
    off = _is(_picture(page), color).sum()
    page.execute_script(
        "byId('forces').click(); byId('scale').value = 0; byId('scale').oninput({target: byId('scale')});"
    )
    assert off == 0
    assert larger > 2 * usual
    assert _is(_picture(page), color).sum() == usual


PLACE = """
const [part] = [...jointOf].find(([part, joint]) => joint.name === arguments[0] && part.name === arguments[1]);
viewer.scene.updateMatrixWorld(true);
const place = new MeshCat.THREE.Vector3().setFromMatrixPosition(part.matrixWorld).project(viewer.camera);
const edges = document.querySelector("canvas").getBoundingClientRect();
return [edges.left + (place.x + 1) / 2 * edges.width, edges.top + (1 - place.y) / 2 * edges.height];
"""
"""Where a part of a joint is on the screen, pixels."""


def _under_the_cursor(browser: Any, x: float, y: float) -> str:
    """Return what the page says of what is there; empty where it says nothing."""
    from selenium.webdriver.common.action_chains import ActionChains

    move = ActionChains(browser)
    move.w3c_actions.pointer_action.move_to_location(round(x), round(y))
    move.perform()
    browser.execute_script("point();")
    return str(browser.execute_script("return byId('tip').hidden ? '' : byId('tip').textContent"))


def _number(text: str) -> tuple[float, str]:
    value, unit = text.split(" ")
    return float(value), unit


def test_values_stand_by_joint_name_under_the_cursor_and_in_the_list(page: Any) -> None:
    robot = zoo.robot_of("3rrr")
    motion = rp.trajectory.reference.corner().sample(times=[0.3, 0.9], two_sided=False)
    reduced = rp.RneaDynamics(robot).reduce(motion, rp.CarrierMotion.parked(2, 3))
    tau, q = rp.distribute(reduced).tau, rp.inverse_kinematics(robot, motion).q
    page.execute_script("for (const e of [byId('panel'), byId('bar')]) e.style.visibility = 'visible';")
    for i, t in enumerate((0.3, 0.9)):
        _seek(page, t)
        page.execute_script("tick();")
        listed = page.execute_script(
            "return [...byId('values').querySelectorAll('tr')].map(row => [...row.cells].map(cell => cell.textContent))"
        )
        values = {name: (_number(position), _number(effort)) for name, position, effort in listed}
        assert set(values) == {*robot.actuated, *robot.carriers}
        for k, name in enumerate(robot.actuated):
            (position, unit), (effort, effort_unit) = values[name]
            assert (unit, effort_unit) == ("rad", "N·m")
            angle = q[i, robot.model.joints[robot.model.getJointId(name)].idx_q]
            assert np.exp(1j * position) == pytest.approx(np.exp(1j * angle), abs=2e-3)  # frames are 15 ms apart
            assert effort == pytest.approx(tau[i, k], abs=0.02 * np.abs(tau).max())
        assert values["carrier_1"][1][1] == "N"
        tooltip = _under_the_cursor(page, *page.execute_script(PLACE, "base_2", "joint_base_2"))
        assert tooltip.splitlines()[0] == "base_2 (driven joint)"
        assert [_number(line) for line in tooltip.splitlines()[1:]] == list(values["base_2"])
    tooltip = _under_the_cursor(page, *page.execute_script(PLACE, "wrist_1", "joint_wrist_1"))
    assert tooltip.startswith("wrist_1 (passive joint)\n")
    assert len(tooltip.splitlines()) == 2  # it has no effort
    assert _under_the_cursor(page, *page.execute_script(PLACE, "carrier_1", "visual_mass_1_0")).startswith(
        "carrier_1 (carrier)"
    )
    canvas = "document.querySelector('canvas').getBoundingClientRect()"
    corner = page.execute_script(f"const e = {canvas}; return [e.right - 3, e.top + 3]")
    assert _under_the_cursor(page, *corner) == ""
    page.execute_script("cursor = null;")


def test_nothing_is_asked_of_the_network_no_error_is_logged_and_meshcats_controls_are_hidden(page: Any) -> None:
    assert page.execute_script("return viewer.gui.domElement.getClientRects().length") == 0
    assert page.execute_script("return performance.getEntriesByType('resource').map(entry => entry.name)") == []
    assert [entry for entry in page.get_log("browser") if entry["level"] == "SEVERE"] == []


IN_VIEW = """
const point = new MeshCat.THREE.Vector3(), seen = [];
viewer.scene.updateMatrixWorld(true);
viewer.scene_tree.find(["meshcat", "robot"]).object.traverse(part => {
  if (!part.geometry || !part.geometry.attributes.position) { return; }
  const corners = part.geometry.attributes.position;
  for (let i = 0; i < corners.count; i++) {
    point.fromBufferAttribute(corners, i).applyMatrix4(part.matrixWorld).project(viewer.camera);
    seen.push(Math.max(Math.abs(point.x), Math.abs(point.y)));
  }
});
return [Math.max(...seen), byId("panel").getBoundingClientRect().right,
        document.querySelector("canvas").getBoundingClientRect().left];
"""
"""Largest coordinate of any corner of the robot in the picture, whose edges are at 1; where legend and picture meet."""


def _all_is_in_view(browser: Any, times: Iterable[float]) -> None:
    """Check that all of the robot is in the picture, that beside the legend, and in its place when that is folded."""
    for t in times:
        _seek(browser, t)
        largest, legend, picture = browser.execute_script(IN_VIEW)
        assert 0.3 < largest < 1.0
        assert legend <= picture
    width = "document.querySelector('canvas').clientWidth"
    assert browser.execute_script(f"return {width} < 0.8 * window.innerWidth")
    browser.execute_script("byId('panel').open = false;")
    _until(browser, f"return {width} === window.innerWidth")
    browser.execute_script("byId('panel').open = true;")


# the 3-RRR is open before them, and the 2-RPR stays so for the next test; a machine in space is seen with the chain
@pytest.mark.long_for("five_bar", "four_bar", "gough")
@pytest.mark.parametrize("name", ["3rrr", *sorted({*zoo.SHIPPED} - {"2rpr", "3rrr"}), "2rpr"])
def test_all_of_the_robot_is_in_the_picture_and_beside_the_legend(browser: Any, folder: Path, name: str) -> None:
    _all_is_in_view(_page_of(browser, folder, name), (0.0, 0.5 * zoo.view_of(name).scene.duration))


def test_the_path_of_a_crossing_turns_red_and_the_platform_with_it(browser: Any, folder: Path) -> None:
    _page_of(browser, folder, "2rpr")
    scene = zoo.view_of("2rpr").scene
    singular = float(scene.t[int(np.argmin(scene.margin))])
    _seek(browser, singular)
    at = _is(_picture(browser), MARGIN_COLORS[0]).sum()
    _seek(browser, 0.0)
    away = _is(_picture(browser), MARGIN_COLORS[0]).sum()
    assert away > 20  # the path keeps its colours
    assert at > away + 100  # the platform has it only there
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


ARROWS = """
viewer.scene.updateMatrixWorld(true);
const root = viewer.scene_tree.find(["meshcat"]).object.matrixWorld.clone().invert();
return data.arrows.map(path => {
  const corners = [];
  viewer.scene_tree.find(["meshcat", ...path.split("/"), "effort", "arrow"]).object.traverse(part => {
    if (!part.geometry) { return; }
    const position = part.geometry.attributes.position, place = root.clone().multiply(part.matrixWorld);
    for (let i = 0; i < position.count; i++) {
      corners.push(new MeshCat.THREE.Vector3().fromBufferAttribute(position, i).applyMatrix4(place).toArray());
    }
  });
  return corners;
});
"""
"""The corners of arrows where they are drawn, in the frame of the scene, m."""

SINGLE = 1e-5
"""Relative: viewers keep corners and matrices in single precision; a chain of twelve joints adds some of it."""

EFFORTS: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "positive": lambda t: 1.0 + t,
    "negative": lambda t: -2.0 + t,
    "rising through zero": lambda t: 2.5 * t - 1.0,
    "falling through zero": lambda t: 1.0 - 2.5 * t,
    "constant positive": lambda t: 0.8 + 0.0 * t,
    "constant negative": lambda t: -0.8 + 0.0 * t,
}
"""Efforts over t from 0 to 1 s, of a slide and of a turning joint each; the largest is 2."""


HOSTILE = (
    "</script><script>alert(1)</script>", "{{ viewer }}", "{% raw %}", "a/b", "a_b", "a%2Fb", "base", "constructor",
    "__proto__", "<object>", "<b>&amp;", "x" * 255, "関節 $"
)  # fmt: skip
"""Names of joints that a page could take for markup, for marks of its own, or for one another."""


def _chain(folder: Path, kinds: Mapping[str, str], name: str) -> tuple[rp.Robot, list[J]]:
    """Return a chain of joints of some kinds, by name, about axes that are nobody's z."""
    joints: list[J] = []
    for i, (joint, kind) in enumerate(kinds.items()):
        parent = joints[-1].child if joints else "base"
        joints.append(J(joint, kind, parent, f"l{i}", (0.1, 0.2, -0.1), (0.3, -0.4, 0.5 + i), (1.0, 2.0, -2.0)))
    data = {
        "name": name,
        "actuated": [*kinds],
        "independent": {"joints": [*kinds]},
        "reference": {"joints": dict.fromkeys(kinds, 0.0)},
    }
    return rp.load_robot(write_robot(folder, urdf_of(joints), data)), joints


def _frames_by_hand(joints: list[J], q: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return origin and axis of each joint of a chain in the world, by the definition of a URDF."""
    rotation, origin, frames = Rotation.identity(), np.zeros(3), []
    for joint, value in zip(joints, q.tolist(), strict=True):
        origin = origin + rotation.apply(joint.xyz)
        rotation = rotation * Rotation.from_euler("xyz", joint.rpy)
        axis = np.array(joint.axis) / np.linalg.norm(joint.axis)
        if joint.kind == "prismatic":
            origin = origin + rotation.apply(value * axis)
        else:
            rotation = rotation * Rotation.from_rotvec(value * axis)
        frames.append((origin, rotation.apply(axis)))
    return frames


def _tip_of_an_arc(corners: np.ndarray, origin: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return foot and tip of the head of an arc about an origin, seen from there."""
    place = corners - origin
    size = np.linalg.norm(place, axis=1)
    # the outermost corner is on the rim of the head; a rim ends where all its corners meet: the tip, or the far end
    rim = place[np.argmax(size)]
    alike = np.linalg.norm(place[:, None] - place[None], axis=2) < 1e-3 * size.max()
    ends = place[alike.sum(axis=1) >= 10]
    return rim, ends[np.argmin(np.linalg.norm(ends - rim, axis=1))]


KINDS = {f"slide_{i // 2}" if i % 2 == 0 else HOSTILE[i // 2]: ("prismatic", "revolute")[i % 2]
         for i in range(2 * len(EFFORTS))} | dict.fromkeys(HOSTILE[len(EFFORTS) :], "revolute")  # fmt: skip
"""Joints of a chain, in order: for each of the efforts a slide and a turning joint, and turning ones without any."""

TITLE = "{{ viewer }}</title><script>alert(2)</script>"


@pytest.fixture(scope="module")
def chain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Scene, list[J], np.ndarray, np.ndarray]:
    """The page of a chain whose joints have hostile names, its scene, its joints, and q and tau over eleven frames."""
    folder = tmp_path_factory.mktemp("chain")
    robot, joints = _chain(folder, KINDS, TITLE)
    t = np.linspace(0.0, 1.0, 11)  # each is a frame
    q = 0.3 * np.sin(np.outer(t, np.arange(1.0, len(joints) + 1.0)))
    tau = np.zeros_like(q)
    tau[:, : 2 * len(EFFORTS)] = np.repeat([effort(t) for effort in EFFORTS.values()], 2, axis=0).T
    scene = make_scene(robot, t, q, np.ones(len(t)), tau, title=robot.name)
    View(scene).save(folder / "chain.html")
    return folder / "chain.html", scene, joints, q, tau


def test_arrows_point_where_the_efforts_push(browser: Any, chain: Any) -> None:
    """Along the axis of a slide and about that of a turning joint, times the sign of the effort, at any time."""
    file, scene, joints, q, tau = chain
    _open(browser, file)
    for frame in (0, 3, 5, 10):
        _seek(browser, float(scene.t[frame]))
        drawn = browser.execute_script(ARROWS)
        frames = _frames_by_hand(joints, q[frame])
        assert len(drawn) == len(frames) == len(joints)
        for i, (corners, (origin, axis)) in enumerate(zip(drawn, frames, strict=True)):
            effort, case = float(tau[frame, i]), f"{joints[i].name}, t = {scene.t[frame]:.1f} s"
            if abs(effort) < 1e-9:
                continue
            turning = joints[i].kind == "revolute"
            longest = (LONGEST_TORQUE if turning else LONGEST_FORCE) * scene.size
            length = longest * abs(effort) / 2.0
            if turning:
                rim, tip = _tip_of_an_arc(np.array(corners), origin)
                assert np.sign(axis @ np.cross(rim, tip)) == np.sign(effort), case
                assert abs(axis @ tip) < 1e-3 * length, case
                assert np.linalg.norm(tip) == pytest.approx(length, rel=SINGLE), case
            else:
                away = np.array(corners) - origin
                tip = away[np.argmax(np.linalg.norm(away, axis=1))]
                np.testing.assert_allclose(tip, np.sign(effort) * length * axis, atol=SINGLE * longest, err_msg=case)
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


JOINT = """
const [part] = [...jointOf].find(([part, joint]) => joint.name === arguments[0] && part.name.startsWith("joint_"));
viewer.scene.updateMatrixWorld(true);
const root = viewer.scene_tree.find(["meshcat"]).object;
return root.worldToLocal(new MeshCat.THREE.Vector3().setFromMatrixPosition(part.matrixWorld)).toArray();
"""
"""Where the solid of a joint is, in the frame of the scene, m."""


def test_names_are_text_every_joint_is_at_its_own_place_and_all_are_in_view(browser: Any, chain: Any) -> None:
    file, scene, joints, q, _ = chain
    if browser.current_url != file.as_uri():
        _open(browser, file)
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []
    assert browser.title == TITLE
    _all_is_in_view(browser, (0.0, 0.5))
    assert browser.execute_script("return document.scripts.length") == 2
    rows = "return [...byId('values').querySelectorAll('tr')].map(row => row.cells[0].textContent)"
    assert browser.execute_script(rows) == [*KINDS]
    _seek(browser, float(scene.t[5]))
    for joint, (origin, _) in zip(joints, _frames_by_hand(joints, q[5]), strict=True):
        if joint.kind == "revolute":
            at = browser.execute_script(JOINT, joint.name)
            np.testing.assert_allclose(at, origin, atol=SINGLE, err_msg=joint.name)


CRANK, ROD = 0.3, 0.8
"""Lengths of a slider-crank, m."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, View]:
    """A notebook cell of a press: its slide is at zero on the crank's axis, its crank has a mesh in magenta."""
    from test_meshes import visual, wedge

    folder = tmp_path_factory.mktemp("cell")
    joints = [
        J("crank", "revolute", "base", "crank_link"),
        J("pin", "revolute", "crank_link", "rod", (CRANK, 0.0, 0.0)),
        J("rod_mount", "fixed", "rod", "rod_end", (ROD, 0.0, 0.0)),
        J("press", "prismatic", "base", "ram", axis=(1.0, 0.0, 0.0)),
    ]
    data = {
        "closures": [{"frames": ["rod_end", "ram"], "axes": ["x", "y"]}],
        "actuated": ["press"],
        "independent": {"joints": ["press"]},
        "reference": {"joints": {"press": 0.9}, "guess": {"crank": 0.9, "pin": -1.2}},
    }
    wedge().apply_scale(2.0).export(folder / "wedge.stl")
    link = '<link name="crank_link">'
    shape = visual('<mesh filename="wedge.stl"/>', "1 0 1 1")
    urdf = urdf_of(joints).replace(link, f"{link}<visual>{shape}</visual>")
    view = show(rp.load_robot(write_robot(folder, urdf, data)), forces=False)
    inside = view._repr_html_()
    (folder / "wedge.stl").unlink()  # the page needs no file
    (folder / "cell.html").write_text(f"<!DOCTYPE html><meta charset='utf-8'>{inside}", encoding="utf-8")
    return folder / "cell.html", view


@pytest.fixture
def in_cell(browser: Any, cell: tuple[Path, View]) -> Iterator[Any]:
    """The browser inside the frame of the cell."""
    if browser.current_url != cell[0].as_uri():
        browser.get(cell[0].as_uri())
    browser.switch_to.frame(0)
    _wait(browser)
    yield browser
    browser.switch_to.default_content()
    assert [entry for entry in browser.get_log("browser") if entry["level"] == "SEVERE"] == []


def test_a_notebook_cell_plays_and_the_block_of_a_slide_is_where_it_slides(
    in_cell: Any, cell: tuple[Path, View]
) -> None:
    """On the ram, at √(l² − r² sin² θ) + r cos θ from the crank, and not where the slide would be at zero."""
    scene = cell[1].scene
    crank = next(reading.position for reading in scene.joints if reading.name == "crank")
    for frame in (0, len(scene.t) // 2):
        _seek(in_cell, float(scene.t[frame]))
        x, y, z = in_cell.execute_script(JOINT, "press")
        wanted = CRANK * np.cos(crank[frame]) + np.sqrt(ROD**2 - (CRANK * np.sin(crank[frame])) ** 2)
        np.testing.assert_allclose([x, y, z], [wanted, 0.0, 0.0], atol=SINGLE)
    assert np.ptp(crank) > 0.05


def test_meshes_are_seen_and_seen_through(in_cell: Any) -> None:
    """A link in magenta: pale while joints are to be seen through it, in its own colour otherwise."""
    _seek(in_cell, 0.0)
    pale = _picture(in_cell)
    in_cell.execute_script("byId('clear').click();")
    full = _picture(in_cell)
    assert _is_shaded(full, "#FF00FF").sum() > 500
    assert _is_shaded(pale, "#FF00FF").sum() < 0.1 * _is_shaded(full, "#FF00FF").sum()
    assert (np.abs(pale - 255.0).max(axis=2) > 20.0).sum() > 500
    in_cell.execute_script("byId('clear').click();")
    np.testing.assert_array_equal(_picture(in_cell), pale)


@pytest.mark.long
def test_the_browser_would_notice(browser: Any, tmp_path: Path) -> None:
    """A page that asks the network and fails in its script is seen to: the checks above can fail."""
    file = tmp_path / "bad.html"
    file.write_text('<img src="https://example.org/a.png"><script>throw new Error("no")</script>')
    browser.get(file.as_uri())
    time.sleep(0.2)
    levels = [entry["level"] for entry in browser.get_log("browser")]
    assert "SEVERE" in levels
    assert browser.execute_script("return performance.getEntriesByType('resource').length") == 1
