"""What to plan: a robot, a motion, a planner and its parameters."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, TypeVar

import click
import numpy as np

from redundancy_pin.arrays import decimal, frozen
from redundancy_pin.cli import options
from redundancy_pin.cli.errors import KEYS
from redundancy_pin.dynamics.backends import BACKENDS
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InputError, RedundancyPinError, shown
from redundancy_pin.io.yaml_file import read_yaml
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.optimal import OBJECTIVES
from redundancy_pin.planners.options import CALM, FEWEST_STEPS, GROUPS, LARGEST_STEP
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.planners.registry import PLANNERS, in_groups
from redundancy_pin.planners.switch_off.planner import SPACING, plan_switch_off
from redundancy_pin.robot import Robot
from redundancy_pin.robot.shipped import source_in
from redundancy_pin.trajectory import Trajectory
from redundancy_pin.trajectory.trajectory import Ends

Reader = Callable[[str, object], Any]
"""From the name of a parameter and the value as written to the value the planner takes; InputError where it is none."""


def _refuse(name: str, value: object, expected: str, example: str) -> InputError:
    return InputError(f"{name} is {shown(value)}, {expected}.", remedy=f"Write {example}.", name=name)


def number(name: str, value: object) -> float:
    """Return a number; text with one is accepted (YAML reads ``1e-3`` as text)."""
    try:
        if not isinstance(value, bool) and isinstance(value, (int, float, str)):
            return decimal(value) if isinstance(value, str) else float(value)
    except (ValueError, OverflowError):
        pass
    raise _refuse(name, value, "not a number", "a number, such as 0.5 (SI units)")


def numbers(name: str, value: object) -> Any:
    """Return a number, or an array of the numbers of nested lists or of text such as ``0.1,-0.1``."""
    if isinstance(value, str) and "," in value:
        value = [part.strip() for part in value.split(",")]
    if not isinstance(value, list):
        return number(name, value)
    rows = [numbers(name, entry) for entry in value]
    if len({np.shape(row) for row in rows}) != 1:
        raise _refuse(name, value, "not a row of numbers", "[0.1, -0.1]")
    return frozen(rows)


def whole(name: str, value: object) -> int:
    """Return a whole number."""
    result = number(name, value)
    if not result.is_integer():
        raise _refuse(name, value, "not a whole number", "a number such as 4")
    return int(result)


def word(name: str, value: object) -> str:
    """Return a word as it stands."""
    if not isinstance(value, str):
        raise _refuse(name, value, "not a word", "text")
    return value


def number_or_word(name: str, value: object) -> float | str:
    """Return a number, or the word as it stands (the planner knows which words it takes)."""
    try:
        return number(name, value)
    except InputError:
        if isinstance(value, str):
            return value
        raise


def flag(name: str, value: object) -> bool:
    """Return a truth value."""
    if not isinstance(value, bool):
        raise _refuse(name, value, "neither true nor false", "true or false")
    return value


def weights(name: str, value: object) -> str | dict[str, float]:
    """Return one word, or the weights of several: from a mapping, or from words such as ``effort`` and ``peak=2``."""
    if isinstance(value, Mapping):
        return {str(key): number(f"the weight of {key}", weight) for key, weight in value.items()}
    words = [value] if isinstance(value, str) else value
    if not isinstance(words, Sequence) or not all(isinstance(entry, str) for entry in words):
        raise _refuse(name, value, "neither a word nor weights", "effort, or {effort: 1, peak: 2}")
    if len(words) == 1 and "=" not in words[0]:
        return str(words[0])
    result: dict[str, float] = {}
    for entry in words:
        key, separator, weight = (part.strip() for part in entry.partition("="))
        if key in result:
            raise InputError(f"{name} has {shown(key)} twice.", remedy="Leave one of them out.", name=name)
        result[key] = number(f"the weight of {key}", weight) if separator else 1.0
    return result


_Command = TypeVar("_Command", bound=Callable[..., Any])


_LEFT_OUT = {"dt": LARGEST_STEP, "steps": FEWEST_STEPS, "calm": CALM}
"""What planners take for fields of a group whose default is None."""

PREFIX = "parameter_"
"""Of the arguments that are parameters of a planner: the speed of a trajectory is not that of a carrier."""


@dataclass(frozen=True)
class Parameter:
    """How users write a parameter of a planner: how its value is read, its help, and a flag that is not its name."""

    read: Reader
    metavar: str
    text: str
    flag: str = ""
    multiple: bool = False


_MAX_SPEED = Parameter(numbers, "V[,V...]", "Limit of the carriers in place of theirs, m/s.", "--max-speed")
_MAX_ACCELERATION = Parameter(numbers, "A[,A...]", "The same, m/s².", "--max-acceleration")
_TRACK = Parameter(numbers, "LOWER,UPPER", "Ends of the tracks in place of theirs, m.")
_BASE_POINT = Parameter(numbers, "X,Y,Z", "Point about which the moment on the base is taken, m.")
_START = Parameter(numbers, "S[,S...]", "Where the carriers start, m.")

SWITCH_OFF: Mapping[str, Parameter] = {
    "threshold": Parameter(number, "NUMBER", "Measure beyond which the actuators are off."),
    "measure": Parameter(word, "WORD", "condition (number of W), or margin."),
    "ramp_down": Parameter(number, "SECONDS", "Duration of the ramp to zero."),
    "return_time": Parameter(number_or_word, "SECONDS", "Duration of the return, or shortest."),
    "datum": Parameter(numbers, "S[,S...]", "Where the carriers park, m."),
    "dt": Parameter(number, "SECONDS", "Spacing of the samples of the plan."),
}
"""Parameters of ``plan_switch_off``."""

STEPWISE: Mapping[str, Parameter] = {
    "lam": Parameter(number, "NUMBER", "Fraction of the baseline effort to aim at, 0 to 1."),
    "active": Parameter(word, "WORD", "always, or accelerating: only while the platform accelerates."),
    "speed": _MAX_SPEED,
    "acceleration": _MAX_ACCELERATION,
    "track": _TRACK,
    "return_time": Parameter(number_or_word, "SECONDS", "Duration of a return, or shortest."),
    "start": _START,
    "datum": Parameter(numbers, "S[,S...]", "Where the carriers return to, m."),
    "stop": Parameter(word, "WORD", "When the carriers come to rest: after the motion, or within it."),
    "brake_time": Parameter(number, "SECONDS", "Time to brake the carriers in."),
    "anticipate": Parameter(
        flag, "", "Keep carriers able to stop before their track ends.", "--anticipate/--no-anticipate"
    ),
    "least_margin": Parameter(number, "NUMBER", "Smallest margin of W along the motion."),
}
"""Parameters of ``plan_stepwise``, but for the baseline, which is a robot."""

WHOLE_TRAJECTORY: Mapping[str, Parameter] = {
    "objective": Parameter(
        weights, "WORD[=WEIGHT]", f"What to minimise: {', '.join(OBJECTIVES)}; may be repeated.", multiple=True
    ),
    "lam": Parameter(number, "NUMBER", "Fraction of the baseline effort that tracking aims at, 0 to 1."),
    "base_point": _BASE_POINT,
    "calm": Parameter(
        number, "FRACTION", "What fewer reversals of the efforts may cost, of the least cost; 0: nothing."
    ),
    "start": Parameter(numbers, "S[,S...]", "Where the carriers start, m; at the datum when left out."),
    "start_speed": Parameter(numbers, "V[,V...]", "Their speeds there, m/s."),
    "end": Parameter(word, "WORD", "How they end: free, rest, datum (at rest there), or periodic."),
    "datum": Parameter(numbers, "S[,S...]", "Where the carriers park, m."),
    "at_most": Parameter(
        weights, "WORD=VALUE", "Bound of an objective beside the one that is minimised; may be repeated.", multiple=True
    ),
    "track": _TRACK,
    "speed": _MAX_SPEED,
    "acceleration": _MAX_ACCELERATION,
    "jerk": Parameter(numbers, "J[,J...]", "Limit of the carriers' jerk, m/s³.", "--max-jerk"),
    "effort": Parameter(numbers, "E[,E...]", "Limit of the main efforts, N or N·m.", "--max-effort"),
    "carrier_force": Parameter(numbers, "F[,F...]", "Limit of the carriers' forces, N.", "--max-carrier-force"),
    "dt": Parameter(number, "SECONDS", "Largest step between nodes."),
    "starts": Parameter(whole, "N", "First guesses to optimise from."),
    "seconds": Parameter(number, "SECONDS", "Time bound of each solution."),
    "refinements": Parameter(whole, "N", "How often the nodes may be refined."),
}
"""Parameters of ``plan_whole_trajectory``, but for the baseline, which is a robot."""

TIME_OPTIMAL: Mapping[str, Parameter] = {
    "effort": WHOLE_TRAJECTORY["effort"],
    "actuator_speed": Parameter(numbers, "V[,V...]", "Limit of the main actuators' rates, m/s or rad/s."),
    "begin": Parameter(word, "WORD", "How the carriers begin: datum (at rest there), rest, or free."),
    "end": WHOLE_TRAJECTORY["end"],
    "datum": WHOLE_TRAJECTORY["datum"],
    "lap": Parameter(flag, "", "The platform goes round and round.", "--lap/--no-lap"),
    **{name: WHOLE_TRAJECTORY[name] for name in ("track", "speed", "acceleration", "jerk", "carrier_force")},
    "steps": Parameter(whole, "N", "Least number of steps."),
    **{name: WHOLE_TRAJECTORY[name] for name in ("seconds", "refinements")},
}
"""Parameters of ``plan_time_optimal``."""

ONLINE: Mapping[str, Parameter] = {
    "horizon": Parameter(number, "SECONDS", "How far ahead the path is known."),
    "step": Parameter(number, "SECONDS", "Between the nodes of a plan."),
    "objective": Parameter(word, "WORD", "peak, or effort."),
    **{name: WHOLE_TRAJECTORY[name] for name in ("track", "speed", "acceleration", "jerk", "effort", "carrier_force")},
    "slow_down": Parameter(flag, "", "Go more slowly where no plan keeps every limit.", "--slow-down/--full-speed"),
}
"""Parameters of ``RecedingHorizon``."""

PARAMETERS: Mapping[str, Mapping[str, Parameter]] = {
    "switch-off": SWITCH_OFF,
    "stepwise": STEPWISE,
    "whole-trajectory": WHOLE_TRAJECTORY,
    "time-optimal": TIME_OPTIMAL,
    "online": ONLINE,
}
"""Parameters by planner, that of a tick among them."""

WITH_BASELINE = ("stepwise", "whole-trajectory")
"""Planners that can aim at a fraction of the efforts of a baseline robot."""


def flags_of(planner: str) -> Mapping[str, str]:
    """Return the flag of each parameter of a planner; of a truth value both, as ``--on/--off``.

    The steps of a stepwise plan have one too, though the command makes them itself.
    """
    flags = {name: _flag(name, parameter) for name, parameter in PARAMETERS[planner].items()}
    others = {make.__name__: f"`plan {name}`" for name, make in PLANNERS.items()}
    return {**others, **({"dt": "--step"} if planner == "stepwise" else {}), **flags}


def _flag(name: str, parameter: Parameter) -> str:
    return parameter.flag or f"--{name.replace('_', '-')}"


def parameters_of(given: Mapping[str, Any]) -> dict[str, object]:
    """Return the parameters among the arguments of a command, as written; see ``planner_options``."""
    return {name.removeprefix(PREFIX): value for name, value in given.items() if name.startswith(PREFIX)}


def read_parameters(planner: str, given: Mapping[str, object]) -> dict[str, Any]:
    """Return the parameters of a planner, each as the kind of value it is."""
    known = PARAMETERS[planner]
    options.require_known(given, tuple(known), f"the planner {planner}")
    return {name: known[name].read(name, value) for name, value in given.items() if value is not None and value != ()}


def planner_options(planner: str) -> Callable[[_Command], _Command]:
    """Add the flags of a planner's parameters to a command, with the planner's own defaults in the help."""

    def decorate(command: _Command) -> _Command:
        if planner in WITH_BASELINE:
            text = "Parameters that make the robot its own baseline: carriers=false."
            command = options.settings_option("--baseline", "baseline", text)(command)
        for name, parameter in reversed(list(PARAMETERS[planner].items())):
            command = _option(planner, name, parameter)(command)
        return command

    return decorate


def _option(planner: str, name: str, parameter: Parameter) -> Callable[[_Command], _Command]:
    default = _default(RecedingHorizon if planner == "online" else PLANNERS[planner], name)
    # None stands for "not given": the planner's own default applies, and the help shows it
    written = _flag(name, parameter)
    if "/" in written:
        shown = written.partition("/")[0 if default else 2]
        return click.option(written, f"{PREFIX}{name}", default=None, help=f"{parameter.text}  [default: {shown}]")
    shown = "" if default is None else f"  [default: {default}]"
    return click.option(
        written,
        f"{PREFIX}{name}",
        metavar=parameter.metavar,
        multiple=parameter.multiple,
        help=f"{parameter.text}{shown}",
    )


def _default(make: Callable[..., Any], name: str) -> object:
    """Return the default of a parameter: the planner's own, or that of the group that has it."""
    own = inspect.signature(make).parameters
    if name in own:
        return own[name].default
    default = next(
        one.default for group in GROUPS.keys() & own.keys() for one in fields(GROUPS[group]) if one.name == name
    )
    return SPACING if make is plan_switch_off and name == "dt" else _LEFT_OUT.get(name, default)


