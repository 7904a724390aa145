"""What the thesis says in words about its stepwise plans, as tests that a working mode passes or fails."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.experiments.planned import measures as m
from redundancy_pin.experiments.planned.cases import Mode, StepwiseCase, corner, square
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.planners.plan import Plan

HALF = 0.05
"""How far from half, in units of the baseline's peak, a torque may be and still count as half."""

SMALL_JUMP = 0.05
"""Smallest jump of a torque, N·m, that shows in a figure."""

MODE_CASES: Mapping[str, StepwiseCase] = {
    "wide": corner(0.025, 0.0),
    "wide half": corner(0.025, 0.5),
    "sharp": corner(0.013, 0.0),
    "sharp half": corner(0.013, 0.5),
    "sharp 12": replace(corner(0.013, 0.0), name="corner-r0.013-lam0-a12", acceleration=12.0),
    "square half": square(0.5),
    "square": square(0.0),
    "square 1.2": replace(square(0.0), name="square-lam0-v1.2", speed=1.2),
}
"""Runs of each working mode."""


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
        return m.accelerating(self.baseline)

    @property
    def decided(self) -> BoolArray:
        """(N,) the same, without the second halves of two-sided samples: those are outcome, not choice, of a step."""
        chosen: BoolArray = self.accelerating & ~self.baseline.motion.jumps
        return chosen

    def limited(self, kind: str | None = None, carrier: int | None = None) -> BoolArray:
        """Return (N,) whether a carrier is at a limit."""
        return m.limited(self.plan, kind, carrier)[: len(self.baseline.t)]

    def inside(self, start: float, end: float) -> BoolArray:
        """Return (N,) whether a sample lies between two times, s."""
        within: BoolArray = (self.baseline.t >= start - 1e-9) & (self.baseline.t <= end + 1e-9)
        return within

    @property
    def corner(self) -> BoolArray:
        """(N,) whether the platform is in the (first) corner."""
        jumps = self.baseline.t[self.baseline.motion.jumps]
        return self.inside(float(jumps[0]), float(jumps[1]))


Runs = Mapping[str, Beside]
"""The runs of one working mode, by the names in ``MODE_CASES``."""

Outcome = tuple[bool, str]
"""Whether a claim holds, and the number that decides."""


@dataclass(frozen=True)
class Claim:
    """A statement without a number of its own.

    Attributes:
        row: which of ``judged.ROWS``.
        source: where in the thesis.
        text: what is said.
        test: whether it holds in a working mode.
        criterion: how that is decided.
    """

    row: str
    source: str
    text: str
    test: Callable[[Runs], Outcome]
    criterion: str


def runs_of(store: PlanStore, mode: Mode) -> dict[str, Beside]:
    """Return all runs of a working mode."""
    cases = {name: replace(case, mode=mode) for name, case in MODE_CASES.items()}
    return {name: Beside(store.plan(case), store.baseline(case)) for name, case in cases.items()}


def _peak(tau: Array, where: BoolArray) -> Array:
    largest: Array = np.abs(tau[where]).max(axis=0, initial=0.0)
    return largest


def _small_torque(runs: Runs) -> Outcome:
    run = runs["wide"]
    value = float(_peak(run.tau, run.accelerating & ~run.limited()).max())
    return value <= 0.1 * np.sqrt(10.0), f"{value:.2g} N·m"


def _second_exceeds_at_speed_limit(runs: Runs) -> Outcome:
    run = runs["wide"]
    at = run.limited("speed", 2) & run.inside(0.0, 0.8)
    if not at.any():
        return False, "carrier 2 is never at its speed limit"
    ours, other = _peak(run.tau, at)[1], _peak(run.baseline.tau, at)[1]
    return bool(ours > other), f"{ours:.2g} against {other:.2g} N·m"


def _sharp_exceeds(runs: Runs) -> Outcome:
    return _exceeds(runs["sharp"], "acceleration")


def _exceeds(run: Beside, kind: str) -> Outcome:
    at = run.corner
    ours, other = _peak(run.tau, at)[1:], _peak(run.baseline.tau, at)[1:]
    reached = bool((run.limited(kind) & at).any())
    return bool((ours > other).all()) and reached, f"τ2, τ3 {_list(ours)} against {_list(other)} N·m"


def _cured_by_acceleration(runs: Runs) -> Outcome:
    run = runs["sharp 12"]
    ours, other = _peak(run.tau, run.corner)[1:], _peak(run.baseline.tau, run.corner)[1:]
    return bool((ours < other).all()), f"τ2, τ3 {_list(ours)} against {_list(other)} N·m"


