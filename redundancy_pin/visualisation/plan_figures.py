"""A plan on one page: efforts, carrier motion with its limits, condition number; the phases shaded in every panel."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.status import SampleStatus
from redundancy_pin.planners.plan import Plan, PlanStatus
from redundancy_pin.robot import CarrierLimits
from redundancy_pin.visualisation.plan_panels import (
    draw_limits,
    draw_series,
    fit_to,
    mark_broken,
    phase_handles,
    shade_phases,
)
from redundancy_pin.visualisation.style import (
    CARRIER_STROKES,
    beyond_handle,
    figure,
    instant_handle,
    legend_above,
    mark_instants,
    words,
)

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
