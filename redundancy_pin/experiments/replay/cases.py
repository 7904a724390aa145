"""The plans that are replayed: of all three planners, through singularities and around corners."""

from __future__ import annotations

from dataclasses import dataclass

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.experiments.beyond.cases import SwitchOff
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.experiments.beyond.tasks import CORNERS, CROSSINGS, HEAVY, Task
from redundancy_pin.experiments.beyond.ways import (
    EFFORT,
    STEPWISE,
    STEPWISE_HALF,
    SWITCH_OFF,
    case_of,
    stepwise_case,
)
from redundancy_pin.planners.plan import Plan
from redundancy_pin.simulation.replay import DRIVES, Drive

_LIGHT, _HEAVY, _FIVE_BAR = CROSSINGS[0], CROSSINGS[2], CROSSINGS[5]
_HEAVY_LINE = Task(
    "heavy-line-0.2",
    "2-RPR with masses (end-effector 0.5 kg, cylinders 0.3 kg), line at 0.2 m/s",
    HEAVY,
    "line",
    0.2,
    0.01,
    threshold=4.0,
    ramp_down=0.36,
)
_MASSLESS: tuple[Drive, ...] = ("open loop", "carriers by motion")


SPARSE = 5e-3
"""Distance of the samples of switch-off plans, s: the carriers' motion is the same, the replay five times as fast."""


@dataclass(frozen=True)
class ReplayCase:
    """A plan to replay.

    Attributes:
        task: the motion.
        way: how it is planned.
        drives: what drives the machine.
    """

    task: Task
    way: str
    drives: tuple[Drive, ...] = DRIVES

    @property
    def name(self) -> str:
        """Unique, for tables."""
        return f"{self.task.name}, {self.way}"

    def plan(self, store: BeyondStore, coarser: float) -> Plan | InfeasiblePlanError:
        """Return the plan, or why there is none."""
        backend = self.task.machine.backends[0]
        try:
            if self.way in (STEPWISE, STEPWISE_HALF):
                return store.thesis.plan(stepwise_case(self.task, 0.0 if self.way == STEPWISE else 0.5))
            if self.way != SWITCH_OFF:
                return store.plan(case_of(self.task, self.way, coarser), backend)
            return store.plan(SwitchOff(self.task, self.task.threshold, SPARSE), backend)
        except InfeasiblePlanError as error:
            return error


CASES: tuple[ReplayCase, ...] = (
    ReplayCase(_LIGHT, SWITCH_OFF, _MASSLESS),
    ReplayCase(_LIGHT, EFFORT, ("open loop",)),
    ReplayCase(_HEAVY, SWITCH_OFF),
    ReplayCase(_HEAVY, EFFORT),
    ReplayCase(_HEAVY_LINE, SWITCH_OFF),
    ReplayCase(_HEAVY_LINE, EFFORT),
    ReplayCase(_FIVE_BAR, SWITCH_OFF),
    ReplayCase(_FIVE_BAR, EFFORT),
    ReplayCase(CORNERS[0], STEPWISE),
    ReplayCase(CORNERS[0], STEPWISE_HALF),
    ReplayCase(CORNERS[0], EFFORT),
    ReplayCase(CORNERS[1], STEPWISE),
    ReplayCase(CORNERS[1], EFFORT),
    ReplayCase(CORNERS[2], STEPWISE),
    ReplayCase(CORNERS[2], EFFORT),
)
