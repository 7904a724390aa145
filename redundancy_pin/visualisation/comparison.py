"""The efforts of several cases along the same motion, one panel an actuator."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.visualisation.style import STROKES, figure, legend_above

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LETTERS, _KEY = 96, 9
"""Letters of a legend that fit beside each other, and how many of them an entry takes with its line and space."""


def plot_comparison(title: str, names: tuple[str, ...], unit: str, cases: Mapping[str, tuple[Array, Array]]) -> Figure:
    """Draw the efforts of each case over time.

    Args:
        title: of the figure.
        names: of the m actuators.
        unit: of the efforts.
        cases: by label: (N,) time, s, and (N, m) efforts.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    with figure(7.0, 1.0 + 1.6 * len(names)) as drawn:
        panels = list(drawn.subplots(len(names), 1, sharex=True, sharey=True, squeeze=False)[:, 0])
        drawn.suptitle(title, fontsize=10.5)
        for i, (panel, name) in enumerate(zip(panels, names, strict=True)):
            for stroke, (label, (t, tau)) in zip(STROKES, cases.items(), strict=False):
                peak = float(np.nanmax(np.abs(tau[:, i]), initial=0.0))
                panel.plot(
                    t, tau[:, i], color=stroke.color, linestyle=stroke.dash, label=f"{label}: peak {peak:.3g} {unit}"
                )
            panel.set_ylabel(f"{name} [{unit}]")
            longest = max(len(text) for text in panel.get_legend_handles_labels()[1])
            fit = max(1, _LETTERS // (_KEY + longest))
            rows = math.ceil(len(cases) / fit)
            legend_above(panel, math.ceil(len(cases) / rows))
        panels[-1].set_xlabel("time t [s]")
        end = max(float(t[-1]) for t, _ in cases.values())
        panels[-1].set_xlim(0.0, end)
        drawn.align_ylabels(panels)
        return drawn
