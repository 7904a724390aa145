"""``redundancy-pin simulate``: what a machine does that is to follow a plan or a motion."""

from __future__ import annotations

from typing import Any

import click

from redundancy_pin.cli import options, output
from redundancy_pin.cli.show import VIDEO
from redundancy_pin.dynamics.backends import COMPILED, RNEA
from redundancy_pin.errors import InputError
from redundancy_pin.loading import load_with
from redundancy_pin.planners.plan import Plan, load_plan
from redundancy_pin.robot import Robot
from redundancy_pin.simulation import KINDS, MotionReference, motion_reference, plan_reference
from redundancy_pin.simulation import simulate as run_simulation
from redundancy_pin.simulation.controllers.by_name import DRIVES
from redundancy_pin.simulation.following import FRICTION, Conditions, follow
from redundancy_pin.trajectory.trajectory import Ends
from redundancy_pin.view import show as view
from redundancy_pin.visualisation.figures.curves import run_title
from redundancy_pin.visualisation.figures.plots import overview, save
from redundancy_pin.visualisation.figures.video import require_video, save_video

CONTROLLERS = {name.lower().replace(" ", "-"): name for name in DRIVES}
"""Controllers, by the name the command line uses."""

CONDITIONS = ("period", "delay", "encoders", "noise", "seed")
"""Those of ``Conditions`` that are flags as they are."""

KEYWORDS = ("carriers", "effort_limit", "carrier_force_limit", "joint_stops", "duration", "dt")
"""Those of ``rp.simulate`` and of ``follow`` that are flags as they are."""

NEVER = "never"


@click.command()
@options.robot_options(required=False)
@options.backend_option("How the forward dynamics are computed.", (RNEA, COMPILED))
@click.option("--plan", "plan_path", metavar="NPZ", help="Plan to follow, as `plan --out` writes it.")
@options.motion_options("to follow")
@options.settings_option("--machine", "machine", "Parameter in which the machine is not as planned, such as "
                         "carrier_mass=2.1. May be repeated.")  # fmt: skip
@click.option("--controller", type=click.Choice(list(CONTROLLERS)), default="open-loop", show_default=True,
              help="What drives it.")  # fmt: skip
@click.option("--park", metavar="S[,S...]", callback=options.by(options.numbers),
              help="Where carriers stand along a trajectory, m.  [default: 0]")  # fmt: skip
@options.keyword_options(Conditions, only=CONDITIONS)
@options.settings_option("--friction", "friction", f"Friction of the joints: {', '.join(FRICTION)}; N, N·m, s. "
                         "May be repeated.", "revolute_coulomb=0.02")  # fmt: skip
@options.keyword_options(run_simulation, follow, only=KEYWORDS)
@click.option("--stop-at", type=click.Choice([*KINDS, NEVER]), multiple=True, default=("track", "joint_limit"),
              show_default=True, help="Events at which it stops. May be repeated.")  # fmt: skip
