"""A plan on one page: efforts, carrier motion with its limits, condition number; the phases shaded in every panel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.dynamics.distribution import SampleStatus
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.plan import Plan, PlanStatus
from redundancy_pin.robot import CarrierLimits
from redundancy_pin.visualisation.figures.style import (
    CARRIER_STROKES,
    STROKES,
    Stroke,
    beyond_handle,
    figure,
    hatch_beyond,
    instant_handle,
    legend_above,
    mark_instants,
    words,
)

if TYPE_CHECKING:
    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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


_CONDITION_TOP = 1e3
"""Largest condition number of the axis: at a singular instant it is infinite."""

_CONDITION_LINEAR = 10.0
"""Up to this condition number the axis is linear."""


def plot_plan(
    plan: Plan,
    *,
    title: str | None = None,
    reference: Array | None = None,
    reference_name: str = "baseline",
) -> Figure:
    """Draw a plan: six panels over time, readable without colour.

    Left: main efforts, carrier forces, condition number. Right: position, speed and acceleration of the carriers, with
    what their limits forbid hatched and every broken limit marked. Grey shades tell the phases of the planner. Drawn if
    the planner has them: its threshold (parameters ``threshold`` and ``measure``) and the singular instants
    (diagnostics ``singular_instants``).

    Args:
        plan: the plan.
        title: of the figure; made from the plan when left out.
        reference: (N, m) main efforts to compare with, thin lines, N or N·m.
        reference_name: what the legend calls them.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    instants = _numbers(plan.diagnostics.get("singular_instants"))
    with figure(9.6, 7.2) as drawn:
        panels = drawn.subplots(3, 2, sharex=True, squeeze=False)
        drawn.suptitle(title or plan_title(plan), fontsize=10.5)
        _draw_efforts(panels[0, 0], plan, reference, reference_name)
        _draw_forces(panels[1, 0], plan)
        _draw_condition(panels[2, 0], plan, _condition_threshold(plan))
        length, time = ("rad" if set(plan.robot.carriers) <= set(plan.robot.rotating) else "m"), "s"
        for panel, label, quantity, values, limit in (
            (panels[0, 1], f"position s [{length}]", "track", plan.carriers.s, _track),
            (panels[1, 1], f"speed ṡ [{length}/{time}]", "speed", plan.carriers.sd, _speed),
            (panels[2, 1], f"acceleration s̈ [{length}/{time}²]", "acceleration", plan.carriers.sdd, _acceleration),
        ):
            _draw_motion(panel, plan, values, quantity, limit)
            panel.set_ylabel(f"carrier {label}")
        for panel in panels.flat:
            shade_phases(panel, plan)
            mark_instants(panel, instants)
            if plan.t[-1] > plan.t[0]:
                panel.set_xlim(plan.t[0], plan.t[-1])
        for panel in panels[-1]:
            panel.set_xlabel("time t [s]")
        for column in panels.T:
            drawn.align_ylabels(column)
        _legend_of_phases(drawn, plan, bool(instants))
        return drawn


def plan_title(plan: Plan) -> str:
    """Return one line that says what the plan is and how it ended."""
    robot, planner, status = plan.robot.name, plan.planner.replace("_", " "), words(plan.status.value)
    said = f"{robot}: {planner}, {status}"
    if not plan.diagnostics.get("optimal", True):
        said = f"{said}, NOT an optimum"
    if plan.status is not PlanStatus.VIOLATES_LIMITS:
        return said
    broken: dict[str, list[str]] = {}
    for i, name in enumerate(plan.robot.carriers):
        for quantity in sorted({event.quantity for event in plan.limits.violated if event.carrier == name}):
            broken.setdefault(quantity, []).append(str(i + 1))
    parts = [
        f"{quantity} of carrier{'s' if len(which) > 1 else ''} {', '.join(which)}" for quantity, which in broken.items()
    ]
    return f"{said} ({'; '.join(parts)})"


