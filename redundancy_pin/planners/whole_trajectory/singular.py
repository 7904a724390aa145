"""f to second order around a motion of the carriers, in the form of a ``CarrierModel`` and two more terms.

What finite efforts ask of the carriers at an instant at which the actuation matrix lacks rank.

At a singular instant t* there are directions u with uᵀ W = 0. Then W τ = f asks for uᵀ f = 0, whatever τ is
(compatibility), and leaves the part of τ in the null space of W open. Differentiating W τ = f in time and projecting
on u closes that gap, since uᵀ W τ̇ = 0:

    uᵀ Ẇ τ = uᵀ ḟ,    ḟ = ∂f/∂t + ∂f/∂s ṡ + ∂f/∂ṡ s̈ + ∂f/∂s̈ s⃛.

Where the motion crosses the singularity with a rate, (W; uᵀ Ẇ) has full rank, and both equations together give the one
τ that W⁻¹ f tends to. The jerk of the carriers enters: that it is the same on both sides makes the limit so.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.kinematics.spectrum import scaled
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import TERMS, CarrierModel, TimedModel
from redundancy_pin.trajectory import Side
from redundancy_pin.trajectory.functions_of_time import ContinuousMotion

S, SD, SDD = 0, 2, 4
"""Places of s, ṡ and s̈ among the terms."""

APART = 1e-3
"""Distance of the times from which derivatives are formed, s, where the motion is smooth for so long."""

STEP = 1e-4
"""Of the differences of the exact derivatives, m or rad, and per second: second derivatives to 1e-8 of themselves."""

_CENTRAL = ((-2.0, 1.0 / 12.0), (-1.0, -2.0 / 3.0), (1.0, 2.0 / 3.0), (2.0, -1.0 / 12.0))
"""Offsets and weights of a derivative of order four."""

_AHEAD = ((1.0, -77.0 / 12.0), (2.0, 107.0 / 6.0), (3.0, -39.0 / 2.0), (4.0, 61.0 / 6.0), (5.0, -25.0 / 12.0))
"""The same from one side, where the other is another piece of the motion."""


def local_model(along: DynamicsAlongMotion, carriers: CarrierMotion) -> tuple[CarrierModel, Array]:
    """Fit around a motion of the carriers, with the exact derivatives of a backend and differences of them.

    f is affine in s̈ and, to second order, a sum over the carriers. The force of a carrier is fitted to first order in
    its own motion; what the others do to it is taken as it is.

    Args:
        along: dynamics along a platform motion, N samples.
        carriers: motion to fit around, N samples.

    Returns:
        The model, and (N, n, k, 2) the coefficients of f by ṡ² and s s̈.
    """
    model = _first_order(along, carriers)
    s, sd, sdd = carriers.s, carriers.sd, carriers.sdd

    def difference(ds: float, dsd: float) -> tuple[Array, Array, Array]:
        slopes = [along.carrier_derivatives(CarrierMotion(s + sign * ds, sd + sign * dsd, sdd)) for sign in (1.0, -1.0)]
        step = 2.0 * (ds + dsd)
        first, second, third = (
            (getattr(slopes[0], name) - getattr(slopes[1], name)) / step for name in ("f_s", "f_sd", "f_sdd")
        )
        return first, second, third

    ss, ssd, ssdd = difference(STEP, 0.0)
    sdsd = difference(0.0, STEP)[1]
    f0, f_terms = np.array(model.f0), np.array(model.f_terms)
    f0 += np.einsum("nik,nk->ni", 0.5 * ss, s**2) + np.einsum("nik,nk->ni", ssd, s * sd)
    f0 += np.einsum("nik,nk->ni", 0.5 * sdsd, sd**2) + np.einsum("nik,nk->ni", ssdd, s * sdd)
    at_s, at_sd, at_sdd = (part[:, None, :] for part in (s, sd, sdd))
    f_terms[..., S] -= ss * at_s + ssd * at_sd + ssdd * at_sdd
    f_terms[..., SD] -= ssd * at_s + sdsd * at_sd
    f_terms[..., SDD] -= ssdd * at_s
    f_terms[..., 1], f_terms[..., 3] = 0.5 * ss, ssd
    whole = replace(model, f0=read_only(f0), f_terms=read_only(f_terms))
    return whole, read_only(np.stack([0.5 * sdsd, ssdd], axis=-1))


def _first_order(along: DynamicsAlongMotion, carriers: CarrierMotion) -> CarrierModel:
    reduced, slopes = along.reduce(carriers), along.carrier_derivatives(carriers)
    n, k = reduced.f.shape[1], along.robot.k
    f_terms, force_terms = np.zeros((len(carriers.s), n, k, TERMS)), np.zeros((len(carriers.s), k, TERMS))
    for place, by, force_by in (
        (S, slopes.f_s, slopes.force_s),
        (SD, slopes.f_sd, slopes.force_sd),
        (SDD, slopes.f_sdd, slopes.force_sdd),
    ):
        f_terms[..., place] = by
        force_terms[..., place] = np.diagonal(force_by, axis1=1, axis2=2)
    at = np.stack([carriers.s, 0.0 * carriers.s, carriers.sd, 0.0 * carriers.s, carriers.sdd], axis=-1)
    f0 = np.asarray(reduced.f) - np.einsum("nikj,nkj->ni", f_terms, at)
    force0 = np.asarray(reduced.carrier_force) - np.einsum("nkj,nkj->nk", force_terms, at)
    return CarrierModel(along.motion.t, reduced.W, *(read_only(part) for part in (f0, f_terms, force0, force_terms)))


def local_rate(
    dynamics: Dynamics, source: ContinuousMotion, t: float, carriers: CarrierMotion, side: Side
) -> CarrierModel:
    """Return derivatives by time of the first-order coefficients, the motion they are fitted around held fixed.

    Args:
        dynamics: a backend.
        source: the platform motion.
        t: the instant, s.
        carriers: what to fit around, one sample.
        side: from which, where the motion has a jump or kink at ``t``.
    """
    kinks = np.concatenate([[source.start, source.end], source.breaks, source.knots if source.exact else []])
    away = np.abs(kinks - t)
    apart = float(away[away > 0.0].min())
    if (away == 0.0).any():
        sign = 1.0 if t == source.start or (side == "right" and t < source.end) else -1.0
        # times have to increase on the left as well
        offsets, weights = (sign * np.array(part)[:: int(sign)] for part in zip(*_AHEAD, strict=True))
        apart = min(APART, 0.19 * apart)
    else:
        offsets, weights = (np.array(part) for part in zip(*_CENTRAL, strict=True))
        apart = min(APART, 0.49 * apart)
    repeated = CarrierMotion(
        *(np.repeat(part, len(offsets), axis=0) for part in (carriers.s, carriers.sd, carriers.sdd))
    )
    model = _first_order(dynamics.along(source.sample_at(t + apart * offsets)), repeated)

    def derivative(values: Array) -> Array:
        slope: Array = np.einsum("n,n...->...", weights / apart, values)[None]
        return read_only(slope)

    parts = (model.W, model.f0, model.f_terms, model.force0, model.force_terms)
    return CarrierModel(np.array([t]), *(derivative(part) for part in parts))


LOST = 1e-6
"""Singular values below this fraction of the largest are lost at a singular instant; one that is only touched is known
to the square root of rounding."""


CROSSED = 1e-3
"""Change of the vanishing singular value over the whole motion, at its rate at the singular instant and relative to the
largest, from which the singularity is crossed. A touch leaves what rounding makes of it, 1e-6; on the circle of the
2-RPR it is 4."""


@dataclass(frozen=True, eq=False)
class SingularNode:
    """A node on a type II singularity; r directions are lost.

    Attributes:
        index: its number among the nodes.
        t: time, s.
        lost: (r, n) rows u with u W = 0.
        rate: time derivatives of the coefficients of W, f and the carrier forces, one sample.
    """

    index: int
    t: float
    lost: Array
    rate: CarrierModel


def singular_node(
    dynamics: Dynamics,
    source: ContinuousMotion,
    index: int,
    t: float,
    half_width: float,
    around: CarrierMotion | None = None,
    side: Side = "right",
) -> SingularNode:
    """Read the derivatives of the model at a singular instant off a backend.

    Args:
        dynamics: either backend.
        source: the platform motion.
        index: number of the node.
        t: the instant, s.
        half_width: the model is interpolated over so much time on both sides of it, s.
        around: for carriers on curved tracks, the motion (one sample) around which the model is fitted.
        side: from which the derivatives are taken; "left" for the node before a jump of the reference acceleration.

    Raises:
        UnsupportedRobotError: see ``carrier_model``.
        InfeasiblePlanError: the motion touches the singularity, rests in it or stays in it: (W; uᵀ Ẇ) lacks rank.
    """
    if around is None:
        model = TimedModel.of(dynamics, source, max(source.start, t - half_width), min(source.end, t + half_width))
        rate = replace(model, interpolant=model.interpolant.derivative()).at(np.array([t]), side)
    else:
        rate = local_rate(dynamics, source, t, around, side)
    reduced = dynamics.along(source.sample_at(np.array([t]))).reduce()
    A = scaled(reduced.W, reduced.row_scale, reduced.column_scale)[0]
    u, values, v = np.linalg.svd(A)
    size = float(values[0])
    if len(values) == 1:  # the only one vanishes: it is small beside what it is elsewhere
        usual = dynamics.along(source.sample_at(_spread(source))).reduce()
        size = float(np.linalg.norm(scaled(usual.W, usual.row_scale, usual.column_scale), axis=(1, 2)).max())
    kept = int((values > LOST * size).sum())
    turning = scaled(rate.W, reduced.row_scale, reduced.column_scale)[0]
    _require_crossing(u[:, kept:].T @ turning @ v[kept:].T / size, source, t)
    lost = u[:, kept:].T / reduced.row_scale
    return SingularNode(index, t, read_only(lost), rate)


def _require_crossing(rate: Array, source: ContinuousMotion, t: float) -> None:
    """Check that the singular values that vanish do so at a rate; ``rate`` (r, r or more), 1/s, is that of W there."""
    slowest = float(np.linalg.svd(rate, compute_uv=False)[-1]) if rate.size else 0.0
    changed = slowest * (source.end - source.start)
    if changed > CROSSED:
        return
    motion = source.sample_at(np.array([t]))
    speed, most = float(np.abs(motion.xd).max()), float(np.abs(source.sample_at(_spread(source)).xd).max())
    how = "rests in" if speed <= CROSSED * most else "touches, or follows,"
    raise InfeasiblePlanError(
        f"At t = {t:.6g} s the motion {how} a type II singularity without crossing it: what f and its rate say there "
        "does not determine the efforts, and no condition on s, ṡ and s̈ keeps them finite beside it.",
        remedy="Lead the motion across the singularity with a speed, or keep a distance from it.",
        constraint="singular_touch",
        time=t,
        amount=changed,
        at_rest=speed <= CROSSED * most,
    )


def _spread(source: ContinuousMotion) -> Array:
    times: Array = np.linspace(source.start, source.end, 101)
    return times
