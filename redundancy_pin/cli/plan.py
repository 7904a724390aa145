"""``redundancy-pin plan``: carrier motion and efforts along a platform motion."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import click

from redundancy_pin.cli.options import RobotOptions, backend_option, json_option, robot_options
from redundancy_pin.cli.output import progress
from redundancy_pin.cli.plan_output import print_plan, require_outputs, warn, write_outputs
from redundancy_pin.cli.plan_parameters import PARAMETERS, PREFIX, flags_of, planner_options
from redundancy_pin.cli.plan_problem import STEP, Problem, problem
from redundancy_pin.cli.plan_problem_file import read_problem
from redundancy_pin.cli.plan_trajectory import FLAGS, parse_trajectory, trajectory_options
from redundancy_pin.cli.wording import KEYS, OPTIONS, in_words
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.plan import PlanStatus
from redundancy_pin.studies.case import RNEA
from redundancy_pin.trajectory import Trajectory, from_csv

BREAKS_LIMITS = 3
"""Exit code where there is a plan, but it breaks limits of the carriers or needs unbounded efforts."""

NOT_OPTIMAL = 4
"""Exit code where there is a plan that keeps all limits, but the optimiser stopped before it had an optimum."""

EXIT_CODES = {PlanStatus.WITHIN_LIMITS: 0, PlanStatus.STOPPED_EARLY: NOT_OPTIMAL}
"""Exit code of each status that has one of its own; the others are ``BREAKS_LIMITS``."""


def _output_options(command: Callable[..., Any]) -> Callable[..., Any]:
    command = json_option(command)
    command = click.option("--plot", metavar="PICTURE", help="Draw the plan (.png, .svg or .pdf).")(command)
    return click.option("--out", metavar="NPZ", help="Where the plan goes; `load_plan` reads it.")(command)


def _shared_options(command: Callable[..., Any]) -> Callable[..., Any]:
    return robot_options()(backend_option(RNEA)(trajectory_options(_output_options(command))))


@click.group(invoke_without_command=True)
@click.option("--problem", "problem_path", metavar="YAML", help="Problem file; docs/problem.yaml explains its keys.")
@_output_options
@click.pass_context
def plan(
    context: click.Context, problem_path: str | None, out: str | None, plot: str | None, as_json: bool
) -> int | None:
    r"""Plan the motion of the carriers.

    By one of the planners below, or as a problem file says. Exit codes: 0 the plan keeps all limits; 3 there is a plan
    and it is written, but it breaks limits or needs unbounded efforts (one line on stderr says which); 4 there is a
    plan and it is written, but the optimiser stopped before it had an optimum; 2 bad input, or no plan exists.

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
        with in_words(KEYS.knowing({name: name for names in PARAMETERS.values() for name in names})):
            return _run(lambda: read_problem(path), out, plot, as_json, inputs=(path,))
    if problem_path or out or plot or as_json:
        raise InputError(
            "Options before the name of the planner belong to --problem.",
            remedy=f"Write them after {context.invoked_subcommand}, or leave the planner out.",
        )
    return None


@plan.command("switch-off")
@_shared_options
@planner_options("switch-off")
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
@planner_options("stepwise")
@click.option("--step", type=float, metavar="SECONDS", help=f"Length of the steps.  [default: {STEP:g}]")
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


@plan.command("whole-trajectory")
@_shared_options
@planner_options("whole-trajectory")
def whole_trajectory(**given: Any) -> int:
    r"""Least effort over the whole motion.

    Carriers and main actuators are planned together: the motors stay on, through singularities too, and every limit of
    track, speed, acceleration, jerk, effort and carrier force is kept. Where nothing keeps them all, the error says
    which limit is in the way, when, and how much would suffice. Needs the extra `optimal`.

    \b
    Examples:
      redundancy-pin plan whole-trajectory --robot 2rpr --trajectory circle --speed 0.5 \
          --objective effort --objective peak=2 --out plan.npz --plot plan.png
      redundancy-pin plan whole-trajectory --robot 3rrr --mode +++ --trajectory corner --radius 0.013 \
          --max-effort 8 --max-jerk 200 --json
    """
    return _from_flags("whole-trajectory", given)


def _from_flags(planner: str, given: Mapping[str, Any]) -> int:
    motion_path = given["motion_path"]
    robot = RobotOptions(given["robot"], given["settings"], given["mode"], given["gravity"])
    settings = given.get("baseline", ())
    baseline = replace(robot, settings=(*robot.settings, *settings)) if settings else None
    parameters = {name.removeprefix(PREFIX): value for name, value in given.items() if name.startswith(PREFIX)}

    def read() -> Problem:
        motion = _motion(given["trajectory"], motion_path, {flag: given[flag] for flag in FLAGS})
        backend, step = given["backend"], given.get("step")
        return problem(planner, robot, backend, motion, parameters, baseline=baseline, step=step)

    with in_words(OPTIONS.knowing(flags_of(planner))):
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
        found = asked.solve(lambda text: advance(1, 3, text))
        advance(2, 3, "writing")
        write_outputs(found, out, plot)
    print_plan(found, out, plot, as_json=as_json)
    warn(found)
    return EXIT_CODES.get(found.status, BREAKS_LIMITS)
