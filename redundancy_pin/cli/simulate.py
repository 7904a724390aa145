"""``redundancy-pin simulate``: what a machine does that is to follow a plan or a motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import click
import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.cli import options, output
from redundancy_pin.cli.errors import BAD_INPUT, OPTIONS, in_words
from redundancy_pin.cli.plan import BREAKS_LIMITS, NOT_OPTIMAL
from redundancy_pin.cli.plan_problem import numbers
from redundancy_pin.cli.show import robot_of
from redundancy_pin.errors import InputError, OutputError
from redundancy_pin.kinematics.coordinates import distance
from redundancy_pin.loading import load_with
from redundancy_pin.planners.plan import Plan, load_plan
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import turning_coordinates
from redundancy_pin.simulation import (
    KINDS,
    MotionReference,
    Sampling,
    Simulation,
    closed_state,
    motion_reference,
    plan_reference,
)
from redundancy_pin.simulation import simulate as run_simulation
from redundancy_pin.simulation.controllers import Encoders, NoisyAmplifier, controller_by_name, joint_friction
from redundancy_pin.simulation.replay import CONTROLLED_ATOL, CONTROLLED_RTOL, DT
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory.trajectory import Ends
from redundancy_pin.view import show as view
from redundancy_pin.visualisation.figures.curves import run_title
from redundancy_pin.visualisation.figures.plots import save
from redundancy_pin.visualisation.figures.plots import simulation as plot_simulation
from redundancy_pin.visualisation.figures.video import require_video, save_video

EXIT_CODES = {
    ResultStatus.OK: 0,
    ResultStatus.STOPPED: BREAKS_LIMITS,
    ResultStatus.NOT_CONVERGED: NOT_OPTIMAL,
}
"""By how a simulation ended."""

CONTROLLERS = {"open-loop": "open loop", "computed-torque": "computed torque", "lqr": "LQR"}
"""Controllers, by the name the command line uses."""

FRICTION = ("prismatic_coulomb", "prismatic_viscous", "revolute_coulomb", "revolute_viscous")

NEVER = "never"

LISTED = 8
"""Events that the table lists; the rest is counted."""

_FLAGS = {name: options.flag(name) for name in ("stop_at", "period", "duration", "dt", "carriers")}
_FLAGS |= {"effort_limit": "--max-effort", "carrier_force_limit": "--max-carrier-force"}


def _numbers(name: str) -> Any:
    return lambda _context, _option, text: None if text is None else numbers(name, text)


@click.command()
@options.robot_options(required=False)
@click.option("--plan", "plan_path", metavar="NPZ", help="Plan to follow, as `plan --out` writes it.")
@options.trajectory_options
@options.settings_option(
    "--machine", "machine", "Parameter in which the machine is not as planned, such as carrier_mass=2.1; repeatable."
)
@click.option("--controller", type=click.Choice(list(CONTROLLERS)), default="open-loop", show_default=True,
              help="What drives it.")  # fmt: skip
@click.option("--park", metavar="S[,S...]", callback=_numbers("--park"),
              help="Where carriers stand along a trajectory, m.  [default: 0]")  # fmt: skip
@click.option("--carriers", type=click.Choice(["force", "motion"]), default="force", show_default=True,
              help="Whether forces drive the carriers, or they follow their motion exactly.")  # fmt: skip
@click.option("--period", type=float, metavar="SECONDS", help="Sampling of the controller.  [default: continuous]")
@click.option("--delay", type=float, metavar="SECONDS", help="From its reading to its answer.  [default: 0]")
@click.option("--encoders", is_flag=True, help="It sees the joints through encoders of 16 bits a turn and 1 µm.")
@click.option("--noise", type=float, default=0.0, show_default=True, metavar="N",
              help="Standard deviation of every actuator's effort, one value a period, N or N·m.")  # fmt: skip
@click.option("--seed", type=click.IntRange(0), default=0, show_default=True, metavar="N", help="Of the noise.")
@options.settings_option(
    "--friction", "friction", f"Friction of the joints: {', '.join(FRICTION)}; N, N·m, s; repeatable."
)
@click.option("--max-effort", metavar="E[,E...]", callback=_numbers("--max-effort"),
              help="Where the amplifiers of the main actuators saturate, N or N·m.")  # fmt: skip
@click.option("--max-carrier-force", metavar="F[,F...]", callback=_numbers("--max-carrier-force"),
              help="The same of the carriers, N.")  # fmt: skip
@click.option("--stop-at", type=click.Choice([*KINDS, NEVER]), multiple=True, default=("track", "joint_limit"),
              show_default=True, help="Events at which it stops; may be repeated.")  # fmt: skip
@click.option("--duration", type=float, metavar="SECONDS", help="How long.  [default: to the end of the motion]")
@click.option("--dt", type=float, metavar="SECONDS", help="Between the samples.  [default: --period, or 0.005]")
@click.option("--out", metavar="NPZ|CSV", help="Where it goes: all of it, or a table by joint name, as of `export`.")
@click.option("--plot", metavar="PICTURE", help="Draw it, with the plan behind it (.png, .svg or .pdf).")
@click.option(
    "--video", metavar="GIF|MP4", help="Write a video, drawn without a display; an MP4 needs ffmpeg or the extra video."
)
@options.json_option
def simulate(robot: options.RobotOptions, **given: Any) -> int:
    r"""Simulate a machine that is to follow a plan or a motion.

    Forward dynamics of the closed chains under a controller: the planned efforts open loop, computed torque, or an LQR.
    It starts as planned. --machine, --friction, --noise, --encoders and a sampled controller make it less than perfect;
    the controller knows the robot as planned.

    Exit codes: 0 it reached its end; 3 it stopped at an event, such as the end of a track; 4 the integration could not
    go on (a line on stderr says which and when, what was simulated until then is written); 2 bad input.

    \b
    Examples:
      redundancy-pin simulate --plan plan.npz --machine carrier_mass=2.1 --out run.npz --plot run.png
      redundancy-pin simulate --robot five_bar --motion motion.csv --controller computed-torque \
          --period 0.001 --delay 0.001 --noise 0.05 --friction revolute_coulomb=0.02
    """
    plan_path, motion, out, plot, video = (given[name] for name in ("plan_path", "motion", "out", "plot", "video"))
    if video:
        require_video(video)
    if out and not out.lower().endswith((".npz", ".csv")):
        raise OutputError(f"--out {out} ends in neither .npz nor .csv.", remedy="Write --out run.npz.", path=out)
    output.require_outputs(out, plot, [path for path in (plan_path, motion.file) if path])
    sampling = _sampling(given)
    with output.progress("simulate") as advance, in_words(OPTIONS.knowing(_FLAGS)):
        advance(0, 3, "reading")
        plan = load_plan(plan_path) if plan_path else None
        nominal, reference, ends = _planned(robot, plan, given)
        machine = _machine(nominal, given["machine"], trust=robot.trust)
        advance(1, 3, "simulation")
        run = _run(machine, reference, sampling, given)
        advance(2, 3, "writing")
        if out and out.lower().endswith(".csv"):
            run.table(machine).to_csv(out)
        elif out:
            run.save(out)
        title = run_title(run, CONTROLLERS[given["controller"]])
        failed = (
            output.drawn(plot, lambda path: save(plot_simulation(run, plan, robot=machine, title=title), path)),
            output.drawn(
                video,
                lambda path: save_video(
                    view(run, robot=machine), path, progress=lambda done, total: advance(done, total, "video")
                ),
            ),
        )
        plot, video = (None if error else path for error, path in zip(failed, (plot, video), strict=True))
    facts = summary(run, reference, machine)
    followed = f"the plan {plan_path}" if plan_path else motion.described
    facts |= {"motion": followed, "controller": given["controller"], "out": out, "plot": plot, "video": video}
    facts["ends"] = ends
    output.report(given["as_json"], facts, _table(run, facts, machine))
    warn(run)
    for error in filter(None, failed):
        raise error
    return EXIT_CODES.get(run.status, BAD_INPUT)


def _sampling(given: Mapping[str, Any]) -> Sampling | None:
    if given["period"] is not None:
        return Sampling(given["period"], given["delay"] or 0.0)
    for flag, value in (("--delay", given["delay"]), ("--noise", given["noise"]), ("--encoders", given["encoders"])):
        if value:
            raise InputError(f"{flag} goes with a sampled controller.", remedy="Add --period 0.001.")
    return None


def _planned(
    robot: options.RobotOptions, plan: Plan | None, given: Mapping[str, Any]
) -> tuple[Robot, MotionReference, Ends | None]:
    """Return the robot as planned, the motion to follow, and the ends of a motion through points."""
    chosen: options.MotionOptions = given["motion"]
    if plan is not None:
        own = {"trajectory": chosen.trajectory, "motion": chosen.path, "park": given["park"], **chosen.flags}
        for name, value in own.items():
            if value is not None:
                message = f"--plan and {options.flag(name)} are both given."
                raise InputError(message, remedy="A plan has its own motion.")
        nominal = robot_of(plan, robot)
        return nominal, plan_reference(plan, robot=nominal), None
    if not robot.source:
        raise InputError("There is nothing to simulate.", remedy="Add --plan NPZ, or --robot NAME and a motion.")
    nominal = robot.load()
    motion, carriers = chosen.follow("A simulation without --plan", nominal), chosen.carriers(nominal)
    if carriers is not None and given["park"] is not None:
        raise InputError("The carriers of the motion move, and --park parks them.", remedy="Leave --park out.")
    parked = 0.0 if given["park"] is None else given["park"]
    reference = motion_reference(nominal, motion, parked if carriers is None else carriers)
    return nominal, reference, getattr(motion, "ends", None)


def _machine(nominal: Robot, changes: Mapping[str, Any], *, trust: bool) -> Robot:
    """Return the robot that is simulated: that of the plan with other parameters."""
    if not changes:
        return nominal
    arguments = {**nominal.parameters, **changes}
    mode = nominal.working_mode or None
    return load_with(nominal.source, arguments, gravity=nominal.gravity.tolist(), working_mode=mode, trust=trust)


def _run(machine: Robot, reference: MotionReference, sampling: Sampling | None, given: Mapping[str, Any]) -> Simulation:
    limits = {"effort_limit": given["max_effort"], "carrier_force_limit": given["max_carrier_force"]}
    controller: Any = controller_by_name(CONTROLLERS[given["controller"]], reference, sampling=sampling, **limits)
    point = reference.at(reference.start)
    start = controller.start_state(machine)
    if machine is not reference.robot:  # with other lengths its chains would not be closed there
        start = closed_state(machine, point.x, point.xd, point.s, point.sd, t=reference.start)
    if sampling is not None and given["encoders"]:
        controller = Encoders(controller, reference, period=sampling.period)
    if given["noise"]:
        require_not_negative("--noise", given["noise"])
        controller = NoisyAmplifier(controller, np.random.default_rng(given["seed"]), given["noise"])
    friction = given["friction"]
    options.require_known(friction, FRICTION, "--friction")
    for name, value in friction.items():
        require_not_negative(f"--friction {name}", value)
    events = set(given["stop_at"])
    if NEVER in events and len(events) > 1:
        raise InputError(f"--stop-at is {NEVER} and {max(events - {NEVER})}.", remedy="Give one or the other.")
    digital: dict[str, Any] = {"rtol": CONTROLLED_RTOL, "atol": CONTROLLED_ATOL, "integrator": "RK45"}
    return run_simulation(
        machine,
        controller,
        start=start,
        duration=reference.end - reference.start if given["duration"] is None else given["duration"],
        dt=(DT if sampling is None else sampling.period) if given["dt"] is None else given["dt"],
        carriers=given["carriers"],
        sampling=sampling,
        external=joint_friction(machine, **friction) if friction else None,
        stop_at=sorted(events - {NEVER}),
        **limits,
        **({} if sampling is None else digital),
    )


def require_not_negative(flag: str, value: object) -> None:
    """Check that what was given to a flag is a number that is not negative."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value < np.inf:
        raise InputError(f"{flag} is {value!r}.", remedy="Give a number that is not negative.")


