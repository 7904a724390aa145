"""The nodes of a whole-trajectory plan: exactly on jumps, kinks and singular instants, denser beside the latter."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, read_only, require_few
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.kinematics.spectrum import scaled, spectrum_of
from redundancy_pin.planners.carrier_model import Actuation
from redundancy_pin.trajectory.functions_of_time import ContinuousMotion

MOST_NODES = 100_000  # unknowns and rows of the programme are a few dozen times as many

LEAST_STEPS = 2
"""Steps between two events; fewer would tie the carriers' jerk to the distance of the events."""

NEAR = 0.2
"""Smallest over largest singular value of W below which the steps get a middle node from the start: there a kink in s̈
that is harmless elsewhere makes efforts between the nodes that the nodes do not show."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Nodes in time.

    ``t`` (M,) times, s; a time at which the reference acceleration jumps occurs twice; ``singular`` (q,) indices of the
    nodes on type II singularities; ``smooth`` (M,) nodes across which the jerk of the carriers is continuous: the
    singular ones, and the middles of steps in which the efforts would otherwise differ from those at both ends.
    """

    t: Array
    singular: IntArray
    smooth: BoolArray

    @property
    def h(self) -> Array:
        """(M − 1,) lengths of the steps, s; zero across a jump."""
        return read_only(np.diff(self.t))


def singular_instants(dynamics: Dynamics, source: ContinuousMotion) -> list[float]:
    """Return the times, s, at which the motion crosses or touches a type II singularity."""
    return Actuation.along(dynamics, source).singular_instants()


def grid_of(source: ContinuousMotion, singular: list[float], dt: float) -> Grid:
    """Return nodes at most ``dt`` apart, with every event on a node.

    ``singular``: times on a type II singularity, s; ``dt``: largest step, s.
    """
    require_few(
        (source.end - source.start) / dt, MOST_NODES, f"dt = {dt:g} s makes {{}} nodes", "Use a larger dt.", dt=dt
    )
    least = 1e-9 * (source.end - source.start)
    # one that rounding keeps from a jump is on it, or the jump would have no node of its own
    inside = [t for t in singular if source.start <= t <= source.end]
    on = [next((jump for jump in source.breaks if abs(jump - t) <= least), t) for t in inside]
    kinks = [source.start, *source.breaks, *(source.knots if source.exact else []), source.end]
    events = np.unique([*on, *(t for t in kinks if all(abs(t - other) > least for other in on))])
    pieces = [
        np.linspace(a, b, max(int(np.ceil((b - a) / dt - 1e-9)), LEAST_STEPS) + 1)[:-1] for a, b in pairwise(events)
    ]
    times = np.concatenate([*pieces, events[-1:]])
    t = np.repeat(times, 1 + np.isin(times, source.breaks))
    return _grid(t, np.isin(t, on), np.zeros(len(t), dtype=bool))


def near_singular(dynamics: Dynamics, source: ContinuousMotion, grid: Grid) -> BoolArray:
    """Return (M − 1,) the steps near a type II singularity."""
    reduced = dynamics.along(source.sample_at(grid.t)).reduce()
    values = spectrum_of(scaled(reduced.W, reduced.row_scale, reduced.column_scale)).singular_values
    # the only singular value of a single freedom is compared with what it is elsewhere
    size = values[:, 0] if values.shape[1] > 1 else values.max()
    near: BoolArray = values[:, -1] < NEAR * size
    return np.logical_or(near[1:], near[:-1])


def with_middles(grid: Grid, steps: BoolArray) -> Grid:
    """Return a grid with a node in the middle of each marked step, across which the jerk is continuous.

    The efforts are then seen inside these steps, while the carriers have no more freedom than before.

    ``steps`` (M − 1,) which steps; those of length zero are left alone.
    """
    marked = np.flatnonzero(np.asarray(steps) & (np.diff(grid.t) > 0.0))
    middle = 0.5 * (grid.t[marked] + grid.t[marked + 1])
    singular = np.zeros(len(grid.t), dtype=bool)
    singular[grid.singular] = True
    t = np.insert(grid.t, marked + 1, middle)
    return _grid(t, np.insert(singular, marked + 1, False), np.insert(grid.smooth, marked + 1, True))


def _grid(t: Array, singular: BoolArray, smooth: BoolArray) -> Grid:
    h = np.diff(t)
    inner = np.zeros(len(t), dtype=bool)
    inner[1:-1] = (h[:-1] > 0.0) & (h[1:] > 0.0)
    return Grid(read_only(t), read_only(np.flatnonzero(singular)), read_only((smooth | singular) & inner))


def widened(steps: BoolArray, by: int) -> BoolArray:
    """Return the steps (M − 1,) and so many more on both sides of each."""
    wider: BoolArray = np.convolve(steps, np.ones(2 * by + 1)) > 0.5
    return wider[by:-by]
