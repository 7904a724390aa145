"""Trade-off curves: two quantities of which neither can be lowered without raising the other."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from redundancy_pin.arrays import Array
from redundancy_pin.visualisation.style import STROKES, figure, plain_log

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LETTERS = 42
"""Of a line of a panel's title."""


@dataclass(frozen=True, eq=False)
class TradeCurve:
    """One motion.

    Attributes:
        title: of its panel.
        unit: of the effort.
        points: (P, 2) root mean squares of acceleration, m/s², and effort, along the curve.
        marks: the same of other plans, by name.
    """

    title: str
    unit: str
    points: Array
    marks: Mapping[str, tuple[float, float]]


def plot_trade_off(title: str, curves: Sequence[TradeCurve]) -> Figure:
    """Draw each curve in a panel of its own, with other plans as marks.

    Args:
        title: of the figure.
        curves: one panel each.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    with figure(3.8 * len(curves), 3.8) as drawn:
        panels = drawn.subplots(1, len(curves), squeeze=False)[0]
        drawn.suptitle(title, fontsize=10.5)
        names = list(dict.fromkeys(name for curve in curves for name in curve.marks))
        for panel, curve in zip(panels, curves, strict=True):
            panel.plot(curve.points[:, 0], curve.points[:, 1], color=STROKES[0].color, marker="o", markersize=4,
                       label="whole trajectory, one point a weight")  # fmt: skip
            for name, (acceleration, effort) in curve.marks.items():
                stroke = STROKES[1 + names.index(name)]
                panel.plot([acceleration], [effort], linestyle="none", marker=stroke.marker, color=stroke.color,
                           markersize=7, label=name)  # fmt: skip
            plain_log(panel)
            panel.set_title(textwrap.fill(curve.title, _LETTERS), fontsize=9)
            panel.set_xlabel("rms of s̈ [m/s²]")
            panel.set_ylabel(f"rms of |τ| [{curve.unit}]")
        named = {}
        for panel in panels:
            named.update({label: handle for handle, label in zip(*panel.get_legend_handles_labels(), strict=True)})
        drawn.legend(named.values(), named.keys(), loc="outside lower center", ncols=len(named), frameon=False)
        return drawn
