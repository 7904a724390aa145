"""The numbers of a nonlinear programme: the dynamics and limits at the nodes.

f is exactly a sum of terms over independent carriers that slide or turn (``carrier_model``): W, f and
the carrier forces are coefficients at each node. Where carriers carry one another, f is an expression of generated
code. The actuation matrix loses rank at a type II singularity, and the efforts there need the rates of these
coefficients as well. At a singular instant there are directions u with uᵀ W = 0. Then W τ = f requires uᵀ f = 0,
whatever τ is (compatibility), and leaves the part of τ in the null space of W open. Differentiating W τ = f in time and
projecting on u determines it, since uᵀ W τ̇ = 0:

    uᵀ Ẇ τ = uᵀ ḟ,    ḟ = ∂f/∂t + ∂f/∂s ṡ + ∂f/∂ṡ s̈ + ∂f/∂s̈ s⃛.

Where the motion crosses the singularity at a rate, (W; uᵀ Ẇ) has full rank, and both equations together give the one
τ that W⁻¹ f tends to. The jerk of the carriers enters: that it is the same on both sides makes the limits the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, read_only
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion, ExactAlongMotion, has_expressions
from redundancy_pin.dynamics.results import ReducedDynamics
from redundancy_pin.errors import InfeasiblePlanError, UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.base_wrench import BASE, BaseWrench, base_wrench, load_at_rest
from redundancy_pin.planners.carrier_model import (
    SDD,
    TERMS,
    CarrierModel,
    TimedModel,
    carrier_model,
    has_other_terms,
    target_effort,
    turns,
)
from redundancy_pin.planners.optimal.mesh import Grid, resample
from redundancy_pin.planners.optimal.nlp import Expression
from redundancy_pin.planners.optimal.objectives import Scales
from redundancy_pin.planners.optimal.settings import Settings
from redundancy_pin.planners.singular_instant import CROSSED, LOST
from redundancy_pin.spectrum import scaled
from redundancy_pin.trajectory import Side
from redundancy_pin.trajectory.continuous_motion import Motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, chebyshev_times

Reader = Callable[[DynamicsAlongMotion], CarrierModel]
"""Reads the coefficients off a backend along a platform motion."""

INSTANTS = 3
"""Number of instants of a motion at which f is tested for other terms: f has them nearly everywhere, or nowhere."""


@dataclass(frozen=True, eq=False)
class Task:
    """A planning task: the part of a problem that does not depend on the nodes."""

    dynamics: Dynamics
    source: Motion
    settings: Settings

    @property
    def slows_at_ends(self) -> bool:
        """Whether nodes are closer together towards both ends, where the timing is planned and begins at rest."""
        return False

    @cached_property
    def read(self) -> Reader:
        """What reads the coefficients off the backend."""
        return reader_of(self)

    def sized(
        self, grid: Grid, model: CarrierModel, parked: ReducedDynamics, rate: Array, before: Problem | None
    ) -> tuple[Scales, PathTiming | None]:
        """Return the sizes, reused from the same task on other nodes if given, and the timing of a path."""
        if before is not None:
            return before.scales, None
        return scales_of(model, self.settings, parked, self.source.end - self.source.start, rate), None


@dataclass(frozen=True, eq=False)
class SingularNode:
    """A node on a type II singularity; r directions are lost.

    ``index``: its number among the nodes; ``lost`` (r, n) rows u with u W = 0; ``rate``: time derivatives of the
    coefficients of W, f and the carrier forces, one sample; ``exact``: if f is an expression, not a polynomial:
    dynamics at the node and at times around it, and the weights of these values in a time derivative.
    """

    index: int
    lost: Array
    rate: CarrierModel
    exact: tuple[ExactAlongMotion, ExactAlongMotion, Array] | None = None


@dataclass(frozen=True, eq=False)
class PathTiming:
    """The data that a least-time problem adds: its nodes are places on a path, m, and their times are unknown.

    ``speed``, ``acceleration``: sizes of ṗ and p̈, m/s and m/s²; ``h`` (M − 1,) of the durations of the steps, s;
    ``fastest`` (M,) largest ṗ that limits of the actuators' rates allow, m/s; ``exceeded_parked``: kinds of limits
    ("effort", "carrier_force") of which the robot with parked carriers exceeds one at any speed, as under gravity.
    """

    speed: float
    acceleration: float
    h: Array
    fastest: Array
    exceeded_parked: tuple[str, ...]

    def powers(self, values: Mapping[str, Array]) -> Array:
        """Return (M, 4) 1, ṗ, ṗ² and p̈ of scaled variables."""
        return stacked_powers(values["pd"][:, 0] * self.speed, values["pdd"][:, 0] * self.acceleration)


def required(timing: PathTiming | None) -> PathTiming:
    """Return the timing of a problem that has one."""
    if timing is None:
        raise ValueError("The problem has its times given.")
    return timing


def powers_of(*pace: Expression) -> tuple[Expression, ...]:
    """Return the factors of the coefficients: 1, and ṗ, ṗ² and p̈ if ṗ and p̈ are unknown."""
    if not pace:
        return (1.0,)
    pd, pdd = pace
    return (1.0, pd, pd**2, pdd)


def stacked_powers(pd: Array, pdd: ArrayLike) -> Array:
    """Return (M, 4) 1, ṗ, ṗ² and p̈ of (M,) speeds and accelerations along a path."""
    return np.stack(np.broadcast_arrays(*powers_of(pd, pdd)), axis=-1)


@dataclass(frozen=True, eq=False)
class Problem:
    """The numbers of the programme; M nodes, n coordinates, m main actuators, k carriers.

    ``grid``: the nodes; ``model``: coefficients of W, f and the carrier forces at the nodes; ``singular``: the nodes on
    type II singularities; ``actuated_rate`` (M, m) rates of the main actuators; ``target`` (M, m) efforts that the
    objective "tracking" aims at; ``settings``: limits, ends and objective; ``scales``: sizes; ``exact``: where f has
    other terms, dynamics whose expressions for f and the carrier forces stand in place of the terms of ``model``;
    ``base``: the wrench on the base, where an objective is about it; ``shares`` (M, c): fractions of the limits of
    efforts, forces and limited rates that the nodes may use; all of them when left out; ``timing``: where the time is
    minimised. Then ``grid`` has places on the path in place of times, and the coefficients of f and of the forces have
    a last axis for 1, ṗ, ṗ² and p̈.
    """

    grid: Grid
    model: CarrierModel
    singular: tuple[SingularNode, ...]
    actuated_rate: Array
    target: Array
    settings: Settings
    scales: Scales
    exact: ExactAlongMotion | None = None
    base: BaseWrench | None = None
    shares: Array | None = None
    timing: PathTiming | None = None

    def times(self, values: Mapping[str, Array]) -> Array:
        """Return (M,) times of the nodes, s, of scaled variables."""
        if self.timing is None:
            return self.grid.t
        return np.append(0.0, np.cumsum(values["h"][:, 0] * self.timing.h))

    def carrier_force(self, values: Mapping[str, Array]) -> Array:
        """Return the carrier forces (M, k) at the nodes, N, of scaled variables."""
        carriers, model = self.carriers(values), self.model
        if self.exact is not None:
            return np.asarray(self.exact.reduce(carriers).carrier_force)
        if self.timing is not None:
            model = at_pace(model, self.timing.powers(values))
        return model.carrier_force(carriers.s, carriers.sd, carriers.sdd)

    def carriers(self, values: Mapping[str, Array]) -> CarrierMotion:
        """Return the motion at the nodes, in units, of scaled s, ṡ and s̈; omitted ones are zero."""
        u, zero = self.scales, np.zeros((len(self.grid.t), self.model.k))
        motion = (values.get(name, zero) * getattr(u, name) for name in ("s", "sd", "sdd"))
        return CarrierMotion(*motion, check_rates=self.timing is None)

    def position(self, values: Mapping[str, Array]) -> PiecewisePolynomial:
        """Return the positions, m, as a function of time, of scaled s, ṡ and s̈: s̈ is linear in a step."""
        carriers = self.carriers(values)
        return PiecewisePolynomial.linear(self.times(values), carriers.s, carriers.sd, carriers.sdd)

    def tau(self, values: Mapping[str, Array]) -> Array:
        """Return (M, m) the main efforts, N or N·m, of scaled ones."""
        return values["tau"] * self.scales.tau

    def scaled(self, carriers: CarrierMotion) -> dict[str, Array]:
        """Return scaled s, ṡ and s̈ of a motion at the nodes."""
        return {name: getattr(carriers, name) / getattr(self.scales, name) for name in ("s", "sd", "sdd")}

    def resampled(self, values: Mapping[str, Array], finer: Problem) -> dict[str, Array]:
        """Return scaled variables on the nodes of a refined problem, linear between the nodes of this one."""
        moved = resample({**values, "t": self.times(values)[:, None]}, self.grid.t, finer.grid.t)
        t = moved.pop("t")
        return moved if finer.timing is None else {**moved, "h": np.diff(t, axis=0) / finer.timing.h[:, None]}


def at_pace(model: CarrierModel, powers: Array) -> CarrierModel:
    """Return the coefficients at (M, 4) 1, ṗ, ṗ² and p̈ of a model along a path."""
    names = ("f0", "f_terms", "force0", "force_terms")
    parts = {name: np.einsum("n...q,nq->n...", getattr(model, name), powers) for name in names}
    return replace(model, **parts)


def linear_model(along: DynamicsAlongMotion) -> CarrierModel:
    """Return f and carrier forces about parked carriers: sizes, where f itself is an expression of the backend.

    Raises:
        UnsupportedRobotError: the backend has no expressions.
    """
    robot = along.robot
    if not has_expressions(along):
        raise UnsupportedRobotError(
            f"f of {robot.name} is no sum over its carriers, as where a carrier carries another.",
            remedy="Pass the robot or CompiledDynamics(robot): generated code has f as an expression.",
        )
    parked = along.reduce()
    slopes = along.carrier_derivatives(CarrierMotion.parked(len(along.motion), robot.k))
    f_terms = np.zeros((*slopes.f_sdd.shape, TERMS))
    force_terms = np.zeros((*parked.carrier_force.shape, TERMS))
    f_terms[..., SDD] = slopes.f_sdd
    force_terms[..., SDD] = np.diagonal(slopes.force_sdd, axis1=1, axis2=2)
    return CarrierModel(along.motion.t, parked.W, parked.f, f_terms, parked.carrier_force, force_terms)


def reader_of(task: Task) -> Reader:
    """Return the function that reads the coefficients of a task off its backend.

    Carriers that slide, and those that turn, have terms of their own. Where f has others at some instants of the
    motion, as with carriers on carriers, it is the backend's expression.
    """
    robot, few = task.dynamics.robot, np.linspace(task.source.start, task.source.end, INSTANTS)
    if robot.k and has_other_terms(task.dynamics.along(task.source.sample_at(few))):
        return linear_model
    if turns(robot):
        return partial(carrier_model, turning=True)
    return carrier_model if robot.k else partial(carrier_model, check=False)


def read_problem(task: Task, grid: Grid, before: Problem | None = None) -> Problem:
    """Read the coefficients at all nodes off the backend; ``before``: the same task on other nodes."""
    settings, motion = task.settings, task.source.sample_at(grid.t)
    along, used = task.dynamics.along(motion), {*settings.objective, *settings.at_most}
    model, singular = task.read(along), singular_nodes(task, grid)
    lam = settings.lam if "tracking" in used else 0.0
    target = target_effort(task.dynamics.robot, motion, lam, settings.baseline if lam else None)
    rate: Array = np.einsum("nim,ni->nm", model.W, motion.xd)
    sizes, timing = task.sized(grid, model, along.reduce(), rate, before)
    base = None
    if set(BASE) & used:
        if task.read is linear_model:
            raise UnsupportedRobotError(
                f"The base wrench of {task.dynamics.robot.name} is no sum over its carriers.",
                remedy="Balancing needs carriers that slide or turn, each on a link of its own.",
            )
        rest = load_at_rest(task.dynamics, motion, settings.start, settings.base_point)
        base = base_wrench(along, rest, settings.base_point, turning=turns(task.dynamics.robot))
        if before is None:
            sizes = replace(sizes, base=base.sizes(sizes.sdd), length=task.dynamics.robot.characteristic_length)
    exact = along if task.read is linear_model and has_expressions(along) else None
    return Problem(
        grid, model, singular, read_only(rate), read_only(target), settings, sizes, exact, base, timing=timing
    )


def scales_of(model: CarrierModel, settings: Settings, parked: ReducedDynamics, duration: float, rate: Array) -> Scales:
    """Return sizes from the limits, and from the parked robot without limits."""
    row_scale, columns = parked.row_scale, parked.column_scale
    (lower, upper), speed, acceleration = settings.limits.track.T, settings.limits.speed, settings.limits.acceleration
    s = np.where(np.isfinite(upper - lower), 0.5 * (upper - lower), 1.0)
    sd = np.where(np.isfinite(speed), speed, 10.0 * s / duration)
    sdd = np.where(np.isfinite(acceleration), acceleration, 10.0 * sd / duration)
    size = float(np.abs(model.f0 / row_scale).max())
    if size == 0.0 and not len(s):
        raise UnsupportedRobotError(
            "No effort is needed along the motion: the robot moves no mass.", remedy="Give its bodies masses."
        )
    if size == 0.0:
        size = float(np.abs(model.f_terms[..., SDD] / row_scale[:, None] * sdd).max()) or 1.0
    rows = model.W / row_scale[:, None]
    tau, unit = (
        size / float(np.median(np.linalg.svd(part, compute_uv=False)[:, 0])) for part in (rows, rows * columns)
    )
    force = np.abs(model.force0).max(axis=0) + np.abs(model.force_terms[..., SDD]).max(axis=0) * sdd
    power = tau * (float(np.abs(rate).max()) or 1.0)
    force = np.where(force > 0.0, force, 1.0)
    return Scales(s, sd, sdd, tau, unit * columns, size * row_scale, force, power, duration, np.ones(6), 1.0)


def singular_nodes(task: Task, grid: Grid) -> tuple[SingularNode, ...]:
    """Read the derivatives of the model at all singular nodes off the backend."""
    return tuple(_singular_node(task, grid, i) for i in grid.singular.tolist())


def _singular_node(task: Task, grid: Grid, index: int) -> SingularNode:
    dynamics, source, dt, t = task.dynamics, task.source, task.settings.dt, float(grid.t[index])
    # of a jump, which has two nodes, the first one has its derivatives from the left
    side: Side = "left" if index < len(grid.h) and grid.h[index] == 0.0 else "right"
    if task.read is carrier_model:
        model = TimedModel.of(dynamics, source, max(source.start, t - dt), min(source.end, t + dt))
        rate = replace(model, interpolant=model.interpolant.derivative()).at(np.array([t]), side)
    else:
        rate = _rate_of_model(task, t, side)
    here = dynamics.along(source.sample_at(np.array([t])))
    reduced = here.reduce()
    u, values, v = np.linalg.svd(scaled(reduced.W, reduced.row_scale, reduced.column_scale)[0])
    size = float(values[0])
    if len(values) == 1:  # the only one vanishes: compare it with its values elsewhere
        usual = dynamics.along(source.sample_at(_spread(source))).reduce()
        size = float(np.linalg.norm(scaled(usual.W, usual.row_scale, usual.column_scale), axis=(1, 2)).max())
    kept = int((values > LOST * size).sum())
    turning = scaled(rate.W, reduced.row_scale, reduced.column_scale)[0]
    _require_crossing(u[:, kept:].T @ turning @ v[kept:].T / size, source, t)
    symbols = None
    if task.read is linear_model:
        edges, times = times_beside(source, t, side)
        unit = PiecewisePolynomial.from_values(edges, np.eye(len(times))[None])
        beside = dynamics.along(source.sample_at(times))
        if has_expressions(here) and has_expressions(beside):
            symbols = here, beside, unit.derivative().at(t)
    return SingularNode(index, read_only(u[:, kept:].T / reduced.row_scale), rate, symbols)


def _require_crossing(rate: Array, source: Motion, t: float) -> None:
    """Check that vanishing singular values have a nonzero rate; ``rate`` (r, r or more), 1/s: rate of W there."""
    slowest = float(np.linalg.svd(rate, compute_uv=False)[-1]) if rate.size else 0.0
    changed = slowest * (source.end - source.start)
    if changed > CROSSED:
        return
    speed, most = (float(np.abs(source.sample_at(at).xd).max()) for at in (np.array([t]), _spread(source)))
    how = "rests in" if speed <= CROSSED * most else "touches, or follows,"
    message = (
        f"At t = {t:.6g} s the motion {how} a type II singularity without crossing it: f and its rate there do "
        "not determine the efforts, and no condition on s, ṡ and s̈ keeps them finite near it."
    )
    remedy = "Lead the motion across the singularity with a speed, or keep a distance from it."
    raise InfeasiblePlanError(
        message, remedy=remedy, constraint="singular_touch", time=t, amount=changed, at_rest=speed <= CROSSED * most
    )


def _spread(source: Motion) -> Array:
    return np.linspace(source.start, source.end, 101)


RATE_SPAN = 1e-3
"""Distance of the times from which derivatives are formed, as a fraction of the motion, where it is smooth for so long:
a motion that changes within a twentieth of its time leaves 1e-9."""

RATE_DEGREE = 5
"""Of the polynomials in time whose derivatives they are."""


def _rate_of_model(task: Task, t: float, side: Side) -> CarrierModel:
    """Return derivatives by time of the coefficients that are read off at times around an instant."""
    edges, times = times_beside(task.source, t, side)
    model = task.read(task.dynamics.along(task.source.sample_at(times)))

    def rate(values: Array) -> Array:
        polynomial = PiecewisePolynomial.from_values(edges, values.reshape(1, len(times), -1))
        return read_only(polynomial.derivative().at(t).reshape(1, *values.shape[1:]))

    parts = (model.W, model.f0, model.f_terms, model.force0, model.force_terms)
    return CarrierModel(np.array([t]), *(rate(np.asarray(part)) for part in parts))


def times_beside(source: Motion, t: float, side: Side) -> tuple[Array, Array]:
    """Return (2,) ends of a smooth stretch that holds an instant, s, and times in it for a polynomial."""
    kinks, span = source.kinks, RATE_SPAN * (source.end - source.start)
    ahead = t == source.start or (side == "right" and t < source.end)
    # beyond a kink, or the end, the motion is another
    on_kink = bool((kinks == t).any())
    start = t if on_kink and ahead else max(t - span, float(kinks[kinks < t].max()))
    end = t if on_kink and not ahead else min(t + span, float(kinks[kinks > t].min()))
    edges = np.array([start, end])
    return edges, chebyshev_times(edges, RATE_DEGREE)
