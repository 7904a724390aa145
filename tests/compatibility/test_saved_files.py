"""Files of version 0.1.0 are read without loss, and plans and simulations made anew are what they were."""

from __future__ import annotations

import dataclasses
import functools
import json
from collections.abc import Mapping
from enum import Enum
from typing import Any

import numpy as np
import pytest
from compatibility_cases import DATA, PLANS, REPLAYS, simulated

import redundancy_pin as rp

INTEGRATED = 1e-9
"""Of the largest value: two ways through one motion, each integrated to some 1e-11 (``rtol``, ``atol`` of simulate)."""

OPTIMISED = 1e-6
"""Of the largest value: what the whole-trajectory planner promises of the same problem through both backends."""

STEPPED = 1e-8
"""Of the largest value: steps are solved to 1e-9 of the largest effort, and each starts where the last one ended."""

TOLERANCES = {
    "switch-off-integration": INTEGRATED,
    "switch-off-differences": INTEGRATED,
    "stepwise-corner": STEPPED,
    "whole-line": OPTIMISED,
    "whole-corner": OPTIMISED,
}

Saved = tuple[dict[str, np.ndarray], dict[str, Any]]


@functools.cache
def stored(name: str) -> Saved:
    """Return the arrays of a file and what else is in it, read with numpy and json alone."""
    with np.load(DATA / f"{name}.npz", allow_pickle=False) as archive:
        arrays = dict(archive)
    return arrays, decoded(json.loads(str(arrays.pop("metadata"))), arrays)


def decoded(value: Any, arrays: dict[str, np.ndarray]) -> Any:
    """Return what JSON has no word for: arrays by name, tuples, numbers that are not finite."""
    if isinstance(value, list):
        return [decoded(entry, arrays) for entry in value]
    if not isinstance(value, dict):
        return value
    if set(value) == {"$array"}:
        return arrays[value["$array"]]
    if set(value) == {"$tuple"}:
        return tuple(decoded(value["$tuple"], arrays))
    if set(value) == {"$float"}:
        return float(value["$float"])
    return {key: decoded(entry, arrays) for key, entry in value.items()}


