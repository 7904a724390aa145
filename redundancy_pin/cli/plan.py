"""``redundancy-pin plan``: carrier motion and efforts along a platform motion."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import click

from redundancy_pin.cli.options import RobotOptions, json_option, robot_options
from redundancy_pin.cli.output import progress
from redundancy_pin.cli.plan_output import print_plan, require_outputs, warn, write_outputs
from redundancy_pin.cli.plan_problem import PLANNERS, STEP, Problem, problem
from redundancy_pin.cli.plan_problem_file import read_problem
from redundancy_pin.cli.plan_trajectory import FLAGS, parse_trajectory, trajectory_options
from redundancy_pin.errors import InputError
from redundancy_pin.experiments.backends import BACKENDS, RNEA
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.plan import PlanStatus
from redundancy_pin.trajectory import Trajectory, from_csv

BREAKS_LIMITS = 3
"""Exit code where there is a plan, but it breaks limits of the carriers or needs unbounded efforts."""

_PREFIX = "parameter_"
"""Of the arguments that are parameters of a planner: the speed of a trajectory is not that of a carrier."""


def _output_options(command: Callable[..., Any]) -> Callable[..., Any]:
    command = json_option(command)
    command = click.option("--plot", metavar="PICTURE", help="Draw the plan (.png, .svg or .pdf).")(command)
    return click.option("--out", metavar="NPZ", help="Where the plan goes; `load_plan` reads it.")(command)


def _shared_options(command: Callable[..., Any]) -> Callable[..., Any]:
    command = trajectory_options(_output_options(command))
    command = click.option(
        "--backend", type=click.Choice(list(BACKENDS)), default=RNEA, show_default=True, help="How to compute."
    )(command)
    return robot_options()(command)


@click.group(invoke_without_command=True)
@click.option("--problem", "problem_path", metavar="YAML", help="Problem file; docs/problem.yaml explains its keys.")
@_output_options
@click.pass_context
def plan(
    context: click.Context, problem_path: str | None, out: str | None, plot: str | None, as_json: bool
) -> int | None:
    r"""Plan the motion of the carriers.

    By one of the planners below, or as a problem file says. Exit codes: 0 the plan keeps all limits; 3 there is a plan
    and it is written, but it breaks limits or needs unbounded efforts (one line on stderr says which); 2 bad input, or
    no plan exists.

    \b
    Examples:
      redundancy-pin plan switch-off --robot 2rpr --trajectory circle --speed 0.6 \
          --threshold 7 --out plan.npz --plot plan.png
      redundancy-pin plan --problem problem.yaml --out plan.npz
    """
    if context.invoked_subcommand is None:
        if problem_path is None:
            raise InputError("There is nothing to plan.", remedy="Name a planner, or give --problem.")
        path = problem_path
        return _run(lambda: read_problem(path), out, plot, as_json, inputs=(path,))
    if problem_path or out or plot or as_json:
        raise InputError(
            "Options before the name of the planner belong to --problem.",
            remedy=f"Write them after {context.invoked_subcommand}, or leave the planner out.",
        )
    return None


def _parameter(planner: str, flag: str, name: str, metavar: str, text: str) -> Callable[..., Any]:
    """Return a flag for a parameter of a planner, with the planner's own default in its help."""
    default = inspect.signature(PLANNERS[planner]).parameters[name].default
    said = "" if default is None else f"  [default: {default}]"
    return click.option(flag, f"{_PREFIX}{name}", metavar=metavar, help=f"{text}{said}")


@plan.command("switch-off")
@_shared_options
@_parameter("switch-off", "--threshold", "threshold", "NUMBER", "Measure beyond which the actuators are off.")
@_parameter("switch-off", "--measure", "measure", "WORD", "condition (number of W), or margin.")
@_parameter("switch-off", "--ramp-down", "ramp_down", "SECONDS", "Duration of the ramp to zero.")
@_parameter("switch-off", "--return-time", "return_time", "SECONDS", "Duration of the return, or shortest.")
@_parameter("switch-off", "--datum", "datum", "S[,S...]", "Where the carriers park, m.")
@_parameter("switch-off", "--dt", "dt", "SECONDS", "Spacing of the samples of the plan.")
@_parameter("switch-off", "--scheme", "scheme", "WORD", "integration, or backward_differences as in the thesis.")
def switch_off(**given: Any) -> int:
    r"""Cross singularities with the actuators off.

    Wherever the condition number exceeds the threshold the main efforts are zero, and the carriers' inertia drives the
    platform (Parsa 2014, chapter 3).

    \b
    Example:
      redundancy-pin plan switch-off --robot 2rpr --trajectory circle --speed 0.6 \
          --threshold 7 --return-time shortest --out plan.npz --plot plan.png
    """
    return _from_flags("switch-off", given)


