"""Crossing type II singularities with the main actuators switched off (Parsa 2014, chapter 3)."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, one_of, positive, require_few
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError, UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.carrier_model import Actuation, Measure, TimedModel, require_carriers
from redundancy_pin.planners.carrier_return import no_return, return_polynomial, shortest_return
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import PlannedMotion
from redundancy_pin.planners.limits import Limits, require_motion, return_duration
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.switch_off.crossing import SwitchOffCourse, cross, cross_stepwise
from redundancy_pin.singularities.roots import Interval
from redundancy_pin.trajectory.continuous_motion import ContinuousMotion, TimedTrajectory, continuous_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

MOST_SAMPLES = 1_000_000  # of a plan: each takes kilobytes on its course through the dynamics

PHASES = ("parked", "ramp_down", "off", "return")


@dataclass(frozen=True, eq=False)
class SwitchOffSettings:
    """Checked settings of the planner; see ``plan_switch_off``."""

    threshold: float
    measure: Measure
    ramp_down: float
    return_time: float | Literal["shortest"]
    datum: Array
    dt: float
    scheme: str


@dataclass(frozen=True, eq=False)
class Leg:
    """A crossing and the return of the carriers after it."""

    crossing: SwitchOffCourse
    back: PiecewisePolynomial


def assemble_plan(
    dynamics: Dynamics, source: ContinuousMotion, legs: list[Leg], settings: SwitchOffSettings, actuation: Actuation
) -> Plan:
    """Sample the crossings and returns, let the backend judge them, and report."""
    times = _grid(source, legs, settings)
    position = _position(source, legs, settings)
    before, after = (carriers_at(position, times, side) for side in ("left", "right"))
    s, sd, sdd = (np.array(part) for part in (after.s, after.sd, after.sdd))
    first_of_two = np.flatnonzero(times[1:] == times[:-1])
    sdd[first_of_two] = before.sdd[first_of_two]
    prescribed = np.full((len(times), dynamics.robot.m), np.nan)
    phase = np.zeros(len(times), dtype=np.intp)
    for leg in legs:
        ramp, off, back = leg.crossing.start, leg.crossing.window.start, leg.crossing.end
        driven = (times >= ramp) & (times <= back)
        if leg.crossing.samples is not None:  # backward differences, not the derivatives of the position
            at = leg.crossing.carriers(times[driven])
            s[driven], sd[driven], sdd[driven] = at.s, at.sd, at.sdd
        phase[(times >= ramp) & (times < off)] = 1
        phase[(times >= off) & (times <= back)] = 2
        phase[(times > back) & (times <= leg.back.end)] = 3
        prescribed[driven] = leg.crossing.ramp(times[driven])
    # only inside the windows: on a ramp W⁻¹ f of the carriers' motion is what was prescribed, but for backward
    # differences, where it is what keeps the platform on its path between the samples
    off_windows = [(leg.crossing.window.start, leg.crossing.end) for leg in legs]
    none = tuple(PiecewisePolynomial.constant(np.zeros(dynamics.robot.m), *window) for window in off_windows)
    plan = finish_plan(
        PlannedMotion(
            dynamics,
            PlanFunctions(source, position.made_continuous(), none),
            dynamics.along(source.sample_at(times)),
            CarrierMotion(s, sd, sdd, check_rates=False),
            Limits().resolved(dynamics.robot),
            "switch_off",
            prescribed=prescribed,
            phase=phase,
            phases=PHASES,
            parameters={**asdict(settings), "datum": settings.datum.tolist()},
        )
    )
    return replace(plan, diagnostics={**plan.diagnostics, **_diagnostics(dynamics, plan, legs, actuation, settings)})


def _position(source: ContinuousMotion, legs: list[Leg], settings: SwitchOffSettings) -> PiecewisePolynomial:
    """Return the positions of the carriers: parked, through a window, back, and so on."""
    parts: list[PiecewisePolynomial] = []
    free = source.start
    starts = [*(leg.crossing.start for leg in legs), source.end]
    for leg, following in zip(legs, starts[1:], strict=True):
        if leg.crossing.start > free:
            parts.append(PiecewisePolynomial.constant(settings.datum, free, leg.crossing.start))
        parts += [leg.crossing.position, leg.back.until(min(leg.back.end, following))]
        free = parts[-1].end
    if source.end > free:
        parts.append(PiecewisePolynomial.constant(settings.datum, free, source.end))
    return PiecewisePolynomial.joined(parts)


def _grid(source: ContinuousMotion, legs: list[Leg], settings: SwitchOffSettings) -> Array:
    """Return a uniform grid with events and peaks of the carriers' motion, and each jump twice."""
    steps = int(np.ceil((source.end - source.start) / settings.dt - 1e-9))
    uniform = np.append(source.start + settings.dt * np.arange(steps), source.end)
    extra: list[ArrayLike] = [source.breaks]
    for leg in legs:
        crossing = leg.crossing
        extra += [[crossing.start, crossing.window.start, crossing.end, min(leg.back.end, source.end)]]
        moved = [leg.back] if crossing.samples is not None else [crossing.position, leg.back]
        extra += [position.derivative(order).peaks() for position in moved for order in range(3)]
    events = np.unique(np.concatenate([np.asarray(part, dtype=float) for part in extra]))
    # a sample that differs from an event by rounding only would make a step as short as rounding
    near = np.abs(uniform[:, None] - events[None, :]).min(axis=1, initial=np.inf) < 1e-9 * settings.dt
    near[[0, -1]] = False
    inner = events[(events > uniform[0]) & (events < uniform[-1])]
    grid: Array = np.sort(np.concatenate([np.union1d(uniform[~near], inner), source.breaks]))
    if settings.scheme == "backward_differences":  # has no motion between its own samples
        for leg in legs:
            crossing = leg.crossing
            own = np.isin(grid, crossing.samples[0]) if crossing.samples else np.ones(len(grid), dtype=bool)
            grid = np.unique(grid[own | (grid < crossing.start) | (grid > crossing.end)])
    return grid


