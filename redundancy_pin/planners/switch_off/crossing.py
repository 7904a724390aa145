"""The carriers through one window without main efforts, and why there may be no such motion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import TimedModel, dense, smooth_edges
from redundancy_pin.planners.carrier_return import CarrierState
from redundancy_pin.planners.switch_off.carrier_equation import CarrierEquation, StepGivenUpError
from redundancy_pin.singularities.roots import Interval, minima
from redundancy_pin.spectrum import null_directions, spectrum_of
from redundancy_pin.trajectory import boundary_polynomial
from redundancy_pin.trajectory.continuous_motion import Motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at


@dataclass(frozen=True, eq=False)
class Crossing:
    """Carriers and main efforts from the start of a ramp-down until the actuators are switched on.

    Attributes:
        window: when the actuators are off, s.
        ramp: main efforts (m,) over time, N or N·m.
        parked_at_entry: (m,) efforts at the start of the window with the carriers parked, N or N·m.
        position: positions of the carriers (k,) over time, m.
    """

    window: Interval
    ramp: PiecewisePolynomial
    parked_at_entry: Array
    position: PiecewisePolynomial

    @property
    def start(self) -> float:
        """Start of the ramp-down, s."""
        return self.position.start

    @property
    def end(self) -> float:
        """Time at which the actuators are switched on, s."""
        return self.position.end

    @property
    def exit(self) -> CarrierState:
        """The carriers at that time."""
        motion = carriers_at(self.position, [self.end])
        return CarrierState(self.end, *(np.array(part[0]) for part in (motion.s, motion.sd, motion.sdd)))


def cross(
    dynamics: Dynamics, motion: Motion, window: Interval, ramp_time: float, datum: Array, row_scale: Array
) -> Crossing:
    """Integrate the carriers through one window (steps 3 and 4 of Parsa 2014, section 3.1; eqs 3.5 and 3.6).

    Args:
        dynamics: a backend.
        motion: the platform's motion.
        window: when the actuators are off, s.
        ramp_time: duration of the ramp-down before it, s.
        datum: (k,) where the carriers park before, m.
        row_scale: (n,) scales of the forces.

    Raises:
        InfeasiblePlanError: the carriers cannot balance the motion; carries constraint, time and amount.
    """
    start = window.start - ramp_time
    ramp, parked = ramp_down(dynamics, motion, start, window, datum)
    model = TimedModel.of(dynamics, motion, start, window.end)
    times = np.unique(np.concatenate([model.interpolant.edges, np.linspace(start, window.end, 201)]))
    here = model.at(times)
    forces = np.concatenate([here.f0, np.einsum("nij,nj->ni", here.W, ramp(times))]) / row_scale
    equation = CarrierEquation(model, ramp, row_scale, max(float(np.abs(forces).max()), 1e-12))
    try:
        down = equation.solve(start, window.start, datum, np.zeros_like(datum))
        entry = carriers_at(down, [window.start])
        off = equation.solve(window.start, window.end, np.array(entry.s[0]), np.array(entry.sd[0]))
    except StepGivenUpError as stuck:
        raise _infeasible(equation, stuck) from stuck
    return Crossing(window, ramp, parked, PiecewisePolynomial.joined([down, off]))


_TOLERANCE = 1e-11
"""Of the interpolated parked efforts, relative to the largest: their second derivatives are known to 1e-6."""


def ramp_down(
    dynamics: Dynamics, motion: Motion, start: float, window: Interval, datum: Array
) -> tuple[PiecewisePolynomial, Array]:
    """Return the main efforts (m,) until the end of a window, N or N·m, and the parked efforts at its start.

    Before the window they are a quintic to zero (Parsa 2014, eq. 3.4). It begins with the efforts of parked carriers,
    their rate and its rate, taken from an interpolant around ``start``.
    """
    end = window.start

    def parked(times: Array) -> Array:
        along = dynamics.along(motion.sample_at(times))
        tau = distribute(along.reduce(CarrierMotion.parked(len(times), dynamics.robot.k, datum))).tau
        return np.asarray(tau)

    around = max(2.0 * start - end, motion.start), min(0.5 * (start + end), motion.end)
    interpolant = PiecewisePolynomial.fit(
        parked,
        smooth_edges(motion, *around),
        motion.knots,
        lambda values: np.full(values.shape[1], max(np.abs(values).max(), np.finfo(float).tiny)),
        _TOLERANCE,
    )
    rates = [interpolant.derivative(order)(np.array([start]))[0] for order in (1, 2)]
    at_start, at_end = parked(np.array([start, end]))
    zero = np.zeros(dynamics.robot.m)
    quintic = boundary_polynomial(start, end, [at_start, *rates], [zero, zero, zero])
    return PiecewisePolynomial.joined([quintic, PiecewisePolynomial.constant(zero, end, window.end)]), at_end


# --- causes of infeasibility ----------------------------------------------------------------------------------------

_RANK_LOSS = 1e-8
"""Smallest singular value of F that counts as zero at a minimum found by search, relative to its largest."""

_NEGLIGIBLE = 1e-7
"""Force, relative to the largest f, that the carriers do not have: an instant of rank loss is known to 1e-8."""

_ACTUATED = 1e-6
"""Fraction of W along a direction below which the main actuators have no effect in it."""

_RUNAWAY = 100.0
"""Distance, m, beyond which a carrier has left every machine."""


def _infeasible(equation: CarrierEquation, stuck: StepGivenUpError) -> InfeasiblePlanError:
    """Return why the carriers cannot be integrated beyond a time."""
    farthest = int(np.argmax(np.abs(stuck.s)))
    if abs(stuck.s[farthest]) > _RUNAWAY:  # the defect is rounding of huge terms
        return InfeasiblePlanError(
            f"Carrier {farthest + 1} runs away with the main actuators off: at t = {stuck.t:.6g} s it would be at "
            f"{stuck.s[farthest]:.3g} m with {stuck.sd[farthest]:.3g} m/s.",
            remedy="Shorten the window (a threshold nearer to the singularity), or park the carriers elsewhere.",
            constraint="carrier_motion",
            time=stuck.t,
            amount=float(abs(stuck.s[farthest])),
        )
    instants = _rank_losses(equation)
    if instants is None:
        path = equation.model.interpolant
        return InfeasiblePlanError(
            f"From t = {path.start:.6g} s to {path.end:.6g} s there is a direction in which accelerating the carriers "
            "has no effect.",
            remedy="Lay their tracks so that the carriers act in every coordinate (on the 2-RPR: away from the base "
            "hinge), or lead the motion away from the singularity.",
            constraint="carrier_effect",
            time=path.start,
            amount=path.end - path.start,
        )
    later = [t for t in instants if t >= stuck.t]
    if later:
        return _uncompensated_force(equation, later[0], stuck)
    return InfeasiblePlanError(
        f"Beyond t = {stuck.t:.6g} s no bounded motion of the carriers balances the prescribed efforts: the residual "
        f"is {stuck.defect:.3g} N.",
        remedy="Shorten the window (a threshold nearer to the singularity) or slow down.",
        constraint="carrier_motion",
        time=stuck.t,
        amount=stuck.defect,
    )


def _rank_losses(equation: CarrierEquation) -> list[float] | None:
    """Return the instants at which F loses rank, s; None if it lacks rank most of the time."""
    times, n = dense(equation.model.interpolant.edges), len(equation.row_scale)

    def values(t: Array) -> Array:
        return spectrum_of(equation.model.at(t).f_terms[..., -1] / equation.row_scale[:, None]).singular_values

    largest = float(values(times).max())
    if largest == 0.0 or np.median(values(times)[:, n - 1]) < _RANK_LOSS * largest:
        return None
    found = minima(lambda t: values(t)[:, n - 1] / largest, times, _RANK_LOSS)
    return [t for t, value in found if value < _RANK_LOSS]


def _uncompensated_force(equation: CarrierEquation, t: float, stuck: StepGivenUpError) -> InfeasiblePlanError:
    """Return the error that names the force which remains where F loses rank, at a time.

    It is uᵀ(f − W τ_ref) along the direction u with uᵀ F = 0. On the 2-RPR the main actuators act along u, not where
    they and the carriers act through the same joints. F may lose rank away from the type II singularity, and during the
    ramp-down.
    """
    model, scale = equation.model.at(np.array([t])), equation.row_scale
    u = null_directions(model.f_terms[..., -1] / scale[:, None])[0][0]
    f = model.f(stuck.s[None], stuck.sd[None], np.zeros((1, model.k)))[0]
    effort = equation.effort(model.t)[0]
    force = float(u @ ((f - model.W[0] @ effort) / scale))
    W, by_motion = model.W[0] / scale[:, None], np.einsum("i,ikj->kj", u / scale, model.f_terms[0, ..., :-1])
    by_main = bool(np.abs(u @ W).max() > _ACTUATED * np.abs(W).max())
    helpless = np.abs(by_motion).max() <= _NEGLIGIBLE * equation.size
    where = "whatever the carriers do" if helpless else f"brought there at s = {np.round(stuck.s, 4).tolist()} m"
    singular_values = spectrum_of(W[None]).singular_values[0]
    singular = bool(singular_values[-1] <= _ACTUATED * singular_values[0])
    place = "At the singular pose," if singular else "At"
    phase = "ramping down" if effort.any() else "off"
    remedy = (
        "Pass the singularity without acceleration along this direction or without the masses that need it"
        if singular
        else "Keep this instant out of the crossing: a threshold nearer to the singularity, or a shorter ramp_down"
    )
    direction = np.round(np.sign(force) * u, 12) + 0.0  # no negative zeros
    return InfeasiblePlanError(
        f"{place} t = {t:.6g} s nothing can carry the inertial force: the motion needs {abs(force):.6g} N along "
        f"({', '.join(f'{component:.6f}' for component in direction)}), but the main actuators are {phase} there and "
        f"no acceleration of the carriers has an effect in this direction ({where}).",
        remedy=remedy
        + (
            ", or leave the main actuators on (plan_whole_trajectory): they could carry it."
            if by_main
            else ", or plan with plan_whole_trajectory, which chooses where the carriers are at the pose."
        ),
        constraint="singular_pose" if singular else "carrier_effect",
        time=t,
        amount=abs(force),
        main_actuators_could=by_main,
        direction=tuple(float(component) for component in direction),
    )
