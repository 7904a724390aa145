"""Conclusions are sentences that change with the numbers."""

from __future__ import annotations

from dataclasses import replace

import pytest
from redundancy_pin.experiments.planned.conclusions import Conclusion, conclusions, verdict
from redundancy_pin.experiments.planned.crossings import CrossingRow, Infeasible
from redundancy_pin.experiments.planned.fair import MOVING, NONE, PARKED, FairRow
from redundancy_pin.experiments.planned.mode_claims import CLAIMS
from redundancy_pin.experiments.planned.mode_table import ClaimRow

MODES = ((1, 1, 1), (-1, -1, -1))
KEY = f"{MOVING}, λ = 0"
HEAVY = Infeasible("circle, end-effector of 0.5 kg", "no", {"amount": 0.25})
CROSSING = CrossingRow(
    "circle-0.5-cn5", "violates_limits", "track", 0.047, 0.12, float("nan"), "none", (1e-12, 1e-12), (0.2, 0.2), 1e-3,
    28.0,
)  # fmt: skip


def row(motion: str, mode: tuple[int, ...], what: str, peak: float, energy: float) -> FairRow:
    carriers = 5.0 if what == KEY else 0.0
    return FairRow(motion, mode, what, "N·m", True, peak, peak / 2.0, 20.0, energy, carriers, "within_limits")


def fair(moving: float) -> list[FairRow]:
    """Every motion in two modes: 3 N·m without carriers, 12 parked, and a given peak with moving ones."""
    rows = []
    for motion in ("corner-r0.025", "corner-r0.013", "square"):
        for mode in MODES:
            rows += [row(motion, mode, NONE, 3.0, 0.4), row(motion, mode, PARKED, 12.0, 1.4)]
            rows.append(row(motion, mode, KEY, moving, 0.3 if moving < 3.0 else 0.6))
    return rows


def claims(holds: bool) -> list[ClaimRow]:
    """One claim that holds in the first mode, and one that holds there only if the first holds everywhere."""
    return [
        ClaimRow(CLAIMS[0], {MODES[0]: (True, ""), MODES[1]: (holds, "")}),
        ClaimRow(CLAIMS[1], dict.fromkeys(MODES, (holds, ""))),
    ]


def made(moving: float = 1.0, crossing: CrossingRow = CROSSING, heavy: Infeasible | None = HEAVY) -> list[Conclusion]:
    return list(conclusions(fair(moving), [crossing], heavy, claims(False)))


@pytest.mark.parametrize(("good", "said"), [(0, "does not stand"), (1, "stands with conditions"), (2, "stands")])
def test_verdicts(good: int, said: str) -> None:
    assert verdict(good, 2) == said


def test_corner_conclusion_follows_the_peaks() -> None:
    low, high = made(1.0)[3], made(9.0)[3]
    assert low.stands == "stands"
    assert "lower in 2 of 2 working modes (0.33 times)" in low.here
    assert "4 times as large" in low.here
    assert high.stands == "does not stand"
    assert "lower in 0 of 2 working modes (3 times)" in high.here
    assert made(1.0)[4].stands == "does not stand"  # the sharper corner: that torques exceed the baseline


def test_square_conclusion_follows_the_peaks() -> None:
    assert "lost, many times over" not in made(1.0)[5].here
    assert "lost, many times over" in made(9.0)[5].here
    assert made(1.0)[5].stands != made(9.0)[5].stands


def test_energy_of_both_sets_counts() -> None:
    here = made(1.0)[6].here
    assert "0.75 times the energy they need" in here
    assert "13 times the energy: the effort is not shared but multiplied" in here


def test_crossing_conclusions_follow_limits_and_jumps() -> None:
    sound = replace(CROSSING, status="within_limits", beyond_track_at_exit=0.0, no_shortest="", shortest=0.4)
    assert "0.047 m beyond its track" in made()[1].here
    assert made()[1].stands == "does not stand"
    assert made(crossing=sound)[1].stands == "stands"
    assert "0.25 N" in made()[0].here
    assert made(crossing=sound, heavy=None)[0].stands == "stands"
    assert made()[2].stands == "does not stand"
    assert made(crossing=replace(CROSSING, jump=(0.2, 0.2)))[2].stands == "stands"


def test_agreement_of_the_working_modes() -> None:
    assert made()[7].stands == "does not stand"
    together = conclusions(fair(1.0), [CROSSING], HEAVY, claims(True))[7]
    assert together.stands == "stands"
    assert "gives them all" in together.here
    assert "no single working mode" not in together.here
