"""Crossing type II singularities with the main actuators switched off (Parsa 2014, chapter 3)."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, positive, require_few
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError, UnsupportedRobotError
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.carrier_model import Actuation, Measure, TimedModel, require_carriers
from redundancy_pin.planners.carrier_return import return_polynomial, shortest_return
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import Findings, PlannedMotion
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.options import (
    NO_NODES,
    Limits,
    Mesh,
    group_of,
    refuse_fields,
    return_duration,
    takes_groups,
)
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.switch_off.crossing import Crossing, cross
from redundancy_pin.singularities.roots import Interval
from redundancy_pin.trajectory.continuous_motion import Motion, TimedTrajectory, as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at

SPACING = 1e-3
"""Default distance of the samples of a plan, s: a ramp of the thesis has 30."""

MOST_SAMPLES = 1_000_000
"""Largest number of samples of a plan; each takes kilobytes of memory while it is evaluated."""

PHASES = ("parked", "ramp_down", "off", "return")


@dataclass(frozen=True, eq=False)
class SwitchOffSettings:
    """Checked settings of the planner; see ``plan_switch_off``."""

    limits: ResolvedLimits
    threshold: float
    measure: Measure
    ramp_down: float
    return_time: float | Literal["shortest"]
    datum: Array
    dt: float

    @property
    def parameters(self) -> dict[str, object]:
        """The settings as plain data, for the plan, which has the limits apart."""
        own = {each.name: getattr(self, each.name) for each in fields(self)[1:]}
        return own | {"datum": self.datum.tolist()}


Returned = tuple[Crossing, PiecewisePolynomial]
"""A crossing, and the return of the carriers (k,) after it, m over time."""


@takes_groups(NO_NODES)
@np.errstate(under="ignore")  # numbers too small to matter become zero, whatever the caller has numpy do
def plan_switch_off(
    dynamics: DynamicsLike,
    motion: PlatformMotion | TimedTrajectory,
    *,
    limits: Limits | None = None,
    mesh: Mesh | None = None,
    threshold: float = 5.0,
    measure: Measure = "condition",
    ramp_down: float = 0.03,
    return_time: float | Literal["shortest"] = 0.4,
    datum: ArrayLike = 0.0,
) -> Plan:
    """Plan the carriers so that the main actuators can be off wherever W is nearly singular.

    The steps of Parsa 2014, section 3.1: where W is nearer to singular than a threshold the main efforts are zero;
    before, they follow a quintic to zero (eq. 3.4); all the while the carriers move so that f(s, ṡ, s̈) = W τ_ref (eqs
    3.5 and 3.6); after it they return to where they park by a polynomial of degree seven, and the efforts follow from
    W τ = f (eq. 3.7). Windows between which the carriers have no time to return are one window.

    The carriers' motion is integrated with error control (see ``carrier_equation``), so the efforts are continuous at
    switch-on. The thesis's backward differences of ṡ and s̈ make them jump there, in proportion to the step.

    Limits are evaluated, not enforced (a crossing leaves no freedom for that): see ``Plan.limits`` and ``Plan.status``.
    ``return_time="shortest"`` chooses the shortest return within the limits of the carriers.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend.
            The robot has at least as many carriers as coordinates.
        motion: a trajectory, evaluated exactly wherever needed, or samples, with quintics between them.
        limits: in place of the robot's own.
        mesh: ``dt``, spacing of the samples of the plan, s, ``SPACING`` when left out; events, jumps and extremes of
            the carriers' motion are added.
        threshold: the condition number of the scaled W above which, or its smallest singular value (no unit) below
            which, the actuators are off.
        measure: which of the two the threshold is.
        ramp_down: duration of the ramp before a window, s.
        return_time: duration of the return, s, or "shortest": the least that keeps every limit of the carriers.
        datum: scalar or (k,) where the carriers park, m.

    Raises:
        InputError: a setting out of its domain.
        UnsupportedRobotError: fewer carriers than coordinates, or carriers on curved tracks.
        InfeasiblePlanError: a window too early or too late in the motion, no room or no admissible return, or a
            force that nothing can carry at the singular pose; carries constraint, time and amount.
        UnreachablePoseError, SingularPoseError, WorkingModeError: as the dynamics.

    Example:
        >>> plan = rp.plan_switch_off("2rpr", rp.trajectory.reference.circle(speed=0.5), threshold=20.0)
        >>> plan.status.value, round(float(plan.peak_effort.max()), 1)
        ('ok', 23.2)
    """
    dynamics, mesh = as_dynamics(dynamics), group_of(mesh, Mesh)
    refuse_fields(NO_NODES, mesh)
    robot, source = dynamics.robot, as_motion(motion)
    if robot.k < robot.n:
        raise UnsupportedRobotError(
            f"{robot.name} has k = {robot.k} carriers for n = {robot.n} coordinates: they cannot take over from the "
            "main actuators.",
            remedy="Switching off needs k ≥ n.",
            carriers=robot.k,
            coordinates=robot.n,
        )
    require_carriers(robot)
    resolved = group_of(limits, Limits).resolved(robot)
    settings = SwitchOffSettings(
        limits=resolved,
        threshold=positive(threshold, "threshold", ""),
        measure=measure,
        ramp_down=positive(ramp_down, "ramp_down", "s"),
        return_time=return_duration(return_time, "return_time"),
        datum=resolved.on_track(datum, "datum"),
        dt=SPACING if mesh.dt is None else mesh.dt,
    )
    samples = (source.end - source.start) / settings.dt
    require_few(samples, MOST_SAMPLES, f"dt = {settings.dt:g} s makes {{}} samples", "Use a larger dt.", dt=settings.dt)
    actuation = Actuation.along(dynamics, source)
    windows = actuation.windows(measure, settings.threshold)
    crossings: list[Returned] = []
    while windows:
        window = windows.pop(0)
        _require_inside(window, source.start, source.end, settings.ramp_down)
        crossing = cross(dynamics, source, window, settings.ramp_down, settings.datum, actuation.row_scale)
        back = _return(dynamics, source, crossing, settings, windows)
        if back is None:  # no room before the next window: both are one
            windows[0] = Interval(window.start, windows[0].end, window.open_start, windows[0].open_end)
        else:
            crossings.append((crossing, back))
    return _assemble_plan(dynamics, source, crossings, settings, actuation)


def _return(
    dynamics: Dynamics, source: Motion, crossing: Crossing, settings: SwitchOffSettings, later: list[Interval]
) -> PiecewisePolynomial | None:
    """Return the carriers' return after a crossing; None if none ends before the next window."""
    state, end, duration = crossing.exit, source.end, settings.return_time
    until = min(end, later[0].start - settings.ramp_down) if later else end
    room = until - state.t
    if later and room <= 0.0:
        return None
    if duration == "shortest":
        model = TimedModel.of(dynamics, source, state.t, until)
        try:
            return shortest_return(
                settings.limits,
                lambda t, *motion: model.at(t).carrier_force(*motion),
                state,
                settings.datum,
                room,
                "Raise the threshold (a shorter window moves the carriers less), lengthen the tracks, or pass a "
                "return_time and accept a plan that violates limits.",
            )
        except InfeasiblePlanError:
            if later:
                return None
            raise
    if duration <= room:
        return return_polynomial(state, duration, settings.datum)
    if later:
        return None
    raise InfeasiblePlanError(
        f"The return of the carriers takes {duration:g} s from t = {state.t:.6g} s, but the motion ends at "
        f"{end:.6g} s: {duration - room:.4g} s are missing.",
        remedy="Shorten return_time, or end the motion further from the singularity.",
        constraint="return_time",
        time=state.t,
        amount=duration - room,
    )


