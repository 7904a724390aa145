"""What a planner says of one cell of a feasibility map: possible, impossible for which limit, or not known."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InfeasiblePlanError, SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.io.json_data import json_data
from redundancy_pin.planners.limits import LIMIT_TOLERANCE
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.map_problem import MapProblem

UNDECIDED = ("", "seconds", "balance")
"""What an error of a planner names as its constraint where it shows of no limit that it is in the way."""

Key = tuple[str, float, float]
"""Planner, value on the x axis, value on the y axis."""


VERDICTS = (ResultStatus.OK, ResultStatus.NOT_CONVERGED, ResultStatus.UNRESOLVED, ResultStatus.INFEASIBLE)
"""The statuses of a cell, in the order of precedence among several attempts: a plan comes first; after a failed attempt
it is not shown that there is no plan."""


@dataclass(frozen=True)
class Cell:
    """What a planner says of one cell.

    Attributes:
        planner: its name on the command line.
        x, y: values of the two parameters.
        verdict: what is known.
        limits: feasible: the limits that bind, at least to 0.1 %; infeasible: those in the way, the worst first.
            "track", "speed", "acceleration", "jerk", "force" of a carrier, "effort" of a main actuator, "end" of the
            motion, "workspace", and whatever else a planner names.
        joint: infeasible: which carrier or actuator exceeds the first of them most.
        time: when, s.
        amount: by how much, in its unit.
        peak_effort: largest |τ| of any main actuator, between the samples included where the planner looks there, N or
            N·m; None without a plan.
        dense_ratio: largest effort between the samples over the largest at the samples; None where it is not known.
        seconds: time taken.
        status: status of the plan; empty without one.
        message: why there is none, what limits it breaks, or that its peak effort lies between the samples.
        settings: parameters of the planner in the attempt that decided.
    """

    planner: str
    x: float
    y: float
    verdict: ResultStatus
    limits: tuple[str, ...] = ()
    joint: str | None = None
    time: float | None = None
    amount: float | None = None
    peak_effort: float | None = None
    dense_ratio: float | None = None
    seconds: float = 0.0
    status: str = ""
    message: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)

    @property
    def key(self) -> Key:
        """What tells it from the others of a map."""
        return self.planner, self.x, self.y

    @property
    def possible(self) -> bool | None:
        """Whether the machine can do it; None where nothing is known."""
        if self.verdict is ResultStatus.UNRESOLVED:
            return None
        return self.verdict is not ResultStatus.INFEASIBLE

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON; None for NaN and infinity."""
        return dict(json_data(asdict(self)))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Cell:
        """Return a cell from its plain data; KeyError, TypeError or ValueError where it is none."""
        return cls(**{**data, "verdict": ResultStatus(data["verdict"]), "limits": tuple(data["limits"])})


def compute(problem: MapProblem, planner: str, x: float, y: float) -> Cell:
    """Return what a planner says of one cell: its first plan that keeps every limit, or the answer that says most.

    Whatever goes wrong is in the cell: a sweep does not stop for one.
    """
    began = time.perf_counter()
    answers: list[Cell] = []
    for settings in problem.attempts(planner):
        cell = Cell(planner, x, y, ResultStatus.OK, settings=settings)
        try:
            plan = problem.case(planner, x, y, settings).plan(problem.backend)
            answers.append(judge(cell, plan, problem.at(x, y)[2]))
        except Exception as error:
            answers.append(judge_error(cell, error))
        if answers[-1].verdict is ResultStatus.OK:
            break
    best = min(answers, key=lambda answer: VERDICTS.index(answer.verdict))
    return replace(best, seconds=round(time.perf_counter() - began, 4))


