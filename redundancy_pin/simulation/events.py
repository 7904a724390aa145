"""Event detection: ends of tracks and joints, stretched legs, lost control, found where they are within a step.

An event is a zero of a scalar function of the configuration. Each step is looked at on the cubic through its ends,
which takes no evaluation of the dynamics; where a function changes sign there, its root is found on the integrator's
own interpolant. A sign that changes twice between two looks does not show; for the stops, which must not be missed, the
turning points of the joints are looked at too.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
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
"""Kinds that stand for a stop: only leaving the allowed side counts."""

RELEASE = "release"
"""Kind of the event at which a stop lets go of a joint that it held."""

_ROUNDING = 1e-12
"""Values of functions other than stops, which have no unit, that are taken for zero at the start."""

_HELD = 0.9
"""Part of its slack by which a joint that starts at its limit may exceed it: a run then stops within the slack."""

_NOT_AT = 1e-3
"""Part of its slack that a joint at a stop that pushes is from where it leaves it: more than rounding, and too little
to creep."""

_UNLIMITED = 1e6
"""rad, or characteristic lengths; URDF writers put large numbers where there is no limit."""

_LOOKS = (0.25, 0.5, 0.75, 1.0)
"""Where in a step the functions are looked at."""

BRIEF = 0.02
"""rad; where joints move less than this in a step, at the speeds of its ends, only its end is looked at, and where they
turn back. A tenth of ``BETWEEN``."""

BETWEEN = 0.2
"""rad; no joint of the pose moves farther than this from look to look at the rank of the closures."""

_SAME = 2e-3
"""Share of a step to which the time of a zero of third order is known: a hundred cube roots of 1e-14, the rounding of a
determinant."""

_TURN = 1e-6
"""Part of a step to which it is known where a joint turns back: what it moves meanwhile is of second order in it. Rank
losses that are nearer to each other are one."""

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
    """The scalar functions of a robot whose zeros are events, with their kinds and names; the stops come first.

    Joints that are at a limit at the ``start`` (nq,) may exceed it by nearly its slack. ``push_back`` are kinds of
    stops that do: a step ends there, whatever ``stop_at`` says. ``at`` and ``held`` are indices of stops: joints at the
    first may be beyond them at the start, by as much as an integration step was off, and cannot leave the others.
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
        labels, stops, slack = _stops(robot)
        self.stops, self.slack, self.held = stops, slack, list(held)
        self._position, self.columns = stops[:2].astype(np.intp)
        self.side, self._bound = stops[2:]
        self._limit = self._bound.copy()
        # a joint that starts at its limit is within it, however it was rounded, and may stay there
        at_limit = np.abs(self.side * (self._bound - start[self._position])) <= slack
        self._bound += np.where(at_limit, _HELD * self.side * slack, 0.0)
        beyond = np.maximum(self.side * (start[self._position] - self._bound) + _NOT_AT * slack, 0.0)
        self._bound[list(at)] += (self.side * beyond)[list(at)]
        self._bound[self.held] = np.inf * self.side[self.held]
        legs = 0 if robot.working_modes is None else len(robot.working_modes.joints)
        self._by_legs = legs > 0
        self._square = robot.m == robot.n
        labels += [("type_I", f"leg {i + 1}") for i in range(legs)] or [("type_I", "type_I")]
        labels += [("type_II", "type_II")] if self._square else []
        labels += [("closure_rank", "closures")]
        self.kinds, self.names = (tuple(part) for part in zip(*labels, strict=True))
        self.pushes = np.array([kind in push_back for kind in self.kinds])
        self._terminal = np.array([kind in stop_at for kind in self.kinds]) | self.pushes
        self._one_sided = np.array([kind in ONE_SIDED for kind in self.kinds])
        self._chain, self._columns = chain, chain.pose_columns
        self._unit = chain.system.step_unit
        self._actuated = np.eye(robot.model.nv)[robot.actuated_velocity][:, self._columns]
        self._still = np.zeros(robot.model.nv)

    def __call__(self, q: Array) -> Array:
        """Return (N, w) the functions at (N, nq) configurations, which takes less time than one by one."""
        chain, columns, count = self._chain, self._columns, len(q)
        p, r = len(columns), chain.rows
        # [J_c; S], whose determinant is zero where actuators do not hold the platform, and [J_c; J_x]
        # determinants, for their signs: a singular value only dips to zero, and a root needs a change of sign
        by_actuators, by_platform, rows = np.empty((count, p, p)), np.empty((count, p, p)), np.empty((count, r, p))
        for i, one in enumerate(q):
            chain.update(one, self._still)
            by_platform[i] = K = chain.matrix()
            rows[i] = K[:r]
            if self._square:
                by_actuators[i, :r], by_actuators[i, r:] = rows[i], self._actuated
        parts = [self.side * (self._bound - q.take(self._position, 1))]
        type_i = mode_indicator(chain.robot, q) if self._by_legs else np.linalg.det(by_platform)[:, None]
        parts.append(type_i)
        if self._square:
            parts.append(np.linalg.det(by_actuators)[:, None])
        # a ratio of singular values has no sign: it touches zero where rank is lost, at roots of any multiplicity
        parts.append(rank_ratio(rows)[:, None])
        return np.concatenate(parts, axis=1)

    def at_start(self, q: Array) -> Array:
        """Return (w,) the functions at the start (nq,), rounding taken for zero.

        A machine that starts at a stop stops again if it goes on outward, whichever way its position was rounded; and
        one that starts at a singular pose has not come to it.

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
        result: BoolArray = self.side * (self._limit - q.take(self._position)) <= self.slack
        return result

    def sign_changes(self, before: Array, after: Array) -> BoolArray:
        """Return (..., w) which functions changed sign, or came to zero, between two points of time.

        A stop is passed where its function turns negative; leaving zero is an event for stops only.
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
        away, rate = self.side * (self._bound - y.take(self._position, 1)), self.approach(y)
        reach = length[:, None] * np.maximum(np.abs(rate[:-1]), np.abs(rate[1:]))
        turning: BoolArray = (rate[:-1] < 0.0) & (rate[1:] > 0.0) & (np.minimum(away[:-1], away[1:]) < reach)
        return turning

    def travel(self, states: Array, length: float) -> float:
        """Return about how far, rad, the fastest joint of the pose moves in a step of some length, s.

        ``states`` (L, nq + nv) are its states at equidistant looks.
        """
        speeds = np.abs(states[:, self.nq + self._columns]) / self._unit
        return length * float(speeds.max(axis=1).mean())

    def is_brief(self, step: Step, time: float) -> bool:
        """Return whether joints hardly move in a step, by the speeds at its ends, or by the time scale, s."""
        ends = np.array([step(step.start), step(step.end)])
        speed = float((np.abs(ends[:, self.nq + self._columns]) / self._unit).max(initial=1.0 / time))
        return (step.end - step.start) * speed < BRIEF

    def ratios(self, step: Step, count: int) -> Array:
        """Return (count + 1,) the ratio of singular values of the closures at equidistant looks at a step."""
        states = np.array([step.at(fraction) for fraction in np.linspace(0.0, 1.0, count + 1).tolist()])
        return self(states[:, : self.nq])[:, -1]

    def least_rank(self, step: Step) -> float:
        """Return the smallest ratio of singular values of the closures within a step, to 1e-6 of the step."""

        def ratio(fraction: float) -> float:
            return float(self(step.at(fraction)[None, : self.nq])[0, -1])

        travel = self.travel(np.array([step.at(fraction) for fraction in (0.0, *_LOOKS)]), step.end - step.start)
        looks = np.linspace(0.0, 1.0, 33 + int(travel / BETWEEN))
        lowest = int(np.argmin(self.ratios(step, len(looks) - 1)))
        ends = looks[max(lowest - 1, 0)], looks[min(lowest + 1, len(looks) - 1)]
        return float(minimize_scalar(ratio, bounds=ends, method="bounded", options={"xatol": 1e-6}).fun)

    @property
    def determinants(self) -> tuple[str, ...]:
        """Kinds whose functions are determinants with the closure rows in them."""
        return (*(() if self._by_legs else ("type_I",)), *(("type_II",) if self._square else ()))

    def rank_loss(self, t: float, y: Array) -> list[Event]:
        """Return the events at a rank loss of the closure rows in use, for the state y (nq + nv) there."""
        kinds = ("closure_rank", *self.determinants)
        return [event for kind in kinds for event in self.zero(self.kinds.index(kind), t, y)]

    def zero(self, index: int, t: float, y: Array) -> list[Event]:
        """Return the event of one of the functions at a zero of it, for the state y (nq + nv) there.

        There is none where the closure rows in use lose rank and dependent rows restore it.
        """
        if self.kinds[index] in ("closure_rank", *self.determinants):
            self._chain.place(y[: self.nq])
            if self._chain.dependent_rows_restore_rank():
                return []
        return [Event(self.kinds[index], self.names[index], t, bool(self._terminal[index]))]


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