def _require_inside(window: Interval, start: float, end: float, ramp_down: float) -> None:
    """Check that a window begins late enough for its ramp-down, and ends before the motion does."""
    missing = start + ramp_down - window.start
    if missing > 0.0:
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


def _assemble_plan(
    dynamics: Dynamics,
    source: Motion,
    crossings: list[Returned],
    settings: SwitchOffSettings,
    actuation: Actuation,
) -> Plan:
    """Sample the crossings and finish the plan."""
    times, position = _sample_times(source, crossings, settings), _position(source, crossings, settings)
    before, after = (carriers_at(position, times, side) for side in ("left", "right"))
    first_of_two = np.append(times[1:] == times[:-1], False)
    sdd = np.where(first_of_two[:, None], before.sdd, after.sdd)
    prescribed = np.full((len(times), dynamics.robot.m), np.nan)
    phase = np.zeros(len(times), dtype=np.intp)
    for crossing, back in crossings:
        phase[(times >= crossing.start) & (times < crossing.window.start)] = PHASES.index("ramp_down")
        phase[(times >= crossing.window.start) & (times <= crossing.end)] = PHASES.index("off")
        phase[(times > crossing.end) & (times <= back.end)] = PHASES.index("return")
        driven = (times >= crossing.start) & (times <= crossing.end)
        prescribed[driven] = crossing.ramp(times[driven])
    zero = np.zeros(dynamics.robot.m)
    off = [PiecewisePolynomial.constant(zero, crossing.window.start, crossing.end) for crossing, _ in crossings]
    singular = actuation.singular_instants
    planned = PlannedMotion(
        dynamics,
        PlanFunctions(source, position.remove_offsets(), tuple(off)),
        dynamics.along(source.sample_at(times)),
        CarrierMotion(after.s, after.sd, sdd, check_rates=False),
        settings.limits,
        "switch_off",
        prescribed=prescribed,
        phase=phase,
        phases=PHASES,
        parameters=settings.parameters,
        findings=Findings(singular_instants=singular),
        diagnostics={
            "windows": [_window(dynamics, source, *each, singular) for each in crossings],
            "worst_measure": actuation.worst(settings.measure),
        },
    )
    return finish_plan(planned)


