"""The planned experiments as frozen configurations; a variation of one is a ``dataclasses.replace``."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.experiments.experiment import PATHS, PathName
from redundancy_pin.experiments.planned.robots import dynamics
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.plan import Plan, finish_plan
from redundancy_pin.planners.stepwise.planner import plan_stepwise
from redundancy_pin.planners.switch_off.planner import Scheme, plan_switch_off
from redundancy_pin.trajectory import Trajectory

Mode = tuple[int, ...]
"""Working mode, ±1 a leg."""


def mode_text(mode: Mode) -> str:
    """Return a working mode as text that no line break splits: ``"++−"``."""
    return "".join("+" if sign > 0 else "\u2212" for sign in mode)


CIRCLE_RETURN_TIME = 0.4
"""Duration of the carriers' return on the circle and the line, s; the thesis does not state it."""

SQUARE_RETURN_TIME = 0.6
"""The same on the square, where 0.65 s lie between the first ramp and the first corner."""

STEP = 5e-3
"""Time step of the stepwise planner, s; the thesis does not state it."""


@dataclass(frozen=True)
class SwitchOffCase:
    """A crossing of chapter 3.

    Attributes:
        name: unique, ``"circle-0.5-cn5"``.
        path: the reference trajectory.
        path_options: its arguments.
        threshold: condition number above which the actuators are off.
        ramp_down: duration of the ramp before, s.
        return_time: duration of the carriers' return, s, or "shortest".
        scheme: how the carriers' motion is found.
        dt: step, s.
        end_effector_mass: kg; zero in the thesis.
    """

    name: str
    path: PathName
    path_options: Mapping[str, float] = field(default_factory=dict)
    threshold: float = 5.0
    ramp_down: float = 0.03
    return_time: float | Literal["shortest"] = CIRCLE_RETURN_TIME
    scheme: Scheme = "integration"
    dt: float = 1e-3
    end_effector_mass: float = 0.0

    @property
    def speed(self) -> float:
        """Cruising speed, m/s."""
        return self.path_options["speed"]

    @property
    def title(self) -> str:
        """For people."""
        return f"2-RPR, {self.path} at {self.speed:g} m/s, off above condition number {self.threshold:g}"

    def trajectory(self) -> Trajectory:
        """Make the reference trajectory."""
        return PATHS[self.path](**self.path_options)

    def dynamics(self, backend: str) -> Dynamics:
        """Return the robot's dynamics."""
        return dynamics(backend, "2rpr", (1, 1), True, self.end_effector_mass)

    def plan(self, backend: str) -> Plan:
        """Plan the crossing.

        Raises:
            InfeasiblePlanError: no such plan exists.
        """
        return plan_switch_off(
            self.dynamics(backend),
            self.trajectory(),
            threshold=self.threshold,
            ramp_down=self.ramp_down,
            return_time=self.return_time,
            scheme=self.scheme,
            dt=self.dt,
        )


