"""Stepwise plans between their samples: samples alone flatter a method that chooses accelerations for them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.experiments.backends import VIRTUAL_WORK
from redundancy_pin.experiments.planned.cases import CORNERS
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.planners.stepwise.report import between_samples

POINTS = 4
"""Points inside each step."""


@dataclass(frozen=True)
class BetweenRow:
    """The largest torques of a plan at its samples and between them, while the optimiser works.

    Attributes:
        case: name of the case.
        at_samples: (3,) largest |τ|, N·m.
        between: (3,) the same between the samples, N·m.
        baseline: (3,) the same without carriers, N·m.
    """

    case: str
    at_samples: tuple[float, ...]
    between: tuple[float, ...]
    baseline: tuple[float, ...]

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return dict(vars(self))


def between_rows(store: PlanStore) -> tuple[BetweenRow, ...]:
    """Return the main stepwise plans between their samples."""
    rows = []
    for case in CORNERS:
        plan = store.plan(case)
        found = between_samples(case.dynamics(VIRTUAL_WORK), plan, POINTS, case.trajectory())
        none = np.abs(store.baseline(case).tau).max(axis=0)
        rows.append(
            BetweenRow(
                case.name, _tuple(found["optimised_peak_at_samples"]), _tuple(found["optimised_peak"]), _tuple(none)
            )
        )
    return tuple(rows)


def _tuple(values: object) -> tuple[float, ...]:
    return tuple(float(value) for value in np.asarray(values, dtype=float))
