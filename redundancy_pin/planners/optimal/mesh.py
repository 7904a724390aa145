"""Nodes of a plan, in time or along a path: on each jump, kink and singular instant, denser near singularities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, read_only, require_few
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.planners.carrier_model import Actuation
from redundancy_pin.spectrum import scaled, spectrum_of
from redundancy_pin.trajectory.continuous_motion import Motion

MOST_NODES = 100_000  # unknowns and rows of the programme are a few dozen times as many

LEAST_STEPS = 2
"""Steps between two events; fewer would tie the carriers' jerk to the distance of the events."""

NEAR_SINGULAR = 0.2
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


def grid_of(source: Motion, singular: Sequence[float], dt: float, ends: bool = False) -> Grid:
    """Return nodes at most ``dt`` apart, with every event on a node.

    ``singular``: times on a type II singularity, s; ``dt``: largest step, s; ``ends``: steps become shorter towards
    both ends, as for a harmonic motion.
    """
    require_few(
        (source.end - source.start) / dt, MOST_NODES, f"dt = {dt:g} s makes {{}} nodes", "Use a larger dt.", dt=dt
    )
    least = 1e-9 * (source.end - source.start)
    # one that rounding keeps from a jump is on it, or the jump would have no node of its own
    inside = [t for t in singular if source.start <= t <= source.end]
    on = [next((jump for jump in source.breaks if abs(jump - t) <= least), t) for t in inside]
    events = np.unique([*on, *(t for t in source.kinks if all(abs(t - other) > least for other in on))])
    span = source.end - source.start
    pieces = []
    for a, b in pairwise(events):
        phase = np.arccos(np.clip(1.0 - 2.0 * (np.array([a, b]) - source.start) / span, -1.0, 1.0)) * span / np.pi
        first, last = phase if ends else (a, b)
        piece = np.linspace(first, last, max(int(np.ceil((last - first) / dt - 1e-9)), LEAST_STEPS) + 1)[:-1]
        if ends:
            piece = np.append(a, source.start + 0.5 * span * (1.0 - np.cos(np.pi / span * piece[1:])))
        pieces.append(piece)
    times = np.concatenate([*pieces, events[-1:]])
    t = np.repeat(times, 1 + np.isin(times, source.breaks))
    return _grid(t, np.isin(t, on), np.zeros(len(t), dtype=bool))


def first_mesh(dynamics: Dynamics, source: Motion, dt: float, ends: bool = False) -> Grid:
    """Return the nodes of ``grid_of``, singular instants included, with a middle in each step next to a singularity."""
    grid = grid_of(source, Actuation.along(dynamics, source).singular_instants, dt, ends)
    near = near_singular(dynamics.along(source.sample_at(grid.t)).reduce())
    return with_middles(grid, near[1:] | near[:-1])


def near_singular(reduced: ReducedDynamics) -> BoolArray:
    """Return (M,) at which nodes W is near a type II singularity."""
    return singular_ratio(reduced) < NEAR_SINGULAR


def singular_ratio(reduced: ReducedDynamics) -> Array:
    """Return (M,) the smallest singular value of the scaled W over the largest."""
    values = spectrum_of(scaled(reduced.W, reduced.row_scale, reduced.column_scale)).singular_values
    # the only singular value of a single DOF is compared with its values elsewhere
    size = values[:, 0] if values.shape[1] > 1 else values.max()
    return np.asarray(values[:, -1] / size)


def with_middles(grid: Grid, steps: BoolArray) -> Grid:
    """Return a grid with a node in the middle of each marked step, across which the jerk is continuous.

    The efforts are then seen inside these steps, while the carriers have no more freedom than before.

    ``steps`` (M − 1,) whether to split a step; steps of length zero are never split.
    """
    marked = np.flatnonzero(np.asarray(steps) & (np.diff(grid.t) > 0.0))
    return with_nodes(grid, marked, 0.5 * (grid.t[marked] + grid.t[marked + 1]), True)


def with_nodes(grid: Grid, marked: IntArray, t: Array, smooth: BoolArray | bool) -> Grid:
    """Return a grid with one node more in each of the marked steps, (r,) indices, at (r,) ``t``.

    ``smooth`` (r,) whether the jerk of the carriers is continuous there.
    """
    singular = np.zeros(len(grid.t), dtype=bool)
    singular[grid.singular] = True
    singular, both = np.insert(singular, marked + 1, False), np.insert(grid.smooth, marked + 1, smooth)
    return _grid(np.insert(grid.t, marked + 1, t), singular, both)


def _grid(t: Array, singular: BoolArray, smooth: BoolArray) -> Grid:
    h = np.diff(t)
    inner = np.zeros(len(t), dtype=bool)
    inner[1:-1] = (h[:-1] > 0.0) & (h[1:] > 0.0)
    return Grid(read_only(t), read_only(np.flatnonzero(singular)), read_only((smooth | singular) & inner))


def steps_around(nodes: Array, times: Array, by: int) -> BoolArray:
    """Return (M − 1,) the steps between (M,) nodes, s, in which some times lie, and so many more on both sides."""
    steps = np.zeros(len(nodes) - 1, dtype=bool)
    steps[np.searchsorted(nodes, times, side="right") - 1] = True
    return widened(steps, by)


def widened(steps: BoolArray, by: int) -> BoolArray:
    """Return the steps (M − 1,) and so many more on both sides of each."""
    wider: BoolArray = np.convolve(steps, np.ones(2 * by + 1)) > 0.5
    return wider[by : by + len(steps)]


def resample(values: Mapping[str, Array], old: Array, new: Array) -> dict[str, Array]:
    """Return blocks of variables at new nodes, linear between the old ones.

    Of nodes that occur twice the second one is the second one there, too.

    ``values``: blocks by name; one with a row a node is interpolated, of any other, whose rows are copies of one
    variable, the first row is kept; ``old`` (M,) and ``new`` nodes, of which each old jump is one.
    """
    at = np.searchsorted(old, new, side="left")
    at[np.append(False, np.diff(new) == 0.0)] += 1
    below = np.maximum(at - 1, 0)
    share = np.divide(new - old[below], old[at] - old[below], out=np.ones_like(new), where=old[at] != new)[:, None]
    return {
        name: (1.0 - share) * block[below] + share * block[at] if len(block) == len(old) else block[:1]
        for name, block in values.items()
    }
