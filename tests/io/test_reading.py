"""The one reader of JSON."""

from __future__ import annotations

import json
from typing import Any

import pytest
from examples import examples
from hypothesis import given
from hypothesis import strategies as st

from redundancy_pin.io.reading import DEEPEST, LARGEST_TEXT, MOST_LISTS, read_json

VALUES = st.recursive(
    st.one_of(st.none(), st.booleans(), st.integers(), st.floats(allow_nan=False, allow_infinity=False), st.text()),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(st.text(), inner, max_size=4)),
    max_leaves=12,
)


@examples(15)
@given(value=VALUES)
def test_json_comes_back(value: Any) -> None:
    text = json.dumps(value)
    assert read_json(text) == json.loads(text)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("[" * 100_000, "nested more"),
        ("[" * (DEEPEST + 2) + "]" * (DEEPEST + 2), "nested more"),
        ('{"a":' * 400 + "1" + "}" * 400, "nested more"),
        ('{"a": 1, "b": {"c": 1, "c": 2}}', "'c' twice"),
        ('{"a": NaN}', "NaN"),
        ("[-Infinity]", "Infinity"),
        ("9" * 5000, "5000 digits"),
        (r'"\ud800"', "surrogates"),
        (r'{"\udfff": 1}', "surrogates"),
        ("", "Expecting value"),
        ("[1] [2]", "Extra data"),
        ("[" + "[]," * MOST_LISTS + "1]", "lists and objects"),
        (" " * (LARGEST_TEXT + 1), "at most"),
    ],
)
def test_refused(text: str, says: str) -> None:
    with pytest.raises(ValueError, match=says) as caught:
        read_json(text)
    assert len(str(caught.value)) < 400


def test_as_deep_as_allowed() -> None:
    assert read_json("[" * DEEPEST + "]" * DEEPEST)
    assert read_json("[NaN, 1]", constants=True)[1] == 1
