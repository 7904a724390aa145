"""The continuous motion that the samples of a plan stand for: platform, carriers, and when actuators are off.

Whoever plays a plan back, ``reference`` for this package's own simulation or ``engines.drive`` for an outside engine,
asks here, so that one plan is one motion.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import PPoly

from redundancy_pin.arrays import Array, BoolArray, read_only
from redundancy_pin.errors import InputError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.continuous_motion import ContinuousMotion, TimedTrajectory, continuous_motion, quintics
from redundancy_pin.planners.plan import Plan

_STEPPED = {"stepwise": ("optimise", "brake"), "switch_off": ("ramp_down", "off")}
"""Phases of planners whose ṡ and s̈ are backward differences of s."""


@dataclass(frozen=True, eq=False)
class PlannedCarriers:
    """Carrier positions as a polynomial in each step of a plan, continuous with their speeds.

    Attributes:
        edges: (P + 1,) distinct times of the plan, s.
        s, sd, sdd: position, m, speed and acceleration (k,) as piecewise polynomials of time; at a jump of s̈ that
            after it.
        lag: (k,) largest distance from the plan's own positions, m: zero but for stepwise plans.
    """

    edges: Array
    s: PPoly
    sd: PPoly
    sdd: PPoly
    lag: Array

    def __call__(self, times: Array) -> CarrierMotion:
        """Return the motion at (N,) times; at a jump of s̈ that after it."""
        return CarrierMotion(self.s(times), self.sd(times), self.sdd(times))


def planned_carriers(plan: Plan) -> PlannedCarriers:
    """Return the continuous motion of the carriers of a plan.

    - Whole-trajectory plans: s̈ is linear in each step, as they were planned.
    - Steps of stepwise plans (and of switch-off plans by backward differences): s̈ is constant and has the plan's value
      at the end of the step; ṡ meets the plan's at every sample. s, integrated, lags behind the plan's by up to half a
      step, because backward differences move a carrier by its new speed. The lag is carried on, so that s stays
      continuous.
    - Everything else: the quintic through s, ṡ and s̈ at both ends, off by O(Δt⁴) in s̈.
    """
    left = np.flatnonzero(np.diff(plan.t) > 0.0)
    right = left + 1
    edges = np.append(plan.t[left], plan.t[-1])
    h = np.diff(edges)[:, None]
    s, sd, sdd = (np.asarray(part) for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd))
    if plan.planner == "whole_trajectory":
        jerk = (sdd[right] - sdd[left]) / h
        powers = np.stack([jerk / 6.0, 0.5 * sdd[left], sd[left], s[left]])
    else:
        ends = [(s[i], sd[i], sdd[i]) for i in (left, right)]
        powers = PPoly.from_bernstein_basis(quintics(edges, *ends)).c
        stepped = _stepped(plan)[right]
        powers[:3, stepped] = 0.0
        powers[3, stepped] = 0.5 * sdd[right][stepped]
    # what the steps do not make up for is carried on: s is continuous, and exact where no step is of the lagging kind
    reached = (powers * h ** np.arange(len(powers) - 1.0, -1.0, -1.0)[:, None, None]).sum(axis=0)
    missed = np.cumsum(reached - s[right], axis=0)
    missed[np.abs(missed) < _ROUNDING] = 0.0
    powers[-1, 1:] += missed[:-1]
    position = PPoly(powers, edges)
    lag = read_only(np.abs(missed).max(axis=0, initial=0.0))
    return PlannedCarriers(read_only(edges), position, position.derivative(), position.derivative(2), lag)


def planned_platform(plan: Plan, trajectory: TimedTrajectory | None = None) -> ContinuousMotion:
    """Return the platform motion of a plan; where its carriers move on longer, the platform is held at its end.

    Args:
        plan: the plan.
        trajectory: the platform motion it was made for; quintics between the plan's samples when left out.

    Raises:
        InputError: the trajectory is not that of the plan.
    """
    source = continuous_motion(plan.motion if trajectory is None else trajectory)
    slack = _SAME_TIME * float(plan.t[-1] - plan.t[0])
    after = plan.t > source.end + slack
    if abs(source.start - plan.t[0]) > slack or source.end > plan.t[-1] + slack or plan.motion.xd[after].any():
        raise InputError(
            f"The plan runs from {plan.t[0]:.9g} to {plan.t[-1]:.9g} s, the trajectory to {source.end:.9g} s.",
            remedy="Pass the trajectory the plan was made for.",
        )
    if not after.any():
        return source
    last, end = source.sample_at(np.array([source.end])), source.end

    def held(times: Array) -> PlatformMotion:
        moving = source.sample_at(times[times <= end])
        count = len(times) - len(moving.t)
        still = np.zeros((count, plan.motion.xd.shape[1]))
        return PlatformMotion(
            times,
            np.concatenate([moving.x, np.repeat(last.x, count, axis=0)]),
            np.concatenate([moving.xd, still]),
            np.concatenate([moving.xdd, still]),
        )

    return replace(source, end=float(plan.t[-1]), breaks=read_only(np.append(source.breaks, end)), sample_at=held)


def smooth_pieces(carriers: PlannedCarriers, platform: ContinuousMotion) -> Array:
    """Return (P + 1,) times, s, between which both motions of a plan are smooth: its samples, breaks and knots."""
    edges = np.concatenate([carriers.edges, platform.breaks, platform.knots])
    return apart(edges[(edges >= carriers.edges[0]) & (edges <= carriers.edges[-1])])


def apart(times: Array) -> Array:
    """Return times in order, those that differ from the one before by rounding left out, the first and last kept."""
    edges = np.unique(times)
    kept = np.append(np.diff(edges) > 1e-10 * (edges[-1] - edges[0]), True)
    kept[0] = True
    result: Array = edges[kept]
    return result


def actuators_off(plan: Plan, edges: Array) -> BoolArray:
    """Return (P,) the pieces between (P + 1,) edges, s, inside which a plan has its main actuators off.

    There its samples at both ends have no effort, one of them at least in the phase that is called so, and W τ = f of
    the planned motion holds with τ = 0 up to the plan's own residual: W⁻¹ f would magnify that. Two samples without
    effort alone do not say it: between two samples at rest there may be a motion that needs efforts.
    """
    after = np.searchsorted(plan.t, 0.5 * (edges[:-1] + edges[1:]))
    zero = (plan.tau == 0.0).all(axis=1)
    named = np.isin(plan.phase, [i for i, name in enumerate(plan.phases) if name == _OFF])
    off: BoolArray = zero[after - 1] & zero[after] & (named[after - 1] | named[after])
    return off


_OFF = "off"
"""Name of the phase in which a plan has its main actuators off."""

_SAME_TIME = 1e-9
"""How far, relative to the duration, plan and trajectory may differ in their times."""

_ROUNDING = 1e-13
"""m; less is no lag."""


def _stepped(plan: Plan) -> BoolArray:
    """Return (N,) whether the step that ends at a sample is one of backward differences."""
    names = _STEPPED.get(plan.planner, ())
    if plan.planner == "switch_off" and plan.parameters.get("scheme") != "backward_differences":
        names = ()
    codes = [i for i, name in enumerate(plan.phases) if name in names]
    stepped: BoolArray = np.isin(plan.phase, codes)
    return stepped
