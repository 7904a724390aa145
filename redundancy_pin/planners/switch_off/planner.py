"""Crossing type II singularities with the main actuators switched off (Parsa 2014, chapter 3)."""

from __future__ import annotations

from typing import Literal

from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, positive
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InfeasiblePlanError, InputError, UnsupportedRobotError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.actuation import Actuation, Measure
from redundancy_pin.planners.carrier_model import TimedModel
from redundancy_pin.planners.carrier_return import no_return, return_polynomial, shortest_return
from redundancy_pin.planners.limits import Limits
from redundancy_pin.planners.plan import Plan, require_dynamics, require_motion
from redundancy_pin.planners.switch_off.assembly import Leg, Settings, assemble_plan
from redundancy_pin.planners.switch_off.backward_differences import cross_stepwise
from redundancy_pin.planners.switch_off.crossing import Crossing, cross
from redundancy_pin.singularities.roots import Interval
from redundancy_pin.trajectory.functions_of_time import ContinuousMotion, TimedTrajectory, continuous_motion

Scheme = Literal["integration", "backward_differences"]


def plan_switch_off(
    dynamics: Dynamics,
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
        dynamics: either backend of a robot with at least as many carriers as coordinates.
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
            force that nothing can carry at the singular pose; carries constraint, t and amount.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as the dynamics.
    """
    require_dynamics(dynamics)
    require_motion(motion, "duration", "breaks", "sample_at")
    settings = _settings(dynamics, threshold, measure, ramp_down, return_time, datum, dt, scheme)
    source = continuous_motion(motion)
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


def _settings(
    dynamics: Dynamics,
    threshold: float,
    measure: Measure,
    ramp_down: float,
    return_time: float | Literal["shortest"],
    datum: ArrayLike,
    dt: float,
    scheme: Scheme,
) -> Settings:
    robot = dynamics.robot
    if robot.k < robot.n:
        raise UnsupportedRobotError(
            f"{robot.name} has {robot.k} carrier(s) for {robot.n} coordinates: they cannot take over from the main "
            "actuators.",
            remedy=f"Switching off needs at least {robot.n} carriers.",
            carriers=robot.k,
            coordinates=robot.n,
        )
    if not isinstance(scheme, str) or scheme not in ("integration", "backward_differences"):
        raise InputError(
            f"scheme is {scheme!r}.", remedy="Pass 'integration' or 'backward_differences'.", scheme=scheme
        )
    if isinstance(return_time, str) and return_time != "shortest":
        raise InputError(f"return_time is {return_time!r}.", remedy="Pass a duration in seconds or 'shortest'.")
    return Settings(
        threshold=positive(threshold, "threshold", ""),
        measure=measure,
        ramp_down=positive(ramp_down, "ramp_down", "s"),
        return_time=return_time if isinstance(return_time, str) else positive(return_time, "return_time", "s"),
        datum=Limits().resolved(robot).on_track(datum, "datum"),
        dt=positive(dt, "dt", "s"),
        scheme=scheme,
    )


def _leg(
    dynamics: Dynamics,
    source: ContinuousMotion,
    window: Interval,
    settings: Settings,
    later: list[Interval],
    row_scale: Array,
) -> Leg | None:
    """Return the crossing of one window with its return, or None where the next window comes too soon for it."""
    crossing = _crossing(dynamics, source, window, settings, row_scale)
    state = crossing.exit
    available = source.end - state.t
    room = min(available, later[0].start - settings.ramp_down - state.t) if later else available
    if settings.return_time == "shortest":
        if room <= 0.0:
            return None
        model = TimedModel.of(dynamics, source, state.t, state.t + room)

        def force(t: Array, s: Array, sd: Array, sdd: Array) -> Array:
            return model.at(t).carrier_force(s, sd, sdd)

        duration, use = shortest_return(dynamics.robot, force, state, settings.datum, room)
        if duration is None:
            if later:
                return None
            remedy = "Raise the threshold (a shorter window moves the carriers less), lengthen the tracks, or pass a "
            raise no_return(use, state.t, room, remedy + "return_time and accept a plan that violates limits.")
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


def _crossing(
    dynamics: Dynamics, source: ContinuousMotion, window: Interval, settings: Settings, row_scale: Array
) -> Crossing:
    if settings.scheme == "backward_differences":
        return cross_stepwise(dynamics, source, window, settings.ramp_down, settings.datum, row_scale, settings.dt)
    return cross(dynamics, source, window, settings.ramp_down, settings.datum, row_scale)


def _require_inside(window: Interval, start: float, end: float, ramp_down: float) -> None:
    """Check that a window begins late enough for its ramp-down, and ends before the motion does.

    Raises:
        InfeasiblePlanError: it does not; carries the constraint, the time and the amount.
    """
    if window.open_start:
        raise InfeasiblePlanError(
            f"The motion begins at t = {start:.6g} s inside the region in which the actuators have to be off.",
            remedy="Start the motion further from the singularity, or move the threshold.",
            constraint="ramp_down",
            time=start,
            amount=ramp_down,
        )
    earliest = window.start - ramp_down
    if earliest < start:
        missing = start - earliest
        raise InfeasiblePlanError(
            f"The actuators have to be off from t = {window.start:.6g} s and need {ramp_down:g} s to ramp down, "
            f"but the motion begins at {start:.6g} s: {missing:.3g} s are missing.",
            remedy="Start the motion further from the singularity, shorten ramp_down, or move the threshold.",
            constraint="ramp_down",
            time=window.start,
            amount=missing,
        )
    if window.open_end:
        raise InfeasiblePlanError(
            f"The motion ends at t = {end:.6g} s inside the region in which the actuators have to be off.",
            remedy="End the motion further from the singularity, or move the threshold.",
            constraint="window_end",
            time=end,
            amount=end - window.start,
        )
