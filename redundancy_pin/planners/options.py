"""Options of the planners, in groups: limits, objective, nodes, and solver.

A planner accepts the groups that apply to it. It uses every field that is given, or raises an
``InputError`` with the reason why it cannot; no field is ignored silently.
"""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields
from types import MappingProxyType
from typing import Any, Literal, ParamSpec, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from redundancy_pin.arrays import (
    Array,
    ByValue,
    assign,
    detached,
    each,
    fraction,
    frozen,
    positive,
    require_type,
    whole,
)
from redundancy_pin.dynamics.default import DynamicsLike
from redundancy_pin.errors import InputError, did_you_mean, shown
from redundancy_pin.planners.base_wrench import point_of
from redundancy_pin.planners.limits import QUANTITIES, ResolvedLimits
from redundancy_pin.robot import Robot

CALM = 0.01
"""Fraction of the least cost at the nodes that a plan may cost more there to have fewer reversals, unless the user asks
for another."""

LARGEST_STEP = 0.005
"""Default of the largest step between the nodes of a plan over a given time, s."""

FEWEST_STEPS = 100
"""Default of the least number of steps along a path whose timing is planned."""

# Each start is solved, and each refinement doubles nodes: more of them would never end
MOST_STARTS, MOST_REFINEMENTS, MOST_STEPS = 1000, 30, 100_000

Progress = Callable[[str], None]
"""Called with a line of text at each stage of a plan; an exception from it ends the planning."""


@dataclass(frozen=True, eq=False)
class Limits(ByValue):
    """Limits of a plan; None takes the robot's declared limit, ``numpy.inf`` removes a limit.

    Example:
        >>> rp.Limits(effort=2.5, track=(-0.16, 0.16)).resolved(rp.load_robot("2rpr")).effort
        array([2.5, 2.5])

    Attributes:
        track: (2,) or (k, 2) track ends of the carriers, m.
        speed: scalar or (k,) largest speed |ṡ| of the carriers, m/s.
        acceleration: scalar or (k,) largest acceleration |s̈| of the carriers, m/s².
        jerk: scalar or (k,) largest jerk |s⃛| of the carriers, m/s³; with it s̈ cannot jump. No robot declares any.
        carrier_force: scalar or (k,) largest force of the carriers' actuators, N.
        effort: scalar or (m,) largest |τ| of the main actuators, N or N·m.
        actuator_speed: scalar or (m,) largest rate of the main actuators, m/s or rad/s.
        further: largest absolute values of other quantities, by their key in ``planners.limits.QUANTITIES``.
    """

    track: ArrayLike | None = None
    speed: ArrayLike | None = None
    acceleration: ArrayLike | None = None
    jerk: ArrayLike | None = None
    carrier_force: ArrayLike | None = None
    effort: ArrayLike | None = None
    actuator_speed: ArrayLike | None = None
    further: Mapping[str, ArrayLike] | None = None

    def __post_init__(self) -> None:
        """Copy the arrays."""
        assign(self, **{field.name: detached(getattr(self, field.name)) for field in fields(self)})

    def resolved(self, robot: Robot) -> ResolvedLimits:
        """Return them as arrays, with the robot's own by default.

        Raises:
            InputError: a limit that is not positive, a track whose ends are not in order, wrong shapes; no limit of
                efforts, where the robot declares one that is not the same both ways.
        """
        own, k = robot.carrier_limits, robot.k
        track = np.array([(limit.lower, limit.upper) for limit in own]).reshape(k, 2)
        if self.track is not None:
            track = np.array(each(self.track, "track", (k, 2)))
            if not (track[:, 0] < track[:, 1]).all():
                raise InputError(
                    f"track is {shown(np.asarray(self.track).tolist())}, but the ends of a track must increase.",
                    remedy="Give the lower end first.",
                    name="track",
                    value=self.track,
                )
        bounds: dict[str, Any] = {
            "speed": [limit.speed for limit in own],
            "acceleration": [limit.acceleration for limit in own],
            "carrier_force": [limit.force for limit in own],
            "jerk": [np.inf] * k,
            "effort": _declared_efforts(robot).tolist() if self.effort is None else [np.inf] * robot.m,
            "actuator_speed": robot.speed_limits.tolist(),
        }
        for name, given in ((name, getattr(self, name)) for name in bounds):
            if given is not None:
                bounds[name] = each(given, name, (len(bounds[name]),), above_zero=True).tolist()
        arrays = {name: frozen(values) for name, values in bounds.items()}
        further = self._further(robot.m, k)
        return ResolvedLimits(robot.carriers, frozen(track), **arrays, further=further)

    def _further(self, m: int, k: int) -> Mapping[str, Array]:
        """Return the limits of further quantities, one number for each of m main actuators or k carriers."""
        given = {} if self.further is None else self.further
        require_type(given, Mapping, "A mapping of quantities to limits", 'Pass further={"power": 20.0}.')
        known = sorted(QUANTITIES.keys() - {field.name for field in fields(self)})
        for key in given:
            if key not in known:
                remedy = "Add an entry to planners.limits.QUANTITIES. "
                remedy += f"Entries are {', '.join(known)}." if known else "No further quantities are defined."
                raise InputError(f"further limits {shown(key)}, which is no quantity.", remedy=remedy, name=key)
            name = QUANTITIES[key].name
            if [one.name for one in QUANTITIES.values() if one is not QUANTITIES["actuator_speed"]].count(name) > 1:
                message = f"The quantity {shown(key)} has the name of another one, {shown(name)}."
                raise InputError(message, remedy="Give its entry of planners.limits.QUANTITIES another name.", name=key)
        sizes = {key: m if QUANTITIES[key].owner == "actuated" else k for key in given}
        return MappingProxyType(
            {key: frozen(each(limit, key, (sizes[key],), above_zero=True)) for key, limit in given.items()}
        )


