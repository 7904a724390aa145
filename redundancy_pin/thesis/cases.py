"""The cases of the reproduction: a robot, a trajectory and what moves the carriers; and how much of it all is run."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product
from typing import Any, Literal, NamedTuple, TypeAlias

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
from redundancy_pin.simulation.replay import DRIVES, Drive
from redundancy_pin.trajectory import Trajectory
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.reference import TRAJECTORIES

Mode: TypeAlias = tuple[int, ...]
"""Working mode, ±1 per leg."""

Options: TypeAlias = tuple[tuple[str, Any], ...]
"""Keyword arguments as sorted pairs: cases are hashable and go to other processes."""

Planner = Literal["none", "parked", "switch_off", "stepwise", "whole_trajectory", "time_optimal"]
"""What moves the carriers: "none", there are none; "parked", they stay at s = 0; or a planner."""


def options(**values: Any) -> Options:
    """Return keyword arguments as the options of a case; mappings become pairs, which are hashable."""
    hashable = {name: tuple(value.items()) if isinstance(value, dict) else value for name, value in values.items()}
    return tuple(sorted(hashable.items()))


@functools.cache
def _load(robot: str, working_mode: Mode, arguments: Options) -> Robot:
    # once per process: constraint models do not pickle, and loading takes longer than many plans
    return load_with(robot, dict(arguments), working_mode=working_mode or None)


@functools.cache
def _dynamics(backend: str, *machine: Any) -> Dynamics:
    return BACKENDS[backend](_load(*machine))


@dataclass(frozen=True)
class Case:
    """A robot, its motion, and the planner of its carriers.

    Attributes:
        name: unique among the cases of a table, and the stem of files.
        robot: shipped name.
        path: name of the trajectory in ``TRAJECTORIES``.
        path_options: its arguments, m, m/s, s, rad.
        planner: what moves the carriers.
        options: of the planner, fields of groups and its keywords (``in_groups``).
        working_mode: ±1 per leg; as declared if empty.
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
        known = self.robot in ("2rpr", "3rrr") and self.load_robot().closed_form
        return (VIRTUAL_WORK, RNEA) if known else (RNEA,)

    @property
    def unit(self) -> str:
        """Unit of the main efforts."""
        return "N" if self.robot == "2rpr" else "N·m"

    def option(self, name: str, default: Any = None) -> Any:
        """Return an option of the planner or, if it has none of that name, of the path."""
        return dict(self.path_options + self.options).get(name, default)

    def with_options(self, name: str = "", /, **changed: Any) -> Case:
        """Return the case with other options of its planner, and another name."""
        return replace(self, name=name or self.name, options=options(**{**dict(self.options), **changed}))

    def with_path(self, **changed: Any) -> Case:
        """Return the case with other options of its trajectory."""
        return replace(self, path_options=options(**{**dict(self.path_options), **changed}))

    @property
    def _machine(self) -> tuple[str, Mode, Options]:
        without = {"carriers": False} if self.planner == "none" else {}
        return self.robot, self.working_mode, options(**{**dict(self.arguments), **without})

    def load_robot(self) -> Robot:
        """Return the robot with its own limits, loaded once."""
        return _load(*self._machine)

    def dynamics(self, backend: str | None = None) -> Dynamics:
        """Return its dynamics by a backend (the first of ``backends`` when left out), made once."""
        return _dynamics(backend or self.backends[0], *self._machine)

    def trajectory(self) -> Trajectory:
        """Make the reference trajectory; InputError if the ramps do not fit."""
        return TRAJECTORIES[self.path](**dict(self.path_options))

    def plan(self, backend: str | None = None) -> Plan:
        """Plan the case; errors as the planners."""
        dynamics, trajectory, given = self.dynamics(backend), self.trajectory(), dict(self.options)
        if self.planner in ("none", "parked"):
            return self._at_rest(dynamics, trajectory)
        for name in ("objective", "at_most"):
            if not isinstance(given.get(name, ""), str):
                given[name] = dict(given[name])
        motion: Any = trajectory
        if self.planner == "time_optimal":
            motion = trajectory.path
        elif self.planner == "stepwise":
            motion = trajectory.sample(self.dt)
            # a robot that can be loaded without its carriers is its own baseline
            if isinstance(self.load_robot().parameters.get("carriers"), bool):
                given["baseline"] = without_carriers(self).dynamics(backend)
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
        pairs = {name: dict(getattr(self, name)) for name in ("arguments", "path_options", "options")}
        return {"robot": self.robot, "working_mode": self.working_mode, "carriers": self.planner, "path": self.path,
                "dt": self.dt, **pairs}  # fmt: skip


