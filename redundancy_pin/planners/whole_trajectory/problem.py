"""The numbers of the programme: nodes in time, and what a backend contributes at them.

Nodes lie exactly on jumps, kinks and singular instants, denser beside the latter. At each of them W, f and the carrier
forces are known by coefficients.

f is exactly a sum of terms over carriers that slide or turn, each on a link of its own (``carrier_model``); with others
it is an expression, or fitted to second order around a motion in s, s², ṡ, s ṡ, s̈, ṡ² and s s̈. The actuation matrix
loses rank at a type II singularity, and the efforts there need the rates of these coefficients as well. At a singular
instant there are directions u with uᵀ W = 0. Then W τ = f requires uᵀ f = 0, whatever τ is (compatibility), and leaves
the part of τ in the null space of W open. Differentiating W τ = f in time and projecting on u determines it, since
uᵀ W τ̇ = 0:

    uᵀ Ẇ τ = uᵀ ḟ,    ḟ = ∂f/∂t + ∂f/∂s ṡ + ∂f/∂ṡ s̈ + ∂f/∂s̈ s⃛.

Where the motion crosses the singularity at a rate, (W; uᵀ Ẇ) has full rank, and both equations together give the one
τ that W⁻¹ f tends to. The jerk of the carriers enters: that it is the same on both sides makes the limits the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, IntArray, read_only, require_few
from redundancy_pin.dynamics.base import (
    Dynamics,
    DynamicsAlongMotion,
    ExactAlongMotion,
    ReducedDynamics,
    has_expressions,
)
from redundancy_pin.errors import InfeasiblePlanError, UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.base_wrench import BASE, BaseWrench, base_wrench, load_at_rest
from redundancy_pin.planners.carrier_model import (
    Actuation,
    CarrierModel,
    TimedModel,
    carrier_model,
    target_effort,
    turning_model,
)
from redundancy_pin.planners.whole_trajectory.options import WholeTrajectoryScales, WholeTrajectorySettings
from redundancy_pin.spectrum import scaled, spectrum_of
from redundancy_pin.trajectory import Side
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, chebyshev_times

MOST_NODES = 100_000  # unknowns and rows of the programme are a few dozen times as many

LEAST_STEPS = 2
"""Steps between two events; fewer would tie the carriers' jerk to the distance of the events."""

NEAR = 0.2
"""Smallest over largest singular value of W below which the steps get a middle node from the start: there a kink in s̈
that is harmless elsewhere makes efforts between the nodes that the nodes do not show."""


@dataclass(frozen=True, eq=False)
class Grid:
    """Nodes in time.

    ``t`` (M,) times, s; a time at which the reference acceleration jumps occurs twice; ``singular`` (q,) indices of the
    nodes on type II singularities; ``smooth`` (M,) nodes across which the jerk of the carriers is continuous: the
    singular ones, and the middles of steps in which the efforts would otherwise differ from those at both ends.
    """

    t: Array
    singular: IntArray
    smooth: BoolArray

    @property
    def h(self) -> Array:
        """(M − 1,) lengths of the steps, s; zero across a jump."""
        return read_only(np.diff(self.t))