def _declared_efforts(robot: Robot) -> Array:
    """Return (m,) the largest |τ| that a robot declares, N or N·m."""
    for name, (least, most) in zip(robot.actuated, robot.effort_limits.T.tolist(), strict=True):
        if least != -most:
            raise InputError(
                f"The robot declares efforts of {name} from {least:g} to {most:g}; the limit of a plan counts both "
                "ways.",
                remedy="Pass the largest |τ| in limits=Limits(effort=...), one number or one for each actuator.",
                name="effort",
            )
    largest: Array = robot.effort_limits[1]
    return largest


@dataclass(frozen=True, eq=False)
class Objective(ByValue):
    """What a plan minimises.

    Example:
        >>> line = rp.trajectory.reference.line(speed=0.2)
        >>> least = rp.Objective("peak", calm=0.0)
        >>> rp.plan_whole_trajectory("2rpr", line, objective=least, mesh=rp.Mesh(dt=0.05)).status.value
        'ok'

    Attributes:
        weights: what to minimise: a name of ``OBJECTIVES``, or weights of several, each in its own unit. When left out:
            "tracking" with ``lam`` or ``baseline``, else "effort".
        lam: λ of "tracking", 0 to 1.
        baseline: the robot whose efforts are τ̂, or its name or path; or a backend of it. For the stepwise planner also
            efforts (N, m), N or N·m, at the samples of the motion.
        base_point: (3,) point about which the moment on the base is taken, m; the world origin when left out.
        calm: fraction of the least cost, at the nodes, that may be spent on fewer reversals of the efforts; 0 for none,
            0.01 when left out.
    """

    weights: str | Mapping[str, float] | None = None
    lam: float = 0.0
    baseline: DynamicsLike | ArrayLike | None = None
    base_point: ArrayLike | None = None
    calm: float | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InputError: λ or ``calm`` not from 0 to 1, a point that is not one, a baseline without "tracking".
        """
        assign(self, lam=fraction(self.lam, "lam"))
        aims = self.lam > 0.0 or self.baseline is not None
        if self.weights is None:
            assign(self, weights="tracking" if aims else "effort")
        point_of(self.base_point)
        assign(self, **{name: detached(getattr(self, name)) for name in ("weights", "baseline", "base_point")})
        if self.calm is not None:
            assign(self, calm=fraction(self.calm, "calm"))
        named = [self.weights] if isinstance(self.weights, str) else self.weights
        if aims and isinstance(named, (list, tuple, Mapping)) and "tracking" not in named:
            raise InputError(
                "lam and baseline define the tracked efforts, but the objective does not have tracking.",
                remedy="Leave them out, or add tracking to the objective.",
                name="lam",
            )

    @classmethod
    def of(cls, objective: str | Mapping[str, float] | Objective) -> Objective:
        """Return the objective that a name or weights stand for."""
        require_type(
            objective, (str, Mapping, Objective), "An objective", "Pass a name, weights by name, or Objective."
        )
        return objective if isinstance(objective, Objective) else cls(objective)


@dataclass(frozen=True)
class Mesh:
    """The nodes of a plan, or its samples.

    Attributes:
        dt: largest step between nodes in time, or between samples, s; when left out 0.005, or the planner's default.
        refinements: how often the mesh may be refined where efforts between the nodes exceed those at the nodes.
        steps: least number of steps along a path whose timing is planned; 100 when left out.

    Example:
        >>> rp.Mesh(dt=0.01, refinements=1).dt
        0.01
    """

    dt: float | None = None
    refinements: int = 3
    steps: int | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InputError: a step that is not positive, numbers that are not whole or too large.
        """
        if self.dt is not None:
            assign(self, dt=positive(self.dt, "dt", "s"))
        if self.steps is not None:
            assign(self, steps=whole(self.steps, "steps", 4, MOST_STEPS))
        assign(self, refinements=whole(self.refinements, "refinements", 0, MOST_REFINEMENTS))


