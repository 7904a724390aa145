"""W τ = f at the instants ahead: where it is singular, and at the nodes of a plan linear in the carriers' motion.

Instants are fixed in time, an eighth of a step apart, so that each is evaluated once, when it comes into sight: there f
is a sum of terms of the carriers' motion (``Dynamics.carrier_terms``), and its values and slopes at any plan need no
backend.

At a singular instant uᵀ W = 0, and τ is what W⁻¹ f tends to: uᵀ Ẇ τ = uᵀ ḟ, with the jerk of the step before and with
that of the step after. With f linear, f = f̄ + F_s δs + F_ṡ δṡ + F_s̈ δs̈, and ′ the derivative by time along the motion
that continues s̄ without jerk,

    ḟ = f̄′ + F_s′ δs + (F_s + F_ṡ′) δṡ + (F_ṡ + F_s̈′) δs̈ + F_s̈ s⃛.
"""

from __future__ import annotations

from collections import deque
from copy import copy
from math import floor, isfinite, isnan, nan
from typing import Any, NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import chebder, chebroots, chebval
from numpy.typing import NDArray

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.results import CarrierTerms
from redundancy_pin.planners.carrier_model import carrier_model, terms
from redundancy_pin.planners.receding_horizon.constants import (
    AT_REST,
    BESIDE,
    DIFFERENCE,
    FADES,
    KEPT,
    PARTS,
    POINTS,
    ROOM,
    ROUNDING,
    SAME,
    SHALLOW,
    SHARP,
    TOUCH,
)
from redundancy_pin.planners.receding_horizon.preview import Preview
from redundancy_pin.robot.scales import turning_velocities
from redundancy_pin.trajectory.functions_of_time import chebyshev_points, chebyshev_series

WITHIN = chebyshev_points(np.array([-1.0]), np.array([1.0]), POINTS - 1)
TO_SERIES = chebyshev_series(np.eye(POINTS)[None])[0]
"""Where det W is evaluated between two instants, from -1 to 1, and the series of such values."""


class Coefficients(NamedTuple):
    """Of N instants; n coordinates, m main actuators, k carriers, T terms.

    ``t`` (N,) s; ``known`` (N,) whether the machine can be there; ``W`` (N, n, m); ``constant`` (N, n + k): f and the
    carriers' forces with the carriers at rest at s = 0, N and N·m; ``terms`` (N, k, T, n + k): of them by carrier.
    """

    t: Array
    known: BoolArray
    W: Array
    constant: Array
    terms: Array

    def at(self, places: IntArray | BoolArray) -> Coefficients:
        """Return those of some instants."""
        return Coefficients._make(part[places] for part in self)

    def values(self, places: IntArray, s: Array, sd: Array, sdd: Array) -> Array:
        """Return f and forces (N, n + k) of carriers (N, k) at some of the instants."""
        by_term = np.stack(terms(s, sd, sdd, self.terms.shape[2], np), axis=-1)
        value: Array = self.constant[places] + (by_term[:, :, None] @ self.terms[places]).sum(axis=1)[:, 0]
        return value


class _Memory:
    """Coefficients of instants in order of time, in arrays with room behind them.

    What has been handed out are views: an instant between others moves those behind it.
    """

    def __init__(self) -> None:
        self.known = Coefficients(np.empty(0), np.empty(0, dtype=bool), *(np.empty(0) for _ in range(3)))
        self._arrays: list[NDArray[Any]] = []
        self._first = self._last = self._room = 0

    def add(self, times: Array, reachable: BoolArray | bool, terms: CarrierTerms) -> Coefficients:
        """Return what is known with further instants, s."""
        old, more = self.known, len(times)
        count = len(old.t) + more
        if self._last + more > self._room:
            # float64 whatever a backend has: machine code reads them
            self._room = max(ROOM, 2 * count)
            of_terms = (np.empty((self._room, *part.shape[1:])) for part in terms)
            self._arrays = [np.empty(self._room), np.empty(self._room, dtype=bool), *of_terms]
            self._first, self._last = 0, len(old.t)
            for array, known in zip(self._arrays, old, strict=True):
                if len(known):
                    array[: len(known)] = known
        new: slice | IntArray = slice(self._last, self._last + more)
        if len(old.t) and times[0] < old.t[-1]:  # between them: seldom, and of those that are last
            tail = int(old.t.searchsorted(times[0]))
            new = self._first + old.t.searchsorted(times) + np.arange(more)
            moved = self._first + np.arange(tail, len(old.t))
            further = moved + times.searchsorted(old.t[tail:])
            for array in self._arrays:
                array[further] = array[moved]
        for array, part in zip(self._arrays, (times, reachable, *terms), strict=True):
            array[new] = part
        self._last += more
        return self._seen()

    def drop_before(self, time: float) -> Coefficients:
        """Return what is known without the instants before a time, s."""
        self._first += int(self.known.t.searchsorted(time))
        return self._seen()

    def _seen(self) -> Coefficients:
        seen = slice(self._first, self._last)
        self.known = Coefficients._make([array[seen] for array in self._arrays])
        return self.known


