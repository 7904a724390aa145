"""Nodes of one tick, and W τ = f there, linear in the carriers' motion about the last plan.

At a singular instant uᵀ W = 0, and τ is what W⁻¹ f tends to: uᵀ Ẇ τ = uᵀ ḟ, with the jerk of the step before and with
that of the step after. With f linear, f = f̄ + F_s δs + F_ṡ δṡ + F_s̈ δs̈, and ′ the derivative by time along the motion
that continues s̄ without jerk,

    ḟ = f̄′ + F_s′ δs + (F_s + F_ṡ′) δṡ + (F_ṡ + F_s̈′) δs̈ + F_s̈ s⃛.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion, ReducedDynamics
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.receding_horizon.preview import Preview
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

DIFFERENCE = 1e-4
"""For derivatives by time at singular instants, s: central differences, off by its square."""

ZONE = 2.5
"""Steps around a singular instant in which the nodes are half as far apart: a step in s̈ there makes τ swing."""

APART = 0.05, 0.2, 0.3
"""Least distances, in steps, of singular instants, of the nodes around them and of the others from any other node."""

INSIDE = 4
"""Parts of the first steps at whose ends the efforts of the plan are evaluated exactly."""

FIRST = 3
"""Number of those steps."""


def nodes_from(start: float, step: float, count: int, roots: Array) -> tuple[Array, IntArray]:
    """Return (count,) nodes, s, from a start on a grid that is fixed in time, and which are singular instants."""
    end = start + step * count
    fine = 0.5 * step * np.arange(np.ceil(2.0 * start / step), np.floor(2.0 * end / step) + 1)
    around = np.abs(fine[:, None] - roots).min(axis=1, initial=np.inf) < ZONE * step
    roots = roots[(roots >= start) & (roots <= end)]
    kept = [start]
    for candidates, apart in zip((roots, fine[around], fine), APART, strict=True):
        if apart == APART[2]:
            candidates = candidates[np.rint(2.0 * candidates / step) % 2 == 0]
        for t in candidates.tolist():
            if t > start and min(abs(t - other) for other in kept) > apart * step:
                kept.append(t)
    nodes = np.sort(kept)[:count]
    return nodes, np.flatnonzero(np.isin(nodes, roots))


def extended(position: PiecewisePolynomial, times: Array) -> CarrierMotion:
    """Return the carriers of a plan at (N,) times, of which some may lie after its end: they are held there."""
    motion = carriers_at(position, times)
    after = times > position.end
    rates = np.where(after[:, None], 0.0, motion.sd), np.where(after[:, None], 0.0, motion.sdd)
    return CarrierMotion(motion.s, *rates, check_rates=False)


@dataclass(frozen=True, eq=False)
class Linearised:
    """Coefficients at N nodes; n coordinates, m main actuators, k carriers.

    Attributes:
        nodes: (N,) s.
        singular: (q,) indices of those that are singular instants.
        known: (N,) whether the motion there is known, and can be reached.
        at: the carriers' motion that all is linear about.
        W: (N, n, m).
        f: (N, n) at that motion, N and N·m.
        slopes: three (N, n, k) derivatives of f by s, ṡ, s̈.
        force: (N, k) the carriers' forces, N.
        force_slopes: three (N, k, k) their derivatives.
        lost: (q, n) directions u that W loses.
        W_rate: (q, m) uᵀ Ẇ.
        f_rate: (q,) uᵀ f̄′.
        slope_rates: four (q, k) of uᵀ ḟ, by δs, δṡ, δs̈ and s⃛.
        row_scale: (n,) see ``ReducedDynamics``.
        along: dynamics at the nodes and beside them, in order of time; ``places`` (N,) are the nodes there, and
            ``inside`` the instants of the first steps, nodes included.
    """

    nodes: Array
    singular: IntArray
    known: BoolArray
    at: CarrierMotion
    W: Array
    f: Array
    slopes: tuple[Array, ...]
    force: Array
    force_slopes: tuple[Array, ...]
    lost: Array
    W_rate: Array
    f_rate: Array
    slope_rates: tuple[Array, ...]
    row_scale: Array
    along: DynamicsAlongMotion
    places: IntArray
    inside: IntArray

    @staticmethod
    def about(dynamics: Dynamics, preview: Preview, nodes: Array, singular: IntArray, at: CarrierMotion) -> Linearised:
        """Read the coefficients off a backend: its kinematics are solved once, its dynamics and their slopes once."""
        q, count, shift = len(singular), len(nodes), np.repeat([-DIFFERENCE, DIFFERENCE], len(singular))[:, None]
        parts = np.arange(1, INSIDE) / INSIDE
        inner = (nodes[:FIRST, None] + np.diff(nodes[: FIRST + 1])[:, None] * parts).ravel()
        times = np.concatenate([nodes, nodes[np.tile(singular, 2)] + shift[:, 0], inner])
        times, order = np.unique(np.minimum(times, preview.end), return_inverse=True)
        beside = [np.tile(part[singular], (2, 1)) for part in (at.s, at.sd, at.sdd)]
        s, sd, sdd = (
            beside[0] + shift * beside[1] + 0.5 * shift**2 * beside[2],
            beside[1] + shift * beside[2],
            beside[2],
        )
        place = order[: count + 2 * q]
        motion = []
        for own, other in ((at.s, s), (at.sd, sd), (at.sdd, sdd)):
            part = np.zeros((len(times), at.s.shape[1]))
            part[place] = np.concatenate([own, other])
            motion.append(part)
        along = dynamics.along(preview.motion(times), unreachable="mark")
        carriers = CarrierMotion(*motion, check_rates=False)
        reduced, slopes = along.reduce(carriers), along.carrier_derivatives(carriers)
        reachable = np.asarray(reduced.reachable)[place[:count]]
        known = (nodes <= preview.end) & np.logical_and.accumulate(reachable)
        names = ("f_s", "f_sd", "f_sdd", "force_s", "force_sd", "force_sdd")
        W, f, force, *by = (
            np.nan_to_num(np.asarray(part)[place])
            for part in (reduced.W, reduced.f, reduced.carrier_force, *(getattr(slopes, name) for name in names))
        )
        u = np.linalg.svd(W[singular] / reduced.row_scale[:, None])[0][:, :, -1] / reduced.row_scale

        def rate(values: Array) -> Array:
            change = (values[count + q :] - values[count : count + q]) / (2.0 * DIFFERENCE)
            projected: Array = np.einsum("qn,qn...->q...", u, change)
            return projected

        by_s, by_sd, by_sdd = (np.einsum("qn,qnk->qk", u, part[singular]) for part in by[:3])
        slope_rates = rate(by[0]), by_s + rate(by[1]), by_sd + rate(by[2]), by_sdd
        return Linearised(
            nodes, singular, known, at, W[:count], f[:count], tuple(part[:count] for part in by[:3]), force[:count],
            tuple(part[:count] for part in by[3:]), u, rate(W), rate(f), slope_rates, reduced.row_scale, along,
            place[:count], np.unique(np.append(order[: FIRST + 1], order[count + 2 * q :])),
        )  # fmt: skip

    def of_plan(self, position: PiecewisePolynomial) -> ReducedDynamics:
        """Return the dynamics of a plan at all instants of ``along``, exactly."""
        return self.along.reduce(extended(position, self.along.motion.t))
