"""Tracking errors over time, logarithmic."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.visualisation.style import STROKES, figure, legend_above

if TYPE_CHECKING:
    from matplotlib.figure import Figure

LEAST = 1e-16
"""m; what is smaller is drawn there."""


def plot_tracking(title: str, curves: Mapping[str, tuple[Array, Array]]) -> Figure:
    """Draw distances from a planned motion over time.

    Args:
        title: of the figure.
        curves: by label, (N,) times, s, and (N,) distances, m.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    with figure(7.0, 4.2) as drawn:
        axes = drawn.subplots()
        drawn.suptitle(title, fontsize=10.5)
        for stroke, (label, (t, error)) in zip(STROKES, curves.items(), strict=False):
            axes.plot(t, np.maximum(error, LEAST), color=stroke.color, linestyle=stroke.dash, label=label)
        axes.set_yscale("log")
        axes.set_xlabel("time t [s]")
        axes.set_ylabel("distance from the plan [m]")
        legend_above(axes, 2)
        return drawn