def _first_jumps(runs: Runs) -> Outcome:
    run = runs["sharp"]
    entered = int(np.flatnonzero(run.baseline.motion.jumps)[0])
    step = float(abs(run.tau[entered, 0] - run.tau[entered - 1, 0]))
    near = run.inside(float(run.baseline.t[entered]), float(run.baseline.t[entered]) + 0.02)
    limited = bool((run.limited("acceleration") & near).any())
    return step > SMALL_JUMP and limited, f"{step:.2g} N·m, acceleration limit {'met' if limited else 'not met'}"


def _half(name: str) -> Callable[[Runs], Outcome]:
    def test(runs: Runs) -> Outcome:
        run = runs[name]
        tau, other = run.tau, run.baseline.tau
        size = np.abs(other).max()
        off = float(np.abs(tau - 0.5 * other)[run.decided].max() / size)
        return off <= HALF, f"off half by {off:.2g} of the baseline's peak"

    return test


def _no_limit(runs: Runs) -> Outcome:
    met = sorted({f"{kind} of {carrier}" for carrier, kind, _, _ in m.bounds(runs["wide half"].plan)})
    return not met, ", ".join(met) if met else "none met"


def _returns_exceed(runs: Runs) -> Outcome:
    run = runs["square half"]
    at = (run.plan.phase == run.plan.phases.index("return"))[: len(run.baseline.t)]
    ours, other = _peak(run.tau, at), _peak(run.baseline.tau, at)
    return bool((ours > other).all()), f"{_list(ours)} against {_list(other)} N·m"


def _first_accelerates_least(runs: Runs) -> Outcome:
    plan = runs["square half"].plan
    first, second, third = np.abs(plan.carriers.sdd[int(np.abs(plan.t - 1.1).argmin())])
    return bool(first < min(second, third)), f"{first:.2g}, {second:.2g}, {third:.2g} m/s²"


def _square_spikes(runs: Runs) -> Outcome:
    run = runs["square"]
    at = run.limited("speed") & run.accelerating
    if not at.any():
        return False, "no speed limit met"
    ours, other = float(_peak(run.tau, at).max()), float(np.abs(run.baseline.tau).max())
    return ours > other, f"{ours:.2g} against {other:.2g} N·m"


def _cured_by_speed(runs: Runs) -> Outcome:
    run = runs["square 1.2"]
    ours, other = _peak(run.tau, run.accelerating), np.abs(run.baseline.tau).max(axis=0)
    return bool((ours < other).all()), f"{_list(ours)} against {_list(other)} N·m"


def _list(values: Array) -> str:
    return ", ".join(f"{value:.2g}" for value in values)


CLAIMS: tuple[Claim, ...] = (
    Claim("4.8-4.9", "section 4.3", "torques of the order of 0.1 N·m at most while the platform accelerates",
          _small_torque, "peak away from limits at most 0.1 √10 N·m; the exact minimum is zero until a limit binds"),
    Claim("4.8-4.9", "fig. 4.8", "τ2 exceeds the baseline where carrier 2 is at its speed limit",
          _second_exceeds_at_speed_limit, "peak of τ2 while the speed limit binds before the corner"),
    Claim("4.10-4.11", "fig. 4.10", "τ2 and τ3 exceed the baseline in the corner, at an acceleration limit",
          _sharp_exceeds, "peaks in the corner"),
    Claim("4.10-4.11", "section 4.3", "12 m/s² brings τ2 and τ3 below the baseline", _cured_by_acceleration,
          "peaks in the corner"),
    Claim("4.10-4.11", "fig. 4.10", "τ1 jumps at 0.8 s, at an acceleration limit", _first_jumps,
          "jump of more than 0.05 N·m at the entry of the corner"),
    Claim("4.12-4.14", "fig. 4.12", "half of the baseline's torque", _half("wide half"),
          "within 5 % of the baseline's peak while the platform accelerates"),
    Claim("4.12-4.14", "fig. 4.14", "no carrier meets a limit", _no_limit, "speed, acceleration, track"),
    Claim("4.15-4.16", "fig. 4.15", "half of the baseline's torque in ramps and corners", _half("square half"),
          "within 5 % of the baseline's peak while the platform accelerates"),
    Claim("4.15-4.16", "fig. 4.15", "above the baseline while carriers return", _returns_exceed,
          "peaks during the returns"),
    Claim("4.15-4.16", "fig. 4.16", "carrier 1 accelerates least on the return at 1.1 s", _first_accelerates_least,
          "|s̈| at 1.1 s"),
    Claim("4.17-4.18", "fig. 4.17", "spikes above the baseline at the speed limits", _square_spikes,
          "peak while a speed limit binds against the baseline's peak"),
    Claim("4.17-4.18", "section 4.3", "1.2 m/s brings the torques below the baseline", _cured_by_speed,
          "peaks while the platform accelerates"),
)  # fmt: skip
"""Statements that a working mode reproduces or not."""