def grid_of(source: ContinuousMotion, singular: Sequence[float], dt: float, ends: bool = False) -> Grid:
    """Return nodes at most ``dt`` apart, with every event on a node.

    ``singular``: times on a type II singularity, s; ``dt``: largest step, s; ``ends``: steps become shorter towards
    both ends, as those of a harmonic motion.
    """
    require_few(
        (source.end - source.start) / dt, MOST_NODES, f"dt = {dt:g} s makes {{}} nodes", "Use a larger dt.", dt=dt
    )
    least = 1e-9 * (source.end - source.start)
    # one that rounding keeps from a jump is on it, or the jump would have no node of its own
    inside = [t for t in singular if source.start <= t <= source.end]
    on = [next((jump for jump in source.breaks if abs(jump - t) <= least), t) for t in inside]
    events = np.unique([*on, *(t for t in source.kinks if all(abs(t - other) > least for other in on))])
    span = source.end - source.start
    pieces = []
    for a, b in pairwise(events):
        phase = np.arccos(np.clip(1.0 - 2.0 * (np.array([a, b]) - source.start) / span, -1.0, 1.0)) * span / np.pi
        first, last = phase if ends else (a, b)
        piece = np.linspace(first, last, max(int(np.ceil((last - first) / dt - 1e-9)), LEAST_STEPS) + 1)[:-1]
        if ends:
            piece = np.append(a, source.start + 0.5 * span * (1.0 - np.cos(np.pi / span * piece[1:])))
        pieces.append(piece)
    times = np.concatenate([*pieces, events[-1:]])
    t = np.repeat(times, 1 + np.isin(times, source.breaks))
    return _grid(t, np.isin(t, on), np.zeros(len(t), dtype=bool))


def first_mesh(dynamics: Dynamics, source: ContinuousMotion, dt: float, ends: bool = False) -> Grid:
    """Return the nodes of ``grid_of``, singular instants among them, and a middle in each step beside a singularity."""
    grid = grid_of(source, Actuation.along(dynamics, source).singular_instants, dt, ends)
    near = near_singular(dynamics.along(source.sample_at(grid.t)).reduce())
    return with_middles(grid, near[1:] | near[:-1])


def near_singular(reduced: ReducedDynamics) -> BoolArray:
    """Return (M,) at which nodes W is near a type II singularity."""
    values = spectrum_of(scaled(reduced.W, reduced.row_scale, reduced.column_scale)).singular_values
    # the only singular value of a single freedom is compared with what it is elsewhere
    size = values[:, 0] if values.shape[1] > 1 else values.max()
    return np.asarray(values[:, -1] < NEAR * size)


def with_middles(grid: Grid, steps: BoolArray) -> Grid:
    """Return a grid with a node in the middle of each marked step, across which the jerk is continuous.

    The efforts are then seen inside these steps, while the carriers have no more freedom than before.

    ``steps`` (M − 1,) which steps; those of length zero are left alone.
    """
    marked = np.flatnonzero(np.asarray(steps) & (np.diff(grid.t) > 0.0))
    middle = 0.5 * (grid.t[marked] + grid.t[marked + 1])
    singular = np.zeros(len(grid.t), dtype=bool)
    singular[grid.singular] = True
    t = np.insert(grid.t, marked + 1, middle)
    return _grid(t, np.insert(singular, marked + 1, False), np.insert(grid.smooth, marked + 1, True))


def _grid(t: Array, singular: BoolArray, smooth: BoolArray) -> Grid:
    h = np.diff(t)
    inner = np.zeros(len(t), dtype=bool)
    inner[1:-1] = (h[:-1] > 0.0) & (h[1:] > 0.0)
    return Grid(read_only(t), read_only(np.flatnonzero(singular)), read_only((smooth | singular) & inner))


def steps_around(grid: Grid, times: Array, by: int) -> BoolArray:
    """Return (M − 1,) the steps in which some times, s, lie, and so many more on both sides of each."""
    steps = np.zeros(len(grid.h), dtype=bool)
    steps[np.searchsorted(grid.t, times, side="right") - 1] = True
    return widened(steps, by)


def widened(steps: BoolArray, by: int) -> BoolArray:
    """Return the steps (M − 1,) and so many more on both sides of each."""
    wider: BoolArray = np.convolve(steps, np.ones(2 * by + 1)) > 0.5
    return wider[by : by + len(steps)]


# --- coefficients at the nodes ---

S, S2, SD, S_SD, SDD = range(5)
"""Places of s, s², ṡ, s ṡ and s̈ among the terms of a ``CarrierModel``."""

LOST = 1e-6
"""Singular values below this fraction of the largest are lost at a singular instant; one that is only touched is known
to the square root of rounding."""

