"""A plan for other programs: by joint name, at a rate of their choice, as CSV, JSON, MAT, JointTrajectory or pandas.

Between its samples a plan is its functions of time, with efforts by W τ = f along them (``reference``), and not what
lines between the samples would be. Where something jumps, a table at a rate has the values after the jump, unless it is
to be two-sided: then the instant has two rows, before and after it. Without a rate the rows are the plan's own samples.
"""

from __future__ import annotations

import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, Frozen, positive, read_only, require_few
from redundancy_pin.errors import InputError, OutputError, optional
from redundancy_pin.io.files import refusing, replacing_file, write_text
from redundancy_pin.kinematics.inverse_kinematics import inverse_kinematics
from redundancy_pin.loading import RobotLike
from redundancy_pin.motion import PlatformMotion
from redundancy_pin.planners.functions import ROUNDED, unique_times
from redundancy_pin.planners.reference import plan_reference
from redundancy_pin.planners.robot_record import robot_of_record
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.trajectory.csv_file import csv_rows, heading_unit, motion_columns, unit_of
from redundancy_pin.trajectory.trajectory import MOST_SAMPLES, sample_times

if TYPE_CHECKING:
    from redundancy_pin.planners.plan import Plan

FORMAT = "redundancy_pin plan table"
"""What the JSON file and the MAT file call themselves."""

VERSION = 1
"""Of that format."""

QUANTITIES = ("position", "rate", "acceleration", "effort")
"""Columns of each joint."""


@dataclass(frozen=True, eq=False)
class PlanTable(Frozen):
    """A plan or a simulation at N instants; J joints: m main actuators, then the carriers.

    Attributes:
        t: (N,) time, s; an instant occurs twice where both sides of a jump are kept.
        joints: names of the J joints.
        main: m, how many of them are main actuators.
        joint_units: for each of ``QUANTITIES`` the units of the J joints.
        position: (N, J) m or rad.
        rate: (N, J) m/s or rad/s.
        acceleration: (N, J) m/s² or rad/s².
        effort: (N, J) what the actuators give, N or N·m; NaN at samples of a plan that has no finite efforts there.
        platform: unit and values (N,) of the independent coordinates, their rates and their accelerations, by name, as
            ``trajectory.from_csv`` reads them.
        about: which plan this is, in plain data.
    """

    t: Array
    joints: tuple[str, ...]
    main: int
    joint_units: Mapping[str, tuple[str, ...]]
    position: Array
    rate: Array
    acceleration: Array
    effort: Array
    platform: Mapping[str, tuple[str, Array]]
    about: Mapping[str, Any]

    def columns(self) -> dict[str, tuple[str, Array]]:
        """Return unit and values (N,) of each column by its name: ``t``, ``x``, ``xd``, ..., ``q:JOINT``, ....

        ``trajectory.csv_file`` defines the column names.
        """
        columns: dict[str, tuple[str, Array]] = {"t": ("s", self.t), **self.platform}
        for j, joint in enumerate(self.joints):
            symbol = "q" if j < self.main else "s"
            for name, quantity in zip((symbol, f"{symbol}d", f"{symbol}dd", "tau"), QUANTITIES, strict=True):
                columns[f"{name}:{joint}"] = (self.joint_units[quantity][j], getattr(self, quantity)[:, j])
        return columns

    def to_csv(self, path: str | Path) -> None:
        """Write CSV: a row of names with units, such as ``tau:elbow [N*m]``, then one for each instant.

        Raises:
            OutputError: the file cannot be written.
        """
        write_text(path, csv_rows(self.columns()))

    def to_json(self, path: str | Path) -> None:
        """Write one JSON object: which plan it is, ``units`` and ``columns`` by name; no finite effort is null.

        Raises:
            OutputError: the file cannot be written.
        """
        columns = self.columns()
        data = {
            **self.about,
            "joints": list(self.joints),
            "units": {name: unit for name, (unit, _) in columns.items()},
            "columns": {
                name: [value if np.isfinite(value) else None for value in values.tolist()]
                for name, (_, values) in columns.items()
            },
        }
        write_text(path, json.dumps(data, allow_nan=False) + "\n")

    def to_mat(self, path: str | Path) -> None:
        """Write a MAT file (version 5): matrices with a column for each joint, and cells with their names.

        Raises:
            OutputError: the file cannot be written.
        """
        from scipy.io import savemat

        def cells(names: tuple[str, ...]) -> Any:
            column = np.empty(len(names), dtype=object)
            column[:] = names
            return column

        data = {
            **{key: value for key, value in self.about.items() if value is not None},
            "t": self.t[:, None],
            "joints": cells(self.joints),
            **{quantity: getattr(self, quantity) for quantity in QUANTITIES},
            "units": {quantity: cells(units) for quantity, units in self.joint_units.items()},
            "coordinates": cells(tuple(self.platform)),
            "coordinate_units": cells(tuple(unit for unit, _ in self.platform.values())),
            "x": np.stack([values for _, values in self.platform.values()], axis=1),
        }
        with replacing_file(path) as temporary, refusing(path):
            savemat(temporary, data, appendmat=False)

    def to_ros(self, path: str | Path) -> None:
        """Write a message ``trajectory_msgs/JointTrajectory`` of ROS 2, YAML or JSON by the name of the file.

        Carriers are joints like the others. An instant at which something jumps has the values after the jump.

        Raises:
            InputError: efforts that are not finite.
            OutputError: another suffix, or the file cannot be written.
        """
        suffix = Path(path).suffix.lower()
        if suffix not in (".yaml", ".yml", ".json"):
            raise OutputError(
                f"{path} ends in neither .yaml nor .json.", remedy="Name it trajectory.yaml.", path=str(path)
            )
        message = joint_trajectory(self.after_jumps())
        if suffix == ".json":
            write_text(path, json.dumps(message, allow_nan=False) + "\n")
            return
        import yaml

        dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
        write_text(path, yaml.dump(message, Dumper=dumper, sort_keys=False, default_flow_style=None, width=1 << 20))

    def to_dataframe(self) -> Any:
        """Return a pandas ``DataFrame`` with t as its index; units are in ``.attrs["units"]``.

        Raises:
            RedundancyPinError: pandas is not installed.
        """
        pandas = optional("pandas", "A data frame needs", "Install it with `pip install 'redundancy_pin[pandas]'`.")
        columns = self.columns()
        values = {name: values for name, (_, values) in columns.items() if name != "t"}
        frame = pandas.DataFrame(values, index=pandas.Index(self.t, name="t"))
        frame.attrs.update(self.about, units={name: unit for name, (unit, _) in columns.items()})
        return frame

    def after_jumps(self) -> PlanTable:
        """Return the table with one row for each instant: of two rows, before and after a jump, the second."""
        kept = ~_before(self.t)
        rows: dict[str, Any] = {name: read_only(getattr(self, name)[kept]) for name in ("t", *QUANTITIES)}
        platform = {name: (unit, read_only(values[kept])) for name, (unit, values) in self.platform.items()}
        return replace(self, platform=platform, **rows)


