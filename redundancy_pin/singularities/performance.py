"""How fast, strong, stiff and accurate a mechanism is at a pose: ellipsoids, manipulability, stiffness, play.

All of it is W, the actuation matrix. With rates u̇ and efforts τ of the motors, and force F of the platform on what it
meets,

    u̇ = Wᵀ ẋ,      F = W τ.

In scaled units (D_x the lengths that turn rotations and moments of the platform into translations and forces) and for
motors of rates u̇_max and efforts τ_max, the singular values σ of D_x⁻¹ W diag(1/u̇_max) and D_x⁻¹ W diag(τ_max) say all:

    ‖u̇/u̇_max‖ ≤ 1 reaches the velocities of an ellipsoid with semi-axes 1/σ,
    ‖τ/τ_max‖ ≤ 1 reaches the forces of one with semi-axes σ (Yoshikawa 1985; with redundant motors no internal force).

Stiffness of the joints, K_q, is felt at the platform as K_x = Γᵀ K_q Γ, of motors alone W K_u Wᵀ (J⁻ᵀ K_u J⁻¹ with
J = W⁻ᵀ), where the springs are at rest: forces that they hold add what the change of W makes of them (Salisbury 1980;
Chen and Kao 2000), which is left out. Play ±δ of the motors lets the platform move by all Δx with |Wᵀ Δx| ≤ δ: with as
many motors as freedoms |Δx_i| ≤ Σ_j |J_ij| δ_j, attained; with more motors a linear program finds the largest Δx_i.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import RANK_TOLERANCE, Array, Frozen, each, read_only
from redundancy_pin.errors import InputError, UnsupportedRobotError, did_you_mean
from redundancy_pin.kinematics.assembly import project
from redundancy_pin.robot import Robot, RobotLike, as_robot
from redundancy_pin.robot.lookup import find_joint, has_joint
from redundancy_pin.robot.scales import column_scale, row_scale
from redundancy_pin.singularities.classify import closed_state
from redundancy_pin.spectrum import scaled, spectrum_of

_LARGEST = float(np.finfo(float).max)

__all__ = ["Ellipsoid", "Performance", "performance", "platform_play", "platform_stiffness"]


@dataclass(frozen=True, eq=False)
class Ellipsoid(Frozen):
    """What motors of unit norm reach at N poses, scaled: m/s or N; a rotation counts at the characteristic length.

    Attributes:
        axes: (N, n) semi-axes, largest first; infinite at a singularity, NaN where W is.
        directions: (N, n, n) their unit vectors, columns, in scaled platform coordinates of the base frame.
    """

    axes: Array
    directions: Array

    @property
    def volume(self) -> Array:
        """(N,) product of the semi-axes: of velocities Yoshikawa's manipulability √det(J Jᵀ)."""
        return read_only(np.prod(self.axes, axis=1))

    @property
    def condition(self) -> Array:
        """(N,) largest over smallest semi-axis, 1 where all directions are alike."""
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = self.axes[:, 0] / self.axes[:, -1]
        return read_only(np.where(self.axes[:, -1] == 0.0, np.inf, ratio))


