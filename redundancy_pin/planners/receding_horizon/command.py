"""Input and output of a control update: weights, statuses, commands."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Literal

import numpy as np

from redundancy_pin.arrays import Array, Frozen, each
from redundancy_pin.errors import InputError
from redundancy_pin.status import UpdateStatus
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.trajectory.time_scaling import TimeScaling

Goal = Literal["effort", "peak"]


def extended(position: PiecewisePolynomial, times: Array) -> tuple[Array, Array, Array]:
    """Return s, ṡ, s̈ (N, k) of a plan at (N,) times; constant after its end."""
    edges = position.edges
    piece = np.clip(np.searchsorted(edges, times, side="right") - 1, 0, len(edges) - 2)
    after = (np.clip(times, edges[0], edges[-1]) - edges[piece])[:, None]
    s, *lower = position.coefficients[:, piece]
    sd = half = np.zeros_like(s)
    for coefficient in lower:  # Horner's rule, for the derivatives too
        half, sd, s = half * after + sd, sd * after + s, s * after + coefficient
    moving = (times <= edges[-1])[:, None]
    return s, sd * moving, 2.0 * half * moving


@dataclass(frozen=True)
class Weights:
    """Weights of the squares that a programme minimises, each over the size of its quantity.

    Attributes:
        effort: mean square of τ over the horizon, over the peak of the last plan.
        peak: its largest |τ|.
        memory: share of the largest |τ| so far up to which that costs nothing.
        acceleration: mean square of s̈, over its limit: without it the motion between the nodes swings.
        jerk: of s⃛, over that which reaches this limit in a step.
        centre: of s, over half the track: room for what comes after the horizon.
        end, end_speed: of s and ṡ at the last node whose motion is known; nodes behind it are there for limits alone.
        missing: of what an elastic programme leaves out of W τ = f.
    """

    effort: float = 0.1
    peak: float = 2.0
    memory: float = 0.9
    acceleration: float = 0.1
    jerk: float = 0.3
    centre: float = 1.0
    end: float = 1.0
    end_speed: float = 1.0
    missing: float = 1e4

    def __post_init__(self) -> None:
        for field in fields(self):
            weight = each(getattr(self, field.name), field.name, (1,), finite=True)[0]
            if weight < 0.0:
                raise InputError(f"{field.name} weighs {weight:g}.", remedy="Pass a weight of zero or more.")
        if self.missing == 0.0:  # relaxed programmes would have no dynamics
            raise InputError("missing weighs 0.", remedy="Pass a positive weight; the default is 1e4.")


GOALS = {"peak": Weights(), "effort": Weights(effort=1.0, peak=0.0)}
"""By the names of ``plan_whole_trajectory``."""


@dataclass(frozen=True, eq=False)
class Command(Frozen):
    """Motion of the carriers and efforts of the main actuators from a control update on. m main actuators, k carriers.

    Attributes:
        t: time of the control update, s.
        status: result of the control update.
        reason: explanation, if ``status`` is not ``OK``.
        carriers: positions (k,), m, as functions of time to the end of the horizon; s̈ is linear between nodes.
        efforts: main efforts (m,) as functions of time, N or N·m: for three steps the solution of W τ = f nearest to
            the planned ones, which follow; within their limits.
        forces: actuator forces of the carriers (k,), N, for these three steps.
        residual: largest |W τ − f| of the planned efforts at the first nodes, N, rotations over the characteristic
            length: the imbalance of a relaxed plan, otherwise the error that the next control update corrects.
        peak: largest |τ| of the plan at its nodes, N or N·m.
        singular: (r,) singular instants ahead, s.
        known_until: until when the plan has the platform's motion, s.
        seconds: time taken, s.
        scaling: which time of the preview the platform is at, where a planner that may slow down has done so; None
            where that is the clock's.
    """

    t: float
    status: UpdateStatus
    reason: str
    carriers: PiecewisePolynomial
    efforts: PiecewisePolynomial
    forces: PiecewisePolynomial
    residual: float
    peak: float
    singular: Array
    known_until: float
    seconds: float
    scaling: TimeScaling | None = None

    def __repr__(self) -> str:
        """Return a short text that identifies the command, without its coefficients."""
        ahead = f"{len(self.singular)} singular ahead, known until {self.known_until:g} s"
        return (
            f"Command(t={self.t:g} s, {self.status.value}; peak {self.peak:.4g}, residual {self.residual:.1e}; {ahead})"
        )

    def motion_at(self, t: float) -> tuple[Array, Array, Array]:
        """Return s, ṡ, s̈ (k,) at a time, m, m/s, m/s²; constant after the end of the plan.

        Raises:
            InputError: not one finite time.
        """
        s, sd, sdd = extended(self.carriers, each(t, "t", (1,), finite=True))
        return s[0], sd[0], sdd[0]

    @property
    def sdd(self) -> Array:
        """(k,) acceleration of the carriers at the control update, m/s²."""
        return self.motion_at(self.t)[2]

    @property
    def tau(self) -> Array:
        """(m,) main efforts at the control update, N or N·m."""
        return self.efforts.at(self.t)


@dataclass(frozen=True, eq=False)
class UpdatePlan:
    """The plan of an update at its N nodes; n coordinates, k carriers.

    ``nodes`` (N,) s; ``at``: s, ṡ and s̈ (N, k) there; ``multipliers`` (N, n) of W τ = f there; ``left``: by which
    fraction of f that is missed at most; ``largest``: |τ| of the command in the step from the update on, N or N·m;
    ``rounds``: programmes that led to it, each about the plan of the one before; ``iterations``: of the interior point
    method in this update, of other motions that were tried too;
    ``tau`` N or N·m, and ``row`` (n,) N or N·m: what efforts and rows are divided by; ``so_far``: largest |τ| of this
    and all plans before, N or N·m.
    """

    command: Command
    nodes: Array
    at: tuple[Array, ...]
    multipliers: Array
    left: float
    largest: float
    iterations: int
    rounds: int
    tau: float
    row: Array
    so_far: float
