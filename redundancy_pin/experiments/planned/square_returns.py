"""Whether any return on the square keeps the limits of the carriers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.experiments.planned.cases import Mode, square
from redundancy_pin.experiments.planned.store import PlanStore


@dataclass(frozen=True)
class SquareReturn:
    """The shortest returns within all limits, in one working mode.

    Attributes:
        mode: ±1 a leg.
        lam: λ.
        durations: of the returns, s; empty if one of them does not exist.
        why: what the planner says where one does not exist; empty otherwise.
    """

    mode: Mode
    lam: float
    durations: tuple[float, ...]
    why: str

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {**vars(self), "mode": list(self.mode), "durations": list(self.durations)}


def square_returns(store: PlanStore, modes: Sequence[Mode]) -> tuple[SquareReturn, ...]:
    """Ask for the shortest returns on the square with λ = 0 and 0.5."""
    return tuple(_returns(store, mode, lam) for mode in modes for lam in (0.0, 0.5))


def _returns(store: PlanStore, mode: Mode, lam: float) -> SquareReturn:
    try:
        plan = store.plan(replace(square(lam, mode), return_time="shortest"))
    except InfeasiblePlanError as error:
        return SquareReturn(mode, lam, (), error.message)
    found = np.asarray(plan.diagnostics["returns"], dtype=float).reshape(-1, 2)
    return SquareReturn(mode, lam, tuple(float(end - start) for start, end in found), "")