def cubic_weights(fractions: Sequence[float]) -> Array:
    """Return (N, 4) weights of y, h ẏ at the start and h ẏ, y at the end of a step of length h in Hermite's cubic."""
    x = np.array(fractions)
    late = x * x * (3.0 - 2.0 * x)
    return np.stack([1.0 - late, x * (1.0 - x) ** 2, -x * x * (1.0 - x), late], axis=1)


_WEIGHTS = cubic_weights((0.0, *_LOOKS))
_WEIGHTS_OF_ENDS = cubic_weights((0.0, 1.0))


class Step:
    """An accepted step of an integrator, as a function of time; good until the integrator is changed or goes on.

    ``before`` is y and ẏ at the start of the step.
    """

    def __init__(self, solver: OdeSolver, before: tuple[Array, Array]) -> None:
        self.start, self.end = float(solver.t_old), float(solver.t)
        self._solver, self._before = solver, before
        self._after: tuple[Array, Array] = (solver.y, solver.f)

    @cached_property
    def _dense(self) -> Callable[[float], Array]:
        # three more evaluations: made only where something needs it
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

    def estimates(self, weights: Array) -> Array:
        """Return (N, nq + nv) y on the cubic through both ends, at the fractions whose ``cubic_weights`` are given."""
        (y0, f0), (y1, f1) = self._before, self._after
        h = self.end - self.start
        states: Array = weights.dot(np.array([y0, h * f0, h * f1, y1]))
        return states


