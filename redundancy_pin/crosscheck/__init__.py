"""Cross-check for users: backend against backend, and both against physics, on random robots in random motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

from redundancy_pin.arrays import require_few
from redundancy_pin.crosscheck.cases import Masses, RandomCase, batches, random_case
from redundancy_pin.crosscheck.checks import (
    CheckRow,
    CrossCheckReport,
    Deviation,
    check_derivatives,
    check_leg_momentum,
    check_motion,
    check_parity,
    check_parity_on_singularities,
    check_power,
    check_round_trip,
    checked_row,
    merged,
)
from redundancy_pin.crosscheck.load_power import load_efforts
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.errors import InputError
from redundancy_pin.loading import load_robot
from redundancy_pin.parallel import parallel, require_jobs
from redundancy_pin.robot.shipped import shipped_robots

MOST_STATES = 100_000_000  # of each robot: weeks

__all__ = ["CheckRow", "CrossCheckReport", "load_efforts", "run"]

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

    Shipped robots get random xacro arguments, gravity and working modes; a robot of one's own is taken as it is. Robots
    with a closed form get every check with both backends, the others those of the RNEA backend.

    Args:
        robots: names or paths; all shipped robots when left out.
        samples: random states for each robot.
        seed: seed of the random states; the same seed gives the same report.
        progress: called at the start, and as batches get ready.
        jobs: processes that share the work; the report does not depend on it.
        trust: as for ``load_robot``.
        settings: arguments of the robots, as ``load_robot`` takes them; shipped ones are then taken as they are, too.

    Raises:
        InputError: ``samples`` or ``jobs`` is not positive, or ``seed`` is negative.
        RedundancyPinError: a robot does not load, no reachable motion of it is found, or a process died.
    """
    for name, value, least in (("samples", samples, 1), ("seed", seed, 0), ("jobs", jobs, 1)):
        if value < least:
            raise InputError(f"{name} is {value}.", remedy=f"Pass {least} or more.", name=name, value=value)
    require_few(samples, MOST_STATES, "samples is {}", "Ask for fewer, with several seeds.")
    require_jobs(jobs)
    names = tuple(robots) if robots else shipped_robots(gallery=False)
    given = tuple((settings or {}).items())
    work = [(*each, trust, given) for each in _batches(names, samples, seed, vary=not given)]
    total, done = sum(size for _, _, size, *_ in work), 0
    rows: tuple[CheckRow, ...] = ()
    if progress:
        progress(0, total)
    # in order, so that the report does not depend on which process was faster
    for (_, _, size, *_), checked in zip(work, parallel(checked_batch, work, jobs, ordered=True), strict=True):
        rows = merged((*rows, *checked))  # a million states are thousands of batches
        done += size
        if progress:
            progress(done, total)
    return CrossCheckReport(tuple(row for row in rows if row.skipped or not row.note), seed)


def _batches(
    names: Sequence[str], samples: int, seed: int, *, vary: bool
) -> Iterator[tuple[str, int, int, int, bool, bool]]:
    """Return what ``checked_batch`` takes, for each case."""
    for position, name in enumerate(names):
        varied = vary and name in shipped_robots(gallery=False)
        own = seed + 1000 * position
        yield from ((name, index, size, own, varied, False) for index, size in enumerate(batches(samples)))
        if varied and load_robot(name).closed_form == "2rpr":
            sizes = batches(max(1, samples // 4))
            yield from ((name, index, size, seed + 7, varied, True) for index, size in enumerate(sizes))


def checked_batch(
    name: str,
    index: int,
    samples: int,
    seed: int,
    vary: bool,
    massless: bool,
    trust: bool,
    settings: tuple[tuple[str, object], ...] = (),
) -> list[CheckRow]:
    """Draw a case and check it; ``massless`` is the 2-RPR of the thesis, whose only masses are the carriers."""
    masses, carriers = (Masses.ZERO_STAYS_ZERO, True) if massless else (Masses.ALL, None)
    case = random_case(
        name, samples, seed, index, vary=vary, carriers=carriers, masses=masses, trust=trust, settings=settings
    )
    deviations = _massless_deviations(case) if massless else _deviations(case)
    rows = [checked_row(case.robot.name, deviation) for deviation in deviations]
    if not vary:  # the shipped ones have states for every check
        rows = [row if row.samples else replace(row, note="every state is skipped") for row in rows]
    note = "those that cannot be followed are drawn again"
    rows.append(CheckRow(case.robot.name, "random motions", 1, 0.0, 0.0, True, note, case.skipped))
    return sorted(rows, key=lambda row: bool(row.note))


def _deviations(case: RandomCase) -> Iterator[Deviation]:
    backends: dict[str, Dynamics] = {"rnea": RneaDynamics(case.robot)}
    if case.robot.closed_form is not None:
        backends["virtual work"] = VirtualWork(case.robot)
        yield from check_parity(case)
        yield from check_parity_on_singularities(case)
    yield from check_motion(case)
    for label, dynamics in backends.items():
        yield from check_power(case, dynamics, label)
        yield from check_round_trip(case, dynamics, label)
        if case.robot.k or "carriers" in case.robot.parameters:
            yield from check_derivatives(case, dynamics.along(case.motion(case.t)), label)


def _massless_deviations(case: RandomCase) -> Iterator[Deviation]:
    yield from check_leg_momentum(case, RneaDynamics(case.robot), "rnea")
    yield from check_leg_momentum(case, VirtualWork(case.robot), "virtual work")
