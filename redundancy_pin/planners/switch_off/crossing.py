"""The carriers through one window without main efforts, and whether they can carry what has to be carried there.

Where they cannot act in some direction, nothing may be left there. The motion is integrated with error control
(``carrier_equation``), or follows from the thesis's own discretisation: there ṡ and s̈ are backward differences of s on
a uniform grid, which makes f(s, ṡ, s̈) = W τ_ref k nonlinear equations for the k positions (Parsa 2014, eqs 3.5 and
3.6). They are solved exactly, so every sample is in balance; but the speed is that of half a step earlier and the
acceleration that of a whole step, an error of first order. The first sample after switch-on, on the return polynomial,
needs efforts in one step: a jump in proportion to the step. It is here to reproduce the thesis and to show where its
jumps come from.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, Frozen, frozen, read_only
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import CarrierModel, TimedModel, dense
from redundancy_pin.planners.carrier_return import CarrierState
from redundancy_pin.planners.switch_off.carrier_equation import CarrierEquation, StepGivenUpError, ramp_down
from redundancy_pin.singularities.roots import Interval, minima
from redundancy_pin.spectrum import null_directions, spectrum_of
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

RANK_LOSS = 1e-8
"""Smallest singular value of F, as a fraction of its largest, that counts as zero at a minimum found by search."""

BALANCED = 1e-7
"""Fraction of f that may be left along the direction in which the carriers cannot act: at such an instant, known to
1e-8 of the motion where it only touches the singularity, f is still off by a multiple of that."""


ACTUATED = 1e-6
"""Fraction of W along a direction below which the main actuators have no effect in it."""


@dataclass(frozen=True, eq=False)
class LostDirection(Frozen):
    """An instant at which the accelerations of the carriers have no effect in one direction.

    ``t``: time, s; ``direction`` (n,) unit vector u, scaled coordinates, with uᵀ F = 0; ``parked``: uᵀ(f − W τ_ref)
    with the carriers at rest at s = 0, N; ``by_motion``: largest coefficient of uᵀ f by s, s², ṡ or s ṡ of a carrier;
    where it is zero the carriers cannot change what is left, whatever they do; ``by_main``: whether the main actuators,
    were they on, would have an effect along u. They have on the 2-RPR, whose legs push where its carriers cannot; not
    where carriers and actuators act through the same joints.
    """

    t: float
    direction: Array
    parked: float
    by_motion: float
    by_main: bool

    def left(self, equation: CarrierEquation, s: Array, sd: Array) -> float:
        """Return uᵀ(f − W τ_ref), N, for carriers at s with speed ṡ, (k,) each."""
        model = equation.model.at(np.array([self.t]))
        load = np.einsum("nij,nj->ni", model.W, equation.effort(model.t))
        force = (model.f(s[None], sd[None], np.zeros((1, model.k))) - load) / equation.row_scale
        return float(force[0] @ self.direction)


def lost_directions(equation: CarrierEquation, start: float, end: float) -> list[LostDirection]:
    """Return the instants between two times at which F lacks rank."""
    model = equation.model
    times = dense(model.interpolant.edges)
    n = len(equation.row_scale)

    def forces(t: Array) -> Array:
        return model.at(t).f_terms[..., 4] / equation.row_scale[:, None]

    largest = float(spectrum_of(forces(times)).singular_values.max())

    def smallest(t: Array) -> Array:
        return spectrum_of(forces(t)).singular_values[:, n - 1] / largest

    if largest == 0.0 or np.median(smallest(times)) < RANK_LOSS:
        raise InfeasiblePlanError(
            f"From t = {start:.6g} s to {end:.6g} s there is a direction in which accelerating the carriers has no "
            "effect.",
            remedy="Their tracks have to be laid so that the carriers act in every coordinate (on the 2-RPR: away "
            "from the base hinge), or the motion must leave the singularity.",
            constraint="carrier_effect",
            time=start,
            amount=end - start,
        )
    lost = []
    for t, value in minima(smallest, times, RANK_LOSS):
        if value >= RANK_LOSS:
            continue
        u = null_directions(forces(np.array([t])))[0][0]
        here = model.at(np.array([t]))
        parked = (here.f0 - np.einsum("nij,nj->ni", here.W, equation.effort(here.t)))[0] / equation.row_scale
        by_motion = np.einsum("i,ikj->kj", u / equation.row_scale, here.f_terms[0, :, :, :4])
        W = here.W[0] / equation.row_scale[:, None]
        by_main = bool(np.abs(u @ W).max() > ACTUATED * np.abs(W).max())
        lost.append(LostDirection(t, frozen(u), float(u @ parked), float(np.abs(by_motion).max()), by_main))
    return lost


def require_balanced(equation: CarrierEquation, lost: Sequence[LostDirection]) -> None:
    """Check that where the carriers cannot act, and cannot change what is left, nothing is left."""
    for instant in lost:
        helpless = instant.by_motion <= BALANCED * equation.size
        if helpless and abs(instant.parked) > BALANCED * equation.size:
            raise nothing_carries(instant, instant.parked, "whatever the carriers do")


def nothing_carries(instant: LostDirection, force: float, circumstance: str) -> InfeasiblePlanError:
    """Return the error that says which force nothing can carry.

    ``instant``: where and in which direction; ``force``: uᵀ(f − W τ_ref), N; ``circumstance``: for which motion of the
    carriers.
    """
    direction = np.round(np.sign(force) * instant.direction, 12) + 0.0  # no negative zeros
    along = ", ".join(f"{component:.6f}" for component in direction)
    return InfeasiblePlanError(
        f"At the singular pose, t = {instant.t:.6g} s, nothing can carry the inertial force: the motion needs "
        f"{abs(force):.6g} N along ({along}), but the main actuators are off there and no acceleration of the carriers "
        f"has an effect in this direction ({circumstance}).",
        remedy="Pass the singularity without acceleration along this direction or without the masses that need it"
        + (", or leave the main actuators on: they could carry it." if instant.by_main else "."),
        constraint="singular_pose",
        time=instant.t,
        amount=abs(force),
        main_actuators_could=instant.by_main,
        direction=tuple(float(component) for component in direction),
    )


@dataclass(frozen=True, eq=False)
class SwitchOffCourse:
    """Carriers and efforts from the start of a ramp-down to the switch-on.

    ``window``: when the actuators are off; ``ramp``: the main efforts; ``parked_at_entry``
    (m,) what they would be when they are off with the carriers parked; ``position``: positions of the carriers (k,) as
    a function of time; ``lost``: instants at which the carriers cannot act in some direction; ``samples``: times (N,)
    and carriers there in backward differences, which the position lags behind; None where the rates are those of the
    position.
    """

    window: Interval
    ramp: PiecewisePolynomial
    parked_at_entry: Array
    position: PiecewisePolynomial
    lost: tuple[LostDirection, ...]
    samples: tuple[Array, CarrierMotion] | None = None

    @property
    def start(self) -> float:
        """Start of the ramp-down, s."""
        return self.position.start

    @property
    def end(self) -> float:
        """Switch-on, s."""
        return self.position.end

    @property
    def exit(self) -> CarrierState:
        """The carriers at switch-on."""
        motion = self.carriers(np.array([self.end]))
        return CarrierState(self.end, *(np.array(part[0]) for part in (motion.s, motion.sd, motion.sdd)))

    def carriers(self, times: Array) -> CarrierMotion:
        """Return the carriers at (N,) times, or at the nearest samples."""
        if self.samples is None:
            return carriers_at(self.position, times)
        t, motion = self.samples
        at = np.abs(np.asarray(times)[:, None] - t).argmin(axis=1)
        return CarrierMotion(motion.s[at], motion.sd[at], motion.sdd[at])


def cross(
    dynamics: Dynamics, motion: ContinuousMotion, window: Interval, ramp_time: float, datum: Array, row_scale: Array
) -> SwitchOffCourse:
    """Integrate the carriers through one window (steps 3 and 4 of Parsa 2014, section 3.1; eqs 3.5 and 3.6)."""
    equation, parked, lost = crossing_equation(dynamics, motion, window, window.start - ramp_time, datum, row_scale)
    start = equation.model.interpolant.start
    zero = np.zeros_like(datum)
    try:
        down = equation.solve(start, window.start, datum, zero)
        at_entry = carriers_at(down, [window.start])
        off = equation.solve(window.start, window.end, np.array(at_entry.s[0]), np.array(at_entry.sd[0]))
    except StepGivenUpError as stuck:
        raise _unbounded(equation, lost, stuck) from stuck
    return SwitchOffCourse(window, equation.effort, parked, PiecewisePolynomial.joined([down, off]), lost)


def crossing_equation(
    dynamics: Dynamics, motion: ContinuousMotion, window: Interval, start: float, datum: Array, row_scale: Array
) -> tuple[CarrierEquation, Array, tuple[LostDirection, ...]]:
    """Return what the carriers have to satisfy from the start of the ramp-down to switch-on, and where it fails.

    Between the two are the efforts (m,) at the start of the window with the carriers parked.
    """
    ramp, parked = ramp_down(dynamics, motion, start, window, datum)
    model = TimedModel.of(dynamics, motion, start, window.end)
    times = np.unique(np.concatenate([model.interpolant.edges, np.linspace(start, window.end, 201)]))
    here = model.at(times)
    load = np.einsum("nij,nj->ni", here.W, ramp(times))
    size = float(max(np.abs(here.f0 / row_scale).max(), np.abs(load / row_scale).max(), 1e-12))
    equation = CarrierEquation(model, ramp, row_scale, size)
    lost = tuple(lost_directions(equation, start, window.end))
    require_balanced(equation, lost)
    return equation, parked, lost


_RUNAWAY = 100.0
"""Distance, m, beyond which a carrier has left every machine."""


def _unbounded(
    equation: CarrierEquation, lost: tuple[LostDirection, ...], stuck: StepGivenUpError
) -> InfeasiblePlanError:
    near = [instant for instant in lost if instant.t >= stuck.t]
    farthest = int(np.argmax(np.abs(stuck.s)))
    if abs(stuck.s[farthest]) > _RUNAWAY:
        # what is left of the equation there is rounding of huge terms
        return InfeasiblePlanError(
            f"Carrier {farthest + 1} runs away with the main actuators off: at t = {stuck.t:.6g} s it would be at "
            f"{stuck.s[farthest]:.3g} m with {stuck.sd[farthest]:.3g} m/s.",
            remedy="Shorten the window (a threshold nearer to the singularity), or park the carriers elsewhere.",
            constraint="carrier_motion",
            time=stuck.t,
            amount=float(abs(stuck.s[farthest])),
        )
    if near:
        force = near[0].left(equation, stuck.s, stuck.sd)
        return nothing_carries(near[0], force, f"brought there at s = {np.round(stuck.s, 4).tolist()} m")
    message = (
        f"Past t = {stuck.t:.6g} s no bounded motion of the carriers balances the prescribed efforts: "
        f"{stuck.defect:.3g} N are left."
    )
    remedy = "Shorten the window (a threshold nearer to the singularity) or slow down."
    return InfeasiblePlanError(message, remedy=remedy, constraint="carrier_motion", time=stuck.t, amount=stuck.defect)


STEP_TOLERANCE = 1e-9
"""Largest imbalance at a sample, relative to the largest f along the crossing. A position rounded to 1e-17 m is an
acceleration of 1e-11 m/s² at a step of a millisecond."""

_MOST_ITERATIONS = 20


def cross_stepwise(
    dynamics: Dynamics,
    motion: ContinuousMotion,
    window: Interval,
    ramp_time: float,
    datum: Array,
    row_scale: Array,
    dt: float,
) -> SwitchOffCourse:
    """Solve the carriers through one window, sample by sample; the window is widened or narrowed to the grid.

    The actuators are off from the first to the last sample inside the window.
    """
    first = int(np.ceil((window.start - motion.start) / dt - 1e-9))
    last = max(int(np.floor((window.end - motion.start) / dt + 1e-9)), first)
    steps = min(max(1, round(ramp_time / dt)), first)
    t: Array = motion.start + dt * np.arange(first - steps, last + 1, dtype=np.float64)
    snapped = Interval(float(t[steps]), float(t[-1]), window.open_start, window.open_end)
    equation, parked, lost = crossing_equation(dynamics, motion, snapped, float(t[0]), datum, row_scale)
    model = equation.model.at(t)
    load = np.einsum("nij,nj->ni", model.W, equation.effort(t))
    s = np.tile(datum, (len(t) + 2, 1))  # two samples at rest before the first
    for i in range(len(t)):
        s[i + 2] = _position(equation, model[i : i + 1], load[i], s[i + 1], s[i], dt)
    sd = np.diff(s, axis=0) / dt
    carriers = CarrierMotion(s[2:], sd[1:], np.diff(sd, axis=0) / dt)
    # s̈ of a sample is that of the step which ends there; the first sample only starts one
    position = PiecewisePolynomial.constant_acceleration(t, s[2:], carriers.sd, carriers.sdd)
    return SwitchOffCourse(snapped, equation.effort, parked, position.made_continuous(), lost, (read_only(t), carriers))


def _position(
    equation: CarrierEquation, model: CarrierModel, load: Array, last: Array, before: Array, dt: float
) -> Array:
    """Solve f(s, (s − s₁)/dt, (s − 2 s₁ + s₂)/dt²) = W τ_ref for s (k,) by Newton's method; one sample of a model."""
    scale, s, left = equation.row_scale, 2.0 * last - before, np.inf
    for _ in range(_MOST_ITERATIONS):
        sd, sdd = (s - last) / dt, (s - 2.0 * last + before) / dt**2
        residual = (load - model.f(s[None], sd[None], sdd[None])[0]) / scale
        left = float(np.abs(residual).max())
        if left <= STEP_TOLERANCE * equation.size:
            return s
        by_s, by_sd, by_sdd = model.slopes(s[None], sd[None])
        slope = (by_s + by_sd / dt + by_sdd / dt**2)[0] / scale[:, None]
        s = s + np.linalg.lstsq(slope, residual, rcond=None)[0]
    t = float(model.t[0])
    message = f"At t = {t:.6g} s no position of the carriers balances the prescribed efforts: {left:.3g} N are left."
    remedy = "Use the integration scheme, or a shorter step."
    raise InfeasiblePlanError(message, remedy=remedy, constraint="carrier_motion", time=t, amount=left)
