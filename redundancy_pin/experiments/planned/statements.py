"""Numbers that the thesis prints about its planned experiments, and how the same ones are read off a plan.

Stated forces are magnitudes. They are printed beside the time at which the threshold is met, but only those at the
start of the ramp-down, 0.03 s earlier, fit; with a time grid of a step up to 10 ms it starts up to a step later.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from redundancy_pin.experiments.planned import grids
from redundancy_pin.experiments.planned import measures as m
from redundancy_pin.experiments.planned.cases import CORNERS, CROSSINGS, Case, mode_text
from redundancy_pin.experiments.planned.grids import Grid
from redundancy_pin.experiments.planned.judged import Judged
from redundancy_pin.experiments.planned.settings import StudySettings
from redundancy_pin.experiments.planned.store import PlanStore
from redundancy_pin.experiments.planned.verdict import Printed, Range, Verdict, judge
from redundancy_pin.planners.plan import Plan

LARGEST_STEP = 0.01
"""Largest time step, s, that the thesis may have used: its times are printed to two decimals. An instant is noticed
at the first sample after it."""

RETURNS = (0.2, 0.4, 0.6, 1.0)
"""Durations of the return on the circle, s."""

STEPS = (5e-4, 1e-3, 2e-3, 5e-3, 1e-2)
"""Time steps of a crossing by backward differences, s."""

STEPWISE_STEPS = (2e-3, 5e-3, 1e-2, 2e-2)
"""Time steps of the stepwise planner, s."""

CORNER_RAMPS = (0.4, 0.45, 0.5, 0.55, 0.6)
"""Ramp lengths over v T that neither run backwards nor overshoot the speed."""

ORIENTATIONS = (-0.6, -0.3, 0.0, 0.3, 0.4, 0.5, 0.6)
"""Orientations of the platform, rad."""

SQUARE_RETURNS = (0.4, 0.5, 0.6, 0.65)
"""Durations of the return on the square, s, that fit between the first ramp and the first corner."""

DIFFERENCES: Final = "backward_differences"
"""The thesis's discretisation. Solved exactly, the forces are continuous on switching on and there is no jump."""

Reason = Callable[[Plan], str]


@dataclass(frozen=True)
class Statement:
    """Numbers stated together.

    Attributes:
        row: which of ``judged.ROWS``.
        source: where in the thesis.
        quantity: what.
        unit: of the numbers.
        printed: the numbers.
        case: the run they are about.
        measure: how to read them off its plan.
        grids: unstated parameters that may explain a deviation.
        late: how much later than the instant itself the thesis may notice it, s.
        why: says why ours differs, should it.
    """

    row: str
    source: str
    quantity: str
    unit: str
    printed: tuple[Printed, ...]
    case: Case
    measure: m.Measure
    grids: tuple[Grid, ...] = field(default=())
    late: float = 0.0
    why: Reason | None = None

    def judged(self, store: PlanStore, condition: str) -> Judged:
        """Return the row of this statement."""
        plan = store.plan(self.case)
        ours = self.measure(plan)
        values, closest = [ours], (not self._given_by(ours), _miss(self.printed, ours), "")
        for grid in self.grids:
            for variation in grid.cases(self.case):
                other = store.try_plan(variation)
                if other is not None:
                    found = self.measure(other)
                    values.append(found)
                    rank = (not self._given_by(found), _miss(self.printed, found), _difference(self.case, variation))
                    closest = min(closest, rank)
        ranges = [Range.of(column) for column in zip(*values, strict=True)]
        ranges = [Range(found.low, found.high + self.late) for found in ranges]
        in_range, gap = judge(self.printed, ranges)
        by_one_run = any(self._given_by(found) for found in values)
        verdict: Verdict = "reproduced" if by_one_run else "differs"
        deviation = [value - printed.value for value, printed in zip(ours, self.printed, strict=True)]
        over = [grid.parameter for grid in self.grids] + ([f"step up to {self.late:g} s"] if self.late else [])
        covered = f"{', '.join(span(found) for found in ranges)} over {', '.join(over)}" if over else ""
        as_run = self._given_by(ours)
        reason = "" if as_run or not by_one_run else f"with {closest[2]}"
        if not by_one_run and in_range == "reproduced":
            reason = "inside the range, but no single run gives it" + (
                f"; closest with {closest[2]}" if closest[2] else ""
            )
        elif not by_one_run:
            reason = f"{gap:.2g} {self.unit} beyond the range" if np.isfinite(gap) else "never happens here"
            reason += f"; {self.why(plan)}" if self.why else ""
        return Judged(
            self.row,
            self.source,
            condition,
            f"{self.quantity} [{self.unit}]",
            ", ".join(str(printed) for printed in self.printed),
            ", ".join(number(value) for value in ours),
            ", ".join("–" if np.isnan(value) else f"{value:+.2g}" for value in deviation),
            covered,
            verdict,
            reason,
            as_run,
        )

    def _given_by(self, found: Sequence[float]) -> bool:
        """Return whether one run gives all the numbers stated together."""
        return judge(self.printed, [Range(value, value + self.late) for value in found])[0] == "reproduced"


