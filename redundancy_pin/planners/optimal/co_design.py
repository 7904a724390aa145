"""Co-design of a robot and its motions: design parameters optimised together with the plans of several tasks.

For each robot that is tried, every task has its least cost and the derivatives of that (``optimal.least_cost``): with
carriers, or if the time of a path is minimised, of the best plan; otherwise of the efforts that the motion
determines. The weighted sum of
the least costs is minimised over the numbers of the robot, within bounds. A robot that cannot carry out a task counts
as worse than any that can.

Least costs have kinks: a peak has one where two actuators share it. The model of the cost therefore takes the slopes
of all robots that were tried (a bundle) plus a curvature (BFGS), within a trust region: at a kink of a convex cost the
model has a kink too, where a quasi-Newton method stalls.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin
from scipy.optimize import minimize

from redundancy_pin.arrays import Array, BoolArray, Frozen, checked, frozen, positive, require_type, whole
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.errors import (
    DeclarationError,
    InfeasiblePlanError,
    InputError,
    SingularPoseError,
    UnreachablePoseError,
    WorkingModeError,
    did_you_mean,
    shown,
)
from redundancy_pin.loading import with_parameters
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.optimal.least_cost import TIME, LeastCost, least_cost
from redundancy_pin.planners.optimal.sensitivity import NO_ROBOT, DesignedRobot
from redundancy_pin.planners.optimal.time_optimal import plan_time_optimal
from redundancy_pin.planners.optimal.whole_trajectory import plan_whole_trajectory
from redundancy_pin.planners.options import Objective, refuse_fields
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory
from redundancy_pin.trajectory.paths import Path

NO_MACHINE = (InfeasiblePlanError, UnreachablePoseError, SingularPoseError, WorkingModeError, DeclarationError)
"""Errors that show that a machine cannot carry out a task."""

_STATIONARY = 3e-4
"""Relative decrease of the cost that the model promises, from which the search ends."""

_LARGEST, _LEAST = 0.3, 1e-3
"""Radius of the trust region, of the ranges: to begin with, and where the method gives up."""

_SEEN = 0.03
"""Radius within which nothing may be promised of a machine that counts as best."""

_DECREASE = 0.1
"""Part of the promised decrease that a machine has to bring, to be the next one."""

_STIFFEST = 20.0
"""Largest curvature of the model, of the cost and the ranges: kinks have more, and are modelled by slopes."""

_ON_BOUND = 1e-9
"""Of the ranges: nearer to a bound is on it."""

_CONVEX = 0.01
"""Curvature by which the slopes of other machines are reduced where the cost is not convex."""


@dataclass(frozen=True, eq=False)
class DesignTask(Frozen):
    """A task of the robot that is designed.

    Attributes:
        dynamics: a backend of the robot to begin with; made by ``as_dynamics`` where a robot, its name or its path is
            given. With carriers the task is planned; without, the motion determines the efforts.
        motion: of the platform, as for ``plan_whole_trajectory``; for the objective "time" a path, or a trajectory
            for its path.
        options: keywords of ``plan_whole_trajectory``: objective, limits, mesh, solver and the others. Without carriers
            options of the carriers' motion have no effect. The objective "time" cannot be combined with others; with
            it, the other keywords are for ``plan_time_optimal``.
        weight: of its least cost, relative to the least cost of the initial robot.
    """

    dynamics: Dynamics
    motion: PlatformMotion | TimedTrajectory | Path
    options: Mapping[str, Any] = field(default_factory=dict)
    weight: float = 1.0

    def __post_init__(self) -> None:
        """Choose the backend of a robot."""
        object.__setattr__(self, "dynamics", as_dynamics(self.dynamics))


@dataclass(frozen=True, eq=False)
class CoDesign(Frozen):
    """A machine and its plans.

    Attributes:
        parameters: of the machine, by name.
        plans: of the tasks, by this machine.
        values: (tasks,) least costs, each in the unit of its objective.
        before: (tasks,) the same of the machine to begin with.
        gradient: (tasks, d) derivatives of ``values`` by the parameters.
        at_bounds: parameters that lie on a bound which the cost presses on.
        optimal: whether no small change within the bounds makes the machine better; else the method did not converge.
        history: one record an accepted machine: cost (1 to begin with), and parameters.
        rejected: how many machines were tried that the file makes no robot of, or that a task has no plan for.
    """

    parameters: Mapping[str, float]
    plans: tuple[Plan, ...]
    values: Array
    before: Array
    gradient: Array
    at_bounds: tuple[str, ...]
    optimal: bool
    history: tuple[Mapping[str, float], ...]
    rejected: int


def co_design(
    tasks: Sequence[DesignTask | tuple[Any, ...]],
    design: Mapping[str, tuple[float, float]],
    *,
    iterations: int = 30,
    progress: Callable[[str], None] | None = None,
) -> CoDesign:
    """Design a robot and its motions together: one robot for several tasks, with carriers or without.

    The weighted mean of the tasks' least costs is minimised, each cost divided by the cost of the initial robot. The
    optimum is local, for the robot as for the plans; begin with other robots to find others.

    Args:
        tasks: ``DesignTask``, or its first fields as a tuple: ``(robot, trajectory, {"objective": "peak"})``. Robots of
            several tasks may differ in other quantities (payload, working mode). Each must be loaded from a file.
        design: numbers of the xacro file, with (lowest, highest) values: masses, lengths, offsets of tracks, in the
            unit of the file. The search begins at the values of the robot of the first task, which all get.
        iterations: largest number of robots that are tried after the first.
        progress: called with a line of text after each.

    Raises:
        InputError: no task, an unknown parameter, bounds out of order or without the first value between them; a task
            whose objective is 0.
        UnsupportedRobotError: a parameter that changes joints or their axes, a robot that was not loaded from a file.
        InfeasiblePlanError, UnreachablePoseError, SingularPoseError, WorkingModeError: the robot to begin with cannot
            carry out a task. Without carriers that includes a type II singularity on the way, and an exceeded limit.

    Example:
        >>> turn = rp.trajectory.from_points([[0.0], [2.0 * np.pi]], [0.0, 1.0], ends="rest")
        >>> best = rp.co_design([("four_bar", turn, {"objective": "peak"})], {"rocker_length": (0.2, 0.4)})
        >>> bool(best.values[0] < best.before[0])
        True
    """
    search = Search(_tasks(tasks), design)
    most = whole(iterations, "iterations", 1, 1000)
    here = search.machine(search.start)
    before, bundle = here.values, [here]
    hessian, history, radius, optimal = np.zeros((len(here.u),) * 2), [search.record(here)], _LARGEST, False
    for _ in range(most):
        if progress is not None:
            progress(", ".join(f"{name} {value:.5g}" for name, value in history[-1].items()))
        u, promised = _modelled(here, bundle, hessian, radius)
        if promised <= _STATIONARY * here.cost:
            # a region that has shrunk, as near machines without a plan, promises little for any slopes
            optimal = _modelled(here, bundle, hessian, max(radius, _SEEN))[1] <= _STATIONARY * here.cost
            break
        if not np.isfinite(promised):
            break
        there = search.machine_or_none(u, here)
        if there is None:
            radius *= 0.4
        else:
            bundle.append(there)
            gained = here.cost - there.cost
            if gained >= _DECREASE * promised:
                hessian = _updated(hessian, there.u - here.u, there.slope - here.slope, _STIFFEST * here.cost)
                radius = min(_LARGEST, 2.0 * radius) if gained > 0.5 * promised else radius
                here = there
                history.append(search.record(here))
            elif there.cost + float(there.slope @ (here.u - there.u)) > here.cost:
                radius *= 0.5  # not convex: the slopes there do not bound the cost here
        if radius < _LEAST:
            break
    pressed = zip(search.names, here.at_bound, strict=True)
    return CoDesign(
        parameters=MappingProxyType(here.parameters),
        plans=tuple(cost.plan for cost in here.costs),
        values=frozen(here.values),
        before=frozen(before),
        gradient=frozen(here.gradients),
        at_bounds=tuple(name for name, at in pressed if at),
        optimal=optimal,
        history=tuple(history),
        rejected=search.rejected,
    )


class Search:
    """What the machines of a search have in common. ``rejected``: those that cannot carry out a task."""

    def __init__(self, tasks: Sequence[DesignTask], design: Mapping[str, tuple[float, float]]) -> None:
        first = tasks[0].dynamics.robot
        self.tasks, self.names = tasks, tuple(design)
        self.low, self.high, self.start = _bounds(first, design)
        total = sum(task.weight for task in tasks)
        self.weights = np.array([task.weight / total for task in tasks])
        self.rejected = 0

    def machine(self, u: Array, near: _Machine | None = None) -> _Machine:
        """Plan every task with a machine, (d,) of the ranges, beginning from the plans of one that is near."""
        return self._planned(u, self._robots(u), near)

    def _parameters(self, u: Array) -> dict[str, float]:
        """Return the parameters of a machine by name."""
        return dict(zip(self.names, ((1.0 - u) * self.low + u * self.high).tolist(), strict=True))

    def _robots(self, u: Array) -> tuple[DesignedRobot, ...]:
        """Return the robot of each task, by a machine."""
        own = {id(task.dynamics.robot): task.dynamics.robot for task in self.tasks}
        made = {
            key: DesignedRobot(with_parameters(robot, **self._parameters(u)), self.names)  # type: ignore[arg-type]
            for key, robot in own.items()
        }
        return tuple(made[id(task.dynamics.robot)] for task in self.tasks)

    def _planned(self, u: Array, robots: tuple[DesignedRobot, ...], near: _Machine | None) -> _Machine:
        """Plan every task with the robots of a machine."""
        known = [None] * len(robots) if near is None else near.costs
        costs = tuple(
            least_cost(task.dynamics.for_robot(one.robot), task.motion, task.options, similar)
            for task, one, similar in zip(self.tasks, robots, known, strict=True)
        )
        values = np.array([cost.value for cost in costs])
        if near is None and (values <= 0.0).any():
            raise InputError(
                f"Task {int(values.argmin())} costs nothing with the robot to begin with: its objective is 0.",
                remedy="Choose an objective that its efforts have a part in.",
                name="objective",
            )
        return _Machine(self, u, self._parameters(u), robots, costs, values, values if near is None else near.before)

    def machine_or_none(self, u: Array, near: _Machine) -> _Machine | None:
        """Return a machine, None where the file makes no robot of its numbers or a task has no plan by it."""
        try:
            robots = self._robots(u)
        except NO_ROBOT:  # by number alone: the file and its other arguments have made the first machine
            self.rejected += 1
            return None
        try:
            return self._planned(u, robots, near)
        except NO_MACHINE:
            self.rejected += 1
            return None

    def record(self, machine: _Machine) -> Mapping[str, float]:
        """Return the cost and the parameters of a machine."""
        return MappingProxyType({"cost": machine.cost, **machine.parameters})


@dataclass(frozen=True, eq=False)
class _Machine:
    """A machine at (d,) fractions ``u`` of the ranges, with the least cost of each task."""

    search: Search
    u: Array
    parameters: dict[str, float]
    robots: tuple[DesignedRobot, ...]
    costs: tuple[LeastCost, ...]
    values: Array
    before: Array

    @property
    def cost(self) -> float:
        """Weighted mean of the least costs, each divided by the cost of the initial machine."""
        return float(self.search.weights @ (self.values / self.before))

    @cached_property
    def gradients(self) -> Array:
        """(tasks, d) derivatives of the least costs by the parameters."""
        return np.stack([cost.gradient(robot) for cost, robot in zip(self.costs, self.robots, strict=True)])

    @property
    def slope(self) -> Array:
        """(d,) derivatives of the cost by the fractions of the ranges."""
        slope: Array = (self.search.weights / self.before) @ self.gradients * (self.search.high - self.search.low)
        return slope

    @property
    def at_bound(self) -> BoolArray:
        """(d,) which parameters are on a bound that the cost presses on."""
        pressed: BoolArray = ((self.u <= 0.0) & (self.slope > 0.0)) | ((self.u >= 1.0) & (self.slope < 0.0))
        return pressed


def _tasks(given: Sequence[DesignTask | tuple[Any, ...]]) -> tuple[DesignTask, ...]:
    remedy = "Pass [(robot, trajectory, {...})]."
    require_type(given, Sequence, "A sequence of tasks", remedy)
    for one in given:
        require_type(one, (DesignTask, tuple, list), "A task", remedy)
        if not isinstance(one, DesignTask) and not 2 <= len(one) <= len(fields(DesignTask)):
            raise InputError(f"A task has {len(one)} entries.", remedy=remedy)
    tasks = tuple(one if isinstance(one, DesignTask) else DesignTask(*one) for one in given)
    if not tasks:
        raise InputError("There is no task to design for.", remedy=remedy)
    for task in tasks:
        require_type(task.options, Mapping, "A mapping of a task's options", remedy)
        positive(task.weight, "weight", "")
        objective = Objective.of(task.options.get("objective", "effort"))
        refuse_fields({"calm": "machines are compared by least costs"}, objective)
        planner = plan_time_optimal if objective.weights == TIME else plan_whole_trajectory
        known = {"objective", *inspect.signature(planner).parameters} - {"dynamics", "motion", "path"}
        for name in task.options:
            if name not in known:
                raise InputError(
                    f"A task has the option {shown(name)}.",
                    remedy=f"{did_you_mean(name, known)}Options are objective and the keywords of {planner.__name__}.",
                    name=name,
                )
    return tasks


def _bounds(robot: Robot, design: Mapping[str, tuple[float, float]]) -> tuple[Array, Array, Array]:
    """Return (d,) lowest and highest values, and where between them, 0 to 1, the robot is."""
    remedy = 'Pass design={"carrier_mass": (0.5, 4.0)}.'
    if not design:
        raise InputError("Nothing is to be designed.", remedy=remedy)
    require_type(design, Mapping, "A mapping of parameters to ranges", remedy)
    rows = []
    for name, ends in design.items():
        value = robot.parameters.get(name)
        if value is None or isinstance(value, (bool, str)):
            numbers = [key for key, own in robot.parameters.items() if not isinstance(own, (bool, str))]
            raise InputError(
                f"{robot.name} has no number {shown(name)} to design.",
                remedy=f"{did_you_mean(name, numbers)}It has: {', '.join(numbers) or 'none'}.",
                name=name,
            )
        low, high = checked(ends, f"The range of {name}", (2,)).tolist()
        if not low < high or not low <= value <= high:
            raise InputError(
                f"The range of {name} is {low:g} to {high:g}; the machine to begin with has {value:g}.",
                remedy="Pass (lowest, highest) with that value in between, or begin with another machine.",
                name=name,
            )
        rows.append((low, high, (value - low) / (high - low)))
    lowest, highest, start = np.array(rows).T
    return lowest, highest, start


def _modelled(here: _Machine, bundle: Sequence[_Machine], hessian: Array, radius: float) -> tuple[Array, float]:
    """Return the best (d,) of the model within the trust region, and the decrease of the cost it promises."""
    apart = np.array([here.u - one.u for one in bundle])
    slopes = np.array([one.slope for one in bundle])
    costs = np.array([one.cost for one in bundle])
    error = np.abs(here.cost - costs - (slopes * apart).sum(axis=1))
    error = np.maximum(error, _CONVEX * here.cost * (apart**2).sum(axis=1)) / here.cost
    slopes = slopes / here.cost
    curvature, size = hessian / here.cost, len(here.u)
    ends = [(max(0.0, u - radius) - u, min(1.0, u + radius) - u) for u in here.u]
    result = minimize(
        lambda z: (z[-1] + 0.5 * z[:-1] @ curvature @ z[:-1], np.append(curvature @ z[:-1], 1.0)),
        np.zeros(size + 1),
        jac=True,
        method="SLSQP",
        bounds=[*ends, (None, None)],
        constraints={
            "type": "ineq",
            "fun": lambda z: z[-1] + error - slopes @ z[:-1],
            "jac": lambda z: np.column_stack([-slopes, np.ones(len(error))]),
        },
        options={"ftol": 1e-12, "maxiter": 200},
    )
    if not (result.success or result.fun < 0.0):
        return here.u, np.inf  # no step, but not for want of a promise
    u = here.u + result.x[:-1]
    u = np.where(u < _ON_BOUND, 0.0, np.where(u > 1.0 - _ON_BOUND, 1.0, u))
    return u, -float(result.fun) * here.cost


def _updated(hessian: Array, step: Array, change: Array, most: float) -> Array:
    """Return the next approximation of the Hessian: BFGS, damped and bounded, so that it stays positive definite."""
    if not hessian.any():
        hessian = np.eye(len(step)) * max(float(step @ change) / float(step @ step), 1e-3 * most)
    along = hessian @ step
    curvature, measured = float(step @ along), float(step @ change)
    if measured < 0.2 * curvature:
        share = 0.8 * curvature / (curvature - measured)
        change = share * change + (1.0 - share) * along
    new = hessian - np.outer(along, along) / curvature + np.outer(change, change) / (step @ change)
    values, vectors = np.linalg.eigh(new)
    bounded: Array = (vectors * np.clip(values, 1e-6 * most, most)) @ vectors.T
    return bounded


# --- one machine for all tasks beside one made for each ---------------------------------------------------------------


def compare_machines(
    tasks: Mapping[str, DesignTask],
    design: Mapping[str, tuple[float, float]],
    *,
    iterations: int = 30,
    progress: Callable[[str], None] | None = None,
) -> list[dict[str, Any]]:
    """Return the costs of every task for the initial machine, a machine made for each task, and one for all tasks.

    Args:
        tasks: by name.
        design: as of ``co_design``.
        iterations: the same.
        progress: the same.

    Returns:
        A record for each machine and task: ``machine``, ``task``, ``parameters``, ``mass`` of all that moves, kg,
        ``value`` of the objective, ``peak``, energies, ``carrier_force``, ``stroke``, ``status``, and ``reason``
        without a plan; ``optimal`` and ``search``, the status of the search for the machine: None for the
        initial one.
    """
    first = _tasks(list(tasks.values()))[0].dynamics.robot
    _bounds(first, design)
    makers: dict[str, list[str]] = {"to begin with": [], **{f"for {name}": [name] for name in tasks}}
    if len(tasks) > 1:
        makers["for all"] = list(tasks)
    records: list[dict[str, Any]] = []
    for machine, names in makers.items():
        if progress is not None:
            progress(f"machine {machine}")
        made = (
            co_design([tasks[name] for name in names], design, iterations=iterations, progress=progress)
            if names
            else None
        )
        ended = ResultStatus.OK if made and made.optimal else ResultStatus.NOT_CONVERGED
        search = ended.value if made else None
        parameters = dict(made.parameters) if made else {name: float(first.parameters[name]) for name in design}
        for name, task in tasks.items():
            robot = with_parameters(task.dynamics.robot, **parameters)  # type: ignore[arg-type]
            record: dict[str, Any] = {
                "machine": machine,
                "task": name,
                **parameters,
                "mass": pin.computeTotalMass(robot.model),
                "value": None,
                "status": ResultStatus.INFEASIBLE.value,
                "reason": None,
                "optimal": made and made.optimal,
                "search": search,
            }
            if made and name in names:
                plan, value = made.plans[names.index(name)], float(made.values[names.index(name)])
            else:
                try:
                    cost = least_cost(task.dynamics.for_robot(robot), task.motion, task.options)
                except NO_MACHINE as error:
                    records.append({**record, "reason": error.message})
                    continue
                plan, value = cost.plan, cost.value
            records.append({**record, "value": value, **_numbers(plan)})
    return records


def _numbers(plan: Plan) -> dict[str, Any]:
    """Return a plan in numbers: largest effort and force at the samples, energies, J, and the carriers' stroke."""
    return {
        "peak": float(plan.peak_effort_at_samples.max()),
        "energy": plan.main_energy + plan.carrier_energy,
        "main_energy": plan.main_energy,
        "carrier_energy": plan.carrier_energy,
        "carrier_force": float(np.abs(plan.carrier_force).max(initial=0.0)),
        "stroke": float(np.ptp(plan.carriers.s, axis=0).max(initial=0.0)),
        "status": plan.status.value,
    }
