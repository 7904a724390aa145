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

from redundancy_pin.arrays import Array, Frozen, fraction, frozen, positive, read_only, whole
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
from redundancy_pin.planners.limits import (
    LIMIT_TOLERANCE,
    QUANTITIES,
    LimitEvent,
    ResolvedLimits,
    States,
    worst_events,
)
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

_SHARPNESS = 60.0
"""Exponent of the smooth maximum over samples, which exceeds the maximum by at most log(samples)/60."""

_STEP = 1e-6
"""Step of the differences by w and its derivatives, relative to their scales."""

_SETTLED, _SPAN = 0.1, 20
"""The search ends when log det M per parameter gains less than ``_SETTLED`` in ``_SPAN`` iterations."""

_FACTORS = 1.25 ** -np.arange(60.0)
"""Factors of the amplitude among which the largest within the limits is bracketed, before bisection."""

_MOST = 8.0
"""Largest factor of the amplitude."""

_BISECTIONS = 12
"""Of the bracket: the factor is known to 6e-5 of itself."""

_LOST = 3.0
"""Largest used fraction of a limit in the search, and that at a pose that the robot does not reach."""

_NEAR = 1.1
"""Singularity margin over the least one that is allowed, below which it is sampled twenty times as densely."""


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
        return self._motions(times)[0]

    def carriers_at(self, times: ArrayLike) -> CarrierMotion:
        """Return the carriers' motion at (N,) times, s."""
        return self._motions(times)[1]

    def _motions(self, times: ArrayLike) -> tuple[PlatformMotion, CarrierMotion]:
        t, harmonics = np.asarray(times, dtype=np.float64), len(self.series) // 2
        orders = [_fourier(t, self.duration, harmonics, order) @ self.series for order in range(3)]
        return _motions(self.robot, t, np.stack(orders))


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
        parameters: names or patterns of the parameters to identify, as in ``identify``.
        limits: of efforts, forces and speeds; None stands for the limits that the robot declares.
        duration: of the motion, s; the lowest frequency is its inverse.
        harmonics: number of frequencies, multiples of the lowest, at least 2.
        margin: least singularity margin, relative to that at home: of the scaled W, and of type I.
        iterations: largest number of steps of the optimiser.
        seed: of the motion from which the search starts.

    Raises:
        InputError: arguments out of range; parameters that no motion shows; a singular home position.
        InfeasiblePlanError: the robot exceeds a limit at rest, or in any motion of this duration.

    Example:
        >>> limits = rp.Limits(effort=30.0, actuator_speed=4.0)
        >>> motion = rp.exciting_motion("five_bar", limits=limits, duration=2.0, harmonics=2, iterations=0)
        >>> len(motion.sample_at(np.arange(0.0, 2.0, 0.01)))
        200
    """
    robot = as_robot(robot)
    duration, harmonics = positive(duration, "duration", "s"), whole(harmonics, "harmonics", 2, 1000)
    iterations, seed = whole(iterations, "iterations", 0, 10**6), whole(seed, "seed", 0, 2**63)
    if fraction(margin, "margin") in (0.0, 1.0):
        raise InputError(f"margin is {margin:g}.", remedy="Pass a number between 0 and 1, such as 0.3.")
    resolved = (Limits() if limits is None else limits).resolved(robot)
    search = _Search(robot, parameters_of(robot, parameters), resolved, duration, harmonics, margin)
    start = np.random.default_rng(seed).standard_normal(search.size)
    smallest = _FACTORS[-1] * start
    start = 0.9 * _largest(start, lambda theta: search.largest_use(theta) < 1.0)
    if not start.any():
        used = search.largest_use(smallest)
        raise InfeasiblePlanError(
            f"No motion of {robot.name} about home keeps the limits: one of {_FACTORS[-1]:.0e} of its size in "
            f"{duration:g} s uses {used:.3g} of one.",
            remedy="Allow larger efforts, pass a longer duration, or declare a reference configuration that is farther "
            "from limits.",
            constraint="home",
            time=0.0,
            amount=used,
        )
    search.choose_base(start)
    values: list[float] = []

    def settled(_: Array, state: OptimizeResult) -> bool:
        values.append(float(state.fun))
        return len(values) > _SPAN and values[-_SPAN] - values[-1] < _SETTLED

    # SLSQP leaves the workspace and does not come back; a trust region shrinks there
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
        largest = _largest(theta, lambda scaled: search.checked(scaled) is not None)
        if (result := search.checked(largest)) is not None:
            return replace(result, status=status)
        status = ResultStatus.NOT_CONVERGED
    raise InfeasiblePlanError(
        f"No motion of {robot.name} about home was found whose limits hold between its samples.",
        remedy="Pass another seed, or larger limits.",
        constraint="motion",
        time=0.0,
    )


class _Search:
    """Information and use of the limits of w(t) = basis · θ; θ (P (n + k),) is relative to the robot's size."""

    def __init__(
        self,
        robot: Robot,
        parameters: Sequence[Parameter],
        limits: ResolvedLimits,
        duration: float,
        harmonics: int,
        margin: float,
    ) -> None:
        self.robot, self.parameters, self.limits, self.margin = robot, parameters, limits, margin
        self.dynamics, self.duration = RneaDynamics(robot), duration
        self.t = np.linspace(0.0, duration, _NODES * harmonics, endpoint=False)
        at_rest = np.concatenate([_fourier(np.zeros(1), duration, harmonics, order) for order in range(3)])
        self.free = null_space(at_rest / np.abs(at_rest).max(axis=1, keepdims=True))
        self.basis = np.stack([_fourier(self.t, duration, harmonics, order) @ self.free for order in range(3)])
        of_carriers = velocity_unit(robot)[robot.carrier_velocity]
        self.unit = 0.1 * np.concatenate([coordinate_unit(robot), of_carriers])
        self.size = self.basis.shape[2] * len(self.unit)
        largest = np.concatenate([limits.effort, limits.carrier_force])
        lengths = np.concatenate([column_scale(robot), robot.characteristic_length / of_carriers])
        self.noise = largest if np.isfinite(largest).all() else lengths
        self.independent = np.arange(len(parameters))
        self.known: tuple[Array, tuple[float, Array, Array, Array]] = np.zeros(0), (0.0, *np.zeros((3, 0)))
        still = np.zeros((3, 1, len(self.unit)))
        self.home = _margins(self.dynamics.along(_motions(robot, np.zeros(1), still)[0]))[0]

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
        """Return the regressor of efforts over Σ per parameter's size (N, m + k, b), and used fractions (N, c)."""
        robot, limits, chosen = self.robot, self.limits, [self.parameters[int(k)] for k in self.independent]
        platform, carriers = _motions(robot, self.t, w)
        along, m = self.dynamics.along(platform, unreachable="mark"), robot.m
        reduced = along.reduce(carriers)
        moved = carriers.s, carriers.sd, carriers.sdd
        rates = np.einsum("Nnm,Nn->Nm", reduced.W, along.motion.xd)
        states = States(distribute(reduced).tau, rates, reduced.carrier_force, *moved)
        limited = list(zip(moved, *limits.bounds, strict=False))
        for joint in joint_ranges(robot):
            limited.append((joint.counted(along.q[:, [joint.at]], False), [joint.lower], [joint.upper]))
        for key, joints in limits.evaluated().items():
            largest = limits.of(key)[joints]
            limited.append((QUANTITIES[key].values(states)[:, joints], -largest, largest))
        values, lower, upper = (np.concatenate(parts, axis=-1) for parts in zip(*limited, strict=True))
        bounded = np.isfinite(lower) & np.isfinite(upper)
        low, high = lower[bounded], upper[bounded]
        with np.errstate(divide="ignore"):
            by_margin = self.margin * self.home / _margins(along)
        used = np.concatenate([(2.0 * values[:, bounded] - low - high) / (high - low), by_margin], axis=1)
        lost = ~np.isfinite(used).all(axis=1)
        used[lost] = _LOST
        Y = chain_regressor(along, chosen, carriers) * np.array([p.size for p in chosen])
        of_motors = np.linalg.pinv(np.where(lost[:, None, None], 1.0, reduced.W * self.noise[:m])) @ Y[:, : robot.n]
        rows = np.concatenate([of_motors, Y[:, robot.n :] / self.noise[m:, None]], axis=1)
        return np.where(lost[:, None, None], 0.0, rows), used

    def largest_use(self, theta: Array) -> float:
        """Return the largest used fraction of a limit at the samples."""
        return float(np.abs(self.evaluate(self.motion(theta))[1]).max())

    def at(self, theta: Array) -> tuple[float, Array, Array, Array]:
        """Return −log det M / b, its gradient, the smooth minimum of what is left of each limit (c,), and its Jacobian.

        Each sample depends on w and its rates there alone: one difference by each of them serves all samples.
        """
        if np.array_equal(self.known[0], theta):
            return self.known[1]
        self.dynamics = RneaDynamics(self.robot).with_cache()  # a carrier that moves leaves the platform as it is
        w = self.motion(theta)
        rows, used = self.evaluate(w)
        used = np.clip(used, -_LOST, _LOST)
        flat, both = rows.reshape(-1, rows.shape[2]), _SHARPNESS * np.stack([used, -used])
        by_rows = -2.0 / rows.shape[2] * np.linalg.pinv(flat).T.reshape(rows.shape)
        by_used = np.subtract(*softmax(both, axis=(0, 1)))
        by_w = np.zeros((1 + used.shape[1], *w.shape))
        for order, j in np.ndindex(3, len(self.unit)):
            step, moved = _STEP * self.unit[j] * self.duration**-order, w.copy()
            moved[order, :, j] += step
            other, more = self.evaluate(moved)
            by_w[0, order, :, j] = (by_rows * (other - rows)).sum(axis=(1, 2)) / step
            by_w[1:, order, :, j] = -(by_used * (np.clip(more, -_LOST, _LOST) - used)).T / step
        by_theta = (np.einsum("oNp,coNj->cpj", self.basis, by_w, optimize=True) * self.unit).reshape(len(by_w), -1)
        value = -float(np.linalg.slogdet(flat.T @ flat)[1]) / rows.shape[2]
        left = 1.0 - logsumexp(both, axis=(0, 1)) / _SHARPNESS
        self.known = theta.copy(), (value, by_theta[0], left, by_theta[1:])
        return self.known[1]

    def checked(self, theta: Array) -> ExcitingMotion | None:
        """Return the motion if it keeps all limits and margins at the samples and between them."""
        robot, limits, end = self.robot, self.limits, self.duration
        t = np.linspace(0.0, end, 4 * len(self.t) + 1)
        try:
            rows, used = self.evaluate(self.motion(theta))
            if np.abs(used).max() > 1.0 + LIMIT_TOLERANCE:  # what follows takes ten times as long
                return None
            moving = ExcitingMotion(
                robot=robot,
                duration=end,
                series=read_only(self.free @ theta.reshape(-1, len(self.unit)) * self.unit),
                status=ResultStatus.OK,
                binding=(),
                margin=0.0,
                base=self.base,
                information=read_only(np.einsum("Nrb,Nrc->bc", rows, rows) / len(rows)),
            )
            along = self.dynamics.along(moving.sample_at(t))
            near = t[(_margins(along) / self.home).min(axis=1) < _NEAR * self.margin]
            beside = near[:, None] + t[1] * np.linspace(-1.0, 1.0, 21)
            dense = np.unique(np.clip(np.append(t, beside), 0.0, end))
            low = (_margins(self.dynamics.along(moving.sample_at(dense))) / self.home).min(axis=1)
            least, at = float(low.min()), float(dense[low.argmin()])
            position = PiecewisePolynomial.constant(np.zeros(0), 0.0, end)
            if robot.k:
                ends, largest = frozen([0.0, end]), self.unit[robot.n :]
                position = PiecewisePolynomial.fit(
                    lambda times: moving.carriers_at(times).s, ends, frozen([]), lambda s: largest, 1e-12
                )
            functions, carriers = PlanFunctions(as_motion(moving), position), moving.carriers_at(t)
            check = intersample_check(
                PlannedMotion(self.dynamics, functions, along, carriers, limits, "exciting motion", chooses_timing=True)
            )
        except RedundancyPinError:
            return None
        if check.violated or not check.within_limits or not least >= self.margin:
            return None
        events = worst_events(check.touched)
        if least < (1.0 + LIMIT_TOLERANCE) * self.margin:
            events += (LimitEvent(robot.name, "singularity margin", at, at, at, least, self.margin, 0.0),)
        return replace(moving, binding=events, margin=least)