def _draw_efforts(axes: Axes, plan: Plan, reference: Array | None, name: str) -> None:
    symbols = [f"τ{i + 1}" for i in range(len(plan.robot.actuated))]
    if reference is not None:
        for i in range(reference.shape[1]):
            axes.plot(plan.t, reference[:, i], color="#777777", linewidth=0.8, zorder=1.8, label=None if i else name)
    draw_series(axes, plan.t, plan.tau, symbols)
    # next to a singularity efforts without a plan grow without bound and would flatten everything else
    fit_to(axes, plan.tau, plan.sample_status == SampleStatus.REGULAR)
    bounds = _numbers(plan.parameters.get("effort"))
    if len(bounds) == len(symbols) and np.isfinite(bounds).any():
        draw_limits(axes, plan.tau, [(-bound, bound) for bound in bounds])
    axes.set_ylabel(f"main {_effort(plan, plan.robot.actuated)}")
    legend_above(axes, len(symbols) + 1)


def _draw_forces(axes: Axes, plan: Plan) -> None:
    names = [f"carrier {i + 1}" for i in range(len(plan.robot.carriers))]
    if names:
        draw_series(axes, plan.t, plan.carrier_force, names, CARRIER_STROKES)
        draw_limits(axes, plan.carrier_force, [_force(limits) for limits in plan.limits.judged_by])
        mark_broken(axes, plan, "force")
        legend_above(axes, len(names))
    axes.set_ylabel(f"carrier {_effort(plan, plan.robot.carriers)}")


def _draw_motion(
    axes: Axes, plan: Plan, values: Array, quantity: str, limit: Callable[[CarrierLimits], tuple[float, float]]
) -> None:
    names = [f"carrier {i + 1}" for i in range(len(plan.robot.carriers))]
    if not names:
        return
    draw_series(axes, plan.t, values, names, CARRIER_STROKES)
    draw_limits(axes, values, [limit(limits) for limits in plan.limits.judged_by])
    mark_broken(axes, plan, quantity)
    if quantity == "track":
        legend_above(axes, len(names))


def _draw_condition(axes: Axes, plan: Plan, threshold: float | None) -> None:
    shown = np.minimum(np.where(np.isnan(plan.condition), np.inf, plan.condition), 10.0 * _CONDITION_TOP)
    axes.plot(plan.t, shown, color="#000000", linewidth=1.2, zorder=2.0)
    top = max(float(shown.max()), 2.0 * (threshold or 1.0))
    axes.set_yscale("log" if top > _CONDITION_LINEAR else "linear")
    axes.set_ylim(1.0, min(_CONDITION_TOP, 1.5 * top) if top > _CONDITION_LINEAR else 1.1 * top)
    if threshold is not None:
        axes.axhline(
            threshold, color="#D55E00", linewidth=1.1, linestyle="--", zorder=1.9, label=f"threshold {threshold:g}"
        )
        legend_above(axes, 1)
    axes.set_ylabel("condition number of W [–]")


def _legend_of_phases(drawn: Figure, plan: Plan, with_instants: bool) -> None:
    handles = phase_handles(plan)
    if with_instants:
        handles.append(instant_handle())
    if plan.robot.carriers:
        handles.append(beyond_handle())
    drawn.legend(handles=handles, loc="outside lower center", ncols=len(handles), frameon=False)


def _condition_threshold(plan: Plan) -> float | None:
    found = _numbers([plan.parameters.get("threshold")])
    return found[0] if found and plan.parameters.get("measure") == "condition" else None


def _numbers(values: object) -> list[float]:
    """Return the numbers of a list in plain data; none where it is something else."""
    listed = values if isinstance(values, (list, tuple)) else ()
    return [float(value) for value in listed if isinstance(value, (int, float))]


def _effort(plan: Plan, names: Sequence[str]) -> str:
    turning = [name in plan.robot.rotating for name in names]
    if not any(turning):
        return "force [N]"
    return "torque [N·m]" if all(turning) else "effort [N or N·m]"


def _track(limits: CarrierLimits) -> tuple[float, float]:
    return limits.lower, limits.upper


def _speed(limits: CarrierLimits) -> tuple[float, float]:
    return -limits.speed, limits.speed


def _acceleration(limits: CarrierLimits) -> tuple[float, float]:
    return -limits.acceleration, limits.acceleration


def _force(limits: CarrierLimits) -> tuple[float, float]:
    return -limits.force, limits.force
