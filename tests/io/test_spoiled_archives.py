"""Malformed files, by hypothesis: refused by one clear error, or read as they stand; nothing else, and soon.

Some hundred in ``make test``; ``make long`` tries 11,500 of all formats (``tests/fuzz/test_malformed_files.py``), each
in a process of its own.
"""

from __future__ import annotations

import functools
import io
import json
import tempfile
import time
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import yaml
import zoo
from examples import examples
from hypothesis import HealthCheck, given
from hypothesis import strategies as st
from parked_plans import parked_plan

import redundancy_pin as rp
from redundancy_pin.errors import InputError, RedundancyPinError
from redundancy_pin.io.yaml_file import parse_yaml

SECONDS = 2.0
"""Of the processor, for what is refused."""

FILES = examples(60, suppress_health_check=[HealthCheck.function_scoped_fixture])

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


@functools.cache
def saved_plan() -> tuple[bytes, Any]:
    """Return the bytes of a plan, and what they say of its efforts."""
    robot = zoo.robot_of("four_bar")
    plan = parked_plan(rp.RneaDynamics(robot), zoo.smooth_motion(robot).at(np.linspace(0.0, 0.3, 7)))
    folder = Path(tempfile.mkdtemp())
    plan.save(folder / "plan.npz")
    return (folder / "plan.npz").read_bytes(), np.array(plan.tau)


def tried(action: Callable[[], Any], name: str) -> Any:
    """Return what an action returns; None where it is refused, soon, by one line that names file and remedy."""
    begin, result, refusal = time.process_time(), None, None
    try:
        result = action()
    except RedundancyPinError as error:
        refusal = error
    assert time.process_time() - begin < SECONDS
    if refusal is not None:
        assert name in refusal.message
        assert refusal.remedy
        assert "\n" not in str(refusal)
        assert len(str(refusal)) < 1500
    return result


@FILES
@given(spoils=SPOILS)
def test_spoiled_bytes_of_a_plan_are_noticed_or_change_nothing(
    spoils: list[tuple[float, str, bytes]], tmp_path: Path
) -> None:
    content, tau = saved_plan()
    path = tmp_path / "plan.npz"
    path.write_bytes(spoiled(content, spoils))
    plan = tried(lambda: rp.load_plan(path), str(path))
    assert plan is None or np.array_equal(plan.tau, tau)


VALUES = st.one_of(
    st.none(), st.booleans(), st.integers(), st.floats(), st.text(max_size=9), st.just([]), st.just({}),
    st.sampled_from(["$tuple", "$array", "$float", "$mapping", "$code"]).map(lambda mark: {mark: "tau"}),
)  # fmt: skip


@FILES
@given(where=st.lists(st.integers(0, 40), min_size=1, max_size=6), value=VALUES)
def test_plans_whose_metadata_hold_other_values_are_refused(where: list[int], value: Any, tmp_path: Path) -> None:
    content, _ = saved_plan()
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
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
    content, _ = saved_plan()
    for what in ("flip", "cut", "drop", "double", "put"):
        assert spoiled(content, [(0.5, what, b"x")]) != content