def without_carriers(case: Case) -> Case:
    """Return the same motion, at the same samples, of the machine without carriers."""
    return replace(case, planner="none", options=())


def parked(case: Case) -> Case:
    """Return the same motion with the carriers parked at s = 0."""
    return replace(case, planner="parked", options=())


def motion_name(case: Case) -> str:
    """Return the name of a motion without the part about its carriers: ``"corner-r0.025"``."""
    return case.name.rpartition("-")[0]


# --- plans, each made once -----------------------------------------------------------------------------------------

Call: TypeAlias = tuple[Any, ...]
"""A label for the progress, a function of a module, and its arguments, which are hashable."""


def call_of(case: Case, backend: str | None = None) -> Call:
    """Return the call that plans a case, by its first backend when left out; name and title do not matter."""
    return (case.name, plan_or_error, replace(case, name="", title=""), backend or case.backends[0])


def plan_or_error(case: Case, backend: str) -> Plan | InfeasiblePlanError:
    """Return the plan of a case, or the error if there is none."""
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
        """Return the plan of a case, or the error if there is none; by the first backend when left out."""
        outcome: Plan | InfeasiblePlanError = self.result(*call_of(case, backend))
        return outcome

    def plan(self, case: Case) -> Plan:
        """Return the plan of a case; InfeasiblePlanError if there is none."""
        outcome = self.outcome(case)
        if isinstance(outcome, InfeasiblePlanError):
            raise outcome
        return outcome


def _numbered(index: int, function: Callable[..., Any], *arguments: Any) -> tuple[int, Any]:
    return index, function(*arguments)


# --- the cases -----------------------------------------------------------------------------------------------------

FIRST_MODE: Mode = (1, 1, 1)
"""Working mode of the 3-RRR in the figures; the thesis does not state it."""

ALL_MODES: tuple[Mode, ...] = tuple(product((1, -1), repeat=3))

# The 2-RPR of the thesis is massless except for its carriers: without them every force is zero, so it has no baseline.
_CIRCLE = Case("circle-0.5-parked", "2rpr", "circle", options(speed=0.5), working_mode=(1, 1),
               title="2-RPR, circle at 0.5 m/s")  # fmt: skip
_FAST, _SLOW, _LINE = (
    replace(_CIRCLE, name=f"{path}-{speed:g}-parked", path=path, path_options=options(speed=speed),
            title=f"2-RPR, {path} at {speed:g} m/s")
    for path, speed in (("circle", 0.75), ("line", 0.1), ("line", 0.2))
)  # fmt: skip
_WIDE, _SHARP = (
    Case(f"corner-r{radius:g}-baseline", "3rrr", "corner", options(radius=radius), "none", working_mode=FIRST_MODE,
         title=f"3-RRR, corner of radius {radius:g} m")
    for radius in (0.025, 0.013)
)  # fmt: skip
_SQUARE = replace(_WIDE, name="square-baseline", path="square", path_options=(), title="3-RRR, square")

MOTIONS: tuple[Case, ...] = (
    *(_CIRCLE, _FAST, _SLOW, _LINE),
    *(each for case in (_WIDE, _SHARP, _SQUARE)
      for each in (case, replace(parked(case), name=f"{motion_name(case)}-parked"))),
)  # fmt: skip
"""Every motion of the thesis with carriers parked, and without carriers."""


def _off(case: Case, threshold: float) -> Case:
    """Return a crossing by switching off; the thesis does not state the time in which the carriers return."""
    ramp = 0.03 if case.path == "circle" else 0.36
    off = replace(case, name=f"{motion_name(case)}-cn{threshold:g}", planner="switch_off")
    return off.with_options(return_time=0.4, threshold=threshold, ramp_down=ramp)


