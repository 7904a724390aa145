"""The figures of a result: what it holds, handed to the plots."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from redundancy_pin.dynamics.distribution import SampleStatus
from redundancy_pin.experiments.result import Result
from redundancy_pin.kinematics.lift import lift
from redundancy_pin.visualisation.figures.comparisons import EffortCurves, plot_comparison, plot_efforts
from redundancy_pin.visualisation.figures.paths import PathCurves, plot_path
from redundancy_pin.visualisation.viewer.parts import base_hinges, links

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
    robot = result.robot
    start = lift(robot, result.motion[:1]).q[0]
    return plot_path(
        PathCurves(
            title=result.experiment.title,
            t=result.t,
            point=result.motion.x[:, :2],
            links=tuple(np.stack(ends)[:, :2] for ends in links(robot, start)),
            hinges=base_hinges(robot)[:, :2],
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
