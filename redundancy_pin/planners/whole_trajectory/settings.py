"""The settings of the whole-trajectory planner, checked."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, frozen, positive
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.planners.stepwise.settings import StepLimits, require_inside, resolve_limits, typed
from redundancy_pin.robot import CarrierLimits, Robot

Objective = Literal["effort", "peak", "tracking", "carrier_force", "carrier_acceleration", "effort_rate", "energy"]
"""What a plan minimises.

effort: ∫ Σ τ² dt; peak: the largest |τ|; tracking: ∫ Σ (τ − λ τ̂)² dt; carrier_force: ∫ Σ F² dt of the carriers'
actuators; carrier_acceleration: ∫ Σ s̈² dt; effort_rate: ∫ Σ τ̇² dt, jumps of the reference left out; energy:
∫ Σ |τ q̇| + Σ |F ṡ| dt, what motors that cannot recover energy draw.
"""

End = Literal["free", "rest", "datum", "periodic"]
"""How the carriers end: anyhow; at rest; at rest where they park; or as they began (s, ṡ and s̈)."""


@dataclass(frozen=True, eq=False)
class WholeSettings:
    """Settings of ``plan_whole_trajectory``; see there.

    Attributes:
        objective: weight of each objective that has one.
        lam: fraction of the baseline effort that "tracking" aims at.
        limits: (k,) limits of the carriers.
        jerk: (k,) largest |s⃛|, m/s³.
        effort: (m,) largest |τ|, N or N·m.
        start, start_speed: (k,) state of the carriers at the start, m and m/s.
        end: how they end.
        datum: (k,) where they park, m.
        dt: largest step between nodes, s.
        starts: number of first guesses.
        seconds: time bound of one solution, s.
        refinements: how often the grid is refined where the efforts between nodes exceed those at the nodes.
    """

    objective: Mapping[Objective, float]
    lam: float
    limits: tuple[CarrierLimits, ...]
    jerk: Array
    effort: Array
    start: Array
    start_speed: Array
    end: End
    datum: Array
    dt: float
    starts: int
    seconds: float
    refinements: int

    @property
    def parameters(self) -> dict[str, object]:
        """The settings as plain data, for the plan."""
        return {
            "objective": dict(self.objective),
            "lam": self.lam,
            "track": [(limit.lower, limit.upper) for limit in self.limits],
            "speed": [limit.speed for limit in self.limits],
            "acceleration": [limit.acceleration for limit in self.limits],
            "carrier_force": [limit.force for limit in self.limits],
            "jerk": self.jerk.tolist(),
            "effort": self.effort.tolist(),
            "start": self.start.tolist(),
            "start_speed": self.start_speed.tolist(),
            "end": self.end,
            "datum": self.datum.tolist(),
            "dt": self.dt,
            "starts": self.starts,
            "seconds": self.seconds,
            "refinements": self.refinements,
        }


def checked_settings(
    robot: Robot,
    *,
    objective: Objective | Mapping[Objective, float],
    lam: float,
    baseline: bool,
    start: ArrayLike | None,
    start_speed: ArrayLike,
    end: End,
    datum: ArrayLike,
    track: ArrayLike | None,
    speed: ArrayLike | None,
    acceleration: ArrayLike | None,
    jerk: ArrayLike | None,
    effort: ArrayLike | None,
    carrier_force: ArrayLike | None,
    dt: float,
    starts: int,
    seconds: float,
    refinements: int,
) -> WholeSettings:
    """Return the settings after checking every one.

    Raises:
        InputError: a setting out of its domain; names it.
        UnsupportedRobotError: no carriers.
        InfeasiblePlanError: a start or datum off the track.
    """
    if robot.k == 0:
        raise UnsupportedRobotError(
            f"{robot.name} has no carriers to plan for.", remedy="Load it with carriers, or declare some."
        )
    if end not in get_args(End):
        raise InputError(f"end is {end!r}.", remedy=f"Use one of {', '.join(get_args(End))}.", end=end)
    weights = _weights(objective)
    if not (isinstance(lam, (int, float)) and 0.0 <= lam <= 1.0):
        raise InputError(f"lam is {lam}, expected a number in [0, 1].", lam=lam)
    if "tracking" in weights and lam > 0.0 and not baseline:
        raise InputError(
            f"lam = {lam:g} asks for a fraction of the baseline effort, and there is no baseline.",
            remedy='Pass baseline=RneaDynamics(load_robot("3rrr", carriers=False)).',
        )
    limits = resolve_limits(robot, speed, acceleration, track)
    if carrier_force is not None:
        bound = _bounds(carrier_force, "carrier_force", robot.k)
        limits = tuple(replace(limit, force=float(value)) for limit, value in zip(limits, bound, strict=True))
    on_track = StepLimits(robot.carriers, limits, anticipate=False, rest_at=math.inf)
    place = frozen(require_inside(datum, "datum", on_track))
    for name, value, least in (("starts", starts, 1), ("refinements", refinements, 0)):
        if not _is_whole(value) or value < least:
            raise InputError(f"{name} is {value}, expected a whole number from {least} up.", name=name, value=value)
    return WholeSettings(
        objective=weights,
        lam=float(lam),
        limits=limits,
        jerk=_bounds(math.inf if jerk is None else jerk, "jerk", robot.k),
        effort=_bounds(math.inf if effort is None else effort, "effort", robot.m),
        start=place if start is None else frozen(require_inside(start, "start", on_track)),
        start_speed=_vector(start_speed, "start_speed", robot.k),
        end=end,
        datum=place,
        dt=positive(dt, "dt", "s"),
        starts=int(starts),
        seconds=positive(seconds, "seconds", "s"),
        refinements=int(refinements),
    )


def _is_whole(value: object) -> bool:
    return isinstance(value, (int, float, np.integer)) and math.isfinite(value) and int(value) == value


def _weights(objective: Objective | Mapping[Objective, float]) -> dict[Objective, float]:
    allowed = get_args(Objective)
    if not isinstance(objective, (str, Mapping)):
        raise InputError(
            f"objective is {objective!r}.", remedy=f"Use {', '.join(allowed)}, or weights of them.", objective=objective
        )
    given: dict[Objective, float] = {objective: 1.0} if isinstance(objective, str) else dict(objective)
    for name, weight in given.items():
        if name not in allowed:
            raise InputError(
                f"objective is {name!r}.", remedy=f"Use {', '.join(allowed)}, or weights of them.", objective=name
            )
        if not (isinstance(weight, (int, float)) and math.isfinite(weight) and weight >= 0.0):
            raise InputError(f"The weight of {name} is {weight!r}.", remedy="Weights are positive.", weight=weight)
    kept = {name: float(weight) for name, weight in given.items() if weight > 0.0}
    if not kept:
        raise InputError("Nothing to minimise: every weight is zero.", remedy="Give one objective a weight.")
    return kept


def _bounds(values: ArrayLike, name: str, length: int) -> Array:
    bounds = _vector(values, name, length, finite=False)
    if not (bounds > 0.0).all():
        raise InputError(
            f"{name} is {typed(values)}, but limits must be positive.", remedy="Pass inf for none.", name=name
        )
    return bounds


def _vector(values: ArrayLike, name: str, length: int, *, finite: bool = True) -> Array:
    try:
        vector = np.broadcast_to(np.asarray(values, dtype=float), (length,))
    except (TypeError, ValueError) as error:
        raise InputError(f"{name} is {typed(values)!r}, expected {length} numbers or one.", name=name) from error
    if np.isnan(vector).any() or (finite and not np.isfinite(vector).all()):
        raise InputError(f"{name} is {typed(values)!r}, expected finite numbers.", name=name)
    return frozen(vector)