def _diagnostics(
    dynamics: Dynamics, plan: Plan, legs: list[Leg], actuation: Actuation, settings: SwitchOffSettings
) -> dict[str, object]:
    efforts, positions = (
        {name: np.nanmax(np.abs(part[plan.phase == i]), axis=0, initial=0.0).tolist() for i, name in enumerate(PHASES)}
        for part in (plan.tau, plan.carriers.s)
    )
    singular = list(actuation.singular_instants)
    return {
        "windows": [_window(dynamics, plan.functions.platform, leg, singular, settings) for leg in legs],
        "no_window": not legs,
        "worst_measure": actuation.worst(settings.measure),
        "singular_instants": singular,
        "peak_effort": efforts,
        "peak_position": positions,
        "largest_imbalance": float(np.nanmax(plan.residual, initial=0.0)),
    }


def _window(
    dynamics: Dynamics, source: ContinuousMotion, leg: Leg, singular: list[float], settings: SwitchOffSettings
) -> dict[str, object]:
    crossing = leg.crossing
    start, end = crossing.start, crossing.end
    state = crossing.exit
    after = np.array([end, min(end + settings.dt, leg.back.end)])
    along = dynamics.along(source.sample_at(after))
    tau = distribute(along.reduce(carriers_at(leg.back, after))).tau
    return {
        "ramp_start": start,
        "entry": crossing.window.start,
        "exit": end,
        "return_end": leg.back.end,
        "return_time": leg.back.end - end,
        "effort_at_ramp_start": crossing.ramp(np.array([start]))[0].tolist(),
        "parked_effort_at_entry": crossing.parked_at_entry.tolist(),
        "exit_jump": np.abs(tau[1 if settings.scheme == "backward_differences" else 0]).tolist(),
        "effort_one_step_after_exit": np.abs(tau[1]).tolist(),
        "carriers_at_exit": {"s": state.s.tolist(), "sd": state.sd.tolist(), "sdd": state.sdd.tolist()},
        "singular_instants": [t for t in singular if start <= t <= end],
        "carriers_without_effect": [{"t": lost.t, "direction": lost.direction.tolist()} for lost in crossing.lost],
    }