def plan_table(
    plan: Plan, rate: float | None = None, *, two_sided: bool | None = None, robot: RobotLike | None = None
) -> PlanTable:
    """Return a plan as a table, see ``Plan.table``."""
    machine = robot_of_record(plan.robot, robot)
    if rate is None:
        parts = _at_samples(plan, machine)
    else:
        parts = _at_rate(plan, machine, positive(rate, "rate", "Hz"), two_sided is True)
    about = {
        "format": FORMAT,
        "version": VERSION,
        "robot": plan.robot.name,
        "planner": plan.planner,
        "backend": plan.backend,
        "status": plan.status.value,
        "least_cost": plan.least_cost,
        "samples_per_second": None if rate is None else float(rate),
    }
    table = table_of_states(machine, parts, about)
    return table.after_jumps() if two_sided is False else table


def table_of_states(
    machine: Robot,
    parts: _States,
    about: Mapping[str, Any],
) -> PlanTable:
    """Return a table of N states of a robot.

    Args:
        machine: the robot.
        parts: of the states.
        about: description, in plain data.
    """
    t, x, xd, xdd, q, v, a, effort = parts
    names = (*machine.actuated, *machine.carriers)
    columns = np.concatenate([machine.actuated_velocity, machine.carrier_velocity])
    platform = motion_columns(machine, PlatformMotion(t, x, xd, xdd, check_rates=False))
    return PlanTable(
        t=read_only(t),
        joints=names,
        main=machine.m,
        joint_units=_units(machine, names),
        position=read_only(np.stack([_position(machine, name, q) for name in names], axis=1)),
        rate=read_only(v[:, columns]),
        acceleration=read_only(a[:, columns]),
        effort=read_only(effort),
        platform={name: (unit, read_only(values)) for name, (unit, values) in platform.items() if name != "t"},
        about=about,
    )


_States: TypeAlias = tuple[Array, Array, Array, Array, Array, Array, Array, Array]
"""t (N,), x (N, n) or (N, 4, 4), ẋ and ẍ (N, n), q (N, nq), v and a (N, nv), and efforts (N, m + k) of states."""


