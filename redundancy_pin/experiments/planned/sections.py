"""The planned study as sections of the report: what came out, and the figures."""

from __future__ import annotations

from redundancy_pin.experiments.document import Block, Heading, Paragraph, Picture, table
from redundancy_pin.experiments.planned.crossing_sections import crossings, sensitivity
from redundancy_pin.experiments.planned.mode_sections import fair_comparison, working_modes
from redundancy_pin.experiments.planned.study import Study
from redundancy_pin.experiments.planned.thesis_figures import FIGURES
from redundancy_pin.experiments.planned.verdict import RULE


def findings(study: Study) -> list[Block]:
    """Return what the study found, without its figures."""
    return [
        *_conclusions(study),
        *_against_thesis(study),
        *working_modes(study),
        *fair_comparison(study),
        *crossings(study),
        *sensitivity(study),
        *_parity(study),
    ]


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
            f"Of {len(study.judged)} statements {as_run} are reproduced by the run itself, {good - as_run} only with "
            "the value of an unstated parameter, or in the working modes, that the verdict names; "
            f"{len(study.judged) - good} differ."
        ),
        table(("where", "condition", "quantity", "stated", "ours", "deviation", "range over", "verdict"), rows),
    ]


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
