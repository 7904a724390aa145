"""``redundancy-pin plan``: carrier motion and efforts along a platform motion."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from typing import Any

import click
import numpy as np

from redundancy_pin.cli import options, output
from redundancy_pin.cli.problem import PlanProblem, read_problem
from redundancy_pin.dynamics.backends import backend_of
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.planners.plan import REVERSAL, Plan
from redundancy_pin.planners.registry import PLANNERS, STEPWISE, SWITCH_OFF, TIME_OPTIMAL, WHOLE
from redundancy_pin.planners.summary import event_texts, summary, warnings_of
from redundancy_pin.robot.joint_ranges import beyond_limits
from redundancy_pin.visualisation.figures.plots import overview
from redundancy_pin.visualisation.figures.style import save

_LISTED = 6  # limits that a table lists; the rest is counted
_LISTED_PHASES = 10  # a stepwise plan may change its phase at every step

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


@click.group(invoke_without_command=True)
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


def _command(name: str, planner: Callable[..., Plan]) -> None:
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
    robot = task.dynamics.robot
    left = beyond_limits(robot, inverse_kinematics(robot, result.motion, mark_unreachable=True).q, result.t)
    point = task.parameters.get("base_point", (0.0, 0.0, 0.0))
    base = np.linalg.norm(result.base_wrench(task.dynamics, point).reshape(-1, 2, 3), axis=2).max(axis=0)
    facts = {
        **summary(result),
        "backend": backend_of(task.dynamics),
        "peak_base_force": base[0],
        "peak_base_moment": base[1],
        "base_point": np.asarray(point),
        "joint_limits": [vars(one) for one in left],
        "motion": task.followed,
        "ends": task.ends,
        "out": out,
        "plot": plot,
    }
    warnings = [*(f"{one}." for one in left), *warnings_of(result, ranges=not left)]
    output.report(as_json, facts, _table(result, facts), warnings=warnings, failed=failed)
    return output.EXIT_CODES[result.status]


def _table(plan: Plan, facts: Mapping[str, Any]) -> output.TextTable:
    status = plan.status.value.replace("_", " ")
    if not plan.findings.optimal:
        status = f"{status}: no optimum, the solver says {plan.findings.solver}"
    phases = [f"{one['name'].replace('_', ' ')} {one['start']:.4g}–{one['end']:.4g}" for one in facts["phases"]]
    # of the joints' kinds: a robot may have motors that turn and carriers that slide
    main, moved = plan.robot.effort_units
    rows = [
        ("status", status),
        ("motion", facts["motion"]),
        ("time [s]", f"{facts['start']:.6g} to {facts['end']:.6g}, {facts['samples']} samples"),
        ("phases [s]", output.listed(phases, _LISTED_PHASES, ", ")),
        (f"peak main effort [{main}]", output.row(facts["peak_effort"])),
        (f"rms main effort [{main}]", output.row(facts["rms_effort"])),
        (f"reversals above {100.0 * REVERSAL:g} % of the peak", output.row(facts["reversals"])),
        (f"peak carrier effort [{moved}]", output.row(facts["peak_carrier_force"])),
        ("peak force on the base [N]", output.number(facts["peak_base_force"])),
        (f"its moment about {output.row(facts['base_point'])} m [N·m]", output.number(facts["peak_base_moment"])),
        ("energy, main actuators [J]", output.number(plan.main_energy)),
        ("energy, carriers [J]", output.number(plan.carrier_energy)),
        ("smallest margin", output.number(facts["smallest_margin"])),
        *_optimum(plan),
        *([("advice", facts["advice"])] if facts["advice"] else []),
    ]
    for name, events in (("limits broken", plan.limits.violated), ("limits touched", plan.limits.binding)):
        texts = event_texts(plan, events, broken=events is plan.limits.violated)
        rows.append((name, output.listed(texts, _LISTED, "\n") or "none"))
    title = f"{plan.robot.name}, {plan.planner.replace('_', ' ')}, {facts['backend']}"
    return output.TextTable(title, [*rows, *output.written(facts, out="plan", plot="picture")])


def _optimum(plan: Plan) -> Iterator[tuple[str, str]]:
    """Give what an optimised plan says of its optimum and its nodes."""
    facts: Mapping[str, Any] = plan.diagnostics
    if "nodes" not in facts:
        return
    weights: Any = plan.parameters.get("objective", {"time": 1.0})
    yield "minimised", ", ".join(name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights.items())
    reached = "local optimum" if plan.findings.optimal else "NOT an optimum"
    yield "reached", f"{reached} in {facts['iterations']} iterations, {facts['seconds']:.3g} s"
    if plan.least_cost is not None:
        calmer = f"; this plan costs up to {plan.parameters['calm']:g} of it more, to be calm"
        yield "least cost", f"{plan.least_cost:.6g}{calmer if facts['calm']['kept'] else ''}"
    yield "nodes", f"{facts['nodes']}, {len(facts['singular_nodes'])} of them singular"
    yield "efforts between the nodes", f"at most {plan.between.ratio:.6g} times those at the nodes"
