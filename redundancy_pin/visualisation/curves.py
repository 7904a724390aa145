"""What the plots of one motion draw: a plan's curves, or those of an inverse-dynamics computation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array, BoolArray
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.dynamics.status import Distribution, SampleStatus
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.singular_crossings import Crossing
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import CarrierLimits, Robot
from redundancy_pin.visualisation.style import words


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
    return Curves(
        title=f"{plan.robot.name}: {plan.planner.replace('_', ' ')}, {words(plan.status.value)}",
        t=plan.t,
        tau=plan.tau,
        main_unit=_unit(tuple(name in plan.robot.rotating for name in plan.robot.actuated)),
        carrier_force=plan.carrier_force,
        carriers=plan.carriers,
        limits=plan.limits.judged_by,
        condition=plan.condition,
        margin=plan.margin,
        regular=plan.sample_status == SampleStatus.REGULAR,
        carriers_turn=bool(plan.robot.carriers) and set(plan.robot.carriers) <= set(plan.robot.rotating),
        instants=_numbers(plan.diagnostics.get("singular_instants")),
        thresholds=_numbers([threshold]),
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
    turning = tuple(not _slides(robot, name) for name in robot.actuated)
    return Curves(
        title=robot.name if title is None else title,
        t=reduced.t,
        tau=efforts.tau,
        main_unit=_unit(turning),
        carrier_force=reduced.carrier_force,
        carriers=sliding,
        limits=robot.carrier_limits,
        condition=efforts.condition,
        margin=efforts.margin,
        regular=efforts.status == SampleStatus.REGULAR,
        carriers_turn=bool(robot.carriers) and not any(_slides(robot, name) for name in robot.carriers),
        instants=tuple(crossing.t for crossing in crossings),
        thresholds=tuple(thresholds),
    )


def _slides(robot: Robot, name: str) -> bool:
    return str(robot.model.joints[robot.model.getJointId(name)].shortname()).startswith("JointModelP")


def _unit(turning: tuple[bool, ...]) -> str:
    if not any(turning):
        return "force [N]"
    return "torque [N·m]" if all(turning) else "effort [N or N·m]"


def _numbers(values: object) -> tuple[float, ...]:
    """Return the numbers of a list in plain data; none where it is something else."""
    listed = values if isinstance(values, (list, tuple)) else ()
    return tuple(float(value) for value in listed if isinstance(value, (int, float)))