def warn(run: Simulation) -> None:
    """Print in one line on stderr why a simulation did not reach its end; nothing if it did."""
    if run.status is ResultStatus.STOPPED:
        last = run.events[-1]
        text = f"stopped at t = {last.t:.6g} s: {last.kind.replace('_', ' ')} ({last.name})"
    elif run.status is ResultStatus.NOT_CONVERGED:
        text = f"could not go on at t = {run.t[-1]:.6g} s: {run.reason}"
    else:
        return
    output.warning(text)


def summary(run: Simulation, reference: MotionReference, robot: Robot) -> dict[str, Any]:
    """Return what is worth knowing of a simulation as plain data; its motion against that it was to follow."""
    during = run.t <= reference.end
    planned = np.array([reference.platform(t)[0] for t in run.t[during].tolist()])
    away = distance(robot, run.x[during], planned)
    return {
        "robot": run.robot.name,
        "status": run.status.value,
        "reason": run.reason,
        "samples": len(run),
        "start": float(run.t[0]),
        "end": float(run.t[-1]),
        "events": [vars(event) for event in run.events],
        "largest_distance": float(away.max()),
        "last_distance": float(away[-1]),
        "peak_effort": _peaks(run.tau),
        "peak_carrier_force": _peaks(run.carrier_force),
        "work": float(run.work[-1]),
        "largest_closure_residual": float(run.gap.max()),
        "parameters": run.parameters,
        "statistics": vars(run.statistics),
    }


