"""What an engine returns, and how far that is from a planned motion."""

from __future__ import annotations

import importlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from engines.drive import Drive
from engines.links import LinkTree
from engines.task import Task
from redundancy_pin.arrays import Array, BoolArray, read_only
from redundancy_pin.errors import RedundancyPinError
from redundancy_pin.kinematics.closure import ConstraintSystem, independent_velocity
from redundancy_pin.kinematics.coordinates import coordinates, difference
from redundancy_pin.robot import Robot
from redundancy_pin.robot.scales import turning_velocities
from redundancy_pin.status import ResultStatus


@dataclass(frozen=True, eq=False)
class EngineRun:
    """A motion an engine computed. N instants, n coordinates, k carriers; arrays are read-only.

    Attributes:
        engine, version: which engine.
        settings: step, s, and what else decided on the result.
        t: (N,) time, s; the start and the end of every step.
        x: (N, n) platform coordinates, base frame, m and rad; poses (N, 4, 4) for a spatial platform.
        s: (N, k) carrier positions, m.
        q: (N, nq) configurations, as in ``robot.model``.
        v: (N, nv) velocities.
        gap: (N,) largest closure residual, m (rotation rows: rad).
        steps: number of steps.
        seconds: wall time of the integration alone, without building the model and without judging.
        status: whether the end was reached.
        message: what the engine said where it was not.
    """

    engine: str
    version: str
    settings: Mapping[str, object]
    t: Array
    x: Array
    s: Array
    q: Array
    v: Array
    gap: Array
    steps: int
    seconds: float
    status: ResultStatus
    message: str

    @property
    def speed(self) -> float:
        """Simulated time per wall time."""
        return float(self.t[-1] - self.t[0]) / self.seconds


@dataclass(frozen=True, eq=False)
class Raw:
    """What comes out of an engine: joint coordinates (N, links) and their rates at (N,) times, s."""

    t: Array
    coordinates: Array
    rates: Array
    seconds: float
    message: str


def finished(
    tree: LinkTree, task: Task, raw: Raw, engine: str, version: str, settings: Mapping[str, object]
) -> EngineRun:
    """Return a run from the engine's joint coordinates; what is not finite is cut off."""
    finite = np.isfinite(raw.coordinates).all(axis=1) & np.isfinite(raw.rates).all(axis=1)
    count = len(raw.t) if finite.all() else int(finite.argmin())
    t = raw.t[:count]
    q, v = tree.to_q(raw.coordinates[:count]), tree.to_v(raw.rates[:count])
    state = ConstraintSystem(task.robot).evaluate(q)
    done = count == len(raw.t) and not raw.message
    message = raw.message or ("" if done else f"The state is not finite after {t[-1]:.6g} s.")
    return EngineRun(
        engine=engine,
        version=version,
        settings=dict(settings),
        t=read_only(t.copy()),
        x=read_only(coordinates(task.robot, state)),
        s=read_only(q[:, task.robot.carrier_position]),
        q=read_only(q),
        v=read_only(v),
        gap=read_only(np.abs(state.phi).max(axis=1, initial=0.0)),
        steps=count - 1,
        seconds=raw.seconds,
        status=ResultStatus.OK if done else ResultStatus.NOT_CONVERGED,
        message=message,
    )


def joined(parts: Sequence[Raw]) -> Raw:
    """Join stretches: the end of one is the start of the next and is kept once."""
    last = len(parts) - 1

    def all_but_end(values: Array, index: int) -> Array:
        return values if index == last else values[:-1]

    return Raw(
        np.concatenate([all_but_end(part.t, i) for i, part in enumerate(parts)]),
        np.concatenate([all_but_end(part.coordinates, i) for i, part in enumerate(parts)]),
        np.concatenate([all_but_end(part.rates, i) for i, part in enumerate(parts)]),
        sum(part.seconds for part in parts),
        parts[-1].message,
    )


@dataclass(frozen=True, eq=False)
class Deviation:
    """How far a run is from the planned motion, at its own instants.

    Attributes:
        t: (N,) time, s.
        platform: (N,) distance of the platform origin (of the independent prismatic joints) from its place, m.
        turn: (N,) angle by which the platform (the independent revolute joints) is off, rad; zero where none turns.
        carriers: (N, k) distance of each carrier from its place on the track, m.
        gap: (N,) closure gap, m (rotation rows: rad).
        completed: whether the run reached its end.
    """

    t: Array
    platform: Array
    turn: Array
    carriers: Array
    gap: Array
    completed: bool

    @property
    def largest(self) -> float:
        """Largest of platform, turn and carriers, in m and rad alike: what a tolerance is compared with.

        Infinite where the run did not reach its end: what is missing is not right.
        """
        if not self.completed:
            return float("inf")
        parts = (self.platform, self.turn, self.carriers)
        return max(float(np.max(part, initial=0.0)) for part in parts)


def deviation(drive: Drive, run: EngineRun) -> Deviation:
    """Compare a run with the motion the drive was made for."""
    robot = drive.task.robot
    planned = drive.platform(run.t)
    off = np.abs(difference(robot, run.x, planned.x))
    turns = _turns(robot)
    return Deviation(
        t=run.t,
        platform=read_only(np.linalg.norm(off[:, ~turns], axis=1)),
        turn=read_only(np.linalg.norm(off[:, turns], axis=1)),
        carriers=read_only(np.abs(run.s - drive.carriers(run.t).s)),
        gap=run.gap,
        completed=run.status == ResultStatus.OK,
    )


def _turns(robot: Robot) -> BoolArray:
    """Return (n,) which independent coordinates are angles."""
    if robot.platform is not None:
        return np.array([axis.startswith("r") for axis in robot.platform.axes])
    turning: BoolArray = turning_velocities(robot)[independent_velocity(robot)]
    return turning


def require(module: str) -> Any:
    """Return an optional engine.

    Raises:
        RedundancyPinError: it is not installed.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise RedundancyPinError(
            f"This needs the engine {module}, which is not installed.",
            remedy="Install it with `pip install 'redundancy_pin[engines]'`.",
            engine=module,
        ) from error
