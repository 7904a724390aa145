"""The one reader of YAML: what a file may hold, and that everything else is refused fast, with file and line."""

from __future__ import annotations

import os
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.errors import InputError
from redundancy_pin.io.yaml_file import DEEPEST, LARGEST_FILE, MOST_VALUES, YamlFile, parse_yaml, read_yaml

SOON = 10.0
"""Seconds of the processor after which a refusal hangs: without limits the inputs below take minutes."""

BOMB = "a0: &a0 [x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]\n" for i in range(1, 12)
)
"""Twelve lines for 3e11 values."""

SCALARS = st.one_of(st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False), st.text(max_size=9))
DOCUMENTS = st.recursive(
    SCALARS,
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(max_size=5), inner, max_size=4)),
    max_leaves=12,
)


def parsed(text: str) -> YamlFile:
    return parse_yaml(text, "robot.yaml", InputError)


def refused(call: Callable[[], Any], *says: str) -> str:
    begin = time.process_time()
    with pytest.raises(InputError) as caught:
        call()
    assert time.process_time() - begin < SOON
    text = str(caught.value)
    assert caught.value.remedy
    assert "\n" not in text
    assert len(text) < 1000
    for part in says:
        assert part in text
    return text


@given(value=DOCUMENTS)
def test_what_yaml_writes_is_read_as_its_own_reader_does(value: Any) -> None:
    text = yaml.safe_dump(value, allow_unicode=True)
    assert parsed(text).data == yaml.safe_load(text)


def test_the_shipped_files_are_read_as_yaml_does() -> None:
    top = Path(__file__).resolve().parents[2]
    files = [*top.glob("models/*/robot.yaml"), *top.glob("docs/*.yaml"), *top.glob("redundancy_pin/thesis/*.yaml")]
    assert len(files) > 8
    for file in files:
        assert read_yaml(file, InputError).data == yaml.safe_load(file.read_text(encoding="utf-8")), file


def test_anchors_and_merged_keys() -> None:
    text = "a: &a {x: 1, y: 2}\nb: {<<: *a, y: 3}\nc: {<<: [{y: 4}, *a], z: *a}\n"
    assert parsed(text).data == yaml.safe_load(text)


def test_a_mark_of_byte_order_is_no_part_of_the_first_key(tmp_path: Path) -> None:
    path = tmp_path / "a.yaml"
    path.write_bytes(b"\xef\xbb\xbfname: x\n")
    assert read_yaml(path, InputError).data == {"name": "x"}


def test_places() -> None:
    file = parsed("name: x\ncarriers:\n- joint: a\n  speed: 1\n- joint: b\n")
    assert file.place("carriers") == "robot.yaml, line 2"
    assert file.place("carriers[0].speed") == "robot.yaml, line 4"
    assert file.place("carriers[1]") == "robot.yaml, line 5"
    assert file.place("carriers[1].force") == "robot.yaml, line 5"
    assert file.place("reference.guess") == "robot.yaml"


