"""The initial value problem of a simulation, its state in progress, and its samples."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Any

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.forward import Progress
from redundancy_pin.simulation.controllers.base import Command, Sampling
from redundancy_pin.simulation.events import Event, EventFunctions
from redundancy_pin.simulation.rank_loss import Sheet
from redundancy_pin.simulation.system import Machine
from redundancy_pin.status import ResultStatus

SAME = 1e-9
"""Instants closer than this fraction of a sampling period, or of the interval of the result's samples, are one."""

SHORTEST = 1e-8
"""Shortest ordinary step, share of the time scale: after many shorter ones in a row the integration fails."""


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
    """Method, tolerances and times of a simulation: what stays the same from its start to its end.

    Attributes:
        method: name of the method in ``INTEGRATORS``.
        settings: rtol, atol (nq + nv,) and max_step.
        time: s; the time scale of the motion: the shorter one of its duration and the time of ``robot.scales``.
        unit: (nq + nv,) the characteristic length or 1 rad for q, and over the time scale for v.
        max_steps: number of steps after which the integration fails.
        grid: (G,) times at which to record, s, first and last included.
        breaks: inner times at which efforts jump, s.
        sampling: of a digital controller, or None.
        report: called with the time that is reached and the last one, s; None: no reports.
    """

    method: str
    settings: Mapping[str, Any]
    time: float
    unit: Array
    max_steps: int
    grid: Array
    breaks: Array
    sampling: Sampling | None
    report: Callable[[float, float], None] | None

    @property
    def shortest(self) -> float:
        """The shortest ordinary step, s."""
        return SHORTEST * self.time

    def notify(self, progress: SimulationProgress) -> None:
        """Report how far the simulation is, if reports were requested."""
        if self.report is not None:
            self.report(progress.t, float(self.grid[-1]))


@dataclass(frozen=True, eq=False)
class SimulatedSample:
    """A closed state and the data from which its forces and accelerations follow.

    Attributes:
        t: time, s.
        y: (nq + nv,) closed state.
        machine: the differential equation, with the closure rows and the stopped joints of this state.
        hold: zero-order hold command; None: the controller answers at every instant.
        sheet: solution branch across a rank loss of the closures (``rank_loss``), or None.
    """

    t: float
    y: Array
    machine: Machine
    hold: Command | None
    sheet: Sheet | None


@dataclass(frozen=True, eq=False, kw_only=True)
class SimulationProgress(Progress):
    """State of a simulation in progress: all that changes from step to step.

    Attributes:
        machine: the differential equation, with the joints that stops hold.
        functions: event functions of the machine.
        hold, sheet: as in ``SimulatedSample``.
        samples, events: recorded so far, in order of time; the lists grow.
        short: number of the last steps that were all shorter than the shortest ordinary one.
        rows_renewed: when dependent closure rows last came into use, s.
        switches: number of the last changes of the stops that push, all of them at ``switched``, s.
        seconds: see ``Statistics``.
        status: None before the end.
        reason: cause of a failure.
    """

    machine: Machine
    functions: EventFunctions
    hold: Command | None
    sheet: Sheet | None
    samples: list[SimulatedSample] = field(default_factory=list)
    events: list[Event] = field(default_factory=list)
    short: int = 0
    rows_renewed: float = -np.inf
    switches: int = 0
    switched: float = -np.inf
    seconds: float = 0.0
    status: ResultStatus | None = None
    reason: str = ""

    def failed(self, why: str) -> SimulationProgress:
        """Return this progress with the status of a failure, and its reason."""
        return replace(self, status=ResultStatus.NOT_CONVERGED, reason=f"At t = {self.t:.9g} s {why.rstrip('.')}.")

    def sample(self, t: float, y: Array) -> SimulatedSample:
        """Return the closed state nearest to y (nq + nv,) at a time, s, as a sample."""
        return SimulatedSample(t, self.machine.project(t, y, self.sheet)[0], self.machine, self.hold, self.sheet)

    def restarted(self, machine: Machine, at: Sequence[int], held: Sequence[int]) -> SimulationProgress:
        """Return the progress restarted with another machine; ``at`` and ``held``: see ``EventFunctions``."""
        old, q = self.functions, self.y[: self.functions.nq]
        functions = EventFunctions(machine.chain, old.stop_at, q, old.push_back, at, held)
        fresh = replace(self, machine=machine, functions=functions, values=functions.at_start(q))
        return replace(fresh, status=None, reason="", next_step=None, short=0)