@dataclass(frozen=True, eq=False)
class PlanProblem:
    """Everything a planner needs.

    ``parameters`` are as ``in_groups`` takes them, ``followed`` says what the motion is, ``ends`` are those of a
    motion through points.
    """

    planner: str
    dynamics: Dynamics
    motion: PlatformMotion | Trajectory
    parameters: Mapping[str, Any]
    followed: str = ""
    ends: Ends | None = None

    def solve(self, progress: Callable[[str], None] | None = None) -> Plan:
        """Return the plan; planners that have stages call ``progress`` with a line of text at each."""
        make = PLANNERS[self.planner]
        extra = {"progress": progress} if progress and "solver" in inspect.signature(make).parameters else {}
        return make(self.dynamics, self.motion, **in_groups(make, {**self.parameters, **extra}))


def problem(
    planner: str,
    robot: Robot,
    backend: str | None,
    motion: PlatformMotion | Trajectory,
    parameters: Mapping[str, object],
    *,
    baseline: options.RobotOptions | None = None,
    step: float | None = None,
) -> PlanProblem:
    """Put a problem together from what flags or a file say, its parameters as written.

    The ``baseline`` is the robot of whose efforts a plan aims at a fraction; ``step`` is the length of the steps of a
    stepwise plan along a trajectory, s.
    """
    values = read_parameters(planner, parameters)
    if backend is not None:
        options.require_choice(backend, tuple(BACKENDS), "the backend")
    for name, given, takers in (("baseline", baseline, WITH_BASELINE), ("step", step, ("stepwise",))):
        if given is not None and planner not in takers:
            only = f"Only {' and '.join(takers)} {'does' if len(takers) == 1 else 'do'}."
            raise InputError(f"The planner {planner} takes no {name}.", remedy=only, name=name)
    if values.get("lam", 0.0) > 0.0 and baseline is None:
        raise InputError(
            f"lam = {values['lam']:g} asks for a fraction of the efforts of a baseline robot, and none is given.",
            remedy="Write --baseline carriers=false: the same robot without carriers.",
        )
    ends = None if planner == "time-optimal" else getattr(motion, "ends", None)  # its path alone counts there
    # the other planners choose their own samples of a trajectory; the steps of this one are samples
    if planner == "stepwise" and isinstance(motion, Trajectory):
        motion = motion.sample(options.STEP if step is None else step)
    elif step is not None:
        raise InputError("A motion from a file has its own steps.", remedy="Leave the step out, or resample the file.")
    if baseline is not None:
        with _about(_BASELINE):
            values["baseline"] = options.dynamics_of(baseline.load(), backend)
    return PlanProblem(planner, options.dynamics_of(robot, backend), motion, values, ends=ends)


