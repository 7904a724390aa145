"""Plans in files: nothing lost, nothing executed, and every way a file can be wrong is said in one line."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zoo
from examples import examples
from hypothesis import HealthCheck, given
from parked_plans import parked_plan
from random_plans import difference, plans

import redundancy_pin as rp
from redundancy_pin.errors import InputError, OutputError, PlanFileError
from redundancy_pin.planners.limits import LimitEvent
from redundancy_pin.planners.plan import PLAN_VERSION, Plan, load_plan, load_robot_of
from redundancy_pin.robot import Robot
from redundancy_pin.status import ResultStatus

# the folder of a test is used anew by every example: each writes its own file whole
EXAMPLES = examples(15, suppress_health_check=[HealthCheck.function_scoped_fixture])


def _plan_of(robot: Robot, **changes: Any) -> Plan:
    """Return a short real plan: parked carriers along a smooth motion."""
    motion = zoo.smooth_motion(robot).at(np.linspace(0.0, 0.3, 7))
    plan = parked_plan(
        rp.RneaDynamics(robot),
        motion,
        parameters={"threshold": 5.0, "return_time": "shortest", "window": (0.1, np.inf)},
        diagnostics={"switch": np.array([0.1, np.nan]), "count": np.int64(3)},
    )
    return replace(plan, **changes)


@pytest.fixture(scope="module")
def plan() -> Plan:
    return _plan_of(zoo.robot_of("3rrr", carrier_mass=2.0, working_mode=(1, -1, 1), gravity=(0.0, -9.81, 0.0)))


@pytest.fixture
def saved(plan: Plan, tmp_path: Path) -> Path:
    path = tmp_path / "plan.npz"
    plan.save(path)
    return path


# ---------------------------------------------------------------------------------------------- nothing is lost


@examples(5, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(plan=plans())
def test_a_plan_comes_back_bit_by_bit(plan: Plan, tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    plan.save(path)
    assert difference(plan, load_plan(path)) == ""


def test_what_comes_back_is_read_only_and_the_file_is_closed(saved: Path) -> None:
    plan = rp.load_plan(saved)
    saved.unlink()
    for array in (plan.t, plan.tau, plan.phase, plan.sample_status, plan.condition, plan.diagnostics["switch"]):
        assert not array.flags.writeable  # type: ignore[attr-defined]
    assert plan.peak_effort.shape == (3,)


def test_the_same_plan_gives_the_same_bytes(plan: Plan, tmp_path: Path) -> None:
    first, second = tmp_path / "a.npz", tmp_path / "b.npz"
    plan.save(first)
    load_plan(first).save(second)
    assert first.read_bytes() == second.read_bytes()


def test_the_file_can_be_read_without_this_package(plan: Plan, saved: Path) -> None:
    with np.load(saved, allow_pickle=False) as archive:
        content = json.loads(str(archive["metadata"]))
        np.testing.assert_array_equal(archive["motion.x"], plan.motion.x)
        np.testing.assert_array_equal(archive["tau"], plan.tau)
    assert content["format"] == "redundancy_pin plan"
    assert content["format_version"] == PLAN_VERSION
    assert content["record"]["robot"]["name"] == "3rrr"
    assert content["record"]["parameters"]["return_time"] == "shortest"


FIELDS_OF_VERSION = {6: "ff76daa563972495"}
"""SHA-256 of the names of all fields of a file, its start, for its version."""


def test_the_version_changes_with_the_fields(plan: Plan, tmp_path: Path) -> None:
    """If this fails, the file has other fields than those of its version: raise ``PLAN_VERSION``."""

    def names(value: Any, path: str = "") -> set[str]:
        if path in (".parameters", ".diagnostics", ".robot.arguments"):  # names of the planner's and the robot's own
            return {path}
        if isinstance(value, list):
            return {path}.union(*(names(each, path) for each in value))
        if not isinstance(value, dict):
            return {path}
        return {path}.union(*(names(each, path if key == "$tuple" else f"{path}.{key}") for key, each in value.items()))

    event = LimitEvent("carrier_1", "speed", 0.0, 0.1, 0.1, 2.0, 1.0, 1.0)
    functions = replace(plan.functions, prescribed=(plan.functions.carriers,), preferred=plan.functions.carriers)
    full = replace(plan, limits=replace(plan.limits, violated=(event,), binding=(event,)), functions=functions)
    full.save(tmp_path / "plan.npz")
    with np.load(tmp_path / "plan.npz", allow_pickle=False) as archive:
        content = json.loads(str(archive["metadata"]))
    fields = sorted(names(content["record"]))
    digest = hashlib.sha256("\n".join(fields).encode()).hexdigest()[:16]
    assert {content["format_version"]: digest} == FIELDS_OF_VERSION, fields


# ------------------------------------------------------------------------------------------------- bad output


@pytest.mark.parametrize("target", ["plan.csv", "plan.JSON", "plan.mat", "nowhere/plan.npz", "."])
def test_other_formats_and_unwritable_places_are_refused(target: str, plan: Plan, tmp_path: Path) -> None:
    """A spreadsheet that opens a zip, or a program that finds no columns, would say it much later."""
    with pytest.raises(OutputError, match=r"npz archives.*plan\.npz.*to_csv" if target.startswith("plan") else None):
        plan.save(tmp_path / target)
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_the_old_plan(saved: Path, plan: Plan, monkeypatch: pytest.MonkeyPatch) -> None:
    before = saved.read_bytes()

    def full(stream: Any, **arrays: Any) -> None:
        stream.write(b"PK\x03\x04 half a file")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(np, "savez_compressed", full)
    with pytest.raises(OutputError, match="No space left"):
        plan.save(saved)
    assert saved.read_bytes() == before
    assert list(saved.parent.iterdir()) == [saved]


@pytest.mark.parametrize(
    ("value", "says"),
    [
        (object(), r"diagnostics\['bad'\] is a object"),
        ({"deep": [1, {2, 3}]}, r"diagnostics\['bad'\]\['deep'\]\[1\] is a set"),
        (np.array([object()]), "array of object"),
        (ResultStatus.OK, "ResultStatus"),
    ],
)
def test_what_a_file_cannot_hold_is_named_and_nothing_is_written(
    value: object, says: str, plan: Plan, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=says):
        replace(plan, diagnostics={"bad": value}).save(tmp_path / "plan.npz")
    assert list(tmp_path.iterdir()) == []


# -------------------------------------------------------------------------------------------------- bad files


def _refused(path: Path, says: str) -> None:
    with pytest.raises(PlanFileError, match=says) as caught:
        load_plan(path)
    assert str(path) in caught.value.message
    assert caught.value.remedy
    assert "\n" not in str(caught.value)


def _rewrite(
    path: Path,
    content: Callable[[dict[str, Any]], Any] | None = None,
    arrays: Callable[[dict[str, Any]], Any] | None = None,
) -> None:
    """Change the metadata and the arrays of a saved plan, as someone with numpy would."""
    with np.load(path) as archive:
        saved_arrays = dict(archive)
    metadata = json.loads(str(saved_arrays.pop("metadata")))
    if content:
        content(metadata)
    if arrays:
        arrays(saved_arrays)
    np.savez_compressed(path, metadata=np.array(json.dumps(metadata)), **saved_arrays)


def test_files_that_are_no_plan(tmp_path: Path) -> None:
    _refused(tmp_path / "nowhere.npz", "does not exist")
    _refused(tmp_path, "is a folder")
    path = tmp_path / "plan.npz"
    for content in (b"", b"PK", b"t,x0,x1\n0,1,2\n", b"\x93NUMPY\x01\x00"):
        path.write_bytes(content)
        _refused(path, f"not an npz archive .{len(content)} bytes")
    np.savez(path, a=np.ones(3), b=np.ones(2))
    _refused(path, "without metadata .it holds a, b")
    for text in ("no json", "[1, 2]", ""):
        np.savez(path, metadata=np.array(text))
        _refused(path, "metadata")


def test_truncated_anywhere(saved: Path) -> None:
    whole = saved.read_bytes()
    for length in [5, 100, *range(200, len(whole), len(whole) // 40), len(whole) - 1]:
        saved.write_bytes(whole[:length])
        _refused(saved, f"damaged: its {length} bytes")


def test_a_flipped_bit_is_noticed_or_harmless(plan: Plan, saved: Path) -> None:
    """A byte of the zip directory that nobody reads may change; no changed byte may change a plan."""
    whole = bytearray(saved.read_bytes())
    noticed = 0
    rng = np.random.default_rng(3)
    for place in rng.choice(len(whole), 150, replace=False):
        whole[place] ^= 0x10
        saved.write_bytes(whole)
        try:
            assert difference(plan.tau, load_plan(saved).tau) == ""
        except PlanFileError:
            noticed += 1
        whole[place] ^= 0x10
    assert noticed > 100


def test_pickles_are_not_opened(tmp_path: Path) -> None:
    path, trap = tmp_path / "plan.npz", tmp_path / "trap"
    np.savez(path, metadata=np.array([_Trap(trap)], dtype=object))
    _refused(path, "damaged")
    assert not trap.exists()


class _Trap:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> tuple[Any, ...]:
        return Path.touch, (self.path,)


def test_another_format_and_newer_ones(saved: Path) -> None:
    original = saved.read_bytes()
    _rewrite(saved, lambda content: content.update(format="someone's plan"))
    _refused(saved, "someone's plan")
    saved.write_bytes(original)
    _rewrite(saved, lambda content: content.update(format_version=PLAN_VERSION + 1, package_version="7.0"))
    _refused(
        saved, rf"version {PLAN_VERSION + 1}, written by redundancy_pin 7\.0; .* reads version {PLAN_VERSION}\. Inst"
    )
    saved.write_bytes(original)
    # an older file has other fields: it is not damaged
    _rewrite(saved, lambda content: content.update(format_version=PLAN_VERSION - 1, record={}))
    _refused(saved, rf"version {PLAN_VERSION - 1}, .* reads version {PLAN_VERSION}\. Compute the plan again")
    for version in (0, "1", None, True):
        saved.write_bytes(original)
        _rewrite(saved, lambda content, version=version: content.update(format_version=version))
        _refused(saved, f"format version is {version!r}")


def _record(change: Callable[[dict[str, Any]], Any]) -> Callable[[Path], None]:
    return lambda path: _rewrite(path, lambda content: change(content["record"]))


def _array(name: str, change: Callable[[Any], Any]) -> Callable[[Path], None]:
    return lambda path: _rewrite(path, arrays=lambda held: held.update({name: change(held[name])}))


TAMPERED: dict[str, tuple[Callable[[Path], None], str]] = {
    "a sample less": (_array("tau", lambda a: a[:-1]), r"tau has shape \(6, 3\).*\(7, 3\)"),
    "carrier force flat": (_array("carrier_force", np.ravel), r"carrier_force has shape \(21,\)"),
    "time backwards": (_array("motion.t", lambda a: a[::-1]), "Time does not increase"),
    "position not finite": (_array("motion.x", lambda a: a * np.nan), "x has 21 value"),
    "single precision": (_array("margin", lambda a: a.astype(np.float32)), "margin is an array of float32"),
    "status that has no name": (_array("sample_status", lambda a: a - 1), "sample_status holds -1"),
    "an array missing": (lambda path: _rewrite(path, arrays=lambda held: held.pop("tau")), "tau"),
    "a field missing": (_record(lambda r: r.pop("margin")), "'margin' is missing"),
    "a field of the robot missing": (_record(lambda r: r["robot"].pop("source")), "'source' is missing"),
    "limits of one carrier": (
        _record(lambda r: r["robot"]["carrier_limits"]["$tuple"].pop()),
        "limits of 2 carriers, but 3",
    ),
    "judged by limits of two": (
        _record(lambda r: r["limits"]["judged_by"]["names"]["$tuple"].pop()),
        "limits of 2 carriers, but 3",
    ),
    "an unknown status": (_record(lambda r: r.update(status="splendid")), "splendid"),
    "an array that is a number": (_record(lambda r: r.update(tau=3)), "tau is an int"),
    "an unknown mark": (_record(lambda r: r.update(parameters={"$code": "1"})), "unknown mark"),
    "a list for the record": (
        lambda path: _rewrite(path, lambda content: content.update(record=[1])),
        "no record",
    ),
    "limits of text": (_record(lambda r: r["limits"]["judged_by"].update(speed="fast")), "is damaged"),
    "limits without a field": (_record(lambda r: r["limits"]["judged_by"].pop("carrier_force")), "is damaged"),
    "an event that is a number": (_record(lambda r: r["limits"].update(violated={"$tuple": [3]})), "is damaged"),
    "phases that are numbers": (_record(lambda r: r.update(phases={"$tuple": [1] * 9})), "is damaged"),
    "a planner that is a number": (_record(lambda r: r.update(planner=3)), "is damaged"),
    "diagnostics that are text": (_record(lambda r: r.update(diagnostics="none")), "is damaged"),
    "breaks of efforts": (_record(lambda r: r["functions"]["platform"].update(breaks="tau")), "is damaged"),
    "a start that is text": (_record(lambda r: r["functions"]["platform"].update(start="0")), "is damaged"),
    "no record": (lambda path: _rewrite(path, lambda content: content.pop("record")), "record"),
}


@pytest.mark.parametrize("case", TAMPERED)
def test_tampered_files(case: str, saved: Path) -> None:
    tamper, says = TAMPERED[case]
    tamper(saved)
    _refused(saved, says)


# ------------------------------------------------------------------------------------------ the robot of a plan


def test_the_robot_comes_back_with_arguments_gravity_and_mode(saved: Path) -> None:
    robot = load_robot_of(load_plan(saved))
    assert robot.parameters["carrier_mass"] == 2.0
    np.testing.assert_array_equal(robot.gravity, [0.0, -9.81, 0.0])
    assert robot.working_mode == (1, -1, 1)


def test_every_shipped_robot_comes_back(shipped: Robot, tmp_path: Path) -> None:
    path = tmp_path / "plan.npz"
    plan = _plan_of(shipped)
    plan.save(path)
    loaded = load_plan(path)
    assert difference(plan.motion, loaded.motion) == ""
    robot = load_robot_of(loaded)
    again = _plan_of(robot)
    # the same computation on the robot loaded again
    np.testing.assert_array_equal(again.tau, loaded.tau)
