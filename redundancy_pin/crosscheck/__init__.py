"""Cross-check for users: the dynamics of a robot against physics, and backend against backend, on random states.

Four checks: rates and accelerations of the joints keep the closures (``closures``), the power of the actuators is the
rate of the energy (``energy``), forward dynamics return the accelerations that inverse dynamics were given, and other
backends give the same W, f, carrier forces and base wrench as RNEA (``physics``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from redundancy_pin.arrays import require_few
from redundancy_pin.crosscheck.physics import check_parity, check_physics
from redundancy_pin.crosscheck.report import SCOPE, CheckRow, CrossCheckReport, merged
from redundancy_pin.crosscheck.states import batches, random_states
from redundancy_pin.dynamics.compiled import CompiledDynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.errors import InputError
from redundancy_pin.parallel import parallel, require_jobs
from redundancy_pin.robot.shipped import shipped_robots

MOST_STATES = 100_000_000
"""Most states of each robot: weeks of computing."""

__all__ = ["SCOPE", "CheckRow", "CrossCheckReport", "run"]

Progress = Callable[[int, int], None]
"""Called with the states done and the states in all."""


def run(
    robots: Sequence[str] | None = None,
    samples: int = 2000,
    seed: int = 0,
    progress: Progress | None = None,
    jobs: int = 1,
    *,
    trust: bool = False,
    settings: Mapping[str, object] | None = None,
) -> CrossCheckReport:
    """Check the dynamics of robots on random states and return the worst deviations.

    RNEA is judged by physics. Generated code, and virtual work where the robot has a closed form, are compared with it.

    Args:
        robots: names or paths; all shipped robots when left out.
        samples: random states for each robot.
        seed: seed of the random states; the same seed gives the same report.
        progress: called at the start, and as batches get ready.
        jobs: processes that share the work; the report does not depend on it.
        trust: as for ``load_robot``.
        settings: arguments of the robots, as ``load_robot`` takes them.

    Raises:
        InputError: ``samples`` or ``jobs`` is not positive, or ``seed`` is negative.
        RedundancyPinError: a robot does not load, no states of it are found, or a process died.

    Example:
        >>> from redundancy_pin import crosscheck
        >>> crosscheck.run(["four_bar"], samples=8).passed
        True
    """
    for name, value, least in (("samples", samples, 1), ("seed", seed, 0), ("jobs", jobs, 1)):
        if value < least:
            raise InputError(f"{name} is {value}.", remedy=f"Pass {least} or more.", name=name, value=value)
    require_few(samples, MOST_STATES, "samples is {}", "Ask for fewer, with several seeds.")
    require_jobs(jobs)
    names = tuple(robots) if robots else shipped_robots(gallery=False)
    given = tuple((settings or {}).items())
    work = [
        (name, size, seed + 1000 * position, index, trust, given)
        for position, name in enumerate(names)
        for index, size in enumerate(batches(samples))
    ]
    total, done = samples * len(names), 0
    rows: tuple[CheckRow, ...] = ()
    if progress:
        progress(0, total)
    # in order, so that the report does not depend on which process was faster
    for (_, size, *_), checked in zip(work, parallel(checked_batch, work, jobs, ordered=True), strict=True):
        rows = merged((*rows, *checked))  # a million states are thousands of batches
        done += size
        if progress:
            progress(done, total)
    return CrossCheckReport(tuple(row for row in rows if row.skipped or not row.note), seed)


def checked_batch(
    source: str, samples: int, seed: int, index: int, trust: bool, settings: tuple[tuple[str, object], ...]
) -> list[CheckRow]:
    """Draw random states, as ``random_states``, and return the rows of all checks on them."""
    states = random_states(source, samples, seed, index, trust=trust, settings=settings)
    robot, along = states.robot, RneaDynamics(states.robot).along(states.motion)
    rows = [*check_physics(states, along), *check_parity(states, along, "compiled", CompiledDynamics)]
    if robot.closed_form is not None:
        rows += check_parity(states, along, "virtual work", VirtualWork)
    note = "those that cannot be reached are drawn again"
    drawn = CheckRow(robot.name, "random states", samples, 0.0, 0.0, True, note, states.skipped)
    return sorted([*rows, drawn], key=lambda row: bool(row.note))