_ROBOT_KEYS = ("robot", "set", "mode", "gravity")
_KEYS = ("planner", *_ROBOT_KEYS, "backend", "trajectory", "motion", "check_rates", "step", "parameters", "baseline")


WORDING = KEYS.knowing({name: name for names in PARAMETERS.values() for name in names})
"""How a problem file writes what the package has names for."""


def read_problem(path: str | Path, *, trust: bool = False) -> PlanProblem:
    """Read a problem file.

    Robots and motions given by path are looked for from the folder of the file. ``trust``, as for ``load_robot``, is
    said by who reads it, not by the file. Errors are in the words of the file, and begin with its name and the line
    they are about.
    """
    place = Path(path)
    file = read_yaml(place, InputError, "The problem ")
    data = file.data
    if not isinstance(data, Mapping):
        raise InputError(f"{path} holds no mapping of keys.", remedy=f"Its keys: {', '.join(_KEYS)}.", path=str(path))
    try:
        return _problem(data, place, trust)
    except RedundancyPinError as error:
        details = error.details if isinstance(error, InputError) else {}  # the robot's own files have keys of their own
        key = str(next((details[word] for word in ("key", "name", "argument") if word in details), ""))
        # the same name may stand in several mappings; a baseline has the settings of the robot beside its own
        group = str(details.get(_GROUP, ""))
        groups = (group, f"{group}set.", *(("", "set.") if group == _BASELINE else ()))
        where = file.place(next((each + key for each in groups if each + key in file.lines), group + key))
        told = WORDING.reword(error)
        raise type(told)(f"{where}: {told.message}", remedy=told.remedy, **told.details) from error


