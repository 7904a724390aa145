"""Figures of the report that sum up many plans: bars, largest speeds, trade-off curves, tracking errors."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.visualisation.figures.style import STROKES, figure, legend_above, legend_below, log_scale
from redundancy_pin.visualisation.figures.time_panels import Curve, Panel, plot_time_panels

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_HATCHES = ("", "///", "...", "xxx", "---", "\\\\\\")  # so that bars can be told apart without colour


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
    """
    width = max(8.0, 1.6 + 0.9 * len(groups))
    with figure(width, 3.6, title) as drawn:
        axes = drawn.subplots()
        bar, places = 0.8 / len(series), np.arange(len(groups))
        smallest = min(float(np.nanmin(values)) for values in series.values())
        for i, (name, values) in enumerate(series.items()):
            at = places + (i - 0.5 * (len(series) - 1)) * bar
            color, hatch = STROKES[i % len(STROKES)].color, _HATCHES[i % len(_HATCHES)]
            axes.bar(at, np.nan_to_num(values), bar, color=color, hatch=hatch, edgecolor="white", linewidth=0.4,
                     label=name)  # fmt: skip
            for x in at[np.isnan(values)]:
                axes.text(x, smallest, "none", rotation=90, ha="center", va="bottom", fontsize=7)
        log_scale(axes)
        axes.set_ylim(bottom=0.7 * smallest)
        axes.set_xticks(places, groups)
        axes.set(xlabel=groups_label, ylabel=label)
        legend_above(axes, width - 0.8)
        return drawn


@dataclass(frozen=True, eq=False)
class Attempts:
    """Speeds tried for one motion.

    Attributes:
        label: in the legend.
        feasible: (P, 2) speed, m/s, ascending, and largest effort, N, of those with a plan.
        infeasible: (Q,) speeds without one, m/s.
    """

    label: str
    feasible: Array
    infeasible: Array


def plot_speed_border(title: str, attempts: Sequence[Attempts]) -> Figure:
    """Draw effort over speed, logarithmic, with crosses on the lower edge where there is no plan.

    Args:
        title: of the figure.
        attempts: one curve each.
    """
    with figure(7.0, 4.6, title) as drawn:
        axes = drawn.subplots()
        for stroke, tried in zip(STROKES, attempts, strict=False):
            axes.plot(*tried.feasible.T, color=stroke.color, linestyle=stroke.dash, marker=stroke.marker, markersize=4,
                      label=tried.label)  # fmt: skip
            axes.plot(tried.infeasible, [0.02] * len(tried.infeasible), "x", color=stroke.color, clip_on=False,
                      transform=axes.get_xaxis_transform())  # fmt: skip
        log_scale(axes)
        axes.set(xlabel="cruising speed [m/s] (crosses: no plan)", ylabel="largest main force [N]")
        legend_above(axes, 6.2)
        return drawn


_LETTERS = 42  # of a line of a panel's title


@dataclass(frozen=True, eq=False)
class TradeCurve:
    """One motion.

    Attributes:
        title: of its panel.
        unit: of the effort.
        points: (P, 2) root mean squares of acceleration, m/s², and effort, along the curve.
        marks: the same of other plans, by name.
    """

    title: str
    unit: str
    points: Array
    marks: Mapping[str, tuple[float, float]]


def plot_trade_off(title: str, curves: Sequence[TradeCurve]) -> Figure:
    """Draw each curve in a panel of its own, with other plans as marks.

    Args:
        title: of the figure.
        curves: one panel each.
    """
    with figure(3.8 * len(curves), 3.8, title) as drawn:
        panels = drawn.subplots(1, len(curves), squeeze=False)[0]
        names = list(dict.fromkeys(name for curve in curves for name in curve.marks))
        for panel, curve in zip(panels, curves, strict=True):
            panel.plot(curve.points[:, 0], curve.points[:, 1], color=STROKES[0].color, marker="o", markersize=4,
                       label="whole trajectory, one point a weight")  # fmt: skip
            for name, (acceleration, effort) in curve.marks.items():
                stroke = STROKES[1 + names.index(name)]
                panel.plot([acceleration], [effort], linestyle="none", marker=stroke.marker, color=stroke.color,
                           markersize=7, label=name)  # fmt: skip
            log_scale(panel)
            panel.set_title(textwrap.fill(curve.title, _LETTERS), fontsize=9)
            panel.set(xlabel="rms of s̈ [m/s²]", ylabel=f"rms of |τ| [{curve.unit}]")
        handles = {line.get_label(): line for panel in panels for line in panel.lines}
        legend_below(drawn, list(handles.values()))
        return drawn


LEAST = 1e-16  # m; what is smaller is drawn there


def plot_tracking(title: str, curves: Mapping[str, tuple[Array, Array]]) -> Figure:
    """Draw distances from a planned motion over time.

    Args:
        title: of the figure.
        curves: by label, (N,) times, s, and (N,) distances, m.
    """
    lines = tuple(Curve(label, t, np.maximum(error, LEAST), i) for i, (label, (t, error)) in enumerate(curves.items()))
    top = max(float(np.nanmax(curve.value)) for curve in lines)
    panel = Panel("distance from the plan [m]", lines, log=True, within=(0.5 * LEAST, 3.0 * top), height=1.8)
    return plot_time_panels(title, [panel])
