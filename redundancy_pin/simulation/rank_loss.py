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

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from scipy.linalg import lapack, qr
from scipy.optimize import minimize_scalar

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.kinematics.chain import ClosedChain
from redundancy_pin.kinematics.coordinates import velocity_scale

NODES = 20
"""Points across a rank loss: even, so that none is on it. What is interpolated is analytic, and 1e-15 is reached."""

WIDEST, NARROWEST = 0.3, 0.01
"""Half of the line across a rank loss, rad (or m over the characteristic length): the longest that is tried, and the
shortest, where the innermost points are 1e-3 from it and a₀ keeps seven digits."""

WITHIN, BEYOND = 0.85, 0.6
"""Shares of that half: a motion is taken over when it is nearer than the first, and let go farther than the second on
its way out, so that its steps have room."""

GAP = 1e-11
"""Closure gap, m, of the interpolated sheet; two sheets that miss each other by more do not meet."""

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

_APART = 1e-6
"""rad; rank losses nearer to each other are one."""

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


@dataclass(frozen=True, eq=False)
class _Point:
    """A point of a sheet: joints' positions from an origin, N, a₀ at some rate, and the ratio of singular values."""

    place: Array
    basis: Array
    bias: Array
    ratio: float


@dataclass(frozen=True, eq=False)
class _Line:
    """Points of a sheet on a line: ``places`` (m, nv), ``bases`` (m, nv, d), ``biases`` (m, nv), ``ratios`` (m,)."""

    places: Array
    bases: Array
    biases: Array
    ratios: Array


