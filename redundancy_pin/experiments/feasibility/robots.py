"""The robots of a map, each loaded once a process."""

from __future__ import annotations

import functools

from redundancy_pin.loading import load_robot
from redundancy_pin.robot import Robot


@functools.lru_cache(maxsize=16)
def loaded(
    source: str,
    mode: tuple[int, ...],
    gravity: tuple[float, ...] | None,
    arguments: tuple[tuple[str, float | bool | str], ...],
) -> Robot:
    """Load a robot, once a process: that takes longer than many a plan, and constraint models do not pickle.

    Raises:
        RedundancyPinError: as ``load_robot``.
    """
    return load_robot(source, working_mode=mode or None, gravity=gravity, **dict(arguments))