class Ahead:
    """Coefficients and singular instants along a preview, as far as it is in sight.

    Nothing is evaluated behind an instant that the machine cannot be at: no plan leads past it. Those instants count
    as unreachable, until it is past.

    Args:
        dynamics: a backend.
        preview: the platform's motion.
        step: between nodes, s.

    Attributes:
        known: what has been evaluated, in order of time.
        row_scale: (n,) see ``ReducedDynamics``.
        roots: singular instants, s.
        sharp: instants about which f of the parked machine bends most, s.
        edges: instants between which they have been looked for, s.
    """

    def __init__(self, dynamics: Dynamics, preview: Preview, step: float) -> None:
        self.dynamics, self.preview, self.spacing = dynamics, preview, step / PARTS
        self.row_scale = np.ones(dynamics.robot.n)
        self._turning = bool(turning_velocities(dynamics.robot)[dynamics.robot.carrier_velocity].any())
        self._square = dynamics.robot.n == dynamics.robot.m
        self._checked = False
        self._largest = self._size = 0.0
        self.roots = self.sharp = np.empty(0)
        self._clear()

    def along(self, preview: Preview, t: float) -> Ahead:
        """Return what is in sight of another preview from a time on, s: nothing yet, but what is past and the sizes."""
        other = copy(self)
        other.preview = preview
        other._clear(t)
        return other

    def _clear(self, keep: float = -np.inf) -> None:
        """Forget all but the instants before a time, s, around which the nodes stay."""
        self._memory = _Memory()
        self.known = self._memory.known
        self._blocked = np.inf  # the first unreachable instant, s
        self.edges = np.empty(0)
        step = PARTS * self.spacing
        self.roots = self.roots[(self.roots < keep) & (self.roots >= keep - KEPT * step)]
        # the first that is looked for is a step and up to two instants later
        self.sharp = self.sharp[(self.sharp < keep + 1.3 * step) & (self.sharp >= keep - KEPT * step)]
        self._determinants: list[float] = []  # at the last two edges
        self._recent: deque[tuple[float, list[float]]] = deque(maxlen=2 * PARTS + 1)  # edges, and f parked there
        self._bends: deque[tuple[float, float]] = deque(maxlen=3)

    def look(self, start: float, end: float) -> Array:
        """Go on to a time, s, from a first one; return the singular instants from the first one on, s.

        Where the preview may change its mind, all of it is read anew.
        """
        preview, spacing = self.preview, self.spacing
        start, end = max(float(start), preview.start), min(float(end), preview.end)
        in_sight = self.edges[0] <= start <= min(self.edges[-1], self._blocked) + SAME if len(self.edges) else True
        if preview.changing or not in_sight:
            self._clear(start if preview.changing else -np.inf)
        seen = self.edges
        past = start - KEPT * PARTS * spacing
        if len(self.known.t) > 2.0 * (end - start) / spacing + 100:
            self.known = self._memory.drop_before(past)
            self.edges = seen = seen[seen >= past]
            self._determinants = self._determinants[-len(seen) :]
            self.roots = self.roots[self.roots >= past]
            self.sharp = self.sharp[self.sharp >= past]
        first = float(seen[-1]) if len(seen) else start
        begin = floor(first / spacing)
        while begin * spacing <= first + 0.1 * spacing:
            begin += 1
        new = [spacing * i for i in range(begin, floor(end / spacing + 1e-6) + 1)]  # sooner than by arrays
        if not len(seen):
            new.insert(0, first)
        if preview.end - end <= SAME and (not new or new[-1] < end - SAME) and end > first + SAME:
            new.append(end)  # nothing more will be known
        if new:
            times = np.array(new)
            places = self._new(times)
            self.edges = np.concatenate((seen, times))
            crossed = self._scan(places) if self._square else []
            self._scan_sharp(new, places)
            # what plans ask for at singular instants, so that they need not come back for it
            beside = [root + shift for root in crossed for shift in (-DIFFERENCE, 0.0, DIFFERENCE)]
            if beside := sorted([time for time in beside if start <= time <= end]):
                self._evaluate(np.array(beside))
        return self.roots[self.roots >= start]

    def _new(self, times: Array) -> IntArray | slice:
        """Return the places in ``known`` of instants that mostly are after all that is there; they are evaluated."""
        t = self.known.t
        if len(t) and times[0] <= t[-1] + SAME:
            return self.at(times)
        self._add(times)
        return slice(len(t), None)

    def at(self, times: Array) -> IntArray:
        """Return the places (N,) of instants in ``known``, s; what is missing there is evaluated."""
        self._evaluate(times)
        return self._found(times)[0]

    def _evaluate(self, times: Array) -> None:
        missing = self._found(times)[1]
        if missing.any():
            new = times[missing]
            self._add(new if (new[1:] > new[:-1]).all() else np.unique(new))

    def _found(self, times: Array) -> tuple[IntArray, BoolArray]:
        """Return the places (N,) of instants in ``known``, s, and which are missing there."""
        t = self.known.t
        places = t.searchsorted(times - SAME)
        if not len(t):
            return places, np.ones(len(times), dtype=bool)
        inside = np.minimum(places, len(t) - 1)
        return inside, (places > inside) | (t[inside] > times + SAME)

    def instants(self, nodes: Array, until: float) -> Array:
        """Return nodes up to a time, s, or the first alone, the instants of the grid, and both sides of jumps of ẍ."""
        nodes = nodes[: max(int((nodes <= until + SAME).sum()), 1)]
        breaks = self.preview.breaks
        breaks = breaks[(breaks > nodes[0] + 2.0 * BESIDE) & (breaks < nodes[-1] - 2.0 * BESIDE)]
        grid = self.spacing * np.arange(np.ceil(nodes[0] / self.spacing), np.ceil(nodes[-1] / self.spacing))
        away = np.abs(grid[:, None] - np.append(nodes, breaks)).min(axis=1) > 0.1 * self.spacing
        return np.unique(np.concatenate([nodes, grid[away], breaks - BESIDE, breaks + BESIDE]))

    def _add(self, times: Array) -> None:
        count = int(times.searchsorted(self._blocked, "right"))
        if count:
            read = self._read(times[:count])
        else:
            read = CarrierTerms(*(np.full((0, *part.shape[1:]), np.nan) for part in self.known[2:]))
        reachable: BoolArray | bool = True
        if count < len(times) or not isfinite(sum(read.constant.ravel().tolist())):
            behind = len(times) - count
            read = CarrierTerms(*(np.concatenate([part, np.full((behind, *part.shape[1:]), np.nan)]) for part in read))
            reachable = np.asarray(np.logical_and.accumulate(np.isfinite(read.constant).all(axis=1)))
            self._blocked = min(self._blocked, times[np.logical_not(reachable)][0])
            read = CarrierTerms(*map(np.nan_to_num, read))
        self.known = self._memory.add(times, reachable, read)

    def _read(self, times: Array) -> CarrierTerms:
        if self._turning or not self._checked:
            return self._modelled(times)
        return self.dynamics.carrier_terms(times, *self.preview.states(times))

    def _modelled(self, times: Array) -> CarrierTerms:
        """Return what ``carrier_terms`` does, of carriers of any kind; the first time, look whether it is all."""
        along = self.dynamics.along(self.preview.motion(times), unreachable="mark")
        model = carrier_model(along, turning=self._turning)
        if not self._checked:
            self.row_scale, self._checked = along.reduce().row_scale, True
        own = np.arange(model.k)
        of_f = model.f_terms.transpose(0, 2, 3, 1)
        of_force = np.zeros((*of_f.shape[:3], model.k))
        of_force[:, own, :, own] = model.force_terms.transpose(1, 0, 2)
        constant = np.concatenate([model.f0, model.force0], axis=1)
        return CarrierTerms(model.W, constant, np.concatenate([of_f, of_force], axis=3))

    def _scan(self, places: IntArray | slice) -> list[float]:
        """Return the singular instants, s, among the last edges, which are at these places, and the two before."""
        new, reachable = np.linalg.det(self.known.W[places]).tolist(), self.known.known[places].tolist()
        # of few numbers sooner known than by arrays; what is compared with NaN is false
        value = self._determinants + [v if there else nan for v, there in zip(new, reachable, strict=True)]
        size = [abs(v) for v in value]
        self._determinants = value[-2:]
        self._largest = largest = max([self._largest, *[v for v in size if not isnan(v)]])
        zero = [v <= AT_REST * largest for v in size]
        brackets = set()
        for j in range(1, len(value)):
            if value[j - 1] * value[j] < 0.0 and not zero[j - 1] and not zero[j]:
                brackets.add((j - 1, j))
        for j in range(1, len(value) - 1):
            dip = size[j] <= size[j - 1] and size[j] < size[j + 1] and size[j] < 0.3 * largest
            if (dip and value[j - 1] * value[j + 1] > 0.0) or (zero[j] and not zero[j - 1] and not zero[j + 1]):
                brackets.add((j - 1, j + 1))
        if not brackets:
            return []
        edges, near, before = self.edges[-len(value) :].tolist(), 1e-3 * PARTS * self.spacing, self.roots.tolist()
        found: list[float] = []
        for first, last in sorted(brackets):
            roots = self._within(edges[first], edges[last], largest)
            found += [root for root in roots if not any(abs(root - other) < near for other in before + found)]
        self.roots = np.array(sorted(before + found))
        return found

    def _scan_sharp(self, times: list[float], places: IntArray | slice) -> None:
        """Look for instants a step or more before the last edges, s, where f of the parked machine bends most."""
        # a tick has few of them: sooner done by numbers than by arrays
        rows = (self.known.constant[places][:, : len(self.row_scale)] / self.row_scale).tolist()
        recent, bends, found, fades = self._recent, self._bends, [], 0.5 ** (self.spacing / FADES)
        for time, row, reachable in zip(times, rows, self.known.known[places].tolist(), strict=True):
            if not reachable:
                recent.clear()
                bends.clear()
                continue
            recent.append((time, row))
            self._size = max(fades * self._size, max(row), -min(row))
            if len(recent) <= 2 * PARTS:
                continue
            (first, before), (middle, there) = recent[0], recent[PARTS]
            if abs(first + time - 2.0 * middle) > SAME:  # a first or last one between the grid
                bends.clear()
                continue
            bend = max([abs(own - 0.5 * (one + other)) for one, own, other in zip(before, there, row, strict=True)])
            bends.append((middle, bend))
            if len(bends) == 3 and bends[0][1] < bends[1][1] >= bend and bends[1][1] > SHARP * self._size:
                found.append(bends[1][0])
        # with another preview it may be there already
        found = [time for time in found if not (np.abs(self.sharp - time) < 0.5 * PARTS * self.spacing).any()]
        if found:
            self.sharp = np.append(self.sharp, found)

    def _within(self, start: float, end: float, largest: float) -> list[float]:
        """Return the instants between two times at which det W is zero, or next to it at a dip, s."""
        middle, half = 0.5 * (start + end), 0.5 * (end - start)
        W = self._read(middle + half * WITHIN).W
        value = np.linalg.det(W) / largest
        size = np.abs(value)
        if not isfinite(size.sum()):
            return []
        if size.min() > max(SHALLOW * size.max(), 10.0 * TOUCH) and (value.min() > 0.0 or value.max() < 0.0):
            return []
        return [middle + half * zero for zero in zeros_of((TO_SERIES @ value).tolist())]


