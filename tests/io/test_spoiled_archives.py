"""Malformed files, by hypothesis: refused by one clear error, or read as they stand; nothing else, and soon.

Some sixty plans and texts in ``make test``, ten times as many in ``make long``, which also tries 9,500 files of the
other formats (``tests/fuzz/test_malformed_files.py``), each in a process of its own.
"""

from __future__ import annotations

import functools
import io
import json
import resource
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from examples import examples
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from mutated import plan_of, saved, stepwise_plan
from random_plans import difference

import redundancy_pin as rp
from redundancy_pin.errors import InputError, RedundancyPinError
from redundancy_pin.io.reading import read_json
from redundancy_pin.io.yaml_file import parse_yaml

SECONDS, MEGABYTES = 2.0, 500.0
"""Of the processor, and of memory beyond that of the process, for a malformed file."""

FILES = examples(20, suppress_health_check=[HealthCheck.function_scoped_fixture])

SPOILS = st.lists(
    st.tuples(st.floats(0.0, 1.0), st.sampled_from(["flip", "cut", "drop", "double", "put"]), st.binary(max_size=9)),
    min_size=1,
    max_size=4,
)
"""Where in a file, what is done there, and bytes to put there."""


def spoiled(content: bytes, spoils: list[tuple[float, str, bytes]]) -> bytes:
    for where, what, more in spoils:
        at = int(where * len(content))
        before, after = content[:at], content[at:]
        if what == "flip" and after:
            after = bytes([after[0] ^ 1 << len(more) % 8]) + after[1:]
        content = {
            "flip": before + after,
            "cut": before,
            "drop": before + after[len(more) + 1 :],
            "double": before + after[:30] + after,
            "put": before + more + after,
        }[what]
    return content


def _parked() -> rp.Plan:
    return plan_of("gough")


PLANS = st.sampled_from([_parked, stepwise_plan])
"""Poses with parked carriers; functions of time and findings."""


@functools.cache
def right(plan: Callable[[], rp.Plan]) -> rp.Plan:
    """Return the plan as its file gives it."""
    with tempfile.TemporaryDirectory() as folder:
        (Path(folder) / "plan.npz").write_bytes(saved(plan))
        return rp.load_plan(Path(folder) / "plan.npz")


def tried(action: Callable[[], Any], name: str) -> Any:
    """Return what an action returns; None where it is refused, soon, by one line that names file and remedy."""
    begin, before, result, refusal = time.process_time(), _peak(), None, None
    try:
        result = action()
    except RedundancyPinError as error:
        refusal = error
    assert time.process_time() - begin < SECONDS
    assert _peak() - before < MEGABYTES
    if refusal is not None:
        assert name in refusal.message
        assert refusal.remedy
        assert "\n" not in str(refusal)
        assert len(str(refusal)) < 1500
    return result


@FILES
@given(plan=PLANS, spoils=SPOILS)
def test_spoiled_bytes_of_a_plan_are_noticed_or_change_nothing(
    plan: Callable[[], rp.Plan], spoils: list[tuple[float, str, bytes]], tmp_path: Path
) -> None:
    path = tmp_path / "plan.npz"
    path.write_bytes(spoiled(saved(plan), spoils))
    read = tried(lambda: rp.load_plan(path), str(path))
    assert read is None or not difference(right(plan), read)


