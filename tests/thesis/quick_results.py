"""Small runs of the main job that tests share, each made once a process."""

from __future__ import annotations

import functools
import tempfile
from collections.abc import Mapping
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import pytest

from redundancy_pin.crosscheck import CheckRow, CrossCheckReport
from redundancy_pin.thesis import reproduce as job
from redundancy_pin.thesis.cases import BY_NAME, QUICK, Case
from redundancy_pin.thesis.figures import Picture
from redundancy_pin.thesis.measures import MotionRun, run
from redundancy_pin.thesis.reproduce import Reproduction

PASSED = CrossCheckReport((CheckRow("2rpr", "power balance", 10, 1e-15, 1e-10, True),), 0)
"""The cross-check has tests of its own."""


def motion(name: str, dt: float = 0.01) -> Case:
    """Return a motion of the thesis with coarser samples."""
    return replace(BY_NAME[name], dt=dt)


run_once = functools.cache(run)
"""A motion is the same whoever runs it."""


def motion_run(name: str, dt: float = 0.01) -> MotionRun:
    """Run a motion of the thesis."""
    return run_once(motion(name, dt))


def spare(patched: pytest.MonkeyPatch) -> None:
    """Let the job do nothing that has a test of its own: pictures, which cost most of its time, and the cross-check."""
    patched.setattr(Picture, "draw", lambda self: None)
    patched.setattr(job, "save", lambda figure, *paths: [path.write_bytes(b"\x89PNG") for path in paths])
    patched.setattr(job.crosscheck, "run", lambda *_: PASSED)
    patched.setattr(job, "run", run_once)


@functools.cache
def reproduction(*chapters: str) -> Reproduction:
    """Run the main job quickly: one motion without a planner, and chapters; its pictures are empty."""
    folder = Path(tempfile.mkdtemp()) / "results"
    with pytest.MonkeyPatch.context() as patched:
        spare(patched)
        # the chapter beyond the thesis has the same plans in every working mode; verdicts of the thesis's depend on it
        modes = ((1, 1, 1), (-1, -1, -1)) if "planned" in chapters else QUICK.modes
        extent = replace(
            QUICK, motions=(motion("corner-r0.025-baseline"),), chapters=chapters, modes=modes, figures=True, jobs=1
        )
        return job.reproduce(folder, extent)


def chapter(name: str) -> Mapping[str, Any]:
    """Return the records of a chapter."""
    return reproduction(name).results.chapters[name]


class Page(HTMLParser):
    """Every element of a page with its attributes, and the text."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.text += data


def require_self_contained(text: str) -> list[str]:
    """Check that a page needs no network, no file beside it and runs nothing; return the sources of its images."""
    page = Page(text)
    images = [str(attributes["src"]) for tag, attributes in page.tags if tag == "img"]
    assert all(image.startswith("data:image/png;base64,") for image in images)
    links = [str(attributes["href"]) for _, attributes in page.tags if "href" in attributes]
    anchors = [attributes["id"] for _, attributes in page.tags if "id" in attributes]
    assert links
    assert all(link.startswith("#") and link[1:] in anchors for link in links)
    assert not {"script", "link", "iframe", "object"} & {tag for tag, _ in page.tags}
    assert not [word for word in ("http://", "https://", "url(") if word in text]
    return images
