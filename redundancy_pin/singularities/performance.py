"""Velocity and force ellipsoids, manipulability, stiffness and play of a mechanism at given configurations.

All of them come from W, the actuation matrix. With rates u̇ and efforts τ of the motors, and the force F of the platform
on its environment,

    u̇ = Wᵀ ẋ,      F = W τ.

In scaled units (D_x the lengths that turn rotations and moments of the platform into translations and forces) and for
motors of rates u̇_max and efforts τ_max, let σ be the singular values of D_x⁻¹ W diag(1/u̇_max) or D_x⁻¹ W diag(τ_max):

    ‖u̇/u̇_max‖ ≤ 1 reaches the velocities of an ellipsoid with semi-axes 1/σ,
    ‖τ/τ_max‖ ≤ 1 reaches the forces of one with semi-axes σ (Yoshikawa 1985; with redundant motors no internal force).

The stiffness K_q of the joints gives the platform the stiffness K_x = Γᵀ K_q Γ, the motors alone W K_u Wᵀ. This holds
for springs at rest; the term of preloaded springs (Salisbury 1980; Chen and Kao 2000) is left out. Play ±δ of the
motors lets the platform move by all Δx with |Wᵀ Δx| ≤ δ: with as many motors as DOF |Δx_i| ≤ Σ_j |(W⁻¹)_ji| δ_j,
attained; with more motors the least of these bounds over all choices of n motors, by duality of linear programs.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import RANK_TOLERANCE, Array, Frozen, each, read_only
from redundancy_pin.errors import InputError, UnsupportedRobotError, did_you_mean
from redundancy_pin.kinematics.assembly import closed_configurations, inverses
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint, has_joint
from redundancy_pin.robot.scales import column_scale, row_scale
from redundancy_pin.spectrum import left_singular, scaled, spectrum_of

_LARGEST = float(np.finfo(float).max)

__all__ = ["Ellipsoid", "Performance", "performance", "platform_play", "platform_stiffness"]


@dataclass(frozen=True, eq=False)
class Ellipsoid(Frozen):
    """Velocities or forces that motors of unit norm reach at N poses, in m/s or N.

    Rotations and moments count at the characteristic length.

    Attributes:
        axes: (N, n) semi-axes, largest first; infinite at a singularity, NaN where W is NaN.
        directions: (N, n, n) their unit vectors, columns, in scaled platform coordinates of the base frame.
    """

    axes: Array
    directions: Array

    @property
    def volume(self) -> Array:
        """(N,) product of the semi-axes; of velocities it is Yoshikawa's manipulability √det(J Jᵀ)."""
        return read_only(np.prod(self.axes, axis=1))

    @property
    def condition(self) -> Array:
        """(N,) largest over smallest semi-axis, 1 for a ball."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = self.axes[:, 0] / self.axes[:, -1]
        return read_only(np.where(self.axes[:, -1] == 0.0, np.inf, ratio))


@dataclass(frozen=True, eq=False)
class Performance(Frozen):
    """Velocities and forces of a platform at N configurations; returned by ``performance``.

    Attributes:
        robot: the robot.
        q: (N, nq) the configurations.
        W: (N, n, m) actuation matrix, base frame, as of ``reduce``; NaN at a type I singularity.
        velocity: velocities of the platform that motors reach with ‖u̇/u̇_max‖ ≤ 1.
        force: forces that they reach with ‖τ/τ_max‖ ≤ 1.
        condition: (N,) condition number of the scaled W, as in ``classify``: all motors count equally at the
            characteristic length.
        margin: (N,) singularity margin to type II: the smallest singular value of the scaled W.
    """

    robot: Robot
    q: Array
    W: Array
    velocity: Ellipsoid
    force: Ellipsoid
    condition: Array
    margin: Array

    def __len__(self) -> int:
        """Return the number of configurations."""
        return len(self.q)

    @property
    def manipulability(self) -> Array:
        """(N,) √det(J Jᵀ), scaled: volume of the velocity ellipsoid relative to the unit ball."""
        return self.velocity.volume


def performance(
    robot: RobotLike, q: ArrayLike, *, rates: ArrayLike | None = None, efforts: ArrayLike | None = None
) -> Performance:
    """Return velocity and force ellipsoids, manipulability and condition number at closed configurations.

    Args:
        robot: the robot, or its name or path.
        q: (N, nq) or (nq,) closed configurations, such as ``inverse_kinematics(...).q``.
        rates: scalar or (m,) u̇_max, m/s or rad/s; default: 1 m/s at the characteristic length.
        efforts: scalar or (m,) τ_max, N or N·m; default: 1 N at the characteristic length.

    Raises:
        InputError: wrong shapes, configurations that are not closed, numbers that are not positive.
        UnsupportedRobotError: fewer motors than DOF.

    Example:
        >>> robot = rp.load_robot("five_bar")
        >>> rp.performance(robot, robot.q_reference, efforts=20.0).force.axes.shape
        (1, 2)
    """
    robot = as_robot(robot)
    q, W = _actuation(robot, q)
    rows, columns = row_scale(robot), column_scale(robot)
    fastest, strongest = (
        absent if given is None else each(given, name, (robot.m,), above_zero=True, finite=True)
        for given, name, absent in ((rates, "rates", 1.0 / columns), (efforts, "efforts", columns))
    )
    slow, strong = left_singular(scaled(W, rows, 1.0 / fastest)), left_singular(scaled(W, rows, strongest))
    even, least = spectrum_of(scaled(W, rows, columns)), slow[1][:, ::-1]
    with np.errstate(divide="ignore"):
        speed = np.where(least <= RANK_TOLERANCE * slow[1][:, :1], np.inf, 1.0 / least)
    velocity = Ellipsoid(read_only(speed), read_only(slow[0][:, :, ::-1].copy()))
    force = Ellipsoid(read_only(strong[1]), read_only(strong[0]))
    return Performance(robot, q, read_only(W), velocity, force, even.condition, even.margin)


def platform_stiffness(robot: RobotLike, q: ArrayLike, stiffness: ArrayLike | Mapping[str, float]) -> Array:
    """Return the stiffness of the platform K_x = Γᵀ K_q Γ (N, n, n), base frame.

    Its unit is N/m, N or N·m/rad by rows and columns; its inverse is the compliance. The springs are at rest, links are
    rigid.

    Args:
        robot: the robot, or its name or path.
        q: (N, nq) or (nq,) closed configurations.
        stiffness: scalar or (m,) of the main actuators, N/m or N·m/rad; or by name of any joint of one DOF, passive
            flexures included.

    Raises:
        InputError: wrong shapes, unknown names, numbers that are negative.

    Example:
        >>> robot = rp.load_robot("five_bar")
        >>> rp.platform_stiffness(robot, robot.q_reference, 500.0).shape
        (1, 2, 2)
    """
    robot = as_robot(robot)
    gamma = closed_configurations(robot, q).gamma
    if not isinstance(stiffness, Mapping):
        values = each(stiffness, "stiffness", (robot.m,), finite=True)
        stiffness = dict(zip(robot.actuated, values.tolist(), strict=True))
    springs, model = np.zeros(robot.model.nv), robot.model
    for name, value in stiffness.items():
        joint = find_joint(model, name) if isinstance(name, str) and has_joint(model, name) else None
        known = isinstance(value, int | float | np.number) and 0.0 <= value <= _LARGEST
        if joint is None or joint.nv != 1 or not known:
            raise InputError(
                f"stiffness of {name!r} is {value!r}; {robot.name} takes numbers ≥ 0 for joints of one DOF.",
                remedy=f"{did_you_mean(name, list(model.names)[1:])}Pass N/m or N·m/rad by joint.",
            )
        springs[joint.idx_v] = value
    return read_only(np.einsum("nvi,v,nvj->nij", gamma, springs, gamma))


def platform_play(robot: RobotLike, q: ArrayLike, play: ArrayLike) -> Array:
    """Return the largest error of each platform coordinate (N, n), ± m and rad, for play of the motors.

    Play is backlash, resolution or tolerance: each motor may be off by ±δ_j on its own. The result is of first order in
    δ, infinite at a type II singularity, NaN at a type I one.

    Args:
        robot: the robot, or its name or path.
        q: (N, nq) or (nq,) closed configurations.
        play: scalar or (m,) ±δ, m or rad.

    Raises:
        InputError: wrong shapes, configurations that are not closed, numbers that are negative.
        UnsupportedRobotError: fewer motors than DOF.

    Example:
        >>> robot = rp.load_robot("five_bar")
        >>> rp.platform_play(robot, robot.q_reference, 1e-3).shape
        (1, 2)
    """
    robot = as_robot(robot)
    q, W = _actuation(robot, q)
    off = each(play, "play", (robot.m,), finite=True)
    if (off < 0.0).any():
        raise InputError(f"play is {off.tolist()}.", remedy="Pass the largest error of each motor, ≥ 0.")
    values = spectrum_of(scaled(W, row_scale(robot), column_scale(robot))).singular_values
    known = np.isfinite(values).all(axis=1)
    at = np.flatnonzero(known & (values[:, -1] > RANK_TOLERANCE * values[:, 0]))
    result = np.where(known, np.inf, np.nan)[:, None].repeat(robot.n, axis=1)
    # dual of the linear program max Δx_i, |Wᵀ Δx| ≤ δ: the least bound that any n of the m motors give by themselves
    for chosen in map(list, combinations(range(robot.m), robot.n)):
        bound = np.abs(inverses(W[at][:, :, chosen]).transpose(0, 2, 1)) @ off[chosen]
        result[at] = np.fmin(result[at], bound)
    return read_only(result)


def _actuation(robot: Robot, q: ArrayLike) -> tuple[Array, Array]:
    """Return q (N, nq) and W (N, n, m), NaN at type I; raises as ``performance``."""
    if robot.m < robot.n:
        raise UnsupportedRobotError(
            f"{robot.name} has {robot.m} main actuators and {robot.n} DOF: some velocities move no motor.",
            remedy="Declare more joints as actuated.",
        )
    given = closed_configurations(robot, q)
    return given.q, given.gamma[:, robot.actuated_velocity].transpose(0, 2, 1).copy()
