"""What is known of the platform's motion ahead, and where it meets type II singularities."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np
from numpy.polynomial import Chebyshev

from redundancy_pin.arrays import Array, Frozen, require_type
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion, TimedTrajectory, continuous_motion, is_timed
from redundancy_pin.trajectory.functions_of_time import chebyshev_points

Source: TypeAlias = "Preview | TimedTrajectory | PlatformMotion | ContinuousMotion | Callable[[Array], PlatformMotion]"
"""A trajectory, samples, or what returns the motion at (N,) times, s."""

SCAN = 4
"""Instants a step at which det W is looked at: two crossings closer than that show as a dip."""

POINTS = 13
"""At which det W is evaluated around a change of its sign, for its polynomial."""

TOUCH = 1e-3
"""|det W| at a dip, relative to the largest, below which the motion counts as touching the singularity."""

STILL = 1e-9
"""Speed at the end of a motion, over its largest, up to which the platform rests there."""

FOR_EVER = 1e6
"""How long it is held there, s."""

SAME = 1e-9
"""Times that differ by less are one, s."""

AT_REST = 1e-9
"""Fraction of the largest |det W| below which it counts as zero: motions that stop there."""


@dataclass(frozen=True, eq=False)
class Preview(Frozen):
    """The platform's motion ahead.

    Attributes:
        motion: returns the motion at (N,) increasing times, s.
        start, end: between which it is known, s; a trajectory that ends at rest is held after its end.
        changing: whether ``motion`` may answer otherwise when asked again.
    """

    motion: Callable[[Array], PlatformMotion]
    start: float
    end: float
    changing: bool = False
    scanned: _Scanned = field(default_factory=lambda: _Scanned(), repr=False)

    @staticmethod
    def of(source: Source) -> Preview:
        """Return a preview of a trajectory, of samples, or of a function of (N,) times, which may change its mind.

        Raises:
            InputError: none of these.
        """
        if isinstance(source, Preview):
            return source
        if isinstance(source, (ContinuousMotion, PlatformMotion)) or is_timed(source):
            known = source if isinstance(source, ContinuousMotion) else continuous_motion(source)
            ends = known.sample_at(np.linspace(known.start, known.end, 9)).xd
            rests = np.abs(ends[-1]).max() <= STILL * np.abs(ends).max()
            polynomials = replace(known, source=known.polynomials)
            prolonged = polynomials.prolonged_until(known.end + FOR_EVER) if rests else polynomials
            return Preview(prolonged.sample_at, known.start, prolonged.end)
        if callable(source):
            return Preview(_answers(source), -np.inf, np.inf, changing=True)
        raise InputError(
            f"The preview is {type(source).__name__}.",
            remedy="Pass a trajectory, a PlatformMotion, or a function from (N,) times to a PlatformMotion.",
        )

    def singular_instants(self, dynamics: Dynamics, start: float, end: float, step: float) -> Array:
        """Return the instants between two times at which det W changes its sign or touches zero, s.

        Where the motion does not change its mind, each stretch is looked at once.
        """
        if dynamics.robot.n != dynamics.robot.m:
            return np.empty(0)
        seen, start, end = self.scanned, max(start, self.start), min(end, self.end)
        if not end > start:
            return np.empty(0)
        if self.changing or not seen.start <= start <= seen.end:
            seen.start, seen.end, seen.roots = start, start, np.empty(0)
        if end > seen.end:
            # whole pieces on a grid of their own, so that a stretch is never too short to tell
            edges = np.linspace(seen.end, end, max(int(np.ceil((end - seen.end) * SCAN / step)), 2) + 1)
            before = edges[0] - (edges[1] - edges[0])
            if before >= max(self.start, start if self.changing else -np.inf) and seen.end > seen.start:
                edges = np.append(before, edges)  # a dip at the seam
            new = _roots(lambda times: self.determinant(dynamics, times), edges, seen)
            new = new[~(np.abs(new[:, None] - seen.roots) < 1e-3 * step).any(axis=1)]
            seen.roots, seen.end = np.sort(np.append(seen.roots, new)), end
        return seen.roots[(seen.roots >= start) & (seen.roots <= end)]

    def determinant(self, dynamics: Dynamics, times: Array) -> Array:
        """Return det W (N,) at (N,) increasing times, s."""
        reduced = dynamics.along(self.motion(times), unreachable="mark").reduce()
        determinant = np.full(len(times), np.nan)
        determinant[reduced.reachable] = np.linalg.det(reduced.W[reduced.reachable])
        return determinant


def _answers(source: Callable[[Array], PlatformMotion]) -> Callable[[Array], PlatformMotion]:
    """Return a function of times whose answers are looked at: a motion, at these times."""

    def answer(times: Array) -> PlatformMotion:
        motion = source(times)
        require_type(motion, PlatformMotion, "A PlatformMotion of the preview", "Return one at the times asked for.")
        if len(motion.t) != len(times) or np.abs(motion.t - times).max() > SAME:
            raise InputError(
                f"The preview was asked for {len(times)} instants from t = {times[0]:.6g} s on, and answers for "
                f"{len(motion.t)} from {motion.t[0]:.6g} s on.",
                remedy="Return the motion at the times that are passed.",
            )
        return motion

    return answer


@dataclass(eq=False)
class _Scanned:
    """How far det W has been looked at, what was met, and its largest magnitude so far."""

    start: float = 0.0
    end: float = -1.0
    roots: Array = field(default_factory=lambda: np.empty(0))
    largest: float = 0.0


def _roots(determinant: Callable[[Array], Array], edges: Array, seen: _Scanned) -> Array:
    value = determinant(edges)
    seen.largest = largest = max(seen.largest, float(np.nanmax(np.abs(value), initial=0.0)))
    size, zero = np.abs(value), np.abs(value) <= AT_REST * largest
    brackets = [(a, a + 1) for a in np.flatnonzero((value[:-1] * value[1:] < 0.0) & ~zero[:-1] & ~zero[1:])]
    inner = np.arange(1, len(edges) - 1)
    dips = inner[(size[inner] <= size[inner - 1]) & (size[inner] < size[inner + 1]) & (size[inner] < 0.3 * largest)]
    brackets += [(j - 1, j + 1) for j in dips if value[j - 1] * value[j + 1] > 0.0]
    brackets += [(j - 1, j + 1) for j in inner[zero[inner] & ~zero[inner - 1] & ~zero[inner + 1]]]
    if not brackets:
        return np.empty(0)
    ordered = sorted(set(brackets))
    roots: list[float] = []
    for first, last in ordered:
        times = chebyshev_points(edges[[first]], edges[[last]], POINTS - 1)
        series = Chebyshev.fit(times, determinant(times) / largest, POINTS - 1, domain=edges[[first, last]])
        width = edges[last] - edges[first]
        zeros = series.roots()
        inside = (zeros.real >= edges[first] - 1e-9 * width) & (zeros.real <= edges[last] + 1e-9 * width)
        crossing = zeros.real[inside & (np.abs(zeros.imag) < 1e-7 * width)]
        if len(crossing):
            roots += crossing.tolist()
            continue
        low = series.deriv().roots()
        low = low.real[(np.abs(low.imag) < 1e-7 * width) & (low.real > edges[first]) & (low.real < edges[last])]
        roots += [float(t) for t in low if abs(series(t)) < TOUCH]
    return np.unique(roots)
