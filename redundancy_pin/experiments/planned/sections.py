"""The planned study as sections of the report."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from redundancy_pin.experiments.document import Block, Bullets, Heading, Paragraph, Picture, Table, table
from redundancy_pin.experiments.planned.between import POINTS
from redundancy_pin.experiments.planned.cases import mode_text
from redundancy_pin.experiments.planned.fair import label
from redundancy_pin.experiments.planned.mode_claims import MODE_CASES
from redundancy_pin.experiments.planned.sensitivity import SensitivityRow
from redundancy_pin.experiments.planned.statements import number
from redundancy_pin.experiments.planned.study import Study
from redundancy_pin.experiments.planned.thesis_figures import FIGURES
from redundancy_pin.experiments.planned.verdict import RULE


def findings(study: Study) -> list[Block]:
    """Return what the study found, without its figures."""
    return [*_conclusions(study), *_against_thesis(study), *_modes(study), *_fair(study), *_crossings(study),
            *_sensitivity(study), *_parity(study)]  # fmt: skip


def figures(study: Study) -> list[Block]:
    """Return the figures of the thesis, drawn anew."""
    blocks: list[Block] = [
        Heading("Result figures of the thesis, from this run"),
        Paragraph(
            "Each figure stands for the one of the same number in Parsa 2014. Those of chapter 4 are in working mode "
            "(+,+,+), in which the stated saturations on the square occur; grey shades are the phases of the planner."
        ),
    ]
    for figure in FIGURES:
        blocks.append(Heading(figure.title, 3))
        blocks.append(Picture(f"{figure.stem}.png", figure.caption(study.store)))
    return blocks


def _conclusions(study: Study) -> list[Block]:
    rows = [(row.thesis, row.stands, row.here) for row in study.conclusions]
    return [
        Heading("What becomes of the thesis's conclusions"),
        Paragraph(
            "Conclusions are given in our words. What is said of them is computed from this run: sentences and "
            "verdicts change with the numbers."
        ),
        table(("conclusion (Parsa 2014)", "verdict", "here"), rows),
    ]


def _against_thesis(study: Study) -> list[Block]:
    rows = [
        (row.source, row.condition, row.quantity, row.stated, row.ours, row.deviation, row.covered, row.said)
        for row in study.judged
    ]
    as_run = sum(row.as_run for row in study.judged)
    good = sum(row.verdict == "reproduced" for row in study.judged)
    return [
        Heading("Stated and computed"),
        Paragraph(RULE),
        Paragraph(
            "Forces are magnitudes; they are those at the start of the ramp-down, which is where the stated ones fit. "
            "Ours on switching on are by backward differences with a step of 1 ms, the thesis's scheme: solved "
            "exactly, there is no jump. Wide ranges explain much: see the rows that ask for several numbers together."
        ),
        Paragraph(
            f"{good} of {len(study.judged)} statements are reproduced, {as_run} of them by the run itself; the others "
            "with the value of an unstated parameter, or in the working modes, that the verdict names."
        ),
        table(("where", "condition", "quantity", "stated", "ours", "deviation", "range over", "verdict"), rows),
    ]


def _modes(study: Study) -> list[Block]:
    rows = [
        (
            mode_text(row.mode),
            MODE_CASES[row.case].name,
            _list(row.baseline_peak),
            _list(row.peak),
            _list(row.rms),
            row.limits,
            row.status,
        )
        for row in study.modes
    ]
    modes = study.settings.modes
    marks = [
        (row.claim.source, row.claim.text, *("yes" if row.outcomes[mode][0] else "–" for mode in modes))
        for row in study.claims
    ]
    counts = [str(sum(row.outcomes[mode][0] for row in study.claims)) for mode in modes]
    marks.append(("", f"of {len(study.claims)}", *counts))
    return [
        Heading("Working modes of the 3-RRR"),
        Paragraph(
            "The thesis does not state the working mode. Limits are 1 m/s and 7 m/s² unless the name says otherwise "
            "(a12: 12 m/s², v1.2: 1.2 m/s); 'stop' means that a carrier is kept able to stop before its track ends. "
            "The square includes the returns of the carriers."
        ),
        table(
            (
                "mode",
                "run",
                "peak |τ| without carriers [N·m]",
                "peak |τ| [N·m]",
                "rms τ [N·m]",
                "limits met (carrier, which, when first)",
                "status",
            ),
            rows,
        ),
        table(("where", "statement holds in", *(mode_text(mode) for mode in modes)), marks),
        Paragraph(
            f"Samples flatter the method, as the accelerations are chosen for them. Between the samples, {POINTS} "
            f"points a step, the optimised stretches in mode {mode_text(modes[0])} have these peaks:"
        ),
        table(
            ("run", "peak |τ| without carriers [N·m]", "at the samples [N·m]", "between them [N·m]"),
            [(row.case, _list(row.baseline), _list(row.at_samples), _list(row.between)) for row in study.between],
        ),
    ]


def _fair(study: Study) -> list[Block]:
    rows = [
        (
            label(row),
            row.what,
            f"{row.peak:.3g} {row.unit}" if row.bounded else "unbounded",
            f"{row.rms:.3g}" if row.bounded else "–",
            f"{row.carrier_force:.3g}",
            f"{row.main_energy:.3g}" if row.bounded else "–",
            f"{row.carrier_energy:.3g}",
            f"{row.energy:.3g}" if row.bounded else "–",
            row.status if row.bounded else "unbounded_effort",
        )
        for row in study.fair
    ]
    return [
        Heading("Fair comparison"),
        Paragraph(
            "The thesis compares moving carriers with a machine that has none. Here the same machine with its carriers "
            "parked stands between, and the carriers' own actuators are counted. Energy is ∫ Σ |power| dt, what motors "
            "that recover nothing would draw. The massless 2-RPR without carriers needs no force at all, so it "
            "has no first line."
        ),
        table(
            (
                "motion",
                "carriers",
                "peak |τ|",
                "rms |τ|",
                "peak carrier force [N]",
                "energy, base [J]",
                "energy, carriers [J]",
                "energy, all [J]",
                "status",
            ),
            rows,
        ),
    ]


def _crossings(study: Study) -> list[Block]:
    rows = [
        (
            row.case,
            row.status,
            row.broken or "none",
            f"{row.beyond_track_at_exit:.3f}",
            f"{row.beyond_track:.3f}",
            "none: see below" if np.isnan(row.shortest) else f"{row.shortest:.3f}",
            _list(row.jump, 1),
            _list(row.jump_of_differences, 2),
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


def _sensitivity(study: Study) -> list[Block]:
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


def _parity(study: Study) -> list[Block]:
    rows = [
        (row.case, *(f"{value:.1e}" for value in (row.position, row.speed, row.acceleration, row.tau,
                                                   row.carrier_force)), row.status)
        for row in study.parity
    ]  # fmt: skip
    return [
        Heading("Plans by both backends"),
        Paragraph(
            "Largest differences of the plans by RNEA and by virtual work, relative to the largest value of each."
        ),
        table(("run", "s", "ṡ", "s̈", "τ", "carrier force", "status"), rows),
    ]


def _list(values: Sequence[float], digits: int = 3) -> str:
    return ", ".join(f"{value:.{digits}g}" for value in values)
