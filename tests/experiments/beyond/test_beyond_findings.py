"""Findings and verdicts of the last chapter are sentences that change with the numbers."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
from redundancy_pin.experiments.beyond.corner_findings import corner_finding, cost_finding
from redundancy_pin.experiments.beyond.crossing_findings import (
    bracket,
    crossing_finding,
    heavy_finding,
    speed_finding,
)
from redundancy_pin.experiments.beyond.fastest import Fastest, Trial
from redundancy_pin.experiments.beyond.findings import CALM, Finding, findings
from redundancy_pin.experiments.beyond.modes import ModeRows
from redundancy_pin.experiments.beyond.optimality import BackendRow, StartsRow
from redundancy_pin.experiments.beyond.rows import INFEASIBLE, Row
from redundancy_pin.experiments.beyond.targets import targets
from redundancy_pin.experiments.beyond.tasks import CORNERS
from redundancy_pin.experiments.beyond.ways import (
    EFFORT,
    NONE,
    PARKED,
    PEAK,
    PEAK_FREE,
    SMOOTH,
    STEPWISE,
    SWITCH_OFF,
    SWITCH_OFF_LATE,
)

GOOD, BROKEN = "within_limits", "violates_limits"


def row(task: str, way: str, peak: float, **changes: object) -> Row:
    plain = Row(task, way, "N", GOOD, peak=peak, dense_peak=peak, reversals=2.0, rms=peak / 2.0, carrier_force=9.0,
                main_energy=peak / 10.0, carrier_energy=1.0)  # fmt: skip
    return replace(plain, **changes)  # type: ignore[arg-type]


def crossings(off: str = BROKEN, whole: str = GOOD, late: str = GOOD) -> list[Row]:
    return [
        row("circle-0.5", SWITCH_OFF, 28.0, status=off, before=2.8),
        row("circle-0.5", SWITCH_OFF_LATE, 23.0, status=late),
        row("circle-0.5", EFFORT, 0.28, status=whole),
        row("circle-0.5", PEAK, 0.14),
        row("circle-0.5", SMOOTH, 0.35, reversals=7.0),
        row("heavy-0.5", SWITCH_OFF, math.nan, status=INFEASIBLE, why="nothing can carry it", missing=0.25),
        row("heavy-0.5", EFFORT, 2.2),
        row("heavy-0.5", PEAK, 1.1),
    ]


def corners(peak: float = 1.7, energy: float = 5.0) -> list[Row]:
    rows = []
    for task in CORNERS:
        rows += [
            row(task.name, NONE, 3.0, carrier_energy=0.0, carrier_force=0.0),
            row(task.name, PARKED, 12.0),
            row(task.name, STEPWISE, 7.0),
            row(task.name, EFFORT, 2.5, carrier_energy=energy),
            row(task.name, PEAK, peak, carrier_energy=energy),
        ]
    return rows


def modes(peak: float = 1.7, free: float = 0.5) -> list[ModeRows]:
    found = []
    for radius in (0.025, 0.013):
        for mode in ((1, 1, 1), (-1, -1, -1)):
            values = {NONE: 3.0, STEPWISE: 1.0, EFFORT: 2.5, PEAK: peak, PEAK_FREE: free}
            found.append(ModeRows(radius, mode, {way: row("corner", way, value) for way, value in values.items()}))
    return found


SLOWER = Trial(1.7, True, GOOD, 74.0)
FASTER = Trial(1.72, False, INFEASIBLE, constraint="acceleration", carrier="carrier_1", limit=-10.2, unit="m/s²")
RACE = Fastest("circle-0.5", "2-RPR, circle at 0.5 m/s", "N", math.inf, SLOWER, FASTER, 5, True, (SLOWER, FASTER))
SAME = BackendRow("circle-0.5-effort", 1e-15, 1e-14, 1e-13, 1e-12, 1e-13, 1e-15, (GOOD, GOOD))
STARTS = StartsRow("circle-0.5-effort", (1.0, 1.0, 1.0), 0.01)


def made(**changes: object) -> dict[str, Finding]:
    given: dict[str, object] = {
        "rows": crossings() + corners(), "races": [RACE], "modes": modes(), "backends": [SAME], "starts": [STARTS],
    }  # fmt: skip
    found = findings(**{**given, **changes})  # type: ignore[arg-type]
    return {finding.claim: finding for finding in found}


def the(found: dict[str, Finding], part: str) -> Finding:
    (only,) = [finding for claim, finding in found.items() if part in claim]
    return only


def test_crossing_follows_the_statuses() -> None:
    _, here, stands = crossing_finding(crossings())
    assert stands == "stands"
    assert "2 of 2 motions" in here
    assert "breaks them on circle-0.5, and has no plan for heavy-0.5" in here
    assert "keeps the limits on none" in here
    assert "0.01 times the largest main force" in here
    assert "0.1 times the largest until the motors are off" in here
    assert (
        "beyond a condition number of 20 keeps the limits on circle-0.5 too, with a largest main force of 23 N" in here
    )
    assert "condition number of 20" not in crossing_finding(crossings(late=BROKEN))[1]
    _, here, stands = crossing_finding(crossings(off=GOOD, whole="stopped_early"))
    assert stands == "stands with conditions"
    assert "1 of 2 motions" in here
    assert "keeps the limits on circle-0.5, breaks them on none" in here


def test_calm_efforts_follow_the_reversals() -> None:
    said = the(made(), "calm enough").here
    assert "turn round at most 7 times on the 1 crossings, with 1.2 times the peak of the least effort" in said
    restless = [replace(one, reversals=40.0) if one.way == EFFORT else one for one in crossings()]
    said = the(made(rows=[*restless, *corners()]), "calm enough").here
    assert "at worst one does 40 times" in said


def test_masses_follow_the_plans() -> None:
    _, here, stands = heavy_finding(crossings())
    assert stands == "stands"
    assert "0.25 N that nothing can carry" in here
    assert "2.2 N for the least effort, 1.1 N for the least peak" in here
    without = [replace(one, status=INFEASIBLE, why="too tight") if one.task == "heavy-0.5" else one for one in
               crossings()]  # fmt: skip
    _, here, stands = heavy_finding(without)
    assert stands == "does not stand"
    assert "too tight" in here
    assert heavy_finding([one for one in crossings() if one.task != "heavy-0.5"])[2] == "does not stand"


def test_speed_follows_the_brackets() -> None:
    _, here, stands = speed_finding([RACE])
    assert stands == "stands"
    assert "a plan at 1.700 m/s (peak 74 N" in here
    assert "none found at 1.720 m/s, where the acceleration of carrier_1 is in the way" in here
    assert "(10.2 m/s² would suffice, and does)" in here
    assert "not proofs" in here
    slow = replace(RACE, slower=replace(SLOWER, speed=0.7))
    assert speed_finding([slow])[2] == "does not stand"
    assert "no plan was found with it" in bracket(replace(RACE, suffices=False))
    assert "no verdict in time" in bracket(replace(RACE, faster=replace(FASTER, constraint="seconds")))
    assert "no longer fit" in bracket(replace(RACE, faster=None))
    assert "not proofs" not in speed_finding([replace(RACE, faster=None)])[1]
    assert "with main forces up to 2.88 N" in bracket(replace(RACE, effort=2.88))


def test_corner_says_where_the_machine_without_carriers_stays_better() -> None:
    _, here, stands = corner_finding(corners(), modes(), CORNERS[0])
    assert stands == "stands"
    assert "Planned for least peak the carriers win in peak (0.57 times), rms (0.57 times)" in here
    assert "stays better in energy of all motors (17 times)" in here
    assert "lower in 2 of 2" in here
    assert "lower peak than the least peak in 2 of them" in here  # 1.0 stepwise against 1.7
    assert "With the end free as well it has a lower one in 0." in here
    _, here, stands = corner_finding(corners(4.0), modes(4.0, free=2.0), CORNERS[0])
    assert stands == "does not stand"
    assert "the carriers win in nothing" in here
    assert "With the end free as well it has a lower one in 2." in here
    assert corner_finding(corners(4.0), modes(), CORNERS[2])[2] == "does not stand"  # the square has one mode
    assert corner_finding(corners(), modes(4.0), CORNERS[2])[2] == "stands"


def test_a_plan_that_stopped_early_does_not_count() -> None:
    unsound = [replace(one, status="stopped_early") if one.way == PEAK else one for one in corners()]
    _, here, stands = corner_finding(unsound, modes(), CORNERS[2])
    assert stands == "does not stand"
    assert "(stopped_early)" in here
    mode = modes()[0]
    early = replace(mode, rows={**mode.rows, PEAK: replace(mode.rows[PEAK], status="stopped_early")})
    assert mode.lower
    assert not early.lower
    assert "1 plans stopped before an optimum" in the(made(rows=[*crossings(whole="stopped_early"), *corners()]),
                                                      "promises").here  # fmt: skip


def test_cost_counts_both_sets_of_motors() -> None:
    _, here, stands = cost_finding(corners())
    assert stands == "does not stand"
    assert "0 of 6 plans" in here
    assert "stays better, always" in here
    _, here, stands = cost_finding(corners(energy=0.01))
    assert stands == "stands"
    assert "always" not in here


def test_between_the_nodes() -> None:
    assert the(made(), "promises").stands == "stands"
    worse = [replace(one, dense_peak=1.2 * one.peak) if one.way == PEAK else one for one in crossings() + corners()]
    found = the(made(rows=worse), "promises")
    assert found.stands == "stands with conditions"
    assert "1.200 times as large" in found.here


def test_restless_efforts_are_said() -> None:
    assert the(made(), "calm").stands == "stands"
    restless = [replace(one, reversals=CALM + 60.0) if one.task == "circle-0.5" else one for one in
                crossings() + corners()]  # fmt: skip
    found = the(made(rows=restless), "calm")
    assert found.stands == "stands with conditions"
    assert f"{CALM + 60} times (circle-0.5" in found.here
    assert "circle-0.5 cross a singularity" in found.here


def test_backends() -> None:
    assert the(made(), "Both backends").stands == "stands"
    flat = replace(SAME, tau=1e-3)
    found = the(made(backends=[SAME, flat]), "Both backends")
    assert found.stands == "stands with conditions"
    assert "1.0e-03" in found.here
    assert "the optimum is flat" in found.here
    wrong = replace(SAME, tau=1e-3, cost=1e-2)
    assert "flat" not in the(made(backends=[wrong]), "Both backends").here
    assert the(made(backends=[replace(SAME, statuses=(GOOD, BROKEN))]), "Both backends").stands == "does not stand"


def test_first_guesses() -> None:
    assert the(made(), "first guess").stands == "stands"
    better = StartsRow("circle-0.5-effort", (1.1, 1.0, math.nan), 0.01)
    assert better.optima == 2
    assert better.excess == pytest.approx(0.1)
    found = the(made(starts=[better]), "first guess")
    assert found.stands == "does not stand"
    assert "circle-0.5-effort (2, up to 10 % worse)" in found.here


def test_targets() -> None:
    rows = [row("circle-0.5", EFFORT, 0.2), row("circle-0.5", PEAK, 0.1), row("corner-r0.025", PEAK, 2.2),
            row("corner-r0.013", PEAK, 7.1)]  # fmt: skip
    assert [target.said for target in targets(rows)] == ["met"] * 4
    assert targets([replace(rows[0], peak=0.22), *rows[1:]])[0].said.startswith("missed: 0.22 N at the nodes")
    between = targets([replace(rows[0], dense_peak=0.3), *rows[1:]])[0]
    assert not between.met
    assert "between the nodes" in between.said
    assert "no sound plan" in targets([replace(rows[0], status="stopped_early"), *rows[1:]])[0].said
    none = targets([replace(rows[0], status=INFEASIBLE, peak=math.nan, dense_peak=math.nan), *rows[1:]])[0]
    assert not none.met
    assert none.as_dict()["found"] is None
