"""Simulate through poses where the closures themselves lose rank, on the solution branch of the motion so far.

At the flat pose of a parallelogram two motions cross, of the parallelogram and of the anti-parallelogram. J_c has a
further null direction there, and everything that is computed from J_c at one pose (the allowed velocities, their basis
N, the acceleration a₀ = −J_c⁺ J̇_c v) is undetermined at the crossing and ill-conditioned near it: with σ the smallest
singular value of J_c, rounding ε costs ε/σ in a position, ε/σ² in N and ε/σ³ in a₀.

Along one branch nothing of this is singular. With z the positions of joints that are independent there, q, N = ∂q/∂z
and a₀ are analytic in z. z are the independent coordinates of a robot that has these joints in place of its platform:
the follower of that robot (``kinematics.branch``) goes along the branch, and a ``Passage`` interpolates q, N = Γ and a₀
across the rank loss.

Efforts do not enter: accelerations follow from Nᵀ M N z̈ = Nᵀ (u − rnea(q, v, a₀)) as everywhere.
The closure forces λ, from J_cᵀ λ = rnea − u, need not be finite at the rank loss.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.polynomial import Chebyshev
from scipy.linalg import qr

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.kinematics.branch import LONGEST_STEP, ClosedState, Follower, follower
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.coordinates import with_independent_joints
from redundancy_pin.kinematics.passage import SPACINGS, Passage, find_passage
from redundancy_pin.robot.lookup import joint_names
from redundancy_pin.robot.scales import velocity_scale

WIDEST = 4.0 * SPACINGS[0]
"""Half of the longest passage, rad or characteristic lengths."""

WITHIN, BEYOND = 0.85, 0.6
"""Fractions of half a passage: a motion enters it nearer to its middle than the first, and leaves it farther away than
the second, so that its steps have room."""

LOST = 1e-6
"""Ratio of singular values of J_c at which rank counts as lost: of the place to which it is known, 1e-8 rad."""

NEAR = 0.05
"""Ratio of the singular values of J_c below which a rank loss ahead is looked for. Accelerations are good to 1e-12."""


def rank_ratio(scaled: Array) -> Array:
    """Return (N,) smallest over largest singular value of closure rows (N, r, p) without units.

    It is 1 without any rows. For a single row, whose ratio to itself is always 1, the result is its length, in
    characteristic lengths or rad per rad, which no unit of length changes.
    """
    if 0 in scaled.shape[1:]:
        return np.ones(len(scaled))
    if not np.isfinite(scaled).all():
        return np.full(len(scaled), np.nan)
    values = np.linalg.svd(scaled, compute_uv=False)
    single = scaled.shape[1] == 1
    return np.asarray(values[:, 0] if single else values[:, -1] / values[:, 0])


@dataclass(frozen=True, eq=False)
class BranchMotion:
    """The state on a branch with given z and ż, with N and a₀.

    Attributes:
        q: (nq,) configuration, carriers where they were.
        v: (nv,) velocity.
        basis: (nv, d) N.
        particular: (nv,) a₀, the acceleration where z̈ = 0.
    """

    q: Array
    v: Array
    basis: Array
    particular: Array


@dataclass(frozen=True, eq=False)
class Sheet:
    """A smooth branch of closed configurations across a rank loss, d joints independent.

    Attributes:
        passage: the branch across the rank loss, of the robot with these joints in place of its platform.
        independent, dependent: (d,) and (r,) velocity indices.
    """

    passage: Passage
    independent: IntArray
    dependent: IntArray

    def position(self, q: Array) -> float:
        """Return where on the passage a configuration (nq,) is, from its middle, rad or characteristic lengths."""
        return self.passage.position(self.passage.solver.coordinates_at(q)) * self.passage.spacing

    def speed(self, v: Array) -> float:
        """Return the speed along the passage, 1/s."""
        unit = self.passage.solver.unit
        return float((v[self.independent] / unit).dot(self.passage.step / unit)) / self.passage.spacing

    def at(self, q: Array, v: Array) -> BranchMotion | None:
        """Return the state on the branch with the z and ż of q (nq,) and v (nv,); None beyond the passage."""
        if not abs(self.position(q)) <= 1.05 * self.passage.half:
            return None
        solver = self.passage.solver
        rated = self.passage.at(solver.coordinates_at(q), v[self.independent], np.zeros(len(self.independent)))
        if rated is None:
            return None
        carriers, columns = solver.robot.carrier_position, solver.chain.pose_columns
        closed, speed = np.array(rated.state.q), v.copy()
        closed[carriers] = q[carriers]
        speed[columns] = rated.v[columns]
        return BranchMotion(closed, speed, rated.state.gamma, rated.a)

    def rank_losses(self, fractions: Array, configurations: Array) -> Array:
        """Return (l,) complex roots of the determinants of the loops, which are known at m fractions of a step.

        Loops that lose rank together have a root each: K has a block for each loop.

        Args:
            fractions: (m,) from 0 to 1.
            configurations: (m, nq) there.
        """
        solver, basis = self.passage.solver, self.passage.nodes[0].basis
        blocks, values = solver.blocks_of(basis), []
        for q in configurations:
            K = solver.matrix(q, basis)[0]
            values.append([np.linalg.det(K[rows[:, None], columns]) for rows, columns in blocks])
        scaled = np.array(values) / np.abs(values).max(axis=0)
        fits = (Chebyshev.fit(fractions, column, len(fractions) - 1, [0.0, 1.0]) for column in scaled.T)
        return np.concatenate([fit.trim(1e-13).roots() for fit in fits])


def sheet_ahead(chain: ClosedChain, q: Array, v: Array, reach: float) -> Sheet | float | None:
    """Return the branch that a motion is on, if it comes to a rank loss of the closures.

    Args:
        chain: evaluator of the robot.
        q: (nq,) closed configuration; J_c may have lost rank there, if v is not zero and one velocity is independent.
        v: (nv,) velocity, which the closures allow.
        reach: how far along the way to look, rad or characteristic lengths.

    Returns:
        The branch; or, if the rank loss is too far away for a passage to reach here, its distance along the way; or
        None: without a rank loss ahead, or a crossing of smooth branches there, or if a joint has several DOF.
    """
    model, columns = chain.model, chain.pose_columns
    if any(joint.nv != 1 for joint in list(model.joints)[1:]) or not chain.rows:
        return None
    scale = velocity_scale(chain.robot) / chain.robot.characteristic_length
    moving = v.copy()
    moving[chain.robot.carrier_velocity] = 0.0
    size, count = float(np.linalg.norm(moving * scale)), len(columns) - chain.rows
    if not size > 0.0 or not count:
        return None
    chain.update(q, np.zeros(model.nv))
    _, values, vectors = np.linalg.svd(chain.closure_rows())
    allowed, lost = vectors[chain.rows :].T, bool(values[-1] < 1e-3 * values[0])
    if lost:  # only the velocity distinguishes the branches
        if count > 1:
            return None
        allowed = (moving * scale)[columns, None] / size
    _, _, order = qr(allowed.T, pivoting=True, mode="economic")
    independent = np.sort(columns[order[:count]])
    rate = moving[independent] * scale[independent]
    length = float(np.linalg.norm(rate))
    if not length > 1e-9 * size:
        return None
    joints = zip(joint_names(model), list(model.joints)[1:], strict=True)
    names = tuple(name for name, joint in joints if joint.idx_v in independent)
    own = follower(with_independent_joints(chain.robot, names))
    x = own.coordinates_at(q)
    gamma = moving[:, None] / moving[independent] if lost else None
    here = own.close(q, x, chain.basis) if gamma is None else own.singular_state(x, q, gamma, basis=chain.basis)
    if here is None:
        return None
    along = rate / length * own.unit  # the coordinates' increment per unit of length
    ahead = 0.0 if lost else _distance(own, here, along, reach)
    if ahead is None or ahead > WITHIN * WIDEST:
        return ahead
    for spacing in SPACINGS:
        passage = _passage(own, here, ahead, along * spacing) if ahead <= WITHIN * 4.0 * spacing else None
        if passage is not None:
            return Sheet(passage, independent, np.setdiff1d(columns, independent))
    # a narrower passage than reaches here may be smooth: it is tried from nearer by
    return ahead if ahead > WITHIN * 4.0 * SPACINGS[-1] else None


def _distance(own: Follower, here: ClosedState, along: Array, reach: float) -> float | None:
    """Return the distance to the first rank loss that the branch of a state passes; None without one."""
    done, start = 0.0, here.x
    while done < reach:
        step = min(LONGEST_STEP, reach - done)
        beyond = own.advance(here, start + (done + step) * along)
        if not isinstance(beyond, ClosedState):
            return None
        if beyond.interpolated:
            return done + step
        if own.changes_sign(here, beyond):
            (sign0, log0), (sign1, log1) = here.determinants, beyond.determinants
            lost = sign0 * sign1 < 0.0
            return done + step * float((1.0 / (1.0 + np.exp(log1[lost] - log0[lost]))).min())
        here, done = beyond, done + step
    return None


def _passage(own: Follower, here: ClosedState, ahead: float, step: Array) -> Passage | None:
    """Return the passage around a rank loss, which is a distance ahead; None if it is not smooth."""
    spacing = float(np.linalg.norm(step / own.unit))
    centre = here.x + ahead / spacing * step
    first = own.advance(here, centre - 4.0 * step)
    passage = find_passage(own, first, centre, step) if isinstance(first, ClosedState) else None
    if passage is None:
        return None
    rate, still = step / spacing, np.zeros(len(step))
    between = (passage.centre + place * step for place in (-3.5, -2.5, -1.5, 0.0, 1.5, 2.5, 3.5))
    return passage if all(passage.at(x, rate, still) is not None for x in between) else None
