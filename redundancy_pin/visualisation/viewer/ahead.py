"""What an on-line planner knew and planned at its ticks, for a moving picture: the path ahead, and plans over time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from redundancy_pin.arrays import Array, BoolArray
from redundancy_pin.errors import InputError
from redundancy_pin.planners.receding_horizon import Command
from redundancy_pin.planners.receding_horizon.command import extended
from redundancy_pin.robot import Robot
from redundancy_pin.visualisation.viewer.scene import traced

MOST_TICKS = 300
"""Of a longer run every other tick is shown, or every third: all of them would make a page of many megabytes."""

MOST_BEADS = 150
"""On the path."""

POINTS = 26
"""Of a plan: every 20 ms of half a second."""


@dataclass(frozen=True, eq=False)
class Ahead:
    """The plans of a run. T ticks, P points of each, B places on the path; times in s from the first frame on."""

    t: Array  # (T,) of the ticks
    until: Array  # (T,) until when the platform's motion was known
    singular: Array  # (r,) singular instants that came into sight
    times: Array  # (T, P) of the points
    planned: Mapping[str, Array]  # (T, P) positions of carriers, m or rad, and efforts of main actuators, N or N·m
    places: Array  # (B, 3) of the platform, world, m
    reached: Array  # (B,) when it is there

    def in_sight(self, t: Array) -> BoolArray:
        """Return (F, B) which places are known and still ahead at (F,) times, s."""
        tick = np.clip(np.searchsorted(self.t, t, side="right") - 1, 0, None)
        inside: BoolArray = (self.reached > t[:, None]) & (self.reached <= self.until[tick][:, None])
        return inside


def ahead_of(robot: Robot, t: Array, q: Array, commands: Sequence[Command]) -> Ahead:
    """Return what the commands of an on-line planner show along (N, nq) configurations at (N,) times, s.

    Raises:
        InputError: no commands, or none in this time.
    """
    during = [command for command in commands if t[0] - 1e-9 <= command.t <= t[-1]]
    if not during:
        raise InputError(
            f"No command lies between {t[0]:.6g} and {t[-1]:.6g} s.", remedy="Pass the commands of this run."
        )
    shown = during[:: -(-len(during) // MOST_TICKS)]
    starts = np.array([command.t for command in shown])
    ends = np.array([min(command.known_until, command.carriers.end, t[-1]) for command in shown])
    times = np.linspace(starts, np.maximum(ends, starts), POINTS).T
    plans = list(zip(shown, times, strict=True))
    s = np.array([extended(command.carriers, own)[0] for command, own in plans])
    within = [np.clip(own, command.efforts.start, command.efforts.end) for command, own in plans]
    tau = np.array([command.efforts(own) for command, own in zip(shown, within, strict=True)])
    roots = np.unique(np.concatenate([command.singular for command in during]).round(4))
    beads = np.unique(np.searchsorted(t, np.linspace(t[0], t[-1], MOST_BEADS)).clip(0, len(t) - 1))
    return Ahead(
        t=starts - t[0],
        until=ends - t[0],
        singular=roots[roots <= t[-1]] - t[0],
        times=times - t[0],
        planned={
            **{name: s[:, :, i] for i, name in enumerate(robot.carriers)},
            **{name: tau[:, :, i] for i, name in enumerate(robot.actuated)},
        },
        places=traced(robot, q[beads]),
        reached=t[beads] - t[0],
    )
