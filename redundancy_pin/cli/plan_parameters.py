"""Parameters of the planners, declared once: from here come the flags, the keys of problem files and the help."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar

import click

from redundancy_pin.cli.keys import require_known
from redundancy_pin.cli.plan_values import Reader, flag, number, number_or_word, numbers, weights, whole, word
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise import plan_stepwise
from redundancy_pin.planners.switch_off import plan_switch_off
from redundancy_pin.planners.whole_trajectory import plan_whole_trajectory

_Command = TypeVar("_Command", bound=Callable[..., Any])

PLANNERS: Mapping[str, Callable[..., Plan]] = {
    "switch-off": plan_switch_off,
    "stepwise": plan_stepwise,
    "whole-trajectory": plan_whole_trajectory,
}
"""Planners, by the name the command line uses."""

PREFIX = "parameter_"
"""Of the arguments that are parameters of a planner: the speed of a trajectory is not that of a carrier."""


@dataclass(frozen=True)
class Parameter:
    """How users write a parameter of a planner.

    Attributes:
        read: from the value as written to the one the planner takes.
        metavar: stands for the value in the help.
        text: what it is, for the help.
        flag: on the command line; made from the name when left out.
        multiple: whether the flag may be repeated.
    """

    read: Reader
    metavar: str
    text: str
    flag: str = ""
    multiple: bool = False


_MAX_SPEED = Parameter(numbers, "V[,V...]", "Limit of the carriers in place of theirs, m/s.", "--max-speed")
_MAX_ACCELERATION = Parameter(numbers, "A[,A...]", "The same, m/s².", "--max-acceleration")
_TRACK = Parameter(numbers, "LOWER,UPPER", "Ends of the tracks in place of theirs, m.")
_START = Parameter(numbers, "S[,S...]", "Where the carriers start, m.")

SWITCH_OFF: Mapping[str, Parameter] = {
    "threshold": Parameter(number, "NUMBER", "Measure beyond which the actuators are off."),
    "measure": Parameter(word, "WORD", "condition (number of W), or margin."),
    "ramp_down": Parameter(number, "SECONDS", "Duration of the ramp to zero."),
    "return_time": Parameter(number_or_word, "SECONDS", "Duration of the return, or shortest."),
    "datum": Parameter(numbers, "S[,S...]", "Where the carriers park, m."),
    "dt": Parameter(number, "SECONDS", "Spacing of the samples of the plan."),
    "scheme": Parameter(word, "WORD", "integration, or backward_differences as in the thesis."),
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
    "between": Parameter(whole, "N", "Points inside each step at which the efforts are checked as well."),
}
"""Parameters of ``plan_stepwise``, but for the baseline, which is a robot."""

WHOLE_TRAJECTORY: Mapping[str, Parameter] = {
    "objective": Parameter(
        weights,
        "WORD[=WEIGHT]",
        "What to minimise: effort, peak, tracking, carrier_force, carrier_acceleration, effort_rate, energy; may be "
        "repeated.",
        multiple=True,
    ),
    "lam": Parameter(number, "NUMBER", "Fraction of the baseline effort that tracking aims at, 0 to 1."),
    "start": Parameter(numbers, "S[,S...]", "Where the carriers start, m; at the datum when left out."),
    "start_speed": Parameter(numbers, "V[,V...]", "Their speeds there, m/s."),
    "end": Parameter(word, "WORD", "How they end: free, rest, datum (at rest there), or periodic."),
    "datum": Parameter(numbers, "S[,S...]", "Where the carriers park, m."),
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

PARAMETERS: Mapping[str, Mapping[str, Parameter]] = {
    "switch-off": SWITCH_OFF,
    "stepwise": STEPWISE,
    "whole-trajectory": WHOLE_TRAJECTORY,
}
"""Parameters by planner."""

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


def read_parameters(planner: str, given: Mapping[str, object]) -> dict[str, Any]:
    """Return the parameters of a planner, each as the kind of value it is.

    Args:
        planner: a key of ``PARAMETERS``.
        given: values as written; None, or nothing of what may be repeated, for those left out.

    Raises:
        InputError: an unknown parameter, or a value of the wrong kind.
    """
    known = PARAMETERS[planner]
    require_known(given, tuple(known), f"the planner {planner}")
    return {name: known[name].read(name, value) for name, value in given.items() if value is not None and value != ()}


def planner_options(planner: str) -> Callable[[_Command], _Command]:
    """Add the flags of a planner's parameters to a command, with the planner's own defaults in the help."""

    def decorate(command: _Command) -> _Command:
        if planner in WITH_BASELINE:
            command = click.option(
                "--baseline",
                multiple=True,
                metavar="NAME=VALUE",
                help="Parameters that make the robot its own baseline: carriers=false.",
            )(command)
        for name, parameter in reversed(list(PARAMETERS[planner].items())):
            command = _option(planner, name, parameter)(command)
        return command

    return decorate


def _option(planner: str, name: str, parameter: Parameter) -> Callable[[_Command], _Command]:
    default = inspect.signature(PLANNERS[planner]).parameters[name].default
    written = _flag(name, parameter)
    if "/" in written:
        said = written.partition("/")[0 if default else 2]
        return click.option(written, f"{PREFIX}{name}", default=None, help=f"{parameter.text}  [default: {said}]")
    said = "" if default is None else f"  [default: {default}]"
    return click.option(
        written,
        f"{PREFIX}{name}",
        metavar=parameter.metavar,
        multiple=parameter.multiple,
        help=f"{parameter.text}{said}",
    )
