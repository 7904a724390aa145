"""One line to see a robot move: a plan, a simulation, a motion, or just a robot."""

from __future__ import annotations

from pathlib import Path
from typing import Literal, overload

import numpy as np

from redundancy_pin.arrays import positive
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.errors import InputError, SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.coordinates import moved
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.loading import load_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion, require_sampled
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import robot_of_record
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import row_scale
from redundancy_pin.simulation.result import Simulation
from redundancy_pin.trajectory import reference
from redundancy_pin.visualisation.figures.curves import curves_of
from redundancy_pin.visualisation.viewer.live import By, LiveRobot
from redundancy_pin.visualisation.viewer.page import View
from redundancy_pin.visualisation.viewer.scene import make_scene

SWING_DURATION = 2.0  # of the default motion of a robot that has none in the thesis, s
SWING = 0.15  # its amplitude in characteristic lengths (rad for rotations); halved until the robot can follow
_HALVINGS = 8
_DT = 0.005


@overload
def show(
    subject: Robot | str | Path, *, live: Literal[True], by: By = "platform", forces: bool = True, height: int = 480
) -> LiveRobot: ...


@overload
def show(
    subject: Plan | Simulation | Robot | str | Path,
    motion: PlatformMotion | None = None,
    carriers: CarrierMotion | None = None,
    *,
    robot: Robot | None = None,
    forces: bool = True,
    force_scale: float = 1.0,
    height: int = 480,
) -> View: ...


def show(
    subject: Plan | Simulation | Robot | str | Path,
    motion: PlatformMotion | None = None,
    carriers: CarrierMotion | None = None,
    *,
    robot: Robot | None = None,
    forces: bool = True,
    force_scale: float = 1.0,
    height: int = 480,
    live: bool = False,
    by: By = "platform",
) -> View | LiveRobot:
    """Return a moving picture: links, joints, tracks, carriers, efforts as arrows, and how near singularities are.

    In a notebook ``rp.show(plan)`` as the last line of a cell plays it; ``.save("out.html")`` writes one file that
    plays offline; ``.serve()`` shows the same page at an address of this machine. The platform and the path it traces
    are coloured by the margin to type II. Meshes of the URDF are in the page; those that are not found or cannot be
    read are named in a warning through ``logging``.

    With ``live=True`` a robot has sliders in a notebook, see ``LiveRobot``; its loops stay closed while one drags.

    Args:
        subject: a plan or a simulation; or a robot, or the name or path of one.
        motion: of a robot, its efforts by the RNEA backend; when left out, its trajectory in the thesis or a small
            swing there and back.
        carriers: of a robot; parked at zero when left out.
        robot: of a plan or a simulation from a file, if its files have moved, or it was changed in Python.
        forces: whether arrows are shown at first.
        force_scale: factor on their length.
        height: of the picture in a notebook, pixels.
        live: whether a robot is moved by sliders (extra ``live``).
        by: what the sliders of a live robot set, ``"platform"`` coordinates or ``"actuators"``.

    Raises:
        InputError: no plan, simulation, robot or name; a motion or carriers together with a plan or a simulation, or
            with sliders; a motion that is not sampled or not the robot's.
        UnsupportedRobotError: sliders of actuators that do not determine the platform.
        RedundancyPinError: what ``load_robot``, ``load_robot_of`` and ``inverse_kinematics`` raise.

    Example:
        >>> import redundancy_pin as rp
        >>> live = rp.show("five_bar", live=True)
        >>> live.sliders["x"].value += 0.05
        >>> live.tau.shape
        (2,)
    """
    if live:
        if isinstance(subject, (Plan, Simulation)) or any(each is not None for each in (motion, carriers, robot)):
            raise InputError(
                "Sliders move a robot, without a plan or motions.", remedy="Pass the robot: show(robot, live=True)."
            )
        moved_by_hand = subject if isinstance(subject, Robot) else load_robot(subject)
        return LiveRobot(RneaDynamics(moved_by_hand), by, forces=forces, height=height)
    if isinstance(subject, (Plan, Simulation)) and (motion is not None or carriers is not None):
        kind = "plan" if isinstance(subject, Plan) else "simulation"
        raise InputError(f"A {kind} has its own motions.", remedy=f"Pass a robot instead of the {kind}, or no motion.")
    positive(force_scale, "force_scale", "")  # before the inverse_kinematics, which takes long
    if isinstance(subject, (Plan, Simulation)):
        shown = robot_of_record(subject.robot, robot)
        drawn = curves_of(subject, shown)
        t, margin, title, tau, force = subject.t, drawn.margin, drawn.title, subject.tau, subject.carrier_force
        if isinstance(subject, Plan):
            q = inverse_kinematics(shown, subject.motion).with_carriers(subject.carriers).q
        else:
            q = subject.q
    elif isinstance(subject, (Robot, str, Path)):
        if robot is not None:
            raise InputError("robot= goes with a plan or a simulation.", remedy="Pass the robot first, without robot=.")
        shown = subject if isinstance(subject, Robot) else load_robot(subject)
        if isinstance(motion, (Plan, Simulation)):
            kind = type(motion).__name__
            raise InputError(f"{kind} is no motion.", remedy=f"Pass show({kind.lower()}, robot=robot).")
        motion = default_motion(shown) if motion is None else motion
        require_sampled(motion)
        carriers = CarrierMotion.parked(len(motion), shown.k) if carriers is None else carriers
        # a picture may be one of poses, without rates
        poses = PlatformMotion(motion.t, motion.x, motion.xd, motion.xdd, check_rates=False)
        reduced = RneaDynamics(shown).reduce(poses, carriers)
        efforts = distribute(reduced)
        t, q, title = motion.t, inverse_kinematics(shown, motion).with_carriers(carriers).q, shown.name
        margin, tau, force = efforts.margin, efforts.tau, reduced.carrier_force
    else:
        raise InputError(
            f"A plan, a simulation, a robot or its name can be shown, not {type(subject).__name__}.",
            remedy="Pass show(plan), or show(robot, motion, carriers).",
        )
    scene = make_scene(shown, t, q, margin, tau, force, title=title, force_scale=force_scale)
    return View(scene, forces=forces, height=height)