def find_events(
    functions: EventFunctions, before: Array, step: Step, time: float, sheet: Sheet | None = None
) -> tuple[list[Event], Array, Array]:
    """Return the events in a step in order of time, up to the first terminal one, and the functions (w,) at its end.

    Also the ratios (L,) of singular values of the closures at its start, at equidistant looks and at its end.
    ``before`` (w,) are the functions at the start, ``time`` is the time scale of the motion, s, ``sheet`` what the
    motion is on where the closures lose rank.
    """
    fine = not functions.is_brief(step, time) or before[-1] < NEAR
    looks, weights = (_LOOKS, _WEIGHTS) if fine else (_LOOKS[-1:], _WEIGHTS_OF_ENDS)
    states = step.estimates(weights)
    values = np.concatenate([before[None], functions(states[1:, : functions.nq])])
    same_signs = bool((values[:-1] * values[1:] > 0.0).all())  # nearly always, and quickly seen
    if (same_signs or not functions.sign_changes(values[:-1], values[1:]).any()) and not _turns(
        functions, step, states, looks
    ).any():
        events: list[Event] = []
    else:
        events = _find_exactly(functions, before, step, looks)
    if sheet is not None:
        return _with_rank_loss(functions, events, before, step, sheet), values[-1], values[:, -1]
    count = int(functions.travel(states, step.end - step.start) / BETWEEN)
    return events, values[-1], values[:, -1] if count < len(values) else functions.ratios(step, count)


