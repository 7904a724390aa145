"""From crossings and returns to a plan: the grid of samples, the phases, and what is worth reporting."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.actuation import Actuation, Measure
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.plan import Plan, finish_plan
from redundancy_pin.planners.switch_off.crossing import Crossing
from redundancy_pin.trajectory.functions_of_time import ContinuousMotion, PiecewisePolynomial, carriers_at

PHASES = ("parked", "ramp_down", "off", "return")


@dataclass(frozen=True, eq=False)
class Settings:
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

    crossing: Crossing
    back: PiecewisePolynomial


def assemble_plan(
    dynamics: Dynamics, source: ContinuousMotion, legs: list[Leg], settings: Settings, actuation: Actuation
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
        dynamics.along(source.sample_at(times)),
        CarrierMotion(s, sd, sdd),
        planner="switch_off",
        phase=phase,
        phases=PHASES,
        parameters={**asdict(settings), "datum": settings.datum.tolist()},
        diagnostics={},
        prescribed=prescribed,
        functions=PlanFunctions(source, position.made_continuous(), none),
    )
    return replace(plan, diagnostics=_diagnostics(dynamics, plan, legs, actuation, settings))


def _position(source: ContinuousMotion, legs: list[Leg], settings: Settings) -> PiecewisePolynomial:
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


def _grid(source: ContinuousMotion, legs: list[Leg], settings: Settings) -> Array:
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
    dynamics: Dynamics, plan: Plan, legs: list[Leg], actuation: Actuation, settings: Settings
) -> dict[str, object]:
    efforts, positions = (
        {name: np.nanmax(np.abs(part[plan.phase == i]), axis=0, initial=0.0).tolist() for i, name in enumerate(PHASES)}
        for part in (plan.tau, plan.carriers.s)
    )
    singular = actuation.singular_instants()
    return {
        "windows": [_window(dynamics, plan.functions_of_time.platform, leg, singular, settings) for leg in legs],
        "no_window": not legs,
        "worst_measure": actuation.worst(settings.measure),
        "singular_instants": singular,
        "peak_effort": efforts,
        "peak_position": positions,
        "largest_imbalance": float(np.nanmax(plan.residual, initial=0.0)),
    }


def _window(
    dynamics: Dynamics, source: ContinuousMotion, leg: Leg, singular: list[float], settings: Settings
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
        "parked_effort_at_entry": crossing.ramp.parked_at_entry.tolist(),
        "exit_jump": np.abs(tau[1 if settings.scheme == "backward_differences" else 0]).tolist(),
        "effort_one_step_after_exit": np.abs(tau[1]).tolist(),
        "carriers_at_exit": {"s": state.s.tolist(), "sd": state.sd.tolist(), "sdd": state.sdd.tolist()},
        "singular_instants": [t for t in singular if start <= t <= end],
        "carriers_without_effect": [{"t": lost.t, "direction": lost.direction.tolist()} for lost in crossing.lost],
    }
