"""Panels over a common time axis: how all curves over time are drawn.

A figure is a list of panels, a panel a list of curves; time axis, legends, limits, phases and singular instants are
the same in all of them. To add one, write a function like this one in ``plots.py``, with ``Panel`` and ``series``
imported from here, and name it in its ``__all__``:

    def power(subject: Plan) -> Figure:
        \"\"\"Draw the power of the main actuators over time.\"\"\"
        panel = Panel("power [W]", series(subject.robot.actuated, subject.t, subject.tau * subject.actuated_rate))
        return plot_time_panels(curves_of_plan(subject).title, [panel], plan=subject)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, runs, stretches
from redundancy_pin.planners.plan import Plan
from redundancy_pin.visualisation.figures.curves import Curves
from redundancy_pin.visualisation.figures.style import (
    BEYOND,
    CARRIER_STROKES,
    INSTANT,
    STROKES,
    WINDOW,
    WITHOUT_EFFORTS,
    brief,
    figure,
    legend_above,
    legend_below,
    legend_label,
    log_scale,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Windows = Sequence[tuple[float, float]]
"""First and last time of each of several intervals, s."""

_CONDITION_TOP = 1e3  # largest condition number of the axis: at a singular instant it is infinite
_CONDITION_LINEAR = 10.0  # up to this condition number the axis is linear
_HEADROOM = 0.08  # free space above and below what an axis shows, as a fraction of it
_VISIBLE_FRACTION = 0.35  # A limit is drawn if the curves use at least this fraction of it; else it would flatten them
_FAR = 100.0  # A limit is written if it is at most this many times what the curves use; else it says nothing
# Greys of the phases, in the order of their names; neighbours differ enough to be told apart in print
_PHASE_FILLS = ("#FFFFFF", "#E4E4E4", "#C4C4C4", "#F1F1F1", "#D4D4D4", "#B4B4B4")
_BOX: dict[str, Any] = {"facecolor": "#FFFFFF", "edgecolor": "none", "alpha": 0.8, "pad": 0.6}


@dataclass(frozen=True, eq=False)
class Curve:
    """One curve."""

    label: str  # in the legend; empty leaves it out
    t: Array  # (N,) time, s
    value: Array  # (N,) what is drawn; not drawn where it is not finite
    stroke: int = 0  # which of the common strokes
    reference: bool = False  # whether others are compared with it: thin and grey
    carrier: bool = False  # whether it is one of the carriers', which have strokes of their own
    fitted: BoolArray | None = None  # (N,) samples to which the axis is fitted, others may leave the picture; None: all
    style: Mapping[str, Any] = field(default_factory=dict)  # keywords of matplotlib's ``plot``, before all others


@dataclass(frozen=True, eq=False)
class Panel:
    """Curves that share an axis.

    ``limits`` are the smallest and largest admissible value, (2,) of all curves or (c, 2) of each, infinite for no
    limit: drawn, and hatched beyond, if the curves come near to them; otherwise written in the corner.
    """

    label: str  # of the axis, with its unit
    curves: tuple[Curve, ...]
    levels: tuple[tuple[float, str], ...] = ()  # horizontal lines, with what the legend says of them
    limits: ArrayLike = ()
    log: bool = False  # whether the axis is logarithmic, from 1 to 1000 without ``within``
    height: float = 1.0  # relative
    within: tuple[float, float] | None = None  # ends of the axis; None: fitted to curves and limits
    marks: tuple[tuple[float, float, str], ...] = ()  # (t, value, text), such as where a limit is exceeded most
    title: str = ""
    legend: bool = True  # without one, its curves are named under the figure, unless another panel names them
    shared: bool = False  # whether panels beside it have the same scale


@dataclass(frozen=True, eq=False)
class Background:
    """What all panels of a figure have behind their curves."""

    plan: Plan | None = None  # whose phases are shaded
    instants: Sequence[float] = ()  # singular instants, s, drawn as dotted lines
    windows: Windows = ()  # near-singular intervals, shaded
    without_efforts: Windows = ()  # hatched

    def draw(self, axes: Axes) -> None:
        """Draw it behind a panel, labelled for the legend under the figure."""
        spans = phase_spans(self.plan) if self.plan is not None else []
        for i, (phase, start, end) in enumerate(spans):
            name = self.plan.phases[phase].replace("_", " ") if self.plan and len(self.plan.phases) > 1 else None
            fill = _PHASE_FILLS[phase % len(_PHASE_FILLS)]
            axes.axvspan(start, end, facecolor=fill, edgecolor="#777777", linewidth=0, zorder=0.2, label=name)
            if i:
                axes.axvline(start, color="#777777", linewidth=0.5, zorder=0.6)
        for shaded, style, order in ((self.windows, WINDOW, 0.5), (self.without_efforts, WITHOUT_EFFORTS, 0.55)):
            for start, end in shaded:
                axes.axvspan(start, end, zorder=order, **style)
        for instant in self.instants:
            axes.axvline(instant, zorder=1.6, **INSTANT)


def background_of(drawn: Curves, plan: Plan | None = None) -> Background:
    """Return singular instants, near-singular intervals and those without efforts, and the phases of a plan."""
    return Background(plan, drawn.instants, drawn.windows, drawn.without_efforts)


def phase_spans(plan: Plan) -> list[tuple[int, float, float]]:
    """Return (phase, start, end), s, of each stretch of a plan in one phase; each ends where the next one starts."""
    t, last = plan.t, len(plan.t) - 1
    return [(int(plan.phase[a]), float(t[a]), float(t[min(b, last)])) for a, b in stretches(plan.phase)]


def series(names: Sequence[str], t: Array, values: Array, **settings: Any) -> tuple[Curve, ...]:
    """Return a curve for each column of ``values`` (N, m); ``settings`` as of ``Curve``."""
    return tuple(Curve(name, t, values[:, i], i, **settings) for i, name in enumerate(names))


def condition_panel(t: Array, condition: Array, thresholds: Sequence[float] = (), *, singular: bool = False) -> Panel:
    """Return a panel of a condition number (N,): linear if it is small, and cut at 1000.

    With ``singular`` the motion meets a singularity, and the condition number is infinite or NaN there.
    """
    shown = np.minimum(np.nan_to_num(condition, nan=np.inf), 10.0 * _CONDITION_TOP)
    top = max([float(shown.max()), *(2.0 * threshold for threshold in thresholds)])
    log = singular or top > _CONDITION_LINEAR
    end = min(_CONDITION_TOP, 1.5 * top) if log else 1.0 + 1.2 * max(top - 1.0, 0.1)
    curve = Curve("", t, shown, style={"color": "#000000"})
    levels = tuple((threshold, f"threshold {threshold:g}") for threshold in thresholds)
    within = (1.0, _CONDITION_TOP if singular else end)
    return Panel("condition number of W [–]", (curve,), levels, log=log, within=within)


def plot_time_panels(
    title: str, panels: Sequence[Panel], *, plan: Plan | None = None, instants: Sequence[float] = ()
) -> Figure:
    """Draw panels one above the other, with the phases of a ``plan`` and singular ``instants``, s, behind them."""
    return plot_panel_grid(title, [panels], None, Background(plan, instants))


def plot_panel_grid(
    title: str, columns: Sequence[Sequence[Panel]], size: tuple[float, float] | None, background: Background
) -> Figure:
    """Draw columns of panels, all of the same heights, in a figure of some width and height, inches; None fits."""
    if size is None:
        size = (9.6 if len(columns) > 1 else 7.2), 1.1 + 1.75 * sum(panel.height for panel in columns[0])
    with figure(*size, title) as drawn:
        heights = [panel.height for panel in columns[0]]
        axes = drawn.subplots(len(heights), len(columns), sharex=True, height_ratios=heights, squeeze=False)
        for beside, row in zip(axes, zip(*columns, strict=True), strict=True):
            for i, (axis, panel) in enumerate(zip(beside, row, strict=True)):
                alike = row if panel.shared else (panel,)
                draw_panel(axis, panel, size[0] / len(columns) - 0.8, alike=alike)
                background.draw(axis)
                axis.tick_params(labelleft=not (panel.shared and i))
        times = [curve.t for column in columns for panel in column for curve in panel.curves]
        first, last = min(float(t[0]) for t in times), max(float(t[-1]) for t in times)
        if last > first:
            axes[0, 0].set_xlim(first, last)
        for axis in axes[-1]:
            axis.set_xlabel("time t [s]")
        for column in axes.T:
            drawn.align_ylabels(column)
        legend_below(drawn)
        return drawn


def draw_panel(axes: Axes, panel: Panel, width: float, *, alike: Sequence[Panel] = ()) -> None:
    """Draw one panel, ``width`` inches wide; ``alike`` are panels with its scale, itself among them."""
    for curve in panel.curves:
        strokes = CARRIER_STROKES if curve.carrier else STROKES
        stroke = strokes[curve.stroke % len(strokes)]
        style: dict[str, Any] = {"color": stroke.color, "linestyle": stroke.dash, "zorder": 2.2}
        if curve.reference:
            style = {"color": "#6E6E6E", "linestyle": "-", "linewidth": 1.0, "zorder": 2.0}
        single = _single_samples(curve.value)
        if single:
            style |= {"marker": stroke.marker, "markersize": 4.0, "markevery": single}
        axes.plot(curve.t, curve.value, label=legend_label(curve.label), **{**style, **curve.style})
    for i, (level, name) in enumerate(panel.levels):
        stroke = STROKES[1 + i % (len(STROKES) - 1)]
        axes.axhline(level, color=stroke.color, linestyle=stroke.dash, linewidth=1.1, zorder=1.9, label=name)
    for t, value, text in panel.marks:
        axes.plot(t, value, linestyle="none", marker="X", markersize=6.5, markerfacecolor="#FFFFFF",
                  markeredgecolor="#000000", zorder=3.0, clip_on=False)  # fmt: skip
        axes.annotate(text, (t, value), xytext=(6, -1), textcoords="offset points", fontsize=7.5, va="center",
                      zorder=3.0, bbox=_BOX)  # fmt: skip
    axes.set_ylabel(panel.label)
    axes.set_title(panel.title, fontsize=8.5)
    if panel.legend:
        legend_above(axes, width)
    if panel.log:
        log_scale(axes)
    if panel.log or panel.within is not None:
        axes.set_ylim(panel.within or (1.0, _CONDITION_TOP))
    elif panel.curves:
        _fit(axes, panel, alike or (panel,))
    else:
        axes.text(0.5, 0.5, "none", transform=axes.transAxes, ha="center", va="center", color="#6E6E6E")


def _single_samples(value: Array) -> list[int]:
    """Return the samples of (N,) that no line shows, because both neighbours are absent or not finite."""
    return [start for start, stop in runs(np.isfinite(value)) if stop - start == 1]


def fitted_range(curves: Sequence[Curve], edges: Sequence[float] = ()) -> tuple[float, float]:
    """Return the ends of an axis that shows zero, curves, limits that are ``edges``, and some space about them."""
    low, high = _extent(curves)
    low, high = min([low, *edges]), max([high, *edges])
    room = _HEADROOM * ((high - low) or 1.0)
    return low - room, high + room


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
    used = np.abs(extent).max()
    least = np.abs(limits[np.isfinite(limits)]).min(initial=np.inf)
    near = np.isfinite(least) and (used == 0.0 or least <= _FAR * used)
    if len(limits) and (limits == limits[0]).all() and np.isnan(shown).all() and near:
        low, high = limits[0]
        one_sided = f"limit ≤ {high:g}" if np.isinf(low) else f"limit ≥ {low:g}" if np.isinf(high) else ""
        text = one_sided or (f"limits ±{high:g}" if low == -high else f"limits {low:g}, {high:g}")
        axes.text(0.985, 0.95, text, transform=axes.transAxes, ha="right", va="top", fontsize=7.5, color="#444444")
    names = [brief(curve.label) for curve in panel.curves if not curve.reference]
    for side, end, outermost in zip(shown.T, axes.get_ylim(), (np.min, np.max), strict=True):
        for edge in np.unique(side[np.isfinite(side)]):
            axes.axhline(edge, color="#000000", linewidth=0.8, zorder=1.5)
            if not (side == edge).all():
                text = f"limit of {', '.join(names[i] for i in np.flatnonzero(side == edge).tolist())}"
                axes.text(0.985, edge, text, transform=axes.get_yaxis_transform(), ha="right", va="center",
                          fontsize=7.0, zorder=1.6, bbox=_BOX)  # fmt: skip
        if len(side) and np.isfinite(side).all():  # what no curve may do
            axes.axhspan(*sorted((float(outermost(side)), end)), zorder=0.4, **BEYOND)
