"""Limits of a plan as arrays, and which of them a plan touches or breaks, when and by how much."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, Frozen, each, frozen, runs
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.robot.joint_ranges import joint_ranges
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

BINDING = 1e-6
"""A quantity within this fraction of its limit counts as touching it."""

EXCEEDING = 1e-9
"""Relative excess that still counts as rounding of a motion built to lie on its limit."""


LIMIT_TOLERANCE = 1e-3
"""Relative excess up to which an effort, a force, a rate of an actuator or a jerk keeps its limit, at samples and
between them: no plan with more counts as within its limits. What comes as near from below touches its limit. Position,
speed and acceleration of carriers are polynomials, which planners keep within limits to rounding (``EXCEEDING``)."""


@dataclass(frozen=True, eq=False)
class ResolvedLimits(Frozen):
    """The limits a planner keeps to, all of them arrays; infinite for none.

    ``names`` (k,) names of the carriers; ``track`` (k, 2) ends, m; ``speed``, ``acceleration``, ``carrier_force``,
    ``jerk`` (k,) m/s, m/s², N and m/s³; ``effort`` (m,) N or N·m; ``actuator_speed`` (m,) m/s or rad/s of the main
    actuators.
    """

    names: tuple[str, ...]
    track: Array
    speed: Array
    acceleration: Array
    carrier_force: Array
    jerk: Array
    effort: Array
    actuator_speed: Array

    def __eq__(self, other: object) -> bool:
        """Return whether names and numbers are the same."""
        if not isinstance(other, ResolvedLimits):
            return NotImplemented
        return self._values == other._values

    def __hash__(self) -> int:
        """Equal limits have equal hashes."""
        return hash(self._values)

    @property
    def _values(self) -> tuple[object, ...]:
        """Names and numbers as tuples: bytes of 0.0 and -0.0 would differ."""
        return (self.names, *(tuple(getattr(self, field.name).ravel().tolist()) for field in fields(self)[1:]))

    @property
    def of_carriers(self) -> tuple[CarrierLimits, ...]:
        """(k,) those of each carrier, as a robot declares them."""
        rows = zip(*self.track.T, self.speed, self.acceleration, self.carrier_force, strict=True)
        return tuple(CarrierLimits(*map(float, row)) for row in rows)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper limits (4, k) of the carriers, in the order of ``QUANTITIES``."""
        lower, upper = self.track.T
        rates = np.stack([self.speed, self.acceleration, self.carrier_force])
        return np.vstack([lower, -rates]), np.vstack([upper, rates])

    def on_track(self, values: ArrayLike, name: str) -> Array:
        """Return (k,) positions after checking that they are on the tracks, m."""
        places = frozen(each(values, name, (len(self.names),), finite=True))
        for carrier, (lower, upper), place in zip(self.names, self.track, places, strict=True):
            beyond = max(place - upper, lower - place)
            if not beyond <= 0.0:
                raise InfeasiblePlanError(
                    f"{name} puts {carrier} at {place:g} m, {beyond:.3g} m off its track [{lower:g}, {upper:g}] m.",
                    remedy="Choose a place on the track.",
                    constraint="track",
                    carrier=carrier,
                    time=0.0,
                    amount=float(beyond),
                )
        return places


@dataclass(frozen=True)
class LimitEvent:
    """A stretch of time over which one limit of one carrier is touched or broken.

    Attributes:
        carrier: name of the carrier joint; of the main actuator for "effort" and its "speed", of any joint for "range".
        quantity: "track", "speed", "acceleration", "jerk" or "force"; "effort", N or N·m; or "range", of a joint's
            position.
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
        judged_by: the limits that the plan was compared with.
    """

    violated: tuple[LimitEvent, ...]
    binding: tuple[LimitEvent, ...]
    judged_by: ResolvedLimits


QUANTITIES = ("track", "speed", "acceleration", "force")
"""Of a carrier, in the order of its position, its rates and its force."""


