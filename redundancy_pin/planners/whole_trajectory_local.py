"""f to second order around a motion of the carriers, in the form of a ``CarrierModel`` and two more terms."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import TERMS, CarrierModel
from redundancy_pin.planners.continuous_motion import ContinuousMotion
from redundancy_pin.trajectory import Side

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