REFUSED = {
    "a key twice": ("gravity: [0, 0, -9.81]\nname: x\ngravity: [0, 0, 0]\n", "line 3", "'gravity'", "line 1"),
    "a key twice inside": ("a:\n- {x: 1,\n   x: 2}\n", "line 3", "'x'"),
    "a merge twice": ("a: &a {}\nb: {<<: *a, <<: *a}\n", "'<<'"),
    "a number for a key": ("guess: {1: 0.5}\n", "line 1", "key 1", "quotes"),
    "a truth value for a key": ("on: 1\n", "key True"),
    "nothing for a key": ("~: 1\n", "key None"),
    "a list for a key": ("? [a]\n: 1\n", "is not text, but a list"),
    "a date": ("name: x\nurdf: 2026-11-22\n", "line 2", "`urdf`", "2026-11-22", "timestamp", "quotes"),
    "a date in a list": ("a: [1, 2026-11-22 10:00:00]\n", "`a[1]`", "timestamp"),
    "binary data": ("a: !!binary aGk=\n", "binary"),
    "a set": ("a: !!set {b}\n", "set"),
    "an object of Python": ("a: !!python/object/apply:os.system [id]\n", "python/object/apply:os.system"),
    "an unknown tag": ("a: !robot {b: 1}\n", "!robot"),
    "a tag that is not true": ("a: !!int word\n", "'word'", "int"),
    "an octal number": ("speed: 010\n", "`speed`", "010"),
    "a number to base sixty": ("time: 1:30\n", "`time`", "1:30"),
    "a float to base sixty": ("time: 1:30.5\n", "`time`", "1:30.5"),
    "a signed one": ("time: +1:2:3.4\n", "`time`", "+1:2:3.4"),
    "text made such a float": ("time: !!float '1:1'\n", "`time`", "1:1"),
    "an integer without end": (f"a: {'9' * 5000}\n", "5000 digits"),
    "one in base sixteen": (f"a: 0x{'f' * 9000}\n", "9002 digits"),
    "a bomb": (BOMB, "line ", str(MOST_VALUES)),
    "a bomb of merges": (
        "a0: &a0 {k0: 1}\n" + "".join(f"a{i}: &a{i} {{<<: *a{i - 1}, k{i}: 1}}\n" for i in range(1, 600)),
        str(DEEPEST),
    ),
    "a value that holds itself": ("a: &a [*a]\n", "line 1", "holds itself"),
    "a merge of itself": ("a: &a {<<: *a}\n", "line 1", "holds itself"),
    "a merge of no mapping": ("a: {<<: 3}\n", "no mapping"),
    "no such anchor": ("a: *b\n", "line 1", "undefined alias"),
    "deep lists": ("a: " + "[" * 100_000, str(DEEPEST)),
    "deep mappings": ("{a: " * 100_000, str(DEEPEST)),
    "deep blocks": ("\n".join(" " * i + "a:" for i in range(200)), str(DEEPEST)),
    "a million values": ("a: [" + "0," * 400_000 + "]", str(MOST_VALUES)),
    "definitions of tags": ("".join(f"%TAG !a{i}! x\n" for i in range(60_000)) + "--- 1", "line 1", "tag"),
    "two documents": ("a: 1\n---\nb: 2\n", "line 2", "single document"),
    "a tab": ("a:\n\t- 1\n", "line 2", "column 1", "a tab", "Put spaces"),
    "a NUL": ("a: \x00\n", "not readable YAML"),
    "half a list": ("a: 1\nb: [1,\n", "not readable YAML"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_refused_with_file_and_place(case: str) -> None:
    text, *says = REFUSED[case]
    refused(lambda: parsed(text), "robot.yaml", *says)


def _folder(path: Path) -> None:
    path.mkdir()


FILES: dict[str, tuple[Callable[[Path], object], str]] = {
    "a folder": (_folder, "folder"),
    "a pipe": (os.mkfifo, "pipe or a device"),
    "a device": (lambda path: path.symlink_to("/dev/zero"), "pipe or a device"),
    "a link that leads nowhere": (lambda path: path.symlink_to("nowhere"), "does not exist"),
    "a link to itself": (lambda path: path.symlink_to(path), "cannot be read"),
    "nothing": (lambda path: None, "does not exist"),
    "fifty megabytes of comments": (lambda path: path.write_bytes(b"# \n" * 17_000_000), str(LARGEST_FILE)),
    "a file with holes": (lambda path: os.truncate(path, 1 << 40) if path.write_bytes(b"") == 0 else None, "too large"),
    "Latin": (lambda path: path.write_bytes(b"a: 1\nname: Gr\xfcbler\n"), "line 2"),
    "UTF-16": (lambda path: path.write_bytes("a: 1\n".encode("utf-16")), "UTF-8"),
}


@pytest.mark.parametrize("case", FILES)
def test_what_is_no_file_of_text_is_refused_at_once(case: str, tmp_path: Path) -> None:
    make, says = FILES[case]
    path = tmp_path / "a.yaml"
    make(path)
    refused(lambda: read_yaml(path, InputError, "The problem "), str(path), says)


@pytest.mark.parametrize("name", ["x" * 300, "a\x00b", "~nobody-of-this-name/a.yaml", "a/" * 3000, "/dev/null"])
def test_names_that_no_file_can_have(name: str) -> None:
    refused(lambda: read_yaml(name, InputError), "cannot be read")
