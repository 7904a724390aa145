"""Verdicts of cells: what the planners say when they are asked directly, and what physics says of the whole map."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from small_maps import corner, crossing

import redundancy_pin as rp
from redundancy_pin.errors import InfeasiblePlanError, UnreachablePoseError
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.status import ResultStatus
from redundancy_pin.studies.case import Case
from redundancy_pin.studies.feasibility import (
    STEPWISE,
    SWITCH_OFF,
    WHOLE,
    Axis,
    FeasibilityMap,
    MapProblem,
    feasibility_map,
)
from redundancy_pin.studies.verdicts import Cell, compute, judge
from redundancy_pin.trajectory import reference

pytest.importorskip("casadi")
pytest.importorskip("joblib")

SOLVER = 1e-6
"""Relative difference of an optimum that is found twice, from limits that differ by rounding."""


SCALES = ["corners", pytest.param("whole", marks=pytest.mark.long)]
"""The four outermost cells of a map, of which each planner can do some and not others; and all of them."""


@pytest.fixture(scope="module", params=SCALES)
def circle(request: pytest.FixtureRequest) -> FeasibilityMap:
    axes = {"x": Axis("speed", (0.4, 2.0)), "y": Axis("stroke", (0.05, 1.0))} if request.param == "corners" else {}
    return feasibility_map(crossing(**axes), jobs=1)


@pytest.fixture(scope="module", params=[pytest.param("corners", marks=pytest.mark.long), SCALES[1]])
def bend(request: pytest.FixtureRequest) -> FeasibilityMap:
    axes = {"x": Axis("speed", (0.1, 0.3)), "y": Axis("stroke", (0.02, 2.0))} if request.param == "corners" else {}
    return feasibility_map(corner(**axes), jobs=1)


# ------------------------------------------------------------------------- the planners asked directly, by other means


def _whole(dynamics: Any, motion: Any, **given: Any) -> Plan | None:
    try:
        return rp.plan_whole_trajectory(dynamics, motion, **in_groups(rp.plan_whole_trajectory, given))
    except InfeasiblePlanError:
        return None


def _require_cells_of_the_planner(result: FeasibilityMap, dynamics: Any, make: Callable[[float], Any]) -> None:
    """The limits go in as keywords of the planner here, not as limits of the robot."""
    effort, nodes = result.problem.limits.get("max_effort"), result.problem.parameters[WHOLE]
    for cell in result.of(WHOLE):
        plan = _whole(dynamics, make(cell.x), track=[-0.5 * cell.y, 0.5 * cell.y], effort=effort, **nodes)
        expected = ResultStatus.INFEASIBLE if plan is None else ResultStatus.OK
        assert cell.verdict is expected, cell
        if plan is not None:
            assert plan.status is ResultStatus.OK
            assert plan.between is not None
            assert cell.dense_ratio == pytest.approx(plan.between.ratio, rel=1e-3)
            assert cell.peak_effort == pytest.approx(plan.peak_effort.max(), rel=1e-3)


@pytest.mark.long_for("corners")
def test_whole_trajectory_cells_of_a_crossing_are_those_of_the_planner(circle: FeasibilityMap) -> None:
    dynamics = rp.VirtualWork(rp.load_robot("2rpr"))
    _require_cells_of_the_planner(circle, dynamics, lambda v: reference.circle(speed=v, ramp_length=0.1 * v))


@pytest.mark.long_for("corners")
def test_whole_trajectory_cells_of_a_corner_are_those_of_the_planner(bend: FeasibilityMap) -> None:
    dynamics = rp.VirtualWork(rp.load_robot("3rrr", working_mode=(1, 1, 1)))
    _require_cells_of_the_planner(bend, dynamics, lambda v: reference.corner(speed=v))


def test_switch_off_cells_are_those_of_the_planner(circle: FeasibilityMap) -> None:
    """The stroke goes in as an argument of the model here: the limits come from its URDF."""
    for cell in circle.of(SWITCH_OFF):
        plan = _switched_off(cell, 20.0, "shortest")
        assert cell.verdict is (ResultStatus.OK if plan else ResultStatus.INFEASIBLE), cell
        if plan is not None:
            assert cell.peak_effort == pytest.approx(plan.peak_effort.max(), rel=SOLVER)


def _switched_off(cell: Cell, threshold: float, return_time: Any) -> Plan | None:
    try:
        plan = rp.plan_switch_off(
            rp.VirtualWork(rp.load_robot("2rpr", track_half_length=0.5 * cell.y)),
            reference.circle(speed=cell.x, ramp_length=0.1 * cell.x),
            threshold=threshold,
            return_time=return_time,
            mesh=rp.Mesh(dt=5e-3),
        )
    except InfeasiblePlanError:
        return None
    return plan if plan.status is ResultStatus.OK else None


def test_switching_off_is_tried_as_the_thesis_does_it_first() -> None:
    """At 0.4 m/s the usual return breaks the acceleration limit at the first threshold, the shortest does not."""
    cell = compute(crossing(parameters={SWITCH_OFF: {"dt": 5e-3}}), SWITCH_OFF, 0.4, 1.0)
    assert cell.settings == {"threshold": 5.0, "return_time": "shortest", "dt": 5e-3}
    assert _switched_off(cell, 5.0, 0.4) is None
    plan = _switched_off(cell, 5.0, "shortest")
    assert plan is not None
    assert cell.peak_effort == pytest.approx(plan.peak_effort.max(), rel=SOLVER)


def test_stepwise_cells_are_those_of_the_planner(bend: FeasibilityMap) -> None:
    dynamics = rp.VirtualWork(rp.load_robot("3rrr", working_mode=(1, 1, 1)))
    for cell in bend.of(STEPWISE):
        plan = rp.plan_stepwise(
            dynamics,
            reference.corner(speed=cell.x),
            mesh=rp.Mesh(dt=5e-3),
            limits=rp.Limits(track=[-0.5 * cell.y, 0.5 * cell.y]),
        )
        kept = plan.status is ResultStatus.OK and plan.peak_effort_at_samples.max() <= 5.0
        assert cell.verdict is (ResultStatus.OK if kept else ResultStatus.INFEASIBLE), cell
        if not kept:
            assert cell.limits[0] == "effort"
            assert set(cell.limits) <= {"effort", "track"}  # a stop by steps may pass the end between two of them
            assert cell.amount == pytest.approx(plan.peak_effort_at_samples.max() - 5.0, rel=SOLVER)


def _require_both_verdicts(result: FeasibilityMap) -> None:
    """Else the tests above would say little."""
    for planner in result.problem.planners:
        assert {cell.verdict for cell in result.of(planner)} == {ResultStatus.OK, ResultStatus.INFEASIBLE}


def test_both_verdicts_occur_on_a_crossing(circle: FeasibilityMap) -> None:
    _require_both_verdicts(circle)


def test_both_verdicts_occur_on_a_corner(bend: FeasibilityMap) -> None:
    _require_both_verdicts(bend)


# ---------------------------------------------------------------------------------------------------------- physics


def _require_more_with_more_stroke(result: FeasibilityMap) -> None:
    """A plan on a short track is one on a longer track, too."""
    for x in result.problem.x.values:
        column = sorted((cell for cell in result.of(WHOLE) if cell.x == x), key=lambda cell: cell.y)
        possible = [cell.possible for cell in column]
        assert possible == sorted(possible), column  # type: ignore[type-var]


def test_more_stroke_never_makes_a_feasible_crossing_infeasible(circle: FeasibilityMap) -> None:
    _require_more_with_more_stroke(circle)


def test_more_stroke_never_makes_a_feasible_corner_infeasible(bend: FeasibilityMap) -> None:
    _require_more_with_more_stroke(bend)


def test_a_slower_platform_needs_less(bend: FeasibilityMap) -> None:
    """The same path with the clock slowed down needs forces smaller by the square, and accelerations too."""
    for y in bend.problem.y.values:
        row = sorted((cell for cell in bend.of(WHOLE) if cell.y == y), key=lambda cell: cell.x)
        possible = [cell.possible for cell in row]
        assert possible == sorted(possible, reverse=True), row  # type: ignore[type-var]


def test_a_limit_that_binds_is_met_to_a_thousandth(bend: FeasibilityMap) -> None:
    bound = {limit for cell in bend.of(WHOLE) if cell.possible for limit in cell.limits}
    assert "track" in bound  # a track of two centimetres is used to its ends
    for cell in bend.of(WHOLE):
        if "effort" in cell.limits and cell.possible:
            assert cell.peak_effort >= 0.999 * 5.0


# ------------------------------------------------------------------------------------ what is known and what is not


def _cell_where(planner_does: Any, monkeypatch: pytest.MonkeyPatch) -> Cell:
    def plan(*_: object) -> Plan:
        raise planner_does

    monkeypatch.setattr(Case, "plan", plan)
    return compute(corner(), WHOLE, 0.1, 2.0)


@pytest.mark.parametrize(
    ("error", "verdict", "limits"),
    [
        (RuntimeError("the solver burst"), ResultStatus.UNRESOLVED, ()),
        (InfeasiblePlanError("Too slow.", constraint="seconds", time=0.0, amount=1.0), ResultStatus.UNRESOLVED, ()),
        (InfeasiblePlanError("Lost.", constraint="balance", time=0.0, amount=1.0), ResultStatus.UNRESOLVED, ()),
        (InfeasiblePlanError("It does not say why."), ResultStatus.UNRESOLVED, ()),
        (
            InfeasiblePlanError("Too far.", constraint="track", time=0.5, amount=0.1),
            ResultStatus.INFEASIBLE,
            ("track",),
        ),
        (UnreachablePoseError("Too far away."), ResultStatus.INFEASIBLE, ("workspace",)),
        (
            InfeasiblePlanError(
                "Both.",
                constraint="track",
                together=True,
                relaxations=({"constraint": "track"}, {"constraint": "effort"}),
            ),
            ResultStatus.INFEASIBLE,
            ("track", "effort"),
        ),
    ],
)
def test_failed_is_not_infeasible(
    error: Exception, verdict: ResultStatus, limits: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> None:
    cell = _cell_where(error, monkeypatch)
    assert (cell.verdict, cell.limits) == (verdict, limits)
    assert str(error) in cell.message
    assert type(error).__name__ in cell.message
    assert cell.peak_effort is None


def test_while_one_try_failed_nothing_is_shown_to_be_impossible(monkeypatch: pytest.MonkeyPatch) -> None:
    answers = iter([InfeasiblePlanError("No.", constraint="track"), RuntimeError("burst")])

    def plan(*_: object) -> Plan:
        raise next(answers, InfeasiblePlanError("No.", constraint="track"))

    monkeypatch.setattr(Case, "plan", plan)
    assert compute(crossing(parameters={}), SWITCH_OFF, 0.4, 0.3).verdict is ResultStatus.UNRESOLVED


@pytest.fixture(scope="module")
def planned() -> Plan:
    problem = corner()
    case = problem.case(WHOLE, 0.1, 2.0, problem.parameters[WHOLE])
    return replace(case, options=tuple(pair for pair in case.options if pair[0] != "effort")).plan(problem.backend)


def _judged(plan: Plan, effort: float = 5.0, planner: str = WHOLE) -> Cell:
    return judge(Cell(planner, 0.1, 2.0, ResultStatus.OK), plan, {"max_effort": effort})


def test_a_plan_that_stopped_early_is_told_apart(planned: Plan) -> None:
    findings = replace(planned.findings, solver="Out_Of_Time")
    cell = _judged(replace(planned, status=ResultStatus.NOT_CONVERGED, findings=findings))
    assert cell.verdict is ResultStatus.NOT_CONVERGED
    assert cell.possible
    assert "Out_Of_Time" in cell.message


def test_a_plan_without_finite_efforts_is_none(planned: Plan) -> None:
    cell = _judged(replace(planned, status=ResultStatus.UNBOUNDED))
    assert (cell.verdict, cell.limits) == (ResultStatus.INFEASIBLE, ("effort",))


def test_a_plan_that_breaks_limits_of_the_carriers_is_none() -> None:
    """The crossing of the thesis leaves the track and exceeds the acceleration limit; the worst is told first."""
    plan = crossing().case(SWITCH_OFF, 0.5, 0.4, {"threshold": 5.0}).plan()
    assert plan.status is ResultStatus.LIMIT_VIOLATED
    cell = _judged(plan, np.inf, SWITCH_OFF)
    assert cell.verdict is ResultStatus.INFEASIBLE
    assert set(cell.limits) == {event.quantity for event in plan.limits.violated} == {"track", "acceleration"}
    worst = max(plan.limits.violated, key=lambda event: abs(event.value / event.limit))
    assert (cell.limits[0], cell.joint, cell.time) == (worst.quantity, worst.joint, worst.worst)
    assert cell.amount == pytest.approx(abs(worst.value - worst.limit))
    assert f"{worst.quantity} of {worst.joint} by {worst.amount:.4g}" in cell.message


def test_a_plan_beyond_the_effort_limit_is_none(planned: Plan) -> None:
    peak = float(planned.peak_effort_at_samples.max())
    cell = _judged(planned, 0.9 * peak)
    assert (cell.verdict, cell.limits) == (ResultStatus.INFEASIBLE, ("effort",))
    assert cell.amount == pytest.approx(0.1 * peak)
    i = int(np.argmin(np.abs(planned.t - cell.time)))
    assert np.abs(planned.tau[i]).max() == pytest.approx(peak)
    assert _judged(planned, 1.1 * peak).verdict is ResultStatus.OK


def test_efforts_that_the_nodes_do_not_show_leave_the_cell_unknown(planned: Plan) -> None:
    assert planned.between is not None
    between = replace(planned.between, ratio=1.5, peak=1.5 * planned.peak_effort_at_samples)
    cell = _judged(replace(planned, between=between), 1.1 * float(planned.peak_effort_at_samples.max()))
    assert cell.verdict is ResultStatus.UNRESOLVED
    assert "not resolved" in cell.message


@pytest.mark.parametrize("effort", [None, 2.0])
def test_a_peak_between_the_samples_is_what_the_limit_is_compared_with(planned: Plan, effort: float | None) -> None:
    """A plan that is not resolved keeps a limit that its continuous motion keeps; without a limit the cell says so."""
    assert planned.between is not None
    shown = float(planned.peak_effort_at_samples.max())
    peak = 1.5 * shown
    between = replace(planned.between, ratio=1.5, peak=1.5 * planned.peak_effort_at_samples)
    plan = replace(planned, status=ResultStatus.UNRESOLVED, between=between)
    limits = {} if effort is None else {"max_effort": effort * peak}
    cell = judge(Cell(WHOLE, 0.1, 2.0, ResultStatus.OK), plan, limits)
    assert (cell.verdict, cell.status, cell.peak_effort) == (ResultStatus.OK, "unresolved", pytest.approx(peak))
    assert f"reach {peak:.4g}, at the samples {shown:.4g}" in cell.message
    assert ("no limit of the efforts" in cell.message) is (effort is None)
    assert "effort" not in cell.limits
    tight = judge(Cell(WHOLE, 0.1, 2.0, ResultStatus.OK), plan, {"max_effort": peak})
    assert tight.verdict is ResultStatus.OK
    assert "effort" in tight.limits  # the peak is on it, although no sample is
    beyond = judge(Cell(WHOLE, 0.1, 2.0, ResultStatus.OK), plan, {"max_effort": 0.9 * peak})
    assert beyond.verdict is ResultStatus.UNRESOLVED
    without = replace(plan, status=ResultStatus.UNBOUNDED, between=replace(between, peak=between.peak * np.inf))
    assert judge(Cell(WHOLE, 0.1, 2.0, ResultStatus.OK), without, limits).verdict is ResultStatus.INFEASIBLE


def test_a_carrier_mass_of_the_robot_is_an_axis() -> None:
    """Heavier carriers push harder: what is minimised, ∫ τ² with the same motion allowed, does not grow."""
    problem = crossing(x=Axis("carrier_mass", (0.5, 2.0)), y=Axis("max_acceleration", (1.0, 10.0)), planners=(WHOLE,))
    assert problem.case(WHOLE, 0.5, 10.0, {}).load_robot().parameters["carrier_mass"] == 0.5
    assert problem.case(WHOLE, 2.0, 1.0, {}).dynamics().robot.carrier_limits[0].acceleration == 1.0
    assert compute(problem, WHOLE, 0.5, 10.0).peak_effort != compute(problem, WHOLE, 2.0, 10.0).peak_effort


def test_a_robot_without_a_version_that_has_no_carriers_is_planned_stepwise() -> None:
    """λ = 0 alone is tried, and a limit of the carriers and the direction of gravity reach the planner."""
    problem = MapProblem(
        "five_bar",
        Axis("speed", (0.05, 0.1)),
        Axis("stroke", (0.2, 0.4)),
        "points",
        options={"points": [[0.2, 0.5], [0.25, 0.5]], "ramp_time": 0.1},
        gravity=(0.0, -9.81, 0.0),
        backend="rnea",
        planners=(STEPWISE,),
        settings={"carriers": True},
    )
    assert [settings["lam"] for settings in problem.attempts(STEPWISE)] == [0.0] or problem.has_baseline
    heavy, light = compute(problem, STEPWISE, 0.05, 0.4), compute(replace(problem, gravity=None), STEPWISE, 0.05, 0.4)
    assert heavy.peak_effort != light.peak_effort


@pytest.mark.long
def test_a_map_of_a_motion_between_poses() -> None:
    """Gough, through 90 degrees of yaw: 0.5 kg a carrier do not hold the weight there (see its own test), 2 kg do."""
    problem = MapProblem(
        "gough",
        Axis("duration", (0.5, 1.0)),
        Axis("carrier_mass", (0.5, 2.0)),
        "pose",
        options={
            "start": (0.0, 0.0, 0.6, 0.0, 0.0, 0.573576436, 0.819152044),
            "end": (0.0, 0.0, 0.6, 0.0, 0.0, 0.819152044, 0.573576436),
        },
        settings={"carriers": True},
        backend="rnea",
        planners=(WHOLE,),
        parameters={WHOLE: {"dt": 0.1}},
    )
    problem.require_names()
    light, heavy = (compute(problem, WHOLE, 1.0, mass) for mass in (0.5, 2.0))
    assert light.verdict is ResultStatus.INFEASIBLE
    assert "acceleration" in light.limits
    assert heavy.verdict is ResultStatus.OK
