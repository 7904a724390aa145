"""Limits of a plan as arrays, and which of them a plan touches or breaks, when and by how much."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, ByValue, IntArray, each, frozen, runs
from redundancy_pin.errors import InfeasiblePlanError, InputError, shown
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.robot.joint_ranges import joint_ranges
from redundancy_pin.robot.scales import effort_unit
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

BINDING = 1e-6
"""A quantity within this fraction of its limit counts as touching it."""

EXCEEDING = 1e-9
"""Relative excess that still counts as rounding of a motion built to lie on its limit."""


LIMIT_TOLERANCE = 1e-3
"""Relative excess up to which an effort, a force, a rate of an actuator or a jerk keeps its limit, at samples and
between them: no plan with more counts as within its limits. A value this close below its limit touches it. Position,
speed and acceleration of carriers are polynomials, which planners limit to machine precision (``EXCEEDING``)."""


@dataclass(frozen=True)
class Quantity:
    """A quantity of actuators or carriers that plans limit: an entry of ``QUANTITIES``.

    Attributes:
        name: of the quantity in ``LimitEvent`` and in refusals.
        owner: "actuated" for the main actuators, or "carriers".
        unit: from whether a joint turns to the unit of its limit.
        formula: from a state to the values of all owners. States are matrices with a row for each node or instant:
            ``tau`` and ``actuated_rate`` of the main actuators (N, m), ``force``, ``s``, ``sd`` and ``sdd`` of the
            carriers (N, k), as numbers or expressions of the solver: use operators that both have, such as
            ``q.tau * q.actuated_rate``. None for what ``motion_quantities`` evaluates.
    """

    name: str
    owner: Literal["actuated", "carriers"]
    unit: Callable[[bool], str]
    formula: Callable[[Any], Any] | None = None

    def values(self, state: Any) -> Any:
        """Return the values of all owners, (N, m) or (N, k), numbers or expressions of the solver.

        Raises:
            InputError: the formula fails, or has not one column for each owner.
        """
        remedy = "Correct it: from tau, actuated_rate (N, m), force, s, sd and sdd (N, k) of a state to all owners."
        wanted = state.tau.shape if self.owner == "actuated" else state.s.shape
        try:
            value = self.formula(state) if self.formula else None
            shape = getattr(value, "shape", ())
        except (ArithmeticError, AttributeError, NotImplementedError, RuntimeError, TypeError, ValueError) as error:
            raise InputError(
                f"The formula of {shown(self.name)} fails: {str(error).rstrip('.')}.", remedy=remedy
            ) from error
        if tuple(shape) != tuple(wanted):
            message = f"The formula of {shown(self.name)} gives an array of shape {tuple(shape)}, not {tuple(wanted)}."
            raise InputError(message, remedy=remedy)
        return value


def _motion_unit(per: str) -> Callable[[bool], str]:
    return lambda turns: ("rad" if turns else "m") + per


def _effort_unit(turns: bool) -> str:
    return effort_unit([turns])


QUANTITIES: dict[str, Quantity] = {
    "track": Quantity("track", "carriers", _motion_unit("")),
    "speed": Quantity("speed", "carriers", _motion_unit("/s")),
    "acceleration": Quantity("acceleration", "carriers", _motion_unit("/s²")),
    "jerk": Quantity("jerk", "carriers", _motion_unit("/s³")),
    "effort": Quantity("effort", "actuated", _effort_unit, lambda q: q.tau),
    "carrier_force": Quantity("force", "carriers", _effort_unit, lambda q: q.force),
    "actuator_speed": Quantity("speed", "actuated", _motion_unit("/s"), lambda q: q.actuated_rate),
}
"""Limited quantities by field of ``Limits``. An added entry is limited by ``Limits(further={key: limit})``: the optimal
planners keep to it at the nodes, the inter-sample check evaluates it between them, for every planner."""


@dataclass(frozen=True, eq=False)
class States:
    """States of a motion at N instants, in the attributes that ``Quantity.formula`` reads."""

    tau: Array
    actuated_rate: Array
    force: Array
    s: Array
    sd: Array
    sdd: Array


@dataclass(frozen=True, eq=False)
class ResolvedLimits(ByValue):
    """The limits a planner keeps to, all of them arrays; infinite for none.

    ``names`` (k,) names of the carriers; ``track`` (k, 2) ends, m; ``speed``, ``acceleration``, ``carrier_force``,
    ``jerk`` (k,) m/s, m/s², N and m/s³; ``effort`` (m,) N or N·m; ``actuator_speed`` (m,) m/s or rad/s of the main
    actuators; ``further``: of other ``QUANTITIES`` by their key, one number for each owner.
    """

    names: tuple[str, ...]
    track: Array
    speed: Array
    acceleration: Array
    carrier_force: Array
    jerk: Array
    effort: Array
    actuator_speed: Array
    further: Mapping[str, Array] = field(default_factory=lambda: MappingProxyType({}))

    def of(self, key: str) -> Array:
        """Return the limits of one of ``QUANTITIES``."""
        limit: Array = self.further[key] if key in self.further else getattr(self, key)
        return limit

    def evaluated(self, timed: bool = True) -> dict[str, IntArray]:
        """Return the quantities that are evaluated from states, each with the joints that have a column in the check.

        Efforts and forces, which plans report, have one for every joint, others where they are limited.

        Args:
            timed: whether the planner chooses the motion of the platform. If not, nothing that it can change lowers the
                rates of the actuators.
        """
        rest = [*self.further, *(["actuator_speed"] if timed else [])]
        limited = {key: np.flatnonzero(np.isfinite(self.of(key))) for key in rest}
        return {"effort": np.arange(len(self.effort)), "carrier_force": np.arange(len(self.names)), **limited}

    @property
    def of_carriers(self) -> tuple[CarrierLimits, ...]:
        """(k,) limits of each carrier, as a robot declares them."""
        rows = zip(*self.track.T, self.speed, self.acceleration, self.carrier_force, strict=True)
        return tuple(CarrierLimits(*map(float, row)) for row in rows)

    @property
    def bounds(self) -> tuple[Array, Array]:
        """Lower and upper limits (4, k) of the carriers, in the order of ``OF_CARRIERS``."""
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
                    joint=carrier,
                    time=0.0,
                    amount=float(beyond),
                    name=name,
                )
        return places


@dataclass(frozen=True)
class LimitEvent:
    """A stretch of time over which one joint touches or exceeds one limit.

    Attributes:
        joint: its name: of a carrier, of the main actuator for "effort" and its "speed", of any joint for "range".
        quantity: "track", "speed", "acceleration", "jerk" or "force"; "effort", N or N·m; or "range", of a joint's
            position.
        start, end: first and last evaluated instant of the stretch, s.
        worst: time of the largest value, s.
        value: the value there, with its sign: m, m/s, m/s² or N.
        limit: the limit it meets, with its sign.
        amount: how far the value exceeds the limit; zero or rounding where the limit is only touched.
    """

    joint: str
    quantity: str
    start: float
    end: float
    worst: float
    value: float
    limit: float
    amount: float


Events = tuple[LimitEvent, ...]


def worst_events(events: Events) -> Events:
    """Return the event with the largest excess for each quantity of each joint, in the order of the first ones."""
    worst: dict[tuple[str, str], LimitEvent] = {}
    for event in events:
        key = event.joint, event.quantity
        if key not in worst or event.amount > worst[key].amount:
            worst[key] = event
    return tuple(worst.values())


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


OF_CARRIERS = ("track", "speed", "acceleration", "force")
"""Of a carrier, in the order of its position, its rates and its force."""


@dataclass(frozen=True, eq=False)
class LimitedQuantity:
    """One quantity of j joints at N instants, with its limits: a row of the table that ``limit_events`` evaluates.

    Attributes:
        name: as in ``LimitEvent.quantity``.
        joints: (j,) names.
        t: (N,) times, or (N, j) times of each joint, increasing, s.
        values: (N, j) in the unit of the quantity; values that are not finite count as zero: they decide a status.
        lower: (j,) lower limits; infinite for none.
        upper: (j,) upper limits.
        exceeding: excess up to which a limit is kept, in ``unit``.
        touching: distance from a limit up to which it is touched, in ``unit``.
        unit: (j,); when left out, for each limit the larger of its magnitude and half the distance of both limits (of
            one alone that is zero, the largest value).
    """

    name: str
    joints: tuple[str, ...]
    t: Array
    values: Array
    lower: Array
    upper: Array
    exceeding: float = LIMIT_TOLERANCE
    touching: float = LIMIT_TOLERANCE
    unit: Array | None = None


def limit_events(quantities: Iterable[LimitedQuantity]) -> tuple[Events, Events]:
    """Return the limits that are exceeded, and those that are touched, both by time.

    Each run of consecutive instants at which a joint exceeds, or touches, one limit is one event.

    Args:
        quantities: rows of the table, such as ``motion_quantities``.
    """
    violated: list[LimitEvent] = []
    touched: list[LimitEvent] = []
    for row in quantities:
        times = np.broadcast_to(row.t.reshape(len(row.t), -1), row.values.shape)
        values = np.where(np.isfinite(row.values), row.values, 0.0)
        for j, joint in enumerate(row.joints):
            t, value, ends = times[:, j], values[:, j], (float(row.upper[j]), float(row.lower[j]))
            for limit, excess in zip(ends, (value - ends[0], ends[1] - value), strict=True):
                if not np.isfinite(limit):
                    continue
                half = 0.5 * (ends[0] - ends[1])
                if not np.isfinite(half):  # limited on one side, maybe at zero
                    half = 0.0 if limit else float(np.abs(value).max(initial=0.0))
                size = max(abs(limit), half) if row.unit is None else row.unit[j]
                broken = excess > row.exceeding * size
                near = (excess > -row.touching * size) & ~broken
                for found, where in ((violated, broken), (touched, near)):
                    for first, stop in runs(where):
                        worst = first + int(np.argmax(excess[first:stop]))
                        span = float(t[first]), float(t[stop - 1]), float(t[worst])
                        amount = max(0.0, float(excess[worst]))
                        found.append(LimitEvent(joint, row.name, *span, float(value[worst]), limit, amount))
    violated, touched = (sorted(events, key=lambda event: event.start) for events in (violated, touched))
    return tuple(violated), tuple(touched)


def motion_quantities(
    limits: ResolvedLimits, position: PiecewisePolynomial, samples: Array | None = None
) -> tuple[LimitedQuantity, ...]:
    """Return track, speed, acceleration and jerk of carriers whose positions (k,), m, are a function of time.

    Evaluated at all extremes, from both sides where s̈ jumps. A jump of s̈ is a jerk within the shorter of the pieces
    that meet there.

    Args:
        limits: of the carriers.
        position: of the carriers.
        samples: (N,) further times, s: extremes determine the largest excess, samples its start and end.
    """
    inside = np.linspace(0.0, 1.0, 5)[:-1]
    edges, step = position.edges, np.diff(position.edges)
    even = edges[:-1, None] + step[:, None] * inside
    extremes = [position.derivative(order).extremes() for order in range(3)]
    further = edges[:0] if samples is None else samples[(samples >= edges[0]) & (samples <= edges[-1])]
    times = np.unique(np.concatenate([even.ravel(), edges[-1:], further, *extremes]))
    sides = [carriers_at(position, times, side) for side in ("left", "right")]
    t, (lower, upper) = np.repeat(times, 2), limits.bounds
    rows = [
        LimitedQuantity(
            name,
            limits.names,
            t,
            np.stack([getattr(side, part) for side in sides], axis=1).reshape(len(t), -1),
            lower[i],
            upper[i],
            EXCEEDING,
            BINDING,
        )
        for i, (name, part) in enumerate(zip(OF_CARRIERS, ("s", "sd", "sdd"), strict=False))
    ]
    if np.isfinite(limits.jerk).any():
        sdd, (least, largest) = position.derivative(2), position.derivative(3).ranges()
        jump = (sdd(edges[1:-1]) - sdd(edges[1:-1], "left")) / np.minimum(step[:-1], step[1:])[:, None]
        jerk = np.concatenate([np.where(-least > largest, least, largest), jump])
        t = np.append(edges[:-1], edges[1:-1])
        order = np.argsort(t, kind="stable")
        rows.append(LimitedQuantity("jerk", limits.names, t[order], jerk[order], -limits.jerk, limits.jerk))
    return tuple(rows)


def range_quantities(robot: Robot, t: Array, q: Array) -> tuple[LimitedQuantity, ...]:
    """Return positions of the joints that have a range, passive ones too, at (N,) times, s, of q (N, nq) or NaN."""
    known = np.isfinite(q).all(axis=1)
    rows = []
    for joint in joint_ranges(robot):
        value, ends = joint.counted(q[known, joint.at], True)[:, None], (frozen([joint.lower]), frozen([joint.upper]))
        rows.append(LimitedQuantity("range", (joint.name,), t[known], value, *ends, 1.0, 1.0, frozen([joint.slack])))
    return tuple(rows)
