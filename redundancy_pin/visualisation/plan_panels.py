"""Parts of the picture of a plan: shaded phases, a band of what a carrier may do, marks where a limit is broken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.plan import Plan
from redundancy_pin.visualisation.style import STROKES

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

_PHASE_FILLS = ("#FFFFFF", "#E4E4E4", "#C4C4C4", "#F1F1F1", "#D4D4D4", "#B4B4B4")
"""Greys of the phases, in the order of their names; neighbours differ enough to be told apart in print."""

_FORBIDDEN = "#8C8C8C"
_VISIBLE_FRACTION = 0.35
"""A limit is drawn if the motion uses at least this fraction of it; else it would flatten the curves."""

_HEADROOM = 1.12
"""Height of an axis over the largest value it shows."""


def phase_runs(phase: IntArray) -> list[tuple[int, int, int]]:
    """Return (phase, first sample, last sample) of each stretch of samples in one phase."""
    edges = np.flatnonzero(np.diff(phase)) + 1
    starts = np.concatenate([[0], edges])
    stops = np.concatenate([edges, [len(phase)]]) - 1
    return [(int(phase[a]), int(a), int(b)) for a, b in zip(starts, stops, strict=True)]


def shade_phases(axes: Axes, plan: Plan) -> None:
    """Shade each phase with its grey, and draw a hairline where one ends; the first phase stays white."""
    runs = phase_runs(plan.phase)
    for i, (phase, first, _) in enumerate(runs):
        start = float(plan.t[first])
        end = float(plan.t[runs[i + 1][1]]) if i + 1 < len(runs) else float(plan.t[-1])
        axes.axvspan(start, end, color=_fill(phase), linewidth=0, zorder=0.2)
        if i:
            axes.axvline(start, color="#777777", linewidth=0.5, zorder=0.6)


def phase_handles(plan: Plan) -> list[Artist]:
    """Return what the legend says of the phases that occur."""
    from matplotlib.patches import Patch

    present = sorted({phase for phase, _, _ in phase_runs(plan.phase)})
    return [
        Patch(facecolor=_fill(phase), edgecolor="#777777", linewidth=0.5, label=plan.phases[phase].replace("_", " "))
        for phase in present
    ]


def draw_series(axes: Axes, t: Array, values: Array, names: Sequence[str]) -> None:
    """Draw one line for each column of ``values`` (N, m), in the common strokes."""
    for i, name in enumerate(names):
        stroke = STROKES[i % len(STROKES)]
        axes.plot(t, values[:, i], color=stroke.color, linestyle=stroke.dash, label=name, zorder=2.0)


def draw_limits(axes: Axes, values: Array, limits: Sequence[tuple[float, float]]) -> None:
    """Hatch what the carriers may not do, and fit the axis to it and to the values.

    Carriers with different limits get a line each in their own stroke, and no hatching. Limits far beyond the values
    are said in the corner instead of drawn.

    Args:
        axes: the axes.
        values: (N, k) what is drawn.
        limits: lower and upper limit of each carrier; infinite where there is none.
    """
    lower, upper = min(low for low, _ in limits), max(high for _, high in limits)
    least, most = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    shown = [edge for edge, value in ((lower, least), (upper, most)) if _is_visible(edge, value)]
    edges = [least, most, *shown]
    room = (_HEADROOM - 1.0) * ((max(edges) - min(edges)) or 1.0)
    bottom, top = min(edges) - room, max(edges) + room
    common = len(set(limits)) == 1
    for edge, far in ((lower, bottom), (upper, top)):
        if edge in shown and common:
            band = axes.axhspan(min(edge, far), max(edge, far), facecolor="none", edgecolor=_FORBIDDEN, linewidth=0)
            band.set(hatch="/////", zorder=0.4)
            axes.axhline(edge, color="#000000", linewidth=0.8, zorder=1.5)
    if not common:
        for i, pair in enumerate(limits):
            for edge in filter(np.isfinite, pair):
                axes.axhline(edge, color=STROKES[i % len(STROKES)].color, linewidth=0.8, zorder=1.5)
    axes.set_ylim(bottom, top)
    if common and not shown and np.isfinite([lower, upper]).any():
        text = f"limits ±{upper:g}" if lower == -upper else f"limits {lower:g}, {upper:g}"
        axes.text(0.985, 0.95, text, transform=axes.transAxes, ha="right", va="top", fontsize=7.5, color="#444444")


def mark_broken(axes: Axes, plan: Plan, quantity: str) -> None:
    """Mark the worst instant of each broken limit of a quantity, and write by how much it is exceeded."""
    for event in plan.limits.violated:
        if event.quantity != quantity:
            continue
        axes.plot(
            event.worst,
            event.value,
            linestyle="none",
            marker="X",
            markersize=6.5,
            markerfacecolor="#FFFFFF",
            markeredgecolor="#000000",
            markeredgewidth=1.0,
            zorder=3.0,
            clip_on=False,
        )
        axes.annotate(
            _excess(event),
            (event.worst, event.value),
            xytext=(6, -1),
            textcoords="offset points",
            fontsize=7.5,
            va="center",
            zorder=3.0,
            bbox={"facecolor": "#FFFFFF", "edgecolor": "none", "alpha": 0.8, "pad": 0.6},
        )


def fit_to(axes: Axes, values: Array, where: BoolArray) -> None:
    """Fit the axis to the values (N, m) of some samples; others may leave the picture."""
    chosen = values[where & np.isfinite(values).all(axis=1)]
    least, most = float(chosen.min(initial=0.0)), float(chosen.max(initial=0.0))
    room = (_HEADROOM - 1.0) * ((most - least) or 1.0)
    axes.set_ylim(least - room, most + room)


def _excess(event: LimitEvent) -> str:
    return f"{event.amount:.2g} beyond"


def _is_visible(edge: float, value: float) -> bool:
    return bool(np.isfinite(edge)) and abs(value) >= _VISIBLE_FRACTION * abs(edge)


def _fill(phase: int) -> str:
    return _PHASE_FILLS[phase % len(_PHASE_FILLS)]
