"""The error tree: one root, message with remedy, numbers that survive another process."""

from __future__ import annotations

import inspect
import pickle

import pytest

from redundancy_pin import errors
from redundancy_pin.errors import InputError, RedundancyPinError, UnreachablePoseError, did_you_mean, rounded_down

KINDS = [
    kind
    for _, kind in inspect.getmembers(errors, inspect.isclass)
    if issubclass(kind, Exception) and kind.__module__ == errors.__name__
]


def test_text_is_message_then_remedy() -> None:
    error = UnreachablePoseError("It is out of reach by 0.2 m.", remedy="Move it.", gap=0.2)
    assert str(error) == "It is out of reach by 0.2 m. Move it."
    assert str(UnreachablePoseError("It is out of reach.")) == "It is out of reach."
    assert (error.message, error.remedy) == ("It is out of reach by 0.2 m.", "Move it.")


@pytest.mark.parametrize("value", [1.3456, 134.99, 0.26899, 12345.6, 1.34, 0.1 + 0.2, 9.999e-7])
def test_a_bound_in_a_message_is_rounded_down(value: float) -> None:
    assert 0.99 * value < float(rounded_down(value)) <= value


def test_a_name_that_is_begun_is_meant_before_one_that_is_alike() -> None:
    assert did_you_mean("spe", ["ape", "speed_limit"]) == "Did you mean 'speed_limit'? "
    assert did_you_mean("spe", ["ape", "limit"]) == "Did you mean 'ape'? "
    assert did_you_mean("x", ["xylophone", "limit"]) == ""


def test_details_cannot_be_changed() -> None:
    error = UnreachablePoseError("Out of reach.", gap=0.2)
    with pytest.raises(TypeError):
        error.details["gap"] = 0.0  # type: ignore[index]


@pytest.mark.parametrize("kind", KINDS)
def test_errors_survive_pickling(kind: type[RedundancyPinError]) -> None:
    error = kind("Wrong by 3.", remedy="Do this.", sample=3, gap=0.1)
    assert isinstance(error, RedundancyPinError)
    assert kind.__doc__
    copy = pickle.loads(pickle.dumps(error))
    assert type(copy) is kind
    assert str(copy) == str(error)
    assert copy.message == error.message
    assert copy.remedy == error.remedy
    assert dict(copy.details) == {"sample": 3, "gap": 0.1}


def test_bad_arguments_are_value_errors_for_callers_who_know_python_only() -> None:
    with pytest.raises(ValueError, match="Wrong"):
        raise InputError("Wrong.")