_GROUP, _BASELINE = "group", "baseline."


@contextmanager
def _about(group: str) -> Iterator[None]:
    """Let errors of bad input say which mapping of the file they are about."""
    try:
        yield
    except InputError as error:
        inner = error.details.get(_GROUP, "")
        raise type(error)(error.message, remedy=error.remedy, **{**error.details, _GROUP: f"{group}{inner}"}) from error


def _problem(data: Mapping[str, Any], place: Path, trust: bool) -> PlanProblem:
    options.require_known(data, _KEYS, f"the problem {place.name}")
    for key in ("planner", "robot"):
        if key not in data:
            raise InputError(f"The problem {place.name} lacks the key {key!r}.", remedy=f"Add {key}: ....", key=key)
    planner = options.require_choice(data["planner"], tuple(PLANNERS), "the planner")
    loaded = replace(_robot(data, place.parent), trust=trust).load()
    motion, followed = _motion(data, place, loaded)
    parameters = _mapping(data.get("parameters", {}), "parameters")
    with _about("parameters."):
        read_parameters(planner, parameters)
    baseline = None
    if data.get("baseline") is not None:
        given = _mapping(data["baseline"], "baseline")
        with _about(_BASELINE):
            baseline = replace(_baseline(given, data, place.parent), trust=trust)
    task = problem(
        planner,
        loaded,
        None if data.get("backend") is None else word("backend", data["backend"]),
        motion,
        parameters,
        baseline=baseline,
        step=None if data.get("step") is None else number("step", data["step"]),
    )
    return replace(task, followed=followed)


