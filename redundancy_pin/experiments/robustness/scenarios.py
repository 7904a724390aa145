"""The crossings of the study: machine, path, planner and the time around the singular poses that is simulated."""

from __future__ import annotations

import functools
from dataclasses import dataclass
from typing import Any, Literal

from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.loading import load_robot
from redundancy_pin.planners.switch_off.planner import plan_switch_off
from redundancy_pin.planners.whole_trajectory.planner import plan_whole_trajectory
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.reference import MotionReference, plan_reference
from redundancy_pin.trajectory import Trajectory, reference

MASS = {"end_effector_mass": 0.5, "cylinder_mass": 0.3}
"""The 2-RPR of the thesis is massless but for its carriers: forces would not determine its motion. kg."""

PLANNED_TRACK = 0.16
"""Half of the track that plans may use, m; the machine has 0.2: a controller needs room."""

Drive = Literal["open loop", "computed torque", "LQR"]
DRIVES: tuple[Drive, ...] = ("open loop", "computed torque", "LQR")


@dataclass(frozen=True)
class Scenario:
    """A planned crossing.

    Attributes:
        path: the reference trajectory.
        planner: who plans the carriers.
        start, end: time that is simulated, s: the singular poses and what leads there.
    """

    path: Literal["line", "circle"]
    planner: Literal["switch off", "whole trajectory"]
    start: float
    end: float

    @property
    def name(self) -> str:
        """For tables."""
        return f"{self.path}, {self.planner}"

    def trajectory(self) -> Trajectory:
        """Make the reference trajectory."""
        return reference.line(0.2) if self.path == "line" else reference.circle(0.5)


SCENARIOS: tuple[Scenario, ...] = (
    Scenario("line", "switch off", 1.9, 3.1),
    Scenario("line", "whole trajectory", 1.9, 3.1),
    Scenario("circle", "whole trajectory", 0.2, 1.1),
)
"""On the circle the machine with masses has no switch-off plan: its end-effector accelerates at the singular poses."""


@functools.cache
def nominal(half_track: float | None = None) -> Robot:
    """Return the robot as planned; with its own track, or another one."""
    arguments: dict[str, Any] = {**MASS}
    if half_track is not None:
        arguments["track_half_length"] = half_track
    return load_robot("2rpr", **arguments)


@functools.cache
def planned(scenario: Scenario) -> MotionReference:
    """Return the planned motion of a scenario, made once a process.

    Raises:
        InfeasiblePlanError: there is none.
    """
    robot, path = nominal(PLANNED_TRACK), scenario.trajectory()
    dynamics = RneaDynamics(robot)
    if scenario.planner == "switch off":
        plan = plan_switch_off(dynamics, path, threshold=4.0, ramp_down=0.36, dt=5e-3)
    else:
        plan = plan_whole_trajectory(dynamics, path, dt=1e-2 if scenario.path == "line" else 5e-3)
    return plan_reference(plan, robot=robot, motion=path)
