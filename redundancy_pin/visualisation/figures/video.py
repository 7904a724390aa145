"""A moving picture as a file: a GIF, or an MP4 with an ffmpeg (extra ``video``), drawn without a display."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from redundancy_pin.arrays import IntArray, positive
from redundancy_pin.errors import InputError, optional
from redundancy_pin.io.files import refusing, replacing_file, require_suffix, require_writable
from redundancy_pin.visualisation.figures.paths import draw_frame, draw_path, label_plane, projection, scene_in
from redundancy_pin.visualisation.figures.style import break_lines, figure, legend_below
from redundancy_pin.visualisation.viewer.page import View
from redundancy_pin.visualisation.viewer.scene import Scene
from redundancy_pin.visualisation.viewer.solids import extent_of

RATE = 25.0
"""Frames a second; a GIF counts in hundredths of a second, so it is a divisor of 100."""

MOST_FRAMES = 3000

_DPI = 100
_MARGIN = 0.05  # free space about everything that moves, as a fraction of it


def save_video(
    view: View | Scene,
    path: str | Path,
    *,
    rate: float = RATE,
    speed: float = 1.0,
    plane: str | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> None:
    """Write a moving picture of what ``rp.show`` returns as .gif or .mp4, with the time written into it.

    Args:
        view: what ``rp.show`` returns, or its scene.
        path: of the file, .gif or .mp4.
        rate: frames a second of the file.
        speed: seconds of the motion in a second of the file.
        plane: "xy", "xz", "yz" or "3d", as of ``snapshots``; what fits when left out.
        progress: called with the numbers of frames drawn and of all.

    Raises:
        InputError: no view, a rate or a speed that is not positive, more than 3000 frames.
        OutputError: another suffix, or the file cannot be written; an earlier one is as it was.
        RedundancyPinError: matplotlib, or for an MP4 ffmpeg, is not installed.

    Example:
        >>> rp.plot.video(rp.show("four_bar"), "four_bar.gif", rate=2.0)
    """
    scene = scene_in(view)
    require_video(path)
    frames = _frames(scene, positive(rate, "rate", "Hz"), positive(speed, "speed", ""))
    plane = ("xy" if scene.is_flat else "3d") if plane is None else plane
    low, high = extent_of(scene.solids, scene.placement, scene.path, projection(plane))
    space = _MARGIN * float((high - low).max())
    with figure(6.0, 5.6) as drawn, replacing_file(path) as temporary, refusing(path):
        axes, writer = drawn.subplots(), _writer(path, rate)
        with writer.saving(drawn, str(temporary), _DPI):
            for done, frame in enumerate(frames.tolist(), start=1):
                axes.clear()
                axes.set_title(break_lines(scene.title, 6.0))
                draw_frame(axes, scene, frame, plane=plane)
                draw_path(axes, scene, plane=plane)
                axes.update_datalim([low - space, high + space])
                axes.autoscale_view()
                label_plane(axes, plane, flat=scene.is_flat)
                axes.text(0.99, 0.99, f"t = {scene.t[frame]:.2f} s", transform=axes.transAxes, ha="right", va="top")
                if done == 1:
                    legend_below(drawn)
                elif done == 2:
                    drawn.set_layout_engine("none")  # the layout of the first frame stays
                writer.grab_frame()
                if progress is not None:
                    progress(done, len(frames))


def _writer(path: str | Path, rate: float) -> Any:
    from matplotlib.animation import FFMpegWriter, PillowWriter

    class Mp4Writer(FFMpegWriter):
        bin_path = staticmethod(_ffmpeg)  # matplotlib asks a process-wide setting

    make: Any = PillowWriter if Path(path).suffix.lower() == ".gif" else Mp4Writer
    return make(fps=rate)


def _ffmpeg() -> str:
    """Return the system's ffmpeg, otherwise the one of the package imageio-ffmpeg."""
    remedy = "Install it with `pip install 'redundancy_pin[video]'`, or write a .gif."
    found = shutil.which("ffmpeg")
    return found or optional("imageio_ffmpeg", "Without the program ffmpeg an MP4 needs", remedy).get_ffmpeg_exe()


def require_video(path: str | Path) -> None:
    """Check, before the work, that a video can be drawn and written there; raises as ``save_video``."""
    if require_suffix(path, (".gif", ".mp4")) == ".mp4":
        _ffmpeg()
    require_writable(path)


def _frames(scene: Scene, rate: float, speed: float) -> IntArray:
    """Return the frames of the scene that the file has, one every ``speed / rate`` s, and the last."""
    count = int(np.floor(scene.duration * rate / speed + 1e-9)) + 1
    if count > MOST_FRAMES:
        raise InputError(
            f"The video would have {count} frames, more than {MOST_FRAMES}.",
            remedy="Use a lower rate, or a higher speed.",
            frames=count,
        )
    wanted = np.arange(count) * speed / rate
    if scene.duration - wanted[-1] > 1e-9:
        wanted = np.append(wanted, scene.duration)
    nearest: IntArray = np.abs(scene.t[:, None] - wanted).argmin(axis=0)
    return nearest
