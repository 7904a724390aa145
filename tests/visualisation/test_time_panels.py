"""Panels over time: limits hatched, carriers in their own colours, condition numbers in black."""

from __future__ import annotations

import numpy as np
import pytest

from redundancy_pin.visualisation.figures.style import CARRIER_STROKES, STROKES
from redundancy_pin.visualisation.figures.time_panels import (
    Background,
    Curve,
    Panel,
    condition_panel,
    plot_panel_grid,
    plot_time_panels,
    series,
)

T = np.linspace(0.0, 1.0, 11)


def test_limits_that_are_near_are_hatched_and_others_left_out() -> None:
    position = Panel("s [m]", (Curve("carrier 1", T, 0.9 * T, carrier=True),), limits=(-1.0, 1.0))
    drawn = plot_time_panels("title", [position])
    (axes,) = drawn.axes
    (band,) = [patch.get_bbox() for patch in axes.patches if patch.get_hatch()]
    assert (band.y0, band.y1) == pytest.approx((1.0, axes.get_ylim()[1]))
    assert axes.get_legend_handles_labels()[1] == ["carrier 1"]
    assert [text.get_text() for text in drawn.legends[0].get_texts()] == ["beyond a limit"]
    far = Panel("s [m]", (Curve("carrier 1", T, 0.1 * T),), limits=(-1.0, 1.0))
    (axes,) = plot_time_panels("title", [far]).axes
    assert not [patch for patch in axes.patches if patch.get_hatch()]
    assert axes.get_ylim()[1] < 0.2


def test_both_sides_are_hatched_but_named_once() -> None:
    speed = Panel("v [m/s]", (Curve("carrier 1", T, 2.0 * T - 1.0, carrier=True),), limits=(-1.2, 1.2))
    drawn = plot_time_panels("title", [speed])
    (axes,) = drawn.axes
    bands = sorted((patch.get_bbox().y0, patch.get_bbox().y1) for patch in axes.patches if patch.get_hatch())
    low, high = axes.get_ylim()
    np.testing.assert_allclose(bands, [(low, -1.2), (1.2, high)])
    assert [text.get_text() for text in drawn.legends[0].get_texts()] == ["beyond a limit"]


def test_carriers_and_condition_numbers_are_no_main_actuators() -> None:
    panels = [
        Panel("f [N]", (Curve("main", T, T, 1), Curve("carrier", T, -T, 1, carrier=True))),
        condition_panel(T, 1.0 + T),
    ]
    drawn = plot_time_panels("title", panels, instants=[0.5])
    main, carrier = drawn.axes[0].lines[:2]
    assert (main.get_color(), carrier.get_color()) == (STROKES[1].color, CARRIER_STROKES[1].color)
    assert drawn.axes[1].lines[0].get_color() == "#000000"
    assert [text.get_text() for text in drawn.legends[0].get_texts()] == ["singular instant"]


def test_a_new_figure_is_a_list_of_panels() -> None:
    """Rows of panels that share a scale, a curve of points only, a mark with its text, an axis with given ends."""
    columns = [
        [
            Panel("P [W]", series(["P1", "P2"], T, np.stack([T, factor * T], axis=1)), legend=False, shared=True),
            Panel("e [m]", (Curve("error", T, 1e-6 * T, style={"linestyle": "none", "marker": "o"}),), log=True,
                  within=(1e-9, 1e-3), marks=((1.0, 1e-6, "largest"),), title=f"factor {factor}"),
        ]
        for factor in (2.0, 5.0)
    ]  # fmt: skip
    drawn = plot_panel_grid("title", columns, (8.0, 5.0), Background(windows=[(0.2, 0.3)]))
    above_left, above_right, below_left, below_right = drawn.axes
    assert above_left.get_ylim() == above_right.get_ylim()
    assert above_left.get_ylim()[1] == pytest.approx(5.0 * 1.08)
    assert below_right.get_title() == "factor 5.0"
    assert below_left.get_ylim() == (1e-9, 1e-3)
    assert [text.get_text() for text in below_left.texts] == ["largest"]
    assert [text.get_text() for text in drawn.legends[0].get_texts()] == ["P1", "P2", "near-singular"]


def test_samples_that_do_not_count_may_leave_the_picture() -> None:
    (axes,) = plot_time_panels("title", [Panel("f [N]", (Curve("f", T, 100.0 * T, fitted=T < 0.15),))]).axes
    assert axes.get_ylim()[1] == pytest.approx(10.0 * 1.08)
