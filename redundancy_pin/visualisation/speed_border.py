"""Effort over speed up to the fastest motion that has a plan."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from redundancy_pin.arrays import Array
from redundancy_pin.visualisation.style import STROKES, figure, legend_above, plain_log

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False)
class Attempts:
    """Speeds tried for one motion.

    Attributes:
        label: in the legend.
        found: (P, 2) speed, m/s, ascending, and largest effort, N, of those with a plan.
        without: (Q,) speeds without one, m/s.
    """

    label: str
    found: Array
    without: Array


def plot_speed_border(title: str, attempts: Sequence[Attempts]) -> Figure:
    """Draw effort over speed, logarithmic, with crosses on the lower edge where there is no plan.

    Args:
        title: of the figure.
        attempts: one curve each.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    with figure(7.0, 4.6) as drawn:
        axes = drawn.subplots()
        drawn.suptitle(title, fontsize=10.5)
        for stroke, tried in zip(STROKES, attempts, strict=False):
            axes.plot(
                tried.found[:, 0], tried.found[:, 1], color=stroke.color, linestyle=stroke.dash, marker=stroke.marker,
                markersize=4, label=tried.label,
            )  # fmt: skip
            axes.plot(
                tried.without, [0.02] * len(tried.without), linestyle="none", marker="x", color=stroke.color,
                transform=axes.get_xaxis_transform(), clip_on=False,
            )  # fmt: skip
        plain_log(axes)
        axes.set_xlabel("cruising speed [m/s] (crosses: no plan found)")
        axes.set_ylabel("largest main force [N]")
        legend_above(axes, 1)
        return drawn
