"""Statements that are met one by one but have to hold together, in one motion with one step."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from redundancy_pin.experiments.planned import measures as m
from redundancy_pin.experiments.planned.cases import CORNERS, CROSSINGS
from redundancy_pin.experiments.planned.judged import Judged
from redundancy_pin.experiments.planned.settings import StudySettings
from redundancy_pin.experiments.planned.statements import DIFFERENCES, steps_and_returns
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.experiments.planned.verdict import Printed

_EXITS = (("0.20", "0.23"), ("1", "1"), ("2.4", "2.4"), ("0.46", "0.50"))
"""Forces on switching on: figures 3.11, 3.13, 3.14, 3.16, N."""

FACTOR = 1.25
"""By what factor all four pairs of forces may be missed if one step and one return time are to explain them."""


def same_step(store: PlanStore, settings: StudySettings) -> Judged:
    """Judge whether one time step and one return time give all stated forces on switching on."""
    best: tuple[float, str] = (np.inf, "")
    steps, durations = steps_and_returns(settings)
    for step in steps:
        for duration in durations:
            worst = 1.0
            for case, stated in zip(CROSSINGS, _EXITS, strict=False):
                plan = store.plan(replace(case, scheme=DIFFERENCES, dt=step, return_time=duration))
                for value, text in zip(m.exit_forces(plan), stated, strict=True):
                    ratio = value / Printed(text).value
                    worst = max(worst, ratio, 1.0 / ratio)
            best = min(best, (worst, f"δt = {1e3 * step:g} ms, return in {duration:g} s"))
    holds = best[0] <= FACTOR
    return Judged(
        "3.14 exit",
        "figs 3.11, 3.13, 3.14, 3.16",
        "circle, all four runs with one step and return time",
        "forces on switching on [N]",
        "; ".join(", ".join(pair) for pair in _EXITS),
        f"missed by a factor of {best[0]:.2g} at best",
        "",
        f"{len(steps)} steps × {len(durations)} return times",
        "reproduced" if holds else "differs",
        f"best with {best[1]}; a factor of {FACTOR:g} would pass",
        False,
    )


def growth_with_threshold(store: PlanStore) -> Judged:
    """Judge whether the forces on the line grow with threshold and speed."""
    slow, fast, high = (m.entry_forces(store.plan(case)) for case in CROSSINGS[4:])
    holds = max(slow) < max(fast) < max(high)
    return Judged(
        "3.21-3.22",
        "figs 3.19, 3.21, 3.22",
        "line, CN 4 at 0.1 m/s, CN 4 and 15 at 0.2 m/s",
        "forces grow with speed and threshold",
        "said",
        "; ".join(", ".join(f"{value:.2g}" for value in pair) for pair in (slow, fast, high)) + " N",
        "",
        "",
        "reproduced" if holds else "differs",
        "forces as they begin to fall",
        holds,
    )


def same_before_the_corner(store: PlanStore) -> Judged:
    """Judge whether carrier 2 can meet its speed limit at 0.65 s on one corner and at 0.4 s on the other."""
    wide, sharp = store.plan(CORNERS[0]), store.plan(CORNERS[2])
    entered = float(wide.motion.t[wide.motion.jumps][0])
    first, second = wide.t < entered - 1e-9, sharp.t < entered - 1e-9
    gap = float(np.abs(wide.carriers.s[first] - sharp.carriers.s[second]).max())
    return Judged(
        "4.10-4.11",
        "figs 4.9, 4.11",
        "both corners, λ 0: the same motion up to the corner",
        "carrier 2 first meets its speed limit [s]",
        "0.65 and 0.4",
        f"{m.first_bound('speed', 2)(wide)[0]:.3g} and {m.first_bound('speed', 2)(sharp)[0]:.3g}",
        "",
        "",
        "differs" if gap < 1e-9 else "reproduced",
        f"up to {entered:.2g} s the two plans differ by at most {gap:.1g} m, so both times cannot be met in one set-up",
    )