def judge(cell: Cell, plan: Plan, limits: Mapping[str, float]) -> Cell:
    """Return a cell with what a plan says of it.

    A plan that breaks a limit of the carriers, exceeds the limit of the main efforts (``limits``, by name of
    ``LIMITS``; that of the plan, which is the robot's own, where left out), or needs unbounded ones is none.
    """
    effort, peak = limits.get("max_effort"), float(plan.peak_effort_at_samples.max(initial=0.0))
    cell = replace(cell, dense_ratio=plan.between.ratio, status=plan.status.value)
    if plan.status is ResultStatus.UNBOUNDED:
        return replace(
            cell, verdict=ResultStatus.INFEASIBLE, limits=("effort",), message="No finite main efforts exist."
        )
    between = float(plan.peak_effort.max(initial=0.0))
    cell = replace(cell, peak_effort=between)
    most = plan.limits.judged_by.effort if effort is None else np.full(len(plan.robot.actuated), effort)
    broken = _broken(plan, most)
    if broken:
        _, _, joint, worst, amount = broken[0]
        names = tuple(dict.fromkeys(name for _, name, *_ in broken))
        shown = "; ".join(f"{name} of {whose} by {by:.4g} at {t:.4g} s" for _, name, whose, t, by in broken[:4])
        message = f"The plan violates limits: {shown}."
        verdict = ResultStatus.INFEASIBLE
        return replace(cell, verdict=verdict, limits=names, joint=joint, time=worst, amount=amount, message=message)
    if (plan.peak_effort > most * (1.0 + LIMIT_TOLERANCE)).any():
        message = f"Between the nodes the efforts reach {between:.4g}: not resolved."
        return replace(cell, verdict=ResultStatus.UNRESOLVED, message=message)
    cell = replace(cell, limits=_binding(plan, most, limits.get("max_jerk")))
    if plan.status is ResultStatus.UNRESOLVED:
        # the peak of the continuous motion is known, and is what the limit is compared with
        limit = "no limit of the efforts is given" if effort is None else f"the limit is {effort:.4g}"
        message = f"Between the samples the efforts reach {between:.4g}, at the samples {peak:.4g}: {limit}."
        return replace(cell, message=message)
    if plan.status is ResultStatus.NOT_CONVERGED:
        message = f"The solver says {plan.findings.solver}."
        return replace(cell, verdict=ResultStatus.NOT_CONVERGED, message=message)
    return cell


def judge_error(cell: Cell, error: Exception) -> Cell:
    """Return a cell with what an error of the planner says of it.

    Poses out of reach, type I singularities and changes of the working mode are limits of the machine. Errors that name
    no constraint, or one that only says that the planner gave up, leave the cell unknown.
    """
    cell = replace(cell, message=f"{type(error).__name__}: {' '.join(str(error).split())}")
    if isinstance(error, (UnreachablePoseError, SingularPoseError, WorkingModeError)):
        return replace(cell, verdict=ResultStatus.INFEASIBLE, limits=("workspace",))
    details: Mapping[str, Any] = error.details if isinstance(error, InfeasiblePlanError) else {}
    constraint = str(details.get("constraint", ""))
    if constraint in UNDECIDED:
        return replace(cell, verdict=ResultStatus.UNRESOLVED)
    relaxed = [str(entry["constraint"]) for entry in details["relaxations"]] if details.get("together") else ()
    when = {"time": details.get("time", details.get("t")), "amount": details.get("amount")}
    known: dict[str, Any] = {name: float(value) for name, value in when.items() if value is not None}
    known |= {"joint": str(details["joint"])} if details.get("joint") is not None else {}
    return replace(
        cell, verdict=ResultStatus.INFEASIBLE, limits=tuple(dict.fromkeys(relaxed or (constraint,))), **known
    )


def _broken(plan: Plan, most: Array) -> list[tuple[float, str, str, float, float]]:
    """Return relative excess, quantity, whose, when and amount of every limit that is broken, the worst first.

    ``most`` (m,) limits of the main efforts, N or N·m.
    """
    broken = [
        (event.amount / max(abs(event.limit), 1e-12), event.quantity, event.joint, event.worst, event.amount)
        for event in plan.limits.violated
        if event.quantity != "effort"  # judged below; between the nodes it says that the plan is not resolved
    ]
    use = np.nan_to_num(np.abs(plan.tau) / most)
    if use.max(initial=0.0) > 1.0 + LIMIT_TOLERANCE:
        i, j = np.unravel_index(int(use.argmax()), use.shape)
        excess, which = float((use[i, j] - 1.0) * most[j]), plan.robot.actuated[int(j)]
        broken.append((float(use[i, j]) - 1.0, "effort", which, float(plan.t[i]), excess))
    return sorted(broken, reverse=True)


def _binding(plan: Plan, effort: Array, jerk: float | None) -> tuple[str, ...]:
    """Return the limits of which a plan uses all but a thousandth, the one most used first.

    ``effort`` (m,) limits of the main efforts, N or N·m; ``jerk`` of the carriers, m/s³.
    """
    s = plan.carriers
    limits = plan.limits.judged_by
    lower, upper = limits.track.T
    use = {
        "track": np.abs(s.s - 0.5 * (lower + upper)) / (0.5 * (upper - lower)),
        "speed": np.abs(s.sd) / limits.speed,
        "acceleration": np.abs(s.sdd) / limits.acceleration,
        "force": np.abs(plan.carrier_force) / limits.carrier_force,
        "effort": plan.peak_effort / effort,
    }
    if jerk:
        h = np.diff(plan.t)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):  # two-sided samples have no step between them
            use["jerk"] = np.where(h > 0.0, np.abs(np.diff(s.sdd, axis=0)) / (h * jerk), 0.0)
    most = {name: float(np.max(np.where(np.isfinite(part), part, 0.0), initial=0.0)) for name, part in use.items()}
    return tuple(name for name in sorted(most, key=lambda name: -most[name]) if most[name] >= 1.0 - LIMIT_TOLERANCE)
