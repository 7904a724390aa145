"""A controller that plans while the machine moves: the receding horizon inside the loop, computed torque around it."""

from __future__ import annotations

from collections import Counter, deque

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, each, fraction, positive, require_type
from redundancy_pin.dynamics.default import DynamicsLike
from redundancy_pin.errors import InputError
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners import receding_horizon as planning
from redundancy_pin.planners.reference import MotionReference, ReferencePoint
from redundancy_pin.robot import Robot
from redundancy_pin.simulation.controllers.base import Command, Sampling
from redundancy_pin.simulation.controllers.computed_torque import HISTORY, ComputedTorque
from redundancy_pin.simulation.derivatives import state_error
from redundancy_pin.simulation.state import State
from redundancy_pin.trajectory.continuous_motion import TimedTrajectory, as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial, chebyshev_times

PIECE = 0.01
"""Longest piece of the polynomials that stand for the platform and the tree, s."""


class OnlineReference(MotionReference):
    """The platform's motion with the carriers and efforts of the latest plan."""

    def __init__(self, robot: Robot, motion: TimedTrajectory) -> None:
        source = as_motion(motion)
        own = np.unique(np.concatenate([source.kinks, np.arange(source.start, source.end, PIECE)]))
        edges = own[np.append(np.diff(own) > 1e-6, True)]
        times = chebyshev_times(edges)
        platform, parked = source.sample_at(times), CarrierMotion.parked(len(times), robot.k)
        tree = inverse_kinematics(robot, platform).with_carriers(parked)

        parts = platform.x, platform.xd, platform.xdd, parked.s, parked.sd, parked.sdd, tree.q, tree.v, tree.a
        values = np.concatenate([part.reshape(len(times), -1) for part in parts], axis=1)
        states = PiecewisePolynomial.from_values(edges, values.reshape(len(edges) - 1, -1, values.shape[1]))
        efforts = PiecewisePolynomial.constant(np.zeros(robot.m + robot.k), source.start, source.end)
        super().__init__(robot, edges, states, efforts, platform.is_pose, np.zeros(robot.k), float("nan"))
        self.plan: planning.Command | None = None

    def carriers(self, t: float) -> tuple[Array, Array, Array]:
        """Return s, ṡ, s̈ (k,) of the latest plan at time t; parked before the first."""
        return super().carriers(t) if self.plan is None else self.plan.motion_at(t)

    def loads(self, t: float) -> tuple[Array, Array]:
        """Return its main efforts (m,) and carrier forces (k,) at time t."""
        return super().loads(t) if self.plan is None else (self.plan.efforts.at(t), self.plan.forces.at(t))

    def platform(self, t: float) -> tuple[Array, Array, Array]:
        """Return x, (n,) or a pose (4, 4), ẋ and ẍ (n,) at time t: where the latest plan leads it along its path."""
        sigma, rate, bend = self.path_time(t)
        x, along, curved = super().platform(sigma)
        return x, along * rate, curved * rate**2 + along * bend

    def path_time(self, t: float) -> tuple[float, float, float]:
        """Return σ, σ̇ and σ̈ of the latest plan, s and 1/s."""
        if self.plan is None or self.plan.scaling is None:
            return t, 1.0, 0.0
        (sigma,), (rate,), (bend,) = self.plan.scaling.at([t])
        return float(sigma), float(rate), float(bend)

    def tree(self, t: float) -> tuple[Array, Array, Array]:
        """Return q (nq,), v and a (nv,) at time t."""
        robot, (s, sd, sdd) = self.robot, self.carriers(t)
        sigma, rate, bend = self.path_time(t)
        q, v, a = (np.array(part) for part in super().tree(sigma))
        v, a = v * rate, a * rate**2 + v * bend
        q[robot.carrier_position], v[robot.carrier_velocity], a[robot.carrier_velocity] = s, sd, sdd
        return q, v, a

    def at(self, t: float) -> ReferencePoint:
        """Return everything at time t, s."""
        return ReferencePoint(t, *self.platform(t), *self.carriers(t), *self.tree(t), *self.loads(t))


