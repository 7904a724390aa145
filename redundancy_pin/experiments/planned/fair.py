"""The fair comparison: no carriers, carriers parked, carriers moving; both sets of actuators counted."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.dynamics.distribution import SampleStatus
from redundancy_pin.experiments.planned import measures as m
from redundancy_pin.experiments.planned.cases import CORNERS, CROSSINGS, Mode, StepwiseCase, mode_text
from redundancy_pin.experiments.planned.mode_claims import MODE_CASES
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.planners.plan import Plan, PlanStatus

NONE, PARKED, MOVING = "no carriers", "carriers parked", "carriers moving"


@dataclass(frozen=True)
class FairRow:
    """One way to drive one motion.

    Attributes:
        motion: what is driven: ``"corner-r0.025"``.
        mode: working mode of the 3-RRR; empty for the 2-RPR.
        what: no carriers, carriers parked, or carriers moving and how.
        unit: of the main efforts.
        bounded: whether the main efforts are finite all along.
        peak: largest |τ| of any main actuator; infinite where not bounded.
        rms: root mean square over time of the norm of τ.
        carrier_force: largest force of a carrier's actuator, N.
        main_energy, carrier_energy: ∫ |power| dt of both sets of actuators, J.
        status: of the plan.
    """

    motion: str
    mode: Mode
    what: str
    unit: str
    bounded: bool
    peak: float
    rms: float
    carrier_force: float
    main_energy: float
    carrier_energy: float
    status: str

    @property
    def moving(self) -> bool:
        """Whether carriers move."""
        return self.what.startswith(MOVING)

    @property
    def energy(self) -> float:
        """∫ |power| dt of all actuators, J."""
        return self.main_energy + self.carrier_energy

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON; None where efforts are unbounded."""
        data = {**vars(self), "mode": list(self.mode), "energy": self.energy}
        return {key: None if isinstance(value, float) and np.isinf(value) else value for key, value in data.items()}


def fair_comparison(store: PlanStore, modes: Sequence[Mode]) -> tuple[FairRow, ...]:
    """Return the comparison for every motion of the thesis; corners and square in every working mode."""
    rows: list[FairRow] = []
    for crossing in CROSSINGS:
        motion = f"{crossing.path}-{crossing.speed:g}"
        if not any(row.motion == motion for row in rows):
            rows.append(_row(motion, (), PARKED, "N", store.parked(crossing)))
        what = f"{MOVING}, off above CN {crossing.threshold:g}"
        rows.append(_row(motion, (), what, "N", store.plan(crossing)))
    for mode in modes:
        for motion, cases in _by_motion(mode).items():
            rows.append(_row(motion, mode, NONE, "N·m", store.baseline(cases[0])))
            rows.append(_row(motion, mode, PARKED, "N·m", store.parked(cases[0])))
            rows += [_row(motion, mode, _how(case), "N·m", store.plan(case)) for case in cases]
    return tuple(rows)


def _by_motion(mode: Mode) -> dict[str, list[StepwiseCase]]:
    found: dict[str, list[StepwiseCase]] = {}
    raised = [case for case in MODE_CASES.values() if case.speed or case.acceleration]
    for case in (*CORNERS, *raised):
        name = "square" if case.path == "square" else f"corner-r{case.path_options['radius']:g}"
        found.setdefault(name, []).append(replace(case, mode=mode))
    return found


def _how(case: StepwiseCase) -> str:
    limit = f", {case.acceleration:g} m/s²" if case.acceleration else f", {case.speed:g} m/s" if case.speed else ""
    return f"{MOVING}, λ = {case.lam:g}{limit}"


def _row(motion: str, mode: Mode, what: str, unit: str, plan: Plan) -> FairRow:
    bounded = plan.status is not PlanStatus.UNBOUNDED_EFFORT
    # along a singular motion efforts without a plan grow without bound between samples, even if no sample is singular
    bounded &= not (what == PARKED and (plan.sample_status != SampleStatus.REGULAR).any())
    unknown = float("inf")
    return FairRow(
        motion,
        mode,
        what,
        unit,
        bounded,
        float(plan.peak_effort.max()) if bounded else unknown,
        m.rms(plan) if bounded else unknown,
        m.peak_carrier_force(plan),
        plan.main_energy if bounded else unknown,
        plan.carrier_energy,
        plan.status.value,
    )


def label(row: FairRow) -> str:
    """Return motion and working mode as text."""
    return f"{row.motion}, {mode_text(row.mode)}" if row.mode else row.motion
