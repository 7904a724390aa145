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
    links, platform = _mechanism(result)
    return plot_path(
        PathCurves(
            title=result.experiment.title,
            t=result.t,
            point=result.motion.x[:, :2],
            links=links,
            hinges=np.unique(np.round([link[0] for link in links], 12), axis=0),
            platform=platform,
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
    """Return the mechanism at the start of the motion, m.

    Returns:
        Legs as polylines (p, 2) from the base hinge through the origins of the joints to the platform, and the corners
        of the platform (c, 2), where legs and closures meet it.
    """
    robot = result.robot
    model = robot.model
    pose = ConstraintSystem(robot).evaluate(lift(robot, result.motion[:1]).q).pose
    carriers = {int(model.getJointId(name)) for name in robot.carriers}
    closing = dict.fromkeys(frame for closure in robot.closures for frame in (closure.frame_a, closure.frame_b))
    joint_of = {frame: int(model.frames[model.getFrameId(frame)].parentJoint) for frame in closing}
    body = int(model.frames[model.getFrameId(robot.platform.frame)].parentJoint) if robot.platform else -1
    corners = [pose.frame_origin[frame] for frame, joint in joint_of.items() if joint == body]
    ends = [(pose.frame_origin[frame], joint) for frame, joint in joint_of.items() if joint != body]
    if body > 0:
        # the leg that carries the platform in the tree ends at the platform's joint, which is one more corner
        corners.append(pose.joint_origin[body])
        ends.append((corners[0] if len(corners) == 2 else pose.joint_origin[body], body))
    legs = []
    for point, joint in ends:
        points = [point[:2, 0]]
        while joint > 0:
            if joint not in carriers:
                points.append(pose.joint_origin[joint][:2, 0])
            joint = int(model.parents[joint])
        legs.append(np.array(points[::-1]))
    return tuple(legs), np.array([corner[:2, 0] for corner in corners])
