"""One plan a tick over the path known ahead, from where the carriers are."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, each, one_of, positive, require_type
from redundancy_pin.dynamics.base import Dynamics, require_dynamics
from redundancy_pin.errors import InputError
from redundancy_pin.motion import CarrierMotion
from redundancy_pin.planners.carrier_model import require_carriers
from redundancy_pin.planners.limits import Limits, grouped
from redundancy_pin.planners.receding_horizon.command import GOALS, Command, Goal, PlanningStatus, Weights
from redundancy_pin.planners.receding_horizon.linearised import ZONE, Linearised, extended, nodes_from
from redundancy_pin.planners.receding_horizon.preview import SAME, Preview, Source
from redundancy_pin.planners.receding_horizon.programme import SOLVERS, Programme
from redundancy_pin.planners.receding_horizon.tick import Setup, Sizes, Tick

NEAR = 0.25
"""A singular instant nearer than this, in steps, is reached by the last plan; the new one begins there."""

SETTLED = 2.0
"""Steps before a singular instant in which a plan begins where the last one is, and not where the carriers are."""

EXTRA = 8
"""Nodes beyond those of even steps, for the finer ones around singular instants."""

CONVERGED = 2.5
"""Steps before a singular instant in which a tick has several rounds: W⁻¹ magnifies what is left of uᵀ f there."""

EXACT = 1e-6
"""Fraction of f that may be left."""

MOST_ROUNDS = 5

PROXIMAL = 3.0
"""Weight of the squared change of s̈ from round to round: they would go to and fro between two plans of one cost."""

SMALLEST = 0.05
"""Efforts count as of size one from this fraction of those of parked carriers."""

FIRST_ROUNDS = 3
"""Programmes of the first tick, each about the plan of the one before."""


class RecedingHorizon:
    """Plans the carriers and the efforts again and again, over the path known for a short time ahead.

    Each tick solves one convex quadratic programme: s, ṡ, s̈ and τ at nodes 20 ms apart, fixed in time, with s̈ linear
    in between, W τ = f linear about the last plan, and the limits of the carriers between the nodes too. W⁻¹ is not
    formed: type II singularities ahead become nodes with what makes τ finite and continuous there (``linearised``). At
    the end of the horizon the carriers can still stop on their tracks, so there always is a motion within their limits.

    Args:
        dynamics: a backend; ``CompiledDynamics`` is the fastest by far.
        horizon: how far ahead it plans, s.
        step: between nodes, s; half of it around singular instants.
        objective: "peak" max |τ| over the horizon, beside the mean square, or "effort", that alone; or ``Weights``.
        track, speed, acceleration, jerk, effort, carrier_force: limits as of ``plan_whole_trajectory``.
        limits: these as one group.
        solver: of the programmes: "piqp" or one of casadi's (``SOLVERS``).

    Attributes:
        limits: in force from the next tick on; may be set between ticks. ``resolved`` has them as arrays.
        largest: largest |τ| so far, N or N·m.

    Raises:
        InputError: a setting out of its domain.
        UnsupportedRobotError: no carriers.
        RedundancyPinError: the solver is not installed.
    """

    def __init__(
        self,
        dynamics: Dynamics,
        *,
        horizon: float = 0.5,
        step: float = 0.02,
        objective: Goal | Weights = "peak",
        track: ArrayLike | None = None,
        speed: ArrayLike | None = None,
        acceleration: ArrayLike | None = None,
        jerk: ArrayLike | None = None,
        effort: ArrayLike | None = None,
        carrier_force: ArrayLike | None = None,
        limits: Limits | None = None,
        solver: str = "piqp",
    ) -> None:
        require_dynamics(dynamics)
        robot = dynamics.robot
        require_carriers(robot)
        one_of(solver, "solver", SOLVERS)
        if not isinstance(objective, Weights):
            one_of(objective, "objective", GOALS)
        self.dynamics, self.robot = dynamics, robot
        self.step, self.horizon = positive(step, "step", "s"), positive(horizon, "horizon", "s")
        if not 2.0 * step <= horizon <= 200.0 * step:
            raise InputError(
                f"The horizon of {horizon:g} s has {horizon / step:g} steps of {step:g} s.", remedy="Have 2 to 200."
            )
        self.weights = objective if isinstance(objective, Weights) else GOALS[objective]
        flat = {"track": track, "speed": speed, "acceleration": acceleration}
        flat |= {"jerk": jerk, "effort": effort, "carrier_force": carrier_force}
        self._count = round(horizon / step) + EXTRA
        self._solver = solver
        self._bounded = (False, False)
        self._programmes: dict[bool, Programme] = {}
        self.limits = grouped("limits", limits, Limits, **flat)
        self._source: object = None
        self._preview: Preview | None = None
        self._last: Command | None = None
        self._sizes: Sizes | None = None
        self.largest = 0.0

    @property
    def started(self) -> bool:
        """Whether there is a plan."""
        return self._last is not None

    @property
    def limits(self) -> Limits:
        """Limits as they were given."""
        return self._given_limits

    @limits.setter
    def limits(self, limits: Limits) -> None:
        require_type(limits, Limits, "The limits of a planner", "Pass Limits(track=..., speed=..., ...).")
        self._given_limits, self.resolved = limits, limits.resolved(self.robot)
        jerk, force = (bool(np.isfinite(part).any()) for part in (self.resolved.jerk, self.resolved.carrier_force))
        if self._bounded != (jerk, force):
            self._bounded = (jerk, force)
            self._programmes.clear()

    def programme(self, elastic: bool) -> Programme:
        """Return the programme of a tick, which is put together once."""
        if elastic not in self._programmes:
            robot = self.robot
            sizes = robot.n, robot.m, robot.k, self._count
            jerk, force = self._bounded
            self._programmes[elastic] = Programme(*sizes, self._solver, jerk, force, elastic)
        return self._programmes[elastic]

    def update(self, t: float, preview: Source, s: ArrayLike | None = None, sd: ArrayLike | None = None) -> Command:
        """Return what to do from a time on.

        Args:
            t: the tick, s; not before the one before.
            preview: the platform's motion ahead; a trajectory or samples that are passed again are read once.
            s: scalar or (k,) where the carriers are, m; where the last plan has them when left out, at first 0. Within
                two steps of a singular instant the last plan goes on all the same.
            sd: the same for their speeds, m/s.

        Raises:
            InputError: values that are not finite, a preview that is none, a time before the last one.
            InfeasiblePlanError: no plan at the first tick, with none before it to go on with.
        """
        began = time.perf_counter()
        if self._preview is None or preview is not self._source:
            self._preview, self._source = Preview.of(preview), preview
        t = self._tick(t)
        if t < self._preview.start - SAME:
            raise InputError(
                f"The tick is at t = {t:.6g} s, and the preview begins at {self._preview.start:.6g} s.",
                remedy="Pass what is known of the motion from the tick on.",
            )
        given = tuple(
            None if part is None else each(part, name, (self.robot.k,), finite=True)
            for part, name in ((s, "s"), (sd, "sd"))
        )
        last = self._last
        command = self._plan(t, self._preview, given, last, last)
        for rounds in range(1, MOST_ROUNDS):
            if rounds >= (FIRST_ROUNDS if last is None else 1) and not self._is_rough(t, command):
                break
            another = self._plan(t, self._preview, given, last, command)
            if another.status is not PlanningStatus.PLANNED:
                break
            command = another
        self._last = command = replace(command, seconds=time.perf_counter() - began)
        self.largest = max(self.largest, float(np.abs(command.efforts(np.linspace(t, t + self.step, 5))).max()))
        return command

    def skip(self, t: float) -> Command:
        """Return what to do where a tick is missed: the last plan goes on, to its end and to the stop behind it.

        Raises:
            InputError: there is no plan yet.
        """
        if self._last is None:
            raise InputError("There is no plan to go on with.", remedy="Call update first.")
        return replace(self._last, t=self._tick(t), status=PlanningStatus.FALLBACK, reason="the tick was missed")

    def _tick(self, t: float) -> float:
        """Return the time of a tick, s, after checking that it goes on from the last one."""
        t = float(each(t, "t", (1,), finite=True)[0])
        if self._last is not None and t < self._last.t:
            raise InputError(
                f"The tick is at t = {t:.6g} s, after one at {self._last.t:.6g} s.", remedy="Go on in time."
            )
        return t

    def _is_rough(self, t: float, command: Command) -> bool:
        """Return whether a plan leaves force out next to a singular instant, which another round would put right."""
        roots = command.singular
        near = ((roots > t) & (roots < t + CONVERGED * self.step)).any()
        exact = self._sizes is None or command.residual <= EXACT * float(self._sizes.row.max())
        return bool(near) and command.status is PlanningStatus.PLANNED and not exact

    def _plan(
        self,
        t: float,
        preview: Preview,
        given: tuple[Array | None, ...],
        last: Command | None,
        about: Command | None,
    ) -> Command:
        """Return a plan that goes on from the last one, with f linear about it or about that of the round before."""
        step, k = self.step, self.robot.k
        before = t if preview.changing else t - ZONE * step  # for the nodes around one that is past
        roots = preview.singular_instants(self.dynamics, before, t + step * (self._count + 1), step)
        ahead = roots[roots > t - SAME]
        near = len(ahead) and ahead[0] <= t + NEAR * step and last is not None
        start = float(ahead[0]) if near else t
        nodes, singular = nodes_from(start, step, self._count + 1, roots)
        if last is None:
            s, sd = (np.zeros(k) if part is None else part for part in given)
            first = s, sd, np.zeros(k)
        else:
            own = extended(last.carriers, nodes[:1])
            settled = len(ahead) and ahead[0] <= t + SETTLED * step
            pairs = zip(given, (own.s[0], own.sd[0]), strict=True)
            s, sd = (planned if part is None or settled else part for part, planned in pairs)
            first = s, sd, own.sdd[0]
        if about is None:
            at = CarrierMotion(*(np.tile(part, (len(nodes), 1)) for part in first), check_rates=False)
        else:
            at = extended(about.carriers, nodes)
        lin = Linearised.about(self.dynamics, preview, nodes, singular, at)
        if self._sizes is None:
            self._sizes = Sizes.of(lin)
        sizes = self._sizes
        if last is not None:  # of all rounds the same, or the second would be off to another plan
            share = min(max(last.peak / sizes.tau, SMALLEST), 1.0)
            sizes = Sizes(share * sizes.tau, sizes.row)
        jerk = None if last is None else last.carriers.derivative(3)(nodes[:1], "left")[0]
        proximal = PROXIMAL if about is not last else 0.0
        setup = Setup(self.resolved, self.weights, self.step, self.horizon, self._count, self.largest, self.programme)
        return Tick(setup, lin, first, last is None, jerk, sizes, proximal).command(t, last, roots, preview)
