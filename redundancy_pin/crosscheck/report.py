"""Results of the cross-check: one row a check, and the report that holds them."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict, dataclass

import numpy as np
from rich.table import Table

from redundancy_pin.arrays import Array


@dataclass(frozen=True)
class CheckRow:
    """One check on one robot.

    Attributes:
        robot: robot it was made on.
        check: what was compared.
        samples: number of states.
        worst: largest deviation, relative to the size of what was compared.
        tolerance: largest deviation that passes.
        passed: whether it does; false for a check without samples or with NaN.
    """

    robot: str
    check: str
    samples: int
    worst: float
    tolerance: float
    passed: bool


@dataclass(frozen=True)
class CrossCheckReport:
    """All rows of a cross-check."""

    rows: tuple[CheckRow, ...]
    seed: int

    @property
    def passed(self) -> bool:
        """Whether there are rows and every one of them passes."""
        return bool(self.rows) and all(row.passed for row in self.rows)

    def as_dict(self) -> dict[str, object]:
        """Return plain numbers, for JSON."""
        return {"passed": self.passed, "seed": self.seed, "rows": [asdict(row) for row in self.rows]}

    def table(self) -> Table:
        """Return the report as a table for the terminal."""
        table = Table("robot", "check", title=f"cross-check, seed {self.seed}")
        for heading in ("states", "worst", "allowed", ""):
            table.add_column(heading, justify="right")
        for row in self.rows:
            verdict = "[green]ok[/green]" if row.passed else "[red]FAILED[/red]"
            cells = (str(row.samples), f"{row.worst:.1e}", f"{row.tolerance:.0e}", verdict)
            table.add_row(row.robot, row.check, *cells)
        return table


def checked_row(robot: str, check: str, deviation: Array, tolerance: float) -> CheckRow:
    """Return the row of one check from its deviations (N,); one that is not finite makes the worst NaN."""
    worst = float(np.max(deviation, initial=0.0)) if np.isfinite(deviation).all() else float("nan")
    return CheckRow(robot, check, len(deviation), worst, tolerance, bool(len(deviation) > 0 and worst <= tolerance))


def merged(rows: Iterable[CheckRow]) -> tuple[CheckRow, ...]:
    """Return one row a check and robot, in the order of first appearance; a NaN stays."""
    total: dict[tuple[str, str], CheckRow] = {}
    for row in rows:
        before = total.get((row.robot, row.check), row)
        samples = row.samples + (before.samples if before is not row else 0)
        worst = float(np.maximum(before.worst, row.worst))
        passed = samples > 0 and worst <= row.tolerance
        total[row.robot, row.check] = CheckRow(row.robot, row.check, samples, worst, row.tolerance, passed)
    return tuple(total.values())


def relative(first: Array, second: Array, floor: float = 1e-6) -> Array:
    """Return (N,) the largest difference of each sample relative to the largest entry of the sample.

    Args:
        first: (N, …) array.
        second: array of the same shape.
        floor: smallest size to divide by, so that rounding of a quantity that happens to vanish is not blown up; a
            thousandth of the typical size of the whole array is used where that is larger.
    """
    count = len(first)
    a, b = first.reshape(count, -1), second.reshape(count, -1)
    if a.shape[1] == 0:
        return np.zeros(count)
    size = np.maximum(np.abs(a).max(axis=1), np.abs(b).max(axis=1))
    typical = float(np.median(size)) if count else 0.0
    result: Array = np.abs(a - b).max(axis=1) / np.maximum(size, max(floor, 1e-3 * typical))
    return result
