"""One plan per control update over the previewed path, from the present positions of the carriers."""

from __future__ import annotations

import math
import time
from dataclasses import replace

from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, each, one_of, positive
from redundancy_pin.dynamics.default import DynamicsLike, as_dynamics
from redundancy_pin.errors import InputError, millimetres
from redundancy_pin.planners.carrier_model import require_carriers
from redundancy_pin.planners.options import Limits, group_of, takes_groups
from redundancy_pin.planners.receding_horizon.command import GOALS, Command, Goal, Weights
from redundancy_pin.planners.receding_horizon.compiled import CompiledPlanner
from redundancy_pin.planners.receding_horizon.constants import BEYOND, LATEST, SAME
from redundancy_pin.planners.receding_horizon.preview import Preview, Source
from redundancy_pin.status import UpdateStatus


class RecedingHorizon:
    """Receding-horizon planner of carriers and efforts, over a short preview of the path.

    Each control update solves a convex quadratic programme: s, ṡ, s̈ and τ at nodes 20 ms apart, 40 ms after 0.2 s,
    fixed in time, with s̈ linear in between, W τ = f linearised about the last plan, its curvature in the cost as far
    as convexity allows, and carrier limits between the nodes. If the linearisation error is too large, it iterates.
    W⁻¹ is not formed: type II singularities ahead become nodes with what makes τ finite and continuous there
    (``window.c``). At the end of the horizon the carriers can still stop on their tracks, so there always is a motion
    within their limits.

    Args:
        dynamics: the robot, or its name or path, for generated code (``as_dynamics``); or a backend.
        horizon: how far ahead it plans, s.
        step: between nodes, s; half of it around singular instants and where the platform turns.
        objective: "peak" max |τ| over the horizon plus the mean square, or "effort", the mean square alone.
            In Python ``Weights``, too.
        limits: in place of the robot's own. ``actuator_speed`` is judged, by ``run_online``: the motion is given.
        slow_down: where no plan keeps every limit, lead the platform along its path more slowly: ``Command.scaling``
            is then the time of the preview that is reached, and the status is ``TIME_SCALED``.

    Attributes:
        limits: active from the next update on; may be set between updates. ``resolved`` has them as arrays.
        slows_down: whether it leads the platform more slowly.

    Raises:
        InputError: a setting out of its domain.
        UnsupportedRobotError: no carriers.
        CompilerError: there is no C compiler, or it fails.

    Example:
        >>> planner = rp.RecedingHorizon("2rpr", horizon=0.4)
        >>> planner.update(0.0, rp.trajectory.reference.circle(speed=0.5)).status.value
        'ok'
    """

    @takes_groups({})
    def __init__(
        self,
        dynamics: DynamicsLike,
        *,
        horizon: float = 0.5,
        step: float = 0.02,
        objective: Goal | Weights = "peak",
        limits: Limits | None = None,
        slow_down: bool = False,
    ) -> None:
        dynamics = as_dynamics(dynamics)
        robot = dynamics.robot
        require_carriers(robot)
        if not isinstance(objective, Weights):
            one_of(objective, "objective", GOALS)
        self.dynamics, self.robot = dynamics, robot
        self.step, self.horizon = positive(step, "step", "s"), positive(horizon, "horizon", "s")
        if not 2.0 * step <= horizon <= 200.0 * step:
            raise InputError(
                f"The horizon of {horizon:g} s has {horizon / step:g} steps of {step:g} s.", remedy="Have 2 to 200."
            )
        self.weights = objective if isinstance(objective, Weights) else GOALS[objective]
        self._given_limits = group_of(limits, Limits)
        self.resolved = self._given_limits.resolved(robot)
        self.slows_down = slow_down
        self._source: object = None
        self._preview: Preview | None = None
        self.updates = CompiledPlanner(dynamics, step, horizon, self.weights, self.resolved, slow_down)

    @property
    def started(self) -> bool:
        """Whether there is a plan."""
        return self.updates.last is not None

    @property
    def largest(self) -> float:
        """Largest |τ| so far, N or N·m."""
        return self.updates.largest

    @property
    def limits(self) -> Limits:
        """Limits as they were given."""
        return self._given_limits

    @limits.setter
    def limits(self, limits: Limits) -> None:
        self._given_limits = group_of(limits, Limits)
        self.resolved = self._given_limits.resolved(self.robot)
        self.updates.set_limits(self.resolved)

    def update(self, t: float, preview: Source, s: ArrayLike | None = None, sd: ArrayLike | None = None) -> Command:
        """Return the command from a time on.

        Args:
            t: time of the control update, s; not before the last one.
            preview: the platform's motion ahead; a trajectory or samples that are passed again are read once.
            s: scalar or (k,) where the carriers are, m; where the last plan has them when left out, at first 0. Within
                two steps of a singular instant the last plan continues regardless.
            sd: the same for their speeds, m/s.

        Raises:
            InputError: values that are not finite, an invalid preview, a time before the last one, before the
                preview or after its end, or beyond 4e6 s.
            InfeasiblePlanError: no plan at the first control update, without an earlier plan to continue.
        """
        began = time.perf_counter()
        t = self._time(t)
        if abs(t) > LATEST:
            raise InputError(
                f"The update is at t = {t:.6g} s, where a clock cannot resolve {SAME:g} s.",
                remedy="Count time from the start of the run.",
            )
        known = self._preview if preview is self._source and self._preview is not None else Preview.of(preview)
        own = self.updates.time_of(t)
        if own < known.start - SAME:
            where = "" if own == t else f", {own:.6g} s of the preview (Command.scaling)"
            raise InputError(
                f"The update is at t = {t:.6g} s{where}, and the preview begins at {known.start:.6g} s.",
                remedy="Pass a preview that begins at the update or before.",
            )
        if own > known.end + SAME:
            raise InputError(
                f"The update is at t = {t:.6g} s, and the preview ends at {known.end:.6g} s.",
                remedy="Pass a preview that extends beyond the update, or continue with the last plan by skip(t).",
            )
        self._source, self._preview = preview, known
        given = tuple(
            None if part is None else each(part, name, (self.robot.k,), finite=True)
            for part, name in ((s, "s"), (sd, "sd"))
        )
        command = self.updates.update(t, known, given).command
        if command.status is UpdateStatus.FALLBACK and given[0] is not None:
            command = replace(command, reason=self._off_track(given[0]) or command.reason)
        return replace(command, seconds=time.perf_counter() - began)

    def _off_track(self, s: Array) -> str:
        """Return which carrier was measured (k,), m, outside its track; empty if none."""
        for name, (lower, upper), at in zip(self.resolved.names, self.resolved.track, s, strict=True):
            if max(lower - at, at - upper) > BEYOND:
                hint = millimetres(abs(at), upper - lower)
                return (
                    f"{name} was measured at {at:g} m, off its track from {lower:g} to {upper:g} m{hint and f'.{hint}'}"
                )
        return ""

    def skip(self, t: float) -> Command:
        """Return the command for a missed control update: the last plan continues to its end and the stop after it.

        Raises:
            InputError: no plan exists yet.
        """
        if self.updates.last is None:
            raise InputError("There is no plan to continue.", remedy="Call update first.")
        reason = "the update was missed"
        return replace(self.updates.last.command, t=self._time(t), status=UpdateStatus.FALLBACK, reason=reason)

    def _time(self, t: float) -> float:
        """Return the time of a control update, s, after checking that it follows the last one."""
        if not (isinstance(t, float) and math.isfinite(t)):
            t = float(each(t, "t", (1,), finite=True)[0])
        if self.updates.last is not None and t < self.updates.last.command.t:
            raise InputError(
                f"The update is at t = {t:.6g} s, after one at {self.updates.last.command.t:.6g} s.",
                remedy="Go on in time.",
            )
        return t
