"""Exciting motions: the efforts along them show most of a robot's dynamic parameters.

Platform and carriers move about home by a Fourier series w(t) that starts and ends there at rest, so that the motion
can be repeated. With Y the regressor of the base parameters, E u = Y π the equations of an identification, and Σ the
standard deviations of the efforts u, the information of the motion is

    M = Σᵢ Yᵢᵀ (Eᵢ Σ² Eᵢᵀ)⁻¹ Yᵢ.

log det M is maximised (D-optimality: the smallest confidence ellipsoid; Swevers et al. 1997, "Optimal robot excitation
and identification"). Unlike a condition number it is smooth, and units of the parameters do not change its optimum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import null_space
from scipy.optimize import BFGS, NonlinearConstraint, OptimizeResult, minimize
from scipy.special import logsumexp, softmax

from redundancy_pin.arrays import Array, Frozen, frozen, read_only
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.dynamics.rnea import RneaAlongMotion, RneaDynamics
from redundancy_pin.errors import InfeasiblePlanError, InputError, RedundancyPinError
from redundancy_pin.identification.base import BaseParameters, base_parameters
from redundancy_pin.identification.parameters import Parameter, parameters_of
from redundancy_pin.identification.regressor import chain_regressor
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.coordinates import pose_rows
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import PlannedMotion, intersample_check
from redundancy_pin.planners.limits import LIMIT_TOLERANCE, LimitEvent, ResolvedLimits, worst_events
from redundancy_pin.planners.options import Limits
from redundancy_pin.robot import Robot
from redundancy_pin.robot.checks import is_pose
from redundancy_pin.robot.joint_ranges import joint_ranges
from redundancy_pin.robot.scales import column_scale, coordinate_unit, row_scale, velocity_unit
from redundancy_pin.spectrum import scaled, spectrum_of
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.quaternions import angular_rates, poses_of, quaternion_rates, quaternions_of

_NODES = 12
"""Samples in the shortest period at which information and limits are evaluated while a motion is sought."""

_SHARP = 60.0
"""Exponent of the smooth maximum over samples, which is at most log(samples)/60 too large."""

_STEP = 1e-6
"""Differences of w and its derivatives, relative to their sizes."""

_SETTLED, _SPAN = 0.1, 20
"""Gain of log det M per parameter in so many iterations below which a motion is as good as the optimum."""

_HALVINGS, _MOST = 14, 8.0
"""Of the interval in which the largest amplitude within limits is sought, and the largest factor of it."""

_BROKEN = 3.0
"""Used fraction of every limit at a sample without efforts."""


_NEAR = 1.1
"""Margins up to so many times the least that are looked at between the samples."""


@dataclass(frozen=True, eq=False, repr=False)
class ExcitingMotion(Frozen):
    """A periodic motion for identification, made by ``exciting_motion``; a trajectory that planners and plots take.

    Attributes:
        robot: the robot.
        duration: of a period, s.
        series: (2 H + 1, n + k) coefficients of w(t): of 1, cos(2π h t/duration), sin(2π h t/duration), h = 1 ... H.
            w is the distance of platform coordinates and carriers from home, m and rad; of a pose the translation, and
            as its rotation twice the vector of a quaternion with real part 1.
        status: ``OK``; ``NOT_CONVERGED`` where the optimiser ended early: there may be better motions.
        binding: limits that the continuous motion touches; all hold.
        margin: least singularity margin along the motion, relative to that at home.
        base: the b base parameters that it shows.
        information: (b, b) M of a period, per sample, parameters relative to their sizes, efforts to their limits (to
            lengths and one newton where not all are limited).
    """

    robot: Robot
    duration: float
    series: Array
    status: ResultStatus
    binding: tuple[LimitEvent, ...]
    margin: float
    base: BaseParameters
    information: Array

    def __repr__(self) -> str:
        """Return status, length, conditioning and what binds."""
        touched = ", ".join(dict.fromkeys(f"{event.quantity} of {event.joint}" for event in self.binding))
        return (
            f"ExcitingMotion({self.robot.name}: {self.status.value}, {self.duration:g} s, {len(self.base)} base "
            f"parameters, condition number {self.condition:.4g}, margin {self.margin:.2f}, "
            f"binding: {touched or 'none'})"
        )

    @property
    def condition(self) -> float:
        """Condition number of the weighted regressor."""
        return float(np.sqrt(np.linalg.cond(self.information)))

    @property
    def breaks(self) -> Array:
        """No times: the acceleration does not jump."""
        return frozen([])

    def sample_at(self, times: ArrayLike) -> PlatformMotion:
        """Return the platform's motion at (N,) increasing times, s; it repeats after ``duration``."""
        t = np.asarray(times, dtype=np.float64)
        return _platform(self.robot, t, self._distances(t))

    def carriers_at(self, times: ArrayLike) -> CarrierMotion:
        """Return the carriers' motion at (N,) times, s."""
        return _carriers(self.robot, self._distances(np.asarray(times, dtype=np.float64)))

    def _distances(self, t: Array) -> Array:
        orders = [_fourier(t, self.duration, len(self.series) // 2, order) @ self.series for order in range(3)]
        return np.stack(orders)


def exciting_motion(
    robot: RobotLike,
    parameters: Sequence[str] | None = None,
    limits: Limits | None = None,
    duration: float = 10.0,
    *,
    harmonics: int = 5,
    margin: float = 0.3,
    iterations: int = 150,
    seed: int = 0,
) -> ExcitingMotion:
    """Return a motion whose efforts show the dynamic parameters of a robot as well as its limits allow.

    A local optimum, the same for the same seed. Limits, ranges of joints and margin hold between the samples too.

    Args:
        robot: the robot as it is declared, or its name or path.
        parameters: names or patterns of what is to be identified, as of ``identify``.
        limits: of efforts, forces and speeds; what is None is what the robot declares.
        duration: of the motion, s; the lowest frequency is its inverse.
        harmonics: number of frequencies, multiples of the lowest, at least 2.
        margin: least singularity margin, relative to that at home: of the scaled W, and of type I.
        iterations: largest number of steps of the optimiser.
        seed: of the motion from which the search starts.

    Raises:
        InputError: arguments out of range; parameters that no motion shows; a singular home position.
        InfeasiblePlanError: the robot exceeds a limit at rest.

    Example:
        >>> motion = rp.exciting_motion("five_bar", limits=rp.Limits(effort=30.0, actuator_speed=4.0), duration=5.0)
        >>> motion.sample_at(np.arange(0.0, 5.0, 0.004))
    """
    robot = as_robot(robot)
    if not (0.0 < duration < np.inf and harmonics == max(int(harmonics), 2) and 0.0 < margin < 1.0):
        raise InputError(
            f"duration is {duration:g} s, harmonics {harmonics:g}, margin {margin:g}.",
            remedy="Pass a positive duration, a whole number of at least 2 harmonics, and a margin between 0 and 1.",
        )
    resolved = (Limits() if limits is None else limits).resolved(robot)
    search = _Search(robot, parameters_of(robot, parameters), resolved, (float(duration), int(harmonics)), margin)
    start = np.random.default_rng(seed).standard_normal(search.size)
    start *= 0.9 * _largest(lambda factor: bool(np.abs(search.evaluate(search.motion(factor * start))[1]).max() < 1.0))
    if not start.any():
        used = np.abs(search.evaluate(search.motion(start))[1]).max()
        raise InfeasiblePlanError(
            f"No motion of {robot.name} about home keeps the limits: at rest there it uses {used:.3g} of one.",
            remedy="Allow larger efforts, or declare a reference configuration that is farther from limits.",
            constraint="home",
            time=0.0,
            amount=float(used),
        )
    search.choose_base(start)
    values: list[float] = []

    def settled(_: Array, state: OptimizeResult) -> bool:
        values.append(float(state.fun))
        return len(values) > _SPAN and values[-_SPAN] - values[-1] < _SETTLED

    # steps of SLSQP leave the workspace and do not come back; a trust region holds, with limits as barriers
    found = minimize(
        lambda theta: search.at(theta)[0],
        start,
        jac=lambda theta: search.at(theta)[1],
        hess=BFGS(),
        constraints=NonlinearConstraint(
            lambda theta: search.at(theta)[2], 0.0, np.inf, jac=lambda theta: search.at(theta)[3], hess=BFGS()
        ),
        method="trust-constr",
        options={"maxiter": iterations, "initial_tr_radius": 0.1 * float(np.linalg.norm(start))},
        callback=settled,
    )
    status = ResultStatus.OK if len(values) < iterations else ResultStatus.NOT_CONVERGED
    for theta in (found.x, start):
        if (result := search.scaled(theta)) is not None:
            return replace(result, status=status)
        status = ResultStatus.NOT_CONVERGED
    raise InfeasiblePlanError(
        f"No motion of {robot.name} about home was found whose limits hold between its samples.",
        remedy="Pass another seed, or larger limits.",
        constraint="motion",
        time=0.0,
    )


class _Search:
    """Information and used fractions of limits of w(t) = basis · θ; θ (P (n + k),) is relative to the robot's size."""

    def __init__(
        self,
        robot: Robot,
        parameters: Sequence[Parameter],
        limits: ResolvedLimits,
        span: tuple[float, int],
        margin: float,
    ) -> None:
        self.robot, self.parameters, self.limits, self.span, self.margin = robot, parameters, limits, span, margin
        self.dynamics, self.t = RneaDynamics(robot), np.linspace(0.0, span[0], _NODES * span[1], endpoint=False)
        at_rest = np.concatenate([_fourier(np.zeros(1), *span, order) for order in range(3)])
        self.free = null_space(at_rest / np.abs(at_rest).max(axis=1, keepdims=True))
        self.basis = np.stack([_fourier(self.t, *span, order) @ self.free for order in range(3)])
        of_carriers = velocity_unit(robot)[robot.carrier_velocity]
        self.unit = 0.1 * np.concatenate([coordinate_unit(robot), of_carriers])
        self.size = self.basis.shape[2] * len(self.unit)
        largest = np.concatenate([limits.effort, limits.carrier_force])
        lengths = np.concatenate([column_scale(robot), robot.characteristic_length / of_carriers])
        self.noise = largest if np.isfinite(largest).all() else lengths
        self.independent = np.arange(len(parameters))
        self.known: tuple[Array, tuple[float, Array, Array, Array]] | None = None
        still = np.zeros((3, 1, len(self.unit)))
        self.home = _margins(self.dynamics.along(_platform(robot, np.zeros(1), still)))[0]

    def series(self, theta: Array) -> Array:
        """Return (2 H + 1, n + k) coefficients."""
        result: Array = self.free @ theta.reshape(-1, len(self.unit)) * self.unit
        return result

    def motion(self, theta: Array) -> Array:
        """Return (3, N, n + k) w, its rate and second rate at the samples."""
        result: Array = self.basis @ theta.reshape(-1, len(self.unit)) * self.unit
        return result

    def choose_base(self, theta: Array) -> None:
        """Choose the base parameters that a motion shows, and regress on them."""
        rows = self.evaluate(self.motion(theta))[0] / np.array([p.size for p in self.parameters])
        self.base = base_parameters(rows.reshape(-1, rows.shape[2]), self.parameters)
        self.independent = self.base.independent
        if not len(self.base):
            raise InputError(f"No motion of {self.robot.name} shows the parameters.", remedy="Choose others.")

    def evaluate(self, w: Array) -> tuple[Array, Array]:
        """Return the weighted regressor (N, r, b) per parameter's size, and used fractions of limits (N, c)."""
        robot, limits, chosen = self.robot, self.limits, [self.parameters[int(k)] for k in self.independent]
        carriers, along = _carriers(robot, w), self.dynamics.along(_platform(robot, self.t, w), unreachable="mark")
        reduced = along.reduce(carriers)
        efforts = np.concatenate([distribute(reduced).tau, reduced.carrier_force], axis=1)
        rates = np.einsum("Nnm,Nn->Nm", reduced.W, along.motion.xd)
        moved = [carriers.s, carriers.sd, carriers.sdd]
        ends = [limits.track, *(each[:, None] * [-1.0, 1.0] for each in (limits.speed, limits.acceleration))]
        for joint in joint_ranges(robot):
            moved.append(joint.counted(along.q[:, joint.at], False)[:, None])
            ends.append(np.array([[joint.lower, joint.upper]]))
        parts = [efforts / np.concatenate([limits.effort, limits.carrier_force]), rates / limits.actuator_speed]
        for values, pair in zip(moved, ends, strict=True):
            bounded = np.isfinite(pair).all(axis=1)
            middle, half = pair[bounded].mean(axis=1), 0.5 * np.diff(pair[bounded], axis=1)[:, 0]
            parts.append((values[:, bounded] - middle) / half)
        with np.errstate(divide="ignore"):
            used = np.concatenate([*parts, self.margin * self.home / _margins(along)], axis=1)
        lost = ~np.isfinite(used).all(axis=1)
        used[lost] = _BROKEN
        E = np.zeros((len(w[0]), robot.n + robot.k, robot.m + robot.k))
        E[:, : robot.n, : robot.m] = np.where(lost[:, None, None], 0.0, reduced.W)
        E[:, robot.n :, robot.m :] = np.eye(robot.k)
        E *= self.noise
        floor = 1e-12 * (E**2).sum(axis=(1, 2)).max() * np.eye(E.shape[1])
        rows = np.linalg.inv(np.linalg.cholesky(E @ E.transpose(0, 2, 1) + floor))
        rows = rows @ np.where(lost[:, None, None], 0.0, chain_regressor(along, chosen, carriers))
        return rows * np.array([p.size for p in chosen]), np.clip(used, -_BROKEN, _BROKEN)

    def at(self, theta: Array) -> tuple[float, Array, Array, Array]:
        """Return −log det M / b, its gradient, what is left of each limit (c,), and its Jacobian (c, P (n + k)).

        Each sample depends on w and its rates there alone: one difference by each of them serves all samples.
        """
        if self.known is not None and np.array_equal(self.known[0], theta):
            return self.known[1]
        self.dynamics = RneaDynamics(self.robot).with_cache()  # a carrier that moves leaves the platform as it is
        w, b = self.motion(theta), len(self.base)
        rows, used = self.evaluate(w)
        flat = rows.reshape(-1, b)
        gain = np.linalg.pinv(flat).T.reshape(rows.shape)
        both = _SHARP * np.stack([used, -used])
        left = 1.0 - logsumexp(both, axis=(0, 1)) / _SHARP
        weight = softmax(both, axis=(0, 1))
        by_value, by_left = np.zeros((self.size // len(self.unit), len(self.unit))), np.zeros((len(left), self.size))
        by_left = by_left.reshape(len(left), -1, len(self.unit))
        for order, j in np.ndindex(3, len(self.unit)):
            step = _STEP * self.unit[j] * self.span[0] ** -order
            moved = w.copy()
            moved[order, :, j] += step
            other, more = self.evaluate(moved)
            by_value[:, j] -= self.basis[order].T @ (gain * (other - rows)).sum(axis=(1, 2)) * (2.0 / b / step)
            by_left[:, :, j] -= ((weight[0] - weight[1]) * (more - used) / step).T @ self.basis[order]
        value = -np.linalg.slogdet(flat.T @ flat)[1] / b
        gradients = (by_value * self.unit).ravel(), (by_left * self.unit).reshape(len(left), -1)
        self.known = theta.copy(), (value, gradients[0], left, gradients[1])
        return self.known[1]

    def scaled(self, theta: Array) -> ExcitingMotion | None:
        """Return the largest multiple of a motion that keeps all limits between its samples; None if none does."""
        return self.checked(_largest(lambda factor: self.checked(factor * theta) is not None) * theta)

    def checked(self, theta: Array) -> ExcitingMotion | None:
        """Return the motion if it keeps all limits and margins at the samples and between them."""
        robot, limits = self.robot, self.limits
        rows = self.evaluate(self.motion(theta))[0]
        information = np.einsum("Nrb,Nrc->bc", rows, rows) / len(rows)
        moving = ExcitingMotion(
            robot,
            self.span[0],
            read_only(self.series(theta)),
            ResultStatus.OK,
            (),
            0.0,
            self.base,
            read_only(information),
        )
        t = np.linspace(0.0, self.span[0], 4 * len(self.t) + 1)
        position = PiecewisePolynomial.constant(np.zeros(0), 0.0, self.span[0])
        if robot.k:
            position = PiecewisePolynomial.fit(
                lambda times: moving.carriers_at(times).s,
                frozen([0.0, self.span[0]]),
                frozen([]),
                lambda s: np.abs(s).max(axis=0) + self.unit[robot.n :],
                1e-12,
            )
        try:
            along = self.dynamics.along(moving.sample_at(t))
            low = (_margins(along) / self.home).min(axis=1)
            near = t[low < _NEAR * low.min()]  # a dip between samples is sought beside the lowest
            dense = np.unique(np.clip(near[:, None] + t[1] * np.linspace(-1.0, 1.0, 21), 0.0, self.span[0]))
            low = (_margins(self.dynamics.along(moving.sample_at(dense))) / self.home).min(axis=1)
            least, at = float(low.min()), float(dense[low.argmin()])
            functions = PlanFunctions(as_motion(moving), position)
            planned = PlannedMotion(
                self.dynamics, functions, along, moving.carriers_at(t), limits, "exciting motion", chooses_timing=True
            )
            check = intersample_check(planned)
        except RedundancyPinError:
            return None
        if check.violated or not check.within_limits or not least >= self.margin:
            return None
        events = worst_events(check.touched)
        if least < (1.0 + LIMIT_TOLERANCE) * self.margin:
            events += (LimitEvent(robot.name, "singularity margin", at, at, at, least, self.margin, 0.0),)
        return replace(moving, binding=events, margin=least)


def _largest(holds: Callable[[float], bool]) -> float:
    """Return the largest factor up to which a property holds, near one if it can be; 0 if it holds for none."""
    low, high = 0.0, 1.0
    while high < _MOST and holds(high):
        low, high = high, 1.25 * high
    while not low and high > 1.0 / _MOST**4:
        low, high = (0.8 * high, high) if holds(0.8 * high) else (0.0, 0.8 * high)
    for _ in range(_HALVINGS if low else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def _margins(along: RneaAlongMotion) -> Array:
    """Return (N, 2) smallest singular value of the scaled W, and lower bound of the distance to type I."""
    scales = column_scale(along.robot), row_scale(along.robot)
    W = scaled(along.tree.W, scales[1], scales[0])
    return np.stack([spectrum_of(W).margin, along.tree.serial_margin_bound], axis=1)


def _fourier(t: Array, duration: float, harmonics: int, order: int = 0) -> Array:
    """Return (N, 2 H + 1) derivatives of 1, cos(2π h t/duration), and sin(2π h t/duration), h = 1 ... H."""
    omega = 2.0 * np.pi / duration * np.arange(1, harmonics + 1)
    angle = t[:, None] * omega + 0.5 * np.pi * order
    constant = np.full((len(t), 1), 0.0 if order else 1.0)
    return np.concatenate([constant, omega**order * np.cos(angle), omega**order * np.sin(angle)], axis=1)


def _carriers(robot: Robot, w: Array) -> CarrierMotion:
    home = np.clip(0.0, *np.array([(each.lower, each.upper) for each in robot.carrier_limits]).reshape(-1, 2).T)
    own = w[:, :, robot.n :]
    return CarrierMotion(home + own[0], own[1], own[2], check_rates=False)


def _platform(robot: Robot, t: Array, w: Array) -> PlatformMotion:
    """Return the motion whose distances from home, and their rates, are w (3, N, n + k)."""
    home, own = follower(robot).home.x, w[:, :, : robot.n]
    if not is_pose(robot):
        return PlatformMotion(t, home + own[0], own[1], own[2], check_rates=False)
    full = np.zeros((3, len(t), 6))
    full[:, :, pose_rows(robot)] = own
    start = np.broadcast_to(quaternions_of(home[None, :3, :3]), (len(t), 4))
    turn = [quaternion_rates(start, each[:, 3:], each[:, 3:])[0] for each in full]  # a vector times the start, halved
    turn[0] = turn[0] + start
    rates = [np.concatenate([a[:, :3], b], axis=1) for a, b in zip(full[1:], angular_rates(*turn), strict=True)]
    poses = poses_of(home[:3, 3] + full[0, :, :3], turn[0])
    return PlatformMotion(t, poses, *(each[:, pose_rows(robot)] for each in rates), check_rates=False)
