"""The files of generated C: source, header, test program, CMake file and README of one robot."""

from __future__ import annotations

import importlib.resources
import re
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

import redundancy_pin
from redundancy_pin.arrays import NEAR_SINGULAR_MARGIN, Array
from redundancy_pin.codegen.names import add_prefix, as_initialiser
from redundancy_pin.codegen.plan import RecordedPlan, plan_facts, plan_source
from redundancy_pin.codegen.recorded import Recorded
from redundancy_pin.codegen.stack import stack_bytes, written_functions
from redundancy_pin.dynamics.compiled.build import driver_source, text_of
from redundancy_pin.dynamics.compiled.parameters import parameter_vector, turning_rows
from redundancy_pin.kinematics.branch import follower
from redundancy_pin.kinematics.coordinates import mode_name
from redundancy_pin.machine_code import NEEDS_INFINITY
from redundancy_pin.planners.receding_horizon import RecedingHorizon
from redundancy_pin.robot import Robot
from redundancy_pin.robot.lookup import find_joint, has_joint
from redundancy_pin.robot.scales import (
    closure_tolerance,
    column_scale,
    coordinate_unit,
    is_revolute,
    row_scale,
    velocity_scale,
    velocity_unit,
)
from redundancy_pin.status import SampleStatus


def pages(
    robot: Robot, prefix: str, recorded: Recorded, online: tuple[RecedingHorizon, RecordedPlan] | None
) -> dict[str, str]:
    """Return the text of each file, by name; ``online``: the planner that is written too, and its updates."""
    facts = {**_facts(robot, prefix, recorded), "plan": plan_facts(*online) if online else None}
    plan = (
        {
            f"{prefix}_plan.c": add_prefix(plan_source(online[0], prefix), prefix),
            f"test_{prefix}_plan.c": add_prefix(_rendered("test_plan.c.j2", facts), prefix),
        }
        if online
        else {}
    )
    return {
        f"{prefix}.c": add_prefix(source(robot, prefix, plan=online is not None), prefix),
        f"{prefix}.h": _rendered("controller.h.j2", facts),
        f"test_{prefix}.c": add_prefix(_rendered("test.c.j2", facts), prefix),
        "CMakeLists.txt": _rendered("CMakeLists.txt.j2", facts),
        "README.md": _rendered("README.md.j2", facts),
        **plan,
    }


def source(robot: Robot, prefix: str, *, plan: bool = False) -> str:
    """Return the C source without the prefix: expressions, driver, what a controller calls; ``plan``: a planner too."""
    definition, functions = written_functions(robot)
    controller, for_plan = (
        importlib.resources.files(__package__).joinpath(name).read_text(encoding="utf-8")
        for name in ("controller.c", "plan_terms.c")
    )
    if plan:
        functions.append(definition.functions["rp_carrier_terms"])
    return "\n".join(
        [
            f"/* {_as_comment(robot.name)}, written by redundancy_pin {redundancy_pin.__version__}; see {prefix}.h. */",
            NEEDS_INFINITY,
            f'#include "{prefix}.h"',
            driver_source(definition, functions, "static"),
            f"static const double REFERENCE[] = {as_initialiser(robot.q_reference)};",
            text_of("sample.c"),
            f"static const double NUMBERS[] = {as_initialiser(parameter_vector(robot))};",
            controller,
            *(["#define SHARED static", text_of("terms.c"), for_plan] if plan else []),
        ]
    )


def _rendered(template: str, facts: dict[str, Any]) -> str:
    import jinja2

    made = jinja2.Environment(  # braces and hashes are C's own
        loader=jinja2.PackageLoader(__package__, ""),
        undefined=jinja2.StrictUndefined,
        variable_start_string="@{",
        variable_end_string="}@",
        comment_start_string="{@",
        comment_end_string="@}",
        keep_trailing_newline=True,
        autoescape=False,  # C and Markdown; names from files are made plain
    )
    return made.get_template(template).render(facts)