def _peak() -> float:
    """Return the largest memory that this process has had, MB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


ARRAYS: dict[str, Callable[[Any], Any]] = {
    "another number": lambda array: array * 7 if array.dtype.kind in "fi" else array,
    "NaN": lambda array: array * np.nan if array.dtype.kind == "f" else array,
    "single precision": lambda array: array.astype(np.float32) if array.dtype.kind == "f" else array,
    "complex": lambda array: array.astype(complex) if array.dtype.kind in "fi" else array,
    "bytes": lambda array: array.astype("S4"),
    "objects": lambda array: array.astype(object),
    "flat": lambda array: array.reshape(-1),
    "one axis more": lambda array: array[..., None],
    "nothing": lambda array: array[:0] if array.ndim else np.zeros(0),
    "text": lambda _: np.array("text"),
    "another shape": lambda _: np.zeros((2, 3, 4)),
    "many flags": lambda _: np.zeros(3 * 10**7, dtype=np.int8),
    "many doubles": lambda _: np.zeros(4 * 10**6),
    "too many bytes": lambda _: np.zeros(10**8, dtype=np.int8),
}
"""What becomes of an array of a plan."""


@FILES
@given(plan=PLANS, member=st.integers(0, 60), what=st.sampled_from(sorted(ARRAYS)), left_out=st.booleans())
def test_plans_with_other_arrays_are_refused(
    plan: Callable[[], rp.Plan], member: int, what: str, left_out: bool, tmp_path: Path
) -> None:
    with zipfile.ZipFile(io.BytesIO(saved(plan))) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    name = sorted(members)[member % len(members)]
    before, stream = np.load(io.BytesIO(members[name])), io.BytesIO()
    after = ARRAYS[what](before)
    np.save(stream, after, allow_pickle=True)
    unchanged = not left_out and after.dtype == before.dtype and np.array_equal(after, before, equal_nan=False)
    members[name] = stream.getvalue()
    path = tmp_path / "plan.npz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for each, member_bytes in members.items():
            if not (left_out and each == name):
                archive.writestr(each, member_bytes)
    assert (tried(lambda: rp.load_plan(path), str(path)) is not None) == unchanged


@FILES
@given(spoils=SPOILS)
def test_spoiled_json_is_refused_or_read_as_python_does(spoils: list[tuple[float, str, bytes]]) -> None:
    header = str(np.load(io.BytesIO(zipfile.ZipFile(io.BytesIO(saved(stepwise_plan))).read("metadata.npy"))))
    text = spoiled(header.encode(), spoils).decode("utf-8", "replace")
    try:
        value = read_json(text)
    except ValueError:
        return
    assert repr(value) == repr(json.loads(text))


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=9), st.just([]), st.just({}),
    st.sampled_from(["$tuple", "$array", "$float", "$mapping", "$code"]).map(lambda mark: {mark: "tau"}),
)  # fmt: skip


@FILES
@given(plan=PLANS, where=st.lists(st.integers(0, 40), min_size=1, max_size=6), value=VALUES)
def test_plans_whose_metadata_hold_other_values_are_refused(
    plan: Callable[[], rp.Plan], where: list[int], value: Any, tmp_path: Path
) -> None:
    with zipfile.ZipFile(io.BytesIO(saved(plan))) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    data = json.loads(str(np.load(io.BytesIO(members["metadata.npy"]))))
    inner, key = data, "record"
    for step in where:  # down into lists and mappings, as far as there are any
        held = inner[key]
        if not isinstance(held, (dict, list)) or not held:
            break
        inner, key = held, (list(held) if isinstance(held, dict) else list(range(len(held))))[step % len(held)]
    unchanged = json.dumps(inner[key]) == json.dumps(value)
    inner[key] = value
    stream = io.BytesIO()
    np.save(stream, np.array(json.dumps(data)))
    members["metadata.npy"] = stream.getvalue()
    path = tmp_path / "plan.npz"
    with zipfile.ZipFile(path, "w") as archive:
        for name, member in members.items():
            archive.writestr(name, member)
    assert (tried(lambda: rp.load_plan(path), str(path)) is not None) == unchanged


@functools.cache
def declaration() -> str:
    return (Path(__file__).parents[2] / "models" / "3rrr" / "robot.yaml").read_text(encoding="utf-8")


@FILES
@given(spoils=SPOILS)
def test_spoiled_yaml_is_refused_or_read_as_yaml_does(spoils: list[tuple[float, str, bytes]]) -> None:
    text = spoiled(declaration().encode(), spoils).decode("utf-8", "replace")
    file = tried(lambda: parse_yaml(text, "robot.yaml", InputError), "robot.yaml")
    assert file is None or file.data == yaml.safe_load(text)


def test_a_spoiled_file_is_another_file() -> None:
    """The judge itself: what is spoiled differs."""
    content = saved(_parked)
    for what in ("flip", "cut", "drop", "double", "put"):
        assert spoiled(content, [(0.5, what, b"x")]) != content
