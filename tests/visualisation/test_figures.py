"""``rp.plot``: what each figure draws is what was computed, with units, limits, phases and singular instants."""

from __future__ import annotations

import doctest
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from io import BytesIO
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from matplotlib import rc_context, rcParams
from matplotlib.colors import to_hex, to_rgb
from matplotlib.figure import Figure
from matplotlib.image import imread
from matplotlib.path import Path as Ring
from matplotlib.text import Text
from matplotlib.transforms import Bbox
from scipy.optimize import brentq

import redundancy_pin as rp
from redundancy_pin.errors import InputError, OutputError, PlanFileError
from redundancy_pin.planners.limits import LimitReport
from redundancy_pin.simulation import Event, Simulation, closed_state
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.trajectory import reference
from redundancy_pin.visualisation.figures.style import CARRIER_STROKES, STROKES
from redundancy_pin.visualisation.figures.time_panels import Curve, Panel, plot_panel_grid, series
from redundancy_pin.visualisation.viewer.mechanism import base_hinges, links
from redundancy_pin.visualisation.viewer.scene import MARGIN_COLORS, margin_classes

EDGE = 1.5
"""Pixels by which the box of a text may be larger than its visible part: ascenders and descenders it has not."""


@cache
def plan() -> rp.Plan:
    """The 2-RPR through its singular line: it leaves a track, exceeds accelerations, and has several phases."""
    dynamics = rp.VirtualWork(zoo.robot_of("2rpr"))
    return rp.plan_switch_off(dynamics, reference.circle(speed=0.6), threshold=7.0, mesh=rp.Mesh(dt=0.004))


@cache
def corner() -> rp.Plan:
    return rp.plan_stepwise(rp.VirtualWork(zoo.robot_of("3rrr")), reference.corner(radius=0.025).sample(0.01))


@cache
def computed() -> rp.plot.Curves:
    robot, trajectory = zoo.robot_of("2rpr"), reference.circle()
    reduced = rp.VirtualWork(robot).reduce(trajectory.sample(dt=0.004))
    crossings = rp.find_crossings(robot, trajectory)
    return rp.plot.curves(robot, reduced, rp.distribute(reduced), crossings=crossings, thresholds=(5.0, 20.0))


@cache
def run() -> tuple[rp.Robot, rp.Plan, Simulation]:
    """A plan, and its simulation on a machine whose carriers are heavier than planned."""
    planned, heavier = rp.load_robot("3rrr"), rp.load_robot("3rrr", carrier_mass=2.4)
    followed = rp.plan_stepwise(rp.VirtualWork(planned), reference.corner(radius=0.025).sample(0.01))
    return heavier, followed, rp.simulate(heavier, followed, duration=0.4, dt=0.02, rtol=1e-5, atol=1e-7)


@cache
def locus_of(name: str) -> Any:
    return rp.singular_locus(zoo.robot_of(name), resolution=12)


@cache
def five_bars_workspace() -> Any:
    return rp.workspace("five_bar", bounds=[(-0.6, 1.1), (-1.0, 1.0)], resolution=8, modes="all")


@cache
def spatial_path() -> Figure:
    robot = zoo.robot_of("gough")
    return rp.plot.path(robot, zoo.smooth_motion(robot).at(np.linspace(0.0, 0.5, 26)))


FIGURES: dict[str, Callable[[], Figure]] = {
    "plan of a crossing": lambda: rp.plot.overview(plan()),
    "plan of a corner": lambda: rp.plot.overview(corner()),
    "efforts": lambda: rp.plot.efforts(plan()),
    "carriers": lambda: rp.plot.carriers(corner()),
    "condition": lambda: rp.plot.condition(computed()),
    "path of a crossing": lambda: rp.plot.path(plan()),
    "spatial path": spatial_path,
    "simulation": lambda: rp.plot.overview(run()[2], run()[1]),
    "snapshots of a crossing": lambda: rp.plot.snapshots(rp.show(plan())),
    "comparison": lambda: rp.plot.comparison({"plan": plan(), "parked": computed()}),
    "six in comparison": lambda: rp.plot.comparison(dict.fromkeys(
        ["without carriers", "carriers parked", "λ = 0.5", "λ = 0", "least peak", "whole trajectory"], corner())),
    "locus": lambda: rp.plot.workspace(locus_of("2rpr")),
    "locus of one coordinate": lambda: rp.plot.workspace(locus_of("four_bar")),
    "workspace": lambda: rp.plot.workspace(five_bars_workspace()),
    "workspace of one coordinate": lambda: rp.plot.workspace(rp.workspace("four_bar", resolution=12)),
    "workspace in space": lambda: rp.plot.workspace(rp.workspace("delta", resolution=5)),
}  # fmt: skip


@pytest.mark.long_for("plan of a corner", "snapshots of a crossing", "workspace", "efforts", "locus of one coordinate",
                      "carriers", "condition", "simulation", "comparison", "locus")  # fmt: skip