def number(value: float) -> str:
    """Return a number in three digits, a dash for none."""
    return "–" if np.isnan(value) else f"{value:.3g}"


def span(found: Range) -> str:
    """Return a range as text, a single number where both ends print the same."""
    low, high = number(found.low), number(found.high)
    return low if low == high else f"{low} to {high}"


def listed(values: Sequence[float], digits: int = 3) -> str:
    """Return numbers as text."""
    return ", ".join(f"{value:.{digits}g}" for value in values)


def _miss(printed: Sequence[Printed], values: Sequence[float]) -> float:
    miss = [abs(value - stated.value) for value, stated in zip(values, printed, strict=True)]
    return max(np.inf if np.isnan(value) else value for value in miss)


def _difference(case: Case, variation: Case) -> str:
    """Return what a variation changes, ``"dt = 0.005, return_time = 0.6"``."""
    parts = []
    for name, value in vars(variation).items():
        if value == getattr(case, name) or name == "scheme":
            continue
        if name == "path_options":
            options = {key: entry for key, entry in value.items() if case.path_options.get(key) != entry}
            parts += [_named(key, entry) for key, entry in options.items()]
        elif name == "mode":
            parts.append(f"mode {mode_text(value)}")
        else:
            parts.append(_named(name, value))
    return ", ".join(parts)


def _named(name: str, value: float) -> str:
    symbol, unit = _SYMBOLS.get(name, (name, ""))
    return f"{symbol} = {value:.3g} {unit}".rstrip()


_SYMBOLS = {
    "dt": ("δt", "s"),
    "alpha": ("α", "rad"),
    "ramp_length": ("p", "m"),
    "return_time": ("return time", "s"),
    "ramp_down": ("ramp-down", "s"),
}
"""What fields of a case are called in the report, and their units."""


def _condition_at(instant: float) -> Reason:
    def why(plan: Plan) -> str:
        finite = np.minimum(plan.condition, 1e6)
        return f"at {instant:g} s the condition number is {float(np.interp(instant, plan.t, finite)):.3g} here"

    return why


def _printed(*texts: str) -> tuple[Printed, ...]:
    return tuple(Printed(text) for text in texts)


def _circle(
    index: int,
    figure: str,
    times: tuple[str, str],
    entry: tuple[str, str],
    leave: tuple[str, ...],
    ramps: Grid,
    settings: StudySettings,
) -> tuple[Statement, ...]:
    """Return what is stated about one switch-off on the circle."""
    case = CROSSINGS[index]
    on, off = f"{figure} entry", f"{figure} exit"
    place = f"fig. {figure}"
    both = leave if len(leave) == 2 else leave * 2
    forces = (ramps, grids.ramp_down_samples((0.02, 0.025, 0.03)))
    jumps = (grids.steps_and_returns(*steps_and_returns(settings)),)
    first, last = (float(text) for text in times)
    return (
        Statement(on, place, "threshold met", "s", _printed(times[0]), case, m.entry_time, (ramps,), LARGEST_STEP,
                  _condition_at(first)),
        Statement(on, place, "forces as they begin to fall", "N", _printed(*entry), case, m.entry_forces, forces,
                  0.0, _steep),
        Statement(off, place, "threshold left", "s", _printed(times[1]), case, m.exit_time, (ramps,), LARGEST_STEP,
                  _condition_at(last)),
        Statement(off, place, "forces on switching on", "N", _printed(*both), replace(case, scheme=DIFFERENCES),
                  m.exit_forces, jumps),
    )  # fmt: skip


