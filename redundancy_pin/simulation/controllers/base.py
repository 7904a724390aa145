"""What drives a machine: the base class of controllers, how a digital one is sampled, and the amplifiers behind it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from typing import Literal, Protocol

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, each, frozen, not_negative, positive
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.dynamics.forward import ForwardKernel
from redundancy_pin.errors import InputError
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.reference import MotionReference, plan_reference
from redundancy_pin.planners.robot_record import robot_record
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.state import State, closed_state, tree_state
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial

CarrierLaw = Callable[[float], tuple[Array, Array, Array]]
"""From time to carrier positions, speeds and accelerations, each (k,); smooth between the controller's ``breaks``."""

CarrierDrive = Literal["force", "motion"]
"""Whether forces drive the carriers, or they follow a given motion exactly."""

Command = tuple[Array, Array]
"""Main efforts (m,), N or N·m, and carrier forces (k,), N."""


@dataclass(frozen=True)
class Sampling:
    """A digital controller: it reads the state every ``period``; outputs act ``delay`` later, with zero-order hold.

    During the first delay the first output acts already, as for a machine at rest under control.

    Attributes:
        period: s.
        delay: from reading the state to the change of the efforts, s; may exceed the period.

    Example:
        >>> from redundancy_pin.simulation.controllers import Sampling
        >>> Sampling(period=1e-3, delay=1e-3).delay
        0.001
    """

    period: float
    delay: float = 0.0

    def __post_init__(self) -> None:
        """Check the values."""
        positive(self.period, "period", "s")
        not_negative(self.delay, "delay")


class EffortLaw(Protocol):
    """The least interface that ``simulate`` needs of a controller; see ``Controller`` for optional members."""

    def effort(self, t: float, state: State) -> Command:
        """Return main efforts (m,), N or N·m, and carrier forces (k,), N, at time t, s."""


class Controller(ABC):
    """Interface of a controller. Derive from it, or pass any object with ``effort`` and the other members it needs.

    Attributes:
        breaks: times, s, at which the efforts jump or kink; the integration restarts there.
        jumps: breaks at which the efforts jump; None: all breaks.
        end: time at which the motion is over, s, or None.
        sampling: the ``Sampling`` it was made for, which the simulation must have; None where any will do.
        carrier_drive: the ``CarrierDrive`` it was made for, the same.
        open_loop: main efforts and carrier forces (m + k) as polynomials of time, if they do not depend on the state:
            machine code then calls no ``effort``.
    """

    breaks: ArrayLike = frozen(())
    jumps: ArrayLike | None = None
    end: float | None = None
    sampling: Sampling | None = None
    carrier_drive: CarrierDrive | None = None
    open_loop: PiecewisePolynomial | None = None

    def class_name(self) -> str:
        """Return the name of the class, for errors and results."""
        return type(self).__name__

    @abstractmethod
    def effort(self, t: float, state: State) -> Command:
        """Return main efforts (m,), N or N·m, and carrier forces (k,), N, at time t, s."""

    def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
        """Return s, ṡ, s̈ (k,) at time t, for carriers driven by motion.

        Raises:
            InputError: nothing defines the motion of the carriers.
        """
        raise InputError(
            f"{self.class_name()} does not define the motion of the carriers.",
            remedy="Give it carrier_motion(t) -> (s, sd, sdd), or drive the carriers by force.",
        )

    def start_state(self, robot: Robot) -> State:
        """Return the state to start from: the reference configuration at rest."""
        return closed_state(robot)


def as_controller(law: Controller | EffortLaw) -> Controller:
    """Return a controller that calls an object with ``effort``, with the defaults for missing members.

    Raises:
        InputError: it has no ``effort``.
    """
    if isinstance(law, Controller):
        return law
    if not callable(getattr(law, "effort", None)):
        remedy = "Pass a plan, or a controller with effort(t, state) -> (tau, carrier_force)."
        if isinstance(law, PlatformMotion) or hasattr(law, "sample"):
            remedy = (
                "A motion has no efforts yet: pass FeedForward(motion_reference(robot, motion)), both of "
                "redundancy_pin.simulation, or another controller of that reference."
            )
        elif isinstance(law, MotionReference):
            remedy = "Pass FeedForward(reference), or another controller of it."
        raise InputError(f"simulate was given {type(law).__name__} for the drive.", remedy=remedy)
    return Adapted(law)