def _stepwise(case: Case, lam: float, **more: Any) -> Case:
    """Return a stepwise plan; the thesis states neither its time step nor the time in which the carriers return."""
    step = replace(case, name=f"{motion_name(case)}-lam{lam:g}", planner="stepwise", dt=5e-3)
    return step.with_options(lam=lam, return_time=0.6, **more)  # on the square 0.65 s lie before the first corner


CROSSINGS: tuple[Case, ...] = (
    _off(_CIRCLE, 5.0), _off(_CIRCLE, 10.0), _off(_CIRCLE, 20.0), _off(_FAST, 5.0),
    _off(_SLOW, 4.0), _off(_LINE, 4.0), _off(_LINE, 15.0),
)  # fmt: skip
"""Crossings whose results the thesis shows; its threshold at 0.1 m/s is not stated: 4 as at 0.2 m/s."""

CORNERS: tuple[Case, ...] = (
    *(_stepwise(case, lam) for case in (_WIDE, _SHARP) for lam in (0.0, 0.5)),
    *(_stepwise(_SQUARE, lam, active="accelerating") for lam in (0.5, 0.0)),
)
"""Stepwise plans whose results the thesis shows, and λ = 0.5 at the sharper corner."""

_MASSES = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}
_WITH_MASSES = "2-RPR with masses (end-effector 0.5 kg, cylinders 0.3 kg)"

# Ramps of these circles have the 3-4-5 shape, v T / 2 long, and not the thesis's that overshoots.
_ROUND = replace(CROSSINGS[0].with_path(ramp_time=0.2, ramp_length=0.05), name="circle-0.5")
SINGULAR: tuple[Case, ...] = (
    _ROUND,
    replace(CROSSINGS[3].with_path(ramp_time=0.2, ramp_length=0.075), name="circle-0.75"),
    replace(_ROUND, name="heavy-0.5", arguments=options(**_MASSES), title=f"{_WITH_MASSES}, circle at 0.5 m/s"),
    replace(CROSSINGS[4], name="line-0.1"),
    replace(CROSSINGS[5], name="line-0.2"),
    replace(CROSSINGS[0], name="five-bar-0.3", robot="five_bar", working_mode=(1, -1), path="polygon",
            arguments=options(carriers=True), title="five-bar, straight down through its singularity at 0.3 m/s",
            path_options=options(vertices=((0.25, 0.6), (0.32, 0.3)), radius=0.01, speed=0.3, ramp_time=0.2)),
)  # fmt: skip
"""Motions through type II singularities; the descent of the five-bar is a line without a corner."""

TURNS: tuple[Case, ...] = (
    replace(CORNERS[0], name="corner-r0.025"),
    replace(CORNERS[2], name="corner-r0.013"),
    replace(CORNERS[5], name="square", title="3-RRR, square with corners of radius 0.025 m"),
)
"""Motions of chapter 4, far from singularities."""

TASKS: tuple[Case, ...] = (*SINGULAR, *TURNS)
"""Motions that are planned by every method."""

HEAVY_CROSSING = replace(CROSSINGS[0], name="circle-0.5-heavy", arguments=options(end_effector_mass=0.5))
"""With the mass of the 3-RRR's platform."""

HEAVY_LINE = replace(CROSSINGS[5], name="heavy-line-0.2", arguments=options(**_MASSES),
                     title=f"{_WITH_MASSES}, line at 0.2 m/s")  # fmt: skip

MODE_CASES: tuple[Case, ...] = (
    *CORNERS[:4],
    CORNERS[2].with_options("corner-r0.013-lam0-a12", acceleration=12.0),
    *CORNERS[4:],
    CORNERS[5].with_options("square-lam0-v1.2", speed=1.2),
)
"""Stepwise plans that are made in every working mode; the thesis raises the limits in two of them."""

BY_NAME: Mapping[str, Case] = {case.name: case for case in (*MOTIONS, *CROSSINGS, *CORNERS)}


CENTRE = (0.866, 0.5, 0.0)
"""Centre of the base of the 3-RRR, m, about which moments are taken."""


