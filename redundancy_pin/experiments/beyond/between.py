"""The thesis's plans between their samples, by the same measure as the dense check of the whole-trajectory plans."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import BPoly

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise.report import between_samples
from redundancy_pin.trajectory import Trajectory

FINER = 20
"""Points in a step, as in the dense check."""

_SWITCH_OFF = 5
"""The same for switch-off plans, whose samples are 1 ms apart: a fifth of the nodes' 5 ms."""


def peak_of_switch_off(dynamics: Dynamics, trajectory: Trajectory, plan: Plan) -> float:
    """Return the largest |τ| between the samples while the motors are on, N or N·m.

    Carriers move on quintics through s, ṡ and s̈ of the samples, which follow the planner's smooth motion to rounding.
    """
    off = plan.phase == plan.phases.index("off")
    left = np.flatnonzero((np.diff(plan.t) > 0.0) & ~off[1:] & ~off[:-1])
    fraction = (np.arange(_SWITCH_OFF) + 0.5) / _SWITCH_OFF
    times = (plan.t[left, None] + np.diff(plan.t)[left, None] * fraction).ravel()
    carriers = _interpolated(plan, times)
    efforts = distribute(dynamics.reduce(trajectory.sample_at(times), carriers, check_track=False)).tau
    return float(np.nanmax(np.abs(efforts)))


def peak_of_stepwise(dynamics: Dynamics, trajectory: Trajectory, plan: Plan) -> float:
    """Return the largest |τ| between the samples of a stepwise plan, N·m."""
    found = between_samples(dynamics, plan, FINER - 1, trajectory)
    return float(np.max(np.asarray(found["peak_effort"], dtype=float)))


def peak_at_rest(dynamics: Dynamics, trajectory: Trajectory, dt: float) -> float:
    """Return the largest |τ| with the carriers, if any, parked, on a grid finer than the samples, N or N·m."""
    motion = trajectory.sample(dt / FINER)
    carriers = CarrierMotion.parked(len(motion), dynamics.robot.k)
    return float(np.abs(distribute(dynamics.reduce(motion, carriers)).tau).max())


def _interpolated(plan: Plan, times: Array) -> CarrierMotion:
    """Return the carriers between the samples; a time that occurs twice separates two pieces."""
    carriers, edges = plan.carriers, np.flatnonzero(np.diff(plan.t) == 0.0) + 1
    parts = [np.empty((len(times), carriers.s.shape[1])) for _ in range(3)]
    for first, stop in zip([0, *edges], [*edges, len(plan.t)], strict=True):
        if stop - first < 2:
            continue
        here = (times >= plan.t[first]) & (times <= plan.t[stop - 1])
        piece = slice(first, stop)
        given = np.stack([carriers.s[piece], carriers.sd[piece], carriers.sdd[piece]], axis=1)
        curve = BPoly.from_derivatives(plan.t[piece], given)
        for part, rate in zip(parts, (curve, curve.derivative(), curve.derivative(2)), strict=True):
            part[here] = rate(times[here])
    return CarrierMotion(*parts)
