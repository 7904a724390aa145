"""Run an experiment: sample the motion, find its singular instants, ask both backends, compare them."""

from __future__ import annotations

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.distribution import SampleStatus, distribute
from redundancy_pin.errors import CrossCheckError
from redundancy_pin.experiments.backends import BACKENDS
from redundancy_pin.experiments.experiment import Experiment
from redundancy_pin.experiments.result import BackendOutcome, Parity, Result, SingularInstant
from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.singularities.crossings import Crossing, find_crossings
from redundancy_pin.trajectory import Trajectory

PARITY_TOLERANCE = 1e-10
"""Largest relative difference between the backends: both are exact, so a thousandth of this is rounding already."""

_SAME_INSTANT = 1e-9
"""Sampling times this close to a singular instant, s, give way to it."""


def run(experiment: Experiment) -> Result:
    """Run an experiment with both backends.

    Args:
        experiment: what to run.

    Raises:
        CrossCheckError: the backends differ by more than ``PARITY_TOLERANCE``.
        RedundancyPinError: the robot does not load or does not follow the motion.
    """
    robot = experiment.load_robot()
    trajectory = experiment.trajectory()
    crossings = find_crossings(robot, trajectory)
    motion = sample_with(trajectory, experiment.dt, np.array([crossing.t for crossing in crossings]))
    carriers = CarrierMotion.parked(len(motion), robot.k)
    outcomes = {}
    for name, backend in BACKENDS.items():
        reduced = backend(robot).reduce(motion, carriers)
        outcomes[name] = BackendOutcome(reduced, distribute(reduced))
    first, second = outcomes.values()
    parity = compare(first, second)
    if not parity.worst <= PARITY_TOLERANCE:
        raise CrossCheckError(
            f"The backends differ by {parity.worst:.3g} (relative) along {experiment.name}, more than "
            f"{PARITY_TOLERANCE:g}: f {parity.f:.3g}, W {parity.W:.3g}, carrier force {parity.carrier_force:.3g}, "
            f"efforts {parity.tau:.3g}.",
            remedy="One of them is wrong: run `redundancy-pin validate` to see where.",
            experiment=experiment.name,
            parity=parity,
        )
    instants = tuple(_instant(crossing, motion, first) for crossing in crossings)
    return Result(experiment, robot, trajectory, motion, carriers, outcomes, instants, parity)


def sample_with(trajectory: Trajectory, dt: float, instants: Array) -> PlatformMotion:
    """Return samples every ``dt`` and at given instants, jumps of the acceleration two-sided.

    Args:
        trajectory: what to sample.
        dt: interval, s.
        instants: (c,) further times, s, increasing; a regular time that all but coincides with one is left out.
    """
    grid = np.unique(trajectory.sample(dt, two_sided=False).t)
    if len(instants):
        apart = np.abs(grid[:, None] - instants[None, :]).min(axis=1) > _SAME_INSTANT
        grid = np.sort(np.concatenate([grid[apart], instants]))
    return trajectory.sample(times=grid)


def compare(first: BackendOutcome, second: BackendOutcome) -> Parity:
    """Return the largest differences of two backends, relative to the largest value along the motion."""
    regular = first.distribution.status == SampleStatus.REGULAR
    a, b = first.reduced, second.reduced
    return Parity(
        f=_difference(a.f, b.f),
        W=_difference(a.W, b.W),
        carrier_force=_difference(a.carrier_force, b.carrier_force),
        tau=_difference(first.distribution.tau[regular], second.distribution.tau[regular]),
    )


def _difference(a: Array, b: Array) -> float:
    if a.size == 0:
        return 0.0
    size = max(float(np.abs(a).max()), float(np.abs(b).max()))
    return float(np.abs(a - b).max()) / size if size > 0.0 else 0.0


def _instant(crossing: Crossing, motion: PlatformMotion, outcome: BackendOutcome) -> SingularInstant:
    sample = int(np.argmin(np.abs(motion.t - crossing.t)))
    distribution = outcome.distribution
    return SingularInstant(
        t=float(motion.t[sample]),
        sample=sample,
        x=tuple(float(value) for value in np.atleast_1d(motion.x[sample])),
        kind=crossing.kind.label,
        uncontrolled=tuple(float(value) for value in distribution.uncontrolled[sample]),
        missing_force=float(distribution.residual[sample]),
        status=SampleStatus(distribution.status[sample]).label,
    )
