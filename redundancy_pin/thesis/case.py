"""One case of a study: a robot, a trajectory, and who plans its carriers; and the memo that makes each plan once."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping, Sequence
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
from redundancy_pin.planners.stepwise.planner import plan_stepwise
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import Trajectory
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.reference import TRAJECTORIES

Mode: TypeAlias = tuple[int, ...]
"""Working mode, ±1 a leg."""

Options: TypeAlias = tuple[tuple[str, Any], ...]
"""Keyword arguments as sorted pairs: cases are hashable and go to other processes."""


Planner = Literal["none", "parked", "switch_off", "stepwise", "whole_trajectory"]
"""What moves the carriers: none, as there are none; nothing, as they stay at s = 0; or a planner."""


def options(**values: Any) -> Options:
    """Return keyword arguments as the options of a case; lists and mappings become tuples, which are hashable."""
    return tuple(sorted((name, _hashable(value)) for name, value in values.items()))


def _hashable(value: Any) -> Any:
    if isinstance(value, Mapping):
        return tuple((key, _hashable(entry)) for key, entry in value.items())
    return tuple(_hashable(entry) for entry in value) if isinstance(value, (list, tuple)) else value


@functools.cache
def load(robot: str, working_mode: Mode = (), arguments: Options = ()) -> Robot:
    """Load a robot once per process: constraint models do not pickle, and loading takes longer than many plans."""
    return load_with(robot, dict(arguments), working_mode=working_mode or None)


@functools.cache
def _dynamics(backend: str, *machine: Any) -> Dynamics:
    return BACKENDS[backend](load(*machine))


@dataclass(frozen=True)
class Case:
    """A robot, its motion, and who plans the carriers. Variations: ``dataclasses.replace`` and the ``with_`` methods.

    Attributes:
        name: unique among the cases of a table, and the stem of files.
        robot: shipped name or path of a declaration.
        path: name of the trajectory in ``TRAJECTORIES``.
        path_options: its arguments, m, m/s, s, rad.
        planner: who moves the carriers.
        options: of the planner, fields of groups and its keywords (``in_groups``); an ``objective`` of several
            weights as pairs.
        working_mode: ±1 a leg; as declared if empty.
        arguments: xacro arguments of the robot.
        dt: sampling interval, time step or largest step between nodes, s.
        two_sided: whether a stepwise plan sees instants at which the acceleration jumps from both sides.
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
    two_sided: bool = True
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

    def with_planner(self, planner: Planner, dt: float | None = None, **changed: Any) -> Case:
        """Return the same motion by another planner, with the options of that planner."""
        return replace(self, planner=planner, options=options(**changed), dt=dt or self.dt)

    def load_robot(self) -> Robot:
        """Return the robot with its own limits, loaded once."""
        return load(*self._machine)

    def dynamics(self, backend: str | None = None) -> Dynamics:
        """Return its dynamics by a backend (the first of ``backends`` when left out), made once."""
        return _dynamics(backend or self.backends[0], *self._machine)

    @property
    def has_baseline(self) -> bool:
        """Whether the robot can be loaded without carriers."""
        return isinstance(self.load_robot().parameters.get("carriers"), bool)

    def trajectory(self) -> Trajectory:
        """Make the reference trajectory; InputError where ramps do not fit in."""
        return TRAJECTORIES[self.path](**dict(self.path_options))

    def plan(self, backend: str | None = None) -> Plan:
        """Plan the case; errors as the planners."""
        dynamics, trajectory, given = self.dynamics(backend), self.trajectory(), dict(self.options)
        if self.planner in ("none", "parked"):
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
        if self.planner == "stepwise" or given.get("lam"):
            given["baseline"] = self._baseline(backend)
        for name in ("objective", "at_most"):
            if not isinstance(given.get(name, ""), str):
                given[name] = dict(given[name])
        if self.planner == "stepwise":
            motion = trajectory.sample(self.dt, two_sided=self.two_sided)
            return plan_stepwise(dynamics, motion, **in_groups(plan_stepwise, given))
        if self.planner == "whole_trajectory":
            # tables state least costs and peaks, and compare them: a calm plan may cost a hundredth more
            given = {"calm": 0.0, **given}
        planner = PLANNERS[self.planner.replace("_", "-")]
        return planner(dynamics, trajectory, **in_groups(planner, {"dt": self.dt, **given}))

    def as_dict(self) -> dict[str, object]:
        """Return the configuration as plain data, for JSON."""
        return {"robot": self.robot, "arguments": dict(self.arguments), "working_mode": list(self.working_mode),
                "carriers": self.planner, "path": self.path, "path_options": dict(self.path_options),
                "options": dict(self.options), "dt": self.dt}  # fmt: skip

    def _baseline(self, backend: str | None) -> Dynamics | None:
        return replace(self, planner="none").dynamics(backend) if self.has_baseline else None

    @property
    def _machine(self) -> tuple[str, Mode, Options]:
        """Arguments of ``load``."""
        without = self.planner == "none"
        arguments = options(**{**dict(self.arguments), "carriers": False}) if without else self.arguments
        return self.robot, self.working_mode, arguments


@dataclass
class Plans:
    """Plans made on demand and kept: chapters, figures and tables share them.

    Cases that differ in name or title alone share a plan.
    """

    _kept: dict[tuple[Case, str], Plan | InfeasiblePlanError] = field(default_factory=dict)

    def outcome(self, case: Case, backend: str | None = None) -> Plan | InfeasiblePlanError:
        """Return the plan of a case, or the error without one; by the first backend of the case when left out."""
        by = backend or case.backends[0]
        key = (replace(case, name="", title=""), by)
        if key not in self._kept:
            self._kept[key] = _outcome(case, by)
        return self._kept[key]

    def prepare(
        self,
        cases: Sequence[tuple[Case, str]],
        jobs: int = -1,
        progress: Callable[[str], None] = lambda _: None,
        *,
        first: Sequence[tuple[Any, ...]] = (),
    ) -> list[Any]:
        """Plan cases by backends in several processes (-1: all cores), and call ``progress`` with the name of each.

        ``first`` are functions with their arguments, called before the plans in the same processes: the longest tasks.
        Returns their results.
        """
        keys = {(replace(case, name="", title=""), backend): case.name for case, backend in cases}
        missing = [key for key in keys if key not in self._kept]
        calls = [*first, *((_outcome, *key) for key in missing)]
        results = parallel(_called, calls, jobs, ordered=True)
        others = [next(results) for _ in first]
        for key, outcome in zip(missing, results, strict=True):
            self._kept[key] = outcome
            progress(keys[key])
        for _ in range(len(cases) - len(missing)):
            progress("plans that were there already")
        return others

    def plan(self, case: Case, backend: str | None = None) -> Plan:
        """Return the plan of a case; InfeasiblePlanError without one."""
        result = self.outcome(case, backend)
        if isinstance(result, InfeasiblePlanError):
            raise result
        return result

    def existing(self, cases: Sequence[Case]) -> list[tuple[Case, Plan]]:
        """Return the cases that have a plan, with it."""
        pairs = [(case, self.outcome(case)) for case in cases]
        return [(case, result) for case, result in pairs if isinstance(result, Plan)]


def _called(function: Callable[..., Any], *given: Any) -> Any:
    return function(*given)


def _outcome(case: Case, backend: str) -> Plan | InfeasiblePlanError:
    try:
        return case.plan(backend)
    except InfeasiblePlanError as error:
        return error