def _steep(plan: Plan) -> str:
    start, met = m.entry_forces(plan), m.window(plan)["parked_effort_at_entry"]
    rise = max(abs(float(b)) - a for a, b in zip(start, met, strict=True))
    return f"forces rise by {rise:.2g} N in the 0.03 s before the threshold"


def steps_and_returns(settings: StudySettings) -> tuple[Sequence[float], Sequence[float]]:
    """Return the time steps and return times, s, over which the forces on switching on are sought."""
    return (STEPS, RETURNS) if settings.sensitivity else (STEPS[1::3], RETURNS[1:3])


_SAME_RAMP = grids.ramp_lengths((0.74, 0.765, 0.775))
"""Ramps for which the other stated times of the circle at 0.5 m/s are met: all its figures share one motion."""

_OWN_RAMP = grids.ramp_lengths((0.715, 0.74, 0.765, 0.79, 0.815))
"""Ramps for which those at 0.75 m/s are met: another motion, whose ramp is stated as little."""


def statements(settings: StudySettings) -> tuple[Statement, ...]:
    """Return every number that the thesis prints about its planned experiments."""
    line = CROSSINGS[4]
    line_grids = (grids.thresholds((3.0, 4.0, 5.0, 10.0)), grids.ramp_lengths((0.4, 0.5, 0.6)))
    return (
        *_circle(0, "3.11", ("0.38", "0.97"), ("2.6", "3.0"), ("0.20", "0.23"), _SAME_RAMP, settings),
        *_circle(1, "3.13", ("0.42", "0.93"), ("5.4", "5.7"), ("1",), _SAME_RAMP, settings),
        *_circle(2, "3.14", ("0.47", "0.89"), ("7.9", "8.1"), ("2.4",), _SAME_RAMP, settings),
        *_circle(3, "3.16", ("0.26", "0.67"), ("4.2", "5.0"), ("0.46", "0.50"), _OWN_RAMP, settings),
        Statement("3.18-3.20", "section 3.3", "forces begin to fall", "s", _printed("3.5"), line, m.ramp_start,
                  line_grids),
        Statement("3.18-3.20", "section 3.5", "forces as they begin to fall", "N", (Printed("0.01", order=True),) * 2,
                  line, m.entry_forces, line_grids),
        *_corners(settings),
    )  # fmt: skip


def _corners(settings: StudySettings) -> tuple[Statement, ...]:
    full = settings.sensitivity
    shared = (
        grids.modes(settings.modes),
        grids.ramp_lengths(CORNER_RAMPS if full else CORNER_RAMPS[::4]),
        grids.steps(STEPWISE_STEPS if full else STEPWISE_STEPS[1:]),
        grids.orientations(ORIENTATIONS if full else ORIENTATIONS[::6]),
    )
    wide, sharp, square = CORNERS[0], CORNERS[2], CORNERS[5]
    on_square = (*shared, grids.return_times(SQUARE_RETURNS if full else SQUARE_RETURNS[::3]))

    def met(row: str, case: Case, carrier: int, kind: str, text: str, over: tuple[Grid, ...]) -> Statement:
        first = kind == "speed" and row != "4.17-4.18"
        measure = m.first_bound(kind, carrier) if first else m.bound_nearest(kind, carrier, float(text))
        figure = {"4.8-4.9": "fig. 4.9", "4.10-4.11": "fig. 4.11", "4.17-4.18": "fig. 4.18"}[row]
        what = f"carrier {carrier} {'meets' if first else 'is at'} its {kind} limit"
        return Statement(row, figure, what, "s", _printed(text), case, measure, over)

    return (
        met("4.8-4.9", wide, 2, "speed", "0.65", shared),
        met("4.8-4.9", wide, 2, "acceleration", "0.9", shared),
        met("4.10-4.11", sharp, 2, "speed", "0.4", shared),
        met("4.17-4.18", square, 2, "speed", "0.2", on_square),
        met("4.17-4.18", square, 3, "speed", "1", on_square),
        met("4.17-4.18", square, 1, "speed", "2.11", on_square),
    )