def may_touch_zero(values: Array, near: float) -> bool:
    """Return whether a function like |t − t₀| may come to zero between equidistant looks at it, or below ``near``."""
    lowest = int(values.argmin())
    if lowest and values[lowest] < near:
        return True
    change = float(np.abs(np.diff(values)).max())
    return bool((values[1:] + values[:-1]).min() <= 1.5 * change)


def _with_rank_loss(
    functions: EventFunctions, events: list[Event], before: Array, step: Step, sheet: Sheet
) -> list[Event]:
    """Return events with the rank losses of the closures that a motion on a sheet comes to in this step.

    The determinants of type I and type II vanish there too, as often as rank is lost, and with a sign or without: they
    are events there whatever their sign does.
    """
    places = np.array([step.at(fraction)[: functions.nq] for fraction in _POINTS])
    ratios = functions(places)[:, -1]
    if not may_touch_zero(ratios, LOST):
        return events
    # what starts at a rank loss has not come to it, what ends there has
    first, last = (_TURN if ratio <= LOST else 0.0 for ratio in (before[-1], ratios[-1]))
    roots = sheet.rank_losses(_POINTS, places)
    near = np.sort(roots.real[(np.abs(roots.imag) < _TURN) & (roots.real > first) & (roots.real <= 1.0 + last)])
    times = [step.time(min(x, 1.0)) for x in near[np.diff(near, prepend=-np.inf) > _TURN].tolist()]
    others = [
        event
        for event in events
        if event.kind not in functions.determinants
        or all(abs(event.t - t) > _SAME * (step.end - step.start) for t in times)
    ]
    return _until_terminal([*others, *(event for t in times for event in functions.rank_loss(t, step(t)))])


def _until_terminal(events: list[Event]) -> list[Event]:
    """Return events in order of time, up to the first terminal one."""
    events.sort(key=lambda event: event.t)
    return events[: next((i for i, event in enumerate(events) if event.terminal), len(events)) + 1]


def _turns(functions: EventFunctions, step: Step, states: Array, looks: Sequence[float]) -> BoolArray:
    return functions.turns(states, np.diff(looks, prepend=0.0) * (step.end - step.start))


def _find_exactly(functions: EventFunctions, before: Array, step: Step, looks: Sequence[float]) -> list[Event]:
    """Find events on the integrator's own interpolant, which costs more."""
    ends = [0.0, *looks]
    turning = _turns(functions, step, np.array([step.at(x) for x in ends]), looks)
    turns = [
        brentq(lambda x, i=i: functions.approach(step.at(x)[None])[0, i], ends[part], ends[part + 1], xtol=_TURN)
        for part, i in np.argwhere(turning)
    ]
    ends = sorted([*ends, *turns])
    after = functions(np.array([step.at(x) for x in ends[1:]])[:, : functions.nq])
    values = np.concatenate([before[None], after])
    changes = np.argwhere(functions.sign_changes(values[:-1], values[1:])).tolist()
    roots = [(i, _root(functions, step, i, ends[part], ends[part + 1])) for part, i in changes]
    return _until_terminal([event for i, t in roots for event in functions.zero(i, t, step(t))])


def _root(functions: EventFunctions, step: Step, index: int, left: float, right: float) -> float:
    """Return the time at which a function changes sign between two fractions of a step."""

    def value(fraction: float) -> float:
        return float(functions(step.at(fraction)[None, : functions.nq])[0, index])

    at_left, at_right = value(left), value(right)
    if at_left * at_right < 0.0:
        # secants crawl towards a root of third order or more
        fraction = brentq(value, left, right, xtol=1e-14, rtol=1e-14, maxiter=10_000)
    else:  # zero to rounding at one end: it starts or ends there
        fraction = left if abs(at_left) <= abs(at_right) else right
    return step.time(fraction)