@dataclass(frozen=True)
class StepwiseCase:
    """Least effort around corners, chapter 4.

    Attributes:
        name: unique, ``"corner-r0.025-lam0"``.
        path: the reference trajectory.
        path_options: its arguments.
        lam: fraction λ of the baseline torque to aim at.
        mode: working mode; the thesis does not state it.
        active: when the optimiser works: all along, or while the platform accelerates.
        speed, acceleration: limits of the carriers in place of the robot's own, m/s and m/s².
        return_time: duration of the returns, s, or "shortest".
        dt: step, s.
        two_sided: whether instants at which the acceleration jumps are sampled from both sides.
    """

    name: str
    path: PathName
    path_options: Mapping[str, float] = field(default_factory=dict)
    lam: float = 0.0
    mode: Mode = (1, 1, 1)
    active: Literal["always", "accelerating"] = "always"
    speed: float | None = None
    acceleration: float | None = None
    return_time: float | Literal["shortest"] = SQUARE_RETURN_TIME
    dt: float = STEP
    two_sided: bool = True

    @property
    def title(self) -> str:
        """For people."""
        what = "square" if self.path == "square" else f"corner of radius {self.path_options['radius']:g} m"
        raised = [
            f"{self.acceleration:g} m/s²" if self.acceleration else "",
            f"{self.speed:g} m/s" if self.speed else "",
        ]
        limits = ", ".join(part for part in raised if part)
        return f"3-RRR, {what}, λ = {self.lam:g}" + (f", limit {limits}" if limits else "")

    def trajectory(self) -> Trajectory:
        """Make the reference trajectory."""
        return PATHS[self.path](**self.path_options)

    def dynamics(self, backend: str) -> Dynamics:
        """Return the dynamics of the machine with carriers."""
        return dynamics(backend, "3rrr", self.mode)

    def baseline_dynamics(self, backend: str) -> Dynamics:
        """Return the dynamics of the machine without internal redundancy."""
        return dynamics(backend, "3rrr", self.mode, False)

    def plan(self, backend: str) -> Plan:
        """Plan the carriers.

        Raises:
            InfeasiblePlanError: no such plan exists.
        """
        return plan_stepwise(
            self.dynamics(backend),
            self.trajectory().sample(self.dt, two_sided=self.two_sided),
            lam=self.lam,
            baseline=self.baseline_dynamics(backend),
            active=self.active,
            speed=self.speed,
            acceleration=self.acceleration,
            return_time=self.return_time,
        )

    def baseline(self, backend: str) -> Plan:
        """Return the same motion of the machine without carriers, as a plan."""
        return _at_rest(self.baseline_dynamics(backend), self.trajectory(), self.dt, "baseline")

    def parked(self, backend: str) -> Plan:
        """Return the same motion with the carriers parked at s = 0, as a plan."""
        return _at_rest(self.dynamics(backend), self.trajectory(), self.dt, "parked")


Case = SwitchOffCase | StepwiseCase


def parked_crossing(case: SwitchOffCase, backend: str) -> Plan:
    """Return the motion of a crossing with the carriers parked: efforts grow without bound at the singularity."""
    return _at_rest(case.dynamics(backend), case.trajectory(), case.dt, "parked")


def _at_rest(machine: Dynamics, trajectory: Trajectory, dt: float, name: str) -> Plan:
    motion = trajectory.sample(dt)
    return finish_plan(
        machine.along(motion),
        CarrierMotion.parked(len(motion), machine.robot.k),
        planner=name,
        phase=np.zeros(len(motion), dtype=np.intp),
        phases=("parked",),
        parameters={"dt": dt},
        diagnostics={},
    )


def _crossing(path: PathName, speed: float, threshold: float, ramp_down: float) -> SwitchOffCase:
    name = f"{path}-{speed:g}-cn{threshold:g}"
    return SwitchOffCase(name, path, {"speed": speed}, threshold=threshold, ramp_down=ramp_down)


def corner(radius: float, lam: float, mode: Mode = (1, 1, 1)) -> StepwiseCase:
    """Return a corner with the limits of the thesis (1 m/s, 7 m/s²); the optimiser works all along."""
    return StepwiseCase(f"corner-r{radius:g}-lam{lam:g}", "corner", {"radius": radius}, lam, mode)


def square(lam: float, mode: Mode = (1, 1, 1)) -> StepwiseCase:
    """Return the square with the limits of the thesis; carriers return while the platform does not accelerate."""
    return StepwiseCase(f"square-lam{lam:g}", "square", {}, lam, mode, "accelerating")


CROSSINGS: tuple[SwitchOffCase, ...] = (
    _crossing("circle", 0.5, 5.0, 0.03),
    _crossing("circle", 0.5, 10.0, 0.03),
    _crossing("circle", 0.5, 20.0, 0.03),
    _crossing("circle", 0.75, 5.0, 0.03),
    _crossing("line", 0.1, 4.0, 0.36),
    _crossing("line", 0.2, 4.0, 0.36),
    _crossing("line", 0.2, 15.0, 0.36),
)
"""The crossings whose results the thesis shows. Its threshold at 0.1 m/s is not stated: 4 as at 0.2 m/s."""

CORNERS: tuple[StepwiseCase, ...] = (
    corner(0.025, 0.0),
    corner(0.025, 0.5),
    corner(0.013, 0.0),
    corner(0.013, 0.5),
    square(0.5),
    square(0.0),
)
"""The stepwise plans whose results the thesis shows, and λ = 0.5 at the sharper corner."""
