"""A case: a robot, a trajectory and the planner of its carriers; and the memo that makes each plan once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal, TypeAlias

import numpy as np

from redundancy_pin.dynamics.backends import BACKENDS, RNEA, VIRTUAL_WORK
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.loading import load_with
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.parallel import parallel
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import PlannedMotion
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.registry import PLANNERS, in_groups
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import Trajectory
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.reference import TRAJECTORIES

Mode: TypeAlias = tuple[int, ...]
"""Working mode, ±1 a leg."""

Options: TypeAlias = tuple[tuple[str, Any], ...]
"""Keyword arguments as sorted pairs: cases are hashable and go to other processes."""

Planner = Literal["none", "parked", "switch_off", "stepwise", "whole_trajectory", "time_optimal"]
"""What moves the carriers: "none", there are none; "parked", nothing, they stay at s = 0; or a planner."""


def options(**values: Any) -> Options:
    """Return keyword arguments as the options of a case; lists and mappings become tuples, which are hashable."""
    return tuple(sorted((name, _hashable(value)) for name, value in values.items()))


def _hashable(value: Any) -> Any:
    if isinstance(value, Mapping):
        return tuple((key, _hashable(entry)) for key, entry in value.items())
    return tuple(_hashable(entry) for entry in value) if isinstance(value, (list, tuple)) else value


@functools.cache
def _load(robot: str, working_mode: Mode, arguments: Options) -> Robot:
    # once per process: constraint models do not pickle, and loading takes longer than many plans
    return load_with(robot, dict(arguments), working_mode=working_mode or None)


@functools.cache
def _dynamics(backend: str, *machine: Any) -> Dynamics:
    return BACKENDS[backend](_load(*machine))


@dataclass(frozen=True)
class Case:
    """A robot, its motion, and who plans the carriers. Variations: ``dataclasses.replace`` and the ``with_`` methods.

    Attributes:
        name: unique among the cases of a table, and the stem of files.
        robot: shipped name.
        path: name of the trajectory in ``TRAJECTORIES``.
        path_options: its arguments, m, m/s, s, rad.
        planner: who moves the carriers.
        options: of the planner, fields of groups and its keywords (``in_groups``); an ``objective`` of several
            weights as pairs.
        working_mode: ±1 a leg; as declared if empty.
        arguments: xacro arguments of the robot.
        dt: sampling interval, time step or largest step between nodes, s.
        title: of the motion, for tables and figures.
    """

    name: str
    robot: str
    path: str
    path_options: Options = ()
    planner: Planner = "parked"
    options: Options = ()
    working_mode: Mode = ()
    arguments: Options = ()
    dt: float = 1e-3
    title: str = ""

    @property
    def backends(self) -> tuple[str, ...]:
        """Backends that know the robot; the first one plans."""
        known = self.robot in ("2rpr", "3rrr") and self.load_robot().closed_form  # none with carriers elsewhere
        return (VIRTUAL_WORK, RNEA) if known else (RNEA,)

    @property
    def unit(self) -> str:
        """Unit of the main efforts."""
        return "N" if self.robot == "2rpr" else "N·m"

    def option(self, name: str, default: Any = None) -> Any:
        """Return an option of the planner or, if it has none of that name, of the path."""
        return dict(self.path_options + self.options).get(name, default)

    def with_options(self, **changed: Any) -> Case:
        """Return the case with other options of its planner."""
        return replace(self, options=options(**{**dict(self.options), **changed}))

    def with_path(self, **changed: Any) -> Case:
        """Return the case with other options of its trajectory."""
        return replace(self, path_options=options(**{**dict(self.path_options), **changed}))

    @property
    def _machine(self) -> tuple[str, Mode, Options]:
        without = self.planner == "none"
        arguments = options(**{**dict(self.arguments), "carriers": False}) if without else self.arguments
        return self.robot, self.working_mode, arguments

    def load_robot(self) -> Robot:
        """Return the robot with its own limits, loaded once."""
        return _load(*self._machine)

    def dynamics(self, backend: str | None = None) -> Dynamics:
        """Return its dynamics by a backend (the first of ``backends`` when left out), made once."""
        return _dynamics(backend or self.backends[0], *self._machine)

    def trajectory(self) -> Trajectory:
        """Make the reference trajectory; InputError where ramps do not fit in."""
        return TRAJECTORIES[self.path](**dict(self.path_options))

    def plan(self, backend: str | None = None) -> Plan:
        """Plan the case; errors as the planners."""
        dynamics, trajectory, given = self.dynamics(backend), self.trajectory(), dict(self.options)
        if self.planner in ("none", "parked"):
            return self._at_rest(dynamics, trajectory)
        # a robot that can be loaded without its carriers is its own baseline
        if self.planner == "stepwise" and isinstance(self.load_robot().parameters.get("carriers"), bool):
            given["baseline"] = replace(self, planner="none").dynamics(backend)
        for name in ("objective", "at_most"):
            if not isinstance(given.get(name, ""), str):
                given[name] = dict(given[name])
        motion: Any = trajectory
        if self.planner == "stepwise":
            motion = trajectory.sample(self.dt)
        elif self.planner == "time_optimal":
            motion = trajectory.path
        else:
            given["dt"] = self.dt
        if self.planner == "whole_trajectory":
            given.setdefault("calm", 0.0)  # tables compare least costs and peaks: a calm plan may cost a hundredth more
        planner = PLANNERS[self.planner.replace("_", "-")]
        return planner(dynamics, motion, **in_groups(planner, given))

    def _at_rest(self, dynamics: Dynamics, trajectory: Trajectory) -> Plan:
        """Return the plan of carriers parked at s = 0, or of a machine without carriers."""
        motion, source, k = trajectory.sample(self.dt), as_motion(trajectory), dynamics.robot.k
        parked = PiecewisePolynomial.constant(np.zeros(k), source.start, source.end)
        return finish_plan(
            PlannedMotion(
                dynamics,
                PlanFunctions(source, parked),
                dynamics.along(motion),
                CarrierMotion.parked(len(motion), k),
                Limits().resolved(dynamics.robot),
                "baseline" if self.planner == "none" else "parked",
                phases=("parked",),
                parameters={"dt": self.dt},
            )
        )

    def as_dict(self) -> dict[str, object]:
        """Return the configuration as plain data, for JSON."""
        return {"robot": self.robot, "arguments": dict(self.arguments), "working_mode": list(self.working_mode),
                "carriers": self.planner, "path": self.path, "path_options": dict(self.path_options),
                "options": dict(self.options), "dt": self.dt}  # fmt: skip


Call: TypeAlias = tuple[Any, ...]
"""A label for the progress, a function of a module, and its arguments, which are hashable."""


def call_of(case: Case, backend: str | None = None) -> Call:
    """Return the call that plans a case, by its first backend when left out; name and title do not matter."""
    return (case.name, plan_or_error, replace(case, name="", title=""), backend or case.backends[0])


def plan_or_error(case: Case, backend: str) -> Plan | InfeasiblePlanError:
    """Return the plan of a case, or the error without one."""
    try:
        return case.plan(backend)
    except InfeasiblePlanError as error:
        return error


@dataclass
class Plans:
    """Results of calls, kept: chapters, figures and tables share the plans."""

    _kept: dict[Call, Any] = field(default_factory=dict)

    def result(self, _: str, *call: Any) -> Any:
        """Return the result of a call, made on demand."""
        if call not in self._kept:
            function, *arguments = call
            self._kept[call] = function(*arguments)
        return self._kept[call]

    def prepare(self, calls: Iterable[Call], jobs: int = -1, progress: Callable[[str], None] = lambda _: None) -> None:
        """Make calls in several processes (-1: all cores), in their order; ``progress`` gets the label of each."""
        labels = {call[1:]: call[0] for call in calls}
        missing = [call for call in labels if call not in self._kept]
        for index, result in parallel(_numbered, [(i, *call) for i, call in enumerate(missing)], jobs):
            self._kept[missing[index]] = result
            progress(labels[missing[index]])

    def outcome(self, case: Case, backend: str | None = None) -> Plan | InfeasiblePlanError:
        """Return the plan of a case, or the error without one; by the first backend of the case when left out."""
        outcome: Plan | InfeasiblePlanError = self.result(*call_of(case, backend))
        return outcome

    def plan(self, case: Case, backend: str | None = None) -> Plan:
        """Return the plan of a case; InfeasiblePlanError without one."""
        outcome = self.outcome(case, backend)
        if isinstance(outcome, InfeasiblePlanError):
            raise outcome
        return outcome


def _numbered(index: int, function: Callable[..., Any], *arguments: Any) -> tuple[int, Any]:
    return index, function(*arguments)
