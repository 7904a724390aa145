"""What an engine is asked to do: an initial state, and efforts as functions of time."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from redundancy_pin.arrays import Array, checked, frozen
from redundancy_pin.errors import InputError
from redundancy_pin.robot import Robot
from redundancy_pin.trajectory import Side


class Efforts(Protocol):
    """Efforts of the main actuators and carriers over time."""

    def __call__(self, t: Array, side: Side = "right") -> Array:
        """Return (N, m + k) main efforts, then carrier forces, at (N,) times; ``side`` decides where they jump."""


@dataclass(frozen=True, init=False, eq=False)
class Task:
    """An initial state and the efforts from then on.

    Attributes:
        robot: the robot.
        start, end: first and last time, s.
        breaks: (b,) inner times at which efforts or their slope jump, s: a step ends there and a new one starts. An
            integrator of order two keeps its order only if no step reaches across.
        q: (nq,) closed configuration at the start, carriers included.
        v: (nv,) velocity there that keeps the closures.
        efforts: main efforts and carrier forces, N or N·m.

    Raises:
        InputError: a state of the wrong shape, an empty interval, breaks outside it or not increasing.
    """

    robot: Robot
    start: float
    end: float
    breaks: Array
    q: Array
    v: Array
    efforts: Efforts

    def __init__(
        self, robot: Robot, start: float, end: float, q: Array, v: Array, efforts: Efforts, breaks: Array | None = None
    ) -> None:
        inner = checked([] if breaks is None else breaks, "breaks", ("b",))
        edges = np.array([start, *inner, end])
        if not (np.isfinite(edges).all() and (np.diff(edges) > 0.0).all()):
            raise InputError(
                f"The interval from {start} to {end} s with breaks at {inner.tolist()} does not increase.",
                remedy="Pass start < breaks < end.",
            )
        for name, value in (
            ("robot", robot),
            ("start", float(start)),
            ("end", float(end)),
            ("breaks", inner),
            ("q", checked(q, "q", (robot.model.nq,))),
            ("v", checked(v, "v", (robot.model.nv,))),
            ("efforts", efforts),
        ):
            object.__setattr__(self, name, value)

    @property
    def duration(self) -> float:
        """Length of the interval, s."""
        return self.end - self.start


@dataclass(frozen=True, eq=False)
class Segment:
    """A stretch of a task between two breaks, cut into equal steps.

    Attributes:
        t: (S + 1,) times, s.
        step: length of a step, s.
        effort: (S + 1, m + k) efforts there; at both ends those inside the stretch.
    """

    t: Array
    step: float
    effort: Array


def segments(task: Task, step: float) -> tuple[Segment, ...]:
    """Cut a task at its breaks and each stretch into equal steps, none longer than ``step``, s.

    Raises:
        InputError: a step that is not positive.
    """
    if not (np.isfinite(step) and step > 0.0):
        raise InputError(f"The step is {step} s.", remedy="Pass a positive number of seconds.", step=step)
    edges = [task.start, *task.breaks, task.end]
    steps = []
    for left, right in itertools.pairwise(edges):
        # a quotient that is whole up to rounding must not cost a step more
        count = max(1, int(np.ceil((right - left) / step * (1.0 - 1e-12))))
        t = np.linspace(left, right, count + 1)
        effort = np.array(task.efforts(t))
        effort[-1] = task.efforts(t[-1:], side="left")[0]
        steps.append(Segment(frozen(t), (right - left) / count, frozen(effort)))
    return tuple(steps)
