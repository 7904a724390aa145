"""Options of planners in groups: what each group checks, and what a planner does not take of it."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from types import MappingProxyType
from typing import Any

import numpy as np
import pytest
import zoo

import redundancy_pin as rp
from redundancy_pin.errors import InputError
from redundancy_pin.planners.optimal.settings import checked_settings
from redundancy_pin.planners.registry import in_groups
from redundancy_pin.trajectory import reference


@pytest.mark.parametrize(
    ("make", "name"),
    [
        (lambda: rp.Mesh(0.0), "dt"),
        (lambda: rp.Mesh(refinements=31), "refinements"),
        (lambda: rp.Mesh(steps=3), "steps"),
        (lambda: rp.Solver(starts=0), "starts"),
        (lambda: rp.Solver(seconds=0.0), "seconds"),
        (lambda: rp.Objective(lam=1.1), "lam"),
        (lambda: rp.Objective(calm=-0.1), "calm"),
        (lambda: rp.Objective(base_point=(0.0, 0.0)), "base_point"),
        (lambda: rp.Objective("effort", lam=0.5), "tracking"),
        (lambda: rp.Objective({"effort": 1.0}, baseline="3rrr"), "tracking"),
    ],
)
def test_a_group_checks_its_numbers(make: Callable[[], object], name: str) -> None:
    with pytest.raises(InputError, match=name):
        make()


@pytest.mark.parametrize(
    "make",
    [
        lambda given: rp.Mesh(dt=given),
        lambda given: rp.Solver(seconds=given),
        lambda given: rp.Objective("tracking", lam=given),
        lambda given: rp.Objective(calm=given),
        lambda given: rp.Limits(effort=given).resolved(zoo.robot_of("3rrr")),
        lambda given: rp.Limits(speed=[given, given, given]).resolved(zoo.robot_of("3rrr")),
        lambda given: checked_settings(zoo.robot_of("3rrr"), {"effort": given}),
    ],
    ids=["dt", "seconds", "lam", "calm", "effort", "speed", "weight"],
)
def test_a_number_is_one_of_any_kind_and_no_text(make: Callable[[Any], object]) -> None:
    for number in (0.5, np.float32(0.5), np.array(0.5)):
        make(number)
    for other in ("0.5", np.str_("0.5"), True, float("nan"), 0.5j):
        with pytest.raises(InputError):
            make(other)


GROUPS: dict[str, tuple[Callable[[Any], Any], Any, Callable[[Any], None]]] = {
    "limits": (lambda given: rp.Limits(effort=given), np.ones(3), lambda given: given.fill(9.0)),
    "list": (lambda given: rp.Limits(track=given), [[-0.1, 0.1]], lambda given: given[0].append(9.0)),
    "weights": (rp.Objective, {"effort": 1.0}, lambda given: given.update(peak=9.0)),
    "point": (lambda given: rp.Objective(base_point=given), np.zeros(3), lambda given: given.fill(9.0)),
    "baseline": (lambda given: rp.Objective(baseline=given), np.ones((2, 3)), lambda given: given.fill(9.0)),
}
"""How a group is made of a value, and a change of that value by its owner."""


@pytest.mark.parametrize("name", GROUPS)
def test_groups_do_not_change_with_their_arguments(name: str) -> None:
    make, given, change = GROUPS[name]
    group, same = make(given), make(copy.deepcopy(given))
    for twin in (same, copy.copy(group), copy.deepcopy(group), pickle.loads(pickle.dumps(group))):
        assert (group == twin, hash(group) == hash(twin)) == (True, True)
    change(given)
    assert group == same
    assert group != make(given)
    for part in (vars(each) for each in (group, pickle.loads(pickle.dumps(group)))):
        assert not any(value.flags.writeable for value in part.values() if isinstance(value, np.ndarray))
        assert not any(isinstance(value, (dict, list)) for value in part.values())


def test_groups_are_equal_by_value() -> None:
    assert rp.Objective("tracking", lam=np.array(0.5), calm=np.float32(0.5)) == rp.Objective("tracking", 0.5, calm=0.5)
    assert rp.Limits(effort=2.5) == rp.Limits(effort=2.5) != rp.Limits(effort=2.6)
    assert rp.Limits(effort=2.5) != rp.Limits(speed=2.5)
    assert rp.Limits(effort=[1.0, 0.0]) == rp.Limits(effort=np.array([1.0, -0.0]))
    assert rp.Objective({"effort": 1.0, "peak": 2.0}) == rp.Objective({"peak": 2.0, "effort": 1.0})
    assert rp.Objective("peak") != rp.Objective("peak", calm=0.0)
    assert rp.Objective(MappingProxyType({"peak": 1.0})) == rp.Objective({"peak": 1.0})
    assert rp.Limits() != rp.Mesh()


def test_lam_and_baseline_ask_for_tracking() -> None:
    assert rp.Objective(lam=0.5, baseline="3rrr").weights == "tracking"
    assert rp.Objective(baseline="3rrr").weights == "tracking"
    assert rp.Objective().weights == "effort"
    assert rp.Objective("peak").weights == "peak"


def test_flags_and_files_write_fields_of_groups_one_by_one() -> None:
    """Each field goes to the group that the planner takes, and keywords of its own stay."""
    flat = {"dt": 0.02, "refinements": 1, "starts": 2, "effort": 3.0, "end": "free", "objective": "peak", "calm": 0.0}
    grouped = in_groups(rp.plan_whole_trajectory, flat)
    assert (grouped["mesh"], grouped["solver"], grouped["end"]) == (rp.Mesh(0.02, 1), rp.Solver(2), "free")
    assert (grouped["limits"].effort, grouped["limits"].speed) == (3.0, None)
    assert (grouped["objective"].weights, grouped["objective"].calm) == ("peak", 0.0)
    assert len(grouped) == 5
    assert in_groups(rp.plan_switch_off, {"dt": 0.02}) == {"mesh": rp.Mesh(dt=0.02)}  # the distance of its samples
    assert in_groups(rp.plan_stepwise, {"lam": 0.5, "dt": 0.1})["objective"].weights == "tracking"
    assert in_groups(rp.plan_time_optimal, {"steps": 50})["mesh"] == rp.Mesh(steps=50)
    assert in_groups(rp.plan_time_optimal, {"unknown": 1}) == {"unknown": 1}


@pytest.mark.parametrize(
    ("plan", "flat", "remedy"),
    [
        (rp.plan_whole_trajectory, {"dt": 0.01}, "Pass mesh=Mesh(dt=...)."),
        (rp.plan_whole_trajectory, {"effort": 3.0}, "Pass limits=Limits(effort=...)."),
        (rp.plan_whole_trajectory, {"calm": 0.0}, "Pass objective=Objective(calm=...)."),
        (rp.plan_whole_trajectory, {"starts": 2}, "Pass solver=Solver(starts=...)."),
        (rp.plan_time_optimal, {"effort": 3.0}, "Pass limits=Limits(effort=...)."),
        (rp.plan_time_optimal, {"objective": "peak"}, "Keywords are limits, mesh, solver, begin, end, datum, lap."),
        (rp.plan_stepwise, {"dt": 0.01}, "Pass mesh=Mesh(dt=...)."),
        (rp.plan_stepwise, {"lam": 0.5}, "Pass objective=Objective(lam=...)."),
        (rp.plan_switch_off, {"dt": 0.01}, "Pass mesh=Mesh(dt=...)."),
        (rp.plan_switch_off, {"treshold": 4.0}, "Did you mean 'threshold'?"),
        (rp.plan_switch_off, {"starts": 2}, "Keywords are limits, mesh, threshold"),
        # fields that it takes in no group
        (rp.plan_time_optimal, {"dt": 0.01}, "Keywords are limits, mesh"),
        (rp.plan_whole_trajectory, {"steps": 10}, "Keywords are "),
        (rp.plan_stepwise, {"jerk": 1.0}, "Keywords are "),
    ],
)
def test_a_keyword_that_is_a_field_of_a_group_names_the_group(
    plan: Callable[..., rp.Plan], flat: dict[str, Any], remedy: str
) -> None:
    with pytest.raises(InputError, match=next(iter(flat))) as caught:
        plan("3rrr", reference.corner(), **flat)
    assert caught.value.remedy.startswith(remedy)


def test_every_planner_takes_its_step_from_the_mesh() -> None:
    assert np.diff(rp.plan_stepwise("3rrr", reference.corner(), mesh=rp.Mesh(dt=0.05)).t).max() == pytest.approx(0.05)
    coarse = rp.plan_switch_off("2rpr", reference.circle(), threshold=20.0, mesh=rp.Mesh(dt=0.05)).t
    assert np.diff(coarse).max() == pytest.approx(0.05, rel=0.1)
    samples = reference.corner().sample(dt=0.05)
    for plan, motion, mesh, name in (
        (rp.plan_stepwise, samples, rp.Mesh(dt=0.05), "dt does not apply: the motion has steps of its own"),
        (rp.plan_stepwise, samples, rp.Mesh(steps=50), "steps does not apply"),
        (rp.plan_switch_off, samples, rp.Mesh(refinements=1), "refinements does not apply"),
    ):
        with pytest.raises(InputError, match=name):
            plan("3rrr", motion, mesh=mesh)


def three() -> rp.VirtualWork:
    return rp.VirtualWork(zoo.robot_of("3rrr"))


def whole(**options: Any) -> object:
    return rp.plan_whole_trajectory(three(), reference.corner(), **in_groups(rp.plan_whole_trajectory, options))


def stepwise(**options: Any) -> object:
    return rp.plan_stepwise(three(), reference.corner(), **in_groups(rp.plan_stepwise, options))


def timed(**options: Any) -> object:
    return rp.plan_time_optimal(three(), reference.corner().path, **in_groups(rp.plan_time_optimal, options))


@pytest.mark.parametrize(
    ("plan", "message"),
    [
        (lambda: whole(mesh=rp.Mesh(steps=50)), "steps does not apply"),
        (lambda: whole(limits={"effort": 1.0}), "limits=Limits"),
        (lambda: whole(objective=5.0), "An objective was expected"),
        (lambda: timed(mesh=rp.Mesh(dt=0.1)), "dt does not apply"),
        (lambda: timed(solver=rp.Solver(starts=2)), "starts does not apply"),
        (lambda: timed(solver=5.0), "solver=Solver"),
        (lambda: stepwise(limits=rp.Limits(jerk=100.0)), "jerk does not apply"),
        (lambda: stepwise(objective=rp.Objective(calm=0.1)), "calm does not apply"),
        (lambda: stepwise(objective=rp.Objective(base_point=(0.0,) * 3)), "base_point does not apply"),
        (lambda: stepwise(objective="peak"), "objective is"),
        (lambda: stepwise(objective={"effort": 1.0, "tracking": 1.0}), "one objective"),
        (lambda: rp.plan_switch_off("2rpr", reference.circle(), limits=3.0), "limits=Limits"),  # type: ignore[arg-type]
        (lambda: rp.RecedingHorizon("3rrr", limits=3.0), "limits=Limits"),  # type: ignore[arg-type]
        (lambda: rp.RecedingHorizon("3rrr", objective=rp.Objective()), "objective is"),  # type: ignore[arg-type]
    ],
)
def test_what_a_planner_does_not_take_is_named(plan: Callable[[], object], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan()


def test_a_misspelt_option_of_the_on_line_planner_is_named() -> None:
    for given, says in (
        ({"horizn": 0.4}, r"RecedingHorizon has no keyword 'horizn'\. Did you mean 'horizon'"),
        ({"acceleration": 2.0}, r"Pass limits=Limits\(acceleration"),
        ({"objective": "peek"}, r"Did you mean 'peak'"),
    ):
        with pytest.raises(InputError, match=says):
            rp.RecedingHorizon(zoo.robot_of("2rpr"), **given)


def test_carriers_measured_in_millimetres_are_the_reason_of_a_fallback() -> None:
    circle = reference.circle()
    for places, says in (
        ([30.0, -12.0], "carrier_1 was measured at 30 m, off its track from -0.2 to 0.2 m. "),
        ([0.2 + 1e-7, -300.0], "carrier_2 was measured at -300 m"),  # the other is off its own by rounding
    ):
        planner = rp.RecedingHorizon("2rpr")
        assert planner.update(0.0, circle, [0.0, 0.0], [0.0, 0.0]).status.value == "ok"
        command = planner.update(0.02, circle, places, [0.0, 0.0])
        assert command.status.value == "fallback"
        assert says in command.reason
        assert "millimetres" in command.reason