def _at_samples(plan: Plan, robot: Robot) -> _States:
    """Return the samples of a plan."""
    tree, efforts = inverse_kinematics(robot, plan.motion).with_carriers(plan.carriers), [plan.tau, plan.carrier_force]
    motion = plan.motion
    return plan.t, motion.x, motion.xd, motion.xdd, tree.q, tree.v, tree.a, np.concatenate(efforts, axis=1)


def _at_rate(plan: Plan, robot: Robot, rate: float, two_sided: bool) -> _States:
    """Return the states that the functions of time of a plan have at a rate, Hz."""
    reference, functions = plan_reference(plan, robot=robot), plan.functions
    start, end = float(plan.t[0]), float(plan.t[-1])
    require_few(
        (end - start) * rate, MOST_SAMPLES, f"rate = {rate:g} Hz makes {{}} rows", "Use a lower rate.", name="rate"
    )
    slack = ROUNDED * (end - start)  # jumps of one instant, from different functions, differ by rounding
    breaks = [functions.platform.breaks, functions.carriers.derivative(2).jumps(), reference.jumps]
    inner = np.concatenate(breaks)
    jumps = unique_times(np.concatenate([[start], inner[(inner > start + slack) & (inner < end - slack)], [end]]))[1:-1]
    times = start + sample_times(end - start, jumps - start if two_sided else jumps[:0], 1.0 / rate, None, two_sided)
    times[-1] = end
    sides = _clear_of(jumps, times, slack)
    q, v, _, _ = reference.tree_and_loads(times)
    _, _, a, effort = reference.tree_and_loads(sides)
    instants, rows = np.unique(times, return_inverse=True)
    at, beside = functions.platform.sample_at(instants), functions.platform.sample_at(sides)
    return times, at.x[rows], at.xd[rows], beside.xdd, q, v, a, effort


def _clear_of(jumps: Array, times: Array, slack: float) -> Array:
    """Return (N,) times, those at a jump moved to its far side, or, if they come again, to the near one."""
    if not len(jumps):
        return times
    after = np.clip(np.searchsorted(jumps, times), 1, len(jumps) - 1) if len(jumps) > 1 else np.zeros(len(times), int)
    nearest = np.where(times - jumps[after - 1] < jumps[after] - times, jumps[after - 1], jumps[after])
    moved = nearest + np.where(_before(times), -slack, slack)
    return np.where(np.abs(times - nearest) < slack, moved, times)


def _before(times: Array) -> BoolArray:
    """Return (N,) which of increasing times come again: they are instants before a jump."""
    return np.append(times[1:] == times[:-1], False)


def _position(robot: Robot, name: str, q: Array) -> Array:
    """Return (N,) the position of a joint of one freedom, m or rad."""
    position = robot.joint_positions(q, [name])[:, 0]
    continuous = find_joint(robot.model, name).nq == 2
    return np.unwrap(position) if continuous else position


def _units(robot: Robot, names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return the units of the joints, as in CSV files."""
    motion = {
        quantity: tuple(unit_of(robot, f"q:{name}", order) for name in names)
        for order, quantity in enumerate(QUANTITIES[:3])
    }
    return {**motion, "effort": tuple(heading_unit(robot, name) for name in names)}


def joint_trajectory(table: PlanTable) -> dict[str, Any]:
    """Return a one-sided table as the fields of ``trajectory_msgs/JointTrajectory``; times are from its first row.

    Raises:
        InputError: efforts that are not finite, or two rows within a nanosecond.
    """
    bad = ~np.isfinite(table.effort).all(axis=1)
    if bad.any():
        raise InputError(
            f"The plan has no finite efforts at t = {table.t[int(bad.argmax())]:.6g} s.",
            remedy="A controller cannot be sent there; to_csv shows the rest.",
        )
    instants = [round(float(t - table.t[0]) * 1e9) for t in table.t]
    if any(after <= before for before, after in itertools.pairwise(instants)):
        raise InputError("Two points have the same time.", remedy="Use a lower rate.")
    parts = zip(*(getattr(table, quantity).tolist() for quantity in QUANTITIES), instants, strict=True)
    return {
        "header": {"stamp": {"sec": 0, "nanosec": 0}, "frame_id": ""},
        "joint_names": list(table.joints),
        "points": [
            {
                "positions": position,
                "velocities": rate,
                "accelerations": acceleration,
                "effort": effort,
                "time_from_start": {"sec": instant // 10**9, "nanosec": instant % 10**9},
            }
            for position, rate, acceleration, effort, instant in parts
        ],
    }
