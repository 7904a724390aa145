"""Figures of the report show what was run."""

from __future__ import annotations

from typing import Any

import numpy as np
import quick_results

from redundancy_pin.thesis.cases import FULL, SINGULAR, Plans
from redundancy_pin.thesis.figures import Results, pictures
from redundancy_pin.thesis.measures import MotionRun
from redundancy_pin.visualisation.figures.plots import side_by_side


def draw(kind: str) -> tuple[MotionRun, Any]:
    """Draw a figure of a motion without a planner."""
    run = quick_results.motion_run("circle-0.5-parked")
    results = Results(FULL, quick_results.PASSED, (run,), (), {}, Plans())
    (picture,) = (picture for picture in pictures(results)["motions"] if picture.stem.endswith(kind))
    return run, picture.draw()


def test_efforts_are_drawn_at_regular_samples() -> None:
    run, figure = draw("efforts")
    axes = figure.axes[0]
    shown = np.asarray(axes.lines[0].get_ydata())
    regular = run.distribution.status == 0
    np.testing.assert_array_equal(shown[regular], run.distribution.tau[regular, 0])
    assert np.isnan(shown[~regular]).all()
    assert "[N]" in axes.get_ylabel()


def test_the_path_is_that_of_the_run() -> None:
    run, figure = draw("path")
    drawn = figure.axes[0]
    paths = [line for line in drawn.lines if len(line.get_xdata()) == len(run.t)]
    # traced by the mechanism, through the kinematics
    np.testing.assert_allclose(paths[0].get_xydata(), run.motion.x, rtol=0.0, atol=1e-14)


def test_plans_side_by_side_name_peak_and_status() -> None:
    plan = SINGULAR[0].plan()
    drawn = side_by_side("title", {"one": plan, "two": plan}, "N", instants=[0.5])
    titles = [axes.get_title() for axes in drawn.axes if axes.get_title()]
    assert len(titles) == 2
    assert all(
        f"{plan.peak_effort.max():.3g} N" in title and plan.status.value.split("_")[0] in title for title in titles
    )