CROSSED = 1e-3
"""Change of the vanishing singular value over the whole motion, at its rate at the singular instant and relative to the
largest, from which the singularity is crossed. A touch leaves what rounding makes of it, 1e-6; on the circle of the
2-RPR it is 4."""


Reader = Callable[[DynamicsAlongMotion], CarrierModel]
"""Reads the coefficients off a backend along a platform motion."""


@dataclass(frozen=True, eq=False)
class Task:
    """A planning task: what does not depend on the nodes."""

    dynamics: Dynamics
    source: ContinuousMotion
    settings: WholeTrajectorySettings


@dataclass(frozen=True, eq=False)
class SingularNode:
    """A node on a type II singularity; r directions are lost.

    ``index``: its number among the nodes; ``lost`` (r, n) rows u with u W = 0; ``rate``: time derivatives of the
    coefficients of W, f and the carrier forces, one sample; ``exact``: where f is no polynomial but an expression,
    dynamics at the node and at times around it, and what the values at these weigh in a derivative by time.
    """

    index: int
    lost: Array
    rate: CarrierModel
    exact: tuple[ExactAlongMotion, ExactAlongMotion, Array] | None = None


@dataclass(frozen=True, eq=False)
class WholeTrajectoryProblem:
    """The numbers of the programme; M nodes, n coordinates, m main actuators, k carriers.

    ``grid``: the nodes; ``model``: coefficients of W, f and the carrier forces at the nodes; fitted,
    ``f_terms`` has two more terms, ṡ² and s s̈, in the end; ``singular``: the nodes on type II singularities;
    ``actuated_rate`` (M, m) rates of the main actuators; ``target`` (M, m) efforts that the objective "tracking" aims
    at; ``settings``: limits, ends and objective; ``scales``: sizes; ``exact``: where f has other terms, dynamics
    whose expressions for f and the carrier forces stand in place of the polynomials of ``model``; ``base``: the wrench
    on the base, where an objective is about it; ``shares`` (M, m + k): fractions of the limits of efforts and forces
    that the nodes may use; all of them when left out.
    """

    grid: Grid
    model: CarrierModel
    singular: tuple[SingularNode, ...]
    actuated_rate: Array
    target: Array
    settings: WholeTrajectorySettings
    scales: WholeTrajectoryScales
    exact: ExactAlongMotion | None = None
    base: BaseWrench | None = None
    shares: Array | None = None

    def carrier_force(self, carriers: CarrierMotion) -> Array:
        """Return the carrier forces (M, k) for a motion at the nodes, N."""
        if self.exact is not None:
            return np.asarray(self.exact.reduce(carriers).carrier_force)
        return self.model.carrier_force(carriers.s, carriers.sd, carriers.sdd)

    def carriers(self, values: Mapping[str, Array]) -> CarrierMotion:
        """Return the motion at the nodes, in units, of scaled s, ṡ and s̈; what is left out is zero."""
        u, zero = self.scales, np.zeros((len(self.grid.t), self.model.k))
        return CarrierMotion(*(values.get(name, zero) * getattr(u, name) for name in ("s", "sd", "sdd")))

    def position(self, values: Mapping[str, Array]) -> PiecewisePolynomial:
        """Return the positions, m, as a function of time, of scaled s, ṡ and s̈: s̈ is linear in a step."""
        carriers = self.carriers(values)
        return PiecewisePolynomial.linear(self.grid.t, carriers.s, carriers.sd, carriers.sdd)

    def scaled(self, carriers: CarrierMotion) -> dict[str, Array]:
        """Return scaled s, ṡ and s̈ of a motion at the nodes."""
        return {name: getattr(carriers, name) / getattr(self.scales, name) for name in ("s", "sd", "sdd")}


