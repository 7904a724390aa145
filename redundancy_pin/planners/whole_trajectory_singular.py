"""What finite efforts ask of the carriers at an instant at which the actuation matrix lacks rank.

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
from numpy.polynomial import chebyshev

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.kinematics.spectrum import scaled
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import CarrierModel
from redundancy_pin.planners.continuous_motion import ContinuousMotion
from redundancy_pin.planners.piecewise_chebyshev import PiecewiseChebyshev
from redundancy_pin.planners.timed_model import TimedModel
from redundancy_pin.planners.whole_trajectory_local import local_rate
from redundancy_pin.trajectory import Side

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
        rate = replace(model, interpolant=_derivative(model.interpolant)).at(np.array([t]), side)
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


def _derivative(interpolant: PiecewiseChebyshev) -> PiecewiseChebyshev:
    slopes = chebyshev.chebder(interpolant.coefficients, axis=1)
    slopes = slopes * (2.0 / np.diff(interpolant.edges))[:, None, None]
    return PiecewiseChebyshev(interpolant.edges, read_only(slopes))
