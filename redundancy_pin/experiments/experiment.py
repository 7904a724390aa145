"""An experiment: a robot, a trajectory and what the carriers do, frozen."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from redundancy_pin.loading import load_robot
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import Trajectory, reference

Carriers = Literal["parked", "none"]
"""What the carriers do: stay at s = 0, or are not there (the non-redundant machine)."""

PathName = Literal["circle", "line", "corner", "square"]

PATHS: Mapping[PathName, Callable[..., Trajectory]] = {
    "circle": reference.circle,
    "line": reference.line,
    "corner": reference.corner,
    "square": reference.square,
}
"""Makers of the reference trajectories, by name."""


@dataclass(frozen=True)
class Experiment:
    """One case to compute.

    Attributes:
        name: unique, used for file names: ``"corner-r0.025-parked"``.
        motion_name: the motion without what the carriers do, ``"corner-r0.025"``; cases that share it are compared.
        title: for people.
        source: where in the thesis the motion comes from.
        robot: shipped robot.
        carriers: what they do.
        path: the reference trajectory.
        path_options: its arguments, m, m/s and s.
        working_mode: ±1 a leg.
        dt: sampling interval, s. Jumps of the acceleration are sampled from both sides, singular instants exactly.
        thresholds: condition numbers whose crossings the thesis reports along this motion.
    """

    name: str
    motion_name: str
    title: str
    source: str
    robot: str
    carriers: Carriers
    path: PathName
    path_options: Mapping[str, float] = field(default_factory=dict)
    working_mode: tuple[int, ...] = ()
    dt: float = 1e-3
    thresholds: tuple[float, ...] = ()

    def load_robot(self) -> Robot:
        """Load the robot of the experiment.

        Raises:
            RedundancyPinError: see ``loading.load_robot``.
        """
        arguments: dict[str, Any] = {"carriers": False} if self.carriers == "none" else {}
        return load_robot(self.robot, working_mode=self.working_mode or None, **arguments)

    def trajectory(self) -> Trajectory:
        """Make the reference trajectory.

        Raises:
            InputError: an option the path does not take.
        """
        return PATHS[self.path](**self.path_options)

    def as_dict(self) -> dict[str, object]:
        """Return the configuration as plain data, for JSON."""
        return {
            "robot": self.robot,
            "working_mode": list(self.working_mode),
            "carriers": self.carriers,
            "path": self.path,
            "path_options": dict(self.path_options),
            "source": self.source,
            "dt": self.dt,
        }
