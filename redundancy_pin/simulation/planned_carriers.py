"""The continuous carrier motion that the samples of a plan stand for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, read_only
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.plan import Plan

_STEPPED = {"stepwise": ("optimise", "brake"), "switch_off": ("ramp_down", "off")}
"""Phases of planners whose ṡ and s̈ are backward differences of s."""


@dataclass(frozen=True, eq=False)
class PlannedCarriers:
    """Carrier positions as a polynomial in each step of a plan, continuous with their speeds.

    Attributes:
        edges: (P + 1,) distinct times of the plan, s.
        coefficients: (P, 6, k) of powers of the time since the start of the step, m/s^j.
        lag: (k,) largest distance from the plan's own positions, m: zero but for stepwise plans.
    """

    edges: Array
    coefficients: Array
    lag: Array

    def __call__(self, times: Array) -> CarrierMotion:
        """Return the motion at (N,) times; at a jump of s̈ that after it."""
        piece = np.clip(np.searchsorted(self.edges, times, side="right") - 1, 0, len(self.coefficients) - 1)
        x = (times - self.edges[piece])[:, None]
        parts = []
        series = self.coefficients
        for _ in range(3):
            value = np.zeros((len(times), series.shape[2]))
            for j in range(series.shape[1] - 1, -1, -1):
                value = value * x + series[piece, j]
            parts.append(value)
            series = series[:, 1:] * np.arange(1, series.shape[1])[:, None]
        return CarrierMotion(*parts)


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
    h = (plan.t[right] - plan.t[left])[:, None]
    s, sd, sdd = (np.asarray(part) for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd))
    series = np.zeros((len(left), 6, s.shape[1]))
    series[:, 0], series[:, 1], series[:, 2] = s[left], sd[left], 0.5 * sdd[left]
    if plan.planner == "whole_trajectory":
        series[:, 3] = (sdd[right] - sdd[left]) / (6.0 * h)
    else:
        series[:, 3:] = _quintic(h, (s[left], sd[left], sdd[left]), (s[right], sd[right], sdd[right]))
        stepped = _stepped(plan)[right]
        series[stepped, 2] = 0.5 * sdd[right][stepped]
        series[stepped, 3:] = 0.0
    # what the steps do not make up for is carried on: s is continuous, and exact where no step is of the lagging kind
    reached = (series * h[:, None] ** np.arange(6)[:, None]).sum(axis=1)
    missed = np.cumsum(reached - s[right], axis=0)
    rounding = np.abs(missed) < _ROUNDING
    missed[rounding] = 0.0
    series[1:, 0] += missed[:-1]
    edges = np.append(plan.t[left], plan.t[-1])
    return PlannedCarriers(read_only(edges), read_only(series), read_only(np.abs(missed).max(axis=0, initial=0.0)))


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


def _quintic(h: Array, start: tuple[Array, ...], end: tuple[Array, ...]) -> Array:
    """Return (P, 3, k) the coefficients of the third to fifth power of the quintics through s, ṡ, s̈ at both ends."""
    (s0, v0, a0), (s1, v1, a1) = start, end
    d = s1 - s0 - h * v0 - 0.5 * h * h * a0
    dv, da = h * (v1 - v0 - h * a0), h * h * (a1 - a0)
    c3, c4, c5 = 10.0 * d - 4.0 * dv + 0.5 * da, -15.0 * d + 7.0 * dv - da, 6.0 * d - 3.0 * dv + 0.5 * da
    result: Array = np.stack([c3 / h**3, c4 / h**4, c5 / h**5], axis=1)
    return result
