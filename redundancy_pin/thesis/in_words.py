"""Statements of the thesis about the 3-RRR without a number: judged in every working mode, which it does not state."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, largest
from redundancy_pin.planners.plan import Plan
from redundancy_pin.thesis import cases, measures
from redundancy_pin.thesis.cases import ALL_MODES, MODE_CASES, Mode, Plans
from redundancy_pin.thesis.measures import bounds
from redundancy_pin.thesis.statements import verdict
from redundancy_pin.thesis.table import Record, mode_text, text

HALF = 0.05
"""Largest distance from half, over the baseline's peak, of a torque that counts as half."""

SMALL_JUMP = 0.05
"""Smallest jump of a torque, N·m, that shows in a figure."""

WIDE, SHARP, SQUARE = "corner-r0.025-lam0", "corner-r0.013-lam0", "square-lam0"


@dataclass(frozen=True, eq=False)
class Compared:
    """A plan and the plan of the machine without carriers (``baseline``), at the same samples."""

    plan: Plan
    baseline: Plan

    @property
    def tau(self) -> Array:
        """(N, m) torque of the plan, without the samples added for braking, N·m."""
        return self.plan.tau[: len(self.baseline.t)]

    @property
    def accelerating(self) -> BoolArray:
        """(N,) whether the platform accelerates."""
        size = np.abs(self.baseline.motion.xdd).max(axis=1)
        moving: BoolArray = size > measures.ACCELERATING * size.max()
        return moving

    def limited(self, kind: str | None = None, carrier: int | None = None) -> BoolArray:
        """Return (N,) whether a carrier is at a limit; see ``measures.bounds``."""
        at = [self.inside(start, end, 0.0) for _, _, start, end in bounds(self.plan, kind, carrier)]
        return np.any(at, axis=0) if at else np.zeros(len(self.baseline.t), dtype=bool)

    def inside(self, start: float, end: float, slack: float = 1e-9) -> BoolArray:
        """Return (N,) whether a sample lies between two times, s."""
        within: BoolArray = (self.baseline.t >= start - slack) & (self.baseline.t <= end + slack)
        return within

    @property
    def corner(self) -> BoolArray:
        """(N,) whether the platform is in the (first) corner."""
        jumps = self.baseline.t[self.baseline.motion.jumps]
        return self.inside(float(jumps[0]), float(jumps[1]))

    def peaks(self, at: BoolArray) -> tuple[Array, Array]:
        """Return (m,) largest |τ| over some samples, of the plan and of the baseline, N·m."""
        return largest(self.tau[at]), largest(self.baseline.tau[at])


Runs = Mapping[str, Compared]
"""The runs of one working mode, by the names of the cases in ``MODE_CASES``."""

Outcome = tuple[bool, str]
"""Whether a statement holds, and the number that decides."""

Test = Callable[[Runs], Outcome]


class InWords(NamedTuple):
    """A statement: name, row of the figure, source, text, criterion, and the test of one working mode."""

    name: str
    row: str
    source: str
    claim: str
    criterion: str
    test: Test


IN_WORDS: list[InWords] = []
"""All statements, in the order of the figures."""


def stated(row: str, source: str, criterion: str) -> Callable[[Test], Test]:
    """Add the decorated test to the statements: its docstring is the text of the statement."""

    def add(test: Test) -> Test:
        words = (inspect.getdoc(test) or test.__name__).removesuffix(".")
        IN_WORDS.append(InWords(test.__name__, row, source, words[0].lower() + words[1:], criterion, test))
        return test

    return add


def runs_of(plans: Plans, mode: Mode) -> dict[str, Compared]:
    """Return all runs of a working mode."""
    moded = [replace(case, working_mode=mode) for case in MODE_CASES]
    return {case.name: Compared(plans.plan(case), plans.plan(cases.without_carriers(case))) for case in moded}


def _against(ours: Array, other: Array) -> str:
    return f"{text(ours, '.2g')} against {text(other, '.2g')} N·m"


