"""Plans of one motion side by side: efforts and carriers, one column a plan, with common axes for the carriers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.planners.plan import Plan
from redundancy_pin.visualisation.figures.style import (
    BEYOND,
    CARRIER_STROKES,
    STROKES,
    beyond_handle,
    figure,
    hatch_beyond,
    instant_handle,
    mark_instants,
    words,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_ROWS = ("position", "speed", "acceleration")
_LABELS = {"position": "s [m]", "speed": "ṡ [m/s]", "acceleration": "s̈ [m/s²]"}
_HEADROOM = 1.15

_ENTRY = 1.25
"""Width of an entry of the legend, inches."""


def plot_side_by_side(title: str, plans: Mapping[str, Plan], unit: str, *, instants: Sequence[float] = ()) -> Figure:
    """Draw plans of the same motion in columns: main efforts, and s, ṡ, s̈ of the carriers with their limits.

    Each effort panel has its own scale, as efforts of different planners can be orders of magnitude apart; its peak
    stands above it. The rows of the carriers share their scales.

    Args:
        title: of the figure.
        plans: by what the column is called.
        unit: of the main efforts.
        instants: singular instants, s, drawn as dotted lines.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    with figure(2.0 + 2.6 * len(plans), 8.0) as drawn:
        axes = drawn.subplots(4, len(plans), sharex=True, squeeze=False, height_ratios=(1.25, 1.0, 1.0, 1.0))
        drawn.suptitle(title, fontsize=10.5)
        for column, (name, plan) in enumerate(plans.items()):
            _efforts(axes[0, column], name, plan, unit)
            for row, quantity in enumerate(_ROWS, start=1):
                _carriers(axes[row, column], plan, quantity)
            for axis in axes[:, column]:
                mark_instants(axis, instants)
            axes[3, column].set_xlabel("time t [s]")
        for row, quantity in enumerate(_ROWS, start=1):
            _share(list(axes[row]), list(plans.values()), quantity)
            axes[row, 0].set_ylabel(_LABELS[quantity])
        axes[0, 0].set_ylabel(f"main effort τ [{unit}]")
        axes[0, 0].set_xlim(0.0, max(float(plan.t[-1]) for plan in plans.values()))
        handles: list[Artist] = []
        labels: list[str] = []
        for axis in (axes[0, -1], axes[1, -1]):
            found = axis.get_legend_handles_labels()
            handles, labels = handles + found[0], labels + found[1]
        if instants:
            handles.append(instant_handle())
            labels.append(str(handles[-1].get_label()))
        if any(axis.patches for axis in axes[1:].flat):
            handles, labels = [*handles, beyond_handle()], [*labels, BEYOND]
        drawn.legend(handles, labels, loc="outside lower center", ncols=_columns(drawn, len(labels)), frameon=False)
        drawn.align_ylabels(axes[:, 0])
        return drawn


def _columns(drawn: Figure, entries: int) -> int:
    """Return in how many columns a legend fits on the page."""
    return min(entries, max(2, int(drawn.get_size_inches()[0] / _ENTRY)))


def values_of(plan: Plan, quantity: str) -> Array:
    """Return (N, k) position, speed or acceleration of the carriers, m, m/s or m/s²."""
    return {"position": plan.carriers.s, "speed": plan.carriers.sd, "acceleration": plan.carriers.sdd}[quantity]


def _efforts(axes: Axes, name: str, plan: Plan, unit: str) -> None:
    for i in range(plan.tau.shape[1]):
        stroke = STROKES[i % len(STROKES)]
        axes.plot(plan.t, plan.tau[:, i], color=stroke.color, linestyle=stroke.dash, label=f"actuator {i + 1}")
    peak = f"peak {float(plan.peak_effort.max()):.3g} {unit}, {words(plan.status.value)}"
    axes.set_title(f"{name}\n{peak}", fontsize=8.5)


def _carriers(axes: Axes, plan: Plan, quantity: str) -> None:
    values = values_of(plan, quantity)
    if not values.shape[1]:
        axes.text(0.5, 0.5, "no carriers", transform=axes.transAxes, ha="center", va="center", color="#6E6E6E")
        return
    for i in range(values.shape[1]):
        stroke = CARRIER_STROKES[i % len(CARRIER_STROKES)]
        axes.plot(plan.t, values[:, i], color=stroke.color, linestyle=stroke.dash, label=f"carrier {i + 1}")


def _share(axes: list[Axes], plans: list[Plan], quantity: str) -> None:
    """Give the panels of a row one scale that holds the curves, and draw the limits."""
    limits = [limit for plan in plans for limit in _limits(plan, quantity)]
    finite = [limit for limit in limits if np.isfinite(limit)]
    largest = max((float(np.abs(values_of(plan, quantity)).max(initial=0.0)) for plan in plans), default=0.0)
    shown = [limit for limit in finite if abs(limit) <= 3.0 * largest]
    top = _HEADROOM * (max([largest, *(abs(limit) for limit in shown)]) or 1.0)
    for i, axis in enumerate(axes):
        axis.set_ylim(-top, top)
        for limit in sorted(set(shown)):
            axis.axhline(limit, color="#000000", linewidth=0.9, linestyle=(0, (6, 2)), zorder=1.8)
        for side in (-1.0, 1.0):
            outermost = max((side * limit for limit in shown if side * limit > 0.0), default=top)
            if outermost < top:
                hatch_beyond(axis, side * outermost, side * top)
        if i:
            axis.tick_params(labelleft=False)


def _limits(plan: Plan, quantity: str) -> tuple[float, ...]:
    found: list[float] = []
    for limit in plan.limits.judged_by:
        if quantity == "position":
            found += [limit.lower, limit.upper]
        else:
            most = limit.speed if quantity == "speed" else limit.acceleration
            found += [-most, most]
    return tuple(found)