def read_coefficients(
    task: Task, grid: Grid, around: CarrierMotion | None = None, *, exact: bool = False, turning: bool = False
) -> WholeTrajectoryProblem:
    """Read the coefficients at all nodes off the backend.

    ``task``: robot, motion and settings; ``around``: where f has other terms, the motion at the nodes around
    which f is fitted; ``exact``: take f as the backend's expressions have it, and sizes alone from the fit;
    ``turning``: read f as that of carriers some of which turn.
    """
    settings, motion = task.settings, task.source.sample_at(grid.t)
    along = task.dynamics.along(motion)
    read: Reader = turning_model if turning else carrier_model
    model = read(along) if around is None else second_order_fit(along, around)

    def reader(i: int) -> Reader:
        return read if around is None else partial(_first_order_fit, carriers=around[i : i + 1])

    singular = tuple(
        singular_node(
            task.dynamics,
            task.source,
            int(i),
            float(grid.t[i]),
            reader(int(i)),
            # of a jump, which has two nodes, the first one
            "left" if i < len(grid.h) and grid.h[i] == 0.0 else "right",
            dt=settings.mesh.dt,
            exact=exact,
        )
        for i in grid.singular
    )
    lam = settings.lam if "tracking" in {**settings.objective, **settings.at_most} else 0.0
    target, _ = target_effort(task.dynamics.robot, motion, lam, settings.baseline if lam else None)
    rate: Array = np.einsum("nim,ni->nm", model.W, motion.xd)
    scales = _scales(model, settings, along.reduce().row_scale, task.source.end - task.source.start, rate)
    base = None
    if set(BASE) & {*settings.objective, *settings.at_most}:
        if around is not None:
            raise UnsupportedRobotError(
                f"The base wrench of {task.dynamics.robot.name} is no sum over its carriers.",
                remedy="Balancing needs carriers that slide or turn, each on a link of its own.",
            )
        rest = load_at_rest(task.dynamics, motion, settings.start, settings.base_point)
        base = base_wrench(along, rest, settings.base_point, turning=turning)
        size = base.sizes(scales.sdd)
        scales = replace(scales, base=size, length=task.dynamics.robot.characteristic_length)
    symbols = along if exact and has_expressions(along) else None
    return WholeTrajectoryProblem(
        grid, model, singular, read_only(rate), read_only(target), settings, scales, symbols, base
    )


def _scales(
    model: CarrierModel, settings: WholeTrajectorySettings, row_scale: Array, duration: float, rate: Array
) -> WholeTrajectoryScales:
    """Return sizes from the limits, and from the parked robot where there are none."""
    (lower, upper), speed, acceleration = settings.limits.track.T, settings.limits.speed, settings.limits.acceleration
    s = np.where(np.isfinite(upper - lower), 0.5 * (upper - lower), 1.0)
    sd = np.where(np.isfinite(speed), speed, 10.0 * s / duration)
    sdd = np.where(np.isfinite(acceleration), acceleration, 10.0 * sd / duration)
    size = float(np.abs(model.f0 / row_scale).max())
    if size == 0.0:
        size = float(np.abs(model.f_terms[..., SDD] / row_scale[:, None] * sdd).max()) or 1.0
    largest = np.linalg.svd(model.W / row_scale[:, None], compute_uv=False)[:, 0]
    tau = size / float(np.median(largest))
    force = np.abs(model.force0).max(axis=0) + np.abs(model.force_terms[..., SDD]).max(axis=0) * sdd
    power = tau * (float(np.abs(rate).max()) or 1.0)
    return WholeTrajectoryScales(
        s, sd, sdd, tau, size * row_scale, np.where(force > 0.0, force, 1.0), power, duration, np.ones(6), 1.0
    )


