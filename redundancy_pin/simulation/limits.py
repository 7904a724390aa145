"""Limits of a robot that a simulated motion exceeds: of carriers, main actuators and ranges of joints."""

from __future__ import annotations

from redundancy_pin.arrays import Array
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.limits import OF_CARRIERS, LimitedQuantity, LimitEvent, limit_events, range_quantities
from redundancy_pin.planners.options import Limits
from redundancy_pin.robot import Robot


def broken_limits(
    robot: Robot, t: Array, q: Array, carriers: CarrierMotion, tau: Array, carrier_force: Array, actuated_rate: Array
) -> tuple[LimitEvent, ...]:
    """Return the limits that N samples of a motion exceed by more than ``LIMIT_TOLERANCE``, by time.

    Unlike a plan a simulation has no limits of its own: the robot's are compared, as it declares them.

    Args:
        robot: the robot.
        t: (N,) times, s.
        q: (N, nq) tree configurations.
        carriers: positions, m, and rates of the carriers; NaN where the motion is not determined.
        tau: (N, m) main efforts, N or N·m.
        carrier_force: (N, k) forces of the carriers' actuators, N.
        actuated_rate: (N, m) rates of the main actuators, m/s or rad/s.
    """
    lower, upper = Limits(effort=float("inf")).resolved(robot).bounds
    values = (carriers.s, carriers.sd, carriers.sdd, carrier_force)
    rows = [
        LimitedQuantity(name, robot.carriers, t, value, lower[i], upper[i])
        for i, (name, value) in enumerate(zip(OF_CARRIERS, values, strict=True))
    ]
    rows += [
        LimitedQuantity("effort", robot.actuated, t, tau, *robot.effort_limits),
        LimitedQuantity("speed", robot.actuated, t, actuated_rate, -robot.speed_limits, robot.speed_limits),
        *range_quantities(robot, t, q),
    ]
    return limit_events(rows)[0]