@stated(
    "4.8-4.9", "section 4.3", "peak away from limits at most 0.1 √10 N·m; the exact minimum is zero until a limit binds"
)
def small_torque(runs: Runs) -> Outcome:
    """Torques of the order of 0.1 N·m at most while the platform accelerates."""
    run = runs[WIDE]
    value = float(largest(run.tau[run.accelerating & ~run.limited()]).max())
    return value <= 0.1 * np.sqrt(10.0), f"{value:.2g} N·m"


@stated("4.8-4.9", "fig. 4.8", "peak of τ2 while the speed limit binds before the corner")
def second_exceeds_at_speed_limit(runs: Runs) -> Outcome:
    """τ2 exceeds the baseline where carrier 2 is at its speed limit."""
    run = runs[WIDE]
    at = run.limited("speed", 2) & run.inside(0.0, 0.8)
    ours, other = (peaks[1] for peaks in run.peaks(at))
    return bool(ours > other), _against(ours, other) if at.any() else "carrier 2 is never at its speed limit"


@stated("4.10-4.11", "fig. 4.10", "peaks in the corner")
def sharp_exceeds(runs: Runs) -> Outcome:
    """τ2 and τ3 exceed the baseline in the corner, at an acceleration limit."""
    run = runs[SHARP]
    ours, other = (peaks[1:] for peaks in run.peaks(run.corner))
    reached = bool((run.limited("acceleration") & run.corner).any())
    return bool((ours > other).all()) and reached, f"τ2, τ3 {_against(ours, other)}"


@stated("4.10-4.11", "section 4.3", "peaks in the corner")
def cured_by_acceleration(runs: Runs) -> Outcome:
    """12 m/s² brings τ2 and τ3 below the baseline."""
    run = runs[f"{SHARP}-a12"]
    ours, other = (peaks[1:] for peaks in run.peaks(run.corner))
    return bool((ours < other).all()), f"τ2, τ3 {_against(ours, other)}"


@stated("4.10-4.11", "fig. 4.10", "jump of more than 0.05 N·m at the entry of the corner")
def first_jumps(runs: Runs) -> Outcome:
    """τ1 jumps at 0.8 s, at an acceleration limit."""
    run = runs[SHARP]
    entered = int(np.flatnonzero(run.baseline.motion.jumps)[0])
    step, start = float(abs(run.tau[entered, 0] - run.tau[entered - 1, 0])), float(run.baseline.t[entered])
    limited = bool((run.limited("acceleration") & run.inside(start, start + 0.02)).any())
    return step > SMALL_JUMP and limited, f"{step:.2g} N·m, acceleration limit {'met' if limited else 'not met'}"


_WITHIN = "within 5 % of the baseline's peak while the platform accelerates"


def _half(runs: Runs, name: str) -> Outcome:
    run = runs[name]
    # of samples at a jump only the first: the second one is a result of a step, and not chosen in it
    chosen, other = run.accelerating & ~run.baseline.motion.jumps, run.baseline.tau
    off = float(np.abs(run.tau - 0.5 * other)[chosen].max() / np.abs(other).max())
    return off <= HALF, f"off half by {off:.2g} of the baseline's peak"


@stated("4.12-4.14", "fig. 4.12", _WITHIN)
def wide_half(runs: Runs) -> Outcome:
    """Half of the baseline's torque."""
    return _half(runs, "corner-r0.025-lam0.5")


@stated("4.12-4.14", "fig. 4.14", "speed, acceleration, track")
def no_limit(runs: Runs) -> Outcome:
    """No carrier meets a limit."""
    met = sorted({f"{kind} of {carrier}" for carrier, kind, _, _ in bounds(runs["corner-r0.025-lam0.5"].plan)})
    return not met, ", ".join(met) or "none met"


