"""How each kind of figure of the thesis is drawn from a plan."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.experiments.planned import measures as m
from redundancy_pin.experiments.planned.cases import Case, StepwiseCase, SwitchOffCase
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.planners.plan import Plan
from redundancy_pin.visualisation.figures.paths import PlanePath, plot_plane_paths
from redundancy_pin.visualisation.figures.time_panels import Curve, Panel, plot_time_panels
from redundancy_pin.visualisation.viewer.parts import base_hinges, links

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Draw = Callable[[PlanStore], "Figure"]
Quantity = Literal["position", "speed", "acceleration"]

_UNITS = {"position": "s [m]", "speed": "ṡ [m/s]", "acceleration": "s̈ [m/s²]"}


def profile(case: Case) -> Draw:
    """Return a drawing of the platform's speed and acceleration (norms)."""

    def draw(store: PlanStore) -> Figure:
        motion = case.trajectory().sample(2e-3)
        speed, acceleration = (np.linalg.norm(part[:, :2], axis=1) for part in (motion.xd, motion.xdd))
        panels = (
            Panel("speed |ẋ| [m/s]", (Curve("speed", motion.t, speed),)),
            Panel("acceleration |ẍ| [m/s²]", (Curve("acceleration", motion.t, acceleration, 1),)),
        )
        return plot_time_panels(f"{_motion_title(case)}: speed and acceleration of the platform", panels)

    return draw


def displacement(case: Case) -> Draw:
    """Return a drawing of the platform's x and y over time."""

    def draw(store: PlanStore) -> Figure:
        motion = case.trajectory().sample(2e-3)
        panels = tuple(
            Panel(f"{name} [m]", (Curve(name, motion.t, motion.x[:, i] - motion.x[0, i], i),))
            for i, name in enumerate(("x − x(0)", "y − y(0)"))
        )
        return plot_time_panels(f"{_motion_title(case)}: displacement of the platform", panels)

    return draw


def crossing_path(case: SwitchOffCase) -> Draw:
    """Return a drawing of the 2-RPR with its path and the singular points on it."""

    def draw(store: PlanStore) -> Figure:
        trajectory = case.trajectory()
        robot = case.dynamics("virtual-work").robot
        motion = trajectory.sample(2e-3)
        instants = np.array(store.plan(case).diagnostics["singular_instants"])
        places = trajectory.sample_at(instants).x
        start = lift(robot, motion[:1]).q[0]
        return plot_plane_paths(
            f"{_motion_title(case)}: path and mechanism at the start",
            [PlanePath("path", motion.x[:, :2])],
            links=[np.stack(ends)[:, :2] for ends in links(robot, start)],
            hinges=base_hinges(robot)[:, :2],
            singular=[(float(x), float(y)) for x, y in places],
        )

    return draw


def corner_paths(*cases: StepwiseCase) -> Draw:
    """Return a drawing of the corners."""

    def draw(store: PlanStore) -> Figure:
        paths = [
            PlanePath(f"radius {case.path_options['radius']:g} m", case.trajectory().sample(2e-3).x[:, :2])
            for case in cases
        ]
        return plot_plane_paths("Corners of the 3-RRR's platform", paths)

    return draw


def square_path(case: StepwiseCase) -> Draw:
    """Return a drawing of the square."""

    def draw(store: PlanStore) -> Figure:
        path = PlanePath("path", case.trajectory().sample(2e-3).x[:, :2])
        return plot_plane_paths("Square of the 3-RRR's platform", [path])

    return draw


def condition(case: SwitchOffCase, thresholds: tuple[float, ...]) -> Draw:
    """Return a drawing of the condition number with thresholds."""

    def draw(store: PlanStore) -> Figure:
        plan = store.plan(case)
        panel = Panel(
            "condition number [–]",
            (Curve("condition number", plan.t, plan.condition),),
            tuple((level, f"threshold {level:g}") for level in thresholds),
            log=True,
            height=1.8,
        )
        return plot_time_panels(f"{_motion_title(case)}: condition number", (panel,), instants=_instants(plan))

    return draw