def _future() -> dict[str, dict[str, Case]]:
    circle = Case("2rpr", "2rpr", "circle", options(speed=0.5, ramp_time=0.2), "whole_trajectory", dt=0.02)
    corner = Case("3rrr", "3rrr", "corner", options(radius=0.025, speed=0.2, ramp_time=0.4), "whole_trajectory",
                  working_mode=FIRST_MODE, dt=0.02)  # fmt: skip
    wide = corner.with_options(track=(-1.0, 1.0), speed=5.0, acceleration=20.0)
    balanced = wide.with_options(objective="base_wrench", base_point=CENTRE)
    none, fast = replace(without_carriers(corner), dt=2e-3), corner.with_path(speed=0.4)
    timed = replace(wide.with_options(effort=3.03), planner="time_optimal")  # N·m: its largest at 0.2 m/s, no carriers
    gough = Case("gough", "gough", "pose", options(start=(0.0, 0.0, 0.6, 0.0, 0.0, 0.573576436, 0.819152044),
                 end=(0.0, 0.0, 0.6, 0.0, 0.0, 0.819152044, 0.573576436)), "whole_trajectory", dt=0.05,
                 arguments=options(carriers=True),
                 title="Gough platform through the type II pose at 90° of yaw, under gravity")  # fmt: skip
    delta = Case("delta", "delta", "points", options(points=((-0.04, 0.02, -0.25), (0.05, 0.0, -0.05)), speed=0.6,
                 ramp_time=0.2), "whole_trajectory", dt=0.02, arguments=options(rod_carriers=True, rod_length=0.35),
                 title="delta through the plane of its elbows, under gravity")  # fmt: skip

    def of(case: Case, **arguments: Any) -> Case:
        return replace(case, arguments=options(**arguments))

    return {
        "2-RPR circle, 0.5 kg at the end-effector": {
            "least effort, carriers on the legs": of(circle, end_effector_mass=0.5),
            "least effort, carriers on the end-effector": of(
                circle, end_effector_mass=0.5, carriers=False, end_effector_carriers=True
            ),
            "least effort, carriers on arms of 0.3 m": of(circle, end_effector_mass=0.5, arm_length=0.3),
        },
        "3-RRR corner, carriers on arms of 0.3 m": {"least effort": of(corner, arm_length=0.3)},
        "3-RRR corner at twice the feed": {
            "no carriers": replace(without_carriers(fast), dt=2e-3),
            "machine of co-design, least peak": replace(
                of(fast, carrier_mass=0.6, tail_length=0.56), dt=0.01
            ).with_options(objective="peak", speed=5.0, acceleration=60.0),
        },
        "3-RRR corner, front of peak over energy": {
            f"least peak with at most {energy} J": wide.with_options(
                objective="peak", at_most={"energy": float(energy)}
            )
            for energy in (2, 3, 4)
        },
        "3-RRR corner, balanced": {
            "no carriers": none,
            "least effort, parked at the end": wide,
            "least base wrench, parked at the end": balanced,
            "least base wrench, free end": balanced.with_options(end="free"),
        },
        "Gough platform, 70 to 110° of yaw": {"least effort": gough},
        "delta, through the plane of its elbows": {"least effort": delta},
        "3-RRR corner, least time": {
            "no carriers": replace(of(corner, carriers=False).with_options(effort=3.03), planner="time_optimal"),
            "parked before, free after": timed.with_options(end="free"),
            "at rest before and after": timed.with_options(begin="rest", end="rest"),
        },
    }


FUTURE: Mapping[tuple[str, str], Case] = {
    (task, method): case for task, methods in _future().items() for method, case in methods.items()
}
"""Future work that the thesis names, by task and method."""

# --- methods -------------------------------------------------------------------------------------------------------

NONE, PARKED, MOVING = "no carriers", "carriers parked", "carriers moving"
SWITCH_OFF, SWITCH_OFF_LATE = "switching off", "switching off late"
STEPWISE, STEPWISE_HALF = "stepwise λ = 0", "stepwise λ = 0.5"
EFFORT, PEAK, PEAK_FREE = "whole trajectory: effort", "whole trajectory: peak", "whole trajectory: peak (end free)"
ENERGY, SMOOTH = "whole trajectory: energy", "whole trajectory: smooth effort"

