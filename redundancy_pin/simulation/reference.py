"""A planned motion as a function of time: tree, platform, carriers and the efforts that belong to it.

Between samples a plan is a continuous motion, and its efforts are τ = W⁻¹ f of that motion: to interpolate the efforts
of the samples would be another, wrong, command. The inverse dynamics are evaluated for all pieces at once and kept as
Chebyshev series, so that a simulation can ask for any instant in microseconds.

Inverse dynamics along a motion, batched: what a feed-forward needs, without a backend.

The simulation judges plans that a backend made, so it has its own.

The continuous motion that the samples of a plan stand for: platform, carriers, and when actuators are off.

Whoever plays a plan back, ``reference`` for this package's own simulation or ``engines.drive`` for an outside engine,
asks here, so that one plan is one motion.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
import pinocchio as pin
from numpy.polynomial import Chebyshev
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, BoolArray, read_only
from redundancy_pin.dynamics.base import ReducedDynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError, InputError
from redundancy_pin.kinematics.coordinates import column_scale, row_scale
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.plan_file import load_robot_of
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory.functions_of_time import (
    SHIFT,
    ContinuousMotion,
    PiecewisePolynomial,
    TimedTrajectory,
    carriers_at,
    chebyshev_series,
    chebyshev_times,
    continuous_motion,
)


@dataclass(frozen=True, eq=False)
class InverseDynamics:
    """The tree along a motion, and W τ = f.

    Attributes:
        q: (N, nq) configurations, carriers included.
        v, a: (N, nv) velocities and accelerations.
        reduced: f, W and carrier forces.
    """

    q: Array
    v: Array
    a: Array
    reduced: ReducedDynamics


def inverse_dynamics(robot: Robot, motion: PlatformMotion, carriers: CarrierMotion) -> InverseDynamics:
    """Return tree motion and reduced dynamics.

    Args:
        robot: the robot.
        motion: (N,) samples of the platform.
        carriers: (N, k) samples of the carriers.

    Raises:
        UnreachablePoseError, SingularPoseError, WorkingModeError: see ``kinematics.lift.lift``.
    """
    tree = lift(robot, motion)
    q, v, a = np.array(tree.q), np.array(tree.v), np.array(tree.a)
    q[:, robot.carrier_position] = carriers.s
    v[:, robot.carrier_velocity] = carriers.sd
    a[:, robot.carrier_velocity] = carriers.sdd
    model, data = robot.model, robot.model.createData()
    effort = np.array([pin.rnea(model, data, *row) for row in zip(q, v, a, strict=True)]).reshape(len(q), model.nv)
    reduced = ReducedDynamics(
        t=motion.t,
        f=read_only(np.einsum("nvi,nv->ni", tree.gamma, effort)),
        W=tree.W,
        carrier_force=read_only(effort[:, robot.carrier_velocity]),
        reachable=tree.reachable,
        gap=tree.gap,
        row_scale=row_scale(robot),
        column_scale=column_scale(robot),
    )
    return InverseDynamics(read_only(q), read_only(v), read_only(a), reduced)


_STEPPED = {"stepwise": ("optimise", "brake"), "switch_off": ("ramp_down", "off")}
"""Phases of planners whose ṡ and s̈ are backward differences of s."""


def planned_carriers(plan: Plan) -> PiecewisePolynomial:
    """Return the positions of the carriers of a plan as a function of time, continuous with their speeds.

    - Whole-trajectory plans: s̈ is linear in each step, as they were planned.
    - Steps of stepwise plans (and of switch-off plans by backward differences): s̈ is constant and has the plan's value
      at the end of the step; ṡ meets the plan's at every sample. s, integrated, lags behind the plan's by up to half a
      step, because backward differences move a carrier by its new speed. The lag is carried on, so that s stays
      continuous.
    - Everything else: the quintic through s, ṡ and s̈ at both ends, off by O(Δt⁴) in s̈.
    """
    s, sd, sdd = (np.asarray(part) for part in (plan.carriers.s, plan.carriers.sd, plan.carriers.sdd))
    if plan.planner == "whole_trajectory":
        return PiecewisePolynomial.linear_acceleration(plan.t, s, sd, sdd).made_continuous()
    left = np.flatnonzero(np.diff(plan.t) > 0.0)
    right = left + 1
    edges = np.append(plan.t[left], plan.t[-1])
    ends = [(s[i], sd[i], sdd[i]) for i in (left, right)]
    powers = PiecewisePolynomial.hermite(edges, *ends).coefficients.copy()
    stepped = _stepped(plan)[right]
    powers[:3, stepped] = 0.0
    powers[3, stepped] = 0.5 * sdd[right][stepped]
    return PiecewisePolynomial(read_only(edges), read_only(powers)).made_continuous()


def planned_platform(plan: Plan, trajectory: TimedTrajectory | None = None) -> ContinuousMotion:
    """Return the platform motion of a plan; where its carriers move on longer, the platform is held at its end.

    Args:
        plan: the plan.
        trajectory: the platform motion it was made for; quintics between the plan's samples when left out.

    Raises:
        InputError: the trajectory is not that of the plan.
    """
    source = continuous_motion(plan.motion if trajectory is None else trajectory)
    slack = _SAME_TIME * float(plan.t[-1] - plan.t[0])
    after = plan.t > source.end + slack
    if abs(source.start - plan.t[0]) > slack or source.end > plan.t[-1] + slack or plan.motion.xd[after].any():
        raise InputError(
            f"The plan runs from {plan.t[0]:.9g} to {plan.t[-1]:.9g} s, the trajectory to {source.end:.9g} s.",
            remedy="Pass the trajectory the plan was made for.",
        )
    return source.held_until(float(plan.t[-1])) if after.any() else source


def smooth_pieces(carriers: PiecewisePolynomial, platform: ContinuousMotion) -> Array:
    """Return (P + 1,) times, s, between which both motions of a plan are smooth: its samples, breaks and knots."""
    edges = np.concatenate([carriers.edges, platform.breaks, platform.knots])
    return apart(edges[(edges >= carriers.edges[0]) & (edges <= carriers.edges[-1])])


def apart(times: Array) -> Array:
    """Return times in order, those that differ from the one before by rounding left out, the first and last kept."""
    edges = np.unique(times)
    kept = np.append(np.diff(edges) > 1e-10 * (edges[-1] - edges[0]), True)
    kept[0] = True
    result: Array = edges[kept]
    return result


def actuators_off(plan: Plan, edges: Array) -> BoolArray:
    """Return (P,) the pieces between (P + 1,) edges, s, inside which a plan has its main actuators off.

    There its samples at both ends have no effort, one of them at least in the phase that is called so, and W τ = f of
    the planned motion holds with τ = 0 up to the plan's own residual: W⁻¹ f would magnify that. Two samples without
    effort alone do not say it: between two samples at rest there may be a motion that needs efforts.
    """
    after = np.searchsorted(plan.t, 0.5 * (edges[:-1] + edges[1:]))
    zero = (plan.tau == 0.0).all(axis=1)
    named = np.isin(plan.phase, [i for i, name in enumerate(plan.phases) if name == _OFF])
    off: BoolArray = zero[after - 1] & zero[after] & (named[after - 1] | named[after])
    return off


_OFF = "off"
"""Name of the phase in which a plan has its main actuators off."""

_SAME_TIME = 1e-9
"""How far, relative to the duration, plan and trajectory may differ in their times."""


def _stepped(plan: Plan) -> BoolArray:
    """Return (N,) whether the step that ends at a sample is one of backward differences."""
    names = _STEPPED.get(plan.planner, ())
    if plan.planner == "switch_off" and plan.parameters.get("scheme") != "backward_differences":
        names = ()
    codes = [i for i, name in enumerate(plan.phases) if name in names]
    stepped: BoolArray = np.isin(plan.phase, codes)
    return stepped


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
        carrier_lag: (k,) largest distance of the carriers from the samples of a plan, m: what backward differences
            leave.
        effort_deviation: largest distance from the finite efforts that the plan states at its samples, N or N·m; what
            its own discretisation costs. NaN without a plan.
    """

    def __init__(
        self,
        robot: Robot,
        edges: Array,
        series: dict[str, PiecewisePolynomial],
        is_pose: bool,
        carrier_lag: Array,
        deviation: float,
    ) -> None:
        self.robot = robot
        self.edges = edges
        self.start, self.end = float(edges[0]), float(edges[-1])
        self.carrier_lag, self.effort_deviation = carrier_lag, deviation
        self._is_pose = is_pose
        self._loads, self._carriers, self._platform, self._tree = (
            series[name] for name in ("loads", "carriers", "platform", "tree")
        )
        self.jumps = self._loads.jumps()

    def loads(self, t: float) -> tuple[Array, Array]:
        """Return main efforts (m,) and carrier forces (k,) at time t; outside the motion those at its ends."""
        both = self._loads.at(t)
        return both[: self.robot.m], both[self.robot.m :]

    def carriers(self, t: float) -> tuple[Array, Array, Array]:
        """Return s, ṡ, s̈ (k,) at time t."""
        s, sd, sdd = self._carriers.at(t).reshape(3, -1)
        return s, sd, sdd

    def platform(self, t: float) -> tuple[Array, Array, Array]:
        """Return x, (n,) or a pose (4, 4), ẋ and ẍ (n,) at time t."""
        flat = self._platform.at(t)
        n = self.robot.n
        x = flat[: -2 * n]
        return (x.reshape(4, 4) if self._is_pose else x), flat[-2 * n : -n], flat[-n:]

    def tree(self, t: float) -> tuple[Array, Array, Array]:
        """Return q (nq,), v and a (nv,) at time t."""
        flat = self._tree.at(t)
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
    lag = np.abs(carriers(plan.t) - plan.carriers.s).max(axis=0, initial=0.0)
    lag[lag < SHIFT] = 0.0
    reference = _build(machine, edges, source.sample_at, partial(carriers_at, carriers), known, off, lag)
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
    left, right = edges[:-1], edges[1:]
    times = chebyshev_times(edges, DEGREE)
    motion, along = platform(times), carriers(times)
    found = inverse_dynamics(robot, motion, along)
    efforts = distribute(found.reduced).tau
    shape = (len(left), DEGREE + 1, -1)

    def polynomials(*parts: Array) -> PiecewisePolynomial:
        values = np.concatenate([part.reshape(len(times), -1) for part in parts], axis=1).reshape(shape)
        return PiecewisePolynomial.from_values(edges, values)

    tau = efforts.reshape(shape).copy()
    tau[off] = 0.0
    for t, value in known.items():
        for piece in np.flatnonzero((left == t) | (right == t)):
            if not off[piece]:
                own = times.reshape(shape[:2])[piece] - t
                tau[piece] = _beside(own / (right - left)[piece], tau[piece], value)
    _require_finite(tau, left)
    return MotionReference(
        robot,
        read_only(edges),
        {
            "loads": polynomials(tau, found.reduced.carrier_force),
            "carriers": polynomials(along.s, along.sd, along.sdd),
            "platform": polynomials(motion.x, motion.xd, motion.xdd),
            "tree": polynomials(found.q, found.v, found.a),
        },
        motion.is_pose,
        lag,
        float("nan"),
    )


def _beside(distance: Array, tau: Array, value: Array) -> Array:
    """Return τ (d, m) in a piece with a singular instant at one end, from the rest of the piece and τ there.

    Args:
        distance: (d,) of the times in the piece from the instant, in lengths of the piece.
        tau: (d, m) W⁻¹ f there.
        value: (m,) at the instant.
    """
    kept = np.abs(distance) > BESIDE
    domain = [min(0.0, np.sign(distance[0])), max(0.0, np.sign(distance[0]))]
    x = np.append(distance[kept], 0.0)
    columns = np.vstack([tau[kept], value]).T
    return np.array([Chebyshev.fit(x, column, DEGREE_BESIDE, domain=domain)(distance) for column in columns]).T


def _require_finite(tau: Array, left: Array) -> None:
    """Check the (P, d, m) efforts at the nodes of each piece: a pole leaves large last Chebyshev coefficients."""
    series = chebyshev_series(tau)
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
