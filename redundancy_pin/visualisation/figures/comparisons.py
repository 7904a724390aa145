"""Figures of the report that compare: two backends, several cases of one motion, several plans side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.planners.plan import Plan
from redundancy_pin.visualisation.figures.curves import carrier_panels, curves_of_plan
from redundancy_pin.visualisation.figures.style import STROKES
from redundancy_pin.visualisation.figures.time_panels import (
    Background,
    Curve,
    Panel,
    Windows,
    fitted_range,
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


@dataclass(frozen=True, eq=False)
class EffortCurves:
    """What the plot shows.

    Attributes:
        title: of the figure.
        names: of the m actuators.
        unit: of the efforts, ``"N"`` or ``"N·m"``.
        t: (N,) time, s.
        tau: (N, m) efforts of the first backend; NaN where there are none.
        check: (N, m) efforts of the second backend.
        backends: names of the two.
        regular: (N,) samples that are neither near-singular nor singular: the efforts axis is scaled to these.
        margin: (N,) smallest scaled singular value of W.
        scale: (m,) lengths, m, that turn the efforts into forces (1 for prismatic actuators).
        carrier_force: (N, k) forces of the carrier actuators, N.
        windows: near-singular time intervals, s.
        instants: singular instants, s.
        missing_force: force that no actuator effort balances at each instant, N, scaled.
    """

    title: str
    names: tuple[str, ...]
    unit: str
    t: Array
    tau: Array
    check: Array
    backends: tuple[str, str]
    regular: BoolArray
    margin: Array
    scale: Array
    carrier_force: Array
    windows: Windows = ()
    instants: tuple[float, ...] = ()
    missing_force: tuple[float, ...] = ()


def plot_efforts(curves: EffortCurves) -> Figure:
    """Draw efforts, what bounds them at singularities, carrier forces, and the difference of the backends.

    Inside near-singular windows efforts are not drawn: they grow as (missing force)/margin, without bound. What stays
    finite is drawn in the panel below, the norm of the efforts (as forces) times the margin; at a singular instant it
    is the force that no actuator can carry.
    """
    names = [f"carrier {i + 1}" for i in range(curves.carrier_force.shape[1])]
    panels = [_both(curves)]
    if curves.instants:
        panels.append(_bounded(curves))
    if names:
        forces = series(names, curves.t, curves.carrier_force, carrier=True)
        panels.append(Panel("carrier force [N]", forces, height=0.9))
    panels.append(_difference(curves))
    return plot_time_panels(curves.title, panels, instants=curves.instants, windows=curves.windows)


def _both(curves: EffortCurves) -> Panel:
    """Return the first backend as lines and the second as markers on them, at regular samples."""
    shown, checked = (np.where(curves.regular[:, None], tau, np.nan) for tau in (curves.tau, curves.check))
    lines = series([f"{name}, {curves.backends[0]}" for name in curves.names], curves.t, shown)
    every, markers = max(1, len(curves.t) // _MARKERS), []
    for i, name in enumerate(curves.names):
        style = {"marker": STROKES[i % len(STROKES)].marker, "markevery": ((i * every) // len(curves.names), every)}
        markers.append(Curve(f"{name}, {curves.backends[1]}", curves.t, checked[:, i], i, style=_RING | style))
    kind = "torque" if curves.unit == "N·m" else "force"
    return Panel(f"actuator {kind} τ [{curves.unit}]", (*lines, *markers), height=1.7)


def _bounded(curves: EffortCurves) -> Panel:
    force, check = (np.linalg.norm(tau / curves.scale, axis=1) * curves.margin for tau in (curves.tau, curves.check))
    ring = _RING | {"marker": "o", "color": "#666666", "markevery": max(1, len(curves.t) // _MARKERS)}
    cross = {"linestyle": "none", "marker": "x", "markersize": 7, "markeredgewidth": 1.6, "color": "#D55E00"}
    missing = "at the singular instant: force that no actuator can carry"
    lines = (
        Curve("", curves.t, force, style={"color": "#000000", "linewidth": 1.2}),
        Curve("", curves.t, check, style=ring),
        Curve(missing, np.array(curves.instants), np.array(curves.missing_force), style=cross),
    )
    return Panel("|τ| · margin [N]", lines, height=0.8)


def _difference(curves: EffortCurves) -> Panel:
    """Return |Δτ| · margin relative to the largest such value: the rounding of W⁻¹ grows as 1/margin."""
    weighted = curves.margin[:, None] / curves.scale
    difference = np.linalg.norm((curves.tau - curves.check) * weighted, axis=1)
    size = float(np.nanmax(np.linalg.norm(curves.tau * weighted, axis=1), initial=0.0)) or 1.0
    starts = np.arange(0, len(curves.t), max(1, len(curves.t) // _STRETCHES))
    largest = np.maximum(np.maximum.reduceat(np.nan_to_num(difference / size), starts), _ROUNDING / 10.0)
    curve = Curve("largest nearby", curves.t[starts], largest, style={"color": "#444444", "linewidth": 1.0})
    within = (_ROUNDING / 3.0, 1e-9)
    return Panel("difference of\nbackends [–]", (curve,), ((1e-10, "tolerance"),), log=True, within=within, height=0.7)


def plot_comparison(title: str, names: tuple[str, ...], unit: str, cases: Mapping[str, tuple[Array, Array]]) -> Figure:
    """Draw the efforts of each case over time, one panel an actuator, with their peaks.

    Args:
        title: of the figure.
        names: of the m actuators.
        unit: of the efforts.
        cases: by label: (N,) time, s, and (N, m) efforts.
    """

    def curve(i: int, stroke: int, label: str) -> Curve:
        t, tau = cases[label]
        peak = float(np.nanmax(np.abs(tau[:, i]), initial=0.0))
        return Curve(f"{label}: peak {peak:.3g} {unit}", t, tau[:, i], stroke)

    panels = [
        Panel(f"{name} [{unit}]", tuple(curve(i, stroke, label) for stroke, label in enumerate(cases)))
        for i, name in enumerate(names)
    ]
    within = fitted_range([curve for panel in panels for curve in panel.curves])
    return plot_time_panels(title, [replace(panel, within=within) for panel in panels])


def plot_side_by_side(title: str, plans: Mapping[str, Plan], unit: str, *, instants: Sequence[float] = ()) -> Figure:
    """Draw plans of the same motion in columns: main efforts, and s, ṡ, s̈ of the carriers with their limits.

    Each effort panel has its own scale, as efforts of different planners can be orders of magnitude apart; its peak
    stands above it. The rows of the carriers share their scales.

    Args:
        title: of the figure.
        plans: by what the column is called.
        unit: of the main efforts.
        instants: singular instants, s, drawn as dotted lines.
    """
    columns: list[list[Panel]] = []
    for name, plan in plans.items():
        first = not columns
        peak = f"peak {float(plan.peak_effort.max()):.3g} {unit}, {plan.status.value.replace('_', ' ')}"
        names = [f"actuator {i + 1}" for i in range(plan.tau.shape[1])]
        main = Panel(f"main effort τ [{unit}]" if first else "", series(names, plan.t, plan.tau), height=1.25,
                     title=f"{name}\n{peak}", legend=False)  # fmt: skip
        rows = [
            replace(panel, label=panel.label.removeprefix("carrier ") if first else "", legend=False, shared=True)
            for panel in carrier_panels(curves_of_plan(plan))
        ]
        columns.append([main, *rows])
    return plot_panel_grid(title, columns, (2.0 + 2.6 * len(plans), 8.0), Background(None, instants))