@pytest.mark.parametrize("name", FIGURES)
def test_titles_labels_and_legends_are_whole_and_apart_and_axes_have_units(name: str) -> None:
    drawn = FIGURES[name]()
    drawn.draw_without_rendering()
    things: list[tuple[str, Any]] = [("suptitle", drawn._suptitle), *enumerate(drawn.legends)]
    for axes in drawn.axes:
        parts = (axes.title, axes.xaxis.label, axes.yaxis.label, axes.get_legend())
        things += [(str(part), part) for part in parts if part and axes.get_visible() and axes.axison]
    shown = {name: thing for name, thing in things if not isinstance(thing, Text) or thing.get_text()}
    boxes = {name: thing.get_window_extent() for name, thing in shown.items()}
    for what, box in boxes.items():
        assert min(box.x0, box.y0) > -EDGE, what
        assert (np.array([box.x1, box.y1]) < np.array([drawn.bbox.x1, drawn.bbox.y1]) + EDGE).all(), what
    for (first, a), (second, b) in combinations(boxes.items(), 2):
        over = Bbox.intersection(a, b)
        assert over is None or min(over.width, over.height) < EDGE, f"{first} over {second}"
    for axes in (axes for axes in drawn.axes if axes.axison and axes.get_visible()):
        assert "[" in axes.get_ylabel()
        assert "…" not in axes.get_ylabel()  # no label of the package is so long that it is cut
    assert "[" in drawn.axes[-1].get_xlabel() + drawn.axes[-1].get_ylabel()


