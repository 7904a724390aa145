"""What figures over time draw of a plan, a simulation or efforts of one's own: one kind of curves."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray, IntArray, assign, require_type, runs
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
        bounds: (m, 2) smallest and largest main efforts, N or N·m, infinite for none; () where none are known.
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
    status: IntArray
    bounds: ArrayLike = ()
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
        """Times, s, of the samples with main efforts before and behind each interval of samples without."""
        last = len(self.t) - 1
        return tuple(
            (float(self.t[max(start - 1, 0)]), float(self.t[min(stop, last)]))
            for start, stop in runs(np.asarray(~np.isfinite(self.tau).all(axis=1)))
        )


def curves_of(subject: Plan | Simulation | Curves, robot: Robot | None = None) -> Curves:
    """Return the curves of a plan or a simulation, or curves as they are.

    Singular instants and the threshold of a plan come from its planner. A simulation whose robot is not given loads it;
    without its files, condition and margin are NaN.
    """
    if isinstance(subject, Curves):
        return subject
    require_type(
        subject,
        (Plan, Simulation),
        "A plan, a simulation or curves",
        "Pass load_plan(...), load_simulation(...) or rp.plot.curves(robot, reduced, efforts).",
    )
    own: dict[str, Any]
    if isinstance(subject, Plan):
        limits, parameters = subject.limits.judged_by, subject.parameters
        threshold = parameters.get("threshold") if parameters.get("measure") == "condition" else None
        planner, status = (text.replace("_", " ") for text in (subject.planner, subject.status.value))
        own = {
            "title": f"{subject.robot.name}: {planner}, {status}",
            "bounds": np.outer(limits.effort, [-1.0, 1.0]),
            "limits": limits.of_carriers,
            "condition": subject.condition,
            "margin": subject.margin,
            "status": subject.sample_status,
            "instants": subject.findings.singular_instants,
            "thresholds": (float(threshold),) if isinstance(threshold, (int, float)) else (),
        }
    else:
        own = {"title": run_title(subject), "limits": subject.robot.carrier_limits}
        own |= dict.fromkeys(("condition", "margin"), np.full(len(subject), np.nan))
        own["status"] = np.full(len(subject), SampleStatus.OK)  # the efforts are those that acted
        with suppress(PlanFileError):
            classes = classify(robot_of_record(subject.robot, robot), subject.q)
            own |= {"condition": classes.condition, "margin": classes.parallel_margin}
    return Curves(
        t=subject.t,
        tau=subject.tau,
        carrier_force=subject.carrier_force,
        carriers=subject.carriers,
        **own,
        **_joints(subject.robot),
    )


def curves_of_plan(plan: Plan) -> Curves:
    """Return the curves of a plan."""
    require_type(plan, Plan, "A plan", "Pass load_plan(...).")
    return curves_of(plan)


_DRIVES = {
    "Constant": "constant efforts",
    "FeedForward": "open loop",
    "ComputedTorque": "computed torque",
    "TimeVaryingLqr": "LQR",
}


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
    return Curves(
        title=robot.name if title is None else title,
        t=reduced.t,
        tau=efforts.tau,
        carrier_force=reduced.carrier_force,
        carriers=sliding,
        limits=robot.carrier_limits,
        condition=efforts.condition,
        margin=efforts.margin,
        status=efforts.status,
        instants=tuple(crossing.t for crossing in crossings),
        thresholds=tuple(thresholds),
        bounds=bounds,
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