def zeros_of(series: list[float]) -> list[float]:
    """Return the zeros from -1 to 1 of a Chebyshev series (D + 1,), or lows that all but touch zero."""
    while len(series) > 1 and abs(series[-1]) <= ROUNDING:
        series = series[:-1]
    slope = series[1] if len(series) > 1 else 0.0
    bend = sum([k * k * abs(c) for k, c in enumerate(series[2:], 2)])  # |Tₖ′| ≤ k²
    if bend < 0.5 * abs(slope) and chebyshev(-1.0, series) * chebyshev(1.0, series) < 0.0:
        zero = 0.0
        for _ in range(60):  # each at most half as far from it: sooner than by eigenvalues
            before, zero = zero, min(max(zero - chebyshev(zero, series) / slope, -1.0), 1.0)
            if abs(zero - before) <= 1e-15:
                break
        return [zero]
    zeros = chebroots(series)
    zeros = zeros.real[(np.abs(zeros.imag) < 2e-7) & (np.abs(zeros.real) <= 1.0 + 2e-9)]
    if not len(zeros):
        low = chebroots(chebder(series))
        low = low.real[(np.abs(low.imag) < 2e-7) & (np.abs(low.real) < 1.0)]
        zeros = low[np.abs(chebval(low, series)) < TOUCH]
    found: list[float] = zeros.tolist()
    return found


def chebyshev(x: float, series: list[float]) -> float:
    """Return a Chebyshev series (D + 1,) at x, from -1 to 1: Clenshaw's recurrence, sooner than by arrays."""
    one = two = 0.0
    for c in reversed(series[1:]):
        one, two = c + 2.0 * x * one - two, one
    return series[0] + x * one - two