class Adapted(Controller):
    """A user's object behind the interface of a controller: its members replace the defaults."""

    def __init__(self, law: EffortLaw) -> None:
        self._law = law
        for name in ("breaks", "jumps", "end", "sampling", "carrier_drive", "carrier_motion", "start_state"):
            if getattr(law, name, None) is not None:
                setattr(self, name, getattr(law, name))

    def effort(self, t: float, state: State) -> Command:
        """Return the efforts of the object."""
        return self._law.effort(t, state)

    def class_name(self) -> str:
        """Return the name of its class."""
        return type(self._law).__name__


def _open_loop(controller: Controller) -> PiecewisePolynomial | None:
    """Return the efforts as polynomials of time; None where ``effort`` was replaced without them."""
    law: object = controller._law if type(controller) is Adapted else controller
    owner = next((one for one in type(law).__mro__ if "effort" in vars(one)), None)
    if owner is None or "open_loop" not in vars(owner) or "effort" in getattr(law, "__dict__", {}):
        return None
    polynomials: PiecewisePolynomial | None = getattr(law, "open_loop", None)
    return polynomials


@dataclass(frozen=True, eq=False)
class Constant(Controller):
    """Constant efforts: zero unless given.

    Attributes:
        tau: (m,) main efforts, N or N·m.
        carrier_force: (k,) carrier forces, N.
    """

    tau: Array
    carrier_force: Array

    @property
    def open_loop(self) -> PiecewisePolynomial:  # type: ignore[override]
        """The efforts as polynomials of time."""
        return PiecewisePolynomial.constant(np.concatenate([self.tau, self.carrier_force]), 0.0, 1.0)

    def effort(self, t: float, state: State) -> Command:
        """Return the efforts."""
        return self.tau, self.carrier_force


class Tracking(Controller):
    """A controller's view of the motion it holds.

    Args:
        plan: a plan, or a reference made by ``plan_reference`` or ``motion_reference``.
        motion: the trajectory that was planned for, for exact values between the samples of a plan.
        sampling: how it will be sampled, if it will be.

    Raises:
        InfeasiblePlanError, PlanFileError: see ``plan_reference``.
    """

    def __init__(
        self, plan: Plan | MotionReference, motion: TimedTrajectory | None = None, sampling: Sampling | None = None
    ) -> None:
        self.reference = plan if isinstance(plan, MotionReference) else plan_reference(plan, motion=motion)
        self.robot = self.reference.robot
        self.sampling = sampling
        # efforts kink at the edges of the reference; a sampled controller's efforts are constant between samples
        self.breaks = self.reference.edges[1:-1] if sampling is None else self.reference.edges[:0]
        self.end = self.reference.end
        self.lead = 0.0 if sampling is None else sampling.delay + 0.5 * sampling.period
        """From reading the state to the middle of the interval in which the answer acts, s."""

    def carrier_motion(self, t: float) -> tuple[Array, Array, Array]:
        """Return the planned s, ṡ, s̈ (k,) at time t."""
        return self.reference.carriers(t)

    def start_state(self, robot: Robot) -> State:
        """Return the planned state at the start."""
        q, v, _ = self.reference.tree(self.reference.start)
        return tree_state(robot, q, v, t=self.reference.start)


class FeedForward(Tracking):
    """The efforts of a plan or reference, open loop.

    Args:
        plan: a plan, or a reference made by ``plan_reference`` or ``motion_reference``.
        motion: the trajectory that was planned for, for exact values between the samples of a plan.
        sampling: of the simulation: the efforts are then taken at the middle of the interval in which they act.

    Raises:
        InfeasiblePlanError, PlanFileError: see ``plan_reference``.

    Example:
        >>> from redundancy_pin.simulation import FeedForward
        >>> plan = rp.plan_stepwise("3rrr", rp.trajectory.reference.corner())
        >>> rp.simulate("3rrr", FeedForward(plan), duration=0.1).status.value
        'ok'
    """

    def __init__(
        self,
        plan: Plan | MotionReference,
        *,
        motion: TimedTrajectory | None = None,
        sampling: Sampling | None = None,
    ) -> None:
        super().__init__(plan, motion, sampling)
        self.jumps = None if sampling else self.reference.jumps

    @property
    def open_loop(self) -> PiecewisePolynomial | None:  # type: ignore[override]
        """The efforts as polynomials of time; None of a sampled controller."""
        return None if self.sampling else self.reference.efforts

    def effort(self, t: float, state: State) -> Command:
        """Return main efforts (m,) and carrier forces (k,) at time t."""
        return self.reference.loads(t + self.lead)


