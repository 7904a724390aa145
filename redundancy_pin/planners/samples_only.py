"""Plans that are samples alone (files of version 0.1.0, plans put together by hand): what is between them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array, read_only, runs
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion, continuous_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

if TYPE_CHECKING:
    from redundancy_pin.planners.plan import Plan


def functions_of_samples(plan: Plan, platform: ContinuousMotion | None = None) -> PlanFunctions:
    """Return the functions of time that the samples of a plan stand for, where it carries none (files of 0.1.0).

    Platform: quintics through x, ẋ, ẍ, held at its end while carriers move on. Carriers:

    - Whole-trajectory plans: s̈ is linear in each step, as they were planned.
    - Steps of stepwise plans (and of switch-off plans by backward differences): s̈ is constant and has the plan's value
      at the end of the step; ṡ meets the plan's at every sample. s, integrated, lags behind the plan's by up to half a
      step, because backward differences move a carrier by its new speed. The lag is carried on, so that s stays
      continuous.
    - Everything else: the quintic through s, ṡ and s̈ at both ends, off by O(Δt⁴) in s̈.

    Main actuators are off between two samples without effort, one of them at least in the phase "off": two samples
    without effort alone do not say it, for between two samples at rest there may be a motion that needs efforts.

    ``platform``: the platform's motion, where it is known.
    """
    t, names = plan.t, np.array(plan.phases)[plan.phase]
    left = np.flatnonzero(np.diff(t) > 0.0)
    right = left + 1
    s, sd, sdd = (np.asarray(part) for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd))
    if plan.planner == "whole_trajectory":
        carriers = PiecewisePolynomial.linear(t, s, sd, sdd)
    else:
        edges = np.append(t[left], t[-1])
        smooth = PiecewisePolynomial.hermite(edges, *((s[i], sd[i], sdd[i]) for i in (left, right)))
        stepped = ("optimise", "brake") if plan.planner == "stepwise" else ()
        if plan.planner == "switch_off" and plan.parameters.get("scheme") == "backward_differences":
            stepped = ("ramp_down", "off")
        constant = np.isin(names[right], stepped)
        powers = smooth.coefficients.copy()
        powers[:3, constant] = 0.0
        powers[3, constant] = 0.5 * sdd[right][constant]
        carriers = PiecewisePolynomial(smooth.edges, read_only(powers))
    idle = (plan.tau == 0.0).all(axis=1)
    off = idle[left] & idle[right] & ((names[left] == "off") | (names[right] == "off"))
    none = np.zeros(plan.tau.shape[1])
    prescribed = tuple(PiecewisePolynomial.constant(none, t[left[a]], t[right[b - 1]]) for a, b in runs(off))
    return PlanFunctions(platform or continuous_motion(plan.motion), carriers.made_continuous(), prescribed)


def reconstruction_error(plan: Plan) -> Array:
    """Return (2, P, k) by how much ṡ, m/s, and s̈, m/s², of quintics through the samples may be off in each of P steps.

    It is what a quintic over two steps misses at the sample between them, of the two that a step is part of that which
    misses less: a sixteenth of it where the motion is smooth; all of it where one phase ends and another begins. Zero
    where the plan's own steps are known to be of lower degree, and where no neighbour tells.
    """
    t = plan.t
    left = np.flatnonzero(np.diff(t) > 0.0)
    right = left + 1
    series = [np.asarray(part) for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd)]
    missed = np.full((2, len(left), series[0].shape[1]), np.inf)
    for first in (0, 1) if plan.planner != "whole_trajectory" else ():
        starts, between, ends = left[first:-1:2], right[first:-1:2], right[first + 1 :: 2]
        if not len(ends):
            continue
        double = PiecewisePolynomial.hermite(
            np.append(t[starts], t[ends[-1]]), *(tuple(part[at] for part in series) for at in (starts, ends))
        )
        for order in (1, 2):
            apart = np.abs(double.derivative(order)(t[between]) - series[order][between])
            for step in (0, 1):
                there = missed[order - 1, first + step : first + 2 * len(ends) : 2]
                np.minimum(there, apart, out=there)
    return np.where(np.isfinite(missed), missed, 0.0)
