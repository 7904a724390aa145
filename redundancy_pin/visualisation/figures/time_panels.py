"""Curves over time in panels one above the other: the form of most figures of the thesis."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.planners.plan import Plan
from redundancy_pin.visualisation.figures.plan import phase_handles, shade_phases
from redundancy_pin.visualisation.figures.style import (
    BEYOND,
    CARRIER_STROKES,
    STROKES,
    figure,
    hatch_beyond,
    instant_handle,
    legend_above,
    mark_instants,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_CONDITION_TOP = 1e3
_HEADROOM = 0.08


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve.

    Attributes:
        label: in the legend.
        t: (N,) time, s.
        value: (N,) what is drawn; not drawn where it is not finite.
        stroke: which of the common strokes.
        reference: whether it is what others are compared with: thin and grey.
        carrier: whether it is one of the carriers', which have strokes of their own.
    """

    label: str
    t: Array
    value: Array
    stroke: int = 0
    reference: bool = False
    carrier: bool = False


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves that share an axis.

    Attributes:
        label: of the axis, with its unit.
        curves: what is drawn.
        levels: horizontal lines, by what the legend says of them.
        limits: largest and smallest admissible value, drawn and hatched beyond where the axis shows them; may be empty.
        log: whether the axis is logarithmic, for condition numbers: from 1 to 1000.
        height: relative.
    """

    label: str
    curves: tuple[Curve, ...]
    levels: tuple[tuple[float, str], ...] = ()
    limits: tuple[float, ...] = ()
    log: bool = False
    height: float = 1.0


def plot_time_panels(
    title: str, panels: Sequence[Panel], *, plan: Plan | None = None, instants: Sequence[float] = ()
) -> Figure:
    """Draw panels over a common time axis.

    Args:
        title: of the figure.
        panels: from top to bottom.
        plan: whose phases are shaded; none where left out.
        instants: singular instants, s, drawn as dotted lines.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    heights = [panel.height for panel in panels]
    with figure(7.2, 1.1 + 1.75 * sum(heights)) as drawn:
        axes = list(drawn.subplots(len(panels), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0])
        drawn.suptitle(title, fontsize=10.5)
        for axis, panel in zip(axes, panels, strict=True):
            _draw(axis, panel)
            if plan is not None:
                shade_phases(axis, plan)
            mark_instants(axis, instants)
        times = [curve.t for panel in panels for curve in panel.curves]
        axes[-1].set_xlim(min(float(t[0]) for t in times), max(float(t[-1]) for t in times))
        axes[-1].set_xlabel("time t [s]")
        drawn.align_ylabels(axes)
        handles = _handles(plan, bool(instants))
        if handles:
            drawn.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)
        return drawn


def _draw(axes: Axes, panel: Panel) -> None:
    for curve in panel.curves:
        strokes = CARRIER_STROKES if curve.carrier else STROKES
        stroke = strokes[curve.stroke % len(strokes)]
        style: dict[str, Any] = {"color": stroke.color, "linestyle": stroke.dash, "zorder": 2.2}
        if panel.log:
            style["color"] = "#000000"  # of condition numbers, as in other figures
        if curve.reference:
            style = {"color": "#6E6E6E", "linestyle": "-", "linewidth": 1.0, "zorder": 2.0}
        value = np.minimum(curve.value, 10.0 * _CONDITION_TOP) if panel.log else curve.value
        axes.plot(curve.t, value, label=curve.label, **style)
    for i, (level, name) in enumerate(panel.levels):
        stroke = STROKES[1 + i % (len(STROKES) - 1)]
        axes.axhline(level, color=stroke.color, linestyle=stroke.dash, linewidth=1.1, zorder=1.9, label=name)
    if panel.log:
        axes.set_yscale("log")
        axes.set_ylim(1.0, _CONDITION_TOP)
    else:
        _fit(axes, panel)
    axes.set_ylabel(panel.label)
    legend_above(axes, max(3, len(panel.curves) + len(panel.levels)))


def _fit(axes: Axes, panel: Panel) -> None:
    """Fit the axis to the curves, and to the limits that they come near to."""
    values = np.concatenate([curve.value[np.isfinite(curve.value)] for curve in panel.curves])
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    shown = [limit for limit in panel.limits if 0.5 * abs(limit) <= (high if limit > 0 else -low)]
    low, high = min([low, *shown]), max([high, *shown])
    room = _HEADROOM * ((high - low) or 1.0)
    for i, limit in enumerate(shown):
        axes.axhline(limit, color="#000000", linewidth=0.9, linestyle=(0, (6, 2)), zorder=1.8)
        hatch_beyond(axes, limit, high + room if limit > 0.0 else low - room, label=None if i else BEYOND)
    axes.set_ylim(low - room, high + room)


def _handles(plan: Plan | None, with_instants: bool) -> list[Any]:
    handles: list[Any] = phase_handles(plan) if plan is not None and len(plan.phases) > 1 else []
    if with_instants:
        handles.append(instant_handle())
    return handles