def forces(case: SwitchOffCase) -> Draw:
    """Return a drawing of the forces of the main actuators and the condition number."""

    def draw(store: PlanStore) -> Figure:
        plan = store.plan(case)
        curves = tuple(Curve(f"τ{i + 1}", plan.t, plan.tau[:, i], i) for i in range(2))
        until = float(m.window(plan)["exit"])
        before = plan.t <= until
        shown = tuple(Curve(f"τ{i + 1}", plan.t[before], plan.tau[before, i], i) for i in range(2))
        level = ((case.threshold, f"threshold {case.threshold:g}"),)
        panels = (
            Panel("force τ [N]", curves, height=1.3),
            Panel("force τ [N], until\nswitched on", shown, height=1.2),
            Panel("condition number [–]", (Curve("condition number", plan.t, plan.condition),), level, log=True),
        )
        return plot_time_panels(f"{case.title}: main actuators", panels, plan=plan, instants=_instants(plan))

    return draw


def carriers(case: SwitchOffCase) -> Draw:
    """Return a drawing of position, speed and acceleration of the carriers of a crossing."""

    def draw(store: PlanStore) -> Figure:
        plan = store.plan(case)
        panels = tuple(_carrier_panel(plan, quantity) for quantity in ("position", "speed", "acceleration"))
        return plot_time_panels(f"{case.title}: carriers", panels, plan=plan, instants=_instants(plan))

    return draw


def torques(case: StepwiseCase) -> Draw:
    """Return a drawing of each base torque beside the machine without carriers and with parked ones."""

    def draw(store: PlanStore) -> Figure:
        plan, none, parked = store.plan(case), store.baseline(case), store.parked(case)
        panels = tuple(
            Panel(
                f"τ{i + 1} [N·m]",
                (
                    Curve("no carriers", none.t, none.tau[:, i], reference=True),
                    Curve("carriers parked", parked.t, parked.tau[:, i], 1),
                    Curve("carriers moving", plan.t, plan.tau[:, i], 0),
                ),
            )
            for i in range(3)
        )
        return plot_time_panels(f"{case.title}, working mode (+,+,+): base torques", panels, plan=plan)

    return draw


def carrier_panels(case: StepwiseCase, quantity: Quantity) -> Draw:
    """Return a drawing of one quantity of the carriers, one panel each."""

    def draw(store: PlanStore) -> Figure:
        plan = store.plan(case)
        panels = tuple(
            Panel(
                f"carrier {i + 1}\n{_UNITS[quantity]}",
                (Curve(f"{quantity} of carrier {i + 1}", plan.t, _values(plan, quantity)[:, i], i, carrier=True),),
                limits=_limits(plan, quantity),
            )
            for i in range(3)
        )
        return plot_time_panels(f"{case.title}, working mode (+,+,+): {quantity} of the carriers", panels, plan=plan)

    return draw


def _carrier_panel(plan: Plan, quantity: Quantity) -> Panel:
    values = _values(plan, quantity)
    curves = tuple(Curve(f"carrier {i + 1}", plan.t, values[:, i], i, carrier=True) for i in range(values.shape[1]))
    return Panel(_UNITS[quantity], curves, limits=_limits(plan, quantity), height=1.2)


def _values(plan: Plan, quantity: Quantity) -> Array:
    return {"position": plan.carriers.s, "speed": plan.carriers.sd, "acceleration": plan.carriers.sdd}[quantity]


def _limits(plan: Plan, quantity: Quantity) -> tuple[float, ...]:
    first = plan.limits.judged_by[0]
    if quantity == "position":
        return first.lower, first.upper
    limit = first.speed if quantity == "speed" else first.acceleration
    return (-limit, limit) if np.isfinite(limit) else ()


def _instants(plan: Plan) -> list[float]:
    found: Any = plan.diagnostics["singular_instants"]
    return [float(instant) for instant in found]


def _motion_title(case: Case) -> str:
    if isinstance(case, SwitchOffCase):
        return f"2-RPR, {case.path} at {case.speed:g} m/s"
    return "3-RRR, square" if case.path == "square" else f"3-RRR, corner of radius {case.path_options['radius']:g} m"
