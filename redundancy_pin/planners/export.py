"""A plan for other programs: by joint name, at a rate of their choice, as CSV, JSON, MAT, JointTrajectory or pandas.

Between its samples a plan is what its functions of time say, efforts by W τ = f of them (``reference``), and not what
lines between the samples would be. Where something jumps, a table at a rate has the values after the jump, unless it is
to be two-sided: then the instant has two rows, before and after it. Without a rate the rows are the plan's own samples.
"""

from __future__ import annotations

import csv
import io
import itertools
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from redundancy_pin.arrays import Array, BoolArray, Frozen, positive, read_only
from redundancy_pin.errors import InputError, OutputError, optional
from redundancy_pin.io.files import refusing, replacing_file, write_text
from redundancy_pin.kinematics.coordinates import is_revolute, joint_position
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.planners.functions import ROUNDED, apart
from redundancy_pin.planners.reference import plan_reference
from redundancy_pin.planners.robot_record import RobotRecord, load_recorded
from redundancy_pin.robot import Robot, RobotLike, as_robot
from redundancy_pin.robot.lookup import find_joint
from redundancy_pin.trajectory.quaternions import quaternions_of
from redundancy_pin.trajectory.trajectory import sample_times

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
    """A plan or a simulation at N instants; J joints: the main actuators, then the carriers.

    Attributes:
        t: (N,) time, s; an instant occurs twice where both sides of a jump are kept.
        joints: names of the J joints.
        joint_units: for each of ``QUANTITIES`` the units of the J joints.
        position: (N, J) m or rad.
        rate: (N, J) m/s or rad/s.
        acceleration: (N, J) m/s² or rad/s².
        effort: (N, J) what the actuators give, N or N·m; NaN at samples of a plan that has no finite efforts there.
        coordinates: names of the independent coordinates; of a pose position and quaternion, then.
        coordinate_units: their units.
        x: (N, n) the coordinates, m and rad; (N, 7) of a pose, the quaternion in the order x, y, z, w.
        about: which plan this is, in plain data.
    """

    t: Array
    joints: tuple[str, ...]
    joint_units: Mapping[str, tuple[str, ...]]
    position: Array
    rate: Array
    acceleration: Array
    effort: Array
    coordinates: tuple[str, ...]
    coordinate_units: tuple[str, ...]
    x: Array
    about: Mapping[str, Any]

    def columns(self) -> dict[str, tuple[str, Array]]:
        """Return unit and values (N,) of each column by its name: ``t``, ``joint.position``, ..., ``platform.x``."""
        columns: dict[str, tuple[str, Array]] = {"t": ("s", self.t)}
        for j, joint in enumerate(self.joints):
            for quantity in QUANTITIES:
                values = getattr(self, quantity)[:, j]
                columns[f"{joint}.{quantity}"] = (self.joint_units[quantity][j], values)
        for j, (name, unit) in enumerate(zip(self.coordinates, self.coordinate_units, strict=True)):
            columns[name] = (unit, self.x[:, j])
        return columns


def plan_table(
    plan: Plan, rate: float | None = None, *, two_sided: bool | None = None, robot: RobotLike | None = None
) -> PlanTable:
    """Return a plan as a table.

    Args:
        plan: the plan.
        rate: rows a second, Hz, and one at the end; the samples of the plan when left out.
        two_sided: whether an instant at which something jumps has two rows, before and after it; when left out, only
            those that the plan itself has twice.
        robot: its robot; loaded from the plan when left out.

    Raises:
        InputError: a rate that is not positive, or makes too many rows.
        InfeasiblePlanError: rows between the samples of a plan that has no finite efforts.
        PlanFileError: the robot cannot be loaded, or is no longer what it was.
    """
    machine = load_recorded(plan.robot) if robot is None else as_robot(robot)
    if rate is None:
        parts = _at_samples(plan, machine)
        if two_sided is False:  # the row after the jump stands for both
            kept = ~_before(plan.t)
            parts = tuple(part[kept] for part in parts)  # type: ignore[assignment]
    else:
        parts = _at_rate(plan, machine, positive(rate, "rate", "Hz"), two_sided is True)
    about = {
        "format": FORMAT,
        "version": VERSION,
        "robot": plan.robot.name,
        "planner": plan.planner,
        "backend": plan.backend,
        "status": plan.status.value,
        "samples_per_second": None if rate is None else float(rate),
    }
    return table_of_states(machine, plan.robot, parts, about)