def _motion(data: Mapping[str, Any], path: Path, robot: Robot) -> tuple[PlatformMotion | Trajectory, str]:
    """Return the motion, and what it is."""
    if ("trajectory" in data) == ("motion" in data):
        raise InputError(
            f"The problem {path.name} needs either a trajectory or a motion.",
            remedy="Write trajectory: {name: circle, speed: 0.6}, or motion: file.csv.",
        )
    if "motion" in data:
        check = data.get("check_rates", True)
        if not isinstance(check, bool):
            raise InputError(f"check_rates is {shown(check)}.", remedy="Write true or false.", key="check_rates")
        chosen = options.MotionOptions(str(path.parent / word("motion", data["motion"])), check)
        return chosen.follow("A plan", robot), chosen.described
    given = dict(_mapping(data["trajectory"], "trajectory", "{name: circle, speed: 0.6}, or {name: points.csv}"))
    if "name" not in given:
        raise InputError("The trajectory lacks the key 'name'.", remedy="Write {name: circle, speed: 0.6}.")
    name = given.pop("name")
    with _about("trajectory."):
        if options.is_points_file(name):
            name = str(path.parent / name)
            chosen = options.MotionOptions(name, check_rates=True)
            if chosen.is_sampled:
                options.require_known(given, (), f"the file {name}, which has rates,")
                return chosen.follow("A plan", robot), chosen.described
        return options.make_trajectory(name, given, robot), str(data["trajectory"]["name"])


def _robot(data: Mapping[str, Any], folder: Path) -> options.RobotOptions:
    """Return the robot options of a mapping."""
    mode, gravity = data.get("mode"), data.get("gravity")
    settings = _mapping(data.get("set", {}), "set")
    for name, value in settings.items():
        if not isinstance(value, (bool, int, float, str)):
            remedy = "Write a number, true, false or text."
            raise InputError(f"{name} in `set` is {shown(value)}.", remedy=remedy, key=f"set.{name}")
    return options.RobotOptions(
        source_in(folder, word("robot", data["robot"])),
        dict(options.parse_setting(f"{name}={value}") for name, value in settings.items()),  # YAML reads 1e-3 as text
        None if mode is None else options.parse_mode(word("mode", mode)),
        None if gravity is None else options.parse_vector(gravity),
    )


def _baseline(given: Mapping[str, Any], data: Mapping[str, Any], folder: Path) -> options.RobotOptions:
    """Return the baseline robot: the robot of the problem, with what ``baseline`` says in place of its own."""
    options.require_known(given, _ROBOT_KEYS, "the baseline")
    # another robot has other parameters and modes: nothing of the first one's is taken over
    own = {} if "robot" in given else {key: data[key] for key in _ROBOT_KEYS if key in data}
    settings = {**_mapping(own.get("set", {}), "set"), **_mapping(given.get("set", {}), "set")}
    return _robot({**own, **given, "set": settings}, folder)


def _mapping(value: object, name: str, form: str = "{key: value}") -> Mapping[str, Any]:
    if not isinstance(value, Mapping):
        raise InputError(f"{name} is {shown(value)}, not a mapping.", remedy=f"Write {name}: {form}.", key=name)
    return value
