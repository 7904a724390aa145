"""Videos: as many frames as the motion lasts, the mechanism where it is, one clear error where none can be made."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
import zoo
from command_line import call, refused
from PIL import Image

import redundancy_pin as rp
from redundancy_pin.errors import InputError, OutputError, RedundancyPinError
from redundancy_pin.visualisation.figures.video import save_video
from redundancy_pin.visualisation.viewer.solids import ROLE_COLORS


def _frames(path: Path) -> list[np.ndarray]:
    with Image.open(path) as image:
        frames = []
        for i in range(image.n_frames):  # type: ignore[attr-defined]
            image.seek(i)
            frames.append(np.asarray(image.convert("RGB"), dtype=float))
    return frames


def _middle(frame: np.ndarray, color: str) -> np.ndarray:
    """Return the mean place of the pixels of a colour, x to the right and y up, above the legend."""
    wanted = [int(color[i : i + 2], 16) for i in (1, 3, 5)]
    rows, columns = np.nonzero(np.abs(frame[:460] - wanted).max(axis=2) < 40)
    return np.array([columns.mean(), -rows.mean()])


def test_a_gif_shows_the_carriers_where_they_are(tmp_path: Path) -> None:
    robot, t = zoo.robot_of("2rpr"), np.linspace(0.0, 0.2, 21)
    still = np.tile(np.array([0.25, 0.7]), (21, 1))
    rest = rp.PlatformMotion(t, still, 0.0 * still, 0.0 * still)
    along = np.stack([0.8 * t, 0.0 * t], axis=1)
    speed = np.stack([0.8 + 0.0 * t, 0.0 * t], axis=1)
    view = rp.show(robot, rest, rp.CarrierMotion(along, speed, 0.0 * along))
    out = tmp_path / "seen.gif"
    save_video(view, out, rate=10.0)
    frames = _frames(out)
    assert len(frames) == 3
    with Image.open(out) as image:
        assert image.info["duration"] == 100
    # the middle of both carriers in the world, and in the picture: a line through them all, at even distances
    index = [view.scene.names.index(name) for name in robot.carriers]
    world = [view.scene.placement[int(np.abs(view.scene.t - 0.1 * i).argmin()), index, :2, 3].mean(axis=0)
             for i in range(3)]  # fmt: skip
    seen = [_middle(frame, ROLE_COLORS["carrier"]) for frame in frames]
    steps, pixels = np.diff(world, axis=0), np.diff(seen, axis=0)
    scale = np.linalg.norm(seen[2] - seen[0]) / np.linalg.norm(world[2] - world[0])
    assert np.linalg.norm(world[2] - world[0]) > 0.05
    np.testing.assert_allclose(pixels, scale * steps, atol=3.0)


@pytest.mark.long
def test_speed_and_rate_decide_on_the_frames(tmp_path: Path) -> None:
    scene = rp.show(zoo.robot_of("gough")).scene  # 2 s
    counts = []
    save_video(
        scene, tmp_path / "a.gif", rate=2.0, speed=2.0, progress=lambda done, total: counts.append((done, total))
    )
    assert counts == [(1, 3), (2, 3), (3, 3)]
    assert len(_frames(tmp_path / "a.gif")) <= 3  # equal ones are one in a GIF


def test_what_cannot_be_made_is_said(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = zoo.view_of("four_bar").scene
    for path, kind, text in (
        ("seen.avi", OutputError, "does not end in .gif or .mp4"),
        ("none/seen.gif", OutputError, "no folder"),
    ):
        with pytest.raises(kind, match=text):
            save_video(scene, tmp_path / path)
    with pytest.raises(InputError, match="more than 3000"):
        save_video(scene, tmp_path / "seen.gif", speed=1e-3)
    with pytest.raises(InputError, match="rate"):
        save_video(scene, tmp_path / "seen.gif", rate=-1.0)
    with pytest.raises(InputError, match="view can be drawn"):
        save_video("four_bar", tmp_path / "seen.gif")  # type: ignore[arg-type]
    monkeypatch.setattr("shutil.which", lambda name: None)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(RedundancyPinError, match=r"ffmpeg.*\[video\].*or write a \.gif"):
        save_video(scene, tmp_path / "seen.mp4")
    assert "ffmpeg" in refused("show", "--robot", "four_bar", "--video", str(tmp_path / "seen.mp4"))
    assert list(tmp_path.iterdir()) == []


def test_an_mp4_is_one(tmp_path: Path) -> None:
    save_video(zoo.view_of("four_bar"), tmp_path / "seen.mp4", rate=2.0, speed=4.0)
    assert (tmp_path / "seen.mp4").read_bytes()[4:8] == b"ftyp"


def test_the_command_writes_one(tmp_path: Path) -> None:
    out = tmp_path / "seen.gif"
    motion = rp.view.default_motion(zoo.robot_of("four_bar"))
    lines = ["t,x0,xd0,xdd0", *(f"{t!r},{x!r},{v!r},{a!r}" for t, x, v, a in zip(
        motion.t[:21].tolist(), motion.x[:21, 0].tolist(), motion.xd[:21, 0].tolist(), motion.xdd[:21, 0].tolist(),
        strict=True))]  # fmt: skip
    (tmp_path / "in.csv").write_text("\n".join(lines) + "\n")
    done = call("show", "--robot", "four_bar", "--motion", str(tmp_path / "in.csv"), "--video", str(out))
    assert (done.exit_code, done.stderr) == (0, "")
    assert str(out) in done.stdout
    assert len(_frames(out)) == 4  # 0.1 s at 25 a second, and the end
