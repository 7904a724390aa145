"""From crossings and returns to a plan: the grid of samples, the phases, and what is worth reporting."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.dynamics.base import Dynamics, DynamicsAlongMotion
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
    left = np.append(times[1:] == times[:-1], False)
    s = np.tile(settings.datum, (len(times), 1))
    sd, sdd = np.zeros_like(s), np.zeros_like(s)
    prescribed = np.full((len(times), dynamics.robot.m), np.nan)
    phase = np.zeros(len(times), dtype=np.intp)
    for leg in legs:
        ramp, off, back = leg.crossing.start, leg.crossing.window.start, leg.crossing.end
        for carriers_of, there in (
            (leg.crossing.carriers, (times >= ramp) & (times <= back)),
            (partial(carriers_at, leg.back), (times > back) & (times <= leg.back.end)),
        ):
            for side, chosen in (("left", there & left), ("right", there & ~left)):
                at = carriers_of(times[chosen], side)  # type: ignore[arg-type]
                s[chosen], sd[chosen], sdd[chosen] = at.s, at.sd, at.sdd
        phase[(times >= ramp) & (times < off)] = 1
        phase[(times >= off) & (times <= back)] = 2
        phase[(times > back) & (times <= leg.back.end)] = 3
        driven = (times >= ramp) & (times <= back)
        prescribed[driven] = leg.crossing.ramp(times[driven])
    along = dynamics.along(source.sample_at(times))
    carriers = CarrierMotion(s, sd, sdd)
    return finish_plan(
        along,
        carriers,
        planner="switch_off",
        phase=phase,
        phases=PHASES,
        parameters={
            "threshold": settings.threshold,
            "measure": settings.measure,
            "ramp_down": settings.ramp_down,
            "return_time": settings.return_time,
            "datum": settings.datum.tolist(),
            "dt": settings.dt,
            "scheme": settings.scheme,
        },
        diagnostics=_diagnostics(dynamics, source, along, carriers, prescribed, phase, legs, actuation, settings),
        prescribed=prescribed,
        functions=_functions(source, legs, settings),
    )


def _functions(source: ContinuousMotion, legs: list[Leg], settings: Settings) -> PlanFunctions:
    """Return the carriers from window to window, and no main efforts inside the windows."""
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
    # only inside the windows: on a ramp W⁻¹ f of the carriers' motion is what was prescribed, but for backward
    # differences, where it is what keeps the platform on its path between the samples
    off = [leg.crossing.ramp.polynomial.control[-1] for leg in legs]
    windows = [(leg.crossing.window.start, leg.crossing.end) for leg in legs]
    none = [PiecewisePolynomial.constant(tau, *window) for tau, window in zip(off, windows, strict=True)]
    return PlanFunctions(source, PiecewisePolynomial.joined(parts).made_continuous(), tuple(none))


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
    dynamics: Dynamics,
    source: ContinuousMotion,
    along: DynamicsAlongMotion,
    carriers: CarrierMotion,
    prescribed: Array,
    phase: IntArray,
    legs: list[Leg],
    actuation: Actuation,
    settings: Settings,
) -> dict[str, object]:
    reduced = along.reduce(carriers)
    tau = np.where(np.isfinite(prescribed), prescribed, distribute(reduced).tau)
    balance = (np.einsum("nij,nj->ni", reduced.W, tau) - reduced.f) / reduced.row_scale
    imbalance = np.linalg.norm(balance, axis=1)
    efforts, positions = (
        {name: np.nanmax(np.abs(part[phase == i]), axis=0, initial=0.0).tolist() for i, name in enumerate(PHASES)}
        for part in (tau, carriers.s)
    )
    singular = actuation.singular_instants()
    return {
        "windows": [_window(dynamics, source, leg, singular, settings) for leg in legs],
        "no_window": not legs,
        "worst_measure": actuation.worst(settings.measure),
        "singular_instants": singular,
        "peak_effort": efforts,
        "peak_position": positions,
        "largest_imbalance": float(np.nanmax(imbalance, initial=0.0)),
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