def _position(source: Motion, crossings: list[Returned], settings: SwitchOffSettings) -> PiecewisePolynomial:
    """Return the positions of the carriers (k,) over time: parked, through a window, back, and so on."""
    parts: list[PiecewisePolynomial] = []
    free = source.start
    starts = [*(crossing.start for crossing, _ in crossings), source.end]
    for (crossing, back), following in zip(crossings, starts[1:], strict=True):
        if crossing.start > free:
            parts.append(PiecewisePolynomial.constant(settings.datum, free, crossing.start))
        parts += [crossing.position, back.between(back.start, min(back.end, following))]
        free = parts[-1].end
    if source.end > free:
        parts.append(PiecewisePolynomial.constant(settings.datum, free, source.end))
    return PiecewisePolynomial.joined(parts)


def _sample_times(source: Motion, crossings: list[Returned], settings: SwitchOffSettings) -> Array:
    """Return a uniform grid, with the events and peaks of the carriers' motion, and each jump twice."""
    steps = int(np.ceil((source.end - source.start) / settings.dt - 1e-9))
    uniform = np.append(source.start + settings.dt * np.arange(steps), source.end)
    events = [source.breaks]
    for crossing, back in crossings:
        events.append(np.array([crossing.start, crossing.window.start, crossing.end, min(back.end, source.end)]))
        events += [path.derivative(order).peaks() for path in (crossing.position, back) for order in range(3)]
    extra = np.unique(np.concatenate(events))
    # a sample that differs from an event by rounding only would make a step as short as rounding
    near = np.abs(uniform[:, None] - extra).min(axis=1, initial=np.inf) < 1e-9 * settings.dt
    near[[0, -1]] = False
    inner = extra[(extra > uniform[0]) & (extra < uniform[-1])]
    grid: Array = np.sort(np.concatenate([np.union1d(uniform[~near], inner), source.breaks]))
    return grid


def _window(
    dynamics: Dynamics, source: Motion, crossing: Crossing, back: PiecewisePolynomial, singular: tuple[float, ...]
) -> dict[str, object]:
    """Return times, efforts and carriers of a crossing, as plain data."""
    start, end, state = crossing.start, crossing.end, crossing.exit
    after = np.array([end])
    efforts = distribute(dynamics.along(source.sample_at(after)).reduce(carriers_at(back, after))).tau[0]
    return {
        "ramp_start": start,
        "entry": crossing.window.start,
        "exit": end,
        "return_end": back.end,
        "return_time": back.end - end,
        "effort_at_ramp_start": crossing.ramp(np.array([start]))[0].tolist(),
        "parked_effort_at_entry": crossing.parked_at_entry.tolist(),
        "exit_jump": np.abs(efforts).tolist(),
        "carriers_at_exit": {"s": state.s.tolist(), "sd": state.sd.tolist(), "sdd": state.sdd.tolist()},
        "singular_instants": [t for t in singular if start <= t <= end],
    }
