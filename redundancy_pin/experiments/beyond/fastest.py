"""How fast a motion can be within the carriers' limits: bisection on speed with the verdict of the planner.

The problem is not convex, so a verdict "infeasible" is local: no plan was found from any first guess. A speed counts as
out of reach only if every first guess fails with two objectives, which lead the solver along different ways.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.experiments.beyond.cases import Whole
from redundancy_pin.experiments.beyond.rows import dense_peak
from redundancy_pin.experiments.beyond.settings import BeyondSettings
from redundancy_pin.experiments.beyond.store import BeyondStore
from redundancy_pin.experiments.beyond.tasks import Task
from redundancy_pin.planners.plan import Plan, PlanStatus

GROWTH = 1.3
"""Factor on the speed until it is too high."""

UNDECIDED = "seconds"
"""Constraint that the planner names when its time ran out: no verdict."""

_MORE = 1.01
"""Factor on the acceleration that would suffice, to see whether a plan exists then: bounds are met to rounding."""


@dataclass(frozen=True)
class Trial:
    """One speed tried.

    Attributes:
        speed: m/s.
        feasible: whether a plan within the limits was found.
        status: of the plan; "infeasible".
        peak: largest |τ| at the nodes or between them, N or N·m; NaN without a plan.
        binding: limits that the plan touches.
        constraint: limit in the way without a plan.
        carrier, time: where.
        limit: the limit that would suffice; NaN if unknown.
        unit: of the limit.
        fraction: by how much the limits would have to be wider.
        said: what the planner says.
    """

    speed: float
    feasible: bool
    status: str
    peak: float = math.nan
    binding: tuple[str, ...] = ()
    constraint: str = ""
    carrier: str = ""
    time: float = math.nan
    limit: float = math.nan
    unit: str = ""
    fraction: float = math.nan
    said: str = ""

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON; None where there is no number."""
        data = {**vars(self), "binding": list(self.binding)}
        return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in data.items()}


@dataclass(frozen=True)
class Fastest:
    """The bracket of the fastest motion.

    Attributes:
        task: name of the motion.
        title: for people.
        unit: of the main efforts.
        effort: limit of the main efforts; infinite for none.
        slower: the fastest speed with a plan.
        faster: the slowest without one; None if every speed that the ramps allow has a plan.
        starts: first guesses tried at ``faster``, with each of two objectives.
        suffices: whether a plan exists at ``faster`` with the wider acceleration that the verdict names; None if it
            names no acceleration.
        trials: all speeds tried, ascending.
    """

    task: str
    title: str
    unit: str
    effort: float
    slower: Trial
    faster: Trial | None
    starts: int
    suffices: bool | None
    trials: tuple[Trial, ...]

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {
            "task": self.task,
            "effort_limit": None if math.isinf(self.effort) else self.effort,
            "fastest_with_plan": self.slower.as_dict(),
            "slowest_without": self.faster.as_dict() if self.faster else None,
            "starts": self.starts,
            "suffices": self.suffices,
            "trials": [trial.as_dict() for trial in self.trials],
        }


