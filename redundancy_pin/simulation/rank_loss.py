"""Poses where the closures themselves lose rank, and how a motion is carried across them on its own branch.

At the flat pose of a parallelogram two motions cross: that of the parallelogram and that of the anti-parallelogram. The
closures Φ(q) = 0 are two smooth sheets that meet there, J_c has a further null direction, and everything that is
computed from J_c at one pose (which velocities are allowed, their basis N, the acceleration a₀ = −J_c⁺ J̇_c v) is
undetermined at the crossing and ill-conditioned beside it: with σ the smallest singular value of J_c, rounding ε costs
ε/σ in a position, ε/σ² in N and ε/σ³ in a₀.

Along one sheet nothing of this is singular. With z the velocities that are independent there, the sheet is a graph
q = ψ(z), and ψ, N = ∂ψ/∂z and a₀ = ψ''(ż, ż) are analytic in z, through the rank loss too: their values there are the
limits along the sheet. So they are evaluated at Chebyshev points on a line across the rank loss, where J_c has full
rank, and interpolated. Which sheet is followed is decided by the continuity of its tangent: from one point of the line
to the next the sheet is extrapolated, and Newton's method closes the rest with z kept. An extrapolation error of second
order cannot reach the other sheet, which is away by the first.

Two sheets that pass near each other without meeting (a parallelogram with sides a little unequal) are told apart by the
gap that the interpolation leaves in the middle: there the motion turns sharply, and is integrated like any other.

What an effort does there is no matter of the closures: accelerations follow from Nᵀ M N z̈ = Nᵀ (u − rnea(q, v, a₀)) as
everywhere. The closure forces λ, from J_cᵀ λ = rnea − u, need not be finite at the rank loss.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from scipy.linalg import eigvals, lapack, qr

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.robot.scales import velocity_scale

NODES = 20
"""Points across a rank loss: even, so that none is on it. What is interpolated is analytic, and 1e-15 is reached."""

WIDEST, NARROWEST = 0.3, 0.01
"""Half of the line across a rank loss, rad (or m over the characteristic length): the longest that is tried, and the
shortest, where the innermost points are 1e-3 from it and a₀ keeps seven digits."""

WITHIN, BEYOND = 0.85, 0.6
"""Shares of that half: a motion is taken over when it is nearer than the first, and let go farther than the second on
its way out, so that its steps have room."""

GAP = 1e-11
"""Closure residual, m, of the interpolated sheet; two sheets that miss each other by more do not meet."""

SLOPE = 1e-7
"""Rate at which closures part, m/s per unit of speed, on the interpolated sheet."""

LOST = 1e-6
"""Ratio of singular values of J_c at which rank counts as lost: of the place to which it is known, 1e-8 rad."""

NEAR = 0.05
"""Ratio of the singular values of J_c below which a rank loss ahead is looked for. Accelerations are good to 1e-12."""

_STEP = 0.03
"""Distance of the points by which a sheet is followed."""

_REGULAR = 0.03
"""Share of the largest ratio of singular values on a line that every point of it must have; the innermost have 0.08."""

_PROBE = 1e-4
"""Step of the differences that tell which way rank is lost, rad."""

_ORDER = 6
"""Points of an extrapolation."""


def rank_ratio(scaled: Array) -> Array:
    """Return (N,) smallest over largest singular value of scaled closure rows (N, r, p); 1 where there are none."""
    if 0 in scaled.shape[1:]:
        return np.ones(len(scaled))
    if not np.isfinite(scaled).all():
        return np.full(len(scaled), np.nan)
    values = np.linalg.svd(scaled, compute_uv=False)
    ratio: Array = values[:, -1] / values[:, 0]
    return ratio


def _barycentric(nodes: Array) -> Array:
    distance = nodes[:, None] - nodes
    np.fill_diagonal(distance, 1.0)
    weights: Array = 1.0 / (distance / np.abs(distance).max()).prod(axis=1)
    return weights


def _lagrange(nodes: Array, s: float, weights: Array | None = None) -> Array:
    """Return (m,) the shares of the values at the nodes in their polynomial's value at s (barycentric formula)."""
    away = s - nodes
    if not away.all():
        there: Array = (away == 0.0).astype(np.float64)
        return there
    share: Array = (_barycentric(nodes) if weights is None else weights) / away
    share /= share.sum()
    return share


