"""``redundancy-pin show``: a robot, a motion or a plan to look at."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import click

from redundancy_pin.cli.options import MotionOptions, RobotOptions, json_option, motion_options, robot_options, robots
from redundancy_pin.cli.output import progress, report
from redundancy_pin.errors import InputError
from redundancy_pin.io.files import require_writable
from redundancy_pin.planners.plan import load_plan
from redundancy_pin.simulation import load_simulation
from redundancy_pin.view import show as view
from redundancy_pin.visualisation.figures.video import require_video, save_video
from redundancy_pin.visualisation.viewer.page import View, require_html

VIDEO = "Write a video, drawn without a display; an MP4 needs ffmpeg or the extra video."


@click.command()
@click.argument("model", default="", metavar="[MODEL]", shell_complete=robots())
@robot_options(required=False)
@click.option("--plan", "plan_path", metavar="NPZ", help="Plan to show, as `plan --out` writes it.")
@click.option("--run", "run_path", metavar="NPZ", help="Simulation to show, as `simulate --out` writes it.")
@motion_options("to show")
@click.option("--html", "out", metavar="HTML", help="Write one file that plays offline, instead of a live viewer.")
@click.option("--video", metavar="GIF|MP4", help=VIDEO)
@click.option("--forces/--no-forces", default=True, show_default=True, help="Whether arrows are shown at first.")
@click.option("--force-scale", type=float, default=1.0, metavar="NUMBER", help="Factor on the length of arrows.")
@click.option("--open", "open_browser", is_flag=True, help="Open it in the default browser.")
@json_option
def show(out: str | None, video: str | None, open_browser: bool, as_json: bool, **given: Any) -> None:
    r"""Show a robot in motion.

    MODEL is another way to give --robot.

    Links, joints, tracks, carriers, the path of the platform, efforts as arrows; platform and path have the colour of
    the margin to a singularity. Without --plan, --run and --motion: its motion in the thesis, or a small swing.

    With --html one self-contained file is written, with --video a GIF or an MP4. Without, the same page is served to
    browsers of this machine until Ctrl-C; its address is printed. No display is needed for any of them.

    \b
    Examples:
      redundancy-pin show model.xml
      redundancy-pin show --robot 3rrr --html 3rrr.html
      redundancy-pin show --plan plan.npz --open
      redundancy-pin show --run run.npz --video run.gif
    """
    # before the robot is loaded
    if video:
        require_video(video)
    if out:
        require_html(out)
        require_writable(out)
    picture = _view(**given)

    def tell(where: str) -> None:
        scene = picture.scene
        facts = {"title": scene.title, "frames": len(scene.t), "duration": scene.duration, "where": where}
        report(as_json, facts, f"{scene.title}: {scene.duration:.4g} s in {len(scene.t)} frames, at {where}")

    if video:
        with progress("video") as advance:
            save_video(picture, video, progress=lambda done, total: advance(done, total, ""))
    if out:
        picture.save(out)
    if out or video:
        tell(" and ".join(path for path in (out, video) if path))
        if open_browser:
            click.launch(out or str(video))
        return
    live = picture.serve(open_browser=open_browser)
    try:
        tell(live.url)
        live.wait()
    except KeyboardInterrupt:
        pass  # how a live view is meant to end
    finally:
        live.close()


def _view(
    model: str, robot: RobotOptions, plan_path: str | None, run_path: str | None, motion: MotionOptions, **settings: Any
) -> View:
    if model and robot.source:
        message = f"The robot is given twice, {model} and --robot {robot.source}."
        raise InputError(message, remedy="Give it once.")
    robot = replace(robot, source=model or robot.source)
    named = [flag for flag, path in (("--plan", plan_path), ("--run", run_path), ("a motion", motion.given)) if path]
    if len(named) > 1:
        message = f"{' and '.join(named)} are both given."
        raise InputError(message, remedy="Give one of them: a plan and a simulation have their motion.")
    if plan_path or run_path:
        subject = load_plan(plan_path) if plan_path else load_simulation(run_path or "")
        return view(subject, robot=robot.recorded(subject), **settings)
    if not robot.source:
        raise InputError("There is nothing to show.", remedy="Name a robot or its file, or add --plan NPZ.")
    loaded = robot.load()
    if not motion.given:
        still: View = view(loaded, **settings)
        return still
    return view(loaded, motion.sampled("A picture", loaded), motion.carriers(loaded), **settings)