Scheme = Literal["integration", "backward_differences"]


@np.errstate(under="ignore")  # numbers too small to matter become zero, whatever the caller has numpy do
def plan_switch_off(
    dynamics: DynamicsLike,
    motion: PlatformMotion | TimedTrajectory,
    *,
    threshold: float = 5.0,
    measure: Measure = "condition",
    ramp_down: float = 0.03,
    return_time: float | Literal["shortest"] = 0.4,
    datum: ArrayLike = 0.0,
    dt: float = 1e-3,
    scheme: Scheme = "integration",
) -> Plan:
    """Plan the carriers so that the main actuators can be off wherever W is nearly singular.

    The steps of Parsa 2014, section 3.1: where W is nearer to singular than a threshold the main efforts are zero;
    before, they follow a quintic to zero (eq. 3.4); all the while the carriers move so that f(s, ṡ, s̈) = W τ_ref (eqs
    3.5 and 3.6); after it they return to where they park by a polynomial of degree seven, and the efforts follow from
    W τ = f (eq. 3.7). Windows between which the carriers have no time to return are one window.

    The carriers' motion is integrated with error control (see ``carrier_equation``), so the efforts are continuous at
    switch-on. ``scheme="backward_differences"`` is the thesis's discretisation on the grid of step ``dt`` instead,
    whose efforts jump there.

    Limits of the carriers are not enforced (a crossing leaves no freedom to do so) but judged, at all extremes of their
    motion (forces at the samples): see ``Plan.limits`` and ``Plan.status``. ``return_time="shortest"`` chooses the
    return within them.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend.
            The robot has at least as many carriers as coordinates.
        motion: a trajectory, evaluated exactly wherever needed, or samples, with quintics between them.
        threshold: the condition number of the scaled W above which, or its smallest singular value (no unit) below
            which, the actuators are off.
        measure: which of the two the threshold is.
        ramp_down: duration of the ramp before a window, s.
        return_time: duration of the return, s, or "shortest": the least that keeps every limit of the carriers.
        datum: scalar or (k,) where the carriers park, m.
        dt: spacing of the samples of the plan, s; events, jumps and extremes of the carriers' motion are added.
        scheme: how the carriers' motion is found.

    Raises:
        InputError: a setting out of its domain.
        UnsupportedRobotError: fewer carriers than coordinates, or carriers on curved tracks.
        InfeasiblePlanError: a window too early or too late in the motion, no room or no admissible return, or a
            force that nothing can carry at the singular pose; carries constraint, time and amount.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as the dynamics.
    """
    dynamics = as_dynamics(dynamics)
    require_motion(motion, "duration", "breaks", "sample_at")
    robot = dynamics.robot
    if robot.k < robot.n:
        raise UnsupportedRobotError(
            f"{robot.name} has {robot.k} carrier(s) for {robot.n} coordinates: they cannot take over from the main "
            "actuators.",
            remedy=f"Switching off needs at least {robot.n} carriers.",
            carriers=robot.k,
            coordinates=robot.n,
        )
    require_carriers(robot)
    one_of(scheme, "scheme", get_args(Scheme))
    settings = SwitchOffSettings(
        threshold=positive(threshold, "threshold", ""),
        measure=measure,
        ramp_down=positive(ramp_down, "ramp_down", "s"),
        return_time=return_duration(return_time, "return_time"),
        datum=Limits().resolved(robot).on_track(datum, "datum"),
        dt=positive(dt, "dt", "s"),
        scheme=scheme,
    )
    source = continuous_motion(motion)
    samples = (source.end - source.start) / settings.dt
    require_few(samples, MOST_SAMPLES, f"dt = {settings.dt:g} s makes {{}} samples", "Use a larger dt.", dt=settings.dt)
    actuation = Actuation.along(dynamics, source)
    windows = actuation.windows(measure, settings.threshold)
    legs: list[Leg] = []
    while windows:
        window = windows.pop(0)
        _require_inside(window, source.start, source.end, settings.ramp_down)
        leg = _leg(dynamics, source, window, settings, windows, actuation.row_scale)
        if leg is None:  # no room before the next window: both are one
            windows[0] = Interval(window.start, windows[0].end, window.open_start, windows[0].open_end)
            continue
        legs.append(leg)
    return assemble_plan(dynamics, source, legs, settings, actuation)