class _Follower:
    """Points of a sheet from guesses near it, with the independent joints where the guess has them.

    A point is (nv, d + 2): the joints' positions from an origin (its place), N, and a₀ at some rate.

    Attributes:
        chain: evaluator of the robot.
        origin: (nq,) configuration from which joints' positions are measured.
        independent, dependent: (d,) and (r,) velocity indices.
        scale: (d,) what makes radians of z: one over the characteristic length for lengths.
    """

    def __init__(self, chain: ClosedChain, origin: Array, independent: IntArray, dependent: IntArray) -> None:
        self.chain, self.origin, self.independent, self.dependent = chain, origin, independent, dependent
        scale = velocity_scale(chain.robot)
        self.scale, self._inverse_scale = scale[independent] / chain.robot.characteristic_length, 1.0 / scale
        self._still = np.zeros(chain.model.nv)

    def configuration(self, place: Array) -> Array:
        """Return the configuration (nq,) at a place (nv,)."""
        q: Array = pin.integrate(self.chain.model, self.origin, place)
        return q

    def point(self, guess: Array, rate: Array) -> Array | None:
        """Return the point that a guess (nv,) leads to, with a₀ at ż (d,); None where Newton's method fails."""
        place = self.close(guess)
        if place is None:
            return None
        chain, dependent, independent = self.chain, self.dependent, self.independent
        jacobian = chain.jacobian()
        solve = np.linalg.inv(jacobian[:, dependent])
        point = np.zeros((len(place), len(independent) + 2))
        basis = point[:, 1:-1]
        point[:, 0] = place
        basis[independent, np.arange(len(independent))] = 1.0
        basis[dependent] = -solve @ jacobian[:, independent]
        chain.update(self.configuration(place), basis @ rate)
        point[dependent, -1] = -solve @ chain.bias()
        return point

    def line(self, guesses: Array, rate: Array, nodes: Array, weights: Array) -> Array | None:
        """Return the points (m, nv, d + 2) from guesses (m, nv) at nodes about 0; None where no smooth sheet has all.

        Where Newton's method has taken some points to another sheet, the interpolated closures gape between them.
        """
        points = [self.point(guess, rate) for guess in guesses]
        closed = [point for point in points if point is not None]
        if len(closed) < len(points):
            return None
        values, ends = np.array(closed), np.sort(nodes)
        for s in (0.5 * (ends[1:] + ends[:-1])).tolist():
            point = np.tensordot(_lagrange(nodes, s, weights), values, 1)
            parting = self.jacobian(point[:, 0]) @ (point[:, 1:-1] @ rate)
            if not (np.abs(self.chain.residual()).max() <= GAP and np.abs(parting).max() <= SLOPE):
                return None
        return values

    def jacobian(self, place: Array) -> Array:
        """Return J_c (r, nv) at a place (nv,)."""
        self.chain.update(self.configuration(place), self._still)
        return self.chain.jacobian()

    def ratio(self, place: Array) -> float:
        """Return the ratio of singular values at a place (nv,)."""
        scaled = self.jacobian(place) * self._inverse_scale
        return float(rank_ratio(scaled[None][:, :, self.chain.pose_columns])[0])

    def roots(self, nodes: Array, configurations: Iterable[Array]) -> Array:
        """Return (l,) complex roots of det D along configurations (nq,) at nodes (m,): there rank is lost.

        D is the dependent block of J_c. Between the nodes roots are those of J_c; farther off they mean nothing.
        The interpolant of D is linearised in barycentric form: Σ D_j x_j = 0, x_j = w_j x / (s − s_j). Loops that lose
        rank together are eigenvalues of the pencil as often, and each as well conditioned as one alone.
        """
        r, weights, blocks = len(self.dependent), _barycentric(nodes), []
        for q in configurations:
            self.chain.update(q, self._still)
            blocks.append(self.chain.jacobian()[:, self.dependent] * self._inverse_scale[self.dependent])
        pencil, unit = np.zeros((2, r * (len(nodes) + 1), r * (len(nodes) + 1)))
        pencil[:r, r:] = np.concatenate(blocks, axis=1)
        pencil[r:, :r] = np.kron(weights[:, None] / np.abs(weights).max(), np.eye(r))
        pencil[r:, r:], unit[r:, r:] = np.kron(np.diag(nodes), np.eye(r)), np.eye(r * len(nodes))
        roots: Array = eigvals(pencil, unit, check_finite=False)
        return roots[np.isfinite(roots)]

    def close(self, guess: Array) -> Array | None:
        """Return the closed place (nv,) with the z of a guess."""
        chain, place, last = self.chain, guess.copy(), np.inf
        for _ in range(12):
            jacobian, residual = self.jacobian(place), chain.residual()
            gap = float(np.abs(residual).max())
            if gap <= 1e-16 or (gap < GAP and gap > 0.3 * last):
                return place
            if not gap <= 10.0 * last:
                return None
            _, _, step, singular = lapack.dgesv(jacobian[:, self.dependent], residual)
            if singular or not np.abs(step).max() < 0.5:
                return None
            place[self.dependent] -= step
            last = gap
        return None


