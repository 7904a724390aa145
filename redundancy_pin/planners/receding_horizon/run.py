"""A whole motion planned as if on line: one plan per control update; the carriers follow the first piece of each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, Frozen, positive
from redundancy_pin.dynamics.distribution import distribute
from redundancy_pin.errors import InfeasiblePlanError, InputError, rounded_down
from redundancy_pin.io.summary import Summary, TextTable, number, row
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.carrier_model import Actuation
from redundancy_pin.planners.check import finish_plan
from redundancy_pin.planners.functions import PlanFunctions, unique_times
from redundancy_pin.planners.intersample_check import Findings, PlannedMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.receding_horizon.command import Command
from redundancy_pin.planners.receding_horizon.constants import LONGEST, SAMPLES, STANDING, STRAIGHT, STRAIGHT_PIECES
from redundancy_pin.planners.receding_horizon.planner import RecedingHorizon
from redundancy_pin.planners.receding_horizon.preview import place_of
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory.continuous_motion import Motion, TimedTrajectory, as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, carriers_at
from redundancy_pin.trajectory.time_scaling import ScaledMotion, TimeScaling

NOT_PLANNED = UpdateStatus.RELAXED, UpdateStatus.FALLBACK
"""Updates that found no plan within every limit."""

LONGEST_STEP, LONGEST_HORIZON = 0.5, 50.0
"""Longest step and horizon, as multiples of the duration of the motion: beyond them they are in another unit."""


@dataclass(frozen=True, eq=False)
class OnLineRun(Frozen):
    """What came of a whole motion.

    Attributes:
        plan: what the carriers did and which efforts that takes, judged as any other plan.
        commands: one per control update.
    """

    plan: Plan
    commands: tuple[Command, ...]

    def summary(self) -> Summary:
        """Return ``Plan.summary`` plus the updates by status and the time that an update took, ms.

        Example:
            >>> print(run_online(RecedingHorizon("2rpr"), circle).summary())
        """
        plan, facts = self.plan, self.plan.summary()
        seconds = [command.seconds for command in self.commands]
        times = dict(zip(("p50", "p99"), 1e3 * np.percentile(seconds, [50.0, 99.0]), strict=True))
        found: Any = plan.diagnostics
        rows = [
            ("status", plan.status.value.replace("_", " ")),
            ("ticks", ", ".join(f"{count} {status}" for status, count in self.counts.items() if count)),
            ("time of a tick, p50 and p99 [ms]", row(times.values())),
            ("later at the end [s]", number(found["delay"])),
            ("singular instants [s]", row(plan.findings.singular_instants) or "none"),
            ("force missing there [N]", number(found["missing_force"])),
            (f"peak main effort [{plan.robot.effort_units[0]}]", row(plan.peak_effort)),
        ]
        table = TextTable(f"{plan.robot.name}, on line", rows)
        return Summary({**facts, "ticks": self.counts, "milliseconds": times}, table, warnings=facts.warnings)

    def __repr__(self) -> str:
        """Return the plan and the ticks by status."""
        counts = ", ".join(f"{count} {status}" for status, count in self.counts.items() if count)
        return f"OnLineRun({self.plan!r}; ticks: {counts})"

    @property
    def counts(self) -> dict[str, int]:
        """Ticks by status."""
        counts = Counter(command.status for command in self.commands)
        return {status.value: counts[status] for status in UpdateStatus}


def run_online(
    planner: RecedingHorizon,
    motion: PlatformMotion | TimedTrajectory,
    *,
    tick: float | None = None,
    start: ArrayLike = 0.0,
) -> OnLineRun:
    """Plan along a motion, one control update after another, each plan with a preview of one horizon.

    Args:
        planner: the planner, before its first update.
        motion: the whole motion.
        tick: between plans, s, at most a horizon; a step when left out.
        start: scalar or (k,) where the carriers are at the start, m.

    Returns:
        Its plan has efforts that are linear in time where W is next to singular, and W⁻¹ f elsewhere; ``diagnostics``
        have the missing part of f there (``missing_force``, N), the results of the updates and their durations.

        A planner that slows down follows the path of the motion; ``delay`` is by how much later it ends, s.

    Raises:
        InputError: a step or a horizon that is too long for the motion.
        InfeasiblePlanError: a start off the track; a refused control update, or a motion that no speed makes feasible;
            carries how far the motion is possible.

    Example:
        >>> from redundancy_pin.planners.receding_horizon import run_online
        >>> run = run_online(rp.RecedingHorizon("2rpr"), rp.trajectory.reference.line(speed=0.2))
        >>> run.counts["relaxed"]
        0
    """
    tick = planner.step if tick is None else positive(tick, "tick", "s")
    if tick > planner.horizon:
        raise InputError(
            f"A tick of {tick:g} s is longer than the horizon of {planner.horizon:g} s.", remedy="Have shorter ticks."
        )
    if planner.started:
        raise InputError("The planner has plans of another run.", remedy="Pass a new RecedingHorizon.")
    source, at = as_motion(motion), planner.resolved.on_track(start, "start")
    _require_times(planner, source.end - source.start)
    commands: list[Command] = []
    pieces, edges = [], [source.start]
    t, end = source.start, source.end
    while t < end - 1e-9:
        commands.append(planner.update(t, motion, *(() if commands else (at, 0.0))))
        _require_progress(commands[-1], source, planner)
        scaling = commands[-1].scaling
        if scaling is not None:
            end = scaling.time_at(source.end)
        until = min(source.start + len(commands) * tick, end)
        if until > end - 1e-9:
            until = end
        pieces.append(commands[-1].carriers.between(t, until))
        edges.append(until)
        t = until
    times, motion_end, position = np.array(edges), source.end, PiecewisePolynomial.joined(pieces)
    carriers, source = position.remove_offsets(), _followed(source, commands, edges)
    nodes = unique_times(
        np.concatenate([np.arange(source.start, source.end, SAMPLES), times, source.breaks, source.knots])
    )
    decided = pieces_of(planner, source, carriers, commands)
    for part, _ in decided:  # parts narrower than a sample are evaluated on the continuous motion
        short = part.end - part.start < SAMPLES
        nodes = nodes[~((nodes > part.start) & (nodes < part.end) & short)]
    functions = PlanFunctions(source, carriers, prescribed=tuple(part for part, _ in decided))
    prescribed = np.full((len(nodes), planner.robot.m), np.nan)
    for part, _ in decided:
        inside = (nodes >= part.start) & (nodes <= part.end)
        prescribed[inside] = part(nodes[inside])
    counts = Counter(command.status.value for command in commands)
    plan = finish_plan(
        PlannedMotion(
            planner.dynamics,
            functions,
            planner.dynamics.along(source.sample_at(nodes)),
            functions.carriers_at(nodes),
            planner.resolved,
            "receding_horizon",
            prescribed=prescribed,
            phases=("on line",),
            parameters={
                "horizon": planner.horizon,
                "step": planner.step,
                "tick": tick,
                "slow_down": planner.slows_down,
            },
            findings=Findings(singular_instants=tuple(singular_instants_met(commands).tolist())),
            diagnostics={
                "ticks": {status.value: counts[status.value] for status in UpdateStatus},
                "reasons": sorted({command.reason for command in commands if command.status in NOT_PLANNED}),
                "missing_force": max((missing for _, missing in decided), default=0.0),
                "seconds": [command.seconds for command in commands],
                "delay": source.end - motion_end,
            },
        )
    )
    return OnLineRun(plan, tuple(commands))


def _require_times(planner: RecedingHorizon, duration: float) -> None:
    """Check that step and horizon are of the size of a motion that takes a duration, s: milliseconds are not."""
    for name, most in (("step", LONGEST_STEP * duration), ("horizon", LONGEST_HORIZON * duration)):
        if (value := getattr(planner, name)) > most:
            raise InputError(
                f"{name} is {value:g} s, and the whole motion takes {duration:.4g} s.",
                remedy=f"Pass at most {rounded_down(most)} s (seconds, not milliseconds).",
                name=name,
            )


def _require_progress(command: Command, source: Motion, planner: RecedingHorizon) -> None:
    """Check that a run continues.

    Raises:
        InfeasiblePlanError: its control update was refused, or the platform is at rest and remains so.
    """
    t, scaling, longest = command.t, command.scaling, LONGEST * (source.end - source.start)
    if command.status is UpdateStatus.REFUSED:
        raise InfeasiblePlanError(
            f"The planner refuses to go on at t = {t:.6g} s: {command.reason}.",
            remedy="Lead the platform along another path.",
            constraint="preview",
            time=command.known_until if scaling is None else float(scaling.at([command.known_until])[0][0]),
        )
    if scaling is None:
        return
    stands = scaling.final_rate == 0.0 and t > scaling.settled + STANDING * planner.horizon
    if stands or t > source.start + longest:
        reached = float(scaling.at([t])[0][0])
        ahead = source.sample_at(np.linspace(reached, min(reached + planner.horizon, source.end), 101))
        beyond = ~planner.dynamics.along(ahead, unreachable="mark").reduce().reachable
        if stands and beyond.any():
            first = int(beyond.argmax())
            where = place_of(np.asarray(ahead.x[first]))
            raise InfeasiblePlanError(
                f"The platform stands at t = {t:.6g} s, where the motion is at {reached:.6g} s: at "
                f"{ahead.t[first]:.6g} s it leads where the machine cannot go, to {where}.",
                remedy="Lead the platform along another path.",
                constraint="preview",
                time=reached,
            )
        raise InfeasiblePlanError(
            f"The platform {'stands' if stands else 'hardly moves'} at t = {t:.6g} s, where the motion is at "
            f"{reached:.6g} s: {'no plan from there keeps every limit' if stands else 'it would take too long'}.",
            remedy="Lead the platform along another path, or loosen the limits.",
            constraint="preview",
            time=reached,
        )


def _followed(source: Motion, commands: list[Command], edges: list[float]) -> Motion:
    """Return the motion of the platform, which each command led from one edge to the next, s."""
    if commands[-1].scaling is None:
        return source
    starts = [0, *(i for i in range(1, len(commands)) if commands[i].scaling is not commands[i - 1].scaling)]
    parts = []
    for i, after in zip(starts, [*starts[1:], None], strict=True):
        own = (commands[i].scaling or TimeScaling.none(edges[0])).curve
        parts.append(own.between(edges[i], own.end if after is None else edges[after]))
    return as_motion(ScaledMotion(source, TimeScaling(PiecewisePolynomial.joined(parts))))


def singular_instants_met(commands: Sequence[Command]) -> Array:
    """Return the singular instants (r,), s, of commands in order of time: each as the last one before it has it.

    Where the platform slows down they come later than it was thought.
    """
    followed = [command.t for command in commands[1:]] + [np.inf]
    met = [c.singular[c.singular <= until] for c, until in zip(commands, followed, strict=True)]
    return np.unique(np.concatenate(met))


def pieces_of(
    planner: RecedingHorizon, source: Motion, carriers: PiecewisePolynomial, commands: list[Command]
) -> list[tuple[PiecewisePolynomial, float]]:
    """Return the efforts near singular instants, where W⁻¹ f magnifies the residual, and the missing force there, N.

    In the direction that W loses they are linear in time, with the planned value at the instant; otherwise W τ = f.
    """
    dynamics, parts = planner.dynamics, []
    if planner.robot.n != planner.robot.m:
        return []
    for window in Actuation.along(dynamics, source).windows("condition", 1.0 / STRAIGHT):
        ends = np.array([window.start, window.end])
        reduced = dynamics.along(source.sample_at(ends)).reduce(carriers_at(carriers, ends))
        tau = np.array(distribute(reduced).tau)
        latest = [max((c for c in commands if c.t <= t), key=lambda c: c.t, default=commands[0]) for t in ends]
        planned = np.array([command.efforts.at(t) for command, t in zip(latest, ends, strict=True)])
        inner = (ends > source.start) & (ends < source.end) & np.isfinite(tau).all(axis=1)
        tau = np.where(inner[:, None], tau, planned)
        # two updates see a singular instant at the same time, up to rounding errors
        roots = singular_instants_met(commands)
        roots = roots[(roots > ends[0]) & (roots < ends[1])]
        roots = roots[np.append(True, np.diff(roots) > 1e-4)] if len(roots) else roots
        mid = [max((c for c in commands if c.t <= t), key=lambda c: c.t).efforts.at(float(t)) for t in roots]
        count = max(STRAIGHT_PIECES, int(np.ceil((window.end - window.start) / SAMPLES)))
        kinks = [
            edges[(edges > window.start) & (edges < window.end)] for edges in (carriers.edges, source.breaks, roots)
        ]
        pieces = unique_times(np.concatenate([np.linspace(window.start, window.end, count + 1), *kinks]))
        jumps = pieces[[int(np.abs(pieces - t).argmin()) for t in kinks[1]]]
        times = np.sort(np.concatenate([pieces, jumps, 0.5 * (pieces[1:] + pieces[:-1])]))  # jumps have two values
        node = np.isin(times, pieces)
        inside = dynamics.along(source.sample_at(times)).reduce(carriers_at(carriers, times))
        W, f = inside.W / inside.row_scale[:, None], inside.f / inside.row_scale
        knots = np.concatenate([ends[:1], roots, ends[1:]])
        across = PiecewisePolynomial.linear(knots, np.array([tau[0], *mid, tau[1]]))(times)
        U, size, V = np.linalg.svd(W)
        left = np.einsum("nij,ni->nj", U, f - np.einsum("nij,nj->ni", W, across))[:, :-1] / size[:, :-1]
        across += np.einsum("njm,nj->nm", V[:, :-1], left)  # by what W does not lose
        part = PiecewisePolynomial.linear(times[node], across[node])
        missing = np.einsum("nij,nj->ni", W, np.where(node[:, None], across, part(times))) - f
        parts.append((part, float(np.abs(missing).max())))
    return parts