def _leg(
    dynamics: Dynamics,
    source: ContinuousMotion,
    window: Interval,
    settings: SwitchOffSettings,
    later: list[Interval],
    row_scale: Array,
) -> Leg | None:
    """Return the crossing of one window with its return, or None where the next window comes too soon for it."""
    task = (dynamics, source, window, settings.ramp_down, settings.datum, row_scale)
    by_differences = settings.scheme == "backward_differences"
    crossing = cross_stepwise(*task, settings.dt) if by_differences else cross(*task)
    state = crossing.exit
    available = source.end - state.t
    room = min(available, later[0].start - settings.ramp_down - state.t) if later else available
    if settings.return_time == "shortest":
        if room <= 0.0:
            return None
        model = TimedModel.of(dynamics, source, state.t, state.t + room)

        def force(t: Array, s: Array, sd: Array, sdd: Array) -> Array:
            return model.at(t).carrier_force(s, sd, sdd)

        duration, _, nearest = shortest_return(dynamics.robot, force, state, settings.datum, room)
        if duration is None:
            if later:
                return None
            remedy = "Raise the threshold (a shorter window moves the carriers less), lengthen the tracks, or pass a "
            raise no_return(nearest, state.t, room, remedy + "return_time and accept a plan that violates limits.")
    else:
        duration = float(settings.return_time)
    if duration > room:
        if later:
            return None
        raise InfeasiblePlanError(
            f"The return of the carriers takes {duration:g} s from t = {state.t:.6g} s, but the motion ends at "
            f"{source.end:.6g} s: {duration - room:.4g} s are missing.",
            remedy="Shorten return_time, or end the motion further from the singularity.",
            constraint="return_time",
            time=state.t,
            amount=duration - room,
        )
    return Leg(crossing, return_polynomial(state, duration, settings.datum))


def _require_inside(window: Interval, start: float, end: float, ramp_down: float) -> None:
    """Check that a window begins late enough for its ramp-down, and ends before the motion does."""
    if window.open_start:
        message = f"The motion begins at t = {start:.6g} s inside the region in which the actuators have to be off."
        remedy = "Start the motion further from the singularity, or move the threshold."
        raise InfeasiblePlanError(message, remedy=remedy, constraint="ramp_down", time=start, amount=ramp_down)
    earliest = window.start - ramp_down
    if earliest < start:
        missing = start - earliest
        message = (
            f"The actuators have to be off from t = {window.start:.6g} s and need {ramp_down:g} s to ramp down, "
            f"but the motion begins at {start:.6g} s: {missing:.3g} s are missing."
        )
        remedy = "Start the motion further from the singularity, shorten ramp_down, or move the threshold."
        raise InfeasiblePlanError(message, remedy=remedy, constraint="ramp_down", time=window.start, amount=missing)
    if window.open_end:
        message = f"The motion ends at t = {end:.6g} s inside the region in which the actuators have to be off."
        remedy = "End the motion further from the singularity, or move the threshold."
        raise InfeasiblePlanError(message, remedy=remedy, constraint="window_end", time=end, amount=end - window.start)