@pytest.mark.long_for("video", "workspace")
@pytest.mark.parametrize("name", [name for name in rp.plot.__all__ if name not in ("Curves", "save")])
def test_the_example_of_every_function_runs(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (example,) = doctest.DocTestFinder(recurse=False).find(getattr(rp.plot, name), name, globs={"rp": rp})
    assert example.examples
    assert doctest.DocTestRunner().run(example).failed == 0


# --- curves over time -------------------------------------------------------------------------------------------------


def _panel(drawn: Figure, label: str) -> Any:
    return next(axes for axes in drawn.axes if axes.get_ylabel().startswith(label))


def _lines(axes: Any, samples: int) -> np.ndarray:
    """Return (N, curves) the curves with so many samples."""
    return np.stack([np.asarray(line.get_ydata()) for line in axes.lines if len(line.get_xdata()) == samples], axis=1)


def _verticals(axes: Any) -> list[float]:
    return sorted(float(line.get_xdata()[0]) for line in axes.lines if line.get_label() == "singular instant")


def _horizontals(axes: Any) -> set[float]:
    return {float(line.get_ydata()[0]) for line in axes.lines if list(line.get_xdata()) == [0, 1]}


def _bands(axes: Any) -> list[tuple[float, float]]:
    """Return bottom and top of each hatched band beyond a limit."""
    hatched = [patch for patch in axes.patches if patch.get_label() == "beyond a limit"]
    return sorted((float(p.get_xy()[1]), float(p.get_xy()[1] + p.get_height())) for p in hatched)


def _legend(drawn: Any) -> list[str]:
    """Return the legend under a figure, or above a panel."""
    legend = drawn.legends[0] if isinstance(drawn, Figure) else drawn.get_legend()
    return [text.get_text() for text in legend.get_texts()]


def _texts(axes: Any) -> list[str]:
    return [text.get_text() for text in axes.texts]


PANELS = {
    "main": lambda one: one.tau,
    "carrier force": lambda one: one.carrier_force,
    "carrier position s [m]": lambda one: one.carriers.s,
    "carrier speed ṡ [m/s]": lambda one: one.carriers.sd,
    "carrier acceleration s̈ [m/s²]": lambda one: one.carriers.sdd,
}


def test_curves_are_the_arrays_of_the_plan_with_the_units_of_the_robot() -> None:
    one = plan()
    efforts, carriers, overview = rp.plot.efforts(one), rp.plot.carriers(one), rp.plot.overview(one)
    for label, values in PANELS.items():
        for drawn in (efforts if label in ("main", "carrier force") else carriers, overview):
            np.testing.assert_array_equal(_lines(_panel(drawn, label), len(one.t)), values(one))
    shown = _lines(_panel(overview, "condition"), len(one.t))[:, 0]
    np.testing.assert_allclose(shown[one.condition < 1e3], one.condition[one.condition < 1e3])
    assert [rp.plot.efforts(each).axes[0].get_ylabel() for each in (one, corner())] == [
        "main force [N]", "main torque [N·m]"]  # fmt: skip
    turning = replace(computed(), carriers_turn=True)
    assert rp.plot.efforts(turning).axes[1].get_ylabel() == "carrier torque [N·m]"
    assert rp.plot.carriers(turning).axes[1].get_ylabel() == "carrier speed ṡ [rad/s]"
    robot = zoo.robot_of("2rpr", carriers=False)
    reduced = rp.VirtualWork(robot).reduce(reference.line().sample(0.05))
    bare = rp.plot.curves(robot, reduced, rp.distribute(reduced))
    assert len(rp.plot.efforts(bare).axes) == 1
    with pytest.raises(InputError, match="no carriers"):
        rp.plot.carriers(bare)


def test_values_beyond_limits_are_hatched_and_far_limits_are_written() -> None:
    """The plan leaves its track of ±0.2 m and exceeds 10 m/s²; it comes near to 2.5 m/s on one side only."""
    drawn = rp.plot.overview(plan())
    track, speed, acceleration = (_panel(drawn, f"carrier {name}") for name in ("position", "speed", "acceleration"))
    assert _horizontals(track) == {-0.2}
    assert _bands(track) == [pytest.approx((track.get_ylim()[0], -0.2))]
    assert _bands(speed) == [pytest.approx((2.5, speed.get_ylim()[1]))]
    low, high = acceleration.get_ylim()
    assert _bands(acceleration) == [pytest.approx((low, -10.0)), pytest.approx((10.0, high))]
    assert "limits ±1000" in _texts(_panel(drawn, "carrier force"))
    (mark,) = [line for line in track.lines if line.get_marker() == "X"]
    (event,) = (one for one in plan().limits.violated if one.quantity == "track")
    assert mark.get_xydata().tolist() == [[event.worst, event.value]]
    assert _texts(track) == [f"{event.amount:.2g} beyond"]
    assert f"(acceleration of carrier_1, carrier_2; track of {event.joint})" in drawn.get_suptitle()


def test_limits_that_differ_are_named_and_effort_limits_are_drawn() -> None:
    judged, bound = plan().limits.judged_by, 0.9 * float(np.abs(plan().tau).max())
    wider = replace(judged, track=np.array([[-0.2, 0.1], [-0.25, np.inf]]), effort=np.array([bound, np.inf]))
    limited = replace(plan(), limits=LimitReport((), (), wider))
    axes = _panel(rp.plot.overview(limited), "carrier position")
    assert _horizontals(axes) == {-0.2, -0.25}
    assert set(_texts(axes)) == {"limit of carrier_1", "limit of carrier_2"}
    assert _bands(axes) == [pytest.approx((axes.get_ylim()[0], -0.25))]  # beyond both
    for drawn in (rp.plot.efforts(limited), rp.plot.overview(limited, corner_like(limited))):
        axes = _panel(drawn, "main force")
        assert set() < _horizontals(axes) <= {-bound, bound}
        assert set(_texts(axes)) == {"limit of slide_1"}  # the other actuator has none
        assert _bands(axes) == []


def corner_like(one: rp.Plan) -> rp.Plan:
    """Another plan for the same robot, half as strong."""
    return replace(one, tau=0.5 * one.tau)


def test_phases_are_shaded_from_one_to_the_next_and_named() -> None:
    for one, draw in product((plan(), corner()), (rp.plot.overview, rp.plot.condition)):
        drawn, starts = draw(one), [0, *(np.flatnonzero(np.diff(one.phase)) + 1).tolist()]
        shades = [patch for patch in drawn.axes[0].patches if not patch.get_hatch()]
        assert [float(patch.get_x()) for patch in shades] == [float(one.t[start]) for start in starts]
        ends = [float(patch.get_x() + patch.get_width()) for patch in shades]
        np.testing.assert_allclose(ends, one.t[[*starts[1:], -1]], rtol=1e-12)
        greys = np.array([patch.get_facecolor()[:3] for patch in shades])
        assert np.ptp(greys, axis=1).max() == 0.0
        (legend,) = drawn.legends
        swatches = [patch for patch in legend.get_patches() if not patch.get_hatch()]
        assert {to_hex(patch.get_edgecolor()) for patch in swatches} == {"#777777"}  # a white one is seen, too
        assert min(patch.get_linewidth() for patch in (*swatches, *shades)) > 0.0
        assert np.abs(np.diff(greys[:, 0])).min() > 0.02  # a fiftieth from black to white, and a hairline between them
        assert set(_legend(drawn)) >= {one.phases[int(one.phase[start])].replace("_", " ") for start in starts}


def test_singular_instants_and_near_singular_intervals_are_where_the_circle_meets_the_line_of_the_base() -> None:
    """The 2-RPR is singular at y = 0; the times are found here from the trajectory alone."""
    trajectory = reference.circle()

    def height(t: float) -> float:
        return float(trajectory.evaluate(t).x[1])

    lowest = float(trajectory.sample(0.001).t[np.argmin(trajectory.sample(0.001).x[:, 1])])
    expected = [brentq(height, 0.2, lowest, xtol=1e-13), brentq(height, lowest, 1.2, xtol=1e-13)]
    for drawn in (rp.plot.condition(computed()), rp.plot.efforts(computed()), rp.plot.carriers(computed())):
        for axes in drawn.axes:
            np.testing.assert_allclose(_verticals(axes), expected, atol=1e-9)
    axes = rp.plot.condition(computed()).axes[0]
    assert _legend(rp.plot.condition(computed())) == ["singular instant", "near-singular"]
    np.testing.assert_array_equal(_verticals(rp.plot.condition(plan()).axes[0]), plan().findings.singular_instants)
    inside = np.zeros(len(computed().t), dtype=bool)
    for patch in axes.patches:
        inside |= (computed().t >= patch.get_x()) & (computed().t <= patch.get_x() + patch.get_width())
    np.testing.assert_array_equal(inside, computed().margin < 0.05)


def test_thresholds_of_condition_numbers_are_drawn_and_named() -> None:
    axes = rp.plot.condition(computed()).axes[0]
    assert _horizontals(axes) == {5.0, 20.0}
    assert {"threshold 5", "threshold 20"} <= set(axes.get_legend_handles_labels()[1])
    assert _horizontals(rp.plot.condition(plan()).axes[0]) == {7.0}
    other = replace(plan(), parameters={"threshold": 0.1, "measure": "margin"})
    assert _horizontals(_panel(rp.plot.overview(other), "condition")) == set()
    assert (axes.get_yscale(), rp.plot.condition(corner()).axes[0].get_yscale()) == ("log", "linear")


def test_unbounded_efforts_do_not_flatten_the_others_and_a_comparison_leaves_them_out() -> None:
    regular = np.abs(computed().tau[computed().regular]).max()
    assert np.nanmax(np.abs(computed().tau)) > 2.0 * regular
    parked = rp.plot.comparison({"parked": computed()})
    for drawn in (rp.plot.efforts(computed()), parked):
        assert drawn.axes[0].get_ylim()[1] < 1.2 * regular
    assert parked.get_suptitle() == "2rpr, near-singular samples left out"
    assert np.isnan(_lines(parked.axes[0], len(computed().t))[:, 0]).sum() == (~computed().regular).sum()
    near = np.full(len(plan().t), SampleStatus.NEAR_SINGULAR)  # of a plan all samples count
    drawn = rp.plot.comparison({"plan": replace(plan(), sample_status=near)})
    assert drawn.get_suptitle() == "2rpr"
    for axes, tau in zip(drawn.axes, plan().tau.T, strict=True):
        np.testing.assert_array_equal(_lines(axes, len(tau))[:, 0], tau)
        assert _legend(axes) == [f"plan: peak {np.abs(tau).max():.3g} N"]
    robot = zoo.robot_of("3rrr")  # samples without efforts are not "left out"
    reduced = rp.VirtualWork(robot).reduce(reference.corner().sample(0.01))
    largest = np.abs(rp.distribute(reduced).tau).max()
    bounded = rp.distribute(reduced, lower=-0.5 * largest, upper=0.5 * largest)
    assert set(bounded.status.tolist()) == {SampleStatus.OK, SampleStatus.BOUND_INFEASIBLE}
    assert rp.plot.comparison({"bounded": rp.plot.curves(robot, reduced, bounded)}).get_suptitle() == "3rrr"


def test_series_differ_without_colour_and_keep_their_strokes() -> None:
    for drawn in (rp.plot.efforts(plan()), rp.plot.comparison({"a": plan(), "b": computed()})):
        for axes in drawn.axes:
            curves = [line for line in axes.lines if len(line.get_xdata()) > 2]
            assert len({str(line._dash_pattern) for line in curves}) == len(curves) > 1
    colors = [stroke["color"] for stroke in (*STROKES, *CARRIER_STROKES)]
    assert len(set(colors)) == len(colors)
    for drawn in (rp.plot.efforts(corner()), rp.plot.overview(corner())):
        assert [line.get_color() for line in drawn.axes[0].lines[:3]] == colors[:3]
        carriers = [line.get_color() for line in _panel(drawn, "carrier force").lines[:3]]
        assert carriers == [stroke["color"] for stroke in CARRIER_STROKES[:3]]


def _pixels(drawn: Figure, *colors: str) -> list[int]:
    """Return how many pixels within the first axes have nearly each colour, in the picture that a notebook shows."""
    picture = imread(BytesIO(drawn._repr_png_()[0]))[::-1, :, :3]
    scale = picture.shape[0] / drawn.bbox.height
    x0, y0, x1, y1 = (int(scale * edge) for edge in drawn.axes[0].get_window_extent().extents)
    return [int((np.abs(picture[y0:y1, x0:x1] - to_rgb(color)).max(axis=2) < 0.1).sum()) for color in colors]


def test_a_sample_without_neighbours_is_a_point() -> None:
    apart = np.abs(computed().tau[:, 0] - computed().tau[:, 1])
    k = int(np.argmax(np.where(computed().regular, apart, 0.0)))  # the actuators have different efforts
    names = ("t", "tau", "carrier_force", "condition", "margin", "status", "carriers")
    one = replace(computed(), **{name: getattr(computed(), name)[k : k + 1] for name in names})
    lone = np.where(np.arange(len(computed().t)) == k, 1.0, np.nan)[:, None] * computed().tau
    for each in (one, replace(computed(), tau=lone)):
        assert min(_pixels(rp.plot.efforts(each), *(stroke["color"] for stroke in STROKES[:2]))) > 10
    robot, motion = zoo.robot_of("2rpr"), reference.circle().sample(0.01)[:1]
    assert _pixels(rp.plot.path(robot, motion), STROKES[0]["color"])[0] > 10
    (start,) = [line for line in rp.plot.snapshots(rp.show(robot, motion), 1).axes[0].lines if line.get_zorder() == 4.1]
    np.testing.assert_allclose(start.get_xydata(), motion.x, atol=1e-9)
    axes = rp.plot.workspace(locus_of("2rpr"), motion=motion.x).axes[0]
    assert next(line for line in axes.lines if line.get_label() == "motion").get_marker() == "o"


def test_bounds_of_efforts_are_drawn_and_samples_without_efforts_within_them_are_shaded() -> None:
    robot, bound = zoo.robot_of("2rpr"), 0.45
    motion = reference.circle().sample(0.002)
    reduced = rp.VirtualWork(robot).reduce(motion)
    solved = rp.distribute(reduced, lower=[-bound, -1.2 * bound], upper=bound)
    drawn = rp.plot.efforts(rp.plot.curves(robot, reduced, solved, bounds=[(-bound, bound), (-1.2 * bound, bound)]))
    axes = drawn.axes[0]
    assert _horizontals(axes) == {bound, -bound, -1.2 * bound}
    assert _bands(axes)[0][1] == pytest.approx(-1.2 * bound)
    assert _bands(axes)[-1][0] == pytest.approx(bound)
    assert {"no efforts", "beyond a limit"} <= set(_legend(drawn))
    shaded = np.zeros(len(motion), dtype=bool)
    for patch in (patch for patch in axes.patches if patch.get_label() == "no efforts"):
        shaded |= (motion.t > patch.get_x()) & (motion.t < patch.get_x() + patch.get_width())
        assert patch.get_facecolor()[3] == 0.0  # near-singular intervals show behind it
    np.testing.assert_array_equal(shaded, solved.status == SampleStatus.BOUND_INFEASIBLE)
    assert 0 < shaded.sum() < len(shaded)
    one_sided = rp.plot.efforts(rp.plot.curves(robot, reduced, solved, bounds=[(-np.inf, bound)] * 2))
    assert _horizontals(one_sided.axes[0]) == {bound}
    far = rp.plot.efforts(rp.plot.curves(robot, reduced, rp.distribute(reduced), bounds=[(-np.inf, 50.0)] * 2))
    assert "limit ≤ 50" in _texts(far.axes[0])
    for wrong in ([(-1.0, 1.0)] * 3, [1.0, 2.0], [(np.nan, 1.0)] * 2):
        with pytest.raises(InputError, match="do not fit 2 actuators"):
            rp.plot.curves(robot, reduced, solved, bounds=wrong)


def test_a_figure_of_ones_own_is_a_list_of_panels() -> None:
    """Rows of panels that share a scale, a mark with its text, an axis with given ends."""
    t = np.linspace(0.0, 1.0, 11)
    columns = [
        [
            Panel("P [W]", series(["P1", "P2"], t, np.stack([t, factor * t], axis=1)), legend=False, shared=True),
            Panel("e [m]", (Curve("error", t, 1e-6 * t),), log=True, within=(1e-9, 1e-3),
                  marks=((1.0, 1e-6, "largest"),), title=f"factor {factor}"),
        ]
        for factor in (2.0, 5.0)
    ]  # fmt: skip
    drawn = plot_panel_grid("title", columns, computed(), size=(8.0, 5.0))
    above_left, above_right, below_left, below_right = drawn.axes
    assert above_left.get_ylim() == above_right.get_ylim()
    assert above_left.get_ylim()[1] == pytest.approx(5.0 * 1.08)
    assert (below_left.get_ylim(), below_right.get_title()) == ((1e-9, 1e-3), "factor 5.0")
    assert _texts(below_left) == ["largest"]
    assert _legend(drawn) == ["P1", "P2", "singular instant", "near-singular"]


# --- simulations ------------------------------------------------------------------------------------------------------


def test_a_simulation_is_drawn_over_its_plan() -> None:
    robot, followed, simulated = run()
    drawn = rp.plot.overview(simulated, followed)
    assert drawn.get_suptitle() == "3rrr: simulation, stepwise, limit violated"
    for label, values in PANELS.items():
        axes = _panel(drawn, label)
        np.testing.assert_array_equal(_lines(axes, len(followed.t)), values(followed))
        np.testing.assert_array_equal(_lines(axes, len(simulated.t)), values(simulated))
    assert _legend(drawn.axes[0]) == ["plan", "base_1", "base_2", "base_3"]
    # the corner in closed form, not the plan's own functions
    apart = simulated.x - reference.corner(radius=0.025).evaluate(simulated.t).x
    expected = np.linalg.norm(apart * [1.0, 1.0, robot.characteristic_length], axis=1)
    (line,) = _panel(drawn, "distance of the platform").lines
    np.testing.assert_allclose(line.get_ydata()[1:], expected[1:], rtol=1e-9, atol=1e-13)
    assert expected.max() > 1e-3  # heavier carriers do lead it astray
    assert len(rp.plot.overview(simulated).axes) == 5  # without a plan there is no distance
    motion = rp.PlatformMotion(simulated.t, simulated.x, simulated.xd, 0.0 * simulated.xd, check_rates=False)
    solved = rp.distribute(rp.RneaDynamics(robot).reduce(motion, simulated.carriers))
    shown = rp.plot.condition(simulated, robot=robot).axes[0].lines[0].get_ydata()
    np.testing.assert_allclose(shown, solved.condition, rtol=1e-9)
    scene = rp.show(simulated, robot=robot).scene
    np.testing.assert_allclose(scene.path_margin, np.abs(solved.margin), rtol=1e-9)


def test_a_simulation_has_its_end_in_the_title_and_is_drawn_without_its_robot_as_far_as_possible() -> None:
    robot, followed, simulated = run()
    stopped = replace(simulated, status=ResultStatus.STOPPED, events=(Event("track", "carrier_2 lower", 0.4, True),))
    failed = replace(simulated, status=ResultStatus.NOT_CONVERGED, reason="rank loss")
    titles = [rp.plot.efforts(one).get_suptitle().partition("stepwise, ")[2] for one in (stopped, failed)]
    assert titles == ["stopped at 0.4 s: carrier_2 lower", "failed at 0.4 s"]
    gone = replace(simulated, robot=replace(simulated.robot, source="nowhere/robot.yaml"))
    np.testing.assert_array_equal(rp.plot.efforts(gone).axes[0].lines[0].get_ydata(), simulated.tau[:, 0])
    with pytest.raises(InputError, match="condition number is not known"):
        rp.plot.condition(gone)
    with pytest.raises(PlanFileError):
        rp.show(gone)
    assert rp.show(gone, robot=robot).scene.duration == pytest.approx(0.4)
    other = replace(followed, robot=replace(followed.robot, name="2rpr", actuated=("a", "b", "c")))
    with pytest.raises(InputError, match="The plan of a simulation"):
        rp.plot.overview(simulated, simulated)  # type: ignore[arg-type]
    with pytest.raises(InputError, match="plan is for 2rpr, the simulation of 3rrr"):
        rp.plot.overview(simulated, other)
    with pytest.raises(InputError, match=r"plan runs from 0 to .* s, the simulation from 9 to 9.4 s"):
        rp.plot.overview(replace(simulated, t=simulated.t + 9.0), followed)


def test_forces_and_impulses_of_joint_stops_are_drawn(tmp_path: Path) -> None:
    """A bar that falls onto a stop: m g c cos φ holds it there."""
    moments = '<inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/>'
    inertial = f'<inertial><origin xyz="0.2 0 0"/><mass value="1.5"/>{moments}</inertial>'
    (tmp_path / "bar.urdf").write_text(
        f'<robot name="bar"><link name="base"/><link name="bar">{inertial}</link><joint name="hinge" type="revolute">'
        '<parent link="base"/><child link="bar"/><axis xyz="0 0 1"/>'
        '<limit lower="-0.5" upper="2" effort="10" velocity="10"/></joint></robot>'
    )
    robot = rp.load_robot(tmp_path / "bar.urdf", gravity=(0, -9.81, 0), actuated="hinge")
    start = closed_state(robot, [0.3], [0.0])
    ended = rp.simulate(robot, start=start, duration=0.1, dt=0.01)
    assert len(rp.plot.overview(ended, robot=robot).axes) == 1
    fell = rp.simulate(robot, start=start, duration=1.0, dt=0.01, joint_stops="inelastic")
    (impact,) = (event for event in fell.events if event.impulse)
    _, axes = rp.plot.overview(fell, robot=robot).axes
    force = next(line.get_ydata() for line in axes.lines if len(line.get_ydata()) == len(fell))
    np.testing.assert_array_equal(force, fell.stop_force[:, 0])
    assert force[-1] == pytest.approx(1.5 * 9.81 * 0.2 * np.cos(-0.5), rel=1e-9)
    mark = next(line for line in axes.lines if line.get_marker() == "X")
    assert mark.get_xdata() == [impact.t]
    assert f"{impact.impulse:.3g} N·s" in axes.texts[0].get_text()
    assert axes.get_legend_handles_labels()[1] == ["hinge"]


# --- paths, snapshots, maps -------------------------------------------------------------------------------------------


def test_the_path_is_drawn_with_the_singular_points_on_the_base_line() -> None:
    axes = rp.plot.path(plan()).axes[0]
    (singular,) = [line for line in axes.lines if line.get_label() == "singular"]
    np.testing.assert_allclose(singular.get_ydata(), 0.0, atol=1e-5)  # between samples 4 ms apart
    x = 0.25 + np.array([-1.0, 1.0]) * np.sqrt(0.2**2 - 0.185**2)
    np.testing.assert_allclose(sorted(singular.get_xdata()), x, atol=1e-5)


def test_a_spatial_path_is_seen_obliquely_and_titled_a_projection() -> None:
    robot = zoo.robot_of("gough")
    motion = zoo.smooth_motion(robot).at(np.linspace(0.0, 0.5, 26))
    oblique, flat, _ = spatial_path().axes
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
    assert set(_texts(oblique)) >= {"x", "y", "z", "axes: 0.1 m"}
    view = rp.show(robot, motion)
    assert rp.plot.snapshots(view, 1, plane="xz").axes[0].get_title() == "gough, projection on x, z"
    assert {"x", "y", "z"} <= set(_texts(rp.plot.snapshots(view, 1, plane="3d").axes[0]))


def test_snapshots_show_the_mechanism_at_each_instant_and_its_margins() -> None:
    scene = zoo.view_of("2rpr").scene
    drawn = rp.plot.snapshots(scene, (0.0, 0.5, 1.0))
    axes = drawn.axes[0]
    boxes = [patch for patch in axes.patches if to_hex(patch.get_facecolor()) == "#d95f0e"]
    expected = []
    for t in (0.0, 0.5, 1.0):
        frame = int(np.abs(scene.t - t).argmin())
        expected += [scene.placement[frame, scene.names.index(name), :2, 3] for name in ("carrier_1", "carrier_2")]
    np.testing.assert_allclose([box.get_xy()[:-1].mean(axis=0) for box in boxes], expected, atol=1e-9)
    path = [line for line in axes.lines if str(line.get_label()).startswith("margin")]
    assert len(path) == 1 + np.count_nonzero(np.diff(margin_classes(scene.path_margin)))
    assert {line.get_color() for line in path} == set(MARGIN_COLORS)
    np.testing.assert_allclose(np.concatenate([path[0].get_xydata(), path[1].get_xydata()[:1]])[[0, -2]],
                               scene.path[[0, len(path[0].get_xydata()) - 1], :2])  # fmt: skip
    labels = {"driven joint", "passive joint", "loop joint", "track", "carrier"}
    assert set(_legend(drawn)) == labels | {str(line.get_label()) for line in path}
    assert sum(to_hex(patch.get_facecolor()) == "#5a5a5a" for patch in axes.patches) == 1  # the base does not move


@pytest.mark.parametrize("name", ["2rpr", "3rrr"])
def test_a_locus_draws_its_curves_hinges_motion_and_crossings(name: str) -> None:
    locus, trajectory = locus_of(name), reference.circle() if name == "2rpr" else reference.corner()
    crossings = rp.find_crossings(zoo.robot_of(name), trajectory)
    axes = rp.plot.workspace(locus, motion=trajectory.sample(0.01).x, crossings=crossings).axes[0]
    drawn = [np.stack(line.get_data(), axis=1) for line in axes.get_lines()]
    hinges = {"2rpr": [[0.0, 0.0], [0.5, 0.0]], "3rrr": [[0.0, 0.0], [3.0**0.5, 0.0], [3.0**0.5 / 2, 1.5]]}[name]
    for wanted in (*(curve.points[:, :2] for curve in locus.curves), hinges, trajectory.sample(0.01).x[:, :2]):
        assert any(len(line) == len(wanted) and np.allclose(line, wanted) for line in drawn)
    marked = [line.get_xydata() for line in axes.lines if line.get_label() == "singular instant"]
    np.testing.assert_allclose(
        marked[0] if marked else np.zeros((0, 2)), [c.x[:2] for c in crossings] or np.zeros((0, 2))
    )
    kinds = {str(line.get_label())[:7].strip(): str(line.get_linestyle()) for line in axes.lines}
    assert kinds["type II"] != kinds.get("type I")
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")


def test_a_locus_and_a_workspace_of_one_coordinate_are_curves() -> None:
    robot = zoo.robot_of("four_bar", ground_length=0.4, crank_length=0.3, coupler_length=0.35, rocker_length=0.2)
    locus = rp.singular_locus(robot, resolution=20)
    axes = rp.plot.workspace(locus).axes[0]
    assert axes.get_xlabel() == "crank [rad]"
    verticals = [line.get_xdata()[0] for line in axes.lines if str(line.get_label()).startswith("combined")]
    np.testing.assert_allclose(verticals, locus.points[:, 0])
    space = rp.workspace(robot, resolution=24)
    space = replace(space, in_range=space.in_range & (np.arange(24) % 5 > 0))  # as ranges of joints would have it
    curves = [np.asarray(line.get_ydata(), dtype=float) for line in rp.plot.workspace(space).axes[0].lines]
    shown = np.nanmax(np.stack(curves), axis=0, where=~np.isnan(curves), initial=-1.0)
    np.testing.assert_allclose(shown, np.where(space.in_range[0], np.abs(space.margin[0]), -1.0))


def test_a_workspace_colours_margins_and_hatches_the_rest() -> None:
    space = five_bars_workspace()
    drawn = rp.plot.workspace(space)
    for k, axes in enumerate(drawn.axes[: len(space.modes)]):
        image = next(one for one in axes.collections if one.get_array() is not None and one.get_array().size == 64)
        shown = np.ma.filled(image.get_array().astype(float), np.nan).reshape(8, 8)
        np.testing.assert_array_equal(shown.T, np.where(space.in_range[k], np.abs(space.margin[k]), np.nan))
        (hatched,) = [one for one in axes.collections if any(getattr(one, "hatches", ()))]
        nodes = np.stack(np.meshgrid(*space.axes, indexing="ij"), axis=-1).reshape(-1, 2)
        rings = [Ring(corners) for path in hatched.get_paths() for corners in path.to_polygons()]  # holes among them
        inside = np.sum([ring.contains_points(nodes) for ring in rings], axis=0) % 2 == 1
        np.testing.assert_array_equal(inside, ~space.reachable[k].ravel())
    assert "out of reach" in _legend(drawn)


def test_the_sketches_are_the_links_of_the_machines() -> None:
    three, four = zoo.robot_of("3rrr"), zoo.robot_of("four_bar")
    lengths = [sorted(float(np.linalg.norm(b - a)) for a, b in links(one, one.q_reference)) for one in (three, four)]
    assert lengths[0] == pytest.approx([0.25 * np.sqrt(3.0)] * 3 + [1.0] * 6)
    assert lengths[1] == pytest.approx(sorted([0.1, 0.35, 0.25]))
    np.testing.assert_allclose(np.ptp(base_hinges(four), axis=0), [0.4, 0.0, 0.0], atol=1e-12)
    two = zoo.robot_of("2rpr")  # a barrel is a line to where its rod has slid to
    ends = [np.array(pair)[:, :2] for pair in links(two, two.q_reference)]
    for hinge in ([0.0, 0.0], [0.5, 0.0]):
        assert any(np.allclose(pair, [hinge, zoo.home_of(two)], atol=1e-9) for pair in ends)


# --- files, notebooks, refusals ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", [".png", ".svg", ".pdf"])
def test_a_picture_is_whole_in_the_format_of_its_suffix_or_not_there(tmp_path: Path, suffix: str) -> None:
    drawn, target = rp.plot.condition(corner()), tmp_path / f"condition{suffix}"
    rp.plot.save(drawn, target)
    head = target.read_bytes()[:200]
    assert {".png": b"\x89PNG", ".svg": b"<svg", ".pdf": b"%PDF"}[suffix] in head or head.startswith(b"<?xml")
    for wrong, text in (
        (tmp_path / "a.txt", "does not end in .png or .svg or .pdf"),
        (tmp_path / "none" / f"a{suffix}", "Cannot write"),
    ):
        with pytest.raises(OutputError, match=text):
            rp.plot.save(drawn, wrong)
    assert list(tmp_path.iterdir()) == [target]


def test_a_figure_is_its_own_picture_in_a_notebook_and_leaves_settings_alone() -> None:
    with rc_context({"lines.linewidth": 9.0}):
        before = dict(rcParams)
        drawn = rp.plot.condition(plan())
        assert dict(rcParams) == before
    assert all(line.get_linewidth() < 5.0 for line in drawn.axes[0].get_lines())
    picture, shown = drawn._repr_png_()
    assert picture[:8] == b"\x89PNG\r\n\x1a\n"
    assert shown == {"width": round(drawn.get_figwidth() * drawn.dpi)}
    assert int.from_bytes(picture[16:20], "big") > 1.5 * shown["width"]  # pixels, in the header


def test_what_cannot_be_drawn_is_refused() -> None:
    robot, four_bar = zoo.robot_of("2rpr"), zoo.robot_of("four_bar")
    scene = zoo.view_of("2rpr").scene
    reduced = rp.VirtualWork(robot).reduce(plan().motion[:5])
    still = rp.PlatformMotion([0.0], [[1.0]], [[0.0]], [[0.0]])
    refused: list[tuple[str, Callable[[], object]]] = [
        ("plane", lambda: rp.plot.snapshots(scene, plane="zz")),
        *(("motion lasts", lambda times=times: rp.plot.snapshots(scene, times)) for times in ((), (-0.1,), (99.0,), 0)),
        ("robot with a motion", lambda: rp.plot.path(robot)),
        ("robot with a motion", lambda: rp.plot.path(plan(), plan().motion)),
        ("no platform", lambda: rp.plot.path(four_bar, still)),
        ("cannot be compared", lambda: rp.plot.comparison({})),
        ("cannot be compared", lambda: rp.plot.comparison({"2rpr": plan(), "3rrr": corner()})),
        ("5 samples of dynamics do not fit",
         lambda: rp.plot.curves(robot, reduced, rp.distribute(reduced), plan().carriers)),
        ("over a locus", lambda: rp.plot.workspace(five_bars_workspace(), motion=still.x)),
    ]  # fmt: skip
    for text, draw in refused:
        with pytest.raises(InputError, match=text):
            draw()
    for one in (rp.plot.efforts, rp.plot.carriers, rp.plot.condition, rp.plot.overview, rp.plot.snapshots,
                rp.plot.workspace):  # fmt: skip
        with pytest.raises(InputError, match="dict") as caught:
            one({})  # type: ignore[operator]
        assert any(word in caught.value.remedy for word in ("rp.", "load_plan"))


def test_zero_efforts_without_bounds_have_no_limit() -> None:
    """Of a massless 2-RPR without carriers; limits of carriers that are parked are written."""
    robot = rp.load_robot("2rpr", carriers=False)
    result = rp.inverse_dynamics(rp.VirtualWork(robot), reference.line().sample(0.05))
    drawn = rp.plot.efforts(rp.plot.curves(robot, result.reduced, result.efforts, bounds=result.bounds))
    assert not [text for text in _texts(drawn.axes[0]) if "limit" in text]
    still = Panel("speed", series(["s"], result.reduced.t, np.zeros((len(result.reduced.t), 1))), limits=((-7.0, 7.0),))
    assert "limits ±7" in _texts(plot_panel_grid("parked", [[still]]).axes[0])