SMOOTHING = 0.01
"""Weight of ∫ Σ τ̇² dt relative to the effort in smooth plans."""

OBJECTIVES: Mapping[str, tuple[tuple[str, float], ...]] = {
    EFFORT: (("effort", 1.0),),
    PEAK: (("peak", 1.0),),
    PEAK_FREE: (("peak", 1.0),),
    ENERGY: (("energy", 1.0),),
    SMOOTH: (("effort", 1.0), ("effort_rate", SMOOTHING)),
}
"""What each method of the whole-trajectory planner minimises."""

LATE = 20.0
"""Condition number, the largest of the thesis, beyond which the motors are off in the second way of switching off."""

STEP = 5e-3
"""Largest step between nodes, s."""

_NODES = {"line-0.1": 2e-2, "line-0.2": 1e-2, "heavy-line-0.2": 1e-2}
"""The same on slow motions, s."""

_ENERGY_COARSER = 2.0
"""Factor on the step of plans of least energy: absolute values are many rows for the solver."""


def crosses(task: Case) -> bool:
    """Return whether a task crosses a type II singularity."""
    return task.planner == "switch_off"


def methods(task: Case) -> tuple[str, ...]:
    """Return the methods by which a task is carried out, in the order of the tables."""
    if crosses(task):
        return (SWITCH_OFF, SWITCH_OFF_LATE, EFFORT, PEAK, SMOOTH)
    whole = (EFFORT, PEAK, PEAK_FREE, ENERGY) if task.path == "corner" else (EFFORT, PEAK)
    return (NONE, PARKED, STEPWISE, STEPWISE_HALF, *whole)


def by_method(task: Case, method: str, coarser: float = 1.0) -> Case:
    """Return a task by one of ``methods``; its name is the stem of the files of the plan.

    ``coarser`` is a factor on the largest step between the nodes of whole-trajectory plans.
    """
    if method in OBJECTIVES:
        objective = OBJECTIVES[method]
        name = "-".join([task.name, *(quantity for quantity, _ in objective)])
        step = coarser * _NODES.get(task.name, STEP) * (_ENERGY_COARSER if method == ENERGY else 1.0)
        whole = replace(task, name=name, planner="whole_trajectory", dt=step, options=options(objective=objective))
        return whole.with_options(f"{name}-end-free", end="free") if method == PEAK_FREE else whole
    if crosses(task):
        named = replace(task, name=f"{task.name}-{method.replace(' ', '-')}")
        return named.with_options(threshold=LATE) if method == SWITCH_OFF_LATE else named
    stepwise = task.with_options(lam=0.5 if method == STEPWISE_HALF else 0.0)
    return {NONE: without_carriers(task), PARKED: parked(task)}.get(method, stepwise)


def at_speed(case: Case, speed: float) -> Case:
    """Return a case at another speed, ramps as long in time."""
    own = dict(case.path_options)
    length = own.get("ramp_length")
    scaled = {} if length is None else {"ramp_length": length * speed / own["speed"]}
    return case.with_path(speed=speed, **scaled)


# --- how much is run -----------------------------------------------------------------------------------------------

SPARSE = 5e-3
"""Distance of the samples of replayed switch-off plans, s: the same motion of the carriers, five times faster."""

_LIGHT, _HEAVY, _FIVE_BAR = SINGULAR[0], SINGULAR[2], SINGULAR[5]


class Replayed(NamedTuple):
    """A task by a method, and the drives that replay its plan."""

    task: Case
    method: str
    drives: tuple[Drive, ...] = DRIVES

    @property
    def name(self) -> str:
        """Unique, for tables."""
        return f"{self.task.name}, {self.method}"

    def case(self, coarser: float) -> Case:
        """Return the case whose plan is replayed."""
        planned = by_method(self.task, self.method, coarser)
        return replace(planned, dt=SPARSE) if self.method == SWITCH_OFF else planned


REPLAYED: tuple[Replayed, ...] = (
    Replayed(_LIGHT, SWITCH_OFF, ("open loop", "carriers by motion")),
    Replayed(_LIGHT, EFFORT, ("open loop",)),
    *(Replayed(task, method) for task in (_HEAVY, HEAVY_LINE, _FIVE_BAR) for method in (SWITCH_OFF, EFFORT)),
    *(Replayed(TURNS[0], method) for method in (STEPWISE, STEPWISE_HALF, EFFORT)),
    *(Replayed(task, method) for task in TURNS[1:] for method in (STEPWISE, EFFORT)),
)

