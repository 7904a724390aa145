"""Efforts of one sample with a status, for control loops: ``distribute`` without the cost of many samples.

The decisions and their tolerances are those that ``distribute`` takes for many samples.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from redundancy_pin.arrays import LARGEST, NEAR_SINGULAR_MARGIN, RANK_TOLERANCE, Array, lapack, read_only
from redundancy_pin.dynamics.allocation import FORCE_TOLERANCE
from redundancy_pin.dynamics.arguments import SampleArguments, SampleArrays, one_sample, sample_arrays, track_excess
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import CONSISTENCY_TOLERANCE
from redundancy_pin.dynamics.results import ReducedSample, Sample, TorqueSample
from redundancy_pin.errors import RedundancyPinError, SingularPoseError, UnreachablePoseError, WorkingModeError
from redundancy_pin.robot import Robot
from redundancy_pin.robot.joint_ranges import is_in_range, track_slack
from redundancy_pin.robot.loads import wrench_values
from redundancy_pin.robot.scales import column_scale, force_sizes, row_scale
from redundancy_pin.spectrum import UNIT
from redundancy_pin.status import SampleStatus

REFUSALS = (UnreachablePoseError, SingularPoseError, WorkingModeError)
"""What kinematics raises for a sample that it cannot close; ``refusal_of`` gives their statuses."""


def without_answer(robot: Robot, status: SampleStatus, residual: float = math.nan) -> TorqueSample:
    """Return a sample without W: NaN, a status, and the closure residual, m."""
    return TorqueSample(np.full(robot.m, np.nan), status, math.nan, np.full(robot.k, np.nan), residual)


class Refusal(NamedTuple):
    """Why kinematics do not solve a sample: a status, and the closure residual, m, or NaN."""

    status: SampleStatus
    residual: float = math.nan


def refusal_of(error: RedundancyPinError) -> Refusal:
    """Return the status and residual for one of the errors ``REFUSALS``."""
    if isinstance(error, UnreachablePoseError):
        residual = error.details.get("residual")
        return Refusal(SampleStatus.UNREACHABLE, residual if isinstance(residual, float) else math.nan)
    return Refusal(SampleStatus.TYPE_I if isinstance(error, SingularPoseError) else SampleStatus.BRANCH_LOST)


def is_finite(given: Sequence[Array], t: float) -> bool:
    """Return whether all numbers of a sample are finite, and not beyond 1e100, as in a ``PlatformMotion``."""
    return abs(t) <= LARGEST and bool((np.abs(np.concatenate(given, axis=None)) <= LARGEST).all())


@lru_cache(maxsize=64)
def _unit_of_W(robot: Robot) -> Array:
    """Return (n, m) the units of W: W times it is D_x⁻¹ W D_a, see ``Distribution``."""
    return read_only(column_scale(robot) / row_scale(robot)[:, None])


def solve_sample(
    robot: Robot, sample: ReducedSample, q: Array, kinematics: tuple[float, float], given: SampleArrays, t: float
) -> TorqueSample:
    """Return the efforts of one sample with a status, for a backend that solves the configuration.

    Args:
        robot: the robot.
        sample: W (n, m), f (n,) and carrier forces (k,).
        q: (nq,) configuration, m and rad; ranges are checked with the carriers at s.
        kinematics: closure residual of q, m, and lower bound of the distance to type I.
        given: arguments of the sample.
        t: time, s, for wrenches that depend on it.

    Example:
        >>> import redundancy_pin as rp
        >>> robot = rp.load_robot("five_bar")
        >>> given = sample_arrays(robot, ([0.2, 0.4], [0.5, 0.0], [0.0, 1.0], (), (), ()))
        >>> sample = rp.RneaDynamics(robot).sample(*given)
        >>> solve_sample(robot, sample, robot.q_reference, (0.0, 1.0), given, 0.0).status.label
        'ok'
    """
    if robot.k:
        q = q.copy()
        q[robot.carrier_position] = given[3]

    def force_size() -> float:
        x, xd, xdd, _, sd, sdd = (part[None] for part in given)
        return float(force_sizes(robot, xd, xdd, sd, sdd, wrench_values(robot.loads, np.array([t]), x, xd))[0])

    return _balance(robot, sample, force_size, is_in_range(robot, q), kinematics)


def solve_reduced_sample(dynamics: Dynamics, given: SampleArguments, t: float) -> TorqueSample:
    """Return the efforts of one sample with a status, for a backend with ``reduce`` only: a closed form.

    Args:
        dynamics: the backend.
        given: arguments of the sample.
        t: time, s, for wrenches that depend on it.

    Raises:
        InputError: wrong shapes, or a matrix that is not a pose.
    """
    robot = dynamics.robot
    if not is_finite(sample_arrays(robot, given), t):
        return without_answer(robot, SampleStatus.NOT_FINITE)
    motion, carriers = one_sample(robot, given, t)
    try:
        one = dynamics.along(motion).reduce(carriers)
    except REFUSALS as error:
        return without_answer(robot, *refusal_of(error))
    in_range = not np.any(one.out_of_range) and bool((track_excess(robot, carriers) <= track_slack(robot)).all())
    sample = Sample(one.W[0], one.f[0], one.carrier_force[0])
    size = 0.0 if one.force_size is None else float(one.force_size[0])
    return _balance(robot, sample, lambda: size, in_range, (float(one.residual[0]), math.nan))


def _balance(
    robot: Robot,
    sample: ReducedSample,
    force_size: Callable[[], float],
    in_range: bool,
    kinematics: tuple[float, float],
) -> TorqueSample:
    """Return the efforts of least norm with W τ = f (Parsa 2014, eqs. 2.17 and 2.53, with W = Jᵀ), or a status.

    Args:
        robot: the robot.
        sample: W, f and carrier forces.
        force_size: returns the size of the forces before they cancel, N; called where W does not reach all of f.
        in_range: whether all joints are in their ranges, carriers too.
        kinematics: closure residual, m, and lower bound of the distance to type I.
    """
    A, g = sample.W * _unit_of_W(robot), sample.f / row_scale(robot)
    size = math.hypot(*g.tolist())  # whose squares do not overflow
    u, values, vt, failed = lapack().dgesdd(A)
    if failed or not math.isfinite(size):
        return without_answer(robot, SampleStatus.NOT_FINITE)
    sizes = values.tolist()
    smallest, margin = RANK_TOLERANCE * max(sizes[0], UNIT), sizes[-1]
    rank = sum(value > smallest for value in sizes)
    components = g @ u
    outside, full = components[rank:], rank == len(sizes)
    if len(outside):
        allowed = CONSISTENCY_TOLERANCE * size + FORCE_TOLERANCE * force_size()
        if math.hypot(*outside.tolist()) > allowed:
            status = SampleStatus.UNDERACTUATED if full else SampleStatus.SINGULAR_INCONSISTENT
            return TorqueSample(np.full(robot.m, np.nan), status, margin, sample.carrier_force, *kinematics)
    tau = column_scale(robot) * ((components[:rank] / values[:rank]) @ vt[:rank])
    if not in_range:
        status = SampleStatus.OUT_OF_RANGE
    elif not full:
        status = SampleStatus.SINGULAR_CONSISTENT
    else:
        status = SampleStatus.NEAR_SINGULAR if margin < NEAR_SINGULAR_MARGIN else SampleStatus.OK
    return TorqueSample(tau, status, margin, sample.carrier_force, *kinematics)
