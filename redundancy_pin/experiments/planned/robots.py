"""Robots and backends of the planned experiments, loaded once."""

from __future__ import annotations

import functools
from typing import Any

from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.experiments.backends import BACKENDS
from redundancy_pin.loading import load_robot


@functools.lru_cache(maxsize=64)
def dynamics(
    backend: str, name: str, mode: tuple[int, ...], carriers: bool = True, end_effector_mass: float = 0.0
) -> Dynamics:
    """Return a backend for a shipped robot; loading is most of the time of a short plan, so each is kept.

    Args:
        backend: a name of ``BACKENDS``.
        name: the shipped robot.
        mode: its working mode, ±1 a leg.
        carriers: whether it has its carriers.
        end_effector_mass: of the 2-RPR, kg.

    Raises:
        RedundancyPinError: the robot does not load.
    """
    options: dict[str, Any] = {"end_effector_mass": end_effector_mass} if end_effector_mass else {}
    return BACKENDS[backend](load_robot(name, working_mode=mode, carriers=carriers, **options))
