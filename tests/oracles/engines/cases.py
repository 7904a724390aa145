"""Motions on which this package is compared with outside engines: ``make engines`` and ``make bench`` run them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from engines.drive import Drive, drive_of_motion, drive_of_plan
from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.coordinates import coordinates
from redundancy_pin.loading import load_robot
from redundancy_pin.planners.optimal.whole_trajectory import plan_whole_trajectory
from redundancy_pin.planners.receding_horizon import RecedingHorizon, run_online
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import Line, RestToRest, Trajectory, reference
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory


@dataclass(frozen=True)
class Case:
    """A robot and a motion.

    Attributes:
        name: a short name.
        robot: name of a shipped robot.
        trajectory: from the robot to the motion of its platform.
        arguments: arguments of ``load_robot``.
        planner: settings of ``plan_whole_trajectory``, or of ``RecedingHorizon``.
        on_line: whether it is planned on line, a tick after the other, by compiled dynamics.
        crossings: number of type II singularities on the way.
        mujoco: whether MuJoCo takes the robot.
    """

    name: str
    robot: str
    trajectory: Callable[[Robot], TimedTrajectory]
    arguments: Mapping[str, Any] = field(default_factory=dict)
    planner: Mapping[str, Any] = field(default_factory=dict)
    crossings: int = 0
    mujoco: bool = True
    on_line: bool = False


def prepare(case: Case, backend: Callable[[Robot], Dynamics]) -> Drive:
    """Plan the carriers of a case, if its robot has any, and return the drive.

    Args:
        case: the case.
        backend: makes a dynamics backend of a robot.

    Raises:
        CompilerError: there is no C compiler, which the on-line planner needs.
    """
    robot = load_robot(case.robot, **case.arguments)
    dynamics, motion = backend(robot), case.trajectory(robot)
    if robot.k == 0:
        return drive_of_motion(dynamics, motion)
    if case.on_line:
        plan = run_online(
            RecedingHorizon(CompiledDynamics(robot), **in_groups(RecedingHorizon, case.planner)), motion
        ).plan
    else:
        plan = plan_whole_trajectory(dynamics, motion, **in_groups(plan_whole_trajectory, case.planner))
    return drive_of_plan(dynamics, plan, motion)


def straight(start: ArrayLike, end: ArrayLike, duration: float) -> Trajectory:
    """Return a rest-to-rest motion along a straight line of the independent coordinates.

    Args:
        start: (n,) coordinates, m and rad.
        end: (n,) the same at the end.
        duration: s.
    """
    path = Line(start, end)
    return Trajectory(path, RestToRest(path.length, duration, "4-5-6-7"))


def _tilted(robot: Robot) -> Trajectory:
    """From the reference pose, sideways and up, with a turn about a skew axis."""
    state = ConstraintSystem(robot).evaluate(np.array(robot.q_reference)[None])
    home = coordinates(robot, state)[0]
    end = home.copy()
    end[:3, 3] += [0.05, -0.03, 0.04]
    end[:3, :3] = Rotation.from_rotvec([0.1, -0.15, 0.2]).as_matrix() @ home[:3, :3]
    return reference.pose(home, end, 1.0)


WITH_MASS = {"end_effector_mass": 0.5, "cylinder_mass": 0.3, "piston_mass": 0.2}
"""Masses of the 2-RPR that the thesis leaves out: without them its motion through a type II pose is undetermined."""

SHORT = Case("2-RPR short line", "2rpr", lambda _: straight((0.15, 0.1), (0.2, -0.1), 0.6), WITH_MASS, crossings=1)
"""Quick, and through a type II pose: for the ordinary tests."""


def yawed(degrees: float) -> Array:
    """Return the pose (4, 4) of the shipped Gough platform, level and 0.6 m high, turned about the vertical."""
    pose = np.eye(4)
    pose[:3, :3] = Rotation.from_euler("z", degrees, degrees=True).as_matrix()
    pose[2, 3] = 0.6
    return pose


YAW = Case(
    "Gough, through 90 degrees of yaw",
    "gough",
    lambda _: reference.pose(yawed(70.0), yawed(110.0), 1.0),
    {"carriers": True},
    {"dt": 0.02},
    crossings=1,
)
"""Poses and gravity through a type II pose."""

FLAT = Case(
    "delta, through the plane of its elbows",
    "delta",
    lambda _: straight((-0.04, 0.02, -0.25), (0.05, 0.0, -0.05), 0.5),
    {"rod_length": 0.35, "rod_carriers": True},
    {"dt": 0.01},
    crossings=1,
)
"""Gravity along the lost direction, up."""

SHORT_ON_LINE = replace(SHORT, name="2-RPR short line, planned on line", on_line=True)

MOVING_TURN = Case(
    "3-RRR turn while moving",
    "3rrr",
    lambda _: straight((1.0, 0.4, 0.0), (0.8, 0.6, -1.0), 1.5),
    planner={"end": "rest"},
    crossings=1,
)

CASES = (
    SHORT,
    Case("2-RPR line", "2rpr", lambda _: reference.line(0.4, ramp_time=0.5), WITH_MASS, crossings=1),
    Case("2-RPR circle", "2rpr", lambda _: reference.circle(), WITH_MASS, crossings=2),
    Case(
        "2-RPR circle, massless pistons",
        "2rpr",
        lambda _: reference.circle(),
        {"end_effector_mass": 0.5, "cylinder_mass": 0.3},
        crossings=2,
        mujoco=False,
    ),
    Case("3-RRR corner, r = 25 mm", "3rrr", lambda _: reference.corner(0.025)),
    Case("3-RRR corner, r = 13 mm", "3rrr", lambda _: reference.corner(0.013)),
    Case("3-RRR square", "3rrr", lambda _: reference.square()),
    Case("3-RRR turn on the spot", "3rrr", lambda _: straight((0.866, 0.5, 0.0), (0.866, 0.5, -1.2), 1.5), crossings=1),
    MOVING_TURN,
    Case(
        "five-bar line",
        "five_bar",
        lambda _: straight((0.1, 0.6), (0.35, 0.3), 1.0),
        {"carriers": True},
        crossings=1,
    ),
    Case("four-bar half turn", "four_bar", lambda _: straight((1.0,), (4.0,), 1.0)),
    Case("Gough, move and tilt", "gough", _tilted),
    YAW,
    FLAT,
    SHORT_ON_LINE,
    Case(
        "2-RPR circle at 0.5 m/s, planned on line",
        "2rpr",
        lambda _: reference.circle(speed=0.5),
        WITH_MASS,
        crossings=2,
        on_line=True,
    ),
    replace(MOVING_TURN, name="3-RRR turn while moving, planned on line", planner={}, on_line=True),
    replace(YAW, name="Gough, through 90 degrees of yaw, planned on line", planner={}, on_line=True),
)
"""Everything ``make engines`` runs."""

CORNER = CASES[4]
"""The 3-RRR with carriers on which speeds are compared."""