def _largest(theta: Array, holds: Callable[[Array], bool]) -> Array:
    """Return the largest multiple of θ that has a property, next to the first of ``_FACTORS``; zero where none has."""
    low = next((float(factor) for factor in _FACTORS if holds(factor * theta)), 0.0)
    while 1.0 <= low < _MOST and holds(1.25 * low * theta):
        low *= 1.25
    high = 1.25 * low
    for _ in range(_BISECTIONS if low else 0):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle * theta) else (low, middle)
    return low * theta


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


def _motions(robot: Robot, t: Array, w: Array) -> tuple[PlatformMotion, CarrierMotion]:
    """Return the motions whose distances from home, and their rates, are w (3, N, n + k)."""
    parked = np.clip(0.0, *np.array([(each.lower, each.upper) for each in robot.carrier_limits]).reshape(-1, 2).T)
    home, own, moved = follower(robot).home.x, w[:, :, : robot.n], w[:, :, robot.n :]
    carriers = CarrierMotion(parked + moved[0], moved[1], moved[2], check_rates=False)
    if not is_pose(robot):
        return PlatformMotion(t, home + own[0], own[1], own[2], check_rates=False), carriers
    full = np.zeros((3, len(t), 6))
    full[:, :, pose_rows(robot)] = own
    start = np.broadcast_to(quaternions_of(home[None, :3, :3]), (len(t), 4))
    turn = [quaternion_rates(start, each[:, 3:], each[:, 3:])[0] for each in full]  # a vector times the start, halved
    turn[0] = turn[0] + start
    rates = [np.concatenate([a[:, :3], b], axis=1) for a, b in zip(full[1:], angular_rates(*turn), strict=True)]
    poses = poses_of(home[:3, 3] + full[0, :, :3], turn[0])
    return PlatformMotion(t, poses, *(each[:, pose_rows(robot)] for each in rates), check_rates=False), carriers
