"""At which times a trajectory is sampled, and which samples are two-sided."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, checked
from redundancy_pin.errors import InputError
from redundancy_pin.trajectory.domain import ROUNDING, inside, positive

MOST_SAMPLES = 10_000_000
"""Samples made at once; more would fill the memory of a usual computer in the dynamics that follow."""


def sample_times(duration: float, breaks: Array, dt: float | None, times: ArrayLike | None, two_sided: bool) -> Array:
    """Return the times to sample at, s; a break occurs twice when it is to be two-sided.

    With ``dt``: 0, dt, 2 dt, ... and the duration, exactly. With ``times``: those. Two-sided, all breaks
    from the first time to the last are inserted twice, in place of a time that differs from one by rounding only,
    so that no step is as short as a rounding error.

    Args:
        duration: of the trajectory, s.
        breaks: (b,) times at which the acceleration jumps, s.
        dt: sampling interval, s, or None.
        times: (N,) strictly increasing times, s, or None.
        two_sided: whether to insert the breaks.

    Raises:
        InputError: both or none of ``dt`` and ``times``, a dt that makes too many samples, times that
            do not increase or are outside [0, duration].
    """
    if (dt is None) == (times is None):
        raise InputError("Pass either dt or times.", remedy="dt=1e-3 samples every millisecond.")
    slack = ROUNDING * duration
    if dt is not None:
        step = positive(dt, "dt", "s")
        if duration / step > MOST_SAMPLES:
            raise InputError(
                f"dt = {step:g} s makes {duration / step:.3g} samples of {duration:.6g} s.",
                remedy=f"At most {MOST_SAMPLES} are made at once: use a larger dt, or sample a part with times.",
                dt=step,
            )
        grid = step * np.arange(np.ceil(duration / step) + 1.0)
        grid = np.append(grid[grid < duration - slack], duration)
    else:
        grid = inside(checked(np.asarray(times), "times", ("N",)), 0.0, duration, "times", "s")
        if len(grid) == 0 or (np.diff(grid) <= 0.0).any():
            raise InputError(
                "times must be a strictly increasing list of at least one time.",
                remedy="Sort the times and remove duplicates; jumps are made two-sided by themselves.",
            )
    if not two_sided or len(breaks) == 0:
        return grid
    within = breaks[(breaks >= grid[0] - slack) & (breaks <= grid[-1] + slack)]
    apart = np.abs(grid[:, None] - within[None, :]) > slack
    return np.sort(np.concatenate([grid[apart.all(axis=1)], within, within]))


def before_jump(times: Array) -> BoolArray:
    """Return (N,) true at the first half of each pair of equal consecutive times."""
    return np.append(times[1:] == times[:-1], False)
