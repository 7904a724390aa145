"""``redundancy-pin plan``: carrier motion and efforts along a platform motion."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any

import click
import numpy as np

from redundancy_pin.arrays import stretches
from redundancy_pin.cli import options, output, plan_problem
from redundancy_pin.cli.errors import OPTIONS, in_words
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.planners.limits import LimitEvent, worst_events
from redundancy_pin.planners.plan import REVERSAL, Plan
from redundancy_pin.robot.joint_ranges import beyond_limits
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.case import COMPILED, RNEA, VIRTUAL_WORK
from redundancy_pin.studies.measures import reversals_beside_singularities
from redundancy_pin.visualisation.figures.plots import plan as plot_plan
from redundancy_pin.visualisation.figures.style import save

# how the command line calls what a plan names by its class
_BACKENDS = {"Rnea": RNEA, "VirtualWork": VIRTUAL_WORK, "Compiled": COMPILED}
_LISTED = 6  # broken limits that a table and a warning list; the rest is counted
_LISTED_PHASES = 10  # a stepwise plan may change its phase at every step

_MANY_SWINGS = 10  # of an effort beside singularities: a motion itself makes a few
_CALMING = 0.01  # weight of "effort_rate" that takes the 2-RPR's circle from 35 reversals to 6, for 8 % more peak

BREAKS_LIMITS = 3  # exit code of a plan that breaks limits or needs unbounded efforts
NOT_OPTIMAL = 4  # exit code of a plan that keeps all limits, but is no optimum or whose samples do not show it
# others: BREAKS_LIMITS
EXIT_CODES = {ResultStatus.OK: 0, ResultStatus.NOT_CONVERGED: NOT_OPTIMAL, ResultStatus.UNRESOLVED: NOT_OPTIMAL}


_FINER = {
    "whole_trajectory": "allow more --refinements, or a shorter --dt",
    "stepwise": "use a shorter --step, or both sides of each jump",
    "receding_horizon": "use a shorter --step",
    "time_optimal": "allow more --refinements, or more --steps",
    "switch_off": "use a shorter --dt",
}
"""What helps a planner whose samples do not show its efforts."""


def warn(plan: Plan, *, ranges: bool = True) -> None:
    """Print in one line on stderr what is wrong with a plan, or all but ``ranges`` of joints; nothing if nothing is."""
    check = plan.between
    broken = tuple(event for event in plan.limits.violated if ranges or event.quantity != "range")
    if broken and plan.status is ResultStatus.LIMIT_VIOLATED:
        output.warning(f"limits broken: {_events(plan, broken, '; ', broken=True)}.")
    if plan.status is ResultStatus.UNBOUNDED:
        bad = np.flatnonzero(~np.isfinite(plan.tau).all(axis=1))
        if len(bad):
            first = f" first at t = {plan.t[bad[0]]:.6g} s," if len(bad) else ""
            where = f"{first} at {len(bad)} of {len(plan.t)} samples"
        else:
            where = f" between the samples, at t = {check.time[int(check.peak.argmax())]:.6g} s"
        output.warning(f"no finite main efforts:{where}, where W is singular.")
    if not plan.findings.optimal:
        kept = plan.status in (ResultStatus.NOT_CONVERGED, ResultStatus.UNRESOLVED)
        there = "The plan keeps every limit, but there" if kept else "There"
        help_ = "use a shorter --step" if plan.planner == "stepwise" else "allow more --seconds"
        output.warning(
            f"this is no optimum: the optimiser stopped early ({plan.findings.solver}). "
            f"{there} may be a better one; {help_}."
        )
    if not check.passed and np.isfinite(check.ratio):
        worst = int(check.peak.argmax())
        output.warning(
            f"between the samples the efforts are {check.ratio:.4g} times those at the samples, up to "
            f"{check.peak[worst]:.4g} {plan.robot.effort_unit(plan.robot.actuated[worst])} at t = "
            f"{check.time[worst]:.6g} s: {_FINER[plan.planner]}."
        )


_AS_IT_IS = ("peak_effort", "peak_effort_at_samples", "rms_effort", "main_energy", "carrier_energy", "reversals",
             "least_cost", "parameters", "diagnostics")  # fmt: skip


def summary(plan: Plan) -> dict[str, Any]:
    """Return what is worth knowing of a plan as plain data."""
    return {
        "robot": plan.robot.name,
        "planner": plan.planner,
        "backend": _BACKENDS.get(plan.backend, plan.backend),
        "status": plan.status.value,
        "optimal": plan.findings.optimal if plan.findings.solver else None,
        "samples": len(plan.t),
        "start": float(plan.t[0]),
        "end": float(plan.t[-1]),
        "advice": _advice(plan),
        "peak_carrier_force": np.abs(plan.carrier_force).max(axis=0, initial=0.0),
        "smallest_margin": _smallest_margin(plan),
        "phases": _phase_times(plan),
        "findings": asdict(plan.findings),
        "limits": {kind: [vars(event) for event in getattr(plan.limits, kind)] for kind in ("violated", "binding")},
        **{name: getattr(plan, name) for name in _AS_IT_IS},
    }


def _of_the_optimum(plan: Plan) -> Iterator[tuple[str, str]]:
    """Give what an optimised plan says of its optimum and its nodes."""
    if "nodes" not in plan.diagnostics:
        return
    weights: Any = plan.parameters.get("objective", {"time": 1.0})
    yield "minimised", ", ".join(name if weight == 1.0 else f"{weight:g} {name}" for name, weight in weights.items())
    facts: Any = plan.diagnostics
    reached = "local optimum" if plan.findings.optimal else "NOT an optimum"
    yield "reached", f"{reached} in {facts['iterations']} iterations, {facts['seconds']:.3g} s"
    if plan.least_cost is not None:
        calmer = f"; this plan costs up to {plan.parameters['calm']:g} of it more, to be calm"
        yield "least cost", f"{plan.least_cost:.6g}{calmer if facts['calm']['kept'] else ''}"
    yield "nodes", f"{facts['nodes']}, {len(facts['singular_nodes'])} of them singular"
    yield "efforts between the nodes", f"at most {plan.between.ratio:.6g} times those at the nodes"


def _advice(plan: Plan) -> str | None:
    """Return what calms the efforts of an optimised plan that swings beside singularities; None where nothing has to.

    There least efforts, and least peaks above all, leave the solver free to swing: a price on their rate does not.
    """
    weights = plan.parameters.get("objective")
    if not isinstance(weights, Mapping) or "effort_rate" in weights:
        return None
    swings = int(reversals_beside_singularities(plan).max(initial=0))
    if swings <= _MANY_SWINGS:
        return None
    calmer = {**weights, "effort_rate": _CALMING}
    flags = " ".join(f"--objective {name}{'' if weight == 1.0 else f'={weight:g}'}" for name, weight in calmer.items())
    return f"an effort turns {swings} times beside singularities; a price on its rate calms it: {flags}"


def _smallest_margin(plan: Plan) -> float:
    """Return the smallest margin of the plan: zero where it crosses a singularity, though no sample may lie on it."""
    return 0.0 if plan.findings.singular_instants else float(np.fmin.reduce(plan.margin))


def _phase_times(plan: Plan) -> list[dict[str, Any]]:
    """Return name, first and last time of every stretch of samples in one phase."""
    return [
        {"name": plan.phases[plan.phase[start]], "start": float(plan.t[start]), "end": float(plan.t[stop - 1])}
        for start, stop in stretches(plan.phase)
    ]


def _table(plan: Plan, facts: Mapping[str, Any]) -> output.TextTable:
    status = plan.status.value.replace("_", " ")
    if not plan.findings.optimal:
        status = f"{status}: no optimum, the solver says {plan.findings.solver}"
    # of the joints' kinds: a robot may have motors that turn and carriers that slide
    main, moved = plan.robot.effort_units
    rows = [
        ("status", status),
        ("motion", facts["motion"]),
        ("time [s]", f"{facts['start']:.6g} to {facts['end']:.6g}, {facts['samples']} samples"),
        ("phases [s]", _phases(facts["phases"])),
        (f"peak main effort [{main}]", output.row(facts["peak_effort"])),
        (f"rms main effort [{main}]", output.row(facts["rms_effort"])),
        (f"reversals above {100.0 * REVERSAL:g} % of the peak", output.row(facts["reversals"])),
        (f"peak carrier effort [{moved}]", output.row(facts["peak_carrier_force"])),
        ("peak force on the base [N]", output.number(facts["peak_base_force"])),
        (f"its moment about {output.row(facts['base_point'])} m [N·m]", output.number(facts["peak_base_moment"])),
        ("energy, main actuators [J]", output.number(plan.main_energy)),
        ("energy, carriers [J]", output.number(plan.carrier_energy)),
        ("smallest margin", output.number(facts["smallest_margin"])),
        *_of_the_optimum(plan),
        *(("advice", text) for text in [facts["advice"]] if text),
        ("limits broken", _events(plan, plan.limits.violated, broken=True)),
        ("limits touched", _events(plan, plan.limits.binding, broken=False)),
        *((f"{name} written to", facts[key]) for name, key in (("plan", "out"), ("picture", "plot")) if facts[key]),
    ]
    title = f"{plan.robot.name}, {plan.planner.replace('_', ' ')}, {_BACKENDS.get(plan.backend, plan.backend)}"
    return output.TextTable(title, (), rows)


def _phases(phases: list[dict[str, Any]]) -> str:
    shown = [f"{phase['name'].replace('_', ' ')} {phase['start']:.4g}–{phase['end']:.4g}" for phase in phases]
    return output.listed(shown, _LISTED_PHASES, ", ")


def _events(plan: Plan, events: tuple[LimitEvent, ...], between: str = "\n", *, broken: bool) -> str:
    shown = [_event(plan, event, broken=broken) for event in worst_events(events)]
    return output.listed(shown, _LISTED, between) or "none"


def _event(plan: Plan, event: LimitEvent, *, broken: bool) -> str:
    unit = plan.robot.limit_unit(event.quantity, event.joint)
    limit = event.limit if event.quantity in ("track", "range") else abs(event.limit)  # the others are of a size
    much = f"by {event.amount:.3g} {unit}" if broken else f"at its limit {limit:.3g} {unit}"
    return f"{event.quantity} of {event.joint} {much} at t = {event.worst:.4g} s"


def _output_options(command: Callable[..., Any]) -> Callable[..., Any]:
    command = options.json_option(command)
    command = click.option("--plot", metavar="PICTURE", help="Draw the plan (.png, .svg or .pdf).")(command)
    return click.option("--out", metavar="NPZ", help="Where the plan goes; `load_plan` reads it.")(command)


def _shared_options(command: Callable[..., Any]) -> Callable[..., Any]:
    return options.robot_options()(options.backend_option()(options.trajectory_options(_output_options(command))))


@click.group(invoke_without_command=True)
@click.option(
    "--problem", "problem_path", metavar="YAML", help="PlanProblem file; docs/problem.yaml explains its keys."
)
@options.trust_option
@_output_options
@click.pass_context
def plan(
    context: click.Context, problem_path: str | None, trust: bool, out: str | None, plot: str | None, as_json: bool
) -> int | None:
    r"""Plan the motion of the carriers.

    By one of the planners below, or as a problem file says. Exit codes: 0 the plan keeps all limits, between its
    samples too, to 0.1 %; 3 there is a plan and it is written, but it breaks limits or needs unbounded efforts (one
    line on stderr says which); 4 there is a plan and it is written, but the optimiser stopped before it had an optimum,
    or the efforts between its samples exceed those at the samples by more than 5 %; 2 bad input, no plan exists, or the
    picture cannot be drawn (the plan is written before).

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
        with in_words(plan_problem.WORDING):
            return _run(lambda: plan_problem.read_problem(path, trust=trust), out, plot, as_json, (path,))
    if problem_path or out or plot or as_json or trust:
        raise InputError(
            "Options before the name of the planner belong to --problem.",
            remedy=f"Write them after {context.invoked_subcommand}, or leave the planner out.",
        )
    return None


