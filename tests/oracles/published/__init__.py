"""Published problems: machines of others, simulated as anyone would, against published or independent solutions."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

import redundancy_pin as rp
from published import models, references
from redundancy_pin.simulation import closed_state

ANDREWS_ORDER = ("beta", "theta", "gamma", "phi", "delta", "omega", "epsilon")


@dataclass(frozen=True)
class Problem:
    """A start at rest or not, a duration, what is looked at, and what it should be at times (N,)."""

    name: str
    robot: Callable[[], Any]
    duration: float
    look: Callable[[Any], Any]
    reference: Callable[[Any], Any]
    start: tuple[tuple[float, ...], tuple[float, ...]] | None = None
    drive: Any = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    compiled: bool = True

    def run(self, *, duration=None, samples=50, **settings):
        """Simulate; seconds are those of the integration alone."""
        robot, duration = self.robot(), self.duration if duration is None else duration
        start = None if self.start is None else closed_state(robot, *self.start)
        given = {**self.settings, **settings}
        return rp.simulate(robot, self.drive, start=start, duration=duration, dt=duration / samples, **given)

    def error(self, run):
        """Largest difference, as a share of the largest value."""
        want = np.asarray(self.reference(run.t))
        return float(np.abs(self.look(run) - want).max() / np.abs(want).max())


def end_of(run):
    names = list(models.andrews().model.names)[1:]
    return run.q[-1][[names.index(name) for name in ANDREWS_ORDER]]


def column(k):
    return lambda run: run.q[:, k]


UP = 0.5 * np.pi
ANDREWS = Problem(
    "Andrews' squeezing mechanism, against the published values", models.andrews, 0.03, end_of,
    lambda t: references.ANDREWS_END["q"], drive=models.Constant(0.033), settings={"rtol": 1e-12, "atol": 1e-13},
)  # fmt: skip
PROBLEMS = (
    ANDREWS,
    Problem(
        "the same, against the printed equations", models.andrews, 0.03, end_of,
        lambda t: references.andrews_end()[0], drive=ANDREWS.drive, settings=ANDREWS.settings,
    ),
    Problem(
        "Haug's spatial slider-crank", models.slider_crank, 5.0, column(1), references.slider_crank, ((0.0,), (6.0,)),
    ),
    Problem("Bricard's six hinges (A04)", models.bricard, 10.0, column(0), references.bricard),
    *(
        Problem(
            f"{n} four-bars in a row (A02)", lambda n=n: models.four_bars(n), 10.0, column(0),
            lambda t, n=n: references.parallel_cranks(t, UP, -1.0, n), ((UP,), (-1.0,)),
        )
        for n in (1, 2, 10)
    ),
    Problem(
        "stiff governor (A05), Radau", models.governor, 10.0, column(1), lambda t: references.governor(t, 2 * np.pi),
        ((0.0, 0.5, -np.pi / 3, np.pi / 3), (2 * np.pi, 0.0, 0.0, 0.0)),
        settings={"integrator": "Radau", "rtol": 1e-7, "atol": 1e-9}, compiled=False,
    ),
    Problem(
        "stiff governor, DOP853, a tenth of a second", models.governor, 0.1, column(1),
        lambda t: references.governor(t, 2 * np.pi), ((0.0, 0.5, -np.pi / 3, np.pi / 3), (2 * np.pi, 0.0, 0.0, 0.0)),
        settings={"rtol": 1e-7, "atol": 1e-9},
    ),
    Problem(
        "Pinocchio's four-bar", lambda: models.four_bars(1, 0.6, 1.0, (5.0, 10.0), 0.1), 5.0, column(0),
        lambda t: references.parallel_cranks(t, 1.2, 0.0, 1, 0.6, (5.0, 10.0), 0.1), ((1.2,), (0.0,)),
    ),
    Problem(
        "Drake's four-bar", models.drake, 5.0, column(0), lambda t: references.drake(t, 3.0),
        ((models.DRAKE_START,), (3.0,)),
    ),
)  # fmt: skip


def seconds_of(action):
    began = time.process_time()
    return action(), time.process_time() - began


def rows(problems=PROBLEMS):
    """Error, digits, steps and processor times of each problem, in Python and in machine code."""
    records = []
    for problem in problems:
        run, seconds = seconds_of(problem.run)
        row = {"what": problem.name, "duration": problem.duration, "status": run.status.value}
        row |= {"error": problem.error(run), "steps": run.statistics.steps, "seconds": seconds}
        if problem.compiled:
            fast = rp.CompiledDynamics(problem.robot())
            quick, row["compiled_seconds"] = seconds_of(lambda p=problem, d=fast: p.run(dynamics=d))
            row["compiled_error"] = problem.error(quick)
        records.append(row)
        print(f"{row['what']}: {row['error']:.1e} in {row['steps']} steps, {row['seconds']:.2f} s", flush=True)
    return records


def table(records):
    """The rows as Markdown."""
    lines = ["| problem | time | digits | error | steps | s | compiled, s |", "|---|---|---|---|---|---|---|"]
    for row in records:
        compiled = f"{row['compiled_seconds']:.2g}" if "compiled_seconds" in row else "–"
        digits = f"{-np.log10(row['error']):.1f}" if row["status"] == "ok" else row["status"]
        lines.append(
            f"| {row['what']} | {row['duration']:g} s | {digits} | {row['error']:.0e} | {row['steps']} "
            f"| {row['seconds']:.2g} | {compiled} |"
        )
    return "\n".join(lines)
