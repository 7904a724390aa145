"""Cross-check for users: the dynamics of a robot against physics, and backend against backend, on random states.

``checks.CHECKS`` is the table of comparisons, of tolerances, and of the errors of a model that pass.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from redundancy_pin.arrays import one_of, whole
from redundancy_pin.crosscheck.checks import check_states
from redundancy_pin.crosscheck.report import SCOPE, CheckRow, CrossCheckReport, merged
from redundancy_pin.crosscheck.states import batches, random_states
from redundancy_pin.dynamics.compiled.gpu import Device
from redundancy_pin.parallel import Progress, parallel, require_jobs
from redundancy_pin.robot.shipped import shipped_robots

MOST_STATES = 100_000_000
"""Most states of each robot: weeks of computing."""

__all__ = ["SCOPE", "CheckRow", "CrossCheckReport", "run"]


def run(
    robots: Sequence[str] | None = None,
    samples: int = 2000,
    seed: int = 0,
    progress: Progress | None = None,
    jobs: int = 1,
    *,
    trust: bool = False,
    settings: Mapping[str, object] | None = None,
    device: Device | None = None,
) -> CrossCheckReport:
    """Check the dynamics of robots on random states and return the worst deviations.

    RNEA is judged by physics. Generated code, and virtual work where the robot has a closed form, are compared with it.
    The states and RNEA are made by the processor, whatever the device.

    Args:
        robots: names or paths; all shipped robots when left out.
        samples: random states for each robot.
        seed: seed of the random states; the same seed gives the same report.
        progress: called with the states done and the states in all, at the start and as batches get ready.
        jobs: processes that share the work, -1 for one per core; the report does not depend on it.
        trust: as for ``load_robot``.
        settings: arguments of the robots, as ``load_robot`` takes them.
        device: "gpu" or "cpu": compare ``GpuDynamics`` there, too.

    Raises:
        InputError: ``samples`` is not positive or above 1e8, ``seed`` is negative, or ``jobs`` is as ``rp.sweep``
            refuses it.
        RedundancyPinError: a robot does not load, no states of it are found, a process died, or cupy is not installed.
        CompilerError: there is no such device, or its code cannot be compiled.

    Example:
        >>> from redundancy_pin import crosscheck
        >>> crosscheck.run(["four_bar"], samples=8).passed
        True
    """
    samples, seed = whole(samples, "samples", 1, MOST_STATES), whole(seed, "seed", 0, 2**63)
    require_jobs(jobs)
    one_of(device, "device", (None, "gpu", "cpu"))
    names = tuple(robots) if robots else shipped_robots(gallery=False)
    given = tuple((settings or {}).items())
    work = [
        (name, size, seed + 1000 * position, index, trust, given, device)
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
    source: str,
    samples: int,
    seed: int,
    index: int,
    trust: bool,
    settings: tuple[tuple[str, object], ...],
    device: Device | None = None,
) -> list[CheckRow]:
    """Draw random states, as ``random_states``, and return the rows of all checks on them."""
    states = random_states(source, samples, seed, index, trust=trust, settings=settings)
    note = "those that cannot be reached are drawn again"
    drawn = CheckRow(states.robot.name, "random states", samples, 0.0, 0.0, True, note, states.skipped)
    return sorted([*check_states(states, device), drawn], key=lambda row: bool(row.note))
