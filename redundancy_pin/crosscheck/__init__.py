"""Cross-check for users: backend against backend, and both against physics, on random robots in random motion."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

from redundancy_pin.crosscheck.cases import Case, Masses, batches, random_case
from redundancy_pin.crosscheck.parity import check_parity, check_parity_on_singularities
from redundancy_pin.crosscheck.physics import (
    check_derivatives,
    check_leg_momentum,
    check_power,
    check_round_trip,
)
from redundancy_pin.crosscheck.report import CheckRow, CrossCheckReport, Tally
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.rnea import RneaDynamics
from redundancy_pin.dynamics.virtual_work import VirtualWork
from redundancy_pin.errors import InputError
from redundancy_pin.loading import load_robot
from redundancy_pin.robot.description import shipped_robots
from redundancy_pin.workers import parallel

__all__ = ["CheckRow", "CrossCheckReport", "run"]

Progress = Callable[[int, int], None]
"""Called with the states done and the states in all."""


@dataclass(frozen=True)
class _Batch:
    """One case that a worker draws and checks."""

    robot: str
    index: int
    samples: int
    seed: int
    vary: bool
    massless: bool = False


def run(
    robots: Sequence[str] | None = None,
    samples: int = 2000,
    seed: int = 0,
    progress: Progress | None = None,
    jobs: int = 1,
) -> CrossCheckReport:
    """Check the dynamics of robots on random states and return the worst deviations.

    Shipped robots get random xacro arguments, gravity and working modes; a robot of one's own is taken as it is. Robots
    with a closed form get every check with both backends, the others those of the RNEA backend.

    Args:
        robots: names or paths; all shipped robots when left out.
        samples: random states for each robot.
        seed: seed of the random states; the same seed gives the same report.
        progress: told how far it is.
        jobs: processes that share the work; the report does not depend on it.

    Raises:
        InputError: ``samples`` or ``jobs`` is not positive, or ``seed`` is negative.
        RedundancyPinError: a robot does not load, no reachable motion of it is found, or a process died.
    """
    if samples < 1:
        raise InputError(f"samples is {samples}.", remedy="Ask for at least one state.", samples=samples)
    if seed < 0:
        raise InputError(f"seed is {seed}.", remedy="Pass a whole number from zero up.", seed=seed)
    if jobs < 1:
        raise InputError(f"jobs is {jobs}.", remedy="Ask for at least one process.", jobs=jobs)
    work = list(_batches(tuple(robots) if robots else shipped_robots(), samples, seed))
    total, done = sum(batch.samples for batch in work), 0
    merged = Tally()
    for batch, tally in zip(work, parallel(_checked, [(batch,) for batch in work], jobs, ordered=True), strict=True):
        merged.merge(tally)
        done += batch.samples
        if progress:
            progress(done, total)
    return CrossCheckReport(merged.rows(), seed)


def _batches(names: Sequence[str], samples: int, seed: int) -> Iterator[_Batch]:
    for position, name in enumerate(names):
        vary = name in shipped_robots()
        own = seed + 1000 * position
        yield from (_Batch(name, index, size, own, vary) for index, size in enumerate(batches(samples)))
        if vary and load_robot(name).closed_form == "2rpr":
            sizes = batches(max(1, samples // 4))
            yield from (_Batch(name, index, size, seed + 7, vary, massless=True) for index, size in enumerate(sizes))


def _checked(batch: _Batch) -> Tally:
    """Draw the case of a batch and check it."""
    tally = Tally()
    name, samples, seed, index = batch.robot, batch.samples, batch.seed, batch.index
    if batch.massless:
        _check_massless(tally, random_case(name, samples, seed, index, carriers=True, masses=Masses.ZERO_STAYS_ZERO))
    else:
        _check(tally, random_case(name, samples, seed, index, vary=batch.vary, masses=Masses.ALL))
    return tally


def _check(tally: Tally, case: Case) -> None:
    backends: dict[str, Dynamics] = {"rnea": RneaDynamics(case.robot)}
    if case.robot.closed_form is not None:
        backends["virtual work"] = VirtualWork(case.robot)
        check_parity(tally, case)
        check_parity_on_singularities(tally, case)
    for label, dynamics in backends.items():
        check_power(tally, case, dynamics, label)
        check_round_trip(tally, case, dynamics, label)
        if case.robot.k:
            check_derivatives(tally, case, dynamics.along(case.motion(case.t)), label)


def _check_massless(tally: Tally, case: Case) -> None:
    """Check the 2-RPR of the thesis, whose only masses are the carriers."""
    for label, dynamics in (("rnea", RneaDynamics(case.robot)), ("virtual work", VirtualWork(case.robot))):
        check_leg_momentum(tally, case, dynamics, label)
