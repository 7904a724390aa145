"""What the thesis states about these motions, and how the same quantity is read off a result.

Stated forces are magnitudes: the text has the opposite sign convention. It gives the forces at which the
switch-off begins, one ramp (0.03 s on the circle, 0.36 s on the line) before the condition number meets the threshold,
with carriers still parked; so they need no planner to be compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.experiments.result import Result, windows

Measure = Callable[[Result], tuple[float, ...]]


@dataclass(frozen=True)
class Stated:
    """One statement of the thesis.

    Attributes:
        source: where it is made.
        experiment: name of the experiment it is about.
        quantity: what is stated.
        unit: its unit.
        values: the stated numbers.
        measure: how to read the same numbers off a result.
        note: why ours may differ, where it is known.
    """

    source: str
    experiment: str
    quantity: str
    unit: str
    values: tuple[float, ...]
    measure: Measure
    note: str = ""


@dataclass(frozen=True)
class Compared:
    """A statement beside our numbers."""

    stated: Stated
    ours: tuple[float, ...]

    def as_dict(self) -> dict[str, object]:
        """Return plain data, for JSON."""
        return {
            "source": self.stated.source,
            "experiment": self.stated.experiment,
            "quantity": self.stated.quantity,
            "unit": self.stated.unit,
            "stated": list(self.stated.values),
            "computed": list(self.ours),
            "note": self.stated.note,
        }


def compare_with_thesis(results: Sequence[Result]) -> tuple[Compared, ...]:
    """Return every statement about the experiments that were run, beside our numbers."""
    by_name: Mapping[str, Result] = {result.experiment.name: result for result in results}
    return tuple(
        Compared(stated, stated.measure(by_name[stated.experiment]))
        for stated in STATEMENTS
        if stated.experiment in by_name
    )


def duration(result: Result) -> tuple[float, ...]:
    """Return the total time, s."""
    return (result.trajectory.duration,)


def deceleration_start(result: Result) -> tuple[float, ...]:
    """Return the time at which the speed begins to fall for the last time, s."""
    speed = np.linalg.norm(result.motion.xd, axis=1)
    cruising = np.isclose(speed, np.median(speed), rtol=1e-9)
    return (float(result.t[np.flatnonzero(cruising)[-1]]),)


def arc_times(result: Result) -> tuple[float, ...]:
    """Return the first and the last jump of the acceleration, s: where the corner begins and ends."""
    breaks = result.trajectory.breaks
    return (float(breaks[0]), float(breaks[-1]))


def crossing_abscissae(result: Result) -> tuple[float, ...]:
    """Return x at the singular instants, m."""
    return tuple(instant.x[0] for instant in result.instants)


def peak_efforts(result: Result) -> tuple[float, ...]:
    """Return the largest |τ| of each actuator, N·m or N."""
    return tuple(float(peak) for peak in result.peaks)


def threshold_time(threshold: float, *, leaving: bool = False) -> Measure:
    """Return a measure: when the condition number first exceeds a threshold, or last does (``leaving``), s.

    The circle passes two singularities, between which the condition number falls to about 17; the thesis treats
    them as one region, so the first entry and the last exit count.
    """

    def measure(result: Result) -> tuple[float, ...]:
        entered, left = _threshold_times(result, threshold)
        return (left if leaving else entered,)

    return measure


def entry_forces(threshold: float, ramp: float) -> Measure:
    """Return a measure: |τ| of each actuator one ramp, s, before the condition number meets a threshold, N."""

    def measure(result: Result) -> tuple[float, ...]:
        entered, _ = _threshold_times(result, threshold)
        tau = result.rnea.distribution.tau
        return tuple(abs(float(np.interp(entered - ramp, result.t, tau[:, i]))) for i in range(tau.shape[1]))

    return measure


def switch_off_start(threshold: float, ramp: float) -> Measure:
    """Return a measure: one ramp, s, before the condition number meets a threshold, s."""

    def measure(result: Result) -> tuple[float, ...]:
        return (_threshold_times(result, threshold)[0] - ramp,)

    return measure


def _threshold_times(result: Result, threshold: float) -> tuple[float, float]:
    # the logarithm of the condition number is nearly straight between samples, and finite below the threshold
    condition = np.minimum(result.rnea.distribution.condition, 1e6)
    above = windows(result.t, condition > threshold)
    first = int(np.searchsorted(result.t, above[0][0]))
    last = int(np.searchsorted(result.t, above[-1][1], side="right")) - 1
    return _level(result, condition, first - 1, threshold), _level(result, condition, last, threshold)


def _level(result: Result, condition: Array, left: int, threshold: float) -> float:
    a, b = np.log(condition[left : left + 2])
    fraction = (np.log(threshold) - a) / (b - a)
    return float(result.t[left] + fraction * (result.t[left + 1] - result.t[left]))


_CIRCLE_RAMP, _LINE_RAMP = 0.03, 0.36
"""Durations of the switch-off, s."""

_AT_START = "ours at the start of the switch-off, 0.03 s before the threshold is met"
_CONDITION_8 = "the stated times fit a condition number of about 8"
_REBUILT = "no number in the text: stands for a rebuild of its model, sampled every 10 ms"


def _circle(
    figure: str, speed: str, threshold: float, met: float, left: float, forces: tuple[float, float], note: str = ""
) -> tuple[Stated, ...]:
    """Return what is stated about one switch-off on the circle."""
    name, level = f"circle-{speed}-parked", f"threshold {threshold:g}"
    return (
        Stated(figure, name, f"{level} met", "s", (met,), threshold_time(threshold), note),
        Stated(figure, name, f"{level} left", "s", (left,), threshold_time(threshold, leaving=True), note),
        Stated(figure, name, f"{level}: forces", "N", forces, entry_forces(threshold, _CIRCLE_RAMP), _AT_START),
    )


STATEMENTS: tuple[Stated, ...] = (
    Stated("section 3.2", "circle-0.5-parked", "total time", "s", (2.68,), duration),
    Stated("section 3.2", "circle-0.5-parked", "deceleration begins", "s", (2.48,), deceleration_start),
    Stated("section 3.2", "circle-0.5-parked", "x where singular", "m", (0.175, 0.33), crossing_abscissae),
    Stated("section 3.2", "line-0.1-parked", "x where singular", "m", (0.19,), crossing_abscissae),
    *_circle("fig. 3.11", "0.5", 5.0, 0.38, 0.97, (2.6, 3.0)),
    *_circle("fig. 3.13", "0.5", 10.0, 0.42, 0.93, (5.4, 5.7), _CONDITION_8),
    *_circle("fig. 3.14", "0.5", 20.0, 0.47, 0.89, (7.9, 8.1)),
    *_circle("fig. 3.16", "0.75", 5.0, 0.26, 0.67, (4.2, 5.0)),
    Stated(
        "section 3.3",
        "line-0.1-parked",
        "forces begin to fall",
        "s",
        (3.5,),
        switch_off_start(4.0, _LINE_RAMP),
        "the threshold is not stated; ours is 4",
    ),
    Stated(
        "section 3.5",
        "line-0.1-parked",
        "threshold 4: forces",
        "N",
        (0.01, 0.01),
        entry_forces(4.0, _LINE_RAMP),
        "an order of magnitude; ours at the start of the switch-off, 0.36 s before the threshold is met",
    ),
    Stated("section 4.2", "corner-r0.025-baseline", "corner from, to", "s", (0.8, 1.0), arc_times),
    Stated("chapter 2", "corner-r0.025-baseline", "peaks", "N·m", (2.3, 3.0, 2.9), peak_efforts, _REBUILT),
    Stated("chapter 2", "corner-r0.013-baseline", "peaks", "N·m", (4.6, 5.9, 5.6), peak_efforts, _REBUILT),
)
"""Statements in the text of the thesis that the motions without a planner can be held against."""