@dataclass(frozen=True)
class Solver:
    """How long and from where the solver works.

    Attributes:
        starts: number of first guesses; the first is parked carriers, the others are random swings (seeded).
        seconds: time bound of the search, s, for all first guesses, meshes and the explanation of infeasibility. The
            plan is the best one found by then.
        progress: called with a line of text at each stage, and during it where the plan has 1000 nodes or more. What it
            raises ends the planning.

    Example:
        >>> rp.Solver(starts=4, seconds=60.0).starts
        4
    """

    starts: int = 1
    seconds: float = 60.0
    progress: Progress | None = None

    def __post_init__(self) -> None:
        """Check the numbers.

        Raises:
            InputError: a number of starts that is not whole or too large, a time that is not positive.
        """
        assign(self, starts=whole(self.starts, "starts", 1, MOST_STARTS))
        assign(self, seconds=positive(self.seconds, "seconds", "s"))


GROUPS: Mapping[str, type] = {"objective": Objective, "limits": Limits, "mesh": Mesh, "solver": Solver}
"""Groups of options, by the keyword of a planner that takes one."""

Parameters = ParamSpec("Parameters")
Planned = TypeVar("Planned")


def takes_groups(
    refused: Mapping[str, str],
) -> Callable[[Callable[Parameters, Planned]], Callable[Parameters, Planned]]:
    """Return a decorator that names the group of a field when a planner gets the field as a keyword.

    Args:
        refused: fields that the planner takes in no group, as for ``refuse_fields``.

    Raises:
        InputError: a keyword that the planner does not take.
    """

    def decorate(planner: Callable[Parameters, Planned]) -> Callable[Parameters, Planned]:
        taken = inspect.signature(planner).parameters

        @functools.wraps(planner)
        def call(*args: Parameters.args, **keywords: Parameters.kwargs) -> Planned:
            for name in keywords.keys() - taken.keys():
                remedy, who = _where(name, taken, refused), planner.__qualname__.removesuffix(".__init__")
                raise InputError(f"{who} has no keyword {shown(name)}.", remedy=remedy, name=name)
            return planner(*args, **keywords)

        call.__dict__["refused"] = refused  # for who lists the options of a planner
        return call

    return decorate


def _where(name: str, taken: Mapping[str, object], refused: Mapping[str, str]) -> str:
    for group in GROUPS.keys() & taken.keys() if name not in refused else ():
        kind = GROUPS[group]
        if name in (field.name for field in fields(kind)):
            return f"Pass {group}={kind.__name__}({name}=...)."
    known = [key for key in taken if key not in ("self", "dynamics", "motion", "path")]
    return f"{did_you_mean(name, known)}Keywords are {', '.join(known)}."


Group = TypeVar("Group", bound=Any)


def group_of(given: Group | None, kind: type[Group]) -> Group:
    """Return a group of options after checking its type; its defaults for None."""
    if given is None:
        made: Group = kind()
        return made
    name, own = kind.__name__, ", ".join(f"{field.name}=..." for field in fields(kind))
    require_type(given, kind, f"{name} for {name.lower()}=", f"Pass {name.lower()}={name}({own}).")
    return given


def refuse_fields(refused: Mapping[str, str], *groups: Any) -> None:
    """Check that groups of options leave fields at their defaults that a planner does not take.

    ``refused``: by field, why the planner does not.

    Raises:
        InputError: one of them is given.
    """
    for group in groups:
        for field in (own for own in fields(group) if own.name in refused):
            value = getattr(group, field.name)
            if value is not field.default and not (np.isscalar(value) and value == field.default):
                raise InputError(
                    f"{field.name} does not apply: {refused[field.name]}.", remedy="Leave it out.", name=field.name
                )


NO_NODES = dict.fromkeys(("refinements", "steps"), "the plan has samples a step apart, and nothing is refined")
"""Fields of ``Mesh`` that planners without an optimisation over nodes do not take."""


def return_duration(value: float | Literal["shortest"], name: str) -> float | Literal["shortest"]:
    """Return how long the carriers' return takes, s, or "shortest", after checking it."""
    if value == "shortest":
        return "shortest"
    if isinstance(value, str):
        raise InputError(f"{name} is {shown(value)}.", remedy="Pass a duration in seconds or 'shortest'.", name=name)
    return positive(value, name, "s")