def _peaks(values: Array) -> Array:
    """Return the largest sizes (c,), NaN left out."""
    peaks: Array = np.fmax.reduce(np.abs(values), axis=0)
    return peaks


def _table(run: Simulation, facts: Mapping[str, Any], machine: Robot) -> output.TextTable:
    main, moved = run.robot.effort_units
    unit = f"m, rad times {machine.characteristic_length:.4g} m" if any(turning_coordinates(machine)) else "m"
    seen = [f"{event.kind.replace('_', ' ')} ({event.name}) at {event.t:.4g} s" for event in run.events]

    rows = [
        ("status", run.status.value.replace("_", " ")),
        ("motion", facts["motion"]),
        ("time [s]", f"{facts['start']:.6g} to {facts['end']:.6g}, {len(run)} samples"),
        ("events", output.listed(seen, LISTED, "\n") or "none"),
        (f"largest distance from the planned motion [{unit}]", output.number(facts["largest_distance"])),
        (f"distance at the end [{unit}]", output.number(facts["last_distance"])),
        *((f"peak of {name} [{main}]", output.number(value))
          for name, value in zip(run.robot.actuated, facts["peak_effort"].tolist(), strict=True)),
        *((f"peak of {name} [{moved}]", output.number(value))
          for name, value in zip(run.robot.carriers, facts["peak_carrier_force"].tolist(), strict=True)),
        ("work of all actuators [J]", output.number(facts["work"])),
        *((f"{name} written to", facts[key])
          for name, key in (("simulation", "out"), ("picture", "plot"), ("video", "video")) if facts[key]),
    ]  # fmt: skip
    return output.TextTable(f"{run.robot.name}, {CONTROLLERS[facts['controller']]}", (), rows)