def check_limits(limits: ResolvedLimits, t: Array, carriers: CarrierMotion, carrier_force: Array) -> LimitReport:
    """Compare a carrier motion and its forces with the limits of the carriers.

    ``t`` (N,) time, s; ``carriers``: carrier motion, N samples; ``carrier_force`` (N, k) forces of the carriers'
    actuators, N.
    """
    violated: list[LimitEvent] = []
    binding: list[LimitEvent] = []
    lowest, highest = limits.bounds
    values = (carriers.s, carriers.sd, carriers.sdd, carrier_force)
    for i, name in enumerate(limits.names):
        for quantity, series, lower, upper in zip(QUANTITIES, values, lowest[:, i], highest[:, i], strict=True):
            value = series[:, i]
            for limit, excess in ((upper, value - upper), (lower, lower - value)):
                if not np.isfinite(limit):
                    continue
                size = max(abs(limit), abs(upper - lower) / 2.0)
                broken = excess > EXCEEDING * size
                touched = (excess > -BINDING * size) & ~broken
                violated += _events(name, quantity, t, value, limit, excess, broken)
                binding += _events(name, quantity, t, value, limit, excess, touched)
    violated, binding = (sorted(events, key=lambda event: event.start) for events in (violated, binding))
    return LimitReport(tuple(violated), tuple(binding), limits)


def motion_events(limits: ResolvedLimits, position: PiecewisePolynomial) -> tuple[LimitEvent, ...]:
    """Return where carriers whose positions (k,), m, are a function of time leave track, speed or acceleration.

    Of an acceleration that jumps the value after the jump counts.
    """
    inside = np.linspace(0.0, 1.0, 5)[:-1]  # that an event has a start and an end; the extremes decide
    even = position.edges[:-1, None] + np.diff(position.edges)[:, None] * inside
    extremes = [position.derivative(order).extremes() for order in range(3)]
    times = np.unique(np.concatenate([even.ravel(), position.edges[-1:], *extremes]))
    carriers = carriers_at(position, times)
    return check_limits(limits, times, carriers, np.zeros_like(carriers.s)).violated


def _events(
    carrier: str, quantity: str, t: Array, value: Array, limit: float, excess: Array, where: BoolArray
) -> list[LimitEvent]:
    events = []
    for start, stop in runs(where):
        worst = start + int(np.argmax(excess[start:stop]))
        span = float(t[start]), float(t[stop - 1]), float(t[worst])
        amount = max(0.0, float(excess[worst]))
        events.append(LimitEvent(carrier, quantity, *span, float(value[worst]), float(limit), amount))
    return events


def range_events(robot: Robot, t: Array, q: Array) -> tuple[LimitEvent, ...]:
    """Return where joints, passive ones too, are beyond their ranges: times (N,), s, configurations (N, nq) or NaN."""
    events, known = [], np.isfinite(q).all(axis=1)
    for joint in joint_ranges(robot):
        value = joint.counted(q[known, joint.at], True)
        for limit, excess in ((joint.lower, joint.lower - value), (joint.upper, value - joint.upper)):
            events += _events(joint.name, "range", t[known], value, limit, excess, excess > joint.slack)
    return tuple(events)


def limit_events(
    quantity: str, names: tuple[str, ...], t: Array, values: Array, limit: Array
) -> tuple[tuple[LimitEvent, ...], tuple[LimitEvent, ...]]:
    """Return the limits that |values| exceed, and those that they touch, by more or less than ``LIMIT_TOLERANCE``.

    Each actuator has one event of one kind at most, from the first to the last such time.

    ``names`` (j,) of the actuators; ``t`` (N,) times or (N, j) times of each, s; ``values`` (N, j) efforts, forces,
    rates or jerks; those that are not finite are judged elsewhere; ``limit`` (j,) the largest allowed.
    """
    violated: list[LimitEvent] = []
    touched: list[LimitEvent] = []
    times = np.broadcast_to(np.asarray(t).reshape(len(t), -1), values.shape)
    for name, own, when, most in zip(names, np.where(np.isfinite(values), values, 0.0).T, times.T, limit, strict=True):
        use = np.abs(own) / most
        exceeded = bool(use.max(initial=0.0) > 1.0 + LIMIT_TOLERANCE)
        at = np.flatnonzero(use > (1.0 + LIMIT_TOLERANCE if exceeded else 1.0 - LIMIT_TOLERANCE))
        if len(at):
            worst = int(at[use[at].argmax()])
            value = float(own[worst])
            excess = max(abs(value) - float(most), 0.0)
            span = float(when[at].min()), float(when[at].max()), float(when[worst])
            meets = float(np.copysign(most, value))
            event = LimitEvent(name, quantity, *span, value, meets, excess)
            (violated if exceeded else touched).append(event)
    return tuple(violated), tuple(touched)
