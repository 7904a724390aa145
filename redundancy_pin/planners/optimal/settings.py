"""Options of the planners over a whole path, checked for a robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, get_args

from numpy.typing import ArrayLike

from redundancy_pin.arrays import Array, each, frozen, one_of, positive, require_type
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.dynamics.default import as_dynamics
from redundancy_pin.planners.base_wrench import point_of, weights_of
from redundancy_pin.planners.limits import ResolvedLimits
from redundancy_pin.planners.optimal.objectives import OBJECTIVES
from redundancy_pin.planners.options import (
    CALM,
    FEWEST_STEPS,
    LARGEST_STEP,
    Limits,
    Mesh,
    Objective,
    Solver,
    group_of,
    refuse_fields,
)
from redundancy_pin.robot import Robot

Begin = Literal["datum", "rest", "free"]
"""How the carriers begin: at given positions and speeds; at rest at any position; or in any state."""

End = Literal["free", "rest", "datum", "periodic"]
"""How the carriers end: anyhow; at rest; at rest where they park; or as they began (s, ṡ and s̈)."""


REFUSED = {"steps": "the nodes are in time, and dt is their largest distance"}
"""Fields of groups that a plan over a given time does not take, and why."""

REFUSED_ON_A_PATH = {
    "dt": "the timing is planned, and steps is the least number of steps along the path",
    "starts": "there is one first guess, a harmonic motion along the path",
}
"""The same of a plan whose timing is planned."""


@dataclass(frozen=True, eq=False)
class Settings:
    """Checked options of a plan over a whole path: weights by name, one number a carrier or actuator.

    ``dt``: largest step between the first nodes, s; in a path whose timing is planned, m. For a path, ``begin`` is the
    carriers' initial condition, and with ``lap`` the platform ends with its initial speed; only time is minimised.
    """

    limits: ResolvedLimits
    start: Array
    start_speed: Array
    end: End
    datum: Array
    dt: float
    refinements: int
    solver: Solver
    objective: Mapping[str, float] = field(default_factory=dict)
    at_most: Mapping[str, float] = field(default_factory=dict)
    lam: float = 0.0
    baseline: Dynamics | None = None
    base_point: Array = field(default_factory=lambda: point_of(None))
    calm: float = 0.0
    begin: Begin = "datum"
    lap: bool = False

    def weighted(self, values: Mapping[str, float]) -> float:
        """Return the weighted sum of the objectives, of values by name."""
        return sum(weight * values[name] for name, weight in self.objective.items())

    @property
    def parameters(self) -> dict[str, object]:
        """The settings as plain data, for the plan."""
        return {
            "objective": dict(self.objective),
            **({"at_most": dict(self.at_most)} if self.at_most else {}),
            "lam": self.lam,
            "calm": self.calm,
            **{name: getattr(self, name).tolist() for name in ("start", "start_speed", "datum", "base_point")},
            **{name: getattr(self.solver, name) for name in ("starts", "seconds")},
            "end": self.end,
            "dt": self.dt,
            "refinements": self.refinements,
        }


def checked_settings(
    robot: Robot,
    objective: str | Mapping[str, float] | Objective = "effort",
    limits: Limits | None = None,
    mesh: Mesh | None = None,
    solver: Solver | None = None,
    start: ArrayLike | None = None,
    start_speed: ArrayLike = 0.0,
    begin: Begin = "datum",
    end: End = "datum",
    datum: ArrayLike = 0.0,
    at_most: Mapping[str, float] | None = None,
    lap: bool = False,
    length: float | None = None,
) -> Settings:
    """Return the settings of a plan after checking every option, as the planners take it.

    ``length``: of a path whose timing is planned, m; then nothing but the time is minimised.

    Raises:
        InputError: an option out of its domain, or one that does not apply.
    """
    one_of(begin, "begin", get_args(Begin))
    one_of(end, "end", get_args(End))
    goal, mesh, solver = Objective.of(objective), group_of(mesh, Mesh), group_of(solver, Solver)
    refuse_fields(REFUSED if length is None else REFUSED_ON_A_PATH, mesh, solver)
    weights = weights_of(goal.weights or {}, OBJECTIVES)
    dt = LARGEST_STEP if mesh.dt is None else mesh.dt
    if length is not None:
        weights, dt = {}, length / (FEWEST_STEPS if mesh.steps is None else mesh.steps)
    resolved = group_of(limits, Limits).resolved(robot)
    park = resolved.on_track(datum, "datum")
    return Settings(
        objective=weights,
        lam=goal.lam,
        baseline=None if goal.baseline is None else as_dynamics(goal.baseline),  # type: ignore[arg-type]  # which refuses efforts
        base_point=point_of(goal.base_point),
        calm=CALM if goal.calm is None else goal.calm,
        limits=resolved,
        start=park if start is None else resolved.on_track(start, "start"),
        start_speed=frozen(each(start_speed, "start_speed", (robot.k,), finite=True)),
        begin=begin,
        end=end,
        datum=park,
        dt=dt,
        refinements=mesh.refinements,
        solver=solver,
        at_most=_bounds(at_most or {}),
        lap=lap,
    )


def _bounds(at_most: Mapping[str, float]) -> dict[str, float]:
    require_type(at_most, Mapping, "A mapping of objectives to bounds", 'Pass at_most={"carrier_force": 60.0}.')
    for name, bound in at_most.items():
        one_of(name, "at_most", tuple(OBJECTIVES))
        positive(bound, f"at_most of {name}", "")
    return {name: float(bound) for name, bound in at_most.items()}
