"""The error tree: one root, message with remedy, numbers that survive another process."""

from __future__ import annotations

import ast
import contextlib
import functools
import inspect
import pickle
import re
from pathlib import Path

import pytest

from redundancy_pin import errors
from redundancy_pin.errors import InputError, RedundancyPinError, UnreachablePoseError

KINDS = [
    kind
    for _, kind in inspect.getmembers(errors, inspect.isclass)
    if issubclass(kind, Exception) and kind.__module__ == errors.__name__
]


@pytest.mark.parametrize("kind", KINDS)
def test_every_error_has_the_one_root(kind: type[RedundancyPinError]) -> None:
    assert issubclass(kind, RedundancyPinError)
    assert kind.__doc__


def test_text_is_message_then_remedy() -> None:
    error = UnreachablePoseError("It is out of reach by 0.2 m.", remedy="Move it.", gap=0.2)
    assert str(error) == "It is out of reach by 0.2 m. Move it."
    assert str(UnreachablePoseError("It is out of reach.")) == "It is out of reach."
    assert (error.message, error.remedy) == ("It is out of reach by 0.2 m.", "Move it.")


def test_details_cannot_be_changed() -> None:
    error = UnreachablePoseError("Out of reach.", gap=0.2)
    with pytest.raises(TypeError):
        error.details["gap"] = 0.0  # type: ignore[index]


@pytest.mark.parametrize("kind", KINDS)
def test_errors_survive_pickling(kind: type[RedundancyPinError]) -> None:
    error = kind("Wrong by 3.", remedy="Do this.", sample=3, gap=0.1)
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is kind
    assert str(copy) == str(error)
    assert copy.message == error.message
    assert copy.remedy == error.remedy
    assert dict(copy.details) == {"sample": 3, "gap": 0.1}


def test_bad_arguments_are_value_errors_for_callers_who_know_python_only() -> None:
    with pytest.raises(ValueError, match="Wrong"):
        raise InputError("Wrong.")


@functools.cache
def _raised() -> list[tuple[str, ast.Call]]:
    """Return every place of the package where an error of ours is made: only these are parsed, not all of it."""
    named = re.compile(rf"(?<![\w.])(?<!class )(?:{'|'.join(kind.__name__ for kind in KINDS)})\(")
    package = Path(errors.__file__).parent
    made = []
    for path in package.rglob("*.py"):
        text = path.read_text(encoding="utf-8")
        for match in named.finditer(text):
            place = f"{path.relative_to(package)}:{text.count(chr(10), 0, match.start()) + 1}"
            made.append((place, _call(text[match.start() :])))
    return made


def _call(text: str) -> ast.Call:
    """Return the call that a text begins with, up to the first bracket that makes it one."""
    for bracket in re.finditer(r"\)", text):
        with contextlib.suppress(SyntaxError):
            call = ast.parse(text[: bracket.end()], mode="eval").body
            assert isinstance(call, ast.Call)
            return call
    raise AssertionError(text[:200])


def test_every_error_is_raised_somewhere() -> None:
    made = {node.func.id for _, node in _raised() if isinstance(node.func, ast.Name)}
    assert {kind.__name__ for kind in KINDS} - made == {"RedundancyPinError"} - made


def test_the_time_of_a_trouble_has_one_name_in_all_details() -> None:
    others = {"t", "at", "when", "instant", "moment", "time_s", "seconds"}
    assert [place for place, node in _raised() if others & {keyword.arg for keyword in node.keywords}] == []