def _facts(robot: Robot, prefix: str, recorded: Recorded) -> dict[str, Any]:
    platform, model = robot.platform, robot.model
    pose = platform is not None and platform.is_pose
    names = list(platform.axes) if platform else list(robot.independent_joints)
    turning = [axis.startswith("r") for axis in platform.axes] if platform else _turning(robot, names)
    lengths = [name for name, turns in zip(names, turning, strict=True) if not turns or not platform]
    frame = f"of frame {_as_comment(platform.frame)} in the base frame" if platform else "of the independent joints"
    rates = _units(names, turning, "m/s", "rad/s")
    closures = [_as_comment(name) for name in robot.constraint_names]
    far = 3 if pose else next((i for i, name in enumerate(names) if name in lengths and _is_scalar(robot, name)), None)
    far_drive = next((i for i, name in enumerate(robot.actuated) if _is_scalar(robot, name)), None)
    length = float(robot.characteristic_length)
    return {
        "version": redundancy_pin.__version__,
        "title": _as_comment(robot.name),
        "prefix": prefix,
        "PREFIX": prefix.upper(),
        "status": {status.name: int(status) for status in SampleStatus},
        "home": as_initialiser(follower(robot).home.x.reshape(-1)),
        "n": robot.n,
        "m": robot.m,
        "k": robot.k,
        "nq": model.nq,
        "nv": model.nv,
        "r": len(closures),
        "nx": 16 if pose else robot.n,
        "pose": pose,
        "stack": stack_bytes(robot),
        "near": NEAR_SINGULAR_MARGIN,
        "tolerance": repr(closure_tolerance(robot)),
        "length": repr(float(robot.characteristic_length)),
        "mode": mode_name(robot.working_mode) or "that of the reference",
        "gravity": ", ".join(f"{value:g}" for value in robot.gravity),
        "x_text": f"pose {frame}: homogeneous 4 x 4, row by row, m"
        if pose
        else f"{_units(names, turning, 'm', 'rad')} {frame}",
        "xd_text": f"{rates} {frame}: velocity of its origin and angular velocity, base axes"
        if platform
        else f"{rates} {frame}",
        "carriers": _of_joints(robot, robot.carriers, "m", "rad"),
        "carrier_efforts": _of_joints(robot, robot.carriers, "N", "N m"),
        "efforts": _of_joints(robot, robot.actuated, "N", "N m"),
        "drives": _of_joints(robot, robot.actuated, "m", "rad"),
        "closures": ", ".join(closures),
        "velocities": ", ".join(_as_comment(name) for name in model.names[1:]),
        "parameters": [(_as_comment(name), _as_comment(str(value))) for name, value in robot.parameters.items()],
        "samples": len(recorded),
        "recorded": ",\n".join(_record(robot, recorded, i) for i in range(len(recorded))),
        "closure": as_initialiser(recorded.closure),
        "gamma": as_initialiser(recorded.gamma),
        "row_scale": as_initialiser(row_scale(robot)),
        "size": {name: as_initialiser(size) for name, size in _sizes(robot, recorded).items()},
        "far": far,
        "far_by": None if far is None else repr(1e3 * (length if pose else float(coordinate_unit(robot)[far]))),
        "far_drive": far_drive,
        "far_drive_by": None if far_drive is None else repr(1e3 * length / float(column_scale(robot)[far_drive])),
    }


def _sizes(robot: Robot, recorded: Recorded) -> dict[str, Array]:
    """Return by quantity what its tolerance is a share of, in the shape of one sample.

    It is the largest value of all samples, lengths and angles made comparable; for forces at least the size of the
    terms that cancel, for coordinates at least the characteristic length or 1 rad.
    """
    rows, columns, reduced = row_scale(robot), column_scale(robot), recorded.reduced
    coordinate, velocity = coordinate_unit(robot), velocity_unit(robot)
    equation = np.where(turning_rows(robot), 1.0, robot.characteristic_length)
    x, xd, _ = recorded.motion
    place = np.ones((4, 4))
    place[:3, 3] = robot.characteristic_length
    force = float(np.asarray(reduced.force_size).max())

    def size(values: Array, unit: Array, least: float = 0.0) -> Array:
        return np.asarray(np.nanmax(np.abs(values) / unit, initial=least) * unit)

    return {
        "tau": size(recorded.efforts.tau, columns, force),
        "W": size(reduced.W, rows[:, None] / columns),
        "f": size(reduced.f, rows, force),
        "carrier_force": size(reduced.carrier_force, velocity_scale(robot)[robot.carrier_velocity], force),
        "residual": size(reduced.f / rows, np.ones(robot.n), force)[0],
        "x": size(x, place if x.ndim == 3 else coordinate, 1.0).ravel(),
        "xd": size(xd, coordinate),
        "closure": size(recorded.closure, equation[:, None] / velocity),
        "gamma": size(recorded.gamma, velocity[:, None] / coordinate),
    }


def _is_scalar(robot: Robot, name: str) -> bool:
    """Whether a coordinate has one number that does not come back to itself: no endless joint."""
    model = robot.model
    return not has_joint(model, name) or int(find_joint(model, name).nq) == 1


def _record(robot: Robot, recorded: Recorded, i: int) -> str:
    motion, carriers, efforts = recorded.motion, recorded.carriers, recorded.efforts
    parts: list[ArrayLike] = [motion[0][i].reshape(-1), motion[1][i], motion[2][i]]
    parts += [carriers[0][i], carriers[1][i], carriers[2][i]] if robot.k else []
    fields: list[ArrayLike] = [
        int(efforts.status[i]),
        efforts.tau[i],
        recorded.reduced.W[i],
        recorded.reduced.f[i],
        [*recorded.reduced.carrier_force[i].tolist(), 0.0],
        efforts.residual[i],
        efforts.margin[i],
        efforts.condition[i],
        recorded.type_I_margin[i],
        recorded.position[i],
        recorded.velocity[i],
    ]
    inputs = "{" + ", ".join(map(as_initialiser, parts)) + "}"
    return "  {" + ", ".join([inputs, *map(as_initialiser, fields)]) + "}"


def _as_comment(text: str) -> str:
    """Return a name from a file as a comment can hold it: nothing that ends one, no line, no trigraph."""
    return re.sub(r"[^A-Za-z0-9_.:+ -]", "_", text)[:80]


def _turning(robot: Robot, names: Iterable[str]) -> list[bool]:
    return [is_revolute(robot, name) for name in names]


def _of_joints(robot: Robot, names: Sequence[str], straight: str, turned: str) -> str:
    return _units(names, _turning(robot, names), straight, turned)


def _units(names: Sequence[str], turning: Sequence[bool], straight: str, turned: str) -> str:
    listed = (
        f"{_as_comment(name)} [{turned if turns else straight}]" for name, turns in zip(names, turning, strict=True)
    )
    return ", ".join(listed)
