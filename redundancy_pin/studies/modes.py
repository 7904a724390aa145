"""The stepwise plans in every working mode of the 3-RRR, which the thesis does not state: what of its words holds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.planners.plan import Plan
from redundancy_pin.studies.case import Mode, Plans
from redundancy_pin.studies.cases import MODE_CASES, mode_text, square, without_carriers
from redundancy_pin.studies.measures import accelerating, bounds, limits_met
from redundancy_pin.studies.statements import thesis
from redundancy_pin.studies.table import Record, text

HALF = 0.05
"""How far from half, in units of the baseline's peak, a torque may be and still count as half."""

SMALL_JUMP = 0.05
"""Smallest jump of a torque, N·m, that shows in a figure."""


@dataclass(frozen=True, eq=False)
class Beside:
    """A plan beside the machine without carriers, at the same samples.

    Attributes:
        plan: the plan.
        baseline: the machine without carriers.
    """

    plan: Plan
    baseline: Plan

    @property
    def tau(self) -> Array:
        """(N, m) torque of the plan, without the samples added for braking, N·m."""
        return self.plan.tau[: len(self.baseline.t)]

    @property
    def accelerating(self) -> BoolArray:
        """(N,) whether the platform accelerates."""
        return accelerating(self.baseline)

    @property
    def decided(self) -> BoolArray:
        """(N,) the same, without the second halves of two-sided samples: those are outcome, not choice, of a step."""
        chosen: BoolArray = self.accelerating & ~self.baseline.motion.jumps
        return chosen

    def limited(self, kind: str | None = None, carrier: int | None = None) -> BoolArray:
        """Return (N,) whether a carrier is at a limit; see ``measures.bounds``."""
        t = self.baseline.t
        at = np.zeros(len(t), dtype=bool)
        for _, _, start, end in bounds(self.plan, kind, carrier):
            at |= (t >= start) & (t <= end)
        return at

    def inside(self, start: float, end: float) -> BoolArray:
        """Return (N,) whether a sample lies between two times, s."""
        within: BoolArray = (self.baseline.t >= start - 1e-9) & (self.baseline.t <= end + 1e-9)
        return within

    @property
    def corner(self) -> BoolArray:
        """(N,) whether the platform is in the (first) corner."""
        jumps = self.baseline.t[self.baseline.motion.jumps]
        return self.inside(float(jumps[0]), float(jumps[1]))

    def peaks(self, where: BoolArray) -> tuple[Array, Array]:
        """Return (m,) largest |τ| of the plan and of the baseline at some samples, N·m."""
        largest = [np.abs(tau[where]).max(axis=0, initial=0.0) for tau in (self.tau, self.baseline.tau)]
        return largest[0], largest[1]


Runs = Mapping[str, Beside]
"""The runs of one working mode, by the names in ``MODE_CASES``."""

Outcome = tuple[bool, str]
"""Whether a claim holds, and the number that decides."""


def runs_of(plans: Plans, mode: Mode) -> dict[str, Beside]:
    """Return all runs of a working mode."""
    cases = {name: replace(case, working_mode=mode) for name, case in MODE_CASES.items()}
    return {name: Beside(plans.plan(case), plans.plan(without_carriers(case))) for name, case in cases.items()}


# --- the claims of the data file -----------------------------------------------------------------------------------


def small_torque(runs: Runs) -> Outcome:
    """Hold if torques are of the order of 0.1 N·m at most away from limits."""
    run = runs["wide"]
    value = float(run.peaks(run.accelerating & ~run.limited())[0].max())
    return value <= 0.1 * np.sqrt(10.0), f"{value:.2g} N·m"


def second_exceeds_at_speed_limit(runs: Runs) -> Outcome:
    """Hold if τ2 exceeds the baseline where carrier 2 is at its speed limit before the corner."""
    run = runs["wide"]
    at = run.limited("speed", 2) & run.inside(0.0, 0.8)
    if not at.any():
        return False, "carrier 2 is never at its speed limit"
    ours, other = (peaks[1] for peaks in run.peaks(at))
    return bool(ours > other), f"{ours:.2g} against {other:.2g} N·m"


def sharp_exceeds(runs: Runs) -> Outcome:
    """Hold if τ2 and τ3 exceed the baseline in the sharp corner, at an acceleration limit."""
    run = runs["sharp"]
    ours, other = (peaks[1:] for peaks in run.peaks(run.corner))
    reached = bool((run.limited("acceleration") & run.corner).any())
    return bool((ours > other).all()) and reached, f"τ2, τ3 {_against(ours, other)}"


def cured_by_acceleration(runs: Runs) -> Outcome:
    """Hold if with 12 m/s² τ2 and τ3 stay below the baseline in the sharp corner."""
    run = runs["sharp 12"]
    ours, other = (peaks[1:] for peaks in run.peaks(run.corner))
    return bool((ours < other).all()), f"τ2, τ3 {_against(ours, other)}"


def first_jumps(runs: Runs) -> Outcome:
    """Hold if τ1 jumps as the sharp corner is entered, at an acceleration limit."""
    run = runs["sharp"]
    entered = int(np.flatnonzero(run.baseline.motion.jumps)[0])
    step = float(abs(run.tau[entered, 0] - run.tau[entered - 1, 0]))
    near = run.inside(float(run.baseline.t[entered]), float(run.baseline.t[entered]) + 0.02)
    limited = bool((run.limited("acceleration") & near).any())
    return step > SMALL_JUMP and limited, f"{step:.2g} N·m, acceleration limit {'met' if limited else 'not met'}"