def default_motion(robot: Robot) -> PlatformMotion:
    """Return a short motion: the thesis's circle or corner for its machines, else a swing there and back.

    Raises:
        InputError: the robot cannot swing about its reference.
    """
    # other lengths or another working mode may keep a machine of the thesis from following its trajectory
    motions = []
    if robot.closed_form in ("2rpr", "3rrr"):
        thesis = reference.circle() if robot.closed_form == "2rpr" else reference.corner()
        motions.append(thesis.sample(_DT))
    motions += [_swing(robot, SWING * 0.5**halving) for halving in range(_HALVINGS)]
    for motion in motions:
        try:
            inverse_kinematics(robot, motion)
        except (UnreachablePoseError, SingularPoseError, WorkingModeError):
            continue
        return motion
    raise InputError(f"{robot.name} cannot move about its reference.", remedy="Pass a motion.")


def _swing(robot: Robot, amplitude: float) -> PlatformMotion:
    """Move by κ(t) d, κ = sin²(π t/T): from rest at the reference and back to it, smooth when repeated.

    Platforms turn about an axis fixed in the world, so that the twist of a pose is κ̇ d like every other rate.
    """
    t = np.arange(0.0, SWING_DURATION + 0.5 * _DT, _DT)
    rate = np.pi / SWING_DURATION
    kappa = np.sin(rate * t) ** 2
    kappa_d, kappa_dd = rate * np.sin(2.0 * rate * t), 2.0 * rate**2 * np.cos(2.0 * rate * t)
    direction = amplitude * robot.characteristic_length / row_scale(robot)
    start = follower(robot).home.x[None]
    x = moved(robot, np.repeat(start, len(t), axis=0), np.outer(kappa, direction))
    return PlatformMotion(t, x, np.outer(kappa_d, direction), np.outer(kappa_dd, direction))