@dataclass(frozen=True, eq=False)
class Motion:
    """What a sheet makes of a state: the state on it, N and a₀, see ``Sheet``."""

    q: Array
    v: Array
    basis: Array
    particular: Array


@dataclass(frozen=True, eq=False)
class Sheet:
    """One smooth sheet of the closed configurations across a rank loss, d independent velocities.

    Attributes:
        follower: of the sheet; z are its independent joints' positions from its origin.
        centre: (d,) z of the rank loss on the way that led here.
        along: (d,) direction of the line in z times its scale, of unit length.
        half: half of the line's length.
        nodes: (m,) positions on the line, from the centre.
        points: (m, nv, d + 2) of the sheet there (``_Follower``), a₀ for unit speed along the line.
    """

    follower: _Follower
    centre: Array
    along: Array
    half: float
    nodes: Array
    points: Array

    @cached_property
    def _weights(self) -> Array:
        return _barycentric(self.nodes)

    def position(self, q: Array) -> float:
        """Return where on its line a configuration is, from its middle."""
        return float(self.along @ self._relative(q))

    def speed(self, v: Array) -> float:
        """Return the speed along the line, 1/s."""
        return float(self.along @ (v[self.follower.independent] * self.follower.scale))

    def _relative(self, q: Array) -> Array:
        model = self.follower.chain.model
        if model.nq != model.nv:  # the inner stages of an integrator leave the unit circle
            q = pin.normalize(model, q)
        z = pin.difference(model, self.follower.origin, q)[self.follower.independent]
        relative: Array = (z - self.centre) * self.follower.scale
        return relative

    def at(self, q: Array, v: Array) -> Motion | None:
        """Return the state on the sheet that has the z and ż of a state, with N and a₀; None beyond the line's ends."""
        relative, rate = self._relative(q), v[self.follower.independent]
        s = float(self.along @ relative)
        if not abs(s) <= 1.05 * self.half:
            return None
        points = self.points if len(rate) == 1 else self._beside(relative, rate)
        if points is None:
            return None
        point = np.tensordot(_lagrange(self.nodes, s, self._weights), points, 1)
        basis, particular = point[:, 1:-1], point[:, -1] * (self.speed(v) ** 2 if len(rate) == 1 else 1.0)
        columns, robot = self.follower.chain.pose_columns, self.follower.chain.robot
        closed, speed = self.follower.configuration(point[:, 0]), v.copy()
        closed[robot.carrier_position] = q[robot.carrier_position]
        speed[columns] = basis[columns] @ rate
        return Motion(closed, speed, basis, particular)

    def _beside(self, relative: Array, rate: Array) -> Array | None:
        """Return the points of the line through z ``relative`` (d,) to the centre, times its scale; a₀ at ż (d,)."""
        away = (relative - (self.along @ relative) * self.along) / self.follower.scale
        guesses = self.points[:, :, 0] + self.points[:, :, 1:-1] @ away
        return self.follower.line(guesses, rate, self.nodes, self._weights)