class Amplifiers:
    """A controller with its amplifiers: its output is checked, and saturates.

    Args:
        controller: the controller that commands the efforts.
        tau_limit: (m,) largest |τ|, N or N·m; infinite if unlimited.
        force_limit: (k,) largest |carrier force|, N.
    """

    def __init__(self, controller: Controller, tau_limit: Array, force_limit: Array) -> None:
        self._controller, self._limits = controller, (tau_limit, force_limit)
        self._shapes = (tau_limit.shape, force_limit.shape)
        self._saturates = bool(np.isfinite(tau_limit).any() or np.isfinite(force_limit).any())
        self.limits: Array = np.concatenate(self._limits)
        """(m + k,) of main efforts and carrier forces."""
        polynomials = _open_loop(controller)
        fits = polynomials is not None and polynomials.coefficients.shape[2] == len(self.limits)
        self.open_loop = polynomials if polynomials is not None and fits else None
        """The controller's output as polynomials of time, before it saturates; None if it depends on the state."""

    def command(self, state: State) -> Command:
        """Return the efforts that act at a state.

        Raises:
            InputError: the controller returns something else than a tuple of (m,) and (k,) finite numbers.
        """
        t = state.t
        answer = self._controller.effort(t, state)
        try:
            tau, force = (np.array(part, dtype=float) for part in answer)
        except (TypeError, ValueError):
            raise self._refused(answer, t) from None
        # a sum is finite only where its parts are, and takes a tenth of the time of np.isfinite on a few numbers
        finite = isfinite(sum(tau.ravel().tolist()) + sum(force.ravel().tolist()))
        if (tau.shape, force.shape) != self._shapes or not finite:
            raise self._refused(answer, t)
        if not self._saturates:
            return tau, force
        tau_limit, force_limit = self._limits
        return np.clip(tau, -tau_limit, tau_limit), np.clip(force, -force_limit, force_limit)

    def _refused(self, answer: object, t: float) -> InputError:
        (m,), (k,) = self._shapes
        return InputError(
            f"{self._controller.class_name()}.effort returned {' '.join(repr(answer).split())} at t = {t:.6g} s.",
            remedy=f"Return main efforts ({m},) and carrier forces ({k},), finite numbers.",
            time=t,
        )


def load_limits(robot: Robot, effort: ArrayLike | None, carrier_force: ArrayLike | None) -> Command:
    """Return largest |τ| (m,), N or N·m, and |F| (k,), N, each from a positive scalar, one value each, or None."""
    pairs = (effort, "effort_limit", robot.m), (carrier_force, "carrier_force_limit", robot.k)
    tau, force = (each(np.inf if limit is None else limit, name, (n,), above_zero=True) for limit, name, n in pairs)
    return tau, force


def is_same(one: Robot, other: Robot) -> bool:
    """Return whether two robots are the same machine; a record has no rotors, and no lengths that no file gave."""
    return one is other or (bool(one.model == other.model) and robot_record(one).describes(other))


def kernel_of(robot: Robot, dynamics: DynamicsLike | None) -> ForwardKernel | None:
    """Return the machine code of a backend's forward dynamics, if it has any.

    Raises:
        InputError: the backend is for another robot.
    """
    if dynamics is None:
        return None
    dynamics = as_dynamics(dynamics)
    if not is_same(dynamics.robot, robot):
        given = dynamics.robot.name
        which = f"another {given}, with other parameters" if given == robot.name else given
        raise InputError(
            f"dynamics are for {which}, but {robot.name} is required.",
            remedy="simulate needs the dynamics of the simulated robot, a controller the dynamics of its own robot.",
        )
    kernel: ForwardKernel | None = getattr(dynamics, "forward", lambda: None)()
    return kernel


def positive_each(values: ArrayLike | None, default: Array, floor: float, name: str) -> Array:
    """Return positive values, one each: those given, or the defaults raised to a share of the largest of them."""
    if values is None:
        largest = float(default.max(initial=0.0))
        return np.maximum(default, floor * largest if largest > 0.0 else 1.0)
    return each(values, name, default.shape, above_zero=True, finite=True)


def largest_loads(reference: MotionReference) -> tuple[Array, Array]:
    """Return the largest |τ| (m,), N or N·m, and |F| (k,), N, at the middles of all pieces of a reference."""
    loads = [reference.loads(t) for t in middles(reference)]
    tau, force = (np.abs(part).max(axis=0) for part in zip(*loads, strict=True))
    return tau, force


def middles(reference: MotionReference) -> list[float]:
    """Return the times in the middle of all pieces of a reference, s."""
    times: list[float] = (0.5 * (reference.edges[:-1] + reference.edges[1:])).tolist()
    return times
