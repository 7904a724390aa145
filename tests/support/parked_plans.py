"""Plans in which no carrier moves, for tests of what a plan is and of its files."""

from __future__ import annotations

from typing import Any

import numpy as np

import redundancy_pin as rp
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import PlannedMotion
from redundancy_pin.planners.options import Limits
from redundancy_pin.planners.plan import Plan
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial


def parked_plan(dynamics: Dynamics, motion: rp.PlatformMotion, **settings: Any) -> Plan:
    """Return the plan of a sampled motion with the carriers at s = 0; ``settings`` as of ``PlannedMotion``."""
    k, source = dynamics.robot.k, as_motion(motion)
    return finish_plan(
        PlannedMotion(
            dynamics,
            PlanFunctions(source, PiecewisePolynomial.constant(np.zeros(k), source.start, source.end)),
            dynamics.along(motion),
            rp.CarrierMotion.parked(len(motion), k),
            Limits().resolved(dynamics.robot),
            "parked",
            **settings,
        )
    )