def fastest(
    store: BeyondStore,
    task: Task,
    settings: BeyondSettings,
    effort: float = math.inf,
    tell: Callable[[str], None] | None = None,
) -> Fastest:
    """Bracket the fastest motion that has a plan.

    On the way a speed is tried with parked carriers as the first guess; the upper end of the bracket then from all
    first guesses, and if a plan turns up the search goes on.

    Args:
        store: the plans.
        task: the motion at a speed that has a plan.
        settings: width of the bracket, first guesses.
        effort: limit of the main efforts, N or N·m.
        tell: called after each speed.

    Raises:
        InfeasiblePlanError: the task has no plan at its own speed.
        InputError: nor is it a motion at all.
    """
    trials: dict[float, Trial] = {}

    def tried(speed: float, starts: int = 1) -> Trial:
        if speed not in trials or (starts > 1 and not trials[speed].feasible):
            trials[speed] = attempt(store, _at(task, speed, settings, effort, starts))
            if tell:
                tell(f"{task.name}: {speed:.3g} m/s")
        return trials[speed]

    def bracket(low: float, high: float) -> tuple[float, float | None]:
        while _exists(task, high) and tried(high).feasible:
            low, high = high, high * GROWTH
        if not _exists(task, high):
            return low, None
        while high - low > settings.tolerance * low:
            middle = 0.5 * (low + high)
            low, high = (middle, high) if tried(middle).feasible else (low, middle)
        return low, high

    store.plan(_at(task, task.speed, settings, effort), task.machine.backends[0])
    tried(task.speed)
    low, high = bracket(task.speed, task.speed * GROWTH)
    while high is not None and tried(high, settings.starts).feasible:
        low, high = bracket(high, high * (1.0 + settings.tolerance))
    ordered = tuple(trials[speed] for speed in sorted(trials))
    verdict: Trial | None = None
    enough: bool | None = None
    if high is not None:
        verdict = trials[high]
        enough = _suffices(store, _at(task, high, settings, effort), verdict)
    return Fastest(
        task.name, task.title, task.unit, effort, trials[low], verdict, settings.starts if verdict else 0, enough,
        ordered,
    )  # fmt: skip


def attempt(store: BeyondStore, case: Whole) -> Trial:
    """Try one speed from the first guesses of a case, with its objective and with the gentlest motion as the aim."""
    speed, backend = case.task.speed, case.task.machine.backends[0]
    gentle = replace(case, objective=(("carrier_acceleration", 1.0),))
    failed = Trial(speed, False, "infeasible")
    for attempted in (case, gentle):
        outcome = store.outcome(attempted, backend)
        if isinstance(outcome, InfeasiblePlanError):
            failed = _failed(speed, outcome)
        elif outcome.status in (PlanStatus.WITHIN_LIMITS, PlanStatus.STOPPED_EARLY):
            binding = sorted({f"{event.quantity} of {event.carrier}" for event in outcome.limits.binding})
            peak = max(float(outcome.peak_effort.max()), dense_peak(outcome))
            return Trial(speed, True, outcome.status.value, peak, tuple(binding))
        else:
            failed = Trial(speed, False, outcome.status.value, said="the plan breaks limits or has no finite efforts")
    return failed


def _failed(speed: float, error: InfeasiblePlanError) -> Trial:
    details = error.details
    return Trial(
        speed,
        False,
        "infeasible",
        constraint=str(details.get("constraint", "")),
        carrier=str(details.get("carrier", "")),
        time=_number(details.get("time")),
        limit=_number(details.get("limit")),
        unit=str(details.get("unit", "")),
        fraction=_number(details.get("fraction")),
        said=error.message,
    )


def _suffices(store: BeyondStore, case: Whole, verdict: Trial) -> bool | None:
    """Return whether the wider acceleration that a verdict names admits a plan."""
    if verdict.constraint != "acceleration" or math.isnan(verdict.limit):
        return None
    wider = replace(case, starts=1, acceleration=_MORE * abs(verdict.limit))
    return isinstance(store.outcome(wider, case.task.machine.backends[0]), Plan)


def _at(task: Task, speed: float, settings: BeyondSettings, effort: float, starts: int = 1) -> Whole:
    limit = None if math.isinf(effort) else effort
    objective: tuple[tuple[str, float], ...] = (("effort", 1.0),)
    return Whole(replace(task, speed=speed), objective, settings.coarser, starts=starts, refinements=1, effort=limit)


def _exists(task: Task, speed: float) -> bool:
    """Return whether the ramps fit into the motion at a speed."""
    try:
        replace(task, speed=speed).trajectory()
    except InputError:
        return False
    return True


def _number(value: object) -> float:
    return float(value) if isinstance(value, (int, float)) else math.nan
