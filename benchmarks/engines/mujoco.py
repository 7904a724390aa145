"""MuJoCo: the tree in minimal coordinates, the closures as its soft equality constraints.

MuJoCo's constraints are springs and dampers by design: along a constraint the acceleration is pulled towards
−b ṙ − k r, and the constraint force costs a little, so that the chains stay open by a gap in proportion to the force.
With the stiffest reference MuJoCo takes (a time constant of two steps) and the highest impedance (0.9999) the gap falls
with the square of the step; how far the motion is off is for ``run.deviation`` to say.
"""

from __future__ import annotations

import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import pinocchio as pin

from engines.links import FrameOnLink, LinkClosure, LinkTree, link_tree
from engines.missing import require
from engines.run import EngineRun, Raw, finished, joined
from engines.task import Segment, Task, segments
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError, UnsupportedRobotError
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.robot import AXES

Integrator = Literal["RK4", "Euler", "implicitfast"]

IMPEDANCE = 0.9999
"""The highest impedance MuJoCo accepts (its mjMAXIMP): the share of the acceleration a constraint may ask for."""

LEAST_INERTIA = 1e-12
"""Mass, kg, and moments of inertia, kg·m², of links that have none: MuJoCo accepts no zero. On machines of a kilogram
and a metre this changes the motion by a millionth of a micrometre."""

LEAST_SHARE = 1e-8
"""Smallest eigenvalue of the open tree's mass matrix, its diagonal scaled to 1, that MuJoCo can divide by: the rounding
of accelerations grows with its inverse."""

TIME_CONSTANT = 2.0
"""Time constant of the constraints in steps; MuJoCo raises anything smaller to this (its option refsafe)."""


def run_mujoco(
    task: Task,
    *,
    step: float,
    time_constant: float | None = None,
    impedance: float = IMPEDANCE,
    integrator: Integrator = "RK4",
) -> EngineRun:
    """Integrate a task with MuJoCo.

    The efforts of a step are those at its middle: MuJoCo holds them over the step.

    Args:
        task: initial state and efforts.
        step: longest step, s; the steps are equal between two breaks.
        time_constant: of the soft constraints, s, critically damped; two steps when left out, which is the stiffest
            MuJoCo takes.
        impedance: of the soft constraints, up to 0.9999.
        integrator: MuJoCo's name of the integrator.

    Returns:
        The motion, with the closure gap the soft constraints leave.

    Raises:
        RedundancyPinError: mujoco is not installed.
        UnsupportedRobotError: a joint that is neither revolute nor prismatic, an open tree without inertia in some
            direction, or a closure that MuJoCo's constraints cannot express.
        InputError: a step, time constant or impedance out of its domain, an unknown integrator.
    """
    parts = segments(task, step)
    longest = max(part.step for part in parts)
    constant = TIME_CONSTANT * longest if time_constant is None else time_constant
    if not constant >= TIME_CONSTANT * longest * (1.0 - _ROUNDING):
        raise InputError(
            f"The time constant is {constant:g} s with steps of {longest:g} s.",
            remedy="MuJoCo takes none below two steps: shorten the step.",
            time_constant=constant,
        )
    if not 0.0 < impedance <= IMPEDANCE:
        raise InputError(
            f"The impedance is {impedance}.", remedy=f"MuJoCo takes numbers up to {IMPEDANCE}.", impedance=impedance
        )
    if integrator not in ("RK4", "Euler", "implicitfast"):
        raise InputError(f"integrator is {integrator!r}.", remedy='Use "RK4", "Euler" or "implicitfast".')
    mj = require("mujoco")
    tree = link_tree(task.robot)
    model = mj.MjModel.from_xml_string(mjcf(tree, constant, impedance, integrator))
    data = mj.MjData(model)
    at = np.array([int(model.joint(str(i)).qposadr[0]) for i in range(len(tree.links))])
    data.qpos[at], data.qvel[at] = tree.from_q(task.q), tree.from_v(task.v)
    found: list[Raw] = []
    for part in parts:
        found.append(_integrate(mj, model, data, task, tree, part, at))
        if found[-1].message:
            break
    settings = {"step": longest, "time_constant": constant, "impedance": impedance, "integrator": integrator}
    return finished(tree, task, joined(found), "mujoco", str(mj.__version__), settings)