class _SheetLine:
    """The sheet along a line in z through a closed configuration: points one by one, each from those next to it.

    Args:
        follower: of the sheet.
        tangent: (nv,) velocity at the start for unit speed along the line.
    """

    def __init__(self, follower: _Follower, tangent: Array) -> None:
        self._follower, self._tangent = follower, tangent
        start = np.zeros(len(tangent))
        self._at, self._places, self._ratios = [0.0], [start], [follower.ratio(start)]

    def guess(self, s: float) -> Array:
        """Return the place at s, extrapolated from the points nearest to it."""
        at = np.array(self._at)
        nearest = np.argsort(np.abs(at - s))[:_ORDER]
        place: Array = s * self._tangent
        if len(nearest) > 1:
            place = _lagrange(at[nearest], s) @ np.array([self._places[i] for i in nearest.tolist()])
        z = self._follower.independent
        place[z] = s * self._tangent[z]
        return place

    def extend(self, to: float) -> bool:
        """Add points up to s, from the outermost on; return whether that was possible."""
        side = np.copysign(1.0, to)
        last = max(side * at for at in self._at)
        while last < side * to:
            # a point may fall on the rank loss itself, where nothing closes; the next one will not
            tries = ((at, self._follower.close(self.guess(side * at))) for at in (last + _STEP, last + 1.37 * _STEP))
            last, place = next(((at, place) for at, place in tries if place is not None), (last, None))
            if place is None:
                return False
            self._at.append(side * last)
            self._places.append(place)
            self._ratios.append(self._follower.ratio(place))
        return True

    def rank_loss(self, reach: float) -> float | None:
        """Return where J_c may lose rank: the first place ahead within reach, else one just behind, if there is any."""
        self.extend(-2.0 * _STEP)
        for side, most in ((1.0, reach), (-1.0, WITHIN * WIDEST)):
            while (last := max(side * at for at in self._at)) < most and self.extend(side * (last + _STEP)):
                near = np.argsort(side * np.array(self._at))[-6:].tolist()  # the outermost points
                before, low, after = [np.inf, *(self._ratios[i] for i in near)][-4:-1]
                if not before >= low < after:
                    continue
                at = self._at[near[-3]]
                configurations = [self._follower.configuration(self._places[i]) for i in near]
                roots = self._follower.roots(np.array([self._at[i] for i in near]), configurations)
                # others are of sheets that keep apart, or beyond the points
                roots = roots[(np.abs(roots.imag) < _STEP) & (np.abs(roots.real - at) < 2.0 * _STEP)]
                if len(roots):
                    return float(roots.real[np.abs(roots - at).argmin()])
        return None

    def steepest(self, loss: float) -> _SheetLine | None:
        """Return the line from beside a rank loss along the gradient of the ratio of singular values, if it has one.

        A line along it meets the rank loss at the same place when it is shifted, to first order. It is taken beside the
        rank loss, for elsewhere another loop may be the one that is nearer to its own.
        """
        away = np.abs(np.array(self._at) - loss)
        place = self._places[int(np.where(away < _STEP, np.inf, away).argmin())]
        old = self._follower
        new = _Follower(old.chain, old.configuration(place), old.independent, old.dependent)
        start = new.point(np.zeros(len(place)), np.zeros(len(new.scale)))
        if start is None:
            return None
        steps = (start[:, 1:-1] * (_PROBE / new.scale)).T
        sides = [[new.close(sign * step) for sign in (1.0, -1.0)] for step in steps]
        ratios = [[np.nan if place is None else new.ratio(place) for place in pair] for pair in sides]
        along = np.array([(after - before) / (2.0 * _PROBE) for after, before in ratios])
        length = float(np.linalg.norm(along))
        if not length > 1e-9:
            return None
        along *= np.copysign(1.0, along @ (self._tangent[new.independent] * new.scale)) / length
        return _SheetLine(new, start[:, 1:-1] @ (along / new.scale))

    def position(self, q: Array) -> float:
        """Return how far along the line a configuration (nq,) is."""
        follower = self._follower
        z = pin.difference(follower.chain.model, follower.origin, q)[follower.independent] * follower.scale
        return float(z @ (self._tangent[follower.independent] * follower.scale))

    def sheet(self, centre: float, half: float) -> Sheet | None:
        """Return the sheet on a line around a place, or None where it is not smooth or does not lose rank there."""
        if not (self.extend(centre + half) and self.extend(centre - half)):
            return None
        nodes = centre + half * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        follower, rate = self._follower, self._tangent[self._follower.independent]
        guesses = np.array([self.guess(s) for s in nodes.tolist()])
        points = follower.line(guesses, rate, nodes - centre, _barycentric(nodes))
        if points is None:
            return None
        # a point that by chance is on another rank loss would be as bad as one on this one
        ratios = [follower.ratio(place) for place in points[:, :, 0]]
        if min(ratios) < _REGULAR * max(ratios):
            return None
        roots = follower.roots(nodes, [follower.configuration(place) for place in points[:, :, 0]])
        root = float(roots.real[np.abs(roots - centre).argmin()])
        if not (abs(root - centre) < half and follower.ratio(_lagrange(nodes, root) @ points[:, :, 0]) <= LOST):
            return None
        return Sheet(follower, root * rate, rate * follower.scale, half, nodes - root, points)


