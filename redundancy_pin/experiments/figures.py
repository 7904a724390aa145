"""The figures of a result: what it holds, handed to the plots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.arrays import Array
from redundancy_pin.dynamics.status import SampleStatus
from redundancy_pin.experiments.result import Result
from redundancy_pin.kinematics.closure import ConstraintSystem
from redundancy_pin.kinematics.state import lift
from redundancy_pin.visualisation.comparison import plot_comparison
from redundancy_pin.visualisation.efforts import EffortCurves, plot_efforts
from redundancy_pin.visualisation.paths import PathCurves, plot_path

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def effort_figure(result: Result) -> Figure:
    """Return the efforts of a result by both backends.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    first, second = result.rnea, result.virtual_work
    return plot_efforts(
        EffortCurves(
            title=result.experiment.title,
            names=effort_names(result),
            unit=result.effort_unit,
            t=result.t,
            tau=first.distribution.tau,
            check=second.distribution.tau,
            backends=("RNEA", "virtual work"),
            regular=first.distribution.status == SampleStatus.REGULAR,
            margin=first.distribution.margin,
            scale=first.reduced.column_scale,
            carrier_force=first.reduced.carrier_force,
            windows=result.near_singular_windows,
            instants=tuple(instant.t for instant in result.instants),
            missing_force=tuple(instant.missing_force for instant in result.instants),
        )
    )


def path_figure(result: Result) -> Figure:
    """Return the mechanism, the path and the condition number of a result.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    links, hinges = _mechanism(result)
    return plot_path(
        PathCurves(
            title=result.experiment.title,
            t=result.t,
            point=result.motion.x[:, :2],
            links=links,
            hinges=hinges,
            condition=result.rnea.distribution.condition,
            thresholds=result.experiment.thresholds,
            windows=result.near_singular_windows,
            instants=tuple(instant.t for instant in result.instants),
            singular_points=tuple((instant.x[0], instant.x[1]) for instant in result.instants),
        )
    )


def comparison_figure(results: Sequence[Result]) -> Figure:
    """Return the efforts of several results along one motion.

    Raises:
        RedundancyPinError: matplotlib is not installed.
    """
    labels = {"parked": "carriers parked", "none": "no carriers"}
    first = results[0]
    return plot_comparison(
        first.experiment.title.rpartition(",")[0],
        effort_names(first),
        first.effort_unit,
        {labels[result.experiment.carriers]: (result.t, result.rnea.distribution.tau) for result in results},
    )


def effort_names(result: Result) -> tuple[str, ...]:
    """Return the symbols of the main efforts, τ1, τ2, ...."""
    return tuple(f"τ{i + 1}" for i in range(result.robot.m))


def _mechanism(result: Result) -> tuple[tuple[Array, ...], Array]:
    """Return the links at the start of the motion as polylines (p, 2), and the hinges on the base (h, 2), m.

    A polyline runs from a base hinge through the origins of the joints to the closure (or the platform).
    """
    robot = result.robot
    system = ConstraintSystem(robot)
    pose = system.evaluate(lift(robot, result.motion[:1]).q).pose
    model = robot.model
    carriers = {int(model.getJointId(name)) for name in robot.carriers}
    ends = [frame for closure in robot.closures for frame in (closure.frame_a, closure.frame_b)]
    if robot.platform is not None:
        ends.append(robot.platform.frame)
    lines, hinges = [], []
    for frame in dict.fromkeys(ends):
        points = [pose.frame_origin[frame][:2, 0]]
        joint = int(model.frames[model.getFrameId(frame)].parentJoint)
        while joint > 0:
            if joint not in carriers:
                points.append(pose.joint_origin[joint][:2, 0])
            joint = int(model.parents[joint])
        lines.append(np.array(points[::-1]))
        hinges.append(lines[-1][0])
    return tuple(lines), np.unique(np.round(np.array(hinges), 12), axis=0)