@plan.command("stepwise")
@_shared_options
@_parameter("stepwise", "--lam", "lam", "NUMBER", "Fraction of the baseline effort to aim at, 0 to 1.")
@click.option(
    "--baseline",
    multiple=True,
    metavar="NAME=VALUE",
    help="Parameters that make the robot its own baseline: carriers=false.",
)
@click.option("--step", type=float, metavar="SECONDS", help=f"Length of the steps.  [default: {STEP:g}]")
@_parameter("stepwise", "--active", "active", "WORD", "always, or accelerating: only while the platform accelerates.")
@_parameter("stepwise", "--max-speed", "speed", "V[,V...]", "Limit of the carriers in place of theirs, m/s.")
@_parameter("stepwise", "--max-acceleration", "acceleration", "A[,A...]", "The same, m/s².")
@_parameter("stepwise", "--track", "track", "LOWER,UPPER", "Ends of the tracks in place of theirs, m.")
@_parameter("stepwise", "--return-time", "return_time", "SECONDS", "Duration of a return, or shortest.")
@_parameter("stepwise", "--start", "start", "S[,S...]", "Where the carriers start, m.")
@_parameter("stepwise", "--datum", "datum", "S[,S...]", "Where the carriers return to, m.")
@_parameter("stepwise", "--stop", "stop", "WORD", "When the carriers come to rest: after the motion, or within it.")
@_parameter("stepwise", "--brake-time", "brake_time", "SECONDS", "Time to brake the carriers in.")
@click.option(
    "--anticipate/--no-anticipate",
    f"{_PREFIX}anticipate",
    default=None,
    help="Keep carriers able to stop before their track ends.  [default: --anticipate]",
)
def stepwise(**given: Any) -> int:
    r"""Least torque around corners, step by step.

    In every step the carriers' accelerations minimise the distance of the main efforts from a fraction of those of a
    baseline robot, within the limits of the carriers (Parsa 2014, chapter 4).

    \b
    Example:
      redundancy-pin plan stepwise --robot 3rrr --mode +++ --trajectory corner --radius 0.025 \
          --lam 0.5 --baseline carriers=false --out plan.npz
    """
    return _from_flags("stepwise", given)


def _from_flags(planner: str, given: Mapping[str, Any]) -> int:
    motion_path = given["motion_path"]
    robot = RobotOptions(given["robot"], given["settings"], given["mode"], given["gravity"])
    settings = given.get("baseline", ())
    baseline = replace(robot, settings=(*robot.settings, *settings)) if settings else None
    parameters = {name.removeprefix(_PREFIX): value for name, value in given.items() if name.startswith(_PREFIX)}

    def read() -> Problem:
        motion = _motion(given["trajectory"], motion_path, {flag: given[flag] for flag in FLAGS})
        backend, step = given["backend"], given.get("step")
        return problem(planner, robot, backend, motion, parameters, baseline=baseline, step=step)

    return _run(read, given["out"], given["plot"], given["as_json"], inputs=(motion_path,) if motion_path else ())


def _motion(
    trajectory: str | None, motion_path: str | None, flags: Mapping[str, float | None]
) -> PlatformMotion | Trajectory:
    if (trajectory is None) == (motion_path is None):
        raise InputError("A plan needs either --trajectory or --motion.", remedy="Give one of them.")
    if motion_path is None:
        return parse_trajectory(str(trajectory), flags)
    useless = [name for name, value in flags.items() if value is not None]
    if useless:
        raise InputError(
            f"--{useless[0].replace('_', '-')} does not apply to a motion from a file.", remedy="Leave it out."
        )
    return from_csv(motion_path)


def _run(
    read: Callable[[], Problem], out: str | None, plot: str | None, as_json: bool, *, inputs: tuple[str, ...]
) -> int:
    """Read, plan, write, print; return the exit code."""
    require_outputs(out, plot, inputs)
    with progress("plan") as advance:
        advance(0, 3, "reading")
        asked = read()
        advance(1, 3, asked.planner)
        found = asked.solve()
        advance(2, 3, "writing")
        write_outputs(found, out, plot)
    print_plan(found, out, plot, as_json=as_json)
    warn(found)
    return 0 if found.status is PlanStatus.WITHIN_LIMITS else BREAKS_LIMITS