class _Follower:
    """Points of a sheet from guesses near it, with the independent joints where the guess has them.

    Attributes:
        chain: evaluator of the robot.
        origin: (nq,) configuration from which joints' positions are measured.
        independent, dependent: (d,) and (r,) velocity indices.
        scale: (d,) what makes radians of z: one over the characteristic length for lengths.
    """

    def __init__(self, chain: ClosedChain, origin: Array, independent: IntArray, dependent: IntArray) -> None:
        self.chain, self.origin, self.independent, self.dependent = chain, origin, independent, dependent
        self._columns, scale = chain.pose_columns, velocity_scale(chain.robot)
        self.scale, self._inverse_scale = scale[independent] / chain.robot.characteristic_length, 1.0 / scale
        self._still = np.zeros(chain.model.nv)

    def configuration(self, place: Array) -> Array:
        """Return the configuration (nq,) at a place (nv,)."""
        q: Array = pin.integrate(self.chain.model, self.origin, place)
        return q

    def point(self, guess: Array, rate: Array) -> _Point | None:
        """Return the point that a guess (nv,) leads to, with a₀ at ż (d,); None where Newton's method fails."""
        place = self.close(guess)
        if place is None:
            return None
        chain, dependent, independent = self.chain, self.dependent, self.independent
        jacobian = chain.jacobian()
        solve = np.linalg.inv(jacobian[:, dependent])
        basis = np.zeros((len(place), len(independent)))
        basis[independent, np.arange(len(independent))] = 1.0
        basis[dependent] = -solve @ jacobian[:, independent]
        bias = np.zeros(len(place))
        chain.update(self.configuration(place), basis @ rate)
        bias[dependent] = -solve @ chain.bias()
        return _Point(place, basis, bias, self._ratio(jacobian))

    def line(self, guesses: Array, rate: Array, nodes: Array, weights: Array) -> _Line | None:
        """Return the line through guesses (m, nv) at nodes about 0, or None where it is not on one smooth sheet.

        Where Newton's method has taken some points to another sheet, the interpolated closures gape between them.
        """
        points = [self.point(guess, rate) for guess in guesses]
        closed = [point for point in points if point is not None]
        if len(closed) < len(points):
            return None
        places, bases, biases = (np.array([getattr(p, name) for p in closed]) for name in ("place", "basis", "bias"))
        ends = np.sort(nodes)
        for s in (0.5 * (ends[1:] + ends[:-1])).tolist():
            share = _lagrange(nodes, s, weights)
            gap, apart = self.gap(share @ places, np.tensordot(share, bases, 1) @ rate)
            if not (gap <= GAP and apart <= SLOPE):
                return None
        return _Line(places, bases, biases, np.array([point.ratio for point in closed]))

    def loss_near(self, nodes: Array, places: Array, guess: float, reach: float) -> float:
        """Return where between nodes, within reach of a guess, rank is lost; NaN where it is not."""
        weights = _barycentric(nodes)

        def ratio(s: float) -> float:
            return self.ratio(_lagrange(nodes, s, weights) @ places)

        bounds = guess - reach, guess + reach
        lowest = minimize_scalar(ratio, bounds=bounds, method="bounded", options={"xatol": 1e-9})
        # |s − s₀| on both sides of its zero tells where that is, better than a search for what is least
        s = float(lowest.x)
        left, right = s - 0.1 * _APART, s + 0.1 * _APART
        before, after = ratio(left), ratio(right)
        s = (left * after + right * before) / (before + after)
        return s if ratio(s) <= LOST else np.nan

    def losses(self, nodes: Array, places: Array) -> Array:
        """Return (l,) where between the outermost nodes rank is lost."""
        weights, ends = _barycentric(nodes), np.sort(nodes)

        def ratio(s: float) -> float:
            return self.ratio(_lagrange(nodes, s, weights) @ places)

        def minima(looks: Array) -> Array:
            ratios = np.array([ratio(s) for s in looks.tolist()])
            lowest = np.flatnonzero((ratios[1:-1] <= ratios[:-2]) & (ratios[1:-1] < ratios[2:])) + 1
            reach = np.maximum(looks[lowest + 1] - looks[lowest], looks[lowest] - looks[lowest - 1])
            losses = [
                self.loss_near(nodes, places, *at) for at in zip(looks[lowest].tolist(), reach.tolist(), strict=True)
            ]
            return np.array([loss for loss in losses if np.isfinite(loss)])

        step = (ends[-1] - ends[0]) / (8 * len(nodes))
        losses = minima(np.arange(ends[0], ends[-1], step))
        # two that are nearer to each other than the looks: seen from the one by looks closer and closer to it
        closer = step * 0.5 ** np.arange(-1.0, 15.0)
        beside = [minima(loss + np.append(-closer, closer[::-1])) for loss in losses.tolist()]
        found = np.sort(np.concatenate([losses, *beside]))
        apart: Array = found[np.diff(found, prepend=-np.inf) > _APART]
        return apart

    def ratio(self, place: Array) -> float:
        """Return the ratio of singular values at a place (nv,)."""
        self.chain.update(self.configuration(place), self._still)
        return self._ratio(self.chain.jacobian())

    def steepest(self) -> Array:
        """Return (d,) the gradient of the ratio of singular values at the origin, by z times its scale.

        A line along it meets the rank loss at the same place when it is shifted, to first order.
        """
        start = self.point(self._still, np.zeros(len(self.scale)))
        steps = np.zeros((0, len(self._still))) if start is None else (start.basis * (_PROBE / self.scale)).T
        sides = [[self.close(sign * step) for sign in (1.0, -1.0)] for step in steps]
        ratios = [[np.nan if place is None else self.ratio(place) for place in pair] for pair in sides]
        return np.array([(after - before) / (2.0 * _PROBE) for after, before in ratios])

    def gap(self, place: Array, velocity: Array) -> tuple[float, float]:
        """Return the closure gap, m, at a place (nv,), and how fast closures part at a velocity (nv,), m/s."""
        self.chain.update(self.configuration(place), self._still)
        apart = self.chain.jacobian() @ velocity
        return float(np.abs(self.chain.residual()).max()), float(np.abs(apart).max())

    def _ratio(self, jacobian: Array) -> float:
        return float(rank_ratio((jacobian * self._inverse_scale)[None][:, :, self._columns])[0])

    def close(self, guess: Array) -> Array | None:
        """Return the closed place (nv,) with the z of a guess."""
        chain, place, last = self.chain, guess.copy(), np.inf
        for _ in range(12):
            chain.update(self.configuration(place), self._still)
            residual = chain.residual()
            gap = float(np.abs(residual).max())
            if gap <= 1e-16 or (gap < GAP and gap > 0.3 * last):
                return place
            if not gap <= 10.0 * last:
                return None
            _, _, step, singular = lapack.dgesv(chain.jacobian()[:, self.dependent], residual)
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
        losses: (l,) where rank is lost on the line through the centre: there, and maybe at other places nearby.
        nodes: (m,) positions on the line, from the centre.
        places: (m, nv) joints' positions from the origin on the line through the centre.
        bases: (m, nv, d) N there.
        curvature: (m, nv) a₀ there for unit speed along the line.
    """

    follower: _Follower
    centre: Array
    along: Array
    half: float
    losses: Array
    nodes: Array
    places: Array
    bases: Array
    curvature: Array

    @cached_property
    def _weights(self) -> Array:
        return _barycentric(self.nodes)

    def position(self, q: Array) -> float:
        """Return where on its line a configuration is, from its middle."""
        return float(self.along @ self._relative(q))

    def distances(self, q: Array) -> Array:
        """Return how far beyond each rank loss (l,) on its line a configuration is; NaN where one has gone."""
        relative = self._relative(q)
        s = float(self.along @ relative)
        if len(self.follower.independent) == 1:
            return s - self.losses
        beside = self._beside(relative - s * self.along, np.zeros(len(relative)))
        if beside is None:
            return np.full(len(self.losses), np.nan)
        return s - np.array([self.follower.loss_near(self.nodes, beside.places, loss, _STEP) for loss in self.losses])

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
        relative = self._relative(q)
        s = float(self.along @ relative)
        if not abs(s) <= 1.05 * self.half:
            return None
        rate = v[self.follower.independent]
        share = _lagrange(self.nodes, s, self._weights)
        if len(self.follower.independent) == 1:
            place, basis = share @ self.places, np.tensordot(share, self.bases, 1)
            particular = (share @ self.curvature) * self.speed(v) ** 2
        else:
            beside = self._beside(relative - s * self.along, rate)
            if beside is None:
                return None
            place, basis = share @ beside.places, np.tensordot(share, beside.bases, 1)
            particular = share @ beside.biases
        columns, robot = self.follower.chain.pose_columns, self.follower.chain.robot
        closed, speed = self.follower.configuration(place), v.copy()
        closed[robot.carrier_position] = q[robot.carrier_position]
        speed[columns] = basis[columns] @ rate
        return Motion(closed, speed, basis, particular)

    def _beside(self, away: Array, rate: Array) -> _Line | None:
        """Return the line ``away`` (d,) from that through the centre, a₀ at a rate ż (d,)."""
        guesses = self.places + self.bases @ (away / self.follower.scale)
        return self.follower.line(guesses, rate, self.nodes, self._weights)


class _Way:
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
        if len(nearest) == 1:
            place: Array = self._places[0] + s * self._tangent
        else:
            place = _lagrange(at[nearest], s) @ np.array(self._places)[nearest]
        z = self._follower.independent
        place[z] = s * self._tangent[z]
        return place

    def extend(self, to: float) -> bool:
        """Add points up to s, from the outermost on; return whether that was possible."""
        side = np.copysign(1.0, to)
        last = max(side * at for at in self._at)
        while last < side * to:
            last += _STEP
            place = self._follower.close(self.guess(side * last))
            if place is None:
                # a point may fall on the rank loss itself, where nothing closes; the next one will not
                last += 0.37 * _STEP
                place = self._follower.close(self.guess(side * last))
                if place is None:
                    return False
            self._at.append(side * last)
            self._places.append(place)
            self._ratios.append(self._follower.ratio(place))
        return True

    def rank_loss(self, reach: float) -> float | None:
        """Return where J_c may lose rank, ahead within reach or just behind; None where it does not."""
        for side, most in ((1.0, reach), (-1.0, WITHIN * WIDEST)):
            while max(side * at for at in self._at) < most:
                if not self.extend(side * (max(side * at for at in self._at) + _STEP)):
                    break
                order = np.argsort(self._at)
                at, ratios = np.array(self._at)[order], np.array(self._ratios)[order]
                lowest = int(ratios.argmin())
                if 2 <= lowest < len(at) - 2 or (lowest and ratios[lowest] < LOST and lowest < len(at) - 1):
                    return _touch(at, ratios, lowest)
                if side > 0.0 and lowest == 0 and len(at) > 3:
                    break  # it moves away: the rank loss can be behind only
        return None

    def sheet(self, centre: float, half: float) -> Sheet | None:
        """Return the sheet on a line around a place, or None where it is not smooth or does not lose rank there."""
        if not (self.extend(centre + half) and self.extend(centre - half)):
            return None
        nodes = centre + half * np.cos(np.pi * (np.arange(NODES) + 0.5) / NODES)
        rate = self._tangent[self._follower.independent]
        guesses = np.array([self.guess(s) for s in nodes.tolist()])
        line = self._follower.line(guesses, rate, nodes - centre, _barycentric(nodes))
        # a point that by chance is on another rank loss would be as bad as one on this one
        if line is None or line.ratios.min() < _REGULAR * line.ratios.max():
            return None
        losses = self._follower.losses(nodes, line.places)
        if not len(losses):
            return None
        root = float(losses[np.abs(losses - centre).argmin()])
        return Sheet(
            follower=self._follower,
            centre=root * rate,
            along=rate * self._follower.scale,
            half=half,
            losses=losses - root,
            nodes=nodes - root,
            places=line.places,
            bases=line.bases,
            curvature=line.biases,
        )


def _touch(at: Array, ratios: Array, lowest: int) -> float:
    """Return where a function that looks like |s − s₀| touches zero, from points on both sides of it."""
    part = slice(max(lowest - 3, 0), lowest + 4)
    s, value = at[part] - at[lowest], ratios[part]
    powers = np.vander(s, min(4, len(s) - 1))
    results = []
    for last in (0.0, at[lowest - 1] - at[lowest]):  # the lowest point lies before the zero, or behind
        signed = np.where(s <= last, -value, value)
        fit, *_ = np.linalg.lstsq(powers, signed, rcond=None)
        roots = np.roots(fit)
        real = roots.real[np.abs(roots.imag) < 1e-9]
        if len(real):
            near = float(real[np.abs(real).argmin()])
            results.append((float(np.abs(powers @ fit - signed).max()), near))
    return float(at[lowest]) + (min(results)[1] if results else 0.0)


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
    follower = _Follower(chain, q.copy(), independent, dependent)
    along = moving[independent] * scale[independent] if count == 1 else follower.steepest()
    length = float(np.linalg.norm(along))
    if not length > 1e-9 * (size if count == 1 else 1.0):
        return None
    if count == 1:
        tangent = moving / length
    else:
        point = follower.point(np.zeros(model.nv), np.zeros(count))
        if point is None:
            return None
        along *= np.copysign(1.0, along @ (moving[independent] * scale[independent])) / length
        tangent = point.basis @ (along / scale[independent])
    way = _Way(follower, tangent)
    centre = way.rank_loss(reach)
    if centre is None:
        return None
    half = WIDEST
    while half >= NARROWEST:
        if abs(centre) <= WITHIN * half:
            sheet = way.sheet(centre, half)
            if sheet is not None:
                return sheet
        half *= 0.7
    # a narrower line than reaches here may be smooth: it is tried from nearer by
    return centre if centre > WITHIN * NARROWEST else None
