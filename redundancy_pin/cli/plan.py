"""``redundancy-pin plan``: carrier motion and efforts along a platform motion."""

from __future__ import annotations

import inspect
import shlex
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import click

from redundancy_pin.cli import options, output
from redundancy_pin.cli.problem import PlanProblem, read_problem
from redundancy_pin.dynamics.backends import backend_of
from redundancy_pin.errors import InputError
from redundancy_pin.planners.registry import PLANNERS, STEPWISE, SWITCH_OFF, TIME_OPTIMAL, WHOLE
from redundancy_pin.visualisation.figures.plots import overview
from redundancy_pin.visualisation.figures.style import save

_TITLES = {
    SWITCH_OFF: "Cross singularities with the actuators off.",
    STEPWISE: "Least torque around corners, step by step.",
    WHOLE: "Least effort over the whole motion.",
    TIME_OPTIMAL: "Least time along the path of a trajectory.",
}
"""What the list of planners says."""

_EXAMPLES = {
    SWITCH_OFF: r"""--robot 2rpr --motion circle:speed=0.6 \
      --threshold 7 --return-time shortest --out plan.npz --plot plan.png""",
    STEPWISE: r"""--robot 3rrr --working-mode +++ --motion corner:radius=0.025 \
      --lam 0.5 --baseline carriers=false --out plan.npz""",
    WHOLE: r"""--robot 2rpr --motion circle:speed=0.5 \
      --objective effort --objective peak=2 --out plan.npz --plot plan.png""",
    TIME_OPTIMAL: r"""--robot 3rrr --working-mode +++ --motion corner --effort 3 \
      --begin rest --end rest --out plan.npz""",
}


def _output_options(command: Callable[..., Any]) -> Callable[..., Any]:
    command = options.json_option(command)
    command = click.option("--plot", metavar="PICTURE", help="Draw the plan (.png, .svg or .pdf).")(command)
    return click.option("--out", metavar="NPZ", help="Where the plan goes; `load_plan` reads it.")(command)


class Planners(click.Group):
    """The group of planners, whose options come after the name of one."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Read the options of the group; see ``click.Command.parse_args``."""
        given = [*args]  # click takes from the list what it has read
        try:
            return super().parse_args(ctx, args)
        except click.NoSuchOption as error:
            flags = {flag for one in self.commands.values() for own in one.params for flag in own.opts}
            if error.option_name not in flags:
                raise
            own, names = error.option_name, f"plan NAME {error.option_name} ..., with one of {', '.join(self.commands)}"
            message, remedy = f"{own} comes after the name of a planner, and there is none.", f"Write {names}."
            named = [word for word in given if word in self.commands]
            if any(word.partition("=")[0] == "--problem" for word in given):
                message = f"{own} does not go with --problem: the file says what to plan."
                remedy = f"Write it into the file (docs/problem.yaml), or without --problem {names}."
            elif named:
                message = f"{own} comes after the name of the planner, not before it."
                remedy = f"Write plan {shlex.join([named[0], *(word for word in given if word != named[0])])}."
            raise InputError(message, remedy=remedy, name=own) from None


@click.group(cls=Planners, invoke_without_command=True)
@click.option("--problem", metavar="YAML", help="Problem file; docs/problem.yaml explains its keys.")
@options.trust_option
@_output_options
@click.pass_context
def plan(context: click.Context, /, problem: str | None, trust: bool, **outputs: Any) -> int | None:
    r"""Plan the motion of the carriers.

    By one of the planners below, or as a problem file says. Exit codes: 0 the plan keeps all limits, between its
    samples too, to 0.1 %; 3 there is a plan and it is written, but it breaks limits or needs unbounded efforts (one
    line on stderr says which); 4 there is a plan and it is written, but the optimiser stopped before it had an optimum,
    or the efforts between its samples exceed those at the samples by more than 5 %; 2 bad input, no plan exists, or the
    picture cannot be drawn (the plan is written before).

    \b
    Examples:
      redundancy-pin plan switch-off --robot 2rpr --motion circle:speed=0.6 \
          --threshold 7 --out plan.npz --plot plan.png
      redundancy-pin plan --problem problem.yaml --out plan.npz
    """
    if context.invoked_subcommand is None:
        if problem is None:
            raise InputError("No task given.", remedy="Name a planner, or give --problem.")
        return _run(lambda: read_problem(problem, trust=trust), problem, **outputs)
    if problem or trust or any(outputs.values()):
        raise InputError(
            "Options before the name of the planner belong to --problem.",
            remedy=f"Write them after {context.invoked_subcommand}, or leave the planner out.",
        )
    return None


def _command(name: str, planner: Callable[..., Any]) -> None:
    """Add the command of a planner, whose help and flags are those of the function."""
    text = "\n\n".join((inspect.getdoc(planner) or "").split("\n\n")[:2]).replace("``", "")
    example = f"\b\nExample:\n  redundancy-pin plan {name} {_EXAMPLES[name]}"

    @plan.command(name, help=f"{text}\n\n{example}", short_help=_TITLES[name])
    @options.robot_options()
    @options.backend_option()
    @options.motion_options("to follow")
    @_output_options
    @options.keyword_options(planner)
    @options.baseline_option(planner)
    def command(
        robot: options.RobotOptions,
        backend: str | None,
        motion: options.MotionOptions,
        out: str | None,
        plot: str | None,
        as_json: bool,
        baseline: Mapping[str, Any] | None = None,
        **keywords: Any,
    ) -> int:
        def read() -> PlanProblem:
            loaded = robot.load()
            followed = motion.follow("A plan", loaded)
            given = {key: value for key, value in keywords.items() if value is not None}
            if baseline:
                other = replace(robot, settings={**robot.settings, **baseline})
                given["baseline"] = options.dynamics_of(other.load(), backend)
            return PlanProblem(name, options.dynamics_of(loaded, backend), followed, given, motion.described)

        return _run(read, motion.file, out, plot, as_json)


for _name, _planner in PLANNERS.items():
    _command(_name, _planner)


def _run(read: Callable[[], PlanProblem], source: str | None, out: str | None, plot: str | None, as_json: bool) -> int:
    """Read, plan, write, print; return the exit code."""
    # before the work: minutes of optimisation are not lost to a misspelt folder
    output.require_outputs(out, (".npz",), plot, (source,))
    with output.progress("plan") as advance:
        advance(0, 3, "reading")
        task = read()
        advance(1, 3, task.planner)
        result = task.solve(lambda text: advance(1, 3, text))
        advance(2, 3, "writing")
        if out:
            result.save(out)
        plot, failed = output.drawn(plot, lambda path: save(overview(result), path))
    facts = result.summary(task.dynamics)
    backend = backend_of(task.dynamics)
    more = {"backend": backend, "motion": task.followed, "ends": task.ends}
    output.report(
        as_json, facts, by=backend, files={"out": ("plan", out), "plot": ("picture", plot)}, failed=failed, **more
    )
    return output.EXIT_CODES[result.status]
