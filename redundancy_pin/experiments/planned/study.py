"""The planned study: runs every case once and judges it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from redundancy_pin.experiments.planned.between import BetweenRow, between_rows
from redundancy_pin.experiments.planned.conclusions import Conclusion, conclusions
from redundancy_pin.experiments.planned.crossings import CrossingRow, Infeasible, crossing_rows, with_heavy_end_effector
from redundancy_pin.experiments.planned.fair import FairRow, fair_comparison
from redundancy_pin.experiments.planned.judged import ROWS, Judged
from redundancy_pin.experiments.planned.mode_table import ClaimRow, ModeRow, mode_rows
from redundancy_pin.experiments.planned.parity import MAIN_CASES, PlanParity, plan_parity
from redundancy_pin.experiments.planned.sensitivity import SensitivityRow, sensitivity
from redundancy_pin.experiments.planned.settings import FULL, StudySettings
from redundancy_pin.experiments.planned.square_returns import SquareReturn, square_returns
from redundancy_pin.experiments.planned.statements import statements
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.experiments.planned.together import growth_with_threshold, same_before_the_corner, same_step
from redundancy_pin.experiments.planned.verdict import RULE

Told = Callable[[str], None]
"""Called after each part with what was done."""


@dataclass(frozen=True, eq=False)
class Study:
    """What the planned experiments say.

    Attributes:
        settings: extent.
        store: the plans, for figures.
        parity: of the plans by both backends.
        judged: the statements of the thesis, judged, by ``ROWS``.
        between: stepwise plans between their samples.
        modes: the working modes.
        claims: statements in words, in every working mode.
        returns: whether any returns on the square keep the limits.
        crossings: what became of the crossings.
        heavy: why a massive end-effector cannot cross; None if it can.
        fair: the comparison with both sets of actuators counted.
        conclusions: what becomes of the thesis's conclusions.
        sensitivity: ranges over what is unstated.
    """

    settings: StudySettings
    store: PlanStore
    parity: tuple[PlanParity, ...]
    judged: tuple[Judged, ...]
    between: tuple[BetweenRow, ...]
    modes: tuple[ModeRow, ...]
    claims: tuple[ClaimRow, ...]
    returns: tuple[SquareReturn, ...]
    crossings: tuple[CrossingRow, ...]
    heavy: Infeasible | None
    fair: tuple[FairRow, ...]
    conclusions: tuple[Conclusion, ...]
    sensitivity: tuple[SensitivityRow, ...]

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {
            "rule": RULE,
            "parity": [row.as_dict() for row in self.parity],
            "against_thesis": [row.as_dict() for row in self.judged],
            "between_samples": [row.as_dict() for row in self.between],
            "working_modes": [row.as_dict() for row in self.modes],
            "claims": [row.as_dict() for row in self.claims],
            "shortest_returns_on_square": [row.as_dict() for row in self.returns],
            "crossings": [row.as_dict() for row in self.crossings],
            "heavy_end_effector": self.heavy.as_dict() if self.heavy else None,
            "fair_comparison": [row.as_dict() for row in self.fair],
            "conclusions": [row.as_dict() for row in self.conclusions],
            "sensitivity": [_without_nan(vars(row)) for row in self.sensitivity],
        }


PARTS = len(MAIN_CASES) + 5
"""How often ``run_study`` tells of progress."""


def run_study(settings: StudySettings = FULL, told: Told | None = None) -> Study:
    """Run the planned experiments.

    Args:
        settings: how much of them.
        told: called after each of ``PARTS`` parts.

    Raises:
        CrossCheckError: the backends plan a case differently.
        InfeasiblePlanError: a case of the thesis has no plan.
    """
    tell = told or (lambda what: None)
    store = PlanStore()
    parity = []
    for case in MAIN_CASES:
        parity.append(plan_parity(store, case))
        tell(case.name)
    judged = [statement.judged(store, ROWS[statement.row]) for statement in statements(settings)]
    judged += [same_step(store, settings), growth_with_threshold(store), same_before_the_corner(store)]
    tell("statements")
    between = between_rows(store)
    modes, claims = mode_rows(store, settings.modes)
    judged += [row.judged() for row in claims]
    returns = square_returns(store, settings.modes)
    tell("working modes")
    crossings, heavy = crossing_rows(store), with_heavy_end_effector(store)
    tell("limits of the crossings")
    fair = fair_comparison(store, settings.modes)
    tell("fair comparison")
    ranges = sensitivity(store, settings)
    tell("sensitivity")
    order = list(ROWS)
    return Study(
        settings,
        store,
        tuple(parity),
        tuple(sorted(judged, key=lambda row: order.index(row.row))),
        between,
        modes,
        claims,
        returns,
        crossings,
        heavy,
        fair,
        conclusions(fair, crossings, heavy, claims),
        ranges,
    )


def _without_nan(row: dict[str, object]) -> dict[str, object]:
    return {key: None if isinstance(value, float) and np.isnan(value) else value for key, value in row.items()}
