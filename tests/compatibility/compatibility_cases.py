"""What version 0.1.0 saved, and the commands whose output was recorded then: coarse, so that all takes seconds."""

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


CIRCLE = ("--robot", "2rpr", "--backend", "virtual-work", "--trajectory", "circle", "--dt", "0.02")
CORNER = ("--robot", "3rrr", "--mode", "+++", "--trajectory", "corner")


@dataclass(frozen=True)
class Command:
    """A command with ``--json``; it runs in a folder of its own that has ``motion.csv`` and ``plan.npz``.

    Attributes:
        arguments: all but ``--json``.
        code: exit code.
        slow: whether it takes more than some seconds.
    """

    arguments: tuple[str, ...]
    code: int = 0
    slow: bool = False


COMMANDS: Mapping[str, Command] = {
    "info": Command(("info",)),
    "info 3rrr": Command(("info", "--robot", "3rrr")),
    "info four_bar": Command(("info", "--robot", "four_bar")),
    "info gough": Command(("info", "--robot", "gough")),
    # 0 in version 0.1.0, which did not see that the motion crosses two singularities between its samples
    "inverse-dynamics": Command(
        ("inverse-dynamics", "--robot", "2rpr", "--motion", "motion.csv", "--out", "efforts.csv"), code=3
    ),
    "singularities": Command(("singularities", "--robot", "2rpr", "--trajectory", "circle:speed=0.5")),
    "plan switch-off": Command(("plan", "switch-off", *CIRCLE, "--threshold", "5", "--out", "made.npz"), code=3),
    "plan switch-off within limits": Command(
        ("plan", "switch-off", "--robot", "2rpr", "--trajectory", "line", "--threshold", "4", "--dt", "0.02")
    ),
    "plan stepwise": Command(("plan", "stepwise", *CORNER, "--step", "0.02")),
    "plan whole-trajectory": Command(("plan", "whole-trajectory", *CIRCLE, "--ramp-length", "0.05")),
    "map": Command(
        ("map", "--robot", "3rrr", "--planner", "stepwise", "--x", "speed=0.1,0.3", "--y", "stroke=0.5,2.0",
         "--jobs", "1", "--refine", "0", "--out", "map")
    ),
    "show": Command(("show", "--plan", "plan.npz", "--html", "seen.html")),
    "validate": Command(("validate", "--robot", "2rpr", "--samples", "4")),
    "study": Command(("study", "--draws", "1", "--jobs", "1", "--out", "study"), slow=True),
}  # fmt: skip

BACKENDS = ("rnea", "virtual-work")
EFFORTS = ("inverse-dynamics", "--robot", "2rpr", "--set", "end_effector_mass=0.5", "--gravity", "0,-9.81,0")
"""Of both backends along ``motion.csv``."""

REPRODUCE = "reproduce"
"""Its keys were recorded from a small job; the whole one takes minutes."""
