"""Parts of the picture of a plan: shaded phases, a band of what a carrier may do, marks where a limit is broken."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.plan import Plan
from redundancy_pin.visualisation.style import STROKES, Stroke, hatch_beyond

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes

_PHASE_FILLS = ("#FFFFFF", "#E4E4E4", "#C4C4C4", "#F1F1F1", "#D4D4D4", "#B4B4B4")
"""Greys of the phases, in the order of their names; neighbours differ enough to be told apart in print."""

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


def draw_series(axes: Axes, t: Array, values: Array, names: Sequence[str], strokes: Sequence[Stroke] = STROKES) -> None:
    """Draw one line for each column of ``values`` (N, m), in the strokes of main actuators or of carriers."""
    for i, name in enumerate(names):
        stroke = strokes[i % len(strokes)]
        axes.plot(t, values[:, i], color=stroke.color, linestyle=stroke.dash, label=name, zorder=2.0)


def draw_limits(axes: Axes, values: Array, limits: Sequence[tuple[float, float]], *, label: str | None = None) -> None:
    """Draw the limits of the carriers, hatch what none of them may do, and fit the axis to it and to the values.

    Where the carriers' limits differ, each line says whose it is. Limits far beyond the values are not drawn, as they
    would flatten the curves; if all are, and all carriers share them, they are said in the corner.

    Args:
        axes: the axes.
        values: (N, k) what is drawn.
        limits: lower and upper limit of each carrier; infinite where there is none.
        label: what a legend calls the hatched parts; None leaves them out of it.
    """
    least, most = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    lower = [low if _is_visible(low, least) else None for low, _ in limits]
    upper = [high if _is_visible(high, most) else None for _, high in limits]
    edges = [least, most, *(edge for edge in (*lower, *upper) if edge is not None)]
    room = (_HEADROOM - 1.0) * ((max(edges) - min(edges)) or 1.0)
    bottom, top = min(edges) - room, max(edges) + room
    for side, far, outermost in ((lower, bottom, min), (upper, top, max)):
        drawn = {edge for edge in side if edge is not None}
        for edge in sorted(drawn):
            axes.axhline(edge, color="#000000", linewidth=0.8, zorder=1.5)
            whose = [i + 1 for i, other in enumerate(side) if other == edge]
            if len(whose) < len(limits):
                _say_whose(axes, edge, whose)
        if drawn and None not in side:
            edge = outermost(drawn)
            hatch_beyond(axes, edge, far, label=label)
            label = None
    axes.set_ylim(bottom, top)
    if len(set(limits)) == 1 and not {*lower, *upper} - {None} and np.isfinite(limits[0]).any():
        low, high = limits[0]
        text = f"limits ±{high:g}" if low == -high else f"limits {low:g}, {high:g}"
        axes.text(0.985, 0.95, text, transform=axes.transAxes, ha="right", va="top", fontsize=7.5, color="#444444")


def _say_whose(axes: Axes, edge: float, whose: Sequence[int]) -> None:
    text = f"limit of {', '.join(str(number) for number in whose)}"
    box = {"facecolor": "#FFFFFF", "edgecolor": "none", "alpha": 0.8, "pad": 0.6}
    place = axes.get_yaxis_transform()
    axes.text(0.985, edge, text, transform=place, ha="right", va="center", fontsize=7.0, zorder=1.6, bbox=box)


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
