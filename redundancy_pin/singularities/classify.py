"""Singularities of a closed chain at given configurations: type I, type II and combined, by rank, with margins.

Type I (serial): the platform velocity does not determine the joint velocities; K loses rank, and there is a platform
twist that cannot be produced. Type II (parallel): with locked actuators a motion remains; T loses rank, and so does W.

Robots with m ≠ n. With fewer actuators than DOF (m < n) n − m independent platform motions are uncontrolled everywhere;
with more (m > n) internal forces exist everywhere. Type II means a rank *below* that: rank W < min(n, m).

The matrices whose rank decides, with J_c the constraint Jacobian, J_x the rows of the independent velocities and S the
selection of the main actuators, all without the carrier columns:

- K = [J_c; J_x] maps joint velocities to platform velocities and loses rank at a type I singularity;
- T = [J_c; S] maps joint velocities to closure and actuator rates and loses rank at a type II singularity;
- W = Γᵀ Sᵀ maps actuator efforts to platform forces. Where K is regular T K⁻¹ = [I 0; * Wᵀ]: W lacks as much rank as T.

Lengths are made comparable by one number, the robot's characteristic length L: every rotation (of a joint, of the
platform, in a closure row) counts as the motion, in metres, of a point at distance L from its axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from redundancy_pin.arrays import (
    FILE_TOLERANCE,
    NEAR_SINGULAR_MARGIN,
    RANK_TOLERANCE,
    Array,
    BoolArray,
    Frozen,
    Labelled,
    read_only,
    require_type,
)
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.assembly import closed_configurations, inverses
from redundancy_pin.kinematics.closure import ConstraintState, ConstraintSystem
from redundancy_pin.kinematics.inverse_kinematics import JointTrajectory
from redundancy_pin.loading import RobotLike, as_robot
from redundancy_pin.robot.scales import column_scale, row_scale
from redundancy_pin.spectrum import left_singular, oriented, spectrum_of


def serial_and_locked(system: ConstraintSystem, state: ConstraintState) -> tuple[Array, Array]:
    """Return K (N, p, p) and T (N, r + m, p) without units; their first r rows are the closure rows.

    If dependent closure rows were dropped, a basis of all rows replaces the independent ones: which rows are
    independent may change along a motion. Where all of them lose rank, to the rounding of a file, the independent ones
    stay.
    """
    r, K = len(system.rows), system.relative(state.K)
    if system.has_dependent_rows:
        rows, _, least = system.combined_rows(system.every.evaluate(state.q))
        full = least > FILE_TOLERANCE
        K[full, :r] = rows[full]
    selection = system.selection[:, system.pose_columns]
    return K, np.concatenate([K[:, :r], np.broadcast_to(selection, (len(K), *selection.shape))], axis=1)


def actuation_matrix(system: ConstraintSystem, serial: Array) -> Array:
    """Return (N, n, m) the scaled actuation matrix D_x⁻¹ W D_a from K (N, p, p); NaN where K is exactly singular."""
    actuated = np.searchsorted(system.pose_columns, system.robot.actuated_velocity)
    gamma = inverses(serial)[:, :, len(system.rows) :]
    by_row: Array = gamma[:, actuated].transpose(0, 2, 1)
    return by_row


def signed_margin(W: Array) -> Array:
    """Return (N,) the smallest singular value of W with the sign of its determinant.

    It is smooth and changes sign where a type II singularity is crossed. Where W is not square (m ≠ n) the sign is +1.

    Args:
        W: (N, n, m) scaled actuation matrices; NaN gives NaN.
    """
    margin = spectrum_of(W).margin
    if W.shape[1] != W.shape[2]:
        return margin
    with np.errstate(invalid="ignore"):  # numpy warns of determinants of NaN
        return margin * np.where(np.linalg.det(W) < 0.0, -1.0, 1.0)


class Margins(NamedTuple):
    """Singularity margins at N configurations.

    Attributes:
        parallel: (N,) signed margin to type II, see ``signed_margin``; NaN exactly at type I.
        serial: (N,) margin to type I, not negative.
    """

    parallel: Array
    serial: Array


def margins_of(system: ConstraintSystem, state: ConstraintState) -> Margins:
    """Return the margins of evaluated configurations."""
    K, _ = serial_and_locked(system, state)
    return Margins(signed_margin(actuation_matrix(system, K)), np.asarray(np.linalg.svd(K, compute_uv=False)[:, -1]))


class SingularityKind(Labelled):
    """Kind of a configuration; a combined singularity is of type I and of type II."""

    UNREACHABLE = -1
    REGULAR = 0
    TYPE_I = 1
    TYPE_II = 2
    COMBINED = 3


@dataclass(frozen=True, eq=False)
class Singularities(Frozen):
    """The singularities of N configurations; returned by ``classify`` and ``classify_motion``.

    A direction is a twist ẋ (m/s, rad/s, base frame) of length 1 m/s in the scaled metric, in which a rotation counts
    with the characteristic length; its largest scaled component is positive. All values are NaN where ``kind`` is
    ``UNREACHABLE``.

    Attributes:
        kind: (N,) values of ``SingularityKind``.
        serial_margin: (N,) smallest singular value of the scaled K: the distance to type I.
        parallel_margin: (N,) smallest singular value of the scaled W: the distance to type II as ``distribute`` reports
            it; NaN at type I, where W is infinite.
        locked_margin: (N,) smallest singular value of the scaled T: the distance to type II, finite everywhere.
        condition: (N,) condition number of the scaled J = Wᵀ (ẋ to actuator rates); infinite at a singularity.
        condition_unscaled: (N,) the same of the plain J, the thesis's measure (Parsa 2014, section 3.1). It equals
            ``condition`` where no units are mixed (2-RPR: cot(γ/2), γ the angle between the legs); where they
            are (3-RRR), it depends on the unit of length, and ``condition`` does not.
        uncontrolled_twist: (N, n) the platform motion that locked actuators leave free; NaN where not type II, and at a
            combined singularity whose free motion leaves the platform at rest.
        lost_direction: (N, n) the platform motion that no joint velocity produces: every twist that is possible is
            normal to it in the scaled metric. NaN where not type I, and where the closure rows depend on each other
            without the platform's.
        least_controlled: (N, n) the platform motion that the actuators resist least, at every configuration; for m < n
            the least controlled of those that are controlled at all.
        least_producible: (N, n) the platform motion that needs the fastest joints, at every configuration.
        passive_motion: (N,) whether joints can move with actuators and platform at rest; then K and T lose rank.
    """

    kind: NDArray[np.int8]
    serial_margin: Array
    parallel_margin: Array
    locked_margin: Array
    condition: Array
    condition_unscaled: Array
    uncontrolled_twist: Array
    lost_direction: Array
    least_controlled: Array
    least_producible: Array
    passive_motion: BoolArray

    def __len__(self) -> int:
        """Return the number of configurations."""
        return len(self.kind)

    @property
    def type_i(self) -> BoolArray:
        """(N,) whether each is a type I singularity (combined ones included)."""
        return read_only((self.kind == SingularityKind.TYPE_I) | (self.kind == SingularityKind.COMBINED))

    @property
    def type_ii(self) -> BoolArray:
        """(N,) whether each is a type II singularity (combined ones included)."""
        return read_only((self.kind == SingularityKind.TYPE_II) | (self.kind == SingularityKind.COMBINED))

    @property
    def near_type_ii(self) -> BoolArray:
        """(N,) whether the parallel margin is below ``NEAR_SINGULAR_MARGIN`` (type II itself included)."""
        return read_only(self.type_ii | (self.parallel_margin < NEAR_SINGULAR_MARGIN))


def classify(robot: RobotLike, q: ArrayLike, *, tolerance: float = RANK_TOLERANCE) -> Singularities:
    """Classify closed configurations; type I singularities, which ``inverse_kinematics`` refuses, are included.

    Args:
        robot: the robot, or its name or path.
        q: (N, nq) or (nq,) configurations of the tree, closed; carriers do not matter.
        tolerance: singular values below this fraction of the largest (of W also below this) count as zero. A type I
            configuration that was solved from a position (not from a joint angle) is exact to the square root of
            rounding only: pass 1e-7 there.

    Raises:
        InputError: wrong shape, values that are not finite, a configuration that is not closed, or a tolerance
            outside (0, 1).

    Example:
        >>> rp.classify("3rrr", rp.load_robot("3rrr").q_reference).type_ii.tolist()
        [False]
    """
    if not 0.0 < tolerance < 1.0:
        raise InputError(f"tolerance is {tolerance}.", remedy="Pass a fraction between 0 and 1, for example 1e-9.")
    robot = as_robot(robot)
    given = closed_configurations(robot, q)
    system, state = given.system, given.state
    rows = row_scale(system.robot)
    K, T = serial_and_locked(system, state)
    serial, locked = np.linalg.svd(K), np.linalg.svd(T)
    type_i = _lacks_rank(serial.S, tolerance)
    W = actuation_matrix(system, K)
    W[type_i] = np.nan
    spectrum = spectrum_of(W)
    unscaled = spectrum_of(W * (rows[:, None] / column_scale(system.robot)))
    type_ii = np.where(type_i, _lacks_rank(locked.S, tolerance), spectrum.rank(tolerance) < min(W.shape[1:]))
    # a motion in the null space of all rows: closures, platform and actuators are at rest
    everything = np.concatenate([K, T[:, len(system.rows) :]], axis=1)
    passive = type_i & type_ii & _lacks_rank(np.linalg.svd(everything, compute_uv=False), tolerance)

    twists = K[:, len(system.rows) :] @ locked.Vh.transpose(0, 2, 1)
    least_controlled = left_singular(W)[0][:, :, -1]
    unknown = np.isnan(least_controlled).any(axis=1)  # at type I: there T determines it
    least_controlled[unknown] = _unit(twists[unknown, :, locked.S.shape[1] - 1])
    uncontrolled = np.where(type_i[:, None], _widest(twists, locked.S, tolerance), least_controlled)
    uncontrolled[~type_ii] = np.nan
    covectors = serial.U[:, len(system.rows) :]
    lost = _widest(covectors, serial.S, tolerance)
    lost[~type_i] = np.nan
    return Singularities(
        kind=read_only((type_i * SingularityKind.TYPE_I + type_ii * SingularityKind.TYPE_II).astype(np.int8)),
        serial_margin=read_only(serial.S[:, -1].copy()),
        parallel_margin=spectrum.margin,
        locked_margin=read_only(locked.S[:, -1].copy()),
        # rounding turns an infinite condition number into any large number
        condition=read_only(np.where(type_i | type_ii, np.inf, spectrum.condition)),
        condition_unscaled=read_only(np.where(type_i | type_ii, np.inf, unscaled.condition)),
        uncontrolled_twist=read_only(oriented(uncontrolled) / rows),
        lost_direction=read_only(oriented(lost) / rows),
        least_controlled=read_only(oriented(least_controlled) / rows),
        least_producible=read_only(oriented(_unit(covectors[:, :, -1])) / rows),
        passive_motion=read_only(passive),
    )


def classify_motion(motion: JointTrajectory, *, tolerance: float = RANK_TOLERANCE) -> Singularities:
    """Classify the samples of a joint trajectory from ``inverse_kinematics``; unreachable ones are marked.

    Raises:
        InputError: a tolerance outside (0, 1), see ``classify``.

    Example:
        >>> pose = rp.inverse_kinematics("3rrr", rp.trajectory.reference.corner().sample(0.1))
        >>> rp.classify_motion(pose).parallel_margin.shape
        (22,)
    """
    require_type(motion, JointTrajectory, "A joint trajectory", "Pass what inverse_kinematics(robot, motion) returns.")
    good, spread = motion.reachable, {}
    for name, values in vars(classify(motion.robot, motion.q[good], tolerance=tolerance)).items():
        # 0 as a truth value is False: no passive motion
        nothing = np.nan if values.dtype.kind == "f" else SingularityKind.UNREACHABLE if name == "kind" else 0
        spread[name] = np.full((len(good), *values.shape[1:]), nothing, dtype=values.dtype)
        spread[name][good] = values
        read_only(spread[name])
    return Singularities(**spread)


def _lacks_rank(values: Array, tolerance: float) -> BoolArray:
    """Return (N,) whether the smallest singular value counts as zero; values (N, c), largest first; NaN does not."""
    result: BoolArray = values[:, -1] <= tolerance * values[:, 0]
    return result


def _widest(vectors: Array, values: Array, tolerance: float) -> Array:
    """Return (N, n) the unit vector along which vectors of a null space extend farthest, NaN where all are zero.

    Args:
        vectors: (N, n, p) the platform's part of each singular vector.
        values: (N, c) its singular value, c ≤ p; vectors without a value belong to no loss of rank.
        tolerance: singular values below this fraction of the largest count as zero.
    """
    null = values <= tolerance * values[:, :1]
    u, size, _ = np.linalg.svd(vectors[:, :, : values.shape[1]] * null[:, None, :], full_matrices=False)
    # null vectors are exact to about the tolerance: a platform part below its root is rounding
    result: Array = np.where(size[:, :1] > np.sqrt(tolerance), u[:, :, 0], np.nan)
    return result


def _unit(vectors: Array) -> Array:
    """Return unit vectors (N, n), NaN where the length is rounding."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    with np.errstate(invalid="ignore", divide="ignore"):
        result: Array = np.where(length > RANK_TOLERANCE, vectors / length, np.nan)
    return result
