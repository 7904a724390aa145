"""What to plan, from flags or from a problem file: a robot, a motion, a planner and its keywords."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

from pydantic import AfterValidator, Field

from redundancy_pin.cli import options
from redundancy_pin.dynamics.backends import BACKENDS
from redundancy_pin.dynamics.base import Dynamics
from redundancy_pin.errors import InfeasiblePlanError, InputError, RedundancyPinError
from redundancy_pin.io.schema import Schema, validated
from redundancy_pin.io.yaml_file import YamlFile, read_yaml
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.registry import PLANNERS, TIME_OPTIMAL, in_groups
from redundancy_pin.robot.shipped import source_in
from redundancy_pin.trajectory import Trajectory
from redundancy_pin.trajectory.trajectory import Ends


@dataclass(frozen=True, eq=False)
class PlanProblem:
    """Everything a planner needs; ``parameters`` are its keywords, fields of its groups of options among them.

    ``followed`` says what the motion is; ``placed`` lets errors begin with the place of their key in a problem file.
    """

    planner: str
    dynamics: Dynamics
    motion: PlatformMotion | Trajectory
    parameters: Mapping[str, Any]
    followed: str
    placed: Callable[[], AbstractContextManager[None]] = nullcontext

    @property
    def ends(self) -> Ends | None:
        """How a motion through points starts and ends; None where the path alone counts, or for other motions."""
        return None if self.planner == TIME_OPTIMAL else getattr(self.motion, "ends", None)

    def solve(self, progress: Callable[[str], None] | None = None) -> Plan:
        """Return the plan; planners that have stages call ``progress`` with a line of text at each."""
        make = PLANNERS[self.planner]
        extra = {"progress": progress} if progress and "solver" in inspect.signature(make).parameters else {}
        with self.placed():
            return make(self.dynamics, self.motion, **in_groups(make, {**self.parameters, **extra}))


def _setting(value: object) -> object:
    if not isinstance(value, (bool, int, float, str)):
        raise ValueError("a number, true, false or text")
    return value


_Settings = dict[str, Annotated[Any, AfterValidator(_setting)]]


def _named_motion(value: object) -> object:
    if not isinstance(value, (str, dict, type(None))):
        raise ValueError("a trajectory or a file: {name: circle, speed: 0.6}, or motion.csv")
    return value


class RobotKeys(Schema):
    """Keys that say which robot; as the flags of the same names."""

    robot: str | None = Field(None, description="the name or the path of a robot")
    set: _Settings = Field({}, description="a mapping of parameters of the robot")
    working_mode: str | None = Field(None, description="text, a sign per leg: '+-+'")
    gravity: Any = None

    def chosen(self, folder: Path, *, trust: bool) -> options.RobotOptions:
        """Return the robot, whose path is seen from a folder."""
        return options.RobotOptions(
            source_in(folder, str(self.robot)),
            dict(
                options.parse_setting(f"{name}={value}") for name, value in self.set.items()
            ),  # YAML reads 1e-3 as text
            None if self.working_mode is None else options.parse_mode("working_mode", self.working_mode),
            None if self.gravity is None else options.parse_vector("gravity", self.gravity),
            trust,
        )


class ProblemFile(RobotKeys):
    """The keys of a problem file."""

    planner: str = Field(description=f"one of {', '.join(PLANNERS)}")
    robot: str = Field(description="the name or the path of a robot")
    backend: str | None = Field(None, description=f"one of {', '.join(BACKENDS)}")
    motion: Annotated[Any, AfterValidator(_named_motion)] = None
    check_rates: bool = Field(True, strict=True, description="true or false")
    parameters: dict[str, Any] = Field({}, description="a mapping of keywords of the planner")
    baseline: RobotKeys | None = Field(None, description="a mapping of robot, set, working_mode, gravity")


def read_problem(path: str | Path, *, trust: bool = False) -> PlanProblem:
    """Read a problem file.

    Robots and motions given by path are looked for from the folder of the file. ``trust``, as for ``load_robot``, is
    said by who reads it, not by the file.

    Raises:
        RedundancyPinError: its message begins with the file and the line it is about.
    """
    file, folder = read_yaml(path, InputError, "The problem "), Path(path).parent
    if not isinstance(file.data, Mapping):
        keys = ", ".join(ProblemFile.model_fields)
        raise InputError(f"{path} holds no mapping of keys.", remedy=f"Its keys: {keys}.", path=str(path))
    with file.naming():
        data = validated(ProblemFile, file.data, of="problem")
    with _placed(file, ""):
        planner = options.require_choice(data.planner, tuple(PLANNERS), "the planner")
        if data.backend is not None:
            options.require_choice(data.backend, tuple(BACKENDS), "the backend")
    with _placed(file, "set.", ""):
        robot = data.chosen(folder, trust=trust).load()
    with _placed(file, "motion.", ""):
        chosen = _motion(data, folder)
        motion = chosen.follow("A plan", robot)
    with _placed(file, "parameters."):
        for key in data.parameters.keys() & ProblemFile.model_fields.keys():
            message = f"{key} is no keyword of a planner, but a key of the problem."
            raise InputError(message, remedy="Write it beside `parameters`.", key=key)
        parameters = options.read_keywords(PLANNERS[planner], data.parameters, f"the planner {planner}")
    if data.baseline is not None:
        with _placed(file, "baseline.", "baseline.set.", "set.", ""):
            baseline = _baseline(data, data.baseline).chosen(folder, trust=trust)
            parameters["baseline"] = options.dynamics_of(baseline.load(), data.backend)
    placed = partial(_placed, file, "", "parameters.")
    dynamics = options.dynamics_of(robot, data.backend)
    return PlanProblem(planner, dynamics, motion, parameters, chosen.described, placed)


def _motion(data: ProblemFile, folder: Path) -> options.MotionOptions:
    given, keys = data.motion, None
    if isinstance(given, dict):
        if "name" not in given:
            raise InputError("The motion lacks the key 'name'.", remedy="Write {name: circle, speed: 0.6}.")
        keys = dict(given)
        given = keys.pop("name")
    return options.MotionOptions(given, data.check_rates, keys, folder)


def _baseline(data: RobotKeys, own: RobotKeys) -> RobotKeys:
    """Return the baseline robot: the robot of the problem, with what ``baseline`` says in place of its own."""
    # another robot has other parameters and modes: nothing of the first one's is taken over
    if own.robot is not None:
        return own
    return RobotKeys(
        robot=data.robot,
        set={**data.set, **own.set},
        working_mode=data.working_mode if own.working_mode is None else own.working_mode,
        gravity=data.gravity if own.gravity is None else own.gravity,
    )


@contextmanager
def _placed(file: YamlFile, *groups: str) -> Iterator[None]:
    """Let errors of the block begin with the file, and the line of the key that they name in one of the groups."""
    try:
        yield
    except RedundancyPinError as error:
        # the robot's own files have keys of their own
        details = error.details if isinstance(error, (InputError, InfeasiblePlanError)) else {}
        key = str(next((details[word] for word in ("key", "name", "argument") if word in details), ""))
        where = file.place(next((group + key for group in groups if group + key in file.lines), groups[0] + key))
        raise type(error)(f"{where}: {error.message}", remedy=error.remedy, **error.details) from error
