"""Nothing a figure says is cut off at its edge or lies over another thing it says."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from itertools import combinations

import pytest
import zoo
from matplotlib.figure import Figure
from matplotlib.text import Text
from matplotlib.transforms import Bbox

import redundancy_pin as rp
from redundancy_pin.planners.plan import Plan
from redundancy_pin.thesis.cases import SINGULAR
from redundancy_pin.trajectory import reference

EDGE = 1.5
"""Pixels by which the box of a text may be larger than what is seen of it: ascenders and descenders it has not."""


@cache
def crossing() -> Plan:
    return SINGULAR[0].plan()


@cache
def corner() -> Plan:
    return rp.plan_stepwise(rp.VirtualWork(zoo.robot_of("3rrr")), reference.corner())


BOX = [(-0.6, 1.1), (-1.0, 1.0)]
FIGURES: dict[str, Callable[[], Figure]] = {
    "plan of a crossing": lambda: rp.plot.plan(crossing()),
    "plan of a corner": lambda: rp.plot.plan(corner()),
    "efforts": lambda: rp.plot.efforts(crossing()),
    "carriers": lambda: rp.plot.carriers(corner()),
    "condition": lambda: rp.plot.condition(crossing()),
    "path of a crossing": lambda: rp.plot.path(crossing()),
    "path of a corner": lambda: rp.plot.path(corner()),
    "snapshots of a crossing": lambda: rp.plot.snapshots(rp.show(crossing())),
    "snapshots of a corner": lambda: rp.plot.snapshots(rp.show(corner())),
    "comparison": lambda: rp.plot.comparison({"stepwise": corner(), "the same again": corner()}),
    "locus": lambda: rp.plot.locus(rp.singular_locus(zoo.robot_of("2rpr"), resolution=24)),
    "ellipsoids": lambda: rp.plot.ellipsoids(rp.performance("five_bar", rp.load_robot("five_bar").q_reference)),
    "workspace": lambda: rp.plot.workspace(rp.workspace("five_bar", bounds=BOX, resolution=8, modes="all")),
    "locus of one coordinate": lambda: rp.plot.locus(rp.singular_locus(zoo.robot_of("four_bar"))),
}  # fmt: skip


def _said(drawn: Figure) -> dict[str, Bbox]:
    """Return the boxes of titles, labels of axes and legends, pixels."""
    drawn.draw_without_rendering()
    things: list[tuple[str, object]] = [("suptitle", drawn._suptitle)] if drawn._suptitle else []
    things += [(f"legend {i}", legend) for i, legend in enumerate(drawn.legends)]
    for i, axes in enumerate(drawn.axes):
        things += [(f"{kind} of panel {i}", thing) for kind, thing in (
            ("title", axes.title), ("x label", axes.xaxis.label), ("y label", axes.yaxis.label),
            ("legend", axes.get_legend())) if thing is not None]  # fmt: skip
    texts = {name: thing for name, thing in things if not isinstance(thing, Text) or thing.get_text()}
    return {name: thing.get_window_extent() for name, thing in texts.items()}  # type: ignore[attr-defined]


@pytest.mark.long_for(
    "path of a crossing",
    "snapshots of a crossing",
    "plan of a crossing",
    "path of a corner",
    "snapshots of a corner",
    "workspace",
    "condition",
    "efforts",
    "carriers",
    "locus of one coordinate",
    "comparison",
)
@pytest.mark.parametrize("name", FIGURES)
def test_titles_labels_and_legends_are_whole_and_apart(name: str) -> None:
    drawn = FIGURES[name]()
    boxes = _said(drawn)
    for what, box in boxes.items():
        assert box.x0 > -EDGE, what
        assert box.y0 > -EDGE, what
        assert box.x1 < drawn.bbox.x1 + EDGE, what
        assert box.y1 < drawn.bbox.y1 + EDGE, what
    for (first, a), (second, b) in combinations(boxes.items(), 2):
        over = Bbox.intersection(a, b)
        assert over is None or min(over.width, over.height) < EDGE, f"{first} over {second}"
