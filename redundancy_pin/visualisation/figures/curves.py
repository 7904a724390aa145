"""One motion with its efforts, of a plan or of an inverse-dynamics computation, and the panels that show it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.dynamics.distribution import Distribution, SampleStatus
from redundancy_pin.errors import InputError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.plan import Plan, PlanStatus
from redundancy_pin.planners.robot_record import RobotRecord, robot_record
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.singularities.crossings import Crossing
from redundancy_pin.visualisation.figures.time_panels import Panel, condition_panel, series


@dataclass(frozen=True, eq=False)
class Curves:
    """One motion with its efforts. N samples, m main actuators, k carriers.

    Attributes:
        title: one line.
        t: (N,) time, s.
        tau: (N, m) main efforts, N or N·m; NaN where there are none.
        main_unit: of the main efforts, such as ``"torque [N·m]"``.
        carrier_force: (N, k) efforts of the carriers' actuators, N.
        carriers: N samples of the carrier motion, m; rad where they turn.
        carriers_turn: whether they do.
        limits: (k,) limits of the carriers.
        condition: (N,) condition number of the scaled W.
        margin: (N,) smallest singular value of the scaled W.
        regular: (N,) samples that are neither near-singular nor singular: effort axes are scaled to these.
        instants: singular instants, s.
        thresholds: condition numbers that mean something to the motion.
    """

    title: str
    t: Array
    tau: Array
    main_unit: str
    carrier_force: Array
    carriers: CarrierMotion
    limits: tuple[CarrierLimits, ...]
    condition: Array
    margin: Array
    regular: BoolArray
    carriers_turn: bool = False
    instants: tuple[float, ...] = ()
    thresholds: tuple[float, ...] = ()

    @property
    def windows(self) -> tuple[tuple[float, float], ...]:
        """First and last time, s, of each stretch of samples below the near-singular margin."""
        edges = np.flatnonzero(np.diff(np.concatenate([[False], self.margin < NEAR_SINGULAR_MARGIN, [False]])))
        return tuple(
            (float(self.t[start]), float(self.t[stop - 1])) for start, stop in zip(edges[::2], edges[1::2], strict=True)
        )


def curves_of_plan(plan: Plan) -> Curves:
    """Return the curves of a plan; singular instants and threshold where its planner names them."""
    threshold = plan.parameters.get("threshold") if plan.parameters.get("measure") == "condition" else None
    main_unit, carriers_turn = _units(plan.robot)
    return Curves(
        title=f"{plan.robot.name}: {plan.planner.replace('_', ' ')}, {plan.status.value.replace('_', ' ')}",
        t=plan.t,
        tau=plan.tau,
        main_unit=main_unit,
        carrier_force=plan.carrier_force,
        carriers=plan.carriers,
        limits=plan.limits.judged_by,
        condition=plan.condition,
        margin=plan.margin,
        regular=plan.sample_status == SampleStatus.REGULAR,
        carriers_turn=carriers_turn,
        instants=numbers(plan.diagnostics.get("singular_instants")),
        thresholds=numbers([threshold]),
    )


def curves(
    robot: Robot,
    reduced: ReducedDynamics,
    efforts: Distribution,
    carriers: CarrierMotion | None = None,
    *,
    crossings: Sequence[Crossing] = (),
    thresholds: Sequence[float] = (),
    title: str | None = None,
) -> Curves:
    """Return the curves of an inverse-dynamics computation.

    Args:
        robot: the robot.
        reduced: from ``dynamics.reduce``.
        efforts: from ``distribute``.
        carriers: what ``reduced`` was computed with; parked at zero when left out.
        crossings: from ``find_crossings`` along the same motion: where the singular instants are.
        thresholds: condition numbers to mark.
        title: the robot's name when left out.

    Raises:
        InputError: parts of different length.
    """
    samples = len(reduced.t)
    sliding = CarrierMotion.parked(samples, robot.k) if carriers is None else carriers
    if len(efforts) != samples or len(sliding) != samples or sliding.s.shape[1] != robot.k:
        raise InputError(
            f"{samples} samples of dynamics do not fit {len(efforts)} of efforts and carriers of shape "
            f"{sliding.s.shape}.",
            remedy="Pass what belongs to one motion.",
        )
    main_unit, carriers_turn = _units(robot_record(robot))
    return Curves(
        title=robot.name if title is None else title,
        t=reduced.t,
        tau=efforts.tau,
        main_unit=main_unit,
        carrier_force=reduced.carrier_force,
        carriers=sliding,
        limits=robot.carrier_limits,
        condition=efforts.condition,
        margin=efforts.margin,
        regular=efforts.status == SampleStatus.REGULAR,
        carriers_turn=carriers_turn,
        instants=tuple(crossing.t for crossing in crossings),
        thresholds=tuple(thresholds),
    )


def _units(record: RobotRecord) -> tuple[str, bool]:
    """Return kind and unit of the main efforts, and whether all carriers turn."""
    unit = record.effort_unit(*record.actuated)
    kind = {"N": "force", "N·m": "torque"}.get(unit, "effort")
    return f"{kind} [{unit}]", bool(record.carriers) and set(record.carriers) <= set(record.rotating)


def numbers(values: object) -> tuple[float, ...]:
    """Return the numbers of a list in a plan's diagnostics or parameters; none where it is something else."""
    listed = values if isinstance(values, (list, tuple)) else ()
    return tuple(float(value) for value in listed if isinstance(value, (int, float)))


