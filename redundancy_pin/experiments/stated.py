"""What the thesis states about these motions, and how the same quantity is read off a result.

Stated forces are magnitudes: the text has the opposite sign convention. It gives the forces at which the
switch-off begins, one ramp (0.03 s on the circle, 0.36 s on the line) before the condition number meets the threshold,
with carriers still parked; so they need no planner to be compared.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

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


def peak_torques(result: Result) -> tuple[float, ...]:
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


def _threshold_times(result: Result, threshold: float) -> tuple[float, float]:
    # the logarithm of the condition number is nearly straight between samples, and finite below the threshold
    condition = np.minimum(result.rnea.distribution.condition, 1e6)
    above = windows(result.t, condition > threshold)
    first = int(np.searchsorted(result.t, above[0][0]))
    last = int(np.searchsorted(result.t, above[-1][1], side="right")) - 1
    return _level(result, condition, first - 1, threshold), _level(result, condition, last, threshold)


def _level(result: Result, condition: np.ndarray, left: int, threshold: float) -> float:  # type: ignore[type-arg]
    a, b = np.log(condition[left : left + 2])
    fraction = (np.log(threshold) - a) / (b - a)
    return float(result.t[left] + fraction * (result.t[left + 1] - result.t[left]))


_START_OF_RAMP = "ours one ramp (0.03 s) before the threshold"
_CONDITION_8 = "the stated times fit a condition number of about 8"

STATEMENTS: tuple[Stated, ...] = (
    Stated("section 3.2", "circle-0.5-parked", "total time", "s", (2.68,), duration),
    Stated("section 3.2", "circle-0.5-parked", "deceleration begins", "s", (2.48,), deceleration_start),
    Stated("section 3.2", "circle-0.5-parked", "x where singular", "m", (0.175, 0.33), crossing_abscissae),
    Stated("section 3.2", "line-0.1-parked", "x where singular", "m", (0.19,), crossing_abscissae),
    Stated("fig. 3.11", "circle-0.5-parked", "threshold 5 met", "s", (0.38,), threshold_time(5.0)),
    Stated("fig. 3.11", "circle-0.5-parked", "threshold 5 left", "s", (0.97,), threshold_time(5.0, leaving=True)),
    Stated("fig. 3.11", "circle-0.5-parked", "forces at switch-off", "N", (2.6, 3.0), entry_forces(5.0, 0.03), _START_OF_RAMP),
    Stated("fig. 3.13", "circle-0.5-parked", "threshold 10 met", "s", (0.42,), threshold_time(10.0), _CONDITION_8),
    Stated("fig. 3.13", "circle-0.5-parked", "threshold 10 left", "s", (0.93,), threshold_time(10.0, leaving=True), _CONDITION_8),
    Stated("fig. 3.13", "circle-0.5-parked", "forces at switch-off", "N", (5.4, 5.7), entry_forces(10.0, 0.03), _START_OF_RAMP),
    Stated("fig. 3.14", "circle-0.5-parked", "threshold 20 met", "s", (0.47,), threshold_time(20.0)),
    Stated("fig. 3.14", "circle-0.5-parked", "threshold 20 left", "s", (0.89,), threshold_time(20.0, leaving=True)),
    Stated("fig. 3.14", "circle-0.5-parked", "forces at switch-off", "N", (7.9, 8.1), entry_forces(20.0, 0.03), _START_OF_RAMP),
    Stated("fig. 3.16", "circle-0.75-parked", "threshold 5 met", "s", (0.26,), threshold_time(5.0)),
    Stated("fig. 3.16", "circle-0.75-parked", "threshold 5 left", "s", (0.67,), threshold_time(5.0, leaving=True)),
    Stated("fig. 3.16", "circle-0.75-parked", "forces at switch-off", "N", (4.2, 5.0), entry_forces(5.0, 0.03), _START_OF_RAMP),
    Stated("section 3.3", "line-0.1-parked", "threshold met", "s", (3.5,), threshold_time(4.0), "threshold not stated; ours is 4"),
    Stated(
        "section 3.5",
        "line-0.1-parked",
        "forces at switch-off",
        "N",
        (0.01, 0.01),
        entry_forces(4.0, 0.36),
        "stated as an order of magnitude; ours one ramp (0.36 s) before the threshold",
    ),
    Stated("fig. 4.3", "corner-r0.025-baseline", "corner from, to", "s", (0.8, 1.0), arc_times),
)
"""Statements in the text of the thesis that the motions without a planner can be held against."""