def mjcf(tree: LinkTree, time_constant: float, impedance: float, integrator: Integrator) -> str:
    """Return the robot as MJCF.

    Args:
        tree: the robot.
        time_constant: of the soft constraints, s.
        impedance: of the soft constraints.
        integrator: MuJoCo's name of the integrator.

    Raises:
        UnsupportedRobotError: an open tree without inertia in some direction, or a closure that MuJoCo's constraints
            cannot express.
    """
    _require_inertia(tree)
    root = ElementTree.Element("mujoco", model=tree.robot.name)
    _add(
        root,
        "compiler",
        angle="radian",
        boundmass=LEAST_INERTIA,
        boundinertia=LEAST_INERTIA,
        inertiafromgeom="false",
        fusestatic="false",
    )
    option = _add(
        root, "option", gravity=tree.gravity, integrator=integrator, solver="Newton", tolerance=0, iterations=50
    )
    _add(option, "flag", contact="disable", warmstart="enable")
    bodies = [_add(root, "worldbody")]
    for index, link in enumerate(tree.links):
        body = _add(bodies[link.parent + 1], "body", pos=link.translation, quat=_quaternion(link.rotation))
        _add(body, "joint", name=index, type={"revolute": "hinge", "prismatic": "slide"}[link.kind], axis=(0, 0, 1))
        moments, axes = np.linalg.eigh(link.inertia)
        axes = axes * np.sign(np.linalg.det(axes))
        moments = np.maximum(moments, 0.0)
        _add(body, "inertial", pos=link.centre, quat=_quaternion(axes), mass=link.mass, diaginertia=moments)
        bodies.append(body)
    equality = _add(root, "equality")
    for number, closure in enumerate(tree.closures):
        kind, places = constraint_of(tree, closure)
        for place, offset in enumerate(places):
            names = [f"{number}_{place}_{side}" for side in "ab"]
            for name, frame in zip(names, (closure.a, closure.b), strict=True):
                _site(bodies[frame.link + 1], name, frame, offset)
            _add(
                equality,
                kind,
                site1=names[0],
                site2=names[1],
                solref=(time_constant, 1.0),
                solimp=(impedance, impedance, 0.001, 0.5, 2.0),
            )
    return ElementTree.tostring(root, encoding="unicode")


def constraint_of(tree: LinkTree, closure: LinkClosure) -> tuple[str, list[Array]]:
    """Return MuJoCo's constraint for a closure, and the points of the frames (3,), m, it joins.

    Rows that no motion of the tree can violate (z of a planar mechanism) may be added: soft constraints stand them.

    Raises:
        UnsupportedRobotError: no constraint of MuJoCo's has this mask.
    """
    held = set(closure.axes) | _idle(tree, closure)
    rotations = [axis for axis in AXES[3:] if axis in held]
    if {"x", "y", "z"} <= held:
        if not any(axis.startswith("r") for axis in closure.axes):
            return "connect", [np.zeros(3)]
        if len(rotations) == 3:
            return "weld", [np.zeros(3)]
        if len(rotations) == 2:  # a hinge: two points on its axis
            free = next(i for i in range(3) if AXES[3 + i] not in held)
            return "connect", [np.zeros(3), tree.robot.characteristic_length * np.eye(3)[free]]
    raise UnsupportedRobotError(
        f"The closure {closure.name!r} holds {', '.join(closure.axes)}, which no constraint of MuJoCo does.",
        remedy="Use Exudyn, whose joints take any mask.",
        closure=closure.name,
    )


def _idle(tree: LinkTree, closure: LinkClosure) -> set[str]:
    """Return the axes along which the frames cannot part, whatever the joints do."""
    robot = tree.robot
    declared = next(c for c in robot.closures if c.name == closure.name)
    whole = ConstraintSystem(replace(robot, closures=(replace(declared, axes=AXES),)))
    rng = np.random.default_rng(0)
    steps = rng.uniform(-1.0, 1.0, (_TRIALS, robot.model.nv))
    state = whole.evaluate(np.array([pin.integrate(robot.model, np.array(robot.q_reference), d) for d in steps]))
    moved = np.abs(state.Jc).max(axis=(0, 2)) + np.abs(state.phi).max(axis=0)
    return {axis for axis, size in zip(AXES, moved, strict=True) if size < _STILL}


