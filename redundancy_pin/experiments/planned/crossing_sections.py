"""Sections of the report on the crossings, and on the sensitivity of all plans to what is unstated."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from redundancy_pin.experiments.document import Block, Bullets, Heading, Paragraph, Table, table
from redundancy_pin.experiments.planned.sensitivity import SensitivityRow
from redundancy_pin.experiments.planned.statements import listed, number
from redundancy_pin.experiments.planned.study import Study


def crossings(study: Study) -> list[Block]:
    """Return the section on limits, returns and jumps of the crossings."""
    rows = [
        (
            row.case,
            row.status,
            row.broken or "none",
            f"{row.beyond_track_at_exit:.3f}",
            f"{row.beyond_track:.3f}",
            "none: see below" if np.isnan(row.shortest) else f"{row.shortest:.3f}",
            listed(row.jump, 1),
            listed(row.jump_of_differences, 2),
            f"{row.peak_on_return:.3g}",
        )
        for row in study.crossings
    ]
    blocks: list[Block] = [
        Heading("Crossings: limits, returns and jumps"),
        table(
            (
                "run",
                "status",
                "limits broken (amount in m, m/s, m/s²)",
                "beyond the track when switched on [m]",
                "beyond it at worst [m]",
                "shortest return within limits [s]",
                "jump of forces, exact [N]",
                "jump, backward differences of 1 ms [N]",
                "peak force on the return [N]",
            ),
            rows,
        ),
    ]
    never = [f"{row.case}: {row.no_shortest}" for row in study.crossings if row.no_shortest]
    if never:
        blocks += [Paragraph("No return keeps the limits in these:"), Bullets(tuple(never))]
    if study.heavy is not None:
        blocks.append(Paragraph(f"No plan exists for the {study.heavy.what}: {study.heavy.message}"))
    return blocks


def sensitivity(study: Study) -> list[Block]:
    """Return the section on what the thesis leaves unstated."""
    blocks: list[Block] = [
        Heading("Sensitivity to what the thesis leaves unstated"),
        Paragraph(
            "Smallest and largest value while one parameter varies over its grid and all others keep their values. "
            "Ranges of pairs of forces span both actuators. A dash: it never happens on the grid."
        ),
    ]
    groups: dict[tuple[str, ...], list[SensitivityRow]] = {}
    for row in study.sensitivity:
        groups.setdefault(_parameters(study.sensitivity, row.case), []).append(row)
    for parameters, rows in groups.items():
        blocks.append(_ranges(parameters, rows))
    return blocks


def _parameters(rows: Sequence[SensitivityRow], case: str) -> tuple[str, ...]:
    return tuple(dict.fromkeys(f"{row.parameter}: {row.grid}" for row in rows if row.case == case))


def _ranges(parameters: tuple[str, ...], rows: Sequence[SensitivityRow]) -> Table:
    lines: dict[tuple[str, str], dict[str, SensitivityRow]] = {}
    for row in rows:
        lines.setdefault((row.case, row.quantity), {})[f"{row.parameter}: {row.grid}"] = row
    texts = []
    for (case, quantity), found in lines.items():
        ours = number(next(iter(found.values())).ours)
        cells = [found[parameter].covered if parameter in found else "" for parameter in parameters]
        texts.append((case, quantity, ours, *cells))
    return table(("run", "quantity", "this run", *parameters), texts)
