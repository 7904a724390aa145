"""Cross-check for users: backend against backend, and both against physics, on random robots in random motion."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from redundancy_pin.crosscheck.cases import Case, Masses, random_cases
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

__all__ = ["CheckRow", "CrossCheckReport", "run"]

Progress = Callable[[int, int], None]
"""Called with the states done and the states in all."""


def run(
    robots: Sequence[str] | None = None, samples: int = 2000, seed: int = 0, progress: Progress | None = None
) -> CrossCheckReport:
    """Check the dynamics of robots on random states and return the worst deviations.

    Shipped robots get random xacro arguments, gravity and working modes; a robot of one's own is taken as it is. Robots
    with a closed form get every check with both backends, the others those of the RNEA backend.

    Args:
        robots: names or paths; all shipped robots when left out.
        samples: random states for each robot.
        seed: seed of the random states; the same seed gives the same report.
        progress: told how far it is.

    Raises:
        InputError: ``samples`` is not positive, or ``seed`` is negative.
        RedundancyPinError: a robot does not load, or no reachable motion of it is found.
    """
    if samples < 1:
        raise InputError(f"samples is {samples}.", remedy="Ask for at least one state.", samples=samples)
    if seed < 0:
        raise InputError(f"seed is {seed}.", remedy="Pass a whole number from zero up.", seed=seed)
    names = tuple(robots) if robots else shipped_robots()
    tally = Tally()
    done, total = 0, samples * len(names)
    for position, name in enumerate(names):
        vary = name in shipped_robots()
        for case in random_cases(name, samples, seed + 1000 * position, vary=vary, masses=Masses.ALL):
            _check(tally, case)
            done += len(case.t)
            if progress:
                progress(done, total)
        if load_robot(name).closed_form == "2rpr" and vary:
            for case in random_cases(
                name, max(1, samples // 4), seed + 7, carriers=True, masses=Masses.ZERO_STAYS_ZERO
            ):
                _check_massless(tally, case)
    return CrossCheckReport(tally.rows(), seed)


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
