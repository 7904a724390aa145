"""Names, signatures and imports of version 0.1.0 hold: new ones may come, old ones may warn, none may go."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator, Mapping
from typing import Any, NamedTuple

import pytest
from compatibility_cases import DATA
from interfaces import PLACES, describe, headline_table, members, parameters, place, results, thing

API = json.loads((DATA / "public_api.json").read_text(encoding="utf-8"))
IMPORTS = json.loads((DATA / "documented_imports.json").read_text(encoding="utf-8"))

RENAMED: Mapping[str, str] = {"rp.simulate(way)": "method", "rp.simulation.simulate(way)": "method"}
"""Pinned parameters, such as ``rp.simulate(way)``, and the ones that have their defaults now: both are accepted."""


@pytest.mark.parametrize("module", PLACES)
def test_public_names_are_still_there(module: str) -> None:
    there = place(module)
    missing = [name for name in API["names"][module] if not has(there, name)]
    assert missing == []


@pytest.mark.parametrize("module", PLACES)
def test_what_they_stand_for_is_called_as_before(module: str) -> None:
    there = place(module)
    lost = [
        line
        for name, pinned in API["names"][module].items()
        if has(there, name)
        for line in _differences(f"{module}.{name}", pinned, thing(there, name))
    ]
    assert lost == []


def test_results_have_their_attributes() -> None:
    now = results()
    lost = {name: sorted(set(pinned) - set(now[name])) for name, pinned in API["results"].items()}
    assert {name: entries for name, entries in lost.items() if entries} == {}


@pytest.mark.parametrize("line", IMPORTS)
def test_documented_imports_work(line: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        exec(compile(line, "<documented>", "exec"), {})


def test_the_headline_is_that_of_the_first_version() -> None:
    """``tests/experiments`` compares the table with what the job computes."""
    assert headline_table() == json.loads((DATA / "headline.json").read_text(encoding="utf-8"))


def has(module: Any, name: str) -> bool:
    try:
        thing(module, name)
    except AttributeError:
        return False
    return True


def _differences(where: str, pinned: dict[str, Any], value: Any) -> Iterator[str]:
    """Give what is lost of a pinned description."""
    now = describe(value)
    if pinned["kind"] == "constant":
        kept = now.get("value")
        if isinstance(kept, list):  # of a list the entries count: new ones may come
            kept = [entry for entry in kept if entry in pinned["value"]]
        if pinned.get("value") != kept:
            yield f"{where} is {now.get('value')}, was {pinned['value']}"
        return
    if pinned["kind"] == "function":
        if not callable(value):
            yield f"{where} is no function any more"
            return
        yield from _lost_parameters(where, pinned["parameters"], parameters(value))
        return
    if pinned["kind"] != now["kind"]:
        yield f"{where} is a {now['kind']}, was a {pinned['kind']}"
    elif pinned["kind"] == "enum":
        lost = {name: entry for name, entry in pinned["members"].items() if now["members"].get(name) != entry}
        if lost:
            yield f"{where} has lost {lost}"
    elif pinned["kind"] == "class":
        yield from _lost_from_class(where, pinned, value, now)


def _lost_from_class(where: str, pinned: dict[str, Any], kind: type, now: dict[str, Any]) -> Iterator[str]:
    bases = {base.__name__ for base in kind.__mro__}
    for base in pinned.get("bases", ()):
        if base not in bases:
            yield f"{where} is no {base} any more"
    if "parameters" in pinned:
        yield from _lost_parameters(where, pinned["parameters"], parameters(kind))
    known = members(kind, undocumented=True)
    yield from (f"{where}.{name} is gone" for name in pinned["attributes"] if name not in known)
    for name, signature in pinned["methods"].items():
        if callable(getattr(kind, name, None)):
            yield from _lost_parameters(f"{where}.{name}", signature, parameters(getattr(kind, name)))
        else:
            yield f"{where}.{name} is no method any more"


def _lost_parameters(where: str, pinned: list[str], now: list[str]) -> Iterator[str]:
    """Give pinned parameters that are not accepted as before, and new ones without a default."""
    current = {parameter.name: parameter for parameter in map(_read, now)}
    in_order = [name for name, parameter in current.items() if parameter.kind.startswith("POSITIONAL")]
    before = [_read(text) for text in pinned]
    for index, (kind, name, default) in enumerate(before):
        text = f"{where}({name})"
        if name not in current:
            yield f"{text} is gone"
            continue
        if kind == "POSITIONAL_OR_KEYWORD" and (current[name].kind != kind or in_order.index(name) != index):
            yield f"{text} has another place"
        if kind == "KEYWORD_ONLY" and current[name].kind not in ("KEYWORD_ONLY", "POSITIONAL_OR_KEYWORD"):
            yield f"{text} is no keyword"
        meant = current.get(RENAMED.get(text, name))
        left_out = meant.default if meant else ""
        if default and left_out != default:
            yield f"{text} is {left_out or 'required'} when left out, was {default}"
    for name in current.keys() - {parameter.name for parameter in before}:
        if not current[name].default and not current[name].kind.startswith("VAR_"):
            yield f"{where} cannot be called without the new {name}"


class _Parameter(NamedTuple):
    kind: str
    name: str
    default: str


def _read(text: str) -> _Parameter:
    first, _, default = text.partition(" = ")
    kind, _, name = first.partition(" ")
    return _Parameter(kind, name, default)
