"""Experiments that tests share, run once a session and coarsely."""

from __future__ import annotations

import functools
from dataclasses import replace

from redundancy_pin.experiments import EXPERIMENTS, Experiment, Result, run


def experiment(name: str, dt: float = 0.01) -> Experiment:
    """Return a shipped experiment with coarser samples."""
    return replace(next(entry for entry in EXPERIMENTS if entry.name == name), dt=dt)


@functools.cache
def result(name: str, dt: float = 0.01) -> Result:
    """Run a shipped experiment once a session."""
    return run(experiment(name, dt))
