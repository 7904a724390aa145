"""What figures over time draw of a plan, a simulation or efforts of one's own: one kind of curves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray, assign, require_type, runs
from redundancy_pin.dynamics.distribution import Distribution
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import InputError, PlanFileError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import RobotRecord, robot_of_record, robot_record
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.simulation.result import Simulation
from redundancy_pin.singularities.classify import classify
from redundancy_pin.singularities.crossings import Crossing
from redundancy_pin.status import ResultStatus, SampleStatus


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
        main_names, carrier_names: of the joints, for legends; numbered where left out.
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
    main_names: tuple[str, ...] = ()
    carrier_names: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        """Number the joints that have no names."""
        main, moved = self.tau.shape[1], self.carrier_force.shape[1]
        assign(self, main_names=self.main_names or tuple(f"actuator {i + 1}" for i in range(main)))
        assign(self, carrier_names=self.carrier_names or tuple(f"carrier {i + 1}" for i in range(moved)))

    @property
    def windows(self) -> tuple[tuple[float, float], ...]:
        """First and last time, s, of each stretch of samples below the near-singular margin."""
        near = runs(self.margin < NEAR_SINGULAR_MARGIN)
        return tuple((float(self.t[start]), float(self.t[stop - 1])) for start, stop in near)


def curves_of_plan(plan: Plan) -> Curves:
    """Return the curves of a plan; singular instants and threshold where its planner names them."""
    require_type(plan, Plan, "A plan", "Pass load_plan(...).")
    threshold = plan.parameters.get("threshold") if plan.parameters.get("measure") == "condition" else None
    return Curves(
        title=f"{plan.robot.name}: {plan.planner.replace('_', ' ')}, {plan.status.value.replace('_', ' ')}",
        t=plan.t,
        tau=plan.tau,
        carrier_force=plan.carrier_force,
        carriers=plan.carriers,
        limits=plan.limits.judged_by.of_carriers,
        condition=plan.condition,
        margin=plan.margin,
        regular=plan.sample_status == SampleStatus.OK,
        instants=plan.findings.singular_instants,
        thresholds=(float(threshold),) if isinstance(threshold, (int, float)) else (),
        **_joints(plan.robot),
    )


def curves_of_run(run: Simulation, robot: Robot | None = None) -> Curves:
    """Return the curves of a simulation; without its robot at hand, it is loaded.

    A robot whose files are gone leaves condition and margin unknown: NaN.
    """
    condition = margin = np.full(len(run), np.nan)
    try:
        classes = classify(robot_of_record(run.robot, robot), run.q)
        condition, margin = classes.condition, classes.parallel_margin
    except PlanFileError:
        pass
    return Curves(
        title=run_title(run),
        t=run.t,
        tau=run.tau,
        carrier_force=run.carrier_force,
        carriers=run.carriers,
        limits=run.robot.carrier_limits,
        condition=condition,
        margin=margin,
        regular=np.ones(len(run), dtype=bool),  # the efforts are those that acted
        **_joints(run.robot),
    )


_DRIVES = {"FeedForward": "open loop", "ComputedTorque": "computed torque", "TimeVaryingLqr": "LQR"}


def run_title(run: Simulation, drive: str | None = None) -> str:
    """Return one line: robot, what drove it (as the simulation has it, when left out), and how it ended."""
    if drive is None:
        named = str(run.parameters.get("drive", ""))
        drive = _DRIVES.get(named, named.replace("_", " "))
    ended = run.status.value.replace("_", " ")
    last = run.events[-1] if run.events else None
    if last is not None and last.terminal:
        ended = f"stopped at {last.t:.4g} s: {last.name}"
    elif run.status is ResultStatus.NOT_CONVERGED:
        ended = f"failed at {run.t[-1]:.4g} s"
    return f"{run.robot.name}: simulation{f', {drive}' if drive else ''}, {ended}"


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
    return Curves(
        title=robot.name if title is None else title,
        t=reduced.t,
        tau=efforts.tau,
        carrier_force=reduced.carrier_force,
        carriers=sliding,
        limits=robot.carrier_limits,
        condition=efforts.condition,
        margin=efforts.margin,
        regular=efforts.status == SampleStatus.OK,
        instants=tuple(crossing.t for crossing in crossings),
        thresholds=tuple(thresholds),
        **_joints(robot_record(robot)),
    )


def _joints(record: RobotRecord) -> dict[str, Any]:
    """Return names of the joints, kind and unit of the main efforts, and whether all carriers turn."""
    unit = record.effort_unit(*record.actuated)
    kind = {"N": "force", "N·m": "torque"}.get(unit, "effort")
    turn = bool(record.carriers) and set(record.carriers) <= set(record.rotating)
    names = {"main_names": record.actuated, "carrier_names": record.carriers}
    return {**names, "main_unit": f"{kind} [{unit}]", "carriers_turn": turn}


def plan_title(plan: Plan) -> str:
    """Return one line: robot, planner, status, and which limits of which joints are broken."""
    title = curves_of_plan(plan).title
    if not plan.findings.optimal:
        title = f"{title}, NOT an optimum"
    if plan.status is not ResultStatus.LIMIT_VIOLATED:
        return title
    broken: dict[str, list[str]] = {}
    for name in dict.fromkeys((*plan.robot.carriers, *(event.joint for event in plan.limits.violated))):
        for quantity in sorted({event.quantity for event in plan.limits.violated if event.joint == name}):
            broken.setdefault(quantity, []).append(name)
    parts = [f"{quantity} of {', '.join(of)}" for quantity, of in broken.items()]
    return f"{title} ({'; '.join(parts)})"


def curves_of(subject: Plan | Simulation | Curves, robot: Robot | None = None) -> Curves:
    """Return the curves of a plan or a simulation, whose robot may be given, or curves as they are."""
    if isinstance(subject, Plan):
        return curves_of_plan(subject)
    if isinstance(subject, Simulation):
        return curves_of_run(subject, robot)
    if not isinstance(subject, Curves):
        raise InputError(
            f"This figure draws a plan, a simulation or curves, not a {type(subject).__name__}.",
            remedy="Pass a plan, a simulation, or rp.plot.curves(robot, reduced, efforts).",
        )
    return subject