class OnlinePlanning(ComputedTorque):
    """Computed torque along plans that are made while the machine moves.

    At every control update ``RecedingHorizon`` plans over the next half second, from the predicted carrier state at the
    start of the plan: the last plan plus a share of the measured deviation from it. Until then the last plan
    continues. The planner does not use the motion beyond the horizon.

    Args:
        planner: new, before its first update; its robot is the model that the controller knows.
        motion: the platform's motion; each control update uses it up to its horizon.
        sampling: of the simulation.
        tick: between plans, s.
        delay: from reading the state to the plan that comes of it, s: at least the time that planning takes.
        correction: share of the carriers' distance from their plan that a new plan takes over, 0 to 1.
        integral: ω_i, rad/s: ẍ has − ω² ω_i ∫ e dt too, against what the model does not know, such as friction; a tenth
            to a third of the bandwidth is stable.
        effort_scale, carrier_scale: as of ``ComputedTorque``.
        others: further settings of ``ComputedTorque``.

    Attributes:
        plans: the latest commands of the planner.
    """

    def __init__(
        self,
        planner: planning.RecedingHorizon,
        motion: TimedTrajectory,
        sampling: Sampling,
        *,
        tick: float = 0.02,
        delay: float = 5e-3,
        correction: float = 0.2,
        integral: float = 0.0,
        effort_scale: ArrayLike,
        carrier_scale: ArrayLike = 1.0,
        dynamics: DynamicsLike | None = None,
        **others: ArrayLike | float | None,
    ) -> None:
        if not isinstance(sampling, Sampling):
            raise InputError("On-line planning is for a digital controller.", remedy="Pass sampling=Sampling(1e-3).")
        require_type(planner, planning.RecedingHorizon, "A RecedingHorizon", "Pass one for each controller.")
        if planner.started:
            raise InputError("The planner has plans of another run.", remedy="Pass a new RecedingHorizon.")
        self._live = OnlineReference(planner.robot, motion)
        self._known_until = planning.Preview.of(motion).end
        settings: dict[str, object] = {"effort_scale": effort_scale, "carrier_scale": carrier_scale, **others}
        super().__init__(self._live, sampling=sampling, dynamics=dynamics, **settings)  # type: ignore[arg-type]
        self.planner, self._motion = planner, motion
        self.tick, self.planning_delay = positive(tick, "tick", "s"), float(each(delay, "delay", (1,), finite=True)[0])
        if not 0.0 <= self.planning_delay < self.tick <= planner.horizon:
            raise InputError(
                f"The delay of {delay:g} s is not within a tick of {tick:g} s, or that not within the horizon of "
                f"{planner.horizon:g} s.",
                remedy="Have delay < tick <= horizon.",
            )
        self.correction = fraction(correction, "correction")
        self.integral, self._period = float(each(integral, "integral", (1,), finite=True)[0]), sampling.period
        if not 0.0 <= self.integral < self.bandwidth:
            raise InputError(
                f"An integral of {self.integral:g} rad/s is not within the bandwidth of {self.bandwidth:g} rad/s.",
                remedy="Pass 0 <= integral < bandwidth.",
            )
        self._accumulated = np.zeros(planner.robot.n)  # m s
        self.plans: deque[planning.Command] = deque(maxlen=HISTORY)
        self._coming: planning.Command | None = None
        self._next = -np.inf

    @property
    def counts(self) -> dict[str, int]:
        """Ticks by status."""
        return dict(Counter(plan.status.value for plan in self.plans))

    def effort(self, t: float, state: State) -> Command:
        """Return main efforts (m,) and carrier forces (k,) at time t; call it in order of time."""
        if self._live.plan is None:  # the machine is at rest, and has time
            self._live.plan = self._plan(t, state.s, state.sd)
            self._next = t + self.tick
        elif t >= self._next - 1e-9 and self._live.path_time(t + self.planning_delay)[0] <= self._known_until:
            self._next += self.tick
            starts = t + self.planning_delay
            (s, sd, _), (s_then, sd_then, _) = self._live.carriers(t), self._live.carriers(starts)
            beside = self.correction * (state.s - s), self.correction * (state.sd - sd)
            self._coming = self._plan(starts, s_then + beside[0], sd_then + beside[1])
        if self._coming is not None and t >= self._coming.t - 1e-9:
            self._live.plan, self._coming = self._coming, None
        if self.integral:
            point = self.reference.at(t)
            error = state_error(self.robot, state, point.x, point.xd, point.s, point.sd)
            self._accumulated = self._accumulated + self._period * error[: self.robot.n]
        return super().effort(t, state)

    def _learnt(self) -> Array:
        return self.integral * self.bandwidth**2 * self._accumulated

    def _plan(self, t: float, s: Array, sd: Array) -> planning.Command:
        command = self.planner.update(t, self._motion, s, sd)
        self.plans.append(command)
        return command