def _require_inertia(tree: LinkTree) -> None:
    """MuJoCo divides by the mass matrix of the open tree, so each joint needs inertia behind it, closures or not."""
    robot = tree.robot
    upper = pin.crba(robot.model, robot.model.createData(), np.array(robot.q_reference))
    mass = np.triu(upper) + np.triu(upper, 1).T
    size = np.sqrt(np.diag(mass))
    if (size > 0.0).all():
        values, vectors = np.linalg.eigh(mass / np.outer(size, size))
        if values[0] > LEAST_SHARE:
            return
        worst = int(np.abs(vectors[:, 0]).argmax())
    else:
        worst = int(size.argmin())
    name = next(link.name for link in tree.links if link.velocity == worst)
    raise UnsupportedRobotError(
        f"With the closures open, joint {name!r} moves (nearly) no mass, and MuJoCo divides by what it moves.",
        remedy="Give its link a mass (the 2-RPR: cylinder_mass and piston_mass), or use Exudyn.",
        joint=name,
    )


def _integrate(mj: Any, model: Any, data: Any, task: Task, tree: LinkTree, part: Segment, at: Array) -> Raw:
    count = len(part.t) - 1
    columns = [next(i for i, link in enumerate(tree.links) if link.velocity == v) for v in tree.driven]
    effort = np.zeros((count, len(tree.links)))
    effort[:, at[columns]] = task.efforts(part.t[:-1] + 0.5 * part.step)
    model.opt.timestep = part.step
    coordinates, rates = np.empty((count + 1, len(at))), np.empty((count + 1, len(at)))
    coordinates[0], rates[0] = data.qpos[at], data.qvel[at]
    step, warnings = mj.mj_step, data.warning
    with _silent(mj):
        began = time.perf_counter()
        for k in range(count):
            data.qfrc_applied[:] = effort[k]
            step(model, data)
            coordinates[k + 1], rates[k + 1] = data.qpos[at], data.qvel[at]
        seconds = time.perf_counter() - began
    # MuJoCo starts over from the reference position when a state is not finite, and only counts a warning
    kinds = (mj.mjtWarning.mjWARN_BADQPOS, mj.mjtWarning.mjWARN_BADQVEL, mj.mjtWarning.mjWARN_BADQACC)
    bad = any(warnings[int(kind)].number for kind in kinds)
    if not bad:
        return Raw(part.t, coordinates, rates, seconds, "")
    kept = int((np.abs(np.diff(coordinates, axis=0)).max(axis=1) > _LEAP).argmax()) + 1
    message = f"MuJoCo found its own state unstable and started over near {part.t[kept - 1]:.6g} s."
    return Raw(part.t[:kept], coordinates[:kept], rates[:kept], seconds, message)


@contextmanager
def _silent(mj: Any) -> Iterator[None]:
    """Keep MuJoCo from printing its warnings and writing them to MUJOCO_LOG.TXT: they are in the result."""
    before = mj.get_mju_user_warning()
    mj.set_mju_user_warning(lambda message: None)
    try:
        yield
    finally:
        mj.set_mju_user_warning(before)


def _add(parent: ElementTree.Element, tag: str, **attributes: object) -> ElementTree.Element:
    return ElementTree.SubElement(parent, tag, {name: _text(value) for name, value in attributes.items()})


def _text(value: object) -> str:
    if isinstance(value, Iterable) and not isinstance(value, str):
        return " ".join(repr(float(part)) for part in value)
    return repr(float(value)) if isinstance(value, float) else str(value)


def _site(body: ElementTree.Element, name: str, frame: FrameOnLink, offset: Array) -> None:
    _add(body, "site", name=name, pos=frame.translation + frame.rotation @ offset, quat=_quaternion(frame.rotation))


def _quaternion(rotation: Array) -> Array:
    """Return (w, x, y, z), MuJoCo's order."""
    x, y, z, w = pin.Quaternion(np.array(rotation)).coeffs()
    return np.array([w, x, y, z])


_ROUNDING = 1e-9
"""By which the longest step may exceed the one asked for: times are divided."""

_TRIALS = 5
"""Random configurations at which a row has to be idle."""

_STILL = 1e-12
"""Rounding of a row of a one-metre machine."""

_LEAP = 1.0
"""Change of a joint in one step, m or rad, that is no motion."""
