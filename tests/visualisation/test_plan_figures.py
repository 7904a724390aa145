"""The picture of a plan shows what the plan holds: curves, limits, phases, threshold, and every broken limit."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.patches import Patch

from redundancy_pin.motion import CarrierMotion, PlatformMotion
from redundancy_pin.planners.functions import PlanFunctions
from redundancy_pin.planners.intersample_check import Findings, IntersamplePeaks
from redundancy_pin.planners.limits import LimitEvent, LimitReport, ResolvedLimits
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.robot_record import RobotRecord
from redundancy_pin.robot import CarrierLimits
from redundancy_pin.status import ResultStatus, SampleStatus
from redundancy_pin.trajectory.continuous_motion import as_motion
from redundancy_pin.trajectory.functions_of_time import PiecewisePolynomial
from redundancy_pin.visualisation.figures.plots import plan as plot_plan
from redundancy_pin.visualisation.figures.style import save
from redundancy_pin.visualisation.figures.time_panels import phase_spans

T = np.linspace(0.0, 1.0, 101)
PHASES = ("parked", "ramp_down", "off", "return")
LIMITS = CarrierLimits(lower=-0.2, upper=0.2, speed=1.0, acceleration=9.0, force=1000.0)


def _limits(*carriers: CarrierLimits) -> ResolvedLimits:
    """Return the limits of carriers c1, c2, ... and two main actuators without limits."""
    k = len(carriers)
    track = np.reshape([(one.lower, one.upper) for one in carriers], (k, 2))
    rates = (np.array([getattr(one, name) for one in carriers]) for name in ("speed", "acceleration", "force"))
    return ResolvedLimits(
        tuple(f"c{i + 1}" for i in range(k)), track, *rates, np.full(k, np.inf), np.full(2, np.inf), np.full(2, np.inf)
    )


def _plan(**changes: Any) -> Plan:
    """Return a synthetic plan whose first carrier leaves its track by 0.05 m at t = 0.5 s."""
    wave = np.sin(np.pi * T)
    s = np.stack([0.25 * wave, -0.1 * wave], axis=1)
    tau = np.stack([3.0 * wave, -2.0 * wave], axis=1)
    phase = np.select([T < 0.2, T < 0.3, T < 0.7, T < 0.9], [0, 1, 2, 3], 0)
    zero = np.zeros((len(T), 2))
    status = np.zeros(len(T), dtype=np.intp)
    status[50], tau[50] = SampleStatus.SINGULAR_INCONSISTENT, np.nan
    status[49], tau[49] = SampleStatus.NEAR_SINGULAR, 1e6
    condition = 1.0 / np.maximum(np.abs(T - 0.5), 1e-300)
    condition[50] = np.inf
    event = LimitEvent("c1", "track", 0.3, 0.7, 0.5, 0.25, 0.2, 0.05)
    record = RobotRecord(
        name="robot",
        source="",
        arguments={},
        gravity=(0.0, 0.0, 0.0),
        working_mode=(),
        actuated=("a1", "a2"),
        carriers=("c1", "c2"),
        rotating=("a1", "a2"),
        carrier_limits=(LIMITS, LIMITS),
        bodies=(),
        q_reference=(),
    )
    motion = PlatformMotion(T, zero, zero, zero)
    plan = Plan(
        motion=motion,
        carriers=CarrierMotion(s, 2.0 * s, -9.0 * s),
        tau=tau,
        carrier_force=5.0 * s,
        actuated_rate=zero,
        sample_status=status,
        residual=np.zeros(len(T)),
        margin=1.0 / condition,
        condition=condition,
        phase=phase,
        phases=PHASES,
        limits=LimitReport((event,), (), _limits(LIMITS, LIMITS)),
        status=ResultStatus.LIMIT_VIOLATED,
        planner="switch_off",
        backend="Rnea",
        robot=record,
        functions=PlanFunctions(as_motion(motion), PiecewisePolynomial.constant(np.zeros(2), T[0], T[-1])),
        between=IntersamplePeaks(np.nanmax(np.abs(tau), axis=0), np.zeros(2), np.zeros(2), 1.0),
        parameters={"threshold": 7.0, "measure": "condition"},
        findings=Findings(singular_instants=(0.5,)),
    )
    return replace(plan, **changes)


def _panel(drawn: Figure, label: str) -> Any:
    return next(axes for axes in drawn.axes if axes.get_ylabel().startswith(label))


def _texts(drawn: Figure) -> list[str]:
    labels = [text.get_text() for axes in drawn.axes for text in axes.texts]
    return [*labels, *(text.get_text() for legend in drawn.legends for text in legend.get_texts())]


def _horizontals(axes: Any) -> set[float]:
    """Return the heights of the lines that cross the whole panel."""
    lines = [line for line in axes.lines if len(line.get_xdata()) == 2 and list(line.get_xdata()) == [0, 1]]
    return {float(line.get_ydata()[0]) for line in lines if line.get_ydata()[0] == line.get_ydata()[1]}


def _curves(axes: Any) -> list[np.ndarray]:
    return [np.asarray(line.get_ydata()) for line in axes.lines if len(line.get_xdata()) == len(T)]


def test_every_panel_draws_the_arrays_of_the_plan() -> None:
    plan = _plan()
    drawn = plot_plan(plan)
    for label, values in (
        ("main torque [N·m]", plan.tau),
        ("carrier force [N]", plan.carrier_force),
        ("carrier position s [m]", plan.carriers.s),
        ("carrier speed ṡ [m/s]", plan.carriers.sd),
        ("carrier acceleration s̈ [m/s²]", plan.carriers.sdd),
    ):
        curves = _curves(_panel(drawn, label))
        np.testing.assert_array_equal(np.stack(curves, axis=1), values)
    condition = _curves(_panel(drawn, "condition"))[0]
    np.testing.assert_allclose(condition[:40], plan.condition[:40])
    assert np.isfinite(condition).all()


def test_the_threshold_and_the_singular_instants_are_drawn() -> None:
    drawn = plot_plan(_plan())
    assert 7.0 in _horizontals(_panel(drawn, "condition"))
    for axes in drawn.axes:
        assert any(list(line.get_xdata()) == [0.5, 0.5] for line in axes.lines)
    assert "singular instant" in _texts(drawn)


@pytest.mark.parametrize("parameters", [{}, {"threshold": 0.1, "measure": "margin"}, {"lam": 0.5}])
def test_a_threshold_on_something_else_is_not_drawn(parameters: dict[str, object]) -> None:
    drawn = plot_plan(_plan(parameters=parameters, findings=Findings()))
    assert _horizontals(_panel(drawn, "condition")) == set()
    assert "singular instant" not in _texts(drawn)


def test_limits_in_reach_are_lines_with_hatching_and_others_are_said() -> None:
    drawn = plot_plan(_plan())
    assert _horizontals(_panel(drawn, "carrier position")) == {-0.2, 0.2}
    # the accelerations reach -2.25 m/s² of 9: a fourth, and the limits would flatten the curves
    assert _horizontals(_panel(drawn, "carrier acceleration")) == set()
    assert "limits ±9" in _texts(drawn)
    assert "limits ±1000" in _texts(drawn)
    hatched = [patch for patch in _panel(drawn, "carrier position").patches if patch.get_hatch()]
    spans = sorted(_span(patch) for patch in hatched)
    low, high = _panel(drawn, "carrier position").get_ylim()
    np.testing.assert_allclose(spans, [(low, -0.2), (0.2, high)])


def _corners(patch: Patch) -> np.ndarray:
    """Return the corners (N, 2) of a span, whatever kind of patch this matplotlib makes of it."""
    return patch.get_patch_transform().transform(patch.get_path().vertices)


def _span(patch: Patch) -> tuple[float, float]:
    heights = _corners(patch)[:, 1]
    return float(heights.min()), float(heights.max())


def test_limits_that_differ_say_whose_they_are() -> None:
    wide = replace(LIMITS, upper=0.25, lower=-math.inf)
    drawn = plot_plan(_plan(limits=LimitReport((), (), _limits(LIMITS, wide)), status=ResultStatus.OK))
    axes = _panel(drawn, "carrier position")
    assert _horizontals(axes) == {0.2, 0.25, -0.2}
    assert {text.get_text() for text in axes.texts} == {"limit of c1", "limit of c2"}
    (hatched,) = [patch for patch in axes.patches if patch.get_hatch()]  # what none of them may do
    assert _span(hatched) == pytest.approx((0.25, axes.get_ylim()[1]))


def test_broken_limits_are_marked_where_they_are_worst() -> None:
    drawn = plot_plan(_plan())
    position = _panel(drawn, "carrier position")
    marks = [line for line in position.lines if line.get_marker() == "X"]
    assert [(float(line.get_xdata()[0]), float(line.get_ydata()[0])) for line in marks] == [(0.5, 0.25)]
    assert any("0.05 beyond" in text for text in _texts(drawn))
    assert "(track of c1)" in drawn.get_suptitle()
    for label in ("carrier speed", "carrier acceleration", "carrier force"):
        assert not [line for line in _panel(drawn, label).lines if line.get_marker() == "X"]


def test_efforts_beside_a_singularity_do_not_flatten_the_rest() -> None:
    low, high = _panel(plot_plan(_plan()), "main torque").get_ylim()
    assert 3.0 < high < 4.0
    assert -3.0 < low < -2.0


def test_phases_are_shaded_from_one_to_the_next() -> None:
    plan = _plan()
    drawn = plot_plan(plan)
    spans = phase_spans(plan)
    assert [phase for phase, _, _ in spans] == [0, 1, 2, 3, 0]
    names = [text.get_text() for legend in drawn.legends for text in legend.get_texts()]
    assert names[:4] == ["parked", "ramp down", "off", "return"]
    fills = [
        (_corners(patch)[:, 0].min(), _corners(patch)[:, 0].max(), patch.get_facecolor())
        for patch in drawn.axes[0].patches
        if not patch.get_hatch()
    ]
    np.testing.assert_allclose(
        [fill[:2] for fill in fills], [(0.0, 0.2), (0.2, 0.3), (0.3, 0.7), (0.7, 0.9), (0.9, 1.0)]
    )
    greys = [fill[2][0] for fill in fills]
    # a fiftieth of the range from black to white, and a hairline between them
    assert np.abs(np.diff(greys)).min() > 0.02
    assert all(fill[2][0] == fill[2][1] == fill[2][2] for fill in fills)


def test_one_sample_and_no_carriers_can_be_drawn(tmp_path: Path) -> None:
    plan = _plan()
    one = {
        name: getattr(plan, name)[:1]
        for name in ("tau", "actuated_rate", "sample_status", "residual", "margin", "condition", "phase", "motion")
    }
    none = np.zeros((1, 0))
    record = replace(plan.robot, carriers=(), carrier_limits=(), rotating=("a1",))
    small = replace(
        plan,
        **one,
        carriers=CarrierMotion(none, none, none),
        carrier_force=none,
        robot=record,
        limits=LimitReport((), (), _limits()),
    )
    drawn = plot_plan(small)
    assert _panel(drawn, "main effort [N or N·m]")
    save(drawn, tmp_path / "one.png")


def test_a_reference_is_drawn_beside_the_efforts() -> None:
    plan = _plan()
    reference = np.full((len(T), 2), 0.5)
    axes = _panel(plot_plan(plan, reference=reference, reference_name="no carriers"), "main torque")
    assert sum(bool((curve == 0.5).all()) for curve in _curves(axes)) == 2
    assert "no carriers" in [text.get_text() for text in axes.get_legend().get_texts()]
