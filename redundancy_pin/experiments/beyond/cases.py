"""Plans of the chapter as frozen configurations."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from redundancy_pin.experiments.beyond.tasks import Task
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.switch_off.planner import plan_switch_off
from redundancy_pin.planners.whole_trajectory.options import End
from redundancy_pin.planners.whole_trajectory.planner import plan_whole_trajectory

RETURN_TIME = 0.4
"""Duration of the carriers' return after switching off, s, as in the chapter on the thesis."""

SECONDS = 60.0
"""Time bound of one solution, s."""


class Case(Protocol):
    """What can be planned with a backend."""

    def plan(self, backend: str) -> Plan:
        """Plan it.

        Raises:
            InfeasiblePlanError: there is no plan.
        """
        ...


@dataclass(frozen=True)
class SwitchOff:
    """A crossing with the main motors off, as the thesis plans it.

    Attributes:
        task: the motion.
        threshold: condition number from which on they are off.
        dt: distance of the samples, s.
    """

    task: Task
    threshold: float
    dt: float = 1e-3

    def plan(self, backend: str) -> Plan:
        """Plan the crossing.

        Raises:
            InfeasiblePlanError: there is no plan.
        """
        return plan_switch_off(
            self.task.machine.dynamics(backend),
            self.task.trajectory(),
            threshold=self.threshold,
            ramp_down=self.task.ramp_down,
            return_time=RETURN_TIME,
            dt=self.dt,
        )


@dataclass(frozen=True)
class Whole:
    """A plan over the whole trajectory; carriers start at rest at the middle of their tracks.

    Attributes:
        task: the motion.
        objective: weights.
        coarser: factor on the largest step between nodes.
        end: how the carriers end; "datum" is at rest where they started.
        starts: first guesses.
        refinements: how often the grid may be refined.
        effort: limit of the main efforts, N or N·m; None for none.
        acceleration: limit of the carriers' acceleration in place of the robot's own, m/s²; None for its own.
    """

    task: Task
    objective: tuple[tuple[str, float], ...]
    coarser: float = 1.0
    end: End = "datum"
    starts: int = 1
    refinements: int = 3
    effort: float | None = None
    acceleration: float | None = None

    @property
    def name(self) -> str:
        """Of its files: task and objective."""
        end = "" if self.end == "datum" else f"-end-{self.end}"
        return f"{self.task.name}-{'-'.join(name for name, _ in self.objective)}{end}"

    def plan(self, backend: str) -> Plan:
        """Plan the motion.

        Raises:
            InfeasiblePlanError: no plan was found, and why.
            InputError: the motion cannot be that fast.
        """
        return plan_whole_trajectory(
            self.task.machine.dynamics(backend),
            self.task.trajectory(),
            objective=dict(self.objective),
            end=self.end,
            acceleration=self.acceleration,
            effort=self.effort,
            dt=self.coarser * self.task.dt,
            starts=self.starts,
            seconds=SECONDS,
            refinements=self.refinements,
        )


def whole(task: Task, objective: str, coarser: float = 1.0) -> Whole:
    """Return the plan of a task with a single objective."""
    return Whole(task, ((objective, 1.0),), coarser)