def plan_title(plan: Plan) -> str:
    """Return one line: robot, planner, status, and which limits of which carriers are broken."""
    title = curves_of_plan(plan).title
    if not plan.diagnostics.get("optimal", True):
        title = f"{title}, NOT an optimum"
    if plan.status is not PlanStatus.VIOLATES_LIMITS:
        return title
    broken: dict[str, list[str]] = {}
    for i, name in enumerate(plan.robot.carriers):
        for quantity in sorted({event.quantity for event in plan.limits.violated if event.carrier == name}):
            broken.setdefault(quantity, []).append(str(i + 1))
    parts = [f"{quantity} of carrier{'s'[: len(of) > 1]} {', '.join(of)}" for quantity, of in broken.items()]
    return f"{title} ({'; '.join(parts)})"


def curves_of(subject: Plan | Curves) -> Curves:
    """Return the curves of a plan, or curves as they are."""
    if isinstance(subject, Plan):
        return curves_of_plan(subject)
    if not isinstance(subject, Curves):
        raise InputError(
            f"This figure draws a plan or curves, not a {type(subject).__name__}.",
            remedy="Pass a plan, or rp.plot.curves(robot, reduced, efforts).",
        )
    return subject


def main_panel(drawn: Curves) -> Panel:
    """Return the main efforts; near a singularity they may leave the picture."""
    names = [f"τ{i + 1}" for i in range(drawn.tau.shape[1])]
    return Panel(f"main {drawn.main_unit}", series(names, drawn.t, drawn.tau, fitted=drawn.regular), height=1.3)


def force_panel(drawn: Curves, events: Sequence[LimitEvent] = ()) -> Panel:
    """Return the efforts of the carriers; ``events`` are limits to mark as broken."""
    unit, limits = "torque [N·m]" if drawn.carriers_turn else "force [N]", [each.force for each in drawn.limits]
    return _carrier_panel(drawn, unit, "force", drawn.carrier_force, [(-limit, limit) for limit in limits], events)


def singularity_panel(drawn: Curves) -> Panel:
    """Return the condition number with its thresholds."""
    return condition_panel(drawn.t, drawn.condition, drawn.thresholds, singular=bool(drawn.instants))


def carrier_panels(drawn: Curves, events: Sequence[LimitEvent] = ()) -> list[Panel]:
    """Return panels of position, speed and acceleration of the carriers; ``events`` are limits to mark as broken."""
    unit, motion, limits = "rad" if drawn.carriers_turn else "m", drawn.carriers, drawn.limits
    return [
        _carrier_panel(drawn, label, quantity, values, edges, events)
        for label, quantity, values, edges in (
            (f"position s [{unit}]", "track", motion.s, [(each.lower, each.upper) for each in limits]),
            (f"speed ṡ [{unit}/s]", "speed", motion.sd, [(-each.speed, each.speed) for each in limits]),
            (f"acceleration s̈ [{unit}/s²]", "acceleration", motion.sdd,
             [(-each.acceleration, each.acceleration) for each in limits]),
        )
    ]  # fmt: skip


def _carrier_panel(
    drawn: Curves, label: str, quantity: str, values: Array, limits: ArrayLike, events: Sequence[LimitEvent]
) -> Panel:
    names = [f"carrier {i + 1}" for i in range(values.shape[1])]
    broken = [event for event in events if event.quantity == quantity]
    marks = tuple((event.worst, event.value, f"{event.amount:.2g} beyond") for event in broken)
    return Panel(f"carrier {label}", series(names, drawn.t, values, carrier=True), limits=limits, marks=marks)
