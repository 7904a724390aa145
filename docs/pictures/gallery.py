"""Draw the gallery into docs/pictures/gallery: each machine as a looping animation of its page, and its efforts.

python docs/pictures/gallery.py [NAME ...]     needs Chromium, its driver, and the extra ``dev`` (selenium)
"""

from __future__ import annotations

import io
import re
import shutil
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image, ImageOps
from selenium import webdriver
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.support.ui import WebDriverWait

import redundancy_pin as rp
from redundancy_pin.visualisation.figures.style import figure

PAGE = Path(__file__).resolve().parents[1] / "gallery.md"
FOLDER = Path(__file__).resolve().parent / "gallery"
SIZE = (360, 300)
"""Pixels of a picture."""
FRAMES, MOST = 20, 3.0
"""Frames of a loop, and its longest duration, s: slower motions are shown faster."""
FLAGS = ("--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader")
HIDE = "for (const e of [byId('panel'), byId('bar'), viewer.gui.domElement]) e.style.visibility = 'hidden';"


def machines() -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield name and variables of each block of the page that runs."""
    blocks = re.findall(
        r"(<!-- not run[^\n]*\n)?```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL
    )
    for left_out, text in blocks:
        if not left_out:
            variables: dict[str, Any] = {}
            exec(compile(text, PAGE.name, "exec"), variables)
            yield re.findall(r'(?:load_robot|plan_\w+)\("(\w+)"', text)[0], variables


def animate(driver: Any, page: Path, target: Path) -> None:
    """Record a page as a GIF that repeats."""
    driver.get(page.as_uri())
    ready = "return typeof animator !== 'undefined' && animator.actions.length > 0 && animator.time > 0"
    WebDriverWait(driver, 60, poll_frequency=0.05).until(lambda one: one.execute_script(ready))
    driver.execute_script("if (animator.playing) { byId('play').click(); } " + HIDE)
    duration = driver.execute_script("return duration")
    frames = []
    for t in np.linspace(0.0, duration, FRAMES, endpoint=False):
        driver.execute_script("goTo(arguments[0]); viewer.render();", t)
        shot = Image.open(io.BytesIO(driver.get_screenshot_as_png())).convert("RGB")
        frames.append(ImageOps.expand(shot, SIZE[0], "white"))  # the crop may reach beyond the page
    frames = [frame.crop(box).resize(SIZE, Image.Resampling.LANCZOS) for box in [drawn_box(frames)] for frame in frames]
    strip = Image.new("RGB", (SIZE[0], 4 * SIZE[1]))
    for i in range(4):
        strip.paste(frames[i * FRAMES // 4], (0, i * SIZE[1]))
    palette = strip.quantize(48, method=Image.Quantize.MAXCOVERAGE)
    drawn = [frame.quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    between = round(1000.0 * min(duration, MOST) / FRAMES)
    drawn[0].save(target, save_all=True, append_images=drawn[1:], duration=between, loop=0, optimize=True)


def drawn_box(frames: list[Image.Image]) -> tuple[int, int, int, int]:
    """Return the part of all frames that holds what is drawn, with a margin, in the proportions of a picture."""
    boxes = np.array([ImageOps.invert(frame).getbbox() for frame in frames])
    (left, top), (right, bottom) = boxes[:, :2].min(axis=0), boxes[:, 2:].max(axis=0)
    width = 1.08 * max(right - left, (bottom - top) * SIZE[0] / SIZE[1])
    height = width * SIZE[1] / SIZE[0]
    x, y = 0.5 * (left + right), 0.5 * (top + bottom)
    return round(x - 0.5 * width), round(y - 0.5 * height), round(x + 0.5 * width), round(y + 0.5 * height)


def plot(variables: dict[str, Any], target: Path) -> None:
    """Draw the efforts that the block ends with."""
    subject = variables.get("plan")
    t = subject.t if subject is not None else variables["motion"].t
    names = subject.robot.actuated if subject is not None else variables["robot"].actuated
    with figure(3.6, 3.0) as drawn:
        axes = drawn.add_subplot()
        lines = axes.plot(t, variables["tau"], linewidth=1.2)
        axes.set(xlabel="t [s]", ylabel="efforts [N·m, N]")
        if len(names) <= 6:
            axes.legend(lines, names, fontsize=7)
        rp.plot.save(drawn, str(target))


def main() -> None:
    """Draw all machines, or those that are named."""
    FOLDER.mkdir(exist_ok=True)
    options = webdriver.ChromeOptions()
    options.binary_location = shutil.which("chromium") or ""
    for flag in (*FLAGS, f"--window-size={2 * SIZE[0]},{2 * SIZE[1]}"):
        options.add_argument(flag)
    driver = webdriver.Chrome(options=options, service=Service(shutil.which("chromedriver")))
    try:
        with tempfile.TemporaryDirectory() as folder:
            for name, variables in machines():
                if sys.argv[1:] and name not in sys.argv[1:]:
                    continue
                plan = variables.get("plan")
                view = rp.show(plan) if plan is not None else rp.show(variables["robot"], variables["motion"])
                page = Path(folder) / f"{name}.html"
                view.save(page)
                animate(driver, page, FOLDER / f"{name}.gif")
                plot(variables, FOLDER / f"{name}.svg")
                print(f"{name}: {(FOLDER / f'{name}.gif').stat().st_size // 1000} kB")
    finally:
        driver.quit()


if __name__ == "__main__":
    main()
