"""Figures of the report that compare: two backends, cases of one motion, plans side by side, and sums of many plans."""

from __future__ import annotations

import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.planners.plan import Plan
from redundancy_pin.visualisation.figures.curves import Curves, curves_of_plan
from redundancy_pin.visualisation.figures.plots import carrier_panels, distance_panel
from redundancy_pin.visualisation.figures.style import STROKES, figure, legend_above, legend_below, log_scale
from redundancy_pin.visualisation.figures.time_panels import (
    Background,
    Curve,
    Panel,
    plot_panel_grid,
    plot_time_panels,
    series,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure


_RING = {"linestyle": "none", "markersize": 4.5, "markerfacecolor": "none", "markeredgewidth": 0.9}
_MARKERS = 36  # markers of the second backend along each line: enough to see the shape, few enough to see the line
_STRETCHES = 300  # stretches of the curve of differences, whose rounding noise would blacken the panel
_ROUNDING = 1e-17  # bottom of that curve; smaller differences are zero but for chance


def plot_efforts(
    drawn: Curves, check: Array, *, backends: tuple[str, str], scale: Array, missing_force: Sequence[float] = ()
) -> Figure:
    """Draw efforts, what bounds them at singularities, carrier forces, and the difference of the backends.

    Inside near-singular windows efforts are not drawn: they grow as (missing force)/margin, without bound. What stays
    finite is drawn in the panel below, the norm of the efforts (as forces) times the margin; at a singular instant it
    is the force that no actuator can carry, ``missing_force``, N, scaled.

    ``check`` (N, m) are the efforts of the second backend; ``scale`` (m,), m, turns efforts into forces.
    """
    panels = [_both(drawn, check, backends)]
    if drawn.instants:
        panels.append(_bounded(drawn, check, scale, missing_force))
    if drawn.carrier_names:
        forces = series(drawn.carrier_names, drawn.t, drawn.carrier_force, carrier=True)
        panels.append(Panel("carrier force [N]", forces, height=0.9))
    panels.append(_difference(drawn, check, scale))
    return plot_time_panels(drawn.title, panels, instants=drawn.instants, windows=drawn.windows)


def _both(drawn: Curves, check: Array, backends: tuple[str, str]) -> Panel:
    """Return the first backend as lines and the second as markers on them, at regular samples."""
    shown, checked = (np.where(drawn.regular[:, None], tau, np.nan) for tau in (drawn.tau, check))
    names = drawn.main_names
    lines = series([f"{name}, {backends[0]}" for name in names], drawn.t, shown)
    every, markers = max(1, len(drawn.t) // _MARKERS), []
    for i, name in enumerate(names):
        style = {"marker": STROKES[i % len(STROKES)].marker, "markevery": ((i * every) // len(names), every)}
        markers.append(Curve(f"{name}, {backends[1]}", drawn.t, checked[:, i], i, style=_RING | style))
    return Panel(f"actuator {drawn.main_unit.replace(' ', ' τ ')}", (*lines, *markers), height=1.7)


def _bounded(drawn: Curves, check: Array, scale: Array, missing_force: Sequence[float]) -> Panel:
    first, second = (np.linalg.norm(tau / scale, axis=1) * drawn.margin for tau in (drawn.tau, check))
    ring = _RING | {"marker": "o", "color": "#666666", "markevery": max(1, len(drawn.t) // _MARKERS)}
    cross = {"linestyle": "none", "marker": "x", "markersize": 7, "markeredgewidth": 1.6, "color": "#D55E00"}
    missing = "at the singular instant: force that no actuator can carry"
    lines = (
        Curve("", drawn.t, first, style={"color": "#000000", "linewidth": 1.2}),
        Curve("", drawn.t, second, style=ring),
        Curve(missing, np.array(drawn.instants), np.array(missing_force), style=cross),
    )
    return Panel("|τ| · margin [N]", lines, height=0.8)


def _difference(drawn: Curves, check: Array, scale: Array) -> Panel:
    """Return |Δτ| · margin relative to the largest such value: the rounding of W⁻¹ grows as 1/margin."""
    weighted = drawn.margin[:, None] / scale
    difference = np.linalg.norm((drawn.tau - check) * weighted, axis=1)
    size = float(np.nanmax(np.linalg.norm(drawn.tau * weighted, axis=1), initial=0.0)) or 1.0
    starts = np.arange(0, len(drawn.t), max(1, len(drawn.t) // _STRETCHES))
    largest = np.maximum(np.maximum.reduceat(np.nan_to_num(difference / size), starts), _ROUNDING / 10.0)
    curve = Curve("largest nearby", drawn.t[starts], largest, style={"color": "#444444", "linewidth": 1.0})
    within = (_ROUNDING / 3.0, 1e-9)
    return Panel("difference of\nbackends [–]", (curve,), ((1e-10, "tolerance"),), log=True, within=within, height=0.7)


def plot_side_by_side(title: str, plans: Mapping[str, Plan], unit: str, *, instants: Sequence[float] = ()) -> Figure:
    """Draw plans of the same motion in columns: main efforts, and s, ṡ, s̈ of the carriers with their limits.

    Each effort panel has its own scale, as efforts of different planners can be orders of magnitude apart; its peak
    stands above it. The rows of the carriers share their scales. ``plans`` are by what their column is called,
    ``unit`` is that of the main efforts, ``instants`` are singular, s.
    """
    columns: list[list[Panel]] = []
    for name, plan in plans.items():
        first = not columns
        peak = f"peak {float(plan.peak_effort.max()):.3g} {unit}, {plan.status.value.replace('_', ' ')}"
        curves = series(plan.robot.actuated, plan.t, plan.tau)
        label = f"main effort τ [{unit}]" if first else ""
        main = Panel(label, curves, height=1.25, title=f"{name}\n{peak}", legend=False)
        rows = [
            replace(panel, label=panel.label.removeprefix("carrier ") if first else "", legend=False, shared=True)
            for panel in carrier_panels(curves_of_plan(plan))
        ]
        columns.append([main, *rows])
    return plot_panel_grid(title, columns, (2.0 + 2.6 * len(plans), 8.0), Background(None, instants))


_HATCHES = ("", "///", "...", "xxx", "---", "\\\\\\")  # so that bars can be told apart without colour


def plot_bars(
    title: str, groups: Sequence[str], groups_label: str, label: str, values: Mapping[str, Array]
) -> Figure:  # fmt: skip
    """Draw one group of bars a case, one bar a method, on a logarithmic axis.

    Values are positive, (G,) by method for the G ``groups``; NaN leaves a gap that is marked "none".
    """
    width = max(8.0, 1.6 + 0.9 * len(groups))
    with figure(width, 3.6, title) as drawn:
        axes = drawn.subplots()
        bar, places = 0.8 / len(values), np.arange(len(groups))
        smallest = min(float(np.nanmin(heights)) for heights in values.values())
        for i, (name, heights) in enumerate(values.items()):
            at = places + (i - 0.5 * (len(values) - 1)) * bar
            color, hatch = STROKES[i % len(STROKES)].color, _HATCHES[i % len(_HATCHES)]
            axes.bar(at, np.nan_to_num(heights), bar, color=color, hatch=hatch, edgecolor="white", linewidth=0.4,
                     label=name)  # fmt: skip
            for x in at[np.isnan(heights)]:
                axes.text(x, smallest, "none", rotation=90, ha="center", va="bottom", fontsize=7)
        log_scale(axes)
        axes.set_ylim(bottom=0.7 * smallest)
        axes.set_xticks(places, groups)
        axes.set(xlabel=groups_label, ylabel=label)
        legend_above(axes, width - 0.8)
        return drawn


def plot_speed_border(title: str, attempts: Sequence[tuple[str, Array, Array]]) -> Figure:
    """Draw effort over speed, logarithmic, with crosses on the lower edge where there is no plan.

    An attempt is a label, (P, 2) speeds, m/s, ascending, and largest efforts, N, with a plan, (Q,) speeds without one.
    """
    with figure(7.0, 4.6, title) as drawn:
        axes = drawn.subplots()
        for stroke, (name, feasible, infeasible) in zip(STROKES, attempts, strict=False):
            axes.plot(*feasible.T, color=stroke.color, linestyle=stroke.dash, marker=stroke.marker, markersize=4,
                      label=name)  # fmt: skip
            axes.plot(infeasible, [0.02] * len(infeasible), "x", color=stroke.color, clip_on=False,
                      transform=axes.get_xaxis_transform())  # fmt: skip
        log_scale(axes)
        axes.set(xlabel="cruising speed [m/s] (crosses: no plan)", ylabel="largest main force [N]")
        legend_above(axes, 6.2)
        return drawn


_LETTERS = 42  # of a line of a panel's title


@dataclass(frozen=True, eq=False)
class TradeCurve:
    """One quantity against another along one motion; acceleration against effort by default."""

    title: str  # of its panel
    unit: str  # of the effort
    points: Array  # (P, 2) both along the curve
    marks: Mapping[str, tuple[float, float]]  # the same of other plans, by name
    labels: tuple[str, str] = ("rms of s̈ [m/s²]", "")  # of abscissa and ordinate
    each: str = "a weight"  # what a point stands for


def plot_trade_off(title: str, curves: Sequence[TradeCurve]) -> Figure:
    """Draw each curve in a panel of its own, with other plans as marks."""
    with figure(3.8 * len(curves), 3.8, title) as drawn:
        panels = drawn.subplots(1, len(curves), squeeze=False)[0]
        names = list(dict.fromkeys(name for curve in curves for name in curve.marks))
        for panel, curve in zip(panels, curves, strict=True):
            panel.plot(curve.points[:, 0], curve.points[:, 1], color=STROKES[0].color, marker="o", markersize=4,
                       label=f"whole trajectory, one point {curve.each}")  # fmt: skip
            for name, (acceleration, effort) in curve.marks.items():
                stroke = STROKES[1 + names.index(name)]
                panel.plot([acceleration], [effort], linestyle="none", marker=stroke.marker, color=stroke.color,
                           markersize=7, label=name)  # fmt: skip
            if (np.array([*curve.points, *curve.marks.values()]) > 0.0).all():  # a front may end in zero
                log_scale(panel)
            panel.set_title(textwrap.fill(curve.title, _LETTERS), fontsize=9)
            panel.set(xlabel=curve.labels[0], ylabel=curve.labels[1] or f"rms of |τ| [{curve.unit}]")
        handles = {line.get_label(): line for panel in panels for line in panel.lines}
        legend_below(drawn, list(handles.values()))
        return drawn


def plot_tracking(title: str, curves: Mapping[str, tuple[Array, Array]]) -> Figure:
    """Draw distances (N,), m, from a planned motion over times (N,), s; both by label."""
    return plot_time_panels(title, [replace(distance_panel("distance from the plan [m]", curves), height=1.8)])
