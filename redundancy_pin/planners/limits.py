"""Which limits of the carriers a plan touches and which it breaks, when and by how much."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import CarrierLimits, Robot

BINDING = 1e-6
"""A quantity within this fraction of its limit counts as touching it."""

EXCEEDING = 1e-9
"""Relative excess that still counts as rounding of a motion built to lie on its limit."""


@dataclass(frozen=True)
class LimitEvent:
    """A stretch of time over which one limit of one carrier is touched or broken.

    Attributes:
        carrier: name of the carrier joint; of the main actuator for "effort".
        quantity: "track", "speed", "acceleration" or "force"; or "effort", N or N·m.
        start, end: first and last sample of the stretch, s.
        worst: time of the largest value, s.
        value: the value there, with its sign: m, m/s, m/s² or N.
        limit: the limit it meets, with its sign.
        amount: how far the value exceeds the limit; zero or rounding where the limit is only touched.
    """

    carrier: str
    quantity: str
    start: float
    end: float
    worst: float
    value: float
    limit: float
    amount: float


@dataclass(frozen=True)
class LimitReport:
    """Limits that a plan breaks, and those it only touches.

    Attributes:
        violated: limits that are broken, by time.
        binding: limits that are touched, by time.
        judged_by: (k,) the limits of each carrier that the plan was compared with.
    """

    violated: tuple[LimitEvent, ...]
    binding: tuple[LimitEvent, ...]
    judged_by: tuple[CarrierLimits, ...]


def check_limits(robot: Robot, t: Array, carriers: CarrierMotion, carrier_force: Array) -> LimitReport:
    """Compare a carrier motion and its forces with the limits of the robot's carriers.

    Args:
        robot: the robot.
        t: (N,) time, s.
        carriers: carrier motion, N samples.
        carrier_force: (N, k) forces of the carriers' actuators, N.
    """
    violated: list[LimitEvent] = []
    binding: list[LimitEvent] = []
    for i, (name, limits) in enumerate(zip(robot.carriers, robot.carrier_limits, strict=True)):
        bounds = {
            "track": (carriers.s[:, i], limits.lower, limits.upper),
            "speed": (carriers.sd[:, i], -limits.speed, limits.speed),
            "acceleration": (carriers.sdd[:, i], -limits.acceleration, limits.acceleration),
            "force": (carrier_force[:, i], -limits.force, limits.force),
        }
        for quantity, (value, lower, upper) in bounds.items():
            for limit, excess in ((upper, value - upper), (lower, lower - value)):
                if not np.isfinite(limit):
                    continue
                size = max(abs(limit), abs(upper - lower) / 2.0)
                broken = excess > EXCEEDING * size
                touched = (excess > -BINDING * size) & ~broken
                violated += _events(name, quantity, t, value, limit, excess, broken)
                binding += _events(name, quantity, t, value, limit, excess, touched)
    return LimitReport(
        tuple(sorted(violated, key=_by_time)), tuple(sorted(binding, key=_by_time)), robot.carrier_limits
    )


def _by_time(event: LimitEvent) -> float:
    return event.start


def _events(
    carrier: str, quantity: str, t: Array, value: Array, limit: float, excess: Array, where: BoolArray
) -> list[LimitEvent]:
    edges = np.flatnonzero(np.diff(np.concatenate([[False], where, [False]]).astype(int)))
    events = []
    for start, stop in zip(edges[::2], edges[1::2], strict=True):
        worst = int(start) + int(np.argmax(excess[start:stop]))
        events.append(
            LimitEvent(
                carrier,
                quantity,
                float(t[start]),
                float(t[stop - 1]),
                float(t[worst]),
                float(value[worst]),
                float(limit),
                max(0.0, float(excess[worst])),
            )
        )
    return events
