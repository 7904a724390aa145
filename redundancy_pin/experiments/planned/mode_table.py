"""The stepwise plans in every working mode: peaks, limits met, and what of the thesis holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.experiments.planned import measures as m
from redundancy_pin.experiments.planned.cases import Mode, mode_text
from redundancy_pin.experiments.planned.judged import ROWS, Judged
from redundancy_pin.experiments.planned.mode_claims import CLAIMS, MODE_CASES, Beside, Claim, runs_of
from redundancy_pin.experiments.planned.store import PlanStore


@dataclass(frozen=True)
class ModeRow:
    """One run in one working mode.

    Attributes:
        mode: ±1 a leg.
        case: name in ``MODE_CASES``.
        baseline_peak, peak, rms: (3,) |τ| without carriers and with them, N·m.
        limits: limits met, with the first time each.
        status: of the plan.
    """

    mode: Mode
    case: str
    baseline_peak: tuple[float, ...]
    peak: tuple[float, ...]
    rms: tuple[float, ...]
    limits: str
    status: str

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {**vars(self), "mode": list(self.mode), "case": MODE_CASES[self.case].name}


@dataclass(frozen=True)
class ClaimRow:
    """A claim in every mode.

    Attributes:
        claim: the claim.
        outcomes: by mode: whether it holds, and the number that decides.
    """

    claim: Claim
    outcomes: dict[Mode, tuple[bool, str]]

    @property
    def holding(self) -> tuple[Mode, ...]:
        """The modes in which it holds."""
        return tuple(mode for mode, (holds, _) in self.outcomes.items() if holds)

    def judged(self) -> Judged:
        """Return the claim as a row of the table."""
        first = next(iter(self.outcomes))
        holding, total = self.holding, len(self.outcomes)
        if holding:
            reason = f"in {len(holding)} of {total} working modes: {', '.join(mode_text(mode) for mode in holding)}"
        else:
            reason = f"in none of {total} working modes ({self.claim.criterion})"
        return Judged(
            self.claim.row,
            self.claim.source,
            ROWS[self.claim.row],
            self.claim.text,
            "said",
            f"{mode_text(first)}: {self.outcomes[first][1]}",
            "",
            "",
            "reproduced" if holding else "differs",
            reason,
            first in holding,
        )

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        modes = {mode_text(mode): {"holds": holds, "found": said} for mode, (holds, said) in self.outcomes.items()}
        return {"row": self.claim.row, "claim": self.claim.text, "criterion": self.claim.criterion, "modes": modes}


def mode_rows(store: PlanStore, modes: Sequence[Mode]) -> tuple[tuple[ModeRow, ...], tuple[ClaimRow, ...]]:
    """Run every working mode.

    Returns:
        One row a mode and case, and one a claim.
    """
    runs = {mode: runs_of(store, mode) for mode in modes}
    rows = tuple(_row(mode, name, run) for mode, found in runs.items() for name, run in found.items())
    claims = tuple(
        ClaimRow(claim, {mode: _plain(claim.test(found)) for mode, found in runs.items()}) for claim in CLAIMS
    )
    return rows, claims


def _plain(outcome: tuple[bool, str]) -> tuple[bool, str]:
    return bool(outcome[0]), outcome[1]


def _row(mode: Mode, name: str, run: Beside) -> ModeRow:
    plan = run.plan
    return ModeRow(
        mode,
        name,
        _tuple(np.abs(run.baseline.tau).max(axis=0)),
        _tuple(plan.peak_effort),
        _tuple(plan.rms_effort),
        limits_met(run),
        plan.status.value,
    )


def limits_met(run: Beside) -> str:
    """Return which carriers meet which limit first when: ``"2 speed 0.34 s, 2 acceleration 0.82 s"``."""
    first: dict[tuple[int, str], float] = {}
    for carrier, kind, start, _ in m.bounds(run.plan):
        first.setdefault((carrier, kind), start)
    return ", ".join(f"{carrier} {kind} {start:.2f} s" for (carrier, kind), start in first.items()) or "none"


def _tuple(values: Array) -> tuple[float, ...]:
    return tuple(float(value) for value in values)
