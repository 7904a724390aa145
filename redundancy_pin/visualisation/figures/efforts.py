"""Efforts along a motion, by both backends, with what happens at singularities said instead of hidden."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.visualisation.figures.style import CARRIER_STROKES, STROKES, figure, legend_above, mark_singular

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_MARKERS = 36
"""Markers of the second backend along each line: enough to see the shape, few enough to see the line."""

_STRETCHES = 300
"""Stretches of the curve of differences, whose rounding noise would blacken the panel."""

_ROUNDING = 1e-17
"""Bottom of that curve; smaller differences are zero but for chance."""

_HEADROOM = 1.12
"""Height of the effort axis over the largest effort it shows."""


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
    windows: tuple[tuple[float, float], ...] = ()
    instants: tuple[float, ...] = ()
    missing_force: tuple[float, ...] = ()


def plot_efforts(curves: EffortCurves) -> Figure:
    """Draw efforts, what bounds them at singularities, carrier forces, and the difference of the backends.

    Inside near-singular windows efforts are not drawn: they grow as (missing force)/margin, without bound. What stays
    finite is drawn in the panel below, the norm of the efforts (as forces) times the margin; at a singular instant it
    is the force that no actuator can carry.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    with_singular, with_carriers = bool(curves.instants), curves.carrier_force.shape[1] > 0
    heights = [3.0, *([1.3] if with_singular else []), *([1.5] if with_carriers else []), 1.1]
    with figure(7.0, 1.0 + sum(heights)) as drawn:
        panels = list(drawn.subplots(len(heights), 1, sharex=True, height_ratios=heights, squeeze=False)[:, 0])
        drawn.suptitle(curves.title, fontsize=10.5)
        rest = iter(panels)
        _draw_efforts(next(rest), curves)
        if with_singular:
            _draw_bounded(next(rest), curves)
        if with_carriers:
            _draw_carriers(next(rest), curves)
        _draw_difference(next(rest), curves)
        for panel in panels:
            panel.set_xlim(curves.t[0], curves.t[-1])
        panels[-1].set_xlabel("time t [s]")
        drawn.align_ylabels(panels)
        return drawn


def _draw_efforts(axes: Axes, curves: EffortCurves) -> None:
    shown = np.where(curves.regular[:, None], curves.tau, np.nan)
    checked = np.where(curves.regular[:, None], curves.check, np.nan)
    every = max(1, len(curves.t) // _MARKERS)
    for i, name in enumerate(curves.names):
        stroke = STROKES[i % len(STROKES)]
        axes.plot(
            curves.t, shown[:, i], color=stroke.color, linestyle=stroke.dash, label=f"{name}, {curves.backends[0]}"
        )
    for i, name in enumerate(curves.names):
        stroke = STROKES[i % len(STROKES)]
        start = (i * every) // len(curves.names)
        axes.plot(
            curves.t[start::every],
            checked[start::every, i],
            color=stroke.color,
            linestyle="none",
            marker=stroke.marker,
            markersize=4.5,
            markerfacecolor="none",
            markeredgewidth=0.9,
            label=f"{name}, {curves.backends[1]}",
        )
    mark_singular(axes, curves.windows, curves.instants, label=True)
    limit = _HEADROOM * float(np.nanmax(np.abs(shown), initial=0.0)) or 1.0
    axes.set_ylim(-limit, limit)
    kind = "torque" if curves.unit == "N·m" else "force"
    axes.set_ylabel(f"actuator {kind} τ [{curves.unit}]")
    legend_above(axes, max(4, len(curves.names)))


def _draw_bounded(axes: Axes, curves: EffortCurves) -> None:
    force = np.linalg.norm(curves.tau / curves.scale, axis=1) * curves.margin
    check = np.linalg.norm(curves.check / curves.scale, axis=1) * curves.margin
    axes.plot(curves.t, force, color="#000000", linewidth=1.2)
    every = max(1, len(curves.t) // _MARKERS)
    axes.plot(
        curves.t[::every],
        check[::every],
        linestyle="none",
        marker="o",
        markersize=4,
        markerfacecolor="none",
        color="#666666",
    )
    mark_singular(axes, curves.windows, curves.instants)
    axes.plot(
        curves.instants,
        curves.missing_force,
        linestyle="none",
        marker="x",
        markersize=7,
        markeredgewidth=1.6,
        color="#D55E00",
        label="at the singular instant: force that no actuator can carry",
    )
    axes.set_ylim(0.0, _HEADROOM * float(np.nanmax(force, initial=0.0)) or 1.0)
    axes.set_ylabel("|τ| · margin [N]")
    legend_above(axes, 2)


def _draw_carriers(axes: Axes, curves: EffortCurves) -> None:
    for i in range(curves.carrier_force.shape[1]):
        stroke = CARRIER_STROKES[i % len(CARRIER_STROKES)]
        axes.plot(
            curves.t, curves.carrier_force[:, i], color=stroke.color, linestyle=stroke.dash, label=f"carrier {i + 1}"
        )
    mark_singular(axes, curves.windows, curves.instants)
    axes.set_ylabel("carrier force [N]")
    legend_above(axes, 6)


def _draw_difference(axes: Axes, curves: EffortCurves) -> None:
    """Draw |Δτ| · margin relative to the largest such value: the rounding of W⁻¹ grows as 1/margin."""
    weighted = curves.margin[:, None] / curves.scale
    difference = np.linalg.norm((curves.tau - curves.check) * weighted, axis=1)
    size = float(np.nanmax(np.linalg.norm(curves.tau * weighted, axis=1), initial=0.0)) or 1.0
    t, largest = _envelope(curves.t, difference / size)
    axes.semilogy(t, np.maximum(largest, _ROUNDING / 10.0), color="#444444", linewidth=1.0, label="largest nearby")
    mark_singular(axes, curves.windows, curves.instants)
    axes.set_ylim(_ROUNDING / 3.0, 1e-9)
    axes.set_yticks([1e-16, 1e-13, 1e-10])
    axes.axhline(1e-10, color="#D55E00", linewidth=0.9, linestyle="--", label="tolerance")
    axes.set_ylabel("difference of\nbackends [–]")
    legend_above(axes, 2)


def _envelope(t: Array, values: Array) -> tuple[Array, Array]:
    """Return the largest value of each of a few hundred stretches of samples, and its middle time; NaN left out."""
    stretch = max(1, len(t) // _STRETCHES)
    count = len(t) // stretch
    blocks = np.nan_to_num(values[: count * stretch]).reshape(count, stretch)
    return t[stretch // 2 :: stretch][:count], blocks.max(axis=1)


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
