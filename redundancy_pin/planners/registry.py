"""The planners by the names that the command line and problem files use, and their options in one mapping."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping
from dataclasses import fields
from typing import Any

from redundancy_pin.planners.optimal import plan_time_optimal
from redundancy_pin.planners.optimal.whole_trajectory import plan_whole_trajectory
from redundancy_pin.planners.options import GROUPS
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.stepwise.planner import plan_stepwise
from redundancy_pin.planners.switch_off.planner import plan_switch_off

SWITCH_OFF, STEPWISE, WHOLE, TIME_OPTIMAL = "switch-off", "stepwise", "whole-trajectory", "time-optimal"

PLANNERS: Mapping[str, Callable[..., Plan]] = {
    SWITCH_OFF: plan_switch_off,
    STEPWISE: plan_stepwise,
    WHOLE: plan_whole_trajectory,
    TIME_OPTIMAL: plan_time_optimal,
}
"""Planners by name; all except the least-time planner plan a motion at its given speed."""


def in_groups(planner: Callable[..., Any], options: Mapping[str, Any]) -> dict[str, Any]:
    """Return keyword arguments of a planner from options in one mapping, as flags and problem files write them.

    Fields of a group that the planner takes go there: ``{"dt": 0.02}`` becomes ``mesh=Mesh(dt=0.02)`` for a planner
    without a keyword ``dt``. Unknown options stay, and the planner refuses them.

    Example:
        >>> in_groups(plan_whole_trajectory, {"dt": 0.02, "objective": "peak"})
        {'objective': 'peak', 'mesh': Mesh(dt=0.02, refinements=3, steps=None)}
    """
    own = inspect.signature(planner).parameters
    keywords = dict(options)
    for group in GROUPS.keys() & own.keys():
        kind = GROUPS[group]
        names = {field.name for field in fields(kind)} - own.keys()
        given = {name: keywords.pop(name) for name in names & keywords.keys()}
        if given and group == "objective" and group in keywords:
            given["weights"] = keywords[group]
        if given:
            keywords[group] = kind(**given)
    return keywords
