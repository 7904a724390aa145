"""``rp.plot``: what each figure draws is what was computed, with units, limits and singular instants."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import moving
import numpy as np
import pytest
import zoo
from matplotlib.colors import to_hex
from scipy.optimize import brentq

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.status import SampleStatus
from redundancy_pin.visualisation.viewer.mechanism import base_hinges, body_points
from redundancy_pin.visualisation.viewer.scene import MARGIN_COLORS, margin_classes

INSTANT = 1e-9
"""Both roots are found to 1e-12 s or better."""


@cache
def plan() -> rp.Plan:
    return rp.plan_switch_off(
        rp.VirtualWork(zoo.robot_of("2rpr")), rp.trajectory.reference.circle(speed=0.6), threshold=7.0
    )


@cache
def corner() -> rp.Plan:
    return rp.plan_stepwise(
        rp.RneaDynamics(zoo.robot_of("3rrr")),
        rp.trajectory.reference.corner(radius=0.025),
    )


@cache
def computed() -> rp.plot.Curves:
    robot, trajectory = zoo.robot_of("2rpr"), rp.trajectory.reference.circle()
    reduced = rp.VirtualWork(robot).reduce(trajectory.sample(dt=0.002))
    crossings = rp.find_crossings(robot, trajectory)
    return rp.plot.curves(robot, reduced, rp.distribute(reduced), crossings=crossings, thresholds=(5.0, 20.0))


def _lines(axes: Any, samples: int) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata()) for line in axes.lines if len(line.get_xdata()) == samples]


def _verticals(axes: Any) -> list[float]:
    """Return where lines cross the whole panel from bottom to top."""
    return sorted(float(line.get_xdata()[0]) for line in axes.lines if list(line.get_ydata()) == [0, 1])


def _horizontals(axes: Any) -> set[float]:
    return {float(line.get_ydata()[0]) for line in axes.lines if list(line.get_xdata()) == [0, 1]}


def _bands(axes: Any) -> list[tuple[float, float]]:
    """Return bottom and top of each hatched band."""
    hatched = [patch for patch in axes.patches if patch.get_hatch()]
    return sorted((float(p.get_xy()[1]), float(p.get_xy()[1] + p.get_height())) for p in hatched)


def figures() -> dict[str, Any]:
    return {
        "efforts": rp.plot.efforts(plan()),
        "carriers": rp.plot.carriers(plan()),
        "condition": rp.plot.condition(plan()),
        "path": rp.plot.path(plan()),
        "plan": rp.plot.plan(plan()),
        "snapshots": rp.plot.snapshots(rp.show(plan())),
        "comparison": rp.plot.comparison({"plan": plan(), "parked": computed()}),
        "computed efforts": rp.plot.efforts(computed()),
        "torques": rp.plot.efforts(corner()),
    }


def test_every_axis_has_a_quantity_and_a_unit() -> None:
    for name, drawn in figures().items():
        for axes in drawn.axes:
            assert "[" in axes.get_ylabel(), name
        shared = drawn.axes[-1:] if name != "path" else drawn.axes
        for axes in shared:
            assert "[" in axes.get_xlabel(), name


def test_units_are_those_of_the_robot() -> None:
    assert rp.plot.efforts(plan()).axes[0].get_ylabel() == "main force [N]"
    assert rp.plot.efforts(corner()).axes[0].get_ylabel() == "main torque [N·m]"
    turning = replace(computed(), carriers_turn=True)
    assert rp.plot.efforts(turning).axes[1].get_ylabel() == "carrier torque [N·m]"
    assert rp.plot.carriers(turning).axes[1].get_ylabel() == "carrier speed ṡ [rad/s]"
    labels = [axes.get_ylabel() for axes in rp.plot.carriers(plan()).axes]
    assert labels == ["carrier position s [m]", "carrier speed ṡ [m/s]", "carrier acceleration s̈ [m/s²]"]


def test_curves_are_the_arrays_of_the_plan_and_of_nothing_else() -> None:
    samples = len(plan().t)
    main, carrier = rp.plot.efforts(plan()).axes
    np.testing.assert_array_equal(np.stack(_lines(main, samples), axis=1), plan().tau)
    np.testing.assert_array_equal(np.stack(_lines(carrier, samples), axis=1), plan().carrier_force)
    motion = plan().carriers
    for axes, values in zip(rp.plot.carriers(plan()).axes, (motion.s, motion.sd, motion.sdd), strict=True):
        np.testing.assert_array_equal(np.stack(_lines(axes, samples), axis=1), values)


def test_what_limits_forbid_is_hatched_down_to_the_limit() -> None:
    """The plan leaves its track of ±0.2 m and exceeds 10 m/s²; 2.5 m/s it comes near to on one side only."""
    track, _, acceleration = rp.plot.carriers(plan()).axes
    bottom, top = track.get_ylim()
    assert -0.2 in _horizontals(track)
    assert any(low == pytest.approx(bottom) and high == pytest.approx(-0.2) for low, high in _bands(track))
    bottom, top = acceleration.get_ylim()
    (low, high) = _bands(acceleration)
    assert low == pytest.approx((bottom, -10.0))
    assert high == pytest.approx((10.0, top))


def test_singular_instants_are_where_the_circle_meets_the_line_of_the_base() -> None:
    """The 2-RPR is singular at y = 0; the times are found here from the trajectory alone."""
    trajectory = rp.trajectory.reference.circle()

    def height(t: float) -> float:
        return float(trajectory.evaluate(t).x[1])

    lowest = float(trajectory.sample(0.001).t[np.argmin(trajectory.sample(0.001).x[:, 1])])
    expected = [brentq(height, 0.2, lowest, xtol=1e-13), brentq(height, lowest, 1.2, xtol=1e-13)]
    for drawn in (rp.plot.condition(computed()), rp.plot.efforts(computed()), rp.plot.carriers(computed())):
        for axes in drawn.axes:
            np.testing.assert_allclose(_verticals(axes), expected, atol=INSTANT)
    (legend,) = rp.plot.condition(computed()).legends
    assert [text.get_text() for text in legend.get_texts()] == ["near-singular", "singular instant"]


def test_a_plan_marks_the_instants_its_planner_found() -> None:
    instants = plan().diagnostics["singular_instants"]
    assert len(instants) == 2
    np.testing.assert_array_equal(_verticals(rp.plot.condition(plan()).axes[0]), instants)


def test_thresholds_are_drawn_and_named() -> None:
    axes = rp.plot.condition(computed()).axes[0]
    assert _horizontals(axes) == {5.0, 20.0}
    assert {"threshold 5", "threshold 20"} <= set(axes.get_legend_handles_labels()[1])
    assert _horizontals(rp.plot.condition(plan()).axes[0]) == {7.0}
    assert axes.get_yscale() == "log"
    assert rp.plot.condition(corner()).axes[0].get_yscale() == "linear"


def test_near_singular_windows_are_where_the_margin_is_small() -> None:
    curves = computed()
    inside = np.zeros(len(curves.t), dtype=bool)
    for start, end in curves.windows:
        inside |= (curves.t >= start) & (curves.t <= end)
    np.testing.assert_array_equal(inside, curves.margin < 0.05)
    assert len(curves.windows) == 2


def test_unbounded_efforts_do_not_flatten_the_others() -> None:
    axes = rp.plot.efforts(computed()).axes[0]
    regular = np.abs(computed().tau[computed().regular]).max()
    assert axes.get_ylim()[1] < 1.2 * regular
    comparison = rp.plot.comparison({"parked": computed()}).axes[0]
    assert comparison.get_ylim()[1] < 1.2 * regular


def test_a_comparison_leaves_out_unbounded_efforts_and_says_so_but_nothing_of_a_plan() -> None:
    near = np.full(len(plan().t), SampleStatus.NEAR_SINGULAR)
    drawn = rp.plot.comparison({"plan": replace(plan(), sample_status=near)})
    assert drawn.get_suptitle() == "2rpr"
    for axes, tau in zip(drawn.axes, plan().tau.T, strict=True):
        np.testing.assert_array_equal(_lines(axes, len(tau))[0], tau)
    drawn = rp.plot.comparison({"plan": plan(), "parked": computed()})
    assert drawn.get_suptitle() == "2rpr, near-singular samples left out"
    assert np.isnan(_lines(drawn.axes[0], len(computed().t))[0]).sum() == (~computed().regular).sum()


def test_series_are_told_apart_without_colour() -> None:
    for drawn in (rp.plot.efforts(plan()), rp.plot.comparison({"a": plan(), "b": computed()})):
        for axes in drawn.axes:
            curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
            assert len({str(line._dash_pattern) for line in curves}) == len(curves) > 1


def test_the_same_actuator_has_the_same_stroke_in_every_figure() -> None:
    colors = [to_hex(line.get_color()) for line in rp.plot.efforts(corner()).axes[0].lines[:3]]
    assert colors == [to_hex(line.get_color()) for line in rp.plot.plan(corner()).axes[0].lines[:3]]


def test_the_path_is_drawn_with_the_singular_points_on_the_base_line() -> None:
    axes = rp.plot.path(plan()).axes[0]
    (singular,) = [line for line in axes.lines if line.get_label() == "singular"]
    np.testing.assert_allclose(singular.get_ydata(), 0.0, atol=1e-5)  # between samples 1 ms apart
    x = 0.25 + np.array([-1.0, 1.0]) * np.sqrt(0.2**2 - 0.185**2)
    np.testing.assert_allclose(sorted(singular.get_xdata()), x, atol=1e-5)


def test_snapshots_show_the_mechanism_once_an_instant() -> None:
    view = rp.show(zoo.robot_of("2rpr"))
    drawn = rp.plot.snapshots(view, (0.0, 0.5, 1.0)).axes[0]
    middles = [
        patch.get_xy()[:-1].mean(axis=0) for patch in drawn.patches if to_hex(patch.get_facecolor()) == "#d95f0e"
    ]
    expected = []
    for t in (0.0, 0.5, 1.0):
        frame = int(np.abs(view.scene.t - t).argmin())
        for name in ("carrier_1", "carrier_2"):
            expected.append(view.scene.placement[frame, view.scene.names.index(name), :2, 3])
    np.testing.assert_allclose(middles, expected, atol=1e-9)
    _, path = drawn.collections  # white behind it
    runs = 1 + np.count_nonzero(np.diff(margin_classes(view.scene.path_margin)))
    assert len(path.get_segments()) == runs
    assert {to_hex(color) for color in path.get_colors()} == {color.lower() for color in MARGIN_COLORS}


def test_snapshots_say_what_is_what() -> None:
    view = rp.show(zoo.robot_of("3rrr"))
    drawn = rp.plot.snapshots(view, 3)
    labels = [text.get_text() for text in drawn.legends[0].get_texts()]
    assert labels == ["driven joint", "passive joint", "closure", "track", "carrier", "margin above 0.4"]
    base = [patch for patch in drawn.axes[0].patches if to_hex(patch.get_facecolor()) == "#5a5a5a"]
    assert len(base) == 1  # it does not move


def test_what_cannot_be_drawn_is_refused() -> None:
    robot = zoo.robot_of("2rpr")
    view = rp.show(robot)
    with pytest.raises(InputError, match="plane"):
        rp.plot.snapshots(view, plane="zz")
    for times in ((), (-0.1,), (99.0,), 0):
        with pytest.raises(InputError, match="motion lasts"):
            rp.plot.snapshots(view, times)
    with pytest.raises(InputError, match="robot with a motion"):
        rp.plot.path(robot)
    with pytest.raises(InputError, match="robot with a motion"):
        rp.plot.path(plan(), plan().motion)
    four_bar = zoo.robot_of("four_bar")
    with pytest.raises(InputError, match="no platform"):
        rp.plot.path(four_bar, rp.PlatformMotion([0.0], [[1.0]], [[0.0]], [[0.0]]))
    with pytest.raises(InputError, match="cannot be compared"):
        rp.plot.comparison({})
    with pytest.raises(InputError, match="cannot be compared"):
        rp.plot.comparison({"2rpr": plan(), "3rrr": corner()})
    reduced = rp.VirtualWork(robot).reduce(plan().motion[:5])
    with pytest.raises(InputError, match="5 samples of dynamics do not fit"):
        rp.plot.curves(robot, reduced, rp.distribute(reduced), plan().carriers)


def test_no_carriers_no_panel() -> None:
    robot = zoo.robot_of("2rpr", carriers=False)
    reduced = rp.VirtualWork(robot).reduce(rp.trajectory.reference.line().sample(0.05))
    curves = rp.plot.curves(robot, reduced, rp.distribute(reduced))
    assert len(rp.plot.efforts(curves).axes) == 1
    with pytest.raises(InputError, match="no carriers"):
        rp.plot.carriers(curves)


@pytest.mark.long
def test_the_same_figure_gives_the_same_svg(tmp_path: Path) -> None:
    for name in ("a", "b"):
        rp.plot.save(rp.plot.snapshots(rp.show(zoo.robot_of("2rpr"))), tmp_path / f"snapshots-{name}.svg")
    assert (tmp_path / "snapshots-a.svg").read_bytes() == (tmp_path / "snapshots-b.svg").read_bytes()


def test_a_figure_is_its_own_picture_in_a_notebook() -> None:
    drawn = rp.plot.condition(plan())
    picture, shown = drawn._repr_png_()
    assert picture[:8] == b"\x89PNG\r\n\x1a\n"
    pixels = int.from_bytes(picture[16:20], "big")  # of the width, in the header
    assert shown == {"width": round(drawn.get_figwidth() * drawn.dpi)}
    assert pixels > 1.5 * shown["width"]


@pytest.mark.parametrize("cases", range(1, 7))
def test_legends_of_comparisons_stay_on_the_page(cases: int) -> None:
    names = ["without carriers", "carriers parked", "λ = 0.5", "λ = 0", "least peak", "whole trajectory"]
    drawn = rp.plot.comparison(dict.fromkeys(names[:cases], corner()))
    drawn.canvas.draw()
    for panel in drawn.axes:
        box = panel.get_legend().get_window_extent()
        assert box.x1 <= drawn.bbox.x1
        assert box.y0 >= panel.get_window_extent().y1 - 1.0


@pytest.mark.parametrize(
    "draw", [rp.plot.efforts, rp.plot.carriers, rp.plot.condition, rp.plot.snapshots, rp.plot.locus]
)
def test_what_cannot_be_drawn_is_refused_by_its_type(draw):
    with pytest.raises(InputError, match="not a dict") as caught:
        draw({})
    assert "rp." in caught.value.remedy


def test_a_spatial_path_is_seen_obliquely_and_said_to_be_a_projection() -> None:
    robot = zoo.robot_of("gough")
    motion = zoo.smooth_motion(robot).at(np.linspace(0.0, 0.5, 26))
    oblique, flat, _ = rp.plot.path(robot, motion).axes
    towards = np.array([0.8, -1.0, 0.6]) / np.sqrt(2.0)
    seen = next(np.array(line.get_xydata()) for line in oblique.lines if line.get_label() == "path")
    moved, there = motion.x[:, :3, 3] - motion.x[0, :3, 3], seen - seen[0]
    # an orthographic picture keeps all lengths but those along the line of sight, and up is up
    np.testing.assert_allclose((there**2).sum(axis=1), (moved**2).sum(axis=1) - (moved @ towards) ** 2, atol=1e-12)
    upward = np.array([*(-towards[2] * towards[:2]), 1.0 - towards[2] ** 2]) / np.hypot(*towards[:2])
    np.testing.assert_allclose(there[:, 1], moved @ upward, atol=1e-9)
    path = next(line for line in flat.lines if line.get_label() == "path")
    np.testing.assert_allclose(path.get_xydata(), motion.x[:, :2, 3], atol=1e-9)
    assert flat.get_title() == "path, projection on x, y"
    assert {text.get_text() for text in oblique.texts} >= {"x", "y", "z", "axes: 0.1 m"}


def test_snapshots_of_a_spatial_machine_are_not_flattened_without_a_word() -> None:
    view = rp.show(zoo.robot_of("gough"))
    assert {"x", "y", "z"} <= {text.get_text() for text in rp.plot.snapshots(view, 1, plane="3d").axes[0].texts}
    assert rp.plot.snapshots(view, 1).axes[0].get_title() == "gough, projection on x, y"
    assert rp.plot.snapshots(view, 1, plane="xz").axes[0].get_title() == "gough, projection on x, z"
    planar = rp.plot.snapshots(rp.show(zoo.robot_of("2rpr")), 1).axes[0]
    assert (planar.get_xlabel(), "projection" in planar.get_title()) == ("x [m]", False)


def test_the_origin_of_a_floating_joint_is_no_hinge(tmp_path: Path) -> None:
    robot = moving.floating(tmp_path, left=0.1)
    body = robot.model.getJointId("root")
    np.testing.assert_allclose(sorted(body_points(robot, body)[:, 0]), [0.1, 0.6], atol=1e-12)
    assert len(base_hinges(robot)) == 0
    scene = rp.show(robot).scene
    assert not [solid for solid in scene.solids if solid.role == "base"]
    rp.plot.snapshots(scene, 2)