def as_data(value: Any) -> Any:
    """Return dataclasses as mappings, enums as their values, and arrays as lists, to be compared."""
    if dataclasses.is_dataclass(value):
        return {field.name: as_data(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Enum):
        return value.value
    if isinstance(value, Mapping):
        return {key: as_data(entry) for key, entry in value.items()}
    if isinstance(value, np.ndarray):
        return value.tolist()
    return [as_data(entry) for entry in value] if isinstance(value, (tuple, list)) else value


def require_kept(now: Any, then: Any) -> None:
    """Everything that a file holds is in what was read from it; the program may know more by now."""
    then = as_data(then)
    if isinstance(then, dict):
        now = as_data(now)
        assert set(then) <= set(now)
        for key, entry in then.items():
            np.testing.assert_equal(now[key], entry, err_msg=key)
    else:
        np.testing.assert_equal(as_data(now), then)


def robot_and_arguments(described: str) -> tuple[str, dict[str, str]]:
    """Split what a plan says of its baseline: the robot with its freedoms and mode, and each argument."""
    robot, _, arguments = described.removesuffix(")").partition("; ")
    return robot, dict(argument.split("=") for argument in arguments.split(", "))


def require_same_baseline(now: str | None, then: str | None) -> None:
    """A robot loaded anew is the one of then, each argument of then at its value; models have got arguments since."""
    if now is None or then is None:
        assert now is then
        return
    (robot, arguments), (robot_then, arguments_then) = robot_and_arguments(now), robot_and_arguments(then)
    assert robot == robot_then
    assert {name: arguments.get(name) for name in arguments_then} == arguments_then


def attribute(value: Any, path: str) -> Any:
    """Follow the name of an array, such as ``motion.x``."""
    return functools.reduce(getattr, path.split("."), value)


def require_near(now: Any, then: Any, tolerance: float, what: str) -> None:
    then = np.asarray(then)
    size = float(np.max(np.abs(then), initial=0.0, where=np.isfinite(then)))
    np.testing.assert_allclose(now, then, rtol=0.0, atol=tolerance * size, err_msg=what)


@pytest.mark.parametrize("name", PLANS)
def test_a_saved_plan_is_read_without_loss(name: str) -> None:
    arrays, content = stored(name)
    plan, record = rp.load_plan(DATA / f"{name}.npz"), content["record"]
    assert (content["format"], content["format_version"], content["package_version"]) == (
        "redundancy_pin plan", 1, "0.1.0")  # fmt: skip
    assert {"motion.t", "motion.x", "motion.xd", "motion.xdd", "carriers.s", "tau", "phase", "margin"} <= set(arrays)
    for path, values in arrays.items():
        np.testing.assert_array_equal(attribute(plan, path), values, err_msg=path)
    for key in ("status", "planner", "backend", "phases", "limits", "robot", "parameters", "diagnostics"):
        require_kept(getattr(plan, key), record[key])
    assert rp.load_robot_of(plan).name == plan.robot.name


@pytest.mark.parametrize(("name", "share"), [("switch-off-differences", 1.0), ("switch-off-integration", 0.5)])
def test_between_the_samples_of_old_files_carriers_move_by_their_scheme(name: str, share: float) -> None:
    plan = rp.load_plan(DATA / f"{name}.npz")
    off = plan.phase == plan.phases.index("off")
    left = np.flatnonzero(off[:-1] & off[1:] & (np.diff(plan.t) > 0.0))
    before, after = plan.carriers.sdd[left], plan.carriers.sdd[left + 1]
    middle = plan.carriers_at(0.5 * (plan.t[left] + plan.t[left + 1])).sdd
    # by differences s̈ of a sample is that of the step which ends there; integrated, it is half way between both
    assert np.abs(middle - (before + share * (after - before))).max() < 0.1 * np.abs(after - before).max()


def test_a_limit_that_was_exceeded_between_the_samples_is_kept_for_a_thousandth_of_the_cost() -> None:
    then, now = rp.load_plan(DATA / "whole-corner.npz"), PLANS["whole-corner"]()
    assert np.abs(now.tau).max() <= 2.4 * (1.0 + 1e-3)
    assert now.diagnostics["nodes"] > then.diagnostics["nodes"]
    assert 1.0 <= now.diagnostics["cost"] / then.diagnostics["cost"] < 1.001


@pytest.mark.parametrize("name", [name for name in PLANS if name != "whole-corner"])
def test_planned_anew_it_is_the_same(name: str) -> None:
    then, now, tolerance = rp.load_plan(DATA / f"{name}.npz"), PLANS[name](), TOLERANCES[name]
    np.testing.assert_allclose(now.t, then.t, rtol=0.0, atol=1e-9 * then.t[-1])
    for path in ("motion.x", "motion.xd", "motion.xdd", "carriers.s", "carriers.sd", "carriers.sdd"):
        require_near(attribute(now, path), attribute(then, path), tolerance, path)
    for path in ("tau", "carrier_force", "actuated_rate"):
        require_near(attribute(now, path), attribute(then, path), tolerance, path)
    np.testing.assert_array_equal(now.sample_status, then.sample_status)
    np.testing.assert_array_equal(now.phase, then.phase)
    np.testing.assert_allclose(now.margin, then.margin, rtol=0.0, atol=1e-9)
    assert (now.status, now.planner, now.backend, now.phases) == (then.status, then.planner, then.backend, then.phases)
    require_same_baseline(now.parameters.get("baseline"), then.parameters.get("baseline"))
    require_kept({**now.parameters, "baseline": None}, {**then.parameters, "baseline": None})
    assert set(then.diagnostics) <= set(now.diagnostics)
    for kind in ("violated", "binding"):
        ours, theirs = getattr(now.limits, kind), getattr(then.limits, kind)
        assert [(one.carrier, one.quantity) for one in ours] == [(one.carrier, one.quantity) for one in theirs]
        for one, other in zip(ours, theirs, strict=True):
            require_near([one.value, one.limit], [other.value, other.limit], tolerance, f"{kind} {one.quantity}")


@pytest.mark.parametrize("name", REPLAYS)
def test_a_saved_simulation_is_read_without_loss(name: str) -> None:
    arrays, content = stored(name)
    run, record = rp.simulation.load_simulation(DATA / f"{name}.npz"), content["record"]
    assert (content["format"], content["format_version"]) == ("redundancy_pin simulation", 1)
    assert {"t", "q", "v", "a", "x", "xd", "s", "tau", "closure_force", "gap", "energy"} <= set(arrays)
    for path, values in arrays.items():
        np.testing.assert_array_equal(attribute(run, path), values, err_msg=path)
    for key in ("status", "reason", "robot", "parameters", "statistics"):
        require_kept(getattr(run, key), record[key])
    assert as_data(run.events) == as_data(record["events"])


@pytest.mark.long_for("replay-differences", "replay-line")
@pytest.mark.long_for("replay-integration", "replay-line-heavy")
@pytest.mark.parametrize("name", REPLAYS)
def test_a_saved_plan_drives_a_robot_where_it_did(name: str) -> None:
    then, now = rp.simulation.load_simulation(DATA / f"{name}.npz"), simulated(REPLAYS[name])
    assert now.status.value == then.status.value
    assert [(event.kind, event.name) for event in now.events] == [(event.kind, event.name) for event in then.events]
    np.testing.assert_allclose(now.t, then.t, rtol=0.0, atol=INTEGRATED)
    for path in ("q", "v", "x", "xd", "s", "sd"):
        # where nothing moves the size of a motion is no measure: a metre, a radian
        np.testing.assert_allclose(
            getattr(now, path)[-1], getattr(then, path)[-1], rtol=0.0, atol=INTEGRATED, err_msg=path
        )
    for path in ("x", "tau", "carrier_force"):
        require_near(getattr(now, path), getattr(then, path), 10.0 * INTEGRATED, path)
    assert now.gap.max() < 1e-12
