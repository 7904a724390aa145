"""The result of a cross-check: one row for each check on each robot."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array
from redundancy_pin.crosscheck.states import REASONS
from redundancy_pin.io.summary import TextTable

SCOPE = (
    "The checks compare the dynamics with the model as it is declared. They do not say whether its lengths, masses "
    "and loads are those of your machine."
)
"""What a cross-check cannot find out; the first of the notes below every report."""

PARITY_SCALE = (
    f"Parity: where the singularity margin of the closures is below {NEAR_SINGULAR_MARGIN:g}, the deviation is "
    f"multiplied by the margin over {NEAR_SINGULAR_MARGIN:g}, because rounding grows as the inverse of the margin."
)
"""How deviations of parity are scaled; printed below a report with such rows."""

_HEADINGS = ("robot", "check", "states", "worst", "allowed", "")


@dataclass(frozen=True)
class CheckRow:
    """One check on one robot.

    Attributes:
        robot: name of the robot.
        check: what was compared.
        samples: number of states that were checked (of the row "random states": states that were used).
        worst: largest deviation, relative to the size of what was compared (of parity, scaled as ``PARITY_SCALE``
            states); NaN if one is not finite.
        tolerance: largest deviation that passes.
        passed: whether it does; false for a check without samples or with NaN.
        note: why the row does not count as a check; empty for a check.
        skipped: number of states that were skipped, by reason (a key of ``REASONS``).
        does_not_show: the errors of a model that pass; empty of rows that only count states.
    """

    robot: str
    check: str
    samples: int
    worst: float
    tolerance: float
    passed: bool
    note: str = ""
    skipped: Mapping[str, int] = field(default_factory=dict)
    does_not_show: str = ""

    @property
    def total(self) -> int:
        """Number of states, skipped ones included."""
        return self.samples + sum(self.skipped.values())

    @property
    def verdict(self) -> str:
        """``ok``, ``FAILED``, or ``left out`` for a row with a note."""
        return "left out" if self.note else "ok" if self.passed else "FAILED"

    @property
    def title(self) -> str:
        """What was compared, and why it is left out."""
        return f"{self.check}: {self.note}" if self.note else self.check

    @property
    def is_parity(self) -> bool:
        """Whether backends are compared with each other, and nothing with physics."""
        return self.check.startswith("parity")

    def as_dict(self) -> dict[str, Any]:
        """Return plain data, for JSON and tables."""
        return {**asdict(self), "total": self.total, "verdict": self.verdict}


@dataclass(frozen=True)
class CrossCheckReport:
    """All rows of a cross-check, and the seed of its random states."""

    rows: tuple[CheckRow, ...]
    seed: int

    @property
    def passed(self) -> bool:
        """Whether there are checks, every robot was judged by physics, and every check passes."""
        checks = [row for row in self.rows if not row.note]
        return bool(checks) and not self.unjudged and all(row.passed for row in checks)

    @property
    def unjudged(self) -> tuple[str, ...]:
        """Robots without a check against physics: backends that agree may share a wrong declaration."""
        judged = {row.robot for row in self.rows if not row.note and not row.is_parity}
        return tuple(dict.fromkeys(row.robot for row in self.rows if row.robot not in judged))

    @property
    def notes(self) -> tuple[str, ...]:
        """What the checks together, and each of them, do not show, and how deviations of parity are scaled."""
        kinds = {row.does_not_show: "parity" if row.is_parity else row.check for row in self.rows if row.does_not_show}
        scale = [PARITY_SCALE] * any(row.is_parity for row in self.rows)
        return (SCOPE, *(f"{kind.capitalize()}: {text}" for text, kind in kinds.items()), *scale)

    def as_dict(self) -> dict[str, object]:
        """Return plain numbers, for JSON."""
        rows = [row.as_dict() for row in self.rows]
        return {"passed": self.passed, "seed": self.seed, "rows": rows, "notes": list(self.notes)}

    def table(self) -> TextTable:
        """Return the report as a table for people."""
        rows = list[tuple[str, ...]]()
        for row in self.rows:
            states = f"{row.samples} of {row.total}" if row.skipped else str(row.samples)
            numbers = ("", "") if row.note else (f"{row.worst:.1e}", f"{row.tolerance:.0e}")
            rows.append((row.robot, row.title, states, *numbers, row.verdict))
            rows += [("", f"  skipped: {REASONS[why]}", str(count), "", "", "") for why, count in row.skipped.items()]
        title, colours = f"cross-check, seed {self.seed}", {"ok": "green", "FAILED": "red"}
        return TextTable(title, rows, _HEADINGS, left=2, caption="\n".join(self.notes), colours=colours)


def checked_row(
    robot: str,
    check: str,
    values: Array,
    tolerance: float,
    skipped: Mapping[str, int],
    note: str = "",
    does_not_show: str = "",
) -> CheckRow:
    """Return the row of a check by the deviations (N,) of its states, relative to the size of what was compared.

    A check that skips every state is left out, with a note. It fails if another branch is the reason, because the
    backend may be wrong.
    """
    worst = float(np.max(values, initial=0.0)) if np.isfinite(values).all() else float("nan")
    nothing = bool(skipped) and not len(values) and "other_branch" not in skipped
    note, passed = note or "every state is skipped" * nothing, len(values) > 0 and worst <= tolerance
    return CheckRow(robot, check, len(values), worst, tolerance, passed, note, skipped, does_not_show)


def merged(rows: Iterable[CheckRow]) -> tuple[CheckRow, ...]:
    """Return one row for each check and robot, in the order of first appearance; a NaN stays."""
    total: dict[tuple[str, str], CheckRow] = {}
    for row in rows:
        before = total.get((row.robot, row.check))
        if before is not None:
            samples, worst = row.samples + before.samples, float(np.maximum(before.worst, row.worst))
            skipped = dict(Counter(row.skipped) + Counter(before.skipped))
            note = row.note and before.note  # one batch with states makes it a check
            row = replace(row, samples=samples, worst=worst, note=note, skipped=skipped)
        total[row.robot, row.check] = replace(row, passed=row.samples > 0 and row.worst <= row.tolerance)
    return tuple(total.values())
