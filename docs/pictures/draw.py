"""Draw the pictures of the README into this folder: ``make pictures``. The same plans give the same bytes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from PIL import Image

import redundancy_pin as rp
from redundancy_pin.io.files import replacing_file
from redundancy_pin.visualisation.figures.paths import draw_frame, draw_path, label_plane
from redundancy_pin.visualisation.figures.style import figure
from redundancy_pin.visualisation.viewer.scene import Scene

FOLDER = Path(__file__).resolve().parent

FRAMES_A_SECOND = 20
"""Frames of a GIF last a whole number of hundredths of a second: 20 a second is true speed."""

COLORS = 32
"""Of the GIF: the scene has about a dozen, the rest are for smooth edges."""


def crossing() -> rp.Plan:
    """The 2-RPR on the thesis's circle, through two singularities with its main actuators off."""
    return rp.plan_switch_off(
        rp.VirtualWork(rp.load_robot("2rpr")), rp.trajectory.reference.circle(speed=0.5), threshold=7.0
    )


def corner() -> rp.Plan:
    """The 3-RRR around the thesis's corner, its carriers moving for least torque."""
    return rp.plan_stepwise(
        rp.RneaDynamics(rp.load_robot("3rrr")), rp.trajectory.reference.corner(radius=0.025), lam=0.0
    )


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


def main() -> None:
    """Draw all pictures."""
    animate(rp.show(crossing()).scene, FOLDER / "crossing.gif", title="2-RPR")
    plan = corner()
    for name, drawn in (
        ("corner.svg", rp.plot.snapshots(rp.show(plan), 3, title="3-RRR around a corner")),
        ("corner_carriers.svg", rp.plot.carriers(plan)),
    ):
        with replacing_file(FOLDER / name) as temporary:
            rp.plot.save(drawn, temporary)
    for path in sorted(FOLDER.glob("*.[gs][iv][fg]")):
        print(f"{path.name}: {path.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
