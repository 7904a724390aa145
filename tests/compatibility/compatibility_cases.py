"""Plans and simulations that were saved once, and how they were made: coarse, so that all takes seconds."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import redundancy_pin as rp

DATA = Path(__file__).parent / "data"


def crossing(scheme: str) -> rp.Plan:
    """The thesis's chapter 3: motors off through the two singular instants of a circle."""
    return rp.plan_switch_off(
        rp.VirtualWork(rp.load_robot("2rpr")),
        rp.trajectory.reference.circle(speed=0.5),
        threshold=7.0,
        dt=0.01,
        scheme=scheme,  # type: ignore[arg-type]
    )


def corner_step_by_step() -> rp.Plan:
    """The thesis's chapter 4, with half of the baseline's efforts as the target."""
    robot, without = rp.load_robot("3rrr"), rp.load_robot("3rrr", carriers=False)
    motion = rp.trajectory.reference.corner(radius=0.025)
    return rp.plan_stepwise(rp.RneaDynamics(robot), motion, dt=0.02, lam=0.5, baseline=rp.RneaDynamics(without))


def whole_line() -> rp.Plan:
    """Motors on through the singular instant in the middle of a line."""
    motion = rp.trajectory.reference.line(speed=0.2)
    return rp.plan_whole_trajectory(rp.VirtualWork(rp.load_robot("2rpr")), motion, objective="effort", dt=0.05)


def whole_corner() -> rp.Plan:
    """A corner without singularity, through the other backend, with a limit on the efforts that binds."""
    motion = rp.trajectory.reference.corner(radius=0.025)
    return rp.plan_whole_trajectory(rp.RneaDynamics(rp.load_robot("3rrr")), motion, effort=2.4, dt=0.04)


PLANS: Mapping[str, Callable[[], rp.Plan]] = {
    "switch-off-integration": lambda: crossing("integration"),
    "switch-off-differences": lambda: crossing("backward_differences"),
    "stepwise-corner": corner_step_by_step,
    "whole-line": whole_line,
    "whole-corner": whole_corner,
}


@dataclass(frozen=True)
class Replay:
    """A saved plan that drives a robot.

    Attributes:
        plan: name of the plan's file.
        settings: of ``simulate``.
        mass: of the end-effector, kg; None for the plan's own robot.
    """

    plan: str
    settings: Mapping[str, Any] = field(default_factory=dict)
    mass: float | None = None


REPLAYS: Mapping[str, Replay] = {
    # the 2-RPR of the thesis has no mass but its carriers: forces do not determine how it moves, and at a singular pose
    # nothing does. So its carriers follow their motion, and the simulation ends before that pose
    "replay-integration": Replay("switch-off-integration", {"carriers": "motion", "duration": 0.5}),
    "replay-differences": Replay("switch-off-differences", {"carriers": "motion", "duration": 0.5}),
    "replay-line": Replay("whole-line", {"carriers": "motion", "duration": 2.4}),
    # another machine than that of the plan has no such trouble, and goes elsewhere
    "replay-line-heavy": Replay("whole-line", {"carriers": "force", "duration": 6.0, "stop_at": ["track"]}, mass=0.2),
    "replay-stepwise": Replay("stepwise-corner"),
    "replay-whole": Replay("whole-corner"),
}
STEP = 0.05
"""s; between the samples of a simulation."""


def simulated(replay: Replay) -> rp.simulation.Simulation:
    """Simulate a plan as it was saved: of an old plan the functions of time are rebuilt from its samples."""
    plan = rp.load_plan(DATA / f"{replay.plan}.npz")
    robot = rp.load_robot_of(plan) if replay.mass is None else rp.load_robot("2rpr", end_effector_mass=replay.mass)
    return rp.simulate(robot, plan, dt=STEP, **replay.settings)
