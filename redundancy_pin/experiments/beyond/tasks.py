"""The motions of the chapter with the machines that carry them out, as frozen configurations."""

from __future__ import annotations

import functools
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.experiments.backends import BACKENDS, RNEA, VIRTUAL_WORK
from redundancy_pin.experiments.planned.cases import Mode
from redundancy_pin.loading import load_robot
from redundancy_pin.trajectory import SpeedProfile, Trajectory, reference
from redundancy_pin.trajectory.paths import Line

PathOf = Literal["circle", "line", "corner", "square", "descent"]

CIRCLE_RAMP = 0.2
"""Duration T of the ramps on the circle, s; they are v T / 2 long, the 3-4-5 shape in speed."""


@dataclass(frozen=True)
class Machine:
    """A shipped robot.

    Attributes:
        robot: its name.
        mode: working mode.
        arguments: further arguments of ``load_robot``.
    """

    robot: str
    mode: Mode
    arguments: tuple[tuple[str, float], ...] = ()

    @property
    def backends(self) -> tuple[str, ...]:
        """Backends that know it, the one that plans first."""
        return (RNEA,) if self.robot == "five_bar" else (VIRTUAL_WORK, RNEA)

    def dynamics(self, backend: str | None = None, *, carriers: bool = True) -> Dynamics:
        """Return its dynamics, loaded once.

        Args:
            backend: a name of ``BACKENDS``; the one that plans when left out.
            carriers: whether it has its carriers.
        """
        return _dynamics(backend or self.backends[0], self, carriers)


@functools.lru_cache(maxsize=64)
def _dynamics(backend: str, machine: Machine, carriers: bool) -> Dynamics:
    options: Mapping[str, Any] = dict(machine.arguments)
    return BACKENDS[backend](load_robot(machine.robot, working_mode=machine.mode, carriers=carriers, **options))


@dataclass(frozen=True)
class Task:
    """A motion of a machine's platform.

    Attributes:
        name: unique, ``"circle-0.5"``.
        title: for people.
        machine: which.
        path: which path.
        speed: cruising speed, m/s.
        dt: largest step between the nodes of a plan, s.
        radius: of corners, m.
        threshold: condition number above which ``plan_switch_off`` has the motors off; infinite if it is not tried.
        ramp_down: how long before the motors go down, s.
    """

    name: str
    title: str
    machine: Machine
    path: PathOf
    speed: float
    dt: float = 5e-3
    radius: float = 0.025
    threshold: float = field(default=float("inf"))
    ramp_down: float = 0.03

    @property
    def unit(self) -> str:
        """Of the main efforts."""
        return "N" if self.machine.robot == "2rpr" else "N·m"

    @property
    def crosses(self) -> bool:
        """Whether the motion crosses a type II singularity."""
        return self.path in ("circle", "line", "descent")

    def trajectory(self) -> Trajectory:
        """Make the motion.

        Raises:
            InputError: too fast for the ramps to fit in.
        """
        match self.path:
            case "circle":
                return reference.circle(self.speed, CIRCLE_RAMP, 0.5 * self.speed * CIRCLE_RAMP)
            case "line":
                return reference.line(self.speed)
            case "corner":
                return reference.corner(self.radius, self.speed)
            case "square":
                return reference.square(radius=self.radius, speed=self.speed)
            case "descent":
                down = Line((0.25, 0.6), (0.32, 0.3))
                return Trajectory(down, SpeedProfile(down.length, self.speed, 0.2))


LIGHT = Machine("2rpr", (1, 1))
"""The massless 2-RPR of the thesis."""

HEAVY = Machine("2rpr", (1, 1), (("end_effector_mass", 0.5), ("cylinder_mass", 0.3)))
"""The same with masses, kg."""

FIVE_BAR = Machine("five_bar", (1, -1))


def three_rrr(mode: Mode) -> Machine:
    """Return the 3-RRR in a working mode."""
    return Machine("3rrr", mode)


def corner(radius: float, mode: Mode = (1, 1, 1)) -> Task:
    """Return a corner at 0.2 m/s, ramps of 0.4 s, straights of 0.12 m."""
    return Task(f"corner-r{radius:g}", f"3-RRR, corner of radius {radius:g} m", three_rrr(mode), "corner", 0.2, 5e-3,
                radius)  # fmt: skip


CROSSINGS: tuple[Task, ...] = (
    Task("circle-0.5", "2-RPR, circle at 0.5 m/s", LIGHT, "circle", 0.5, threshold=5.0),
    Task("circle-0.75", "2-RPR, circle at 0.75 m/s", LIGHT, "circle", 0.75, threshold=5.0),
    Task("heavy-0.5", "2-RPR with masses (end-effector 0.5 kg, cylinders 0.3 kg), circle at 0.5 m/s", HEAVY, "circle",
         0.5, threshold=5.0),
    Task("line-0.1", "2-RPR, line at 0.1 m/s", LIGHT, "line", 0.1, 0.02, threshold=4.0, ramp_down=0.36),
    Task("line-0.2", "2-RPR, line at 0.2 m/s", LIGHT, "line", 0.2, 0.01, threshold=4.0, ramp_down=0.36),
    Task("five-bar-0.3", "five-bar, straight down through its singularity at 0.3 m/s", FIVE_BAR, "descent", 0.3,
         threshold=5.0),
)  # fmt: skip
"""Motions through type II singularities."""

CORNERS: tuple[Task, ...] = (
    corner(0.025),
    corner(0.013),
    Task("square", "3-RRR, square with corners of radius 0.025 m", three_rrr((1, 1, 1)), "square", 0.2),
)
"""Motions of chapter 4, far from singularities."""

TASKS: tuple[Task, ...] = (*CROSSINGS, *CORNERS)