@stated("4.15-4.16", "fig. 4.15", _WITHIN)
def square_half(runs: Runs) -> Outcome:
    """Half of the baseline's torque in ramps and corners."""
    return _half(runs, "square-lam0.5")


@stated("4.15-4.16", "fig. 4.15", "peaks during the returns")
def returns_exceed(runs: Runs) -> Outcome:
    """Above the baseline while carriers return."""
    run = runs["square-lam0.5"]
    ours, other = run.peaks((run.plan.phase == run.plan.phases.index("return"))[: len(run.baseline.t)])
    return bool((ours > other).all()), _against(ours, other)


@stated("4.15-4.16", "fig. 4.16", "|s̈| at 1.1 s")
def first_accelerates_least(runs: Runs) -> Outcome:
    """Carrier 1 accelerates least on the return at 1.1 s."""
    plan = runs["square-lam0.5"].plan
    first, second, third = np.abs(plan.carriers.sdd[int(np.abs(plan.t - 1.1).argmin())])
    return bool(first < min(second, third)), f"{first:.2g}, {second:.2g}, {third:.2g} m/s²"


@stated("4.17-4.18", "fig. 4.17", "peak while a speed limit binds against the baseline's peak")
def square_spikes(runs: Runs) -> Outcome:
    """Spikes above the baseline at the speed limits."""
    run = runs[SQUARE]
    at = run.limited("speed") & run.accelerating
    ours, other = largest(run.tau[at]).max(), np.abs(run.baseline.tau).max()
    return bool(ours > other), _against(ours, other) if at.any() else "no speed limit met"


@stated("4.17-4.18", "section 4.3", "peaks while the platform accelerates")
def cured_by_speed(runs: Runs) -> Outcome:
    """1.2 m/s brings the torques below the baseline."""
    run = runs[f"{SQUARE}-v1.2"]
    ours, other = largest(run.tau[run.accelerating]), largest(run.baseline.tau)
    return bool((ours < other).all()), _against(ours, other)


def judge_in_words(runs: Mapping[Mode, Runs]) -> tuple[list[Record], list[Record]]:
    """Return each statement with its outcome in each working mode, and the verdicts on them."""
    claims, verdicts = [], []
    for one in IN_WORDS:
        shown = {}
        for mode, of_mode in runs.items():
            holds, found = one.test(of_mode)
            shown[mode_text(mode)] = {"holds": bool(holds), "found": found}
        claims.append({"name": one.name, "source": one.source, "claim": one.claim, "modes": shown})
        first, holding = next(iter(shown)), [mode for mode, outcome in shown.items() if outcome["holds"]]
        reason = f"in {len(holding) or 'none'} of {len(shown)} working modes"
        reason += f": {', '.join(holding)}" if holding else f" ({one.criterion})"
        verdicts.append(
            verdict(one.row, one.source, one.claim, "in words", f"{first}: {shown[first]['found']}", bool(holding),
                    reason, first in holding, complete=len(runs) == len(ALL_MODES))
        )  # fmt: skip
    return claims, verdicts


def mode_records(runs: Mapping[Mode, Runs]) -> Sequence[Record]:
    """Return peaks and limits met of every run, by working mode."""
    return [
        {"mode": mode, "case": name, "baseline_peak": largest(run.baseline.tau), "rms": run.plan.rms_effort,
         "peak": run.plan.peak_effort_at_samples, "limits": limits_met(run.plan), "status": run.plan.status.value}
        for mode, of_mode in runs.items()
        for name, run in of_mode.items()
    ]  # fmt: skip


def limits_met(plan: Plan) -> str:
    """Return which carriers meet which limit first when: ``"2 speed 0.34 s, 2 acceleration 0.82 s"``."""
    first: dict[tuple[int, str], float] = {}
    for carrier, kind, start, _ in bounds(plan):
        first.setdefault((carrier, kind), start)
    return ", ".join(f"{carrier} {kind} {start:.2f} s" for (carrier, kind), start in first.items()) or "none"