def wide_half(runs: Runs) -> Outcome:
    """Hold if the torque is half of the baseline's at the wide corner."""
    return _half(runs["wide half"])


def square_half(runs: Runs) -> Outcome:
    """Hold if the torque is half of the baseline's in ramps and corners of the square."""
    return _half(runs["square half"])


def no_limit(runs: Runs) -> Outcome:
    """Hold if no carrier meets a limit."""
    met = sorted({f"{kind} of {carrier}" for carrier, kind, _, _ in bounds(runs["wide half"].plan)})
    return not met, ", ".join(met) if met else "none met"


def returns_exceed(runs: Runs) -> Outcome:
    """Hold if all torques exceed the baseline while carriers return."""
    run = runs["square half"]
    at = (run.plan.phase == run.plan.phases.index("return"))[: len(run.baseline.t)]
    ours, other = run.peaks(at)
    return bool((ours > other).all()), _against(ours, other)


def first_accelerates_least(runs: Runs) -> Outcome:
    """Hold if carrier 1 accelerates least on the return at 1.1 s."""
    plan = runs["square half"].plan
    first, second, third = np.abs(plan.carriers.sdd[int(np.abs(plan.t - 1.1).argmin())])
    return bool(first < min(second, third)), f"{first:.2g}, {second:.2g}, {third:.2g} m/s²"


def square_spikes(runs: Runs) -> Outcome:
    """Hold if torques at the speed limits on the square exceed the baseline's peak."""
    run = runs["square"]
    at = run.limited("speed") & run.accelerating
    if not at.any():
        return False, "no speed limit met"
    ours, other = float(run.peaks(at)[0].max()), float(np.abs(run.baseline.tau).max())
    return ours > other, f"{ours:.2g} against {other:.2g} N·m"


def cured_by_speed(runs: Runs) -> Outcome:
    """Hold if with 1.2 m/s torques stay below the baseline's peaks while the platform accelerates."""
    run = runs["square 1.2"]
    ours, other = run.peaks(run.accelerating)[0], np.abs(run.baseline.tau).max(axis=0)
    return bool((ours < other).all()), _against(ours, other)


def _half(run: Beside) -> Outcome:
    tau, other = run.tau, run.baseline.tau
    off = float(np.abs(tau - 0.5 * other)[run.decided].max() / np.abs(other).max())
    return off <= HALF, f"off half by {off:.2g} of the baseline's peak"


def _against(ours: Array, other: Array) -> str:
    return f"{text(ours, '.2g')} against {text(other, '.2g')} N·m"


# --- records -------------------------------------------------------------------------------------------------------


def working_modes(plans: Plans, modes: Sequence[Mode]) -> dict[str, list[Record]]:
    """Run every working mode.

    Returns:
        ``working_modes``, a record for each mode and case; ``claims``, one for each claim of the thesis with its
        outcome in each mode; ``judged``, the same as rows of the table of verdicts.
    """
    runs = {mode: runs_of(plans, mode) for mode in modes}
    records = [
        {
            "mode": mode,
            "case": MODE_CASES[name].name,
            "baseline_peak": np.abs(run.baseline.tau).max(axis=0),
            "peak": run.plan.peak_effort,
            "rms": run.plan.rms_effort,
            "limits": limits_met(run.plan),
            "status": run.plan.status.value,
        }
        for mode, of_mode in runs.items()
        for name, run in of_mode.items()
    ]
    claims = []
    for claim in thesis()["claims"]:
        test: Callable[[Runs], Outcome] = globals()[claim["test"]]
        outcomes = {mode_text(mode): test(of_mode) for mode, of_mode in runs.items()}
        shown = {mode: {"holds": bool(holds), "found": number} for mode, (holds, number) in outcomes.items()}
        claims.append({**claim, "modes": shown})
    return {"working_modes": records, "claims": claims, "judged": [_judged(claim) for claim in claims]}


def _judged(claim: Record) -> Record:
    outcomes: Mapping[str, Record] = claim["modes"]
    first = next(iter(outcomes))
    holding = [mode for mode, outcome in outcomes.items() if outcome["holds"]]
    if holding:
        reason = f"in {len(holding)} of {len(outcomes)} working modes: {', '.join(holding)}"
    else:
        reason = f"in none of {len(outcomes)} working modes ({claim['criterion']})"
    return {
        "row": claim["row"],
        "source": claim["source"],
        "condition": thesis()["rows"][claim["row"]],
        "quantity": claim["claim"],
        "stated": "in words",
        "ours": f"{first}: {outcomes[first]['found']}",
        "deviation": "",
        "covered": "",
        "verdict": "reproduced" if holding else "differs",
        "reason": reason,
        "as_run": first in holding,
    }


def square_returns(plans: Plans, modes: Sequence[Mode]) -> list[Record]:
    """Return the shortest returns on the square within all limits, s, or why there are none."""
    records = []
    for mode in modes:
        for lam in (0.0, 0.5):
            outcome = plans.outcome(square(lam, mode).with_options(return_time="shortest"))
            if isinstance(outcome, Plan):
                spans, why = np.asarray(outcome.diagnostics["returns"], dtype=float).reshape(-1, 2), ""
            else:
                spans, why = np.empty((0, 2)), outcome.message
            records.append({"mode": mode, "lam": lam, "durations": spans[:, 1] - spans[:, 0], "why": why})
    return records