def sheet_ahead(chain: ClosedChain, q: Array, v: Array, reach: float) -> Sheet | float | None:
    """Return the sheet that a motion is on, if it comes to a rank loss of the closures.

    Args:
        chain: evaluator of the robot.
        q: (nq,) closed configuration; J_c may have lost rank there, if v is not zero and one velocity is independent.
        v: (nv,) velocity, which the closures allow.
        reach: how far along the way to look.

    Returns:
        The sheet; or, where the rank loss is too far for it to reach here, its distance along the way; or None: there
        is no rank loss ahead, or it is no crossing of smooth sheets, or not of joints of one freedom each.
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
    _, values, vectors = np.linalg.svd(chain.jacobian()[:, columns] / scale[columns])
    allowed = vectors[chain.rows :].T
    if values[-1] < 1e-3 * values[0]:  # the velocity is what tells the sheets apart
        if count > 1:
            return None
        allowed = (moving * scale)[columns, None] / size
    _, _, order = qr(allowed.T, pivoting=True, mode="economic")
    independent = columns[order[:count]]
    dependent = np.setdiff1d(columns, independent)
    along = moving[independent] * scale[independent]
    length = float(np.linalg.norm(along))
    if not length > 1e-9 * size:
        return None
    line = _SheetLine(_Follower(chain, q.copy(), independent, dependent), moving / length)
    centre = line.rank_loss(reach)
    if centre is None or centre > WITHIN * WIDEST:
        return centre
    if count > 1:
        steepest = line.steepest(centre)
        centre = None if steepest is None else steepest.rank_loss(WIDEST)
        if steepest is None or centre is None:
            return None
        line = steepest
    ahead = centre - line.position(q)
    half = WIDEST
    while half >= NARROWEST:
        sheet = line.sheet(centre, half) if abs(ahead) <= WITHIN * half else None
        if sheet is not None:
            return sheet
        half *= 0.7
    # a narrower line than reaches here may be smooth: it is tried from nearer by
    return ahead if ahead > WITHIN * NARROWEST else None