@plan.command("switch-off")
@_shared_options
@plan_problem.planner_options("switch-off")
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
@plan_problem.planner_options("stepwise")
@click.option(
    "--step", "--dt", type=float, metavar="SECONDS", help=f"Length of the steps.  [default: {options.STEP:g}]"
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


@plan.command("whole-trajectory")
@_shared_options
@plan_problem.planner_options("whole-trajectory")
def whole_trajectory(**given: Any) -> int:
    r"""Least effort over the whole motion.

    Carriers and main actuators are planned together: the motors stay on, through singularities too, and every limit of
    track, speed, acceleration, jerk, effort and carrier force is kept. Where nothing keeps them all, the error says
    which limit is in the way, when, and how much would suffice.

    \b
    Examples:
      redundancy-pin plan whole-trajectory --robot 2rpr --trajectory circle --speed 0.5 \
          --objective effort --objective peak=2 --out plan.npz --plot plan.png
      redundancy-pin plan whole-trajectory --robot 3rrr --mode +++ --trajectory corner --radius 0.013 \
          --max-effort 9 --max-jerk 200 --json
    """
    return _from_flags("whole-trajectory", given)


@plan.command("time-optimal")
@_shared_options
@plan_problem.planner_options("time-optimal")
def time_optimal(**given: Any) -> int:
    r"""Least time along the path of a trajectory.

    Timing, carriers and main actuators are planned together, within limits of efforts, of the actuators' rates and of
    the carriers, through singularities too; how fast the trajectory is does not matter. Robots without carriers are
    planned as well.

    \b
    Example:
      redundancy-pin plan time-optimal --robot 3rrr --mode +++ --trajectory corner --max-effort 3 \
          --begin rest --end rest --out plan.npz
    """
    return _from_flags("time-optimal", given)


def _from_flags(planner: str, given: Mapping[str, Any]) -> int:
    robot, motion, settings = given["robot"], given["motion"], given.get("baseline")
    baseline = replace(robot, settings={**robot.settings, **settings}) if settings else None
    parameters = plan_problem.parameters_of(given)

    def read() -> plan_problem.PlanProblem:
        loaded, backend, step = robot.load(), given["backend"], given.get("step")
        followed = motion.follow("A plan", loaded)
        task = plan_problem.problem(planner, loaded, backend, followed, parameters, baseline=baseline, step=step)
        return replace(task, followed=motion.described)

    with in_words(OPTIONS.knowing(plan_problem.flags_of(planner))):
        return _run(read, given["out"], given["plot"], given["as_json"], (motion.file,) if motion.file else ())


def _run(
    read: Callable[[], plan_problem.PlanProblem],
    out: str | None,
    plot: str | None,
    as_json: bool,
    inputs: Iterable[str],
) -> int:
    """Read, plan, write, print; return the exit code."""
    # before the work: minutes of optimisation are not lost to a misspelt folder
    if out:
        output.require_suffix("--out", out, ".npz")
    output.require_outputs(out, plot, inputs)
    with output.progress("plan") as advance:
        advance(0, 3, "reading")
        task = read()
        advance(1, 3, task.planner)
        result = task.solve(lambda text: advance(1, 3, text))
        advance(2, 3, "writing")
        if out:
            result.save(out)
        failed = output.drawn(plot, lambda path: save(plot_plan(result), path))
        plot = None if failed else plot
    robot = task.dynamics.robot
    left = beyond_limits(robot, inverse_kinematics(robot, result.motion, mark_unreachable=True).q, result.t)
    point = task.parameters.get("base_point", (0.0, 0.0, 0.0))
    base = np.linalg.norm(result.base_wrench(task.dynamics, point).reshape(-1, 2, 3), axis=2).max(axis=0)
    base_facts = {"peak_base_force": base[0], "peak_base_moment": base[1], "base_point": np.asarray(point)}
    joints = [vars(one) for one in left]
    facts = {**summary(result), **base_facts, "joint_limits": joints, "out": out, "plot": plot}
    facts |= {"motion": task.followed, "ends": task.ends}
    output.report(as_json, facts, _table(result, facts))
    for one in left:
        output.warning(f"{one}.")
    warn(result, ranges=not left)  # last, and on stderr: what is wrong with a plan is the line a user sees
    if failed:
        raise failed
    return EXIT_CODES.get(result.status, BREAKS_LIMITS)