def singular_node(
    dynamics: Dynamics,
    source: ContinuousMotion,
    index: int,
    t: float,
    read: Reader = carrier_model,
    side: Side = "right",
    *,
    dt: float = 0.005,
    exact: bool = False,
) -> SingularNode:
    """Read the derivatives of the model at a singular instant off the backend.

    ``t``: the instant, s; ``read``: what reads the model off; ``side``: from which the derivatives are taken; "left"
    for the node before a jump of the reference acceleration; ``dt``: largest step between nodes, s; ``exact``: as in
    ``read_coefficients``.
    """
    if read is carrier_model:
        model = TimedModel.of(dynamics, source, max(source.start, t - dt), min(source.end, t + dt))
        rate = replace(model, interpolant=model.interpolant.derivative()).at(np.array([t]), side)
    else:
        rate = _rate_of_model(dynamics, source, t, read, side)
    here = dynamics.along(source.sample_at(np.array([t])))
    reduced = here.reduce()
    u, values, v = np.linalg.svd(scaled(reduced.W, reduced.row_scale, reduced.column_scale)[0])
    size = float(values[0])
    if len(values) == 1:  # the only one vanishes: it is small beside what it is elsewhere
        usual = dynamics.along(source.sample_at(_spread(source))).reduce()
        size = float(np.linalg.norm(scaled(usual.W, usual.row_scale, usual.column_scale), axis=(1, 2)).max())
    kept = int((values > LOST * size).sum())
    turning = scaled(rate.W, reduced.row_scale, reduced.column_scale)[0]
    _require_crossing(u[:, kept:].T @ turning @ v[kept:].T / size, source, t)
    symbols = None
    if exact:
        edges, times = times_beside(source, t, side)
        unit = PiecewisePolynomial.from_values(edges, np.eye(len(times))[None])
        beside = dynamics.along(source.sample_at(times))
        if has_expressions(here) and has_expressions(beside):
            symbols = here, beside, unit.derivative().at(t)
    return SingularNode(index, read_only(u[:, kept:].T / reduced.row_scale), rate, symbols)


def _require_crossing(rate: Array, source: ContinuousMotion, t: float) -> None:
    """Check that the singular values that vanish do so at a rate; ``rate`` (r, r or more), 1/s, is that of W there."""
    slowest = float(np.linalg.svd(rate, compute_uv=False)[-1]) if rate.size else 0.0
    changed = slowest * (source.end - source.start)
    if changed > CROSSED:
        return
    speed, most = (float(np.abs(source.sample_at(at).xd).max()) for at in (np.array([t]), _spread(source)))
    how = "rests in" if speed <= CROSSED * most else "touches, or follows,"
    message = (
        f"At t = {t:.6g} s the motion {how} a type II singularity without crossing it: what f and its rate say there "
        "does not determine the efforts, and no condition on s, ṡ and s̈ keeps them finite beside it."
    )
    remedy = "Lead the motion across the singularity with a speed, or keep a distance from it."
    raise InfeasiblePlanError(
        message, remedy=remedy, constraint="singular_touch", time=t, amount=changed, at_rest=speed <= CROSSED * most
    )


def _spread(source: ContinuousMotion) -> Array:
    return np.linspace(source.start, source.end, 101)


STEP = 1e-4
"""Of the differences of the exact derivatives, m or rad, and per second: second derivatives to 1e-8 of themselves."""


def second_order_fit(along: DynamicsAlongMotion, carriers: CarrierMotion) -> CarrierModel:
    """Fit f to second order around a motion of the carriers, with exact derivatives and differences of them.

    f is affine in s̈ and, to second order, a sum over the carriers: seven terms. The force of a carrier is fitted to
    first order in its own motion; what the others do to it is taken as it is.

    ``along``: dynamics along a platform motion, N samples; ``carriers``: motion to fit around, N samples.
    """
    model = _first_order_fit(along, carriers)
    s, sd, sdd = carriers.s, carriers.sd, carriers.sdd

    def slope(ds: float, dsd: float) -> list[Array]:
        ahead, behind = (
            along.carrier_derivatives(CarrierMotion(s + sign * ds, sd + sign * dsd, sdd)) for sign in (1.0, -1.0)
        )
        return [(getattr(ahead, by) - getattr(behind, by)) / (2.0 * (ds + dsd)) for by in ("f_s", "f_sd", "f_sdd")]

    ss, ssd, ssdd = slope(STEP, 0.0)
    _, sdsd, _ = slope(0.0, STEP)
    # the quadratic form is expanded about zero: what it adds at the motion goes into the lower terms
    at = [part[:, None, :] for part in (s, sd, sdd)]
    f0 = model.f0 + (0.5 * ss * at[0] ** 2 + ssd * at[0] * at[1] + 0.5 * sdsd * at[1] ** 2 + ssdd * at[0] * at[2]).sum(
        2
    )
    by_term = list(np.moveaxis(model.f_terms, -1, 0))
    by_term[S] = by_term[S] - (ss * at[0] + ssd * at[1] + ssdd * at[2])
    by_term[SD] = by_term[SD] - (ssd * at[0] + sdsd * at[1])
    by_term[SDD] = by_term[SDD] - ssdd * at[0]
    by_term[S2], by_term[S_SD] = 0.5 * ss, ssd
    return replace(model, f0=read_only(f0), f_terms=read_only(np.stack([*by_term, 0.5 * sdsd, ssdd], axis=-1)))


