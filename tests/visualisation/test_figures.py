"""Figures say what they show: units, legends, clipped singular windows, and the same bytes every time."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure

import redundancy_pin as rp
from redundancy_pin.errors import OutputError, RedundancyPinError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.visualisation.figures.curves import Curves
from redundancy_pin.visualisation.figures.page import Page, RepeatableLayout
from redundancy_pin.visualisation.figures.paths import plot_path
from redundancy_pin.visualisation.figures.plots import plot_comparison
from redundancy_pin.visualisation.figures.style import CARRIER_STROKES, STROKES, figure, save

T = np.linspace(0.0, 1.0, 201)
SINGULAR = 100


def _efforts(*, singular: bool = True, carriers: int = 2) -> Figure:
    margin = np.abs(T - 0.5) if singular else np.ones(len(T))
    with np.errstate(divide="ignore"):
        tau = (
            np.stack([1.0 / (T - 0.5), -1.0 / (T - 0.5)], axis=1) if singular else np.sin(np.stack([T, 2 * T], axis=1))
        )
    if singular:
        tau[SINGULAR] = np.nan
    curves = Curves(
        title="title",
        t=T,
        tau=tau,
        main_unit="force [N]",
        carrier_force=np.zeros((len(T), carriers)),
        carriers=CarrierMotion.parked(len(T), carriers),
        limits=(),
        condition=1.0 / np.maximum(margin, 1e-300),
        margin=margin,
        regular=margin > 0.05,
        instants=(0.5,) if singular else (),
    )
    return rp.plot.efforts(curves)


def _path(*, singular: bool = True) -> Figure:
    return plot_path(
        "title",
        T,
        np.stack([np.cos(T), np.sin(T)], axis=1),
        (np.array([[0.0, 0.0], [1.0, 0.0]]),),
        np.zeros((1, 2)),
        np.where(T == 0.5, np.inf, 1.0 / np.maximum(np.abs(T - 0.5), 1e-300)) if singular else 2.0 + T,
        thresholds=(5.0,) if singular else (),
        instants=(0.5,) if singular else (),
        singular_points=((0.5, 0.5),) if singular else (),
    )


@pytest.mark.parametrize("singular", [True, False])
@pytest.mark.parametrize("carriers", [0, 2])
def test_every_axis_has_a_quantity_and_a_unit(singular: bool, carriers: int) -> None:
    for drawn in (_efforts(singular=singular, carriers=carriers), _path(singular=singular)):
        for axes in drawn.axes:
            assert "[" in axes.get_ylabel()
        assert "[s]" in drawn.axes[-1].get_xlabel()


def test_efforts_inside_the_window_do_not_scale_the_axis() -> None:
    drawn = _efforts()
    axes = drawn.axes[0]
    assert axes.get_ylim()[1] < 30.0  # 1/0.05 and some room; the largest sample is 200
    assert "singular instant" in [text.get_text() for text in drawn.legends[0].get_texts()]


def test_strokes_differ_without_colour() -> None:
    assert len({str(stroke.dash) for stroke in STROKES}) == len(STROKES)
    assert len({stroke.marker for stroke in STROKES}) == len(STROKES)


def test_carriers_have_strokes_of_their_own() -> None:
    mains, carriers = ({stroke.color for stroke in strokes} for strokes in (STROKES, CARRIER_STROKES))
    assert len(carriers) == len(CARRIER_STROKES)
    assert not mains & carriers
    assert len({str(stroke.dash) for stroke in CARRIER_STROKES}) == len(CARRIER_STROKES)
    drawn = _efforts()
    (panel,) = [axes for axes in drawn.axes if axes.get_ylabel() == "carrier force [N]"]
    assert {line.get_color() for line in panel.lines[:2]} <= carriers


def test_comparison_shows_each_case_with_its_peak() -> None:
    tau = np.stack([T, -2.0 * T, 3.0 * T], axis=1)
    drawn = plot_comparison("title", ("τ1", "τ2", "τ3"), "N·m", {"a": (T, tau), "b": (T, 2.0 * tau)})
    assert len(drawn.axes) == 3
    assert drawn.axes[1].get_legend_handles_labels()[1] == ["a: peak 2 N·m", "b: peak 4 N·m"]


@pytest.mark.long_for(".png", ".svg")
@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_saving_twice_gives_the_same_bytes(suffix: str, tmp_path: Path) -> None:
    for name in ("a", "b"):
        save(_efforts(), tmp_path / f"{name}{suffix}")
    assert (tmp_path / f"a{suffix}").read_bytes() == (tmp_path / f"b{suffix}").read_bytes()


def test_a_figure_is_laid_out_once_and_drawn_once_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    drawings, layouts = [], []
    real, lay_out = Page.draw, RepeatableLayout.execute
    monkeypatch.setattr(RepeatableLayout, "execute", lambda *given: layouts.append(0) or lay_out(*given))
    with figure(3.0, 2.0) as drawn:
        axes = drawn.subplots()
        axes.set_ylabel("a label\nof three\nlines")
    before, engine = axes.get_position(original=True), drawn.get_layout_engine()
    # which file a drawing is for, and where the label is then, in fractions of the page
    monkeypatch.setattr(Page, "draw", lambda self, to: (real(self, to), drawings.append(
        (type(to).__name__, axes.yaxis.label.get_window_extent(to).x0 / drawn.bbox.width)))[0])  # fmt: skip
    save(drawn, tmp_path / "a.png", tmp_path / "a.svg")
    assert [kind for kind, _ in drawings] == ["RendererAgg", "MixedModeRenderer"]
    assert len(layouts) == 1
    assert all(0.0 < left < 0.05 for _, left in drawings)
    assert axes.get_position(original=True).x0 > before.x0
    assert (drawn.get_layout_engine(), drawn.dpi) == (engine, 100)


def test_user_defaults_do_not_leak_in_or_out() -> None:
    import matplotlib

    with matplotlib.rc_context({"lines.linewidth": 9.0}):
        before = dict(matplotlib.rcParams)
        axes = _path().axes[0]
        assert dict(matplotlib.rcParams) == before
    assert all(line.get_linewidth() < 5.0 for line in axes.get_lines())


def test_pictures_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    drawn = _path()
    with pytest.raises(OutputError, match="picture format"):
        save(drawn, tmp_path / "a.txt")
    with pytest.raises(OutputError, match="Cannot write"):
        save(drawn, tmp_path / "none" / "a.png")


def test_without_matplotlib_the_remedy_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(RedundancyPinError, match=r"redundancy_pin\[plot\]"), figure(1.0, 1.0):
        pass
