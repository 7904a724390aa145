"""MuJoCo: the tree in minimal coordinates, the closures as its soft equality constraints.

MuJoCo's constraints are springs and dampers by design: along a constraint the acceleration is pulled towards
−b ṙ − k r, and the constraint force costs a little, so that the chains stay open by a gap in proportion to the force.
With the stiffest reference MuJoCo takes (a time constant of two steps) and the highest impedance (0.9999) the gap falls
with the square of the step; how far the motion is off is for ``run.deviation`` to say.
"""

from __future__ import annotations

import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Literal

import numpy as np

from engines.links import LinkTree, link_tree
from engines.run import EngineRun, Raw, finished, joined, require
from engines.task import Segment, Task, segments
from redundancy_pin.arrays import Array
from redundancy_pin.errors import InputError
from redundancy_pin.writers import IMPEDANCE, mjcf

Integrator = Literal["RK4", "Euler", "implicitfast"]

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
    text = ElementTree.tostring(mjcf(task.robot, longest, constant, impedance, integrator), encoding="unicode")
    model = mj.MjModel.from_xml_string(text)
    data = mj.MjData(model)
    at = np.array([int(model.joint(link.name).qposadr[0]) for link in tree.links])
    data.qpos[at], data.qvel[at] = tree.from_q(task.q), tree.from_v(task.v)
    runs: list[Raw] = []
    for part in parts:
        runs.append(_integrate(mj, model, data, task, tree, part, at))
        if runs[-1].message:
            break
    settings = {"step": longest, "time_constant": constant, "impedance": impedance, "integrator": integrator}
    return finished(tree, task, joined(runs), "mujoco", str(mj.__version__), settings)


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


_ROUNDING = 1e-9
"""By which the longest step may exceed the one asked for: times are divided."""

_LEAP = 1.0
"""Change of a joint in one step, m or rad, that is no motion."""
