"""What a plan says of itself: an early stop is never an optimum, and efforts without bound are a warning."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import redundancy_pin as rp
from redundancy_pin.planners.optimal import nlp
from redundancy_pin.planners.plan import Plan
from redundancy_pin.planners.summary import warnings_of
from redundancy_pin.status import ResultStatus
from redundancy_pin.trajectory import reference


@pytest.fixture(scope="module")
def plan() -> Plan:
    return rp.plan_stepwise(rp.VirtualWork("3rrr"), reference.corner(), mesh=rp.Mesh(dt=0.005))


def test_a_plan_within_limits_has_no_warnings(plan: Plan) -> None:
    facts = plan.summary()
    assert facts.warnings == []
    assert (facts["status"], facts["optimal"], facts["samples"]) == ("ok", True, len(plan.t))
    assert facts["phases"][0]["start"] == plan.t[0]
    assert facts["phases"][-1]["end"] == plan.t[-1]


def test_efforts_without_bound_between_the_samples_are_one_warning(plan: Plan) -> None:
    between = replace(plan.between, peak=np.array([1.0, np.inf, 2.0]), time=np.array([0.1, 0.2, 0.3]), ratio=np.inf)
    assert list(warnings_of(replace(plan, status=ResultStatus.UNBOUNDED, between=between))) == [
        "no finite main efforts: between the samples, at t = 0.2 s, where W is singular."
    ]


def test_one_actuator_that_the_samples_do_not_show_makes_a_plan_unresolved_and_is_named() -> None:
    """The actuator of the largest effort hides none: base_1 takes 1.67 N·m between samples that show 0.22."""
    dynamics = rp.RneaDynamics("3rrr")
    coarse = rp.plan_stepwise(dynamics, reference.corner().sample(0.02))
    inside = coarse.efforts_at(np.linspace(0.951, 0.959, 9), dynamics)
    shown = np.abs(coarse.tau).max(axis=0)
    assert np.abs(inside[:, 0]).max() - shown[0] > 0.05 * shown.max()
    assert coarse.between.peak.max() < 1.05 * shown.max()
    assert coarse.status is ResultStatus.UNRESOLVED
    (warning,) = coarse.summary().warnings
    assert "base_1 takes up to 1.668 N·m at t = 0.96 s, and 0.2221 at the samples" in warning
    facts = coarse.summary()
    assert (facts["peak_carrier_force"] > np.abs(coarse.carrier_force).max(axis=0)).any()
    assert "rms main effort at the samples" in str(facts)


def test_the_unit_of_efforts_is_that_of_joints_that_turn_slide_or_do_both(plan: Plan) -> None:
    mixed = replace(plan.robot, rotating=("base_1", "base_2"))
    units = [mixed.effort_unit(*names) for names in (("base_1", "base_2"), ("base_3",), ("base_1", "base_3"), ())]
    assert units == ["N·m", "N", "N or N·m", "N"]


def test_no_optimum_is_warned_of_whatever_the_status(plan: Plan) -> None:
    findings = replace(plan.findings, optimal=False, solver="Time_Exceeded")
    for status in (ResultStatus.NOT_CONVERGED, ResultStatus.UNRESOLVED, ResultStatus.UNBOUNDED):
        text = " ".join(warnings_of(replace(plan, status=status, findings=findings)))
        assert "this is no optimum: the optimiser stopped early (Time_Exceeded)" in text


def test_a_plan_that_stopped_early_is_no_optimum_and_keeps_its_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tolerance that no solver can meet: it ends at a point that keeps every limit and is proved no optimum."""
    monkeypatch.setattr(nlp, "TOLERANCE", 1e-30)
    circle, mesh = reference.circle(ramp_length=0.05), rp.Mesh(dt=0.08, refinements=0)
    plan = rp.plan_whole_trajectory(rp.VirtualWork("2rpr"), circle, mesh=mesh)
    assert (plan.status, plan.summary()["optimal"]) == (ResultStatus.NOT_CONVERGED, False)
    assert not plan.limits.violated
    assert next(warnings_of(plan)).startswith("this is no optimum")


def test_ticks_without_a_plan_of_a_run_that_was_saved_before_it_had_reasons(plan: Plan) -> None:
    early = replace(plan, diagnostics={"ticks": {"ok": 3, "relaxed": 2, "fallback": 0}})
    (warning,) = early.summary().warnings
    assert warning.startswith("2 of 5 ticks had no plan within every limit (2 relaxed): ")


def test_a_summary_is_printed_as_a_table_and_with_dynamics_has_the_base(plan: Plan) -> None:
    text, dynamics = str(plan.summary()), rp.RneaDynamics("3rrr")
    for value in (plan.rms_effort[0], plan.main_energy):
        assert f"{value:.6g}" in text
    assert "base" not in text.replace("base_", "")
    facts = plan.summary(dynamics)
    wrench = dynamics.along(plan.motion).base_wrench(plan.carriers)
    assert facts["peak_base_force"] == pytest.approx(np.linalg.norm(wrench[:, :3], axis=1).max())
    assert facts["peak_base_moment"] == pytest.approx(np.linalg.norm(wrench[:, 3:], axis=1).max())
    assert f"{facts['peak_base_force']:.6g}" in str(facts)
    late = replace(plan, status=ResultStatus.UNBOUNDED).summary()
    assert str(late).endswith("".join(f"warning: {each}\n" for each in late.warnings))