@dataclass(frozen=True, eq=False)
class Performance(Frozen):
    """How fast and strong a robot is at N configurations; made by ``performance``.

    Attributes:
        robot: the robot.
        q: (N, nq) the configurations.
        W: (N, n, m) actuation matrix, base frame, as of ``reduce``; NaN at a type I singularity.
        velocity: velocities of the platform that motors reach with ‖u̇/u̇_max‖ ≤ 1.
        force: forces that they reach with ‖τ/τ_max‖ ≤ 1.
        condition: (N,) condition number of the scaled W, as ``classify`` has it: motors alike at the characteristic
            length.
        margin: (N,) its smallest singular value: the distance to type II.
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
        """(N,) √det(J Jᵀ), scaled: volume of the velocity ellipsoid over that of the unit ball."""
        return self.velocity.volume


def performance(
    robot: RobotLike, q: ArrayLike, *, rates: ArrayLike | None = None, efforts: ArrayLike | None = None
) -> Performance:
    """Return velocity and force ellipsoids, manipulability and condition number at closed configurations.

    Args:
        robot: the robot, or its name or path.
        q: (N, nq) or (nq,) closed configurations, such as ``inverse_kinematics(...).q``.
        rates: scalar or (m,) u̇_max, m/s or rad/s; left out: 1 m/s at the characteristic length.
        efforts: scalar or (m,) τ_max, N or N·m; left out: 1 N at the characteristic length.

    Raises:
        InputError: wrong shapes, configurations that are not closed, numbers that are not positive.
        UnsupportedRobotError: fewer motors than freedoms.
    """
    robot = as_robot(robot)
    q, W = _actuation(robot, q)
    rows, columns = row_scale(robot), column_scale(robot)
    fastest, strongest = (
        absent if given is None else each(given, name, (robot.m,), above_zero=True, finite=True)
        for given, name, absent in ((rates, "rates", 1.0 / columns), (efforts, "efforts", columns))
    )
    slow, strong = _svd(scaled(W, rows, 1.0 / fastest)), _svd(scaled(W, rows, strongest))
    even = spectrum_of(scaled(W, rows, columns))
    with np.errstate(divide="ignore"):
        speed = 1.0 / slow[1][:, ::-1]
    speed[slow[1][:, ::-1] <= RANK_TOLERANCE * slow[1][:, :1]] = np.inf
    return Performance(
        robot=robot,
        q=q,
        W=read_only(W),
        velocity=Ellipsoid(read_only(speed), read_only(slow[0][:, :, ::-1].copy())),
        force=Ellipsoid(read_only(strong[1]), read_only(strong[0])),
        condition=even.condition,
        margin=even.margin,
    )


def platform_stiffness(robot: RobotLike, q: ArrayLike, stiffness: ArrayLike | Mapping[str, float]) -> Array:
    """Return (N, n, n) K_x = Γᵀ K_q Γ: the force that a small displacement of the platform meets.

    N/m, N or N·m/rad by rows and columns of the platform's coordinates; its inverse is the compliance. The springs are
    at rest, links are rigid.

    Args:
        robot: the robot, or its name or path.
        q: (N, nq) or (nq,) closed configurations.
        stiffness: scalar or (m,) of the main actuators, N/m or N·m/rad; or by name of any joint of one freedom, passive
            flexures included.

    Raises:
        InputError: wrong shapes, unknown names, numbers that are negative.
    """
    robot = as_robot(robot)
    system, state = closed_state(robot, q)
    if not isinstance(stiffness, Mapping):
        values = each(stiffness, "stiffness", (robot.m,), finite=True)
        stiffness = dict(zip(robot.actuated, values.tolist(), strict=True))
    springs, model = np.zeros(robot.model.nv), robot.model
    for name, value in stiffness.items():
        joint = find_joint(model, name) if isinstance(name, str) and has_joint(model, name) else None
        known = isinstance(value, int | float | np.number) and 0.0 <= value <= _LARGEST
        if joint is None or joint.nv != 1 or not known:
            raise InputError(
                f"stiffness of {name!r} is {value!r}; {robot.name} has springs in joints of one freedom, not negative.",
                remedy=f"{did_you_mean(name, list(model.names)[1:])}Pass N/m or N·m/rad by joint.",
            )
        springs[joint.idx_v] = value
    gamma = project(system, state).gamma
    return read_only(np.einsum("nvi,v,nvj->nij", gamma, springs, gamma))


def platform_play(robot: RobotLike, q: ArrayLike, play: ArrayLike) -> Array:
    """Return (N, n) how far the platform can be off along each of its coordinates, ± m and rad, for play of the motors.

    Backlash, resolution or tolerance: each motor may be off by ±δ_j on its own. First order in δ. Infinite at a type II
    singularity, NaN at a type I one.

    Args:
        robot: the robot, or its name or path.
        q: (N, nq) or (nq,) closed configurations.
        play: scalar or (m,) ±δ, m or rad.

    Raises:
        InputError: wrong shapes, configurations that are not closed, numbers that are negative.
        UnsupportedRobotError: fewer motors than freedoms.
    """
    robot = as_robot(robot)
    q, W = _actuation(robot, q)
    off = each(play, "play", (robot.m,), finite=True)
    if (off < 0.0).any():
        raise InputError(f"play is {off.tolist()}.", remedy="Pass what each motor may be off by, to both sides.")
    values = spectrum_of(scaled(W, row_scale(robot), column_scale(robot))).singular_values
    known = np.isfinite(values).all(axis=1)
    free = known & (values[:, -1] <= RANK_TOLERANCE * values[:, 0])
    result = np.where(free, np.inf, np.nan)[:, None].repeat(robot.n, axis=1)
    at = np.flatnonzero(known & ~free)
    if robot.m == robot.n:
        result[at] = np.abs(np.linalg.inv(W[at]).transpose(0, 2, 1)) @ off
        return read_only(result)
    from scipy.optimize import linprog

    # without units: the solver's tolerances have none
    play_lengths = off * column_scale(robot)
    largest = float(play_lengths.max()) or 1.0
    for k in at:
        one = scaled(W[k : k + 1], row_scale(robot), column_scale(robot))[0].T
        rows, bounds = np.concatenate([one, -one]), np.tile(play_lengths / largest, 2)
        for i, goal in enumerate(np.eye(robot.n)):
            result[k, i] = -linprog(-goal, A_ub=rows, b_ub=bounds, bounds=(None, None)).fun * largest
    result[at] /= row_scale(robot)
    return read_only(result)


def _actuation(robot: Robot, q: ArrayLike) -> tuple[Array, Array]:
    """Return q (N, nq) and W (N, n, m), NaN at type I."""
    if robot.m < robot.n:
        raise UnsupportedRobotError(
            f"{robot.name} has {robot.m} main actuators and {robot.n} freedoms: some velocities meet no motor at all.",
            remedy="Declare more joints as actuated.",
        )
    system, state = closed_state(robot, q)
    return state.q, project(system, state).gamma[:, robot.actuated_velocity].transpose(0, 2, 1).copy()


def _svd(matrices: Array) -> tuple[Array, Array]:
    """Return U (N, n, n) and the singular values (N, n), largest first; NaN of what is not finite."""
    good = np.isfinite(matrices).all(axis=(1, 2))
    N, n = matrices.shape[:2]
    u, values = np.full((N, n, n), np.nan), np.full((N, n), np.nan)
    decomposed = np.linalg.svd(matrices[good], full_matrices=False)
    u[good], values[good] = decomposed.U, decomposed.S
    return u, values