@click.option("--out", metavar="NPZ|CSV", help="Where it goes: all of it, or a table by joint name, as of `export`.")
@click.option("--plot", metavar="PICTURE", help="Draw it, with the plan behind it (.png, .svg or .pdf).")
@click.option("--video", metavar="GIF|MP4", help=VIDEO)
@options.json_option
def simulate(
    robot: options.RobotOptions,
    backend: str | None,
    plan_path: str | None,
    motion: options.MotionOptions,
    out: str | None,
    plot: str | None,
    video: str | None,
    as_json: bool,
    **given: Any,
) -> int:
    r"""Simulate a machine that is to follow a plan or a motion.

    Forward dynamics of the closed chains under a controller: the planned efforts open loop, computed torque, or an LQR.
    It starts as planned. --machine, --friction, --noise, --encoders and a sampled controller make it less than perfect;
    the controller knows the robot as planned.

    Exit codes: 0 it reached its end; 3 it stopped at an event, such as the end of a track, or exceeds a limit of the
    robot, such as a speed of a carrier; 4 the integration could not
    go on (a line on stderr says which and when, what was simulated until then is written); 2 bad input.

    \b
    Examples:
      redundancy-pin simulate --plan plan.npz --machine carrier_mass=2.1 --out run.npz --plot run.png
      redundancy-pin simulate --robot five_bar --motion motion.csv --controller computed-torque \
          --period 0.001 --delay 0.001 --noise 0.05 --friction revolute_coulomb=0.02
    """
    if video:
        require_video(video)
    output.require_outputs(out, (".npz", ".csv"), plot, (plan_path, motion.file))
    if NEVER in given["stop_at"] and len(set(given["stop_at"])) > 1:
        raise InputError(f"--stop-at is {' and '.join(sorted(given['stop_at']))}.", remedy="Give one or the other.")
    chosen = {name: given[name] for name in CONDITIONS if given[name] is not None}
    conditions = Conditions(**chosen, friction=given["friction"])
    settings = {name: given[name] for name in KEYWORDS if given[name] is not None}
    settings["stop_at"] = sorted({*given["stop_at"]} - {NEVER})
    controller = CONTROLLERS[given["controller"]]
    with output.progress("simulate") as advance:
        advance(0, 3, "reading")
        plan = load_plan(plan_path) if plan_path else None
        nominal, reference, ends = _planned(robot, plan, motion, given["park"])
        machine = nominal
        if given["machine"]:
            changed = {**nominal.parameters, **given["machine"]}
            mode, gravity = nominal.working_mode or None, nominal.gravity.tolist()
            machine = load_with(nominal.source, changed, gravity=gravity, working_mode=mode, trust=robot.trust)
        advance(1, 3, "simulation")
        settings["dynamics"] = options.dynamics_of(machine, backend)
        settings["progress"] = lambda t, end: advance(0, 0, f"at {t:.3g} of {end:.3g} s")
        run = follow(machine, reference, controller, conditions, **settings)
        advance(2, 3, "writing")
        if out and out.lower().endswith(".csv"):
            run.table(machine).to_csv(out)
        elif out:
            run.save(out)
        title = run_title(run, controller)

        def film(path: str) -> None:
            save_video(view(run, robot=machine), path, progress=lambda done, all_: advance(done, all_, "video"))

        plot, undrawn = output.drawn(plot, lambda path: save(overview(run, plan, robot=machine, title=title), path))
        video, unfilmed = output.drawn(video, film)
    facts = run.summary(reference, machine)
    files = {"out": ("simulation", out), "plot": ("picture", plot), "video": ("video", video)}
    followed = f"the plan {plan_path}" if plan_path else motion.described
    more = {"motion": followed, "controller": given["controller"], "ends": ends}
    output.report(as_json, facts, by=controller, files=files, failed=undrawn or unfilmed, **more)
    return output.EXIT_CODES[run.status]


def _planned(
    robot: options.RobotOptions, plan: Plan | None, motion: options.MotionOptions, park: Any
) -> tuple[Robot, MotionReference, Ends | None]:
    """Return the robot as planned, the motion to follow, and the ends of a motion through points."""
    if plan is not None:
        for name, value in (("motion", motion.given), ("park", park)):
            if value is not None:
                raise InputError(f"--plan and --{name} are both given.", remedy="A plan has its own motion.")
        nominal = robot.recorded(plan)
        return nominal, plan_reference(plan, robot=nominal), None
    if not robot.source:
        raise InputError("There is nothing to simulate.", remedy="Add --plan NPZ, or --robot NAME and a motion.")
    nominal = robot.load()
    followed, carriers = motion.follow("A simulation without a plan", nominal), motion.carriers(nominal)
    if carriers is not None and park is not None:
        raise InputError("The carriers of the motion move, and --park parks them.", remedy="Leave --park out.")
    parked = 0.0 if park is None else park
    reference = motion_reference(nominal, followed, parked if carriers is None else carriers)
    return nominal, reference, getattr(followed, "ends", None)
