"""W τ = f at the instants ahead: where it is singular, and at the nodes of a plan linear in the carriers' motion.

Instants are fixed in time, an eighth of a step apart, so that each is evaluated once, when it comes into sight: there f
is a sum of terms of the carriers' motion (``CarrierModel``), and its values and slopes at any plan need no backend.

At a singular instant uᵀ W = 0, and τ is what W⁻¹ f tends to: uᵀ Ẇ τ = uᵀ ḟ, with the jerk of the step before and with
that of the step after. With f linear, f = f̄ + F_s δs + F_ṡ δṡ + F_s̈ δs̈, and ′ the derivative by time along the motion
that continues s̄ without jerk,

    ḟ = f̄′ + F_s′ δs + (F_s + F_ṡ′) δṡ + (F_ṡ + F_s̈′) δs̈ + F_s̈ s⃛.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.polynomial import Chebyshev

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.kinematics.coordinates import turning_velocities
from redundancy_pin.planners.carrier_model import carrier_model, terms, turning_model
from redundancy_pin.planners.receding_horizon.preview import SAME, Preview
from redundancy_pin.trajectory.functions_of_time import chebyshev_points

PARTS = 8
"""Instants a step at which W τ = f is known: two crossings closer than that show as a dip of det W."""

POINTS = 13
"""At which det W is evaluated around a change of its sign, for its polynomial."""

TOUCH = 1e-3
"""|det W| at a dip, relative to the largest, below which the motion counts as touching the singularity."""

AT_REST = 1e-9
"""Fraction of the largest |det W| below which it counts as zero: motions that stop there."""

DIFFERENCE = 1e-4
"""For derivatives by time at singular instants, s: central differences, off by its square."""

ZONE = 2.5
"""Steps around a singular instant in which the nodes are half as far apart: a step in s̈ there makes τ swing."""

NEAR = 10
"""Steps from which on the nodes are twice as far apart."""

APART = 0.05, 0.2
"""Least distances, in steps, of singular instants and of other nodes from those and the start."""

FIRST = 3
"""Steps in which the efforts of a plan are evaluated exactly, at every instant that is known."""

BESIDE = 1e-8
"""Before and after an instant at which ẍ jumps, s: f jumps with it, and so do the efforts."""

TINY = 1e-30
"""Complex step: derivatives without differences."""

BEND = 1e-3
"""Central differences of these, m and m/s, for second derivatives: exact but for carriers that turn."""

KEPT = 3
"""Steps that are past and still kept, for the nodes around a singular instant that is past."""


@dataclass(frozen=True, eq=False)
class Coefficients:
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
        return Coefficients(*(getattr(self, name)[places] for name in _NAMES))

    def merged(self, other: Coefficients) -> Coefficients:
        """Return these and others, in order of time."""
        if not len(self.t):
            return other
        order = np.argsort(np.append(self.t, other.t), kind="stable")
        return Coefficients(*(np.concatenate([getattr(self, name), getattr(other, name)])[order] for name in _NAMES))

    def values(self, places: IntArray, s: Array, sd: Array, sdd: Array) -> Array:
        """Return f and forces (N, n + k) of carriers (N, k) at some of the instants."""
        by_term = np.stack(terms(s, sd, sdd, self.terms.shape[2], np), axis=-1)
        value: Array = self.constant[places] + (by_term[:, :, None] @ self.terms[places]).sum(axis=1)[:, 0]
        return value

    def slopes(self, places: IntArray, s: Array, sd: Array, sdd: Array) -> tuple[Array, Array]:
        """Return ``values`` and their derivatives (3, N, n + k, k) by s, ṡ and s̈."""
        s, sd, sdd = np.stack([s, sd, sdd])[:, None] + 1j * TINY * np.eye(3)[:, :, None, None]
        by_term = np.stack(terms(s, sd, sdd, self.terms.shape[2], np), axis=-1)  # (3, N, k, T)
        by_term = np.concatenate([by_term[:1].real, by_term.imag / TINY]).transpose(1, 2, 0, 3)
        all_of = by_term @ self.terms[places]  # (N, k, 4, n + k)
        return self.constant[places] + all_of[:, :, 0].sum(axis=1), all_of[:, :, 1:].transpose(2, 0, 3, 1)

    def curvature(self, places: IntArray, s: Array, sd: Array, sdd: Array, along: Array) -> Array:
        """Return second derivatives (N, k, 3, 3) of f along directions (N, n), by s, ṡ and s̈ of each carrier."""
        count, n = self.terms.shape[2], along.shape[1]
        by_term = (self.terms[places][..., :n] @ along[:, None, :, None])[..., 0]  # (N, k, T)
        steps = BEND * np.stack([np.eye(3), -np.eye(3)])[:, None] + 1j * TINY * np.eye(3)[:, None]
        at = steps[..., None, None] + np.stack([s, sd, sdd])  # (2, 3 by steps i, 3 by steps of size h, 3, N, k)
        s, sd, sdd = np.moveaxis(at, 3, 0)
        slope = np.stack(terms(s, sd, sdd, count, np), axis=-1).imag / TINY
        second: Array = ((slope[0] - slope[1]) * by_term).sum(axis=-1) / (2.0 * BEND)
        return second.transpose(2, 3, 0, 1)


_NAMES = tuple(field.name for field in fields(Coefficients))


class Ahead:
    """Coefficients and singular instants along a preview, as far as it is in sight.

    Args:
        dynamics: a backend.
        preview: the platform's motion.
        step: between nodes, s.

    Attributes:
        known: what has been evaluated, in order of time.
        row_scale: (n,) see ``ReducedDynamics``.
        roots: singular instants, s.
        edges: instants between which they have been looked for, s.
    """

    def __init__(self, dynamics: Dynamics, preview: Preview, step: float) -> None:
        self.dynamics, self.preview, self.spacing = dynamics, preview, step / PARTS
        self.row_scale = np.ones(dynamics.robot.n)
        self._turning = bool(turning_velocities(dynamics.robot)[dynamics.robot.carrier_velocity].any())
        self._largest = 0.0
        self._clear()

    def _clear(self) -> None:
        self.known = Coefficients(np.empty(0), np.empty(0, dtype=bool), *(np.empty(0) for _ in range(3)))
        self.roots, self.edges = np.empty(0), np.empty(0)

    def look(self, start: float, end: float) -> Array:
        """Go on to a time, s, from a first one; return the singular instants from the first one on, s.

        Where the preview may change its mind, all of it is read anew.
        """
        preview, spacing = self.preview, self.spacing
        start, end = max(start, preview.start), min(end, preview.end)
        if preview.changing or (len(self.edges) and not self.edges[0] <= start <= self.edges[-1] + SAME):
            self._clear()
        seen = self.edges
        past = start - KEPT * PARTS * spacing
        if len(self.known.t) > 2.0 * (end - start) / spacing + 100:
            self.known = self.known.at(self.known.t >= past)
            self.edges = seen = seen[seen >= past]
            self.roots = self.roots[self.roots >= past]
        first = start if not len(seen) else seen[-1]
        grid = spacing * np.arange(np.floor(first / spacing), np.floor(end / spacing + 1e-6) + 1.0)
        new = grid[grid > first + 0.1 * spacing]
        if not len(seen):
            new = np.append(first, new)
        if preview.end - end <= SAME and (not len(new) or new[-1] < end - SAME) and end > first + SAME:
            new = np.append(new, end)  # nothing more will be known
        if len(new):
            places = self.at(new)
            self.edges = np.append(seen, new)
            if self.dynamics.robot.n == self.dynamics.robot.m:
                self._scan(len(new), places)
        return self.roots[self.roots >= start]

    def at(self, times: Array) -> IntArray:
        """Return the places (N,) of instants in ``known``, s; what is missing there is evaluated."""
        while True:
            t = self.known.t
            places = np.searchsorted(t, times - SAME)
            inside = np.minimum(places, len(t) - 1)
            missing = (places >= len(t)) | (t[inside] > times + SAME) if len(t) else np.ones(len(times), dtype=bool)
            if not missing.any():
                return inside
            self._add(np.unique(times[missing]))

    def instants(self, nodes: Array, until: float) -> Array:
        """Return nodes up to a time, s, or the first alone, the instants of the grid, and both sides of jumps of ẍ."""
        nodes = nodes[: max(int((nodes <= until + SAME).sum()), 1)]
        breaks = self.preview.breaks
        breaks = breaks[(breaks > nodes[0] + 2.0 * BESIDE) & (breaks < nodes[-1] - 2.0 * BESIDE)]
        grid = self.spacing * np.arange(np.ceil(nodes[0] / self.spacing), np.ceil(nodes[-1] / self.spacing))
        away = np.abs(grid[:, None] - np.append(nodes, breaks)).min(axis=1) > 0.1 * self.spacing
        return np.unique(np.concatenate([nodes, grid[away], breaks - BESIDE, breaks + BESIDE]))

    def _add(self, times: Array) -> None:
        along = self.dynamics.along(self.preview.motion(times), unreachable="mark")
        first = not len(self.known.t)
        model = turning_model(along) if self._turning else carrier_model(along, check=first)
        if first:
            self.row_scale = along.reduce().row_scale
        own = np.arange(model.k)
        of_f = model.f_terms.transpose(0, 2, 3, 1)
        of_force = np.zeros((*of_f.shape[:3], model.k))
        of_force[:, own, :, own] = model.force_terms.transpose(1, 0, 2)
        read = (
            model.W,
            np.concatenate([model.f0, model.force0], axis=1),
            np.concatenate([of_f, of_force], axis=3),
        )
        reachable: BoolArray = np.asarray(np.isfinite(model.f0).all(axis=1))
        self.known = self.known.merged(Coefficients(times, reachable, *map(np.nan_to_num, read)))

    def _scan(self, count: int, places: IntArray) -> None:
        """Look for singular instants among the last ``count`` edges and the two before."""
        edges = self.edges[-count - 2 :]
        if len(edges) > count:
            places = self.at(edges)
        value = np.linalg.det(self.known.W[places])
        value[~self.known.known[places]] = np.nan
        self._largest = largest = max(self._largest, float(np.nanmax(np.abs(value), initial=0.0)))
        size, sign, zero = np.abs(value), np.sign(value), np.abs(value) <= AT_REST * largest
        brackets = [(a, a + 1) for a in np.flatnonzero((sign[:-1] + sign[1:] == 0.0) & ~zero[:-1] & ~zero[1:])]
        inner = np.arange(1, len(edges) - 1)
        dips = inner[(size[inner] <= size[inner - 1]) & (size[inner] < size[inner + 1]) & (size[inner] < 0.3 * largest)]
        brackets += [(j - 1, j + 1) for j in dips if sign[j - 1] == sign[j + 1]]
        brackets += [(j - 1, j + 1) for j in inner[zero[inner] & ~zero[inner - 1] & ~zero[inner + 1]]]
        for first, last in sorted(set(brackets)):
            roots = self._within(float(edges[first]), float(edges[last]), largest)
            new = roots[~(np.abs(roots[:, None] - self.roots) < 1e-3 * PARTS * self.spacing).any(axis=1)]
            self.roots = np.sort(np.append(self.roots, new))

    def _within(self, start: float, end: float, largest: float) -> Array:
        """Return the instants between two times at which det W is zero, or next to it at a dip, s."""
        times, width = chebyshev_points(np.array([start]), np.array([end]), POINTS - 1), end - start
        W = self.dynamics.along(self.preview.motion(times), unreachable="mark").reduce().W
        if not np.isfinite(W).all():
            return np.empty(0)
        series = Chebyshev.fit(times, np.linalg.det(W) / largest, POINTS - 1, domain=[start, end])
        zeros = series.roots()
        inside = (zeros.real >= start - 1e-9 * width) & (zeros.real <= end + 1e-9 * width)
        crossing = zeros.real[inside & (np.abs(zeros.imag) < 1e-7 * width)]
        if len(crossing):
            return np.asarray(crossing)
        low = series.deriv().roots()
        low = low.real[(np.abs(low.imag) < 1e-7 * width) & (low.real > start) & (low.real < end)]
        touching: Array = low[np.abs(series(low)) < TOUCH]
        return touching


def nodes_from(start: float, step: float, count: int, roots: Array) -> tuple[Array, IntArray]:
    """Return (count,) nodes, s, from a start on a grid that is fixed in time, and which are singular instants.

    A step apart, and from ``NEAR`` steps on two, half as far around singular instants.
    """
    first = np.floor(2.0 * start / step)
    half = np.arange(first, first + 4 * count)
    grid = 0.5 * step * half
    chosen: list[float] = []
    for root in roots[(roots >= start) & (roots <= start + 2.0 * step * count)].tolist():
        if root > start + APART[0] * step and all(root - other > APART[0] * step for other in chosen):
            chosen.append(root)
    apart = np.abs(grid[:, None] - roots).min(axis=1, initial=np.inf)
    far = grid > start + (NEAR + 1e-6) * step
    unit = np.where(far, 2.0, 1.0) * np.where(apart < np.where(far, 2.0, 1.0) * ZONE * step, 1.0, 2.0)
    fixed = np.array([start, *chosen])
    kept = (half % unit == 0.0) & (np.abs(grid[:, None] - fixed).min(axis=1) > APART[1] * step) & (grid > start)
    nodes = np.sort(np.append(fixed, grid[kept]))[:count]
    return nodes, np.flatnonzero(np.isin(nodes, roots))


@dataclass(frozen=True, eq=False)
class Linearised:
    """W τ = f at N nodes, linear about a plan; n coordinates, m main actuators, k carriers.

    Attributes:
        nodes: (N,) s.
        singular: (q,) indices of those that are singular instants.
        known: (N,) whether the motion there is known, and can be reached.
        at: (N, k) s, ṡ, s̈ that all is linear about.
        W: (N, n, m).
        f: (N, n) at that motion, N and N·m.
        slopes: (3, N, n, k) derivatives of f by s, ṡ, s̈.
        force: (N, k) the carriers' forces, N.
        force_slopes: (3, N, k) their derivatives by their own motion.
        lost: (q, n) directions u that W loses.
        W_rate: (q, m) uᵀ Ẇ.
        f_rate: (q,) uᵀ f̄′.
        slope_rates: four (q, k) of uᵀ ḟ, by δs, δṡ, δs̈ and s⃛.
        curvature: (N, k, 3, 3) second derivatives of −yᵀ f by s, ṡ and s̈, with the multipliers y of W τ = f.
        row_scale: (n,) see ``ReducedDynamics``.
        until: s, after which nothing is known.
    """

    nodes: Array
    singular: IntArray
    known: BoolArray
    at: tuple[Array, ...]
    W: Array
    f: Array
    slopes: Array
    force: Array
    force_slopes: Array
    lost: Array
    W_rate: Array
    f_rate: Array
    slope_rates: tuple[Array, ...]
    curvature: Array
    row_scale: Array
    until: float

    @staticmethod
    def about(
        ahead: Ahead, nodes: Array, singular: IntArray, at: tuple[Array, ...], multipliers: Array, until: float
    ) -> Linearised:
        """Return it about a motion of the carriers, three (N, k), and multipliers (N, n) of W τ = f there.

        What is after ``until``, s, is not known.
        """
        q, count, times = len(singular), len(nodes), nodes
        if q:
            shift = np.repeat([-DIFFERENCE, DIFFERENCE], q)
            times = np.concatenate([nodes, np.tile(nodes[singular], 2) + shift])
            s, sd, sdd = (np.tile(part[singular], (2, 1)) for part in at)
            h = shift[:, None]
            beside = (s + h * sd, sd + h * sdd, sdd)  # what is even in h cancels
            whole = tuple(np.concatenate(pair) for pair in zip(at, beside, strict=True))
        else:
            whole = at
        places = ahead.at(np.minimum(times, until))
        coefficients, n = ahead.known, len(ahead.row_scale)
        value, by = coefficients.slopes(places, *whole)
        W, f, by_f = coefficients.W[places], value[:, :n], by[:, :, :n]
        u = np.linalg.svd(W[singular] / ahead.row_scale[:, None])[0][:, :, -1] / ahead.row_scale if q else W[:0, :, 0]

        def rate(values: Array) -> Array:
            change = (values[count + q :] - values[count : count + q]) / (2.0 * DIFFERENCE)
            projected: Array = np.einsum("qn,qn...->q...", u, change)
            return projected

        by_s, by_sd, by_sdd = np.einsum("qn,dqnk->dqk", u, by_f[:, singular])
        own = np.arange(at[0].shape[1])
        s, sd, sdd = at
        curvature = coefficients.curvature(places[:count], s, sd, sdd, -multipliers)
        return Linearised(
            nodes, singular, (nodes <= until + SAME) & np.logical_and.accumulate(coefficients.known[places[:count]]),
            at, W[:count], f[:count], by_f[:, :count], value[:count, n:], by[:, :count, n + own, own], u, rate(W),
            rate(f), (rate(by_f[0]), by_s + rate(by_f[1]), by_sd + rate(by_f[2]), by_sdd), curvature,
            ahead.row_scale, until,
        )  # fmt: skip
