"""A planned motion as a function of time: tree, platform, carriers and the efforts that belong to it.

Between samples a plan is a continuous motion, and its efforts are τ = W⁻¹ f of that motion: to interpolate the efforts
of the samples would be another, wrong, command. The inverse dynamics are evaluated for all pieces at once and kept as
Chebyshev series, so that a simulation can ask for any instant in microseconds.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, read_only
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.continuous_motion import TimedTrajectory, continuous_motion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.plan_file import load_robot_of
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.inverse import inverse_dynamics
from redundancy_pin.simulation.planned_carriers import (
    actuators_off,
    apart,
    planned_carriers,
    planned_platform,
    smooth_pieces,
)
from redundancy_pin.simulation.series import Series

DEGREE = 9
"""Of the series in each piece. A step of 5 ms of a motion that changes within 50 ms leaves 1e-14."""

BESIDE = 0.3
"""Part of a piece next to a singular instant in which τ = W⁻¹ f magnifies rounding and is not evaluated."""

DEGREE_BESIDE = 5
"""Of τ in the pieces at a singular instant, from the rest of the piece and the τ that the plan states there."""

POLE = 1e-2
"""Last coefficients of the efforts in a piece, relative to the largest, from which they have a pole there."""

SINGULAR = 1e-6
"""Margin of W, relative to the largest along the motion, below which a sample of a plan counts as singular."""


@dataclass(frozen=True, eq=False)
class ReferencePoint:
    """A planned motion at one instant.

    Attributes:
        t: time, s.
        x: (n,) platform coordinates, m and rad, or a pose (4, 4).
        xd, xdd: (n,) their rates.
        s, sd, sdd: (k,) carrier motion.
        q, v, a: (nq,), (nv,), (nv,) tree configuration, velocity and acceleration, carriers included.
        tau: (m,) main efforts, N or N·m.
        carrier_force: (k,) forces of the carriers' actuators, N.
    """

    t: float
    x: Array
    xd: Array
    xdd: Array
    s: Array
    sd: Array
    sdd: Array
    q: Array
    v: Array
    a: Array
    tau: Array
    carrier_force: Array


class MotionReference:
    """A motion of platform and carriers with the efforts that belong to it, as a function of time.

    Made by ``plan_reference`` or ``motion_reference``.

    Attributes:
        robot: the robot whose efforts these are.
        start, end: first and last time, s.
        edges: (P + 1,) ends of the pieces, s; efforts may jump or kink there and nowhere else.
        jumps: (j,) those of the inner edges, s, at which efforts jump; at the others their slope does.
        carrier_lag: (k,) see ``PlannedCarriers.lag``.
        effort_deviation: largest distance from the finite efforts that the plan states at its samples, N or N·m; what
            its own discretisation costs. NaN without a plan.
    """

    def __init__(
        self, robot: Robot, edges: Array, series: dict[str, Array], is_pose: bool, carrier_lag: Array, deviation: float
    ) -> None:
        self.robot = robot
        self.edges = edges
        self.start, self.end = float(edges[0]), float(edges[-1])
        self.carrier_lag, self.effort_deviation = carrier_lag, deviation
        self._is_pose = is_pose
        self._loads, self._carriers, self._platform, self._tree = (
            Series(edges, series[name]) for name in ("loads", "carriers", "platform", "tree")
        )
        self.jumps = self._loads.jumps()

    def loads(self, t: float) -> tuple[Array, Array]:
        """Return main efforts (m,) and carrier forces (k,) at time t; outside the motion those at its ends."""
        both = self._loads(t)
        return both[: self.robot.m], both[self.robot.m :]

    def carriers(self, t: float) -> tuple[Array, Array, Array]:
        """Return s, ṡ, s̈ (k,) at time t."""
        s, sd, sdd = self._carriers(t).reshape(3, -1)
        return s, sd, sdd

    def platform(self, t: float) -> tuple[Array, Array, Array]:
        """Return x, (n,) or a pose (4, 4), ẋ and ẍ (n,) at time t."""
        flat = self._platform(t)
        n = self.robot.n
        x = flat[: -2 * n]
        return (x.reshape(4, 4) if self._is_pose else x), flat[-2 * n : -n], flat[-n:]

    def tree(self, t: float) -> tuple[Array, Array, Array]:
        """Return q (nq,), v and a (nv,) at time t."""
        flat = self._tree(t)
        nv = self.robot.model.nv
        return flat[: -2 * nv], flat[-2 * nv : -nv], flat[-nv:]

    def at(self, t: float) -> ReferencePoint:
        """Return everything at time t, s."""
        return ReferencePoint(t, *self.platform(t), *self.carriers(t), *self.tree(t), *self.loads(t))


def plan_reference(plan: Plan, *, robot: Robot | None = None, motion: TimedTrajectory | None = None) -> MotionReference:
    """Return the continuous motion that a plan stands for.

    Args:
        plan: from any planner.
        robot: its robot; loaded from the plan when left out.
        motion: the trajectory that was planned for, for exact values between the samples; else quintics through x, ẋ, ẍ
            of the samples, whose acceleration is off by O(Δt⁴).

    Raises:
        InputError: the motion is not that of the plan.
        InfeasiblePlanError: some instant has no finite efforts.
        PlanFileError: the robot cannot be loaded, or is no longer what it was.
    """
    machine = load_robot_of(plan) if robot is None else robot
    source = planned_platform(plan, motion)
    carriers = planned_carriers(plan)
    edges = smooth_pieces(carriers, source)
    off = actuators_off(plan, edges)
    singular = np.flatnonzero(plan.margin <= SINGULAR * plan.margin.max())
    known = {float(plan.t[i]): np.asarray(plan.tau[i]) for i in singular if np.isfinite(plan.tau[i]).all()}
    reference = _build(machine, edges, source.sample_at, carriers, known, off, carriers.lag)
    stated = np.isfinite(plan.tau).all(axis=1) & ~_beside_jump(plan.t)
    # a sample belongs to the step that it ends, and the first one to none: a plan by steps may set off with a jump
    stated[0] = False
    before = np.nextafter(plan.t, -np.inf)
    deviation = max(
        (float(np.abs(reference.loads(float(before[i]))[0] - plan.tau[i]).max()) for i in np.flatnonzero(stated)),
        default=float("nan"),
    )
    reference.effort_deviation = deviation
    return reference


def motion_reference(
    robot: Robot,
    motion: TimedTrajectory | PlatformMotion,
    carriers: ArrayLike = 0.0,
    *,
    step: float = 0.01,
) -> MotionReference:
    """Return a platform motion with parked carriers as a reference, with its efforts.

    Args:
        robot: the robot.
        motion: a trajectory, or samples with quintics between them.
        carriers: scalar or (k,) where the carriers are parked, m.
        step: longest piece, s, of the series that represent it.

    Raises:
        InfeasiblePlanError: some instant has no finite efforts.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as inverse dynamics.
    """
    if not step > 0.0:
        raise InputError(f"step is {step} s.", remedy="Pass a positive number.")
    source = continuous_motion(motion)
    own = np.unique(np.concatenate([[source.start], source.breaks, source.knots, [source.end]]))
    parts = [np.linspace(a, b, max(2, int(np.ceil((b - a) / step)) + 1)) for a, b in itertools.pairwise(own)]
    edges = apart(np.concatenate(parts))
    place = np.broadcast_to(np.asarray(carriers, dtype=float), (robot.k,))

    def parked(times: Array) -> CarrierMotion:
        return CarrierMotion.parked(len(times), robot.k, place)

    off = np.zeros(len(edges) - 1, dtype=bool)
    return _build(robot, edges, source.sample_at, parked, {}, off, np.zeros(robot.k))


def _build(
    robot: Robot,
    edges: Array,
    platform: Callable[[Array], PlatformMotion],
    carriers: Callable[[Array], CarrierMotion],
    known: dict[float, Array],
    off: BoolArray,
    lag: Array,
) -> MotionReference:
    """Evaluate inverse dynamics at the nodes of all pieces at once and turn them into series."""
    nodes = np.sort(chebyshev.chebpts1(DEGREE + 1))
    to_series = np.linalg.inv(chebyshev.chebvander(nodes, DEGREE))
    left, right = edges[:-1], edges[1:]
    times = (0.5 * (left + right)[:, None] + 0.5 * (right - left)[:, None] * nodes).ravel()
    motion, along = platform(times), carriers(times)
    found = inverse_dynamics(robot, motion, along)
    efforts = distribute(found.reduced).tau
    shape = (len(left), DEGREE + 1, -1)

    def series(*parts: Array) -> Array:
        values = np.concatenate([part.reshape(len(times), -1) for part in parts], axis=1).reshape(shape)
        return read_only(np.einsum("dn,pnc->pdc", to_series, values))

    tau = efforts.reshape(len(left), DEGREE + 1, robot.m).copy()
    tau[off] = 0.0
    of_tau = np.einsum("dn,pnc->pdc", to_series, tau)
    for t, value in known.items():
        for piece in np.flatnonzero((left == t) | (right == t)):
            if not off[piece]:
                of_tau[piece] = _beside(nodes, tau[piece], value, at_left=bool(left[piece] == t))
    _require_finite(of_tau, left)
    of_force = np.einsum("dn,pnc->pdc", to_series, found.reduced.carrier_force.reshape(shape))
    return MotionReference(
        robot,
        read_only(edges),
        {
            "loads": read_only(np.concatenate([of_tau, of_force], axis=2)),
            "carriers": series(along.s, along.sd, along.sdd),
            "platform": series(motion.x, motion.xd, motion.xdd),
            "tree": series(found.q, found.v, found.a),
        },
        motion.is_pose,
        lag,
        float("nan"),
    )


def _beside(nodes: Array, tau: Array, value: Array, *, at_left: bool) -> Array:
    """Return (d, m) the series of τ in a piece with a singular instant at one end, from the rest of it and τ there."""
    end = -1.0 if at_left else 1.0
    kept = np.abs(nodes - end) > 2.0 * BESIDE
    x = np.append(nodes[kept], end)
    fitted = chebyshev.chebfit(x, np.vstack([tau[kept], value]), DEGREE_BESIDE)
    result = np.zeros((DEGREE + 1, tau.shape[1]))
    result[: DEGREE_BESIDE + 1] = fitted
    return result


def _require_finite(series: Array, left: Array) -> None:
    size = np.abs(series).max(initial=0.0, where=np.isfinite(series))
    bad = ~np.isfinite(series).all(axis=(1, 2)) | (np.abs(series[:, -2:]).max(axis=(1, 2)) > POLE * size)
    if bad.any():
        t = float(left[int(np.flatnonzero(bad)[0])])
        raise InfeasiblePlanError(
            f"In the step from t = {t:.6g} s on, the motion has no finite efforts.",
            remedy="It meets a type II singularity that it may not cross: plan it with plan_whole_trajectory.",
            constraint="effort",
            time=t,
        )


def _beside_jump(t: Array) -> BoolArray:
    """Return (N,) which samples are one of two at the same instant."""
    same = np.diff(t) == 0.0
    result: BoolArray = np.append(same, False) | np.append(False, same)
    return result
