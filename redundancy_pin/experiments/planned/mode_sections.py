"""Sections of the report on the stepwise plans: working modes, and the fair comparison."""

from __future__ import annotations

from collections.abc import Sequence

from redundancy_pin.experiments.document import Block, Bullets, Heading, Paragraph, Table, table
from redundancy_pin.experiments.planned.between import POINTS
from redundancy_pin.experiments.planned.cases import mode_text
from redundancy_pin.experiments.planned.fair import FairRow, label
from redundancy_pin.experiments.planned.mode_claims import MODE_CASES
from redundancy_pin.experiments.planned.statements import listed, span
from redundancy_pin.experiments.planned.study import Study
from redundancy_pin.experiments.planned.verdict import Range


def working_modes(study: Study) -> list[Block]:
    """Return the section on working modes, plans between samples and returns on the square."""
    rows = [
        (
            mode_text(row.mode),
            MODE_CASES[row.case].name,
            listed(row.baseline_peak),
            listed(row.peak),
            listed(row.rms),
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
            f"Samples can flatter the method, as the accelerations are chosen for them. Between the samples, {POINTS} "
            f"points a step, the optimised stretches in mode {mode_text(modes[0])} have these peaks:"
        ),
        table(
            ("run", "peak |τ| without carriers [N·m]", "at the samples [N·m]", "between them [N·m]"),
            [(row.case, listed(row.baseline), listed(row.at_samples), listed(row.between)) for row in study.between],
        ),
        *_returns(study),
    ]


def _returns(study: Study) -> list[Block]:
    first = [row for row in study.returns if row.mode == study.settings.modes[0]]
    kept = sum(not row.why for row in study.returns)
    said = [
        f"λ = {row.lam:g}: " + (row.why or "returns of " + listed(row.durations) + " s keep every limit.")
        for row in first
    ]
    return [
        Paragraph(
            f"Asked for the shortest returns on the square that keep every limit, the planner finds them in {kept} of "
            f"{len(study.returns)} cases (modes, λ = 0 and 0.5). In mode {mode_text(first[0].mode)}:"
        ),
        Bullets(tuple(said)),
    ]


def fair_comparison(study: Study) -> list[Block]:
    """Return the section that counts both sets of actuators."""
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
        if row.mode in ((), study.settings.modes[0])
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
        _over_modes(study),
    ]


def _over_modes(study: Study) -> Table:
    groups: dict[tuple[str, str], list[FairRow]] = {}
    for row in study.fair:
        if row.mode:
            groups.setdefault((row.motion, row.what), []).append(row)
    rows = [
        (
            motion,
            what,
            _range([row.peak for row in found]),
            _range([row.rms for row in found]),
            _range([row.carrier_force for row in found]),
            _range([row.main_energy for row in found]),
            _range([row.energy for row in found]),
        )
        for (motion, what), found in groups.items()
    ]
    headings = (
        "motion",
        "carriers",
        "peak |τ| [N·m]",
        "rms |τ| [N·m]",
        "peak carrier force [N]",
        "energy, base [J]",
        "energy, all [J]",
    )
    return table(headings, rows, f"The same over {len(study.settings.modes)} working modes: smallest to largest value.")


def _range(values: Sequence[float]) -> str:
    return span(Range.of(values))
