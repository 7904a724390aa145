"""Calls of ``redundancy-pin plan`` that several tests start from."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from redundancy_pin.planners.plan import Plan

LINE = ("plan", "switch-off", "--robot", "2rpr", "--motion", "line", "--threshold", "4", "--dt", "0.01")
"""A crossing within all limits: slow, along the line."""

CORNER = ("plan", "stepwise", "--robot", "3rrr", "--working-mode", "+++", "--motion", "corner", "--dt", "0.02")

PROBLEM: dict[str, Any] = {
    "planner": "stepwise",
    "robot": "3rrr",
    "parameters": {"dt": 0.05},
    "motion": {"name": "corner"},
}


def same(ours: Plan, theirs: Plan) -> None:
    """The same computation on the same input: equal to the last bit."""
    for name in ("tau", "carrier_force", "margin", "phase", "sample_status"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
    np.testing.assert_array_equal(ours.motion.x, theirs.motion.x)
    np.testing.assert_array_equal(ours.carriers.s, theirs.carriers.s)
    assert ours.status is theirs.status
    assert ours.limits == theirs.limits
    assert ours.robot == theirs.robot


def write_problem(path: Path, **data: Any) -> Path:
    """Write a problem file."""
    path.write_text(yaml.safe_dump(data), encoding="utf-8")
    return path
