"""Every way to carry out a motion of the chapter, as rows of numbers."""

from __future__ import annotations

from dataclasses import replace

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.experiments.beyond.between import peak_at_rest, peak_of_stepwise, peak_of_switch_off
from redundancy_pin.experiments.beyond.cases import SwitchOff, Whole
from redundancy_pin.experiments.beyond.rows import Row, dense_peak, row_of, row_without
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.experiments.beyond.tasks import Task
from redundancy_pin.experiments.planned import cases as planned

NONE = "no carriers"
PARKED = "carriers parked"
SWITCH_OFF = "switching off"
SWITCH_OFF_LATE = "switching off late"
STEPWISE = "stepwise λ = 0"
STEPWISE_HALF = "stepwise λ = 0.5"
EFFORT = "whole trajectory: effort"
PEAK = "whole trajectory: peak"
PEAK_FREE = "whole trajectory: peak (end free)"
ENERGY = "whole trajectory: energy"
SMOOTH = "whole trajectory: smooth effort"

SMOOTHING = 0.01
"""Weight of ∫ Σ τ̇² dt beside the effort in smooth plans."""

OBJECTIVES: dict[str, tuple[tuple[str, float], ...]] = {
    EFFORT: (("effort", 1.0),),
    PEAK: (("peak", 1.0),),
    PEAK_FREE: (("peak", 1.0),),
    ENERGY: (("energy", 1.0),),
    SMOOTH: (("effort", 1.0), ("effort_rate", SMOOTHING)),
}
"""What each way of the whole-trajectory planner minimises."""

LATE = 20.0
"""Condition number, the largest of the thesis, beyond which the motors are off in the second way of switching off."""

_ENERGY_COARSER = 2.0
"""Factor on the step of plans of least energy: absolute values are many rows for the solver."""


def case_of(task: Task, way: str, coarser: float = 1.0) -> Whole:
    """Return the whole-trajectory plan of a way."""
    case = Whole(task, OBJECTIVES[way], coarser * (_ENERGY_COARSER if way == ENERGY else 1.0))
    return replace(case, end="free") if way == PEAK_FREE else case


def crossing_rows(store: BeyondStore, task: Task, coarser: float) -> tuple[Row, ...]:
    """Return a crossing of a singularity by switching off and over the whole trajectory."""
    off = (switch_off_row(store, task), switch_off_row(store, task, SWITCH_OFF_LATE))
    return (*off, *(whole_row(store, task, way, coarser) for way in (EFFORT, PEAK, SMOOTH)))


def corner_rows(store: BeyondStore, task: Task, coarser: float, *, energy: bool = True) -> tuple[Row, ...]:
    """Return a corner or the square without carriers, with parked ones, stepwise, and over the whole trajectory."""
    ways = (EFFORT, PEAK, PEAK_FREE, ENERGY) if energy else (EFFORT, PEAK)
    return (*stepwise_rows(store, task), *(whole_row(store, task, way, coarser) for way in ways))


def switch_off_case(task: Task, way: str = SWITCH_OFF) -> SwitchOff:
    """Return the plan of a crossing with the motors off, from the task's threshold or from ``LATE`` on."""
    return SwitchOff(task, LATE if way == SWITCH_OFF_LATE else task.threshold)


def switch_off_row(store: BeyondStore, task: Task, way: str = SWITCH_OFF) -> Row:
    """Return a crossing with the motors off."""
    backend = task.machine.backends[0]
    try:
        plan = store.plan(switch_off_case(task, way), backend)
    except InfeasiblePlanError as error:
        return row_without(task.name, way, task.unit, error)
    dense = peak_of_switch_off(task.machine.dynamics(), task.trajectory(), plan)
    return row_of(task.name, way, task.unit, plan, dense, f"beyond-{task.name}-{way.replace(' ', '-')}")


def whole_row(store: BeyondStore, task: Task, way: str, coarser: float) -> Row:
    """Return a plan over the whole trajectory."""
    case = case_of(task, way, coarser)
    try:
        plan = store.plan(case, task.machine.backends[0])
    except InfeasiblePlanError as error:
        return row_without(task.name, way, task.unit, error)
    return row_of(task.name, way, task.unit, plan, dense_peak(plan), f"beyond-{case.name}")


def stepwise_rows(store: BeyondStore, task: Task) -> tuple[Row, ...]:
    """Return the machine without carriers, with parked ones, and the stepwise plans, from the thesis's chapter."""
    cases = {STEPWISE: stepwise_case(task, 0.0), STEPWISE_HALF: stepwise_case(task, 0.5)}
    first, trajectory, machine = cases[STEPWISE], task.trajectory(), task.machine
    rows = []
    for way, carriers in ((NONE, False), (PARKED, True)):
        plan = store.thesis.parked(first) if carriers else store.thesis.baseline(first)
        dense = peak_at_rest(machine.dynamics(carriers=carriers), trajectory, first.dt)
        rows.append(row_of(task.name, way, task.unit, plan, dense))
    for way, case in cases.items():
        try:
            plan = store.thesis.plan(case)
        except InfeasiblePlanError as error:
            rows.append(row_without(task.name, way, task.unit, error))
            continue
        rows.append(row_of(task.name, way, task.unit, plan, peak_of_stepwise(machine.dynamics(), trajectory, plan)))
    return tuple(rows)


def stepwise_case(task: Task, lam: float) -> planned.StepwiseCase:
    """Return the stepwise plan of a task, as in the thesis's chapter."""
    mode = task.machine.mode
    return planned.square(lam, mode) if task.path == "square" else planned.corner(task.radius, lam, mode)
