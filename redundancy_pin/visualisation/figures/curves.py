"""What figures over time draw of a plan, a simulation or an inverse-dynamics computation: one kind of curves."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray, IntArray, require_type, runs, stretches
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
        status: (N,) a ``SampleStatus`` each.
        main_names, carrier_names: of the joints, for legends.
        bounds: (m, 2) smallest and largest main efforts, N or N·m, infinite for none; () where none are known.
        instants: singular instants, s.
        thresholds: condition numbers that mean something to the motion.
        phases: (name, start, end) of each interval of one phase of a plan, s; () if there are fewer than two phases.
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
    status: IntArray
    main_names: tuple[str, ...]
    carrier_names: tuple[str, ...]
    bounds: ArrayLike = ()
    carriers_turn: bool = False
    instants: tuple[float, ...] = ()
    thresholds: tuple[float, ...] = ()
    phases: tuple[tuple[str, float, float], ...] = ()

    @property
    def regular(self) -> BoolArray:
        """(N,) samples that are neither near-singular nor singular: effort axes are scaled to these."""
        return np.asarray(self.status == SampleStatus.OK)

    @property
    def windows(self) -> tuple[tuple[float, float], ...]:
        """First and last time, s, of each interval of samples below the near-singular margin."""
        near = runs(self.margin < NEAR_SINGULAR_MARGIN)
        return tuple((float(self.t[start]), float(self.t[stop - 1])) for start, stop in near)

    @property
    def without_efforts(self) -> tuple[tuple[float, float], ...]:
        """Times, s, of the samples before and after each interval of samples without main efforts."""
        last = len(self.t) - 1
        return tuple(
            (float(self.t[max(start - 1, 0)]), float(self.t[min(stop, last)]))
            for start, stop in runs(np.asarray(~np.isfinite(self.tau).all(axis=1)))
        )


def curves_of(subject: Plan | Simulation | Curves, robot: Robot | None = None) -> Curves:
    """Return the curves of a plan or a simulation, or curves as they are.

    Singular instants, phases and the threshold of a plan come from its planner. A simulation whose robot is not given
    loads it; without its files, condition and margin are NaN.
    """
    if isinstance(subject, Curves):
        return subject
    require_type(
        subject,
        (Plan, Simulation),
        "A plan, a simulation or curves",
        "Pass rp.load_plan(...), rp.simulation.load_simulation(...) or rp.plot.curves(robot, reduced, efforts).",
    )
    if isinstance(subject, Plan):
        limits, parameters, t = subject.limits.judged_by, subject.parameters, subject.t
        threshold = parameters.get("threshold") if parameters.get("measure") == "condition" else None
        planner, status = (text.replace("_", " ") for text in (subject.planner, subject.status.value))
        return replace(
            _recorded(subject, f"{subject.robot.name}: {planner}, {status}", limits.of_carriers),
            bounds=np.outer(limits.effort, [-1.0, 1.0]),
            condition=subject.condition,
            margin=subject.margin,
            status=subject.sample_status,
            instants=subject.findings.singular_instants,
            thresholds=(float(threshold),) if isinstance(threshold, (int, float)) else (),
            phases=() if len(subject.phases) < 2 else tuple(
                (subject.phases[int(subject.phase[a])].replace("_", " "), float(t[a]), float(t[min(b, len(t) - 1)]))
                for a, b in stretches(subject.phase)
            ),
        )  # fmt: skip
    drawn = _recorded(subject, run_title(subject), subject.robot.carrier_limits)
    with suppress(PlanFileError):
        classes = classify(robot_of_record(subject.robot, robot), subject.q)
        drawn = replace(drawn, condition=classes.condition, margin=classes.parallel_margin)
    return drawn


def _recorded(subject: Plan | Simulation, title: str, limits: tuple[CarrierLimits, ...]) -> Curves:
    """Return the samples of a plan or a simulation, with unknown condition and margin."""
    main_unit, turn = _kinds(subject.robot)
    unknown = np.full(len(subject.t), np.nan)
    return Curves(
        title,
        subject.t,
        subject.tau,
        main_unit,
        subject.carrier_force,
        subject.carriers,
        limits,
        condition=unknown,
        margin=unknown,
        status=np.full(len(subject.t), SampleStatus.OK),
        carriers_turn=turn,
        main_names=subject.robot.actuated,
        carrier_names=subject.robot.carriers,
    )


_CONTROLLERS = {
    "Constant": "constant efforts",
    "FeedForward": "open loop",
    "ComputedTorque": "computed torque",
    "TimeVaryingLqr": "LQR",
}


def run_title(run: Simulation, controller: str | None = None) -> str:
    """Return one line: robot, controller (as the simulation has it, when left out), and how it ended."""
    if controller is None:
        named = str(run.parameters.get("drive", ""))
        controller = _CONTROLLERS.get(named, named.replace("_", " "))
    ended = run.status.value.replace("_", " ")
    last = run.events[-1] if run.events else None
    if last is not None and last.terminal:
        ended = f"stopped at {last.t:.4g} s: {last.name}"
    elif run.status is ResultStatus.NOT_CONVERGED:
        ended = f"failed at {run.t[-1]:.4g} s"
    return f"{run.robot.name}: simulation{f', {controller}' if controller else ''}, {ended}"


def curves(
    robot: Robot,
    reduced: ReducedDynamics,
    efforts: Distribution,
    carriers: CarrierMotion | None = None,
    *,
    crossings: Sequence[Crossing] = (),
    thresholds: Sequence[float] = (),
    title: str | None = None,
    bounds: ArrayLike = (),
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
        bounds: (m, 2) smallest and largest main efforts that ``distribute`` was given, N or N·m, infinite for none.

    Raises:
        InputError: parts of different length, or bounds that do not fit the actuators.

    Example:
        >>> robot, motion = rp.load_robot("3rrr"), rp.trajectory.reference.corner().sample(0.05)
        >>> result = rp.inverse_dynamics(robot, motion)
        >>> figure = rp.plot.efforts(rp.plot.curves(robot, result.reduced, result.efforts))
    """
    samples = len(reduced.t)
    sliding = CarrierMotion.parked(samples, robot.k) if carriers is None else carriers
    if len(efforts) != samples or len(sliding) != samples or sliding.s.shape[1] != robot.k:
        raise InputError(
            f"{samples} samples of dynamics do not fit {len(efforts)} of efforts and carriers of shape "
            f"{sliding.s.shape}.",
            remedy="Pass what belongs to one motion.",
        )
    ends = np.asarray(bounds, dtype=float)
    if ends.shape not in ((0,), (robot.m, 2)) or np.isnan(ends).any():
        raise InputError(
            f"Bounds of shape {ends.shape} do not fit {robot.m} actuators, or are not numbers.",
            remedy=f"Pass {robot.m} rows of a smallest and a largest effort, infinite for none.",
        )
    main_unit, turn = _kinds(robot_record(robot))
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
        status=efforts.status,
        bounds=bounds,
        carriers_turn=turn,
        instants=tuple(crossing.t for crossing in crossings),
        thresholds=tuple(thresholds),
        main_names=robot.actuated,
        carrier_names=robot.carriers,
    )


def _kinds(record: RobotRecord) -> tuple[str, bool]:
    """Return kind and unit of the main efforts, and whether all carriers turn."""
    unit = record.effort_unit(*record.actuated)
    kind = {"N": "force", "N·m": "torque"}.get(unit, "effort")
    return f"{kind} [{unit}]", bool(record.carriers) and set(record.carriers) <= set(record.rotating)


def plan_title(plan: Plan) -> str:
    """Return one line: robot, planner, status, and which limits of which joints are broken."""
    violated = plan.limits.violated if plan.status is ResultStatus.LIMIT_VIOLATED else ()
    joints = {
        quantity: dict.fromkeys(event.joint for event in violated if event.quantity == quantity)
        for quantity in sorted({event.quantity for event in violated})
    }
    broken = "; ".join(f"{quantity} of {', '.join(names)}" for quantity, names in joints.items())
    optimal = "" if plan.findings.optimal else ", NOT an optimum"
    return f"{curves_of(plan).title}{optimal}{f' ({broken})' if broken else ''}"
