"""A whole motion planned as if on line: one plan a tick, of which the carriers follow the first piece."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Frozen, positive
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.receding_horizon.planner import Command, PlanningStatus, RecedingHorizon, _from
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory, continuous_motion
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial


@dataclass(frozen=True, eq=False)
class OnLineRun(Frozen):
    """What came of a whole motion.

    Attributes:
        plan: what the carriers did and which efforts that takes, judged as any other plan.
        commands: one a tick.
    """

    plan: Plan
    commands: tuple[Command, ...]

    @property
    def counts(self) -> dict[str, int]:
        """Ticks by status."""
        found = Counter(command.status for command in self.commands)
        return {status.value: found[status] for status in PlanningStatus}


def run_online(
    planner: RecedingHorizon,
    motion: PlatformMotion | TimedTrajectory,
    *,
    tick: float | None = None,
    start: ArrayLike = 0.0,
) -> OnLineRun:
    """Plan along a motion tick after tick, each plan with a preview of one horizon.

    Args:
        planner: the planner, before its first tick.
        motion: the whole motion.
        tick: between plans, s; a step when left out.
        start: scalar or (k,) where the carriers are at the start, m.
    """
    tick = planner.step if tick is None else positive(tick, "tick", "s")
    source = continuous_motion(motion)
    times = np.append(np.arange(source.start, source.end - 1e-9, tick), source.end)
    commands, pieces = [], []
    for i, (t, until) in enumerate(zip(times[:-1].tolist(), times[1:].tolist(), strict=True)):
        commands.append(planner.update(t, motion, *((start, 0.0) if i == 0 else ())))
        pieces.append(_from(commands[-1].carriers, t, until))
    position = PiecewisePolynomial.joined(pieces)
    functions = PlanFunctions(source, position.made_continuous())
    singular = np.unique(np.concatenate([command.singular for command in commands]))
    nodes = np.unique(np.concatenate([np.arange(source.start, source.end, 0.005), times]))
    nodes = nodes[(np.abs(nodes[:, None] - singular) > 1e-6).all(axis=1)]
    plan = finish_plan(
        planner.dynamics.along(source.sample_at(nodes)),
        functions.carriers_at(nodes),
        planner="receding_horizon",
        phase=np.zeros(len(nodes), dtype=np.intp),
        phases=("on line",),
        parameters={"horizon": planner.horizon, "step": planner.step, "tick": tick, **planner.limits.parameters()},
        diagnostics={"singular_instants": singular.tolist()},
        carrier_limits=planner.limits.of_carriers,
        functions=functions,
        dynamics=planner.dynamics,
    )
    return OnLineRun(plan, tuple(commands))
