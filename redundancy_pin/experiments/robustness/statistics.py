"""What a finished study says: rates and errors with intervals of confidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import binomtest, bootstrap

from redundancy_pin.arrays import Array
from redundancy_pin.experiments.robustness.trial import Trial

CONFIDENCE = 0.95

RESAMPLES = 2000
"""Of the bootstrap; its seed is fixed, so the same trials give the same intervals."""


@dataclass(frozen=True)
class Interval:
    """An estimate with its interval of confidence.

    Attributes:
        value: the estimate.
        low, high: 95 % interval.
    """

    value: float
    low: float
    high: float


@dataclass(frozen=True)
class CellStatistics:
    """One scenario with one drive.

    Attributes:
        scenario, drive: names.
        draws: number of trials.
        success: share of crossings that succeeded, with Wilson's interval.
        largest: mean of the largest distance of each trial from its plan, m, with the bootstrap's interval; over all
            trials that were simulated, failed ones up to where they ended.
        worst: the largest of these distances, m.
        rms: mean of the root mean square distances, m.
        effort: largest |τ| of any trial, N.
        carrier_force: largest |F| of any trial, N.
        statuses: how often each status came about.
        given_up: largest share of readings at which a computed torque found no answer.
    """

    scenario: str
    drive: str
    draws: int
    success: Interval
    largest: Interval
    worst: float
    rms: Interval
    effort: float
    carrier_force: float
    statuses: dict[str, int]
    given_up: float


def cell_statistics(trials: Sequence[Trial]) -> CellStatistics:
    """Return the statistics of the trials of one cell, one or more."""
    simulated = [trial for trial in trials if np.isfinite(trial.largest)]
    return CellStatistics(
        trials[0].scenario,
        trials[0].drive,
        len(trials),
        wilson(sum(trial.success for trial in trials), len(trials)),
        mean_interval(np.array([trial.largest for trial in simulated])),
        max((trial.largest for trial in simulated), default=float("nan")),
        mean_interval(np.array([trial.rms for trial in simulated])),
        max((trial.effort for trial in simulated), default=float("nan")),
        max((trial.carrier_force for trial in simulated), default=float("nan")),
        {
            status: sum(trial.status == status for trial in trials)
            for status in sorted({trial.status for trial in trials})
        },
        max((trial.given_up for trial in simulated), default=float("nan")),
    )


def wilson(successes: int, count: int) -> Interval:
    """Return a rate with Wilson's interval (Wilson 1927)."""
    found = binomtest(successes, count).proportion_ci(CONFIDENCE, method="wilson")
    return Interval(successes / count, float(found.low), float(found.high))


def mean_interval(values: Array) -> Interval:
    """Return a mean with the percentile interval of the bootstrap; without an interval for fewer than two values."""
    if len(values) == 0:
        return Interval(float("nan"), float("nan"), float("nan"))
    mean = float(values.mean())
    if len(values) < 2 or np.ptp(values) == 0.0:
        return Interval(mean, mean, mean) if len(values) > 1 else Interval(mean, float("nan"), float("nan"))
    found = bootstrap(
        (values,),
        np.mean,
        confidence_level=CONFIDENCE,
        n_resamples=RESAMPLES,
        method="percentile",
        random_state=np.random.default_rng(0),
    ).confidence_interval
    return Interval(mean, float(found.low), float(found.high))
