"""Panels over a common time axis: how all curves over time are drawn.

A figure is a list of panels, a panel a list of curves; time axis, legends, limits, phases and singular instants are
the same in all of them. To add one, write a function like this one in ``plots.py``, with ``Panel`` and ``series``
imported from here, and name it in its ``__all__``:

    def power(subject: Plan) -> Figure:
        \"\"\"Draw the power of the main actuators over time.\"\"\"
        panel = Panel("power [W]", series(subject.robot.actuated, subject.t, subject.tau * subject.actuated_rate))
        return plot_time_panels(f"{subject.robot.name}: power", [panel], subject)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, runs
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.result import Simulation
from redundancy_pin.visualisation.figures.curves import Curves, curves_of
from redundancy_pin.visualisation.figures.style import (
    BEYOND,
    INSTANT,
    STROKES,
    WINDOW,
    WITHOUT_EFFORTS,
    Stroke,
    brief,
    figure,
    legend_above,
    legend_below,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_CONDITION_TOP = 1e3  # largest condition number of the axis: at a singular instant it is infinite
_CONDITION_LINEAR = 10.0  # up to this condition number the axis is linear
_HEADROOM = 0.08  # free space above and below the shown values, as a fraction of their range
_VISIBLE_FRACTION = 0.35  # A limit is drawn if the curves use at least this fraction of it; else it would flatten them
_FAR = 100.0  # A limit is written if it is at most this many times the largest value
# Greys of the phases, in the order of their names; neighbours differ enough in print
_PHASE_FILLS = ("#FFFFFF", "#E4E4E4", "#C4C4C4", "#F1F1F1", "#D4D4D4", "#B4B4B4")
_BOX: dict[str, Any] = {"facecolor": "#FFFFFF", "edgecolor": "none", "alpha": 0.8, "pad": 0.6}


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve."""

    label: str  # in the legend; none for an empty one
    t: Array  # (N,) time, s
    value: Array  # (N,) in the unit of the panel; not drawn where it is not finite
    stroke: Stroke = field(default_factory=lambda: STROKES[0])
    fitted: BoolArray | None = None  # (N,) samples that the axis shows in any case; None: all


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves that share an axis.

    ``limits`` are the smallest and largest admissible value, (2,) of all curves or (c, 2) of each, infinite for no
    limit: drawn, and hatched beyond, if the curves come near to them; otherwise written in the corner.
    """

    label: str  # of the axis, with its unit
    curves: tuple[Curve, ...]
    levels: Mapping[str, float] = field(default_factory=dict)  # horizontal lines by the label in the legend
    limits: ArrayLike = ()
    log: bool = False  # whether the axis is logarithmic; needs ``within``
    height: float = 1.0  # relative
    within: tuple[float, float] | None = None  # ends of the axis; None: fitted to curves and limits
    marks: tuple[tuple[float, float, str], ...] = ()  # (t, value, text), such as where a limit is exceeded most
    title: str = ""
    legend: bool = True  # without one, its curves are named under the figure, unless another panel names them
    shared: bool = False  # whether all panels of its row have the same scale


def series(names: Sequence[str], t: Array, values: Array, strokes: Sequence[Stroke] = STROKES) -> tuple[Curve, ...]:
    """Return a curve for each column of ``values`` (N, m)."""
    return tuple(Curve(name, t, values[:, i], strokes[i % len(strokes)]) for i, name in enumerate(names))


def condition_panel(drawn: Curves) -> Panel:
    """Return a panel of the condition number: linear if it is small, cut at 1000, infinite or NaN where singular."""
    singular = bool(drawn.instants)
    shown = np.minimum(np.nan_to_num(drawn.condition, nan=np.inf), 10.0 * _CONDITION_TOP)
    top = max([float(shown.max()), *(2.0 * threshold for threshold in drawn.thresholds)])
    log = singular or top > _CONDITION_LINEAR
    end = min(_CONDITION_TOP, 1.5 * top) if log else 1.0 + 1.2 * max(top - 1.0, 0.1)
    curve = Curve("", drawn.t, shown, STROKES[0] | {"color": "#000000"})
    levels = {f"threshold {threshold:g}": threshold for threshold in drawn.thresholds}
    within = (1.0, _CONDITION_TOP if singular else end)
    return Panel("condition number of W [–]", (curve,), levels, log=log, within=within)


def plot_time_panels(title: str, panels: Sequence[Panel], behind: Plan | Simulation | Curves | None = None) -> Figure:
    """Draw panels one above the other, with phases, intervals and singular instants of a motion behind them."""
    return plot_panel_grid(title, [panels], behind)


def plot_panel_grid(
    title: str,
    columns: Sequence[Sequence[Panel]],
    behind: Plan | Simulation | Curves | None = None,
    *,
    size: tuple[float, float] | None = None,
    shaded: bool = True,
) -> Figure:
    """Draw columns of panels, all of the same heights, in a figure of some width and height, inches; None fits."""
    heights = [panel.height for panel in columns[0]]
    size = size or (9.6 if len(columns) > 1 else 7.2, 1.1 + 1.75 * sum(heights))
    with figure(*size, title) as drawn:
        axes = drawn.subplots(len(heights), len(columns), sharex=True, height_ratios=heights, squeeze=False)
        for beside, row in zip(axes, zip(*columns, strict=True), strict=True):
            for i, (axis, panel) in enumerate(zip(beside, row, strict=True)):
                draw_panel(axis, panel, size[0] / len(columns) - 0.8, alike=row if panel.shared else (panel,))
                if behind is not None:
                    draw_background(axis, curves_of(behind), shaded=shaded)
                axis.tick_params(labelleft=not (panel.shared and i))
        times = [curve.t for column in columns for panel in column for curve in panel.curves]
        label_time(axes[-1], min(float(t[0]) for t in times), max(float(t[-1]) for t in times))
        for column in axes.T:
            drawn.align_ylabels(column)
        legend_below(drawn)
        return drawn


def label_time(row: Sequence[Axes], first: float, last: float) -> None:
    """Label axes over time, s, with their ends."""
    for axes in row:
        axes.set(xlabel="time t [s]", xlim=(first, last) if last > first else None)


def draw_background(axes: Axes, behind: Curves, *, shaded: bool = True) -> None:
    """Draw singular instants and, if ``shaded``, phases or near-singular intervals, and intervals without efforts."""
    for instant in behind.instants:
        axes.axvline(instant, zorder=1.6, **INSTANT)
    if not shaded:
        return
    names = [*dict.fromkeys(name for name, _, _ in behind.phases)]
    for name, start, end in behind.phases:
        fill = _PHASE_FILLS[names.index(name) % len(_PHASE_FILLS)]
        # the line round it is a hairline between phases, and shows a white one in the legend
        axes.axvspan(start, end, facecolor=fill, edgecolor="#777777", linewidth=0.5, zorder=0.2, label=name)
    windows = () if behind.phases else behind.windows
    for spans, style, order in ((windows, WINDOW, 0.5), (behind.without_efforts, WITHOUT_EFFORTS, 0.55)):
        for start, end in spans:
            axes.axvspan(start, end, zorder=order, **style)


def draw_panel(axes: Axes, panel: Panel, width: float, *, alike: Sequence[Panel] = ()) -> None:
    """Draw one panel, ``width`` inches wide; ``alike`` are panels with its scale, itself among them."""
    for curve in panel.curves:
        alone = [start for start, stop in runs(np.isfinite(curve.value)) if stop - start == 1]
        marked = {"markersize": 4.0, "markevery": alone} if alone else {"marker": ""}  # no line shows such a sample
        axes.plot(curve.t, curve.value, label=brief(curve.label), **{"zorder": 2.2, **curve.stroke, **marked})
    for i, (name, level) in enumerate(panel.levels.items()):
        stroke = STROKES[1 + i % (len(STROKES) - 1)] | {"marker": ""}
        axes.axhline(level, linewidth=1.1, zorder=1.9, label=name, **stroke)
    for t, value, text in panel.marks:
        axes.plot(t, value, linestyle="none", marker="X", markersize=6.5, markerfacecolor="#FFFFFF",
                  markeredgecolor="#000000", zorder=3.0, clip_on=False)  # fmt: skip
        axes.annotate(text, (t, value), xytext=(6, -1), textcoords="offset points", fontsize=7.5, va="center",
                      zorder=3.0, bbox=_BOX)  # fmt: skip
    axes.set_ylabel(brief(panel.label))
    axes.set_title(panel.title, fontsize=8.5)
    if panel.legend:
        legend_above(axes, width)
    if panel.log:
        _set_log_scale(axes)
    if panel.within is not None:
        axes.set_ylim(panel.within)
    elif not panel.curves:
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color="#6E6E6E")
    else:
        _fit(axes, panel, alike or (panel,))


def fitted_range(curves: Sequence[Curve], edges: Sequence[float] = ()) -> tuple[float, float]:
    """Return the ends of an axis that shows zero, curves, limits that are ``edges``, and some space about them."""
    low, high = _extent(curves)
    low, high = min([low, *edges]), max([high, *edges])
    space = _HEADROOM * ((high - low) or 1.0)
    return low - space, high + space


def _extent(curves: Sequence[Curve]) -> tuple[float, float]:
    """Return the smallest and the largest value to which an axis is fitted, zero among them."""
    counted = [curve.value if curve.fitted is None else curve.value[curve.fitted] for curve in curves]
    values = np.concatenate([part[np.isfinite(part)] for part in counted])
    return float(values.min(initial=0.0)), float(values.max(initial=0.0))


def _fit(axes: Axes, panel: Panel, alike: Sequence[Panel]) -> None:
    """Scale the axis to the curves of panels alike and to limits in reach, and draw the limits of the panel."""
    curves = [curve for other in alike for curve in other.curves]
    extent = np.array(_extent(curves))

    def in_reach(limits: ArrayLike) -> Array:  # (c, 2); NaN where a limit is so far that it would flatten the curves
        pairs = np.reshape(limits, (-1, 2)).astype(float)
        return np.where(np.abs(extent) >= _VISIBLE_FRACTION * np.abs(pairs), pairs, np.nan)

    edges = np.concatenate([in_reach(other.limits).ravel() for other in alike])
    axes.set_ylim(fitted_range(curves, edges[np.isfinite(edges)].tolist()))
    shown, limits = in_reach(panel.limits), np.reshape(panel.limits, (-1, 2))
    used, least = np.abs(extent).max(), np.abs(limits[np.isfinite(limits)]).min(initial=np.inf)
    near = np.isfinite(least) and (used == 0.0 or least <= _FAR * used)
    if len(limits) and (limits == limits[0]).all() and np.isnan(shown).all() and near:
        low, high = limits[0]
        one_sided = f"limit ≤ {high:g}" if np.isinf(low) else f"limit ≥ {low:g}" if np.isinf(high) else ""
        text = one_sided or (f"limits ±{high:g}" if low == -high else f"limits {low:g}, {high:g}")
        axes.text(0.985, 0.95, text, transform=axes.transAxes, ha="right", va="top", fontsize=7.5, color="#444444")
    names = [brief(curve.label) for curve in panel.curves[-len(limits) :]]  # curves to compare with come first
    for side, end, outermost in zip(shown.T, axes.get_ylim(), (np.min, np.max), strict=True):
        for edge in np.unique(side[np.isfinite(side)]):
            axes.axhline(edge, color="#000000", linewidth=0.8, zorder=1.5)
            if not (side == edge).all():
                text = f"limit of {', '.join(names[i] for i in np.flatnonzero(side == edge).tolist())}"
                axes.text(0.985, edge, text, transform=axes.get_yaxis_transform(), ha="right", va="center",
                          fontsize=7.0, zorder=1.6, bbox=_BOX)  # fmt: skip
        if len(side) and np.isfinite(side).all():  # inadmissible for every curve
            axes.axhspan(*sorted((float(outermost(side)), end)), zorder=0.4, **BEYOND)


def _set_log_scale(axes: Axes) -> None:
    """Make the vertical axis logarithmic, with plain numbers: 20 in place of 2×10¹."""
    from matplotlib.ticker import LogFormatter

    axes.set_yscale("log")
    # decades on the axis below which some, and below which all numbers between powers of ten are written
    for set_formatter in (axes.yaxis.set_major_formatter, axes.yaxis.set_minor_formatter):
        set_formatter(LogFormatter(minor_thresholds=(2.0, 0.6)))