def _first_order_fit(along: DynamicsAlongMotion, carriers: CarrierMotion) -> CarrierModel:
    """Fit f to first order around a motion of the carriers, or around one sample of it at all times."""
    carriers = CarrierMotion(
        *(np.resize(getattr(carriers, name), (len(along.motion), along.robot.k)) for name in ("s", "sd", "sdd"))
    )
    reduced, slopes = along.reduce(carriers), along.carrier_derivatives(carriers)
    zero = np.zeros_like(slopes.f_s)
    f_terms = np.stack([slopes.f_s, zero, slopes.f_sd, zero, slopes.f_sdd], axis=-1)
    own = [np.diagonal(part, axis1=1, axis2=2) for part in (slopes.force_s, slopes.force_sd, slopes.force_sdd)]
    nothing = np.zeros_like(own[0])
    force_terms = np.stack([own[0], nothing, own[1], nothing, own[2]], axis=-1)
    at = np.stack([carriers.s, nothing, carriers.sd, nothing, carriers.sdd], axis=-1)
    f0 = np.asarray(reduced.f) - np.einsum("nikj,nkj->ni", f_terms, at)
    force0 = np.asarray(reduced.carrier_force) - np.einsum("nkj,nkj->nk", force_terms, at)
    return CarrierModel(along.motion.t, reduced.W, *(read_only(part) for part in (f0, f_terms, force0, force_terms)))


APART = 2e-3
"""Distance of the times from which derivatives are formed, s, where the motion is smooth for so long."""

DEGREE = 5
"""Of the polynomials in time whose derivatives they are."""


def _rate_of_model(dynamics: Dynamics, source: ContinuousMotion, t: float, read: Reader, side: Side) -> CarrierModel:
    """Return derivatives by time of the coefficients that are read off at times around an instant."""
    edges, times = times_beside(source, t, side)
    model = read(dynamics.along(source.sample_at(times)))

    def rate(values: Array) -> Array:
        polynomial = PiecewisePolynomial.from_values(edges, values.reshape(1, len(times), -1))
        return read_only(polynomial.derivative().at(t).reshape(1, *values.shape[1:]))

    parts = (model.W, model.f0, model.f_terms, model.force0, model.force_terms)
    return CarrierModel(np.array([t]), *(rate(np.asarray(part)) for part in parts))


def times_beside(source: ContinuousMotion, t: float, side: Side) -> tuple[Array, Array]:
    """Return (2,) ends of a smooth stretch that holds an instant, s, and times in it for a polynomial."""
    kinks = source.kinks
    ahead = t == source.start or (side == "right" and t < source.end)
    # beyond a kink, or the end, the motion is another
    on_kink = bool((kinks == t).any())
    start = t if on_kink and ahead else max(t - APART, float(kinks[kinks < t].max()))
    end = t if on_kink and not ahead else min(t + APART, float(kinks[kinks > t].min()))
    edges = np.array([start, end])
    return edges, chebyshev_times(edges, DEGREE)
