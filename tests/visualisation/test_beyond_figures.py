"""Figures of the last chapter show what they are given."""

from __future__ import annotations

import numpy as np
import pytest

from redundancy_pin.planners.plan import Plan
from redundancy_pin.studies.cases import EFFORT, SINGULAR, by_method
from redundancy_pin.visualisation.figures.comparisons import (
    TradeCurve,
    plot_bars,
    plot_side_by_side,
    plot_speed_border,
    plot_trade_off,
)


@pytest.fixture(scope="module")
def plans() -> dict[str, Plan]:
    task = SINGULAR[0]
    return {"off": task.plan(), "whole": by_method(task, EFFORT, 4.0).plan()}


def test_columns_show_each_plan_and_its_limits(plans: dict[str, Plan]) -> None:
    figure = plot_side_by_side("circle", plans, "N", instants=[0.57, 0.88])
    axes = np.array(figure.axes).reshape(4, 2)
    for column, (name, plan) in enumerate(plans.items()):
        assert name in axes[0, column].get_title()
        assert f"{plan.peak_effort.max():.3g} N" in axes[0, column].get_title()
        assert axes[0, column].get_title().endswith(plan.status.value.replace("_", " "))
        assert "_" not in axes[0, column].get_title()
        parts = (plan.tau, plan.carriers.s, plan.carriers.sd, plan.carriers.sdd)
        for axis, values in zip(axes[:, column], parts, strict=True):
            for i in range(2):
                np.testing.assert_array_equal(axis.lines[i].get_ydata(), values[:, i])
        levels = [line.get_ydata()[0] for line in axes[1, column].lines if len(set(line.get_ydata())) == 1]
        assert {-0.2, 0.2} <= set(levels)
        assert sum(list(line.get_xdata()) == [0.57, 0.57] for line in axes[0, column].lines) == 1
    mains = {line.get_color() for line in axes[0, 0].lines}
    carriers = {line.get_color() for line in axes[1, 0].lines[:2]}
    assert len(carriers) == 2
    assert not carriers & mains
    (legend,) = figure.legends
    labels = [text.get_text() for text in legend.get_texts()]
    assert labels == ["slide_1", "slide_2", "carrier_1", "carrier_2", "singular instant", "beyond a limit"]
    hatched = [patch.get_bbox() for patch in axes[1, 0].patches if patch.get_hatch()]
    bottom, top = axes[1, 0].get_ylim()
    np.testing.assert_allclose(sorted((box.y0, box.y1) for box in hatched), [(bottom, -0.2), (0.2, top)])
    for row in range(1, 4):  # one scale a row, and every curve inside
        assert axes[row, 0].get_ylim() == axes[row, 1].get_ylim()
    bottom, top = axes[1, 0].get_ylim()
    assert bottom < plans["off"].carriers.s.min() < plans["off"].carriers.s.max() < top


def test_bars_show_values_and_gaps() -> None:
    figure = plot_bars("title", ["+++", "---"], "mode", "τ", {"a": np.array([1.0, 2.0]), "b": np.array([np.nan, 3.0])})
    heights = [bar.get_height() for bar in figure.axes[0].patches]
    assert heights == [1.0, 2.0, 0.0, 3.0]
    assert [text.get_text() for text in figure.axes[0].texts] == ["none"]


def test_border_shows_speeds_with_and_without_a_plan() -> None:
    tried = ("circle", np.array([[0.5, 0.2], [1.0, 1.4]]), np.array([1.2, 1.3]))
    figure = plot_speed_border("title", [tried])
    curve, without = figure.axes[0].lines
    assert list(curve.get_xdata()) == [0.5, 1.0]
    assert list(curve.get_ydata()) == [0.2, 1.4]
    assert list(without.get_xdata()) == [1.2, 1.3]


def test_trade_off_shows_curve_and_marks() -> None:
    curve = TradeCurve("corner", "N·m", np.array([[1.0, 5.0], [2.0, 3.0]]), {"stepwise": (3.0, 4.0)})
    figure = plot_trade_off("title", [curve])
    line, mark = figure.axes[0].lines
    assert list(line.get_xdata()) == [1.0, 2.0]
    assert list(line.get_ydata()) == [5.0, 3.0]
    assert (list(mark.get_xdata()), list(mark.get_ydata())) == ([3.0], [4.0])
    assert mark.get_label() == "stepwise"
    assert figure.axes[0].get_legend() is None  # one legend for all panels, where it hides no point
    assert [text.get_text() for text in figure.legends[0].get_texts()] == [
        "whole trajectory, one point a weight", "stepwise"
    ]  # fmt: skip


def test_a_planner_has_the_same_mark_in_every_panel() -> None:
    points = np.array([[1.0, 5.0], [2.0, 3.0]])
    first = TradeCurve("a", "N", points, {"off": (3.0, 4.0), "stepwise": (2.0, 4.0)})
    second = TradeCurve("b", "N", points, {"stepwise": (3.0, 4.0)})
    figure = plot_trade_off("title", [first, second])
    marks = [next(line for line in axes.lines if line.get_label() == "stepwise") for axes in figure.axes]
    assert marks[0].get_marker() == marks[1].get_marker()
    assert marks[0].get_color() == marks[1].get_color()


def test_logarithmic_axes_have_numbers_without_powers() -> None:
    figure = plot_bars("title", ["+", "-"], "mode", "τ [N·m]", {"a": np.array([3.0, 40.0])})
    figure.draw_without_rendering()
    axis = figure.axes[0].yaxis
    labels = [text.get_text() for text in (*axis.get_majorticklabels(), *axis.get_minorticklabels())]
    assert {"10", "20"} <= set(labels)
    assert not [text for text in labels if "^" in text]
