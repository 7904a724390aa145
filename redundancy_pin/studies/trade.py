"""What one quantity costs in another: a Pareto front of whole-trajectory plans of one motion.

Points are found by bounds (ε-constraint): y is minimised while x may not exceed a bound, for bounds from the least x
(or a thousandth of the largest, where that is more) to what x is where nothing but y counts. Unlike weights that finds
concave parts of a front as well. Where y is least without any x, the front is that one point.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Frozen, one_of, whole
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.planners.base_wrench import load_at_rest
from redundancy_pin.planners.optimal import OBJECTIVES
from redundancy_pin.planners.plan import Plan
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.case import Case, Plans
from redundancy_pin.studies.cases import at_speed
from redundancy_pin.studies.measures import numbers
from redundancy_pin.studies.table import Record, Table, table
from redundancy_pin.visualisation.figures.comparisons import TradeCurve, plot_trade_off

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MINIMISED = tuple(name for name in OBJECTIVES if name != "tracking")
"""What may be minimised."""

BOUNDED = (*MINIMISED, "track", "time")
"""What may be bounded: objectives, the length of the tracks, and the duration of the motion."""

_SHARES = {"track": (0.1, 1.0), "time": (0.6, 2.0)}
"""Of the machine's own tracks, and of the motion's own duration, by default."""

_LEAST = 5e-3
"""Fraction above the least x at which the front begins: at it the carriers have no choice left."""

_SPAN = 1e-3
"""Of the largest bound: below it x is nothing, as where parked carriers are the least of it."""

_ANY = 1e6
"""A bound that bounds nothing, over the value of the other end: it makes the plan report the quantity."""

_NOTHING = 1e-11
"""Of the size of an objective, below which it is zero: what the barrier of the optimiser leaves of squares is 2e-12."""

_DOMINATED = 1e-6
"""Relative difference that counts as rounding."""


@dataclass(frozen=True, eq=False)
class TradeOff(Frozen):
    """A front.

    Attributes:
        case: what was planned.
        x, y: the quantities: x is bounded, y minimised.
        points: a record each, from the tightest bound to the loosest: ``bound``, ``x``, ``y``, what else the plan costs
            (peak effort, energies, force of carriers and on the base, stroke, duration), ``status``, ``dominated`` by
            another point, and ``reason`` where there is no plan.
    """

    case: Case
    x: str
    y: str
    points: tuple[Record, ...]

    @property
    def front(self) -> tuple[Record, ...]:
        """The points that have a plan and that no other is better than in both."""
        return tuple(point for point in self.points if point["reason"] is None and not point["dominated"])

    def table(self) -> Table:
        """Return all points."""
        return table("front", self.points, f"{self.y} (y) against {self.x} (x)")

    def draw(self) -> Figure:
        """Draw the front, and what does not lie on it as marks."""
        others = [point for point in self.points if point["reason"] is None and point["dominated"]]
        marks = {f"dominated ({i + 1})": (point["x"], point["y"]) for i, point in enumerate(others[:4])}
        along = np.array([(point["x"], point["y"]) for point in self.front]).reshape(-1, 2)
        curve = TradeCurve(self.case.title or self.case.name, "", along, marks, (self.x, self.y), "a bound")
        return plot_trade_off(f"{self.y} against {self.x}", [curve])


def trade_off(
    case: Case,
    x: str,
    y: str,
    *,
    points: int = 9,
    between: tuple[float, float] | None = None,
    backend: str | None = None,
    jobs: int = 1,
    tell: Callable[[str], None] = lambda _: None,
    plans: Plans | None = None,
) -> TradeOff:
    """Return the front of two quantities.

    Args:
        case: robot, trajectory and options of the whole-trajectory planner; its objective is y.
        x: what is bounded (``BOUNDED``).
        y: what is minimised (``MINIMISED``).
        points: number of bounds.
        between: lowest and highest bound: of an objective in its unit; of "track" and "time" as shares of the machine's
            own tracks and of the motion's own duration.
        backend: what plans; the case's first when left out.
        jobs: processes; -1 for all cores.
        tell: called with the name of each plan.
        plans: plans made earlier.

    Raises:
        InputError: an unknown quantity, twice the same, bounds that are none, a motion whose time cannot be changed.
        InfeasiblePlanError: the motion has no plan at all.
    """
    one_of(x, "x", BOUNDED)
    one_of(y, "y", MINIMISED)
    if x == y:
        raise InputError(f"Both quantities are {x}.", remedy="Trade one for another.", name=x)
    whole(points, "points", 2, 1000)
    if between is not None and not 0.0 < between[0] < between[1] < np.inf:
        raise InputError(f"The bounds are {between}.", remedy="Give a lower and a higher number above zero.")
    made = plans or Plans()
    by = backend or case.backends[0]
    least_y = replace(case, planner="whole_trajectory", name=f"{case.name}-least-{y}").with_options(objective=y)
    if x in _SHARES:
        shares = np.geomspace(*(between or _SHARES[x]), points)
        varied = [_shared(least_y, x, float(share)) for share in shares]
        bounds = [float(share) for share in shares]
    else:
        least_x = replace(least_y, name=f"{case.name}-least-{x}").with_options(objective=x)
        ends = [one.with_options(at_most={of: _ANY}) for one, of in ((least_x, y), (least_y, x))]
        if between is None:
            made.prepare([(one, by) for one in ends], jobs, tell)
            low, high = (_value(made.plan(one, by), x) for one in ends)
            low = max(low * (1.0 + _LEAST), _SPAN * high)
        else:
            low, high = between
        space = np.geomspace if high > 3.0 * low > 0.0 else np.linspace
        bounds = [float(bound) for bound in space(low, max(high, low * (1.0 + _LEAST)), points)]
        varied = [
            replace(least_y, name=f"{case.name}-{x}-{bound:.4g}").with_options(at_most={x: bound}) for bound in bounds
        ]
        if high == 0.0:  # y is least where there is nothing of x: the front is that point
            bounds, varied = [0.0], [ends[1]]
    made.prepare([(one, by) for one in varied], jobs, tell)
    records = [
        trade_record(one, made.outcome(one, by), x, y, bound, by) for one, bound in zip(varied, bounds, strict=True)
    ]
    if all(record["reason"] is not None for record in records):
        made.plan(varied[-1], by)
    return TradeOff(case, x, y, tuple(judge_front(records)))


def _shared(case: Case, x: str, share: float) -> Case:
    """Return a case with a share of its tracks, or at another speed."""
    named = replace(case, name=f"{case.name}-{x}-{share:.4g}")
    if x == "track":
        ends = case.option("track") or [(own.lower, own.upper) for own in case.dynamics().robot.carrier_limits]
        tracks = np.broadcast_to(np.asarray(ends, dtype=float), (case.dynamics().robot.k, 2))
        datum = np.broadcast_to(np.asarray(case.option("datum", 0.0), dtype=float), (len(tracks),))[:, None]
        return named.with_options(track=(datum + share * (tracks - datum)).tolist())
    speed = dict(case.path_options).get("speed")  # the planner has one as well, the carriers'
    if not isinstance(speed, float):
        raise InputError(
            f"The time of the {case.path} has no one speed that could be changed.",
            remedy="Name the speed of the trajectory, such as corner:speed=0.2.",
        )
    return at_speed(named, speed / share)


def _value(plan: Plan, name: str) -> float:
    values, sizes = (plan.diagnostics[key] for key in ("objective", "objective_size"))
    value, size = (float(of[name]) for of in (values, sizes))  # type: ignore[index]
    return value if abs(value) > _NOTHING * size else 0.0


def trade_record(case: Case, outcome: Plan | InfeasiblePlanError, x: str, y: str, bound: float, backend: str) -> Record:
    """Return one point of a front: the plan within a bound of ``x``, or why there is none."""
    record: Record = {
        "bound": bound,
        "x": bound,
        "y": None,
        "reason": None,
        "dominated": False,
        "status": ResultStatus.INFEASIBLE.value,
    }
    if isinstance(outcome, InfeasiblePlanError):
        return {**record, "reason": outcome.message}
    dynamics, carriers = case.dynamics(backend), outcome.carriers
    push = outcome.base_wrench(dynamics) - load_at_rest(dynamics, outcome.motion, carriers.s[0], np.zeros(3))
    stroke = float(np.ptp(carriers.s, axis=0).max())
    duration = float(outcome.t[-1] - outcome.t[0])
    known = {"track": stroke, "time": duration}
    shown = numbers(outcome)
    return {
        **record,
        "x": known[x] if x in known else _value(outcome, x),
        "y": _value(outcome, y),
        **{
            name: shown[name] for name in ("peak", "energy", "main_energy", "carrier_energy", "carrier_force", "status")
        },
        "base_force": float(np.linalg.norm(push[:, :3], axis=1).max()),
        "stroke": stroke,
        "duration": duration,
    }


def judge_front(records: list[Record]) -> list[Record]:
    """Return the records, with whether another is as good in x and y and better in one of them."""
    planned = [record for record in records if record["reason"] is None]

    def beaten(one: Record) -> bool:
        return any(
            other["x"] <= one["x"] * (1.0 + _DOMINATED) and other["y"] < one["y"] * (1.0 - _DOMINATED)
            for other in planned
            if other is not one
        )

    return [{**record, "dominated": record["reason"] is None and beaten(record)} for record in records]