TRADED: tuple[Case, ...] = (_LIGHT, TURNS[0])
"""Tasks whose effort is traded against the carriers' acceleration."""

CHAPTERS = ("planned", "beyond", "future", "replay")


@dataclass(frozen=True)
class Extent:
    """How much of the reproduction is run; the plans that the thesis shows are always made.

    Attributes:
        motions: run without a planner.
        chapters: of ``CHAPTERS``, besides these motions.
        samples: random states of each robot in the cross-check before the job.
        figures: whether all figures are drawn, or only those on the first page of the report.
        parity: plans of the thesis that both backends make.
        modes: working modes of the 3-RRR to compare; the figures show the first one.
        whole_grids: whether to vary what the thesis leaves unstated over whole grids, or only at their ends.
        coarser: factor on the largest step between nodes of every whole-trajectory plan.
        tolerance: width of the bracket of the fastest motion, as a fraction of the speed.
        starts: first guesses in the search for other optima, and for a plan at a speed where one failed.
        starts_coarser, started: factor on the step, and tasks, of plans from several first guesses.
        ratios: weights of the carriers' acceleration in the trade-off of ``TRADED``, over the one at which both parts
            of the cost are the same for the plan of least effort; no trade-off without any.
        races: tasks whose greatest speed is bracketed, from a speed that has a plan.
        compared: whole-trajectory plans, by task and method, that both backends make.
        future: plans of future work, by task and method.
        replayed: plans that are replayed.
        jobs: processes; -1 for all cores.
        name: what results call this extent.
    """

    motions: tuple[Case, ...] = MOTIONS
    chapters: tuple[str, ...] = CHAPTERS
    samples: int = 2000
    figures: bool = True
    parity: tuple[Case, ...] = (*CROSSINGS, *CORNERS)
    modes: tuple[Mode, ...] = ALL_MODES
    whole_grids: bool = True
    coarser: float = 1.0
    tolerance: float = 1e-2
    starts: int = 5
    starts_coarser: float = 2.0
    started: tuple[Case, ...] = (_LIGHT, _HEAVY, _FIVE_BAR, *TURNS[:2])
    ratios: tuple[float, ...] = (0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0, 1e3)
    races: tuple[Case, ...] = (_LIGHT, _HEAVY, SINGULAR[4])
    compared: tuple[tuple[Case, str], ...] = tuple((task, method) for task in TASKS for method in (EFFORT, PEAK))
    future: tuple[tuple[str, str], ...] = tuple(FUTURE)
    replayed: tuple[Replayed, ...] = REPLAYED
    jobs: int = -1
    name: str = "full"

    @property
    def complete(self) -> bool:
        """Whether all working modes and all values of the grids are tried, so that all statements can be judged."""
        return self.whole_grids and self.modes == ALL_MODES


FULL = Extent()

QUICK = Extent(
    motions=tuple(replace(case, dt=2e-3) for case in MOTIONS if case.name != "line-0.1-parked"),
    samples=100, figures=False, parity=(CROSSINGS[0], CORNERS[0]), modes=(FIRST_MODE,), whole_grids=False, coarser=4.0,
    tolerance=0.1, starts=2, starts_coarser=6.0, started=(_LIGHT,), ratios=(), races=(SINGULAR[4],),
    compared=((SINGULAR[4], EFFORT), (TURNS[0], EFFORT)),
    future=tuple(key for key in FUTURE if key[0].startswith(("Gough", "delta", "3-RRR corner, balanced"))),
    replayed=(Replayed(_LIGHT, SWITCH_OFF, ("open loop",)), Replayed(_HEAVY, SWITCH_OFF),
              Replayed(TURNS[0], EFFORT, ("open loop",))),
    jobs=1, name="quick",
)  # fmt: skip
"""Coarse, for a look and for tests: one working mode, the ends of the grids, a massless, a missing and a cornering
replay, no trade-off, and the figures of the first page."""
