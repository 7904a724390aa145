"""What drives a machine: the protocol of controllers, and how a digital controller is sampled."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import isfinite
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.reference import MotionReference, plan_reference
from redundancy_pin.simulation.state import State, tree_state
from redundancy_pin.trajectory.continuous import TimedTrajectory

CarrierLaw = Callable[[float], tuple[Array, Array, Array]]
"""From time to carrier positions, speeds and accelerations, each (k,); smooth between the controller's ``breaks``."""

CarrierDrive = Literal["force", "motion"]
"""Whether forces drive the carriers, or they follow a given motion exactly."""


class Controller(Protocol):
    """What ``simulate`` needs of a controller.

    Optional attributes, used where present:

    - ``breaks``: times, s, at which the efforts jump or kink; the integration starts anew there.
    - ``jumps``: those of them at which the efforts jump.
    - ``carrier_motion``: a ``CarrierLaw``, for carriers driven by motion.
    - ``sampling``: the ``Sampling`` it was made for; the simulation must have the same.
    - ``carrier_drive``: the ``CarrierDrive`` it was made for, the same; either where it is missing.
    - ``start_state(robot)``: the ``State`` to start from, and ``end``: the time at which the motion is over, s.
    """

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        """Return main efforts (m,), N or N·m, and carrier forces (k,), N, at time t, s."""


@dataclass(frozen=True, eq=False)
class Constant:
    """Constant efforts: zero unless given.

    Attributes:
        tau: (m,) main efforts, N or N·m.
        carrier_force: (k,) carrier forces, N.
    """

    tau: Array
    carrier_force: Array

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        """Return the efforts."""
        return self.tau, self.carrier_force


@dataclass(frozen=True)
class Sampling:
    """A digital controller: it reads the state every ``period``, and its output acts ``delay`` later and is held.

    Until its first output acts, the first output acts: the machine stands with the controller on.

    Attributes:
        period: s.
        delay: from reading the state to the change of the efforts, s; may exceed the period.
    """

    period: float
    delay: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        if not (np.isfinite(self.period) and self.period > 0.0 and np.isfinite(self.delay) and self.delay >= 0.0):
            raise InputError(
                f"The sampling has period {self.period} s and delay {self.delay} s.",
                remedy="Pass a positive period and a delay that is not negative.",
            )


@dataclass(frozen=True, eq=False)
class Drive:
    """A controller behind its amplifiers: saturation, and the split into generalised forces.

    Attributes:
        robot: the robot.
        controller: what commands the efforts.
        tau_limit: (m,) largest |τ|, N or N·m; infinite where there is none.
        force_limit: (k,) largest |carrier force|, N.
    """

    robot: Robot
    controller: Controller
    tau_limit: Array
    force_limit: Array
    _limited: bool = field(init=False)
    _shapes: tuple[tuple[int], tuple[int]] = field(init=False)

    def __post_init__(self) -> None:
        """Note what efforts look like, and whether anything saturates."""
        object.__setattr__(self, "_shapes", ((self.robot.m,), (self.robot.k,)))
        object.__setattr__(
            self, "_limited", bool(np.isfinite(self.tau_limit).any() or np.isfinite(self.force_limit).any())
        )

    def command(self, t: float, state: State) -> tuple[Array, Array]:
        """Return the efforts that act: τ (m,) and carrier forces (k,).

        Raises:
            InputError: the controller returns something else than a tuple of (m,) and (k,) finite numbers.
        """
        answer = self.controller.effort(t, state)
        try:
            tau, force = (np.array(part, dtype=float) for part in answer)
        except (TypeError, ValueError):
            raise self._wrong(answer, t) from None
        # a sum is finite only where its parts are, and takes a tenth of the time of np.isfinite on a few numbers
        finite = isfinite(sum(tau.ravel().tolist()) + sum(force.ravel().tolist()))
        if (tau.shape, force.shape) != self._shapes or not finite:
            raise self._wrong(answer, t)
        return self._saturated(tau, force)

    def _wrong(self, answer: object, t: float) -> InputError:
        m, k, said = self.robot.m, self.robot.k, " ".join(repr(answer).split())
        return InputError(
            f"{type(self.controller).__name__}.effort returned {said} at t = {t:.6g} s.",
            remedy=f"Return main efforts ({m},) and carrier forces ({k},), finite numbers.",
            time=t,
        )

    def _saturated(self, tau: Array, force: Array) -> tuple[Array, Array]:
        if not self._limited:
            return tau, force
        return (
            np.clip(tau, -self.tau_limit, self.tau_limit),
            np.clip(force, -self.force_limit, self.force_limit),
        )


def limit(values: ArrayLike | None, count: int, name: str) -> Array:
    """Return (count,) limits from a scalar, one value each, or None for no limit.

    Raises:
        InputError: wrong number of values, or one that is not positive.
    """
    given = np.full(1, np.inf) if values is None else np.atleast_1d(np.asarray(values, dtype=float))
    if given.shape not in ((1,), (count,)) or not (given > 0.0).all():
        raise InputError(
            f"{name} is {values!r}.", remedy=f"Pass one positive number, or {count}, or None for no limit."
        )
    return np.broadcast_to(given, (count,))


class Tracking:
    """A controller's view of the motion it holds.

    Args:
        plan: a plan, or a reference made by ``plan_reference`` or ``motion_reference``.
        motion: the trajectory that was planned for, for exact values between the samples of a plan.
        sampling: how it will be sampled, if it will be.
    """

    def __init__(self, plan: Plan | MotionReference, motion: TimedTrajectory | None, sampling: Sampling | None) -> None:
        self.reference = plan if isinstance(plan, MotionReference) else plan_reference(plan, motion=motion)
        self.robot = self.reference.robot
        self.sampling = sampling
        self.breaks = self.reference.edges[1:-1] if sampling is None else self.reference.edges[:0]
        """Efforts kink at the edges of the reference; those of a sampled controller are constant between samples."""
        self.end = self.reference.end
        self.lead = 0.0 if sampling is None else sampling.delay + 0.5 * sampling.period
        """From reading the state to the middle of the interval in which the answer acts, s."""

    def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
        """Return the planned s, ṡ, s̈ (k,) at time t."""
        return self.reference.carriers(t)

    def start_state(self, robot: Robot) -> State:
        """Return the planned state at the start."""
        q, v, _ = self.reference.tree(self.reference.start)
        return tree_state(robot, q.copy(), v.copy(), t=self.reference.start)


class FeedForward:
    """The efforts of a plan or reference, open loop.

    Args:
        plan: a plan, or a reference made by ``plan_reference`` or ``motion_reference``.
        motion: the trajectory that was planned for, for exact values between the samples of a plan.

    Raises:
        InfeasiblePlanError, PlanFileError: see ``plan_reference``.
    """

    def __init__(self, plan: Plan | MotionReference, *, motion: TimedTrajectory | None = None) -> None:
        self.reference = plan if isinstance(plan, MotionReference) else plan_reference(plan, motion=motion)
        self.breaks = self.reference.edges[1:-1]
        self.jumps = self.reference.jumps
        self.end = self.reference.end

    def effort(self, t: float, state: State) -> tuple[Array, Array]:
        """Return main efforts (m,) and carrier forces (k,) at time t."""
        return self.reference.loads(t)

    def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
        """Return the planned s, ṡ, s̈ (k,) at time t."""
        return self.reference.carriers(t)

    def start_state(self, robot: Robot) -> State:
        """Return the planned state at the start."""
        q, v, _ = self.reference.tree(self.reference.start)
        return tree_state(robot, np.array(q), np.array(v), t=self.reference.start)
