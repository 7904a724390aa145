"""One plan in numbers: efforts at the samples and between them, carriers against their limits, energies."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.signal import find_peaks

from redundancy_pin.arrays import IntArray
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.experiments.planned import measures as m
from redundancy_pin.planners.plan import Plan, PlanStatus

INFEASIBLE = "infeasible"
"""Status of a row whose planner found no plan."""

UNKNOWN = math.nan


@dataclass(frozen=True)
class Row:
    """One way to carry out one motion.

    Attributes:
        task: name of the motion.
        way: how: ``WHOLE_EFFORT``, ....
        unit: of the main efforts.
        status: of the plan, a ``PlanStatus`` as text; "infeasible" where there is none, and the numbers are NaN.
        why: what the planner says where there is none.
        missing: force that nothing can carry at a singular pose, N, where that is why.
        peak: largest |τ| at the samples.
        dense_peak: largest |τ| between them; of a switch-off plan while the motors are on.
        before: of a switch-off plan, the largest |τ| until the motors are off; else NaN.
        reversals: most reversals of any main effort, see ``reversals``.
        rms: root mean square over time of the norm of τ.
        carrier_force: largest force of a carrier's actuator, N.
        main_energy, carrier_energy: ∫ |power| dt, J.
        position, speed, acceleration: largest |s|, |ṡ|, |s̈| of any carrier.
        track, speed_limit, acceleration_limit: the limits of these: half the track, m, m/s, m/s².
        broken: limits that are broken, the worst of each carrier and quantity.
        solver: how the solver ended; empty for planners without one.
        file: of the plan, without suffix; empty if none is written.
    """

    task: str
    way: str
    unit: str
    status: str
    why: str = ""
    missing: float = UNKNOWN
    peak: float = UNKNOWN
    dense_peak: float = UNKNOWN
    before: float = UNKNOWN
    reversals: float = UNKNOWN
    rms: float = UNKNOWN
    carrier_force: float = UNKNOWN
    main_energy: float = UNKNOWN
    carrier_energy: float = UNKNOWN
    position: float = UNKNOWN
    speed: float = UNKNOWN
    acceleration: float = UNKNOWN
    track: float = UNKNOWN
    speed_limit: float = UNKNOWN
    acceleration_limit: float = UNKNOWN
    broken: str = ""
    solver: str = ""
    file: str = ""

    @property
    def exists(self) -> bool:
        """Whether there is a plan."""
        return self.status != INFEASIBLE

    @property
    def sound(self) -> bool:
        """Whether there is a plan with finite efforts within all limits, and, of an optimiser, an optimal one."""
        return self.status == PlanStatus.WITHIN_LIMITS.value

    @property
    def energy(self) -> float:
        """∫ |power| dt of all actuators, J."""
        return self.main_energy + self.carrier_energy

    @property
    def worst(self) -> float:
        """Largest |τ|, at the samples or between them."""
        return max(self.peak, self.dense_peak)

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON; None where there is no number."""
        data = {**vars(self), "energy": self.energy}
        return {key: None if isinstance(value, float) and math.isnan(value) else value for key, value in data.items()}


def row_of(task: str, way: str, unit: str, plan: Plan, dense_peak: float, file: str = "") -> Row:
    """Return a plan in numbers.

    Args:
        task: name of the motion.
        way: how it is carried out.
        unit: of the main efforts.
        plan: the plan.
        dense_peak: its largest |τ| between the samples.
        file: of the plan, without suffix.
    """
    moves = plan.carriers.s.shape[1] > 0
    limits = plan.limits.judged_by
    return Row(
        task,
        way,
        unit,
        plan.status.value,
        peak=float(plan.peak_effort.max()),
        dense_peak=dense_peak,
        before=_before(plan),
        reversals=float(reversals(plan).max()),
        rms=m.rms(plan),
        carrier_force=m.peak_carrier_force(plan),
        main_energy=plan.main_energy,
        carrier_energy=plan.carrier_energy,
        position=_largest(plan.carriers.s),
        speed=_largest(plan.carriers.sd),
        acceleration=_largest(plan.carriers.sdd),
        track=max(limit.upper for limit in limits) if moves else UNKNOWN,
        speed_limit=max(limit.speed for limit in limits) if moves else UNKNOWN,
        acceleration_limit=max(limit.acceleration for limit in limits) if moves else UNKNOWN,
        broken=_broken(plan),
        solver=str(plan.diagnostics.get("solver", "")),
        file=file,
    )


def row_without(task: str, way: str, unit: str, error: InfeasiblePlanError) -> Row:
    """Return the row of a plan that does not exist."""
    missing = error.details.get("amount") if error.details.get("constraint") == "singular_pose" else None
    return Row(task, way, unit, INFEASIBLE, why=error.message,
               missing=float(missing) if isinstance(missing, float) else UNKNOWN)  # fmt: skip


SWING = 0.05
"""Fraction of the peak that an effort has to move back by for a turn to count."""


def reversals(plan: Plan) -> IntArray:
    """Return (m,) how often each main effort turns round and then moves by more than ``SWING`` of the peak."""
    least = SWING * float(plan.peak_effort.max())
    if least == 0.0:
        return np.zeros(plan.tau.shape[1], dtype=np.intp)
    tau = np.nan_to_num(plan.tau)
    return np.array(
        [sum(len(find_peaks(sign * effort, prominence=least)[0]) for sign in (1.0, -1.0)) for effort in tau.T]
    )


def dense_peak(plan: Plan) -> float:
    """Return the largest |τ| between the nodes of a whole-trajectory plan, by its own dense check, N or N·m."""
    check: Mapping[str, Any] = plan.diagnostics["dense_check"]  # type: ignore[assignment]
    return float(check["peak_effort"])


def _before(plan: Plan) -> float:
    if plan.planner != "switch_off":
        return UNKNOWN
    off = np.flatnonzero(plan.phase == plan.phases.index("off"))
    return float(np.nanmax(np.abs(plan.tau[: off[0]]))) if len(off) else UNKNOWN


def _largest(values: Any) -> float:
    return float(np.abs(values).max(initial=0.0))


def _broken(plan: Plan) -> str:
    worst: dict[tuple[str, str], Any] = {}
    for event in plan.limits.violated:
        key = (event.quantity, event.carrier)
        if key not in worst or event.amount > worst[key].amount:
            worst[key] = event
    return "; ".join(f"{kind} of {who} by {event.amount:.3g} at {event.worst:.2f} s" for (kind, who), event in
                     worst.items())  # fmt: skip
