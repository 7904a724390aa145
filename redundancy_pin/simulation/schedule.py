"""When a digital controller reads the state, and when its output acts."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.simulation.control import Sampling

SAME = 1e-9
"""Instants closer than this fraction of a sampling period, or of the interval of the result's samples, are one."""


class Schedule:
    """Readings and changes of the efforts from a start to an end.

    Args:
        sampling: period and delay.
        start: time of the first reading, s.
        end: s; nothing is read there.
    """

    def __init__(self, sampling: Sampling, start: float, end: float) -> None:
        self._start, self._end, self._same = start, end, SAME * sampling.period
        count = max(1, int(np.ceil((end - start) / sampling.period - SAME)))
        self._reads: Array = start + sampling.period * np.arange(count, dtype=np.float64)
        self._acts: Array = self._reads + sampling.delay

    def edges(self, breaks: Array) -> list[float]:
        """Return the instants at which something changes, ``breaks`` among them; those that are the same only once."""
        inner = np.sort(np.concatenate([self._reads, self._acts, breaks]))
        inner = inner[(inner > self._start + self._same) & (inner < self._end - self._same)]
        kept = inner[np.diff(inner, prepend=-np.inf) > self._same]
        return [self._start, *kept.tolist(), self._end]

    def reads(self, t: float) -> int:
        """Return how many readings are due by time t."""
        return int(np.searchsorted(self._reads, t + self._same, side="right"))

    def acts(self, t: float) -> int:
        """Return how many outputs have had the time to act by time t."""
        return int(np.searchsorted(self._acts, t + self._same, side="right"))