def table_of_states(
    machine: Robot,
    record: RobotRecord,
    parts: tuple[Array, Array, Array, Array, Array, Array],
    about: Mapping[str, Any],
) -> PlanTable:
    """Return a table of N states of a robot.

    Args:
        machine: the robot.
        record: the same, in plain data.
        parts: t (N,), x (N, n) or (N, 4, 4), q (N, nq), v and a (N, nv), and efforts (N, m + k).
        about: what it is, in plain data.
    """
    t, x, q, v, a, effort = parts
    names = (*machine.actuated, *machine.carriers)
    columns = np.concatenate([machine.actuated_velocity, machine.carrier_velocity])
    coordinates, units, x = joint_columns(machine, x)
    return PlanTable(
        t=read_only(t),
        joints=names,
        joint_units=_units(record, names),
        position=read_only(np.stack([_position(machine, name, q) for name in names], axis=1)),
        rate=read_only(v[:, columns]),
        acceleration=read_only(a[:, columns]),
        effort=read_only(effort),
        coordinates=coordinates,
        coordinate_units=units,
        x=read_only(x),
        about=about,
    )


def _at_samples(plan: Plan, robot: Robot) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return t, x, q, v, a and efforts of the samples of a plan."""
    tree, efforts = lift(robot, plan.motion).with_carriers(plan.carriers), [plan.tau, plan.carrier_force]
    return plan.t, plan.motion.x, tree.q, tree.v, tree.a, np.concatenate(efforts, axis=1)


def _at_rate(plan: Plan, robot: Robot, rate: float, two_sided: bool) -> tuple[Array, Array, Array, Array, Array, Array]:
    """Return t, x, q, v, a and efforts of the functions of time of a plan, at a rate, Hz."""
    reference, functions = plan_reference(plan, robot=robot), plan.functions_of_time
    start, end = float(plan.t[0]), float(plan.t[-1])
    slack = ROUNDED * (end - start)  # jumps of one instant, from different functions, differ by rounding
    breaks = [functions.platform.breaks, functions.carriers.derivative(2).jumps(), reference.jumps]
    inner = np.concatenate(breaks)
    jumps = apart(np.concatenate([[start], inner[(inner > start + slack) & (inner < end - slack)], [end]]))[1:-1]
    times = start + sample_times(end - start, jumps - start if two_sided else jumps[:0], 1.0 / rate, None, two_sided)
    times[-1] = end
    sides = _clear_of(jumps, times, slack)
    q, v, _, _ = reference.tree_and_loads(times)
    _, _, a, effort = reference.tree_and_loads(sides)
    instants, rows = np.unique(times, return_inverse=True)
    return times, functions.platform.sample_at(instants).x[rows], q, v, a, effort


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
    position = joint_position(robot, name, q)
    continuous = find_joint(robot.model, name).nq == 2
    return np.unwrap(position) if continuous else position


def joint_columns(robot: Robot, x: Array) -> tuple[tuple[str, ...], tuple[str, ...], Array]:
    """Return names, units and values of the independent coordinates."""
    if robot.platform is None:
        units = tuple("rad" if is_revolute(robot, name) else "m" for name in robot.independent_joints)
        return tuple(f"independent.{name}" for name in robot.independent_joints), units, x
    if not robot.platform.is_pose:
        names = tuple(f"platform.{axis}" for axis in robot.platform.axes)
        return names, tuple("rad" if axis.startswith("r") else "m" for axis in robot.platform.axes), x
    values = np.concatenate([x[:, :3, 3], quaternions_of(x[:, :3, :3])], axis=1)
    axes = ("x", "y", "z", "qx", "qy", "qz", "qw")
    return tuple(f"platform.{axis}" for axis in axes), ("m",) * 3 + ("1",) * 4, values


def _units(record: RobotRecord, names: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """Return the units of the joints, in ASCII: spreadsheets guess at everything else."""
    rate = {"position": "track", "rate": "speed", "acceleration": "acceleration", "effort": "effort"}
    return {
        quantity: tuple(record.limit_unit(limit, name).replace("²", "^2").replace("·", " ") for name in names)
        for quantity, limit in rate.items()
    }


# --- files ----------------------------------------------------------------------------------------------------------


def write_csv(table: PlanTable, path: str | Path) -> None:
    """Write a table as CSV: a row of names with units, such as ``elbow.effort [N m]``, then one for each instant."""
    columns, text = table.columns(), io.StringIO()
    csv.writer(text, lineterminator="\n").writerow([f"{name} [{unit}]" for name, (unit, _) in columns.items()])
    rows = np.stack([values for _, values in columns.values()], axis=1).tolist()
    text.writelines(",".join(map(repr, row)) + "\n" for row in rows)  # repr: floats come back bit by bit
    write_text(path, text.getvalue())


def write_json(table: PlanTable, path: str | Path) -> None:
    """Write a table as one JSON object: which plan it is, ``units`` and ``columns``; no finite effort is null."""
    columns = table.columns()
    data = {
        **table.about,
        "joints": list(table.joints),
        "units": {name: unit for name, (unit, _) in columns.items()},
        "columns": {
            name: [value if np.isfinite(value) else None for value in values.tolist()]
            for name, (_, values) in columns.items()
        },
    }
    write_text(path, json.dumps(data, allow_nan=False) + "\n")


def write_mat(table: PlanTable, path: str | Path) -> None:
    """Write a table as a MAT file (version 5): matrices with a column for each joint, and cells with their names."""
    from scipy.io import savemat

    def cells(names: tuple[str, ...]) -> Any:
        column = np.empty(len(names), dtype=object)
        column[:] = names
        return column

    data = {
        **{key: value for key, value in table.about.items() if value is not None},
        "t": table.t[:, None],
        "joints": cells(table.joints),
        **{quantity: getattr(table, quantity) for quantity in QUANTITIES},
        "units": {quantity: cells(units) for quantity, units in table.joint_units.items()},
        "coordinates": cells(table.coordinates),
        "coordinate_units": cells(table.coordinate_units),
        "x": table.x,
    }
    with replacing_file(path) as temporary, refusing(path):
        savemat(temporary, data, appendmat=False)


def write_ros(table: PlanTable, path: str | Path) -> None:
    """Write a table as a message ``trajectory_msgs/JointTrajectory`` of ROS 2, YAML or JSON by the name of the file.

    Raises:
        InputError: efforts that are not finite.
        OutputError: another suffix, or the file cannot be written.
    """
    suffix = Path(path).suffix.lower()
    if suffix not in (".yaml", ".yml", ".json"):
        raise OutputError(f"{path} ends in neither .yaml nor .json.", remedy="Name it trajectory.yaml.", path=str(path))
    message = joint_trajectory(table)
    if suffix == ".json":
        write_text(path, json.dumps(message, allow_nan=False) + "\n")
        return
    import yaml

    dumper: Any = getattr(yaml, "CSafeDumper", yaml.SafeDumper)
    write_text(path, yaml.dump(message, Dumper=dumper, sort_keys=False, default_flow_style=None, width=1 << 20))


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


def data_frame(table: PlanTable) -> Any:
    """Return a table as a pandas ``DataFrame`` with t as its index; units are in ``.attrs["units"]``.

    Raises:
        RedundancyPinError: pandas is not installed.
    """
    pandas = optional("pandas", "A data frame needs", "Install it with `pip install 'redundancy_pin[pandas]'`.")
    columns = table.columns()
    frame = pandas.DataFrame(
        {name: values for name, (_, values) in columns.items() if name != "t"}, index=pandas.Index(table.t, name="t")
    )
    frame.attrs.update(table.about, units={name: unit for name, (unit, _) in columns.items()})
    return frame
