"""What a simulation integrates, how far it is, and what it records."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array, IntArray
from redundancy_pin.dynamics.forward import Progress
from redundancy_pin.simulation.controllers.base import Command, Sampling
from redundancy_pin.simulation.events import Event, EventFunctions
from redundancy_pin.simulation.rank_loss import Sheet
from redundancy_pin.simulation.system import Machine
from redundancy_pin.status import ResultStatus

SAME = 1e-9
"""Instants closer than this fraction of a sampling period, or of the interval of the result's samples, are one."""

SHORTEST = 1e-8
"""Shortest ordinary step, share of the time scale: after many shorter ones in a row the integration is given up."""

LARGEST_RESIDUAL = 1e-9
"""Closure residual, rad or characteristic lengths, that the projection must not leave."""


@dataclass(frozen=True)
class SmoothInterval:
    """A time, s, over which the efforts are smooth.

    ``reads``: whether a digital controller reads the state at its start; ``acting``: number of the reading whose answer
    acts meanwhile, None where the controller answers at every instant.
    """

    start: float
    end: float
    reads: bool = False
    acting: int | None = None


def smooth_intervals(start: float, end: float, breaks: Array, sampling: Sampling | None) -> list[SmoothInterval]:
    """Return the intervals from a start to an end, s, with ``breaks`` between them.

    The reading at the start is taken before, and none is taken at the end.
    """
    if sampling is None:
        return [SmoothInterval(left, right) for left, right in pairwise([start, *breaks.tolist(), end])]
    same = SAME * sampling.period
    count = max(1, int(np.ceil((end - start) / sampling.period - SAME)))
    reads = start + sampling.period * np.arange(count)
    acts = reads + sampling.delay
    edges = np.sort(np.concatenate([reads, acts, breaks]))
    edges = edges[(edges > start + same) & (edges < end - same)]
    edges = np.concatenate([[start], edges[np.diff(edges, prepend=-np.inf) > same], [end]])
    due, acted = (np.searchsorted(times, edges[:-1] + same, side="right") for times in (reads, acts))
    result, taken = [], 1
    for left, right, read, act in zip(edges[:-1].tolist(), edges[1:].tolist(), due, acted, strict=True):
        new = bool(read > taken)
        taken += new
        result.append(SmoothInterval(left, right, new, max(min(int(act), taken) - 1, 0)))
    return result


@dataclass(frozen=True, eq=False)
class InitialValueProblem:
    """What is integrated, and how.

    Attributes:
        machine: the differential equation, with the joints that stops hold.
        free: the same without stops.
        held: (h,) stops that hold joints, by their places among the functions.
        functions: whose zeros are events.
        method: its name in ``INTEGRATORS``.
        settings: rtol, atol (nq + nv,) and max_step.
        time: s; the time scale of the motion: the shorter one of its duration and the time of ``robot.scales``.
        unit: (nq + nv,) the characteristic length or 1 rad for q, and over the time scale for v.
        max_steps: number of steps after which it is given up.
        grid: (G,) times at which to record, s, first and last included.
        breaks: inner times at which efforts jump, s.
        sampling: of a digital controller, or None.
        report: called with the time that is reached and the last one, s; None where nobody asks.
    """

    machine: Machine
    free: Machine
    held: IntArray
    functions: EventFunctions
    method: str
    settings: Mapping[str, Any]
    time: float
    unit: Array
    max_steps: int
    grid: Array
    breaks: Array
    sampling: Sampling | None
    report: Callable[[float, float], None] | None = None

    @property
    def shortest(self) -> float:
        """The shortest ordinary step, s."""
        return SHORTEST * self.time

    @property
    def largest_residual(self) -> float:
        """The closure residual, m, that the projection must not leave."""
        return LARGEST_RESIDUAL * self.machine.robot.characteristic_length


@dataclass(frozen=True, eq=False)
class SimulationProgress(Progress):
    """How far a simulation is.

    Attributes:
        sheet: what it is on where the closures lose rank, see ``rank_loss``.
        short: how many steps in a row were shorter than the shortest ordinary one.
        rows_renewed: when dependent closure rows last came into use, s.
        switches: how often in a row stops have begun or ended to push, at ``switched``, s.
        seconds: see ``Statistics``.
        status: None while it goes on.
        reason: why it failed.
    """

    sheet: Sheet | None = None
    short: int = 0
    rows_renewed: float = -np.inf
    switches: int = 0
    switched: float = -np.inf
    seconds: float = 0.0
    status: ResultStatus | None = None
    reason: str = ""

    def failed(self, why: str) -> SimulationProgress:
        """Return that it ends here."""
        return replace(self, status=ResultStatus.NOT_CONVERGED, reason=f"At t = {self.t:.9g} s {why.rstrip('.')}.")


@dataclass(frozen=True, eq=False)
class SimulatedSample:
    """A closed state y (nq + nv,) at time t, s, and the command that is held there (None: the controller's answer).

    ``machine``: what has moved it, with the closure rows that it used; None is that of the start.
    """

    t: float
    y: Array
    hold: Command | None
    sheet: Sheet | None
    machine: Machine | None = None


@dataclass(eq=False)
class SimulationRecord:
    """Samples and events in order of time, as they come in."""

    samples: list[SimulatedSample] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
