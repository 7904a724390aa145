"""Event detection: limits of tracks and joints, singularities of type I and II, rank losses of the closures.

An event is a zero of a scalar function of the configuration. The functions are evaluated on the cubic through the ends
of a step, which takes no evaluation of the dynamics; if one changes sign there, its root is found on the integrator's
interpolant. A sign that changes twice between two evaluations does not show; for the stops, which must not be missed,
the turning points of the joints are evaluated too.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.integrate import OdeSolver
from scipy.optimize import brentq, minimize_scalar

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.coordinates import mode_indicator
from redundancy_pin.robot import Robot
from redundancy_pin.robot.joint_ranges import ROUNDING, all_ranges
from redundancy_pin.simulation.rank_loss import LOST, NEAR, Sheet, rank_ratio

KINDS = ("track", "joint_limit", "type_I", "type_II", "closure_rank")
"""A carrier at an end of its track; another joint at its limit; a leg at full stretch or folded, where the platform
velocity does not determine the joints; actuators that do not hold the platform; a pose at which the closures lose
rank."""

ONE_SIDED = ("track", "joint_limit")
"""Kinds of stops: only leaving the allowed side counts."""

RELEASE = "release"
"""Kind of the event at which a stop lets go of a joint."""

_ROUNDING = 1e-12
"""Values of functions other than stops, no unit, that count as zero at the start."""

_HELD = 0.9
"""Part of its slack by which a joint that starts at its limit may exceed it: a run then stops within the slack."""

_NOT_AT = 1e-3
"""Part of its slack that a joint at a stop that pushes may move outward: more than rounding, too little to creep."""

_UNLIMITED = 1e6
"""rad, or characteristic lengths; URDF writers put larger numbers for no limit."""

_LOOKS = (0.25, 0.5, 0.75, 1.0)
"""Fractions of a step at which the functions are evaluated."""

BRIEF = 0.02
"""rad; if joints move less than this in a step, at the speeds of its ends, the functions are evaluated only at its end
and at turning points. A tenth of ``BETWEEN``."""

BETWEEN = 0.2
"""rad; largest travel of a joint of the pose between two evaluations of the rank of the closures."""

_SAME = 2e-3
"""Share of a step to which the time of a zero of third order is known: a hundred cube roots of 1e-14, the rounding of a
determinant."""

_TURN = 1e-6
"""Accuracy of a turning point, part of a step: the error of the position is of second order in it. Rank losses nearer
to each other are one."""

_POINTS = 0.5 - 0.5 * np.cos(np.linspace(0.0, np.pi, 12))
"""Fractions of a step on a sheet, of a third of a radian at most, between which closure rows are interpolated."""


@dataclass(frozen=True)
class Event:
    """Something that happened during a simulation.

    Attributes:
        kind: one of ``KINDS``, or ``RELEASE``.
        name: which one: "carrier_1 upper", "leg 2", or the kind itself.
        t: time, s, found as a root on the integrator's own interpolant.
        terminal: whether the simulation stopped there.
        impulse: of a stop that pushes back, N·s or N·m·s.
    """

    kind: str
    name: str
    t: float
    terminal: bool
    impulse: float = 0.0


class EventFunctions:
    """The scalar functions of a robot whose zeros are events; the functions of the stops come first.

    Args:
        chain: evaluator of the robot.
        stop_at: kinds of events that end a simulation.
        start: (nq,) configuration; joints that are at a limit there may exceed it by nearly its slack.
        push_back: kinds of stops that push back: a step ends there, whatever is in ``stop_at``.
        at: indices of stops that joints may exceed at the start, by the error of an integration step.
        held: indices of stops that joints cannot leave.

    Attributes:
        kinds, names: of each function.
        stops: (4, l) index in q and in v, side and bound of each stop; ``columns`` and ``side`` are two of the rows.
        slack: (l,) by which a joint at its limit may exceed it.
        determinants: kinds whose functions are determinants with the closure rows in them.
    """

    def __init__(
        self,
        chain: ClosedChain,
        stop_at: tuple[str, ...],
        start: Array,
        push_back: tuple[str, ...] = (),
        at: Sequence[int] = (),
        held: Sequence[int] = (),
    ) -> None:
        robot = chain.robot
        self.nq, self.stop_at, self.push_back = robot.model.nq, stop_at, push_back
        labels, self.stops, self.slack = _stops(robot)
        at, self.held = list(at), list(held)
        self._position, self.columns = self.stops[:2].astype(np.intp)
        self.side, self._bound = self.stops[2:]
        self._limit = self._bound.copy()
        # a joint that starts at its limit is within it, however it was rounded, and may stay there
        at_limit = np.abs(self._within(start)) <= self.slack
        self._bound += np.where(at_limit, _HELD * self.side * self.slack, 0.0)
        beyond = np.maximum(_NOT_AT * self.slack - self._within(start), 0.0)
        self._bound[at] += (self.side * beyond)[at]
        self._bound[self.held] = np.inf * self.side[self.held]
        legs = 0 if robot.working_modes is None else len(robot.working_modes.joints)
        self._by_legs, self._square = legs > 0, robot.m == robot.n
        self.determinants = (() if legs else ("type_I",)) + (("type_II",) if self._square else ())
        labels += [("type_I", f"leg {i + 1}") for i in range(legs)] or [("type_I", "type_I")]
        labels += [("type_II", "type_II")] if self._square else []
        labels += [("closure_rank", "closures")]
        self.kinds, self.names = (tuple(part) for part in zip(*labels, strict=True))
        self.pushes = np.isin(self.kinds, push_back)
        self._terminal = np.isin(self.kinds, stop_at) | self.pushes
        self._one_sided = np.isin(self.kinds, ONE_SIDED)
        self._chain, self._columns, self._unit = chain, chain.pose_columns, chain.system.step_unit
        self._actuated = np.eye(robot.model.nv)[robot.actuated_velocity][:, self._columns]
        self._still = np.zeros(robot.model.nv)

    def __call__(self, y: Array) -> Array:
        """Return (N, w) the functions at configurations (N, nq) or states (N, nq + nv)."""
        chain, q = self._chain, y[:, : self.nq]
        count, p, r = len(q), len(self._columns), chain.rows
        # [J_c; S], whose determinant is zero where actuators do not hold the platform, and [J_c; J_x]
        # determinants, for their signs: a singular value only dips to zero, and a root needs a change of sign
        by_actuators, by_platform = np.empty((count, p, p)), np.empty((count, p, p))
        for i, one in enumerate(q):
            chain.update(one, self._still)
            by_platform[i] = chain.matrix()
        rows = by_platform[:, :r]
        type_i = mode_indicator(chain.robot, q) if self._by_legs else np.linalg.det(by_platform)[:, None]
        parts = [self._within(q), type_i]
        if self._square:
            by_actuators[:, :r], by_actuators[:, r:] = rows, self._actuated
            parts.append(np.linalg.det(by_actuators)[:, None])
        # a ratio of singular values has no sign: it touches zero where rank is lost, at roots of any multiplicity
        return np.concatenate([*parts, rank_ratio(rows)[:, None]], axis=1)

    def rank(self, y: Array) -> Array:
        """Return (N,) the ratio of singular values of the closures at configurations or states."""
        return self(y)[:, -1]

    def _within(self, y: Array) -> Array:
        """Return (..., l) how far joints are from their stops, m or rad; negative beyond them."""
        inside: Array = self.side * (self._bound - y.take(self._position, -1))
        return inside

    def at_start(self, q: Array) -> Array:
        """Return (w,) the functions at the start (nq,), rounding taken for zero.

        A machine that starts at a stop stops again if it moves outward, whichever way its position was rounded. A
        machine that starts at a singular pose has not come to it.

        Raises:
            InputError: a stop at which the simulation ends has been passed already.
        """
        values: Array = self(q[None])[0]
        rounding = np.full(len(values), _ROUNDING)
        rounding[: len(self.slack)] = self.slack
        for i in np.flatnonzero(self._one_sided & self._terminal & (values < -rounding)):
            raise InputError(
                f"The simulation starts {-values[i]:.3g} beyond the limit {self.names[i]!r}.",
                remedy="Start within the limits, or leave the kind out of stop_at"
                + (' (with joint_stops="end").' if self.pushes[i] else "."),
                event=self.names[i],
                amount=float(-values[i]),
            )
        values[np.where(self._one_sided, (values < 0.0) & (values >= -rounding), np.abs(values) <= rounding)] = 0.0
        return values

    def touching(self, q: Array) -> BoolArray:
        """Return (l,) which stops joints are at, or beyond, at a configuration (nq,)."""
        return np.asarray(self.side * (self._limit - q.take(self._position)) <= self.slack)

    def sign_changes(self, before: Array, after: Array) -> BoolArray:
        """Return (..., w) which functions changed sign, or came to zero, between two points of time.

        A stop is passed if its function becomes negative; leaving zero is an event for stops only.
        """
        leaves = (before >= 0.0) & (after < 0.0)
        swaps = ((before > 0.0) & (after <= 0.0)) | ((before < 0.0) & (after >= 0.0))
        return np.where(self._one_sided, leaves, swaps)

    def approach(self, y: Array) -> Array:
        """Return (N, l) the rates at which joints move away from their stops, for states y (N, nq + nv)."""
        rates: Array = -self.side * y.take(self.nq + self.columns, 1)
        return rates

    def turns(self, y: Array, length: Array) -> BoolArray:
        """Return (N, l) which joints turn back, near enough to a stop to pass it, in which of N parts of a step.

        y (N + 1, nq + nv) are the states at the ends of the parts, length (N,) their durations, s.
        """
        away, rate = self._within(y), self.approach(y)
        reach = length[:, None] * np.maximum(np.abs(rate[:-1]), np.abs(rate[1:]))
        return np.asarray((rate[:-1] < 0.0) & (rate[1:] > 0.0) & (np.minimum(away[:-1], away[1:]) < reach))

    def speeds(self, y: Array) -> Array:
        """Return (N,) speeds of the fastest joint of the pose, rad or characteristic lengths per s, for N states."""
        speeds: Array = (np.abs(y[:, self.nq + self._columns]) / self._unit).max(axis=1, initial=0.0)
        return speeds

    def ratios(self, step: Step, count: int) -> Array:
        """Return (count + 1,) the ratio of singular values of the closures at equidistant points of a step."""
        return self.rank(step.states(np.linspace(0.0, 1.0, count + 1)))

    def least_rank(self, step: Step) -> float:
        """Return the smallest ratio of singular values of the closures within a step, to 1e-6 of the step."""
        travel = (step.end - step.start) * self.speeds(step.states((0.0, *_LOOKS))).mean()
        looks = np.linspace(0.0, 1.0, 33 + int(travel / BETWEEN))
        lowest = int(np.argmin(self.ratios(step, len(looks) - 1)))
        ends = looks[max(lowest - 1, 0)], looks[min(lowest + 1, len(looks) - 1)]
        ratio = lambda fraction: float(self.rank(step.states([fraction]))[0])  # noqa: E731
        return float(minimize_scalar(ratio, bounds=ends, method="bounded", options={"xatol": 1e-6}).fun)

    def events(self, indices: Iterable[int], t: float, y: Array) -> list[Event]:
        """Return the events of functions that are zero at a time, s, and a state y (nq + nv,).

        Closures, and determinants with their rows, have none if dependent rows restore the rank that those in use lose.
        """
        self._chain.place(y[: self.nq])
        restored = self._chain.dependent_rows_restore_rank()
        return [
            Event(self.kinds[i], self.names[i], t, bool(self._terminal[i]))
            for i in indices
            if not (restored and self.kinds[i] in ("closure_rank", *self.determinants))
        ]


def _stops(robot: Robot) -> tuple[list[tuple[str, str]], Array, Array]:
    """Return kind and name of the finite limits of joints; index in q and in v, side and bound (4, l); slack (l,)."""
    labels, stops = [], []
    for joint in all_ranges(robot):
        kind, column = "track" if joint.name in robot.carriers else "joint_limit", robot.model.joints[joint.column + 1]
        for side, bound, which in ((-1.0, joint.lower, "lower"), (1.0, joint.upper, "upper")):
            if abs(bound) < _UNLIMITED * joint.slack / ROUNDING:
                labels.append((kind, f"{joint.name} {which}"))
                stops.append((joint.at, column.idx_v, side, bound, joint.slack))
    table = np.array(stops, dtype=float).reshape(-1, 5).T
    return labels, table[:4], table[4]


class Step:
    """An accepted step of an integrator, as a function of time; valid until the integrator takes the next one.

    ``before`` is y and ẏ at the start of the step.
    """

    def __init__(self, solver: OdeSolver, before: tuple[Array, Array]) -> None:
        self.start, self.end = float(solver.t_old), float(solver.t)
        self._solver, self._before = solver, before
        self._after: tuple[Array, Array] = (solver.y, solver.f)

    @cached_property
    def _dense(self) -> Callable[[float], Array]:
        # three more evaluations: only if needed
        interpolant: Callable[[float], Array] = self._solver.dense_output()
        return interpolant

    def __call__(self, t: float) -> Array:
        """Return y at a time in the step, to the accuracy of the integrator."""
        if t <= self.start:
            return self._before[0]
        return self._after[0] if t >= self.end else self._dense(t)

    def time(self, fraction: float) -> float:
        """Return the time at a fraction of the step, s."""
        return self.end if fraction == 1.0 else self.start + fraction * (self.end - self.start)

    def at(self, fraction: float) -> Array:
        """Return y at a fraction of the step, to the accuracy of the integrator."""
        return self(self.time(fraction))

    def states(self, fractions: Iterable[float]) -> Array:
        """Return (N, nq + nv) y at fractions of the step, to the accuracy of the integrator."""
        return np.array([self.at(fraction) for fraction in fractions])

    def estimates(self, fractions: Sequence[float]) -> Array:
        """Return (N, nq + nv) y at fractions of the step on the cubic through both ends (Hermite)."""
        (y0, f0), (y1, f1) = self._before, self._after
        h, x = self.end - self.start, np.array(fractions)
        late = x * x * (3.0 - 2.0 * x)
        weights = np.stack([1.0 - late, x * (1.0 - x) ** 2, -x * x * (1.0 - x), late], axis=1)
        states: Array = weights.dot(np.array([y0, h * f0, h * f1, y1]))
        return states


def find_events(
    functions: EventFunctions, before: Array, step: Step, time: float, sheet: Sheet | None = None
) -> tuple[list[Event], Array, Array]:
    """Return the events in a step, the functions (w,) at its end, and the rank (L,) of the closures along it.

    Args:
        functions: event functions.
        before: (w,) the functions at the start of the step.
        step: the step.
        time: time scale of the motion, s.
        sheet: solution branch across a rank loss of the closures that the motion is on, or None.

    Returns:
        The events in order of time, up to the first terminal one; the functions; and the ratios of singular values at
        equidistant points, from the start of the step to its end.
    """
    length = step.end - step.start
    is_brief = length * float(functions.speeds(step.states((0.0, 1.0))).max(initial=1.0 / time)) < BRIEF
    looks = (1.0,) if is_brief and before[-1] >= NEAR else _LOOKS
    states = step.estimates((0.0, *looks))
    values = np.concatenate([before[None], functions(states[1:])])
    events: list[Event] = []
    turning = functions.turns(states, length * np.diff(looks, prepend=0.0))
    if turning.any() or functions.sign_changes(values[:-1], values[1:]).any():
        events = _find_exactly(functions, before, step, looks)
    if sheet is not None:
        return _with_rank_loss(functions, events, before, step, sheet), values[-1], values[:, -1]
    count = int(length * functions.speeds(states).mean() / BETWEEN)
    return events, values[-1], values[:, -1] if count < len(values) else functions.ratios(step, count)


def may_touch_zero(values: Array, near: float) -> bool:
    """Return whether a function like |t − t₀| may come to zero between equidistant values of it, or below ``near``."""
    lowest = int(values.argmin())
    if lowest and values[lowest] < near:
        return True
    change = float(np.abs(np.diff(values)).max())
    return bool((values[1:] + values[:-1]).min() <= 1.5 * change)


def _with_rank_loss(
    functions: EventFunctions, events: list[Event], before: Array, step: Step, sheet: Sheet
) -> list[Event]:
    """Return events with the rank losses of the closures that a motion on a sheet comes to in this step.

    The determinants of type I and type II vanish there too, with or without a change of sign: both are events.
    """
    places = step.states(_POINTS)
    ratios = functions.rank(places)
    if not may_touch_zero(ratios, LOST):
        return events
    # what starts at a rank loss has not come to it, what ends there has
    first, last = (_TURN if ratio <= LOST else 0.0 for ratio in (before[-1], ratios[-1]))
    roots = sheet.rank_losses(_POINTS, places[:, : functions.nq])
    near = np.sort(roots.real[(np.abs(roots.imag) < _TURN) & (roots.real > -first) & (roots.real <= 1.0 + last)])
    near = near[np.diff(near, prepend=-np.inf) > _TURN]
    losses, times = ([step.time(min(x, 1.0)) for x in some.tolist()] for some in (near, near[near > first]))
    same, singular = _SAME * (step.end - step.start), ("closure_rank", *functions.determinants)
    events = [
        event
        for event in events
        if event.kind not in functions.determinants or all(abs(event.t - t) > same for t in losses)
    ]
    indices = [functions.kinds.index(kind) for kind in singular]
    return _until_terminal([*events, *(event for t in times for event in functions.events(indices, t, step(t)))])


def _until_terminal(events: list[Event]) -> list[Event]:
    """Return events in order of time, up to the first terminal one."""
    events.sort(key=lambda event: event.t)
    return events[: next((i for i, event in enumerate(events) if event.terminal), len(events)) + 1]


def _find_exactly(functions: EventFunctions, before: Array, step: Step, looks: Sequence[float]) -> list[Event]:
    """Return the events on the integrator's interpolant, which costs more."""
    ends = [0.0, *looks]
    turning = functions.turns(step.states(ends), np.diff(ends) * (step.end - step.start))
    turns = [
        brentq(lambda x, i=i: functions.approach(step.at(x)[None])[0, i], ends[part], ends[part + 1], xtol=_TURN)
        for part, i in np.argwhere(turning)
    ]
    ends = sorted([*ends, *turns])
    values = np.concatenate([before[None], functions(step.states(ends[1:]))])
    changes = np.argwhere(functions.sign_changes(values[:-1], values[1:])).tolist()
    roots = [(i, _root(functions, step, i, ends[part], ends[part + 1])) for part, i in changes]
    return _until_terminal([event for i, t in roots for event in functions.events([i], t, step(t))])


def _root(functions: EventFunctions, step: Step, index: int, left: float, right: float) -> float:
    """Return the time at which a function changes sign between two fractions of a step."""

    def value(fraction: float) -> float:
        return float(functions(step.at(fraction)[None])[0, index])

    at_left, at_right = value(left), value(right)
    if at_left * at_right < 0.0:
        # secants crawl towards a root of third order or more
        fraction = brentq(value, left, right, xtol=1e-14, rtol=1e-14, maxiter=10_000)
    else:  # zero to machine precision at one end: it starts or ends there
        fraction = left if abs(at_left) <= abs(at_right) else right
    return step.time(fraction)
