"""Numbers of several methods in several cases, as groups of bars."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.visualisation.style import STROKES, figure, legend_above, plain_log

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_HATCHES = ("", "///", "...", "xxx", "---", "\\\\\\")
"""So that bars can be told apart without colour."""


def plot_bars(
    title: str, groups: Sequence[str], groups_label: str, label: str, series: Mapping[str, Array]
) -> Figure:  # fmt: skip
    """Draw one group of bars a case, one bar a method, on a logarithmic axis.

    Args:
        title: of the figure.
        groups: names of the G cases.
        groups_label: of their axis.
        label: of the values' axis, with its unit.
        series: (G,) positive values by method; NaN leaves a gap that is marked "none".

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    with figure(max(8.0, 1.6 + 0.9 * len(groups)), 3.6) as drawn:
        axes = drawn.subplots()
        drawn.suptitle(title, fontsize=10.5)
        width = 0.8 / len(series)
        places = np.arange(len(groups))
        smallest = min(float(np.nanmin(values)) for values in series.values())
        for i, (name, values) in enumerate(series.items()):
            at = places + (i - 0.5 * (len(series) - 1)) * width
            axes.bar(
                at,
                np.nan_to_num(values),
                width,
                color=STROKES[i % len(STROKES)].color,
                hatch=_HATCHES[i % len(_HATCHES)],
                edgecolor="white",
                linewidth=0.4,
                label=name,
            )
            for x in at[np.isnan(values)]:
                axes.text(x, smallest, "none", rotation=90, ha="center", va="bottom", fontsize=7)
        plain_log(axes)
        axes.set_ylim(bottom=0.7 * smallest)
        axes.set_xticks(places, groups)
        axes.set_xlabel(groups_label)
        axes.set_ylabel(label)
        legend_above(axes, len(series))
        return drawn
