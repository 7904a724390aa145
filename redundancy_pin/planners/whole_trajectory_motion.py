"""Carriers with piecewise linear acceleration: exact between the nodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.motion import CarrierMotion


@dataclass(frozen=True, eq=False)
class CarrierCourse:
    """Motion of the carriers over M nodes, s̈ linear between two of them.

    Attributes:
        t: (M,) times, s; a time that occurs twice has two accelerations.
        s, sd, sdd: (M, k) position, m, and its rates.
    """

    t: Array
    s: Array
    sd: Array
    sdd: Array

    def at_nodes(self) -> CarrierMotion:
        """Return the motion at the nodes."""
        return CarrierMotion(self.s, self.sd, self.sdd)

    def inside(self, parts: int) -> tuple[Array, CarrierMotion]:
        """Return times and motion on a grid ``parts`` times as fine, jumps twice."""
        fraction = np.arange(parts) / parts
        left = np.flatnonzero(np.diff(self.t) > 0.0)
        step = np.repeat(left, parts)
        own = np.tile(fraction, len(left))
        # the last node, and the first of the two at each jump, are not the start of a step
        ends = np.flatnonzero(np.append(np.diff(self.t) == 0.0, True))
        at = np.concatenate([step, np.maximum(ends - 1, 0)])
        share = np.concatenate([own, np.ones(len(ends))])
        order = np.lexsort((share, at))
        times = np.where(share == 1.0, self.t[at + 1], self.t[at] + share * np.diff(self.t)[at])
        return times[order], self._inside(at[order], share[order])

    def _inside(self, step: IntArray, fraction: Array) -> CarrierMotion:
        h = np.diff(self.t)[step, None]
        x = fraction[:, None] * h
        jerk = np.diff(self.sdd, axis=0)[step] / h
        s, sd, sdd = self.s[step], self.sd[step], self.sdd[step]
        return CarrierMotion(
            s + x * (sd + x * (sdd / 2.0 + x * jerk / 6.0)), sd + x * (sdd + x * jerk / 2.0), sdd + x * jerk
        )

    def ranges(self) -> tuple[Array, Array, Array, Array]:
        """Return the exact least and largest s and ṡ in every step, (M − 1, k) each: least s, largest s, then ṡ."""
        h = np.diff(self.t)[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            jerk = np.where(h > 0.0, np.diff(self.sdd, axis=0) / h, 0.0)
            sd, sdd = self.sd[:-1], self.sdd[:-1]
            stationary = -sdd / jerk
            # ṡ = 0, from the root that does not cancel
            q = -0.5 * (sdd + np.copysign(np.sqrt(sdd**2 - 2.0 * jerk * sd), sdd))
            turns = [2.0 * q / jerk, sd / q]
        ends = [np.zeros_like(jerk), np.broadcast_to(h, jerk.shape)]
        found = []
        for name, inner in (("s", turns), ("sd", [stationary])):
            at = np.stack([*ends, *(np.clip(np.nan_to_num(x, nan=0.0), 0.0, h) for x in inner)])
            speeds = sd + at * (sdd + at * jerk / 2.0)
            values = self.s[:-1] + at * (sd + at * (sdd / 2.0 + at * jerk / 6.0)) if name == "s" else speeds
            found += [values.min(axis=0), values.max(axis=0)]
        return found[0], found[1], found[2], found[3]

    def at(self, times: Array) -> CarrierMotion:
        """Return the motion at (N,) times, after the jump where one falls on a jump."""
        step = np.clip(np.searchsorted(self.t, times, side="right") - 1, 0, len(self.t) - 2)
        while (zero := self.t[step + 1] == self.t[step]).any():
            step = step - zero
        return self._inside(step, (times - self.t[step]) / (self.t[step + 1] - self.t[step]))
